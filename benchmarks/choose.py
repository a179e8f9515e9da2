"""Which scheme for which accuracy, by `dal.recommend`: the tables of docs/howto/scheme.md.

Usage: ``./dev shell python benchmarks/choose.py``, a minute on a quiet machine; or
``... choose.py --tables``, which measures nothing.

Asks `dal.recommend` for systems of every kind and four accuracies, ROUNDS times, and writes the
milliseconds of all that it tried to docs/howto/scheme.json, and from these the tables between the
marks of docs/howto/scheme.md.  tests/python/study/test_choice.py compares the last column of
docs/reference/schemes.md with the file.
"""

from __future__ import annotations

import json
import math
import re
import statistics
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import sympy as sp

import dalembert as dal

DOCS = Path(__file__).resolve().parents[1] / "docs" / "howto"
ACCURACIES = ("1e-3", "1e-6", "1e-9", "1e-11")
ROUNDS = 5  # of which the median counts
NEAR = 1.2  # times the time of the fastest: to be chosen as well
BEGIN, END = "<!-- by benchmarks/choose.py -->\n\n", "\n<!-- to here -->\n"
ORDER = ("base", "bm4", "bm6", "kl6", "kl8", "ss10", "bm6, auto", "kl8, auto", "reference",
         "taylor")  # fmt: skip


def springs_with_magnet() -> dal.System:
    """L has a term that is linear in v: the motion is not reversible."""
    x, y, z = dal.coordinates("x y z")
    kinetic, potential = (x.d**2 + y.d**2 + z.d**2) / 2, (x**2 + 2 * y**2 + 1.5 * z**2) / 2
    return dal.System.from_sympy(kinetic - potential + x**2 * z.d, [z.d - y * x.d],
                                 q0=[0.5, 0.3, -0.2], v0=[1, 0.7, 0.3])  # fmt: skip


def comet() -> dal.System:
    """Kepler's problem on an ellipse with e = 0.8; a third coordinate rests."""
    x, y, z = dal.coordinates("x y z")
    kinetic = (x.d**2 + y.d**2 + z.d**2) / 2
    return dal.System.from_sympy(kinetic + 1 / sp.sqrt(x**2 + y**2), [z.d], q0=[0.2, 0, 0],
                                 v0=[0, 3, 0])  # fmt: skip


def sleigh_in_oil() -> dal.System:
    """In a well, with friction and a push that swings."""
    x, y, theta = dal.coordinates("x y theta")
    t = dal.time
    return dal.System.from_sympy(
        (x.d**2 + y.d**2) / 2 + theta.d**2 / 4 - (x**2 + y**2) / 2,
        [sp.cos(theta) * y.d - sp.sin(theta) * x.d - theta.d / 5],
        force={x: -x.d / 50 + sp.sin(t) / 10, theta: -theta.d / 50},
        q0=[0.5, 0, 0], v0=[0.5, 0.2, 1],
    )  # fmt: skip


CATALOGUE = dal.systems.get
# kind, and of each system a name, how it is made, and t_end
KINDS: dict[str, dict[str, tuple[Any, float]]] = {
    "constant mass": {
        "knife_edge": (CATALOGUE, 50), "particle_oscillator": (CATALOGUE, 100),
        "heisenberg": (CATALOGUE, 100), "contact_oscillator": (CATALOGUE, 100),
        "robot": (CATALOGUE, 50), "cvt": (CATALOGUE, 100), "magnet": (springs_with_magnet, 100),
    },
    "M(q), or forces of v": {
        "rolling_disc": (CATALOGUE, 50), "genmass": (CATALOGUE, 50), "n_trailer": (CATALOGUE, 50),
        "sleigh_in_oil": (sleigh_in_oil, 50),
    },
    "the speed changes a lot": {
        "particle": (CATALOGUE, 100), "sleigh": (CATALOGUE, 100),
        "sleigh_contact": (CATALOGUE, 100), "comet": (comet, 50),
    },
}  # fmt: skip


def plain(one: Any) -> str:
    """The name of what was tried, without its base."""
    name = one.scheme.removeprefix("leapfrog-").removeprefix("midpoint-")
    if name in ("leapfrog", "midpoint"):
        return "base"
    return name + ", auto" if one.h == "auto" else name


