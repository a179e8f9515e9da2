"""General systems: any Lagrangian, forces, affine and nonlinear constraints.

What the core computes is compared with formulas in NumPy and with exact solutions.
"""

import pickle
import re

import numpy as np
import pytest

import dalembert as dal
from conftest import KINDS, General, U

BETAS = [0.0, 0.3, 0.5, 1.0]

# As in test_geometry: sums of at most 5 terms of size 1 to 10 and solves with condition below 100.
TOLERANCE = 1e-13


def near(value, expected, tolerance=TOLERANCE):
    np.testing.assert_allclose(value, expected, rtol=tolerance, atol=tolerance)


def several(general, count=5):
    rng = np.random.default_rng(3)
    return (
        general.q0 + 0.2 * rng.standard_normal((count, 3)),
        general.v0() + 0.5 * rng.standard_normal((count, 3)),
    )


# ---- what a system says about itself -------------------------------------------------------


def test_properties(general):
    system = general.system()
    assert (system.n, system.m, system.kind) == (3, 1, general.kind)
    assert system.mass is None and system.is_forced and system.differenced == ()
    shown = repr(system)
    kind = "" if general.kind == "linear" else f"{general.kind} "
    assert shown.startswith(
        f"<System general(x, y, z): 3 coordinates, 1 {kind}constraint, general Lagrangian, forced"
    )
    assert not dal.systems.particle().is_forced and dal.systems.particle().kind == "linear"


def test_differenced_are_named(general):
    missing = [name for name in general.functions if name.endswith(("q", "v", "derivative"))]
    missing = [n for n in missing if n not in ("lagrangian_q", "lagrangian_v", "constraint_v")]
    bare = general.system(**dict.fromkeys(missing))
    assert sorted(bare.differenced) == sorted(missing)
    run = dal.integrate(bare, "midpoint", h=0.05, steps=4)
    assert sorted(run.stats.differenced) == sorted(missing)
    assert run.stats.lagrangian_calls >= 8 and run.stats.force_calls >= 8
    # The schemes ask for L_q, L_v, f and phi_v only, but for Newton's speed.
    whole = dal.integrate(general.system(), "midpoint", h=0.05, steps=4)
    np.testing.assert_allclose(run.x, whole.x, rtol=0.0, atol=64 * U * np.max(np.abs(whole.x)))
    near(bare.multipliers(*several(general)), general.system().multipliers(*several(general)), 1e-9)


def test_number_of_constraints_is_asked_for():
    asked = []

    def constraint(q, v):
        asked.append((q.tolist(), v.tolist()))
        return [v[0] - v[1]]

    def make(**data):
        return dal.System(
            mass=1, n=2, constraint=constraint, constraint_v=lambda q, v: [[1, -1]], **data
        )

    assert make().m == make(q0=[3, 4], v0=[5, 5]).m == make(m=1).m == 1
    assert asked == [([0, 0], [1, 1]), ([3, 4], [5, 5])]
    nothing = dal.System(
        mass=[1.0], constraint=lambda q, v: [], constraint_v=lambda q, v: np.empty((0, 1))
    )
    assert (nothing.m, nothing.kind) == (0, "linear")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({}, "mass is missing: expected a mass or a lagrangian"),
        ({"mass": [1], "lagrangian": abs}, "mass and lagrangian are both given"),
        ({"potential": abs, "lagrangian": abs}, "potential and lagrangian are both given"),
        ({"lagrangian": abs, "lagrangian_q": abs, "n": 1}, "given without lagrangian_q.*_v"),
        ({"mass": [1], "lagrangian_vv": abs}, r"lagrangian_vv is given without lagrangian\(q, v\)"),
        ({"mass": [1], "force_q": abs}, r"force_q is given without force\(t, q, v\)"),
        ({"mass": [1], "force": 3}, "force = 3: expected a function"),
        ({"mass": [1, 1], "affine": abs}, r"affine is given without mu\(q\)"),
        ({"mass": [1, 1], "mu": abs, "affine_derivative": abs}, r"without affine\(q\)"),
        ({"mass": [1, 1], "constraint": abs}, r"constraint is given without constraint_v\(q, v\)"),
        ({"mass": [1, 1], "constraint_q": abs}, r"constraint_q is given without constraint\(q"),
        (
            {"mass": [1, 1], "mu": abs, "constraint": abs, "constraint_v": abs},
            "mu and constraint are both given",
        ),
        (
            {"mass": [1, 1], "mu": abs, "affine": abs, "affine_derivative": abs},
            "affine_derivative is given alone: expected both",
        ),
        (
            {"mass": [1, 1], "constraint": lambda q, v: v[0], "constraint_v": abs},
            r"constraint returned \(\): expected shape \(m,\)",
        ),
        (
            {"lagrangian": abs, "lagrangian_q": abs, "lagrangian_v": abs},
            "n is missing: neither coordinates nor q0 determine it",
        ),
    ],
)
def test_wrong_definitions(arguments, text):
    with pytest.raises(ValueError, match=text):
        dal.System(**arguments)


