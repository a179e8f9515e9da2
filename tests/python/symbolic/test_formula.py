"""Formulas of systems: as they are read, as MathML, and against the systems that carry them."""

from __future__ import annotations

import html
import re
import sys

import numpy as np
import pytest
import sympy
from conftest import Page, U

import dalembert as dal
from dalembert import growth
from dalembert.symbolic import formula
import dalembert.symbolic.expressions as expressions
from dalembert.system.sources import Expressions

IN_C = dal.systems.names()
ALL = (*IN_C, *dal.systems.names_in_sympy())


# ---- reading -------------------------------------------------------------------------------------


def expression(text):
    """Return a formula as SymPy has it, evaluated."""
    (found,) = formula.read(text, exact=True)
    return found.doit()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2 x y", 30.0),
        ("x y/2 + 1", 8.5),
        ("1/2 x", 1.5),  # from left to right
        ("x/2/y", 0.3),
        ("-x^2 + y^2", 16.0),
        ("2 - x - y", -6.0),
        ("x^-1", 1 / 3),
        ("x^(y - 3)", 9.0),
        ("(x + y) (x - y)", -16.0),
        ("m a_1/sqrt(x y)", 14 / 15**0.5),
        ("y sin(x)^2", 5 * np.sin(3) ** 2),
        ("1.5e1 x", 45.0),
        ("2x", 6.0),
        ("x 2", 6.0),
        ("-x y", -15.0),
        ("x - (y - 2)", 0.0),
        ("2^x^2", 512.0),
        ("- - x", 3.0),
    ],
)
def test_values(text, expected):
    found = expression(text).subs({"x": 3, "y": 5, "m": 2, "a_1": 7})
    assert float(found) == pytest.approx(expected, rel=1e-15)


def test_decimals_are_exact():
    assert expression("0.1 x + 2.5e-3") == sympy.Symbol("x") / 10 + sympy.Rational(1, 400)


def test_names_are_names():
    """Also words of Python, functions that are not known here, and the constants of SymPy."""
    words = ["lambda", "in", "None", "E", "I", "pi", "S", "open", "os", "nu0", "sin"]
    assert expression(" ".join(words)) == sympy.Mul(*map(sympy.Symbol, words))
    (found,) = formula.read("eval(x) Add(x)")
    assert {f.func.__name__ for f in found.atoms(sympy.core.function.AppliedUndef)} == {
        "eval", "Add",
    }  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        "", "x +", "(x", "x)", "x ^", "sin()", "x = ", "= x", "x?", "3 ~ x", "a, b", "x^^2",
        "(a, b)", "x.y", "1.2.3", "x**2", "x//2", "x[0]", "'x'", "_0", "__import__(os)", "x\ny",
        "é", "(" * 60 + "x" + ")" * 60, "-" * 3000 + "x", "9" * 5000, "a" * 50_000 + "?",
    ],
)  # fmt: skip
def test_no_formulas(text):
    with pytest.raises(ValueError, match="formula = "):
        formula.read(text)
    assert formula.mathml(text) == f"<code>{html.escape(text)}</code>"


def test_nothing_is_evaluated():
    assert formula.latex("9^9^9^9") == ["9^{9^{9^{9}}}"]
    assert formula.latex("x + (y - 1.50 x) = 1e300 sin(0)") == [
        "x", "{}+ y", r"{}- 1.5\,x", r"{}= 1.0 \cdot 10^{300}\,\sin{\left(0 \right)}",
    ]  # fmt: skip


