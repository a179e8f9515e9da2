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

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._lib import Array

__all__ = [
    "Distribution", "Span", "degree", "integration", "is_settled", "no_more", "search", "shortened",
]  # fmt: skip

# An entry counts if it is this many times the largest difference to the twins.
_TRUST = 30
# What is left, and does not count, is zero if it is so much smaller than what counted last.
_GAP = 1e-4


@dataclass(frozen=True)
class Distribution:
    """What is found of D; see `dalembert.Check`."""

    growth: tuple[int, ...] | None
    general_growth: tuple[int, ...] | None
    growth_note: str
    integrable: bool | None  # None: not known
    digits: int
    holonomic: tuple[str, ...] = ()
    exact: bool = False


def degree(orders: int) -> int:
    """Return the degree of the controls that are needed up to an order of eps."""
    return 2 if orders <= 11 else 3


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
    source: Any, levels: Sequence[Array], twins: Sequence[Array]
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
    source: Any, orders: int, limit: int, enough: Callable[[list[int]], bool]
) -> tuple[list[int], bool]:
    """Return the dimensions of D^1, D^2, ...

    Parameters
    ----------
    source
        With sizes n and m, and ``rounding`` of numbers of size 1: relative to its order, and
        absolute.  For orders of eps and the seed of a motion, ``brackets(orders, seed)`` gives a
        list of the fields pulled back along it, shape (n - m, m): a row for each field of D, with
        its dependent components; the independent ones are constants in eps.  ``twins(orders,
        seed)`` gives the same from elsewhere, see `Span`, or None if nothing is unknown.
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
    >>> from dalembert.growth.search import shortened
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
