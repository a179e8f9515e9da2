"""Threads: many runs on one system, exceptions in the right thread, no lock held by C."""

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import dalembert as dal

H = 0.02


def together(count, function):
    """Call ``function(i)`` in ``count`` threads that start at the same moment."""
    barrier = threading.Barrier(count)

    def start(i):
        barrier.wait()
        return function(i)

    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(start, range(count)))


def states(system, count):
    """Initial data in D, another for each thread."""
    rng = np.random.default_rng(2)
    q = system.q0 + 0.1 * rng.standard_normal((count, system.n))
    return q, system.project(q, np.tile(system.v0, (count, 1)))


@pytest.mark.parametrize("scheme", ["midpoint", "leapfrog-kl6", "reference"])
@pytest.mark.parametrize("kind", ["catalogue", "python"])
def test_many_runs_on_one_system(own, scheme, kind):
    system = dal.systems.heisenberg() if kind == "catalogue" else own.system()
    steps = 3000 if kind == "catalogue" else 30
    q, v = states(system, 6)

    def run(i):
        return dal.integrate(system, scheme, q[i], v[i], h=H, steps=steps)

    alone = [run(i) for i in range(6)]
    for a, b in zip(alone, together(6, run)):
        np.testing.assert_array_equal(a.x, b.x)
        assert a.stats == b.stats


def test_geometry_of_one_system(own):
    system = own.system()
    q, v = states(system, 40)
    expected = system.multipliers(q, v)
    for found in together(8, lambda i: [system.multipliers(a, b) for a, b in zip(q, v)]):
        np.testing.assert_array_equal(found, expected)


def test_one_solution(own):
    run = dal.integrate(own.system(), "midpoint", h=H, steps=200)
    found = together(8, lambda i: run.multipliers)
    assert all(x is found[0] for x in found)


def test_a_fork_while_a_thread_computes(own):
    """The child of a fork has no threads that would open a lock: it computes on its own."""
    parent, waiting = os.getpid(), threading.Event()
    inside, go_on = threading.Event(), threading.Event()

    def potential(q):
        if waiting.is_set() and os.getpid() == parent:
            inside.set()
            go_on.wait(20)
        return own.potential(q)

    run = dal.integrate(own.system(potential=potential), "midpoint", h=H, steps=20)
    expected = run.system.energy(run.q, run.v)
    waiting.set()
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(lambda: run.energy)
        assert inside.wait(20)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # a fork beside threads is meant
            child = os.fork()
        if child == 0:
            signal.alarm(10)
            right = False
            try:
                right = np.array_equal(run.energy, expected)
            finally:
                os._exit(0 if right else 1)
        status = os.waitpid(child, 0)[1]
        go_on.set()
        np.testing.assert_array_equal(running.result(), expected)
    assert status == 0, f"the child ended with {status}; 14: it waited for ever"


def test_exceptions_stay_in_their_thread(own):
    """Every thread raises its own exception on the one system, some steps into the run."""

    class Mine(Exception):
        pass

    local = threading.local()

    def gradient(q):
        local.calls = getattr(local, "calls", 0) + 1
        if local.calls == 20 + local.number:
            raise Mine(local.number)
        return own.gradient(q)

    system = own.system(gradient=gradient)

    def run(i):
        local.number = i
        with pytest.raises(Mine) as caught:
            dal.integrate(system, "midpoint", h=H, steps=1000)
        return caught.value.args

    assert together(6, run) == [(i,) for i in range(6)]


class Enough(Exception):
    """Ends a run from its progress function."""


def test_c_runs_without_the_lock_of_the_interpreter(particle):
    """While a thread is in C, in blocks of about 0.07 s, this one goes on."""
    enough, blocks = threading.Event(), []

    def progress(done, total):
        blocks.append(done)
        if enough.is_set():
            raise Enough

    def run():
        with pytest.raises(Enough):
            dal.integrate(
                particle, "midpoint", h=1e-6, steps=10**10, stride=10**4, progress=progress
            )

    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(run)
        time.sleep(0.2)  # until its blocks are long
        before = len(blocks)
        for _ in range(60):
            time.sleep(0.001)
        within = len(blocks) - before
        enough.set()
        running.result()
    assert within < 30  # with the lock held by C there would be one for each of the 60


def test_a_run_in_another_process():
    """A system goes there as its description, and the same bits come back."""
    sleigh = dal.systems.sleigh(a=0.3)
    code = """
import pickle, sys
import dalembert as dal
system = pickle.load(sys.stdin.buffer)
pickle.dump(dal.integrate(system, "leapfrog", h=0.1, steps=100).x, sys.stdout.buffer)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], input=pickle.dumps(sleigh), stdout=subprocess.PIPE, check=True
    )
    here = dal.integrate(sleigh, "leapfrog", h=0.1, steps=100).x
    np.testing.assert_array_equal(pickle.loads(done.stdout), here)
