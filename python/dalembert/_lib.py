"""The one module that sees the extension: status codes, buffers and callbacks.

How an exception of a user's function reaches the user:

1. A public function calls C through :func:`attempt` or :func:`make`.  C holds no lock of Python.
2. C calls a trampoline (``dal_py_potential``, ...), which calls the user's function.
3. The function raises.  The trampoline's ``onerror`` keeps the exception for this thread and
   returns ``DAL_EUSER`` to C (a positive number for a :class:`DomainError`, so that C may try a
   shorter Newton step).
4. C unwinds, leaves its state as it was, and returns its status.
5. :func:`failure` sees the status and hands out the exception that was kept, with its traceback.

What is kept belongs to the thread, not to an object: threads may share a system, and a callback
may itself integrate, because an exception is kept only when the callback has already been left.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ._core import ffi as ffi
from ._core import lib as lib
from .arguments import Array as Array
from .arguments import returned, shown

if TYPE_CHECKING:
    from .solution import Solution

__all__ = [
    "ConvergenceError",
    "DalembertError",
    "DalembertWarning",
    "DomainError",
    "NotOnConstraintError",
    "SingularError",
]


ROUNDOFF = 2.0**-53  # the unit roundoff u


# ---- exceptions ----------------------------------------------------------------------------


class DalembertWarning(UserWarning):
    """A result was computed, and there is reason to doubt it."""


class DalembertError(RuntimeError):
    """A computation that could not be finished.

    Attributes
    ----------
    status : int
        The status of the C library, see ``dal_status`` in ``dalembert.h``.
    step : int or None
        Number of steps that were made before the failure, in a run; in an evaluation of stacked
        states, the row that failed.
    t : float or None
        Time of the last good state of a run.
    partial : Solution or None
        The part of a run that was computed.
    """

    status: int = lib.DAL_EUSER

    def __init__(
        self,
        message: str = "",
        *,
        status: int | None = None,
        step: int | None = None,
        t: float | None = None,
        partial: Solution | None = None,
    ) -> None:
        super().__init__(message)
        if status is not None:
            self.status = status
        self.step = step
        self.t = t
        self.partial = partial


class ConvergenceError(DalembertError):
    """Newton's iteration, or the step size control of the reference flow, did not converge."""

    status = lib.DAL_ENOCONV


class SingularError(DalembertError):
    """A matrix that has to be invertible is not, to working precision."""

    status = lib.DAL_ESINGULAR


class NotOnConstraintError(DalembertError, ValueError):
    """Initial data do not satisfy the constraint phi(q, v) = 0."""

    status = lib.DAL_EOFFD


class DomainError(DalembertError):
    """A function is not defined where it was asked for: NaN, Inf, or raised by a callback.

    A callback may raise it for a ``q`` outside its domain: Newton's iteration then tries a shorter
    step before the run fails.
    """

    status = lib.DAL_EDOMAIN


_EXCEPTIONS: dict[int, type[Exception]] = {
    lib.DAL_EINVAL: ValueError,
    lib.DAL_ENOMEM: MemoryError,
    lib.DAL_EUNSUPPORTED: NotImplementedError,
    lib.DAL_EDOMAIN: DomainError,
    lib.DAL_ESINGULAR: SingularError,
    lib.DAL_ENOCONV: ConvergenceError,
    lib.DAL_EOFFD: NotOnConstraintError,
}


