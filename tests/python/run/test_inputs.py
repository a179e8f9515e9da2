"""Inputs of the force, and steps by hand: a cart on a blade whose motion is solved on its own."""

import pickle

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
        mass=[M, M, J], forms=lambda q: [[np.sin(q[2]), -np.cos(q[2]), 0]],
        forms_velocity_derivative=lambda q, v: [
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
def cart(request, monkeypatch):
    if request.param == "functions":
        return from_functions()
    if request.param == "without a compiler":
        monkeypatch.setenv("CC", "none-such")
        with pytest.warns(dal.DalembertWarning, match="no C compiler"):
            return from_sympy()
    return from_sympy()


def table(count, seed=3):
    return np.random.default_rng(seed).normal(size=(count, 2))


def solved(inputs, length):
    """The state and the work of the motors and the brake, each row of inputs for a time."""
    y = np.array([*START, SPEED, TURN, 0.0])
    for left, right in inputs:
        def rates(t, y, left=left, right=right):
            ahead = left + right - BRAKE * y[3]
            return [
                y[3] * np.cos(y[2]), y[3] * np.sin(y[2]), y[4], ahead / M, (right - left) / J,
                ahead * y[3] + (right - left) * y[4],
            ]  # fmt: skip

        y = solve_ivp(rates, (0, length), y, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    return np.array([*y[:3], y[3] * np.cos(y[2]), y[3] * np.sin(y[2]), y[4]]), y[5]


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
        (lambda x, u, w: {"inputs": [u]}, "inputs: u does not act"),
        (lambda x, u, w: {"inputs": [u, w], "force": {x: u}}, "inputs: w does not act"),
        (lambda x, u, w: {"inputs": [u, u], "force": {x: u}}, "inputs: u is there twice"),
        (lambda x, u, w: {"inputs": ["u"], "force": {x: u}}, "'u': expected a symbol"),
        (lambda x, u, w: {"inputs": "u", "force": {x: u}}, "inputs = 'u': expected a sequence"),
        (lambda x, u, w: {"inputs": [w], "force": {x: w * u}}, "force.*: u is neither"),
        (lambda x, u, w: {"inputs": [u], "force": {x: u}, "parameters": {u: 1}}, "u is the name"),
        (
            lambda x, u, w: {"inputs": [u], "force": {x: u}, "constraints": [x.d - u]},
            "u is an input; only a force",
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
        ({"inputs": ["a"]}, "there is no force"),
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
    with pytest.raises(ValueError, match="takes no inputs"):
        dal.systems.particle().field([0, 1, 0], [1, 1, 1], inputs=[1.0])


# ---- runs --------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme, order", [("midpoint", 2), ("leapfrog", 2), ("midpoint-kl6", 6)])
def test_orders(scheme, order):
    """Full order in the states, and of the energy balance, with inputs that jump."""
    inputs, cart = table(4), from_sympy()
    expected, work = solved(inputs, 0.4)
    errors = []
    for hold in (3, 6) if order == 6 else (8, 16):
        run = dal.integrate(cart, scheme, h=0.4 / hold, steps=4 * hold, inputs=inputs, hold=hold)
        balance = abs(run.energy[-1] - run.energy[0] - work)
        errors.append([abs(run.x[-1] - expected).max(), balance])
        assert run.residual.max() <= 4 * 3 * U
    slopes = np.log2(np.divide(*errors))
    assert (slopes > order - 0.4).all() and slopes[0] < order + 1
    reference = dal.integrate(cart, "reference", h=0.1, steps=16, inputs=inputs, hold=4)
    np.testing.assert_allclose(reference.x[-1], expected, atol=1e-11)


@pytest.mark.parametrize("hold, stride", [(1, 1), (3, 4), (5, 2), (40, 1)])
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
        mass=[1, 1], forms=lambda q: [[0, 1]], force=lambda t, q, v, u: [0, u[0]], inputs=1
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
        ({"inputs": lambda t, q, v: [1.0]}, "inputs: expected shape"),
        ({"inputs": lambda t, q, v: None}, r"inputs has to return shape \(2,\), it returned None"),
        ({"inputs": lambda t, q, v: np.array([1.0, np.inf])}, r"step 1 \(t = 0\): u\[1\] = inf"),
        ({"inputs": lambda t, q, v: np.ones(3)}, "inputs has to return shape"),
        ({"inputs": lambda t: [1.0, 1.0]}, r"expected one of \(t, q, v\)"),
        ({"inputs": {"left": 1.0}}, "right is missing"),
        ({"hold": 2}, "hold = 2 has no effect without inputs"),
        ({"inputs": [0.0, 0.0], "hold": 0}, "hold = 0"),
    ],
)
def test_refused_inputs_of_runs(given, text):
    with pytest.raises(ValueError, match=text):
        dal.integrate(from_sympy(), h=0.1, steps=4, **given)
    with pytest.raises(ValueError, match="takes no inputs"):
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
def test_expressions_are_held(compiler, h, monkeypatch):
    """Leapfrog is exact under a constant force, so that the motion is known in closed form."""
    x, (gain, push) = dal.coordinates("x")[0], sympy.symbols("gain push")
    system = spring()
    monkeypatch.setenv("CC", compiler)
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
    """Of symbols, of dynamicsymbols and of names, with the time and parameters."""
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
        ({"left": x, "rigt": 1}, "inputs: rigt is no input; did you mean 'right'"),
        ({"left": x, "right": [1, 2]}, r"inputs\['right'\]"),
        ({"left": x, "right": sympy.Symbol("w")}, r"inputs\['right'\]: w is neither a coordinate"),
        ({"left": sympy.sqrt(-theta), "right": 0}, r"inputs of step 1 \(t = 0\): u\[0\] = -?nan"),
    ):
        with pytest.raises(ValueError, match=text):
            dal.integrate(from_sympy(), h=0.1, steps=4, inputs=given)
    with pytest.raises(ValueError, match="left is no input; expected none"):
        dal.integrate(dal.systems.particle(), h=0.1, steps=4, inputs={"left": x})
    with pytest.raises(ValueError, match="hold: needed with h = 'auto'"):
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
        mass=sleigh.mass, forms=lambda q: [[np.sin(q[2]), -np.cos(q[2]), 0]], force=force
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


