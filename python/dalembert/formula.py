"""Formulas in plain text, as systems carry them, read and written as MathML.

``v_theta^2/2`` is a half of the square of the velocity of theta; a blank is a product, a name with
a bracket at it a function: ``J v_theta^2``, ``m (v_x + v_y)``, ``sqrt(A B)``.  ``sum_i(y_i z_i)`` is
a sum over i.  A quotient has all before it, up to a sign, above its line.
"""

from __future__ import annotations

import html
import re
from collections.abc import Collection
from dataclasses import dataclass

__all__ = ["mathml", "names"]

_TOKENS = re.compile(
    r"\s*(?:(?P<number>\d+(?:\.\d+)?(?:e[+-]?\d+)?)"
    r"|(?P<name>[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*(?:_\([^()]*\))?)(?P<call>\()?"
    r"|(?P<sign>[-+/^()=,]))"
)

GREEK = dict(
    zip(
        "alpha beta gamma delta epsilon eps zeta eta theta iota kappa lambda mu nu xi omicron pi rho "
        "sigma tau upsilon phi chi psi omega".split(),
        "αβγδεεζηθικλμνξοπρστυφχψω",
    )
)
GREEK |= {
    name.capitalize(): letter
    for name, letter in zip(
        "gamma delta theta lambda xi pi sigma phi psi omega".split(), "ΓΔΘΛΞΠΣΦΨΩ"
    )
}


@dataclass(frozen=True)
class _Token:
    kind: str  # "number", "name", "function", or the sign itself
    text: str


def _tokens(text: str) -> list[_Token]:
    found = []
    place = 0
    while text[place:].strip():
        match = _TOKENS.match(text, place)
        if match is None:
            raise ValueError(f"formula = {text!r}: no formula from {text[place:].strip()!r} on")
        place = match.end()
        if match["number"]:
            found.append(_Token("number", match["number"]))
        elif match["name"]:
            found.append(_Token("function" if match["call"] else "name", match["name"]))
        else:
            found.append(_Token(match["sign"], match["sign"]))
    return [*found, _Token("end", "the end")]


def names(text: str) -> set[str]:
    """Return the names in a formula that are no functions, as they are written.

    Raises
    ------
    ValueError
        If there is something in it that is no formula.

    Examples
    --------
    >>> from dalembert import formula
    >>> sorted(formula.names("m a theta/sqrt(A B)"))
    ['A', 'B', 'a', 'm', 'theta']
    """
    return {token.text for token in _tokens(text) if token.kind == "name"}


def mathml(text: str, coordinates: Collection[str] = ()) -> str:
    """Return a formula as MathML, a line of its own; as code, if it cannot be read.

    Parameters
    ----------
    text : str
        See the module.
    coordinates : collection of str
        What ``v_x`` may be the velocity of.

    Examples
    --------
    >>> from dalembert import formula
    >>> formula.mathml("v_x/2", ["x"])
    '<math display="block"><mfrac><mover><mi>x</mi><mo>˙</mo></mover><mn>2</mn></mfrac></math>'
    >>> formula.mathml("x?")
    '<code>x?</code>'
    """
    try:
        return f'<math display="block">{_Reader(text, coordinates).equation()}</math>'
    except ValueError:
        return f"<code>{html.escape(text)}</code>"


