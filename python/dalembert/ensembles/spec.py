"""The definition of an ensemble: its members, and the results kept for each."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..core import Array, arguments
from ..core.extras import Progress
from ..core.records import extended, option
from ..run.events import Event
from ..run.laws import is_control
from ..run.options import (
    IntegrateOptions,
    Options,
    Size,
    Step,
    Extent,
    Events,
    Inputs,
    Sampling,
    Watching,
)
from ..run.scheme import Scheme
from ..system import System
from .design import Design

# What every ensemble has.
TAKEN = {"status", "done", "t_end", "doubtful", "ended_by", "happened", "messages", "failed",
         "mark", "states"}  # fmt: skip

# What is computed from states, and may not be defined at some.
MEASURES = ("energy", "residual", "multipliers")


_TAILS = {"q0": 1, "v0": 1, "inputs": 2}  # how many axes a member has, of what has any


# ---- what is given for members -----------------------------------------------------------------


@dataclass(frozen=True)
class Broadcast:
    """Values for members: the last ``tail`` axes belong to one member, the others broadcast."""

    values: Array
    tail: int = 0  # how many axes one member has

    @property
    def leading(self) -> tuple[int, ...]:
        """Shape of the axes that broadcast."""
        return self.values.shape[: self.values.ndim - self.tail]

    @property
    def varies(self) -> bool:
        """Whether members may have different values."""
        return math.prod(self.leading) > 1

    def rows(self, shape: tuple[int, ...], begin: int, end: int) -> Array:
        """Return the values of the members begin .. end - 1 of an ensemble of this shape.

        The result has one row if all members have the same values.
        """
        leading, tail = self.leading, self.values.shape[len(self.leading) :]
        if not self.varies:
            return self.values.reshape(1, *tail)
        if leading == shape:
            whole = self.values.reshape(math.prod(leading), *tail)
            return np.ascontiguousarray(whole[begin:end])
        places = np.unravel_index(np.arange(begin, end), shape)[len(shape) - len(leading) :]
        index = tuple(k if size > 1 else 0 * k for k, size in zip(places, leading))
        return np.ascontiguousarray(self.values[index])


def broadcast(value: ArrayLike, name: str, *tail: int | None) -> Broadcast:
    """Return values with these last axes, None for any length."""
    shape = np.shape(value) if arguments.shape(value) == np.shape(value) else None
    if shape is None or len(shape) < len(tail):
        arguments.array(value, name, tuple(tail))
    found = arguments.array(value, name, (*[None] * (len(shape) - len(tail)), *tail))
    if 0 in found.shape[: found.ndim - len(tail)]:
        raise ValueError(f"{name}: expected at least one member, got shape {found.shape}")
    return Broadcast(found, len(tail))


# ---- what is kept ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Output:
    """The results kept for each member."""

    at_end: bool  # only the last state; otherwise a row for each stride steps
    states: bool = False
    measures: tuple[str, ...] = ()  # "energy", "residual", "multipliers", "reactions"
    columns: Mapping[str, int] = field(default_factory=dict)  # places in a state, by name
    reduce: Callable[[Any], Any] | None = None  # a function of a `Solution`, instead of all others

    @classmethod
    def of(cls, keep: Any, system: System) -> Output:
        """Return the results that the argument ``keep`` requests."""
        if callable(keep):
            arguments.function(keep, "keep", "run")
            return cls(at_end=False, reduce=keep)
        names = [keep] if isinstance(keep, str) else keep
        names = arguments.names(names, "keep", "'end', 'all', names, or a function of a Solution")
        if not names:
            raise ValueError("keep = []: expected at least one name")
        velocities = [f"v_{name}" for name in system.coordinates]
        places = {name: k for k, name in enumerate((*system.coordinates, *velocities))}
        measures = (*MEASURES, "reactions")
        known = dict.fromkeys(("end", "all", "q", "v", *measures, *places), 0)
        for name in names:
            arguments.choice(name, "keep", known)
        if {"end", "all"} <= {*names}:
            raise ValueError("keep contains 'end' and 'all': expected only one of them")
        taken = {"end", "all", "q", "v", *measures, *TAKEN}
        columns = {name: places[name] for name in names if name in places}
        for name in columns:
            if name in taken or (name in velocities and name in system.coordinates):
                raise ValueError(
                    f"keep: {name!r} is the name of a coordinate and of another quantity; use "
                    "keep='all', which numbers them"
                )
        chosen = tuple(name for name in measures if name in names)
        whole = bool({"all", "q", "v"} & {*names}) or not (columns or chosen)
        return cls("end" in names, whole, chosen, columns)


# ---- what is asked -----------------------------------------------------------------------------


# fmt: off
@dataclass(frozen=True, eq=False, repr=False)
class _Members(Options):
    q0: ArrayLike | None = field(default=None, metadata=extended(Options, "q0"))
    v0: ArrayLike | None = field(default=None, metadata=extended(Options, "v0", """
        The leading axes are those of the members; the leading axes of all arguments broadcast.  By
        default the initial data have the parameters of each member.
    """, type="array_like, shape (..., n)"))
    parameters: Mapping[str, ArrayLike] | None = option(
        "mapping of str to array_like, shape (...), or Design",
        "Values of parameters; see `grid` and `sample`.  Other parameters are those of the system.")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class EnsembleOptions(Events, Inputs, Sampling, Step, Extent, Size, _Members):
    """The options of `ensemble`."""

    h: ArrayLike | str | None = field(default=None, metadata=extended(
        Size, "h", "The step size of each member, or one word for all members.",
        type='array_like, shape (...), "auto", "reversible" or "own"'))
    stride: int | None = field(default=None, metadata=extended(
        Sampling, "stride",
        "Results have a row for each stored state.  Not allowed if only the end is kept."))
    inputs: Any = field(default=None, metadata=extended(Inputs, "inputs", """
        An array may have leading axes, shape (..., holds, k).  Expressions are evaluated in C with
        the parameters of each member."""))
    events: Any = field(default=(), metadata=extended(
        Events, "events", "Events and resets given as expressions are computed in C."))
    keep: Any = option("str, sequence of str or callable", """
        The results to keep.

        - "end" (default): the last state, as ``q`` and ``v``.
        - "all": every stride-th state.
        - Names: coordinates ("theta"), velocities ("v_theta"), "energy", "residual", "multipliers",
          "reactions"; every stride steps, or at the end if "end" is among them.
        - A function of a `Solution` that returns a number, an array, or a mapping from names to
          numbers or arrays.

        If h is a word, the numbers of rows differ, so only the end or a function can be kept.
    """, default="end", parse=lambda text: text.split(","), metavar="NAME,...")
    axes: Any = option("sequence of str, or mapping of str to array_like", """
        Names of the axes of the members, and values along them, for plots and xarray.  Default: the
        axes of a `grid`.""")
    executor: Any = option("concurrent.futures.Executor, or function that returns one", """
        Executor of blocks of members, each of some seconds: a ``ProcessPoolExecutor``, dask's
        ``client.get_executor(pure=False)``, ...  Default: threads of this process.""")
    threads: int | None = option(
        "int", "Number of threads; default: one for each processor.", parse=int, metavar="N")
    lanes: bool = option("bool", """
        Advance several members at once with vector instructions, 3 to 6 times as fast.  Requires
        steps of fixed size, n <= 8, no events, no ``energy``, and inputs as numbers that last 8
        steps or more.  Otherwise members are advanced one by one, with a warning; ``lanes`` of the
        result says which.  The bits of a member then do not depend on
        other members, their order or the threads, on one kind of machine.  They differ from those
        of `integrate` by about 1e-12 over 1000 steps, because vector sines differ in the last bit.
        With "taylor" the bits are those of `integrate`; n may be any number, and there must be no
        inputs, kinks or jumps.
    """, default=False, parse=bool)
    store: str | os.PathLike[str] | None = option("str or path", """
        A directory for the results, one file for each block.  After an interruption, the same call
        resumes: finished blocks are not computed again.""", parse=Path, metavar="DIR")
    block: int | None = option(
        "int", "Number of members in a block; default: as many as take some seconds.",
        read=partial(arguments.integer, least=1), parse=int, metavar="N")
    progress: Progress = field(default=True, metadata=extended(
        Watching, "progress",
        "The numbers are those of members.  By default a bar is shown if tqdm is installed.",
        default=True))
# fmt: on


# ---- all of it ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Common:
    """The properties common to all members.

    The initial data of a member, its step size, number of steps and rows of inputs replace those of
    the options.
    """

    options: IntegrateOptions
    stride: int  # 0: the end alone
    output: Output
    lanes: bool = False

    @property
    def system(self) -> System:
        """The system of all members, except for their parameters."""
        return self.options.system

    @property
    def scheme(self) -> Scheme:
        """The scheme of all members."""
        return self.options.scheme  # type: ignore[return-value]

    @property
    def events(self) -> tuple[Event, ...]:
        """The events of each member."""
        return self.options.events  # type: ignore[no-any-return]

    @property
    def varies(self) -> bool:
        """Whether the step size varies along a run."""
        return bool(self.options.control)

    def rows(self, steps: Array) -> int:
        """Return the number of rows kept for each member, which have the same number of steps."""
        return 1 if self.stride == 0 or self.varies else int(steps.flat[0]) // self.stride + 1

    def having(self, **options: Any) -> Common:
        """Return the properties with other options of each member."""
        return replace(self, options=self.options.having(**options))


@dataclass(frozen=True)
class EnsembleSpec:
    """The definition of an ensemble."""

    common: Common
    shape: tuple[int, ...]  # of the broadcast arguments; members are numbered in C order
    axes: tuple[str, ...]
    ticks: dict[str, Array]  # values along axes, by name
    q0: Broadcast | None
    v0: Broadcast | None
    parameters: dict[str, Broadcast]
    h: Broadcast
    steps: Broadcast
    inputs: Broadcast | None
    lacks: tuple[str, ...] = ()  # functions of it that a store does not keep

    def arrays(self) -> dict[str, Array]:
        """Return the values for members, by the names that `of_arrays` expects."""
        found = {name: getattr(self, name) for name in (*_TAILS, "h", "steps")}
        found |= {f"parameters.{name}": x for name, x in self.parameters.items()}
        return {name: x.values for name, x in found.items() if x is not None}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, Array], **more: Any) -> EnsembleSpec:
        """Return the definition from the result of `arrays` and the other attributes."""
        given = {name: Broadcast(x, _TAILS.get(name, 0)) for name, x in arrays.items()}
        parameters = {
            name.removeprefix("parameters."): x
            for name, x in given.items() if name.startswith("parameters.")
        }  # fmt: skip
        plain = {name: given.get(name) for name in (*_TAILS, "h", "steps")}
        return cls(parameters=parameters, **plain, **more)

    @property
    def count(self) -> int:
        """The number of members."""
        return math.prod(self.shape)

    @property
    def rows(self) -> int:
        """The number of rows kept for each member."""
        return self.common.rows(self.steps.values)

    def block(self, begin: int, end: int) -> dict[str, Array]:
        """Return the values for the members begin .. end - 1; one row if all members have the same.

        "x" and "parameters" are absent if they are those of the system.
        """
        common, shape, count = self.common, self.shape, end - begin
        found = {"h": self.h.rows(shape, begin, end), "steps": self.steps.rows(shape, begin, end)}
        if self.q0 is not None and self.v0 is not None:
            halves = [x.rows(shape, begin, end) for x in (self.q0, self.v0)]
            rows = max(map(len, halves))
            wide = [np.broadcast_to(x, (rows, x.shape[1])) for x in halves]
            found["x"] = np.concatenate(wide, axis=1)
        if self.parameters:
            values = {name: x.rows(shape, begin, end) for name, x in self.parameters.items()}
            table = np.empty((count, len(common.system.parameters)))
            table[:] = list(common.system.parameters.values())
            for k, name in enumerate(common.system.parameters):
                if name in values:
                    table[:, k] = values[name]
            found["parameters"] = table
        if self.inputs is not None:
            found["inputs"] = self.inputs.rows(shape, begin, end)
        return found


def members_shape(given: Mapping[str, Broadcast | None]) -> tuple[int, ...]:
    """Return the broadcast shape of the leading axes; raise ValueError if they do not match."""
    leading = {name: x.leading for name, x in given.items() if x is not None and x.leading}
    try:
        return np.broadcast_shapes(*leading.values())
    except ValueError:
        shown = ", ".join(f"{name}: {shape}" for name, shape in leading.items())
        raise ValueError(
            f"the leading axes of the members do not broadcast together: {shown}"
        ) from None


def read_members(asked: EnsembleOptions, inputs: Any, holds: int) -> dict[str, Any]:
    """Return the arguments for members, each as `Broadcast`, or None."""
    system, q0, v0, values = asked.system, asked.q0, asked.v0, asked.parameters
    n = system.n
    arguments.pair(q0, v0, ("q0", "v0"), " for those of the system")
    if q0 is None and system.q0 is None:
        raise ValueError(
            f"q0 and v0 are missing: the system {system.name!r} has no default initial data"
        )
    found: dict[str, Any] = {
        name: None if x is None else broadcast(x, name, n) for name, x in (("q0", q0), ("v0", v0))
    }
    if not isinstance(values, Design):
        values = arguments.mapping(values, "parameters")
    found["parameters"] = {
        str(name): broadcast(values.compact(name) if isinstance(values, Design) else values[name],
                          f"parameters[{str(name)!r}]")
        for name in values
    }  # fmt: skip
    found["inputs"] = None
    if inputs is not None and not is_control(inputs):
        found["inputs"] = _inputs(inputs, system, holds)
    return found


def _inputs(inputs: Any, system: System, holds: int) -> Broadcast:
    """Return rows of inputs for all members, or, with leading axes, for each."""
    if isinstance(inputs, Mapping) or np.ndim(inputs) <= 2:
        return Broadcast(arguments.inputs(inputs, system.inputs, holds), 2)
    if not system.inputs:
        raise ValueError("inputs: the system has no inputs; remove it")
    return broadcast(inputs, "inputs", holds, len(system.inputs))


def axes_of(
    shape: tuple[int, ...], given: Any, parameters: Any
) -> tuple[tuple[str, ...], dict[str, Array]]:
    """Return the names of the axes and the values along them, as given or from a grid."""
    if given is None and isinstance(parameters, Design) and parameters.shape == shape:
        ticks = {x: parameters.compact(x).reshape(-1) for x in parameters.axes if x in parameters}
        return parameters.axes, ticks
    if given is None:
        names = ["member"] if len(shape) == 1 else [f"axis_{k}" for k in range(len(shape))]
        return tuple(names), {}
    names = arguments.names(given, "axes", "names of the axes of the members")
    if len(names) != len(shape) or len({*names}) != len(names):
        raise ValueError(f"axes = {names!r}: expected {len(shape)} names, for members {shape}")
    if not isinstance(given, Mapping):
        return tuple(names), {}
    return tuple(names), {
        name: arguments.array(given[name], f"axes[{name!r}]", (size,))
        for name, size in zip(names, shape)
    }
