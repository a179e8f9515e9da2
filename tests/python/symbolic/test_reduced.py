"""The equations on D: against the multipliers, by operations on columns, and their cost."""

import ctypes
import dataclasses
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import pytest
import sympy
import sympy as sp
from sympy import Rational, cos, sin

import dalembert as dal
from dalembert import compiler
from dalembert.symbolic import given, motion as motions
from dalembert.symbolic.convolutions import cost
from dalembert.symbolic.graph import Graph, below
from dalembert.symbolic.motion import agrees, motion
from dalembert.symbolic.printing import as_function
from dalembert.symbolic.reduced import NotReduced, Reduced, _copied
from dalembert.symbolic.values import values

sys.path.insert(0, str(Path(__file__).parents[3] / "benchmarks/peers"))
import problems  # noqa: E402


def known(names):
    """Positive parameters."""
    return sympy.symbols(names, positive=True)


def moving(names):
    q = dal.coordinates(names)
    return q, [x.d for x in q]


def model_of(L, constraints, q, **options):
    """The model, whose parameters are all symbols that are neither coordinates nor inputs."""
    force = options.get("force") or {}
    symbols = {s for e in (L, *constraints, *force.values()) for s in sympy.sympify(e).free_symbols}
    inputs = {s.name for s in options.get("inputs", ())}
    taken = {*q, *(x.d for x in q), dal.time}
    names = dict.fromkeys(sorted({s.name for s in symbols - taken} - inputs), 1.0)
    return given.make_model(L, constraints, q, names or None, **options)[0]


def unit(v):
    return sum(x**2 for x in v) / 2


# ---- what is checked -----------------------------------------------------------------------------


class Numbers:
    """A model and its equations on D, in numbers."""

    def __init__(self, model):
        self.model, self.found = model, model.reduced
        assert isinstance(self.found, Reduced)
        derived, found = model.derived, self.found
        read, graph = derived.read, derived.read.graph
        n, m, self.k = model.n, model.m, model.n - model.m
        sizes = {"w": self.k, "E": n * self.k, "e": n, "velocity": n, "rates": self.k}
        assert {name: len(getattr(found, name)) for name in sizes} == sizes
        q, v, p, u = ([read(s) for s in x] for x in (model.q, model.v, model.p, model.u))
        t = graph.symbol("t")
        arguments = {"t": t, "q": q, "v": v, "w": found.w, "p": p, "u": u}
        self.mask = {*v, *found.w}
        assert not self.mask & {*below([*found.E, *found.e])}
        assert not {*v} & {*below([*found.velocity, *found.rates])}
        assert not {*found.w} & {*below(found.quasi)}
        motion = dict(zip(q, found.velocity)) | dict(zip(found.w, found.rates)) | {t: 1}
        terms = derived.terms.outputs
        rest = dict.fromkeys(v, graph.zero)
        a = graph.replaced(derived.entries("constraint", "phi"), rest)
        self.parts = {
            "E": (found.E, (n, self.k)), "e": (found.e, (n,)), "V": (found.velocity, (n,)),
            "acceleration": (graph.along(found.velocity, motion), (n,)),
            "quasi": (found.quasi, (self.k,)), "M": (derived.mass or terms["M"], (n, n)),
            "F": (terms["F"], (n,)), "mu": (terms.get("mu", ()), (m, n)),
            "g": (terms.get("g", ()), (m,)), "a": (a, (m,)),
        }  # fmt: skip
        nodes = [e for part, _ in self.parts.values() for e in part]
        self.function = as_function(arguments, nodes)

    def at(self, q, w, v=None, t=0.7, p=None, u=None):
        n, model = self.model.n, self.model
        p = np.linspace(0.6, 1.4, len(model.p)) if p is None else p
        u = np.linspace(-0.5, 0.5, len(model.u)) if u is None else u
        flat = self.function(t, q, np.zeros(n) if v is None else v, w, p, u)
        found, start = {}, 0
        for name, (part, shape) in self.parts.items():
            found[name] = np.reshape(flat[start : start + len(part)], shape).astype(float)
            start += len(part)
        return found

    def check(self, seed=0, count=3, **given):
        """Check the basis, the velocities and the accelerations at random states."""
        rng = np.random.default_rng(seed)
        for _ in range(count):
            q = given.get("q", rng.uniform(-1.5, 1.5, self.model.n))
            w = rng.uniform(-1, 1, self.k)
            others = {key: x for key, x in given.items() if key != "q"}
            there = self.at(q, w, **others)
            assert abs(there["mu"] @ there["E"]).max(initial=0) <= 1e-12
            assert abs(there["mu"] @ there["e"] + there["a"]).max(initial=0) <= 1e-12
            assert np.linalg.matrix_rank(there["E"], 1e-6) == self.k
            assert abs(there["E"] @ w + there["e"] - there["V"]).max() <= 1e-12
            on_D = self.at(q, w, there["V"], **others)
            assert abs(on_D["quasi"] - w).max() <= 1e-12
            expected = accelerations(on_D)
            size = 1 + abs(expected).max()
            assert abs(there["acceleration"] - expected).max() <= 1e-9 * size
        return there


    def check_rank(self, count=20):
        """Check that E has full rank where mu has, at angles that are multiples of pi/2."""
        rng = np.random.default_rng(2)
        for _ in range(count):
            q = rng.choice([0.0, 0.5, 1.0, -0.5], self.model.n) * np.pi
            there = self.at(q, np.ones(self.k))
            if np.linalg.matrix_rank(there["mu"], 1e-9) == self.model.m:
                assert np.linalg.matrix_rank(there["E"], 1e-6) == self.k


