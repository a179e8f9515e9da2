"""Systems from SymPy: what is accepted and refused, what is generated, against exact arithmetic."""

import ctypes
import functools
import itertools
import json
import pickle
import random
import re
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import pytest
import sympy
from conftest import U, refused
from sympy.physics.mechanics import dynamicsymbols

import dalembert as dal
from dalembert import compiler, core
import dalembert.symbolic.codegen as codegen
import dalembert.symbolic.constructor as constructor
import dalembert.symbolic.given as symbolic
import dalembert.symbolic.symbols as model
from dalembert.symbolic import expressions
from dalembert.symbolic.evaluation import library
from dalembert.symbolic.graph import Graph, below
from dalembert.symbolic.reading import Reader
from dalembert.symbolic.values import values

VECTORS = json.loads((Path(__file__).parents[2] / "data" / "vectors.json").read_text("ascii"))


# ---- systems ---------------------------------------------------------------------------------


def from_strings(name, constrained=True):
    """Return a system of the vectors, from the strings that stand there."""
    entry = VECTORS["systems"][name]
    words = {c: sympy.Symbol(c) for c in [*entry["coordinates"], *entry["params"]]}

    def read(text):
        return sympy.sympify(text, locals=words, rational=True)

    q = [words[c] for c in entry["coordinates"]]
    v = sympy.symbols(f"u0:{len(q)}")
    M = sympy.Matrix([[read(e) for e in row] for row in entry["mass_matrix"]])
    velocity = sympy.Matrix(v)
    b = sympy.Matrix([read(e) for e in entry["b"]])
    L = (velocity.T * M * velocity)[0] / 2 + (b.T * velocity)[0] - read(entry["V"])
    mu = sympy.Matrix([[read(e) for e in row] for row in entry["mu"]])
    values = {key: float(Fraction(x)) for key, x in entry["params"].items()}
    return dal.System.from_sympy(
        L, mu if constrained else (), coordinates=list(zip(q, v)), parameters=values, name=name
    )


def trailer(count, **options):
    """Return a car with trailers in a row: n = count + 3, m = count + 1."""
    names = " ".join(f"theta{i}" for i in range(count + 1))
    x, y, *angles = dal.coordinates(f"x y {names}")
    rows = []
    X, Y = x.d, y.d
    for i, angle in enumerate(angles):
        if i > 0:  # the axle of trailer i is 1 behind the one before
            X = X + sympy.sin(angle) * angle.d
            Y = Y - sympy.cos(angle) * angle.d
        rows.append(sympy.sin(angle) * X - sympy.cos(angle) * Y)
    L = (x.d**2 + y.d**2 + sum(a.d**2 for a in angles)) / 2
    return dal.System.from_sympy(L, rows, coordinates=[x, y, *angles], **options)


def skates(count):
    """Return L, constraints and coordinates of skates in a row, a spring between neighbours."""
    q = dal.coordinates(" ".join(f"x{i} y{i} a{i}" for i in range(count)))
    places = [*zip(q[::3], q[1::3])]
    V = sum(
        (sympy.sqrt((x - u) ** 2 + (y - w) ** 2) - 1) ** 2 / 2
        for (x, y), (u, w) in itertools.pairwise(places)
    )
    rows = [sympy.cos(a) * y.d - sympy.sin(a) * x.d for (x, y), a in zip(places, q[2::3])]
    return sum(x.d**2 for x in q) / 2 - V, rows, q


def rich():
    """Return a system with everything in it: general metric, force, parameters, many functions."""
    x, y, z = dal.coordinates("x y z")
    a, b = sympy.symbols("a b")
    t = dynamicsymbols._t
    L = (
        (2 + sympy.sin(x)) * x.d**2 / 2
        + sympy.exp(y / 4) * y.d**2
        + (3 + sympy.sqrt(1 + z**2)) * z.d**2 / 2
        + a * sympy.cos(z) * x.d * y.d / 2
        + sympy.tanh(x) * y.d
        - sympy.log(2 + y**2) * b**3
        - sympy.atan2(y, 2 + x) ** 5
        - sympy.Rational(1, 3) * x**4 / (1 + z**2)
        - sympy.cosh(z) ** sympy.Rational(3, 2)
    )
    force = {x: sympy.cos(t) - a * x.d, z: -z.d * sympy.Abs(z.d) + sympy.pi * sympy.tan(t * x / 9)}
    rows = [z.d - sympy.sinh(y) * x.d / (1 + x**2) + b * sympy.asin(x / 3) * y.d]
    return dal.System.from_sympy(L, rows, parameters={a: 0.7, b: 1.3}, force=force)


def long():
    """Return a system of many operations, whose values are stored on the way."""
    x, y, theta = q = dal.coordinates("x y theta")
    V = sum(sympy.cos(k * x - y / k) * (theta + y / k) ** 3 / k**2 for k in range(1, 31))
    return dal.System.from_sympy(sum(v.d**2 for v in q) / 2 - V, [y.d - x * theta.d])


def of(L, constraints=(), coordinates=None, parameters=None, *more):
    """Return a model, which is not compiled."""
    return symbolic.make_model(L, constraints, coordinates, parameters, *more)[0]


# ---- generated callbacks against 25 digits ---------------------------------------------------


def value_and_scale(e, values):
    """Return an expression to 25 digits, and the size that its terms have: what rounding sees.

    Each part is taken to be known up to u times its scale; so the scale of a sum is the sum of the
    scales, and that of f(x) is |f(x)| + |f'(x)| scale(x).
    """
    if e.is_Symbol:
        return values[e], abs(values[e])
    if e.is_number:
        x = mpmath.mpf(sympy.N(e, 30)) if e != 0 else mpmath.mpf(0)
        return x, abs(x)
    parts = [value_and_scale(a, values) for a in e.args]
    if e.is_Add:
        return mpmath.fsum(x for x, _ in parts), mpmath.fsum(s for _, s in parts)
    if e.is_Mul:
        return mpmath.fprod(x for x, _ in parts), mpmath.fprod(s for _, s in parts)
    stand_ins = [sympy.Dummy(real=True) for _ in parts]
    f = e.func(*stand_ins)
    at = {d: sympy.Float(str(x), 30) for d, (x, _) in zip(stand_ins, parts)}
    x = mpmath.mpf(sympy.N(f.subs(at), 30))
    scale = abs(x)
    for d, (_, s), argument in zip(stand_ins, parts, e.args):
        if not argument.is_number:
            scale += abs(mpmath.mpf(sympy.N(f.diff(d).subs(at), 30))) * s
    return x, scale


def evaluate(system, name, t, q, v):
    """Call a callback of a compiled system through its pointer; every output by name."""
    n, m = system.n, system.m
    shapes = {
        "potential": {"V": 1, "V_q": n, "V_qq": n * n},
        "constraint": {"phi": m, "phi_v": m * n, "phi_q": m * n},
        "lagrangian": {
            "L": 1, "L_q": n, "L_v": n, "L_qq": n * n, "L_vq": n * n, "L_vv": n * n
        },
        "force": {"f": n, "f_q": n * n, "f_v": n * n},
    }[name]  # fmt: skip
    function = getattr(library(system._model).definition, name)
    parameters = np.array(list(system.parameters.values()))
    ctx = core.ffi.cast("void *", parameters.ctypes.data)
    point = [t, q] if name == "potential" else [t, q, v]
    rates = [] if name in ("potential", "force") else [core.ffi.NULL]  # phi_t, L_vt
    if name == "force":
        point.append(np.zeros(0))  # the inputs
    inputs = [x if isinstance(x, float) else core.pointer(x) for x in point]
    together = {key: np.full(size, np.nan) for key, size in shapes.items()}
    assert function(*inputs, *(core.pointer(x) for x in together.values()), *rates, ctx) == 0
    for key, size in shapes.items():  # alone it is the same, bit by bit
        alone = np.full(size, np.nan)
        wanted = [core.pointer(alone) if k == key else core.ffi.NULL for k in shapes]
        assert function(*inputs, *wanted, *rates, ctx) == 0
        np.testing.assert_array_equal(alone, together[key])
    if name == "constraint" and system.sparsity is not None:
        for key in ("phi_v", "phi_q"):
            matrix = np.zeros((m, n))
            matrix[system.sparsity] = together[key][: len(system.sparsity[0])]
            assert np.isnan(together[key][len(system.sparsity[0]) :]).all()
            together[key] = matrix.ravel()
    return together


MAKERS = {
    **{name: (lambda name=name: from_strings(name)) for name in VECTORS["systems"]},
    "trailer3": lambda: trailer(3),
    "skates3": lambda: dal.System.from_sympy(*skates(3)),
    "rich": rich,
    "long": long,
}


