"""Ensembles, from arguments or from a store."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
import os
import time
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import core
from ..core import Array, DalembertWarning, arguments, extras, lib, require_system
from ..core.extras import Progress
from ..run.events import CONSISTENCY, Event
from ..run.events import laws as events_of
from ..run.events import take as take_events
from ..core.memory import available_memory
from ..run.integration import with_method
from ..run.options import kind_of, require
from ..run.steps import number_of_steps, options_of
from ..run.journal import of_system, require_same
from ..run.laws import Law, is_control, take_inputs
from ..run.runs import started_stepper
from ..run.scheme import Scheme
from ..system import System, require_parameters
from . import pool, work
from . import store as stores
from .ask import Ask, Given, Kept, Setting, axes_of, members_shape, read_members
from .functions import digest
from .result import Ensemble, Memory, Stored
from .store import StoreError

_THREAD_SECONDS = 0.05  # of a block that a thread makes: short, so that all end together
_TASK_SECONDS = 2.0  # of one that is sent elsewhere, or written to a store
_MOST_BYTES, _MOST = 2**26, 100_000  # of a block, members
_LANES = 16  # members that are stepped at once, at most: fewer in a block would leave lanes empty
_MOST_BLOCKS = 100_000  # what schedulers and file systems bear


def ensemble(
    system: System,
    scheme: Scheme | str | float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    parameters: Mapping[str, ArrayLike] | None = None,
    *,
    h: ArrayLike,
    t_end: float | None = None,
    steps: int | None = None,
    t0: float = 0.0,
    stride: int | None = None,
    keep: Any = "end",
    inputs: Any = None,
    hold: int | None = None,
    events: Any = (),
    consistent: str = "check",
    initial: str | None = None,
    max_iterations: int | None = None,
    energy: str | None = None,
    method: str | None = None,
    tolerance: float | None = None,
    axes: Any = None,
    executor: Any = None,
    threads: int | None = None,
    lanes: bool = False,
    store: str | os.PathLike[str] | None = None,
    block: int | None = None,
    progress: Progress = True,
) -> Ensemble:
    """Integrate many runs of a system with other initial data, parameters or step sizes.

    Each member gives bitwise the same result as its own `integrate` call, on any number of threads
    or machines.  A member that fails is recorded with its error message.

    Parameters
    ----------
    system : System
    scheme : Scheme, str or float, optional
        Default: the default of `integrate` for a number h.
    q0, v0 : array_like, shape (..., n), optional
        Initial data; pass both or neither.  Default: the initial data of the system with the
        parameters of each member.  Leading axes are those of the members; the leading axes of all
        arguments broadcast.
    parameters : mapping of str to array_like, shape (...), or Design, optional
        Values of parameters; see `grid` and `sample`.  Other parameters are those of the system.
    h : array_like, shape (...)
        Step size.
    t_end, steps, t0 : float, int, float, optional
        As for `integrate`; the same for all members.
    stride : int, optional
        Number of steps between rows of the results; default 1.  Not allowed if only the end is
        kept.
    keep : str, sequence of str or callable, optional
        The results to keep.

        - "end" (default): the last state, as ``q`` and ``v``.
        - "all": every stride-th state.
        - Names: coordinates ("theta"), velocities ("v_theta"), "energy", "residual", "multipliers",
          "reactions"; every stride steps, or at the end if "end" is among them.
        - A function of a `Solution` that returns a number, an array, or a mapping from names to
          numbers or arrays.
    inputs : array_like, mapping or callable, optional
        Inputs as for `integrate`, or with leading axes, shape (..., holds, k).  Expressions are
        evaluated in C with the parameters of each member.
    hold, events, consistent, initial, max_iterations, energy, method, tolerance : optional
        As for `integrate`.  Events and resets given as expressions are computed in C.
    axes : sequence of str, or mapping of str to array_like, optional
        Names of the axes of the members, and values along them, for plots and xarray.  Default: the
        axes of a `grid`.
    executor : concurrent.futures.Executor, or function that returns one, optional
        Executor of blocks of members, each of some seconds: a ``ProcessPoolExecutor``, dask's
        ``client.get_executor(pure=False)``, ...  Default: threads of this process.
    threads : int, optional
        Number of threads; default: one for each processor.
    lanes : bool, optional
        Advance several members at once with vector instructions, 3 to 6 times as fast.  Requires
        constant mass, linear constraints, no forces that depend on v, n <= 8, and no events, inputs
        or ``energy``.  Otherwise members are advanced one by one, with a warning; ``lanes`` of the
        result says which.  The bits of a member then do not depend on other members, their order or
        the threads, on one kind of machine.  They differ from those of `integrate` by about 1e-12
        over 1000 steps, because vector sines differ in the last bit.
    store : str or path, optional
        A directory for the results, one file for each block.  After an interruption, the same call
        resumes: finished blocks are not computed again.
    block : int, optional
        Number of members in a block; default: as many as take some seconds.
    progress : bool or callable, optional
        As for `integrate`, with numbers of members.  By default a bar is shown if tqdm is
        installed.

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
    ask = _ask(**{name: value for name, value in locals().items() if name not in _HOW})
    if lanes and (why := work.without_lanes(ask.setting, inputs is not None)):
        warnings.warn(
            f"lanes = True has no effect, because members are stepped one by one: {why}",
            DalembertWarning, stacklevel=2,
        )  # fmt: skip
        ask = dataclasses.replace(ask, setting=dataclasses.replace(ask.setting, lanes=False))
    if executor is not None and threads is not None:
        raise ValueError(
            f"threads = {threads} is given together with an executor: expected one of the two"
        )
    path, count = None if store is None else _folder(store), pool.threads_of(threads)
    pieces = pool.Blocks(ask, _size(ask, block, path is not None or executor is not None))
    data: Memory | Stored
    if path is None:
        _require_memory(ask)
        data = Memory(ask, pieces.size)
    else:
        about = _about(ask, pieces.size)
        there = stores.create(path, about, ask.arrays())
        require_same(system, there["system"], path)
        pieces.size = there["block"]
        data = Stored(path, about["mark"], ask, pieces.size)
    left = [k for k in range(len(pieces)) if not data.has(k)]
    before = ask.count - sum(end - begin for begin, end in map(pieces.range, left))
    try:
        bar = progress is not True or extras.is_there("tqdm")
        with extras.progress(progress if bar else False, ask.count, "member") as show:
            def tell(done: float) -> None:
                show(min(before + int(done), ask.count))

            if executor is None:
                pool.by_threads(pieces, left, data, tell, count)
            else:
                pool.by_executor(executor, pieces, left, data, tell)
            show(ask.count)
    except BaseException as error:
        with contextlib.suppress(AttributeError, TypeError):
            error.partial = Ensemble(ask, data)  # type: ignore[attr-defined]
        raise
    if path is not None:
        stores.tidy(path)
    found = Ensemble(ask, data)
    _warn(found)
    return found


