"""Steps of many sizes: how accurate, where they end, and all that a run may have."""

import pickle
import warnings

import numpy as np
import pytest
import sympy

import dalembert as dal
from conftest import U

# What the tolerance promises holds for motions that are not chaotic; those that come to rest
# forget their errors, and end far below it.
USUAL = ("particle_oscillator", "knife_edge", "heisenberg", "contact_oscillator", "genmass",
         "rolling_disc", "n_trailer")  # fmt: skip
RELAXING = ("particle", "sleigh", "sleigh_contact")


def relative(run, q, v):
    """The largest error of the last state, relative to 1 + |x_i|."""
    x = np.concatenate([q, v])
    return (abs(run.x[-1] - x) / (1 + abs(x))).max()


@pytest.mark.parametrize("name", USUAL + RELAXING)
def test_the_error_is_about_the_tolerance(name):
    system = getattr(dal.systems, name)()
    end = dal.reference(system, t=100.0, tolerance=1e-14)
    for scheme, tolerance in (("leapfrog-kl8", 1e-6), ("leapfrog-kl8", 1e-9), ("bm4", 1e-6)):
        run = dal.integrate(system, scheme, h="auto", t_end=100, tolerance=tolerance)
        error = relative(run, end.q, end.v)
        assert error < 30 * tolerance
        assert name in RELAXING or error > tolerance / 100
        assert run.residual.max() <= 4 * system.n * U
        assert run.t[0] == 0 and run.t[-1] == 100 and (np.diff(run.t) > 0).all()


def test_a_motion_that_relaxes_takes_longer_and_longer_steps():
    run = dal.integrate(dal.systems.particle(), h="auto", t_end=1000)
    h = np.diff(run.t)
    assert h[-3] > 20 * h[3]
    assert len(run.t) < 200


@pytest.mark.parametrize(("scheme", "tolerance"), [("bm4", 1e-14), ("leapfrog-ss10", 1e-14)])
def test_a_tolerance_that_the_estimate_does_not_see_is_said(scheme, tolerance):
    system = dal.systems.particle_oscillator()
    with pytest.warns(dal.DalembertWarning, match="a larger error than the tolerance allows"):
        run = dal.integrate(system, scheme, h="auto", tolerance=tolerance, t_end=100)
    exact = dal.integrate(system, "reference", h=100, steps=1, tolerance=1e-15)
    assert relative(run, exact.q[-1], exact.v[-1]) > 5 * tolerance
    assert run.stats.uncontrolled > run.stats.steps / 20
    seen = dal.integrate(system, scheme, h="auto", tolerance=1e-12, t_end=100)
    assert seen.stats.uncontrolled == 0


