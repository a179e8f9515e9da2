"""Events of a run: where a function of the state changes its sign."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import core
from ..core import Array, arguments, ffi, lib
from ..system import System
from .laws import Law, are_compiled, is_expression, reset_of, values
from .scheme import Scheme

CONSISTENCY = {"check": lib.DAL_CHECK, "project": lib.DAL_PROJECT, "assume": lib.DAL_ASSUME}


@dataclass(frozen=True)
class Event:
    """Where a function g of the state changes its sign, and what then happens.

    Its place is found by a step of the scheme from the last state, so that the state lies in D to
    roundoff and has the order of the scheme.  A change of sign from one step to the next is found,
    and also two of them within a step where g falls towards zero at its beginning and rises at its
    end.  A state with g = 0 counts when it is reached, and not when it is left.

    Parameters
    ----------
    g : callable or sympy.Expr
        ``g(t, q, v) -> float``, a number that changes its sign where the event is, as q[0] - 1,
        and no condition as q[0] > 1; or an expression in coordinates, velocities, parameters and
        the time, which is compiled.
    direction : float, optional
        > 0: only where g grows along the run; < 0: where it falls; 0: both.
    terminal : bool or int, optional
        The run ends at this event: at the first, or at the one of this number.
    reset : callable or mapping, optional
        ``reset(q, v) -> (q, v)``, or ``{x.d: -x.d / 2, ...}``, expressions of coordinates and
        velocities that change, which are compiled: the state from which the run continues.  The
        event that ends the run has no reset.
    consistent : {"check", "project", "assume"}, optional
        A state of ``reset`` that is not in D is refused, projected in the mass metric, or used.

    Examples
    --------
    >>> import dalembert as dal
    >>> wall = dal.Event(lambda t, q, v: q[0] - 0.4, direction=1, reset=lambda q, v: (q, -v))
    >>> run = dal.integrate(dal.systems.knife_edge(), h=0.01, t_end=4, events=[wall])
    >>> run.q_events[0][:, 0]
    array([0.4, 0.4, 0.4])
    """

    g: Any
    direction: float = 0.0
    terminal: bool | int = False
    reset: Callable[[Array, Array], tuple[ArrayLike, ArrayLike]] | Mapping[Any, Any] | None = None
    consistent: str = "check"


@dataclass
class Happened:
    """What happened in a run, in the order of time."""

    count: int
    events: list[int] = field(default_factory=list)
    t: list[float] = field(default_factory=list)
    x: list[Array] = field(default_factory=list)
    after: list[Array | None] = field(default_factory=list)

    def add(self, number: int, t: float, x: Array, after: Array | None) -> None:
        """Take one more."""
        self.events.append(number)
        self.t.append(t)
        self.x.append(x)
        self.after.append(after)


def take(given: Any) -> list[Event]:
    """Return what was given as events; functions may have SciPy's attributes."""
    if given == ():
        return []
    if callable(given) or isinstance(given, Event) or is_expression(given):
        given = [given]
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise ValueError(f"events = {arguments.shown(given)}: expected a sequence of events")
    return [_event(one, f"events[{k}]") for k, one in enumerate(given)]


def _event(one: Any, name: str) -> Event:
    if not isinstance(one, Event):
        fields = ("direction", "terminal", "reset", "consistent")
        one = Event(one, **{key: getattr(one, key) for key in fields if hasattr(one, key)})
    if getattr(one.g, "is_Relational", False) or getattr(one.g, "is_Boolean", False):
        raise ValueError(
            f"{name} = {one.g}: a condition; expected an expression that changes its sign where it "
            "happens, as x - 1 for x > 1"
        )
    if not (is_expression(one.g) or callable(one.g)):
        raise ValueError(f"{name} = {arguments.shown(one.g)}: expected g(t, q, v) or an expression")
    if not is_expression(one.g):
        arguments.function(one.g, name, "t, q, v")
    arguments.number(one.direction, f"{name}.direction")
    if not isinstance(one.terminal, bool | np.bool_):
        arguments.integer(one.terminal, f"{name}.terminal", 0)
    if not isinstance(one.reset, Mapping):
        arguments.function(one.reset, f"{name}.reset", "q, v")
    arguments.choice(one.consistent, f"{name}.consistent", CONSISTENCY)
    return one


