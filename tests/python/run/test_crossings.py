"""Events of "taylor" from the series of g along the motion: none is missed, whatever the step."""

import math
import warnings

import numpy as np
import pytest
import sympy as sp

import dalembert as dal

x, y = dal.coordinates("x y")
t = dal.time


def plane(V=0, **more):
    """Return a particle in the plane with a potential."""
    return dal.System.from_sympy((x.d**2 + y.d**2) / 2 - V, [], **more)


SWING = plane((x**2 + 49 * y**2) / 2)  # x = sin t, y = cos 7 t
DATA = {"q0": [0, 1], "v0": [1, 0]}
KNOWN = {x: np.sin, y: lambda s: np.cos(7 * s), t: lambda s: s}

GUARDS = {
    "fast": sp.sin(200 * t),
    "product": sp.sin(300 * x * y),
    "kink": sp.Abs(x) - sp.Rational(1, 2),
    "largest": sp.Max(x, y) - sp.Rational(3, 10),
    "hill": sp.exp(-(((t - 7) / sp.Rational(1, 500)) ** 2)) - sp.Rational(1, 2),
    "hill of x": sp.exp(-(((x - sp.Rational(1, 3)) * 500) ** 2)) - sp.Rational(1, 2),
    "pole": 1 / (x + sp.Rational(101, 100)) - 50,
    "branch": sp.asin(sp.sin(3 * t)) - sp.Rational(3, 10),
    "pulses": sp.cos(sp.pi * t) ** 400 - sp.Rational(1, 2),
    "near": x - 1 + sp.Rational(1, 10**9),
    "cube": x**3,
}


def truth(g, until, count=400_001):
    """Return the zeros of g along the known motion, from values on a fine grid."""
    symbols = [*KNOWN]
    f = sp.lambdify(symbols, g, "numpy")

    def value(s):
        return f(*(KNOWN[one](s) for one in symbols)) + 0 * s

    grid = np.linspace(0, until, count)[1:]
    values = value(grid)
    low = np.flatnonzero(np.sign(values[1:]) * np.sign(values[:-1]) < 0)
    a, b = grid[low], grid[low + 1]
    for _ in range(60):
        middle = (a + b) / 2
        left = np.sign(value(middle)) == np.sign(value(a))
        a, b = np.where(left, middle, a), np.where(left, b, middle)
    return a


@pytest.mark.parametrize("name", GUARDS)
@pytest.mark.parametrize("sizes", [{}, {"h": 2.5}])
def test_none_is_missed(name, sizes):
    run = dal.integrate(SWING, "taylor", **DATA, t_end=10, events=[GUARDS[name]], **sizes)
    expected = truth(GUARDS[name], 10)
    if name == "near":  # pairs that are 9e-5 apart
        expected = np.sort([math.pi / 2 + 2 * math.pi * k + s for k in (0, 1) for s in
                            (-math.sqrt(2e-9), math.sqrt(2e-9))])  # fmt: skip
    assert len(run.t_events[0]) == len(expected)
    tolerance = {"cube": 1e-5, "near": 1e-11}.get(name, 1e-13)
    np.testing.assert_allclose(run.t_events[0], expected, rtol=0, atol=tolerance)
    np.testing.assert_allclose(run.q_events[0][:, 0], np.sin(expected), rtol=0, atol=tolerance)
    assert len(run.t) < 60


def test_jumps():
    """A guard that jumps over zero crosses where it jumps."""
    g = sp.sign(sp.sin(40 * t)) + sp.Rational(1, 2)
    run = dal.integrate(SWING, **DATA, t_end=10, events=[g, sp.Piecewise((x, y > 0), (-1, True))])
    np.testing.assert_allclose(
        run.t_events[0], np.arange(1, 128) * math.pi / 40, rtol=0, atol=1e-14
    )
    s = np.linspace(0, 10, 1_000_001)
    values = np.where(np.cos(7 * s) > 0, np.sin(s), -1)
    assert len(run.t_events[1]) == np.sum(np.sign(values[1:]) != np.sign(values[:-1])) - 1


@pytest.mark.parametrize("g, often", [(x - 1, "2 times"), (x**2, "3 times"), (1 + x, "once")])
def test_touches_are_told(g, often):
    with pytest.warns(dal.DalembertWarning, match=f"close to zero within a step, {often}"):
        run = dal.integrate(SWING, **DATA, t_end=10, events=[g])
    assert len(run.t_events[0]) == 0


def test_near_zero_is_no_touch():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = dal.integrate(SWING, **DATA, t_end=10, events=[x - 1 - sp.Float(1e-13)])
    assert len(run.t_events[0]) == 0


