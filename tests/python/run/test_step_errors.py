"""The estimate of the error of a run, and the warning that h is too large."""

import warnings

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import dalembert as dal

x, y = dal.coordinates("x y")
SPRING = dal.System.from_sympy(x.d**2 / 2 - x**2 / 2, [], [x], q0=[1], v0=[0])
TOO_LARGE = "h is too large"


def told(function, *args, **given):
    """Return a run and its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run = function(*args, **given)
    return run, [str(w.message) for w in caught]


def error_on_spring(run):
    """Return the error of the last state, from q = cos t, relative to the sizes of q and v."""
    t = run.t[-1]
    return max(abs(run.q[-1, 0] - np.cos(t)) / 2, abs(run.v[-1, 0] + np.sin(t)))


@pytest.mark.parametrize(
    ("scheme", "h", "steps", "large"),
    [
        ("leapfrog", 0.3, 200, True),
        ("leapfrog", 0.05, 400, False),
        ("midpoint", 0.2, 301, True),
        ("leapfrog", -0.3, 202, True),
        ("leapfrog-suzuki4", 0.9, 400, True),
        ("leapfrog", 0.12, 3000, True),
        ("leapfrog", 0.01, 3000, False),
        ("bm4", 0.2, 5000, False),
    ],
)
def test_estimate_and_warning(scheme, h, steps, large):
    """Within a third of the error where all steps are made again, else not less than half of it."""
    run, texts = told(dal.integrate, SPRING, scheme, h=h, steps=steps, stride=steps)
    error, stats = error_on_spring(run), run.stats
    assert (error > 0.08) == large == (len(texts) == 1) and (large or error < 0.02)
    assert stats.whole == (large or steps < 1000)
    if stats.whole:
        assert abs(stats.error / error - 1) < 0.35
        assert (2 if large else 0.25) * steps <= stats.remade < 3 * steps
    else:
        assert error / 2 < stats.error < 0.015 and 0 < stats.remade < 0.04 * steps
    assert "error of the last state: " in repr(run)
    for text in texts:
        assert text.startswith(TOO_LARGE) and "check_h=False" in text


def test_a_run_of_which_only_the_first_part_is_made_again():
    """Its estimate is that of the part, and grows with what the windows have of the rest."""
    run, texts = told(dal.integrate, SPRING, "leapfrog", h=0.01, steps=200_000, stride=200_000)
    assert run.stats.whole and 0.25 * 131_072 <= run.stats.remade < 200_000 and not texts
    assert 0.3 < run.stats.error / error_on_spring(run) < 3


def test_no_bit_of_the_run_depends_on_it():
    """Nor what is counted; and whoever watches or steers is not asked again."""
    asked = []

    def inputs(t, q, v):
        asked.append(t)
        return [np.sin(3 * t) - q[0]]

    cart = dal.System(mass=[2], force=lambda t, q, v, u: u - v, inputs=["push"], q0=[1], v0=[0])
    tops = {"events": [lambda t, q, v: v[0]]}
    for system, steps, given in (
        (dal.systems.rolling_disc(), 1300, {"scheme": "midpoint"}),
        (dal.systems.knife_edge(), 2500, {"scheme": "bm4"}),
        (dal.systems.contact_oscillator(), 700, {"energy": "keep"}),
        (SPRING, 300, tops),
        (
            cart,
            90,
            {"inputs": inputs, "scheme": "midpoint", "observer": lambda *_: asked.append(0)},
        ),
    ):
        runs = []
        for check in (True, False):
            asked.clear()
            runs.append(told(dal.integrate, system, h=0.03, steps=steps, check_h=check, **given)[0])
            runs.append(list(asked))
        checked, first, plain, second = runs
        assert np.array_equal(checked.x, plain.x) and first == second
        assert np.array_equal(checked.reactions, plain.reactions)
        assert checked.stats.remade > 0 == plain.stats.remade
        assert checked.stats == plain.stats  # but for what the estimate says


def test_with_inputs():
    """A mass that is pushed by u_k in step k, and a spring: by sums of cosines."""
    u = np.random.default_rng(1).normal(size=(120, 1))
    f = sp.Symbol("f")
    pushed = dal.System.from_sympy(
        x.d**2 / 2 - x**2 / 2, [], [x], force={x: f}, inputs=[f], q0=[1], v0=[0]
    )
    h = 0.3
    run, texts = told(dal.integrate, pushed, "leapfrog", h=h, steps=120, inputs=u)
    z, states = 1.0, [1.0]
    for (push,) in u:  # q + i v turns about the push
        z = push + (z - push) * np.exp(-1j * h)
        states.append(z)
    states = np.array(states)
    error = max(
        abs(run.q[-1, 0] - z.real) / np.ptp(states.real),
        abs(run.v[-1, 0] - z.imag) / abs(states.imag).max(),
    )
    assert error > 0.05 and len(texts) == 1 and abs(run.stats.error / error - 1) < 0.35


def test_inputs_in_constraints():
    """A carriage that inputs move pulls at a spring: v jumps, in the steps made again as well."""
    rate = sp.Symbol("rate")
    pulled = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2 - (x - y) ** 2 / 2, [y.d - rate], [x, y], inputs=[rate],
        q0=[1, 0], v0=[0, 0],
    )  # fmt: skip
    u = np.random.default_rng(2).normal(size=(30, 1))
    for h, steps, hold, large in ((0.3, 300, 10, True), (0.02, 1500, 50, False)):
        run, texts = told(
            dal.integrate, pulled, "leapfrog", h=h, steps=steps, inputs=u, hold=hold,
            consistent="project",
        )  # fmt: skip
        z, at, ways = 1.0 + 0j, 0.0, []  # z = x - y - i (x' - rate) turns
        speed = 0.0
        for (move,) in u:
            z = z.real - 1j * (speed - move)
            z *= np.exp(1j * h * hold)
            at, speed = at + move * h * hold, move - z.imag
            ways.append(z.real + at)
        error = abs(run.q[-1, 0] - ways[-1]) / np.ptp(run.q[:, 0])
        speeds = abs(run.v[-1, 0] - speed) / abs(run.v[:, 0]).max()
        error = max(error, speeds)
        assert len(texts) == large and run.stats.whole == large
        assert abs(run.stats.error / error - 1) < 0.35 if large else error < run.stats.error < 0.05
        plain = told(
            dal.integrate, pulled, "leapfrog", h=h, steps=steps, inputs=u, hold=hold,
            consistent="project", check_h=False,
        )[0]  # fmt: skip
        assert np.array_equal(run.x, plain.x) and np.array_equal(run.reactions, plain.reactions)


def test_inputs_after_a_window_that_cannot_be_made():
    """The force is not defined where only steps of h/2 look: held inputs are those of the run."""
    h = 0.01

    def force(t, q, v, u):
        if abs(t / h % 1 - 0.5) < 0.1:
            raise dal.DomainError("between the steps")
        return u - q

    pushed = dal.System(mass=[1], force=force, inputs=["push"], q0=[1], v0=[0])
    u = np.random.default_rng(1).normal(size=(101, 1))
    runs = [
        told(dal.integrate, pushed, "midpoint", h=h, steps=1010, inputs=u, hold=10, check_h=check)
        for check in (True, False)
    ]
    (checked, texts), (plain, _) = runs
    assert np.array_equal(checked.x, plain.x) and "its error is unknown" in texts[0]


def test_errors_that_die_out_are_no_reason():
    """Samples add up errors of a motion that comes to rest; the run made again does not."""
    damped = dal.System.from_sympy(
        x.d**2 / 2 - x**2 / 2, [], [x], force={x: -x.d / 10}, q0=[1], v0=[0]
    )
    run, texts = told(dal.integrate, damped, "midpoint", h=0.25, steps=1200)
    assert not texts and run.stats.whole and run.stats.error < 1e-6


def test_longer_steps_that_are_unstable_are_no_reason():
    """A stiff spring that hardly moves: h = 1.5 / omega is stable, and 3 h / 2 is not."""
    stiff = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2 - x**2 / 2 - 10**4 * y**2 / 2, [], q0=[1, 1e-8], v0=[0, 0]
    )
    run, texts = told(dal.integrate, stiff, "leapfrog", h=0.015, steps=900)
    assert not texts and run.stats.whole and run.stats.error < 0.01


def test_after_a_reset_and_at_a_terminal_event():
    """A ball that bounces by itself has no error of a step, and none that is told."""
    ball = dal.System(mass=[1], potential=lambda q: q[0], gradient=lambda q: [1.0], q0=[1], v0=[0])
    bounce = dal.Event(lambda t, q, v: q[0], reset=lambda q, v: (q, -v), direction=-1)
    run, texts = told(dal.integrate, ball, h=0.01, steps=2500, events=[bounce])
    assert not texts and run.stats.error < 1e-9
    end = dal.Event(lambda t, q, v: t - 40.0, terminal=True)
    run, texts = told(dal.integrate, SPRING, h=0.3, steps=10**6, stride=10**6, events=[end])
    assert len(texts) == 1 and run.stats.whole
    assert run.stats.remade == (33 + 1) + (66 + 1) + 2 * 133 + 12  # 4h, 2h, h/2, and a window


def test_an_end_in_a_jump_of_the_inputs():
    """v jumps at t = 0.5, and with it an event ends the run: the steps were good."""
    rate = sp.Symbol("rate")
    car = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2 - x**2 / 2, [y.d - rate], [x, y], inputs=[rate],
        q0=[0, 0], v0=[1, 0.1],
    )  # fmt: skip
    end = dal.Event(lambda t, q, v: v[1] - 0.3, terminal=True)
    run, texts = told(
        dal.integrate, car, "midpoint", h=0.01, steps=100, inputs=[[0.1], [0.5]], hold=50,
        events=[end],
    )  # fmt: skip
    assert run.t[-1] == 0.5 and not texts and run.stats.error < 1e-4


def test_the_shortest_runs():
    """As long as the longest of the steps made again."""
    for scheme in ("explicit", "leapfrog"):
        for steps in (6, 7, 8, 9):
            run, texts = told(dal.integrate, SPRING, scheme, h=0.9, steps=steps)
            assert run.stats.error > 0.02 and len(texts) == (run.stats.error > 0.05)


def test_an_end_where_long_steps_are_right_by_chance():
    """Steps of 4h are a turn ahead of those of h, to the bit nearly: the states before tell."""
    h = 0.12
    speeds = [2 / k * np.arcsin(k / 2) for k in (h, 4 * h)]  # of the phase, of leapfrog
    steps = round(2 * np.pi / (speeds[1] - speeds[0]) / h)
    run, texts = told(dal.integrate, SPRING, "leapfrog", h=h, steps=steps)
    assert len(texts) == 1 and abs(run.stats.error / error_on_spring(run) - 1) < 0.35


def test_kept_nodes():
    """The nodes are those of the run with moved nodes, as is the estimate."""
    for h, large in ((0.02, False), (0.2, True)):
        of = [
            told(dal.integrate, SPRING, scheme, [0], [1], h=h, steps=400, **how)
            for scheme, how in (("midpoint", {}), ("midpoint-nodes", {"initial": "shift"}))
        ]
        (moved, _), (kept, texts) = of
        assert abs(kept.stats.error / moved.stats.error - 1) < 0.1 and len(texts) == large


def test_progress_shows_the_steps_that_check_h():
    seen = []
    slow = dal.System(
        mass=[1], potential=lambda q: q[0] ** 2 / 2, gradient=lambda q: q, q0=[1], v0=[0]
    )
    told(dal.integrate, slow, "leapfrog", h=0.3, steps=20000, stride=20000,
         progress=lambda done, total: seen.append((done, total)))  # fmt: skip
    done, total = np.transpose(seen)
    assert np.all(np.diff(done) >= 0) and np.all(done <= total)
    assert done[-1] == total[-1] >= 40000


def test_the_nearly_flat_disc():
    """It falls nearly flat: the energy, which is constant, tells how wrong that is.

    Of the first no step of another size can be made.
    """
    disc = dal.systems.rolling_disc()
    for lean, yaw, spin, h, known in (
        (1.4, 0.5, 2, 0.02, False), (1.45, 1, 1, 0.03, True)
    ):  # fmt: skip
        q0 = [0, 0, 0, lean, 0]
        v0 = disc.project(q0, [0, 0, yaw, 0, spin])
        run, texts = told(dal.integrate, disc, "midpoint", q0, v0, h=h, steps=200)
        assert run.energy[-1] / run.energy[0] < 0.8 and np.isfinite(run.stats.error) == known
        assert sum("too large (h = 0.0" in text for text in texts) == 1
        assert known != ("a run with h / 2 failed" in repr(run))


def test_what_is_short_and_violent():
    """Samples miss the fall of a disc, which toils, and encounters, where the energy strays."""
    disc = dal.systems.rolling_disc()
    q0 = [0, 0, 0, 1.3449, 0]
    v0 = disc.project(q0, [0, 0, 0.839224, 0, 2.84248])
    run, texts = told(dal.integrate, disc, "midpoint", q0, v0, h=0.001118457, steps=3576)
    exact = dal.integrate(disc, "reference", q0, v0, h=run.t[-1], steps=1)
    assert abs(run.q[-1] - exact.q[-1]).max() > 0.3 and texts[0].startswith(TOO_LARGE)

    comet = dal.System.from_sympy((x.d**2 + y.d**2) / 2 + 1 / sp.sqrt(x**2 + y**2))
    start, steps, h = [1, 0, 0, 0.1], 3000, 0.002
    run, texts = told(dal.integrate, comet, "leapfrog", start[:2], start[2:], h=h, steps=steps)
    exact = solve_ivp(
        lambda t, s: [*s[2:], *(-s[:2] / np.hypot(*s[:2]) ** 3)], (0, steps * h), start,
        method="DOP853", rtol=1e-12, atol=1e-12,
    ).y[:2, -1]  # fmt: skip
    assert abs(run.q[-1] - exact).max() > 0.2 and texts[0].startswith(TOO_LARGE)


@pytest.mark.parametrize(
    ("h", "steps", "large"), [(0.1, 94, False), (0.02, 1571, False), (0.12, 1309, True)]
)
def test_the_error_of_a_part_is_not_that_of_the_run(tmp_path, h, steps, large):
    """The estimate covers half of a resumed run: only a large error of that half is reported."""
    path, given = tmp_path / "run.dal", {"h": h, "steps": steps, "stride": steps}
    first = told(dal.integrate, SPRING, "leapfrog", journal=path, **given)[0]
    assert first.stats.whole == (steps != 1571) and first.stats.error > 0
    run, texts = told(dal.resume, path, SPRING, steps=2 * steps)
    assert error_on_spring(run) > 1.8 * error_on_spring(first) and run.stats.remade > 0
    assert large == ("error of the last state" in repr(run)) == (len(texts) == 1)
    if large:
        assert run.stats.whole == 2 and 0.05 < run.stats.error < 0.7 * error_on_spring(run)
        assert "at least about" in repr(run) and "at least about" in texts[0]
    else:
        assert np.isnan(run.stats.error)
    again = told(dal.resume, path, SPRING)[0]  # which is over
    assert np.isnan(again.stats.error) and np.array_equal(again.x, run.x)


@pytest.mark.parametrize("steps", [150, 1500])
def test_the_error_since_a_reset_is_not_that_of_the_run(steps):
    """Resets at each turn, which change nothing: a thirtieth of the error is known, at most."""
    turn = dal.Event(lambda t, q, v: v[0], reset=lambda q, v: (q, v))
    run, texts = told(dal.integrate, SPRING, "leapfrog", h=0.2, steps=steps, events=[turn])
    assert error_on_spring(run) > 0.02 and run.stats.remade > 0 and not texts
    assert np.isnan(run.stats.error) and "error of the last state" not in repr(run)


def test_samples_of_a_resumed_run_are_not_those_of_the_whole(tmp_path):
    """A reset some steps before its end, at t = 100 pi, leaves only samples."""
    path, h, steps = tmp_path / "run.dal", 0.12, 1309
    turn = {"events": [dal.Event(lambda t, q, v: v[0], reset=lambda q, v: (q, v))]}
    told(dal.integrate, SPRING, "leapfrog", h=h, steps=steps, journal=path, **turn)
    run = told(dal.resume, path, SPRING, steps=2 * steps, **turn)[0]
    assert error_on_spring(run) > 0.15 and run.stats.remade > 0 and np.isnan(run.stats.error)


def test_runs_without_an_estimate():
    for given in (
        {"h": "auto", "t_end": 1}, {"h": 0.1, "steps": 50, "scheme": "reference"},
        {"h": 0.1, "steps": 5}, {"h": 0.1, "steps": 0},
    ):  # fmt: skip
        run, texts = told(dal.integrate, SPRING, **given)
        assert run.stats.remade == 0 and np.isnan(run.stats.error) and not texts
        assert "error of the last state" not in repr(run)