# ---- MathML --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "read"),
    [
        ("v_x^2/2", "x˙22"),
        ("v_theta0 - theta_x", "θ˙0−θx"),
        ("m gs x", "mgsx"),
        ("v_y_i", "y˙i"),
        ("u_(i-1)", "u(i−1)"),
        ("v_w", "vw"),  # w is no coordinate
        ("sqrt(A B) atan(x/y)", "ABatan(xy)"),
        ("sum_i(y_i)", "∑i(yi)"),
        ("k1 x + J0", "k1x+J0"),
        ("a = b = 2", "a=b=2"),
        ("a - (b + c)", "a−(b+c)"),
        ("-y x", "−yx"),
        ("eps lambda/2", "ϵλ2"),
        ("1/2 x", "12x"),
        ("2 (x + 1)/3", "2(x+1)3"),
    ],
)
def test_mathml(text, read):
    """All stands in its order, with a dot for a velocity."""
    found = formula.mathml(text, ["x", "y1", "y2", "theta0"])
    assert "".join(Page(found).words.split()) == read


def test_fractions_and_roots_lose_their_brackets():
    assert formula.latex("(a + b)/(c (d))") == [r"\frac{a + b}{c\,d}"]
    assert formula.latex("x^(a + b) sqrt(a + b)") == [r"x^{a + b}\,\sqrt{a + b}"]
    found = formula.mathml("(a + b)/2")
    assert found.count("<mfrac>") == 1 and "(" not in Page(found).words


def test_lines_may_break_before_a_sign():
    """A formula is a piece for each of its terms, with the sign that stands before it."""
    found = re.findall("<math.*?</math>", formula.mathml("L = -a x^2 + (b + c)/2 - d"))
    assert [Page(x).words for x in found] == ["L", "=−ax2", "+b+c2", "−d"]
    for piece in found[1:]:  # an operator that is not the first of a row is no prefix
        assert re.match("<math[^>]*><mrow>(<mrow ?/>|<mrow></mrow>)<mo>", piece)


def test_foreign_names_are_shown_as_they_are():
    assert formula.mathml("<b>") == "<code>&lt;b&gt;</code>"


@pytest.mark.parametrize("package", ["sympy", "latex2mathml.converter"])
def test_without_what_writes_formulas(package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    assert formula.mathml("x < 2") == "<code>x &lt; 2</code>"
    assert formula.mathml("x + 2") == "<code>x + 2</code>"


# ---- the formulas of the systems -----------------------------------------------------------------


def twin(name, **parameters):
    """Return a system in C, and that of its formulas."""
    system = dal.systems.get(name, **parameters)
    about = {"name": name, "help": "", "description": "", "source": ""}
    model = expressions.model(system)
    return system, dal.System._of(Expressions(model, system.parameters, about, None, None, {}))


CHANGED = {
    "chaotic": {"pairs": 2},
    "n_trailer": {"trailers": 2, "d": 0.7, "m": 1.4, "J": 0.3},
    "sleigh": {"m": 0.6, "J": 1.7, "a": -0.9},
    "rolling_disc": {"m": 1.6, "r": 0.7, "A": 0.4, "C": 0.9, "g": 2.1},
}


@pytest.mark.parametrize("name", IN_C)
def test_model_of_formulas(name):
    """L and phi that are read are those of the system, at states off D and with other parameters.

    Both are sums of at most some dozen terms of the size of the result or of the state: 64 u.
    """
    source = np.random.default_rng(7)
    system, made = twin(name, **CHANGED.get(name, {}))
    assert (made.n, made.m, made.kind) == (system.n, system.m, system.kind)
    assert made.coordinates == system.coordinates
    for _ in range(3):
        q, v = source.uniform(-1, 1, (2, system.n))
        for what in ("energy", "residual", "metric"):
            one, other = (np.asarray(getattr(s, what)(q, v)) for s in (system, made))
            size = max(1.0, np.abs(one).max())
            np.testing.assert_allclose(other, one, rtol=0, atol=64 * U * size, err_msg=what)
        v = system.project(q, v)
        one, other = (s.acceleration(q, v) for s in (system, made))
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-12 * max(1, np.abs(one).max()))


