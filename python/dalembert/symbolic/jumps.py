"""Jumps of the formulas of a model: terms such as sign(v) near a state."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence

import sympy
from sympy.core.relational import Relational

from .model import Model
from .symbols import TIME, Expr

NEAR = 1e-6  # relative to the terms of what changes its sign


def jumps(
    model: Model,
    values: Mapping[str, float],
    t: float,
    x: Sequence[float],
    u: Sequence[float],
    near: bool = True,
) -> list[str]:
    """Return the terms that jump, or have a kink, near the state x at time t, in words.

    Each text has the formula of the term, in the user's names.  If ``near`` is false, the result
    has all such terms of the model.
    """
    symbols = (*model.q, *model.v, *model.p, *model.u, TIME)
    numbers = dict(zip(symbols, map(float, (*x, *values.values(), *u, t))))
    formulas: list[tuple[str, Expr]] = [("L", model.L)]
    formulas += [(f"constraints[{a}]", e) for a, e in enumerate(model.constraints)]
    formulas += [(f"the force on {x}", e) for x, e in zip(model.coordinates, model.force or ())]
    found = (
        f"{model.shown(term)} in {name}"
        for name, e in formulas
        for term, argument in sorted(_arguments(e), key=str)
        if not near or _is_near_zero(argument, numbers)
    )
    return list(dict.fromkeys(found))


def _arguments(e: Expr) -> Iterator[tuple[Expr, Expr]]:
    """Yield the terms that jump, each with the expression that changes sign there."""
    for term in e.atoms(sympy.sign, sympy.Heaviside, sympy.Abs):
        yield term, term.args[0]
    for term in e.atoms(sympy.Piecewise):
        for condition in term.atoms(Relational):
            yield term, condition.lhs - condition.rhs
    for term in e.atoms(sympy.Max, sympy.Min):
        for one, other in itertools.combinations(term.args, 2):
            yield term, one - other


def _is_near_zero(argument: Expr, numbers: Mapping[Expr, float]) -> bool:
    """Return whether an argument is much smaller than its terms."""
    terms = [_number(term, numbers) for term in sympy.Add.make_args(argument)]
    size = max(map(abs, terms)) if len(terms) > 1 else 1.0
    return abs(math.fsum(terms)) <= NEAR * size


def _number(e: Expr, numbers: Mapping[Expr, float]) -> float:
    """Return the value of an expression, or NaN."""
    try:
        return float(e.xreplace({s: sympy.Float(x) for s, x in numbers.items()}))
    except (TypeError, ValueError, OverflowError):
        return math.nan
