"""General systems: any Lagrangian, forces, affine and nonlinear constraints.

What the core computes is compared with formulas in NumPy, with exact solutions, and with the same
system in other coordinates.
"""

import pickle
import re
from concurrent.futures import ThreadPoolExecutor

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
        ({"mass": [1, 1], "affine": abs}, r"affine is given without forms\(q\)"),
        ({"mass": [1, 1], "forms": abs, "affine_derivative": abs}, r"without affine\(q\)"),
        ({"mass": [1, 1], "constraint": abs}, r"constraint is given without constraint_v\(q, v\)"),
        ({"mass": [1, 1], "constraint_q": abs}, r"constraint_q is given without constraint\(q"),
        (
            {"mass": [1, 1], "forms": abs, "constraint": abs, "constraint_v": abs},
            "forms and constraint are both given",
        ),
        (
            {"mass": [1, 1], "forms": abs, "affine": abs, "affine_derivative": abs},
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


def test_power_is_what_the_energy_gains(general):
    """Along the flow, by Gauss's quadrature with 12 nodes over a unit of time."""
    system, t0 = general.system(), 0.2
    nodes, weights = np.polynomial.legendre.leggauss(12)
    times = t0 + (nodes + 1) / 2
    powers = []
    for t in times:
        state = dal.reference(system, t=t, t0=t0)
        powers.append(system.power(state.q, state.v, t))
    gained = np.array(powers).T @ weights / 2
    end = dal.reference(system, t=t0 + 1, t0=t0)
    change = system.energy(end.q, end.v) - system.energy(system.q0, system.v0)
    assert abs(change) > 0.1
    near(gained.sum(), change, 1e-11)
    assert (abs(gained[0]) > 0.01) == (general.kind != "linear")


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


@pytest.mark.parametrize("beta", BETAS[:3])
def test_kept_nodes_keep_the_deformation(general, beta):
    scheme = dal.Scheme([(beta, 1.0)], nodes="kept")
    run = dal.integrate(general.system(), scheme, h=0.02, steps=30, initial="project")
    for q, v in zip(run.q, run.v):
        assert general.residual(q - (1 - beta) * 0.02 * v, v) <= 4 * 3 * U
    assert run.residual.max() <= 4 * 3 * U


@pytest.mark.parametrize("scheme", ["midpoint", "leapfrog", "leapfrog-mirror"])
def test_symmetry_on_D(general, scheme):
    """Back with -h, from the time that was reached; 64 u for each of the 40 steps."""
    system = general.system()
    there = dal.integrate(system, scheme, h=0.05, steps=20, t0=0.3)
    back = dal.integrate(
        system, scheme, there.q[-1], there.v[-1], h=-0.05, steps=20, t0=there.t[-1]
    )
    assert np.max(np.abs(there.x[-1] - there.x[0])) > 0.5
    np.testing.assert_allclose(back.x[-1], there.x[0], rtol=0.0, atol=40 * 64 * U)


def test_threads(general):
    system = general.system()
    expected = dal.integrate(system, "midpoint", h=0.02, steps=20)
    with ThreadPoolExecutor(4) as pool:
        for run in pool.map(
            lambda _: dal.integrate(system, "midpoint", h=0.02, steps=20), range(8)
        ):
            np.testing.assert_array_equal(run.x, expected.x)
            assert run.stats == expected.stats
    assert run.stats.lagrangian_calls > 20 and run.stats.force_calls > 20


# ---- functions of the user -----------------------------------------------------------------


def everything(system):
    """Make the core ask for every output of every function."""
    system.check()
    run = dal.integrate(system, "midpoint", h=0.05, steps=2)
    return run.energy, run.multipliers


SHAPES = {
    "lagrangian": (), "lagrangian_q": (3,), "lagrangian_v": (3,), "lagrangian_qq": (3, 3),
    "lagrangian_vq": (3, 3), "lagrangian_vv": (3, 3), "force": (3,), "force_q": (3, 3),
    "force_v": (3, 3), "forms": (1, 3), "forms_velocity_derivative": (1, 3), "affine": (1,),
    "affine_derivative": (1, 3), "constraint": (1,), "constraint_v": (1, 3),
    "constraint_q": (1, 3),
}  # fmt: skip
FUNCTIONS = [(kind, name) for kind in KINDS for name in General(kind).functions]


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
    ("affine", "affine"): "(forms v + affine)",
    ("affine", "forms_velocity_derivative"): "(forms_velocity_derivative + affine_derivative)",
    ("affine", "affine_derivative"): "(forms_velocity_derivative + affine_derivative)",
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


def test_a_domain_that_ends(general):
    """A run stops where a force is no longer defined."""
    outside = dal.DomainError("too fast")

    def force(t, q, v):
        if t > 0.5:
            raise outside
        return general.force(t, q, v)

    with pytest.raises(dal.DomainError) as caught:
        dal.integrate(general.system(force=force), "midpoint", h=0.0625, steps=20)
    assert caught.value is outside and caught.value.partial.t[-1] == 0.5


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
        if name not in ("lagrangian", "force", "affine", "constraint", "forms")
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


# ---- exact solutions: oscillators ----------------------------------------------------------

K, DAMPING = 4.0, 0.6


def damped_exact(t, q0, v0):
    w, decay = np.sqrt(K - DAMPING**2 / 4), np.exp(-DAMPING * t / 2)
    b = (v0 + DAMPING / 2 * q0) / w
    q = decay * (q0 * np.cos(w * t) + b * np.sin(w * t))
    return q, decay * w * (b * np.cos(w * t) - q0 * np.sin(w * t)) - DAMPING / 2 * q


AMPLITUDE, FREQUENCY = np.array([1.5, -0.7]), 1.3


def driven_exact(t, q0, v0, t0=0.0):
    """The solution of qddot + q = A cos(w t) has a part of frequency w, and one of frequency 1."""
    w, a = FREQUENCY, AMPLITUDE / (1 - FREQUENCY**2)
    c, s = q0 - a * np.cos(w * t0), v0 + a * w * np.sin(w * t0)
    q = a * np.cos(w * (t0 + t)) + c * np.cos(t) + s * np.sin(t)
    return q, s * np.cos(t) - c * np.sin(t) - a * w * np.sin(w * (t0 + t))


OSCILLATORS = {
    "damped": {
        "mass": [1.0],
        "potential": lambda q: K * q[0] ** 2 / 2,
        "gradient": lambda q: K * q,
        "hessian": lambda q: [[K]],
        "force": lambda t, q, v: -DAMPING * v,
        "force_q": lambda t, q, v: [[0.0]],
        "force_v": lambda t, q, v: [[-DAMPING]],
        "q0": [1.0],
        "v0": [0.5],
        "exact": damped_exact,
    },
    "driven": {
        "mass": [1.0, 1.0],
        "potential": lambda q: q @ q / 2,
        "gradient": lambda q: q,
        "hessian": lambda q: np.eye(2),
        "force": lambda t, q, v: AMPLITUDE * np.cos(FREQUENCY * t),
        "q0": [1.0, 0.2],
        "v0": [0.5, -0.4],
        "exact": driven_exact,
    },
}
SCHEMES = [
    *BETAS, "leapfrog", "leapfrog-mirror", "leapfrog-suzuki4", "midpoint-suzuki4", "leapfrog-kl6",
]  # fmt: skip


# Steps over a unit of time whose errors are far from the floor, by order.
STEPS = {1: (40, 60, 80, 120), 2: (40, 60, 80, 120), 4: (6, 9, 12, 16), 6: (3, 4, 6, 8)}


def keeps_order(system, scheme, *data, t0=0.0):
    """Return the study of a scheme, whose order at t_end and after one step is what it promises."""
    order = dal.Scheme.of(scheme).order
    study = dal.convergence(system, scheme, *data, t0=t0, t_end=t0 + 1, steps=STEPS[order])
    np.testing.assert_allclose(study.fits["global_state"].slope, order, atol=0.1)
    # The next term of the error bends the line of one step more where h is 1/3.
    np.testing.assert_allclose(study.p, order, atol=0.4 if order > 2 else 0.1)
    assert study.holds or order > 2
    assert study.keeps_D
    return study


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", OSCILLATORS)
def test_oscillators_keep_the_order(name, scheme):
    study = keeps_order(dal.System(**OSCILLATORS[name]), scheme)
    assert study.reference == 0.0  # it is the exact solution


@pytest.mark.parametrize("scheme", SCHEMES)
def test_initial_time_reaches_the_core(scheme):
    """At another initial time the force is another; the exact solution is that of time 0."""
    driven = dal.System(**OSCILLATORS["driven"])
    assert keeps_order(driven, scheme, t0=0.7).reference > 0.0
    exact = np.concatenate(driven_exact(1.0, driven.q0, driven.v0, t0=0.7))
    run = dal.integrate(driven, "leapfrog-kl8", t0=0.7, h=0.05, t_end=1.7)
    near(run.x[-1], exact, 1e-12)
    end = dal.reference(driven, t=1.7, t0=0.7)
    near(np.concatenate([end.q, end.v]), exact, 1e-12)
    near(driven.acceleration(driven.q0, driven.v0, 0.7), AMPLITUDE * np.cos(0.91) - driven.q0)


def test_exact_may_raise():
    def exact(t, q0, v0):
        assert not q0.flags.writeable
        raise Mine("here")

    system = dal.System(**{**OSCILLATORS["damped"], "exact": exact})
    with pytest.raises(Mine):
        system.exact(1.0)
    with pytest.raises(Mine):
        dal.convergence(system, "midpoint")
    with pytest.raises(ValueError, match=r"exact \(v\) returned shape .*: expected \(1,\)"):
        dal.System(mass=[1], exact=lambda t, q, v: (q, 0.0)).exact(1.0, [1], [1])


# ---- a knife edge with friction ------------------------------------------------------------


def knife(friction):
    mass = np.array([2.0, 2.0, 0.75])
    return dal.System(
        mass=mass,
        potential=lambda q: -5 * q[0],
        gradient=lambda q: [-5.0, 0.0, 0.0],
        hessian=lambda q: np.zeros((3, 3)),
        forms=lambda q: [[np.sin(q[2]), -np.cos(q[2]), 0.0]],
        forms_velocity_derivative=lambda q, v: [
            [0.0, 0.0, np.cos(q[2]) * v[0] + np.sin(q[2]) * v[1]]
        ],
        force=lambda t, q, v: -friction * mass * v,
        force_q=lambda t, q, v: np.zeros((3, 3)),
        force_v=lambda t, q, v: -friction * np.diag(mass),
        q0=[0.0, 0.0, 0.2],
        v0=[np.cos(0.2) / 2, np.sin(0.2) / 2, 1.2],
    )


@pytest.mark.parametrize("scheme", SCHEMES)
def test_knife_edge_with_friction(scheme):
    keeps_order(knife(0.4), scheme)


def test_knife_edge_with_friction_on_the_flow():
    """u' + c u = g sin theta... along the edge, and omega = omega_0 exp(-c t): by the flow."""
    c = 0.4
    system = knife(c)
    end = dal.reference(system, t=1.0)
    near(end.v[2], 1.2 * np.exp(-c), 1e-12)
    near(end.q[2], 0.2 + 1.2 * (1 - np.exp(-c)) / c, 1e-12)
    # u is the integral of exp(-c (1 - s)) 5/2 cos theta(s), with theta(s) as above.
    nodes, weights = np.polynomial.legendre.leggauss(20)
    s = (nodes + 1) / 2
    theta = 0.2 + 1.2 * (1 - np.exp(-c * s)) / c
    u = 0.5 * np.exp(-c) + weights @ (np.exp(-c * (1 - s)) * 2.5 * np.cos(theta)) / 2
    near(end.v[:2], [u * np.cos(end.q[2]), u * np.sin(end.q[2])], 1e-12)
    # Without friction the built-in system with the same numbers.
    same = dal.systems.knife_edge()
    q, v = several_on_D(same)
    near(knife(0.0).acceleration(q, v), same.acceleration(q, v))


def several_on_D(system, count=5):
    rng = np.random.default_rng(4)
    q = system.q0 + 0.3 * rng.standard_normal((count, system.n))
    return q, system.project(q, system.v0 + 0.5 * rng.standard_normal((count, system.n)))


# ---- a nonlinear constraint: constant speed ------------------------------------------------

SPEED, GRAVITY = 2.0, 1.5


def speed_exact(t, q0, v0):
    """v = c (cos a, sin a) with a' = -(g/c) cos a, so sin a = -tanh s with s = g t/c + s0."""
    unit = SPEED**2 / GRAVITY
    s0 = -np.arctanh(v0[1] / SPEED)
    s = GRAVITY / SPEED * t + s0

    def gudermannian(s):
        return 2 * np.arctan(np.tanh(s / 2))

    x = q0[0] + unit * (gudermannian(s) - gudermannian(s0))
    y = q0[1] - unit * np.log(np.cosh(s) / np.cosh(s0))
    return [x, y], [SPEED / np.cosh(s), -SPEED * np.tanh(s)]


def constant_speed():
    return dal.System(
        mass=[2, 2],
        potential=lambda q: 2 * GRAVITY * q[1],
        gradient=lambda q: [0.0, 2 * GRAVITY],
        hessian=lambda q: np.zeros((2, 2)),
        constraint=lambda q, v: [np.hypot(*v) - SPEED],
        constraint_v=lambda q, v: [v / np.hypot(*v)],
        constraint_q=lambda q, v: np.zeros((1, 2)),
        q0=[0.0, 0.0],
        v0=[0.6 * SPEED, 0.8 * SPEED],
        exact=speed_exact,
    )


@pytest.mark.parametrize("scheme", SCHEMES)
def test_constant_speed(scheme):
    """Orders, and D kept to 4 n u: the terms of phi are at most 2 |v|, so |v| is kept to 8 n u."""
    system = constant_speed()
    assert keeps_order(system, scheme).reference == 0.0
    run = dal.integrate(system, scheme, h=0.02, steps=200)
    assert np.abs(np.hypot(*run.v.T) / SPEED - 1).max() <= 2 * 4 * 2 * U
    assert run.residual.max() <= 4 * 2 * U


def test_constant_speed_by_the_flow():
    end = dal.reference(constant_speed(), t=2.0)
    exact = speed_exact(2.0, [0.0, 0.0], [0.6 * SPEED, 0.8 * SPEED])
    near(np.concatenate([end.q, end.v]), np.concatenate(exact), 1e-12)


# ---- an affine constraint: a ball on a table that turns ------------------------------------

INERTIA, TURN = 0.4, 0.7  # of a homogeneous ball of mass 1 and radius 1; of the table


class Ball:
    """A ball that rolls on a table: q = (x, y) and Euler's angles (theta, phi, psi).

    omega_x = theta' cos phi + psi' sin theta sin phi, omega_y = theta' sin phi - psi' sin theta
    cos phi; x' - omega_y = -TURN y, y' + omega_x = TURN x.
    """

    def lagrangian(self, q, v):
        spin = v[2] ** 2 + v[3] ** 2 + v[4] ** 2 + 2 * v[3] * v[4] * np.cos(q[2])
        return (v[0] ** 2 + v[1] ** 2 + INERTIA * spin) / 2

    def lagrangian_q(self, q, v):
        return [0.0, 0.0, -INERTIA * v[3] * v[4] * np.sin(q[2]), 0.0, 0.0]

    def lagrangian_v(self, q, v):
        return self.lagrangian_vv(q, v) @ v

    def lagrangian_vv(self, q, v):
        M = np.diag([1.0, 1.0, INERTIA, INERTIA, INERTIA])
        M[3, 4] = M[4, 3] = INERTIA * np.cos(q[2])
        return M

    def lagrangian_vq(self, q, v):
        A = np.zeros((5, 5))
        A[3:, 2] = -INERTIA * np.sin(q[2]) * v[[4, 3]]
        return A

    def lagrangian_qq(self, q, v):
        A = np.zeros((5, 5))
        A[2, 2] = -INERTIA * v[3] * v[4] * np.cos(q[2])
        return A

    def forms(self, q):
        s, (sp, cp) = np.sin(q[2]), (np.sin(q[3]), np.cos(q[3]))
        return np.array([[1.0, 0.0, -sp, 0.0, s * cp], [0.0, 1.0, cp, 0.0, s * sp]])

    def forms_velocity_derivative(self, q, v):
        s, c, sp, cp = np.sin(q[2]), np.cos(q[2]), np.sin(q[3]), np.cos(q[3])
        return np.array(
            [
                [0.0, 0.0, v[4] * c * cp, -cp * v[2] - v[4] * s * sp, 0.0],
                [0.0, 0.0, v[4] * c * sp, -sp * v[2] + v[4] * s * cp, 0.0],
            ]
        )

    def affine(self, q):
        return [TURN * q[1], -TURN * q[0]]

    def affine_derivative(self, q):
        return [[0.0, TURN, 0.0, 0.0, 0.0], [-TURN, 0.0, 0.0, 0.0, 0.0]]

    def system(self):
        names = [name for name in dir(self) if name.startswith(("lagrangian", "forms", "affine"))]
        system = dal.System(
            **{name: getattr(self, name) for name in names},
            coordinates=["x", "y", "theta", "phi", "psi"],
        )
        q = np.array([0.3, -0.2, 1.1, 0.4, -0.5])
        return system, q, system.consistent(q, [0.5, 0.2, 0.3, -0.4, 0.0], keep=["x", "y"])


def circle(t, q, v):
    """The centre of the ball turns with J/(J + m a^2) TURN = 2 TURN/7."""
    k = INERTIA / (1 + INERTIA) * TURN
    s, c = np.sin(k * t), np.cos(k * t)
    velocity = np.array([[c, -s], [s, c]]) @ v[:2]
    return q[:2] + np.array([[s, c - 1], [1 - c, s]]) @ v[:2] / k, velocity


def test_ball_on_a_turning_table():
    system, q, v = Ball().system()
    assert system.kind == "affine" and system.check(q, v)
    end = dal.reference(system, q, v, t=2.0)
    near(end.q[:2], circle(2.0, q, v)[0], 1e-12)
    near(end.v[:2], circle(2.0, q, v)[1], 1e-12)
    # The energy changes; the moving energy E - TURN (x y' - y x') does not.
    values = [
        (system.energy(a, b), TURN * (a[0] * b[1] - a[1] * b[0])) for a, b in ((q, v), end[:2])
    ]
    assert abs(values[1][0] - values[0][0]) > 0.1
    near(values[1][0] - values[1][1], values[0][0] - values[0][1], 1e-12)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_ball_keeps_the_order(scheme):
    """The order of the state against the flow, and against the circle at the two coarsest steps."""
    system, q, v = Ball().system()
    keeps_order(system, scheme, q, v)
    order = dal.Scheme.of(scheme).order
    coarse, fine = STEPS[order][0], STEPS[order][2]
    errors, exact = [], np.concatenate(circle(1.0, q, v))
    for count in (coarse, fine):
        run = dal.integrate(system, scheme, q, v, h=1 / count, steps=count)
        errors.append(np.max(np.abs(np.concatenate([run.q[-1, :2], run.v[-1, :2]]) - exact)))
        assert run.residual.max() <= 4 * 5 * U
    assert abs(np.log(errors[0] / errors[1]) / np.log(fine / coarse) - order) < 0.3


# ---- a Lagrangian of its own: the sleigh in the coordinates of its contact -----------------

M, J, A = 1.5, 0.8, 0.4


def to_contact(q, v):
    """From the centre of mass of the built-in sleigh to its contact point."""
    s, c = np.sin(q[2]), np.cos(q[2])
    return q - A * np.array([c, s, 0.0]), v - A * v[2] * np.array([-s, c, 0.0])


def to_centre(q, v):
    s, c = np.sin(q[2]), np.cos(q[2])
    return q + A * np.array([c, s, 0.0]), v + A * v[2] * np.array([-s, c, 0.0])


def sleigh_contact():
    def lagrangian(q, v):
        turn = v[1] * np.cos(q[2]) - v[0] * np.sin(q[2])
        return (
            M * (v[0] ** 2 + v[1] ** 2) / 2 + (J + M * A**2) * v[2] ** 2 / 2 + M * A * v[2] * turn
        )

    def metric(q, v):
        s, c = M * A * np.sin(q[2]), M * A * np.cos(q[2])
        return np.array([[M, 0.0, -s], [0.0, M, c], [-s, c, J + M * A**2]])

    def lagrangian_q(q, v):
        return [0.0, 0.0, -M * A * v[2] * (v[0] * np.cos(q[2]) + v[1] * np.sin(q[2]))]

    def lagrangian_vq(q, v):
        s, c = M * A * np.sin(q[2]), M * A * np.cos(q[2])
        last = -v[0] * c - v[1] * s
        return [[0.0, 0.0, -c * v[2]], [0.0, 0.0, -s * v[2]], [0.0, 0.0, last]]

    def lagrangian_qq(q, v):
        last = M * A * v[2] * (v[0] * np.sin(q[2]) - v[1] * np.cos(q[2]))
        return np.diag([0.0, 0.0, last])

    sleigh = dal.systems.sleigh()

    def exact(t, q0, v0):
        return to_contact(*sleigh.exact(t, *to_centre(q0, v0)))

    q0, v0 = to_contact(sleigh.q0, sleigh.v0)
    return dal.System(
        lagrangian=lagrangian,
        lagrangian_q=lagrangian_q,
        lagrangian_v=lambda q, v: metric(q, v) @ v,
        lagrangian_qq=lagrangian_qq,
        lagrangian_vq=lagrangian_vq,
        lagrangian_vv=metric,
        forms=lambda q: [[-np.sin(q[2]), np.cos(q[2]), 0.0]],
        forms_velocity_derivative=lambda q, v: [
            [0.0, 0.0, -np.cos(q[2]) * v[0] - np.sin(q[2]) * v[1]]
        ],
        q0=q0,
        v0=v0,
        exact=exact,
    )


def test_sleigh_in_two_coordinates():
    contact, centre = sleigh_contact(), dal.systems.sleigh()
    assert contact.check()
    q, v = several_on_D(centre)
    for a, b in zip(q, v):
        c, d = to_contact(a, b)
        assert contact.relative_residual(c, d) <= 64 * U
        near(contact.energy(c, d), centre.energy(a, b))
        near(contact.multipliers(c, d), centre.multipliers(a, b))  # the same force
    end = dal.reference(contact, t=1.0)
    near(np.concatenate([end.q, end.v]), np.concatenate(contact.exact(1.0)), 1e-12)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_sleigh_keeps_the_order(scheme):
    assert keeps_order(sleigh_contact(), scheme).reference == 0.0
