"""From formulas to functions in C or Python; SymPy is imported when something here is used."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..core.extras import Later

codegen = Later(__name__, "codegen")
evaluation = Later(__name__, "evaluation")
event = Later(__name__, "event")
expressions = Later(__name__, "expressions")
given = Later(__name__, "given")
jumps = Later(__name__, "jumps")
mechanisms = Later(__name__, "mechanisms")
model = Later(__name__, "model")
series = Later(__name__, "series")


def coordinates(names: str | Sequence[str]) -> tuple[Any, ...]:
    """Return coordinates, SymPy symbols with a velocity ``.d`` each.

    Parameters
    ----------
    names : str or sequence of str
        As for ``sympy.symbols``: separated by commas or spaces; ``"q1:4"`` is q1, q2, q3.

    Returns
    -------
    tuple of symbols
        Calls with the same names make equal symbols.  Those of one name and different calls are
        different to SymPy, but the same coordinate of a system.

    Raises
    ------
    ImportError
        If SymPy is not installed.
    ValueError
        If there are no names, or one is there twice.

    Examples
    --------
    >>> import dalembert as dal
    >>> x, y = dal.coordinates("x y")
    >>> x.d * y
    y*x.d
    """
    return given.named(names)  # type: ignore[no-any-return]
