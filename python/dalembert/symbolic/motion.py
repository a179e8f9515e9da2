"""The motion of a model as rates of states: of (q, w) on D, or of (q, v)."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mpmath

from .graph import Node, Number, below
from .model import Model
from .recurrences import Series
from .reduced import NotReduced, Reduced
from .symbols import TIME
from .values import values


@dataclass(frozen=True)
class Motion:
    """The rates of the states (q, w).

    Attributes
    ----------
    w : tuple of Node
        Symbols of the states besides q.
    velocity : tuple of Node
        The rates of q: v as nodes in (t, q, w).
    rates : tuple of Node
        The rates of w.
    quasi : tuple of Node
        w as nodes in (t, q, v).
    in_D : bool
        Whether v lies in D for all w; if not, w is v.
    """

    w: Sequence[Node]
    velocity: Sequence[Node]
    rates: Sequence[Node]
    quasi: Sequence[Node]
    in_D: bool


def motion(model: Model) -> Motion:
    """Return the motion of a model: on D if a basis of D is found, and agrees with the multipliers.
    """
    v = [model.derived.read(x) for x in model.v]
    if model.derived.kind == "linear" and model.m == model.n:  # D is v = 0
        return Motion((), [v[0].graph.zero for _ in v], (), (), True)
    try:
        found = model.reduced
    except NotReduced:
        found = None
    if found is None or _leaves_doubles(found) or not agrees(model, found):
        return Motion(v, v, accelerations(model), v, model.m == 0)
    return Motion(found.w, found.velocity, found.rates, found.quasi, True)


def agrees(model: Model, found: Reduced) -> bool:
    """Return whether equations on D give the acceleration with the multipliers, at two points.

    The acceleration is that of the matrix [[M, mu^T], [mu, 0]], with 40 digits.  Among very large
    or small numbers some terms are seen only where the state is as large or small: there are more
    points, and digits.
    """
    names = [x.name for x in (*model.q, *model.p, *model.u, TIME)] + [x.value for x in found.w]
    groups = [x.name for x in model.q], [x.value for x in found.w]
    comparison = _Comparison(model, found)
    source, tried = random.Random(2), 0
    far = max(map(_digits, comparison.numbers), default=0.0)
    is_far = far > _FAR
    digits = 40 + int(4 * far) * is_far
    for k in range(4 * _POINTS if is_far else _POINTS):
        point: dict[str, Any] = {x: source.randint(200, 1100) / 1000 for x in names}
        for group in groups if k > 1 and is_far else ():
            size = mpmath.mpf(10) ** source.uniform(-far, far)
            point |= {x: size * point[x] for x in group}
        apart = comparison.apart(point, digits)
        if apart is None:
            continue
        difference, size = apart
        if difference > size * _CLOSE:  # unless it is roundoff, where the acceleration is 0
            again = comparison.apart(point, 2 * digits)
            if again is None or again[0] > difference * _CLOSE:
                return False
        tried += 1
        if tried == 2 and not is_far:
            break
    return True


class _Comparison:
    """The acceleration of equations on D, and that with the multipliers."""

    def __init__(self, model: Model, found: Reduced) -> None:
        self.model, self.found = model, found
        read = model.derived.read
        motion = dict(zip(map(read, model.q), found.velocity)) | dict(zip(found.w, found.rates))
        graph = found.velocity[0].graph
        self.slopes = graph.along(found.velocity, motion | {read(TIME): graph.one})

    @property
    def numbers(self) -> list[Number]:
        return [e.value for e in below(self.slopes) if e.op == "number" and e.value]

    def apart(self, point: dict[str, Any], digits: int) -> tuple[Any, Any] | None:
        """Return the largest difference, and the largest component; None outside the domain."""
        model, found, n, m = self.model, self.found, self.model.n, self.model.m
        terms = model.derived.terms.outputs
        with mpmath.workdps(digits):
            point = point | dict(zip((x.name for x in model.v), values(found.velocity, point)))
            M = values(model.derived.mass or terms["M"], point)
            mu, F, g = (values(terms.get(x, ()), point) for x in ("mu", "F", "g"))
            given = values(self.slopes, point)
            if not all(map(mpmath.isfinite, (*M, *mu, *F, *g, *given))):
                return None
            above = [[*row, *mu[i::n]] for i, row in enumerate(_rows(M, n))]
            whole = [*above, *([*row, *[0] * m] for row in _rows(mu, n))]
            right = [*F, *(-x for x in g)]
            try:
                expected = mpmath.lu_solve(mpmath.matrix(whole), mpmath.matrix(right))[:n]
            except ZeroDivisionError:
                return None
            differences = (abs(x - y) for x, y in zip(given, expected))
            return max(differences), max(map(abs, (*expected, *given)))


def _leaves_doubles(found: Reduced) -> bool:
    """Return whether products of large or small numbers are none of the doubles."""
    nodes = below([*found.velocity, *found.rates, *found.quasi])
    return any(e.value and _digits(e.value) > _DOUBLES for e in nodes if e.op == "number")


def _digits(x: Number) -> float:
    """Return how far a number is from 1, in decimal digits."""
    return abs(math.log10(abs(x.numerator)) - math.log10(x.denominator))


_POINTS = 8  # of which two have to be in the domain
_CLOSE = mpmath.mpf(10) ** -20
_FAR = 8  # decimal digits of a very large or small number
_DOUBLES = 290  # those of a double


def series_of(model: Model, motion: Motion) -> Series:
    """Return the series of (q, w)."""
    read = model.derived.read
    states = [*map(read, model.q), *motion.w]
    return Series(dict(zip(states, (*motion.velocity, *motion.rates))), read(TIME))


def accelerations(model: Model) -> list[Node]:
    """Return dv/dt as nodes in (t, q, v), with the multipliers eliminated.

    The rows of mu become orthogonal in the metric M^-1, by the modified method of Gram and Schmidt.
    Rows that nearly depend on others cost digits once; in mu M^-1 mu^T they would do so twice.
    """
    derived, n = model.derived, model.n
    outputs = derived.terms.outputs
    M = _rows(derived.mass or outputs["M"], n)
    mu = _rows(outputs.get("mu", ()), n)
    g = list(outputs.get("g", ()))
    v, *Z = solve(M, [list(outputs["F"]), *mu])
    for a, (row, z) in enumerate(zip(mu, Z)):
        norm = _dot(row, z)
        v = _less(v, (_dot(row, v) + g[a]) / norm, z)
        for b in range(a + 1, len(mu)):
            share = _dot(mu[b], z) / norm
            mu[b], Z[b] = _less(mu[b], share, row), _less(Z[b], share, z)
            g[b] = g[b] - share * g[a]
    return v


def _less(x: Sequence[Node], share: Node, y: Sequence[Node]) -> list[Node]:
    return [a if b.is_zero or share.is_zero else a - share * b for a, b in zip(x, y)]


def _rows(entries: Sequence[Any], n: int) -> list[list[Any]]:
    return [list(entries[i : i + n]) for i in range(0, len(entries), n)]


def _dot(a: Sequence[Node], b: Sequence[Node]) -> Node:
    return a[0].graph.sum(x * y for x, y in zip(a, b) if not (x.is_zero or y.is_zero))


def solve(A: list[list[Node]], rights: list[list[Node]]) -> list[list[Node]]:
    """Return A^-1 times each right side, for a positive definite A, without pivoting."""
    A, rights, n = [[*row] for row in A], [[*x] for x in rights], len(A)
    for j in range(n):
        for i in range(j + 1, n):
            if A[i][j].is_zero:
                continue
            share = A[i][j] / A[j][j]
            for k in range(j + 1, n):
                A[i][k] = A[i][k] - share * A[j][k]
            for x in rights:
                x[i] = x[i] - share * x[j]
    for x in rights:
        for i in reversed(range(n)):
            later = [A[i][k] * x[k] for k in range(i + 1, n) if not A[i][k].is_zero]
            x[i] = (x[i] - x[i].graph.sum(later)) / A[i][i]
    return rights
