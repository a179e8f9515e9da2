"""Runs: schemes as records, `integrate`, and the `Solution` that it returns."""

from __future__ import annotations

import contextlib
import math
import operator
import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from . import _lib, geometry
from ._lib import Array, DalembertError, DalembertWarning, NotOnConstraintError, ffi, lib
from .system import System, differenced

__all__ = [
    "Reference",
    "Scheme",
    "Solution",
    "Statistics",
    "integrate",
    "reference",
    "schemes",
]

NODES = {"moved": lib.DAL_MOVED_NODES, "kept": lib.DAL_KEPT_NODES}
CONSISTENCY = {"check": lib.DAL_CHECK, "project": lib.DAL_PROJECT, "assume": lib.DAL_ASSUME}
INITIAL = {
    "D": lib.DAL_INITIAL_D,
    "D_eps": lib.DAL_INITIAL_D_EPS,
    "project": lib.DAL_INITIAL_PROJECT,
    "shift": lib.DAL_INITIAL_SHIFT,
}
SOLVERS = {"schur": lib.DAL_SOLVER_SCHUR, "multiroot": lib.DAL_SOLVER_MULTIROOT}
SIZES = {"auto": lib.DAL_SIZES_AUTO, "runtime": lib.DAL_SIZES_RUNTIME}
METHODS = {
    "rk8pd": lib.DAL_FLOW_RK8PD,
    "msadams": lib.DAL_FLOW_MSADAMS,
    "msbdf": lib.DAL_FLOW_MSBDF,
}

BLOCK_SECONDS = 0.07  # of one call of C: short enough for Ctrl-C, long enough to cost nothing
BLOCK_STEPS = 10_000  # at most, between two stored states
FLOW_ROWS = 100  # of one call of the reference flow, which starts anew in each
CONSISTENT = 1e-8  # relative residual that is accepted as being in D, as by the core


