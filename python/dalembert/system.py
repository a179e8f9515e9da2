"""Systems: the triple (Q = R^n, L, D) with D = {phi(q, v) = 0}, and perhaps a force."""

from __future__ import annotations

import contextlib
import dataclasses
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from . import _lib, arguments, deformation, extras, geometry, growth, pointers, symbolic
from ._lib import FUNCTIONS, Array, ffi, lib
from .examination import Check, examine

if TYPE_CHECKING:
    from .model import Model

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

_MOST_COORDINATES = 10_000  # of dense matrices: n^2 numbers each, n^3 operations in a step

_KIND_NAMES = {name: kind for kind, name in _KINDS.items()}
_OUTPUTS = {
    "V_q": lib.DAL_MISSING_V_Q,
    "V_qq": lib.DAL_MISSING_V_QQ,
    "phi_q": lib.DAL_MISSING_PHI_Q,
    "L_qq": lib.DAL_MISSING_L_QQ,
    "L_vq": lib.DAL_MISSING_L_VQ,
    "L_vv": lib.DAL_MISSING_L_VV,
    "f_q": lib.DAL_MISSING_F_Q,
    "f_v": lib.DAL_MISSING_F_V,
}

# What each function makes no sense without.
_TAKEN = {  # by the functions that do not take (q, v)
    **dict.fromkeys(
        ("potential", "gradient", "hessian", "forms", "affine", "affine_derivative"), "q"
    ),
    **dict.fromkeys(("force", "force_q", "force_v", "exact"), "t, q, v"),
}

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
    description, source : str, optional
        What coordinates and parameters are, in some sentences; where the system is from.
    formulas : sequence of str, optional
        "L = ...", the constraints "... = 0", and "where NAME = ..." for what else is in them or in
        names of invariants; ``v_x`` is the velocity of x, a blank a product, ``^`` a power.
    coordinates : sequence of str, optional
        Names of the coordinates; default "q0", "q1", ...
    q0, v0 : array_like, shape (n,), optional
        Initial data to start from by default, both or none.
    exact : callable, optional
        ``exact(t, q0, v0) -> (q, v)``: the exact state a time t after (q0, v0).  Where there is a
        force that depends on time, the solution that starts at time 0.
    invariants : mapping of str to callable, optional
        ``invariant(q, v) -> float`` by name: first integrals besides the energy.
    steady : bool, optional
        Whether mu depends only on coordinates that no reaction pushes, those i with row i of
        M^-1 mu^T zero, as on the heading of a blade; only with ``mass`` and ``forms``.  Steps are
        then linear, without iteration; a step that finds it false ends the run.
    kind : {"linear", "affine", "nonlinear"}, optional
        Of a ``constraint`` that is a C function; default "linear".
    missing : sequence of str, optional
        Outputs that C functions do not write: "V_q", "V_qq", "phi_q", "L_qq", ...
    ctx : array, address or pointer, optional
        What C functions get as their last argument; kept alive, and theirs to read.

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

    ``potential``, ``constraint``, ``lagrangian`` and ``force`` may be C functions, with the
    arguments of ``dal_potential_fn`` and so on in ``dalembert.h``: a numba ``cfunc`` (see
    `dalembert.pointers.numba_wanted`), a function pointer of ctypes or cffi, or a SciPy
    ``LowLevelCallable``.  Then all that are given have to be, with the derivatives among their
    outputs; m is needed; and a step is as fast as from C.  Python functions are called once for
    each evaluation, which is the slow path, vectorised or not.

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
        description: str = "",
        source: str = "",
        formulas: Sequence[str] = (),
        coordinates: Sequence[str] | None = None,
        q0: ArrayLike | None = None,
        v0: ArrayLike | None = None,
        exact: Callable[[float, Array, Array], tuple[ArrayLike, ArrayLike]] | None = None,
        invariants: Mapping[str, Callable[[Array, Array], float]] | None = None,
        steady: bool = False,
        kind: str | None = None,
        missing: Sequence[str] | None = None,
        ctx: Any = None,
    ) -> None:
        if hasattr(self, "_handle"):
            raise TypeError("a System does not change: __init__ is called once")
        given = locals()
        _require_named(invariants)
        functions: dict[str, Callable[..., Any] | None] = {key: given[key] for key in FUNCTIONS}
        compiled = {
            key: found
            for key in pointers.ARGUMENTS
            if (found := pointers.find(key, given[key])) is not None
        }
        for key, function in {**functions, **(invariants or {})}.items():
            if key not in compiled:
                arguments.function(function, key, _TAKEN.get(key, "q, v"))
        if compiled:
            _require_compiled(functions, compiled, mass, m)
        else:
            _require_parts(functions, mass)
            for key in ("kind", "missing", "ctx"):
                if given[key] is not None:
                    raise ValueError(
                        f"{key} = {arguments.shown(given[key])}: only C functions take it"
                    )
        arguments.pair(q0, v0, ("q0", "v0"))

        if coordinates is not None:
            coordinates = arguments.names(
                coordinates, "coordinates", "several names, as ['x', 'y']"
            )
        told = _number_of_coordinates(n, coordinates, q0)
        matrix = None if mass is None else _mass_matrix(mass, n, told)
        size = told if matrix is None else len(matrix)
        if size is None:
            raise ValueError("n: needed, because neither coordinates nor q0 tell it")
        names = [f"q{i}" for i in range(size)] if coordinates is None else list(coordinates)
        if len(names) != size or len(set(names)) != size:
            raise ValueError(f"coordinates = {coordinates!r}: expected {size} different names")
        state = None
        if q0 is not None and v0 is not None:
            state = np.concatenate(
                [arguments.array(q0, "q0", (size,)), arguments.array(v0, "v0", (size,))]
            )
        if compiled:
            m = arguments.integer(0 if m is None else m, "m", 0)
            c_kind = arguments.choice("linear" if kind is None else kind, "kind", _KIND_NAMES)
            c_missing = sum({arguments.choice(key, "missing", _OUTPUTS) for key in missing or ()})
            context, self._kept = pointers.context(ctx, compiled)
            callbacks = {
                key: ffi.cast(f"dal_{key}_fn", found.address) for key, found in compiled.items()
            }
            self._exact = exact
        else:
            m = _number_of_constraints(forms, constraint, m, size, state)
            c_kind = lib.DAL_LINEAR
            if m > 0:
                c_kind = lib.DAL_AFFINE if affine is not None else c_kind
                c_kind = lib.DAL_NONLINEAR if constraint is not None else c_kind
            c_missing = _missing(functions, m, _KINDS[c_kind])
            self._callables = _lib.Callables(size, m, functions)
            context = self._context = ffi.new_handle(self._callables)
            callbacks = {
                "lagrangian": ffi.NULL if lagrangian is None else lib.dal_py_lagrangian,
                "potential": ffi.NULL if potential is None else lib.dal_py_potential,
                "constraint": ffi.NULL if m == 0 else _CONSTRAINTS[c_kind],
                "force": ffi.NULL if force is None else lib.dal_py_force,
                "exact": ffi.NULL if exact is None else lib.dal_py_exact,
            }
        c_names, kept = _lib.strings(names)
        about = {"name": name, "help": help, "description": description, "source": source}
        lines = arguments.names(formulas, "formulas", "several lines")
        texts = _texts({**about, "formulas": "\n".join(lines)})
        definition = ffi.new(
            "dal_system_def *",
            {
                "n": size,
                "m": m,
                "mass": ffi.NULL if matrix is None else _lib.pointer(matrix),
                "kind": c_kind,
                "missing": c_missing,
                "steady": int(bool(steady)),
                "ctx": context,
                **texts,
                "coordinates": c_names,
                "state": ffi.NULL if state is None else _lib.pointer(state),
                **callbacks,
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
                **about,
                "formulas": lines,
                "coordinates": names,
                "q0": None if state is None else state[:size],
                "v0": None if state is None else state[size:],
                "invariants": self._invariants,
                "steady": steady,
            },
        )
        self._adopt(_lib.make("system", definition, owner=context))
        del kept, texts

    # What systems of other origins than Python functions have besides.
    _of_library = False  # True: `systems.get` with the name and the parameters makes it again
    _symbolic: symbolic.Symbolic | None = None
    _exact: Callable[..., tuple[ArrayLike, ArrayLike]] | None = None

    @classmethod
    def from_sympy(
        cls,
        L: Any,
        constraints: Any = (),
        coordinates: Iterable[Any] | None = None,
        parameters: Mapping[Any, Any] | None = None,
        *,
        force: Mapping[Any, Any] | None = None,
        name: str = "system",
        help: str = "",
        description: str = "",
        source: str = "",
        q0: Any = None,
        v0: Any = None,
        exact: Any = None,
        invariants: Mapping[str, Any] | None = None,
    ) -> System:
        """Return the system of a Lagrangian and constraints that are SymPy expressions.

        Everything is differentiated and compiled to C, step routine included, and kept in a cache
        (see `dalembert.compiler`).  Parameters stay free: `with_parameters` compiles nothing.

        A term is left out only where it is proved to be zero, so walls such as ``Max(0, x - 2)**2``
        and numbers of any unit are kept.  The derivative of a ``Piecewise`` is that of its pieces:
        a jump exerts no force.  Outside of all its pieces it is not defined, and callbacks end in a
        `DomainError`.  Where Newton's method alone needs a derivative (V_qq, L_qq, f_q, f_v), that
        of a jump is taken as 0, and that at the edge of ``Max(0, x)**(3/2)`` as finite.

        Parameters
        ----------
        L : sympy.Expr
            The Lagrangian.  If it is v^T M v / 2 - V(q) with a constant M, the fast step routine is
            used.
        constraints : sequence, optional
            What vanishes, or an ``Eq``; linear, affine or nonlinear in the velocities, see `kind`.
            A list of n coefficients, and a row of a matrix, is a one-form mu(q).
        coordinates : sequence, optional
            Of `dalembert.coordinates`; of dynamicsymbols, whose velocities are their derivatives;
            or pairs (q, v) of symbols.  Default: all that occur, those of `dalembert.coordinates`
            in the order in which they were named there, then dynamicsymbols by name.
        parameters : mapping, optional
            Symbol, or its name, to value.  What a symbol assumes, as ``positive=True``, has to hold
            of every value that it gets, here and in `with_parameters`.
        force : mapping, optional
            Coordinate to component of a generalized force, d/dt L_v - L_q = f + mu^T lambda, in
            coordinates, velocities and the time ``dynamicsymbols._t``.
        name, help, description, source : str, optional
            As of `System`.
        q0, v0 : sequence, optional
            Default initial data; numbers, or expressions in the parameters.
        exact : sequence or callable, optional
            The exact solution: 2n expressions (q, v) in the time and in the symbols of the
            coordinates and velocities, which stand for the initial data; or
            ``exact(t, q0, v0, **parameters) -> (q, v)``.
        invariants : mapping, optional
            Name to expression, or to ``invariant(q, v, **parameters) -> float``.

        Returns
        -------
        System

        Raises
        ------
        ValueError
            If a symbol is left over, something has no place in a system, a function is not among
            what can be compiled, or a derivative needs a ``DiracDelta``.  The text names it.
        dalembert.compiler.CompilerError
            If the compiler refuses the program; the text has the line, and what it comes from.
        ImportError
            If SymPy is not installed.

        Warns
        -----
        DalembertWarning
            If there is no C compiler, so that Python functions are used; or no cache.

        Examples
        --------
        >>> import dalembert as dal
        >>> x, y, z = dal.coordinates("x y z")
        >>> own = dal.System.from_sympy(
        ...     L=(x.d**2 + y.d**2 + z.d**2) / 2, constraints=[z.d - y * x.d]
        ... )
        >>> own
        <System system(x, y, z): n = 3, m = 1>
        >>> own.multipliers([0, 1, 0], [1, 1, 1])
        array([0.5])
        """
        arguments.mapping(parameters, "parameters")
        arguments.mapping(force, "force")
        _require_named(invariants)
        state = None if q0 is None and v0 is None else symbolic.initial_data(q0, v0)
        in_model = state is not None and not isinstance(state, np.ndarray)
        named = symbolic.mapping(invariants, "invariants")
        model, values = symbolic.make_model(
            L,
            constraints,
            coordinates,
            parameters,
            force,
            state if in_model else None,
            exact if symbolic.is_expressions(exact) else None,
            {key: e for key, e in named.items() if symbolic.is_expressions(e)},
        )
        return cls._from_model(
            model,
            values,
            {"name": name, "help": help, "description": description, "source": source},
            None if in_model else state,
            None if symbolic.is_expressions(exact) else exact,
            {key: None if symbolic.is_expressions(e) else e for key, e in named.items()},
        )

    @classmethod
    def from_lagranges_method(
        cls, lm: Any, parameters: Mapping[Any, Any] | None = None, **options: Any
    ) -> System:
        """Return the system of a ``sympy.physics.mechanics.LagrangesMethod``.

        Its Lagrangian, ``nonhol_coneqs`` and ``forcelist`` are taken.  Mind the sign of the
        multipliers: here d/dt L_v - L_q = f + mu^T lambda.  The equations of a LagrangesMethod and
        its ``solve_multipliers`` have -lambda, its ``rhs()`` has lambda.

        Parameters
        ----------
        lm : sympy.physics.mechanics.LagrangesMethod
            Before or after ``form_lagranges_equations()``.
        parameters, **options
            As of `from_sympy`.

        Raises
        ------
        ValueError
            If there are holonomic constraints, the time is left over, or it is no LagrangesMethod.

        Examples
        --------
        >>> import dalembert as dal
        >>> from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols
        >>> x, y = dynamicsymbols("x y")
        >>> lm = LagrangesMethod(x.diff() ** 2 / 2 + y.diff() ** 2 / 2 - x, [x, y],
        ...                      nonhol_coneqs=[y.diff() - x * x.diff()])
        >>> dal.System.from_lagranges_method(lm).multipliers([0, 0], [1, 0])
        array([1.])
        """
        return cls.from_sympy(parameters=parameters, **{**symbolic.from_method(lm), **options})

    @classmethod
    def from_mechanics_system(
        cls, system: Any, parameters: Mapping[Any, Any] | None = None, **options: Any
    ) -> System:
        """Return the system of a ``sympy.physics.mechanics.System``.

        Its bodies give the Lagrangian, with their potential energies; its loads and actuators the
        force; its nonholonomic constraints are kept.  Generalized speeds are replaced by velocities
        after the kinematic differential equations.

        Parameters
        ----------
        system : sympy.physics.mechanics.System
        parameters, **options
            As of `from_sympy`.

        Raises
        ------
        ValueError
            If there are holonomic constraints or auxiliary speeds, or it is no such System.

        Examples
        --------
        >>> import dalembert as dal
        >>> from sympy.physics import mechanics
        >>> q, u = mechanics.dynamicsymbols("q u")
        >>> wall = mechanics.RigidBody("W")
        >>> system = mechanics.System.from_newtonian(wall)
        >>> bob = mechanics.Particle("P", mass=2)
        >>> bob.potential_energy = 3 * q**2 / 2
        >>> system.add_joints(mechanics.PrismaticJoint("J", wall, bob, q, u))
        >>> dal.System.from_mechanics_system(system).acceleration([1], [0])
        array([-1.5])
        """
        given = symbolic.from_system(system)
        return cls.from_sympy(parameters=parameters, **{**given, **options})

    @classmethod
    def _from_model(
        cls,
        model: Any,
        values: dict[str, float],
        about: dict[str, str],
        state: Array | None,
        exact: Callable[..., Any] | None,
        invariants: dict[str, Callable[..., Any] | None],
    ) -> System:
        """Make a system from a model; an invariant that is None is an expression of the model."""
        symbolic.require_assumed(model, values)
        texts = _texts(about)
        source, given = symbolic.Symbolic(model, values), invariants
        library = source.library()
        n = model.n
        if model.state is not None:
            state = source.matrix(library, "state", (2 * n,))
        if state is not None and len(state) != 2 * n:
            raise ValueError(f"(q0, v0): expected {n} numbers each, got {len(state)} in all")
        mass = source.matrix(library, "mass", (n, n))
        in_python = library is None
        if in_python or any(invariants.values()):
            invariants = {**source.invariants(invariants)}
        if library is None:
            source.warn(about["name"])
            self = cls(
                mass=mass,
                n=n,
                m=model.m,
                **about,
                coordinates=model.coordinates,
                q0=None if state is None else state[:n],
                v0=None if state is None else state[n:],
                invariants=invariants,
                **source.in_python(),
            )
        else:
            self = cls.__new__(cls)
            self._kept = library
            definition = ffi.new("dal_system_def *", library.definition[0])
            c_names, kept = _lib.strings(list(model.coordinates))
            c_invariants, also_kept = _lib.strings(list(invariants))
            definition.coordinates = c_names
            for key, text in texts.items():
                setattr(definition, key, text)
            definition.mass = ffi.NULL if mass is None else _lib.pointer(mass)
            definition.state = ffi.NULL if state is None else _lib.pointer(state)
            if values:
                definition.ctx = _lib.pointer(source.parameters)
                definition.ctx_size = source.parameters.nbytes
            if definition.invariant != ffi.NULL and None in invariants.values():
                definition.invariants = len(invariants)
                definition.invariant_names = c_invariants
                self._invariants = {}
            else:
                self._invariants = dict(invariants)
            self._adopt(_lib.make("system", definition))
            del kept, also_kept, texts
        if exact is not None:
            arguments.function(exact, "exact")
            self._exact = source.bound(exact)
        self._symbolic = source
        self._parameters = dict(values)
        self._description = (_restore_model, model, values, about, state, exact, given)
        return self

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
        self._of_library = True
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
        self._about = _lib.string(lib.dal_system_description(handle))
        self._source = _lib.string(lib.dal_system_source(handle))
        self._formulas = tuple(_lib.string(lib.dal_system_formulas(handle)).splitlines())
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
    def description(self) -> str:
        """What its coordinates and parameters are, in some sentences; "" if it does not say."""
        return self._about

    @property
    def source(self) -> str:
        """Where it is from, in the literature; "" if it does not say."""
        return self._source

    @property
    def formulas(self) -> tuple[str, ...]:
        """L, the constraints, and what else is in them or in names of invariants, a line each.

        ``v_x`` is the velocity of x, a blank a product, ``^`` a power.  Those of a system that was
        made by `from_sympy` follow from its expressions.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.systems.particle().formulas
        ('L = (v_x^2 + v_y^2 + v_z^2)/2', 'v_z - y v_x = 0')
        """
        if self._symbolic is None:
            return self._formulas
        formulas: tuple[str, ...] = self._symbolic.model.formulas()
        return formulas

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
                        self._handle, 0.0, _lib.pointer(x, k), _lib.pointer(values, k)
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
            Initial state, in D, both; neither: the system's.

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
                found = self._exact(float(time), x0[:n].copy(), x0[n:].copy())
                x[k, :n] = arguments.returned(found[0], (n,), "exact (q)")
                x[k, n:] = arguments.returned(found[1], (n,), "exact (v)")
                continue
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

    def check(
        self,
        q: ArrayLike | None = None,
        v: ArrayLike | None = None,
        *,
        progress: bool | Callable[[int, int], Any] = False,
    ) -> Check:
        """Examine the system at a state: derivatives, rank, definiteness, integrability, growth.

        Derivatives are compared with differences over several distances; what is wrong by less
        than 1e-7 of 1 + its size is not seen, and an entry where differences do not converge, such
        as a second derivative at a kink, is not judged.
        What depends on v is examined at another velocity too, where it is defined there, and the
        force at times 0 and 1.  The growth vector of D, and with it whether D is integrable, is
        found with many digits for a system made by `from_sympy`, and for one whose formulas say
        what it is if SymPy is installed; else by its functions, as far as their digits go.

        Parameters
        ----------
        q, v : array_like, shape (n,), optional
            Where to look, in the user's units, both; neither: the system's initial data; without
            any, and if the system was made by `from_sympy`, some state in D.  The growth vector is
            that at q if q is given, else that at a general point.
        progress : bool or callable, optional
            True: a bar of tqdm.  A function is called as ``progress(done, total)`` with numbers of
            dimensions that brackets add to D, m at a general point and m at q.

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
        >>> trailers = dal.systems.n_trailer(trailers=2)
        >>> trailers.check().growth
        (2, 3, 4, 5)

        It grows more slowly where the first trailer stands at a right angle to the car:

        >>> trailers.check([0, 0, 3.141592653589793 / 2, 0, 0], [0, 0, 0, 0, 0]).growth
        (2, 3, 4, 4, 5)
        """
        asked = q is not None
        if q is None and v is None and self._state is None and self._symbolic is not None:
            q, v = self._general_state()
        found = examine(self, q, v)
        if self._m == 0 or self._kind != "linear":
            return found
        place, _ = geometry.initial(self, q, v, "q", "v")
        at = place if asked else None
        total = self._m * (2 if asked else 1)
        with extras.progress(progress, total, "dimension") as show:
            distribution = growth.examine(self, place, at, show)
            show(total)
        return found.with_distribution(distribution)

    def _general_state(self) -> tuple[Array, Array]:
        """Return some state in D, in no special position."""
        source, first = np.random.default_rng(1), None
        for size in np.repeat((1.0, -1.0, 10.0, -10.0, 100.0, -100.0), 4):  # where it is defined
            q, v = source.uniform(0.2, 1.0, (2, self._n))
            state = size * q, v
            first = first or state
            with contextlib.suppress(_lib.DalembertError, ArithmeticError, ValueError):
                return state[0], self.project(*state)
        assert first is not None
        return first  # the examination says why

    def with_parameters(self, **parameters: float) -> System:
        """Return the system with other values of some parameters; nothing is compiled.

        Parameters
        ----------
        **parameters : float
            New values, in the user's units.

        Returns
        -------
        System

        Raises
        ------
        ValueError
            If the system has no such parameter, or the value is out of its range.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.systems.disk().with_parameters(R=0.5).parameters["R"]
        0.5
        """
        require_parameters(self.name, parameters, self._parameters)
        restore, first, *rest = self._description
        values = {
            **self._parameters,
            **{key: symbolic.parameter_value(x, key) for key, x in parameters.items()},
        }
        if restore is _restore_model:
            made = type(self)._from_model(first, values, *rest[1:])
            made._of_library = self._of_library
            return made
        return type(self)._builtin(first, values) if restore is _restore_builtin else self

    def c_source(self, name: str | None = None) -> str:
        """Return a C file with the system, for a program that is linked with libdalembert.

        It has one function, ``int NAME_system(dal_system **system, double p0, ..., dal_error
        *error)``, with the parameters in the order of `parameters`; what it makes steps as fast as
        this system.  ``cc own.c main.c -ffp-contract=off $(pkg-config --cflags --libs dalembert)``

        Parameters
        ----------
        name : str, optional
            The NAME, a C identifier.  Default: the system's name.

        Raises
        ------
        ValueError
            If the system was not made from expressions, or the name is no identifier.

        Examples
        --------
        >>> import dalembert as dal
        >>> x, y = dal.coordinates("x y")
        >>> own = dal.System.from_sympy(L=(x.d**2 + y.d**2) / 2, constraints=[y.d - x * x.d])
        >>> "int own_system(dal_system **system, dal_error *error);" in own.c_source("own")
        True
        """
        if self._symbolic is None:
            raise ValueError(f"the system {self.name!r} was not made by from_sympy")
        from . import codegen

        made = codegen.program(
            self._symbolic.model, symbolic.c_identifier(name, self.name), self
        )
        return made.source

    def _repr_latex_(self) -> str | None:
        """Return L, mu and the equations of motion for a notebook; None if they are not known."""
        return None if self._symbolic is None else f"${self._symbolic.model.latex()}$"

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
        values = ", ".join(f"{key} = {value:g}" for key, value in self._parameters.items())
        names = ", ".join(self.coordinates[:8]) + ", ..." * (self.n > 8)
        traits = (
            (", general Lagrangian" if self._mass is None else "")
            + (f", {self._kind}" if self._kind != "linear" else "")
            + (", forced" if self._is_forced else "")
        )
        parameters = f"; parameters {values}" if values else ""
        return f"<System {self.name}({names}): n = {self.n}, m = {self.m}{traits}{parameters}>"

    def __init_subclass__(cls) -> None:
        for name in ("n", "m"):
            if name in cls.__dict__:
                raise TypeError(f"{name} of a System is that of its functions, not of the class")

    def __copy__(self) -> System:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> System:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        restore, *description = self._description
        if isinstance(description[0], dict):
            _refuse_unpicklable(self.name, description[0])
        if restore is _restore_model:
            exact, invariants = description[-2:]
            functions = {key: f for key, f in invariants.items() if f is not None}
            _refuse_unpicklable(self.name, {"exact": exact, "invariants": functions})
            description = [self._of_library, *description]
        return restore, tuple(description)


