"""The pages of systems: what each says about itself, and a typical run, as HTML.

A page is self-contained: no script, no network, the same bytes every time.
"""

from __future__ import annotations

import functools
import html
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from . import core, formula, growth, systems, web
from .core import extras, files
from .show import plot
from .core import Array
from .geometry.examination import Check
from .run.integration import integrate
from .run.solution import Solution
from .core import require_system
from .system import System
from .table import number

__all__ = ["available", "page", "write"]

# The typical run, and the accurate one; the times at which both are compared with what is known.
END, TIMES = 20, (1, 10)
SCHEME, STEP = "leapfrog", 0.02
FINE, FINE_STEP = "leapfrog-kl8", 0.05
SHOWN = 8  # coordinates over time, at most

CSS = """
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(16.5rem, 1fr));
         gap: 1rem; padding: 0; }
.card { border: 1px solid #bbb; padding: .6rem .8rem .7rem; display: block; color: inherit;
        text-decoration: none; }
.card:hover, .card:focus { border-color: #111; }
.card h2 { border: 0; margin: .4rem 0 .1rem; font-size: 1.05rem; text-decoration: underline; }
.card p { margin: 0 0 .3rem; font-size: .92rem; line-height: 1.4; }
.card .note { font: .8rem/1.4 system-ui, sans-serif; }
.card figure { margin: 0; }
math { font-family: math, "Cambria Math", "STIX Two Math", "Latin Modern Math", "STIX Math",
       serif; }
.formulas { overflow-x: auto; padding: .2rem 0; }
.formulas math { margin: .7rem 0 .7rem 1.5rem; width: max-content; font-size: 1.08em; }
td math { font-size: 1.15em; }
.facts td { vertical-align: top; padding: .12rem 1.1rem .12rem 0; }
.facts td + td { white-space: normal; }
.digits td { font-family: ui-monospace, "DejaVu Sans Mono", monospace; }
nav { font: .85rem/1.5 system-ui, sans-serif; margin-top: 2.5rem; border-top: 1px solid #bbb;
      padding-top: .5rem; }
"""


def write(
    folder: str | Path = "catalogue",
    chosen: str | System | Iterable[str | System] | None = None,
    *,
    progress: bool | Callable[[int, int], Any] = False,
) -> list[Path]:
    """Write a page for each system, and an index of them.

    Parameters
    ----------
    folder : str or Path, optional
        Where index.html and the pages NAME.html go; made if it is not there, files of these names
        are replaced.
    chosen : str, System or iterable of them, optional
        Names of systems, or systems with initial data.  Default: all that come with the library,
        but those written in SymPy only if that is installed.
    progress : bool or callable, optional
        True: a bar of tqdm.  A function is called as ``progress(done, total)`` with numbers of
        pages, before each and at the end.

    Returns
    -------
    list of Path
        Of the files, the index first.

    Raises
    ------
    ValueError
        If there is no system of a name, a system has no initial data, two have the same name, one
        is called index, or there are none.
    ImportError
        If matplotlib is not installed, or SymPy and a system needs it; the text has the line to
        type.
    OSError
        If a file cannot be written; the text has its name.

    Examples
    --------
    >>> import dalembert as dal, pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as place:
    ...     [path.name for path in dal.pages.write(place, ["disk", "sleigh"])]
    ['index.html', 'disk.html', 'sleigh.html']
    """
    plot.require_matplotlib()
    if isinstance(chosen, (str, System)):
        chosen = [chosen]
    found = list(available() if chosen is None else chosen)
    names = [_slug(x) if isinstance(x, System) else systems.plain_name(x) for x in found]
    if not names:
        raise ValueError("chosen is empty; expected at least one system")
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"chosen: {name} is there {names.count(name)} times")
    if "index" in names:
        raise ValueError("chosen: a system is called index, as the list of all pages is")
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
            run = _run(system, SCHEME, STEP)
            paths.append(place / f"{name}.html")
            files.write(paths[-1], _page(system, run, names))
            cards.append(_card(system, run))
        files.write(index, _index(cards))
        show(len(names))
    return paths


def available() -> tuple[str, ...]:
    """Return the names of all systems that can be made here.

    Examples
    --------
    >>> import dalembert as dal
    >>> "sleigh" in dal.pages.available()
    True
    """
    more = systems.names_in_sympy() if extras.is_there("sympy") else ()
    return (*systems.names(), *more)


