"""Members of an ensemble that are stepped together, against the step of one after the other.

Both are compiled from expressions here: the scalar one as models are, with the instructions of this
processor.  The lanes have different initial data and make all their steps in the first cache.

Ratios within one run, of the least times of some.  Fails if a bar is missed.
"""

from __future__ import annotations

import dataclasses
import os
import sys
import tempfile
import time
from typing import Any

import numpy as np
import sympy
from bench_stage import particle_oscillator, sleigh
from sympy import cos, sin

import dalembert as dal
from dalembert.core import ffi, lib
from dalembert.system import twins

H, STEPS, REPETITIONS, MOST = 0.01, 500, 60, 16

# Lanes of a vector, the instructions, and how many times as many steps they have to make: of stages
# with constant mass, and with momenta.
SETS = ((2, "SSE2", 0.0, 0.0), (4, "AVX2", 2.5, 2.0), (8, "AVX-512", 4.0, 3.0))


def free_sleigh() -> dal.System:
    """Without a potential."""
    x, y, theta = dal.coordinates("x y theta")
    m, J, a = sympy.symbols("m J a")
    L = (m * (x.d**2 + y.d**2) + J * theta.d**2) / 2
    return dal.System.from_sympy(L, [-sin(theta) * x.d + cos(theta) * y.d - a * theta.d],
                                 parameters={m: 1.5, J: 0.4, a: 0.3}, name="free_sleigh",
                                 q0=[0.3, -0.2, 0.3], v0=[0.2, 0.3, 1])


def members(system: dal.System, scheme: str, count: int) -> list[dal.Stepper]:
    """Return steppers from initial data of their own."""
    rng = np.random.default_rng(1)
    made = []
    for _ in range(count):
        q = system.q0 + rng.uniform(-0.02, 0.02, system.n)
        v = system.project(q, system.v0 + rng.uniform(-0.02, 0.02, system.n))
        made.append(dal.Stepper(system, scheme, h=H, q0=q, v0=v))
    return made


def measured(system: dal.System, scheme: str) -> dict[int, float]:
    """Return the seconds for a step of a member by lanes of a vector; 1: of the scalar step."""
    together = type(system)._of(dataclasses.replace(system._source, lanes=True))
    alone = members(system, scheme, MOST)
    side_by_side = members(together, scheme, MOST)
    made: Any = ffi.new("dal__lanes **")
    assert lib.dal__lanes_new(made, side_by_side[0]._handle, ffi.NULL) == 0
    block = made[0]
    found: dict[int, list[float]] = {1: []}
    first = [stepper.save() for stepper in alone]
    for _ in range(REPETITIONS):
        for stepper, state in zip(alone, first):
            stepper.restore(state)
        start = time.perf_counter()
        for stepper in alone:
            lib.dal_advance(stepper._handle, STEPS, ffi.NULL, ffi.NULL)
        found[1].append((time.perf_counter() - start) / MOST)
        for vector, *_ in SETS:
            width = lib.dal__lanes_use(block, vector)
            if width == 0:
                continue
            for lane in range(width):
                lib.dal__lanes_load(block, lane, side_by_side[lane]._handle)
            start = time.perf_counter()
            lib.dal__lanes_advance(block, STEPS)
            found.setdefault(vector, []).append((time.perf_counter() - start) / width)
            assert all(lib.dal__lanes_made(block, lane) == STEPS for lane in range(width))
    lib.dal__lanes_free(block)
    return {vector: min(times) / STEPS for vector, times in found.items()}


def from_formulas(name: str) -> dal.System:
    """Return a system of the library, compiled from its formulas."""
    twin = twins.twin(getattr(dal.systems, name)(), "lanes")
    assert twin is not None
    return type(twin)._of(dataclasses.replace(twin._source, part=""))


def main() -> int:
    kept = True
    systems = {make.__name__: make() for make in (particle_oscillator, sleigh, free_sleigh)}
    momenta = ("sleigh_contact", "rolling_disc", "n_trailer", "snakeboard")
    systems |= {name: from_formulas(name) for name in momenta}
    for label, system in systems.items():
        for scheme in ("leapfrog", "midpoint"):
            times = measured(system, scheme)
            print(f"{label}, {scheme}, h = {H}: {1e9 * times[1]:.1f} ns a step alone")
            for vector, name, *bars in SETS:
                bar = bars[label in momenta]
                if vector in times:
                    ratio = times[1] / times[vector]
                    kept &= ratio >= bar
                    print(f"  {f'{name}, ns for a member':52} {1e9 * times[vector]:8.2f}")
                    print(f"  {f'{name}, times as many steps':52} {ratio:8.2f}   >= {bar:<4g} "
                          f"{'ok' if ratio >= bar else 'MISSED'}")
    return 0 if kept else 1


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as directory:
        os.environ["DALEMBERT_CACHE"] = directory
        sys.exit(main())
