"""Which entries a model's step routine leaves out: zero at every point, and the others not."""

import numpy as np
import pytest
import sympy
from sympy import cos, sin

import dalembert as dal
from dalembert.symbolic.given import make_model
from dalembert.symbolic.pattern import pattern


def model(L, constraints, q, parameters=None):
    return make_model(L, constraints, list(q), parameters)[0]


def coupled():
    """M has the blocks {x, theta}, {y}, {z}; V pulls y only; theta turns mu, and is pushed by x."""
    x, y, z, theta = q = dal.coordinates("x y z theta")
    L = x.d**2 + y.d**2 + z.d**2 + theta.d**2 + x.d * theta.d / 2 - y**2
    return model(L, [cos(theta) * x.d + sin(theta) * z.d], q)


def blade():
    x, y, theta = q = dal.coordinates("x y theta")
    return model(x.d**2 + y.d**2 + theta.d**2 + 3 * x, [sin(theta) * x.d - cos(theta) * y.d], q)


def sleigh():
    x, y, theta = q = dal.coordinates("x y theta")
    L = x.d**2 + y.d**2 + theta.d**2
    return model(L, [sin(theta) * x.d - cos(theta) * y.d + theta.d], q)


def chain():
    """M couples neighbours: its inverse is full."""
    q = dal.coordinates("a b c d")
    L = sum(x.d**2 for x in q) + sum(x.d * y.d for x, y in zip(q, q[1:])) / 3
    return model(L, [q[0].d + q[1] * q[2].d], q)


@pytest.mark.parametrize("make", [coupled, blade, sleigh, chain])
def test_entries(make):
    """Against the matrices in numbers, at three points."""
    found, of = pattern(make()), make()
    n = of.n
    outputs = dict(of.derived.function("constraint").outputs)
    matrices = {"inverse": np.zeros((n, n)), "mu": 0, "Z": 0, "N": 0}
    source = np.random.default_rng(3)
    inverse = np.linalg.inv(np.array(of.derived.mass, dtype=float).reshape(n, n))
    for _ in range(3):
        at = {s.name: x for s, x in zip((*of.q, *of.v), source.uniform(0.2, 1.2, 2 * n))}

        def numbers(name):
            values = [sympy.sympify(e).subs(at) for e in outputs[name]]
            return np.array(values, dtype=float).reshape(-1, n)

        mu = numbers("phi_v")
        for name, A in (("inverse", inverse), ("mu", mu), ("Z", mu @ inverse),
                        ("N", numbers("phi_q"))):  # fmt: skip
            matrices[name] = matrices[name] + (np.abs(A) > 1e-12)
    for name, often in matrices.items():
        assert getattr(found, name) == (often > 0).tolist(), name


def test_pull_and_steady():
    assert pattern(coupled()).pull == [[True, True, True, True]]
    assert pattern(blade()).pull == [[True, True, False]]  # V pulls x, the reaction both
    assert pattern(blade()).steady
    assert not pattern(coupled()).steady
    assert not pattern(sleigh()).steady


def test_what_v_pushes():
    assert pattern(blade()).kick == [[True, False, False]]
    assert pattern(coupled()).kick == [[False, True, False, False]]
    assert pattern(sleigh()).kick == [[False] * 3]
    x, y, theta = q = dal.coordinates("x y theta")
    L, row = x.d**2 + x.d * y.d + y.d**2 + theta.d**2, sin(theta) * x.d - cos(theta) * y.d
    assert pattern(model(L - x, [row], q)).kick == [[True, True, False]]  # through M
    assert pattern(blade()).apart
    turned = pattern(model(L - theta**2, [row], q))  # V turns the blade
    assert turned.steady and not turned.apart
    assert not pattern(sleigh()).apart  # nothing pushes theta but the reaction


def test_masses_of_one():
    x, y, z, theta = q = dal.coordinates("x y z theta")
    m = sympy.Symbol("m")
    T = (x.d**2 + y.d**2 + m * z.d**2 + theta.d**2 + x.d * theta.d) / 2
    # x and theta are coupled, and the mass of z may be another tomorrow
    found = pattern(model(T, [z.d - y * x.d], q, {m: 1}))
    assert found.one == [[False, True, False, False]]


def test_initializer():
    text = "{0x111ULL, 0x3ULL, 0x3ULL, 0x4ULL, 0x3ULL, 0x1ULL, 0x0ULL"
    assert pattern(blade()).initializer() == text + ", 0x0ULL" * 4 + "}"
    q = dal.coordinates("a b c d e f g h i")
    large = pattern(model(sum(x.d**2 for x in q), [q[0].d - q[1] * q[2].d], q))
    assert large.initializer() is None  # 81 entries do not fit into a word
    assert large.steady
