"""Pages about systems: description and a typical run, as HTML.

A page is self-contained: it needs no network, has the same bytes every time, and no script except
that of its film.
"""

from __future__ import annotations

import collections
import contextlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import core, growth, systems
from ..core import extras, files, require_system
from ..core.documentation import Common
from ..core.extras import Progress
from ..geometry import Check
from ..run import Solution
from ..run.integration import doubts
from ..symbolic import formula
from ..system import System
from . import film_page, panels, plot, web
from .scene import make_scene
from .table import Table, number

__all__ = ["available", "page", "write"]

# The typical run, and the accurate one; the times at which both are compared with what is known.
END, TIMES = 20, (1, 10)
SCHEME, STEP = "leapfrog", 0.02
FINE, FINE_STEP = "leapfrog-kl8", 0.05
FPS, FRAMES = 20, 120  # of the film
ON_D = (
    "The velocities in a basis of the kernel of the constraints, in closed form, and the rates of "
    "their components w (Hamel's equations). The scheme \"taylor\" integrates them."
)


@Common("ValueError, ImportError, OSError")
def write(
    folder: str | Path = "catalogue",
    chosen: str | System | Iterable[str | System] | None = None,
    *,
    progress: Progress = False,
) -> list[Path]:
    """Write a page for each system, and an index.

    Parameters
    ----------
    folder : str or Path, optional
        Folder for index.html and the pages NAME.html.  It is created if necessary; files of these
        names are replaced.
    chosen : str, System or iterable of them, optional
        Names of systems, or systems with initial data.  Default: all systems of the library; those
        written in SymPy only if it is installed.

    Returns
    -------
    list of Path
        Paths of the files, the index first.

    Raises
    ------
    ValueError
        If a name is unknown, a system has no initial data, two have the same name, one is called
        "index", or there are none.

    Examples
    --------
    >>> import dalembert as dal, pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     [path.name for path in dal.pages.write(place, ["disk", "sleigh"])]
    ['index.html', 'disk.html', 'sleigh.html']
    """
    web.require()
    if isinstance(chosen, (str, System)):
        chosen = [chosen]
    found = list(available() if chosen is None else chosen)
    names = [_slug(x) if isinstance(x, System) else systems.plain_name(x) for x in found]
    if not names:
        raise ValueError("chosen is empty; expected at least one system")
    name, count = collections.Counter(names).most_common(1)[0]
    if count > 1:
        raise ValueError(f"chosen: {name} occurs {count} times; expected different systems")
    if "index" in names:
        raise ValueError(
            "chosen: the name index is reserved for the list of all pages; rename the system"
        )
    for x, name in zip(found, names):
        if isinstance(x, System):
            _require_start(x)
        elif name not in available():
            systems.get(name)  # says what it needs
    place = Path(folder)
    files.require_folder(place)
    place.mkdir(exist_ok=True)
    for name in ("index", *names):
        files.require_writable(place / f"{name}.html")
    index = place / "index.html"
    paths, cards = [index], []
    with extras.progress(progress, len(names), "page") as show:
        for k, (x, name) in enumerate(zip(found, names)):
            show(k)
            system = x if isinstance(x, System) else systems.get(x)
            run = web.run(system, SCHEME, h=STEP, t_end=END)
            paths.append(place / f"{name}.html")
            files.write(paths[-1], _page(system, run, names))
            cards.append((name, system, panels.small(run, f"small-{_slug(system)}")))
        files.write(index, _index(cards))
        show(len(names))
    return paths


def available() -> tuple[str, ...]:
    """Return the names of all systems available in this installation.

    Examples
    --------
    >>> import dalembert as dal
    >>> "sleigh" in dal.pages.available()
    True
    """
    more = systems.names_in_sympy() if extras.is_there("sympy") else ()
    return (*systems.names(), *more)


