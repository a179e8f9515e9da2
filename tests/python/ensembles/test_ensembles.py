"""Ensembles: every member has the bits of its own run, and what fails is one entry."""

from __future__ import annotations

import concurrent.futures as futures
import pickle
import signal
import warnings

import numpy as np
import pytest
import sympy
from scipy import stats

import dalembert as dal
from dalembert.ensembles import block

ALWAYS = {"status", "done", "t_end", "doubtful", *block.STATISTICS}


# ---- systems -----------------------------------------------------------------------------------


def skate(**values):
    """Return a skate with a spring, friction, two motors, and a mass that is not diagonal."""
    x, y, theta = dal.coordinates("x y theta")
    k, c, w = sympy.symbols("k c w")
    m = sympy.Symbol("m", positive=True)
    u, s = sympy.symbols("u s")
    L = (
        m * (x.d**2 + y.d**2) / 2 + theta.d**2 + w * x.d * theta.d / 4
        - k * (x**2 + sympy.Max(0, y) ** 2) / 2
    )
    return dal.System.from_sympy(
        L, [x.d * sympy.sin(theta) - y.d * sympy.cos(theta)], coordinates=[x, y, theta],
        parameters={"m": 1.0, "k": 2.0, "c": 0.1, "w": 0.5} | values,
        force={x: -c * x.d + u, theta: s}, inputs=[u, s], q0=[0.0, 0.0, 0.3],
        v0=[np.cos(0.3), np.sin(0.3), 0.7], name="skate",
    )  # fmt: skip


def in_python():
    """Return a skate of functions in Python."""
    return dal.System(
        mass=[1.0, 1.0, 0.5], mu=lambda q: [[np.sin(q[2]), -np.cos(q[2]), 0.0]],
        q0=[0, 0, 0.3], v0=[np.cos(0.3), np.sin(0.3), 0.7],
    )  # fmt: skip


def many(system, *given, **more):
    """Return an ensemble without a bar, with warnings as they come."""
    return dal.ensemble(system, *given, **{"progress": False, "threads": 2} | more)


def of_run(run, name):
    """Return what an ensemble keeps of a run."""
    names = [*run.system.coordinates, *(f"v_{x}" for x in run.system.coordinates)]
    return run.x[:, names.index(name)] if name in names else getattr(run, name)


def check_members(found, at_end=True, only=None):
    """Compare all that was kept with runs of `integrate`."""
    names = [name for name in found if name not in (*ALWAYS, "ended_by", "happened")]
    for k in range(len(found)) if only is None else only:
        steps = 2**62 if isinstance(found.h, str) else max(1, int(found.steps[k]))
        run = found.member(k, stride=steps if at_end else None)
        assert run.success == bool(found.success[k]), found.message(k)
        assert found.message(k) == run.message
        assert found.done[k] == run.stats.steps
        for name in block.STATISTICS:
            assert found[name][k] == getattr(run.stats, name), name
        for name in names:
            values = of_run(run, name)
            kept = found[name][k]
            if at_end and run.success and len(values):
                assert np.array_equal(kept, values[-1], equal_nan=True), name
            elif at_end:
                assert np.isnan(kept).all()
            else:
                assert np.array_equal(kept[: len(values)], values, equal_nan=True), name
                assert np.isnan(kept[len(values) :]).all()


# ---- bits --------------------------------------------------------------------------------------


RNG = np.random.default_rng(5)
PARAMETERS = {
    "sleigh": {"a": RNG.uniform(0.1, 0.4, 7), "J": RNG.uniform(0.5, 2, 7)},
    "rolling_disc": {"r": RNG.uniform(0.5, 2, 7)},
    "snakeboard": {"m": RNG.uniform(5.0, 7.0, 7)},
    "contact_oscillator": {},
}


