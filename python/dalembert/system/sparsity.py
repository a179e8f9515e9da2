"""The argument ``sparsity``: the entries of mu that may be nonzero."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core import arguments


class Sparsity(NamedTuple):
    """Rows and columns of the entries, both ascending, and the number of constraints."""

    rows: NDArray[np.uintp]
    columns: NDArray[np.uintp]
    m: int


_EXPECTED = (
    "expected an array of shape (m, n), nonzero where entries may be, a SciPy sparse array, "
    "or a tuple (rows, columns)"
)


def read(value: Any, n: int, m: int | None) -> Sparsity:
    """Return the given sparsity for n coordinates; raise ValueError if it is invalid."""
    shape: tuple[int, ...] = ()
    if hasattr(value, "tocoo"):
        shape, found = value.shape, value.tocoo()
        order = np.lexsort((found.col, found.row))
        rows, columns = found.row[order], found.col[order]
        new = np.append(True, (np.diff(rows) != 0) | (np.diff(columns) != 0))[: len(rows)]
        rows, columns = rows[new], columns[new]
    elif isinstance(value, tuple):
        rows, columns = _pair(value)
    else:
        given = np.asarray(value)
        if given.ndim != 2 or given.dtype.kind not in "biuf":
            raise ValueError(f"sparsity = {arguments.shown(value)}: {_EXPECTED}")
        shape, (rows, columns) = given.shape, np.nonzero(given)
    if shape and (len(shape) != 2 or shape[1] != n):
        raise ValueError(f"sparsity: expected shape (m, {n}), got {shape}")
    if m is None:
        m = shape[0] if shape else int(max(rows, default=-1)) + 1
    if shape and shape[0] != m:
        raise ValueError(f"sparsity: expected shape ({m}, {n}), got {shape}")
    return Sparsity(rows.astype(np.uintp), columns.astype(np.uintp), m)


def _pair(value: tuple[Any, ...]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return rows and columns of valid types; C checks their order."""
    both = [np.asarray(x) for x in value]
    if len(both) != 2 or any(
        x.ndim != 1 or (x.size and x.dtype.kind not in "iu") for x in both
    ):
        raise ValueError(f"sparsity = {arguments.shown(value)}: {_EXPECTED}")
    rows, columns = both
    if len(rows) != len(columns):
        raise ValueError(f"sparsity: {len(rows)} rows and {len(columns)} columns of entries")
    for name, x in (("row", rows), ("column", columns)):
        if x.size and x.min() < 0:
            raise ValueError(f"sparsity: {name} {x.min()} is negative")
    return rows, columns
