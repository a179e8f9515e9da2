"""Derivatives of motions, against differences of runs, and in closed form."""

import functools
import math

import mpmath as mp
import numpy as np
import pytest
import sympy as sp

import dalembert as dal
from dalembert.symbolic import expressions

x, y, z = dal.coordinates("x y z")
k, u = sp.symbols("k u", real=True)
T = (x.d**2 + y.d**2) / 2
SYSTEMS = (
    "sleigh", "knife_edge", "rolling_disc", "snakeboard", "particle", "contact_oscillator", "cvt",
    "two_wheeled_robot", "roller_racer", "n_trailer", "heisenberg",
)  # fmt: skip


def difference(f, h=1e-4):
    """Return the derivative of a function at 0, to order 4."""
    return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)


def end(system, x0, t_end, **more):
    q, v = np.split(x0, 2)
    run = dal.integrate(system, "taylor", q, v, t_end=t_end, stride=10**9,
                        consistent="project", **more)  # fmt: skip
    return run.x[-1]


def require_close(one, other, tolerance=1e-9):
    assert abs(one - other).max() <= tolerance * (1 + abs(other).max())


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_start(name):
    system = getattr(dal.systems, name)()
    start, found = dal.variations(system, t_eval=[0, 3]).dx
    x0 = np.concatenate([system.q0, system.v0])
    assert start.shape == (2 * system.n, 2 * system.n - system.m)
    assert np.linalg.matrix_rank(start) == start.shape[1]
    for direction, column in zip(start.T, found.T):

        def moved(h, direction=direction):
            return end(system, x0 + h * direction, 3)

        require_close(column, difference(moved))


@pytest.mark.parametrize("name", SYSTEMS)
def test_tangent_to_D(name):
    """phi_q dq + phi_v dv is 0, but for 4 n u of the sizes of its terms, with 40 digits."""
    system = getattr(dal.systems, name)()
    found = dal.variations(system, t_end=5)
    model = expressions.model(system) if system._model is None else system._model
    phi = sp.Matrix(model.constraints)
    by_x = phi.jacobian([*model.q, *model.v])
    slopes = sp.lambdify([model.q, model.v, model.p], by_x, "mpmath")
    with mp.workdps(40):
        q, v, p = ([mp.mpf(float(a)) for a in values]
                   for values in (found.q, found.v, system.parameters.values()))  # fmt: skip
        matrix = slopes(q, v, p)
        for column in found.dx.T:
            for a in range(system.m):
                terms = [matrix[a, i] * mp.mpf(float(c)) for i, c in enumerate(column)]
                bound = 4 * system.n * 2.0**-53 * sum(map(abs, terms))
                assert abs(sum(terms)) <= bound


def test_the_motion_is_the_same():
    run = dal.integrate(dal.systems.sleigh(), "taylor", t_end=20)
    found = dal.variations(dal.systems.sleigh(), t_eval=[20])
    np.testing.assert_allclose(found.x[-1], run.x[-1], rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.rate[0, :3], run.v[-1], rtol=0, atol=1e-13)


def test_parameters():
    """The initial velocity is projected into the D that changes, in the mass metric."""
    system = dal.systems.sleigh()
    x0 = np.concatenate([system.q0, system.v0])
    found = dal.variations(system, t_end=3, parameters=["m", "J", "a"])
    assert found.columns == ("x", "y", "theta", "w0", "w1", "m", "J", "a")
    for name, column in zip(found.columns[5:], found.dx.T[5:]):

        def moved(h, name=name):
            return end(system.with_parameters(**{name: system.parameters[name] + h}), x0, 3)

        require_close(column, difference(moved))


@functools.cache
def driven():
    L = T - k * x**2 / 2 - sp.cos(y)
    return dal.System.from_sympy(L, force={y: u * sp.sin(x)}, inputs=[u], parameters={k: 2})


