"""Formulas as a graph of operations, each of which stands once.

A node is a number, a symbol, or an operation on one or two nodes; a choice and a condition have
more.  Nodes are made by the functions of a `Graph`, which return the node that is already there if
it has the same operation and arguments.  So equal parts of all formulas of a model are one node,
and are computed once.

These are the rules by which formulas are rewritten, and all of them:

- Numbers are rational, and folded exactly, unless the result is out of the range of doubles.
- A number comes first in a product, and once: (2 x) (3 y) is 6 (x y); -(x - y) is y - x.
- In a sum equal terms are collected, also those of sums in it that are not long; in a product
  equal bases, with their exponents.  A difference in a sum is kept: x - y has digits that x lacks.
  But if one of its terms cancels it is opened: y + (x - y) is x.
- A number that all terms of a sum have is taken out: 2 x + 2 y is 2 (x + y).
- x + 0, 1 x, 0 x, x^1, x^0 and (x^a)^b are simplified as for numbers.
- A function of numbers is a number where that is exact, as cos(0) and max(2, 3).
- The arguments of a sum, a product, a maximum and a minimum are in the order of their creation.
- Long sums and products are trees in which the operands that are known first meet first.

Nothing is expanded, factored or solved.  Derivatives are made on the graph.
"""

from __future__ import annotations

import functools
import heapq
import operator
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

import sympy

Number = int | Fraction

# The bits of `Node.reach` that belong to no symbol.
WALL = 1  # a maximum, a minimum or an absolute value is in it
PIECE = 2  # so is a function that is not analytic

# A sum with more terms is one term of another sum.
_LONG = 24

CONDITIONS = ("<", "<=", "==", "!=", "and", "or", "not", "true")
_WALLS = ("max", "min", "fabs")
_JUMPS = ("sign", "step")
_COMMUTE = ("+", "*", "max", "min", "==", "!=", "and", "or")

# How long a result takes, relative to a sum; for all other functions it is 12.
_LATENCY = {"+": 1, "-": 1, "*": 1, "/": 3, "sqrt": 4, "pow": 4, "fabs": 0, "choose": 1, "max": 1,
            "min": 1, "sign": 2, "step": 2} | dict.fromkeys(CONDITIONS, 0)  # fmt: skip


class Node:
    """A node of a graph.

    Attributes
    ----------
    op : str
        "number", "constant", "symbol" or "nan"; "+", "-", "*", "/"; "pow" with a rational exponent;
        "choose", with a condition and two values; a condition; or the name of a function of C,
        where "step" is Heaviside's, with its value at 0.
    args : tuple of Node
    value : object
        The number; the constant as a SymPy expression; the name of the symbol; the exponent.
    reach : int
        The bits of all symbols, and of jumps, in it.
    index : int
        Nodes are numbered as they are made, so arguments come before operations on them.
    depth : int
        The time after which the result is known, relative to that of a sum.
    bit : int
        The bit of a symbol or a jump in `reach`.
    is_zero : bool
        Whether the node is the number 0.
    """

    __slots__ = ("args", "bit", "depth", "graph", "index", "is_zero", "op", "reach", "value")

    def __init__(self, graph: Graph, op: str, args: tuple[Node, ...], value: Any) -> None:
        self.graph, self.op, self.args, self.value = graph, op, args, value
        self.index = len(graph.nodes)
        self.is_zero = op == "number" and value == 0
        self.bit = graph.new_bit() if op == "symbol" or op in _JUMPS else 0
        self.reach, self.depth = self.bit, 0
        for a in args:
            self.reach |= a.reach
            self.depth = max(self.depth, a.depth)
        if args:
            self.depth += _LATENCY.get(op, 12)
        if op in _WALLS:
            self.reach |= WALL | PIECE
        elif op in _JUMPS or op == "choose":
            self.reach |= PIECE

    def __add__(self, other: Node | Number) -> Node:
        return self.graph.sum([self, other])

    def __sub__(self, other: Node | Number) -> Node:
        return self.graph.sum([self, -1 * self.graph.node(other)])

    def __rsub__(self, other: Node | Number) -> Node:
        return self.graph.node(other) - self

    def __mul__(self, other: Node | Number) -> Node:
        return self.graph.product([self, other])

    def __truediv__(self, other: Node | Number) -> Node:
        return self * self.graph.power(self.graph.node(other), -1)

    def __rtruediv__(self, other: Number) -> Node:
        return self.graph.node(other) / self

    def __pow__(self, exponent: Number) -> Node:
        return self.graph.power(self, exponent)

    def __neg__(self) -> Node:
        return -1 * self

    __radd__, __rmul__ = __add__, __mul__


