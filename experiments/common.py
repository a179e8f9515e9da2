"""What the experiments share: rows that compare, and what a script does with its arguments.

An experiment NAME.py has a docstring about the publication, a function ``run(quick)`` that returns
its rows and what is drawn, and a function ``draw(data)`` that returns a figure of matplotlib. It
ends in ``common.main(run, draw)``:

    python experiments/NAME.py                   # the table; docs/evidence/NAME.json and NAME.png
    python experiments/NAME.py --quick           # smaller, in seconds, the table only
    python experiments/NAME.py --folder DIR      # files into DIR

The exit status is 1 if a row does not compare as it should.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dalembert.show.palette import COLOURS
from dalembert.show.table import Table, text

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "evidence"
TITLES = ("quantity", "printed", "here", "verdict")
BYTES = 60_000  # of a picture


@dataclass(frozen=True)
class Row:
    """What was printed beside what was computed; `near` and `holds` make rows.

    ``agrees`` comes from a stated tolerance or criterion, which stands in ``note``.  ``differs``
    says why it is known not to agree: such a row is wrong when it does.
    """

    quantity: str
    printed: str
    here: str
    agrees: bool
    note: str
    differs: str = ""

    @property
    def good(self) -> bool:
        """Whether the row compares as it should."""
        return self.agrees != bool(self.differs)

    @property
    def verdict(self) -> str:
        """Say in words how the two compare, or that what was found holds: nothing was printed."""
        word = "holds" if self.printed == "-" else "agrees"
        if self.good:
            return f"differs: {self.differs}" if self.differs else f"{word}: {self.note}"
        return f"UNEXPECTED, {word}: {self.note}" if self.agrees else f"FAILS: {self.note}"


def near(quantity: str, printed: float, here: float, within: float, *, digits: int = 6,
         source: str = "", note: str = "", differs: str = "") -> Row:  # fmt: skip
    """Compare two numbers: they agree where they differ by at most ``within``.

    ``source`` says where a number is from that the publication does not print, ``note`` what else
    belongs to the verdict.
    """
    off = abs(here - printed)
    said = (f"{source}: " if source else "") + f"{printed:.{digits}g}"
    return Row(quantity, said, f"{here:.{digits}g}", bool(off <= within),
               f"off by {off:.1e}, at most {within:g}" + (f"; {note}" if note else ""),
               differs)  # fmt: skip


def holds(quantity: str, claim: str, here: str, test: bool, criterion: str, *,
          differs: str = "") -> Row:  # fmt: skip
    """Compare a claim in words with a measured property, ``test`` by ``criterion``."""
    return Row(quantity, claim, here, bool(test), criterion, differs)


def slope(h: Sequence[float], errors: Sequence[float]) -> float:
    """Return the least squares slope of log errors over log h: the order."""
    return float(np.polyfit(np.log(h), np.log(errors), 1)[0])


def table(rows: Sequence[Row]) -> str:
    """Return the rows as text."""
    cells = [(row.quantity, row.printed, row.here, row.verdict) for row in rows]
    return text(Table(list(TITLES), cells, len(TITLES)).lines(sys.maxsize))


def colours() -> Any:
    """Return a context in which curves have the colours of the package."""
    import matplotlib
    from cycler import cycler

    return matplotlib.rc_context({"axes.prop_cycle": cycler(color=COLOURS)})


def picture(figure: Any) -> bytes:
    """Return a figure as a PNG of few colours."""
    from PIL import Image

    raw, small = io.BytesIO(), io.BytesIO()
    figure.savefig(raw, format="png", dpi=100)
    few = Image.open(raw).convert("RGB").quantize(160, method=Image.Quantize.MAXCOVERAGE)
    few.save(small, format="png", optimize=True)
    return small.getvalue()


def main(
    run: Callable[[bool], tuple[list[Row], Any]],
    draw: Callable[[Any], Any],
    arguments: Sequence[str] | None = None,
) -> None:
    """Run the experiment as the arguments say, and exit."""
    name = Path(sys.modules[run.__module__].__file__ or "").stem
    about = (sys.modules[run.__module__].__doc__ or "").strip()
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="smaller, in seconds")
    where = "where NAME.json and NAME.png go; docs/evidence, nowhere if quick"
    parser.add_argument("--folder", type=Path, metavar="DIR", help=where)
    options = parser.parse_args(arguments)
    folder = options.folder or (None if options.quick else FOLDER)

    start = time.process_time()
    rows, data = run(options.quick)
    seconds = time.process_time() - start
    print(about.splitlines()[0], table(rows), f"{seconds:.1f} s of cpu time", sep="\n\n")
    if not rows:
        sys.exit("no rows")
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        result = {
            "title": about.splitlines()[0],
            "seconds": float(f"{seconds:.2g}"),
            "rows": [asdict(row) | {"verdict": row.verdict} for row in rows],
        }
        (folder / f"{name}.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        with colours():
            png = picture(draw(data))
        if len(png) > BYTES:
            sys.exit(f"the picture has {len(png)} bytes, more than {BYTES}")
        (folder / f"{name}.png").write_bytes(png)
    sys.exit(any(not row.good for row in rows))
