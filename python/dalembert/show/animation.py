"""Moving pictures of runs: bodies, the trails of their contacts, and the reactions that act there.

What is drawn is computed once, as lines and polygons in the plane of the picture; Matplotlib draws
them for films, and the script of a page for the screen.
"""

from __future__ import annotations

import contextlib
import functools
import html
import io
import json
import math
import operator
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core import Array, arguments, extras, files, residual_bound
from ..core.extras import Progress
from ..run import Solution
from . import bodies, web
from .bodies import ROLES, Body, Shape
from .plot import COLOURS, ZERO, Axes, _require, axes_for, plain

__all__ = ["Animation", "animate", "snapshots"]

MOST_FRAMES = 5000
TRAIL = 600, 5000  # points of a trail: at least, and at most unless there are more frames
CURVE = 200  # stretches of a curve of a page, with two points each
ARROWS = ("velocity", "reaction")
LONGEST, HEAD = 0.22, 0.035  # of an arrow, in sizes of the picture
NOTEBOOK = 10_000_000  # characters that a film may put into one

_BLUE, _ORANGE, _GREEN, _PINK = COLOURS[:4]
_LINES: dict[str, dict[str, Any]] = {
    "ground": {"color": "0.82", "linewidth": 0.8},
    "bar": {"color": "0.25", "linewidth": 1.6},
    "blade": {"color": _ORANGE, "linewidth": 3.6, "capstyle": "butt"},
    "dot": {"color": "0.1", "marker": "o", "markersize": 4, "linestyle": "none"},
    "velocity": {"color": _BLUE, "linewidth": 1.6},
    "reaction": {"color": _PINK, "linewidth": 2.0},
}
_FILLS = {"plane": (_GREEN, 0.8), "body": (_BLUE, 1.4)}  # the colour, and the width of the edge


# ---- states of a run at any time -----------------------------------------------------------------


