"""Systems: the triple (Q = R^n, L, D) with D = {phi(q, v) = 0}, and perhaps a force."""

from __future__ import annotations

import contextlib
import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _lib, arguments, deformation, geometry
from ._lib import FUNCTIONS, Array, ffi, lib
from .examination import Check, examine

__all__ = ["System"]

# What each bit of dal_missing is called in Python; that of phi_q depends on the constraints.
_MISSING = {
    lib.DAL_MISSING_V_Q: "gradient",
    lib.DAL_MISSING_V_QQ: "hessian",
    lib.DAL_MISSING_L_QQ: "lagrangian_qq",
    lib.DAL_MISSING_L_VQ: "lagrangian_vq",
    lib.DAL_MISSING_L_VV: "lagrangian_vv",
    lib.DAL_MISSING_F_Q: "force_q",
    lib.DAL_MISSING_F_V: "force_v",
}
_MISSING_PHI_Q = {
    "linear": ("forms_velocity_derivative",),
    "affine": ("forms_velocity_derivative", "affine_derivative"),
    "nonlinear": ("constraint_q",),
}

_KINDS = {number: name for name, number in _lib.KINDS.items()}
_CONSTRAINTS = {
    lib.DAL_LINEAR: lib.dal_py_linear,
    lib.DAL_AFFINE: lib.dal_py_affine,
    lib.DAL_NONLINEAR: lib.dal_py_nonlinear,
}

# What each function makes no sense without.
_NEEDS = {
    "gradient": "potential(q) -> V",
    "hessian": "potential(q) -> V",
    "lagrangian": "lagrangian_q(q, v) -> dL/dq and lagrangian_v(q, v) -> dL/dv",
    **dict.fromkeys(
        ("lagrangian_q", "lagrangian_v", "lagrangian_qq", "lagrangian_vq", "lagrangian_vv"),
        "lagrangian(q, v) -> L",
    ),
    "force_q": "force(t, q, v) -> f",
    "force_v": "force(t, q, v) -> f",
    "forms_velocity_derivative": "forms(q) -> mu",
    "affine": "forms(q) -> mu",
    "affine_derivative": "affine(q) -> a",
    "constraint": "constraint_v(q, v) -> dphi/dv",
    "constraint_v": "constraint(q, v) -> phi",
    "constraint_q": "constraint(q, v) -> phi",
}


def differenced(bits: int, kind: str) -> tuple[str, ...]:
    """Return the names of the derivatives in a sum of ``dal_missing``; kind of the constraints."""
    names = tuple(name for bit, name in _MISSING.items() if bits & bit)
    return names + (_MISSING_PHI_Q[kind] if bits & lib.DAL_MISSING_PHI_Q else ())


