"""Runs with events to t = 100 by Taylor series: the library's times, and those of heyoka.

For each problem there is one event at a time: a velocity or coordinate that changes its sign,
sin(50 t), and an oscillating function of the state.  No event ends the run or changes the state.
heyoka has its default tolerance; its callback appends the time.  It integrates the ODE for (q, v),
and that in a basis of D.

All calls of a problem alternate in one process, and the least times of the wall count.  Each is
also made without the event, and the library's steps alone, by a stepper.  Columns are the time with
the event, that without, both in microseconds, and the number of events.  The ratios are those of
our times to heyoka's, with the event, without it, and of what the event adds.  Counts that differ
are marked by *.  A zero at the start is no event.

Run it where heyoka and the package are installed:

    PYTHONPATH=build-dev/python python benchmarks/peers/events.py [--rounds 15] [springs ...]
"""

from __future__ import annotations

import os

# One thread: the calls are compared.
for _name in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_name}_NUM_THREADS", "1")

import argparse  # noqa: E402
import time  # noqa: E402
import warnings  # noqa: E402
from collections.abc import Callable  # noqa: E402
from dataclasses import dataclass, field  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402
import sympy as sp  # noqa: E402
from common import T_STATE, heyoka  # noqa: E402
from peer_dalembert import system as system_of  # noqa: E402
from peer_heyoka import expression  # noqa: E402
from problems import PROBLEMS, Ode, Problem, t  # noqa: E402

import dalembert as dal  # noqa: E402

AT_START = 1e-9  # a zero of g at the start: heyoka counts it
ZERO = {  # what changes its sign
    "springs": "x", "knife_edge": "x", "sleigh": "x", "contact": "x", "rolling_disc": "beta",
    "snakeboard": "phi", "gyroscopic": "x", "comet": "y",
}  # fmt: skip


def guards(problem: Problem) -> dict[str, sp.Expr]:
    """Return the events in the symbols of the problem; names of columns to expressions."""
    known = {x.name: x for x in (*problem.q, *problem.v)}
    one, other = problem.q[0], problem.v[1]
    name = ZERO[problem.name]
    return {
        name: known[name],
        "sin(50 t)": sp.sin(50 * t),
        f"sin(20 {one}) + cos(30 {other}) / 2": sp.sin(20 * one) + sp.cos(30 * other) / 2,
    }


@dataclass
class Timed:
    """A call, the least of its seconds, and the times of events that it found."""

    call: Callable[[], Any]
    seconds: float = np.inf
    found: Any = field(default_factory=list)

    def again(self) -> None:
        begun = time.perf_counter()
        found = self.call()
        self.seconds = min(self.seconds, time.perf_counter() - begun)
        self.found = np.array([at for at in found if at > AT_START])


def ours(problem: Problem, system: Any, guard: sp.Expr | None) -> Timed:
    """Return a run of the library, which stores its first and last states."""
    start, n = np.array(problem.start), system.n
    q0, v0 = start[:n], start[n:]
    q = dal.coordinates([x.name for x in problem.q])
    rule = dict(zip((*problem.q, *problem.v, t), (*q, *(x.d for x in q), dal.time)))
    events = [] if guard is None else [guard.xreplace(rule)]

    def call() -> Any:
        run = dal.integrate(system, "taylor", q0, v0, t_end=T_STATE, stride=10**9, events=events)
        return run.t_events[0] if events else []

    return Timed(call)


def alone(problem: Problem, system: Any) -> Timed:
    """Return the steps of the library alone, of a stepper that is started again."""
    start, n = np.array(problem.start), system.n
    stepper = dal.Stepper(system, "taylor", start[:n], start[n:], h=T_STATE)

    def call() -> list[float]:
        stepper.reset(start[:n], start[n:], 0.0)
        stepper.step()
        return []

    return Timed(call)


def theirs(problem: Problem, ode: Ode, guard: sp.Expr | None) -> Timed:
    """Return a run of heyoka on an ODE."""
    hy = heyoka()
    known = {x: hy.make_vars(x.name) for x in ode.symbols} | {t: hy.time}
    system = [(known[x], expression(hy, f, known)) for x, f in zip(ode.symbols, ode.rates)]
    found: list[float] = []
    options = {}
    if guard is not None:
        if ode.name:  # its velocities are others
            q, w = ode.symbols[: ode.n], ode.symbols[ode.n :]
            rule = dict(zip(problem.v, problem.basis * sp.Matrix(w)))
            guard = guard.xreplace(rule)
            assert guard.free_symbols <= {*q, *w, t}
        event = hy.nt_event(expression(hy, guard, known), lambda flow, at, sign: found.append(at))
        options["nt_events"] = [event]
    start = ode.into(np.array(problem.start))
    flow = hy.taylor_adaptive(system, start.copy(), compact_mode=False, **options)

    # The integrator has a copy of the callback, which shares the list
    def call() -> list[float]:
        found.clear()
        flow.time = 0.0
        flow.state[:] = start
        flow.propagate_until(T_STATE)
        return found.copy()

    return Timed(call)


def compared(problem: Problem, rounds: int) -> None:
    """Print the rows of a problem."""
    system = system_of(problem)
    makers = [("ours", lambda guard: ours(problem, system, guard))] + [
        (f"heyoka{ode.name}", lambda guard, ode=ode: theirs(problem, ode, guard))
        for ode in problem.odes
    ]
    plain = {name: make(None) for name, make in makers} | {"steps": alone(problem, system)}
    for title, guard in guards(problem).items():
        with_event = {name: make(guard) for name, make in makers}
        every = [*plain.values(), *with_event.values()]
        for _ in range(rounds + 1):  # the first one compiles
            for one in every:
                one.again()
        steps = plain["steps"].seconds
        print(f"{problem.name}, {title}; our steps alone {1e6 * steps:.1f}")
        us = with_event["ours"]
        for name, one in with_event.items():
            bare = plain[name].seconds
            row = (f"  {name:12s} {1e6 * one.seconds:9.1f} {1e6 * bare:9.1f}"
                   f" {len(one.found):6d}")  # fmt: skip
            if name != "ours":
                more = us.seconds - plain["ours"].seconds, one.seconds - bare
                added = f"{more[0] / more[1]:.2f}" if more[1] > 1e-6 else "-"
                row += (f"{'*' if len(us.found) != len(one.found) else ' '} ours/heyoka:"
                        f" {us.seconds / one.seconds:.2f} with,"
                        f" {plain['ours'].seconds / bare:.2f} without,"
                        f" {added} of the difference")  # fmt: skip
                row += apart(us.found, one.found)
            print(row, flush=True)


def apart(one: Any, other: Any) -> str:
    """Return how much the times differ, where there are as many."""
    if len(one) != len(other) or not len(one):
        return ""
    return f"; times agree to {np.max(np.abs(np.sort(one) - np.sort(other))):.0e}"


def main() -> None:
    parser = argparse.ArgumentParser(description="Runs with events, of the library and heyoka.")
    parser.add_argument("problems", nargs="*", help=f"of {', '.join(PROBLEMS)}; default: all")
    parser.add_argument("--rounds", type=int, default=15, help="calls of each, whose least counts")
    given = parser.parse_args()
    warnings.simplefilter("ignore", dal.DalembertWarning)
    print("microseconds with the event, without it, and the number of events")
    for name in given.problems or PROBLEMS:
        compared(PROBLEMS[name](), given.rounds)


if __name__ == "__main__":
    main()