@pytest.mark.parametrize(
    "name, scheme",
    [
        *(("sleigh", x) for x in ("leapfrog", "midpoint-nodes", "pair:0.5:0.25", "reference")),
        ("rolling_disc", "midpoint"), ("snakeboard", "leapfrog-kl6"),
        ("contact_oscillator", "midpoint"),
    ],
)  # fmt: skip
def test_members_are_runs(name, scheme):
    system = dal.systems.get(name)
    initial = "shift" if scheme.endswith("nodes") else None
    scale = np.linspace(0.5, 1.5, 7)[:, None]
    given = {"h": 0.01, "steps": 12, "initial": initial, "block": 3}
    found = many(system, scheme, parameters=PARAMETERS[name], **given)
    check_members(found)
    if not PARAMETERS[name]:
        found = many(system, scheme, scale * system.q0, scale * system.v0,
                     consistent="project", **given)  # fmt: skip
    keep = ["all", "energy", "residual", "multipliers", "reactions", system.coordinates[0]]
    found = many(system, scheme, parameters=PARAMETERS[name], keep=keep, stride=4, **given)
    assert found.q.shape == found.v.shape == (len(found), 4, system.n)
    check_members(found, at_end=False)


EACH = ["end", "q", "energy", "residual", "multipliers", "reactions"]


@pytest.mark.parametrize("word, scheme", [("auto", None), ("auto", "bm6"), ("reversible", None)])
def test_members_with_steps_of_their_own_sizes(word, scheme):
    system, values = dal.systems.sleigh(), PARAMETERS["sleigh"]
    ahead = many(system, scheme, parameters=values, h=word, t_end=20, keep=EACH, block=3)
    check_members(ahead)
    assert len({*ahead.done}) > 1 and (ahead.t == 20).all() and ahead.h == word
    assert (ahead.steps == ahead.done).all()
    if word == "auto":
        given = {"parameters": values, "h": word, "tolerance": 1e-5, "h_max": 0.1, "t0": 1.0}
        back = many(system, scheme, **given, t_end=-0.5, keep=EACH, max_iterations=20)
        check_members(back)
        assert (back.t == -0.5).all() and (back.done >= 15).all()
        kept = many(system, scheme, **given, t_end=1.5, energy="keep", keep=EACH)
        check_members(kept)
        assert (abs(kept.energy - [r.energy[0] for r in map(kept.member, range(7))]) < 1e-14).all()
    counts = many(system, scheme, parameters=values, h=word, t_end=20, keep=lambda run: len(run.t))
    assert (counts.value == ahead.done + 1).all()
    assert (many(system, h=word, t_end=0).q == system.q0).all()


def test_inputs_and_events_with_steps_of_variable_size():
    system, K = skate(), 5
    values = {"m": np.linspace(0.5, 2, K), "k": np.linspace(0, 4, K)}
    given = {"h": "auto", "t_end": 1.0, "keep": EACH, "parameters": values}
    check_members(many(system, **given, inputs=[0.5, -0.2]))
    check_members(many(system, **given, inputs=RNG.normal(size=(K, 4, 2)), hold=0.3))
    x, y, _ = dal.coordinates("x y theta")
    u, s = sympy.symbols("u s")
    law = {u: -2 * x, s: sympy.cos(dal.time)}
    found = many(system, **given, inputs=law, hold=0.07)
    assert block.is_in_c(found._spec.common)
    check_members(found)
    check_members(many(system, **given, inputs=lambda t, q, v: [q[0], t], hold=0.07))
    with pytest.raises(ValueError, match="hold is missing: with h = 'auto'"):
        many(system, **given, inputs=law)
    with pytest.raises(ValueError, match="inputs: expected shape"):
        many(system, **given, inputs=np.zeros((K, 5, 2)), hold=0.3)
    compiled = [dal.Event(x - 0.3, terminal=True), dal.Event(y - 0.05)]
    plain = [dal.Event(lambda t, q, v: q[0] - 0.3, terminal=True), lambda t, q, v: q[1] - 0.05]
    for inputs in ({}, {"inputs": law, "hold": 0.07}):
        for events in (compiled, plain):
            found = many(system, **given, events=events, **inputs)
            check_members(found)
            assert 0 in found.ended_by and found.happened[:, 1].any()


def test_failures_with_steps_of_variable_size():
    system = dal.systems.sleigh()
    v0 = system.v0 + np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 0.0]] * 2)
    values = {"J": [1.0, 2.0, 0.5, 1.5]}
    with pytest.warns(dal.DalembertWarning, match="2 of 4 members failed"):
        found = many(system, None, system.q0, v0, values, h="auto", t_end=1, block=4, keep=EACH)
    assert found.success.tolist() == [False, True] * 2 and np.isnan(found.q[::2]).all()
    check_members(found, only=[1, 3])
    x = dal.coordinates("x")[0]
    wall = dal.System.from_sympy(x.d**2 / 2 - sympy.log(1 - x), q0=[0], v0=[1])
    for events in ([], [lambda t, q, v: q[0] + 10.0]):  # in C, and one by one
        with pytest.warns(dal.DalembertWarning, match="2 of 2 members failed"):
            found = many(wall, None, [[0.0], [0.5]], [1.0], h="auto", t_end=5, events=events)
        for k in range(2):
            with pytest.raises(dal.DalembertError) as caught:
                found.member(k, throw=True)
            assert str(caught.value) in found.message(k)
            assert found.t_end[k] == caught.value.t > 0.1