def test_pickle(general):
    system = general.system()
    again = pickle.loads(pickle.dumps(system))
    q, v = several(general)
    assert repr(again) == repr(system)
    np.testing.assert_array_equal(again.acceleration(q, v, 0.3), system.acceleration(q, v, 0.3))
    with pytest.raises(pickle.PicklingError, match="its force = .*lambda"):
        pickle.dumps(general.system(force=lambda t, q, v: 0 * v, force_q=None, force_v=None))


# ---- mechanics -----------------------------------------------------------------------------


def test_mechanics_off_D(general):
    system, t = general.system(), 0.6
    q, v = several(general)
    pairs = list(zip(q, v))
    near(system.energy(q, v), [general.energy(a, b) for a, b in pairs])
    near(system.metric(q, v), [general.lagrangian_vv(a, b) for a, b in pairs])
    near(system.residual(q, v), [general.phi(a, b) for a, b in pairs])
    near(system.residual(q, v, 0.1), [general.phi(a - 0.1 * b, b) for a, b in pairs])
    near(system.relative_residual(q, v), [general.residual(a, b) for a, b in pairs])
    a, lam = (np.array(x) for x in zip(*(general.acceleration(t, b, c) for b, c in pairs)))
    near(system.acceleration(q, v, t), a)
    near(system.multipliers(q, v, t), lam)
    near(system.field(q, v, t), np.hstack([v, a]))
    mu = np.array([general.phi_v(b, c)[0] for b, c in pairs])
    M = system.metric(q, v)
    near(system.gram(q, v)[:, 0, 0], [a @ np.linalg.solve(b, a) for a, b in zip(mu, M)])
    of_constraint, of_force = system.power(q, v, t)
    near(of_constraint, lam[:, 0] * np.einsum("ki,ki->k", mu, v))
    near(of_force, [general.force(t, b, c) @ c for b, c in pairs])
    assert system.power(q[0], v[0], t) == (of_constraint[0], of_force[0])
    assert system.metric(q[0], v[0]).shape == (3, 3)


def test_projection(general):
    """Onto D, and onto D_eps, along M^-1 mu^T; for constraints linear in v the nearest velocity."""
    system = general.system()
    q, v = several(general)
    for shift in (0.0, 0.05):
        w = system.project(q, v, shift)
        for a, b, c in zip(q, v, w):
            assert general.residual(a - shift * c, c) <= 16 * 3 * U
            direction = general.lagrangian_vv(a, b) @ (c - b)
            near(np.cross(direction, general.phi_v(a, b)[0]), 0.0)
    w = system.consistent(q, v, keep="x")
    np.testing.assert_array_equal(w[:, 0], v[:, 0])
    assert system.relative_residual(q, w).max() <= 16 * 3 * U


# ---- the schemes ---------------------------------------------------------------------------


@pytest.mark.parametrize("beta", BETAS)
@pytest.mark.parametrize("h", [0.05, -0.05])
def test_one_step(general, beta, h):
    system, t = general.system(), 0.3
    run = dal.integrate(system, beta, h=h, steps=2, t0=t)
    for k in range(2):
        q, v, lam = general.beta_step(beta, t + k * h, h, run.q[k], run.v[k])
        near(run.q[k + 1], q)
        near(run.v[k + 1], v)
        near(run.reactions[k], lam, TOLERANCE / abs(h))
        assert general.residual(run.q[k + 1], run.v[k + 1]) <= 4 * 3 * U


