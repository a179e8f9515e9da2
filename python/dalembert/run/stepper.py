"""Single steps, for control loops outside the library."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import core, geometry
from ..core import Array, arguments, ffi, lib
from ..core.errors import raised
from ..core.records import documents, method
from .events import CONSISTENCY
from .integration import doubt_start, with_method
from .options import StepperOptions, in_c
from .scheme import Scheme
from .runs import one_row, started_stepper
from .solution import Statistics, counts_of
from .steps import how

_double = np.dtype(np.float64)


@documents(StepperOptions)
class Stepper:
    """A system, a scheme and a current state, advanced step by step.

    The states are bitwise those of `integrate`.  Use a stepper in one thread at a time.

    With "auto" and "reversible" the time increases, each step has its own size, and `until` leads
    to a time.

    Attributes
    ----------
    system : System
    scheme : Scheme

    Raises
    ------
    ValueError, NotOnConstraintError, NotImplementedError
        As for `integrate`.

    Examples
    --------
    A controller that brings a cart to the speed 1:

    >>> import dalembert as dal
    >>> cart = dal.System(mass=[2], force=lambda t, q, v, u: u, inputs=["push"], q0=[0], v0=[0])
    >>> stepper = dal.Stepper(cart, "midpoint", h=0.1)
    >>> for _ in range(100):
    ...     stepper.step([3 * (1 - stepper.v[0])])
    >>> stepper.v.round(4)
    array([1.])
    """

    @method(StepperOptions)
    def __init__(self, *args: Any, **given: Any) -> None:
        asked = StepperOptions.of("Stepper", args, given).read()
        system, scheme = asked.system, asked.scheme
        self._t0, self._control = asked.t0, asked.control
        assert isinstance(scheme, Scheme)
        self.system, varies = system, bool(self._control)
        self.scheme = with_method(scheme, None, asked.tolerance if scheme.is_flow else None)
        self._first = math.inf if varies else arguments.step_size(asked.h, self._t0)
        self._how = CONSISTENCY[asked.consistent], scheme._initial(asked.initial)
        self._x0 = geometry.initial_state(system, asked.q0, asked.v0)
        self._u0 = arguments.inputs(asked.inputs, system.inputs, 1)[0].copy()
        self._handle = started_stepper(
            system, self.scheme, self._x0, t0=self._t0, h=self._first, consistency=self._how[0],
            initial=self._how[1], options=in_c(asked.of_c), inputs=self._u0,
        )  # fmt: skip
        doubt_start(system, self._x0, self._t0, self._how[0])
        self._u = self._u0.copy()
        self._c_u = core.pointer(self._u)
        self._start = self._x0.copy()
        self._c_start = core.pointer(self._start)
        self._mean = np.full(system.m, np.nan)
        self._c_mean = core.pointer(self._mean, output=True)
        self._done = ffi.new("size_t *")
        self._bytes = 16 * system.n

    def step(self, inputs: Any = None, steps: int = 1) -> None:
        """Take one step, or several with the same inputs.

        If a step fails, the state is that after the last successful one.

        Parameters
        ----------
        inputs : array_like, shape (k,), or mapping, optional
            New inputs, as an array or by name; they apply until they are changed.  Default: no
            change.  If the constraints depend on inputs, a change moves the velocity into the new D
            before the step.
        steps : int, optional
            Number of steps; default 1.

        Raises
        ------
        ValueError
            If the inputs are invalid; no step is taken.
        SingularError, ConvergenceError, DomainError
            If a step fails; ``.step`` and ``.t`` locate it.
        Exception
            Any exception raised by a function of the system.
        """
        if inputs is not None:
            self._set(inputs)
        if type(steps) is not int or steps != 1:
            steps = arguments.integer(steps, "steps", 0)
        self._advance(steps)

    def until(self, t: float, inputs: Any = None) -> None:
        """Take steps of variable size up to a time, at which the last one ends.

        If a step fails, the state is that after the last successful one.

        Parameters
        ----------
        t : float
            A time from that of the stepper on.
        inputs : array_like, shape (k,), or mapping, optional
            As for `step`.

        Raises
        ------
        ValueError
            If the stepper has a fixed step size, or t lies before its time; no step is taken.
        SingularError, ConvergenceError, DomainError, Exception
            As for `step`.

        Examples
        --------
        >>> import dalembert as dal
        >>> stepper = dal.Stepper(dal.systems.sleigh(), h="auto", tolerance=1e-10)
        >>> stepper.until(2.5)
        >>> stepper.t
        2.5
        """
        t = arguments.number(t, "t")
        if not self._control:
            raise ValueError(
                f"t = {t!r}: until needs steps of variable size, h = 'auto' or h = 'reversible'; "
                f"this stepper has h = {self._first:g}"
            )
        core.call(self.system.kind, lib.dal_stepper_until, self._handle, t)
        try:
            if inputs is not None:
                self._set(inputs)
            begin, impulse = self.t, np.zeros(self.system.m)
            while self.t != t:
                before = self.t
                self._advance(1)
                impulse += (self.t - before) * self._mean
            if t != begin:
                self._mean[:] = impulse / (t - begin)
        finally:
            core.call(self.system.kind, lib.dal_stepper_until, self._handle, math.inf)

    def _advance(self, steps: int) -> None:
        raised.exception = None
        status = lib.dal_advance(self._handle, steps, self._c_mean, self._done)
        if status:
            self._mean[:] = np.nan
            message = core.words(self._handle, self.system.kind)
            raise core.failure(status, message, step=self.steps, t=self.t)

    def _set(self, inputs: Any) -> None:
        u, kind = self._u, type(inputs)  # u is what C takes its copy from
        if kind is np.ndarray:
            is_plain = inputs.shape == u.shape and inputs.dtype is _double
        else:
            is_plain = kind is list and len(inputs) == len(u) and {*map(type, inputs)} == {float}
        u[:] = inputs if is_plain else one_row(inputs, self.system.inputs)
        if lib.dal_stepper_input(self._handle, self._c_u):
            arguments.inputs(inputs, self.system.inputs, 1)  # which says what is wrong

    @property
    def h(self) -> float:
        """The size of the last step, or of the first one; after `restore`, of the saved state."""
        return float(lib.dal_stepper_h(self._handle))

    @property
    def x(self) -> Array:
        """The state (q, v), shape (2n,), a read-only copy."""
        return np.frombuffer(ffi.buffer(lib.dal_stepper_state(self._handle), self._bytes)[:])

    @property
    def q(self) -> Array:
        """Coordinates, shape (n,), a read-only copy."""
        return self.x[: self.system.n]

    @property
    def v(self) -> Array:
        """Velocities, shape (n,), a read-only copy."""
        return self.x[self.system.n :]

    @property
    def t(self) -> float:
        """The time; with a fixed step size ``t0 + steps * h``."""
        return float(lib.dal_stepper_time(self._handle))

    @property
    def steps(self) -> int:
        """Number of steps since the start, or since the last reset."""
        return int(counts_of(self._handle).steps)

    @property
    def inputs(self) -> Array:
        """The inputs of the next step, shape (k,), a copy."""
        return core.doubles(lib.dal_stepper_inputs(self._handle), len(self._u))

    @property
    def energy(self) -> float:
        """The energy of the current state."""
        return float(self.system._mechanics.call(lib.dal_energy, self.t, self.x, ()))

    @property
    def residual(self) -> float:
        """Relative residual of the set that the scheme preserves."""
        shift = self.scheme.shift(self.h) if self.scheme.nodes == "kept" else 0.0
        given = self.t, shift, self.x, ()
        return float(self.system._mechanics.call(lib.dal_relative_residual, *given))

    @property
    def reaction(self) -> Array:
        """Mean multipliers over the last call of `step`, shape (m,); NaN before the first."""
        return self._mean.copy()

    @property
    def stats(self) -> Statistics:
        """Counters of the steps so far."""
        return Statistics._of(counts_of(self._handle), self.system.kind)

    def save(self) -> Array:
        """Return all data that determine the following steps, as an array of numbers for `restore`.

        Raises
        ------
        NotImplementedError
            If the steps of the scheme cannot be resumed.
        """
        values = np.empty(max(int(lib.dal_stepper_saved(self._handle)), 1))
        core.call(self.system.kind, lib.dal_stepper_save, self._handle, values)
        return values

    def restore(self, saved: ArrayLike) -> None:
        """Resume from the result of `save`, also in another process, with bitwise identical steps.

        On failure the stepper is unchanged.

        Raises
        ------
        ValueError
            If the data belong to another system, scheme or version.
        """
        values = np.ascontiguousarray(saved, dtype=float).reshape(-1)
        core.call(self.system.kind, lib.dal_stepper_restore, self._handle, values, len(values))
        self._mean[:] = np.nan

    def reset(
        self, q: ArrayLike | None = None, v: ArrayLike | None = None, t: float | None = None
    ) -> None:
        """Restart from a state and a time, by default the first ones.

        The inputs are those of the constructor.  On failure the stepper is unchanged.

        Parameters
        ----------
        q, v : array_like, shape (n,), optional
            Pass both or neither.
        t : float, optional

        Raises
        ------
        ValueError, NotOnConstraintError
            As for the constructor.
        """
        arguments.pair(q, v, ("q", "v"), " for those of the start")
        x = self._x0 if q is None else geometry.initial_state(self.system, q, v, "q", "v")
        t = self._t0 if t is None else arguments.number(t, "t")
        doubt_start(self.system, x, t, self._how[0])
        before = self.inputs if self._u.size else None
        if before is not None:
            self._set(self._u0)
        self._start[:] = x
        raised.exception = None
        status = lib.dal_stepper_start(
            self._handle, t, self._first if self._control else self.h, self._c_start, *self._how
        )
        if status:
            if before is not None:
                self._set(before)
            raise core.failure(status, core.words(self._handle, self.system.kind))
        self._mean[:] = np.nan

    def __repr__(self) -> str:
        name, scheme = self.system.name, self.scheme.name
        return f"<Stepper of {name} by {scheme}, {how(self.h, self._control)}: t = {self.t:g}>"