def test_expressions_with_inputs_of_each_member():
    system, K = skate(), 6
    values = {"m": np.linspace(0.5, 2, K), "k": np.linspace(0, 4, K), "w": np.linspace(0, 1, K)}
    tables = RNG.normal(size=(K, 5, 2))
    for scheme in ("leapfrog", "midpoint"):
        found = many(system, scheme, parameters=values, inputs=tables, hold=4, h=0.02, steps=20,
                     keep=["energy", "v_theta", "multipliers", "reactions"], stride=5)  # fmt: skip
        check_members(found, at_end=False)
        assert not np.array_equal(found.energy[0], found.energy[1])
    single = many(system, parameters=values, inputs=[0.5, -0.2], h=0.02, steps=20)
    check_members(single)
    turned = many(system, parameters=values, h=0.02, steps=20,
                  inputs=lambda t, q, v: [-q[0], 0.1])  # fmt: skip
    check_members(turned)


def test_functions_of_python():
    scale = np.linspace(0.5, 1.5, 4)[:, None]
    system = in_python()
    found = many(system, "midpoint", system.q0, scale * system.v0, h=0.1, steps=8)
    check_members(found)
    whole = many(system, "midpoint", system.q0, scale * system.v0, h=0.1, steps=8, keep="all")
    check_members(whole, at_end=False)


def test_step_sizes_of_members():
    h = 0.1 / 2.0 ** np.arange(5)
    found = many(dal.systems.sleigh(), "midpoint", h=h, t_end=1)
    assert found.steps.tolist() == [10, 20, 40, 80, 160] and found.t.tolist() == [1.0] * 5
    check_members(found)
    q, _ = dal.systems.sleigh().exact(1.0)
    errors = abs(found.q - q).max(axis=1)
    assert (np.diff(np.log2(errors)) < -1.9).all()
    rows = many(dal.systems.sleigh(), "midpoint", h=h, steps=8, keep="all", stride=4)
    assert rows.t.shape == (5, 3) and rows.t[1, -1] == 8 * h[1]
    check_members(rows, at_end=False)


def test_time():
    """Rows are measured at the times of a trajectory, to the bit."""
    x, y = dal.coordinates("x y")
    push = sympy.Symbol("push")
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2 - push * x * sympy.sin(7 * dal.time), [y.d - x * x.d * dal.time],
        parameters={push: 1.0}, q0=[0.0, 0.0], v0=[1.0, 0.0],
    )  # fmt: skip
    found = many(system, parameters={"push": [1.0, 2.0]}, t0=0.3, h=0.07, steps=90, stride=3,
                 keep=["all", "energy", "residual", "multipliers"])  # fmt: skip
    check_members(found, at_end=False)


@pytest.mark.parametrize("is_compiled", [True, False])
def test_events(is_compiled):
    system = skate()
    x, _, theta = dal.coordinates("x y theta")
    wall = sympy.Symbol("k") / 8
    if is_compiled:
        events = [dal.Event(x - wall, terminal=True), dal.Event(sympy.sin(3 * theta))]
    else:
        events = [dal.Event(lambda t, q, v: q[0] - 0.25, terminal=True),
                  dal.Event(lambda t, q, v: np.sin(3 * q[2]))]  # fmt: skip
    values = {"k": [2.0] * 4 if not is_compiled else [0.5, 1.0, 2.0, 80.0]}
    speeds = np.array([0.5, 1.0, 2.0, 0.01])[:, None] * system.v0
    found = many(system, "midpoint", system.q0, speeds, values, events=events, h=0.01, steps=150)
    assert {-1, 0} == {*found.ended_by.tolist()}
    for k in range(4):
        run = found.member(k)
        assert found.t[k] == run.t[-1] and (found.q[k] == run.q[-1]).all()
        assert found.happened[k].tolist() == [len(t) for t in run.t_events]
        assert found.message(k) == run.message
    rows = many(system, "midpoint", system.q0, speeds, values, events=events, h=0.01, steps=150,
                keep=["all", "energy"], stride=50)  # fmt: skip
    check_members(rows, at_end=False)


