"""The nonholonomic schemes of odelab, written anew from their papers and compiled by numba.

- `McLachlan-Perlmutter`: (4.18) of R. McLachlan, M. Perlmutter, Integrators for nonholonomic
  mechanical systems, J. Nonlinear Sci. 16 (2006) 283-328; for L = |v|^2/2 - V(q).
- `SPARK s`: L. Jay, Solution of index 2 implicit differential-algebraic equations by Lobatto
  Runge-Kutta methods, BIT 43 (2003) 93-106: Lobatto IIIA for q, IIIB for v, s stages, order
  2s - 2.  Of the constraint vanish the means over the stages, sum_j a_ij phi(Q_j, V_j) for
  i = 2 ... s, and phi at the end of the step.
- `energy`: q' - q = h w, M (v' - v) = -h (mean of V_q from q to q') + h mu^T lambda, mu w = 0,
  with w = (v + v')/2 and mu at (q + q')/2: E. Celledoni, M. Farre Puiggali, E. H. Hoiseth,
  D. Martin de Diego, Energy-preserving integrators applied to nonholonomic systems, J. Nonlinear
  Sci. 29 (2019) 1523-1562.  The states are not in D.
- `reflecting leapfrog`: S. Ferraro, D. Iglesias, D. Martin de Diego, Momentum and energy preserving
  integrators for nonholonomic dynamics, Nonlinearity 21 (2008) 1911-1928: explicit;
  w' = (P - Q) w - h P M^-1 V_q, q' = q + h w', P and Q the projections onto D_q and its complement.

Equations are solved by Newton's method for the multipliers, whose matrix knows mu and (mu v)_q, and
by iteration for the rest; they end when nothing changes but roundoff.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import sympy as sp
from common import T_STATE, Method, Refused, need, python_function, stopwatch
from problems import Problem

ITERATIONS = 60
SMALL = 2e-14  # of 1 + |q|: sines of large angles have the roundoff of the angles


def lobatto(stages: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return c, b and the matrices A of IIIA and IIIB."""
    x = sp.Symbol("x")
    nodes = [sp.Integer(-1), *sorted(sp.roots(sp.Poly(sp.legendre(stages - 1, x).diff(x), x))), 1]
    c = [(node + 1) / 2 for node in nodes]
    A = np.empty((stages, stages))
    b = np.empty(stages)
    for j in range(stages):
        lagrange = sp.prod((x - c[k]) / (c[j] - c[k]) for k in range(stages) if k != j)
        integral = sp.integrate(sp.expand(lagrange), x)
        b[j] = integral.subs(x, 1)
        A[:, j] = [integral.subs(x, node) for node in c]
    # b_i B_ij + b_j A_ji = b_i b_j
    return np.array(c, dtype=float), b, A, b[None, :] - (A * b[:, None]).T / b[:, None]


