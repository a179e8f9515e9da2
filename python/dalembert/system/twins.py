"""Copies of systems, compiled for steps, for several members at once, or for Taylor series."""

from __future__ import annotations

import contextlib
import dataclasses
import functools

import numpy as np

from .. import compiler, geometry
from ..core import DalembertError, extras
from ..symbolic import codegen, evaluation, expressions
from .sources import BuiltIn, Expressions
from .system import System

_CLOSE = 1e-10  # of two ways to compute the field, relative to its largest component


@functools.lru_cache(maxsize=16)
def twin(system: System, part: str) -> System | None:
    """Return a system compiled with a part of `codegen.program`; None if there is none.

    A system from expressions is compiled again.  For a system written in C, its formulas are
    compiled, and the field of the result is compared with that of the system.
    """
    if not extras.is_there("sympy"):
        return None
    source = system._source
    if isinstance(source, Expressions):
        if source.part or not _fits(source.model, part):
            return None
        with compiler.showing(system._progress):
            if evaluation.library(source.model, part) is None:  # there is no compiler
                return None
            return System._of(dataclasses.replace(source, part=part))
    if part == "steps" or not isinstance(source, BuiltIn) or system.q0 is None:
        return None
    with contextlib.suppress(ValueError, ArithmeticError, DalembertError):
        model = expressions.model(system)
        if _fits(model, part):
            state = np.concatenate([system.q0, system.v0])
            about = {name: "" for name in ("help", "description", "source")}
            made = System._of(
                Expressions(model, system.parameters, {"name": system.name, **about}, state, None,
                            {}, part=part)  # fmt: skip
            )
            if _same(system, made):
                return made
    return None


def _fits(model: object, part: str) -> bool:
    """Return whether a part makes a difference for a model."""
    wanted = {"steps": codegen.has_steps, "lanes": codegen.has_lanes}.get(part)
    return wanted is None or bool(wanted(model))


def _same(system: System, other: System) -> bool:
    """Return whether two systems have the same field."""
    one, two = (geometry.field(x, system.q0, system.v0) for x in (system, other))
    return bool(abs(one - two).max() <= _CLOSE * max(1.0, abs(one).max()))
