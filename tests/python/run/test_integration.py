"""Runs: the schemes against NumPy, the grid of time, arguments, the Solution, and failures."""

import pickle
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp

import dalembert as dal
from conftest import U
from dalembert.run import integration
from dalembert.run.runs import Run

STEPS, H = 20, 0.05
# Newton stops within a few u of the solution; 20 steps of a smooth flow over one unit of time
# amplify that by less than e^5 = 150, and numbers are below 10: 64 * 150 * 10 * u = 1e-11.
TOLERANCE = 1e-11


def transcribed(own, substeps, h=H, steps=STEPS, q=None, v=None):
    """The states and the mean multipliers of a composition of beta-schemes."""
    q, v = (own.q0, own.v0()) if q is None else (q, v)
    states, reactions = [np.concatenate([q, v])], []
    for _ in range(steps):
        mean = np.zeros(2)
        for beta, fraction in substeps:
            q, v, lam = own.beta_step(beta, fraction * h, q, v)
            mean += fraction * lam
        states.append(np.concatenate([q, v]))
        reactions.append(mean)
    return np.array(states), np.array(reactions)


# ---- schemes -------------------------------------------------------------------------------


@pytest.mark.parametrize("beta", [0.0, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("h", [H, -H])
def test_beta_schemes(own, beta, h):
    run = dal.integrate(own.system(), beta, h=h, steps=STEPS)
    x, reactions = transcribed(own, [(beta, 1.0)], h)
    np.testing.assert_allclose(run.x, x, rtol=TOLERANCE, atol=TOLERANCE)
    # lambda is an impulse divided by h.
    np.testing.assert_allclose(run.reactions, reactions, atol=TOLERANCE / H)
    assert run.residual.max() <= 4 * 4 * U


@pytest.mark.parametrize(("name", "beta"), [("explicit", 0.0), ("midpoint", 0.5), ("endpoint", 1)])
def test_names_are_numbers(own, name, beta):
    system = own.system()
    named = dal.integrate(system, name, h=H, steps=STEPS)
    np.testing.assert_array_equal(named.x, dal.integrate(system, beta, h=H, steps=STEPS).x)
    assert named.scheme.name == name


@pytest.mark.parametrize(
    ("name", "substeps"),
    [
        ("leapfrog", [(0.0, 0.5), (1.0, 0.5)]),
        ("leapfrog-mirror", [(1.0, 0.5), (0.0, 0.5)]),
        (None, [(0.5, 0.25), (0.0, 0.5), (1.0, 0.25)]),
    ],
)
def test_compositions(own, name, substeps):
    scheme = name or dal.Scheme(substeps, name="three")
    run = dal.integrate(own.system(), scheme, h=H, steps=STEPS)
    x, reactions = transcribed(own, substeps)
    np.testing.assert_allclose(run.x, x, rtol=TOLERANCE, atol=TOLERANCE)
    np.testing.assert_allclose(run.reactions, reactions, atol=TOLERANCE / H)
    if name:
        np.testing.assert_allclose(run.scheme.substeps, substeps, rtol=0)


@pytest.mark.parametrize("beta", [0.0, 0.5, 0.75])
@pytest.mark.parametrize("initial", ["D", "D_eps", "project", "shift"])
def test_kept_nodes(own, beta, initial):
    system, shift = own.system(), (1 - beta) * H
    scheme = dal.Scheme([(beta, 1)], nodes="kept")
    q, v = own.q0, own.v0()
    if initial == "D_eps":
        v = system.project(q, v, shift)
    run = dal.integrate(system, scheme, q, v, h=H, steps=STEPS, initial=initial)
    # The state of the moved nodes that belongs to the initial node and velocity.
    node = q + shift * v if initial == "shift" else q
    if initial == "project":
        v = system.project(q, v, shift)
    x, _ = transcribed(own, [(beta, 1.0)], q=node - shift * v, v=v)
    x[:, :4] += shift * x[:, 4:]
    np.testing.assert_allclose(run.x, x, rtol=TOLERANCE, atol=TOLERANCE)
    assert run.nodes == "kept" and run.shift == shift
    kept = run.residual[1:] if initial == "D" else run.residual
    assert kept.max() <= 4 * 4 * U  # of D_eps
    assert run.residual[0] > 1e-4 or initial != "D"
    if beta == 0.5:
        assert abs(run.constraint[1:]).max() > 1e-6  # of D: not kept


def test_python_and_c_functions_give_the_same_bits(particle, particle_in_python):
    for scheme in ("midpoint", "leapfrog", "midpoint-kl6"):
        runs = [dal.integrate(s, scheme, h=0.1, steps=50) for s in (particle, particle_in_python)]
        np.testing.assert_array_equal(runs[0].x, runs[1].x)
        np.testing.assert_array_equal(runs[0].reactions, runs[1].reactions)


def test_representations_of_schemes():
    assert repr(dal.Scheme.find("leapfrog")) == (
        "<Scheme leapfrog: (beta, fraction) = (0, 0.5), (1, 0.5); moved nodes, order 2>"
    )
    assert repr(dal.Scheme([(0.5, 1.0)], nodes="kept", name="mine")) == (
        "<Scheme mine: (beta, fraction) = (0.5, 1); kept nodes>"
    )
    assert "..., 18 in all" in repr(dal.Scheme.find("leapfrog-kl6"))
    assert repr(dal.Scheme.find("reference")) == "<Scheme reference: family flow>"


def test_table_of_schemes():
    names = [scheme.name for scheme in dal.schemes()]
    assert {"leapfrog", "midpoint", "explicit", "endpoint", "midpoint-nodes"} <= set(names)
    for scheme in dal.schemes():
        assert scheme.help and (scheme.order >= 1) == (scheme.family == "beta")
        assert not scheme.substeps or abs(sum(f for _, f in scheme.substeps) - 1) < 1e-14
        assert dal.Scheme.find(scheme.name) == scheme
        assert dal.Scheme.find(scheme.name.replace("-", "_")) == scheme
        assert pickle.loads(pickle.dumps(scheme)) == scheme
    assert dal.Scheme.find("midpoint-nodes").nodes == "kept"
    assert dal.Scheme.find("0.3").substeps == ((0.3, 1.0),)


@pytest.mark.parametrize("beta", [0, 0.25, 0.5, 1.0])
def test_beta_as_a_number_is_the_scheme_of_that_number(beta, monkeypatch):
    by_name = dal.Scheme.find(repr(float(beta)))
    find = dal.Scheme.find

    def without_point(name):
        assert "." not in name, "C would read it by its locale"
        return find(name)

    monkeypatch.setattr(dal.Scheme, "find", without_point)
    assert dal.Scheme.of(beta) == by_name


def test_explicit_is_a_property_of_scheme_and_system(own):
    assert dal.Scheme.find("explicit").is_explicit(own.system())
    assert not dal.Scheme.find("midpoint").is_explicit(own.system())
    assert dal.Scheme.find("midpoint-nodes").shift(0.1) == 0.05
    with pytest.raises(NotImplementedError, match="leapfrog"):
        dal.Scheme.find("leapfrog").shift(0.1)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: dal.Scheme([(1.5, 1)]), "1.5"),
        (lambda: dal.Scheme([(0.5, 0.5)]), "0.5"),
        (lambda: dal.Scheme([(0, 0.5), (1, 0.5)], nodes="kept"), "kept"),
        (lambda: dal.Scheme([(0.5, 1)], nodes="fixed"), "nodes = 'fixed'.*'moved', 'kept'"),
        (lambda: dal.Scheme([]), "at least one"),
        (lambda: dal.Scheme(3), r"substeps: expected shape \(N, 2\), got \(\)"),
        (lambda: dal.Scheme([(0.5, 1)], name=3), "name = 3: expected a string"),
        (lambda: dal.Scheme([(0.5, 1)], order=1.5), "order = 1.5: expected an integer"),
        (lambda: dal.Scheme.find(3), "scheme = 3: expected a string"),
        (lambda: dal.Scheme([0.5, 1]), r"shape \(N, 2\), got \(2,\)"),
        (lambda: dal.Scheme([(0.5, 1)], name="x" * 40), "39 bytes"),
        (lambda: dal.Scheme.find("simpson"), "simpson.*leapfrog"),
        (lambda: dal.Scheme.of(1.5), r"scheme = 1.5: expected beta in \[0, 1\]"),
        (lambda: dal.Scheme.of(float("nan")), "scheme = nan: expected beta"),
        (lambda: dal.Scheme.find("leap"), '"leap"; choose .*a number.*did you mean .leapfrog.'),
        (lambda: dal.Scheme.find("simpson"), '"simpson"; choose .*-nodes.*reference.*pair:A:B'),
        (lambda: dal.Scheme.find("refrence"), "did you mean 'reference'"),
        (lambda: dal.Scheme.of(10**400), "scheme = 1000.*: expected a Scheme"),
        (lambda: dal.Scheme.find("midpoint").shift("x"), "h = 'x': expected a finite number"),
        (lambda: dal.Scheme.find("midpoint").is_explicit(3), "system = 3: expected a dalembert.Sy"),
        (lambda: dal.Scheme.of(None), "scheme"),
    ],
)
def test_wrong_schemes(make, text):
    with pytest.raises(ValueError, match=text):
        make()


