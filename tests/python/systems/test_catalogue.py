"""The systems that are written in SymPy, against equations of motion that are reduced by hand."""

import importlib.util
import json
import os
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import pytest
from conftest import U
from mpmath import cos, sin, tan

import dalembert as dal
from dalembert.systems import catalogue

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

def make(name):
    return dal.systems.get(name)


# ---- each system -------------------------------------------------------------------------------


def test_every_system_is_here():
    assert set(REDUCED) == set(NAMES) == set(catalogue.__all__)
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


# ---- known states, of all systems ----------------------------------------------------------------


EVERY = (*dal.systems.names(), *NAMES)


def numbers(state):
    return np.array([*state.q, *state.v], dtype=float)


@pytest.mark.parametrize("name", EVERY)
def test_known_states(name):
    """Against the data of the system, the flow, and the exact solution.

    The flow has a tolerance of 1e-13 for a step, of which there are about 10 in a unit of time, and
    the motions separate by less than a factor 10 in one and 1000 in ten.
    """
    system = make(name)
    start, one, ten = dal.systems.known_states(name.replace("_", "-"))
    assert (start.t, one.t, ten.t) == (0, 1, 10)
    first = np.concatenate([system.q0, system.v0])
    size = max(1.0, np.abs(first).max())
    np.testing.assert_allclose(numbers(start), first, rtol=0, atol=4 * U * size)
    for state, tolerance in ((one, 1e-11), (ten, 1e-9)):
        assert len(state.q) == len(state.v) == system.n
        flow = dal.reference(system, t=state.t)
        found, known = np.concatenate([flow.q, flow.v]), numbers(state)
        size = max(1.0, np.abs(known).max())
        np.testing.assert_allclose(found, known, rtol=0, atol=tolerance * size)
        if system.has_exact:
            exact = np.concatenate(system.exact(state.t))
            np.testing.assert_allclose(exact, known, rtol=0, atol=1e-13 * size)


@pytest.mark.parametrize("name", EVERY)
def test_digits_of_known_states(name):
    """30 digits, at most 30 of them behind the point; fewer only where a number ends."""
    for state in dal.systems.known_states(name)[1:]:
        texts = (*state.q, *state.v)
        full = 0
        for text in texts:
            digits, _, exponent = text.lstrip("-").replace(".", "").partition("e")
            ends = Fraction(text).limit_denominator(10**4) == Fraction(text)
            assert len(digits.lstrip("0")) <= 30
            assert ends or len(digits.lstrip("0")) >= 26 + int(exponent or 0)
            full += not ends
        assert full >= len(texts) / 2