# What an output of a callback is called in Python, by the kind of the constraints; an index means
# that an entry of it is meant.
_COMMON_NAMES = (
    (r"(?:potential: )?\bV_q\[0,(\d+)\]", r"gradient[\1]"),
    (r"(?:potential: )?\bV_qq(?=\[)", "hessian"),
    (r"potential: V\[0,0\]", "potential"),
    (r"lagrangian: L\[0,0\]", "lagrangian"),
    (r"(?:lagrangian: )?\bL_([qv])\[0,(\d+)\]", r"lagrangian_\1[\2]"),
    (r"(?:lagrangian: )?\bL_(qq|vq|vv)(?=\[)", r"lagrangian_\1"),
    (r"force: f\[0,(\d+)\]", r"force[\1]"),
    (r"(?:force: )?\bf_([qv])(?=\[)", r"force_\1"),
    (r"\bx0(?= does not lie in D)", "(q0, v0)"),
)
_PYTHON_NAMES = {
    kind: [(re.compile(pattern), name) for pattern, name in (*_COMMON_NAMES, *names)]
    for kind, names in {
        "linear": (
            (r"(?:constraint: )?\bphi_v(?=\[)", "forms"),
            (r"(?:constraint: )?\bphi_q(?=\[)", "forms_velocity_derivative"),
        ),
        "affine": (
            (r"constraint: phi\[0,(\d+)\]", r"(forms v + affine)[\1]"),
            (r"(?:constraint: )?\bphi_v(?=\[)", "forms"),
            (
                r"(?:constraint: )?\bphi_q(?=\[)",
                "(forms_velocity_derivative + affine_derivative)",
            ),
        ),
        "nonlinear": (
            (r"constraint: phi\[0,(\d+)\]", r"constraint[\1]"),
            (r"(?:constraint: )?\bphi_([qv])(?=\[)", r"constraint_\1"),
        ),
    }.items()
}


class _Raised(threading.local):
    """The exception that a callback of this thread raised, until C has returned."""

    exception: BaseException | None = None


_raised = _Raised()


def attempt(function: Callable[..., int], *arguments: Any) -> int:
    """Call a C function that may call back; return its status for :func:`failure`."""
    _raised.exception = None
    return function(*arguments)


def failure(
    status: int,
    message: str,
    *,
    kind: str = "linear",
    step: int | None = None,
    t: float | None = None,
) -> BaseException:
    """Return the exception for a status that is not success.

    It is the very exception that a callback raised, where this is why C failed.  ``kind`` is that
    of the constraints, whose functions the message may name.
    """
    exception, _raised.exception = _raised.exception, None
    if exception is not None and status in (lib.DAL_EUSER, lib.DAL_EDOMAIN):
        return exception
    message = in_python(message, kind) or string(lib.dal_strerror(status))
    exception_type = _EXCEPTIONS.get(status, DalembertError)
    if issubclass(exception_type, DalembertError):
        return exception_type(message, status=status, step=step, t=t)
    return exception_type(message)


def check(status: int, message: str = "", *, step: int | None = None) -> None:
    """Raise the exception of ``status``, unless it is success."""
    if status < 0:
        raise failure(status, message, step=step)


def make(kind: str, *arguments: Any, owner: Any = None) -> Any:
    """Return a C object ``dal_<kind>`` from ``dal_<kind>_new(&object, *arguments, &error)``.

    It is freed with the last reference to it, and keeps ``owner`` alive until then.
    """
    return adopt(kind, getattr(lib, f"dal_{kind}_new"), *arguments, owner=owner)


def adopt(kind: str, new: Callable[..., int], *arguments: Any, owner: Any = None) -> Any:
    """As :func:`make`, for a constructor of another name."""
    slot = ffi.new(f"dal_{kind} **")
    error = ffi.new("dal_error *")
    status = attempt(new, slot, *arguments, error)
    if status < 0:
        raise failure(status, string(error.text))
    free = getattr(lib, f"dal_{kind}_free")

    def release(handle: Any, _owner: Any = owner) -> None:
        free(handle)

    return ffi.gc(slot[0], release)


