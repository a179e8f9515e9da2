"""From peers.json to peers.md and two pictures: ``python draw.py PEERS_JSON FOLDER``.

Everything that the page says in numbers, and who wins where, is computed from the results.
"""

from __future__ import annotations

import json
import math
import statistics
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dalembert.show.palette import COLOURS, LIGHT

OURS = ("leapfrog", "midpoint", "suzuki4", "bm4", "kl6", "bm6", "kl8", "ss10", "kl8 auto",
        "ss10 auto", "bm6 auto", "midpoint keep", "kl8 keep", "reference", "taylor",
        "taylor once")  # fmt: skip
FLOWS = ("reference", "taylor", "taylor once")  # the rest are steps of dalembert itself
KEEP = ("midpoint keep", "kl8 keep")
IN_D = ("heyoka in D", "GSL rk8pd in D")
ACCURACIES = (1e-3, 1e-6, 1e-9, 1e-11, 1e-12)
# What dalembert is to reach: see bars()
HEYOKA = ("heyoka", "heyoka in D")
CALL_BARS = 0.9, 1.1  # of the pairs in which "taylor" is first, and times of heyoka everywhere
BARE_BARS = 0.8, 0.62  # times of the integrator of heyoka: everywhere, and the geometric mean
BARE = (1e-6, 1e-9, 1e-12)
ENERGY_BARS = ((1e5, 100.0), (1e7, 1e4))  # T, and how much less than the best peer
ENERGY_COUNT = 3  # on so many reversible problems
SLOWEST = 5.0  # of the energy picture, times the cpu time that is given
WORK = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)  # errors of the energy

# One colour for each peer; curves of one peer differ by their lines and markers.
BLUE, RED, GREEN, PINK, ORANGE, SKY, BLACK = COLOURS
GREY = LIGHT["quiet"]
STYLES = {
    "leapfrog": (BLUE, ":", "o"), "bm6": (BLUE, "--", "s"), "ss10": (BLUE, "-", "o"),
    "kl8": (BLUE, "-", "D"), "kl8 auto": (BLUE, "--", "^"), "kl8 keep": (BLUE, ":", "D"),
    "reference": (SKY, "-", "v"), "taylor": (SKY, "-", "o"),
    "heyoka": (RED, "--", "^"), "heyoka in D": (RED, "-", "^"),
    "GSL rk8pd": (ORANGE, "--", "v"), "GSL rk8pd in D": (ORANGE, "-", "v"),
    "SciPy DOP853": (GREEN, "-", "s"), "CVODE Adams": (PINK, "-", "P"),
    "Exudyn": (BLACK, "-", "X"), "SPARK 4": (GREY, "-", "*"), "odelab energy": (GREY, "--", "d"),
}  # fmt: skip


# ---- numbers ---------------------------------------------------------------------------------


def curve(method: dict[str, Any], kind: str = "median") -> list[tuple[float, float]]:
    """(seconds, error) of what worked, from coarse to fine."""
    return [(p[kind], p["error"]) for p in method["points"] if kind in p]


def seconds_for(method: dict[str, Any], accuracy: float, kind: str = "median") -> float | None:
    """Return the least time for an accuracy, between two settings by the logarithms."""
    points = curve(method, kind)
    found = [s for s, error in points if error <= accuracy]
    for (s, e), (s2, e2) in zip(points, points[1:]):
        if e > accuracy >= e2 > 0:
            part = math.log(accuracy / e) / math.log(e2 / e)
            found.append(math.exp(math.log(s) + part * math.log(s2 / s)))
    return min(found) if found else None


def best(methods: dict[str, Any], accuracy: float, ours: bool,
         but: tuple[str, ...] = ()) -> tuple[float, str] | None:  # fmt: skip
    found = [(s, name) for name, method in methods.items()
             if (name in OURS) == ours and name not in but
             and (s := seconds_for(method, accuracy)) is not None]  # fmt: skip
    return min(found) if found else None


