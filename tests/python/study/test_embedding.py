"""Embeddings: against numbers of 36 digits, the schemes they reproduce, and the order they measure;
and the perturbed equations of motion."""

import json
import math
import pickle
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot

import dalembert as dal
from conftest import U, particle_derivative, particle_forms, refused, runge_kutta
from dalembert.geometry import cutoff

DATA = Path(__file__).parents[2] / "data"
VECTORS = json.loads((DATA / "vectors.json").read_text(encoding="ascii"))["embedding"]

Z = np.array([0.5, 0.3, -0.2, 1.0, 0.7])  # xi of the particle: x, y, z, v_x, v_y


def largest(x, y=0.0):
    return float(np.max(np.abs(np.asarray(x) - y)))


def of_particle(scheme="midpoint", h=0.1, **options):
    return dal.embedding(dal.systems.particle(), scheme, h, dependent="z", **options)


@pytest.fixture
def midpoint():
    return of_particle()


# ---- numbers -------------------------------------------------------------------------------


def test_cutoff():
    """The exponents are rounded, at most 2 cot(pi/10) = 6; C tests the rest of these numbers."""
    for entry in VECTORS:
        values = cutoff(float(Fraction(entry["tau"])))
        for value, key in zip(values, ("chi0", "chi1", "dchi0"), strict=True):
            assert abs(value - float(entry[key])) <= 64 * U * abs(float(entry[key]))


def test_limit_of_small_steps():
    """g tends to -chi_0' d, with the error constants d of the particle."""
    _, y, _, a, b = Z
    s = 1 + y**2
    first = np.array([a * b * y / (2 * s), 0, -a * b / (2 * s), -a * b**2 / (2 * s**2), 0])
    second = np.array(
        [
            a * b**2 * (2 * y**2 - 1) / (12 * s**2), 0, -a * b**2 * y / (4 * s**2),
            -a * b**3 * y / (4 * s**3), 0,
        ]
    )  # fmt: skip
    taus = np.linspace(0.1, 0.9, 5)
    for scheme, d in (("explicit", first), ("endpoint", -first), ("midpoint", second)):
        embedding = of_particle(scheme, 1e-3)
        # O(h) with a factor of size 1; noise is 4e-10 at most.
        assert largest(embedding.limit(Z), d) <= 2e-3
        slopes = cutoff(taus)[2]
        assert largest(embedding.g(taus, Z), -slopes[:, None] * d) <= 4e-3


# ---- the scheme as a period map ------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "scheme", "h"),
    [
        ("sleigh", "leapfrog", -0.1),
        ("ball_on_table", "midpoint", 0.1),
    ],
)
def test_period_map(name, scheme, h):
    system = dal.systems.get(name)
    embedding = dal.embedding(system, scheme, h)
    run = dal.integrate(system, scheme, h=h, steps=2)
    ends = embedding.chart.drop(run.q, run.v)
    # The perturbed flow has the tolerance 1e-12 for each of its steps.
    assert largest(embedding.flow(0, h), ends[1]) <= 1e-10
    assert largest(embedding.flow(3 * h, 5 * h), ends[2]) <= 2e-10
    assert largest(embedding.flow(h, 0, ends[1]), ends[0]) <= 1e-10
    assert largest(embedding.flow(0.3 * h, h, embedding.flow(0, 0.3 * h)), ends[1]) <= 1e-10
    # The curves are those solutions.
    assert largest(embedding.curve([0, 1, 2]), ends) <= 1e-12
    assert largest(embedding.curve(0.4), embedding.flow(0, 0.4 * h)) <= 1e-10
    assert largest(embedding.curve(1.4), embedding.curve(0.4, ends[1])) <= 1e-12


@pytest.mark.parametrize("dependent", ["x", "z"])
def test_any_choice_of_coordinates(particle, dependent):
    embedding = dal.embedding(particle, "midpoint", 0.2, dependent=dependent)
    assert embedding.chart.dependent == (dependent,)
    assert f"v_{dependent}" not in embedding.coordinates
    run = dal.integrate(particle, "midpoint", h=0.2, steps=1)
    end = np.concatenate(embedding.chart.lift(embedding.flow(0, 0.2)))
    assert largest(end, run.x[1]) <= 1e-10


def test_period_map_of_the_users_own(own):
    """Functions in Python, m = 2, and no exact solution; the perturbed ODE integrated here."""
    system, h = own.system(), 0.1
    embedding = dal.embedding(system, "midpoint", h)
    assert embedding.numerical and embedding.accuracy == pytest.approx(1e-14)

    def field(t, z):
        return embedding.chart.field(z) + h**2 * embedding.g(t / h, z)

    run = dal.integrate(system, "midpoint", h=h, steps=1)
    end = runge_kutta(field, embedding.start, h, 20)
    assert largest(end, embedding.chart.drop(run.q[1], run.v[1])) <= 1e-9


