"""The systems that are written in SymPy, against equations of motion that are reduced by hand."""

import importlib.util
import os
import subprocess
import sys

import numpy as np
import pytest
from conftest import U
from mpmath import cos, sin, tan

import dalembert as dal
from dalembert import catalogue

NAMES = dal.systems.names_in_sympy()


# ---- the motion, reduced by hand -----------------------------------------------------------------
#
# Each function takes the parameters and a state (q, v) of D, and returns the velocity in D and the
# acceleration.  u is the speed along the heading.


def steered_car(p, q, v):
    """m u^2 + J theta'^2 = (m + J tan(phi)^2/l^2) u^2 is constant."""
    theta, phi = q[2:]
    turn, steer = v[2:]
    u = cos(theta) * v[0] + sin(theta) * v[1]
    slope = (1 + tan(phi) ** 2) * steer
    du = -p["J"] * tan(phi) * slope * u / (p["m"] * p["l"] ** 2 + p["J"] * tan(phi) ** 2)
    dturn = (du * tan(phi) + u * slope) / p["l"]
    return [*along(theta, u, turn, du), dturn, -dturn]


def roller_racer(p, q, v):
    """The second axle pulls with force f: m u' = -f sin phi, J theta'' = f d1 cos phi, ..."""
    theta, phi = q[2:]
    turn, swing = v[2:]
    m, J, K, d1, d2 = (p[key] for key in ("m", "J", "K", "d1", "d2"))
    s, c = sin(phi), cos(phi)
    u = cos(theta) * v[0] + sin(theta) * v[1]
    f = (u * c + d1 * s * turn) * swing / (s**2 / m + (d1 * c) ** 2 / J + d2**2 / K)
    dturn = f * d1 * c / J
    return [*along(theta, u, turn, -f * s / m), dturn, f * d2 / K - dturn]


def two_wheeled_robot(p, q, v):
    m, a, b, r = (p[key] for key in ("m", "a", "b", "r"))
    A, B = m + 2 * p["I"] / r**2, p["J"] + m * a**2 + 2 * p["I"] * b**2 / r**2
    theta, turn = q[2], v[2]
    u = cos(theta) * v[0] + sin(theta) * v[1]
    du, dturn = m * a * turn**2 / A, -m * a * u * turn / B
    return [*along(theta, u, turn, du), dturn, (du + b * dturn) / r, (du - b * dturn) / r]


def cvt(p, q, v):
    x, y, z = q
    ddz = (x * y - z - y * v[1] * v[2]) / (1 + y**2)
    return [-v[1] * v[2] - y * ddz, -y - 3 * p["c"] * y**2, ddz]


def sleigh_with_rotor(p, q, v):
    """The spring turns the sleigh, whose speed u' = a theta'^2 is that of the blade."""
    m, J, a, K, k = (p[key] for key in ("m", "J", "a", "K", "k"))
    theta, psi = q[2:]
    turn = v[2]
    s, c = sin(theta), cos(theta)
    u = c * v[0] + s * v[1]
    du, dturn = a * turn**2, (k * psi - m * a * u * turn) / (J + m * a**2)
    x, y = along(theta, u, turn, du)
    x += -a * (dturn * s + turn**2 * c)
    y += a * (dturn * c - turn**2 * s)
    return [x, y, dturn, -k * psi / K - dturn]


def disguised(p, q, v):
    """On the paraboloid x + |z|^2/2 = const, with x'' from its second derivative."""
    x, y, z, dz = q[0], q[1:4], q[4:], v[4:]
    slope = [c * (1 + b**2) for b, c in zip(y, z)]
    slope[0] += z[0] * z[1] ** 2
    slope[1] += z[1] * z[0] ** 2
    square = sum(c**2 for c in z)
    work = sum(c * d for c, d in zip(z, slope))
    ddx = (work - sum(d**2 for d in dz) - x * square) / (1 + square)
    return [
        ddx,
        *(-b * (1 + c**2) for b, c in zip(y, z)),
        *((ddx + x) * c - d for c, d in zip(z, slope)),
    ]


