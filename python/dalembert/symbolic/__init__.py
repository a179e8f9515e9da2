"""Conversion of formulas to functions in C or Python; SymPy is imported on first use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..core.extras import Later

codegen = Later(__name__, "codegen")
constructor = Later(__name__, "constructor")
equations = Later(__name__, "equations")
evaluation = Later(__name__, "evaluation")
event = Later(__name__, "event")
expressions = Later(__name__, "expressions")
given = Later(__name__, "given")
jumps = Later(__name__, "jumps")
mechanisms = Later(__name__, "mechanisms")
model = Later(__name__, "model")
printing = Later(__name__, "printing")
symbols = Later(__name__, "symbols")


def coordinates(names: str | Sequence[str]) -> tuple[Any, ...]:
    """Return coordinates: SymPy symbols, each with its velocity ``.d``.

    Parameters
    ----------
    names : str or sequence of str
        As for ``sympy.symbols``: separated by commas or spaces; ``"q1:4"`` is q1, q2, q3.

    Returns
    -------
    tuple of symbols
        Calls with the same names return equal symbols.  Symbols with the same name from different
        calls are different in SymPy, but denote the same coordinate of a system.

    Raises
    ------
    ImportError
        If SymPy is not installed.
    ValueError
        If there are no names, or one occurs twice.

    Examples
    --------
    >>> import dalembert as dal
    >>> x, y = dal.coordinates("x y")
    >>> x.d * y
    y*x.d
    """
    return given.named(names)  # type: ignore[no-any-return]
