"""Nodes of a graph as text: for C, for vectors in C, and for Python.

A part that is used several times gets a name, and the others stand in the formula that uses them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from .graph import CONDITIONS, PIECE, WALL, Graph, Node, below
from .reading import Reader

Expr = Any

_LEAVES = ("number", "constant", "symbol", "nan")

# A formula with more letters gets a name.
_LONGEST = 160


@dataclass(frozen=True)
class Style:
    """How a language writes operations.

    Attributes
    ----------
    line : str
        The definition of a name.
    forms : dict
        How operations are written, if not as functions.
    names : dict
        Names of functions that differ from those of the graph.
    call : str
        How functions are written.
    vector : str
        How a number becomes an argument of a function; empty if it is one.
    """

    line: str
    forms: Mapping[str, str]
    names: Mapping[str, str] = field(default_factory=dict)
    call: str = "{name}({args})"
    vector: str = ""


_NAMES = {"power": "pow", "sign": "model_sign", "step": "model_step", "max": "model_larger",
          "min": "model_smaller"}  # fmt: skip
_SIGNS = {"<": "({} < {})", "<=": "({} <= {})", "==": "({} == {})", "!=": "({} != {})"}
C = Style("const double {} = {};", {
    **_SIGNS, "choose": "({} ? {} : {})", "and": "({} && {})", "or": "({} || {})", "not": "!{}",
    "true": "1", "nan": "NAN",
}, _NAMES)  # fmt: skip
LANES = Style("const dal_vec {} = {};", {
    **_SIGNS, "and": "({} & {})", "or": "({} | {})", "not": "~{}", "true": "~(dal_mask){{0}}",
    "nan": "NAN",
}, _NAMES, "DAL_LANES({name})({args})", "DAL_LANES(all_of)({})")  # fmt: skip
PYTHON = Style("{} = {}", {
    **_SIGNS, "choose": "({1} if {0} else {2})", "and": "({} and {})", "or": "({} or {})",
    "not": "(not {})", "true": "True", "nan": "nan",
})  # fmt: skip

# ---- what languages have -------------------------------------------------------------------------


def spelled(nodes: Sequence[Node]) -> list[Node]:
    """Return nodes without powers that are products, quotients or square roots.

    Their graph is a new one.  So their text does not depend on other uses of the graph of the
    model.
    """
    graph, made = Graph(), dict[Node, Node]()
    for node in below(nodes):
        args = [made[a] for a in node.args]
        if node.op == "pow":
            made[node] = _spelled_power(graph, args[0], node.value)
        else:
            made[node] = graph.make(node.op, *args, value=node.value)
    return [made[e] for e in nodes]


def _spelled_power(graph: Graph, x: Node, exponent: int | Fraction) -> Node:
    count, degree = abs(exponent.numerator), exponent.denominator
    if count > 64 or degree > 2:
        return graph.make("power", x, graph.number(exponent))
    root = x if degree == 1 else graph.make("sqrt", x)
    if exponent < 0:
        return _repeated(graph.make("/", graph.one, root), count)
    if degree == 1 or count == 1:
        return _repeated(root, count)
    return graph.make("*", _repeated(x, count // 2), root)


def _repeated(x: Node, count: int) -> Node:
    """Return x^count by repeated squaring."""
    if count == 1:
        return x
    half = _repeated(x, count // 2)
    square = x.graph.make("*", half, half)
    return x.graph.make("*", square, x) if count % 2 else square


# ---- text ----------------------------------------------------------------------------------------


class Text:
    """The text of some nodes, which are `spelled`.

    Parameters
    ----------
    nodes : sequence of Node
        All nodes whose value is wanted.
    style : Style
    symbols : mapping of str to str, optional
        The texts of symbols that are not their names.
    in_array : bool, optional
        Whether named parts are elements of an array of C.

    Attributes
    ----------
    called : set of str
        The functions of the math library that are written.
    count : int
        How many names there are.
    """

    def __init__(
        self, nodes: Sequence[Node], style: Style, symbols: Mapping[str, str] | None = None,
        in_array: bool = False,
    ) -> None:  # fmt: skip
        self.style = style
        self.called: set[str] = set()
        self._symbols = symbols or {}
        self._in_array = in_array
        self._uses = _uses(nodes)
        self._known: dict[Node, tuple[str, int]] = {}
        self.count = 0

    def names(self, nodes: Iterable[Node], asked: Iterable[Node]) -> list[str]:
        """Return definitions of those nodes, by index, that have a name; see the module.

        The nodes in ``asked`` have none, unless others use them too.
        """
        lines = []
        wanted = {*asked}
        for node in nodes:
            text, strength = self._written(node)
            if node.op in _LEAVES or node.op in CONDITIONS or (
                self._uses[node] < 2 and (node in wanted or len(text) <= _LONGEST)
            ):
                self._known[node] = text, strength
                continue
            is_number = _is_number(node)
            line = self.style.line.replace("dal_vec", "double") if is_number else self.style.line
            name = f"x{self.count}"
            if self._in_array and not is_number:
                name, line = f"part[{self.count}]", "{} = {};"
            lines.append(line.format(name, text))
            self._known[node] = name, _ATOM
            self.count += 1
        return lines

    @property
    def zero(self) -> str:
        """The text of 0, as a value of its own."""
        return self.style.vector.format("0.0") if self.style.vector else "0.0"

    def whole(self, node: Node) -> str:
        """Return the text of a node after its parts were named, as a value of its own."""
        text, _ = self._known[node]
        return self._argument(node, text)

    def _argument(self, node: Node, text: str) -> str:
        return self.style.vector.format(text) if self.style.vector and _is_number(node) else text

    def _written(self, e: Node) -> tuple[str, int]:
        """Return the text of an operation, and how strongly it holds together."""
        op = e.op
        style = C if self.style.vector and _is_number(e) else self.style
        if op == "symbol":
            return self._symbols.get(e.value, e.value), _ATOM
        if op in ("number", "constant"):
            text = repr(nearest(e))
            return text, _ATOM if text[0] != "-" else _SUM
        if op in ("+", "-"):
            a, b = e.args
            return f"{self._part(a, _SUM)} {op} {self._part(b, _PRODUCT)}", _SUM
        if op == "*":
            return self._product(*e.args), _PRODUCT
        if op == "/":
            return f"{self._part(e.args[0], _PRODUCT)} / {self._part(e.args[1], _ATOM)}", _PRODUCT
        parts = [self._known[a][0] for a in e.args]
        if op not in _SIGNS and style is self.style:
            parts = [self._argument(a, part) for a, part in zip(e.args, parts)]
        if op in style.forms:
            return style.forms[op].format(*parts), _ATOM
        name = style.names.get(op, op)
        if style is self.style and op not in ("fabs", "choose") and not name.startswith("model_"):
            self.called.add(name)
        return style.call.format(name=name, args=", ".join(parts)), _ATOM

    def _product(self, a: Node, b: Node) -> str:
        if a.op == "number" and a.value == -1:
            return f"-{self._part(b, _PRODUCT)}"
        for one, other in ((a, b), (b, a)):
            if other.op == "/" and self._uses[other] < 2 and other.args[0].value == 1:
                return f"{self._part(one, _PRODUCT)} / {self._part(other.args[1], _ATOM)}"
        return f"{self._part(a, _PRODUCT)} * {self._part(b, _ATOM)}"

    def _part(self, e: Node, strength: int) -> str:
        text, own = self._known[e]
        return text if own >= strength else f"({text})"


_SUM, _PRODUCT, _ATOM = range(3)


# ---- functions of Python -------------------------------------------------------------------------


def as_function(
    arguments: Mapping[str, Sequence[Node] | Node], nodes: Sequence[Node]
) -> Callable[..., list[float]]:
    """Return a function of Python of numbers and sequences of numbers, which returns a list."""
    nodes = spelled(nodes)
    used = {e.value for e in below(nodes) if e.op == "symbol"}
    text = Text(nodes, PYTHON)
    lines = []
    for name, given in arguments.items():
        places = [(given, name)] if isinstance(given, Node) else [
            (x, f"{name}[{i}]") for i, x in enumerate(given)
        ]  # fmt: skip
        lines += [f"{x.value} = float64({place})" for x, place in places if x.value in used]
    lines += text.names(below(nodes), nodes)
    lines.append(f"return [{', '.join(map(text.whole, nodes))}]")
    body = "".join(f"        {line}\n" for line in lines)
    source = f"def made({', '.join(arguments)}):\n    with errstate(all='ignore'):\n{body}"
    names = dict(_IN_PYTHON)
    exec(compile(source, "<model>", "exec"), names)
    made: Callable[..., list[float]] = names["made"]
    return made


def function(
    arguments: Mapping[str, Sequence[Expr] | Expr], expressions: Sequence[Expr]
) -> Callable[..., list[float]]:
    """Return the same for SymPy expressions in the symbols of the arguments."""
    graph = Graph()
    several = {key: x if isinstance(x, Sequence) else [x] for key, x in arguments.items()}
    symbols = {s: graph.symbol(s.name) for x in several.values() for s in x}
    read = Reader(graph, symbols)
    nodes = {
        key: [symbols[s] for s in x] if isinstance(x, Sequence) else symbols[x]
        for key, x in arguments.items()
    }
    return as_function(nodes, [read(e) for e in expressions])


def _step(x: float, at_zero: float) -> float:
    return x if math.isnan(x) else at_zero if x == 0 else float(x > 0)


_IN_PYTHON: dict[str, Any] = {
    name: getattr(np, name) for name in (
        "errstate", "float64", "nan", "sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log",
        "sqrt", "fabs", "sign",
    )
} | {
    "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2,
    "asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh, "power": np.power,
    "max": np.maximum, "min": np.minimum, "erf": math.erf, "erfc": math.erfc, "step": _step,
}  # fmt: skip


def _is_number(e: Node) -> bool:
    """Return whether a node has no symbols."""
    return not e.reach & ~(WALL | PIECE) and e.op not in CONDITIONS


def _uses(nodes: Sequence[Node]) -> dict[Node, int]:
    """Return how often each node is used; an output is a use."""
    found = dict.fromkeys(below(nodes), 0)
    for node in found:
        for a in node.args:
            found[a] += 1
    for node in dict.fromkeys(nodes):
        found[node] += 1
    return found


def nearest(e: Node) -> float:
    """Return the double nearest to a number or a constant."""
    return e.value.numerator / e.value.denominator if e.op == "number" else float(e.value)


@dataclass
class Program:
    """C source, line by line."""

    lines: list[str] = field(default_factory=list)

    @property
    def source(self) -> str:
        """The source code."""
        return "".join(f"{line}\n" for line in self.lines)

    def add(self, text: str) -> None:
        """Add lines."""
        self.lines += text.split("\n")
