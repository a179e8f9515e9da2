"""Ensembles, from arguments or from a store."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import time
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from .. import core
from ..core import Array, DalembertWarning, extras, lib, require_system
from ..core.memory import require_memory
from ..core.records import options_of, takes
from ..run.events import CONSISTENCY, Event
from ..run.events import laws as events_of
from ..run.integration import with_method
from ..run.journal import of_system, require_same
from ..run.laws import Law, is_control, take_inputs
from ..run.options import IntegrateOptions, in_c
from ..run.runs import started_stepper
from ..run.scheme import Scheme
from ..run.steps import MOST, Steps
from ..system import System, require_parameters
from . import block, executors
from . import store as stores
from .functions import digest
from .result import Ensemble, Memory, Stored
from .spec import (
    Broadcast,
    Common,
    EnsembleOptions,
    EnsembleSpec,
    Output,
    axes_of,
    broadcast,
    members_shape,
    read_members,
)
from .store import StoreError

_THREAD_SECONDS = 0.05  # of a block that a thread makes: short, so that all end together
_TASK_SECONDS = 2.0  # of one that is sent elsewhere, or written to a store
_MOST_BYTES, _MOST = 2**26, 100_000  # of a block, members
_LANES = 16  # members that are stepped at once, at most: fewer in a block would leave lanes empty
_MOST_BLOCKS = 100_000  # what schedulers and file systems bear


@takes(EnsembleOptions)
def ensemble(*args: Any, **given: Any) -> Ensemble:
    """Integrate many runs of a system with other initial data, parameters or step sizes.

    Each member gives bitwise the same result as its own `integrate` call, on any number of threads
    or machines.  Initial data, parameters, step sizes and inputs may differ between members; all
    other options are the same.  A member that fails is recorded with its error message.

    Returns
    -------
    Ensemble

    Raises
    ------
    ValueError
        If an argument is out of range, or a number is not finite.  The message names it.  An error
        of one member, such as initial data off D or a parameter out of range, is recorded instead.
    StoreError
        If a file of the store is damaged, or belongs to another ensemble.
    KeyboardInterrupt
        On Ctrl-C; ``.partial`` has the results so far.

    Warns
    -----
    DalembertWarning
        If `integrate` would warn of some members, or if ``lanes`` has no effect.

    Notes
    -----
    C computes a block without the interpreter's lock, unless the system, events, controllers or
    ``keep`` are Python functions.  With Python functions members are computed one by one.

    Examples
    --------
    >>> import dalembert as dal
    >>> many = dal.ensemble(dal.systems.sleigh(), parameters=dal.grid(a=[0.1, 0.2], J=[1, 2, 3]),
    ...                     h=0.01, t_end=1, progress=False)
    >>> many.q.shape, many.shape
    ((6, 3), (2, 3))
    >>> bool((many.member(4).q[-1] == many.q[4]).all())
    True
    """
    asked = EnsembleOptions.of("ensemble", args, given)
    spec, executor, path = _spec(asked), asked.executor, asked.store
    if asked.lanes and (why := block.without_lanes(spec.common, asked.inputs is not None)):
        warnings.warn(
            f"lanes = True has no effect, because members are stepped one by one: {why}",
            DalembertWarning, stacklevel=2,
        )  # fmt: skip
        spec = replace(spec, common=replace(spec.common, lanes=False))
    if executor is not None and asked.threads is not None:
        raise ValueError(
            f"threads = {asked.threads} is given together with an executor: expected one of the two"
        )
    path, threads = None if path is None else _folder(path), executors.threads_of(asked.threads)
    is_sent = path is not None or executor is not None
    pieces = executors.Blocks(spec, asked.block or _size(spec, is_sent))
    data: Memory | Stored
    if path is None:
        size, rows = _bytes_of_member(spec) * spec.count, f"members of {spec.rows} rows"
        require_memory(size, f"{spec.count} {rows}", "keep fewer quantities, or pass store=")
        data = Memory(spec, pieces.size)
    else:
        about = _about(spec, pieces.size)
        there = stores.create(path, about, spec.arrays())
        require_same(asked.system, there["system"], path)
        pieces.size = there["block"]
        data = Stored(path, about["mark"], spec, pieces.size)
    left = [k for k in range(len(pieces)) if not data.has(k)]
    before = spec.count - sum(end - begin for begin, end in map(pieces.range, left))
    wanted = asked.progress is not True or extras.is_there("tqdm")
    try:
        with extras.progress(wanted and asked.progress, spec.count, "member") as show:
            def tell(done: float) -> None:
                show(min(before + int(done), spec.count))

            if executor is None:
                executors.by_threads(pieces, left, data, tell, threads)
            else:
                executors.by_executor(executor, pieces, left, data, tell)
            show(spec.count)
    except BaseException as error:
        with contextlib.suppress(AttributeError, TypeError):
            error.partial = Ensemble(spec, data)  # type: ignore[attr-defined]
        raise
    if path is not None:
        stores.tidy(path)
    found = Ensemble(spec, data)
    _warn(found)
    return found


def _folder(path: str | os.PathLike[str]) -> str:
    """Return the absolute path of a store."""
    found = os.fspath(path)
    if not isinstance(found, str) or not found:
        raise ValueError(f"store = {path!r}: expected the name of a directory")
    return os.path.abspath(found)


def open_ensemble(path: str | os.PathLike[str], system: System | None = None) -> Ensemble:
    """Return the ensemble in a store, finished or not.

    Arrays are read on first use.

    Parameters
    ----------
    path : str or path
        The directory.
    system : System, optional
        The system of the ensemble; not needed if it comes with the library.

    Raises
    ------
    ValueError
        If there is no store, or it belongs to another version or system.
    StoreError
        If a file is damaged, or belongs to another ensemble.

    Examples
    --------
    >>> import os, tempfile
    >>> import dalembert as dal
    >>> path = os.path.join(tempfile.mkdtemp(), "sweep")
    >>> many = dal.ensemble(dal.systems.sleigh(), parameters={"a": [0.1, 0.2]}, h=0.01, steps=10,
    ...                     store=path, progress=False)
    >>> bool((dal.open_ensemble(path).q == many.q).all())
    True
    """
    path = _folder(path)
    about = stores.read_about(path)
    arrays = stores.read_members(path, about["mark"])
    if about["mark"] != _mark(about, arrays):
        raise StoreError(f"{path}: the arguments of the members differ from those in the store")
    spec = _spec_of(about, arrays, require_same(system, about["system"], path))
    return Ensemble(spec, Stored(path, about["mark"], spec, about["block"]))


# ---- arguments -----------------------------------------------------------------------------------


def _spec(given: EnsembleOptions) -> EnsembleSpec:
    """Return the definition of an ensemble, or raise ValueError."""
    require_system(given.system)
    output = Output.of(given.keep, given.system)
    asked = given.read()
    system, scheme, control = asked.system, asked.scheme, asked.control
    assert isinstance(scheme, Scheme)
    many: list[Steps] = []
    if control:
        many.append(Steps.of(asked))
        sizes, number = np.array(many[0].first), np.array(MOST)
    else:
        sizes = broadcast(asked.h, "h").values
        different = np.unique(sizes)
        many += [Steps.of(asked.having(h=h)) for h in different.tolist()]
        number = np.array([one.count for one in many])[np.searchsorted(different, sizes)]
        scheme = with_method(scheme, asked.method, asked.tolerance)
    counts = [one.count for one in many]
    stride = _stride(asked.stride, output, many)
    inputs = take_inputs(system, asked.inputs)
    hold = None if inputs is None else many[0].hold(asked.hold, inputs)
    if inputs is not None and not is_control(inputs) and len(set(counts)) > 1:
        raise ValueError(
            "inputs: the numbers of steps differ between members; expected a function, or the "
            "same number of steps"
        )
    members = read_members(asked, inputs, many[0].holds(hold or 1))
    require_parameters(system.name, members["parameters"], system.parameters)
    values = {k: x for k, x in members.items() if k != "parameters"}
    values |= {f"parameters[{k!r}]": x for k, x in members["parameters"].items()}
    shape = members_shape(values | {"h": Broadcast(sizes)}) or (1,)
    names, ticks = axes_of(shape, asked.axes, asked.parameters)
    shared = {name: x for name, x in vars(asked).items() if name in options_of(IntegrateOptions)}
    of_members: dict[str, Any] = {} if control else dict.fromkeys(
        ("h", "t_end", "steps", "tolerance", "method")
    )
    shared |= dict.fromkeys(("q0", "v0", "stride")) | of_members
    shared |= {"scheme": scheme, "inputs": inputs if is_control(inputs) else None, "hold": hold,
               "events": tuple(asked.events), "progress": False}  # fmt: skip
    common = Common(IntegrateOptions(**shared), stride, output, bool(asked.lanes))
    return EnsembleSpec(
        common=common, shape=shape, axes=names, ticks=ticks, h=Broadcast(sizes),
        steps=Broadcast(number), **members,
    )  # fmt: skip


def _stride(stride: int | None, output: Output, many: list[Steps]) -> int:
    """Return the stride, 0 if only the end is kept."""
    if output.at_end:
        if stride is not None:
            raise ValueError(
                f"stride = {stride}: not used, because only the end is kept; remove it"
            )
        return 0
    if output.reduce is None and (many[0].varies or len({one.count for one in many}) > 1):
        raise ValueError(
            "keep: the numbers of rows differ between members; expected 'end', or a function "
            "of a Solution"
        )
    return max(one.stride(stride) for one in many)


# ---- blocks --------------------------------------------------------------------------------------


def _bytes_of_member(spec: EnsembleSpec) -> int:
    """Return the approximate size of the results of a member in bytes."""
    parts = block.layout(spec.common, spec.rows).values()
    return sum(math.prod(shape) * np.dtype(kind).itemsize for shape, kind, _ in parts)


def _size(spec: EnsembleSpec, is_sent: bool) -> int:
    """Return the number of members of a block."""
    seconds = _TASK_SECONDS if is_sent else _THREAD_SECONDS
    wanted = max(seconds / _seconds_of_member(spec), _LANES if spec.common.lanes else 0)
    wanted = min(wanted, _MOST_BYTES / _bytes_of_member(spec), _MOST)
    least = -(-spec.count // _MOST_BLOCKS) if is_sent else 1
    return max(least, min(int(wanted), spec.count))


def _seconds_of_member(spec: EnsembleSpec) -> float:
    """Return the approximate time for a member in seconds, from some steps of the first."""
    common, rows = spec.common, spec.block(0, 1)
    asked, steps, part, piece, elapsed = common.options, int(rows["steps"][0]), 0.0, 1, 1e-6
    span = asked.t_end - asked.t0 if common.varies else steps
    if not block.is_in_c(common):
        return 0.1 if common.varies else 2e-4 + 5e-5 * steps  # functions are called
    with contextlib.suppress(Exception):  # it may fail, as any other
        stepper = started_stepper(
            common.system, common.scheme, _first_state(spec), t0=asked.t0,
            h=float(rows["h"][0]),
            consistency=CONSISTENCY["project"], options=in_c(asked.of_c),
            initial=common.scheme._initial(asked.initial),
        )  # fmt: skip
        began = time.perf_counter()

        def enough(t: float) -> None:
            if time.perf_counter() - began > 0.05:
                raise TimeoutError  # a step that takes long

        context = core.ffi.new_handle(enough)
        given = {"stepper": stepper, "steps": steps, "stride": steps, "until": asked.t_end or 0.0}
        run = core.ffi.new("dal_run *", {**given, "unchecked": 1})
        run.watch, run.watch_ctx = lib.dal_py_watch, context
        while part < 1.0 and elapsed < 2e-3:
            status = core.attempt(lib.dal_run_go, run, piece)
            elapsed, piece = time.perf_counter() - began, 2 * piece
            if status:
                raise core.failure(status)
            far = lib.dal_stepper_time(stepper) - asked.t0 if common.varies else int(run.done)
            part = far / span
    return 1e-6 + elapsed / max(part, 1e-3 if common.varies else 1.0 / max(steps, 1))


def _first_state(spec: EnsembleSpec) -> Array:
    """Return the initial data of the first member."""
    rows, system = spec.block(0, 1), spec.common.system
    if "x" in rows:
        return rows["x"][0]
    return np.concatenate([system.q0, system.v0])


def _warn(found: Ensemble) -> None:
    """Warn of members that failed or are doubtful."""
    failed, doubtful = found.failed, np.flatnonzero(found["doubtful"])
    if len(failed):
        first = int(failed[0])
        warnings.warn(
            f"{len(failed)} of {len(found)} members failed, see failed and message(k); the "
            f"first is member {first}: {found.message(first)}", DalembertWarning, stacklevel=3,
        )  # fmt: skip
    if len(doubtful):
        warnings.warn(
            f"{len(doubtful)} of {len(found)} members are doubtful, see doubtful; "
            f"member({int(doubtful[0])}) gives the reason", DalembertWarning, stacklevel=3,
        )  # fmt: skip


# ---- the store -----------------------------------------------------------------------------------


def _about(spec: EnsembleSpec, size: int) -> dict[str, Any]:
    """Return data for JSON that identify an ensemble."""
    common = spec.common
    scheme, output, control = common.scheme._data(), common.output, common.options.inputs
    if scheme is None:
        raise ValueError(
            f"store: the scheme {common.scheme.name!r} is made of functions, which a store "
            "cannot save"
        )
    events = [
        [str(one.g) if hasattr(one.g, "free_symbols") else digest(one.g), float(one.direction),
         int(one.terminal), _told_reset(common.system, one), one.consistent]
        for one in common.events
    ]  # fmt: skip
    named = common.system._source.named()
    about = {
        "dalembert": core.version(),
        "system": of_system(common.system, _first_state(spec), common.options.t0),
        "scheme": scheme,
        "shape": list(spec.shape),
        "axes": list(spec.axes),
        "ticks": {name: x.tolist() for name, x in spec.ticks.items()},
        "options": common.options.numbers,
        "stride": common.stride,
        "keep": [output.at_end, output.states, list(output.measures), dict(output.columns),
                 digest(output.reduce)],
        "functions": {name: digest(f) for name, f in named.items() if f is not None},
        "events": events,
        "control": control.about(common.system) if isinstance(control, Law) else digest(control),
        "lanes": common.lanes,
    }  # fmt: skip
    mark = _mark(about, spec.arrays())
    return about | {"mark": mark, "block": size, "seal": stores.seal(mark, size)}


def _told_reset(system: System, one: Event) -> str:
    """Return a digest of the reset of an event, "" if it has none."""
    _, law = events_of(system, one, "events")
    return digest(one.reset) if law is None else str(law.about(system)["key"])


def _mark(about: Mapping[str, Any], arrays: Mapping[str, Array]) -> str:
    """Return a digest of an ensemble and of the values for its members."""
    system = [about["system"][key] for key in ("name", "identity")]
    told = {key: x for key, x in about.items() if key not in _NOT_TOLD} | {"system": system}
    whole = hashlib.sha256(json.dumps(told, sort_keys=True).encode())
    for name, x in sorted(arrays.items()):
        whole.update(f"{name} {x.dtype} {x.shape}".encode())
        whole.update(np.ascontiguousarray(x))
    return whole.hexdigest()


_NOT_TOLD = ("format", "version", "mark", "block", "seal")


def _spec_of(about: Mapping[str, Any], arrays: Mapping[str, Array], system: System) -> EnsembleSpec:
    """Return the definition in a store, which does not keep functions."""
    at_end, states, measures, columns, reduce = about["keep"]
    lacks = {"events": about["events"], "inputs": about["control"], "keep": reduce}
    options = {"h": None, "scheme": Scheme._from_data(about["scheme"]), **about["options"]}
    common = Common(
        IntegrateOptions(system, **options), about["stride"],
        Output(at_end, states, tuple(measures), columns), about["lanes"],
    )  # fmt: skip
    return EnsembleSpec.of_arrays(
        arrays, common=common, shape=tuple(about["shape"]), axes=tuple(about["axes"]),
        ticks={name: np.array(x) for name, x in about["ticks"].items()},
        lacks=tuple(name for name, there in lacks.items() if there),
    )  # fmt: skip
