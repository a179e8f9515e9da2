"""No line of code is longer than 100 columns, and none ends in blanks.

Usage: ``python check_columns.py SOURCE_ROOT``
"""

from __future__ import annotations

import sys
from pathlib import Path

COLUMNS = 100
FOLDERS = (
    "benchmarks", "csrc", "docs", "examples", "experiments", "include", "python", "tests",
)  # fmt: skip
ENDINGS = {".c", ".h", ".py", ".pyi", ".build"}


def complaints(root: Path) -> list[str]:
    """What is wrong, one line each."""
    found = []
    files = [path for folder in FOLDERS for path in sorted((root / folder).rglob("*"))]
    for path in [root / "meson.build", root / "version.py", *files]:
        if path.suffix not in ENDINGS:
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            where = f"{path.relative_to(root)}:{number}"
            if len(line) > COLUMNS:
                found.append(f"{where} has {len(line)} columns")
            if line != line.rstrip():
                found.append(f"{where} ends in blanks")
    return found


if __name__ == "__main__":
    (source_root,) = sys.argv[1:]
    wrong = complaints(Path(source_root))
    sys.exit("\n".join(wrong) if wrong else 0)