def accelerations(x):
    """The accelerations, by multipliers."""
    m = len(x["mu"])
    whole = np.block([[x["M"], -x["mu"].T], [x["mu"], np.zeros((m, m))]])
    return np.linalg.solve(whole, [*x["F"], *-x["g"]])[: len(x["F"])]


# ---- the catalogue -------------------------------------------------------------------------------


def catalogue():
    """The systems written in C, in SymPy."""
    m, J, a, R, k, g, r, A, C = known("m J a R k g r A C")
    inertia, k1, k2, k3, J0, J1, gs, eps, Omega = known("I k1 k2 k3 J0 J1 gs eps Omega")
    q, v = moving("x y z")
    (x, y, z), (vx, vy, vz) = q, v
    springs = unit(v) - (k1 * x**2 + k2 * y**2 + k3 * z**2) / 2
    yield "particle", 1, unit(v), [vz - y * vx], q
    yield "particle_oscillator", 5, springs, [vz - y * vx], q
    yield "heisenberg", 8, springs, [y * vx - x * vy + vz], q
    L = unit(v) - (x**2 + y**2 + z**2 + eps * x**2 * z**2) / 2
    yield "contact_oscillator", 8, L, [vx + y * vz], q
    q, (vx, vy, turn) = moving("x y theta")
    (x, y, theta), across = q, vy * cos(q[2]) - vx * sin(q[2])
    L = (m * (vx**2 + vy**2) + J * turn**2) / 2
    yield "knife_edge", 2, L + m * gs * x, [-across], q
    yield "sleigh", 8, L, [across - a * turn], q
    yield "sleigh_contact", 6, L + m * a * turn * (a * turn / 2 + across), [across], q
    q, (vx, vy, turn, roll) = moving("x y theta phi")
    L = (m * (vx**2 + vy**2) + inertia * turn**2 + J * roll**2) / 2
    phi = q[3]
    yield "disk", 0, L, [vx - R * turn * cos(phi), vy - R * turn * sin(phi)], q
    q, (vx, vy, turn, roll) = moving("x y phi theta")
    L = (m * (vx**2 + vy**2) + inertia * turn**2 + J * roll**2) / 2 - k * sin(q[3])
    yield "robot", 4, L, [vx - R * roll * cos(q[2]), vy - R * roll * sin(q[2])], q
    q, v = moving("x y1 y2 y3 z1 z2 z3")
    V = sum(x**2 for x in q) + (q[4] * q[5]) ** 2 + sum((q[i] * q[i + 3]) ** 2 for i in (1, 2, 3))
    rest = sum(q[i] * v[i + 3] for i in (1, 2, 3))
    yield "chaotic", 27, unit(v) - V / 2, [v[0] + rest], q
    q, (v1, v2, v3) = moving("q1 q2 q3")
    q1, q2, q3 = q
    L = (
        (2 + q2**2 / 4) * v1**2 + (Rational(3, 2) + cos(q1) / 3) * v2**2 + (1 + q1**2 / 3) * v3**2
    ) / 2 + q3 * v1 * v2 / 5 + v1 * v3 / 10 + q1 * v2 * v3 / 6
    L += q2 * q3 * v1 / 4 + sin(q1) * v2 / 3 - q1 * q2 * v3 / 5
    L -= (q1**2 + 2 * q2**2 + 3 * q3**2 / 2) / 2 + q1**4 / 4 + q1 * q2 * q3 / 5
    yield "genmass", 67, L, [-q2 * v1 + (q1 / 2 + q3 / 4) * v2 + (1 + q1**2 / 5) * v3], q
    q, (vx, vy, yaw, lean, spin) = moving("x y alpha beta gamma")
    (_, _, alpha, beta, _), omega = q, spin + yaw * sin(q[3])
    L = (
        m * (vx**2 + vy**2 + r**2 * sin(beta) ** 2 * lean**2)
        + A * (lean**2 + cos(beta) ** 2 * yaw**2) + C * omega**2
    ) / 2 - m * g * r * cos(beta)  # fmt: skip
    yield "rolling_disc", 18, L, [
        vx - r * omega * cos(alpha) - r * lean * cos(beta) * sin(alpha),
        vy - r * omega * sin(alpha) + r * lean * cos(beta) * cos(alpha),
    ], q  # fmt: skip
    q, v = moving("x y theta_x theta_y theta_z")
    L = (m * (v[0] ** 2 + v[1] ** 2) + J * sum(x**2 for x in v[2:])) / 2
    rolls = [v[0] - a * v[3] + Omega * q[1], v[1] + a * v[2] - Omega * q[0]]
    yield "ball_on_table", 0, L, rolls, q
    q, (vx, vy, turn, rotor, steer) = moving("x y theta psi phi")
    theta, phi = q[2], q[4]
    L = (m * (vx**2 + vy**2 + r**2 * turn**2) + J0 * rotor**2) / 2 + J0 * rotor * turn
    yield "snakeboard", 9, L + J1 * steer**2, [
        vy * cos(theta + s * phi) - vx * sin(theta + s * phi) - s * r * turn * cos(phi)
        for s in (1, -1)
    ], q  # fmt: skip
    yield "n_trailer", 83, *trailers(3)


