"""Python functions called from C: what they get, what they may return and raise, Ctrl-C."""

import contextlib
import os
import re
import signal
import threading
import time
import traceback
import warnings

import numpy as np
import pytest

import dalembert as dal
from dalembert.core import arguments
from dalembert.geometry import examine

H = 0.05
FUNCTIONS = ["mu", "mu_v_q", "potential", "gradient", "hessian"]


class Mine(Exception):
    """An exception that the package does not know."""


def failing(function, at, error):
    """Return ``function`` with an exception at call number ``at``, counted from 0."""
    count = 0

    def deep_inside():
        raise error

    def wrapped(*arguments):
        nonlocal count
        count += 1
        if count == at + 1:
            deep_inside()
        return function(*arguments)

    wrapped.calls = lambda: count
    return wrapped


# ---- what functions get and return ---------------------------------------------------------


def test_writing_to_an_argument_is_refused(own):
    def gradient(q):
        q[0] = 0.0
        return q

    with pytest.raises(ValueError, match="read-only"):
        own.system(gradient=gradient).acceleration(own.q0, own.v0())


def in_one_buffer(buffers):
    """Return a function that gives arrays of a shape in the same memory each time."""

    def give(a):
        buffer = buffers.setdefault(a.shape, np.empty(a.shape))
        buffer[...] = a
        return buffer

    return give


def unaligned(a):
    b = np.empty(a.nbytes + 1, np.uint8)[1:].view(float).reshape(a.shape)
    b[...] = a
    return b


@pytest.mark.parametrize(
    "kind",
    [
        lambda a: a.tolist(),
        lambda a: [np.array(row) for row in a],
        lambda a: np.broadcast_to(a, a.shape),  # read-only
        lambda a: np.ascontiguousarray(a[::-1])[::-1],
        in_one_buffer({}),
        unaligned,
        np.asfortranarray,
        lambda a: np.repeat(a, 2, axis=-1)[..., ::2],
        lambda a: a.astype(np.longdouble),
        lambda a: a.astype(object),
        lambda a: a.astype(">f8"),
    ],
)
def test_anything_array_like_may_be_returned(own, kind):
    expected = dal.integrate(own.system(), "midpoint", h=H, steps=5)
    changes = {
        "mu": lambda q: kind(own.mu(q)),
        "mu_v_q": lambda q, v: kind(own.mu_v_q(q, v)),
        "gradient": lambda q: kind(own.gradient(q)),
        "hessian": lambda q: kind(own.hessian(q)),
    }
    run = dal.integrate(own.system(**changes), "midpoint", h=H, steps=5)
    np.testing.assert_array_equal(run.x, expected.x)


def test_arguments_are_aligned():
    given = unaligned(np.arange(3.0))
    taken = arguments.array(given, "q", (3,))
    assert taken.flags.aligned and not given.flags.aligned
    np.testing.assert_array_equal(taken, given)


def test_an_argument_may_be_returned():
    """The gradient of V = q.q/2 is q, the very array that was given; the force v is v."""
    system = dal.System(
        mass=[1, 1],
        potential=lambda q: q @ q / 2,
        gradient=lambda q: q,
        hessian=lambda q: np.eye(2),
    )
    # Half a period of the midpoint rule, (1 - i h/2) / (1 + i h/2) = exp(-i h') in q + i v.
    h = 2 * np.tan(np.pi / 20)
    run = dal.integrate(system, "midpoint", [0.3, 0.0], [0.0, -1.2], h=h, steps=10)
    # 10 steps with the roundoff of a few numbers of size 1
    np.testing.assert_allclose(run.x[-1], [-0.3, 0.0, 0.0, 1.2], rtol=0, atol=2e-14)
    pushed = dal.System(mass=[1, 1], force=lambda t, q, v: v)
    np.testing.assert_array_equal(pushed.acceleration([0, 0], [2, 3]), [2, 3])


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (5, r"exact returned 5: expected 2 arrays of shape \(2,\)"),
        (None, "returned None: expected"),
        (([0, 0],), r"returned \(\[0, 0\],\): expected"),
        (([0, 0], [0, 0], 1), "expected 2 arrays"),
        (([0, 0], "x"), r"exact \(v\) returned no real numbers .* shape \(2,\)"),
        (([0, 0], [0]), r"exact \(v\) returned shape \(1,\): expected \(2,\)"),
    ],
)
def test_an_exact_solution_that_is_none_is_named(value, text):
    system = dal.System(mass=[1, 1], exact=lambda t, q, v: value, q0=[0, 0], v0=[1, 1])
    with pytest.raises(ValueError, match=text):
        system.exact(1.0)


