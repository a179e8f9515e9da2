"""The arguments of systems, in groups: of functions, and of expressions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from numpy.typing import ArrayLike

from ..core import Array
from ..core.functions import OfPoint, OfState, OfTime, OfTimeTwo
from ..core.records import Record, extended, meaning, option

# fmt: off


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Lagrangian:
    mass: ArrayLike | None = option("array_like, shape (n, n), (n,) or ()", """
        The mass matrix M, its diagonal, or one mass for all coordinates; M is symmetric and
        positive definite.  Pass either ``mass`` or ``lagrangian``.""")
    potential: Callable[[Array], float] | None = option(
        "callable", "``potential(q) -> float``: V.  Default: V = 0.")
    gradient: OfPoint | None = option("callable", "``gradient(q) -> (n,)``: dV/dq_j.")
    hessian: OfPoint | None = option("callable", "``hessian(q) -> (n, n)``: d2V/dq_i dq_j.")
    lagrangian: Callable[[Array, Array], float] | None = option("callable")
    lagrangian_q: OfState | None = option("callable")
    lagrangian_v: OfState | None = option("callable", """
        A general Lagrangian, instead of ``mass`` and ``potential``; all three are required.
        ``lagrangian(q, v) -> float``: L; ``lagrangian_q(q, v) -> (n,)``: dL/dq_i;
        ``lagrangian_v(q, v) -> (n,)``: dL/dv_i.""")
    lagrangian_qq: OfState | None = option("callable")
    lagrangian_vq: OfState | None = option("callable")
    lagrangian_vv: OfState | None = option("callable", """
        Second derivatives, functions of (q, v) of shape (n, n): d2L/dq_i dq_j; d2L/dv_i dq_j with
        the velocity as row; d2L/dv_i dv_j, symmetric and positive definite.""")
    lagrangian_vt: OfTime | None = option("callable", """
        ``lagrangian_vt(t, q, v) -> (n,)``: d2L/dv_i dt.  Requires ``time_dependent``.""")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Constraints:
    mu: OfPoint | None = option("callable", """
        ``mu(q) -> (m, n)``: mu(q), one row for each constraint.  If neither ``mu`` nor
        ``constraint`` is given, the system has no constraints.""")
    mu_v_q: OfState | None = option("callable", """
        ``mu_v_q(q, v) -> (m, n)``: entry [a, j] is d(mu^a(q) v)/dq_j.""")
    affine: OfPoint | None = option("callable")
    affine_derivative: OfPoint | None = option("callable", """
        ``affine(q) -> (m,)``: a(q), so that the constraints are mu(q) v + a(q) = 0;
        ``affine_derivative(q) -> (m, n)``: entry [a, j] is da^a/dq_j.  Pass both
        ``affine_derivative`` and ``mu_v_q``, or neither.""")
    constraint: OfState | None = option("callable")
    constraint_v: OfState | None = option("callable")
    constraint_q: OfState | None = option("callable", """
        Nonlinear constraints, instead of ``mu``.  ``constraint(q, v) -> (m,)``: phi;
        ``constraint_v(q, v) -> (m, n)``: dphi^a/dv_i, required, of rank m along the motion;
        ``constraint_q(q, v) -> (m, n)``: dphi^a/dq_j.""")
    steady: bool = option("bool", """
        Whether mu depends only on coordinates on which no constraint force acts, such as the
        heading of a blade.  Row i of M^-1 mu^T is zero for such a coordinate i.  Requires ``mass``
        and ``mu``.  The steps are then linear, without iteration.  A step at which the
        declaration proves false raises an error.""", default=False)
    sparsity: Any = option("array_like or sparse array, shape (m, n), or tuple (rows, columns)", """
        The entries that may be nonzero in mu or in d(mu v)/dq, sorted by row and then by column.
        ``mu`` and ``mu_v_q`` then return an array of these entries alone.
        See Notes.""")
    time_dependent: bool = option("bool", """
        Whether the constraints or the Lagrangian depend on time.  If so, all functions, invariants
        included, take t as an additional first argument: ``mu(t, q)``, ``constraint(t, q, v)``.
    """, default=False)
    constraint_t: OfTime | None = option("callable", """
        ``constraint_t(t, q, v) -> (m,)``: dphi^a/dt, which is d(mu^a(t, q) v)/dt for linear
        constraints.  Requires ``time_dependent``.""")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Forces:
    force: OfTime | None = option("callable")
    force_q: OfTime | None = option("callable")
    force_v: OfTime | None = option("callable", """
        ``force(t, q, v) -> (n,)``: f; ``force_q(t, q, v) -> (n, n)``: df_i/dq_j;
        ``force_v(t, q, v) -> (n, n)``: df_i/dv_j.  With ``inputs`` the arguments are (t, q, v, u).
    """)
    inputs: Sequence[str] | int | None = option("sequence of str or int", """
        Names of the inputs u, or their number.  Inputs change from step to step of a run, as motor
        torques do; see `dalembert.integrate` and `dalembert.Stepper`.  Functions that accept no
        inputs, such as order studies, use zeros.""")
    driven: bool = option("bool", """
        Whether the constraints depend on the inputs, as v - u = 0 does.  If so, ``mu``,
        ``affine``, ``constraint`` and their derivatives take u as an additional last argument:
        ``mu(q, u)``, ``constraint(q, v, u)``.""", default=False)
    positional: bool = option("bool", """
        Whether the force depends on t, q and its inputs alone.  Steps then treat it like the
        gradient of a potential, which is faster, and pass NaN for v.""", default=False)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class About:
    name: str = option("str", default="system")
    help: str = option("str", "A name, and a description of one line.", default="")
    description: str = option("str", default="")
    source: str = option("str", """
        Some sentences about the coordinates and parameters; the source in the literature.
    """, default="")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Names:
    n: int | None = option("int", """
        Number of coordinates; required if neither ``mass``, ``coordinates`` nor ``q0`` determines
        it.""")
    m: int | None = option("int", """
        Number of constraints.  Default: the number of rows that ``mu`` returns at ``q0`` or at
        0.  With ``constraint``, the number of values at (q0, v0), or at q = 0, v = (1, ..., 1).""")
    formulas: Sequence[str] = option("sequence of str", """
        "L = ...", the constraints "... = 0", and "where NAME = ..." for each other symbol in these
        and in the names of invariants.  ``v_x`` is the velocity of x, a blank a product, ``^`` a
        power.""", default=())
    coordinates: Sequence[str] | None = option("sequence of str", """
        Names of the coordinates; default "q0", "q1", ...""")
    units: Mapping[str, str] | None = option("mapping of str to str", """
        Units of coordinates, of the time and of the energy: {"x": "m", "theta": "rad", "t": "s",
        "energy": "J"}.  Plots, pages and files show them; nothing is converted.""")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Motion:
    q0: ArrayLike | None = option("array_like, shape (n,)")
    v0: ArrayLike | None = option(
        "array_like, shape (n,)", "Default initial data; pass both or neither.")
    exact: OfTimeTwo | None = option("callable", """
        ``exact(t, q0, v0) -> (q, v)``: the exact state at time t of the solution that starts from
        (q0, v0) at time 0.""")
    invariants: Mapping[str, Callable[[Array, Array], float]] | None = option(
        "mapping of str to callable", """
        First integrals besides the energy: name to ``invariant(q, v) -> float``.
    """)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class InC:
    kind: str | None = option('{"linear", "affine", "nonlinear"}', """
        How a ``constraint`` given as a C function depends on v; default "linear".""")
    missing: Sequence[str] | None = option("sequence of str", """
        Outputs that the C functions do not write: "V_q", "V_qq", "phi_q", "L_qq", ...""")
    ctx: Any = option("array, address or pointer", """
        Last argument passed to the C functions.  The object is kept alive; the C functions may only
        read it.""")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SystemOptions(InC, Motion, Names, About, Forces, Constraints, Lagrangian, Record):
    """The arguments of `System`, which are functions."""

    renamed: ClassVar = {"forms": "mu", "forms_velocity_derivative": "mu_v_q"}


@dataclass(frozen=True, eq=False, repr=False)
class _Formulas(Record):
    L: Any = field(metadata=meaning("sympy.Expr", """
        The Lagrangian.  Steps are fastest if it is v^T M v / 2 - V(q) with constant M."""))
    constraints: Any = option("sequence", """
        Each constraint is an expression that vanishes or an ``Eq``, and is linear, affine or
        nonlinear in the velocities.  A list of n coefficients, or a row of a matrix, is a
        one-form mu(q).  The symbol of the time is `dalembert.time`, or ``dynamicsymbols._t``
        together with dynamicsymbols.""", default=())
    coordinates: Iterable[Any] | None = option("sequence", """
        Coordinates from `dalembert.coordinates`, dynamicsymbols (the velocities are their
        derivatives), or pairs (q, v) of symbols.  Default: all coordinates in the expressions;
        those of `dalembert.coordinates` in the order of their definition, then dynamicsymbols
        by name.""")
    parameters: Mapping[Any, Any] | None = option("mapping", """
        Symbol, or its name, to value.  The assumptions of a symbol, such as ``positive=True``,
        have to hold for each value, also in `with_parameters`.""")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SympyOptions(About, _Formulas):
    """The options of `System.from_sympy`."""

    force: Mapping[Any, Any] | None = option("mapping", """
        Coordinate to component of the generalized force f in d/dt L_v - L_q = f + mu^T lambda.
        A component may contain coordinates, velocities, inputs and the time.""")
    inputs: Iterable[Any] = option("sequence", """
        Symbols or dynamicsymbols in the force or the constraints that change during a run, such
        as motor torques or a steering rate.  Their names become ``System.inputs``.""", default=())
    q0: Any = option("sequence")
    v0: Any = option("sequence", "Default initial data; numbers, or expressions in the parameters.")
    exact: Any = option("sequence or callable", """
        The exact solution: 2n expressions (q, v), or
        ``exact(t, q0, v0, **parameters) -> (q, v)``.  In the expressions the symbols of
        coordinates and velocities denote the initial data.""")
    invariants: Mapping[str, Any] | None = option("mapping", """
        Name to expression, or to ``invariant(q, v, **parameters) -> float``;
        ``invariant(t, q, v, **parameters)`` if the system depends on time.""")
    units: Mapping[str, str] | None = field(default=None, metadata=extended(Names, "units"))
    positions: Any = option("sequence", """
        Constraints on coordinates alone, as expressions that vanish.  Their time derivatives
        have to be among ``constraints``; steps satisfy the derivatives.  A run warns if a
        position constraint is violated by more than 1e-6 (see `off_positions`), initially or by
        drift.""", default=())
    progress: bool | Callable[[Any, Any], Any] | None = option("bool or callable", """
        Shows the seconds of compiling, here and at the first run, if they are more than one.  They
        come with those of another model of this size.  True: show a tqdm bar.  A function is
        called as ``progress(done, total)``.  Default: a bar in a terminal.  The logger
        ``dalembert.compiler`` gets a line, too.""")
