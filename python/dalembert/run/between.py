"""States between the stored ones of a run, by steps of its scheme.

Used if the step size varies, if there are inputs, and for Taylor series, which are as exact there.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .. import core
from ..core import Array, lib
from .options import in_c


def fill(run: Any, times: Array, x: Array) -> None:
    """Write the states of a `Solution` at the times into x, shape (N, 2n).

    Steps start from the last known state before each time: a row, or the state after a reset.
    """
    known, states = _known(run)
    ahead = -1.0 if known[-1] < known[0] else 1.0
    for end in known[[0, -1]]:  # a grid of the user's may have rounded them otherwise
        times = np.where(np.abs(times - end) <= 4 * np.spacing(np.abs(end)), end, times)
    places = np.searchsorted(ahead * known, ahead * times, side="right") - 1
    outside = (places < 0) | (ahead * (times - known[-1]) > 0)
    if outside.any():
        t, first, last = float(times[outside][0]), float(known[0]), float(known[-1])
        raise ValueError(f"t = {t!r}: expected times from {first!r} to {last!r}")
    if run.nodes == "kept":
        raise ValueError(
            f"t: no states are computed between those of {run.scheme.name!r} with inputs; "
            "expected times of stored states"
        )
    is_series = run.scheme.family == "taylor"
    control = {"h": "own"} if is_series else run.control
    record, kept = run.scheme._record_of(run.system)
    handle = run.scheme._stepped(run.system)._handle
    stepper = core.make("stepper", handle, record, in_c(control), owner=(handle, kept))
    changes = _changes(run, known)
    rows = dict(zip(run.t.tolist(), run.x))  # which come back as they are
    from_row = None  # of the stepper
    for k in np.argsort(ahead * times, kind="stable"):
        place, t = places[k], float(times[k])
        x[k] = rows.get(t, states[place])
        if t == known[place]:
            continue
        if is_series and place == from_row and not len(run.inputs):
            x[k] = _lead(run, stepper, t)  # a step has many states
        else:
            x[k] = _reach(run, stepper, control, changes, float(known[place]), states[place], t)
        from_row = place


def _known(run: Any) -> tuple[Array, Array]:
    """Return the times and the states of rows and after resets, in the order of the run."""
    again = [~np.isnan(after).any(axis=1) for after in run.x_after]
    t = np.concatenate([run.t, *(t[some] for t, some in zip(run.t_events, again))])
    x = np.concatenate([run.x, *(x[some] for x, some in zip(run.x_after, again))])
    ahead = -1.0 if run.t[-1] < run.t[0] else 1.0
    order = np.argsort(ahead * t, kind="stable")  # at one time that after the reset is the last
    return t[order], x[order]


def _changes(run: Any, known: Array) -> Array:
    """Return the times at which rows of inputs begin."""
    if not run.control:  # a hold is so many steps
        return run.t0 + np.arange(len(run.inputs)) * int(run.hold) * run.h
    ahead = -1.0 if known[-1] < known[0] else 1.0
    return run.t0 + ahead * run.hold * np.arange(len(run.inputs))


def _reach(
    run: Any, stepper: Any, control: dict[str, Any], changes: Array, t: float, x: Array, end: float
) -> Array:
    """Return the state at time ``end``, by steps from x at t."""
    kind, ahead = run.system.kind, 1.0 if end > t else -1.0
    by_motion = control.get("h") in ("own", "reversible")  # whose first step is found by itself
    slack = 4 * np.spacing(max(abs(t), abs(end)))  # so near a change is at t, or at the end
    passed = changes[(ahead * (changes - t) > slack) & (ahead * (end - changes) > slack)]
    for until in [*passed.tolist(), end]:
        row = max(np.searchsorted(ahead * changes, ahead * t + slack, side="right") - 1, 0)
        if len(run.inputs):  # the state may lie in the D of those before
            row_before = max(row - run.system.is_driven, 0)
            core.call(kind, lib.dal_stepper_input, stepper, run.inputs[row_before].copy())
        pieces = 1 if control else math.ceil(abs((until - t) / run.h) * (1 - 1e-9))
        core.call(
            kind, lib.dal_stepper_start, stepper, t,
            ahead * np.inf if by_motion else (until - t) / pieces, x,
            lib.DAL_ASSUME, lib.DAL_INITIAL_NONE,
        )  # fmt: skip
        if run.system.is_driven and len(run.inputs):
            core.call(kind, lib.dal_stepper_input, stepper, run.inputs[row].copy())
        if control:
            x = _lead(run, stepper, until)
        else:
            core.call(kind, lib.dal_advance, stepper, pieces, core.ffi.NULL, core.ffi.NULL)
            x = core.doubles(lib.dal_stepper_state(stepper), 2 * run.system.n)
        t = until
    return x


def _lead(run: Any, stepper: Any, end: float) -> Array:
    """Return the state at time ``end``, by steps of variable size from where the stepper is."""
    kind = run.system.kind
    core.call(kind, lib.dal_stepper_until, stepper, end)
    while lib.dal_stepper_time(stepper) != end:
        core.call(kind, lib.dal_step, stepper, core.ffi.NULL)
    return core.doubles(lib.dal_stepper_state(stepper), 2 * run.system.n)
