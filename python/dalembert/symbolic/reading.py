"""SymPy expressions as nodes of a graph, and nodes as SymPy expressions."""

from __future__ import annotations

import functools
import itertools
from collections import Counter
from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import Any

import sympy
from sympy.logic.boolalg import Boolean

from . import formula
from .graph import Graph, Node

Expr = Any

# Functions of C that SymPy has by these names, or by their inverse.
FUNCTIONS = {getattr(sympy, x): x for x in formula.FUNCTIONS if x not in ("Abs", "sqrt")}
FUNCTIONS |= {sympy.Abs: "fabs", sympy.sign: "sign", sympy.Heaviside: "step"}
_INVERSE = {sympy.sec: "cos", sympy.csc: "sin", sympy.cot: "tan"}
_OF_TWO = {sympy.Max: "max", sympy.Min: "min", sympy.And: "and", sympy.Or: "or"}
_RELATIONS = {"<": "<", "<=": "<=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}


class Reader:
    """Translation of expressions in known symbols; equal parts are read once.

    Two factors that occur together in several products are multiplied first.

    Parameters
    ----------
    graph : Graph
    symbols : mapping of sympy.Symbol to Node
    expressions : iterable of sympy.Expr, optional
        Those whose products are compared.
    """

    def __init__(
        self, graph: Graph, symbols: Mapping[Expr, Node], expressions: Iterable[Expr] = ()
    ) -> None:
        self.graph = graph
        self._pairs = _pairs(expressions)
        self._known: dict[Expr, Node] = dict(symbols)
        self._written: dict[Node, Expr] = {node: s for s, node in symbols.items()}

    def __call__(self, e: Expr) -> Node:
        """Return the node of an expression."""
        found = self._known.get(e)
        if found is None:
            found = self._known[e] = self._read(e)
        return found

    def _read(self, e: Expr) -> Node:
        graph = self.graph
        if e.is_Rational or e.is_Float:
            value = sympy.Rational(e)  # a double is one exactly
            return graph.number(Fraction(value.p, value.q))
        if isinstance(e, sympy.Piecewise):
            return self._piecewise(e)
        if e.is_Mul:
            return self._product(e)
        args = [self(a) for a in e.args]
        if isinstance(e, Boolean):
            return self._condition(e, args)
        if not args or all(a.op in ("number", "constant") for a in args):
            return graph.make("constant", value=e)
        if e.is_Add:
            return graph.sum(args)
        if e.is_Pow:
            base, exponent = args
            if exponent.op == "number":
                return graph.power(base, exponent.value)
            return graph.call("power", base, exponent)
        if name := _INVERSE.get(e.func):
            return 1 / graph.call(name, *args)
        if name := _OF_TWO.get(e.func):
            return functools.reduce(functools.partial(graph.call, name), args)
        return graph.call(FUNCTIONS[e.func], *args)

    def _product(self, e: Expr) -> Node:
        """Return a product as one numerator over one denominator."""
        above = self._joined([a for a in e.args if not _is_below(a)])
        below = [self(1 / a) for a in e.args if _is_below(a)]
        if all(a.op in ("number", "constant") for a in (*above, *below)):
            return self.graph.make("constant", value=e)
        return self.graph.product(above) / self.graph.product(below)

    def _joined(self, factors: list[Expr]) -> list[Node]:
        """Return factors; two that occur together more than once are one."""
        found = []
        while len(factors) > 1:
            pair = max(itertools.combinations(factors, 2), key=lambda x: self._pairs[frozenset(x)])
            if self._pairs[frozenset(pair)] < 2:
                break
            factors = [a for a in factors if a not in pair]
            found.append(self.graph.product(map(self, pair)))
        return [*found, *map(self, factors)]

    def _piecewise(self, e: Expr) -> Node:
        found = self.graph.nan
        for value, condition in reversed(e.args):
            found = self.graph.choose(self(condition), self(value), found)
        return found

    def _condition(self, e: Expr, args: list[Node]) -> Node:
        graph = self.graph
        if e in (sympy.true, sympy.false):
            return graph.truth(e == sympy.true)
        if isinstance(e, sympy.Not):
            return graph.make("not", *args)
        if isinstance(e, sympy.ITE):
            condition, one, other = args
            elsewhere = graph.make("and", graph.make("not", condition), other)
            return graph.make("or", graph.make("and", condition, one), elsewhere)
        if name := _OF_TWO.get(e.func):
            return functools.reduce(functools.partial(graph.make, name), args)
        return graph.call(_RELATIONS[e.rel_op], *(args[::-1] if ">" in e.rel_op else args))

    # ---- and back ------------------------------------------------------------------------------

    def formula(self, node: Node) -> Expr:
        """Return the expression of a node."""
        made = self._written
        left = [node]
        while left:
            e = left[-1]
            unknown = [a for a in e.args if a not in made]
            if e in made or not unknown:
                left.pop()
                if e not in made:
                    made[e] = self._write(e, [made[a] for a in e.args])
            else:
                left += unknown
        return made[node]

    def _write(self, e: Node, args: list[Expr]) -> Expr:
        op = e.op
        if op in _WRITTEN:
            return _WRITTEN[op](*args)
        if op == "number":
            return sympy.Rational(e.value.numerator, e.value.denominator)
        if op == "constant":
            return e.value
        if op == "symbol":  # that no expression has, as w0 of the equations on D
            return sympy.Symbol(e.value, real=True)
        if op == "pow":
            return args[0] ** sympy.Rational(e.value.numerator, e.value.denominator)
        if op == "choose":
            condition, one, other = args
            rest = [] if other is sympy.nan else [(other, True)]
            return sympy.Piecewise((one, condition), *rest)
        return _SYMPY[op](*args)


def _is_below(e: Expr) -> bool:
    """Return whether a factor belongs to the denominator."""
    return bool(e.is_Pow and e.exp.is_Rational and e.exp.is_negative)


def _pairs(expressions: Iterable[Expr]) -> Counter[frozenset[Expr]]:
    """Return how often two factors occur in a product together."""
    found: Counter[frozenset[Expr]] = Counter()
    seen: set[Expr] = set()
    left = list(expressions)
    while left:
        e = left.pop()
        if e not in seen:
            seen.add(e)
            left += e.args
            if e.is_Mul:
                factors = [a for a in e.args if not a.is_Number and not _is_below(a)]
                found.update(map(frozenset, itertools.combinations(factors, 2)))
    return found


_SYMPY = {name: f for f, name in (FUNCTIONS | _OF_TWO).items()}
_WRITTEN = {
    "+": sympy.Add, "-": lambda a, b: a - b, "*": sympy.Mul, "power": sympy.Pow,
    "<": sympy.Lt, "<=": sympy.Le, "==": sympy.Eq, "!=": sympy.Ne,
    "not": sympy.Not, "true": lambda: sympy.true, "nan": lambda: sympy.nan,
}  # fmt: skip
