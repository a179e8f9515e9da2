"""As many constraints as coordinates: the motion is prescribed, the forces are what is sought."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import dalembert as dal

X, Y = dal.coordinates("x y")
PUSH = sp.Symbol("push")
Q0 = np.array([0.3, 0.4])


class Led:
    """Two constraints mu(t, q) v + a(t, q) = 0 on two coordinates, in plain NumPy.

    T = ((1 + y^2) x'^2 + y'^2) / 2, V = -x y, the force (push - x', 0).
    """

    system = dal.System.from_sympy(
        ((1 + Y**2) * X.d**2 + Y.d**2) / 2 + X * Y,
        [
            (2 + sp.sin(Y)) * X.d + Y.d - 1 - dal.time,
            X.d - sp.cos(X) * Y.d - sp.sin(dal.time) * X,
        ],
        force={X: PUSH - X.d},
        inputs=[PUSH],
        name="led",
    )

    @staticmethod
    def mu(t, q):
        return np.array([[2 + np.sin(q[1]), 1], [1, -np.cos(q[0])]])

    @classmethod
    def velocity(cls, t, q):
        return np.linalg.solve(cls.mu(t, q), [1 + t, np.sin(t) * q[0]])

    @classmethod
    def multipliers(cls, t, q, push=0.0):
        """M a - f = mu^T lambda, with a by a difference of order 4 along the motion."""
        v, e = cls.velocity(t, q), 1e-3
        one, two = (
            (cls.velocity(t + d, q + d * v) - cls.velocity(t - d, q - d * v)) / (2 * d)
            for d in (e, 2 * e)
        )
        a = (4 * one - two) / 3
        # d/dt L_x' = (1 + y^2) a_x + 2 y y' x', L_x = y, L_y = y x'^2 + x
        needed = [
            (1 + q[1] ** 2) * a[0] + 2 * q[1] * v[1] * v[0] - q[1] - push + v[0],
            a[1] - q[1] * v[0] ** 2 - q[0],
        ]
        return np.linalg.solve(cls.mu(t, q).T, needed)

    @classmethod
    def position(cls, t):
        """The end of the motion that starts in Q0 at 0."""
        return solve_ivp(
            cls.velocity, (0, t), Q0, method="DOP853", rtol=1e-13, atol=1e-14
        ).y[:, -1]  # fmt: skip


@pytest.mark.parametrize(
    ("scheme", "h", "error"),
    [
        ("leapfrog", 1e-3, 1e-6),
        ("midpoint", 1e-3, 1e-6),
        ("leapfrog-kl6", 0.05, 1e-10),
        ("midpoint-kl8", 0.1, 1e-11),
        ("bm6", 0.05, 1e-9),
        ("explicit", 1e-3, 2e-3),
        ("pair:0.5:0.5", 1e-3, 1e-6),
        ("reference", 0.5, 1e-12),
    ],
)
def test_prescribed_motion(scheme, h, error):
    """q is a quadrature, v follows from q and t, the multipliers are the forces of its motors."""
    v0 = Led.velocity(0, Q0)
    run = dal.integrate(Led.system, scheme, Q0, v0, h=h, t_end=1, inputs=[0.7])
    np.testing.assert_allclose(run.q[-1], Led.position(1), atol=error)
    for k in (0, len(run.t) // 2, -1):
        t, q = run.t[k], run.q[k]
        np.testing.assert_allclose(run.v[k], Led.velocity(t, q), rtol=1e-14)
        np.testing.assert_allclose(run.multipliers[k], Led.multipliers(t, q, 0.7), rtol=1e-9)
    assert run.residual.max() <= 8 * 2.0**-53
    if not np.isnan(run.reactions).any():  # means over a step, of its middle
        half = len(run.t) // 2
        t, q = run.t[half] + h / 2, (run.q[half] + run.q[half + 1]) / 2
        near = 30 * h if scheme == "explicit" else 30 * h**2
        np.testing.assert_allclose(run.reactions[half], Led.multipliers(t, q, 0.7), atol=near)


def test_projected_nodes_are_those_of_a_motion_whose_time_is_that_of_its_moved_nodes():
    """q - h/2 v starts at t = 0, as if the node stood at h/2: so seen the error is O(h^2)."""
    for h in (0.02, 0.01):
        moved = Q0
        for _ in range(60):
            moved = Q0 - h / 2 * Led.velocity(0, moved)
        end = solve_ivp(Led.velocity, (0, 1), moved, method="DOP853", rtol=1e-13, atol=1e-14)
        node = end.y[:, -1] + h / 2 * Led.velocity(1, end.y[:, -1])
        run = dal.integrate(
            Led.system, "midpoint-nodes", Q0, Led.velocity(0, Q0), h=h, t_end=1, initial="project"
        )
        np.testing.assert_allclose(run.q[-1], node, atol=0.3 * h**2)
        assert 0.1 * h < abs(run.q[-1] - Led.position(1)).max() < 0.3 * h


def test_all_ways_to_run():
    v0 = Led.velocity(0, Q0)
    run = dal.integrate(Led.system, "midpoint-kl6", Q0, v0, h="auto", t_end=1)
    np.testing.assert_allclose(run.q[-1], Led.position(1), atol=1e-8)
    np.testing.assert_allclose(run(0.3).q, Led.position(0.3), atol=1e-6)
    kept = dal.integrate(Led.system, "midpoint-nodes", Q0, v0, h=1e-3, t_end=1, initial="shift")
    np.testing.assert_allclose(kept.q[-1] - kept.v[-1] * 5e-4, Led.position(1), atol=1e-6)
    study = dal.convergence(Led.system, "midpoint", q0=Q0, v0=v0, t_end=1)
    assert study.verdict == "holds"
    np.testing.assert_allclose(
        dal.reference(Led.system, Q0, v0, 1.0, coordinates="xi").q, Led.position(1), atol=1e-12
    )
    with pytest.raises(dal.NotOnConstraintError, match="project"):
        dal.integrate(Led.system, "leapfrog", Q0, v0 + [1e-3, 0], h=0.1, steps=1)
    found = dal.integrate(Led.system, "leapfrog", Q0, [5, 5], h=0.1, steps=1, consistent="project")
    np.testing.assert_allclose(found.v[0], v0, rtol=1e-14)
    np.testing.assert_allclose(Led.system.consistent(Q0, [5, 5]), v0, rtol=1e-14)
    with pytest.raises(dal.SingularError, match="keep fixes 1 of 2 velocities"):
        Led.system.consistent(Q0, v0, keep="x")


@pytest.mark.parametrize("lanes", [False, True])
def test_ensembles_and_journals_have_the_bits(lanes, tmp_path):
    starts = Q0 + 0.01 * np.arange(10).reshape(5, 2)
    given = {"consistent": "project", "h": 0.02, "t_end": 1}
    runs = [dal.integrate(Led.system, "leapfrog", q, [0, 0], **given) for q in starts]
    many = dal.ensemble(
        Led.system, "leapfrog", q0=starts, v0=[0, 0], lanes=lanes, progress=False, **given
    )
    np.testing.assert_array_equal(many.q, [run.q[-1] for run in runs])
    file = tmp_path / "run.dal"
    dal.integrate(Led.system, "leapfrog", starts[1], [0, 0], journal=file, **given)
    np.testing.assert_array_equal(dal.resume(file, system=Led.system).x, runs[1].x)


def test_a_chart_has_no_velocity_left():
    v0 = Led.velocity(0.2, Q0)
    chart = dal.Chart(Led.system, Q0, v0, t=0.2)
    assert chart.independent == () and chart.A(Q0, t=0.2).shape == (2, 0)
    np.testing.assert_allclose(chart.field(Q0, 0.2), v0, rtol=1e-14)
    np.testing.assert_allclose(chart.lift(Q0, 0.2)[1], v0, rtol=1e-14)
    assert chart.condition(Q0, t=0.2) == 1.0
    slope = [Led.velocity(0.2, Q0 + e) - Led.velocity(0.2, Q0 - e) for e in 1e-5 * np.eye(2)]
    np.testing.assert_allclose(chart.jacobian(Q0, 0.2)[2:], np.transpose(slope) / 2e-5, rtol=1e-8)
    run = dal.integrate(Led.system, "midpoint", Q0, v0, t0=0.2, h=0.1, steps=1)
    np.testing.assert_allclose(chart.step(Q0, 0.1, t=0.2)[0], run.q[-1], rtol=1e-14)


def test_what_the_check_says(in_python):
    found = Led.system.check(Q0, Led.velocity(0, Q0))
    assert found and found.rank == 2 and found.kernel_min == np.inf
    assert found.text.endswith("one for each coordinate: they prescribe the velocity")
    assert "on ker mu" not in str(found)
    at_rest = weighed().check()
    assert at_rest and at_rest.integrable and at_rest.growth == (0, 0) and at_rest.exact
    assert at_rest.text.endswith("D has dimension 0: the system cannot move")
    five = dal.coordinates("a b c d e")  # too many for a proof by algebra, which is not needed
    rows = [x.d + (sp.sin(x) + y**2) * y.d for x, y in zip(five, five[1:])]
    fixed = dal.System.from_sympy(sum(x.d**2 for x in five), [*rows, five[4].d])
    assert fixed.check([1] * 5, [0] * 5).exact


def weighed():
    """Return two linear constraints on two coordinates: nothing moves."""
    return dal.System.from_sympy(
        (X.d**2 + Y.d**2) / 2 - 9.81 * X - 3 * Y,
        [sp.cos(X) * X.d + sp.sin(Y) * Y.d / 3 + Y.d, (3 + Y) * X.d - Y.d / 7],
        q0=Q0,
        v0=[0, 0],
    )


@pytest.mark.parametrize("scheme", ["leapfrog", "midpoint", "leapfrog-kl6", "bm4", "reference"])
def test_rest(scheme, in_python):
    """mu v = 0 leaves v = 0, whatever weighs on it; the multipliers carry that."""
    run = dal.integrate(weighed(), scheme, h=0.1, t_end=1)
    assert not run.v.any() and (run.q == Q0).all()
    mu = [[np.cos(0.3), np.sin(0.4) / 3 + 1], [3.4, -1 / 7]]
    np.testing.assert_allclose(run.multipliers, [np.linalg.solve(np.transpose(mu), [9.81, 3])] * 11)


def test_nonlinear(in_python):
    """x'^2 + y'^2 = 4 and x' y' = 1: two of the four velocities, by where v0 is."""
    both = dal.System.from_sympy((X.d**2 + Y.d**2) / 2 - X, [X.d**2 + Y.d**2 - 4, X.d * Y.d - 1])
    low, high = (np.sqrt(2 + s * np.sqrt(3)) for s in (-1, 1))
    for v in ([low, high], [high, low], [-low, -high]):
        v0 = both.project(Q0, np.multiply(v, 1.05))
        np.testing.assert_allclose(v0, v, rtol=1e-14)
        run = dal.integrate(both, "midpoint", Q0, v0, h=0.1, t_end=1)
        np.testing.assert_allclose(run.q[-1], Q0 + v, rtol=1e-13)
        slope = [[2 * v[0], 2 * v[1]], [v[1], v[0]]]
        force = np.linalg.solve(np.transpose(slope), [1, 0])
        np.testing.assert_allclose(run.multipliers[-1], force, rtol=1e-12)


def test_sympy_mechanics(in_python):
    from sympy.physics import mechanics

    q, u = mechanics.dynamicsymbols("q u")
    lm = mechanics.LagrangesMethod(q.diff() ** 2 - q, [q], nonhol_coneqs=[q.diff() - 2])
    np.testing.assert_allclose(dal.System.from_lagranges_method(lm).multipliers([5], [2]), [1])
    wall, bob = mechanics.RigidBody("W"), mechanics.Particle("P", mass=2)
    system = mechanics.System.from_newtonian(wall)
    bob.potential_energy = 3 * q**2 / 2
    system.add_joints(mechanics.PrismaticJoint("J", wall, bob, q, u))
    system.add_nonholonomic_constraints(u - 4)
    led = dal.System.from_mechanics_system(system)
    assert led.m == led.n == 1
    np.testing.assert_allclose(led.multipliers([5], led.project([5], [0])), [15])


def test_more_constraints_than_coordinates():
    with pytest.raises(ValueError, match="constraints: 2 on 1 coordinates; expected at most 1"):
        dal.System.from_sympy(X.d**2 / 2, [X.d - 3, X.d - 4])
    with pytest.raises(ValueError, match="m = 2 constraints on n = 1 coordinates: expected at"):
        dal.System(mass=[1], mu=lambda q: [[1.0], [2.0]])