def test_directions_and_ends():
    up, down, end = (dal.Event(sp.sin(50 * t), direction=d) for d in (1, -1, 0))
    both = dal.Event(sp.sin(50 * t), terminal=7)
    run = dal.integrate(SWING, **DATA, t_end=10, events=[up, down, end, both])
    np.testing.assert_allclose(run.t[-1], 7 * math.pi / 50, rtol=1e-15)
    assert [len(found) for found in run.t_events] == [3, 4, 7, 7]
    back = dal.integrate(SWING, **DATA, t_end=-10, events=[up])
    np.testing.assert_allclose(back.t_events[0], -np.arange(1, 160, 2) * math.pi / 50, rtol=1e-14)


def test_a_zero_at_the_start_does_not_count():
    run = dal.integrate(SWING, **DATA, t_end=10, events=[x, x.d - 1])
    np.testing.assert_allclose(run.t_events[0], np.pi * np.arange(1, 4), rtol=1e-15)
    assert len(run.t_events[1]) == 0  # it touches


@pytest.mark.parametrize("sizes", [{}, {"scheme": "taylor", "h": 0.5}])
def test_resets_at_a_fast_guard(sizes):
    """A corrugated wall: between its zeros the particle swings to and fro."""
    wall = dal.Event(sp.sin(40 * x) - sp.Rational(1, 2), reset={x.d: -x.d})
    run = dal.integrate(SWING, **DATA, t_end=10, events=[wall], **sizes)
    places = run.q_events[0][:, 0]
    inner, outer = math.asin(0.5) / 40, (-math.pi - math.asin(0.5)) / 40
    np.testing.assert_allclose(places[::2], inner, rtol=0, atol=1e-13)
    np.testing.assert_allclose(places[1::2], outer, rtol=0, atol=1e-13)
    assert len(places) == 96


def test_zeno():
    fall = plane(x)
    bounce = dal.Event(x, direction=-1, reset={x.d: -x.d / 2})
    with pytest.raises(dal.ZenoError) as raised:
        dal.integrate(fall, q0=[1, 0], v0=[0, 1], t_end=20, events=[bounce])
    times = raised.value.partial.t_events[0]
    expected = math.sqrt(2) * (3 - 2.0 ** (1 - np.arange(len(times))))
    np.testing.assert_allclose(times, expected, rtol=1e-12)
    assert len(times) > 30


def test_many_in_a_step():
    run = dal.integrate(plane(), q0=[0, 0], v0=[1, 0], t_end=100, events=[sp.sin(50 * x)])
    np.testing.assert_allclose(
        run.t_events[0], np.arange(1, 1592) * math.pi / 50, rtol=1e-14, atol=0
    )


def test_functions_beside_expressions():
    run = dal.integrate(SWING, **DATA, t_end=100, events=[sp.sin(50 * t), lambda t, q, v: q[0]])
    assert [len(found) for found in run.t_events] == [1591, 31]


def test_journal_and_parameters(tmp_path):
    w = sp.Symbol("w", real=True)
    system = plane((x**2 + y**2) / 2, parameters={w: 30})
    path = tmp_path / "run.dal"
    dal.integrate(system, **DATA, t_end=5, events=[sp.sin(w * t) - x], journal=path)
    again = dal.resume(path, system, t_end=20, events=[sp.sin(w * t) - x])
    whole = dal.integrate(system, **DATA, t_end=20, events=[sp.sin(w * t) - x])
    np.testing.assert_allclose(again.t_events[0], whole.t_events[0], rtol=0, atol=1e-14)
    other = system.with_parameters(w=60)
    assert len(dal.integrate(other, **DATA, t_end=20, events=[sp.sin(w * t)]).t_events[0]) == 381


def test_loose_tolerances():
    run = dal.integrate(SWING, "taylor", **DATA, t_end=20, tolerance=1e-6, events=[x - y])
    expected = truth(x - y, 20)
    np.testing.assert_allclose(run.t_events[0], expected, rtol=0, atol=1e-5)


def test_no_series():
    """Where g has no series, as at the end of a root, its values decide."""
    run = dal.integrate(SWING, **DATA, t_end=10, events=[sp.sqrt(sp.Max(0, x)) - sp.Rational(1, 4)])
    expected = truth(x - sp.Rational(1, 16), 10)
    np.testing.assert_allclose(run.t_events[0], expected, rtol=0, atol=1e-12)


FREE = plane()
START = {"q0": [0, 0], "v0": [1, 0]}  # x = t


def crossings(g, t_end=10, **given):
    return dal.integrate(FREE, "taylor", **START, t_end=t_end, events=[g], **given).t_events[0]


