"""Ensembles on other processes: pools that break, and dask."""

from __future__ import annotations

import concurrent.futures as futures
import multiprocessing
import os
import signal
from pathlib import Path

import distributed
import numpy as np
import pytest

import dalembert as dal
from dalembert.ensembles import store

VALUES = {"a": np.linspace(0.1, 0.4, 24)}
GIVEN = {"parameters": VALUES, "h": 0.01, "steps": 20, "progress": False, "block": 3}


def make(**more):
    return dal.ensemble(dal.systems.sleigh(), "midpoint", **GIVEN | more)


def same(one, other):
    assert [*one] == [*other]
    for name in one:
        assert np.array_equal(one[name], other[name], equal_nan=True), name


class DiesOnce:
    """A reduction that ends its process, once for all processes, at the member with one value."""

    def __init__(self, path, value, always=False):
        self.path, self.value, self.always = path, value, always

    def __call__(self, run):
        if run.system.parameters["a"] == self.value:
            with open(self.path, "a") as file:
                file.write("died\n")
            if self.always or len(Path(self.path).read_text().splitlines()) == 1:
                os.kill(os.getpid(), signal.SIGKILL)
        return run.q[-1]


def in_processes():
    return futures.ProcessPoolExecutor(2, multiprocessing.get_context("spawn"))


# ---- pools of processes ------------------------------------------------------------------------


@pytest.mark.parametrize("how", ["pool", "function"])
@pytest.mark.parametrize("stored", [False, True])
def test_a_worker_that_dies(tmp_path, how, stored):
    dies = DiesOnce(str(tmp_path / "died"), VALUES["a"][10])
    here = make(keep=lambda run: run.q[-1])
    place = {"store": str(tmp_path / "store")} if stored else {}
    if how == "pool":
        with in_processes() as executor:
            there = make(keep=dies, executor=executor, **place)
    else:
        there = make(keep=dies, executor=in_processes, **place)
    same(here, there)
    assert len((tmp_path / "died").read_text().splitlines()) == 2


def test_a_member_that_kills_whoever_makes_it(tmp_path):
    dies = DiesOnce(str(tmp_path / "died"), VALUES["a"][10], always=True)
    here = make(keep=lambda run: run.q[-1])
    with pytest.warns(dal.DalembertWarning, match="3 of 24 members failed.*died"):
        there = make(keep=dies, executor=in_processes)
    assert there.failed.tolist() == [9, 10, 11]
    others = [k for k in range(24) if k not in (9, 10, 11)]
    assert (there.value[others] == here.value[others]).all() and np.isnan(there.value[9:12]).all()
    assert "died" in there.message(10)


def test_an_executor_that_is_broken_for_good():
    class Broken(futures.Executor):
        def submit(self, *given):
            raise futures.BrokenExecutor("no workers")

    with pytest.raises(futures.BrokenExecutor):
        make(executor=Broken())


def test_what_a_worker_cannot_load():
    def here_alone(run):
        return run.q[-1]

    with pytest.raises(Exception, match="pickle|local object"):
        make(keep=here_alone, executor=in_processes)


def test_ctrl_c_with_processes():
    with in_processes() as executor:
        def interrupt(done, total):
            if done:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt) as raised:
            make(executor=executor, steps=20_000, block=1, progress=interrupt)
    partial = raised.value.partial
    made = np.flatnonzero(partial.success)
    assert 0 < len(made) and (partial.q[made] == make(steps=20_000).q[made]).all()


class Elsewhere(futures.ThreadPoolExecutor):
    """Workers that see no store."""

    def submit(self, function, *given):
        def blind(*given):
            plain, store.is_that = store.is_that, lambda *given: False
            try:
                return function(*given)
            finally:
                store.is_that = plain

        return super().submit(blind, *given)


def test_a_store_that_workers_do_not_see(tmp_path):
    with Elsewhere(1) as executor:
        there = make(executor=executor, store=str(tmp_path / "store"))
    same(make(), there)
    same(there, dal.open_ensemble(tmp_path / "store"))


# ---- dask --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def client():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None,
    ) as cluster, distributed.Client(cluster) as client:  # fmt: skip
        yield client


@pytest.mark.parametrize("stored", [False, True])
def test_dask(client, tmp_path, stored):
    here = make(keep=["all", "energy"])
    place = {"store": str(tmp_path / "store")} if stored else {}
    there = make(keep=["all", "energy"], executor=client.get_executor(pure=False), **place)
    same(here, there)


def test_dask_with_a_worker_that_dies(client, tmp_path):
    dies = DiesOnce(str(tmp_path / "died"), VALUES["a"][10])
    here = make(keep=lambda run: run.q[-1])
    there = make(keep=dies, executor=client.get_executor(pure=False))
    same(here, there)
    assert len((tmp_path / "died").read_text().splitlines()) >= 2


def test_dask_with_a_member_that_always_kills(client, tmp_path):
    dies = DiesOnce(str(tmp_path / "died"), VALUES["a"][10], always=True)
    here = make(keep=lambda run: run.q[-1])
    with pytest.warns(dal.DalembertWarning, match="members failed"):
        there = make(keep=dies, executor=client.get_executor(pure=False))
    assert 10 in there.failed and len(there.failed) <= 6
    good = np.flatnonzero(there.success)
    assert len(good) >= 18 and (there.value[good] == here.value[good]).all()
