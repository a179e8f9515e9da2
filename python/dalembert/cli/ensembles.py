"""The command ``ensemble`` for many runs."""

from __future__ import annotations

import argparse
import contextlib
import functools
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from ..core import arguments, extras, files
from ..ensembles import Ensemble, ensemble, grid
from ..ensembles.spec import EnsembleOptions
from ..system import System
from . import runs

_GRID = (
    "values of a parameter, coordinate or velocity (v_NAME): N of them from A to B, or a list "
    "(repeatable)"
)


def add(commands: Any, numbers: Any, parameter: Any) -> None:
    """Add the command to a parser; ``numbers`` and ``parameter`` read arguments."""
    command = commands.add_parser(
        "ensemble", help="run a grid of parameters and initial data, on threads or a cluster",
        description="Integrate a system for all combinations of values, and print a summary.  "
        "With --store, repeat the same command after an interruption to resume.  The exit status "
        "is 1 if all members fail.",
    )  # fmt: skip
    add = command.add_argument
    add("model", metavar="MODEL", help=runs.MODEL)
    add("--grid", action="append", default=[], type=axis, metavar="NAME=A:B:N|X,Y,...", help=_GRID)
    add("--parameter", action="append", default=[], type=parameter, metavar="NAME=VALUE",
        help="set a parameter of all members (repeatable)")
    runs.add_options(command, EnsembleOptions, numbers)
    add("--executor", metavar="dask://HOST:PORT|processes[:N]", type=_executor,
        help="cluster or processes that run the members (default: threads of this process)")
    add("--output", type=Path, metavar="FILE", help="write the results to FILE.nc or FILE.npz")
    command.set_defaults(run=_run)


def axis(text: str) -> tuple[str, Any]:
    """Return the name and the values of an argument ``--grid``."""
    name, equal, values = text.partition("=")
    try:
        if values.count(":") == 2:
            low, high, count = values.split(":")
            found = np.linspace(float(low), float(high), arguments.integer(int(count), "N", 1))
        else:
            found = np.array([float(word) for word in values.split(",")])
    except ValueError:
        found = np.array([])
    if not equal or not name or not found.size:
        raise argparse.ArgumentTypeError(f"{text!r}; expected NAME=A:B:N or NAME=X,Y,...")
    return name, found


def _executor(text: str) -> str:
    scheme, _, rest = text.partition(":")
    if text.startswith("dask://") and len(text) > 7:
        return text
    if scheme == "processes" and (rest.isdigit() and int(rest) > 0 or not rest):
        return text
    raise argparse.ArgumentTypeError(f"{text!r}; expected dask://HOST:PORT or processes:N")


@contextlib.contextmanager
def _workers(text: str | None) -> Iterator[Any]:
    """Provide an executor, or None for threads."""
    if text is None:
        yield None
    elif text.startswith("dask://"):
        distributed = extras.require("distributed", "--executor dask://...")
        with distributed.Client(f"tcp://{text.removeprefix('dask://')}", timeout="10s") as client:
            yield client.get_executor(pure=False)
    else:
        count = int(text.partition(":")[2] or 0) or None
        yield functools.partial(ProcessPoolExecutor, count)


def _given(system: System, given: argparse.Namespace) -> tuple[Any, Any, Any, Any]:
    """Return q0, v0 and parameters of all members, from the grid, and its axes."""
    axes: dict[str, Any] = {}
    for name, values in given.grid:
        if name in axes:
            raise ValueError(f"--grid {name} is given more than once: expected once")
        axes[name] = values
    if not axes:
        raise ValueError("--grid is missing: give at least one, for example --grid a=0:1:50")
    design = grid(**axes)
    places = (*system.coordinates, *(f"v_{name}" for name in system.coordinates))
    for name in axes:
        if any(name == other for other, _ in given.parameter):
            raise ValueError(f"{name} is given by --parameter and by --grid: expected one of them")
        arguments.choice(name, "--grid", dict.fromkeys((*system.parameters, *places), 0))
    chosen = {name: design.compact(name) for name in axes if name in system.parameters}
    moved = [name for name in axes if name not in system.parameters]
    if not moved:
        return given.q0, given.v0, design, axes
    arguments.pair(given.q0, given.v0, ("--q0", "--v0"), " for those of the system")
    start = (given.q0, given.v0) if given.q0 is not None else (system.q0, system.v0)
    if start[0] is None:
        raise ValueError(
            f"--q0 and --v0 are missing: the system {system.name!r} has no default initial data"
        )
    x = np.broadcast_to(np.concatenate(start), (*design.shape, 2 * system.n)).copy()
    for name in moved:
        x[..., places.index(name)] = design[name]
    return x[..., : system.n], x[..., system.n :], chosen, axes


def _run(given: argparse.Namespace) -> int:
    system = runs.model(given.model, runs.parameters(given))
    if given.output is not None:
        if given.output.suffix not in (".nc", ".npz"):
            raise ValueError(f"--output {given.output}: expected a name that ends in .nc or .npz")
        files.require_writable(given.output)
    of_members = dict(zip(("q0", "v0", "parameters", "axes"), _given(system, given)))
    try:
        with _workers(given.executor) as executor:
            found = ensemble(
                system, **runs.options(given, EnsembleOptions) | of_members
                | {"executor": executor, "progress": runs.progress()},
            )  # fmt: skip
    except KeyboardInterrupt:
        if given.store is not None:
            print(f"{given.store} has the results so far; to resume, repeat the same command",
                  file=sys.stderr)  # fmt: skip
        raise
    print(found)
    if given.output is not None:
        _write(found, given.output)
    elif given.store is None:
        print("not saved: add --output FILE.nc", file=sys.stderr)
    return int(not found.success.any())


def _write(found: Ensemble, path: Path) -> None:
    """Write the results."""
    if path.suffix == ".nc":
        dataset = found.to_xarray()
        dataset["doubtful"] = dataset.doubtful.astype("int8")  # netCDF has no truth values
        dataset.to_netcdf(path, engine="h5netcdf")
    else:
        np.savez(path, **{name: found[name] for name in found}, **{
            f"parameter_{name}": x for name, x in found.parameters.items()
        })  # fmt: skip
