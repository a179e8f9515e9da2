"""Systems that depend on time, from expressions and from functions, against a reduced equation.

A skate with the heading theta, whose blade a motor turns at the rate TURN, on a floor that moves
with the velocity w = SWAY (cos 2t, 0), down a slope that changes, and gets heavier as
exp(GROWTH t).  With e = (cos psi, sin psi), psi = theta + TURN t, its velocity is u e + w and

    u' = g cos(psi) - GROWTH (u + w.e) - w'.e,     theta' = omega exp(-GROWTH t).
"""

import functools
import pickle

import numpy as np
import pytest
import scipy.integrate
import sympy as sp

import dalembert as dal

M, J, SLOPE, TURN, SWAY = 2.0, 0.75, 2.5, 0.7, 0.4
Q0 = np.array([0.1, -0.2, 0.3])
ORDERS = {"midpoint": 2, "leapfrog": 2, "leapfrog-suzuki4": 4, "leapfrog-kl6": 6}


def gravity(t):
    return SLOPE * (1 + np.sin(3 * t) / 2)


def velocity(u, omega, t, theta, sway):
    psi = theta + TURN * t
    return np.array([u * np.cos(psi) + sway * np.cos(2 * t), u * np.sin(psi), omega])


def exact(t_end, growth, sway, u=1.1, omega=-0.4, t0=0.0):
    """Return (q, v, lambda) by the reduced equation."""

    def rates(t, state):
        u, _, _, theta = state
        psi, w = theta + TURN * t, sway * np.cos(2 * t)
        push = -2 * sway * np.sin(2 * t)
        du = gravity(t) * np.cos(psi) - growth * (u + w * np.cos(psi)) - push * np.cos(psi)
        turns = omega * np.exp(-growth * (t - t0))
        return [du, u * np.cos(psi) + w, u * np.sin(psi), turns]

    found = scipy.integrate.solve_ivp(
        rates, (t0, t_end), [u, *Q0], method="DOP853", rtol=3e-14, atol=3e-14
    )
    u, *q = found.y[:, -1]
    turns = omega * np.exp(-growth * (t_end - t0))
    v = velocity(u, turns, t_end, q[2], sway)
    psi, w, push = q[2] + TURN * t_end, sway * np.cos(2 * t_end), -2 * sway * np.sin(2 * t_end)
    normal = np.sin(psi)
    reaction = M * np.exp(growth * t_end) * (
        push * normal + growth * w * normal - u * (turns + TURN) - gravity(t_end) * normal
    )
    return np.array(q), v, reaction


def start(sway, t0=0.0, growth=0.0):
    return Q0, velocity(1.1, -0.4, t0, Q0[2], sway)


@functools.cache
def of_expressions(growth=0.0, sway=SWAY):
    """Return the skate from SymPy; what is 0 of growth and sway leaves the formulas."""
    t = dal.time
    x, y, theta = dal.coordinates("x y theta")
    psi = theta + TURN * t
    g = SLOPE * (1 + sp.sin(3 * t) / 2)
    L = M * (x.d**2 + y.d**2) / 2 + J * theta.d**2 / 2 + M * g * x
    phi = sp.sin(psi) * (x.d - sway * sp.cos(2 * t)) - sp.cos(psi) * y.d
    return dal.System.from_sympy(sp.exp(growth * t) * L if growth else L, [phi])


