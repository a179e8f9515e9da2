"""The growth vector of D, and whether D is integrable: the one place that decides.

By expressions where there are any and SymPy is installed, with many digits and proofs (`algebra`);
else by the functions of the system, as far as their 16 digits go (`functions`).
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..core import extras
from ..core import Array, Handle
from . import functions
from .search import Distribution, is_settled

if TYPE_CHECKING:
    from ..symbolic.model import Model

__all__ = ["Distribution", "examine", "is_settled"]


def examine(
    system: Handle,
    near: Array,
    q: Array | None = None,
    show: Callable[[int], Any] = lambda found: None,
) -> Distribution:
    """Return what can be said of D.

    Parameters
    ----------
    system : System
        With linear constraints, at least one.
    near : ndarray, shape (n,)
        Some point where mu is defined; general ones are sought near it first.
    q : ndarray, shape (n,), optional
        Where the growth vector is wanted; default: at a general point.
    show : callable, optional
        Called with the number of dimensions found so far, of m at a general point and m at q.

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
    from . import algebra

    return algebra.examine(model, system.parameters, near, q, show)


def _model(system: Handle, near: Array) -> Model | None:
    """Return the expressions of a system, or those of its formulas if they say what it is."""
    if system._model is not None:
        return system._model
    if not system.formulas or not extras.is_there("sympy"):
        return None
    from ..symbolic import expressions

    with contextlib.suppress(ValueError, ArithmeticError):  # formulas may be for readers only
        model = expressions.model(system)
        # only constraints matter here; derivatives of L take longer than all the rest
        model = dataclasses.replace(model, L=sum(v**2 for v in model.v), force=None)
        if expressions.agree(model, system, near):
            return model
    return None