@pytest.mark.parametrize("name", ALL)
def test_names_of_invariants_say_what_they_are(name):
    """The value of each invariant is that of its name, with what is explained put in."""
    system = dal.systems.get(name)
    values = dict(system.parameters)
    values |= dict(zip(system.coordinates, system.q0))
    values |= {f"v_{x}": v for x, v in zip(system.coordinates, system.v0)}
    values["energy"] = system.energy(system.q0, system.v0)
    lines = [x.removeprefix("where ") for x in system.formulas if x.startswith("where ")]
    if name == "two_wheeled_robot":  # its docstring
        lines = [
            "u = v_x cos(theta) + v_y sin(theta)",
            "A = m + 2 I/r^2",
            "B = J + m a^2 + 2 I b^2/r^2",
        ]
        assert all(f"`{line}`" in system.description for line in lines)
    for line in lines:
        left, right = line.split(" = ")
        if "_i" not in left:
            values[left] = float(expression(right).subs(values))
    for text, expected in system.invariant(system.q0, system.v0).items():
        found = float(expression(text).subs(values))
        assert found == pytest.approx(expected, rel=1e-13, abs=1e-13)


@pytest.mark.parametrize("name", ALL)
def test_formulas_are_complete(name):
    """All names are known, and all is read; there is L, and a line for each constraint."""
    system = dal.systems.get(name)
    known = {*system.coordinates, *system.parameters, *(f"v_{x}" for x in system.coordinates)}
    defined = {x.split(" = ")[0][6:] for x in system.formulas if x.startswith("where ")}
    for line in system.formulas:
        assert "<code>" not in formula.mathml(line.removeprefix("where "), system.coordinates)
        sides = formula.read(line.removeprefix("where "))
        left = {x.name for side in sides for x in side.free_symbols} - known - defined - {"L"}
        assert all(re.search(r"_(i|\(i-1\))$", x) for x in left), (line, left)
    assert system.formulas[0].startswith("L = ")
    rows = [x for x in system.formulas[1:] if not x.startswith("where ")]
    assert len(rows) == system.m or name == "n_trailer"
    assert all(line.endswith(" = 0") for line in rows)


def test_models_that_cannot_be():
    plain = {"mass": [1, 1], "coordinates": ["x", "y"]}
    bad = {
        (): "has no formulas",
        ("L = v_x^2 + foo(y)",): "foo\\(y\\) is an unknown function",
        ("L = v_x^2/2 + w",): "w is neither a coordinate",
        ("L = v_x^2", "v_y_i = 0"): None,
        ("L = v_x^2 + y_i",): "the index belongs to no sum",
        ("L = (v_x, v_y)",): "a list is out of place",
    }
    for formulas, text in bad.items():
        system = dal.System(formulas=formulas, **plain)
        assert system.formulas == formulas
        if text is None:  # an index over nothing: no constraint
            assert expressions.model(system).m == 0
            continue
        with pytest.raises(ValueError, match=text):
            expressions.model(system)


# ---- of expressions ------------------------------------------------------------------------------


def test_formulas_of_expressions():
    x, y = dal.coordinates("x y")
    m, k = sympy.symbols("m k")
    own = dal.System.from_sympy(
        m * (x.d**2 + y.d**2) / 2 + x * y.d - k * sympy.sqrt(1 + x**2) / 3,
        [y.d - x**2 * x.d],
        parameters={m: 2, k: 1},
        force={x: -x.d},
    )
    assert own.formulas[1:] == ("-v_x x^2 + v_y = 0", "f_x = -v_x")
    moving, _, rest = own.formulas[0].partition(" - ")
    assert moving.startswith("L = ") and "v_x" in moving and rest == "k sqrt(x^2 + 1)/3"
    source = np.random.default_rng(2)
    q, v = source.uniform(-1, 1, (2, 2))
    values = {"m": 2, "k": 1, "x": q[0], "y": q[1], "v_x": v[0], "v_y": v[1]}
    L = float(expression(own.formulas[0][4:]).subs(values))
    momentum = own.metric(q, v) @ v + [0, q[0]]
    assert own.energy(q, v) == pytest.approx(momentum @ v - L, rel=1e-13)
