"""The result of a run: states, and quantities computed from them on first use."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import core, geometry
from ..core import Array, arguments, ffi, functions, lib, require_system
from ..system import System
from . import between
from .dense import Dense
from .scheme import Scheme
from .steps import how


@dataclass(frozen=True)
class Statistics:
    """Counters and diagnostics of a run.

    Attributes
    ----------
    steps, substeps : int
        Number of steps, and of systems of equations solved in them.
    iterations : int
        Newton iterations.
    constraint_calls, potential_calls, lagrangian_calls, force_calls : int
        Calls of the system's functions.
    corrections : int
        Final corrections onto D that took an additional evaluation.
    rejected : int
        Error-controlled or reversible steps that were repeated with a shorter step.
    uncontrolled : int
        Error-controlled steps longer than the tolerance allows, as the estimate of their error is
        roundoff.
    scaled, unscaled : int
        Steps repeated with scaled velocities to keep the energy; steps for which this was not
        possible, so that the energy changed.
    resets : int
        Irreversible steps of "reversible", in which the time scale of the motion changed too fast.
    full_newtons : int
        Sub-steps solved by the full Newton iteration: all sub-steps of a general system; otherwise
        those that needed the Hessian of V.
    halvings : int
        Newton steps halved because a function left its domain.
    worst_residual : float
        Largest relative residual, after any step, of the set that the scheme preserves.
    initial_residual, initial_correction : float
        Relative residual of the initial data, and the distance by which they were moved, in the
        mass metric.
    differenced : tuple of str
        Derivatives that were replaced by central differences.
    evaluations : int
        Evaluations of the vector field by "reference"; series and examined slopes by "taylor".
    jump_step, jump, largest_kinetic : int, float, float
        The first step at which the energy was found changed by more than half of the largest
        kinetic energy, the change, and that kinetic energy.  The step is 0 if there is none.
        Changes undone by ``energy="keep"`` count.  The energy is checked every 64 steps and at the
        end.  No check if something does work, or the scheme is of order 1.
    least_pivot, least_pivot_t : float
        Least pivot of C = mu M^-1 mu^T, relative to the largest pivot of the same row so far, and
        its time.  It is 1 if no pivot became smaller.  A pivot near 0 means that the constraints
        lose rank there, as at the dead centre of a linkage.
    least_pivot_rows : tuple of int
        Numbers of the constraints that contribute to this pivot; empty if unknown.
    rank_doubts : int
        Number of checks at which a pivot was so small that numerical errors may decide which branch
        the motion follows.
    least_step, least_step_t : float
        Shortest step of a run with variable steps, relative to the mean of the steps before it, and
        its time.  It is 1 for steps of fixed size.
    error : float
        Approximate error of the last state, relative to its size.  The size of a q is its range in
        the run, that of a v its largest absolute value.  No size counts as less than 1e-3 of the
        largest of its kind.  The value is nan if there is no estimate.  It is inf if steps of h / 2
        failed and the steps of h are suspect.  After `resume`, and in suspect runs after a reset,
        only the steps since then can be repeated.  Their error is reported only above 0.05, which
        means that h is too large; otherwise the value is nan.
    remade : int
        Steps of another size that were taken for this estimate.
    whole : int
        1 if the estimate repeats the whole run, or its first 131072 steps.  2 if it repeats the
        steps since a reset or since `resume`.  If 0, it repeats samples and adds up their errors;
        the sum usually exceeds the error.
    """

    steps: int = 0
    substeps: int = 0
    iterations: int = 0
    constraint_calls: int = 0
    potential_calls: int = 0
    lagrangian_calls: int = 0
    force_calls: int = 0
    corrections: int = 0
    full_newtons: int = 0
    halvings: int = 0
    worst_residual: float = 0.0
    initial_residual: float = 0.0
    initial_correction: float = 0.0
    differenced: tuple[str, ...] = ()
    evaluations: int = 0
    jump_step: int = 0
    jump: float = 0.0
    largest_kinetic: float = 0.0
    error: float = field(default=np.nan, compare=False)  # not after a restart
    remade: int = field(default=0, compare=False)
    whole: int = field(default=0, compare=False)
    rejected: int = 0
    scaled: int = 0
    unscaled: int = 0
    resets: int = 0
    uncontrolled: int = 0
    least_pivot: float = 1.0
    least_pivot_t: float = 0.0
    least_pivot_rows: tuple[int, ...] = ()
    rank_doubts: int = 0
    least_step: float = 1.0
    least_step_t: float = 0.0

    @classmethod
    def _of(cls, counts: Any, kind: str) -> Statistics:
        """Return the statistics in a ``dal_stats``."""
        differenced = functions.differenced(counts.differenced, kind) if counts.differenced else ()
        self = cls.__new__(cls)  # whose __init__ takes as long again
        rows = _rows_of(counts.least_pivot_rows)
        self.__dict__.update(
            core.members(counts), differenced=differenced, least_pivot_rows=rows
        )  # fmt: skip
        return self


def counts_of(stepper: Any) -> Any:
    """Return the ``dal_stats`` of a stepper."""
    counts = ffi.new("dal_stats *")
    lib.dal_stepper_stats(stepper, counts)
    return counts


def _rows_of(given: Any) -> tuple[int, ...]:
    """Return the rows that C encodes as a sum of powers of 2."""
    return given if isinstance(given, tuple) else tuple(a for a in range(52) if int(given) >> a & 1)


def rank_doubt(stats: Any) -> str:
    """Return a message that says where the constraints nearly lose rank."""
    rows = [f"constraints[{a}]" for a in _rows_of(stats.least_pivot_rows)] or ["the constraints"]
    return (
        f"near t = {stats.least_pivot_t:g} {' and '.join(rows)} nearly lost rank: the least "
        f"pivot of mu M^-1 mu^T was {stats.least_pivot:.1e} of its usual size. If branches of "
        "the motion meet there, as at a dead centre, the errors of the steps choose the "
        "branch. Compare runs with other steps or tolerances"
    )


class _Counted:
    """The statistics of a run, created on first use."""

    def __get__(self, run: Any, owner: Any) -> Statistics:
        if run is None or run._counts is None:
            raise AttributeError("stats")
        made = Statistics._of(run._counts, run.system.kind)
        return run.__dict__.setdefault("stats", made)  # type: ignore[no-any-return]


@dataclass(frozen=True, eq=False)
class States:
    """States of a run at times between the stored ones.

    Attributes
    ----------
    t : float or ndarray, shape (N,)
    q, v : ndarray, shape (n,) or (N, n)
    chart_changes : int
        Number of changes, from one of these states to the next, of the dependent coordinates used
        in the interpolation.
    """

    t: Any
    q: Array
    v: Array
    chart_changes: int


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Solution(Mapping[str, Any]):
    """The result of a run: states, and quantities computed from them on first use.

    A solution is also a mapping of its arrays, numbers and texts, so ``np.savez(file, **run)``
    writes them, and ``len`` is the number of keys.  Its arrays are read-only; modify a copy such as
    ``run.q.copy()``.

    Attributes
    ----------
    t : ndarray, shape (N+1,)
        Times of the states, in the user's units: ``t0 + k * h * stride``, or ``t_eval`` if given,
        or the times of the stored steps if their size varies.  If a terminal event ended the run,
        the last time is that of the event.
    q, v : ndarray, shape (N+1, n)
        Views of ``x``.
    x : ndarray, shape (N+1, 2n)
        The states (q, v), without a copy of the array written by C.
    y : ndarray, shape (2n, N+1)
        ``x`` transposed, a view, as in SciPy.
    multipliers : ndarray, shape (N+1, m)
        The forces lambda(q, v) at the stored states, by their formula.  They do not include jumps
        of the velocity at changes of the inputs of constraints.
    reactions : ndarray, shape (N, m)
        The scheme's own multipliers: mean forces over the intervals between stored states,
        including the impulses of jumps.  Each belongs to the middle of its interval.  NaN for the
        reference flow, which has none, and with ``t_eval``.
    energy : ndarray, shape (N+1,)
    constraint : ndarray, shape (N+1, m)
        phi(q, v), which is mu(q) v for linear constraints.
    residual : ndarray, shape (N+1,)
        Relative residual (see `System.relative_residual`) of the set that the scheme preserves: D
        for moved nodes, D_eps (phi at q - shift v) for kept nodes.
    inputs : ndarray, shape (holds, k)
        Row i applies to the steps i * hold, ..., (i + 1) * hold - 1. No rows: the inputs are 0.
        The multipliers of a state use the inputs of the step that begins there.  If constraints
        depend on inputs, multipliers and residual use the inputs of the step that ended there.
    t_events : tuple of ndarray, shape (K,)
        The times of each event.
    q_events, v_events : tuple of ndarray, shape (K, n)
        The states at these times, in D, before a reset.
    q_after, v_after : tuple of ndarray, shape (K, n)
        The states after the reset, NaN if there was none.
    system : System
    scheme : Scheme
    h : float
        Step size; there are ``stride`` steps between stored states.  NaN if the step size varies.
    control : dict
        The control of the step size, such as ``{"h": "auto", "tolerance": 1e-9}``; empty for steps
        of fixed size.
    hold : float
        Number of steps for which a row of ``inputs`` applies; a time if the step size varies.
    stride : int
    dense : Dense or None
        The polynomials of the steps, if asked for.
    nodes : {"moved", "kept"}
    shift : float
        0 for moved nodes, (1 - beta) h for kept ones.
    stats : Statistics
    success : bool
        True unless a step failed.  A run stopped by an observer or an event is a success.
    status : int
        ``dal_status`` of the C library: 0 for success, 1 if an observer or an event stopped the
        run, negative if a step failed.
    message : str
        The end of the run in words.

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.particle(), "midpoint", h=0.01, t_end=10)
    >>> run.q.shape, run["energy"].shape
    ((1001, 3), (1001,))
    """

    _KEYS = (
        "t", "q", "v", "multipliers", "reactions", "energy", "constraint", "residual", "h",
        "success", "status", "message", "y", "x", "nodes", "shift", "stride", "inputs", "hold",
    )  # fmt: skip

    system: System
    scheme: Scheme
    x: Array
    reactions: Array
    t0: float
    h: float
    stride: int
    stats: Statistics = _Counted()  # type: ignore[assignment]
    status: int
    message: str
    times: Array | None = None
    inputs: Array | None = None
    hold: float = 1
    control: Mapping[str, Any] = field(default_factory=dict)
    t_events: tuple[Array, ...] = ()
    x_events: tuple[Array, ...] = ()
    x_after: tuple[Array, ...] = ()
    dense: Dense | None = None
    _computed: dict[str, Array] = field(default_factory=dict, init=False)
    _counts: ClassVar[Any] = None  # the dal_stats, where there are no stats yet

    @classmethod
    def _made(cls, **given: Any) -> Solution:
        """Return the solution of a run by this library, without checks of its arrays.

        ``given`` has control, and stats or _counts.
        """
        self = cls.__new__(cls)
        self.__dict__.update(given, _computed={})
        self._freeze()
        return self

    def _freeze(self) -> None:
        """Make the arrays read-only."""
        events = self.t_events + self.x_events + self.x_after
        for array in (self.x, self.reactions, self.inputs, self.times, *events):
            if array is not None:
                array.setflags(write=False)

    def __post_init__(self) -> None:
        require_system(self.system)
        if not isinstance(self.scheme, Scheme):
            raise ValueError(f"scheme = {self.scheme!r}: expected a dalembert.Scheme")
        arguments.number(self.t0, "t0")
        if not self.control:
            arguments.number(self.h, "h")
            arguments.integer(self.hold, "hold", 1)
        arguments.integer(self.stride, "stride", 1)
        n, m = self.system.n, self.system.m
        x = self.x  # that of a file is as it was checked there, and stays there
        if not isinstance(x, np.memmap):
            x = arguments.array(x, "x", (None, 2 * n))
        reactions = np.asarray(self.reactions, dtype=float)  # NaN for the reference flow
        if len(x) == 0 or reactions.shape != (len(x) - 1, m):
            raise ValueError(
                f"x and reactions: expected shapes (N+1, {2 * n}) and (N, {m}), "
                f"got {x.shape} and {reactions.shape}"
            )
        width = len(self.system.inputs)
        inputs = np.zeros((0, width)) if self.inputs is None else self.inputs
        arrays = {
            "x": x, "reactions": reactions,
            "inputs": arguments.array(inputs, "inputs", (None, width)),
        }  # fmt: skip
        if self.control and self.times is None:
            raise ValueError(
                "times is missing: the steps differ in size, so pass the times of the states"
            )
        if self.times is not None:
            arrays["times"] = arguments.array(self.times, "times", (len(x),))
        for name, array in arrays.items():
            object.__setattr__(self, name, array[:])
        for name in ("t_events", "x_events", "x_after"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        self._freeze()

    @property
    def success(self) -> bool:
        """True unless a step failed."""
        return self.status >= 0

    @property
    def nodes(self) -> str:
        """The nodes of the scheme: "moved" or "kept"."""
        return self.scheme.nodes

    @property
    def shift(self) -> float:
        """0 for moved nodes, (1 - beta) h for kept nodes."""
        return self.scheme.shift(self.h) if self.nodes == "kept" else 0.0

    @property
    def t(self) -> Array:
        """Times of the states, shape (N+1,)."""
        if self.times is not None:
            return self.times
        return self._once("t", lambda: self.t0 + np.arange(len(self.x)) * self.stride * self.h)

    @property
    def q(self) -> Array:
        """Coordinates, shape (N+1, n), a view."""
        return self.x[:, : self.system.n]

    @property
    def v(self) -> Array:
        """Velocities, shape (N+1, n), a view."""
        return self.x[:, self.system.n :]

    @property
    def q_events(self) -> tuple[Array, ...]:
        """Coordinates at each event, shape (K, n)."""
        return tuple(x[:, : self.system.n] for x in self.x_events)

    @property
    def v_events(self) -> tuple[Array, ...]:
        """Velocities at each event, before a reset, shape (K, n)."""
        return tuple(x[:, self.system.n :] for x in self.x_events)

    @property
    def q_after(self) -> tuple[Array, ...]:
        """Coordinates after the resets of each event, shape (K, n)."""
        return tuple(x[:, : self.system.n] for x in self.x_after)

    @property
    def v_after(self) -> tuple[Array, ...]:
        """Velocities after the resets of each event, shape (K, n)."""
        return tuple(x[:, self.system.n :] for x in self.x_after)

    @property
    def y(self) -> Array:
        """States, shape (2n, N+1), a view."""
        return self.x.T

    @property
    def multipliers(self) -> Array:
        """lambda(q, v) by its formula, shape (N+1, m)."""
        return self._evaluate("multipliers", "multipliers")

    @property
    def energy(self) -> Array:
        """Energy, shape (N+1,)."""
        return self._evaluate("energy", "energy")

    @property
    def constraint(self) -> Array:
        """The constraint phi(q, v), shape (N+1, m)."""
        return self._evaluate("constraint", "residual")

    @property
    def residual(self) -> Array:
        """Relative residual of the set that the scheme preserves, shape (N+1,)."""
        return self._evaluate("residual", "relative", self.shift)

    def _evaluate(self, name: str, output: str, shift: float = 0.0) -> Array:
        """Return a quantity of the stored states."""
        given: dict[str, Any] = {"shift": shift, "inputs": self._inputs_of_rows()}
        timeless = not (self.system.is_forced or self.system.is_time_dependent)
        if self.times is None and (timeless or self.stride == 1):
            given |= {"t0": self.t0, "h": self.stride * self.h}
        else:  # t0 + k (stride h) and t0 + (k stride) h may differ in their last bit
            given["times"] = self.t
        return self._once(
            name, lambda: geometry.trajectory(self.system, self.x, output, **given)
        )

    def _inputs_of_rows(self) -> Array:
        """Return the inputs for each stored state.

        They are the inputs of the step that begins there.  If constraints depend on inputs they are
        those of the step that ended there, which the velocity satisfies.
        """
        if self.system.is_driven:
            return self._inputs_before_rows()
        if self.times is not None:
            return self._inputs_at(self.times)
        return self._rows_of_inputs(np.arange(len(self.x)) * self.stride // int(self.hold))

    def _inputs_before_rows(self) -> Array:
        """Return the inputs of the steps that ended at the stored states."""
        if self.times is None:
            last = np.arange(len(self.x)) * self.stride - 1
            return self._rows_of_inputs(last.clip(0) // int(self.hold))
        nearest, side = self._in_spans(self.times)
        rows = nearest - (side <= 0)
        if not self.control:
            rows //= int(self.hold)
        # a row at the time of the one before, and that of a terminal event, may be after a jump
        rows[1:] += self.times[1:] == self.times[:-1]
        if any(self.times[-1] in t[-1:] for t in self.t_events):
            rows[-1] = len(self.inputs) - 1
        return self._rows_of_inputs(rows.clip(0))

    def _inputs_at(self, times: Array) -> Array:
        """Return the inputs of the steps that begin, or continue, at the given times."""
        nearest, side = self._in_spans(times)
        rows = nearest - (side < 0)
        return self._rows_of_inputs(rows if self.control else rows // int(self.hold))

    def _in_spans(self, times: Array) -> tuple[NDArray[np.int_], Array]:
        """Return the number of the nearest time at which a step or a row of inputs begins, and the
        side.

        Side 0 means within rounding; C assigns an output time there to the step before.
        """
        size = self.h
        if self.control and self.times is not None:  # rows of inputs are as steps of others
            size = float(np.copysign(self.hold, self.times[-1] - self.t0))
        nearest = np.rint((times - self.t0) / size)
        begin = self.t0 + nearest * size
        rounding = 2.0 * np.finfo(float).eps * np.maximum(np.abs(times), np.abs(begin))
        off = np.sign(size) * (times - begin)
        return nearest.astype(int), np.where(np.abs(off) <= rounding, 0.0, np.sign(off))

    def _rows_of_inputs(self, rows: NDArray[np.int_]) -> Array:
        """Return the inputs of these rows; the last row applies to all later ones."""
        assert self.inputs is not None
        if len(self.inputs) == 0:
            return np.zeros((len(rows), len(self.system.inputs)))
        return self.inputs[np.minimum(rows, len(self.inputs) - 1)]

    def _once(self, name: str, compute: Callable[[], Array]) -> Array:
        """Compute an array on first use.

        There is no lock, which a fork would leave locked: the first of two threads to end wins.
        """
        if name not in self._computed:
            self._computed.setdefault(name, compute())
        self._computed[name].setflags(write=False)
        return self._computed[name]

    def __call__(self, t: ArrayLike) -> States:
        """Return the states at times between the stored ones, in the set that the scheme preserves.

        Positions and velocities of independent coordinates are interpolated by polynomials; the
        constraint determines the other velocities.  So the states lie in D, or in D_eps for kept
        nodes, to roundoff.  With respect to the distance of the stored states, their error has the
        order of the scheme, up to 4.  A stored state is returned unchanged.

        If the step size varies, or there are inputs, steps of the scheme lead to the states, each
        from the stored state before.  They have the error of the run.  Each costs one step, or as
        many as there are between two stored states.  With "taylor" it is always so, and all states
        within a step come from its polynomial; with ``dense=True`` from that of the run.

        Parameters
        ----------
        t : array_like, shape () or (N,)
            Times in the user's units, in any order.

        Returns
        -------
        States
            Has ``t``, ``q`` and ``v``.

        Raises
        ------
        ValueError
            If a time is not finite or lies outside the run, or if the state was reset between the
            two stored states around it.  Also for a run with ``t_eval``, and for times between kept
            nodes if there are inputs.
        SingularError, DomainError
            If the constraints lose rank at a state, or a function is not defined there.

        Examples
        --------
        >>> import dalembert as dal
        >>> system = dal.systems.particle()
        >>> run = dal.integrate(system, "midpoint", h=0.1, t_end=10)
        >>> state = run(2.345)
        >>> bool(system.relative_residual(state.q, state.v) < 1e-15)
        True
        >>> run([0.15, 0.25, 0.35]).q.shape
        (3, 3)
        """
        times = arguments.array(t, "t", (), (None,))
        flat = times.reshape(-1)
        x, changes = np.empty((flat.size, 2 * self.system.n)), 0
        assert self.inputs is not None
        if self.dense is not None:
            x[...] = self.dense.states(flat)
        elif self.control or len(self.inputs) or self.scheme.family == "taylor":
            between.fill(self, flat, x)
        else:
            for first, rows, these in self._pieces(flat):
                x[these], some = self._interpolate(flat[these], first, rows)
                changes += some
        x = x.reshape(*times.shape, 2 * self.system.n)
        n = self.system.n
        return States(times if times.ndim else float(times), x[..., :n], x[..., n:], changes)

    def _pieces(self, t: Array) -> Iterator[tuple[int, int, Any]]:
        """Yield the smooth pieces between resets: first row, number of rows, mask of times.

        A last row at which the run ended is a piece of its own.
        """
        h, count = self.stride * self.h, len(self.x)
        if self.times is not None:
            grid = self.t0 + np.arange(count) * h
            if not np.array_equal(self.times[:-1], grid[:-1]):
                raise ValueError(
                    "t: expected times of t_eval, because no states are computed between them"
                )
            count -= 1
        at = [x[~np.isnan(a).any(axis=1)] for x, a in zip(self.t_events, self.x_after)]
        place = np.sort(np.concatenate([*at, np.zeros(0)]) - self.t0) / h
        ends = [-1, *np.unique(np.ceil(place).astype(int) - 1).tolist(), count - 1]
        found = (t - self.t0) / h
        slack = 4e-16 * np.maximum(np.abs(t), np.abs(self.t0)) / abs(h)
        left = np.ones(len(t), dtype=bool)
        for before, last in zip(ends, ends[1:]):
            low = -np.inf if before < 0 else before + 1 - slack
            high = np.inf if last == count - 1 and self.times is None else last + slack
            these = left & (found >= low) & (found <= high)
            left &= ~these
            if these.any():
                yield before + 1, last - before, these
        if self.times is not None and (left & (t == self.times[-1])).any():
            these = left & (t == self.times[-1])
            left &= ~these
            yield count, 1, these
        if left.any():
            raise ValueError(
                f"t = {t[left][0]:g}: the state was reset, or the run ended, between the two "
                "stored states; for states there, pass t_eval to integrate"
            )

    def _interpolate(self, flat: Array, first: int, rows: int) -> tuple[Array, int]:
        """Return states interpolated from some rows, and the number of changes of charts."""
        n, h = self.system.n, self.stride * self.h
        stored = np.ascontiguousarray(self.x[first : first + rows])
        if first == len(self.x) - 1 and self.times is not None:
            return stored, 0
        t0 = self.t0 + first * h
        x = np.empty((flat.size, 2 * n))
        changes, some = 0, ffi.new("size_t *")
        chart = self.system._c("chart")
        before = flat[:0]  # the last time between stored states: seen again for a change after it
        most = geometry.most_in_a_call(self.system)
        for start in range(0, flat.size, most):
            these = np.concatenate([before, flat[start : start + most]])
            part = np.empty((len(these), 2 * n))
            core.call(
                self.system.kind, lib.dal_chart_interpolate, chart, t0, h, self.shift,
                rows, core.pointer(stored, 0, rows * 2 * n), len(these), core.pointer(these),
                core.pointer(part, output=True), some, ffi.NULL,
            )  # fmt: skip
            changes += int(some[0])
            x[start : start + most] = part[len(before) :]
            nearest = np.rint((these - t0) / h).astype(int).clip(0, rows - 1)
            before = these[(part != stored[nearest]).any(axis=1)][-1:]
        return x, changes

    def __getitem__(self, key: str) -> Any:
        if key not in self._KEYS:
            names = self.system.coordinates
            place = names.index(key) if key in names else None
            hint = "" if place is None else f". {key} is coordinate {place}: run.q[:, {place}]"
            raise KeyError(f"{key!r}: expected one of {', '.join(self._KEYS)}{hint}")
        return getattr(self, key)

    def __iter__(self) -> Iterator[str]:
        return iter(self._KEYS)

    def __len__(self) -> int:
        return len(self._KEYS)

    __eq__ = object.__eq__  # arrays have no truth value
    __hash__ = object.__hash__

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self._KEYS})

    def __reduce__(self) -> tuple[Any, ...]:  # by way of the constructor, which checks the arrays
        given = {x.name: getattr(self, x.name) for x in fields(self) if x.init}
        return partial(type(self), **given), (), {"_computed": self._computed}

    @property
    def _how(self) -> str:
        """The step size, or its control, in words."""
        return how(self.h, self.control)

    def __repr__(self) -> str:
        where = " at kept nodes (D_eps)" if self.nodes == "kept" else ""
        every = f", every {self.stride} steps" if self.stride > 1 else ""
        lines = [
            f"<Solution of {self.system.name} by {self.scheme.name}, {self._how}: "
            f"{'success' if self.success else 'FAILED'}",
            f"  {len(self.x)} states at t = {self.t[0]:g} .. {self.t[-1]:g}{every}",
        ]
        known = not np.isnan(self.stats.worst_residual)  # that of a journal is not
        if known and self.scheme.family != "flow" and self.system.m > 0:
            size = f"{self.stats.worst_residual:.1e}"
            lines.append(f"  constraint{where}: relative residual at most {size}")
        if np.isinf(self.stats.error):
            lines.append("  error of the last state: unknown, because a run with h / 2 failed")
        elif self.stats.error >= 0.0:
            error, bound = self.stats.error, ("at most ", "", "at least ")[self.stats.whole]
            size = f"about {error:.0e} of its size"
            if error == 0.0:
                size = "0"
            elif error >= 0.95:
                size = "as large as the state" if error < 1.5 else f"{error:.2g} times its size"
            lines.append(f"  error of the last state: {bound}{size}")
        if self.stats.scaled or self.stats.unscaled:
            lost = f", except in {self.stats.unscaled} of {self.stats.steps} steps"
            lines.append(f"  energy kept{lost if self.stats.unscaled else ''}")
        return "\n".join([*lines, f"  {self.message}>"])
