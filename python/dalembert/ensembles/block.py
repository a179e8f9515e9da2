"""Computation of a block of members, in C if possible, else one by one."""

from __future__ import annotations

import contextlib
import dataclasses
import threading
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from .. import core, geometry
from ..core import Array, DalembertError, arguments, ffi, lib
from ..core.errors import raised
from ..run import Solution, integrate
from ..run import events
from ..run.events import CONSISTENCY
from ..run.integration import SHORT, doubts, quietly
from ..run.laws import series
from ..run.options import in_c
from ..run.runs import OFF_D
from ..run.steps import Steps, how
from ..system import Expressions, System
from ..system.twins import twin
from .spec import MEASURES, TAKEN, EnsembleSpec, Output, Common

# What is kept of a `Statistics`, with what to say of it.
STATISTICS = {
    "iterations": np.int64,
    "full_newtons": np.int64,
    "halvings": np.int64,
    "corrections": np.int64,
    "worst_residual": np.float64,
    "initial_correction": np.float64,
    "jump_step": np.int64,
    "least_pivot": np.float64,
}

# Names that nothing else can have.
RESERVED = {*TAKEN, *STATISTICS, "q", "v", "file"}  # NumPy's savez has a file

_NEVER = np.int64(-1)  # no event has ended it

Block = dict[str, Any]  # arrays with a row for each member; and "messages", of those that failed
Show = Callable[[float], Any]


class Stopped(Exception):
    """The ensemble has to stop now."""


# ---- one block ---------------------------------------------------------------------------------


def make(
    common: Common, rows: Mapping[str, Array], count: int, stop: threading.Event, show: Show
) -> Block:
    """Compute a block of members, whose ``rows`` are those of `EnsembleSpec.block`.

    After ``stop``, members that are not computed have the status DAL_STOPPED.  ``show(done)`` is
    called several times a second with the number of members done.
    """

    def watch(far: float) -> None:
        if stop.is_set():
            raise Stopped
        show(far)

    if is_in_c(common):
        return _by_c(common, rows, count, watch)
    return _one_by_one(common, rows, count, watch)


def is_in_c(common: Common) -> bool:
    """Return whether C computes blocks without Python."""
    return (
        not common.system._source.calls_python
        and not common.system.positions
        and common.scheme._maps is None
        and common.output.reduce is None
        and not callable(common.options.inputs)
        and (common.options.inputs is None or common.options.inputs.is_compiled(common.system))
        and common.options.h != "reversible"  # whose doubts need the whole run
        and all(events.is_in_c(common.system, one) for one in common.events)
    )


def layout(common: Common, rows: int) -> dict[str, tuple[tuple[int, ...], Any, Any]]:
    """Return the shape, type and initial value of each array of a member."""
    n, m, kept = common.system.n, common.system.m, common.output
    found: dict[str, tuple[tuple[int, ...], Any, Any]] = {
        "status": ((), np.int32, lib.DAL_STOPPED),
        "done": ((), np.int64, 0),
        "t_end": ((), np.float64, np.nan),
        "doubtful": ((), np.bool_, False),
        **{name: ((), kind, name == "least_pivot") for name, kind in STATISTICS.items()},
    }
    if common.events:
        found["ended_by"] = (), np.int64, -1
        found["happened"] = (len(common.events),), np.int64, 0
    shape, intervals = ((), ()) if kept.at_end else ((rows,), (rows - 1,))
    shapes = {name: shape for name in (*kept.columns, "energy", "residual")}
    shapes |= {"multipliers": (*shape, m), "reactions": (*intervals, m),
               "states": (*shape, 2 * n)}  # fmt: skip
    names = (*kept.columns, *kept.measures, *["states"] * kept.states)
    return found | {name: (shapes[name], np.float64, np.nan) for name in names}


def empty(common: Common, rows: int, count: int) -> Block:
    """Return the initial arrays of so many members with so many rows each."""
    arrays = {
        name: np.full((count, *shape), value, kind)
        for name, (shape, kind, value) in layout(common, rows).items()
    }
    return {**arrays, "messages": {}}


# ---- in C --------------------------------------------------------------------------------------


