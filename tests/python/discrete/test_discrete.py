"""Discrete mechanics against formulas in NumPy, and maps that are written in Python."""

import copy
import pickle
import threading

import numpy as np
import pytest

import dalembert as dal
from conftest import U

# Single sums and quotients by h >= 0.05 of numbers of size 1 to 10.
TOLERANCE = 1e-13
# After Newton on matrices of condition below 100, with a quotient by h.
SOLVED = 1e-12


def beta_map(beta):
    """Return rho^beta, written in Python."""

    def rho(h, q0, q1):
        return (1 - beta) * q0 + beta * q1, (q1 - q0) / h

    def derivatives(h, q0, q1):
        one = np.eye(len(q0))
        return (1 - beta) * one, beta * one, -one / h, one / h

    return rho, derivatives


def bent(h, q0, q1):
    d = q1 - q0
    return (q0 + q1) / 2 + d**2 / 10, 2 * np.sinh(d / 2) / h


def bent_derivatives(h, q0, q1):
    d = q1 - q0
    slope, one = np.diag(np.cosh(d / 2) / h), np.eye(len(q0))
    return one / 2 - np.diag(d / 5), one / 2 + np.diag(d / 5), -slope, slope


@pytest.fixture
def pair(own):
    rng = np.random.default_rng(3)
    return own.q0, own.q0 + 0.05 * rng.standard_normal(4)


@pytest.mark.parametrize("beta", [0.0, 0.25, 1.0])
def test_formulas(own, pair, beta):
    h, (q0, q1) = 0.1, pair
    discrete = dal.Discrete(own.system(), beta)
    g, f = (1 - beta) * q0 + beta * q1, (q1 - q0) / h
    near = {"rtol": TOLERANCE, "atol": TOLERANCE}
    np.testing.assert_allclose(discrete.state(h, q0, q1), (g, f), **near)
    np.testing.assert_allclose(discrete.nodes(h, g, f), pair, **near)
    lagrangian = f @ own.mass @ f / 2 - own.potential(g)
    np.testing.assert_allclose(discrete.lagrangian(h, q0, q1), h * lagrangian, **near)
    force, p = -own.gradient(g), own.mass @ f
    D1, D2, D12 = discrete.lagrangian_derivatives(h, q0, q1)
    np.testing.assert_allclose(D1, h * (1 - beta) * force - p, rtol=SOLVED, atol=SOLVED)
    np.testing.assert_allclose(D2, h * beta * force + p, rtol=SOLVED, atol=SOLVED)
    second = -own.mass / h - h * beta * (1 - beta) * own.hessian(g)
    np.testing.assert_allclose(D12, second, rtol=SOLVED, atol=SOLVED)
    minus, plus = discrete.momenta(h, q0, q1)
    np.testing.assert_array_equal((minus, plus), (-D1, D2))
    xi0, xi1 = np.arange(4.0), np.ones(4)
    np.testing.assert_allclose(
        discrete.momentum(h, q0, q1, xi0, xi1), (minus @ xi0, plus @ xi1), **near
    )
    mu, slope = own.mu(g), own.mu_v_q(g, f)
    np.testing.assert_allclose(discrete.constraint(h, q0, q1), mu @ f, **near)
    E1, E2 = discrete.constraint_derivatives(h, q0, q1)
    np.testing.assert_allclose(E1, (1 - beta) * slope - mu / h, **near)
    np.testing.assert_allclose(E2, beta * slope + mu / h, **near)


@pytest.mark.parametrize("beta", [0.0, 0.5, 0.8])
def test_step_against_numpy(own, beta):
    h, system = 0.05, own.system()
    q, v = system.q0, system.v0
    discrete = dal.Discrete(system, beta)
    expected_q, expected_v, expected = own.beta_step(beta, h, q, v)
    q_next, v_next, multipliers = discrete.advance(h, q, v)
    np.testing.assert_allclose(q_next, expected_q, atol=SOLVED)
    np.testing.assert_allclose(v_next, expected_v, atol=SOLVED)
    np.testing.assert_allclose(multipliers, expected, atol=SOLVED / h)
    assert own.residual(q_next, v_next) <= 4 * 4 * U
    q0, q1 = discrete.nodes(h, q, v)
    q2, on_nodes = discrete.step(h, q0, q1)
    np.testing.assert_allclose(q2, q1 + h * expected_v, atol=SOLVED)
    np.testing.assert_allclose(on_nodes, expected, atol=SOLVED / h**2)
    residual = discrete.residual(h, q0, q1, q2, on_nodes)
    assert residual.shape == (6,) and abs(residual).max() < SOLVED / h
    moved = discrete.residual(h, q0, q1, q2, on_nodes + 1) - residual
    np.testing.assert_allclose(moved[:4], h * own.mu(q1).sum(axis=0), atol=SOLVED)


