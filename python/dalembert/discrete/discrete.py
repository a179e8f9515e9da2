"""Discrete mechanics on pairs of nodes: difference maps, L_d and D_d, the node map.

A finite difference map rho(q0, q1) = (g, f) computes a position and a velocity from two nodes one
step h apart.  It defines the discrete Lagrangian L_d = h L o rho and the discrete constraint D_d =
{phi_d = phi o rho = 0}.  The discrete Lagrange-d'Alembert equations

    D_2 L_d(q_{k-1}, q_k) + D_1 L_d(q_k, q_{k+1}) + h mu(q_k)^T lambda_{k+1} = 0,
    phi_d(q_k, q_{k+1}) = 0

lead from one pair of nodes to the next.  Without constraints they are the discrete Euler-Lagrange
equations.  A pair (q_{k-1}, q_k) belongs to the state (q, v) = rho(q_{k-1}, q_k) and to its time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .. import core, geometry
from ..core import Array, Handle, Pair, Workspaces, arguments, ffi, lib, require_system
from ..core.documentation import Common
from ..core.functions import OfTimeTwo
from ..geometry.mechanics import halves, vectors


class _Documented(Common):
    """Parameters and exceptions of the methods.

    Parameters
    ----------
    h : float
        The step.
    q0, q1, q, v : array_like, shape (n,)
    t : float, optional
        Time of the pair of nodes, or of its state.

    Raises
    ------
    ValueError
        If an argument has another shape or is not finite, or h = 0.
    DomainError
        If a function of the system or of the map is not finite.
    SingularError
        If the matrix of `regularity` is singular.
    ConvergenceError
        If Newton's iteration does not converge.
    """


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class DifferenceMap:
    """A finite difference map rho(q0, q1) = (g, f) for a step h (FDM).

    Parameters
    ----------
    beta : float, optional
        Parameter in [0, 1] of g = (1 - beta) q0 + beta q1 and f = (q1 - q0)/h (robeta).  For your
        own map, beta is the position of g between the nodes, which only affects functions of time.
    map : callable, optional
        ``map(h, q0, q1) -> (g, f)``, each of shape (n,), with g(q, q) = q, f(q, q) = 0 and
        df/dq1 = 1/h on the diagonal.
    derivatives : callable, optional
        ``derivatives(h, q0, q1) -> (dg/dq0, dg/dq1, df/dq0, df/dq1)``, each of shape (n, n).
        Default: central differences, with an error of about 1e-12 in the derivatives of L_d.

    Raises
    ------
    ValueError
        If beta is not in [0, 1], or an argument is not callable.

    Examples
    --------
    >>> import numpy as np
    >>> import dalembert as dal
    >>> dal.DifferenceMap(0.5)
    <DifferenceMap beta = 0.5>
    >>> bent = dal.DifferenceMap(
    ...     map=lambda h, q0, q1: ((q0 + q1) / 2, 2 * np.sinh((q1 - q0) / 2) / h)
    ... )
    >>> q, v = dal.Discrete(dal.systems.particle(), bent).state(0.1, [0, 1, 0], [0.1, 1, 0])
    >>> v.round(6)
    array([1.000417, 0.      , 0.      ])
    """

    beta: float = 0.5
    map: OfTimeTwo | None = field(default=None, kw_only=True)
    derivatives: Callable[[float, Array, Array], tuple[ArrayLike, ...]] | None = field(
        default=None, kw_only=True
    )

    def __post_init__(self) -> None:
        arguments.function(self.map, "map")
        arguments.function(self.derivatives, "derivatives")
        if self.derivatives is not None and self.map is None:
            raise ValueError("derivatives are given without map(h, q0, q1) -> (g, f)")
        beta = arguments.number(self.beta, "beta")
        if not 0 <= beta <= 1:
            raise ValueError(f"beta = {beta}: expected a number in [0, 1]")
        object.__setattr__(self, "beta", beta)

    def __repr__(self) -> str:
        name = getattr(self.map, "__name__", self.map)
        own = "" if self.map is None else f", map = {name}"
        return f"<DifferenceMap beta = {self.beta:g}{own}>"

    def _definition(self, n: int) -> tuple[Any, Any]:
        """Return a ``dal_difference_map *`` for n coordinates, and the objects to keep alive."""
        definition = ffi.new("dal_difference_map *", {"beta": self.beta})
        if self.map is None:
            return definition, None
        callables = core.Callables(n, 0, map=self.map, derivatives=self.derivatives)
        definition.map, definition.differenced = lib.dal_py_map, self.derivatives is None
        definition.ctx = context = ffi.new_handle(callables)
        return definition, (callables, context)


class Regularity(NamedTuple):
    """The matrix of the equations for the next node, see `Discrete.regularity`.

    Attributes
    ----------
    matrix : ndarray, shape (n + m, n + m)
        [[D_1 D_2 L_d, mu^T], [D_2 phi_d, 0]].
    sign : int
        Sign of the determinant; 0 if it vanishes to working precision.
    logarithm : float
        log ``|determinant|``, -inf if it vanishes.
    condition : float
        Condition number of the matrix with its first n columns multiplied by h; inf if the
        determinant vanishes.
    """

    matrix: Array
    sign: int
    logarithm: float
    condition: float


class NodeRun(NamedTuple):
    """A run on nodes, see `Discrete.run`.

    Attributes
    ----------
    nodes : ndarray, shape (steps + 2, n)
    multipliers : ndarray, shape (steps, m)
        Forces; row k acts at node k + 1.
    """

    nodes: Array
    multipliers: Array


class Discrete(core.Constant):
    """A system with its discrete Lagrangian and its discrete constraint.

    Parameters
    ----------
    system : System
    lagrangian : DifferenceMap or float, optional
        The map rho of L_d = h L o rho; a number is beta; default 0.5.
    constraint : DifferenceMap or float, optional
        The map of phi_d = phi o rho, and of states.  Default: the same map.

    Raises
    ------
    ValueError
        If a map is neither a DifferenceMap nor a number in [0, 1].

    Notes
    -----
    The methods take nodes and velocities of shape (n,), the step h first and times t last.  They
    also raise any exception raised by a function of the system or of the map.  Threads may share a
    Discrete if these functions are thread-safe.

    Examples
    --------
    Ten steps of the particle with the midpoint map, on nodes and on states:

    >>> import numpy as np
    >>> import dalembert as dal
    >>> particle = dal.systems.particle()
    >>> discrete = dal.Discrete(particle, 0.5)
    >>> q, v = particle.q0, particle.v0
    >>> run = discrete.run(0.1, *discrete.nodes(0.1, q, v), steps=10)
    >>> for k in range(10):
    ...     q, v, reaction = discrete.advance(0.1, q, v)
    >>> np.allclose(discrete.state(0.1, *run.nodes[-2:]), (q, v))
    True
    """

    def __init__(
        self,
        system: Handle,
        lagrangian: DifferenceMap | float = 0.5,
        constraint: DifferenceMap | float | None = None,
    ) -> None:
        require_system(system)
        self.system = system
        first = _difference_map(lagrangian, "lagrangian")
        second = None if constraint is None else _difference_map(constraint, "constraint")
        self.maps = first, second or first
        definitions = [
            (ffi.NULL, None) if one is None else one._definition(system.n)
            for one in (first, second)
        ]
        handle, records = system._handle, [record for record, _ in definitions]
        self._discretes = Workspaces(
            lambda: core.make("discrete", handle, *records, owner=(handle, definitions)),
            system.kind,
        )
        with self._discretes.lend():
            pass

    def _call(self, function: Callable[..., int], *outputs: Any, **given: Any) -> Any:
        """Call a C function of t, h and nodes, given by name; return outputs of these shapes."""
        shape = (self.system.n,)
        checked = (
            arguments.number(x, name) if name in ("t", "h") else arguments.array(x, name, shape)
            for name, x in given.items()
        )
        return self._discretes.call(function, *checked, *outputs)

    def __repr__(self) -> str:
        lagrangian, constraint = self.maps
        other = "" if constraint is lagrangian else f", {constraint!r} for D_d"
        return f"<Discrete {self.system.name}: {lagrangian!r}{other}>"

    def __reduce__(self) -> tuple[Any, ...]:
        first, second = self.maps
        return Discrete, (self.system, first, None if second is first else second)

    # ---- nodes and states ------------------------------------------------------------------

    @_Documented("ValueError, DomainError", "q, v : ndarray, shape (n,)")
    def state(self, h: float, q0: ArrayLike, q1: ArrayLike) -> Pair:
        """Return the state (q, v) of a pair of nodes under the map of D_d (roloc).

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Discrete(dal.systems.particle(), 0.5).state(0.5, [0, 1, 0], [1, 1, 1])
        (array([0.5, 1. , 0.5]), array([2., 0., 2.]))
        """
        q, v = self._call(lib.dal_discrete_state, (2, self.system.n), h=h, q0=q0, q1=q1)
        return q, v

    @_Documented("ValueError, DomainError", "q0, q1 : ndarray, shape (n,)")
    def nodes(self, h: float, q: ArrayLike, v: ArrayLike, t: float = 0.0) -> Pair:
        """Return the pair of nodes of a state: the inverse of `state`.

        A state in D gives a pair of D_d.

        Raises
        ------
        SingularError, ConvergenceError
            If your own map has no inverse there.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Discrete(dal.systems.particle(), 0.0).nodes(0.5, [0, 1, 0], [1, 1, 1])
        (array([0., 1., 0.]), array([0.5, 1.5, 0.5]))
        """
        x, shape = np.concatenate(vectors(self.system, q=q, v=v)), (self.system.n,)
        return self._call(lib.dal_discrete_nodes, x, shape, shape, t=t, h=h)

    # ---- the discrete Lagrangian and constraint ----------------------------------------------

    @_Documented("ValueError, DomainError", "float")
    def lagrangian(self, h: float, q0: ArrayLike, q1: ArrayLike, t: float = 0.0) -> float:
        """Return L_d(q0, q1) = h L(rho(q0, q1)) (aprox, Ld1).

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Discrete(dal.systems.particle()).lagrangian(0.5, [0, 1, 0], [1, 1, 1])
        2.0
        """
        outputs = ((), ffi.NULL, ffi.NULL, ffi.NULL)
        return self._call(lib.dal_discrete_lagrangian, *outputs, t=t, h=h, q0=q0, q1=q1)

    @_Documented("ValueError, DomainError")
    def lagrangian_derivatives(
        self, h: float, q0: ArrayLike, q1: ArrayLike , t: float = 0.0
    ) -> tuple[Array, Array, Array]:
        """Return D_1 L_d, D_2 L_d and D_1 D_2 L_d.

        Returns
        -------
        D1, D2 : ndarray, shape (n,)
        D12 : ndarray, shape (n, n)
            Entry [i, j] is d2L_d/dq0_i dq1_j; accurate to about 1e-10 for your own map.

        Examples
        --------
        >>> import dalembert as dal
        >>> discrete = dal.Discrete(dal.systems.particle())
        >>> discrete.lagrangian_derivatives(0.5, [0, 1, 0], [1, 1, 1])[1]
        array([2., 0., 2.])
        """
        n = self.system.n
        outputs = (ffi.NULL, (n,), (n,), (n, n))
        return self._call(lib.dal_discrete_lagrangian, *outputs, t=t, h=h, q0=q0, q1=q1)

    @_Documented("ValueError, DomainError", "ndarray, shape (m,)")
    def constraint(self, h: float, q0: ArrayLike, q1: ArrayLike, t: float = 0.0) -> Array:
        """Return phi_d(q0, q1), which is zero for a pair of D_d (DiscNHSet).

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Discrete(dal.systems.particle()).constraint(0.5, [0, 1, 0], [1, 1, 2])
        array([2.])
        """
        outputs = ((self.system.m,), ffi.NULL, ffi.NULL)
        return self._call(lib.dal_discrete_constraint, *outputs, t=t, h=h, q0=q0, q1=q1)

    @_Documented("ValueError, DomainError", "D1, D2 : ndarray, shape (m, n)")
    def constraint_derivatives(
        self, h: float, q0: ArrayLike, q1: ArrayLike, t: float = 0.0
    ) -> Pair:
        """Return D_1 phi_d and D_2 phi_d.

        Examples
        --------
        >>> import dalembert as dal
        >>> discrete = dal.Discrete(dal.systems.particle())
        >>> discrete.constraint_derivatives(0.5, [0, 1, 0], [1, 1, 2])[1]
        array([[-2., -1.,  2.]])
        """
        outputs = (ffi.NULL, *[(self.system.m, self.system.n)] * 2)
        return self._call(lib.dal_discrete_constraint, *outputs, t=t, h=h, q0=q0, q1=q1)

    @_Documented("ValueError, DomainError")
    def momenta(
        self, h: float, q0: ArrayLike, q1: ArrayLike, t: float = 0.0
    ) -> Pair:
        """Return the discrete Legendre transforms p^- = -D_1 L_d and p^+ = D_2 L_d.

        Along an orbit p^-(q_k, q_{k+1}) - p^+(q_{k-1}, q_k) = h mu(q_k)^T lambda_{k+1}.

        Parameters
        ----------
        t : float, optional
            Time of the pair.  Generalized forces are part of the momenta.

        Returns
        -------
        minus, plus : ndarray, shape (n,)
            Momenta at q0 and at q1.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Discrete(dal.systems.particle()).momenta(0.5, [0, 1, 0], [1, 1, 1])
        (array([2., 0., 2.]), array([2., 0., 2.]))
        """
        shape = (self.system.n,)
        return self._call(lib.dal_discrete_momenta, shape, shape, t=t, h=h, q0=q0, q1=q1)

    @_Documented("ValueError, DomainError", "minus, plus : float")
    def momentum(
        self,
        h: float,
        q0: ArrayLike,
        q1: ArrayLike,
        xi0: ArrayLike,
        xi1: ArrayLike,
        t: float = 0.0,
    ) -> tuple[float, float]:
        """Return p^- . xi0 and p^+ . xi1, the discrete momentum of a symmetry.

        The two are equal if L_d is invariant.  They are then constant along an orbit if there are
        no forces, and no constraints or xi lies in D at every node.

        Parameters
        ----------
        xi0, xi1 : array_like, shape (n,)
            The generator of the symmetry at q0 and at q1.

        Examples
        --------
        >>> import dalembert as dal
        >>> particle = dal.systems.particle()  # does not notice a translation along y
        >>> y = [0, 1, 0]
        >>> dal.Discrete(particle).momentum(0.5, [0, 1, 0], [1, 2, 1], y, y)
        (2.0, 2.0)
        """
        nodes = {"q0": q0, "q1": q1, "xi0": xi0, "xi1": xi1}
        return self._call(lib.dal_discrete_momentum, (), (), t=t, h=h, **nodes)

    # ---- the discrete equations --------------------------------------------------------------

    @_Documented("ValueError, DomainError")
    def residual(
        self,
        h: float,
        q_before: ArrayLike,
        q: ArrayLike,
        q_after: ArrayLike,
        multipliers: ArrayLike,
        t: float = 0.0,
    ) -> Array:
        """Return the left sides of the discrete Lagrange-d'Alembert equations (DLA).

        Parameters
        ----------
        q_before, q, q_after : array_like, shape (n,)
            Three nodes.
        multipliers : array_like, shape (m,)
            lambda_{k+1}, a force.
        t : float, optional
            Time of the pair (q_before, q).

        Returns
        -------
        ndarray, shape (n + m,)
            The n equations of momenta, then phi_d(q, q_after).

        Examples
        --------
        >>> import dalembert as dal
        >>> discrete = dal.Discrete(dal.systems.particle())
        >>> discrete.residual(0.5, [0, 1, 0], [1, 1, 1], [2, 1, 2], [0.25])
        array([-0.125,  0.   ,  0.125,  0.   ])
        """
        forces = arguments.array(multipliers, "multipliers", (self.system.m,))
        shape = (self.system.n + self.system.m,)
        nodes = {"q_before": q_before, "q": q, "q_after": q_after}
        return self._call(lib.dal_discrete_residual, forces, shape, t=t, h=h, **nodes)

    @_Documented("ValueError, DomainError", "Regularity")
    def regularity(self, h: float, q: ArrayLike, q_after: ArrayLike, t: float = 0.0) -> Regularity:
        """Return the matrix that has to be invertible to determine q_after (REG, RegularityDLA).

        The node map is defined near (q, q_after) if the determinant, sign * exp(logarithm), is not
        0.

        Parameters
        ----------
        q, q_after : array_like, shape (n,)
        t : float, optional
            Time of the preceding pair.

        Examples
        --------
        A step of the particle that is not possible with any multiplier:

        >>> import dalembert as dal
        >>> discrete = dal.Discrete(dal.systems.particle(), 1.0)
        >>> discrete.regularity(0.5, [0, -1, 0], [1, 1, 0]).sign
        0
        """
        size, sign = self.system.n + self.system.m, ffi.new("int *")
        matrix, *logarithm_and_condition = self._call(
            lib.dal_discrete_regularity, (size, size), sign, (), (), t=t, h=h, q=q, q_after=q_after
        )
        return Regularity(matrix, int(sign[0]), *logarithm_and_condition)

    @_Documented("ValueError, DomainError, SingularError, ConvergenceError")
    def step(self, h: float, q0: ArrayLike, q1: ArrayLike, t: float = 0.0) -> Pair:
        """Return the node after the pair (q0, q1) and the multipliers (NHFlow).

        The pair need not lie in D_d; the new one does.

        Returns
        -------
        q2 : ndarray, shape (n,)
        multipliers : ndarray, shape (m,)
            Forces.

        Examples
        --------
        >>> import dalembert as dal
        >>> q2, multipliers = dal.Discrete(dal.systems.particle()).step(0.5, [0, 1, 0], [1, 1, 1])
        >>> q2
        array([2., 1., 2.])
        """
        before, after = np.array(vectors(self.system, q0=q0, q1=q1))
        multipliers = (self.system.m,)
        return after, self._call(lib.dal_discrete_step, before, after, multipliers, t=t, h=h)

    @_Documented("ValueError", "NodeRun")
    def run(
        self, h: float, q0: ArrayLike, q1: ArrayLike, *, steps: int, t0: float = 0.0
    ) -> NodeRun:
        """Take steps on nodes, from a pair of D_d.

        Parameters
        ----------
        q0, q1 : array_like, shape (n,)
            The first two nodes, see `nodes`.
        steps : int
            Number of steps, each of which computes a node.
        t0 : float, optional
            Time of the pair (q0, q1), and of its state.

        Raises
        ------
        NotOnConstraintError
            If (q0, q1) does not lie in D_d; take a `step` first.
        DomainError, SingularError, ConvergenceError
            As for `step`; ``.step`` is the number of good steps.

        Examples
        --------
        >>> import dalembert as dal
        >>> discrete = dal.Discrete(dal.systems.particle())
        >>> discrete.run(0.5, [0, 1, 0], [1, 1, 1], steps=3).nodes[-1]
        array([4., 1., 4.])
        """
        t0 = arguments.number(t0, "t0")
        h = arguments.step_size(h, t0)
        steps = arguments.integer(steps, "steps", 0)
        nodes = np.empty((steps + 2, self.system.n))
        nodes[:2] = vectors(self.system, q0=q0, q1=q1)
        multipliers = np.empty((steps, self.system.m))
        done = ffi.new("size_t *")
        most = geometry.most_in_a_call(self.system)
        with self._discretes.lend() as discrete:
            for start in range(0, max(steps, 1), most):
                status = core.attempt(
                    lib.dal_discrete_run, discrete, t0 + start * h, h, min(most, steps - start),
                    core.pointer(nodes, start), core.pointer(multipliers, start), done,
                )  # fmt: skip
                self._discretes.check(status, discrete, start + int(done[0]))
        return NodeRun(nodes, multipliers)

    @_Documented("ValueError, DomainError, SingularError, ConvergenceError")
    def advance(
        self, h: float, q: ArrayLike, v: ArrayLike, t: float = 0.0
    ) -> tuple[Array, Array, Array]:
        """Return the state after one step, rho F rho^-1 (VNI), and the multipliers.

        The new state lies in D to roundoff.  If both maps are rho^beta, this is the scheme beta
        of `integrate`.

        Parameters
        ----------
        q, v : array_like, shape (n,)
            A state in D.

        Returns
        -------
        q, v : ndarray, shape (n,)
        multipliers : ndarray, shape (m,)
            Forces.

        Examples
        --------
        >>> import dalembert as dal
        >>> q, v, _ = dal.Discrete(dal.systems.particle()).advance(0.5, [0, 1, 0], [2, 0, 2])
        >>> q
        array([1., 1., 1.])
        """
        x = np.concatenate(vectors(self.system, q=q, v=v))
        multipliers = self._call(lib.dal_discrete_advance, x, (self.system.m,), t=t, h=h)
        return *halves(x), multipliers


def _difference_map(value: Any, name: str) -> DifferenceMap:
    if isinstance(value, DifferenceMap):
        return value
    try:
        return DifferenceMap(value)
    except ValueError:
        raise ValueError(
            f"{name} = {arguments.shown(value)}: expected a DifferenceMap or beta in [0, 1]"
        ) from None


@_Documented("ValueError")
def exact_velocity(
    system: Handle,
    h: float,
    q0: ArrayLike,
    q1: ArrayLike,
    *,
    t0: float = 0.0,
    tolerance: float = 1e-13,
) -> Pair:
    """Return the velocity that leads from q0 to q1 in time h, and the defect across D.

    The exact discrete constraint D_d^E consists of the pairs (q0, q(h)) of solutions in D.  For any
    pair the result is the velocity in D at q0 whose solution misses q1 only in the direction M^-1
    mu^T.

    Parameters
    ----------
    h : float
        Time from q0 to q1, of either sign.
    t0 : float, optional
        Time at q0.
    tolerance : float, optional
        Tolerance of the reference flow.

    Returns
    -------
    v0 : ndarray, shape (n,)
    defect : ndarray, shape (m,)
        mu (q1 - q(h))/h, zero if and only if (q0, q1) lies in D_d^E.

    Raises
    ------
    ConvergenceError
        If h is too large.
    DomainError, SingularError
        As for `reference`.

    Examples
    --------
    >>> import dalembert as dal
    >>> particle = dal.systems.particle()
    >>> q1, _ = particle.exact(0.5, [0, 1, 0], [1, 1, 1])
    >>> v0, defect = dal.exact_velocity(particle, 0.5, [0, 1, 0], q1)
    >>> v0.round(10)
    array([1., 1., 1.])
    """
    require_system(system)
    h, t0 = arguments.number(h, "h"), arguments.number(t0, "t0")
    tolerance = arguments.tolerance(tolerance)
    q0, q1 = vectors(system, q0=q0, q1=q1)
    flow = system._c("flow", lib.DAL_FLOW_RK8PD, lib.DAL_FLOW_X, tolerance)
    v0, defect = np.empty(system.n), np.empty(system.m)
    with core.watching(flow):
        core.call(system.kind, lib.dal_exact_velocity, flow, t0, h, q0, q1, v0, defect)
    return v0, defect
