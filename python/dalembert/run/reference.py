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
from .runs import consistent_state
from .scheme import METHODS
from .solution import rank_doubt
from .taylor import require_supported, state

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
        Constant inputs; default 0. Not with Taylor series.

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
    if method == "taylor" and inputs is not None:
        raise ValueError(
            f"inputs = {arguments.shown(inputs)}: method='taylor' does not support inputs; "
            "remove them, or choose another method"
        )
    if method == "taylor":
        require_supported(system, coordinates=None if coordinates == "x" else coordinates)
        x = consistent_state(system, x0, t0, consistency)
        x, error = state(system, x, t0, t, tolerance)
        return Reference(x[: system.n], x[system.n :], error)
    flow = system._c("flow", flow_method, coordinate, tolerance)
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