class Graph:
    """The nodes of a model.

    Examples
    --------
    >>> from dalembert.symbolic.graph import Graph
    >>> graph = Graph()
    >>> x, y = graph.symbol("x"), graph.symbol("y")
    >>> y * x is x * y
    True
    >>> slopes = graph.gradient(x**2 * y, [x, y])
    >>> slopes[x] is 2 * (x * y), slopes[y] is x**2
    (True, True)
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[tuple[Any, ...], Node] = {}
        self._bits = PIECE
        self.zero, self.one = self.number(0), self.number(1)
        self.nan = self.make("nan")

    def new_bit(self) -> int:
        """Return a bit for `Node.reach` that nothing has."""
        self._bits <<= 1
        return self._bits

    def make(self, op: str, *args: Node, value: Any = None) -> Node:
        """Return the node of an operation as it stands, see `Node`."""
        if op in _COMMUTE and _place(args[0]) > _place(args[1]):
            args = args[1], args[0]
        key = (op, value, *(a.index for a in args))
        found = self._known.get(key)
        if found is None:
            found = self._known[key] = Node(self, op, args, value)
            self.nodes.append(found)
        return found

    # ---- numbers, sums, products, powers -------------------------------------------------------

    def symbol(self, name: str) -> Node:
        return self.make("symbol", value=name)

    def number(self, x: Number) -> Node:
        return self.make("number", value=x.numerator if x.denominator == 1 else x)

    def node(self, x: Node | Number) -> Node:
        return x if isinstance(x, Node) else self.number(x)

    def sum(self, terms: Iterable[Node | Number]) -> Node:
        """Return the sum of terms."""
        given = [self.node(x) for x in terms]
        found = _collected(_split(e) for e in given)
        within = [part for e, x in found.items() for part in _terms(e, x)]
        collected = _opened(_collected(within))
        if len(collected) < len(within):
            found = collected
        if not all(_is_in_range(x) for x in found.values()):
            return self._tree([(e, 1) for e in given], self._sum_of_two)[0]
        if not found:
            return self.zero
        sizes = {abs(x) for x in found.values()}
        common = sizes.pop() if len(sizes) == 1 else 1
        parts = [
            (self.scaled(1 if abs(x) == common else abs(x), e), 1 if x > 0 else -1)
            for e, x in found.items()
        ]
        node, sign = self._tree(parts, self._sum_of_two)
        return self.scaled(sign * common, node)

    def _sum_of_two(self, one: tuple[Node, int], other: tuple[Node, int]) -> tuple[Node, int]:
        (a, sign), (b, second) = one, other
        if sign == second:
            return self.make("+", a, b), sign
        return (self.make("-", a, b) if sign > 0 else self.make("-", b, a)), 1

    def product(self, factors: Iterable[Node | Number]) -> Node:
        """Return the product of factors."""
        number: Number = 1
        numbers: list[Node] = []
        found: dict[Node, Number] = {}
        for given in factors:
            factor, rest = _split(self.node(given))
            if factor != 1:
                if _is_in_range(number * factor):
                    number *= factor
                else:
                    numbers.append(self.number(factor))
            base, exponent = (rest.args[0], rest.value) if rest.op == "pow" else (rest, 1)
            if base is not self.one:
                found[base] = found.get(base, 0) + exponent
        if number == 0:
            return self.zero
        parts = [(self.power(base, k), 1) for base, k in found.items() if k != 0]
        parts += [(x, 1) for x in numbers]
        if not parts:
            return self.number(number)
        node, _ = self._tree(parts, lambda a, b: (self.make("*", a[0], b[0]), 1))
        return self.scaled(number, node)

    def _tree(
        self, parts: list[tuple[Node, int]], join: Callable[..., tuple[Node, int]]
    ) -> tuple[Node, int]:
        """Return parts joined in pairs, those first that are known first."""
        waiting = [(part[0].depth, i, part) for i, part in enumerate(parts)]
        heapq.heapify(waiting)
        for i in range(len(parts), 2 * len(parts) - 1):
            _, _, one = heapq.heappop(waiting)
            _, _, other = heapq.heappop(waiting)
            joined = join(one, other)
            heapq.heappush(waiting, (joined[0].depth, i, joined))
        return waiting[0][2]

    def scaled(self, factor: Number, e: Node) -> Node:
        """Return a number times a node."""
        if factor == 1 or e.is_zero:
            return e
        inner, rest = _split(e)
        if inner != 1:
            if not _is_in_range(factor * inner):
                return self.make("*", self.number(factor), e)
            factor *= inner
        if factor < 0 and rest.op == "-":
            factor, rest = -factor, self.make("-", *rest.args[::-1])
        if rest is self.one or factor == 0:
            return self.number(factor)
        return rest if factor == 1 else self.make("*", self.number(factor), rest)

    def power(self, base: Node, exponent: Number) -> Node:
        """Return a rational power."""
        if base.op == "pow" and (base.value.denominator > 1 or exponent.denominator == 1):
            return self.power(base.args[0], base.value * exponent)  # but sqrt(x^2) is not x
        if exponent == 0:
            return self.one
        if exponent == 1 or base is self.one:
            return base
        if exponent.denominator == 1:
            factor, rest = _split(base)
            if abs(exponent) <= 64 and (factor or exponent > 0):
                whole = Fraction(factor) ** int(exponent)
                if rest is self.one and _is_in_range(whole):
                    return self.number(whole)
                if factor != 1 and rest is not self.one and _is_in_range(whole):
                    return self.scaled(whole, self.power(rest, exponent))
        value = exponent.numerator if exponent.denominator == 1 else exponent
        return self.make("pow", base, value=value)

    # ---- functions -----------------------------------------------------------------------------

    def call(self, name: str, *args: Node) -> Node:
        """Return a function, or a condition, of nodes."""
        if name == "sqrt":
            return self.power(args[0], Fraction(1, 2))
        if name in _EXACT and all(a.op == "number" for a in args):
            value = _EXACT[name](*(a.value for a in args))
            if value is not None:
                return self.number(value) if not isinstance(value, bool) else self.truth(value)
        return self.make(name, *args)

    def truth(self, value: bool) -> Node:
        """Return the condition that always holds, or never."""
        true = self.make("true")
        return true if value else self.make("not", true)

    def choose(self, condition: Node, one: Node, other: Node) -> Node:
        """Return ``one`` where a condition holds, and ``other`` elsewhere."""
        if condition.op == "true" or one is other:
            return one
        if condition.op == "not" and condition.args[0].op == "true":
            return other
        return self.make("choose", condition, one, other)

    def step(self, x: Node) -> Node:
        """Return Heaviside's function of x, 1/2 at 0, as the derivative of a maximum."""
        return self.make("step", x, self.number(Fraction(1, 2)))

    # ---- derivatives ---------------------------------------------------------------------------

    def gradient(self, e: Node, variables: Iterable[Node]) -> dict[Node, Node]:
        """Return the derivatives of a node by those variables on which it depends.

        A variable is a symbol, or a jump.  Jumps are constants otherwise, see `jumps`.  Reverse
        differentiation: the derivatives by all variables take as long as a few values.
        """
        return self._gradient(e, {x: None for x in variables}, {})

    def _gradient(
        self, e: Node, variables: Mapping[Node, Any], known: dict[Node, dict[Node, Node]]
    ) -> dict[Node, Node]:
        mask = mask_of(variables)
        sums: dict[Node, list[Node]] = {e: [self.one]}
        found: dict[Node, Node] = {}
        for node in reversed(below([e], mask)):
            slope = self.sum(sums.pop(node, ()))
            if slope.is_zero:
                continue
            if node in variables:
                found[node] = slope
                continue
            if node.op == "choose":
                parts = self._choice(node, variables, known)
            else:
                parts = [(a, x) for a, x in self._slopes(node) if a.reach & mask]
            for a, x in parts:
                sums.setdefault(a, []).append(slope * x)
        return found

    def _choice(
        self, e: Node, variables: Mapping[Node, Any], known: dict[Node, dict[Node, Node]]
    ) -> list[tuple[Node, Node]]:
        """Return the derivatives of a choice by variables: each branch alone, for elsewhere its
        derivatives may not exist.
        """
        condition, *branches = e.args
        for branch in branches:
            if branch not in known:
                known[branch] = self._gradient(branch, variables, known)
        return [
            (x, self.choose(condition, *(self._in_branch(b, known[b].get(x)) for b in branches)))
            for x in variables
            if any(x in known[b] or (b is self.nan and e.reach & x.bit) for b in branches)
        ]  # fmt: skip

    def _in_branch(self, branch: Node, slope: Node | None) -> Node:
        return branch if branch is self.nan else self.zero if slope is None else slope

    def along(self, nodes: Sequence[Node], direction: Mapping[Node, Node | Number]) -> list[Node]:
        """Return the derivatives of nodes when symbols change at these rates.

        Forward differentiation; applied again it gives derivatives of any order.
        """
        mask = mask_of(direction)
        rates: dict[Node, Node] = {}
        for node in below(nodes, mask):
            if node in direction:
                rates[node] = self.node(direction[node])
            elif node.op == "choose":
                condition, one, other = node.args
                rates[node] = self.choose(
                    condition, *(self._in_branch(b, rates.get(b)) for b in (one, other))
                )
            else:
                rates[node] = self.sum(
                    [x * rates[a] for a, x in self._slopes(node) if a in rates]
                )
        return [rates.get(e, self.zero) for e in nodes]

    def _slopes(self, e: Node) -> Iterator[tuple[Node, Node]]:
        """Yield the arguments of an operation, with the derivatives by them."""
        op, args = e.op, e.args
        if op in ("+", "-"):
            yield args[0], self.one
            yield args[1], self.one if op == "+" else self.number(-1)
        elif op == "*":
            yield args[0], args[1]
            yield args[1], args[0]
        elif op == "pow":
            (x,) = args
            # 1/x and sqrt(x) are there already
            yield x, (
                -1 * (e * e) if e.value == -1 else
                Fraction(1, 2) / e if e.value == Fraction(1, 2) else e.value * x ** (e.value - 1)
            )  # fmt: skip
        elif op in ("max", "min"):
            one, other = args
            step = self.step(one - other if op == "max" else other - one)
            yield one, step
            yield other, 1 - step
        elif op in _SLOPES:
            yield from zip(args, _SLOPES[op](self, e, *args))

    def jumps(
        self, nodes: Iterable[Node], variables: Iterable[Node]
    ) -> Iterator[tuple[Node, Node]]:
        """Yield each jump in nodes whose argument depends on a variable, and its factor.

        The factor is the derivative by the jump.  Unless it is 0 there, there is a DiracDelta.
        """
        mask = mask_of(variables)
        for e in nodes:
            if e.reach & PIECE:
                found = [x for x in below([e], mask) if x.op in _JUMPS and x.args[0].reach & mask]
                for jump, factor in self.gradient(e, found).items() if found else ():
                    yield jump, factor

    # ---- other walks ---------------------------------------------------------------------------

    def replaced(
        self, nodes: Sequence[Node], values: Mapping[Node, Node],
        rule: Callable[[Node], Node] | None = None,
    ) -> list[Node]:  # fmt: skip
        """Return nodes with some nodes replaced by others; then ``rule`` of each new node."""
        made: dict[Node, Node] = {}
        for node in below(nodes):
            if node in values:
                made[node] = values[node]
                continue
            args = [made[a] for a in node.args]
            new = node if all(a is b for a, b in zip(args, node.args)) else self.again(node, args)
            made[node] = new if rule is None else rule(new)
        return [made[e] for e in nodes]

    def again(self, e: Node, args: Sequence[Node]) -> Node:
        """Return the operation of a node on other arguments."""
        if e.op in ("+", "-"):
            return args[0] + args[1] if e.op == "+" else args[0] - args[1]
        if e.op == "*":
            return args[0] * args[1]
        if e.op == "pow":
            return self.power(args[0], e.value)
        return self.choose(*args) if e.op == "choose" else self.call(e.op, *args)

    def bounded(self, nodes: Sequence[Node]) -> list[Node]:
        """Return nodes whose inverse powers are finite at walls.

        A power such as 1/sqrt(max(0, x)) is 1 where its base is 0, so that a step as its factor
        makes it 0.
        """

        def rule(e: Node) -> Node:
            if e.op not in ("pow", "power") or not e.args[0].reach & WALL:
                return e
            base, *exponents = e.args
            finite = self.make("!=", base, self.zero)
            for y in exponents:
                finite = self.make("or", finite, self.call("<=", self.zero, y))
            if exponents or e.value < 0:
                base = self.choose(finite, base, self.one)
            return self.again(e, [base, *exponents])

        changed = iter(self.replaced([e for e in nodes if e.reach & WALL], {}, rule))
        return [next(changed) if e.reach & WALL else e for e in nodes]


