"""Studies as tables and words: plain, in colours by rich, and as HTML."""

from __future__ import annotations

import math
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TextIO

from . import arguments, web
from ._lib import Array

if TYPE_CHECKING:
    from .study import Fit, Studies, Study

__all__ = [
    "Column",
    "columns",
    "heading",
    "html",
    "lines",
    "number",
    "order",
    "overview",
    "rich",
    "sentence",
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


def order(x: float) -> str:
    """Return an order with two decimals, "-" if it is not known."""
    return "-" if not math.isfinite(x) else f"{round(x, 2) + 0.0:.2f}"  # no -0.00


def _worst(values: Array) -> float:
    return max((float(x) for x in values if math.isfinite(x)), default=math.nan)


def _points(fit: Fit) -> str:
    return "1 point" if fit.points == 1 else f"{fit.points} points"


def _listing(names: list[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


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

    def worst(title: str, values: Array) -> Column:
        return Column(title, [number(x) for x in values])

    return [
        Column("h", [f"{h:.4g}" for h in study.h]),
        errors("q error order", study.q_error, study.q_orders),
        errors("v error order", study.v_error, study.v_orders),
        errors("lambda order", study.multiplier_error, study.multiplier_orders),
        worst("res. D", study.residual),
        worst("D_eps", study.residual_eps),
        worst("energy", study.energy_error),
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
        column("res. D", lambda study: number(_worst(study.residual))),
        column("D_eps", lambda study: number(_worst(study.residual_eps))),
        column("energy", lambda study: number(_worst(study.energy_error))),
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


def sentence(studies: Studies) -> str:
    """Return the verdict of several studies in one sentence."""
    if not studies:
        return "No scheme was studied."
    system = studies[0].system.name
    failing = [study.scheme.name for study in studies if study.holds is False]
    holding = [study for study in studies if study.holds]
    undecided = [study.scheme.name for study in studies if study.holds is None]
    rest = f"; no verdict on {_listing(undecided)}" if undecided else ""
    if failing:
        do = "does" if len(failing) == 1 else "do"
        return (
            f"On {system}, {_listing(failing)} {do} not deliver what is promised; "
            f"{len(holding)} of {len(studies)} schemes hold{rest}."
        )
    if not holding:
        return f"On {system} there is no verdict on {_listing(undecided)}."
    worst = max(_worst(x.residual if x.keeps_D else x.residual_eps) for x in holding)
    if len(holding) == 1:
        return (
            f"On {system}, {holding[0].scheme.name} has its promised order and keeps its "
            f"constraint set to {worst:.1e}{rest}."
        )
    who = "both" if len(holding) == 2 else f"all {len(holding)}" if not rest else len(holding)
    return (
        f"On {system}, {who} schemes have their promised order and keep their constraint "
        f"set to {worst:.1e}{rest}."
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
    yield from _wrapped(sentence(studies), width, "bold " + COLOURS[studies.holds])


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