# ---- the reference flow --------------------------------------------------------------------


def test_reference(own):
    system = own.system()
    there = dal.reference(system, own.q0, own.v0(), 2.0)
    back = dal.reference(system, there.q, there.v, t=0.0, t0=2.0)
    np.testing.assert_allclose(back.q, own.q0, atol=1e-11)
    np.testing.assert_allclose(back.v, own.v0(), atol=1e-11)
    assert 0 < there.accuracy < 1e-11
    fine = dal.integrate(system, "leapfrog-kl8", h=0.02, t_end=2)
    np.testing.assert_allclose(there.q, fine.q[-1], atol=1e-10)  # 1e-10: order 8 at h = 0.02


@pytest.mark.parametrize("method", ["rk8pd", "msadams", "rodas"])
@pytest.mark.parametrize("coordinates", ["x", "xi"])
def test_tolerances_below_roundoff_are_refused(particle, method, coordinates):
    options = {"method": method, "coordinates": coordinates}
    for tolerance in (1e-300, 4.4e-16, -1.0, 0.2):
        with pytest.raises(ValueError, match=r"tolerance = .*: expected a number from 4.4e-16 "):
            dal.reference(particle, t=1e-3, tolerance=tolerance, **options)
    assert dal.reference(particle, t=1e-9, tolerance=4 * U, **options).accuracy < 1e-14