def trailers(count):
    """L, the constraints and the coordinates of a car with trailers."""
    m, J, d = known("m J d")
    q, v = moving(f"x y theta:{count + 1}")
    (u, w), L, constraints = v[:2], 0, []
    for i, (angle, turn) in enumerate(zip(q[2:], v[2:])):
        if i:
            u, w = u + d * turn * sin(angle), w - d * turn * cos(angle)
        L += (m * (u**2 + w**2) + J * turn**2) / 2
        constraints.append(w * cos(angle) - u * sin(angle))
    return L, constraints, q


@pytest.mark.parametrize(
    "name, most, L, constraints, q", [*catalogue()], ids=lambda x: x if isinstance(x, str) else ""
)
def test_systems_in_C(name, most, L, constraints, q):
    """The accelerations of the system in C come from formulas by hand."""
    system = dal.systems.get(name)
    model = model_of(L, constraints, q)
    numbers = Numbers(model)
    numbers.check()
    numbers.check_rank()
    assert model.reduced.cost <= most
    p = [system.parameters[key] for key in model.parameters]
    rng = np.random.default_rng(1)
    point, w = rng.uniform(-1.5, 1.5, model.n), rng.uniform(-1, 1, numbers.k)
    there = numbers.at(point, w, p=p)
    expected = system.acceleration(point, there["V"])
    assert abs(there["acceleration"] - expected).max() <= 1e-9 * (1 + abs(expected).max())


@pytest.mark.parametrize("name, most", [
    ("cvt", 5), ("disguised", 22), ("roller_racer", 17), ("sleigh_with_rotor", 8),
    ("steered_car", 13), ("two_wheeled_robot", 6),
])  # fmt: skip
def test_systems_in_sympy(name, most):
    model = dal.systems.get(name)._model
    numbers = Numbers(model)
    numbers.check()
    numbers.check_rank()
    assert model.reduced.cost <= most


