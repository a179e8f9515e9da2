"""The command ``dalembert``: runs, studies and pages of systems, lists, and the cache.

Exit status: 0 if no verdict fails, 1 if one does or a computation fails.  It is 2 for a usage error
or an output that cannot be written.  It is 130 after Ctrl-C, and 141 if the reader of the output
has ended.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from .. import compiler, core, systems
from ..core import extras, files
from ..core.arguments import suggestion
from ..run.options import IntegrateOptions
from ..run.scheme import INITIAL
from ..run.scheme import schemes as named_schemes
from ..show import pages, report, table, web
from ..study.refinement import MOST_STEPS, studies
from ..systems import catalogue
from . import ensembles, runs

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments without the name of the program.  Default: those of the process.

    Returns
    -------
    int
        The exit status, see the module.

    Examples
    --------
    >>> from dalembert.cli import main
    >>> main(["--version"])  # doctest: +ELLIPSIS
    dalembert ...
    0
    """
    parser = _parser()
    for name in ("stdout", "stderr"):  # None where the caller has closed it
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115  (until the process ends)
    try:
        given = parser.parse_args(arguments)
    except SystemExit as stop:
        return int(stop.code or 0)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = lambda text, *where: _say(given, f"warning: {text}")
            status = int(given.run(given))
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # What is left in the buffer would raise again when the interpreter ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except (ValueError, ImportError) as error:
        _say(given, error)
        return 2
    except OSError as error:
        _say(given, _in_words(error))
        return 1
    except (core.DalembertError, NotImplementedError, MemoryError) as error:
        _say(given, error)
        return 1
    except KeyboardInterrupt:
        return 130


def _in_words(error: OSError) -> str:
    """Return the name of the file and the error, without its number."""
    return f"{error.filename}: {error.strerror}" if error.filename else str(error)


def _say(given: argparse.Namespace, what: Any) -> None:
    print(f"dalembert {given.command}: {runs.as_typed(str(what), vars(given))}", file=sys.stderr)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, with the name of a similar option."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if args is None or self._subparsers is not None:  # before the name of the command
            return super().parse_known_args(args, namespace)
        words: list[str] = []
        for word in args:
            name = word.partition("=")[0]
            if re.match(r"-[\d.]", word) and words and re.fullmatch("--[^=]+", words[-1]):
                words[-1] += f"={word}"  # --q0 -1,0: a value that begins with a minus sign
                continue
            known = self._option_string_actions
            if name.startswith("--") and not any(each.startswith(name) for each in known):
                similar = "did you mean '--h'? " if name == "--dt" else suggestion(name, known)
                self.error(f"unknown option {name}; {similar}".rstrip("; "))
            words.append(word)
        return super().parse_known_args(words, namespace)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}\nsee `{self.prog} --help`\n")

    def _get_value(self, action: argparse.Action, text: str) -> Any:
        try:
            return super()._get_value(action, text)  # type: ignore[misc]
        except argparse.ArgumentError:
            if action.type not in (float, int):
                raise
            expected = "a number" if action.type is float else "a whole number"
            raise argparse.ArgumentError(action, f"{text!r}; expected {expected}") from None

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(
                action,
                f"there is no {value!r}; {suggestion(value, action.choices)}choose one of: "
                f"{', '.join(action.choices)}",
            )


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="dalembert",
        description="Simulate mechanical systems with velocity constraints, and measure the order "
        "of each scheme.",
    )
    parser.add_argument("--version", action="version", version=f"dalembert {core.version()}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    study = commands.add_parser(
        "study",
        help="measure the order of schemes on a system, and give a verdict",
        description="Refine the step size of each scheme on a system, print the verdict and the "
        "measured orders, and write a report.  The exit status is 1 if a scheme does not reach "
        "its promised order or does not keep its constraint.",
    )
    _add_study_options(study)
    for module in (runs, ensembles):
        module.add(
            commands, _read("numbers separated by commas", _list_of(float)),
            _read("NAME=NUMBER", _parameter),
        )  # fmt: skip
    book = commands.add_parser(
        "catalogue",
        help="write a page for each system, with its formulas and a run, and an index",
        description="Write DIR/index.html and a page DIR/NAME.html for each system.  A page has "
        "the formulas, parameters, initial data, a picture of a run, the invariants and their "
        "drift, and the source in the literature.  It also has the exact solution or a reference "
        "to 30 digits, and the Python and C code of the system.  The pages need no network and no "
        "script.  Existing files of these names are replaced.  A system in SymPy is compiled the "
        "first time, which takes some seconds.",
    )
    book.add_argument(
        "folder", metavar="DIR", nargs="?", type=Path, default=Path("catalogue"),
        help="folder of the pages, created if necessary (default: catalogue)",
    )  # fmt: skip
    book.add_argument(
        "--system", action="append", metavar="MODEL",
        help=f"{runs.MODEL} (repeatable; default: all)",
    )  # fmt: skip
    listed = commands.add_parser("systems", help="list the built-in systems")
    schemes = commands.add_parser("schemes", help="list the named schemes")
    cache = commands.add_parser(
        "cache", help="show or empty the cache of compiled models",
        description="Show the folder of the compiled models, their number and their size.",
    )  # fmt: skip
    cache.add_argument("--clear", action="store_true", help="remove all compiled models")
    for command, function in (
        (study, _study), (book, _catalogue), (listed, _systems), (schemes, _schemes),
        (cache, _cache),
    ):  # fmt: skip
        command.set_defaults(run=function)
    return parser


