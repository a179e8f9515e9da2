"""The scheme "taylor": the flow of the ODE on D by the series of a model."""

import functools
import math
import os
import pickle
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import sympy as sp

import dalembert as dal
from dalembert import core
from dalembert.core import ffi

x, y, z, w = dal.coordinates("x y z w")
t, n = dal.time, sp.Symbol("n")
F, T = sp.symbols("F T")


def free(V, force=None, **more):
    """Return a particle in the plane with a potential."""
    return dal.System.from_sympy((x.d**2 + y.d**2) / 2 - V, [], force=force, **more)


def skate(**more):
    return dal.System.from_sympy(
        (x.d**2 + y.d**2 + z.d**2) / 2 - x / 2, [-sp.sin(z) * x.d + sp.cos(z) * y.d],
        q0=[0, 0, 0.3], v0=[np.cos(0.3), np.sin(0.3), 1], **more,
    )  # fmt: skip


OWN = {
    "affine": (dal.System.from_sympy, (x.d**2 + y.d**2 + z.d**2) / 2, [z.d - y * x.d - sp.sin(t)]),
    "mass": (
        dal.System.from_sympy,
        (x.d**2 + 2 * y.d**2 + z.d**2 * (1 + x**2) + x.d * z.d * sp.sin(y)) / 2
        - x * y * z * sp.cos(t),
        [z.d - y * x.d - sp.sin(t * x)], {x: -x.d * y, y: sp.sin(t)},
    ),
    "nonlinear": (
        dal.System.from_sympy,
        (x.d**2 + y.d**2 + z.d**2 * (2 + sp.sin(t))) / 2 + t * x.d * y - z,
        [x.d**2 + y.d**2 - z.d**2 - 1],
    ),
    "power": (
        functools.partial(dal.System.from_sympy, parameters={n: 2.5}),
        (x.d**2 + y.d**2) / 2 - (2 + x**2) ** n * (1 + y**2) / 9, [],
    ),
    "no freedom": (
        dal.System.from_sympy, (x.d**2 + y.d**2) / 2, [x.d - y * sp.cos(t), y.d + x]
    ),
    "two": (
        dal.System.from_sympy,
        (x.d**2 + y.d**2 + z.d**2 + w.d**2 + x.d * y.d) / 2 - (1 + x**2) ** sp.Rational(3, 2) / w,
        [x.d - y * z.d, w.d - sp.sin(x) * z.d + y.d],
    ),
}  # fmt: skip
START = np.array([0.1, 0.2, 0.3, 0.9]), np.array([1.0, 0.5, 0.3, 0.2])


def own(name):
    """Return a system with other parts than those of the catalogue, and its initial data."""
    make, L, constraints, *force = OWN[name]
    system = make(L, constraints, force=force[0] if force else None)
    return system, START[0][: system.n], START[1][: system.n]


@pytest.mark.parametrize("name", ["two_wheeled_robot", "steered_car", *OWN])
def test_agrees_with_the_reference(name):
    system, q0, v0 = own(name) if name in OWN else (dal.systems.get(name), None, None)
    given = {"h": 0.1, "t_end": 3, "consistent": "project"}
    run = dal.integrate(system, "taylor", q0, v0, **given)
    other = dal.integrate(system, "reference", q0, v0, tolerance=1e-14, **given)
    np.testing.assert_allclose(run.x, other.x, rtol=0, atol=1e-12 * abs(other.x).max())
    assert (run.t == other.t).all() and run.success and run.message == other.message
    assert run.residual[1:].max() <= run.stats.worst_residual <= 4 * system.n * 2.0**-53
    assert 0 < run.stats.evaluations < other.stats.evaluations
    back = dal.integrate(system, q0=run.q[-1], v0=run.v[-1], h=-0.1, t0=3, t_end=0,
                         scheme="taylor")  # fmt: skip
    np.testing.assert_allclose(back.x[-1], run.x[0], rtol=0, atol=1e-11)


A, B = sp.Rational(3, 10), sp.Symbol("s")


@functools.cache
def exact_skate(s):
    """Return (q, v) at s of the skate, from (0, 0, 0.3) with speed 1: it is c - sin(theta)/2."""
    theta, c = A + B, 1 + sp.sin(A) / 2
    speed = c - sp.sin(theta) / 2
    along = speed * sp.cos(theta), speed * sp.sin(theta)
    q = *(sp.integrate(sp.expand(e.rewrite(sp.exp)), (B, 0, B)) for e in along), theta
    numbers = [sp.N(e.subs(B, s), 30, maxn=500) for e in (*q, *along, sp.Integer(1))]
    return np.array([float(sp.re(e)) for e in numbers])


