"""The content of a film: states of a run at any time, shapes, and the projection of space.

Lines and polygons in the plane of the film are computed once.  Matplotlib draws them in stage.py,
and the script of a page in film_page.py.
"""

from __future__ import annotations

import contextlib
import math
import operator
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..core import Array, arguments
from ..run import Solution
from . import bodies
from .bodies import ROLES, Body, Shape
from .plot import require_kind

TRAIL = 600, 5000  # points of a trail: at least, and at most unless there are more frames
LONGEST = 0.22  # of an arrow, in sizes of the picture


# ---- states of a run at any time -----------------------------------------------------------------


def _states(run: Solution, t: Array) -> tuple[Array, Array]:
    """Return times and states there, at the requested times or of the nearest stored states.

    Nearest stored states are used for a run with ``t_eval``, around a reset, and before a terminal
    event.
    """
    order = np.argsort(run.t, kind="stable")
    stored = run.t[order]
    after = np.searchsorted(stored, t).clip(1 if len(stored) > 1 else 0, len(stored) - 1)
    before = np.maximum(after - 1, 0)
    near = order[np.where(t - stored[before] < stored[after] - t, before, after)]
    times, x = run.t[near], run.x[near]
    pieces = []
    with contextlib.suppress(ValueError):  # of times that lie in no piece, which are left
        for piece in run._pieces(t):
            pieces.append(piece)
    for first, rows, these in pieces:
        x[these] = run._interpolate(t[these], first, rows)[0]
        times[these] = t[these]
    x.flags.writeable = False  # a body sees views
    return times, x


# ---- how space is seen ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Camera:
    """A perspective view from above of a point, from a distance."""

    centre: Array
    distance: float
    azimuth: float = math.radians(-60)
    elevation: float = math.radians(24)

    def __call__(self, points: Array) -> Array:
        """Project points to the plane through the centre."""
        c, s = math.cos(self.azimuth), math.sin(self.azimuth)
        low, high = math.cos(self.elevation), math.sin(self.elevation)
        right = np.array([-s, c, 0])
        up = np.array([-high * c, -high * s, low])
        near = np.array([low * c, low * s, high])
        at = _lifted(points) - self.centre
        depth = self.distance / np.maximum(self.distance - at @ near, 1e-3 * self.distance)
        return np.column_stack([at @ right, at @ up]) * depth[:, None]


def _round_number(x: float) -> float:
    """Return the largest of 1, 2 or 5 times a power of 10 that is at most x > 0."""
    power = 10.0 ** math.floor(math.log10(x))
    return power * max(k for k in (1, 2, 5) if k * power <= x * (1 + 1e-9))


def _floor(points: Array) -> tuple[list[Shape], float]:
    """Return a grid below points in space, shape (K, 3), and the side of its squares."""
    low, high = points.min(axis=0), points.max(axis=0)
    step = _round_number(float((high - low)[:2].max() or 1.0) / 5)
    (x0, y0), (x1, y1) = np.floor(low[:2] / step), np.ceil(high[:2] / step)
    xs, ys = (step * np.arange(a, b + 1) for a, b in ((x0, max(x1, x0 + 1)), (y0, max(y1, y0 + 1))))
    z = low[2]
    lines = [[(x, ys[0], z), (x, ys[-1], z)] for x in xs]
    lines += [[(xs[0], y, z), (xs[-1], y, z)] for y in ys]
    return [Shape("ground", ends) for ends in lines], step


# ---- what is drawn -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Scene:
    """All frames of a film, and the data for further frames."""

    run: Solution
    body: Body
    columns: tuple[int, ...]
    t: Array  # of the frames
    frames: list[list[Shape]]
    trails: list[Array]  # in the plane of the picture, shape (P, 2) each
    per_frame: int  # points of a trail from one frame to the next
    ground: list[Shape]
    grid: float  # sides of the squares of the ground
    scale: float | None  # units of force for one of length
    look: Any  # from space to the plane
    limits: Array  # shape (2, 2): lowest and highest x and y
    names: list[str]  # of the axes in the plane, if they are known

    @property
    def in_space(self) -> bool:
        return self.look is not _flat

    def unit(self, name: str) -> str:
        """Return a unit to put after a number, or ""."""
        return f" {unit}" if (unit := self.run.system.unit(name)) else ""

    def shapes(self, t: float) -> tuple[float, list[Shape]]:
        """Return the time and the shapes of one frame."""
        times, x = _states(self.run, np.array([t]))
        found = list(self.body(float(times[0]), *np.split(x[0], 2)))
        if self.scale:
            found += arrows(found, forces_at(self.run, times, x, self.columns)[0], self.scale)
        return float(times[0]), _seen(found, self.look)


