"""The reference flow by Taylor series: an independent integrator, as a judge and as a method."""

import functools
import os
import pickle
import signal
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import sympy as sp

import dalembert as dal

x, y, z, w = dal.coordinates("x y z w")
t, n = dal.time, sp.Symbol("n")


def bent_root(exponent):
    """A free particle in the plane whose potential ends at x = 0."""
    return dal.System.from_sympy((x.d**2 + y.d**2) / 2 - x**exponent, [])


OWN = {
    "affine": (dal.System.from_sympy, (x.d**2 + y.d**2 + z.d**2) / 2, [z.d - y * x.d - sp.sin(t)]),
    "mass": (
        dal.System.from_sympy,
        (x.d**2 + 2 * y.d**2 + z.d**2 * (1 + x**2) + x.d * z.d * sp.sin(y)) / 2
        - x * y * z * sp.cos(t),
        [z.d - y * x.d - sp.sin(t * x)], {x: -x.d * y, y: sp.sin(t)},
    ),
    "nonlinear": (
        dal.System.from_sympy,
        (x.d**2 + y.d**2 + z.d**2 * (2 + sp.sin(t))) / 2 + t * x.d * y - z,
        [x.d**2 + y.d**2 - z.d**2 - 1],
    ),
    "power": (
        functools.partial(dal.System.from_sympy, parameters={n: 2.5}),
        (x.d**2 + y.d**2) / 2 - (2 + x**2) ** n * (1 + y**2) / 9, [],
    ),
    "free": (dal.System.from_sympy, (x.d**2 + y.d**2 + z.d**2 + x.d * y.d) / 2 - x * y**3, []),
    "two": (
        dal.System.from_sympy,
        (x.d**2 + y.d**2 + z.d**2 + w.d**2 + x.d * y.d) / 2 - (1 + x**2) ** sp.Rational(3, 2) / w,
        [x.d - y * z.d, w.d - sp.sin(x) * z.d + y.d],
    ),
}  # fmt: skip
START = np.array([0.1, 0.2, 0.3, 0.9]), np.array([1.0, 0.5, 0.3, 0.2])


def own(name):
    """Return a system with other parts than those of the catalogue, and its initial data."""
    make, L, constraints, *force = OWN[name]
    system = make(L, constraints, force=force[0] if force else None)
    return system, START[0][: system.n], START[1][: system.n]


@pytest.mark.parametrize("name", ["two_wheeled_robot", "steered_car", *OWN])
def test_agrees_with_the_other_methods(name):
    system, q0, v0 = own(name) if name in OWN else (dal.systems.get(name), None, None)
    given = {"h": 0.1, "t_end": 3, "consistent": "project"}
    series = {"method": "taylor", "tolerance": 1e-15}
    run = dal.integrate(system, "reference", q0, v0, **given, **series)
    other = dal.integrate(system, "reference", q0, v0, tolerance=1e-14, **given)
    np.testing.assert_allclose(run.x, other.x, rtol=0, atol=1e-12 * abs(other.x).max())
    assert (run.t == other.t).all() and run.success and run.message == other.message
    assert run.residual.max() <= run.stats.worst_residual <= 4 * system.n * 2.0**-53
    assert 0 < run.stats.evaluations < other.stats.evaluations / 10
    back = dal.integrate(
        system, "reference", run.q[-1], run.v[-1], h=-0.1, t0=3, t_end=0, **series
    )
    np.testing.assert_allclose(back.x[-1], run.x[0], rtol=0, atol=1e-11)


A, B = sp.Rational(3, 10), sp.Symbol("s")


@functools.cache
def skate(s):
    """Return (q, v) at s of the skate, from (0, 0, 0.3) with speed 1: it is c - sin(theta)/2."""
    theta, c = A + B, 1 + sp.sin(A) / 2
    speed = c - sp.sin(theta) / 2
    along = speed * sp.cos(theta), speed * sp.sin(theta)
    q = *(sp.integrate(sp.expand(e.rewrite(sp.exp)), (B, 0, B)) for e in along), theta
    numbers = [sp.N(e.subs(B, s), 30, maxn=500) for e in (*q, *along, sp.Integer(1))]
    return np.array([float(sp.re(e)) for e in numbers])


