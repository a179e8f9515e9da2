"""A study as one self-contained HTML page: no script, no network, the same bytes every time."""

from __future__ import annotations

import hashlib
import json
import platform
import shlex
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import core
from ..core import files
from ..run import Solution, integrate
from ..study import Studies, Study
from . import plot, web
from .table import Column, html, studies_html, study_html

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
    first = studies[0]
    styles = plot.styles(study.scheme.name for study in studies)
    runs = [_run(study) for study in studies]
    longest = max(runs, key=lambda run: run.t[-1])
    return str(
        web.render(
            "report.html",
            studies=studies,
            first=first,
            system=first.system,
            start=", ".join(f"{x} = {q:g}" for x, q in zip(first.system.coordinates, first.q0)),
            velocity=", ".join(f"{v:g}" for v in first.v0),
            initial=repr(initial) if (initial := _initial(studies)) else "",
            convergence=_convergence(studies, styles),
            drift=_drift(runs, styles),
            energy=_energy(studies, runs, styles),
            step=f"{abs(longest.h):g}",
            short=[run.scheme.name for run in runs if run.t[-1] != longest.t[-1]],
            tables=[studies_html(studies), *map(study_html, studies)],
            command=command(studies) if first.system._source.of_library else "",
            data=(data := json.dumps(description(studies), sort_keys=True)),
            facts=_facts(studies, data),
        )
    )


def _run(study: Study) -> Solution:
    """One longer run of the scheme of a study, for the drift and the energy; or what there is."""
    initial = "project" if study.initial == "D_eps" else study.initial
    try:
        with warnings.catch_warnings():
            # The pictures show what the warning would say.
            warnings.simplefilter("ignore", core.DalembertWarning)
            return integrate(
                study.system,
                study.scheme,
                study.q0,
                study.v0,
                t0=study.t0,
                h=(study.t_end - study.t0) / 20,
                steps=400,
                initial=initial,
            )
    except core.DalembertError as error:
        if error.partial is None:
            raise
        return error.partial


def _convergence(studies: Studies, styles: dict[str, Any]) -> str:
    groups = [
        [study for study in studies if study.scheme.order <= 2],
        [study for study in studies if study.scheme.order > 2],
    ]
    groups = [group for group in groups if group]
    figure = web.figure(6.0 * len(groups) if len(groups) > 1 else 8.0, 4.6)
    for group, ax in zip(groups, figure.subplots(1, len(groups), squeeze=False)[0]):
        plot.convergence(group, ax, styles=styles)
        if len(groups) > 1:
            ax.set_title("order up to 2" if group is groups[0] else "compositions")
    return web.svg(figure, "convergence", "Errors at the end over the step size, log-log.")


def _drift(runs: list[Solution], styles: dict[str, Any]) -> str:
    figure = web.figure(12.0, 4.4)
    plot.drift(runs, figure.subplots(1, 2, sharey=True), styles=styles)
    return web.svg(figure, "drift", "Relative residuals of D and of D_eps over time.")


def _energy(studies: Studies, runs: list[Solution], styles: dict[str, Any]) -> str:
    groups: dict[str, list[Solution]] = {}
    for study, run in zip(studies, runs):
        order = study.scheme.order
        key = "order 1 or none" if order < 2 else "order 2" if order == 2 else "order 4 and more"
        groups.setdefault(key, []).append(run)
    figure = web.figure(max(4.0 * len(groups), 8.0), 5.0)
    axes = figure.subplots(1, len(groups), squeeze=False)[0]
    for (title, group), ax in zip(sorted(groups.items()), axes):
        plot.energy(group, ax, styles=styles)
        ax.set_title(title)
        ax.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, frameon=False, fontsize="small"
        )
        if ax is not axes[0]:
            ax.set_ylabel("")
    return web.svg(figure, "energy", "Relative energy error over time.")


def description(studies: Studies) -> dict[str, Any]:
    """Return what determines the numbers of the studies, as plain data."""
    first = studies[0]
    system = first.system
    return {
        "system": system.name,
        "parameters": {key: float(x) for key, x in sorted(system.parameters.items())},
        "n": system.n,
        "m": system.m,
        "q0": first.q0.tolist(),
        "v0": first.v0.tolist(),
        "t0": first.t0,
        "t_end": first.t_end,
        "schemes": [
            {
                "name": x.scheme.name,
                "nodes": x.scheme.nodes,
                "initial": x.initial,
                "substeps": [list(map(float, sub)) for sub in x.scheme.substeps],
                "steps": x.steps.tolist(),
            }
            for x in studies
        ],
    }


def _facts(studies: Studies, data: str) -> Any:
    """What else determines the numbers, as a table."""
    import matplotlib

    parameters = description(studies)["parameters"]
    versions = {
        "dalembert": core.version(),
        "Python": platform.python_version(),
        "NumPy": np.__version__,
        "matplotlib": matplotlib.__version__,
    }
    rows = {
        "versions": ", ".join([*map(" ".join, versions.items()), platform.machine()]),
        "parameters": ", ".join(f"{key} = {x!r}" for key, x in parameters.items()) or "none",
        "SHA-256 of the description": hashlib.sha256(data.encode()).hexdigest(),
    }
    return html(
        [Column("", list(rows), left=True), Column("", list(rows.values()), left=True)],
        style="facts",
    )


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
