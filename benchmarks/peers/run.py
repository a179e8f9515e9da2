"""dalembert and its peers on the same problems: cpu time against error, energy over long times.

Usage: ``python run.py [--quick | --long] [--problem NAME]... [--merge] [--out FOLDER]``

Writes peers.json, peers.md, peers-state.png and peers-energy.png into FOLDER, by default docs/ of
this checkout, and, with --quick, nowhere: then the table is printed only.  With --merge problems
that are not named stay as they are in the peers.json of FOLDER.  A default run takes half an
hour, --quick a few minutes, --long, which goes to T = 1e7 and gives slow methods more time, some
hours.

Times are those of the process during the call that a user makes, medians over rounds in each of
which every method runs once with each of its settings, in another order.  What is done before, such
as compiling, is reported apart.  Peers that are not installed are skipped by name.
"""

from __future__ import annotations

import os

# One thread: process time counts all of them.
for _name in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_name}_NUM_THREADS", "1")

import argparse  # noqa: E402
import dataclasses  # noqa: E402
import gc  # noqa: E402
import importlib  # noqa: E402
import json  # noqa: E402
import platform  # noqa: E402
import random  # noqa: E402
import statistics  # noqa: E402
import tempfile  # noqa: E402
import time  # noqa: E402
from collections.abc import Iterable  # noqa: E402
from dataclasses import dataclass  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402
import sympy as sp  # noqa: E402
from common import GRID, T_STATE, Method, Missing, Refused, versions  # noqa: E402
from problems import PROBLEMS, Problem  # noqa: E402

HERE = Path(__file__).resolve().parent
PEERS = ("dalembert", "heyoka", "gsl", "scipy", "sundials", "exudyn", "odelab")
PACKAGES = ("dalembert", "heyoka", "scipy", "scikit-sundae", "exudyn", "numba", "numpy", "sympy")
CALL = 20  # of these samples come from one call
WARM = 0.02  # calls that take less are made once more before, so that caches are warm
BARE = 25  # rounds of the integrators alone
SAMPLES = 200  # of the energy, from each power of ten to the next
WORK = 1000.0  # T of the runs that say what an error of the energy costs


@dataclass(frozen=True)
class Effort:
    """How much is done."""

    rounds: int
    seconds: float  # of all rounds of one point; there are at least two rounds
    horizon: float  # the longest T of the energy
    cap: float  # seconds of a run from one power of ten to the next
    cap_slow: float  # the same, for methods that take more time than is asked for
    most: float  # seconds of a point, after which no finer setting of the method is tried
    trial: float = 1000.0  # T of the runs that say how fast a method is
    only: int | None = None  # settings of a method: so many, without the finest


EFFORTS = {
    "default": Effort(5, 1.5, 1e6, 15.0, 1.5, 1.0),
    "quick": Effort(2, 0.1, 1e4, 0.2, 0.2, 0.5, 100.0, 3),
    "long": Effort(7, 4.0, 1e7, 200.0, 20.0, 20.0),
}


def attempt(method: Method, setting: float, state: np.ndarray, times: np.ndarray,
            ) -> tuple[float, np.ndarray | str]:  # fmt: skip
    """Return the seconds of a call, and its states or why there are none."""
    start = time.process_time()
    try:
        with np.errstate(all="ignore"):
            states: np.ndarray | str = method.solve(setting, state, times)
    except Exception as error:  # noqa: BLE001 - whatever a peer raises is its result
        states = f"{type(error).__name__}: {error}".split("\n")[0][:200]
    seconds = time.process_time() - start
    if not isinstance(states, str) and not np.all(np.abs(states) < 1e8):
        states = "it diverges"
    return seconds, states


def chosen(settings: tuple[float, ...] | Any, only: int | None) -> list[float]:
    if only is None or len(settings) <= only:
        return list(settings)
    last = 2 * (len(settings) - 1) / 3
    return [settings[round(i * last / (only - 1))] for i in range(only)]


# ---- the state at t = 100 --------------------------------------------------------------------