def methods(problem: Problem) -> Iterator[Method | Refused]:
    numba = need("numba")
    e, n, m = problem.equations, len(problem.q), len(problem.constraints)
    start = np.array(problem.start)
    one_step = np.empty((1, 2 * n))
    with stopwatch() as model_seconds:
        functions = _model(problem)

    def made(compiled: Any, *options: Any):  # type: ignore[no-untyped-def]
        """Compile, and return ``solve`` and the seconds."""

        def solve(steps: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
            h = T_STATE / steps
            stride = round((times[1] - times[0]) / h)
            states = np.empty((len(times) - 1, 2 * n))
            if not compiled(times[0], state, h, stride, states, *options):
                raise RuntimeError("the iteration of a step does not converge")
            return states

        with stopwatch() as seconds:
            compiled(0.0, start, 1e-3, 1, one_step, *options)
        return solve, seconds[0] + model_seconds[0]

    low = (400, 1000, 4000, 10000, 40000, 100000)
    mechanical = e.constant_mass and not e.velocity_force
    reason = ("it is stated for a constant mass" if not e.constant_mass
              else "it is stated for forces of the position")  # fmt: skip
    schemes = {
        "McLachlan-Perlmutter": _mclachlan_perlmutter,
        "odelab energy": _energy,
        "reflecting leapfrog": _reflecting,
    }
    for name, make in schemes.items():
        if not mechanical:
            yield Refused(name, reason)
            continue
        solve, seconds = made(make(numba, n, m, *functions))
        yield Method(name, "steps", low, solve, seconds, 2, long=name == "odelab energy")
    spark = _spark(numba, n, m, *functions)
    for stages, settings in ((2, low), (3, (100, 200, 400, 1000, 4000, 10000)),
                             (4, (100, 200, 400, 1000, 2000))):  # fmt: skip
        c, b, A, B = lobatto(stages)
        A, B = np.vstack([A, b]), np.vstack([B, b])
        rows = np.zeros((stages, stages + 1))  # of the constraints that vanish
        rows[:-1, :-1], rows[-1, -1] = A[1:stages], 1.0
        solve, seconds = made(spark, c, A, B, A @ B[:stages], rows)
        yield Method(f"SPARK {stages}", "steps", settings, solve, seconds, 2 * stages - 2,
                     long=stages == 4)  # fmt: skip


def _model(problem: Problem) -> tuple[Any, Any]:
    """Return what moves, (M^-1 F, M^-1 mu^T), and what constrains, (mu, (mu v)_q)."""
    e, arguments = problem.equations, {"q": problem.q, "v": problem.v}
    n, m = len(problem.q), e.mu.rows
    made = []
    for name, first, second in (("push", e.free, e.pull), ("hold", e.mu, e.D)):
        flat = {"a": sp.Matrix(list(first)), "b": sp.Matrix(list(second))}
        function = python_function(name, arguments, flat)
        function(0.0, np.ones(n), np.ones(n), np.empty(len(first)), np.empty(n * m))
        made.append(function)
    return made[0], made[1]


def _solver(numba: Any):  # type: ignore[no-untyped-def]
    @numba.njit
    def eliminate(A: np.ndarray, b: np.ndarray) -> bool:
        """Solve A x = b in place, with pivots."""
        size = b.size
        for k in range(size):
            pivot = k
            for i in range(k + 1, size):
                if abs(A[i, k]) > abs(A[pivot, k]):
                    pivot = i
            if not abs(A[pivot, k]) > 0.0:
                return False
            if pivot != k:
                for j in range(k, size):
                    A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
                b[k], b[pivot] = b[pivot], b[k]
            for i in range(k + 1, size):
                factor = A[i, k] / A[k, k]
                for j in range(k + 1, size):
                    A[i, j] -= factor * A[k, j]
                b[i] -= factor * b[k]
        for k in range(size - 1, -1, -1):
            for j in range(k + 1, size):
                b[k] -= A[k, j] * b[j]
            b[k] /= A[k, k]
        return True

    return eliminate


def _mclachlan_perlmutter(numba: Any, n: int, m: int, push: Any, hold: Any) -> Any:
    eliminate = _solver(numba)

    @numba.njit
    def run(t0, state, h, stride, states):  # type: ignore[no-untyped-def]
        q, v = state[:n].copy(), state[n:].copy()
        half, new = np.empty(n), np.empty(n)
        free, pull = np.empty(n), np.empty(n * m)
        mu, D = np.empty(n * m), np.empty(n * m)
        A, phi, reaction = np.empty((m, m)), np.empty(m), np.zeros(m)
        for row in range(states.shape[0]):
            for step in range(stride):
                for i in range(n):
                    half[i] = q[i] + h / 2 * v[i]
                push(t0 + h * (row * stride + step + 0.5), half, v, free, pull)
                last, small = 1e300, SMALL * (1 + np.max(np.abs(q)))
                for iteration in range(ITERATIONS):
                    for i in range(n):
                        new[i] = v[i] + h * free[i]
                        for a in range(m):
                            new[i] += h * pull[i * m + a] * reaction[a]
                        q[i] = half[i] + h / 2 * new[i]
                    hold(0.0, q, new, mu, D)
                    largest = 0.0
                    for a in range(m):
                        phi[a] = 0.0
                        for i in range(n):
                            phi[a] -= mu[a * n + i] * new[i]
                        largest = max(largest, abs(phi[a]))
                        for b in range(m):
                            A[a, b] = 0.0
                            for i in range(n):
                                A[a, b] += h * (mu[a * n + i] + h / 2 * D[a * n + i]) * (
                                    pull[i * m + b])  # fmt: skip
                    # At the level of roundoff, where it no longer falls
                    if largest <= 1e-16 or (largest < small and largest >= last):
                        break
                    last = largest
                    if not eliminate(A, phi):
                        return False
                    for a in range(m):
                        reaction[a] += phi[a]
                else:
                    return False
                for i in range(n):
                    v[i] = new[i]
            states[row, :n], states[row, n:] = q, v
        return True

    return run


def _energy(numba: Any, n: int, m: int, push: Any, hold: Any) -> Any:
    eliminate = _solver(numba)
    points, weights = np.polynomial.legendre.leggauss(3)  # exact for polynomials V of degree 6
    points, weights = (points + 1) / 2, weights / 2

    @numba.njit
    def run(t0, state, h, stride, states):  # type: ignore[no-untyped-def]
        q, v = state[:n].copy(), state[n:].copy()
        mean, middle, between = np.empty(n), np.empty(n), np.empty(n)
        force, total, pull = np.empty(n), np.empty(n), np.empty(n * m)
        mu, D = np.empty(n * m), np.empty(n * m)
        A, phi, reaction = np.empty((m, m)), np.empty(m), np.zeros(m)
        for row in range(states.shape[0]):
            for step in range(stride):
                for i in range(n):
                    mean[i] = v[i]
                last, small = 1e300, SMALL * (1 + np.max(np.abs(q)))
                for iteration in range(ITERATIONS):
                    total[:] = 0.0
                    for k in range(3):
                        for i in range(n):
                            between[i] = q[i] + points[k] * h * mean[i]
                        push(0.0, between, v, force, pull)
                        for i in range(n):
                            total[i] += weights[k] * force[i]
                    for i in range(n):
                        middle[i] = q[i] + h / 2 * mean[i]
                    push(0.0, middle, v, force, pull)
                    change = 0.0
                    for i in range(n):
                        new = v[i] + h / 2 * total[i]
                        for a in range(m):
                            new += h / 2 * pull[i * m + a] * reaction[a]
                        change = max(change, abs(new - mean[i]))
                        mean[i] = new
                        middle[i] = q[i] + h / 2 * mean[i]
                    hold(0.0, middle, mean, mu, D)
                    for a in range(m):
                        phi[a] = 0.0
                        for i in range(n):
                            phi[a] -= mu[a * n + i] * mean[i]
                        change = max(change, abs(phi[a]))
                        for b in range(m):
                            A[a, b] = 0.0
                            for i in range(n):
                                A[a, b] += h / 2 * (mu[a * n + i] + h / 2 * D[a * n + i]) * (
                                    pull[i * m + b])  # fmt: skip
                    if change <= 1e-16 or (change < small and change >= last):
                        break
                    last = change
                    if not eliminate(A, phi):
                        return False
                    for a in range(m):
                        reaction[a] += phi[a]
                else:
                    return False
                for i in range(n):
                    q[i] += h * mean[i]
                    v[i] = 2 * mean[i] - v[i]
            states[row, :n], states[row, n:] = q, v
        return True

    return run


def _reflecting(numba: Any, n: int, m: int, push: Any, hold: Any) -> Any:
    eliminate = _solver(numba)

    @numba.njit
    def split(q, w, free, pull, mu, D, A, phi):  # type: ignore[no-untyped-def]
        """phi = C^-1 mu w: the part of w that is not in D is M^-1 mu^T phi."""
        for a in range(m):
            phi[a] = 0.0
            for i in range(n):
                phi[a] += mu[a * n + i] * w[i]
            for b in range(m):
                A[a, b] = 0.0
                for i in range(n):
                    A[a, b] += mu[a * n + i] * pull[i * m + b]
        return eliminate(A, phi)

    @numba.njit
    def run(t0, state, h, stride, states):  # type: ignore[no-untyped-def]
        q, w = state[:n].copy(), state[n:].copy()
        free, pull = np.empty(n), np.empty(n * m)
        mu, D, onto = np.empty(n * m), np.empty(n * m), np.empty(n)
        A, phi = np.empty((m, m)), np.empty(m)
        # The first half step, with the acceleration of the motion
        push(0.0, q, w, free, pull)
        hold(0.0, q, w, mu, D)
        for a in range(m):
            phi[a] = 0.0
            for i in range(n):
                phi[a] += mu[a * n + i] * free[i] + D[a * n + i] * w[i]
            for b in range(m):
                A[a, b] = 0.0
                for i in range(n):
                    A[a, b] += mu[a * n + i] * pull[i * m + b]
        if not eliminate(A, phi):
            return False
        for i in range(n):
            w[i] += h / 2 * free[i]
            for a in range(m):
                w[i] -= h / 2 * pull[i * m + a] * phi[a]
        for row in range(states.shape[0]):
            for step in range(stride):
                for i in range(n):
                    q[i] += h * w[i]
                push(0.0, q, w, free, pull)
                hold(0.0, q, w, mu, D)
                # At the node: v = P (w + h/2 free), and then w' = 2 v - w + h/2 (free - free)
                for i in range(n):
                    onto[i] = w[i] + h / 2 * free[i]
                if not split(q, onto, free, pull, mu, D, A, phi):
                    return False
                for i in range(n):
                    for a in range(m):
                        onto[i] -= pull[i * m + a] * phi[a]
                if step == stride - 1:
                    states[row, :n], states[row, n:] = q, onto
                for i in range(n):
                    w[i] = 2 * onto[i] - w[i]
            if not abs(w[0]) < 1e6:
                return False
        return True

    return run


def _spark(numba: Any, n: int, m: int, push: Any, hold: Any) -> Any:
    eliminate = _solver(numba)

    @numba.njit
    def run(t0, state, h, stride, states, c, A, B, shifts, rows):  # type: ignore
        # A and B have the weights b as their last row: the end of the step
        s = c.size
        q, v = state[:n].copy(), state[n:].copy()
        Q, V, rate = np.empty((s + 1, n)), np.empty((s + 1, n)), np.empty((s, n))
        free, pull = np.empty(n), np.empty((s, n * m))
        mu, D = np.empty((s + 1, n * m)), np.empty((s + 1, n * m))
        reaction = np.zeros((s, m))
        # dV_j / dlambda_k = h B[j, k] pull_k, dQ_j / dlambda_k = h^2 shifts[j, k] pull_k
        J, phi, one = np.empty((s * m, s * m)), np.empty(s * m), np.empty((s + 1) * m)
        for row in range(states.shape[0]):
            for step in range(stride):
                time = t0 + h * (row * stride + step)
                for j in range(s + 1):
                    V[j] = v
                last, small = 1e300, SMALL * (1 + np.max(np.abs(q)))
                for iteration in range(ITERATIONS):
                    change = 0.0
                    for j in range(s):
                        for i in range(n):
                            Q[j, i] = q[i]
                            for k in range(s):
                                Q[j, i] += h * A[j, k] * V[k, i]
                        push(time + c[j] * h, Q[j], V[j], free, pull[j])
                        for i in range(n):
                            rate[j, i] = free[i]
                            for a in range(m):
                                rate[j, i] += pull[j, i * m + a] * reaction[j, a]
                    for j in range(s + 1):
                        for i in range(n):
                            new = v[i]
                            for k in range(s):
                                new += h * B[j, k] * rate[k, i]
                            change = max(change, abs(new - V[j, i]))
                            V[j, i] = new
                    for i in range(n):
                        Q[s, i] = q[i]
                        for k in range(s):
                            Q[s, i] += h * A[s, k] * V[k, i]
                    for j in range(s + 1):
                        hold(time, Q[j], V[j], mu[j], D[j])
                        for a in range(m):
                            one[j * m + a] = 0.0
                            for i in range(n):
                                one[j * m + a] += mu[j, a * n + i] * V[j, i]
                    for r in range(s):
                        for a in range(m):
                            phi[r * m + a] = 0.0
                            for j in range(s + 1):
                                phi[r * m + a] -= rows[r, j] * one[j * m + a]
                            change = max(change, abs(phi[r * m + a]))
                    if change <= 1e-16 or (change < small and change >= last):
                        break
                    last = change
                    for r in range(s):
                        for a in range(m):
                            for k in range(s):
                                for d in range(m):
                                    entry = 0.0
                                    for j in range(s + 1):
                                        if rows[r, j] != 0.0:
                                            part = 0.0
                                            for i in range(n):
                                                at = a * n + i
                                                part += h * pull[k, i * m + d] * (
                                                    B[j, k] * mu[j, at]
                                                    + h * shifts[j, k] * D[j, at])  # fmt: skip
                                            entry += rows[r, j] * part
                                    J[r * m + a, k * m + d] = entry
                    if not eliminate(J, phi):
                        return False
                    for k in range(s):
                        for d in range(m):
                            reaction[k, d] += phi[k * m + d]
                else:
                    return False
                for i in range(n):
                    q[i], v[i] = Q[s, i], V[s, i]
            states[row, :n], states[row, n:] = q, v
        return True

    return run