def script():
    """The program that wrote the known states."""
    path = Path(__file__).parents[2] / "data" / "make_references.py"
    spec = importlib.util.spec_from_file_location("make_references", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


IN_VECTORS = {
    "particle": "particle", "particle_osc": "particle_oscillator", "knife": "knife_edge",
    "sleigh": "sleigh", "sleigh_contact": "sleigh_contact", "disk": "disk",
    "heis": "heisenberg", "genmass": "genmass",
}  # fmt: skip


@pytest.mark.parametrize("name", sorted({*EVERY} - {*IN_VECTORS.values()}))
def test_known_states_to_19_digits(name):
    """By one of the two methods, of order 18 with steps of 1/6, from exact data and in 30 digits.

    The vectors below have the other systems.
    """
    program, system = script(), make(name)
    states = dal.systems.known_states(name)
    with mpmath.workdps(30):
        start = [mpmath.mpf(str(e.evalf(32))) for e in program.exact_start(system)]
        known = [mpmath.mpf(text) for text in (*states[0].q, *states[0].v)]
        assert max(abs(a - b) for a, b in zip(start, known)) < 1e-28
        (end,) = program.extrapolated(program.field(system), known, [1], steps=6, columns=9)
        known = [mpmath.mpf(text) for text in (*states[1].q, *states[1].v)]
        assert max(abs(a - b) for a, b in zip(end, known)) < 1e-19


@pytest.mark.parametrize("name", IN_VECTORS)
def test_known_states_are_those_of_the_vectors(name):
    """Which have 40 digits, from other programs: the last of the 30 may be rounded otherwise."""
    data = Path(__file__).parents[2] / "data" / "reference.json"
    theirs = json.loads(data.read_text(encoding="ascii"))[name]["states"]
    for state in dal.systems.known_states(IN_VECTORS[name])[1:]:
        other = theirs[f"{state.t:g}"]
        for a, b in zip((*state.q, *state.v), (*other["q"], *other["v"])):
            assert abs(Fraction(a) - Fraction(b)) <= Fraction(1, 10**29) * (1 + abs(Fraction(b)))


def test_known_states_of_nothing():
    with pytest.raises(ValueError, match="no system 'pendulum'; choose one of: particle, "):
        dal.systems.known_states("pendulum")


# ---- against other systems ---------------------------------------------------------------------


def test_invariant_of_the_roller_racer():
    """The one with the elliptic integral, which its docstring states."""
    system = make("roller_racer")
    m, J, K, d1, d2 = system.parameters.values()

    def square(phi):
        return sin(phi) ** 2 / m + (d1 * cos(phi)) ** 2 / J

    def slope(phi):
        return d1 / (mpmath.sqrt(m * J) * square(phi) * mpmath.sqrt(1 + square(phi) * K / d2**2))

    run = dal.integrate(system, "reference", h=0.5, t_end=5)
    phi, turn = run.q[:, 3], run.v[:, 2]
    u = np.cos(run.q[:, 2]) * run.v[:, 0] + np.sin(run.q[:, 2]) * run.v[:, 1]
    s, c = np.sin(phi), np.cos(phi)
    N = s**2 / m + (d1 * c) ** 2 / J
    angle = np.unwrap(np.arctan2(
        np.sqrt(1 + N * K / d2**2) * (u * s - d1 * turn * c),
        d1 * u * c * np.sqrt(m / J) + turn * s * np.sqrt(J / m),
    ))  # fmt: skip
    values = angle - [float(mpmath.quad(slope, [0, x])) for x in phi]
    assert np.ptp(phi) > 3 and np.ptp(angle) > 2
    assert np.ptp(values) < 1e-11  # the flow, 1e-13 for each of some dozen steps


# ---- without SymPy, and what is refused --------------------------------------------------------


def test_sympy_is_imported_late():
    program = (
        "import sys, dalembert as dal\n"
        "dal.systems.names_in_sympy(), dir(dal.systems), dal.systems.cvt\n"
        "assert dal.cli.main(['systems']) == 0\n"
        "assert 'sympy' not in sys.modules\n"
    ).replace("dal.cli", "__import__('dalembert.cli').cli")
    subprocess.run([sys.executable, "-c", program], check=True, env=os.environ, timeout=240)


def test_without_sympy(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match="car needs SymPy: pip install sympy"):
        dal.systems.steered_car()


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: dal.systems.steered_car(l=0), "l = 0: expected a positive number"),
        (lambda: dal.systems.roller_racer(K=-1), "K = -1: expected a positive number"),
        (lambda: dal.systems.cvt(c=np.nan), "c = nan: expected a finite number"),
        (lambda: dal.systems.two_wheeled_robot(a="1"), "a = '1': expected a finite number"),
        (lambda: dal.systems.get("cvt", d=1), "parameters: 'cvt' has no 'd'; it has c"),
        (lambda: dal.systems.get("disguised", d=1), "the system 'disguised' has none"),
        (lambda: make("steered_car").with_parameters(l=0), "l = 0: expected a positive number"),
        (lambda: make("roller_racer").with_parameters(d2=-0.5), "d2 = -0.5: expected a positive"),
        (lambda: make("cvt").with_parameters(c=np.inf), "c = inf: expected a finite number"),
        (lambda: dal.systems.snakeboard().with_parameters(J0=1), "expected m r"),
    ],
)
def test_refused(call, text):
    with pytest.raises(ValueError, match=text):
        call()