@pytest.mark.parametrize("name", MAKERS)
def test_callbacks_to_25_digits(name):
    """Every output at a state, within 64 u of the scale of its terms."""
    system = MAKERS[name]()
    found = system._model
    source = np.random.default_rng(5)
    checked = 0
    expressions = {
        "potential": {"V": [-found.L.xreplace(dict.fromkeys(found.v, sympy.S.Zero))]},
        "lagrangian": {"L": [found.L]},
        "constraint": {"phi": list(found.constraints)},
        "force": {"f": list(found.force or ())},
    }
    q, v = source.uniform(0.2, 1.1, (2, system.n))
    t = float(source.uniform(0.2, 1.1))
    values = dict(zip(found.q, map(mpmath.mpf, q))) | dict(zip(found.v, map(mpmath.mpf, v)))
    values |= dict(zip(found.p, map(mpmath.mpf, system.parameters.values())))
    values[model.TIME] = mpmath.mpf(t)
    for callback, outputs in expressions.items():
        if found.derived.function(callback) is None:
            continue
        base = next(iter(outputs.values()))
        for key in dict(found.derived.function(callback).outputs):
            letters = key.partition("_")[2]
            entries = base
            for letter in letters:
                entries = [e.diff(x) for e in entries for x in getattr(found, letter)]
            outputs[key] = entries
        got = evaluate(system, callback, t, q, v)
        with mpmath.workdps(30):
            for key, entries in outputs.items():
                for k, e in enumerate(entries):
                    x, scale = value_and_scale(e, values)
                    assert abs(got[key][k] - x) <= 64 * U * scale, (callback, key, k, e)
                    checked += 1
    assert checked >= system.n


def random_expression(source, symbols, depth):
    """Return a sum, product, power or function of some of the symbols; it may have jumps."""
    if depth == 0:
        return source.choice(symbols)
    parts = [random_expression(source, symbols, depth - 1) for _ in range(source.randint(2, 4))]
    one, two, *_ = parts
    return source.choice([
        lambda: sympy.Add(*(source.randint(-3, 3) * e for e in parts)),
        lambda: sympy.Add(*parts, source.randint(-1, 1)),
        lambda: sympy.Mul(*parts, sympy.Rational(source.randint(-3, 3), 2)),
        lambda: one * (two - 1) ** source.choice([2, 3, -1]) + one,
        lambda: sympy.sqrt(1 + one**2) * two,
        lambda: source.choice([sympy.sin, sympy.exp, sympy.atan, sympy.tanh])(one) - two,
        lambda: source.choice([sympy.Abs, sympy.sign, sympy.Heaviside])(one) * two**2,
        lambda: sympy.Piecewise((one, one > two), (two, True)) + sympy.Max(0, one),
    ])()  # fmt: skip


@pytest.mark.parametrize("seed", range(24))
def test_derivatives_on_the_graph(seed):
    """Reverse, forward and second derivatives are those of SymPy, at a point with 40 digits."""
    source, symbols = random.Random(seed), model.canonical("q", 6)
    e = random_expression(source, symbols, 3)
    graph = Graph()
    nodes = {s: graph.symbol(s.name) for s in symbols}
    read = Reader(graph, nodes)
    root, variables = read(e), [*nodes.values()]
    slopes = graph.gradient(root, variables)
    forward = [graph.along([root], {x: 1})[0] for x in variables]
    seconds = graph.along(forward, {variables[0]: 1, variables[3]: 2})
    point = {s.name: source.randint(-900, 900) / 701 for s in symbols}
    exact = {s: sympy.Rational(point[s.name]) for s in symbols}
    with mpmath.workdps(40):
        found, other, second = (
            values(x, point)
            for x in ([slopes.get(x, graph.zero) for x in variables], forward, seconds)
        )
        for i, x in enumerate(symbols):
            slope = sympy.diff(e, x).replace(sympy.DiracDelta, lambda *u: 0)
            both = sympy.diff(slope, symbols[0]) + 2 * sympy.diff(slope, symbols[3])
            both = both.replace(sympy.DiracDelta, lambda *u: 0)
            for value, expected in ((found[i], slope), (other[i], slope), (second[i], both)):
                wanted = expected.xreplace(exact)._to_mpmath(mpmath.mp.prec)
                assert abs(value - wanted) <= 1e-30 * (1 + abs(wanted)), (x, expected)
    assert set(slopes) <= {nodes[s] for s in e.free_symbols}


@pytest.mark.parametrize("name", ["snakeboard", "n_trailer"])
def test_constraints_are_differentiated_the_shorter_way(name):
    """Forward or in reverse."""
    found = expressions.model(getattr(dal.systems, name)()).derived
    phi, phi_v, phi_q = (found.entries("constraint", x) for x in ("phi", "phi_v", "phi_q"))
    variables = [e for e in below(phi) if e.op == "symbol" and e.value[0] in "qv"]
    graph = variables[0].graph
    reverse = [x for e in phi for x in graph.gradient(e, variables).values()]
    forward = [x for v in variables for x in graph.along(phi, {v: 1})]
    assert len(below([*phi_v, *phi_q])) <= min(len(below(reverse)), len(below(forward))) + 1


def test_work_grows_with_what_is_there():
    """Twice as many skates take twice as many operations and lines of the program.

    Their matrices grow fourfold.
    """
    work = []
    for count in (6, 12):
        skating = of(*skates(count))
        lines = codegen.program(skating, part="steps").source.count("\n")
        work.append((len(skating.derived.read.graph.nodes), lines))
    (operations, lines), (more, longer) = work
    # There are 5 and 11 springs.
    assert more <= 2.3 * operations and longer <= 2.3 * lines


def test_constraints_with_the_entries_of_their_sparsity(tmp_path):
    """What a compact program writes is what stands there in the matrices, and the rest is 0."""
    L, rows, q = skates(4)
    rows[1] += sympy.sin(q[0]) * q[11].d  # phi_q has an entry where phi_v has none
    found = of(L, rows, q)
    outputs = found.derived.function("constraint").outputs
    pattern = [
        (i, j) for i, j in itertools.product(range(4), range(12))
        if not (outputs["phi_v"][12 * i + j].is_zero and outputs["phi_q"][12 * i + j].is_zero)
    ]  # fmt: skip
    row, column = found.sparsity
    assert [*zip(row, column)] == pattern and len(pattern) == 4 * 3 + 2

    source = codegen.program(found, compact=None, part="steps").source
    assert ".sparsity = &model_sparsity" in source and "kernel.h" not in source
    assert "dal_sparsity model_sparsity = {14, model_row, model_column};" in source
    for name, places in (("row", row), ("column", column)):
        assert f"size_t model_{name}[] = {{{', '.join(map(str, places))}}};" in source
    callbacks, _, _ = source.partition("static const dal_sparsity")
    callbacks += """DAL_API void jacobians(const double *q, const double *v, double *a, double *b)
    { model_constraint(0.0, q, v, NULL, a, b, NULL, NULL); }"""
    made = compiler.compile_program(compiler.find(), callbacks)
    (tmp_path / "compact.so").write_bytes(made)
    function = ctypes.CDLL(str(tmp_path / "compact.so")).jacobians

    point = np.random.default_rng(2).uniform(0.2, 1.1, (2, 12))
    compact = np.full((2, 14), np.nan)
    function(*(ctypes.c_void_p(x.ctypes.data) for x in (*point, *compact)))
    whole = evaluate(dal.System.from_sympy(L, rows, q), "constraint", 0.0, *point)
    for key, values in zip(("phi_v", "phi_q"), compact):
        dense = np.zeros((4, 12))
        dense[row, column] = values
        np.testing.assert_array_equal(dense.ravel(), whole[key])


def test_which_constraints_are_sparse():
    L, rows, q = skates(4)
    full = sum((k + 2) * x.d for k, x in enumerate(q))

    def is_compact(L, rows, q, force=None):
        return codegen.is_compact(of(L, rows, q, None, force))

    assert is_compact(L, rows, q) and is_compact(L, rows, q, {q[0]: -q[0]})
    half = [*rows, full, full + q[0] * q[1].d]
    assert is_compact(L, half, q)  # 36 entries of 72
    assert not is_compact(L, [rows[0] + q[5].d, *half[1:]], q)
    assert not is_compact(L, (), q)
    assert is_compact(L, rows, q, {q[0]: -q[0].d})
    assert not is_compact(L + q[0].d * q[1].d / 9, rows, q)
    assert not is_compact(L + sympy.sin(q[0]) * q[0].d ** 2 / 9, rows, q)
    assert not is_compact(L, [rows[0] + 1, *rows[1:]], q)
    assert is_compact(*skates(3)) and not is_compact(*skates(2))


