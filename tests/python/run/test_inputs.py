"""Inputs of the force, and steps by hand: a cart on a blade whose motion is solved on its own."""

import functools
import pickle
import warnings

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from sympy.physics.mechanics import dynamicsymbols

import dalembert as dal
from conftest import U

M, J, BRAKE = 2.0, 0.75, 0.6
START = np.array([0.3, -0.2, 0.4])
SPEED, TURN = 1.0, 1.1
V0 = np.array([SPEED * np.cos(0.4), SPEED * np.sin(0.4), TURN])
NAMES = ("left", "right")
STEPS = 24


def force(t, q, v, u):
    push = u[0] + u[1]
    return [
        push * np.cos(q[2]) - BRAKE * v[0], push * np.sin(q[2]) - BRAKE * v[1], u[1] - u[0]
    ]  # fmt: skip


def from_functions():
    return dal.System(
        mass=[M, M, J], mu=lambda q: [[np.sin(q[2]), -np.cos(q[2]), 0]],
        mu_v_q=lambda q, v: [
            [0, 0, np.cos(q[2]) * v[0] + np.sin(q[2]) * v[1]]
        ],
        force=force, inputs=NAMES, coordinates=["x", "y", "theta"], q0=START, v0=V0,
    )  # fmt: skip


def from_sympy(left=None, right=None, **options):
    x, y, theta = dal.coordinates("x y theta")
    m, brake = sympy.symbols("m brake")
    left, right = left or sympy.Symbol("left"), right or sympy.Symbol("right")
    push = left + right
    return dal.System.from_sympy(
        L=m * (x.d**2 + y.d**2) / 2 + sympy.Rational(3, 8) * theta.d**2,
        constraints=[sympy.sin(theta) * x.d - sympy.cos(theta) * y.d],
        parameters={m: M, brake: BRAKE},
        force={
            x: push * sympy.cos(theta) - brake * x.d, y: push * sympy.sin(theta) - brake * y.d,
            theta: right - left,
        },
        inputs=[left, right], q0=START, v0=V0, **options,
    )  # fmt: skip


@pytest.fixture(params=["functions", "sympy", "without a compiler"])
def cart(request):
    if request.param == "functions":
        return from_functions()
    if request.param == "without a compiler":
        request.getfixturevalue("in_python")
    return from_sympy()


def table(count, seed=3):
    return np.random.default_rng(seed).normal(size=(count, 2))


# ---- the system --------------------------------------------------------------------------------


def test_mechanics(cart):
    u = np.array([0.7, -0.2])
    q, v = START + 0.1, np.array([0.9 * np.cos(0.5), 0.9 * np.sin(0.5), 0.4])
    e, ahead = np.array([np.cos(0.5), np.sin(0.5)]), (0.5 - BRAKE * 0.9) / M
    vdot = [ahead * e[0] - 0.36 * e[1], ahead * e[1] + 0.36 * e[0], -0.9 / J]
    assert cart.inputs == NAMES and "inputs left, right" in repr(cart)
    np.testing.assert_allclose(cart.acceleration(q, v, inputs=u), vdot, atol=1e-14)
    np.testing.assert_allclose(cart.field(q, v, inputs=u), [*v, *vdot], atol=1e-14)
    np.testing.assert_allclose(cart.multipliers(q, v, inputs=u), [-M * 0.36], atol=1e-14)
    power = (0.5 - BRAKE * 0.9) * 0.9 - 0.9 * 0.4
    np.testing.assert_allclose(cart.power(q, v, inputs=dict(zip(NAMES, u)))[1], power, atol=1e-14)
    rows = cart.acceleration([q, q], [v, v], inputs=[u, 0 * u])
    np.testing.assert_array_equal(rows[1], cart.acceleration(q, v))  # nothing stays behind
    np.testing.assert_array_equal(rows[0], cart.acceleration(q, v, inputs=u))
    by_name = cart.acceleration([q, q], [v, v], inputs={"left": [u[0], 0], "right": [u[1], 0]})
    np.testing.assert_array_equal(by_name, rows)
    moved, _ = cart.perturbed(q, v, np.zeros(6), inputs=u)
    np.testing.assert_allclose(moved, [*v, *vdot], atol=1e-14)
    assert cart.check(q, v)


def test_description():
    system = from_sympy()
    assert system.formulas[-1] == "f_theta = -left + right"
    assert "left" in system._repr_latex_()
    assert 'input_names[] = {"left", "right"}' in system.c_source("cart")
    assert ".inputs = 2" in system.c_source("cart")
    copy = pickle.loads(pickle.dumps(system.with_parameters(m=3.0)))
    assert copy.inputs == NAMES
    expected = system.acceleration(START, V0, inputs=[1, 0])[0]
    assert copy.acceleration(START, V0, inputs=[1, 0])[0] != expected
    moving = from_sympy(*dynamicsymbols("left right"))
    assert moving.inputs == NAMES
    np.testing.assert_array_equal(moving.acceleration(START, V0, inputs=[1, 0])[0], expected)
    one = dal.System(mass=[1], force=lambda t, q, v, u: u, inputs=1)
    assert one.inputs == ("u0",)
    bent = system.deformed(
        lambda q, v: [0.0], 0.5, g_v=lambda q, v: np.zeros((1, 3)), kind="linear"
    )
    assert bent.inputs == NAMES


@pytest.mark.parametrize(
    "make, text",
    [
        (lambda x, u, w: {"inputs": [u]}, "inputs: u has no effect"),
        (lambda x, u, w: {"inputs": [u, w], "force": {x: u}}, "inputs: w has no effect"),
        (lambda x, u, w: {"inputs": [u, u], "force": {x: u}}, "inputs: u occurs twice"),
        (lambda x, u, w: {"inputs": ["u"], "force": {x: u}}, "'u': expected a symbol"),
        (lambda x, u, w: {"inputs": "u", "force": {x: u}}, "inputs = 'u': expected a sequence"),
        (lambda x, u, w: {"inputs": [w], "force": {x: w * u}}, "force.*: u is neither"),
        (lambda x, u, w: {"inputs": [u], "force": {x: u}, "parameters": {u: 1}}, "u is also"),
        (
            lambda x, u, w: {"inputs": [u], "constraints": [x.d - w], "parameters": {w: 1}},
            "inputs: u has no effect",
        ),
        (
            lambda x, u, w: {"inputs": [u], "q0": [u, 0], "v0": [0, 0], "force": {x: u}},
            "the input u: only forces and constraints",
        ),
    ],
)
def test_refused_expressions(make, text):
    x, y = dal.coordinates("x y")
    u, w = sympy.symbols("u w")
    with pytest.raises(ValueError, match=text):
        dal.System.from_sympy((x.d**2 + y.d**2) / 2, **make(x, u, w))