def test_resets():
    bounce = dal.Event(lambda t, q, v: q[0] - 0.4, direction=1, reset=lambda q, v: (q, -v))
    found = many(dal.systems.knife_edge(), parameters={"gs": [2.0, 2.5, 3.0]}, h=0.01, t_end=4,
                 events=[bounce])  # fmt: skip
    check_members(found)
    assert (found.happened[:, 0] > 1).all() and (found.ended_by == -1).all()


def test_laws_have_the_parameters_of_each_member(tmp_path):
    """Controllers and resets that are expressions are made in C; a mass held by its feedback."""
    x, (gain, e, push) = dal.coordinates("x")[0], sympy.symbols("gain e push")
    system = dal.System.from_sympy(
        x.d**2 / 2, force={x: push}, inputs=[push], parameters={gain: 9.0, e: 9.0}, q0=[1], v0=[0]
    )
    gains, kept = np.array([0.5, 1.0, 4.0]), np.array([0.1, 0.5, 0.75])
    values = {"gain": gains, "e": kept}
    wall = dal.Event(x, direction=-1, reset={x.d: -e * x.d, x: x})
    options = {"h": 0.01, "parameters": values, "hold": 10, "inputs": {push: -gain * x}}
    found = many(system, **options, steps=100)
    assert block.is_in_c(found._spec.common)
    check_members(found)
    for k, stiffness in enumerate(gains):
        step = np.array([[1 - stiffness * 0.005, 0.1], [-stiffness * 0.1, 1]])
        expected = np.linalg.matrix_power(step, 10) @ [1, 0]
        np.testing.assert_allclose([found.q[k, 0], found.v[k, 0]], expected, atol=1e-13)
    thrown = many(system, q0=[1], v0=[-2], parameters=values, h=0.01, steps=80, events=[wall])
    assert block.is_in_c(thrown._spec.common) and (thrown.happened == 1).all()
    np.testing.assert_allclose(thrown.q[:, 0], 2 * kept * 0.3, atol=1e-12)
    rows = many(system, **options, steps=100, events=[wall], keep=["all", "energy"])
    check_members(rows, at_end=False)
    whole = many(system, **options, steps=100, store=tmp_path)
    np.testing.assert_array_equal(whole.q, found.q)
    with pytest.raises(ValueError, match="differs in control"):
        many(system, **options | {"inputs": {push: -2 * gain * x}}, steps=100, store=tmp_path)


def test_reductions():
    def of(run):
        return {"drift": np.ptp(run.energy), "last": run.q[-1]}

    values = {"a": [0.1, 0.2, 0.3]}
    found = many(dal.systems.sleigh(), parameters=values, h=0.01, steps=50, keep=of)
    assert found.last.shape == (3, 3) and found.drift.shape == (3,)
    for k in range(3):
        assert found.drift[k] == np.ptp(found.member(k).energy)
    one = many(dal.systems.sleigh(), parameters=values, h=0.01, steps=50,
               keep=lambda run: run.q[-1, 0])  # fmt: skip
    assert (one.value == found.last[:, 0]).all()

    def of_any_length(run):
        return np.zeros(int(10 * run.system.parameters["a"] + 0.5))

    odd = {"parameters": values, "h": 0.01, "steps": 50, "keep": of_any_length}
    with pytest.warns(dal.DalembertWarning, match="2 of 3 members failed.*shape"):
        found = many(dal.systems.sleigh(), block=3, **odd)
    assert found.failed.tolist() == [1, 2]
    with pytest.raises(ValueError, match="of shape"):
        many(dal.systems.sleigh(), block=1, **odd)


def test_any_order_threads_and_blocks():
    system = skate()
    values = {"m": RNG.uniform(0.5, 2, 40)}
    given = {"parameters": values, "h": 0.02, "steps": 30, "keep": ["all", "energy"]}
    one = many(system, "leapfrog", threads=1, block=40, **given)
    for threads, block in ((2, 1), (3, 7), (1, None)):
        other = many(system, "leapfrog", threads=threads, block=block, **given)
        for name in one:
            assert np.array_equal(one[name], other[name], equal_nan=True), (name, threads, block)
    order = RNG.permutation(40)
    other = many(system, "leapfrog", **given | {"parameters": {"m": values["m"][order]}})
    assert np.array_equal(other.q, one.q[order])


