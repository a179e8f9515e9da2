"""The growth vector of D at a point: the dimensions of D^1 = D, D^2 = D + [D, D], ...

D^{k+1} = D^k + [D, D^k] is spanned by the brackets [X_a, [X_b, ... [X_y, X_z]]] of up to k + 1
fields.  A field X_u of D has the constant independent velocities u, so a bracket has dependent
components only.  The formula

    [X_u, W] = dW/dq X_u - dX_u/dq W

needs derivatives along lines only, which are computed by differences.

At a general point only the brackets that are new in D^k have to be bracketed again.  At other
points all matter, and u, ..., z are random.  While D^{k+1} is incomplete, a random bracket adds to
it with probability 1, because its coefficients are polynomials in u, ..., z.

For the meaning of the growth vector see A. Bellaiche, The tangent space in sub-Riemannian geometry.
For cars with trailers see F. Jean, The car with N trailers: it is (2, 3, ..., n), unless two
neighbours other than the last two are at right angles.
"""

from __future__ import annotations

import functools
import itertools
import random
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core import Array, DalembertError
from ..core.extras import Show

# An entry counts if it is this many times the difference to its twin.
_TRUST = 30
# What does not count is zero if it is so much smaller than what counted last.
_GAP = 1e-4

# General points are sought at such distances from a state, as the curvature is by the core.
_NEARBY = (0.1, 0.01, 0.001)

# What functions raise for states that they were not made for, and what the core does.
OUTSIDE = DalembertError, ArithmeticError, ValueError

# Independent velocities of the fields of a bracket, the outermost first.
Word = tuple[tuple[float, ...], ...]

# The dimensions of D^1, D^2, ...
Growth = tuple[int, ...]


@dataclass(frozen=True)
class Distribution:
    """The results about D; see `dalembert.Check`."""

    growth: Growth | None
    general_growth: Growth | None
    growth_note: str
    integrable: bool | None  # None: not known
    digits: int
    holonomic: tuple[str, ...] = ()
    exact: bool = False


def brackets(
    fields: Callable[[Any], Array], dependent: Sequence[int], n: int, stencil: Any
) -> Callable[[Word, Any], Array]:
    """Return a function of a word and a point: the dependent components of a bracket.

    ``fields(q)`` is S, shape (m, n - m), with v_dependent = S u on D.  The stencil has steps and
    weights of the difference along a line.  Results are cached, because many words have parts in
    common.
    """
    rows = list(dependent)
    independent = [i for i in range(n) if i not in rows]
    fields = functools.cache(fields)

    @functools.cache
    def at(word: Word, q: tuple[Any, ...]) -> Array:
        head, rest = word[:1], word[1:]
        if rest:
            W, X = at(rest, q), at(head, q)
            return along(rest, q, X) - along(head, q, W)
        S = fields(q)
        X = np.zeros(n, dtype=S.dtype)
        X[independent] = head[0]
        X[rows] = S @ np.array(head[0])
        return X

    def along(word: Word, q: tuple[Any, ...], direction: Array) -> Array:
        """Return the derivative of a bracket along a line."""
        return sum(weight * at(word, tuple(q + step * direction)) for step, weight in stencil)

    return lambda word, q: at(word, tuple(q))[rows]


class _Span:
    """Rows after elimination; a row differs from its twin by its uncertainty."""

    def __init__(self) -> None:
        self._least: Any = 1
        self._leads: list[tuple[int, Array, Array]] = []

    def add(self, row: Array, twin: Array, rounding: Any) -> bool | None:
        """Return whether a row adds to the space, None if that cannot be decided."""
        rounding = rounding * max(1, abs(row).max())
        for c, lead, other in self._leads:
            row, twin = row - row[c] * lead, twin - twin[c] * other
        c = int(np.argmax(abs(row)))
        size = abs(row[c])
        if size > max(rounding, _TRUST * abs(row - twin).max()):
            self._least = min(self._least, size)
            self._leads.append((c, row / row[c], twin / twin[c]))
            return True
        return False if max(size, abs(twin).max()) <= _GAP * self._least else None


def search(
    point: Any,
    most: int,
    show: Show = lambda added: None,
    least: int = 0,
    is_general: bool = True,
) -> tuple[Growth, bool]:
    """Return the dimensions of D^1, D^2, ..., and False if rounding hides further ones.

    ``point`` has the sizes n and m, the ``rounding`` of numbers of size 1, and ``pair(word)``.  The
    last is the dependent components of a bracket, shape (m,), and their twin, see `_Span`.  The
    search ends after ``most`` orders, or when the dimensions are settled and at least ``least``.
    ``show`` is called with the number of added dimensions.
    """
    n, count = point.n, point.n - point.m
    span, dimensions, words = _Span(), [count], list[Word]()
    for k in range(2, most + 2):
        candidates = _of_new_ones(count, words) if is_general else _at_random(count, k)
        grown, words = dimensions[-1], []
        for word in candidates:
            counts = span.add(*point.pair(word), point.rounding)
            if counts is None:
                return tuple(dimensions), False
            if counts:
                grown += 1
                words.append(word)
                show(grown - count)
            if grown == n or not (counts or is_general):
                break
        dimensions.append(grown)
        if is_settled(dimensions, n) and grown >= least:
            break
    return tuple(dimensions), True


