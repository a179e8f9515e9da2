"""Events, resets and output times of runs, against motions that are known."""

import pickle

import numpy as np
import pytest
import sympy

import dalembert as dal
from conftest import U

EDGE = dal.systems.knife_edge()


def exact_time(g, low, high):
    """Where g of the exact motion changes its sign, by bisection."""
    sign = np.sign(g(low, *EDGE.exact(low)))
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if np.sign(g(middle, *EDGE.exact(middle))) == sign else (
            low, middle
        )  # fmt: skip
    return low


def through(t, q, v):
    return q[0] + 0.2 * v[1] * q[2] - 0.5


@pytest.mark.parametrize(
    "scheme, order, h", [("midpoint", 2, 0.04), ("leapfrog-kl6", 6, 0.2), ("leapfrog-kl8", 8, 0.3)]
)
def test_orders(scheme, order, h):
    expected = exact_time(through, 0.1, 1.5)
    errors = []
    for step in (h, h / 2):
        run = dal.integrate(EDGE, scheme, h=step, steps=round(2.4 / step), events=[through])
        t, q, v = run.t_events[0][0], run.q_events[0][0], run.v_events[0][0]
        assert EDGE.relative_residual(q, v) <= 4 * 3 * U
        x = np.concatenate(EDGE.exact(expected))
        errors.append(max(abs(t - expected), abs(np.concatenate([q, v]) - x).max()))
    assert abs(np.log2(errors[0] / errors[1]) - order) < 0.7


def test_forms_of_events():
    """A function, one with SciPy's attributes, an expression, an Event: the same places."""
    x, y, theta = dal.coordinates("x y theta")
    m, gs = sympy.symbols("m gs")

    def g(t, q, v):
        return q[0] - 0.4

    def growing(t, q, v):
        return q[0] - 0.4

    growing.direction = 1
    listed = [
        g, growing, x - sympy.Rational(2, 5), dal.Event(g, direction=-1), gs * x - 1,
        x.d * m - 2 * theta.d,
    ]  # fmt: skip
    run = dal.integrate(EDGE, h=0.05, t_end=4, events=listed)
    plain = dal.integrate(EDGE, h=0.05, t_end=4)
    np.testing.assert_array_equal(run.x, plain.x)  # who only looks changes nothing
    assert run.t_events[1].size > 0 and run.t_events[3].size > 0
    both = np.sort(np.concatenate([run.t_events[1], run.t_events[3]]))
    np.testing.assert_array_equal(run.t_events[0], both)
    np.testing.assert_allclose(run.t_events[2], both, atol=1e-14)
    np.testing.assert_allclose(run.t_events[4], both, atol=1e-13)
    v, q = run.v_events[5], run.q_events[5]
    np.testing.assert_allclose(v[:, 0] * 2 - 2 * v[:, 2], 0, atol=1e-13)
    assert q.shape == v.shape and np.isnan(run.q_after[0]).all()
    copy = pickle.loads(pickle.dumps(run))
    np.testing.assert_array_equal(copy.q_events[5], q)


def test_expressions_without_a_compiler(monkeypatch):
    x, y, theta = dal.coordinates("x y theta")
    monkeypatch.setenv("CC", "none-such")
    both = [x * theta.d - sympy.Rational(1, 3), lambda t, q, v: q[0] * v[2] - 1 / 3]
    run = dal.integrate(EDGE, h=0.05, t_end=2, events=both)
    assert len(run.t_events[0]) == 2
    np.testing.assert_allclose(*run.t_events, atol=1e-14)


