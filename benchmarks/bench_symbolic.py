"""Models from SymPy: their step against C by hand, and how long it takes until they run.

Usage: ``python bench_symbolic.py BENCH_SYMBOLIC BENCH_STORE``, the programs made from
bench_symbolic.c and bench_store.c.

Ratios within one run; seconds are of this machine.  Fails if a bar is missed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np
import sympy

import dalembert as dal
from dalembert import compiler
from dalembert.symbolic import evaluation

STORED_STEPS = 1_000_000


def particle() -> dal.System:
    x, y, z = dal.coordinates("x y z")
    return dal.System.from_sympy((x.d**2 + y.d**2 + z.d**2) / 2, [z.d - y * x.d],
                                 q0=[0.5, 0.3, -0.2], v0=[1, 0.7, 0.3])


def sleigh() -> dal.System:
    x, y, theta = dal.coordinates("x y theta")
    a = sympy.Symbol("a")
    L = (x.d**2 + y.d**2) / 2 + sympy.Rational(3, 10) * theta.d**2
    row = -sympy.sin(theta) * x.d + sympy.cos(theta) * y.d - a * theta.d
    return dal.System.from_sympy(L, [row], parameters={a: 0.8})


def disk() -> dal.System:
    x, y, theta, phi = dal.coordinates("x y theta phi")
    R = sympy.Symbol("R")
    L = (x.d**2 + y.d**2) / 2 + theta.d**2 / 4 + phi.d**2 / 8
    rows = [x.d - R * sympy.cos(phi) * theta.d, y.d - R * sympy.sin(phi) * theta.d]
    return dal.System.from_sympy(L, rows, parameters={R: 0.5})


def snakeboard() -> dal.System:
    """n = 5, m = 2: the largest of the small ones."""
    x, y, theta, psi, phi = dal.coordinates("x y theta psi phi")
    m, r, J0, J1 = sympy.symbols("m r J0 J1")
    L = m * (x.d**2 + y.d**2 + r**2 * theta.d**2) / 2 + J0 * psi.d**2 / 2
    L += J0 * psi.d * theta.d + J1 * phi.d**2
    rows = [-sympy.sin(theta + s * phi) * x.d + sympy.cos(theta + s * phi) * y.d
            - s * r * sympy.cos(phi) * theta.d for s in (1, -1)]
    return dal.System.from_sympy(L, rows, parameters={m: 6, r: 0.25, J0: 0.01, J1: 0.001})


def trailers(count: int) -> dal.System:
    """A car with trailers: n = count + 3, m = count + 1."""
    x, y, *angles = dal.coordinates("x y " + " ".join(f"a{i}" for i in range(count + 1)))
    rows, X, Y = [], x.d, y.d
    for i, angle in enumerate(angles):
        if i > 0:
            X, Y = X + sympy.sin(angle) * angle.d, Y - sympy.cos(angle) * angle.d
        rows.append(sympy.sin(angle) * X - sympy.cos(angle) * Y)
    L = (x.d**2 + y.d**2 + sum(a.d**2 for a in angles)) / 2
    return dal.System.from_sympy(L, rows, coordinates=[x, y, *angles])


def at_most(what: str, measured: float, bar: float) -> bool:
    """Print a line of the table."""
    kept = measured <= bar
    print(f"  {what:52} {measured:8.3f}   <= {bar:<4g} {'ok' if kept else 'MISSED'}")
    return kept


def until_it_runs(make: Callable[[], dal.System]) -> float:
    """Return the seconds from the lines of a model to its first step."""
    start = time.perf_counter()
    system = make()
    q = np.linspace(0.1, 0.4, system.n)
    v = system.project(q, np.ones(system.n))
    assert dal.integrate(system, "midpoint", q, v, h=1e-3, steps=1).success
    return time.perf_counter() - start


def start_up() -> bool:
    """Cold and from the cache, with SymPy imported; the least of some."""
    print("seconds from expressions to the first step")
    kept = []
    for make, bar in ((particle, 1.0), (snakeboard, 1.0), (lambda: trailers(10), 15.0)):
        cold, warm = [], []
        for _ in range(3):
            with tempfile.TemporaryDirectory() as directory:
                os.environ["DALEMBERT_CACHE"] = directory
                for times in (cold, warm):
                    sympy.core.cache.clear_cache()
                    compiler._libraries.clear()
                    times.append(until_it_runs(make))
        name = getattr(make, "__name__").replace("<lambda>", "car with 10 trailers")
        kept.append(at_most(f"{name}, cold", min(cold), bar))
        kept.append(at_most(f"{name}, from the cache", min(warm), 0.05 if bar == 1 else 0.5))
    return all(kept)


def growth_vector() -> bool:
    """Return the least time of several runs of the largest system, to its end."""
    system = trailers(10)
    q = np.linspace(0.1, 1.3, system.n)
    times: list[list[float]] = [[], []]
    for _ in range(3):
        for found, at in zip(times, ((), (q, np.zeros(system.n)))):
            start = time.perf_counter()
            assert system.check(*at).growth == tuple(range(2, 14))
            found.append(time.perf_counter() - start)
    print("seconds of a check of the car with 10 trailers, growth vector of D and all")
    kept = [at_most("at a general point", min(times[0]), 10),
            at_most("at a given point", min(times[1]), 20)]
    return all(kept)


def stored_steps(program: str) -> bool:
    """Store a million steps from Python and from C."""
    system = particle()
    in_python, in_c = [], []
    for _ in range(15):
        start = time.perf_counter()
        run = dal.integrate(system, "midpoint", h=0.01, steps=STORED_STEPS)
        in_python.append(time.perf_counter() - start)
        assert run.success
        del run
        done = subprocess.run([program, str(STORED_STEPS)], capture_output=True, text=True,
                              check=True)
        in_c.append(float(done.stdout))
    print(f"{STORED_STEPS} stored steps of the particle, midpoint")
    return at_most("from Python, from expressions / from C, by hand", min(in_python) / min(in_c),
                   1.25)


def main(steps: str, store: str) -> int:
    with tempfile.TemporaryDirectory() as directory:
        os.environ["DALEMBERT_CACHE"] = directory
        kept = []
        for i, (make, values) in enumerate(((particle, []), (sleigh, ["0.8"]), (disk, ["0.5"]))):
            path = str(evaluation.library(make()._model, "steps").path)
            done = subprocess.run([steps, str(i), path, *values], check=False)
            kept.append(done.returncode == 0)
        kept.append(stored_steps(store))
        kept.append(start_up())
        kept.append(growth_vector())
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