@pytest.mark.parametrize("name, most", [
    ("springs", 5), ("knife_edge", 2), ("sleigh", 12), ("contact", 8), ("rolling_disc", 15),
    ("snakeboard", 14), ("gyroscopic", 6), ("comet", 8),
])  # fmt: skip
def test_problems_of_the_peers(name, most):
    problem = problems.PROBLEMS[name]()
    q, v = moving(" ".join(map(str, problem.q)))
    rule = dict(zip((*problem.q, *problem.v), (*q, *v))) | {problems.t: dal.time}
    force = {rule[x]: f.xreplace(rule) for x, f in problem.force.items()}
    constraints = [e.xreplace(rule) for e in problem.constraints]
    model = model_of(problem.L.xreplace(rule), constraints, q, force=force or None)
    Numbers(model).check()
    found = model.reduced
    assert found.cost <= most
    read = model.derived.read
    rates = {read(x): e for x, e in zip(model.q, found.velocity)} | dict(zip(found.w, found.rates))
    assert cost(rates | {read.graph.symbol("t"): read.graph.one}) == found.cost


# ---- own models ----------------------------------------------------------------------------------

X, Y, Z = dal.coordinates("x y z")
Q3 = (X, Y, Z)
V3 = tuple(x.d for x in Q3)
Q4 = dal.coordinates("x1 x2 x3 x4")
V4 = tuple(x.d for x in Q4)
FREE = sympy.Symbol("b")  # a parameter that may be 0
POSITIVE, NONZERO = known("c"), sympy.Symbol("c", nonzero=True, real=True)
PUSH = sympy.Symbol("push")


def words(model):
    """The kinds of operations."""
    return [" ".join(x for x in text.split() if x not in model.coordinates)
            for text in model.reduced.how]  # fmt: skip


def test_affine():
    """A table turns at a rate that grows; on it is a blade, of heading 0 and of heading z."""
    turn = dal.time / 3
    model = model_of(unit(V3) - X**2 * Y / 2, [Y.d - turn * X - sin(Z)], Q3)
    numbers = Numbers(model)
    there = numbers.check()
    assert words(model) == ["pivot"] and abs(there["e"]).max() > 0.1
    model = model_of(unit(V3), [X.d * sin(Z) - Y.d * cos(Z) + turn * X], Q3)
    assert words(model) == ["turn"]
    Numbers(model).check()


def test_mass_in_two_blocks():
    L = (2 + cos(X)) * V4[0] ** 2 / 2 + V4[0] * V4[1] / 2 + V4[1] ** 2 + unit(V4[2:])
    L = L.xreplace({X: Q4[0]}) + Q4[2] ** 2 * V4[3] ** 2 / 2 + V4[2] * V4[3] * sin(Q4[3]) / 2
    model = model_of(L - Q4[0] ** 2 * Q4[2], [], Q4)
    Numbers(model).check()
    assert model.reduced.how == () and model.derived.mass is None


def test_without_constraints():
    """E is 1, w is v, and forces, time and inputs are as they are."""
    model = model_of(
        unit(V3) - X**2 * Y * cos(dal.time), [], Q3, force={X: -X.d * Y.d + PUSH}, inputs=[PUSH]
    )
    numbers = Numbers(model)
    there = numbers.check()
    assert np.array_equal(there["E"], np.eye(3)) and not there["e"].any()
    assert model.reduced.velocity == model.reduced.w


@pytest.mark.parametrize("parameter, how", [
    (FREE, None), (POSITIVE, "pivot"), (NONZERO, "pivot"),
])  # fmt: skip
def test_pivots_of_parameters(parameter, how):
    """A parameter that may be 0 is no pivot: b x' + y y' + z z' = 0 needs a division."""
    model = model_of(unit(V3), [parameter * X.d + Y * Y.d + Z * Z.d], Q3)
    if how is None:
        with pytest.raises(NotReduced, match="no operation"):
            model.reduced  # noqa: B018
    else:
        assert words(model) == [how]
        Numbers(model).check()


