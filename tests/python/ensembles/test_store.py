"""Ensembles in a store: gone on with after any kill, and what else may lie in a directory."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import dalembert as dal
from dalembert.core import files
from dalembert.ensembles import StoreError

VALUES = {"a": np.linspace(0.1, 0.4, 23), "J": np.linspace(0.5, 2.0, 23)}
GIVEN = {"parameters": VALUES, "h": 0.01, "steps": 20, "progress": False, "threads": 2}


def make(path=None, **more):
    given = GIVEN | more
    scheme = "midpoint-kl8" if given["h"] == "auto" else "midpoint"
    return dal.ensemble(dal.systems.sleigh(), scheme, store=path, **given)


def same(one, other):
    assert [*one] == [*other]
    for name in one:
        assert np.array_equal(one[name], other[name], equal_nan=True), name


def block(path, index):
    return Path(path) / f"block-{index:09d}.npz"


@pytest.fixture
def path(tmp_path):
    return str(tmp_path / "store")


# ---- what it is for ----------------------------------------------------------------------------


@pytest.mark.parametrize("keep", ["end", ["all", "energy"], ["theta", "reactions"]])
def test_a_store_has_the_same_bits(path, keep):
    here = make(keep=keep)
    there = make(path, keep=keep, block=5)
    same(here, there)
    assert len([*Path(path).glob("block-*.npz")]) == 5
    before = {one: os.stat(one).st_mtime_ns for one in Path(path).iterdir()}
    same(here, make(path, keep=keep, block=7))  # nothing is made again
    assert before == {one: os.stat(one).st_mtime_ns for one in Path(path).iterdir()}
    opened = dal.open_ensemble(path)
    same(here, opened)
    assert opened.shape == here.shape and opened.scheme == here.scheme
    assert (opened.parameters["a"] == VALUES["a"]).all()
    assert np.array_equal(opened.member(3).q[-1], here.member(3).q[-1])
    for begin, part in opened.blocks():
        for name, x in part.items():
            if name in opened:
                assert np.array_equal(x, here[name][begin : begin + len(x)], equal_nan=True)


def test_steps_of_variable_size_in_a_store(path):
    given = {"h": "auto", "tolerance": 1e-6, "steps": None, "t_end": 3.0}
    given["keep"] = ["end", "q", "energy"]
    here, there = (make(where, **given, block=5) for where in (None, path))
    same(here, there)
    block(path, 2).unlink()
    same(here, make(path, **given))
    opened = dal.open_ensemble(path)
    same(here, opened)
    assert opened.h == "auto" and (opened.steps == here.done).all()
    assert (opened.member(9).x[-1] == np.r_[here.q[9], here.v[9]]).all()
    for name, value in (("tolerance", 1e-7), ("t_end", 4.0), ("h_max", 0.1), ("energy", "keep")):
        with pytest.raises(ValueError, match=f"another ensemble, which differs in {name}"):
            make(path, **given | {name: value})
    with pytest.raises(ValueError, match="another ensemble, which differs in .*tolerance"):
        make(path)


def test_what_is_missing_is_made(path):
    here = make()
    make(path, block=4)
    for index in (0, 3, 5):
        block(path, index).unlink()
    partial = dal.open_ensemble(path)
    assert partial.unfinished.tolist() == [*range(4), *range(12, 16), *range(20, 23)]
    assert np.isnan(partial.q[0]).all() and (partial.q[4] == here.q[4]).all()
    kept = os.stat(block(path, 1)).st_mtime_ns
    same(here, make(path))
    assert os.stat(block(path, 1)).st_mtime_ns == kept


def test_failed_members_and_functions(path):
    system = dal.systems.sleigh()
    v0 = np.tile(system.v0, (6, 1))
    v0[2] = [0, 1, 0]
    wall = dal.Event(lambda t, q, v: q[0] - 0.05, terminal=True)
    given = {"h": 0.01, "steps": 40, "progress": False, "events": [wall], "block": 2}
    with pytest.warns(dal.DalembertWarning, match="1 of 6"):
        here = dal.ensemble(system, "leapfrog", system.q0, v0, **given)
    with pytest.warns(dal.DalembertWarning, match="1 of 6"):
        there = dal.ensemble(system, "leapfrog", system.q0, v0, store=path, **given)
    same(here, there)
    opened = dal.open_ensemble(path)
    for k in range(6):
        assert opened.message(k) == here.message(k)
    assert there.member(0).t[-1] == here.t[0]
    with pytest.raises(ValueError, match="has events.*a store cannot save functions"):
        opened.member(0)


def test_a_reduction_in_a_store(path):
    def last(run):
        return {"end": run.q[-1], "drift": np.ptp(run.energy)}

    here = make(keep=last)
    there = make(path, keep=last, block=4)
    same(here, there)
    same(here, dal.open_ensemble(path))


def test_xarray_is_lazy(path):
    here = make(keep=["all", "energy"]).to_xarray()
    make(path, keep=["all", "energy"], block=6)
    there = dal.open_ensemble(path).to_xarray()
    assert there.q.chunks is not None and there.q.chunks[0] == (6, 6, 6, 5)
    assert there.compute().identical(here.drop_vars([])) or there.equals(here)
    for name in here:
        assert np.array_equal(here[name].values, there[name].values, equal_nan=True)


MANY = """
import resource
import sys
import numpy as np
import dalembert as dal

