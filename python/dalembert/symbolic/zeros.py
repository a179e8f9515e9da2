"""Proofs that an expression is zero everywhere, over the rational numbers.

An expression is written as a polynomial in letters, with rational coefficients and integer
exponents of any sign.  The letters are its symbols; sines, cosines and exponentials of the terms of
their arguments; roots; sums in denominators; and all other functions.  Then relations between the
letters, such as s^2 = 1 - c^2, are substituted.  If the result is empty, the expression is zero
wherever it is defined.  The converse does not hold: Max(0, x) Max(0, -x) is not decided.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Hashable, Iterable
from typing import Any

import sympy
from sympy import QQ

Expr = Any

# A monomial is its letters and their exponents, by letter; a polynomial has its coefficients.
Monomial = tuple[tuple[int, int], ...]
Polynomial = dict[Monomial, Any]

_ONE: Monomial = ()
_UNIT: Polynomial = {_ONE: QQ(1)}

# A larger multiple of an angle, or power of a sum, is a letter of its own.
_LARGEST = 16

# Products of terms after which the question is left open: about a tenth of a second.
_PATIENCE = 20_000


def of_sympy(names: str) -> tuple[Any, ...]:
    """Return the objects of SymPy with these names."""
    return tuple(getattr(sympy, name) for name in names.split())


# Functions that are not analytic: what they are somewhere says nothing of elsewhere.
PIECES = of_sympy("Abs sign Heaviside Max Min Piecewise Rel")


class _Undecided(Exception):
    """A proof takes too long, or a denominator may be zero."""


def is_zero(expression: Expr) -> bool:
    """Return whether an expression is proved to be zero wherever it is defined.

    Examples
    --------
    >>> import sympy
    >>> from dalembert.symbolic.zeros import is_zero
    >>> x, y = sympy.symbols("x y", real=True)
    >>> is_zero(sympy.cos(x - y) - sympy.cos(x) * sympy.cos(y) - sympy.sin(x) * sympy.sin(y))
    True
    >>> is_zero(sympy.Max(0, x - 2)), is_zero(sympy.Float("1e-60") * x)
    (False, False)
    """
    if expression.is_Number:
        return bool(expression == 0)
    try:
        form = _Form(expression)
        return not form.reduced(form.of(expression))
    except _Undecided:
        return False


class _Form:
    """Polynomials in letters.

    Letter g of ``relations`` satisfies g^k = B, with B in the letters before it.
    """

    def __init__(self, expression: Expr) -> None:
        self.letters: dict[Hashable, int] = {}
        self.relations: dict[int, tuple[int, Polynomial]] = {}
        self.known: dict[Expr, Polynomial] = {}
        self.left = _PATIENCE
        self.units: dict[Monomial, int] = {}
        for e in expression.atoms(*_PERIODIC, *_EXPONENTIAL):
            for term, count in self.of(e.args[0]).items():
                self.units[term] = math.lcm(self.units.get(term, 1), int(count.denominator))
        self.known.clear()

    def letter(self, key: Hashable, exponent: int = 1) -> Polynomial:
        """Return the letter of a key, a new one for a new key."""
        return {((self.letters.setdefault(key, len(self.letters)), exponent),): QQ(1)}

    def times(self, a: Polynomial, b: Polynomial) -> Polynomial:
        self.left -= len(a) * len(b)
        if self.left < 0:
            raise _Undecided
        pairs = itertools.product(a.items(), b.items())
        return _collected((_product(one, other), x * y) for (one, x), (other, y) in pairs)

    def power(self, a: Polynomial, exponent: int) -> Polynomial:
        """Return a^exponent; a sum in a denominator becomes a letter."""
        if len(a) == 1:
            ((term, x),) = a.items()
            return {tuple((g, k * exponent) for g, k in term): x**exponent}
        if exponent < 0:
            return self.root(a, 1, exponent)
        return functools.reduce(self.times, [a] * exponent, _UNIT)

    def root(self, a: Polynomial, degree: int, exponent: int) -> Polynomial:
        """Return the letter g^exponent, where g^degree = a."""
        if not self.reduced(a):
            raise _Undecided
        found = self.letter((degree, frozenset(a.items())), exponent)
        ((term, _),) = found.items()
        self.relations[term[0][0]] = degree, a
        return found

    def of(self, e: Expr) -> Polynomial:
        """Return the polynomial of an expression."""
        found = self.known.get(e)
        if found is None:
            found = self.known[e] = self._of(e)
        return found

    def _of(self, e: Expr) -> Polynomial:
        if e.is_Rational or e.is_Float:
            value = sympy.Rational(e)
            return {_ONE: QQ(value.p, value.q)} if value else {}
        if e.is_Add:
            return _collected(pair for part in e.args for pair in self.of(part).items())
        if e.is_Mul:
            return functools.reduce(self.times, map(self.of, e.args))
        if e.is_Pow and e.exp.is_Rational and max(abs(e.exp.p), e.exp.q) <= _LARGEST:
            base = self.of(e.base)
            if e.exp.q == 1:
                return self.power(base, e.exp.p)
            return self.root(base, e.exp.q, e.exp.p)
        if isinstance(e, _PERIODIC):
            return self.periodic(e)
        if isinstance(e, _EXPONENTIAL):
            return self.exponential(e)
        return self.letter(e)

    def multiples(self, e: Expr) -> list[tuple[Monomial, int]] | None:
        """Return the argument of a function as integer multiples of units, None if too large."""
        found = [(term, x * self.units.get(term, 1)) for term, x in self.of(e.args[0]).items()]
        if any(x.denominator != 1 or abs(x) > _LARGEST for _, x in found):
            return None
        return [(term, int(x)) for term, x in found]

    def periodic(self, e: Expr) -> Polynomial:
        """Return a trigonometric function in the sines and cosines of the terms of its argument."""
        multiples = self.multiples(e)
        if multiples is None:
            return self.letter(e)
        cosine, sine = _UNIT, _collected(())
        for term, count in multiples:
            c, s = (self.letter((name, term)) for name in ("cos", "sin"))
            ((letters, _),) = s.items()
            self.relations[letters[0][0]] = 2, _sum(_UNIT, self.times(c, c), -1)
            sign = 1 if count > 0 else -1
            for _ in range(abs(count)):
                cosine, sine = (
                    _sum(self.times(cosine, c), self.times(sine, s), -sign),
                    _sum(self.times(sine, c), self.times(cosine, s), sign),
                )
        above, below = {
            sympy.sin: (sine, None), sympy.cos: (cosine, None), sympy.tan: (sine, cosine),
            sympy.cot: (cosine, sine), sympy.sec: (None, cosine), sympy.csc: (None, sine),
        }[e.func]  # fmt: skip
        found = _UNIT if above is None else above
        return found if below is None else self.times(found, self.power(below, -1))

    def exponential(self, e: Expr) -> Polynomial:
        """Return an exponential or hyperbolic function in exponentials of terms."""
        multiples = self.multiples(e)
        if multiples is None:
            return self.letter(e)
        up = _UNIT
        for term, count in multiples:
            up = self.times(up, self.letter(("exp", term), count))
        down = self.power(up, -1)
        if isinstance(e, sympy.exp):
            return up
        sine, cosine = _sum(up, down, -1), _sum(up, down, 1)
        if isinstance(e, sympy.tanh):
            return self.times(sine, self.power(cosine, -1))
        return {t: x / 2 for t, x in (sine if isinstance(e, sympy.sinh) else cosine).items()}

    def reduced(self, a: Polynomial) -> Polynomial:
        """Return a times a nonzero factor, after substitution of all relations.

        Later letters are substituted first, because they depend on earlier ones.
        """
        for g in sorted(self.relations, reverse=True):
            degree, base = self.relations[g]
            exponents = [dict(term).get(g, 0) for term in a]
            least = min(exponents, default=0)
            shift = -(least // degree) * degree if least < 0 else 0
            if not shift and max(exponents, default=0) < degree:
                continue
            found: list[tuple[Monomial, Any]] = []
            for (term, x), exponent in zip(a.items(), exponents):
                whole, rest = divmod(exponent + shift, degree)
                others = dict(term) | {g: rest}
                kept = tuple(sorted((letter, k) for letter, k in others.items() if k))
                found += self.times({kept: x}, self.power(base, whole)).items()
            a = _collected(found)
        return a


_PERIODIC = of_sympy("sin cos tan cot sec csc")
_EXPONENTIAL = of_sympy("exp sinh cosh tanh")


def _collected(terms: Iterable[tuple[Any, Any]]) -> dict[Any, Any]:
    """Return a sum with like terms combined, without zeros."""
    found: dict[Any, Any] = {}
    for key, x in terms:
        found[key] = found.get(key, 0) + x
    return {key: x for key, x in found.items() if x}


def _product(one: Monomial, other: Monomial) -> Monomial:
    if not one or not other:
        return one or other
    return tuple(sorted(_collected((*one, *other)).items()))


def _sum(a: Polynomial, b: Polynomial, sign: int) -> Polynomial:
    """Return a + sign b."""
    return _collected((*a.items(), *((term, sign * x) for term, x in b.items())))