@pytest.mark.parametrize("h", [0.05, -0.05])
@pytest.mark.parametrize(("stride", "hold"), [(1, 3), (2, 3), (3, 1), (1, 60)])
@pytest.mark.parametrize("scheme", ["leapfrog-kl8", "midpoint-kl6", "reference"])
def test_states_between_stored_ones_are_those_of_the_inputs(scheme, stride, hold, h):
    system = dal.System(mass=[1], force=lambda t, q, v, u: [u[0] - v[0]], inputs=["u"])
    table = np.resize([10.0, -3.0, 0.0, 10.0, 2.0], 60 // hold)
    run = dal.integrate(
        system, scheme, [0], [0], h=h, steps=60, stride=stride, inputs=table[:, None], hold=hold
    )

    def velocity(t):  # v' = u - v
        v, held = 0.0, hold * abs(h)
        for k, u in enumerate(table):
            passed = np.sign(h) * min(abs(t) - k * held, held)
            v = u + (v - u) * np.exp(-passed)
            if (k + 1) * held >= abs(t):
                return v

    times = np.linspace(0.01, 3, 61) * np.sign(h)
    exact = [velocity(t) for t in times]
    np.testing.assert_allclose(run(times).v[:, 0], exact, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(run(times[::-1]).v[::-1], run(times).v)  # in any order
    np.testing.assert_array_equal(run(run.t).v, run.v)


def test_states_between_kept_nodes_are_refused():
    system = dal.System(mass=[1], force=lambda t, q, v, u: u, inputs=["u"], q0=[0], v0=[1])
    run = dal.integrate(
        system, "explicit-nodes", h=0.1, steps=4, inputs=[1.0], initial="project"
    )
    with pytest.raises(ValueError, match="t: between states of 'explicit-nodes' with inputs"):
        run(0.05)
