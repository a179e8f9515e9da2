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
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ._core import ffi as ffi
from ._core import lib as lib
from .arguments import Array as Array
from .arguments import returned

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
    """Initial data do not satisfy the constraint mu(q) v = 0."""

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


# What an output of a callback is called in Python; an index means that an entry of it is meant.
_PYTHON_NAMES = [
    (re.compile(pattern), name)
    for pattern, name in (
        (r"(?:potential: )?\bV_q\[0,(\d+)\]", r"gradient[\1]"),
        (r"(?:potential: )?\bV_qq(?=\[)", "hessian"),
        (r"(?:constraint: )?\bphi_v(?=\[)", "forms"),
        (r"(?:constraint: )?\bphi_q(?=\[)", "forms_velocity_derivative"),
        (r"potential: V\[0,0\]", "potential"),
        (r"\bx0(?= does not lie in D)", "(q0, v0)"),
    )
]


class _Raised(threading.local):
    """The exception that a callback of this thread raised, until C has returned."""

    exception: BaseException | None = None


_raised = _Raised()


def attempt(function: Callable[..., int], *arguments: Any) -> int:
    """Call a C function that may call back; return its status for :func:`failure`."""
    _raised.exception = None
    return function(*arguments)


def failure(
    status: int, message: str, *, step: int | None = None, t: float | None = None
) -> BaseException:
    """Return the exception for a status that is not success.

    It is the very exception that a callback raised, where this is why C failed.
    """
    exception, _raised.exception = _raised.exception, None
    if exception is not None and status in (lib.DAL_EUSER, lib.DAL_EDOMAIN):
        return exception
    message = in_python(message) or string(lib.dal_strerror(status))
    kind = _EXCEPTIONS.get(status, DalembertError)
    if issubclass(kind, DalembertError):
        return kind(message, status=status, step=step, t=t)
    return kind(message)


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


# ---- texts and buffers ---------------------------------------------------------------------


def version() -> str:
    """Return the version of the C library that is running."""
    return string(lib.dal_version())


def string(text: Any) -> str:
    """Return a C string, "" for NULL."""
    return ffi.string(text).decode("utf-8", "replace") if text != ffi.NULL else ""


def in_python(message: str) -> str:
    """Return a message of the core with the names that users of Python gave: gradient, not V_q."""
    for pattern, name in _PYTHON_NAMES:
        message = pattern.sub(name, message)
    return message


def strings(texts: list[str]) -> tuple[Any, list[Any]]:
    """Return a ``const char *[]`` and what has to be kept alive with it."""
    kept = [ffi.new("char[]", text.encode()) for text in texts]
    return ffi.new("const char *[]", kept), kept


def pointer(array: Array, row: int = 0) -> Any:
    """Return the address of ``array[row]``; the caller keeps the array alive."""
    return ffi.from_buffer("double[]", array) + row * (array.strides[0] // array.itemsize)


def doubles(address: Any, count: int) -> Array:
    """Return a copy of ``count`` doubles."""
    return np.frombuffer(ffi.buffer(address, 8 * count)[:]).copy()


def residual_bound(n: int) -> float:
    """Return 4 n u: a relative residual up to this is roundoff of n coordinates."""
    return 4 * n * ROUNDOFF


# ---- callbacks -----------------------------------------------------------------------------

_from_handle, _buffer, _memmove = ffi.from_handle, ffi.buffer, ffi.memmove
_frombuffer, _ndarray, _double = np.frombuffer, np.ndarray, np.dtype(np.float64)


class Callables:
    """A user's functions of a system, and the shapes of what they return."""

    __slots__ = (
        "bytes", "forms", "forms_velocity_derivative", "gradient", "hessian", "matrix", "potential",
        "square", "vector",
    )  # fmt: skip

    def __init__(
        self,
        n: int,
        m: int,
        forms: Callable[[Array], ArrayLike] | None,
        forms_velocity_derivative: Callable[[Array, Array], ArrayLike] | None,
        potential: Callable[[Array], float] | None,
        gradient: Callable[[Array], ArrayLike] | None,
        hessian: Callable[[Array], ArrayLike] | None,
    ) -> None:
        self.forms = forms
        self.forms_velocity_derivative = forms_velocity_derivative
        self.potential = potential
        self.gradient = gradient
        self.hessian = hessian
        self.bytes = 8 * n
        self.vector, self.matrix, self.square = (n,), (m, n), (n, n)


def _write(target: Any, value: Any, shape: tuple[int, ...], name: str) -> None:
    """Copy what a callback returned to ``target``; an array of doubles needs no conversion."""
    if type(value) is not _ndarray or value.dtype is not _double or value.shape != shape:
        value = returned(value, shape, name)
    elif not value.flags.c_contiguous:
        value = value.copy()
    _memmove(target, value, value.nbytes)


def _remember(kind: type[BaseException], value: BaseException, traceback: Any) -> int:
    """Keep the exception of a callback until C has returned, and say so to C."""
    _raised.exception = value.with_traceback(traceback)
    return 1 if isinstance(value, DomainError) else lib.DAL_EUSER


# The arrays that a user's function gets are copies, of the 24 bytes of a particle say, made as a
# bytes object: that is as fast as a view of C's memory, cannot be written to, and may be kept.


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_potential(q: Any, V: Any, V_q: Any, V_qq: Any, ctx: Any) -> int:
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
def dal_py_constraint(q: Any, v: Any, phi: Any, phi_v: Any, phi_q: Any, ctx: Any) -> int:
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
        return bool(self.function(step, t, q, v))


@ffi.def_extern(error=lib.DAL_EUSER, onerror=_remember)
def dal_py_observer(step: int, t: float, x: Any, ctx: Any) -> int:
    observer = _from_handle(ctx)
    state = _buffer(x, 2 * observer.bytes)[:]
    half = observer.bytes
    return int(observer.see(step, t, _frombuffer(state[:half]), _frombuffer(state[half:])))
