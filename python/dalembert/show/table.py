"""Studies as tables and words: plain, in colours by rich, and as HTML."""

from __future__ import annotations

import math
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TextIO

from ..core import Array, arguments, extras
from ..study.study import Fit, Studies, Study, order, worst
from . import web

__all__ = [
    "Column",
    "attach",
    "columns",
    "heading",
    "html",
    "lines",
    "number",
    "overview",
    "rich",
    "show",
    "studies_html",
    "studies_lines",
    "study_html",
    "study_lines",
    "summary",
    "text",
]

Line = tuple[str, str]  # its text, and its style for rich

WIDTH = 100  # of the plain table, at most
COLOURS = {True: "green", False: "red", None: "yellow"}  # of a verdict


# ---- numbers -------------------------------------------------------------------------------


def number(x: float) -> str:
    """Return a number with two digits, "-" if it is not finite."""
    return "-" if not math.isfinite(x) else "0" if x == 0 else f"{x:.1e}"


def _points(fit: Fit) -> str:
    return "1 point" if fit.points == 1 else f"{fit.points} points"


# ---- columns -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Column:
    """A column of a table as text; ``left``: flush left."""

    title: str
    cells: list[str]
    left: bool = False

    @property
    def width(self) -> int:
        """Characters that the widest entry takes."""
        return max(len(text) for text in (self.title, *self.cells))


def columns(study: Study) -> list[Column]:
    """Return the table of a study: step size, errors with local orders, residuals, energy."""

    def errors(title: str, values: Array, orders: Array) -> Column:
        cells = [f"{number(x):>7} {order(p):>5}" for x, p in zip(values, orders)]
        return Column(title, cells)

    def largest(title: str, values: Array) -> Column:
        return Column(title, [number(x) for x in values])

    return [
        Column("h", [f"{h:.4g}" for h in study.h]),
        errors("q error order", study.q_error, study.q_orders),
        errors("v error order", study.v_error, study.v_orders),
        errors("lambda order", study.multiplier_error, study.multiplier_orders),
        largest("res. D", study.residual),
        largest("D_eps", study.residual_eps),
        largest("energy", study.energy_error),
    ]


def overview(studies: Studies) -> list[Column]:
    """Return the table of several studies, one row for each scheme."""

    def column(title: str, text: Callable[[Study], str]) -> Column:
        return Column(title, [text(study) for study in studies])

    return [
        Column("scheme", [study.scheme.name for study in studies], left=True),
        column("promised", lambda study: study.promise),
        column("p", lambda study: study.fits["state"].order(1)),
        column("s", lambda study: study.fits["reaction"].order(1)),
        column("at t_end", lambda study: study.fits["global_state"].order()),
        column("res. D", lambda study: number(worst(study.residual))),
        column("D_eps", lambda study: number(worst(study.residual_eps))),
        column("energy", lambda study: number(worst(study.energy_error))),
        column("keeps", lambda study: study.keeps),
        column("verdict", lambda study: study.verdict),
    ]


# ---- words ---------------------------------------------------------------------------------


def heading(study: Study) -> str:
    """Return one line that says what was studied."""
    start = f", initial={study.initial!r}" if study.initial else ""
    return f"{study.scheme.name} on {study.system.name}, t = {study.t0:g} to {study.t_end:g}{start}"


def summary(study: Study) -> str:
    """Return the verdict in words, then the points that the fits rest on; two lines."""
    keys = {"q": "global_q", "v": "global_v", "lambda": "global_multipliers"}
    at_end = ", ".join(f"{name} {study.fits[key].order()}" for name, key in keys.items())
    return (
        f"{study.text}\n"
        f"p over {_points(study.fits['state'])}, s over {_points(study.fits['reaction'])}; "
        f"orders at t_end: {at_end}; kept to roundoff: {study.keeps}."
    )


# ---- lines ---------------------------------------------------------------------------------


def study_lines(study: Study, width: int) -> Iterator[Line]:
    """Yield a study line by line; ValueError if ``width`` is no positive integer."""
    width = arguments.integer(width, "width", 1)
    yield heading(study), "bold"
    yield from lines(columns(study), width)
    first, rest = summary(study).split("\n")
    yield from _wrapped(first, width, COLOURS[study.holds])
    yield from _wrapped(rest, width)


