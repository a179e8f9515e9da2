"""The functions of users: their names, what they take, and which outputs of C's callbacks they are.

An output is called as in C: V_q is the derivative of V by q, of n numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from numpy.typing import ArrayLike

from .arguments import Array
from .library import lib

# Functions of users: any, of q, of (q, v), of (t, q, v); and what returns two arrays, a state.
Function = Callable[..., Any]
OfPoint = Callable[[Array], ArrayLike]
OfState = Callable[[Array, Array], ArrayLike]
OfTime = Callable[[float, Array, Array], ArrayLike]
OfTimeTwo = Callable[[float, Array, Array], tuple[ArrayLike, ArrayLike]]

# By the callback, or by the kind of the constraints: what each output of C is called in Python.
OUTPUTS = {
    "potential": {"V": "potential", "V_q": "gradient", "V_qq": "hessian"},
    "lagrangian": {f"L{x}": f"lagrangian{x}" for x in ("", "_q", "_v", "_qq", "_vq", "_vv")},
    "force": {f"f{x}": f"force{x}" for x in ("", "_q", "_v")},
    "linear": {"phi_v": "forms", "phi_q": "forms_velocity_derivative"},
    "affine": {
        "phi": "(forms v + affine)",
        "phi_v": "forms",
        "phi_q": "(forms_velocity_derivative + affine_derivative)",
    },
    "nonlinear": {f"phi{x}": f"constraint{x}" for x in ("", "_v", "_q")},
    "deformation": {x: x for x in ("g", "g_v", "g_q")},
}

# What each function takes.
FUNCTIONS = {
    "forms": "q",
    "forms_velocity_derivative": "q, v",
    "affine": "q",
    "affine_derivative": "q",
    **dict.fromkeys(OUTPUTS["nonlinear"].values(), "q, v"),
    **dict.fromkeys(OUTPUTS["potential"].values(), "q"),
    **dict.fromkeys(OUTPUTS["lagrangian"].values(), "q, v"),
    **dict.fromkeys((*OUTPUTS["force"].values(), "exact"), "t, q, v"),
}


def taken(name: str, inputs: int = 0) -> str:
    """Return what a function takes; of forces after the state the inputs, if there are any."""
    takes_inputs = inputs > 0 and name in OUTPUTS["force"].values()
    return FUNCTIONS.get(name, "q, v") + ", u" * takes_inputs


# The bits of dal_missing.
MISSING: dict[str, int] = {
    output: getattr(lib, f"DAL_MISSING_{output.upper()}")
    for output in ("V_q", "V_qq", "phi_q", "L_qq", "L_vq", "L_vv", "f_q", "f_v")
}


def outputs(kind: str) -> dict[str, str]:
    """Return what outputs are called in Python, for constraints of a kind."""
    return {
        output: name
        for key in ("potential", "lagrangian", "force", kind)
        for output, name in OUTPUTS[key].items()
    }


def shape(output: str, n: int, m: int) -> tuple[int, ...]:
    """Return the shape of an output: that of what is differentiated, and n for each derivative."""
    name, _, variables = output.partition("_")
    return {"f": (n,), "phi": (m,), "g": (m,)}.get(name, ()) + (n,) * len(variables)


def _given_by(output: str, kind: str) -> list[str]:
    """Return the functions that an output is made of: one, or two for affine constraints."""
    return re.findall(r"\w+", outputs(kind)[output])


def differenced(bits: int, kind: str) -> tuple[str, ...]:
    """Return the functions that are not given, of a sum of ``dal_missing``; those of D last."""
    last = sorted(MISSING, key=lambda output: output == "phi_q")
    return tuple(x for output in last if bits & MISSING[output] for x in _given_by(output, kind))


def missing(given: Mapping[str, Any], m: int, kind: str) -> int:
    """Return the sum of ``dal_missing`` for the derivatives that are not given."""
    names, bits = outputs(kind), 0
    for output, bit in MISSING.items():
        whole = output.partition("_")[0]
        there = m > 0 if whole == "phi" else given[names[whole]] is not None
        if there and any(given[name] is None for name in _given_by(output, kind)):
            bits |= bit
    return bits
