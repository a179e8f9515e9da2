"""What a peer offers: methods that go from a state to states at given times.

A module ``peer_NAME.py`` has ``methods(problem)``, a generator of `Method` and `Refused`.  It
raises `Missing` when what it needs is not installed; the rest of the run goes on without it.
"""

from __future__ import annotations

import contextlib
import importlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import sympy as sp
from problems import Ode, Problem

T_STATE = 100.0  # where the error of the state is measured
# States are asked for at multiples of it, which are whole steps: 100/h is a multiple of 20.
GRID = 5.0
PACKAGES = {"sksundae": "scikit-sundae"}  # where a module is called otherwise


class Missing(Exception):
    """A peer that is not here; the text says what."""


@dataclass(frozen=True)
class Refused:
    """A method that cannot do the problem, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class Method:
    """One curve.  A setting is a tolerance or a number of steps in 100 units of time."""

    name: str
    kind: str  # "steps", "tolerance" or, smaller where it is finer as well, "eps"
    settings: Sequence[float]  # from coarse to fine
    solve: Callable[[Any, np.ndarray, np.ndarray], np.ndarray]  # setting, state, times -> states
    compile_seconds: float  # what was done beforehand for this problem
    order: int = 0  # of the state in h, for "steps"
    usual: float | None = None  # the setting of long runs, where none is as fast as is asked for
    long: bool = True  # whether its energy is followed over long times
    bare: list[float] | None = None  # where solve adds the seconds of the integrator alone


def need(package: str) -> ModuleType:
    """Import a package, or say by its name that it is missing."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        module = package.split(".")[0]
        short = PACKAGES.get(module, module)
        raise Missing(f"{short} is not installed" if error.name in (None, module, package)
                      else f"{short} does not load: {error}") from None  # fmt: skip


def heyoka() -> ModuleType:
    """Import heyoka, without its cache: what compiling takes is reported."""
    hy = need("heyoka")
    if hasattr(hy.llvm_state, "set_diskcache_enabled"):
        hy.llvm_state.set_diskcache_enabled(False)
    return hy


@contextlib.contextmanager
def stopwatch() -> Iterator[list[float]]:
    """Seconds of the block, in what it gives; of the wall, since compilers are processes."""
    seconds = [0.0]
    start = time.perf_counter()
    yield seconds
    seconds[0] = time.perf_counter() - start


# ---- from expressions to code ------------------------------------------------------------------


def decimal(expression: Any, bits: int = 53) -> Any:
    """Replace fractions by their decimals, which no language divides at run time."""
    expression = sp.sympify(expression)
    powers = {x.exp for x in expression.atoms(sp.Pow)}
    fractions = {x for x in expression.atoms(sp.Rational) if not x.is_Integer} - powers
    return expression.xreplace({x: sp.Float(x, precision=bits) for x in fractions})


def _lines(outputs: dict[str, Any], declare: str, write: Callable[[Any], str],
           index: Callable[[Any, int], str]) -> Iterator[str]:  # fmt: skip
    """Assignments of matrices, with what they have in common computed once."""
    matrices = {name: sp.Matrix(x) for name, x in outputs.items()}
    flat = [decimal(x) for matrix in matrices.values() for x in matrix]
    # Powers such as r^(-3/2) by products of a root: no compiler does that to pow
    halves = {p for x in flat for p in x.atoms(sp.Pow) if p.exp.is_Rational and p.exp.q == 2}
    roots = {base: sp.Symbol(f"root_{i}")
             for i, base in enumerate(sorted({p.base for p in halves}, key=str))}  # fmt: skip
    for base, root in roots.items():
        yield f"{declare}{root} = {write(sp.sqrt(base))}"
    flat = [x.xreplace({p: roots[p.base] ** (2 * p.exp) for p in halves}) for x in flat]
    shared, flat = sp.cse(flat, sp.numbered_symbols("c_"))
    for name, value in shared:
        yield f"{declare}{name} = {write(value)}"
    values = iter(flat)
    for name, matrix in matrices.items():
        for i in range(len(matrix)):
            yield f"{name}_{index(matrix, i)} = {write(next(values))}"


def python_function(name: str, arguments: dict[str, Sequence[sp.Symbol]],
                    outputs: dict[str, Any]) -> Callable[..., Any]:  # fmt: skip
    """Make a function of the time, of vectors and of arrays that it fills; numba's if it is here.

    A column is an array of one index, another matrix of two.
    """
    body = [f"{x} = {vector}_[{i}]" for vector, symbols in arguments.items()
            for i, x in enumerate(symbols)]  # fmt: skip

    def index(matrix: Any, i: int) -> str:
        rows, columns = matrix.shape
        return f"[{i}]" if columns == 1 else f"[{i // columns}, {i % columns}]"

    def write(expression: Any) -> str:
        return sp.pycode(expression, fully_qualified_modules=False)

    body += _lines(outputs, "", write, index)
    names = ", ".join(f"{x}_" for x in (*arguments, *outputs))
    text = f"def {name}(t, {names}):\n    " + "\n    ".join(body)
    scope: dict[str, Any] = {}
    exec("from math import sin, cos, tan, sqrt\n" + text, scope)
    with contextlib.suppress(Missing):
        return need("numba").njit(scope[name])
    return scope[name]


def c_function(name: str, ode: Ode) -> str:
    """Return the C source of y' = f(t, y)."""
    from sympy.codegen.rewriting import create_expand_pow_optimization

    expand = create_expand_pow_optimization(4)
    body = [f"const double {x} = y_[{i}]" for i, x in enumerate(ode.symbols)]
    body += _lines({"out": sp.Matrix(ode.rates)}, "const double ",
                   lambda x: sp.ccode(expand(x)), lambda _, i: f"[{i}]")  # fmt: skip
    return (f"static void {name}(double t, const double *y_, double *out_)\n{{\n  "
            + ";\n  ".join(["(void) t", *body]) + ";\n}\n")  # fmt: skip


def field(problem: Problem) -> Callable[..., Any]:
    """Return ``field(t, y, out)``, the ODE of the problem for y = (q, v)."""
    e = problem.equations
    return python_function("field", {"y": (*problem.q, *problem.v)},
                           {"out": sp.Matrix([*problem.v, *e.acceleration])})  # fmt: skip


def field_jacobian(problem: Problem) -> Callable[..., Any]:
    """Return ``jacobian(t, y, out)``."""
    y = sp.Matrix([*problem.q, *problem.v])
    f = sp.Matrix([*problem.v, *problem.equations.acceleration])
    return python_function("jacobian", {"y": list(y)}, {"out": f.jacobian(y)})


def versions(*packages: str) -> dict[str, str]:
    """Return the versions of the packages that are here."""
    from importlib import metadata

    found = {}
    for name in packages:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    if "dalembert" not in found:  # from a build tree
        with contextlib.suppress(Missing):
            found = {"dalembert": need("dalembert").__version__} | found
    return found | {"python": sys.version.split()[0]}
