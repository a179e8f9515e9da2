"""The growth vector of a D given by functions, from their 16 digits."""

from __future__ import annotations

import contextlib

from ..core import Array, DalembertError, Handle, Pair
from ..core.extras import Show
from ..geometry import Chart
from .search import OUTSIDE, Distribution, Word, brackets, explore

# The derivative along a line by central differences of order 6.
_WEIGHTS = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
_STENCIL = [(sign * k, sign * w) for k, w in _WEIGHTS for sign in (1, -1)]
# The largest and the least distance of the points.
_MOST, _LEAST = 2.0**-3, 2.0**-10
# A bracket of one more field takes 7 times as many points; so many take some seconds.
_ORDERS = 4


class _Functions:
    """mu given by functions, see `search.explore`."""

    digits = 16
    lost = (
        "are lost in the rounding errors of the functions; System.from_sympy computes with more "
        "digits"
    )
    most_there = _ORDERS

    def __init__(self, system: Handle) -> None:
        self.system, self.n, self.m = system, system.n, system.m
        self.most = min(self.m, _ORDERS)

    def point(self, q: Array, is_exact: bool) -> _Point:
        return _Point(self.system, q)


class _Point:
    """Brackets of mu given by functions, at a point, see `search.search`.

    Brackets of k + 1 fields are multiplied by h^k, so their roundoff is the same for all k. Twins
    use another distance h of the differences, so small that the two agree.  Raises DalembertError
    if the rank of mu is below m there, or, from `pair`, if its derivatives do not seem to exist.
    """

    rounding = 2.0**-44

    def __init__(self, system: Handle, q: Array) -> None:
        self.n, self.m = system.n, system.m
        self._chart, self._q, self._h = Chart(system, q), q, _MOST
        self._dependent = [system.coordinates.index(c) for c in self._chart.dependent]

    def pair(self, word: Word) -> Pair:
        """Return the dependent components of a bracket, and their twin by other differences."""
        while self._h >= _LEAST:
            with contextlib.suppress(*OUTSIDE):
                row, twin = (self._row(word, part * self._h) for part in (1.0, 0.8))
                if abs(row - twin).max() <= 64 * self.rounding * max(1, abs(row).max()):
                    return row, twin
            self._h /= 2
        raise DalembertError("mu does not appear to be smooth there")

    def _row(self, word: Word, h: float) -> Array:
        stencil = [(h * step, self._h / h * weight) for step, weight in _STENCIL]
        return brackets(
            lambda q: -self._chart.A(q), self._dependent, self.n, stencil
        )(word, self._q)


def examine(
    system: Handle,
    near: Array,
    q: Array | None = None,
    show: Show = lambda found: None,
) -> Distribution:
    """Return the result of `growth.examine`, to 16 digits."""
    return explore(_Functions(system), near, q, show)[0]
