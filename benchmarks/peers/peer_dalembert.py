"""dalembert: its schemes, and a composition of order 10 that is a record of sub-steps."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from common import T_STATE, Method, Refused, need, stopwatch
from problems import Problem, t

# Symmetric composition of symmetric steps, order 10, 35 stages: M. Sofroniou, G. Spaletta,
# Derivation of symmetric composition constants for symmetric integrators, Optim. Methods Softw. 20
# (2005) 597-613.  The first half and the middle; the rest is its mirror image.
SS10 = (
    0.07879572252168641926390768, 0.31309610341510852776481247, 0.02791838323507806610952027,
    -0.22959284159390709415121340, 0.13096206107716486317465686, -0.26973340565451071434460973,
    0.07497334315589143566613711, 0.11199342399981020488957508, 0.36613344954622675119314812,
    -0.39910563013603589787862981, 0.10308739852747107731580277, 0.41143087395589023782070412,
    -0.00486636058313526176219566, -0.39203335370863990644808194, 0.05194250296244964703718290,
    0.05066509075992449633587434, 0.04967437063972987905456880, 0.04931773575959453791768001,
)  # fmt: skip

STEPS = {
    "leapfrog": (2, (400, 1000, 4000, 10000, 40000, 100000, 400000)),
    "midpoint": (2, (400, 1000, 4000, 10000, 40000, 100000)),
    "suzuki4": (4, (100, 200, 400, 1000, 2000, 4000, 10000, 20000)),
    "kl6": (6, (100, 160, 240, 400, 600, 1000, 2000, 4000)),
    "kl8": (8, (100, 160, 240, 400, 600, 1000)),
    "ss10": (10, (60, 100, 160, 240, 320, 400)),
}


def system(problem: Problem) -> Any:
    """Return the problem as a model of dalembert."""
    dal = need("dalembert")
    return dal.System.from_sympy(
        problem.L, problem.constraints, list(zip(problem.q, problem.v)),
        force={x: f.xreplace({t: dal.time}) for x, f in problem.force.items()} or None,
        name=problem.name, q0=problem.q0, v0=problem.v0,
    )  # fmt: skip


def methods(problem: Problem) -> Iterator[Method | Refused]:
    dal = need("dalembert")
    n = len(problem.q)
    with stopwatch() as compiled:
        model = system(problem)
        dal.integrate(model, "leapfrog", h=1e-3, steps=1)

    def run(scheme: Any, state: np.ndarray, h: float, steps: int, times: np.ndarray,
            **options: Any) -> np.ndarray:  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", dal.DalembertWarning)
            found = dal.integrate(model, scheme, state[:n], state[n:], h=h, t0=times[0],
                                  steps=steps * (len(times) - 1), stride=steps,
                                  **options)  # fmt: skip
        return np.hstack([found.q[1:], found.v[1:]])

    def fixed(scheme: Any):  # type: ignore[no-untyped-def]
        def solve(steps: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
            h = T_STATE / steps
            return run(scheme, state, h, round((times[1] - times[0]) / h), times)

        return solve

    def reference(tolerance: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
        return run("reference", state, times[1] - times[0], 1, times, tolerance=tolerance)

    simple = problem.equations.constant_mass and not problem.equations.velocity_force
    base = "leapfrog" if simple else "midpoint"  # leapfrog is then two stages
    for name, (order, settings) in STEPS.items():
        record: Any = name if order == 2 else f"{base}-{name}"
        if name == "ss10":
            pairs = [(0, 0.5), (1, 0.5)] if simple else [(0.5, 1.0)]
            fractions = (*SS10, *SS10[-2::-1])
            record = dal.Scheme([(beta, c * part) for c in fractions for beta, part in pairs],
                                name=name, order=10, symmetric=True)  # fmt: skip
        yield Method(name, "steps", settings, fixed(record), compiled[0], order)
    yield Method("reference", "tolerance",
                 (1e-4, 1e-6, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-14), reference,
                 compiled[0])  # fmt: skip
