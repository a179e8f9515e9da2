"""A run as an object: it does not change, whatever comes in is checked, its times are right."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import dalembert as dal
from dalembert import core
from dalembert.run import solution


@pytest.fixture
def run(particle):
    return dal.integrate(particle, "midpoint", h=0.05, steps=40)


def fields(run):
    return {x.name: getattr(run, x.name) for x in dataclasses.fields(run) if x.init}


@pytest.mark.parametrize("name", [*dal.Solution._KEYS, "t0"])
def test_nothing_of_a_run_is_replaced(run, name):
    """Else C would read past an array of another type or width, or of another system's."""
    with pytest.raises(AttributeError):
        setattr(run, name, getattr(run, name))
    with pytest.raises(AttributeError):
        delattr(run, name)


ARRAYS = ["t", "q", "v", "x", "y", "multipliers", "reactions", "energy", "constraint", "residual"]


@pytest.mark.parametrize("restore", [lambda x: x, copy.copy, copy.deepcopy])
def test_arrays_are_read_only(run, restore):
    again = restore(run)
    for name in ARRAYS:
        np.testing.assert_array_equal(again[name], run[name])
        with pytest.raises(ValueError, match="read-only"):
            again[name][0] = 1.0


def test_statistics_are_those_of_the_end_whenever_they_are_asked_for(particle):
    first = dal.integrate(particle, "midpoint", h=0.05, steps=40)
    dal.integrate(particle, "midpoint", h=0.05, steps=7)
    assert "stats" in dir(first)
    assert first.stats.steps == 40 and first.stats is first.stats
    given = fields(first)
    del given["stats"]
    with pytest.raises(TypeError, match="missing 1 required keyword-only argument: 'stats'"):
        dal.Solution(**given)


def test_a_run_pickles_with_what_was_computed(run):
    before = run.energy
    again = pickle.loads(pickle.dumps(run))
    assert again._computed["energy"] is again.energy and "residual" not in again._computed
    np.testing.assert_array_equal(again.energy, before)
    np.testing.assert_array_equal(again.residual, run.residual)
    assert (again.t0, again.h, again.stats, str(again)) == (run.t0, run.h, run.stats, str(run))
    for name in ARRAYS:
        assert not again[name].flags.writeable


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"x": np.zeros((41, 4))}, r"x: expected shape \(N, 6\), got \(41, 4\)"),
        ({"x": np.zeros(6)}, r"x: expected shape \(N, 6\), got \(6,\)"),
        ({"x": np.full((41, 6), np.inf)}, r"x\[0, 0\] = inf"),
        ({"x": np.zeros((0, 6))}, r"expected shapes \(N\+1, 6\) and \(N, 1\), got \(0, 6\) and"),
        ({"x": np.zeros((9, 6))}, r"got \(9, 6\) and \(40, 1\)"),
        ({"reactions": np.zeros((40, 2))}, r"got \(41, 6\) and \(40, 2\)"),
        ({"system": "particle"}, "system = 'particle': expected a dalembert.System"),
        ({"scheme": "midpoint"}, "scheme = 'midpoint': expected a dalembert.Scheme"),
        ({"stride": 0}, "stride = 0: expected at least 1"),
        ({"h": np.nan}, "h = nan"),
    ],
)
def test_a_run_of_the_user_is_checked(run, change, text):
    with pytest.raises(ValueError, match=text):
        dal.Solution(**{**fields(run), **change})


def test_what_a_run_of_the_user_is_made_of_is_converted(run):
    given = run.x[::2].astype(np.float32)
    made = dal.Solution(**{**fields(run), "x": given, "reactions": run.reactions[::2], "stride": 2})
    assert made.x.dtype == np.float64 and given.flags.writeable
    np.testing.assert_array_equal(made.energy, run.system.energy(given[:, :3], given[:, 3:]))
    np.testing.assert_array_equal(made.t, run.t[::2])


def test_an_array_reshaped_in_place_is_refused(run):
    run.x.dtype = np.float32
    for compute in (lambda: run.energy, lambda: run(0.5)):
        with pytest.raises(ValueError, match="float32: expected float64"):
            compute()


def test_what_goes_to_c_is_checked():
    good = np.zeros((4, 3))
    assert core.pointer(good, 1, 9) - core.pointer(good) == 3
    assert core.pointer(np.zeros((4, 0)), 3) is not None
    frozen = np.zeros(3)
    frozen.flags.writeable = False
    core.pointer(frozen)
    for array, row, count, output in (
        (good.astype(np.float32), 0, 0, False),
        (good.astype(">f8"), 0, 0, False),
        (good.astype(np.int64), 0, 0, False),
        (good[:, ::2], 0, 0, False),
        (good[::-1], 0, 0, False),
        (good.T, 0, 0, False),
        (good, 1, 10, False),
        (good, 5, 0, False),
        (good, -1, 0, False),
        (frozen, 0, 3, True),
    ):
        with pytest.raises((ValueError, BufferError)):
            core.pointer(array, row, count, output=output)