def _flat(points: Array) -> Array:
    return points


def _seen(shapes: Iterable[Shape], look: Any) -> list[Shape]:
    """Return shapes in the plane of the film, in drawing order."""
    found = [replace(shape, points=look(shape.points)) for shape in shapes]
    return sorted(found, key=lambda shape: ROLES.index(shape.role))


def forces_at(run: Solution, t: Array, x: Array, columns: Sequence[int]) -> Array:
    """Return the reaction of each constraint as a force, shape (N, m, number of columns)."""
    q, v = np.split(x, 2, axis=1)
    inputs = run._inputs_at(t)
    multipliers = run.system.multipliers(q, v, t=t, inputs=inputs if inputs.size else None)
    return np.asarray(multipliers[:, :, None] * bodies.forms(run, t, q, v, columns))


def _contacts(shapes: Iterable[Shape]) -> list[Shape]:
    """Return the shapes with reactions; these leave a trail."""
    return [shape for shape in shapes if shape.constraints]


def arrows(shapes: Iterable[Shape], forces: Array, scale: float) -> list[Shape]:
    """Return the reactions at the contacts; a force in the plane has no third component."""
    found = []
    for contact in _contacts(shapes):
        middle = contact.middle
        force = np.zeros(len(middle))
        total = forces[sorted(set(contact.constraints))].sum(axis=0)[: len(middle)]
        force[: len(total)] = total
        found.append(Shape("reaction", [middle, middle + force / scale]))
    return found


def _drawn(body: Body, t: float, x: Array, m: int) -> list[Shape]:
    """Return the shapes of a body; raise ValueError if it returns anything else."""
    shapes = body(t, *np.split(x, 2))
    if not isinstance(shapes, Iterable):
        raise ValueError(f"body returned {arguments.shown(shapes)}: expected a list of shapes")
    shapes = list(shapes)
    for shape in shapes:
        if not isinstance(shape, Shape):
            raise ValueError(
                f"body returned {arguments.shown(shape)} in its list: expected shapes, for "
                "example those of dal.plot.bodies"
            )
        if shape.constraints and max(shape.constraints) >= m:
            raise ValueError(
                f"body: a {shape.role} has constraints = {shape.constraints}, but the system "
                f"has {m} constraint{'s' * (m != 1)}, numbered from 0"
            )
    return shapes


def _columns(run: Solution, coordinates: Sequence[int] | None) -> tuple[int, ...]:
    """Return the indices of position coordinates: as given, or x, y (z), or the first two."""
    n, names = run.system.n, run.system.coordinates
    if coordinates is None:
        if "x" in names and "y" in names:
            space = "xyz" if set(names) == set("xyz") else "xy"
            return tuple(names.index(x) for x in space)
        return tuple(range(min(n, 2)))
    try:
        found = tuple(operator.index(k) for k in coordinates)
    except TypeError:
        found = ()
    if not 1 <= len(found) <= 3 or not all(0 <= k < n for k in found):
        raise ValueError(
            f"coordinates = {arguments.shown(coordinates)}: expected up to three of 0 to {n - 1}"
        )
    return found