@pytest.mark.parametrize(
    "given, text",
    [
        ({"inputs": ["a"]}, "expected a force that uses them"),
        ({"inputs": ["a", "a"], "force": lambda t, q, v, u: u}, "expected different names"),
        ({"inputs": -1, "force": lambda t, q, v, u: u}, "inputs = -1"),
        ({"inputs": ["a"], "force": lambda t, q, v: v}, r"force is a function of \(t, q, v\)"),
        ({"force": lambda t, q, v, u: u}, r"force is a function of \(t, q, v, u\)"),
    ],
)
def test_refused_functions(given, text):
    with pytest.raises(ValueError, match=text):
        dal.System(mass=[1.0], **given)


def test_refused_values(cart):
    for inputs, text in (
        ([1.0], "inputs: expected shape"),
        ([np.nan, 1.0], r"inputs\[0\] = nan"),
        ({"left": 1.0}, "inputs: right is missing"),
        ({"left": 1.0, "rigth": 2.0}, "did you mean 'right'"),
    ):
        with pytest.raises(ValueError, match=text):
            cart.multipliers(START, V0, inputs=inputs)
    with pytest.raises(ValueError, match="has no inputs"):
        dal.systems.particle().field([0, 1, 0], [1, 1, 1], inputs=[1.0])


# ---- runs --------------------------------------------------------------------------------------


