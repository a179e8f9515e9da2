"""The growth vector of D at a point: the dimensions of D^1 = D, D^2 = D + [D, D], ...

D^{k+1} is D^k + [D, D^k], so brackets of k + 1 fields need k derivatives of mu, and expressions of
them grow beyond measure.  Here they are found as numbers, from motions along D.  For a control u(s)
let q(s), 0 <= s <= 1, solve

    dq/ds = eps X_u(q),    q(0) = q_0,    X_u = sum_i u_i(s) X_i,

where X_1, ..., X_{n-m} span D.  Pulled back to q_0 along it, a field Y of D is the Volterra series

    Y + eps int [X_u, Y] + eps^2 int int [X_u, [X_u', Y]] + ...    at q_0

(A. Agrachev, Y. Sachkov, Control Theory from the Geometric Viewpoint, section 2.4).  So its
coefficient of eps^k is a sum of brackets of k + 1 fields: it lies in D^{k+1}.  Since such brackets
span the Lie algebra, and the iterated integrals of u that stand before them are independent, the
coefficients up to eps^k, for enough controls, span D^{k+1}(q_0).  This holds at every point,
regular or not.  For what the growth vector says see A. Bellaiche, The tangent space in
sub-Riemannian geometry; for cars with trailers F. Jean, The car with N trailers: there it is
(2, 3, ..., n), unless two neighbours stand at right angles, the last two apart.

Controls here are polynomials in s.  While those of a degree have not given all of D^k, a random one
gives a new direction, with probability 1; so the search ends with one that does not.  That the
coefficients for the degree of `degree` span the free Lie algebra, so that nothing is missing
whatever D is, was computed: for degree 2 for brackets of up to 11 fields of two, 7 of three, 6 of
four and 5 of five; for degree 3 of up to 13 of two, 9 of three and 7 of four.
"""

from __future__ import annotations

import functools
import itertools
import random
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from . import _lib
from ._lib import Array

if TYPE_CHECKING:
    from .system import System

__all__ = [
    "Source",
    "Span",
    "degree",
    "integration",
    "is_settled",
    "of_functions",
    "search",
    "shortened",
]

# An entry counts if it is this many times the largest difference to the twins.
_TRUST = 30
# What is left, and does not count, is zero if it is so much smaller than what counted last.
_GAP = 1e-4


def degree(orders: int) -> int:
    """Return the degree of the controls that are needed up to an order of eps."""
    return 2 if orders <= 11 else 3


class Source(Protocol):
    """What finds brackets at a point: see `brackets`."""

    n: int
    m: int
    rounding: tuple[Any, Any]  # of numbers of size 1: relative to its order, and absolute

    def brackets(self, orders: int, seed: int) -> list[Array]:
        """Return for each order of eps the fields pulled back along a motion.

        Shape (n - m, m): a row for each field of D, with its dependent components; the independent
        ones are constants in eps.
        """

    def twins(self, orders: int, seed: int) -> list[Array] | None:
        """Return the same from elsewhere, see `Span`; None if nothing is unknown."""


# ---- dimensions --------------------------------------------------------------------------------


class Span:
    """A space of rows, found by elimination.

    An entry counts if it is larger than what rounding leaves, and than the difference to twins: the
    same rows from elsewhere, which differ from them by what is not known.

    Attributes
    ----------
    columns : list of int
        Those of the pivots.
    least : number
        The smallest pivot so far.
    rest : number
        The largest entry of the rows added last that did not count.
    """

    def __init__(self) -> None:
        self.columns: list[int] = []
        self.least: Any = 1
        self.rest: Any = 0
        self._leads: list[tuple[Array, Array]] = []

    def add(self, rows: Array, twins: Array, rounding: Any) -> None:
        """Add rows; what is at most ``rounding`` does not count."""
        for c, (lead, other) in zip(self.columns, self._leads):
            rows = rows - np.outer(rows[:, c], lead)
            twins = twins - np.outer(twins[:, c], other)
        while True:
            size = abs(rows)
            least = max(rounding, _TRUST * abs(rows - twins).max(initial=0))
            if not (size > least).any():
                break
            r, c = map(int, np.unravel_index(int(np.argmax(size)), size.shape))
            self.least = min(self.least, size[r, c])
            lead, other = rows[r] / rows[r, c], twins[r] / twins[r, c]
            self.columns.append(c)
            self._leads.append((lead, other))
            rows, twins = np.delete(rows, r, axis=0), np.delete(twins, r, axis=0)
            rows = rows - np.outer(rows[:, c], lead)
            twins = twins - np.outer(twins[:, c], other)
        self.rest = size.max(initial=0)


def _dimensions(
    source: Source, levels: Sequence[Array], twins: Sequence[Array]
) -> tuple[list[int], bool]:
    """Return the dimensions of D^1, D^2, ..., and False if the rest could not be told."""
    relative, absolute = source.rounding
    span, found = Span(), [source.n - source.m]
    for rows, other in zip(levels, twins):
        span.add(rows, other, relative * abs(rows).max(initial=0) + absolute)
        if span.rest > _GAP * span.least:
            return found, False
        found.append(found[0] + len(span.columns))
    return found, True


