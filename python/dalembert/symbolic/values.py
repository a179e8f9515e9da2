"""Values of nodes with many digits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mpmath

from .graph import Node, below

def values(nodes: Sequence[Node], point: Mapping[str, Any]) -> list[Any]:
    """Return the values of nodes at a point, given by symbol, in the precision of mpmath.

    A node that is not defined there is NaN.
    """
    found: dict[Node, Any] = {}
    for e in below(nodes):
        try:
            found[e] = _value(e, [found[a] for a in e.args], point)
        except (ArithmeticError, AttributeError, TypeError, ValueError):  # as of a complex number
            found[e] = mpmath.nan
    return [found[e] for e in nodes]


def may_vanish(nodes: Sequence[Node], point: Mapping[str, Any]) -> list[bool]:
    """Return for each node whether it is 0, or not defined, at a point with 50 digits."""
    with mpmath.workdps(50):
        found = values([*nodes, *below(nodes)], point)
        least = mpmath.ldexp(max((abs(x) for x in found if mpmath.isfinite(x)), default=1), -100)
        return [not abs(x) > least for x in found[: len(nodes)]]


def _value(e: Node, args: list[Any], point: Mapping[str, Any]) -> Any:
    op = e.op
    if op in _VALUES:
        return _VALUES[op](*args)
    if op == "symbol":
        return mpmath.mpf(point[e.value])
    if op == "number":
        return mpmath.mpf(e.value.numerator) / e.value.denominator
    if op == "constant":
        return e.value._to_mpmath(mpmath.mp.prec)
    if op == "pow":
        return mpmath.power(args[0], mpmath.mpf(e.value.numerator) / e.value.denominator)
    if any(mpmath.mag(x) > _LARGEST for x in args if x):
        raise OverflowError  # a sine would reduce it by pi without an end
    return getattr(mpmath, op)(*args)


_LARGEST = 2000  # the exponent of 2 of an argument

_VALUES = {
    "+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b,
    "max": max, "min": min, "step": lambda x, at_zero: at_zero if x == 0 else int(x > 0),
    "choose": lambda condition, a, b: a if condition else b, "nan": lambda: mpmath.nan,
    "<": lambda a, b: a < b, "<=": lambda a, b: a <= b, "==": lambda a, b: a == b,
    "!=": lambda a, b: a != b, "and": lambda a, b: a and b, "or": lambda a, b: a or b,
    "not": lambda a: not a, "true": lambda: True,
}  # fmt: skip
