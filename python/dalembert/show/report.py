"""A study as one self-contained HTML page: no script, no network, the same bytes every time."""

from __future__ import annotations

import hashlib
import json
import platform
import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import core
from ..core import files
from ..run import Solution
from ..study import Studies, Study
from . import plot, web
from .table import Table, of_study, overview

__all__ = ["write"]


def write(studies: Studies | Sequence[Study], path: str | Path) -> Path:
    """Write the report of studies on one system as an HTML page.

    The verdict is the first sentence; then come the convergence picture, the drift of D and
    D_eps, the energy, the tables, and how to reproduce all this.  For the drift and the energy
    every scheme runs once more, 400 steps of a twentieth of the interval each.

    Parameters
    ----------
    studies : Studies or sequence of Study
        At least one, all on the same system from the same data.
    path : str or Path
        The file to write; one that is there is replaced when the page is complete.

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    ValueError
        If there is no study, or they are not on one system.
    ImportError
        If matplotlib or Jinja2 is not installed; the text has the line to type.
    OSError
        If the file cannot be written; the text has its name.

    Examples
    --------
    >>> import dalembert as dal, tempfile, pathlib
    >>> found = dal.studies(dal.systems.particle(), ["midpoint"])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     text = dal.report.write(found, pathlib.Path(folder) / "report.html").read_text()
    >>> text.startswith("<!DOCTYPE html>")
    True
    """
    web.require()
    studies = Studies(studies)
    if not studies:
        raise ValueError("studies is empty; expected at least one")
    names = sorted({study.system.name for study in studies})
    if len(names) > 1:
        raise ValueError(f"studies are on {', '.join(names)}; expected one system")
    path = Path(path)
    files.require_writable(path)
    files.write(path, page(studies))
    return path


def page(studies: Studies) -> str:
    """Return the HTML page of `write`."""
    name = studies[0].system.name
    title = f"{name}: {'fails' if studies.holds is False else 'study'}"
    above, heading = f"dalembert study: {name}", studies.sentence()
    return web.page(title, above, _sections(studies), heading=heading)


def _sections(studies: Studies) -> Iterator[web.Section]:
    yield "", _about(studies), ""
    yield from _pictures(studies)
    words = (
        "p and s are slopes of the one-step errors from exact data, minus 1, over the points at "
        "least 100 times above the round-off floor; s is the order of the scheme's own "
        "multipliers. A scheme holds if p, or the order at the end, and s are at least the "
        "promised ones minus 0.2 and its set is kept to roundoff."
    )
    yield "Tables", words, overview(studies)
    for study in studies:
        yield "", "", of_study(study)
    yield from _reproduce(studies)


def _about(studies: Studies) -> str:
    """What was studied, from where to where, and what it is compared with."""
    first = studies[0]
    start = ", ".join(f"{x} = {q:g}" for x, q in zip(first.system.coordinates, first.q0))
    velocity = ", ".join(f"{v:g}" for v in first.v0)
    exact = first.reference == 0
    other = "the exact solution" if exact else f"a reference flow good to {first.reference:.1e}"
    initial = _initial(studies)
    kept = f" Schemes with kept nodes start with `initial={initial!r}`." if initial else ""
    return (
        f"{web.sentence(first.system.help)} Runs go from t = {first.t0:g} to {first.t_end:g}, "
        f"start in {start}, v = ({velocity}), and are compared with {other}.{kept} All numbers "
        "are in the user's units."
    )


def _pictures(studies: Studies) -> Iterator[web.Section]:
    styles = plot.styles(study.scheme.name for study in studies)
    yield "Convergence", "", web.svg(
        _by_order(studies, plot.convergence, styles),
        "convergence",
        "Errors at the end over the step size, log-log.",
        "The largest error of (q, v) at the end of the interval. Triangles have whole slopes; "
        "hollow markers lie too close to roundoff to count for the fitted order in the legend.",
    )
    runs = [_run(study) for study in studies]
    figure = web.figure(12.0, 4.4)
    plot.drift(runs, figure.subplots(1, 2, sharey=True), styles=styles)
    yield "Drift of D and D_eps", "", web.svg(
        figure,
        "drift",
        "Relative residuals of D and of D_eps over time.",
        "The relative residual of the constraint in D (left) and in D_eps (right). A scheme with "
        "moved nodes keeps D, one with kept nodes D_eps. Of each run the largest residual in each "
        "of 50 stretches is drawn; exact zeros are drawn at 1e-17, the dashed line is the unit "
        "roundoff u. Schemes with several sub-steps have no D_eps.",
    )
    longest = max(runs, key=lambda run: run.t[-1])
    short = ", ".join(run.scheme.name for run in runs if run.t[-1] != longest.t[-1])
    what = "error" if all(run.system.conserves_energy for run in runs) else "change"
    yield "Energy", "", web.svg(
        _by_order(runs, plot.energy, styles),
        "energy",
        f"Relative energy {what} over time.",
        f"The {what} of the energy over 400 steps of {abs(longest.h):g}, each panel on its own "
        f"linear axis.{f' Runs that broke off: {short}.' if short else ''}",
    )


