"""Deformed constraints: against formulas in NumPy."""

import copy
import gc
import pickle
import re
import weakref

import numpy as np
import pytest

import dalembert as dal
from conftest import U, particle_derivative, particle_forms

# Solves with condition below 100 and sums of 4 terms of size 1 to 10: 1e-13 is about 1000 u.
TOLERANCE = 1e-13


class Mine(Exception):
    """An exception that the package does not know."""


def product(q, v):
    return [v[0] * v[1]]


def product_v(q, v):
    return [[v[1], v[0], 0.0]]


def product_q(q, v):
    return [[0.0, 0.0, 0.0]]


def with_product(system, delta, **changes):
    return system.deformed(product, delta, **{"g_v": product_v, "g_q": product_q, **changes})


class Bent:
    """A deformation of the system in R^4, nonlinear in v, with its derivatives."""

    delta = 0.3

    def g(self, q, v):
        return np.array(
            [np.sin(q[0]) * v[1] ** 2 + v[0] * v[2] * q[3], v[3] ** 2 / 2 + q[1] * v[0]]
        )

    def g_v(self, q, v):
        return np.array(
            [
                [v[2] * q[3], 2 * np.sin(q[0]) * v[1], v[0] * q[3], 0.0],
                [q[1], 0.0, 0.0, v[3]],
            ]
        )

    def g_q(self, q, v):
        return np.array([[np.cos(q[0]) * v[1] ** 2, 0.0, 0.0, v[0] * v[2]], [0.0, v[0], 0.0, 0.0]])

    def of(self, base, **changes):
        derivatives = {"g_v": self.g_v, "g_q": self.g_q}
        return base.deformed(self.g, self.delta, **{**derivatives, **changes})


@pytest.fixture
def bent():
    return Bent()


def several(own, system, count=5):
    """Return states of D_delta."""
    rng = np.random.default_rng(3)
    q = own.q0 + 0.1 * rng.standard_normal((count, 4))
    return q, system.project(q, own.v0() + 0.1 * rng.standard_normal((count, 4)))


# ---- formulas ----------------------------------------------------------------------------


def test_formulas(own, bent):
    """lambda_delta and vdot from the saddle point system of phi + delta g."""
    system = bent.of(own.system())
    q, v = several(own, system)
    for p, w in zip(q, v):
        phi_v = own.mu(p) + bent.delta * bent.g_v(p, w)
        phi_q = own.mu_v_q(p, w) + bent.delta * bent.g_q(p, w)
        saddle = np.block([[own.mass, -phi_v.T], [phi_v, np.zeros((2, 2))]])
        x = np.linalg.solve(saddle, np.concatenate([-own.gradient(p), -phi_q @ w]))
        close = {"rtol": TOLERANCE, "atol": TOLERANCE}
        np.testing.assert_allclose(system.acceleration(p, w), x[:4], **close)
        np.testing.assert_allclose(system.multipliers(p, w), x[4:], **close)
        gram = phi_v @ np.linalg.solve(own.mass, phi_v.T)
        np.testing.assert_allclose(system.gram(p, w), gram, **close)
        residual = own.mu(p) @ w + bent.delta * bent.g(p, w)
        np.testing.assert_allclose(system.residual(p, w), residual, rtol=0, atol=TOLERANCE)
        np.testing.assert_allclose(system.power(p, w)[0], x[4:] @ phi_v @ w, **close)
        assert abs(system.power(p, w)[0]) > 1e-4


def test_the_check_examines_the_derivatives(own, bent):
    base = own.system()
    q, v = (x[0] for x in several(own, bent.of(base), 1))
    assert bent.of(base).check(q, v), bent.of(base).check(q, v).text
    for name in ("g_v", "g_q"):
        wrong = bent.of(base, **{name: lambda q, v, name=name: 1.1 * getattr(bent, name)(q, v)})
        found = wrong.check(q, v)
        assert not found and f"constraint_{name[-1]}" in found.text
    without = bent.of(base, g_q=None)
    assert without.check(q, v) and without.differenced == ("constraint_q",)
    # By central differences: the header says 1e-12 of quantities of size 1 to 10.
    np.testing.assert_allclose(
        without.multipliers(q, v), bent.of(base).multipliers(q, v), rtol=0, atol=1e-10
    )