def test_on_nonlinear_constraints(particle):
    """Nothing changes for them: D_delta is a set of states as D is."""
    system = particle.at_kept_nodes(0.2)
    q, v = particle.q0, system.project(particle.q0, particle.v0)
    bounds = [dal.embedding(system, "midpoint", h, q0=q, v0=v).bound() for h in (0.2, 0.1, 0.05)]
    assert max(bounds) < 1.2 * min(bounds)
    embedding = dal.embedding(system, "midpoint", 0.2, q0=q, v0=v)
    run = dal.integrate(system, "midpoint", q, v, h=0.2, steps=1)
    assert largest(embedding.flow(0, 0.2), embedding.chart.drop(run.q[1], run.v[1])) <= 1e-10


def test_kept_nodes_are_embedded_by_their_moved_map(midpoint):
    kept = of_particle("midpoint-nodes", order=2)
    np.testing.assert_array_equal(kept.g([0.3, 0.6], Z), midpoint.g([0.3, 0.6], Z))


# ---- the field -----------------------------------------------------------------------------


def test_g_is_periodic_and_vanishes_at_integers(midpoint):
    np.testing.assert_array_equal(midpoint.g([0, 1, -3, 7.0], Z), np.zeros((4, 5)))
    values = midpoint.g([0.4, 1.4, -2.6], Z)
    assert largest(values, values[0]) <= 32 * midpoint.noise
    assert largest(values) > 1e-2


def test_rows(midpoint):
    taus = np.array([0.2, 0.5, 0.7])
    places = Z + np.outer([0.0, 0.1, -0.1], np.ones(5))
    for method in (midpoint.g, midpoint.source, midpoint.curve, midpoint.g_tilde):
        width = 6 if method == midpoint.g_tilde else 5
        both = method(taus, places)
        assert both.shape == (3, width) and method(0.2, Z).shape == (width,)
        for k in range(3):
            np.testing.assert_array_equal(both[k], method(taus[k], places[k]))
        np.testing.assert_array_equal(method(taus, Z)[1], method(taus[1], Z))
        np.testing.assert_array_equal(method(0.2, places)[2], method(0.2, places[2]))
        np.testing.assert_array_equal(method(taus), method(taus, midpoint.start))
        assert method([], Z).shape == (0, width)
    np.testing.assert_array_equal(midpoint.limit(), midpoint.limit(midpoint.start))


def test_g_tilde(own):
    """g~ is g lifted: tangent to D, so that the reactions stay those of the plain problem."""
    system = own.system()
    embedding = dal.embedding(system, "explicit", 0.1)
    q, v = own.q0, own.v0()
    for tau in (0.3, 0.6):
        g, gt = embedding.g(tau), embedding.g_tilde(tau)
        np.testing.assert_array_equal(embedding.chart.drop(gt[:4], gt[4:]), g)
        # d(mu v) along g~: sums of 10 terms of size 1.
        tangent = own.mu_v_q(q, v) @ gt[:4] + own.mu(q) @ gt[4:]
        assert largest(tangent) <= 256 * U
        field, multipliers = system.perturbed(q, v, gt, 0.1)
        assert largest(field, system.field(q, v) + 0.1 * gt) <= 1e-13
        assert largest(multipliers, system.multipliers(q, v)) <= 1e-13


# ---- perturbed equations -------------------------------------------------------------------


def test_perturbed_against_the_saddle_point_system(own):
    """ODEPert and hatLambday, from [[M, -mu^T], [mu, 0]] with the perturbation in it."""
    rng = np.random.default_rng(2)
    q = own.q0 + 0.2 * rng.standard_normal((5, 4))
    system, weight = own.system(), 0.3
    v = system.project(q, rng.standard_normal((5, 4)))
    ghat = rng.standard_normal((5, 8))
    field, multipliers = system.perturbed(q, v, ghat, weight)
    for k in range(5):
        mu, turn = own.mu(q[k]), own.mu_v_q(q[k], v[k])
        qdot = v[k] + weight * ghat[k, :4]
        saddle = np.block([[own.mass, -mu.T], [mu, np.zeros((2, 2))]])
        force = own.mass @ (weight * ghat[k, 4:]) - own.gradient(q[k])
        x = np.linalg.solve(saddle, np.concatenate([force, -turn @ qdot]))
        assert largest(field[k], [*qdot, *x[:4]]) <= 1e-13
        assert largest(multipliers[k], x[4:]) <= 1e-13
        one = system.perturbed(q[k], v[k], ghat[k], weight)
        np.testing.assert_array_equal(one[0], field[k])
        np.testing.assert_array_equal(one[1], multipliers[k])
    assert largest(system.perturbed(q, v, ghat, 0.0)[0], system.field(q, v)) <= 1e-15
    with pytest.raises(ValueError, match=r"ghat: expected shape \(8,\), got \(4,\)"):
        system.perturbed(q[0], v[0], ghat[0, :4])
    with pytest.raises(ValueError, match=r"ghat\[2\] = nan"):
        system.perturbed(q[0], v[0], [0, 0, np.nan, 0, 0, 0, 0, 0])
    with pytest.raises(ValueError, match="weight = inf"):
        system.perturbed(q[0], v[0], ghat[0], np.inf)


