"""The families of schemes beside beta: pairs of maps, the reference flow, and one of a user's."""

import os
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dalembert as dal
from dalembert import cli

HEUN = Path(dal.__file__).resolve().parents[2] / "tests" / "family_heun.so"


def stepped(system, maps, h, steps):
    """The states of the velocity integrator, one `Discrete.advance` after the other."""
    discrete = dal.Discrete(system, *maps)
    states = [(system.q0, system.v0)]
    for k in range(steps):
        q, v, _ = discrete.advance(h, *states[-1], t=k * h)
        states.append((q, v))
    return np.array(states).reshape(steps + 1, -1)


def bent(strength):
    """rho^(1/2), its point moved across by the chord: of order 1, and not rho^beta of any beta."""
    turn = strength * np.array(
        [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, -1], [0, 0, 1, 0]], dtype=float
    )
    return dal.DifferenceMap(
        map=lambda h, q0, q1: ((q0 + q1) / 2 + h * turn @ (q1 - q0), (q1 - q0) / h)
    )


@pytest.mark.parametrize("betas", [(0.25, 0.5), (0.5, 0.0), (1.0, 0.75), (0.5, 0.5)])
@pytest.mark.parametrize("name", ["robot", "sleigh_contact"])
def test_pair_makes_the_steps_of_the_discrete_mechanics(name, betas):
    system, h = dal.systems.get(name), 0.05
    run = dal.integrate(system, dal.Scheme.pair(*betas), h=h, steps=20)
    again = dal.integrate(system, f"pair:{betas[0]}:{betas[1]}", h=h, steps=20)
    expected = stepped(system, betas, h, 20)
    np.testing.assert_allclose(run.x, expected, rtol=0, atol=1e-12 * abs(expected).max())
    np.testing.assert_array_equal(run.x, again.x)
    assert run.residual.max() <= 4 * system.n * 2.0**-53
    assert not np.array_equal(run.x, dal.integrate(system, 0.3, h=h, steps=20).x)


@pytest.mark.parametrize("betas", [(1 / 3, 2 / 3), (0.35000000000000003, 0.15000000000000002)])
def test_pair_of_numbers_with_many_digits(betas):
    system, scheme = dal.systems.robot(), dal.Scheme.pair(*betas)
    run = dal.integrate(system, scheme, h=0.05, steps=20)
    expected = stepped(system, betas, 0.05, 20)
    np.testing.assert_allclose(run.x, expected, rtol=0, atol=1e-12 * abs(expected).max())
    assert scheme.name.startswith(f"pair:{betas[0]:.10g}") and pickle.loads(pickle.dumps(scheme))
    near = dal.integrate(system, dal.Scheme.pair(*(x + 1e-9 for x in betas)), h=0.05, steps=20)
    assert 1e-12 < abs(near.x - run.x).max() < 1e-7


def test_pair_of_a_map_of_the_users_own(own):
    system, maps = own.system(), (bent(0.3), 0.5)
    run = dal.integrate(system, dal.Scheme.pair(*maps), own.q0, own.v0(), h=0.02, steps=10)
    discrete, x = dal.Discrete(system, *maps), run.x[0]
    for k in range(10):
        q, v, _ = discrete.advance(0.02, x[:4], x[4:], t=0.02 * k)
        x = np.concatenate([q, v])
        np.testing.assert_allclose(run.x[k + 1], x, rtol=0, atol=1e-12)
    plain = dal.integrate(system, dal.Scheme.pair(0.5), own.q0, own.v0(), h=0.02, steps=10)
    assert abs(run.x - plain.x).max() > 1e-6


def test_reference_does_not_depend_on_what_is_stored():
    system = dal.systems.sleigh()
    every = dal.integrate(system, "reference", h=0.5, steps=20)
    some = dal.integrate(system, "reference", h=0.5, steps=20, stride=5)
    np.testing.assert_array_equal(some.x, every.x[::5])
    assert every.residual.max() <= 4 * system.n * 2.0**-53


@pytest.mark.parametrize("method", ["rk8pd", "rodas"])
def test_reference_at_rest_beside_a_wall(method):
    """Pushed from t = 1/2 on: too long a step leads behind the wall, and the motion does not."""

    def gradient(q):
        if q[0] > 0.1:
            raise dal.DomainError("wall")
        return np.zeros(3)

    system = dal.System(
        mass=[1, 1, 1], mu=lambda q: [[-q[1], 0, 1]], gradient=gradient,
        potential=lambda q: 0.0, force=lambda t, q, v: [10.0 * (t > 0.5), 0, 0],
    )  # fmt: skip
    flow = dal.Scheme.flow(method, 1e-9)
    run = dal.integrate(system, flow, [0, 0, 0], [0, 0, 0], h=0.6, steps=1)
    assert abs(run.q[-1] - [0.05, 0, 0]).max() < 1e-6  # 10 (0.1)^2/2
    with pytest.raises(dal.DomainError, match="wall"):
        dal.integrate(system, flow, [0, 0, 0], [0, 0, 0], h=0.7, steps=1)


@pytest.mark.parametrize("method", ["rk8pd", "msadams", "rodas"])
@pytest.mark.parametrize("raises", [False, True])
def test_reference_says_where_the_field_ends(method, raises):
    """x = sin t, as far as x = 0.7."""

    def gradient(q):
        if raises and q[0] > 0.7:
            raise dal.DomainError("outside")
        return q if q[0] <= 0.7 else q * np.nan

    system = dal.System(mass=[1], potential=lambda q: q[0] ** 2 / 2, gradient=gradient, n=1, m=0)
    for call, given in ((dal.integrate, {"scheme": "reference", "h": 5, "steps": 1}),
                        (dal.reference, {"t": 5})):  # fmt: skip
        with pytest.raises(dal.DomainError) as caught:
            call(system, q0=[0], v0=[1], method=method, **given)
        text = "\n".join([str(caught.value), *getattr(caught.value, "__notes__", [])])
        t = float(re.search("cannot integrate beyond t = ([^:]*):", text)[1])
        assert abs(t - np.arcsin(0.7)) < 1e-4
        assert ("outside" if raises else "gradient[0] = nan") in text