def rivals(energy: dict[str, Any], T: float, but: tuple[str, ...],
           ) -> list[tuple[float, str] | None]:  # fmt: skip
    """The smallest error of the energy up to T, of dalembert and of others as fast."""
    sides: list[tuple[float, str] | None] = []
    for ours in (True, False):
        found = [(e, name) for name, m in energy["methods"].items()
                 if (name in OURS) == ours
                 and name not in ("odelab energy", *but)
                 and m.get("rate", 1e9) <= 2 * energy["target"]
                 and (e := at(m, T)) is not None]  # fmt: skip
        sides.append(min(found) if found else None)
    return sides


def at(method: dict[str, Any], T: float) -> float | None:
    return next((p["error"] for p in method["points"] if p["T"] == T), None)


def times_of(results: dict[str, Any]) -> list[float]:
    return sorted({p["T"] for problem in results["problems"].values()
                   for method in problem.get("energy", {"methods": {}})["methods"].values()
                   for p in method["points"]})  # fmt: skip


def number(value: float | None, digits: int = 2) -> str:
    if value is None:
        return "-"
    if 100 <= value < 10000:
        return f"{value:.0f}"
    if value == 0:
        return "0"
    return f"{value:.{digits}g}" if 0.01 <= value < 100 else f"{value:.{digits - 1}e}".replace(
        "e-0", "e-").replace("e+0", "e")  # fmt: skip


def sizes(problem: dict[str, Any]) -> str:
    constraints = "1 constraint" if problem["m"] == 1 else f"{problem['m']} constraints"
    return f"{problem['n']} coordinates, {constraints}"


def power(value: float) -> str:
    return f"1e{round(math.log10(value))}"


# ---- the page --------------------------------------------------------------------------------


def table(head: list[str], rows: list[list[str]]) -> Iterator[str]:
    yield "| " + " | ".join(head) + " |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield "| " + " | ".join(row) + " |"
    yield ""


def names(results: dict[str, Any]) -> list[str]:
    found: dict[str, None] = {}
    for problem in results["problems"].values():
        found |= dict.fromkeys(problem["state"]) | dict.fromkeys(problem["refused"])
    return list(found)


def duel(ours: tuple[float, str] | None, theirs: tuple[float, str] | None) -> str:
    """Who is faster, and by how much."""
    if ours is None or theirs is None:
        return "-" if ours is theirs else f"only {(ours or theirs)[1]}"  # type: ignore[index]
    ratio = ours[0] / theirs[0]
    return (f"**{ours[1]}**, {1 / ratio:.1f} times faster than {theirs[1]}" if ratio < 1
            else f"{theirs[1]}, {ratio:.1f} times faster than {ours[1]}")  # fmt: skip


def alone(state: dict[str, Any], accuracy: float) -> str:
    """The times of two integrators without calls, and their ratio."""
    ours, *theirs = (seconds_for(state[name], accuracy, "bare") if name in state else None
                     for name in ("taylor", *HEYOKA))
    if not ours or not any(theirs):
        return "-"
    other = min(filter(None, theirs))
    return f"{number(1e3 * ours)}, {number(1e3 * other)}: {ours / other:.2f}"


def count(found: list[str]) -> str:
    """"heyoka 3, GSL 1": how often each is there."""
    numbers = sorted(((found.count(x), x) for x in set(found)), key=lambda x: (-x[0], x[1]))
    return ", ".join(f"{x} {n}" for n, x in numbers) or "nobody"


def verdict(reached: bool) -> str:
    return "reached" if reached else "**missed**"


def against_heyoka(results: dict[str, Any], accuracies: tuple[float, ...], kind: str,
                   ) -> list[tuple[float, str]]:  # fmt: skip
    """The time of "taylor", relative to the better form of heyoka, for each pair."""
    found = []
    for p in results["problems"].values():
        for a in accuracies:
            ours, *theirs = (seconds_for(p["state"][name], a, kind) if name in p["state"] else None
                             for name in ("taylor", *HEYOKA))
            if ours and any(theirs):
                ratio = ours / min(filter(None, theirs))
                found.append((ratio, f"{p['title']}, {power(a)}"))
    return found


