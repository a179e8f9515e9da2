"""heyoka: Taylor series of an order that the tolerance chooses, compiled by LLVM.

On the ODE for (q, v), and on that in a basis of D, which the motion cannot leave.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import sympy as sp
from common import Method, Refused, decimal, heyoka, stopwatch
from problems import Ode, Problem, t

TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13, 2.2e-16)  # the last is its default


def expression(hy: ModuleType, x: Any, known: dict[sp.Symbol, Any], bits: int = 53) -> Any:
    """Return x as an expression of heyoka; powers are products: it has no series of 0**3."""
    x = decimal(x, bits)
    powers = {p: sp.Dummy() for p in x.atoms(sp.Pow) if p.exp.is_Integer and p.exp > 2}
    products = {}
    for p, dummy in powers.items():
        base = expression(hy, p.base, known, bits)
        products[dummy] = base
        for _ in range(int(p.exp) - 1):
            products[dummy] = products[dummy] * base
    return hy.from_sympy(x.xreplace(powers), known | products)


def methods(problem: Problem) -> Iterator[Method | Refused]:
    hy = heyoka()
    for ode in problem.odes:
        yield _method(hy, ode)


def _method(hy: ModuleType, ode: Ode) -> Method:
    known = {x: hy.make_vars(x.name) for x in ode.symbols} | {t: hy.time}
    with stopwatch() as derived:
        field = [(known[x], expression(hy, f, known))
                 for x, f in zip(ode.symbols, ode.rates)]  # fmt: skip
    flows, bare = {}, []
    with stopwatch() as compiled:
        for tolerance in TOLERANCES:
            flows[tolerance] = hy.taylor_adaptive(
                field, [0.0] * len(field), tol=tolerance, compact_mode=False
            )

    def solve(tolerance: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
        flow = flows[tolerance]
        flow.time = times[0]
        flow.state[:] = ode.into(state)
        if len(times) == 2:
            begun = time.perf_counter()
            flow.propagate_until(times[1])
            bare.append(time.perf_counter() - begun)
            return ode.out_of(flow.state[None].copy())
        return ode.out_of(flow.propagate_grid(times)[-1][1:])

    return Method(f"heyoka{ode.name}", "tolerance", TOLERANCES, solve,
                  derived[0] + compiled[0] / len(TOLERANCES), bare=bare)  # fmt: skip