def laws(system: System, one: Event, name: str) -> tuple[Any, Law | None]:
    """Return g as named expressions, and the reset as a law; None for what is not one."""
    g = ((name, one.g),) if is_expression(one.g) else None
    is_mapping = isinstance(one.reset, Mapping)
    return g, reset_of(system, one.reset, name) if is_mapping else None


def is_in_c(system: System, one: Event, name: str = "event") -> bool:
    """Return whether C looks for an event, and resets the state, without Python."""
    g, reset = laws(system, one, name)
    if g is None or (one.reset is not None and reset is None):
        return False
    return are_compiled(system, g) and (reset is None or reset.is_compiled(system))


class Watch:
    """The events of a run in C, and the times that are asked for."""

    def __init__(
        self,
        system: System,
        stepper: Any,
        scheme: Scheme,
        events: Sequence[Event],
        times: Array | None,
    ) -> None:
        self.events, self.times = list(events), times
        self.happened = Happened(len(events))
        self.at = None if times is None else np.empty((len(times), 2 * system.n))
        rows = ffi.new("dal_event[]", max(len(events), 1))
        self._kept: list[Any] = []
        for k, one in enumerate(events):
            self._fill(system, rows[k], one, f"events[{k}]")
        record, kept = scheme._record_of(system)
        self._kept.append(kept)
        self.handle = core.make(
            "events", stepper, record, rows, len(events), owner=(stepper, self._kept)
        )
        self.context = ffi.NULL
        if events:
            listener = core.Callables(system.n, system.m, happened=self.happened.add)
            self.context = ffi.new_handle(listener)
            self._kept.append(listener)

    @classmethod
    def of(
        cls,
        system: System,
        stepper: Any,
        scheme: Scheme,
        events: Sequence[Event],
        times: Array | None,
    ) -> Watch | None:
        """Return what looks at a run; None where there is nothing to look at."""
        needed = events or times is not None
        return cls(system, stepper, scheme, events, times) if needed else None

    def _fill(self, system: System, row: Any, one: Event, name: str) -> None:
        """Write the event for C."""
        row.direction = int(np.sign(one.direction))
        row.terminal = int(one.terminal)
        row.consistency = CONSISTENCY[one.consistent]
        g, reset = laws(system, one, name)
        callables = core.Callables(system.n, system.m, g=one.g, reset=one.reset, name=name)
        context = ffi.new_handle(callables)
        self._kept += [callables, context]
        row.g, row.ctx = lib.dal_py_event, context
        if g is not None:
            row.g, row.ctx, kept = values(system, g)
            self._kept.append(kept)
        if reset is not None:
            law, kept = reset.in_c(system)
            row.reset, row.reset_ctx = ffi.addressof(lib, "dal_law_reset"), law
            self._kept += [law, kept]
        elif one.reset is not None:
            row.reset, row.reset_ctx = lib.dal_py_reset, context

    def join(self, run: Any) -> None:
        """Have a ``dal_run`` look at them."""
        run.events, run.happened, run.happened_ctx = self.handle, lib.dal_py_happened, self.context
        if self.times is not None:
            run.times, run.time_count = core.pointer(self.times), len(self.times)
            run.at = core.pointer(self.at, output=True)

    @property
    def last(self) -> int:
        """The event that happened last."""
        return self.happened.events[-1]

    def doubts(self) -> Iterator[str]:
        """Say what could not be told."""
        if not self.events:
            return
        number, t, g = ffi.new("size_t *"), ffi.new("double *"), ffi.new("double *")
        if doubts := lib.dal_events_doubts(self.handle, number, t, g):
            often = "once" if doubts == 1 else f"{doubts} times"
            yield (
                f"events[{int(number[0])}] comes so near to zero within a step, {often}, first at "
                f"t = {t[0]:g} with g = {g[0]:.3g}, that the error of the step is larger: whether "
                "it happens there cannot be told; take a smaller h"
            )


def split(happened: Happened, n: int) -> tuple[tuple[Array, ...], ...]:
    """Return times, states and states after resets of each event."""
    found = []
    for k in range(happened.count):
        of = [i for i, event_ in enumerate(happened.events) if event_ == k]
        t = np.array([happened.t[i] for i in of])
        x = np.array([happened.x[i] for i in of]).reshape(-1, 2 * n)
        none = np.full(2 * n, np.nan)
        ends = [happened.after[i] if happened.after[i] is not None else none for i in of]
        found.append((t, x, np.array(ends).reshape(-1, 2 * n)))
    times, states, after = zip(*found) if found else ((), (), ())
    return times, states, after
