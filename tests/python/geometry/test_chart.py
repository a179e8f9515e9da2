"""Charts of D and the states between those of a run, against formulas in NumPy, the geometry
functions, and the steps of integrate."""

import logging
import pickle

import numpy as np
import pytest
import sympy as sp

import dalembert as dal
from conftest import U
from dalembert.geometry import cutoff

# Solves with condition below 10 and sums of 4 terms of size 1 to 10: 1e-13 is about 1000 u.
TOLERANCE = 1e-13


def near(value, expected, tolerance=TOLERANCE):
    np.testing.assert_allclose(value, expected, rtol=tolerance, atol=tolerance)


def several(own, count=7):
    """Return states of D."""
    rng = np.random.default_rng(1)
    q = own.q0 + 0.2 * rng.standard_normal((count, 4))
    return q, own.system().project(q, rng.standard_normal((count, 4)))


# ---- charts --------------------------------------------------------------------------------


def test_connection(own):
    q, v = several(own)
    chart = dal.Chart(own.system(coordinates="abcd"), q[0], dependent=["c", "a"])
    assert chart.dependent == ("a", "c") and chart.independent == ("b", "d")
    mu = np.array([own.mu(p) for p in q])
    near(chart.B(q), mu[:, :, [0, 2]])
    near(chart.A(q), np.linalg.solve(mu[:, :, [0, 2]], mu[:, :, [1, 3]]))
    np.testing.assert_array_equal(chart.A(q[1]), chart.A(q, v)[1])
    near(v[:, [0, 2]], -np.einsum("kaj,kj->ka", chart.A(q), v[:, [1, 3]]))
    size = np.sqrt(np.diag(own.mass))
    scaled = chart.A(q) * size[[0, 2]][:, None] / size[[1, 3]]
    near(chart.condition(q), np.hypot(1.0, np.linalg.norm(scaled, 2, axis=(1, 2))))
    assert isinstance(chart.condition(q[0]), float)


def test_psi(own):
    q, v = several(own)
    system = own.system()
    chart = dal.Chart(system, q[0])
    xi = chart.drop(q, v)
    assert xi.shape == (7, 6)
    for got, expected in zip(chart.lift(xi), (q, v)):
        near(got, expected)
    assert np.max(system.relative_residual(*chart.lift(xi))) <= 16 * U
    J = chart.jacobian(xi)
    np.testing.assert_array_equal(chart.left_inverse @ J[3], np.eye(6))
    np.testing.assert_array_equal(J[3], chart.jacobian(xi[3]))
    near(np.einsum("kij,kj->ki", J, chart.field(xi)), system.field(q, v))
    hor, ver = chart.split(q, v + 1.0)
    near(hor + ver, v + 1.0)
    assert np.max(system.relative_residual(q, hor)) <= 16 * U
    assert not np.any(ver[:, [c in chart.independent for c in system.coordinates]])
    d = 1e-5  # differences err by d^2 and u/d
    up, down = (np.hstack(chart.lift(xi[2] + s * d * np.eye(6))).T for s in (1, -1))
    near(J[2], (up - down) / (2 * d), 1e-8)


def test_multipliers(own):
    q, v = several(own)
    system = own.system()
    chart = dal.Chart(system, q[0])
    of_frame = chart.multipliers(q, v)
    near(of_frame, np.einsum("kab,ka->kb", chart.B(q), system.multipliers(q, v)))
    near(chart.multipliers_back(q, v, of_frame), system.multipliers(q, v))
    near(chart.multipliers(q[0], v[0], [1.0, 2.0]), chart.B(q[0]).T @ [1.0, 2.0])


@pytest.mark.parametrize("beta", [0.0, 0.3, 0.5, 1.0])
def test_step(own, beta):
    q, v = several(own)
    system = own.system()
    chart = dal.Chart(system, q[0])
    after, reactions = chart.step(chart.drop(q, v), h=0.05, beta=beta)
    for k in range(len(q)):
        run = dal.integrate(system, beta, q[k], v[k], h=0.05, steps=1)
        near(after[k], chart.drop(run.q[1], run.v[1]))
        node = q[k] + (1 - beta) * 0.05 * v[k]
        near(reactions[k], chart.multipliers(node, v[k], run.reactions[0]), 20 * TOLERANCE)


