"""Systems with many coordinates, whose constraints touch few: against dense ones, against an
integration of the reduced equations, and what is refused."""

import pickle
import re
import tracemalloc

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.sparse import coo_array

import dalembert as dal

U = 2.0**-53


class Skates:
    """Skates in a row; each drags the next one along, and a spring is between neighbours."""

    def __init__(self, count, coupling=0.4, stiffness=0.7):
        self.count, self.n = count, 3 * count
        self.coupling, self.stiffness = coupling, stiffness
        own = np.arange(self.n).reshape(count, 3)
        pattern = np.zeros((count, self.n), dtype=bool)
        for a in range(count):
            pattern[a, own[a]] = True
            if a and coupling:
                pattern[a, own[a - 1]] = True
        self.pattern, self.entries = pattern, np.nonzero(pattern)

    def mu(self, q):
        mu = np.zeros((self.count, self.n))
        for a in range(self.count):
            x, y, heading = q[3 * a : 3 * a + 3]
            mu[a, 3 * a : 3 * a + 3] = -np.sin(heading), np.cos(heading), 0.2 + 0.1 * np.sin(x)
            if a and self.coupling:
                mu[a, 3 * a - 3] = self.coupling * np.cos(q[3 * a - 1])
        return mu

    def derivative(self, q, v):
        N = np.zeros((self.count, self.n))
        for a in range(self.count):
            x, y, heading = q[3 * a : 3 * a + 3]
            vx, vy, turn = v[3 * a : 3 * a + 3]
            N[a, 3 * a] = 0.1 * np.cos(x) * turn
            N[a, 3 * a + 2] = -np.cos(heading) * vx - np.sin(heading) * vy
            if a and self.coupling:
                N[a, 3 * a - 1] = -self.coupling * np.sin(q[3 * a - 1]) * v[3 * a - 3]
        return N

    def potential(self, q):
        d = np.diff(q.reshape(-1, 3)[:, :2], axis=0)
        return self.stiffness * float(np.sum((np.sum(d**2, axis=1) - 1) ** 2)) / 4

    def gradient(self, q):
        d = np.diff(q.reshape(-1, 3)[:, :2], axis=0)
        pull = self.stiffness * (np.sum(d**2, axis=1) - 1)[:, None] * d
        g = np.zeros((self.count, 3))
        g[1:, :2] += pull
        g[:-1, :2] -= pull
        return g.ravel()

    def sparse_forms(self, q):
        return self.mu(q)[self.entries]

    def sparse_derivative(self, q, v):
        return self.derivative(q, v)[self.entries]

    @property
    def masses(self):
        return 1 + 0.1 * (np.arange(self.n) % 5)

    def systems(self, **more):
        """Return the dense system and the sparse one."""
        V = {"potential": self.potential, "gradient": self.gradient} if self.stiffness else {}
        common = V | more
        dense = dal.System(
            mass=np.diag(self.masses), mu=self.mu,
            mu_v_q=self.derivative, **common,
        )  # fmt: skip
        sparse = dal.System(
            mass=self.masses, mu=self.sparse_forms,
            mu_v_q=self.sparse_derivative, sparsity=self.pattern, **common,
        )  # fmt: skip
        return dense, sparse

    def start(self, system):
        q = np.zeros((self.count, 3))
        q[:, 0], q[:, 2] = np.arange(self.count), 0.3 * np.sin(np.arange(self.count))
        v = np.cos(np.arange(self.n)) + 0.3
        return q.ravel(), system.consistent(q.ravel(), v)

    def reduced(self, t, x):
        """The equations with the multipliers eliminated, dense, by NumPy."""
        q, v = np.split(x, 2)
        mu, inverse = self.mu(q), 1 / self.masses
        f = -self.gradient(q)
        C = (mu * inverse) @ mu.T
        multipliers = np.linalg.solve(C, -mu @ (inverse * f) - self.derivative(q, v) @ v)
        return np.concatenate([v, inverse * (f + mu.T @ multipliers)])


