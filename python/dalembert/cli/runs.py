"""The commands for single runs: recommend, run, resume, info, export."""

from __future__ import annotations

import argparse
import importlib.util
import re
import shlex
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from .. import systems
from ..core import extras, files, lib, string
from ..core.arguments import suggestion
from ..core.errors import DalembertError
from ..core.records import MISSING, options_of
from ..run import Solution, integrate, load, resume
from ..run.journal import Journal, is_journal
from ..run.options import IntegrateOptions, ResumeOptions
from ..run.storage import SUFFIXES, require_suffix
from ..study.recommendation import recommend
from ..system import System

MODEL = (
    "system: a name listed by `dalembert systems`, or FILE.py:NAME, where NAME is a System or a "
    "function that returns one; the file is executed"
)
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
    add_options(advice, IntegrateOptions, numbers, names=("q0", "v0", "t0"))
    advice.add_argument("--t-end", type=float, required=True, metavar="T", help="end time")
    advice.add_argument("--accuracy", type=float, default=1e-6, metavar="E",
                        help="largest admissible error of the state at T, relative to 1 + abs(x) "
                        "(default: 1e-6)")
    add_options(run, IntegrateOptions, numbers)
    goes_on = commands.add_parser(
        "resume", help="resume a run from its journal",
        description="Resume a run from its journal; the result is bitwise identical to an "
        "uninterrupted run.",
    )  # fmt: skip
    _add_file(goes_on)
    add_options(goes_on, ResumeOptions, numbers)
    for command in (run, goes_on):
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


def add_options(command: Any, record: Any, numbers: Any, names: Iterable[str] = ()) -> None:
    """Add the options of a record that a command line can have, or those of these names."""
    listed, texts = options_of(record), [""]
    end = command if names else command.add_mutually_exclusive_group(required="h" in listed)
    for one in reversed(listed.values()):  # without a text, that of the option after it
        texts.append(one.help or texts[-1])
    for name, one in listed.items():
        text = in_words(texts.pop(), listed).replace("%", "%%")
        if one.parse is None or (names and name not in names):
            continue
        how: dict[str, Any] = {"help": text, "default": one.default}
        if one.parse is bool:
            on_off = argparse.BooleanOptionalAction
            how["action"] = on_off if one.default is None else "store_true"
        elif one.choices:
            how["choices"] = list(one.choices)
        else:
            how |= {"type": numbers if one.parse is list else one.parse, "metavar": one.metavar}
        if one.default is MISSING:
            how |= {"default": None, "required": True}
        place = end if name in ("t_end", "steps") else command
        place.add_argument(_typed(name), **how)


def _typed(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def options(given: argparse.Namespace, record: Any) -> dict[str, Any]:
    """Return the values for the options of a record."""
    there = vars(given)
    return {name: there[name] for name in options_of(record) if name in there}


# Advice of the package that has another form on the command line.
_AS_TYPED = {
    r"\bconsistent='(\w+)'": r"--consistent \1",
    r", or compute it with system\.project\(q0, v0\)": "",
    r"\bcheck_h=False\b": "--no-check-h",
}


def as_typed(text: str, names: Iterable[str]) -> str:
    """Return a message of the package with arguments of Python as options of the command."""
    for python, typed in _AS_TYPED.items():
        text = re.sub(python, typed, text)
    for name in names:
        here, typed = rf"(?<![\w.'-]){name}", _typed(name)
        if name in ("command", "run", "system", "model", "file", "output"):
            continue
        text = re.sub(rf"{here} = '?([^\s',;:)]+)'?", rf"{typed} \1", text)
        # Names that are English words are names of options only at the beginning.
        is_name = "_" in name or name[-1] == "0" or name == "stride"
        text = re.sub(rf"{here}\b" if is_name else rf"^{name}(?=:| is )", typed, text)
    return text


def in_words(text: str, names: Iterable[str]) -> str:
    """Return the text of an option of the package, as the help of one of the command."""
    words = re.split("``(.*?)``", " ".join(text.split()))
    for k, word in enumerate(words):
        if k % 2 and (word in names or re.fullmatch(r'\w+="\w+"', word)):
            words[k] = " ".join(_typed(word).replace('"', "").split("="))
        elif k % 2 == 0:
            for name in (name for name in names if "_" in name):
                word = re.sub(rf"\b{name}\b", _typed(name), word)
            words[k] = word.replace("`", "")
    return "".join(words)


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
        system, **options(given, IntegrateOptions), progress=progress()
    ), given.journal)  # fmt: skip


def _resume(given: argparse.Namespace) -> int:
    system = _system(given)
    goes_on = given.t_end is not None or given.steps is not None
    is_complete = not goes_on and _is_complete(given.file)
    status = _finish(given, lambda: resume(
        given.file, system, **options(given, ResumeOptions), progress=progress()
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
