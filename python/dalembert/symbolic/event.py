"""Expressions of the state outside the system: compiled, or as Python functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from ..core import Handle, arguments, ffi, pointer
from ..core.functions import Function
from . import evaluation, given
from .model import Model
from .printing import function as in_python
from .symbols import TIME, Coordinate, Velocity

Expr = Any


def function(
    system: Handle, expressions: Sequence[tuple[str, Expr]], of: Model | None = None
) -> tuple[Any, Any, Function | None]:
    """Return expressions of (t, q, v) and the parameters of a system as one C function.

    Each has a name for messages.  Symbols denote coordinates, velocities and parameters by name;
    dynamicsymbols and their derivatives do too.  With the model ``of`` the system there are Taylor
    series along its motions.

    Returns
    -------
    address : cdata
        Address of a C function of type ``dal_invariant_fn``; NULL without a compiler.
    kept : tuple
        The context of the function, its parameters, and its library; has to be kept alive.
    python : callable or None
        Without a compiler: a function that returns the values at (t, q, v) as a list.

    Raises
    ------
    ValueError
        If a symbol is unknown, or an expression cannot be compiled.

    Examples
    --------
    >>> import dalembert as dal
    >>> from dalembert.symbolic import event
    >>> x, y, z = dal.coordinates("x y z")
    >>> address, kept, _ = event.function(dal.systems.particle(), [("events[0]", x + y.d)])
    """
    found = model(system, expressions)
    values = np.array(list(system.parameters.values()), dtype=float)
    library = evaluation.library(found, of=of)
    if library is not None:
        context = pointer(values) if values.size else ffi.NULL
        return library.definition.invariant, (context, values, library), None
    arguments = {"t": TIME, "q": found.q, "v": found.v, "p": found.p}
    inner = in_python(arguments, found.invariants)
    return ffi.NULL, None, lambda t, q, v: [float(x) for x in inner(t, q, v, values)]


def after(system: Handle, reset: Mapping[Any, Expr], where: str) -> list[tuple[str, Expr]]:
    """Return the 2n expressions of the state after a reset, with names for messages.

    A coordinate or velocity that is not in the mapping keeps its value.  Keys are symbols, or names
    of coordinates, and "v_x" for the velocity of x.

    Raises
    ------
    ValueError
        If a key is not a coordinate or velocity.

    Examples
    --------
    >>> import dalembert as dal
    >>> from dalembert.symbolic import event
    >>> x, y, z = dal.coordinates("x y z")
    >>> event.after(dal.systems.particle(), {x.d: -x.d / 2}, "events[0].reset")[3]
    ('events[0].reset[x.d]', -x.d/2)
    """
    positions = [Coordinate(name) for name in system.coordinates]
    states = {str(s): s for s in [*positions, *(q.d for q in positions)]}
    named = {f"v_{q}": str(q.d) for q in positions}
    found: dict[str, Expr] = dict(states)
    for key, expression in reset.items():
        name = str(_own(key, states) if hasattr(key, "free_symbols") else key)
        name = named.get(name, name) if name not in states else name
        if name not in states:
            raise ValueError(
                f"{where}: {key} is neither a coordinate nor a velocity; expected a subset of "
                f"{', '.join(states)}"
            )
        found[name] = _expression(expression, f"{where}[{name}]")
    return [(f"{where}[{name}]", expression) for name, expression in found.items()]


def inputs(system: Handle, given: Mapping[Any, Any]) -> list[tuple[str, Expr]]:
    """Return the expressions of the inputs of a system, in their order, with names for messages.

    Raises
    ------
    ValueError
        If a key is not an input, an input is missing, or a value is not an expression or a number.
    """
    names = {_name(key): key for key in given}
    for name, key in names.items():
        if name not in system.inputs:
            hint = arguments.suggestion(name, system.inputs)
            raise ValueError(
                f"inputs: {key} is not an input; {hint}expected "
                f"{', '.join(system.inputs) or 'none'}"
            )
    if missing := [name for name in system.inputs if name not in names]:
        raise ValueError(f"inputs: {missing[0]} is missing; expected {', '.join(system.inputs)}")
    return [
        (f"inputs[{name!r}]", _expression(given[names[name]], f"inputs[{name!r}]"))
        for name in system.inputs
    ]


def _name(key: Any) -> str:
    """Return the name of a symbol, or of a function of time."""
    return str(getattr(key, "func", key) if isinstance(key, AppliedUndef) else key)


def _expression(value: Any, where: str) -> Expr:
    """Return a SymPy expression, also for a number."""
    if hasattr(value, "free_symbols"):
        return value
    number = arguments.number(value, where)
    return sympy.Float(number) if number else sympy.Integer(0)


def _own(expression: Expr, known: Mapping[str, Expr]) -> Expr:
    """Return an expression with the known symbols in place of those with the same names."""
    rule = {}
    for f in expression.atoms(AppliedUndef):
        if len(f.args) == 1 and str(f.func) in known:
            rule[sympy.Derivative(f, f.args[0])] = known[f"{f.func}.d"]
            rule[f] = known[str(f.func)]
    for s in expression.free_symbols:
        if s.name in known and not isinstance(s, Coordinate | Velocity):
            rule[s] = known[s.name]
    return expression.xreplace(rule)


def model(system: Handle, expressions: Sequence[tuple[str, Expr]]) -> Model:
    """Return a model with the expressions as its invariants."""
    names = system.coordinates
    pairs = [(name, Coordinate(name), Coordinate(name).d) for name in names]
    values = system.parameters
    symbols = [sympy.Symbol(name) for name in values]
    translate = given.Translation(pairs, values, symbols, {})
    known = {str(s): s for _, *both in pairs for s in both}
    found = [translate(_own(x, known), where, translate.any_clock) for where, x in expressions]
    return Model(
        coordinates=tuple(names), parameters=tuple(values), constraints=(),
        L=sympy.Add(*(v**2 for v in translate.v)) / 2, invariants=tuple(found),
    )  # fmt: skip