@pytest.mark.parametrize("g, zeros", [
    (sp.tanh(50 * ((x - 5) ** 2 - 1)), [4, 6]),
    (sp.tanh(50 * (x - 5)) * sp.tanh(50 * (x - 6)), [5, 6]),
    (1 / (1 + sp.exp(50 * ((x - 5) ** 2 - 1))) - sp.Rational(1, 2), [4, 6]),
    (1 / sp.cosh(1000 * (x - 5)) - sp.Rational(1, 2),
     [5 - math.acosh(2) / 1000, 5 + math.acosh(2) / 1000]),
    (1 / (x - sp.Rational(51, 10)) - 1, [5.1, 6.1]),
    (sp.log(sp.Abs(x - sp.Rational(51, 10))), [4.1, 6.1]),
    (sp.sqrt(sp.Abs(x - sp.Rational(51, 10))) - 1, [4.1, 6.1]),
    (sp.tan(x), np.arange(1, 7) * math.pi / 2),
    (sp.sqrt(x + sp.Rational(1, 10**9)) - sp.Rational(1, 1000), [999e-9]),
    (sp.atan2(sp.sin(x), sp.cos(x)) - 1, [1, math.pi, 1 + 2 * math.pi, 3 * math.pi]),
])  # fmt: skip
@pytest.mark.parametrize("sizes", [{}, {"h": 2.5}])
def test_hidden_and_singular(g, zeros, sizes):
    np.testing.assert_allclose(crossings(g, **sizes), zeros, rtol=0, atol=1e-13)


@pytest.mark.parametrize("sizes", [{}, {"h": 0.5}])
def test_a_sign_that_is_zero_at_the_start(sizes):
    np.testing.assert_allclose(crossings((x - 3) * sp.sign(x), 5, **sizes), [3], rtol=1e-15)
    first = (math.pi - 1) / 20
    found = crossings(sp.sin(20 * x + 1) * sp.sign(x), 1, **sizes)
    np.testing.assert_allclose(found[:2], [first, first + math.pi / 20], rtol=1e-14)


@pytest.mark.parametrize("sizes", [{}, {"h": 0.4}])
def test_flat_guards(sizes):
    """A guard that comes to zero and stays there has reached it then."""
    flat = dal.Event(sp.Max(0, 5 - x), terminal=True)
    run = dal.integrate(FREE, "taylor", **START, t_end=10, events=[flat], **sizes)
    assert abs(run.t[-1] - 5) < 1e-14


@pytest.mark.parametrize("sizes", [{}, {"h": 0.3}])
@pytest.mark.parametrize("g", [sp.Abs(x - sp.Rational(41, 10)), sp.Abs(sp.sin(x))])
def test_touches_with_kinks(g, sizes):
    with pytest.warns(dal.DalembertWarning, match="comes close to zero"):
        assert len(crossings(g, 6, **sizes)) == 0


@pytest.mark.parametrize("given", [{"h": 0.01}, {"h": 0.1}, {"h": 0.25}, {}])
@pytest.mark.parametrize("part", [0.5, 0.8])
def test_the_ball_stays_above_the_floor(given, part):
    fall = plane(x)
    bounce = dal.Event(x, direction=-1, reset={x.d: -part * x.d})
    with pytest.raises(dal.ZenoError) as raised:
        dal.integrate(fall, "taylor", [1, 0], [0, 0.1], t_end=20, events=[bounce], **given)
    end = math.sqrt(2) * (1 + 2 * part / (1 - part))
    assert abs(raised.value.partial.t[-1] - end) < 0.3
    assert raised.value.partial.q[:, 0].min() > -1e-12


@pytest.mark.parametrize("given", [{"h": 0.25}, {"h": 0.2}, {"h": 1}, {"h": 0.3}, {}])
def test_a_corner(given):
    """Both walls are met at one time, which may be the end of a step."""
    walls = [dal.Event(s - 1, reset={s.d: -s.d}) for s in (x, y)]
    scheme = "taylor" if given.get("h") != 0.2 else "leapfrog"
    run = dal.integrate(FREE, scheme, [0, 0], [1, 1], t_end=3, events=walls, **given)
    np.testing.assert_allclose(run.x[-1], [-1, -1, -1, -1], rtol=0, atol=1e-13)
    assert [len(found) for found in run.t_events] == [1, 1]


@pytest.mark.parametrize("place", [0.1, 0.37, 0.5, 0.9, 0.77])
def test_once_beside_a_reset(place):
    swing = plane((x**2 + y**2) / 2)
    events = [dal.Event(x - place, reset={x.d: x.d}), y - place]
    run = dal.integrate(swing, "taylor", [0, 0], [1, 1], t_end=30, events=events)
    assert abs(len(run.t_events[0]) - len(run.t_events[1])) <= 1
    assert (np.diff(run.t_events[1]) > 1e-3).all()