def turned_skate():
    """Return a skate with the blade at heading + 2 t and two motors, and its field by hand."""
    x, y, heading = dal.coordinates("x y heading")
    ahead, torque = sp.symbols("ahead torque")
    blade = heading + 2 * dal.time
    system = dal.System.from_sympy(
        (x.d**2 + 2 * y.d**2 + 3 * heading.d**2) / 2 - y,
        [sp.sin(blade) * x.d - sp.cos(blade) * y.d],
        force={x: ahead, heading: torque - heading.d},
        inputs=[ahead, torque],
    )

    def field(t, q, v, u):
        angle, rate, mass = q[2] + 2 * t, v[2] + 2, np.array([1.0, 2, 3])
        mu = np.array([np.sin(angle), -np.cos(angle), 0])
        turn = rate * (np.cos(angle) * v[0] + np.sin(angle) * v[1])
        free = np.array([u[0], -1, u[1] - v[2]]) / mass
        reaction = -(mu @ free + turn) / (mu @ (mu / mass))
        return np.concatenate([v, free + mu / mass * reaction]), mu, reaction

    return system, field


def test_time_and_inputs(in_python):
    """The field of a chart is that of the system at the same t and inputs, less a velocity."""
    system, field = turned_skate()
    q, t = np.array([[0.1, 0.2, 0.3], [1, 2, -0.4], [0, 0, 0]]), np.array([0.2, 1.1, -0.3])
    chart = dal.Chart(system, q[0], t=t[0], dependent="y")
    assert dal.Chart(system, q[0], t=t[0]).dependent == ("x",)  # y is heavier
    xi = np.hstack([q, [[0.5, -1], [1, 2], [-2, 0.3]]])
    u = np.array([[1.0, 2], [-3, 0.5], [0, 0]])
    _, v = chart.lift(xi, t)
    angle = q[:, 2] + 2 * t
    near(v, np.column_stack([xi[:, 3], np.tan(angle) * xi[:, 3], xi[:, 4]]))
    near(chart.A(q, t=t)[:, 0, 0], -np.tan(angle))
    near(chart.B(q, t=t)[:, 0, 0], -np.cos(angle))
    near(chart.condition(q, t=t), np.hypot(1, np.sqrt(2) * np.tan(angle)))
    for k in range(3):
        expected, mu, reaction = field(t[k], q[k], v[k], u[k])
        near(chart.field(xi, t, u)[k], np.delete(expected, 4))
        named = dict(zip(("ahead", "torque"), u[k]))
        near(chart.field(xi[k], t[k], named), np.delete(expected, 4))
        near(chart.multipliers(q, v, t=t, inputs=u)[k], mu[1] * reaction)
        near(chart.multipliers_back(q[k], v[k], [mu[1] * reaction], t[k]), reaction)

        def slope(way, rate, k=k, e=1e-5):
            ends = (np.concatenate(chart.lift(xi[k] + d * way, t[k] + d * rate)) for d in (e, -e))
            return np.subtract(*ends) / (2 * e)

        near(slope(chart.field(xi[k], t[k], u[k]), 1), expected, 1e-8)  # the whole acceleration
        near(chart.jacobian(xi, t)[k].T, [slope(way, 0) for way in np.eye(5)], 1e-8)
        hor, ver = chart.split(q[k], v[k] + [0, 7, 0], t[k])
        near(hor, v[k])
        near(ver, [0, 7, 0])
        run = dal.integrate(system, "midpoint", q[k], v[k], t0=t[k], h=0.05, steps=1, inputs=u[k])
        made, reactions = chart.step(xi, 0.05, t=t, inputs=u)
        near(made[k], chart.drop(run.q[-1], run.v[-1]))
        node, middle = angle[k] + 0.05 + 0.025 * v[k][2], run.reactions[0, 0]
        near(reactions[k, 0], -np.cos(node) * middle, 1e-12)
    # what a call was given is gone after it
    near(chart.field(xi[0], t[0]), np.delete(field(t[0], q[0], v[0], [0, 0])[0], 4))
    late = (np.pi / 2 - 0.3) / 2 - 1e-3  # the blade nearly points along y
    assert chart.condition(q[0], t=late) > 100
    assert chart.renewed(q[0], t=late).dependent == ("x",)
    assert chart.renewed(q[0], t=0.1) is chart
    again = pickle.loads(pickle.dumps(chart))
    np.testing.assert_array_equal(again.field(xi, t, u), chart.field(xi, t, u))
    there = chart.curve(q[0], v[0], q[1], v[1], 0.5, t=0.7)
    near(there[1][1], np.tan(there[0][2] + 1.4) * there[1][0])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"t": [0, 1]}, "t: expected shape"),
        ({"inputs": [1]}, "inputs"),
        ({"inputs": {"torc": 1}}, "torc"),
        ({"t": np.nan}, "t"),
    ],
)
def test_bad_times_and_inputs(given, words, in_python):
    chart = dal.Chart(turned_skate()[0], [0, 0, 0])
    with pytest.raises(ValueError, match=words):
        chart.field([0, 0, 0, 1, 1], **given)


