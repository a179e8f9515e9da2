"""The available memory of this machine."""

from __future__ import annotations

import contextlib
import os
import sys


def available_memory() -> int:
    """Return the bytes available without swapping, as far as the machine reports them."""
    with contextlib.suppress(OSError, StopIteration, ValueError):
        with open("/proc/meminfo", encoding="ascii") as lines:
            line = next(line for line in lines if line.startswith("MemAvailable:"))
        return int(line.split()[1]) * 1024
    with contextlib.suppress(AttributeError, OSError, ValueError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return sys.maxsize


def require_memory(size: int, what: str, advice: str) -> None:
    """Raise MemoryError if so many bytes for ``what`` do not fit, before any allocation."""
    if size > 2**24 and size > (memory := available_memory()):  # which takes a while to ask
        raise MemoryError(
            f"{what} need {size} bytes ({size / 2**30:.4g} GiB), and this machine has "
            f"{memory / 2**30:.4g} GiB: {advice}"
        )
