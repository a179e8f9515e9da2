"""What Python adds to a run: storing a million steps against C, and callables written in Python.

Usage: ``python bench_python.py BENCH_STORE``, the program made from bench_store.c.

Times are minima over interleaved repetitions; fails if a bar is missed.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

import dalembert as dal

REPETITIONS = 15
STORED_STEPS = 1_000_000
CALLABLE_STEPS = 5_000


def seconds(run: Callable[[], dal.Solution]) -> float:
    """Time one run; its arrays are freed after the clock has stopped."""
    start = time.perf_counter()
    result = run()
    elapsed = time.perf_counter() - start
    assert result.success
    return elapsed


def at_most(what: str, measured: float, bar: float) -> bool:
    """Print a line of the table."""
    kept = measured <= bar
    print(f"  {what:52} {measured:8.2f}   <= {bar:<4g} {'ok' if kept else 'MISSED'}")
    return kept


def stored_steps(program: str) -> bool:
    """Store a million steps from Python and from C, both into freshly allocated arrays."""
    particle = dal.systems.particle()
    in_python, in_c = [], []
    for _ in range(REPETITIONS):
        in_python.append(seconds(lambda: dal.integrate(particle, "midpoint", h=0.01,
                                                       steps=STORED_STEPS)))
        done = subprocess.run([program, str(STORED_STEPS)], capture_output=True, text=True,
                              check=True)
        in_c.append(float(done.stdout))
    print(f"{STORED_STEPS} stored steps of the particle, midpoint")
    print(f"  {'from C':52} {1e3 * min(in_c):8.2f} ms")
    print(f"  {'from Python':52} {1e3 * min(in_python):8.2f} ms")
    return at_most("from Python / from C", min(in_python) / min(in_c), 1.5)


def python_callables() -> bool:
    """Step a system whose functions are Python and return arrays."""
    own = dal.System(
        mass=[1.0, 1.0, 1.0],
        mu=lambda q: np.array([[-q[1], 0.0, 1.0]]),
        mu_v_q=lambda q, v: np.array([[0.0, -v[0], 0.0]]),
        q0=[0.5, 0.3, -0.2],
        v0=[1.0, 0.7, 0.3],
    )
    times = [seconds(lambda: dal.integrate(own, "midpoint", h=0.01, steps=CALLABLE_STEPS))
             for _ in range(REPETITIONS)]
    print("step of the particle from Python callables that return arrays, midpoint")
    return at_most("microseconds a step", 1e6 * min(times) / CALLABLE_STEPS, 10.0)


def main(program: str) -> int:
    kept = [stored_steps(program), python_callables()]
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