# ---- schemes -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scheme:
    """A scheme as a record: beta-schemes one after the other, each over a fraction of the step.

    Parameters
    ----------
    substeps : sequence of (beta, fraction)
        beta in [0, 1]; the fractions are not 0 and sum to 1.
    nodes : {"moved", "kept"}, optional
        Where the states are: "moved" nodes (1 - beta) q_{k-1} + beta q_k keep D; "kept" nodes q_k
        keep D_eps = {mu(q - (1 - beta) h v) v = 0} and need a single sub-step.
    name : str, optional
        At most 39 bytes.
    help, reference : str, optional
        One line about the scheme, and where it comes from.
    order, multiplier_order : int, optional
        What is promised, (p, s): local errors O(h^(p+1)) of q and v and O(h^(s+1)) of the scheme's
        own multipliers.  order 0: nothing is promised.
    symmetric : bool, optional
        True if the scheme is its own adjoint on D.

    Raises
    ------
    ValueError
        If the record is not valid; the text says what.

    Examples
    --------
    >>> import dalembert as dal
    >>> theta = dal.Scheme([(0.3, 1.0)], name="beta 0.3")
    >>> dal.integrate(dal.systems.particle(), theta, h=0.1, steps=10).success
    True
    """

    substeps: tuple[tuple[float, float], ...]
    nodes: str = "moved"
    name: str = "own"
    help: str = ""
    reference: str = ""
    order: int = 0
    multiplier_order: int = 0
    symmetric: bool = False
    _record: Any = field(init=False, repr=False, compare=False)  # the dal_scheme
    _kept: Any = field(init=False, repr=False, compare=False)  # what the dal_scheme points to

    def __post_init__(self) -> None:
        if len(self.substeps) == 0 and self.name != "reference":
            raise ValueError(f"substeps of {self.name!r}: expected at least one (beta, fraction)")
        if len(self.substeps) > 0:
            pairs = _lib.array(self.substeps, f"substeps of {self.name!r}", (None, 2))
            object.__setattr__(self, "substeps", tuple((float(b), float(f)) for b, f in pairs))
        name = self.name.encode()
        if not 0 < len(name) < 40:
            raise ValueError(f"name = {self.name!r}: expected 1 to 39 bytes, got {len(name)}")
        kept = (
            ffi.new("dal_substep[]", list(self.substeps)),
            ffi.new("char[]", self.help.encode()),
            ffi.new("char[]", self.reference.encode()),
        )
        record = ffi.new("dal_scheme *")
        record.name = name
        record.help, record.reference = kept[1], kept[2]
        if self.substeps and (len(self.substeps) > 1 or self.substeps[0][1] != 1.0):
            record.count, record.substeps = len(self.substeps), kept[0]
        elif self.substeps:
            record.beta = self.substeps[0][0]
        record.nodes = _lib.choice(self.nodes, "nodes", NODES)
        record.order = operator.index(self.order)
        record.multiplier_order = operator.index(self.multiplier_order)
        record.symmetric = bool(self.symmetric)
        object.__setattr__(self, "_record", record)
        object.__setattr__(self, "_kept", kept)
        if not self.is_reference:
            _lib.make("stepper", _validator()._handle, record, ffi.NULL)

    @classmethod
    def find(cls, name: str) -> Scheme:
        """Return the scheme of this name, "reference" for the reference flow.

        Parameters
        ----------
        name : str
            "explicit", "midpoint", "endpoint", a number in [0, 1] (beta), "leapfrog",
            "leapfrog-mirror"; with "-nodes" for kept nodes; "leapfrog" and "midpoint" with
            "-suzuki4", "-yoshida4", "-kl6", "-kl8".  ``-`` and ``_`` are the same.

        Raises
        ------
        ValueError
            If there is no such scheme; the text lists what there is.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Scheme.find("leapfrog").substeps
        ((0.0, 0.5), (1.0, 0.5))
        """
        if name == REFERENCE.name:
            return REFERENCE
        record = ffi.new("dal_scheme *")
        error = ffi.new("dal_error *")
        status = lib.dal_scheme_find(record, name.encode(), error)
        _lib.check(status, _lib.string(error.text))
        return cls._read(record)

    @classmethod
    def of(cls, value: Scheme | str | float) -> Scheme:
        """Return a scheme that is given as itself, by its name, or by its beta."""
        if isinstance(value, Scheme):
            return value
        if isinstance(value, str):
            return cls.find(value)
        return cls.find(repr(_lib.number(value, "scheme")))

    @classmethod
    def _read(cls, record: Any) -> Scheme:
        """Return the scheme of a ``dal_scheme``."""
        count = int(record.count)
        return cls(
            substeps=tuple((s.beta, s.fraction) for s in record.substeps[0:count])
            if count
            else ((record.beta, 1.0),),
            nodes="kept" if record.nodes == lib.DAL_KEPT_NODES else "moved",
            name=_lib.string(record.name),
            help=_lib.string(record.help),
            reference=_lib.string(record.reference),
            order=int(record.order),
            multiplier_order=int(record.multiplier_order),
            symmetric=bool(record.symmetric),
        )

    @property
    def is_reference(self) -> bool:
        """True for the reference flow, which has no sub-steps."""
        return self.name == "reference" and not self.substeps

    def is_explicit(self, system: System) -> bool:
        """Return whether a step on this system is a sequence of linear solves."""
        return not self.is_reference and bool(
            lib.dal_scheme_is_explicit(self._record, system._handle)
        )

    def shift(self, h: float) -> float:
        """Return the shift (1 - beta) h of the D_eps that kept nodes keep.

        Raises
        ------
        NotImplementedError
            For a record with several sub-steps, which has no D_eps.
        """
        shift = ffi.new("double *")
        status = lib.dal_scheme_shift(self._record, shift)
        _lib.check(status, f"{self.name!r} has no single sub-step, and so no D_eps")
        return float(shift[0]) * h

    def __str__(self) -> str:
        return self.name

    def __reduce__(self) -> tuple[Any, ...]:
        return Scheme, (
            self.substeps, self.nodes, self.name, self.help, self.reference, self.order,
            self.multiplier_order, self.symmetric,
        )  # fmt: skip


_lock = threading.Lock()
_free_particle: list[System] = []


def _validator() -> System:
    """Return a system on which the core can try a record: a free particle on a line."""
    with _lock:
        if not _free_particle:
            _free_particle.append(System(mass=[1.0], name="free particle"))
    return _free_particle[0]


REFERENCE = Scheme(
    (),
    name="reference",
    help="adaptive integration of the ODE on D by GSL: best for short accurate runs",
    reference="GSL odeiv2: rk8pd, msadams, msbdf",
)


def schemes() -> list[Scheme]:
    """Return the named schemes.

    Examples
    --------
    >>> import dalembert as dal
    >>> "leapfrog" in [scheme.name for scheme in dal.schemes()]
    True
    """
    found = []
    for i in range(lib.dal_scheme_count()):
        record = ffi.new("dal_scheme *")
        _lib.check(lib.dal_scheme_at(record, i))
        found.append(Scheme._read(record))
    return found


# ---- what a run returns --------------------------------------------------------------------


