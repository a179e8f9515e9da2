"""The geometry functions against formulas in NumPy, at one state and at stacked ones."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

import dalembert as dal
from conftest import KINDS, General, U, relative_residual
from dalembert import geometry

# Sums of at most 4 terms of size 1 to 10 and solves with condition below 100: 1e-13 is about
# 1000 u, far below any sign or factor.
TOLERANCE = 1e-13


def several(own, count=7):
    rng = np.random.default_rng(1)
    return own.q0 + 0.2 * rng.standard_normal((count, 4)), rng.standard_normal((count, 4))


def test_energy(own):
    q, v = several(own)
    expected = [w @ own.mass @ w / 2 + own.potential(p) for p, w in zip(q, v)]
    system = own.system()
    np.testing.assert_allclose(system.energy(q, v), expected, rtol=TOLERANCE)
    assert isinstance(system.energy(q[0], v[0]), float)
    assert system.energy(q[0], v[0]) == system.energy(q, v)[0]


def test_residual_on_D_and_on_its_deformation(own):
    q, v = several(own)
    system = own.system()
    for shift in (0.0, 0.05):
        mu = [own.mu(p - shift * w) for p, w in zip(q, v)]
        expected = np.array([a @ w for a, w in zip(mu, v)])
        moves = [
            abs(own.mu_v_q(p - shift * w, w))
            @ (abs(p - shift * w) + abs(shift * w)) * (shift > 0)
            for p, w in zip(q, v)
        ]
        relative = [
            relative_residual(own.mass, a, w, moves=b) for a, w, b in zip(mu, v, moves)
        ]
        np.testing.assert_allclose(system.residual(q, v, shift), expected, atol=TOLERANCE)
        np.testing.assert_allclose(system.relative_residual(q, v, shift), relative, rtol=TOLERANCE)
    assert system.residual(q[0], v[0]).shape == (2,)


def test_gram(own):
    q, _ = several(own)
    expected = [own.mu(p) @ np.linalg.solve(own.mass, own.mu(p).T) for p in q]
    np.testing.assert_allclose(own.system().gram(q), expected, rtol=TOLERANCE, atol=TOLERANCE)
    assert own.system().gram(q[0]).shape == (2, 2)


def test_multipliers_and_acceleration_off_D(own):
    q, v = several(own)
    system = own.system()
    a, lam = (np.array(x) for x in zip(*(own.acceleration(p, w) for p, w in zip(q, v))))
    np.testing.assert_allclose(system.multipliers(q, v), lam, rtol=TOLERANCE, atol=TOLERANCE)
    np.testing.assert_allclose(system.acceleration(q, v), a, rtol=TOLERANCE, atol=TOLERANCE)
    np.testing.assert_array_equal(system.field(q, v), np.hstack([v, system.acceleration(q, v)]))
    np.testing.assert_array_equal(system.multipliers(q[2], v[2]), system.multipliers(q, v)[2])


def test_project(own):
    q, v = several(own)
    system = own.system()
    expected = [own.project(p, w) for p, w in zip(q, v)]
    np.testing.assert_allclose(system.project(q, v), expected, rtol=TOLERANCE, atol=TOLERANCE)
    assert system.relative_residual(q, system.project(q, v)).max() <= 4 * 4 * U


def test_project_onto_the_deformation(own):
    q, v = several(own)
    system, shift = own.system(), 0.05
    w = system.project(q, v, shift)
    assert system.relative_residual(q, w, shift).max() <= 16 * 4 * U
    # Along M^-1 mu(q)^T: what is added lies in the span of mu(q)^T after multiplication with M.
    for p, difference in zip(q, (w - v) @ own.mass):
        mu = own.mu(p)
        kappa = np.linalg.lstsq(mu.T, difference, rcond=None)[0]
        np.testing.assert_allclose(mu.T @ kappa, difference, atol=TOLERANCE)


@pytest.mark.parametrize("keep", ["q1", ["q1"], [False, True, False, False]])
def test_consistent_keeps_components(own, keep):
    q, v = several(own)
    system = own.system()
    w = system.consistent(q, v, keep)
    np.testing.assert_array_equal(w[:, 1], v[:, 1])
    assert system.relative_residual(q, w).max() <= 4 * 4 * U
    # Nearest in the mass metric: the gradient M (w - v) is orthogonal to every direction in D_q
    # that leaves component 1 alone.
    for p, difference in zip(q, (w - v) @ own.mass):
        rows = np.vstack([own.mu(p), [0.0, 1.0, 0.0, 0.0]])
        directions = np.linalg.svd(rows)[2][3:]
        np.testing.assert_allclose(directions @ difference, 0.0, atol=TOLERANCE)


def test_consistent_with_too_much_kept(own):
    q, v = several(own, 1)
    with pytest.raises(dal.SingularError, match="keep fixes 4 of 4 velocities"):
        own.system().consistent(q[0], v[0], keep=["q0", "q1", "q2", "q3"])
    with pytest.raises(dal.SingularError, match="keep fixes 2 of 3 velocities") as caught:
        dal.systems.particle().consistent(np.zeros((3, 3)), np.ones((3, 3)), keep=["y", "z"])
    assert caught.value.step == 0


@pytest.mark.parametrize("kind", KINDS)
def test_consistent_in_many_ways(kind):
    """Names, places and truth values are one; bits are kept; D is reached to 4 n u."""
    system = General(kind).system()
    source = np.random.default_rng(3)
    curved = kind == "nonlinear"  # not every v has a consistent velocity nearby then
    for keep in (["x"], ["y", "x"], *([] if curved else ([], ["x", "z"]))):
        places = [system.coordinates.index(c) for c in keep]
        for size in (1e-3, 1.0, *([] if curved else [1e3])):
            q, v = source.uniform(-0.5, 0.5, (2, 4, 3))
            v *= size
            v[0, 0] = -0.0
            w = system.consistent(q, v, keep)
            assert w[:, places].tobytes() == v[:, places].tobytes()
            # a nonlinear equation is solved to the accuracy of its own terms
            assert system.relative_residual(q, w).max() <= 4 * 3 * U * (1 + curved)
            truth = [c in keep for c in system.coordinates]
            for same in (iter(keep), places, np.array(places, dtype=int), truth, np.array(truth)):
                np.testing.assert_array_equal(system.consistent(q, v, keep=same), w)
    if not curved:
        alone = system.consistent(q[0], v[0], keep=2)
        np.testing.assert_array_equal(alone, system.consistent(q[0], v[0], keep="z"))


@pytest.mark.parametrize(
    ("keep", "text"),
    [
        ("nowhere", "there is no coordinate 'nowhere'; choose from q0, q1, q2, q3"),
        (["q0", "nowhere"], "there is no coordinate 'nowhere'"),
        ("", "there is no coordinate ''"),
        ([True, False], "keep: expected 4 values True or False, got 2"),
        ([0, 1, 0, 0], "0 occurs twice; for a mask"),
        ([0, 4], "keep = 4: expected at most 3"),
        (-1, "keep = -1: expected at least 0"),
        (1.0, "keep = 1.0: expected names or indices of coordinates, or 4 values True"),
        ([None], "expected names or indices"),
        (b"q0", "expected names or indices"),
        ([True, 1], "expected names or indices"),
    ],
)
def test_keep_is_named_in_errors(own, keep, text):
    with pytest.raises(ValueError, match=re.escape(text)):
        own.system().consistent(own.q0, own.v0(), keep=keep)


def test_states_are_named_in_errors(own):
    system = own.system()
    for q, v, text in (
        ([0, 1], own.v0(), "q0: expected shape (4,) or (N, 4), got (2,)"),
        (own.q0, [own.v0()], "v0: expected shape (4,), as for q0, got (1, 4)"),
        (own.q0, [1, np.inf, 0, 0], "v0[1] = inf"),
    ):
        with pytest.raises(ValueError, match=re.escape(text)):
            system.consistent(q, v, keep="q1")


def test_functions_are_methods(own):
    q, v = several(own, 2)
    system = own.system()
    np.testing.assert_array_equal(dal.geometry.energy(system, q, v), system.energy(q, v))


def test_without_constraints():
    free = dal.System(mass=[2.0, 4.0], potential=lambda q: q @ q, gradient=lambda q: 2 * q, n=2)
    np.testing.assert_array_equal(free.acceleration([1, 2], [0, 0]), [-1.0, -1.0])
    assert free.multipliers([1, 2], [0, 0]).shape == (0,)
    assert free.residual([[1, 2]], [[0, 0]]).shape == (1, 0)
    assert free.relative_residual([1, 2], [3, 4]) == 0.0


def test_no_rows(own):
    nothing = np.empty((0, 4))
    assert own.system().energy(nothing, nothing).shape == (0,)
    assert own.system().acceleration(nothing, nothing).shape == (0, 4)


@pytest.mark.parametrize(
    "kind",
    [
        lambda a: a.tolist(),
        lambda a: np.asfortranarray(a),
        lambda a: np.repeat(a, 2, axis=1)[:, ::2],
        lambda a: a.astype(np.float32).astype(np.longdouble),
    ],
)
def test_any_array_like(own, kind):
    q, v = (np.round(64 * a) / 64 for a in several(own))  # exact in float32
    system = own.system()
    np.testing.assert_array_equal(system.energy(kind(q), kind(v)), system.energy(q, v))


def test_integers_and_read_only_arrays(particle):
    q, v = np.array([0, 1, 0]), np.array([1, 1, 1])
    q.flags.writeable = v.flags.writeable = False
    assert particle.multipliers(q, v) == pytest.approx([0.5], rel=4 * U)
    np.testing.assert_array_equal(particle.project(q, 3 * v), [3, 3, 3])


def test_inputs_are_not_changed(particle):
    q, v = np.array([0.0, 1.0, 0.0]), np.array([1.0, 1.0, 3.0])
    np.testing.assert_array_equal(particle.project(q, v), [2, 1, 2])
    np.testing.assert_array_equal(v, [1, 1, 3])


@pytest.mark.parametrize(
    ("q", "v", "text"),
    [
        ([0, 1], [1, 1, 1], r"q: expected shape \(3,\) or \(N, 3\), got \(2,\)"),
        ([0, 1, 0], [[1, 1, 1]], r"v: expected shape \(3,\), as for q, got \(1, 3\)"),
        ([0, np.nan, 0], [1, 1, 1], r"q\[1\] = nan"),
        ([0, 1, 0], [1, 1, np.inf], r"v\[2\] = inf"),
        ([0, 1j, 0], [1, 1, 1], "q: expected real numbers"),
        (["a", "b", "c"], [1, 1, 1], "q: expected real numbers"),
        ([[0, 1, 0], [1]], [1, 1, 1], "q: expected real numbers"),
    ],
)
def test_wrong_arguments_are_named(particle, q, v, text):
    with pytest.raises(ValueError, match=text):
        particle.energy(q, v)


def test_singular_forms_say_which_row():
    system = dal.System(mass=[1, 1], mu=lambda q: [[q[0], 0]], m=1)
    with pytest.raises(dal.SingularError) as caught:
        system.multipliers([[1, 0], [2, 0], [0, 0]], np.ones((3, 2)))
    assert caught.value.step == 2
    assert caught.value.status < 0


@pytest.mark.parametrize("sizes, most", [((3, 1), 2**14), ((15, 13), 191), ((160, 1), 1)])
def test_a_call_of_a_large_system_has_few_states(sizes, most):
    """(n + m)^3 operations for each of them, 4 million at most."""
    n, m = sizes
    assert geometry.most_in_a_call(SimpleNamespace(n=n, m=m)) == most