@pytest.mark.parametrize(
    ("scheme", "coupling", "stiffness"),
    [
        *((x, 0.4, 0.7) for x in ("leapfrog", "midpoint", "midpoint-nodes", "explicit", "0.3")),
        *(("midpoint", *x) for x in ((0, 0.7), (0.4, 0), (0, 0))),
    ],
)
def test_same_runs(scheme, coupling, stiffness):
    skates = Skates(7, coupling, stiffness)
    dense, sparse = skates.systems()
    start = skates.start(dense)
    initial = {"initial": "project"} if "nodes" in scheme else {}
    runs = [dal.integrate(s, scheme, *start, h=0.03, steps=30, **initial) for s in (dense, sparse)]
    for key in ("q", "v", "multipliers", "energy", "residual"):
        one, other = (getattr(run, key) for run in runs)
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-11, err_msg=key)
    assert runs[1].stats.worst_residual <= 4 * skates.n * U


def test_against_the_reduced_equations():
    skates = Skates(6)
    sparse = skates.systems()[1]
    q0, v0 = skates.start(sparse)
    run = dal.integrate(sparse, "midpoint-kl8", q0, v0, h=0.05, t_end=0.5)
    exact = solve_ivp(
        skates.reduced, (0, 0.5), np.concatenate([q0, v0]), "DOP853", rtol=1e-13, atol=1e-13
    ).y[:, -1]
    np.testing.assert_allclose(np.concatenate([run.q[-1], run.v[-1]]), exact, rtol=0, atol=1e-9)
    flow = dal.integrate(sparse, "reference", q0, v0, h=0.25, t_end=0.5)
    np.testing.assert_allclose(np.concatenate([flow.q[-1], flow.v[-1]]), exact, atol=1e-10)


@pytest.mark.parametrize("given", [
    lambda s: s.pattern,
    lambda s: s.pattern.astype(int).tolist(),
    lambda s: coo_array(s.pattern),
    lambda s: coo_array(s.pattern).tocsc(),
    lambda s: coo_array((np.ones(42), tuple(np.tile(x, 2) for x in s.entries)), (4, 12)),
    lambda s: s.entries,
    lambda s: tuple(x.astype(np.int32) for x in s.entries),
])  # fmt: skip
def test_ways_to_say_it(given):
    skates = Skates(4)
    system = dal.System(mass=1, n=skates.n, mu=skates.sparse_forms, sparsity=given(skates))
    assert system.m == 4
    for one, other in zip(system.sparsity, skates.entries):
        np.testing.assert_array_equal(one, other)
    assert dal.System(mass=1, n=2).sparsity is None
    large = dal.System(mass=1, n=20_001, mu=lambda q: [1], sparsity=([0], [0]))
    assert (large.n, large.m) == (20_001, 1)


def test_derivatives_by_differences():
    skates = Skates(8)
    dense, sparse = skates.systems()
    q0, v0 = skates.start(dense)
    alone = dal.System(
        mass=skates.masses, mu=skates.sparse_forms, sparsity=skates.entries,
        potential=skates.potential, gradient=skates.gradient,
    )  # fmt: skip
    exact = dense.multipliers(q0, v0)
    np.testing.assert_allclose(alone.multipliers(q0, v0), exact, rtol=0, atol=1e-10)
    run = dal.integrate(alone, "midpoint", q0, v0, h=0.03, steps=10)
    best = dal.integrate(sparse, "midpoint", q0, v0, h=0.03, steps=10)
    np.testing.assert_allclose(run.q, best.q, rtol=0, atol=1e-12)
    assert run.stats.worst_residual <= 4 * skates.n * U


def test_forces_of_position_alone():
    skates = Skates(5)
    pushed = {"force": lambda t, q, v, u: np.sin(t + q) + u[0], "inputs": 1, "positional": True}
    dense, sparse = skates.systems(**pushed)
    start, table = skates.start(dense), np.linspace(-1, 1, 40)[:, None]
    runs = [
        dal.integrate(s, "leapfrog", *start, h=0.02, steps=40, inputs=table)
        for s in (dense, sparse)
    ]
    np.testing.assert_allclose(runs[0].v, runs[1].v, rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="positional = True: expected a force"):
        dal.System(mass=1, n=2, positional=True)
    wrong = skates.systems(force=lambda t, q, v: -v, positional=True)[1]
    with pytest.raises(ValueError, match="the force is declared positional, but"):
        dal.integrate(wrong, "leapfrog", *start, h=0.02, steps=1)


def drag(t, q, v):
    return -0.1 * v