def make_scene(
    run: Solution,
    body: Body | None,
    coordinates: Sequence[int] | None,
    count: int,
    multipliers: bool,
    scale: float | None,
) -> Scene:
    require_kind(run, "run", Solution)
    columns = _columns(run, coordinates)
    arguments.function(body, "body", "t, q, v")
    names = [_with_unit(run, run.system.coordinates[k]) for k in columns] if body is None else []
    if body is None and coordinates is None:
        body = bodies.of(run)
        if body and run.system.name in bodies.PAIRS:
            names = ["y", "z"]
        if body and run.system.name in bodies.IN_SPACE:
            columns = (0, 1, 2)
    if body is None:
        body = bodies.point(run, columns)
    if scale is not None and arguments.number(scale, "scale") <= 0:
        raise ValueError(f"scale = {scale:g}: expected a positive force for one unit of length")
    m = run.system.m
    if len(run.t) == 1:
        count = 1
    least = min(max(TRAIL[0], len(run.t)), TRAIL[1])
    per_frame = max(1, math.ceil(least / max(count - 1, 1))) if count > 1 else 1
    asked = np.linspace(run.t[0], run.t[-1], (count - 1) * per_frame + 1)
    t, x = _states(run, asked)
    if not np.isfinite(x).all():
        raise ValueError("run contains states that are not finite, which cannot be drawn")
    all_shapes = [_drawn(body, float(a), b, m) for a, b in zip(t, x)]
    frames = all_shapes[::per_frame]
    marks = [_contacts(s) or [dot for dot in s if dot.role == "dot"] for s in all_shapes]
    many = min(map(len, marks))
    trails = [np.array([shapes[k].middle for shapes in marks]) for k in range(many)]
    # A point of the plane lies on the ground of space.
    in_space = any(s.points.shape[1] == 3 for shapes in all_shapes for s in shapes)
    of_body = [s.points for shapes in frames for s in shapes]
    if in_space:
        trails = [_lifted(p) for p in trails]
        frames = [[replace(s, points=_lifted(s.points)) for s in shapes] for shapes in frames]
        of_body = [_lifted(p) for p in of_body]
    if not of_body:
        raise ValueError("body returned no shapes: expected at least one")
    cloud = np.concatenate([*of_body, *trails])
    size = bodies.size(cloud)
    drawn: float | None = None
    if multipliers and m > 0:
        forces = forces_at(run, t[::per_frame], x[::per_frame], columns)
        drawn = scale or _scale(run, t[::per_frame], x[::per_frame], frames, forces, size)
        if drawn:
            for shapes, force in zip(frames, forces):
                shapes += arrows(shapes, force, drawn)
    ground: list[Shape] = []
    look, grid = _flat, _round_number(size / 4)
    if in_space:
        ground, grid = _floor(cloud)
        look = Camera((cloud.min(axis=0) + cloud.max(axis=0)) / 2, 3.5 * size)
        low = cloud[:, 2].min()
        shadows = [
            Shape("ground", np.column_stack([p[:, :2], np.full(len(p), low)]))
            for p in trails
            if len(p) > 1 and np.ptp(p[:, 2]) > 0
        ]
        ground = _seen([*ground, *shadows], look)
        trails = [look(p) for p in trails]
    frames = [_seen(shapes, look) for shapes in frames]
    points = [s.points for shapes in [*frames, ground] for s in shapes]
    cloud = np.concatenate([*points, *trails])
    middle = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
    half = np.maximum(np.ptp(cloud, axis=0) / 2, 0.25 * bodies.size(cloud)) * 1.06
    return Scene(
        run, body, columns, t[::per_frame], frames, trails, per_frame, ground, grid, drawn, look,
        np.array([middle - half, middle + half]), names[:2] if not in_space else [],
    )  # fmt: skip


def _with_unit(run: Solution, name: str) -> str:
    return f"{name} ({unit})" if (unit := run.system.unit(name)) else name


def _lifted(points: Array) -> Array:
    """Return points in space; points of the plane get z = 0."""
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


def _scale(
    run: Solution, t: Array, x: Array, frames: list[list[Shape]], forces: Array, size: float
) -> float | None:
    """Return a round number of units of force for one of length; None if all forces are roundoff.

    A force is roundoff if, over the size of the film, its work is negligible compared with the
    kinetic energy.
    """
    largest = max(
        (
            float(np.linalg.norm(force[sorted(set(contact.constraints))].sum(axis=0)))
            for shapes, force in zip(frames, forces)
            for contact in _contacts(shapes)
        ),
        default=0.0,
    )
    q, v = np.split(x, 2, axis=1)
    kinetic = run.system.energy(q, v, t) - run.system.energy(q, 0 * v, t)
    if largest <= 1e-10 * float(np.abs(kinetic).max()) / size:
        return None
    return 1 / _round_number(LONGEST * size / largest)