# ---- the compiled step ------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["particle", "sleigh", "generic4", "knife", "trailer3"])
@pytest.mark.parametrize("scheme", ["midpoint", "leapfrog", "explicit", "leapfrog-kl8"])
def test_one_text_two_compilations(name, scheme):
    """1000 steps of the compiled step routine have the bits of the library's run-time version."""
    system = MAKERS[name]()
    assert library(system._model, "steps").definition.compiled != core.ffi.NULL
    source = np.random.default_rng(7)
    q0 = source.uniform(-0.5, 0.5, system.n)
    v0 = system.project(q0, source.uniform(-1, 1, system.n))
    ends = []
    for any_sizes in (False, True):
        record = dal.Scheme.find(scheme)
        handle = record._stepped(system)._handle
        stepper = core.make("stepper", handle, c_record(record), core.ffi.NULL)
        if any_sizes:
            core.lib.dal__beta_any_sizes(stepper)
        x = np.concatenate([q0, v0])
        start = (0.0, 0.01, core.pointer(x), core.lib.DAL_CHECK, core.lib.DAL_INITIAL_NONE)
        assert core.lib.dal_stepper_start(stepper, *start) == 0
        reaction = np.zeros(system.m)
        done = core.lib.dal_advance(stepper, 1000, core.pointer(reaction), core.ffi.NULL)
        assert done == 0, core.string(core.lib.dal_stepper_error(stepper).text)
        state = core.doubles(core.lib.dal_stepper_state(stepper), 2 * system.n)
        ends.append(np.concatenate([state, reaction]))
    np.testing.assert_array_equal(*ends)
    assert np.abs(ends[0][: system.n] - q0).max() > 0.1


def test_factors_are_one_number():
    """What is rational in a term is the double next to it; that costs no division."""
    x, y = dal.coordinates("x y")
    third, tenths = sympy.Rational(1, 3), sympy.Rational(3, 10)
    L = (x.d**2 + y.d**2) / 2 - tenths * x**2 * y**2 / 2 - third * x * y - y / (7 * (3 + x**2))
    system = dal.System.from_sympy(L, [y.d - x.d / 7], [x, y])
    source = codegen.program(system._model, part="steps").source
    potential = source[source.index("model_potential") : source.index("model_call_potential")]
    assert "10.0" not in source and " / 2.0" not in source and " / 3.0" not in source
    assert "0.3 * " in potential and repr(1 / 3) in potential
    at = {"x": 0.7, "y": -1.3}
    exact = float(-L.subs({x.d: 0, y.d: 0, x: at["x"], y: at["y"]}))
    energy = system.energy(np.array([at["x"], at["y"]]), np.zeros(2))
    assert abs(energy - exact) <= 8 * U * (1 + abs(exact))


def test_many_coordinates():
    """Too many for a step routine of their own; the run-time version makes the steps."""
    q = dal.coordinates(" ".join(f"x{i}" for i in range(40)))
    rows = [a.d - b * c.d for a, b, c in zip(q, q[10:], q[20:30])]
    large = dal.System.from_sympy(sum(x.d**2 for x in q) / 2, rows, coordinates=list(q))
    assert library(large._model, "steps").definition.compiled == core.ffi.NULL
    q0 = np.linspace(-1, 1, 40)
    run = dal.integrate(large, "midpoint", q0, large.project(q0, np.cos(q0)), h=0.01, steps=100)
    assert run.success and run.residual.max() <= 4 * 40 * U


def c_record(record):
    found = core.ffi.new("dal_scheme *")
    error = core.ffi.new("dal_error *")
    assert core.lib.dal_scheme_find(found, record.name.encode(), error) == 0
    return found


# ---- what is accepted --------------------------------------------------------------------------


def test_four_ways_to_write_a_particle():
    """Coordinates with .d, dynamicsymbols, pairs of symbols, one-forms: the same compiled model."""
    x, y, z = dal.coordinates("x y z")
    m = sympy.Symbol("m", positive=True)
    systems = [
        dal.System.from_sympy(
            m * (x.d**2 + y.d**2 + z.d**2) / 2, [sympy.Eq(z.d, y * x.d)], parameters={m: 2}
        )
    ]
    X, Y, Z = dynamicsymbols("x y z")
    t = dynamicsymbols._t
    L = m * (X.diff(t) ** 2 + Y.diff(t) ** 2 + Z.diff(t) ** 2) / 2
    rows = [Z.diff(t) - Y * X.diff(t)]
    systems.append(dal.System.from_sympy(L, rows, parameters={"m": sympy.Integer(2)}))
    q, v = sympy.symbols("x y z"), sympy.symbols("u:3")
    L = m * sum(u**2 for u in v) / 2
    forms = sympy.Matrix([[-q[1], 0, 1]])
    for constraints in (forms, [[-q[1], 0, 1]], v[2] - q[1] * v[0]):
        systems.append(
            dal.System.from_sympy(L, constraints, dict(zip(q, v)), parameters={m: 2})
        )
    assert {s.coordinates for s in systems} == {("x", "y", "z")}
    assert len({s._model.key for s in systems}) == 1
    assert len({library(s._model).path for s in systems}) == 1
    assert systems[0].multipliers([0, 1, 0], [1, 1, 1]) == pytest.approx([1.0], abs=4 * U)


def test_order_of_coordinates():
    z, x = dal.coordinates("z x")
    assert dal.System.from_sympy(x.d**2 + z.d**2).coordinates == ("z", "x")
    x, z = dal.coordinates(["x", "z"])
    assert dal.System.from_sympy(x.d**2 + z.d**2).coordinates == ("x", "z")
    assert dal.System.from_sympy(x.d**2 + z.d**2, coordinates=[z, x]).coordinates == ("z", "x")
    again = dal.coordinates("x z")[0]
    assert x == again and x.d == again.d and hash(x.d) == hash(again.d)
    assert x.d != sympy.Symbol("x.d", real=True)
    for symbol in pickle.loads(pickle.dumps([x, x.d, x.d**2 + sympy.sin(x)])):
        assert symbol in (x, x.d, x.d**2 + sympy.sin(x))


@pytest.mark.parametrize("disturb", [
    lambda: [make() for make in map(functools.partial(getattr, dal.systems),
                                    dal.systems.names_in_sympy())],
    lambda: [dal.coordinates(names) for names in itertools.permutations("xyz")],
    lambda: dal.coordinates("tau x"),
    lambda: [dal.coordinates(name) for name in "zyx"],
], ids=["library", "permutations", "another", "single"])  # fmt: skip
def test_no_other_call_changes_an_order(disturb):
    """The multiplier (9.81 + v_x v_y)/2 of z' = y x' in a field 9.81 z is that of x, y, z."""
    disturb()
    x, y, z = dal.coordinates("x y z")
    kinetic = (x.d**2 + y.d**2 + z.d**2) / 2
    for again in (disturb, lambda: None):
        own = dal.System.from_sympy(kinetic - 9.81 * z, [z.d - y * x.d])
        assert own.coordinates == ("x", "y", "z")
        assert own.multipliers([0, 1, 0], [1, 1, 1]) == pytest.approx([(9.81 + 1) / 2], rel=1e-15)
        again()


def test_symbols_of_several_calls():
    """As the calls name them, then in the order of the calls; else they are asked for."""
    x, y, theta = dal.coordinates("x y theta")
    _, other = dal.coordinates("tau x")
    kinetic = (other.d**2 + y.d**2 + theta.d**2) / 2
    make = dal.System.from_sympy
    forms = [sympy.cos(theta) * y.d - sympy.sin(theta) * x.d]  # of another x
    own = make(kinetic, forms, force={x: theta})
    assert own.coordinates == ("x", "y", "theta")
    same = make(kinetic.subs(other.d, x.d), forms, force={x: theta})
    assert own._model.key == same._model.key
    assert make(kinetic - sympy.Derivative(x**2, other)).formulas[0].endswith("- 2 x")
    assert make(kinetic, forms, coordinates=[theta, y, x]).coordinates == ("theta", "y", "x")
    a, b = dal.coordinates("first1")[0], dal.coordinates("second1")[0]
    assert make(b.d**2 + a.d**2).coordinates == ("first1", "second1")
    dal.coordinates("first1")  # made again, the order of the two is no longer clear
    with pytest.raises(ValueError, match="coordinates is missing: .* order of first1, second1 is"):
        make(b.d**2 + a.d**2)
    swapped = dal.coordinates("theta y")[0]
    with pytest.raises(ValueError, match=r"'theta y'\) and .*\('x y theta'"):
        make((x.d**2 + y.d**2 + theta.d**2) / 2 - swapped)