def test_pair_of_a_parameter_and_a_coordinate():
    model = model_of(unit(V3), [FREE * X.d - Z * Y.d], Q3)
    assert words(model) == ["pair"]
    numbers = Numbers(model)
    numbers.check()
    numbers.check(p=[0.0])  # and where the parameter is 0
    numbers.check(q=[0.3, 0.1, 0.0])


def test_turns_and_pairs_in_other_units():
    """Squares of velocities have the weights of the kinetic energy."""
    T = unit([X.d / POSITIVE, Y.d, Z.d])
    model = model_of(T, [sin(Z) * X.d / POSITIVE - cos(Z) * Y.d], Q3)
    assert words(model) == ["turn"]
    Numbers(model).check()
    model = model_of(T, [Z * X.d / POSITIVE - X * Y.d + 1], Q3)
    assert words(model) == ["pair"]
    there = Numbers(model).check(q=[0.3, 0.5, 0.7], p=[100.0])
    row = np.array([0.7 / 100, -0.3, 0])  # e has the least kinetic energy
    moved = row * [1e4, 1, 1]
    np.testing.assert_allclose(there["e"], -moved / (row @ moved), rtol=1e-13)


def test_rows_that_nearly_depend_on_others():
    """They cost digits once, not twice."""
    q, v = moving("x y z w")
    one = [sin(q[1] + i * q[3]) + i for i in range(4)]
    other = [cos(q[0] * i - q[2]) for i in range(4)]
    small = sp.Symbol("small")
    rows = [sum(map(sp.prod, zip(one, v))),
            sum((a + small * b) * e for a, b, e in zip(one, other, v))]  # fmt: skip
    model = model_of(unit(v) - q[0] ** 2 * q[1], rows, q)
    nodes = motions.accelerations(model)
    point = dict(zip([e.name for e in (*model.q, *model.v, *model.p)],
                     [0.3, 0.5, -0.7, 0.2, 1.0, 0.5, 0.25, -1.0, 2.0**-20]))  # fmt: skip
    rounded = values(nodes, point)
    with mpmath.workdps(60):
        exact = values(nodes, point)
        apart = max(abs(a - b) for a, b in zip(rounded, exact)) / max(map(abs, exact))
    assert apart < 1e-8


def test_common_factors_vanish():
    """x y' - x^2 z' = 0 is y' = x z' off x = 0, where the basis keeps its rank."""
    model = model_of(unit(V3) - Y**2, [X * Y.d - X**2 * Z.d], Q3)
    numbers = Numbers(model)
    numbers.check()
    there = numbers.at([0.0, 0.2, 0.3], [0.5, 0.6])
    assert np.linalg.matrix_rank(there["E"]) == 2 and np.isfinite(there["acceleration"]).all()


def test_quaternions():
    """A sphere in R^4, and three entries without a pivot."""
    sphere = sum(x * v for x, v in zip(Q4, V4))
    three = sum(x**2 * v for x, v in zip(Q4[:3], V4))
    for constraint in (sphere, three):
        model = model_of(unit(V4) - Q4[0] ** 3, [constraint], Q4)
        assert words(model) == ["quaternion"]
        numbers = Numbers(model)
        numbers.check()
        numbers.check(q=[0.0, 0.4, 0.0, 0.0])


@pytest.mark.parametrize("pivot", [
    1 + X**2, sympy.exp(X), 3 + 2 * sin(X) * cos(Y), POSITIVE + Y**4, -2 - Z**2,
])  # fmt: skip
def test_pivots_that_vanish_nowhere(pivot):
    model = model_of(unit(V3), [X * X.d + sin(Y) * Y.d + pivot * Z.d], Q3)
    assert words(model) == ["pivot without division"]
    Numbers(model).check()


def test_time_and_inputs_in_constraints():
    turned = X.d * sin(dal.time) - Y.d * cos(dal.time) + Z * Z.d
    model = model_of(unit(V3) * (1 + dal.time**2) - X**2, [turned], Q3)
    Numbers(model).check()
    model = model_of(
        unit(V3) - X * Y, [Z.d - PUSH * X.d - Y * PUSH], Q3, inputs=[PUSH], force={Y: PUSH**2 - Y.d}
    )
    Numbers(model).check()