@pytest.mark.parametrize(("scheme", "miss"), [("explicit", 7.2e-3), ("midpoint", 1.65e-4)])
def test_only_the_right_perturbed_ode_has_the_scheme_as_its_period_map(particle, scheme, miss):
    """With ghat = g~, ODEPert leads to Phi, and ODEPert2 past it, though it stays in D (E2)."""
    h = 0.2
    embedding = of_particle(scheme, h)
    weight = h**embedding.order

    def g_tilde(t, x):
        return embedding.g_tilde(t / h, embedding.chart.drop(x[:3], x[3:]))

    def right(t, x):
        return particle.perturbed(x[:3], x[3:], g_tilde(t, x), weight)[0]

    def printed(t, x):
        q, v, push = x[:3], x[3:], weight * g_tilde(t, x)[:3]
        mu, turn = particle_forms(q), particle_derivative(q, v)
        reaction = mu.T @ np.linalg.solve(mu @ mu.T, turn @ push)  # M = 1
        return particle.field(q, v) + np.concatenate([push, -reaction])

    start = np.concatenate([particle.q0, particle.v0])
    end = dal.integrate(particle, scheme, h=h, steps=1).x[-1]
    # 80 steps of order 4 of a field that changes over tenths of the period.
    assert largest(runge_kutta(right, start, h, 80), end) <= 1e-11
    past = runge_kutta(printed, start, h, 80)
    assert largest(past, end) == pytest.approx(miss, rel=0.02)
    assert particle.relative_residual(past[:3], past[3:]) <= 80 * 4 * U


# ---- what it measures ----------------------------------------------------------------------

def test_measured_order_of_a_record_without_a_promise():
    """With beta = 0.3 and 0.7 over half steps each the first order cancels on D."""
    for substeps, order in (([(0.3, 1.0)], 1), ([(0.3, 0.5), (0.7, 0.5)], 2)):
        found = of_particle(dal.Scheme(substeps), 0.2, order=3).measured_order()
        assert found.points == 5 and abs(found.slope - order) < 0.1
    with pytest.raises(ValueError, match="promises none"):
        of_particle(dal.Scheme([(0.3, 1.0)]))


def test_noise():
    """The noise is that of the flow times h^-(p+1), and says where p = 4 has no meaning."""
    exact = of_particle("leapfrog-suzuki4", 0.1)
    rough = of_particle("leapfrog-suzuki4", 0.1, numerical=True, tolerance=1e-9)
    assert not exact.numerical and exact.accuracy == pytest.approx(4 * U)
    assert rough.numerical and rough.accuracy == pytest.approx(1e-9)
    assert exact.noise == pytest.approx(4 * U * 1e5) and rough.noise == pytest.approx(1e-4)
    assert exact.meaningful() and not rough.meaningful()
    assert exact.with_step(0.05).noise == pytest.approx(32 * exact.noise)
    assert not exact.with_step(2e-3).meaningful()
    # Steps without a meaning do not count for the order.
    fit = exact.measured_order([0.25, 0.15, 0.1, 0.002, 0.001])
    assert fit.points == 3 and abs(fit.slope - 4) < 0.1
    assert np.isnan(exact.measured_order([0.002, 0.001]).slope)
    # It is about what the two flows differ by.
    for h in (0.2, 0.1, 0.05):
        one, other = (of_particle("midpoint", h, numerical=flag) for flag in (False, True))
        taus = np.linspace(0.05, 0.95, 19)
        assert 0 < largest(one.g(taus, Z), other.g(taus, Z)) <= 32 * other.noise


# ---- as an object --------------------------------------------------------------------------


