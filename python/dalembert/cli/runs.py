"""The commands for single runs: recommend, run, resume, info, export."""

from __future__ import annotations

import argparse
import importlib.util
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .. import systems
from ..core import extras, files, lib, string
from ..core.arguments import suggestion
from ..core.errors import DalembertError
from ..run import Solution, integrate, load, resume
from ..run.events import CONSISTENCY
from ..run.journal import ERRORS, Journal, is_journal
from ..run.scheme import INITIAL
from ..run.storage import SUFFIXES, require_suffix
from ..study.recommendation import recommend
from ..system import System

MODEL = (
    "system: a name listed by `dalembert systems`, or FILE.py:NAME, where NAME is a System or a "
    "function that returns one; the file is executed"
)
CONSISTENT = (
    "initial velocities that violate the constraint: raise an error (check, the default), project "
    "them, or use them unchanged (assume)"
)
KEPT_NODES = "initial data of a scheme with kept nodes"
_OUTPUT = f"write the run to a file with a name that ends in {' or '.join(SUFFIXES)}"


def add(commands: Any, numbers: Any, parameter: Any) -> None:
    """Add the commands to a parser; ``numbers`` and ``parameter`` read arguments."""
    advice = commands.add_parser(
        "recommend", help="find the scheme and the step for an accuracy, by trial runs",
        description="Try schemes on a system.  Print the fastest one for an accuracy, the results "
        "of all trials, and the command that starts the run.",
    )  # fmt: skip
    run = commands.add_parser(
        "run", help="integrate a system once, optionally with a journal that survives a crash",
        description="Integrate a system, and print a summary of the run.",
    )  # fmt: skip
    for command in (advice, run):
        command.add_argument("model", metavar="MODEL", help=MODEL)
        command.add_argument("--q0", type=numbers, metavar="X,Y,...",
                             help="initial positions")
        command.add_argument("--v0", type=numbers, metavar="X,Y,...",
                             help="initial velocities, which satisfy the constraint")
        command.add_argument("--t0", type=float, default=0.0, metavar="T",
                             help="start time (default: 0)")
    advice.add_argument("--t-end", type=float, required=True, metavar="T", help="end time")
    advice.add_argument("--accuracy", type=float, default=1e-6, metavar="E",
                        help="largest admissible error of the state at T, relative to 1 + abs(x) "
                        "(default: 1e-6)")
    run.add_argument("--scheme", metavar="NAME",
                     help="name of a scheme, see `dalembert schemes`, or a number beta "
                     "(default: the cheapest of order 2, leapfrog or midpoint; with --h auto its "
                     "composition kl8)")
    run.add_argument("--h", type=_step, required=True, metavar="H",
                     help="step size: a number, auto (as long as the tolerance allows) or "
                     "reversible")
    run.add_argument("--tolerance", type=float, metavar="E",
                     help="error tolerance of --h auto (default: 1e-9), or of the scheme reference "
                     "(default: 1e-13)")
    run.add_argument("--eps", type=float, metavar="E",
                     help="size of the steps with --h reversible, in units of the time scale of "
                     "the motion (at most 0.2)")
    run.add_argument("--h-max", type=float, metavar="H", help="longest step with --h auto")
    add_end(run, required=True)
    run.add_argument("--stride", type=int, metavar="K", help="store every K-th state (default: 1)")
    run.add_argument("--consistent", choices=list(CONSISTENCY), default="check", help=CONSISTENT)
    run.add_argument("--initial", choices=list(INITIAL), help=KEPT_NODES)
    run.add_argument("--energy", choices=["keep"],
                     help="keep the energy constant to roundoff, which doubles the run time")
    run.add_argument("--no-check-h", dest="check_h", action="store_false", default=None,
                     help="do not estimate whether the step is too large")
    run.add_argument("--journal", type=Path, metavar="FILE",
                     help="write a journal to a new FILE, for `dalembert resume` and "
                     "`dalembert info`")
    goes_on = commands.add_parser(
        "resume", help="resume a run from its journal",
        description="Resume a run from its journal; the result is bitwise identical to an "
        "uninterrupted run.",
    )  # fmt: skip
    _add_file(goes_on)
    add_end(goes_on, required=False)
    for command in (run, goes_on):
        command.add_argument("--journal-errors", choices=list(ERRORS),
                             help="when the journal cannot be written: warn and continue without "
                             "it (default), or stop")
        command.add_argument("--output", type=Path, metavar="FILE", help=_OUTPUT)
    info = commands.add_parser("info", help="show the contents of a journal or a saved run")
    _add_file(info)
    export = commands.add_parser(
        "export", help="write a journal or a saved run to another file format"
    )
    export.add_argument("file", metavar="FILE", type=Path,
                        help="journal or saved run (.npz or .nc)")
    export.add_argument("output", metavar="OUTPUT", type=Path, help=_OUTPUT)
    _add_model(export)
    for command in (advice, run, goes_on, info, export):
        command.add_argument("--parameter", action="append", default=[], type=parameter,
                             metavar="NAME=VALUE",
                             help="set a parameter of the system (repeatable)")
    of: dict[Any, Callable[[argparse.Namespace], int]] = {
        advice: _recommend, run: _run, goes_on: _resume, info: _info, export: _export
    }  # fmt: skip
    for command, function in of.items():
        command.set_defaults(run=function)