def _folder(path: str | os.PathLike[str]) -> str:
    """Return the absolute path of a store."""
    found = os.fspath(path)
    if not isinstance(found, str) or not found:
        raise ValueError(f"store = {path!r}: expected the name of a directory")
    return os.path.abspath(found)


_HOW = ("executor", "threads", "store", "block", "progress")


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
    ask = _ask_of(about, arrays, require_same(system, about["system"], path))
    return Ensemble(ask, Stored(path, about["mark"], ask, about["block"]))


# ---- arguments -----------------------------------------------------------------------------------


def _ask(
    system: System, scheme: Any, q0: Any, v0: Any, parameters: Any, h: Any, t_end: Any, steps: Any,
    t0: Any, stride: Any, keep: Any, inputs: Any, hold: Any, events: Any, consistent: Any,
    initial: Any, max_iterations: Any, energy: Any, method: Any, tolerance: Any, axes: Any,
    lanes: Any,
) -> Ask:  # fmt: skip
    """Return the definition of an ensemble, or raise ValueError."""
    require_system(system)
    record = Scheme.usual(system) if scheme is None else Scheme.of(scheme)
    t0 = arguments.number(t0, "t0")
    kept = Kept.of(keep, system)
    if isinstance(h, str):
        raise ValueError(f"h = {h!r}: expected numbers, because ensembles take steps of fixed size")
    require(
        kind_of(record, method=method), inputs=inputs, hold=hold, events=events, initial=initial,
        max_iterations=max_iterations, energy=energy, method=method, tolerance=tolerance,
    )  # fmt: skip
    sizes = arguments.array(h, "h", *[(None,) * k for k in range(33)])
    many = np.unique(sizes)
    if sizes.size == 0:
        raise ValueError("h: expected at least one step size")
    counts = [number_of_steps(t0, arguments.step_size(x, t0), t_end, steps) for x in many.tolist()]
    number = np.array(counts)[np.searchsorted(many, sizes)]
    stride = _stride(stride, kept, counts)
    kind = "a whole number of steps"
    holds = 1 if hold is None else arguments.integer(hold, "hold", 1, kind=kind)
    inputs = take_inputs(system, inputs)
    if inputs is not None and not is_control(inputs) and len(set(counts)) > 1:
        raise ValueError(
            "inputs: the numbers of steps differ between members; expected a function, or the "
            "same number of steps"
        )
    if callable(inputs):
        arguments.function(inputs, "inputs", "t, q, v")
        if not system.inputs:
            raise ValueError("inputs: the system has no inputs; remove it")
    given = read_members(system, q0, v0, parameters, inputs, -(-counts[0] // holds))
    require_parameters(system.name, given["parameters"], system.parameters)
    all_given = {**{k: x for k, x in given.items() if k != "parameters"}, "h": Given(sizes),
                 **{f"parameters[{k!r}]": x for k, x in given["parameters"].items()}}
    shape = members_shape(all_given)
    arguments.choice(consistent, "consistent", CONSISTENCY)
    record._initial(initial)
    options_of({}, max_iterations, energy)
    setting = Setting(
        system=system, scheme=with_method(record, method, tolerance), t0=t0, stride=stride,
        kept=kept, consistent=consistent, initial=initial,
        max_iterations=max_iterations, energy=energy, hold=hold,
        events=tuple(take_events(events)),
        control=inputs if is_control(inputs) else None, lanes=bool(lanes),
    )  # fmt: skip
    shape = shape or (1,)
    names, ticks = axes_of(shape, axes, parameters)
    return Ask(
        setting=setting, shape=shape, axes=names, ticks=ticks, h=Given(sizes), steps=Given(number),
        **given,
    )  # fmt: skip


def _stride(stride: Any, kept: Kept, counts: list[int]) -> int:
    """Return the stride, 0 if only the end is kept."""
    if kept.at_end:
        if stride is not None:
            raise ValueError(
                f"stride = {stride}: not used, because only the end is kept; remove it"
            )
        return 0
    found = 1 if stride is None else arguments.integer(stride, "stride", 1)
    if kept.reduce is None and len(set(counts)) > 1:
        raise ValueError(
            "keep: the numbers of rows differ between members; expected 'end', or a function "
            "of a Solution"
        )
    for count in counts:
        if count % found:
            raise ValueError(
                f"steps = {count}: expected a multiple of stride = {found}, "
                f"{count - count % found} or {count - count % found + found}"
            )
    return found


# ---- blocks --------------------------------------------------------------------------------------


def _bytes_of_member(ask: Ask) -> int:
    """Return the approximate size of the results of a member in bytes."""
    parts = work.layout(ask.setting, ask.rows).values()
    return sum(math.prod(shape) * np.dtype(kind).itemsize for shape, kind, _ in parts)


def _size(ask: Ask, block: int | None, is_sent: bool) -> int:
    """Return the number of members of a block."""
    if block is not None:
        return arguments.integer(block, "block", 1)
    seconds = _TASK_SECONDS if is_sent else _THREAD_SECONDS
    wanted = max(seconds / _seconds_of_member(ask), _LANES if ask.setting.lanes else 0)
    wanted = min(wanted, _MOST_BYTES / _bytes_of_member(ask), _MOST)
    least = -(-ask.count // _MOST_BLOCKS) if is_sent else 1
    return max(least, min(int(wanted), ask.count))


def _seconds_of_member(ask: Ask) -> float:
    """Return the approximate time for a member in seconds, from some steps of the first."""
    setting, rows = ask.setting, ask.block(0, 1)
    steps, made, piece, elapsed = int(rows["steps"][0]), 0, 1, 1e-6
    if not work.is_in_c(setting):
        return 2e-4 + 5e-5 * steps  # whose functions are called for members alone
    with contextlib.suppress(Exception):  # it may fail, as any other
        stepper = started_stepper(
            setting.system, setting.scheme, _first_state(ask), t0=setting.t0,
            h=float(rows["h"][0]), consistency=CONSISTENCY["project"],
            initial=setting.scheme._initial(setting.initial),
        )  # fmt: skip
        began = time.perf_counter()

        def enough(t: float) -> None:
            if time.perf_counter() - began > 0.05:
                raise TimeoutError  # a step that takes long

        context = core.ffi.new_handle(enough)
        run = core.ffi.new("dal_run *", {"stepper": stepper, "steps": steps, "stride": steps})
        run.watch, run.watch_ctx = lib.dal_py_watch, context
        while made < steps and elapsed < 2e-3:
            status = core.attempt(lib.dal_run_go, run, piece)
            elapsed = time.perf_counter() - began
            if status:
                raise core.failure(status)
            made, piece = int(run.done), 2 * piece
    return 1e-6 + elapsed / max(made, 1) * steps


def _first_state(ask: Ask) -> Array:
    """Return the initial data of the first member."""
    rows, system = ask.block(0, 1), ask.setting.system
    if "x" in rows:
        return rows["x"][0]
    return np.concatenate([system.q0, system.v0])


def _require_memory(ask: Ask) -> None:
    """Raise MemoryError if the results would not fit in memory."""
    size = _bytes_of_member(ask) * ask.count
    memory = available_memory() if size > 2**24 else size
    if size > memory:
        raise MemoryError(
            f"{ask.count} members of {ask.rows} rows need {size} bytes ({size / 2**30:.4g} "
            f"GiB), and this machine has {memory / 2**30:.4g} GiB: keep fewer quantities, or "
            "pass store="
        )


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


def _about(ask: Ask, size: int) -> dict[str, Any]:
    """Return data for JSON that identify an ensemble."""
    setting = ask.setting
    scheme, kept = setting.scheme._data(), setting.kept
    if scheme is None:
        raise ValueError(
            f"store: the scheme {setting.scheme.name!r} is made of functions, which a store "
            "cannot save"
        )
    events = [
        [str(one.g) if hasattr(one.g, "free_symbols") else digest(one.g), float(one.direction),
         int(one.terminal), _told_reset(setting.system, one), one.consistent]
        for one in setting.events
    ]  # fmt: skip
    named, control = setting.system._source.named(), setting.control
    about = {
        "dalembert": core.version(),
        "system": of_system(setting.system, _first_state(ask), setting.t0),
        "scheme": scheme,
        "shape": list(ask.shape),
        "axes": list(ask.axes),
        "ticks": {name: x.tolist() for name, x in ask.ticks.items()},
        "t0": setting.t0,
        "stride": setting.stride,
        "keep": [kept.at_end, kept.states, list(kept.measures), dict(kept.columns),
                 digest(kept.reduce)],
        "functions": {name: digest(f) for name, f in named.items() if f is not None},
        "consistent": setting.consistent,
        "initial": setting.initial,
        "max_iterations": setting.max_iterations,
        "hold": setting.hold,
        "events": events,
        "control": control.about(setting.system) if isinstance(control, Law) else digest(control),
        "lanes": setting.lanes,
        **({"energy": setting.energy} if setting.energy else {}),
    }  # fmt: skip
    mark = _mark(about, ask.arrays())
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


def _ask_of(about: Mapping[str, Any], arrays: Mapping[str, Array], system: System) -> Ask:
    """Return the definition in a store, which does not keep functions."""
    at_end, states, measures, columns, reduce = about["keep"]
    lacks = {"events": about["events"], "inputs": about["control"], "keep": reduce}
    setting = Setting(
        system=system, scheme=Scheme._from_data(about["scheme"]), t0=about["t0"],
        stride=about["stride"], kept=Kept(at_end, states, tuple(measures), columns),
        consistent=about["consistent"], initial=about["initial"],
        max_iterations=about["max_iterations"], hold=about["hold"], events=(), control=None,
        lanes=about["lanes"], energy=about.get("energy"),
    )  # fmt: skip
    return Ask.of_arrays(
        arrays, setting=setting, shape=tuple(about["shape"]), axes=tuple(about["axes"]),
        ticks={name: np.array(x) for name, x in about["ticks"].items()},
        lacks=tuple(name for name, there in lacks.items() if there),
    )  # fmt: skip