def test_reference_refuses_data_off_D(particle):
    for call in (
        lambda: dal.reference(particle, [0, 1, 0], [1, 1, 3], 1.0),
        lambda: dal.integrate(particle, "reference", [0, 1, 0], [1, 1, 3], h=0.1, steps=1),
    ):
        with pytest.raises(dal.NotOnConstraintError, match="0.333.*consistent='project'"):
            call()
    end = dal.reference(particle, [0, 1, 0], [1, 1, 3], t=0.0, consistent="project")
    np.testing.assert_array_equal(end.v, [2, 1, 2])
    run = dal.integrate(
        particle, "reference", [0, 1, 0], [1, 1, 3], h=0.1, steps=1, consistent="project"
    )
    np.testing.assert_array_equal(run.v[0], [2, 1, 2])
    assert run.stats.initial_correction == pytest.approx(np.sqrt(2), rel=1e-14)
    run = dal.integrate(
        particle, "reference", [0, 1, 0], [1, 1, 3], h=0.1, steps=1, consistent="assume"
    )
    np.testing.assert_array_equal(run.v[0], [1, 1, 3])


# ---- grid of time --------------------------------------------------------------------------


def test_times_are_not_accumulated(particle):
    run = dal.integrate(particle, "midpoint", h=0.1, t_end=100, t0=0.0)
    assert run.t[-1] == 1000 * 0.1
    np.testing.assert_array_equal(run.t, [k * 0.1 for k in range(1001)])
    run = dal.integrate(particle, "midpoint", h=-0.1, t_end=-2, t0=1.0, stride=5)
    np.testing.assert_array_equal(run.t, [1.0 + k * -0.1 for k in range(0, 31, 5)])


def test_stride(own):
    system = own.system()
    every = dal.integrate(system, "leapfrog", h=H, steps=STEPS)
    some = dal.integrate(system, "leapfrog", h=H, steps=STEPS, stride=4)
    np.testing.assert_array_equal(some.x, every.x[::4])
    means = every.reactions.reshape(5, 4, 2).mean(axis=1)
    np.testing.assert_allclose(some.reactions, means, rtol=1e-14)
    assert some.stats.steps == STEPS


HOW = [
    {"h": H, "steps": STEPS}, {"h": -H, "steps": STEPS, "stride": 4}, {"h": "auto", "t_end": 1.0},
    {"h": H, "steps": STEPS, "energy": "keep"}, {"h": H, "steps": STEPS, "t_eval": [0.03, 0.5]},
]  # fmt: skip


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("scheme", ["leapfrog-kl6", "midpoint-suzuki4", "bm6"])
def test_a_run_has_no_memory_of_those_before(scheme, how):
    system = dal.systems.particle_oscillator()
    q, v = system.q0, system.v0
    alone = dal.integrate(system, scheme, q, v, **how)
    inner = []

    def inside(step, t, q, v):  # while the run has the stepper
        inner.append(dal.integrate(system, scheme, system.q0, system.v0, **how))
        return step >= 4

    dal.integrate(system, scheme, q, -2 * v, observer=inside, **how)
    assert [len(kept) for kept in system._steppers.values()] == [2]
    for again in (*inner, dal.integrate(system, scheme, q, v, **how)):
        assert again.x.tobytes() == alone.x.tobytes()
        assert again.reactions.tobytes() == alone.reactions.tobytes()
        assert (again.stats, again.message) == (alone.stats, alone.message)


def test_steppers_of_failed_and_of_large_runs_are_not_kept(particle):
    with pytest.raises(dal.NotOnConstraintError):
        dal.integrate(particle, q0=[0, 1, 0], v0=[1, 0, 2], h=H, steps=1)
    assert not any(particle._steppers.values())
    large = dal.System(mass=np.ones(70), q0=np.zeros(70), v0=np.ones(70))
    for system, scheme in ((large, "leapfrog"), *((particle, k / 50) for k in range(50))):
        dal.integrate(system, scheme, h=1e-3, steps=1)
    assert not large._steppers
    assert 0 < sum(map(len, particle._steppers.values())) <= 16


