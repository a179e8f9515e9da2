"""Models with numbers: compiled, or as Python functions without a compiler."""

from __future__ import annotations

import functools
import hashlib
import importlib.resources
import os
import sys
import warnings
from typing import Any

import numpy as np
import sympy

from .. import compiler
from ..compiler import Library
from ..core import Array, DalembertWarning, arguments, functions
from ..core.functions import Function
from . import codegen
from .model import Model

_PACKAGE = __name__.partition(".")[0]

_WITHOUT_COMPILER = (
    "no C compiler was found ({where}), so the system {name!r} runs on Python functions, 30 "
    "to 300 times slower; install gcc or clang, or set CC"
)


@functools.cache
def _generator() -> str:
    """Return a digest of all code that turns a model into C."""
    here = importlib.resources.files(__package__)
    names = (
        "formula.py", "symbols.py", "graph.py", "reading.py", "functions.py", "printing.py",
        "walls.py", "values.py", "derive.py", "model.py", "zeros.py", "pattern.py",
        "constructor.py", "motion.py", "forms.py", "convolutions.py", "reduced.py",
        "recurrences.py", "expansion.py", "variations.py", "codegen.py",
    )  # fmt: skip
    return hashlib.sha256(b"".join(here.joinpath(name).read_bytes() for name in names)).hexdigest()


def library(model: Model, part: str = "", of: Model | None = None) -> Library | None:
    """Return the compiled model; None if there is no compiler.

    The library for a part, or along the motions ``of`` a model, is another one: see
    `codegen.program`.
    """
    if part == "lanes" and not codegen.has_lanes(model):
        part = ""

    def program() -> str:
        return codegen.program(model, part=part, of=of).source

    versions = f"sympy {sympy.__version__}, {_generator()} {part}{of.key if of else ''}"
    return compiler.library(model.key, versions, program, part == "lanes")


class Evaluation:
    """A model with values of its parameters: its matrices, and its functions in Python."""

    def __init__(self, model: Model, values: dict[str, float]) -> None:
        self.model = model
        self.values = values
        self.parameters = np.array(list(values.values()), dtype=float)

    def bound(self, function: Function) -> Function:
        """Return a function of the user with the values of the parameters as keyword arguments."""
        return functools.partial(function, **self.values)

    def matrix(self, library: Library | None, name: str, shape: tuple[int, ...]) -> Array | None:
        """Return the mass or the initial state, which depend on parameters only, or None."""
        found = np.full(shape, np.nan)
        if library is not None:
            if not library.has(name):
                return None
            library.evaluate(name, self.parameters, found)
        else:
            functions = list(self.model.callables(name).values())
            if not functions:
                return None
            n = self.model.n
            found[...] = np.reshape(functions[0](*np.zeros((2, n)), self.parameters), shape)
        if not np.isfinite(found).all():
            values = ", ".join(f"{key} = {x:g}" for key, x in self.values.items())
            raise ValueError(f"parameters: the {name} is not finite for {values}")
        return found

    def in_python(self) -> dict[str, Any]:
        """Return the arguments of System that define it by Python functions."""
        model, p = self.model, self.parameters
        n, m, kind = model.n, model.m, model.derived.kind
        names = functions.outputs("nonlinear" if kind == "nonlinear" else "linear")
        made = {
            output: function
            for callback in ("potential", "lagrangian", "constraint", "force")
            for output, function in model.callables(callback).items()
        }

        def called(name: str, output: str) -> Function:
            last = int(model.is_driven and functions.is_of_constraint(name))
            return _callable(made[output], name, functions.shape(output, n, m), n, p, last)

        found = {name: called(name, output) for output, name in names.items() if output in made}
        if kind == "affine":
            slope, at = made["phi_q"], -2 if model.is_driven else -1  # the place of v
            found["affine"] = called("affine", "phi")
            found["affine_derivative"] = called("affine_derivative", "phi_q")
            found["mu_v_q"] = lambda *point: np.reshape(
                np.subtract(
                    slope(*point, p),
                    slope(*point[:at], np.zeros(n), *point[len(point) + at + 1 :], p),
                ),
                (m, n),
            )
        if model.exact is not None:
            exact = model.callables("exact")["x"]
            found["exact"] = lambda t, q, v: np.split(np.array(exact(t, q, v, p)), 2)
        return found

    def invariants(
        self, given: dict[str, Function | None]
    ) -> dict[str, Function]:
        """Return all first integrals as Python functions of a state; None: the next expression."""
        values = self.model.callables("invariant").get("values")
        found: dict[str, Function] = {}
        i = 0
        for name, function in given.items():
            arguments.function(function, name)
            if function is not None:
                found[name] = self.bound(function)
            elif values is not None:
                found[name] = lambda *state, i=i: float(values(*state, self.parameters)[i])
                i += 1
        return found

    def warn(self, name: str) -> None:
        """Warn of the cost of a missing compiler."""
        where = f"CC = {os.environ['CC']}" if os.environ.get("CC") else "cc, gcc, clang"
        text = _WITHOUT_COMPILER.format(where=where, name=name)
        warnings.warn(text, DalembertWarning, stacklevel=2 + _depth())


def _callable(
    function: Function, name: str, shape: tuple[int, ...], n: int, p: Array, last: int
) -> Function:
    """Return a function with its parameters bound, and the arguments that System expects.

    ``last`` is the number of arguments after v, which are the inputs.
    """
    zero = (np.zeros(n),) if functions.FUNCTIONS[name] == "q" else ()

    def whole(*given: Any) -> Any:
        end = len(given) - last
        return function(*given[:end], *zero, *given[end:], p)

    if shape:
        return lambda *given: np.reshape(whole(*given), shape)
    return lambda *given: float(whole(*given)[0])


def _depth() -> int:
    """Return the number of calls of this package between its caller and the user."""
    frame, depth = sys._getframe(1), 0
    while frame.f_back is not None and (
        str(frame.f_globals.get("__package__")).partition(".")[0] == _PACKAGE
    ):
        frame, depth = frame.f_back, depth + 1
    return depth - 1