class System:
    """A mechanical system with velocity constraints, from functions of the user.

    The equations are ``d/dt L_v - L_q = f + phi_v^T lambda`` with ``phi(q, v) = 0``.  The
    Lagrangian L is ``v^T M v / 2 - V(q)`` with a constant mass matrix M, or any function with L_vv
    positive definite.  The constraints phi are linear, ``mu(q) v``; affine, ``mu(q) v + a(q)``; or
    nonlinear.  The force f may depend on time.  Systems that come with the library are made by the
    functions of `dalembert.systems`.

    Parameters
    ----------
    mass : array_like, shape (n, n), (n,) or ()
        M, its diagonal, or one mass for all coordinates; symmetric, positive definite.  Either it
        or ``lagrangian`` is given.
    forms : callable, optional
        ``forms(q) -> (m, n)``: mu(q), one row for each constraint.  Without it, and without
        ``constraint``, there are no constraints.
    forms_velocity_derivative : callable, optional
        ``forms_velocity_derivative(q, v) -> (m, n)``: entry [a, j] is d(mu^a(q) v)/dq_j.
    affine, affine_derivative : callable, optional
        ``affine(q) -> (m,)``: a(q), so that the constraints are mu(q) v + a(q) = 0;
        ``affine_derivative(q) -> (m, n)``: entry [a, j] is da^a/dq_j.  It is given together with
        ``forms_velocity_derivative``, or neither is.
    constraint, constraint_v, constraint_q : callable, optional
        Nonlinear constraints, instead of ``forms``.  ``constraint(q, v) -> (m,)``: phi;
        ``constraint_v(q, v) -> (m, n)``: dphi^a/dv_i, needed, and of rank m wherever the system
        goes; ``constraint_q(q, v) -> (m, n)``: dphi^a/dq_j.
    potential : callable, optional
        ``potential(q) -> float``.  None: V = 0.
    gradient : callable, optional
        ``gradient(q) -> (n,)``: dV/dq_j.
    hessian : callable, optional
        ``hessian(q) -> (n, n)``: d2V/dq_i dq_j.
    lagrangian, lagrangian_q, lagrangian_v : callable, optional
        Instead of mass and potential, all three: ``lagrangian(q, v) -> float``;
        ``lagrangian_q(q, v) -> (n,)``: dL/dq_i; ``lagrangian_v(q, v) -> (n,)``: dL/dv_i.
    lagrangian_qq, lagrangian_vq, lagrangian_vv : callable, optional
        Of (q, v), shape (n, n): d2L/dq_i dq_j; d2L/dv_i dq_j, where the row is that of the
        velocity; d2L/dv_i dv_j, symmetric and positive definite.
    force, force_q, force_v : callable, optional
        ``force(t, q, v) -> (n,)``: f; ``force_q(t, q, v) -> (n, n)``: df_i/dq_j;
        ``force_v(t, q, v) -> (n, n)``: df_i/dv_j.
    n : int, optional
        Number of coordinates; needed where neither the mass, the coordinates nor q0 tell it.
    m : int, optional
        Number of constraints.  Without it ``forms`` is asked once, at ``q0`` or at 0, or
        ``constraint``, at (q0, v0) or at (0, (1, ..., 1)).
    name, help : str, optional
        A name, and one line about the system.
    coordinates : sequence of str, optional
        Names of the coordinates; default "q0", "q1", ...
    q0, v0 : array_like, shape (n,), optional
        Initial data to start from by default, both or none.
    exact : callable, optional
        ``exact(t, q0, v0) -> (q, v)``: the exact state a time t after (q0, v0).  Where there is a
        force that depends on time, the solution that starts at time 0.
    invariants : mapping of str to callable, optional
        ``invariant(q, v) -> float`` by name: first integrals besides the energy.

    Raises
    ------
    ValueError
        If an argument has the wrong shape, is missing or one too many, or the mass matrix is not
        symmetric and positive definite.  The text names it.

    Notes
    -----
    Derivatives that are not given are replaced by central differences, see `differenced`.  Where
    ``gradient``, ``lagrangian_vq``, ``lagrangian_vv`` or that of the constraints by q is missing,
    accelerations and multipliers are good to about 1e-12; the others cost Newton's speed only.

    A system of constant mass without force and with linear constraints is integrated by the fastest
    step routine; all others by Newton's iteration on all n + m unknowns.

    The arrays that the functions get are read-only copies, which may be kept.  An exception that
    a function raises comes back from the call that caused it.  A function may raise
    `dalembert.DomainError` for a state outside its domain.

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

    The same with friction, and a conveyor belt under it that moves with velocity 2:

    >>> belt = dal.System(
    ...     mass=[1, 1, 1],
    ...     forms=lambda q: [[-q[1], 0, 1]],
    ...     affine=lambda q: [-2],
    ...     force=lambda t, q, v: -v / 10,
    ...     coordinates=["x", "y", "z"],
    ... )
    >>> belt
    <System system(x, y, z): n = 3, m = 1, affine, forced>
    >>> belt.residual([0, 1, 0], [1, 1, 3])
    array([0.])

    A Lagrangian of its own, in polar coordinates, and a speed that is kept:

    >>> speed = lambda q, v: (v[0] ** 2 + (q[0] * v[1]) ** 2) ** 0.5
    >>> runner = dal.System(
    ...     lagrangian=lambda q, v: (v[0] ** 2 + (q[0] * v[1]) ** 2) / 2,
    ...     lagrangian_q=lambda q, v: [q[0] * v[1] ** 2, 0],
    ...     lagrangian_v=lambda q, v: [v[0], q[0] ** 2 * v[1]],
    ...     constraint=lambda q, v: [speed(q, v) - 2],
    ...     constraint_v=lambda q, v: [[v[0] / speed(q, v), q[0] ** 2 * v[1] / speed(q, v)]],
    ...     coordinates=["r", "phi"],
    ... )
    >>> runner.kind
    'nonlinear'
    """

    def __init__(
        self,
        *,
        mass: ArrayLike | None = None,
        forms: Callable[[Array], ArrayLike] | None = None,
        forms_velocity_derivative: Callable[[Array, Array], ArrayLike] | None = None,
        affine: Callable[[Array], ArrayLike] | None = None,
        affine_derivative: Callable[[Array], ArrayLike] | None = None,
        constraint: Callable[[Array, Array], ArrayLike] | None = None,
        constraint_v: Callable[[Array, Array], ArrayLike] | None = None,
        constraint_q: Callable[[Array, Array], ArrayLike] | None = None,
        potential: Callable[[Array], float] | None = None,
        gradient: Callable[[Array], ArrayLike] | None = None,
        hessian: Callable[[Array], ArrayLike] | None = None,
        lagrangian: Callable[[Array, Array], float] | None = None,
        lagrangian_q: Callable[[Array, Array], ArrayLike] | None = None,
        lagrangian_v: Callable[[Array, Array], ArrayLike] | None = None,
        lagrangian_qq: Callable[[Array, Array], ArrayLike] | None = None,
        lagrangian_vq: Callable[[Array, Array], ArrayLike] | None = None,
        lagrangian_vv: Callable[[Array, Array], ArrayLike] | None = None,
        force: Callable[[float, Array, Array], ArrayLike] | None = None,
        force_q: Callable[[float, Array, Array], ArrayLike] | None = None,
        force_v: Callable[[float, Array, Array], ArrayLike] | None = None,
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
        given = locals()
        functions: dict[str, Callable[..., Any] | None] = {key: given[key] for key in FUNCTIONS}
        for key, function in {**functions, **(invariants or {})}.items():
            arguments.function(function, key)
        _require_parts(functions, mass)
        if (q0 is None) != (v0 is None):
            raise ValueError("q0 and v0: expected both or none")

        told = _number_of_coordinates(n, coordinates, q0)
        matrix = None if mass is None else _mass_matrix(mass, n, told)
        size = told if matrix is None else len(matrix)
        if size is None:
            raise ValueError("n: needed, because neither coordinates nor q0 tell it")
        names = [f"q{i}" for i in range(size)] if coordinates is None else list(coordinates)
        if len(names) != size or not all(isinstance(c, str) for c in names):
            raise ValueError(f"coordinates = {coordinates!r}: expected {size} names")
        state = None
        if q0 is not None and v0 is not None:
            state = np.concatenate(
                [arguments.array(q0, "q0", (size,)), arguments.array(v0, "v0", (size,))]
            )
        m = _number_of_constraints(forms, constraint, m, size, state)
        kind = lib.DAL_LINEAR
        if m > 0:
            kind = lib.DAL_AFFINE if affine is not None else kind
            kind = lib.DAL_NONLINEAR if constraint is not None else kind

        self._callables = _lib.Callables(size, m, functions)
        self._context = ffi.new_handle(self._callables)
        c_names, kept = _lib.strings(names)
        c_name = ffi.new("char[]", arguments.text(name, "name").encode())
        c_help = ffi.new("char[]", arguments.text(help, "help").encode())
        definition = ffi.new(
            "dal_system_def *",
            {
                "n": size,
                "m": m,
                "mass": ffi.NULL if matrix is None else _lib.pointer(matrix),
                "lagrangian": ffi.NULL if lagrangian is None else lib.dal_py_lagrangian,
                "potential": ffi.NULL if potential is None else lib.dal_py_potential,
                "constraint": ffi.NULL if m == 0 else _CONSTRAINTS[kind],
                "kind": kind,
                "force": ffi.NULL if force is None else lib.dal_py_force,
                "missing": _missing(functions, m, _KINDS[kind]),
                "ctx": self._context,
                "name": c_name,
                "help": c_help,
                "coordinates": c_names,
                "state": ffi.NULL if state is None else _lib.pointer(state),
                "exact": ffi.NULL if exact is None else lib.dal_py_exact,
            },
        )
        self._invariants = dict(invariants or {})
        self._description: tuple[Any, ...] = (
            _restore,
            {
                **functions,
                "mass": matrix,
                "n": size,
                "m": m,
                "name": name,
                "help": help,
                "coordinates": names,
                "q0": None if state is None else state[:size],
                "v0": None if state is None else state[size:],
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
        new = lib.dal_system_builtin
        handle = _lib.adopt("system", new, c_name, c_names, _lib.pointer(values), len(values))
        del kept
        self = cls._derived(handle, ())
        self._description = (_restore_builtin, self.name, self.parameters)
        return self

    @classmethod
    def _derived(cls, handle: Any, description: tuple[Any, ...]) -> System:
        """Make the system of a C one; the description is the call that makes it again."""
        self = cls.__new__(cls)
        self._invariants = {}
        self._description = description
        self._adopt(handle)
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
        self._kind = _KINDS[lib.dal_system_kind(handle)]
        self._is_forced = bool(lib.dal_system_is_forced(handle))
        self._mass: Array | None = None
        mass = lib.dal_system_mass(handle)
        if mass != ffi.NULL:
            self._mass = _lib.doubles(mass, self._n**2).reshape(self._n, self._n)
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
    def mass(self) -> Array | None:
        """Mass matrix M, shape (n, n), read-only; None if it is not constant, see `metric`."""
        return self._mass

    @property
    def kind(self) -> str:
        """Kind of the constraints: "linear", "affine" or "nonlinear"."""
        return self._kind

    @property
    def is_forced(self) -> bool:
        """True if there is a force besides that of the Lagrangian."""
        return self._is_forced

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
        return differenced(lib.dal_system_missing(self._handle), self._kind)

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
        if self._description[0] is _restore:
            return self._callables.exact is not None
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
            status = _lib.attempt(
                lib.dal_system_exact,
                self._handle,
                float(time),
                _lib.pointer(x0),
                _lib.pointer(x, k),
            )
            if status == lib.DAL_EUNSUPPORTED:
                raise NotImplementedError(f"the system {self.name!r} carries no exact solution")
            _lib.check(status, step=k)
        x = x[0] if times.ndim == 0 else x
        return x[..., :n], x[..., n:]

    def check(self, q: ArrayLike | None = None, v: ArrayLike | None = None) -> Check:
        """Examine the system at a state: derivatives, rank, definiteness, integrability.

        What depends on v is examined at another velocity too, where it is defined there, and the
        force at times 0 and 1.

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
    power = geometry.power
    metric = geometry.metric
    gram = geometry.gram
    multipliers = geometry.multipliers
    acceleration = geometry.acceleration
    field = geometry.field
    perturbed = geometry.perturbed
    project = geometry.project
    consistent = geometry.consistent

    # ---- other constraints: the functions of `deformation` as methods --------------------

    deformed = deformation.deformed
    at_kept_nodes = deformation.at_kept_nodes

    # ---- as an object --------------------------------------------------------------------

    def __repr__(self) -> str:
        values = "".join(f", {key} = {value:g}" for key, value in self._parameters.items())
        names = ", ".join(self.coordinates[:8]) + ", ..." * (self.n > 8)
        traits = (
            (", general Lagrangian" if self._mass is None else "")
            + (f", {self._kind}" if self._kind != "linear" else "")
            + (", forced" if self._is_forced else "")
        )
        return f"<System {self.name}({names}): n = {self.n}, m = {self.m}{traits}{values}>"

    def __copy__(self) -> System:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> System:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        restore, *description = self._description
        if isinstance(description[0], dict):
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
    for key, function in {**functions, **description.get("invariants", {})}.items():
        try:
            pickle.dumps(function)
        except Exception as error:
            raise pickle.PicklingError(
                f"the system {name!r} does not pickle, because its {key} = {function!r} does not; "
                "define it with def at the top level of a module"
            ) from error


def _require_parts(functions: dict[str, Callable[..., Any] | None], mass: Any) -> None:
    """Raise ValueError if functions are given that do not go together, or not all that do."""
    given = {key for key, function in functions.items() if function is not None}
    if mass is not None:
        given.add("mass")
    for one, other in (
        ("mass", "lagrangian"),
        ("potential", "lagrangian"),
        ("forms", "constraint"),
    ):
        if one in given and other in given:
            raise ValueError(f"{one} and {other}: expected one of the two")
    for key in FUNCTIONS:
        needed = _NEEDS.get(key, "")
        names = [part.split("(")[0] for part in needed.split(" and ")] if needed else []
        if key in given and not given.issuperset(names):
            raise ValueError(f"{key} without {needed}")
    if not given & {"mass", "lagrangian"}:
        raise ValueError("mass: needed, or a lagrangian")
    derivatives = given & {"forms_velocity_derivative", "affine_derivative"}
    if "affine" in given and len(derivatives) == 1:
        raise ValueError(
            f"{derivatives.pop()} alone: expected forms_velocity_derivative and "
            "affine_derivative, both or none"
        )


def _missing(functions: dict[str, Callable[..., Any] | None], m: int, kind: str) -> int:
    """Return the sum of ``dal_missing`` for the derivatives that are not given."""
    owners = {"gradient": "potential", "hessian": "potential"}
    bits = 0
    for bit, name in _MISSING.items():
        owner = owners.get(name, name.split("_")[0])
        if functions[owner] is not None and functions[name] is None:
            bits |= bit
    if m > 0 and any(functions[name] is None for name in _MISSING_PHI_Q[kind]):
        bits |= lib.DAL_MISSING_PHI_Q
    return bits


def _number_of_coordinates(
    n: int | None, coordinates: Sequence[str] | None, q0: ArrayLike | None
) -> int | None:
    """Return n as given, or as the coordinates or q0 tell it; None if nothing does."""
    if n is not None:
        return arguments.integer(n, "n", 1)
    if coordinates is not None:
        return len(coordinates)
    return None if q0 is None else int(np.size(q0))


def _mass_matrix(mass: ArrayLike, n: int | None, told: int | None) -> Array:
    """Return M for a matrix, its diagonal, or one number; ValueError if n does not agree."""
    matrix = arguments.array(mass, "mass", (None, None), (None,), ())
    if matrix.ndim == 0:
        if told is None:
            raise ValueError(f"n: needed, because mass = {mass!r} does not tell it")
        matrix = np.full(told, float(matrix))
    if matrix.ndim == 1:
        matrix = np.diag(matrix)
    if matrix.shape[0] != matrix.shape[1] or matrix.size == 0:
        raise ValueError(f"mass: expected a square matrix, got shape {matrix.shape}")
    if n is not None and len(matrix) != n:
        raise ValueError(f"n = {n}: the mass matrix has shape {matrix.shape}")
    return matrix.copy()


def _number_of_constraints(
    forms: Callable[[Array], ArrayLike] | None,
    constraint: Callable[[Array, Array], ArrayLike] | None,
    m: int | None,
    n: int,
    state: Array | None,
) -> int:
    """Return m as given, or as many as ``forms(q)`` or ``constraint(q, v)`` returns."""
    if forms is None and constraint is None:
        if m:
            raise ValueError(f"m = {m}: without forms or constraint there are no constraints")
        return 0
    if m is not None:
        return arguments.integer(m, "m", 0)
    point = np.concatenate([np.zeros(n), np.ones(n)]) if state is None else state.copy()
    point.flags.writeable = False
    if constraint is not None:
        shape = np.shape(constraint(point[:n], point[n:]))
        if len(shape) != 1:
            raise ValueError(
                "constraint has to return shape (m,), one number for each constraint, it "
                f"returned {shape}"
            )
    elif forms is not None:
        shape = np.shape(forms(point[:n]))
        if len(shape) != 2 or shape[1] != n:
            raise ValueError(
                f"forms has to return shape (m, {n}), one row for each constraint, "
                f"it returned {shape}"
            )
    return arguments.integer(shape[0], "m", 0)
