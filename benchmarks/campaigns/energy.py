"""The energy over long times by Taylor series: a random walk by the roundoff of the steps.

    ./dev shell python benchmarks/campaigns/energy.py [--problem springs] [--starts 8] [--until 1e6]

For each problem of benchmarks/peers that keeps its energy the starts are its own, moved by 1 % at
random and projected into D.  Printed is the root mean square over the starts of the change of the
energy, relative to the largest kinetic energy, at each power of ten of the time.  The last column
is the slope of its logarithm: 1/2 for a random walk, 1 for a drift.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import dalembert as dal

PEERS = Path(__file__).resolve().parents[1] / "peers"
FIRST = 2  # power of ten of the time of the first row
ROWS = 100  # from each power to the next


def starts(system: dal.System, state: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return initial data near a state."""
    q, v = np.split(state, 2)
    near = q + 0.01 * np.random.default_rng(1).normal(size=(count, len(q)))
    near[0] = q
    return near, np.array([system.project(x, v) for x in near])


def changes(system: dal.System, q0: np.ndarray, v0: np.ndarray, powers: range) -> np.ndarray:
    """Return the change of the energy of a motion at each power of ten of the time."""
    found, kinetic, t = [], 0.0, 0.0
    E = system.energy(q0, v0)
    for power in powers:
        h = (10.0**power - t) / ROWS
        run = dal.integrate(system, "taylor", q0, v0, t0=t, h=h, steps=ROWS, check_h=False)
        q0, v0, t = run.q[-1], run.v[-1], 10.0**power
        kinetic = max(kinetic, (run.energy - system.energy(run.q, 0 * run.v)).max())
        found.append(abs(run.energy[-1] - E))
    return np.array(found) / kinetic


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--problem", action="append")
    parser.add_argument("--starts", type=int, default=8)
    parser.add_argument("--until", type=float, default=1e6)
    asked = parser.parse_args()
    sys.path.insert(0, str(PEERS))
    from peer_dalembert import system as system_of
    from problems import PROBLEMS

    for name, make in PROBLEMS.items():
        problem = make()
        if not problem.conserves or (asked.problem and name not in asked.problem):
            continue
        system = system_of(problem)
        last = round(np.log10(asked.until)) - (problem.pace > 1)
        powers = range(FIRST, last + 1)
        data = zip(*starts(system, np.array(problem.start), asked.starts))
        begun = time.process_time()
        rms = np.sqrt(np.mean([changes(system, *one, powers) ** 2 for one in data], axis=0))
        spent = (time.process_time() - begun) / asked.starts
        slope = np.polyfit(list(powers), np.log10(np.maximum(rms, 1e-17)), 1)[0]
        row = ", ".join(f"1e{p} {x:.1e}" for p, x in zip(powers, rms))
        print(f"{name}: {row}; slope {slope:.2f}; {spent:.1f} s for a start", flush=True)


if __name__ == "__main__":
    main()