def state_errors(problem: Problem, methods: list[Method], effort: Effort) -> dict[str, Any]:
    """Time every method with each setting, and compare the state at T_STATE with the reference."""
    digits = json.loads((HERE / "references.json").read_text())[problem.name]
    reference = np.array([float(x) for x in digits])
    residual = sp.lambdify([[*problem.q, *problem.v]], list(problem.constraints))
    start, times = np.array(problem.start), np.array([0.0, T_STATE])
    points: dict[tuple[int, float], dict[str, Any]] = {}
    seconds: dict[tuple[int, float], list[float]] = {}
    for i, method in enumerate(methods):
        for setting in chosen(method.settings, effort.only):
            took, states = attempt(method, setting, start, times)
            point = points[i, setting] = {"setting": setting}
            if isinstance(states, str):
                point["failed"] = states
                continue
            point["error"] = float(np.max(np.abs(states[-1] - reference)))
            point["residual"] = float(np.max(np.abs(residual(states[-1]))))
            seconds[i, setting], point["first"] = [], took
            point["rounds"] = int(np.clip(effort.seconds / max(took, 1e-9), 2, effort.rounds))
            # The first call of a method may do what no other does
            if took > effort.most and attempt(method, setting, start, times)[0] > effort.most:
                break
    for round_ in range(effort.rounds):
        gc.collect()
        order = [key for key in seconds if points[key]["rounds"] > round_]
        random.Random(round_).shuffle(order)
        for i, setting in order:
            if points[i, setting]["first"] < WARM:
                attempt(methods[i], setting, start, times)
            seconds[i, setting].append(attempt(methods[i], setting, start, times)[0])
    for key, all_seconds in seconds.items():
        points[key]["median"] = statistics.median(all_seconds)
        points[key]["minimum"] = min(all_seconds)
    for key, least in bare_seconds(methods, seconds, start, times).items():
        points[key]["bare"] = least
    return {
        method.name: {
            "kind": method.kind, "order": method.order, "compile": method.compile_seconds,
            "points": [point for (j, _), point in points.items() if j == i],
        }
        for i, method in enumerate(methods)
    }  # fmt: skip


def bare_seconds(methods: list[Method], keys: Iterable[tuple[int, float]], start: np.ndarray,
                 times: np.ndarray) -> dict[tuple[int, float], float]:  # fmt: skip
    """Return the least seconds of the integrators alone, without the call around them."""
    found: dict[tuple[int, float], float] = {}
    mine = [key for key in keys if methods[key[0]].bare is not None]
    for _ in range(BARE):
        for i, setting in mine:
            methods[i].bare.clear()
            attempt(methods[i], setting, start, times)
            found[i, setting] = min([found.get((i, setting), np.inf), *methods[i].bare])
    return found


# ---- the energy up to t = 1e7 ----------------------------------------------------------------


def rate(method: Method, setting: float, problem: Problem, until: float) -> float:
    """Seconds for a unit of time, of a run that is long enough."""
    times = np.array([0.0, until])
    found = [attempt(method, setting, np.array(problem.start), times) for _ in range(2)]
    if any(isinstance(states, str) for _, states in found):
        return float("inf")
    return min(seconds for seconds, _ in found) / until


