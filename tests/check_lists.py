"""What lies in a directory is what meson.build lists: no source is forgotten.

Usage: ``python check_lists.py DIRECTORY PATTERN... -- NAME...``
"""

from __future__ import annotations

import sys
from pathlib import Path


def main(directory: str, *rest: str) -> str | None:
    """Compare the files of ``directory`` that match a pattern with the names listed."""
    split = rest.index("--")
    patterns, listed = rest[:split], set(rest[split + 1 :])
    root = Path(directory)
    there = {str(path.relative_to(root)) for pattern in patterns for path in root.glob(pattern)}
    if there != listed:
        return f"{directory}: not listed in meson.build: {sorted(there - listed)}; " \
               f"listed, not there: {sorted(listed - there)}"
    print(f"{directory}: {len(there)} files")
    return None


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