@pytest.mark.parametrize("value", [2, np.float32(2), np.array(2.0), np.float64(2), True * 2])
def test_potential_may_be_any_number(value):
    system = dal.System(mass=[1], potential=lambda q: value, gradient=lambda q: [0])
    assert system.energy([0], [2]) == 4.0


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("mu", np.ones(4), r"mu returned shape \(4,\): expected \(2, 4\)"),
        ("mu", np.ones((4, 2)), r"mu returned shape \(4, 2\): expected \(2, 4\)"),
        ("mu", None, r"mu returned no real numbers .* shape \(2, 4\)"),
        ("mu", [[1, 2], [3]], "mu returned no real numbers"),
        ("mu", "text", "mu returned no real numbers"),
        ("mu", 1j * np.ones((2, 4)), "mu returned no real numbers .*complex"),
        ("mu_v_q", np.ones((2, 3)), r"mu_v_q .*\(2, 3\)"),
        ("gradient", np.ones((4, 1)), r"gradient returned shape \(4, 1\): expected \(4,\)"),
        ("gradient", 0.0, r"gradient returned shape \(\): expected \(4,\)"),
        ("hessian", np.ones(4), r"hessian returned shape \(4,\): expected \(4, 4\)"),
        ("potential", np.ones(1), r"potential returned shape \(1,\): expected \(\)"),
    ],
)
def test_wrong_shapes_name_the_function(own, name, value, text):
    system = own.system(**{name: lambda *arguments: value}, m=2)
    with pytest.raises(ValueError, match=text):
        everything(system)


def everything(system):
    """Make the core ask for every output of every function."""
    system.check()
    run = dal.integrate(system, "midpoint", h=H, steps=2)
    return run.energy, run.multipliers


# ---- what functions raise ------------------------------------------------------------------


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("error", [Mine("here"), SystemExit(3), KeyboardInterrupt()])
def test_exceptions_come_back_as_themselves(own, name, error):
    wrapped = failing(getattr(own, name), 0, error)
    with pytest.raises(type(error)) as caught:
        everything(own.system(**{name: wrapped}, m=2))
    assert caught.value is error
    names = [frame.name for frame in traceback.extract_tb(caught.tb)]
    assert "deep_inside" in names and "everything" in names


@pytest.mark.parametrize("scheme", ["midpoint", "leapfrog", "reference", "midpoint-suzuki4"])
def test_every_call_of_a_run_may_fail(own, scheme):
    steps = 4
    counting = failing(own.mu, -1, None)
    whole = dal.integrate(own.system(mu=counting, m=2), scheme, h=H, steps=steps)
    rows = []
    for k in range(counting.calls()):
        error = Mine(k)
        system = own.system(mu=failing(own.mu, k, error), m=2)
        with pytest.raises(Mine) as caught:
            dal.integrate(system, scheme, h=H, steps=steps)
        assert caught.value is error
        partial = getattr(error, "partial", None)
        if partial is None:  # before the first step
            assert not rows or rows[-1] <= 1
            continue
        np.testing.assert_array_equal(partial.x, whole.x[: len(partial.x)])
        assert not partial.success and "Mine" in partial.message
        rows.append(len(partial.x))
    assert rows == sorted(rows)
    assert set(rows) == set(range(1, steps + 1))


