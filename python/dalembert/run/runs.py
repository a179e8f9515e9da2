"""Runs in the making: blocks of steps, between which Python sees Ctrl-C and shows the progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from .. import core, geometry
from ..core import Array, ffi, lib
from ..system import System
from .scheme import REFERENCE, Scheme
from .solution import Solution, Statistics

__all__ = ["FlowRun", "Run", "SchemeRun", "started_state", "started_stepper"]

BLOCK_SECONDS = 0.07  # of one call of C: short enough for Ctrl-C, long enough to cost nothing
FLOW_ROWS = 100  # of one call of the reference flow, which starts anew in each


def started_stepper(
    system: System,
    scheme: Scheme,
    x0: Array,
    *,
    t0: float,
    h: float,
    consistency: int,
    initial: int = lib.DAL_INITIAL_NONE,
    options: Any = ffi.NULL,
) -> Any:
    """Return a ``dal_stepper`` at its initial data, which the core has checked.

    The record of the reference flow is that of a scheme with beta = 0: a stepper of it does with
    the initial data what every scheme does, and makes no step.
    """
    stepper = system._c("stepper", scheme._record, options)
    status = core.attempt(lib.dal_stepper_start, stepper, t0, h, x0, consistency, initial)
    if status < 0:
        hint = "; consistent='project' would project v0" if status == lib.DAL_EOFFD else ""
        message = core.string(lib.dal_stepper_message(stepper)) + hint
        raise core.failure(status, message, kind=system.kind, step=0, t=t0)
    return stepper


def state(stepper: Any, system: System) -> Array:
    """Return a copy of the state of a stepper, shape (2n,)."""
    return core.doubles(lib.dal_stepper_state(stepper), 2 * system.n)


def started_state(system: System, x0: Array, t0: float, consistency: int) -> Array:
    """Return the state from which the reference flow starts, shape (2n,)."""
    stepper = started_stepper(system, REFERENCE, x0, t0=t0, h=1.0, consistency=consistency)
    return state(stepper, system)


class Run:
    """A run in the making: its buffers, how many rows of them are good, and why it ended."""

    def __init__(
        self,
        system: System,
        scheme: Scheme,
        t0: float,
        h: float,
        rows: int,
        stride: int,
        observer: core.Observer | None,
        show: Callable[[int], Any],
    ) -> None:
        self.system = system
        self.scheme = scheme
        self.t0, self.h, self.rows, self.stride = t0, h, rows, stride
        self.observer = observer
        self.show, self.shown, self.shown_at = show, -1, 0.0
        self.x = np.empty((rows + 1, 2 * system.n))
        self.reactions = np.empty((rows, system.m))
        self.good = 0  # rows after row 0
        self.status = lib.DAL_SUCCESS
        self.error: BaseException | None = None
        self.done = ffi.new("size_t *")

    def make(self) -> None:
        """Make the run; if it does not go through, ``status`` and ``error`` say why."""
        try:
            for start, count in self.blocks():
                self.block(start, count)
                self.tell(self.good * self.stride)
                if self.status != lib.DAL_SUCCESS:
                    return
        except BaseException as error:  # KeyboardInterrupt too: what was computed goes with it
            self.status, self.error = lib.DAL_EUSER, error

    def tell(self, steps: int) -> None:
        """Show the progress, some times a second and at the end."""
        now = time.perf_counter()
        last = steps == self.rows * self.stride
        if steps > self.shown and (last or now - self.shown_at > BLOCK_SECONDS):
            self.shown, self.shown_at = steps, now
            self.show(steps)

    def blocks(self) -> Iterator[tuple[int, int]]:
        """Yield (first row, number of rows); also for no rows, so that row 0 is observed."""
        raise NotImplementedError

    def block(self, start: int, count: int) -> None:
        """Compute the rows after ``start``; set ``good``, and ``status`` and ``error``."""
        raise NotImplementedError

    def stats(self) -> Statistics:
        """Return what the run has cost so far."""
        raise NotImplementedError

    def time(self, row: int) -> float:
        """Return the time of a stored state."""
        return self.t0 + row * self.stride * self.h

    def observe(self, row: int) -> bool:
        """Show a stored state to the observer; return whether it wants to stop."""
        n = self.system.n
        x = self.x[row].copy()
        x.flags.writeable = False
        return self.observer is not None and self.observer.see(
            row * self.stride, self.time(row), x[:n], x[n:]
        )

    def solution(self) -> Solution:
        """Return the rows that are good."""
        t = self.time(self.good)
        messages = {
            lib.DAL_SUCCESS: f"{self.good * self.stride} steps to t = {t:g}",
            lib.DAL_STOPPED: f"an observer stopped the run at t = {t:g}",
        }
        return Solution(
            system=self.system,
            scheme=self.scheme,
            x=self.x[: self.good + 1],
            reactions=self.reactions[: self.good],
            t0=self.t0,
            h=self.h,
            stride=self.stride,
            stats=self.stats(),
            status=self.status,
            message=messages.get(self.status, f"{type(self.error).__name__}: {self.error}"),
        )


class SchemeRun(Run):
    """A run of a stepper."""

    def start(self, x0: Array, consistency: int, initial: int, options: Any) -> None:
        """Make the stepper and check the initial data; what is raised here has no part of a run."""
        self.stepper = started_stepper(
            self.system, self.scheme, x0, t0=self.t0, h=self.h, consistency=consistency,
            initial=initial, options=options,
        )  # fmt: skip
        self.x[0] = state(self.stepper, self.system)
        self.most = min(10_000, geometry.most_in_a_call(self.system))  # steps in one call of C
        observed = self.observer is not None
        self.context = ffi.new_handle(self.observer) if observed else ffi.NULL
        self.trampoline = lib.dal_py_observer if observed else ffi.NULL

    def stats(self) -> Statistics:
        return Statistics._read(self.stepper, self.system.kind)

    def blocks(self) -> Iterator[tuple[int, int]]:
        start, count = 0, max(1, min(16, self.most // self.stride))
        while start < self.rows or start == 0:
            count = min(count, self.rows - start)
            began = time.perf_counter()
            yield start, count
            elapsed = max(time.perf_counter() - began, 1e-9)
            start += max(count, 1)
            count = max(1, int(count * min(8.0, BLOCK_SECONDS / elapsed)))

    def block(self, start: int, count: int) -> None:
        if self.stride <= self.most or count == 0:
            status = core.attempt(
                lib.dal_integrate, self.stepper, count * self.stride, self.stride,
                core.pointer(self.x, start), core.pointer(self.reactions, start),
                self.trampoline, self.context, self.done,
            )  # fmt: skip
            self.good = start + int(self.done[0]) // self.stride
            self.end(status)
            return
        for row in range(start, start + count):
            if self.observe(row):
                self.end(lib.DAL_STOPPED)
            else:
                self.long_interval(row)
            if self.status != lib.DAL_SUCCESS:
                return

    def long_interval(self, row: int) -> None:
        """Go from one stored state to the next in pieces, always the same ones: so are the bits."""
        total = np.zeros(self.system.m)
        mean = np.empty(self.system.m)
        for begin in range(0, self.stride, self.most):
            steps = min(self.most, self.stride - begin)
            status = core.attempt(lib.dal_advance, self.stepper, steps, mean, self.done)
            if status != lib.DAL_SUCCESS:
                self.end(status)
                return
            total += steps * mean
            self.tell(row * self.stride + begin + steps)
        self.x[row + 1] = state(self.stepper, self.system)
        self.reactions[row] = total / self.stride
        self.good = row + 1
        if self.good == self.rows and self.observe(self.good):
            self.end(lib.DAL_STOPPED)

    def end(self, status: int) -> None:
        """Take over a status, with the exception that belongs to it."""
        self.status = status
        if status < 0:
            step = self.stats().steps
            t = lib.dal_stepper_time(self.stepper)
            message = core.string(lib.dal_stepper_message(self.stepper))
            self.error = core.failure(status, message, kind=self.system.kind, step=step, t=t)


class FlowRun(Run):
    """A run of the reference flow.

    Its blocks have a fixed number of rows, because the integrator starts anew in each: the bits
    must not depend on how fast the machine is.
    """

    def start(self, x0: Array, consistency: int, method: int, tolerance: float) -> None:
        """Make the flow and check the initial data; what is raised here has no part of a run."""
        self.flow = self.system._c("flow", method, lib.DAL_FLOW_X, tolerance)
        stepper = started_stepper(
            self.system, REFERENCE, x0, t0=self.t0, h=self.h, consistency=consistency
        )
        self.x[0] = state(stepper, self.system)
        self.initial = Statistics._read(stepper, self.system.kind)
        self.reactions.fill(np.nan)

    def stats(self) -> Statistics:
        return Statistics(
            steps=self.good * self.stride,
            initial_residual=self.initial.initial_residual,
            initial_correction=self.initial.initial_correction,
            differenced=self.system.differenced,
            evaluations=int(lib.dal_flow_evaluations(self.flow)),
        )

    def blocks(self) -> Iterator[tuple[int, int]]:
        for start in range(0, max(self.rows, 1), FLOW_ROWS):
            yield start, min(FLOW_ROWS, self.rows - start)

    def block(self, start: int, count: int) -> None:
        if start == 0 and self.observe(0):
            self.status = lib.DAL_STOPPED
            return
        last = (start + count) * self.stride

        def show(t: float) -> None:
            self.tell(min(int((t - self.t0) / self.h), last))

        with core.watching("flow", self.flow, show):
            status = core.attempt(
                lib.dal_flow_trajectory, self.flow, self.time(start), self.stride * self.h, count,
                core.pointer(self.x, start), self.done,
            )  # fmt: skip
        if status < 0:
            message = core.string(lib.dal_flow_message(self.flow))
            good = start + int(self.done[0])
            self.error = core.failure(
                status, message, kind=self.system.kind, step=good * self.stride, t=self.time(good)
            )
        for row in range(start + 1, start + 1 + int(self.done[0])):
            self.good = row
            if self.observe(row):
                self.status, self.error = lib.DAL_STOPPED, None
                return
        self.status = status