def test_the_derivative_by_time_is_written_d():
    x, y = dal.coordinates("x y")
    t = dynamicsymbols._t
    for by in (t, "t", sympy.Symbol("t", real=True)):
        with pytest.raises(ValueError, match=r"x.diff\(t\): write x.d"):
            sympy.diff(x, by)
    for rate in (sympy.Derivative(x, t), sympy.Derivative(x * y, t, t)):
        with pytest.raises(ValueError, match=r"constraints\[0\]: .* write x.d for the velocity"):
            dal.System.from_sympy(x.d**2 + y.d**2, [y.d - rate])
    assert x.diff(x) == 1 and x.diff(y) == 0 and x.diff(sympy.Symbol("m")) == 0
    made = dal.System.from_sympy(x.d**2 + y.d**2 - sympy.Derivative(x**2, x))
    assert made.formulas[0] == "L = v_x^2 + v_y^2 - 2 x"
    u = sympy.Symbol("u")  # slopes by coordinates and velocities are no rates
    force = {x: sympy.Derivative(u * x, x) + sympy.Derivative(x.d**2, x.d)}
    made = dal.System.from_sympy((x.d**2 + y.d**2) / 2, force=force, inputs=[u])
    assert made.acceleration([0, 0], [3, 0], inputs=[4]).tolist() == [10, 0]


def test_keys_tell_models_apart():
    """Equal ones have equal keys, in whatever order their parts were given."""
    x, y = dal.coordinates("x y")
    m = sympy.Symbol("m")
    kinetic = (x.d**2 + y.d**2) / 2

    def key(L, constraints=()):
        return of(L, constraints, [x, y], {m: 1}).key

    different = [
        kinetic, kinetic - x, kinetic - y, kinetic - m * x, kinetic - x * y, kinetic - x**2,
        kinetic - sympy.sin(x), kinetic - sympy.cos(x), kinetic - 2 * x, kinetic - x / 2,
        kinetic - sympy.Float(0.5) * x, kinetic - sympy.sin(x + y), kinetic - sympy.sin(x) - y,
        kinetic - sympy.Piecewise((x, x > 0), (y, True)),
        kinetic - sympy.Piecewise((x, x >= 0), (y, True)),
    ]  # fmt: skip
    keys = [key(L) for L in different] + [key(kinetic, [y.d]), key(kinetic, [y.d - x.d])]
    assert len(set(keys)) == len(keys)
    assert key(y.d**2 / 2 - y * x + x.d**2 / 2) == key(kinetic - x * y)


def test_large_callbacks_are_called():
    """Small ones are inlined in the step routine; those of many operations are not, and are cut."""
    x, y = dal.coordinates("x y")
    for count, head in ((1, "DAL_KERNEL_INLINE int"), (150, "static int")):
        V = sum(sympy.sin(k * x) / k for k in range(1, count + 1))
        model = of((x.d**2 + y.d**2) / 2 - V, [y.d - x * x.d])
        source = codegen.program(model, part="steps").source
        assert f"{head}\nmodel_potential(" in source
        assert (count > 1) == (source.count("MODEL_CUT(part);") > 5)
        assert "DAL_KERNEL_INLINE int\nmodel_constraint(" in source


def test_constant_mass_is_found():
    """Where it takes sin^2 + cos^2 = 1 to see it; and not where it is not there."""
    x, y, theta = dal.coordinates("x y theta")
    m = sympy.Symbol("m")
    c, s = sympy.cos(theta), sympy.sin(theta)
    turned = ((c * x.d + s * y.d) ** 2 + (-s * x.d + c * y.d) ** 2 + theta.d**2) * m / 2
    system = dal.System.from_sympy(turned - x, coordinates=[x, y, theta], parameters={m: 3})
    np.testing.assert_array_equal(system.mass, 3 * np.eye(3))
    assert system.energy([2, 0, 0.3], [1, 0, 0]) == pytest.approx(3.5, abs=16 * U)
    for extra in (x * theta.d, c * x.d * y.d / 4, x.d**4 / 12):
        assert of(turned + extra, (), [x, y, theta], {m: 3}).derived.mass is None
    # a gyroscopic term that cancels
    zero = (s**2 + c**2 - 1) * x.d
    assert of(turned + zero, (), [x, y, theta], {m: 3}).derived.mass is not None


def test_forces_without_velocities():
    """A force enters as V_q does if it has no v in it; the derivative of dry friction is 0 too."""
    x, y, z = q = dal.coordinates("x y z")
    L, row = (x.d**2 + y.d**2 + z.d**2) / 2, z.d - y * x.d
    u = sympy.Symbol("u")
    driven = {x: u - x, y: sympy.sin(dal.time)}
    spring = dal.System.from_sympy(L, [row], q, force=driven, inputs=[u])
    friction = dal.System.from_sympy(L, [row], q, force={y: -sympy.sign(y.d) / 10})
    potential = dal.System.from_sympy(L - x**2 / 2, [row], q)
    assert spring._model.derived.is_positional and not spring._model.derived.has_momenta
    assert not friction._model.derived.is_positional and friction._model.derived.has_momenta
    slid = dal.integrate(friction, "leapfrog", [0, 1, 0], [1, 1, 1], h=0.01, steps=100)
    np.testing.assert_allclose(slid.v[:, 1], 1 - slid.t / 10, rtol=0, atol=512 * U)
    forced = dal.System.from_sympy(L, [row], q, force={x: -x})
    for scheme in ("leapfrog", "midpoint", "leapfrog-kl6"):
        runs = [
            dal.integrate(s, scheme, [0, 1, 0], [1, 1, 1], h=0.05, steps=100)
            for s in (forced, potential)
        ]
        np.testing.assert_array_equal(runs[0].x, runs[1].x)
        np.testing.assert_array_equal(runs[0].reactions, runs[1].reactions)


def test_a_quaternion_has_no_mass_along_itself():
    """The error names the cure; a top that is cured turns after Euler's equations."""
    p = dal.coordinates("p:4")
    rows = sympy.Matrix(
        [[-p[1], p[0], p[3], -p[2]], [-p[2], -p[3], p[0], p[1]], [-p[3], p[2], -p[1], p[0]]]
    )
    omega = 2 * rows * sympy.Matrix([x.d for x in p])
    inertia = sympy.diag(1, 2, 4)
    L, length = (omega.T * inertia * omega)[0] / 2, sum(x * x.d for x in p)
    q, turn = np.array([0.5, -0.1, 0.7, 0.5]), np.array([0.3, -1.1, 0.8])
    to_q = np.array(rows.subs(dict(zip(p, q))), dtype=float).T / 2
    with pytest.raises(dal.SingularError, match=r"add c \(mu v\).2/2 to L; for a quaternion p"):
        dal.System.from_sympy(L, [length]).acceleration(q, to_q @ turn)
    cured = dal.System.from_sympy(L + 3 * length**2 / 2, [length])
    found = 4 * to_q.T @ cured.acceleration(q, to_q @ turn)
    a, b, c = turn
    np.testing.assert_allclose(found, [-2 * b * c, 3 * a * c / 2, -a * b / 4], rtol=1e-13)


def test_powers_of_a_parameter_at_zero():
    """V_q of x^n at x = 0 is that of the limit, where n x^n / x, as SymPy has it, is no number."""
    x, y = dal.coordinates("x y")
    n = sympy.Symbol("n")
    L = (x.d**2 + y.d**2) / 2 - x**n - sympy.sin(y ** (n + 1)) + x**sympy.pi
    system = dal.System.from_sympy(L, (), None, {n: 2})
    for value, expected in ((0, (0, -1)), (1, (-1, 0)), (2, (0, 0)), (3, (0, 0))):
        there = system.with_parameters(n=value)
        np.testing.assert_array_equal(there.acceleration([0, 0], [0, 0]), expected)
    with pytest.raises(dal.DomainError):  # infinite
        system.with_parameters(n=0.5).acceleration([0, 0], [0, 0])
    V_qq = dal.System.from_sympy(x.d**2 / 2 - x**n, parameters={n: 2})._model.callables("potential")
    for value, expected in ((0, 0), (2, 2), (3, 0)):
        assert V_qq["V_qq"]([0.0], [0.0], [value]) == [expected]