def bars(results: dict[str, Any]) -> Iterator[str]:
    """What is asked of dalembert, and what was measured."""
    problems = results["problems"]
    share, most = CALL_BARS
    found = against_heyoka(results, ACCURACIES, "median")
    first = sum(ratio <= 1 for ratio, _ in found)
    if found:
        yield (f"- **A prepared call of `taylor` is faster than one of heyoka in "
               f"{100 * share:.0f} % of all pairs, and takes at most {most} times as long**: "
               f"{verdict(first >= share * len(found) and max(found)[0] <= most)}; it is faster in "
               f"{first} of {len(found)}, and takes at most {max(found)[0]:.2f} times as long "
               f"({max(found)[1]}).")  # fmt: skip
    each, mean = BARE_BARS
    found = against_heyoka(results, BARE, "bare")
    if found:
        whole = math.exp(statistics.fmean(math.log(ratio) for ratio, _ in found))
        yield (f"- **The integrator alone takes at most {each} of heyoka's time for errors from "
               f"1e-6 to 1e-12, in the geometric mean {mean}**: "
               f"{verdict(max(found)[0] <= each and whole <= mean)}; at most {max(found)[0]:.2f} "
               f"({max(found)[1]}), in the mean {whole:.2f}.")  # fmt: skip
    long = [p for p in problems.values() if "energy" in p and p.get("reversible", True)]
    for T, factor in ENERGY_BARS if long else ():
        parts: dict[tuple[str, ...], list[str]] = {(): [], IN_D: []}
        enough = 0
        for but, found in parts.items():
            for p in long:
                ours, theirs = rivals(p["energy"], T, but)
                if ours and theirs:
                    ratio = theirs[0] / max(ours[0], 1e-17)
                    enough += but == IN_D and ratio >= factor
                    found.append(f"{p['title']} {number(ratio)}")
        if parts[IN_D]:
            yield (f"- **The energy up to T = {power(T)}, {number(factor)} times better than the "
                   f"best peer at equal cpu time, on {ENERGY_COUNT} reversible problems**: "
                   f"{verdict(enough >= ENERGY_COUNT)}, on {enough}.  With the same equations for "
                   f"all, the error of the best peer over that of dalembert: "
                   f"{'; '.join(parts[IN_D])}.  The same ratio if peers get the equations in D: "
                   f"{'; '.join(parts[()])}.")  # fmt: skip
    for p in problems.values():
        work = p.get("work", {})
        parts = []
        kinds = (
            ("fixed and controlled steps", (*FLOWS, *KEEP), WORK),
            ("`energy=\"keep\"`", [x for x in OURS if x not in KEEP], WORK[-2:]),
        )
        for what, but, errors in kinds:
            ratios = []
            for a in errors:
                reference = seconds_for(work["reference"], a) if "reference" in work else None
                found = best(work, a, True, tuple(but))
                if reference and found:
                    ratios.append((found[0] / reference, found[1], a))
            if ratios:
                times = [f"{number(r)} at {power(a)} ({name})" for r, name, a in ratios]
                times[0] = times[0].replace(" at", " times as long at")
                parts.append(f"with {what} {verdict(max(ratios)[0] <= 1)}; {', '.join(times)}")
        if parts:
            yield (f"- **At least level with `reference` at equal error of the energy**, to "
                   f"t = 1000, {p['title']}: {'; '.join(parts)}.")  # fmt: skip