def test_regularity(own, pair):
    h, (q0, q1) = 0.1, pair
    discrete = dal.Discrete(own.system(), 0.3)
    found = discrete.regularity(h, q0, q1)
    D12 = discrete.lagrangian_derivatives(h, q0, q1)[2]
    E2 = discrete.constraint_derivatives(h, q0, q1)[1]
    expected = np.block([[D12, own.mu(q0).T], [E2, np.zeros((2, 2))]])
    np.testing.assert_allclose(found.matrix, expected, rtol=SOLVED)
    sign, logarithm = np.linalg.slogdet(expected)
    assert found.sign == sign
    assert found.logarithm == pytest.approx(logarithm, abs=1e-11)
    expected[:, :4] *= h
    assert found.condition == pytest.approx(np.linalg.cond(expected), rel=1e-9)


def test_run_is_its_steps(own):
    system, h = own.system(), 0.05
    discrete = dal.Discrete(system, 0.5)
    q0, q1 = discrete.nodes(h, system.q0, system.v0)
    run = discrete.run(h, q0, q1, steps=20)
    assert run.nodes.shape == (22, 4) and run.multipliers.shape == (20, 2)
    for k in range(20):
        q2, multipliers = discrete.step(h, q0, q1)
        np.testing.assert_allclose(q2, run.nodes[k + 2], atol=20 * SOLVED)
        np.testing.assert_allclose(multipliers, run.multipliers[k], atol=20 * SOLVED / h)
        q0, q1 = q1, q2
    assert discrete.run(h, q0, q1, steps=0).nodes.shape == (2, 4)
    solution = dal.integrate(system, "midpoint", h=h, steps=21)
    for k in range(21):
        q, v = discrete.state(h, *run.nodes[k : k + 2])
        np.testing.assert_allclose(q, solution.q[k], atol=50 * SOLVED)
        np.testing.assert_allclose(v, solution.v[k], atol=50 * SOLVED)


def test_long_run_in_blocks(particle, monkeypatch):
    discrete = dal.Discrete(particle, 0.5)
    pair = discrete.nodes(0.01, particle.q0, particle.v0)
    whole = discrete.run(0.01, *pair, steps=100)
    monkeypatch.setattr("dalembert.geometry.most_in_a_call", lambda system: 7)
    blocks = discrete.run(0.01, *pair, steps=100)
    # A new block takes (q1 - q0)/h from the nodes: u |q|/h of v, and that over h of lambda.
    np.testing.assert_allclose(blocks.nodes, whole.nodes, atol=1e-12)
    np.testing.assert_allclose(blocks.multipliers, whole.multipliers, atol=1e-10)


def push(t, q, v):
    return [np.cos(3 * t)]


def test_time_goes_on_in_the_next_block(monkeypatch):
    """A force that depends on time, against its steps one by one."""
    monkeypatch.setattr("dalembert.geometry.most_in_a_call", lambda system: 7)
    discrete, h, t0 = dal.Discrete(dal.System(mass=[1.0], force=push)), 0.1, 0.4
    run = discrete.run(h, 0.0, 0.1, steps=20, t0=t0)
    for k in range(20):
        node, _ = discrete.step(h, *run.nodes[k : k + 2], t=t0 + k * h)
        np.testing.assert_allclose(run.nodes[k + 2], node, atol=1e-13)


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("beta", [0.0, 0.5])
def test_map_in_python(own, beta, given):
    """A map that is rho^beta, by functions: the same steps."""
    system, h = own.system(), 0.1
    rho, derivatives = beta_map(beta)
    map = dal.DifferenceMap(beta, map=rho, derivatives=derivatives if given else None)
    ours, theirs = dal.Discrete(system, map), dal.Discrete(system, beta)
    q, v = system.q0, system.v0
    # differenced derivatives are good to 1e-12 of 1/h
    tolerance = SOLVED if given else 1e-10
    for one, two in zip(ours.advance(h, q, v), theirs.advance(h, q, v)):
        np.testing.assert_allclose(one, two, atol=tolerance / h)
    pair = ours.nodes(h, q, v)
    np.testing.assert_allclose(pair, theirs.nodes(h, q, v), atol=SOLVED)
    for one, two in zip(
        ours.lagrangian_derivatives(h, *pair), theirs.lagrangian_derivatives(h, *pair)
    ):
        np.testing.assert_allclose(one, two, atol=1e-9 / h)


