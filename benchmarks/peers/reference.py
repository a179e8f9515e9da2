"""Computes references.json, the states at t = 100: `python reference.py [NAME]...`, some minutes.

Gragg's midpoint rule, extrapolated, in 34 digits (mpmath), from the expressions as they are; twice,
with other steps and orders.  What the two agree in is kept, and has to agree with heyoka, if it is
installed, which solves the equations by Taylor series in long double.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import mpmath
import numpy as np
import sympy as sp
from common import T_STATE, Missing, need
from peer_heyoka import expression
from problems import PROBLEMS, Problem, t

FILE = Path(__file__).with_name("references.json")


def extrapolated(f: Callable[..., list], y: list, steps: int, columns: int) -> list:
    """Advance y to T_STATE in so many large steps, each of order 2 * columns."""
    H = mpmath.mpf(T_STATE) / steps
    for step in range(steps):
        time, table = step * H, []
        first = f(time, y)
        for j in range(columns):
            count = 2 * (j + 1)
            h = H / count
            before, now = y, [a + h * b for a, b in zip(y, first)]
            for i in range(1, count):
                before, now = now, [
                    a + 2 * h * b for a, b in zip(before, f(time + i * h, now))
                ]
            ends = [(a + b + h * c) / 2 for a, b, c in zip(before, now, f(time + H, now))]
            row = [ends]
            for k, previous in enumerate(table):
                ratio = (mpmath.mpf(j + 1) / (j - k)) ** 2 - 1
                row.append([a + (a - b) / ratio for a, b in zip(row[k], previous)])
            table = row
        y = table[-1]
    return y


def accurate(problem: Problem) -> list:
    e = problem.equations
    field = sp.lambdify([t, [*problem.q, *problem.v]], [*problem.v, *e.acceleration], "mpmath",
                        cse=True)  # fmt: skip
    start = [mpmath.mpf(sp.Rational(x).p) / sp.Rational(x).q for x in (*problem.q0, *problem.v0)]
    first = extrapolated(field, start, 500 * problem.pace, 12)
    second = extrapolated(field, start, 400 * problem.pace, 13)
    apart = max(abs(a - b) for a, b in zip(first, second))
    print(f"{problem.name}: the two differ by {mpmath.nstr(apart, 2)}", flush=True)
    assert apart < 1e-19
    return second


def by_heyoka(problem: Problem) -> np.ndarray:
    hy = need("heyoka")
    long = np.longdouble
    known = {x: hy.make_vars(x.name) for x in (*problem.q, *problem.v)} | {t: hy.time}
    f = [expression(hy, x, known, 64)
         for x in (*problem.v, *problem.equations.acceleration)]  # fmt: skip
    field = [(known[x], value) for x, value in zip((*problem.q, *problem.v), f)]
    start = [long(sp.Rational(x).p) / long(sp.Rational(x).q) for x in (*problem.q0, *problem.v0)]
    flow = hy.taylor_adaptive(field, np.array(start), fp_type=long)
    flow.propagate_until(long(T_STATE))
    return flow.state


def main() -> None:
    mpmath.mp.dps = 34
    found = json.loads(FILE.read_text()) if sys.argv[1:] else {}
    for name, make in PROBLEMS.items():
        if sys.argv[1:] and name not in sys.argv[1:]:
            continue
        state = accurate(make())
        found[name] = [mpmath.nstr(x, 21) for x in state]
        try:
            other = by_heyoka(make())
        except Missing as missing:
            print(f"  not compared: {missing}")
            continue
        apart = max(abs(np.longdouble(a) - b) for a, b in zip(found[name], other))
        print(f"  heyoka in long double differs by {apart:.1e}", flush=True)
        assert apart < 1e-15 * make().pace  # close approaches multiply what is rounded
    FILE.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
