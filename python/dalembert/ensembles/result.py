"""The results of an ensemble."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..core import Array, arguments, extras, lib
from ..run import Solution
from . import block, store
from .spec import EnsembleSpec, Broadcast

# What every ensemble has, whatever is kept.
_ALWAYS = ("status", "done", "t_end", "doubtful", *block.STATISTICS)


_SMALL = 2**26  # bytes of an array that is kept when it was read from a store


class Memory:
    """Blocks of an ensemble, collected in memory."""

    def __init__(self, spec: EnsembleSpec, size: int) -> None:
        self._count, self._size = spec.count, size
        self._arrays = block.empty(spec.common, spec.rows, spec.count)
        self.messages: dict[int, str] = self._arrays.pop("messages")

    def put(self, index: int, made: block.Block) -> None:
        """Store a block."""
        begin = index * self._size
        for name, x in made.items():
            if name == "messages":
                self.messages |= {begin + k: text for k, text in x.items()}
                continue
            if name not in self._arrays:
                self._arrays[name] = np.full((self._count, *x.shape[1:]), *_blank(name, x.dtype))
            if self._arrays[name].shape[1:] != x.shape[1:]:
                raise ValueError(
                    f"keep returned {name!r} of shape {x.shape[1:]}, but of shape "
                    f"{self._arrays[name].shape[1:]} for another member: expected the same "
                    "shape"
                )
            self._arrays[name][begin : begin + len(x)] = x

    def has(self, index: int) -> bool:
        """Return whether a block is present."""
        return False

    def names(self) -> list[str]:
        """Return the names of the arrays."""
        return [*self._arrays]

    def array(self, name: str) -> Array:
        """Return an array, shape (K, ...)."""
        found = self._arrays[name]
        found.flags.writeable = False
        return found

    def blocks(self) -> Iterator[tuple[int, block.Block]]:
        """Yield the first member of each block, and its arrays."""
        for begin in range(0, self._count, self._size):
            end = min(begin + self._size, self._count)
            yield begin, {name: x[begin:end] for name, x in self._arrays.items()}


def _blank(name: str, kind: np.dtype[Any]) -> tuple[Any, Any]:
    """Return the fill value for members that were not computed, and its type."""
    if name == "status":
        return lib.DAL_STOPPED, kind
    return (np.nan if kind.kind == "f" else -1 if name == "ended_by" else 0), kind


class Stored:
    """Blocks of an ensemble in a store, read on first use."""

    def __init__(self, path: str, mark: str, spec: EnsembleSpec, size: int) -> None:
        self.path, self.mark, self._count, self._size = path, mark, spec.count, size
        self._reduces = spec.common.output.reduce is not None or "keep" in spec.lacks
        self._there = store.there(path, mark, -(-self._count // size))
        self._read: dict[str, Array] = {}  # small arrays that were read
        self._layout = block.layout(spec.common, spec.rows)

    def put(self, index: int, made: block.Block) -> None:
        """Write a block, unless it was stopped."""
        if (made["status"] != lib.DAL_STOPPED).all():
            store.write(self.path, index, self.mark, made)
            self.know(index)

    def know(self, index: int) -> None:
        """Register a block that another process has written."""
        self._there = sorted({*self._there, index})
        self._read.clear()

    def has(self, index: int) -> bool:
        """Return whether a block is present."""
        return index in self._there

    @property
    def messages(self) -> dict[int, str]:
        """Messages of the members that failed."""
        return {
            index * self._size + k: text
            for index in self._there
            for k, text in store.read(self.path, index, self.mark, "messages")["messages"].items()
        }

    def names(self) -> list[str]:
        """Return the names of the arrays."""
        found = [*self._layout]
        for index in self._there:  # a block whose members have all failed may lack some
            if len(more := store.names(self.path, index)) > len(found):
                found = more
            if not self._reduces:
                break
        return found

    def array(self, name: str) -> Array:
        """Return an array, shape (K, ...)."""
        found: Array | None = None
        if name in self._read:
            return self._read[name]
        for index in self._there:
            x = self._of_block(index, name)
            if x is None:  # all of its members have failed
                continue
            if found is None:
                found = np.full((self._count, *x.shape[1:]), *_blank(name, x.dtype))
            found[index * self._size : index * self._size + len(x)] = x
        if found is None:
            shape, kind, value = self._layout[name]
            found = np.full((self._count, *shape), value, kind)
        found.flags.writeable = False
        if found.nbytes <= _SMALL:
            self._read[name] = found
        return found

    def _of_block(self, index: int, name: str) -> Array | None:
        """Return an array of a block; raise StoreError if its shape or type is wrong."""
        return self._checked(index, name, store.read(self.path, index, self.mark, name).get(name))

    def _checked(self, index: int, name: str, x: Array | None) -> Array | None:
        shape, kind, _ = self._layout.get(name, (None, None, None))
        if x is None and shape is None:
            return None
        size = min(self._size, self._count - index * self._size)
        if (
            x is None
            or x.shape[:1] != (size,)
            or (shape is not None and (x.shape[1:] != shape or x.dtype != kind))
        ):
            raise store.damaged(self.path, index, f"the file is not valid: {name}")
        return x

    def by_dask(self, name: str, n: int) -> Any:
        """Return a dask array that is read block by block."""
        da = extras.require("dask.array", "a lazy array")
        delayed = extras.require("dask", "a lazy array").delayed
        whole = {"q": "states", "v": "states"}.get(name, name)
        part = {"q": slice(None, n), "v": slice(n, None)}.get(name, slice(None))
        example = next(
            x for index in self._there if (x := self._of_block(index, whole)) is not None
        )
        shape = example[..., part].shape[1:] if whole == "states" else example.shape[1:]

        def of_block(index: int) -> Array:
            begin, end = index * self._size, min((index + 1) * self._size, self._count)
            x = self._of_block(index, whole) if index in there else None
            if x is None:
                return np.full((end - begin, *shape), *_blank(whole, example.dtype))
            return x[..., part] if whole == "states" else x

        there = {*self._there}
        parts = [
            da.from_delayed(
                delayed(of_block)(index),
                (min(self._size, self._count - index * self._size), *shape), example.dtype,
            )
            for index in range(-(-self._count // self._size))
        ]  # fmt: skip
        return da.concatenate(parts)

    def blocks(self) -> Iterator[tuple[int, block.Block]]:
        """Yield the first member of each block, and its arrays."""
        for index in self._there:
            made = store.read(self.path, index, self.mark)
            names = {*made, *self._layout} - {"messages"}
            yield index * self._size, {
                name: x for name in names
                if (x := self._checked(index, name, made.get(name))) is not None
            }  # fmt: skip


class Ensemble(Mapping[str, Any]):
    """Many runs: the results kept for each, failures with their messages, and each run again.

    An ensemble is a mapping from names to arrays; their first axis counts the members.  The arrays
    listed below are attributes too.  The missing values of a member that failed are NaN.

    Attributes
    ----------
    system : System
        The system of all members, except for their parameters.
    scheme : Scheme
    shape : tuple of int
        Broadcast shape of the arguments; members are numbered in C order.
    axes : tuple of str
        Names of these axes.
    ticks : dict of ndarray
        Values along axes, by the name of the axis.
    parameters : dict of ndarray, shape (K,)
        The given parameters of each member.
    q0, v0 : ndarray, shape (K, n), or None
        The given initial data.
    h : ndarray, shape (K,), or str
    steps : ndarray, shape (K,)
    t0 : float
    stride : int
        Number of steps between rows; 0 if only the end was kept.
    lanes : bool
        Whether several members were advanced at once.
    """

    def __init__(self, spec: EnsembleSpec, data: Memory | Stored) -> None:
        self._spec, self._data = spec, data
        common = spec.common
        self.system, self.scheme = common.system, common.scheme
        self.shape, self.axes, self.ticks = spec.shape, spec.axes, spec.ticks
        self.t0, self.stride, self.lanes = common.options.t0, common.stride, common.lanes
        self._varies = common.varies

    # ---- what was given ------------------------------------------------------------------------

    def _of_members(self, given: Broadcast) -> Array:
        rows = given.rows(self.shape, 0, len(self))
        return np.broadcast_to(rows, (len(self), *rows.shape[1:]))

    def __len__(self) -> int:
        return self._spec.count

    @property
    def parameters(self) -> dict[str, Array]:
        """Values of the given parameters, shape (K,) each."""
        return {name: self._of_members(x) for name, x in self._spec.parameters.items()}

    @property
    def q0(self) -> Array | None:
        """Initial positions, shape (K, n); None if they are the system's."""
        return None if self._spec.q0 is None else self._of_members(self._spec.q0)

    @property
    def v0(self) -> Array | None:
        """Initial velocities, shape (K, n); None if they are the system's."""
        return None if self._spec.v0 is None else self._of_members(self._spec.v0)

    @property
    def h(self) -> Any:
        """Step sizes, shape (K,), or the word for steps of variable size."""
        return self._spec.common.options.h if self._varies else self._of_members(self._spec.h)

    @property
    def steps(self) -> Array:
        """Requested numbers of steps, shape (K,); those taken if their size varies."""
        return self["done"] if self._varies else self._of_members(self._spec.steps)

    # ---- what was made -------------------------------------------------------------------------

    def __getitem__(self, name: str) -> Any:
        n = self.system.n
        if name in ("q", "v") and "states" in self._data.names():
            x = self._data.array("states")
            return x[..., :n] if name == "q" else x[..., n:]
        if name not in self._data.names():
            raise KeyError(
                f"there is no attribute {name!r}: expected one of {', '.join(self)}. To store "
                "more quantities, name them in keep= of dal.ensemble; to write files, use "
                "to_xarray()"
            )
        return self._data.array(name)

    def __iter__(self) -> Iterator[str]:
        names = self._data.names()
        own = [name for name in names if name != "states"]
        return iter([*["q", "v"] * ("states" in names), *own])

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        try:
            return self[name]
        except KeyError as error:
            raise AttributeError(error.args[0]) from None

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self})

    __eq__ = object.__eq__  # arrays have no truth value
    __hash__ = object.__hash__

    @property
    def t(self) -> Array:
        """Times of the rows, shape (rows,), or (K, rows) if step sizes differ; (K,) for the end."""
        if self.stride == 0 or self._varies:
            return self["t_end"]  # type: ignore[no-any-return]
        rows = np.arange(self._spec.rows) * self.stride
        if not self._spec.h.varies:
            return self.t0 + rows * float(self._spec.h.values.flat[0])
        return self.t0 + rows * self.h[:, None]

    @property
    def success(self) -> Array:
        """Whether each member ended without error, shape (K,)."""
        return self["status"] == lib.DAL_SUCCESS  # type: ignore[no-any-return]

    @property
    def failed(self) -> Array:
        """The numbers of the members that failed."""
        return np.flatnonzero(self["status"] < 0)

    @property
    def unfinished(self) -> Array:
        """The numbers of the members not computed because the ensemble was stopped."""
        return np.flatnonzero(self["status"] == lib.DAL_STOPPED)

    @property
    def stats(self) -> dict[str, Array]:
        """Counters of each member, by the names of `Statistics`, shape (K,) each."""
        return {name: self[name] for name in block.STATISTICS}

    def message(self, k: int | tuple[int, ...]) -> str:
        """Return the outcome of a member in words; ``k`` as for `member`."""
        k = self._number(k)
        status = int(self["status"][k])
        if status < 0:
            return self._data.messages[k]
        t = float(self["t_end"][k])
        if status == lib.DAL_STOPPED:
            return "not finished: the ensemble was stopped"
        ended_by = int(self["ended_by"][k]) if "ended_by" in self else -1
        if ended_by >= 0:
            return f"events[{ended_by}] ended the run at t = {t:g}"
        return f"{int(self['done'][k])} steps to t = {t:g}"

    def _number(self, k: int | tuple[int, ...]) -> int:
        if not isinstance(k, tuple):
            k = arguments.integer(k, "k", -(2**63))
            if not -len(self) <= k < len(self):
                raise ValueError(f"there is no member {k}: expected 0 to {len(self) - 1}")
            return k % len(self)
        if len(k) != len(self.shape):
            raise ValueError(
                f"k = {k}: expected a number, or {len(self.shape)} numbers, one for each axis"
            )
        where = [
            arguments.integer(one, f"k[{axis}]", -size, size - 1) % size
            for axis, (one, size) in enumerate(zip(k, self.shape))
        ]
        return int(np.ravel_multi_index(where, self.shape))

    def member(
        self, k: int | tuple[int, ...], *, stride: int | None = None, throw: bool = False
    ) -> Solution:
        """Compute the run of member k again; the result is bitwise identical.

        Parameters
        ----------
        k : int or tuple of int
            Number of the member, or its place along the axes of ``shape``.  Negative numbers
            count from the end.
        stride : int, optional
            As for `integrate`.  Default: that of the ensemble, or 1 if only the end was kept.
        throw : bool, optional
            True: if the member failed in a step, raise its exception instead of returning the
            states so far.

        Raises
        ------
        ValueError
            If its initial data or parameters are invalid, or there is no such member.
        """
        if self._spec.lacks:
            raise ValueError(
                f"member({k}): this ensemble has {', '.join(self._spec.lacks)}, and a store "
                "cannot save functions; repeat dal.ensemble with the same arguments"
            )
        stride = self.stride or 1 if stride is None else stride
        return block.member(self._spec, self._number(k), stride=stride, throw=throw)

    def blocks(self) -> Iterator[tuple[int, dict[str, Array]]]:
        """Yield parts of the ensemble: the number of the first member, and the arrays by name.

        An ensemble in a store is read part by part, so the memory is bounded.
        """
        return self._data.blocks()

    # ---- as something else ---------------------------------------------------------------------

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset``, with parameters as coordinates.

        A grid has an axis for each of its names.  With dask installed, the arrays of a store are
        lazy.

        Raises
        ------
        ImportError
            If xarray is not installed.
        """
        xarray = extras.require("xarray", "to_xarray")
        about = {"system": self.system.name, "scheme": self.scheme.name, "t0": self.t0}
        found = xarray.Dataset(attrs=about)
        values = {name: self._lazy(name) for name in self}
        inner = {name: self._inner(name, x.ndim - 1) for name, x in values.items()}
        used = {*values, "t", "q0", "v0", *(dim for dims in inner.values() for dim in dims)}
        axes = tuple(f"{name}_axis" if name in used else name for name in self.axes)
        for name, x in values.items():
            dims = (*axes, *inner[name])
            found[name] = dims, x.reshape((*self.shape, *x.shape[1:]))
        given = {name: x for name, x in self.ticks.items() if name in self.axes}
        for name, axis in zip(self.axes, axes):
            if name in given:
                found = found.assign_coords({axis: given[name]})
        for name, x in self.parameters.items():
            if name not in self.ticks:
                label = f"{name}_parameter" if name in used or name in axes else name
                found = found.assign_coords({label: (axes, x.reshape(self.shape))})
        for name, of in (("q0", self.q0), ("v0", self.v0)):
            if of is not None:
                rows = of.reshape(*self.shape, -1)
                found = found.assign_coords({name: ((*axes, "coordinate"), rows)})
        if {"q", "v"} & {*self}:
            found = found.assign_coords(coordinate=list(self.system.coordinates))
        if self.stride > 0 and "time" in {dim for dims in inner.values() for dim in dims}:
            dims = ("time",) if self.t.ndim == 1 else (*axes, "time")
            t = self.t if self.t.ndim == 1 else self.t.reshape(*self.shape, -1)
            found = found.assign_coords(t=(dims, t))
        return found

    def _inner(self, name: str, count: int) -> tuple[str, ...]:
        """Return the names of the axes of one member."""
        rows = ("interval" if name == "reactions" else "time",) * (self.stride > 0)
        known = {
            "q": ("coordinate",), "v": ("coordinate",), "multipliers": ("constraint",),
            "reactions": ("constraint",), "happened": ("event",),
        }  # fmt: skip
        if name in (*_ALWAYS, "ended_by"):
            return ()
        if self._spec.common.output.reduce is not None or "keep" in self._spec.lacks:
            return tuple(f"{name}_{k}" for k in range(count))
        names = (*(() if name == "happened" else rows), *known.get(name, ()))
        return names if len(names) == count else tuple(f"{name}_{k}" for k in range(count))

    def _lazy(self, name: str) -> Any:
        """Return an array, as dask array if it is in a store and dask is installed."""
        if isinstance(self._data, Memory) or not extras.is_there("dask") or name in _ALWAYS:
            return self[name]
        return self._data.by_dask(name, self.system.n)

    @property
    def kept(self) -> list[str]:
        """The names of the kept results, without those that every ensemble has."""
        return [name for name in self if name not in _ALWAYS]

    def __repr__(self) -> str:
        status = self["status"]
        good, failed = int((status == 0).sum()), int((status < 0).sum())
        shape = "" if len(self.shape) < 2 else f" ({' x '.join(map(str, self.shape))})"
        lines = [
            f"<Ensemble of {len(self)} runs{shape} of {self.system.name} by {self.scheme.name}"
            f"{' in lanes' * self.lanes}: {good} completed",
        ]
        if failed:
            lines.append(f"  {failed} failed, see failed and message(k)")
        if left := len(self) - good - failed:
            lines.append(f"  {left} were not finished")
        if doubtful := int(self["doubtful"].sum()):
            lines.append(f"  {doubtful} are doubtful, see doubtful and member(k)")
        lines.append(f"  kept: {', '.join(self.kept)}")
        return "\n".join(lines) + ">"
