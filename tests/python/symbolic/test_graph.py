"""The graph of operations: its rules, its derivatives, and its text, against SymPy and mpmath."""

import itertools
import operator
import random
import sys
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import pytest
import sympy

from dalembert.symbolic.graph import Graph, below
from dalembert.symbolic.printing import LANES, Text, as_function, function, spelled
from dalembert.symbolic.reading import Reader
from dalembert.symbolic.values import may_vanish, values

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks/campaigns"))
import evaluation  # noqa: E402

U = 2.0**-53


@pytest.fixture
def graph():
    return Graph()


def test_rules(graph):
    """Equal formulas are one node; each line is a rule of the module."""
    x, y, z = map(graph.symbol, "xyz")
    third = Fraction(1, 3)
    same = [
        (x + y, y + x), (x * y, y * x), ((2 * x) * (3 * y), 6 * (x * y)), (x + 0, x), (1 * x, x),
        (x + x, 2 * x), (graph.sum([x, -y, -x]), -y), (2 * x + third * x, Fraction(7, 3) * x),
        (x * x, x**2),
        (x**2 * x**-2, graph.one), (x**2 / x, x), ((x**2) ** 3, x**6), ((2 * x) ** 3, 8 * x**3),
        (graph.call("sqrt", x) ** 2, x), (graph.call("sqrt", x) * graph.call("sqrt", x), x),
        ((x + y) - (x + z), y - z), (3 * (x + y) - 3 * x, 3 * y), (0 * x, graph.zero),
        (y + (x - y), x), (x + ((y - x) + z), y + z), (2 * y - 2 * (y - x), 2 * x),
        (((x - y) - z) - ((x - y) + z**2), -(z + z**2)),
        (x / 2 + y / 2, (x + y) / 2), (3 - 3 * x, 3 * (1 - x)), (-x - y, -(x + y)),
        (graph.call("cos", graph.zero), graph.one), (-(x - y), y - x), (x / 2, x * Fraction(1, 2)),
        (graph.call("max", graph.number(2), graph.number(3)), graph.number(3)),
        (graph.choose(graph.truth(True), x, y), x), (graph.choose(graph.truth(False), x, y), y),
    ]  # fmt: skip
    for k, (one, other) in enumerate(same):
        assert one is other, k
    assert (x - y) - (y - z) is not x - 2 * y + z  # far from 0 the differences are exact
    different = [(graph.call("sqrt", x**2), x), (x - y, y - x), (x**third, x), (x / y, y / x)]
    for k, (one, other) in enumerate(different):
        assert one is not other, k


def test_numbers_are_exact_unless_out_of_range(graph):
    x = graph.symbol("x")
    small = Fraction(1, 10**200)
    assert (Fraction(1, 10) * (Fraction(1, 10) * x)).args[0].value == Fraction(1, 100)
    product = small * (small * x)  # whose factor is no double
    assert [a.value for a in (product.args[0], product.args[1].args[0])] == [small, small]
    assert (10**200 * product).args[1].op != "number"
    twice = graph.product([10**200, 10**200, x])
    assert values([twice], {"x": 1})[0] == mpmath.mpf(10) ** 400
    assert graph.sum(2 * [10**308 * x]).op == "+"


def test_numbers_in_lanes_are_numbers(graph):
    x, root = graph.symbol("x"), graph.call("sqrt", graph.number(2))
    nodes = spelled([root * x, root + x])
    text = Text(nodes, LANES)
    assert text.names(below(nodes), nodes) == ["const double x0 = sqrt(2.0);"]
    assert not text.called


def test_long_chains_are_trees(graph):
    """256 terms need 8 additions one after the other; a sine is added last."""
    terms = [graph.symbol(f"x{i}") for i in range(256)]
    assert graph.sum(terms).depth == 8 and graph.product(terms).depth == 8
    last = graph.sum([graph.call("sin", terms[0]), *terms[1:9]])
    assert last.depth == graph.call("sin", terms[0]).depth + 1
    whole = graph.sum(terms)
    assert len(graph.gradient(whole, terms)) == 256
    assert [*map(len, [below([whole]), below([whole], terms[3].bit)])] == [511, 9]


def test_collected_terms_of_a_symmetric_form(graph):
    """The momenta of v^T M v / 2 are M v: no entry is added to itself."""
    v = [graph.symbol(f"v{i}") for i in range(3)]
    M = [[graph.symbol(f"M{min(i, j)}{max(i, j)}") for j in range(3)] for i in range(3)]
    rows = [graph.sum(a * b for a, b in zip(row, v)) for row in M]
    L = Fraction(1, 2) * graph.sum(a * b for a, b in zip(v, rows))
    slopes = graph.gradient(L, v)
    for i in range(3):
        assert len(below([slopes[v[i]]])) == 3 + 3 + 5, i


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_derivatives_of_any_order_along_directions(graph, order):
    """Along again, in mixed directions, against SymPy."""
    symbols = sympy.symbols("x y z", real=True)
    x, y, z = symbols
    e = sympy.exp(x * y) / (2 + sympy.sin(z)) + sympy.tanh(x - z) * sympy.sqrt(1 + y**2) ** 3
    nodes = {s: graph.symbol(s.name) for s in symbols}
    root, expected = [Reader(graph, nodes)(e)], e
    source = random.Random(order)
    for _ in range(order):
        direction = {s: source.randint(-3, 3) for s in symbols}
        root = graph.along(root, {nodes[s]: k for s, k in direction.items()})
        expected = sum(k * sympy.diff(expected, s) for s, k in direction.items())
    point = {s.name: source.randint(1, 900) / 701 for s in symbols}
    with mpmath.workdps(40):
        wanted = expected.xreplace({s: sympy.Rational(point[s.name]) for s in symbols})
        wanted = wanted._to_mpmath(mpmath.mp.prec)
        assert abs(values(root, point)[0] - wanted) <= 1e-32 * (1 + abs(wanted))