def _by_c(common: Common, rows: Mapping[str, Array], count: int, watch: Show) -> Block:
    other = twin(common.system, _part(common)) if common.lanes else None
    if other is None:
        return _in_one_call(common, rows, count, watch)
    if isinstance(common.system._source, Expressions):
        return _in_one_call(common.having(system=other), rows, count, watch)
    # of a system that is written in C, what it refuses, and from what its members start
    kept = Output(at_end=True, states=True)
    start = dataclasses.replace(common, output=kept, stride=0, lanes=False)
    none = {**rows, "steps": np.zeros(1, np.int64)}
    begun = _in_one_call(start, none, count, watch)
    common = common.having(system=other, consistent="assume")
    made = _in_one_call(common, {**rows, "x": begun["states"]}, count, watch)
    made["initial_correction"] = begun["initial_correction"]
    for k, text in begun["messages"].items():
        made["status"][k], made["messages"][k] = begun["status"][k], text
    return made


def without_lanes(common: Common, has_inputs: bool) -> str:
    """Return why members cannot be advanced side by side, "" if they can."""
    hold, least = common.options.hold or 1, lib.DAL__LANES_INPUT_STEPS
    scheme = common.scheme
    if scheme.nodes != "moved" or scheme.family not in ("beta", "taylor"):
        return f"the scheme {scheme.name!r} has kept nodes or no sub-steps"
    given = {"events": common.events, "energy": common.options.energy}
    if common.varies:
        return f"with h = {common.options.h!r} each member has its own step size"
    if there := [name for name, value in given.items() if value]:
        return f"{there[0]} are checked for each member"
    if not is_in_c(common):
        return "Python functions are called for each member"
    if has_inputs and (common.options.inputs is not None or common.system.is_driven):
        return "inputs are functions, or enter constraints"
    if has_inputs and scheme.family == "taylor":
        return "inputs change the series of each member"
    if has_inputs and hold < least:
        return f"inputs last {hold} steps (hold), and lanes need at least {least}"
    other = twin(common.system, _part(common))
    if other is None:
        return (
            f"the system {common.system.name!r} needs formulas"
            + " and at most 8 coordinates" * (scheme.family == "beta")
        )
    if scheme.family == "taylor" and lib.dal_system_has_series(other._handle) < 2:
        return f"the system {common.system.name!r} has kinks or jumps, or no basis of D"
    return ""


def _part(common: Common) -> str:
    """Return the part of `codegen.program` by which several members are advanced at once."""
    return "four series" if common.scheme.family == "taylor" else "lanes"


def _in_one_call(common: Common, rows: Mapping[str, Array], count: int, watch: Show) -> Block:
    system, kept = common.system, common.output
    made = empty(common, common.rows(rows["steps"]), count)
    members, alive = _members(common, rows, count, made)
    record, record_kept = common.scheme._record_of(system)
    handle, options = common.scheme._stepped(system)._handle, in_c(common.options.of_c)
    error, context = ffi.new("dal_error *"), ffi.new_handle(watch)
    status = core.attempt(
        lib.dal_ensemble_run, handle, record, options, members, 0, count,
        lib.dal_py_watch, context, error,
    )  # fmt: skip
    if status != lib.DAL_SUCCESS and not isinstance(raised.exception, Stopped):
        raise core.failure(status, core.words(error, system.kind))
    raised.exception = None
    for name, place in kept.columns.items():
        made[name] = alive["states"][..., place].copy()
    if "ended_by" in made:
        made["ended_by"][made["ended_by"] == len(common.events)] = -1
    stats = alive["stats"]
    for name in STATISTICS:
        made[name] = stats[name].astype(STATISTICS[name])
    for k in map(int, np.flatnonzero(made["status"] < 0)):
        error = _refused(system, rows, k) if np.isnan(made["t_end"][k]) else None
        if error is None:
            status, words = int(made["status"][k]), core.words(alive["errors"] + k, system.kind)
            error = core.failure(status, words + OFF_D * (status == lib.DAL_EOFFD))
        made["status"][k], made["messages"][k] = status_of(error), _message(error)
    _doubt(common, rows, stats, alive["doubts"], made)
    del record_kept
    return made


