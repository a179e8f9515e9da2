"""No number that is wrong without a word: cases that were, against independent solutions."""

from __future__ import annotations

import warnings
from fractions import Fraction

import numpy as np
import pytest
import sympy as sp

import dalembert as dal

U = 2.0**-53


def system_of(B, mass, c):
    """Return the system of constant forms B in the field of the constant force -c."""
    return dal.System(
        mass=mass,
        mu=lambda q: B,
        mu_v_q=lambda q, v: 0 * B,
        potential=lambda q: q @ c,
        gradient=lambda q: c,
    )


def coupled(m, ring, seed=None):
    """Return m forms that share a coordinate each with the next: a chain, or a ring."""
    n = 2 * m + 1
    B = np.zeros((m, n))
    random = np.random.default_rng(seed)
    for i in range(m):
        last = (0 if ring else 2 * m) if i == m - 1 else 2 * i + 2
        if seed is None:
            B[i, [2 * i, 2 * i + 1, last]] = 0.5, 1, 0.1
        else:
            B[i, [2 * i, 2 * i + 1]] = random.normal() / 2, 1
            B[i, last] += 0.3 * random.normal()
    return B


def residual_of(mu, inverse, v, phi=None):
    """Return the residual of D as the header defines it."""
    d = np.sqrt(np.diag(inverse))
    value = mu @ v if phi is None else phi
    scale = abs(mu) @ d * np.max(abs(v) / d) + abs(value - mu @ v)
    return np.max(abs(value) / np.where(scale > 0, scale, 1))


# ---- linear algebra ------------------------------------------------------------------------------


@pytest.mark.parametrize("ring", [False, True])
@pytest.mark.parametrize(
    "m, seed, mass",
    [(12, None, "unit"), (20, 0, "full"), (50, 1, "diagonal"), (50, 1, "full"), (200, 2, "unit")],
)
def test_coupled_constraints(m, seed, mass, ring):
    """Lambda, the projection and a step against a dense solve, for conditions below 100."""
    B = coupled(m, ring, seed)
    n = B.shape[1]
    random = np.random.default_rng(5)
    M = {
        "unit": np.eye(n),
        "diagonal": np.diag(random.uniform(0.5, 2, n)),
        "full": np.eye(n) + 0.3 * (np.eye(n, k=1) + np.eye(n, k=-1)),
    }[mass]
    c, v = random.normal(size=(2, n))
    system, q = system_of(B, M, c), np.zeros(n)
    inverse = np.linalg.inv(M)
    C = B @ inverse @ B.T
    tolerance = 100 * n * U * np.linalg.cond(C)
    assert tolerance < 1e-10
    exact = np.linalg.solve(C, B @ inverse @ c)
    np.testing.assert_allclose(system.multipliers(q, q), exact, rtol=0, atol=tolerance * 10)
    in_D = v - inverse @ B.T @ np.linalg.solve(C, B @ v)
    projected = system.project(q, v)
    np.testing.assert_allclose(projected, in_D, rtol=0, atol=tolerance * 10)
    run = dal.integrate(system, "midpoint", q, projected, h=0.1, steps=3)
    a = inverse @ (B.T @ exact - c)  # constant: the motion is a parabola, which midpoint follows
    np.testing.assert_allclose(run.v[-1], in_D + 0.3 * a, rtol=0, atol=tolerance * 10)
    np.testing.assert_allclose(run.q[-1], 0.3 * in_D + 0.045 * a, rtol=0, atol=tolerance * 10)
    assert max(residual_of(B, inverse, v) for v in run.v) <= 4 * n * U


@pytest.mark.parametrize("condition", [1e8, 1e12])
def test_conditions_that_have_an_answer(condition):
    """Two forms that nearly coincide, in units as far apart as 1e20."""
    e = 2 / np.sqrt(condition)
    for unit in (1.0, 1e20, 1e-20):
        B = np.array([[1, 1, 0], [1, 1 + e, e]]) * [[1], [unit]]
        c = np.array([1.0, 2, 3])
        rows = sp.Matrix(2, 3, [sp.Rational(float(b)) for b in B.ravel()])
        exact = (rows * rows.T).LUsolve(rows * sp.Matrix([1, 2, 3]))
        told = system_of(B, np.eye(3), c).multipliers(np.zeros(3), np.zeros(3))
        for a in range(2):
            assert abs(told[a] / float(exact[a]) - 1) <= 100 * 2 * U * condition * 10