def below(nodes: Iterable[Node], mask: int = -1) -> list[Node]:
    """Return nodes and all that they are made from, if a bit of the mask is in them, by index."""
    found: set[Node] = set()
    left = [e for e in nodes if mask == -1 or e.reach & mask]
    while left:
        e = left.pop()
        if e not in found:
            found.add(e)
            left += [a for a in e.args if mask == -1 or a.reach & mask]
    return sorted(found, key=lambda e: e.index)


def pieces(e: Node) -> list[Node]:
    """Return the functions in a node that are not analytic."""
    if not e.reach & PIECE:
        return []
    return [x for x in below([e], PIECE) if x.op in (*_WALLS, *_JUMPS, "choose")]


def mask_of(variables: Iterable[Node]) -> int:
    """Return the bits of symbols and jumps, to be compared with `Node.reach`."""
    mask = 0
    for x in variables:
        mask |= x.bit
    return mask


def _terms(e: Node, factor: Number) -> list[tuple[Number, Node]]:
    """Return the terms of a multiple of a sum; a long sum is one term."""
    whole, found = (factor, e), list[tuple[Number, Node]]()
    left = [whole]
    while left:
        factor, e = left.pop()
        inner, rest = _split(e)
        factor *= inner
        if rest.op == "+":
            left += [(factor, a) for a in reversed(rest.args)]
        else:
            found.append((factor, rest))
        if len(found) + len(left) > _LONG:
            return [whole]
    return found


