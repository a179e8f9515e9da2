"""SciPy: DOP853 (explicit, order 8) and Radau (implicit, order 5) on the reduced ODE."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from common import Method, Refused, field, field_jacobian, need, stopwatch
from problems import Problem


def methods(problem: Problem) -> Iterator[Method | Refused]:
    solve_ivp = need("scipy.integrate").solve_ivp
    start = np.array(problem.start)
    size = len(start)
    with stopwatch() as compiled:
        rates = field(problem)
        rates(0.0, start, np.empty(size))
    with stopwatch() as compiled_jacobian:
        derivatives = field_jacobian(problem)
        derivatives(0.0, start, np.empty((size, size)))

    def f(t: float, y: np.ndarray) -> np.ndarray:
        out = np.empty(size)
        rates(t, y, out)
        return out

    def jacobian(t: float, y: np.ndarray) -> np.ndarray:
        out = np.empty((size, size))
        derivatives(t, y, out)
        return out

    def solver(method: str, **options: object):
        def solve(tolerance: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
            run = solve_ivp(f, (times[0], times[-1]), state, method, times[1:],
                            rtol=tolerance, atol=tolerance, **options)  # fmt: skip
            if not run.success:
                raise RuntimeError(run.message)
            return run.y.T

        return solve

    yield Method("SciPy DOP853", "tolerance", (1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13),
                 solver("DOP853"), compiled[0], usual=1e-9)  # fmt: skip
    yield Method("SciPy Radau", "tolerance", (1e-3, 1e-5, 1e-7, 1e-9),
                 solver("Radau", jac=jacobian), compiled[0] + compiled_jacobian[0],
                 usual=1e-7)  # fmt: skip
