"""The growth vector of a D that is given by functions, with the 16 digits that they have."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .. import _lib
from .._lib import Array
from .search import Distribution, is_settled, no_more, search, shortened

if TYPE_CHECKING:
    from ..system import System

__all__ = ["examine"]

# What functions raise for states that they were not made for, and what the core does.
_OUTSIDE = _lib.DalembertError, ArithmeticError, ValueError
# The derivative along a line by central differences of order 8, h apart; for no more points in all.
_WEIGHTS = ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280))
_POINTS = 20_000
# Derivatives that are differenced over 2^-12 smooth out what is not smooth.
_LEAST = 2.0**-10
_DIGITS = 16


class _Functions:
    """Brackets of mu given by functions, at a point, see `search`.

    X_i, i = 1, ..., c, are the fields of D with a unit vector in the place of the independent
    velocities.  [X_i, X_j] follows from the derivatives of mu, and

        [X_i, W] = dW/dq X_i - dX_i/dq W

    for a bracket W of them by differences of W along X_i.  Those of k + 1 fields are given times
    h^(k-1), so that their roundoff is the same for all k.  Twins have another distance h of the
    differences; it is taken so small that the two agree up to roundoff.

    Raises
    ------
    DalembertError
        If mu has not rank m there; by `brackets`, if its derivatives do not seem to exist.
    """

    def __init__(self, system: System, q: Array) -> None:
        from ..chart import Chart

        self.n, self.m = system.n, system.m
        self.most = 1  # orders that are not too many points
        while 8**self.most * (self.n - self.m) ** (self.most + 1) <= _POINTS:
            self.most += 1
        self._chart, self._q, self._h = Chart(system, q), q, 0.125
        self._dependent = [system.coordinates.index(c) for c in self._chart.dependent]
        # derivatives that are differenced have 9 digits at least
        self._error = 1e-9 if "forms_velocity_derivative" in system.differenced else 2.0**-46
        self.rounding = self._error, self._error

    def brackets(self, orders: int, seed: int) -> list[Array]:
        """Return for each order all left-normed brackets; they do not depend on the seed."""
        if seed > 0:
            return self._found
        while self._h >= _LEAST:
            with contextlib.suppress(*_OUTSIDE):
                found, twins = self._rows(orders, 1.0), self._rows(orders, 0.8)
                off = max(abs(a - b).max(initial=0) for a, b in zip(found, twins))
                size = max(1, *(abs(a).max(initial=0) for a in found))
                if off <= 64 * self._error * size:
                    self._found, self._twins = found, twins
                    return found
            self._h /= 2
        raise _lib.DalembertError("mu does not seem to be smooth there")

    def twins(self, orders: int, seed: int) -> list[Array]:
        """Return the same by other differences."""
        return self._twins

    def _rows(self, orders: int, part: float) -> list[Array]:
        values = self._levels(self._q[np.newaxis], orders, part * self._h)
        return [
            value[0][:, self._dependent] * self._h**k for k, value in enumerate(values[1:])
        ]

    def _levels(self, q: Array, orders: int, h: float) -> list[Array]:
        """Return at points q, shape (P, n), the fields and their brackets, shapes (P, words, n)."""
        unit = np.eye(self.n - self.m)
        c = len(unit)
        J = self._chart.jacobian(np.hstack([np.repeat(q, c, 0), np.tile(unit, (len(q), 1))]))
        slope = J[:, self.n :, : self.n].reshape(len(q), c, self.n, self.n)
        X = J.reshape(len(q), c, 2 * self.n, -1)[:, 0, self.n :, self.n :].swapaxes(1, 2)
        pairs = list(itertools.combinations(range(c), 2))
        turned = np.einsum("pjab,pib->pija", slope, X)  # dX_j/dq X_i
        first = [turned[:, i, j] - turned[:, j, i] for i, j in pairs]
        levels = [X, np.reshape(first, (len(pairs), len(q), self.n)).swapaxes(0, 1)]
        if orders == 1:
            return levels
        steps = np.array([sign * k * h for k, _ in _WEIGHTS for sign in (1, -1)])
        weights = np.array([sign * w / h for _, w in _WEIGHTS for sign in (1, -1)])
        places = q[:, None, None] + steps[:, None] * X[:, :, None]  # (P, c, 8, n)
        around = self._levels(places.reshape(-1, self.n), orders - 1, h)
        for k in range(1, orders):
            beside = around[k].reshape(len(q), c, len(steps), -1, self.n)
            along = np.einsum("s,piswa->piwa", weights, beside)
            turned = np.einsum("piab,pwb->piwa", slope, levels[k])
            levels.append((along - turned).reshape(len(q), -1, self.n))
        return levels


def examine(system: System, near: Array, q: Array | None = None) -> Distribution:
    """Return the growth vector at a general point near some point, and at a given one.

    Parameters
    ----------
    system : System
        With linear constraints, at least one.
    near : ndarray, shape (n,)
    q : ndarray, shape (n,), optional
        Default: at the general point.
    """
    n = system.n
    general, note = _near(system, near)
    integrable = None
    if general is not None and len(general) > 1:
        integrable = general[0] == general[1]
    if q is None or general is None:
        return Distribution(general, general, note, integrable, _DIGITS)
    most = n if note else general[-1]
    try:
        point = _Functions(system, q)
        found, told = search(point, 1, point.most, lambda dimensions: dimensions[-1] == most)
    except _lib.DalembertError as error:
        return Distribution(None, general, str(error), integrable, _DIGITS)
    here = shortened(found, n) if told else tuple(found)
    lacks = _lost(found) if not told else "" if found[-1] == most else no_more(found)
    return Distribution(here, general, lacks, integrable, _DIGITS)


def _near(system: System, q: Array) -> tuple[tuple[int, ...] | None, str]:
    """Return the growth vector at a general point near q, and what is not known of it."""
    n = system.n
    message = ""
    for size in (0.1, 0.01, 0.001, 0.0):
        place = q + size * (1 + abs(q)) * np.cos(np.arange(1, n + 1))
        try:
            point = _Functions(system, place)
            found, told = search(
                point, 1, min(system.m, point.most), lambda dimensions: is_settled(dimensions, n)
            )
        except _OUTSIDE as error:
            message = str(error)
            continue
        if is_settled(found, n):
            return shortened(found, n), ""
        return tuple(found), no_more(found) if told else _lost(found)
    return None, message


def _lost(found: Sequence[int]) -> str:
    return (
        f"brackets of {len(found) + 1} fields are lost in the rounding errors of functions; "
        "System.from_sympy has more digits"
    )