@Common("ValueError, ImportError")
def page(system: System) -> str:
    """Return the page of a system as HTML.

    Examples
    --------
    >>> import dalembert as dal
    >>> text = dal.pages.page(dal.systems.disk(R=0.5))
    >>> "dal.systems.disk(R=0.5)" in text
    True
    """
    web.require()
    require_system(system)
    _require_start(system)
    return _page(system, web.run(system, SCHEME, h=STEP, t_end=END), ())


def _require_start(system: System) -> None:
    if system.q0 is None:
        raise ValueError(
            f"the system {system.name!r} has no default initial data, which its page needs"
        )


def _slug(system: System) -> str:
    """Return the name of a system as a file name."""
    return re.sub(r"[^\w-]", "_", system.name)


def _index(cards: Sequence[tuple[str, System, web.HTML]]) -> str:
    words = (
        f"{len(cards)} mechanical systems with velocity constraints. Each page has the "
        "formulas, initial data, invariants, the exact or a reference solution, and the code "
        "in Python and C."
    )
    sections = [("", words, web.render("cards.html", cards=cards))]
    return web.page("Catalogue of systems", f"dalembert {core.version()}", sections)


def _page(system: System, run: Solution, names: Sequence[str]) -> str:
    library = (*systems.names(), *systems.names_in_sympy())
    links = {**dict.fromkeys(library, ""), **{name: f"{name}.html" for name in names}}
    above = [f"dalembert {core.version()}"]
    if names:
        k = names.index(_slug(system))
        links["catalogue"] = "index.html"
        above += ["`catalogue`", *(f"before: `{name}`" for name in names[:k][-1:])]
        above += [f"next: `{name}`" for name in names[k + 1 :][:1]]
    return web.page(
        system.name,
        " | ".join(above),
        _sections(system, run),
        coordinates=system.coordinates,
        links=links,
    )


def _sections(system: System, run: Solution) -> Iterator[web.Section]:
    runs = (run, web.run(system, FINE, h=FINE_STEP, t_end=END))
    unit = panels.unit(system, "t")
    broken = "" if run.success else f" It ended early at t = {run.t[-1]:g}{unit}: {run.message}."
    caption = f"A typical run: {SCHEME} with h = {STEP:g}{unit} to t = {END}{unit}.{broken}"
    caption += "".join(f" Doubtful: {x}." for x in doubts(run))
    path = panels.motion(run, f"run-{_slug(system)}", caption)
    yield "", web.sentence(system.help), web.side_by_side([panels.equations(system), path])
    yield "", system.description, ""
    yield "", f"Source: {web.sentence(system.source)}" if system.source else "", ""
    scene = make_scene(run, None, None, FRAMES, multipliers=True, scale=None)
    yield "In motion", "", film_page.frame(scene, FPS, trail=True)
    yield "The run", "", web.side_by_side(_pictures(system, run))
    if rows := panels.on_D(system):
        yield "Equations on D", ON_D, [("", "", Table(["", ""], rows, 2, style="formulas"))]
    yield "What it is", "", [("", "", Table(["", ""], _facts(system), 2, style="facts"))]
    yield "Parameters and initial data", "", [*_given(system)]
    invariants, words, table = _invariants(system, runs)
    yield invariants, words, [("", "", table)]
    for title, words, table in (*_known(system), *_accuracy(system, runs)):
        yield title, words, [("", "", table)]
    yield "How to create it", "" if system._source.of_library else web.OF_THE_USER, ""
    if system._source.of_library:
        yield from _programs(system, run)


def _pictures(system: System, run: Solution) -> Iterator[web.HTML]:
    """Yield plots of the conserved quantities, and of the coordinates unless they were shown."""
    slug, styles = _slug(system), plot.styles([run.scheme.name])
    drift = "The error of the energy."
    if not system.conserves_energy:
        drift = "The change of the energy, which is not conserved here."
    words = "The relative residual of the constraints; the dashed line is the unit roundoff u."
    below = panels.energies([run], f"energy-{slug}", styles, drift)
    for kept in panels.residuals([run], f"residual-{slug}", styles, [words]):
        below = kept + below
    yield below
    if panels.plane(system) is not None:
        some = f"The first {panels.COORDINATES} coordinates" * (system.n > panels.COORDINATES)
        yield panels.coordinates(run, f"q-{slug}", f"{some or 'The coordinates'} over time.")