# ---- functions of the user -----------------------------------------------------------------


def everything(system):
    """Make the core ask for every output of every function."""
    system.check()
    run = dal.integrate(system, "midpoint", h=0.05, steps=2)
    return run.energy, run.multipliers


SHAPES = {
    "lagrangian": (), "lagrangian_q": (3,), "lagrangian_v": (3,), "lagrangian_qq": (3, 3),
    "lagrangian_vq": (3, 3), "lagrangian_vv": (3, 3), "force": (3,), "force_q": (3, 3),
    "force_v": (3, 3), "mu": (1, 3), "mu_v_q": (1, 3), "affine": (1,),
    "affine_derivative": (1, 3), "constraint": (1,), "constraint_v": (1, 3),
    "constraint_q": (1, 3),
}  # fmt: skip
FUNCTIONS = [
    *(("affine", name) for name in General("affine").functions),
    *((kind, name) for kind in ("linear", "nonlinear") for name in General.constraints[kind]),
]


@pytest.mark.parametrize(("kind", "name"), FUNCTIONS)
def test_wrong_shapes_name_the_function(kind, name):
    general, shape = General(kind), SHAPES[name]
    wrong = np.ones((*shape, 2))
    system = general.system(**{name: lambda *arguments: wrong, "m": 1})
    text = f"{name} returned shape {wrong.shape}: expected {shape}"
    with pytest.raises(ValueError, match="^" + re.escape(text)):
        everything(system)


class Mine(Exception):
    """An exception that the package does not know."""


@pytest.mark.parametrize(("kind", "name"), FUNCTIONS)
def test_exceptions_come_back_as_themselves(kind, name):
    error = Mine("here")

    def raising(*arguments):
        raise error

    with pytest.raises(Mine) as caught:
        everything(General(kind).system(**{name: raising, "m": 1}))
    assert caught.value is error


# What is not finite is named as the user named it; where two functions are added, by both.
NAMED = {
    ("affine", "affine"): "(mu v + affine)",
    ("affine", "mu_v_q"): "(mu_v_q + affine_derivative)",
    ("affine", "affine_derivative"): "(mu_v_q + affine_derivative)",
}


@pytest.mark.parametrize(("kind", "name"), FUNCTIONS)
def test_what_is_not_finite_is_named(kind, name):
    general, shape = General(kind), SHAPES[name]
    entry = tuple(length - 1 for length in shape)

    def broken(*arguments):
        value = np.array(getattr(general, name)(*arguments), dtype=float)
        value[entry] = np.nan
        return value

    system = general.system(**{name: broken, "m": 1})
    index = f"[{','.join(map(str, entry))}]" if shape else ""
    text = f"{NAMED.get((kind, name), name)}{index} = nan"
    found = system.check()
    assert not found and found.text.startswith(text), found.text
    if name != "lagrangian":  # which only the energy needs
        with pytest.raises(dal.DomainError, match="^" + re.escape(text)):
            dal.integrate(system, "midpoint", h=0.05, steps=1)


@pytest.mark.parametrize("kind", KINDS)
def test_arrays_are_read_only_and_may_be_kept(kind):
    general, kept = General(kind), []

    def watched(name):
        def function(*arguments):
            for array in arguments:
                if isinstance(array, np.ndarray):
                    assert not array.flags.writeable
                    kept.append((array, array.copy()))
            return getattr(general, name)(*arguments).tolist()

        return function

    names = [name for name in general.functions if name != "lagrangian"]
    run = dal.integrate(
        general.system(**{name: watched(name) for name in names}), "midpoint", h=0.05, steps=3
    )
    assert len(kept) > 50
    for array, then in kept:
        np.testing.assert_array_equal(array, then)
    whole = dal.integrate(general.system(), "midpoint", h=0.05, steps=3)
    np.testing.assert_array_equal(run.x, whole.x)


# ---- check ---------------------------------------------------------------------------------


