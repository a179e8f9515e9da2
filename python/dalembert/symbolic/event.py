"""Expressions of the state that are no part of a system: compiled, or as functions of Python."""

from __future__ import annotations

from typing import Any

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from ..core import Handle, ffi, pointer
from ..core.functions import Function
from . import evaluation, given
from . import model as models
from .model import Coordinate, Model

Expr = Any


def function(system: Handle, expression: Expr, where: str) -> tuple[Any, Any, Function | None]:
    """Return an expression of (t, q, v) and the parameters of a system as a C function.

    Symbols stand for what the system calls by their name; dynamicsymbols and their derivatives too.

    Returns
    -------
    address : cdata
        Of a C function as ``dal_event_fn``; NULL where there is no compiler.
    kept : object
        What its context is, and what has to be kept alive.
    python : callable or None
        ``g(t, q, v)``, where there is no compiler.

    Raises
    ------
    ValueError
        If a symbol is left over, or something is not among what can be compiled.

    Examples
    --------
    >>> import dalembert as dal
    >>> from dalembert.symbolic import event
    >>> x, y, z = dal.coordinates("x y z")
    >>> address, kept, _ = event.function(dal.systems.particle(), x + y.d, "events[0]")
    """
    model = _model(system, expression, where)
    values = np.array(list(system.parameters.values()), dtype=float)
    library = evaluation.library(model)
    if library is not None:
        context = pointer(values) if values.size else ffi.NULL
        return library.definition.invariant, (context, values, library), None
    (found,) = model.invariants
    inner = sympy.lambdify(
        [models.TIME, model.q, model.v, model.p],
        models.with_default(models.in_doubles(found, 17)), "math",
    )  # fmt: skip
    return ffi.NULL, None, lambda t, q, v: float(inner(t, q, v, values))


def _model(system: Handle, expression: Expr, where: str) -> Model:
    """Return a model with the expression as its only invariant."""
    names = system.coordinates
    pairs = [(name, Coordinate(name), Coordinate(name).d) for name in names]
    values = system.parameters
    symbols = [sympy.Symbol(name) for name in values]
    translate = given.Translation(pairs, values, symbols, {})
    known = dict(zip(names, (q for _, q, _ in pairs)))
    rule = {}
    for f in expression.atoms(AppliedUndef):
        if len(f.args) == 1 and str(f.func) in known:
            rule[sympy.Derivative(f, f.args[0])] = known[str(f.func)].d
            rule[f] = known[str(f.func)]
    for s in expression.free_symbols:
        if s.name in known and not isinstance(s, Coordinate | models.Velocity):
            rule[s] = known[s.name]
    found = translate(expression.xreplace(rule), where, translate.any_clock)
    return Model(
        coordinates=tuple(names), parameters=tuple(values), constraints=(),
        L=sympy.Add(*(v**2 for v in translate.v)) / 2, invariants=(found,),
    )  # fmt: skip
