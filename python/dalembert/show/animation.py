"""Films of runs: bodies, trails of their contacts, and reactions."""

from __future__ import annotations

import contextlib
import html
import io
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core import arguments, extras, files
from ..core.extras import Progress
from ..run import Solution
from . import film_page, web
from .bodies import Body, Shape
from .plot import Axes, Documented, plain
from .scene import Scene, make_scene
from .stage import clock, draw, draw_trails, stage

__all__ = ["Animation", "animate", "snapshots"]

MOST_FRAMES = 5000
NOTEBOOK = 10_000_000  # characters that a film may put into one


class Animation:
    """A film of a run, created by `dalembert.plot.animate`.

    Attributes
    ----------
    run : Solution
    t : ndarray, shape (frames,)
        Times of the frames, in the user's units.
    fps : float
        Frames per second of the film.
    scale : float or None
        Units of force for a unit of length of the arrows; None without arrows.
    ax : matplotlib axes
    """

    def __init__(self, scene: Scene, fps: float, trail: bool, ax: Axes | None) -> None:
        self.run, self.t, self.scale, self.fps = scene.run, scene.t, scene.scale, fps
        self._scene, self._trail = scene, trail
        self.ax = stage(scene, ax)
        self._there: list[Any] = []
        self._clock = clock(scene)
        self._show(0)

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        name, seconds = self.run.system.name, len(self) / self.fps
        return f"<Animation of {name}: {len(self)} frames, {seconds:g} seconds>"

    def frame(self, t: float) -> Axes:
        """Draw the frame at any time of the run.

        Parameters
        ----------
        t : float
            The time, in the user's units.

        Returns
        -------
        matplotlib axes

        Raises
        ------
        ValueError
            If t lies outside the run.

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
            raise ValueError(f"t = {t:g}: expected a time of the run, from {first:g} to {last:g}")
        t, shapes = self._scene.shapes(t)
        forward = 1 if self.run.t[-1] >= self.run.t[0] else -1
        past = int(np.searchsorted(forward * self.t, forward * t, side="right")) - 1
        self._put(t, shapes, past)
        return self.ax

    def _show(self, k: int) -> None:
        self._put(float(self.t[k]), self._scene.frames[k], k)

    def _put(self, t: float, shapes: list[Shape], k: int) -> None:
        """Replace moving shapes by those of a frame, and trails by those up to frame k."""
        for artist in self._there:
            artist.remove()
        scene = self._scene
        self._there = []
        if self._trail:
            past = k * scene.per_frame + 1
            self._there += draw_trails(self.ax, [trail[:past] for trail in scene.trails])
        self._there += draw(self.ax, shapes, float(np.ptp(scene.limits, axis=0).max()))
        self.ax.set_title(plain(self._clock(t)), loc="right", fontsize="medium", color="0.3")

    # ---- files -----------------------------------------------------------------------------------

    @Documented("ImportError, OSError")
    def save(self, path: str | Path, *, progress: Progress = False) -> None:
        """Write the film to a file, completely or not at all.

        Parameters
        ----------
        path : str or Path
            The file.  The suffix determines the format: ``.gif``; ``.mp4``, which needs ffmpeg;
            ``.html``, a self-contained page with a slider, the energy and the residual.

        Raises
        ------
        ValueError
            If the suffix is another, or a GIF would have more than 50 frames per second, which
            browsers do not show.
        RuntimeError
            If ffmpeg is not installed or fails.

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
        figure = self.ax.figure
        options: dict[str, Any] = {"format": "raw", "dpi": figure.dpi, "transparent": False,
                                   "facecolor": figure.get_facecolor()}  # fmt: skip
        for k in range(len(self)):
            show(k)
            buffer = io.BytesIO()
            with web.default_style():
                self._show(k)
                figure.savefig(buffer, **options)
            width, height = (int(x) for x in figure.bbox.size)
            yield np.frombuffer(buffer.getvalue(), np.uint8).reshape(height, width, 4)
        show(len(self))

    def _gif(self, show: extras.Show) -> bytes:
        if not 0.002 <= self.fps <= 50:
            raise ValueError(
                f"fps = {self.fps:g}: expected 0.002 to 50 frames per second for a GIF"
            )
        image = extras.require("PIL.Image", "a GIF")
        pixels = [x[:, :, :3] for x in self._pixels(show)]
        # One palette for all, of the frames at both ends and in the middle: the colours of lines
        # and areas as they are, and some between them for their edges.
        some = np.concatenate([pixels[k] for k in (0, len(pixels) // 2, -1)])
        colours, counts = np.unique(_packed(some), return_counts=True)
        often = colours[np.argsort(counts)[-24:]].tolist()
        between = image.fromarray(some).quantize(32, image.Quantize.MAXCOVERAGE).getpalette()
        palette = [x for c in often for x in c.to_bytes(3, "big")] + between[: 3 * 32]
        frames = [image.fromarray(_nearest(x, palette), "P") for x in pixels]
        for frame in frames:
            frame.putpalette(palette)
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
                "path: an .mp4 file needs the program ffmpeg. Install it (apt install "
                "ffmpeg), or write a .gif or .html file, which need nothing else"
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
            if process.returncode != 0 or said:  # of a full disk it says no more than that
                raise RuntimeError(f"ffmpeg failed: {said.strip()}")
            return film.read_bytes()

    def _page(self, show: extras.Show) -> bytes:
        page = film_page.html(self._scene, self.fps, self._trail).encode()
        show(len(self))
        return page

    def _repr_html_(self) -> str | None:
        """Return the page in a frame, for notebooks."""
        if not extras.is_there("jinja2"):
            return None
        page = film_page.frame(self._scene, self.fps, self._trail)
        if len(page) > NOTEBOOK:
            return (
                f"<p>{html.escape(repr(self))}: the page has {len(page) / 1e6:.0f} MB, too "
                "much for a notebook; <code>.save('film.html')</code> writes it to a file.</p>"
            )
        return str(page)


def _packed(pixels: NDArray[np.uint8]) -> NDArray[np.int_]:
    """Return each colour as a number, shape (pixels,)."""
    return pixels.reshape(-1, 3) @ np.array([1 << 16, 1 << 8, 1])


def _nearest(pixels: NDArray[np.uint8], palette: list[int]) -> NDArray[np.uint8]:
    """Return for each pixel the index of the nearest colour of a palette."""
    colours, where = np.unique(_packed(pixels), return_inverse=True)
    known = np.reshape(palette, (-1, 3))
    apart = np.stack([colours >> 16, colours >> 8 & 255, colours & 255], axis=1)[:, None] - known
    best = (apart**2).sum(axis=2).argmin(axis=1).astype(np.uint8)
    return np.asarray(best[where].reshape(pixels.shape[:2]))


# ---- the functions of dal.plot -------------------------------------------------------------------


class _Documented(Documented):
    """Parameters of films and snapshots.

    Parameters
    ----------
    body : callable, optional
        ``body(t, q, v)`` returns the shapes to draw, see `dalembert.plot.bodies`.  The default for
        a system of the library is its body.  Other systems are drawn as a point with its velocity,
        in space with the plane of D if there is one constraint.
    coordinates : sequence of int, optional
        Indices of the coordinates of a position, two in the plane or three in space.  They
        determine the point, which is then drawn instead of the library's body, and the components
        of the reactions.  Default: x and y, with z if there are no other coordinates; otherwise the
        first two.
    multipliers : bool, optional
        Whether to draw the reactions mu^T lambda as arrows at the contacts.  They are omitted if
        all are zero to roundoff.
    scale : float, optional
        Units of force for one unit of length of the arrows.  Default: a round number, shown in the
        legend.
    """


@_Documented("ValueError, ImportError")
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
    """Create a film of a run: the body, the trails of its contacts, and the reactions.

    The frames are evenly spaced in time, from the first stored state to the last.  States between
    the stored ones are those of ``run(t)``, in D.  If ``run(t)`` is not available (for a run with
    ``t_eval``, or around a reset), the frame shows the nearest stored state and its time.

    Parameters
    ----------
    fps : float, optional
        Frames per second of the film; default 20.
    seconds : float, optional
        Duration of the film in seconds, independent of the duration of the run; default 5.
    trail : bool, optional
        Whether contacts, or the dots of a body without contacts, leave trails.
    ax : matplotlib axes, optional
        Plane axes, also for films in space.

    Returns
    -------
    Animation
        Has the methods ``save`` and ``frame``; a notebook shows it as a page with a slider.

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.sleigh(), "leapfrog", h=0.02, t_end=10)
    >>> dal.plot.animate(run)
    <Animation of sleigh: 100 frames, 5 seconds>

    With your own body:

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
    scene = make_scene(run, body, coordinates, count, multipliers, scale)
    return Animation(scene, fps, trail, ax)


@_Documented("ValueError, ImportError", "matplotlib axes")
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
    """Draw the body at several times along its trail, in one plot.

    Parameters
    ----------
    count : int, optional
        Number of outlines, evenly spaced in time; later ones are darker.  Default 9.

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.sleigh(), "leapfrog", h=0.02, t_end=10)
    >>> dal.plot.snapshots(run).get_title(loc="left")
    'sleigh'
    """
    count = arguments.integer(count, "count", 2, MOST_FRAMES)
    scene = make_scene(run, body, coordinates, count, multipliers, scale)
    ax = stage(scene, ax, shown=True)
    size = float(np.ptp(scene.limits, axis=0).max())
    draw_trails(ax, scene.trails)
    for shapes, alpha in zip(scene.frames, np.linspace(0.35, 1.0, len(scene.frames))):
        if alpha < 1:
            shapes = [shape for shape in shapes if shape.role != "ground"]
        draw(ax, shapes, size, float(alpha))
    first, last = map(clock(scene), scene.t[[0, -1]].tolist())
    span = f"{first.removesuffix(scene.unit('t'))} to {last.removeprefix('t = ')}"
    ax.set_title(plain(span), loc="right", fontsize="medium", color="0.3")
    return ax
