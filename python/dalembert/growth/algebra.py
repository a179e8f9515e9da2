"""Integrability and growth vector of D = ker mu, from the expressions of a model.

The growth vector, and constraints that are integrable by themselves, are computed at points with
many digits, see `search`.  This proves that brackets leave D. Algebra proves, if possible, that
they stay in D, see `zeros`.
"""

from __future__ import annotations

import dataclasses
import itertools
import random
from collections.abc import Mapping, Sequence
from typing import Any

import mpmath
import numpy as np
import sympy

from ..core import Array, Pair
from ..core.extras import Show
from ..symbolic.functions import with_default
from ..symbolic.model import Model
from ..symbolic.zeros import PIECES, is_zero
from .search import Distribution, Word, brackets, explore, is_settled, search

Expr = Any

# The steps of differences are 2**-_BITS; what is not larger than _ZERO is zero.
_BITS, _ZERO = 220, mpmath.ldexp(1, -160)
# At a given point brackets are formed up to this order, and with no more values of mu than this.
_ORDERS, _WORK = 10, 30_000


@mpmath.workprec(3 * _BITS)
def examine(
    model: Model,
    values: Mapping[str, float],
    near: Array,
    q: Array | None = None,
    show: Show = lambda found: None,
) -> Distribution:
    """Return the result of `growth.examine`, for values of the parameters of a model."""
    n, m, forms = model.n, model.m, _Forms(model, values)
    found, points = explore(forms, near, q, show)
    general = found.general_growth
    if general is None:
        return found
    settled = is_settled(general, n)
    alone = [a for a in range(m) if all(point.is_integrable(a) for point in points)]
    if len(alone) > n - general[-1]:  # what is small in one has its own size in the other
        alone = []
    proved = general[-1] == n or (
        settled and general[-1] == n - m and forms.are_involutive(points[0].dependent)
    )
    where, note = "", found.growth_note
    if forms.in_pieces and general[-1] < n and not proved:
        where = ", as far as points nearby show"
        note = note or "mu is given in pieces, and only those near this point were examined"
    named = [f"constraints[{a}]: {model.shown(model.constraints[a])} = 0{where}" for a in alone]
    hidden = n - general[-1] if settled else 0
    if hidden > len(alone):
        which = f"{hidden} of the constraints together" if hidden < m else "all together"
        named.append(which + where)
    return dataclasses.replace(found, growth_note=note, holonomic=tuple(named), exact=proved)


class _Forms:
    """mu as expressions, and as a function in the precision of mpmath."""

    digits = 30
    lost = "cannot be distinguished from 0, because the point is known only to 16 digits"

    def __init__(self, model: Model, values: Mapping[str, float]) -> None:
        numbers = {p: sympy.Rational(x) for p, x in zip(model.p, values.values())}
        self.n, self.m = model.n, model.m
        self.most = self.m
        self.most_there = max(1, min(_ORDERS, int(np.log2(_WORK / self.n**2))))
        self.q, self.shown = model.q, model.shown
        forms = model.derived.expressions("constraint", "phi_v")
        self.mu = [e.xreplace(numbers) for e in forms]
        self._edges = _edges(self.mu)
        self.in_pieces = any(e.has(*PIECES) for e in self.mu)
        printed = [
            with_default(e.replace(sympy.Heaviside, lambda x, _: (1 + sympy.sign(x)) / 2))
            for e in (*self.mu, *self._edges)
        ]
        self._values = sympy.lambdify([self.q], printed, "mpmath", cse=True)

    def at(self, q: Sequence[Any]) -> tuple[Array, list[Any]]:
        """Return mu, and functions that vanish if mu is not smooth; ValueError off its domain."""
        try:
            found = [mpmath.mpmathify(x) for x in self._values(q)]
        except (ArithmeticError, ValueError):
            found = [mpmath.nan]
        if not all(isinstance(x, mpmath.mpf) and mpmath.isfinite(x) for x in found):
            raise ValueError("mu is not defined there")
        size = self.m * self.n
        return np.array(found[:size], dtype=object).reshape(self.m, self.n), found[size:]

    def point(self, q: Array, is_exact: bool) -> _Point:
        """Return a point; raise ValueError if it is not exact and mu is not smooth there."""
        places = [list(map(mpmath.mpf, q))]
        if not is_exact:
            source = random.Random(1)
            ends = (x + max(1.0, abs(x)) * source.choice((-1, 1)) * 2.0**-53 for x in places[0])
            places.append(list(ends))
            self.require_smooth(*places)
        return _Point(self, places)

    def require_smooth(self, q: Sequence[Any], other: Sequence[Any]) -> None:
        """Raise ValueError if mu is not smooth at a point, as far as that is known."""
        for e, one, two in zip(self._edges, self.at(q)[1], self.at(other)[1]):
            if abs(one) <= 4 * abs(one - two):
                raise ValueError(f"mu is not smooth there: {self.shown(e)} is 0")

    def are_involutive(self, dependent: Sequence[int]) -> bool:
        """Return whether D is proved to be involutive: d mu^a(X, Y) = 0 for a basis of fields."""
        n, m, q = self.n, self.m, self.q
        if n - m <= 1:
            return True
        if m > 4:
            return False
        mu = sympy.Matrix(m, n, self.mu)
        free = [i for i in range(n) if i not in dependent]
        B = mu[:, list(dependent)]
        solved = -B.adjugate() * mu[:, free]
        fields = sympy.zeros(n, n - m)  # without division
        for k, i in enumerate(dependent):
            fields[i, :] = solved[k, :]
        for k, i in enumerate(free):
            fields[i, k] = B.det(method="berkowitz")
        for a in range(m):
            slope = mu[a, :].jacobian(q)
            found = fields.T * (slope - slope.T) * fields
            pairs = itertools.combinations(range(n - m), 2)
            if not all(is_zero(found[i, j]) for i, j in pairs):
                return False
        return True


