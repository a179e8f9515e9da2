"""Members of the particle in springs to T = 100: time for each, and error of the energy.

The library's lanes on one thread against the batch mode of heyoka, eight members at a time, on the
equations with the multiplier put in.  Run it where heyoka and the package are installed:

    PYTHONPATH=build-dev/python python benchmarks/peers/ensembles.py
"""

from __future__ import annotations

import time

import heyoka
import numpy as np

import dalembert as dal

T_END, MEMBERS, OF_HEYOKA, BATCH, RUNS = 100.0, 4096, 1024, 8, 3

system = dal.systems.particle_oscillator()
q0 = np.tile(system.q0, (MEMBERS, 1))
v0 = system.v0 * np.random.default_rng(0).uniform(0.8, 1.2, (MEMBERS, 1))


def error(q, v):
    """Return the largest relative error of the energy."""
    first = system.energy(q0[: len(q)], v0[: len(q)])
    return abs(system.energy(q, v) / first - 1).max()


def by_lanes(scheme, h):
    best = np.inf
    for _ in range(RUNS):
        start = time.perf_counter()
        runs = dal.ensemble(system, scheme, q0, v0, h=h, t_end=T_END, lanes=True, threads=1,
                            progress=False)  # fmt: skip
        best = min(best, time.perf_counter() - start)
    return 1e3 * best / MEMBERS, error(runs.q, runs.v)


def by_heyoka(tolerance):
    x, y, z, u, v, w = heyoka.make_vars("x", "y", "z", "u", "v", "w")
    k1, k2, k3 = (system.parameters[name] for name in ("k1", "k2", "k3"))
    pull = (u * v - y * k1 * x + k3 * z) / (1.0 + y * y)  # lambda, of w = y u
    field = [(x, u), (y, v), (z, w), (u, -k1 * x - pull * y), (v, -k2 * y), (w, -k3 * z + pull)]
    batch = heyoka.taylor_adaptive_batch(field, state=np.zeros((6, BATCH)), tol=tolerance)
    best = np.inf
    for _ in range(RUNS):
        ends, start = [], time.perf_counter()
        for k in range(0, OF_HEYOKA, BATCH):
            batch.state[:3], batch.state[3:] = q0[k : k + BATCH].T, v0[k : k + BATCH].T
            batch.set_time(0.0)
            batch.propagate_until(T_END)
            ends.append(batch.state.T.copy())
        best = min(best, time.perf_counter() - start)
    x = np.concatenate(ends)
    return 1e3 * best / OF_HEYOKA, error(x[:, :3], x[:, 3:])


for h in (0.5, 0.4, 0.25, 0.2, 0.1):
    took, off = by_lanes("leapfrog-kl8", h)
    print(f"lanes, leapfrog-kl8, h = {h:<6g} {took:.4f} ms, energy to {off:.1e}")
for tolerance in (1e-7, 1e-9, 1e-11, 1e-13, 1e-16):
    took, off = by_heyoka(tolerance)
    print(f"heyoka, tolerance {tolerance:<12g} {took:.4f} ms, energy to {off:.1e}")
