"""Formulas of systems in plain text: read and written by SymPy, and as MathML.

``v_theta^2/2`` is half the square of the velocity of theta.  A blank is a product, and a name
directly before a bracket is a function: ``J v_theta^2``, ``m (v_x + v_y)``, ``sqrt(A B)``.
``sum_i(y_i z_i)`` is a sum over i.
"""

from __future__ import annotations

import html
import itertools
import re
from collections.abc import Collection
from typing import Any

from ..core import extras

Expr = Any

FUNCTIONS = (
    "Abs sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh exp log sqrt erf erfc"
).split()
_STRUCTURE = "Integer Float Rational Add Mul Pow".split()
DEPTH = 50  # of brackets in brackets; the time that SymPy takes grows with its third power
_NUMBER = r"\d+(?:\.\d+)?(?:e[+-]?\d{1,3})?(?![\d.])"
_NAME = r"[A-Za-z]\w*(?:(?<=_)\(i-1\))?"
_ALLOWED = re.compile(rf"(?:{_NUMBER}|{_NAME}|[-+^(), ]|/(?!/))++", re.ASCII)
_WORD = re.compile(rf"{_NUMBER}|({_NAME})(?=(\()?)", re.ASCII)


def read(text: str, exact: bool = False) -> list[Expr]:
    """Return the sides of an equation, or a single expression, as SymPy expressions.

    Nothing is evaluated or reordered.  All names are symbols.

    Parameters
    ----------
    text : str
        See the module.
    exact : bool, optional
        Whether to read decimals as rational numbers.

    Raises
    ------
    ValueError
        If the text is not a formula.
    ImportError
        If SymPy is not installed.  The message has the command that installs it.

    Examples
    --------
    >>> from dalembert.symbolic import formula
    >>> formula.read("2 x - y = 0")
    [2*x - y, 0]
    """
    return [_side(side.strip(), exact) for side in text.split("=")]


def _side(text: str, exact: bool) -> Expr:
    sympy = extras.require("sympy", "a formula")
    parser = extras.require("sympy.parsing.sympy_parser", "a formula")
    known = {x: getattr(sympy, x) for x in (*_STRUCTURE, *FUNCTIONS)}
    names: dict[str, Expr] = {}

    def word(match: re.Match[str]) -> str:
        """Return a number or function unchanged; replace a name, which may be a Python keyword."""
        name, call = match.groups()
        if not name or (call and name in FUNCTIONS):
            return match[0]
        names[f"_{len(names)}"] = (sympy.Function if call else sympy.Symbol)(name)
        return f" _{len(names) - 1}"

    depth = itertools.accumulate((c == "(") - (c == ")") for c in text)
    rules = [parser.auto_number, *([parser.rationalize] if exact else [])]
    rules += [parser.implicit_multiplication, parser.convert_xor]
    try:
        if not _ALLOWED.fullmatch(text) or max(depth) > DEPTH:
            raise ValueError("a sign is out of place")
        # For Python -a b is (-a) b.
        words = _WORD.sub(word, re.sub(r"((?:^|[(,]) *)-(?= *[A-Za-z(])", r"\1-1 ", text))
        found = parser.parse_expr(
            words, names, rules, {"__builtins__": {}, **known}, evaluate=False
        )
        if not isinstance(found, sympy.Expr) or found.has(sympy.Tuple):
            raise ValueError("a list is out of place")
    except Exception as error:  # SyntaxError, TypeError, tokenize.TokenError, ...
        raise ValueError(f"formula = {text!r}: {error}") from error
    return found


def latex(text: str, coordinates: Collection[str] = ()) -> list[str]:
    """Return a formula as LaTeX, a list of terms, each with its sign.

    Examples
    --------
    >>> from dalembert.symbolic import formula
    >>> formula.latex("v_x - y_1 = 0", ["x"])
    ['\\\\dot{x}', '{}- y_{1}', '{}= 0']
    """
    sympy = extras.require("sympy", "a formula")
    known = {*coordinates, *(re.sub(r"\d+$", "_i", name) for name in coordinates)}
    found = []
    for side in read(text):
        names = {x: _symbol(x.name, known, sympy) for x in side.free_symbols}
        for k, term in enumerate(sympy.Add.make_args(side)):
            tex = sympy.latex(term, order="none", mul_symbol=r"\,", max=9, symbol_names=names)
            tex = tex.replace(r"\operatorname{sum}", r"\sum\limits")
            # What is not evaluated has 1 times 1/2 for 1/2.
            tex = re.sub(r"(?<![\d.])1 *(?:\\cdot|\\,) *(?=\\frac\{1\})", "", tex)
            sign = ("= " if k == 0 else "" if tex.startswith("-") else "+ ") if found else ""
            found.append("{}" * bool(found) + sign + tex)
    return found


def _symbol(name: str, coordinates: Collection[str], sympy: Any) -> str:
    """Return a name as LaTeX, with a dot if it is the velocity of a coordinate."""
    base = name.removeprefix("v_")
    has_dot = base in coordinates and base != name
    base = (base if has_dot else name).replace("eps", "epsilon")
    letter, *index = sympy.latex(sympy.Symbol(base)).split("_", 1)
    if letter.isalpha() and len(letter) > 1:
        letter = rf"\mathrm{{{letter}}}"
    return "_".join([rf"\dot{{{letter}}}" if has_dot else letter, *index])


def mathml(text: str, coordinates: Collection[str] = ()) -> str:
    """Return a formula as MathML, one element for each term, so that lines break before a sign.

    If it cannot be read, or SymPy or latex2mathml is not installed, the result is a code element.

    Parameters
    ----------
    text : str
        See the module.
    coordinates : collection of str
        Names of the coordinates, whose velocities are ``v_...``.

    Examples
    --------
    >>> from dalembert.symbolic import formula
    >>> formula.mathml("x", ["x"]).endswith("><mrow><mi>x</mi></mrow></math>")
    True
    >>> formula.mathml("x?")
    '<code>x?</code>'
    """
    try:
        write = extras.require("latex2mathml.converter", "a formula").convert
        return " ".join(map(write, latex(text, coordinates)))
    except (ImportError, ValueError):
        return f"<code>{html.escape(text)}</code>"
