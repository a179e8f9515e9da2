"""The pages of systems: what each says about itself, and a typical run, as HTML.

A page is self-contained: no script, no network, the same bytes every time.
"""

from __future__ import annotations

import contextlib
import functools
import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import core, growth, systems
from ..core import Array, extras, files, require_system
from ..geometry import Check
from ..run import Solution, integrate
from ..symbolic import formula
from ..system import System
from . import plot, web
from .table import Column, html, number

__all__ = ["available", "page", "write"]

# The typical run, and the accurate one; the times at which both are compared with what is known.
END, TIMES = 20, (1, 10)
SCHEME, STEP = "leapfrog", 0.02
FINE, FINE_STEP = "leapfrog-kl8", 0.05
SHOWN = 8  # coordinates over time, at most


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
        If matplotlib or Jinja2 is not installed, or SymPy and a system needs it; the text has the
        line to type.
    OSError
        If a file cannot be written; the text has its name.

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
            cards.append((name, system, _small(system, run)))
        files.write(index, web.render("index.html", cards=cards))
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
        If matplotlib or Jinja2 is not installed; the text has the line to type.

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


def _page(system: System, run: Solution, names: Sequence[str]) -> str:
    runs = (run, _run(system, FINE, FINE_STEP))
    k = names.index(_slug(system)) if names else 0
    end = zip(system.coordinates, run.q[-1], run.v[-1])
    is_ours = system._source.of_library
    return str(
        web.render(
            "system.html",
            system=system,
            names=names,
            library=(*systems.names(), *systems.names_in_sympy()),
            before=names[k - 1] if k > 0 else None,
            after=names[k + 1] if k + 1 < len(names) else None,
            version=core.version(),
            run=run,
            typical=f"{SCHEME} with h = {STEP:g} to t = {END}",
            shown=f"first {SHOWN} coordinates" if system.n > SHOWN else "coordinates",
            has_path=_has_path(system),
            picture=_picture(system, run),
            facts=_table(("", ""), _facts(system), "facts"),
            start=_start(system),
            conserves=_conserves(system),
            invariants=_invariants(system, runs),
            reference=_known(system),
            accuracy=_accuracy(system, runs),
            python=python_lines(system) if is_ours else "",
            c=c_lines(system) if is_ours else "",
            end="\n".join(f"{name:12} {q: .17g}  {v: .17g}" for name, q, v in end),
        )
    )


def _table(titles: Sequence[str], rows: Iterable[Sequence[Any]], style: str = "") -> Any:
    """A table as HTML, the first column flush left; with a style all columns."""
    cells = list(zip(*rows))
    if not cells:
        return ""
    return html([Column(*x, left=bool(style) or k == 0) for k, x in enumerate(zip(titles, cells))],
                style=style)


def _math(words: str, system: System) -> Any:
    return web.math(words, system.coordinates)


def _facts(system: System) -> list[tuple[str, str]]:
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
    return rows


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


def _start(system: System) -> list[Any]:
    """Parameters and initial data."""
    assert system.q0 is not None and system.v0 is not None
    values = [(_math(key, system), f"{x:.15g}") for key, x in system.parameters.items()]
    rows = [
        (_math(name, system), f"{q:.15g}", f"{v:.15g}")
        for name, q, v in zip(system.coordinates, system.q0, system.v0)
    ]
    return [
        _table(("parameter", "value"), values),
        _table(("coordinate", "at the start", "its velocity"), rows),
    ]


def _conserves(system: System) -> bool:
    """Whether the energy is a first integral."""
    return system.kind == "linear" and not system.is_forced