before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
found = dal.ensemble(dal.systems.sleigh(), parameters={"a": np.linspace(0.1, 0.3, 100_000)}, h=0.01,
                     steps=2, block=2000, progress=False, store=sys.argv[1])
assert sum(len(part["states"]) for _, part in found.blocks()) == 100_000
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""


def test_memory_does_not_grow_with_what_is_kept(path):
    """A hundred thousand members have 13 MB of results; what was given for them has one."""
    command = [sys.executable, "-c", MANY, path]
    assert float(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout) < 30


# ---- kills -------------------------------------------------------------------------------------


LONG = {"parameters": {"a": np.linspace(0.1, 0.4, 20)}, "h": 0.01, "progress": False}


def begun(path, **given):
    """Start an ensemble in a process of its own; return its number."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            dal.ensemble(dal.systems.sleigh(), "midpoint", threads=2, block=2, store=path,
                         **LONG | given)  # fmt: skip
            status = 0
        finally:
            os._exit(status)
    return child


def test_killed_again_and_again(path):
    def made():
        return len([*Path(path).glob("block-*.npz")])

    long = {"steps": 20_000}
    for _ in range(3):
        before = made()
        child = begun(path, **long)
        while made() == before:
            assert os.waitpid(child, os.WNOHANG) == (0, 0)
            time.sleep(0.001)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    there = dal.ensemble(dal.systems.sleigh(), "midpoint", store=path, **LONG, **long)
    same(dal.ensemble(dal.systems.sleigh(), "midpoint", **LONG, **long), there)


CALLS = ["open", "fsync", "replace"]


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("late", [False, True])
def test_killed_at_every_point_of_a_file(path, call, late):
    """A process dies before or after each call that makes a sealed file; the next goes on."""
    here = make()
    for number in range(100):
        child = os.fork()
        if child == 0:
            _die_at(call, late, number)
            try:
                make(path, block=6, threads=1)
            finally:
                os._exit(0)
        _, status = os.waitpid(child, 0)
        if os.path.exists(os.path.join(path, "ensemble.json")):
            for index in range(4):
                if block(path, index).exists():
                    with np.load(block(path, index)) as file:
                        assert all(np.isfinite(file["states"]).ravel())
        same(here, make(path, block=6))
        if os.waitstatus_to_exitcode(status) == 0:
            break
        shutil.rmtree(path)
    assert number >= 8  # what was given, the description, four blocks


def _die_at(call, late, number):
    """End this process, without a word, at a call of the number."""
    import builtins

    where = {"open": builtins, "fsync": os, "replace": os}[call]
    plain, count = getattr(where, call), iter(range(10**6))

    def dying(*given, **named):
        counts = call != "open" or str(given[0]).endswith(".new")
        now = next(count) if counts else -1
        if now == number and not late:
            os._exit(9)
        result = plain(*given, **named)
        if now == number:
            os._exit(9)
        return result

    setattr(where, call, dying)


# ---- what else may be there --------------------------------------------------------------------


def test_other_ensembles_are_refused(path):
    make(path)
    for more, words in (
        ({"h": 0.02}, "the arguments of the members"),
        ({"steps": 40}, "the arguments of the members"),
        ({"keep": "all"}, "stride, keep"),
        ({"consistent": "project"}, "consistent"),
        ({"t0": 1.0}, "t0"),
        ({"parameters": {"a": VALUES["a"] + 1e-16 * (VALUES["a"] > 0.3), "J": VALUES["J"]}},
         "the arguments of the members"),
        ({"parameters": {"a": VALUES["a"][:5]}}, "shape"),
    ):  # fmt: skip
        if more.get("parameters", {}).get("J") is not None:
            more["parameters"]["a"] = np.nextafter(VALUES["a"], 1)
        with pytest.raises(ValueError, match=f"another ensemble.*{words}"):
            make(path, **more)
    with pytest.raises(ValueError, match="another ensemble.*scheme"):
        dal.ensemble(dal.systems.sleigh(), "leapfrog", store=path, **GIVEN)
    with pytest.raises(ValueError, match="another ensemble.*system"):
        dal.ensemble(dal.systems.sleigh(m=2), "midpoint", store=path, **GIVEN)
    with pytest.raises(ValueError, match="system"):
        dal.open_ensemble(path, dal.systems.knife_edge())


def test_functions_are_told_apart(path):
    """By their code, and by what it refers to."""
    def system(strength):
        return dal.System(
            mass=[1.0, 1.0], potential=lambda q: strength * q[0] ** 2,
            gradient=lambda q: [2 * strength * q[0], 0.0], q0=[1.0, 0.0], v0=[0.0, 1.0],
        )  # fmt: skip

    def run(k, keep="end", **more):
        return dal.ensemble(system(k), "midpoint", h=0.1, steps=5, progress=False, store=path,
                            keep=keep, **more)  # fmt: skip

    here = run(1.0)
    same(here, run(1.0))
    with pytest.raises(ValueError, match="another ensemble.*functions"):
        run(2.0)
    shutil.rmtree(path)
    run(1.0, keep=lambda run: run.q[-1, 0])
    with pytest.raises(ValueError, match="another ensemble.*keep"):
        run(1.0, keep=lambda run: run.q[-1, 1])
    shutil.rmtree(path)
    run(1.0, events=[lambda t, q, v: q[0] - 0.5])
    with pytest.raises(ValueError, match="another ensemble.*events"):
        run(1.0, events=[lambda t, q, v: q[0] - 0.6])


def test_two_processes_begin_at_once(path):
    """One of two ensembles has the store, the other is refused, and no block is mixed."""
    for _ in range(4):
        both = [begun(path, h=h, steps=20) for h in (0.01, 0.02)]
        ends = [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in both]
        assert sorted(ends) == [0, 1]
        opened = dal.open_ensemble(path)
        same(dal.ensemble(dal.systems.sleigh(), "midpoint", steps=20, **LONG | {"h": opened.h[0]}),
             opened)  # fmt: skip
        shutil.rmtree(path)


def test_a_process_that_was_forgotten(path):
    """Another ensemble lies at its path now: it is refused, and leaves nothing there."""
    def begin(run):
        if not begun:
            begun.append(True)
            shutil.rmtree(path)
            make(path, h=0.02, block=6)
        return run.q[-1]

    begun = []
    with pytest.raises(StoreError, match="no longer the store of this ensemble"):
        make(path, keep=begin, block=6, threads=1)
    same(make(h=0.02), dal.open_ensemble(path))


def test_a_store_before_its_first_block(path):
    make(path, block=6)
    for index in range(4):
        block(path, index).unlink()
    opened = dal.open_ensemble(path)
    assert len(opened.unfinished) == 23 and np.isnan(opened.q).all() and "23 were" in repr(opened)


def test_a_relative_path(path, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    found = make("here")
    monkeypatch.chdir(tmp_path / "elsewhere")
    same(found, make())


def test_foreign_directories(path, tmp_path):
    with pytest.raises(ValueError, match="is not the store"):
        dal.open_ensemble(tmp_path)
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_bytes(b"cat")
    with pytest.raises(ValueError, match="cat.jpg"):
        make(tmp_path / "photos")
    assert [x.name for x in (tmp_path / "photos").iterdir()] == ["cat.jpg"]
    (tmp_path / "file").write_text("")
    with pytest.raises((OSError, ValueError), match="file"):
        make(tmp_path / "file")
    make(path)
    (Path(path) / "notes.txt").write_text("mine")  # beside what is a store it is let alone
    (Path(path) / "block-1.npz").write_text("not one")
    (Path(path) / ".block-000000000.npz.0011223344556677.new").write_bytes(b"half")
    same(make(), make(path))
    assert (Path(path) / "notes.txt").read_text() == "mine"


def test_a_description_that_was_changed(path):
    make(path, block=6)
    name = Path(path) / "ensemble.json"
    text = name.read_text()
    for old, new in (('"block": 6', '"block": 7'), ('"block": 6', '"block": 0'),
                     ('"block": 6', '"block": "6"'), ('"stride": 0', '"stride": 1'),
                     ("23\n", "1000000000000000\n")):  # fmt: skip
        assert old in text
        name.write_text(text.replace(old, new))
        with pytest.raises((ValueError, StoreError)):
            dal.open_ensemble(path)


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"format": "other", "version": 1}', "\0\1",
                                  '{"format": "dalembert ensemble", "version": 99}'])  # fmt: skip
def test_strange_descriptions(path, text):
    make(path)
    (Path(path) / "ensemble.json").write_text(text)
    for again in (lambda: make(path), lambda: dal.open_ensemble(path)):
        with pytest.raises(ValueError, match="ensemble.json"):
            again()


def test_damaged_blocks_are_named(path):
    here = make()
    make(path, block=6)
    whole = block(path, 1).read_bytes()
    for content in (b"", whole[:100], whole[:-30], b"PK" + whole, os.urandom(500)):
        block(path, 1).write_bytes(content)
        with pytest.raises(StoreError, match="block-000000001.npz.*remove it"):
            dal.open_ensemble(path)
        with pytest.raises(StoreError, match="block-000000001.npz"):
            make(path)
    middle = bytearray(whole)
    place = whole.index(here.q[6].tobytes()[:8])
    middle[place] ^= 1
    block(path, 1).write_bytes(middle)
    opened = dal.open_ensemble(path)  # which reads no numbers
    with pytest.raises(StoreError, match="block-000000001.npz is damaged"):
        opened.q
    shutil.copy(block(path, 0), block(path, 1))
    with pytest.raises(StoreError, match="is not a block of this ensemble"):
        make(path)
    block(path, 1).unlink()
    same(here, make(path))
    other = path + "-other"
    make(other, block=6, h=0.02)
    shutil.copy(block(other, 1), block(path, 1))
    with pytest.raises(StoreError, match="is not a block of this ensemble"):
        dal.open_ensemble(path)


@pytest.mark.parametrize("change", ["shape", "type", "missing", "count"])
def test_blocks_of_another_form(path, change):
    make(path, block=6)
    with np.load(block(path, 2)) as file:
        arrays = dict(file)
    x = arrays.pop("states")
    if change != "missing":
        form = {"shape": x[:, :5], "type": x.astype("f4"), "count": x[:-1]}
        arrays["states"] = form[change]
    np.savez(block(path, 2), **arrays)
    opened = dal.open_ensemble(path)
    for read in (lambda: opened.q, lambda: [*opened.blocks()], lambda: opened.to_xarray().load()):
        with pytest.raises(StoreError, match="block-000000002.npz"):
            read()


def test_what_was_given_is_not_changed(path):
    make(path)
    (name,) = Path(path).glob("given-*-parameters.a.npy")
    for values in (VALUES["a"][::-1], VALUES["a"][:-1], VALUES["a"].astype("f4")):
        np.save(name, values)
        with pytest.raises(StoreError, match="the arguments of the members"):
            dal.open_ensemble(path)
    name.write_bytes(b"not an array")
    with pytest.raises(StoreError, match="-parameters.a.npy"):
        dal.open_ensemble(path)
    name.unlink()
    with pytest.raises(StoreError, match="the arguments of the members"):
        dal.open_ensemble(path)


def test_pickled_objects_are_not_loaded(path):
    make(path, block=6)
    with np.load(block(path, 2)) as file:
        arrays = dict(file)
    arrays["q"] = np.array([print], dtype=object)
    np.savez(block(path, 2), **arrays)
    with pytest.raises(StoreError):
        [*dal.open_ensemble(path).blocks()]


def test_a_full_disk(path, monkeypatch):
    here = make()
    plain, calls = files.replace, []

    def failing(target, content, mode=None):
        calls.append(target)
        if len(calls) > 6:  # four given, two blocks
            raise OSError(28, "No space left on device", str(target))
        plain(target, content, mode)

    monkeypatch.setattr(files, "replace", failing)
    with pytest.raises(OSError, match="No space left"):
        make(path, block=6, threads=1)
    monkeypatch.undo()
    assert len(dal.open_ensemble(path).unfinished) > 0
    same(here, make(path))


def test_about_is_text(path):
    make(path)
    about = json.loads((Path(path) / "ensemble.json").read_text())
    assert about["format"] == "dalembert ensemble" and about["system"]["name"] == "sleigh"