def test_exact_at_a_late_time():
    """An angle of 16 turns: its sine is that of the angle, not of its rounding."""
    for h in (100.0, 0.5):
        run = dal.integrate(skate(), "taylor", h=h, t_end=100)
        np.testing.assert_allclose(run.x[-1], exact_skate(100), rtol=0, atol=3e-13)
    run = dal.integrate(skate(), t_end=100)
    np.testing.assert_allclose(run.x[-1], exact_skate(100), rtol=0, atol=3e-13)


def test_the_sine_of_a_large_angle():
    """At 1e8 an angle is rounded by 1e-8, which acts like a force if its rest is dropped."""
    far = 2.0**26
    near, there = (
        dal.integrate(
            dal.System.from_sympy(
                (x.d**2 + y.d**2) / 2 - sp.cos(x - offset) * sp.Rational(1, 3), []
            ),
            "taylor", [offset + 0.5, 0], [0.7, 0], h=1.0, t_end=200,
        ) for offset in (0.0, far)
    )  # fmt: skip
    np.testing.assert_allclose(there.v, near.v, rtol=0, atol=2e-7)
    drift = abs(there.energy - there.energy[0])
    assert drift.max() < 4 * np.spacing(far) and near.energy.std() < 3e-15


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9, 1e-12])
def test_the_error_is_about_the_tolerance(tolerance):
    run = dal.integrate(skate(), "taylor", h=100.0, t_end=100, tolerance=tolerance)
    error = abs(run.x[-1] - exact_skate(100)).max()
    assert error < 1000 * tolerance  # the speed is off by that of a step, for a time of 100
    finer = dal.integrate(skate(), "taylor", h=100.0, t_end=100, tolerance=tolerance / 1000)
    assert abs(finer.x[-1] - exact_skate(100)).max() < max(0.1 * error, 3e-13)


def test_energy_over_a_long_time():
    """Without bias the energy walks at random: 2e4 time units, some 1e4 steps."""
    springs = dal.System.from_sympy(
        (x.d**2 + y.d**2 + z.d**2) / 2 - x**2 / 2 - y**2 - 3 * z**2 / 4, [z.d - y * x.d],
        q0=[1, 0, 0.5], v0=[0, 1, 0],
    )  # fmt: skip
    run = dal.integrate(springs, "taylor", h=1000.0, t_end=20000)
    assert abs(run.energy - run.energy[0]).max() < 5e-14
    assert run.stats.worst_residual <= 4 * 3 * 2.0**-53


# ---- steps of its own size -----------------------------------------------------------------------


def test_energy_after_a_late_time():
    """The square of s is not rounded to one side where times are multiples of 2^-26."""
    run = dal.integrate(skate(), "taylor", t0=1e8, h=1e5, steps=6, check_h=False)
    assert abs(run.energy - run.energy[0]).max() < 3e-13


def test_without_h():
    """Without h a model takes its series, and other systems the reference flow."""
    run = dal.integrate(skate(), t_end=20)
    assert run.scheme.name == "taylor" and run.control == {"h": "own"}
    assert run.t[0] == 0 and run.t[-1] == 20 and len(run.t) < 20
    assert run.stats.steps == len(run.t) - 1
    np.testing.assert_allclose(run.x[-1], exact_skate(20), rtol=0, atol=1e-13)
    between = run(11.3)
    np.testing.assert_allclose([*between.q, *between.v], exact_skate(sp.Rational(113, 10)),
                               rtol=0, atol=1e-13)  # fmt: skip
    back = dal.integrate(skate(), q0=run.q[-1], v0=run.v[-1], t0=20, t_end=0)
    np.testing.assert_allclose(back.x[-1], run.x[0], rtol=0, atol=1e-12)
    assert (np.diff(back.t) < 0).all()
    few = dal.integrate(skate(), t_end=20, stride=4)
    assert (few.t[:-1] == run.t[::4][: len(few.t) - 1]).all() and few.t[-1] == 20
    particle = dal.systems.particle()
    with pytest.raises(NotImplementedError, match='"reference" has no steps of its own size'):
        dal.integrate(particle, t_end=5, method="msadams")
    for method in ("rk8pd", "rodas"):
        other = dal.integrate(particle, t_end=5, method=method, tolerance=1e-10)
        assert other.scheme.name == "reference" and other.t[-1] == 5 and len(other.t) > 10
        np.testing.assert_allclose(other.q[-1], particle.exact(5.0)[0], rtol=0, atol=1e-8)


def test_the_reference_without_h_knows_the_time():
    """Each of its own steps begins at a time of its own."""
    pushed = dal.System(mass=[1.0], force=lambda t, q, v: [np.sin(t)], q0=[0], v0=[0])
    run = dal.integrate(pushed, t_end=5)
    np.testing.assert_allclose(run.q[:, 0], run.t - np.sin(run.t), rtol=0, atol=1e-13)


