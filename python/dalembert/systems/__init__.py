"""The systems of the library, one function for each.

``dal.systems.names()`` lists the systems written in C. ``dal.systems.names_in_sympy()`` lists those
that need SymPy, see `dalembert.systems.catalogue`.  ``dal.systems.particle()`` returns a system,
and ``help(dal.systems.disk)`` shows the coordinates and parameters of another.

>>> import dalembert as dal
>>> ball = dal.systems.ball_on_table(Omega=2)  # affine constraints
>>> ball.coordinates
('x', 'y', 'theta_x', 'theta_y', 'theta_z')
>>> ball.parameters["Omega"], dal.systems.rolling_disc(m=2, g=0).parameters["m"]
(2.0, 2.0)
>>> dal.systems.snakeboard(J0=1)
Traceback (most recent call last):
    ...
ValueError: parameters m = 1, r = 0.5, J0 = 1 of snakeboard: expected m r^2 > J0, but m r^2 is 0.25
"""

from __future__ import annotations

import functools
import importlib.resources
import inspect
import json
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .. import core
from ..core import arguments, lib
from ..system import BuiltIn, System, require_parameters
from . import catalogue

__all__ = ["KnownState", "get", "known_states", "names", "names_in_sympy", "plain_name"]


def names() -> tuple[str, ...]:
    """Return the names of the systems written in C, which are always available.

    Examples
    --------
    >>> import dalembert as dal
    >>> "particle" in dal.systems.names()
    True
    """
    return tuple(core.string(lib.dal_builtin_name(i)) for i in range(lib.dal_builtin_count()))


def names_in_sympy() -> tuple[str, ...]:
    """Return the names of the systems written in SymPy, which need it installed.

    Examples
    --------
    >>> import dalembert as dal
    >>> "roller_racer" in dal.systems.names_in_sympy()
    True
    """
    return tuple(catalogue.__all__)


def get(name: str, /, **parameters: float) -> System:
    """Return the system of this name with the given values of parameters.

    Parameters
    ----------
    name : str
        One of `names` or `names_in_sympy`; ``-`` and ``_`` are equivalent.
    **parameters : float
        Parameters as in ``System.parameters``, in the user's units.  Default: those of the system.

    Raises
    ------
    ValueError
        If there is no such system or parameter, or a parameter is out of range.  The message lists
        the names.
    ImportError
        If the system is written in SymPy and SymPy is not installed.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.get("knife-edge").name
    'knife_edge'
    >>> train = dal.systems.get("n-trailer", trailers=10)
    >>> train.n, train.m, train.coordinates[-1]
    (13, 11, 'theta10')
    """
    plain = plain_name(name)
    if plain not in names_in_sympy():
        default = System._of(BuiltIn(plain, {}))
        require_parameters(plain, parameters, default.parameters)
        return System._of(BuiltIn(plain, parameters)) if parameters else default
    make: Callable[..., System] = getattr(catalogue, plain)
    require_parameters(plain, parameters, inspect.signature(make).parameters)
    return make(**parameters)


@dataclass(frozen=True)
class KnownState:
    """A state known to 30 digits.

    Attributes
    ----------
    t : float
        Time since the start.
    q, v : tuple of str
        The n coordinates and velocities, as decimal numbers.
    """

    t: float
    q: tuple[str, ...]
    v: tuple[str, ...]


def known_states(name: str) -> tuple[KnownState, ...]:
    """Return states of a system with its default parameters and data, known to 30 digits.

    Two methods computed them, see ``tests/data/make_references.py``.  Parameters and data are exact
    decimals: a = 0.4 is 2/5.

    Parameters
    ----------
    name : str
        One of `names` or `names_in_sympy`; ``-`` and ``_`` are equivalent.

    Returns
    -------
    tuple of KnownState
        The states at t = 0, 1 and 10.

    Raises
    ------
    ValueError
        If there is no such system.

    Examples
    --------
    >>> import dalembert as dal
    >>> start, one, ten = dal.systems.known_states("cvt")
    >>> one.q[0]
    '0.937266465602263978857429501611'
    """
    plain = plain_name(name)
    return tuple(
        KnownState(float(t), tuple(state["q"]), tuple(state["v"]))
        for t, state in _references()[plain].items()
    )


@functools.cache
def _references() -> dict[str, dict[str, dict[str, list[str]]]]:
    text = importlib.resources.files(__package__).joinpath("references.json").read_text("ascii")
    return json.loads(text)  # type: ignore[no-any-return]


def plain_name(name: str) -> str:
    """Return the name of a system as in `names` or `names_in_sympy`: with _ for -.

    Raises
    ------
    ValueError
        If there is no such system.  The message lists the names.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.plain_name("knife-edge")
    'knife_edge'
    """
    plain = name.replace("-", "_") if isinstance(name, str) else name
    there = [*names(), *names_in_sympy()]
    if plain not in there:
        raise ValueError(_no_system(name, there))
    return plain


def _no_system(name: Any, there: list[str]) -> str:
    meant = arguments.suggestion(name, there)
    return f"there is no system {arguments.shown(name)}; {meant}choose one of: {', '.join(there)}"


def _maker(name: str) -> Callable[..., System]:
    """Return the function that creates a system, with a docstring from the texts in C."""
    default = get(name)

    def make(**parameters: float) -> System:
        return get(name, **parameters)

    make.__name__ = make.__qualname__ = name
    values = "\n".join(f"{key} : float, default {x:g}" for key, x in default.parameters.items())
    formulas = "\n".join(f"    {line}" for line in default.formulas)
    make.__doc__ = (
        f"{default.help}\n\n{textwrap.fill(default.description, 96)}\n\n"
        f"Coordinates {', '.join(default.coordinates)}; {default.m} constraint"
        f"{'s' * (default.m > 1)}"
        f"{', with an exact solution' if default.has_exact else ''}::\n\n{formulas}\n"
        + (f"\nParameters\n----------\n{values}\n" if values else "")
        + "\nReturns\n-------\nSystem\n"
        + f"\nReferences\n----------\n{textwrap.fill(default.source, 96)}\n"
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
    if name in names_in_sympy():
        return getattr(catalogue, name)  # type: ignore[no-any-return]
    if name not in names():
        raise AttributeError(_no_system(name, [*names(), *names_in_sympy()]))
    globals()[name] = maker = _maker(name)
    return maker


def __dir__() -> list[str]:
    return [*__all__, *names(), *names_in_sympy()]
