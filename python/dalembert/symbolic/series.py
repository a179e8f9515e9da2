"""The ODE on D of a model in expressions of heyoka, for its Taylor series."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import sympy

from .functions import nearest
from .model import Model
from .symbols import TIME
from .zeros import of_sympy

Expr = Any
Term = Any  # an expression of heyoka; None: 0

_FUNCTIONS = {
    getattr(sympy, name): name
    for name in (
        "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh",
        "acosh", "atanh", "erf", "atan2",
    )
}  # fmt: skip
_INVERSE = {sympy.sec: "cos", sympy.csc: "sin", sympy.cot: "tan"}
# At real arguments they end, or jump, where a series may go on: as that of sqrt(t^2) does at 0.
_BRANCHED = of_sympy("log asin acos acosh atanh atan2")


def ode(model: Model, heyoka: Any) -> tuple[list[tuple[Any, Any]], bool]:
    """Return the pairs of a variable and its rate, and whether the series may pass a branch point.

    The variables are (q, v).  The parameters of heyoka are the parameters of the model, then its
    inputs.  The multipliers are eliminated as in field.h.

    Raises
    ------
    ValueError
        If an expression has no Taylor series.  The message has it, in the user's names.
    """
    formula = model.derived.read.formula
    outputs = {name: [*map(formula, x)] for name, x in model.derived.terms.outputs.items()}
    outputs = {
        name: [e.replace(_is_whole, lambda part: part.args[-1].expr) for e in x]
        for name, x in outputs.items()
    }
    if model.derived.mass is not None:
        outputs["M"] = [*map(formula, model.derived.mass)]
    temporaries, reduced = sympy.cse(
        [e for x in outputs.values() for e in x], sympy.numbered_symbols("x"), list=False
    )
    variables = heyoka.make_vars(*(s.name for s in (*model.q, *model.v)))
    known = dict(zip((*model.q, *model.v), variables)) | {TIME: heyoka.time}
    known |= {s: heyoka.par[i] for i, s in enumerate((*model.p, *model.u))}
    write = _Writer(heyoka, known, model.shown)
    for symbol, e in temporaries:
        known[symbol] = write(e)
    terms = iter([None if e == 0 else write(e) for e in reduced])
    made = {name: [next(terms) for _ in x] for name, x in outputs.items()}
    n, m = model.n, model.m
    rows = [made["mu"][a * n : (a + 1) * n] for a in range(m)]
    M = [made["M"][i * n : (i + 1) * n] for i in range(n)]
    free, *Z = _solve(M, [made["F"], *rows])
    C = [[_dot(row, z) for z in Z] for row in rows]
    right = [_sum(_dot(row, free), g) for row, g in zip(rows, made.get("g", ()))]
    (lack,) = _solve(C, [right])
    rates = [_sum(free[i], None, _dot([z[i] for z in Z], lack)) for i in range(n)]
    zero = heyoka.expression(0.0)
    pairs = [*zip(variables[:n], variables[n:])]
    pairs += [(x, zero if rate is None else rate) for x, rate in zip(variables[n:], rates)]
    return pairs, any(map(_is_branched, (*(e for _, e in temporaries), *reduced)))


def _is_whole(e: Expr) -> bool:
    """Return whether an expression is Piecewise((0, n = 0), (f, True)) with f = 0 at n = 0.

    The derivative n x^(n - 1) of x^n has these two pieces, because it is undefined at n = 0 and x =
    0.
    """
    if not isinstance(e, sympy.Piecewise):
        return False
    (value, condition), *_, (rest, always) = e.args
    equal = isinstance(condition, sympy.Eq) and len(e.args) == 2 and always == sympy.true
    return bool(equal and value == 0 == rest.xreplace({condition.lhs: condition.rhs}))


def _is_branched(e: Expr) -> bool:
    powers = e.atoms(sympy.Pow)
    return e.has(*_BRANCHED) or any(not p.exp.is_Integer and p.base != sympy.E for p in powers)


# ---- elimination -------------------------------------------------------------------------------


def _sum(a: Term, b: Term = None, less: Term = None) -> Term:
    found = b if a is None else a if b is None else a + b
    if less is None:
        return found
    return -less if found is None else found - less


def _product(a: Term, b: Term) -> Term:
    return None if a is None or b is None else a * b


def _dot(a: list[Term], b: list[Term]) -> Term:
    found = None
    for x, y in zip(a, b):
        found = _sum(found, _product(x, y))
    return found


def _solve(A: list[list[Term]], rights: list[list[Term]]) -> list[list[Term]]:
    """Return A^-1 times each right side, for a positive definite A, without pivoting."""
    A, rights, n = [[*row] for row in A], [[*x] for x in rights], len(A)
    for j in range(n):
        for i in range(j + 1, n):
            if A[i][j] is None:
                continue
            share = A[i][j] / A[j][j]
            for k in range(j + 1, n):
                A[i][k] = _sum(A[i][k], None, _product(share, A[j][k]))
            for x in rights:
                x[i] = _sum(x[i], None, _product(share, x[j]))
    for x in rights:
        for i in reversed(range(n)):
            for k in range(i + 1, n):
                x[i] = _sum(x[i], None, _product(A[i][k], x[k]))
            x[i] = None if x[i] is None else x[i] / A[i][i]
    return rights


# ---- expressions -------------------------------------------------------------------------------


class _Writer:
    """Conversion of SymPy expressions to heyoka expressions."""

    def __init__(self, heyoka: Any, known: dict[Expr, Any], shown: Callable[[Expr], Expr]) -> None:
        self.heyoka, self.known, self.shown = heyoka, known, shown

    def __call__(self, e: Expr) -> Any:
        if e.is_Symbol:
            return self.known[e]
        if e.is_Number or e.is_NumberSymbol:
            return self.heyoka.expression(nearest(e))
        if e.is_Add:
            return self.heyoka.sum([self(x) for x in e.args])
        if e.is_Mul:
            return self.product(e)
        if e.is_Pow:
            return self.power(e.base, e.exp)
        if name := _FUNCTIONS.get(e.func):
            return getattr(self.heyoka, name)(*map(self, e.args))
        if name := _INVERSE.get(e.func):
            return 1.0 / getattr(self.heyoka, name)(self(e.args[0]))
        shown = e if e.free_symbols - self.known.keys() else self.shown(e)
        raise ValueError(
            f"method = 'taylor': {shown} ({type(e).__name__}) has no Taylor series where it "
            "jumps or has a kink; choose rk8pd, msadams or rodas"
        )

    def product(self, e: Expr) -> Any:
        above = [x for x in e.args if not (x.is_Pow and x.exp.is_negative)]
        below = [self.power(x.base, -x.exp) for x in e.args if x.is_Pow and x.exp.is_negative]
        found = self.heyoka.prod([*map(self, above)] or [self.heyoka.expression(1.0)])
        return found / self.heyoka.prod(below) if below else found

    def power(self, base: Expr, exponent: Expr) -> Any:
        """Return a power; integer powers become products, for heyoka's have no series at 0."""
        if base == sympy.E:
            return self.heyoka.exp(self(exponent))
        if exponent.is_Integer and 1 <= abs(exponent) <= 64:
            square, found, left = self(base), None, abs(int(exponent))
            while left:
                if left % 2:
                    found = square if found is None else found * square
                left //= 2
                square = square * square if left else square
            return 1.0 / found if exponent < 0 else found
        if exponent == sympy.Rational(1, 2):
            return self.heyoka.sqrt(self(base))
        return self(base) ** self(exponent)
