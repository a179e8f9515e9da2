"""The equations of the schemes with 50 digits, and the flow in long double, for the campaign."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from campaign_systems import Case, Mechanism, mpf, scales, vector

U = 2.0**-53


# ---- the equations of a scheme ------------------------------------------------------------------


class Substep:
    """The beta-scheme over h from (t, q, v), all mpf: its solution connected with h = 0.

    R1 = L_v(q', w) - L_v(q, v) - h (1-beta) (L_q + f)(q', w) - h beta (L_q + f)(q, v)
         - phi_v(q_k, (v+w)/2)^T kappa,    R2 = phi(q', w),
    q_k = q + (1-beta) h v, q' = q_k + beta h w, f at t and t + h.
    """

    def __init__(self, mech: Mechanism, beta: float, h: Any, t: Any, q: Any, v: Any) -> None:
        self.mech, self.beta = mech, beta
        self.exact = (h, t, q, v)
        self.h, self.t = float(h), float(t)
        self.q, self.v = q.astype(float), v.astype(float)
        M, mu = mech.metric(self.q), mech.mu(self.q, self.v, self.t)
        self.row, self.column = scales(M, mu)
        self.speed = abs(self.v / self.column[: mech.n]).max()
        self.moderate = False
        self.y: Any = None

    def evaluate(self, y: Any, h: float) -> tuple[Any, Any]:
        """Return (R1, R2) and their Jacobian by y = (w, kappa), scaled; at a step h."""
        mech, n = self.mech, self.mech.n
        w, kappa = y[:n], y[n:]
        a, b = self.beta * h, (1 - self.beta) * h
        qk = self.q + b * self.v
        self.z0 = mech.z(self.q, self.v, self.t)
        self.zk = mech.z(qk, (self.v + w) / 2, self.t + b)
        self.z1 = mech.z(qk + a * w, w, self.t + h)
        p0, p1 = (self.momenta(z) for z in (self.z0, self.z1))
        at1, atk = mech.phi.at(self.z1), mech.phi.at(self.zk)
        self.J1, self.Gk = at1.jacobian(), atk.jacobian()[:, n:-1].T
        self.Hk = atk.hessian(kappa)[n:-1, :-1]
        R1 = p1[0] - p0[0] - b * p1[1] - a * p0[1] - self.Gk @ kappa
        self.H1, self.f1 = mech.L_hessian(self.z1), mech.force.at(self.z1).jacobian()
        self.by_q1 = self.H1[n:, :n] - b * (self.H1[:n, :n] + self.f1[:, :n])
        K = self.H1[n:, n:] - b * (self.H1[:n, n:] + self.f1[:, n:-1]) - self.Hk[:, n:] / 2
        J = np.zeros((len(y), len(y)))
        J[:n, :n], J[:n, n:] = K + a * self.by_q1, -self.Gk
        J[n:, :n] = self.J1[:, n:-1] + a * self.J1[:, :n]
        R = np.concatenate([R1, at1.value()])
        return self.row * R, self.row[:, None] * J * self.column

    def momenta(self, z: Any) -> tuple[Any, Any]:
        """Return L_v and L_q + f."""
        n = self.mech.n
        L_z = self.mech.lagrangian.at(z).jacobian()[0, :-1]
        return L_z[n:] + self.mech.M @ z[n:-1], L_z[:n] + self.mech.force.at(z).value()

    def newton(self, y: Any, h: float, ratio: float = 0.2) -> tuple[Any, float] | None:
        """Return the solution near y in units of column, and a sign, if Newton contracts there.

        ratio: the largest that the second change may be, in parts of the first.
        """
        last = math.inf
        for k in range(14):
            R, J = self.evaluate(self.column * y, h)
            if not (np.isfinite(R).all() and np.isfinite(J).all()):
                return None
            try:
                d = np.linalg.solve(J, -R)
            except np.linalg.LinAlgError:
                return None
            y = y + d
            size, scale = abs(d).max(), max(abs(y).max(), self.speed)
            if size <= 1e-13 * scale or (last <= 1e-7 * scale and size > 0.1 * last):
                return y, np.linalg.slogdet(J)[0]
            if size > (ratio if k == 1 else 0.5) * last:
                return None
            last = size
        return None

    def follow(self, most: float, ratio: float = 0.2) -> float:
        """Follow the solution from h = 0; return how far it came as a fraction of h.

        Each of its steps is at most `most`, the first of them with this ratio of `newton`.
        """
        y = np.concatenate([self.v, np.zeros(self.mech.m)]) / self.column
        at = self.newton(y, 0.0)
        if at is None:
            return 0.0
        (self.y, sign), done, size = at, 0.0, most
        before: tuple[Any, float] | None = None
        while done < 1.0:
            size = min(size, 1.0 - done)
            slope = 0.0 if before is None else (self.y - before[0]) / (done - before[1])
            guess = self.y + size * slope
            at = self.newton(guess, (done + size) * self.h, 0.2 if done else ratio)
            if at is not None and at[1] != sign and size < 1e-3:
                # a determinant may change its sign where the solution goes on as before
                near = 1e-3 * np.max(abs(size * slope)) + 1e-9 * abs(guess).max()
                sign = at[1] if abs(at[0] - guess).max() <= near else sign
            if at is None or at[1] != sign:
                size /= 2
                if size < 1e-7:
                    return done
                continue
            change = abs(at[0] - self.y).max()
            self.moderate = size == 1.0 and (change < 3 * self.speed or self.speed < 1e-9 * change)
            before = self.y, done
            self.y, done, size = at[0], done + size, min(2 * size, most)
        return 1.0

    def is_fold(self) -> bool:
        """Return whether the Jacobian is about singular where the solution was lost."""
        if self.y is None:
            return False
        J = self.evaluate(self.column * self.y, self.reached * self.h)[1]
        return not np.linalg.cond(J) < 1e3

    def solve(self, most: float, ratio: float) -> bool:
        """Solve to 50 digits; False if the solution ends before h, or the step is ill posed."""
        mech, n = self.mech, self.mech.n
        self.reached = self.follow(most, ratio)
        if self.reached < 1.0:
            return False
        _, self.J = self.evaluate(self.column * self.y, self.h)
        self.condition = np.linalg.cond(self.J, np.inf)
        if not self.condition < 1e13:
            return False
        inverse = np.linalg.inv(self.J)
        h, t, q, v = self.exact
        beta, M = mpf(self.beta), vector(mech.M)
        qk, tk = q + (1 - beta) * h * v, t + (1 - beta) * h
        one = [mpf(1)]

        def momenta(q: Any, v: Any, t: Any) -> tuple[Any, Any]:
            z = [*q, *v, t]
            g = mech.lagrangian.exactly(z)[1](one)
            f = mech.force.exactly(z)[0]
            return vector(g[n:-1]) + M.dot(v), vector(g[:n]) + vector(f)

        p0 = momenta(q, v, t)
        y, size = vector(self.column * self.y), abs(self.y).max() + 1e-300
        for _ in range(14):
            w, kappa = y[:n], y[n:]
            q1 = qk + beta * h * w
            p1 = momenta(q1, w, t + h)
            push = mech.phi.exactly([*qk, *((v + w) / 2), tk])[1](list(kappa))[n:-1]
            R1 = p1[0] - p0[0] - h * ((1 - beta) * p1[1] + beta * p0[1]) - vector(push)
            R = np.concatenate([R1, mech.phi.exactly([*q1, *w, t + h])[0]])
            d = -inverse @ (R * self.row)
            largest = max(abs(d), default=mpf(0))
            y = y + d * self.column
            if largest <= 1e-45 * size:
                break
        else:
            return False
        self.w, self.kappa = y[:n], y[n:]
        self.q1 = qk + beta * h * self.w
        return True

    def limit(self) -> tuple[Any, Any, Any]:
        """Return what rounding may do to (q', w) and kappa, in units of u, and their derivatives.

        The terms of R1 and R2 are rounded, each with its arguments (`At.sizes`), and |J^-1| times
        this changes the solution; a factorisation that is backward stable in the scaled matrix adds
        its condition times the solution.  Rounding of q' itself and of h adds to q'.
        """
        mech, n, h = self.mech, self.mech.n, self.h
        a, b = self.beta * h, (1 - self.beta) * h
        y = self.column * self.y
        w, kappa = y[:n], y[n:]
        R, J = self.evaluate(y, h)
        one, M = np.ones(1), abs(mech.M)
        L0, L1 = (mech.lagrangian.at(z).sizes(one)[1] for z in (self.z0, self.z1))
        f0, f1 = (mech.force.at(z).sizes()[0] for z in (self.z0, self.z1))
        R1 = M @ (abs(w) + abs(self.v)) + L1[n:-1] + L0[n:-1] + abs(b) * (L1[:n] + f1)
        R1 += abs(a) * (L0[:n] + f0) + mech.phi.at(self.zk).sizes(kappa)[1][n:-1]
        R2 = mech.phi.at(self.z1).sizes()[0]
        inverse = np.linalg.inv(J)
        of_terms = (abs(inverse) @ (self.row * np.concatenate([R1, R2]))).max()
        size = max(abs(self.y).max(), self.speed)
        local = self.column * (of_terms + self.condition * size)
        q1 = abs(self.q) + abs(h) * (abs(self.v) + abs(w)) + abs(a) * local[:n]
        H0, g0 = mech.L_hessian(self.z0), mech.force.at(self.z0).jacobian()
        by_q = self.by_q1 - H0[n:, :n] - a * (H0[:n, :n] + g0[:, :n]) - self.Hk[:, :n]
        by_v = b * self.by_q1 - H0[n:, n:] - a * (H0[:n, n:] + g0[:, n:-1]) - b * self.Hk[:, :n]
        by_v -= self.Hk[:, n:] / 2
        by = np.block([[by_q, by_v], [self.J1[:, :n], b * self.J1[:, :n]]])
        D = -self.column[:, None] * (inverse @ (self.row[:, None] * by))
        I = np.eye(n)
        state = np.block([[I + a * D[:n, :n], b * I + a * D[:n, n:]], [D[:n]]])
        return np.concatenate([q1, local[:n]]), local[n:], (state, D[n:])


@dataclass
class Step:
    """A step by the equations: the new state, the mean reaction, and their limits."""

    x: Any
    reaction: Any
    x_limit: Any
    reaction_limit: Any
    moderate: bool


def exact_step(case: Case, t: Any, x: Any, most: float = 1.0, ratio: float = 0.2) -> Step | str:
    """Return a step from a stored x, or why there is none; see `Substep.follow`."""
    mech, n = case.mechanism, case.mechanism.n
    h = mpf(case.h)
    q, v = vector(x[:n]), vector(x[n:])
    kept = case.scheme.nodes == "kept"
    shift = (1 - mpf(case.scheme.substeps[0][0])) * h if kept else mpf(0)
    q = q - shift * v
    parts, moderate, impulse = [], True, 0 * vector(np.zeros(mech.m))
    before = np.concatenate([abs(x[:n]) + abs(case.h * x[n:]), abs(x[n:])])
    for beta, fraction in case.scheme.substeps:
        step = Substep(mech, beta, h * mpf(fraction), t, q, v)
        if not step.solve(most, ratio):
            if 0.0 < step.reached < 1.0 and step.is_fold():
                return f"the solution ends at {step.reached:.4g} of a sub-step of {step.h:.3g}"
            return "ill posed"
        parts.append(step.limit())
        q, v, t = step.q1, step.w, t + h * mpf(fraction)
        impulse = impulse + step.kappa
        moderate = moderate and step.moderate and step.condition < 1e4
    # each local error is carried to the end by the derivative of what comes after it
    later, total, force = np.eye(2 * n), np.zeros(2 * n), np.zeros((mech.m, 2 * n))
    reaction = np.zeros(mech.m)
    for local, kappa, (by_x, kappa_by_x) in reversed(parts):
        total += abs(later) @ local
        reaction += kappa + abs(force) @ local
        force = force @ by_x + kappa_by_x
        later = later @ by_x
    total += abs(later) @ before
    reaction += abs(force) @ before
    if kept:
        q = q + shift * v
        total[:n] += abs(float(shift)) * total[n:]
    return Step(np.concatenate([q, v]), impulse / h, 100 * U * total,
                100 * U * reaction / abs(case.h), moderate)  # fmt: skip


# ---- the flow -----------------------------------------------------------------------------------


def extrapolated(mech: Mechanism, t: float, x: Any, t1: float, tolerance: float) -> Any:
    """Return the state at t1 by extrapolation of the midpoint rule, in long double."""
    n = mech.n
    counts = np.arange(2, 22, 2)
    t, t1, x = np.longdouble(t), np.longdouble(t1), x.astype(np.longdouble)

    def field(t: Any, x: Any) -> Any:
        return np.concatenate([x[n:], mech.acceleration(t, x[:n], x[n:])[0]])

    H, steps = t1 - t, 0
    scale = np.maximum(abs(x), abs(H * field(t, x)))
    scale += 1e-3 * np.repeat([scale[:n].max(), scale[n:].max()], n) + np.longdouble(1e-300)
    while t != t1:
        steps += 1
        if steps > 40:  # stiff: not for this method
            return None
        H = t1 - t if abs(H) >= abs(t1 - t) else H
        table: list[Any] = []
        f0, best = field(t, x), (math.inf, None)
        for j, count in enumerate(counts):
            d = H / count
            y0, y1 = x, x + d * f0
            for i in range(1, count):
                y0, y1 = y1, y0 + 2 * d * field(t + i * d, y1)
            row = [(y0 + y1 + d * field(t + H, y1)) / 2]
            for k in range(j):
                row.append(row[k] + (row[k] - table[k]) / ((count / counts[j - k - 1]) ** 2 - 1))
            if j:
                error = float(np.max(abs(row[-1] - row[-2]) / scale))
                best = min(best, (error, j, row[-1])) if math.isfinite(error) else best
            table = row
            if best[0] <= tolerance:
                break
        if best[0] <= 100 * tolerance:
            t, x = t + H, best[-1]
            H *= 1.5 if best[0] <= tolerance else 0.9
            continue
        H /= 2
        if abs(H) < 1e-9 * abs(t1 - t):
            return None
    return x


def flow(mech: Mechanism, t: float, x: Any, t1: float) -> tuple[Any, Any] | None:
    """Return the state at t1 and a bound of its error, from two tolerances; None if unknown."""
    found = [extrapolated(mech, t, x, t1, tolerance) for tolerance in (1e-18, 1e-15)]
    if found[0] is None or found[1] is None:
        return None
    return found[0], abs(found[0] - found[1]) + 1e-18 * abs(found[0])