def test_stride_longer_than_a_block(particle):
    steps = 50_000  # in pieces of 10 000
    some = dal.integrate(particle, "midpoint", h=1e-4, steps=steps, stride=steps // 2)
    every = dal.integrate(particle, "midpoint", h=1e-4, steps=steps)
    np.testing.assert_array_equal(some.x, every.x[:: steps // 2])
    # The mean of 25 000 numbers summed in another order: 25 000 u relative at most.
    np.testing.assert_allclose(
        some.reactions, every.reactions.reshape(2, -1, 1).mean(axis=1), rtol=steps * U
    )


def test_no_steps(own):
    seen = []
    for scheme in ("leapfrog", "reference"):
        run = dal.integrate(
            own.system(), scheme, h=H, steps=0, observer=lambda *state: seen.append(state)
        )
        assert run.success and run.x.shape == (1, 8) and run.reactions.shape == (0, 2)
        assert run.t.tolist() == [0.0] and run.energy.shape == (1,)
    assert [state[:2] for state in seen] == [(0, 0.0), (0, 0.0)]
    assert dal.integrate(own.system(), h=H, t_end=0).x.shape == (1, 8)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"h": 0.03, "t_end": 1.0}, "33.33.* t_end = 0.99 or 1.02, or h = 0.0294.* or 0.0303"),
        ({"h": 2, "t_end": 1}, r"take t_end = 2.0, or h = 1.0$"),
        ({"h": 0.3, "t_end": 1}, r"take t_end = 0.9 or 1.2, or h = 0.25 or 0.3333333333333333$"),
        ({"h": -0.3, "t0": 0.1, "t_end": -1}, r"take t_end = -0.8 or -1.1, or h = -0.275 or "),
        ({"h": 0.1, "t_end": -1.0}, "t_end = -1: expected a time after"),
        ({"h": 0.1}, "t_end and steps.*none"),
        ({"h": 0.1, "t_end": 1.0, "steps": 10}, "t_end and steps.*both"),
        ({"h": 0, "steps": 1}, "h = 0"),
        ({"h": np.nan, "steps": 1}, "h = nan"),
        ({"h": [0.1], "steps": 1}, r"h = \[0.1\]: expected a finite number"),
        ({"h": 0.1, "t_end": "x"}, "t_end = 'x': expected a finite number"),
        ({"h": 0.1, "steps": -1}, "steps = -1"),
        ({"h": 0.1, "steps": 1.0}, "steps = 1.0: expected an integer"),
        ({"h": 0.1, "steps": 10, "stride": 3}, "steps = 10.*stride = 3, 9 or 12"),
        ({"h": 0.1, "steps": 10, "stride": 0}, "stride = 0"),
        ({"h": 0.1, "steps": 1, "consistent": "maybe"}, "consistent = 'maybe'.*'check'"),
        ({"h": 0.1, "steps": 1, "initial": "D"}, "initial = 'D'.*moved"),
        ({"h": 0.1, "steps": 1, "scheme": "midpoint-nodes"}, "initial is miss.*'shift' moves q0"),
        ({"h": 0.1, "steps": 1, "scheme": []}, r"scheme = \[\]: expected a Scheme"),
        ({"h": 0.1, "steps": 1, "observer": 3}, "observer = 3: expected a function"),
        ({"h": 0.1, "steps": 1, "progress": 3}, "progress = 3: expected True, False or a function"),
        ({"h": 0.1, "steps": 1, "max_iterations": 0}, "max_iterations = 0"),
        ({"h": 0.1, "steps": 1, "q0": [0, 1], "v0": [0, 1, 1]}, r"q0: .* \(3,\), got \(2,\)"),
        ({"h": 0.1, "steps": 1, "q0": [0, 1, 1], "v0": [0, 1, np.inf]}, r"v0\[2\] = inf"),
        ({"h": 0.1, "steps": 1, "t0": None}, "t0"),
        ({"h": 1e-300, "t_end": 1.0e9}, "too small"),
        ({"h": 0.1, "steps": 2**63}, "steps = 9223372036854775808: expected at most"),
        ({"h": 0.1, "steps": 10**5000}, "steps = a value of type int: expected at most"),
        ({"h": 1e-3, "t_end": 1e200}, "too small"),
        ({"h": 1e-17, "t0": 1, "steps": 1}, "h = 1e-17 does not change the time t = 1.0"),
        ({"h": 1e308, "steps": 2}, "h = 1e\\+308 leads to the time t = inf"),
        ({"h": 1e-320, "steps": 2}, "h = 1e-320: expected at least 2.2e-308 in size"),
        ({"h": -0.5, "t0": 1e16, "steps": 1}, "h = -0.5 does not change the time t = 1e\\+16"),
        ({"h": 0.1, "steps": 10**17}, "h = 0.1 does not change the time t = 1e\\+16"),
        ({"h": 0.5, "t_end": 2.0**53}, "h = 0.5 does not change the time t = 9007199254740992.0"),
        ({"h": 10**400, "steps": 1}, "h = 1000.*: expected a finite number"),
        ({"h": 0.1, "steps": 1, "t0": 10**400}, "t0 = 1000.*: expected a finite number"),
        ({"h": 0.1, "steps": 1, "q0": [0, 10**400, 0], "v0": [0, 1, 1]}, "q0: .*largest double"),
        ({"h": 0.1, "steps": 1, "scheme": 10**400}, "scheme = 1000.*: expected a Scheme"),
        ({"h": 0.1, "steps": 1, "scheme": "leapfrgo"}, "midpoint.*did you mean 'leapfrog'"),
        ({"h": 0.1, "steps": 1, "scheme": "kl8-leapfrog"}, "choose one of: leapfrog"),
        ({"h": 0.1, "steps": 1, "scheme": "reference", "method": "rk8"},
         "method = 'rk8': did you mean 'rk8pd'"),
        ({"h": 0.1, "steps": 1, "scheme": "reference", "tolerance": 0}, "tolerance"),
    ],
)
def test_wrong_arguments_are_named(particle, arguments, text):
    with pytest.raises(ValueError, match=text):
        dal.integrate(particle, **arguments)


def test_a_system_is_needed():
    with pytest.raises(ValueError, match="system = 'particle'"):
        dal.integrate("particle", h=0.1, steps=1)
    with pytest.raises(ValueError, match="q0 is missing"):
        dal.integrate(dal.System(mass=[1]), h=0.1, steps=1)


@pytest.mark.parametrize("steps", [10**12, 10**15, 2**52])
def test_huge_runs_are_refused_with_their_size(particle, steps, monkeypatch):
    def refuse(*arguments, **options):
        raise AssertionError("allocated")

    monkeypatch.setattr(np, "empty", refuse)
    # (steps + 1) rows of q, v and t, and one reaction for each step.
    size = 8 * ((steps + 1) * 7 + steps)
    with pytest.raises(MemoryError, match=rf"steps = {steps}.*\b{size} bytes"):
        dal.integrate(particle, h=4.0, steps=steps)


