"""Members in lanes: the runs of `integrate` to roundoff, the same whatever lies beside them."""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

import dalembert as dal
from dalembert.core import lib
from dalembert.ensembles import api, block
from dalembert.system import twins
from dalembert.symbolic import expressions

U = 2.0**-53
RNG = np.random.default_rng(8)


def many(system, *given, **more):
    return dal.ensemble(system, *given, **{"progress": False, "threads": 2, "lanes": True} | more)


def skate():
    x, y, theta = dal.coordinates("x y theta")
    k, b = sympy.symbols("k b")
    m = sympy.Symbol("m", positive=True)
    return dal.System.from_sympy(
        m * (x.d**2 + y.d**2) / 2 + theta.d**2 / 2 - k * x**2 / 2 + sympy.sqrt(1 - b * y) / 8,
        [x.d * sympy.sin(theta) - y.d * sympy.cos(theta)],
        parameters={m: 1.0, k: 1.0, b: 0.0}, name="skate",
    )  # fmt: skip


def data(K):
    """Return initial data and parameters, of which some are refused or leave the domain."""
    v0 = np.tile([1.0, 0.0, 0.4], (K, 1)) * RNG.uniform(0.5, 1.5, (K, 1))
    values = {"m": RNG.uniform(0.5, 2, K), "k": RNG.uniform(0, 2, K), "b": np.zeros(K)}
    v0[3] = [0.0, 1.0, 0.0]
    values["m"][7] = -1.0
    values["b"][11] = 20.0  # a root, until y = 1/20
    values["k"][13] = 1e5
    return np.zeros(3), v0, values


@pytest.mark.parametrize("scheme", ["midpoint", "leapfrog-kl6"])
def test_lanes_are_runs(scheme):
    q0, v0, values = data(37)
    keep = ["all", "energy", "residual", "multipliers", "reactions", "theta"]
    given = {"h": 0.02, "steps": 100, "stride": 20, "keep": keep}
    with pytest.warns(dal.DalembertWarning, match="of 37 members failed"):
        plain = many(skate(), scheme, q0, v0, values, lanes=False, **given)
    with pytest.warns(dal.DalembertWarning, match="of 37 members failed"):
        there = many(skate(), scheme, q0, v0, values, **given)
    assert (there.status == plain.status).all() and (there.done == plain.done).all()
    assert {3, 7, 11} <= {*there.failed.tolist()}
    for k in there.failed.tolist():
        assert there.message(k) == plain.message(k)
    for name in plain.kept:
        size = np.nanmax(abs(plain[name]), initial=1e-3)
        assert np.isnan(there[name]).sum() == np.isnan(plain[name]).sum(), name
        error = abs(there[name] - plain[name])
        error[13] = 0  # which is stiff
        assert np.nanmax(error) <= 1e-11 * max(size, 1), name
    good = there.success
    assert there.worst_residual[good].max() <= 4 * 3 * U


def test_series_of_four_are_runs_to_the_bit():
    """Members that are refused, that leave the domain, and a single one at the end of a block."""
    q0, v0, values = data(38)
    given = {"h": 0.5, "steps": 12, "stride": 3, "keep": ["all", "energy", "residual", "theta"]}
    with pytest.warns(dal.DalembertWarning, match="of 38 members failed"):
        plain = many(skate(), "taylor", q0, v0, values, lanes=False, **given)
        several = [many(skate(), "taylor", q0, v0, values, block=k, **given) for k in (1, 6, 38)]
    assert {3, 7, 11} <= {*plain.failed.tolist()} and plain.success.sum() > 30
    for there in several:
        assert there.lanes and (there.status == plain.status).all()
        assert (there.done == plain.done).all()
        assert [there.message(k) for k in range(38)] == [plain.message(k) for k in range(38)]
        for name in plain.kept:
            np.testing.assert_array_equal(there[name], plain[name], err_msg=name)
    run = dal.integrate(skate().with_parameters(k=values["k"][5], m=values["m"][5]), "taylor",
                        q0, v0[5], h=0.5, steps=12)  # fmt: skip
    np.testing.assert_array_equal(run.x[::3, :3], plain["q"][5])


