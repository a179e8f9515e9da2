"""Journals: runs that are killed, gone on with, read, refused."""

import os
import pickle
import random
import signal
import warnings

import numpy as np
import pytest
import sympy

import dalembert as dal
from dalembert.run import journal as journals

M, J = 2.0, 0.75


def force(t, q, v, u):
    return [u[0] * np.cos(q[2]) - 0.1 * v[0], u[0] * np.sin(q[2]), u[1]]


def forms(q):
    return [[np.sin(q[2]), -np.cos(q[2]), 0]]


def turning(q, v):
    return [[0, 0, np.cos(q[2]) * v[0] + np.sin(q[2]) * v[1]]]


def cart(mass=M, **options):
    return dal.System(
        mass=[mass, mass, J], mu=forms, mu_v_q=turning, force=force,
        inputs=["push", "turn"], coordinates=["x", "y", "theta"], q0=[0.3, -0.2, 0.4],
        v0=[np.cos(0.4), np.sin(0.4), 1.1], name="cart", **options,
    )  # fmt: skip


def sleigh():
    x, y, theta = dal.coordinates("x y theta")
    a = sympy.Symbol("a")
    return dal.System.from_sympy(
        (x.d**2 + y.d**2 + theta.d**2) / 2 + sympy.cos(x) / 3,
        [-sympy.sin(theta) * x.d + sympy.cos(theta) * y.d - a * theta.d], parameters={a: 0.2},
        q0=[0, 0, 0], v0=[1, a, 1], name="sleigh",
    )  # fmt: skip


def control(t, q, v):
    return [0.5 - q[0], np.sin(5 * t)]


WALL = dal.Event(lambda t, q, v: q[0] - 0.6, direction=1, reset=lambda q, v: (q, -v))
TURN = dal.Event(lambda t, q, v: np.sin(3 * q[2]))
LATE = dal.Event(lambda t, q, v: t - 1.87, terminal=True)
TABLE = np.random.default_rng(1).normal(size=(20, 2))

AUTO = {"h": "auto", "t_end": 3.0, "steps": None, "tolerance": 1e-5}
CASES = {
    "built in": (dal.systems.sleigh, "leapfrog-kl6", {"stride": 2}, {}),
    "of SymPy": (sleigh, "midpoint", {}, {}),
    "table": (cart, "leapfrog", {"hold": 3, "stride": 4}, {"inputs": TABLE}),
    "controller and events": (cart, "leapfrog", {}, {"inputs": control, "events": [WALL, TURN]}),
    "terminal": (
        cart, "midpoint", {"hold": 7, "stride": 3}, {"inputs": control, "events": [WALL, LATE]}
    ),
    "output times and inputs": (
        cart, "midpoint", {"t_eval": np.linspace(0, 2.9, 37), "hold": 3},
        {"inputs": control, "events": [TURN]},
    ),
    "output times": (
        cart, "leapfrog", {"t_eval": np.linspace(0, 2.9, 37)}, {"events": [WALL]}
    ),
    "kept nodes": (
        dal.systems.particle, "midpoint-nodes", {"initial": "shift", "stride": 3}, {}
    ),
    "pair": (dal.systems.disk, dal.Scheme.pair(0.25, 0.5), {}, {}),
    "reference": (dal.systems.sleigh, "reference", {"tolerance": 1e-9, "stride": 10}, {}),
    "error-controlled": (
        cart, "bm4", {**AUTO, "hold": 0.21, "stride": 3, "h_max": 0.3},
        {"inputs": control, "events": [WALL, TURN]},
    ),
    "error-controlled, table": (
        cart, "midpoint-suzuki4", {**AUTO, "hold": 0.15, "stride": 4}, {"inputs": TABLE}
    ),
    "error-controlled, terminal": (
        dal.systems.sleigh, "bm6", {**AUTO, "t_eval": np.linspace(0, 2.9, 37)}, {"events": [LATE]}
    ),
    "own record": (
        dal.systems.disk, dal.Scheme([(0.3, 0.4), (0.7, 0.6)], name="mine"), {}, {}
    ),
}  # fmt: skip


@pytest.fixture(params=CASES)
def case(request):
    make, scheme, options, functions = CASES[request.param]
    return make(), scheme, {"h": 0.05, "steps": 60, **options}, functions