def test_what_it_is(particle):
    embedding = dal.embedding(particle, "midpoint", 0.1, q0=[0, 1, 0], v0=[1, 2, 1])
    assert embedding.system is particle and embedding.scheme.name == "midpoint"
    assert embedding.order == 2 and embedding.h == 0.1
    independent = embedding.chart.independent
    assert embedding.coordinates == ("x", "y", "z", *(f"v_{name}" for name in independent))
    np.testing.assert_array_equal(embedding.start, embedding.chart.drop([0, 1, 0], [1, 2, 1]))
    assert not embedding.start.flags.writeable
    assert repr(embedding).startswith("<Embedding of midpoint on particle: h = 0.1, p = 2, exact")
    assert "reference flow" in repr(of_particle(numerical=True))
    assert of_particle("explicit", order=3).order == 3


def test_with_step_keeps_the_rest():
    embedding = of_particle("midpoint", order=3, numerical=True, tolerance=1e-12)
    other = embedding.with_step(0.05)
    same = of_particle("midpoint", 0.05, order=3, numerical=True, tolerance=1e-12)
    assert (other.h, other.order, other.numerical, other.tolerance) == (0.05, 3, True, 1e-12)
    np.testing.assert_array_equal(other.g(0.4, Z), same.g(0.4, Z))
    assert embedding.h == 0.1


def test_pickle(midpoint, particle_in_python):
    for embedding in (midpoint, dal.embedding(particle_in_python, "explicit", 0.1)):
        again = pickle.loads(pickle.dumps(embedding))
        np.testing.assert_array_equal(again.g(0.4), embedding.g(0.4))
        assert repr(again) == repr(embedding)


def test_threads_share_it(midpoint):
    taus = np.linspace(0, 1, 100)
    with ThreadPoolExecutor(4) as pool:
        for values in pool.map(midpoint.g, [taus] * 4):
            np.testing.assert_array_equal(values, midpoint.g(taus))


# ---- what may go wrong ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"system": "particle"}, "system = 'particle'"),
        ({"scheme": "reference"}, "scheme = 'reference'"),
        ({"scheme": "nothing"}, "nothing"),
        ({"h": 0.0}, "h = 0"),
        ({"h": np.nan}, "h = nan"),
        ({"h": "x"}, "h = 'x'"),
        ({"order": 0}, "order = 0: expected at least 1"),
        ({"order": -1}, "order = -1"),
        ({"order": 1.5}, "order = 1.5"),
        ({"q0": [0, 1], "v0": [0, 1]}, r"q0: expected shape \(3,\), got \(2,\)"),
        ({"dependent": "w"}, "dependent: there is no coordinate 'w'"),
        ({"dependent": ["x", "z"]}, "dependent = .*expected m = 1"),
        ({"consistent": "perhaps"}, "consistent = 'perhaps'"),
        ({"tolerance": 0.0}, "tolerance = 0.0"),
        ({"tolerance": 1e-300}, "tolerance = 1e-300"),
        ({"tolerance": 1.0}, "tolerance = 1.0"),
        ({"tolerance": np.inf}, "tolerance = inf"),
    ],
)
def test_wrong_arguments_are_named(particle, arguments, text):
    given = {"system": particle, "scheme": "midpoint", "h": 0.1, **arguments}
    with pytest.raises(ValueError, match=text):
        dal.embedding(**given)


def test_data_off_D_are_refused(particle):
    with pytest.raises(dal.NotOnConstraintError, match="consistent='project'"):
        dal.embedding(particle, "midpoint", 0.1, q0=particle.q0, v0=[1, 1, 1])
    projected = dal.embedding(
        particle, "midpoint", 0.1, q0=particle.q0, v0=[1, 1, 1], consistent="project"
    )
    v = particle.project(particle.q0, [1, 1, 1])
    assert largest(projected.start, projected.chart.drop(particle.q0, v)) <= 4 * U


def test_forces_are_refused():
    pushed = dal.System(
        mass=[1, 1, 1], mu=particle_forms, force=lambda t, q, v: [t, 0, 0],
        q0=[0, 1, 0], v0=[1, 1, 1],
    )  # fmt: skip
    with pytest.raises(NotImplementedError, match="autonomous"):
        dal.embedding(pushed, "midpoint", 0.1)


