"""Plots of studies and runs, with matplotlib.

Every function takes ``ax=None`` (default: new axes) and returns the axes without showing them.
Colours are those of Okabe and Ito.  Markers and line styles differ as well, so plots are readable
in black and white.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import geometry
from ..core import ROUNDOFF, Array, Pair, extras, residual_bound
from ..core.documentation import Common
from ..run import Solution
from ..study import Embedding, Studies, Study
from .palette import COLOURS, PAPER

__all__ = ["convergence", "drift", "energy", "path", "perturbation", "styles"]

Style = Mapping[str, Any]
Axes = Any  # of matplotlib

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
LINES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (6, 1.5, 1, 1.5, 1, 1.5)))

ZERO = 1e-17  # where an exact zero is drawn on a logarithmic axis
NOT_ROUNDOFF = 1e-8  # the axis of residuals reaches here, so that roundoff looks small
STRETCHES = 50  # of a run, for the drift: roundoff of every step would hide what is beneath it

QUANTITIES = {
    "state": ("state_error", "global_state", 0, "error of (q, v) at t = {t_end:g}", ("", "v_")),
    "q": ("q_error", "global_q", 0, "error of q at t = {t_end:g}", ("",)),
    "v": ("v_error", "global_v", 0, "error of v at t = {t_end:g}", ("v_",)),
    "multipliers": (
        "multiplier_error", "global_multipliers", 0, "error of lambda at t = {t_end:g}", ()
    ),
    "local": ("local_error", "state", 1, "error of (q, v) after one step", ("", "v_")),
    "reactions": (
        "local_reaction_error", "reaction", 1, "error of the scheme's multiplier after one step", ()
    ),
}  # fmt: skip


class Documented(Common):
    """Parameters and exceptions of the plots.

    Parameters
    ----------
    study : Study or sequence of Study
    solution : Solution or sequence of Solution
    styles : mapping of scheme names to properties of a line, optional
        See `dalembert.plot.styles`.

    Raises
    ------
    ValueError
        If an argument is of another type or out of range, or there is nothing to draw.
    """


def styles(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return a colour, a marker and a line style for each name.

    Parameters
    ----------
    names : iterable of str
        Names of schemes.  Up to 7 differ in colour; up to 280 in colour, marker or line style.

    Returns
    -------
    dict of str to dict
        Line properties, for the argument ``styles`` of the plots.

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.plot.styles(["midpoint", "leapfrog"])["leapfrog"]["marker"]
    's'
    """
    return {
        name: {
            "color": COLOURS[i % len(COLOURS)],
            "marker": MARKERS[i % len(MARKERS)],
            "linestyle": LINES[i % len(LINES)],
            # Smaller and smaller, so that one of two equal curves is seen behind the other.
            "markersize": 8.5 - 0.5 * (i % len(MARKERS)),
        }
        for i, name in enumerate(dict.fromkeys(names))
    }


@Documented("ValueError, ImportError")
def convergence(
    study: Study | Studies | Sequence[Study],
    ax: Axes | None = None,
    *,
    quantity: str = "state",
    styles: Mapping[str, Style] | None = None,
) -> Axes:
    """Draw errors over the step size, log-log, with the fitted orders and slope triangles.

    Lines join the points that count for the fit.  The other points have hollow markers: they are
    too close to roundoff, or exactly zero and drawn at 1e-17.

    Parameters
    ----------
    quantity : {"state", "q", "v", "multipliers", "local", "reactions"}
        "state", "q", "v" and "multipliers" are errors at ``t_end``.  "local" and "reactions" are
        one-step errors of (q, v) and of the scheme's own multipliers.  The legend shows the order
        of the scheme, which for one-step errors is the slope minus 1.

    Examples
    --------
    >>> import dalembert as dal
    >>> study = dal.convergence(dal.systems.particle(), "midpoint")
    >>> dal.plot.convergence(study).get_xscale()
    'log'
    """
    if quantity not in QUANTITIES:
        raise ValueError(f"quantity = {quantity!r}: expected one of {', '.join(QUANTITIES)}")
    name, key, loss, words, of = QUANTITIES[quantity]
    studies = several(study, "study", Study)
    ax = axes_for(ax)
    from matplotlib.ticker import LogLocator, NullFormatter

    styles = _styles(studies, styles)
    triangles: dict[int, tuple[float, Array, Array]] = {}
    for item in studies:
        fit, error = item.fits[key], getattr(item, name)
        drawn = np.isfinite(error)
        h, error = np.abs(item.h[drawn]), np.maximum(error[drawn], ZERO)
        clear = np.array(fit.counted)[drawn]
        label = plain(f"{item.scheme.name}: {fit.order(loss)}")
        (line,) = ax.loglog(h[clear], error[clear], label=label, **styles[item.scheme.name])
        _hollow(ax, h[~clear], error[~clear], line, markersize=line.get_markersize())
        if not math.isnan(fit.slope) and not fit.exact and round(fit.slope) > 0:
            _lowest(triangles, round(fit.slope), h[clear], error[clear])
    for slope, (_, h, error) in sorted(triangles.items()):
        _triangle(ax, slope, h, error)
    shortest, longest = ax.get_xlim()
    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if longest < 100 * shortest else (1,)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    parts = [before + x for item in studies for x in item.system.coordinates for before in of]
    ax.set(
        xlabel=with_unit("step h", studies, "t"),
        ylabel=with_unit(words.format(t_end=studies[0].t_end), studies, *parts),
        title=f"{_systems(studies)}: convergence",
    )
    return _legend(ax, "scheme: fitted order")