def _invariants(system: System, runs: Sequence[Solution]) -> Any:
    """The first integrals, and how far they drift in the typical run and in the accurate one."""
    values = [
        {**({"energy": x.energy} if _conserves(system) else {}), **system.invariant(x.q, x.v)}
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
    drifts = (f"drift of {SCHEME}, h = {STEP:g}", f"of {FINE}, h = {FINE_STEP:g}")
    return _table(("invariant", "at the start", *drifts), rows)


def _invariant(system: System, name: str) -> Any:
    """An invariant by its name; if there are shorthands in it, by its expression too."""
    shown = _math(name, system)
    model = system._model
    if model is None or len(model.invariants) != len(system.invariants):
        return shown
    try:
        found = {x.name for side in formula.read(name) for x in side.free_symbols}
    except ValueError:
        found = {name}
    known = {*system.coordinates, *system.parameters, *(f"v_{x}" for x in system.coordinates)}
    if found <= known:
        return shown
    expression = model.formula(model.invariants[system.invariants.index(name)])
    return shown + "\n= " + _math(expression, system)


# ---- what is known of the solution ---------------------------------------------------------------


def _known_states(system: System) -> tuple[systems.KnownState, ...]:
    """The states to 30 digits, of a system of the library with its own parameters."""
    if not system._source.of_library or systems.get(system.name).parameters != system.parameters:
        return ()
    return systems.known_states(system.name)


def _known(system: System) -> Any:
    """The reference to 30 digits."""
    states = _known_states(system)
    rows = [
        (_math(shown, system), *(getattr(x, letter)[i] for x in states))
        for i, name in enumerate(system.coordinates)
        for letter, shown in (("q", name), ("v", f"v_{name}"))
    ]
    return states and _table(("", *(f"t = {x.t:g}" for x in states)), rows, "digits")


def _accuracy(system: System, runs: Sequence[Solution]) -> Any:
    """How far runs are from the exact solution and from the reference."""
    states = {x.t: np.array([*x.q, *x.v], dtype=float) for x in _known_states(system)}
    exact = functools.partial(_exact, system)
    subjects = [
        (f"{run.scheme.name}, h = {run.h:g}", functools.partial(_state, run)) for run in runs
    ]
    rows = []
    if system.has_exact:
        rows = [(f"{name}, from the exact solution", *_distances(x, exact)) for name, x in subjects]
        subjects = [("exact solution, in double precision", exact)]
    if states:
        rows += [(f"{name}, from the reference", *_distances(x, states.get)) for name, x in subjects]
    return _table(("largest difference of (q, v)", *(f"t = {t:g}" for t in TIMES)), rows)


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
    with contextlib.suppress(ImportError, ValueError):
        if name.isidentifier():
            return f"${formula.latex(name)[0]}$"
    return plot.plain(name)


def _small(system: System, run: Solution) -> Any:
    """The path, or some coordinates over time, for the index."""
    figure = web.figure(3.2, 2.2, layout=None)
    ax = figure.add_axes((0.02, 0.02, 0.96, 0.96))
    if _has_path(system):
        _draw_path(run, ax)
    else:
        for x, line in zip(run.q.T[:4], plot.LINES):
            ax.plot(run.t[:500], x[:500], color="black", linestyle=line, linewidth=1.1)
    ax.axis("off")
    return web.svg(figure, f"small-{_slug(system)}", f"A run of {system.name}.")


def _picture(system: System, run: Solution) -> Any:
    """The path, the coordinates over time, and below the residual and the energy."""
    names = system.coordinates[:SHOWN]
    upper, lower, gap = max(3.9, 0.85 * len(names)), 1.9, 0.7
    height = upper + gap + lower + 0.6
    figure = web.figure(11.0, height, layout=None)  # that of matplotlib takes twice the time
    axes = figure.subplot_mosaic(
        [
            *(["path", ".", k] if _has_path(system) else [k] * 3 for k in range(len(names))),
            ["."] * 3,
            ["residual", ".", "energy"],
        ],
        width_ratios=(4.2, 1.0, 5.0),
        height_ratios=[*[upper / len(names)] * len(names), gap, lower],
        gridspec_kw={"left": 0.07, "right": 0.99, "wspace": 0, "hspace": 0.06},
    )
    figure.subplots_adjust(bottom=0.5 / height, top=1 - 0.1 / height)
    if _has_path(system):
        _draw_path(run, axes["path"])
        axes["path"].set(xlabel="$x$", ylabel="$y$")
        axes["path"].legend(frameon=False, fontsize="small")
    for k, (name, x) in enumerate(zip(names, run.q.T)):
        ax = axes[k]
        ax.plot(run.t, x, color=plot.COLOURS[0], linewidth=1.2)
        ax.plot(run.t[:1], x[:1], color="black", marker="o", markersize=4, clip_on=False)
        ax.set_ylabel(_label(name), rotation=0)
        ax.margins(x=0.01)
        ax.locator_params(axis="y", nbins=3)
        ax.tick_params(labelbottom=name == names[-1])
    figure.align_ylabels([axes[k] for k in range(len(names))])
    ax.set_xlabel("$t$")
    _draw_residual(run, axes["residual"])
    ax = axes["energy"]
    ax.plot(run.t, run.energy - run.energy[0], color=plot.COLOURS[1], linewidth=1.2)
    ax.set(xlabel="$t$", ylabel="$E - E_0$")
    ax.margins(x=0.01)
    ax.ticklabel_format(axis="y", style="sci", scilimits=(-3, 3), useMathText=True)
    return web.svg(figure, f"run-{_slug(system)}", f"A run of {system.name}.")


def _draw_path(run: Solution, ax: Any) -> None:
    x, y = (run.q[:, run.system.coordinates.index(name)] for name in ("x", "y"))
    ax.plot(x, y, color=plot.COLOURS[0], linewidth=1.4)
    ax.plot(x[:1], y[:1], "ko", label="start")
    ax.plot(x[-1:], y[-1:], "ks", markerfacecolor="white", label="end")
    ax.set_aspect("equal", adjustable="datalim")


def _draw_residual(run: Solution, ax: Any) -> None:
    """The residual of D on a logarithmic axis, the largest of each stretch."""
    ax.plot(*plot._stretches(run.t, run.residual), color=plot.COLOURS[2], linewidth=1.2)
    ax.axhline(core.ROUNDOFF, color="black", linewidth=1, linestyle=(0, (5, 3)))
    top = max(plot.NOT_ROUNDOFF, 2 * float(run.residual.max()))
    ax.set(yscale="log", ylim=(plot.ZERO / 4, top), yticks=[1e-16, 1e-12, 1e-8], xlabel="$t$")
    ax.set_ylabel("residual of $D$" if run.system.m else "(no constraints)")
    ax.margins(x=0.01)


# ---- how to make it ------------------------------------------------------------------------------


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