# ---- failures ----------------------------------------------------------------------------------


def failing():
    """Return members of which some fail: initial data, parameter, domain, singular, h too large."""
    x, y, theta = dal.coordinates("x y theta")
    m, b, s = sympy.Symbol("m", positive=True), sympy.Symbol("b"), sympy.Symbol("s")
    system = dal.System.from_sympy(
        m * (x.d**2 + y.d**2) / 2 + theta.d**2 / 2 - sympy.sqrt(1 - b * x) / 8 - s * x**4,
        [x.d * sympy.sin(theta) - y.d * sympy.cos(theta)],
        parameters={"m": 1.0, "b": 0.0, "s": 0.0}, name="failing",
    )  # fmt: skip
    K = 9
    q0 = np.zeros((K, 3))
    v0 = np.tile([1.0, 0.0, 0.1], (K, 1))
    m, b, s = np.ones(K), np.zeros(K), np.zeros(K)
    v0[1] = [0.0, 1.0, 0.0]  # not in D
    m[3] = -1.0
    b[4] = 1.0  # a root, until x = 1
    q0[5, 0] = 1.5
    b[5] = 1.0
    s[7] = 1e9  # blows up
    return system, q0, v0, {"m": m, "b": b, "s": s}


def test_failed_members_are_entries():
    system, q0, v0, values = failing()
    given = {"h": 0.05, "steps": 40}
    with pytest.warns(dal.DalembertWarning, match=r"5 of 9 members failed.*NotOnConstraintError"):
        found = many(system, "midpoint", q0, v0, values, block=4, **given)
    assert found.failed.tolist() == [1, 3, 4, 5, 7]
    for k in range(9):
        own = system
        try:
            own = system.with_parameters(**{name: x[k] for name, x in values.items()})
            run = dal.integrate(own, "midpoint", q0[k], v0[k], throw=False, **given)
        except Exception as error:
            assert found.message(k) == f"{type(error).__name__}: {error}"
            assert found.done[k] == 0 and np.isnan(found.t_end[k]) and np.isnan(found.q[k]).all()
            with pytest.raises(type(error)):
                found.member(k)
            continue
        assert found.message(k) == run.message
        assert found.done[k] == run.stats.steps and found.t_end[k] == run.t[-1]
        assert np.isnan(found.q[k]).all() == (not run.success)
    assert "NotOnConstraintError" in found.message(1) and "project" in found.message(1)
    assert found.message(3).startswith("ValueError: m = -1: expected a positive number")
    with pytest.warns(dal.DalembertWarning):
        rows = many(system, "midpoint", q0, v0, values, keep=["all", "energy"], stride=4, **given)
    check_members(rows, at_end=False, only=[0, 2, 4, 6, 7, 8])
    assert "5 failed" in repr(found) and "4 completed" in repr(found)


def test_exceptions_of_functions_are_entries():
    def forms(q):
        if q[0] > 0.5:
            raise KeyError("too far")
        return [[np.sin(q[2]), -np.cos(q[2]), 0.0]]

    system = dal.System(mass=[1, 1, 1], mu=forms, q0=[0, 0, 0], v0=[1, 0, 0.1])
    speed = np.array([0.1, 1.0, 0.2])[:, None] * system.v0
    with pytest.warns(dal.DalembertWarning, match="1 of 3 members failed.*too far"):
        found = many(system, "leapfrog", system.q0, speed, h=0.1, t_end=2)
    assert found.failed.tolist() == [1] and 4 <= found.done[1] <= 5
    assert found.message(1) == "KeyError: 'too far'"
    with pytest.raises(KeyError):
        found.member(1, throw=True)


def test_ranges_of_parameters_of_the_library():
    with pytest.warns(dal.DalembertWarning, match="2 of 3"):
        found = many(dal.systems.sleigh(), parameters={"J": [1.0, -1.0, 0.0]}, h=0.1, steps=5)
    with pytest.raises(ValueError) as raised:
        dal.systems.sleigh(J=-1.0)
    assert found.message(1) == f"ValueError: {raised.value}"
    with pytest.warns(dal.DalembertWarning, match="expected n = "):
        found = many(dal.systems.n_trailer(), parameters={"trailers": [2, 3]}, h=0.01, steps=5)