def _step(text: str) -> float | str:
    """Return a number, or the word, which `integrate` checks."""
    try:
        return float(text)
    except ValueError:
        return text


def add_end(command: Any, *, required: bool) -> None:
    end = command.add_mutually_exclusive_group(required=required)
    end.add_argument("--t-end", type=float, metavar="T", help="end time")
    end.add_argument("--steps", type=int, metavar="N", help="number of steps")


def _add_model(command: Any) -> None:
    command.add_argument("model", metavar="MODEL", nargs="?",
                         help="FILE.py:NAME of the system, if it is not a built-in one")


def _add_file(command: Any) -> None:
    command.add_argument("file", metavar="FILE", type=Path, help="journal of a run")
    _add_model(command)


def model(text: str, parameters: dict[str, float]) -> System:
    """Return the system of an argument MODEL; raise ValueError if there is none."""
    path, colon, name = text.rpartition(":")
    if text.endswith(".py"):
        raise ValueError(f"{text}: expected {text}:NAME with the name of a System in this file")
    if not colon or not path.endswith(".py"):
        return systems.get(text, **parameters)
    spec = importlib.util.spec_from_file_location(Path(path).stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    if not hasattr(module, name):
        there = [each for each in vars(module) if not each.startswith("_")]
        raise ValueError(f"{path} has no {name!r}; {suggestion(name, there)}".rstrip("; "))
    found = getattr(module, name)
    if callable(found) and not isinstance(found, System):
        found = found()
    if not isinstance(found, System):
        raise ValueError(f"{text}: expected a dalembert.System, or a function that returns one")
    return found.with_parameters(**parameters) if parameters else found


def parameters(given: argparse.Namespace) -> dict[str, float]:
    """Return the values of ``--parameter``; raise ValueError if one occurs twice."""
    found = dict(given.parameter)
    for name in found:
        if sum(name == other for other, _ in given.parameter) > 1:
            raise ValueError(f"--parameter {name} is given more than once: expected once")
    return found


def _system(given: argparse.Namespace) -> System | None:
    values = parameters(given)
    if given.model is None and values:
        raise ValueError(
            "--parameter without MODEL: FILE already has the parameters of a built-in system"
        )
    return None if given.model is None else model(given.model, values)


def progress() -> bool:
    return sys.stderr.isatty() and extras.is_there("tqdm")


def _finish(given: argparse.Namespace, make: Callable[[], Solution], journal: Path | None) -> int:
    """Execute a run, print and write it; print how to resume it after an interruption."""
    if given.output is not None:
        require_suffix(given.output)
        files.require_writable(given.output)
    try:
        run = make()
    except (DalembertError, KeyboardInterrupt) as error:
        if journal is not None and journal.exists():
            words = ["dalembert", "resume", str(journal)]
            if ".py:" in str(given.model):
                words.append(given.model)
                words += [f"--parameter={name}={value!r}" for name, value in given.parameter]
            print(f"{journal} has the run so far; to resume: {shlex.join(words)}", file=sys.stderr)
        if (partial := getattr(error, "partial", None)) is not None and given.output is not None:
            partial.save(given.output)
        raise
    print(run)
    if given.output is not None:
        run.save(given.output)
    elif journal is None:
        print("not saved: add --output FILE.nc", file=sys.stderr)
    return 0


def _recommend(given: argparse.Namespace) -> int:
    system = model(given.model, parameters(given))
    found = recommend(
        system, given.q0, given.v0, t_end=given.t_end, accuracy=given.accuracy, t0=given.t0
    )
    state = {"q0": given.q0, "v0": given.v0}
    words = [f"--{name}={','.join(map(repr, x))}" for name, x in state.items() if x is not None]
    words += [f"--parameter={name}={value!r}" for name, value in given.parameter]
    words += [f"--{name.replace('_', '-')}={x}" for name, x in found.arguments.items()]
    print(f"{found}\n{shlex.join(['dalembert', 'run', given.model, *words])}")
    return 0


def _run(given: argparse.Namespace) -> int:
    system = model(given.model, parameters(given))
    return _finish(given, lambda: integrate(
        system, given.scheme, given.q0, given.v0, h=given.h, t_end=given.t_end,
        steps=given.steps, t0=given.t0, stride=given.stride, tolerance=given.tolerance,
        h_max=given.h_max, eps=given.eps,
        consistent=given.consistent, initial=given.initial,
        energy=given.energy, check_h=given.check_h,
        journal=given.journal, journal_errors=given.journal_errors, progress=progress(),
    ), given.journal)  # fmt: skip


def _resume(given: argparse.Namespace) -> int:
    system = _system(given)
    goes_on = given.t_end is not None or given.steps is not None
    is_complete = not goes_on and _is_complete(given.file)
    status = _finish(given, lambda: resume(
        given.file, system, t_end=given.t_end, steps=given.steps,
        journal_errors=given.journal_errors, progress=progress(),
    ), given.file)  # fmt: skip
    if is_complete:
        print("the run was already complete; nothing was computed", file=sys.stderr)
    return status


def _is_complete(path: Path) -> bool:
    journal = Journal.open(path)
    steps, info = journal.steps(), journal.info
    at_end = info.records > 0 and float(journal.records()[-1]["t"]) == steps.t_end
    journal.close()
    return at_end if steps.varies else int(info.done) == steps.count


def _info(given: argparse.Namespace) -> int:
    if not is_journal(given.file):
        print(load(given.file, _system(given)))
        return 0
    journal = Journal.open(given.file)
    info, about = journal.info, journal.about["system"]
    values = ", ".join(f"{name} = {x:g}" for name, x in about["parameters"].items())
    origin = "built-in" if about["of_library"] else "user-defined"
    digest = bytes(info.fingerprint[0:8]).hex()
    many = f"a state stored every {info.stride} steps"
    stored = "every state stored" if info.stride == 1 else many
    steps, hold = journal.steps(), journal.about["hold"]
    held = f"a time of {hold:g}" if steps.varies else f"{hold} steps"
    inputs = f"{info.inputs}, held for {held}" if info.inputs else "none"
    done = f"{info.done} of {info.steps} steps, t = {info.t0 + info.done * info.h:g}"
    if steps.varies:
        done = f"{info.done} steps; the run ends at t = {steps.t_end:g}"
    lines = {
        "system": f"{about['name']}({', '.join(about['coordinates'])}), {origin}, {digest}",
        "parameters": values or "none",
        "scheme": f"{string(info.scheme)}, {steps.how}, {stored}",
        "events": f"{info.events or 'none'}",
        "inputs": inputs,
        "last snapshot": done,
        "journal": f"{info.records} records of {info.size} bytes",
        "written by": string(info.writer) + ", which is still writing" * bool(info.is_written),
    }
    if info.records:
        last = journal.records()[-1]
        kinds = {lib.DAL_RECORD_ROW: "row", lib.DAL_RECORD_TIME: "time"}
        what = kinds.get(int(last["kind"]), "event")
        lines["last record"] = f"{what} {last['number']}, t = {last['t']:g}, x = {last['x']}"
    for name, text in lines.items():
        print(f"{name:13}  {text}")
    journal.close()
    return 0


def _export(given: argparse.Namespace) -> int:
    run = load(given.file, _system(given))
    run.save(given.output)
    print(run)
    print(f"written: {given.output}")
    return 0
