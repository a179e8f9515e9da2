"""A source of the core calls sources before it, and includes headers of its own floor or lower.

Usage: ``python check_floors.py CSRC libdalembert.a HEADER... FLOOR...`` where a FLOOR is the names
of its sources, relative to the folder CSRC, with commas between them, the ground first, and in each
the callers behind.  So no calls go in a circle.  What is called is read from the object files.

Also: what is not static is public or called ``dal__name``, and every source is on a floor.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

from check_symbols import declared, read

# Headers that code of the user includes, and the folder where they belong.
STEP_HEADERS = {
    "deformation": "system", "lu": "algebra", "rows": "algebra", "residual": "algebra",
    "field": "system", "kernel": "step", "lanes": "step", "family": "step",
    "series": "step",
}  # fmt: skip


def symbols(archive: str) -> tuple[dict[str, str], dict[str, set[str]]]:
    """Read a static library.

    Returns
    -------
    definitions : dict
        The object that defines each external symbol.
    uses : dict
        For each object, the external symbols that it uses and does not define.
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


def check_calls(archive: str, headers: list[str], floors: list[list[str]]) -> list[str]:
    """What is wrong with who calls whom, one line each."""
    place_of = {
        source.replace("/", "_"): place
        for place, source in enumerate(source for floor in floors for source in floor)
    }
    definitions, uses = symbols(archive)
    public = declared(read(headers))
    found = [f"{source} is on no floor" for source in sorted(uses.keys() - place_of.keys())]
    found += [f"{source} is not in {archive}" for source in sorted(place_of.keys() - uses.keys())]
    if found:
        return found
    for name, source in sorted(definitions.items()):
        if name not in public and not name.startswith("dal__"):
            found.append(f"{source} defines {name}, neither public nor called dal__")
    for source, names in sorted(uses.items()):
        for name in sorted(names & definitions.keys()):
            other = definitions[name]
            if place_of[other] > place_of[source]:
                found.append(f"{source} uses {name} of {other}, which stands behind it")
    return found


def check_includes(csrc: Path, headers: list[str], floors: list[list[str]]) -> list[str]:
    """What is wrong with who includes what, one line each."""
    floor_of = {
        source.split("/")[0]: number for number, floor in enumerate(floors) for source in floor
    }
    public = {Path(header).stem: Path(header).stem for header in headers} | STEP_HEADERS
    found = []
    for path in sorted(csrc.rglob("*.[ch]")):
        own = path.relative_to(csrc).parts[0]
        for name in re.findall(r'^#include "(.*)"', path.read_text(encoding="utf-8"), flags=re.M):
            folder, stem = name.split("/")[0], Path(name).stem
            floor = floor_of.get(public[stem] if folder == "dalembert" else folder, 0)
            if name != "dalembert.h" and floor > floor_of[own]:
                found.append(f"{path.relative_to(csrc)} includes {name}, of a higher floor")
    return found


if __name__ == "__main__":
    csrc, archive, *rest = sys.argv[1:]
    headers = [name for name in rest if name.endswith(".h")]
    floors = [floor.split(",") for floor in rest if not floor.endswith(".h")]
    found = check_calls(archive, headers, floors) + check_includes(Path(csrc), headers, floors)
    sys.exit("\n".join(found) or None)
