"""Charts of D: coordinates with m dependent velocities, and curves between two states.

Every method takes ``q`` and ``v`` of shape (n,) or (N, n), or ``xi`` of shape (2n-m,) or (N, 2n-m),
in the user's units.  N is the first axis of the result.  ``t`` is the time of all states, or an
array with the time of each; only systems that depend on time use it.  The methods also raise any
exception raised by a function of the system.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import core
from ..core import Array, Handle, Pair, Workspaces, arguments, ffi, lib, require_system
from . import mechanics

__all__ = ["Chart", "cutoff"]

_log = logging.getLogger(__name__)


class _Documented(mechanics.Documented):
    """Parameters and exceptions of the methods.

    Parameters
    ----------
    xi : array_like, shape (2n-m,) or (N, 2n-m)

    Raises
    ------
    SingularError
        If the independent velocities do not determine the others; ``.step`` is the row that failed.
    ConvergenceError
        If Newton's iteration for nonlinear constraints does not converge.
    """


class Chart(core.Constant):
    """Coordinates xi = (q, v of the independent coordinates) of D.

    B denotes the columns of mu(q) for the dependent coordinates, and A is B^-1 times the others.
    On D, v_dependent = -A v_independent (the Ehresmann connection).  Affine constraints add a term.
    For nonlinear constraints mu is dphi/dv, and Newton's iteration computes v_dependent; it
    starts at the state for which the chart was created.  For m = n no velocity is independent: xi
    is q, and its field is the prescribed velocity.

    D may depend on time; the dependent coordinates are the same at all times.

    A chart is immutable; several threads may use it.

    Parameters
    ----------
    system : System
    q, v : array_like, shape (n,), optional
        The state for the choice of coordinates, in the user's units.  Default: the system's initial
        data.  If q is given, the default of v is zero, which is sufficient unless the constraints
        are nonlinear.
    dependent : str or iterable of str, optional
        Names of the m dependent coordinates.  Default: chosen by pivoting, independently of the
        units of the coordinates.
    t : float, optional
        The time for the choice of coordinates.

    Attributes
    ----------
    system : System
    dependent, independent : tuple of str
        Names in the order of the system's coordinates, as the rows and columns of A and B.
    left_inverse : ndarray, shape (2n-m, 2n)
        The derivative of `drop`; its product with `jacobian` is the identity (Inverse).

    Raises
    ------
    ValueError, DomainError
        For invalid arguments, or a state outside the domain of a function.
    SingularError
        If the independent velocities do not determine the others.

    Examples
    --------
    >>> import dalembert as dal
    >>> chart = dal.Chart(dal.systems.particle(), q=[0, 1, 0], dependent="z")
    >>> q, v = chart.lift([0, 1, 0, 3, 5])          # x y z, and the velocities of x and y
    >>> v
    array([3., 5., 3.])
    """

    def __init__(
        self,
        system: Handle,
        q: ArrayLike | None = None,
        v: ArrayLike | None = None,
        dependent: str | Iterable[str] | None = None,
        t: float = 0.0,
    ) -> None:
        require_system(system)
        if q is not None and v is None:
            v = np.zeros(system.n)
        self.system = system
        self._x = mechanics.initial_state(system, q, v, "q", "v")
        self._t = arguments.number(t, "t")
        self._width = 2 * system.n - system.m
        self._charts = Workspaces(self._new, system.kind)
        self._place = ffi.NULL
        if dependent is not None:
            self._place = ffi.new("size_t[]", indices(system, dependent))
        with self._charts.lend() as chart:
            found = lib.dal_chart_dependent(chart)
            self._place = ffi.new("size_t[]", [found[a] for a in range(system.m)])
        chosen = set(self._place)
        names = system.coordinates
        self.dependent = tuple(c for i, c in enumerate(names) if i in chosen)
        self.independent = tuple(c for i, c in enumerate(names) if i not in chosen)

    def _new(self) -> Any:
        """Return a ``dal_chart`` with the choice of this chart."""
        chart = self.system._c("chart")
        self._choose(chart)
        return chart

    def _choose(self, chart: Any) -> None:
        """Give a ``dal_chart`` the choice of this chart."""
        core.call(self.system.kind, lib.dal_chart_choose, chart, self._t, self._place, self._x)

    def _coordinates(self, xi: ArrayLike) -> tuple[Array, bool]:
        """Return a copy of the rows xi, shape (N, 2n-m), and whether xi was a single one."""
        given = arguments.array(xi, "xi", (self._width,), (None, self._width))
        return np.atleast_2d(given).copy(), given.ndim == 1

    def _of_states(
        self,
        function: Callable[..., int],
        q: ArrayLike,
        v: ArrayLike | None,
        t: ArrayLike,
        *outputs: Any,
        multipliers: ArrayLike | None = None,
    ) -> Any:
        """Return the outputs of a function for each state, see `Workspaces.rows`."""
        x, single = mechanics.states(self.system, q, mechanics.or_zero(v, q))
        given = [mechanics.times(t, x, single), x]
        if multipliers is not None:
            m = self.system.m
            given.append(mechanics.beside(x, single, multipliers, "multipliers", m))
        return self._charts.rows(function, single, *given, *outputs)

    def _of_coordinates(
        self,
        function: Callable[..., int],
        xi: ArrayLike,
        t: ArrayLike,
        *outputs: Any,
        inputs: Any = None,
    ) -> Any:
        """Return the outputs of a function for each row of coordinates."""
        rows, single = self._coordinates(xi)
        acting = mechanics.input_rows(self.system, inputs, len(rows))
        at = mechanics.times(t, rows, single)
        return self._charts.rows(function, single, at, rows, *outputs, inputs=acting)

    # ---- the connection ------------------------------------------------------------------

    @_Documented("ValueError, DomainError, SingularError", "ndarray, shape (m, n-m) or (N, m, n-m)")
    def A(self, q: ArrayLike, v: ArrayLike | None = None, t: ArrayLike = 0.0) -> Array:
        """Return A = B^-1 mu[:, independent], so that v_dependent = -A v_independent on D.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Chart(dal.systems.particle(), dependent="z").A([0, 3, 0])
        array([[-3.,  0.]])
        """
        n, m = self.system.n, self.system.m
        return self._of_states(lib.dal_chart_connection, q, v, t, (m, n - m), ffi.NULL)

    @_Documented("ValueError, DomainError, SingularError", "ndarray, shape (m, m) or (N, m, m)")
    def B(self, q: ArrayLike, v: ArrayLike | None = None, t: ArrayLike = 0.0) -> Array:
        """Return B = mu[:, dependent].

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Chart(dal.systems.particle(), [0, 3, 0], dependent="x").B([0, 3, 0])
        array([[-3.]])
        """
        m = self.system.m
        return self._of_states(lib.dal_chart_connection, q, v, t, ffi.NULL, (m, m))

    @_Documented("ValueError, DomainError", "float or ndarray, shape (N,)")
    def condition(self, q: ArrayLike, v: ArrayLike | None = None, t: ArrayLike = 0.0) -> Any:
        """Return the largest ratio of v to v_independent, in the units 1/sqrt(M_ii).

        The value is at least 1, and does not depend on the forms that describe D.  It is infinite
        if the dependent velocities are not determined.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Chart(dal.systems.particle(), dependent="z").condition([0, 0.75, 0])
        1.25
        """
        return self._of_states(lib.dal_chart_condition, q, v, t, ())

    @_Documented("ValueError, DomainError, SingularError")
    def renewed(self, q: ArrayLike, v: ArrayLike | None = None, t: float = 0.0) -> Chart:
        """Return a chart that is well conditioned at (q, v): this one, if it is.

        A change of the dependent coordinates is logged (``logging``, level INFO).

        Parameters
        ----------
        q : array_like, shape (n,)
        v : array_like, shape (n,), optional
            Matters only if the constraints are nonlinear or L is not quadratic in v; default 0.
        t : float, optional
            Time of the state.

        Returns
        -------
        Chart
            This object if its condition is at most 10 sqrt(1 + m (n-m)), else a new chart.  For
            nonlinear constraints always a new chart, whose Newton iteration starts at v.

        Examples
        --------
        >>> import dalembert as dal
        >>> chart = dal.Chart(dal.systems.particle(), dependent="z")
        >>> chart.renewed([0, 2, 0]) is chart
        True
        >>> chart.renewed([0, 100, 0]).dependent
        ('x',)
        """
        system = self.system
        q, v = mechanics.vectors(system, q=q, v=np.zeros(system.n) if v is None else v)
        changed, chart = ffi.new("int *"), self._new()
        x, t = np.concatenate([q, v]), arguments.number(t, "t")
        core.call(system.kind, lib.dal_chart_renew, chart, t, x, changed)
        if changed[0]:
            _log.info("%s", core.string(lib.dal_chart_error(chart).text))
        elif system.kind != "nonlinear":
            return self
        found = lib.dal_chart_dependent(chart)
        return Chart(system, q, v, [system.coordinates[found[a]] for a in range(system.m)], t)

    @_Documented("ValueError, DomainError, SingularError, ConvergenceError")
    def split(self, q: ArrayLike, v: ArrayLike, t: ArrayLike = 0.0) -> Pair:
        """Return v = hor + ver: hor is in D, and ver is zero in the independent components.

        Returns
        -------
        hor, ver : ndarray, shape (n,) or (N, n)

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Chart(dal.systems.particle(), dependent="z").split([0, 1, 0], [2, 1, 5])
        (array([2., 1., 2.]), array([0., 0., 3.]))
        """
        n = self.system.n
        return self._of_states(lib.dal_chart_split, q, v, t, (n,), (n,))

    # ---- psi -----------------------------------------------------------------------------

    @_Documented("ValueError, DomainError, SingularError, ConvergenceError")
    def lift(self, xi: ArrayLike, t: ArrayLike = 0.0, inputs: Any = None) -> Pair:
        """Return the state psi(xi), which lies in D to roundoff (Embedd).

        Returns
        -------
        q, v : ndarray, shape (n,) or (N, n)

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Chart(dal.systems.particle(), dependent="z").lift([0, 2, 0, 1, 1])
        (array([0., 2., 0.]), array([1., 1., 2.]))
        """
        x = self._of_coordinates(lib.dal_chart_lift, xi, t, (2 * self.system.n,), inputs=inputs)
        return mechanics.halves(x)

    @_Documented("ValueError", "ndarray, shape (2n-m,) or (N, 2n-m)")
    def drop(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return xi = (q, v_independent).

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Chart(dal.systems.particle(), dependent="z").drop([0, 2, 0], [1, 1, 2])
        array([0., 2., 0., 1., 1.])
        """
        x, single = mechanics.states(self.system, q, mechanics.or_zero(v, q))
        return self._charts.rows(lib.dal_chart_drop, single, x, (self._width,))

    @_Documented("ValueError, DomainError, SingularError, ConvergenceError")
    def jacobian(self, xi: ArrayLike, t: ArrayLike = 0.0, inputs: Any = None) -> Array:
        """Return d(q, v)/dxi of `lift` (EhresJota).

        Returns
        -------
        ndarray, shape (2n, 2n-m) or (N, 2n, 2n-m)

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Chart(dal.systems.particle(), dependent="z").jacobian([0, 2, 0, 3, 1])[5]
        array([0., 3., 0., 2., 0.])
        """
        shape = (2 * self.system.n, self._width)
        return self._of_coordinates(lib.dal_chart_jacobian, xi, t, shape, ffi.NULL, inputs=inputs)

    @property
    def left_inverse(self) -> Array:
        """The derivative of `drop`, shape (2n-m, 2n)."""
        n = self.system.n
        independent = [i for i in range(n) if i not in set(self._place)]
        return np.eye(2 * n)[[*range(n), *(n + i for i in independent)]]

    # ---- dynamics ------------------------------------------------------------------------

    @_Documented("ValueError, DomainError, SingularError, ConvergenceError")
    def field(self, xi: ArrayLike, t: ArrayLike = 0.0, inputs: Any = None) -> Array:
        """Return dxi/dt of the ODE on D (ODExi, ODExiConnec), equivalent to `System.field`.

        Differences of the field linearize a controlled motion.

        Returns
        -------
        ndarray, shape (2n-m,) or (N, 2n-m)

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Chart(dal.systems.particle(), dependent="z").field([0, 1, 0, 1, 1])
        array([ 1. ,  1. ,  1. , -0.5,  0. ])

        With a motor that turns a skate:

        >>> import sympy as sp
        >>> x, y, theta = dal.coordinates("x y theta")
        >>> torque = sp.Symbol("torque")
        >>> skate = dal.System.from_sympy(
        ...     (x.d**2 + y.d**2 + theta.d**2) / 2, [sp.sin(theta) * x.d - sp.cos(theta) * y.d],
        ...     force={theta: torque}, inputs=[torque],
        ... )
        >>> dal.Chart(skate, [0, 0, 0]).field([0, 0, 0, 1, 0], inputs={"torque": 2})
        array([1., 0., 0., 0., 2.])
        """
        shape = (self._width,)
        return self._of_coordinates(lib.dal_chart_field, xi, t, shape, inputs=inputs)

    @_Documented("ValueError, DomainError, SingularError")
    def multipliers(
        self,
        q: ArrayLike,
        v: ArrayLike,
        multipliers: ArrayLike | None = None,
        t: ArrayLike = 0.0,
        inputs: Any = None,
    ) -> Array:
        """Return lambda_E = B^T lambda, the multipliers of the forms [A, I].

        Parameters
        ----------
        multipliers : array_like, shape (m,) or (N, m), optional
            lambda.  Default: `System.multipliers` with these t and inputs.

        Returns
        -------
        ndarray, shape (m,) or (N, m)
            lambda_E, forces.

        Examples
        --------
        >>> import dalembert as dal
        >>> chart = dal.Chart(dal.systems.particle(), [0, 2, 0], dependent="x")
        >>> chart.multipliers([0, 2, 0], [1, 1, 2], multipliers=[3])
        array([-6.])
        """
        if multipliers is None:
            multipliers = self.system.multipliers(q, v, t, inputs)
        made = lib.dal_chart_multipliers
        return self._of_states(made, q, v, t, (self.system.m,), multipliers=multipliers)

    @_Documented("ValueError, DomainError, SingularError", "ndarray, shape (m,) or (N, m)")
    def multipliers_back(
        self, q: ArrayLike, v: ArrayLike, multipliers: ArrayLike, t: ArrayLike = 0.0
    ) -> Array:
        """Return lambda = B^-T lambda_E, the multipliers of mu.

        This is the inverse of `multipliers`.

        Parameters
        ----------
        multipliers : array_like, shape (m,) or (N, m)
            lambda_E.

        Examples
        --------
        >>> import dalembert as dal
        >>> chart = dal.Chart(dal.systems.particle(), [0, 2, 0], dependent="x")
        >>> chart.multipliers_back([0, 2, 0], [1, 1, 2], [-6])
        array([3.])
        """
        made = lib.dal_chart_multipliers_back
        return self._of_states(made, q, v, t, (self.system.m,), multipliers=multipliers)

    @_Documented("ValueError, DomainError, SingularError, ConvergenceError")
    def step(
        self,
        xi: ArrayLike,
        h: float,
        beta: float = 0.5,
        t: ArrayLike = 0.0,
        inputs: Any = None,
    ) -> Pair:
        """Return xi after one step of the beta-scheme with moved nodes, and its multiplier.

        The multiplier is eliminated from the equations, as in the decompositions after (firstorder)
        and (secondorder).  The state agrees with `integrate` to roundoff.

        Parameters
        ----------
        h : float
        beta : float, optional
            Parameter of the scheme, in [0, 1]; 0.5 (default) is midpoint.
        t : float or array_like, shape (N,), optional
            Time at the beginning of the step.
        inputs : array_like, shape (k,) or (N, k), or mapping, optional
            Inputs, constant over the step, in order or by name; default 0.

        Returns
        -------
        xi : ndarray, shape (2n-m,) or (N, 2n-m)
        multipliers : ndarray, shape (m,) or (N, m)
            lambda_E at the node q + (1 - beta) h v: forces.

        Examples
        --------
        >>> import dalembert as dal
        >>> chart = dal.Chart(dal.systems.particle(), dependent="z")
        >>> xi, reaction = chart.step([0, 1, 0, 1, 1], h=0.1)
        >>> bool(abs(reaction[0] - 1 / (1 + 1.05 * 1.1)) < 1e-14)
        True
        """
        xi, single = self._coordinates(xi)
        h, beta = arguments.number(h, "h"), arguments.number(beta, "beta")
        acting = mechanics.input_rows(self.system, inputs, len(xi))
        given = mechanics.times(t, xi, single), beta, h, xi, (self.system.m,)
        made = self._charts.rows(lib.dal_chart_step, single, *given, inputs=acting)
        return core.first(xi, single), made

    def curve(
        self,
        q1: ArrayLike,
        v1: ArrayLike,
        q2: ArrayLike,
        v2: ArrayLike,
        tau: ArrayLike,
        t: float = 0.0,
    ) -> Pair:
        """Return psi(chi_0(tau) xi1 + chi_1(tau) xi2), a curve in D (yD, InterpolationD).

        The curve leads from (q1, v1) for tau <= 0 to (q2, v2) for tau >= 1; all its derivatives are
        zero at both ends.

        Parameters
        ----------
        q1, v1, q2, v2 : array_like, shape (n,)
            Two states of D.
        tau : array_like, shape () or (N,)
        t : float, optional
            The time at which D is evaluated.

        Returns
        -------
        q, v : ndarray, shape (n,) or (N, n)

        Raises
        ------
        ValueError, DomainError, SingularError, ConvergenceError
            For invalid arguments, a state outside the domain, undetermined dependent velocities,
            or a Newton iteration that does not converge.

        Examples
        --------
        >>> import dalembert as dal
        >>> chart = dal.Chart(dal.systems.particle(), dependent="z")
        >>> chart.curve([0, 1, 0], [2, 1, 2], [4, 3, 2], [0, 3, 0], 0.5)
        (array([2., 2., 1.]), array([1., 2., 2.]))
        """
        n = self.system.n
        ends = np.concatenate(mechanics.vectors(self.system, q1=q1, v1=v1, q2=q2, v2=v2))
        places, t = arguments.array(tau, "tau", (), (None,)), arguments.number(t, "t")
        x = np.empty((*places.shape, 2 * n))
        first, second = core.pointer(ends), core.pointer(ends) + 2 * n
        with self._charts.lend() as chart:
            for k, (each, row) in enumerate(zip(places.flat, x.reshape(-1, 2 * n))):
                core.call(
                    self.system.kind, lib.dal_chart_curve, chart, t, first, second, float(each),
                    row, step=k,
                )  # fmt: skip
        return mechanics.halves(x)

    def closed(self) -> Any:
        """Return the equations of this chart in closed form, as `System.reduced`.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Chart(dal.systems.particle(), dependent="z").closed().E
        Matrix([
        [1, 0],
        [0, 1],
        [y, 0]])
        """
        return self.system.reduced(self.dependent)

    def __reduce__(self) -> tuple[Any, ...]:
        n = self.system.n
        return Chart, (self.system, self._x[:n], self._x[n:], self.dependent, self._t)

    def __repr__(self) -> str:
        return (
            f"<Chart of {self.system.name}: ({', '.join(self.dependent)}) depend on "
            f"({', '.join(self.independent)})>"
        )


