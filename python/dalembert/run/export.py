"""Runs as tables and data sets of other packages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .. import core
from ..core import Array, arguments, extras
from ..core.documentation import Common
from .solution import Solution


def columns(run: Solution) -> tuple[list[tuple[str, str]], Array]:
    """Return columns: time, coordinates, velocities, multipliers, energy, residual.

    Each column has a name and the name of its quantity.  The first has an additional "_" if a
    coordinate has the same name.
    """
    names = run.system.coordinates
    quantities = ["t", *names, *(f"v_{name}" for name in names)]
    quantities += [*(f"lambda_{a}" for a in range(run.system.m)), "energy", "residual"]
    taken, head = {*names}, []
    for k, quantity in enumerate(quantities):
        name = quantity
        while name in taken and not 0 < k <= len(names):
            name += "_"
        taken.add(name)
        head.append((name, quantity))
    return head, np.column_stack([run.t, run.x, run.multipliers, run.energy, run.residual])


@Common("ImportError")
def to_pandas(run: Solution) -> Any:
    """Return the states as a ``pandas.DataFrame``, one row for each, with the time as index.

    Columns: the coordinates, their velocities ``v_...``, the multipliers ``lambda_0`` and so on,
    energy and residual.  If a coordinate has the same name as a quantity, the latter gets a "_", as
    in ``energy_``.  ``attrs["units"]`` has the known units by column.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.integrate(dal.systems.particle(), h=0.1, steps=10).to_pandas().shape
    (11, 9)
    """
    pandas = extras.require("pandas", "to_pandas")
    head, values = columns(run)
    names = [name for name, _ in head]
    frame = pandas.DataFrame(values[:, 1:], pandas.Index(run.t, name=names[0]), names[1:])
    units = {name: run.system.unit(name) for name, quantity in head if name == quantity}
    frame.attrs["units"] = {name: unit for name, unit in units.items() if unit}
    return frame


@Common("ImportError")
def to_xarray(run: Solution, units: Mapping[str, str] | None = None) -> Any:
    """Return the run as an ``xarray.Dataset``.

    The dimensions are time, coordinate, form (one for each constraint), and interval (the middles
    of the intervals between stored states).  A run with inputs also has input and hold.

    Parameters
    ----------
    units : mapping, optional
        Units as for `System`; default: the units of the system.  The units of time and energy
        become their attribute ``units``, the others the coordinate ``unit``.

    Examples
    --------
    >>> import dalembert as dal
    >>> data = dal.integrate(dal.systems.particle(), h=0.1, steps=10).to_xarray()
    >>> data.q.sel(coordinate="y").shape
    (11,)
    """
    xarray = extras.require("xarray", "to_xarray")
    names, along = run.system.coordinates, ("time", "coordinate")
    units = {**run.system.units, **arguments.units(units, names)}
    axes = {
        "q": (along, "coordinates"),
        "v": (along, "velocities, in units of the coordinates per unit of time"),
        "multipliers": (("time", "form"), "lambda(q, v) by the formula: forces"),
        "energy": ("time", "energy"),
        "constraint": (("time", "form"), "phi(q, v)"),
        "residual": ("time", "relative residual of the set that the scheme keeps"),
        "reactions": (("interval", "form"), "mean multipliers of the scheme: forces"),
    }
    coordinates: dict[str, Any] = {
        "time": ("time", run.t, {"long_name": "time", "units": units.get("t", "")}),
        "coordinate": list(names),
        "unit": ("coordinate", [units.get(name, "") for name in names]),
        "interval": (run.t[:-1] + run.t[1:]) / 2,
    }
    data = {
        name: (of, getattr(run, name), {"long_name": words})
        for name, (of, words) in axes.items()
    }
    if "energy" in units:
        data["energy"][2]["units"] = units["energy"]
    if run.system.inputs:
        applies = f"a time of {run.hold:g}" if run.control else f"{run.hold:g} steps"
        words = f"inputs of the force; a row applies for {applies}"
        data["inputs"] = (("hold", "input"), run.inputs, {"long_name": words})
        coordinates["input"] = list(run.system.inputs)
    return xarray.Dataset(
        data,
        coords=coordinates,
        attrs={
            "system": run.system.name,
            **{f"parameter_{key}": x for key, x in run.system.parameters.items()},
            "scheme": run.scheme.name,
            **{x: getattr(run, x) for x in ("nodes", "h", "stride", "status", "message")},
            **{f"control_{key}": x for key, x in run.control.items()},
            "dalembert": core.version(),
        },
    )
