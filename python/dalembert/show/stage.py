"""A film on Matplotlib axes: the ground, shapes, trails, and the key of the arrows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..core import Array, extras
from . import web
from .bodies import ROLES, Shape
from .palette import LIGHT
from .plot import Axes, axes_for, plain
from .scene import Scene

ARROWS = ("velocity", "reaction")
HEAD = 0.035  # of an arrow, in sizes of the picture

_LINES: dict[str, dict[str, Any]] = {
    "ground": {"color": LIGHT["ground"], "linewidth": 0.8},
    "bar": {"color": LIGHT["bar"], "linewidth": 1.6},
    "blade": {"color": LIGHT["vermilion"], "linewidth": 3.6, "capstyle": "butt"},
    "dot": {"color": LIGHT["ink"], "marker": "o", "markersize": 4, "linestyle": "none"},
    "velocity": {"color": LIGHT["blue"], "linewidth": 1.6},
    "reaction": {"color": LIGHT["purple"], "linewidth": 2.0},
}
# The colour, and the width of the edge.
_FILLS = {"plane": (LIGHT["green"], 0.8), "body": (LIGHT["blue"], 1.4)}


def arrow(points: Array, size: float) -> Array:
    """Return an arrow as one line: shaft, and a head of this size, smaller for a short arrow."""
    tail, tip = points
    along = tip - tail
    length = float(np.hypot(*along))
    if length == 0:
        return points
    back = along / length * min(size, 0.5 * length)
    side = 0.5 * np.array([-back[1], back[0]])
    return np.array([tail, tip, tip - back + side, tip, tip - back - side])


def draw(ax: Axes, shapes: Sequence[Shape], size: float, alpha: float = 1.0) -> list[Any]:
    """Draw shapes on axes, one artist for each role; return the artists."""
    from matplotlib import collections, colors

    found: list[Any] = []
    for role in ROLES:
        points = [shape.points for shape in shapes if shape.role == role]
        if not points:
            continue
        if role == "dot":
            found += ax.plot(*np.concatenate(points).T, alpha=alpha, **_LINES[role])
            continue
        if role in _FILLS:
            colour, width = _FILLS[role]
            piece: Any = collections.PolyCollection(
                points, linewidths=width, edgecolors=colors.to_rgba(colour, alpha),
                facecolors=colors.to_rgba(colour, 0.2 * alpha),
            )  # fmt: skip
        else:
            if role in ARROWS:
                points = [arrow(x, HEAD * size) for x in points]
            piece = collections.LineCollection(points, alpha=alpha, **_LINES[role])
        piece.set_zorder(2)
        found.append(ax.add_collection(piece, autolim=False))
    return found


def draw_trails(ax: Axes, trails: Sequence[Array]) -> list[Any]:
    from matplotlib.collections import LineCollection

    lines = LineCollection(trails, color=LIGHT["blue"], linewidth=1.1, alpha=0.75, zorder=2)
    return [ax.add_collection(lines, autolim=False)]


def stage(scene: Scene, ax: Axes | None, *, shown: bool = False) -> Axes:
    """Return axes with limits and ground: the given ones, or those of a new figure.

    A new figure is registered with pyplot only if it is ``shown`` to the user.
    """
    limits = scene.limits
    span = limits[1] - limits[0]
    if ax is None:
        width, margin, top, bottom = 4.8, 0.42, 0.3, 0.55
        if scene.in_space:
            margin, bottom = 0.1, 0.35
        inner = width - 2 * margin
        high = float(np.clip(inner * span[1] / span[0], 1.8, 4.6))
        height = round((high + top + bottom) * 50) / 50  # an even number of pixels
        high = height - top - bottom
        # The colours of a film are for a white ground, whatever the user's style is.
        with web.default_style():
            if shown:
                figure = extras.require("matplotlib.pyplot", "a picture").figure(
                    figsize=(width, height)
                )
            else:
                figure = web.figure(width, height, layout=None)
            ax = figure.add_axes((margin / width, bottom / height, inner / width, high / height))
        # The axes fill their place: more is seen above and below, or at the sides.
        box = np.array([inner, high])
        limits = limits.mean(axis=0) + np.outer([-0.5, 0.5], box * (span / box).max())
    ax = axes_for(ax)
    if ax.name != "rectilinear":
        raise ValueError(f"ax has the projection {ax.name!r}: expected plane axes")
    ax.set(xlim=limits[:, 0], ylim=limits[:, 1], autoscale_on=False)
    ax.set_aspect("equal", adjustable="box")
    ax.set_title(plain(scene.run.system.name), loc="left", fontsize="medium")
    for spine in ax.spines.values():
        spine.set_visible(False)
    ax.tick_params(length=0, labelsize="small", labelcolor="0.45")
    if scene.in_space:
        ax.set(xticks=[], yticks=[])
    else:
        from matplotlib.ticker import MultipleLocator

        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(MultipleLocator(scene.grid))
        ax.grid(color="0.92", linewidth=0.8)
        ax.set_axisbelow(True)
        labels = ax.get_xlabel(), ax.get_ylabel()
        for name, label, (x, y) in zip(scene.names, labels, ((0.99, 0.01), (0.01, 0.99))):
            if label:
                continue
            where = {"ha": "right", "va": "bottom"} if x > y else {"ha": "left", "va": "top"}
            ax.text(
                x, y, plain(name), transform=ax.transAxes, color="0.45", fontsize="small", **where
            )
    draw(ax, scene.ground, float(span.max()))
    _key(scene, ax)
    return ax


def _key(scene: Scene, ax: Axes) -> None:
    """Write the meaning of the arrows below the axes."""
    roles = {shape.role for shapes in scene.frames for shape in shapes}
    words = words_of(scene)
    entries = [
        (ax.plot([], [], **_LINES[role])[0], plain(words[role])) for role in ARROWS if role in roles
    ]
    if scene.in_space:
        entries.append((ax.plot([], [], **_LINES["ground"])[0], plain(words["ground"])))
    if entries:
        below = (
            0.0 if scene.in_space else -0.18 / (ax.get_position().height * ax.figure.bbox.height)
            * ax.figure.dpi
        )
        ax.legend(
            *zip(*entries), loc="upper center", bbox_to_anchor=(0.5, below), ncols=3,
            frameon=False, fontsize="small", labelcolor=ax.title.get_color(),
            handlelength=1.2, columnspacing=1.2, borderaxespad=0.2,
        )  # fmt: skip


def words_of(scene: Scene) -> dict[str, str]:
    """Return the texts of the legend."""
    force = f"reaction: length 1 is a force of {scene.scale or 0:g}"
    length = scene.unit(scene.run.system.coordinates[scene.columns[0]])
    squares = f"squares of {scene.grid:g}{length}"
    return {"velocity": "velocity", "reaction": force, "ground": squares}


def clock(scene: Scene) -> Callable[[float], str]:
    """Return a function that formats a time with enough digits to distinguish frames."""
    gaps = np.abs(np.diff(scene.t))
    gap = float(gaps[gaps > 0].min()) if gaps.any() else 0.01
    digits = max(1, math.ceil(-math.log10(gap)))
    form = f".{digits}f" if digits <= 6 else f".{digits + 2}g"
    unit = scene.unit("t")
    return lambda t: f"t = {t:{form}}{unit}"