def page(system: System) -> str:
    """Return the page of a system as HTML.

    Parameters
    ----------
    system : System
        With initial data.

    Raises
    ------
    ValueError
        If it is no system, or has no initial data.
    ImportError
        If matplotlib is not installed; the text has the line to type.

    Examples
    --------
    >>> import dalembert as dal
    >>> text = dal.pages.page(dal.systems.disk(R=0.5))
    >>> "dal.systems.disk(R=0.5)" in text
    True
    """
    plot.require_matplotlib()
    require_system(system)
    _require_start(system)
    return _page(system, _run(system, SCHEME, STEP), ())


def _require_start(system: System) -> None:
    if system.q0 is None:
        raise ValueError(f"the system {system.name!r} has no initial data, which its page needs")


def _slug(system: System) -> str:
    """Return the name of a system as that of a file."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", system.name)


def _run(system: System, scheme: str, h: float) -> Solution:
    """Return a run, or as much of it as there is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", core.DalembertWarning)  # the page shows what it would say
        return integrate(system, scheme, h=h, t_end=END, throw=False)


# ---- the index ---------------------------------------------------------------------------------


def _index(cards: Sequence[str]) -> str:
    body = f"""<p class="eyebrow">dalembert</p>
<h1>Catalogue of systems</h1>
<p>Mechanical systems with velocity constraints, {len(cards)} of them. Each page has the formulas,
initial data, invariants, what is known of the solution, and the lines of Python and C that make the
system and run it.</p>
<div class="cards">
{"".join(cards)}</div>"""
    return web.page("Catalogue of systems", body, CSS)


def _card(system: System, run: Solution) -> str:
    name = _slug(system)
    figure = web.figure(3.2, 2.2, layout=None)
    ax = figure.add_axes((0.02, 0.02, 0.96, 0.96))
    if _has_path(system):
        _draw_path(run, ax)
        ax.set_aspect("equal", adjustable="datalim")
    else:
        for x, line in zip(run.q.T[:4], plot.LINES):
            ax.plot(run.t[:500], x[:500], color="black", linestyle=line, linewidth=1.1)
    ax.axis("off")
    kind = "no" if system.m == 0 else system.kind
    return f"""<a class="card" href="{name}.html">
{web.svg(figure, f"small-{name}", f"A run of {system.name}.")}
<h2>{html.escape(system.name)}</h2>
<p>{_sentence(system.help)}</p>
<p class="note">n = {system.n}, m = {system.m}, {kind} constraints</p>
</a>
"""


# ---- the page of a system ----------------------------------------------------------------------


def _page(system: System, run: Solution, names: Sequence[str]) -> str:
    text = html.escape
    runs = (run, _run(system, FINE, FINE_STEP))
    back = '<a href="index.html">catalogue</a>' if names else "system"
    parts = [
        f'<p class="eyebrow">dalembert {back}</p>',
        f"<h1>{text(system.name)}</h1>",
        f"<p>{_sentence(system.help)}</p>",
        f"<p>{_prose(system.description, system, names)}</p>" if system.description else "",
        f'<p class="note">Source: {_sentence(system.source)}</p>' if system.source else "",
        _formulas(system),
        _picture(system, run),
        _facts(system),
        _start(system),
        _invariants(system, runs),
        _known(system),
        _accuracy(system, runs),
        _reproduce(system, run),
        _links(system, names),
    ]
    return web.page(system.name, "\n".join(part for part in parts if part), CSS)


def _sentence(words: str) -> str:
    """A line of help as a sentence."""
    return html.escape(f"{words[:1].upper()}{words[1:].removesuffix('.')}.") if words else ""


def _math(words: str, system: System) -> str:
    return formula.mathml(words, system.coordinates)


def _inline(words: str, system: System) -> str:
    """A formula within text."""
    return _math(words, system).replace('<math display="block">', "<math>")


def _cell(words: str, system: System) -> str:
    """A formula in a table, with fractions as large as on a line of their own."""
    return _math(words, system).replace('display="block"', 'displaystyle="true"')


def _prose(words: str, system: System, names: Sequence[str]) -> str:
    """Text in which what stands in backticks is a formula, or a system of the catalogue."""
    found = []
    for k, part in enumerate(words.split("`")):
        if k % 2 == 0:
            found.append(html.escape(part))
        elif part in names:
            found.append(f'<a href="{part}.html">{part}</a>')
        elif part in (*systems.names(), *systems.names_in_sympy()):
            found.append(part)
        else:
            found.append(_inline(part, system))
    return "".join(found)