SKATE = dal.System.from_sympy(
    (x.d**2 + y.d**2 + z.d**2) / 2 - x / 2, [-sp.sin(z) * x.d + sp.cos(z) * y.d],
    q0=[0, 0, 0.3], v0=[np.cos(0.3), np.sin(0.3), 1],
)  # fmt: skip


@pytest.mark.parametrize("method, bound", [("taylor", 1e-9), ("rk8pd", 1e-7), ("msadams", 1e-5)])
def test_long_intervals(method, bound):
    """What is not stored stays in D too: the distance of stored states makes no difference."""
    exact = skate(400)
    for h in (400.0, 40.0):
        run = dal.integrate(SKATE, "reference", h=h, t_end=400, method=method, tolerance=1e-11)
        assert np.abs(run.x[-1] - exact).max() < bound, h
    end = dal.reference(SKATE, t=400, method=method, tolerance=1e-11)
    assert np.abs(np.r_[end.q, end.v] - exact).max() < bound


def test_off_D_the_flow_stays_as_far_off():
    """What is assumed is used: the ODE keeps mu v, and only what is stored is brought into D."""
    across = 0.25
    v0 = np.array(SKATE.v0) + across * np.array([np.sin(0.3), -np.cos(0.3), 0])
    with pytest.warns(dal.DalembertWarning, match="energy"):
        run = dal.integrate(
            SKATE, "reference", SKATE.q0, v0, h=100.0, t_end=100, consistent="assume"
        )
    # along the blade v' = -cos(theta)/2 - across
    speed = 1 - across * 100 - (np.sin(100.3) - np.sin(0.3)) / 2
    along = run.v[-1, 0] * np.cos(100.3) + run.v[-1, 1] * np.sin(100.3)
    assert abs(along - speed) < 1e-8
    end = dal.reference(SKATE, SKATE.q0, v0, t=100, consistent="assume")
    np.testing.assert_allclose(end.v, run.v[-1], rtol=0, atol=1e-8)


def test_a_large_coordinate_is_not_the_measure_of_all():
    """The tolerance is that of each number in the state; nothing depends on y."""
    given = {"h": 1.0, "t_end": 20, "method": "taylor", "tolerance": 1e-11}
    near = dal.integrate(SKATE, "reference", **given)
    for far in (1e3, 1e8, 1e14):
        run = dal.integrate(SKATE, "reference", [0, far, 0.3], SKATE.v0, **given)
        np.testing.assert_allclose(run.v, near.v, rtol=0, atol=1e-9)
        np.testing.assert_allclose(run.q[:, 0], near.q[:, 0], rtol=0, atol=1e-9)
    slow = dal.System.from_sympy((x.d**2 + y.d**2) / 2 - (x / 100000) ** 2 / 2, [])
    run = dal.integrate(
        slow, "reference", [1, 0], [0, 30], **given | {"h": 1e6, "t_end": 1e6}
    )  # y gets large on the way
    assert abs(run.q[-1, 0] - np.cos(10)) < 1e-9
    with pytest.raises(dal.DomainError, match=r"numbers up to 1e\+31; expected at most 1e\+30"):
        dal.integrate(SKATE, "reference", [0, 1e31, 0.3], SKATE.v0, **given)


def test_accuracy_of_the_state():
    """What is estimated bounds the difference to the state to 30 digits."""
    known = dal.systems.known_states("cvt")[-1]
    for tolerance in (1e-6, 1e-15):
        found = dal.reference(dal.systems.cvt(), t=known.t, method="taylor", tolerance=tolerance)
        error = max(abs(found.q - [*map(float, known.q)]).max(),
                    abs(found.v - [*map(float, known.v)]).max())  # fmt: skip
        assert error <= 3 * found.accuracy + 1e-15
        assert found.accuracy < 1e3 * tolerance + 1e-13


