"""Dense output of "taylor": states from the polynomials of the steps."""

import pickle

import numpy as np
import pytest
import sympy as sp

import dalembert as dal
from dalembert import core
from dalembert.run.dense import Dense

x, y, z = dal.coordinates("x y z")
FALL = dal.System.from_sympy((x.d**2 + y.d**2) / 2 - x, [])
BOUNCE = dal.Event(x, direction=-1, reset={x.d: -x.d})


def height(s):
    """Return x of a ball that falls from 1 and bounces."""
    half = np.sqrt(2)
    phase = (s + half) % (2 * half)
    return phase * half - phase**2 / 2


@pytest.mark.parametrize("t_end", [50, -50])
def test_states(t_end):
    system = dal.systems.sleigh()
    run = dal.integrate(system, "taylor", t_end=t_end, dense=True)
    times = np.random.default_rng(2).uniform(0, 1, 300) * t_end
    found = run(times)
    order = np.argsort(abs(times))
    exact = dal.integrate(system, "taylor", t_end=t_end, t_eval=times[order])
    np.testing.assert_allclose(found.q[order], exact.q, rtol=0, atol=3e-14)
    np.testing.assert_allclose(found.v[order], exact.v, rtol=0, atol=3e-14)
    assert system.relative_residual(found.q, found.v).max() < 4e-16
    np.testing.assert_array_equal(np.hstack([run(run.t).q, run(run.t).v]), run.x)
    assert run.dense.span == (0, t_end)
    assert 0 < run.dense.count < 40 and run.dense.nbytes < 1e6
    assert "polynomials" in repr(run.dense)


@pytest.mark.parametrize("sizes", [{}, {"h": 0.3}])
def test_after_resets(sizes):
    run = dal.integrate(FALL, "taylor", [1, 0], [0, 1], t_end=30, events=[BOUNCE], dense=True,
                        **sizes)  # fmt: skip
    times = np.linspace(0, 30, 2001)
    np.testing.assert_allclose(run(times).q[:, 0], height(times), rtol=0, atol=1e-13)
    at = run(run.t_events[0])
    np.testing.assert_allclose(at.v[:, 0], np.sqrt(2), rtol=1e-13)


def test_ends():
    stop = dal.Event(x - 0.5, terminal=True)
    run = dal.integrate(FALL, "taylor", [1, 0], [0, 1], t_end=30, events=[stop], dense=True)
    assert run.dense.span == (0, 1) and abs(run(1).q[0] - 0.5) < 1e-15
    for t in (1.1, -0.1, np.inf, np.nan):
        with pytest.raises(ValueError, match="t = |finite"):
            run(t)
    between = dal.integrate(FALL, "taylor", [1, 0], [0, 1], t_end=2, t_eval=[0.3], dense=True)
    np.testing.assert_allclose(between([1.5, 2.0]).q[:, 0], [-0.125, -1], rtol=1e-15)


def test_inputs():
    u = sp.Symbol("u")
    driven = dal.System.from_sympy(x.d**2 / 2, force={x: u}, inputs=[u])
    run = dal.integrate(driven, "taylor", [0], [0], t_end=2, inputs=[[1], [-1]], hold=1, dense=True)
    np.testing.assert_allclose(run([0.5, 1.5, 2]).q[:, 0], [0.125, 0.875, 1], rtol=1e-14)


def test_copies_have_none():
    run = dal.integrate(FALL, "taylor", [1, 0], [0, 1], t_end=3, dense=True)
    copy = pickle.loads(pickle.dumps(run))
    assert copy.dense is None and abs(copy(1.3).q - run(1.3).q).max() < 1e-15
    assert dal.integrate(FALL, t_end=1, q0=[1, 0], v0=[0, 1]).dense is None


def test_refused():
    with pytest.raises(ValueError, match="dense = True: not used with the scheme 'reference'"):
        dal.integrate(dal.systems.sleigh(), "reference", t_end=1, dense=True)
    with pytest.raises(ValueError, match="dense = True: not used with a fixed step"):
        dal.integrate(dal.systems.sleigh(), "leapfrog", h=0.1, t_end=1, dense=True)


def test_other_parameters_are_refused():
    """A stepper of the same code with other parameters is another one."""
    k = sp.Symbol("k")
    spring = dal.System.from_sympy(x.d**2 / 2 - k * x**2 / 2, coordinates=[x], parameters={k: 1})
    scheme = dal.Scheme.find("taylor")
    dense = Dense(spring, scheme)
    other = scheme._stepped(spring.with_parameters(k=2))
    stepper = core.make("stepper", other._handle, scheme._record, core.ffi.NULL, owner=other)
    with pytest.raises(ValueError, match="dense belongs to another system"):
        with dense.keeping(stepper):
            pass
