"""Systems: the triple (Q = R^n, L, D) with L = v^T M v / 2 - V(q) and D = {mu(q) v = 0}."""

from __future__ import annotations

import contextlib
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _lib, arguments, geometry
from ._lib import Array, ffi, lib
from .examination import Check, examine

__all__ = ["System"]

# What each bit of dal_missing is called in Python.
_MISSING = {
    lib.DAL_MISSING_V_Q: "gradient",
    lib.DAL_MISSING_V_QQ: "hessian",
    lib.DAL_MISSING_PHI_Q: "forms_velocity_derivative",
}


def differenced(bits: int) -> tuple[str, ...]:
    """Return the names of the derivatives in a sum of ``dal_missing``."""
    return tuple(name for bit, name in _MISSING.items() if bits & bit)


class System:
    """A mechanical system with linear velocity constraints, from functions of the user.

    The Lagrangian is ``v^T M v / 2 - V(q)`` with a constant mass matrix M, the constraints are
    ``mu(q) v = 0``; the reaction is ``mu^T lambda``.  Systems that come with the library are made
    by the functions of `dalembert.systems`.

    Parameters
    ----------
    mass : array_like, shape (n, n), (n,) or ()
        M, its diagonal, or one mass for all coordinates; symmetric, positive definite.
    forms : callable, optional
        ``forms(q) -> (m, n)``: mu(q), one row for each constraint.  None: no constraints.
    forms_velocity_derivative : callable, optional
        ``forms_velocity_derivative(q, v) -> (m, n)``: entry [a, j] is d(mu^a(q) v)/dq_j.
    potential : callable, optional
        ``potential(q) -> float``.  None: V = 0.
    gradient : callable, optional
        ``gradient(q) -> (n,)``: dV/dq_j.
    hessian : callable, optional
        ``hessian(q) -> (n, n)``: d2V/dq_i dq_j.
    n : int, optional
        Number of coordinates; needed where neither the mass, the coordinates nor q0 tell it.
    m : int, optional
        Number of constraints.  Without it ``forms`` is asked once, at ``q0`` or at 0.
    name, help : str, optional
        A name, and one line about the system.
    coordinates : sequence of str, optional
        Names of the coordinates; default "q0", "q1", ...
    q0, v0 : array_like, shape (n,), optional
        Initial data to start from by default, both or none.
    exact : callable, optional
        ``exact(t, q0, v0) -> (q, v)``: the exact state a time t after (q0, v0).
    invariants : mapping of str to callable, optional
        ``invariant(q, v) -> float`` by name: first integrals besides the energy.

    Raises
    ------
    ValueError
        If an argument has the wrong shape, or the mass matrix is not symmetric and positive
        definite.  The text names the entry.

    Notes
    -----
    Derivatives that are not given are replaced by central differences, see `differenced`.  A
    missing Hessian costs Newton's speed only; without the gradient or
    ``forms_velocity_derivative`` accelerations and multipliers are good to about 1e-12.

    The arrays that the functions get are read-only copies, which may be kept.  An exception that
    a function raises comes back from the call that caused it.  A function may raise
    `dalembert.DomainError` for a q outside its domain.

    A system does not change after it is made, and threads may share it as far as its functions
    may.  It pickles as its description.

    Examples
    --------
    >>> import dalembert as dal
    >>> own = dal.System(
    ...     mass=[1, 1, 1],
    ...     forms=lambda q: [[-q[1], 0, 1]],
    ...     forms_velocity_derivative=lambda q, v: [[0, -v[0], 0]],
    ...     coordinates=["x", "y", "z"],
    ... )
    >>> own.multipliers([0, 1, 0], [1, 1, 1])
    array([0.5])
    """

    def __init__(
        self,
        *,
        mass: ArrayLike,
        forms: Callable[[Array], ArrayLike] | None = None,
        forms_velocity_derivative: Callable[[Array, Array], ArrayLike] | None = None,
        potential: Callable[[Array], float] | None = None,
        gradient: Callable[[Array], ArrayLike] | None = None,
        hessian: Callable[[Array], ArrayLike] | None = None,
        n: int | None = None,
        m: int | None = None,
        name: str = "system",
        help: str = "",
        coordinates: Sequence[str] | None = None,
        q0: ArrayLike | None = None,
        v0: ArrayLike | None = None,
        exact: Callable[[float, Array, Array], tuple[ArrayLike, ArrayLike]] | None = None,
        invariants: Mapping[str, Callable[[Array, Array], float]] | None = None,
    ) -> None:
        functions = {
            "forms": forms,
            "forms_velocity_derivative": forms_velocity_derivative,
            "potential": potential,
            "gradient": gradient,
            "hessian": hessian,
            "exact": exact,
            **(invariants or {}),
        }
        for key, function in functions.items():
            arguments.function(function, key)
        if potential is None and (gradient is not None or hessian is not None):
            given = "gradient" if gradient is not None else "hessian"
            raise ValueError(f"{given} without potential: the energy needs potential(q) -> V")
        if forms is None and forms_velocity_derivative is not None:
            raise ValueError("forms_velocity_derivative without forms(q) -> mu")
        if (q0 is None) != (v0 is None):
            raise ValueError("q0 and v0: expected both or none")

        matrix = _mass_matrix(mass, n, coordinates, q0)
        n = len(matrix)
        names = [f"q{i}" for i in range(n)] if coordinates is None else list(coordinates)
        if len(names) != n or not all(isinstance(c, str) for c in names):
            raise ValueError(f"coordinates = {coordinates!r}: expected {n} names")
        state = None
        if q0 is not None and v0 is not None:
            state = np.concatenate(
                [arguments.array(q0, "q0", (n,)), arguments.array(v0, "v0", (n,))]
            )
        m = _number_of_constraints(forms, m, np.zeros(n) if state is None else state[:n])

        missing = 0
        if potential is not None:
            missing |= lib.DAL_MISSING_V_Q * (gradient is None)
            missing |= lib.DAL_MISSING_V_QQ * (hessian is None)
        if m > 0:
            missing |= lib.DAL_MISSING_PHI_Q * (forms_velocity_derivative is None)
        self._callables = _lib.Callables(
            n, m, forms, forms_velocity_derivative, potential, gradient, hessian
        )
        self._context = ffi.new_handle(self._callables)
        c_names, kept = _lib.strings(names)
        c_name = ffi.new("char[]", arguments.text(name, "name").encode())
        c_help = ffi.new("char[]", arguments.text(help, "help").encode())
        definition = ffi.new(
            "dal_system_def *",
            {
                "n": n,
                "m": m,
                "mass": _lib.pointer(matrix),
                "potential": ffi.NULL if potential is None else lib.dal_py_potential,
                "constraint": ffi.NULL if m == 0 else lib.dal_py_constraint,
                "missing": missing,
                "ctx": self._context,
                "name": c_name,
                "help": c_help,
                "coordinates": c_names,
                "state": ffi.NULL if state is None else _lib.pointer(state),
            },
        )
        self._exact = exact
        self._invariants = dict(invariants or {})
        self._description: tuple[Any, ...] = (
            _restore,
            {
                "mass": matrix,
                "forms": forms,
                "forms_velocity_derivative": forms_velocity_derivative,
                "potential": potential,
                "gradient": gradient,
                "hessian": hessian,
                "m": m,
                "name": name,
                "help": help,
                "coordinates": names,
                "q0": None if state is None else state[:n],
                "v0": None if state is None else state[n:],
                "exact": exact,
                "invariants": self._invariants,
            },
        )
        self._adopt(_lib.make("system", definition))
        del kept

    @classmethod
    def _builtin(cls, name: str, parameters: Mapping[str, Any]) -> System:
        """Make the system that comes with the library under ``name``."""
        values = np.array([arguments.number(value, key) for key, value in parameters.items()])
        c_names, kept = _lib.strings(list(parameters))
        c_name = ffi.new("char[]", name.encode())
        self = cls.__new__(cls)
        self._exact = None
        self._invariants = {}
        self._adopt(
            _lib.adopt(
                "system",
                lib.dal_system_builtin,
                c_name,
                c_names,
                _lib.pointer(values),
                len(values),
            )
        )
        del kept
        self._description = (_restore_builtin, self.name, self.parameters)
        return self

    def _adopt(self, handle: Any) -> None:
        """Take over a C system, and read what it says about itself."""
        self._handle = handle
        self._workspaces: list[Any] = []
        self._n = int(lib.dal_system_n(handle))
        self._m = int(lib.dal_system_m(handle))
        self._name = _lib.string(lib.dal_system_name(handle))
        self._help = _lib.string(lib.dal_system_help(handle))
        self._coordinates = tuple(
            _lib.string(lib.dal_system_coordinate(handle, i)) for i in range(self._n)
        )
        self._parameters = {
            _lib.string(lib.dal_system_parameter_name(handle, i)): float(
                lib.dal_system_parameter(handle, i)
            )
            for i in range(lib.dal_system_parameters(handle))
        }
        self._invariant_names = tuple(self._invariants) or tuple(
            _lib.string(lib.dal_system_invariant_name(handle, i))
            for i in range(lib.dal_system_invariants(handle))
        )
        self._mass = _lib.doubles(lib.dal_system_mass(handle), self._n**2).reshape(self._n, self._n)
        self._mass.flags.writeable = False
        state = np.empty(2 * self._n)
        self._state = None
        if lib.dal_system_state(handle, _lib.pointer(state)) == lib.DAL_SUCCESS:
            state.flags.writeable = False
            self._state = state

    @contextlib.contextmanager
    def _workspace(self) -> Iterator[Any]:
        """Lend a ``dal_mechanics``, which belongs to one call at a time.

        Threads, and callbacks that come back here, each get one of their own, so nobody waits.
        """
        try:
            mechanics = self._workspaces.pop()
        except IndexError:
            mechanics = _lib.make("mechanics", self._handle, owner=self._handle)
        try:
            yield mechanics
        finally:
            self._workspaces.append(mechanics)

    # ---- what the system is --------------------------------------------------------------

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self._n

    @property
    def m(self) -> int:
        """Number of constraints."""
        return self._m

    @property
    def name(self) -> str:
        """Name of the system."""
        return self._name

    @property
    def help(self) -> str:
        """One line about the system."""
        return self._help

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the n coordinates."""
        return self._coordinates

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of a system that comes with the library; empty for a user's own."""
        return dict(self._parameters)

    @property
    def mass(self) -> Array:
        """Mass matrix M, shape (n, n), read-only."""
        return self._mass

    @property
    def q0(self) -> Array | None:
        """Default initial coordinates, shape (n,), read-only; None if there are none."""
        return None if self._state is None else self._state[: self._n]

    @property
    def v0(self) -> Array | None:
        """Default initial velocities, shape (n,), read-only; None if there are none."""
        return None if self._state is None else self._state[self._n :]

    @property
    def differenced(self) -> tuple[str, ...]:
        """Names of the derivatives that are replaced by central differences."""
        return differenced(lib.dal_system_missing(self._handle))

    @property
    def invariants(self) -> tuple[str, ...]:
        """Names of the first integrals besides the energy."""
        return self._invariant_names

    def invariant(self, q: ArrayLike, v: ArrayLike) -> dict[str, Any]:
        """Return the first integrals besides the energy.

        Parameters
        ----------
        q, v : array_like, shape (n,) or (N, n)
            A state, or N of them, in the user's units.

        Returns
        -------
        dict of str to float or ndarray
            For each name a float, or an array of shape (N,) for stacked states.

        Raises
        ------
        ValueError
            If q or v has another shape.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.System(mass=[1, 1], invariants={"p": lambda q, v: v[0]}).invariant([0, 0], [2, 1])
        {'p': 2.0}
        """
        x, single = geometry.states(self, q, v)
        n, names = self._n, self._invariant_names
        values = np.empty((len(x), len(names)))
        for k, row in enumerate(x):
            if self._invariants:
                values[k] = [
                    arguments.returned(f(row[:n].copy(), row[n:].copy()), (), name)
                    for name, f in self._invariants.items()
                ]
            elif names:
                _lib.check(
                    lib.dal_system_invariant(
                        self._handle, _lib.pointer(x, k), _lib.pointer(values, k)
                    ),
                    step=k,
                )
        if single:
            return {name: float(values[0, i]) for i, name in enumerate(names)}
        return {name: values[:, i] for i, name in enumerate(names)}

    @property
    def has_exact(self) -> bool:
        """True if `exact` gives the exact solution."""
        if self._exact is not None:
            return True
        x = np.zeros(2 * self._n) if self._state is None else self._state.copy()
        y = np.empty_like(x)
        status = lib.dal_system_exact(self._handle, 0.0, _lib.pointer(x), _lib.pointer(y))
        return bool(status != lib.DAL_EUNSUPPORTED)

    def exact(
        self, t: ArrayLike, q0: ArrayLike | None = None, v0: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Return the exact state a time t after (q0, v0).

        Parameters
        ----------
        t : float or array_like, shape (N,)
            Time since the initial state, in the user's units; negative times are allowed.
        q0, v0 : array_like, shape (n,), optional
            Initial state, in D.  Default: the system's.

        Returns
        -------
        q, v : ndarray, shape (n,) or (N, n)

        Raises
        ------
        NotImplementedError
            If the system carries no exact solution.
        ValueError
            If an argument has another shape.

        Examples
        --------
        >>> import dalembert as dal
        >>> q, v = dal.systems.particle().exact(1.0, [0, 0, 0], [0, 1, 0])
        >>> q
        array([0., 1., 0.])
        """
        times = arguments.array(t, "t", (), (None,))
        n = self._n
        x0 = np.concatenate(geometry.initial(self, q0, v0))
        x = np.empty((times.size, 2 * n))
        for k, time in enumerate(np.atleast_1d(times)):
            if self._exact is not None:
                q, v = self._exact(float(time), x0[:n].copy(), x0[n:].copy())
                x[k, :n] = arguments.returned(q, (n,), "exact (q)")
                x[k, n:] = arguments.returned(v, (n,), "exact (v)")
                continue
            status = lib.dal_system_exact(
                self._handle, float(time), _lib.pointer(x0), _lib.pointer(x, k)
            )
            if status == lib.DAL_EUNSUPPORTED:
                raise NotImplementedError(f"the system {self.name!r} carries no exact solution")
            _lib.check(status, step=k)
        x = x[0] if times.ndim == 0 else x
        return x[..., :n], x[..., n:]

    def check(self, q: ArrayLike | None = None, v: ArrayLike | None = None) -> Check:
        """Examine the system at a state: derivatives, rank, definiteness, integrability.

        Parameters
        ----------
        q, v : array_like, shape (n,), optional
            Where to look, in the user's units.  Default: the system's initial data.

        Returns
        -------
        Check
            True if all is as it should be; ``print(system.check())`` shows what was found.

        Raises
        ------
        ValueError
            If q or v has another shape, or none is given and the system has no initial data.
        Exception
            Whatever a function of the user raises.

        Examples
        --------
        >>> import dalembert as dal
        >>> wrong = dal.System(
        ...     mass=[1, 1], potential=lambda q: q[0] ** 2, gradient=lambda q: [q[0], 0]
        ... )
        >>> bool(wrong.check([1, 0], [0, 0]))
        False
        """
        return examine(self, q, v)

    # ---- mechanics on D: the functions of `geometry` as methods --------------------------

    energy = geometry.energy
    residual = geometry.residual
    relative_residual = geometry.relative_residual
    gram = geometry.gram
    multipliers = geometry.multipliers
    acceleration = geometry.acceleration
    field = geometry.field
    project = geometry.project
    consistent = geometry.consistent

    # ---- as an object --------------------------------------------------------------------

    def __repr__(self) -> str:
        values = "".join(f", {key} = {value:g}" for key, value in self._parameters.items())
        names = ", ".join(self.coordinates[:8]) + ", ..." * (self.n > 8)
        return f"<System {self.name}({names}): n = {self.n}, m = {self.m}{values}>"

    def __copy__(self) -> System:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> System:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        restore, *description = self._description
        if restore is _restore:
            _refuse_unpicklable(self.name, description[0])
        return restore, tuple(description)


def require_system(value: Any) -> None:
    """Raise ValueError if an argument ``system`` is not one."""
    if not isinstance(value, System):
        raise ValueError(f"system = {value!r}: expected a dalembert.System")


def _restore(description: dict[str, Any]) -> System:
    """Make a user's system again from its description."""
    return System(**description)


def _restore_builtin(name: str, parameters: dict[str, float]) -> System:
    """Make a system that comes with the library again."""
    return System._builtin(name, parameters)


def _refuse_unpicklable(name: str, description: dict[str, Any]) -> None:
    """Raise PicklingError, with the line to change, for a function that does not pickle."""
    functions = {key: f for key, f in description.items() if callable(f)}
    for key, function in {**functions, **description["invariants"]}.items():
        try:
            pickle.dumps(function)
        except Exception as error:
            raise pickle.PicklingError(
                f"the system {name!r} does not pickle, because its {key} = {function!r} does not; "
                "define it with def at the top level of a module"
            ) from error


def _mass_matrix(
    mass: ArrayLike, n: int | None, coordinates: Sequence[str] | None, q0: ArrayLike | None
) -> Array:
    """Return M for a matrix, its diagonal, or one number; ValueError if n does not agree."""
    matrix = arguments.array(mass, "mass", (None, None), (None,), ())
    if n is not None:
        n = arguments.integer(n, "n", 1)
    if matrix.ndim == 0:
        if n is None and coordinates is not None:
            n = len(coordinates)
        if n is None and q0 is not None:
            n = np.size(q0)
        if n is None:
            raise ValueError(f"n: needed, because mass = {mass!r} does not tell it")
        matrix = np.full(n, float(matrix))
    if matrix.ndim == 1:
        matrix = np.diag(matrix)
    if matrix.shape[0] != matrix.shape[1] or matrix.size == 0:
        raise ValueError(f"mass: expected a square matrix, got shape {matrix.shape}")
    if n is not None and len(matrix) != n:
        raise ValueError(f"n = {n}: the mass matrix has shape {matrix.shape}")
    return matrix.copy()


def _number_of_constraints(
    forms: Callable[[Array], ArrayLike] | None, m: int | None, q: Array
) -> int:
    """Return m as given, or as the rows of ``forms(q)``."""
    if forms is None:
        if m:
            raise ValueError(f"m = {m}: without forms there are no constraints")
        return 0
    if m is None:
        point = q.copy()
        point.flags.writeable = False
        rows = np.shape(forms(point))
        if len(rows) != 2 or rows[1] != len(q):
            raise ValueError(
                f"forms has to return shape (m, {len(q)}), one row for each constraint, "
                f"it returned {rows}"
            )
        m = rows[0]
    return arguments.integer(m, "m", 0)
