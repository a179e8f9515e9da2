"""The systems that come with the library: one function for each, made from the C catalogue.

``dal.systems.names()`` lists them, ``dal.systems.particle()`` makes one, ``help(dal.systems.disk)``
shows its coordinates and parameters.

>>> import dalembert as dal
>>> ball = dal.systems.ball_on_table(Omega=2)  # affine constraints
>>> ball.coordinates
('x', 'y', 'theta_x', 'theta_y', 'theta_z')
>>> ball.parameters["Omega"], dal.systems.rolling_disc(m=2, g=0).parameters["m"]
(2.0, 2.0)
>>> dal.systems.snakeboard(J0=1)
Traceback (most recent call last):
    ...
ValueError: parameters m = 1, r = 0.5, J0 = 1 of snakeboard; expected m r^2 > J0, and m r^2 is 0.25
"""

from __future__ import annotations

import inspect
from collections.abc import Callable

from . import _lib
from ._lib import lib
from .system import System

__all__ = ["get", "names"]


def names() -> tuple[str, ...]:
    """Return the names of the systems that come with the library.

    Examples
    --------
    >>> import dalembert as dal
    >>> "particle" in dal.systems.names()
    True
    """
    return tuple(_lib.string(lib.dal_builtin_name(i)) for i in range(lib.dal_builtin_count()))


def get(name: str, /, **parameters: float) -> System:
    """Return the system of this name, with some parameters changed from their defaults.

    Parameters
    ----------
    name : str
        One of `names`; ``-`` and ``_`` are the same.
    **parameters : float
        As ``System.parameters`` lists them, in the user's units.

    Raises
    ------
    ValueError
        If there is no such system or parameter, or a parameter is out of its range; the text
        lists what there is.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.get("knife-edge").name
    'knife_edge'
    >>> train = dal.systems.get("n-trailer", trailers=10)
    >>> train.n, train.m, train.coordinates[-1]
    (13, 11, 'theta10')
    """
    return System._builtin(name, parameters)


def _maker(name: str) -> Callable[..., System]:
    """Return the function that makes one system; what it says is what the core says."""
    default = get(name)

    def make(**parameters: float) -> System:
        return get(name, **parameters)

    make.__name__ = make.__qualname__ = name
    values = "\n".join(f"{key} : float, default {x:g}" for key, x in default.parameters.items())
    make.__doc__ = (
        f"{default.help}\n\n"
        f"Coordinates: {', '.join(default.coordinates)}.  "
        f"{default.n} coordinates, {default.m} constraints"
        f"{', with an exact solution' if default.has_exact else ''}.\n"
        + (f"\nParameters\n----------\n{values}\n" if values else "")
        + "\nReturns\n-------\nSystem\n"
    )
    make.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=x, annotation=float)
            for key, x in default.parameters.items()
        ],
        return_annotation=System,
    )
    return make


def __getattr__(name: str) -> Callable[..., System]:
    if name not in names():
        raise AttributeError(f"there is no system {name!r}; there are {', '.join(names())}")
    globals()[name] = maker = _maker(name)
    return maker


def __dir__() -> list[str]:
    return [*__all__, *names()]