def search(
    source: Source, orders: int, limit: int, enough: Callable[[list[int]], bool]
) -> tuple[list[int], bool]:
    """Return the dimensions of D^1, D^2, ...

    Parameters
    ----------
    source : Source
    orders : int
        With which highest order of eps to begin.
    limit : int
        Where to stop, if the dimensions are not enough by then.
    enough : callable
        Of the dimensions.

    Returns
    -------
    dimensions : list of int
    told : bool
        False if further ones cannot be told from those found.
    """
    count = source.n - source.m
    while True:
        levels, twins = ([np.empty((0, source.m))] * orders for _ in range(2))
        found, told = [count] * (orders + 1), True
        for seed in itertools.count():
            new = source.brackets(orders, seed)
            more, told = _dimensions(source, _joined(levels, new), _joined(twins, new))
            if seed > 0 and more == found:
                break
            levels, twins = _joined(levels, new), _joined(twins, source.twins(orders, seed) or new)
            found, told = _dimensions(source, levels, twins)
        if not told or enough(found) or orders >= limit:
            return found, told
        # as many more orders as are needed if each adds what the last one did
        last = found[-1] - found[-2]
        more_orders = orders if last == 0 else -(-(source.n - found[-1]) // last)
        orders = min(orders + more_orders, limit)


def _joined(one: Sequence[Array], other: Sequence[Array]) -> list[Array]:
    return [np.concatenate(pair) for pair in zip(one, other)]


def is_settled(dimensions: Sequence[int], n: int) -> bool:
    """Return whether no further bracket can add to the dimensions, at a general point."""
    return dimensions[-1] == n or (len(dimensions) > 1 and dimensions[-1] == dimensions[-2])


def shortened(dimensions: Sequence[int], n: int) -> tuple[int, ...]:
    """Return dimensions up to the first that is as the last one, and once more if that is not n.

    Examples
    --------
    >>> from dalembert.growth import shortened
    >>> shortened([2, 3, 4, 4, 5, 5, 5], 5), shortened([2, 3, 4, 4, 4], 5)
    ((2, 3, 4, 4, 5), (2, 3, 4, 4))
    """
    last = dimensions[-1]
    return (*dimensions[: list(dimensions).index(last) + 1], *([last] if last < n else []))


def no_more(dimensions: Sequence[int]) -> str:
    """Return what there is to say where the search has ended before the dimensions have."""
    return f"brackets of more than {len(dimensions)} fields are not formed"


# ---- integrals ---------------------------------------------------------------------------------


def integration(cosines: Array) -> tuple[Array, Array, Array]:
    """Return N + 1 nodes s from 0 to 1, and two matrices.

    Their product maps the values of a polynomial there to its integrals from 0 to each node.  The
    nodes are x = 1 - 2s = cos(pi j/N), j = 0, ..., N; coefficients by Chebyshev polynomials, which
    the second matrix gives, and integrals of those, in the first, are sums of cosines.

    Parameters
    ----------
    cosines : ndarray, shape (2N,)
        cos(pi j/N), numbers of any kind.
    """
    N = len(cosines) // 2
    j = np.arange(N + 1)
    T = cosines[np.outer(np.arange(N + 2), j) % (2 * N)]  # T_i at node j
    half = np.where((j == 0) | (j == N), 1, 2)
    weights = T[: N + 1] * np.outer(half, half) / (2 * N)
    powers = np.empty_like(weights)  # antiderivatives of T_i but for constants
    powers[0], powers[1] = T[1], T[2] / 4
    for i in range(2, N + 1):
        powers[i] = (T[i + 1] / (i + 1) - T[i - 1] / (i - 1)) / 2
    return (1 - T[1]) / 2, ((powers[:, :1] - powers) / 2).T, weights


# ---- from functions ----------------------------------------------------------------------------


# What functions raise for states that they were not made for, and what the core does.
_OUTSIDE = _lib.DalembertError, ArithmeticError, ValueError
_NO_MOTIONS = "the motions along D are no polynomials of their length there"


@functools.lru_cache(maxsize=4)
def _integration(N: int) -> tuple[Array, Array]:
    nodes, integrals, weights = integration(np.cos(np.pi * np.arange(2 * N) / N))
    return nodes, integrals @ weights


class _Functions:
    """Brackets of mu given by functions, at a point, see `Source`.

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
        from .chart import Chart

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


def of_functions(
    system: System, q: Array, at: bool
) -> tuple[tuple[int, ...] | None, tuple[int, ...] | None, str]:
    """Return the growth vector at a point, that at a general one, and what is not known of them.

    Parameters
    ----------
    system : System
        With linear constraints, at least one.
    q : ndarray, shape (n,)
        The point, if ``at``; else the general point is near it.
    at : bool
    """
    n = system.n
    general, note = _near(system, q)
    if not at or general is None:
        return general, general, note
    most = n if note else general[-1]
    try:
        found, told = search(
            _Functions(system, q), 1, _ORDERS, lambda dimensions: dimensions[-1] == most
        )
    except _lib.DalembertError as error:
        return None, general, str(error)
    if not told:
        return tuple(found), general, _lost(found)
    return shortened(found, n), general, "" if found[-1] == most else no_more(found)


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
