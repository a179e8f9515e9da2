"""The functions of users: their names, arguments, and outputs in the callbacks of C.

An output has its name in C: V_q is the derivative of V by q, n numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from numpy.typing import ArrayLike

from .arguments import Array
from .library import lib

# Functions of users: any, of q, of (q, v), of (t, q, v); and what returns two arrays, a state.
# Those of a system that depends on time take t before all else.
Function = Callable[..., Any]
OfPoint = Callable[[Array], ArrayLike]
OfState = Callable[[Array, Array], ArrayLike]
OfTime = Callable[[float, Array, Array], ArrayLike]
OfTimeTwo = Callable[[float, Array, Array], tuple[ArrayLike, ArrayLike]]

# By the callback, or by the kind of the constraints: what each output of C is called in Python.
OUTPUTS = {
    "potential": {"V": "potential", "V_q": "gradient", "V_qq": "hessian"},
    "lagrangian": {
        f"L{x}": f"lagrangian{x}" for x in ("", "_q", "_v", "_qq", "_vq", "_vv", "_vt")
    },
    "force": {f"f{x}": f"force{x}" for x in ("", "_q", "_v")},
    "linear": {"phi_v": "mu", "phi_q": "mu_v_q", "phi_t": "constraint_t"},
    "affine": {
        "phi": "(mu v + affine)",
        "phi_v": "mu",
        "phi_q": "(mu_v_q + affine_derivative)",
        "phi_t": "constraint_t",
    },
    "nonlinear": {f"phi{x}": f"constraint{x}" for x in ("", "_v", "_q", "_t")},
    "deformation": {x: x for x in ("g", "g_v", "g_q", "g_t")},
}

# What each function takes.
FUNCTIONS = {
    "mu": "q",
    "mu_v_q": "q, v",
    "affine": "q",
    "affine_derivative": "q",
    **dict.fromkeys(OUTPUTS["nonlinear"].values(), "q, v"),
    **dict.fromkeys(OUTPUTS["potential"].values(), "q"),
    **dict.fromkeys(OUTPUTS["lagrangian"].values(), "q, v"),
    **dict.fromkeys((*OUTPUTS["force"].values(), "exact"), "t, q, v"),
}


# What there is only of systems that depend on time: derivatives by it.
OF_TIME = ("constraint_t", "lagrangian_vt")


def is_of_constraint(name: str) -> bool:
    """Return whether a function is the constraint, or one of its derivatives."""
    return name.startswith(("mu", "affine", "constraint"))


def taken(name: str, inputs: int = 0, timed: bool = False, driven: bool = False) -> str:
    """Return the arguments of a function; for forces the inputs follow the state, if there are any.

    ``timed``: the system depends on time.  ``driven``: the constraints take inputs as well.
    """
    takes_inputs = name in OUTPUTS["force"].values() or (driven and is_of_constraint(name))
    takes_inputs = takes_inputs and inputs > 0
    found = FUNCTIONS.get(name, "q, v") + ", u" * takes_inputs
    return f"t, {found}" if timed and not found.startswith("t, ") else found


# The bits of dal_missing.
MISSING: dict[str, int] = {
    output: getattr(lib, f"DAL_MISSING_{output.upper()}")
    for output in (
        "V_q", "V_qq", "phi_q", "phi_t", "L_qq", "L_vq", "L_vv", "L_vt", "f_q", "f_v"
    )
}


def outputs(kind: str) -> dict[str, str]:
    """Return the names of outputs in Python, for constraints of a kind."""
    return {
        output: name
        for key in ("potential", "lagrangian", "force", kind)
        for output, name in OUTPUTS[key].items()
    }


def shape(output: str, n: int, m: int) -> tuple[int, ...]:
    """Return the shape of an output: that of the function, and n for each derivative by q or v."""
    name, _, variables = output.partition("_")
    whole = {"f": (n,), "phi": (m,), "g": (m,)}.get(name, ())
    return whole + (n,) * len(variables.replace("t", ""))


def _given_by(output: str, kind: str) -> list[str]:
    """Return the functions that supply an output: one, or two for affine constraints."""
    return re.findall(r"\w+", outputs(kind)[output])


def differenced(bits: int, kind: str) -> tuple[str, ...]:
    """Return the missing functions for a sum of ``dal_missing``; those of D last."""
    last = sorted(MISSING, key=lambda output: output.startswith("phi"))
    return tuple(x for output in last if bits & MISSING[output] for x in _given_by(output, kind))


def missing(given: Mapping[str, Any], m: int, kind: str, timed: bool = False) -> int:
    """Return the sum of ``dal_missing`` for the missing derivatives."""
    names, bits = outputs(kind), 0
    for output, bit in MISSING.items():
        if names[output] in OF_TIME and not timed:
            continue
        whole = output.partition("_")[0]
        there = m > 0 if whole == "phi" else given[names[whole]] is not None
        if there and any(given[name] is None for name in _given_by(output, kind)):
            bits |= bit
    return bits