@Documented("ValueError, ImportError", "ndarray of two matplotlib axes")
def drift(
    solution: Solution | Sequence[Solution],
    ax: Sequence[Axes] | None = None,
    *,
    styles: Mapping[str, Style] | None = None,
) -> Array:
    """Draw the relative residuals of D and of D_eps over time, side by side.

    Exact zeros are drawn at 1e-17; the dashed line is the unit roundoff u. Schemes with several
    sub-steps have no D_eps and appear only on the left.  A hollow marker is the start of a run with
    kept nodes in D instead of D_eps.  For a run with more than 50 states the plot shows the largest
    residual in each of 50 stretches.

    Parameters
    ----------
    ax : two matplotlib axes, optional
        Axes for D and for D_eps.

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.particle(), "midpoint", h=0.05, steps=100)
    >>> left, right = dal.plot.drift(run)
    """
    solutions = several(solution, "solution", Solution)
    if ax is None:
        ax = _subplots(1, 2, sharey=True, figsize=(9, 3.8))
    axes = np.asarray(ax, dtype=object).ravel()
    if len(axes) != 2:
        raise ValueError(f"ax has {len(axes)} axes: expected two, for D and for D_eps")
    axes = np.array([axes_for(axis) for axis in axes])
    styles = _styles(solutions, styles)
    for run in solutions:
        style = _over_time(styles[run.scheme.name], min(len(run.t), STRETCHES))
        in_D, in_D_eps = _residuals(run)
        axes[0].plot(*_stretches(run.t, in_D), label=plain(run.scheme.name), **style)
        if in_D_eps is None:
            continue
        # Kept nodes may start in D and jump to D_eps in the first step: that start is a point.
        jump = int(run.nodes == "kept" and in_D_eps[0] > residual_bound(run.system.n))
        rows = _stretches(run.t[jump:], in_D_eps[jump:])
        (line,) = axes[1].plot(*rows, label=plain(run.scheme.name), **style)
        _hollow(axes[1], run.t[:jump], in_D_eps[:jump], line)
    linear = all(run.system.kind == "linear" for run in solutions)
    before, after = (r"\mu(", r")\,v") if linear else (r"\varphi(", ", v)")
    sets = (("D", "q"), (r"D_\varepsilon", r"q - (1-\beta) h v"))
    titles = (f"${name}$:  ${before}{place}{after} = 0$" for name, place in sets)
    for axis, title in zip(axes, titles):
        axis.axhline(ROUNDOFF, color="black", linewidth=1, linestyle=(0, (5, 3)), zorder=1)
        _beside(axis, "u", (1, ROUNDOFF), xycoords=("axes fraction", "data"))
        axis.set(yscale="log", title=title, xlabel=_time(solutions))
    for axis in axes:
        lowest, highest = axis.get_ylim()
        axis.set_ylim(min(lowest, ZERO / 4), max(highest, NOT_ROUNDOFF))
    axes[0].set_ylabel("relative residual of the constraint")
    _legend(axes[1], None, axes[0].get_legend_handles_labels())
    return axes


@Documented("ValueError, ImportError")
def energy(
    solution: Solution | Sequence[Solution],
    ax: Axes | None = None,
    *,
    styles: Mapping[str, Style] | None = None,
) -> Axes:
    """Draw the relative energy error over time, on a linear axis.

    The label says "change" if the energy is not conserved because forces or constraints do work.

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.particle(), "midpoint", h=0.05, steps=100)
    >>> ax = dal.plot.energy(run)
    """
    solutions = several(solution, "solution", Solution)
    ax = axes_for(ax)
    styles = _styles(solutions, styles)
    for run in solutions:
        scale = max(abs(run.energy[0]), 1.0)
        error, style = (run.energy - run.energy[0]) / scale, styles[run.scheme.name]
        ax.plot(run.t, error, label=plain(run.scheme.name), **_over_time(style, len(run.t)))
    ax.axhline(0, color="0.6", linewidth=0.8, zorder=1)
    what = "error" if all(run.system.conserves_energy for run in solutions) else "change"
    ax.set(
        xlabel=_time(solutions),
        ylabel=rf"energy {what}  $(E - E_0) / \max(|E_0|, 1)$",
        title=f"{_systems(solutions)}: energy",
    )
    scientific(ax)
    return _legend(ax, None)


