"""Execution of runs in pieces of steps; between them Python notices Ctrl-C and shows progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import core, geometry, symbolic
from ..core import Array, arguments, ffi, lib
from ..core.errors import raised
from ..core.extras import Show
from ..core.memory import require_memory
from ..system import System
from .laws import Law, is_control
from .scheme import Scheme
from .dense import Dense
from .events import Watch, split
from .solution import Solution, Statistics, counts_of, rank_doubt
from .steps import Steps

OFF_D = (
    ". Pass consistent='project' to use the nearest admissible velocity, or compute it with "
    "system.project(q0, v0)"
)
RESET_OFF_D = ". Give the event consistent='project' to project the velocity after its reset"
_FIRST_ROWS = 3  # of a run whose number of steps nobody knows
PIECE_SECONDS = 0.07  # of one call of C: short enough for Ctrl-C, long enough to cost nothing


_KINDS, _SIZE = 16, 64  # of steppers that are kept: kinds of a system, and its n + m


def idle_steppers(system: System, scheme: Scheme, options: Any) -> list[Any]:
    """Return cached idle steppers; creating one can cost as much as a short run.

    A start resets everything in them except the inputs.
    """
    if system.n + system.m > _SIZE or system.inputs or scheme._maps is not None:
        return []
    kinds, kind = system._steppers, (scheme._record, options)
    if kind not in kinds and len(kinds) >= _KINDS:
        kinds.clear()
    return kinds.setdefault(kind, [])


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
    idle: list[Any] | None = None,
    inputs: Array | None = None,
) -> Any:
    """Return a ``dal_stepper``, if possible an idle one, started from initial data that C checked.

    ``inputs`` are the initial inputs, for constraints that depend on them; None: zeros.
    """
    try:
        stepper = (idle or []).pop()
    except IndexError:
        record, kept = scheme._record_of(system)
        handle = scheme._stepped(system)._handle
        stepper = core.make("stepper", handle, record, options, owner=(handle, kept))
    raised.exception = None
    if inputs is not None:
        lib.dal_stepper_input(stepper, core.pointer(inputs))
    status = lib.dal_stepper_start(stepper, t0, h, core.pointer(x0), consistency, initial)
    if status < 0:
        hint = OFF_D if status == lib.DAL_EOFFD else ""
        if hint and system.is_driven:
            values = np.zeros(len(system.inputs)) if inputs is None else inputs
            first = ", ".join(f"{name} = {u:g}" for name, u in zip(system.inputs, values))
            hint = f"; the first inputs are {first}{hint}"
        core.check(status, stepper, system.kind, hint=hint, step=0, t=t0)
    return stepper


def consistent_state(
    system: System, x0: Array, t0: float, consistency: int, inputs: Array | None = None
) -> Array:
    """Return the state from which every scheme would start, shape (2n,)."""
    scheme = Scheme.find("explicit")
    handle = system._handle  # it makes no step, for which something would have to be compiled
    own = core.make("stepper", handle, scheme._record, ffi.NULL, owner=handle)
    stepper = started_stepper(
        system, scheme, x0, t0=t0, h=1.0, consistency=consistency, inputs=inputs, idle=[own]
    )
    return core.doubles(lib.dal_stepper_state(stepper), 2 * system.n)


@dataclass(frozen=True)
class Plan:
    """The parts of a run: ``asked`` are its options, ``first`` the inputs given to the stepper."""

    asked: Any
    system: System
    scheme: Scheme
    stepper: Any
    steps: Steps
    stride: int
    inputs: Any = None
    hold: float = 1
    watch: Watch | None = None
    first: Array | None = None
    dense: Dense | None = None


class Run:
    """A run in execution: its buffers, the number of valid rows, and the reason of its end."""

    def __init__(self, plan: Plan, show: Show) -> None:
        system, stepper, steps, watch = plan.system, plan.stepper, plan.steps, plan.watch
        inputs, hold, observer = plan.inputs, plan.hold, plan.asked.observer
        self.timed = watch is not None and watch.times is not None
        self.system, self.scheme, self.stepper, self.steps = system, plan.scheme, stepper, steps
        self.t0, self.h = steps.t0, steps.h
        self.show, self.shown_at = show, -np.inf
        self.checks = self.left = 0  # steps that check h: all that are known of, those to be made
        self.watch, self.hold, self.dense = watch, hold, plan.dense
        self.journal: Any = None
        self.varies = steps.varies
        self.inputs = None  # the rows that C reads, or that a controller fills
        if inputs is not None:
            given = None if is_control(inputs) else inputs
            self.inputs = arguments.inputs(given, system.inputs, steps.holds(hold))
        self.status = lib.DAL_SUCCESS
        self.error: BaseException | None = None
        self.run = run = ffi.new("dal_run *")
        run.stepper, run.steps, run.stride = stepper, steps.count, plan.stride
        if self.varies:
            run.until, run.input_duration = steps.t_end, steps.direction * hold
        else:
            run.input_steps = int(hold)
        self.watching = ffi.new_handle(_within(show, steps))
        run.watch, run.watch_ctx = lib.dal_py_watch, self.watching
        run.unchecked = plan.asked.check_h is False
        rows = _FIRST_ROWS if self.varies else steps.count // plan.stride + 1
        self._allocate(1 if self.timed else rows)
        ffi.memmove(self.x, lib.dal_stepper_state(stepper), 16 * system.n)
        if self.inputs is not None:
            run.inputs = core.pointer(self.inputs)
        if plan.first is not None and is_control(inputs):  # which was asked for them
            run.rows_set = 1
        if observer is not None or callable(inputs):
            self._call_back(observer, inputs)
        self.law = inputs if isinstance(inputs, Law) else None
        if self.law is not None:
            law, kept = self.law.in_c(system)
            run.control, run.control_ctx = ffi.addressof(lib, "dal_law_control"), law
            self.law_kept = law, kept
        if watch is not None:
            watch.join(run)

    def make_room(self, rows: int) -> None:
        """Provide room in C for so many rows, if their number is not known in advance.

        A run with output times has only the first row.
        """
        if self.timed or rows <= len(self.x):
            return
        rows = max(rows, 2 * len(self.x))
        size = 8 * rows * (2 * self.system.n + self.system.m + 1)
        require_memory(size, f"{rows} stored states", "use a larger stride, or t_eval")
        self._allocate(rows, (self.x, self.reactions, self.times))

    def _allocate(self, rows: int, stored: Sequence[Array] = ()) -> None:
        """Allocate arrays of so many rows for C, which begin with the stored rows."""
        run, system = self.run, self.system
        arrays = (
            np.empty((rows, 2 * system.n)), np.empty((rows - 1, system.m)),
            np.empty(rows if self.varies else 0),
        )  # fmt: skip
        for new, old in zip(arrays, stored):
            new[: len(old)] = old
        self.x, self.reactions, self.times = arrays  # filled: Ctrl-C may come at any time
        if not self.timed:
            run.x, run.reactions = core.pointer(self.x), core.pointer(self.reactions)
            run.row_times = core.pointer(self.times) if self.varies else ffi.NULL

    def _call_back(self, observer: Any, inputs: Any) -> None:
        """Connect an observer, or a controller, with C."""
        system, run = self.system, self.run
        self.callables = core.Callables(
            system.n, system.m, len(system.inputs), observer=observer, control=inputs,
            control_rows=lambda value: _returned_row(value, system.inputs),
        )  # fmt: skip
        self.context = run.observer_ctx = run.control_ctx = ffi.new_handle(self.callables)
        if observer is not None:
            run.observer = lib.dal_py_observer
        if callable(inputs):
            run.control = lib.dal_py_control

    def make(self) -> None:
        """Execute the run; after a failure ``status`` and ``error`` have the reason."""
        interrupted = False  # between two calls of C
        run, piece = self.run, 1  # nobody knows how long a step takes
        if not self.system._source.calls_python:
            piece = max(1, geometry.most_in_a_call(self.system) // 64)
        try:
            while True:
                if self.varies:
                    self.make_room(int(run.stored) + piece // int(run.stride) + 3)
                began = time.perf_counter()
                self.status = core.attempt(lib.dal_run_go, run, piece)
                if self.status >= 0 and isinstance(raised.exception, KeyboardInterrupt):
                    raise raised.exception  # within steps that are made again, which may fail
                elapsed = time.perf_counter() - began
                over = self.is_over
                if over or began + elapsed - self.shown_at > PIECE_SECONDS:
                    self.tell(began + elapsed)
                if self.journal is not None:
                    self.journal.tell()
                if (self.status != lib.DAL_SUCCESS or over) and not run.checks:
                    break
                piece = max(1, int(piece * min(8.0, PIECE_SECONDS / max(elapsed, 1e-9))))
        except BaseException as error:  # KeyboardInterrupt too: what was computed goes with it
            self.status, self.error = lib.DAL_EUSER, error
            interrupted = True
            return
        finally:
            if self.journal is not None:
                self.journal.close(run, saves=interrupted)
        if self.status < 0:
            message = core.words(self.stepper, self.system.kind)
            message += RESET_OFF_D if self.status == lib.DAL_EOFFD else ""
            t = lib.dal_stepper_time(self.stepper)
            if self.status == lib.DAL_ENOCONV:
                message += self._suspects(t)
            self.error = core.failure(self.status, message, step=int(run.done), t=t)

    def _suspects(self, t: float) -> str:
        """Return possible causes why steps from t on do not converge: singular points and jumps."""
        system, found = self.system, ""
        stats = Statistics._of(counts_of(self.stepper), system.kind)
        if stats.rank_doubts:
            found += "; " + rank_doubt(stats)
        if system._model is not None:
            x = core.doubles(lib.dal_stepper_state(self.stepper), 2 * system.n)
            u = core.doubles(lib.dal_stepper_inputs(self.stepper), len(system.inputs))
            near = not self.scheme.is_flow  # whose state is that before its steps
            terms = symbolic.jumps.jumps(system._model, system.parameters, t, x, u, near)
            found += f"; terms that jump{' here' * near}: {', '.join(terms)}" if terms else ""
        return found

    @property
    def is_over(self) -> bool:
        """Whether all steps have been taken."""
        if self.varies:
            return bool(lib.dal_stepper_time(self.stepper) == self.steps.t_end)
        return bool(self.run.done == self.run.steps)

    def tell(self, now: float) -> None:
        """Show the progress."""
        self.shown_at, done, left = now, int(self.run.done), int(self.run.checks)
        if left > self.left:  # they begin again, with another step
            self.checks += left - self.left
        self.left = left
        if self.checks:
            self.show(done + self.checks - left, done + self.checks)
        else:
            self.show(abs(lib.dal_stepper_time(self.stepper) - self.t0) if self.varies else done)

    def _at_times(self) -> tuple[Array, Array]:
        """Return the states at output times, and at a terminal event.

        If the run reached none of them, the initial state.
        """
        run, watch = self.run, self.watch
        assert watch is not None
        x, times = watch.at[: run.times_done], watch.times[: run.times_done]
        if run.ended:
            kept = self.scheme.nodes == "kept"
            shift = self.scheme.shift(self.h) if kept else 0.0  # such steps have one size
            x = np.vstack([x, _end(watch.happened.x[-1], self.system.n, shift)])
            times = np.append(times, run.t_end)
        return (x, times) if len(x) else (self.x[:], np.array([self.t0]))

    def solution(self) -> Solution:
        """Return the solution with the valid rows."""
        run, rows = self.run, max(int(self.run.stored), 1)
        t = self.t0 + (rows - 1) * int(run.stride) * self.h
        rows = min(rows, len(self.x))  # that of output times has none
        x, reactions, times = self.x[:rows], self.reactions[: rows - 1], None
        if self.varies:
            t = lib.dal_stepper_time(self.stepper)
            times = self.times[:rows] if run.stored else np.array([self.t0])
        happened: dict[str, Any] = {}
        if self.watch is not None:
            names = ("t_events", "x_events", "x_after")
            happened = dict(zip(names, split(self.watch.happened)))
            if run.ended:
                t = run.t_end
                if not self.varies:
                    times = self.t0 + np.arange(rows) * int(run.stride) * self.h
                    times[-1] = t
            if self.watch.times is not None:
                x, times = self._at_times()
                reactions = np.full((len(x) - 1, self.system.m), np.nan)
        if self.dense is not None:
            self.dense.span = self.t0, t
        if self.status < 0:
            message = f"{type(self.error).__name__}: {self.error}"
        elif run.ended:
            message = f"events[{self.watch.last}] ended the run at t = {t:g}"
        elif self.status == lib.DAL_SUCCESS:
            message = f"{int(run.done)} steps to t = {t:g}"
        else:
            message = f"an observer stopped the run at t = {t:g}"
        if self.inputs is None:
            inputs = np.empty((0, len(self.system.inputs)))
        elif self.varies:
            inputs = self.inputs[: run.rows_set]
        else:
            inputs = self.inputs[: -(-int(run.done + run.ended) // int(self.hold))]
        return Solution._made(
            system=self.system, scheme=self.scheme, t0=self.t0, h=self.h, stride=int(run.stride),
            x=x, reactions=reactions, status=self.status, times=times, inputs=inputs,
            hold=self.hold, control=self.steps.control, message=message,
            dense=self.dense, _counts=counts_of(self.stepper), **happened,
        )  # fmt: skip


def _within(show: Show, steps: Steps) -> Callable[[float], None]:
    """Return a function that shows the progress within a long step, and lets Ctrl-C through."""
    if steps.varies:
        return lambda t: show(abs(t - steps.t0))
    return lambda t: show(min((t - steps.t0) / steps.h, steps.count))


def _end(x: Array, n: int, shift: float) -> Array:
    """Return a state of the moved nodes as one of the set that the scheme preserves."""
    return np.concatenate([x[:n] + shift * x[n:], x[n:]])


def one_row(value: Any, names: tuple[str, ...]) -> Array:
    """Return inputs as an array of k numbers; a single input may be given as a number."""
    if value is None:
        expected = f"{len(names)} numbers ({', '.join(names)})"
        raise ValueError(f"inputs returned None: expected {expected}")
    return arguments.inputs(value, names, 1)[0]


def _returned_row(value: Any, names: tuple[str, ...]) -> Array:
    """Return the result of a controller as an array of k numbers."""
    shape = arguments.shape(value)
    if len(shape) == 1 and shape[0] != len(names):
        raise ValueError(
            f"inputs(t, q, v) returned {shape[0]} number{'s' * (shape[0] != 1)}: expected "
            f"{len(names)} ({', '.join(names)})"
        )
    return one_row(value, names)


def first_inputs(system: System, inputs: Any, holds: int, x0: Array, t0: float) -> Array | None:
    """Return the inputs of the first step, which determine the D of the initial data.

    None if D does not depend on inputs, or there are no inputs.
    """
    if not system.is_driven or inputs is None:
        return None
    if isinstance(inputs, Law):
        law, _kept = inputs.in_c(system)
        found, raised.exception = np.full(len(system.inputs), np.nan), None
        status = lib.dal_law_control(0, t0, core.pointer(x0), core.pointer(found), law)
        core.check(lib.DAL_EUSER if status else lib.DAL_SUCCESS)
        return arguments.inputs(found, system.inputs, 1)[0]
    if callable(inputs):
        return _returned_row(inputs(t0, *np.split(x0.copy(), 2)), system.inputs)
    return arguments.inputs(inputs, system.inputs, holds)[0].copy()