def test_parameters_stay_free():
    """with_parameters compiles nothing, shares the code, and is the system of these values."""
    x, theta = dal.coordinates("x theta")
    m, k, g = sympy.symbols("m k g")
    L = m * x.d**2 / 2 + theta.d**2 / 2 - k * x**2 / 2 - g * sympy.cos(theta)
    system = dal.System.from_sympy(
        L,
        [x.d - k * theta.d],
        parameters={m: 1, k: 2, g: 0},
        q0=[k, 0],
        v0=[k**2, k],
        invariants={"p": m * x.d},
        exact=lambda t, q0, v0, m, k, g: (q0 + t * v0, v0 * m * k),
    )
    other = system.with_parameters(m=3, k=5)
    assert library(other._model) is library(system._model)
    assert other.parameters == {"m": 3, "k": 5, "g": 0}
    np.testing.assert_array_equal(other.mass, np.diag([3.0, 1.0]))
    np.testing.assert_array_equal(other.q0, [5, 0])
    np.testing.assert_array_equal(other.v0, [25, 5])
    np.testing.assert_array_equal(system.q0, [2, 0])
    assert other.invariant(other.q0, other.v0) == {"p": 75.0}
    assert other.exact(1.0)[1] == pytest.approx([25 * 15, 5 * 15])
    assert other.residual(other.q0, other.v0) == 0
    again = pickle.loads(pickle.dumps(dal.System.from_sympy(L, (), None, {m: 1, k: 2, g: 0})))
    assert again.with_parameters(g=2).energy([0, 0], [0, 0]) == 2
    with pytest.raises(ValueError, match="has no 'l'; it has m, k, g"):
        system.with_parameters(l=1)
    with pytest.raises(ValueError, match="mass is not positive definite"):
        system.with_parameters(m=-1)
    with pytest.raises(ValueError, match="m = nan: expected a finite number"):
        system.with_parameters(m=float("nan"))
    with pytest.raises(ValueError, match="'m' is given, but the system"):
        dal.System(mass=[1]).with_parameters(m=1)


def test_values_are_what_their_symbols_assume():
    """sqrt(m^2) is m because m is positive: so it has to be, here and in with_parameters."""
    x = dal.coordinates("x")[0]
    words = {
        "positive": (2, -1, "-1: expected a positive number"),
        "negative": (-2, 0, "0: expected a negative number"),
        "nonnegative": (0, -0.5, "-0.5: expected a number >= 0"),
        "nonpositive": (0, 0.5, "0.5: expected a number <= 0"),
        "nonzero": (1, 0, "0: expected a number other than 0"),
        "integer": (3, 2.5, "2.5: expected a whole number"),
    }
    for word, (good, bad, text) in words.items():
        k = sympy.Symbol("k", real=True, **{word: True})
        for key in (k, "k") if word == "positive" else (k,):  # what stands in L counts, too
            make = functools.partial(dal.System.from_sympy, x.d**2 / 2 - k**2 * x, name="fall")
            system = make(parameters={key: good})
            for again in (system, pickle.loads(pickle.dumps(system))):
                with pytest.raises(ValueError, match=f"k = {text}"):
                    again.with_parameters(k=bad)
                assert again.with_parameters(k=2 * good).parameters == {"k": 2.0 * good}
            with pytest.raises(ValueError, match=f"k = {text}"):
                make(parameters={key: bad})
    free = dal.System.from_sympy(x.d**2 / 2 - sympy.Symbol("k") * x, parameters={"k": 1})
    assert free.with_parameters(k=-1).parameters == {"k": -1.0}


def test_what_it_says_about_itself_stays():
    x = dal.coordinates("x")[0]
    k = sympy.Symbol("k")
    about = {"name": "fall", "help": "a line", "description": "two lines", "source": "a book"}
    system = dal.System.from_sympy(x.d**2 / 2 - k * x, parameters={k: 1}, **about)
    for again in (system, pickle.loads(pickle.dumps(system)), system.with_parameters(k=2)):
        assert {key: getattr(again, key) for key in about} == about
        assert again.formulas == ("L = v_x^2/2 - k x",)


def test_exact_and_invariants_by_expressions():
    """A falling point: exact solution and angular momentum, compiled; the study uses them."""
    x, y = dal.coordinates("x y")
    g = sympy.Symbol("g")
    t = sympy.Symbol("t")
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2 - g * y,
        parameters={g: 3},
        exact=[x + t * x.d, y + t * y.d - g * t**2 / 2, x.d, y.d - g * t],
        invariants={"v_x": x.d, "parabola": y.d**2 / 2 + g * y},
        q0=[1, 2],
        v0=[1, 1],
    )
    q, v = system.exact(2.0)
    np.testing.assert_allclose([*q, *v], [3, -2, 1, -5], rtol=4 * U)
    assert system.invariant(q, v) == {"v_x": 1.0, "parabola": 6.5}
    assert system.invariants == ("v_x", "parabola") and system.has_exact
    mixed = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2,
        parameters={g: 3},
        coordinates=[x, y],
        invariants={"p": x.d * g, "r": lambda q, v, g: v[1] * g, "s": y.d},
    )
    assert mixed.invariant([0, 0], [1, 2]) == {"p": 3.0, "r": 6.0, "s": 2.0}


def test_a_force_by_names_of_coordinates():
    x, y = dal.coordinates("x y")
    L = (x.d**2 + y.d**2) / 2
    by_name = dal.System.from_sympy(L, force={"y": -x, x: y})
    assert by_name.formulas == dal.System.from_sympy(L, force={y: -x, x: y}).formulas


def test_the_check_names_terms_without_a_velocity():
    x, y, z = dal.coordinates("x y z")
    L = (x.d**2 + y.d**2 + z.d**2) / 2
    slip = dal.System.from_sympy(L, [x.d - y.d, z.d - y * x + 2])  # y x.d was meant
    found = slip.check([0, 0, 0], [1, 1, -2])
    assert found.still == ("-x y + 2, in constraints[1]",)
    assert "without a velocity   -x y + 2, in constraints[1]" in str(found)
    assert dal.System.from_sympy(L, [z.d - y * x.d]).check([0, 0, 0], [1, 0, 0]).still == ()