@Documented("ValueError, ImportError")
def path(
    solution: Solution,
    ax: Axes | None = None,
    coordinates: tuple[int, int] = (0, 1),
) -> Axes:
    """Draw a run in the plane of two coordinates, with equal axes and the start marked.

    Parameters
    ----------
    solution : Solution
    coordinates : pair of int
        Indices of two coordinates; default (0, 1).

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.knife_edge(), "leapfrog", h=0.05, steps=100)
    >>> dal.plot.path(run).get_xlabel()
    'x'
    """
    require_kind(solution, "solution", Solution)
    n = solution.system.n
    try:
        i, j = map(operator.index, coordinates)
    except (TypeError, ValueError):
        i = j = -1
    if not (0 <= i < n and 0 <= j < n):
        raise ValueError(f"coordinates = {coordinates!r}: expected two of 0 to {n - 1}")
    ax = axes_for(ax)
    first, second = solution.q[:, i], solution.q[:, j]
    ax.plot(first, second, color=COLOURS[0])
    ax.plot(first[:1], second[:1], color=COLOURS[1], marker="o", linestyle="none", label="start")
    ax.set_aspect("equal", adjustable="datalim")
    names = (solution.system.coordinates[k] for k in (i, j))
    x, y = (with_unit(name, [solution], name) for name in names)
    title = f"{solution.system.name}: path, {solution.scheme.name}, {solution._how}"
    ax.set(xlabel=x, ylabel=y, title=plain(title))
    ax.legend(frameon=False)
    return ax


@Documented("ValueError, ImportError")
def perturbation(
    embedding: Embedding,
    ax: Axes | None = None,
    *,
    hs: Sequence[float] | None = None,
    z: ArrayLike | None = None,
) -> Axes:
    """Draw the largest component of ``|g|`` over tau for several h.

    With the order of the scheme the curves nearly coincide; with one more they double if h is
    halved.  A thin horizontal line is the noise of the curve of the same style; values below it are
    roundoff.  Usually it is close to 0 and visible only in the legend.

    Parameters
    ----------
    embedding : Embedding
    hs : sequence of float, optional
        Steps.  Default: the step of the embedding, a half and a quarter of it.
    z : array_like, shape (2n-m,), optional
        The point.  Default: ``embedding.start``.

    Examples
    --------
    >>> import dalembert as dal
    >>> midpoint = dal.embedding(dal.systems.particle(), "midpoint", h=0.1)
    >>> dal.plot.perturbation(midpoint).get_xlabel()
    'time in units of the period, tau = t/h'
    """
    require_kind(embedding, "embedding", Embedding)
    ax = axes_for(ax)
    steps = [embedding.h / 2**k for k in range(3)] if hs is None else list(hs)
    if not steps:
        raise ValueError("hs is empty: expected at least one step")
    found = [embedding.with_step(h) for h in steps]
    taus = np.arange(1, 200) / 200
    for one, style in zip(found, styles(map(str, found)).values()):
        size = np.abs(one.g(taus, z)).max(axis=-1)
        line = {"color": style["color"], "linestyle": style["linestyle"]}
        ax.plot(taus, size, label=f"{one.h:g}, noise {one.noise:.0e}", **line)
        ax.axhline(one.noise, linewidth=0.8, zorder=1, **line)
    title = f"{embedding.system.name}: {embedding.scheme.name} with p = {embedding.order}"
    ax.set(
        xlabel="time in units of the period, tau = t/h",
        ylabel="largest component of |g|",
        title=plain(title),
    )
    return _legend(ax, "step h")