def test_output_times():
    times = [0, 0.5, 0.5, 1.234, 2]
    run = dal.integrate(skate(), t_end=2, t_eval=times)
    assert (run.t == times).all()
    for row, s in zip(run.x, times):
        np.testing.assert_allclose(row, exact_skate(sp.nsimplify(s)), rtol=0, atol=1e-14)


def test_what_does_not_go_together():
    for given, words in (
        ({"scheme": "midpoint", "t_end": 1}, "h is missing, or 'own', with the scheme 'midpoint'"),
        ({"scheme": "taylor", "h": "auto", "t_end": 1}, "h = 'auto' with the scheme 'taylor'"),
        ({"t_end": 1, "steps": 3}, "steps = 3: not used with h = 'own'"),
        ({}, "t_end is missing"),
        ({"scheme": "taylor", "method": "rk8pd", "t_end": 1}, "method = 'rk8pd': not used with"),
        ({"scheme": "taylor", "tolerance": 0.5, "t_end": 1}, "tolerance = 0.5"),
        ({"t_end": 1, "energy": "keep"}, "energy = 'keep': not used with h = 'own'"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=words):
            dal.integrate(skate(), **given)
    plain = dal.System(
        mass=[1.0], potential=lambda q: q[0] ** 2 / 2, gradient=lambda q: q, q0=[1], v0=[0]
    )
    with pytest.raises(NotImplementedError, match="has no Taylor series, which come from its expr"):
        dal.integrate(plain, "taylor", t_end=1)


def test_systems_in_c():
    """Their series come from their formulas."""
    particle = dal.systems.particle()
    run = dal.integrate(particle, "taylor", t_end=10)
    np.testing.assert_allclose(run.q[-1], particle.exact(10.0)[0], rtol=0, atol=1e-13)
    assert run.system is particle and run.residual.max() < 1e-15


def test_stepper():
    stepper = dal.Stepper(skate(), "taylor")
    stepper.step()
    first = dal.integrate(skate(), t_end=20)
    assert stepper.t == first.t[1] and (stepper.q == first.q[1]).all()
    stepper.until(20)
    assert stepper.t == 20
    np.testing.assert_allclose(stepper.q, exact_skate(20)[:3], rtol=0, atol=1e-13)
    options = ffi.new("dal_options *", {"own_steps": 1})
    pair, system = dal.Scheme.pair(0.5), skate()
    with pytest.raises(NotImplementedError, match='"pair:.*has no steps of its own size'):
        core.make("stepper", system._handle, pair._record, options, owner=system._handle)


# ---- inputs, events, saved states ----------------------------------------------------------------


def steered(driven=False):
    constraints = [y.d - sp.tan(z) * x.d, *([z.d - T] if driven else [])]
    force = {} if driven else {"force": {x: F, z: T}}
    return dal.System.from_sympy(
        (x.d**2 + y.d**2 + z.d**2) / 2 - x**2 / 9, constraints, q0=[0, 0, 0.1],
        v0=[1, np.tan(0.1), 0], inputs=[T] if driven else [F, T], **force,
    )  # fmt: skip


@pytest.mark.parametrize("driven", [False, True])
def test_inputs(driven):
    """Steps end where inputs change; a constraint with inputs moves the velocity."""
    rows = np.random.default_rng(0).normal(size=(50, 2))[:, : 1 if driven else 2]
    given = {"h": 0.02, "t_end": 1, "inputs": rows, "consistent": "project"}
    run = dal.integrate(steered(driven), "taylor", **given)
    other = dal.integrate(steered(driven), "reference", tolerance=1e-14, **given)
    np.testing.assert_allclose(run.x, other.x, rtol=0, atol=1e-14)
    alone = dal.integrate(steered(driven), t_end=1, inputs=rows, hold=0.02, consistent="project")
    np.testing.assert_allclose(alone.x[-1], other.x[-1], rtol=0, atol=1e-14)
    constant = dal.integrate(steered(driven), t_end=1, inputs=rows[0], consistent="project")
    assert len(constant.t) < 10


def test_events():
    def wall(t, q, v):
        return q[0] - 0.5

    wall.terminal = True
    run = dal.integrate(skate(), t_end=20, events=[wall])
    assert run.status == 1 and abs(run.q[-1, 0] - 0.5) < 1e-14 and len(run.t_events[0]) == 1
    exact = exact_skate(sp.nsimplify(float(run.t[-1])))
    np.testing.assert_allclose(run.x[-1], exact, rtol=0, atol=1e-13)


@pytest.mark.parametrize("speed, given", [(3, {}), (1.7, {"h": 0.1}), (10, {"h": 0.01})])
def test_bounces_between_walls(speed, given):
    """The steps that a run chooses end at a reset, late where t is rounded coarsely."""
    free = dal.System.from_sympy(x.d**2 / 2, [], coordinates=[x])
    walls = [dal.Event(x - 1, direction=1, reset={x.d: -x.d}),
             dal.Event(x + 1, direction=-1, reset={x.d: -x.d})]  # fmt: skip
    run = dal.integrate(free, "taylor", [0], [speed], t_end=100, events=walls, **given)
    expected = (1 + 2 * np.arange(50 * speed)) / speed
    np.testing.assert_allclose(np.sort(np.concatenate(run.t_events)), expected, atol=1e-11)
    assert len(run.t) < 10 * len(expected) + 101 / given.get("h", 1)


@pytest.mark.parametrize("given", [{}, {"h": 2.0}, {"h": 2.0, "t_eval": [3, 19]}])
def test_states_between_rows(given):
    """They are as exact as the rows, in any order, and in D."""
    run = dal.integrate(skate(), "taylor", t_end=20, **given)
    times = np.random.default_rng(1).uniform(3, 19, 50)
    found = run(times)
    order = np.argsort(times)
    exact = dal.integrate(skate(), t_end=20, t_eval=times[order])
    np.testing.assert_allclose(found.q[order], exact.q, rtol=0, atol=1e-14)
    assert run.system.relative_residual(found.q, found.v).max() < 4e-16
    for t, q in zip(times[:3], found.q):
        assert (run(t).q == q).all()


def test_the_next_double():
    run = dal.integrate(skate(), t_end=20)
    for i in (1, 3, -2):
        assert abs(run(np.nextafter(run.t[i], 9)).q - run.q[i]).max() < 1e-14


def test_events_in_long_steps():
    """A step may be half an oscillation; with functions as events it is made in parts."""
    oscillator = free(x**2 / 2)
    for g, count in ((x**2 - sp.Rational(1, 2), 64), (sp.sin(5 * t), 159), (x * x.d - 0.4, 64)):
        for event in (g, sp.lambdify((t, (x, y), (x.d, y.d)), g)):
            run = dal.integrate(oscillator, q0=[0, 0], v0=[1, 0], t_end=100, events=[event])
            assert len(run.t_events[0]) == count
    assert run.control["parts"] == 16


@pytest.mark.parametrize("sizes", [{}, {"h": 0.25}])
def test_journal(tmp_path, sizes):
    """A run that goes on from its journal has the bits of one that never ended."""
    contact = free(x + 50 * sp.Max(0, -x) ** 2)
    given = {"scheme": "taylor", "q0": [1, 0], "v0": [0.1, 1], **sizes}
    path = tmp_path / "run.dal"
    dal.integrate(contact, **given, t_end=5, journal=path)
    longer = dal.resume(path, contact, t_end=9)
    until = {} if sizes else {"t_eval": longer.t}
    whole = dal.integrate(contact, **given, t_end=9, **until)
    if sizes:
        np.testing.assert_array_equal(longer.x, whole.x)
    else:  # the step to t = 5 was cut
        np.testing.assert_allclose(longer.x, whole.x, rtol=0, atol=1e-13)


def test_saved_states():
    """At every state, in pieces and at their ends, on both sides of a switch."""
    contact = free(x + 50 * sp.Max(0, -x) ** 2)
    for sizes in ({}, {"h": 0.1}):
        one, other = (
            dal.Stepper(contact, "taylor", q0=[1, 0], v0=[0.1, 1], **sizes) for _ in range(2)
        )
        for _ in range(40):
            one.step()
            other.restore(one.save())
            for _ in range(2):
                other.step()
            saved = one.save()
            one.step(), one.step()
            assert (one.q == other.q).all() and (one.v == other.v).all() and one.t == other.t
            one.restore(saved)


def test_threads_and_pickles():
    def work(system):
        return dal.integrate(system, t_end=20).x

    system = skate()
    with ThreadPoolExecutor(4) as pool:
        one, *others = pool.map(work, [system] * 4)
    assert all((one == other).all() for other in others)
    scheme = dal.Scheme.taylor(1e-12)
    assert pickle.loads(pickle.dumps(scheme)) == scheme and scheme.tolerance == 1e-12
    run = dal.integrate(system, scheme, h=0.5, t_end=5)
    assert run.scheme == scheme and np.isnan(run.reactions).all()


def test_ensemble():
    speeds = np.linspace(0.5, 1.5, 5)
    v0 = np.outer(speeds, skate().v0)
    many = dal.ensemble(skate(), "taylor", v0=v0, q0=np.tile(skate().q0, (5, 1)), h=0.5, t_end=5)
    for k in range(5):
        run = dal.integrate(skate(), "taylor", skate().q0, v0[k], h=0.5, t_end=5)
        np.testing.assert_array_equal(np.r_[many.q[k], many.v[k]], run.x[-1])


def test_parameters_are_those_of_the_system():
    """One compilation serves all values; another run with the first ones is the same to the bit."""
    system = dal.systems.sleigh_with_rotor()
    name, value = next(iter(system.parameters.items()))
    other = system.with_parameters(**{name: 1.5 * value})
    runs = [dal.integrate(s, "taylor", h=0.5, t_end=5) for s in (system, other, system)]
    expected = dal.integrate(other, "reference", h=0.5, t_end=5)
    np.testing.assert_allclose(runs[1].x, expected.x, rtol=0, atol=1e-11)
    assert abs(runs[1].x - runs[0].x).max() > 1e-3
    np.testing.assert_array_equal(runs[2].x, runs[0].x)


def test_state_at_one_time():
    """dal.reference with method="taylor", and its accuracy, against the state to 30 digits."""
    known = dal.systems.known_states("cvt")[-1]
    for tolerance in (1e-6, 1e-15):
        found = dal.reference(dal.systems.cvt(), t=known.t, method="taylor", tolerance=tolerance)
        error = max(abs(found.q - [*map(float, known.q)]).max(),
                    abs(found.v - [*map(float, known.v)]).max())  # fmt: skip
        assert error <= 3 * found.accuracy + 1e-15
        assert found.accuracy < 1e3 * tolerance + 1e-13
    start = dal.reference(skate(), t=0, method="taylor")
    assert (start.q == skate().q0).all()
    with pytest.raises(NotImplementedError, match="coordinates: not supported by"):
        dal.reference(skate(), method="taylor", coordinates="xi")


# ---- walls and ends ------------------------------------------------------------------------------


@pytest.mark.parametrize("exponent", [sp.Rational(5, 2), sp.Rational(7, 2)])
@pytest.mark.parametrize("U, t_end", [(7 * x / 10, 3), (x**2 / 2, 3), (7 * x / 10, 7)])
def test_a_wall_is_not_passed_through(exponent, U, t_end):
    """A power has no series where its base is zero, so the piece there is examined inside."""
    wall = free(30 * sp.Max(0, x - 1) ** exponent + U)
    for q, v in ((0.77468268, 2.03669280), (0.80299298, 2.19006771), (0.0, 2.0)):
        run = dal.integrate(wall, "taylor", [q, 0], [v, 0], t_end=t_end)
        assert np.ptp(run.energy) < 1e-9
        known = dal.integrate(
            wall, "midpoint-kl8", [q, 0], [v, 0], h=t_end / 20000, t_end=t_end, check_h=False
        )
        np.testing.assert_allclose(run.q[-1], known.q[-1], rtol=0, atol=1e-6)


def test_saturated_functions():
    """A tanh far from zero hides the force that comes."""
    hill = dal.System.from_sympy(
        x.d**2 / 2 - sp.tanh(50 * ((x - 5) ** 2 - 1)) / 9, coordinates=[x]
    )
    for q, far in ((3.4, 9.73634871), (3.9, 10.23634871)):
        run = dal.integrate(hill, "taylor", [q], [1], t_end=6)
        assert abs(run.q[-1, 0] - far) < 1e-8
    brake = dal.System.from_sympy(
        x.d**2 / 2, force={x: -sp.tanh(40 * (x - 2)) + sp.tanh(40 * (x - 3))}, coordinates=[x]
    )
    assert abs(dal.integrate(brake, "taylor", [0], [3], t_end=6).v[-1, 0] - math.sqrt(5)) < 1e-12


def fall(s, height=1.0):
    """Return x at s in the potential |x|, from rest at a height: parabolas from turn to turn."""
    quarter = np.sqrt(2 * height)
    s = s % (4 * quarter)
    if s > 3 * quarter:
        return height - (s - 4 * quarter) ** 2 / 2
    return height - s**2 / 2 if s < quarter else (s - 2 * quarter) ** 2 / 2 - height


@pytest.mark.parametrize("v0, before", [(0.0, 0.0), (np.sqrt(2), 3 * np.sqrt(2))])
def test_a_kink(v0, before):
    """A step ends at the kink, to a rounding, and the next one has the other branch."""
    system = free(sp.Abs(x))
    for t_end in (50, -50):
        run = dal.integrate(system, q0=[fall(before), 0], v0=[v0, 1], t_end=t_end)
        expected = [fall(before + s) for s in run.t]
        np.testing.assert_allclose(run.q[:, 0], expected, rtol=0, atol=2e-13)
        assert len(run.t) < 60
    rest = dal.integrate(system, q0=[0, 0], v0=[0, 1], t_end=5)
    assert (rest.q[:, 0] == 0).all()


@pytest.mark.parametrize("exponent", [1, 2, 3, sp.Rational(3, 2), sp.Rational(5, 2)])
def test_a_contact(exponent):
    """A ball that bounces from a spring, whose force has a jump, a kink or a root."""
    system = free(x + 100 * sp.Max(0, -x) ** exponent)
    run = dal.integrate(system, q0=[1, 0], v0=[0, 1], t_end=20)
    assert abs(run.energy - run.energy[0]).max() < 1e-12
    down = run.t[(abs(run.q[:, 0]) < 1e-12) & (run.v[:, 0] < 0)]
    down = down[np.r_[True, np.diff(down) > 0.1]]
    assert len(down) > 3
    np.testing.assert_allclose(np.diff(down), down[1] - down[0], rtol=1e-10)
    inside = dal.integrate(system, q0=[1, 0], v0=[0, 1], t_end=2, t_eval=[down[0] + 0.01])
    assert inside.q[0, 0] < -0.005


def test_pieces():
    V = sp.Piecewise((x**2, x < 1), (2 * x - 1, (x >= 1) & (x < 2)), (x**2 / 2 + 1, True))
    run = dal.integrate(free(V), q0=[-2.2, 0], v0=[0, 1], t_end=30)
    assert abs(run.energy - run.energy[0]).max() < 3e-14
    assert run.q[:, 0].max() > 2


def test_the_sign_of_a_speed():
    """Coulomb's law brakes right until the speed is 0; then no step leads on."""
    system = free(0, force={x: -sp.sign(x.d)})
    with pytest.raises(dal.ConvergenceError, match="either side of the jump leads back") as caught:
        dal.integrate(system, q0=[1, 0], v0=[1, 1], t_end=20)
    assert abs(caught.value.t - 1) < 1e-15
    np.testing.assert_allclose(caught.value.partial.q[-1], [1.5, 1], rtol=0, atol=1e-15)


ENDS = {
    "a root": (free(sp.sqrt(x)), [1, 0], [-1, 0]),
    "a pole": (free(1 / x), [-1, 0], [1, 0]),
    "the force of a logarithm": (free(0, force={x: -1 / x}), [1, 0], [0, 1]),
    "the root of a square": (free(sp.sqrt((x - 1) ** 2 * (1 + y**2))), [3, 0], [-1, 0.5]),
}


@pytest.mark.parametrize("name", ENDS)
def test_where_series_end(name):
    """At such a point a run stops with its time, or goes on right."""
    system, q0, v0 = ENDS[name]
    run = dal.integrate(system, q0=q0, v0=v0, t_end=9, throw=False)
    if not run.success:
        assert "collapsed" in run.message and len(run.t) > 3
        h = run.t[-1] / 64
        other = dal.integrate(system, "reference", q0, v0, h=h, steps=63, tolerance=1e-13)
        there = dal.integrate(system, "taylor", q0, v0, h=h, steps=63)
        np.testing.assert_allclose(there.x, other.x, rtol=0, atol=1e-9)
    else:
        assert abs(run.energy - run.energy[0]).max() < 1e-12


@pytest.mark.parametrize("wall", [sp.Rational(1, 3), 1, 100])
def test_two_formulas_of_one_wall(wall):
    """Max(0, x - a)^2 has a maximum and a step, whose switches are one."""
    rng = np.random.default_rng(3)
    system = free(x**2 / 2 + 10 * sp.Max(0, x - wall) ** 2 + sp.Abs(y) + sp.Abs(y - x) / 9)
    for _ in range(20):
        q0, v0 = rng.normal(size=(2, 2)) * float(wall) * 2
        run = dal.integrate(system, q0=q0, v0=v0, t_end=20)
        assert abs(run.energy / run.energy[0] - 1).max() < 1e-12


def test_terms_that_grow_fast():
    """A floor that is exp(-300 x), below the last digit of the weight until just before it."""
    for k in (50, 200, 300, 1000):
        floor = free(x + sp.exp(-k * x))
        run = dal.integrate(floor, q0=[1, 0], v0=[0, 1], t_end=6)
        assert abs(run.energy - run.energy[0]).max() < 1e-13 and run.q[:, 0].min() > -0.1
    pulse = free(0, force={x: sp.exp(-((t - 20) ** 2))})
    run = dal.integrate(pulse, q0=[0, 0], v0=[0, 1], t_end=50)
    assert abs(run.v[-1, 0] - np.sqrt(np.pi)) < 1e-13
    within = free(0, force={x: sp.exp(-50 * (t - 5) ** 2)})  # a step that is 50 times longer
    run = dal.integrate(within, "taylor", [0, 0], [0, 1], h=10, t_end=10)
    assert abs(run.v[-1, 0] - np.sqrt(np.pi / 50)) < 1e-13


@pytest.mark.parametrize("place", [10, 5000])
def test_a_hill_on_a_straight_way(place):
    """Its slope is zero in all digits where the motion begins."""
    hill = free(sp.exp(-50 * (x - place) ** 2))
    run = dal.integrate(hill, q0=[0, 0], v0=[0.5, 0], t_end=4 * place)
    assert abs(run.v[-1] - [-0.5, 0]).max() < 1e-12 and len(run.t) < 500


@pytest.mark.parametrize("width", [0.2, 0.05, 0.01])
def test_hills_that_are_narrower_than_steps(width):
    hill = sp.exp(-((x - 0.3) ** 2 + (y - 0.2) ** 2) / (2 * sp.Float(width) ** 2)) / 5
    wall = (sp.cosh((x + y) / width) + sp.sinh(-(x**3))) * sp.exp(-2 / sp.Float(width))
    rng = np.random.default_rng(3)
    for V in (hill, wall):
        system = free(x**2 / 2 + y**2 / 2 + V)
        for _ in range(10):
            run = dal.integrate(system, q0=rng.normal(size=2) / 2, v0=rng.normal(size=2), t_end=20)
            assert abs(run.energy / run.energy[0] - 1).max() < 1e-12


def test_narrow_waves_of_time():
    """All coefficients are 0 where the cosine is, and at the end of a step too."""
    waves = free(0, force={x: sp.cos(t) ** 100})
    run = dal.integrate(waves, "taylor", [0, 0], [0, 1], t0=np.pi / 2, h=3 * np.pi, steps=1)
    one = np.pi * math.comb(100, 50) / 2**100
    assert abs(run.v[-1, 0] / (3 * one) - 1) < 1e-13


def test_narrow_wells_of_an_angle():
    """A step of the oscillator leads over several of them."""
    system = free(x**2 / 50 - sp.cos(y) ** 60 / 5)
    run = dal.integrate(system, q0=[1, np.pi / 2], v0=[0, 0.5], t_end=100)
    assert abs(run.energy - run.energy[0]).max() < 1e-12 and run.v[:, 1].max() > 0.7


def test_another_branch():
    """Over the crest of acos(cos(x)) and back in one step."""
    crest = free((x - 1) ** 2 * 5 + sp.acos(sp.cos(3 * x)) / 10)
    with pytest.raises(dal.ConvergenceError, match="step size collapsed"):
        dal.integrate(crest, q0=[1.04, 0], v0=[0.2, 0], t_end=1)


def test_decay():
    """A speed that vanishes among others: its digits are not followed below 1e-45."""
    system = free(x**2 / 2, force={y: -50 * y.d})
    run = dal.integrate(system, q0=[1, 0], v0=[0, 1], t_end=100)
    assert len(run.t) < 4000 and abs(run.q[-1, 1] - 0.02) < 1e-15
    smooth = free(0, force={x: -sp.tanh(100 * x.d)})
    run = dal.integrate(smooth, q0=[365, 0], v0=[1, 0], t_end=20)
    assert len(run.t) < 4000 and abs(run.q[-1, 0] - 365.500082246703) < 1e-9
    far = free(-sp.tanh(x))
    for place in (-370, 365):
        run = dal.integrate(far, q0=[place, 0], v0=[1, 0], t_end=1)
        assert abs(run.q[-1, 0] - place - 1) < 1e-13


def test_functions_of_a_modulus():
    """The branch that is not taken may be infinite."""
    root = sp.Piecewise((sp.sqrt(x), x > 0), (sp.sqrt(-x), True))
    for V in (1 / sp.Abs(x), sp.log(sp.Abs(x)), root):
        for side in (1, -1):
            run = dal.integrate(free(V), q0=[2 * side, 0], v0=[0.1, 0], t_end=0.5)
            assert run.success and abs(run.energy - run.energy[0]).max() < 1e-14


def test_coefficients_that_are_zero_by_chance():
    """At t = 0 all coefficients of t^30 that a series has are zero."""
    run = dal.integrate(free(0, force={x: t**30}), q0=[0, 0], v0=[0, 1], t_end=2)
    assert abs(run.v[-1, 0] / (2.0**31 / 31) - 1) < 1e-13


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_units(scale):
    """The unit of time does not matter, nor do those of the coordinates."""
    system = free(x**2 / 2 * sp.Float(scale) ** -2 + y**2 * sp.Float(scale) ** -2)
    run = dal.integrate(system, q0=[1, 1e-20], v0=[0, 0], t_end=100 * scale)
    assert abs(run.q[-1, 0] - np.cos(100)) < 1e-13 and len(run.t) < 100
    assert abs(run.q[-1, 1] / 1e-20 - np.cos(100 * np.sqrt(2))) < 3e-13


def test_units_of_coordinates():
    """One that is 1e60 times smaller than another has its own digits."""
    run = dal.integrate(free(x**2 / 8 + y**2), "taylor", [1e30, 1e-30], [0, 0], t_end=20)
    assert abs(run.q[-1] / [1e30, 1e-30] - np.cos([10, 20 * np.sqrt(2)])).max() < 1e-13


@pytest.mark.parametrize("place", [0.0, 2.0**20, -2.0**30])
def test_far_from_the_origin(place):
    """Distances keep their digits: the motion relative to a place is that near the origin."""
    a = sp.Symbol("a")
    V = (x - a) ** 2 / 2 + sp.cos(x - y) - 1 / sp.sqrt(1 + (x - a) ** 2 + (y - a) ** 2)
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2 + z.d**2 * (1 + (x - y) ** 2)) / 2 - V, [z.d - (y - a) * x.d],
        parameters={a: place},
    )  # fmt: skip
    start = np.array([0.5, -0.25, 0.125])
    run = dal.integrate(system, "taylor", start + [place, place, 0], [1, 0.5, -0.25], t_end=30)
    near = dal.integrate(system.with_parameters(a=0.0), "taylor", start, [1, 0.5, -0.25], t_end=30)
    assert run.stats.steps <= near.stats.steps + 2
    assert abs(run.v[-1] - near.v[-1]).max() <= 2e-14 + 2e-16 * abs(place)
    assert abs(run.q[-1, 2] - near.q[-1, 2]) <= 1e-13