# ---- initial data --------------------------------------------------------------------------


def test_consistent(particle):
    q0, v0 = [0, 1, 0], [1, 1, 3]
    with pytest.raises(dal.NotOnConstraintError, match="0.333") as caught:
        dal.integrate(particle, "midpoint", q0, v0, h=0.1, steps=1)
    assert isinstance(caught.value, ValueError) and caught.value.step == 0
    projected = dal.integrate(particle, "midpoint", q0, v0, h=0.1, steps=1, consistent="project")
    np.testing.assert_array_equal(projected.x[0], [0, 1, 0, 2, 1, 2])
    # v moves by (1, 0, -1); the mass matrix is 1.
    assert projected.stats.initial_correction == pytest.approx(np.sqrt(2), rel=1e-14)
    assert projected.stats.initial_residual == pytest.approx(1 / 3)  # |z' - y x'| / (2 max |v_i|)
    assumed = dal.integrate(particle, "midpoint", q0, v0, h=0.1, steps=1, consistent="assume")
    np.testing.assert_array_equal(assumed.x[0], [0, 1, 0, 1, 1, 3])


def test_data_in_D_to_1e_8_are_corrected(particle):
    run = dal.integrate(particle, "midpoint", [0, 1, 0], [1, 1, 1 + 1e-9], h=0.1, steps=1)
    assert run.residual[0] <= 4 * 3 * U
    assert 0 < run.stats.initial_correction < 2e-9


@pytest.mark.parametrize(("heading", "told"), [(1e12, False), (1e14, True), (1e300, True)])
def test_a_heading_that_doubles_do_not_resolve_is_told(heading, told, in_python):
    x, y, theta = dal.coordinates("x y theta")
    blade = dal.System.from_sympy(
        (x.d**2 + y.d**2 + theta.d**2) / 2, [sp.sin(theta) * x.d - sp.cos(theta) * y.d]
    )
    q0, v0 = [1e300, 1e17, heading], [np.cos(heading), np.sin(heading), 1.0]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        dal.integrate(blade, "leapfrog", q0, v0, h=0.01, steps=10)
        dal.Stepper(blade, "leapfrog", q0, v0, h=0.01).reset(q0, v0)
    texts = [str(w.message) for w in caught]
    assert len(texts) == 3 * told and all(f"q0[2] = {heading:g} is too large" in t for t in texts)


def test_integers_and_strided_initial_data(particle):
    q0, v0 = np.array([0, 9, 1, 9, 0])[::2], np.ones((3, 2))[:, 0]
    run = dal.integrate(particle, "midpoint", q0, v0, h=0.1, steps=3)
    same = dal.integrate(particle, "midpoint", (0, 1, 0), [1, 1, 1], h=0.1, steps=3)
    np.testing.assert_array_equal(run.x, same.x)
    np.testing.assert_array_equal(run.x[0], [0, 1, 0, 1, 1, 1])


def test_read_only_initial_data_stay_as_they_are(particle):
    q0, v0 = np.array([0, 1, 0]), np.array([1.0, 1.0, 3.0])
    q0.flags.writeable = v0.flags.writeable = False
    for scheme in ("midpoint", "reference"):
        dal.integrate(particle, scheme, q0, v0, h=0.1, steps=1, consistent="project")
    np.testing.assert_array_equal(v0, [1, 1, 3])


# ---- the Solution --------------------------------------------------------------------------


def test_computed_quantities(own):
    run = dal.integrate(own.system(), "midpoint", h=H, steps=STEPS)
    lam = np.array([own.acceleration(q, v)[1] for q, v in zip(run.q, run.v)])
    energy = [v @ own.mass @ v / 2 + own.potential(q) for q, v in zip(run.q, run.v)]
    np.testing.assert_allclose(run.multipliers, lam, atol=1e-12)
    np.testing.assert_allclose(run.energy, energy, rtol=1e-13)
    np.testing.assert_allclose(
        run.constraint, [own.mu(q) @ v for q, v in zip(run.q, run.v)], atol=4 * 4 * U
    )
    np.testing.assert_allclose(
        run.residual, [own.residual(q, v) for q, v in zip(run.q, run.v)], atol=4 * 4 * U
    )
    assert run.multipliers is run.multipliers


def test_arrays_are_views_of_one_buffer(particle):
    run = dal.integrate(particle, "midpoint", h=0.1, steps=10)
    assert run.x.shape == (11, 6) and run.x.flags.c_contiguous
    for view, shape in ((run.q, (11, 3)), (run.v, (11, 3)), (run.y, (6, 11))):
        assert view.shape == shape and np.shares_memory(view, run.x)
    np.testing.assert_array_equal(np.hstack([run.q, run.v]), run.x)
    np.testing.assert_array_equal(run.y.T, run.x)


@pytest.mark.parametrize("option", ["observer", "progress", "inputs"])
def test_a_domain_error_of_what_may_stop_a_run_is_its_own(option):
    system = dal.System(mass=[1], force=lambda t, q, v, u: u, inputs=1, q0=[0], v0=[1])

    def refuse(*given):
        raise dal.DomainError("outside of the table")

    with pytest.raises(dal.DomainError, match="^outside of the table$"):
        dal.integrate(system, h=1e-4, steps=100_000, **{option: refuse})