def test_series_of_four_are_computed_together():
    """The system is compiled with a series for four motions, also one that is built in."""
    x, y, z = dal.coordinates("x y z")
    springs = dal.System.from_sympy(
        (x.d**2 + y.d**2 + z.d**2 - x**2 - 2 * y**2) / 2, [z.d - y * x.d], q0=[1, 0, 0],
        v0=[0, 1, 0],
    )  # fmt: skip
    for system in (springs, dal.systems.particle_oscillator()):
        twin = twins.twin(system, "four series")
        assert lib.dal_system_has_series(twin._handle) == 2
        v0 = np.outer(np.linspace(0.5, 2, 9), system.v0)
        ends = [many(system, "taylor", v0=v0, q0=system.q0, h=1.0, steps=7, lanes=lanes)
                for lanes in (False, True)]  # fmt: skip
        np.testing.assert_array_equal(*(end.q for end in ends))
        assert ends[1].lanes and not ends[0].lanes


def test_series_of_four_with_conditions_on_parameters():
    """A power whose exponent is a parameter, and formulas that parameters choose."""
    x, y = dal.coordinates("x y")
    c, d = sympy.symbols("c d")
    by_case = sympy.Piecewise(
        (x**2, (c > 1) & (d < 2)), (x, sympy.Or(c < 0.5, sympy.Not(d >= 1))), (x**4, True)
    )
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2 - ((x + 2) ** c + c) ** (-d) - by_case, [y.d - x * x.d],
        parameters={c: 1, d: 1}, q0=[0.3, 0.2], v0=[1, 0.3],
    )  # fmt: skip
    values = {"c": np.array([2.5, 2.6, 0.3, 1.1, 2.2]), "d": np.array([0.5, 3, 3, 2.5, 0])}
    plain, several = (many(system, "taylor", parameters=values, h=0.5, steps=2, lanes=lanes)
                      for lanes in (False, True))  # fmt: skip
    assert several.lanes and several.success.all()
    np.testing.assert_array_equal(several.q, plain.q)


def test_series_of_four_with_many_refusals():
    """The members behind a block of refused ones are led on."""
    values = {"m": np.array([-1.0] * 20 + [1.0] * 4), "k": np.ones(24), "b": np.zeros(24)}
    given = {"h": 0.5, "steps": 4, "threads": 1}
    with pytest.warns(dal.DalembertWarning, match="20 of 24 members failed"):
        plain, several = (
            many(skate(), "taylor", np.zeros(3), [1, 0, 0.4], values, lanes=lanes, **given)
            for lanes in (False, True)
        )
    assert several.success.sum() == 4 and several.message(3) == plain.message(3)
    np.testing.assert_array_equal(several.q, plain.q)


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_in_a_long_step():
    x, y = dal.coordinates("x y")
    fast = dal.System.from_sympy((x.d**2 + y.d**2) / 2 - 10**10 * x**2 / 2 - y**4, [])
    many(fast, "taylor", [1, 1], np.ones((5, 2)), h=0.1, steps=1)  # which compiles it
    begun = time.perf_counter()
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        many(fast, "taylor", [1, 1], np.ones((5, 2)), h=1e4, steps=1, threads=1)
    assert time.perf_counter() - begun < 5


@pytest.mark.parametrize("power", [False, True])
def test_series_of_four_see_a_wall_that_grows(power):
    """The coefficients of the first piece do not show exp(-1000 x), nor (1 - x)^60 at x = 1."""
    x, y = dal.coordinates("x y")
    V = (x - 1) ** 60 if power else sympy.exp(-1000 * x)
    wall = dal.System.from_sympy((x.d**2 + y.d**2) / 2 - V, [])
    v0 = np.column_stack([np.linspace(-0.5, -1.5, 8), np.ones(8)])
    ends = [many(wall, "taylor", [1, 0], v0, h=0.5, steps=6, lanes=lanes).v
            for lanes in (False, True)]  # fmt: skip
    np.testing.assert_array_equal(*ends)
    assert (abs(ends[0][:, 0]) <= 1.000001 * abs(v0[:, 0])).all()
    assert power or (ends[0][:, 0] > 0).all()  # all have come back


