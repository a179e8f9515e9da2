"""The reference flow to one time, by an adaptive method."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .. import core, geometry
from ..core import Array, DalembertWarning, arguments, ffi, lib, require_system
from ..core.documentation import Common
from ..system import System
from .events import CONSISTENCY
from .integration import integrate
from .runs import consistent_state
from .scheme import METHODS, Scheme
from .solution import rank_doubt

LOOSER = 10.0  # second tolerance of series, whose difference is the accuracy
COORDINATES = {"x": lib.DAL_FLOW_X, "xi": lib.DAL_FLOW_XI}


class Reference(NamedTuple):
    """A state of the reference flow.

    Attributes
    ----------
    q, v : ndarray, shape (n,)
    accuracy : float
        Estimate of the error: the largest component of the difference to the result with ten times
        the tolerance.
    """

    q: Array
    v: Array
    accuracy: float


@Common("ValueError", "Reference")
def reference(
    system: System,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    t: float = 1.0,
    t0: float = 0.0,
    consistent: str = "check",
    method: str = "rk8pd",
    tolerance: float = 1e-13,
    coordinates: str = "x",
    inputs: Any = None,
) -> Reference:
    """Return the state of the ODE on D at one time, by an adaptive method.

    Parameters
    ----------
    t, t0 : float, optional
        Times; ``t < t0`` is allowed.
    consistent : {"check", "project", "assume"}, optional
        As for `integrate`.
    method : {"rk8pd", "msadams", "rodas", "taylor"}, optional
        Prince-Dormand 8(7) (default), Adams, a Rosenbrock method for stiff potentials, or Taylor
        series as for `integrate`, in the coordinates x.
    tolerance : float, optional
        Relative and absolute tolerance of each step, in [4.4e-16, 0.1].  If the roundoff of the
        field is larger, a step may have an error of that size.
    coordinates : {"x", "xi"}, optional
        Variables of the ODE: the states (q, v), or coordinates xi of charts of D (`Chart`).  A
        chart is replaced when it becomes ill conditioned.
    inputs : array_like, shape (k,), or mapping, optional
        Constant inputs; default 0.

    Warns
    -----
    DalembertWarning
        If the constraints nearly lose rank during the motion, in the coordinates x (not with
        "taylor").

    Raises
    ------
    NotOnConstraintError
        If the initial data are not in D.
    SingularError, ConvergenceError, DomainError
        If the flow could not be continued.

    Examples
    --------
    >>> import dalembert as dal
    >>> particle = dal.systems.particle()
    >>> end = dal.reference(particle, t=1.0)
    >>> bool(abs(end.q - particle.exact(1.0)[0]).max() < 1e-11)
    True
    """
    require_system(system)
    t, t0 = arguments.number(t, "t"), arguments.number(t0, "t0")
    x0 = geometry.initial_state(system, q0, v0)
    consistency = arguments.choice(consistent, "consistent", CONSISTENCY)
    flow_method = arguments.choice(method, "method", METHODS)
    tolerance = arguments.tolerance(tolerance)
    coordinate = arguments.choice(coordinates, "coordinates", COORDINATES)
    acting = arguments.inputs(inputs, system.inputs, 1)[0].copy()
    if method == "taylor":
        if coordinates != "x":
            raise NotImplementedError(
                "coordinates: not supported by method = 'taylor'; choose rk8pd, msadams or rodas"
            )
        return _by_series(system, x0, t0, t, tolerance, consistent, acting)
    compiled = Scheme.find("reference")._stepped(system)
    flow = compiled._c("flow", flow_method, coordinate, tolerance)
    core.call(system.kind, lib.dal_flow_input, flow, acting)
    x = consistent_state(system, x0, t0, consistency, acting)
    accuracy = np.empty(1)
    with core.watching(flow):
        core.call(system.kind, lib.dal_flow_apply, flow, t0, t, x, accuracy)
    counts = ffi.new("dal_stats *")
    lib.dal_flow_stats(flow, counts)
    if counts.rank_doubts:
        warnings.warn(rank_doubt(counts), DalembertWarning, stacklevel=2)
    return Reference(x[: system.n], x[system.n :], float(accuracy[0]))


def _by_series(
    system: System, x0: Array, t0: float, t: float, tolerance: float, consistent: str, u: Array
) -> Reference:
    """Return the state by Taylor series, and its difference to the state by looser ones."""
    ends, n = [], system.n
    for level in (tolerance, min(LOOSER * tolerance, 0.1)):
        run = integrate(
            system, Scheme.taylor(level), x0[:n], x0[n:], t0=t0, h=(t - t0) or 1.0,
            steps=int(t != t0), consistent=consistent, inputs=u if len(u) else None,
        )  # fmt: skip
        ends.append(run.x[-1])
    q, v = ends[0][:n], ends[0][n:]
    rate = geometry.field(system, q, v, t=t, inputs=u if len(u) else None)
    size = 4.0 * abs(ends[0]).max() + abs(rate).max() * max(abs(t), abs(t0))
    error = max(abs(ends[0] - ends[1]).max(), np.finfo(float).eps / 2 * size)
    return Reference(q.copy(), v.copy(), float(error))
