"""The C library, with its texts and numbers in Python; the only module that imports `_core`."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from .._core import ffi as ffi
from .._core import lib as lib
from .arguments import Array as Array

ROUNDOFF = 2.0**-53  # the unit roundoff u


def version() -> str:
    """Return the version of the running C library."""
    return string(lib.dal_version())


def string(text: Any) -> str:
    """Return a C string, "" for NULL."""
    return ffi.string(text).decode("utf-8", "replace") if text != ffi.NULL else ""


def strings(texts: list[str]) -> tuple[Any, list[Any]]:
    """Return a ``const char *[]`` and the objects to keep alive with it."""
    kept = [ffi.new("char[]", text.encode()) for text in texts]
    return ffi.new("const char *[]", kept), kept


def pointer(array: Array, row: int = 0, count: int = 0, *, output: bool = False) -> Any:
    """Return the address of ``array[row]``; the caller keeps the array alive.

    C reads, or for an ``output`` writes, ``count`` doubles from there.  Raises ValueError if the
    array has fewer C-contiguous doubles from its row on, or is read-only for an ``output``.
    """
    if array.dtype != np.float64:
        raise ValueError(f"an array of {array.dtype}: expected float64")
    address = ffi.from_buffer("double[]", array, output)
    if row == count == 0:
        return address
    start = row * (array.size // max(len(array), 1)) if row else 0
    if not 0 <= start <= len(address) - count:
        raise ValueError(
            f"an array of shape {array.shape}: expected {count} numbers from row {row} on"
        )
    return address + start


def doubles(address: Any, count: int) -> Array:
    """Return a copy of ``count`` doubles."""
    return np.frombuffer(ffi.buffer(address, 8 * count)[:]).copy()


def members(record: Any) -> dict[str, Any]:
    """Return the members of a C record, given by its address."""
    return {name: getattr(record, name) for name in _names(ffi.typeof(record))}


@functools.cache
def _names(pointer_to: Any) -> tuple[str, ...]:
    """Return the names of the members of the type of a pointer."""
    return tuple(name for name, _ in pointer_to.item.fields)


def residual_bound(n: int) -> float:
    """Return 4 n u, the largest relative residual that is roundoff for n coordinates."""
    return 4 * n * ROUNDOFF


class Constant:
    """An object whose public attributes are set once, because C relies on them."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self.__dict__ and not name.startswith("_"):
            raise AttributeError(f"{type(self).__name__}.{name} cannot be changed")
        super().__setattr__(name, value)