def test_doubtful_members():
    system = dal.systems.particle_oscillator()
    h = [0.01, 1.99]
    speed = np.array([0.1, 1.0, 100.0])[:, None, None] * system.v0
    with pytest.warns(dal.DalembertWarning) as caught:
        found = many(system, "midpoint", system.q0 * 1.0, speed, h=h, steps=500,
                     consistent="project")  # fmt: skip
    expected = []
    for k in range(len(found)):
        with warnings.catch_warnings(record=True) as own:
            warnings.simplefilter("always")
            found.member(k)
        expected.append(any(issubclass(w.category, dal.DalembertWarning) for w in own))
    assert found.doubtful.tolist() == expected
    if any(expected):
        assert any("doubtful" in str(w.message) for w in caught)


def test_doubtful_events():
    """A ball that just reaches a height within a step, one that does not, one that is above it."""
    (x,) = dal.coordinates(["x"])
    ball = dal.System.from_sympy(x.d**2 / 2 - 9 * x)
    for event in (x - sympy.Rational(1, 2), lambda t, q, v: q[0] - 0.5):
        with pytest.warns(dal.DalembertWarning, match="1 of 4 members are doubtful"):
            found = many(ball, "midpoint", [0.0], [[2.0], [3.0], [2.5], [4.0]], h=0.31, steps=3,
                         events=[event])  # fmt: skip
        assert found.doubtful.tolist() == [False, True, False, False]
        assert found.happened[:, 0].tolist() == [0, 0, 0, 2]


# ---- what is refused ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "given"),
    [
        ("system", {"system": "sleigh"}),
        ("q0: expected shape", {"q0": np.zeros((4, 2)), "v0": np.zeros((4, 2))}),
        ("v0", {"q0": np.zeros((4, 3))}),
        (r"do not broadcast.*q0: \(4,\)", {"q0": np.zeros((4, 3)), "v0": np.zeros((3, 3))}),
        ("has no 'b'", {"parameters": {"b": [1.0]}}),
        (r"parameters\['a'\]\[1\] = nan", {"parameters": {"a": [1.0, np.nan]}}),
        ("at least one member", {"parameters": {"a": []}}),
        ("h", {"h": 0.0}),
        ("t_end and steps", {"t_end": 1.0}),
        ("keep", {"keep": "everything"}),
        ("keep", {"keep": ["end", "all"]}),
        ("stride = 3", {"keep": "all", "stride": 3}),
        ("only the end is kept", {"stride": 2}),
        ("threads", {"threads": 0}),
        ("block", {"block": 0}),
        ("executor", {"executor": 3, "threads": None}),
        ("initial", {"initial": "shift"}),
        ("no inputs", {"inputs": [1.0]}),
        ("hold = 2", {"hold": 2}),
        ("progress", {"progress": "yes"}),
    ],
)
def test_refusals(words, given):
    whole = {"system": dal.systems.sleigh(), "h": 0.1, "steps": 10} | given
    with pytest.raises(ValueError, match=words):
        many(**whole)


def test_parameters_of_a_system_without():
    with pytest.raises(ValueError, match="'m' is given, but the system .* has none"):
        many(in_python(), parameters={"m": [1, 2]}, h=0.1, steps=1)


def test_memory():
    with pytest.raises(MemoryError, match="keep fewer quantities, or pass store="):
        many(dal.systems.sleigh(), parameters={"a": np.ones(100_000)}, h=0.1, steps=10**9,
             keep="all")  # fmt: skip


def test_names_that_mean_two_things():
    system = dal.System(mass=[1, 1], coordinates=["u", "v_u"], q0=[0, 50], v0=[1, 0])
    energy = dal.System(mass=[1], coordinates=["energy"], q0=[0], v0=[1])
    for one, name in ((system, "v_u"), (energy, "energy")):
        with pytest.raises(ValueError, match="a coordinate and of another quantity"):
            many(one, h=0.1, steps=1, keep=name)


@pytest.mark.parametrize("returned", [{1: 2.0}, {"a b": 1.0}, {"file": 1.0}, {"status": 1.0}, None,
                                      "text", np.ma.masked_array([1.0], [True]),
                                      np.datetime64("2020-01-01"), [[1.0], 2.0]])  # fmt: skip