def _by_order(items: Sequence[Any], draw: Callable[..., Any], styles: dict[str, Any]) -> Any:
    """A figure with a panel for each kind of schemes that there is."""
    groups: dict[str, list[Any]] = {}
    for item in items:
        order = item.scheme.order
        key = "order 1 or none" if order < 2 else "order 2" if order == 2 else "order 4 and more"
        groups.setdefault(key, []).append(item)
    figure = web.figure(max(4.0 * len(groups), 8.0), 5.0)
    axes = figure.subplots(1, len(groups), squeeze=False)[0]
    for title, ax in zip(sorted(groups), axes):
        draw(groups[title], ax, styles=styles)
        ax.set_title(title)
        ax.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, frameon=False, fontsize="small"
        )
        if ax is not axes[0]:
            ax.set_ylabel("")
    return figure


def _run(study: Study) -> Solution:
    """One longer run of the scheme of a study, for the drift and the energy; or what there is."""
    return web.run(
        study.system, study.scheme, q0=study.q0, v0=study.v0, t0=study.t0,
        h=(study.t_end - study.t0) / 20, steps=400,
        initial="project" if study.initial == "D_eps" else study.initial,
    )  # fmt: skip


def description(studies: Studies) -> dict[str, Any]:
    """Return what determines the numbers of the studies, as plain data."""
    first, *_ = told = [study.to_dict() for study in studies]
    same = ("system", "parameters", "q0", "v0", "t0", "t_end")
    each = ("scheme", "nodes", "initial", "steps")
    schemes = [
        {**{key: x[key] for key in each}, "substeps": [*map(list, study.scheme.substeps)]}
        for x, study in zip(told, studies)
    ]
    return {**{key: first[key] for key in same}, "schemes": schemes}


def _reproduce(studies: Studies) -> Iterator[web.Section]:
    import matplotlib

    data = json.dumps(description(studies), sort_keys=True)
    parameters = studies[0].system.parameters
    facts = {
        "versions": f"dalembert {core.version()}, Python {platform.python_version()}, NumPy "
        f"{np.__version__}, matplotlib {matplotlib.__version__}, {platform.machine()}",
        "parameters": ", ".join(f"{key} = {x!r}" for key, x in parameters.items()) or "none",
        "SHA-256 of the description": hashlib.sha256(data.encode()).hexdigest(),
    }
    ours = studies[0].system._source.of_library
    words, line = ("", command(studies)) if ours else (web.OF_THE_USER, "")
    yield "How to reproduce", words, line
    yield "", "", Table(["", ""], [*facts.items()], 2, style="facts")
    yield "", "", data


def _initial(studies: Studies) -> str | None:
    """What schemes with kept nodes start with."""
    return next((study.initial for study in studies if study.initial), None)


def command(studies: Studies) -> str:
    """Return the command line that makes these studies of a built-in system again."""
    first = studies[0]
    words = ["dalembert", "study", first.system.name]
    for key, x in first.system.parameters.items():
        words += ["--parameter", f"{key}={float(x)!r}"]
    for key, values in (("--q0", first.q0), ("--v0", first.v0)):
        words.append(f"{key}={','.join(repr(float(x)) for x in values)}")
    words += ["--t-end", repr(float(first.t_end))]
    for study in studies:
        words += ["--scheme", study.scheme.name]
    if initial := _initial(studies):
        words += ["--initial", initial]
    if len({tuple(study.steps.tolist()) for study in studies}) == 1 and len(studies) > 1:
        words += ["--steps", ",".join(map(str, first.steps.tolist()))]
    return shlex.join(words)
