"""A study as one self-contained HTML page: no script, no network, the same bytes every time."""

from __future__ import annotations

import hashlib
import html
import json
import platform
import shlex
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from . import core, web
from .core import files
from .show import plot
from .run.integration import integrate
from .run.solution import Solution
from .study.study import Studies, Study
from .table import studies_html, study_html

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
        If matplotlib is not installed; the text has the line to type.
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
    plot.require_matplotlib()
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
    system = first.system
    styles = plot.styles(study.scheme.name for study in studies)
    runs = [_run(study) for study in studies]
    longest = max(runs, key=lambda run: run.t[-1])
    text = html.escape
    start = ", ".join(f"{name} = {x:g}" for name, x in zip(system.coordinates, first.q0))
    velocity = ", ".join(f"{x:g}" for x in first.v0)
    reference = (
        "the exact solution"
        if first.reference == 0
        else f"a reference flow good to {first.reference:.1e}"
    )
    about = f"{system.help[:1].upper()}{system.help[1:]}. " if system.help else ""
    kept = {study.initial for study in studies if study.initial}
    kept_note = (
        f" Schemes with kept nodes start with <code>initial={text(repr(sorted(kept)[0]))}</code>."
        if kept
        else ""
    )
    title = f"{system.name}: {'fails' if studies.holds is False else 'study'}"
    body = f"""<p class="eyebrow">dalembert study: {text(system.name)}</p>
<h1>{text(studies.sentence())}</h1>
<p>{text(about)}Runs go from t = {first.t0:g} to {first.t_end:g}, start in {text(start)},
v = ({text(velocity)}), and are compared with {reference}.{kept_note} All numbers are in the
user's units.</p>

<h2>Convergence</h2>
{_convergence(studies, styles)}

<h2>Drift of D and D<sub>ε</sub></h2>
{_drift(runs, styles)}

<h2>Energy</h2>
{_energy(studies, runs, styles, longest)}

<h2>Tables</h2>
<p class="note">p and s are slopes of the one-step errors from exact data, minus 1, over the points
at least 100 times above the round-off floor; s is the order of the scheme's own multipliers. A
scheme holds if p, or the order at the end, and s are at least the promised ones minus 0.2 and its
set is kept to roundoff.</p>
{studies_html(studies)}
{"".join(study_html(study) for study in studies)}

<details>
<summary>How to reproduce</summary>
{_reproduce(studies)}
</details>"""
    return web.page(title, body)


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
    return web.svg(
        figure,
        "convergence",
        "Errors at the end over the step size, log-log.",
        "The largest error of (q, v) at the end of the interval. Triangles have whole "
        "slopes; hollow markers lie too close to roundoff to count for the fitted order in "
        "the legend.",
    )


def _drift(runs: list[Solution], styles: dict[str, Any]) -> str:
    figure = web.figure(12.0, 4.4)
    plot.drift(runs, figure.subplots(1, 2, sharey=True), styles=styles)
    return web.svg(
        figure,
        "drift",
        "Relative residuals of D and of D_eps over time.",
        "The relative residual of the constraint in D (left) and in D<sub>ε</sub> "
        "(right). A scheme with moved nodes keeps D, one with kept nodes D<sub>ε</sub>. Of "
        "each run the largest residual in each of 50 stretches is drawn; exact zeros are "
        "drawn at 10<sup>−17</sup>, the dashed line is the unit roundoff u. Schemes "
        "with several sub-steps have no D<sub>ε</sub>.",
    )


def _energy(
    studies: Studies, runs: list[Solution], styles: dict[str, Any], longest: Solution
) -> str:
    groups: dict[str, list[Solution]] = {}
    for study, run in zip(studies, runs):
        order = study.scheme.order
        key = "order 1 or none" if order < 2 else "order 2" if order == 2 else "order 4 and more"
        groups.setdefault(key, []).append(run)
    figure = web.figure(max(4.0 * len(groups), 8.0), 5.0)
    short = []
    for (title, group), ax in zip(
        sorted(groups.items()), figure.subplots(1, len(groups), squeeze=False)[0]
    ):
        plot.energy(group, ax, styles=styles)
        ax.set_title(title)
        if ax is not ax.figure.axes[0]:
            ax.set_ylabel("")
        ax.legend(
            loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, frameon=False, fontsize="small"
        )
        short += [run.scheme.name for run in group if run.t[-1] != longest.t[-1]]
    broken = f" Runs that broke off: {html.escape(', '.join(short))}." if short else ""
    return web.svg(
        figure,
        "energy",
        "Relative energy error over time.",
        f"The error of the energy over 400 steps of {abs(longest.h):g}, each panel on its "
        f"own linear axis.{broken}",
    )


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


def _reproduce(studies: Studies) -> str:
    import matplotlib

    first = studies[0]
    system = first.system
    data = description(studies)
    digest = hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
    parameters = ", ".join(f"{key} = {x!r}" for key, x in data["parameters"].items()) or "none"
    versions = (
        f"dalembert {core.version()}, Python "
        f"{platform.python_version()}, NumPy {np.__version__}, matplotlib "
        f"{matplotlib.__version__}, {platform.machine()}"
    )
    if system._source.of_library:
        how = f"<pre>{html.escape(command(studies))}</pre>"
    else:
        how = (
            "<p>The system is one of the user's own: the program that made it belongs to this "
            "page.</p>"
        )
    return f"""{how}
<table>
<tr><td class="left">versions</td><td class="left">{html.escape(versions)}</td></tr>
<tr><td class="left">parameters</td><td class="left">{html.escape(parameters)}</td></tr>
<tr><td class="left">SHA-256 of the description</td><td class="left"><code>{digest}</code></td></tr>
</table>
<pre>{html.escape(json.dumps(data, sort_keys=True))}</pre>"""


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
    initial = next((study.initial for study in studies if study.initial), None)
    if initial:
        words += ["--initial", initial]
    if len({tuple(study.steps.tolist()) for study in studies}) == 1 and len(studies) > 1:
        words += ["--steps", ",".join(map(str, first.steps.tolist()))]
    return shlex.join(words)