def _formulas(system: System) -> str:
    if not system.formulas:
        return ""
    lines = [line for line in system.formulas if not line.startswith("where ")]
    where = [line.removeprefix("where ") for line in system.formulas if line.startswith("where ")]
    shown = "\n".join(_math(line, system) for line in lines)
    more = "\n".join(_math(line, system) for line in where)
    more = f'<p>where</p>\n<div class="formulas">\n{more}\n</div>' if where else ""
    return f'<h2>Formulas</h2>\n<div class="formulas">\n{shown}\n</div>\n{more}'


def _table(rows: Iterable[Sequence[str]], head: Sequence[str] = (), style: str = "") -> str:
    """A table of HTML cells, the first column flush left; with a style all columns."""

    def row(cells: Sequence[str], tag: str) -> str:
        left = [' class="left"' if k == 0 or style else "" for k in range(len(cells))]
        inside = "".join(f"<{tag}{how}>{cell}</{tag}>" for how, cell in zip(left, cells))
        return f"<tr>{inside}</tr>\n"

    body = "".join(row(cells, "td") for cells in rows)
    top = row(head, "th") if head else ""
    kind = f' class="{style}"' if style else ""
    return f'<div class="scroll"><table{kind}>\n{top}{body}</table></div>'


def _facts(system: System) -> str:
    """What the system is, and what its examination finds."""
    found = system.check()
    rows = [
        ("coordinates n", str(system.n)),
        ("constraints m", f"{system.m}, {system.kind}" if system.m else "0"),
        ("mass matrix", "constant" if system.mass is not None else "depends on the coordinates"),
    ]
    if system.is_forced:
        rows.append(("force", "besides that of the Lagrangian"))
    if system.m and system.kind == "linear":
        curved = (
            "integrable: a holonomic constraint in disguise"
            if found.integrable
            else f"not integrable: curvature {found.curvature:.3g} at the start"
        )
        rows.append(("D", curved))
        rows += _distribution(system, found)
    if system.m:
        rows.append(("rank and condition of μ", f"{found.rank}, {found.condition:.3g}"))
    rows.append(("examination at the start", ("passed: " if found else "failed: ") + found.text))
    cells = [(html.escape(key), html.escape(value)) for key, value in rows]
    return "<h2>What it is</h2>\n" + _table(cells, style="facts")


def _distribution(system: System, found: Check) -> list[tuple[str, str]]:
    """How D grows by brackets."""
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


def _start(system: System) -> str:
    """Parameters and initial data."""
    assert system.q0 is not None and system.v0 is not None
    parts = ["<h2>Parameters and initial data</h2>"]
    if system.parameters:
        values = [(_cell(key, system), f"{x:.15g}") for key, x in system.parameters.items()]
        parts.append(_table(values, ("parameter", "value")))
    rows = [
        (_cell(name, system), f"{q:.15g}", f"{v:.15g}")
        for name, q, v in zip(system.coordinates, system.q0, system.v0)
    ]
    parts.append(_table(rows, ("coordinate", "at the start", "its velocity")))
    return "\n".join(parts)


def _conserves(system: System) -> bool:
    """Whether the energy is a first integral."""
    return system.kind == "linear" and not system.is_forced


def _invariants(system: System, runs: Sequence[Solution]) -> str:
    """The first integrals, and how far they drift in the typical run and in the accurate one."""
    values = [system.invariant(x.q, x.v) for x in runs]
    rows = []
    if _conserves(system):
        energy = [x.energy for x in runs]
        rows.append(("energy", _digits(energy[0][0]), *map(_drift, energy)))
    for name in system.invariants:
        both = [x[name] for x in values]
        rows.append((_invariant(system, name), _digits(both[0][0]), *map(_drift, both)))
    note = "" if _conserves(system) else (
        "<p>The energy is not among them: "
        + ("there is a force." if system.is_forced else "the constraints do work.")
        + "</p>"
    )  # fmt: skip
    if not rows:
        return f"<h2>Invariants</h2>\n<p>None is known.</p>\n{note}"
    head = (
        "invariant",
        "at the start",
        f"drift of {SCHEME}, h = {STEP:g}",
        f"of {FINE}, h = {FINE_STEP:g}",
    )
    return (
        f"<h2>Invariants</h2>\n{_table(rows, head)}\n{note}"
        f'<p class="note">The drift is the largest change from t = 0 to {END}.</p>'
    )


