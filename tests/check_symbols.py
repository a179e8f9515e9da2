"""The shared library exports the functions that the headers mark DAL_API, and nothing else.

Usage: ``python check_symbols.py libdalembert.so HEADER...``
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path


def declared(header: str) -> set[str]:
    """Names of the functions that ``header`` marks DAL_API."""
    text = re.sub(r"/\*.*?\*/", "", header, flags=re.S)
    return set(re.findall(r"^DAL_API\b[^;{(]*?\b(dal_\w+)\s*\(", text, flags=re.M))


def exported(library: str) -> set[str]:
    """Names in the dynamic symbol table of ``library`` that it defines."""
    table = subprocess.run(
        ["nm", "--dynamic", "--defined-only", "--format=posix", library],
        capture_output=True, text=True, check=True,
    ).stdout
    return {line.split()[0] for line in table.splitlines()}


def read(headers: list[str]) -> str:
    """Return the text of the headers, one after the other."""
    return "\n".join(Path(header).read_text(encoding="utf-8") for header in headers)


def main(library: str, *headers: str) -> str | None:
    wanted, found = declared(read(headers)), exported(library)
    if not wanted:
        return f"{headers}: no function is marked DAL_API"
    if wanted != found:
        return f"declared, not exported: {sorted(wanted - found)}; " \
               f"exported, not declared: {sorted(found - wanted)}"
    print(f"{len(found)} functions")
    return None


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