class Constant:
    """An object whose public attributes are set once: C counts on them."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__dict__ and not name.startswith("_"):
            raise AttributeError(f"{type(self).__name__}.{name} does not change")
        super().__setattr__(name, value)


# ---- texts and buffers ---------------------------------------------------------------------


def version() -> str:
    """Return the version of the C library that is running."""
    return string(lib.dal_version())


def string(text: Any) -> str:
    """Return a C string, "" for NULL."""
    return ffi.string(text).decode("utf-8", "replace") if text != ffi.NULL else ""


def in_python(message: str, kind: str = "linear") -> str:
    """Return a message of the core with the names that users of Python gave: gradient, not V_q."""
    for pattern, name in _PYTHON_NAMES[kind]:
        message = pattern.sub(name, message)
    return message


def strings(texts: list[str]) -> tuple[Any, list[Any]]:
    """Return a ``const char *[]`` and what has to be kept alive with it."""
    kept = [ffi.new("char[]", text.encode()) for text in texts]
    return ffi.new("const char *[]", kept), kept


def pointer(array: Array, row: int = 0, count: int = 0, *, output: bool = False) -> Any:
    """Return the address of ``array[row]``; the caller keeps the array alive.

    C reads, or for an ``output`` writes, ``count`` doubles from there.

    Raises
    ------
    ValueError
        If the array does not hold C-contiguous doubles, so many after its row, or cannot be
        written to.
    """
    if array.dtype != _double:
        raise ValueError(f"an array of {array.dtype}: expected float64")
    address = ffi.from_buffer("double[]", array, output)
    start = row * (array.size // max(len(array), 1)) if row else 0
    if not 0 <= start <= len(address) - count:
        raise ValueError(
            f"an array of shape {array.shape}: expected {count} numbers from row {row} on"
        )
    return address + start


def doubles(address: Any, count: int) -> Array:
    """Return a copy of ``count`` doubles."""
    return np.frombuffer(ffi.buffer(address, 8 * count)[:]).copy()


def residual_bound(n: int) -> float:
    """Return 4 n u: a relative residual up to this is roundoff of n coordinates."""
    return 4 * n * ROUNDOFF


# ---- callbacks -----------------------------------------------------------------------------

_from_handle, _buffer, _memmove = ffi.from_handle, ffi.buffer, ffi.memmove
_frombuffer, _ndarray, _double = np.frombuffer, np.ndarray, np.dtype(np.float64)


# The kinds of constraints, by their names.
KINDS = {"linear": lib.DAL_LINEAR, "affine": lib.DAL_AFFINE, "nonlinear": lib.DAL_NONLINEAR}

FUNCTIONS = (
    "forms", "forms_velocity_derivative", "affine", "affine_derivative",
    "constraint", "constraint_v", "constraint_q",
    "potential", "gradient", "hessian",
    "lagrangian", "lagrangian_q", "lagrangian_v", "lagrangian_qq", "lagrangian_vq", "lagrangian_vv",
    "force", "force_q", "force_v",
    "exact",
)  # fmt: skip


class Callables:
    """A user's functions of a system, and the shapes of what they return."""

    __slots__ = (*FUNCTIONS, "bytes", "matrix", "multipliers", "square", "vector")

    def __init__(self, n: int, m: int, functions: Mapping[str, Callable[..., Any] | None]) -> None:
        for name in FUNCTIONS:
            setattr(self, name, functions[name])
        self.bytes = 8 * n
        self.vector, self.multipliers, self.matrix, self.square = (n,), (m,), (m, n), (n, n)


def _doubles(value: Any, shape: tuple[int, ...], name: str) -> Array:
    """Return what a callback returned as C-contiguous doubles; such an array as it is."""
    if type(value) is not _ndarray or value.dtype is not _double or value.shape != shape:
        return returned(value, shape, name)
    return value if value.flags.c_contiguous else value.copy()


def _write(target: Any, value: Any, shape: tuple[int, ...], name: str) -> None:
    """Copy what a callback returned to ``target``."""
    value = _doubles(value, shape, name)
    _memmove(target, value, value.nbytes)


def _remember(kind: type[BaseException], value: BaseException, traceback: Any) -> int:
    """Keep the exception of a callback until C has returned, and say so to C."""
    _raised.exception = value.with_traceback(traceback)
    return 1 if isinstance(value, DomainError) else lib.DAL_EUSER


# Time goes to forces and exact solutions alone: what C asks for phi_t or L_vt is declared to depend
# on time, and no system of Python's functions is.