def test_refused_by_name():
    x, y, z = dal.coordinates("x y z")
    m, t = sympy.symbols("m t")
    f, u = sympy.Function("f"), sympy.Function("u")(t)
    X = dynamicsymbols("X")
    positive = sympy.Symbol("m", positive=True)
    L = (x.d**2 + y.d**2) / 2
    from_sympy = dal.System.from_sympy
    cases = [
        (lambda: from_sympy(m * L), "L: m is neither a coordinate .x, y. nor a parameter"),
        (lambda: from_sympy(L * t), "unknown symbol t; for the time, write"),
        (lambda: from_sympy(L, [x - y]), r"constraints\[0\] = x - y: expected an expression"),
        (lambda: from_sympy(L, [x.d, y.d, x.d]), "3 on 2 coordinates"),
        (lambda: from_sympy(L, [x.d - f(x)]), r"unknown function"),
        (lambda: from_sympy(L - sympy.gamma(x)), "gamma.* cannot be compiled"),
        (lambda: from_sympy(L + sympy.I * x), "cannot be compiled"),
        (lambda: from_sympy(L + sympy.Float("1e400") * x), "too large for a double"),
        (lambda: from_sympy("x**2"), "expected a SymPy expression, not a text"),
        (lambda: from_sympy(sympy.Integer(1)), "coordinates is missing"),
        (lambda: from_sympy(L, coordinates=["x"]), "coordinates: 'x'"),
        (lambda: from_sympy(L, coordinates=[x, x, y]), "expected different names"),
        (lambda: from_sympy(L, [sympy.true]), "expected an equation that depends on"),
        (lambda: from_sympy(L, [[1, 2, 3]]), "expected 2 coefficients, got 3"),
        (lambda: from_sympy(L, [[1, x * y.d]]), r"coefficient 1, x\*y.d, contains a velocity"),
        (lambda: from_sympy(L, force={x: m}), r"force\[x\]: m is neither .*, nor in inputs="),
        (lambda: from_sympy(L, force={"m": 1}), "force: m is not a coordinate"),
        (lambda: from_sympy(L, parameters={m: "heavy"}), "m = 'heavy'"),
        (lambda: from_sympy(L, parameters={m: 10**400}), "m = 10{50}.*: expected a finite number"),
        (lambda: from_sympy(L, parameters={m: sympy.Integer(10) ** 400}), "m = inf"),
        (lambda: from_sympy(L, parameters={m: sympy.I}), "m = I: expected a real number"),
        (lambda: from_sympy(L, parameters=b"x"), "parameters = b'x': expected a mapping"),
        (lambda: from_sympy(L, force=b"x"), "force = b'x': expected a mapping"),
        (lambda: from_sympy(L, invariants=[x.d]), "invariants = .x.d.: expected a mapping"),
        (lambda: from_sympy(L, coordinates=5), "coordinates = 5: expected a sequence"),
        (lambda: from_sympy(L, constraints=5), "constraints = 5: expected a sequence"),
        (lambda: from_sympy(L, constraints="x"), "constraints = 'x': expected a sequence"),
        (lambda: from_sympy(L, exact=5), "exact = 5: expected a sequence"),
        (lambda: from_sympy(L, q0=5, v0=[0, 0]), "q0 = 5: expected a list of numbers"),
        (lambda: from_sympy(L, q0=[0, 0], v0=5), "v0 = 5: expected a list of numbers"),
        (lambda: dal.coordinates(b"x y"), "names = b'x y': expected a sequence"),
        (lambda: dal.coordinates(5), "names = 5: expected a sequence"),
        (lambda: from_sympy(L, [y.d - t * x.d]), "constraints.0.: unknown symbol t"),
        (lambda: from_sympy(L, force={x: u}), r"force\[x\]: u\(t\) is an unknown function"),
        (lambda: from_sympy(L, force={x: u.diff(t)}), r"force\[x\]: Derivative\(u\(t\), t\) is no"),
        (lambda: from_sympy(L, force={x: u + u.diff(t)}, inputs=[u]), "is the rate of the input u"),
        (lambda: from_sympy(L, force={x: sympy.Derivative(x.d, t)}), "x.d, t. is an acceleration"),
        (lambda: from_sympy(L, force={x: dal.time}, inputs=[dal.time]), "the time is known"),
        (lambda: from_sympy(L - x * sympy.cosh(1000)), r"L: 9.8504E\+433 is too large"),
        (lambda: from_sympy(L - x / sympy.cosh(1000)), "L: 1.0152E-434 is too small"),
        (lambda: from_sympy(L - x * sympy.asin(2)), r"L: asin\(2\) is not a real number"),
        (lambda: from_sympy(L - sympy.Symbol("q0", real=True)), "L: q0 is neither a coordinate"),
        (lambda: from_sympy(L, [y.d - u * x.d]), r"constraints\[0\]: u\(t\) is an unknown"),
        (lambda: from_sympy(L, force={x: m}), r"force\[x\]: m is neither a coordinate"),
        (lambda: from_sympy(L - z), r"L contains z\.d not at all or only linearly, so z has no m"),
        (lambda: from_sympy(L, coordinates=[x, y, z]), r"L contains z\.d not at all"),
        (lambda: from_sympy(L + x * z.d), r"L contains z\.d not at all or only linearly"),
        (lambda: from_sympy(L - X), r"L contains X\.d not at all"),
        (lambda: from_sympy(L - sympy.Mod(x, 2)), r"L: Mod\(x, 2\) \(Mod\) cannot be compiled"),
        (lambda: from_sympy(L, parameters={"m": 1, m: 2}), "m occurs twice"),
        (lambda: from_sympy(L, force={m: 1}), "force: m is not a coordinate"),
        (lambda: from_sympy(L, force={3: x}), "force: 3: expected a coordinate"),
        (lambda: from_sympy(L, invariants={"p": None}), r"invariants\['p'\] = None: expected a"),
        (lambda: from_sympy(L, q0=[0, 0]), "q0 is given without v0: expected both"),
        (lambda: from_sympy(L, q0=[0], v0=[0]), "q0 has 1 number: expected 2, one for each of x"),
        (lambda: from_sympy(L, q0=[0, 0], v0=[m] * 3), "v0 has 3 numbers: expected 2, one for"),
        (lambda: from_sympy(L, q0=[[0, 0]], v0=[0, 0]), r"q0 has shape \(1, 2\): expected \(2,\)"),
        (lambda: from_sympy(L, q0="00", v0=[0, 0]), "q0 = '00': expected a list of numbers, one"),
        (lambda: from_sympy(L, q0={x: 0, y: 0}, v0=[0, 0]), "q0 = {.*}: expected a list of numb"),
        (lambda: from_sympy(L, q0=[0, "0"], v0=[0, 0]), r"q0\[1\] = '0': expected a finite number"),
        (lambda: from_sympy(L, q0=[x, 0], v0=[0, 0]), "expected numbers, or expressions of param"),
        (lambda: from_sympy(X.diff("t") ** 2 + X.diff("t", 2)), "not the velocity of a coordinate"),
        (lambda: from_sympy(L, exact=[x]), "exact: expected 4 expressions, got 1"),
        (lambda: from_sympy(L + float("nan")), "L contains nan: expected finite numbers"),
        (lambda: from_sympy(L - sympy.oo * x), "L contains -oo: expected finite numbers"),
        (lambda: from_sympy(L, [[1, sympy.zoo]]), "constraints.0. contains zoo: expected finite"),
        (lambda: from_sympy(m**2, (), [(m, m)]), "coordinates: m stands for two of the coord"),
        (lambda: from_sympy(m**2, (), [(m, t), (t, m)]), "coordinates: m stands for two"),
        (lambda: from_sympy(m**2, (), [(t, m)], {"m": 1}), "parameters: m is .* a velocity; exp"),
        (lambda: from_sympy(m**2, (), [(t, m)], inputs=[m]), "inputs: m is also the name of"),
        (
            lambda: from_sympy(L - m * x - positive * y, (), None, {m: 1}),
            "L: m is the name of two symbols, one of them positive",
        ),
        (
            lambda: from_sympy(L - m * x, (), None, {m: 1}, force={x: positive}),
            r"force\[x\]: m is the name of two symbols, one of them positive",
        ),
        (lambda: from_sympy(L + X, (), [x, y]), r"L: X\(t\) is an unknown .*\.subs\(X\(t\), "),
        (lambda: from_sympy(L + f(x)), r"L: f\(x\) is an unknown function; write its formula"),
        (lambda: from_sympy(L, name="a\0b"), "name"),
        (lambda: from_sympy(L, source=3), "source = 3: expected a string"),
        (lambda: dal.coordinates("x x"), "all different"),
        (lambda: dal.coordinates(""), "at least one"),
        (lambda: dal.coordinates("x,,y"), "names = 'x,,y': missing symbol"),
        (lambda: dal.systems.particle().c_source(), "was not made by from_sympy"),
        (lambda: from_sympy(L).c_source("a b"), "expected a C identifier"),
    ]
    refused(cases)


WITHOUT = """
import sys
sys.modules["sympy"] = None
import dalembert as dal
for call in (lambda: dal.coordinates("x"), lambda: dal.System.from_sympy(0)):
    try:
        call()
    except ImportError as error:
        print(error)
"""


def test_without_sympy():
    done = subprocess.run([sys.executable, "-c", WITHOUT], stdout=subprocess.PIPE, text=True)
    assert done.stdout == 2 * "a system from expressions needs sympy: pip install sympy\n"


@pytest.mark.parametrize(
    "scheme, exponent",
    [("leapfrog", "4/3"), ("leapfrog", "3/2"), ("midpoint", "3/2"), ("reference", "3/2")],
)
def test_a_wall_whose_stiffness_is_infinite_at_its_edge(scheme, exponent):
    """Outside of it nothing acts; V_qq, 0 times infinity there, is for Newton's method alone."""
    x, y, z = dal.coordinates("x y z")
    kinetic, form = (x.d**2 + y.d**2 + z.d**2) / 2, z.d - y * x.d
    power, edge = sympy.Rational(exponent), sympy.Rational(1, 2)
    inside = sympy.Piecewise(((x - edge) ** power, x > edge), (0, True))
    runs = [
        dal.integrate(dal.System.from_sympy(L, form, force=force), scheme,
                      [0, 1, 0], [1, 1, 1], h=0.01, steps=100)
        for L, force in [
            (kinetic - 50 * sympy.Max(0, x - edge) ** power, None),
            (kinetic - 50 * (sympy.Max(0, x - edge) + sympy.Max(0, -x - edge)) ** power, None),
            (kinetic - 50 * inside, None),
            (kinetic, {x: -50 * power * sympy.Max(0, x - edge) ** (power - 1)}),
        ]
    ]  # fmt: skip
    k = sympy.Symbol("k")
    system = dal.System.from_sympy(
        kinetic - 50 * sympy.Max(0, x - edge) ** k, form, parameters={k: float(power)}
    )
    runs.append(dal.integrate(system, scheme, [0, 1, 0], [1, 1, 1], h=0.01, steps=100))
    assert runs[0].q[-1, 0] < 0.8  # it has come back
    for run in runs[1:]:
        assert run.q == pytest.approx(runs[0].q, rel=1e-9, abs=1e-9)


def test_the_slopes_of_a_power_of_a_wall():
    """f = y max(0, x)^k with k = 3/2: inside, at the edge, and outside, where all slopes are 0."""
    x, y = dal.coordinates("x y")
    k = sympy.Symbol("k")
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2, force={x: y * sympy.Max(0, x) ** k}, parameters={k: 1.5}
    )
    for at, slopes in ((4, [6, 8]), (0, [0, 0]), (-1, [0, 0])):
        got = evaluate(system, "force", 0.0, np.array([at, 2.0]), np.zeros(2))
        assert got["f_q"][:2].tolist() == slopes