def studies_lines(studies: Studies, width: int) -> Iterator[Line]:
    """Yield several studies line by line, with an overview and the verdict at the end."""
    width = arguments.integer(width, "width", 1)
    for study in studies:
        yield from study_lines(study, width)
        yield "", ""
    if studies:
        yield from lines(overview(studies), width)
    yield from _wrapped(studies.sentence(), width, "bold " + COLOURS[studies.holds])


def lines(table: list[Column], width: int) -> Iterator[Line]:
    """Yield the lines of a table."""
    for block in _blocks(table, width):
        for k, row in enumerate(zip(*([c.title, *c.cells] for c in block))):
            cells = (
                text.ljust(c.width) if c.left else text.rjust(c.width)
                for text, c in zip(row, block)
            )
            yield "  ".join(cells).rstrip(), "" if k else "bold"


def _blocks(table: list[Column], width: int) -> list[list[Column]]:
    """Split the columns into tables of at most ``width`` characters that repeat the first one."""
    first, *rest = table
    blocks, room = [[first]], width - first.width
    for column in rest:
        if column.width + 2 > room and len(blocks[-1]) > 1:
            blocks.append([first])
            room = width - first.width
        blocks[-1].append(column)
        room -= column.width + 2
    return blocks


def _wrapped(text: str, width: int, style: str = "") -> Iterator[Line]:
    return ((line, style) for line in textwrap.wrap(text, width))


def text(lines: Iterable[Line]) -> str:
    """Return lines as plain text."""
    return "\n".join(text for text, _ in lines)


def rich(lines: Iterable[Line]) -> Iterator[Any]:
    """Yield what rich prints for lines."""
    from rich.text import Text

    return (Text(text, style=style) for text, style in lines)


def show(item: Study | Studies, file: TextIO | None) -> None:
    """Print: with rich on a terminal if rich is installed, else plain."""
    out = sys.stdout if file is None else file
    if not out.isatty():
        print(item, file=out)
        return
    try:
        from rich.console import Console
    except ImportError:
        print(item.table(min(WIDTH, shutil.get_terminal_size().columns)), file=out)
    else:
        Console(file=out, highlight=False).print(item)


# ---- HTML ----------------------------------------------------------------------------------


def html(columns: list[Column], caption: str = "", style: str = "") -> Any:
    """Return a table as HTML, of a class of the stylesheet."""
    return web.render("table.html", columns=columns, caption=caption, style=style)


def study_html(study: Study) -> Any:
    """Return a study as HTML."""
    fits = {name: study.fits[key] for name, key in (("p", "state"), ("s", "reaction"))}
    return web.render(
        "study.html",
        study=study,
        table=html(columns(study), heading(study)),
        fitted=", ".join(f"{x} = {fit.order(1)} ({_points(fit)})" for x, fit in fits.items()),
    )


def studies_html(studies: Studies) -> Any:
    """Return the overview of several studies as HTML."""
    return html(overview(studies), f"Overview of {len(studies)} schemes")


# ---- objects -------------------------------------------------------------------------------


def attach(kind: type, lines: Callable[[Any, int], Iterator[Line]], page: Callable[..., Any]) -> None:
    """Give the objects of a class their tables: as text, printed, and as HTML in a notebook."""

    def table(self: Any, width: int = WIDTH) -> str:
        """Return tables and verdict as plain text, ``width`` characters wide at most."""
        return text(lines(self, width))

    def shown(self: Any, file: TextIO | None = None) -> None:
        """Print tables and verdict: with rich on a terminal if rich is installed, else plain.

        Parameters
        ----------
        file : text stream, optional
            Default: standard output.
        """
        show(self, file)

    def console(self: Any, console: Any, options: Any) -> Iterator[Any]:
        return rich(lines(self, options.max_width))

    def notebook(self: Any) -> str | None:
        return str(page(self)) if extras.is_there("jinja2") else None

    methods = {"table": table, "__str__": lambda self: table(self), "show": shown,
               "__rich_console__": console, "_repr_html_": notebook}  # fmt: skip
    for name, method in methods.items():
        method.__name__ = name
        setattr(kind, name, method)