def test_digits_of_smooth_steps():
    """The slope of tanh keeps its digits far out, where 1 - tanh^2 has none."""
    graph = Graph()
    x = graph.symbol("x")
    (slope,) = graph.gradient(graph.call("tanh", x), [x]).values()
    z = sympy.Symbol("x", real=True)
    at = function({"x": z}, [Reader(graph, {z: x}).formula(slope)])
    for value in (0.3, 5.0, 20.0, 300.0):
        expected = float(1 / mpmath.cosh(value) ** 2)
        assert at(value)[0] == pytest.approx(expected, rel=8 * U, abs=0)


def test_values_of_random_formulas():
    """In Python and in C, against 50 digits; the campaign has hundreds."""
    errors, _ = zip(*evaluation.campaign(40))
    assert 0.1 < max(errors) <= evaluation.BAR


def test_text_groups_as_the_graph():
    """Differences and quotients, in all groupings, in both languages."""
    a, b, c = symbols = sympy.symbols("a b c", real=True)
    forms = [
        a - (b - c), a - (b + c), (a - b) - c, a / (b * c), a / b / c, a / (b / c), -a * (b + c),
        -(a + b) * c, a * (b - c) - b * (c - a), -a / b - c, (a * b) ** 3 - c**-2, -(a**2) * -b,
        2 - a, -3 + a * -2, sympy.sqrt(a) ** -3, a ** sympy.Rational(5, 2), 1 / (3 + a / b),
    ]  # fmt: skip
    with mpmath.workdps(60):
        at = dict(zip(symbols, (0.7, 1.9, 1.3)))
        given = [evaluation.Case(e, at) for e in forms]
        for evaluated in (evaluation.in_python, evaluation.in_c):
            errors = [c.error(x) for c, x in zip(given, evaluated(given))]
            assert max(errors) <= evaluation.BAR, forms[np.argmax(errors)]


def test_operations_on_operations_of_the_same_strength(graph):
    """a - (b - c), a / (b / c), ...: all pairs, in both places."""
    a, b, c = nodes = [graph.symbol(x) for x in "abc"]
    at = dict(zip("abc", (Fraction(7), Fraction(5), Fraction(-2))))
    exact = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}
    made, expected = [], []
    for one, other in itertools.product("+-*/", repeat=2):
        made.append(graph.make(one, a, graph.make(other, b, c)))
        expected.append(exact[one](at["a"], exact[other](at["b"], at["c"])))
        made.append(graph.make(one, graph.make(other, b, c), a))
        # operands of sums and products have an order
        pair = exact[other](at["b"], at["c"]), at["a"]
        expected.append(exact[one](*pair))
    point = [float(x) for x in at.values()]
    for e, value in zip(made, expected):  # each alone, for shared parts have names
        assert as_function({"z": nodes}, [e])(point)[0] == pytest.approx(float(value), rel=4 * U)


def test_conditions():
    """All relations and connectives, on both sides of their walls and on them."""
    x, y = symbols = sympy.symbols("x y", real=True)
    conditions = [
        x > y, x >= y, x < y, x <= y, sympy.Eq(x, y), sympy.Ne(x, y), (x > 1) & (y < 2),
        (x > 1) | (y < 2), ~((x > 1) & (y < 2)), sympy.ITE(x > 1, y > 2, y < 0),
    ]  # fmt: skip
    forms = [sympy.Piecewise((1, condition), (0, True)) for condition in conditions]
    at = function({"z": symbols}, forms)
    for point in itertools.product((-1, 1, 1.5, 2, 3), repeat=2):
        values = dict(zip(symbols, map(sympy.Rational, point)))
        exact = [int(bool(c.xreplace(values))) for c in conditions]
        assert at(point) == exact, point


def test_values_that_no_precision_reaches():
    """Arguments of sines that have 10^12 digits are given up, at once."""
    graph = Graph()
    x = graph.symbol("x")
    for e in (graph.call("cos", graph.call("exp", 10**12 * x)),
              graph.call("sin", graph.call("cosh", 10**34 * x))):  # fmt: skip
        assert may_vanish([x * e], {"x": 0.7}) == [True]


def test_the_same_text_in_any_order_of_questions(graph):
    """Symbols and parts that were read before change nothing."""
    x, y = sympy.symbols("x y", real=True)
    forms = [x**2 + y**2 + sympy.sin(x * y), x**3 - y]
    texts = set()
    for order in itertools.permutations([x, x**2, sympy.sin(x * y)]):
        read = Reader(graph, {s: graph.symbol(s.name) for s in (x, y)})
        for e in order:
            read(e)
        texts.add(str([read.formula(read(e)) for e in forms]))
    assert len(texts) == 1