def test_order_threads_and_blocks_change_no_bit():
    q0, v0, values = data(61)
    given = {"h": 0.03, "steps": 60, "keep": ["all", "energy", "reactions"], "stride": 15}
    with pytest.warns(dal.DalembertWarning):
        one = many(skate(), "midpoint", q0, v0, values, threads=1, block=61, **given)
        for threads, block in ((2, 1), (2, 7), (3, 16), (2, 40)):
            other = many(skate(), "midpoint", q0, v0, values, threads=threads, block=block, **given)
            for name in one:
                assert np.array_equal(one[name], other[name], equal_nan=True), (name, block)
        order = RNG.permutation(61)
        moved = {name: x[order] for name, x in values.items()}
        other = many(skate(), "midpoint", q0, v0[order], moved, **given)
    for name in one:
        assert np.array_equal(one[name][order], other[name], equal_nan=True), name


def test_systems_of_the_library(tmp_path):
    """They are made in lanes from their formulas, and refuse what they refuse."""
    values = {"a": np.linspace(0.1, 0.3, 20), "J": np.linspace(0.5, 1, 20)}
    values["J"][4] = -1.0
    given = {"parameters": values, "h": 0.01, "steps": 1000}
    with pytest.warns(dal.DalembertWarning, match="1 of 20 members failed.*parameter J of sleigh"):
        plain = many(dal.systems.sleigh(), lanes=False, **given)
        there = many(dal.systems.sleigh(), **given)
        kept = many(dal.systems.sleigh(), store=tmp_path / "store", **given)
    assert twins.twin(dal.systems.sleigh(), "lanes") is not None
    assert there.lanes and "by leapfrog in lanes: 19 completed" in repr(there)
    good = there.success
    assert there.message(4) == plain.message(4) and good.sum() == 19
    size = abs(plain.q[good]).max()
    assert 0 < abs(there.q - plain.q)[good].max() <= 1e-12 * size
    assert (there.steps == plain.steps).all() and np.array_equal(there.q, kept.q, equal_nan=True)
    assert np.array_equal(dal.open_ensemble(tmp_path / "store").q, kept.q, equal_nan=True)
    wild = dal.systems.sleigh()
    q0, v0 = wild.q0, wild.v0 + np.outer(np.linspace(0, 1, 5), [0, 0, 1e-9])
    off = many(wild, "midpoint", q0, v0, h=0.01, steps=10)
    assert (off.initial_correction[1:] > 0).all() and off.initial_correction[0] == 0


def test_formulas_that_do_not_say_the_same(monkeypatch):
    other = expressions.model(dal.systems.knife_edge())
    monkeypatch.setattr(twins, "expressions", SimpleNamespace(model=lambda system: other))
    assert twins.twin(dal.systems.sleigh(), "lanes") is None


def test_what_has_no_lanes():
    """It is made as without, to the bit, and the ensemble says so and why."""
    train = dal.systems.n_trailer(trailers=6)
    assert twins.twin(train, "lanes") is None
    values = {"a": np.linspace(0.18, 0.22, 5)}
    given = {"h": 0.01, "steps": 20}
    x, a, u = *dal.coordinates("x"), *sympy.symbols("a u")
    start = {"parameters": {a: 1.0}, "q0": [0.5], "v0": [0]}
    kinked = dal.System.from_sympy(x.d**2 / 2 - a * abs(x), [], name="kinked", **start)
    pushed = dal.System.from_sympy(x.d**2 / 2, [], force={x: a * u}, inputs=[u], **start)
    for system, scheme, more, why in (
        (train, "midpoint", {}, "'n_trailer' needs .* at most 8 coordinates"),
        (dal.systems.sleigh(), "midpoint-nodes", {"initial": "shift"}, "'midpoint-nodes' has kept"),
        (dal.systems.sleigh(), "pair:0.5:0.5", {}, "'pair:0.5:0.5' has .* no sub-steps"),
        (dal.systems.sleigh(), "reference", {}, "'reference' has .* no sub-steps"),
        (dal.systems.sleigh(), "midpoint", {"events": [lambda t, q, v: q[0] - 0.01]}, "events"),
        (dal.systems.sleigh(), "midpoint", {"energy": "keep"}, "energy"),
        (kinked, "taylor", {}, "'kinked' has kinks or jumps"),
        (pushed, "taylor", {"inputs": [0.1]}, "inputs change the series"),
        (dal.systems.sleigh(), "midpoint", {"keep": lambda run: run.q[-1]}, "Python functions"),
    ):
        chosen = given if system is train else given | {"parameters": values}
        one = many(system, scheme, lanes=False, **chosen, **more)
        assert not one.lanes and "in lanes" not in repr(one)
        with pytest.warns(dal.DalembertWarning, match=f"^lanes = True has no effect, .*: .*{why}"):
            two = many(system, scheme, **chosen, **more)
        assert not two.lanes and "in lanes" not in repr(two)
        for name in one:
            assert np.array_equal(one[name], two[name], equal_nan=True), (scheme, name)