def _refused(system: System, rows: Mapping[str, Array], k: int) -> Exception | None:
    """Return the error in the parameters of a member, or None."""
    try:
        _with_parameters(system, rows, k)
    except Exception as error:
        return error
    return None


def _with_parameters(system: System, rows: Mapping[str, Array], k: int) -> System:
    """Return the system of a member."""
    if "parameters" not in rows:
        return system
    values = rows["parameters"][k % len(rows["parameters"])].tolist()
    return system.with_parameters(**dict(zip(system.parameters, values)))


def _members(
    common: Common, rows: Mapping[str, Array], count: int, made: Block
) -> tuple[Any, dict[str, Any]]:
    """Return the ``dal_members``, and the objects that have to stay alive, by name."""
    system, kept = common.system, common.output
    given = {name: x for name, x in rows.items() if name != "steps"}
    steps = rows["steps"][: 1 if common.stride else None].astype(np.uintp)
    members = ffi.new("dal_members *")
    for name, x in given.items():
        setattr(members, name, core.pointer(x))
        size = x.nbytes if name == "parameters" else x.size
        setattr(members, f"{name}_next", 0 if len(x) == 1 and count > 1 else size // len(x))
    members.steps = ffi.from_buffer("size_t[]", steps)
    members.steps_next = int(len(steps) > 1)
    asked = common.options
    members.count, members.t0 = count, asked.t0
    if common.varies:
        sizes = Steps.of(asked)
        members.until, members.input_duration = sizes.t_end, sizes.direction * (asked.hold or 0.0)
    else:
        members.input_steps = asked.hold or 1
    members.stride, members.lanes = common.stride, int(common.lanes)
    members.consistency = CONSISTENCY[asked.consistent]
    members.initial = common.scheme._initial(asked.initial)
    states = made.get("states")
    if states is None and kept.columns:
        shape = made[next(iter(kept.columns))].shape
        states = np.empty((*shape, 2 * system.n))
    if states is not None:
        members.states = core.pointer(states, output=True)
    for name in kept.measures:
        setattr(members, name, core.pointer(made[name], output=True))
    members.t_end = core.pointer(made["t_end"], output=True)
    members.status = ffi.from_buffer("int[]", made["status"], True)
    stats = np.zeros(count, _stats_type())
    members.stats = ffi.from_buffer("dal_stats[]", stats, True)
    doubts_of = np.zeros(count, np.uintp)
    errors = ffi.new("dal_error[]", count)
    members.errors = errors
    buffers = {"done": made["done"], "doubts": doubts_of}
    listed, resets, alive_events = _events(common)
    if asked.inputs is not None:
        law, kept_law = asked.inputs.in_c(common.system)
        law.ctx = ffi.NULL  # the parameters of each member
        members.control = law
        alive_events.append((law, kept_law))
    if common.events:
        members.events, members.event_count = listed, len(common.events)
        members.resets = resets
        buffers |= {"happened": made["happened"], "ended_by": made["ended_by"]}
    for name, x in buffers.items():
        setattr(members, name, ffi.from_buffer("size_t[]", x, True))
    return members, {
        "given": given, "steps": steps, "states": states, "stats": stats, "doubts": doubts_of,
        "errors": errors, "events": (listed, resets, alive_events),
    }  # fmt: skip


def _events(common: Common) -> tuple[Any, Any, list[Any]]:
    """Return the ``dal_event[]`` and their resets, with the parameters of each member."""
    found = ffi.new("dal_event[]", max(1, len(common.events)))
    resets = ffi.new("dal_law[]", max(1, len(common.events)))
    alive = []
    of = events.along(common.system, common.options.scheme)
    for k, one in enumerate(common.events):
        g, reset = events.laws(common.system, one, f"events[{k}]")
        found[k].g, _, kept, found[k].series = series(common.system, g, of)
        if reset is not None:
            law, kept_law = reset.in_c(common.system)
            resets[k] = law[0]
            resets[k].ctx = ffi.NULL  # as that of g
            alive.append((law, kept_law))
        found[k].direction, found[k].terminal = int(np.sign(one.direction)), int(one.terminal)
        found[k].consistency = CONSISTENCY[one.consistent]
        alive.append(kept)
    return found, resets, alive


def _stats_type() -> np.dtype[Any]:
    """Return the NumPy type of ``dal_stats``."""
    fields = ffi.typeof("dal_stats").fields
    kinds = {"size_t": np.uintp, "double": np.float64, "unsigned int": np.uintc}
    return np.dtype({
        "names": [name for name, _ in fields],
        "formats": [kinds[field.type.cname] for _, field in fields],
        "offsets": [field.offset for _, field in fields],
        "itemsize": ffi.sizeof("dal_stats"),
    })


def _doubt(
    common: Common, rows: Mapping[str, Array], stats: Any, doubts_of: Array, made: Block
) -> None:
    """Mark members whose run deserves a warning."""
    control = common.options.control
    system, names = common.system, {*MEASURES} & {*common.output.measures}
    suspect = (
        (stats["jump_step"] > 0)
        | (stats["unscaled"] > 0)
        | (stats["full_newtons"] * 10 > stats["substeps"])
        | (stats["rank_doubts"] > 0)
        | (stats["least_step"] < SHORT)
        | (stats["worst_residual"] > core.residual_bound(system.n))
        | (stats["uncontrolled"] * 20 > stats["steps"])
    )
    made["doubtful"] = doubts_of > 0
    for name in names:
        lacks = np.isnan(made[name]).reshape(len(stats), -1).any(axis=1)
        made["doubtful"] |= lacks & (made["status"] == 0) & (made.get("ended_by", _NEVER) < 0)
    for k in np.flatnonzero(suspect & (made["status"] == 0)):
        of = SimpleNamespace(**{name: stats[name][k] for name in stats.dtype.names})
        h = float(rows["h"][k % len(rows["h"])])
        run = SimpleNamespace(
            system=system, stats=of, h=h, t0=common.options.t0, control=control,
            _how=how(h, control),
        )  # fmt: skip
        made["doubtful"][k] |= any(True for _ in doubts(run))


# ---- one by one --------------------------------------------------------------------------------


def one(common: Common, rows: Mapping[str, Array], k: int, **how: Any) -> Solution:
    """Return the run of member k of a block, as from `integrate`."""
    mine = {name: x[k % len(x)] for name, x in rows.items()}
    options = vars(common.options) | {"system": _with_parameters(common.system, rows, k)}
    if not common.varies:
        options |= {"h": float(mine["h"]), "steps": int(mine["steps"])}
    if "x" in mine:
        options["q0"], options["v0"] = np.split(mine["x"], 2)
    if "inputs" in mine:
        options["inputs"] = mine["inputs"]
    return integrate(**options | how)


def _one_by_one(common: Common, rows: Mapping[str, Array], count: int, watch: Show) -> Block:
    made = empty(common, common.rows(rows["steps"]), count)
    for k in range(count):
        def progress(done: int, total: int, k: int = k) -> None:
            watch(k + done / max(total, 1))

        try:
            watch(k)
            _keep(common, made, k, rows, progress)
        except Stopped:
            break
        except Exception as error:  # of a member: its entry
            made["status"][k] = status_of(error)
            made["messages"][k] = _message(error)
    return made


def _keep(
    common: Common, made: Block, k: int, rows: Mapping[str, Array], progress: Any
) -> None:
    """Compute member k, and write its results."""
    kept, reached = common.output, None
    stride = common.stride or max(1, int(rows["steps"][k % len(rows["steps"])]))
    check_h = None if common.varies else False
    with quietly() as found:
        try:
            run = one(common, rows, k, stride=stride, progress=progress, check_h=check_h)
        except Exception as error:
            if not isinstance(partial := getattr(error, "partial", None), Solution):
                raise
            run, reached = partial, getattr(error, "t", None)
            _count(common, made, k, run, reached)
            if not isinstance(error, DalembertError):  # a function of the user has raised
                raise
    _count(common, made, k, run, reached)
    made["doubtful"][k] = bool(found)
    for name in STATISTICS:
        made[name][k] = getattr(run.stats, name)
    made["status"][k] = run.status
    if run.status < 0:
        made["messages"][k] = run.message
    else:
        made["status"][k] = lib.DAL_SUCCESS
    if kept.reduce is not None:
        if run.status >= 0:
            _reduce(kept.reduce(run), made, k, len(made["status"]))
        return
    is_over = run.status >= 0
    arrays = {name: _measured(run, name) for name in kept.measures}
    arrays |= {name: run.x[:, place] for name, place in kept.columns.items()}
    if kept.states:
        arrays["states"] = run.x
    for name, values in arrays.items():
        undefined = name in MEASURES and np.isnan(values).any()
        made["doubtful"][k] |= undefined and is_over
        if not kept.at_end:
            made[name][k, : len(values)] = values
        elif is_over and len(values):
            made[name][k] = values[-1]


def _measured(run: Solution, name: str) -> Array:
    """Return a quantity of the rows of a run, NaN if undefined."""
    try:
        return getattr(run, name)  # type: ignore[no-any-return]
    except (DalembertError, ArithmeticError, ValueError):
        shape = (run.system.m,) if name == "multipliers" else ()
        values = np.full((len(run.t), *shape), np.nan)
    output, shift = ("relative", run.shift) if name == "residual" else (name, 0.0)
    inputs = run._inputs_of_rows()
    for k, t in enumerate(run.t.tolist()):
        with contextlib.suppress(DalembertError, ArithmeticError, ValueError):
            values[k] = geometry.trajectory(
                run.system, run.x[k : k + 1], output, t0=t, shift=shift, inputs=inputs[k : k + 1]
            )[0]
    return values


def _count(common: Common, made: Block, k: int, run: Solution, reached: float | None) -> None:
    """Write the progress of a run, which failed if it reached a time."""
    made["done"][k] = run.stats.steps
    made["t_end"][k] = run.t[-1] if run.times is not None else run.t0 + run.stats.steps * run.h
    if common.varies and reached is not None:
        made["t_end"][k] = reached
    for i, times in enumerate(run.t_events):
        made["happened"][k, i] = len(times)
    if run.status == lib.DAL_STOPPED:
        made["ended_by"][k] = _ended_by(common, run)


def _ended_by(common: Common, run: Solution) -> int:
    """Return the number of the terminal event that ended the run."""
    last = [times[-1] if len(times) else -np.inf for times in run.t_events]
    ends = [
        k for k, (one_, times) in enumerate(zip(common.events, run.t_events))
        if one_.terminal and len(times) >= int(one_.terminal) and times[-1] == run.t[-1]
    ]  # fmt: skip
    return ends[0] if ends else int(np.argmax(last))


def _reduce(value: Any, made: Block, k: int, count: int) -> None:
    """Write the result of a function of a run."""
    found = value if isinstance(value, Mapping) else {"value": value}
    for name, given in found.items():
        if not (isinstance(name, str) and name.isidentifier()) or name in RESERVED:
            raise ValueError(f"keep returned the name {name!r}: expected an unused identifier")
        shape = arguments.shape(given)
        if not isinstance(shape, tuple):
            raise ValueError(f"keep returned {name!r} as {shape}: expected a number or an array")
        x = arguments.returned(given, shape, f"keep ({name})")
        if name not in made:
            made[name] = np.full((count, *x.shape), np.nan)
        if made[name].shape[1:] != x.shape:
            raise ValueError(
                f"keep returned {name!r} of shape {x.shape}, but of shape "
                f"{made[name].shape[1:]} for another member: expected the same shape"
            )
        made[name][k] = x


def _message(error: BaseException) -> str:
    """Return the message for an exception, as in a `Solution`."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # of a user's exception that cannot be shown
        return type(error).__name__


def status_of(error: BaseException) -> int:
    """Return the status of an exception."""
    if isinstance(error, DalembertError):
        return int(error.status)
    kinds = {
        MemoryError: lib.DAL_ENOMEM, NotImplementedError: lib.DAL_EUNSUPPORTED,
        ValueError: lib.DAL_EINVAL,
    }  # fmt: skip
    return int(next((x for kind, x in kinds.items() if isinstance(error, kind)), lib.DAL_EUSER))


def member(spec: EnsembleSpec, k: int, **how: Any) -> Solution:
    """Compute the run of a member again."""
    return one(spec.common, spec.block(k, k + 1), 0, **how)
