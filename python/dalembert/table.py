"""Studies as tables and words: plain, with rich, and as HTML."""

from __future__ import annotations

import html
import math
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TextIO

from .core import arguments
from .core import Array

if TYPE_CHECKING:
    from .study.study import Fit, Studies, Study

__all__ = [
    "Column",
    "columns",
    "heading",
    "number",
    "order",
    "overview",
    "plain",
    "sentence",
    "show",
    "studies_html",
    "studies_rich",
    "studies_text",
    "study_html",
    "study_rich",
    "study_text",
    "summary",
]

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


# ---- plain ---------------------------------------------------------------------------------


def study_text(study: Study, width: int) -> str:
    """Return a study as plain text; ValueError if ``width`` is no positive integer."""
    width = arguments.integer(width, "width", 1)
    return "\n".join(
        [heading(study), *plain(columns(study), width), *_wrapped(summary(study), width)]
    )


def studies_text(studies: Studies, width: int) -> str:
    """Return several studies as plain text, with an overview and the verdict at the end."""
    width = arguments.integer(width, "width", 1)
    tables = [study_text(study, width) + "\n" for study in studies]
    last = plain(overview(studies), width) if studies else []
    return "\n".join([*tables, *last, *_wrapped(sentence(studies), width)])


def plain(table: list[Column], width: int) -> list[str]:
    """Return the lines of a table."""
    lines = []
    for block in _blocks(table, width):
        for row in zip(*([c.title, *c.cells] for c in block)):
            cells = (
                text.ljust(c.width) if c.left else text.rjust(c.width)
                for text, c in zip(row, block)
            )
            lines.append("  ".join(cells).rstrip())
    return lines


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


def _wrapped(text: str, width: int) -> list[str]:
    return [line for part in text.split("\n") for line in textwrap.wrap(part, width)]


# ---- rich ----------------------------------------------------------------------------------


def study_rich(study: Study, width: int) -> Iterator[Any]:
    """Yield what rich prints for a study."""
    from rich.text import Text

    yield Text(heading(study), style="bold")
    yield from _rich(columns(study), width)
    first, rest = summary(study).split("\n")
    yield Text(first, style=COLOURS[study.holds])
    yield Text(rest)


def studies_rich(studies: Studies, width: int) -> Iterator[Any]:
    """Yield what rich prints for several studies."""
    from rich.text import Text

    for study in studies:
        yield from study_rich(study, width)
        yield Text()
    if studies:
        yield from _rich(overview(studies), width)
    yield Text(sentence(studies), style="bold " + COLOURS[studies.holds])


def _rich(columns: list[Column], width: int) -> Iterator[Any]:
    from rich.table import Table

    for block in _blocks(columns, width):
        table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="bold")
        for column in block:
            table.add_column(column.title, justify="left" if column.left else "right", no_wrap=True)
        for row in zip(*(column.cells for column in block)):
            table.add_row(*row)
        yield table


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


def study_html(study: Study) -> str:
    """Return a study as HTML."""
    state, reaction = study.fits["state"], study.fits["reaction"]
    return (
        f"{_html(columns(study), heading(study))}"
        f'<p class="note"><b>{_cell(study.verdict)}</b>: {html.escape(study.text)} '
        f"Fitted p = {state.order(1)} ({_points(state)}), s = {reaction.order(1)} "
        f"({_points(reaction)}).</p>\n"
    )


def studies_html(studies: Studies) -> str:
    """Return the overview of several studies as HTML."""
    return _html(overview(studies), f"Overview of {len(studies)} schemes")


def _html(columns: Sequence[Column], caption: str) -> str:
    left = [' class="left"' if column.left else "" for column in columns]
    head = "".join(f"<th{a}>{html.escape(c.title)}</th>" for a, c in zip(left, columns))
    rows = "\n".join(
        "<tr>" + "".join(f"<td{a}>{_cell(cell)}</td>" for a, cell in zip(left, row)) + "</tr>"
        for row in zip(*(column.cells for column in columns))
    )
    return (
        f'<div class="scroll"><table><caption>{html.escape(caption)}</caption>\n'
        f"<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody></table></div>\n"
    )


def _cell(text: str) -> str:
    return '<span class="fails">fails</span>' if text == "fails" else html.escape(text)