def test_curve(own):
    q, v = several(own)
    system = own.system()
    chart = dal.Chart(system, q[0])
    tau = np.linspace(-0.1, 1.1, 25)
    x = chart.curve(q[0], v[0], q[1], v[1], tau)
    assert np.max(system.relative_residual(*x)) <= 16 * U
    chi, rest, _ = cutoff(tau)
    xi = np.outer(chi, chart.drop(q[0], v[0])) + np.outer(rest, chart.drop(q[1], v[1]))
    near(chart.drop(*x), xi)
    near(chart.curve(q[0], v[0], q[1], v[1], 0.0)[1], v[0])


def test_choice_and_change(caplog):
    particle = dal.systems.particle()
    chart = dal.Chart(particle, [0, 0.5, 0])
    assert repr(chart) == "<Chart of particle: (z) depend on (x, y)>"
    assert dal.Chart(particle, [0, 2, 0]).dependent == ("x",)
    assert dal.Chart(particle).dependent == chart.renewed([0, 17, 0]).dependent
    with caplog.at_level(logging.INFO, "dalembert"):
        other = chart.renewed([0, 18, 0])
    assert other.dependent == ("x",) and other.renewed([0, 17, 0]) is other
    assert "change from z (condition 18 here) to x" in caplog.text
    chosen = dal.Chart(particle, [0, 2, 0], dependent="z")  # by itself it takes x there
    again = pickle.loads(pickle.dumps(chosen))
    assert again.dependent == ("z",) and again.condition([0, 2, 0]) == chosen.condition([0, 2, 0])


def test_a_renewed_chart_of_nonlinear_constraints_starts_at_the_new_velocity():
    """v_x^2 + v_y^2 = 4 has two velocities of each v_x: the branch is that of the state."""
    circle = dal.System(
        mass=[1, 1],
        constraint=lambda q, v: [v @ v - 4],
        constraint_v=lambda q, v: [2 * v],
        constraint_q=lambda q, v: [[0, 0]],
        coordinates=["x", "y"],
    )
    chart = dal.Chart(circle, [0, 0], [0, 2])
    near(chart.lift([0, 0, 1.2])[1], [1.2, 1.6])
    below = chart.renewed([0, 0], [0, -2])
    assert below.dependent == chart.dependent == ("y",)
    near(below.lift([0, 0, 1.2])[1], [1.2, -1.6])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda c: c.lift([1, 2]), r"xi: expected shape \(5,\) or \(N, 5\)"),
        (lambda c: c.drop([1, 2, 3], [1, 2]), "v: expected shape"),
        (lambda c: c.A([1, np.nan, 3]), r"q\[1\] = nan"),
        (lambda c: c.step([0, 0, 0, 1, 1], h=0), "h = 0"),
        (lambda c: c.step([0, 0, 0, 1, 1], h=0.1, beta=2), "beta = 2"),
        (lambda c: c.multipliers([0] * 3, [0] * 3, [1, 2]), r"multipliers: expected shape \(1,\)"),
        (lambda c: c.curve([0, 0, 0], [0, 0, 0], [0, 0], [0, 0, 0], 0), "q2: expected shape"),
        (lambda c: dal.Chart(c.system, dependent="w"), "no coordinate 'w'; choose from x, y, z"),
        (lambda c: dal.Chart(c.system, dependent="zz"), "did you mean 'z'"),
        (lambda c: dal.Chart(c.system, dependent=3), "dependent = 3: expected m = 1 names"),
        (lambda c: dal.Chart(c.system, v=[0, 0, 0]), "v is given without q"),
        (lambda c: dal.Chart(c.system, dependent=["x", "z"]), "expected m = 1 names"),
        (lambda c: dal.Chart(None), "system"),
    ],
)
def test_bad_arguments(call, words):
    with pytest.raises((ValueError, TypeError), match=words):
        call(dal.Chart(dal.systems.particle()))


def test_singular():
    particle = dal.systems.particle()
    with pytest.raises(dal.SingularError, match="coordinates x .* form a singular matrix"):
        dal.Chart(particle, [0, 0, 0], dependent="x")
    chart = dal.Chart(particle, [0, 1, 0], dependent="x")
    with pytest.raises(dal.SingularError) as caught:
        chart.A([[0, 1, 0], [0, 2, 0], [0, 0, 0]])
    assert caught.value.step == 2
    assert chart.condition([0, 0, 0]) == np.inf