def test_steps_of_variable_size_have_no_lanes(monkeypatch):
    given = {"parameters": {"a": np.linspace(0.1, 0.3, 5)}, "h": "auto", "t_end": 2}
    one = many(dal.systems.sleigh(), lanes=False, **given)
    with pytest.warns(dal.DalembertWarning, match="no effect, .*: with h = 'auto' each member has"):
        two = many(dal.systems.sleigh(), **given)
    assert not two.lanes and (one.q == two.q).all()
    monkeypatch.setattr(block, "without_lanes", lambda *of: "")
    assert abs(many(dal.systems.sleigh(), **given).q - one.q).max() < 1e-11  # nor in C


def pushed():
    x, y, theta = dal.coordinates("x y theta")
    u = sympy.Symbol("u")
    L = (x.d**2 + y.d**2 + theta.d**2 / 2 - x**2) / 2
    row = sympy.sin(theta) * x.d - sympy.cos(theta) * y.d
    return dal.System.from_sympy(
        L, [row], force={x: u, theta: -theta.d / 10}, inputs=[u], name="pushed",
        q0=[0, 0, 0], v0=[1, 0, 0.4],
    )  # fmt: skip


def test_momenta():
    """M(q): the runs of members alone, to the last bits of the sines."""
    given = {"h": 0.01, "steps": 300, "stride": 60, "keep": ["all", "reactions"]}
    disc = dal.systems.rolling_disc()
    values = {"parameters": {"m": disc.parameters["m"] * np.linspace(0.9, 1.1, 20)}}
    for scheme in ("leapfrog", "midpoint"):
        there, plain = (many(disc, scheme, lanes=x, **given, **values) for x in (True, False))
        assert there.lanes and there.success.all()
        for column in ("q", "v", "reactions"):
            size = abs(plain[column]).max()
            assert 0 < abs(there[column] - plain[column]).max() <= 1e-12 * size, column
        assert there.worst_residual.max() <= 4 * len(plain.q[0, 0]) * U


