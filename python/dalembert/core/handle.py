"""C systems with their properties, and the C objects that functions work with."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import arguments
from .arguments import Array, shown
from .errors import call, check, make, name_of
from .functions import differenced
from .library import Constant, doubles, ffi, lib, pointer, string

# The kinds of constraints, by their names.
KINDS = {"linear": lib.DAL_LINEAR, "affine": lib.DAL_AFFINE, "nonlinear": lib.DAL_NONLINEAR}


def first(values: Array, single: bool) -> Any:
    """Return rows, or for a single state its row, which may be a number."""
    return values if not single else values[0] if values.ndim > 1 else float(values[0])


class Workspaces:
    """C objects for use by one call at a time, for a system with constraints of a kind.

    Threads and re-entrant callbacks get separate objects, so no call waits.
    """

    def __init__(self, new: Callable[[], Any], kind: str) -> None:
        self._new, self._kind = new, kind
        self._free: list[Any] = []

    @contextlib.contextmanager
    def lend(self) -> Iterator[Any]:
        """Lend an object."""
        try:
            one = self._free.pop()
        except IndexError:
            one = self._new()
        try:
            yield one
        finally:
            self._free.append(one)

    def check(self, status: int, one: Any, step: int | None = None) -> None:
        """Raise the exception for a status of an object, unless it is success."""
        check(status, one, self._kind, step=step)

    def call(self, function: Callable[..., int], *given: Any) -> Any:
        """Call ``function(one, *given)``; a tuple stands for an output array, see `rows`."""
        arrays = _arrays(given, 1)
        with self.lend() as one:
            call(self._kind, function, one, *arrays)
        return _outputs(given, arrays, True)

    def rows(
        self, function: Callable[..., int], single: bool, *given: Any, inputs: Array | None = None
    ) -> Any:
        """Call ``function(one, *given)`` for each row of the arrays in ``given``.

        A tuple stands for an output array with rows of this shape, a list for a number per row.
        The result is these arrays, or a single one, without the axis of rows if ``single``.
        ``inputs`` has a row for each call, if the system has inputs.
        """
        count = next(len(x) for x in given if isinstance(x, np.ndarray))
        arrays = _arrays(given, count)
        with self.lend() as one:
            take = getattr(lib, f"dal_{name_of(one)}_input") if inputs is not None else None
            try:
                for k in range(count):
                    if inputs is not None:
                        call(self._kind, take, one, pointer(inputs, k))
                    call(self._kind, function, one, *(_row(x, k) for x in arrays), step=k)
            finally:
                if inputs is not None:
                    take(one, pointer(np.zeros(inputs.shape[1])))
        return _outputs(given, arrays, single)


def _arrays(given: Sequence[Any], count: int) -> list[Any]:
    """Return the arguments, with arrays of so many rows for shapes."""
    return [np.empty((count, *x)) if isinstance(x, tuple) else x for x in given]


def _row(x: Any, k: int) -> Any:
    """Return the value for C of an argument for row k."""
    if isinstance(x, np.ndarray):
        return pointer(x, k)
    return x[k] if isinstance(x, list) else x


def _outputs(given: Sequence[Any], arrays: Sequence[Any], single: bool) -> Any:
    """Return the output arrays, or the single one."""
    made = [first(array, single) for x, array in zip(given, arrays) if isinstance(x, tuple)]
    return made[0] if len(made) == 1 else tuple(made)


class Handle(Constant):
    """A C system and its properties; see `dalembert.System`."""

    n: int
    m: int
    name: str
    help: str
    description: str
    source: str
    coordinates: tuple[str, ...]
    kind: str
    has_constant_mass: bool
    is_forced: bool
    is_driven: bool
    is_time_dependent: bool
    inputs: tuple[str, ...]
    q0: Array | None
    v0: Array | None
    differenced: tuple[str, ...]
    _model: Any = None  # the expressions that it was made from
    _units: Mapping[str, str] = {}
    _identity: Any  # what tells it from others, for JSON

    def _adopt(self, handle: Any) -> None:
        """Take ownership of a C system, and read its properties."""

        def text(what: str, *given: int) -> str:
            return string(getattr(lib, f"dal_system_{what}")(handle, *given))

        self._handle = handle
        self.n, self.m = n, _ = int(lib.dal_system_n(handle)), int(lib.dal_system_m(handle))
        for what in ("name", "help", "description", "source"):
            setattr(self, what, text(what))
        self._formulas = tuple(text("formulas").splitlines())
        self.coordinates = tuple(text("coordinate", i) for i in range(n))
        inputs = int(lib.dal_system_inputs(handle))
        self.inputs = tuple(text("input_name", i) for i in range(inputs))
        self._parameters = {
            text("parameter_name", i): float(lib.dal_system_parameter(handle, i))
            for i in range(lib.dal_system_parameters(handle))
        }
        self.kind = {number: name for name, number in KINDS.items()}[lib.dal_system_kind(handle)]
        self.is_forced = bool(lib.dal_system_is_forced(handle))
        self.is_driven = bool(lib.dal_system_is_driven(handle))
        constant = lib.dal_system_mass(handle, ffi.NULL) == lib.DAL_SUCCESS
        self.has_constant_mass = constant  # without n^2 numbers
        self.is_time_dependent = bool(lib.dal_system_is_time_dependent(handle))
        self.differenced = differenced(lib.dal_system_missing(handle), self.kind)
        state = np.empty(2 * n)
        has_state = lib.dal_system_state(handle, pointer(state)) == lib.DAL_SUCCESS
        self.q0, self.v0 = (state[:n], state[n:]) if has_state else (None, None)
        for array in (self.q0, self.v0):
            if array is not None:
                array.flags.writeable = False
        self._mechanics = Workspaces(
            lambda: make("mechanics", handle, owner=handle), self.kind
        )
        self._steppers: dict[Any, list[Any]] = {}  # that nobody uses, by what they are made of

    @functools.cached_property
    def mass(self) -> Array | None:
        """The mass matrix, of shape (n, n); None if it is not constant."""
        if not self.has_constant_mass:
            return None
        matrix = np.empty((self.n, self.n))
        lib.dal_system_mass(self._handle, pointer(matrix))
        matrix.flags.writeable = False
        return matrix

    @property
    def sparsity(self) -> tuple[NDArray[np.uintp], NDArray[np.uintp]] | None:
        """Rows and columns of the entries of mu that may be nonzero; None: all."""
        given = lib.dal_system_sparsity(self._handle)
        if given == ffi.NULL:
            return None
        size = given.entries * ffi.sizeof("size_t")
        both = (ffi.buffer(x, size)[:] for x in (given.row, given.column))
        rows, columns = (np.frombuffer(x, dtype=np.uintp) for x in both)
        return rows, columns

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of a system of the library or of expressions; empty for functions."""
        return dict(self._parameters)

    @property
    def units(self) -> dict[str, str]:
        """The given units of coordinates, of the time "t" and of the "energy"."""
        return dict(self._units)

    def unit(self, name: str) -> str:
        """Return the unit of a coordinate, a velocity, the time or the energy; "" if unknown.

        Parameters
        ----------
        name : str
            A coordinate; ``v_`` and a coordinate, for its velocity; "t"; or "energy".  Other
            quantities have no known unit.

        Examples
        --------
        >>> import dalembert as dal
        >>> sleigh = dal.systems.sleigh().with_units(x="m", theta="rad", t="s")
        >>> sleigh.unit("v_x"), sleigh.unit("v_theta"), sleigh.unit("y")
        ('m/s', 'rad/s', '')
        """
        base = arguments.text(name, "name").removeprefix("v_")
        if name in self._units or name in self.coordinates or base not in self.coordinates:
            return self._units.get(name, "")
        if not {base, "t"} <= self._units.keys():
            return ""
        time = self._units["t"]
        return f"{self._units[base]}/{time if time.isalnum() else f'({time})'}"

    @property
    def formulas(self) -> tuple[str, ...]:
        """Lines for L, the constraints, and abbreviations in these and in names of invariants.

        ``v_x`` is the velocity of x, a blank a product, ``^`` a power.  For a system from
        expressions they are derived from these.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.systems.particle().formulas
        ('L = (v_x^2 + v_y^2 + v_z^2)/2', 'v_z - y v_x = 0')
        """
        return self._formulas if self._model is None else self._model.formulas()

    def _c(self, constructor: str, *given: Any) -> Any:
        """Return a C object of this system, which keeps it alive."""
        return make(constructor, self._handle, *given, owner=self._handle)


def require_autonomous(system: Any, what: str) -> None:
    """Raise ValueError unless ``system`` is a System that depends on time in its force only."""
    require_system(system)
    if system.is_time_dependent:
        raise ValueError(
            f"system = {system!r}: expected a system that does not depend on time for {what}"
        )


def require_system(value: Any) -> None:
    """Raise ValueError unless ``system`` is a System."""
    if not isinstance(value, Handle):
        raise ValueError(
            f"system = {shown(value)}: expected a dalembert.System, for example "
            "dalembert.systems.sleigh()"
        )