class _Reader:
    """Reads a formula from left to right, and returns the MathML of its parts."""

    def __init__(self, text: str, coordinates: Collection[str]) -> None:
        self.text = text
        self.coordinates = set(coordinates)
        self.tokens = _tokens(text)
        self.place = 0

    @property
    def next(self) -> _Token:
        return self.tokens[self.place]

    def take(self, *kinds: str) -> _Token:
        """Return the next token, which has to be of some kind."""
        token = self.next
        if token.kind not in kinds:
            raise ValueError(f"formula = {self.text!r}: {token.text!r} out of place")
        self.place += 1
        return token

    def equation(self) -> str:
        parts = [self.sum()]
        while self.next.kind in ("=", ","):
            sign = self.take("=", ",").text
            parts += [f"<mo>{sign}</mo>", self.sum()]
        self.take("end")
        return _row(parts)

    def sum(self) -> str:
        parts = []
        if self.next.kind in ("-", "+"):
            parts.append(_sign(self.take("-", "+").text))
        parts.append(self.term())
        while self.next.kind in ("-", "+"):
            parts += [_sign(self.take("-", "+").text), self.term()]
        return _row(parts)

    def term(self) -> str:
        """Factors, and quotients of what stands before by the next factor."""
        factors = [self.factor()]
        while self.next.kind in ("number", "name", "function", "(", "/"):
            if self.next.kind == "/":
                self.take("/")
                above = _bare(_row(_spaced(factors)))
                factors = [f"<mfrac>{above}{_bare(self.factor())}</mfrac>"]
            else:
                factors.append(self.factor())
        return _row(_spaced(factors))

    def factor(self) -> str:
        base = self.base()
        if self.next.kind != "^":
            return base
        self.take("^")
        exponent = _sign(self.take("-").text) if self.next.kind == "-" else ""
        exponent = _row([x for x in (exponent, _bare(self.base())) if x])
        return f"<msup>{base}{exponent}</msup>"

    def base(self) -> str:
        token = self.take("number", "name", "function", "(")
        if token.kind == "number":
            return f"<mn>{token.text}</mn>"
        if token.kind == "name":
            return self.name(token.text)
        if token.kind == "(":
            return _bracketed(self.closed())
        if token.text == "sqrt":
            return f"<msqrt>{self.closed()}</msqrt>"
        if token.text.startswith("sum_"):
            index = token.text.removeprefix("sum_")
            inside = _bracketed(self.closed())
            return _row([f"<munder><mo>∑</mo>{_letter(index)}</munder>", inside])
        return _row([self.name(token.text), "<mo>&#x2061;</mo>", _bracketed(self.closed())])

    def closed(self) -> str:
        parts = [self.sum()]
        while self.next.kind == ",":
            self.take(",")
            parts += ["<mo>,</mo>", self.sum()]
        self.take(")")
        return _row(parts)

    def name(self, text: str) -> str:
        """A letter with its indices; with a dot, if it is the velocity of a coordinate."""
        dot = text.startswith("v_") and self.is_coordinate(text.removeprefix("v_"))
        letter, _, index = (text.removeprefix("v_") if dot else text).partition("_")
        number = re.search(r"\d*$", letter)
        digits = number[0] if number and number.start() > 0 else ""
        base = _letter(letter.removesuffix(digits) if digits else letter)
        if dot:
            base = f"<mover>{base}<mo>˙</mo></mover>"
        parts = [f"<mn>{digits}</mn>"] if digits else []
        parts += [_index(part) for part in index.split("_") if part]
        return f"<msub>{base}{_row(parts)}</msub>" if parts else base

    def is_coordinate(self, text: str) -> bool:
        """Whether this is a coordinate, or ``theta_i`` where there are theta0, theta1, ..."""
        if text in self.coordinates:
            return True
        letter, _, index = text.rpartition("_")
        return index == "i" and any(re.fullmatch(rf"{letter}\d+", x) for x in self.coordinates)


def _row(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"<mrow>{''.join(parts)}</mrow>"


def _spaced(factors: list[str]) -> list[str]:
    """Factors with a thin space between them, which a reader needs: m a, not ma."""
    spaced = factors[:1]
    for factor in factors[1:]:
        spaced += ['<mspace width="0.17em"></mspace>', factor]
    return spaced


def _bracketed(inside: str) -> str:
    """In brackets, which grow only around what is tall."""
    size = "" if re.search("<mfrac>|<munder>", inside) else ' stretchy="false"'
    return f"<mrow><mo{size}>(</mo>{inside}<mo{size}>)</mo></mrow>"


def _bare(row: str) -> str:
    """What stands above or below a line, or as an exponent, without the brackets around all."""
    match = re.fullmatch(r"<mrow><mo[^>]*>\(</mo>(.*)<mo[^>]*>\)</mo></mrow>", row)
    if match is None:
        return row
    depth = 0
    for bracket in re.findall(r">([()])<", match[1]):
        depth += 1 if bracket == "(" else -1
        if depth < 0:
            return row
    return match[1]


def _sign(text: str) -> str:
    return f"<mo>{'−' if text == '-' else text}</mo>"


def _letter(text: str) -> str:
    return f"<mi>{GREEK.get(text, text)}</mi>"


def _index(text: str) -> str:
    if text.startswith("("):
        return "".join(
            f"<mn>{x}</mn>" if x.isdigit() else _sign(x) if x in "+-" else _letter(x)
            for x in re.findall(r"\d+|[-+]|[A-Za-z]+", text)
        )
    return f"<mn>{text}</mn>" if text.isdigit() else _letter(text)
