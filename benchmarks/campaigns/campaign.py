"""A random campaign: random systems, all schemes, judged by code that shares nothing with ours.

    ./dev shell python benchmarks/campaigns/campaign.py --seed 1 --minutes 10

``--only KIND`` and ``--repeat CASE`` run some of it.

It needs SciPy's neighbours only: NumPy, mpmath and SymPy, and is quicker with gmpy2.  It is not
part of the test suites.  Case k of seed S is made from (S, k) alone, so that `--seed S --repeat k`
makes it again and says more about it.

A system is a sum of terms c F(a.z + b) G(w.z), with z = (q, v, t) and F, G from a short list: then
all derivatives are a few lines, in double, in long double and with 55 digits.  What is looked for
is a silent error, that is success without a warning and

    bound      a stored state where |mu^a v| > 4 n u s^a, or more than stats.worst_residual tells;
    step       a step that is not the solution of the equations of the scheme that is connected with
               h = 0, by more than 100 u cond (see `Substep.limit`); nor that to which Newton's
               changes from v shrink and then halve, where that is another;
    reaction   the same for the multipliers, of the scheme and by the formula;
    order      one-step errors that fall with less than h^(p + 0.8);
    reference  a reference state farther from the solution than ten times the accuracy it claims;
    energy     a jump of the energy by more than half of the largest kinetic energy; no number.

A false alarm is an exception, or a warning about D, where the oracle finds nothing wrong.
"""

from __future__ import annotations

import argparse
import collections
import itertools
import math
import os
import re
import tempfile
import time
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from campaign_oracle import Step, U, exact_step, flow
from campaign_systems import Case, TooLong, make, mpf, scales, vector
from tqdm import tqdm

import dalembert as dal

# ---- what is judged -----------------------------------------------------------------------------