def test_forces_of_velocity():
    """With masses by numbers; by a matrix, all entries of mu are formed then."""
    skates = Skates(4)
    dense = skates.systems(force=drag)[0]
    sparse = skates.systems(force=drag)[1]
    matrix = dal.System(
        mass=np.diag(skates.masses), mu=skates.sparse_forms,
        mu_v_q=skates.sparse_derivative, sparsity=skates.entries, force=drag,
        potential=skates.potential, gradient=skates.gradient,
    )  # fmt: skip
    start = skates.start(dense)
    runs = [
        dal.integrate(s, "midpoint", *start, h=0.03, steps=20) for s in (dense, sparse, matrix)
    ]
    for run in runs[1:]:
        np.testing.assert_allclose(run.v, runs[0].v, rtol=0, atol=1e-13)
    with pytest.raises(dal.ConvergenceError, match="a smaller h"):
        stiff = skates.systems(force=lambda t, q, v: -100 * v)[1]
        dal.integrate(stiff, "midpoint", *start, h=0.1, steps=20)


def test_expressions_with_friction(request):
    """More than 8 coordinates: by rows; where steps do not contract the derivatives serve."""
    count = 3
    q = dal.coordinates(" ".join(f"x{i} y{i} a{i}" for i in range(count)))
    x, y, a = q[::3], q[1::3], q[2::3]
    L = sum(c.d**2 for c in q) / 2 - sum((x[i + 1] - x[i] - 1) ** 2 for i in range(count - 1))
    rows = [-sympy.sin(a[i]) * x[i].d + sympy.cos(a[i]) * y[i].d for i in range(count)]
    friction = {c: -100 * c.d for c in q}
    system = dal.System.from_sympy(L, rows, q, force=friction)
    request.getfixturevalue("in_python")
    dense = dal.System.from_sympy(L, rows, q, force=friction)
    assert system.sparsity is not None and dense.sparsity is None
    start = np.arange(9) * 0.4, system.consistent(np.arange(9) * 0.4, np.cos(np.arange(9)))
    runs = [dal.integrate(s, "midpoint", *start, h=0.1, steps=20) for s in (system, dense)]
    np.testing.assert_allclose(runs[0].v, runs[1].v, rtol=0, atol=1e-12)
    assert runs[0].stats.full_newtons > 10


def test_the_rest_of_the_library():
    skates = Skates(4)
    dense, sparse = skates.systems()
    q, v = skates.start(dense)
    checks = [s.check(q, v) for s in (dense, sparse)]
    assert [str(c) for c in checks][0] == str(checks[1])
    given = {"q0": q, "v0": v, "t_end": 0.4, "steps": (6, 9, 12)}
    studies = [dal.convergence(s, "midpoint", **given) for s in (dense, sparse)]
    errors = [study.state_error for study in studies]
    np.testing.assert_allclose(errors[0], errors[1], rtol=1e-6, atol=1e-13)
    assert studies[0].verdict == studies[1].verdict
    deformed = [
        s.deformed(lambda q, v: 0 * v[:4] + v[0], 0.1, g_v=lambda q, v: np.eye(4, 12)[[0] * 4],
                   g_q=lambda q, v: np.zeros((4, 12)))
        for s in (dense, sparse)
    ]
    np.testing.assert_allclose(
        deformed[0].multipliers(q, v), deformed[1].multipliers(q, v), rtol=0, atol=1e-10
    )
    charts = [dal.Chart(s, q, v) for s in (dense, sparse)]
    fields = [chart.field(chart.drop(q, v)) for chart in charts]
    np.testing.assert_allclose(fields[0], fields[1], rtol=0, atol=1e-12)
    discrete = [dal.Discrete(s, 0.5).constraint_derivatives(0.1, q, q + 0.1 * v)
                for s in (dense, sparse)]
    for one, other in zip(*discrete):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


@pytest.mark.parametrize("given", [True, False])
def test_check_finds_what_a_sparsity_leaves_out(given):
    def forms(q):
        return [-np.sin(q[2]), np.cos(q[2]), -np.sin(q[5]), np.cos(q[5]), 0]

    def derivative(q, v):
        return [0, 0, 0, 0, -np.cos(q[5]) * v[3] - np.sin(q[5]) * v[4]]

    q, v = [0, 0, 0.3, 1, 1, 0.5], [np.cos(0.3), np.sin(0.3), 1, np.cos(0.5), np.sin(0.5), 1]
    rows, columns = [0, 0, 1, 1, 1], [0, 1, 3, 4, 5]  # without the heading of the first
    system = dal.System(mass=np.ones(6), mu=forms, sparsity=(rows, columns),
                        mu_v_q=derivative if given else None)
    text = r"mu_v_q\[0,2\]" if given else r"sparsity: entry \(0, 2\) is missing"
    assert re.search(text, str(system.check(q, v)))
    whole = dal.System(mass=np.ones(6), mu=lambda q: np.insert(forms(q), 2, 0),
                       sparsity=([0, 0, 0, 1, 1, 1], range(6)))
    assert str(whole.check(q, v)).startswith("passed")
    assert not whole.check(q, v).phi_q.checked