def summary(results: dict[str, Any]) -> Iterator[str]:
    """Where dalembert wins and loses, counted."""
    problems = results["problems"].values()
    kinds = (((), "among all"), (IN_D, "without the equations in D"))
    yield "## In short"
    yield ""
    for but, what in kinds:
        first = []
        for p in problems:
            for a in ACCURACIES:
                found = [side for ours in (True, False)
                         if (side := best(p["state"], a, ours, but))]  # fmt: skip
                if found:
                    name = min(found)[1]
                    first.append("dalembert" if name in OURS else name)
        yield (f"- **The state at t = 100**, {what}.  {len(first)} pairs of a problem and an "
               f"accuracy; fastest: {count(first)}.")  # fmt: skip
    for but, what in kinds:
        parts = []
        for T in times_of(results):
            first = []
            for p in problems:
                sides = rivals(p["energy"], T, but) if "energy" in p else [None, None]
                if None not in sides:
                    name = min(sides)[1]  # type: ignore[type-var,index]
                    first.append("dalembert" if name in OURS else name)
            if first:
                parts.append(f"up to {power(T)}: {count(first)}")
        yield (f"- **The energy over long times**, {what}.  Number of problems with the smallest "
               f"error at equal cpu time, {'; '.join(parts)}.")  # fmt: skip
    yield ""


def state_part(results: dict[str, Any]) -> Iterator[str]:
    problems = results["problems"]
    yield "## The state at t = 100"
    yield ""
    yield "![The error of the state at t = 100 against the cpu time of a call](peers-state.png)"
    yield ""
    yield "The fastest method for each accuracy, of dalembert (bold if it wins) and of all others."
    yield "Times between two settings are interpolated logarithmically:"
    yield ""
    yield from table(
        ["", *(power(a) for a in ACCURACIES)],
        [[p["title"], *(duel(best(p["state"], a, True), best(p["state"], a, False))
                        for a in ACCURACIES)] for p in problems.values()],
    )  # fmt: skip
    yield "The integrators alone, without the call from Python: milliseconds of `taylor` and of the"
    yield "better form of heyoka, minima of some rounds."
    yield ""
    yield from table(
        ["", *(power(a) for a in BARE)],
        [[p["title"], *(alone(p["state"], a) for a in BARE)] for p in problems.values()],
    )
    yield "Here `reference` is compared with the same integrator of GSL, coded by hand in C, and"
    yield "the fastest composition with `reference`:"
    yield ""
    rows = []
    for p in problems.values():
        row = [p["title"]]
        for a in (1e-6, 1e-9):
            s = p["state"]
            pair = [(x, "reference") for x in [seconds_for(s["reference"], a)] if x]
            row.append(duel(*pair, best({"GSL rk8pd": s["GSL rk8pd"]}, a, False))
                       if pair and "GSL rk8pd" in s else "-")  # fmt: skip
            other = best(s, a, True, FLOWS)
            row.append(f"{other[1]}, {pair[0][0] / other[0]:.1f} times as fast"
                       if pair and other else "-")  # fmt: skip
        rows.append(row)
    yield from table(["", "1e-6: GSL", "1e-6: compositions", "1e-9: GSL", "1e-9: compositions"],
                     rows)  # fmt: skip
    yield "Milliseconds of cpu time for an error of the state; - : not reached with the settings"
    yield "that were tried, or the method does not apply to the problem."
    yield ""
    for accuracy in (*ACCURACIES[:3], ACCURACIES[-1]):
        yield f"### {power(accuracy)}"
        yield ""
        rows = []
        for name in names(results):
            row = [f"`{name}`" if name in OURS else name]
            for p in problems.values():
                s = seconds_for(p["state"][name], accuracy) if name in p["state"] else None
                row.append(number(s and 1e3 * s))
            rows.append(row)
        yield from table(["", *(p["title"] for p in problems.values())], rows)