def test_long_runs_stay_in_D():
    """The rows go on from their projection: what is not in D would grow with time."""
    racer, given = dal.systems.roller_racer(), {"h": 1, "t_end": 500, "stride": 10}
    run = dal.integrate(racer, "reference", **given, method="taylor")
    assert run.residual.max() <= 4 * racer.n * 2.0**-53
    other = dal.integrate(racer, "reference", **given)
    np.testing.assert_allclose(run.x, other.x, rtol=0, atol=1e-7 * abs(other.x).max())


def test_parameters_and_units_are_those_of_the_system():
    """One compilation serves all values; another run with the first ones is the same to the bit."""
    system = dal.systems.sleigh_with_rotor()
    name, value = next(iter(system.parameters.items()))
    other = system.with_parameters(**{name: 1.5 * value})
    runs = [
        dal.integrate(s, "reference", h=0.5, t_end=5, method="taylor") for s in
        (system, other, system)
    ]  # fmt: skip
    expected = dal.integrate(other, "reference", h=0.5, t_end=5)
    np.testing.assert_allclose(runs[1].x, expected.x, rtol=0, atol=1e-11)
    assert abs(runs[1].x - runs[0].x).max() > 1e-3
    np.testing.assert_array_equal(runs[2].x, runs[0].x)


def test_threads():
    def work(system):
        return dal.integrate(system, "reference", h=0.1, t_end=20, method="taylor").x

    with ThreadPoolExecutor(4) as pool:
        one, *others = pool.map(work, [dal.systems.cvt()] * 4)
    assert all((one == x).all() for x in others)


def test_times_and_observers():
    system, times = dal.systems.cvt(), [0, 0.5, 0.5, 1.234, 2]
    run = dal.integrate(system, "reference", h=0.1, t_end=2, t_eval=times, method="taylor")
    other = dal.integrate(system, "reference", h=0.1, t_end=2, t_eval=times)
    assert (run.t == other.t).all() and run.stats.steps == 20
    np.testing.assert_allclose(run.x, other.x, rtol=0, atol=1e-13)
    seen = {}
    for method in "taylor", "rk8pd":
        seen[method] = []

        def look(step, t, q, v, seen=seen[method]):
            seen.append((step, t))
            return step >= 6

        run = dal.integrate(
            system, "reference", h=0.1, t_end=2, stride=2, method=method, observer=look
        )
        assert run.status == 1 and run.stats.steps == 6 and len(run.t) == 4
        assert run.message.startswith("an observer stopped the run at t = 0.6")
    assert seen["taylor"] == seen["rk8pd"]
    with pytest.raises(ZeroDivisionError) as caught:
        dal.integrate(system, "reference", h=0.1, t_end=2, method="taylor",
                      observer=lambda k, t, q, v: k == 5 and 1 / 0)  # fmt: skip
    assert len(caught.value.partial.t) == 6


def test_scheme_of_its_own():
    scheme = dal.Scheme.flow("taylor", 1e-12)
    assert pickle.loads(pickle.dumps(scheme)) == scheme
    run = dal.integrate(dal.systems.cvt(), scheme, h=0.1, t_end=1)
    assert run.scheme == scheme and run.nodes == "moved" and np.isnan(run.reactions).all()
    near = dal.reference(dal.systems.cvt(), t=0.55)
    np.testing.assert_allclose(run(0.55).q, near.q, rtol=0, atol=1e-6)
    assert len(dal.integrate(dal.systems.cvt(), scheme, h=0.1, steps=0).t) == 1