def test_check_passes(general):
    report = general.system().check()
    assert report and report.general and report.forced and report.kind == general.kind
    near(report.mass_min, np.linalg.eigvalsh(general.lagrangian_vv(general.q0, general.v0()))[0])
    assert np.isnan(report.curvature) == (general.kind != "linear")
    shown = str(report)
    for name in (*general.lagrangians[1:], *general.forces[1:]):
        assert name in shown
    assert "gradient" not in shown
    assert ("constraint_v" in shown) == (general.kind == "nonlinear")


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (kind, name)
        for kind, name in FUNCTIONS
        if name not in ("lagrangian", "force", "affine", "constraint", "mu")
    ],
)
def test_check_finds_what_is_wrong(kind, name):
    """An entry that is off by 1e-3, of every derivative; forms are what phi is made of."""
    general, shape = General(kind), SHAPES[name]
    entry = tuple(length - 1 for length in shape)

    def wrong(*arguments):
        value = getattr(general, name)(*arguments)
        value[entry] += 1e-3
        return value

    report = general.system(**{name: wrong}).check()
    index = ",".join(map(str, entry))
    assert not report
    assert report.text.startswith(f"{NAMED.get((kind, name), name)}[{index}] is given as")


def test_check_of_a_constraint_without_rank():
    circle = dal.System(
        mass=[1, 1, 1],
        constraint=lambda q, v: [v @ v - 1],
        constraint_v=lambda q, v: [2 * v],
        constraint_q=lambda q, v: np.zeros((1, 3)),
    )
    assert circle.check([0, 0, 0], [0.6, 0, 0.8])
    report = circle.check([0, 0, 0], [0, 0, 0])
    assert not report and report.rank == 0
    assert "rank 0 instead of 1" in report.text and "quadratic in v" in report.text


# ---- the initial time, and exact solutions -------------------------------------------------

AMPLITUDE, FREQUENCY = np.array([1.5, -0.7]), 1.3


def driven_exact(t, q0, v0, t0=0.0):
    """The solution of qddot + q = A cos(w t) has a part of frequency w, and one of frequency 1."""
    w, a = FREQUENCY, AMPLITUDE / (1 - FREQUENCY**2)
    c, s = q0 - a * np.cos(w * t0), v0 + a * w * np.sin(w * t0)
    q = a * np.cos(w * (t0 + t)) + c * np.cos(t) + s * np.sin(t)
    return q, s * np.cos(t) - c * np.sin(t) - a * w * np.sin(w * (t0 + t))


def driven(exact=driven_exact):
    return dal.System(
        mass=[1.0, 1.0], potential=lambda q: q @ q / 2, gradient=lambda q: q,
        force=lambda t, q, v: AMPLITUDE * np.cos(FREQUENCY * t),
        q0=[1.0, 0.2], v0=[0.5, -0.4], exact=exact,
    )  # fmt: skip


def test_initial_time_reaches_the_core():
    """At another initial time the force is another; the exact solution is that of time 0."""
    system, steps = driven(), (40, 60, 80, 120)
    assert dal.convergence(system, "midpoint", t_end=1, steps=steps).reference == 0.0
    later = dal.convergence(system, "midpoint", t0=0.7, t_end=1.7, steps=steps)
    assert later.reference > 0.0 and later.holds and abs(later.p - 2) < 0.1
    exact = np.concatenate(driven_exact(1.0, system.q0, system.v0, t0=0.7))
    run = dal.integrate(system, "leapfrog-kl8", t0=0.7, h=0.05, t_end=1.7)
    near(run.x[-1], exact, 1e-12)
    end = dal.reference(system, t=1.7, t0=0.7)
    near(np.concatenate([end.q, end.v]), exact, 1e-12)
    near(system.acceleration(system.q0, system.v0, 0.7), AMPLITUDE * np.cos(0.91) - system.q0)


def test_exact_may_raise():
    def exact(t, q0, v0):
        assert not q0.flags.writeable
        raise Mine("here")

    system = driven(exact)
    with pytest.raises(Mine):
        system.exact(1.0)
    with pytest.raises(Mine):
        dal.convergence(system, "midpoint")
    with pytest.raises(ValueError, match=r"exact \(v\) returned shape .*: expected \(1,\)"):
        dal.System(mass=[1], exact=lambda t, q, v: (q, 0.0)).exact(1.0, [1], [1])