def test_what_is_taken_over(own, bent, particle):
    system = with_product(particle, 0.1)
    assert (system.n, system.m, system.kind) == (3, 1, "nonlinear")
    assert system.coordinates == particle.coordinates
    assert system.name == "particle_deformed"
    np.testing.assert_array_equal(system.mass, particle.mass)
    assert system.q0 is None and system.invariants == () and not system.has_exact
    assert "nonlinear" in repr(system)
    q, v = several(own, bent.of(own.system()), 1)
    np.testing.assert_array_equal(bent.of(own.system()).energy(q, v), own.system().energy(q, v))
    np.testing.assert_array_equal(
        with_product(particle, 0.0).field(q[0, :3], v[0, :3]),
        particle.field(q[0, :3], v[0, :3]),
    )


# ---- kept nodes ----------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["midpoint-nodes", "explicit-nodes"])
def test_kept_nodes_stay_in_it(own, scheme):
    h, record = 0.05, dal.Scheme.find(scheme)
    base = own.system()
    system = base.at_kept_nodes(record.shift(h))
    run = dal.integrate(base, record, h=h, steps=100, initial="shift")
    np.testing.assert_array_equal(
        system.residual(run.q, run.v), base.residual(run.q, run.v, record.shift(h))
    )
    assert system.relative_residual(run.q, run.v).max() <= 4 * 4 * U
    assert base.relative_residual(run.q, run.v).max() > 1e-3
    found = system.check(run.q[-1], run.v[-1])
    assert found and found.kind == "nonlinear", found.text


# ---- as objects ----------------------------------------------------------------------------


def test_the_handle_keeps_the_base():
    """What C holds is the handle: with it the base lives, and with it it goes."""
    for deform in (lambda base: with_product(base, 0.1), lambda base: base.at_kept_nodes(0.1)):
        base = dal.System(
            mass=[1, 1, 1], mu=particle_forms, mu_v_q=particle_derivative
        )
        alive, handle = weakref.ref(base), deform(base)._handle
        del base
        gc.collect()
        assert alive() is not None
        del handle
        gc.collect()
        assert alive() is None


def test_pickle():
    base = dal.System(
        mass=[1, 1, 1], mu=particle_forms, mu_v_q=particle_derivative
    )
    q, v = [0.5, 0.3, -0.2], [1.0, 0.7, 0.265]
    for system in (
        with_product(dal.systems.particle(), 0.05),
        with_product(base, 0.05),
        base.at_kept_nodes(0.1),
        with_product(dal.systems.particle().at_kept_nodes(0.1), 0.2),
    ):
        again = pickle.loads(pickle.dumps(system))
        np.testing.assert_array_equal(again.field(q, v), system.field(q, v))
        assert (again.name, again.kind) == (system.name, system.kind)
        assert copy.deepcopy(system) is system


def test_pickle_of_a_lambda_says_which(particle):
    system = particle.deformed(product, 0.1, g_v=lambda q, v: product_v(q, v), g_q=product_q)
    with pytest.raises(pickle.PicklingError, match="'particle_deformed'.*its g_v = <function"):
        pickle.dumps(system)
    local = dal.System(mass=[1, 1, 1], mu=lambda q: [[-q[1], 0, 1]], name="local")
    with pytest.raises(pickle.PicklingError, match="'local'.*mu"):
        pickle.dumps(with_product(local, 0.1))


# ---- what may go wrong ---------------------------------------------------------------------


def use(system, own):
    """Make the core ask for every output of every function."""
    q, v = own.q0, own.v0()
    system.field(q, v)
    return system.check(q, v)


