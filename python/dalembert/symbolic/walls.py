"""Proofs that a derivative needs no DiracDelta where a formula jumps."""

from __future__ import annotations

from typing import Any

import sympy

from .zeros import is_zero, of_sympy

Expr = Any


def is_without_jump(factor: Expr, argument: Expr) -> bool:
    """Return whether a factor is proved to vanish with the argument of its DiracDelta.

    The factor is the derivative by the function that jumps.
    """
    return _vanishes_with(factor, argument) or all(
        _vanishes_with(factor, part) for part in _zero_with(argument)
    )


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