def test_inputs_and_second_derivatives():
    system, x0 = driven(), np.array([0.3, 0.2, 0.1, 0.7])
    found = dal.variations(
        system, x0[:2], x0[2:], t_end=4, inputs=["u"], parameters=["k"], values=[0.7], order=2
    )
    assert found.columns == ("x", "y", "w0", "w1", "k", "u") and found.d2x.shape == (4, 6, 6)

    def moved(a, b, c):
        other = system.with_parameters(k=2 + c)
        return end(other, x0 + [a, 0, 0, 0], 4, inputs=[0.7 + b])

    directions = {"x": (1, 0, 0), "u": (0, 1, 0), "k": (0, 0, 1)}

    def first(a, at, h=1e-4):
        return difference(lambda s: moved(*(at + s * a)), h)

    for name, one in directions.items():
        i, a = found.columns.index(name), np.array(one)
        require_close(found.dx[:, i], first(a, np.zeros(3)))
        for other, two in directions.items():
            j, b, h = found.columns.index(other), np.array(two), 1e-3
            mixed = difference(lambda s, a=a, b=b, h=h: first(a, s * b, h), h)
            require_close(found.d2x[:, i, j], mixed, 1e-7)
    assert (found.d2x == np.swapaxes(found.d2x, 1, 2)).all()
    alone = dal.variations(
        system, x0[:2], x0[2:], t_end=4, inputs=["u"], parameters=["k"], values=[0.7]
    )
    np.testing.assert_allclose(alone.dx, found.dx, rtol=0, atol=1e-13)


def test_second_derivatives_on_D():
    """Along a straight line in (q, w) the second derivative of the end is that of the run."""
    system = dal.systems.knife_edge()
    found = dal.variations(system, t_eval=[0, 2], order=2)
    x0, start, second = found.x[0], found.dx[0], found.d2x[0]
    for i in range(5):
        def moved(h, i=i):
            along = x0 + h * start[:, i] + h**2 / 2 * second[:, i, i]
            return end(system, along, 2)

        h = 3e-3
        bend = (-moved(2 * h) + 16 * moved(h) - 30 * moved(0) + 16 * moved(-h) - moved(-2 * h)) / (
            12 * h**2
        )
        require_close(found.d2x[1][:, i, i], bend, 1e-6)


KINKS = {
    "V of |x|": (T - k * sp.Abs(x), None),
    "wall": (T - k * sp.Max(0, x) ** 2 / 2 - sp.Max(0, -x) ** 2, None),
    "two": (T - k * sp.Abs(x) - sp.Abs(y - 1) * sp.sin(k), None),
    "force": (T - k * x**2 / 2, {x: -k * sp.sign(y - 2 + x / 3)}),
    "time": (T - k * x**2 / 2, {x: -k * sp.sign(dal.time - 2) * sp.cos(y)}),
}


@pytest.mark.parametrize("name", KINKS)
@pytest.mark.parametrize("t_end", [5, -5])
def test_kinks_and_jumps(name, t_end):
    """Where a force jumps the time of the jump has a derivative too."""
    L, force = KINKS[name]
    system = dal.System.from_sympy(L, force=force, parameters={k: 1.3})
    x0 = np.array([1, 0, 0.3, 1])
    found = dal.variations(system, x0[:2], x0[2:], t_end=t_end, parameters=["k"])
    for i, direction in enumerate(np.eye(4)):

        def moved(h, direction=direction):
            return end(system, x0 + h * direction, t_end)

        require_close(found.dx[:, i], difference(moved, 1e-5), 3e-9)
    require_close(
        found.dx[:, 4],
        difference(lambda h: end(system.with_parameters(k=1.3 + h), x0, t_end), 1e-5), 3e-9,
    )
    if t_end > 0:
        with pytest.raises(NotImplementedError, match="kink, which the motion passes at t"):
            dal.variations(system, x0[:2], x0[2:], t_end=t_end, order=2)