def _collected(terms: Iterable[tuple[Number, Node]]) -> dict[Node, Number]:
    """Return the factor of each term of a sum, unless it is 0."""
    found: dict[Node, Number] = {}
    for factor, e in terms:
        found[e] = found.get(e, 0) + factor
    return {e: x for e, x in found.items() if x}


def _opened(sums: dict[Node, Number]) -> dict[Node, Number]:
    """Return the factors of terms with the terms of those differences in which one cancels."""
    for e in [e for e in sums if e.op == "-"]:
        if e not in sums:
            continue  # it has cancelled
        rest = {other: x for other, x in sums.items() if other is not e}
        opened = [(x, a) for k, a in zip((1, -1), e.args) for x, a in _terms(a, k * sums[e])]
        if any(rest.get(a) == -x for x, a in opened):
            sums = _collected([*((x, a) for a, x in rest.items()), *opened])
    return sums


def _place(e: Node) -> tuple[bool, int]:
    """Return the place among the arguments of an operation that commutes: numbers come first."""
    return e.op != "number", e.index


def _split(e: Node) -> tuple[Number, Node]:
    """Return the number and the rest of a product."""
    if e.op == "number":
        return e.value, e.graph.one
    if e.op == "*" and e.args[0].op == "number" and e.args[1].op != "number":
        return e.args[0].value, e.args[1]
    return 1, e


