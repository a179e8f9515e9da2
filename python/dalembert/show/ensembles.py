"""Plots of ensembles: end states, basins, bands; and their display in a notebook."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core import Array, arguments, extras
from ..core.documentation import Common
from ..ensembles import Ensemble
from .palette import COLOURS, FAILED, GROUND
from .plot import Axes, axes_for, plain, with_unit
from . import web
from .table import Table

_BANDS = ((5, 95, 0.2), (25, 75, 0.35))  # percentiles, and how dense they are drawn


@Common("ValueError, ImportError")
def draw(
    self: Ensemble, what: str | None = None, ax: Axes | None = None, *, y: str | None = None
) -> Axes:
    """Draw the ensemble; failed members are omitted, or grey.

    Results over time are drawn as bands of ``what``: the median, and the ranges that contain half
    and nine tenths of the members.  For a grid with two axes the plot is a map of ``what`` at the
    end.  Otherwise it shows the end states, ``y`` over ``what``.

    Parameters
    ----------
    what : str, optional
        A coordinate, a velocity ("v_theta"), or another scalar result.  Default: the first
        coordinate; for a grid with events, the number of the event that ended each member.
    y : str, optional
        Vertical axis for end states; default: the second coordinate.

    Examples
    --------
    >>> import dalembert as dal
    >>> many = dal.ensemble(dal.systems.sleigh(), parameters={"a": [0.1, 0.2]}, h=0.01, steps=100,
    ...                     keep="all", stride=10, progress=False)
    >>> many.plot("theta").get_ylabel()
    'theta'
    """
    if what is None:
        what = "ended_by" if "ended_by" in self and len(self.shape) == 2 else _first(self)
    ax = axes_for(ax)
    if self.stride > 0 and what not in ("ended_by", "t_end", "done"):
        _bands(self, what, ax)
    elif len(self.shape) == 2 and y is None:
        _map(self, what, ax)
    else:
        second = self.system.coordinates[min(1, self.system.n - 1)] if "q" in self else what
        _states(self, what, second if y is None else y, ax)
    ax.set_title(plain(f"{self.system.name}: {len(self)} runs, {self.scheme.name}"))
    return ax


def _first(found: Ensemble) -> str:
    """Return the name of a quantity that can be drawn."""
    if "q" in found:
        return found.system.coordinates[0]
    return found.kept[0] if found.kept else "t_end"


def values_of(found: Ensemble, name: str) -> Array:
    """Return one number for each member or row; raise ValueError for other quantities."""
    places = (*found.system.coordinates, *(f"v_{x}" for x in found.system.coordinates))
    if name not in found and name in places and "q" in found:
        k = places.index(name)
        return found["q" if k < found.system.n else "v"][..., k % found.system.n]
    arguments.choice(name, "what", dict.fromkeys((*found, *places), 0))
    values = np.asarray(found[name])
    if values.ndim > 1 + (found.stride > 0 and name != "happened"):
        raise ValueError(f"what = {name!r}: expected a quantity with one number for each member")
    return values


def _label(found: Ensemble, name: str, at: str = "") -> str:
    of = name
    if name not in found.system.coordinates:  # a parameter may have any name
        of = "" if name in found.system.parameters else {"t_end": "t", "h": "t"}.get(name, name)
    return with_unit(f"{name}{at}", [found], of)


def _bands(found: Ensemble, what: str, ax: Axes) -> None:
    values, t = values_of(found, what), found.t
    good = np.isfinite(values).any(axis=1)
    t = t if t.ndim == 1 else t[np.flatnonzero(good)[0]]
    for low, high, dense in _BANDS:
        edges = np.nanpercentile(values[good], (low, high), axis=0)
        ax.fill_between(t[: values.shape[1]], *edges, color=COLOURS[0], alpha=dense, linewidth=0,
                        label=f"{high - low} % of the members")  # fmt: skip
    ax.plot(t[: values.shape[1]], np.nanmedian(values[good], axis=0), color=COLOURS[0],
            label="median")  # fmt: skip
    ax.set(xlabel=_label(found, "t"), ylabel=_label(found, what))
    ax.legend(frameon=False, fontsize="small")


def _map(found: Ensemble, what: str, ax: Axes) -> None:
    values = values_of(found, what).astype(float).reshape(found.shape)
    values[~found.success.reshape(found.shape)] = np.nan
    x, y = (found.ticks.get(name, np.arange(size)) for name, size in zip(found.axes, found.shape))
    whole = what in ("ended_by",)
    colors: Any = None
    if whole:
        colors = extras.require("matplotlib.colors", "a picture").ListedColormap(
            [GROUND, *COLOURS[: max(1, int(np.nanmax(values)) + 1)]]
        )
    limits = {"vmin": -1.5, "vmax": colors.N - 1.5} if whole else {}
    ax.set_facecolor(FAILED)
    mesh = ax.pcolormesh(x, y, values.T, cmap=colors, shading="nearest", rasterized=True, **limits)
    bar = ax.figure.colorbar(mesh, ax=ax)
    if whole:
        events = [f"event {k}" for k in range(colors.N - 1)]
        bar.set_ticks(range(-1, colors.N - 1), labels=["none", *events])
        bar.set_label("event that ended the run")
    else:
        bar.set_label(_label(found, what, " at the end"))
    ax.set(xlabel=_label(found, found.axes[0]), ylabel=_label(found, found.axes[1]))


def _states(found: Ensemble, x: str, y: str, ax: Axes) -> None:
    first, second = (values_of(found, name) for name in (x, y))
    varied = [name for name, values in found.parameters.items() if len(np.unique(values)) > 1]
    colour: Any = {"color": COLOURS[0]}
    if len(varied) == 1:
        colour = {"c": found.parameters[varied[0]]}
    points = ax.scatter(first, second, s=max(2.0, 40.0 / len(found) ** 0.25), linewidth=0, **colour)
    if len(varied) == 1:
        ax.figure.colorbar(points, ax=ax).set_label(_label(found, varied[0]))
    ax.set(xlabel=_label(found, x, " at the end"), ylabel=_label(found, y, " at the end"))


# ---- notebooks ---------------------------------------------------------------------------------


def page(self: Ensemble) -> str | None:
    """Return the ensemble for a notebook: arguments, outcome and results."""
    status = self["status"]
    shape = " × ".join(map(str, self.shape))
    rows = [
        ["members", f"{len(self)}" if len(self.shape) == 1 else f"{len(self)} ({shape})"],
        ["completed", str(int((status == 0).sum()))],
        ["failed", str(len(self.failed))],
        ["not finished", str(len(self.unfinished))],
        ["doubtful", str(int(self["doubtful"].sum()))],
        *(
            [name, f"{x.min():g} .. {x.max():g}"] for name, x in self.parameters.items()
        ),
        ["kept", ", ".join(self.kept)],
    ]  # fmt: skip
    first = [[f"member {k}", self.message(int(k))] for k in self.failed[:5]]
    title = f"{self.system.name} by {self.scheme.name}"
    return web.notebook([("", "", Table(["Ensemble", title], [*rows, *first], 2, style="facts"))])
