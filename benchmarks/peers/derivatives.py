"""Derivatives of motions to t = 100 by their start: the library's times, and those of heyoka.

Both integrate the variational equations by Taylor series, at their finest tolerance.  The library
has a column for each of the 2n - m numbers (q, w); so has heyoka for the ODE in a basis of D, and
one for each of the 2n numbers (q, v) for the other one.  heyoka writes out all operations, which it
takes long to compile, or loops with --compact.  Compiling is not counted.  All calls of a
problem alternate in one process, and the least times count.

Run it where heyoka and the package are installed:

    PYTHONPATH=build-dev/python python benchmarks/peers/derivatives.py [--order 2] [springs ...]
"""

from __future__ import annotations

import os

# One thread: the calls are compared.
for _name in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_name}_NUM_THREADS", "1")

import argparse  # noqa: E402
import time  # noqa: E402
from collections.abc import Callable  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402
from common import T_STATE, heyoka  # noqa: E402
from peer_dalembert import system as system_of  # noqa: E402
from peer_heyoka import expression  # noqa: E402
from problems import PROBLEMS, Ode, Problem, t  # noqa: E402

import dalembert as dal  # noqa: E402
from dalembert.core import ffi, lib, make  # noqa: E402
from dalembert.system.twins import twin  # noqa: E402

Call = Callable[[], Any]


def prepared(system: dal.System, order: int, columns: int) -> Any:
    """Return a ``dal_taylor_variations``."""
    compiled = twin(system, "variations" if order == 1 else "second variations")
    record, kept = dal.Scheme.find("taylor")._record_of(system)
    return make("taylor_variations", compiled._handle, record, order, columns,
                owner=(compiled, kept))  # fmt: skip


def ours(problem: Problem, order: int) -> Call:
    """Return the call of C."""
    system, n = system_of(problem), len(problem.q)
    start = np.array(problem.start, dtype=float)
    q0, v0 = start[:n], start[n:]
    first = dal.variations(system, q0, v0, t_end=0.0, order=order)
    dx = np.ascontiguousarray(first.dx.T)
    made = prepared(system, order, len(dx))

    def call() -> None:
        lib.dal_taylor_variations_start(
            made, 0.0, ffi.from_buffer("double[]", start), ffi.from_buffer("double[]", dx),
            ffi.NULL,
        )  # fmt: skip
        lib.dal_taylor_variations_go(made, T_STATE, ffi.NULL, ffi.NULL)

    return call


def theirs(
    ode: Ode, problem: Problem, order: int, compact: bool
) -> tuple[Call, float]:
    """Return heyoka's call on an ODE, and the seconds that compiling took."""
    hy = heyoka()
    known = {x: hy.make_vars(x.name) for x in ode.symbols} | {t: hy.time}
    system = [(known[x], expression(hy, f, known)) for x, f in zip(ode.symbols, ode.rates)]
    start = np.array(ode.into(np.array(problem.start)), dtype=float)
    begun = time.perf_counter()
    varied = hy.var_ode_sys(system, hy.var_args.vars, order=order)
    flow = hy.taylor_adaptive(varied, start.copy(), compact_mode=compact)
    seconds = time.perf_counter() - begun
    whole = flow.state.copy()

    def call() -> None:
        flow.time = 0.0
        flow.state[:] = whole
        flow.propagate_until(T_STATE)

    return call, seconds


def compared(problem: Problem, order: int, compact: bool, rounds: int) -> None:
    """Print the rows of a problem."""
    call = ours(problem, order)
    found = [theirs(ode, problem, order, compact) for ode in problem.odes]
    calls = [call, *(one for one, _ in found)]
    least = [np.inf] * len(calls)
    for _ in range(rounds + 1):
        for k, one in enumerate(calls):
            begun = time.perf_counter()
            one()
            least[k] = min(least[k], time.perf_counter() - begun)
    print(f"{problem.name:14s} ours {1e3 * least[0]:8.3f} ms", end="")
    for ode, seconds, (_, compiled) in zip(problem.odes, least[1:], found):
        print(f"; heyoka{ode.name} {1e3 * seconds:8.3f} ms, ours/heyoka {least[0] / seconds:.2f}"
              f" (compiled in {compiled:.1f} s)", end="")  # fmt: skip
    print(flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Variational equations of the library and heyoka.")
    parser.add_argument("problems", nargs="*", help=f"of {', '.join(PROBLEMS)}; default: all")
    parser.add_argument("--order", type=int, default=1, choices=(1, 2))
    parser.add_argument("--compact", action="store_true", help="heyoka's loops")
    parser.add_argument("--rounds", type=int, default=15, help="calls of each, whose least counts")
    given = parser.parse_args()
    for name in given.problems or PROBLEMS:
        compared(PROBLEMS[name](), given.order, given.compact, given.rounds)


if __name__ == "__main__":
    main()