def test_terminal():
    def stop(t, q, v):
        return q[2] - 1.0

    stop.terminal = True
    run = dal.integrate(EDGE, "leapfrog-kl6", h=0.05, t_end=4, stride=2, events=[stop])
    end = 0.8 / 1.2
    assert run.success and run.status == 1 and run.message.startswith("events[0] ended the run")
    assert abs(run.t[-1] - end) < 1e-12 and run.t[-2] == pytest.approx(0.6)
    np.testing.assert_allclose(run.q[-1], EDGE.exact(end)[0], atol=1e-9)
    np.testing.assert_array_equal(run.x[-1], run.x_events[0][0])
    assert len(run.reactions) == len(run.t) - 1 and len(run.energy) == len(run.t)
    assert run.residual.max() <= 4 * 3 * U
    # the mean force over the last, shorter interval, by the exact motion
    middle = np.linspace(run.t[-2], end, 2001)
    q, v = EDGE.exact((middle[1:] + middle[:-1]) / 2)
    assert abs(EDGE.multipliers(q, v).mean() - run.reactions[-1, 0]) < 1e-7
    np.testing.assert_array_equal(run(run.t[-1]).q, run.q[-1])
    np.testing.assert_array_equal(run(run.t[:-1]).q, run.q[:-1])
    with pytest.raises(ValueError, match="between the two stored states"):
        run(0.63)
    stop.terminal = 2
    turning = dal.Event(lambda t, q, v: np.sin(q[2]), terminal=3)
    longer = dal.integrate(EDGE, h=0.05, t_end=40, events=[stop, turning])
    assert longer.q[-1, 2] == pytest.approx(3 * np.pi) and len(longer.t_events[1]) == 3


@pytest.mark.parametrize("nodes", ["midpoint", "midpoint-nodes"])
def test_resets(nodes):
    """A blade that is turned back at a wall retraces its way, and is turned back there again."""
    wall = dal.Event(lambda t, q, v: q[0] - 0.4, direction=1, reset=lambda q, v: (q, -v))
    initial = {"initial": "shift"} if nodes != "midpoint" else {}
    run = dal.integrate(EDGE, nodes, h=0.005, t_end=1.5, events=[wall], **initial)
    (T,) = run.t_events[0]
    assert abs(T - exact_time(lambda t, q, v: q[0] - 0.4, 0.1, 1.0)) < 1e-5
    np.testing.assert_array_equal(run.v_after[0], -run.v_events[0])
    assert EDGE.relative_residual(run.q_after[0][0], run.v_after[0][0]) <= 4 * 3 * U
    assert run.residual.max() <= 8 * 3 * U
    q = run.q[-1] - run.shift * run.v[-1]
    np.testing.assert_allclose(q, EDGE.exact(2 * T - 1.5)[0], atol=1e-4)
    row = int(np.searchsorted(run.t, T))
    with pytest.raises(ValueError, match="the state was reset"):
        run((run.t[row - 1] + run.t[row]) / 2)
    for k in (row - 1, row, row + 1):  # on both sides of it, from its own side
        np.testing.assert_array_equal(run(run.t[k]).q, run.q[k])
    side = run(run.t[row] + 0.0025)
    moved = side.q - run.shift * side.v
    np.testing.assert_allclose(moved, EDGE.exact(2 * T - side.t)[0], atol=1e-4)


@pytest.mark.parametrize("compiler", ["cc", "none-such"])
def test_resets_that_are_expressions(compiler, monkeypatch):
    """A ball from height 2 keeps e of its speed at each bounce: the motion is known."""
    height, (e, g) = dal.coordinates("height")[0], sympy.symbols("e g")
    ball = dal.System.from_sympy(
        height.d**2 / 2 - g * height, parameters={e: 0.75, g: 9.0}, q0=[2], v0=[0]
    )
    monkeypatch.setenv("CC", compiler)
    reset = {height.d: -e * height.d}
    floor = dal.Event(height, direction=-1, reset=reset)
    run = dal.integrate(ball, h=0.01, t_end=1.5, events=[floor])
    fall, speed = 2 / 3, 6.0
    bounces = [fall, fall + 2 * 0.75 * speed / 9]
    np.testing.assert_allclose(run.t_events[0], bounces[: len(run.t_events[0])], atol=1e-12)
    rest = 1.5 - fall
    expected = [0.75 * speed * rest - 4.5 * rest**2, 0.75 * speed - 9 * rest]
    np.testing.assert_allclose(run.x[-1], expected, rtol=0, atol=1e-11)
    swapped = dal.Event(height, direction=-1, reset={"height": height.d, "v_height": height + 1})
    run = dal.integrate(ball, h=0.01, t_end=0.7, events=[swapped])
    np.testing.assert_allclose(run.x_after[0][0], [-6, 1], atol=1e-12)
    for key in ("speed", sympy.Symbol("w")):
        wrong = dal.Event(height, reset={key: 1})
        with pytest.raises(ValueError, match=rf"reset: {key} is neither a coordinate nor a velo"):
            dal.integrate(ball, h=0.01, t_end=1, events=[wrong])


