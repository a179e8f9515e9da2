"""Power series of SymPy expressions, truncated, with 77 digits.

A `Tape` holds expressions as a list of operations, each of which finds its coefficient of order k
from coefficients of its arguments up to k; so series can be found order by order, where the next
one of the inputs follows from those of the expressions, as along the solution of an ODE.  Numbers
are integers, in units of 2**-BITS: for equal digits much faster than `mpmath.mpf` in NumPy arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mpmath
import numpy as np
import sympy
from sympy.logic.boolalg import BooleanAtom

from .._lib import Array

__all__ = ["BITS", "NotAnalytic", "Tape", "fixed", "real"]

Expr = Any

BITS = 256
# Below this, in units of 2**-BITS, an argument is at the place where |x|, say, has no derivative.
_KINK = 1 << (BITS // 2)


class NotAnalytic(ValueError):
    """An expression has no Taylor series where it was asked for one.

    Attributes
    ----------
    expression : sympy.Basic
    """

    def __init__(self, expression: Expr) -> None:
        super().__init__(f"{expression} has no Taylor series there")
        self.expression = expression


def fixed(x: Any) -> int:
    """Return a number as an integer."""
    return int(mpmath.libmp.to_fixed(mpmath.mpmathify(x)._mpf_, BITS))


def real(values: Any) -> Array:
    """Return integers as an array of ``mpmath.mpf``."""
    with mpmath.workprec(BITS):
        flat = [mpmath.ldexp(mpmath.mpf(int(i)), -BITS) for i in np.ravel(values)]
    return np.array(flat, dtype=object).reshape(np.shape(values))


class Tape:
    """Expressions as series up to an order, some series of each side by side.

    Parameters
    ----------
    orders : int
        The highest order.
    width : int
        How many series each expression has.
    inputs : mapping of sympy.Symbol to ndarray
        The coefficients of the symbols, shape (orders + 1, width); the caller sets those of order
        k before he calls ``advance(k, ...)``.
    definitions : mapping of sympy.Symbol to sympy.Expr
        What further symbols stand for.

    Examples
    --------
    >>> import sympy
    >>> from dalembert.growth.series import Tape, fixed, real
    >>> x = sympy.Symbol("x", real=True)
    >>> import numpy as np
    >>> line = np.array([[0], [fixed(1)], [0], [0]], dtype=object)
    >>> tape = Tape(3, 1, {x: line})
    >>> sine = tape.series(sympy.sin(2 * x))
    >>> for k in (1, 2, 3):
    ...     tape.advance(k)
    >>> [float(c) for c in real(sine[:, 0])]
    [0.0, 2.0, 0.0, -1.3333333333333333]
    """

    def __init__(
        self,
        orders: int,
        width: int,
        inputs: Mapping[Expr, Array],
        definitions: Mapping[Expr, Expr] | None = None,
    ) -> None:
        self.orders, self.width = orders, width
        self._series = dict(inputs)
        self._definitions = dict(definitions or {})
        self._operations: list[Callable[[int], None]] = []

    def __len__(self) -> int:
        return len(self._operations)

    def advance(self, k: int, start: int = 0, stop: int | None = None) -> None:
        """Find the coefficients of order k > 0 of all operations, or of some."""
        for operation in self._operations[start:stop]:
            operation(k)

    def series(self, e: Expr) -> Array:
        """Return the coefficients of an expression, shape (orders + 1, width); order 0 is set.

        Raises
        ------
        NotAnalytic
            If it has none, where the inputs have their coefficients of order 0.
        """
        found = self._series.get(e)
        if found is None:
            found = self._make(e)
            self._series[e] = found
        return found

    # ---- kinds of expressions ------------------------------------------------------------

    def _make(self, e: Expr) -> Array:
        if e in self._definitions:
            return self.series(self._definitions[e])
        if e.is_number:
            return self._constant(e)
        if e.is_Add:
            parts = [self.series(a) for a in e.args]
            return self._operation(lambda out, k: _put(out, k, sum(part[k] for part in parts)))
        if e.is_Mul:
            return self._product(e)
        if e.is_Pow:
            return self._power(e)
        if isinstance(e, sympy.Piecewise):
            for value, condition in e.args:
                if self._holds(condition):
                    return self.series(value)
            raise NotAnalytic(e)
        if isinstance(e, sympy.Max | sympy.Min):
            return self._extreme(e)
        if isinstance(e, sympy.Abs | sympy.sign | sympy.Heaviside | sympy.DiracDelta):
            argument = e.args[0]
            up = self._holds(argument > 0)
            return self.series(
                {
                    sympy.Abs: argument if up else -argument,
                    sympy.sign: sympy.Integer(1 if up else -1),
                    sympy.Heaviside: sympy.Integer(1 if up else 0),
                    sympy.DiracDelta: sympy.Integer(0),
                }[e.func]
            )
        return self._function(e)

    def _blank(self) -> Array:
        return np.zeros((self.orders + 1, self.width), dtype=object)

    def _operation(self, operation: Callable[[Array, int], None]) -> Array:
        """Add an operation, which sets ``out[k]``."""
        out = self._blank()
        operation(out, 0)
        self._operations.append(lambda k: operation(out, k))
        return out

    def _constant(self, e: Expr) -> Array:
        out = self._blank()
        out[0] = (int(e.p) << BITS) // int(e.q) if e.is_Rational else _number(e)
        return out

    def _product(self, e: Expr) -> Array:
        number, factors = e.as_coeff_mul()
        found = self.series(factors[0])
        for factor in factors[1:]:
            found = self._times(found, self.series(factor))
        if number == 1:
            return found
        scale = self._constant(number)[0]
        return self._operation(lambda out, k: _put(out, k, found[k] * scale >> BITS))

    def _times(self, a: Array, b: Array) -> Array:
        return self._operation(
            lambda out, k: _put(out, k, (a[: k + 1] * b[k::-1]).sum(axis=0) >> BITS)
        )

    def _power(self, e: Expr) -> Array:
        """Return a power; y = x^a has x y' = a x' y."""
        base, exponent = e.args
        if exponent.is_Integer and exponent > 1:
            half = self.series(base ** (exponent // 2))
            square = self._times(half, half)
            return self._times(square, self.series(base)) if exponent % 2 else square
        if not exponent.is_Rational:
            slopes: list[Array] = []
            power = self.series(exponent * sympy.log(base))
            slopes.append(self._composed(e, mpmath.exp, [power], slopes))
            return slopes[0]
        x, p, q = self.series(base), int(exponent.p), int(exponent.q)
        if min(abs(x[0])) <= _KINK:
            raise NotAnalytic(e)

        def operation(out: Array, k: int) -> None:
            if k == 0:
                out[0] = _each(e, lambda value: mpmath.power(value, mpmath.mpf(p) / q), x[0])
                return
            j = _counting(k)
            terms = (p * j - q * (k - j)) * x[1 : k + 1] * out[k - 1 :: -1]
            out[k] = terms.sum(axis=0) // (x[0] * (q * k))

        return self._operation(operation)

    def _function(self, e: Expr) -> Array:
        function = getattr(mpmath, e.func.__name__)
        slopes: list[Array] = []
        found = self._composed(e, function, [self.series(a) for a in e.args], slopes)
        self._series[e] = found  # the slope of the exponential is the exponential
        names = [sympy.Dummy(real=True) for _ in e.args]
        back = dict(zip(names, e.args))
        slopes += [self.series(e.func(*names).diff(x).xreplace(back)) for x in names]
        return found

    def _composed(
        self, e: Expr, function: Callable[..., Any], arguments: list[Array], slopes: list[Array]
    ) -> Array:
        """Return f(x, ...), for e: its derivative is the sum of slopes times those of x, ..."""

        def operation(out: Array, k: int) -> None:
            if k == 0:
                out[0] = _each(e, function, *(x[0] for x in arguments))
                return
            j = _counting(k)
            terms = [(j * x[1 : k + 1] * g[k - 1 :: -1]) for x, g in zip(arguments, slopes)]
            out[k] = sum(term.sum(axis=0) for term in terms) // k >> BITS

        return self._operation(operation)

    # ---- where there are branches ----------------------------------------------------------

    def _extreme(self, e: Expr) -> Array:
        best = e.args[0]
        for other in e.args[1:]:
            above = self._holds(other > best)
            best = other if above == isinstance(e, sympy.Max) else best
        return self.series(best)

    def _holds(self, condition: Expr) -> bool:
        """Return whether a condition holds; NotAnalytic if that is not the same nearby."""
        if isinstance(condition, BooleanAtom):
            return bool(condition)
        if isinstance(condition, sympy.Not):
            return not self._holds(condition.args[0])
        if isinstance(condition, sympy.And):
            return all(self._holds(part) for part in condition.args)
        if isinstance(condition, sympy.Or):
            return any(self._holds(part) for part in condition.args)
        difference = self.series(condition.lhs - condition.rhs)[0]
        if min(abs(difference)) <= _KINK or (min(difference) < 0 < max(difference)):
            raise NotAnalytic(condition)
        if isinstance(condition, sympy.Eq | sympy.Ne):
            return isinstance(condition, sympy.Ne)
        return (difference[0] > 0) == isinstance(condition, sympy.Gt | sympy.Ge)


def _put(out: Array, k: int, value: Any) -> None:
    out[k] = value


def _counting(k: int) -> Array:
    """Return 1, ..., k as a column."""
    return np.arange(1, k + 1, dtype=object)[:, np.newaxis]


def _number(e: Expr) -> int:
    with mpmath.workprec(BITS + 32):
        return fixed(e._to_mpmath(BITS + 32))


def _each(e: Expr, function: Callable[..., Any], *arguments: Sequence[int]) -> list[int]:
    """Return a function, for e, of integers that stand for numbers; each is computed once."""
    known: dict[tuple[int, ...], int] = {}
    with mpmath.workprec(BITS + 32):
        for point in set(zip(*arguments)):
            try:
                value = function(*(mpmath.ldexp(mpmath.mpf(x), -BITS) for x in point))
            except (ValueError, ZeroDivisionError) as error:
                raise NotAnalytic(e) from error
            if not isinstance(value, mpmath.mpf) or not mpmath.isfinite(value):
                raise NotAnalytic(e)
            known[point] = fixed(value)
    return [known[point] for point in zip(*arguments)]