def _states(run: Solution, t: Array) -> tuple[Array, Array]:
    """Return times and the states there: those asked for, or of the nearest stored states.

    The latter where there are none between: of a run with ``t_eval``, around a reset, before the
    terminal event.
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
class _Camera:
    """A view in perspective from above, at a point, from a distance."""

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
    """Return 1, 2 or 5 times a power of 10: the largest that is not above x > 0."""
    power = 10.0 ** math.floor(math.log10(x))
    return power * max(k for k in (1, 2, 5) if k * power <= x * (1 + 1e-9))


def _floor(points: Array) -> tuple[list[Shape], float]:
    """Return a grid below points in space, shape (K, 3), and the sides of its squares."""
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
class _Scene:
    """All frames of a film, and how further ones are made."""

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

    def shapes(self, t: float) -> tuple[float, list[Shape]]:
        """Return the time and the shapes of one instant."""
        times, x = _states(self.run, np.array([t]))
        found = list(self.body(float(times[0]), *np.split(x[0], 2)))
        if self.scale:
            found += _arrows(found, _forces(self.run, times, x, self.columns)[0], self.scale)
        return float(times[0]), _seen(found, self.look)


def _flat(points: Array) -> Array:
    return points


def _seen(shapes: Iterable[Shape], look: Any) -> list[Shape]:
    """Return shapes in the plane of the picture, in the order in which they are drawn."""
    found = [replace(shape, points=look(shape.points)) for shape in shapes]
    return sorted(found, key=lambda shape: ROLES.index(shape.role))


def _forces(run: Solution, t: Array, x: Array, columns: Sequence[int]) -> Array:
    """Return the reaction of each constraint as a force, shape (N, m, number of columns)."""
    q, v = np.split(x, 2, axis=1)
    steps = np.floor((t - run.t0) / run.h + 1e-9).astype(int)
    inputs = run._inputs_at(steps)
    multipliers = run.system.multipliers(q, v, t=t, inputs=inputs if inputs.size else None)
    return np.asarray(multipliers[:, :, None] * bodies.forms(run, t, q, v, columns))


def _contacts(shapes: Iterable[Shape]) -> list[Shape]:
    """The shapes at which something acts; those that leave a trail."""
    return [shape for shape in shapes if shape.constraints]


def _arrows(shapes: Iterable[Shape], forces: Array, scale: float) -> list[Shape]:
    """Return the reactions at the contacts; a force in the plane has no third component."""
    found = []
    for contact in _contacts(shapes):
        middle = contact.middle
        force = np.zeros(len(middle))
        total = forces[list(contact.constraints)].sum(axis=0)[: len(middle)]
        force[: len(total)] = total
        found.append(Shape("reaction", [middle, middle + force / scale]))
    return found


def _drawn(body: Body, t: float, x: Array, m: int) -> list[Shape]:
    """Return the shapes of a body, which has to be one."""
    shapes = body(t, *np.split(x, 2))
    if not isinstance(shapes, Iterable):
        raise ValueError(f"body returned {arguments.shown(shapes)}: expected a list of shapes")
    shapes = list(shapes)
    for shape in shapes:
        if not isinstance(shape, Shape):
            raise ValueError(
                f"body returned {arguments.shown(shape)} in its list: expected shapes, as those of "
                "dal.plot.bodies"
            )
        if shape.constraints and max(shape.constraints) >= m:
            raise ValueError(
                f"body: a {shape.role} has constraints = {shape.constraints}, the system has "
                f"m = {m}, numbered from 0"
            )
    return shapes


def _columns(run: Solution, coordinates: Sequence[int] | None) -> tuple[int, ...]:
    """Return the coordinates that are places: as asked for, or x, y (z), or the first."""
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
            f"coordinates is {arguments.shown(coordinates)}; expected up to three of 0 to {n - 1}"
        )
    return found


def _scene(
    run: Solution,
    body: Body | None,
    coordinates: Sequence[int] | None,
    count: int,
    multipliers: bool,
    scale: float | None,
) -> _Scene:
    _require(run, "run", Solution)
    columns = _columns(run, coordinates)
    arguments.function(body, "body", "t, q, v")
    names = [run.system.coordinates[k] for k in columns] if body is None else []
    if body is None and coordinates is None:
        body = bodies.of(run)
        names = ["y", "z"] if body and run.system.name in bodies.PAIRS else names
    if body is None:
        body = bodies.point(run, columns)
    if scale is not None and arguments.number(scale, "scale") <= 0:
        raise ValueError(f"scale = {scale:g}: expected units of force for one of length, > 0")
    m = run.system.m
    if len(run.t) == 1:
        count = 1
    least = min(max(TRAIL[0], len(run.t)), TRAIL[1])
    per_frame = max(1, math.ceil(least / max(count - 1, 1))) if count > 1 else 1
    asked = np.linspace(run.t[0], run.t[-1], (count - 1) * per_frame + 1)
    t, x = _states(run, asked)
    if not np.isfinite(x).all():
        raise ValueError("run has states that are not finite, of which nothing can be drawn")
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
        raise ValueError("body returned no shapes: there is nothing to draw")
    cloud = np.concatenate([*of_body, *trails])
    size = bodies.size(cloud)
    drawn: float | None = None
    if multipliers and m > 0:
        forces = _forces(run, t[::per_frame], x[::per_frame], columns)
        drawn = scale or _scale(run, frames, forces, size)
        if drawn:
            for shapes, force in zip(frames, forces):
                shapes += _arrows(shapes, force, drawn)
    ground: list[Shape] = []
    look, grid = _flat, _round_number(size / 4)
    if in_space:
        ground, grid = _floor(cloud)
        look = _Camera((cloud.min(axis=0) + cloud.max(axis=0)) / 2, 3.5 * size)
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
    return _Scene(
        run, body, columns, t[::per_frame], frames, trails, per_frame, ground, grid, drawn, look,
        np.array([middle - half, middle + half]), names[:2] if not in_space else [],
    )  # fmt: skip


def _lifted(points: Array) -> Array:
    """Return points in space: those of the plane lie at z = 0."""
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


def _scale(run: Solution, frames: list[list[Shape]], forces: Array, size: float) -> float | None:
    """Return a round number of units of force for one of length; None where all are roundoff."""
    largest = max(
        (
            float(np.linalg.norm(force[list(contact.constraints)].sum(axis=0)))
            for shapes, force in zip(frames, forces)
            for contact in _contacts(shapes)
        ),
        default=0.0,
    )
    if largest <= 1e-10 * float(np.abs(run.energy).max()) / size:
        return None
    return 1 / _round_number(LONGEST * size / largest)


# ---- drawing by Matplotlib -----------------------------------------------------------------------


def _head(points: Array, size: float) -> Array:
    """Return an arrow as one line: shaft, and head of this size, or less for a short arrow."""
    tail, tip = points
    along = tip - tail
    length = float(np.hypot(*along))
    if length == 0:
        return points
    back = along / length * min(size, 0.5 * length)
    side = 0.5 * np.array([-back[1], back[0]])
    return np.array([tail, tip, tip - back + side, tip, tip - back - side])


def _draw(ax: Axes, shapes: Sequence[Shape], size: float, alpha: float = 1.0) -> list[Any]:
    """Draw shapes on axes, of each role in one piece; return what was put there."""
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
                points = [_head(x, HEAD * size) for x in points]
            piece = collections.LineCollection(points, alpha=alpha, **_LINES[role])
        piece.set_zorder(2)
        found.append(ax.add_collection(piece, autolim=False))
    return found


def _draw_trails(ax: Axes, trails: Sequence[Array]) -> list[Any]:
    from matplotlib.collections import LineCollection

    lines = LineCollection(trails, color=_BLUE, linewidth=1.1, alpha=0.75, zorder=2)
    return [ax.add_collection(lines, autolim=False)]


def _stage(scene: _Scene, ax: Axes | None) -> Axes:
    """Return axes with limits and ground: those given, or some of a figure of their own."""
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
        with extras.require("matplotlib.style", "a film").context("default"):
            figure = web.figure(width, height, layout=None)
            ax = figure.add_axes((margin / width, bottom / height, inner / width, high / height))
        # The axes fill their place: more is seen above and below, or at the sides.
        box = np.array([inner, high])
        limits = limits.mean(axis=0) + np.outer([-0.5, 0.5], box * (span / box).max())
    ax = axes_for(ax)
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
        for name, (x, y) in zip(scene.names, ((0.99, 0.01), (0.01, 0.99))):
            where = {"ha": "right", "va": "bottom"} if x > y else {"ha": "left", "va": "top"}
            ax.text(
                x, y, plain(name), transform=ax.transAxes, color="0.45", fontsize="small", **where
            )
    _draw(ax, scene.ground, float(span.max()))
    _key(scene, ax)
    return ax


def _key(scene: _Scene, ax: Axes) -> None:
    """Say below what the arrows are."""
    roles = {shape.role for shapes in scene.frames for shape in shapes}
    words = _words(scene)
    entries = [
        (ax.plot([], [], **_LINES[role])[0], words[role]) for role in ARROWS if role in roles
    ]
    if scene.in_space:
        entries.append((ax.plot([], [], **_LINES["ground"])[0], words["ground"]))
    if entries:
        below = (
            0.0 if scene.in_space else -0.18 / ax.get_position().height / ax.figure.get_figheight()
        )
        ax.legend(
            *zip(*entries), loc="upper center", bbox_to_anchor=(0.5, below), ncols=3,
            frameon=False, fontsize="small", labelcolor=ax.title.get_color(),
            handlelength=1.2, columnspacing=1.2, borderaxespad=0.2,
        )  # fmt: skip


def _words(scene: _Scene) -> dict[str, str]:
    """What the legend says."""
    force = f"reaction: length 1 is a force of {scene.scale or 0:g}"
    return {"velocity": "velocity", "reaction": force, "ground": f"squares of {scene.grid:g}"}


def _clock(t: Array) -> str:
    """Return the format of the time: with digits to tell frames apart, and no more than 6."""
    gap = float(np.abs(np.diff(t)).min()) if len(t) > 1 else 0.0
    digits = min(max(1, math.ceil(-math.log10(gap))), 6) if gap > 0 else 2
    return f"t = {{:.{digits}f}}"


class Animation:
    """A film of a run, as `animate` makes it.

    Attributes
    ----------
    run : Solution
    t : ndarray, shape (frames,)
        Times of the frames, in the user's units.
    fps : float
        Frames of each second of the film.
    scale : float or None
        Units of force for a unit of length of the arrows; None if there are none.
    ax : matplotlib axes
    """

    def __init__(self, scene: _Scene, fps: float, trail: bool, ax: Axes | None) -> None:
        self.run, self.t, self.scale, self.fps = scene.run, scene.t, scene.scale, fps
        self._scene, self._trail = scene, trail
        self.ax = _stage(scene, ax)
        self._there: list[Any] = []
        self._format = _clock(self.t)
        self._show(0)

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        name, seconds = self.run.system.name, len(self) / self.fps
        return f"<Animation of {name}: {len(self)} frames, {seconds:g} seconds>"

    def frame(self, t: float) -> Axes:
        """Draw one instant, at any time of the run.

        Parameters
        ----------
        t : float
            In the user's units.

        Returns
        -------
        matplotlib axes

        Raises
        ------
        ValueError
            If it is not a time of the run.

        Examples
        --------
        >>> import dalembert as dal
        >>> run = dal.integrate(dal.systems.sleigh(), "leapfrog", h=0.02, t_end=5)
        >>> dal.plot.animate(run).frame(2.5).get_title(loc="right")
        't = 2.50'
        """
        t = arguments.number(t, "t")
        first, last = sorted(self.run.t[[0, -1]].tolist())
        if not first <= t <= last:
            raise ValueError(f"t = {t:g}: expected a time of the run, {first:g} to {last:g}")
        t, shapes = self._scene.shapes(t)
        forward = 1 if self.run.t[-1] >= self.run.t[0] else -1
        past = int(np.searchsorted(forward * self.t, forward * t, side="right")) - 1
        self._put(t, shapes, past)
        return self.ax

    def _show(self, k: int) -> None:
        self._put(float(self.t[k]), self._scene.frames[k], k)

    def _put(self, t: float, shapes: list[Shape], k: int) -> None:
        """Replace what moves by a frame, and the trails by those up to frame k."""
        for artist in self._there:
            artist.remove()
        scene = self._scene
        self._there = []
        if self._trail:
            past = k * scene.per_frame + 1
            self._there += _draw_trails(self.ax, [trail[:past] for trail in scene.trails])
        self._there += _draw(self.ax, shapes, float(np.ptp(scene.limits, axis=0).max()))
        self.ax.set_title(self._format.format(t), loc="right", fontsize="medium", color="0.3")

    # ---- files -----------------------------------------------------------------------------------

    def save(self, path: str | Path, *, progress: Progress = False) -> None:
        """Write the film to a file, whole or not at all.

        Parameters
        ----------
        path : str or Path
            Its ending says what is written: ``.gif``; ``.mp4``, for which ffmpeg has to be
            installed; ``.html``, a page with a slider, the energy and the residual, in one file.
        progress : bool or callable, optional
            True: a bar of tqdm.  A function is called as ``progress(done, total)`` with numbers of
            frames.

        Raises
        ------
        ValueError
            If the ending is another, or a GIF would have more than 50 frames a second, which
            browsers do not show.
        ImportError
            If Jinja2, which pages need, or Pillow is not installed; the text has the line to type.
        RuntimeError
            If ffmpeg is not installed or fails.
        OSError
            If the file cannot be written.

        Examples
        --------
        >>> import dalembert as dal, pathlib, tempfile
        >>> run = dal.integrate(dal.systems.sleigh(), "leapfrog", h=0.02, t_end=5)
        >>> with tempfile.TemporaryDirectory() as place:
        ...     file = pathlib.Path(place, "sleigh.gif")
        ...     dal.plot.animate(run, fps=10, seconds=1).save(file)
        ...     file.read_bytes()[:3]
        b'GIF'
        """
        target = Path(path)
        make = {".gif": self._gif, ".mp4": self._mp4, ".html": self._page}.get(
            target.suffix.lower()
        )
        if make is None:
            raise ValueError(
                f"path = {str(path)!r}: expected a name that ends in .gif, .mp4, .html"
            )
        files.require_writable(target)
        with extras.progress(progress, len(self), "frame") as show:
            content = make(show)
        files.replace(target.resolve(), content)

    def _pixels(self, show: extras.Show) -> Iterator[NDArray[np.uint8]]:
        """Yield the frames as arrays of bytes, shape (height, width, 4)."""
        import matplotlib

        figure = self.ax.figure
        options: dict[str, Any] = {"format": "raw", "dpi": figure.dpi, "transparent": False}
        with matplotlib.rc_context({"savefig.bbox": None}):
            for k in range(len(self)):
                show(k)
                self._show(k)
                buffer = io.BytesIO()
                figure.savefig(buffer, **options)
                width, height = (int(x) for x in figure.bbox.size)
                yield np.frombuffer(buffer.getvalue(), np.uint8).reshape(height, width, 4)
        show(len(self))

    def _gif(self, show: extras.Show) -> bytes:
        if self.fps > 50:
            raise ValueError(f"fps = {self.fps:g}: a GIF has at most 50 frames a second")
        image = extras.require("PIL.Image", "a GIF")
        frames = [image.fromarray(x[:, :, :3]) for x in self._pixels(show)]
        # One palette for all, of the frames at both ends and in the middle.
        some = np.concatenate([np.asarray(frames[k]) for k in (0, len(frames) // 2, -1)])
        palette = image.fromarray(some).quantize(32, image.Quantize.MAXCOVERAGE)
        frames = [x.quantize(palette=palette, dither=image.Dither.NONE) for x in frames]
        # Durations are whole hundredths of a second; their sum is right.
        ends = np.rint(100 * np.arange(len(frames) + 1) / self.fps).astype(int)
        buffer = io.BytesIO()
        frames[0].save(
            buffer, "GIF", save_all=True, append_images=frames[1:], loop=0,
            duration=(10 * np.diff(ends)).tolist(),
        )  # fmt: skip
        return buffer.getvalue()

    def _mp4(self, show: extras.Show) -> bytes:
        ffmpeg = shutil.which("ffmpeg")
        if ffmpeg is None:
            raise RuntimeError(
                "a file .mp4 needs the program ffmpeg: apt install ffmpeg, or what installs it on "
                "your system; .gif and .html need nothing else"
            )
        with tempfile.TemporaryDirectory() as folder:
            film = Path(folder, "film.mp4")
            frames = self._pixels(show)
            first = next(frames)
            command = [
                ffmpeg, "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgba",
                "-s", f"{first.shape[1]}x{first.shape[0]}", "-framerate", f"{self.fps!r}",
                "-i", "-", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", str(film),
            ]  # fmt: skip
            # In a session of its own: Ctrl-C is for this process, which then ends the other.
            with subprocess.Popen(
                command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
            ) as process:
                assert process.stdin is not None and process.stderr is not None
                with contextlib.suppress(BrokenPipeError):
                    for frame in (first, *frames):
                        process.stdin.write(frame.tobytes())
                    process.stdin.close()
                said = process.stderr.read().decode(errors="replace")
            if process.returncode != 0:
                raise RuntimeError(f"ffmpeg failed: {said.strip()}")
            return film.read_bytes()

    # ---- pages -----------------------------------------------------------------------------------

    def _page(self, show: extras.Show) -> bytes:
        return self._html().encode()

    def _html(self) -> str:
        """Return the film as a page of its own."""
        web.require()
        system, run = self.run.system, self.run
        about = f"{run.scheme.name}, h = {run.h:g}: {len(self)} frames of {len(run.t)} states"
        if not run.success:
            about += f"; it broke off: {run.message}"
        return str(web.render("film.html", title=system.name, about=about, data=self._data()))

    def _data(self) -> str:
        """Return what the script of a page draws, as JSON that may stand in HTML."""
        scene, run = self._scene, self.run
        low, span = scene.limits[0], np.ptp(scene.limits, axis=0)
        unit = 4000 / span.max()

        def whole(points: Array) -> list[int]:
            return [round(x) for x in ((points - low) * unit).ravel().tolist()]

        def sent(shapes: Iterable[Shape]) -> list[list[Any]]:
            head = HEAD * float(span.max())
            return [
                [ROLES.index(x.role), *whole(_head(x.points, head))]
                if x.role in ARROWS
                else [ROLES.index(x.role), *whole(x.points)]
                for x in shapes
            ]

        words = _words(scene)
        roles = {shape.role for shapes in scene.frames for shape in shapes}
        said = [role for role in ARROWS if role in roles]
        change = "E − E₀" if run.system.conserves_energy else "E − E₀, no error here"
        below = "log₁₀ residual; roundoff is below the dashed line"
        residual = np.maximum(run.residual, ZERO)
        data = {
            "size": [round(x) for x in (span * unit).tolist()],
            "roles": ROLES,
            "fps": self.fps,
            "t": [float(f"{x:.12g}") for x in self.t.tolist()],
            "clock": [self._format.format(x) for x in self.t.tolist()],
            "frames": [sent(shapes) for shapes in scene.frames],
            "trails": [whole(x) for x in scene.trails] if self._trail else [],
            "each": scene.per_frame,
            "ground": sent(scene.ground),
            "names": scene.names,
            "grid": [] if scene.in_space else _ticks(scene, whole),
            "key": [[ROLES.index(role), words[role]] for role in said],
            "squares": words["ground"] if scene.in_space else "",
            "curves": [
                _curve(change, run.t, run.energy - run.energy[0]),
                _curve(
                    "log₁₀ residual; roundoff is below the dashed line",
                    run.t,
                    np.log10(residual),
                    residual_bound(run.system.n),
                ),
            ],
        }
        text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
        return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")

    def _repr_html_(self) -> str | None:
        """Return the page in a frame, for notebooks."""
        if not extras.is_there("jinja2"):
            return None
        page = self._html()
        if len(page) > NOTEBOOK:
            return (
                f"<p>{html.escape(repr(self))}: its page has {len(page) / 1e6:.0f} MB, too much "
                "for a notebook; <code>.save('film.html')</code> writes it.</p>"
            )
        return (
            f'<iframe srcdoc="{html.escape(page)}" title="{html.escape(self.run.system.name)}" '
            'style="width:100%;max-width:46rem;height:44rem;border:0"></iframe>'
        )


def _ticks(scene: _Scene, whole: Any) -> list[list[Any]]:
    """Return the lines of the grid: 0 for x or 1 for y, where, and what is written there."""
    found = []
    for axis in (0, 1):
        low, high = scene.limits[:, axis] / scene.grid
        for k in range(math.ceil(low), math.floor(high) + 1):
            place = np.tile(scene.limits[0], 1)
            place[axis] = k * scene.grid
            found.append([axis, whole(place[None])[axis], f"{k * scene.grid:.12g}"])
    return found


def _curve(name: str, t: Array, y: Array, bound: float | None = None) -> dict[str, Any]:
    """Return a curve for a page: of each stretch the lowest and the highest value."""
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


# ---- the functions of dal.plot -------------------------------------------------------------------


def animate(
    run: Solution,
    body: Body | None = None,
    *,
    coordinates: Sequence[int] | None = None,
    fps: float = 20.0,
    seconds: float = 5.0,
    trail: bool = True,
    multipliers: bool = True,
    scale: float | None = None,
    ax: Axes | None = None,
) -> Animation:
    """Make a film of a run: the body, the trail of its contacts, the reactions that act there.

    The frames are evenly spaced in time, from the first stored state to the last.  States between
    the stored ones are those of ``run(t)``, in D; where there are none (a run with ``t_eval``,
    around a reset) the nearest stored state is drawn, with its own time.

    Parameters
    ----------
    run : Solution
    body : callable, optional
        ``body(t, q, v)`` returns the shapes to draw, see `dal.plot.bodies`.  Default: the body of
        a system of the library, else a point with its velocity, and in space, for one constraint,
        with the plane of D.
    coordinates : sequence of int, optional
        Which of q are places, two in the plane or three in space: for the point, which is then
        drawn instead of the library's body, and for the components of the reactions.  Default:
        those called x and y, and z if there are no others; else the first two.
    fps : float, optional
        Frames of each second of the film.
    seconds : float, optional
        Duration of the film, whatever the duration of the run in the user's units of time.
    trail : bool, optional
        Whether contacts leave trails; where a body has none, its dots do.
    multipliers : bool, optional
        Whether the reactions are drawn, as arrows mu^T lambda at the contacts.  They are left out
        where all of them are zero to roundoff.
    scale : float, optional
        Units of force for one unit of length of the arrows.  Default: a round number; the legend
        has it.
    ax : matplotlib axes, optional
        In the plane, for space too.

    Returns
    -------
    Animation
        With ``save``, ``frame``; a notebook shows it as a page with a slider.

    Raises
    ------
    ValueError
        If it is no run, an argument is out of its range, or the body returns something else than
        shapes.
    ImportError
        If matplotlib is not installed.

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.sleigh(), "leapfrog", h=0.02, t_end=10)
    >>> dal.plot.animate(run)
    <Animation of sleigh: 100 frames, 5 seconds>

    With a body of one's own, for a system of one's own:

    >>> draw = dal.plot.bodies
    >>> def skate(t, q, v):
    ...     return [draw.circle(q[:2], 0.2), draw.blade(q[:2], q[2], 0.6, constraints=0)]
    >>> film = dal.plot.animate(run, skate, fps=25, seconds=4)
    """
    fps, seconds = (
        arguments.number(value, name) for value, name in ((fps, "fps"), (seconds, "seconds"))
    )
    if fps <= 0 or seconds <= 0:
        raise ValueError(f"fps = {fps:g}, seconds = {seconds:g}: expected positive numbers")
    count = max(2, round(fps * seconds)) if fps * seconds <= MOST_FRAMES else MOST_FRAMES + 1
    if count > MOST_FRAMES:
        raise ValueError(
            f"fps = {fps:g}, seconds = {seconds:g}: expected at most {MOST_FRAMES} frames"
        )
    scene = _scene(run, body, coordinates, count, multipliers, scale)
    return Animation(scene, fps, trail, ax)


def snapshots(
    run: Solution,
    body: Body | None = None,
    ax: Axes | None = None,
    *,
    count: int = 9,
    coordinates: Sequence[int] | None = None,
    multipliers: bool = False,
    scale: float | None = None,
) -> Axes:
    """Draw the body at several times along the whole trail, in one picture.

    Parameters
    ----------
    run : Solution
    body : callable, optional
        As for `animate`; so are ``coordinates`` and ``scale``.
    ax : matplotlib axes, optional
    count : int, optional
        How many outlines, evenly spaced in time; the later the darker.
    coordinates : sequence of int, optional
    multipliers : bool, optional
        Whether the reactions are drawn.
    scale : float, optional

    Returns
    -------
    matplotlib axes

    Raises
    ------
    ValueError
        As `animate`.
    ImportError
        If matplotlib is not installed.

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.sleigh(), "leapfrog", h=0.02, t_end=10)
    >>> dal.plot.snapshots(run).get_title(loc="left")
    'sleigh'
    """
    count = arguments.integer(count, "count", 2, MOST_FRAMES)
    scene = _scene(run, body, coordinates, count, multipliers, scale)
    ax = _stage(scene, ax)
    size = float(np.ptp(scene.limits, axis=0).max())
    _draw_trails(ax, scene.trails)
    for shapes, alpha in zip(scene.frames, np.linspace(0.35, 1.0, len(scene.frames))):
        if alpha < 1:
            shapes = [shape for shape in shapes if shape.role != "ground"]
        _draw(ax, shapes, size, float(alpha))
    first, last = (_clock(scene.t).format(float(x)) for x in scene.t[[0, -1]])
    ax.set_title(f"{first} to {last.removeprefix('t = ')}", loc="right", fontsize="medium",
                 color="0.3")  # fmt: skip
    return ax
