"""Functions in machine code: their addresses, from the packages that create them."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import arguments
from .extras import require
from .library import ffi

# Number of arguments of the callbacks of dalembert.h.
ARGUMENTS = {"potential": 6, "constraint": 8, "driven": 9, "lagrangian": 11, "force": 8}


@dataclass(frozen=True)
class Pointer:
    """A C function."""

    address: int
    owner: Any  # to be kept alive
    user_data: Any = None  # the ctx of a SciPy LowLevelCallable


def find(name: str, value: Any, callback: str | None = None) -> Pointer | None:
    """Return an argument ``name`` of `System` as C function; None if it is not one.

    ``callback`` is its type, one of `ARGUMENTS`; default: the type of its name.  Raises ValueError
    if the C function is NULL or is known to have another number of arguments.
    """
    found = _find(value)
    if found is None:
        return None
    pointer, arguments = found
    if pointer.address == 0:
        raise ValueError(f"{name} = {value!r}: the address of the C function is NULL")
    callback = callback or name
    if arguments is not None and arguments != ARGUMENTS[callback]:
        raise ValueError(
            f"{name} = {value!r}: the C function has {arguments} arguments, expected the "
            f"{ARGUMENTS[callback]} of dal_{callback}_fn in dalembert.h"
        )
    return pointer


def _find(value: Any) -> tuple[Pointer, int | None] | None:
    """Return a C function and its number of arguments, None if that is unknown."""
    if isinstance(value, ctypes._CFuncPtr):
        address = ctypes.cast(value, ctypes.c_void_p).value or 0
        told = value.argtypes
        return Pointer(address, value), None if told is None else len(told)
    if isinstance(value, _CData):
        kind = ffi.typeof(value) if _is_ours(value) else None
        told = None if kind is None or kind.kind != "function" else kind.args
        return Pointer(_address(value), value), None if told is None else len(told)
    if type(value).__name__ == "CFunc" and isinstance(getattr(value, "address", None), int):
        return Pointer(value.address, value), len(value._sig.args)  # numba.cfunc
    if type(value).__name__ == "LowLevelCallable" and isinstance(value, tuple):
        if _is_capsule(value.function):
            name = value.signature.encode() if value.signature else None
            return Pointer(_in_capsule(value.function, name), value, value.user_data), None
        if inner := _find(value.function):
            pointer, arguments = inner
            return Pointer(pointer.address, value, value.user_data), arguments
    return None


_CData = type(ffi.NULL)


def _is_ours(value: Any) -> bool:
    """Return whether this cffi knows the type of some cdata."""
    try:
        ffi.typeof(value)
    except TypeError:
        return False
    return True


def _is_capsule(value: Any) -> bool:
    return type(value).__name__ == "PyCapsule"


def _in_capsule(value: Any, name: bytes | None) -> int:
    """Return the address in a PyCapsule."""
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype, pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return int(pointer(value, name) or 0)


def numba_wanted() -> Any:
    """Return ``wanted(output)`` for numba functions: whether a pointer is not NULL.

    Numba has no such test, and a callback must not write to an output that is NULL.

    Raises
    ------
    ImportError
        If numba is not installed.

    Examples
    --------
    >>> from dalembert import pointers
    >>> wanted = pointers.numba_wanted()  # doctest: +SKIP
    """
    numba = require("numba", "a test for numba functions")
    from numba.extending import intrinsic

    @intrinsic
    def wanted(typing: Any, pointer: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            number = builder.ptrtoint(values[0], context.get_value_type(numba.types.intp))
            return builder.icmp_unsigned("!=", number, number.type(0))

        return numba.types.boolean(pointer), generate

    return wanted


def context(given: Any, pointers: Mapping[str, Pointer]) -> tuple[Any, Any]:
    """Return the ctx of the callbacks, and the object to keep alive.

    ``given`` is an array, an address, or a pointer of ctypes or cffi.  For None it is the ctx of
    the LowLevelCallables, which have to agree.
    """
    if given is None:
        told = {int(_address(p.user_data)) for p in pointers.values() if p.user_data is not None}
        if len(told) > 1:
            raise ValueError(
                "ctx: the callbacks have different user_data; expected the same for all"
            )
        return ffi.cast("void *", told.pop() if told else 0), dict(pointers)
    return ffi.cast("void *", _address(given)), (given, dict(pointers))


def _address(value: Any) -> int:
    if isinstance(value, np.ndarray):
        if not value.flags.c_contiguous:
            raise ValueError("ctx: expected a contiguous array")
        return int(value.ctypes.data)
    if isinstance(value, _CData):
        return int(ffi.cast("uintptr_t", value))
    if isinstance(value, int) and not isinstance(value, bool):
        return arguments.integer(value, "ctx", 0, 2 * sys.maxsize + 1)
    if isinstance(value, ctypes.Array | ctypes.Structure):
        return ctypes.addressof(value)
    if isinstance(value, ctypes._SimpleCData | ctypes._Pointer):
        return ctypes.cast(value, ctypes.c_void_p).value or 0
    if _is_capsule(value):
        return _in_capsule(value, None)
    raise ValueError(f"ctx = {value!r}: expected an array, an address, or a pointer")
