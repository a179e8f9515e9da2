"""dalembert: its schemes with steps of one size, and with steps that it chooses."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from common import T_STATE, Method, Refused, need, stopwatch
from problems import Problem, t

Solve = Callable[[float, np.ndarray, np.ndarray], np.ndarray]

FINE = (100, 140, 200, 240, 280, 320, 360, 400, 480, 560, 720, 1000)
LONG = ("leapfrog", "kl8", "ss10")  # and kl6 or bm6: their energy is followed over long times
STEPS = {  # the order, and the settings
    "leapfrog": (2, (400, 1000, 4000, 10000, 40000, 100000, 400000)),
    "midpoint": (2, (400, 1000, 4000, 10000, 40000, 100000)),
    "suzuki4": (4, (100, 200, 400, 1000, 2000, 4000, 10000, 20000)),
    "bm4": (4, (100, 200, 400, 1000, 2000, 4000, 10000, 20000)),
    "kl6": (6, (100, 160, 240, 400, 600, 1000, 2000, 4000)),
    "bm6": (6, (100, 160, 240, 400, 600, 1000, 2000, 4000)),
    "kl8": (8, (*FINE, 1400, 2000)),
    "ss10": (10, (60, 80, *FINE)),
}
TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)  # of "auto"
SERIES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-15)


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
    with stopwatch() as derived:
        model = system(problem)
    with stopwatch() as of_series:
        dal.integrate(model, "taylor", h=1e-3, steps=1)
    with stopwatch() as of_steps:
        dal.integrate(model, "leapfrog", h=1e-3, steps=1)
    compiled, compiled_series = derived[0] + of_steps[0], derived[0] + of_series[0]

    def run(scheme: Any, state: np.ndarray, times: np.ndarray, **options: Any) -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", dal.DalembertWarning)
            return dal.integrate(
                model, scheme, state[:n], state[n:], t0=times[0], check_h=False, **options
            )

    def fixed(scheme: Any, **options: Any) -> Solve:
        def solve(steps: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
            h = T_STATE / steps
            stride = round((times[1] - times[0]) / h)
            found = run(scheme, state, times, h=h, steps=stride * (len(times) - 1), stride=stride,
                        **options)  # fmt: skip
            return np.hstack([found.q[1:], found.v[1:]])

        return solve

    def controlled(scheme: str) -> Solve:
        """Return a solver whose steps have the sizes that the library chooses."""

        def solve(tolerance: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
            rows = {"stride": 10**9} if len(times) == 2 else {"t_eval": times[1:]}
            found = run(scheme, state, times, h="auto", t_end=times[-1], tolerance=tolerance,
                        **rows)  # fmt: skip
            return np.hstack([found.q, found.v])[1 - len(times) :]

        return solve

    def flow(scheme: str, **options: Any) -> Solve:
        def solve(tolerance: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
            found = run(scheme, state, times, h=times[1] - times[0], steps=len(times) - 1,
                        tolerance=tolerance, **options)  # fmt: skip
            return np.hstack([found.q[1:], found.v[1:]])

        return solve

    steppers: dict[tuple[float, float], Any] = {}
    bare: list[float] = []

    def prepared(tolerance: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Start a stepper again, which was made before."""
        key = tolerance, times[1] - times[0]
        if key not in steppers:
            scheme = dal.Scheme.taylor(tolerance)
            steppers[key] = dal.Stepper(model, scheme, state[:n], state[n:], h=key[1])
        stepper, rows = steppers[key], np.empty((len(times) - 1, 2 * n))
        stepper.reset(state[:n], state[n:], times[0])
        begun = time.perf_counter()
        for row in rows:
            stepper.step()
            row[:] = stepper.x
        bare.append(time.perf_counter() - begun)
        return rows

    simple = problem.equations.constant_mass and not problem.equations.velocity_force
    base = "leapfrog" if simple else "midpoint"  # leapfrog is then two stages
    long = (*LONG, "bm6" if simple else "kl6")  # pairs are dear where leapfrog is two stages
    for name, (order, settings) in STEPS.items():
        record = name if order == 2 or name in ("bm4", "bm6") else f"{base}-{name}"
        yield Method(name, "steps", settings, fixed(record), compiled, order,
                     long=name in long)  # fmt: skip
    for name in ("kl8", "ss10"):
        yield Method(f"{name} auto", "tolerance", TOLERANCES, controlled(f"{base}-{name}"),
                     compiled, long=name == "kl8")  # fmt: skip
    yield Method("bm6 auto", "tolerance", TOLERANCES, controlled("bm6"), compiled, long=False)
    if not problem.reversible:
        yield Method("kl8 keep", "steps", (60, 80, *STEPS["kl8"][1]),
                     fixed(f"{base}-kl8", energy="keep"), compiled, 8)  # fmt: skip
        yield Method("midpoint keep", "steps", (400, 600, 800, 1000, 1400, 2000, 4000),
                     fixed("midpoint", energy="keep"), compiled, 2, long=False)  # fmt: skip
    yield Method("reference", "tolerance",
                 (1e-4, 1e-6, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-14),
                 flow("reference", method="rk8pd"), compiled)  # fmt: skip
    yield Method("taylor", "tolerance", SERIES, prepared, compiled_series, bare=bare)
    yield Method("taylor once", "tolerance", SERIES, flow("taylor"), compiled_series, long=False)
