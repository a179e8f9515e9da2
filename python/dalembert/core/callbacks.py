"""The trampolines through which C calls the functions of users."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from .arguments import Array, Pair, returned, shown
from .errors import DomainError, name_of, raised
from .functions import OUTPUTS, Function
from .functions import shape as shape_of
from .library import ffi, lib

_from_handle, _buffer, _memmove = ffi.from_handle, ffi.buffer, ffi.memmove
_frombuffer, _ndarray, _double = np.frombuffer, np.ndarray, np.dtype(np.float64)

# The callbacks whose outputs are functions of the user, all of (q, v) or of (t, q, v).
_PLAIN = ("lagrangian", "force", "deformation")


class Callables:
    """A user's functions, and the shapes of their results, for n coordinates and m constraints.

    The last argument of the force, and of driven constraints, is the inputs, if there are any.
    ``timed``: the first argument of all is the time.  ``entries``: the number of entries that
    sparse linear forms return instead of a matrix.
    """

    def __init__(
        self,
        n: int,
        m: int,
        inputs: int = 0,
        timed: bool = False,
        entries: int | None = None,
        **functions: Function | None,
    ) -> None:
        self.__dict__.update(functions)
        self.timed = timed
        self.bytes, self.bytes_of_inputs = 8 * n, 8 * inputs
        self.vector, self.multipliers, self.square = (n,), (m,), (n, n)
        self.matrix = (m, n) if entries is None else (entries,)
        self.plain = {
            callback: [(name, shape_of(x, n, m)) for x, name in OUTPUTS[callback].items()]
            for callback in (*_PLAIN, "nonlinear")
            if any(functions.get(name) is not None for name in OUTPUTS[callback].values())
        }


def _doubles(value: Any, shape: tuple[int, ...], name: str) -> Array:
    """Return a callback's result as C-contiguous doubles, without a copy if possible."""
    if type(value) is not _ndarray or value.dtype is not _double or value.shape != shape:
        return returned(value, shape, name)
    return value if value.flags.c_contiguous else value.copy()


def _write(target: Any, value: Any, shape: tuple[int, ...], name: str) -> None:
    """Copy a callback's result to ``target``."""
    if not shape and isinstance(value, float):
        target[0] = value
        return
    value = _doubles(value, shape, name)
    _memmove(target, value, value.nbytes)


def _remember(kind: type[BaseException], value: BaseException, traceback: Any) -> int:
    """Keep the exception of a callback until C has returned, and return its status to C."""
    _keep(kind, value, traceback)
    return 1 if isinstance(value, DomainError) else lib.DAL_EUSER


def _keep(kind: type[BaseException], value: BaseException, traceback: Any) -> None:
    """Keep the exception of a watch, which returns a positive number to C by itself."""
    raised.exception = value.with_traceback(traceback)


_trampoline = functools.partial(ffi.def_extern, error=lib.DAL_EUSER, onerror=_remember)
_watching = functools.partial(ffi.def_extern, error=lib.DAL_EUSER, onerror=_keep)


# The arrays that a user's function gets are copies, of the 24 bytes of a particle say, made as a
# bytes object: that is as fast as a view of C's memory, cannot be written to, and may be kept.


@_trampoline()
def dal_py_potential(t: float, q: Any, V: Any, V_q: Any, V_qq: Any, ctx: Any) -> int:
    call = _from_handle(ctx)
    point: tuple[Any, ...] = (_frombuffer(_buffer(q, call.bytes)[:]),)
    if call.timed:
        point = t, *point
    if V:
        _write(V, call.potential(*point), (), "potential")
    if V_q:
        _write(V_q, call.gradient(*point), call.vector, "gradient")
    if V_qq:
        _write(V_qq, call.hessian(*point), call.square, "hessian")
    return 0


def _inputs(call: Callables, u: Any) -> tuple[Any, ...]:
    """Return the inputs as the last argument of a function."""
    return (_frombuffer(_buffer(u, call.bytes_of_inputs)[:]),)


def _define(callback: str, driven: bool = False) -> None:
    """Define the trampoline of a plain callback: (t, q, v, an address for each output, context).

    For the force, and for driven constraints, the inputs precede the outputs.
    """
    is_force = callback == "force"
    takes_inputs = is_force or driven

    def answer(t: float, q: Any, v: Any, *targets: Any) -> int:
        call = _from_handle(targets[-1])
        size = call.bytes
        state: tuple[Any, ...] = _frombuffer(_buffer(q, size)[:]), _frombuffer(_buffer(v, size)[:])
        if is_force or call.timed:
            state = t, *state
        if takes_inputs:
            inputs, targets = targets[0], targets[1:]
            if call.bytes_of_inputs:
                state = *state, *_inputs(call, inputs)
        for (name, shape), target in zip(call.plain[callback], targets):
            if target:
                _write(target, getattr(call, name)(*state), shape, name)
        return 0

    _trampoline(f"dal_py_{'driven_' * driven}{callback}")(answer)


for _callback in _PLAIN:
    _define(_callback)


