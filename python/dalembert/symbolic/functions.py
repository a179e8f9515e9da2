"""The functions and numbers that a model may contain."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable

import sympy
from sympy.core.function import AppliedUndef

from .reading import FUNCTIONS
from .symbols import TIME, Expr
from .zeros import of_sympy

_STRUCTURE = (
    *of_sympy(
        "Add Mul Pow Symbol Rational Float NumberSymbol sec csc cot Max Min Piecewise Rel And Or "
        "Not ITE"
    ),
    sympy.functions.elementary.piecewise.ExprCondPair,
    sympy.logic.boolalg.BooleanAtom,
)


_NUMBERS = (sympy.Float, sympy.Rational)
_WITH_VALUES = (sympy.Pow, sympy.Function)


def require_known(
    expression: Expr, where: str, shown: Callable[[Expr], Expr] = lambda e: e
) -> None:
    """Raise ValueError if an expression has a part that cannot be compiled."""
    for e in sympy.preorder_traversal(expression):
        if isinstance(e, (*_STRUCTURE, *FUNCTIONS)):
            if isinstance(e, _NUMBERS) or (isinstance(e, _WITH_VALUES) and e.is_number):
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


def nearest(x: Expr, where: str = "") -> float:
    """Return the double nearest to a number; raise ValueError if there is none."""
    place = f"{where}{': ' * bool(where)}"
    try:
        found = x.p / x.q if x.is_Rational else float(x)
    except OverflowError:
        found = math.inf
    except TypeError:
        raise ValueError(f"{place}{x} is not a real number") from None
    if math.isinf(found) or (x != 0 and abs(found) < sys.float_info.min):
        size = "large" if math.isinf(found) else "small"
        raise ValueError(f"{place}{sympy.N(x, 5)} is too {size} for a double")
    return found
