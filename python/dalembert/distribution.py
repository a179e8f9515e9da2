"""Is D = ker mu integrable?  Frobenius' theorem on the expressions of a model.

Brackets are formed exactly; whether they leave D is seen at random points with 50 digits, which
proves that they do.  That they do not is proved by algebra where that is possible, see `is_zero`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
import sympy

from .model import DIGITS, Model, Points, engine_for

__all__ = ["Distribution", "examine", "is_zero"]

Expr = Any

# More than this many operations are not expanded, and not differentiated again.
_LARGE = 20_000
_PROVABLE = 3_000


@dataclass(frozen=True)
class Distribution:
    """What `examine` found; see `dalembert.Check`."""

    growth: tuple[int, ...]
    holonomic: tuple[str, ...]
    exact: bool


def examine(model: Model, values: Mapping[str, float]) -> Distribution:
    """Return the growth vector of D, and the constraints that are holonomic in disguise.

    Parameters
    ----------
    model : Model
        With linear constraints, at least one.
    values : mapping
        Of the parameters.
    """
    n, m, q = model.n, model.m, model.q
    constraint = model.derived.function("constraint")
    assert constraint is not None
    exact_values = {p: sympy.Rational(x) for p, x in zip(model.p, values.values())}
    give = constraint.engine.give
    flat = [give(e).xreplace(exact_values) for e in dict(constraint.outputs)["phi_v"]]
    mu = [flat[a * n : (a + 1) * n] for a in range(m)]
    slopes = [sympy.diff(e, x) for e in flat for x in q]
    points = Points(q)
    with mpmath.workdps(DIGITS):
        found = [_Point(n, m, numbers) for numbers in points.evaluate([*flat, *slopes])]
        found = [point for point in found if len(point.fields) == n - m]
        if not found:
            return Distribution((n - m,), (), False)
        growth = [n - m, max(point.second() for point in found)]
        proved = growth[-1] == n or (growth[0] == growth[1] and _is_involutive(mu, q, found[0]))
        if growth[0] < growth[1] < n:
            growth += _further(mu, q, found[0].pivots, points, growth[1])
            proved = growth[-1] == n
        alone = [a for a in range(m) if all(point.integrable(a) for point in found)]
    named = [f"constraints[{a}]: {model.shown(model.constraints[a])} = 0" for a in alone]
    stays = growth[-1] < n and growth[-1] == growth[-2]
    hidden = n - growth[-1] if stays else 0
    if hidden > len(alone):
        named.append(f"{hidden} of the constraints together" if hidden < m else "all together")
    return Distribution(tuple(growth), tuple(named), proved)


class _Point:
    """mu and its derivatives at a point, as numbers."""

    def __init__(self, n: int, m: int, numbers: Sequence[Any]) -> None:
        self.n, self.m = n, m
        self.mu = [list(numbers[a * n : (a + 1) * n]) for a in range(m)]
        rest = numbers[m * n :]
        # d mu^a: [a][i][j] = d mu^a_i / dq_j
        self.slope = [
            [list(rest[(a * n + i) * n : (a * n + i + 1) * n]) for i in range(n)] for a in range(m)
        ]
        self.pivots, self.fields = _kernel(self.mu, n)

    def second(self) -> int:
        """Return the dimension of D + [D, D]: mu^a([X, Y]) = -d mu^a(X, Y)."""
        columns = []
        for X, Y in itertools.combinations(self.fields, 2):
            columns.append([self._turn(a, X, Y) for a in range(self.m)])
        return len(self.fields) + _rank(columns)

    def _turn(self, a: int, X: Sequence[Any], Y: Sequence[Any]) -> Any:
        slope, n = self.slope[a], self.n
        terms = [slope[i][j] * (X[j] * Y[i] - X[i] * Y[j]) for i in range(n) for j in range(n)]
        found = mpmath.fsum(terms)
        return found if abs(found) > _TINY * sum(map(abs, terms)) else mpmath.mpf(0)

    def integrable(self, a: int) -> bool:
        """Return whether d mu^a ^ mu^a vanishes here: then the one constraint is holonomic."""
        w, d = self.mu[a], self.slope[a]
        for i, j, k in itertools.combinations(range(self.n), 3):
            terms = [
                (d[j][i] - d[i][j]) * w[k], (d[k][j] - d[j][k]) * w[i], (d[i][k] - d[k][i]) * w[j]
            ]  # fmt: skip
            if abs(mpmath.fsum(terms)) > _TINY * (1 + sum(map(abs, terms))):
                return False
        return True


_TINY = mpmath.mpf(10) ** -30


def _eliminate(rows: Sequence[Sequence[Any]]) -> tuple[list[list[Any]], list[int]]:
    """Return the reduced rows, and the column of the pivot of each; the largest entry leads."""
    left = [list(row) for row in rows]
    done: list[list[Any]] = []
    pivots: list[int] = []
    scale = max((abs(x) for row in left for x in row), default=0)
    while left:
        size, r, c = max(
            (abs(x), r, c) for r, row in enumerate(left) for c, x in enumerate(row)
        )
        if size <= _TINY * scale:
            break
        lead = left.pop(r)
        lead = [x / lead[c] for x in lead]
        for row in (*left, *done):
            factor = row[c]
            row[:] = [x - factor * y for x, y in zip(row, lead)]
        done.append(lead)
        pivots.append(c)
    return done, pivots


def _rank(rows: Sequence[Sequence[Any]]) -> int:
    return len(_eliminate(rows)[1])


def _kernel(rows: Sequence[Sequence[Any]], n: int) -> tuple[list[int], list[list[Any]]]:
    """Return the pivot columns of a matrix and a basis of its kernel."""
    reduced, pivots = _eliminate(rows)
    basis = []
    for free in (c for c in range(n) if c not in pivots):
        field = [mpmath.mpf(int(c == free)) for c in range(n)]
        for row, c in zip(reduced, pivots):
            field[c] = -row[free]
        basis.append(field)
    return pivots, basis


# ---- with expressions ----------------------------------------------------------------------------


def _fields(mu: list[list[Expr]], q: Sequence[Expr], pivots: list[int]) -> list[list[Expr]]:
    """Return n - m fields that span D where the pivot columns B are regular, without division.

    Free column k: det B in its place, -adj B mu_k in those of the pivots.
    """
    B = sympy.Matrix([[row[c] for c in pivots] for row in mu])
    adjugate = B.adjugate()
    determinant = sum((B[0, k] * adjugate[k, 0] for k in range(B.rows)), sympy.Integer(0))
    found = []
    for free in (c for c in range(len(q)) if c not in pivots):
        dependent = -adjugate * sympy.Matrix([row[free] for row in mu])
        field = [sympy.Integer(0)] * len(q)
        field[free] = determinant
        for c, entry in zip(pivots, dependent):
            field[c] = entry
        found.append(field)
    return found


def _further(
    mu: list[list[Expr]], q: Sequence[Expr], pivots: list[int], points: Points, known: int
) -> list[int]:
    """Return the dimensions after that of D + [D, D], known, as far as they are found."""
    n = len(q)
    if len(mu) > 4:
        return []
    fields = _fields(mu, q, pivots)
    if sum(sympy.count_ops(e) for field in fields for e in field) > _LARGE // 10:
        return []
    engine = engine_for([e for field in fields for e in field])
    variables = [engine.take(x) for x in q]
    basis = [[engine.take(e) for e in field] for field in fields]

    def bracket(X: list[Expr], Y: list[Expr]) -> list[Expr]:
        return [
            sum(
                (X[j] * engine.diff(Y[i], variables[j]) - Y[j] * engine.diff(X[i], variables[j])
                 for j in range(n)),
                engine.take(sympy.Integer(0)),
            )
            for i in range(n)
        ]  # fmt: skip

    def numbers(some: list[list[Expr]]) -> list[list[Any]]:
        values = points.evaluate([engine.give(e) for field in some for e in field])
        if not values:
            return []
        return [values[0][k * n : (k + 1) * n] for k in range(len(some))]

    span = numbers(basis)
    last, dimensions = basis, [len(basis)]
    while dimensions[-1] < n and (len(dimensions) < 2 or dimensions[-1] > dimensions[-2]):
        made = [bracket(X, Y) for X in basis for Y in last if X is not Y]
        if sum(sympy.count_ops(engine.give(e)) for field in made for e in field) > _LARGE:
            break
        last = []
        for field, row in zip(made, numbers(made)):
            if _rank([*span, row]) > len(span):
                span.append(row)
                last.append(field)
        dimensions.append(len(span))
    return dimensions[2:] if dimensions[1:2] == [known] else []


def _is_involutive(mu: list[list[Expr]], q: Sequence[Expr], point: _Point) -> bool:
    """Return whether it is proved that D is: d mu^a(X, Y) = 0 for all fields of a basis."""
    n = len(q)
    if n - len(mu) == 1:
        return True
    if len(mu) > 4:
        return False
    fields = _fields(mu, q, point.pivots)
    for row in mu:
        turn = {
            (i, j): sympy.diff(row[i], q[j]) - sympy.diff(row[j], q[i])
            for i, j in itertools.combinations(range(n), 2)
        }
        for X, Y in itertools.combinations(fields, 2):
            terms = [d * (X[j] * Y[i] - X[i] * Y[j]) for (i, j), d in turn.items()]
            if not is_zero(sympy.Add(*terms)):
                return False
    return True


def is_zero(expression: Expr) -> bool:
    """Return whether an expression is proved to be zero.

    Its numerator is a polynomial in symbols, in sines and cosines, and in other functions, which
    count as unknowns; it is reduced by sin^2 + cos^2 = 1.
    """
    if expression == 0:
        return True
    if sympy.count_ops(expression) > _PROVABLE:
        return False
    numerator = sympy.expand_trig(sympy.fraction(sympy.together(expression))[0])
    angles = {e.args[0] for e in numerator.atoms(sympy.sin, sympy.cos)}
    rule, relations, unknowns = {}, [], []
    for k, angle in enumerate(sorted(angles, key=sympy.default_sort_key)):
        s, c = sympy.symbols(f"s{k} c{k}")
        rule |= {sympy.sin(angle): s, sympy.cos(angle): c}
        relations.append(s**2 + c**2 - 1)
        unknowns += [s, c]
    numerator = sympy.expand(numerator.xreplace(rule))
    if numerator == 0:
        return True
    if not relations:
        return False
    try:
        _, rest = sympy.reduced(numerator, relations, *unknowns)
    except sympy.PolynomialError:
        return False
    return bool(sympy.expand(rest) == 0)
