"""Put the tables of docs/evidence/*.json into docs/evidence.md, between the marks of each.

``python experiments/table.py`` writes the page anew; with ``--check`` it says whether page and
results differ, with exit status 1 if they do.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from common import FOLDER, TITLES

PAGE = FOLDER.parent / "evidence.md"
MARKED = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end of table -->)", re.DOTALL)


def cell(text: str) -> str:
    """Return a text as a cell of a table in Markdown."""
    return re.sub(r"([|_*<\\])", r"\\\1", text)


def markdown(results: dict) -> str:
    """Return the table of one experiment, and what it cost."""
    lines = ["| " + " | ".join(TITLES) + " |", "| " + " | ".join("---" for _ in TITLES) + " |"]
    lines += ["| " + " | ".join(cell(row[title]) for title in TITLES) + " |"
              for row in results["rows"]]  # fmt: skip
    return "\n".join(lines) + f"\n\nCost: {results['seconds']:g} s of cpu time.\n"


def renewed(page: str, folder: Path) -> str:
    """Return the page with the tables of all results, each of which has its place."""
    names = [name for _, name, _ in MARKED.findall(page)]
    there = sorted(path.stem for path in folder.glob("*.json"))
    if sorted(names) != there:
        sys.exit(f"tables of the page: {sorted(names)}; results: {there}")

    def put(match: re.Match) -> str:
        results = json.loads((folder / f"{match[2]}.json").read_text(encoding="utf-8"))
        return match[1] + markdown(results) + match[3]

    return MARKED.sub(put, page)


def main(check: bool) -> str | None:
    """Renew the page, or say whether it is the one that the results make."""
    page = PAGE.read_text(encoding="utf-8")
    new = renewed(page, FOLDER)
    if not check:
        PAGE.write_text(new, encoding="utf-8")
    elif new != page:
        return f"{PAGE.name} is not what its results make: python experiments/table.py"
    return None


if __name__ == "__main__":
    sys.exit(main("--check" in sys.argv[1:]))