@pytest.mark.parametrize("method", ["rk8pd", "msadams", "rodas"])
def test_reference_of_a_coordinate_of_1e30(method):
    """x = 1e30 cos t, y = sin 2 t."""
    springs = dal.System(
        mass=[1, 1], potential=lambda q: q[0] ** 2 / 2 + 2 * q[1] ** 2, n=2, m=0,
        gradient=lambda q: q * [1, 4], hessian=lambda q: np.diag([1, 4]),
    )  # fmt: skip
    flow = dal.Scheme.flow(method, 1e-9)
    run = dal.integrate(springs, flow, [1e30, 0], [0, 2], h=3, steps=1)
    assert run.stats.evaluations < 2e4
    np.testing.assert_allclose(run.q[-1], [1e30 * np.cos(3), np.sin(6)], rtol=1e-6)


@pytest.mark.parametrize("method", ["rk8pd", "msadams"])
def test_reference_of_a_disc_that_falls_nearly_flat(method):
    """There the roundoff of its field is 1e10 times the tolerance."""
    disc = dal.systems.rolling_disc()
    run = dal.integrate(
        disc, "reference", [0, 0, 0.3, 0.6345, 0], [0, 0, -0.00362, 0.163, 0], h=0.8, steps=1,
        consistent="project", method=method,
    )  # fmt: skip
    assert run.stats.evaluations < 1e5
    assert abs(run.energy - run.energy[0]).max() < 1e-7


def test_flow_has_a_method_and_a_tolerance():
    system = dal.systems.sleigh()
    best = dal.integrate(system, "reference", h=1.0, steps=5).x
    rough = dal.integrate(system, dal.Scheme.flow("rk8pd", 1e-4), h=1.0, steps=5).x
    assert 1e-13 < abs(rough - best).max() < 1e-2
    other = dal.integrate(system, dal.Scheme.flow("msadams", 1e-12), h=1.0, steps=5).x
    np.testing.assert_allclose(other, best, rtol=0, atol=1e-9)
    given = dal.integrate(system, "reference", h=1.0, steps=5, tolerance=1e-4).x
    np.testing.assert_array_equal(given, rough)
    with pytest.raises(ValueError, match="tolerance = 1e-05: the scheme already has"):
        dal.integrate(system, dal.Scheme.flow(tolerance=1e-4), h=1.0, steps=5, tolerance=1e-5)
    with pytest.raises(ValueError, match="method = 'euler'"):
        dal.Scheme.flow("euler")
    with pytest.raises(ValueError, match="tolerance = -1"):
        dal.Scheme.flow(tolerance=-1)


def test_schemes_pickle_with_what_they_carry():
    library = dal.Scheme.from_library(str(HEUN), "heun_scheme")
    work = Work(dal.Scheme.pair(0.25, 0.5), dal.Scheme.flow("rk8pd", 1e-6), library)
    code = "import pickle, sys; print(pickle.load(sys.stdin.buffer)())"
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    there = subprocess.run(
        [sys.executable, "-c", code], input=pickle.dumps(work), env=env, cwd="/",
        capture_output=True, check=True,
    )  # fmt: skip
    assert there.stdout.decode().strip() == work()


class Work:
    """Runs that another process makes; it returns their bits."""

    def __init__(self, *schemes):
        self.schemes = schemes

    def __call__(self):
        runs = (dal.integrate(dal.systems.disk(), x, h=0.1, steps=5) for x in self.schemes)
        return " ".join(run.x.tobytes().hex() for run in runs)


# ---- a family that a user wrote, in a shared library ---------------------------------------


def heun(system, x, h):
    """Heun's method on the ODE on D, and the projection of its result onto D."""

    def field(y):
        return np.concatenate([y[system.n :], system.acceleration(y[: system.n], y[system.n :])])

    before = field(x)
    y = x + h / 2 * (before + field(x + h * before))
    return np.concatenate([y[: system.n], system.project(y[: system.n], y[system.n :])])


def test_family_of_a_library():
    system = dal.systems.sleigh()
    run = dal.integrate(system, f"{HEUN}:heun_scheme", h=0.05, steps=20)
    x = np.concatenate([system.q0, system.v0])
    for k in range(20):
        x = heun(system, x, 0.05)
        np.testing.assert_allclose(run.x[k + 1], x, rtol=0, atol=1e-12 * abs(x).max())
    assert run.residual.max() <= 4 * system.n * 2.0**-53
    assert np.isnan(run.reactions).all()
    assert run.scheme.family == "heun"


def test_study_of_a_library_s_family():
    study = dal.convergence(dal.systems.disk(), f"{HEUN}:heun_scheme", t_end=1)
    assert study.holds and abs(study.p - 2) < 0.2


def test_command_line_takes_a_library(capsys):
    words = ["run", "disk", "--scheme", f"{HEUN}:heun_scheme", "--h", "0.1", "--steps", "5"]
    assert cli.main(words) == 0
    assert "heun" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nowhere.so:heun_scheme", "nowhere.so"),
        (f"{HEUN}:other_scheme", "other_scheme"),
        ("pair:0.25", "there is no scheme"),
        ("pair:0.25:1.5", "there is no scheme"),
    ],
)
def test_what_is_not_there_is_named(name, words):
    with pytest.raises(ValueError, match=words):
        dal.integrate(dal.systems.disk(), name, h=0.1, steps=1)
