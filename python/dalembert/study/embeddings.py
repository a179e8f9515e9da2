"""A scheme as the period map of a periodically perturbed flow (propoDisc).

One step of a scheme of order p from xi in D is the time-h map of

    xidot = f(xi) + h^p g(t/h, xi)                              (pertODE, perturbedNhODExi)

with xi the coordinates of a `dalembert.Chart` and f the field of the ODE on D in them.  The
function g is 1-periodic in its first argument tau = t/h, and bounded as h -> 0.  With p + 1 in
place of p, g grows as 1/h; with p - 1, it tends to 0. So g measures p.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import core, geometry
from ..core import Array, Workspaces, arguments, extras, ffi, lib, require_autonomous
from ..core.documentation import Common
from ..core.extras import Progress
from ..geometry import Chart
from ..run.events import CONSISTENCY
from ..run.runs import consistent_state
from ..run.scheme import Scheme
from ..system import System
from .study import Fit

# Where |g| is looked at, in a period: among them 1/2, where chi_0' is largest.
TAUS = np.arange(1, 64) / 64

# The steps of a measured order, as fractions of the largest.
FRACTIONS = (1, 2 / 3, 1 / 2, 1 / 3, 1 / 4)

CLEAR = 100  # as many times g stands above its noise, if it is meaningful


class _Documented(Common):
    """Parameters and exceptions of the methods.

    Parameters
    ----------
    tau : array_like, shape () or (N,)
        Time in units of h.
    z : array_like, shape (2n-m,), optional

    Raises
    ------
    ValueError
        If an argument has another shape or is not finite.
    ConvergenceError
        If h is too large.
    Exception
        Any exception of a step, of the flow or of a function of the system.
    """


class Embedding(core.Constant):
    """A scheme with the step h as the time-h map of xidot = f(xi) + h^p g(t/h, xi).

    Created by `embedding`.  The methods take and return coordinates xi of ``chart``, shape (2n-m,):
    q and the velocities of the independent coordinates.  The default of ``z`` is ``start``.  Phi is
    the scheme, F the flow of the ODE on D, and tau = t/h the time in units of the period.  A scheme
    with kept nodes is replaced by its conjugate with moved nodes, at the states (q - (1-beta) h v,
    v).

    Attributes
    ----------
    chart : Chart
        The coordinates xi.
    system : System
    scheme : Scheme
    h : float
        The period, in the user's units of time.
    order : int
        p.
    start : ndarray, shape (2n-m,), read-only
        The initial data in these coordinates.
    tolerance : float
        Tolerance of the reference flow.
    numerical : bool
        True if F is the reference flow, False if it is the exact solution of the system.

    Examples
    --------
    >>> import dalembert as dal
    >>> midpoint = dal.embedding(dal.systems.particle(), "midpoint", h=0.1)
    >>> midpoint
    <Embedding of midpoint on particle: h = 0.1, p = 2, exact flow, noise of g 4e-13>
    >>> midpoint.coordinates
    ('x', 'y', 'z', 'v_x', 'v_y')
    >>> midpoint.g([0, 0.5]).shape
    (2, 5)
    >>> midpoint.measured_order().order()
    '2.00'
    """

    def __init__(
        self,
        chart: Chart,
        scheme: Scheme,
        h: float,
        order: int | None,
        start: Array,
        tolerance: float,
        numerical: bool,
    ) -> None:
        self.chart = chart
        self.scheme = scheme
        self.h = h
        self.start = start.copy()
        self.start.flags.writeable = False
        self.tolerance = tolerance
        self.numerical = numerical or not chart.system.has_exact
        record, self._kept = scheme._record_of(chart.system)
        given = {"scheme": record, "h": h, "order": order or 0, "tolerance": tolerance}
        self._definition = ffi.new("dal_embedding_def *", given | {"numerical": int(numerical)})
        self._embeddings = Workspaces(self._new, chart.system.kind)
        with self._embeddings.lend() as embedding:
            self.order = int(lib.dal_embedding_order(embedding))
            self._noise = float(lib.dal_embedding_noise(embedding))

    def _new(self) -> Any:
        """Return a ``dal_embedding`` with the choice of the chart."""
        owner = (self.system, self.scheme)
        embedding = core.make("embedding", self.system._handle, self._definition, owner=owner)
        self.chart._choose(lib.dal_embedding_chart(embedding))
        return embedding

    def _call(
        self,
        function: Callable[..., int],
        *given: Any,
        row: int | None = None,
        show: Callable[[float], Any] = core.ignore,
    ) -> None:
        """Call ``function(embedding, *given)``; ``show`` receives the number of steps taken."""
        with self._embeddings.lend() as embedding, core.watching(embedding, show):
            core.call(self.system.kind, function, embedding, *given, step=row)

    def _point(self, z: ArrayLike | None, name: str, *shapes: tuple[int | None, ...]) -> Array:
        return self.start if z is None else arguments.array(z, name, self.start.shape, *shapes)

    def _along(
        self,
        function: Callable[..., int],
        tau: ArrayLike,
        z: ArrayLike | None,
        name: str = "z",
        progress: Progress = False,
    ) -> Array:
        """Return the values of a function of (tau, z), one row for each pair."""
        taus = arguments.array(tau, "tau", (), (None,))
        points = self._point(z, name, (None, self.start.size))
        if taus.ndim == 1 and points.ndim == 2 and len(taus) != len(points):
            raise ValueError(f"{name}: expected {len(taus)} rows as tau has, got {len(points)}")
        rows = (*taus.shape, *points.shape[:-1])[:1]
        times = np.broadcast_to(taus, rows or 1)
        places = np.ascontiguousarray(np.broadcast_to(points, (len(times), self.start.size)))
        values = np.empty_like(places)
        before = [0, *np.cumsum(np.maximum(np.ceil(times) - 1, 0)).tolist()]  # steps of curves
        with extras.progress(progress, int(before[-1]), "step") as show:
            for k, time in enumerate(times):
                self._call(
                    function, float(time), places[k], values[k], row=k,
                    show=lambda made, k=k: show(int(before[k] + made)),
                )  # fmt: skip
            show(int(before[-1]))
        return values if rows else values[0]

    # ---- what it is ------------------------------------------------------------------------

    @property
    def system(self) -> System:
        """The system."""
        return self.chart.system

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates xi: q, then the independent velocities, ``v_...``."""
        return (*self.system.coordinates, *(f"v_{name}" for name in self.chart.independent))

    @property
    def accuracy(self) -> float:
        """Accuracy of F: the tolerance of the reference flow, or roundoff if F is exact."""
        return self._noise * abs(self.h) ** (self.order + 1)

    @property
    def noise(self) -> float:
        """Approximate noise in g: the accuracy of F times h^-(p+1)."""
        return self._noise

    @_Documented("ValueError")
    def with_step(self, h: float) -> Embedding:
        """Return the embedding with another step, of the same order.

        Parameters
        ----------
        h : float
            The new step, not 0.

        Examples
        --------
        >>> import dalembert as dal
        >>> midpoint = dal.embedding(dal.systems.particle(), "midpoint", h=0.1)
        >>> midpoint.with_step(0.05).h
        0.05
        """
        make, (chart, scheme, _, *rest) = self.__reduce__()
        return make(chart, scheme, arguments.number(h, "h"), *rest)

    def __repr__(self) -> str:
        flow = "reference flow" if self.numerical else "exact flow"
        return (
            f"<Embedding of {self.scheme.name} on {self.system.name}: h = {self.h:g}, "
            f"p = {self.order}, {flow}, noise of g {self.noise:.0e}>"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return Embedding, (
            self.chart, self.scheme, self.h, self.order, self.start, self.tolerance,
            self.numerical,
        )  # fmt: skip

    # ---- the field -------------------------------------------------------------------------

    @_Documented("ValueError, ConvergenceError, Exception")
    def g(self, tau: ArrayLike, z: ArrayLike | None = None) -> Array:
        """Return g(tau, z), 1-periodic in tau (gdefinition).

        Parameters
        ----------
        z : array_like, shape (2n-m,) or (N, 2n-m), optional

        Returns
        -------
        ndarray, shape (2n-m,) or (N, 2n-m)
            Exactly 0 if tau is an integer.

        Examples
        --------
        >>> import dalembert as dal
        >>> explicit = dal.embedding(dal.systems.particle(), "explicit", h=0.1)
        >>> explicit.g(0.5, [0.5, 0.3, -0.2, 1, 0.7]).round(3)
        array([ 0.163,  0.   , -0.504, -0.324,  0.   ])
        """
        return self._along(lib.dal_embedding_field, tau, z)

    @_Documented("ValueError, ConvergenceError, Exception", "ndarray, shape (2n,) or (N, 2n)")
    def g_tilde(self, tau: ArrayLike, z: ArrayLike | None = None) -> Array:
        """Return g~ = (dpsi/dxi) g in the state (q, v), a vector tangent to D (tildeg).

        `System.perturbed` with g~ is the field of the perturbed ODE.  Its multipliers are those of
        the unperturbed system.

        Parameters
        ----------
        z : array_like, shape (2n-m,) or (N, 2n-m), optional

        Examples
        --------
        >>> import dalembert as dal
        >>> explicit = dal.embedding(dal.systems.particle(), "explicit", h=0.1)
        >>> explicit.g_tilde(0.5, [0.5, 0.3, -0.2, 1, 0.7]).round(3)
        array([ 0.163,  0.   , -0.504, -0.324,  0.   , -0.097])
        """
        points = self._point(z, "z", (None, self.start.size))
        return np.einsum("...ij,...j->...i", self.chart.jacobian(points), self.g(tau, points))

    @_Documented("ValueError, Exception", "ndarray, shape (2n-m,)")
    def limit(self, z: ArrayLike | None = None) -> Array:
        """Return d(z) = (Phi(z) - F(h, z)) / h^(p+1).

        As h -> 0, d tends to the error constant of the scheme, and g(tau, z) to -chi_0'(tau) d(z).
        The slope chi_0' is that of `dalembert.geometry.cutoff`.

        Examples
        --------
        >>> import dalembert as dal
        >>> explicit = dal.embedding(dal.systems.particle(), "explicit", h=0.01)
        >>> explicit.limit([0.5, 0.3, -0.2, 1, 0.7]).round(2)
        array([ 0.1 ,  0.  , -0.32, -0.21,  0.  ])
        """
        point = self._point(z, "z")
        values = np.empty_like(point)
        self._call(lib.dal_embedding_limit, point, values, row=0)
        return values

    # ---- curves ----------------------------------------------------------------------------

    @_Documented("ValueError, Exception", "ndarray, shape (2n-m,) or (N, 2n-m)")
    def curve(
        self,
        tau: ArrayLike,
        y: ArrayLike | None = None,
        *,
        progress: Progress = False,
    ) -> Array:
        """Return the solution G~(tau, y), tau >= 0, that starts in y (Gdef, Gtilde, period0).

        For tau <= 1 it is ``chi_0 F(h tau, y) + chi_1 F(h tau - h, Phi(y))``.  From Phi(y) on it
        continues in the same way.

        Parameters
        ----------
        y : array_like, shape (2n-m,) or (N, 2n-m), optional

        Examples
        --------
        >>> import dalembert as dal
        >>> explicit = dal.embedding(dal.systems.particle(), "explicit", h=0.5)
        >>> explicit.curve([0, 1], [0, 0, 0, 1, 1])
        array([[0. , 0. , 0. , 1. , 1. ],
               [0.5, 0.5, 0. , 0.8, 1. ]])
        """
        return self._along(lib.dal_embedding_curve, tau, y, "y", progress)

    @_Documented("ValueError, ConvergenceError, Exception", "ndarray, shape (2n-m,) or (N, 2n-m)")
    def source(self, tau: ArrayLike, z: ArrayLike | None = None) -> Array:
        """Return the start y of the curve through z at tau - floor(tau) (ztilde).

        Parameters
        ----------
        z : array_like, shape (2n-m,) or (N, 2n-m), optional

        Examples
        --------
        >>> import dalembert as dal
        >>> explicit = dal.embedding(dal.systems.particle(), "explicit", h=0.1)
        >>> z = [0.5, 0.3, -0.2, 1, 0.7]
        >>> explicit.curve(0.4, explicit.source(0.4, z)).round(12)
        array([ 0.5,  0.3, -0.2,  1. ,  0.7])
        """
        return self._along(lib.dal_embedding_source, tau, z)

    @_Documented("ValueError, ConvergenceError, Exception", "ndarray, shape (2n-m,)")
    def flow(
        self,
        t0: float,
        t1: float,
        z: ArrayLike | None = None,
        *,
        progress: Progress = False,
    ) -> Array:
        """Return the solution at t1 of the perturbed ODE that starts from z at t0, to about 1e-12.

        From t0 to t0 + h, with t0 a multiple of h, the flow is a step of the scheme.

        Parameters
        ----------
        t0, t1 : float
            Times in the user's units; ``t1 < t0`` is allowed.

        Examples
        --------
        >>> import dalembert as dal
        >>> explicit = dal.embedding(dal.systems.particle(), "explicit", h=0.5)
        >>> explicit.flow(0, 0.5, [0, 0, 0, 1, 1]).round(9)
        array([0.5, 0.5, 0. , 0.8, 1. ])
        """
        t0, t1 = arguments.number(t0, "t0"), arguments.number(t1, "t1")
        values = self._point(z, "z").copy()
        total = math.ceil(abs((t1 - t0) / self.h))
        with extras.progress(progress, total, "step") as show:
            self._call(lib.dal_embedding_flow, t0, t1, values, show=lambda made: show(int(made)))
            show(total)
        return values

    # ---- how large g is --------------------------------------------------------------------

    @_Documented("ValueError, ConvergenceError, Exception", "float")
    def bound(self, z: ArrayLike | None = None) -> float:
        """Return the largest component of ``|g(tau, z)|`` over a period.

        Examples
        --------
        With the order of the scheme the bound hardly depends on h; with one more it grows as 1/h:

        >>> import dalembert as dal
        >>> for order in (2, 3):
        ...     large = dal.embedding(dal.systems.particle(), "midpoint", h=0.1, order=order)
        ...     print(round(large.with_step(0.05).bound() / large.bound(), 1))
        1.0
        2.0
        """
        return float(np.abs(self.g(TAUS, self._point(z, "z"))).max())

    @_Documented("ValueError, ConvergenceError, Exception", "bool")
    def meaningful(self, z: ArrayLike | None = None) -> bool:
        """Return whether ``|g|`` is at least 100 times its noise at some time in a period.

        If not, for example for p = 4 and small h, the values of g are roundoff.

        Examples
        --------
        >>> import dalembert as dal
        >>> fourth = dal.embedding(dal.systems.heisenberg(), "leapfrog-suzuki4", h=0.1)
        >>> fourth.meaningful(), fourth.with_step(0.005).meaningful()
        (True, False)
        """
        return self.bound(z) > CLEAR * self.noise

    @_Documented("ValueError, ConvergenceError, Exception")
    def measured_order(self, hs: Sequence[float] | None = None, z: ArrayLike | None = None) -> Fit:
        """Return the order of the scheme: the log-log slope of ``h^p |g|`` over h.

        The result does not depend on the order p of this embedding.

        Parameters
        ----------
        hs : sequence of float, optional
            Steps.  Default: h times 1, 2/3, 1/2, 1/3, 1/4.

        Returns
        -------
        Fit
            ``slope`` is the order, ``points`` the number of meaningful steps.  At least three of
            them are needed, over a factor of two in h.

        Examples
        --------
        >>> import dalembert as dal
        >>> claimed = dal.embedding(dal.systems.sleigh(), "explicit", h=0.1, order=2)
        >>> claimed.measured_order().order()
        '1.00'
        """
        given = [self.h * x for x in FRACTIONS] if hs is None else hs
        steps = arguments.array(given, "hs", (None,))
        found = [self.with_step(h) for h in steps]
        # h^(p+1) g has one and the same noise for all h, that of the flow.
        sizes = np.array([abs(one.h) ** (one.order + 1) * one.bound(z) for one in found])
        raw = Fit.of(np.abs(steps), sizes, self.accuracy)
        return dataclasses.replace(raw, slope=raw.slope - 1)


@Common("ValueError", "Embedding")
def embedding(
    system: System,
    scheme: Scheme | str | float,
    h: float,
    order: int | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    dependent: str | Iterable[str] | None = None,
    consistent: str = "check",
    tolerance: float = 1e-14,
    numerical: bool = False,
) -> Embedding:
    """Return a scheme as the period map of a periodically perturbed flow (propoDisc).

    Parameters
    ----------
    system : System
        A system without force and independent of time.
    scheme : Scheme, str or float
        Any scheme except the reference flow.
    h : float
        Step and period, in the user's units of time; not 0.
    order : int, optional
        p, at least 1. Default: the promised order of the scheme.
    q0, v0 : array_like, shape (n,), optional
        A state in D, for the choice of coordinates and as default of ``z``.  Default: the system's
        initial data.
    dependent : str or iterable of str, optional
        Names of the m dependent coordinates, as for `Chart`.
    consistent : {"check", "project", "assume"}, optional
        As in `integrate`.
    tolerance : float, optional
        Tolerance of the reference flow F, in [4.4e-16, 0.1].  It limits the accuracy of g, whose
        noise is about tolerance h^-(p+1).
    numerical : bool, optional
        True: F is the reference flow even if the system has an exact solution.

    Raises
    ------
    NotOnConstraintError
        If (q0, v0) is not in D.
    NotImplementedError
        If the system has a force or depends on time.
    SingularError, DomainError
        If the coordinates cannot be chosen at (q0, v0).

    Examples
    --------
    >>> import dalembert as dal
    >>> for h in (0.2, 0.1, 0.05):
    ...     print(f"{dal.embedding(dal.systems.particle(), 'explicit', h).bound():.2f}")
    0.51
    0.51
    0.51
    """
    require_autonomous(system, "an embedding")
    scheme = Scheme.of(scheme)
    if scheme.is_flow:
        raise ValueError("scheme = 'reference': expected a scheme with a fixed step h")
    h = arguments.number(h, "h")
    order = None if order is None else arguments.integer(order, "order", 1, 2**31 - 1)
    tolerance = arguments.tolerance(tolerance)
    x0 = geometry.initial_state(system, q0, v0)
    consistency = arguments.choice(consistent, "consistent", CONSISTENCY)
    q, v = np.split(consistent_state(system, x0, 0.0, consistency), 2)
    chart = Chart(system, q, v, dependent)
    return Embedding(chart, scheme, h, order, chart.drop(q, v), tolerance, bool(numerical))