def embedded(
    self: Embedding,
    hs: Sequence[float] | None = None,
    z: ArrayLike | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw ``|g|`` over tau for several h; see `dalembert.plot.perturbation`."""
    return perturbation(self, ax, hs=hs, z=z)


def _lowest(triangles: dict[int, Any], slope: int, h: Array, error: Array) -> None:
    """Keep for each slope the lowest curve, which has room for a triangle below it."""
    if len(h) < 2:
        return
    height = float(np.mean(np.log(error) - slope * np.log(h)))
    if slope not in triangles or height < triangles[slope][0]:
        triangles[slope] = (height, h, error)


def _triangle(ax: Axes, slope: int, h: Array, error: Array) -> None:
    """Draw a triangle of this slope below the middle of a curve."""
    order = np.argsort(h)
    h, error = h[order], error[order]
    middle = math.sqrt(h[0] * h[-1])
    left, right = middle / 1.2, middle * 1.2
    top = math.exp(np.interp(math.log(right), np.log(h), np.log(error))) / 2.0
    bottom = top * (left / right) ** slope
    grey = {"facecolor": (0.5, 0.5, 0.5, 0.3), "edgecolor": "0.5"}
    ax.fill([left, right, right], [bottom, bottom, top], **grey, linewidth=0.8, zorder=1)
    _beside(ax, str(slope), (right, math.sqrt(top * bottom)), fontsize="small")


def _beside(ax: Axes, text: str, place: tuple[float, float], **more: Any) -> None:
    """Write a text to the right of a place."""
    ax.annotate(text, place, xytext=(3, 0), textcoords="offset points", va="center", **more)


def _hollow(ax: Axes, x: Array, y: Array, line: Any, **more: Any) -> None:
    """Draw points with the marker and the colour of a line, but hollow."""
    marker, color = line.get_marker(), line.get_color()
    ax.plot(x, y, linestyle="none", marker=marker, color=color, markerfacecolor=PAPER, **more)


def scientific(ax: Axes) -> None:
    """Write the numbers of a vertical axis with powers of 10 if they are large or small."""
    ax.ticklabel_format(axis="y", style="sci", scilimits=(-3, 3), useMathText=True)


def _residuals(run: Solution) -> tuple[Array, Array | None]:
    """Return the relative residuals of D and of D_eps; None if the scheme has no D_eps."""
    in_D = geometry.relative_residual(run.system, run.q, run.v)
    if len(run.scheme.substeps) != 1:
        return in_D, None
    return in_D, geometry.relative_residual(run.system, run.q, run.v, run.scheme.shift(run.h))


def _stretches(t: Array, residual: Array) -> Pair:
    """Return the largest residual in each stretch of a run, and the times of the stretches."""
    starts = np.unique(np.linspace(0, len(t), min(len(t), STRETCHES), endpoint=False, dtype=int))
    return t[starts], np.maximum(np.maximum.reduceat(residual, starts), ZERO)


def _over_time(style: Style, points: int) -> dict[str, Any]:
    """Return the style of a curve with many points: about a dozen small markers."""
    return {**style, "markevery": max(1, points // 12), "markersize": 4, "linewidth": 1.2}


def _styles(items: Sequence[Any], given: Mapping[str, Style] | None) -> dict[str, Style]:
    """Return the given styles, and others for the remaining schemes."""
    return {**styles(item.scheme.name for item in items), **(given or {})}


def _systems(items: Sequence[Any]) -> str:
    return plain(", ".join(dict.fromkeys(item.system.name for item in items)))


def plain(text: str) -> str:
    """Return a text for Matplotlib in which a $ does not begin a formula."""
    return text.replace("$", r"\$")


def with_unit(words: str, items: Iterable[Any], *names: str) -> str:
    """Return a label with the common unit of some quantities of the systems, if it is known."""
    found = {item.system.unit(name) for item in items for name in names}
    (shared,) = found if len(found) == 1 else [None]
    return plain(f"{words} ({shared})" if shared else words)


def _time(items: Iterable[Any]) -> str:
    return with_unit("time t", items, "t")


def several(item: Any, what: str, kind: type) -> list[Any]:
    items = list(item) if isinstance(item, Sequence) and not isinstance(item, str) else [item]
    if not items:
        raise ValueError(f"{what} is empty: expected at least one")
    for one in items:
        require_kind(one, what, kind, " or several")
    return items


def require_kind(item: Any, what: str, kind: type, more: str = "") -> None:
    if not isinstance(item, kind):
        package = kind.__module__.partition(".")[0]
        raise ValueError(
            f"{what} is a {type(item).__name__}; expected a {package}.{kind.__name__}{more}"
        )


def _legend(ax: Axes, title: str | None, entries: tuple[Any, Any] | None = None) -> Axes:
    """Add a legend, inside for a few curves, beside the axes for many."""
    handles, labels = entries or ax.get_legend_handles_labels()
    where: dict[str, Any] = {}
    if len(handles) > 4:
        where = {"loc": "upper left", "bbox_to_anchor": (1.05, 1)}
    ax.legend(handles, labels, title=title, frameon=False, fontsize="small", **where)
    return ax


def axes_for(ax: Axes | None) -> Axes:
    """Return the given axes, or new ones."""
    if ax is None:
        ax = _subplots()
    require_kind(ax, "ax", extras.require("matplotlib.axes", "a picture").Axes)
    return ax


def _subplots(*shape: int, **options: Any) -> Any:
    """Return axes of a new figure."""
    for module in ("matplotlib", "matplotlib.pyplot"):
        found = extras.require(module, "a picture")
    return found.subplots(*shape, layout="constrained", **options)[1]