@pytest.mark.parametrize("size", [1e9, 1e12])
def test_a_large_term_that_does_no_work(size):
    """A rate of a function in L, whose size is far above that of the forces, costs no digits."""
    parts = (x.d**2 * (2 + sp.sin(y)) + y.d**2 + z.d**2) / 2 - x**2 / 2, [z.d - y * x.d]
    start = [0.5, 0.25, 0], [1, -0.5, 0.25]
    gauge = size * y.d / (1 + y**2)
    ends = [
        dal.integrate(dal.System.from_sympy(parts[0] + more, parts[1]), "taylor", *start, t_end=20)
        for more in (0, gauge)
    ]
    assert abs(ends[0].q[-1] - ends[1].q[-1]).max() <= 1e-13


def test_a_large_force_along_the_constraint():
    """Its multiplier has roundoff of the size of the acceleration, also where an angle is 0."""
    run = dal.integrate(skate(force={y: -1e12}), q0=[0, 0, 0], v0=[1, 0, 1], t_end=1e-5)
    speed = 1 - 2e12 * np.sin(5e-6) ** 2 - np.sin(1e-5) / 2
    assert abs(np.hypot(*run.v[-1, :2]) / abs(speed) - 1) < 1e-13


@pytest.mark.parametrize("unit, right", [(1.0, True), (16.0, True), (1e8, False), (1e20, False)])
def test_units_that_are_far_apart(unit, right):
    """A sphere in R^4 with one coordinate in another unit: right, or refused."""
    q, u = dal.coordinates("a b c d"), sp.Symbol("u", positive=True)
    one = q[0] / u
    T = (one.subs(q[0], q[0].d) ** 2 + sum(e.d**2 for e in q[1:])) / 2
    row = one * q[0].d / u + sum(e * e.d for e in q[1:])
    system = dal.System.from_sympy(T - one - q[1] * q[2], [row], q, parameters={u: unit})
    start = np.array([0.5, 0.5, 0.5, 0.5]), np.array([0.1, -0.1, 0.2, -0.2])
    scale = np.array([unit, 1, 1, 1])
    if not right:
        words = "roundoff of the equations on D|series are not finite"
        with pytest.raises(dal.DomainError, match=words):
            dal.integrate(system, "taylor", *(e * scale for e in start), t_end=2)
        return
    run = dal.integrate(system, "taylor", *(e * scale for e in start), t_end=2)
    other = dal.reference(system, *(e * scale for e in start), t=2)
    assert abs((run.q[-1] - other.q) / scale).max() <= 1e-11


def test_no_velocity():
    """As many constraints as coordinates: the system stays where it is."""
    rows = [x.d + sp.sin(x + t) / 2 * y.d, y.d + sp.cos(x - y) / 2 * x.d]
    still = dal.System.from_sympy((x.d**2 + y.d**2) / 2 - x**2 / 2, rows)
    run = dal.integrate(still, q0=[0.3, 0.4], v0=[0, 0], t_end=200)
    assert (run.x == [0.3, 0.4, 0, 0]).all() and run.stats.steps < 10


def test_rest():
    """Rest, a straight line, and a start from rest."""
    for V, v in ((0, 0.0), (0, 1.0), (x, 0.0)):
        run = dal.integrate(free(V), q0=[1, 2], v0=[0, v], t_end=1000)
        expected = [1 - (500000 if V == x else 0), 2 + 1000 * v]
        np.testing.assert_allclose(run.q[-1], expected, rtol=1e-15)


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c():
    system = skate()
    dal.integrate(system, t_end=1)
    for given in ({"h": 1e8, "t_end": 1e9}, {"t_end": 1e9, "stride": 1000}):
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt) as caught:
            dal.integrate(system, "taylor", **given)
        assert not caught.value.partial.success
