"""Events of a run: sign changes of a function of the state."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import core
from ..core import Array, arguments, ffi, lib
from ..system import System
from .laws import Law, are_compiled, is_expression, reset_of, series
from .scheme import Scheme

CONSISTENCY = {"check": lib.DAL_CHECK, "project": lib.DAL_PROJECT, "assume": lib.DAL_ASSUME}


@dataclass(frozen=True)
class Event:
    """A sign change of a function g of the state, and its consequences.

    A step of the scheme leads from the last state to the event.  So its state lies in D to roundoff
    and has the order of the scheme.  A sign change from one step to the next is detected.  Two sign
    changes within a step are detected if g moves towards zero at its beginning and away from zero
    at its end.  A state with g = 0 counts when it is reached, not when it is left.

    Parameters
    ----------
    g : callable or sympy.Expr
        ``g(t, q, v) -> float``, a number that changes sign at the event, such as q[0] - 1, not a
        condition such as q[0] > 1. An expression in coordinates, velocities, parameters and the
        time is compiled.
    direction : float, optional
        Positive: only if g increases along the run; negative: only if g decreases; 0 (default):
        both.
    terminal : bool or int, optional
        True: the first occurrence ends the run.  A number k: the k-th occurrence does.
    reset : callable or mapping, optional
        The state from which the run continues: ``reset(q, v) -> (q, v)``, or a mapping from the
        coordinates and velocities that change to expressions, ``{x.d: -x.d / 2, ...}``, which are
        compiled.  An event that ends the run is not reset.
    consistent : {"check", "project", "assume"}, optional
        The treatment of a state of ``reset`` that violates the constraint: raise an error
        (default), project its velocity, or use it.

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


@dataclass(frozen=True)
class Happened:
    """The events of a run, in the order of time.

    Attributes
    ----------
    count : int
        How many events there may be.
    events, t : ndarray, shape (K,)
        The number and the time of each.
    x, after : ndarray, shape (K, 2n)
        The states, and those after resets, NaN if there was none.
    """

    count: int
    events: Array
    t: Array
    x: Array
    after: Array


def take(given: Any) -> list[Event]:
    """Return the given events as `Event`; functions may have SciPy's attributes."""
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
            f"{name} = {one.g} is a condition: expected an expression that changes sign at "
            "the event, for example x - 1 for x > 1"
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
    """Return g as named expressions and the reset as a law; None if one is not an expression."""
    g = ((name, one.g),) if is_expression(one.g) else None
    is_mapping = isinstance(one.reset, Mapping)
    return g, reset_of(system, one.reset, name) if is_mapping else None


def along(system: System, scheme: Scheme) -> Any:
    """Return the model along whose motions events have series, None for other schemes."""
    return scheme._stepped(system)._model if scheme.family == "taylor" else None


def is_in_c(system: System, one: Event, name: str = "event") -> bool:
    """Return whether C detects an event and resets the state without Python."""
    g, reset = laws(system, one, name)
    if g is None or (one.reset is not None and reset is None):
        return False
    return are_compiled(system, g) and (reset is None or reset.is_compiled(system))


class Watch:
    """The events and output times of a run in C."""

    def __init__(
        self,
        system: System,
        stepper: Any,
        scheme: Scheme,
        events: Sequence[Event],
        times: Array | None,
    ) -> None:
        self.events, self.times = list(events), times
        self._happened = ffi.gc(
            ffi.new("dal_kept_events *", {"n": system.n}), lib.dal_kept_events_free
        )
        self.at = None if times is None else np.empty((len(times), 2 * system.n))
        rows = ffi.new("dal_event[]", max(len(events), 1))
        self._kept: list[Any] = []
        of = along(system, scheme)
        self._advice = "" if of else "; take a smaller h"
        for k, one in enumerate(events):
            self._fill(system, rows[k], one, f"events[{k}]", of)
        record, kept = scheme._record_of(system)
        self._kept.append(kept)
        self.handle = core.make(
            "events", stepper, record, rows, len(events), owner=(stepper, self._kept)
        )

    def _fill(self, system: System, row: Any, one: Event, name: str, of: Any) -> None:
        """Write the event for C, with series along motions of a model."""
        row.direction = int(np.sign(one.direction))
        row.terminal = int(one.terminal)
        row.consistency = CONSISTENCY[one.consistent]
        g, reset = laws(system, one, name)
        callables = core.Callables(system.n, system.m, g=one.g, reset=one.reset, name=name)
        context = ffi.new_handle(callables)
        self._kept += [callables, context]
        row.g, row.ctx = lib.dal_py_event, context
        if g is not None:
            row.g, row.ctx, kept, row.series = series(system, g, of)
            self._kept.append(kept)
        if reset is not None:
            law, kept = reset.in_c(system)
            row.reset, row.reset_ctx = ffi.addressof(lib, "dal_law_reset"), law
            self._kept += [law, kept]
        elif one.reset is not None:
            row.reset, row.reset_ctx = lib.dal_py_reset, context

    def join(self, run: Any) -> None:
        """Connect the watch with a ``dal_run``."""
        run.events = self.handle
        run.happened, run.happened_ctx = ffi.addressof(lib, "dal_keep_event"), self._happened
        if self.times is not None:
            run.times, run.time_count = core.pointer(self.times), len(self.times)
            run.x_at_times = core.pointer(self.at, output=True)

    @property
    def happened(self) -> Happened:
        """The events so far."""
        kept = self._happened
        count, n = int(kept.count), int(kept.n)
        states = core.doubles(kept.x, 4 * n * count).reshape(count, 2, 2 * n)
        numbers = np.frombuffer(ffi.buffer(kept.event, 8 * count)[:], dtype=np.uintp)
        return Happened(
            len(self.events), numbers, core.doubles(kept.t, count), states[:, 0], states[:, 1]
        )

    @property
    def last(self) -> int:
        """Number of the last event."""
        return int(self._happened.event[self._happened.count - 1])

    def doubts(self) -> Iterator[str]:
        """Yield messages about events that could not be decided."""
        if not self.events:
            return
        number, t, g = ffi.new("size_t *"), ffi.new("double *"), ffi.new("double *")
        if doubts := lib.dal_events_doubts(self.handle, number, t, g):
            often = "once" if doubts == 1 else f"{doubts} times"
            yield (
                f"events[{int(number[0])}] comes close to zero within a step, {often}, first "
                f"at t = {t[0]:g} with g = {g[0]:.3g}. The error of the step is larger, so "
                f"the run cannot decide whether the event happens{self._advice}"
            )


def split(happened: Happened) -> tuple[tuple[Array, ...], ...]:
    """Return times, states and states after resets of each event."""
    of = [happened.events == k for k in range(happened.count)]
    return tuple(
        tuple(np.ascontiguousarray(values[some]) for some in of)
        for values in (happened.t, happened.x, happened.after)
    )
