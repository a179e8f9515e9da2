"""Mechanics on D, at one state or at N stacked ones.

Every function takes ``q`` and ``v`` of shape (n,) or (N, n), in the user's units, and puts the N
first in the shape of its result.  They are also methods of `dalembert.System`.  The sign and the
scale of the multiplier: d/dt L_v - L_q = mu^T lambda, so lambda is a force.

All of them raise ValueError if an argument has another shape or is not finite, DomainError if a
function of the system is not, SingularError if mu(q) loses rank (``.step`` is the row that
failed), and whatever a function of the user raises.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from . import _lib, arguments
from ._lib import Array, ffi, lib

if TYPE_CHECKING:
    from .system import System

__all__ = [
    "acceleration",
    "consistent",
    "energy",
    "field",
    "gram",
    "multipliers",
    "project",
    "relative_residual",
    "residual",
]

# Rows in one call of C: a fraction of a second at most, so that Ctrl-C is seen between two.
_BLOCK = 1 << 14


# ---- states --------------------------------------------------------------------------------


def states(system: System, q: ArrayLike, v: ArrayLike) -> tuple[Array, bool]:
    """Return the rows (q, v), shape (N, 2n), always a copy, and whether it was a single state."""
    n = system.n
    q = arguments.array(q, "q", (n,), (None, n))
    v = arguments.array(v, "v", (n,), (None, n))
    if q.shape != v.shape:
        raise ValueError(f"v: expected shape {q.shape} as q has, got {v.shape}")
    return np.concatenate([np.atleast_2d(q), np.atleast_2d(v)], axis=1), q.ndim == 1


def initial(
    system: System, q0: ArrayLike | None, v0: ArrayLike | None, *names: str
) -> tuple[Array, Array]:
    """Return initial data, those of the system where none are given.

    ``names`` are those of the two arguments, by default q0 and v0.
    """
    found = []
    q_name, v_name = names or ("q0", "v0")
    for given, default, name in ((q0, system.q0, q_name), (v0, system.v0, v_name)):
        value = default if given is None else given
        if value is None:
            raise ValueError(f"{name}: needed, the system {system.name!r} has no initial data")
        found.append(arguments.array(value, name, (system.n,)))
    return found[0], found[1]


def trajectory(
    system: System,
    x: Array,
    output: str,
    width: int | None,
    *,
    t0: float = 0.0,
    h: float = 0.0,
    shift: float = 0.0,
) -> Array:
    """Evaluate one output of ``dal_trajectory`` on the rows of ``x``, shape (N, 2n)."""
    outputs = ("energy", "multipliers", "residual", "relative")
    values = np.empty((len(x),) if width is None else (len(x), width))
    done = ffi.new("size_t *")
    with system._workspace() as mechanics:
        for start in range(0, len(x), _BLOCK):
            pointers = [
                _lib.pointer(values, start) if name == output else ffi.NULL for name in outputs
            ]
            count = min(_BLOCK, len(x) - start)
            status = _lib.attempt(
                lib.dal_trajectory, mechanics, t0 + start * h, h, shift, count,
                _lib.pointer(x, start), *pointers, done,
            )  # fmt: skip
            _check(status, mechanics, start + done[0])
    return values


def rows(
    system: System,
    function: Callable[..., int],
    inputs: Iterable[tuple[Any, ...]],
    values: Array | None = None,
) -> None:
    """Call ``function(mechanics, *given)``, one call for each row."""
    with system._workspace() as mechanics:
        for k, given in enumerate(inputs):
            output = () if values is None else (_lib.pointer(values, k),)
            _check(_lib.attempt(function, mechanics, *given, *output), mechanics, k)


def _check(status: int, mechanics: Any, row: int) -> None:
    if status < 0:
        message = _lib.string(lib.dal_mechanics_message(mechanics))
        raise _lib.failure(status, message, step=int(row))


# ---- functions -----------------------------------------------------------------------------


def energy(system: System, q: ArrayLike, v: ArrayLike) -> Any:
    """Return E = v^T M v / 2 + V(q), a first integral on D.

    Parameters
    ----------
    system : System
    q, v : array_like, shape (n,) or (N, n)

    Returns
    -------
    float or ndarray, shape (N,)

    Raises
    ------
    ValueError, DomainError
        As at the top of this module.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().energy([0, 1, 0], [1, 1, 1])
    1.5
    """
    x, single = states(system, q, v)
    values = trajectory(system, x, "energy", None)
    return float(values[0]) if single else values


def residual(system: System, q: ArrayLike, v: ArrayLike, shift: float = 0.0) -> Array:
    """Return mu(q - shift v) v, which is zero on D (shift 0) or on D_eps (shift (1 - beta) h).

    Parameters
    ----------
    system : System
    q, v : array_like, shape (n,) or (N, n)
    shift : float, optional
        A time, in the user's units.

    Returns
    -------
    ndarray, shape (m,) or (N, m)

    Raises
    ------
    ValueError, DomainError
        As at the top of this module.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().residual([0, 1, 0], [1, 1, 3])
    array([2.])
    """
    x, single = states(system, q, v)
    shift = arguments.number(shift, "shift")
    values = trajectory(system, x, "residual", system.m, shift=shift)
    return values[0] if single else values


def relative_residual(system: System, q: ArrayLike, v: ArrayLike, shift: float = 0.0) -> Any:
    """Return max_a |mu^a v| / sum_i |mu^a_i v_i| with mu at q - shift v.

    It does not change with the scale of mu or v; on D it is at the level of roundoff, 1e-16.

    Parameters
    ----------
    system : System
    q, v : array_like, shape (n,) or (N, n)
    shift : float, optional
        A time, in the user's units; 0 is D, (1 - beta) h is D_eps.

    Returns
    -------
    float or ndarray, shape (N,)

    Raises
    ------
    ValueError, DomainError
        As at the top of this module.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().relative_residual([0, 1, 0], [1, 1, 3])
    0.5
    """
    x, single = states(system, q, v)
    values = trajectory(system, x, "relative", None, shift=arguments.number(shift, "shift"))
    return float(values[0]) if single else values


def multipliers(system: System, q: ArrayLike, v: ArrayLike, t: float = 0.0) -> Array:
    """Return lambda = -C^-1 (d(mu v)/dq v - mu M^-1 V_q) (lambdax), with C = mu M^-1 mu^T.

    It is defined off D as well.

    Parameters
    ----------
    system : System
    q, v : array_like, shape (n,) or (N, n)
    t : float, optional
        Time of the states.

    Returns
    -------
    ndarray, shape (m,) or (N, m)
        Forces.

    Raises
    ------
    ValueError, DomainError, SingularError
        As at the top of this module.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().multipliers([0, 1, 0], [1, 1, 1])
    array([0.5])
    """
    x, single = states(system, q, v)
    values = trajectory(system, x, "multipliers", system.m, t0=arguments.number(t, "t"))
    return values[0] if single else values


def gram(system: System, q: ArrayLike, v: ArrayLike | None = None) -> Array:
    """Return C = mu M^-1 mu^T (lemma lemmaC), symmetric and positive definite.

    Parameters
    ----------
    system : System
    q : array_like, shape (n,) or (N, n)
    v : array_like, shape (n,) or (N, n), optional
        Matters only if the constraints are nonlinear or L is not quadratic in v; default 0.

    Returns
    -------
    ndarray, shape (m, m) or (N, m, m)

    Raises
    ------
    ValueError, DomainError, SingularError
        As at the top of this module.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().gram([0, 1, 0])
    array([[2.]])
    """
    x, single = states(system, q, np.zeros(np.shape(q)) if v is None else v)
    values = np.empty((len(x), system.m**2))
    rows(system, lib.dal_gram, ((_lib.pointer(x, k),) for k in range(len(x))), values)
    matrices = values.reshape(len(x), system.m, system.m)
    return matrices[0] if single else matrices


def acceleration(system: System, q: ArrayLike, v: ArrayLike, t: float = 0.0) -> Array:
    """Return vdot = M^-1 (mu^T lambda - V_q).

    Parameters
    ----------
    system : System
    q, v : array_like, shape (n,) or (N, n)
    t : float, optional
        Time of the states.

    Returns
    -------
    ndarray, shape (n,) or (N, n)

    Raises
    ------
    ValueError, DomainError, SingularError
        As at the top of this module.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().acceleration([0, 1, 0], [1, 1, 1])
    array([-0.5,  0. ,  0.5])
    """
    return _vectors(system, lib.dal_acceleration, system.n, q, v, t)


def field(system: System, q: ArrayLike, v: ArrayLike, t: float = 0.0) -> Array:
    """Return (v, vdot), the vector field of the ODE on D.

    Parameters
    ----------
    system : System
    q, v : array_like, shape (n,) or (N, n)
    t : float, optional
        Time of the states.

    Returns
    -------
    ndarray, shape (2n,) or (N, 2n)

    Raises
    ------
    ValueError, DomainError, SingularError
        As at the top of this module.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().field([0, 1, 0], [1, 1, 1])
    array([ 1. ,  1. ,  1. , -0.5,  0. ,  0.5])
    """
    return _vectors(system, lib.dal_field, 2 * system.n, q, v, t)


def _vectors(
    system: System, function: Callable[..., int], width: int, q: ArrayLike, v: ArrayLike, t: float
) -> Array:
    x, single = states(system, q, v)
    t = arguments.number(t, "t")
    values = np.empty((len(x), width))
    rows(system, function, ((t, _lib.pointer(x, k)) for k in range(len(x))), values)
    return values[0] if single else values


def project(system: System, q: ArrayLike, v: ArrayLike, shift: float = 0.0) -> Array:
    """Return the velocity projected to D (shift 0) or to D_eps (shift (1 - beta) h).

    For shift 0 it is v - M^-1 mu^T C^-1 mu v, the nearest one in the mass metric.

    Parameters
    ----------
    system : System
    q, v : array_like, shape (n,) or (N, n)
    shift : float, optional
        A time, in the user's units.

    Returns
    -------
    ndarray, shape (n,) or (N, n)

    Raises
    ------
    ValueError, DomainError, SingularError
        As at the top of this module.
    ConvergenceError
        For shift != 0, where the equation is not linear.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().project([0, 1, 0], [1, 1, 3])
    array([2., 1., 2.])
    """
    x, single = states(system, q, v)
    projection(system, x, arguments.number(shift, "shift"))
    v = x[:, system.n :].copy()
    return v[0] if single else v


def projection(system: System, x: Array, shift: float = 0.0) -> Array:
    """Project the rows of ``x`` in place; return how far, in the mass metric, shape (N,)."""
    distances = np.empty(len(x))
    rows(system, lib.dal_project, ((shift, _lib.pointer(x, k)) for k in range(len(x))), distances)
    return distances


def consistent(
    system: System,
    q0: ArrayLike,
    v0: ArrayLike,
    keep: str | Iterable[str] | Iterable[bool] | None = None,
) -> Array:
    """Return the velocity in D nearest to v0 in the mass metric, with some components kept.

    Parameters
    ----------
    system : System
    q0, v0 : array_like, shape (n,) or (N, n)
    keep : str, iterable of str, or iterable of bool, optional
        Coordinates whose velocities stay as they are: their names, or n truth values.

    Returns
    -------
    ndarray, shape (n,) or (N, n)

    Raises
    ------
    ValueError, DomainError
        As at the top of this module.
    SingularError
        If the kept components leave too little freedom.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().consistent([0, 1, 0], [1, 1, 3], keep=["z"])
    array([3., 1., 3.])
    """
    x, single = states(system, q0, v0)
    mask = ffi.NULL if keep is None else ffi.new("unsigned char[]", _mask(system, keep))
    distances = np.empty(len(x))
    rows(system, lib.dal_consistent, ((mask, _lib.pointer(x, k)) for k in range(len(x))), distances)
    v = x[:, system.n :].copy()
    return v[0] if single else v


def _mask(system: System, keep: Any) -> list[int]:
    """Return n zeros and ones for names of coordinates or for n truth values."""
    try:
        keep = [keep] if isinstance(keep, str) else list(keep)
    except TypeError:
        keep = [keep]
    if all(isinstance(k, str) for k in keep):
        unknown = [k for k in keep if k not in system.coordinates]
        if unknown:
            raise ValueError(
                f"keep: there is no coordinate {unknown[0]!r}; there are "
                f"{', '.join(system.coordinates)}"
            )
        return [int(c in keep) for c in system.coordinates]
    if len(keep) != system.n or not all(isinstance(k, (bool, np.bool_)) for k in keep):
        raise ValueError(
            f"keep = {keep!r}: expected names of coordinates or {system.n} truth values"
        )
    return [int(k) for k in keep]