class Module(Skates):
    """Picklable."""


def test_journals_and_pickles(tmp_path):
    skates = Module(5)
    sparse = skates.systems()[1]
    again = pickle.loads(pickle.dumps(sparse))
    start, journal = skates.start(sparse), tmp_path / "run.dal"
    whole = dal.integrate(sparse, "leapfrog-kl6", *start, h=0.02, steps=60)
    dal.integrate(again, "leapfrog-kl6", *start, h=0.02, steps=25, journal=journal)
    run = dal.resume(journal, system=again, steps=60)
    np.testing.assert_array_equal(run.q, whole.q)
    others = Module(5, coupling=0).systems()[1]
    with pytest.raises(ValueError):
        dal.resume(journal, system=others, steps=70)
    told = [
        dal.System(mass=1, n=3, mu=lambda q: [1], sparsity=([0], [column]), force=drag,
                   positional=positional)
        for column, positional in ((0, False), (1, False), (0, True))
    ]  # fmt: skip
    first, *rest = (system._identity for system in told)
    assert first not in rest and rest[0] != rest[1]


@pytest.mark.parametrize(("given", "text"), [
    ({"sparsity": np.ones((2, 3))}, r"sparsity: expected shape \(m, 6\), got \(2, 3\)"),
    ({"sparsity": np.ones((3, 6)), "m": 2}, r"sparsity: expected shape \(2, 6\), got \(3, 6\)"),
    ({"sparsity": 3}, r"sparsity = 3: expected an array of shape \(m, n\)"),
    ({"sparsity": ([0, 1], [2])}, "sparsity: 2 rows and 1 columns of entries"),
    ({"sparsity": ([0.5], [2])}, "sparsity = .*expected an array"),
    ({"sparsity": ([0, -1], [2, 3])}, "sparsity: row -1 is negative"),
    ({"sparsity": ([0, 0], [3, 2])}, r"entry 1, \(0, 2\), comes after \(0, 3\)"),
    ({"sparsity": ([0, 0], [3, 7])}, r"entry 1, \(0, 7\), is outside"),
    ({"sparsity": coo_array(np.ones(6))}, r"expected shape \(m, 6\), got \(6,\)"),
    ({"sparsity": np.ones((2, 6)), "affine": lambda q: [0, 0]}, "sparsity is given with affine"),
    ({"sparsity": np.ones((2, 6)), "mu": None}, "sparsity is given without mu"),
])  # fmt: skip
def test_refused(given, text):
    options = {"mu": lambda q: np.zeros(12), "mass": np.ones(6)} | given
    with pytest.raises(ValueError, match=text):
        dal.System(**options)


def test_wrong_lengths_are_named():
    skates = Skates(3)
    system = dal.System(mass=skates.masses, mu=skates.mu, sparsity=skates.pattern)
    with pytest.raises(ValueError, match=r"mu returned shape .*: expected \(15,\)"):
        system.multipliers(np.zeros(9), np.zeros(9))


def test_no_matrix_of_n_rows():
    """3000 skates: a matrix of n rows would have 650 MB, and one of m rows 72."""
    count = 3000
    n, own = 3 * count, np.arange(3 * count).reshape(count, 3)

    def forms(q):
        heading = q[2::3]
        return np.stack([-np.sin(heading), np.cos(heading), 0 * heading], 1).ravel()

    def derivative(q, v):
        turn = -np.cos(q[2::3]) * v[::3] - np.sin(q[2::3]) * v[1::3]
        return np.stack([0 * turn, 0 * turn, turn], 1).ravel()

    tracemalloc.start()
    system = dal.System(
        mass=np.ones(n), mu=forms, mu_v_q=derivative,
        sparsity=(np.repeat(np.arange(count), 3), own.ravel()),
    )  # fmt: skip
    assert "9000 coordinates, 3000 constraints" in repr(system)
    run = dal.integrate(system, "midpoint", np.zeros(n), np.tile([1.0, 0, 0.5], count), h=0.1,
                        steps=10)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 2e7 and abs(run.residual).max() < 1e-15
