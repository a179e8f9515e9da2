"""Formulas in plain text, as systems carry them: reading them, and writing them as MathML.

``v_theta^2/2`` is a half of the square of the velocity of theta; a blank is a product, a name with
a bracket at it a function: ``J v_theta^2``, ``m (v_x + v_y)``, ``sqrt(A B)``.  ``sum_i(y_i z_i)``
is a sum over i.  A quotient has all before it, up to a sign, above its line.
"""

from __future__ import annotations

import html
import re
from collections.abc import Collection
from dataclasses import dataclass

__all__ = ["Node", "mathml", "names", "read"]

_TOKENS = re.compile(
    r"\s*(?:(?P<number>\d+(?:\.\d+)?(?:e[+-]?\d+)?)"
    r"|(?P<name>[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*(?:_\([^()]*\))?)(?P<call>\()?"
    r"|(?P<sign>[-+/^()=,]))"
)

GREEK = dict(
    zip(
        "alpha beta gamma delta epsilon eps zeta eta theta iota kappa lambda mu nu xi omicron pi "
        "rho sigma tau upsilon phi chi psi omega".split(),
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


@dataclass(frozen=True)
class Node:
    """A part of a formula.

    Attributes
    ----------
    kind : str
        "number", "name", "call" (of a function), "power", "product", "quotient", "sum", "minus"
        (the negative), "bracket", "equation", or "list" (with commas).
    text : str
        Of a number, a name, the name of a function.
    parts : tuple of Node
    """

    kind: str
    text: str = ""
    parts: tuple[Node, ...] = ()


def read(text: str) -> Node:
    """Return a formula as a tree.

    Raises
    ------
    ValueError
        If it is none.

    Examples
    --------
    >>> from dalembert import formula
    >>> [part.text for part in formula.read("2 x").parts]
    ['2', 'x']
    """
    return _Reader(text).all()


class _Reader:
    """Reads a formula from left to right."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens = _tokens(text)
        self.place = 0

    @property
    def next(self) -> str:
        """Kind of the next token."""
        return self.tokens[self.place].kind

    def take(self, *kinds: str) -> _Token:
        """Return the next token, which has to be of some kind."""
        token = self.tokens[self.place]
        if token.kind not in kinds:
            raise ValueError(f"formula = {self.text!r}: {token.text!r} out of place")
        self.place += 1
        return token

    def several(self, sign: str, kind: str) -> Node:
        """Sums with a sign between them."""
        parts = [self.sum()]
        while self.next == sign:
            self.take(sign)
            parts.append(self.sum())
        return parts[0] if len(parts) == 1 else Node(kind, parts=tuple(parts))

    def all(self) -> Node:
        found = self.several("=", "equation")
        self.take("end")
        return found

    def sum(self) -> Node:
        parts = []
        while not parts or self.next in ("-", "+"):
            sign = self.take("-", "+").kind if self.next in ("-", "+") else "+"
            term = self.term()
            parts.append(Node("minus", parts=(term,)) if sign == "-" else term)
        return parts[0] if len(parts) == 1 else Node("sum", parts=tuple(parts))

    def term(self) -> Node:
        """Factors, and quotients of what stands before by the next factor."""
        factors = [self.factor()]
        while self.next in ("number", "name", "function", "(", "/"):
            if self.next == "/":
                self.take("/")
                factors = [Node("quotient", parts=(_product(factors), self.factor()))]
            else:
                factors.append(self.factor())
        return _product(factors)

    def factor(self) -> Node:
        base = self.base()
        if self.next != "^":
            return base
        self.take("^")
        if self.next == "-":
            self.take("-")
            return Node("power", parts=(base, Node("minus", parts=(self.base(),))))
        return Node("power", parts=(base, self.base()))

    def base(self) -> Node:
        token = self.take("number", "name", "function", "(")
        if token.kind in ("number", "name"):
            return Node(token.kind, token.text)
        inside = self.several(",", "list")
        self.take(")")
        if token.kind == "(":
            return Node("bracket", parts=(inside,))
        return Node("call", token.text, (inside,))


def _product(factors: list[Node]) -> Node:
    return factors[0] if len(factors) == 1 else Node("product", parts=tuple(factors))


# ---- MathML --------------------------------------------------------------------------------------

LINE = 70  # letters of a formula in one line


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
        tree = read(text)
    except ValueError:
        return f"<code>{html.escape(text)}</code>"
    return f'<math display="block">{_Writer(coordinates).write(tree)}</math>'


class _Writer:
    """Writes the parts of a formula."""

    def __init__(self, coordinates: Collection[str]) -> None:
        self.coordinates = set(coordinates)

    def write(self, node: Node) -> str:
        parts = [self.write(part) for part in node.parts]
        match node.kind:
            case "number":
                return f"<mn>{node.text}</mn>"
            case "name":
                return self.name(node.text)
            case "call":
                return self.call(node.text, parts[0])
            case "power":
                return f"<msup>{parts[0]}{self.bare(node.parts[1])}</msup>"
            case "product":
                return _row(parts, '<mspace width="0.17em"></mspace>')
            case "quotient":
                return f"<mfrac>{self.bare(node.parts[0])}{self.bare(node.parts[1])}</mfrac>"
            case "minus":
                return _row(["<mo>−</mo>", parts[0]])
            case "sum":
                return _row(self.terms(node))
            case "bracket":
                return _bracketed(parts[0])
            case "equation":
                return self.equation(node, parts)
            case _:
                return _row(parts, "<mo>,</mo>")

    def terms(self, node: Node) -> list[str]:
        """The terms of a sum, each with the sign before it."""
        found = []
        for k, part in enumerate(node.parts):
            sign = "<mo>−</mo>" if part.kind == "minus" else "<mo>+</mo>" if k else ""
            found.append(sign + self.write(part.parts[0] if part.kind == "minus" else part))
        return found

    def equation(self, node: Node, parts: list[str]) -> str:
        """In one line; with a long sum at its end in several, broken before a sign."""
        last = node.parts[-1]
        if last.kind != "sum" or sum(map(_length, parts)) <= LINE:
            return _row(parts, "<mo>=</mo>")
        lines = [""]
        for term in self.terms(last):
            if lines[-1] and _length(lines[-1]) + _length(term) > LINE:
                lines.append("")
            lines[-1] += term
        left = [_row([*parts[:-1], ""], "<mo>=</mo>"), *[""] * (len(lines) - 1)]
        rows = (
            f'<mtr><mtd style="text-align: right">{a}</mtd>'
            f'<mtd style="text-align: left"><mrow>{b}</mrow></mtd></mtr>'
            for a, b in zip(left, lines)
        )
        return f'<mtable displaystyle="true">{"".join(rows)}</mtable>'

    def bare(self, node: Node) -> str:
        """What stands above or below a line, or as an exponent: without brackets."""
        return self.write(node.parts[0] if node.kind == "bracket" else node)

    def call(self, name: str, inside: str) -> str:
        if name == "sqrt":
            return f"<msqrt>{inside}</msqrt>"
        if name.startswith("sum_"):
            index = _letter(name.removeprefix("sum_"))
            return _row([f"<munder><mo>∑</mo>{index}</munder>", _bracketed(inside)])
        return _row([_letter(name), _bracketed(inside)], "<mo>&#x2061;</mo>")

    def name(self, text: str) -> str:
        """A letter with its indices; with a dot, if it is the velocity of a coordinate."""
        dot = text.startswith("v_") and self.is_coordinate(text.removeprefix("v_"))
        letter, _, index = (text.removeprefix("v_") if dot else text).partition("_")
        digits = re.sub(r"^.*?\D(?=\d*$)", "", letter)
        base = _letter(letter.removesuffix(digits))
        if dot:
            base = f"<mover>{base}<mo>˙</mo></mover>"
        below = [f"<mn>{digits}</mn>"] if digits else []
        below += [_index(part) for part in index.split("_") if part]
        return f"<msub>{base}{_row(below)}</msub>" if below else base

    def is_coordinate(self, text: str) -> bool:
        """Whether this is a coordinate, or ``theta_i`` where there are theta0, theta1, ..."""
        if text in self.coordinates:
            return True
        letter, _, index = text.rpartition("_")
        return index == "i" and any(re.fullmatch(rf"{letter}\d+", x) for x in self.coordinates)


def _length(text: str) -> int:
    """How many letters are seen; those of a fraction count as if they stood side by side."""
    return len(re.sub("<[^>]*>", "", text))


def _row(parts: list[str], between: str = "") -> str:
    return parts[0] if len(parts) == 1 else f"<mrow>{between.join(parts)}</mrow>"


def _bracketed(inside: str) -> str:
    """In brackets, which grow only around what is tall."""
    size = "" if re.search("<mfrac>|<munder>", inside) else ' stretchy="false"'
    return f"<mrow><mo{size}>(</mo>{inside}<mo{size}>)</mo></mrow>"


def _letter(text: str) -> str:
    return f"<mi>{GREEK.get(text, text)}</mi>"


def _index(text: str) -> str:
    """An index: a number, a letter, or (i-1)."""
    found = [
        f"<mn>{x}</mn>" if x.isdigit() else f"<mo>{x.replace('-', '−')}</mo>" if x in "+-"
        else _letter(x)
        for x in re.findall(r"\d+|[-+]|[A-Za-z]+", text)
    ]  # fmt: skip
    return _row(found)