@dataclass(frozen=True)
class Statistics:
    """What a run has cost.

    Attributes
    ----------
    steps, substeps : int
        Steps made, and systems of equations solved in them.
    iterations : int
        Newton iterations.
    constraint_calls, potential_calls : int
        Calls of the system's functions.
    corrections : int
        Final corrections onto D that took an evaluation of their own.
    full_newtons : int
        Sub-steps that needed the Hessian of V.
    halvings : int
        Newton steps halved because a function left its domain.
    worst_residual : float
        Largest relative residual of the kept set after a step, as the step predicts it.
    initial_residual, initial_correction : float
        Relative residual of the initial data, and how far they were moved in the mass metric.
    differenced : tuple of str
        Derivatives that were replaced by central differences.
    evaluations : int
        Of the vector field, by the reference flow.
    """

    steps: int = 0
    substeps: int = 0
    iterations: int = 0
    constraint_calls: int = 0
    potential_calls: int = 0
    corrections: int = 0
    full_newtons: int = 0
    halvings: int = 0
    worst_residual: float = 0.0
    initial_residual: float = 0.0
    initial_correction: float = 0.0
    differenced: tuple[str, ...] = ()
    evaluations: int = 0

    @classmethod
    def _read(cls, stepper: Any) -> Statistics:
        stats = ffi.new("dal_stats *")
        lib.dal_stepper_stats(stepper, stats)
        values = {name: getattr(stats, name) for name, _ in ffi.typeof("dal_stats").fields}
        return cls(**{**values, "differenced": differenced(stats.differenced)})


