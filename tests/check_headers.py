"""Everything that the headers declare has a comment, which the reference shows; the first header
is short enough to be read on the first day.

Usage: ``python check_headers.py FOLDER HEADER...`` with the folder of comments.py.
"""

from __future__ import annotations

import importlib
import sys

from check_symbols import declared
from check_symbols import read as read_all

MOST_LINES = 480


def main(folder: str, *headers: str) -> str | None:
    sys.path.insert(0, folder)
    comments = importlib.import_module("comments")
    entries = [entry for header in comments.HEADERS for entry in comments.read(header)[1]]
    shown = {name for entry in entries if entry.kind == "function" for name in entry.names}
    if left := declared(read_all(headers)) ^ shown:
        return f"either in a header or in the reference, not in both: {sorted(left)}"
    wrong = comments.complaints()
    if (lines := len(read_all(headers[:1]).splitlines())) > MOST_LINES:
        wrong.append(f"{headers[0]} has {lines} lines: expected at most {MOST_LINES}")
    if not wrong:
        print(f"{len(shown)} functions, {len(entries)} comments")
    return "\n".join(wrong) or None


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