def test_what_reductions_may_not_return(returned):
    with pytest.warns(dal.DalembertWarning, match="1 of 1 members failed"):
        found = many(dal.systems.sleigh(), h=0.1, steps=1, keep=lambda run: returned)
    assert "ValueError: keep" in found.message(0) and repr(found)


def test_an_exception_that_cannot_be_shown():
    class Silent(Exception):
        def __str__(self):
            raise KeyError

    def fail(run):
        raise Silent

    with pytest.warns(dal.DalembertWarning, match="Silent"):
        found = many(dal.systems.sleigh(), h=0.1, steps=1, keep=fail)
    assert found.message(0) == "Silent"


@pytest.mark.parametrize("is_compiled", [True, False])
def test_what_is_not_defined_at_a_row(is_compiled):
    """The run goes on, as by itself; the quantity is NaN there, and the member doubtful."""
    x, y = dal.coordinates("x y")
    system = dal.System.from_sympy((x.d**2 + y.d**2) / 2 - sympy.log(y) / 100)
    events = [] if is_compiled else [lambda t, q, v: q[0] - 100]
    with pytest.warns(dal.DalembertWarning, match="1 of 2 members are doubtful"):
        found = many(system, "explicit", [0.0, 1.0], [[1.0, 0.0], [1.0, -0.6]], h=0.5, steps=6,
                     keep=["all", "energy"], events=events)  # fmt: skip
    assert found.success.all() and found.doubtful.tolist() == [False, True]
    assert (found.q[1] == found.member(1).q).all()
    assert np.isnan(found.energy[1]).sum() == (found.q[1, :, 1] <= 0).sum() > 0


def test_partial_of_nothing():
    def fail(run):
        raise SystemExit

    with pytest.raises(SystemExit) as raised:
        many(dal.systems.sleigh(), h=0.1, steps=1, keep=fail)
    partial = raised.value.partial
    assert len(partial.unfinished) == 1 and "1 were not finished" in repr(partial)


def test_xarray_of_names_that_collide():
    found = many(dal.systems.sleigh(), h=0.1, steps=4, parameters={"a": [0.1, 0.2]},
                 axes=["status"], keep=["all"])  # fmt: skip
    dataset = found.to_xarray()
    assert (dataset.status.values == 0).all() and dataset.status.dims == ("status_axis",)
    vector = many(dal.systems.sleigh(), h=0.1, steps=2, keep=lambda run: np.ones((3, 2)))
    assert vector.to_xarray().value.shape == (1, 3, 2)


def test_steps_zero_with_inputs_of_members():
    found = many(skate(), h=0.1, steps=0, inputs=np.zeros((3, 0, 2)))
    assert len(found) == 3 and (found.done == 0).all()


# ---- designs -----------------------------------------------------------------------------------


def test_grid():
    design = dal.grid(a=[0.1, 0.2], J=[1, 2, 3])
    found = many(dal.systems.sleigh(), parameters=design, h=0.01, steps=5)
    assert found.shape == (2, 3) and found.axes == ("a", "J")
    assert (found.parameters["J"] == [1, 2, 3, 1, 2, 3]).all()
    check_members(found)
    dataset = found.to_xarray()
    assert dataset.q.dims == ("a", "J", "coordinate")
    assert (dataset.q.sel(a=0.2, J=3).values == found.q[5]).all()
    q0 = np.zeros((4, 1, 1, 3))
    v0 = np.array([1.0, 2, 3, 4])[:, None, None, None] * dal.systems.sleigh().v0
    wide = many(dal.systems.sleigh(), "leapfrog", q0, v0, design, h=0.01, steps=5,
                consistent="project")  # fmt: skip
    assert wide.shape == (4, 2, 3)
    check_members(wide, only=[0, 7, 23])
    for wrong in ({}, {"a": []}, {"a": [[1.0]]}):
        with pytest.raises(ValueError):
            dal.grid(**wrong)


