"""Taylor series of a motion, as recurrences.

The coefficients of order k of each operation follow from those of its arguments up to order k, and
of itself up to k-1.  See series.h for the convolutions.  With c for the result:

- c = a b.  c_k = sum a_j b_(k-j).
- c = a / b.  b_0 c_k = a_k - sum b_j c_(k-j), j >= 1.
- c^2 = a.  2 c_0 c_k = a_k - sum c_j c_(k-j), 1 <= j < k.
- c = a^e.  a_0 k c_k = sum (e j a_j c_(k-j)) - sum (j c_j a_(k-j)).
- c' = a' b, as for sin, exp, tan, erf.  k c_k = sum j a_j b_(k-j).
- c' b = a', as for log, asin.  b_0 k c_k = k a_k - sum j c_j b_(k-j).

A series has degree 0 or 1 if it is constant or linear in t, and takes no convolution then.

A function with branches, such as a maximum, has the series of one of them.  Another branch comes
when a switch changes its sign, the difference of the arguments.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import sympy

from .graph import CONDITIONS, Graph, Node, below, mask_of

# Degree of a series that does not end.
ENDLESS = 2

# Powers of the time, and of sines and cosines; higher ones are pulses.
_LOW, _LOW_OF_WAVES = 4, 16

COMPARED = ("max", "min", "<", "<=", "==", "!=")
_ALONE = ("fabs", "sign", "step")
BRANCHING = (*COMPARED, *_ALONE)
_CONSTANT = ("sign", "step", *CONDITIONS)  # between switches

# Functions that may be far below the last digit, and then grow beyond all others.
_EXPONENTIAL = ("exp", "sinh", "cosh")

# Functions with branches where they are finite: beyond, the series of asin(sin(t)) goes on as t.
_BRANCHED = ("asin", "acos", "acosh", "atan2")


@dataclass(frozen=True)
class Rule:
    """How the derivative of a function follows from that of its argument.

    Attributes
    ----------
    other : callable
        Returns b, from the graph, the argument and the function.
    is_quotient : bool
        Whether c' b = a', and not c' = a' b.
    sign : int
        Factor of the derivative.
    """

    other: Callable[[Graph, Node, Node], Node]
    is_quotient: bool = False
    sign: int = 1


def _square(g: Graph, x: Node) -> Node:
    return g.make("*", x, x)


def _bell(g: Graph, x: Node) -> Node:
    power = g.make("exp", g.make("*", g.number(-1), _square(g, x)))
    return g.make("*", g.make("constant", value=2 / sympy.sqrt(sympy.pi)), power)


def _root(g: Graph, sign: int, x: Node, shift: int) -> Node:
    square = _square(g, x)
    total = g.make("+" if sign > 0 else "-", g.number(shift), square)
    return g.make("sqrt", total)


RULES = {
    "sin": Rule(lambda g, x, c: g.make("cos", x)),
    "cos": Rule(lambda g, x, c: g.make("sin", x), sign=-1),
    "sinh": Rule(lambda g, x, c: g.make("cosh", x)),
    "cosh": Rule(lambda g, x, c: g.make("sinh", x)),
    "exp": Rule(lambda g, x, c: c),
    "tan": Rule(lambda g, x, c: g.make("+", g.one, _square(g, c))),
    "tanh": Rule(lambda g, x, c: g.make("-", g.one, _square(g, c))),
    "erf": Rule(lambda g, x, c: _bell(g, x)),
    "erfc": Rule(lambda g, x, c: _bell(g, x), sign=-1),
    "log": Rule(lambda g, x, c: x, True),
    "asin": Rule(lambda g, x, c: _root(g, -1, x, 1), True),
    "acos": Rule(lambda g, x, c: _root(g, -1, x, 1), True, -1),
    "atan": Rule(lambda g, x, c: g.make("+", g.one, _square(g, x)), True),
    "asinh": Rule(lambda g, x, c: _root(g, 1, x, 1), True),
    "acosh": Rule(lambda g, x, c: _root(g, 1, x, -1), True),
    "atanh": Rule(lambda g, x, c: g.make("-", g.one, _square(g, x)), True),
}  # fmt: skip

# Operands of convolutions: a series, and whether its coefficient of order j is multiplied by j.
Operand = tuple[Node, bool]
Pair = tuple[Operand, Operand]


# ---- operations with recurrences ---------------------------------------------------------------


def _prepared(nodes: Sequence[Node], changing: int) -> list[Node]:
    """Return nodes in operations that have recurrences, in a graph of their own.

    The bits of all symbols that are not constant are ``changing``.
    """
    graph, made = Graph(), dict[Node, Node]()
    for node in below(nodes):
        args = [made[a] for a in node.args]
        if node.op == "pow" and node.value == -2 and args[0].op == "cosh":
            tanh = graph.make("tanh", args[0].args[0])  # cosh overflows where the tanh is 1
            made[node] = graph.make("-", graph.one, _square(graph, tanh))
        elif node.op == "pow":
            made[node] = _power(graph, args[0], node.value)
        elif node.op == "*":
            made[node] = _product(graph, *args)
        elif node.op == "power" and node.args[1].reach & changing:
            exponent = graph.make("*", args[1], graph.make("log", args[0]))
            made[node] = graph.make("exp", exponent)
        else:
            made[node] = graph.make(node.op, *args, value=node.value)
    return [made[e] for e in nodes]


def _product(graph: Graph, a: Node, b: Node) -> Node:
    """Return a product, with 1/x in it as a division."""
    for one, other in ((a, b), (b, a)):
        if other.op == "/" and other.args[0] is graph.one:
            return graph.make("/", one, other.args[1])
    return graph.make("*", a, b)


def _power(graph: Graph, x: Node, exponent: int | Fraction) -> Node:
    """Return a rational power by products, a division, a root or the recurrence of powers."""
    if exponent == Fraction(1, 2):
        return graph.make("sqrt", x)
    if exponent.denominator > 1 or abs(exponent) > 64:
        return graph.make("power", x, graph.number(exponent))
    if exponent < 0:
        return graph.make("/", graph.one, _power(graph, x, -exponent))
    if exponent == 1:
        return x
    half = _power(graph, x, exponent // 2)
    square = graph.make("*", half, half)
    return graph.make("*", square, x) if exponent % 2 else square


class Series:
    """The recurrences of the rates of some states, or of functions of given series.

    Parameters
    ----------
    states : mapping of Node to Node
        The rate of each state; both belong to one graph.
    time : Node
        The symbol of the time.
    given : sequence of Node, optional
        Symbols whose coefficients are given.
    functions : sequence of Node, optional
        Nodes whose coefficients are wanted.

    Attributes
    ----------
    states, given, functions : dict of Node to Node, list of Node, list of Node
        The same in a graph of operations with recurrences.
    nodes : list of Node
        All operations and symbols, arguments first.
    degree : dict of Node to int
    pairs : dict of tuple to int
        The operands of each convolution, and its number.
    switches : dict of Node to int
        The series whose signs determine branches, numbered.
    sides : dict of Node to tuple of int
        The number of the switch of a function with branches, and the factor of its sign.
    exponents : dict of Node to None
        The arguments of exponential functions; they become large where those do.
    is_doubtful : bool
        Whether something may come that the series do not show: a pulse in time or of an angle,
        or another branch.
    """

    def __init__(
        self, states: Mapping[Node, Node], time: Node, given: Sequence[Node] = (),
        functions: Sequence[Node] = (),
    ) -> None:  # fmt: skip
        changing = mask_of([*states, *given, time])
        every = [*states, *states.values(), time, *given, *functions]
        prepared = iter(_prepared(every, changing))
        symbols = [next(prepared) for _ in states]
        self.states = {x: next(prepared) for x in symbols}
        self.time = next(prepared)
        self.given = [next(prepared) for _ in given]
        self.functions = list(prepared)
        self.other: dict[Node, Node] = {}
        self.switches: dict[Node, int] = {}
        self.sides: dict[Node, tuple[int, int]] = {}
        self.exponents: dict[Node, None] = {}
        self._complete()
        every = [*self.states, *self.states.values(), *self.other.values(), *self.switches,
                 *self.exponents, *self.given, *self.functions]  # fmt: skip
        self.nodes = below(every)
        self.degree = self._degrees()
        self.is_doubtful = self._has_branches() or self._has_pulses()
        self.pairs: dict[Pair, int] = {}
        for e in self.nodes:
            for pair in self.needs(e):
                self.pairs.setdefault(pair, len(self.pairs))

    def _has_branches(self) -> bool:
        return any(e.op in _BRANCHED and self.degree[e] > 0 for e in self.nodes)

    def _has_pulses(self) -> bool:
        """Return whether there are functions of time but low powers, or high powers of waves.

        Exponentials are followed by their arguments.
        """
        clock = mask_of([self.time])
        power: dict[Node, float] = {}  # of the time, sines and cosines in it
        waves: dict[Node, int] = {}  # the same of sines and cosines of anything
        for e in self.nodes:
            args = [power[a] for a in e.args]
            several = [waves[a] for a in e.args]
            is_wave = e.op in ("sin", "cos")
            waves[e] = sum(several) if e.op == "*" else max([*several, is_wave])
            if not e.reach & clock:
                power[e] = 0
            elif e is self.time:
                power[e] = 1
            elif e.op in ("+", "-") or e.op in _EXPONENTIAL:
                power[e] = max(args)
            elif e.op == "*":
                power[e] = sum(args)
            elif e.op == "/":
                power[e] = args[0] if args[1] == 0 else math.inf
            else:
                is_uniform = args[0] == 1 and self.degree[e.args[0]] == 1
                power[e] = 1 if is_wave and is_uniform else math.inf
        high = max(waves.values(), default=0) > _LOW_OF_WAVES
        return high or max(power.values(), default=0) > _LOW

    def _complete(self) -> None:
        """Find the series that functions need besides their arguments, and the switches."""
        changing = mask_of([*self.states, *self.given, self.time])
        left = below([*self.states, *self.states.values(), *self.functions])
        divisors = {*below(e.args[1] for e in left if e.op == "/")}
        while left:
            e = left.pop()
            graph = e.graph
            if e in self.other or e in self.sides or not e.reach & changing:
                continue
            if e.op in _EXPONENTIAL:
                signs = (1, -1) if e.op != "exp" or e in divisors else (1,)
                self.exponents |= {_times(sign, e.args[0]): None for sign in signs}
            elif e.op == "tanh":  # differs from 1 or -1 by an exponential of twice the argument
                twice = graph.make("+", e.args[0], e.args[0])
                self.exponents |= {_times(sign, twice): None for sign in (1, -1)}
            if e.op in RULES:
                found = self.other[e] = RULES[e.op].other(graph, e.args[0], e)
            elif e.op == "atan2":
                y, x = e.args
                found = self.other[e] = graph.make("+", _square(graph, x), _square(graph, y))
            elif e.op in BRANCHING:
                other = e.args[1] if e.op in COMPARED else graph.zero
                found, sign = _difference(e.args[0], other)
                self.sides[e] = self.switches.setdefault(found, len(self.switches)), sign
            else:
                continue
            left += below([found])

    def _degrees(self) -> dict[Node, int]:
        """Return the degree of each series: the least that the rates allow."""
        known = dict.fromkeys(self.states, 0)
        while True:
            degree: dict[Node, int] = {}
            for e in self.nodes:
                degree[e] = self._degree(e, degree, known)
            rates = {
                x: 0 if rate.is_zero else min(degree[rate] + 1, ENDLESS)
                for x, rate in self.states.items()
            }
            if rates == known:
                return degree
            known = rates

    def _degree(self, e: Node, degree: Mapping[Node, int], states: Mapping[Node, int]) -> int:
        if e in states:
            return states[e]
        if e is self.time:
            return 1
        if e in self.given:
            return ENDLESS
        if e.op in _CONSTANT:
            return 0
        if e.op == "choose":
            return ENDLESS if max(degree[a] for a in e.args[1:]) > 0 else 0
        of_args = [degree[a] for a in e.args]
        largest = max(of_args, default=0)
        if e.op in ("+", "-") or (e.op == "*" and min(of_args) == 0):
            return largest
        if e.op == "/" and of_args[1] == 0:
            return largest
        return ENDLESS if largest > 0 else 0

    def needs(self, e: Node) -> list[Pair]:
        """Return the convolutions of an operation."""
        degree = self.degree
        if degree[e] < ENDLESS or e in self.states:
            return []
        if e.op == "*":
            return [] if min(degree[a] for a in e.args) < 2 else [_pair(*e.args)]
        if e.op == "/":
            return [_pair(e.args[1], e)] if degree[e.args[1]] == ENDLESS else []
        if e.op == "sqrt":
            return [_pair(e, e)]
        if e.op == "power":
            return [((e.args[0], True), (e, False)), ((e, True), (e.args[0], False))]
        if e.op == "atan2":
            y, x = e.args
            pairs = ((y, x), (x, y), (e, self.other[e]))
            return [((a, True), (b, False)) for a, b in pairs]
        if rule := RULES.get(e.op):
            if rule.is_quotient:
                return [((e, True), (self.other[e], False))]
            is_linear = degree[e.args[0]] == 1
            return [] if is_linear else [((e.args[0], True), (self.other[e], False))]
        return []


def _difference(a: Node, b: Node) -> tuple[Node, int]:
    """Return the difference of two nodes up to a factor, and the sign of the factor."""
    if a.is_zero:
        found, sign = _difference(b, a)
        return found, -sign
    if b.is_zero and a.op == "*" and a.args[0].op == "number":  # as of -x
        found, sign = _difference(a.args[1], b)
        return found, sign if a.args[0].value > 0 else -sign
    if b.is_zero:
        return _difference(*a.args) if a.op == "-" else (a, 1)
    one, other = sorted((a, b), key=lambda e: e.index)
    return a.graph.make("-", one, other), 1 if one is a else -1


def _times(sign: int, a: Node) -> Node:
    return a if sign > 0 else a.graph.make("*", a.graph.number(-1), a)


def _pair(a: Node, b: Node) -> Pair:
    one, other = sorted((a, b), key=lambda e: e.index)
    return (one, False), (other, False)