def energy_part(results: dict[str, Any]) -> Iterator[str]:
    problems = {k: p for k, p in results["problems"].items() if "energy" in p}
    times = times_of(results)
    if not problems or not times:
        return
    yield "## The energy over long times"
    yield ""
    yield "![The largest error of the energy up to T, at equal cpu time](peers-energy.png)"
    yield ""
    yield "The step or tolerance of every method is chosen for about the cpu time of heyoka with"
    yield "its default tolerance.  (If heyoka is not installed, `reference` with 1e-9 takes its"
    yield "place.)  Methods that cannot be as fast run with their usual settings, and their time is"
    yield "in the last table.  The first table has the smaller error of the energy, of dalembert"
    yield "(bold) or of the best other method.  It omits methods that take more than twice that"
    yield "time, and `odelab energy`, which conserves the energy but does not stay in D:"
    yield ""
    for but in ((), IN_D):
        if but:
            yield "The same without the equations in D, which need a basis of D:"
            yield ""
        rows = []
        for p in problems.values():
            row = [p["title"], f"{number(1e6 * p['energy']['target'])} µs"]
            for T in times:
                sides = rivals(p["energy"], T, but)
                if None in sides:
                    one = sides[0] or sides[1]
                    row.append(f"{one[1]} {number(one[0])}" if one else "-")
                    continue
                (first, name), (second, other) = sorted(sides)  # type: ignore[type-var]
                bold = f"**{name}**" if name in OURS else name
                row.append(f"{bold} {number(first)}; {other} {number(second)}")
            rows.append(row)
        yield from table(["", "cpu for t = 1", *(power(T) for T in times)], rows)
    yield "These tables show the largest error of the energy up to T, and the cpu time for a unit"
    yield "of time.  The last column is the largest residual of the constraints in these states."
    yield ""
    for p in problems.values():
        yield f"### {p['title']}"
        yield ""
        rows = []
        for name, m in p["energy"]["methods"].items():
            setting = m.get("setting")
            kind = p["state"][name]["kind"]
            how = "-" if setting is None else (
                f"h = {number(results['t_state'] / setting, 3)}" if kind == "steps"
                else f"{kind} {number(setting)}")  # fmt: skip
            off = max((x["residual"] for x in m["points"]), default=None)
            cpu = f"{number(1e6 * m['rate'])} µs" if m.get("rate", math.inf) < math.inf else "-"
            rows.append([f"`{name}`" if name in OURS else name, how, cpu,
                         *(number(at(m, T)) for T in times), number(off, 1)])  # fmt: skip
        yield from table(["", "setting", "cpu", *(power(T) for T in times), "off D"], rows)
    for p in problems.values():
        if "work" not in p:
            continue
        yield f"## The cost of an error of the energy: {p['title']}"
        yield ""
        yield "Milliseconds of cpu time up to t = 1000 for a largest error of the energy; - : not"
        yield "reached with the settings of the state that were fast enough to be tried:"
        yield ""
        rows = [[f"`{name}`" if name in OURS else name,
                 *(number(s and 1e3 * s) for s in (seconds_for(m, a) for a in WORK))]
                for name, m in p["work"].items()]  # fmt: skip
        yield from table(["", *map(power, WORK)], rows)


INTRODUCTION = """\
# dalembert and its peers

This page compares run time and accuracy of dalembert and six other codes.  All codes get equations
generated from the same SymPy model and run in one process, in turn; variants marked "in D" get the
equations reduced by hand.  To reproduce it:

    python benchmarks/peers/run.py

This writes the page, its pictures and `peers.json`.  Peers that are not installed are skipped:
`pip install heyoka scipy numba scikit-sundae exudyn`.

"""

ADVICE = """\
## Which method

- An accurate run of a system from expressions: `taylor`, the default of `dal.integrate` without
  `h`.  For errors of 1e-9 and less it is mostly the fastest code here.  No code needs less
  preparation: the equations on D come from the Lagrangian.  Its energy walks at random, by roundoff
  alone.
- The same with 1e-3 to 1e-6, one call: the call from Python takes as long as the work.  Prepare a
  `Stepper`, or run an ensemble.
- A control loop, or large steps: a scheme of order 2 to 6.  A step takes a microsecond, has no
  error control that could surprise, and keeps D exactly.
- Millions of oscillations with a given cost for each: a symmetric composition (`bm6`, `kl8`,
  `ss10`).  The energy stays in a band, whose width the step size sets.
- Functions of Python or C instead of expressions: the schemes, or `reference`.  There are no series
  of a function that is not known.
- Large sparse systems, forces with jumps, stick and slip: the schemes of order 2.  `taylor` ends a
  piece at each jump, and refuses a motion that slides along one.
- A stiff force: `reference` with `method="rodas"`.
- D_ε, discrete mechanics, backward error analysis: the schemes are the subject.

"""