def _edges(expressions: Sequence[Expr]) -> list[Expr]:
    """Return expressions that vanish at points without Taylor series."""
    found = set()
    kinds = sympy.core.function.Application, sympy.Pow, sympy.Rel
    for e in set().union(*(e.atoms(*kinds) for e in expressions)):
        if isinstance(e, sympy.Abs | sympy.sign | sympy.Heaviside):
            found.add(e.args[0])
        elif isinstance(e, sympy.Max | sympy.Min):
            found |= {a - b for a, b in itertools.combinations(e.args, 2)}
        elif isinstance(e, sympy.Rel):
            found.add(e.lhs - e.rhs)
        elif e.is_Pow and not e.exp.is_integer and not e.base.is_number:
            found.add(e.base)
    return sorted(found, key=sympy.default_sort_key)


class _Point:
    """Brackets of mu at a point that has several places, see `search.search`.

    ``rows`` are the rows of mu.  Raises ValueError if they are dependent there.
    """

    rounding = _ZERO

    def __init__(
        self, forms: _Forms, places: list[Sequence[Any]], rows: Sequence[int] | None = None
    ) -> None:
        self._forms, self._rows = forms, list(range(forms.m) if rows is None else rows)
        self.n, self.m = forms.n, len(self._rows)
        self._places = [np.array(x, dtype=object) for x in places]
        self._pivots = _pivots(self._mu(places[0]))
        if len(self._pivots) < self.m:
            raise ValueError(f"mu has rank {len(self._pivots)} instead of {self.m}")
        self.dependent = [c for _, c in self._pivots]
        self._free = [j for j in range(self.n) if j not in self.dependent]
        size = [1] * self.m
        if len(places) == 1:
            size = abs(self._fields(places[0])).max(axis=1, initial=0)
        # of dependent coordinates; what is no more than roundoff is none
        self._units = np.array([x if x > _ZERO**2 else 1 for x in size], dtype=object)
        self._digits = 0

    def pair(self, word: Word) -> Pair:
        """Return the dependent components of a bracket, here and at the other place."""
        digits = _BITS * (-(-len(word) // 4) * 4 + 1)  # each difference loses _BITS
        if digits > self._digits:
            step = mpmath.ldexp(1, -_BITS)
            stencil = [(step, 1 / step), (0, -1 / step)]
            self._digits = digits
            self._brackets = brackets(self._fields, self.dependent, self.n, stencil)
        with mpmath.workprec(self._digits):
            rows = [self._brackets(word, q) / self._units for q in self._places]
        return rows[0], rows[-1]

    def _mu(self, q: Sequence[Any]) -> Array:
        return self._forms.at(q)[0][self._rows]

    def _fields(self, q: Sequence[Any]) -> Array:
        mu = self._mu(q)
        for r, c in self._pivots:
            _eliminate(mu, r, c)
        return -mu[[r for r, _ in self._pivots]][:, self._free]

    def is_integrable(self, a: int) -> bool:
        """Return whether one constraint is integrable by itself, and so holonomic."""
        alone, told = search(_Point(self._forms, self._places, [a]), 1)
        return told and alone[-1] < self.n


def _pivots(mu: Array) -> list[tuple[int, int]]:
    """Return rows and columns for Gauss-Jordan elimination, as many as the rank."""
    found = list[tuple[int, int]]()
    mu = np.array([form / (abs(form).max() or 1) for form in mu])  # whatever their units are
    for _ in mu:
        size = abs(mu)
        size[[r for r, _ in found]] = 0
        r, c = map(int, np.unravel_index(int(np.argmax(size)), size.shape))
        if size[r, c] <= _ZERO:
            break
        _eliminate(mu, r, c)
        found.append((r, c))
    return found


def _eliminate(mu: Array, r: int, c: int) -> None:
    """Make column c a unit vector by row r."""
    live = np.flatnonzero(mu[r])
    lead = mu[r, live] / mu[r, c]
    for i in np.flatnonzero(mu[:, c]):
        if i != r:
            mu[i, live] -= mu[i, c] * lead
    mu[r, live] = lead
