"""Runs in files: NumPy and netCDF, both ways; comma separated values; and journals."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from .. import core
from ..core import Array, extras, files
from ..system import System
from .export import columns, to_xarray
from .journal import Journal, is_journal, of_system, require_same
from .scheme import Scheme
from .solution import Solution, Statistics

SUFFIXES = (".npz", ".nc", ".csv")

_ARRAYS = ("x", "reactions", "inputs", "times")
_NUMBERS = ("t0", "h", "stride", "hold", "control", "status", "message")


def require_suffix(path: Path) -> None:
    """Raise ValueError if the suffix of a name is not that of a supported format."""
    if path.suffix not in SUFFIXES:
        raise ValueError(f"path = {str(path)!r}: expected a name that ends in .npz, .nc or .csv")


def save(run: Solution, path: str | os.PathLike[str]) -> None:
    """Write the run to a file, completely or not at all.

    ``.npz`` (NumPy) and ``.nc`` (netCDF-4) contain the complete run, without code;
    ``dalembert.load`` reads them.  ``.nc`` contains the data of `to_xarray`, for xarray, h5py,
    Julia or MATLAB.  ``.csv`` has the columns of `to_pandas`.

    Parameters
    ----------
    path : str or path
        The file; its suffix determines the format.

    Raises
    ------
    ValueError
        If the suffix is another.
    OSError
        If the file cannot be written; an existing file is then unchanged.
    ImportError
        For ``.nc``, if xarray or h5netcdf is not installed.

    Examples
    --------
    >>> import os, tempfile
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.particle(), h=0.1, steps=10)
    >>> run.save(os.path.join(tempfile.mkdtemp(), "run.csv"))
    """
    target = Path(os.fsdecode(path))
    require_suffix(target)
    files.require_writable(target)
    if target.suffix == ".csv":
        content = _csv(run)
    elif target.suffix == ".npz":
        buffer = io.BytesIO()
        np.savez(buffer, about=np.array(json.dumps(_about(run))), **_pack(run))
        content = buffer.getvalue()
    else:
        _require_netcdf()
        data = to_xarray(run)
        packed = {name: x for name, x in _pack(run).items() if x.size}
        stored = {
            f"stored_{name}": ([f"{name}_{i}" for i in range(x.ndim)], x)
            for name, x in packed.items()
        }
        data = data.assign(stored).assign_attrs(about=json.dumps(_about(run)))
        content = bytes(data.to_netcdf(engine="h5netcdf"))
    files.replace(target.resolve(), content)


def load(
    path: str | os.PathLike[str], system: System | None = None, scheme: Scheme | None = None
) -> Solution:
    """Return the run in a file of `Solution.save` or in a journal, without computing anything.

    The states of a journal are memory-mapped.

    Parameters
    ----------
    path : str or path
    system : System, optional
        The system of the run; not needed if it comes with the library.
    scheme : Scheme, optional
        The scheme of the run; required if it contains code, such as your own maps.

    Raises
    ------
    ValueError
        If the file is not a run, or belongs to another system.  The message says which.
    OSError
        If the file does not exist, or cannot be read.

    Warns
    -----
    DalembertWarning
        If the end of a journal is damaged.

    Examples
    --------
    >>> import os, tempfile
    >>> import dalembert as dal
    >>> path = os.path.join(tempfile.mkdtemp(), "run.npz")
    >>> run = dal.integrate(dal.systems.sleigh(), h=0.01, t_end=1)
    >>> run.save(path)
    >>> bool((dal.load(path).x == run.x).all())
    True
    """
    target = Path(os.fsdecode(path))
    if is_journal(target):
        journal = Journal.open(path)
        try:
            return journal.solution(system, scheme)
        finally:
            journal.close()
    with open(target, "rb") as file:
        start = file.read(8)
    try:
        if start.startswith(b"PK"):
            with zipfile.ZipFile(target) as archive:
                if archive.testzip() is not None:
                    raise zipfile.BadZipFile
            with np.load(target, allow_pickle=False) as found:
                about, arrays = json.loads(str(found["about"])), dict(found)
        elif start == b"\x89HDF\r\n\x1a\n":
            with _require_netcdf().open_dataset(target, engine="h5netcdf") as data:
                about = json.loads(data.attrs["about"])
                arrays = {
                    str(name).removeprefix("stored_"): x.to_numpy()
                    for name, x in data.items()
                    if str(name).startswith("stored_")
                }
        else:
            raise KeyError
        arrays["x"], about["system"]
    except (KeyError, TypeError, json.JSONDecodeError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(
            f"{target}: expected the journal of a run or a saved run, or the file is damaged"
        ) from error
    if scheme is None and about["scheme"] is None:
        raise ValueError(f"scheme is missing: the scheme of {target} is made of functions; pass it")
    found = require_same(system, about["system"], str(target))
    return _unpack(about, arrays, found, scheme or Scheme._from_data(about["scheme"]))


def _require_netcdf() -> Any:
    """Return xarray; raise ImportError unless it and its requirements are installed."""
    for module in ("h5py", "h5netcdf"):
        extras.require(module, "a file .nc")
    return extras.require("xarray", "a file .nc")


# ---- a run as arrays and data --------------------------------------------------------------------


def _about(run: Solution) -> dict[str, Any]:
    """Return the data of a run other than arrays, for JSON."""
    return {
        "dalembert": core.version(),
        "system": of_system(run.system, run.x[0], float(run.t[0])),
        "scheme": run.scheme._data(),
        "stats": dataclasses.asdict(run.stats),
        "events": len(run.t_events),
        **{name: getattr(run, name) for name in _NUMBERS},
    }


def _pack(run: Solution) -> dict[str, Array]:
    """Return the arrays that define the run, and its times."""
    found = {name: getattr(run, name) for name in _ARRAYS}
    for k in range(len(run.t_events)):
        for name in ("t_events", "x_events", "x_after"):
            found[f"{name}_{k}"] = getattr(run, name)[k]
    return {"t": run.t} | {name: np.asarray(x) for name, x in found.items() if x is not None}


def _unpack(
    about: dict[str, Any], arrays: dict[str, Array], system: System, scheme: Scheme
) -> Solution:
    """Return the run; missing arrays are empty."""
    n, m = system.n, system.m
    rows = len(arrays["x"])
    given: dict[str, Any] = {name: arrays.get(name) for name in _ARRAYS}
    if given["reactions"] is None:
        given["reactions"] = np.zeros((rows - 1, m))
    widths = {"t_events": (0,), "x_events": (0, 2 * n), "x_after": (0, 2 * n)}
    for name, shape in widths.items():
        events = range(about["events"])
        given[name] = tuple(arrays.get(f"{name}_{k}", np.zeros(shape)) for k in events)
    stats = {k: tuple(v) if isinstance(v, list) else v for k, v in about["stats"].items()}
    return Solution(
        system=system, scheme=scheme, stats=Statistics(**stats),
        **given, **{name: about[name] for name in _NUMBERS},
    )  # fmt: skip


def _csv(run: Solution) -> bytes:
    """Return the columns with 17 digits, which reproduce the doubles exactly."""
    (head, values), text = columns(run), io.StringIO()
    csv.writer(text, lineterminator="\n").writerow([name for name, _ in head])
    np.savetxt(text, values, "%.17g", ",")
    return text.getvalue().encode()
