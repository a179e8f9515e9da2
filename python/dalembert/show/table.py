"""Studies as tables and sentences: plain, in colours by rich, and as HTML."""

from __future__ import annotations

import math
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, TextIO

from ..core import Array, arguments
from ..study.study import Fit, Studies, Study, order, worst
from . import web

Line = tuple[str, str]  # its text, and its style for rich

WIDTH = 100  # of the plain table, at most
COLOURS = {True: "green", False: "red", None: "yellow"}  # of a verdict


# ---- numbers -------------------------------------------------------------------------------


def number(x: float) -> str:
    """Return a number with two digits, "-" if it is not finite."""
    return "-" if not math.isfinite(x) else "0" if x == 0 else f"{x:.1e}"


def _points(fit: Fit) -> str:
    return "1 point" if fit.points == 1 else f"{fit.points} points"


# ---- tables --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Table:
    """A table, with a caption, a sentence below the caption, and a note below the table.

    Its first columns are flush left; the style is a class of the stylesheet.
    """

    titles: list[str]
    rows: list[Any]
    left: int = 1
    caption: str = ""
    verdict: str = ""
    note: str = ""
    style: str = ""

    def html(self) -> web.HTML:
        """Return the table as HTML."""
        return web.render("table.html", table=self)

    def lines(self, width: int) -> Iterator[Line]:
        """Yield the table line by line, in parts that repeat the first column if it is too wide."""
        columns = [*zip(self.titles, *self.rows)]
        widths = [max(map(len, column)) for column in columns]
        parts = [[0]]
        for k in range(1, len(columns)):
            if len(parts[-1]) > 1 and sum(widths[j] + 2 for j in parts[-1]) + widths[k] > width:
                parts.append([0])
            parts[-1].append(k)
        for part in parts:
            for i, row in enumerate(zip(*columns)):
                cells = (f"{row[k]:{'<' if k < self.left else '>'}{widths[k]}}" for k in part)
                yield "  ".join(cells).rstrip(), "" if i else "bold"


def of_study(study: Study) -> Table:
    """Return the table of a study: step size, errors with local orders, residuals, energy."""

    def errors(values: Array, orders: Array) -> list[str]:
        return [f"{number(x):>7} {order(p):>5}" for x, p in zip(values, orders)]

    columns = {
        "h": [f"{h:.4g}" for h in study.h],
        "q error order": errors(study.q_error, study.q_orders),
        "v error order": errors(study.v_error, study.v_orders),
        "lambda order": errors(study.multiplier_error, study.multiplier_orders),
        "res. D": map(number, study.residual),
        "D_eps": map(number, study.residual_eps),
        "energy": map(number, study.energy_error),
    }
    rows = [*zip(*columns.values())]
    return Table([*columns], rows, 0, heading(study), study.text, summary(study))


def overview(studies: Studies) -> Table:
    """Return the table of several studies, one row for each scheme."""
    titles = "scheme", "verdict", "promised", "p", "s", "at end", "res. D", "D_eps", "energy"
    rows = [
        (
            study.scheme.name,
            study.verdict,
            study.promise,
            study.fits["state"].order(1),
            study.fits["reaction"].order(1),
            study.fits["global_state"].order(),
            *(number(worst(x)) for x in (study.residual, study.residual_eps, study.energy_error)),
            "both" if study.keeps_D and study.keeps_D_eps else study.keeps,
        )
        for study in studies
    ]
    caption = f"Overview of {len(studies)} schemes"
    return Table([*titles, "keeps"], rows, 2, caption, studies.sentence())


# ---- words ---------------------------------------------------------------------------------


def heading(study: Study) -> str:
    """Return the heading of a study in one line."""
    start = f", initial={study.initial!r}" if study.initial else ""
    return f"{study.scheme.name} on {study.system.name}, t = {study.t0:g} to {study.t_end:g}{start}"


def summary(study: Study) -> str:
    """Return the points used by the fits, and the orders at the end."""
    keys = {"q": "global_q", "v": "global_v", "lambda": "global_multipliers"}
    at_end = ", ".join(f"{name} {study.fits[key].order()}" for name, key in keys.items())
    return (
        f"p over {_points(study.fits['state'])}, s over {_points(study.fits['reaction'])}; "
        f"orders at t_end: {at_end}; kept to roundoff: {study.keeps}."
    )


# ---- lines ---------------------------------------------------------------------------------


def study_lines(study: Study, width: int) -> Iterator[Line]:
    """Yield a study line by line; raise ValueError unless ``width`` is a positive integer."""
    width = arguments.integer(width, "width", 1)
    table = of_study(study)
    yield table.caption, "bold"
    yield from _wrapped(table.verdict, width, COLOURS[study.holds])
    yield from table.lines(width)
    yield from _wrapped(table.note, width)


def overview_lines(studies: Studies, width: int) -> Iterator[Line]:
    """Yield the verdict on several studies and their overview line by line."""
    width = arguments.integer(width, "width", 1)
    table = overview(studies)
    yield from _wrapped(table.verdict, width, "bold " + COLOURS[studies.holds])
    if studies:
        yield from table.lines(width)


def studies_lines(studies: Studies, width: int) -> Iterator[Line]:
    """Yield several studies line by line: the verdict, the overview, and the table of each."""
    yield from overview_lines(studies, width)
    for study in studies:
        yield "", ""
        yield from study_lines(study, width)


def _wrapped(text: str, width: int, style: str = "") -> Iterator[Line]:
    return ((line, style) for line in textwrap.wrap(text, width))


def text(lines: Iterable[Line]) -> str:
    """Return lines as plain text."""
    return "\n".join(text for text, _ in lines)


def rich(lines: Iterable[Line]) -> Iterator[Any]:
    """Yield objects that rich prints for the lines."""
    from rich.text import Text

    return (Text(text, style=style) for text, style in lines)


def show(lines: Callable[[int], Iterator[Line]], file: TextIO | None) -> None:
    """Print lines for a width: with rich on a terminal if rich is installed, else plain."""
    out = sys.stdout if file is None else file
    if not out.isatty():
        print(text(lines(WIDTH)), file=out)
        return
    try:
        from rich.console import Console
    except ImportError:
        print(text(lines(min(WIDTH, shutil.get_terminal_size().columns))), file=out)
    else:
        console = Console(file=out, highlight=False)
        console.print(*rich(lines(console.width)), sep="\n")


# ---- objects -------------------------------------------------------------------------------


def attach(
    kind: type, lines: Callable[[Any, int], Iterator[Line]], page: Callable[[Any], Table]
) -> None:
    """Attach tables to the objects of a class: as text, printed, and as HTML in a notebook."""

    def table(self: Any, width: int = WIDTH) -> str:
        """Return tables and verdict as plain text with at most ``width`` characters in a line."""
        return text(lines(self, width))

    def shown(self: Any, file: TextIO | None = None) -> None:
        """Print tables and verdict: with rich on a terminal if rich is installed, else plain.

        Parameters
        ----------
        file : text stream, optional
            Default: standard output.
        """
        show(partial(lines, self), file)

    def console(self: Any, console: Any, options: Any) -> Iterator[Any]:
        return rich(lines(self, options.max_width))

    def notebook(self: Any) -> str | None:
        return web.notebook([("", "", page(self))])

    methods = {"table": table, "__str__": lambda self: table(self), "show": shown,
               "__rich_console__": console, "_repr_html_": notebook}  # fmt: skip
    for name, method in methods.items():
        method.__name__ = name
        setattr(kind, name, method)
