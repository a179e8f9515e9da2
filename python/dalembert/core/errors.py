"""Calls of C, and their exceptions.

How an exception of a user's function reaches the user:

1. A public function calls C through :func:`attempt` or :func:`make`.  C holds no lock of Python.
2. C calls a trampoline (``dal_py_potential``, ...), which calls the user's function.
3. The function raises.  The trampoline's ``onerror`` keeps the exception for this thread and
   returns ``DAL_EUSER`` to C.  For a :class:`DomainError` it returns a positive number, and C may
   try a shorter Newton step.
4. C unwinds, leaves its state unchanged, and returns its status.
5. :func:`failure` checks the status and returns the kept exception, with its traceback.

The kept exception belongs to the thread, not to an object, so threads may share a system.  A
callback may itself integrate, because an exception is kept only after the callback has ended.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from . import functions
from .library import ffi, lib, pointer, string

# ---- exceptions ----------------------------------------------------------------------------


class DalembertWarning(UserWarning):
    """The result of a computation may be doubtful."""


class DalembertError(RuntimeError):
    """A computation that could not be finished.

    Attributes
    ----------
    status : int
        The status of the C library, see ``dal_status`` in ``dalembert.h``.
    step : int or None
        Number of steps before the failure of a run; in an evaluation of stacked states, the row
        that failed.
    t : float or None
        Time of the last valid state of a run.
    partial : Solution or None
        The part of the run before the failure.
    """

    status: int = lib.DAL_EUSER

    def __init__(
        self,
        message: str = "",
        *,
        status: int | None = None,
        step: int | None = None,
        t: float | None = None,
        partial: Any = None,
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
    """A function is not defined at a state: it returned NaN or Inf, or raised this exception.

    A function of the system may raise it for a ``q`` outside its domain.  Newton's iteration then
    tries a shorter step before the run fails.
    """

    status = lib.DAL_EDOMAIN


class ZenoError(DalembertError):
    """Events accumulate, or a system rests on one after its reset, so the run has to stop."""

    status = lib.DAL_EZENO


class JournalError(DalembertError):
    """The journal of a run cannot be written, or read."""

    status = lib.DAL_EIO


_EXCEPTIONS: dict[int, type[Exception]] = {
    lib.DAL_EINVAL: ValueError,
    lib.DAL_ENOMEM: MemoryError,
    lib.DAL_EUNSUPPORTED: NotImplementedError,
    **{
        x.status: x
        for x in (
            DomainError, SingularError, ConvergenceError, NotOnConstraintError, ZenoError,
            JournalError,
        )
    },
}


class _Raised(threading.local):
    """The exception that a callback of this thread raised, until C has returned."""

    exception: BaseException | None = None


raised = _Raised()


def attempt(function: Callable[..., int], *arguments: Any) -> int:
    """Call a C function that may call back; return its status for :func:`failure`.

    Arrays among the arguments are passed by address, and have to be of the right type and size.
    """
    raised.exception = None
    return function(*[pointer(x) if isinstance(x, np.ndarray) else x for x in arguments])


def failure(
    status: int,
    message: str = "",
    *,
    step: int | None = None,
    t: float | None = None,
) -> BaseException:
    """Return the exception for a status that is not success.

    If a callback's exception caused the failure, that exception is returned.  A DomainError may be
    unrelated, because C may avoid the point and fail later for another reason.
    """
    exception, raised.exception = raised.exception, None
    refused = status == lib.DAL_EDOMAIN and (not message or "outside its domain" in message)
    if exception is not None and (refused or status == lib.DAL_EUSER):
        if isinstance(exception, DalembertError) and exception.step is None:
            exception.step, exception.t = step, t
        if refused and message:
            exception.add_note(message)
        return exception
    message = message or string(lib.dal_strerror(status))
    exception_type = _EXCEPTIONS.get(status, DalembertError)
    if issubclass(exception_type, DalembertError):
        return exception_type(message, status=status, step=step, t=t)
    return exception_type(message)


def check(
    status: int, source: Any = "", kind: str = "linear", *, hint: str = "", **where: Any
) -> None:
    """Raise the exception of a status, unless it is success.

    The ``source`` is the message, or a C object with its message (see :func:`words`).
    """
    if status < 0:
        message = source if isinstance(source, str) else words(source, kind)
        raise failure(status, message + hint, **where)


def call(
    kind: str, function: Callable[..., int], one: Any, *arguments: Any, step: int | None = None
) -> None:
    """Call a function of a C object, on a system with constraints of a kind."""
    check(attempt(function, one, *arguments), one, kind, step=step)


def make(kind: str, *arguments: Any, owner: Any = None, new: Any = None) -> Any:
    """Return a C object ``dal_<kind>`` from ``new(&object, *arguments, &error)``.

    The default constructor is ``dal_<kind>_new``.  The object is freed with the last reference to
    it, and keeps ``owner`` alive until then.
    """
    slot, error = ffi.new(f"dal_{kind} **"), ffi.new("dal_error *")
    check(attempt(new or getattr(lib, f"dal_{kind}_new"), slot, *arguments, error), error)
    free = getattr(lib, f"dal_{kind}_free")

    def release(handle: Any, _owner: Any = owner) -> None:
        free(handle)

    return ffi.gc(slot[0], release)


def name_of(one: Any) -> str:
    """Return the type of a C object: ``chart`` for a ``dal_chart *``."""
    name: str = ffi.typeof(one).item.cname
    return name.split()[-1].removeprefix("dal_")


def words(source: Any, kind: str = "linear") -> str:
    """Return the text of a ``dal_error``, with the names used in Python.

    The ``source`` is the record, or the C object that owns it.  The ``kind`` of the constraints
    determines the names of their functions.
    """
    name = name_of(source)
    error = source if name == "error" else getattr(lib, f"dal_{name}_error")(source)
    text, names = ffi.string(error.text), functions.outputs(kind)
    if (output := string(error.output)) in names:
        index = ("", "[{column}]", "[{row},{column}]")[len(functions.shape(output, 1, 1))]
        entry = names[output] + index.format(row=error.row, column=error.column)
        text = text[: error.begin] + entry.encode() + text[error.end :]
    text = text.removeprefix(b"options.")  # they are arguments here
    return text.replace(b"keep_energy: ", b"energy = 'keep': ").decode("utf-8", "replace")