# The core asks linear constraints for mu alone, and never for phi = mu v.
def _define_forms(kind: str, driven: bool) -> None:
    """Define the trampoline of linear or affine constraints."""
    is_affine = kind == "affine"

    def answer(t: float, q: Any, v: Any, *targets: Any) -> int:
        *inputs, phi, phi_v, phi_q, phi_t, ctx = targets
        call = _from_handle(ctx)
        point: tuple[Any, ...] = (_frombuffer(_buffer(q, call.bytes)[:]),)
        if call.timed:
            point = t, *point
        last = _inputs(call, *inputs) if driven else ()
        phi = phi if is_affine else None
        if phi or phi_q or phi_t:
            velocity = _frombuffer(_buffer(v, call.bytes)[:])
        if phi or phi_v:
            mu = _doubles(call.mu(*point, *last), call.matrix, "mu")
            if phi_v:
                _memmove(phi_v, mu, mu.nbytes)
            if phi:
                shift = _doubles(call.affine(*point, *last), call.multipliers, "affine")
                _write(phi, mu @ velocity + shift, call.multipliers, "affine")
        if phi_q:
            name = "mu_v_q"
            found = call.mu_v_q(*point, velocity, *last)
            slope = _doubles(found, call.matrix, name)
            if is_affine:
                found = call.affine_derivative(*point, *last)
                slope = slope + _doubles(found, call.matrix, "affine_derivative")
            _write(phi_q, slope, call.matrix, name)
        if phi_t:
            found = call.constraint_t(*point, velocity, *last)
            _write(phi_t, found, call.multipliers, "constraint_t")
        return 0

    _trampoline(f"dal_py_{'driven_' * driven}{kind}")(answer)


for _driven in (False, True):
    _define_forms("linear", _driven)
    _define_forms("affine", _driven)
    _define("nonlinear", _driven)


def _halves(call: Callables, x: Any) -> Pair:
    """Return q and v of a state."""
    state = _buffer(x, 2 * call.bytes)[:]
    return _frombuffer(state[: call.bytes]), _frombuffer(state[call.bytes :])


@_trampoline()
def dal_py_exact(t: float, x0: Any, x: Any, ctx: Any) -> int:
    call = _from_handle(ctx)
    values = call.exact(t, *_halves(call, x0))
    _write_several((x, x + call.vector[0]), values, call.vector, ("exact (q)", "exact (v)"))
    return 0


_OF_MAP = ("map (g)", "map (f)")
_OF_DERIVATIVES = tuple(f"derivatives (d{x}/d{q})" for x in "gf" for q in ("q0", "q1"))


def _write_several(
    targets: tuple[Any, ...], values: Any, shape: tuple[int, ...], names: tuple[str, ...]
) -> None:
    """Copy a callback's result, a tuple, to as many targets."""
    try:
        several = tuple(values)
    except TypeError:
        several = ()
    if len(several) != len(targets):
        raise ValueError(
            f"{names[0].rpartition(' ')[0]} returned {shown(values)}: expected {len(targets)} "
            f"arrays of shape {shape}"
        )
    for target, value, what in zip(targets, several, names):
        _write(target, value, shape, what)


@_trampoline()
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


@_watching()
def dal_py_watch(t: float, ctx: Any) -> int:
    _from_handle(ctx)(t)
    return 0


def ignore(t: float) -> None:
    """Do nothing; called now and then in long computations, so that Ctrl-C is noticed."""


@contextlib.contextmanager
def watching(one: Any, show: Callable[[float], Any] = ignore) -> Iterator[None]:
    """Let Ctrl-C interrupt the computation of a C object.

    ``show(t)`` is called several times a second with the current time, or the number of steps.
    """
    watch, context = getattr(lib, f"dal_{name_of(one)}_watch"), ffi.new_handle(show)
    watch(one, lib.dal_py_watch, context)
    try:
        yield
    finally:
        watch(one, ffi.NULL, ffi.NULL)


@_watching()
def dal_py_observer(step: int, t: float, x: Any, ctx: Any) -> int:
    call = _from_handle(ctx)
    answer = call.observer(step, t, *_halves(call, x))
    try:
        return bool(answer)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"observer returned {shown(answer)}: expected True to stop, else False or None"
        ) from error


@_watching()
def dal_py_control(step: int, t: float, x: Any, u: Any, ctx: Any) -> int:
    call = _from_handle(ctx)
    inputs = call.control(t, *_halves(call, x))
    shape = (call.bytes_of_inputs // 8,)
    if type(inputs) is not _ndarray or inputs.shape != shape:
        inputs = call.control_rows(inputs)
    _write(u, inputs, shape, "inputs")
    return 0


@_trampoline()
def dal_py_event(t: float, x: Any, g: Any, ctx: Any) -> int:
    call = _from_handle(ctx)
    value = call.g(t, *_halves(call, x))
    if isinstance(value, (bool, np.bool_)):
        raise ValueError(
            f"{call.name} returned {value}, a condition: expected a number that changes sign "
            "at the event, for example q[0] - 1 for q[0] > 1"
        )
    _write(g, value, (), call.name)
    return 0


@_trampoline()
def dal_py_reset(t: float, x: Any, ctx: Any) -> int:
    call = _from_handle(ctx)
    names = f"the reset of {call.name} (q)", f"the reset of {call.name} (v)"
    q, v = x, x + call.vector[0]
    _write_several((q, v), call.reset(*_halves(call, x)), call.vector, names)
    return 0


@_trampoline()
def dal_py_law(t: float, x: Any, values: Any, ctx: Any) -> int:
    call = _from_handle(ctx)
    _write(values, call.law(t, *_halves(call, x)), call.values, "an expression")
    return 0
