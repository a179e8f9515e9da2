"""Systems: the triple (Q = R^n, L, D) with D = {phi(q, v) = 0}, with an optional force."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import compiler, core, geometry, growth, symbolic
from ..core import KINDS, Handle, Pair, arguments, extras, lib
from ..core.documentation import Common
from ..core.extras import Progress
from ..core.functions import OfState, OfTime
from ..core.records import documents, method, options_of
from ..geometry import Check, examine
from ..geometry.mechanics import Documented
from . import sources
from .definition import About, SympyOptions, SystemOptions
from .sources import Source


CLOSE = 1e-6  # of position constraints: what is nearer satisfies them


@documents(SystemOptions)
class System(Handle):
    """A mechanical system with velocity constraints, defined by functions.

    The equations are ``d/dt L_v - L_q = f + phi_v^T lambda`` with ``phi(q, v) = 0``.  The
    Lagrangian L is ``v^T M v / 2 - V(q)`` with a constant mass matrix M, or any function with
    positive definite L_vv.  The constraints phi are linear, ``mu(q) v``; affine,
    ``mu(q) v + a(q)``; or nonlinear in v.  The force f may depend on time.  If the system is
    ``time_dependent``, so may all other functions.  `System.from_sympy` takes formulas instead of
    functions; `dalembert.systems` has ready-made systems.

    Attributes
    ----------
    n, m : int
        Numbers of coordinates and of constraints.
    name, help, description, source : str
        As given; "" if not given.
    coordinates : tuple of str
        Names of the n coordinates.
    mass : ndarray, shape (n, n), or None
        M, read-only; None if M is not constant (see `metric`).
    has_constant_mass : bool
        Whether M is constant; does not allocate the n^2 entries of ``mass``.
    sparsity : tuple of ndarray, or None
        Rows and columns of the entries that may be nonzero, as given or, with more than 8
        coordinates, as found in the expressions.  None if the system has no sparsity.
    kind : {"linear", "affine", "nonlinear"}
        How the constraints depend on v.
    is_forced : bool
        True if the system has a force f.
    is_time_dependent : bool
        True if the constraints or the Lagrangian depend on time.  The energy is then not conserved.
    inputs : tuple of str
        Names of the inputs of the force and of the constraints.
    is_driven : bool
        True if the constraints depend on inputs.
    units : dict of str to str
        As given; `unit` also returns the units of velocities.
    q0, v0 : ndarray, shape (n,), or None
        Default initial data, read-only; None if there are none.
    differenced : tuple of str
        Names of the derivatives that are replaced by central differences.

    Raises
    ------
    ValueError
        If an argument has the wrong shape, is missing or superfluous, or if the mass matrix is not
        symmetric and positive definite.  The message names the argument.

    Notes
    -----
    Derivatives that are not given are replaced by central differences and listed in
    ``differenced``.  Without ``gradient``, ``lagrangian_vq``, ``lagrangian_vv``, ``lagrangian_vt``,
    or the derivatives of the constraints by q or t, accelerations and multipliers are accurate to
    about 1e-12.  Without any other derivative only Newton's iteration is slower.

    Steps are fastest for constant mass, linear constraints and no force that depends on v.  All
    other systems are integrated by the form of the step routine in momenta.  A step that does not
    converge is repeated by Newton's iteration for all n + m unknowns.

    With a ``sparsity``, the time and memory of a step are proportional to n.  This requires masses
    instead of a matrix, and few coordinates in each constraint.  The Hessian of V and the
    derivatives of the force then serve only steps that do not converge without them, for n <= 500.
    Otherwise h has to resolve the oscillations and decay due to V and the force.  Chains and
    many-body systems lead to narrow bands and small blocks.  A constraint that shares a coordinate
    with all others, and a tree that branches everywhere, cost as much as a dense matrix of m rows.
    Only steps of beta-schemes and of the reference use the sparsity: `check`, `Chart`, `Discrete`,
    pairs, and ``run(t)`` allocate matrices of n rows.  Use ``t_eval`` instead of ``run(t)``.

    ``potential``, ``constraint``, ``lagrangian`` and ``force`` may be C functions.  Their arguments
    are those of ``dal_potential_fn`` and so on in ``dalembert.h``.  Pass a numba ``cfunc`` (see
    `dalembert.pointers.numba_wanted`), a function pointer of ctypes or cffi, or a SciPy
    ``LowLevelCallable``.  If one is a C function, all have to be; the derivatives are among their
    outputs, and m is required.  A step is then as fast as in C.  Python functions are called once
    for each evaluation, which is slower, vectorised or not.

    The functions receive read-only copies of arrays, which they may keep.  If a function raises an
    exception, the call that evaluated it raises the same exception.  A function may raise
    `dalembert.DomainError` for a state outside its domain.

    A system is immutable.  Threads may share it if its functions are thread-safe.  It is pickled as
    its definition.

    Examples
    --------
    >>> import dalembert as dal
    >>> own = dal.System(
    ...     mass=[1, 1, 1],
    ...     mu=lambda q: [[-q[1], 0, 1]],
    ...     mu_v_q=lambda q, v: [[0, -v[0], 0]],
    ...     coordinates=["x", "y", "z"],
    ... )
    >>> own.multipliers([0, 1, 0], [1, 1, 1])
    array([0.5])

    The same with friction, on a conveyor belt that moves with velocity 2:

    >>> belt = dal.System(
    ...     mass=[1, 1, 1],
    ...     mu=lambda q: [[-q[1], 0, 1]],
    ...     affine=lambda q: [-2],
    ...     force=lambda t, q, v: -v / 10,
    ...     coordinates=["x", "y", "z"],
    ... )
    >>> belt
    <System system(x, y, z): 3 coordinates, 1 affine constraint, forced>
    >>> belt.residual([0, 1, 0], [1, 1, 3])
    array([0.])

    A Lagrangian in polar coordinates, and a prescribed speed:

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

    A blade turned by a motor at the rate 2:

    >>> sin, cos = np.sin, np.cos
    >>> turned = dal.System(
    ...     mass=[1, 1],
    ...     mu=lambda t, q: [[sin(2 * t), -cos(2 * t)]],
    ...     constraint_t=lambda t, q, v: [2 * cos(2 * t) * v[0] + 2 * sin(2 * t) * v[1]],
    ...     coordinates=["x", "y"],
    ...     time_dependent=True,
    ... )
    >>> turned.multipliers([0, 0], [1, 0], t=0)
    array([-2.])
    """

    _progress: Progress | None = None  # of compiling

    @method(SystemOptions)
    def __init__(self, *args: Any, **given: Any) -> None:
        if hasattr(self, "_handle"):
            raise TypeError("a System cannot be changed: __init__ is called only once")
        asked = SystemOptions.of("System", args, given)
        self._take(sources.functions(asked), asked.units)

    @classmethod
    def _of(cls, source: Source, units: Mapping[str, str] | None = None) -> System:
        """Return the system defined by a source."""
        self = cls.__new__(cls)
        self._take(source, units)
        return self

    def _take(self, source: Source, units: Mapping[str, str] | None) -> None:
        made = source.make()
        self._source = source
        self._exact, self._invariants, self._has_exact, self._model = made[1:]
        self._adopt(made.handle)
        self._units = arguments.units(units, self.coordinates)
        if made.model is not None:
            self._parameters = source.values
        self.invariants = tuple(self._invariants) or tuple(
            core.string(lib.dal_system_invariant_name(made.handle, i))
            for i in range(lib.dal_system_invariants(made.handle))
        )

    @classmethod
    @method(SympyOptions)
    def from_sympy(cls, *args: Any, **given: Any) -> System:
        """Return the system defined by SymPy expressions for the Lagrangian and the constraints.

        The expressions are differentiated and compiled to C.  The first run compiles its part of
        the steps too: Taylor series, or the routine of the other schemes, which takes longest.  All
        of it is cached (see `dalembert.compiler`).  Parameters remain free: `with_parameters` does
        not compile again.

        A term is dropped only if it is proved to be zero; walls such as ``Max(0, x - 2)**2`` are
        kept.  A ``Piecewise`` is differentiated piece by piece: a jump exerts no force.  Outside
        all of its pieces it is undefined, and an evaluation there raises `DomainError`.
        Derivatives that only Newton's method uses (V_qq, L_qq, f_q, f_v) are taken as 0 at a jump,
        and as finite at the edge of ``Max(0, x)**(3/2)``.

        Returns
        -------
        System

        Raises
        ------
        ValueError
            If a symbol is unknown, an expression is not allowed in its place, a function cannot be
            compiled, or a derivative needs a ``DiracDelta``.  The message names it.
        dalembert.compiler.CompilerError
            If the compiler rejects the program; the message has the line.
        ImportError
            If SymPy is not installed.

        Warns
        -----
        DalembertWarning
            If there is no C compiler, so that the slower Python functions are used, or no cache.

        Examples
        --------
        >>> import dalembert as dal
        >>> x, y, z = dal.coordinates("x y z")
        >>> own = dal.System.from_sympy(
        ...     L=(x.d**2 + y.d**2 + z.d**2) / 2, constraints=[z.d - y * x.d]
        ... )
        >>> own
        <System system(x, y, z): 3 coordinates, 1 constraint>
        >>> own.multipliers([0, 1, 0], [1, 1, 1])
        array([0.5])
        """
        asked = SympyOptions.of("from_sympy", args, given)
        arguments.mapping(asked.parameters, "parameters")
        arguments.mapping(asked.force, "force")
        sources.require_named(asked.invariants)
        values = {name: x for name, x in vars(asked).items() if name not in ("units", "progress")}
        about = {name: values.pop(name) for name in options_of(About)}
        first = [values.pop(name) for name in ("L", "constraints", "coordinates", "parameters")]
        taken = symbolic.given.take(*first, **values)
        with compiler.showing(asked.progress):
            made = cls._of(sources.Expressions(about=about, **taken), asked.units)
        made._progress = asked.progress
        return made

    @classmethod
    def from_lagranges_method(
        cls, lm: Any, parameters: Mapping[Any, Any] | None = None, **options: Any
    ) -> System:
        """Return the system of a ``sympy.physics.mechanics.LagrangesMethod``.

        The system has the Lagrangian, the constraints and the ``forcelist`` of the method;
        ``hol_coneqs`` become the ``positions`` of `from_sympy`.  A load that is constant in
        ``frame`` becomes a part of V, any other load a force.  The sign of the multipliers differs:
        here d/dt L_v - L_q = f + mu^T lambda.  The equations of a LagrangesMethod and its
        ``solve_multipliers`` contain -lambda; its ``rhs()`` contains lambda.

        Parameters
        ----------
        lm : sympy.physics.mechanics.LagrangesMethod
            Before or after ``form_lagranges_equations()``.
        parameters, **options
            As for `from_sympy`.

        Raises
        ------
        ValueError
            If ``lm`` is not a LagrangesMethod.

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
        given = symbolic.mechanisms.from_method(lm, options.get("inputs", ()))
        return cls.from_sympy(parameters=parameters, **{**given, **options})

    @classmethod
    def from_mechanics_system(
        cls, system: Any, parameters: Mapping[Any, Any] | None = None, **options: Any
    ) -> System:
        """Return the system of a ``sympy.physics.mechanics.System``.

        The bodies and their potential energies define the Lagrangian.  A load that is constant in
        the inertial frame, such as a weight, becomes a part of V; other loads and actuators define
        the force.  Velocity constraints are kept; holonomic constraints become the ``positions`` of
        `from_sympy`.  The kinematic differential equations replace generalized speeds by
        velocities.

        Parameters
        ----------
        system : sympy.physics.mechanics.System
        parameters, **options
            As for `from_sympy`.

        Raises
        ------
        ValueError
            If ``system`` is not such a System or has auxiliary speeds, or a speed has no kinematic
            differential equation.  Also if the velocity of a mass centre is not the derivative of
            its position, or an angular velocity does not belong to an orientation.

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
        given = symbolic.mechanisms.from_system(system, options.get("inputs", ()))
        return cls.from_sympy(parameters=parameters, **{**given, **options})

    # ---- what the system is --------------------------------------------------------------

    @Documented("ValueError")
    def invariant(self, q: ArrayLike, v: ArrayLike, t: ArrayLike = 0.0) -> dict[str, Any]:
        """Return the first integrals besides the energy.

        Returns
        -------
        dict of str to float or ndarray
            For each name a float, or an array of shape (N,) for stacked states.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.System(mass=[1, 1], invariants={"p": lambda q, v: v[0]}).invariant([0, 0], [2, 1])
        {'p': 2.0}
        """
        x, single = geometry.states(self, q, v)
        n, names = self.n, self.invariants
        times = np.broadcast_to(arguments.array(t, "t", *[(), (len(x),)][: 2 - single]), len(x))
        values = np.empty((len(x), len(names)))
        for k, (at, row) in enumerate(zip(times.tolist(), x)):
            if self._invariants:
                before = (at,) * self.is_time_dependent
                values[k] = [
                    arguments.returned(f(*before, row[:n].copy(), row[n:].copy()), (), name)
                    for name, f in self._invariants.items()
                ]
            elif names:
                output = values[k]
                core.check(
                    core.attempt(lib.dal_system_invariant, self._handle, at, row, output), step=k
                )
        return {name: core.first(values[:, i], single) for i, name in enumerate(names)}

    @property
    def conserves_energy(self) -> bool:
        """True if the type of the system implies that the energy is conserved.

        This holds if the constraints are linear and independent of inputs, there is no force, and
        neither Lagrangian nor constraints depend on time.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.systems.particle().conserves_energy, dal.systems.ball_on_table().conserves_energy
        (True, False)
        """
        acted_on = self.is_forced or self.is_driven or self.is_time_dependent
        return self.kind == "linear" and not acted_on

    @property
    def has_exact(self) -> bool:
        """True if the system has an exact solution, see `exact`."""
        if self._has_exact is not None:
            return self._has_exact
        x = np.zeros(2 * self.n) if self.q0 is None else np.concatenate([self.q0, self.v0])
        y = np.empty_like(x)
        status = core.attempt(lib.dal_system_exact, self._handle, 0.0, x, y)
        return bool(status != lib.DAL_EUNSUPPORTED)

    @Common("ValueError", "q, v : ndarray, shape (n,) or (N, n)")
    def exact(
        self, t: ArrayLike, q0: ArrayLike | None = None, v0: ArrayLike | None = None
    ) -> Pair:
        """Return the exact state at time t of the solution that starts from (q0, v0) at time 0.

        Parameters
        ----------
        t : float or array_like, shape (N,)
            Time since the initial state, in the user's units; negative times are allowed.

        Raises
        ------
        NotImplementedError
            If the system has no exact solution.

        Examples
        --------
        >>> import dalembert as dal
        >>> q, v = dal.systems.particle().exact(1.0, [0, 0, 0], [0, 1, 0])
        >>> q
        array([0., 1., 0.])
        """
        times = arguments.array(t, "t", (), (None,))
        n = self.n
        x0 = geometry.initial_state(self, q0, v0)
        x = np.empty((times.size, 2 * n))
        for k, time in enumerate(np.atleast_1d(times)):
            if self._exact is not None:
                found = self._exact(float(time), x0[:n].copy(), x0[n:].copy())
                x[k, :n] = arguments.returned(found[0], (n,), "exact (q)")
                x[k, n:] = arguments.returned(found[1], (n,), "exact (v)")
                continue
            status = core.attempt(lib.dal_system_exact, self._handle, float(time), x0, x[k])
            if status == lib.DAL_EUNSUPPORTED:
                raise NotImplementedError(f"the system {self.name!r} has no exact solution")
            core.check(status, step=k)
        x = core.first(x, times.ndim == 0)
        return x[..., :n], x[..., n:]

    def check(
        self,
        q: ArrayLike | None = None,
        v: ArrayLike | None = None,
        *,
        t: float = 0.0,
        progress: Progress = False,
    ) -> Check:
        """Check the system at a state: derivatives, rank, definiteness, integrability, growth.

        Derivatives are compared with differences over several distances.  An error below
        ``1e-7 (1 + |derivative|)`` is not detected.  An entry whose differences do not converge,
        such as a second derivative at a kink, is not judged.  Functions of v are checked at a
        second velocity too, if they are defined there, and functions of time also at t + 1.

        The growth vector of D shows whether D is integrable.  It is computed with many digits for
        systems from `from_sympy`.  With SymPy installed, this also holds for systems whose
        ``formulas`` are complete.  Otherwise it is computed from function values, to their
        accuracy.  It is not computed if the system depends on time or its constraints depend on
        inputs.  In the second case v has to satisfy the constraints with inputs 0.

        Parameters
        ----------
        q, v : array_like, shape (n,), optional
            The state in the user's units; pass both or neither.  Default: the system's initial
            data, or, if a system from `from_sympy` has none, a random state in D. The growth vector
            is computed at a general point and, if q is given, at q.
        t : float, optional
            The time.
        progress : bool or callable, optional
            True: show a tqdm bar.  A function is called as ``progress(done, total)``, where done is
            the number of dimensions that brackets have added to D. The total is m at the general
            point, plus m at q.

        Returns
        -------
        Check
            True if all checks pass; ``print(system.check())`` shows the results.

        Raises
        ------
        ValueError
            If q or v has another shape, or none is given and the system has no initial data.
        Exception
            Any exception raised by a function of the system.

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

        The growth is slower if the first trailer is at a right angle to the car:

        >>> trailers.check([0, 0, 3.141592653589793 / 2, 0, 0], [0, 0, 0, 0, 0]).growth
        (2, 3, 4, 4, 5)
        """
        asked = q is not None
        if q is None and v is None and self.q0 is None and self._model is not None:
            q, v = self._general_state()
        found = examine(self, q, v, arguments.number(t, "t"))
        if (q is not None or self.q0 is not None) and (off := self.off_positions(q, t)):
            found = dataclasses.replace(found, passed=False, text=off)
        if self.kind == "affine" and self._model is not None:
            found = dataclasses.replace(found, still=self._model.still())
        if self.m == 0 or self.kind != "linear" or self.is_time_dependent or self.is_driven:
            return found
        place, _ = geometry.initial(self, q, v, "q", "v")
        at = place if asked else None
        total = self.m * (2 if asked else 1)
        with extras.progress(progress, total, "dimension") as show:
            distribution = growth.examine(self, place, at, show)
            show(total)
        return found.with_distribution(distribution)

    @property
    def positions(self) -> tuple[str, ...]:
        """The position constraints given to `from_sympy`, as text."""
        model = self._model
        return () if model is None else tuple(str(model.shown(e)) for e in model.positions)

    def off_positions(self, q: ArrayLike | None = None, t: float = 0.0) -> str:
        """Return a message if q violates a position constraint, else "".

        The violation of g = 0, one of the ``positions`` of `from_sympy`, is ``|g|`` divided by
        ``sum_i |dg/dq_i| (1 + |q_i|)``; up to 1e-6 is allowed.  The message has the first violated
        constraint, its value and its violation.

        Parameters
        ----------
        q : array_like, shape (n,), optional
            Default: the system's initial data.
        t : float, optional

        Examples
        --------
        >>> import dalembert as dal
        >>> x, y = dal.coordinates("x y")
        >>> bob = dal.System.from_sympy(
        ...     (x.d**2 + y.d**2) / 2 - y, [x * x.d + y * y.d], positions=[x**2 + y**2 - 1]
        ... )
        >>> bob.off_positions([0, -1]), bob.off_positions([0, -1.01])[:12]
        ('', 'positions[0]')
        """
        model = self._model
        if model is None or not model.positions:
            return ""
        q = self.q0 if q is None else arguments.array(q, "q", (self.n,))
        k = len(model.positions)
        found = np.array(model.at_positions(t, q, list(self.parameters.values())), dtype=float)
        off = abs(found[:k]) / (abs(found[k:].reshape(k, -1)) @ (1.0 + abs(q)))
        for i in np.flatnonzero(~(off <= CLOSE)):
            return (
                f"positions[{i}] = {self.positions[i]} is {found[i]:.3g} at t = {t:g}: "
                f"relative error {off[i]:.1e}, allowed {CLOSE:g}"
            )
        return ""

    def _general_state(self) -> Pair:
        """Return a random state in D."""
        source, first = np.random.default_rng(1), None
        for size in np.repeat((1.0, -1.0, 10.0, -10.0, 100.0, -100.0), 4):  # where it is defined
            q, v = source.uniform(0.2, 1.0, (2, self.n))
            state = size * q, v
            first = first or state
            with contextlib.suppress(core.DalembertError, ArithmeticError, ValueError):
                return state[0], self.project(*state)
        assert first is not None
        return first  # the examination says why

    def with_parameters(self, **parameters: float) -> System:
        """Return the system with other parameter values, without compiling again.

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
        new = {key: arguments.parameter(x, key) for key, x in parameters.items()}
        source = self._source.with_values(self._parameters | new)
        return self if source is self._source else type(self)._of(source, self._units)

    def with_units(self, **units: str) -> System:
        """Return the system with other units of coordinates, of the time or of the energy.

        Parameters
        ----------
        **units : str
            As for `System`; use ``**{"name": unit}`` if a name is not a Python identifier.

        Returns
        -------
        System

        Raises
        ------
        ValueError
            If the system has no such coordinate, or a unit is not a str.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.systems.disk().with_units(x="m", y="m", t="s").units
        {'x': 'm', 'y': 'm', 't': 's'}
        """
        return type(self)._of(self._source, {**self._units, **units})

    def c_source(self, name: str | None = None, derivatives: int = 0) -> str:
        """Return C source that defines the system, for programs linked with libdalembert.

        It defines one function,
        ``int NAME_system(dal_system **system, double PARAMETER, ..., dal_error *error)``, with the
        parameters in the order of `parameters`.  Names reserved in C or C++ get an underscore.
        Steps of the new system are as fast as those of this one.  `c_header` declares the function.
        To compile:

        ``cc own.c main.c -ffp-contract=off $(pkg-config --cflags --libs dalembert) -lm``

        Parameters
        ----------
        name : str, optional
            NAME, a C identifier.  Default: the system's name.
        derivatives : {0, 1, 2}, optional
            The order of the derivatives of motions that the program computes, see
            ``dalembert/taylor.h``; default: none.

        Raises
        ------
        ValueError
            If the system was not made by `from_sympy`, the name is not an identifier, or the order
            is another.

        Examples
        --------
        >>> import dalembert as dal
        >>> x, y = dal.coordinates("x y")
        >>> own = dal.System.from_sympy(L=(x.d**2 + y.d**2) / 2, constraints=[y.d - x * x.d])
        >>> "int own_system(dal_system **system, dal_error *error);" in own.c_source("own")
        True
        """
        parts = {0: "", **{order: part for part, order in symbolic.codegen.VARIED.items()}}
        if derivatives not in parts:
            raise ValueError(f"derivatives = {derivatives!r}: expected 0, 1 or 2")
        model, identifier = self._named_for_c(name)
        part = parts[derivatives]
        source: str = symbolic.codegen.program(model, identifier, self, part=part).source
        return source

    def c_header(self, name: str | None = None) -> str:
        """Return a C and C++ header that declares the function of `c_source`.

        Parameters
        ----------
        name : str, optional
            As in `c_source`.

        Raises
        ------
        ValueError
            As in `c_source`.

        Examples
        --------
        >>> import dalembert as dal
        >>> import sympy
        >>> x, g = dal.coordinates("x")[0], sympy.Symbol("g")
        >>> own = dal.System.from_sympy(L=x.d**2 / 2 - g * x, parameters={g: 9.81})
        >>> [line for line in own.c_header("own").split("\\n") if "(" in line]
        ['int own_system(dal_system **system, double g, dal_error *error);']
        """
        _, identifier = self._named_for_c(name)
        text: str = symbolic.constructor.header(identifier, self)
        return text

    def _named_for_c(self, name: str | None) -> tuple[Any, str]:
        """Return the model and its name in C."""
        if self._model is None:
            raise ValueError(f"the system {self.name!r} was not made by from_sympy")
        return self._model, symbolic.constructor.c_identifier(name, self.name)

    def reduced(self, dependent: str | Iterable[str] | None = None) -> Any:
        """Return the equations of motion on D in closed form, as by Hamel.

        The velocities are v = E(q) w + e(q), with a basis E of the kernel of mu that has full rank
        wherever mu has.  The scheme "taylor" integrates these equations.  Before they are returned
        they are compared with the multipliers, at two points with 40 digits.

        Parameters
        ----------
        dependent : str or iterable of str, optional
            Names of m coordinates.  Then w are the velocities of the others, and the equations hold
            where these determine the dependent ones, as in a `Chart`.

        Returns
        -------
        dalembert.symbolic.equations.Equations
            w, E, e, rates (of w) and how (E was found), in SymPy; in a notebook a formula; ``c`` is
            the same as two C functions.

        Raises
        ------
        NotImplementedError
            If no such E is found, or the constraints are nonlinear.
        ValueError
            If the system has no formulas, or other than m names of coordinates are given.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.systems.knife_edge().reduced().E
        Matrix([
        [cos(theta), 0],
        [sin(theta), 0],
        [         0, 1]])
        """
        model = symbolic.expressions.model(self) if self._model is None else self._model
        places = None if dependent is None else geometry.chart.indices(self, dependent)
        return symbolic.equations.equations(model, places)

    def _repr_latex_(self) -> str | None:
        """Return L, mu and the equations of motion for a notebook, None without expressions."""
        return None if self._model is None else f"${self._model.latex()}$"

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

    # ---- other constraints -----------------------------------------------------------------

    def deformed(
        self,
        g: OfState,
        delta: float,
        *,
        g_v: OfState,
        g_q: OfState | None = None,
        g_t: OfTime | None = None,
        kind: str = "nonlinear",
    ) -> System:
        """Return the system with the constraints phi + delta g = 0 (deformation, DefCons, DefDAE).

        Its `gram` is C_delta, its `multipliers` are lambda_delta and its `field` is h_delta (Ceps,
        heps).  Constraints that are nonlinear in v do work (see `power`), so the energy is not
        conserved.  The exact solution, the invariants and the initial data are not carried over;
        ``deformed.project(q, v)`` returns a velocity in the deformed D.

        Parameters
        ----------
        g : callable
            The deformation ``g(q, v) -> (m,)``.
        delta : float
            The size of the deformation, in the user's units.
        g_v : callable
            ``g_v(q, v) -> (m, n)``: entry [a, i] is dg^a/dv_i.
        g_q : callable, optional
            ``g_q(q, v) -> (m, n)``: entry [a, j] is dg^a/dq_j.  By default d(phi + delta g)/dq is
            replaced by central differences (see ``differenced``).
        g_t : callable, optional
            ``g_t(t, q, v) -> (m,)``: dg^a/dt, only if the system depends on time; by default
            central differences. g, g_v and g_q then take t as their first argument too.
        kind : {"nonlinear", "affine", "linear"}, optional
            How phi + delta g depends on v.

        Returns
        -------
        System
            Keeps this system alive; can be pickled if g, g_v, g_q and g_t can.

        Raises
        ------
        ValueError
            If an argument is out of range, the system has no constraints, or ``kind`` is simpler
            than the kind of this system.
        NotImplementedError
            If m n > 4000.

        Examples
        --------
        The particle, deformed by g = v_x v_y:

        >>> import dalembert as dal
        >>> bent = dal.systems.particle().deformed(
        ...     lambda q, v: [v[0] * v[1]], 0.5, g_v=lambda q, v: [[v[1], v[0], 0]],
        ...     g_q=lambda q, v: [[0, 0, 0]],
        ... )
        >>> bent.residual([0, 1, 0], [2, 2, 0])
        array([0.])
        >>> bent.multipliers([0, 1, 0], [2, 2, 0]).round(12)
        array([2.])
        >>> [round(power, 12) for power in bent.power([0, 1, 0], [2, 2, 0])]
        [4.0, 0.0]
        """
        for function, name in ((g, "g"), (g_v, "g_v"), (g_q, "g_q"), (g_t, "g_t")):
            arguments.function(function, name)
        if g_t is not None and not self.is_time_dependent:
            raise ValueError("g_t is given, but the system does not depend on time; remove it")
        if g is None or g_v is None:
            raise ValueError("g(q, v) and g_v(q, v) -> dg/dv: expected both of them")
        if arguments.choice(kind, "kind", KINDS) < KINDS[self.kind]:
            raise ValueError(
                f"kind = {kind!r}: expected at least {self.kind}, the kind of the constraints "
                "of the system"
            )
        delta = arguments.number(delta, "delta")
        source = sources.Deformed(self, g, delta, g_v, g_q, g_t, kind)
        return type(self)._of(source, self._units)

    def at_kept_nodes(self, shift: float) -> System:
        """Return the system with the constraints phi(q - shift v, v) = 0 (deformedCons).

        For ``shift = scheme.shift(h)``, which is (1 - beta) h, its D is the set D_eps that the
        scheme with kept nodes preserves (originalnodes).  These constraints are nonlinear.  The
        scheme is of order 1 for the flow of the new system, as it is for the flow of this one.

        Parameters
        ----------
        shift : float
            A time, in the user's units.

        Returns
        -------
        System
            Keeps this system alive; can be pickled if this system can.

        Raises
        ------
        ValueError
            If the shift is not finite, or the system lacks ``mu_v_q``
            (``constraint_q`` if the constraints are nonlinear).
        NotImplementedError
            If m n > 4000.

        Examples
        --------
        >>> import dalembert as dal
        >>> particle, scheme = dal.systems.particle(), dal.Scheme.find("midpoint-nodes")
        >>> run = dal.integrate(particle, scheme, h=0.1, steps=50, initial="shift")
        >>> in_D_eps = particle.at_kept_nodes(scheme.shift(0.1))
        >>> bool(in_D_eps.relative_residual(run.q, run.v).max() < 1e-15)
        True
        """
        shift = arguments.number(shift, "shift")
        if lib.dal_system_missing(self._handle) & lib.DAL_MISSING_PHI_Q:
            needed = "constraint_q" if self.kind == "nonlinear" else "mu_v_q"
            raise ValueError(f"{needed} is missing: the system {self.name!r} does not provide it")
        return type(self)._of(sources.AtKeptNodes(self, shift), self._units)

    # ---- as an object --------------------------------------------------------------------

    def __repr__(self) -> str:
        values = ", ".join(f"{key} = {value:g}" for key, value in self._parameters.items())
        names = ", ".join(self.coordinates[:8]) + ", ..." * (self.n > 8)
        traits = (
            ("" if self.has_constant_mass else ", general Lagrangian")
            + (", forced" if self.is_forced else "")
            + (", driven" if self.is_driven else "")
            + (", depends on time" if self.is_time_dependent else "")
            + (f", inputs {', '.join(self.inputs)}" if self.inputs else "")
        )
        parameters = f"; parameters {values}" if values else ""
        return f"<System {self.name}({names}): {self._sizes}{traits}{parameters}>"

    @property
    def _sizes(self) -> str:
        """The numbers of coordinates and of constraints, in words."""
        one, some = "coordinate" + "s" * (self.n != 1), "constraint" + "s" * (self.m != 1)
        kind = f"{self.kind} " if self.kind != "linear" else ""
        return f"{self.n} {one}, {self.m or 'no'} {kind}{some}"

    @property
    def _identity(self) -> Any:
        """Return data for JSON that identify the system as far as possible.

        A system made of functions is identified by their names and the mass, not by their values.
        """
        return [self._source.identity(), self.parameters]

    def __init_subclass__(cls) -> None:
        for name in ("n", "m"):
            if name in cls.__dict__:
                raise TypeError(f"{name} of a System belongs to its functions, not to the class")

    def __copy__(self) -> System:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> System:
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        self._source.require_picklable(self.name)
        return System._of, (self._source, self._units)


def require_parameters(name: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Raise ValueError for the first given parameter that the system does not have."""
    names = list(known)
    for key in given:
        if not names:
            raise ValueError(f"parameters: {key!r} is given, but the system {name!r} has none")
        if key not in names:
            raise ValueError(
                f"parameters: {name!r} has no {key!r}; {arguments.suggestion(key, names)}it has "
                f"{', '.join(names)}"
            )