class Functions:
    """The same as Python functions."""

    def __init__(self, growth=0.0, sway=SWAY):
        self.growth, self.sway = growth, sway

    def mu(self, t, q):
        psi = q[2] + TURN * t
        return [[np.sin(psi), -np.cos(psi), 0]]

    def mu_v_q(self, t, q, v):
        psi = q[2] + TURN * t
        return [[0, 0, np.cos(psi) * v[0] + np.sin(psi) * v[1]]]

    def affine(self, t, q):
        return [-np.sin(q[2] + TURN * t) * self.sway * np.cos(2 * t)]

    def affine_derivative(self, t, q):
        return [[0, 0, -np.cos(q[2] + TURN * t) * self.sway * np.cos(2 * t)]]

    def constraint(self, t, q, v):
        return np.array(self.mu(t, q)) @ v + self.affine(t, q)

    def constraint_v(self, t, q, v):
        return self.mu(t, q)

    def constraint_q(self, t, q, v):
        return np.add(self.mu_v_q(t, q, v), self.affine_derivative(t, q))

    def constraint_t(self, t, q, v):
        psi, w = q[2] + TURN * t, self.sway * np.cos(2 * t)
        turned = TURN * (np.cos(psi) * (v[0] - w) + np.sin(psi) * v[1])
        return [turned + np.sin(psi) * self.sway * 2 * np.sin(2 * t)]

    def potential(self, t, q):
        return -M * gravity(t) * q[0]

    def gradient(self, t, q):
        return [-M * gravity(t), 0, 0]

    def hessian(self, t, q):
        return np.zeros((3, 3))

    def lagrangian(self, t, q, v):
        kinetic = M * (v[0] ** 2 + v[1] ** 2) / 2 + J * v[2] ** 2 / 2
        return np.exp(self.growth * t) * (kinetic - self.potential(t, q))

    def lagrangian_q(self, t, q, v):
        return -np.exp(self.growth * t) * np.array(self.gradient(t, q))

    def lagrangian_v(self, t, q, v):
        return np.exp(self.growth * t) * np.array([M, M, J]) * v

    def lagrangian_qq(self, t, q, v):
        return np.zeros((3, 3))

    def lagrangian_vq(self, t, q, v):
        return np.zeros((3, 3))

    def lagrangian_vv(self, t, q, v):
        return np.exp(self.growth * t) * np.diag([M, M, J])

    def lagrangian_vt(self, t, q, v):
        return self.growth * self.lagrangian_v(t, q, v)

    LINEAR = ("mu", "mu_v_q", "constraint_t")
    AFFINE = (*LINEAR, "affine", "affine_derivative")
    NONLINEAR = ("constraint", "constraint_v", "constraint_q", "constraint_t")
    SIMPLE = ("potential", "gradient", "hessian")
    GENERAL = ("lagrangian", *(f"lagrangian_{x}" for x in ("q", "v", "qq", "vq", "vv", "vt")))

    def system(self, *names, **others):
        given = {name: getattr(self, name) for name in names}
        if "lagrangian" not in names:
            given["mass"] = [M, M, J]
        return dal.System(n=3, m=1, time_dependent=True, **{**given, **others})


