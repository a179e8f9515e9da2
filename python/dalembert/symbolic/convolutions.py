"""The cost of the Taylor series of an ODE: its convolutions.

A coefficient of a product of two series is a convolution of theirs, which takes most of the time.
A factor whose series has at most two terms makes it a sum: a constant, the time, and a coordinate
whose velocity is constant.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from .graph import Node, below

MANY = 2  # the degree of a series that does not end

_FREE = ("fabs", "sign", "step", "max", "min", "choose")
_FUNCTIONS = {"exp": 1, "log": 1, "power": 3}
_PAIRS = {"sin": "sin", "cos": "sin", "sinh": "sinh", "cosh": "sinh"}


def degrees(rates: Mapping[Node, Node]) -> dict[Node, int]:
    """Return the degrees, at most `MANY`, of the series of symbols with these rates."""
    found = dict.fromkeys(rates, MANY)
    while True:
        known = degrees_of(rates.values(), found)
        better = {
            x: min(found[x], 0 if e.is_zero else known[e] + 1) for x, e in rates.items()
        }  # fmt: skip
        if better == found:
            return found
        found = better


def degrees_of(nodes: Iterable[Node], symbols: Mapping[Node, int]) -> dict[Node, int]:
    """Return the degrees of nodes and of all they are made of; other symbols are constants."""
    found: dict[Node, int] = {}
    for e in below(nodes):
        if e.op == "symbol":
            found[e] = symbols.get(e, 0)
            continue
        given = [found[a] for a in e.args]
        if e.op in ("+", "-"):
            found[e] = max(given)
        elif e.op == "*":
            found[e] = min(sum(given), MANY)
        else:
            found[e] = MANY if any(given) else 0
    return found


def cost(rates: Mapping[Node, Node]) -> int:
    """Return the number of convolutions of an ODE, given as the rates of its symbols.

    Examples
    --------
    >>> from dalembert.symbolic.convolutions import cost
    >>> from dalembert.symbolic.graph import Graph
    >>> graph = Graph()
    >>> x, y, k = map(graph.symbol, "xyk")
    >>> cost({x: y, y: -k * x}), cost({x: y, y: -k * x**3}), cost({x: k, y: x * y})
    (0, 2, 0)
    """
    return cost_of([*rates.values()], degrees(rates))


def cost_of(nodes: Sequence[Node], symbols: Mapping[Node, int]) -> int:
    """Return the number of convolutions of nodes, given the degrees of the symbols."""
    known = degrees_of(nodes, symbols)
    found = 0
    pairs: set[tuple[str, Node]] = set()
    inverses: set[Node] = {e for e in nodes if _is_inverse(e) and known[e] == MANY}
    for e, degree in known.items():
        divisors = [a for a in e.args if _is_inverse(a) and known[a] == MANY]
        if e.op == "*":
            one, other = (known[a] for a in e.args)
            found += one == other == MANY
            if min(one, other) < MANY or len(divisors) == 2:
                inverses.update(divisors[:1])
            continue
        inverses.update(divisors)
        if degree < MANY or all(known[a] < MANY for a in e.args) or e.op in ("+", "-", *_FREE):
            continue
        if e.op == "pow":
            if not _is_inverse(e):
                found += 1 if e.value == 2 else 2
        elif e.op in _PAIRS:
            pairs.add((_PAIRS[e.op], e.args[0]))
        else:
            found += _FUNCTIONS.get(e.op, 2)
    return found + 2 * len(pairs) + sum(known[e.args[0]] == MANY for e in inverses)


def _is_inverse(e: Node) -> bool:
    return e.op == "pow" and e.value == -1
