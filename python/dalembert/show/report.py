"""A study as a self-contained HTML page: no script, no network, the same bytes every time."""

from __future__ import annotations

import hashlib
import json
import platform
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import core
from ..core import files
from ..core.documentation import Common
from ..run import Solution
from ..run.integration import doubts
from ..study import Studies, Study
from . import panels, plot, web
from .table import Table, of_study, overview

__all__ = ["write"]

MOST = 4  # schemes in one picture


@Common("ValueError, ImportError, OSError")
def write(studies: Study | Studies | Sequence[Study], path: str | Path) -> Path:
    """Write the report of studies on one system as an HTML page.

    The page shows the verdict, the equations and a path.  Plots of the errors, of the residuals of
    D and D_eps, and of the energy follow.  Folded sections have the plots of more than four
    schemes, tables, and the commands that reproduce the report.  For the residuals and the energy
    every scheme runs once more, for 400 steps of a twentieth of the interval.

    Parameters
    ----------
    studies : Study, Studies or sequence of Study
        At least one, all on the same system from the same data.
    path : str or Path
        The file to write.  An existing file is replaced when the page is complete.

    Returns
    -------
    Path
        Path of the file.

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
    studies = Studies(plot.several(studies, "studies", Study))
    names = sorted({study.system.name for study in studies})
    if len(names) > 1:
        raise ValueError(f"studies are on {', '.join(names)}: expected one system")
    path = Path(path)
    files.require_writable(path)
    files.write(path, page(studies))
    return path


def page(studies: Studies) -> str:
    """Return the HTML page of `write`."""
    system = studies[0].system
    title = f"{system.name}: {'fails' if studies.holds is False else 'study'}"
    runs = {id(study): _run(study) for study in studies}
    sections = _sections(studies, runs)
    return web.page(title, "dalembert study", sections, heading=system.name)


def _sections(studies: Studies, runs: dict[int, Solution]) -> Iterator[web.Section]:
    system = studies[0].system
    best = max(runs.values(), key=lambda run: (run.success, run.scheme.order))
    caption = f"A run: {best.scheme.name}, {len(best.x) - 1} steps of h = {_time(best, best.h)}."
    path = panels.motion(best, "path", caption)
    kind = "fails" if studies.holds is False else "holds" if studies.holds else ""
    yield "", "", web.paragraph(studies.sentence(), f"verdict {kind}")
    for study in studies:
        if study.holds is False:
            yield "", "", web.paragraph(f"{study.scheme.name}: {study.text}")
    for study in studies:
        for doubt in doubts(runs[id(study)]):
            yield "", "", web.paragraph(f"{study.scheme.name}, in a longer run: {doubt}")
    yield "", web.sentence(system.help), web.side_by_side([panels.equations(system), path])
    yield "", _about(studies), ""
    styles = plot.styles(study.scheme.name for study in studies)
    first, *more = _in_fours(studies)
    yield "Errors, constraints, energy", _WORDS, _pictures(first, runs, styles, "first")
    for k, some in enumerate(more):
        title = f"{_kind(some[0])}: {', '.join(study.scheme.name for study in some)}"
        yield title, "", [("", "", _pictures(some, runs, styles, f"more{k}"))]
    words = (
        "The order p is the slope of the one-step errors, minus 1. The order s is the same for the "
        "scheme's own multipliers. Only errors at least 100 times above roundoff count. The "
        "verdict is 'holds' under two conditions. First, s, and either p or the order at the end, "
        "are at least the promised orders minus 0.2. Second, the constraint holds to roundoff."
    )
    tables = [("", "", of_study(study)) for study in studies]
    yield "Tables", words, [("", "", overview(studies)), *tables]
    yield "How to reproduce", "", [*_reproduce(studies)]


def _about(studies: Studies) -> str:
    """Return the problem of the studies in words: system, interval and reference."""
    first = studies[0]
    system, unit = first.system, panels.unit
    start = ", ".join(f"{x} = {q:g}{unit(system, x)}" for x, q in zip(system.coordinates, first.q0))
    velocity = ", ".join(
        f"{v:g}{unit(system, f'v_{x}')}" for x, v in zip(system.coordinates, first.v0)
    )
    exact = first.reference == 0
    other = "the exact solution" if exact else f"a reference flow good to {first.reference:.1e}"
    initial = _initial(studies)
    kept = f" Schemes with kept nodes start with `initial={initial!r}`." if initial else ""
    return (
        f"The runs go from t = {first.t0:g} to {first.t_end:g}{unit(system, 't')}. They start at "
        f"{start}, v = ({velocity}), and are compared with {other}.{kept} "
        "Numbers without a unit are in the units of the model."
    )


_WORDS = (
    "The error is the largest component of the error of (q, v) at the end of the interval. The "
    "legend has the fitted orders; hollow markers are too close to roundoff to count. A scheme "
    "with moved nodes satisfies D, and one with kept nodes satisfies D_ε. Schemes with several "
    "sub-steps have no D_ε. The residual plots show the largest residual in each of 50 parts of "
    "a run. Exact zeros are drawn at 1e-17; the dashed line is the unit roundoff u."
)


def _kind(study: Study) -> str:
    """Return the kind of a scheme."""
    order = study.scheme.order
    if study.scheme.nodes == "kept":
        return "Kept nodes"
    return "Order 1 or none" if order < 2 else "Order 2" if order == 2 else "Order 4 and more"


def _in_fours(studies: Studies) -> list[list[Study]]:
    """Return groups of studies for one plot each: failures and one of each kind first."""
    kinds: dict[str, list[int]] = {}
    for k, study in enumerate(studies):
        kinds.setdefault(_kind(study), []).append(k)
    failing = [k for k, study in enumerate(studies) if study.holds is False]
    wanted = [*failing, *(few[0] for few in kinds.values()), *range(len(studies))]
    first = sorted([*dict.fromkeys(wanted)][:MOST])
    fours = [first]
    for few in kinds.values():
        left = [k for k in few if k not in first]
        fours += [left[k : k + MOST] for k in range(0, len(left), MOST)]
    return [[studies[k] for k in some] for some in fours]


def _pictures(
    studies: Sequence[Study], runs: dict[int, Solution], styles: dict[str, Any], name: str
) -> web.HTML:
    """Return plots of the errors, the residuals and the energy of some schemes."""
    these = [runs[id(study)] for study in studies]
    longest = max(these, key=lambda run: run.t[-1])
    short = ", ".join(run.scheme.name for run in these if run.t[-1] != longest.t[-1])
    what = "error" if studies[0].system.conserves_energy else "change"
    energy = (
        f"The {what} of the energy over 400 steps of {_time(longest, abs(longest.h))}, each scheme "
        f"on its own axis.{f' Runs that ended early: {short}.' if short else ''}"
    )
    return web.side_by_side(
        [
            panels.convergence(studies, f"{name}-errors", styles, "Errors over the step size."),
            panels.energies(these, f"{name}-energy", styles, energy),
            *panels.residuals(
                these, name, styles, ["The residual of D.", "The residual of D_ε."]
            ),
        ]
    )


def _time(run: Solution, t: float) -> str:
    return f"{t:g}{panels.unit(run.system, 't')}"


def _run(study: Study) -> Solution:
    """Return a longer run of the scheme of a study, or the states before a failure."""
    return web.run(
        study.system, study.scheme, q0=study.q0, v0=study.v0, t0=study.t0,
        h=(study.t_end - study.t0) / 20, steps=400,
        initial="project" if study.initial == "D_eps" else study.initial,
    )  # fmt: skip


def description(studies: Studies) -> dict[str, Any]:
    """Return the data that determine the numbers of the studies."""
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
    yield "", "" if ours else web.OF_THE_USER, command(studies) if ours else ""
    yield "", "", Table(["", ""], [*facts.items()], 2, style="facts")
    yield "Description", "", [("", "", data)]


def _initial(studies: Studies) -> str | None:
    """Return the meaning of the initial data for schemes with kept nodes."""
    return next((study.initial for study in studies if study.initial), None)


def command(studies: Studies) -> str:
    """Return the command line that repeats these studies of a built-in system."""
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
