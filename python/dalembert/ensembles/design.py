"""Designs: the values of parameters in an ensemble."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..core import Array, arguments, extras
from ..core.documentation import Common

_METHODS = {"sobol": "Sobol", "halton": "Halton", "lhs": "LatinHypercube"}


class Design(Mapping[str, Array]):
    """Values by name, arrays of one shape, for the ``parameters`` of `dalembert.ensemble`.

    Attributes
    ----------
    shape : tuple of int
        Shape of each array; its product is the number of members.
    axes : tuple of str
        Names of the axes: the names in a grid, or "member".
    """

    def __init__(self, values: Mapping[str, Array], axes: tuple[str, ...]) -> None:
        self._values = dict(values)  # an axis along which one does not change has length 1
        self.axes = axes
        self.shape = np.broadcast_shapes(*(x.shape for x in self._values.values()))

    def __getitem__(self, name: str) -> Array:
        return np.broadcast_to(self._values[name], self.shape)

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def compact(self, name: str) -> Array:
        """Return the values of a name, with length 1 along axes on which they are constant."""
        return self._values[name]

    def __repr__(self) -> str:
        parts = [f"{name}: {x.min():g} .. {x.max():g}" for name, x in self._values.items()]
        return f"<Design of shape {self.shape}; {', '.join(parts)}>"


def grid(**values: ArrayLike) -> Design:
    """Return all combinations of values.

    Parameters
    ----------
    **values : array_like, shape (N,)
        The values of each name.

    Returns
    -------
    Design
        A mapping from names to arrays with an axis for each name, in their order.

    Raises
    ------
    ValueError
        If there are no values, or if they are not finite numbers in one dimension.

    Examples
    --------
    >>> import dalembert as dal
    >>> design = dal.grid(a=[0.1, 0.2, 0.3], J=[1, 2])
    >>> design.shape
    (3, 2)
    >>> design["J"]
    array([[1., 2.],
           [1., 2.],
           [1., 2.]])
    """
    if not values:
        raise ValueError(
            "grid() has no arguments: expected names with values, for example grid(a=[0.1, 0.2])"
        )
    rows = {name: arguments.array(given, name, (None,)) for name, given in values.items()}
    for name, row in rows.items():
        if len(row) == 0:
            raise ValueError(f"{name}: expected at least one value")
    count = len(rows)
    found = {
        name: row.reshape([-1 if k == axis else 1 for k in range(count)])
        for axis, (name, row) in enumerate(rows.items())
    }
    return Design(found, tuple(rows))


@Common("ValueError, ImportError")
def sample(count: int, *, seed: int = 0, method: str = "sobol", **ranges: Any) -> Design:
    """Return values that fill ranges evenly, from a quasi-random sequence of ``scipy.stats.qmc``.

    Parameters
    ----------
    count : int
        Number of values; for "sobol" preferably a power of 2.
    seed : int, optional
        The same seed gives the same values.
    method : {"sobol", "halton", "lhs"}, optional
        The sequence, scrambled; "lhs" is Latin hypercube sampling.
    **ranges : pair of float, or distribution
        For each name the smallest and the largest value, or a distribution of ``scipy.stats`` such
        as ``norm(1, 0.1)``.

    Returns
    -------
    Design
        A mapping from names to arrays of shape (count,).

    Examples
    --------
    >>> import dalembert as dal
    >>> design = dal.sample(8, seed=1, a=(0.1, 0.2), J=(1, 3))
    >>> design.shape, bool((design["J"] >= 1).all() and (design["J"] <= 3).all())
    ((8,), True)
    """
    count = arguments.integer(count, "count", 1)
    arguments.choice(method, "method", dict.fromkeys(_METHODS, 0))
    if not ranges:
        raise ValueError(
            "sample() has no ranges: expected names with ranges, for example sample(100, "
            "a=(0.1, 0.2))"
        )
    qmc = extras.require("scipy.stats.qmc", "sample")
    sequence = getattr(qmc, _METHODS[method])(len(ranges), seed=arguments.integer(seed, "seed", 0))
    power = (count - 1).bit_length()
    # of Sobol's points all powers of 2 are balanced, and others would be warned of
    points = sequence.random(1 << power if method == "sobol" else count)[:count]
    found = {}
    for name, column in zip(ranges, points.T):
        given = ranges[name]
        if hasattr(given, "ppf"):
            values = np.asarray(given.ppf(column), dtype=float)
        else:
            low, high = arguments.array(given, name, (2,))
            if low > high:
                raise ValueError(f"{name} = {arguments.shown(given)}: expected (least, largest)")
            values = low + (high - low) * column
        found[name] = arguments.array(values, name, (count,))
    return Design(found, ("member",))