def _invariant(system: System, name: str) -> str:
    """An invariant by its name; if there are shorthands in it, by its expression too."""
    shown = _cell(name, system)
    model = system._model
    if model is None or len(model.invariants) != len(system.invariants):
        return shown
    try:
        found = formula.names(name)
    except ValueError:
        found = {name}
    known = {*system.coordinates, *system.parameters, *(f"v_{x}" for x in system.coordinates)}
    if found <= known:
        return shown
    expression = model.formula(model.invariants[system.invariants.index(name)])
    return f"{shown}<br>= {_inline(expression, system)}"


def _digits(x: float) -> str:
    """A number with ten digits."""
    return f"{x:.10g}"


def _drift(values: Array) -> str:
    return number(float(np.abs(values - values[0]).max()))


# ---- what is known of the solution ---------------------------------------------------------------


def _known_states(system: System) -> tuple[systems.KnownState, ...]:
    """The states to 30 digits, of a system of the library with its own parameters."""
    if not system._source.of_library or systems.get(system.name).parameters != system.parameters:
        return ()
    return systems.known_states(system.name)


def _known(system: System) -> str:
    """The reference to 30 digits."""
    states = _known_states(system)
    if not states:
        return ""
    rows = []
    for i, name in enumerate(system.coordinates):
        for letter, shown in (("q", name), ("v", f"v_{name}")):
            rows.append((_cell(shown, system), *(getattr(x, letter)[i] for x in states)))
    table = _table(rows, ("", *(f"t = {x.t:g}" for x in states)), "digits")
    return (
        "<h2>Reference to 30 digits</h2>\n"
        "<p>From the initial data, with parameters and data that are decimals exactly; computed by "
        "Taylor series and by extrapolation, which agree to these digits.</p>\n" + table
    )


def _accuracy(system: System, runs: Sequence[Solution]) -> str:
    """How far runs are from the exact solution and from the reference."""
    states = {x.t: np.array([*x.q, *x.v], dtype=float) for x in _known_states(system)}
    subjects = [
        (f"{run.scheme.name}, h = {run.h:g}", functools.partial(_state, run)) for run in runs
    ]
    rows = []
    if system.has_exact:
        rows += [
            (f"{name}, from the exact solution", *_distances(at, lambda t: _exact(system, t)))
            for name, at in subjects
        ]
        subjects = [("exact solution, in double precision", lambda t: _exact(system, t))]
    if states:
        rows += [
            (f"{name}, from the reference", *_distances(at, states.get)) for name, at in subjects
        ]
    if not rows:
        return ""
    title = "Exact solution" if system.has_exact else "Measured against the reference"
    said = (
        "<p>There is an exact solution for all initial data: <code>system.exact(t)</code>.</p>\n"
        if system.has_exact
        else ""
    )
    head = ("largest difference of (q, v)", *(f"t = {t:g}" for t in TIMES))
    return f"<h2>{title}</h2>\n{said}{_table(rows, head)}"


def _exact(system: System, t: float) -> Array:
    return np.concatenate(system.exact(float(t)))


def _state(run: Solution, t: float) -> Array | None:
    """The stored state at a time, None if the run did not come so far."""
    k = round(t / run.h)
    return run.x[k] if k < len(run.x) else None


def _distances(one: Callable[[float], Any], other: Callable[[float], Any]) -> list[str]:
    found = []
    for t in TIMES:
        a, b = one(t), other(t)
        found.append("-" if a is None or b is None else number(float(np.abs(a - b).max())))
    return found


# ---- the picture of a run ------------------------------------------------------------------------


def _has_path(system: System) -> bool:
    return {"x", "y"} <= set(system.coordinates)


def _label(name: str) -> str:
    """The name of a coordinate for matplotlib: theta_x as a letter with an index."""
    letter, digits, index = re.fullmatch(r"([^\d_]*)(\d*)_?(.*)", name).groups()  # type: ignore
    if not name.isascii() or not name.replace("_", "").isalnum() or not letter:
        return plot.plain(name)
    letter = formula.GREEK.get(letter, letter)
    letter = letter if len(letter) == 1 else rf"\mathrm{{{letter}}}"
    below = digits + formula.GREEK.get(index, index)
    return f"${letter}_{{{below}}}$" if below else f"${letter}$"