def test_exceptions_of_functions_come_back():
    def forms(q):
        if q[1] > 1:
            raise KeyError("too far")
        return [[-q[1], 0.0, 1.0]]

    chart = dal.Chart(dal.System(mass=np.eye(3), mu=forms), [0, 0, 0])
    with pytest.raises(KeyError, match="too far"):
        chart.lift([0, 2, 0, 1, 1])
    near(chart.lift([0, 0.5, 0, 1, 1])[1], [1, 1, 0.5])


# ---- between the states of a run -----------------------------------------------------------


@pytest.mark.parametrize("scheme", ["leapfrog", "midpoint-nodes", "endpoint-nodes", "reference"])
@pytest.mark.parametrize("stride", [1, 3])
def test_run_is_called(own, scheme, stride):
    system = own.system()
    v0 = system.consistent(own.q0, [0.3, -0.2, 0.5, 0.1])
    kept = {"initial": "shift"} if scheme.endswith("nodes") else {}
    run = dal.integrate(
        system, scheme, own.q0, v0, h=-0.01, t0=0.3, steps=60, stride=stride, **kept
    )
    again = run(run.t)
    np.testing.assert_array_equal(again.q, run.q)
    np.testing.assert_array_equal(again.v, run.v)
    t = np.random.default_rng(2).uniform(-0.3, 0.3, 50)
    states = run(t)
    assert states.q.shape == states.v.shape == (50, 4)
    np.testing.assert_array_equal(states.t, t)
    assert np.max(system.relative_residual(states.q, states.v, run.shift)) <= 16 * U
    one = run(t[7])
    np.testing.assert_array_equal(one.q, states.q[7])
    np.testing.assert_array_equal(one.v, states.v[7])
    assert one.t == t[7] and states.chart_changes >= 0
    exact = dal.reference(system, own.q0, v0, t=t[7], t0=0.3)
    shift = run.shift
    # h^2, or h for endpoint, times derivatives below 10
    error = 10 * (0.01 if scheme == "endpoint-nodes" else 0.01**2)
    near(one.q - shift * one.v, exact.q, error)
    near(one.v, exact.v, error)


def test_order_of_what_lies_between():
    system = dal.systems.particle_oscillator()
    exact = dal.reference(system, t=1.0 / 3.0)
    for scheme, order in (("midpoint", 2), ("midpoint-suzuki4", 4), ("midpoint-kl8", 4)):
        errors = [
            np.max(np.abs(dal.integrate(system, scheme, h=h, t_end=1.0)(1.0 / 3.0).q - exact.q))
            + np.max(np.abs(dal.integrate(system, scheme, h=h, t_end=1.0)(1.0 / 3.0).v - exact.v))
            for h in (1 / 8, 1 / 16)
        ]
        # 1/3 stands at 2/3 of one interval and at 1/3 of the other
        assert abs(np.log2(errors[0] / errors[1]) - order) < 0.4


def test_charts_change_along_a_run():
    run = dal.integrate(dal.systems.particle(), "midpoint", [0, -3, 0], [1, 1, -3], h=0.1, t_end=6)
    assert run(np.arange(0.05, 6, 0.1)).chart_changes == 2
    assert run(0.05).chart_changes == 0


def test_partial_run():
    def observer(step, t, q, v):
        return step == 30

    run = dal.integrate(dal.systems.particle(), h=0.1, t_end=10, observer=observer)
    assert run.t[-1] == 3.0
    run(2.95)
    with pytest.raises(ValueError, match="t = 3.05 is outside the stored.*from 0 to 3$"):
        run(3.05)


def test_ends_of_a_run():
    run = dal.integrate(dal.systems.particle(), h=1 / 3 + 1e-11, t_end=1.0)
    assert run.t[-1] != 1.0
    near(run(1.0).q, run.q[-1], 1e-10)
    short = dal.integrate(dal.systems.particle(), h=1 / 3 - 1e-11, t_end=1.0)
    near(short(1.0).q, short.q[-1] + (1.0 - short.t[-1]) * short.v[-1], 1e-15)
    for t in (-1e-6, 1.001, np.inf, np.nan):
        with pytest.raises(ValueError, match="t = |t = nan|expected finite"):
            run(t)
    with pytest.raises(ValueError, match="t: expected shape"):
        run([[0.5]])
    alone = dal.integrate(dal.systems.particle(), h=0.1, steps=0)
    np.testing.assert_array_equal(alone(0.0).q, alone.q[0])
    assert run([]).q.shape == (0, 3)