def cutoff(tau: ArrayLike) -> tuple[Any, Any, Any]:
    """Return the cut-off functions chi_0 and chi_1 = 1 - chi_0, and d chi_0 / d tau (CutOff).

    chi_0 = (1 + tanh cot(pi tau)) / 2 on 0 < tau < 1, 1 before and 0 after.

    Parameters
    ----------
    tau : array_like
        Real numbers.

    Returns
    -------
    chi_0, chi_1, slope : float or ndarray, shape of tau
        Accurate to roundoff relative to each value, however small.

    Examples
    --------
    >>> from dalembert.geometry import cutoff
    >>> cutoff([0.0, 0.5, 1.0])[0]
    array([1. , 0.5, 0. ])
    """
    given = np.asarray(tau, dtype=float, order="C")
    values = np.empty((3, given.size))
    for k, each in enumerate(given.flat):
        lib.dal_cutoff(float(each), *(core.pointer(values, row) + k for row in range(3)))
    first, second, slope = values.reshape(3, *given.shape)
    return (first, second, slope) if given.ndim else (float(first), float(second), float(slope))


def indices(system: Handle, dependent: str | Iterable[str]) -> list[int]:
    """Return the indices of m names of coordinates."""
    names = [dependent] if isinstance(dependent, str) else dependent
    names = arguments.names(names, "dependent", f"m = {system.m} names of coordinates")
    places = [mechanics.place(system, name, "dependent") for name in names]
    if len(names) != system.m:
        raise ValueError(
            f"dependent = {names!r}: expected m = {system.m} names of coordinates, one for each "
            "constraint"
        )
    return places
