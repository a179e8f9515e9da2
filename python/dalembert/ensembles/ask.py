"""The definition of an ensemble: its members, and the results kept for each."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..core import Array, arguments
from ..run.events import Event
from ..run.laws import Law, is_control
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
class Given:
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


def _given(value: ArrayLike, name: str, *tail: int | None) -> Given:
    """Return values with these last axes, None for any length."""
    shape = np.shape(value) if arguments.shape(value) == np.shape(value) else None
    if shape is None or len(shape) < len(tail):
        arguments.array(value, name, tuple(tail))
    found = arguments.array(value, name, (*[None] * (len(shape) - len(tail)), *tail))
    if 0 in found.shape[: found.ndim - len(tail)]:
        raise ValueError(f"{name}: expected at least one member, got shape {found.shape}")
    return Given(found, len(tail))


# ---- what is kept ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Kept:
    """The results kept for each member.

    Attributes
    ----------
    at_end : bool
        Only the last state; otherwise a row for each stride steps.
    states : bool
        The states.
    measures : tuple of str
        "energy", "residual", "multipliers", "reactions".
    columns : mapping of str to int
        Name of a coordinate or velocity to its place in a state.
    reduce : callable or None
        A function of the `Solution` whose result is kept instead of all others.
    """

    at_end: bool
    states: bool = False
    measures: tuple[str, ...] = ()
    columns: Mapping[str, int] = dataclasses.field(default_factory=dict)
    reduce: Callable[[Any], Any] | None = None

    @classmethod
    def of(cls, keep: Any, system: System) -> Kept:
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


# ---- all of it ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """The properties common to all members."""

    system: System
    scheme: Scheme
    t0: float
    stride: int  # 0: the end alone
    kept: Kept
    consistent: str
    initial: str | None
    max_iterations: int | None
    hold: int | None
    events: tuple[Event, ...]
    control: Callable[..., Any] | Law | None  # inputs that are a function, or expressions
    lanes: bool = False
    energy: str | None = None


@dataclass(frozen=True)
class Ask:
    """The definition of an ensemble.

    Attributes
    ----------
    shape : tuple of int
        Shape of the broadcast arguments; the members are numbered in C order.
    axes : tuple of str
        Names of the axes.
    ticks : dict of ndarray
        Values along axes, by the name of the axis.
    """

    setting: Setting
    shape: tuple[int, ...]
    axes: tuple[str, ...]
    ticks: dict[str, Array]
    q0: Given | None
    v0: Given | None
    parameters: dict[str, Given]
    h: Given
    steps: Given
    inputs: Given | None
    lacks: tuple[str, ...] = ()  # functions of it that a store does not keep

    def arrays(self) -> dict[str, Array]:
        """Return the values for members, by the names that `of_arrays` expects."""
        found = {name: getattr(self, name) for name in (*_TAILS, "h", "steps")}
        found |= {f"parameters.{name}": x for name, x in self.parameters.items()}
        return {name: x.values for name, x in found.items() if x is not None}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, Array], **more: Any) -> Ask:
        """Return the definition from the result of `arrays` and the other attributes."""
        given = {name: Given(x, _TAILS.get(name, 0)) for name, x in arrays.items()}
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
        stride = self.setting.stride
        return 1 if stride == 0 else int(self.steps.values.flat[0]) // stride + 1

    def block(self, begin: int, end: int) -> dict[str, Array]:
        """Return the values for the members begin .. end - 1; one row if all members have the same.

        "x" and "parameters" are absent if they are those of the system.
        """
        setting, shape, count = self.setting, self.shape, end - begin
        found = {"h": self.h.rows(shape, begin, end), "steps": self.steps.rows(shape, begin, end)}
        if self.q0 is not None and self.v0 is not None:
            halves = [x.rows(shape, begin, end) for x in (self.q0, self.v0)]
            rows = max(map(len, halves))
            wide = [np.broadcast_to(x, (rows, x.shape[1])) for x in halves]
            found["x"] = np.concatenate(wide, axis=1)
        if self.parameters:
            values = {name: x.rows(shape, begin, end) for name, x in self.parameters.items()}
            table = np.empty((count, len(setting.system.parameters)))
            table[:] = list(setting.system.parameters.values())
            for k, name in enumerate(setting.system.parameters):
                if name in values:
                    table[:, k] = values[name]
            found["parameters"] = table
        if self.inputs is not None:
            found["inputs"] = self.inputs.rows(shape, begin, end)
        return found


def members_shape(given: Mapping[str, Given | None]) -> tuple[int, ...]:
    """Return the broadcast shape of the leading axes; raise ValueError if they do not match."""
    leading = {name: x.leading for name, x in given.items() if x is not None and x.leading}
    try:
        return np.broadcast_shapes(*leading.values())
    except ValueError:
        shown = ", ".join(f"{name}: {shape}" for name, shape in leading.items())
        raise ValueError(
            f"the leading axes of the members do not broadcast together: {shown}"
        ) from None


def read_members(
    system: System,
    q0: ArrayLike | None,
    v0: ArrayLike | None,
    parameters: Mapping[str, ArrayLike] | None,
    inputs: Any,
    holds: int,
) -> dict[str, Any]:
    """Return the arguments for members, each as `Given`, or None."""
    n = system.n
    arguments.pair(q0, v0, ("q0", "v0"), " for those of the system")
    if q0 is None and system.q0 is None:
        raise ValueError(
            f"q0 and v0 are missing: the system {system.name!r} has no default initial data"
        )
    found: dict[str, Any] = {
        name: None if x is None else _given(x, name, n) for name, x in (("q0", q0), ("v0", v0))
    }
    values = parameters if isinstance(parameters, Design) else arguments.mapping(
        parameters, "parameters"
    )
    found["parameters"] = {
        str(name): _given(values.compact(name) if isinstance(values, Design) else values[name],
                          f"parameters[{str(name)!r}]")
        for name in values
    }  # fmt: skip
    found["inputs"] = None
    if inputs is not None and not is_control(inputs):
        found["inputs"] = _inputs(inputs, system, holds)
    return found


def _inputs(inputs: Any, system: System, holds: int) -> Given:
    """Return rows of inputs for all members, or, with leading axes, for each."""
    if isinstance(inputs, Mapping) or np.ndim(inputs) <= 2:
        return Given(arguments.inputs(inputs, system.inputs, holds), 2)
    if not system.inputs:
        raise ValueError("inputs: the system has no inputs; remove it")
    return _given(inputs, "inputs", holds, len(system.inputs))


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