def test_solution_is_a_mapping(particle):
    run = dal.integrate(particle, "midpoint", h=0.1, steps=10)
    keys = "t q v multipliers reactions energy constraint residual h success status message y x"
    assert set(keys.split()) | {"nodes", "shift", "stride", "inputs", "hold"} == set(run)
    assert len(run) == len(dict(run)) == len(list(run))
    for key in run:
        np.testing.assert_equal(run[key], getattr(run, key))
    with pytest.raises(KeyError, match="lam"):
        run["lam"]
    with pytest.raises(KeyError, match=r"z is coordinate 2: run\.q\[:, 2\]"):
        run["z"]
    assert run.success and run.status == 0 and run.message == "10 steps to t = 1"
    assert run.stats.steps == run.stats.substeps == 10
    for scheme, stages in (("leapfrog", 1), ("leapfrog-kl8", 17), ("bm6", 10)):  # fused pairs
        assert dal.integrate(particle, scheme, h=0.1, steps=10).stats.substeps == 10 * stages
    assert run == run and run != dal.integrate(particle, "midpoint", h=0.1, steps=10)


def test_a_missing_extra_says_the_line_to_type(particle, monkeypatch):
    run = dal.integrate(particle, "midpoint", h=0.1, steps=1)
    monkeypatch.setitem(sys.modules, "xarray", None)
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    with pytest.raises(ImportError, match="pip install xarray"):
        run.to_xarray()
    with pytest.raises(ImportError, match="pip install tqdm"):
        dal.integrate(particle, "midpoint", h=0.1, steps=1, progress=True)


def test_differenced_are_in_the_statistics(own):
    bare = own.system(hessian=None, mu_v_q=None)
    run = dal.integrate(bare, "midpoint", h=H, steps=5)
    assert run.stats.differenced == ("hessian", "mu_v_q")
    full = dal.integrate(own.system(), "midpoint", h=H, steps=5)
    # Only Newton's matrix is differenced: the solution is the same to what Newton stops at.
    np.testing.assert_allclose(run.x, full.x, atol=TOLERANCE)


def test_a_differenced_gradient_needs_no_full_newton():
    spring = dal.System(mass=[1], potential=lambda q: q[0] ** 2 / 2, q0=[1], v0=[0])
    run = dal.integrate(spring, "leapfrog", h=0.1, steps=50)
    assert run.stats.full_newtons == 0 and "gradient" in run.stats.differenced
    assert run.q[-1, 0] == pytest.approx(np.cos(5), abs=0.005)


class Doubtful(SimpleNamespace):
    """What a warning looks at."""

    t0, h, control, _how = 0.0, 0.1, {}, "h = 0.1"


def test_a_step_that_is_large_for_the_potential_is_a_warning():
    # h^2 V_qq beta (1 - beta) / M = 62: Newton without the Hessian does not contract.
    stiff = dal.System(
        mass=[1, 1],
        potential=lambda q: 500 * q @ q,
        gradient=lambda q: 1000 * q,
        hessian=lambda q: 1000 * np.eye(2),
        q0=[1, 0],
        v0=[0, 1],
    )
    with pytest.warns(dal.DalembertWarning, match="long for this system .h = 0.5.") as caught:
        run = dal.integrate(stiff, "midpoint", h=0.5, steps=4)
    assert caught[0].filename == __file__
    assert run.success and run.stats.full_newtons == 4
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dal.integrate(stiff, "midpoint", h=0.005, steps=4)


@pytest.mark.parametrize(
    "numbers, warned",
    [
        ({"full_newtons": 10}, False),
        ({"full_newtons": 11}, True),
        ({"jump_step": 7, "jump": 2.0, "largest_kinetic": 1.5}, True),
    ],
)
def test_what_is_warned_of(particle, numbers, warned):
    """More than a tenth of the sub-steps by the full iteration, or an energy that has jumped."""
    stats = dal.Statistics(substeps=100, **numbers)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        integration._warn(Doubtful(system=particle, stats=stats))
    assert len(caught) == warned


def test_systems_without_a_simpler_iteration_are_not_warned_of():
    stats = dal.Statistics(substeps=100, full_newtons=100)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sleigh = dal.systems.sleigh_contact()  # M depends on q
        integration._warn(Doubtful(system=sleigh, stats=stats))


@pytest.mark.parametrize("t_end, steps", [(1 + 5e-10, 10), (0.0, 0), (1e5 * (1 + 5e-10), 10**6)])
def test_t_end_is_met_to_1e_9(particle, t_end, steps):
    assert dal.integrate(particle, h=0.1, t_end=t_end, stride=steps or 1).stats.steps == steps
    for sign in (1, -1):
        with pytest.raises(ValueError, match="steps of h = 0.1"):
            dal.integrate(particle, h=0.1, t_end=max(t_end, 0.1) * (1 + 2e-9 * sign))


@pytest.mark.parametrize(
    ("h", "t_end", "t0"),
    [(2**64, 1, 0), (1e300, 1e-300, 0), (-(2**64), -1, 0), (1e9, 1e6 + 1e-3, 1e6), (0.1, 3e-11, 0)],
)
def test_a_step_much_longer_than_the_run_is_refused(particle, h, t_end, t0):
    """It would make no step, and leave the state at t0."""
    given = {"h": h, "t_end": t_end, "t0": t0}
    with pytest.raises(ValueError, match=r"^t_end = .* steps of h = "):
        dal.integrate(particle, **given)
    with pytest.raises(ValueError, match=r"^t_end = .* steps of h = "):
        dal.ensemble(particle, progress=False, **given)
    assert dal.integrate(particle, h=0.1, t0=0.3, t_end=0.1 * 3).stats.steps == 0  # an ulp


