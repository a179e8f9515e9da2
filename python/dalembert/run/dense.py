"""Dense output: the polynomials of the steps of a run."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from .. import core
from ..core import Array, ffi, lib
from ..system import System
from .scheme import Scheme


class Dense:
    """The polynomials of the steps of a run by "taylor".

    ``run(t)`` takes its states from them.  Files and copies of a run in other processes have none;
    there ``run(t)`` makes a step of the scheme for each time.

    Attributes
    ----------
    count : int
        The number of polynomials.
    nbytes : int
        Their memory.
    span : tuple of float
        The times where the run begins and ends.

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.sleigh(), "taylor", t_end=10, dense=True)
    >>> run([0.1, 0.2, 0.3]).q.shape
    (3, 3)
    >>> run.dense.count < 30
    True
    """

    def __init__(self, system: System, scheme: Scheme) -> None:
        if scheme.family != "taylor":
            raise ValueError(
                f"dense = True: not used with the scheme {scheme.name!r}; take the scheme 'taylor'"
            )
        record, kept = scheme._record_of(system)
        handle = scheme._stepped(system)._handle
        self.span, self._size = (0.0, 0.0), 2 * system.n
        self._handle = core.make(
            "taylor_dense", handle, record, owner=(handle, kept)
        )

    def __reduce__(self) -> Any:
        return type(None), ()

    def __repr__(self) -> str:
        return f"<Dense: {self.count} polynomials, {self.nbytes / 1e6:.3g} MB>"

    @property
    def count(self) -> int:
        return int(lib.dal_taylor_dense_count(self._handle, ffi.NULL))

    @property
    def nbytes(self) -> int:
        size = ffi.new("size_t *")
        lib.dal_taylor_dense_count(self._handle, size)
        return int(size[0])

    @contextlib.contextmanager
    def keeping(self, stepper: Any) -> Iterator[None]:
        """Keep the polynomials of a ``dal_stepper``."""
        core.check(lib.dal_taylor_keep(stepper, self._handle), stepper)
        try:
            yield
        finally:
            lib.dal_taylor_keep(stepper, ffi.NULL)

    def states(self, times: Array) -> Array:
        """Return the states at times of the run, shape (N, 2n)."""
        low, high = sorted(self.span)
        slack = 4 * np.spacing(np.maximum(np.abs(times), max(abs(low), abs(high))))
        outside = (times < low - slack) | (times > high + slack)
        if outside.any():
            t = float(times[outside][0])
            raise ValueError(f"t = {t!r}: expected times from {self.span[0]!r} to "
                             f"{self.span[1]!r}")  # fmt: skip
        times = np.clip(times, low, high)
        x = np.empty((len(times), self._size))
        for first in range(0, len(times), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            status = lib.dal_taylor_dense_states(
                self._handle, len(times[some]), core.pointer(times[some]),
                core.pointer(x[some], output=True),
            )  # fmt: skip
            core.check(status, self._handle)
        return x


_AT_ONCE = 2**16  # times of one call of C, after which Ctrl-C is noticed