@pytest.mark.parametrize("method", ["g", "g_tilde", "source", "curve"])
def test_wrong_points_are_named(midpoint, method):
    call, name = getattr(midpoint, method), "y" if method == "curve" else "z"
    refused([
        (lambda: call(0.5, np.ones(6)), rf"{name}: expected shape \(5,\) or \(N, 5\), got \(6,\)"),
        (lambda: call([0.1, 0.2], np.ones((3, 5))), f"{name}: expected 2 rows as tau has, got 3"),
        (lambda: call(0.5, [0, np.nan, 0, 1, 1]), rf"{name}\[1\] = nan"),
        (lambda: call([0.5, np.inf]), r"tau\[1\] = inf"),
        (lambda: call([[0.5]]), "tau: expected shape"),
    ])  # fmt: skip


def test_other_wrong_arguments(midpoint):
    refused([
        (lambda: midpoint.curve(-0.5), "tau = -0.5: expected a number in"),
        (lambda: midpoint.flow(0, np.inf), "t1 = inf"),
        (lambda: midpoint.flow(0, 0.1, np.ones(4)), r"z: expected shape \(5,\), got \(4,\)"),
        (lambda: midpoint.with_step(0), "h = 0"),
        (lambda: midpoint.measured_order([np.nan]), r"hs\[0\] = nan"),
        (lambda: midpoint.plot(hs=[0.0]), "h = 0"),
        (lambda: midpoint.plot(hs=[]), "hs is empty"),
        (lambda: dal.plot.perturbation("midpoint"), "expected a dalembert.Embedding"),
        *(
            (lambda call=call: call(np.ones((2, 5))), r"z: expected shape \(5,\), got \(2, 5\)")
            for call in (midpoint.bound, midpoint.meaningful, midpoint.limit)
        ),
    ])  # fmt: skip
    assert midpoint.flow(0.3, 0.3).tolist() == midpoint.start.tolist()


def test_progress_of_a_flow(midpoint):
    told = []
    end = midpoint.flow(0.0, 2.05, progress=lambda *numbers: told.append(numbers))
    assert (end == midpoint.flow(0.0, 2.05)).all()
    done, totals = zip(*told, strict=True)
    assert set(totals) == {math.ceil(2.05 / midpoint.h)} and done[-1] == totals[0]
    assert sorted(done) == list(done)
    with pytest.raises(ValueError, match="progress = 3"):
        midpoint.flow(0.0, 1.0, progress=3)


def test_a_period_that_is_too_long():
    """Curves that do not cover the states: the iteration for the source says so."""
    embedding = dal.embedding(dal.systems.heisenberg(), "explicit", 5.0)
    with pytest.raises(dal.ConvergenceError, match="h = 5 is too large") as caught:
        embedding.g([0.0, 0.5])
    assert caught.value.step == 1


def test_exceptions_come_back_as_themselves(own):
    class Mine(Exception):
        pass

    armed = []

    def gradient(q):
        if armed:
            raise armed[0]
        return own.gradient(q)

    embedding = dal.embedding(own.system(gradient=gradient), "midpoint", 0.1)
    armed.append(Mine("here"))
    for call in (embedding.g, embedding.source, lambda tau: embedding.flow(0, tau)):
        with pytest.raises(Mine) as caught:
            call(0.5)
        assert caught.value is armed[0]
    armed.clear()
    assert np.isfinite(embedding.g(0.5)).all()


# ---- the picture ---------------------------------------------------------------------------


@pytest.mark.usefixtures("no_windows")
def test_picture(midpoint):
    ax = midpoint.plot()
    entries = [text.get_text() for text in ax.get_legend().get_texts()]
    assert entries == [
        f"{h:g}, noise {midpoint.with_step(h).noise:.0e}" for h in (0.1, 0.05, 0.025)
    ]
    curves = [line for line in ax.lines if line.get_label() in entries]
    levels = [line for line in ax.lines if line.get_label() not in entries]
    assert len(curves) == len(levels) == 3
    for h, curve, level in zip((0.1, 0.05, 0.025), curves, levels):
        one = midpoint.with_step(h)
        taus = curve.get_xdata()
        np.testing.assert_array_equal(curve.get_ydata(), np.abs(one.g(taus)).max(axis=1))
        assert set(level.get_ydata()) == {one.noise}
        assert curve.get_color() == level.get_color()
        assert curve.get_linestyle() == level.get_linestyle()
    assert len({line.get_linestyle() for line in curves}) == 3
    assert "tau" in ax.get_xlabel() and ax.get_ylabel() == "largest component of |g|"
    assert ax.get_title() == "particle: midpoint with p = 2"
    _, mine = pyplot.subplots()
    assert dal.plot.perturbation(midpoint, mine, hs=[0.2], z=Z + 0.1) is mine
    expected = np.abs(midpoint.with_step(0.2).g(0.5, Z + 0.1)).max()
    assert np.interp(0.5, *mine.lines[0].get_data()) == expected
