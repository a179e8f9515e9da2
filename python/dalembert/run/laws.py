"""Expressions of the state that C evaluates: events, resets, and the inputs of a run."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from .. import core
from ..core import arguments, ffi, lib
from ..symbolic import event
from ..system import System

Named = tuple[tuple[str, Any], ...]  # expressions, with names for messages


def is_expression(value: Any) -> bool:
    """Return whether a value is a SymPy expression, without importing SymPy."""
    return hasattr(value, "free_symbols")


@functools.lru_cache(maxsize=64)
def _made(system: System, expressions: Named, of: Any = None) -> tuple[Any, Any, Any]:
    return event.function(system, expressions, of)


def series(system: System, expressions: Named, of: Any) -> tuple[Any, Any, Any, Any]:
    """Return the results of `values`, and a ``dal_event_series *`` for a model, or NULL."""
    made = values(system, expressions, of)
    _, kept, function = _made(system, expressions, of)
    address = 0 if function is not None or of is None else kept[2].address("along")
    return *made, ffi.cast("struct dal_event_series *", address)


def values(system: System, expressions: Named, of: Any = None) -> tuple[Any, Any, Any]:
    """Return a ``dal_invariant_fn`` of expressions, its context, and the objects to keep alive."""
    address, kept, function = _made(system, expressions, of)
    if function is None:
        return ffi.cast("dal_invariant_fn", address), kept[0], kept
    callables = core.Callables(system.n, system.m, law=function, values=(len(expressions),))
    context = ffi.new_handle(callables)
    return lib.dal_py_law, context, (callables, context)


def are_compiled(system: System, expressions: Named) -> bool:
    """Return whether C evaluates expressions without Python."""
    return _made(system, expressions)[2] is None


@dataclass(frozen=True)
class Law:
    """Inputs, or the state after an event, as expressions of time, state and parameters."""

    expressions: Named

    def is_compiled(self, system: System) -> bool:
        """Return whether C evaluates the law without Python."""
        return are_compiled(system, self.expressions)

    def in_c(self, system: System) -> tuple[Any, Any]:
        """Return the ``dal_law *`` with the parameters of a system, and objects to keep alive."""
        function, context, kept = values(system, self.expressions)
        scratch = ffi.new("double[]", len(self.expressions))
        law = ffi.new("dal_law *", {"values": function, "count": len(self.expressions),
                                    "ctx": context, "scratch": scratch})  # fmt: skip
        return law, (kept, scratch)

    def about(self, system: System) -> dict[str, Any]:
        """Return data for JSON that identify the law: a digest, and its text."""
        shown = {name: str(expression) for name, expression in self.expressions}
        return {"key": event.model(system, self.expressions).key, "shown": shown}


Inputs = Any  # rows, or what makes them: Law | Callable[..., Any]


def take_inputs(system: System, given: Any) -> Inputs:
    """Return inputs as a `Law` if a mapping has expressions, else unchanged."""
    if isinstance(given, Mapping) and any(map(is_expression, given.values())):
        given = Law(tuple(event.inputs(system, given)))
    elif callable(given):
        arguments.function(given, "inputs", "t, q, v")
    if is_control(given) and not system.inputs:
        raise ValueError("inputs: the system has no inputs; remove it")
    return given


def is_control(inputs: Inputs) -> bool:
    """Return whether the rows of inputs are computed during the run."""
    return callable(inputs) or isinstance(inputs, Law)


def reset_of(system: System, reset: Callable[..., Any] | Mapping[Any, Any], name: str) -> Law:
    """Return the reset of an event as a law."""
    return Law(tuple(event.after(system, reset, f"{name}.reset")))