def assert_same(one, other):
    for name in ("t", "x", "reactions", "inputs"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in ("t_events", "x_events", "x_after"):
        assert len(getattr(one, name)) == len(getattr(other, name))
        for a, b in zip(getattr(one, name), getattr(other, name)):
            np.testing.assert_array_equal(a, b)
    np.testing.assert_equal(
        (one.status, one.h, one.stride, one.hold, one.control),
        (other.status, other.h, other.stride, other.hold, other.control),
    )


def run_is_controlled(options):
    return options["h"] == "auto"


def given_system(system):
    return None if system._source.of_library else system


# ---- a run and its file --------------------------------------------------------------------------


def test_a_journal_changes_nothing_and_holds_all(case, tmp_path):
    system, scheme, options, functions = case
    path = tmp_path / "run.dal"
    plain = dal.integrate(system, scheme, **options, **functions)
    run = dal.integrate(system, scheme, **options, **functions, journal=path)
    assert_same(run, plain)
    assert run.stats == plain.stats
    found = dal.load(path, given_system(system))
    assert_same(found, plain)
    assert found.system.n == system.n and found.scheme.name == run.scheme.name
    for name in ("energy", "multipliers", "residual", "q", "v", "constraint"):
        np.testing.assert_array_equal(getattr(found, name), getattr(run, name))
    if "t_eval" not in options and not functions:
        np.testing.assert_array_equal(found(0.7).q, run(0.7).q)


@pytest.mark.parametrize("seconds", [-1.0, 5.0])
def test_going_on_is_the_whole_run(case, tmp_path, monkeypatch, seconds):
    """A run that an exception ends anywhere goes on to the bits of the whole one, twice over."""
    monkeypatch.setattr(journals, "SECONDS", seconds)
    system, scheme, options, functions = case
    path = tmp_path / "run.dal"
    whole = dal.integrate(system, scheme, **options, **functions)
    calls = []

    def stop(step, t, q, v):
        calls.append(step)
        if len(calls) in (4, 9):
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough") as caught:
        dal.integrate(system, scheme, **options, **functions, journal=path, observer=stop)
    partial = dal.load(path, given_system(system))
    if "t_eval" not in options:
        np.testing.assert_array_equal(partial.x, caught.value.partial.x)
        assert not partial.success or partial.status == 1
        assert (" of 3, from" if run_is_controlled(options) else "of 60 steps") in partial.message
    given = {"system": given_system(system), **functions}
    with pytest.raises(RuntimeError, match="enough"):
        for _ in range(2):
            run = dal.resume(path, **given, observer=stop)
        assert len(calls) < 9  # it was over before
        raise RuntimeError("enough")
    run = dal.resume(path, **given)
    assert_same(run, whole)
    assert run.stats == whole.stats
    assert_same(dal.load(path, given_system(system)), whole)
    assert_same(dal.resume(path, **given), whole)  # of a run that is over


def test_longer(tmp_path):
    path = tmp_path / "run.dal"
    system = dal.systems.sleigh()
    dal.integrate(system, h=0.01, t_end=1, journal=path)
    whole = dal.integrate(system, h=0.01, t_end=3)
    assert_same(dal.resume(path, t_end=2), dal.integrate(system, h=0.01, t_end=2))
    assert_same(dal.resume(path, steps=300), whole)
    assert_same(dal.load(path), whole)
    for steps in (100, 299):
        with pytest.raises(ValueError, match=f"300 steps, but the run has only steps = {steps}"):
            dal.resume(path, steps=steps)
    with pytest.raises(ValueError, match=r"^t_end = 2.99 is before the end .* \(t = 3\): expec"):
        dal.resume(path, t_end=2.99)


def test_an_event_in_the_first_step(tmp_path):
    """Nobody has looked at the events when the first snapshot is made."""
    point = dal.System(mass=[1.0], q0=[0], v0=[1])
    near = dal.Event(lambda t, q, v: q[0] - 0.04, reset=lambda q, v: (q, -v))
    path = tmp_path / "run.dal"
    dal.integrate(point, events=[near], journal=path, h=0.1, steps=0, stride=50)
    run = dal.resume(path, point, events=[near], steps=100)
    assert_same(run, dal.integrate(point, events=[near], h=0.1, steps=100, stride=50))
    np.testing.assert_allclose(run.q[:, 0], [0, -4.92, -9.92], atol=1e-12)


def test_other_event_functions(tmp_path):
    """An event that has another value than when it was saved is another one."""
    point = dal.System(mass=[1.0], q0=[0], v0=[1])
    path = tmp_path / "run.dal"
    first = [lambda t, q, v: q[0] - 5.5]
    dal.integrate(point, h=0.1, steps=10, events=first, journal=path)
    for other in (0.85, -1.0, 5.4):
        with pytest.raises(ValueError, match=r"event 0: g = .* at t = 1, but it was -4.5"):
            dal.resume(path, point, events=[lambda t, q, v: q[0] - other], steps=30)
    assert dal.resume(path, point, events=first, steps=60).t_events[0] == pytest.approx([5.5])


def test_an_end_before_the_first_output_time(tmp_path):
    point = dal.System(mass=[1.0], q0=[3], v0=[1])
    end = dal.Event(lambda t, q, v: q[0] - 4, terminal=True)
    path = tmp_path / "run.dal"
    options = {"h": 0.1, "steps": 100, "events": [end]}
    run = dal.integrate(point, **options, t_eval=[5, 6], journal=path)
    np.testing.assert_allclose(run.t, [1.0])
    np.testing.assert_allclose(run.x, [[4.0, 1.0]])
    some = dal.integrate(point, **options, t_eval=[0.2, 0.5, 5])
    np.testing.assert_allclose(some.t, [0.2, 0.5, 1.0])
    np.testing.assert_allclose(some.q[:, 0], [3.2, 3.5, 4.0])
    assert_same(dal.load(path, point), run)
    assert_same(dal.resume(path, point, events=[end]), run)
    for suffix in (".npz", ".csv"):
        run.save(tmp_path / f"run{suffix}")
    assert_same(dal.load(tmp_path / "run.npz", point), run)

    def stop(step, t, q, v):
        raise RuntimeError

    with pytest.raises(RuntimeError) as caught:
        dal.integrate(point, h=0.1, steps=100, t_eval=[5], journal=tmp_path / "b", observer=stop)
    np.testing.assert_array_equal(caught.value.partial.x, [[3, 1]])
    found = dal.load(tmp_path / "b", point)
    np.testing.assert_array_equal(found.x, [[3, 1]])
    assert found.t == [0]


def test_an_exception_within_a_composed_step(tmp_path):
    """What a step that failed has left in the predictor is in no snapshot."""
    limit = [np.inf]

    def pushed(t, q, v):
        if t > limit[0]:
            raise KeyError
        return [-0.1 * v[0], -q[1], 0.2 * np.cos(t)]

    system = dal.System(
        mass=[1, 1, 1], mu=forms, q0=[0, 0, 0.3], v0=[np.cos(0.3), np.sin(0.3), 0.7],
        force=pushed,
    )  # fmt: skip
    whole = dal.integrate(system, "leapfrog-suzuki4", h=0.1, steps=40)
    for k, at in enumerate((0.05, 1.53, 3.5)):
        path, limit[0] = tmp_path / f"{k}.dal", at
        with pytest.raises(KeyError):
            dal.integrate(system, "leapfrog-suzuki4", h=0.1, steps=40, journal=path)
        limit[0] = np.inf
        assert_same(dal.resume(path, system), whole)


def test_an_interrupt_between_two_calls_saves(tmp_path):
    path = tmp_path / "run.dal"

    def interrupt(done, total):
        if done > 1000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dal.integrate(dal.systems.sleigh(), h=0.01, steps=10**6, journal=path, progress=interrupt)
    info = journals.Journal.open(path).info
    assert info.done == info.records - 1 > 1000


def test_a_loaded_run_stays_in_the_file(tmp_path):
    path = tmp_path / "run.dal"
    run = dal.integrate(dal.systems.sleigh(), h=0.01, steps=1000, journal=path)
    found = dal.load(path)
    assert isinstance(found.x, np.memmap) and not found.x.flags.writeable
    assert isinstance(found.q, np.memmap)
    os.remove(path)
    np.testing.assert_array_equal(found.x, run.x)
    copy = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(copy.x, run.x)


def test_a_run_that_has_made_nothing(tmp_path):
    """It is where it begins."""
    def refuse(step, t, q, v):
        raise RuntimeError

    path = tmp_path / "run.dal"
    system = dal.systems.sleigh()
    with pytest.raises(RuntimeError):
        dal.integrate(system, h=0.1, steps=4, t0=2.0, journal=path, observer=refuse)
    content = path.read_bytes()
    path.write_bytes(content[: journals.Journal.open(path).info.begin])
    found = dal.load(path)
    assert found.t == [2.0] and "0 of 4 steps" in found.message
    np.testing.assert_array_equal(found.x, dal.integrate(system, h=0.1, steps=0).x)
    assert_same(dal.resume(path), dal.integrate(system, h=0.1, steps=4, t0=2.0))


def test_a_journal_is_read_while_it_is_written(tmp_path):
    path, seen = tmp_path / "run.dal", []

    def look(step, t, q, v):
        if step == 50:
            seen.append(dal.load(path, system))
            with pytest.raises(ValueError, match=rf"process {os.getpid()} on .* writes it"):
                dal.resume(path, system)

    system = cart()
    run = dal.integrate(system, "midpoint", h=0.01, steps=60, journal=path, observer=look)
    count = len(seen[0].x)
    assert 0 < count <= 51
    np.testing.assert_array_equal(seen[0].x, run.x[:count])
    assert "of 60 steps" in seen[0].message


# ---- kills ---------------------------------------------------------------------------------------


def die(at, make):
    """Run something in a child, which kills itself at a step; return the last that it had shown."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)

        def show(done, total):
            os.write(writer, f"{done}\n".encode())
            if done >= at:
                os.kill(os.getpid(), signal.SIGKILL)

        try:
            make(show)
        finally:
            os._exit(0)
    os.close(writer)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    with os.fdopen(reader) as lines:
        return int(lines.read().split()[-1])


@pytest.mark.parametrize("kind", ["inputs and events", "long"])
def test_kills(tmp_path, monkeypatch, kind):
    """Killed, resumed, killed again, resumed: each step that was shown is in the file."""
    monkeypatch.setattr(journals, "SECONDS", 0.003)
    monkeypatch.setattr("dalembert.run.runs.PIECE_SECONDS", 0.002)
    if kind == "long":
        system, scheme, functions = dal.systems.sleigh(), "leapfrog-kl6", {}
        options = {"h": 0.01, "steps": 20_000, "stride": 100}
    else:
        system, scheme = cart(), "midpoint"
        functions = {"inputs": control, "events": [WALL, TURN]}
        options = {"h": 0.05, "steps": 300, "stride": 2, "hold": 3}
    whole = dal.integrate(system, scheme, **options, **functions)
    given = {"system": given_system(system), **functions}
    random.seed(7)
    for k in range(3):
        path = tmp_path / f"{k}.dal"
        first, second = sorted(random.uniform(0, 0.5) * options["steps"] for _ in range(2))
        calls = [
            lambda show: dal.integrate(
                system, scheme, **options, **functions, journal=path, progress=show
            ),
            lambda show: dal.resume(path, **given, progress=show),
        ]
        for at, call in zip((first, second + 0.2 * options["steps"]), calls):
            shown = die(at, call)
            with warnings.catch_warnings(action="ignore"):
                found = dal.load(path, given["system"])
            assert shown // options["stride"] + 1 <= len(found.x)
            np.testing.assert_array_equal(found.x, whole.x[: len(found.x)])
            np.testing.assert_array_equal(found.reactions, whole.reactions[: len(found.x) - 1])
        with warnings.catch_warnings(action="ignore"):
            run = dal.resume(path, **given)
        assert_same(run, whole)
        assert run.stats == whole.stats


# ---- what does not fit ---------------------------------------------------------------------------


def test_another_system(tmp_path):
    path = tmp_path / "run.dal"
    own = sleigh()
    dal.integrate(own, h=0.05, steps=10, journal=path)
    with pytest.raises(ValueError, match="'sleigh'.*not a built-in system"):
        dal.load(path)
    with pytest.raises(ValueError, match="belongs to one with a = 0.2, but this one has a = 0.3"):
        dal.load(path, own.with_parameters(a=0.3))
    with pytest.raises(ValueError, match="another system, 'sleigh', not to <System particle"):
        dal.resume(path, dal.systems.particle())
    assert len(dal.resume(path, sleigh(), steps=20).x) == 21  # made anew, it is the same

    path = tmp_path / "cart.dal"
    dal.integrate(cart(), h=0.05, steps=10, journal=path)
    with pytest.raises(ValueError, match="belongs to another system"):
        dal.load(path, cart(2.5))

    def other(t, q, v, u):
        return np.add(force(t, q, v, u), [0.01 * v[0], 0, 0])

    looks_alike = dal.System(
        mass=[M, M, J], mu=forms, mu_v_q=turning, force=other,
        inputs=["push", "turn"], coordinates=["x", "y", "theta"],
    )  # fmt: skip
    with pytest.raises(ValueError, match="at its first state the field was"):
        dal.load(path, looks_alike)
    assert len(dal.load(path, cart()).x) == 11


def test_other_inputs_and_events(tmp_path):
    path = tmp_path / "run.dal"
    options = {"h": 0.05, "steps": 20, "inputs": TABLE, "events": [WALL]}
    dal.integrate(cart(), **options, journal=path)
    given = {"system": cart(), "inputs": TABLE, "events": [WALL]}
    for change, text in (
        ({"inputs": None}, "inputs is missing"),
        ({"events": []}, "the number of events is 1 in the journal, but 0 in the run"),
        ({"inputs": TABLE + 1e-12}, r"inputs\[0\] of row 0 is .* in the journal"),
        ({"steps": 40}, "inputs: expected shape"),
        ({"scheme": dal.Scheme.find("leapfrog")}, "another system or scheme"),
    ):
        with pytest.raises(ValueError, match=text):
            dal.resume(path, **(given | change))
    assert len(dal.resume(path, **given).x) == 21  # nothing of it has done harm


def test_a_controller_that_is_another(tmp_path):
    path = tmp_path / "run.dal"

    def stop(step, t, q, v):
        if step == 12:
            raise RuntimeError

    with pytest.raises(RuntimeError):
        dal.integrate(cart(), h=0.05, steps=20, inputs=control, journal=path, observer=stop)
    whole = dal.integrate(cart(), h=0.05, steps=20, inputs=control)
    content = path.read_bytes()
    # a snapshot was made when the run broke off: only that of the beginning is left
    info = journals.Journal.open(path).info
    slot = (info.begin - content.find(b"process ") - 128) // 3
    begin = info.begin - 2 * slot
    path.write_bytes(content[:begin] + bytes(2 * slot) + content[info.begin :])

    def other(t, q, v):
        return [0.5 - q[0], np.sin(5 * t) + 1e-9 * (t > 0.3)]

    with pytest.raises(ValueError, match="differs from the recomputed one"):
        dal.resume(path, cart(), inputs=other)
    assert_same(dal.resume(path, cart(), inputs=control), whole)


def test_expressions_of_inputs_are_compared(tmp_path, in_python):
    x, push = dal.coordinates("x")[0], sympy.Symbol("push")
    mass = dal.System.from_sympy(x.d**2 / 2, force={x: push}, inputs=[push], q0=[1], v0=[0])
    path, law = tmp_path / "run.dal", {push: -x - x.d / 3}
    dal.integrate(mass, h=0.05, steps=20, inputs=law, journal=path)
    for other, text in (
        ({push: -x - x.d / 4}, r"has inputs\['push'\] = -x - x.d/3, but these are .* = -x - x.d/4"),
        (lambda t, q, v: -q - v / 3, "but these are no expressions; expected the same"),
        (None, "inputs is missing"),
    ):
        with pytest.raises(ValueError, match=text):
            dal.resume(path, mass, steps=40, inputs=other)
    longer = dal.resume(path, mass, steps=40, inputs=law)
    assert_same(longer, dal.integrate(mass, h=0.05, steps=40, inputs=law))
    dal.integrate(mass, h=0.05, steps=20, inputs=lambda t, q, v: -q, journal=tmp_path / "other")
    with pytest.raises(ValueError, match="has no expressions, but these are"):
        dal.resume(tmp_path / "other", mass, steps=40, inputs=law)


def test_refused_files(tmp_path):
    system = dal.systems.sleigh()
    path = tmp_path / "run.dal"
    dal.integrate(system, h=0.1, steps=2, journal=str(path))
    with pytest.raises(ValueError, match="run.dal: the file exists already"):
        dal.integrate(system, h=0.1, steps=2, journal=path)
    with pytest.raises(dal.JournalError, match="No such file or directory"):
        dal.integrate(system, h=0.1, steps=2, journal=tmp_path / "none" / "run.dal")
    with pytest.raises(FileNotFoundError):
        dal.load(tmp_path / "none.dal")
    with pytest.raises(FileNotFoundError):
        dal.resume(tmp_path / "none.dal")
    other = tmp_path / "text"
    other.write_text("nothing of the kind")
    with pytest.raises(ValueError, match="expected the journal of a run or a saved run"):
        dal.load(other)
    with pytest.raises(ValueError, match="not the journal of a run"):
        dal.resume(other)
    for name in ("", "a\0b"):
        with pytest.raises(ValueError, match="journal = .*: expected the name of a file"):
            dal.integrate(system, h=0.1, steps=2, journal=name)
    with pytest.raises(ValueError, match="journal_errors = 'no'"):
        dal.integrate(system, h=0.1, steps=2, journal=tmp_path / "b", journal_errors="no")
    with pytest.raises(NotImplementedError, match="cannot be resumed"):
        dal.integrate(
            system, "reference", h=0.1, steps=2, method="msadams", journal=tmp_path / "b"
        )
    assert not (tmp_path / "b").exists() and sorted(os.listdir(tmp_path)) == ["run.dal", "text"]


def test_a_scheme_made_of_functions(tmp_path):
    path = tmp_path / "run.dal"
    half = dal.DifferenceMap(
        map=lambda h, a, b: ((a + b) / 2, (b - a) / h),
        derivatives=lambda h, a, b: (np.eye(3) / 2, np.eye(3) / 2, -np.eye(3) / h, np.eye(3) / h),
    )
    scheme = dal.Scheme.pair(half, half)
    run = dal.integrate(dal.systems.particle(), scheme, h=0.1, steps=4, journal=path)
    with pytest.raises(ValueError, match="scheme is missing"):
        dal.resume(path)
    run.save(tmp_path / "run.npz")
    for file in (path, tmp_path / "run.npz"):
        with pytest.raises(ValueError, match="scheme is missing"):
            dal.load(file)
        np.testing.assert_array_equal(dal.load(file, scheme=scheme).x, run.x)
    longer = dal.resume(path, scheme=scheme, steps=6)
    np.testing.assert_array_equal(longer.x[:5], run.x)


# ---- disks ---------------------------------------------------------------------------------------


def limited(path, errors, size):
    """A run whose file may have so many bytes; return what it printed."""
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    return dal.integrate(
        dal.systems.sleigh(), h=0.01, steps=5000, journal=path, journal_errors=errors
    )


@pytest.mark.parametrize("errors", ["warn", "stop"])
def test_no_space(tmp_path, errors):
    path = tmp_path / "run.dal"
    whole = dal.integrate(dal.systems.sleigh(), h=0.01, steps=5000)
    child = os.fork()
    if child == 0:  # the limit is that of a process
        code = 1
        try:
            if errors == "warn":
                with pytest.warns(dal.DalembertWarning, match="continues without its journal"):
                    run = limited(path, errors, 100_000)
                code = 0 if np.array_equal(run.x, whole.x) else 2
            else:
                with pytest.raises(dal.JournalError, match="File too large") as caught:
                    limited(path, errors, 100_000)
                partial = caught.value.partial
                code = 0 if np.array_equal(partial.x, whole.x[: len(partial.x)]) else 3
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    found = dal.load(path)
    assert 0 < len(found.x) < 5001
    np.testing.assert_array_equal(found.x, whole.x[: len(found.x)])
    assert_same(dal.resume(path), whole)


def test_a_file_that_vanishes(tmp_path):
    path = tmp_path / "run.dal"

    def remove(step, t, q, v):
        if step == 30:
            path.unlink()

    system = dal.systems.sleigh()
    whole = dal.integrate(system, h=0.01, steps=500)
    with pytest.warns(dal.DalembertWarning, match="the file was removed or replaced") as told:
        run = dal.integrate(system, h=0.01, steps=500, journal=path, observer=remove)
    assert_same(run, whole)
    assert told[0].filename == __file__  # the line of the user is named
    with pytest.raises(dal.JournalError, match="the file was removed or replaced"):
        dal.integrate(
            system, h=0.01, steps=500, journal=path, observer=remove, journal_errors="stop"
        )


def test_a_damaged_end(tmp_path):
    path = tmp_path / "run.dal"
    system = dal.systems.sleigh()
    whole = dal.integrate(system, h=0.01, steps=50, journal=path)
    content = path.read_bytes()
    path.write_bytes(content[:-300])
    with pytest.warns(dal.DalembertWarning, match="the last 52 bytes are not a complete") as told:
        found = dal.load(path)
    assert told[0].filename == __file__
    np.testing.assert_array_equal(found.x, whole.x[:47])
    with pytest.warns(dal.DalembertWarning, match="the last 52 bytes") as told:
        assert_same(dal.resume(path), whole)
    assert told[0].filename == __file__
    assert path.stat().st_size == len(content)