def test_a_barrier_still_refuses():
    x = dal.coordinates("x")[0]
    barrier = dal.System.from_sympy(x.d**2 / 2 - 1 / sympy.Max(0, x))
    with pytest.raises(dal.DomainError):
        dal.integrate(barrier, "leapfrog", [-1], [1], h=0.01, steps=1)


def test_what_has_no_jump_after_all():
    """A factor that vanishes where the argument does; but sign(x^3) jumps, where 3 x^2 vanishes."""
    x, y = dal.coordinates("x y")
    sign, half = sympy.sign, sympy.Rational(1, 2)
    q = [0.3, -0.7]
    for V in (
        y**4 * sign(y * sympy.Abs(y)), x * sign(x**3), x * y * sign(x**3 * y),
        x**2 * sign(sympy.tanh(x) * sympy.exp(y)), x * (x - half) * sign(x * (x - half)),
        x**2 * sympy.Heaviside(-(x**3)), x * x.d * sympy.Abs(x.d) * sign(sympy.sinh(x)),
    ):  # fmt: skip
        L = (x.d**2 + y.d**2) / 2 - V
        made = of(L)
        name, output = ("lagrangian", "L_q") if V.has(x.d) else ("potential", "V_q")
        found = made.callables(name)[output](q, [0.2, 0.5], [])
        value = sympy.lambdify([(x, y), (x.d, y.d)], L if V.has(x.d) else V, "mpmath")
        for i in range(2):
            exact = mpmath.diff(
                lambda s, i=i: value([s if j == i else q[j] for j in range(2)], [0.2, 0.5]), q[i]
            )
            assert found[i] == pytest.approx(float(exact), rel=1e-12, abs=1e-12), V
    for V in (
        sign(x**3), y * sign(x**3), x * sign(sympy.tanh(y)), sign(y * sympy.Abs(y)),
        x**2 * sign(x * y), x * sign(x * (x - 1)), sign(sympy.sinh(x) ** 3), sign(x**5 - x**3),
        sign(sympy.Piecewise((x, x > y), (1, True))) * y,
    ):  # fmt: skip
        with pytest.raises(ValueError, match="L: its derivative by [xy] needs DiracDelta"):
            dal.System.from_sympy((x.d**2 + y.d**2) / 2 - V)


@pytest.mark.parametrize("name", ["q0", "v0", "q1", "u0", "w0"])
@pytest.mark.parametrize("assumed", [{}, {"real": True}, {"positive": True}])
def test_parameters_called_as_our_symbols(name, assumed):
    """The rest length of a spring, of stiffness 1, is 2."""
    x, y = dal.coordinates("x y")
    rest = sympy.Symbol(name, **assumed)
    L = (x.d**2 + y.d**2 - (x - rest) ** 2) / 2
    system = dal.System.from_sympy(L, parameters={rest: 2}, force={y: -(x.d - rest)})
    assert system.acceleration([5, 0], [7, 0]).tolist() == [-3, -5]


def test_pieces_end_where_they_are_constant():
    """Beyond the last condition the model is not defined, although its derivatives are 0."""
    x, y = dal.coordinates("x y")
    L = (x.d**2 + y.d**2) / 2 - x * y - sympy.Piecewise((1, x < y))
    system = dal.System.from_sympy(L, force={})
    assert system.acceleration([-5, 0], [0, 0]).tolist() == [0, 5] and not system.is_forced
    with pytest.raises(dal.DomainError, match="gradient"):
        system.acceleration([5, 0], [0, 0])


@pytest.mark.parametrize("make", [
    lambda x, y: (-sympy.atan2(1 + y, sympy.acosh(x)), []),
    lambda x, y: (x.d**2 * sympy.Max(4, 1 / y, sympy.log(x)), []),
    lambda x, y: (0, [y.d - sympy.Piecewise((x.d, 1 / x.d > 3), (2 * x.d, True))]),
    lambda x, y: (-((1 + x**2) ** sympy.Piecewise((y, y >= 1))), []),
])  # fmt: skip
def test_models_that_are_not_defined_where_proofs_look(make):
    """At 0, at rest, and where a condition holds: SymPy has no values there."""
    x, y = dal.coordinates("x y")
    more, rows = make(x, y)
    system = dal.System.from_sympy((x.d**2 + y.d**2) / 2 + more, rows)
    assert np.isfinite(system.acceleration([2, 1.5], system.project([2, 1.5], [0.3, 0.2]))).all()


def test_names_that_are_taken_for_others():
    x, y = dal.coordinates("x y")
    L = (x.d**2 + y.d**2) / 2
    assert dal.coordinates("q1:4, z") == dal.coordinates(["q1", "q2", "q3", "z"])
    for other in (sympy.Symbol("x"), sympy.Symbol("x.d")):
        with pytest.raises(ValueError, match=f"L: this {other} differs from the symbol of the"):
            dal.System.from_sympy(L - other)
    for key in (x, "x", sympy.Symbol("x")):
        with pytest.raises(ValueError, match="parameters: x is a coordinate"):
            dal.System.from_sympy(L, parameters={key: 1})
    nothing = (sympy.sin(x) ** 2 + sympy.cos(x) ** 2 - 1) * x.d
    with pytest.raises(ValueError, match=r"constraints\[0\] = .*: it is 0 for all velocities"):
        dal.System.from_sympy(L, [nothing])


@pytest.mark.parametrize("formulas", [
    ("L = (v_x^2 + v_y^2 + v_z^2)/2",),
    ("v_z - y v_x = 0",),
    ("L = (v_x^2 + v_y^2 + v_z^2)/2", "v_z - exp(exp(exp(exp(exp(10))))) v_x = 0"),
], ids=["L", "constraint", "too large"])  # fmt: skip
def test_formulas_that_say_a_part(formulas):
    """Then the growth vector is that of the functions."""
    system = dal.System(
        mass=[1, 1, 1], mu=lambda q: [[-q[1], 0, 1]], coordinates=["x", "y", "z"],
        formulas=formulas,
    )  # fmt: skip
    assert system.check([0.3, 0.4, 0.5], [1, 1, 0.4]).growth == (2, 3)


def test_latex():
    system = rich()
    text = system._repr_latex_()
    assert text.startswith("$") and text.count(r"\begin{aligned}") == 1
    for part in (r"L &=", r"\mu &=", r"L_{vv} \ddot q", r"\lambda &=", r"\dot{x}"):
        assert part in text
    assert dal.systems.particle()._repr_latex_() is None
    evil = sympy.Function(r"\href{javascript:alert(1)}{x}")(sympy.Symbol("t"))
    text = dal.System.from_sympy(evil.diff("t") ** 2)._repr_latex_()
    assert "href{" not in text and ":" not in text


def test_pickle_and_threads():
    """Systems go to other processes as models; many threads make and run the same ones."""
    system = rich()
    again = pickle.loads(pickle.dumps(system))
    q, v = [0.3, 0.4, 0.5], [1.0, 2.0, 3.0]
    assert again.energy(q, v) == system.energy(q, v)
    expected = dal.integrate(system, "midpoint", q, system.project(q, v), h=0.01, steps=50).y

    def work(k):
        own = rich() if k % 4 == 1 else pickle.loads(pickle.dumps(system))
        return dal.integrate(own, "midpoint", q, own.project(q, v), h=0.01, steps=50).y

    with ThreadPoolExecutor(4) as pool:
        for y in pool.map(work, range(8)):
            np.testing.assert_array_equal(y, expected)


def test_reserved_names_of_c():
    for name, expected in (("a-b", "a_b"), ("2d", "model_2d"), ("größe", "gr__e")):
        assert constructor.c_identifier(None, name) == expected
    assert re.fullmatch(r"\w+", constructor.c_identifier("own", "x"))


# ---- the compiled ODE on D ---------------------------------------------------------------------

_X, _Y, _Z, _W = dal.coordinates("x y z w")
_SQUARES = (_X.d**2 + _Y.d**2 + _Z.d**2) / 2
FIELDS = {
    "free": (_SQUARES + _X.d * _Y.d / 2, []),
    "affine": (_SQUARES, [_Z.d - _Y * _X.d - sympy.sin(dal.time)]),
    "mass of t": (
        _SQUARES + _Z.d**2 * (1 + sympy.sin(dal.time)) + dal.time * _X.d * _Y - _Z,
        [_X.d**2 + _Y.d**2 - _Z.d**2 - 1],
    ),
    "mass of q": (
        _SQUARES + _Y.d**2 * _X**2 + _X.d * _Z.d * sympy.sin(_Y) / 2 - _X * _Y * _Z,
        [_Z.d - _Y * _X.d - sympy.sin(dal.time * _X)],
        {_X: -_X.d * _Y, _Y: sympy.sin(dal.time)},
    ),
    "three": (
        _SQUARES + _W.d**2 / 2 + _X.d * _Y.d / 2 - _X**2 * _W,
        [_X.d - _Y * _Z.d, _W.d - sympy.sin(_X) * _Z.d + _Y.d, _Y.d + _X * _W.d],
    ),
    "two blades": (
        _SQUARES + _Z.d**2 + 2 * _W.d**2 - _X**2 * _Y,
        [sympy.sin(_W) * _X.d - sympy.cos(_W) * _Y.d - _W.d / 2, _Z.d - 2 * _X.d + 1],
    ),
    "constant on an axis": (_SQUARES, [_X.d + _Y * (_Y.d + _Z.d)]),
    "roll of t": (
        _SQUARES, [sympy.sin(dal.time) * _X.d - sympy.cos(dal.time) * _Y.d, _Z.d - _Y * _X.d],
    ),
}  # fmt: skip