def along(theta, u, turn, du):
    """Return the acceleration of a point that moves along the heading."""
    return [du * cos(theta) - u * turn * sin(theta), du * sin(theta) + u * turn * cos(theta)]


REDUCED = {f.__name__: f for f in (
    steered_car, roller_racer, two_wheeled_robot, cvt, sleigh_with_rotor, disguised,
)}  # fmt: skip

# q at t = 1 from the default data: the equations above by Taylor series of mpmath with 30 digits.
REFERENCE = {
    "steered_car": [
        "0.75409824933650350318", "0.52860906645149633602", "1.1026926469644799718",
        "0.51597985225476649431",
    ],
    "roller_racer": [
        "0.88258626173339106653", "0.28237207141979522004", "0.71878108049376619858",
        "0.88993027125554877340",
    ],
    "two_wheeled_robot": [
        "0.14448846766361989807", "0.14915093705139771323", "1.2677885868361911589",
        "5.0630383647487676615", "-0.74369315626837929199",
    ],
    "cvt": ["0.93726646560226397886", "0.21430180336820884176", "0.17518534504306869711"],
    "sleigh_with_rotor": [
        "-0.025834646157570034570", "0.56807522979142530232", "1.2894588126805353303",
        "-0.19220725992054710205",
    ],
    "disguised": [
        "1.1910733863595522562", "0.36333844745037294001", "0.072002210461911528232",
        "0.025625590420168557271", "0.62501703093763897266", "0.75628923474871561961",
        "1.2387973092051067341",
    ],
}  # fmt: skip


def make(name):
    return dal.systems.get(name)


# ---- each system -------------------------------------------------------------------------------


def test_every_system_is_here():
    assert set(REDUCED) == set(REFERENCE) == set(NAMES) == set(catalogue.__all__)
    assert len(NAMES) + len(dal.systems.names()) >= 21
    assert not set(NAMES) & set(dal.systems.names())


@pytest.mark.parametrize("name", NAMES)
def test_describes_itself(name):
    system = make(name)
    function = getattr(dal.systems, name)
    assert system.name == name == function.__name__ and name in dir(dal.systems)
    about = {key: getattr(system, key) for key in ("help", "description", "source")}
    assert about == catalogue.about(name) and all(about.values())
    assert system.help in function.__doc__
    assert f"Coordinates {', '.join(system.coordinates)}" in function.__doc__
    assert all(key in function.__doc__ for key in system.parameters)
    assert system.relative_residual(system.q0, system.v0) <= 64 * U
    assert make(name.replace("_", "-")).parameters == system.parameters


@pytest.mark.parametrize("name", NAMES)
def test_acceleration(name):
    """Against the reduced equations, at three states with other parameters.

    Both are sums of about 10 terms, and the linear system has a condition below 100: 1e-12.
    """
    source = np.random.default_rng(3)
    default = make(name)
    for _ in range(3):
        changed = {key: x * source.uniform(0.7, 1.4) for key, x in default.parameters.items()}
        system = dal.systems.get(name, **changed)
        q = system.q0 + source.uniform(-0.2, 0.2, system.n)
        v = system.project(q, system.v0 + source.uniform(-0.2, 0.2, system.n))
        expected = np.array(REDUCED[name](changed, q.tolist(), v.tolist()), dtype=float)
        size = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(system.acceleration(q, v), expected, rtol=0, atol=1e-12 * size)


