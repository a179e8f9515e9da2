"""Models: a Lagrangian and constraints as SymPy expressions, and their derivatives."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import sympy

from . import latex
from .derive import Derived, derive
from .printing import as_function, function
from .reduced import NotReduced, Reduced, reduced
from .symbols import TIME, Coordinate, Expr, Rule, canonical


@dataclass(frozen=True, eq=False)
class Model:
    """A Lagrangian and constraints in canonical symbols, and the user's names.

    Attributes
    ----------
    coordinates, parameters : tuple of str
        Names; q0 is the first coordinate, v0 its velocity, p0 the first parameter.
    L : sympy.Expr
        The Lagrangian.
    constraints : tuple of sympy.Expr
        Expressions that vanish; may contain the inputs, which are constant over a step.
    force : tuple of sympy.Expr or None
        The n components of the generalized force; may contain the inputs.  All may contain t.
    state : tuple of sympy.Expr or None
        Default initial data (q, v), in the parameters.
    exact : tuple of sympy.Expr or None
        The exact solution (q, v) at time t, in the initial data q0 ... v0 ...
    invariants : tuple of sympy.Expr
        First integrals besides the energy.
    assumptions : tuple of tuple of str
        The assumptions on the values of each parameter: "positive", ...
    inputs : tuple of str
        Names; u0 is the first input of the force and the constraints.
    positions : tuple of sympy.Expr
        Constraints on q and the time, whose time derivatives are among the constraints.
    """

    coordinates: tuple[str, ...]
    parameters: tuple[str, ...]
    L: Expr
    constraints: tuple[Expr, ...]
    force: tuple[Expr, ...] | None = None
    state: tuple[Expr, ...] | None = None
    exact: tuple[Expr, ...] | None = None
    invariants: tuple[Expr, ...] = ()
    assumptions: tuple[tuple[str, ...], ...] = ()
    inputs: tuple[str, ...] = ()
    positions: tuple[Expr, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        fields = dataclasses.fields(self)
        return Model, tuple(getattr(self, field.name) for field in fields)

    @property
    def n(self) -> int:
        return len(self.coordinates)

    @property
    def m(self) -> int:
        return len(self.constraints)

    @property
    def q(self) -> tuple[Expr, ...]:
        return canonical("q", self.n)

    @property
    def v(self) -> tuple[Expr, ...]:
        return canonical("v", self.n)

    @property
    def p(self) -> tuple[Expr, ...]:
        return canonical("p", len(self.parameters))

    @property
    def u(self) -> tuple[Expr, ...]:
        return canonical("u", len(self.inputs))

    @property
    def is_time_dependent(self) -> bool:
        """Whether L or the constraints depend on time."""
        return any(TIME in e.free_symbols for e in (self.L, *self.constraints))

    @property
    def is_driven(self) -> bool:
        """Whether a constraint depends on inputs."""
        return any(u in e.free_symbols for e in self.constraints for u in self.u)

    @functools.cached_property
    def key(self) -> str:
        """A digest of the model without its names."""
        parts = [
            (self.L,), self.constraints, self.force, self.state, self.exact, self.invariants
        ]  # fmt: skip
        texts = [None if part is None else [_structure(e) for e in part] for part in parts]
        text = repr((self.n, len(self.parameters), len(self.inputs), texts, self.assumptions))
        return hashlib.sha256(text.encode()).hexdigest()

    @functools.cached_property
    def derived(self) -> Derived:
        """Type, mass and derivatives."""
        return derive(self)

    @property
    def reduced(self) -> Reduced:
        """The equations on D; raises NotReduced if there are none in closed form."""
        if isinstance(self._reduced, NotReduced):
            raise self._reduced
        return self._reduced

    @functools.cached_property
    def _reduced(self) -> Reduced | NotReduced:
        try:
            return reduced(self)
        except NotReduced as error:
            return error

    @functools.cached_property
    def sparsity(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Rows and columns, row by row, of the entries that are nonzero in phi_v or phi_q."""
        jacobians = (self.derived.entries("constraint", x) for x in ("phi_v", "phi_q"))
        there = [k for k, both in enumerate(zip(*jacobians)) if not all(e.is_zero for e in both)]
        return tuple(k // self.n for k in there), tuple(k % self.n for k in there)

    def shown(self, expression: Expr) -> Expr:
        """Return an expression with the user's names."""
        return expression.xreplace(self._names)

    @functools.cached_property
    def _names(self) -> Rule:
        found = dict(zip((*self.p, *self.u), map(sympy.Symbol, (*self.parameters, *self.inputs))))
        for q, v, name in zip(self.q, self.v, self.coordinates):
            coordinate = Coordinate(name)
            found |= {q: coordinate, v: coordinate.d}
        return found

    @functools.cached_property
    def _plain_names(self) -> Rule:
        velocities = [f"v_{name}" for name in self.coordinates]
        names = [*self.coordinates, *velocities, *self.parameters, *self.inputs]
        return dict(zip((*self.q, *self.v, *self.p, *self.u), map(sympy.Symbol, names)))

    # ---- as Python functions --------------------------------------------------------------

    def callables(self, name: str) -> dict[str, Callable[..., Any]]:
        """Return a function of Python for each output of a function.

        Its arguments are (q, v, p).  An exact solution, a force, and all functions of a model that
        depends on time have the arguments (t, q, v, p).  Inputs precede p.
        """
        function = self.derived.function(name)
        arguments = {"q": self.q, "v": self.v, "p": self.p}
        if (name == "force" and self.inputs) or (name == "constraint" and self.is_driven):
            arguments = {"q": self.q, "v": self.v, "u": self.u, "p": self.p}
        if name in ("force", "exact") or (self.is_time_dependent and name not in ("mass", "state")):
            arguments = {"t": TIME} | arguments
        nodes = {
            key: self.derived.read(x) if key == "t" else [self.derived.read(s) for s in x]
            for key, x in arguments.items()
        }
        return {
            output: as_function(nodes, entries)
            for output, entries in (function.outputs.items() if function else ())
        }

    @functools.cached_property
    def at_positions(self) -> Callable[..., list[float]]:
        """A function of (t, q, p): the position constraints, then the n slopes of each."""
        slopes = [sympy.diff(e, x) for e in self.positions for x in self.q]
        return function({"t": TIME, "q": self.q, "p": self.p}, [*self.positions, *slopes])

    # ---- for people ------------------------------------------------------------------------

    def formula(self, expression: Expr) -> str:
        """Return an expression as plain text: v_x for the velocity of x, a blank for a product.

        Terms with velocities come first.
        """
        moving, parts = {*self.v}, ([], [])
        for term in sympy.Add.make_args(expression):
            parts[not term.free_symbols & moving].append(term.xreplace(self._plain_names))
        texts = [str(sympy.factor_terms(sympy.Add(*part))) for part in parts if part]
        text = " + ".join(texts).replace("+ -", "- ")
        return text.replace("**", "^").replace("*", " ")

    def still(self) -> tuple[str, ...]:
        """Return the terms without a velocity of each constraint that has some, as plain text."""
        at_rest = dict.fromkeys(self.v, 0)
        found = ((a, phi.xreplace(at_rest)) for a, phi in enumerate(self.constraints))
        return tuple(f"{self.formula(e)}, in constraints[{a}]" for a, e in found if e != 0)

    def formulas(self) -> tuple[str, ...]:
        """Return L, the constraints and the force as plain text, one line each."""
        force = zip(self.coordinates, self.force or ())
        return (
            f"L = {self.formula(self.L)}",
            *(f"{self.formula(phi)} = 0" for phi in self.constraints),
            *(f"f_{name} = {self.formula(f)}" for name, f in force if f != 0),
        )

    def latex(self) -> str:
        """Return L, mu and the ODE on D as LaTeX, in an aligned environment."""
        return latex.latex(self)


def _structure(e: Expr) -> str:
    """Return a text that two expressions share only if they are equal.

    ``srepr`` does the same, but sorts again and takes ten times as long.
    """
    if not e.args:
        return str(sympy.srepr(e))
    return f"{type(e).__name__}({', '.join(map(_structure, e.args))})"