# The arrays that a user's function gets are copies, of the 24 bytes of a particle say, made as a
# bytes object: that is as fast as a view of C's memory, cannot be written to, and may be kept.


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_potential(t: float, q: Any, V: Any, V_q: Any, V_qq: Any, ctx: Any) -> int:
    call = _from_handle(ctx)
    point = _frombuffer(_buffer(q, call.bytes)[:])
    if V:
        value = call.potential(point)
        V[0] = value if isinstance(value, float) else returned(value, (), "potential")
    if V_q:
        _write(V_q, call.gradient(point), call.vector, "gradient")
    if V_qq:
        _write(V_qq, call.hessian(point), call.square, "hessian")
    return 0


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_lagrangian(
    t: float,
    q: Any,
    v: Any,
    L: Any,
    L_q: Any,
    L_v: Any,
    L_qq: Any,
    L_vq: Any,
    L_vv: Any,
    L_vt: Any,
    ctx: Any,
) -> int:
    call = _from_handle(ctx)
    point = _frombuffer(_buffer(q, call.bytes)[:])
    velocity = _frombuffer(_buffer(v, call.bytes)[:])
    if L:
        value = call.lagrangian(point, velocity)
        L[0] = value if isinstance(value, float) else returned(value, (), "lagrangian")
    if L_q:
        _write(L_q, call.lagrangian_q(point, velocity), call.vector, "lagrangian_q")
    if L_v:
        _write(L_v, call.lagrangian_v(point, velocity), call.vector, "lagrangian_v")
    if L_qq:
        _write(L_qq, call.lagrangian_qq(point, velocity), call.square, "lagrangian_qq")
    if L_vq:
        _write(L_vq, call.lagrangian_vq(point, velocity), call.square, "lagrangian_vq")
    if L_vv:
        _write(L_vv, call.lagrangian_vv(point, velocity), call.square, "lagrangian_vv")
    return 0


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_force(t: float, q: Any, v: Any, f: Any, f_q: Any, f_v: Any, ctx: Any) -> int:
    call = _from_handle(ctx)
    point = _frombuffer(_buffer(q, call.bytes)[:])
    velocity = _frombuffer(_buffer(v, call.bytes)[:])
    if f:
        _write(f, call.force(t, point, velocity), call.vector, "force")
    if f_q:
        _write(f_q, call.force_q(t, point, velocity), call.square, "force_q")
    if f_v:
        _write(f_v, call.force_v(t, point, velocity), call.square, "force_v")
    return 0


# The core asks linear constraints for mu alone, and never for phi = mu v.
@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_linear(
    t: float, q: Any, v: Any, phi: Any, phi_v: Any, phi_q: Any, phi_t: Any, ctx: Any
) -> int:
    call = _from_handle(ctx)
    point = _frombuffer(_buffer(q, call.bytes)[:])
    if phi_v:
        _write(phi_v, call.forms(point), call.matrix, "forms")
    if phi_q:
        velocity = _frombuffer(_buffer(v, call.bytes)[:])
        _write(
            phi_q,
            call.forms_velocity_derivative(point, velocity),
            call.matrix,
            "forms_velocity_derivative",
        )
    return 0


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_affine(
    t: float, q: Any, v: Any, phi: Any, phi_v: Any, phi_q: Any, phi_t: Any, ctx: Any
) -> int:
    call = _from_handle(ctx)
    point = _frombuffer(_buffer(q, call.bytes)[:])
    velocity = _frombuffer(_buffer(v, call.bytes)[:])
    if phi or phi_v:
        forms = _doubles(call.forms(point), call.matrix, "forms")
        if phi_v:
            _memmove(phi_v, forms, forms.nbytes)
        if phi:
            shift = _doubles(call.affine(point), call.multipliers, "affine")
            _write(phi, forms @ velocity + shift, call.multipliers, "affine")
    if phi_q:
        name = "forms_velocity_derivative"
        turn = _doubles(call.forms_velocity_derivative(point, velocity), call.matrix, name)
        shift = _doubles(call.affine_derivative(point), call.matrix, "affine_derivative")
        _write(phi_q, turn + shift, call.matrix, name)
    return 0


def _constrain(call: Any, q: Any, v: Any, outputs: dict[str, Any]) -> int:
    """Answer for m functions of (q, v), their derivatives by v and by q: names and targets."""
    point = _frombuffer(_buffer(q, call.bytes)[:])
    velocity = _frombuffer(_buffer(v, call.bytes)[:])
    shapes = (call.multipliers, call.matrix, call.matrix)
    for (name, target), shape in zip(outputs.items(), shapes, strict=True):
        if target:
            _write(target, getattr(call, name)(point, velocity), shape, name)
    return 0


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_nonlinear(
    t: float, q: Any, v: Any, phi: Any, phi_v: Any, phi_q: Any, phi_t: Any, ctx: Any
) -> int:
    call = _from_handle(ctx)
    return _constrain(call, q, v, {"constraint": phi, "constraint_v": phi_v, "constraint_q": phi_q})


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_exact(t: float, x0: Any, x: Any, ctx: Any) -> int:
    call = _from_handle(ctx)
    state = _buffer(x0, 2 * call.bytes)[:]
    values = call.exact(t, _frombuffer(state[: call.bytes]), _frombuffer(state[call.bytes :]))
    _write_several((x, x + call.vector[0]), values, call.vector, ("exact (q)", "exact (v)"))
    return 0