def _is_in_range(x: Number) -> bool:
    """Return whether a number is 0, or its double is neither infinite nor subnormal."""
    if abs(x.numerator.bit_length() - x.denominator.bit_length()) < 1000:
        return True  # as nearly always
    return x == 0 or _LEAST <= abs(x) <= _MOST


_LEAST, _MOST = Fraction(sys.float_info.min), Fraction(sys.float_info.max)


# Values of functions of numbers, None where they are not rational.
_EXACT: dict[str, Callable[..., Number | bool | None]] = {
    "fabs": abs, "sign": lambda x: (x > 0) - (x < 0), "max": max, "min": min,
    "step": lambda x, at_zero: at_zero if x == 0 else int(x > 0),
    "<": operator.lt, "<=": operator.le, "==": operator.eq, "!=": operator.ne,
} | {
    name: functools.partial(lambda value, x: value if x == 0 else None, value)
    for value, names in ((0, "sin tan asin atan sinh tanh asinh atanh erf"),
                         (1, "cos exp cosh erfc"))
    for name in names.split()
}  # fmt: skip


# Derivatives by the arguments, from the function f and its arguments.
_SLOPES: dict[str, Callable[..., tuple[Node, ...]]] = {
    "sin": lambda g, f, x: (g.call("cos", x),),
    "cos": lambda g, f, x: (-g.call("sin", x),),
    "tan": lambda g, f, x: (1 + f**2,),
    "asin": lambda g, f, x: (1 / g.call("sqrt", 1 - x**2),),
    "acos": lambda g, f, x: (-1 / g.call("sqrt", 1 - x**2),),
    "atan": lambda g, f, x: (1 / (1 + x**2),),
    "atan2": lambda g, f, y, x: (x / (x**2 + y**2), -y / (x**2 + y**2)),
    "sinh": lambda g, f, x: (g.call("cosh", x),),
    "cosh": lambda g, f, x: (g.call("sinh", x),),
    "tanh": lambda g, f, x: (1 / g.call("cosh", x) ** 2,),  # 1 - f^2 has no digits for large x
    "asinh": lambda g, f, x: (1 / g.call("sqrt", 1 + x**2),),
    "acosh": lambda g, f, x: (1 / (g.call("sqrt", x - 1) * g.call("sqrt", x + 1)),),
    "atanh": lambda g, f, x: (1 / (1 - x**2),),
    "exp": lambda g, f, x: (f,),
    "log": lambda g, f, x: (1 / x,),
    "erf": lambda g, f, x: (_bell(g, x),),
    "erfc": lambda g, f, x: (-_bell(g, x),),
    "fabs": lambda g, f, x: (g.make("sign", x),),
    "power": lambda g, f, x, y: (_slope_of_power(g, x, y), f * g.call("log", x)),
}


def _bell(g: Graph, x: Node) -> Node:
    return g.call("exp", -(x**2)) * g.make("constant", value=2 / sympy.sqrt(sympy.pi))


def _slope_of_power(g: Graph, x: Node, y: Node) -> Node:
    """Return y x^(y-1), which is 0 for y = 0 also at x = 0."""
    slope = y * g.call("power", x, y - 1)
    return g.choose(g.make("==", y, g.zero), g.zero, slope) if y.reach else slope