def test_walls_and_functions_are_kept():
    V = sympy.Max(0, X - Y) ** 2 + sympy.log(2 + Z**2) + sympy.sqrt(1 + X**2) + sympy.tan(Y / 4)
    force = {X: -sympy.Abs(X.d) * X.d, Y: -sympy.tanh(3 * Y.d)}
    model = model_of(unit(V3) - V, [Z.d - sympy.atan(Y) * X.d], Q3, force=force)
    Numbers(model).check()


ROOTS = sympy.sqrt(1 + X.d**2 + Y.d**2) - sympy.sqrt(4 - Z.d * cos(X))


@pytest.mark.parametrize("more", [0, dal.time * Z.d**2])
def test_kinetic_energies_that_are_no_quadratic_form(more):
    model = model_of(unit(V3) + ROOTS + more - X * Y, [Z.d - Y * X.d], Q3)
    Numbers(model).check()


def test_powers_that_are_floats():
    """Their numerators have 16 digits; no monomial has such an exponent."""
    V = (1 + X**2) ** 0.77 + (2 + cos(Y)) ** -1.3
    model = model_of(sympy.sqrt(1 + X**2) ** 0.4 * unit(V3) - V, [Z.d - Y * X.d], Q3)
    Numbers(model).check()


def test_angles_that_are_sums():
    """A blade whose heading is the sum of two angles, in units of a half."""
    q, v = moving("x y alpha beta")
    heading = q[2] + q[3] / 2
    model = model_of(unit(v) - q[0], [v[0] * sin(heading) - v[1] * cos(heading)], q)
    assert words(model) == ["turn"]
    Numbers(model).check()


@pytest.mark.parametrize("L, constraints, reason", [
    (unit(V3), [X.d**2 - Y.d * Z.d], "not linear"),
    (unit(V3), [X.d, Y.d - X * Z.d, Z.d + Y * X.d], "no velocity"),
    (unit(V3), [X * X.d + Y * Y.d + sin(Z) * Z.d], "no operation"),
])  # fmt: skip
def test_what_is_not_reduced(L, constraints, reason):
    model = model_of(L, constraints, Q3)
    with pytest.raises(NotReduced, match=reason):
        model.reduced  # noqa: B018


def test_long_chains():
    """Eight trailers take twice as many convolutions as four: nothing is expanded."""
    costs = []
    for count in (4, 8):
        model = model_of(*trailers(count))
        Numbers(model).check(count=2)
        costs.append(model.reduced.cost)
    assert costs[0] <= 110 and costs[1] <= 2 * costs[0]


# ---- what costs ----------------------------------------------------------------------------------


def test_cost():
    graph = Graph()
    x, y, p = map(graph.symbol, "xyp")
    product, root = x * y, graph.power(x, Rational(1, 2))
    for rate, expected in (
        (p * x + 3 * y + p**2, 0), (product + p * product, 1), (x / y, 1), (p / y, 1),
        (x / y + p / y, 2), (x**2, 1), (x**3, 2), (root, 2), (graph.call("sin", x), 2),
        (graph.call("sin", x) * graph.call("cos", x), 3), (graph.call("exp", p), 0),
        (graph.call("exp", x * p), 1), (graph.call("tan", x), 2), (graph.call("max", x, y), 0),
    ):  # fmt: skip
        assert cost({x: rate, y: x}) == expected, rate
    assert cost({x: p, y: graph.call("sin", x) * y}) == 1  # x moves evenly
    assert cost({x: graph.zero, y: x * y**2}) == 1


def test_equations_are_compared_before_they_are_believed():
    """With rates off by 1e-12 the series are those of (q, v)."""
    x, y, theta = dal.coordinates("x y theta")
    blade = dal.System.from_sympy(
        (x.d**2 + y.d**2 + theta.d**2) / 2 - x, [sp.sin(theta) * x.d - sp.cos(theta) * y.d]
    )
    model = blade._model
    assert motion(model).in_D
    found = model.reduced
    wrong = Fraction(1) + Fraction(1, 10**12)
    rates = (wrong * found.rates[0], *found.rates[1:])
    model.__dict__["_reduced"] = dataclasses.replace(found, rates=rates)
    assert not motion(model).in_D
    with pytest.raises(NotImplementedError, match="are wrong; please report it"):
        blade.reduced()