def _add_study_options(study: argparse.ArgumentParser) -> None:
    numbers = _read("numbers separated by commas", _list_of(float))
    counts = _read("whole numbers separated by commas", _list_of(int))
    add, written = study.add_argument, study.add_mutually_exclusive_group()
    add("system", metavar="MODEL", help=runs.MODEL)
    add("--scheme", action="append", metavar="NAME",
        help="name of a scheme, see `dalembert schemes`, or a number beta (repeatable; default: "
        "all)")
    add("--parameter", action="append", default=[], type=_read("NAME=NUMBER", _parameter),
        metavar="NAME=VALUE", help="set a parameter of the system (repeatable)")
    runs.add_options(study, IntegrateOptions, numbers, names=("q0", "v0"))
    add("--t-end", type=float, metavar="T",
        help="end time of the runs (default: 1, or later if errors would be below roundoff)")
    add("--steps", type=counts, metavar="N,N,...",
        help="numbers of steps up to T, one for each run (default: chosen by the order of the "
        "scheme)")
    add("--max-steps", type=_read("a whole number", _count), default=MOST_STEPS, metavar="N",
        help="largest total number of steps; a study that needs more is refused (default: 1e9)")
    add("--initial", choices=list(INITIAL),
        help="initial data of schemes with kept nodes (default: D_eps)")
    written.add_argument("--output", type=Path, metavar="FILE",
                         help="file of the report (default: report.html)")
    written.add_argument("--no-report", action="store_true", help="write no report")
    add("--tables", action="store_true", help="print the table of each scheme as well")
    add("--json", nargs="?", const="-", metavar="FILE",
        help="write the numbers as JSON to FILE, or to standard output; in the latter case the "
        "tables go to standard error")  # fmt: skip