def setting_for(method: Method, target: float, problem: Problem, state: dict[str, Any],
                trial: float) -> tuple[float, float]:  # fmt: skip
    """Return the most accurate setting that is about as fast as the target, and how fast it is."""
    known = {p["setting"]: p["median"] / T_STATE
             for p in state["points"] if "median" in p}  # fmt: skip
    if not known:
        raise RuntimeError("it fails at t = 100 with all settings")
    coarse = min(known) if method.kind == "steps" else max(known)
    if known[coarse] > 20 * target:
        setting = method.usual or coarse
        return setting, known.get(setting) or rate(method, setting, problem, T_STATE)
    if method.kind == "steps":
        setting = sorted(known)[len(known) // 2]
        for _ in range(3):
            found = rate(method, setting, problem, trial)
            if np.isfinite(found):
                wanted = max(coarse, round(setting * target / found / 20) * 20)
                if abs(wanted / setting - 1) < 0.05:
                    return setting, found
                setting = wanted
        return setting, rate(method, setting, problem, trial)
    fine = {s: rate(method, s, problem, trial) for s in sorted(known)}
    affordable = [s for s, found in fine.items() if found <= 1.1 * target]
    setting = affordable[0] if affordable else method.usual or coarse
    return setting, fine.get(setting) or rate(method, setting, problem, trial)


def decade(method: Method, setting: float, y: np.ndarray, t: float, T: float, limit: float,
           ) -> tuple[float, np.ndarray | str]:  # fmt: skip
    """Go from t to T in some calls, and give up when they take too long."""
    times = t + (T - t) / SAMPLES * np.arange(SAMPLES + 1)
    assert abs((times[1] - t) / GRID - round((times[1] - t) / GRID)) < 1e-9
    total, found = 0.0, []
    for i in range(0, SAMPLES, CALL):
        seconds, states = attempt(method, setting, y, times[i : i + CALL + 1])
        total += seconds
        if isinstance(states, str):
            return total, states
        if total > limit:
            return total, "it becomes slower and slower"
        found.append(states)
        y = states[-1].copy()
    return total, np.vstack(found)


def energy_errors(problem: Problem, methods: list[Method], state: dict[str, Any],
                  effort: Effort) -> dict[str, Any]:  # fmt: skip
    """Follow the energy of the methods, which all get about the same cpu time."""
    energy = sp.lambdify([[*problem.q, *problem.v]], problem.equations.energy)
    residual = sp.lambdify([[*problem.q, *problem.v]], list(problem.constraints))
    start = np.array(problem.start)
    by_name = {method.name: method for method in methods if method.long}
    pacemaker = by_name.get("heyoka") or by_name["reference"]
    pace = pacemaker.settings[-1] if pacemaker.name == "heyoka" else 1e-9
    target = rate(pacemaker, pace, problem, effort.trial)
    # Longer ones show nothing new of what drifts, or passes close to something
    horizon = effort.horizon if problem.reversible and problem.pace == 1 else effort.horizon / 10
    found: dict[str, Any] = {}
    for name, method in by_name.items():
        try:
            setting, speed = setting_for(method, target, problem, state[name],
                                         effort.trial)  # fmt: skip
        except RuntimeError as error:
            found[name] = {"stopped": str(error), "points": []}
            continue
        entry = found[name] = {"setting": setting, "points": []}
        if not np.isfinite(speed):
            entry["stopped"] = "it fails before T = 1e3"
            continue
        entry["rate"] = speed
        cap = effort.cap if speed < 3 * target else effort.cap_slow
        y, t, total, worst, off, T = start, 0.0, 0.0, 0.0, 0.0, 1e3
        while T <= horizon:
            if speed * (T - t) > cap:
                entry["stopped"] = f"t = {T:.0e} would take {speed * T:.0f} s"
                break
            seconds, states = decade(method, setting, y, t, T, 3 * cap)
            if isinstance(states, str):
                entry["stopped"] = f"before t = {T:.0e}: {states}"
                break
            total += seconds
            worst = max(worst, float(np.max(np.abs(energy(states.T) - energy(start)))))
            off = max(off, float(np.max(np.abs(np.vstack(
                [np.broadcast_to(x, len(states)) for x in residual(states.T)])))))  # fmt: skip
            entry["points"].append({"T": T, "seconds": total, "error": worst, "residual": off})
            y, t, T = states[-1].copy(), T, 10 * T
    return {"target": target, "pacemaker": f"{pacemaker.name}, tolerance {pace:g}",
            "methods": found}  # fmt: skip


def energy_work(problem: Problem, methods: list[Method], state: dict[str, Any],
                effort: Effort) -> dict[str, Any]:  # fmt: skip
    """Measure what an error of the energy up to WORK costs, where it drifts for all methods."""
    energy = sp.lambdify([[*problem.q, *problem.v]], problem.equations.energy)
    start = np.array(problem.start)
    times = np.arange(0.0, WORK + GRID / 2, GRID)
    found: dict[str, Any] = {}
    for method in methods:
        points = found[method.name] = []
        for point in state[method.name]["points"]:
            if point.get("median", np.inf) * WORK / T_STATE > effort.cap_slow / 10:
                continue
            runs = [attempt(method, point["setting"], start, times) for _ in range(3)]
            states = runs[0][1]
            if not isinstance(states, str):
                error = float(np.max(np.abs(energy(states.T) - energy(start))))
                points.append({"setting": point["setting"], "error": error,
                               "median": statistics.median(run[0] for run in runs)})  # fmt: skip
    return {name: {"points": points} for name, points in found.items() if points}


# ---- all of it -------------------------------------------------------------------------------


def machine() -> dict[str, Any]:
    cpu = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next(x.split(":")[1].strip() for x in lines if x.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {"cpu": cpu, "threads": os.cpu_count(), "system": platform.system()}


def rounded(value: Any) -> Any:
    """Four digits are enough for a file that people read."""
    if isinstance(value, dict):
        return {key: rounded(x) for key, x in value.items()}
    if isinstance(value, list):
        return [rounded(x) for x in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def study(names: list[str], effort: Effort, say: Any = print) -> dict[str, Any]:
    begun = time.time()
    results: dict[str, Any] = {
        "date": time.strftime("%Y-%m-%d"), "machine": machine(), "versions": versions(*PACKAGES),
        "t_state": T_STATE, "missing": {}, "problems": {},
    }  # fmt: skip
    for name in names:
        problem = PROBLEMS[name]()
        methods: list[Method] = []
        refused = {}
        for peer in PEERS:
            if peer in results["missing"]:
                continue
            try:
                for offer in importlib.import_module(f"peer_{peer}").methods(problem):
                    if isinstance(offer, Refused):
                        refused[offer.name] = offer.reason
                    else:
                        if offer.kind == "steps":
                            finer = [problem.pace * x for x in offer.settings]
                            offer = dataclasses.replace(offer, settings=finer)
                        methods.append(offer)
            except Missing as missing:
                if peer == "dalembert":
                    raise SystemExit(f"{missing}; of a build: PYTHONPATH=BUILD/python") from None
                results["missing"][peer] = str(missing)
                say(f"skipped: {missing}")
        state = state_errors(problem, methods, effort)
        found = results["problems"][name] = {
            "title": problem.title, "text": problem.text, "n": len(problem.q),
            "m": len(problem.constraints), "reversible": problem.reversible, "refused": refused,
            "state": state,
        }  # fmt: skip
        if problem.conserves:
            found["energy"] = energy_errors(problem, methods, state, effort)
        if problem.conserves and not problem.reversible:
            found["work"] = energy_work(problem, methods, state, effort)
        say(f"{name}: {len(methods)} methods, {time.time() - begun:.0f} s", flush=True)
    results["seconds"] = time.time() - begun
    return rounded(results)


def merged(old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """Put the problems of a new run in the place of those of an old one."""
    both = old["problems"] | new["problems"]
    return new | {
        "problems": {name: both[name] for name in PROBLEMS if name in both},
        "seconds": old["seconds"] + new["seconds"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    pace = parser.add_mutually_exclusive_group()
    for name in ("quick", "long"):
        pace.add_argument(f"--{name}", dest="effort", action="store_const", const=name)
    parser.add_argument("--problem", action="append", choices=list(PROBLEMS))
    parser.add_argument("--merge", action="store_true")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    effort = EFFORTS[arguments.effort or "default"]
    out = arguments.out
    if out is None and arguments.effort != "quick":
        out = HERE.parents[1] / "docs"
    if arguments.merge and (out is None or not (out / "peers.json").is_file()):
        parser.error("--merge: expected a folder with the peers.json of a run before")
    with tempfile.TemporaryDirectory() as cache:
        os.environ["DALEMBERT_CACHE"] = cache  # an empty one: what compiling takes is reported
        results = study(arguments.problem or list(PROBLEMS), effort)
    if arguments.merge:
        results = merged(json.loads((out / "peers.json").read_text()), results)

    import draw

    if out is None:
        print(draw.page(results))
    else:
        out.mkdir(parents=True, exist_ok=True)
        (out / "peers.json").write_text(json.dumps(results, indent=1) + "\n")
        draw.write(results, out)


if __name__ == "__main__":
    main()