def test_equations_are_compared_where_all_terms_are_seen():
    """In coarse units a root is linear at velocities of 1."""
    c = 1e37
    L = c**2 * unit(V3) + sympy.sqrt(1 + c**2 * X.d**2) - X**2 / 2
    model = model_of(L, [Z.d - 2 * Y.d], Q3)
    assert agrees(model, model.reduced)
    without = model_of(c**2 * unit(V3) - X**2 / 2, [Z.d - 2 * Y.d], Q3).reduced
    graph, copies = model.derived.read.graph, {}

    def copied(nodes):
        return tuple(_copied(graph, nodes, copies))

    wrong = dataclasses.replace(model.reduced, **{
        name: copied(getattr(without, name)) for name in ("w", "velocity", "rates")
    })  # fmt: skip
    assert not agrees(model, wrong)


def test_equations_for_people():
    """Of the sleigh, as Bloch (2003) writes them; and what has none."""
    found = dal.systems.sleigh().reduced()
    a, J, m, theta = sp.symbols("a J m theta")
    w1, w2 = found.w
    names = {s: sp.Symbol(s.name) for s in found.E.free_symbols | found.rates.free_symbols}
    rates = found.rates.xreplace(names)
    w1, w2 = sp.Symbol(w1.name), sp.Symbol(w2.name)
    assert sp.simplify(rates[0] - a * w2**2) == 0
    assert sp.simplify(rates[1] + m * a * w1 * w2 / (J + m * a**2)) == 0
    assert found.E.xreplace(names)[:, 0] == sp.Matrix([sp.cos(theta), sp.sin(theta), 0])
    assert r"\dot w_{1} &= a w_{2}^{2}" in found._repr_latex_()
    x, y = dal.coordinates("x y")
    free = dal.System.from_sympy((x.d**2 + y.d**2) / 2)
    assert free.reduced().E == sp.eye(2) and free.reduced().rates == sp.zeros(2, 1)
    round_ = dal.System.from_sympy((x.d**2 + y.d**2) / 2, [x.d**2 + y.d**2 - 1])
    with pytest.raises(NotImplementedError, match="not linear in the velocities"):
        round_.reduced()
    with pytest.raises(ValueError, match="has no formulas"):
        dal.System(mass=[1.0]).reduced()


@pytest.mark.parametrize("name", ["particle", "sleigh", "snakeboard", "cvt", "disguised"])
def test_closed_charts(name, tmp_path):
    """In closed form, and in C, a chart is what it is in numbers."""
    system = dal.systems.get(name)
    n, k = system.n, system.n - system.m
    chart = dal.Chart(system)
    closed = chart.closed()
    xi = np.random.default_rng(1).uniform(0.2, 0.9, n + k)
    q, v = chart.lift(xi)
    symbols = [sp.Symbol(x) for x in (*system.coordinates, *system.parameters)]
    values = dict(zip(symbols, [*q, *system.parameters.values()]))
    plain = {x: sp.Symbol(x.name) for x in closed.E.free_symbols | closed.e.free_symbols}
    E, e = (np.array(x.xreplace(plain).subs(values), dtype=float) for x in (closed.E, closed.e))
    np.testing.assert_allclose(E @ xi[n:] + e[:, 0], v, atol=1e-14)
    (tmp_path / "own.c").write_text(closed.c)
    command = [*compiler.find().command, "-shared", "-fPIC", "own.c", "-o", "own.so", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "own.so"))
    outs = np.zeros(n), np.zeros(k)
    p = np.array([*system.parameters.values(), 0.0])
    given = [ctypes.c_void_p(x.ctypes.data) for x in (q, xi[n:].copy(), p, p)]
    for function, out in zip((library.velocity, library.rates), outs):
        function(ctypes.c_double(0.0), *given, ctypes.c_void_p(out.ctypes.data))
    np.testing.assert_allclose(np.concatenate(outs), chart.field(xi), atol=1e-13)


def test_what_is_no_chart():
    blade = dal.systems.knife_edge()
    with pytest.raises(NotImplementedError, match="do not determine the dependent"):
        blade.reduced("theta")
    with pytest.raises(ValueError, match="expected m = 1 names"):
        blade.reduced(["x", "y"])