def _draw_path(run: Solution, ax: Any) -> None:
    x, y = (run.q[:, run.system.coordinates.index(name)] for name in ("x", "y"))
    ax.plot(x, y, color=plot.COLOURS[0], linewidth=1.4)
    ax.plot(x[:1], y[:1], color="black", marker="o", linestyle="none", label="start")
    ax.plot(
        x[-1:], y[-1:], color="black", marker="s", markerfacecolor="white", linestyle="none",
        label="end",
    )  # fmt: skip


def _picture(system: System, run: Solution) -> str:
    """The path, the coordinates over time, and below the residual and the energy."""
    shown = min(system.n, SHOWN)
    upper, lower, gap = max(3.9, 0.85 * shown), 1.9, 0.6
    width, height = 11.0, upper + lower + 2 * gap + 0.1
    figure = web.figure(width, height, layout=None)

    def axes(left: float, bottom: float, right: float, top: float) -> Any:
        """Axes between these places, in inches; a layout by matplotlib takes twice the time."""
        return figure.add_axes(
            (left / width, bottom / height, (right - left) / width, (top - bottom) / height)
        )

    start, middle, top = 0.75, 5.65, height - 0.1
    floor = top - upper
    if _has_path(system):
        ax = axes(start, floor, middle - 0.7, top)
        _draw_path(run, ax)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel("$x$")
        ax.set_ylabel("$y$")
        ax.legend(frameon=False, fontsize="small")
    each = upper / shown
    for k, (name, x) in enumerate(zip(system.coordinates[:shown], run.q.T)):
        left = middle + 0.3 if _has_path(system) else start
        ax = axes(left, top - (k + 1) * each + 0.07, width - 0.1, top - k * each)
        ax.plot(run.t, x, color=plot.COLOURS[0], linewidth=1.2)
        ax.plot(run.t[:1], x[:1], color="black", marker="o", markersize=4, clip_on=False)
        ax.set_ylabel(_label(name), rotation=0, labelpad=6)
        ax.yaxis.set_label_coords(-0.55 / (width - 0.1 - left), 0.5)
        ax.margins(x=0.01)
        ax.locator_params(axis="y", nbins=3)
        ax.tick_params(labelbottom=k == shown - 1)
    ax.set_xlabel("$t$")
    _draw_residual(run, axes(start, gap - 0.1, middle - 0.7, gap - 0.1 + lower))
    ax = axes(middle + 0.3, gap - 0.1, width - 0.1, gap - 0.1 + lower)
    ax.plot(run.t, run.energy - run.energy[0], color=plot.COLOURS[1], linewidth=1.2)
    ax.set_ylabel("$E - E_0$")
    ax.set_xlabel("$t$")
    ax.margins(x=0.01)
    ax.ticklabel_format(axis="y", style="sci", scilimits=(-3, 3), useMathText=True)
    return web.svg(
        figure, f"run-{_slug(system)}", f"A run of {system.name}.", _caption(system, run)
    )


def _draw_residual(run: Solution, ax: Any) -> None:
    """The residual of D on a logarithmic axis, the largest of each stretch."""
    ax.plot(*plot._stretches(run.t, run.residual), color=plot.COLOURS[2], linewidth=1.2)
    ax.set_yscale("log")
    ax.axhline(core.ROUNDOFF, color="black", linewidth=1, linestyle=(0, (5, 3)))
    ax.set_ylim(plot.ZERO / 4, max(plot.NOT_ROUNDOFF, 2 * float(run.residual.max())))
    ax.set_yticks([1e-16, 1e-12, 1e-8])
    ax.set_ylabel("residual of $D$" if run.system.m else "(no constraints)")
    ax.set_xlabel("$t$")
    ax.margins(x=0.01)


def _caption(system: System, run: Solution) -> str:
    words = [f"A typical run: {SCHEME} with h = {STEP:g} to t = {END}."]
    if not run.success:
        words.append(f"It broke off at t = {run.t[-1]:g}: {html.escape(run.message)}.")
    shown = f"first {SHOWN} coordinates" if system.n > SHOWN else "coordinates"
    if _has_path(system):
        flat = ", seen along z" if "z" in system.coordinates else ""
        words.append(f"The path{flat}, and the {shown} over time;")
    else:
        words.append(f"The {shown} over time;")
    words.append(
        "below, the relative residual of the constraints, with the unit roundoff as the dashed "
        "line, and"
    )
    words.append(
        "the error of the energy."
        if _conserves(system)
        else "the change of the energy, which is no error here."
    )
    return " ".join(words)