def require_system(value: Any) -> None:
    """Raise ValueError if an argument ``system`` is not one."""
    if not isinstance(value, System):
        raise ValueError(
            f"system = {arguments.shown(value)}: expected a dalembert.System, as "
            "dalembert.systems.sleigh() returns"
        )


def require_parameters(name: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Raise ValueError for the first of the given parameters that the system does not have."""
    names = list(known)
    for key in given:
        if key not in names:
            raise ValueError(
                f"parameters: {name!r} has no {key!r}; {arguments.suggestion(key, names)}it has "
                f"{', '.join(names) or 'none'}"
            )


def _restore(description: dict[str, Any]) -> System:
    """Make a user's system again from its description."""
    return System(**description)


def _restore_model(of_library: bool, *description: Any) -> System:
    """Make a system again from its model."""
    system = System._from_model(*description)
    system._of_library = of_library
    return system


def _texts(about: Mapping[str, str]) -> dict[str, Any]:
    """Return the texts of a definition as C strings, which have to be kept alive."""
    return {key: ffi.new("char[]", arguments.text(x, key).encode()) for key, x in about.items()}


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


def _require_named(invariants: Any) -> None:
    """Raise ValueError if invariants are neither None nor a mapping from names."""
    arguments.mapping(invariants, "invariants")
    arguments.names(invariants or (), "invariants", "names that are strings")
    for name, value in (invariants or {}).items():
        if value is None:
            raise ValueError(f"invariants[{name!r}] = None: expected a function or an expression")


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


def _require_compiled(
    functions: dict[str, Callable[..., Any] | None],
    compiled: Mapping[str, pointers.Pointer],
    mass: Any,
    m: int | None,
) -> None:
    """Raise ValueError if something does not go together with C functions."""
    for key, function in functions.items():
        if function is not None and key != "exact" and key not in compiled:
            raise ValueError(
                f"{key} = {function!r} together with the C function {next(iter(compiled))}: "
                "expected C functions for potential, constraint, lagrangian and force, with their "
                "derivatives among the outputs, or Python functions"
            )
    if (mass is None) == ("lagrangian" not in compiled):
        raise ValueError("mass and lagrangian: expected one of the two")
    if mass is None and "potential" in compiled:
        raise ValueError("potential and lagrangian: expected one of the two")
    if ("constraint" in compiled) != bool(m):
        raise ValueError(f"m = {m}: expected the number of constraints, with a constraint only")


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
        return arguments.integer(n, "n", 1, _MOST_COORDINATES)
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
        shape = arguments.shape(constraint(point[:n], point[n:]))
        if len(shape) != 1:
            raise ValueError(
                "constraint has to return shape (m,), one number for each constraint, it "
                f"returned {shape}"
            )
    elif forms is not None:
        shape = arguments.shape(forms(point[:n]))
        if len(shape) != 2 or shape[1] != n:
            raise ValueError(
                f"forms has to return shape (m, {n}), one row for each constraint, "
                f"it returned {shape}"
            )
    return arguments.integer(shape[0], "m", 0)