@pytest.mark.parametrize(
    "system, q0, v0, kind, words",
    [
        (bent_root(sp.Rational(1, 2)), [1, 0], [-1, 0], dal.DomainError, "no Taylor series"),
        (
            bent_root(sp.Rational(5, 2)), [1, 0], [-2, 0],
            dal.DomainError, "the motion ends between t = .* gradient",
        ),
        (bent_root(-1), [-1, 0], [1, 0], dal.DomainError, "not finite beyond t = 0.57079632"),
        (
            dal.System.from_sympy((x.d**2 + y.d**2) / 2, [], force={x: -1 / x}),
            [1, 0], [0, 1], dal.ConvergenceError, "collapsed to h",
        ),
        (
            dal.System.from_sympy((x.d**2 + y.d**2) / 2 - sp.atan2(y, x) ** 2, []),
            [-1, 0.1], [0, -2], dal.DomainError, "no Taylor series",
        ),
    ],
)  # fmt: skip
def test_where_series_end(system, q0, v0, kind, words):
    """They go on behind a point where a root is 0, and what they say there is wrong."""
    with pytest.raises(kind, match=words) as caught:
        dal.integrate(system, "reference", q0, v0, h=0.05, t_end=9, method="taylor")
    error, partial = caught.value, caught.value.partial
    assert error.t == partial.t[-1] and error.step == len(partial.t) - 1 and not partial.success
    whole = dal.integrate(system, "reference", q0, v0, h=0.05, t_end=error.t)
    np.testing.assert_allclose(partial.x, whole.x, rtol=0, atol=1e-9)
    run = dal.integrate(
        system, "reference", q0, v0, h=0.05, t_end=9, method="taylor", throw=False
    )
    np.testing.assert_array_equal(run.x, partial.x)
    with pytest.raises(kind, match=words):
        dal.reference(system, q0, v0, t=9, method="taylor")


def test_what_has_no_series():
    system = dal.System.from_sympy((x.d**2 + y.d**2) / 2 - sp.Abs(x), [])
    with pytest.raises(ValueError, match=r"taylor.*sign\(x\).*no Taylor series"):
        dal.reference(system, [1, 0], [0, 0], method="taylor")


def test_what_it_does_not_take():
    cvt, given = dal.systems.cvt(), {"h": 0.1, "t_end": 1, "method": "taylor"}
    with pytest.raises(ValueError, match="'sleigh' has no expressions"):
        dal.integrate(dal.systems.sleigh(), "reference", **given)
    with pytest.raises(ValueError, match="'sleigh' has no expressions"):
        dal.reference(dal.systems.sleigh(), method="taylor")
    for name, value in {
        "events": [lambda t, q, v: q[0]], "inputs": np.zeros((10, 1)), "journal": "run.dal",
    }.items():  # fmt: skip
        words = rf"^{name} = [^~]*: not used with method = 'taylor'"
        with pytest.raises(ValueError, match=words):
            dal.integrate(cvt, "reference", **given, **{name: value})
    with pytest.raises(ValueError, match="observer and t_eval are both given: expected one"):
        dal.integrate(cvt, "reference", **given, t_eval=[1], observer=lambda *_: None)
    with pytest.raises(NotImplementedError, match="coordinates: not supported by"):
        dal.reference(cvt, method="taylor", coordinates="xi")
    with pytest.raises(dal.NotOnConstraintError):
        dal.integrate(cvt, "reference", [0, 0, 0], [1, 1, 1], **given)
    for make in (
        lambda: dal.Stepper(cvt, dal.Scheme.flow("taylor"), h=0.1),
        lambda: dal.ensemble(cvt, "reference", **given),
    ):
        with pytest.raises(NotImplementedError, match="only in integrate and reference"):
            make()


def test_without_heyoka(monkeypatch):
    monkeypatch.setitem(sys.modules, "heyoka", None)
    with pytest.raises(ImportError, match="method='taylor' needs heyoka: pip install heyoka$"):
        dal.reference(dal.systems.cvt(), method="taylor", tolerance=1.25e-13)


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c():
    cvt = dal.systems.cvt()
    dal.reference(cvt, t=1, method="taylor")  # compiled now
    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt) as caught:
        dal.integrate(cvt, "reference", h=1e6, t_end=1e9, method="taylor")
    assert not caught.value.partial.success