@pytest.mark.parametrize("stride", [1, 4])
@pytest.mark.parametrize("t0", [0.0, 1.5])
def test_times_count_every_step(stride, t0):
    """A force that depends on t tells which time the multipliers of a stored state were given."""
    force = lambda t, q, v: [0.0, np.cos(3 * t), np.sin(t)]  # noqa: E731
    system = dal.System(
        mass=[1, 1, 1], mu=lambda q: [[-q[1], 0, 1]], force=force, q0=[0, 1, 0], v0=[1, 1, 1]
    )
    run = dal.integrate(system, "midpoint", h=0.05, steps=40, stride=stride, t0=t0)
    np.testing.assert_array_equal(run.t, [t0 + k * stride * 0.05 for k in range(len(run.x))])
    for t, q, v, found in zip(run.t, run.q, run.v, run.multipliers):
        # C lambda = v_x v_y - (f_z - y f_x) (here f_x = 0) with C = 1 + y^2
        expected = (v[0] * v[1] - np.sin(t)) / (1 + q[1] ** 2)
        # the derivative of the form is differenced: 1e-12
        np.testing.assert_allclose(found, [expected], rtol=0, atol=1e-11)
    halfway = (run.t[:-1] + run.t[1:]) / 2
    np.testing.assert_allclose(run(halfway).q, (run.q[:-1] + run.q[1:]) / 2, atol=0.2 * stride**2)
    np.testing.assert_array_equal(run(run.t).q, run.q)


def test_changes_of_the_chart_are_counted_across_blocks(monkeypatch):
    """A heading that turns makes x, then y, the better coordinate: with blocks of any length."""
    run = dal.integrate(
        dal.systems.knife_edge(), "midpoint", h=0.05, steps=400, consistent="project"
    )
    times = np.linspace(0, run.t[-1], 157)
    whole = run(times)
    assert whole.chart_changes >= 3
    for block in (1, 2, 7, 64):
        monkeypatch.setattr(solution.geometry, "most_in_a_call", lambda _, most=block: most)
        found = run(times)
        assert found.chart_changes == whole.chart_changes
        np.testing.assert_array_equal(found.q, whole.q)
        np.testing.assert_array_equal(found.v, whole.v)


@pytest.mark.parametrize(
    ("error", "text"),
    [(0.0, "0"), (1e-3, "about 1e-03 of its size"), (1.2, "as large as the state"),
     (20.0, "20 times its size")],
)  # fmt: skip
def test_the_size_of_the_error_in_words(error, text):
    run = dal.integrate(dal.systems.particle(), h=0.1, steps=4)
    stats = dataclasses.replace(run.stats, error=error, whole=1)
    run = dataclasses.replace(run, stats=stats)
    assert f"\n  error of the last state: {text}\n" in str(run)


def test_what_a_run_says_of_itself(own):
    run = dal.integrate(own.system(), "midpoint", h=0.05, steps=40, stride=4, t0=1)
    assert str(run).splitlines() == [
        "<Solution of own by midpoint, h = 0.05: success",
        "  11 states at t = 1 .. 3, every 4 steps",
        f"  constraint: relative residual at most {run.stats.worst_residual:.1e}",
        f"  error of the last state: about {run.stats.error:.0e} of its size",
        "  40 steps to t = 3>",
    ]

    def gradient(q):
        calls.append(q)
        if len(calls) > 30:
            raise dal.DomainError("a wall")
        return own.gradient(q)

    calls = []
    failed = dal.integrate(own.system(gradient=gradient), h=0.05, steps=40, throw=False)
    assert not failed.success and failed.status < 0 and failed.nodes == "moved"
    assert "FAILED" in str(failed) and str(failed).endswith("DomainError: a wall>")
    kept = dal.integrate(own.system(), "midpoint-nodes", h=0.05, steps=4, initial="project")
    assert run.shift == 0.0
    assert "constraint at kept nodes (D_eps): relative residual at most " in str(kept)
    assert (kept.nodes, kept.shift) == ("kept", 0.025)
    reference = dal.integrate(own.system(), "reference", h=0.05, steps=4)
    assert "residual" not in str(reference) and np.isnan(reference.reactions).all()
    free = dal.integrate(dal.System(mass=[1], q0=[0], v0=[1]), h=0.1, steps=4)
    assert "residual" not in str(free)


# ---- other objects that C counts on --------------------------------------------------------


def test_a_chart_and_an_embedding_do_not_change(particle):
    """Their workspaces in C were made for the system, the scheme and the step of the beginning."""
    large = dal.System(mass=np.eye(40), q0=np.zeros(40), v0=np.zeros(40))
    chart, embedding = dal.Chart(particle), dal.embedding(particle, "midpoint", h=0.1)
    for thing, name, value in (
        (chart, "system", large),
        (chart, "dependent", ()),
        (embedding, "chart", dal.Chart(large)),
        (embedding, "scheme", dal.Scheme.find("leapfrog")),
        (embedding, "start", np.zeros(2)),
        (embedding, "h", 0.2),
    ):
        with pytest.raises(AttributeError, match=f"{type(thing).__name__}.{name} cannot be"):
            setattr(thing, name, value)
    assert copy.deepcopy(chart).system is particle


def test_a_system_is_made_once(particle_in_python):
    with pytest.raises(TypeError, match="__init__ is called only once"):
        particle_in_python.__init__(mass=np.eye(40))
    run = dal.integrate(particle_in_python, h=0.1, steps=2)
    assert run.energy.shape == (3,)


@pytest.mark.parametrize("name", ["n", "m"])
def test_a_subclass_leaves_the_sizes_alone(name):
    with pytest.raises(TypeError, match=f"{name} of a System belongs to its functions"):
        type("Own", (dal.System,), {name: 2})