@pytest.mark.parametrize("name", NAMES)
def test_reference_to_20_digits(name):
    """The flow, whose tolerance is 1e-13 for a step, of which there are about 10."""
    expected = [float(text) for text in REFERENCE[name]]
    np.testing.assert_allclose(dal.reference(make(name), t=1.0).q, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_check(name):
    growth = {
        "steered_car": (2, 3, 4),
        "roller_racer": (2, 3, 4),
        "two_wheeled_robot": (2, 3, 4, 4),
        "cvt": (2, 3),
        "sleigh_with_rotor": (3, 4),
        "disguised": (6, 6),
    }
    report = make(name).check()
    assert report and report.growth == growth[name]
    assert report.integrable == (name == "disguised")
    assert bool(report.holonomic) == (name in ("disguised", "two_wheeled_robot"))


@pytest.mark.parametrize("name", NAMES)
def test_invariants_on_the_flow(name):
    """Constant to the accuracy of the flow: 1e-13 for each of about 100 steps."""
    system = make(name)
    run = dal.integrate(system, "reference", h=0.1, t_end=5)
    values = {"energy": system.energy(run.q, run.v), **system.invariant(run.q, run.v)}
    assert tuple(values)[1:] == system.invariants
    for key, x in values.items():
        drift = np.abs(x - x[0]).max()
        assert drift <= 1e-11 * max(1.0, abs(x[0])), key


@pytest.mark.parametrize("name", NAMES)
def test_midpoint(name):
    system = make(name)
    study = dal.convergence(system, "midpoint")
    assert study.holds is True and study.scheme.order == 2
    run = dal.integrate(system, "midpoint", h=0.01, steps=500)
    assert system.relative_residual(run.q, run.v).max() <= 64 * U


# ---- against other systems ---------------------------------------------------------------------


def test_cvt_over_ten_turns():
    """Values at 20 pi by DOP853 of SciPy at 1e-13, which agree to 3e-11 with those at 1e-12."""
    end = dal.reference(make("cvt"), t=20 * np.pi)
    expected = [-0.91655137526, -0.629729862469, 0.189943486988]
    np.testing.assert_allclose(end.q, expected, rtol=0, atol=1e-10)
    still, contact = dal.systems.cvt(c=0), dal.systems.contact_oscillator()
    q, v = contact.q0, contact.v0
    one, other = (dal.integrate(s, "midpoint", q, v, h=0.01, steps=100) for s in (still, contact))
    np.testing.assert_allclose(one.y, other.y, rtol=0, atol=64 * U)


def test_rotor_without_spring_leaves_the_sleigh_alone():
    system, sleigh = dal.systems.sleigh_with_rotor(k=0), dal.systems.sleigh()
    q, v = sleigh.exact(2.0, system.q0[:3], system.v0[:3])
    end = dal.reference(system, t=2.0)
    np.testing.assert_allclose([*end.q[:3], *end.v[:3]], [*q, *v], rtol=0, atol=1e-11)
    assert end.v[2] + end.v[3] == pytest.approx(0.5, abs=1e-12)


def test_disguised_stays_on_its_surface():
    """The midpoint rule keeps D, whose quadratic integral it keeps to order 2 only."""
    system = make("disguised")
    (name,) = system.invariants
    errors = []
    for steps in (50, 100):
        run = dal.integrate(system, "midpoint", h=1 / steps, steps=steps)
        x = system.invariant(run.q, run.v)[name]
        errors.append(np.abs(x - x[0]).max())
    assert errors[0] < 1e-2 and 3.5 < errors[0] / errors[1] < 4.5


# ---- without SymPy, and what is refused --------------------------------------------------------


def test_sympy_is_imported_late():
    program = (
        "import sys, dalembert as dal\n"
        "dal.systems.names_in_sympy(), dir(dal.systems), dal.systems.cvt\n"
        "assert dal.cli.main(['systems']) == 0\n"
        "assert 'sympy' not in sys.modules\n"
    ).replace("dal.cli", "__import__('dalembert.cli').cli")
    subprocess.run([sys.executable, "-c", program], check=True, env=os.environ, timeout=60)


def test_without_sympy(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"car needs SymPy: pip install 'dalembert\[sym\]'"):
        dal.systems.steered_car()


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: dal.systems.steered_car(l=0), "l = 0: expected a positive number"),
        (lambda: dal.systems.roller_racer(K=-1), "K = -1: expected a positive number"),
        (lambda: dal.systems.cvt(c=np.nan), "c = nan: expected a finite number"),
        (lambda: dal.systems.two_wheeled_robot(a="1"), "a = '1': expected a finite number"),
        (lambda: dal.systems.get("cvt", d=1), "parameters: 'cvt' has no 'd'; it has c"),
        (lambda: dal.systems.get("disguised", d=1), "has no 'd'; it has none"),
    ],
)
def test_refused(call, text):
    with pytest.raises(ValueError, match=text):
        call()
