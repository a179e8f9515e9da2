"""A film as a self-contained page: the data of the run and the script that draws them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from ..core import Array, residual_bound
from . import web
from .bodies import ROLES, Shape
from .plot import ZERO
from .scene import Scene
from .stage import ARROWS, HEAD, arrow, clock, words_of

CURVE = 200  # stretches of a curve, with two points each


def html(scene: Scene, fps: float, trail: bool) -> str:
    """Return the film of a scene as a self-contained page."""
    web.require()
    run = scene.run
    about = f"{run.scheme.name}, {run._how}: {len(scene.t)} frames of {len(run.t)} states"
    if not run.success:
        about += f"; it ended early: {run.message}"
    data = _data(scene, fps, trail)
    return str(web.render("film.html", title=run.system.name, about=about, data=data))


def frame(scene: Scene, fps: float, trail: bool) -> web.HTML:
    """Return the page in a frame, as part of another page."""
    page = html(scene, fps, trail)
    return web.render("frame.html", title=scene.run.system.name, page=page)


def _data(scene: Scene, fps: float, trail: bool) -> str:
    """Return the data for the script of a page, as JSON that is safe in HTML."""
    run = scene.run
    low, span = scene.limits[0], np.ptp(scene.limits, axis=0)
    unit = 4000 / span.max()

    def whole(points: Array) -> list[int]:
        return [round(x) for x in ((points - low) * unit).ravel().tolist()]

    def sent(shapes: Iterable[Shape]) -> list[list[Any]]:
        size = HEAD * float(span.max())
        return [
            [ROLES.index(x.role), *whole(arrow(x.points, size))]
            if x.role in ARROWS
            else [ROLES.index(x.role), *whole(x.points)]
            for x in shapes
        ]

    words, written = words_of(scene), clock(scene)
    roles = {shape.role for shapes in scene.frames for shape in shapes}
    said = [role for role in ARROWS if role in roles]
    change = f"E − E₀ ({x})" if (x := run.system.unit("energy")) else "E − E₀"
    if not run.system.conserves_energy:
        change += ", no error here"
    below = "log₁₀ residual; roundoff is below the dashed line"
    residual = np.maximum(run.residual, ZERO)
    data = {
        "size": [round(x) for x in (span * unit).tolist()],
        "roles": ROLES,
        "fps": fps,
        "t": [float(f"{x:.9g}") for x in (scene.t - run.t[0]).tolist()],  # since the beginning
        "clock": [written(x) for x in scene.t.tolist()],
        "frames": [sent(shapes) for shapes in scene.frames],
        "trails": [whole(x) for x in scene.trails] if trail else [],
        "each": scene.per_frame,
        "ground": sent(scene.ground),
        "names": scene.names,
        "grid": [] if scene.in_space else _ticks(scene, whole),
        "key": [[ROLES.index(role), words[role]] for role in said],
        "squares": words["ground"] if scene.in_space else "",
        "curves": [
            _curve(change, run.t - run.t[0], run.energy - run.energy[0]),
            _curve(below, run.t - run.t[0], np.log10(residual), residual_bound(run.system.n)),
        ],
    }
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _ticks(scene: Scene, whole: Any) -> list[list[Any]]:
    """Return the lines of the grid: 0 for x or 1 for y, the coordinate, and the label."""
    found = []
    for axis in (0, 1):
        low, high = scene.limits[:, axis] / scene.grid
        for k in range(math.ceil(low), math.floor(high) + 1):
            place = np.tile(scene.limits[0], 1)
            place[axis] = k * scene.grid
            found.append([axis, whole(place[None])[axis], f"{k * scene.grid:.12g}"])
    return found


def _curve(name: str, t: Array, y: Array, bound: float | None = None) -> dict[str, Any]:
    """Return a curve for a page: the smallest and the largest value of each stretch."""
    if len(t) > 2 * CURVE:
        starts = np.linspace(0, len(t), CURVE, endpoint=False, dtype=int)
        pick = set()
        for a, b in zip(starts, [*starts[1:], len(t)]):
            pick |= {a + int(np.argmin(y[a:b])), a + int(np.argmax(y[a:b]))}
        rows = np.array(sorted(pick))
        t, y = t[rows], y[rows]
    good = np.isfinite(y)
    points = [[float(f"{a:.9g}"), float(f"{b:.4g}")] for a, b in zip(t[good], y[good])]
    return {"name": name, "points": points, "bound": bound and math.log10(bound)}