EVERY = {
    "expressions": (0.0, SWAY, lambda: of_expressions()),
    "expressions, linear": (0.0, 0.0, lambda: of_expressions(sway=0)),
    "expressions, general": (0.3, SWAY, lambda: of_expressions(0.3)),
    "linear": (0.0, 0.0, lambda: Functions(0, 0).system(*Functions.LINEAR, *Functions.SIMPLE)),
    "affine": (0.0, SWAY, lambda: Functions().system(*Functions.AFFINE, *Functions.SIMPLE)),
    "nonlinear": (0.0, SWAY, lambda: Functions().system(*Functions.NONLINEAR, "potential")),
    "general": (0.3, SWAY, lambda: Functions(0.3).system(*Functions.AFFINE, *Functions.GENERAL)),
    "differences": (
        0.3, SWAY, lambda: Functions(0.3).system("mu", "affine", *Functions.GENERAL[:3])
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", EVERY)
def test_orders_and_D(name):
    """Orders of q, v and lambda; D(t) to roundoff in every state."""
    growth, sway, make = EVERY[name]
    system, fast = make(), name.startswith("expressions")
    assert system.is_time_dependent and not system.conserves_energy
    assert "depends on time" in repr(system)
    q1, v1, reaction = exact(1.0, growth, sway)
    schemes = ORDERS if fast else {"midpoint": 2}
    for scheme, order in schemes.items():
        h = 0.02 if order < 4 else 0.1 if order < 6 else 0.2
        errors = []
        for size in (h, h / 2):
            run = dal.integrate(system, scheme, *start(sway), h=size, t_end=1.0)
            assert run.residual.max() <= 12 * 2**-53
            assert abs(system.residual(run.q, run.v, t=run.t)).max() < 1e-14
            errors.append([
                abs(run.q[-1] - q1).max(), abs(run.v[-1] - v1).max(),
                abs(run.multipliers[-1, 0] - reaction),
            ])  # fmt: skip
        floor = 1e-10 if system.differenced else 1e-12
        for coarse, fine in zip(*errors):
            assert np.log2(coarse / fine) > order - 0.3 or fine < floor, (scheme, errors)


def test_all_ways_are_the_same(request):
    """Expressions, functions and functions of expressions have the same numbers."""
    growth, t0 = 0.3, 0.8
    one = of_expressions(growth)
    request.getfixturevalue("in_python")
    others = [
        Functions(growth).system(*Functions.AFFINE, *Functions.GENERAL),
        Functions(growth).system(*Functions.NONLINEAR, *Functions.GENERAL),
        of_expressions.__wrapped__(growth),
    ]
    generator = np.random.default_rng(5)
    q, v = generator.normal(size=(2, 20, 3))
    t = generator.uniform(-1, 2, 20)
    q0, v0 = start(SWAY, t0)
    run = dal.integrate(one, "midpoint", q0, v0, t0=t0, h=0.05, steps=20)
    for other in others:
        for what in (
            "energy", "residual", "multipliers", "acceleration", "field", "gram", "metric"
        ):
            found = [getattr(each, what)(q, v, t=t) for each in (one, other)]
            np.testing.assert_allclose(*found, rtol=1e-12, atol=1e-12)
        single = [one.multipliers(a, b, t=c) for a, b, c in zip(q, v, t)]
        np.testing.assert_array_equal(single, one.multipliers(q, v, t=t))
        found = [each.consistent(q, v, keep=2, t=t) for each in (one, other)]
        np.testing.assert_allclose(*found, rtol=1e-12, atol=1e-12)
        again = dal.integrate(other, "midpoint", q0, v0, t0=t0, h=0.05, steps=20)
        np.testing.assert_allclose(again.x, run.x, rtol=1e-11, atol=1e-11)


def test_quantities_of_a_run():
    """Rows are evaluated at their own times, evenly spaced or not."""
    system = of_expressions(0.3)
    plain = dal.integrate(system, "leapfrog", *start(SWAY), h=0.05, t_end=1)
    at = np.array([0.0, 0.13, 0.5, 0.99])
    timed = dal.integrate(system, "leapfrog", *start(SWAY), h=0.05, t_end=1, t_eval=at)
    for run in (plain, timed):
        assert run.residual.max() <= 12 * 2**-53
        for k in (1, 2, -1):
            E = np.exp(0.3 * run.t[k])
            q, v = run.q[k], run.v[k]
            kinetic = (M * (v[:2] @ v[:2]) + J * v[2] ** 2) / 2
            energy = E * (kinetic - M * gravity(run.t[k]) * q[0])
            np.testing.assert_allclose(run.energy[k], energy, rtol=1e-13)
    state = plain(0.333)
    assert system.relative_residual(state.q, state.v, t=0.333) < 1e-15
    some = dal.integrate(system, "leapfrog", *start(SWAY), h=0.05, steps=200, stride=5)
    every = dal.integrate(system, "leapfrog", *start(SWAY), h=0.05, steps=200)
    for name in ("energy", "residual", "multipliers"):
        np.testing.assert_array_equal(getattr(some, name), getattr(every, name)[::5])


def test_stepper_and_events():
    """Steps by hand and events know what time it is."""
    system = of_expressions(0.3)
    q0, v0 = start(SWAY, 0.4)
    stepper = dal.Stepper(system, "leapfrog", q0, v0, h=0.05, t0=0.4)
    stepper.step(steps=7)
    run = dal.integrate(system, "leapfrog", q0, v0, h=0.05, t0=0.4, steps=7)
    assert np.array_equal(stepper.x, run.x[-1])
    assert stepper.energy == run.energy[-1] and stepper.residual <= 12 * 2**-53
    x = dal.coordinates("x y theta")[0]
    events = [dal.time - sp.Rational(1, 2), x * sp.cos(dal.time) - 0.3]
    run = dal.integrate(system, "leapfrog-kl6", q0, v0, h=0.05, t0=0.4, steps=20, events=events)
    assert run.t_events[0] == pytest.approx([0.5], abs=1e-15)
    assert len(run.t_events[1]) > 0
    for t, q, v in zip(run.t_events[1], run.q_events[1], run.v_events[1]):
        assert q[0] * np.cos(t) == pytest.approx(0.3, abs=1e-14)
        assert system.relative_residual(q, v, t=t) < 1e-15


def test_initial_data_are_those_of_their_time():
    system = of_expressions()
    q0, v0 = start(SWAY, 1.0)
    with pytest.raises(dal.NotOnConstraintError):
        dal.integrate(system, q0=q0, v0=v0, h=0.1, steps=1)
    assert dal.integrate(system, q0=q0, v0=v0, h=0.1, steps=1, t0=1.0).success
    np.testing.assert_allclose(system.project(q0, v0 + 1, t=1.0) @ [0, 0, 1], v0[2] + 1)
    run = dal.integrate(system, q0=q0, v0=v0, h=0.1, steps=1, consistent="project")
    assert abs(system.residual(*np.split(run.x[0], 2), t=0.0)).max() < 1e-15


def test_kept_nodes_and_deformations():
    functions = Functions(0, 0)
    system = functions.system(*Functions.LINEAR)
    q0, v0 = Q0, velocity(1.1, -0.4, 0, Q0[2], 0)
    run = dal.integrate(system, "midpoint-nodes", q0, v0, h=0.05, steps=20, initial="shift")
    assert run.residual.max() <= 12 * 2**-53
    # a blade that is deformed into the one on a floor that moves
    bent = [
        system.deformed(
            functions_g.affine, 1.0, g_v=lambda t, q, v: np.zeros((1, 3)),
            g_q=lambda t, q, v: functions_g.affine_derivative(t, q), kind="affine", **more,
        )
        for functions_g in [_Floor()]
        for more in ({}, {"g_t": functions_g.time_derivative})
    ]  # fmt: skip
    same = of_expressions()
    for deformed in bent:
        assert deformed.is_time_dependent
        found = [
            each.multipliers(Q0, velocity(1.1, -0.4, 0.7, Q0[2], SWAY), t=0.7)
            for each in (deformed, dal.System(
                mass=[M, M, J], m=1, time_dependent=True,
                **{x: getattr(Functions(), x) for x in Functions.AFFINE},
            ))
        ]  # fmt: skip
        np.testing.assert_allclose(*found, rtol=1e-10)
    assert "constraint_t" in bent[0].differenced and "constraint_t" not in bent[1].differenced
    with pytest.raises(ValueError, match="g_t is given, but the system does not depend on time"):
        dal.systems.particle().deformed(
            lambda q, v: [0], 1.0, g_v=lambda q, v: [[0, 0, 0]], g_t=lambda t, q, v: [0]
        )
    assert same.is_time_dependent


class _Floor(Functions):
    """What the motion of the floor adds to the constraint."""

    def affine(self, t, q, v=None):
        return super().affine(t, q)

    def time_derivative(self, t, q, v):
        psi = q[2] + TURN * t
        w, push = self.sway * np.cos(2 * t), -2 * self.sway * np.sin(2 * t)
        return [-TURN * np.cos(psi) * w - np.sin(psi) * push]


def test_the_check_sees_what_is_wrong():
    good = Functions(0.3)
    assert good.system(*Functions.AFFINE, *Functions.GENERAL).check(*start(SWAY), t=0.0)
    for name in ("constraint_t", "lagrangian_vt"):
        wrong = Functions(0.3)
        right = getattr(wrong, name)
        setattr(wrong, name, lambda t, q, v, right=right: np.array(right(t, q, v)) + 0.01)
        found = wrong.system(*Functions.AFFINE, *Functions.GENERAL).check(*start(SWAY))
        assert not found and name in found.text
    assert "constraint_t (phi_t)" in str(found)


def test_growth_is_not_sought():
    """D(t) may be integrable at each time without a function that it keeps."""
    found = of_expressions(sway=0).check(Q0, velocity(1.1, -0.4, 0, Q0[2], 0))
    assert found and found.growth is None and found.holonomic == ()


def test_discrete_mechanics_take_the_time():
    system, t = of_expressions(), 0.6
    discrete = dal.Discrete(system)
    q, v = start(SWAY, t)
    pair = discrete.nodes(0.1, q, v, t=t)
    assert abs(discrete.constraint(0.1, *pair, t=t)).max() < 1e-14
    assert abs(discrete.constraint(0.1, *pair)).max() > 0.1
    assert discrete.lagrangian(0.1, *pair, t=t) != discrete.lagrangian(0.1, *pair)
    for name in ("lagrangian_derivatives", "constraint_derivatives"):
        one, other = (getattr(discrete, name)(0.1, *pair, t=each) for each in (t, 0.0))
        assert any(abs(a - b).max() > 1e-3 for a, b in zip(one, other))
    after = discrete.advance(0.1, q, v, t=t)
    run = dal.integrate(system, "midpoint", q, v, h=0.1, steps=1, t0=t)
    np.testing.assert_allclose(np.concatenate(after[:2]), run.x[1], rtol=0, atol=1e-13)
    with pytest.raises(ValueError, match="does not depend on time for an embedding"):
        dal.embedding(system, "midpoint", h=0.1, q0=q, v0=v)


def test_it_pickles_and_becomes_c():
    system = of_expressions(0.3)
    q0, v0 = start(SWAY)
    run = dal.integrate(system, q0=q0, v0=v0, h=0.05, steps=10)
    again = dal.integrate(pickle.loads(pickle.dumps(system)), q0=q0, v0=v0, h=0.05, steps=10)
    assert np.array_equal(run.x, again.x)
    assert pickle.loads(pickle.dumps(dal.time)) == dal.time
    assert ".time_dependent = 1" in system.c_source("skate")
    assert ".time_dependent" not in dal.systems.steered_car().c_source("car")
    assert r"\varphi_t" in system._repr_latex_() and "L_{vt}" in system._repr_latex_()


def test_energy_is_not_called_an_invariant():
    run = dal.integrate(of_expressions(), q0=start(SWAY)[0], v0=start(SWAY)[1], h=0.1, steps=10)
    assert "energy change" in dal.plot.energy(run).get_ylabel()
    assert run.stats.jump_step == 0  # although it has changed by more than all of it
    assert np.ptp(run.energy) > abs(run.energy[0]) / 2


def test_invariants_take_the_time(in_python):
    x = dal.coordinates("x")[0]
    t = dal.time
    falling = dal.System.from_sympy(
        x.d**2 / 2 + x * sp.cos(t), invariants={"p": x.d - sp.sin(t)}, exact=None
    )
    own = dal.System(
        mass=1, n=1, potential=lambda t, q: -q[0] * np.cos(t), time_dependent=True,
        invariants={"p": lambda t, q, v: v[0] - np.sin(t)},
    )  # fmt: skip
    for system in (falling, own):
        run = dal.integrate(system, "leapfrog-kl6", [0], [1], h=0.1, t_end=5)
        p = system.invariant(run.q, run.v, run.t)["p"]
        assert abs(p - 1).max() < 1e-8
        assert system.invariant([0.0], [2.0], t=1.0)["p"] == pytest.approx(2 - np.sin(1))


# ---- symbols and what is refused -----------------------------------------------------------------


def test_symbols_of_the_time(in_python):
    """dalembert.time everywhere; a symbol t only where it cannot be a forgotten parameter."""
    x, y = dal.coordinates("x y")
    t, plain = dal.time, sp.Symbol("t")
    L = (x.d**2 + y.d**2) / 2
    assert t != plain and t != sp.Symbol("t", real=True)
    timed = dal.System.from_sympy(L, [y.d - sp.sin(t) * x.d])
    assert timed.multipliers([0, 0], [1, 0], t=0) == pytest.approx([1.0])
    with pytest.raises(ValueError, match=r"constraints\[0\]: unknown symbol t.* dalembert.time"):
        dal.System.from_sympy(L, [y.d - sp.sin(plain) * x.d])
    with pytest.raises(ValueError, match="L: unknown symbol t"):
        dal.System.from_sympy(L - plain * x)
    with pytest.raises(ValueError, match="may not depend on time"):
        dal.System.from_sympy(L, q0=[t, 0], v0=[0, 0])
    with pytest.raises(ValueError, match="may not depend on time"):
        dal.System.from_sympy(L, invariants={"p": x.d - t})
    # a parameter called t, and the time, are two things
    both = dal.System.from_sympy(L - plain * t * x, parameters={plain: 3})
    assert both.acceleration([0, 0], [0, 0], t=2).tolist() == [-6, 0]
    real = sp.Symbol("t", real=True)
    steady = dal.System.from_sympy(L - real * x, parameters={real: 3})
    assert not steady.is_time_dependent
    assert steady.acceleration([0, 0], [0, 0]).tolist() == [-3, 0]
    forced = dal.System.from_sympy(L, force={x: t, y: plain})
    assert not forced.is_time_dependent
    assert forced.acceleration([0, 0], [0, 0], t=2).tolist() == [2, 2]


def test_dynamicsymbols(in_python):
    from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

    x, y = dynamicsymbols("x y")
    t = dynamicsymbols._t
    system = dal.System.from_sympy(
        (x.diff(t) ** 2 + y.diff(t) ** 2) / 2, [y.diff(t) - sp.sin(t) * x.diff(t) - dal.time]
    )
    assert system.is_time_dependent and system.kind == "affine"
    assert system.residual([0, 0], [2, 0], t=1.5) == pytest.approx([-2 * np.sin(1.5) - 1.5])
    method = LagrangesMethod(
        x.diff(t) ** 2 / 2 + y.diff(t) ** 2 / 2, [x, y],
        nonhol_coneqs=[y.diff(t) - sp.sin(t) * x.diff(t)],
    )  # fmt: skip
    assert dal.System.from_lagranges_method(method).is_time_dependent


def test_a_system_whose_time_cancels_is_none_of_it(in_python):
    x, y = dal.coordinates("x y")
    t = dal.time
    L = (x.d**2 + y.d**2) / 2 + sp.sin(t) - sp.sin(t)
    assert not dal.System.from_sympy(L).is_time_dependent


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"mu": lambda q: [[1, 0]]}, r"mu is a function of \(q\): expected a function"),
        ({"potential": lambda q: 0.0}, r"potential is a function of .* \(t, q\)"),
        ({"gradient": lambda t, q: [0, 0]}, r"gradient is given without potential\(t, q\) -> V"),
        ({"constraint_t": lambda t, q, v: [0]}, "constraint_t is given without mu"),
        ({"lagrangian_vt": lambda t, q, v: [0, 0]}, r"without lagrangian\(t, q, v\)"),
        ({"invariants": {"p": lambda q, v: 0.0}}, r"p is a function of \(q, v\)"),
        ({"mu": lambda t, q: [[1, 0]], "steady": True}, "steady"),
        *(
            ({x: lambda t, q, v: [0], "time_dependent": False}, f"{x} is .*: expected time_dep")
            for x in ("constraint_t", "lagrangian_vt")
        ),
    ],
)
def test_bad_arguments(given, text):
    with pytest.raises(ValueError, match=text):
        dal.System(**{"mass": [1, 1], "time_dependent": True, **given})


def test_times_of_states():
    system = of_expressions()
    with pytest.raises(ValueError, match=r"t: expected shape \(\) \(a number\) or \(2,\)"):
        system.energy(np.zeros((2, 3)), np.zeros((2, 3)), t=[1, 2, 3])
    with pytest.raises(ValueError, match="t: expected shape"):
        system.multipliers(np.zeros(3), np.zeros(3), t=[1.0])
