"""Mechanics on D, at one state or at N stacked ones.

Every function takes ``q`` and ``v`` of shape (n,) or (N, n), in the user's units.  N is the first
axis of the result.  The functions are also methods of `dalembert.System`.  The multiplier lambda is
a force: d/dt L_v - L_q = f + mu^T lambda.  M denotes the mass matrix L_vv, D the set {phi(q, v) =
0}, and mu the derivative phi_v.  For linear constraints phi is mu v.  The functions also raise any
exception raised by a function of the system.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import core
from ..core import Array, Handle, Pair, arguments, ffi, lib
from ..core.documentation import Shared


class Documented(Shared):
    """Parameters and exceptions of the functions.

    Parameters
    ----------
    system : System
    q, v, q0, v0 : array_like, shape (n,) or (N, n)
    v : array_like, shape (n,) or (N, n), optional
        Matters only if the constraints are nonlinear or L is not quadratic in v; default 0.
    shift : float, optional
        A time, in the user's units; 0 is D, (1 - beta) h is D_eps.
    t : float or array_like, shape (N,), optional
        Time of the states.
    inputs : array_like, shape (k,) or (N, k), or mapping, optional
        Inputs of the constraints and the force, in order or by name; default 0.

    Raises
    ------
    ValueError
        If an argument has another shape or is not finite.
    DomainError
        If a function of the system is not finite or not defined; ``.step`` is the row that failed.
    SingularError
        If mu loses rank; ``.step`` is the row that failed.
    """


def most_in_a_call(system: Handle) -> int:
    """Return the largest number of states or steps in a call of C, so Ctrl-C is noticed soon.

    A call takes at most a tenth of a second, if a state takes about (n + m)^3 operations.  The
    number depends on the sizes only, not on the machine, and so do the bits of sums in a call.
    """
    return max(1, min(2**14, 2**22 // (system.n + system.m) ** 3))


# ---- states --------------------------------------------------------------------------------


def states(
    system: Handle, q: ArrayLike, v: ArrayLike, names: tuple[str, str] = ("q", "v")
) -> tuple[Array, bool]:
    """Return a copy of the rows (q, v), shape (N, 2n), and whether it was a single state.

    ``names`` are the names of the two arguments in messages.
    """
    n = system.n
    q = arguments.array(q, names[0], (n,), (None, n))
    v = arguments.array(v, names[1], (n,), (None, n))
    if q.shape != v.shape:
        raise ValueError(f"{names[1]}: expected shape {q.shape}, as for {names[0]}, got {v.shape}")
    return np.concatenate([np.atleast_2d(q), np.atleast_2d(v)], axis=1), q.ndim == 1


def or_zero(v: ArrayLike | None, q: ArrayLike) -> ArrayLike:
    """Return the velocities, or zeros if they are None."""
    return np.zeros(np.shape(q)) if v is None else v


def vectors(system: Handle, **given: ArrayLike) -> list[Array]:
    """Return the given vectors of n numbers; their names serve for messages."""
    return [arguments.array(x, name, (system.n,)) for name, x in given.items()]


def beside(x: Array, single: bool, value: ArrayLike, name: str, width: int) -> Array:
    """Return an argument that accompanies states: ``width`` numbers for each."""
    shape = (width,) if single else (len(x), width)
    return np.atleast_2d(arguments.array(value, name, shape))


def halves(x: Array) -> Pair:
    """Return q and v of states, as separate arrays."""
    q, v = np.split(x, 2, axis=-1)
    return q.copy(), v.copy()


def initial(
    system: Handle, q0: ArrayLike | None, v0: ArrayLike | None, *names: str
) -> Pair:
    """Return the initial data, by default those of the system.

    Raises ValueError if only one of q0 and v0 is given.  ``names`` are the names of the two
    arguments in messages, by default q0 and v0.
    """
    found = []
    q_name, v_name = names or ("q0", "v0")
    arguments.pair(q0, v0, (q_name, v_name), " for those of the system")
    for given, default, name in ((q0, system.q0, q_name), (v0, system.v0, v_name)):
        value = default if given is None else given
        if value is None:
            raise ValueError(
                f"{name} is missing: the system {system.name!r} has no default initial data"
            )
        found.append(arguments.array(value, name, (system.n,)))
    return found[0], found[1]


def initial_state(system: Handle, q0: ArrayLike | None, v0: ArrayLike | None, *names: str) -> Array:
    """Return `initial` data as a state (q, v), shape (2n,)."""
    if (
        type(q0) is type(v0) is np.ndarray
        and q0.shape == v0.shape == (system.n,)
        and q0.dtype == v0.dtype == np.float64
    ):  # most often all is well, which is soon seen
        x = np.concatenate((q0, v0))
        if math.isfinite(x.dot(x)):
            return x
    return np.concatenate(initial(system, q0, v0, *names))


def trajectory(
    system: Handle,
    x: Array,
    output: str,
    *,
    t0: float = 0.0,
    h: float = 0.0,
    shift: float = 0.0,
    inputs: Array | None = None,
    times: Array | None = None,
) -> Array:
    """Evaluate one output of ``dal_trajectory`` on the rows of ``x``, shape (N, 2n).

    ``inputs`` has a row for each state of a system with inputs; None: zeros.  ``times`` are the
    times of the rows if they are not evenly spaced.
    """
    inputs = np.zeros((len(x), len(system.inputs))) if inputs is None else inputs
    outputs = {"energy": (), "multipliers": (system.m,), "residual": (system.m,), "relative": ()}
    values = np.empty((len(x), *outputs[output]))
    done = ffi.new("size_t *")
    with system._mechanics.lend() as mechanics:
        steady = not (system.is_forced or system.is_time_dependent)
        most = most_in_a_call(system) if times is None or steady else 1
        for start in range(0, len(x), most):
            count = min(most, len(x) - start)
            rows = np.ascontiguousarray(x[start : start + count])
            pointers = [
                core.pointer(values, start, output=True) if name == output else ffi.NULL
                for name in outputs
            ]
            status = core.attempt(
                lib.dal_trajectory, mechanics,
                t0 + start * h if times is None else times[start], h, shift, count,
                core.pointer(rows, 0, count * 2 * system.n),
                core.pointer(inputs, start) if inputs.size else ffi.NULL, *pointers, done,
            )  # fmt: skip
            system._mechanics.check(status, mechanics, start + int(done[0]))
    return values


def times(t: ArrayLike, x: Array, single: bool) -> float | list[float]:
    """Return the time of all states, or a list with the time of each."""
    found = arguments.array(t, "t", *[(), (len(x),)][: 2 - single])
    return found.tolist()  # type: ignore[no-any-return]


def _quantity(
    system: Handle,
    q: ArrayLike,
    v: ArrayLike,
    output: str,
    t: ArrayLike = 0.0,
    *,
    inputs: Any = None,
    shift: float = 0.0,
) -> Any:
    """Evaluate one output of ``dal_trajectory`` at states."""
    x, single = states(system, q, v)
    rows = arguments.inputs(inputs, system.inputs, len(x))
    at = times(t, x, single)
    when: dict[str, Any] = {"times": np.array(at)} if isinstance(at, list) else {"t0": at}
    shift = arguments.number(shift, "shift")
    values = trajectory(system, x, output, inputs=rows, shift=shift, **when)
    return core.first(values, single)


def input_rows(system: Handle, given: Any, count: int) -> Array | None:
    """Return the inputs at ``count`` states; None if the system has no inputs."""
    rows = arguments.inputs(given, system.inputs, count)
    return rows if system.inputs else None


def _rows(
    system: Handle,
    function: Callable[..., int],
    q: ArrayLike,
    v: ArrayLike,
    *outputs: tuple[int, ...],
    t: ArrayLike = 0.0,
    inputs: Any = None,
) -> Any:
    """Return the outputs of a function for each state, arrays of these shapes."""
    x, single = states(system, q, v)
    rows = input_rows(system, inputs, len(x))
    given = times(t, x, single), x, *outputs
    return system._mechanics.rows(function, single, *given, inputs=rows)


# ---- functions -----------------------------------------------------------------------------


@Documented("ValueError, DomainError", "float or ndarray, shape (N,)")
def energy(system: Handle, q: ArrayLike, v: ArrayLike, t: ArrayLike = 0.0) -> Any:
    """Return the energy E = L_v v - L at each state.

    For constant mass it is v^T M v / 2 + V(q).  It is conserved on D, unless there is a force, the
    constraint forces do work (see `power`), or L depends on time.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().energy([0, 1, 0], [1, 1, 1])
    1.5
    """
    return _quantity(system, q, v, "energy", t)


@Documented("ValueError, DomainError", "ndarray, shape (m,) or (N, m)")
def residual(
    system: Handle,
    q: ArrayLike,
    v: ArrayLike,
    shift: float = 0.0,
    t: ArrayLike = 0.0,
    inputs: Any = None,
) -> Array:
    """Return the residual phi(q - shift v, v) of the constraints.

    It is zero on D for shift 0, and on D_eps for shift (1 - beta) h.  For linear constraints it is
    mu(q - shift v) v.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().residual([0, 1, 0], [1, 1, 3])
    array([2.])
    """
    return _quantity(system, q, v, "residual", t, shift=shift, inputs=inputs)


@Documented("ValueError, DomainError", "float or ndarray, shape (N,)")
def relative_residual(
    system: Handle,
    q: ArrayLike,
    v: ArrayLike,
    shift: float = 0.0,
    t: ArrayLike = 0.0,
    inputs: Any = None,
) -> Any:
    """Return the relative residual, the largest ``|mu^a v| / (|mu^a| |v|)`` at (q - shift v, v).

    Here ``|mu^a| = sum_i |mu^a_i| d_i`` and ``|v| = max_j |v_j| / d_j``.  The scale
    ``d_i = sqrt((M^-1)_ii)`` is the largest ``|v_i|`` of a velocity with ``v^T M v = 1``.

    For affine and nonlinear constraints the numerator is ``|phi^a|``.  The roundings of q and t add
    ``|phi^a - mu^a v| + sum_i |dphi^a/dq_i q_i| + |dphi^a/dt t|`` to the denominator.  With a
    shift, linear constraints have the second of these terms too, and
    ``|q_i - shift v_i| + |shift v_i|`` replaces ``|q_i|``.

    The residual does not change if forms or coordinates are rescaled.  In states stored by a run it
    is at most ``4 n 2^-53``.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().relative_residual([0, 1, 0], [1, 1, 2])
    0.25
    """
    return _quantity(system, q, v, "relative", t, shift=shift, inputs=inputs)


@Documented("ValueError, DomainError, SingularError")
def multipliers(
    system: Handle, q: ArrayLike, v: ArrayLike, t: ArrayLike = 0.0, inputs: Any = None
) -> Array:
    """Return the multipliers lambda = -C^-1 (phi_q v + mu f_v) (lambdax), C = mu M^-1 mu^T.

    Here f_v = M^-1 (L_q - L_vq v + f), which is -M^-1 V_q for constant mass without force.  For
    linear constraints phi_q v is d(mu v)/dq v.  The formula applies off D as well.

    Returns
    -------
    ndarray, shape (m,) or (N, m)
        lambda, forces.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().multipliers([0, 1, 0], [1, 1, 1])
    array([0.5])
    """
    return _quantity(system, q, v, "multipliers", t, inputs=inputs)


@Documented("ValueError, DomainError", "ndarray, shape (n, n) or (N, n, n)")
def metric(
    system: Handle, q: ArrayLike, v: ArrayLike | None = None, t: ArrayLike = 0.0
) -> Array:
    """Return the mass matrix M = L_vv at each state.

    Raises
    ------
    SingularError
        If M is not positive definite.

    Examples
    --------
    >>> import dalembert as dal
    >>> polar = dal.System(
    ...     lagrangian=lambda q, v: (v[0] ** 2 + (q[0] * v[1]) ** 2) / 2,
    ...     lagrangian_q=lambda q, v: [q[0] * v[1] ** 2, 0],
    ...     lagrangian_v=lambda q, v: [v[0], q[0] ** 2 * v[1]],
    ...     lagrangian_vv=lambda q, v: [[1, 0], [0, q[0] ** 2]],
    ...     coordinates=["r", "phi"],
    ... )
    >>> polar.metric([3, 0])
    array([[1., 0.],
           [0., 9.]])
    """
    return _rows(system, lib.dal_metric, q, or_zero(v, q), (system.n, system.n), t=t)


@Documented("ValueError, DomainError, SingularError")
def power(
    system: Handle, q: ArrayLike, v: ArrayLike, t: ArrayLike = 0.0, inputs: Any = None
) -> tuple[Any, Any]:
    """Return the power lambda . (phi_v v) of the constraint forces, and f . v of the force.

    On D their sum is dE/dt.  For linear constraints the first is 0 on D.

    Returns
    -------
    constraint, force : float or ndarray, shape (N,)

    Examples
    --------
    >>> import dalembert as dal
    >>> damped = dal.System(mass=[1, 1], force=lambda t, q, v: -v / 2)
    >>> damped.power([0, 0], [2, 0])
    (0.0, -2.0)
    """
    return _rows(system, lib.dal_power, q, v, (), (), t=t, inputs=inputs)


@Documented("ValueError, DomainError, SingularError", "ndarray, shape (m, m) or (N, m, m)")
def gram(
    system: Handle, q: ArrayLike, v: ArrayLike | None = None, t: ArrayLike = 0.0
) -> Array:
    """Return the symmetric, positive definite matrix C = mu M^-1 mu^T (lemma lemmaC).

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().gram([0, 1, 0])
    array([[2.]])
    """
    return _rows(system, lib.dal_gram, q, or_zero(v, q), (system.m, system.m), t=t)


@Documented("ValueError, DomainError, SingularError", "ndarray, shape (n,) or (N, n)")
def acceleration(
    system: Handle, q: ArrayLike, v: ArrayLike, t: ArrayLike = 0.0, inputs: Any = None
) -> Array:
    """Return the acceleration vdot = f_v + M^-1 mu^T lambda, with f_v as in `multipliers`.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().acceleration([0, 1, 0], [1, 1, 1])
    array([-0.5,  0. ,  0.5])
    """
    return _rows(system, lib.dal_acceleration, q, v, (system.n,), t=t, inputs=inputs)


@Documented("ValueError, DomainError, SingularError", "ndarray, shape (2n,) or (N, 2n)")
def field(
    system: Handle, q: ArrayLike, v: ArrayLike, t: ArrayLike = 0.0, inputs: Any = None
) -> Array:
    """Return the vector field (v, vdot) of the ODE on D.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().field([0, 1, 0], [1, 1, 1])
    array([ 1. ,  1. ,  1. , -0.5,  0. ,  0.5])
    """
    return _rows(system, lib.dal_field, q, v, (2 * system.n,), t=t, inputs=inputs)


@Documented("ValueError, DomainError, SingularError")
def perturbed(
    system: Handle,
    q: ArrayLike,
    v: ArrayLike,
    ghat: ArrayLike,
    weight: float = 1.0,
    t: ArrayLike = 0.0,
    inputs: Any = None,
) -> Pair:
    """Return the field and the multipliers of the perturbed equations of motion (PerturbedDAE).

    The equations are qdot = v + weight ghat_q, vdot = f_v + M^-1 mu^T lambda + weight ghat_v with
    phi(q, v) = 0. On D their field is tangent to D for every ghat (ODEPert).  The multipliers are
    `multipliers` minus weight C^-1 (phi_q ghat_q + mu ghat_v) (hatLambday); the difference is 0 if
    ghat is tangent to D.

    Parameters
    ----------
    ghat : array_like, shape (2n,) or (N, 2n)
        The perturbation (ghat_q, ghat_v).
    weight : float, optional
        Factor of ghat, such as h^p; default 1.

    Returns
    -------
    field : ndarray, shape (2n,) or (N, 2n)
        (qdot, vdot).
    multipliers : ndarray, shape (m,) or (N, m)

    Examples
    --------
    A push in direction z; through the constraint v_z = y v_x a part of it acts on x:

    >>> import dalembert as dal
    >>> particle = dal.systems.particle()
    >>> particle.perturbed([0, 1, 0], [0, 0, 0], [0, 0, 0, 0, 0, 2])
    (array([0., 0., 0., 1., 0., 1.]), array([-1.]))
    """
    x, single = states(system, q, v)
    push = beside(x, single, ghat, "ghat", 2 * system.n)
    weight = arguments.number(weight, "weight")
    outputs = (2 * system.n,), (system.m,)
    rows = input_rows(system, inputs, len(x))
    given = times(t, x, single), weight, x, push, *outputs
    return system._mechanics.rows(lib.dal_perturbed, single, *given, inputs=rows)


@Documented("ValueError, DomainError, SingularError", "ndarray, shape (n,) or (N, n)")
def project(
    system: Handle,
    q: ArrayLike,
    v: ArrayLike,
    shift: float = 0.0,
    t: ArrayLike = 0.0,
    inputs: Any = None,
) -> Array:
    """Return the velocity projected to D (shift 0) or to D_eps (shift (1 - beta) h).

    For shift 0 and linear or affine constraints it is v - M^-1 mu^T C^-1 phi, the nearest velocity
    in D in the mass metric.

    Raises
    ------
    ConvergenceError
        If Newton's iteration does not converge, for shift != 0 or nonlinear constraints.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().project([0, 1, 0], [1, 1, 3])
    array([2., 1., 2.])
    """
    x, single = states(system, q, v)
    rows = input_rows(system, inputs, len(x))
    projection(system, x, arguments.number(shift, "shift"), times(t, x, single), rows)
    return core.first(halves(x)[1], single)


def projection(
    system: Handle,
    x: Array,
    shift: float = 0.0,
    t: float | list[float] = 0.0,
    inputs: Array | None = None,
) -> Array:
    """Project the rows of ``x`` in place; return the distances in the mass metric, shape (N,)."""
    return system._mechanics.rows(lib.dal_project, False, t, shift, x, (), inputs=inputs)


@Documented("ValueError, DomainError", "ndarray, shape (n,) or (N, n)")
def consistent(
    system: Handle,
    q0: ArrayLike,
    v0: ArrayLike,
    keep: str | int | Iterable[str] | Iterable[int] | Iterable[bool] | None = None,
    t: ArrayLike = 0.0,
    inputs: Any = None,
) -> Array:
    """Return the velocity in D nearest to v0 in the mass metric, with some components fixed.

    For nonlinear constraints Newton's iteration from v0 computes a velocity in D.

    Parameters
    ----------
    q0, v0 : array_like, shape (n,) or (N, n)
    keep : str, int, iterable of str, of int, or of bool, optional
        Coordinates whose velocities do not change: names, indices, or n truth values.

    Raises
    ------
    SingularError
        If the fixed components leave too little freedom, even if v0 is in D.
    ConvergenceError
        If Newton's iteration does not converge, for nonlinear constraints.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.particle().consistent([0, 1, 0], [1, 1, 3], keep=["z"])
    array([3., 1., 3.])
    """
    x, single = states(system, q0, v0, ("q0", "v0"))
    mask = ffi.NULL if keep is None else ffi.new("unsigned char[]", _mask(system, keep))
    given = times(t, x, single), mask, x, ()
    rows = input_rows(system, inputs, len(x))
    system._mechanics.rows(lib.dal_consistent, single, *given, inputs=rows)
    return core.first(halves(x)[1], single)


def _mask(system: Handle, keep: Any) -> list[int]:
    """Return n zeros and ones for names or indices of coordinates, or for n truth values."""
    n = system.n
    try:
        given = [keep] if isinstance(keep, str | bytes) else list(keep)
    except TypeError:
        given = [keep]
    if given and all(isinstance(k, bool | np.bool_) for k in given):
        if len(given) != n:
            raise ValueError(f"keep: expected {n} values True or False, got {len(given)}")
        return [int(k) for k in given]
    places = []
    for k in given:
        if isinstance(k, str):
            places.append(place(system, k, "keep"))
        elif isinstance(k, int | np.integer) and not isinstance(k, bool):
            places.append(arguments.integer(k, "keep", 0, n - 1))
            if places.count(k) > 1:
                raise ValueError(
                    f"keep = {arguments.shown(keep)}: {k} occurs twice; for a mask, use True "
                    "and False"
                )
        else:
            raise ValueError(
                f"keep = {arguments.shown(keep)}: expected names or indices of coordinates, "
                f"or {n} values True or False"
            )
    return [int(i in places) for i in range(n)]


def place(system: Handle, name: str, argument: str) -> int:
    """Return the index of a coordinate; raise ValueError about an argument if it is unknown."""
    names = system.coordinates
    if name not in names:
        raise ValueError(
            f"{argument}: there is no coordinate {arguments.shown(name)}; "
            f"{arguments.suggestion(name, names)}choose from {', '.join(names)}"
        )
    return names.index(name)