def _of_new_ones(count: int, last: Sequence[Word]) -> Iterable[Word]:
    """Return the brackets to try at a general point, of ``count`` fields and the last new ones."""
    source = random.Random(1)
    fields = [
        tuple((i == j) + source.uniform(-0.3, 0.3) for j in range(count)) for i in range(count)
    ]
    if last:
        return [(u, *word) for word in last for u in fields]
    return itertools.combinations(fields, 2)


def _at_random(count: int, length: int) -> Iterator[Word]:
    """Yield random brackets to try at any point, until one adds nothing new."""
    source = random.Random(2)
    while True:
        yield tuple(tuple(source.uniform(-1, 1) for _ in range(count)) for _ in range(length))


def explore(
    source: Any, near: Array, q: Array | None, show: Show
) -> tuple[Distribution, list[Any]]:
    """Return the results about D, see `growth.examine`, and the points with computed brackets.

    The source has the sizes n and m, its ``digits``, and ``point(q, is_exact)`` for `search`.  It
    also has the numbers of orders ``most`` at a general point and ``most_there`` at q.  Its
    ``lost`` is the message for brackets not distinguishable from 0.
    """
    n, m, show = source.n, source.m, _rising(show)
    points, general, note = _general(source, near, show)
    if general is None:
        return Distribution(None, None, note, None, source.digits), points
    show(m)
    here: Growth | None = general
    if q is not None:

        def at_q(added: int) -> None:
            show(m + added)

        try:
            points.append(source.point(q, False))
            here, note = _look(source, points[-1], source.most, at_q)
            if here != general:
                most, least = source.most_there, general[-1]
                here, note = _look(source, points[-1], most, at_q, least, is_general=False)
            general = max(general, here, key=_size)  # q may lie in another region
        except OUTSIDE as error:
            here, note = None, str(error)
    integrable = None
    if is_settled(general, n) or general[-1] > n - m:
        integrable = general[-1] == n - m
    return Distribution(here, general, note, integrable, source.digits), points


def _general(source: Any, near: Array, show: Show) -> tuple[list[Any], Growth | None, str]:
    """Return general points, the largest growth vector at them, and its reservation.

    One point is not sufficient for functions that vanish nearly everywhere, or are piecewise.
    """
    points, best, note, lack = list[Any](), (), "", ""
    for places, is_exact in _places(near):
        for place in places:
            try:
                point = source.point(place, is_exact)
                found, said = _look(source, point, source.most, show)
            except OUTSIDE as error:
                lack = lack or str(error)
                continue
            points.append(point)
            if _size(found) > _size(best):
                best, note = found, said
            if found[-1] == source.n or said:
                break
        if points:
            return points, best, note
    return points, None, f"found no point where mu can be examined: {lack}"


def _look(
    source: Any, point: Any, most: int, show: Show, least: int = 0, is_general: bool = True
) -> tuple[Growth, str]:
    """Return the growth vector at a point, see `search`, and a reservation about it."""
    found, told = search(point, most, show, least, is_general)
    note = ""
    if not told:
        note = f"brackets of {len(found) + 1} fields {source.lost}"
    elif found[-1] < least or not is_settled(found, source.n):
        note = f"brackets of more than {len(found)} fields are not formed"
    return found[: found.index(found[-1]) + 2], note


def _places(near: Array) -> Iterator[tuple[list[Array], bool]]:
    """Yield general places, near ones first, then ``near``; each is exact or rounded."""
    for size in _NEARBY:
        yield [nearby(near, size, k) for k in range(1, 5)], True
    yield [near], False
    source = random.Random(1)
    yield [np.array([source.uniform(0.5, 1) for _ in near]) for _ in range(2)], True


def nearby(q: Array, size: float, k: int = 1) -> Array:
    """Return the k-th of a sequence of points at a distance from q."""
    return q + size * (1 + abs(q)) * np.cos(k * np.arange(1, len(q) + 1))


def _size(growth: Growth) -> Growth:
    """Return a key that orders growth vectors by their end, then by how early they reach it."""
    return (*growth[-1:], *growth)


def _rising(show: Show) -> Show:
    """Return a function that passes only increasing values to ``show``."""
    most = 0

    def told(found: int) -> None:
        nonlocal most
        if found > most:
            most = found
            show(found)

    return told


def is_settled(dimensions: Sequence[int], n: int) -> bool:
    """Return whether no further bracket can add to the dimensions, at a general point."""
    return dimensions[-1] == n or (len(dimensions) > 1 and dimensions[-1] == dimensions[-2])
