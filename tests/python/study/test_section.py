"""Return maps and periodic orbits, against differences and known orbits."""

import math

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import dalembert as dal

x, y, z = dal.coordinates("x y z")
T = (x.d**2 + y.d**2) / 2
HENON = dal.System.from_sympy(T - (x**2 + y**2) / 2 - x**2 * y + y**3 / 3)


def test_points():
    system = dal.systems.contact_oscillator()
    t, q, v = dal.section(system, x).points(count=300)
    assert q.shape == (300, 3) and (np.diff(t) > 0).all()
    assert abs(q[:, 0]).max() < 1e-12 and (v[:, 0] > 0).all()
    assert np.ptp(system.energy(q, v)) < 1e-13
    down = dal.section(system, x, direction=-1).points(count=10)
    both = dal.section(system, x, direction=0).points(count=20)
    assert (down[2][:, 0] < 0).all()
    np.testing.assert_array_equal(np.sort(np.concatenate([t[:10], down[0]]))[:15], both[0][:15])


def test_the_derivative_of_the_map():
    system = dal.systems.contact_oscillator(eps=0.3)
    section = dal.section(system, x - z / 3)
    there = section.map(returns=2)
    x0 = np.concatenate([system.q0, system.v0])
    assert there.start.shape == (6, 5)
    for direction, column in zip(there.start.T, there.derivative.T):

        def moved(h, direction=direction):
            q, v = np.split(x0 + h * direction, 2)
            return section.map(q, system.project(q, v), returns=2).x

        h = 1e-4
        ends = (8 * (moved(h) - moved(-h)) - (moved(2 * h) - moved(-2 * h))) / (12 * h)
        np.testing.assert_allclose(column, ends, rtol=0, atol=1e-8)
    # tangent to the section
    np.testing.assert_allclose(there.derivative[0], there.derivative[2] / 3, atol=1e-12)


def test_a_pendulum():
    pendulum = dal.System.from_sympy(x.d**2 / 2 + sp.cos(x))
    orbit = dal.section(pendulum, x).orbit([0], [1.5])
    k = orbit.v[0] / 2
    assert abs(orbit.period - 4 * ellipk(k**2)) < 1e-13
    turning = dal.section(
        pendulum, sp.sin(x / 2), periods={"x": 4 * math.pi}
    ).orbit([0], [3])  # fmt: skip
    k = 2 / turning.v[0]
    assert abs(turning.period - 2 * 2 * k * ellipk(k**2)) < 1e-12


def test_henon_and_heiles():
    """Its multipliers, by another method with differences."""
    orbit = dal.section(HENON, x).orbit([0, 0.3], [0.42, 0], energy=1 / 8)
    assert abs(HENON.energy(orbit.q, orbit.v) - 1 / 8) < 1e-15 and orbit.residual < 1e-14

    def flow(s, at):
        a, b, da, db = at
        return [da, db, -a - 2 * a * b, -b - a * a + b * b]

    def last(at):
        return solve_ivp(flow, (0, orbit.period), at, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]

    x0, h = np.concatenate([orbit.q, orbit.v]), 1e-4
    np.testing.assert_allclose(last(x0), x0, rtol=0, atol=1e-11)
    monodromy = np.array([
        (8 * (last(x0 + h * e) - last(x0 - h * e)) - last(x0 + 2 * h * e) + last(x0 - 2 * h * e))
        / (12 * h) for e in np.eye(4)
    ]).T  # fmt: skip
    assert abs(np.trace(monodromy) - (1 + orbit.multipliers.sum())) < 1e-7
    assert abs(abs(orbit.multipliers) - 1).max() < 1e-7


def test_energy_and_families():
    """Without an energy the nearest orbit of the family is found."""
    section = dal.section(dal.systems.contact_oscillator(), x)
    start = [0, 0.3, 0.2]
    v = section.system.project(start, [1, 0.2, 0.1])
    near = section.orbit(start, v)
    given = section.orbit(start, v, energy=1.0)
    for orbit in (near, given):
        run = dal.integrate(section.system, "taylor", orbit.q, orbit.v, t_end=orbit.period)
        np.testing.assert_allclose(run.x[-1], run.x[0], rtol=0, atol=1e-12)
        assert abs(orbit.multipliers - 1).min() < 1e-6
    assert abs(section.system.energy(given.q, given.v) - 1) < 1e-14