def test_jumps_at_output_times():
    """The jump counts, also where an output is exactly on it."""
    system = dal.System.from_sympy(x.d**2 / 2, force={x: -sp.sign(x - 1)}, coordinates=[x])
    exact = np.array([[0.2, 0.6], [-1.6, 0.2]])
    for times in ([1], [0.5, 1], [0.4, 0.5, 0.9, 1]):  # the jump is at 0.5
        found = dal.variations(system, [0.5], [0.75], t_eval=times)
        np.testing.assert_allclose(found.dx[-1], exact, rtol=0, atol=1e-13)
    before = dal.variations(system, [0.5], [0.75], t_end=0.5)
    np.testing.assert_allclose(before.rate, [1.25, 1], rtol=0, atol=1e-13)
    switched = dal.System.from_sympy(
        x.d**2 / 2, force={x: -sp.sign(dal.time - k)}, coordinates=[x], parameters={k: 1}
    )
    for times in ([2], np.linspace(0, 2, 5)):
        found = dal.variations(switched, [0], [0], t_eval=times, parameters=["k"])
        np.testing.assert_allclose(found.dx[-1, :, -1], [2, 2], rtol=0, atol=1e-13)
    with pytest.raises(NotImplementedError, match="kink"):
        dal.variations(system, [0.5], [0.75], t_eval=[0.5, 1], order=2)


def test_closed_form():
    """An oscillator: many columns, several times, and its symplectic matrix."""
    system = dal.System.from_sympy(T - x**2 / 2 - 2 * y**2)
    times = [0.0, 1.0, 1.0, 30.0]
    directions = np.random.default_rng(1).normal(size=(23, 4))
    found = dal.variations(system, [1, 0], [0, 1], t_eval=times, directions=directions)
    for t, dx in zip(times, found.dx):
        c, s, c2, s2 = (f(w * t) for w in (1, 2) for f in (math.cos, math.sin))
        exact = np.array([[c, 0, s, 0], [0, c2, 0, s2 / 2], [-s, 0, c, 0], [0, -2 * s2, 0, c2]])
        np.testing.assert_allclose(dx, exact @ directions.T, rtol=0, atol=3e-14)
    assert found.columns[:2] == ("direction 0", "direction 1")


@pytest.mark.parametrize("given, message", [
    ({"order": 3}, "order = 3: expected"),
    ({"t_eval": [1]}, "exactly one of t_end and t_eval"),
    ({"t_end": None, "t_eval": [1, 0.5]}, "t_eval: expected times in the order"),
    ({"parameters": ["mm"]}, "parameters: 'mm' is unknown; did you mean"),
    ({"inputs": ["u"]}, "inputs: 'u' is unknown; expected none"),
    ({"directions": [[0, 0, 0, 0, 1, 0]]}, "column 0 is not tangent to D"),
    ({"directions": np.zeros((0, 6))}, "expected at least one column"),
    ({"t_end": math.nan}, "t_end = nan"),
])  # fmt: skip
def test_refused(given, message):
    with pytest.raises((ValueError, dal.NotOnConstraintError), match=message):
        dal.variations(dal.systems.sleigh(), **{"t_end": 1, **given})


def test_not_supported():
    own = dal.System(mass=[1], potential=lambda q: q[0] ** 2, gradient=lambda q: 2 * q)
    with pytest.raises(NotImplementedError, match="has no Taylor series"):
        dal.variations(own, [1], [0], t_end=1)
    speed = dal.System.from_sympy(T, [x.d**2 + y.d**2 - 1])
    with pytest.raises(NotImplementedError, match="no equations on D in closed form"):
        dal.variations(speed, [0, 0], [1, 0], t_end=1)
    with pytest.raises(dal.NotOnConstraintError):
        dal.variations(dal.systems.sleigh(), [0, 0, 0], [0, 1, 0], t_end=1)


def test_a_velocity_that_is_projected():
    """Where v0 is off D, it is projected for each value of a parameter."""
    system, q0, v0 = dal.systems.sleigh(), np.array([0, 0, 0.4]), np.array([1, 0.5, 0.8])
    found = dal.variations(
        system, q0, v0, t_end=2, parameters=["a", "m"], consistent="project"
    )
    for name, column in zip(("a", "m"), found.dx.T[-2:]):

        def moved(h, name=name):
            other = system.with_parameters(**{name: system.parameters[name] + h})
            return end(other, np.concatenate([q0, v0]), 2)

        require_close(column, difference(moved))