class DeformationCallables:
    """A user's g of phi + delta g, and the shapes of what it returns."""

    __slots__ = ("bytes", "g", "g_q", "g_v", "matrix", "multipliers")

    def __init__(
        self,
        n: int,
        m: int,
        g: Callable[..., Any],
        g_v: Callable[..., Any],
        g_q: Callable[..., Any] | None,
    ) -> None:
        self.g, self.g_v, self.g_q = g, g_v, g_q
        self.bytes = 8 * n
        self.multipliers, self.matrix = (m,), (m, n)


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_deformation(
    t: float, q: Any, v: Any, g: Any, g_v: Any, g_q: Any, g_t: Any, ctx: Any
) -> int:
    call = _from_handle(ctx)
    return _constrain(call, q, v, {"g": g, "g_v": g_v, "g_q": g_q})


class MapCallables:
    """A user's finite difference map of n coordinates."""

    __slots__ = ("bytes", "derivatives", "map", "square", "vector")

    def __init__(
        self, n: int, map: Callable[..., Any], derivatives: Callable[..., Any] | None
    ) -> None:
        self.map = map
        self.derivatives = derivatives
        self.bytes = 8 * n
        self.vector, self.square = (n,), (n, n)


_OF_MAP = ("map (g)", "map (f)")
_OF_DERIVATIVES = tuple(f"derivatives (d{x}/d{q})" for x in "gf" for q in ("q0", "q1"))


def _write_several(
    targets: tuple[Any, ...], values: Any, shape: tuple[int, ...], names: tuple[str, ...]
) -> None:
    """Copy what a callback returned as a tuple to as many targets."""
    try:
        several = tuple(values)
    except TypeError:
        several = ()
    if len(several) != len(targets):
        raise ValueError(
            f"{names[0].split()[0]} has to return {len(targets)} arrays of shape {shape}, "
            f"it returned {shown(values)}"
        )
    for target, value, what in zip(targets, several, names):
        _write(target, value, shape, what)


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_map(
    h: float, q0: Any, q1: Any, g: Any, f: Any, g_0: Any, g_1: Any, f_0: Any, f_1: Any, ctx: Any
) -> int:
    call = _from_handle(ctx)
    pair = [_frombuffer(_buffer(q, call.bytes)[:]) for q in (q0, q1)]
    _write_several((g, f), call.map(h, *pair), call.vector, _OF_MAP)
    if g_0:
        targets = (g_0, g_1, f_0, f_1)
        _write_several(targets, call.derivatives(h, *pair), call.square, _OF_DERIVATIVES)
    return 0


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_watch(t: float, ctx: Any) -> int:
    _from_handle(ctx)(t)
    return 0


class Observer:
    """A user's observer of a run; it sees every stored state once, whatever the blocks are."""

    __slots__ = ("bytes", "function", "last")

    def __init__(self, n: int, function: Callable[[int, float, Array, Array], Any]) -> None:
        self.bytes = 8 * n
        self.function = function
        self.last = -1

    def see(self, step: int, t: float, q: Array, v: Array) -> bool:
        """Show a state, unless it is the last one again; return whether to stop."""
        if step == self.last:
            return False
        self.last = step
        answer = self.function(step, t, q, v)
        try:
            return bool(answer)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"observer has to return whether to stop, it returned {shown(answer)}"
            ) from error


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_observer(step: int, t: float, x: Any, ctx: Any) -> int:
    observer = _from_handle(ctx)
    state = _buffer(x, 2 * observer.bytes)[:]
    half = observer.bytes
    return int(observer.see(step, t, _frombuffer(state[:half]), _frombuffer(state[half:])))
