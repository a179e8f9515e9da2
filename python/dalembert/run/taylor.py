"""The reference flow by Taylor series, for systems from expressions, with heyoka.

The tolerance determines the order of a step; LLVM compiles the step for the system.  States between
its ends are sums of the same series.  Stored states are projected to D.  The run consists of legs
that start from states in D, so it does not drift off D.  Each leg has a tolerance for the size of
its first state, because heyoka's tolerance is relative to the largest component.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from .. import core, geometry, symbolic
from ..core import Array, ConvergenceError, DalembertError, DomainError, extras, lib
from ..core.extras import Show
from ..system import System
from .runs import Plan
from .solution import Solution, Statistics, counts_of

ROWS, STEPS = 64, 128  # of a leg, at the most
LARGE = 32.0  # a number in a state that makes the tolerance of its series smaller,
RATIO = 1024.0  # by steps of this, since each tolerance is compiled; the smaller the longer
LARGEST = 1e30  # number that takes seconds
LOOSER = 10.0  # of the second integration, whose difference is the accuracy

# Integrators that nobody uses, by what they were compiled for; as many as this are kept.
_KEPT = 16
_idle: dict[tuple[str, float], list[_Series]] = {}
_lock = threading.Lock()


class _Series:
    """An integrator of heyoka for a model, with values of its parameters."""

    def __init__(self, model: Any, tolerance: float) -> None:
        heyoka = extras.require("heyoka", "method='taylor'")
        pairs, self.is_branched = symbolic.series.ode(model, heyoka)
        self.key, self.tolerance = (model.key, tolerance), tolerance
        # For n = 5, m = 3 compiling takes 7 s, or 1.4 for steps that take twice as long.
        self.flow = heyoka.taylor_adaptive(
            pairs, [0.0] * len(pairs), tol=tolerance, compact_mode=model.n + model.m > 7,
            pars=[0.0] * (len(model.p) + len(model.u)),
        )  # fmt: skip
        self.outcomes = heyoka.taylor_outcome
        self.steps = 0

    def start(self, system: System, x: Array, t: float) -> None:
        """Start from a state at a time."""
        values = [*system.parameters.values(), *([0.0] * len(system.inputs))]
        self.flow.pars[:] = values
        self.flow.state[:] = x
        self.flow.time = t

    def to(self, system: System, times: Array) -> tuple[Array, DalembertError | None]:
        """Return the rows at later times, which may repeat, up to the end of a leg, and its error.

        If the error is None, the leg can be continued.
        """
        ahead = times[np.r_[True, np.diff(times) != 0]]
        grid = ahead if ahead[0] == self.flow.time else np.r_[self.flow.time, ahead]
        stop: list[DalembertError] = []
        if len(grid) == 1:
            return np.repeat(self.flow.state[None], len(times), axis=0), None
        last, stuck, count = float(self.flow.time), 0, 0

        def look(flow: Any) -> bool:
            """Notice Ctrl-C, and record the end of the step."""
            nonlocal last, stuck, count
            self.steps, count = self.steps + 1, count + 1
            h, t = float(flow.last_h), float(flow.time)
            stuck = stuck + 1 if t == last else 0  # the last step to a row may be a rounding
            if stuck == 3:
                stop.append(self.collapsed(t, h))
            elif self.is_branched:
                stop.extend(self.branches(system, last, h))
            last = last if stop else t
            return not stop and count < STEPS

        outcome, *_, found = self.flow.propagate_grid(grid, callback=look)
        if not stop and outcome not in (self.outcomes.time_limit, self.outcomes.cb_stop):
            stop.append(DomainError(
                f"method = 'taylor': the series are not finite beyond t = {last!r}"
            ))  # fmt: skip
        found = np.asarray(found)[len(grid) - len(ahead) :]
        rows = np.cumsum(np.r_[False, np.diff(times) != 0])
        return found[rows[rows < len(found)]], stop[0] if stop else None

    def collapsed(self, t: float, h: float) -> DalembertError:
        return ConvergenceError(
            f"method = 'taylor': the step size collapsed to h = {h:g} at t = {t!r} (tolerance "
            f"{self.tolerance:g})"
        )  # fmt: skip

    def branches(self, system: System, t: float, h: float) -> Iterator[DalembertError]:
        """Yield an error if the series do not solve the ODE at the end of a step.

        This happens after a point at which a root is zero, or the argument of an atan2 turned.
        """
        n, flow = system.n, self.flow
        numbers = np.arange(1, flow.tc.shape[1])
        slope = (flow.tc[:, 1:] * numbers) @ h ** (numbers - 1.0)
        try:
            rate = geometry.field(system, flow.state[:n], flow.state[n:], t=float(flow.time))
        except DalembertError as error:
            ends = f"the motion ends between t = {t!r} and {float(flow.time)!r}"
            yield type(error)(f"method = 'taylor': {ends}: {error}", status=error.status)
            return
        size = np.abs(rate).max() + np.abs(slope).max()
        if not np.abs(slope - rate).max() <= max(1e-6, self.tolerance**0.5) * size:
            yield DomainError(
                f"method = 'taylor': between t = {t!r} and {float(flow.time)!r} the motion "
                "passes a point where it has no Taylor series, for example a zero of a root; "
                "choose another method"
            )  # fmt: skip


@contextlib.contextmanager
def _series(system: System, tolerance: float) -> Iterator[_Series]:
    """Provide an integrator for exclusive use."""
    model = system._model
    key = model.key, tolerance
    with _lock:
        found = _idle.get(key)
        series = found.pop() if found else None
    if series is None:
        series = _Series(model, tolerance)
    series.steps = 0
    try:
        yield series
    finally:
        with _lock:
            _idle.setdefault(key, []).append(series)
            if sum(map(len, _idle.values())) > _KEPT:
                oldest = next(k for k, kept in _idle.items() if kept)
                _idle.pop(oldest)


def _level(tolerance: float, x: Array) -> float:
    """Return the tolerance for heyoka that gives this tolerance for each component of a state."""
    size = float(np.abs(x).max())
    if size > LARGEST:
        raise DomainError(
            f"method = 'taylor': a state has numbers up to {size:g}; expected at most "
            f"{LARGEST:g}, because the tolerance of a series is relative to the largest"
        )
    excess = size / LARGE
    return tolerance / RATIO ** max(0, math.ceil(math.log(max(excess, 1.0), RATIO)))


def _legs(
    system: System, x: Array, t: float, times: Array, tolerance: float
) -> Iterator[tuple[Array, int]]:
    """Yield rows at the given times, from x at t, not yet in D, with the number of steps."""
    done = steps = 0
    level = _level(tolerance, x)
    while done < len(times):
        with _series(system, level) as series:
            series.start(system, x, t)
            rows, error = series.to(system, times[done : done + ROWS])
            end, now = series.flow.state.copy(), float(series.flow.time)
            steps += series.steps
        used, level = level, level if error is not None else _level(tolerance, end)
        if level < used:
            continue  # the same leg once more
        done += len(rows)
        yield rows, steps
        if error is not None:
            raise error
        x, t = end, now
        if done < len(times):
            geometry.projection(system, x[None], t=t)


def require_supported(system: System, **given: Any) -> None:
    """Raise an exception for a system without expressions, or for unsupported arguments."""
    if system._model is None:
        raise ValueError(
            f"method = 'taylor': the system {system.name!r} has no expressions to "
            "differentiate; expected a system from System.from_sympy"
        )
    for name, value in given.items():
        if value is not None and not (isinstance(value, (list, tuple)) and len(value) == 0):
            raise NotImplementedError(
                f"{name}: not supported by method = 'taylor'; choose rk8pd, msadams or rodas"
            )


def state(system: System, x: Array, t0: float, t: float, tolerance: float) -> tuple[Array, float]:
    """Return the state in D at t, from x at t0, and an estimate of its error."""
    ends = []
    for level in (tolerance, min(LOOSER * tolerance, 0.1)):
        *_, (rows, _) = _legs(system, x, t0, np.array([t]), level)
        geometry.projection(system, rows, t=t)
        ends.append(rows[0])
    n = system.n
    rate = geometry.field(system, ends[0][:n], ends[0][n:], t=t)
    least = 4.0 * np.abs(ends[0]).max() + np.abs(rate).max() * max(abs(t), abs(t0))
    difference = np.abs(ends[0] - ends[1]).max()
    return ends[0], float(max(difference, np.finfo(float).eps / 2 * least))


class SeriesRun:
    """A run by Taylor series in execution, with the interface of `Run`."""

    def __init__(self, plan: Plan, show: Show) -> None:
        self.system, self.scheme, self.stepper = plan.system, plan.scheme, plan.stepper
        steps, stride, watch = plan.steps, plan.stride, plan.watch
        t0, h = self.t0, self.h = steps.t0, steps.h
        self.stride, self.steps = stride, steps.count
        self.observer, self.show, self.watch = plan.asked.observer, show, watch
        self.times = None if watch is None else watch.times
        self.start = core.doubles(lib.dal_stepper_state(plan.stepper), 2 * plan.system.n)
        stored = t0 + np.arange(steps.count // stride + 1) * stride * h
        self.grid = stored[1:] if self.times is None else self.times
        self.x = np.empty((len(self.grid), 2 * plan.system.n))
        self.done = 0  # rows
        self.worst = 0.0
        self.taken = 0  # steps of the series
        self.status = lib.DAL_SUCCESS
        self.error: BaseException | None = None

    def make(self) -> None:
        """Execute the run; after a failure ``status`` and ``error`` have the reason."""
        try:
            self._make()
        except BaseException as error:  # KeyboardInterrupt too: what was computed goes with it
            self.error = error
            self.status = error.status if isinstance(error, DalembertError) else lib.DAL_EUSER
            if isinstance(error, DalembertError):
                error.step = self._step()
                error.t = float(self.grid[self.done - 1]) if self.done else self.t0

    def _make(self) -> None:
        if self._stops(0, self.t0, self.start):
            return
        legs = _legs(self.system, self.start, self.t0, self.grid, self.scheme.tolerance)
        for rows, self.taken in legs:
            if self._store(rows):
                return
            self.show(self._step())

    def _store(self, rows: Array) -> bool:
        """Project rows to D and store them; return whether the observer stops the run."""
        begin, n = self.done, self.system.n
        if len(rows) == 0:
            return False
        times = self.grid[begin : begin + len(rows)]
        kept = self.x[begin : begin + len(rows)]
        kept[:] = rows
        try:
            geometry.projection(self.system, kept, t=times.tolist())
            residual = geometry.relative_residual(self.system, kept[:, :n], kept[:, n:], t=times)
        except DalembertError as error:  # its step is the row
            if error.step:
                self._store(rows[: error.step])
            raise
        self.worst = max(self.worst, *residual)
        for t, x in zip(times, kept):
            self.done += 1
            if self._stops(self._step(), float(t), x):
                return True
        return False

    def _stops(self, step: int, t: float, x: Array) -> bool:
        """Show a state to the observer, and return whether it stops the run."""
        if self.observer is None:
            return False
        n = self.system.n
        if self.observer(step, t, x[:n].copy(), x[n:].copy()):
            self.status = lib.DAL_STOPPED
        return bool(self.status == lib.DAL_STOPPED)

    def _step(self) -> int:
        """Return the number of steps taken."""
        if self.times is None or self.done == len(self.grid):
            return self.done * self.stride if self.times is None else self.steps
        t = float(self.grid[self.done - 1]) if self.done else self.t0
        return int((t - self.t0) / self.h)

    def solution(self) -> Solution:
        """Return the solution so far."""
        system, x, times = self.system, self.x[: self.done], None
        if self.times is None:
            x = np.vstack([self.start, x])
        elif self.done:
            times = self.times[: self.done]
        else:
            x, times = self.start[None], np.array([self.t0])
        stats = dataclasses.replace(
            Statistics._of(counts_of(self.stepper), system.kind), steps=self._step(),
            evaluations=self.taken, worst_residual=self.worst,
        )  # fmt: skip
        t = self.t0 + self._step() * self.h
        message = f"{self._step()} steps to t = {t:g}"
        if self.status == lib.DAL_STOPPED:
            message = f"an observer stopped the run at t = {t:g}"
        if self.error is not None:
            message = f"{type(self.error).__name__}: {self.error}"
        return Solution._made(
            system=system, scheme=self.scheme, t0=self.t0, h=self.h, stride=self.stride, x=x[:],
            reactions=np.full((len(x) - 1, system.m), np.nan), status=self.status, times=times,
            inputs=np.zeros((0, len(system.inputs))), hold=1, control={}, stats=stats,
            message=message,
        )  # fmt: skip