def test_bent_map_keeps_D_and_has_order_two(own):
    system = own.system()
    discrete = dal.Discrete(system, dal.DifferenceMap(map=bent, derivatives=bent_derivatives))
    errors = []
    for steps in (10, 20):
        q, v = system.q0, system.v0
        for _ in range(steps):
            q, v, _ = discrete.advance(0.5 / steps, q, v)
            assert own.residual(q, v) <= 4 * 4 * U
        end = dal.reference(system, t=0.5)
        errors.append(abs(np.concatenate([q - end.q, v - end.v])).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.15)


def test_exact_velocity_at_a_later_time():
    """x'' = cos 3 t: x(t0 + h) = x0 + v0 h - h sin(3 t0)/3 + (cos 3 t0 - cos 3 (t0 + h))/9."""
    t0, h, v = 0.7, 0.5, -0.3
    end = v * h - h * np.sin(3 * t0) / 3 + (np.cos(3 * t0) - np.cos(3 * (t0 + h))) / 9
    v0, _ = dal.exact_velocity(dal.System(mass=[1.0], force=push), h, 0.0, end, t0=t0)
    assert v0 == pytest.approx(v, abs=1e-11)


# ---- errors ----------------------------------------------------------------------------------


def test_exceptions_of_a_map_come_back(particle):
    def raises(h, q0, q1):
        raise KeyError("lost")

    with pytest.raises(KeyError, match="lost"):
        dal.Discrete(particle, dal.DifferenceMap(map=raises)).state(0.1, [0, 0, 0], [1, 1, 1])

    def outside(h, q0, q1):
        raise dal.DomainError("not there")

    with pytest.raises(dal.DomainError, match="not there"):
        dal.Discrete(particle, dal.DifferenceMap(map=outside)).lagrangian(0.1, [0] * 3, [1] * 3)


@pytest.mark.parametrize(
    ("map", "text"),
    [
        (lambda h, q0, q1: q0, r"map returned .*: expected 2 arrays of shape \(3,\)"),
        (lambda h, q0, q1: 1.0, r"map returned .*: expected 2 arrays of shape \(3,\)"),
        (lambda h, q0, q1: (q0, q1[:2]), r"map \(f\) returned shape .*: expected \(3,\)"),
        (lambda h, q0, q1: ("a", q1), r"map \(g\) returned no real numbers"),
    ],
)
def test_what_a_map_returns(particle, map, text):
    discrete = dal.Discrete(particle, dal.DifferenceMap(map=map))
    with pytest.raises(ValueError, match=text):
        discrete.state(0.1, [0, 0, 0], [1, 1, 1])


def test_what_derivatives_return(particle):
    def derivatives(h, q0, q1):
        return np.eye(3), np.eye(3), np.eye(2), np.eye(3)

    discrete = dal.Discrete(particle, dal.DifferenceMap(map=bent, derivatives=derivatives))
    with pytest.raises(ValueError, match=r"\(df/dq0\) returned shape .*: expected \(3, 3\)"):
        discrete.lagrangian_derivatives(0.1, [0, 0, 0], [1, 1, 1])
    nan = dal.DifferenceMap(map=lambda h, q0, q1: (q0, q1 * np.nan))
    with pytest.raises(dal.DomainError, match="difference map: f"):
        dal.Discrete(particle, nan).state(0.1, [0, 0, 0], [1, 1, 1])