def solved(model, t, q, v, p):
    """The acceleration, from the formulas of L, of the constraints and of the force, by NumPy."""
    time = sympy.Symbol("t", real=True)
    at = dict(zip((*model.q, *model.v, *model.p), (*q, *v, *p))) | {time: t}

    def number(expressions, *shape):
        return np.array([float(e.subs(at)) for e in expressions]).reshape(shape)

    n, m, L = model.n, model.m, sympy.Matrix([model.L])
    L_v = L.jacobian(model.v).T
    pull = L.jacobian(model.q).T - L_v.jacobian(model.q) * sympy.Matrix(model.v) - L_v.diff(time)
    F = number(pull + sympy.Matrix(model.force or [0] * n), n)
    phi = sympy.Matrix(m, 1, model.constraints)
    mu = number(phi.jacobian(model.v), m, n) if m else np.zeros((0, n))
    turn = phi.jacobian(model.q) * sympy.Matrix(model.v) + phi.diff(time) if m else []
    M = number(L_v.jacobian(model.v), n, n)
    whole = np.block([[M, -mu.T], [mu, np.zeros((m, m))]])
    return np.linalg.solve(whole, np.r_[F, -number(turn, m)])[:n]


@pytest.mark.parametrize("name", [*dal.systems.names_in_sympy(), *FIELDS])
def test_compiled_field(name):
    """What is compiled for a model is its ODE on D, off D too."""
    if name in FIELDS:
        L, constraints, *force = FIELDS[name]
        system = dal.System.from_sympy(L, constraints, force=force[0] if force else None)
    else:
        system = dal.systems.get(name)
    assert "NULL, model_field};" in codegen.program(system._model, part="steps").source
    system = dal.Scheme.find("reference")._stepped(system)
    random = np.random.default_rng(3)
    for t in (0.0, 0.7):
        q, v = 0.4 * random.normal(size=(2, system.n)) + 0.3
        expected = solved(system._model, t, q, v, system.parameters.values())
        found = system.field(q, v, t=t)
        np.testing.assert_array_equal(found[: system.n], v)
        np.testing.assert_allclose(found[system.n :], expected, rtol=1e-12, atol=1e-12)


def test_constant_gram():
    """C = mu M^-1 mu^T is given where it is the same everywhere, and nowhere else."""
    blade = sympy.sin(_Z) * _X.d - sympy.cos(_Z) * _Y.d
    lasting = [
        (_SQUARES + _X.d**2 / 2, [blade], None),
        (_SQUARES, [blade, sympy.cos(_Z) * _X.d + sympy.sin(_Z) * _Y.d - 3 * _Z.d], [1, 0, 0, 10]),
        (_SQUARES, [blade - _Z.d / 2 - sympy.sin(dal.time)], [1.25]),
        (_SQUARES, [_X.d - 2 * _Y.d], [5]),
        (_SQUARES + _X.d * _Y.d / 2, [blade], None),
        (_SQUARES, [_Z.d - _Y * _X.d], None),
        (_SQUARES, [_Z.d - _Y * (_X.d + _Y.d)], None),
        (_SQUARES, [_X.d**2 + _Y.d**2 - _Z.d**2], None),
        (_SQUARES, [_X.d / _X + _Y.d], None),
        (_SQUARES, [_X.d * sympy.Abs(_Y) / _Y + _Z.d], [2]),
        (_SQUARES * (1 + _X**2), [blade], None),
        (_SQUARES, [_X.d * sympy.sin(dal.time) + _Y.d], None),
    ]
    for L, rows, expected in lasting:
        terms = of(L, rows).derived.terms.outputs
        assert ([float(e.value) for e in terms["C"]] if "C" in terms else None) == expected, rows


def test_compiled_field_is_looked_into():
    """What it cannot say is said as the library says it."""
    light = dal.System.from_sympy((_X.d**2 + _X * _Y.d**2 + _Z.d**2) / 2, [_Z.d - _Y * _X.d])
    with pytest.raises(dal.SingularError, match=r"\[1,1\] = -1: L_vv is not positive"):
        light.field([-1, 2, 0], [1, 1, 2])
    row = _Z.d - _Y * _X.d
    twice = dal.System.from_sympy(_SQUARES, [row, row + sympy.Rational(1, 10**9) * _Y.d])
    with pytest.raises(dal.SingularError, match=r"\[1\] equals constraints\[0\] up to 7e-10"):
        twice.field([0, 1, 0], [1, 0, 1])
    wall = dal.System.from_sympy(_SQUARES - sympy.log(_X), [row])
    with pytest.raises(dal.DomainError, match="gradient|potential"):
        wall.field([0, 1, 0], [1, 0, 1])


# ---- positions ---------------------------------------------------------------------------------


def pendulum(**more):
    """A bob on a rod of length 1, by the derivative of its position constraint."""
    x, y = dal.coordinates("x y")
    given = {"positions": [x**2 + y**2 - 1], **more}
    return dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2 - 9.81 * y, [x * x.d + y * y.d], name="pendulum", **given
    )


def test_initial_data_off_a_position_constraint_are_named():
    system = pendulum()
    angle = 0.3
    on, off = (r * np.array([np.sin(angle), -np.cos(angle)]) for r in (1, 1.007))  # by 7 mm
    v0, how = [0.0, 0.0], {"h": 0.001, "t_end": 0.1}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = dal.integrate(system, q0=on, v0=v0, **how)
        dal.integrate(system, q0=off, v0=v0, consistent="assume", **how)
        dal.integrate(system, q0=on * (1 + 1e-8), v0=v0, **how)
        dal.integrate(pendulum(positions=()), q0=off, v0=v0, **how)  # nothing says that it is 1
    assert abs(np.hypot(*run.q.T) - 1).max() < 1e-6
    words = r"a position constraint.*positions\[0\] = x\*\*2 \+ y\*\*2 - 1 is 0.014 at t = 0"
    for make in (dal.integrate, dal.Stepper, dal.convergence):
        given = {"integrate": how, "Stepper": {"h": 0.1}}.get(make.__name__, {"t_end": 0.1})
        with pytest.warns(dal.DalembertWarning, match=words):
            make(system, q0=off, v0=v0, **given)
    with pytest.warns(dal.DalembertWarning, match="1 of 2 members are doubtful"):
        many = dal.ensemble(system, q0=[on, off], v0=v0, progress=False, **how)
    assert many["doubtful"].tolist() == [False, True]
    check = system.check(off, v0)
    assert not check and "positions[0] = x**2 + y**2 - 1 is 0.014" in check.text
    assert system.check(on, v0) and system.positions == ("x**2 + y**2 - 1",)
    assert system.off_positions(on) == "" and "relative error 3" in system.off_positions(off)


def test_a_run_that_drifts_off_a_position_constraint_says_so():
    with pytest.warns(dal.DalembertWarning, match=r"drifted off a position constraint: positions"):
        run = dal.integrate(pendulum(), "explicit", [0, -1], [1, 0], h=0.01, t_end=1)
    assert abs(np.hypot(*run.q[-1]) - 1) > 1e-4


@pytest.mark.parametrize(
    ("positions", "words"),
    [
        (lambda x, y: [x - y], r"positions\[0\] = x - y: its time derivative is not a combination"),
        (lambda x, y: [x**2 + y**2 - dal.time], r"its time derivative is not a combination"),
        (lambda x, y: [x.d - y], r"positions\[0\] = .*: expected an expression of the coordinates"),
        (lambda x, y: [x * 0 + 1], r"positions\[0\] = 1: expected an expression with a coordinate"),
        (lambda x, y: [[1, 0]], r"positions\[0\]: expected an expression that vanishes"),
        (lambda x, y: "x", r"positions = 'x': expected a sequence"),
    ],
)
def test_refused_positions(positions, words):
    with pytest.raises(ValueError, match=words):
        pendulum(positions=positions(*dal.coordinates("x y")))