HOW = """\
## How it was measured

- Time is the cpu time of a user's call from Python, with its overhead (some 0.1 ms for
  `dal.integrate`).  It is the median of rounds; each round runs every method with each of its
  settings, in a different order.  It excludes building and compiling models: see below.
- The error is the largest difference of a coordinate or velocity from a state of 21 digits.  This
  state is computed by extrapolation (Gragg) in 34 digits, twice with different steps and orders.
  The two agree to 1e-25.  With heyoka in long double they agree to 1e-15
  (`benchmarks/peers/reference.py`).  On the comet they agree to 1e-19, also with the solution by
  Kepler's equation, and with heyoka to 2e-15.
- All codes get `v' = f(t, q, v)`, the equations with the multipliers eliminated by SymPy.  The
  codes heyoka and GSL also get the equations *in D*, for (q, w): n - m velocities w with
  `v = B(q) w`, chosen by hand.  With these the motion cannot leave D.  All problems here have such
  a basis, for all q.  dalembert, Exudyn and the schemes of odelab get the constraints.
- heyoka runs with `compact_mode=False`.  SciPy and scikit-sundae call right-hand sides and
  Jacobians compiled by numba.  CVODE uses Adams methods, IDA the form of index 1 (index 2 needs an
  option that scikit-sundae does not have).  GSL is called in C with `-O3 -march=native`.  Exudyn
  uses `TrapezoidalIndex2` and a constraint on the level of velocities, whose functions are called
  in Python.  The schemes of odelab are implemented from their papers and compiled by numba.
- `suzuki4`, `kl6`, `kl8` and `ss10` are compositions of leapfrog, or of midpoint if M depends on q
  or a force on v.  `auto` means controlled steps, `h="auto"`; `keep` is `energy="keep"`.
  `reference` is `method="rk8pd"`.  `taylor` is a `Stepper` that is started again, as heyoka's
  integrator is; `taylor once` is a call of `dal.integrate`.
- The energy is computed in stretches of 20 states; each stretch is a separate call.  Methods that
  only repeat others are omitted there.
- McLachlan and Perlmutter's scheme is `leapfrog` in another form: the errors are the same.  The
  reflecting leapfrog and SPARK 2 have the same errors too.

## Problems

"""


def page(results: dict[str, Any]) -> str:
    machine, found = results["machine"], results["versions"]
    lines = [INTRODUCTION + ", ".join(f"{k} {v}" for k, v in found.items()) + "."]
    lines += [f"{machine['cpu']}, {machine['threads']} threads, {machine['system']}; "
              f"{results['date']}; {results['seconds'] / 60:.0f} minutes.", ""]  # fmt: skip
    for missing in results["missing"].values():
        lines += [f"Skipped: {missing}.", ""]
    lines.append(ADVICE)
    lines += [*summary(results), *state_part(results), *energy_part(results)]
    lines.append(HOW.rstrip("\n"))
    lines.append("")
    refused: dict[str, set[str]] = {}
    for p in results["problems"].values():
        lines.append(f"- **{p['title']}**, {sizes(p)}: {p['text']}.")
        for name, reason in p["refused"].items():
            refused.setdefault(f"{name}: {reason}", set()).add(p["title"])
    lines.append("")
    if refused:
        lines += ["Not applicable:", ""]
        lines += [f"- {what} ({', '.join(sorted(where))})." for what, where in refused.items()]
        lines.append("")
    failures = [
        f"- {name}, {p['title']}, setting {number(point['setting'], 3)}: `{point['failed']}`"
        for p in results["problems"].values() for name, m in p["state"].items()
        for point in m["points"] if "failed" in point
    ]  # fmt: skip
    failures += [
        f"- {name}, {p['title']}, energy: `{m['stopped']}`"
        for p in results["problems"].values() if "energy" in p
        for name, m in p["energy"]["methods"].items()
        if "stopped" in m and "would take" not in m["stopped"]
    ]  # fmt: skip
    if failures:
        lines += ["Runs that failed:", "", *failures, ""]
    lines += ["## Seconds until a model runs", "",
              "From the reduced equations (dalembert: from the Lagrangian) to code that runs.  The"
              " time includes derivatives and compilation, without the caches of dalembert and"
              " heyoka; with their caches both need some hundredths.", ""]  # fmt: skip
    rows = [[f"`{name}`" if name in OURS else name,
             *(number(p["state"][name]["compile"]) if name in p["state"] else "-"
               for p in results["problems"].values())]
            for name in names(results)
            if name not in OURS or name in ("leapfrog", "taylor")]  # fmt: skip
    lines += table(["", *(p["title"] for p in results["problems"].values())], rows)
    if targets := [*bars(results)]:
        lines += ["## Targets", "", *targets]
    return "\n".join(wrapped(lines)).rstrip("\n") + "\n"


