"""Members of ensembles to T = 100 on one thread: time for each, and its error.

Lanes of the library against the batch mode of heyoka.  First the particle in springs by a scheme
that keeps to D, and its energy, on the equations with the multiplier put in.  Then the Taylor
series of both in D, on all problems: the time for an error of the state, by interpolation between
tolerances, and the ratio of the times.  Run it where heyoka and the package are installed:

    PYTHONPATH=build-dev/python python benchmarks/peers/ensembles.py [springs knife_edge ...]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import heyoka
import numpy as np
from draw import seconds_for
from peer_dalembert import system as system_of
from peer_heyoka import expression
from problems import PROBLEMS, t

import dalembert as dal

T_END, RUNS = 100.0, 5
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 1e-15)
ACCURACIES = (1e-6, 1e-9, 1e-12)
BATCHES = (4, 8)  # heyoka's members at a time; the faster ones count


def shortest(call: Callable[[], np.ndarray]) -> tuple[float, np.ndarray]:
    """Return the least CPU time of several calls, and the result."""
    best = np.inf
    for _ in range(RUNS):
        begun = time.process_time()
        found = call()
        best = min(best, time.process_time() - begun)
    return best, found


def by_heyoka(field, starts, tolerance, batch):
    """Return the ends of motions of y' = f, and the time of a member."""
    flow = heyoka.taylor_adaptive_batch(field, np.zeros((starts.shape[1], batch)), tol=tolerance)

    def call():
        ends = []
        for k in range(0, len(starts), batch):
            flow.state[:] = starts[k : k + batch].T
            flow.set_time(0.0)
            flow.propagate_until(T_END)
            ends.append(flow.state.T.copy())
        return np.concatenate(ends)

    seconds, ends = shortest(call)
    return seconds / len(starts), ends


def by_lanes(system, scheme, q0, v0, h):
    """Return the ends (q, v) of members, and the time of one."""

    def call():
        runs = dal.ensemble(system, scheme, q0, v0, h=h, t_end=T_END, lanes=True, threads=1,
                            progress=False)  # fmt: skip
        return np.hstack([runs.q, runs.v])

    seconds, ends = shortest(call)
    return seconds / len(q0), ends


def energies() -> None:
    """Print the first comparison."""
    members, of_heyoka = 4096, 1024
    system = dal.systems.particle_oscillator()
    q0 = np.tile(system.q0, (members, 1))
    v0 = system.v0 * np.random.default_rng(0).uniform(0.8, 1.2, (members, 1))
    first = system.energy(q0, v0)
    x, y, z, u, v, w = heyoka.make_vars("x", "y", "z", "u", "v", "w")
    k1, k2, k3 = (system.parameters[name] for name in ("k1", "k2", "k3"))
    pull = (u * v - y * k1 * x + k3 * z) / (1.0 + y * y)  # lambda, of w = y u
    field = [(x, u), (y, v), (z, w), (u, -k1 * x - pull * y), (v, -k2 * y), (w, -k3 * z + pull)]

    def say(name, seconds, ends):
        off = abs(system.energy(ends[:, :3], ends[:, 3:]) / first[: len(ends)] - 1).max()
        print(f"{name} {1e3 * seconds:.4f} ms, energy to {off:.1e}", flush=True)

    for h in (0.5, 0.4, 0.25, 0.2, 0.1):
        say(f"lanes, leapfrog-kl8, h = {h:<6g}", *by_lanes(system, "leapfrog-kl8", q0, v0, h))
    states = np.hstack([q0, v0])[:of_heyoka]
    for tolerance in (1e-7, 1e-9, 1e-11, 1e-13, 1e-16):
        say(f"heyoka, tolerance {tolerance:<12g}", *by_heyoka(field, states, tolerance, 8))


def series(name: str) -> None:
    """Print the second comparison for a problem."""
    problem, members = PROBLEMS[name](), 256
    system, ode = system_of(problem), problem.odes[1]
    start, n = np.array(problem.start), system.n
    turned = np.random.default_rng(1).uniform(0.9, 1.1, (members, 1))
    q0 = np.tile(start[:n], (members, 1))
    v0 = turned * start[n:]
    known = {x: heyoka.make_vars(x.name) for x in ode.symbols} | {t: heyoka.time}
    field = [(known[x], expression(heyoka, f, known)) for x, f in zip(ode.symbols, ode.rates)]
    starts = np.array([ode.into(x) for x in np.hstack([q0, v0])])
    right = by_lanes(system, "taylor", q0, v0, T_END)[1]
    size = abs(right).max()
    ours, theirs = [], []
    for tolerance in TOLERANCES:
        seconds, ends = by_lanes(system, dal.Scheme.taylor(tolerance), q0, v0, T_END)
        ours.append({"median": seconds, "error": abs(ends - right).max() / size})
        seconds, ends = min((by_heyoka(field, starts, tolerance, k) for k in BATCHES),
                            key=lambda found: found[0])  # fmt: skip
        theirs.append({"median": seconds, "error": abs(ode.out_of(ends) - right).max() / size})
    found = [[seconds_for({"points": side}, accuracy) for side in (ours, theirs)]
             for accuracy in ACCURACIES]  # fmt: skip
    row = ", ".join(f"{1e6 * one:.0f} {1e6 * other:.0f} us: {one / other:.2f}" if one and other
                    else "-" for one, other in found)  # fmt: skip
    print(f"{name}: {row}", flush=True)


def main() -> None:
    names = sys.argv[1:]
    if not names:
        energies()
    print("time of a member for errors of", *ACCURACIES, "by taylor in lanes, by heyoka in D")
    for name in names or PROBLEMS:
        series(name)


if __name__ == "__main__":
    main()