def test_a_study_does_not_swallow_exceptions(own):
    """To the core a run that fails is a point of the study; an exception of the user is not."""
    counting = failing(own.mu, -1, None)
    dal.convergence(own.system(mu=counting, m=2), "midpoint", t_end=0.5)
    for k in np.linspace(0, counting.calls() - 1, 12, dtype=int):
        error = Mine(k)
        system = own.system(mu=failing(own.mu, k, error), m=2)
        with pytest.raises(Mine) as caught:
            dal.convergence(system, "midpoint", t_end=0.5)
        assert caught.value is error


def test_a_run_goes_through_after_a_failure(own):
    system = own.system(mu=failing(own.mu, 7, Mine()), m=2)
    with pytest.raises(Mine):
        dal.integrate(system, "midpoint", h=H, steps=10)
    run = dal.integrate(system, "midpoint", h=H, steps=10)
    np.testing.assert_array_equal(run.x, dal.integrate(own.system(), "midpoint", h=H, steps=10).x)


@pytest.mark.parametrize("name", ["mu", "gradient"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nan_is_a_domain_error(own, name, value):
    function, count = getattr(own, name), 0

    def wrapped(q):
        nonlocal count
        count += 1
        return np.full_like(function(q), value) if count > 20 else function(q)

    with pytest.raises(dal.DomainError) as caught:
        dal.integrate(own.system(**{name: wrapped}, m=2), "midpoint", h=H, steps=100)
    assert 1 <= caught.value.step < 20
    assert len(caught.value.partial.x) == caught.value.step + 1
    assert np.isfinite(caught.value.partial.x).all()


def test_domain_error_of_the_user(own):
    # In D_q a motion along q0 > 0.35 is refused; the initial q0 is 0.3 and grows.
    outside = dal.DomainError("q0 is too large")

    def forms(q):
        if q[0] > 0.35:
            raise outside
        return own.mu(q)

    system = own.system(mu=forms, m=2)
    free = dal.integrate(own.system(), "midpoint", h=H, steps=100)
    assert free.q[:, 0].max() > 0.35
    with pytest.raises(dal.DomainError, match="too large") as caught:
        dal.integrate(system, "midpoint", h=H, steps=100)
    assert caught.value is outside
    assert caught.value.partial.q[:, 0].max() <= 0.35
    assert outside.step == len(caught.value.partial.t) - 1 > 0 and outside.t == outside.step * H
    assert dal.integrate(system, "midpoint", h=H, steps=100, throw=False).success is False


def test_a_domain_error_shortens_the_step():
    """V = q - log(q)/100 for q > 0: Newton's first step from q = 1 ends at q < 0."""
    refused = []

    def inside(q, value):
        if q[0] <= 0:
            refused.append(dal.DomainError(f"q = {q[0]} is behind the wall"))
            raise refused[-1]
        return value

    def run(max_iterations):
        refused.clear()
        return dal.integrate(
            system, "midpoint", [1], [0], h=1.5, steps=1, max_iterations=max_iterations
        )

    system = dal.System(
        mass=[1],
        potential=lambda q: inside(q, q[0] - np.log(q[0]) / 100),
        gradient=lambda q: inside(q, [1 - 1 / (100 * q[0])]),
        hessian=lambda q: inside(q, [[1 / (100 * q[0] ** 2)]]),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", dal.DalembertWarning)  # h is large, that is the point
        assert run(50).stats.halvings > 0 and refused
    # What was overcome is not what a later call failed of, in C or outside of its domain.
    broken = dal.System(mass=[1], potential=lambda q: 0, gradient=lambda q: [np.nan])
    with pytest.raises(dal.DomainError, match="gradient.0. = nan"):
        broken.acceleration([0], [0])
    with pytest.raises(dal.ConvergenceError, match="Newton did not converge in 2 iterations"):
        run(2)
    assert refused


def test_a_function_may_integrate(own):
    """An inner run that fails and is caught does not disturb the outer one."""
    inner = own.system(gradient=failing(own.gradient, 5, Mine()))

    def gradient(q):
        with contextlib.suppress(Mine):
            dal.integrate(inner, "midpoint", h=H, steps=3)
        return own.gradient(q)

    run = dal.integrate(own.system(gradient=gradient), "midpoint", h=H, steps=3)
    np.testing.assert_array_equal(run.x, dal.integrate(own.system(), "midpoint", h=H, steps=3).x)


def test_nothing_is_printed(own, capfd):
    with pytest.raises(Mine):
        dal.integrate(own.system(gradient=failing(own.gradient, 9, Mine())), h=H, steps=20)
    assert capfd.readouterr() == ("", "")


# ---- observers -----------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["midpoint", "reference"])
@pytest.mark.parametrize(("steps", "stride"), [(500, 1), (500, 5), (40_000, 20_000)])
def test_an_observer_sees_every_stored_state_once(particle, scheme, steps, stride):
    seen = []
    run = dal.integrate(
        particle, scheme, h=1e-4, steps=steps, stride=stride, t0=2.0,
        observer=lambda step, t, q, v: seen.append((step, t, *q, *v)),
    )  # fmt: skip
    assert [s[0] for s in seen] == list(range(0, steps + 1, stride))
    np.testing.assert_array_equal([s[1] for s in seen], run.t)
    np.testing.assert_array_equal([s[2:] for s in seen], run.x)


@pytest.mark.parametrize("scheme", ["midpoint", "reference"])
@pytest.mark.parametrize("at", [0, 1, 37, 100])
def test_an_observer_may_stop(particle, scheme, at):
    run = dal.integrate(
        particle, scheme, h=0.01, steps=100, observer=lambda step, t, q, v: step >= at
    )
    assert run.success and run.status == 1 and "observer" in run.message
    assert len(run.x) == at + 1 and run.reactions.shape == (at, 1)
    whole = dal.integrate(particle, scheme, h=0.01, steps=100)
    np.testing.assert_array_equal(run.x, whole.x[: at + 1])


@pytest.mark.parametrize("scheme", ["midpoint", "reference"])
def test_an_observer_says_whether_to_stop(particle, scheme):
    text = r"observer returned array\(\[0\., 1\.\]\): expected True"
    with pytest.raises(ValueError, match=text):
        dal.integrate(particle, scheme, h=0.1, steps=3, observer=lambda *_: np.arange(2.0))


@pytest.mark.parametrize("stride", [1, 20_000])
@pytest.mark.parametrize("scheme", ["midpoint", "reference"])
def test_an_observer_may_raise(particle, scheme, stride):
    error = Mine()
    observer = failing(lambda *state: None, 3, error)
    with pytest.raises(Mine) as caught:
        dal.integrate(particle, scheme, h=1e-5, steps=5 * stride, stride=stride, observer=observer)
    assert caught.value is error and len(error.partial.x) == 4


def test_progress_may_raise(particle):
    with pytest.raises(Mine) as caught:
        dal.integrate(particle, h=0.01, steps=100, progress=failing(print, 0, Mine()))
    assert len(caught.value.partial.x) > 1


# ---- Ctrl-C --------------------------------------------------------------------------------


class Interrupt:
    """Press Ctrl-C a moment after the start, or after the first progress that a run shows."""

    def __init__(self):
        self.timer = threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT))
        self.began = None

    def start(self):
        self.began = time.perf_counter()
        self.timer.start()

    def progress(self, done, total):
        if self.began is None:
            self.start()


@pytest.fixture
def interrupt():
    """The handler is Python's, whatever started the tests."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    press = Interrupt()
    yield press
    press.timer.cancel()
    if press.began is not None:
        press.timer.join()
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("stride", [1_000, 10**8])
def test_ctrl_c_in_a_run_of_c(particle, interrupt, stride):
    with pytest.raises(KeyboardInterrupt) as caught:
        dal.integrate(
            particle, "midpoint", h=1e-6, steps=10**9, stride=stride, progress=interrupt.progress
        )
    # A block takes about 0.1 s, the run would take a minute.
    assert time.perf_counter() - interrupt.began < 20
    partial = caught.value.partial
    assert not partial.success and "KeyboardInterrupt" in partial.message
    assert len(partial.x) > 1 or stride > 1_000
    assert np.isfinite(partial.x).all()


def test_ctrl_c_in_a_run_of_the_reference_flow(own, interrupt):
    with pytest.raises(KeyboardInterrupt) as caught:
        dal.integrate(own.system(), "reference", h=0.1, steps=10**6, progress=interrupt.progress)
    assert len(caught.value.partial.x) > 1 and np.isfinite(caught.value.partial.x).all()


LONG = {
    "reference": lambda one: dal.reference(one, t=1e7),
    "reference, msadams": lambda one: dal.reference(one, t=1e7, method="msadams"),
    "reference, rodas": lambda one: dal.reference(one, t=1e7, method="rodas", tolerance=1e-9),
    "reference, xi": lambda one: dal.reference(one, t=1e7, coordinates="xi"),
    "reference, Python": lambda one: dal.reference(
        dal.System(mass=[1], potential=lambda q: q @ q / 2, gradient=lambda q: q), 1, 0, t=1e7
    ),
    "exact_velocity": lambda one: dal.exact_velocity(one, 1e7, [0, 1, 0], [1, 2, 3]),
    "one long interval": lambda one: dal.integrate(one, "reference", h=1e7, steps=1),
    "nodes": lambda one: dal.Discrete(one).run(1e-3, one.q0, one.q0, steps=10**7),
    "general, few states": lambda one: dal.integrate(
        dal.systems.ball_on_table(), "midpoint", h=1e-6, steps=10**7, stride=10**5
    ),
    "general, more states": lambda one: dal.integrate(
        dal.systems.ball_on_table(), "midpoint", h=1e-6, steps=10**8, stride=10**4
    ),
}


@pytest.mark.parametrize("name", LONG)
def test_ctrl_c_in_one_long_call(interrupt, name):
    one = dal.systems.particle_oscillator()
    interrupt.start()
    with pytest.raises(KeyboardInterrupt):
        LONG[name](one)
    # It is pressed after 0.05 s and seen within 0.1 s; no call ends in less than 10 s.
    assert time.perf_counter() - interrupt.began < 9


def test_a_flow_that_was_interrupted_keeps_its_rows(interrupt):
    one = dal.systems.particle_oscillator()

    def after_a_row(done, total):
        if done:
            interrupt.progress(done, total)

    with pytest.raises(KeyboardInterrupt) as caught:
        dal.integrate(one, "reference", h=50.0, steps=10**6, progress=after_a_row)
    part = caught.value.partial
    again = dal.integrate(one, "reference", h=50.0, steps=len(part.x) - 1)
    np.testing.assert_array_equal(part.x, again.x)
    assert len(part.x) > 1 and part.status < 0


def test_ctrl_c_in_a_python_function(own, interrupt, capfd):
    with pytest.raises(KeyboardInterrupt) as caught:
        dal.integrate(own.system(), "midpoint", h=1e-4, steps=10**6, progress=interrupt.progress)
    assert len(caught.value.partial.x) > 1 and np.isfinite(caught.value.partial.x).all()
    again = dal.integrate(own.system(), "midpoint", h=H, steps=3)
    assert again.success


def test_ctrl_c_while_a_trajectory_is_evaluated(own, interrupt):
    q, v = np.tile(own.q0, (10**6, 1)), np.tile(own.v0(), (10**6, 1))
    interrupt.start()
    with pytest.raises(KeyboardInterrupt):
        own.system().multipliers(q, v)


# ---- what is not finite --------------------------------------------------------------------


@pytest.mark.parametrize(
    "name, entry, text",
    [
        ("potential", (), r"potential = nan"),
        ("gradient", (2,), r"gradient\[2\] = nan"),
        ("hessian", (1, 2), r"hessian\[1,2\] = nan"),
        ("mu", (1, 2), r"mu\[1,2\] = nan"),
        ("mu_v_q", (0, 3), r"mu_v_q\[0,3\] = nan"),
    ],
)
def test_what_is_not_finite_is_named_as_the_user_named_it(own, name, entry, text):
    def broken(*arguments):
        value = np.array(getattr(own, name)(*arguments), dtype=float)
        value[entry] = np.nan
        return value

    functions = {key: getattr(own, key) for key in FUNCTIONS}
    system = own.system(**{**functions, name: broken}, m=2)
    found = examine(system, own.q0, own.v0())  # the check without the growth vector, which is slow
    assert not found and re.match(text, found.text), found.text
    if name != "hessian":  # which mechanics on D does not need
        with pytest.raises(dal.DomainError, match="^" + text):
            system.energy(own.q0, own.v0()) if name == "potential" else system.field(
                own.q0, own.v0()
            )


@pytest.mark.parametrize(
    "wrong, message",
    [
        (dict(mu=lambda q: [[-q[1], 0, 1], [1, 0]]), r"^mu returned rows of different"),
        (dict(mu=lambda q: None), "^mu returned None: expected"),
        (dict(mu=lambda q, v: [[0, 0, 1]]), r"^mu is a function of \(q, v\).*of \(q\)"),
        (dict(force=lambda q, v: -v), r"^force is a function of \(q, v\).*function of \(t, q, v\)"),
        (dict(mu_v_q=lambda q: 0), "^mu_v_q is a function"),
        (dict(exact=lambda t: 0), r"^exact is a function of \(t\).*function of \(t, q, v\)"),
    ],
)
def test_a_callback_of_another_kind_is_named(wrong, message):
    with pytest.raises(ValueError, match=message):
        dal.System(**{"mass": [1, 1, 1], "mu": lambda q: [[-q[1], 0, 1]], **wrong})


def test_a_callback_may_take_more_than_it_is_given():
    forms = lambda *q, scale=1: [[-scale * q[0][1], 0, 1]]  # noqa: E731
    assert dal.System(mass=[1, 1, 1], mu=forms).m == 1
    with pytest.raises(ValueError, match=r"^observer is a function of \(t, x\)"):
        dal.integrate(dal.systems.particle(), h=0.1, steps=1, observer=lambda t, x: 0)


def test_an_exception_that_was_stepped_around_is_not_the_reason_of_a_later_failure():
    """Newton's iteration leaves where a gradient is not defined; later one is not finite."""
    raised = []

    def gradient(q):
        if q[0] > 0.125 and not raised:
            raised.append(dal.DomainError("left the table"))
            raise raised[0]
        return q * (np.nan if q[0] > wild else 1.0)

    system = dal.System(
        mass=[1, 1, 1], mu=lambda q: [[-q[1], 0, 1]],
        potential=lambda q: q @ q / 2, gradient=gradient,
    )  # fmt: skip
    given = {"q0": [0, 1, 0], "v0": [1, 1, 1], "h": 0.01, "steps": 40}
    wild = 1.0
    assert dal.integrate(system, "midpoint", **given).success and raised
    raised.clear()
    wild = 0.205
    with pytest.raises(dal.DomainError, match="the callback did not set it") as caught:
        dal.integrate(system, "midpoint", **given)
    assert raised and caught.value.step in (20, 21)