def test_arguments(particle):
    discrete = dal.Discrete(particle)
    with pytest.raises(ValueError, match="h = 0"):
        discrete.state(0, [0, 0, 0], [1, 1, 1])
    with pytest.raises(ValueError, match="q1"):
        discrete.lagrangian(0.1, [0, 0, 0], [1, 1])
    with pytest.raises(ValueError, match=r"v\[1\] = nan"):
        discrete.advance(0.1, [0, 0, 0], [1, np.nan, 1])
    with pytest.raises(ValueError, match="multipliers"):
        discrete.residual(0.1, [0] * 3, [0] * 3, [0] * 3, [1, 2])
    with pytest.raises(ValueError, match="h = 1e-17 does not change the time t = 1.0"):
        discrete.run(1e-17, [0] * 3, [1] * 3, steps=1, t0=1)
    with pytest.raises(ValueError, match="steps = -1"):
        discrete.run(0.1, [0] * 3, [1] * 3, steps=-1)
    with pytest.raises(dal.NotOnConstraintError, match="the discrete constraint") as caught:
        discrete.run(0.1, [0, 1, 0], [1, 1, 0], steps=5)
    assert caught.value.step == 0
    for wrong in (1.5, "half", [0.5]):
        with pytest.raises(ValueError, match="constraint = "):
            dal.Discrete(particle, 0.5, wrong)
    with pytest.raises(ValueError, match="system = "):
        dal.Discrete("particle")
    with pytest.raises(ValueError, match=r"beta = -0.5"):
        dal.DifferenceMap(-0.5)
    with pytest.raises(ValueError, match="derivatives are given without map"):
        dal.DifferenceMap(derivatives=bent_derivatives)
    with pytest.raises(ValueError, match="map = 3"):
        dal.DifferenceMap(map=3)
    with pytest.raises(ValueError, match="h = 0"):
        dal.exact_velocity(particle, 0, [0] * 3, [1] * 3)


def test_a_failure_in_a_later_block_counts_all_steps(monkeypatch):
    monkeypatch.setattr("dalembert.geometry.most_in_a_call", lambda system: 7)
    wall = dal.System(mass=[1.0], potential=lambda q: 0.0, gradient=lambda q: q * np.log(-q) * 0)
    with np.errstate(invalid="ignore"), pytest.raises(dal.DomainError, match="gradient") as caught:
        dal.Discrete(wall, 0.0).run(0.1, -2.0, -1.9, steps=100)
    # -2 + 0.1 k is negative up to k = 19, where the gradient is asked for by the step to 20 or 21.
    assert caught.value.step in (18, 19, 20)


def test_failure_within_a_run(particle):
    calls = []

    def failing(h, q0, q1):
        calls.append(h)
        if len(calls) > 200:
            raise dal.DomainError("enough")
        return beta_map(0.5)[0](h, q0, q1)

    map = dal.DifferenceMap(map=failing, derivatives=beta_map(0.5)[1])
    discrete = dal.Discrete(particle, 0.5, map)
    pair = dal.Discrete(particle, 0.5).nodes(0.1, particle.q0, particle.v0)
    with pytest.raises(dal.DomainError, match="enough"):
        discrete.run(0.1, *pair, steps=1000)


# ---- as objects ------------------------------------------------------------------------------


def test_pickle_and_repr(own):
    discrete = dal.Discrete(
        own.system(), dal.DifferenceMap(map=bent, derivatives=bent_derivatives), 0.5
    )
    assert repr(discrete) == (
        "<Discrete own: <DifferenceMap beta = 0.5, map = bent>, <DifferenceMap beta = 0.5> for D_d>"
    )
    other = pickle.loads(pickle.dumps(discrete))
    assert other.maps[0].map is bent
    expected = discrete.lagrangian(0.1, own.q0, own.q0 + 0.1)
    assert other.lagrangian(0.1, own.q0, own.q0 + 0.1) == expected
    assert copy.deepcopy(discrete).lagrangian(0.1, own.q0, own.q0 + 0.1) == expected
    assert discrete.system.name == "own"


def test_threads_share_it(own):
    discrete = dal.Discrete(own.system(), 0.3)
    system = discrete.system
    expected = discrete.advance(0.1, system.q0, system.v0)
    found = []

    def work():
        for _ in range(50):
            found.append(discrete.advance(0.1, system.q0, system.v0))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 200
    for one in found:
        for a, b in zip(one, expected):
            np.testing.assert_array_equal(a, b)


def test_a_map_that_uses_its_own_discrete(particle):
    """A callback may come back to the object that called it."""
    seen = []

    def rho(h, q0, q1):
        if len(seen) < 3:
            seen.append(None)
            discrete.lagrangian(h, q0, q1)
        return beta_map(0.5)[0](h, q0, q1)

    discrete = dal.Discrete(particle, dal.DifferenceMap(map=rho))
    expected = dal.Discrete(particle, 0.5).lagrangian(0.1, [0, 1, 0], [0.1, 1, 0.1])
    assert discrete.lagrangian(0.1, [0, 1, 0], [0.1, 1, 0.1]) == pytest.approx(expected)
