"""Runs in the making: pieces of steps, between which Python sees Ctrl-C and shows the progress."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from .. import core
from ..core import Array, ffi, lib
from ..core.extras import Show
from ..system import System
from .scheme import Scheme
from .solution import Solution, Statistics

PIECE_SECONDS = 0.07  # of one call of C: short enough for Ctrl-C, long enough to cost nothing


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
    """Return a ``dal_stepper`` at its initial data, which the core has checked."""
    record, kept = scheme._record_of(system)
    stepper = core.make("stepper", system._handle, record, options, owner=(system._handle, kept))
    status = core.attempt(lib.dal_stepper_start, stepper, t0, h, x0, consistency, initial)
    hint = "; consistent='project' would project v0" if status == lib.DAL_EOFFD else ""
    core.verify(status, stepper, system.kind, hint=hint, step=0, t=t0)
    return stepper


def consistent_state(system: System, x0: Array, t0: float, consistency: int) -> Array:
    """Return what every scheme would start from, shape (2n,)."""
    scheme = Scheme.find("explicit")
    stepper = started_stepper(system, scheme, x0, t0=t0, h=1.0, consistency=consistency)
    return core.doubles(lib.dal_stepper_state(stepper), 2 * system.n)


class Run:
    """A run in the making: its buffers, how many rows of them are good, and why it ended."""

    def __init__(
        self,
        system: System,
        scheme: Scheme,
        stepper: Any,
        *,
        t0: float,
        h: float,
        steps: int,
        stride: int,
        observer: core.Callables | None,
        show: Show,
    ) -> None:
        rows = steps // stride
        self.system, self.scheme, self.stepper = system, scheme, stepper
        self.t0, self.h = t0, h
        self.show, self.shown_at = show, -np.inf
        self.x = np.empty((rows + 1, 2 * system.n))
        self.reactions = np.empty((rows, system.m))
        self.status = lib.DAL_SUCCESS
        self.error: BaseException | None = None
        self.contexts = [ffi.new_handle(one) for one in (observer, core.ignore)]
        self.run = ffi.new(
            "dal_run *",
            {
                "stepper": stepper, "steps": steps, "stride": stride,
                "x": core.pointer(self.x), "reactions": core.pointer(self.reactions),
                "observer": ffi.NULL if observer is None else lib.dal_py_observer,
                "observer_ctx": self.contexts[0],
                "watch": lib.dal_py_watch, "watch_ctx": self.contexts[1],
            },
        )  # fmt: skip

    def make(self) -> None:
        """Make the run; if it does not go through, ``status`` and ``error`` say why."""
        run, piece = self.run, 1
        try:
            while True:
                began = time.perf_counter()
                self.status = core.attempt(lib.dal_run_go, run, piece)
                elapsed = time.perf_counter() - began
                self.tell(began + elapsed)
                if self.status != lib.DAL_SUCCESS or run.done == run.steps:
                    break
                piece = max(1, int(piece * min(8.0, PIECE_SECONDS / max(elapsed, 1e-9))))
        except BaseException as error:  # KeyboardInterrupt too: what was computed goes with it
            self.status, self.error = lib.DAL_EUSER, error
            return
        if self.status < 0:
            message = core.words(self.stepper, self.system.kind)
            t = lib.dal_stepper_time(self.stepper)
            self.error = core.failure(self.status, message, step=int(run.done), t=t)

    def tell(self, now: float) -> None:
        """Show the progress, some times a second and at the end."""
        if now - self.shown_at > PIECE_SECONDS or self.run.done == self.run.steps:
            self.shown_at = now
            self.show(int(self.run.done))

    def solution(self) -> Solution:
        """Return the rows that are good."""
        run, rows = self.run, max(int(self.run.stored) - 1, 0)
        t = self.t0 + rows * int(run.stride) * self.h
        messages = {
            lib.DAL_SUCCESS: f"{rows * int(run.stride)} steps to t = {t:g}",
            lib.DAL_STOPPED: f"an observer stopped the run at t = {t:g}",
        }
        return Solution(
            system=self.system, scheme=self.scheme, t0=self.t0, h=self.h, stride=int(run.stride),
            x=self.x[: rows + 1], reactions=self.reactions[:rows], status=self.status,
            stats=Statistics._read(self.stepper, self.system.kind),
            message=messages.get(self.status, f"{type(self.error).__name__}: {self.error}"),
        )  # fmt: skip
