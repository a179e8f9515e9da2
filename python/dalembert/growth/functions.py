"""The growth vector of a D that is given by functions, with the 16 digits that they have."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence


import numpy as np

from .. import core
from ..core import Array, Handle, Pair
from ..core.extras import Show
from ..geometry import Chart
from .search import (
    NEARBY, Brackets, Distribution, Growth, Word, at_general_point, at_random, is_larger, nearby,
    no_more, rising, search, shortened,
)  # fmt: skip

# What functions raise for states that they were not made for, and what the core does.
_OUTSIDE = core.DalembertError, ArithmeticError, ValueError
# The derivative along a line by central differences of order 6.
_WEIGHTS = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
_STENCIL = [(sign * k, sign * w) for k, w in _WEIGHTS for sign in (1, -1)]
# The largest and the least distance of the points, and their largest number, for one bracket.
_MOST, _LEAST, _POINTS = 2.0**-3, 2.0**-10, 5_000
_DIGITS = 16


class _Functions:
    """Brackets of mu given by functions, at a point, see `search`.

    Those of k + 1 fields are given times h^k, so that their roundoff is the same for all k.  Twins
    have another distance h of the differences; it is taken so small that the two agree.

    Raises
    ------
    DalembertError
        If mu has not rank m there; by `pair`, if its derivatives do not seem to exist.
    """

    rounding = 2.0**-44

    def __init__(self, system: Handle, q: Array) -> None:
        self.n, self.m = system.n, system.m
        self._chart, self._q, self._h = Chart(system, q), q, _MOST
        self._dependent = [system.coordinates.index(c) for c in self._chart.dependent]
        # a bracket of one more field takes 7 times as many points
        self.most = int(np.log(_POINTS) / np.log(7))

    def pair(self, word: Word) -> Pair:
        """Return the dependent components of a bracket, and the same by other differences."""
        while self._h >= _LEAST:
            with contextlib.suppress(*_OUTSIDE):
                row, twin = (self._row(word, part * self._h) for part in (1.0, 0.8))
                if abs(row - twin).max() <= 64 * self.rounding * max(1, abs(row).max()):
                    return row, twin
            self._h /= 2
        raise core.DalembertError("mu does not seem to be smooth there")

    def _row(self, word: Word, h: float) -> Array:
        stencil = [(h * step, self._h / h * weight) for step, weight in _STENCIL]
        brackets = Brackets(lambda q: -self._chart.A(q), self._dependent, self.n, stencil)
        return brackets.at(word, self._q)[self._dependent]


def examine(
    system: Handle,
    near: Array,
    q: Array | None = None,
    show: Show = lambda found: None,
) -> Distribution:
    """Return what `growth.examine` does; the general point is one near ``near``."""
    n, m = system.n, system.m
    general, note = _near(system, near, rising(show))
    show(m)
    if q is None or general is None:
        return Distribution(general, general, note, _is_integrable(general), _DIGITS)
    most = n if note or general[-1] == general[0] else general[-1]
    try:
        point = _Functions(system, q)
        found, _, told = search(
            point, at_random(n - m), point.most, lambda dimensions: dimensions[-1] >= most,
            lambda k: show(m + k),
        )  # fmt: skip
    except core.DalembertError as error:
        return Distribution(None, general, str(error), _is_integrable(general), _DIGITS)
    here = shortened(found, n) if told else tuple(found)
    lacks = _lost(found) if not told else "" if found[-1] >= general[-1] else no_more(found)
    if is_larger(here, general):  # mu is given in pieces
        general = here
    return Distribution(here, general, lacks, _is_integrable(general), _DIGITS)


def _is_integrable(general: Growth | None) -> bool | None:
    """Return what a growth vector tells of that, if it does."""
    return general[0] == general[1] if general is not None and len(general) > 1 else None


def _near(system: Handle, q: Array, show: Show) -> tuple[Growth | None, str]:
    """Return the growth vector at a general point near q, and what is not known of it.

    The largest of some, for functions may be given in pieces.
    """
    best, note = None, ""
    for size in (*NEARBY, 0.0):
        for k in range(1, 5 if size else 2):
            try:
                point = _Functions(system, nearby(q, size, k))
                grown, _, told, settled = at_general_point(point, min(system.m, point.most), show)
            except _OUTSIDE as error:
                note = note or str(error)
                continue
            if best is None or is_larger(grown, best):
                best = grown
                note = "" if settled else no_more(grown) if told else _lost(grown)
            if grown[-1] == system.n or not settled:
                return best, note
        if best is not None:
            break
    return best, note


def _lost(found: Sequence[int]) -> str:
    return (
        f"brackets of {len(found) + 1} fields are lost in the rounding errors of functions; "
        "System.from_sympy has more digits"
    )