def test_conditions_that_have_none():
    B = np.array([[1, 1, 0], [1, 1 + 1e-9, 1e-9]])  # 1e18 for C
    with pytest.raises(dal.SingularError, match=r"\[1\] equals constraints\[0\] up to 7e-10"):
        system_of(B, np.eye(3), np.ones(3)).multipliers(np.zeros(3), np.zeros(3))
    small = np.array([[1, 0, 0], [0, 1e-20, 0]])  # small, not singular
    told = system_of(small, np.eye(3), np.ones(3)).multipliers(np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(told, [1, 1e20], rtol=1e-15)


@pytest.mark.parametrize("decades", [0, 8, 12, 16])
@pytest.mark.parametrize("force", [False, True])
def test_units_of_coordinates(decades, force):
    """A pendulum beside a free particle whose unit of length is small: the same step."""
    pull = {
        "potential": lambda q: 100 * np.cos(q[0]),
        "gradient": lambda q: [-100 * np.sin(q[0]), 0],
    }
    if force:
        pull = {
            "force": lambda t, q, v: [100 * np.sin(q[0]), 0],
            "force_q": lambda t, q, v: [[100 * np.cos(q[0]), 0], [0, 0]],
            "force_v": lambda t, q, v: np.zeros((2, 2)),
        }
    system = dal.System(mass=[1, 10.0 ** (-2 * decades)], **pull)
    start = [1, 0], [1, 10.0**decades]
    run = dal.integrate(system, "midpoint", *start, h=0.1, steps=1)
    (q, q1), (v, v1) = run.q[:, 0], run.v[:, 0]
    assert abs(v1 - v - 5 * (np.sin(q) + np.sin(q1))) < 1e-13
    assert abs(q1 - q - 0.05 * (v + v1)) < 1e-14
    with pytest.raises(dal.ConvergenceError):  # no small step leads there
        dal.integrate(system, "midpoint", *start, h=0.3, steps=1)


@pytest.mark.parametrize("decades", [12, 15, 30, 60])
def test_units_of_forms(decades):
    """Forms a graded factor apart are no nearer to singular: everything that solves with them."""
    mu = np.array([[1, -1, 0, 0], [0, 1, -1, 0], [0, 0, 1, -1.0]])
    mu = mu * 10.0 ** np.array([[-decades], [0], [decades]])
    system = system_of(mu, np.ones(4), np.array([1.0, 2, 3, 4]))
    q, mean = np.zeros(4), np.full(4, 2.5)
    np.testing.assert_allclose(system.project(q, [1, 2, 3, 4]), mean, rtol=1e-14)
    kept = system.consistent(q, [1, 2, 3, 4], keep=[3])
    np.testing.assert_allclose(kept, np.full(4, 4.0), rtol=1e-14)
    np.testing.assert_allclose(system.acceleration(q, mean), -mean, rtol=1e-13)
    for scheme in ("leapfrog", "midpoint-nodes", "reference"):
        initial = {"initial": "project"} if scheme.endswith("nodes") else {}
        run = dal.integrate(system, scheme, q, mean, h=0.1, steps=2, **initial)
        np.testing.assert_allclose(run.v[-1], mean - 0.2 * mean, rtol=1e-12)
    flow = dal.reference(system, q, mean, 0.2, coordinates="xi")
    np.testing.assert_allclose(flow.v, 0.8 * mean, rtol=1e-12)


# ---- the residual --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["n_trailer", "snakeboard", "two_wheeled_robot"])
def test_headings_of_zero(name):
    """Forms with one term, velocities of any size: projection and steps, no false alarm."""
    system = dal.systems.get(name)
    q = np.zeros(system.n)
    random = np.random.default_rng(0)
    inverse = np.linalg.inv(system.metric(q))
    for k in range(30):
        v = system.project(q, random.normal(size=system.n) * 10.0 ** random.integers(-80, 80))
        assert system.relative_residual(q, v) <= 4 * system.n * U
        mu = np.array([system.residual(q, e) for e in np.eye(system.n)]).T
        assert residual_of(mu, inverse, v) <= 4 * system.n * U
    for scheme in ("leapfrog", "midpoint", "reference"):
        v = system.project(q, np.ones(system.n))
        run = dal.integrate(system, scheme, q, v, h=0.01, steps=9)
        assert run.residual.max() <= 4 * system.n * U


@pytest.mark.parametrize("scheme", ["leapfrog", "explicit", "midpoint", "leapfrog-kl6"])
def test_from_rest(scheme, in_python):
    """A robot that its wheels turn on the spot, and one that a force holds against its blade."""
    x, y, th, right, left = dal.coordinates("x y theta phi_r phi_l")
    u = sp.cos(th) * x.d + sp.sin(th) * y.d
    rows = [
        -sp.sin(th) * x.d + sp.cos(th) * y.d,
        u + sp.Rational(1, 5) * th.d - right.d / 10,
        u - sp.Rational(1, 5) * th.d - left.d / 10,
    ]
    centre = x.d - th.d * sp.sin(th) / 10, y.d + th.d * sp.cos(th) / 10
    L = 5 * (centre[0] ** 2 + centre[1] ** 2) + th.d**2 / 4 + (right.d**2 + left.d**2) / 200
    robot = dal.System.from_sympy(L, rows, [x, y, th, right, left], force={right: 1, left: -1})
    run = dal.integrate(robot, scheme, [0] * 5, [0] * 5, h=0.002, steps=20)
    inverse = np.linalg.inv(robot.metric(run.q[0]))
    assert run.stats.worst_residual >= run.residual.max() and run.residual.max() <= 20 * U
    for q, v in zip(run.q, run.v):
        mu = np.array([robot.residual(q, e) for e in np.eye(5)]).T
        assert residual_of(mu, inverse, v) <= 20 * U
    held = dal.System(
        mass=[1, 2],
        mu=lambda q: [[0.3, 0]],
        mu_v_q=lambda q, v: [[0, 0]],
        potential=lambda q: 7 * q[0],
        gradient=lambda q: [7, 0],
    )
    run = dal.integrate(held, scheme, [0.1, 0], [0, 0], h=0.01, steps=100)
    assert not run.v.any() and run.residual.max() == 0


@pytest.mark.parametrize("name", ["steered_car", "roller_racer"])
def test_the_worst_is_what_is_stored(name):
    system = dal.systems.get(name)
    run = dal.integrate(system, "leapfrog", h=0.02, steps=5000)
    assert run.residual.max() <= run.stats.worst_residual <= 4 * system.n * U


def test_a_false_declaration_is_found_out():
    """Mu depends on y, which the reaction pushes, beyond y = 1/2 only."""
    system = dal.System(
        mass=np.eye(3),
        mu=lambda q: [[1, -np.sin(q[2]), max(q[1] - 0.5, 0)]],
        mu_v_q=lambda q, v: [[0, (q[1] > 0.5) * v[2], -np.cos(q[2]) * v[1]]],
        steady=True,
    )
    q0 = [0, 0, 0.3]
    v0 = system.project(q0, [0.2, 1, 1])
    with pytest.raises(ValueError, match=r"step [3-7]\d \(.*declared steady"):  # where y is 1/2
        dal.integrate(system, "leapfrog", q0, v0, h=0.01, steps=300)


@pytest.mark.parametrize("scheme", ["midpoint-nodes", "explicit-nodes"])
@pytest.mark.parametrize("far, h", [(1, 0.2), (1e4, 0.1), (1e7, 0.01)])
@pytest.mark.parametrize("force", [False, True])
def test_kept_nodes_where_they_give_q_back(scheme, far, h, force):
    """The state that is measured is the one that a reader computes from what is stored."""
    more = {"force": lambda t, q, v: 0 * v} if force else {}
    system = dal.System(
        mass=[1, 1, 0.5], mu=lambda q: [[-np.sin(q[2]), np.cos(q[2]), -0.2]], **more
    )
    start = [far, -far, far], [1, 0.2, 3.0]
    run = dal.integrate(
        system, scheme, *start, h=h, steps=40, consistent="project", initial="project"
    )
    inverse = np.diag([1, 1, 2.0])
    told = 0.0
    for q, v in zip(run.q[1:] - run.shift * run.v[1:], run.v[1:]):
        told = max(told, residual_of(np.array([[-np.sin(q[2]), np.cos(q[2]), -0.2]]), inverse, v))
    assert told <= 12 * U and told <= run.stats.worst_residual * (1 + 1e-9) + U


# ---- roots and blow-ups --------------------------------------------------------------------------


def told(system, scheme, h, steps):
    """Return whether a run ends in an error or a warning, and the run if it came to its end."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            run = dal.integrate(system, scheme, h=h, steps=steps)
        except dal.DalembertError as error:
            assert f"h = {h:g}" in str(error) and "t = " in str(error)
            return True, None
    words = "energy has changed", "too large (h = "
    return any(word in str(one.message) for word in words for one in heard), run


@pytest.mark.parametrize(
    "name, scheme",
    [
        ("heisenberg", "leapfrog"), ("snakeboard", "leapfrog"), ("sleigh", "leapfrog"),
        ("chaotic", "midpoint"), ("rolling_disc", "midpoint"), ("sleigh", "midpoint-kl8"),
    ],
)  # fmt: skip
def test_growing_steps(name, scheme):
    """The step doubles until it fails: an energy that is lost or explodes is never silent."""
    system = dal.systems.get(name)
    h, failed = 0.05, False
    while h < 100:
        loud, run = told(system, scheme, h, 256)
        if run is not None and not loud:
            v = run.v[::64]
            kinetic = max(w @ system.metric(q, w) @ w / 2 for q, w in zip(run.q[::64], v))
            assert abs(run.energy[::64] - run.energy[0]).max() <= 0.51 * kinetic, h
        failed = failed or loud
        h *= 2
    assert failed or name == "heisenberg"


def test_time_that_stands_still():
    particle = dal.systems.particle()
    with pytest.raises(ValueError, match="does not change the time"):
        dal.integrate(particle, "midpoint", h=1e-3, steps=2, t0=1e14)


@pytest.mark.parametrize("t_end", [1e-6, 1e-7, 1e-9])
@pytest.mark.parametrize("scheme", ["midpoint", "leapfrog"])
def test_short_spans(scheme, t_end):
    """Where h is so small that errors are roundoff over h no order is said to be missed."""
    study = dal.convergence(dal.systems.particle(), scheme, t_end=t_end)
    assert study.holds is not False and study.keeps == "D", study.text


@pytest.mark.parametrize("angle", [0.5, 1e-3, 1e-5, 1e-6])
def test_the_reference_knows_what_nearly_dependent_forms_lose(angle):
    """A line of free fall, by exact rationals."""
    B = np.array([[0.3, 1.0, -0.7], [0.3 + angle, 1.0, -0.7 + 0.2 * angle]])
    c, v = np.array([1.5, -2.0, 1.0]), 0.25
    held = system_of(B, np.array([1.0, 2.0, 0.5]), c)
    (a, b, d), (e, f, g) = ([Fraction(x) for x in row] for row in B)
    w = [b * g - d * f, d * e - a * g, a * f - b * e]  # along D
    w = [x / w[1] for x in w]
    pull = -sum(x * Fraction(y) for x, y in zip(w, c, strict=True))
    pull /= w[0] ** 2 + 2 * w[1] ** 2 + w[2] ** 2 / 2
    t = 3
    q = [float(x * (Fraction(v) * t + pull * t * t / 2)) for x in w]
    found = dal.reference(held, [0, 0, 0], held.project([0, 0, 0], [float(x) * v for x in w]), t)
    assert abs(found.q - q).max() <= 10 * found.accuracy
    assert found.accuracy <= 1e-13 + 1e-14 / angle**2


# ---- rows that depend ------------------------------------------------------------------------


def words_of(make):
    """Return the end of what an error, or a check, says."""
    try:
        text = make().text
    except dal.SingularError as error:
        text = str(error)
    return text.split(": ")[-1]


def test_rows_that_depend_are_named(in_python):
    """In every message about the rank; coefficients as they are in the formulas."""
    x, y, z, w, psi = dal.coordinates("x y z w psi")
    c, s = sp.cos(psi), sp.sin(psi)
    side, ahead = -s * x.d + c * y.d, c * x.d + s * y.d
    T = sum(i * k.d**2 for i, k in enumerate((x, y, z, w, psi), 1)) / 2
    state = [0.1, 0.2, 0.3, 0.4, 0.5], np.zeros(5)
    third = sp.Rational(1, 3)
    for rows, said in (
        ([side, ahead - psi.d, side, ahead + psi.d], "constraints[2] equals constraints[0] here"),
        ([side, ahead, 2 * side - ahead],
         "constraints[2] = 2 constraints[0] - constraints[1] here"),
        ([side, ahead, -1000 * side], "constraints[2] equals -1000 constraints[0] here"),
        ([1e-9 * ahead, side, 2 * ahead - third * side],
         "constraints[2] = 2e+09 constraints[0] - 0.333333 constraints[1] here"),
        ([side, ahead, w.d - ahead, z.d - side, z.d - w.d - side],
         "constraints[4] = -constraints[1] - constraints[2] + constraints[3] here"),
        ([side, ahead + 2 * side, side, ahead],
         "constraints[2] equals constraints[0]; "
         "constraints[3] = -2 constraints[0] + constraints[1] here"),
        ([(x - sp.Rational(1, 10)) * side, ahead], "constraints[0] vanishes here"),
        ([side + sp.Rational(1, 10**9) * ahead, side],
         "constraints[1] equals constraints[0] up to 9e-10 here"),
        ([side - 1, ahead, 2 * side - 3],
         "constraints[2] equals 2 constraints[0] here, in its dependence on v"),
    ):  # fmt: skip
        system = dal.System.from_sympy(T, rows)
        assert words_of(lambda: system.check(*state)) == said
        assert words_of(lambda: system.multipliers(*state)) == said
        assert words_of(lambda: system.project(state[0], np.ones(5))) == said
        if "up to" not in said:  # then a choice is possible
            assert said in words_of(lambda: dal.Chart(system, *state))
    tiny = dal.System.from_sympy(T, [1e-200 * side, ahead])  # the square of its length is 0
    assert words_of(lambda: tiny.multipliers(*state)) == "mu does not have full rank"


def test_rows_that_depend_on_the_way():
    """Two blades that are parallel at s = 0, where a step leads."""
    blades = dal.System(
        mass=[1, 1, 1],
        mu=lambda q: [[np.cos(q[2]), np.sin(q[2]), 0], [np.cos(q[2]), -np.sin(q[2]), 0]],
        mu_v_q=lambda q, v: [
            [0, 0, -np.sin(q[2]) * v[0] + sign * np.cos(q[2]) * v[1]] for sign in (1, -1)
        ],
    )
    for scheme in ("leapfrog", "midpoint", "endpoint", "leapfrog-kl6"):
        run = dal.integrate(
            blades, scheme, [0, 0, 0.5], [0, 0, -1], h=0.5, t_end=2, throw=False
        )
        assert run.message.startswith("SingularError: step "), scheme
        assert "constraints[1] equals constraints[0] here" in run.message, run.message


def test_rows_that_vanish_on_the_way_are_named(in_python):
    """The second of two constraints vanishes at x = 0, between a node and the end of a step."""
    x, y, z, w = dal.coordinates("x y z w")
    rows = [w.d - 2 * z.d, x * (x.d + y.d)]
    system = dal.System.from_sympy((x.d**2 + y.d**2 + z.d**2 + w.d**2) / 2, rows)
    for scheme in ("leapfrog", "midpoint"):
        start = [-1, 1, 0, 0], [1, -1, 1, 2]
        run = dal.integrate(system, scheme, *start, h=0.036, steps=99, throw=False)
        assert run.success is False and abs(run.q[-1, 0]) < 0.036
        assert "constraints[1] turns by more than a right angle in this step" in run.message


def test_rows_of_many_constraints_that_depend():
    """Where C is stored by blocks, those of one are looked at."""
    T, rows = 0, []
    for k in range(6):
        x, y = dal.coordinates(f"x{k} y{k}")
        T, rows = T + x.d**2 + k * y.d**2 + y.d**2, [*rows, x.d - y * y.d]
    rows.insert(3, 2 * rows[4])
    system = dal.System.from_sympy(T, rows)
    assert system.sparsity is not None
    with pytest.raises(dal.SingularError, match=r"\[5\] equals 0.5 constraints\[3\] here"):
        system.multipliers(np.ones(12), np.ones(12))


def test_kept_components_and_the_rows_that_depend():
    system = system_of(np.array([[1.0, 1, 1], [3, 3, 1]]), np.eye(3), np.zeros(3))
    with pytest.raises(dal.SingularError, match=r"fix fewer: .*\[1\] equals 3 constraints\[0\]"):
        system.consistent([0, 0, 0], [1, 1, 1], keep=[2])