class Trial:
    """A case that the library has run, and what is wrong with it: (what, text), as told above."""

    def __init__(self, case: Case) -> None:
        self.case, self.mech = case, case.mechanism
        self.findings: list[tuple[str, str]] = []
        self.rng = np.random.default_rng(list(case.name.encode()))
        self.error: Exception | None = None
        if "sympy" in case.tags:
            L, given = self.mech.formulas()
            self.system = dal.System.from_sympy(L, **given)
        else:
            self.system = self.mech.library("no-hessians" not in case.tags)

    def integrate(self, **changed: Any) -> Any:
        """Run the case, or one like it; None if it failed with nothing done."""
        case = self.case
        given = {"h": case.h, "steps": case.steps, "t0": case.t0, **case.options, **changed}
        self.error = None
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            try:
                run = dal.integrate(self.system, case.scheme, case.q0, case.v0, **given)
            except TooLong:
                raise
            except Exception as error:  # whatever it is, the campaign goes on
                self.error, run = error, getattr(error, "partial", None)
        self.told = [str(w.message) for w in told if issubclass(w.category, dal.DalembertWarning)]
        return run

    def judge(self) -> list[tuple[str, str]]:
        """Run the case and look for all that can be wrong with it."""
        case = self.case
        self.mech.calls = 40_000
        self.run = self.integrate()
        if self.run is not None and not case.scheme.is_flow:
            about_D = [text for text in self.told if "residual of the constraint" in text]
            if self.check_bound() and about_D:
                self.found("alarm", about_D[0])
            if "step" in case.checks:
                self.check_steps()
            self.check_energy()
        if self.run is not None and "multipliers" in case.checks:
            self.check_multipliers()
        if self.error is not None:
            self.check_refusal()
            return self.findings
        if case.scheme.nodes == "moved" and "reference" in case.checks | {case.scheme.name}:
            self.check_reference()
        if case.scheme.nodes == "moved" and "order" in case.checks:
            self.check_order()
        return self.findings

    def found(self, what: str, text: str) -> None:
        """Take note, unless what is wrong was told by a warning or an exception."""
        if what == "alarm" or not (self.told or self.error):
            self.findings.append((what, text))

    def forms(self, q: Any, v: Any, t: float) -> tuple[Any, Any]:
        """Return mu and phi - mu v in double, as the library gets them."""
        if "sympy" in self.case.tags and self.mech.kind == "linear":
            columns = [self.system.residual(q, e, t=t) for e in np.eye(self.mech.n)]
            return np.array(columns).T, np.zeros(self.mech.m)
        mu = self.mech.mu(q, v if self.mech.kind == "nonlinear" else 0 * v, t)
        if self.mech.kind == "linear":
            return mu, np.zeros(self.mech.m)
        if self.mech.kind == "affine":
            return mu, self.mech.phi.at(self.mech.z(q, 0 * v, t)).value()
        rest = vector(self.mech.phi.at(self.mech.z(q, v, t)).value()) - vector(mu).dot(vector(v))
        return mu, rest

    def check_bound(self) -> bool:
        """Compare |mu v| with 4 n u s at every stored state."""
        mech, case, run = self.mech, self.case, self.run
        n, limit = mech.n, 4 * mech.n * U
        if mech.m == 0:
            return True
        shift = (1 - case.scheme.substeps[0][0]) * case.h if case.scheme.nodes == "kept" else 0.0
        worst, where, rounding = 0.0, 0, np.zeros(mech.m)
        for k, (t, q, v) in enumerate(zip(run.t, run.q, run.v, strict=True)):
            if k == 0 and shift:
                continue
            if not (np.isfinite(q).all() and np.isfinite(v).all()):
                self.found("energy", f"state {k} is not finite")
                return False
            reach = abs(q) + abs(shift * v)
            q = q - shift * v
            mu, rest = self.forms(q, v, t)
            M = mech.metric(q)
            d = 1 / np.sqrt(np.diag(M))  # first, so that the inverse is that of a scaled matrix
            d = d * np.sqrt(np.diag(np.linalg.inv(M * np.outer(d, d))))
            size = abs(mu) @ d
            top = abs(v).max() or 1.0  # its square may overflow
            speed = top * math.sqrt(v / top @ M @ (v / top))
            residual, extra = abs(mu @ v + rest.astype(float)), abs(rest.astype(float))
            if (residual > limit / 4 * (size * speed + extra)).any():
                residual = abs(vector(mu).dot(vector(v)) + rest)
            at = mech.phi.at(mech.z(q, v, t))
            if mech.kind != "linear":  # q and t are rounded, and phi by the user's function
                rounding = 4 * U * at.sizes()[0]
                extra = extra + abs(at.jacobian()[:, -1] * t)
            if mech.kind != "linear" or shift:
                extra = extra + abs(at.jacobian()[:, : mech.n]) @ reach
            for a in range(mech.m):
                s = size[a] * speed + extra[a]
                if residual[a] > limit * s + rounding[a]:
                    self.found("bound", f"state {k}, form {a}: {float(residual[a] / s) / limit:.3g}"
                               f" times the bound {limit:.2g}; told {run.stats.worst_residual:.2g}")
                    return False
                s = size[a] * (abs(v) / d).max() + extra[a]
                if k and s and float(residual[a] - rounding[a]) / s > worst:
                    worst, where = float(residual[a] - rounding[a]) / s, k
        if worst > run.stats.worst_residual * (1 + 1e-6) + n * U:
            self.found("bound", f"state {where}: residual {worst:.3g}, stats.worst_residual tells "
                       f"{run.stats.worst_residual:.3g}")  # fmt: skip
        return True

    def check_steps(self) -> None:
        """Solve the equations of one or two steps, and compare."""
        case, run, n = self.case, self.run, self.mech.n
        last = len(run.x) - 1
        few = 2 if len(case.scheme.substeps) <= 2 else 1
        for k in sorted({last, *self.rng.integers(1, last + 1, few - 1)} if last else ()):
            x, x1 = run.x[k - 1], run.x[k]
            if not (np.isfinite(x).all() and np.isfinite(x1).all()):
                return
            t = mpf(case.t0) + (k - 1) * mpf(case.h)
            step = exact_step(case, t, x)
            if is_off(step, x1):
                step = exact_step(case, t, x, 1 / 64)  # were we on the right branch?
            if isinstance(step, str) or is_off(step, x1):
                # of several solutions that to which Newton contracts will do
                near = exact_step(case, t, x, 1.0, 1.0)
                step = near if isinstance(near, Step) and not is_off(near, x1) else step
            if isinstance(step, str):
                if step != "ill posed":
                    self.found("step", f"step {k} is success, but {step}")
                continue
            off = distance(x1, step.x)
            if (off > step.x_limit).any():
                i = int(np.argmax(off / step.x_limit))
                scale = max(abs(step.x[(i // n) * n :][:n])) + 1e-300
                kind = "other root" if off[i] > 1e-4 * scale else "precision"
                self.found("step", f"step {k}, {kind}: component {i} is {x1[i]:.17g}, by the "
                           f"equations {float(step.x[i]):.17g}, limit {step.x_limit[i]:.2g}")
                return
            told, limit = run.reactions[k - 1], step.reaction_limit
            for a in np.flatnonzero(distance(told, step.reaction) > limit)[:1]:
                self.found("reaction", f"step {k}: reaction {a} is {told[a]:.17g}, by the "
                           f"equations {float(step.reaction[a]):.17g}, limit {limit[a]:.2g}")

    def check_energy(self) -> None:
        mech, case, run = self.mech, self.case, self.run
        if mech.kind != "linear" or mech.forced or mech.rheonomic or case.scheme.order < 2:
            return
        if self.error is not None:
            return
        energies = np.array([mech.energy(q, v) for q, v in zip(run.q, run.v, strict=True)])
        # a little more than half: which states count for the largest kinetic energy is open
        half = 0.55 * energies[:, 1].max() + 1e-10 * energies[:, 2].max()
        change = abs(energies[-1, 0] - energies[0, 0])
        if not change <= half:
            self.found("energy", f"{energies[0, 0]:.6g} -> {energies[-1, 0]:.6g} in {case.steps} "
                       f"steps, largest kinetic energy {energies[:, 1].max():.3g}")

    def check_multipliers(self) -> None:
        """Compare lambda(q, v) with a solve in long double, perturbed to know its condition."""
        mech, run = self.mech, self.run
        if mech.m == 0 or not np.isfinite(run.x).all():
            return
        k = int(self.rng.integers(len(run.x)))
        if abs(run.x[k]).max() > 1e12 * (1 + abs(run.x[0]).max()):  # where sines are noise
            return
        t = np.longdouble(self.case.t0) + k * np.longdouble(self.case.h)
        q, v = run.x[k].astype(np.longdouble).reshape(2, -1)
        values = []
        for i in range(5):
            by = 1 + (i > 0) * 1e-9 * self.rng.uniform(-1, 1, (3, mech.n))
            values.append(mech.acceleration(t * by[2, 0], q * by[0], v * by[1])[1])
        H = mech.L_hessian(mech.z(q, v, t))
        at, crossed = H[mech.n :, mech.n :], abs(H[mech.n :, : mech.n]) @ abs(v)
        mu = mech.mu(q, v, t)
        row, column = scales(at, mu)
        A = np.block([[at, -mu.T], [mu, np.zeros(2 * [mech.m])]]).astype(float)
        condition = np.linalg.cond(row[:, None] * A * column, np.inf)
        acceleration, exact = mech.acceleration(t, q, v)
        size = np.max(abs(np.concatenate([acceleration, exact]) / column))
        # terms of L_qv v may cancel others, and leave no more than their rounding
        size = max(size, np.max(row[: mech.n] * crossed.astype(float)))
        spread_of = np.max([abs(value - exact) for value in values], axis=0) / 1e-9
        limit = 100 * U * (condition * size * column[mech.n :] + spread_of) + 1e-300
        try:
            told = run.multipliers[k]
        except dal.DalembertError:  # a state of this run is so large that a function overflows
            return
        off = abs(told - exact)
        for a in np.flatnonzero(~(off <= limit))[: int(condition < 1e13)]:
            self.found("reaction", f"multiplier {a} at state {k} is {told[a]:.17g}, "
                       f"expected {float(exact[a]):.17g}, limit {float(limit[a]):.2g}")

    def check_reference(self) -> None:
        """Compare `reference` with extrapolation in long double."""
        case, run = self.case, self.run
        n, x0, t0 = self.mech.n, run.x[0], case.t0
        t1 = t0 + case.unit * float(self.rng.choice([0.3, 1.0, 2.0]))
        exact = flow(self.mech, t0, x0, t1) if self.mech.smooth and n <= 8 else None
        if exact is None:
            return
        try:
            told = dal.reference(self.system, x0[:n], x0[n:], t1, t0)
        except dal.DalembertError as error:
            return self.found("alarm", f"reference to t = {t1}: {error}")
        off = abs(np.concatenate([told.q, told.v]) - exact[0])
        allowed = 10 * max(told.accuracy, 4 * U * abs(exact[0]).max()) + 10 * exact[1].max()
        if not off.max() <= allowed:
            self.found("reference", f"from {t0} to {t1}: off by {float(off.max()):.3g}, claimed "
                       f"{told.accuracy:.3g}; state {float(abs(exact[0]).max()):.3g}, own error "
                       f"{float(exact[1].max()):.2g}")  # fmt: skip
        return None

    def check_order(self) -> None:
        """Measure the slope of one-step errors from exact data."""
        case, mech = self.case, self.mech
        p, n = case.scheme.order, mech.n
        if p == 0 or not mech.smooth or n > 8:
            return
        x0 = self.run.x[0]
        if not x0.any():
            return
        case.q0, case.v0 = x0[:n], x0[n:]
        d = 1 / np.sqrt(np.diag(mech.metric(case.q0)))
        errors: list[tuple[float, float]] = []
        rounding = 2000 * max(1.0, len(case.scheme.substeps) / 4)
        floor = U * max(rounding, 100 * condition(mech, case.q0, case.v0, case.t0))
        scale = 0.0
        for j in range(10):
            h = case.unit * (0.5 if p > 2 else 0.1) / 2**j
            run = self.integrate(h=h, steps=1, consistent="assume")
            exact = flow(mech, case.t0, x0, case.t0 + h) if run is not None else None
            if self.error is not None or exact is None:
                continue
            units = np.concatenate([d * case.unit, d])
            scale = scale or float(max(abs(x / units).max() for x in (x0, exact[0])))
            error = float(max(abs(run.x[1] - exact[0]) / units)) / scale
            if error < floor:
                break
            errors.append((h, error))
        self.error = None
        pairs = [(a, b) for a, b in itertools.pairwise(errors) if a[0] == 2 * b[0]]
        slopes = [math.log2(a[1] / b[1]) for a, b in pairs]
        settled = len(slopes) >= 3 and np.ptp(slopes[-3:]) < 0.05
        if settled and max(slopes[-2:]) < p + 0.8:
            self.found("order", f"slopes {[round(s, 2) for s in slopes]}, promised {p + 1}; errors "
                       f"{[f'{e:.2g}' for _, e in errors]}")  # fmt: skip

    def check_refusal(self) -> None:
        """Call it a false alarm if the equations have a moderate solution."""
        case, error = self.case, self.error
        text = f"{type(error).__name__}: {error}"
        if self.run is None:
            if "dependent" not in case.tags:
                self.found("alarm", f"at the start: {text}")
            return
        k = len(self.run.x) - 1
        if case.scheme.is_flow:
            t0 = case.t0 + k * case.h
            if self.mech.smooth and flow(self.mech, t0, self.run.x[k], t0 + case.h) is not None:
                self.found("alarm", text)
            return
        step = exact_step(case, mpf(case.t0) + k * mpf(case.h), self.run.x[k])
        if isinstance(step, Step) and step.moderate:
            self.found("alarm", f"step {k + 1} has a moderate solution: {text}")


# ---- the campaign -------------------------------------------------------------------------------


def is_off(step: Step | str, x: Any) -> bool:
    """Return whether a state is not that of the step; not where there is none."""
    return isinstance(step, Step) and bool((distance(x, step.x) > step.x_limit).any())


def condition(mech: Any, q: Any, v: Any, t: float) -> float:
    """Return that of mu M^-1 mu^T, scaled to a unit diagonal."""
    if mech.m == 0:
        return 1.0
    rows = np.linalg.solve(np.linalg.cholesky(mech.metric(q)), mech.mu(q, v, t).T)
    return float(np.linalg.cond(rows / np.linalg.norm(rows, axis=0))) ** 2


def distance(x: Any, y: Any) -> Any:
    return abs((vector(x) - y).astype(float))


def cases(seed: int, only: str | None) -> Iterator[tuple[int, Case]]:
    for index in itertools.count():
        case = make(seed, index)
        if only is None or only in case.tags:
            yield index, case


def repeat(seed: int, index: int) -> int:
    """Make one case, look for everything, and say what there is; return how much is wrong."""
    case = make(seed, index)
    case.checks |= {"step", "multipliers", "order", "reference"}
    print(case)
    trial = Trial(case)
    for what, text in trial.judge():
        print(f"{what.upper()}: {text}")
    print(f"warnings: {trial.told}, exception: {trial.error!r}")
    return len(trial.findings)


def campaign(seed: int, minutes: float, only: str | None) -> bool:
    """Make cases until the time is over or Ctrl-C; return whether one had a silent error."""
    made, silent, alarms = (collections.Counter[str]() for _ in range(3))
    index, end = -1, time.monotonic() + 60 * minutes
    bar = tqdm(unit=" cases", mininterval=1.0)
    try:
        for index, case in cases(seed, only):
            if time.monotonic() > end:
                break
            made.update(case.tags)
            try:
                findings = Trial(case).judge()
            except (TooLong, np.linalg.LinAlgError) as error:
                made[f"not judged ({type(error).__name__})"] += 1
                continue
            for what, text in findings:
                if what == "alarm":
                    alarms[re.sub(r"[0-9][0-9.e+-]*", "#", text)[:80]] += 1
                else:
                    silent[what] += 1
                tqdm.write(f"{what.upper()}: {text}\n{case}\n")
            bar.update()
            bar.set_postfix(silent=sum(silent.values()), alarms=sum(alarms.values()), case=index)
    except KeyboardInterrupt:
        pass
    bar.close()
    print("cases by kind:", ", ".join(f"{tag} {count}" for tag, count in sorted(made.items())))
    print(f"silent errors: {sum(silent.values())} {dict(silent)}")
    print(f"false alarms: {sum(alarms.values())} {dict(alarms)}")
    print(f"seed {seed}, {bar.n} cases, the last {index}")
    return sum(silent.values()) > 0


def main() -> int:
    parser = argparse.ArgumentParser(description="A random campaign.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--only", metavar="KIND", help="a tag: chain, units, midpoint-kl8, ...")
    parser.add_argument("--repeat", type=int, metavar="CASE", help="one case, with all checks")
    given = parser.parse_args()
    np.seterr(all="ignore")
    with tempfile.TemporaryDirectory() as cache:
        os.environ["DALEMBERT_CACHE"] = cache
        if given.repeat is not None:
            return repeat(given.seed, given.repeat)
        return campaign(given.seed, given.minutes, given.only)


if __name__ == "__main__":
    raise SystemExit(main())
