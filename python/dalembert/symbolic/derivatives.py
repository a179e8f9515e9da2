"""Derivatives of expressions, with SymPy or SymEngine, and the jumps that they do not have."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any

import sympy
from sympy.logic.boolalg import Boolean

try:
    import symengine
except ImportError:
    symengine = None

from .symbols import Expr, Rule
from .zeros import is_zero, of_sympy


# ---- jumps -----------------------------------------------------------------------------------


class Jump(Exception):
    """A derivative that needs a DiracDelta of args[1], by the symbol args[0]."""


def _gradient(e: Expr, symbols: Collection[Expr]) -> Rule:
    """Return the derivatives of an expression by those symbols that occur in it.

    The results are those of ``sympy.diff``, which would traverse all terms of all sums for each
    symbol.
    """
    if not e.is_Add and not e.is_Mul:
        e = e.replace(_is_parametric, lambda power: _Power(*power.args))
        found = {s: sympy.diff(e, s) for s in e.free_symbols if s in symbols}
        return {s: slope.replace(_Power, sympy.Pow) for s, slope in found.items()}
    slopes: dict[Expr, list[Expr]] = {}
    for i, part in enumerate(e.args):
        for s, slope in _gradient(part, symbols).items():
            slopes.setdefault(s, []).append(
                slope if e.is_Add else sympy.Mul(*e.args[:i], slope, *e.args[i + 1 :])
            )
    return {s: sympy.Add(*found) for s, found in slopes.items()}


class _Power(sympy.Function):
    """x^n with a parameter n; SymPy's derivative n x^n / x is 0/0 at x = 0."""

    def fdiff(self, argindex: int = 1) -> Expr:
        x, n = self.args
        return sympy.Piecewise((0, sympy.Eq(n, 0)), (n * _Power(x, n - 1), True))


def _is_parametric(e: Expr) -> bool:
    """Return whether an expression is a power whose exponent is constant but not rational."""
    return bool(e.is_Pow and not e.exp.is_Rational and not e.base.is_number and _is_constant(e.exp))


def _as_function(found: Expr, symbol: Expr, almost: bool) -> Expr:
    """Return a derivative by a symbol as a function.

    A DiracDelta is dropped if its factor vanishes with its argument, as in the derivative of x^2
    sign(x).  If `almost`, it is always dropped, for a derivative that may be wrong at jumps.
    """
    for delta in found.atoms(sympy.DiracDelta):
        mark = sympy.Dummy(real=True)
        marked = found.xreplace({delta: mark})
        if not almost and not _is_without_jump(marked.diff(mark), delta.args[0], symbol):
            raise Jump(symbol, delta.args[0])
        found = marked.xreplace({mark: sympy.Integer(0)})
    return found.replace(_is_inverse, _bounded) if almost else found


def _is_inverse(e: Expr) -> bool:
    """Return whether a power may be infinite on one side of a wall, as 1/sqrt(Max(0, x))."""
    return e.is_Pow and not e.exp.is_nonnegative and e.base.has(sympy.Max, sympy.Min, sympy.Abs)


def _bounded(e: Expr) -> Expr:
    """Return a power that is 1 if its base is 0, so that a step function as factor makes it 0."""
    return sympy.Piecewise((e.base, sympy.Ne(e.base, 0)), (1, True)) ** e.exp


def _is_without_jump(factor: Expr, argument: Expr, symbol: Expr) -> bool:
    """Return whether a factor is proved to vanish with the argument of its DiracDelta.

    The jump is the factor divided by the slope of the argument: sign(x^3) jumps although 3 x^2
    vanishes.
    """
    if _vanishes_with(factor, argument):
        return True
    slope = argument.diff(symbol)
    terms = map(sympy.factor_terms, sympy.Add.make_args(factor))
    height = sympy.Add(*(term / sympy.factor_terms(slope) for term in terms))
    return all(_vanishes_with(height, part) for part in _zero_with(argument))


_Step = sympy.Function("_Step")