def test_returning():
    """A skate on a plane comes back up to a shift along it."""
    skate = dal.systems.knife_edge()
    names = ["theta", "v_theta", "v_x", "v_y"]
    assert skate.coordinates == ("x", "y", "theta")
    theta = dal.coordinates("theta")[0]
    section = dal.section(skate, sp.sin(theta), returning=names, periods={"theta": 2 * math.pi})
    orbit = section.orbit([0, 0, 0], [1, 0, 2.0])
    assert abs(orbit.period - 2 * math.pi / orbit.v[2]) < 1e-12


@pytest.mark.parametrize("given, message", [
    ({"g": lambda t, q, v: q[0]}, "g = .*: expected a SymPy expression"),
    ({"returning": ["w"]}, "returning: 'w' is unknown; .*expected x, y, v_x, v_y"),
    ({"periods": {"a": 1}}, "periods: 'a' is unknown"),
    ({"periods": {"x": 0}}, "periods = 0: expected a positive number"),
    ({"t_max": -1}, "t_max = -1: expected a positive number"),
    ({"g": sp.sign(x)}, "expected an expression without jumps"),
    ({"g": sp.Integer(1)}, "g = 1: expected a SymPy expression in the state"),
])  # fmt: skip
def test_refused(given, message):
    with pytest.raises(ValueError, match=message):
        dal.section(HENON, **{"g": x, **given})


def test_no_return():
    free = dal.System.from_sympy(T)
    with pytest.raises(ValueError, match="0 crossings up to t = 10, not 1; give a larger t_max"):
        dal.section(free, x, t_max=10).map([1, 0], [1, 0])
    with pytest.raises(dal.ConvergenceError, match="begin"):
        dal.section(HENON, x).orbit([0, 0.05], [0.01, 0.3], energy=0.01, returns=7)


def test_an_equilibrium_is_no_orbit():
    with pytest.raises((dal.ConvergenceError, ValueError)):
        dal.section(HENON, x).orbit([0, 1e-12], [1e-12, 0])


def test_a_section_on_a_jump():
    """The motion ends with the force before the jump, and begins with the one after it."""
    system = dal.System.from_sympy(x.d**2 / 2, force={x: -sp.sign(x)}, coordinates=[x])
    orbit = dal.section(system, x).orbit([0], [1])
    assert abs(orbit.period - 4) < 1e-13 and abs(orbit.multipliers[0] - 1) < 1e-12


def test_starts_beside_the_section():
    """The first crossing in the right direction is the start."""
    for start in ([0.2, 0.3], [0, 0.3]):
        orbit = dal.section(HENON, x).orbit(start, [-0.42, 0], energy=1 / 8)
        assert abs(HENON.energy(orbit.q, orbit.v) - 1 / 8) < 1e-15


def test_numbers_that_do_not_determine_the_state():
    with pytest.raises(ValueError, match="returning: 2 numbers do not determine the state"):
        dal.section(HENON, x, returning=["y", "v_y"]).orbit([0, 0.3], [0.42, 0])


def test_equations_that_depend_on_time():
    """A forced oscillator: the multipliers of its stroboscopic map."""
    t = dal.time
    forced = dal.System.from_sympy(
        x.d**2 / 2 - 2 * x**2, force={x: sp.cos(t) - x.d / 5}, coordinates=[x]
    )
    with pytest.raises(ValueError, match="depend on time: give their period"):
        dal.section(forced, x).orbit([0], [1])
    with pytest.raises(dal.ConvergenceError, match="no multiple of the period"):
        dal.section(forced, sp.sin(t * sp.sqrt(2))).orbit([0.3], [0], period=2 * math.pi)
    for at in (0.0, 1.0):
        orbit = dal.section(forced, sp.sin(t)).orbit([0.3], [0], period=2 * math.pi, t=at)
        rate, frequency = 0.1, math.sqrt(4 - 0.01)
        exact = np.exp(2 * math.pi * np.array([-rate + 1j * frequency, -rate - 1j * frequency]))
        np.testing.assert_allclose(np.sort(orbit.multipliers.imag), np.sort(exact.imag), atol=1e-12)
        np.testing.assert_allclose(orbit.multipliers.real, exact.real, atol=1e-12)
        steady = np.linalg.solve([[3, 0.2], [-0.2, 3]], [1, 0])  # of cos t and sin t
        np.testing.assert_allclose(orbit.q, steady[:1], rtol=0, atol=1e-12)