@pytest.mark.parametrize("scheme", ["leapfrog", "midpoint"])
def test_walls_within_rounding_of_a_step(scheme):
    """A free particle turns at a wall at k h, whose g there is a rounding of either sign."""
    free = dal.System(mass=[1])
    for k in range(1, 20):
        wall = 0.1 * k
        turn = dal.Event(lambda t, q, v: q[0] - wall, direction=1, reset=lambda q, v: (q, -v))
        run = dal.integrate(free, scheme, [0], [1], h=0.1, t_end=2, events=[turn])
        assert abs(run.t_events[0] - wall).max() < 1e-14 and len(run.t_events[0]) == 1
        assert abs(run.q[-1, 0] - (2 * wall - 2)) < 1e-14


def test_reset_onto_D_on_request():
    off = {"direction": 1, "reset": lambda q, v: (q, [0, -1, v[2]])}
    g = lambda t, q, v: q[0] - 0.4  # noqa: E731
    text = r"after the reset of event 0 at t = 0\.45.*Give the event consistent='project'"
    with pytest.raises(dal.NotOnConstraintError, match=text):
        dal.integrate(EDGE, h=0.05, t_end=2, events=[dal.Event(g, **off)])
    run = dal.integrate(EDGE, h=0.05, t_end=2, events=[dal.Event(g, consistent="project", **off)])
    q, v = run.q_after[0][0], run.v_after[0][0]
    expected = EDGE.project(q, [0, -1, run.v_events[0][0, 2]])
    np.testing.assert_allclose(v, expected, atol=1e-14)


def test_balls():
    """Bounces at their times; accumulating, they end in an error that has what came before."""
    def ball(restitution):
        system = dal.System(
            mass=[1], potential=lambda q: 9 * q[0], gradient=lambda q: [9.0], q0=[2], v0=[0]
        )
        floor = dal.Event(lambda t, q, v: q[0], reset=lambda q, v: (q, -restitution * v))
        return dal.integrate(system, h=0.01, t_end=4, events=[floor])

    run = ball(1.0)
    np.testing.assert_allclose(run.t_events[0], [2 / 3, 2, 10 / 3], atol=1e-12)
    assert abs(run.energy - 18).max() < 1e-11
    with pytest.raises(dal.ZenoError, match="repeats without end|accumulate") as caught:
        ball(0.5)
    partial = caught.value.partial
    assert 1.99 < partial.t[-1] <= 2.001 and partial.q.min() > -1e-12
    assert len(partial.t_events[0]) > 5


def test_doubt_is_said():
    spring = dal.System(mass=[1], potential=lambda q: 9 * q[0], gradient=lambda q: [9.0],
                        q0=[0], v0=[3])  # fmt: skip
    with pytest.warns(dal.DalembertWarning, match=r"events\[0\] comes close to zero.*t = 0\.333"):
        dal.integrate(spring, h=0.31, steps=3, events=[lambda t, q, v: q[0] - 0.5])


@pytest.mark.parametrize("scheme", ["midpoint", "leapfrog-kl6", "reference"])
@pytest.mark.parametrize("h", [0.05, -0.05])
def test_t_eval(scheme, h):
    times = np.sort(np.random.default_rng(2).uniform(0, 60 * abs(h), 40)) * np.sign(h)
    times = np.concatenate([[0.0], times, [60 * h]])
    run = dal.integrate(EDGE, scheme, h=h, steps=60, t_eval=times)
    np.testing.assert_array_equal(run.t, times)
    error = abs(run.q - EDGE.exact(times)[0]).max()
    assert error < {"midpoint": 2e-2, "leapfrog-kl6": 1e-9, "reference": 1e-11}[scheme]
    assert run.residual.max() <= 4 * 3 * U
    plain = dal.integrate(EDGE, scheme, h=h, steps=60)
    np.testing.assert_array_equal(run.x[[0, -1]], plain.x[[0, -1]])
    assert np.isnan(run.reactions).all() and run.reactions.shape == (41, 1)
    with pytest.raises(ValueError, match="t_eval"):
        run(times[3])


