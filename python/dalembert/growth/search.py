"""The growth vector of D at a point: the dimensions of D^1 = D, D^2 = D + [D, D], ...

D^{k+1} = D^k + [D, D^k] is spanned by the brackets [X_a, [X_b, ... [X_y, X_z]]] of up to k + 1
fields.  A field X_u of D has the constant independent velocities u, so a bracket has dependent
components alone, and

    [X_u, W] = dW/dq X_u - dX_u/dq W

takes no more than derivatives along lines, which are found by differences.

At a general point only the brackets that are new in D^k have to be bracketed again.  Elsewhere the
others matter too; there u, ..., z are random: while something of D^{k+1} is missing, a random
bracket gives it with probability 1, for its coefficients are polynomials in u, ..., z.  For what
the growth vector says see A. Bellaiche, The tangent space in sub-Riemannian geometry; for cars with
trailers F. Jean, The car with N trailers: there it is (2, 3, ..., n), unless two neighbours stand
at right angles, the last two apart.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core import Array
from ..core.extras import Show

# An entry counts if it is this many times the difference to its twin.
_TRUST = 30
# What does not count is zero if it is so much smaller than what counted last.
_GAP = 1e-4

# General points are sought at such distances from a state, as the curvature is by the core.
NEARBY = (0.1, 0.01, 0.001)

# Independent velocities of the fields of a bracket, the outermost first; brackets by their order.
Word = tuple[tuple[float, ...], ...]
Words = list[list[Word]]

# The dimensions of D^1, D^2, ...
Growth = tuple[int, ...]


@dataclass(frozen=True)
class Distribution:
    """What is found of D; see `dalembert.Check`."""

    growth: Growth | None
    general_growth: Growth | None
    growth_note: str
    integrable: bool | None  # None: not known
    digits: int
    holonomic: tuple[str, ...] = ()
    exact: bool = False


class Brackets:
    """Brackets of fields of D by differences.

    ``fields(q)`` is S, shape (m, n - m), so that v_dependent = S u on D; the stencil has steps and
    weights of the difference along a line.
    """

    def __init__(
        self, fields: Callable[[Array], Array], dependent: Sequence[int], n: int, stencil: Any
    ) -> None:
        self.n, self.dependent = n, list(dependent)
        self._independent = [i for i in range(n) if i not in self.dependent]
        self._fields, self._stencil = fields, stencil
        self._known: dict[Any, Array] = {}

    def at(self, word: Word, q: Array) -> Array:
        """Return a bracket at a point, all its n components."""
        key = word, tuple(q)
        if key not in self._known:
            self._known[key] = self._new(word, q)
        return self._known[key]

    def _new(self, word: Word, q: Array) -> Array:
        head, rest = word[:1], word[1:]
        if rest:
            W, X = self.at(rest, q), self.at(head, q)
            return self._along(rest, q, X) - self._along(head, q, W)
        if tuple(q) not in self._known:
            self._known[tuple(q)] = self._fields(q)
        S = self._known[tuple(q)]
        X = np.zeros(self.n, dtype=S.dtype)
        X[self._independent] = head[0]
        X[self.dependent] = S @ np.array(head[0])
        return X

    def _along(self, word: Word, q: Array, direction: Array) -> Array:
        """Return the derivative of a bracket along a line."""
        return sum(weight * self.at(word, q + step * direction) for step, weight in self._stencil)


class _Span:
    """Rows, eliminated; the twin of one, found elsewhere, differs by what is not known of it."""

    def __init__(self) -> None:
        self._least: Any = 1
        self._leads: list[tuple[int, Array, Array]] = []

    def add(self, row: Array, twin: Array, rounding: Any) -> bool | None:
        """Return whether a row adds to the space, None if that cannot be told."""
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


Candidates = Callable[[int, Sequence[Word], list[Word]], Iterable[Word]]


def of_new_ones(count: int) -> Candidates:
    """Return the brackets to try at a general point, of ``count`` fields and those found last."""
    source = random.Random(1)
    fields = [
        tuple((i == j) + source.uniform(-0.3, 0.3) for j in range(count)) for i in range(count)
    ]

    pairs = list(itertools.combinations(fields, 2))
    return lambda _, last, __: [(u, *word) for word in last for u in fields] if last else pairs


def at_random(count: int) -> Candidates:
    """Return those to try anywhere: random ones, until one is nothing new."""
    source = random.Random(2)

    def candidates(k: int, _: Sequence[Word], found: list[Word]) -> Iterator[Word]:
        word: Word | None = None
        while word is None or word in found:
            word = tuple(tuple(source.uniform(-1, 1) for _ in range(count)) for _ in range(k + 1))
            yield word

    return candidates


def search(
    source: Any,
    candidates: Candidates,
    limit: int,
    enough: Callable[[list[int]], bool],
    show: Show,
) -> tuple[list[int], Words, bool]:
    """Return the dimensions of D^1, D^2, ...

    ``source`` has the sizes n and m, the ``rounding`` of numbers of size 1, and ``pair(word)``: the
    dependent components of a bracket, shape (m,), and a twin, see `_Span`.  ``candidates`` gives
    the brackets of k + 1 fields to try, of k, those found of k fields, and the list of those found
    so far of k + 1.  The search ends with k = ``limit``, or if the dimensions are ``enough``, and
    ``show`` is told how many dimensions were added to D.

    Also the brackets that were found to be independent, of 2 fields, of 3, ..., and False if
    further ones cannot be told from those found.
    """
    span, dimensions, words = _Span(), [source.n - source.m], Words()
    for k in range(1, limit + 1):
        found = list[Word]()
        for word in candidates(k, words[-1] if words else (), found):
            counts = span.add(*source.pair(word), source.rounding)
            if counts is None:
                return dimensions, words, False
            if counts:
                found.append(word)
                show(dimensions[-1] + len(found) - dimensions[0])
            if dimensions[-1] + len(found) == source.n:
                break
        words.append(found)
        dimensions.append(dimensions[-1] + len(found))
        if enough(dimensions):
            break
    return dimensions, words, True


def at_general_point(
    point: Any, limit: int, show: Show
) -> tuple[Growth, Words, bool, bool]:
    """Return the growth vector at a general point, as far as it is found, and its brackets.

    Also whether further ones could be told from them, and whether it is settled.
    """
    n = point.n
    found, words, told = search(
        point, of_new_ones(n - point.m), limit, lambda found: is_settled(found, n), show
    )
    settled = is_settled(found, n)
    return shortened(found, n) if settled else tuple(found), words, told, settled


def largest(
    points: Iterable[Any], limit: int, show: Show
) -> tuple[Growth, Words, bool, bool]:
    """Return the largest growth vector of several general points, see `at_general_point`.

    Of functions that vanish nearly everywhere, or are given in pieces, one point does not tell.
    """
    best = None
    for point in points:
        found = at_general_point(point, limit, show)
        if best is None or is_larger(found[0], best[0]):
            best = found
        if found[0][-1] == point.n:
            break
    assert best is not None
    return best


def nearby(q: Array, size: float, k: int = 1) -> Array:
    """Return the k-th of some points at a distance from q."""
    return q + size * (1 + abs(q)) * np.cos(k * np.arange(1, len(q) + 1))


def is_larger(one: Sequence[int], other: Sequence[int]) -> bool:
    """Return whether one growth vector ends above another, or gets there sooner."""
    return (one[-1], *one) > (other[-1], *other)


def rising(show: Show) -> Show:
    """Return the function that shows what is more than it was told before."""
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


def shortened(dimensions: Sequence[int], n: int) -> Growth:
    """Return dimensions up to the first that is as the last one, and once more if that is not n."""
    last = dimensions[-1]
    return (*dimensions[: list(dimensions).index(last) + 1], *([last] if last < n else []))


def no_more(dimensions: Sequence[int]) -> str:
    """Return what there is to say where the search has ended before the dimensions have."""
    return f"brackets of more than {len(dimensions)} fields are not formed"