@pytest.mark.parametrize("name", ["g", "g_v", "g_q"])
def test_exceptions_come_back_as_themselves(own, bent, name):
    error = Mine(name)

    def failing(q, v):
        raise error

    functions = {"g": bent.g, "g_v": bent.g_v, "g_q": bent.g_q, name: failing}
    with pytest.raises(Mine) as caught:
        use(own.system().deformed(functions.pop("g"), 0.3, **functions), own)
    assert caught.value is error


@pytest.mark.parametrize("name", ["mu", "mu_v_q", "gradient"])
def test_exceptions_of_the_base_come_back(own, bent, name):
    error = Mine(name)

    def failing(*arguments):
        raise error

    base = own.system(**{name: failing}, m=2)
    for system in (bent.of(base), base.at_kept_nodes(0.1)):
        with pytest.raises(Mine) as caught:
            system.field(own.q0, own.v0())
        assert caught.value is error


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("g", np.ones(3), r"g returned shape \(3,\): expected \(2,\)"),
        ("g", 1.0, r"g returned shape \(\): expected \(2,\)"),
        ("g_v", np.ones((4, 2)), r"g_v returned shape \(4, 2\): expected \(2, 4\)"),
        ("g_q", None, r"g_q returned no real numbers .* shape \(2, 4\)"),
    ],
)
def test_wrong_shapes_name_the_function(own, bent, name, value, text):
    functions = {"g": bent.g, "g_v": bent.g_v, "g_q": bent.g_q, name: lambda q, v: value}
    with pytest.raises(ValueError, match=text):
        use(own.system().deformed(functions.pop("g"), 0.3, **functions), own)


def test_what_is_not_finite_is_a_domain_error(own, bent):
    system = bent.of(own.system(), g_v=lambda q, v: np.full((2, 4), np.nan))
    with pytest.raises(dal.DomainError, match="constraint_v"):
        system.field(own.q0, own.v0())


def test_arguments_are_read_only(own, bent):
    def write(q, v):
        v[0] = 0.0

    with pytest.raises(ValueError, match="read-only"):
        own.system().deformed(write, 0.3, g_v=bent.g_v).residual(own.q0, own.v0())


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"g": None}, r"g\(q, v\) and g_v\(q, v\) -> dg/dv: expected both"),
        ({"g_v": None}, r"g\(q, v\) and g_v\(q, v\)"),
        ({"g": 5}, "g = 5: expected a function"),
        ({"g_v": "x"}, "g_v = 'x': expected a function"),
        ({"g_q": 5}, "g_q = 5: expected a function"),
        ({"delta": np.nan}, "delta = nan: expected a finite number"),
        ({"delta": "x"}, "delta = 'x'"),
        ({"kind": "cubic"}, "kind = 'cubic': expected one of 'linear', 'affine', 'nonlinear'"),
        ({"kind": 2}, "kind = 2"),
    ],
)
def test_wrong_arguments_are_named(particle, arguments, text):
    given = {"g": product, "delta": 0.1, "g_v": product_v, **arguments}
    with pytest.raises(ValueError, match="^" + text):
        particle.deformed(given.pop("g"), given.pop("delta"), **given)


def test_refused(own, bent, particle):
    system = bent.of(own.system())
    with pytest.raises(ValueError, match="kind = 'linear': expected at least nonlinear"):
        bent.of(system, kind="linear")
    free = dal.System(mass=[1, 1])
    with pytest.raises(ValueError, match="no constraints"):
        free.deformed(product, 0.1, g_v=product_v)
    with pytest.raises(ValueError, match="no constraints"):
        free.at_kept_nodes(0.1)
    for shift in (np.inf, None, [1.0]):
        with pytest.raises(ValueError, match=re.escape(f"shift = {shift!r}")):
            particle.at_kept_nodes(shift)
    bare = own.system(mu_v_q=None)
    with pytest.raises(ValueError, match="^mu_v_q is missing.*'own'"):
        bare.at_kept_nodes(0.1)
    bare = dal.System(
        mass=[1, 1], constraint=lambda q, v: [v[0]], constraint_v=lambda q, v: [[1, 0]]
    )
    with pytest.raises(ValueError, match="^constraint_q is missing"):
        bare.at_kept_nodes(0.1)
