"""The formulas of a system as SymPy expressions: a model of a system that was not made from one."""

from __future__ import annotations

import re
from typing import Any

import sympy

from . import given
from ..core import Handle
from ..formula import Node, read
from .model import FUNCTIONS, Model

__all__ = ["model"]

Expr = Any

_CALLS = {name: function for function, name in FUNCTIONS.items()} | {
    "abs": sympy.Abs,
    "sqrt": sympy.sqrt,
}


def model(system: Handle) -> Model:
    """Return the model that the formulas of a system describe.

    An index i in them runs over what the coordinates say: over 0, 1, 2 if there are theta0, theta1
    and theta2; what is defined by ``u_(i-1)`` begins with its second value.

    Raises
    ------
    ValueError
        If it has no formulas, or they do not say all.

    Examples
    --------
    >>> import dalembert as dal
    >>> from dalembert import expressions
    >>> found = expressions.model(dal.systems.heisenberg())
    >>> found.shown(found.constraints[0])
    -x*y.d + y*x.d + z.d
    """
    return _Formulas(system).model()


class _Formulas:
    """What the lines of a system say, with symbols by name."""

    def __init__(self, system: Handle) -> None:
        self.system = system
        self.velocities = {f"v_{name}" for name in system.coordinates}
        self.indices = _indices(system)
        self.defined: dict[str, Expr] = {}
        for line in system.formulas:
            if line.startswith("where "):
                self.define(line.removeprefix("where "))

    def define(self, line: str) -> None:
        """Keep what a name stands for, or names with each index."""
        name, _, text = line.partition(" = ")
        if not name.endswith("_i"):
            self.defined[name] = self.expression(read(text))
            return
        first = 1 if "_(i-1)" in text else 0
        for i in self.indices[first:]:
            self.defined[_indexed(name, i, self.velocities)] = self.expression(read(text), i)

    def model(self) -> Model:
        lines = [line for line in self.system.formulas if not line.startswith("where ")]
        if not lines:
            raise ValueError(f"the system {self.system.name!r} has no formulas")
        L, *rest = (read(line) for line in lines)
        constraints = []
        for equation in rest:
            left, right = equation.parts
            indices = self.indices if _has_index(equation) else [None]
            for i in indices:
                constraints.append(self.whole(left, i) - self.whole(right, i))
        coordinates = [
            (sympy.Symbol(name), sympy.Symbol(f"v_{name}")) for name in self.system.coordinates
        ]
        made, _ = given.make_model(
            self.whole(L.parts[1]), constraints, coordinates, self.system.parameters,
            None, None, None, None,
        )  # fmt: skip
        return made

    def whole(self, node: Node, i: int | None = None) -> Expr:
        """Return an expression in coordinates, velocities and parameters alone."""
        found = self.expression(node, i)
        rule = {sympy.Symbol(name): e for name, e in self.defined.items()}
        for _ in rule:
            found = found.xreplace(rule)
        return found

    def expression(self, node: Node, i: int | None = None) -> Expr:
        """Return the expression of a part; i is what an index stands for."""
        if node.kind == "number":
            return sympy.Rational(node.text)
        if node.kind == "name":
            known = self.velocities | {*self.system.coordinates}
            return sympy.Symbol(_indexed(node.text, i, known))
        if node.kind == "call":
            return self.call(node, i)
        parts = [self.expression(part, i) for part in node.parts]
        match node.kind:
            case "sum":
                return sympy.Add(*parts)
            case "product":
                return sympy.Mul(*parts)
            case "quotient":
                return parts[0] / parts[1]
            case "power":
                return parts[0] ** parts[1]
            case "minus":
                return -parts[0]
            case "bracket":
                return parts[0]
        raise ValueError(f"formulas of {self.system.name!r}: {node.kind} out of place")

    def call(self, node: Node, i: int | None) -> Expr:
        (inside,) = node.parts
        if node.text == "sum_i":
            return sympy.Add(*(self.expression(inside, k) for k in self.indices))
        if node.text not in _CALLS:
            raise ValueError(f"formulas of {self.system.name!r}: {node.text} is no known function")
        parts = inside.parts if inside.kind == "list" else (inside,)
        return _CALLS[node.text](*(self.expression(part, i) for part in parts))


def _indices(system: Handle) -> list[int]:
    """Return what an index i runs over: the numbers at the ends of coordinates."""
    found = {int(match[1]) for x in system.coordinates if (match := re.search(r"(\d+)$", x))}
    return sorted(found)


def _indexed(name: str, i: int | None, known: set[str]) -> str:
    """Return a name with i put in: y_i as y1 where there is one, u_(i-1) as u_0."""
    base, _, index = name.rpartition("_")
    if index not in ("i", "(i-1)"):
        return name
    if i is None:
        raise ValueError(f"{name}: an index without a sum")
    k = i - (index != "i")
    return f"{base}{k}" if f"{base}{k}" in known else f"{base}_{k}"


def _has_index(node: Node) -> bool:
    """Return whether there is an index that is not that of a sum."""
    if node.kind == "call" and node.text == "sum_i":
        return False
    if node.kind == "name" and node.text.endswith(("_i", "_(i-1)")):
        return True
    return any(map(_has_index, node.parts))