def _given(system: System) -> Iterator[web.Section]:
    """Yield the parameters and the initial data, with known units."""
    values = [(f"`{key}`", f"{x:.15g}") for key, x in system.parameters.items()]
    if values:
        yield "", "", Table(["parameter", "value"], values)
    assert system.q0 is not None and system.v0 is not None
    rows = [
        (f"`{name}`", f"{q:.15g}{panels.unit(system, name)}",
         f"{v:.15g}{panels.unit(system, f'v_{name}')}")
        for name, q, v in zip(system.coordinates, system.q0, system.v0)
    ]  # fmt: skip
    yield "", "", Table(["coordinate", "at the start", "its velocity"], rows)


def _facts(system: System) -> list[tuple[str, str]]:
    """Return facts about the system and the results of its check."""
    found = system.check()
    rows = [
        ("coordinates", str(system.n)),
        ("constraints", f"{system.m}, {system.kind}" if system.m else "none"),
        ("mass matrix", "constant" if system.has_constant_mass else "depends on the coordinates"),
    ]
    if system.is_forced:
        rows.append(("force", "besides that of the Lagrangian"))
    if system.m and system.kind == "linear" and not system.is_driven:
        curved = (
            "integrable: the constraint may be holonomic"
            if found.integrable
            else f"not integrable: curvature {found.curvature:.3g} at the start"
        )
        rows.append(("D", curved))
        rows += _distribution(system, found)
    if system.m:
        rows.append(("rank and condition of μ", f"{found.rank}, {found.condition:.3g}"))
    rows.append(("examination at the start", ("passed: " if found else "failed: ") + found.text))
    return rows


def _distribution(system: System, found: Check) -> list[tuple[str, str]]:
    """Return facts about the growth of D by brackets."""
    grown = found.growth
    if grown is None:
        return []
    if grown[-1] == system.n:
        what = "D is bracket generating"
    elif growth.is_settled(grown, system.n):
        what = f"D lies in a foliation by leaves of dimension {grown[-1]}"
    else:
        what = found.growth_note
    how = "proved" if found.exact else f"seen at random points, to {found.digits} digits"
    return [
        ("growth vector of D", f"{grown}: {what}; {how}"),
        *(("holonomic in disguise", text) for text in found.holonomic),
    ]


def _invariants(system: System, runs: Sequence[Solution]) -> web.Section:
    """Return the first integrals, and their drift in the typical and in the accurate run."""
    conserved = system.conserves_energy
    values = [
        {**({"energy": x.energy} if conserved else {}), **system.invariant(x.q, x.v, x.t)}
        for x in runs
    ]
    rows = [
        (
            name if name == "energy" else _invariant(system, name),
            f"{values[0][name][0]:.10g}",
            *(number(float(np.abs(x[name] - x[name][0]).max())) for x in values),
        )
        for name in values[0]
    ]
    words = f"The drift is the largest change from t = 0 to {END}." if rows else "None is known."
    if not conserved:
        why = "there is a force" if system.is_forced else "the constraints do work"
        why = "inputs drive the constraints" if system.is_driven else why
        why = "the system depends on time" if system.is_time_dependent else why
        words += f" The energy is not conserved: {why}."
    drifts = [f"drift of {SCHEME}, h = {STEP:g}", f"of {FINE}, h = {FINE_STEP:g}"]
    return "Invariants", words, Table(["invariant", "at the start", *drifts], rows)


def _invariant(system: System, name: str) -> str:
    """Return an invariant by its name, and by its expression too if that has abbreviations."""
    velocities = {f"v_{x}" for x in system.coordinates}
    with contextlib.suppress(ImportError, ValueError):
        names = {x.name for side in formula.read(name) for x in side.free_symbols}
        if names <= {*system.coordinates, *velocities, *system.parameters}:
            return f"`{name}`"
    model = system._model
    if model is None or len(model.invariants) != len(system.invariants):
        return f"`{name}`"
    return f"`{name}`\n= `{model.formula(model.invariants[system.invariants.index(name)])}`"