@pytest.mark.parametrize("hold, stride", [(1, 1), (5, 2), (40, 1)])
def test_one_way_or_another(cart, hold, stride):
    """A table, names, a controller and steps by hand give the same bits."""
    holds = -(-STEPS // hold)
    inputs = table(holds)
    given = {"h": 0.05, "steps": STEPS, "stride": stride, "hold": hold}
    run = dal.integrate(cart, "midpoint", inputs=inputs, **given)
    np.testing.assert_array_equal(run.inputs, inputs)
    assert run.hold == hold and run["inputs"] is run.inputs
    named = dict(zip(NAMES, inputs.T))
    rows, times = iter(inputs), []

    def control(t, q, v):
        times.append(t)
        return next(rows)

    for other in (named, control):
        again = dal.integrate(cart, "midpoint", inputs=other, **given)
        np.testing.assert_array_equal(again.x, run.x)
        np.testing.assert_array_equal(again.inputs, inputs)
        np.testing.assert_array_equal(again.reactions, run.reactions)
    np.testing.assert_allclose(times, np.arange(holds) * hold * 0.05, atol=1e-15)
    stepper = dal.Stepper(cart, "midpoint", h=0.05)
    for k in range(STEPS):
        stepper.step(inputs[k // hold])
        if (k + 1) % stride == 0:
            np.testing.assert_array_equal(stepper.x, run.x[(k + 1) // stride])
    assert stepper.t == run.t[-1] and stepper.steps == STEPS


def test_multipliers_and_energy_of_rows():
    """Those of a state have the inputs that begin there, those of the last one its own."""
    inputs, cart = table(6), from_sympy()
    run = dal.integrate(cart, h=0.05, steps=STEPS, stride=2, inputs=inputs, hold=4)
    for k in range(len(run.t)):
        row = inputs[min(2 * k // 4, 5)]
        expected = cart.multipliers(run.q[k], run.v[k], inputs=row)
        np.testing.assert_array_equal(run.multipliers[k], expected)
    constant = dal.integrate(cart, h=0.05, steps=4, inputs=[0.3, 0.4])
    np.testing.assert_array_equal(constant.inputs, np.tile([0.3, 0.4], (4, 1)))
    nothing = dal.integrate(cart, h=0.05, steps=4)
    assert nothing.inputs.shape == (0, 2)
    zeros = dal.integrate(cart, h=0.05, steps=4, inputs=np.zeros((4, 2)))
    np.testing.assert_array_equal(zeros.x, nothing.x)
    np.testing.assert_array_equal(zeros.multipliers, nothing.multipliers)
    copy = pickle.loads(pickle.dumps(run))
    np.testing.assert_array_equal(copy.inputs, inputs)
    np.testing.assert_array_equal(copy.multipliers, run.multipliers)


def test_inputs_of_output_times():
    """A time between the steps has the inputs of its own step: on a rail the reaction is -u."""
    rail = dal.System(
        mass=[1, 1], mu=lambda q: [[0, 1]], force=lambda t, q, v, u: [0, u[0]], inputs=1
    )
    inputs, at = table(8)[:, :1], [0.0, 0.07, 0.12, 0.31, 0.38]
    run = dal.integrate(rail, "leapfrog", [0, 0], [1, 0], h=0.05, steps=8, inputs=inputs, t_eval=at)
    np.testing.assert_array_equal(run.multipliers, -inputs[[0, 1, 2, 6, 7]])


def test_a_single_input_is_a_number():
    cart = dal.System(
        mass=[2], force=lambda t, q, v, u: u - v, inputs=["push"], q0=[0], v0=[0]
    )
    run = dal.integrate(cart, h=0.1, steps=3, inputs=lambda t, q, v: 1 - v[0])
    stepper = dal.Stepper(cart, h=0.1)
    for k in range(3):
        assert run.inputs[k] == 1 - run.v[k]
        stepper.step(1 - run.v[k, 0])
    np.testing.assert_array_equal(stepper.x, run.x[-1])


def test_a_controller_that_fails(cart):
    def control(t, q, v):
        if t > 0.42:
            raise RuntimeError("no more")
        return [1.0, t]

    with pytest.raises(RuntimeError, match="no more") as caught:
        dal.integrate(cart, h=0.05, steps=STEPS, inputs=control)
    partial = caught.value.partial
    assert len(partial.t) == 10 and len(partial.inputs) == 9
    whole = dal.integrate(cart, h=0.05, steps=9, inputs=partial.inputs)
    np.testing.assert_array_equal(whole.x, partial.x)


@pytest.mark.parametrize(
    "given, text",
    [
        ({"inputs": np.zeros((5, 2))}, "inputs: expected shape"),
        ({"inputs": lambda t, q, v: [1.0]}, r"v\) returned 1 number: expected 2 \("),
        ({"inputs": lambda t, q, v: None}, r"inputs returned None: expected 2 numbers \("),
        ({"inputs": lambda t, q, v: np.array([1.0, np.inf])}, r"step 1 \(t = 0\): u\[1\] = inf"),
        ({"inputs": lambda t, q, v: np.ones(3)}, r"\(t, q, v\) returned 3 numbers: expected 2 \("),
        ({"inputs": lambda t: [1.0, 1.0]}, r"a function of \(t, q, v\)"),
        ({"inputs": {"left": 1.0}}, "right is missing"),
        ({"hold": 2}, "hold = 2: not used without inputs"),
        ({"inputs": [0.0, 0.0], "hold": 0}, "hold = 0"),
        ({"inputs": [0.0, 0.0], "hold": 0.1}, "hold = 0.1: expected a whole number of steps"),
    ],
)
def test_refused_inputs_of_runs(given, text):
    with pytest.raises(ValueError, match=text):
        dal.integrate(from_sympy(), h=0.1, steps=4, **given)
    with pytest.raises(ValueError, match="has no inputs"):
        dal.integrate(dal.systems.particle(), h=0.1, steps=4, inputs=lambda t, q, v: [])


# ---- controllers that are expressions ----------------------------------------------------------


def sampled(mass, stiffness, damping, period, count):
    """States x, v of a mass whose force -stiffness x - damping v is held over periods."""
    gain, states = np.array([stiffness, damping]), [np.array([1.0, 0.25])]
    drift, kick = np.array([[1, period], [0, 1]]), np.array([period**2 / 2, period]) / mass
    for _ in range(count):
        states.append(drift @ states[-1] - kick * (gain @ states[-1]))
    return np.array(states), -np.array(states[:-1]) @ gain


def spring(**options):
    x, (mass, gain, push) = dal.coordinates("x")[0], sympy.symbols("mass gain push")
    return dal.System.from_sympy(
        mass * x.d**2 / 2, force={x: push}, inputs=[push], parameters={mass: 2.0, gain: 1.5},
        q0=[1], v0=[0.25], **options,
    )  # fmt: skip


@pytest.mark.parametrize("compiler", ["cc", "none-such"])
@pytest.mark.parametrize("h", [0.05, "auto"])
def test_expressions_are_held(compiler, h, request):
    """Leapfrog is exact under a constant force, so that the motion is known in closed form."""
    x, (gain, push) = dal.coordinates("x")[0], sympy.symbols("gain push")
    if compiler == "none-such":
        request.getfixturevalue("in_python")
    system = spring()
    varies = h == "auto"
    run = dal.integrate(
        system, h=h, t_end=3.0, inputs={push: -gain * x - x.d / 2}, hold=0.2 if varies else 4
    )
    states, forces = sampled(2.0, 1.5, 0.5, 0.2, 15)
    np.testing.assert_allclose(run.inputs[:, 0], forces, rtol=0, atol=1e-13)
    np.testing.assert_allclose(run.x[-1], states[-1], rtol=0, atol=1e-13)
    if not varies:
        np.testing.assert_allclose(run.x[::4], states, rtol=0, atol=1e-13)


def test_expressions_are_what_functions_are():
    """Inputs are symbols, dynamicsymbols or names; laws have the time and parameters."""
    left, right = dynamicsymbols("left right")
    x, y, theta = dal.coordinates("x y theta")
    brake = sympy.Symbol("brake")

    def control(t, q, v):
        return [np.sin(3 * t) - BRAKE * v[0] * q[2], 0.25]

    law = sympy.sin(3 * dal.time) - brake * x.d * theta
    moving = law.subs({x.d: dynamicsymbols("x").diff(), theta: dynamicsymbols("theta")})
    expected = dal.integrate(from_sympy(), "midpoint", h=0.05, steps=STEPS, inputs=control, hold=3)
    for keys in ({"left": law, "right": 0.25}, {left: moving, right: sympy.Rational(1, 4)}):
        run = dal.integrate(from_sympy(), "midpoint", h=0.05, steps=STEPS, inputs=keys, hold=3)
        np.testing.assert_allclose(run.x, expected.x, rtol=0, atol=1e-14)
        np.testing.assert_allclose(run.inputs, expected.inputs, rtol=0, atol=1e-14)


def test_refused_laws():
    x, _, theta = dal.coordinates("x y theta")
    for given, text in (
        ({"left": x}, "inputs: right is missing; expected left, right"),
        ({"left": x, "rigt": 1}, "inputs: rigt is not an input; did you mean 'right'"),
        ({"left": x, "right": [1, 2]}, r"inputs\['right'\]"),
        ({"left": x, "right": sympy.Symbol("w")}, r"inputs\['right'\]: w is neither a coordinate"),
        ({"left": sympy.sqrt(-theta), "right": 0}, r"inputs of step 1 \(t = 0\): u\[0\] = -?nan"),
    ):
        with pytest.raises(ValueError, match=text):
            dal.integrate(from_sympy(), h=0.1, steps=4, inputs=given)
    with pytest.raises(ValueError, match="left is not an input; expected none"):
        dal.integrate(dal.systems.particle(), h=0.1, steps=4, inputs={"left": x})
    with pytest.raises(ValueError, match="hold is missing: with h = 'auto'"):
        dal.integrate(from_sympy(), h="auto", t_end=1, inputs={"left": x, "right": 0})


# ---- steps by hand -----------------------------------------------------------------------------


def test_stepper(cart):
    stepper = dal.Stepper(cart, "leapfrog-kl6", h=0.05)
    assert np.isnan(stepper.reaction).all() and stepper.t == 0.0
    stepper.step({"left": 0.5, "right": 0.25}, steps=3)
    run = dal.integrate(cart, "leapfrog-kl6", h=0.05, steps=3, stride=3, inputs=[0.5, 0.25])
    np.testing.assert_array_equal(stepper.x, run.x[-1])
    np.testing.assert_array_equal(stepper.q, run.q[-1])
    np.testing.assert_array_equal(stepper.v, run.v[-1])
    np.testing.assert_array_equal(stepper.reaction, run.reactions[-1])
    np.testing.assert_array_equal(stepper.inputs, [0.5, 0.25])
    assert stepper.energy == run.energy[-1] and stepper.residual == run.residual[-1]
    assert stepper.stats.steps == 3

    saved = stepper.save()
    stepper.step([1.0, -1.0], steps=5)
    later = stepper.x
    elsewhere = dal.Stepper(cart, "leapfrog-kl6", h=0.1)
    for one in (stepper, elsewhere):
        one.restore(saved)
        np.testing.assert_array_equal(one.inputs, [0.5, 0.25])
        one.step([1.0, -1.0], steps=5)
        np.testing.assert_array_equal(one.x, later)
    stepper.reset()
    np.testing.assert_array_equal(stepper.x[:3], START)
    np.testing.assert_array_equal(stepper.inputs, [0, 0])
    assert stepper.t == 0.0
    stepper.reset(START + 1, 0 * V0, t=2.0)
    stepper.step()
    assert stepper.t == 2.05
    with pytest.raises(dal.NotOnConstraintError):
        stepper.reset(START, V0 + 1)
    assert stepper.t == 2.05  # as it was


def test_stepper_failures(cart):
    stepper = dal.Stepper(cart, h=0.05)
    stepper.step([0.5, 0.25])
    before = stepper.x
    for inputs in ([1.0], [np.nan, 1.0], np.array([np.inf, 1.0]), {"left": 2.0}, "ab"):
        with pytest.raises(ValueError, match="inputs"):
            stepper.step(inputs)
        np.testing.assert_array_equal(stepper.inputs, [0.5, 0.25])
    np.testing.assert_array_equal(stepper.x, before)
    with pytest.raises(ValueError, match="another system"):
        stepper.restore(dal.Stepper(dal.systems.sleigh(), h=0.1).save())

    def wall(t, q, v, u):
        if q[0] > 0.5:
            raise ZeroDivisionError("a wall")
        return u

    free = dal.System(mass=[1], force=wall, inputs=1, q0=[0], v0=[1])
    stepper = dal.Stepper(free, h=0.1)
    with pytest.raises(ZeroDivisionError, match="a wall"):
        stepper.step(0.0, steps=20)
    assert stepper.steps == 5 and np.isnan(stepper.reaction).all()
    flow = dal.Stepper(dal.systems.particle(), dal.Scheme.flow("msadams"), h=0.1)
    with pytest.raises(NotImplementedError, match="cannot be resumed"):
        flow.save()


def test_a_step_that_fails_leaves_no_reaction():
    """The reaction is that of the last good call; after a failure there is none."""
    sleigh, calls = dal.systems.sleigh(), []

    def force(t, q, v):
        calls.append(t)
        if t > 0.15:
            raise RuntimeError("no more")
        return np.zeros(3)

    own = dal.System(
        mass=sleigh.mass, mu=lambda q: [[np.sin(q[2]), -np.cos(q[2]), 0]], force=force
    )
    stepper = dal.Stepper(own, "midpoint", np.zeros(3), [1, 0, 0.5], h=0.1)
    stepper.step()
    assert np.isfinite(stepper.reaction).all()
    before = stepper.x
    with pytest.raises(RuntimeError, match="no more"):
        stepper.step(steps=3)
    assert np.isnan(stepper.reaction).all() and np.array_equal(stepper.x, before)


def test_a_restored_step_size():
    one, other = (dal.Stepper(from_sympy(), h=h) for h in (0.1, 0.2))
    one.step(steps=3)
    other.restore(one.save())
    t = other.t
    other.step()
    assert other.h == 0.1 and other.t - t == pytest.approx(0.1) and "h = 0.1" in repr(other)
    with pytest.raises(ValueError, match="steps = -1: expected at least 0"):
        other.step(steps=-1)


@pytest.mark.parametrize(
    ("scheme", "stride", "hold", "h"),
    [
        ("leapfrog-kl8", 2, 3, -0.05), ("midpoint-kl6", 1, 3, 0.05), ("midpoint-kl6", 3, 1, 0.05),
        ("reference", 2, 3, 0.05), ("reference", 3, 1, -0.05), ("reference", 1, 24, 0.05),
    ],
)  # fmt: skip
def test_states_between_stored_ones_are_those_of_the_inputs(scheme, stride, hold, h):
    system = dal.System(mass=[1], force=lambda t, q, v, u: [u[0] - v[0]], inputs=["u"])
    table = np.resize([10.0, -3.0, 0.0, 10.0, 2.0], 24 // hold)
    run = dal.integrate(
        system, scheme, [0], [0], h=h, steps=24, stride=stride, inputs=table[:, None], hold=hold
    )

    def velocity(t):  # v' = u - v
        v, held = 0.0, hold * abs(h)
        for k, u in enumerate(table):
            passed = np.sign(h) * min(abs(t) - k * held, held)
            v = u + (v - u) * np.exp(-passed)
            if (k + 1) * held >= abs(t):
                return v

    times = np.linspace(0.01, 1.2, 25) * np.sign(h)
    exact = [velocity(t) for t in times]
    np.testing.assert_allclose(run(times).v[:, 0], exact, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(run(times[::-1]).v[::-1], run(times).v)  # in any order
    np.testing.assert_array_equal(run(run.t).v, run.v)


def test_states_between_kept_nodes_are_refused():
    system = dal.System(mass=[1], force=lambda t, q, v, u: u, inputs=["u"], q0=[0], v0=[1])
    run = dal.integrate(
        system, "explicit-nodes", h=0.1, steps=4, inputs=[1.0], initial="project"
    )
    with pytest.raises(ValueError, match="between those of 'explicit-nodes' with inputs"):
        run(0.05)


# ---- inputs in constraints: a sled with two of them, whose equations are solved on their own ----

SLED = np.diag([1.0, 1.0, 0.5, 0.0])
SLED[2:, 2:] += 0.2
HOLD = 0.25
DRIVE = np.column_stack([np.sin(1.3 * np.arange(6)), 0.3 * np.cos(2.0 * np.arange(6))])


def sled_forms(q, u):
    s, c = np.sin(q[2] + u[1]), np.cos(q[2] + u[1])
    return np.array([[s, -c, -0.3, 0.0], [0.0, 0.1, 0.0, 1.0]])


def sled_affine(q, u):
    return np.array([0.0, -u[0] * (1.0 + 0.2 * q[0])])


def sled_rates(t, x, u):
    q, v, mu = x[:4], x[4:], sled_forms(x[:4], u)
    ahead = np.cos(q[2] + u[1]) * v[0] + np.sin(q[2] + u[1]) * v[1]
    pull = -np.array([0.7, 0.3 * q[2], 0.3 * q[1], -0.2 * np.sin(q[3])])
    turn = np.array([ahead * v[2], -0.2 * u[0] * v[0]])
    A = np.block([[SLED, -mu.T], [mu, np.zeros((2, 2))]])
    return np.concatenate([v, np.linalg.solve(A, [*pull, *-turn])[:4]])


def jumped(x, u):
    """The state after the impulse that leads into the D of these inputs."""
    mu, Z = sled_forms(x[:4], u), np.linalg.solve(SLED, sled_forms(x[:4], u).T)
    off = mu @ x[4:] + sled_affine(x[:4], u)
    return np.concatenate([x[:4], x[4:] - Z @ np.linalg.solve(mu @ Z, off)])


SLED_START = jumped(np.array([0.1, 0.2, 0.3, 0.4, 1.0, 0.5, 0.2, 0.0]), DRIVE[0])


@functools.cache
def sled_end():
    x = SLED_START
    for u in DRIVE:
        found = solve_ivp(
            sled_rates, (0, HOLD), jumped(x, u), "DOP853", args=(u,), rtol=1e-13, atol=1e-14
        )
        x = found.y[:, -1]
    return x


def sled_potential(q):
    return 0.7 * q[0] + 0.3 * q[1] * q[2] + 0.2 * np.cos(q[3])


@functools.cache
def sled(kind="sympy"):
    names = {"inputs": ["rate", "angle"], "coordinates": ["x", "y", "theta", "steer"]}
    if kind == "functions":
        return dal.System(
            mass=SLED, mu=sled_forms, affine=sled_affine, potential=sled_potential, driven=True,
            **names,
        )  # fmt: skip
    if kind == "nonlinear":
        return dal.System(
            mass=SLED, constraint=lambda q, v, u: sled_forms(q, u) @ v + sled_affine(q, u),
            constraint_v=lambda q, v, u: sled_forms(q, u), potential=sled_potential, driven=True,
            **names,
        )  # fmt: skip
    x, y, theta, steer = dal.coordinates("x y theta steer")
    rate, angle, c = sympy.symbols("rate angle c")
    T = (x.d**2 + y.d**2) / 2 + theta.d**2 / 4 + (theta.d + steer.d) ** 2 / 10
    V = sympy.Float(0.7) * x + sympy.Float(0.3) * theta * y + sympy.cos(steer) / 5
    blade = sympy.sin(theta + angle) * x.d - sympy.cos(theta + angle) * y.d - 0.3 * theta.d
    motor = steer.d - rate * (1 + c * x) + y.d / 10
    return dal.System.from_sympy(
        T - V, [blade, motor], inputs=[rate, angle], parameters={c: 0.2}
    )  # fmt: skip


def drive(scheme, hold=8, kind="sympy", **more):
    given = {"h": HOLD / hold, "steps": hold * len(DRIVE), "inputs": DRIVE, "hold": hold, **more}
    return dal.integrate(sled(kind), scheme, *np.split(SLED_START, 2), **given)


@pytest.mark.parametrize(
    "scheme, order",
    [
        ("explicit", 1), ("midpoint", 2), ("leapfrog-mirror", 2), ("pair:0.5:0.5", 2), ("bm4", 4),
        ("leapfrog-yoshida4", 4),  # sub-steps back in time
    ],
)  # fmt: skip
def test_driven_orders(scheme, order):
    """Full order between jumps of the velocity that are those of an impact."""
    errors = []
    for hold in (8, 16):
        run = drive(scheme, hold)
        errors.append(abs(run.x[-1] - sled_end()).max())
        assert run.residual.max() <= 16 * U and run.stats.worst_residual <= 16 * U
    assert abs(np.log2(errors[0] / errors[1]) - order) < 0.05


def test_driven_flow_and_controlled_steps():
    assert abs(drive("reference", 1).x[-1] - sled_end()).max() < 1e-13
    assert abs(drive("reference", 2, method="msadams").x[-1] - sled_end()).max() < 1e-10
    how = {"h": "auto", "t_end": HOLD * len(DRIVE), "hold": HOLD, "tolerance": 1e-5, "steps": None}
    run = drive("leapfrog", **how)
    assert abs(run.x[-1] - sled_end()).max() < 1e-5 and run.residual.max() < 16 * U


@pytest.mark.parametrize("kind", ["functions", "nonlinear", "without a compiler"])
def test_driven_functions(kind, request):
    expected = drive("bm4", 4).x
    if kind == "without a compiler":
        request.getfixturevalue("in_python")
    run = drive("bm4", 4, kind)
    np.testing.assert_allclose(run.x, expected, atol=1e-13)
    assert run.residual.max() <= 16 * U


def test_driven_geometry():
    system, u, x = sled(), DRIVE[1], SLED_START
    there = jumped(x, u)
    (q, v), w = np.split(x, 2), there[4:]
    assert system.is_driven and not system.is_forced and not system.conserves_energy
    np.testing.assert_allclose(system.project(q, v, inputs=u), w, atol=1e-15)
    off = sled_forms(q, u) @ v + sled_affine(q, u)
    np.testing.assert_allclose(system.residual(q, v, inputs=u), off, atol=1e-15)
    assert system.relative_residual(q, w, inputs=u) < 16 * U < system.relative_residual(q, w)
    kept = system.consistent(q, v, keep=["y"], inputs=u)
    assert kept[1] == v[1] and system.relative_residual(q, kept, inputs=u) < 16 * U
    np.testing.assert_allclose(system.field(q, w, inputs=u), sled_rates(0, there, u), atol=1e-15)
    chart = dal.Chart(system, q, w)
    xi = chart.drop(q, w)
    np.testing.assert_allclose(np.concatenate(chart.lift(xi, inputs=u)), there, atol=1e-15)
    moved = chart.jacobian(xi, inputs=u) @ chart.field(xi, inputs=u)
    np.testing.assert_allclose(moved, sled_rates(0, there, u), atol=1e-14)
    end = solve_ivp(sled_rates, (0, HOLD), there, "DOP853", args=(u,), rtol=1e-13, atol=1e-14)
    for coordinates in ("x", "xi"):
        found = dal.reference(system, q, w, t=HOLD, coordinates=coordinates, inputs=u)
        np.testing.assert_allclose([*found.q, *found.v], end.y[:, -1], atol=1e-12)
    assert system.check(*np.split(jumped(x, [0, 0]), 2))
    assert "the constraint with inputs 0" in system.check(q, w).text


@functools.cache
def moved_cart():
    """Two masses 1, the velocity of the first given by an input, in a field of strength 3."""
    x, y = dal.coordinates("x y")
    u = sympy.Symbol("u")
    T = (x.d**2 + y.d**2) / 2
    return dal.System.from_sympy(T - 3 * x, [x.d - u], inputs=[u], q0=[0, 0], v0=[1, 1])


STAIRS = np.array([[1.0], [1.0], [-1.0], [-1.0], [2.0], [2.0]])


@pytest.mark.parametrize("stride", [1, 4])
def test_a_prescribed_velocity(stride):
    """Rows stand before a jump; reactions have its impulse, multipliers have not."""
    run = dal.integrate(
        moved_cart(), "leapfrog", h=0.25, steps=24, inputs=STAIRS, hold=4, stride=stride
    )
    at = np.arange(0, 25, stride)
    u = np.repeat(STAIRS[:, 0], 4)
    position = np.concatenate([[0], np.cumsum(u) / 4])
    np.testing.assert_array_equal(run.q, np.column_stack([position, np.arange(25) / 4])[at])
    np.testing.assert_array_equal(run.v[:, 0], np.concatenate([[1], u])[at])
    np.testing.assert_array_equal(run.multipliers, np.full((len(at), 1), 3.0))
    forces = np.full(24, 3.0)
    forces[[8, 16]] += np.array([-2.0, 3.0]) / 0.25
    expected = forces.reshape(-1, stride).mean(axis=1)
    np.testing.assert_allclose(run.reactions[:, 0], expected, atol=1e-14)
    assert run.residual.max() == 0.0
    np.testing.assert_allclose(run.energy, ((run.v**2).sum(axis=1) / 2 + 3 * run.q[:, 0]))


def test_a_prescribed_speed(in_python):
    """Not linear in v: the impulse is along the velocity, which keeps its direction."""
    x, y = dal.coordinates("x y")
    u = sympy.Symbol("u")
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2, [x.d**2 + y.d**2 - u**2], inputs=[u], q0=[0, 0], v0=[0.6, 0.8]
    )
    speeds = np.array([1.0, 3.0, 0.5])
    run = dal.integrate(system, "midpoint", h=0.25, steps=6, inputs=speeds[:, None], hold=2)
    assert system.kind == "nonlinear"
    np.testing.assert_allclose(run.v[2::2], speeds[:, None] * [0.6, 0.8], atol=1e-15)
    np.testing.assert_allclose(run.q[2::2, 1], np.cumsum(speeds) * 0.4, atol=1e-15)
    # (3 - 1) e = 2 v Lambda with v = e
    np.testing.assert_allclose(run.reactions[:, 0], [0, 0, 4, 0, -2.5 / 6 / 0.25, 0], atol=1e-14)


def test_a_driven_sleigh(in_python):
    """A mass that depends on q: ahead a w^2 is the acceleration while the rate is w."""
    x, y, theta = dal.coordinates("x y theta")
    w, a, s, c = sympy.Symbol("w"), sympy.Rational(2, 5), sympy.sin(theta), sympy.cos(theta)
    T = ((x.d - a * s * theta.d) ** 2 + (y.d + a * c * theta.d) ** 2) / 2 + theta.d**2 / 5
    system = dal.System.from_sympy(T, [s * x.d - c * y.d, theta.d - w], inputs=[w])
    rates = [0.5, -0.8, 1.1]
    speed, heading, place = 1.0, 0.0, np.zeros(2)
    for r in rates:  # and the integral of the speed along the heading, in closed form
        k, end = 0.4 * r**2, heading + r
        for at, sign in ((end, 1), (heading, -1)):
            now = speed + k * (sign > 0)
            place += sign * now / r * np.array([np.sin(at), -np.cos(at)])
            place += sign * k / r**2 * np.array([np.cos(at), np.sin(at)])
        speed, heading = speed + k, end
    expected = np.array([*place, heading, speed * np.cos(heading), speed * np.sin(heading), 1.1])
    start = [0, 0, 0], [1, 0, 0.5]
    errors = []
    for hold in (8, 16):
        given = {"h": 1 / hold, "steps": 3 * hold, "inputs": np.c_[rates], "hold": hold}
        run = dal.integrate(system, "midpoint-suzuki4", *start, **given)
        errors.append(abs(run.x[-1] - expected).max())
    assert abs(np.log2(errors[0] / errors[1]) - 4) < 0.1


def test_the_start_of_driven_runs():
    system = moved_cart()
    x, _ = dal.coordinates("x y")
    law = {"u": sympy.cos(x) / 2 + x.d / 4}
    how = {"h": 0.125, "steps": 16, "hold": 2}
    first = r"the first inputs are u = 0.75. Pass consistent='project'"
    with pytest.raises(dal.NotOnConstraintError, match=first):
        dal.integrate(system, "leapfrog", inputs=law, **how)
    calls = []

    def control(t, q, v):
        calls.append(t)
        return [np.cos(q[0]) / 2 + v[0] / 4]

    by_law = dal.integrate(system, "leapfrog", inputs=law, consistent="project", **how)
    by_hand = dal.integrate(system, "leapfrog", inputs=control, consistent="project", **how)
    assert by_law.inputs[0] == 0.75 == by_law.v[0, 0]  # at the velocity before the first jump
    assert calls == (0.25 * np.arange(8)).tolist()
    for other in (by_hand.inputs, by_law.inputs):
        again = dal.integrate(system, "leapfrog", inputs=other, consistent="project", **how)
        np.testing.assert_allclose(again.x, by_law.x, atol=1e-15)
    assert by_law.residual.max() == 0.0
    with pytest.raises(dal.NotOnConstraintError, match="first inputs are u = 0."):
        dal.integrate(system, "leapfrog", h=0.125, steps=16)


def test_driven_steps_by_hand():
    run = drive("leapfrog", 4)
    stepper = dal.Stepper(sled(), "leapfrog", *np.split(SLED_START, 2), h=HOLD / 4, inputs=DRIVE[0])
    for k, u in enumerate(DRIVE):
        if k == 3:
            saved = stepper.save()
        stepper.step(u)
        np.testing.assert_array_equal(stepper.reaction, run.reactions[4 * k])
        stepper.step(steps=3)
    np.testing.assert_array_equal(stepper.x, run.x[-1])
    stepper.restore(saved)  # before a jump, which is that of the last inputs that are given
    stepper.step([7.0, 7.0], steps=0)
    for u in DRIVE[3:]:
        stepper.step(u, steps=4)
    np.testing.assert_array_equal(stepper.x, run.x[-1])
    with pytest.raises(dal.NotOnConstraintError):
        stepper.reset([0, 0, 0, 0], [0, 0, 0, 5])
    np.testing.assert_array_equal(stepper.inputs, DRIVE[-1])
    stepper.reset()
    np.testing.assert_array_equal(stepper.inputs, DRIVE[0])
    fresh = dal.Stepper(sled(), "leapfrog", *np.split(SLED_START, 2), h=HOLD / 4, inputs=DRIVE[0])
    for one in (stepper, fresh):
        one.step(DRIVE[-1])
    np.testing.assert_array_equal(stepper.x, fresh.x)


def test_events_of_a_jump():
    """A velocity that changes its sign in the jump; what happens then begins after it."""
    guard = dal.Event(lambda t, q, v: v[0])
    up = dal.Event(lambda t, q, v: v[0], direction=1)
    twice = dal.Event(lambda t, q, v: v[0] + 1.5 * (t - 2))  # and back within the step
    how = {"inputs": STAIRS, "t_end": 6.0}
    run = dal.integrate(moved_cart(), "leapfrog", h=1.0, events=[guard, up, twice], **how)
    assert [t.tolist() for t in run.t_events[:2]] == [[2.0, 4.0], [4.0]]
    np.testing.assert_allclose(run.t_events[2], [4 / 3, 2, 8 / 3], atol=1e-15)
    np.testing.assert_array_equal(run.x_events[0], [[2, 2, -1, 1], [0, 4, 2, 1]])
    end = dal.Event(lambda t, q, v: v[0], terminal=True)
    run = dal.integrate(moved_cart(), "leapfrog", h=0.25, hold=4, events=[end], **how)
    np.testing.assert_array_equal(run.x[-2:], [[2, 2, 1, 1], [2, 2, -1, 1]])
    for stride in (1, 6):  # with the row before the jump, and without
        run = dal.integrate(
            moved_cart(), "leapfrog", h=0.25, hold=4, events=[end], stride=stride, **how
        )
        np.testing.assert_array_equal(run.x[-1], [2, 2, -1, 1])
        assert run.t[-1] == 2.0 and run.residual.max() == 0.0
    back = dal.Event(lambda t, q, v: v[0], reset=lambda q, v: (q, [v[0], -2 * v[1]]))
    for h in (0.25, "auto"):
        hold = 4 if h == 0.25 else 1.0
        run = dal.integrate(moved_cart(), "leapfrog", h=h, hold=hold, events=[back], **how)
        np.testing.assert_allclose(run.x[-1], [4, 6, 2, 4], atol=1e-14)
        assert run.residual.max() == 0.0 and run.t_events[0].tolist() == [2.0, 4.0]
        np.testing.assert_allclose(run([2.1, 4.1]).q, [[1.9, 1.8], [0.2, -1.6]], atol=1e-14)
        if h == 0.25:  # "auto" has two rows at the time of a reset
            np.testing.assert_array_equal(run(run.t).v, run.v)


def test_states_between_jumps():
    run = drive("bm6", 4, stride=8)
    times = np.array([0.1, HOLD, 0.3, 0.62, 1.2])
    x = SLED_START
    for k, u in enumerate(DRIVE):
        there = times[(times > k * HOLD) & (times <= (k + 1) * HOLD)] - k * HOLD
        at = {"t_eval": [*there[there < HOLD], HOLD], "rtol": 1e-12, "atol": 1e-12}
        found = solve_ivp(sled_rates, (0, HOLD), jumped(x, u), "DOP853", args=(u,), **at)
        for t, state in zip(there, found.y.T):
            now = run(t + k * HOLD)
            np.testing.assert_allclose([*now.q, *now.v], state, atol=1e-9)
        x = found.y[:, -1]


@pytest.mark.parametrize("t0", [0, 1.7, -3.3])
@pytest.mark.parametrize("ahead", [1, -1])
def test_rows_where_inputs_change_have_those_of_the_step_that_ended(t0, ahead, in_python):
    """However t0 + k hold is rounded: else the residual is the change of the input."""
    x, steer = dal.coordinates("x steer")
    rate = sympy.Symbol("rate")
    car = dal.System.from_sympy(
        (x.d**2 + steer.d**2) / 2 - x**2 / 2, [steer.d - rate], inputs=[rate],
        q0=[0, 0], v0=[1, 0.1],
    )  # fmt: skip
    times = t0 + ahead * np.array([0.1, 0.1, 0.1 + 1e-13, 0.1 + 1e-9, 0.2, 0.25])
    times[1] = np.nextafter(times[0], ahead * np.inf)  # by C's rule still the end of the step
    given = {"inputs": [[0.1], [0.9], [0.2]], "t0": t0, "t_end": t0 + 0.3 * ahead}
    for scheme, how in (
        (None, {"h": "auto", "hold": 0.1}), ("midpoint", {"h": 0.1 * ahead}),
        ("reference", {"h": 0.1 * ahead}),
    ):  # fmt: skip
        for t_eval in (None, times):
            run = dal.integrate(car, scheme, **given, **how, t_eval=t_eval)
            assert run.residual.max() < 1e-14


def test_journals_of_driven_runs(tmp_path):
    x, _ = dal.coordinates("x y")
    law = {"u": sympy.cos(x) / 2 + x.d / 4}
    for how in ({"h": 0.25, "steps": 24, "hold": 2}, {"h": "auto", "t_end": 6, "hold": 0.5}):
        given = {"inputs": law, "consistent": "project", **how}
        whole = dal.integrate(moved_cart(), "leapfrog", **given)
        path = tmp_path / f"{len(how)}{how['h']}.dal"
        stop = dal.integrate(
            moved_cart(), "leapfrog", journal=path, observer=lambda k, t, q, v: k == 5, **given
        )
        assert len(stop.x) < len(whole.x)
        again = dal.resume(path, moved_cart(), inputs=law)
        for name in ("x", "inputs", "reactions", "residual"):
            np.testing.assert_array_equal(getattr(again, name), getattr(whole, name))


def test_ensembles_of_driven_members():
    x, _ = dal.coordinates("x y")
    law = {"u": sympy.cos(x) / 2 + x.d / 4}
    system, starts = moved_cart(), np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 1.0]])
    how = {"h": 0.25, "steps": 12, "consistent": "project"}
    for inputs in (law, np.linspace(0, 1, 36).reshape(3, 12, 1)):
        keep = ["all", "residual", "multipliers", "reactions"]
        many = dal.ensemble(
            system, "leapfrog", starts, [1.0, 1.0], stride=1, keep=keep, inputs=inputs, **how
        )
        for k, q in enumerate(starts):
            mine = inputs if inputs is law else inputs[k]
            one = dal.integrate(system, "leapfrog", q, [1.0, 1.0], inputs=mine, **how)
            np.testing.assert_array_equal(many.states[k], one.x)
            np.testing.assert_array_equal(many.residual[k], one.residual)
            np.testing.assert_array_equal(many.multipliers[k], one.multipliers)
            np.testing.assert_array_equal(many.reactions[k], one.reactions)


def test_multipliers_of_members_with_a_law(in_python):
    """Multipliers at a row belong to the inputs that begin there, also if a law computes them."""
    x, y = dal.coordinates("x y")
    push = sympy.Symbol("push")
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2, [x.d - y.d], force={x: push}, inputs=[push]
    )
    starts = np.array([[1.0, 1.0], [2.0, 2.0]])
    many = dal.ensemble(
        system, "midpoint", starts, [0.0, 0.0], h=0.1, steps=4, stride=1, hold=2,
        inputs={push: -x}, keep=["q", "multipliers"],
    )  # fmt: skip
    held = many.q[:, [0, 0, 2, 2, 2], 0]
    np.testing.assert_allclose(many.multipliers[..., 0], held / 2, atol=1e-15)


def test_a_turned_blade(in_python):
    """An input in mu: D turns, and each jump leaves the part of the velocity along the blade."""
    x, y, theta = dal.coordinates("x y theta")
    angle = sympy.Symbol("angle")
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2 + theta.d**2) / 2, [sympy.sin(angle) * x.d - sympy.cos(angle) * y.d],
        inputs=[angle], q0=[0, 0, 0], v0=[1, 0, 0],
    )  # fmt: skip
    angles = np.array([0.0, 0.3, 0.5])
    run = dal.integrate(system, "leapfrog", h=0.5, steps=3, inputs=angles[:, None])
    speeds = np.cumprod(np.cos([0, 0.3, 0.2]))
    steps = speeds[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    np.testing.assert_allclose(run.v[1:, :2], steps, atol=1e-15)
    np.testing.assert_allclose(run.q[1:, :2], np.cumsum(steps, axis=0) / 2, atol=1e-15)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of the energy that is lost
        run = dal.integrate(system, "leapfrog", h=0.5, steps=2, inputs=[[0.0], [1.4]])
    assert run.energy[-1] < 0.1 * run.energy[0]
    with pytest.raises(NotImplementedError, match="inputs in its constraints, which do work"):
        dal.integrate(system, "leapfrog", h=0.5, steps=2, energy="keep")
    assert system.kind == "linear" and not system.conserves_energy
    found = system.check()
    assert found and "D changes with the inputs" in found.text and found.growth is None
    assert "(D changes with inputs)" in str(found) and "holonomic" not in str(found)


def test_many_driven_coordinates():
    """Constraints that are stored by their entries: twelve masses, each with a rate."""
    q = dal.coordinates([f"q{i}" for i in range(12)])
    u = sympy.symbols("u0:6")
    system = dal.System.from_sympy(
        sympy.Add(*(x.d**2 for x in q)) / 2,
        [q[2 * i].d - u[i] * q[2 * i + 1].d for i in range(6)],
        inputs=u, q0=[0] * 12, v0=[0, 1] * 6,
    )  # fmt: skip
    rates = np.array([[0.0] * 6, [0.5] * 6])
    run = dal.integrate(system, "leapfrog", h=1.0, steps=2, inputs=rates)
    np.testing.assert_allclose(run.v[-1], np.tile([0.4, 0.8], 6), atol=1e-15)
    np.testing.assert_allclose(run.q[-1], np.tile([0.4, 1.8], 6), atol=1e-15)
    assert run.residual.max() <= 48 * U


@pytest.mark.parametrize(
    "how, text",
    [
        ({"scheme": "midpoint-nodes", "initial": "D"}, "choose a scheme with moved nodes"),
        ({"scheme": "bm4", "h": "reversible"}, "inputs in its constraints"),
        ({"scheme": "leapfrog", "energy": "keep"}, "affine constraints"),
    ],
)
def test_refused_driven_runs(how, text):
    given = {"h": 0.1, "t_end": 1.0, **how}
    with pytest.raises(NotImplementedError, match=text):
        dal.integrate(moved_cart(), **given)


@pytest.mark.parametrize("events", [(), [lambda t, q, v: q[0] - 99]])
def test_a_jump_that_fails(events, in_python):
    x, y = dal.coordinates("x y")
    u = sympy.Symbol("u")
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2, [u * (x.d - 1)], inputs=[u], q0=[0, 0], v0=[1, 0]
    )
    with pytest.raises(dal.SingularError, match=r"the inputs of step 3 \(t = 2\): ") as error:
        dal.integrate(
            system, "leapfrog", h=1.0, steps=3, inputs=[[1.0], [2.0], [0.0]], events=events
        )
    np.testing.assert_array_equal(error.value.partial.q[:, 0], [0, 1, 2])


def test_refused_driven_systems(in_python):
    x, y = dal.coordinates("x y")
    u = sympy.Symbol("u")
    fast = dal.System.from_sympy(x.d**2 + y.d**2 + x.d**4, [x.d - u * y.d], inputs=[u])
    with pytest.raises(NotImplementedError, match="inputs in constraints: expected L quadratic"):
        dal.integrate(fast, "midpoint", [0, 0], [0, 1], h=0.1, steps=1)
    with pytest.raises(NotImplementedError, match="whose constraints depend on inputs"):
        moved_cart().deformed(lambda q, v: [0.0], 0.5, g_v=lambda q, v: np.zeros((1, 2)))
    for given, text in (
        ({"mu": lambda q, u: [[1.0]]}, "driven = True: expected inputs"),
        ({"inputs": 1}, "driven = True: expected constraints"),
        ({"inputs": 1, "mu": lambda q: [[1.0]]}, r"a function of \(q, u\)"),
    ):
        with pytest.raises(ValueError, match=text):
            dal.System(mass=[1.0], driven=True, **given)
    with pytest.raises(ValueError, match="pass driven=True"):
        dal.System(mass=[1.0], mu=lambda q, u: [[1.0]], inputs=1)