class Solution(Mapping[str, Any]):
    """A run: states, and what is computed from them when it is asked for.

    Everything is an attribute and a key.  ``len`` is the number of keys, as for any mapping.

    Attributes
    ----------
    t : ndarray, shape (N+1,)
        Times ``t0 + k * h * stride``, in the user's units.
    q, v : ndarray, shape (N+1, n)
        Views of ``x``.
    x : ndarray, shape (N+1, 2n)
        The states (q, v), the very buffer that the core wrote.
    y : ndarray, shape (2n, N+1)
        ``x`` transposed, a view, as SciPy has it.
    multipliers : ndarray, shape (N+1, m)
        lambda(q, v) by the formula at the stored states: forces.
    reactions : ndarray, shape (N, m)
        The scheme's own multipliers: mean forces over the intervals between stored states,
        belonging to their middles.  NaN for the reference flow, which has none.
    energy : ndarray, shape (N+1,)
    constraint : ndarray, shape (N+1, m)
        mu(q) v.
    residual : ndarray, shape (N+1,)
        Relative residual ``max_a |mu^a v| / sum_i |mu^a_i v_i|`` of the set that the scheme
        keeps: D for moved nodes, D_eps (mu at q - shift v) for kept ones.
    system : System
    scheme : Scheme
    h : float
        Step size; between stored states lie ``stride`` steps.
    stride : int
    nodes : {"moved", "kept"}
    shift : float
        0 for moved nodes, (1 - beta) h for kept ones.
    stats : Statistics
    success : bool
        True unless a step failed; stopped by an observer is a success.
    status : int
        ``dal_status`` of the C library: 0, 1 if an observer stopped the run, or negative.
    message : str

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.particle(), "midpoint", h=0.01, t_end=10)
    >>> run.q.shape, run["energy"].shape
    ((1001, 3), (1001,))
    """

    _KEYS = (
        "t", "q", "v", "multipliers", "reactions", "energy", "constraint", "residual", "scheme",
        "h", "stats", "success", "status", "message", "y", "x", "system", "nodes", "shift",
        "stride",
    )  # fmt: skip

    def __init__(
        self,
        *,
        system: System,
        scheme: Scheme,
        x: Array,
        reactions: Array,
        t0: float,
        h: float,
        stride: int,
        stats: Statistics,
        status: int,
        message: str,
    ) -> None:
        self.system = system
        self.scheme = scheme
        self.x = x
        self.reactions = reactions
        self.h = h
        self.stride = stride
        self.stats = stats
        self.status = status
        self.success = status >= 0
        self.message = message
        self.nodes = scheme.nodes
        self.shift = scheme.shift(h) if scheme.nodes == "kept" else 0.0
        self.t = t0 + np.arange(len(x)) * stride * h
        self._lock = threading.Lock()
        self._computed: dict[str, Array] = {}

    @property
    def q(self) -> Array:
        """Coordinates, shape (N+1, n), a view."""
        return self.x[:, : self.system.n]

    @property
    def v(self) -> Array:
        """Velocities, shape (N+1, n), a view."""
        return self.x[:, self.system.n :]

    @property
    def y(self) -> Array:
        """States, shape (2n, N+1), a view."""
        return self.x.T

    @property
    def multipliers(self) -> Array:
        """lambda(q, v) by the formula, shape (N+1, m)."""
        return self._evaluate("multipliers", "multipliers", self.system.m)

    @property
    def energy(self) -> Array:
        """Energy, shape (N+1,)."""
        return self._evaluate("energy", "energy", None)

    @property
    def constraint(self) -> Array:
        """mu(q) v, shape (N+1, m)."""
        return self._evaluate("constraint", "residual", self.system.m)

    @property
    def residual(self) -> Array:
        """Relative residual of the set that the scheme keeps, shape (N+1,)."""
        return self._evaluate("residual", "relative", None, self.shift)

    def _evaluate(self, name: str, output: str, width: int | None, shift: float = 0.0) -> Array:
        """Compute a quantity from the stored states, once."""
        with self._lock:
            if name not in self._computed:
                self._computed[name] = geometry.trajectory(
                    self.system, self.x, output, width,
                    t0=float(self.t[0]), h=self.stride * self.h, shift=shift,
                )  # fmt: skip
            return self._computed[name]

    def to_xarray(self) -> Any:
        """Return the run as an ``xarray.Dataset``.

        Dimensions: time, coordinate, form (one for each constraint), interval (the middles of the
        intervals between stored states).

        Raises
        ------
        ImportError
            If xarray is not installed; the text is the line to type.

        Examples
        --------
        >>> import dalembert as dal
        >>> data = dal.integrate(dal.systems.particle(), h=0.1, steps=10).to_xarray()
        >>> data.q.sel(coordinate="y").shape
        (11,)
        """
        try:
            import xarray
        except ImportError as error:
            raise ImportError("to_xarray needs xarray: pip install xarray") from error
        along = ("time", "coordinate")
        return xarray.Dataset(
            {
                "q": (along, self.q),
                "v": (along, self.v),
                "multipliers": (("time", "form"), self.multipliers),
                "energy": ("time", self.energy),
                "constraint": (("time", "form"), self.constraint),
                "residual": ("time", self.residual),
                "reactions": (("interval", "form"), self.reactions),
            },
            coords={
                "time": self.t,
                "coordinate": list(self.system.coordinates),
                "interval": (self.t[:-1] + self.t[1:]) / 2,
            },
            attrs={
                "system": self.system.name,
                **{f"parameter_{key}": x for key, x in self.system.parameters.items()},
                "scheme": self.scheme.name,
                "nodes": self.nodes,
                "h": self.h,
                "stride": self.stride,
                "status": self.status,
                "message": self.message,
                "dalembert": _lib.version(),
            },
        )

    def __getitem__(self, key: str) -> Any:
        if key not in self._KEYS:
            raise KeyError(key)
        return getattr(self, key)

    def __iter__(self) -> Iterator[str]:
        return iter(self._KEYS)

    def __len__(self) -> int:
        return len(self._KEYS)

    __eq__ = object.__eq__  # arrays have no truth value
    __hash__ = object.__hash__

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self._KEYS})

    def __getstate__(self) -> dict[str, Any]:
        return {key: x for key, x in self.__dict__.items() if key != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._lock = threading.Lock()

    def __repr__(self) -> str:
        kept = "D_eps" if self.nodes == "kept" else "D"
        every = f", every {self.stride} steps" if self.stride > 1 else ""
        lines = [
            f"<Solution of {self.system.name} by {self.scheme.name}, h = {self.h:g}: "
            f"{'success' if self.success else 'FAILED'}",
            f"  {len(self.x)} states at t = {self.t[0]:g} .. {self.t[-1]:g}{every}",
        ]
        if not self.scheme.is_reference and self.system.m > 0:
            lines.append(f"  worst residual of {kept}: {self.stats.worst_residual:.1e}")
        return "\n".join([*lines, f"  {self.message}>"])


# ---- runs ----------------------------------------------------------------------------------


def integrate(
    system: System,
    scheme: Scheme | str | float = "leapfrog",
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    *,
    h: float,
    t_end: float | None = None,
    steps: int | None = None,
    t0: float = 0.0,
    stride: int = 1,
    consistent: str = "check",
    initial: str | None = None,
    observer: Callable[[int, float, Array, Array], Any] | None = None,
    progress: bool | Callable[[int, int], Any] = False,
    throw: bool = True,
    solver: str = "schur",
    sizes: str = "auto",
    max_iterations: int = 50,
    method: str = "rk8pd",
    tolerance: float = 1e-13,
) -> Solution:
    """Integrate a system with a fixed step size.

    Parameters
    ----------
    system : System
    scheme : Scheme, str or float, optional
        A record, the name of one, or beta.  "reference" is the adaptive flow of the ODE on D,
        observed every ``h * stride``: the best choice for short accurate runs.
    q0, v0 : array_like, shape (n,), optional
        Initial data in the user's units.  Default: those of the system.
    h : float
        Step size, negative to integrate backwards.  It is never changed.
    t_end : float
        End of the run; ``(t_end - t0) / h`` has to be an integer to 1e-9 of it.
    steps : int
        Number of steps, 0 is allowed.  Exactly one of t_end and steps is given.
    t0 : float, optional
        Initial time.
    stride : int, optional
        Every stride-th state is stored; the number of steps is a multiple of it.
    consistent : {"check", "project", "assume"}, optional
        Initial data that are not in D are refused, projected in the mass metric, or used.
    initial : {"D", "D_eps", "project", "shift"}, optional
        Needed for kept nodes, and only there.  "D": the data lie in D and are used as they are,
        the first step jumps to D_eps.  "D_eps": they lie in D_eps.  "project": the velocity is
        projected from D onto D_eps.  "shift": q is moved to the node q + (1 - beta) h v, so that
        the run is that of the moved nodes, seen at the nodes.
    observer : callable, optional
        ``observer(step, t, q, v)`` is called at every stored state; true stops the run.
    progress : bool or callable, optional
        True: a bar of tqdm.  A function is called as ``progress(done, total)`` with numbers of
        steps, some times a second.
    throw : bool, optional
        False: a step that fails ends the run, and the Solution says so, instead of an exception.
    solver : {"schur", "multiroot"}, optional
        How the equations of a step are solved; "multiroot" is slow, an independent check.
    sizes : {"auto", "runtime"}, optional
        Which compilation of the step is used; the bits are the same.
    max_iterations : int, optional
        Of Newton in a sub-step.
    method : {"rk8pd", "msadams", "msbdf"}, optional
        Of the reference flow.
    tolerance : float, optional
        Of the reference flow, relative and absolute, for each of its steps.

    Returns
    -------
    Solution

    Raises
    ------
    ValueError
        If an argument is out of range; the text names it, its value, and what was expected.
    MemoryError
        If the states would not fit into the memory of this machine; nothing was allocated.
    NotOnConstraintError
        If the initial data are not in D; the text names the residual.
    SingularError, ConvergenceError, DomainError
        If a step failed; ``.step``, ``.t`` and ``.partial``, a Solution, say how far it came.
    Exception
        Whatever the observer or a function of the system raises, as it is; Ctrl-C likewise.
        They have ``.partial`` too.

    Warns
    -----
    DalembertWarning
        If the result may be doubtful: the kept set is not kept to roundoff, or many steps needed
        the Hessian of V, so that h is large for this potential.

    Notes
    -----
    C runs without the lock of the interpreter; threads may run on the same system.

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.particle(), "midpoint", [0, 1, 0], [1, 1, 1],
    ...                     h=0.01, t_end=10)
    >>> bool(run.residual.max() < 1e-15)
    True
    """
    if not isinstance(system, System):
        raise ValueError(f"system = {system!r}: expected a dalembert.System")
    record = Scheme.of(scheme)
    t0, h = _lib.number(t0, "t0"), _lib.number(h, "h")
    if h == 0.0:
        raise ValueError("h = 0: expected a step size, negative to integrate backwards")
    steps = _number_of_steps(t0, h, t_end, steps)
    stride = _integer(stride, "stride", 1)
    if steps % stride:
        raise ValueError(
            f"steps = {steps}: expected a multiple of stride = {stride}, "
            f"{steps - steps % stride} or {steps - steps % stride + stride}"
        )
    consistency = _lib.choice(consistent, "consistent", CONSISTENCY)
    if record.nodes == "moved" and initial is not None:
        raise ValueError(f"initial = {initial!r}: {record.name!r} has moved nodes, it takes none")
    if record.nodes == "kept" and initial is None:
        raise ValueError(
            f"initial: needed, because {record.name!r} has kept nodes: one of "
            f"{', '.join(map(repr, INITIAL))}"
        )
    start = lib.DAL_INITIAL_NONE if initial is None else _lib.choice(initial, "initial", INITIAL)
    options = ffi.new("dal_options *")
    options.solver = _lib.choice(solver, "solver", SOLVERS)
    options.sizes = _lib.choice(sizes, "sizes", SIZES)
    options.max_iterations = _integer(max_iterations, "max_iterations", 1, 2**31 - 1)
    flow_method = _lib.choice(method, "method", METHODS)
    tolerance = _lib.number(tolerance, "tolerance")
    x0 = np.concatenate(geometry.initial(system, q0, v0))
    rows = steps // stride
    _require_memory(system, rows, steps, stride)

    watcher = None if observer is None else _lib.Observer(system.n, observer)
    run: _SchemeRun | _FlowRun
    with _progress(progress, steps) as report:
        if record.is_reference:
            run = _FlowRun(system, record, t0, h, rows, stride, watcher)
            run.start(x0, consistent, flow_method, tolerance)
        else:
            run = _SchemeRun(system, record, t0, h, rows, stride, watcher)
            run.start(x0, consistency, start, options)
        run.make(report)
    solution = run.solution()
    error = run.error
    if error is None:
        _warn(solution)
    elif throw or not isinstance(error, DalembertError):
        with contextlib.suppress(AttributeError, TypeError):
            error.partial = solution  # type: ignore[attr-defined]
        try:
            raise error
        finally:
            del error, run  # else the traceback would keep itself alive
    return solution


class _Run:
    """A run in the making: its buffers, how many rows of them are good, and why it ended."""

    def __init__(
        self,
        system: System,
        scheme: Scheme,
        t0: float,
        h: float,
        rows: int,
        stride: int,
        observer: _lib.Observer | None,
    ) -> None:
        self.system = system
        self.scheme = scheme
        self.t0, self.h, self.rows, self.stride = t0, h, rows, stride
        self.observer = observer
        self.x = np.empty((rows + 1, 2 * system.n))
        self.reactions = np.empty((rows, system.m))
        self.good = 0  # rows after row 0
        self.status = lib.DAL_SUCCESS
        self.error: BaseException | None = None
        self.done = ffi.new("size_t *")

    def make(self, report: Callable[[int], Any]) -> None:
        """Make the run in blocks, between which Python sees Ctrl-C and shows the progress."""
        try:
            for start, count in self.blocks():
                self.block(start, count)
                report(self.good * self.stride)
                if self.status != lib.DAL_SUCCESS:
                    return
        except BaseException as error:  # KeyboardInterrupt too: what was computed goes with it
            self.status, self.error = lib.DAL_EUSER, error

    def blocks(self) -> Iterator[tuple[int, int]]:
        """Yield (first row, number of rows); also for no rows, so that row 0 is observed."""
        raise NotImplementedError

    def block(self, start: int, count: int) -> None:
        """Compute the rows after ``start``; set ``good``, and ``status`` and ``error``."""
        raise NotImplementedError

    def stats(self) -> Statistics:
        """Return what the run has cost so far."""
        raise NotImplementedError

    def time(self, row: int) -> float:
        """Return the time of a stored state."""
        return self.t0 + row * self.stride * self.h

    def observe(self, row: int) -> bool:
        """Show a stored state to the observer; return whether it wants to stop."""
        n = self.system.n
        x = self.x[row].copy()
        x.flags.writeable = False
        return self.observer is not None and self.observer.see(
            row * self.stride, self.time(row), x[:n], x[n:]
        )

    def solution(self) -> Solution:
        """Return the rows that are good."""
        t = self.time(self.good)
        messages = {
            lib.DAL_SUCCESS: f"{self.good * self.stride} steps to t = {t:g}",
            lib.DAL_STOPPED: f"an observer stopped the run at t = {t:g}",
        }
        return Solution(
            system=self.system,
            scheme=self.scheme,
            x=self.x[: self.good + 1],
            reactions=self.reactions[: self.good],
            t0=self.t0,
            h=self.h,
            stride=self.stride,
            stats=self.stats(),
            status=self.status,
            message=messages.get(self.status, f"{type(self.error).__name__}: {self.error}"),
        )


class _SchemeRun(_Run):
    """A run of a stepper."""

    def start(self, x0: Array, consistency: int, initial: int, options: Any) -> None:
        """Make the stepper and check the initial data; what is raised here has no part of a run."""
        handle = self.system._handle
        self.stepper = _lib.make("stepper", handle, self.scheme._record, options, owner=handle)
        status = _lib.attempt(
            lib.dal_stepper_start, self.stepper, self.t0, self.h, _lib.pointer(x0), consistency,
            initial,
        )  # fmt: skip
        if status < 0:
            raise _lib.failure(status, self.message(), step=0, t=self.t0)
        self.x[0] = self.state()
        observed = self.observer is not None
        self.context = ffi.new_handle(self.observer) if observed else ffi.NULL
        self.trampoline = lib.dal_py_observer if observed else ffi.NULL

    def state(self) -> Array:
        return _lib.doubles(lib.dal_stepper_state(self.stepper), 2 * self.system.n)

    def message(self) -> str:
        return _lib.string(lib.dal_stepper_message(self.stepper))

    def stats(self) -> Statistics:
        return Statistics._read(self.stepper)

    def blocks(self) -> Iterator[tuple[int, int]]:
        start, count = 0, 16 if self.stride <= BLOCK_STEPS else 1
        while start < self.rows or start == 0:
            count = min(count, self.rows - start)
            began = time.perf_counter()
            yield start, count
            elapsed = max(time.perf_counter() - began, 1e-9)
            start += max(count, 1)
            count = max(1, int(count * min(8.0, BLOCK_SECONDS / elapsed)))

    def block(self, start: int, count: int) -> None:
        if self.stride <= BLOCK_STEPS or count == 0:
            status = _lib.attempt(
                lib.dal_integrate, self.stepper, count * self.stride, self.stride,
                _lib.pointer(self.x, start), _lib.pointer(self.reactions, start),
                self.trampoline, self.context, self.done,
            )  # fmt: skip
            self.good = start + int(self.done[0]) // self.stride
            self.end(status)
            return
        for row in range(start, start + count):
            if self.observe(row):
                self.end(lib.DAL_STOPPED)
            else:
                self.long_interval(row)
            if self.status != lib.DAL_SUCCESS:
                return

    def long_interval(self, row: int) -> None:
        """Go from one stored state to the next in pieces, always the same ones: so are the bits."""
        total = np.zeros(self.system.m)
        mean = np.empty(self.system.m)
        for begin in range(0, self.stride, BLOCK_STEPS):
            steps = min(BLOCK_STEPS, self.stride - begin)
            status = _lib.attempt(
                lib.dal_advance, self.stepper, steps, _lib.pointer(mean), self.done
            )
            if status != lib.DAL_SUCCESS:
                self.end(status)
                return
            total += steps * mean
        self.x[row + 1] = self.state()
        self.reactions[row] = total / self.stride
        self.good = row + 1
        if self.good == self.rows and self.observe(self.good):
            self.end(lib.DAL_STOPPED)

    def end(self, status: int) -> None:
        """Take over a status, with the exception that belongs to it."""
        self.status = status
        if status < 0:
            step = self.stats().steps
            t = lib.dal_stepper_time(self.stepper)
            self.error = _lib.failure(status, self.message(), step=step, t=t)


class _FlowRun(_Run):
    """A run of the reference flow.

    Its blocks have a fixed number of rows, because the integrator starts anew in each: the bits
    must not depend on how fast the machine is.
    """

    def start(self, x0: Array, consistent: str, method: int, tolerance: float) -> None:
        """Make the flow and check the initial data; what is raised here has no part of a run."""
        handle = self.system._handle
        self.flow = _lib.make("flow", handle, method, tolerance, owner=handle)
        self.initial = _bring_into_D(self.system, x0, consistent, self.t0)
        self.x[0] = x0
        self.reactions.fill(np.nan)

    def stats(self) -> Statistics:
        residual, correction = self.initial
        return Statistics(
            steps=self.good * self.stride,
            initial_residual=residual,
            initial_correction=correction,
            differenced=self.system.differenced,
            evaluations=int(lib.dal_flow_evaluations(self.flow)),
        )

    def blocks(self) -> Iterator[tuple[int, int]]:
        for start in range(0, max(self.rows, 1), FLOW_ROWS):
            yield start, min(FLOW_ROWS, self.rows - start)

    def block(self, start: int, count: int) -> None:
        if start == 0 and self.observe(0):
            self.status = lib.DAL_STOPPED
            return
        status = _lib.attempt(
            lib.dal_flow_trajectory, self.flow, self.time(start), self.stride * self.h, count,
            _lib.pointer(self.x, start), self.done,
        )  # fmt: skip
        if status < 0:
            message = _lib.string(lib.dal_flow_message(self.flow))
            good = start + int(self.done[0])
            self.error = _lib.failure(status, message, step=good * self.stride, t=self.time(good))
        for row in range(start + 1, start + 1 + int(self.done[0])):
            self.good = row
            if self.observe(row):
                self.status, self.error = lib.DAL_STOPPED, None
                return
        self.status = status


class Reference(NamedTuple):
    """A state of the reference flow.

    Attributes
    ----------
    q, v : ndarray, shape (n,)
    accuracy : float
        Estimate of the error, the largest component of the difference to the result at a
        tolerance ten times as large.
    """

    q: Array
    v: Array
    accuracy: float


def reference(
    system: System,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    t: float = 1.0,
    t0: float = 0.0,
    method: str = "rk8pd",
    tolerance: float = 1e-13,
) -> Reference:
    """Return the state of the ODE on D at one time, by an adaptive method of GSL.

    One call of C: for an interval so long that it may be interrupted, use
    ``integrate(system, "reference", ...)``.

    Parameters
    ----------
    system : System
    q0, v0 : array_like, shape (n,), optional
        State at t0, in D, in the user's units.  Default: the system's.
    t, t0 : float, optional
        Times; ``t < t0`` is allowed.
    method : {"rk8pd", "msadams", "msbdf"}, optional
        Prince-Dormand 8(9), Adams, or BDF for stiff potentials.
    tolerance : float, optional
        Relative and absolute, for each step, in (0, 0.1].

    Returns
    -------
    Reference

    Raises
    ------
    ValueError
        If an argument is out of range.
    NotOnConstraintError
        If the initial data are not in D.
    SingularError, ConvergenceError, DomainError
        If the flow could not go on.

    Examples
    --------
    >>> import dalembert as dal
    >>> particle = dal.systems.particle()
    >>> end = dal.reference(particle, t=1.0)
    >>> bool(abs(end.q - particle.exact(1.0)[0]).max() < 1e-11)
    True
    """
    t, t0 = _lib.number(t, "t"), _lib.number(t0, "t0")
    x = np.concatenate(geometry.initial(system, q0, v0))
    flow_method = _lib.choice(method, "method", METHODS)
    tolerance = _lib.number(tolerance, "tolerance")
    flow = _lib.make("flow", system._handle, flow_method, tolerance, owner=system._handle)
    _bring_into_D(system, x, "check", t0)
    accuracy = ffi.new("double *")
    status = _lib.attempt(lib.dal_flow_apply, flow, t0, t, _lib.pointer(x), accuracy)
    if status < 0:
        raise _lib.failure(status, _lib.string(lib.dal_flow_message(flow)))
    return Reference(x[: system.n], x[system.n :], float(accuracy[0]))


# ---- arguments -----------------------------------------------------------------------------


def _integer(value: Any, name: str, least: int, most: float = 2**63 - 1) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        raise ValueError(f"{name} = {value!r}: expected an integer") from None
    if not least <= number <= most:
        raise ValueError(f"{name} = {number}: expected {least} .. {most}")
    return number


def _number_of_steps(t0: float, h: float, t_end: float | None, steps: int | None) -> int:
    """Return the number of steps; h is never changed to make it an integer."""
    if (t_end is None) == (steps is None):
        given = "none" if steps is None else "both"
        raise ValueError(f"t_end and steps: expected one of them, got {given}")
    if t_end is None:
        return _integer(steps, "steps", 0, math.inf)  # the memory says how many
    t_end = _lib.number(t_end, "t_end")
    ratio = (t_end - t0) / h
    if ratio < 0.0:
        raise ValueError(f"t_end = {t_end:g} lies before t0 = {t0:g} in the direction of h = {h:g}")
    if not math.isfinite(ratio):
        raise ValueError(f"h = {h:g} is too small for t_end - t0 = {t_end - t0:g}")
    steps = round(ratio)
    if abs(ratio - steps) > 1e-9 * max(1.0, ratio):
        few, many = math.floor(ratio), math.ceil(ratio)
        sizes = [f"{(t_end - t0) / k!r}" for k in (many, few) if k > 0]
        raise ValueError(
            f"t_end = {t_end!r} is {ratio:.10g} steps of h = {h!r} from t0 = {t0!r}: take "
            f"t_end = {t0 + few * h!r} or {t0 + many * h!r}, or h = {' or '.join(sizes)}"
        )
    return steps


def _require_memory(system: System, rows: int, steps: int, stride: int) -> None:
    """Refuse a run whose arrays do not fit, before anything is allocated."""
    size = 8 * ((rows + 1) * (2 * system.n + 1) + rows * system.m)
    memory = _available_memory() if size > 2**24 else sys.maxsize  # which takes a while to ask
    if size > memory:
        raise MemoryError(
            f"steps = {steps} with stride = {stride} are {rows + 1} stored states, {size} bytes "
            f"({size / 2**30:.4g} GiB); this machine has {memory / 2**30:.4g} GiB: store fewer "
            "with a larger stride"
        )
    _integer(steps, "steps", 0)


def _available_memory() -> int:
    """Return the bytes that can be had without swapping, as far as the machine tells."""
    with contextlib.suppress(OSError, StopIteration, ValueError):
        with open("/proc/meminfo", encoding="ascii") as lines:
            line = next(line for line in lines if line.startswith("MemAvailable:"))
        return int(line.split()[1]) * 1024
    with contextlib.suppress(AttributeError, OSError, ValueError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return sys.maxsize


def _bring_into_D(system: System, x: Array, consistent: str, t0: float) -> tuple[float, float]:
    """Do with ``x`` what the core does with initial data; return residual and correction."""
    residual = float(geometry.trajectory(system, x[np.newaxis], "relative", None)[0])
    if consistent == "check" and not residual <= CONSISTENT:
        raise NotOnConstraintError(
            f"the initial data are not in D: |mu v| = {residual:.3g} sum |mu_i v_i|, expected at "
            f"most {CONSISTENT:g} of it; consistent='project' would project them",
            step=0,
            t=t0,
        )
    if consistent == "assume":
        return residual, 0.0
    return residual, float(geometry.projection(system, x[np.newaxis])[0])


@contextlib.contextmanager
def _progress(
    progress: bool | Callable[[int, int], Any], total: int
) -> Iterator[Callable[[int], Any]]:
    """Give a function of the number of steps made."""
    if callable(progress):
        yield lambda done: progress(done, total)
    elif progress:
        try:
            from tqdm.auto import tqdm
        except ImportError as error:
            raise ImportError("progress=True needs tqdm: pip install tqdm") from error
        with tqdm(total=total, unit="step", unit_scale=True) as bar:
            yield lambda done: bar.update(done - bar.n)
    else:
        yield lambda done: None


def _warn(solution: Solution) -> None:
    """Warn where a run that went through is doubtful."""
    stats, n = solution.stats, solution.system.n
    bound = 4 * n * 2.0**-53
    if stats.worst_residual > 10 * bound:
        warnings.warn(
            f"the constraint is kept to {stats.worst_residual:.1e} only, expected {bound:.1e}; "
            "mu may be badly conditioned or not smooth",
            DalembertWarning,
            stacklevel=3,
        )
    if stats.full_newtons > 0.1 * stats.substeps:
        warnings.warn(
            f"{stats.full_newtons} of {stats.substeps} sub-steps needed the Hessian of V: "
            f"h = {solution.h:g} is large for this potential",
            DalembertWarning,
            stacklevel=3,
        )
