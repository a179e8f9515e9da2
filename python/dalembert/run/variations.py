"""Derivatives of motions: the variational equations by Taylor series."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import core, geometry
from ..core import Array, arguments, ffi, lib, require_system
from ..system import System
from ..system.twins import twin
from .scheme import Scheme

_PARTS = {1: "variations", 2: "second variations"}


@dataclass(frozen=True, eq=False)
class Variations:
    """Motions with their derivatives, see `variations`.

    For N times, K columns and n coordinates.  Given a single time, the arrays have no first axis.

    Attributes
    ----------
    t : ndarray, shape (N,)
    x : ndarray, shape (N, 2n)
        The states (q, v).
    columns : tuple of str
        The names of the K columns: those of coordinates and quasi-velocities, parameters, inputs.
    dx : ndarray, shape (N, 2n, K)
        The derivatives of x by each.  They are tangent to D to roundoff.
    d2x : ndarray, shape (N, 2n, K, K), or None
        The second derivatives, along straight lines in (q, w, parameters, inputs).
    rate : ndarray, shape (N, 2n)
        The derivative by the end time: (v, dv/dt), at a jump of the force the one before it.
    system : System
    """

    t: Array
    x: Array
    columns: tuple[str, ...]
    dx: Array
    d2x: Array | None
    rate: Array
    system: System

    @property
    def q(self) -> Array:
        return self.x[..., : self.system.n]

    @property
    def v(self) -> Array:
        return self.x[..., self.system.n :]

    def _last(self) -> Variations:
        """Return the last of the times alone."""
        second = None if self.d2x is None else self.d2x[-1]
        return Variations(
            self.t[-1], self.x[-1], self.columns, self.dx[-1], second, self.rate[-1], self.system
        )


def variations(
    system: System,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    *,
    t_end: float | None = None,
    t_eval: ArrayLike | None = None,
    t0: float = 0.0,
    directions: ArrayLike | None = None,
    parameters: Sequence[str] = (),
    inputs: Sequence[str] = (),
    values: ArrayLike | None = None,
    order: int = 1,
    tolerance: float | None = None,
    consistent: str = "check",
) -> Variations:
    """Return a motion and its derivatives by its start, parameters and inputs.

    The variational equations are integrated along the Taylor series of the motion, in the
    quasi-velocities w of `System.reduced`.  So the motion is the one that `integrate` finds, and
    its derivatives are tangent to D to roundoff.  A system is compiled for this on first use.  At a
    start on a kink or a jump of the force they are one-sided.

    Parameters
    ----------
    system : System
        From expressions, or of the library.
    q0, v0 : array_like, shape (n,), optional
        Initial data in D; default: those of the system.
    t_end, t_eval : float; array_like, shape (N,)
        The end, or several times in the order of the motion.
    t0 : float, optional
    directions : array_like, shape (K, 2n), optional
        Directions (dq, dv) of the start, tangent to D.  Default: a basis of the tangent space at
        the start.  It has a column for each coordinate, at fixed w, and for each w, at fixed q.
    parameters : sequence of str, optional
        Names of parameters.  The initial velocity is projected into the D that changes with them,
        in the mass metric, at fixed q.
    inputs : sequence of str, optional
        Names of inputs that are constant.
    values : array_like, shape (k,), optional
        The inputs themselves; default 0.
    order : {1, 2}, optional
    tolerance : float, optional
        That of the scheme "taylor"; default 1e-15.
    consistent : {"check", "project"}, optional
        The treatment of a v0 that violates the constraint.  "check" raises an error (default);
        "project" projects it in the mass metric, for all values of the parameters.

    Returns
    -------
    Variations

    Raises
    ------
    ValueError
        If an argument is invalid, or a direction is not tangent to D.
    NotImplementedError
        If the system has no Taylor series, or no equations on D in closed form.  Also if its
        constraints depend on inputs, and for second derivatives where a function has a kink.
    DomainError, SingularError, ConvergenceError
        As for `integrate`; also where the motion touches a jump of the force.

    Examples
    --------
    >>> import dalembert as dal
    >>> found = dal.variations(dal.systems.sleigh(), t_end=10, parameters=["a"])
    >>> found.columns, found.dx.shape
    (('x', 'y', 'theta', 'w0', 'w1', 'a'), (6, 6))
    """
    require_system(system)
    order = arguments.integer(order, "order", 1, 2)
    times = _times(t_end, t_eval, t0)
    compiled = twin(system, _PARTS[order])
    if compiled is None or compiled._model is None:
        raise NotImplementedError(
            f"the system {system.name!r} has no Taylor series, which come from its expressions; "
            "derivatives need them"
        )
    scheme = Scheme.find("taylor") if tolerance is None else Scheme.taylor(tolerance)
    x0 = geometry.initial_state(system, q0, v0)
    is_projected = arguments.choice(consistent, "consistent", {"check": False, "project": True})
    given = x0.copy() if is_projected else None
    if given is not None:
        x0[system.n :] = system.project(*np.split(x0, 2), t=float(t0), inputs=values)
    start = _Start(system, compiled, scheme, order, x0, float(t0), values)
    if directions is None:
        start.add_basis()
    else:
        start.add(arguments.array(directions, "directions", (None, 2 * system.n)))
    start.add_parameters(_chosen(parameters, system.parameters, "parameters"), given)
    start.add_inputs(_chosen(inputs, system.inputs, "inputs"))
    found = start.lead(times)
    return found if t_eval is not None else found._last()


def _times(t_end: float | None, t_eval: ArrayLike | None, t0: float) -> Array:
    """Return the times at which derivatives are wanted."""
    if (t_end is None) == (t_eval is None):
        raise ValueError("expected exactly one of t_end and t_eval")
    if t_eval is None:
        return np.array([arguments.number(t_end, "t_end")])
    times = arguments.array(t_eval, "t_eval", (None,))
    ahead = np.diff(np.concatenate([[t0], times]))
    if not ((ahead >= 0).all() or (ahead <= 0).all()):
        raise ValueError("t_eval: expected times in the order of the motion, from t0 on")
    return times


def _chosen(names: Sequence[str], known: Iterable[str], argument: str) -> list[str]:
    """Return names of parameters or inputs; ValueError if one is unknown."""
    names, known = arguments.names(names, argument, "several names"), list(known)
    for name in names:
        if name not in known:
            hint = arguments.suggestion(name, known)
            raise ValueError(
                f"{argument}: {name!r} is unknown; {hint}expected {', '.join(known) or 'none'}"
            )
    return list(names)


class _Start:
    """The columns of derivatives at the start of a motion."""

    def __init__(
        self, system: System, compiled: System, scheme: Scheme, order: int, x0: Array, t0: float,
        values: ArrayLike | None,
    ) -> None:  # fmt: skip
        self.system, self.compiled, self.scheme, self.order = system, compiled, scheme, order
        self.t0 = t0
        self.x0 = x0
        self.values = None if values is None else arguments.inputs(values, system.inputs, 1)[0]
        self.numbers = len(system.parameters), len(system.inputs)
        self.dx: list[Array] = []
        self.dz: list[Array] = []
        self.names: list[str] = []
        self._one = self._make(1)

    def _make(self, columns: int) -> Any:
        """Return the ``dal_taylor_variations`` for a number of columns."""
        record, kept = self.scheme._record_of(self.system)
        made = core.make(
            "taylor_variations", self.compiled._handle, record, self.order, columns,
            owner=(self.compiled, kept),
        )  # fmt: skip
        if self.values is not None:
            core.call("linear", lib.dal_taylor_variations_input, made, self.values)
        return made

    def column(self, dy: Array, dz: Array | None = None) -> Array:
        """Return the derivatives of x from those of the numbers (q, w)."""
        dx = np.zeros_like(self.x0)
        given = ffi.NULL if dz is None else dz
        core.call("linear", lib.dal_taylor_variations_column, self._one, self.t0, self.x0, dy,
                  given, dx)  # fmt: skip
        return dx

    def add(self, dx: Array) -> None:
        """Add directions of the start."""
        self.dx += [*dx]
        self.dz += [np.zeros(sum(self.numbers)) for _ in dx]
        self.names += [f"direction {k}" for k in range(len(dx))]

    def add_basis(self) -> None:
        """Add a basis of the tangent space."""
        self.add(np.array([self.column(dy) for dy in np.eye(self.states)]))
        quasi = (f"w{i}" for i in range(self.states - self.system.n))
        self.names = [*self.system.coordinates, *quasi]

    @property
    def states(self) -> int:
        return int(lib.dal_taylor_variations_states(self._one))

    def add_parameters(self, names: Sequence[str], given: Array | None) -> None:
        """Add columns whose initial velocity is projected into the D that changes.

        It is projected from a ``given`` state, if that is off D.
        """
        n, known = self.system.n, list(self.system.parameters)
        basis = np.array([self.column(dy)[n:] for dy in np.eye(self.states)[n:]])
        M = geometry.metric(self.system, self.x0[:n], self.x0[n:], self.t0)
        for name in names:
            dz = np.zeros(sum(self.numbers))
            dz[known.index(name)] = 1.0
            dx = self.column(np.zeros(self.states), dz)  # at fixed w
            slope = np.zeros(n) if given is None else self._slope_of_projection(name, given)
            if len(basis):  # tangent to D, and in the basis as near to the slope as possible
                weighed = basis @ M
                dx[n:] += np.linalg.solve(weighed @ basis.T, weighed @ (slope - dx[n:])) @ basis
            self._add(name, dx, dz)

    def _slope_of_projection(self, name: str, given: Array) -> Array:
        """Return the derivative of the projected velocity by a parameter, by differences."""
        value = self.system.parameters[name]
        h = 1e-3 * (abs(value) or 1.0)

        def projected(k: int) -> Array:
            other = self.system.with_parameters(**{name: value + k * h})
            return other.project(*np.split(given, 2), t=self.t0, inputs=self.values)

        one, two = (projected(k) - projected(-k) for k in (1, 2))
        three = projected(3) - projected(-3)
        return (45 * one - 9 * two + three) / (60 * h)

    def add_inputs(self, names: Sequence[str]) -> None:
        """Add columns of inputs, which do not change the start."""
        for name in names:
            dz = np.zeros(sum(self.numbers))
            dz[self.numbers[0] + list(self.system.inputs).index(name)] = 1.0
            self._add(name, np.zeros_like(self.x0), dz)

    def _add(self, name: str, dx: Array, dz: Array) -> None:
        self.dx.append(dx)
        self.dz.append(dz)
        self.names.append(name)

    def lead(self, times: Array) -> Variations:
        """Return the derivatives at some times."""
        columns, size = len(self.dx), len(self.x0)
        if not columns:
            raise ValueError("directions, parameters, inputs: expected at least one column")
        made = self._make(columns)
        dx, dz = np.array(self.dx), np.array(self.dz).reshape(columns, -1)
        core.call("linear", lib.dal_taylor_variations_start, made, self.t0, self.x0, dx, dz)
        pairs = [(i, j) for i in range(columns) for j in range(i, columns)]
        x = np.empty((len(times), size))
        rate = np.empty_like(x)
        first = np.empty((len(times), size, columns))
        second = np.empty((len(times), size, columns, columns)) if self.order == 2 else None
        watching = ffi.new_handle(lambda t: None)
        for k, t in enumerate(times):
            core.call("linear", lib.dal_taylor_variations_go, made, float(t), lib.dal_py_watch,
                      watching)  # fmt: skip
            x[k] = core.doubles(lib.dal_taylor_variations_state(made), size)
            acceleration = core.doubles(lib.dal_taylor_variations_acceleration(made), size // 2)
            rate[k] = np.concatenate([x[k, size // 2 :], acceleration])
            found = core.doubles(lib.dal_taylor_variations_columns(made), columns * size)
            first[k] = found.reshape(columns, size).T
            if second is not None:
                found = core.doubles(lib.dal_taylor_variations_second(made), len(pairs) * size)
                for (i, j), column in zip(pairs, found.reshape(-1, size)):
                    second[k, :, i, j] = second[k, :, j, i] = column
        at_start = np.isnan(rate).any(axis=1)  # where nothing has moved yet
        if at_start.any():
            q, v = np.split(self.x0, 2)
            rate[at_start] = geometry.field(self.system, q, v, self.t0, self.values)
        return Variations(times, x, tuple(self.names), first, second, rate, self.system)
