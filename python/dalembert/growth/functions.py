"""The growth vector of a D that is given by functions, with the 16 digits that they have."""

from __future__ import annotations

import functools
import itertools
import random
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .. import _lib
from .._lib import Array
from .search import Distribution, degree, integration, is_settled, no_more, search, shortened

if TYPE_CHECKING:
    from ..system import System

__all__ = ["examine"]

# What functions raise for states that they were not made for, and what the core does.
_OUTSIDE = _lib.DalembertError, ArithmeticError, ValueError
_NO_MOTIONS = "the motions along D are no polynomials of their length there"


@functools.lru_cache(maxsize=4)
def _integration(N: int) -> tuple[Array, Array]:
    nodes, integrals, weights = integration(np.cos(np.pi * np.arange(2 * N) / N))
    return nodes, integrals @ weights


class _Functions:
    """Brackets of mu given by functions, at a point, see `search`.

    Those of two fields follow from the derivatives of mu.  For more, motions are computed for some
    eps between -h and h, and the fields pulled back along them are polynomials in eps, up to
    roundoff; h is taken so small that this is so.  A smaller h makes the twins.

    Parameters
    ----------
    system : System
        With linear constraints.
    q : ndarray, shape (n,)

    Raises
    ------
    DalembertError
        If mu has not rank m there; by `brackets`, if there are no such polynomials.
    """

    _NODES = 24  # in s; the velocities there are polynomials up to roundoff

    def __init__(self, system: System, q: Array) -> None:
        from ..chart import Chart

        self.n, self.m = system.n, system.m
        self._chart, self._q, self._h = Chart(system, q), q, 1.0
        names = system.coordinates
        self._dependent = [names.index(c) for c in self._chart.dependent]
        self._independent = [names.index(c) for c in self._chart.independent]
        # derivatives that are differenced have 9 digits at least
        self._error = 1e-9 if "forms_velocity_derivative" in system.differenced else 2.0**-46
        self.rounding = self._error, self._error

    def brackets(self, orders: int, seed: int) -> list[Array]:
        """Return for each order of eps / h the fields pulled back; or all brackets of two."""
        if orders == 1:
            return [self._commutators(self._q)]
        while self._h > 1e-4:
            found = self._polynomials(self._h, orders, seed)
            if found is not None:
                return found
            self._h /= 2
        raise _lib.DalembertError(_NO_MOTIONS)

    def twins(self, orders: int, seed: int) -> list[Array]:
        """Return the same by shorter motions; or from a point at the distance of rounding."""
        if orders == 1:
            away = 2.0**-52 * np.maximum(1, abs(self._q)) * np.cos(np.arange(self.n))
            return [self._commutators(self._q + away)]
        part = 0.8
        found = self._polynomials(self._h * part, orders, seed)
        if found is None:
            raise _lib.DalembertError(_NO_MOTIONS)
        return [rows / part ** (k + 1) for k, rows in enumerate(found)]

    def _commutators(self, q: Array) -> Array:
        """Return the dependent components of [X_i, X_j] for i < j, one row each."""
        n, unit = self.n, np.eye(self.n - self.m)
        J = self._chart.jacobian(np.hstack([np.tile(q, (len(unit), 1)), unit]))
        slope, X = J[:, n:, :n][:, self._dependent], J[0, n:, n:]
        pairs = list(itertools.combinations(range(len(unit)), 2))
        rows = [slope[j] @ X[:, i] - slope[i] @ X[:, j] for i, j in pairs]
        return np.reshape(rows, (-1, self.m))

    def _polynomials(self, h: float, orders: int, seed: int) -> list[Array] | None:
        """Return the coefficients of the fields pulled back; None if h is too large."""
        source = random.Random(seed)
        s, _ = _integration(self._NODES)
        controls = np.zeros((len(s), len(self._independent)))
        for _ in range(degree(orders) + 1):  # Horner
            controls *= s[:, np.newaxis]
            controls += [source.uniform(-1, 1) for _ in self._independent]
        count = 2 * orders + 14
        x = np.cos(np.pi * np.arange(count + 1) / count)
        pulled = np.empty((count + 1, self.m, controls.shape[1]))
        try:
            for i, eps in enumerate(h * x):
                motion = self._motion(eps, controls)
                found = None if motion is None else self._pull_back(eps, motion, controls)
                if found is None:
                    return None
                pulled[i] = found
        except _OUTSIDE:
            return None
        series = np.polynomial.chebyshev.chebfit(x, pulled.reshape(count + 1, -1), count)
        if abs(series[-2:]).max() > 4 * self._error * abs(series).max():
            return None
        powers = np.zeros((orders + 1, count + 1))  # of the Chebyshev polynomials
        for k in range(count + 1):
            column = np.polynomial.chebyshev.cheb2poly([0] * k + [1])[: orders + 1]
            powers[: len(column), k] = column
        found = (powers @ series).reshape(-1, *pulled.shape[1:])
        return [rows.T for rows in found[1:]]

    def _motion(self, eps: float, controls: Array) -> Array | None:
        """Return q at the nodes; None if the iteration does not converge."""
        _, integral = _integration(self._NODES)

        def picard(q: Array) -> Array:
            _, v = self._chart.lift(np.hstack([q, controls]))
            return self._q + eps * integral @ v

        return _iterate(picard, np.tile(self._q, (len(controls), 1)))

    def _pull_back(self, eps: float, q: Array, controls: Array) -> Array | None:
        """Solve dZ/ds = eps dX_u/dq Z from the end of a motion, where Z are the fields of D."""
        n, dependent = self.n, self._dependent
        J = self._chart.jacobian(np.hstack([q, controls]))
        slope, end = J[:, n:, :n], J[-1, n:, n:]
        _, integral = _integration(self._NODES)
        to_end = integral[-1] - integral

        def picard(Z: Array) -> Array:
            return end - eps * np.tensordot(to_end, slope @ Z, 1)

        found = _iterate(picard, np.tile(end, (len(q), 1, 1)))
        return None if found is None else found[0, dependent]


def _iterate(function: Callable[[Array], Array], x: Array) -> Array | None:
    """Return the fixed point of a function, to roundoff; None if it is not found."""
    for _ in range(60):
        before, x = x, function(x)
        if not np.isfinite(x).all():
            break
        if abs(x - before).max() <= 4 * np.finfo(float).eps * (1 + abs(x).max()):
            return x
    return None


# As many orders as are left of 16 digits in general.
_ORDERS = 7
_DIGITS = 16


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
        found, told = search(
            _Functions(system, q), 1, _ORDERS, lambda dimensions: dimensions[-1] == most
        )
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
            found, told = search(
                _Functions(system, place), 1, min(system.m, _ORDERS),
                lambda dimensions: is_settled(dimensions, n),
            )  # fmt: skip
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