# ---- how to make it ------------------------------------------------------------------------------


def _reproduce(system: System, run: Solution) -> str:
    if not system._source.of_library:
        return (
            "<h2>How to make it</h2>\n<p>The system is one of the user's own: the program that "
            "made it belongs to this page.</p>"
        )
    end = "\n".join(
        f"{name:12} {q: .17g}  {v: .17g}"
        for name, q, v in zip(system.coordinates, run.q[-1], run.v[-1])
    )
    compiled = ""
    if system._model is not None:
        compiled = (
            "<p>The C file of the system is written by Python, <code>system.c_source()</code>; "
            "compile it together with this:</p>"
        )
    return f"""<h2>How to make it</h2>
<p>In Python, system and run:</p>
<pre>{html.escape(python_lines(system))}</pre>
<p>In C:</p>
{compiled}<pre>{html.escape(c_lines(system))}</pre>
<p>Both end at t = {run.t[-1]:g} in (coordinate, its velocity):</p>
<pre>{html.escape(end)}</pre>"""


def _changed(system: System) -> dict[str, float]:
    """The parameters that are not as the library has them."""
    default = systems.get(system.name).parameters
    return {key: x for key, x in system.parameters.items() if x != default[key]}


def python_lines(system: System) -> str:
    """Return the program of Python that makes a system of the library and its typical run."""
    values = ", ".join(f"{key}={x!r}" for key, x in _changed(system).items())
    return f"""import dalembert as dal

system = dal.systems.{system.name}({values})
run = dal.integrate(system, {SCHEME!r}, h={STEP!r}, t_end={END})
print(run.x[-1])"""


def c_lines(system: System) -> str:
    """Return the program of C that does the same."""
    changed = _changed(system)
    declare = ""
    names = values = "NULL"
    if changed and system._model is None:
        names, values = "names", "values"
        declare = (
            f"    const char *const names[] = {{{', '.join(map(quoted, changed))}}};\n"
            f"    const double values[] = {{{', '.join(map(repr, changed.values()))}}};\n"
        )
    make = f"dal_system_builtin(&system, {quoted(system.name)}, {names}, {values}, "
    make += f"{len(changed)}, &error)"
    prototype = ""
    if system._model is not None:
        kinds = "".join(f"double {key}, " for key in system.parameters)
        given = "".join(f"{x!r}, " for x in system.parameters.values())
        prototype = f"int {system.name}_system(dal_system **system, {kinds}dal_error *error);\n\n"
        make = f"{system.name}_system(&system, {given}&error)"
    size = 2 * system.n
    return f"""#include <dalembert.h>
#include <stdio.h>

{prototype}int main(void)
{{
    dal_system *system;
    dal_scheme scheme;
    dal_stepper *stepper;
    dal_error error;
    double x[{size}];
{declare}    if ({make}
        || dal_scheme_find(&scheme, {quoted(SCHEME)}, &error)
        || dal_stepper_new(&stepper, system, &scheme, NULL, &error))
        return puts(error.text), 1;
    dal_system_state(system, x);
    if (dal_stepper_start(stepper, 0.0, {STEP!r}, x, DAL_CHECK, DAL_INITIAL_NONE)
        || dal_advance(stepper, {round(END / STEP)}, NULL, NULL))
        return puts(dal_stepper_message(stepper)), 1;
    for (int i = 0; i < {size}; i++) printf("%.17g\\n", dal_stepper_state(stepper)[i]);
    dal_stepper_free(stepper);
    dal_system_free(system);
    return 0;
}}"""


def quoted(text: str) -> str:
    """Return a name as a C string."""
    return f'"{text}"'


def _links(system: System, names: Sequence[str]) -> str:
    if not names:
        return f"<nav>dalembert {core.version()}</nav>"
    k = list(names).index(_slug(system))
    links = ['<a href="index.html">catalogue</a>']
    if k > 0:
        links.append(f'before: <a href="{names[k - 1]}.html">{names[k - 1]}</a>')
    if k + 1 < len(names):
        links.append(f'next: <a href="{names[k + 1]}.html">{names[k + 1]}</a>')
    return f"<nav>{' | '.join(links)} | dalembert {core.version()}</nav>"