# ---- what is known of the solution ---------------------------------------------------------------


def _known_states(system: System) -> tuple[systems.KnownState, ...]:
    """Return the states to 30 digits of a system of the library with its default parameters."""
    if not system._source.of_library or systems.get(system.name).parameters != system.parameters:
        return ()
    return systems.known_states(system.name)


def _known(system: System) -> Iterator[web.Section]:
    """Yield the reference solution to 30 digits."""
    if states := _known_states(system):
        rows = [
            (f"`{shown}`", *(getattr(x, letter)[i] for x in states))
            for i, name in enumerate(system.coordinates)
            for letter, shown in (("q", name), ("v", f"v_{name}"))
        ]
        titles = ["", *(f"t = {x.t:g}" for x in states)]
        yield (
            "Reference to 30 digits",
            "Starts from the initial data. Parameters and data are exact decimals. Taylor "
            "series and extrapolation agree to the digits shown.",
            Table(titles, rows, len(titles), style="digits"),
        )


def _accuracy(system: System, runs: Sequence[Solution]) -> Iterator[web.Section]:
    """Yield the distances of runs from the exact solution and from the reference."""
    known: dict[str, Callable[[float], Any]] = {}
    if system.has_exact:
        known["the exact solution"] = lambda t: np.concatenate(system.exact(float(t)))
    if states := _known_states(system):
        known["the reference"] = {x.t: np.array([*x.q, *x.v], dtype=float) for x in states}.get
    rows = [
        (f"{run.scheme.name}, h = {run.h:g}, from {what}", *(_distance(run, at, t) for t in TIMES))
        for what, at in known.items()
        for run in runs
    ]
    if rows:
        words = "There is an exact solution for all initial data: `system.exact(t)`."
        titles = ["largest difference of (q, v)", *(f"t = {t:g}" for t in TIMES)]
        yield "Accuracy", words if system.has_exact else "", Table(titles, rows)


def _distance(run: Solution, at: Callable[[float], Any], t: float) -> str:
    """Return the distance of a run from the exact state at a time, if the run reached it."""
    k = round(t / run.h)
    return number(float(np.abs(run.x[k] - at(t)).max())) if k < len(run.x) else "-"


# ---- how to make it ------------------------------------------------------------------------------


def _programs(system: System, run: Solution) -> Iterator[web.Section]:
    yield "", "In Python, system and run:", python_lines(system)
    words = "In C"
    if system._model is not None:
        words = "In C, with the file that Python writes, system.c_source()"
    end = "\n".join(
        f"{name:12} {q: .17g}  {v: .17g}"
        for name, q, v in zip(system.coordinates, run.q[-1], run.v[-1])
    )
    both = f"Both end at t = {run.t[-1]:g} in (coordinate, its velocity):"
    yield words, "", [("", "", c_lines(system)), ("", both, end)]


def _changed(system: System) -> dict[str, float]:
    """Return the parameters that differ from those of the library."""
    default = systems.get(system.name).parameters
    return {key: x for key, x in system.parameters.items() if x != default[key]}


def python_lines(system: System) -> str:
    """Return the Python program that creates a system of the library and its typical run."""
    values = ", ".join(f"{key}={x!r}" for key, x in _changed(system).items())
    return f"""import dalembert as dal

system = dal.systems.{system.name}({values})
run = dal.integrate(system, {SCHEME!r}, h={STEP!r}, t_end={END})
print(run.x[-1])"""


def c_lines(system: System) -> str:
    """Return the C program that does the same."""
    changed = _changed(system) if system._model is None else None
    values = {"scheme": SCHEME, "h": STEP, "steps": round(END / STEP)}
    return str(web.render("program.txt", system=system, changed=changed, **values))