@pytest.mark.parametrize("scheme", ["midpoint", "midpoint-nodes", "endpoint-nodes"])
def test_the_end_behind_output_times(scheme):
    """A run that an event ends has its last state as it has the others: of the kept nodes."""
    wall = dal.Event(lambda t, q, v: q[0] - 0.4, terminal=True)
    given = {"h": 0.02, "t_end": 2, "events": [wall]}
    if scheme != "midpoint":
        given["initial"] = "shift"
    rows = dal.integrate(EDGE, scheme, **given)
    timed = dal.integrate(EDGE, scheme, t_eval=[0.1, 0.2, 1.9], **given)
    assert timed.t[-1] == rows.t[-1] < 1.9 and len(timed.t) == 3
    np.testing.assert_array_equal(timed.x[-1], rows.x[-1])
    assert timed.residual.max() <= 4 * 3 * U


def test_t_eval_with_forces_in_time_and_inputs():
    """The multipliers of a row are those at its time, with its inputs."""
    system = dal.System(
        mass=[1, 1], mu=lambda q: [[1.0, -1.0]], inputs=["u"],
        force=lambda t, q, v, u: [u[0] + np.sin(t), 0.0], q0=[0, 0], v0=[0, 0],
    )  # fmt: skip
    times, inputs = [0.05, 0.1, 0.23, 0.4], [[1.0], [2.0], [3.0], [4.0]]
    run = dal.integrate(system, h=0.1, steps=4, t_eval=times, inputs=inputs)
    row = np.array([1.0, 2.0, 3.0, 4.0])
    expected = -(row + np.sin(times)) / 2
    np.testing.assert_allclose(run.multipliers[:, 0], expected, atol=1e-14)


@pytest.mark.parametrize(
    "given, text",
    [
        ({"events": "x"}, "events = 'x': expected a sequence"),
        ({"events": [3]}, r"events\[0\] = 3"),
        ({"events": [lambda t, q: 1.0]}, r"expected a function of \(t, q, v\)"),
        ({"events": [sympy.Symbol("w")]}, r"events\[0\]: w is neither"),
        ({"events": [sympy.Symbol("x") > 1]}, r"events\[0\] = x > 1 is a condition"),
        ({"events": [sympy.Eq(sympy.Symbol("x"), 1)]}, r"events\[0\] = Eq\(x, 1\) is a condition"),
        ({"events": [lambda t, q, v: q[0] > 1]}, r"events\[0\] returned False, a condition"),
        ({"events": [lambda t, q, v: bool(q[0] < 1)]}, r"events\[0\] returned True, a condition"),
        ({"events": [dal.Event(through, terminal=-1)]}, r"events\[0\].terminal = -1"),
        ({"events": [dal.Event(through, direction="up")]}, r"events\[0\].direction = 'up'"),
        ({"events": [dal.Event(through, reset=3)]}, r"events\[0\].reset = 3"),
        ({"events": [dal.Event(through, consistent="no")]}, r"events\[0\].consistent = 'no'"),
        ({"t_eval": [0.0, 1.0]}, r"t_eval contains 1\.0: expected"),
        ({"t_eval": [0.2, 0.1]}, "in the order of the run"),
        ({"t_eval": []}, "at least one time"),
        ({"t_eval": [np.nan]}, "t_eval"),
    ],
)
def test_refused(given, text):
    with pytest.raises(ValueError, match=text):
        dal.integrate(EDGE, h=0.1, steps=3, **given)


def test_failures():
    for g, error in (
        (lambda t, q, v: np.nan if t > 0.55 else 1.0, dal.DomainError),
        (lambda t, q, v: [1.0, 2.0], ValueError),
        (lambda t, q, v: 1.0 if t < 0.55 else 1 / 0, ZeroDivisionError),
    ):
        with pytest.raises(error) as caught:
            dal.integrate(EDGE, h=0.1, steps=10, events=[g])
        if error is not ValueError:
            assert len(caught.value.partial.t) == 6
    with pytest.raises(ValueError, match=r"the reset of events\[0\] returned .* expected 2 arrays"):
        dal.integrate(EDGE, h=0.1, steps=10, events=[dal.Event(through, reset=lambda q, v: q)])
    adams = dal.Scheme.flow("msadams")
    with pytest.raises(NotImplementedError, match="does not support events"):
        dal.integrate(EDGE, adams, h=0.1, steps=10, events=[through])