@pytest.mark.parametrize("h_max", [1e-17, 1e-300])
def test_steps_of_roundoff_are_refused(particle, h_max):
    with pytest.raises(ValueError, match="^h_max = .* is too small for t_end - t0 = 1"):
        dal.integrate(particle, h="auto", t_end=1, h_max=h_max)


@pytest.mark.parametrize("steps", [2**64, 1.5, "a", None])
def test_numbers_of_steps_of_a_stepper_are_integers(particle, steps):
    stepper = dal.Stepper(particle, h=0.1)
    with pytest.raises(ValueError, match="^steps = "):
        stepper.step(steps=steps)
    assert stepper.steps == 0


# ---- the default scheme ----------------------------------------------------------------------


def drag(t, q, v):
    return -0.1 * v


POSITIONAL = dal.System(mass=[1.0, 1.0], force=lambda t, q, v: -q, positional=True,
                        q0=[1, 0], v0=[0, 1])  # fmt: skip
DRAGGED = dal.System(mass=[1.0, 1.0], force=drag, q0=[1, 0], v0=[0, 1])
SPARSE_DRAGGED = dal.System(
    mass=[1.0] * 3, force=drag, mu=lambda q: [1.0, 1.0], sparsity=([0, 0], [0, 1]), m=1,
    q0=[1, 0, 0], v0=[0, 0, 1],
)  # fmt: skip
SPEED = dal.System(
    mass=[1.0, 1.0], constraint=lambda q, v: [v @ v - 1], constraint_v=lambda q, v: [2 * v],
    q0=[0, 0], v0=[0.6, 0.8],
)  # fmt: skip


@pytest.mark.parametrize(
    ("system", "scheme"),
    [
        *[(getattr(dal.systems, name)(), "leapfrog") for name in
          ("particle", "knife_edge", "sleigh", "disk", "robot", "snakeboard")],
        (POSITIONAL, "leapfrog"),
        *[(getattr(dal.systems, name)(), "midpoint") for name in
          ("sleigh_contact", "genmass", "rolling_disc", "n_trailer", "ball_on_table")],
        *[(system, "midpoint") for system in (DRAGGED, SPARSE_DRAGGED, SPEED)],
    ],
    ids=lambda one: getattr(one, "name", one),
)  # fmt: skip
def test_the_default_is_the_scheme_of_order_2_that_is_solved_at_once(system, scheme, tmp_path):
    run = dal.integrate(system, h=0.01, steps=4, journal=tmp_path / "run.dal")
    assert run.scheme.name == scheme and run.scheme.order == 2 and f"by {scheme}," in repr(run)
    solved = {name: dal.integrate(system, name, h=0.01, steps=40).stats.iterations
              for name in ("leapfrog", "midpoint")}  # fmt: skip
    if scheme == "leapfrog":
        assert solved["leapfrog"] <= solved["midpoint"]
    else:
        assert solved["leapfrog"] > 1.7 * solved["midpoint"]
    assert dal.Stepper(system, h=0.01).scheme == run.scheme == dal.Scheme.usual(system)
    assert dal.ensemble(system, h=0.01, steps=4, progress=False).scheme == run.scheme
    few = dal.convergence(system, t_end=0.1, steps=[2, 4])
    assert few.scheme == run.scheme
    auto = dal.integrate(system, h="auto", t_end=0.01)
    assert auto.scheme.name == f"{scheme}-kl8"
    assert dal.load(tmp_path / "run.dal", system).scheme == run.scheme


# ---- progress ------------------------------------------------------------------------------


def test_progress_as_a_function(particle):
    told = []
    steps = 100_000
    dal.integrate(
        particle, "midpoint", h=1e-4, steps=steps, progress=lambda *numbers: told.append(numbers)
    )
    done = [d for d, _ in told]
    assert {total for _, total in told} == {steps}
    assert done == sorted(set(done)) and done[-1] == steps
    assert len(told) < 1000  # by blocks, not by steps


def test_progress_between_two_stored_states(particle):
    told = []
    steps = 5_000_000  # in one interval, some 0.2 s
    dal.integrate(
        particle, "midpoint", h=1e-6, steps=steps, stride=steps,
        progress=lambda *numbers: told.append(numbers),
    )  # fmt: skip
    done = [d for d, _ in told]
    assert len(done) > 1 and done == sorted(set(done)) and done[-1] == steps


