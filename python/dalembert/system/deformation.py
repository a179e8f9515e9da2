"""Systems whose constraints are those of another one, deformed; methods of `dalembert.System`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from .. import core
from ..core import arguments
from ..core import Array, ffi, lib

if TYPE_CHECKING:
    from .system import System

__all__ = ["at_kept_nodes", "deformed"]


def deformed(
    system: System,
    g: Callable[[Array, Array], ArrayLike],
    delta: float,
    *,
    g_v: Callable[[Array, Array], ArrayLike],
    g_q: Callable[[Array, Array], ArrayLike] | None = None,
    kind: str = "nonlinear",
) -> System:
    """Return the system with the constraints phi + delta g = 0 (deformation, DefCons, DefDAE).

    It is a system as any other: `gram` is C_delta, `multipliers` are lambda_delta and `field` is
    h_delta (Ceps, heps).  Constraints that are nonlinear in v do work, see `power`, so that the
    energy is no first integral.  The exact solution, the invariants and the initial data of the
    system are not those of the deformed one; ``deformed.project(q, v)`` leads into its D.

    Parameters
    ----------
    system : System
        With at least one constraint.
    g : callable
        ``g(q, v) -> (m,)``.
    delta : float
        The size of the deformation, in the user's units.
    g_v : callable
        ``g_v(q, v) -> (m, n)``: entry [a, i] is dg^a/dv_i.
    g_q : callable, optional
        ``g_q(q, v) -> (m, n)``: entry [a, j] is dg^a/dq_j.  None: d(phi + delta g)/dq is replaced
        by central differences, see `differenced`.
    kind : {"nonlinear", "affine", "linear"}, optional
        Of phi + delta g as a function of v.

    Returns
    -------
    System
        It keeps ``system`` alive, and pickles if g, g_v and g_q do.

    Raises
    ------
    ValueError
        If an argument is out of range, the system has no constraints, or the kind is simpler than
        that of the system.
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
    for function, name in ((g, "g"), (g_v, "g_v"), (g_q, "g_q")):
        arguments.function(function, name)
    if g is None or g_v is None:
        raise ValueError("g(q, v) and g_v(q, v) -> dg/dv: expected both")
    number = arguments.choice(kind, "kind", core.KINDS)
    if number < core.KINDS[system.kind]:
        raise ValueError(
            f"kind = {kind!r}: the constraints of the system are {system.kind} already"
        )
    callables = core.DeformationCallables(system.n, system.m, g, g_v, g_q)
    context = ffi.new_handle(callables)
    handle = core.adopt(
        "system",
        lib.dal_system_deform,
        system._handle,
        lib.dal_py_deformation,
        context,
        arguments.number(delta, "delta"),
        number,
        lib.DAL_MISSING_PHI_Q if g_q is None else 0,
        owner=(system, callables, context),
    )
    description = {"system": system, "g": g, "delta": delta, "g_v": g_v, "g_q": g_q, "kind": kind}
    return system._derived(handle, (_restore_deformed, description))


def at_kept_nodes(system: System, shift: float) -> System:
    """Return the system with the constraints phi(q - shift v, v) = 0 (deformedCons, originalnodes).

    For ``shift = scheme.shift(h)``, which is (1 - beta) h, its D is the D_eps in which the scheme
    with kept nodes stays.  It is a nonlinear constraint with a flow of its own; such a run is a
    method of order 1 for that flow, as it is for the flow of ``system``.

    Parameters
    ----------
    system : System
        With at least one constraint, whose derivative by q is given.
    shift : float
        A time, in the user's units.

    Returns
    -------
    System
        It keeps ``system`` alive, and pickles if ``system`` does.

    Raises
    ------
    ValueError
        If the shift is not finite, or the system does not provide what is needed.
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
    if lib.dal_system_missing(system._handle) & lib.DAL_MISSING_PHI_Q:
        needed = "constraint_q" if system.kind == "nonlinear" else "forms_velocity_derivative"
        raise ValueError(f"{needed}: needed, the system {system.name!r} does not provide it")
    new = lib.dal_system_deform_nodes
    handle = core.adopt("system", new, system._handle, shift, owner=system)
    return system._derived(handle, (at_kept_nodes, system, shift))


def _restore_deformed(description: dict[str, Any]) -> System:
    """Make a deformed system again from its description."""
    return deformed(**description)
