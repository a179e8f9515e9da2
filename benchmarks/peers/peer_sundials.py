"""scikit-sundae: CVODE (Adams) on the reduced ODE, IDA on the constrained equations.

IDA gets (q, v, lambda) in the form of index 1, with the multiplier from the derivative of the
constraint, and the Jacobian.  The form of index 2, which has the constraint itself, needs
``IDASetSuppressAlg``, which scikit-sundae does not have: its steps fail.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import sympy as sp
from common import Method, Refused, field, field_jacobian, need, python_function, stopwatch
from problems import Problem, t

STEPS = 100_000_000


def methods(problem: Problem) -> Iterator[Method | Refused]:
    cvode, ida = need("sksundae.cvode"), need("sksundae.ida")
    start = np.array(problem.start)
    size = len(start)
    with stopwatch() as compiled:
        rates, derivatives = field(problem), field_jacobian(problem)
        rates(0.0, start, np.empty(size))
        derivatives(0.0, start, np.empty((size, size)))

    def f(t: float, y: np.ndarray, out: np.ndarray) -> None:
        rates(t, y, out)

    def jacobian(t: float, y: np.ndarray, rate: np.ndarray, out: np.ndarray) -> None:
        derivatives(t, y, out)

    def adams(tolerance: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
        flow = cvode.CVODE(f, method="Adams", rtol=tolerance, atol=tolerance,
                           jacfn=jacobian, max_num_steps=STEPS)  # fmt: skip
        flow.init_step(times[0], state)
        return np.array([flow.step(time).y for time in times[1:]])

    yield Method("CVODE Adams", "tolerance", (1e-4, 1e-6, 1e-8, 1e-10, 1e-12), adams,
                 compiled[0], usual=1e-10)  # fmt: skip

    with stopwatch() as compiled:
        residual, residual_jacobian, multipliers = _index_one(problem, start)
    m = len(problem.constraints)

    def dae(t: float, y: np.ndarray, rate: np.ndarray, out: np.ndarray) -> None:
        residual(t, y, rate, out)

    def dae_jacobian(t, y, rate, res, cj, out):  # type: ignore[no-untyped-def]
        residual_jacobian(t, y, rate, np.array([cj]), out)

    def index_one(tolerance: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
        flow = ida.IDA(dae, rtol=tolerance, atol=tolerance, jacfn=dae_jacobian,
                       algebraic_idx=list(range(size, size + m)), max_num_steps=STEPS)  # fmt: skip
        y, rate = np.zeros(size + m), np.zeros(size + m)
        y[:size] = state
        multipliers(times[0], state, y[size:])
        rates(times[0], state, rate[:size])
        flow.init_step(times[0], y, rate)
        return np.array([flow.step(time).y[:size] for time in times[1:]])

    yield Method("IDA index 1", "tolerance", (1e-4, 1e-6, 1e-8, 1e-10), index_one,
                 compiled[0], usual=1e-8)  # fmt: skip


def _index_one(problem: Problem, start: np.ndarray):  # type: ignore[no-untyped-def]
    """Return the residual, its Jacobian and the multipliers, as functions that fill arrays."""
    e, q, v = problem.equations, sp.Matrix(problem.q), sp.Matrix(problem.v)
    n, m = len(q), e.mu.rows
    reactions = sp.Matrix(sp.symbols(f"l0:{m}"))
    rate_q, rate_v = sp.Matrix(sp.symbols(f"a0:{n}")), sp.Matrix(sp.symbols(f"b0:{n}"))
    rate_l = sp.symbols(f"z0:{m}")
    y, rate = [*q, *v, *reactions], [*rate_q, *rate_v, *rate_l]
    unforced = e.mu * e.free + e.D * v + sp.Matrix(problem.constraints).diff(t)
    matrix = (e.mu * e.pull).applyfunc(sp.simplify)
    equations = sp.Matrix([
        *(rate_q - v), *(e.M * rate_v - e.F - e.mu.T * reactions), *(matrix * reactions + unforced)
    ])  # fmt: skip
    cj = sp.Symbol("cj")
    jacobian = equations.jacobian(y) + cj * equations.jacobian(rate)
    made = (
        python_function("residual", {"y": y, "rate": rate}, {"out": equations}),
        python_function("jacobian", {"y": y, "rate": rate, "c": [cj]}, {"out": jacobian}),
        python_function("reactions", {"y": [*q, *v]}, {"out": -matrix.inv() * unforced}),
    )
    zeros = np.zeros(2 * n + m)
    full = np.append(start, np.zeros(m))
    made[0](0.0, full, zeros, np.empty(2 * n + m))
    made[1](0.0, full, zeros, np.ones(1), np.empty((2 * n + m, 2 * n + m)))
    made[2](0.0, start, np.empty(m))
    return made