def measured(system: dal.System, t_end: float, accuracy: str) -> dict[str, float | None]:
    """Return the milliseconds of each scheme, the median over rounds; None: not reached."""
    seen: dict[str, list[float]] = {name: [] for name in ORDER}
    for _ in range(ROUNDS):
        found = dal.recommend(system, t_end=t_end, accuracy=float(accuracy))
        for one in found.tried:
            reached = one.error <= float(accuracy)
            seen[plain(one)].append(one.seconds * 1e3 if reached else math.inf)
    medians = {name: statistics.median(times) for name, times in seen.items()}
    return {name: float(f"{x:.3g}") if x < math.inf else None for name, x in medians.items()}


def ratios(systems: dict[str, Any], accuracy: str) -> dict[str, tuple[float, int]]:
    """Return the median of time / best time of each scheme, and how often it is the first."""
    table: dict[str, list[float]] = {name: [] for name in ORDER}
    for of in systems.values():
        times = {name: math.inf if x is None else x for name, x in of[accuracy].items()}
        for name in ORDER:
            table[name].append(times[name] / min(times.values()))
    return {name: (statistics.median(all_), all_.count(1.0)) for name, all_ in table.items()}


def chart(results: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of the chart: the fastest, and what is near."""
    yield "| | about " + " | about ".join(ACCURACIES) + " |"
    yield "|---" * (1 + len(ACCURACIES)) + "|"
    for kind, systems in results.items():
        cells = []
        for accuracy in ACCURACIES:
            row = sorted((ratio, name) for name, (ratio, _) in ratios(systems, accuracy).items())
            cells.append(", ".join(label(name) for x, name in row if x <= NEAR * row[0][0]))
        yield f"| {kind} | " + " | ".join(cells) + " |"


def matrix(results: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of the table of all that was measured."""
    yield "| | scheme | " + " | ".join(ACCURACIES) + " |"
    yield "|---" * (2 + len(ACCURACIES)) + "|"
    for kind, systems in results.items():
        columns = [ratios(systems, accuracy) for accuracy in ACCURACIES]
        first = f"{kind}: {len(systems)} systems"
        for name in ORDER:
            cells = []
            for column in columns:
                x, wins = column[name]
                text = "-" if x == math.inf else f"{x:.{1 if x < 9.95 else 0}f}"
                best = x == min(ratio for ratio, _ in column.values())
                cells.append((f"**{text}**" if best else text) + (f" ({wins})" if wins else ""))
            yield f"| {first} | {label(name)} | " + " | ".join(cells) + " |"
            first = ""


def page(text: str, results: dict[str, Any]) -> str:
    """Return the page with new tables."""
    for table in (chart, matrix):
        before, rest = text.split(BEGIN, 1)
        # the marks of what is done are not looked at again
        text = before + BEGIN.upper() + "\n".join(table(results)) + "\n" + rest[rest.index(END):]
    return text.replace(BEGIN.upper(), BEGIN)


def label(name: str) -> str:
    """The name of a row."""
    if name == "base":
        return "`leapfrog`, `midpoint`"
    scheme, *auto = name.split(", ")
    return f"`{scheme}`" + (', `h="auto"`' if auto else "")


def measure() -> dict[str, Any]:
    """Return the milliseconds of all kinds, systems, accuracies and schemes."""
    results: dict[str, Any] = {}
    for kind, systems in KINDS.items():
        results[kind] = {}
        for name, (make, t_end) in systems.items():
            system = make(name) if make is CATALOGUE else make()
            results[kind][name] = {a: measured(system, t_end, a) for a in ACCURACIES}
            print(name, flush=True)
    return results


def main() -> None:
    where, data = DOCS / "scheme.md", DOCS / "scheme.json"
    if "--tables" not in sys.argv[1:]:
        text = json.dumps(measure(), indent=1)
        # the schemes of one accuracy on one line
        data.write_text(re.sub(r"\n {4,}", " ", text.replace("\n   }", " }")) + "\n")
    where.write_text(page(where.read_text(), json.loads(data.read_text())))


if __name__ == "__main__":
    main()