def test_what_it_returns():
    system = dal.systems.knife_edge()
    run = dal.integrate(system, h="auto", t_end=-7, t0=1.5, h_max=0.3, stride=4)
    assert run.scheme.name == "leapfrog-kl8"
    assert run.control == {"h": "auto", "tolerance": 1e-9, "h_max": 0.3}
    assert np.isnan(run.h) and run.stride == 4
    assert run.t[0] == 1.5 and run.t[-1] == -7
    assert len(run.t) == -(-run.stats.steps // 4) + 1
    assert abs(np.diff(run.t)).max() <= 4 * 0.3
    assert "h = 'auto', tolerance = 1e-09, h_max = 0.3" in repr(run)
    np.testing.assert_allclose(run.energy, run.energy[0], rtol=1e-8)
    q, v = dal.reference(system, t=-7, t0=1.5)[:2]
    assert relative(run, q, v) < 1e-8
    again = pickle.loads(pickle.dumps(run))
    np.testing.assert_array_equal(again.t, run.t)
    assert again.control == run.control and (again(0.0).q == run(0.0).q).all()


def test_reactions_are_means_over_each_interval():
    run = dal.integrate(dal.systems.knife_edge(), h="auto", t_end=5, tolerance=1e-12)
    for k in (1, len(run.t) // 2):
        t = np.linspace(run.t[k], run.t[k + 1], 4001)
        fine = dal.integrate(
            run.system, "reference", run.q[k], run.v[k], t0=t[0], h=t[1] - t[0], steps=4000
        )
        mean = np.trapezoid(fine.multipliers[:, 0], fine.t) / (t[-1] - t[0])
        assert abs(run.reactions[k, 0] - mean) < 1e-7


def test_a_run_that_has_no_time():
    edge = dal.systems.knife_edge()
    run = dal.integrate(edge, h="auto", t_end=0, t_eval=[0.0])
    assert run.t.tolist() == [0] and (run.q[0] == edge.q0).all()
    assert len(dal.integrate(edge, h="auto", t_end=0).t) == 1


@pytest.mark.parametrize("end", [0.2, 1e-4])  # more steps, and one
def test_nothing_is_evaluated_beyond_the_end(end):
    times = []

    def force(t, q, v):
        times.append(t)
        return [-np.sin(t)]

    system = dal.System(mass=[1], force=force, q0=[0], v0=[1])
    run = dal.integrate(system, "leapfrog-suzuki4", h="auto", t_end=end, tolerance=1e-4)
    assert abs(run.v[-1, 0] - np.cos(end)) < 1e-4
    assert 0.7 * end < max(times) <= end  # the stages of this record stay within each step


@pytest.mark.parametrize("scheme", ["bm4", "leapfrog-kl8", "midpoint-kl6"])
def test_the_edge_of_a_domain_is_an_end(scheme):
    calls = []

    def gradient(q):
        calls.append(q[0])
        return [np.nan if q[0] > 0.5 else 0, 0, 0]

    system = dal.System(
        mass=[1, 1, 1], mu=lambda q: [[-q[1], 0, 1]], potential=lambda q: 0.0,
        gradient=gradient,
    )  # fmt: skip
    with pytest.raises(dal.DomainError) as caught:
        dal.integrate(system, scheme, [0, 1, 0], [1, 1, 1], h="auto", t_end=5)
    assert len(calls) < 20000
    assert caught.value.partial.t[-1] == pytest.approx(0.5, abs=0.1)  # an end is not looked at


def test_time_and_a_clock_that_is_a_coordinate_give_the_same_steps():
    x, y, z, c = dal.coordinates("x y z c")
    kinetic, slides = (x.d**2 + y.d**2 + z.d**2) / 2, z.d - y * x.d
    well = (x**2 + 2 * y**2 + 3 * z**2 / 2) / 2
    driven = dal.System.from_sympy(
        kinetic - well + x * sympy.sin(dal.time), [slides], q0=[0.5, 0.3, -0.2], v0=[1, 0.7, 0.3]
    )
    heavy = 10**9  # so that what it drives does not push it back
    twin = dal.System.from_sympy(
        kinetic + heavy * c.d**2 / 2 - well + x * sympy.sin(c), [slides],
        q0=[0.5, 0.3, -0.2, 0], v0=[1, 0.7, 0.3, 1],
    )  # fmt: skip
    exact = dal.integrate(driven, "reference", h=50, t_end=50, tolerance=1e-15)
    for tolerance in (1e-4, 1e-8):
        run, other = (
            dal.integrate(system, "leapfrog-kl8", h="auto", tolerance=tolerance, t_end=50)
            for system in (driven, twin)
        )
        assert run.stats.steps == pytest.approx(other.stats.steps, rel=0.1)
        assert run.stats.uncontrolled == 0
        assert tolerance / 300 < relative(run, exact.q[-1], exact.v[-1]) < 30 * tolerance


# ---- between the steps ---------------------------------------------------------------------------


def test_states_between_the_stored_ones_have_the_error_of_the_run():
    system = dal.systems.knife_edge()
    for stride in (1, 5):
        run = dal.integrate(system, h="auto", t_end=9, tolerance=1e-11, stride=stride)
        t = np.random.default_rng(3).uniform(0, 9, 40)
        found = run(t)
        for k in range(len(t)):
            q, v = system.exact(t[k])
            assert abs(found.q[k] - q).max() < 1e-9 and abs(found.v[k] - v).max() < 1e-9
            assert system.relative_residual(found.q[k], found.v[k]) <= 4 * 3 * U
        np.testing.assert_array_equal(run(run.t).q, run.q)
    for t in (-0.1, 9.1):
        with pytest.raises(ValueError, match="expected times from 0.0 to 9.0"):
            run(t)


def test_output_times():
    system = dal.systems.knife_edge()
    times = np.linspace(0, 9, 61)
    run = dal.integrate(system, h="auto", t_end=9, tolerance=1e-11, t_eval=times)
    assert (run.t == times).all()
    for t, q in zip(run.t, run.q):
        assert abs(q - system.exact(t)[0]).max() < 1e-9
    assert abs(run(0.2345).q - system.exact(0.2345)[0]).max() < 1e-9


def test_resets_and_the_end():
    edge = dal.systems.knife_edge()
    wall = dal.Event(
        lambda t, q, v: q[0] - 0.4, direction=1, terminal=3, reset=lambda q, v: (q, -v)
    )
    run = dal.integrate(edge, h="auto", t_end=50, tolerance=1e-10, events=[wall])
    fixed = dal.integrate(edge, "leapfrog-kl8", h=0.01, t_end=50, events=[wall])
    assert run.message.startswith("events[0] ended the run")
    np.testing.assert_allclose(run.t_events[0], fixed.t_events[0], atol=1e-8)
    np.testing.assert_allclose(run.x_after[0][:2], fixed.x_after[0][:2], atol=1e-8)
    assert run.t[-1] == run.t_events[0][-1] and abs(run.q[-1, 0] - 0.4) < 1e-13
    for t in (run.t_events[0][0] - 0.01, run.t_events[0][0] + 0.01):
        state = run(t)
        q, v = edge.exact(t) if t < run.t_events[0][0] else edge.exact(2 * run.t_events[0][0] - t)
        sign = 1 if t < run.t_events[0][0] else -1
        np.testing.assert_allclose(state.q, q, atol=1e-8)
        np.testing.assert_allclose(state.v, sign * v, atol=1e-8)


# ---- inputs --------------------------------------------------------------------------------------


@pytest.fixture
def cart():
    return dal.System(
        mass=[2], force=lambda t, q, v, u: u, inputs=["push"], q0=[0], v0=[0], name="cart"
    )


def test_steps_end_where_inputs_change(cart):
    table = np.array([[1.0], [-3.0], [2.0], [0.5]])
    run = dal.integrate(cart, h="auto", t_end=1.0, inputs=table, hold=0.3)
    speed = np.concatenate([[0], np.cumsum(table[:, 0] * [0.3, 0.3, 0.3, 0.1]) / 2])
    for k in range(4):
        row = np.flatnonzero(run.t == 0 + k * 0.3)
        assert len(row) == 1 and abs(run.v[row[0], 0] - speed[k]) < 1e-14
    assert abs(run.v[-1, 0] - speed[4]) < 1e-14
    assert (run.inputs == table).all() and run.hold == 0.3
    coarse = dal.integrate(cart, h="auto", t_end=1.0, inputs=table, hold=0.3, stride=1000)
    assert len(coarse.t) == 2
    for t in (0.1, 0.45, 0.6, 0.95):
        k = int(t / 0.3 + 1e-9)
        v = speed[k] + table[k, 0] / 2 * (t - k * 0.3)
        assert abs(run(t).v[0] - v) < 1e-13 and abs(coarse(t).v[0] - v) < 1e-13
    even = dal.integrate(cart, h="auto", t_end=0.9, inputs=table[:3], hold=0.3)  # 3 * 0.3 < 0.9
    assert abs(even.v[-1, 0] - speed[3]) < 1e-14
    whole = dal.integrate(cart, h="auto", t_end=1.0, inputs=[4.0])
    assert whole.inputs.shape == (1, 1) and abs(whole.v[-1, 0] - 2) < 1e-14


def test_a_controller_is_asked_at_its_times(cart):
    asked = []

    def control(t, q, v):
        asked.append(t)
        return [1 - v[0]]

    run = dal.integrate(cart, h="auto", t_end=-2, inputs=control, hold=0.5)
    assert asked == [0, -0.5, -1.0, -1.5]
    assert (run.inputs[:, 0] == [1 - run.v[run.t == t][0, 0] for t in asked]).all()


# ---- files, watchers, failures -------------------------------------------------------------------


def test_a_journal_goes_on_to_another_end(tmp_path):
    path = tmp_path / "run.dal"
    edge = dal.systems.knife_edge()
    dal.integrate(edge, h="auto", t_end=3, journal=path)
    longer = dal.resume(path, t_end=5)
    assert longer.t[-1] == 5 and 3 in longer.t
    assert abs(longer.q[-1] - edge.exact(5.0)[0]).max() < 1e-8
    with pytest.raises(ValueError, match="steps = 7: not used with h = 'auto'"):
        dal.resume(path, steps=7)


def test_progress_is_in_time():
    told = []
    dal.integrate(
        dal.systems.knife_edge(), h="auto", t_end=-4, progress=lambda done, total: told.append(
            (done, total))
    )  # fmt: skip
    assert told[-1] == (4.0, 4.0)


def test_what_was_made_before_a_failure_is_kept():
    def potential(q):
        if q[0] >= 1:
            raise dal.DomainError("the cliff")
        return -np.log(1 - q[0]) - 5 * q[0]

    system = dal.System(
        mass=[1, 1], potential=potential, gradient=lambda q: [1 / (1 - q[0]) - 5, 0],
        mu=lambda q: [[0, 1]], q0=[0, 0], v0=[1, 0],
    )  # fmt: skip

    def observer(step, t, q, v):
        if t > 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        dal.integrate(system, h="auto", t_end=100, observer=observer)
    assert 1 < caught.value.partial.t[-1] < 3 and len(caught.value.partial.x) > 2


# ---- reversible steps ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def comet():
    """Kepler's ellipse of eccentricity 0.9, with a blade that turns with it: z' = x y' - y x'."""
    x, y, z = dal.coordinates("x y z")
    speed = np.sqrt(1.9 / 0.1)
    return dal.System.from_sympy(
        (x.d**2 + y.d**2 + z.d**2) / 2 + 1 / sympy.sqrt(x**2 + y**2), [z.d - x * y.d + y * x.d],
        q0=[0.1, 0, 0], v0=[0, speed, 0.1 * speed], name="comet",
    )  # fmt: skip


def test_steps_that_became_too_long_are_made_again(comet):
    turns = 10 * 2 * np.pi
    run = dal.integrate(comet, h="auto", tolerance=1e-6, t_end=turns)
    made_again = run.stats.rejected / run.stats.steps
    assert 0.1 < made_again < 0.5  # every approach takes some
    assert abs(run.energy - run.energy[0]).max() < 1e-4


def test_the_energy_of_reversible_steps_does_not_drift(comet):
    run = dal.integrate(comet, h="reversible", eps=0.15, t_end=200 * 2 * np.pi)
    change = abs(run.energy - run.energy[0])
    quarter = len(change) // 4
    assert run.scheme.name == "bm6" and run.control == {"h": "reversible", "eps": 0.15}
    assert change.max() < 2e-7 and change[-quarter:].max() < 1.05 * change[:quarter].max()
    assert run.stats.resets <= 2 and run.residual.max() <= 4 * 3 * U
    auto = dal.integrate(comet, "bm6", h="auto", tolerance=1e-3, t_end=200 * 2 * np.pi)
    drift = abs(auto.energy - auto.energy[0])
    assert drift[-1] > 3 * drift[len(drift) // 4]  # of a method that is not
    steps = np.diff(run.t)
    assert np.percentile(steps, 98) > 20 * np.percentile(steps, 2)


def drift_of(energy, run):
    """The largest change of an energy in units of the largest kinetic energy, for masses 1."""
    return abs(energy - energy[0]).max() / (run.v**2).sum(axis=1).max() * 2


@pytest.mark.parametrize("offset", [0, 10**11])
def test_the_energy_decides_whether_reversible_steps_are_warned_of(offset):
    # with an offset the roundoff of run.energy is 4e-6 of the kinetic energy
    x, c = dal.coordinates("x")[0], sympy.Symbol("c")
    system = dal.System.from_sympy(
        x.d**2 / 2 - (1 - sympy.cos(x)) ** 2 - c, q0=[1e-3], v0=[2.82], parameters={c: offset}
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = dal.integrate(system, h="reversible", t_end=50)
    assert run.stats.resets > 10  # at the top of the barrier, where the motion nearly stops
    assert drift_of(run.v[:, 0] ** 2 / 2 + (1 - np.cos(run.q[:, 0])) ** 2, run) < 1e-6
    if not offset:
        with pytest.warns(dal.DalembertWarning, match="steps were not reversible") as said:
            run = dal.integrate(system, "bm4", h="reversible", t_end=50)
        drift = drift_of(run.v[:, 0] ** 2 / 2 + (1 - np.cos(run.q[:, 0])) ** 2, run)
        assert drift > 1e-5 and f"changed by {drift:.1e} of" in str(said[0].message)


def test_an_energy_that_comes_and_goes_is_not_warned_of(comet):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = dal.integrate(comet, "bm4", h="reversible", eps=0.2, t_end=100)
    assert 0 < run.stats.resets <= 10 and drift_of(run.energy, run) > 3e-6


@pytest.mark.filterwarnings("error")
def test_energy_that_resets_take_is_not_warned_of():
    """A ball that loses a third of its energy at each bounce: nothing of that is the steps'."""
    ball = dal.System(mass=[1], potential=lambda q: 9.81 * q[0], gradient=lambda q: [9.81])
    bounce = dal.Event(lambda t, q, v: q[0], direction=-1, reset=lambda q, v: (q, -0.8 * v))
    for t_end in (2, 3, 4):
        run = dal.integrate(ball, None, [1], [0], h="reversible", t_end=t_end, events=[bounce])
        assert run.energy[-1] < 0.3 * run.energy[0]


def test_every_end_can_be_reached():
    """Also where no number leads there from the state before: t + (end - t) is not the end."""
    particle = dal.systems.particle()
    rng = np.random.default_rng(1)
    for end in (0.11, 0.10382182036017691, *rng.uniform(1e-3, 1.6, 400)):
        for sign in (1, -1):
            run = dal.integrate(particle, h="auto", t_end=sign * end, tolerance=1e-8)
            assert run.t[-1] == sign * end


def test_an_energy_that_is_lost_in_the_first_encounter_is_warned_of():
    x, y = dal.coordinates("x y")
    walls = sum(sympy.exp(k * (a - 1)) + sympy.exp(-k * (a + 1)) for k, a in ((100, x), (5, y)))
    box = dal.System.from_sympy((x.d**2 + y.d**2) / 2 - walls - 3 * x**2 * y**2 / 10)
    with pytest.warns(dal.DalembertWarning, match="changed by 1.3e-05 of .* first encounters"):
        run = dal.integrate(
            box, q0=[-0.28, 0.68], v0=[1.9, 1.88], h="reversible", eps=0.2, t_end=10
        )
    assert run.stats.resets <= 10
    q, energy = run.q, (run.v**2).sum(axis=1) / 2 + 0.3 * (run.q**2).prod(axis=1)
    for i, k in ((0, 100), (1, 5)):
        energy += np.exp(k * (q[:, i] - 1)) + np.exp(-k * (q[:, i] + 1))
    assert abs(drift_of(energy, run) / 1.3e-5 - 1) < 0.05


def test_reversible_steps_have_all_that_a_run_has(comet, tmp_path):
    t = np.linspace(0, 5, 7)
    cross = dal.Event(lambda t, q, v: q[0])
    run = dal.integrate(comet, "leapfrog-kl8", h="reversible", t_end=5, events=[cross])
    exact = dal.integrate(comet, h="auto", tolerance=1e-12, t_end=5, t_eval=t, events=[cross])
    np.testing.assert_allclose(run(t).q, exact.q, atol=1e-6)
    np.testing.assert_allclose(run.t_events[0], exact.t_events[0], atol=1e-6)
    there = dal.integrate(comet, "leapfrog-kl8", h="reversible", t_end=5, t_eval=t)
    np.testing.assert_allclose(there.q, exact.q, atol=1e-6)
    back = dal.integrate(
        comet, "leapfrog-kl8", run.q[-1], run.v[-1], h="reversible", t0=5.0, t_end=0
    )
    np.testing.assert_allclose(back.q[-1], comet.q0, atol=1e-6)
    path = tmp_path / "run.dal"
    dal.integrate(comet, "leapfrog-kl8", h="reversible", t_end=3, journal=path)
    assert dal.load(path, comet).control == run.control
    longer = dal.resume(path, comet, t_end=5)
    np.testing.assert_allclose(longer.q[-1], exact.q[-1], atol=1e-6)


@pytest.mark.parametrize(
    "given, error, words",
    [
        ({"eps": 0.5}, ValueError, "^eps = 0.5: expected a positive number up to 0.2"),
        ({"eps": -1}, ValueError, "eps = -1: expected a positive number"),
        ({"tolerance": 1e-6}, ValueError, "tolerance = 1e-06: not used with h = 'rev"),
        ({"h_max": 1}, ValueError, "h_max = 1: not used with h = 'rev"),
        ({"scheme": "leapfrog"}, NotImplementedError, "a symmetric composition"),
        ({"scheme": "endpoint"}, NotImplementedError, "a symmetric composition"),
        ({"t_end": None, "steps": 3}, ValueError, "steps = 3: not used with h = 'reversible'"),
    ],
)
def test_refused_reversible_steps(given, error, words, comet):
    with pytest.raises(error, match=words):
        dal.integrate(comet, **{"h": "reversible", "t_end": 1, **given})


def test_refused_eps():
    with pytest.raises(ValueError, match="eps = 0.1: not used with a fixed step"):
        dal.integrate(dal.systems.disk(), h=0.1, t_end=1, eps=0.1)
    with pytest.raises(NotImplementedError, match="mass that depends on q"):
        dal.integrate(dal.systems.rolling_disc(), h="reversible", t_end=1)


@pytest.mark.parametrize(
    "given, error, words",
    [
        ({}, ValueError, "t_end is missing: with h = 'auto'"),
        ({"t_end": 1, "steps": 10}, ValueError, "steps = 10: not used with h = 'auto'"),
        ({"t_end": np.inf}, ValueError, "t_end = inf"),
        ({"t_end": 1, "tolerance": 1e-15}, ValueError, "^tolerance = 1e-15: expected a number"),
        ({"t_end": 1, "tolerance": 0}, ValueError, "tolerance = 0"),
        ({"t_end": 1, "tolerance": 1}, ValueError, "^tolerance = 1: expected"),
        ({"t_end": 1, "tolerance": "low"}, ValueError, "tolerance = 'low'"),
        ({"t_end": 1, "h_max": 0}, ValueError, "h_max = 0: expected a positive number"),
        ({"t_end": 1, "scheme": "leapfrog"}, NotImplementedError, "no error estimate"),
        ({"t_end": 1, "scheme": "reference"}, ValueError, "chooses its own step sizes"),
        (
            {"t_end": 1, "scheme": "midpoint-nodes", "initial": "D"}, ValueError,
            "kept nodes, whose D_eps depends on h",
        ),
        ({"t_end": 1, "hold": 0.1}, ValueError, "hold = 0.1: not used without inputs"),
        ({"t_end": 1, "t_eval": [0.5, 1.5]}, ValueError, "t_eval contains 1.5: expected"),
    ],
)  # fmt: skip
def test_refused(given, error, words):
    with pytest.raises(error, match=words):
        dal.integrate(dal.systems.knife_edge(), h="auto", **given)


def test_refused_inputs(cart):
    with pytest.raises(ValueError, match="hold is missing: with h = 'auto'"):
        dal.integrate(cart, h="auto", t_end=1, inputs=lambda t, q, v: [1])
    with pytest.raises(ValueError, match="hold = -1.0: expected a positive time"):
        dal.integrate(cart, h="auto", t_end=1, inputs=[1], hold=-1)
    with pytest.raises(ValueError, match="h_max = 1: not used with a fixed step"):
        dal.integrate(cart, h=0.1, t_end=1, h_max=1)
    with pytest.raises(ValueError, match="did you mean 'auto'\\? expected a number"):
        dal.integrate(cart, h="automatic", t_end=1)


# ---- Stepper ------------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [{"h": "auto", "tolerance": 1e-8}, {"h": "reversible"}])
def test_a_stepper_has_the_steps_of_a_run(given):
    system = dal.systems.robot()
    run = dal.integrate(system, t_end=3, **given)
    stepper = dal.Stepper(system, **given)
    assert stepper.scheme == run.scheme and repr(given["h"]) in repr(stepper)
    stepper.until(3)
    assert stepper.t == 3 and stepper.steps == run.stats.steps
    np.testing.assert_array_equal(stepper.x, run.x[-1])
    mean = np.diff(run.t) @ run.reactions / 3
    np.testing.assert_allclose(stepper.reaction, mean, rtol=1e-12, atol=1e-12)
    saved = stepper.save()
    stepper.step(steps=5)
    assert stepper.t > 3 and stepper.steps == run.stats.steps + 5
    other = dal.Stepper(system, **given)
    other.restore(saved)
    other.step(steps=5)
    np.testing.assert_array_equal(other.x, stepper.x)
    stepper.reset()
    stepper.until(3)
    np.testing.assert_array_equal(stepper.x, run.x[-1])


def test_a_loop_with_inputs_until_times():
    cart = dal.System(mass=[2], force=lambda t, q, v, u: u, inputs=["push"], q0=[0], v0=[0])
    stepper = dal.Stepper(cart, "leapfrog-kl6", h="auto", h_max=0.3)
    for k in range(1, 31):
        stepper.until(k / 10, [3 * (1 - stepper.v[0])])
        assert stepper.t == k / 10
    assert stepper.v[0] == pytest.approx(1 - 0.85**30, rel=1e-12)


def test_what_steppers_refuse():
    robot = dal.systems.robot()
    stepper = dal.Stepper(robot, h="auto")
    stepper.until(1)
    with pytest.raises(ValueError, match="t = 0.5: expected a time from 1 on"):
        stepper.until(0.5)
    assert stepper.t == 1
    stepper.until(1)
    assert stepper.t == 1
    with pytest.raises(ValueError, match="^t = 1.0: until needs steps of variable size"):
        dal.Stepper(robot, h=0.1).until(1)
    with pytest.raises(ValueError, match="^tolerance = 1e-08: not used with a fixed step"):
        dal.Stepper(robot, h=0.1, tolerance=1e-8)
    with pytest.raises(ValueError, match="^tolerance = -1: expected a positive number"):
        dal.Stepper(robot, h="auto", tolerance=-1)
    loose, tight = (dal.Stepper(robot, "reference", h=1, tolerance=x) for x in (1e-3, 1e-12))
    for one in (loose, tight):
        one.step()
    assert 0 < abs(loose.x - tight.x).max() < 0.1
