"""Many coordinates: skates in a row, whose constraints touch three coordinates each.

Usage: ``python bench_chain.py``.  The time of a step for 333, 999 and 2997 skates, by functions of
NumPy; and how long a model of 60 skates, 180 coordinates, takes to be made from expressions.
Minima over repetitions.  Fails if a bar is missed.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time

import numpy as np
import sympy

import dalembert as dal

REPETITIONS, STEPS = 5, 50
MOST_MS = 5.0  # a step of 999 skates
MOST_RATIO = 4.5  # of 2997 skates against 999
MOST_SECONDS = 10.0  # to make the model


def skates(count: int) -> tuple[dal.System, np.ndarray, np.ndarray]:
    own = np.arange(3 * count).reshape(count, 3)

    def forms(q):
        heading = q[2::3]
        return np.stack([-np.sin(heading), np.cos(heading), 0 * heading], 1).ravel()

    def derivative(q, v):
        turn = -np.cos(q[2::3]) * v[::3] - np.sin(q[2::3]) * v[1::3]
        return np.stack([0 * turn, 0 * turn, turn], 1).ravel()

    def springs(q):
        d = np.diff(q[own[:, :2]], axis=0)
        return d, np.hypot(*d.T)

    def gradient(q):
        d, length = springs(q)
        pull = d * (1 - 1 / length)[:, None]
        result = np.zeros((count, 3))
        result[1:, :2] += pull
        result[:-1, :2] -= pull
        return result.ravel()

    system = dal.System(
        mass=np.ones(3 * count), mu=forms, mu_v_q=derivative,
        potential=lambda q: float(np.sum((springs(q)[1] - 1) ** 2) / 2), gradient=gradient,
        sparsity=(np.repeat(np.arange(count), 3), own.ravel()),
    )  # fmt: skip
    heading = 0.3 * np.sin(np.arange(count))
    q0 = np.stack([np.arange(count), 0 * heading, heading], 1).ravel()
    v0 = np.stack([np.cos(heading), np.sin(heading), 0.5 + 0 * heading], 1).ravel()
    return system, q0, v0


def milliseconds(count: int, scheme: str) -> float:
    system, q0, v0 = skates(count)
    least = np.inf
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        dal.integrate(system, scheme, q0, v0, h=0.01, steps=STEPS, stride=STEPS,
                      check_h=False)
        least = min(least, 1e3 * (time.perf_counter() - start) / STEPS)
    return least


def seconds_to_make(count: int) -> float:
    q = dal.coordinates(" ".join(f"x{i} y{i} a{i}" for i in range(count)))
    x, y, a = q[::3], q[1::3], q[2::3]
    lengths = [
        sympy.sqrt((x[i + 1] - x[i]) ** 2 + (y[i + 1] - y[i]) ** 2) for i in range(count - 1)
    ]
    L = sum(c.d**2 for c in q) / 2 - sum((r - 1) ** 2 for r in lengths) / 2
    rows = [-sympy.sin(a[i]) * x[i].d + sympy.cos(a[i]) * y[i].d for i in range(count)]
    start = time.perf_counter()
    dal.System.from_sympy(L, rows, q)
    return time.perf_counter() - start


def main() -> int:
    missed = 0
    for scheme in ("leapfrog", "midpoint"):
        times = {count: milliseconds(count, scheme) for count in (333, 999, 2997)}
        ratio = times[2997] / times[999]
        shown = ", ".join(f"{count} skates {ms:.3f} ms" for count, ms in times.items())
        print(f"{scheme}: {shown} a step (bar {MOST_MS} of 999)")
        print(f"{scheme}: 2997 / 999 skates {ratio:.2f} (bar {MOST_RATIO})")
        missed += times[999] > MOST_MS or ratio > MOST_RATIO
    with tempfile.TemporaryDirectory() as folder:
        os.environ["DALEMBERT_CACHE"] = folder
        made = seconds_to_make(60)
    print(f"a model of 180 coordinates from expressions: {made:.1f} s (bar {MOST_SECONDS})")
    return int(missed + (made > MOST_SECONDS) > 0)


if __name__ == "__main__":
    sys.exit(main())