def _read(expected: str, read: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return the type of an argument; its message has the expected form."""

    def convert(text: str) -> Any:
        try:
            return read(text)
        except (ValueError, OverflowError):
            raise argparse.ArgumentTypeError(f"{text!r}; expected {expected}") from None

    return convert


def _list_of(kind: type) -> Callable[[str], list[Any]]:
    return lambda text: [kind(word) for word in text.split(",")]


def _study(given: argparse.Namespace) -> int:
    system = runs.model(given.system, runs.parameters(given))
    output = _output(given)
    if sys.stderr.isatty() and (missing := [x for x in ("rich", "tqdm") if not extras.is_there(x)]):
        _say(given, f"for colours and a progress bar: pip install {' '.join(missing)}")
    interrupt = None
    try:
        found = studies(
            system, given.scheme, given.q0, given.v0, t_end=given.t_end, steps=given.steps,
            initial=given.initial, max_steps=given.max_steps,
            progress=sys.stderr.isatty() and extras.is_there("tqdm"),
        )  # fmt: skip
    except KeyboardInterrupt as stop:
        interrupt, found = stop, getattr(stop, "partial", ())
        if not found:
            raise
    lines = table.studies_lines if given.tables else table.overview_lines
    table.show(partial(lines, found), sys.stderr if given.json == "-" else sys.stdout)
    if interrupt:
        wanted = given.scheme or [scheme for scheme in named_schemes() if scheme.order > 0]
        _say(given, f"interrupted: {len(found)} of {len(wanted)} schemes were studied")
    if given.json:
        text = json.dumps(found.to_dict(), indent=2, allow_nan=False) + "\n"
        if given.json == "-":
            sys.stdout.write(text)
        else:
            files.write(given.json, text)
    if output is not None:
        print(f"writing {output} ...", file=sys.stderr)
        report.write(found, output)
    if interrupt:
        raise interrupt
    return 1 if found.holds is False else 0


def _output(given: argparse.Namespace) -> Path | None:
    """Return the path of the report, if any; raise ValueError if a file cannot be written."""
    output = None if given.no_report else given.output or Path("report.html")
    if output is not None:
        try:
            web.require()
        except ImportError as error:
            if given.output:
                raise
            _say(given, f"no report: {error}")
            output = None
    for path in (output, None if given.json in (None, "-") else given.json):
        if path is not None:
            _require(files.require_writable, path)
    if output is not None and given.json and Path(given.json).resolve() == output.resolve():
        raise ValueError(f"{output}: both --output and --json name it; expected different files")
    return output


def _require(check: Callable[[Path], None], path: str | Path) -> None:
    """Check the output path before any work; a problem there is a usage error."""
    try:
        check(Path(path))
    except OSError as error:
        raise ValueError(_in_words(error)) from error


def _catalogue(given: argparse.Namespace) -> int:
    names = given.system or pages.available()
    chosen = [runs.model(name, {}) if ".py" in name else name for name in names]
    _require(files.require_folder, given.folder)

    def show(done: int, total: int) -> None:
        if done < total:
            print(f"page {done + 1} of {total}: {names[done]}", file=sys.stderr)

    index, *_ = pages.write(given.folder, chosen, progress=show)
    print(f"catalogue: {index}", file=sys.stderr)
    left_out = ", ".join(x for x in systems.names_in_sympy() if x not in pages.available())
    if left_out and not given.system:
        print(f"catalogue: omitted, because SymPy is not installed: {left_out}", file=sys.stderr)
    return 0


def _systems(given: argparse.Namespace) -> int:
    found = [systems.get(name) for name in systems.names()]
    _list((system.name, system.help) for system in found)
    print("\nDefined in SymPy, which has to be installed:")
    _list((name, catalogue.about(name)["help"]) for name in systems.names_in_sympy())
    return 0


def _schemes(given: argparse.Namespace) -> int:
    _list((record.name, record.help) for record in named_schemes())
    print("\nBesides these:")
    _list(
        [
            ("N", "the beta-scheme with beta = N, a number in [0, 1]"),
            ("N-nodes", "the same at the original nodes: satisfies D_eps"),
            ("pair:A:B", "two maps: beta A for L_d, beta B for D_d"),
            ("FILE.so:SYMBOL", "your own dal_scheme with its family, in a shared library"),
        ]
    )
    return 0


def _cache(given: argparse.Namespace) -> int:
    found = compiler.entries()
    size = sum(path.stat().st_size for path in found)
    print(f"{compiler.folder()}: {len(found)} compiled models, {size / 1024:.0f} KiB")
    if given.clear:
        print(f"removed {compiler.clear()}")
    return 0


def _list(items: Any) -> None:
    rows = list(items)
    width = max(len(name) for name, _ in rows)
    for name, text in rows:
        print(f"{name:{width}}  {text}")


def _parameter(text: str) -> tuple[str, float]:
    name, sign, value = text.partition("=")
    if not sign or not name:
        raise ValueError
    return name, float(value)


def _count(text: str) -> int:
    """Read a whole number, also as 2e12."""
    return int(text) if text.strip().isdigit() else int(float(text))