def wrapped(lines: list[str]) -> Iterator[str]:
    """Break what is longer than 100 columns, except tables."""
    import textwrap

    for line in "\n".join(lines).split("\n"):
        if line.startswith("|") or len(line) <= 100:
            yield line
        else:
            yield from textwrap.wrap(line, 100, subsequent_indent="  " * line.startswith("- "),
                                     break_long_words=False, break_on_hyphens=False)  # fmt: skip


# ---- pictures --------------------------------------------------------------------------------


class Labels:
    """Names at the ends of curves, where there is room: right, left, above or below an end."""

    def __init__(self, axes: Any) -> None:
        self.axes, self.renderer = axes, axes.figure.canvas.get_renderer()
        self.taken: list[Any] = []
        self.wanted: list[tuple[str, str, list[tuple[float, float]]]] = []

    def add(self, text: str, color: str, points: list[tuple[float, float]]) -> None:
        self.wanted.append((text, color, points))

    def place(self) -> None:
        from matplotlib.patheffects import withStroke
        from matplotlib.transforms import Bbox

        transform, frame = self.axes.transData, self.axes.get_window_extent()
        dots = []
        for _, _, points in self.wanted:
            pixels = [transform.transform(p) for p in points]
            for a, b in zip(pixels, pixels[1:]):
                dots += [a + (b - a) * k / 12 for k in range(12)]
            dots += pixels[-1:]
        around = [(dx, dy) for dy in (0, 9, -9, 18, -18, 27, -27, 36, -36, 48, -48, 62, -62)
                  for dx in (7, -7)]  # fmt: skip
        for text, color, points in self.wanted:
            ends = [points[-1], points[0], points[len(points) // 2]]
            choices = []
            for rank, end in enumerate(ends):
                for distance, (dx, dy) in enumerate(around):
                    label = self.axes.annotate(
                        text, end, (dx, dy), textcoords="offset points", fontsize=9, color=color,
                        ha="left" if dx > 0 else "right", va="center", annotation_clip=False)
                    box = label.get_window_extent(self.renderer).expanded(1.02, 1.05)
                    label.remove()
                    inside = frame.contains(box.x0, box.y0) and frame.contains(box.x1, box.y1)
                    covered = sum(box.contains(x, y) for x, y in dots)
                    overlap = sum(Bbox.intersection(box, other) is not None
                                  for other in self.taken)  # fmt: skip
                    choices.append((1000 * overlap + 1000 * (not inside) + 12 * covered
                                    + 2.5 * distance + 8 * rank, dx, dy, end, box))  # fmt: skip
            _, dx, dy, end, box = min(choices, key=lambda choice: choice[0])
            self.taken.append(box)
            far = abs(dy) > 12
            self.axes.annotate(
                text, end, (dx, dy), textcoords="offset points", fontsize=9, color=color,
                ha="left" if dx > 0 else "right", va="center", zorder=5,
                path_effects=[withStroke(linewidth=2.5, foreground="white")],
                arrowprops={"arrowstyle": "-", "color": color, "lw": 0.5} if far else None)


def figure_of(count: int, label_x: str, label_y: str, title: str) -> Any:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = min(2, count)
    rows = -(-count // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(6.4 * columns, 5.2 * rows),
                                squeeze=False, layout="constrained", facecolor="white")  # fmt: skip
    figure.suptitle(title, fontsize=13)
    for i, ax in enumerate(axes.flat):
        ax.set_visible(i < count)
        ax.set(xscale="log", yscale="log", xlabel=label_x)
        ax.set_ylabel(label_y if i % columns == 0 else "")
        ax.grid(True, which="major", color=LIGHT["rule"], lw=0.6)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, list(axes.flat)[:count]


def draw_curves(ax: Any, curves: dict[str, list[tuple[float, float]]], labels: Labels) -> None:
    for name, points in curves.items():
        color, line, marker = STYLES[name]
        ax.plot(*zip(*points), color=color, ls=line, marker=marker, ms=4.5, lw=1.4,
                mfc="white" if line in ("--", ":") else color, mew=1.0)  # fmt: skip
        labels.add(name, color, points)


def write(results: dict[str, Any], folder: Path) -> None:
    """Write peers.md, peers-state.png and peers-energy.png."""
    (folder / "peers.md").write_text(page(results), encoding="utf-8")
    problems = list(results["problems"].values())
    figure, axes = figure_of(len(problems), "cpu time of the call, ms",
                             "largest error of q and v at t = 100",
                             "The state at t = 100: blue is dalembert; left and low is good")
    todo = []
    for ax, p in zip(axes, problems):
        ax.set_title(f"{p['title']} ({sizes(p)})", fontsize=11)
        curves = {name: [(1e3 * s, max(e, 1e-15)) for s, e in curve(p["state"][name]) if e < 3]
                  for name in STYLES if name in p["state"]}  # fmt: skip
        todo.append((ax, {k: v for k, v in curves.items() if v}))
    save(figure, todo, folder / "peers-state.png", 2.2)
    problems = [p for p in problems if "energy" in p]
    if not problems:
        return
    figure, axes = figure_of(len(problems), "T", "largest error of the energy up to T",
                             "The energy over long times, at about equal cpu time for a unit of "
                             "time: blue is dalembert.\n(slower: ...) is how much more time a "
                             f"method took; those above {SLOWEST:g} are in the tables only")
    todo = []
    for ax, p in zip(axes, problems):
        target = p["energy"]["target"]
        ax.set_title(f"{p['title']}: {1e6 * target:.2g} µs of cpu for t = 1", fontsize=11)
        curves = {}
        for name in STYLES:
            m = p["energy"]["methods"].get(name, {"points": []})
            points = [(x["T"], max(x["error"], 1e-15)) for x in m["points"] if x["error"] < 1e3]
            if points and m["rate"] <= SLOWEST * target:
                curves[name] = points
        todo.append((ax, curves))
        ax.slower = {name: m["rate"] / target for name, m in p["energy"]["methods"].items()
                     if "rate" in m}  # fmt: skip
    save(figure, todo, folder / "peers-energy.png", 12)


def save(figure: Any, todo: list[Any], path: Path, room: float) -> None:
    """Draw the curves, then place their names, which needs the scales."""
    placed = []
    for ax, curves in todo:
        labels = Labels(ax)
        draw_curves(ax, curves, labels)
        slower = getattr(ax, "slower", {})
        labels.wanted = [
            (f"{text} (slower: {slower[text]:.0f}×)" if slower.get(text, 1) > 2 else text,
             color, points) for text, color, points in labels.wanted
        ]  # fmt: skip
        low, high = ax.get_xlim()
        ax.set_xlim(low / 1.3, high * room)
        placed.append(labels)
    figure.canvas.draw()
    for labels in placed:
        labels.place()
    figure.savefig(path, dpi=90, metadata={"Software": None})


if __name__ == "__main__":
    write(json.loads(Path(sys.argv[1]).read_text()), Path(sys.argv[2]))