def test_progress_of_the_reference_flow_between_two_stored_states():
    seen = []
    dal.integrate(
        dal.systems.particle_oscillator(), "reference", h=0.01, steps=10**6, stride=10**6,
        progress=lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    done = [count for count, _ in seen]
    assert done == sorted(set(done)) and seen[-1] == (10**6, 10**6)
    assert sum(0 < count < 10**6 for count in done) >= 2  # 0.3 s of work, asked every 0.05 s


def test_progress_as_a_bar(particle, capsys):
    dal.integrate(particle, "midpoint", h=0.1, steps=100, progress=True)
    assert "100%" in capsys.readouterr().err


# ---- failures ------------------------------------------------------------------------------


def singular(particle, **options):
    """Steps of y by h v_y = 2 with beta = 1: from y = -1 to 1 is S = 1 + y y' = 0 exactly."""
    return dal.integrate(
        particle, "endpoint", [0, -7, 0], [0, 1, 0], h=2.0, steps=10, t0=1.0, **options
    )


def test_a_step_that_fails_keeps_what_was_computed(particle):
    with pytest.raises(dal.SingularError) as caught:
        singular(particle)
    error = caught.value
    assert (error.step, error.t) == (3, 7.0)
    assert error.status == error.partial.status < 0
    assert not error.partial.success and "SingularError" in error.partial.message
    np.testing.assert_array_equal(error.partial.q[:, 1], [-7, -5, -3, -1])
    assert error.partial.reactions.shape == (3, 1) and error.partial.t[-1] == 7.0
    assert error.partial.energy.shape == (4,)


def test_what_is_stored_survives_ctrl_c_while_room_is_made(monkeypatch):
    """Where nobody knows how many states come, arrays grow: filled before they are used."""
    given = {"h": "auto", "t_end": 30.0, "h_max": 0.01}
    sleigh, allocate = dal.systems.sleigh(), Run._allocate
    whole = dal.integrate(sleigh, **given)

    def interrupted(run, rows, stored=()):
        allocate(run, rows, stored)
        if len(stored) and run.run.stored > 1000:
            raise KeyboardInterrupt

    monkeypatch.setattr(Run, "_allocate", interrupted)
    monkeypatch.setattr(np, "empty", lambda shape: np.full(shape, np.nan))
    with pytest.raises(KeyboardInterrupt) as caught:
        dal.integrate(sleigh, **given)
    partial = caught.value.partial
    assert 1000 < len(partial.t) < len(whole.t)
    np.testing.assert_array_equal(partial.x, whole.x[: len(partial.t)])
    np.testing.assert_array_equal(partial.t, whole.t[: len(partial.t)])


def test_a_failure_between_stored_states(particle):
    with pytest.raises(dal.SingularError) as caught:
        singular(particle, stride=2)
    assert caught.value.step == 3 and caught.value.t == 7.0
    np.testing.assert_array_equal(caught.value.partial.q[:, 1], [-7, -3])


def test_without_throwing(particle):
    run = singular(particle, throw=False)
    assert not run.success and run.status < 0 and len(run.x) == 4
    assert "FAILED" in repr(run)


def test_newton_that_does_not_converge():
    with pytest.raises(dal.ConvergenceError) as caught:
        dal.integrate(dal.systems.chaotic(), "midpoint", h=5.0, steps=100)
    assert caught.value.partial is not None


def test_too_few_iterations(own):
    with pytest.raises(dal.ConvergenceError):
        dal.integrate(own.system(), "midpoint", h=0.5, steps=10, max_iterations=1)


def test_exceptions_pickle(particle):
    with pytest.raises(dal.SingularError) as caught:
        singular(particle)
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value) and again.step == 3
    assert again.status == caught.value.status
    np.testing.assert_array_equal(again.partial.x, caught.value.partial.x)


@pytest.mark.parametrize(
    "given",
    [
        {"scheme": "leapfrog-kl8", "h": np.pi / 20, "steps": 20},
        {"scheme": "leapfrog-kl8", "h": "auto", "t_end": 2 * np.pi},
        {"scheme": "reference", "h": 2 * np.pi, "steps": 5},
    ],
)
def test_from_rest_to_rest_is_no_jump_of_the_energy(given):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = dal.integrate(
            dal.System(mass=[1], potential=lambda q: q[0] ** 2 / 2, gradient=lambda q: q),
            q0=[1], v0=[0], **given,
        )  # fmt: skip
    assert run.stats.jump_step == 0 and abs(run.v[-1, 0]) < 1e-6


# ---- far from the origin ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def ramp():
    """v_z^3 + v_z = 2 (y - c), where only z is pushed: 8 z = 3 v_z^4 + 2 v_z^2 from y = c on."""
    x, y, z = dal.coordinates("x y z")
    c = sp.Symbol("c")
    kinetic = (x.d**2 + y.d**2 + z.d**2) / 2
    return dal.System.from_sympy(kinetic, [z.d**3 + z.d - 2 * (y - c)], parameters={c: 0})


@pytest.mark.parametrize(
    ("given", "tolerance"),
    [
        ({"scheme": "leapfrog", "h": 0.01}, 1e-4),
        ({"scheme": "midpoint", "h": 0.01}, 1e-4),
        ({"scheme": "midpoint-kl6", "h": 0.02}, 1e-9),
        ({"scheme": "midpoint-kl6", "h": "auto"}, 1e-7),
        ({"scheme": "reference", "h": 0.1}, 1e-9),
    ],
)
def test_nonlinear_constraint_far_from_the_origin(ramp, given, tolerance):
    for c in (1.0, 1e3, 1e5):
        q0, far = [0, c, 0], ramp.with_parameters(c=c)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            run = dal.integrate(far, q0=q0, v0=far.project(q0, [1, 1, 0]), t_end=2, **given)
        s, w = run.q[:, 1] - c, run.v[:, 2]
        assert abs(w**3 + w - 2 * s).max() <= 12 * U * 4 * (1 + c)
        assert abs(run.q[-1, 2] - (3 * w[-1] ** 4 + 2 * w[-1] ** 2) / 8) < tolerance * (1 + c / 1e3)
        assert run.residual.max() <= run.stats.worst_residual <= 12 * U
