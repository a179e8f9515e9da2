"""The formulas of a system as SymPy expressions, for systems not made from expressions."""

from __future__ import annotations

import re
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from ..core import Handle
from . import given
from .formula import read
from .model import Model
from .symbols import Rule

Expr = Any


def model(system: Handle) -> Model:
    """Return the model described by the formulas of a system.

    The coordinates define the range of an index i: 0, 1, 2 if there are theta0, theta1 and theta2.
    A definition with ``u_(i-1)`` begins with the second value of i.

    Raises
    ------
    ValueError
        If the system has no formulas, or they are incomplete.

    Examples
    --------
    >>> import dalembert as dal
    >>> from dalembert.symbolic import expressions
    >>> found = expressions.model(dal.systems.heisenberg())
    >>> found.shown(found.constraints[0])
    -x*y.d + y*x.d + z.d
    """
    return _Formulas(system).model()


class _Formulas:
    """The content of the lines of a system, with symbols by name."""

    def __init__(self, system: Handle) -> None:
        self.system = system
        self.known = {*system.coordinates, *(f"v_{name}" for name in system.coordinates)}
        # What an index runs over: the numbers at the ends of coordinates.
        ends = (re.search(r"(\d+)$", name) for name in system.coordinates)
        self.indices = sorted({int(match[1]) for match in ends if match})
        self.defined: Rule = {}
        for line in system.formulas:
            if line.startswith("where "):
                self.define(line.removeprefix("where "))

    def define(self, line: str) -> None:
        """Store the definition of a name, or of names with each index."""
        name, right = read(line, exact=True)
        first = any(x.name.endswith("_(i-1)") for x in right.free_symbols)
        for i in self.indices[first:] if name.name.endswith("_i") else [None]:
            self.defined[self.expression(name, i)] = self.expression(right, i)

    def model(self) -> Model:
        lines = [line for line in self.system.formulas if not line.startswith("where ")]
        if not lines:
            raise ValueError(f"the system {self.system.name!r} has no formulas")
        (_, L), *rest = (read(line, exact=True) for line in lines)
        constraints = []
        for left, right in rest:
            phi = self.summed(left - right)
            has_index = any(x.name.endswith(("_i", "_(i-1)")) for x in phi.free_symbols)
            constraints += [self.whole(phi, i) for i in (self.indices if has_index else [None])]
        coordinates = [
            (sympy.Symbol(name), sympy.Symbol(f"v_{name}")) for name in self.system.coordinates
        ]
        L = self.whole(L)
        return given.make_model(L, constraints, coordinates, self.system.parameters)[0]

    def whole(self, found: Expr, i: int | None = None) -> Expr:
        """Return an expression in coordinates, velocities and parameters alone."""
        found = self.expression(found, i)
        for _ in self.defined:
            found = found.xreplace(self.defined)
        return found

    def expression(self, found: Expr, i: int | None = None) -> Expr:
        """Return an expression that is evaluated; i is the value of an index."""
        found = self.summed(found)
        return found.xreplace({x: self.indexed(x.name, i) for x in found.free_symbols}).doit()

    def summed(self, found: Expr) -> Expr:
        """Return an expression with its sums over i written out."""
        sums = [x for x in found.atoms(AppliedUndef) if x.name == "sum_i"]
        return found.xreplace(
            {x: sympy.Add(*(self.expression(x.args[0], i) for i in self.indices)) for x in sums}
        )

    def indexed(self, name: str, i: int | None) -> Expr:
        """Return a name with the value of i: y_i becomes y1 if it exists, u_(i-1) becomes u_0."""
        base, _, index = name.rpartition("_")
        if index in ("i", "(i-1)"):
            if i is None:
                raise ValueError(f"{name}: the index belongs to no sum")
            k = i - (index != "i")
            name = f"{base}{k}" if f"{base}{k}" in self.known else f"{base}_{k}"
        return sympy.Symbol(name)