def test_momenta_by_hand():
    """M(q) against (1 + 2 y^2) x'' = -x - 3 y x' y' and y'' = y x'^2 - y, by hand: z' = y x'."""
    x, y, z = dal.coordinates("x y z")
    m = sympy.Symbol("m", positive=True)
    L = m * ((1 + y**2) * x.d**2 + y.d**2 + z.d**2 - x**2 - y**2) / 2
    bead = dal.System.from_sympy(L, [z.d - y * x.d], parameters={m: 1.0}, name="bead")

    def motion(t, state):
        x, y, u, v = state
        return [u, v, -(x + 3 * y * u * v) / (1 + 2 * y**2), y * u**2 - y]

    start = np.random.default_rng(8).uniform(-1, 1, (4, 4))
    exact = [solve_ivp(motion, (0, 2), state, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
             for state in start]  # fmt: skip
    start, exact = np.repeat(start, 4, axis=0), np.repeat(exact, 4, axis=0)
    q0 = np.c_[start[:, :2], np.zeros(16)]
    v0 = np.c_[start[:, 2:], start[:, 1] * start[:, 2]]
    units = {"m": np.tile([1e-30, 1e-3, 1.0, 1e30], 4)}

    def error(scheme, h):
        there = many(bead, scheme, q0, v0, units, h=h, t_end=2)
        assert there.lanes and there.success.all() and there.worst_residual.max() <= 4 * 3 * U
        return abs(np.c_[there.q[:, :2], there.v[:, :2]] - exact).max(axis=1)

    assert error("midpoint-kl8", 0.05).max() <= 1e-12
    coarse, fine = error("midpoint", 0.02), error("midpoint", 0.01)
    assert np.log2(coarse / fine) == pytest.approx(2, abs=0.001) and coarse.min() > 1e-6


@pytest.mark.parametrize("hold, stride", [(8, 4), (10, 25), (20, 10), (13, 13)])
def test_inputs(hold, stride):
    """Rows of inputs begin within rows of results and at them; members have rows of others."""
    steps = 13 * 15 if hold == 13 else 200
    given = {"h": 0.01, "steps": steps, "stride": stride, "keep": ["all", "reactions"],
             "hold": hold, "inputs": RNG.integers(-1, 2, (20, -(-steps // hold), 1))}  # fmt: skip
    there, plain = (many(pushed(), "midpoint", lanes=x, **given) for x in (True, False))
    assert there.lanes and there.success.all()
    for column in ("q", "v", "reactions"):
        assert abs(there[column] - plain[column]).max() <= 1e-13, column
    with pytest.warns(dal.DalembertWarning, match=r"inputs last 7 steps \(hold\), and .* least 8"):
        many(pushed(), h=0.01, steps=70, hold=7, inputs=np.ones((20, 10, 1)))


def test_inputs_after_a_lane_has_stopped():
    """Where the step that a lane cannot make is the last with its inputs, the next has others."""
    x, y, z = dal.coordinates("x y z")
    u = sympy.Symbol("u")
    L = (x.d**2 + y.d**2 + z.d**2) / 2 - 2000 * sympy.Max(0, x - 1) ** 2
    wall = dal.System.from_sympy(L, [z.d - y * x.d], force={y: u - y.d / 10}, inputs=[u],
                                 name="wall")  # fmt: skip
    q0, v0 = np.array([0, 0.1, 0]), np.array([1, 0.4, 0.1]) * np.linspace(0.5, 3, 96)[:, None]
    rows = {"h": 0.05, "steps": 160, "hold": 8, "inputs": RNG.normal(size=(20, 1))}
    there, plain = (many(wall, "midpoint", q0, v0, lanes=x, **rows) for x in (True, False))
    assert there.lanes and there.success.all() and plain.stats["full_newtons"].sum() > 20
    assert abs(there.v - plain.v).max() <= 1e-9


def test_steps_and_step_sizes_of_members():
    h = 0.1 / 2.0 ** np.arange(6)
    given = {"h": h, "t_end": 1}
    there, plain = (many(dal.systems.sleigh(), "midpoint", lanes=x, **given) for x in (True, False))
    assert there.done.tolist() == (10 * 2 ** np.arange(6)).tolist()
    assert abs(there.q - plain.q).max() < 1e-13
    none = many(dal.systems.sleigh(), "midpoint", parameters={"a": [0.1, 0.2]}, h=0.1, steps=0)
    assert (none.done == 0).all() and (none.q == dal.systems.sleigh().q0).all()


@pytest.mark.parametrize(("lane", "blocks"), [(True, 1), (False, 16)])
def test_long_members_fill_the_lanes(lane, blocks, monkeypatch, tmp_path):
    monkeypatch.setattr(api, "_seconds_of_member", lambda spec: 1e3)  # a block of its own
    particle = dal.systems.particle()
    many(particle, h=np.full(16, 0.1), steps=1, lanes=lane, store=tmp_path / "of", threads=1)
    assert len(list((tmp_path / "of").glob("block-*.npz"))) == blocks


def test_energy_jumps_are_seen():
    system = dal.systems.particle_oscillator()
    v0 = np.array([0.1, 100.0])[:, None] * system.v0
    given = {"h": 1.99, "steps": 500, "consistent": "project"}
    plain, there = (
        _quietly(many, system, "midpoint", system.q0, v0, lanes=x, **given) for x in (False, True)
    )
    assert (plain.doubtful == there.doubtful).all()


def _quietly(function, *given, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return function(*given, **more)


