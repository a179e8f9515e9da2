"""The growth vector of D, and the decision whether D is integrable.

With expressions and SymPy, the computation has many digits and proofs (`algebra`).  Otherwise it
uses the functions of the system and their 16 digits (`functions`).
"""

from __future__ import annotations

import contextlib
import dataclasses
from typing import Any

import numpy as np

from ..core import Array, DalembertError, Handle, extras
from ..core.extras import Show
from ..geometry import residual
from ..symbolic import expressions
from . import functions
from .search import Distribution, is_settled, nearby

algebra = extras.Later(__name__, "algebra")

__all__ = ["Distribution", "agree", "examine", "is_settled"]


def examine(
    system: Handle,
    near: Array,
    q: Array | None = None,
    show: Show = lambda found: None,
) -> Distribution:
    """Return the growth vector of D, and whether D is integrable.

    Parameters
    ----------
    system : System
        A system with linear constraints, at least one.
    near : ndarray, shape (n,)
        A point in the domain of mu; general points are chosen near it first.
    q : ndarray, shape (n,), optional
        The point of the growth vector; default: a general point.
    show : callable, optional
        Called with the number of dimensions so far, of m at a general point and m at q.

    Examples
    --------
    >>> import dalembert as dal
    >>> from dalembert import growth
    >>> disk = dal.systems.disk()
    >>> found = growth.examine(disk, disk.q0)
    >>> found.growth, found.integrable, found.exact
    ((2, 3, 4), False, True)
    """
    model = _model(system, near)
    if model is None:
        return functions.examine(system, near, q, show)
    return algebra.examine(model, system.parameters, near, q, show)


def _model(system: Handle, near: Array) -> Any:
    """Return the expressions of a system, or of its formulas if these are complete."""
    if system._model is not None:
        return system._model
    if not system.formulas or not extras.is_there("sympy"):
        return None
    with contextlib.suppress(ValueError, ArithmeticError):  # formulas may be for readers only
        model = expressions.model(system)
        # only constraints matter here; derivatives of L take longer than all the rest
        model = dataclasses.replace(model, L=sum(v**2 for v in model.v), force=None)
        if agree(model, system, near):
            return model
    return None


def agree(found: Any, system: Handle, q: Array) -> bool:
    """Return whether the linear constraints of a model agree with a system, at q and nearby."""
    if found.m != system.m or found.derived.kind != "linear":
        return False
    if found.m == 0:
        return True
    n, p = system.n, list(system.parameters.values())
    forms = found.callables("constraint")["phi_v"]
    for size in (0.0, 0.01, 0.1):
        place = nearby(q, size)
        try:
            one = np.reshape(forms(place, np.zeros(n), p), (-1, n))
            other = residual(system, np.tile(place, (n, 1)), np.eye(n)).T
        except (DalembertError, ArithmeticError, ValueError):
            return False
        if one.shape != other.shape or not np.allclose(one, other, rtol=1e-12, atol=1e-12):
            return False
    return True
