"""A source of the core calls its own floor or lower ones, as its object files show.

Usage: ``python check_floors.py libdalembert.a dalembert.h FLOOR...`` where a FLOOR is the names of
its sources with commas between them, the ground first.

Also: what is not static is public or called ``dal__name``, and every source is on a floor.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

from check_symbols import declared


def symbols(archive: str) -> tuple[dict[str, str], dict[str, set[str]]]:
    """Read a static library.

    Returns
    -------
    definitions : dict
        The source that defines each external symbol.
    uses : dict
        For each source, the external symbols that it uses and does not define.
    """
    table = subprocess.run(
        ["nm", "--extern-only", "--format=posix", archive],
        capture_output=True, text=True, check=True,
    ).stdout
    definitions: dict[str, str] = {}
    uses: dict[str, set[str]] = defaultdict(set)
    source = ""
    for line in table.splitlines():
        if member := re.fullmatch(r".*\[(?:.*csrc_)?(\w+\.c)\.o\]:", line):
            source = member[1]
            uses[source] = set()
        elif line:
            name, kind = line.split()[:2]
            if kind in "Uw":
                uses[source].add(name)
            else:
                definitions[name] = source
    return definitions, uses


def complaints(archive: str, header: str, floors: list[list[str]]) -> list[str]:
    """What is wrong with the house, one line each."""
    floor_of = {source: number for number, floor in enumerate(floors) for source in floor}
    definitions, uses = symbols(archive)
    public = declared(Path(header).read_text(encoding="utf-8"))
    found = [f"{source} is on no floor" for source in sorted(uses.keys() - floor_of.keys())]
    found += [f"{source} is not in {archive}" for source in sorted(floor_of.keys() - uses.keys())]
    if found:
        return found
    for name, source in sorted(definitions.items()):
        if name not in public and not name.startswith("dal__"):
            found.append(f"{source} defines {name}, neither in {header} nor called dal__")
    for source, names in sorted(uses.items()):
        for name in sorted(names & definitions.keys()):
            other = definitions[name]
            if floor_of[other] > floor_of[source]:
                found.append(
                    f"{source} (floor {floor_of[source]}) uses {name} "
                    f"of {other} (floor {floor_of[other]})"
                )
    return found


if __name__ == "__main__":
    archive, header, *floors = sys.argv[1:]
    found = complaints(archive, header, [floor.split(",") for floor in floors])
    sys.exit("\n".join(found) or None)
