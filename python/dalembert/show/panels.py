"""Parts of pages: equations, and plots as narrow panels with a description in words."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..core import Array, extras
from ..run import Solution
from ..study import Study
from ..symbolic import formula
from ..system import System
from . import palette, plot, web
from .table import Table, number

WIDTH = 4.2  # inches: what is written stays readable on 360 points of a screen
COORDINATES = 8  # over time, at most
LONG = 1000  # letters of a formula that SymPy still writes in a moment
ROWS = 2000  # of a run, of which more than these are drawn by some of them


# ---- words -----------------------------------------------------------------------------------


def equations(system: System) -> web.HTML:
    """Return the equations of motion and the formulas in them, or other known facts instead."""
    rows: list[tuple[str, Any]] = [("", web.equation(_MOTION.format(
        force="<mo>+</mo><mi>f</mi>" * system.is_forced, reaction=_REACTION * (system.m > 0)
    )))]  # fmt: skip
    for text in system.formulas:
        line = text.removeprefix("where ")
        whole = f"`{line}`"
        if len(line) > LONG:
            whole = f"{line[:LONG]}... ({len(line)} letters in all)"
        rows.append(("where" * (line != text), whole))
    note = "" if system.formulas else _made_of(system)
    table = Table(["", ""], rows, 2, note=note, style="formulas")
    return web.render("table.html", table=table, coordinates=system.coordinates)


def on_D(system: System) -> list[tuple[str, str]]:
    """Return the equations on D as rows of a table; none if they are not known, or too long."""
    if not extras.is_there("sympy"):
        return []
    with contextlib.suppress(NotImplementedError, ValueError):
        rows = system.reduced().lines()
        if max(len(text) for _, text in rows) <= LONG // 4:
            return [(name, f"`{text}`") for name, text in rows]
    return []


_MOTION = (
    "<mfrac><mi>d</mi><mrow><mi>d</mi><mi>t</mi></mrow></mfrac><msub><mi>L</mi><mi>v</mi></msub>"
    "<mo>=</mo><msub><mi>L</mi><mi>q</mi></msub>{force}{reaction}"
)
_REACTION = (
    "<mo>+</mo><msubsup><mi>φ</mi><mi>v</mi><mi>T</mi></msubsup><mi>λ</mi>"
    "<mo>,</mo><mspace width='1em'/><mi>φ</mi><mo>=</mo><mn>0</mn>"
)


def _made_of(system: System) -> str:
    """Return the known facts about a system without formulas."""
    given = [name for name, x in system._source.named().items() if x is not None]
    parts = ", ".join(["a constant mass"] * system.has_constant_mass + given) or "functions"
    names = ", ".join(system.coordinates[:COORDINATES]) + ", ..." * (system.n > COORDINATES)
    count = f"{system.m} {system.kind} constraint{'s' * (system.m > 1)}" if system.m else "none"
    return (
        f"The system has no formulas, because it is defined by {parts}. Coordinates: {names}; "
        f"constraints: {count}."
    )


def _range(name: str, values: Array, unit: str = "") -> str:
    low, high = float(np.min(values)), float(np.max(values))
    ends = f"from {values[0]:.3g} to {values[-1]:.3g}{unit}"
    return f"{name} {ends}, between {low:.3g} and {high:.3g}"


def unit(system: System, name: str) -> str:
    """Return a unit to put after a number, or ""."""
    return f" {x}" if (x := system.unit(name)) else ""


def label(system: System, name: str) -> str:
    """Return a coordinate and its unit for Matplotlib; theta_x becomes a letter with an index."""
    unit = plot.plain(f" ({x})" if (x := system.unit(name)) else "")
    with contextlib.suppress(ImportError, ValueError):
        if name.isidentifier() and len(name) < 12:  # longer ones are words, not letters
            return f"${formula.latex(name)[0]}${unit}"
    return plot.plain(name) + unit


# ---- one run ---------------------------------------------------------------------------------


def plane(system: System) -> tuple[int, int] | None:
    """Return the indices of the coordinates x and y, if there are any."""
    with contextlib.suppress(ValueError):
        return system.coordinates.index("x"), system.coordinates.index("y")
    return None


def some(run: Solution) -> Any:
    """Return indices of rows spread over a run."""
    return np.unique(np.linspace(0, len(run.x) - 1, min(len(run.x), ROWS)).astype(int))


def _drawn(run: Solution) -> tuple[Solution, str]:
    """Return the part of a run to draw, and in words the omitted part.

    For a long run these are rows spread over it, if linear interpolation reproduces the others to 1
    %.  Otherwise the motion would look slower than it is, and the beginning of the run is drawn.
    """
    count = len(run.x)
    if count <= ROWS:
        return run, ""
    rows, words = some(run), ""
    for values in run.q.T[:COORDINATES]:
        between = np.interp(np.arange(count), rows, values[rows])
        if np.abs(between - values).max() > 0.01 * np.ptp(values):
            rows, words = np.arange(ROWS), f"The first {ROWS} of {count} states."
            break
    reactions = np.zeros((len(rows) - 1, run.system.m))
    part = {"x": np.array(run.x[rows]), "reactions": reactions, "times": run.t[rows]}
    return dataclasses.replace(run, **part), words


@web.default_style()
def motion(run: Solution, name: str, caption: str = "") -> web.HTML:
    """Return the path in the plane of x and y; without these, the coordinates over time."""
    if (where := plane(run.system)) is None:
        return coordinates(run, name, caption)
    run, left = _drawn(run)
    figure = web.figure(WIDTH, 3.6)
    ax = plot.path(run, figure.subplots(), where)
    ax.set_title("")
    ax.get_legend().set_loc("best")
    return web.svg(figure, name, _seen(run, where), f"{caption} {left}".strip())


@web.default_style()
def coordinates(run: Solution, name: str, caption: str = "") -> web.HTML:
    """Return the coordinates over time, in separate panels."""
    run, left = _drawn(run)
    system = run.system
    shown = system.coordinates[:COORDINATES]
    height = 0.8 + 0.75 * len(shown)
    figure = web.figure(WIDTH, height, layout=None)  # which takes half of the time
    figure.subplots_adjust(0.65 / WIDTH, 0.45 / height, 0.97, 1 - 0.25 / height, hspace=0.5)
    axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for k, (x, ax) in enumerate(zip(shown, axes)):
        ax.plot(run.t, run.q[:, k], color=palette.COLOURS[0])
        ax.plot(run.t[:1], run.q[:1, k], color=palette.COLOURS[1], marker="o")
        ax.set_title(label(system, x), loc="right", fontsize="medium", pad=4)
        ax.margins(x=0.02)
        plot.scientific(ax)
    axes[-1].set_xlabel(label(system, "t"))
    return web.svg(figure, name, _seen(run), f"{caption} {left}".strip())


def _seen(run: Solution, where: Sequence[int] | None = None) -> str:
    """Return a description of the path in a plane, or of the coordinates over time."""
    system, times = run.system, f"from t = {run.t[0]:g} to {run.t[-1]:g}"
    names = system.coordinates
    said = "; ".join(
        _range(names[k], run.q[:, k], unit(system, names[k]))
        for k in where or range(min(system.n, COORDINATES))
    )
    what = "Coordinates" if where is None else "Path in the plane of x and y"
    return f"{what} of {system.name} {times}: {said}."


@web.default_style()
def small(run: Solution, name: str) -> web.HTML:
    """Return the path, or some coordinates over time, without axes."""
    figure = web.figure(3.2, 2.2, layout=None)
    ax = figure.add_axes((0.02, 0.02, 0.96, 0.96))
    if where := plane(run.system):
        plot.path(run, ax, where).legend().remove()
        ax.set_title("")
    else:
        ax.plot(run.t[:500], run.q[:500, :4])
    ax.axis("off")
    return web.svg(figure, name, _seen(run, where))


# ---- several ---------------------------------------------------------------------------------


@web.default_style()
def convergence(
    studies: Sequence[Study], name: str, styles: Mapping[str, Any], caption: str = ""
) -> web.HTML:
    """Return errors over step sizes."""
    figure = web.figure(WIDTH, 4.2)
    ax = plot.convergence(studies, figure.subplots(), styles=styles)
    ax.set_title("")
    _legend_below(figure, ax)
    words = f"Errors at the end over the step size, log-log: {'; '.join(map(_falls, studies))}."
    return web.svg(figure, name, words, caption)


def _falls(study: Study) -> str:
    """Return a description of the decrease of the error with the step size."""
    who, drawn, fit = study.scheme.name, np.isfinite(study.state_error), study.fits["global_state"]
    h, error = np.abs(study.h[drawn]), study.state_error[drawn]
    if len(h) == 0:
        return f"{who} has no known errors"
    if fit.exact:
        return f"{who} is exact to roundoff, {number(float(error.max()))} at most"
    clear = np.array(fit.counted)[drawn]
    least = number(float(error.min()))
    rest = "" if clear.all() else f"; the others are at roundoff, {least} at least"
    if clear.sum() < 2:
        return f"{who} has errors from {number(float(error.max()))} down to {least}"
    first, last = (int(f(np.where(clear, h, np.nan))) for f in (np.nanargmax, np.nanargmin))
    at = [f"{number(error[k])} at h = {h[k]:.2g}" for k in (first, last)]
    verb = "falls" if error[last] < error[first] else "goes"
    return f"{who} {verb} with slope {fit.order()} from {at[0]} to {at[1]}{rest}"


@web.default_style()
def residuals(
    runs: Sequence[Solution], name: str, styles: Mapping[str, Any], captions: Sequence[str]
) -> list[web.HTML]:
    """Return the relative residuals of D, and of D_eps if one of the schemes has it.

    With one caption the result has D alone; without constraints it is empty.
    """
    if runs[0].system.m == 0:
        return []
    figures = [web.figure(WIDTH, 3.4) for _ in range(2)]
    axes = [figure.subplots() for figure in figures]
    plot.drift(runs, axes, styles=styles)
    low, high = zip(*(ax.get_ylim() for ax in axes))
    found = []
    for what, figure, ax, caption in zip(("D", "D_ε"), figures, axes, captions):
        ax.set(ylim=(min(low), max(high)), ylabel="relative residual")
        lines, names = ax.get_legend_handles_labels()
        if not names:
            continue
        if len(runs) > 1:
            _legend_below(figure, ax)
        elif ax.get_legend() is not None:
            ax.get_legend().remove()
        tops = (float(max(line.get_ydata())) for line in lines)
        said = "; ".join(f"{who} {number(top)} at most" for who, top in zip(names, tops))
        words = f"Relative residual of {what} over time, log axis: {said}."
        found.append(web.svg(figure, f"{name}-{what}", words, caption))
    return found


@web.default_style()
def energies(
    runs: Sequence[Solution], name: str, styles: Mapping[str, Any], caption: str = ""
) -> web.HTML:
    """Return the relative change of the energy over time, one panel for each scheme."""
    figure = web.figure(WIDTH, 3.4 if len(runs) < 3 else 4.2)
    axes = figure.subplots(len(runs), 1, sharex=True, squeeze=False)[:, 0]
    for run, ax in zip(runs, axes):
        plot.energy([run], ax, styles=styles).get_legend().remove()
        ax.set_title("")
        name_of = plot.plain(run.scheme.name) if len(runs) > 1 else ""
        ax.set_title(name_of, loc="right", fontsize="medium", pad=4)
        figure.supylabel(ax.get_ylabel(), fontsize="medium")
        ax.set(ylabel="", xlabel=ax.get_xlabel() if ax is axes[-1] else "")
    what = "error" if runs[0].system.conserves_energy else "change"
    said = "; ".join(map(_swings, runs))
    return web.svg(figure, name, f"Relative {what} of the energy over time: {said}.", caption)


def _swings(run: Solution) -> str:
    """Return a description of the range of the energy of a run."""
    change = (run.energy - run.energy[0]) / max(abs(run.energy[0]), 1.0)
    low, high, last = (f"{x:.1e}" for x in (change.min(), change.max(), change[-1]))
    return f"{run.scheme.name} between {low} and {high}, {last} at the end"


def _legend_below(figure: Any, ax: Any) -> None:
    """Put the legend of axes below them, in two columns."""
    if ax.get_legend() is not None:
        ax.get_legend().remove()
    entries = ax.get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", ncols=2, frameon=False, fontsize=9)
