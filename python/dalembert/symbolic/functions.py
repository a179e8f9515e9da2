"""The functions and numbers that a model may contain, and numbers as doubles."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable

import sympy
from sympy.core.function import AppliedUndef

from . import formula
from .symbols import TIME, Expr
from .zeros import of_sympy

# Functions that both C and the math module have, or that are printed by their definition.
FUNCTIONS = {getattr(sympy, x): x for x in formula.FUNCTIONS if x not in ("Abs", "sqrt")}
FUNCTIONS[sympy.Abs] = "fabs"

_STRUCTURE = (
    *of_sympy(
        "Add Mul Pow Symbol Rational Float NumberSymbol sec csc cot sign Heaviside Max Min "
        "Piecewise Rel And Or Not"
    ),
    sympy.functions.elementary.piecewise.ExprCondPair,
    sympy.logic.boolalg.BooleanAtom,
)


def require_known(
    expression: Expr, where: str, shown: Callable[[Expr], Expr] = lambda e: e
) -> None:
    """Raise ValueError if an expression has a part that cannot be compiled."""
    for e in sympy.preorder_traversal(expression):
        if isinstance(e, (*_STRUCTURE, *FUNCTIONS)):
            if isinstance(e, sympy.Float | sympy.Rational):
                nearest(e, where)
            continue
        if isinstance(e, AppliedUndef):
            hint = "write its formula instead"
            if [str(x) for x in e.args] == [TIME.name]:
                hint = (
                    "list a coordinate in coordinates=, and an input of a force or a "
                    "constraint in inputs=. Replace a generalized speed by velocities, with "
                    f"its kinematic differential equation, for example by .subs({shown(e)}, "
                    "...)"
                )
            raise ValueError(f"{where}: {shown(e)} is an unknown function; {hint}")
        names = {f.__name__ for f in (*FUNCTIONS, *_STRUCTURE) if issubclass(f, sympy.Function)}
        raise ValueError(
            f"{where}: {shown(e)} ({type(e).__name__}) cannot be compiled; expected "
            "expressions of "
            f"{', '.join(sorted({*names, 'sqrt', 'Max', 'Min', 'And', 'Or', 'Not'}))}"
        )


def in_doubles(e: Expr, digits: int = 15) -> Expr:
    """Return an expression whose long numbers are replaced by doubles of so many digits."""
    return e.xreplace({
        x: sympy.Float(nearest(x), digits) for x in e.atoms(sympy.Rational, sympy.Float)
        if x.is_Float or max(abs(x.p), x.q) >= 2**53
    })  # fmt: skip


def nearest(x: Expr, where: str = "") -> float:
    """Return the double nearest to a number; raise ValueError if it is out of range."""
    try:
        found = x.p / x.q if x.is_Rational else float(x)
    except OverflowError:
        found = math.inf
    if math.isinf(found) or (x != 0 and abs(found) < sys.float_info.min):
        size = "large" if math.isinf(found) else "small"
        raise ValueError(f"{where}{': ' * bool(where)}{sympy.N(x, 5)} is too {size} for a double")
    return found


def with_default(e: Expr) -> Expr:
    """Return an expression for `lambdify`: a Piecewise without a default becomes NaN there."""
    return e.replace(
        lambda part: isinstance(part, sympy.Piecewise) and part.args[-1].cond != sympy.true,
        lambda part: part.func(*part.args, (sympy.nan, True)),
    )
