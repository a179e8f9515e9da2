"""Expressions as C, for numbers and for vectors, and the lines of a program."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import sympy
from sympy.logic.boolalg import BooleanFalse, BooleanTrue

from .functions import FUNCTIONS, nearest


@dataclass
class Program:
    """C source, line by line.

    Attributes
    ----------
    lines : list of (str, callable or None)
        A line, and a function that returns a description of its result and its expression; None if
        it has no expression.
    """

    lines: list[tuple[str, Callable[[], tuple[str, Any]] | None]] = field(default_factory=list)

    @property
    def source(self) -> str:
        """The source code."""
        return "".join(f"{line}\n" for line, _ in self.lines)

    def add(self, text: str) -> None:
        """Add lines without an expression."""
        self.lines.extend((line, None) for line in text.split("\n"))

    def origin(self, number: int, shown: Callable[[Any], Any]) -> str:
        """Return the result that a line, counted from 1, computes, in terms of ``shown``."""
        _, origin = self.lines[number - 1]
        if origin is None:
            return ""
        what, expression = origin()
        return f"{what} = {shown(expression)}"

# Functions that the math library of C has not: those of _HELPERS, and 1 over one that it has.
_OWN = {sympy.sign: "model_sign", sympy.Heaviside: "model_step"}
_OF_TWO = {sympy.Max: "model_larger", sympy.Min: "model_smaller"}
_INVERSE = {sympy.sec: "cos", sympy.csc: "sin", sympy.cot: "tan"}


class Printer:
    """Expressions as C, from a closed list of functions.

    Attributes
    ----------
    powers : set of int
        Exponents for which `_power` is needed.
    real, nowhere : str
        The type of a number, and the NaN of this type.
    """

    real, nowhere = "double", "NAN"

    def __init__(self, powers: set[int]) -> None:
        self.powers = powers

    def name(self, name: str) -> str:
        """Return the name of a generated function."""
        return name

    def whole(self, e: Any) -> str:
        """Return an expression that is complete, or an argument."""
        return self(e)

    def call(self, name: str, *arguments: str) -> str:
        return f"{name}({', '.join(arguments)})"

    def choice(self, condition: str, value: str, other: str) -> str:
        return f"({condition} ? {value} : {other})"

    def __call__(self, e: Any) -> str:
        if e.is_Symbol:
            return str(e.name)
        if e.is_Add:
            return f"({self._sum(e)})"
        if e.is_Mul:
            return self._product(e)
        if e.is_Pow:
            return self._power(e.base, e.exp)
        if e.is_Number or e.is_NumberSymbol:
            return self._number(e)
        return self._function(e)

    def _sum(self, e: Any) -> str:
        text = ""
        for i, term in enumerate(e.args):
            negative = term.could_extract_minus_sign() and (term.is_Number or term.is_Mul)
            part = self(-term if negative else term)
            text += (" - " if i else "-") + part if negative else (" + " if i else "") + part
        return text

    def _product(self, e: Any) -> str:
        coefficient, factors = e.as_coeff_mul()
        above, below = [], []
        for factor in factors:
            if factor.is_Pow and factor.exp.is_Rational and factor.exp.is_negative:
                below.append(self._power(factor.base, -factor.exp))
            else:
                above.append(self(factor))
        sign = ""
        if coefficient.is_negative:
            sign, coefficient = "-", -coefficient
        if coefficient != 1 or not above:
            above.insert(0, self._number(coefficient))
        text = " * ".join(above)
        if below:
            text += " / " + (below[0] if len(below) == 1 else f"({' * '.join(below)})")
        return f"({sign}{text})"

    def _power(self, base: Any, exponent: Any) -> str:
        if base == sympy.E:
            return self.call("exp", self.whole(exponent))
        if exponent.is_Rational and exponent.is_negative:
            return f"(1.0 / {self._power(base, -exponent)})"
        if exponent == 1:
            return self(base)
        if exponent == sympy.Rational(1, 2):
            return self.call("sqrt", self.whole(base))
        if exponent.is_Integer and 2 <= exponent <= 64:
            self.powers.add(int(exponent))
            return self.call(f"model_power_{int(exponent)}", self.whole(base))
        return self.call("pow", self.whole(base), self.whole(exponent))

    def _number(self, e: Any) -> str:
        text = repr(nearest(e))
        return f"({text})" if text.startswith("-") else text

    def _function(self, e: Any) -> str:
        if isinstance(e, sympy.Piecewise):
            text = self.nowhere
            for value, condition in reversed(e.args):
                text = self.whole(value) if condition == sympy.true else (
                    self.choice(self._condition(condition), self.whole(value), text)
                )
            return text
        parts = map(self.whole, e.args)
        if name := FUNCTIONS.get(e.func) or _OWN.get(e.func):
            return self.call(name, *parts)
        if name := _OF_TWO.get(e.func):
            return functools.reduce(lambda one, other: self.call(name, one, other), parts)
        if name := _INVERSE.get(e.func):
            return f"(1.0 / {self.call(name, next(parts))})"
        raise ValueError(f"{e} ({type(e).__name__}) cannot be written in C")

    _signs = {"and": " && ", "or": " || ", "not": "!", True: "1", False: "0"}

    def _condition(self, e: Any) -> str:
        if isinstance(e, BooleanTrue | BooleanFalse):
            return self._signs[bool(e)]
        if isinstance(e, sympy.core.relational.Relational):
            return f"({self.whole(e.lhs)} {e.rel_op} {self.whole(e.rhs)})"
        if isinstance(e, sympy.Not):
            return f"{self._signs['not']}{self._condition(e.args[0])}"
        if isinstance(e, sympy.And | sympy.Or):
            sign = self._signs["and" if isinstance(e, sympy.And) else "or"]
            return f"({sign.join(map(self._condition, e.args))})"
        raise ValueError(f"{e} ({type(e).__name__}) cannot be written in C")


class VectorPrinter(Printer):
    """Expressions as C for vectors; expressions without symbols remain numbers.

    Attributes
    ----------
    called : set of str
        The functions of the math library that are used.
    """

    real, nowhere = "dal_vec", "DAL_LANES(all_of)(NAN)"
    _signs = {
        "and": " & ", "or": " | ", "not": "~", True: "~(dal_mask){0}", False: "(dal_mask){0}",
    }  # fmt: skip

    def __init__(self, powers: set[int]) -> None:
        super().__init__(powers)
        self.called: set[str] = set()

    def __call__(self, e: Any) -> str:
        return super().__call__(e) if e.free_symbols else Printer(set())(e)

    def name(self, name: str) -> str:
        return f"DAL_LANES({name})"

    def whole(self, e: Any) -> str:
        return self(e) if e.free_symbols else f"DAL_LANES(all_of)({self(e)})"

    def call(self, name: str, *arguments: str) -> str:
        if name != "fabs" and not name.startswith("model_"):
            self.called.add(name)
        return super().call(self.name(name), *arguments)

    def choice(self, condition: str, value: str, other: str) -> str:
        return super().call("DAL_LANES(choose)", condition, value, other)