def test_sample():
    design = dal.sample(64, seed=3, a=(0.1, 0.3), J=stats.norm(1, 0.1))
    again = dal.sample(64, seed=3, a=(0.1, 0.3), J=(0, 1))
    assert design.shape == (64,) and (design["a"] == again["a"]).all()
    counts, _ = np.histogram(design["a"], 8, (0.1, 0.3))
    assert (counts == 8).all()
    assert abs(design["J"].mean() - 1) < 0.01
    assert (dal.sample(64, seed=4, a=(0.1, 0.3))["a"] != design["a"]).any()
    for method in ("halton", "lhs"):
        assert dal.sample(5, method=method, a=(1, 2))["a"].shape == (5,)
    for wrong in ({"a": (2, 1)}, {"a": 1}, {}):
        with pytest.raises(ValueError):
            dal.sample(4, **wrong)
    with pytest.raises(ValueError, match="method"):
        dal.sample(4, method="random", a=(0, 1))


# ---- stopping ----------------------------------------------------------------------------------


@pytest.mark.usefixtures("ctrl_c")
def test_interrupt_keeps_what_was_made():
    system, K = dal.systems.sleigh(), 2000

    def press(done, total):
        if done > 60:  # more than what two threads have begun and not finished
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt) as raised:
        many(system, parameters={"a": np.full(K, 0.2)}, h=0.001, steps=100_000, block=20,
             threads=2, progress=press)  # fmt: skip
    partial = raised.value.partial
    made = np.flatnonzero(partial.status == 0)
    assert 0 < len(made) < K and len(partial.unfinished) == K - len(made)
    assert np.isfinite(partial.q[made]).all()
    assert (partial.q[made] == partial.q[made[0]]).all()
    assert np.isnan(partial.q[partial.unfinished]).all()
    assert "not finished" in partial.message(int(partial.unfinished[0]))


def test_progress():
    seen = []
    many(dal.systems.sleigh(), parameters={"a": np.full(300, 0.2)}, h=0.01, steps=5_000,
         progress=lambda done, total: seen.append((done, total)))  # fmt: skip
    done = [one for one, _ in seen]
    assert done == sorted(done) and done[-1] == 300 and len(done) > 3
    assert {total for _, total in seen} == {300}


# ---- executors ---------------------------------------------------------------------------------


def test_processes():
    system = skate()
    values = {"m": RNG.uniform(0.5, 2, 23)}
    given = {"parameters": values, "h": 0.02, "steps": 30, "keep": ["all", "energy"]}
    here = many(system, "midpoint", **given)
    auto = {"parameters": values, "h": "auto", "t_end": 0.5, "keep": EACH}
    with futures.ProcessPoolExecutor(2) as executor:
        there = many(system, "midpoint", executor=executor, threads=None, block=5, **given)
        varied = many(system, executor=executor, threads=None, block=9, **auto)
    for name, x in many(system, **auto).items():
        assert np.array_equal(x, varied[name], equal_nan=True), name
    again = many(system, "midpoint", executor=lambda: futures.ProcessPoolExecutor(2),
                 threads=None, block=7, **given)  # fmt: skip
    for name in here:
        assert np.array_equal(here[name], there[name], equal_nan=True)
        assert np.array_equal(here[name], again[name], equal_nan=True)


def test_what_does_not_pickle():
    with futures.ProcessPoolExecutor(1) as executor:
        with pytest.raises(pickle.PicklingError, match="mu"):
            many(in_python(), h=0.1, steps=1, executor=executor, threads=None)


def test_a_member_is_named_by_its_number_or_its_place_along_the_axes():
    sleigh = dal.systems.sleigh()
    speeds = np.array([0.5, 1.0, 2.0])[:, None, None] * sleigh.v0
    found = dal.ensemble(sleigh, "midpoint", sleigh.q0, speeds, h=[0.01, 0.02], steps=5)
    assert found.shape == (3, 2)
    for place, k in (((0, 0), 0), ((0, 1), 1), ((2, 1), 5), ((-1, 0), 4), ((np.int64(1), -1), 3)):
        run = found.member(place)
        assert (run.q[-1] == found.q[k]).all() and run.h == found.h[k]
        assert found.message(place) == found.message(k)
    for place, text in (
        ((3, 0), r"k\[0\] = 3: expected at most 2"),
        ((0, -3), r"k\[1\] = -3: expected at least -2"),
        ((0, 0.5), r"k\[1\] = 0.5: expected an integer"),
        ((1,), r"k = \(1,\): expected a number, or 2 numbers"),
        (6, r"there is no member 6: expected 0 to 5"),
        (-7, r"there is no member -7: expected 0 to 5"),
    ):
        with pytest.raises(ValueError, match=text):
            found.member(place)
