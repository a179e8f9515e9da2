"""Is D = ker mu integrable, and if not, how far from it?  On the expressions of a model.

The growth vector is found at points, as numbers with 77 digits, see `search`; so are constraints
that are integrable by themselves.  That brackets leave D is proved by that; that they stay in it is
proved by algebra where that is possible, see `is_zero`.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np
import sympy

from .._lib import Array
from ..model import Model
from . import search as growth
from .search import Distribution
from .series import BITS, NotAnalytic, Tape, fixed, real

__all__ = ["examine", "is_zero"]

Expr = Any

# No larger expressions are expanded.
_PROVABLE = 3_000
# What is left of equal things, relative to them; and to what they are computed from.
_ROUNDING = mpmath.ldexp(1, -100), mpmath.ldexp(1, -180)
# At a given point brackets are formed up to this order, and orders times coordinates.
_ORDERS, _WORK = 24, 200
_DIGITS = 30


def examine(
    model: Model, values: Mapping[str, float], near: Array, q: Array | None = None
) -> Distribution:
    """Return the growth vector of D, and the constraints that are holonomic in disguise.

    Parameters
    ----------
    model : Model
        With linear constraints, at least one.
    values : mapping
        Of the parameters.
    near : ndarray, shape (n,)
        Some point where mu is defined.
    q : ndarray, shape (n,), optional
        Where the growth vector is wanted; default: at a general point.
    """
    n, m = model.n, model.m
    forms = _Forms.of(model, values)
    with mpmath.workprec(BITS):
        points = list(itertools.islice(_general_points(forms, near), 3))
        if not points:
            note = "no point was found where mu is smooth"
            return Distribution(None, None, note, None, _DIGITS)
        found, told = growth.search(
            points[0], min(2, m), m, lambda dimensions: growth.is_settled(dimensions, n)
        )
        general = growth.shortened(found, n)
        if q is None:
            here, note = general, "" if told else "further brackets are too small to be told from 0"
        else:
            here, note = _at(model, forms, q, general)
        alone = [a for a in range(m) if all(_is_integrable(point, a) for point in points)]
    settled = told and growth.is_settled(found, n)
    proved = general[-1] == n or (
        settled and general[-1] == n - m and _is_involutive(model, forms, points[0].dependent)
    )
    named = [f"constraints[{a}]: {model.shown(model.constraints[a])} = 0" for a in alone]
    hidden = n - general[-1] if settled else 0
    if hidden > len(alone):
        named.append(f"{hidden} of the constraints together" if hidden < m else "all together")
    integrable = general[-1] == n - m if settled or general[-1] > n - m else None
    return Distribution(here, general, note, integrable, _DIGITS, tuple(named), proved)


def _at(
    model: Model, forms: _Forms, q: Array, general: tuple[int, ...]
) -> tuple[tuple[int, ...] | None, str]:
    """Return the growth vector at a point that is known to double precision, and what it lacks."""
    source = random.Random(1)
    other = [x + max(1.0, abs(x)) * source.choice((-1, 1)) * 2.0**-53 for x in map(mpmath.mpf, q)]
    try:
        point = _Point(forms, [fixed(x) for x in q], [fixed(x) for x in other])
    except NotAnalytic as error:
        return None, f"{model.shown(error.expression)} has no Taylor series there"
    except ValueError as error:
        return None, str(error)
    n = model.n
    limit = max(len(general) - 1, min(_ORDERS, _WORK // n))
    found, told = growth.search(
        point, len(general) - 1, limit, lambda dimensions: dimensions[-1] == general[-1]
    )
    if found[-1] == general[-1]:
        return growth.shortened(found, n), ""
    if told:
        return growth.shortened(found, n), growth.no_more(found)
    return tuple(found), (
        f"brackets of {len(found) + 1} fields cannot be told from 0 at a point that is known to 16 "
        "digits"
    )


def _general_points(forms: _Forms, near: Array) -> Iterator[_Point]:
    """Give points in no special position where mu is smooth and of full rank."""
    source = random.Random(1)
    for k in range(12):
        q = [mpmath.mpf(source.randint(2**40, 2**41)) / 2**41 for _ in near]
        if k >= 4:  # that was nowhere
            size = 10.0 ** -(k // 4)
            q = [c + size * (1 + abs(c)) * (2 * x - 1.5) for c, x in zip(map(mpmath.mpf, near), q)]
        with contextlib.suppress(ValueError):
            yield _Point(forms, [fixed(x) for x in q])


def _is_integrable(point: _Point, a: int) -> bool:
    """Return whether d mu^a ^ mu^a vanishes at a point: then the one constraint is holonomic."""
    form = point.mu[a]
    turn = point.slopes[:, a] - point.slopes[:, a].T
    terms = np.multiply.outer(turn, form)
    terms = np.array([terms, terms.transpose(1, 2, 0), terms.transpose(2, 0, 1)])
    relative, absolute = _ROUNDING
    return bool((abs(terms.sum(axis=0)) <= relative * abs(terms).sum(axis=0) + absolute).all())


# ---- at a point --------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Forms:
    """mu(q) and N(q, v) = d(mu v)/dq, row by row, in symbols that are defined one by one."""

    q: tuple[Expr, ...]
    v: tuple[Expr, ...]
    mu: tuple[Expr, ...]
    N: tuple[Expr, ...]
    definitions: Mapping[Expr, Expr]

    @classmethod
    def of(cls, model: Model, values: Mapping[str, float]) -> _Forms:
        """Return those of a model with linear constraints, for values of its parameters."""
        constraint = model.derived.function("constraint")
        assert constraint is not None
        engine, outputs = constraint.engine, dict(constraint.outputs)
        numbers = {p: sympy.Rational(x) for p, x in zip(model.p, values.values())}

        def give(e: Expr) -> Expr:
            return engine.give(e).xreplace(numbers)

        parts, found = engine.cse([*outputs["phi_v"], *outputs["phi_q"]])
        definitions = {give(symbol): give(e) for symbol, e in parts}
        entries = tuple(give(e) for e in found)
        size = model.m * model.n
        return cls(model.q, model.v, entries[:size], entries[size:], definitions)

    def tape(self, q: Array, v: Array) -> Tape:
        """Return a tape for series of q and v, shape (n, orders + 1, width)."""
        inputs = dict(zip((*self.q, *self.v), (*q, *v)))
        return Tape(q.shape[1] - 1, q.shape[2], inputs, self.definitions)


class _Point:
    """Brackets of mu at a point, see `growth.search`.

    Parameters
    ----------
    forms : _Forms
    q : sequence of int
        In units of 2**-BITS.
    other : sequence of int, optional
        A point that cannot be told from q.

    Attributes
    ----------
    mu : ndarray, shape (m, n)
    slopes : ndarray, shape (n, m, n)
        Entry [i, a, j] is d mu^a_i/dq_j.

    Raises
    ------
    ValueError
        If mu is not smooth there, or has not rank m.
    """

    rounding = _ROUNDING

    def __init__(self, forms: _Forms, q: Sequence[int], other: Sequence[int] | None = None) -> None:
        self.n = len(q)
        self.m = len(forms.mu) // self.n
        self._forms, self._q, self._other = forms, q, other
        shape = (self.n, 1, self.n)
        places = np.empty(shape, dtype=object)
        places[...] = np.array(q, dtype=object)[:, np.newaxis, np.newaxis]
        units = np.zeros(shape, dtype=object)
        units[range(self.n), 0, range(self.n)] = fixed(1)
        tape = forms.tape(places, units)
        self.mu = real([tape.series(e)[0, 0] for e in forms.mu]).reshape(self.m, self.n)
        slopes = real(np.array([tape.series(e)[0] for e in forms.N], dtype=object).T)
        self.slopes = slopes.reshape(self.n, self.m, self.n)
        span = growth.Span()
        span.add(self.mu, self.mu, _ROUNDING[0] * abs(self.mu).max())
        self.dependent = span.columns
        if len(self.dependent) < self.m:
            raise ValueError(f"mu has rank {len(self.dependent)} instead of {self.m}")
        self._independent = [i for i in range(self.n) if i not in self.dependent]

    def brackets(self, orders: int, seed: int) -> list[Array]:
        """Return for each order the coefficients of the fields pulled back along a motion."""
        return self._along(self._q, orders, seed)

    def twins(self, orders: int, seed: int) -> list[Array] | None:
        """Return those at the other point, if there is one."""
        return None if self._other is None else self._along(self._other, orders, seed)

    def _along(self, place: Sequence[int], orders: int, seed: int) -> list[Array]:
        """Return the coefficients at one place, along one motion."""
        source, degree = random.Random(seed), growth.degree(orders)
        nodes, integral = _integration(orders * (degree + 1))
        width, one = len(nodes), fixed(1)
        mu, N = np.zeros((2, orders + 1, width, self.m, self.n), dtype=object)
        q, velocities = np.zeros((2, self.n, orders + 1, width), dtype=object)
        v = np.zeros((orders + 1, width, self.n, 1), dtype=object)
        q[:, 0] = np.array(place, dtype=object)[:, np.newaxis]
        for _ in range(degree + 1):  # Horner
            for i in self._independent:
                v[0, :, i, 0] = (v[0, :, i, 0] * nodes >> BITS) + source.randint(-one, one)
        tape = self._forms.tape(q, velocities)
        of_mu = [tape.series(e) for e in self._forms.mu]
        of_N: list[Array] = []
        first = len(tape)  # operations that mu needs, which does not depend on v
        solve = self._solver([row[0, 0] for row in of_mu])
        for k in range(orders + 1):
            if k > 0:
                tape.advance(k, 0, first)
            _collect(mu, of_mu, k)
            if k == orders:
                break
            v[k][:, self.dependent] = solve(_convolve(mu, v, k))
            velocities[:, k] = v[k, :, :, 0].T
            if k > 0:
                tape.advance(k, first)
            else:
                of_N = [tape.series(e) for e in self._forms.N]
            _collect(N, of_N, k)
            q[:, k + 1] = (integral @ v[k, :, :, 0] >> BITS).T
        return self._pull_back(mu, N, integral, solve)

    def _pull_back(
        self, mu: Array, N: Array, integral: Array, solve: Callable[[Array], Array]
    ) -> list[Array]:
        """Solve dZ/ds = eps dX_u/dq Z from the end of the motion, where Z are the fields of D.

        mu X_u = 0, so the dependent rows of dX_u/dq are -B^-1 N(q, X_u); the others are 0.
        """
        orders, width, count = len(mu) - 1, len(integral), len(self._independent)
        Z, slope = np.zeros((2, orders + 1, width, self.n, count), dtype=object)
        end = np.zeros((orders + 1, 1, self.n, count), dtype=object)
        end[0, 0, self._independent, range(count)] = fixed(1)
        for k in range(orders + 1):
            end[k][:, self.dependent] = solve(_convolve(mu[:, -1:], end, k))
            Z[k] = end[k]
            if k > 0:
                pull = _convolve(N, Z, k - 1) + _convolve(mu, slope, k - 1)
                slope[k - 1][:, self.dependent] = solve(pull)
                path = integral @ slope[k - 1].reshape(width, -1) >> BITS
                Z[k] -= (path[-1] - path).reshape(width, self.n, count)
        return [real(Z[k, 0, self.dependent].T) for k in range(1, orders + 1)]

    def _solver(self, mu: Sequence[int]) -> Callable[[Array], Array]:
        """Return the function that multiplies by -B^-1, with the B of order 0, and 2**-BITS."""
        B = real(mu).reshape(self.m, self.n)[:, self.dependent]
        inverse = np.array((mpmath.matrix(B.tolist()) ** -1).tolist(), dtype=object)
        scaled = np.array([[fixed(x) for x in row] for row in inverse], dtype=object)
        return lambda right: -(np.matmul(scaled, right >> BITS) >> BITS)


def _collect(matrices: Array, series: Sequence[Array], k: int) -> None:
    """Set the coefficient of order k of matrices at each node, from those of their entries."""
    matrices[k] = np.array([s[k] for s in series], dtype=object).T.reshape(matrices[k].shape)


def _convolve(a: Array, b: Array, k: int) -> Array:
    """Return the coefficient of order k of a product of series of matrices, times 2**BITS."""
    return sum(np.matmul(a[j], b[k - j]) for j in range(k + 1))


@functools.lru_cache(maxsize=8)
def _integration(N: int) -> tuple[Array, Array]:
    """Return `growth.integration` in units of 2**-BITS."""
    with mpmath.workprec(BITS + 32):
        cosines = np.array([mpmath.cospi(mpmath.mpf(j) / N) for j in range(2 * N)], dtype=object)
        nodes, integrals, weights = (
            np.vectorize(fixed, otypes=[object])(x) for x in growth.integration(cosines)
        )
    return nodes, integrals @ weights >> BITS


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


def _is_involutive(model: Model, forms: _Forms, dependent: list[int]) -> bool:
    """Return whether it is proved that D is: d mu^a(X, Y) = 0 for all fields of a basis."""
    n, m, q = model.n, model.m, model.q
    if n - m == 1:
        return True
    if m > 4:
        return False
    known: dict[Expr, Expr] = {}
    for symbol, e in forms.definitions.items():
        known[symbol] = e.xreplace(known)
    mu = [[e.xreplace(known) for e in forms.mu[a * n : (a + 1) * n]] for a in range(m)]
    fields = _fields(mu, q, dependent)
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