def _vanishes_with(factor: Expr, argument: Expr) -> bool:
    """Return whether a factor is proved to vanish with an argument.

    A step function may have any value at its jump: sign(x)^3 is 0 at 0 and yet jumps.
    """
    factor = factor.replace(sympy.sign, lambda u: 2 * _Step(u) - 1)
    factor = factor.replace(sympy.Heaviside, lambda u, _: _Step(u))
    places = [factor.subs(argument, 0).subs(-argument, 0)]
    for s in argument.free_symbols:
        slope = argument.diff(s)
        if slope != 0 and _is_constant(slope):
            places.append(factor.xreplace({s: sympy.expand(s - argument / slope)}))
    return any(
        is_zero(e.replace(_Step, lambda u: sympy.Heaviside(u) if u.is_nonzero else _Step(u)))
        for e in places
    )


def _zero_with(e: Expr) -> list[Expr]:
    """Return expressions such that one of them is 0 wherever e is 0."""
    if e.is_Mul:
        return [part for factor in e.args for part in _zero_with(factor)]
    if e.is_Pow and e.exp.is_positive:
        return _zero_with(e.base)
    if isinstance(e, _ONE_ZERO):
        return _zero_with(e.args[0])
    return [] if e.is_nonzero or _is_constant(e) else [e]


# Real functions that are 0 at 0 alone.
_ONE_ZERO = of_sympy("Abs sinh tanh asinh asin atan erf")


def _is_constant(e: Expr) -> bool:
    """Return whether an expression has no symbols except parameters, and so counts as nonzero."""
    return all(s.name[0] == "p" for s in e.free_symbols)


# ---- two ways to differentiate ---------------------------------------------------------------


# What SymEngine differentiates as SymPy does; for the rest it lacks assumptions or rules.
_SMOOTH = of_sympy(
    "Add Mul Pow Symbol Number NumberSymbol exp log sin cos tan asin acos atan sinh cosh tanh"
)


class SymPy:
    """Derivatives, by the symbols that occur, and common subexpressions, with SymPy."""

    name = f"sympy {sympy.__version__}"

    @staticmethod
    def take(expression: Expr) -> Expr:
        return expression

    give = take

    @staticmethod
    def gradient(expression: Expr, symbols: Sequence[Expr], almost: bool = False) -> Rule:
        slopes = _gradient(expression, {*symbols})
        return {x: _as_function(slopes[x], x, almost) for x in symbols if x in slopes}

    @staticmethod
    def cse(expressions: list[Expr]) -> tuple[list[tuple[Expr, Expr]], list[Expr]]:
        found, reduced = sympy.cse(
            expressions, sympy.numbered_symbols("x"), order="none", list=False
        )
        conditions: Rule = {}  # what is no number stays where it is
        temporaries = []
        for symbol, e in found:
            e = e.xreplace(conditions)
            if isinstance(e, Boolean) and not e.is_Symbol:
                conditions[symbol] = e
            else:
                temporaries.append((symbol, e))
        return temporaries, [e.xreplace(conditions) for e in reduced]


class SymEngine:
    """The same with SymEngine, 60 to 80 times faster."""

    name = f"symengine {getattr(symengine, '__version__', '')}"

    @staticmethod
    def take(expression: Expr) -> Expr:
        return symengine.sympify(expression)

    @staticmethod
    def gradient(expression: Expr, symbols: Sequence[Expr], almost: bool = False) -> Rule:
        occurring = expression.free_symbols  # and what is smooth has no jumps
        return {x: symengine.diff(expression, x) for x in symbols if x in occurring}

    @staticmethod
    def cse(expressions: list[Expr]) -> tuple[list[tuple[Expr, Expr]], list[Expr]]:
        return symengine.cse(expressions)

    @staticmethod
    def give(expression: Expr) -> Expr:
        found = sympy.sympify(expression)
        # SymEngine's symbols have no assumptions; only those of the model have any.
        return found.xreplace({s: sympy.Symbol(s.name, real=True) for s in found.free_symbols})


def engine_for(expressions: Iterable[Expr]) -> Any:
    """Return the fastest installed engine that supports the expressions."""
    return SymEngine if symengine is not None and _are_smooth(expressions) else SymPy


def _are_smooth(expressions: Iterable[Expr]) -> bool:
    """Return whether all functions in the expressions are smooth."""
    seen: set[Expr] = set()
    left = list(expressions)
    while left:
        e = left.pop()
        if e not in seen:
            if not isinstance(e, _SMOOTH) or _is_parametric(e):
                return False
            seen.add(e)
            left += e.args
    return True


def default_engine() -> str:
    """Return the name and version of the engine for smooth models."""
    return SymPy.name if symengine is None else SymEngine.name
