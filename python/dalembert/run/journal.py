"""The journal of a run: a file from which an interrupted run resumes."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .. import core, geometry, systems
from ..core import Array, DalembertError, DalembertWarning, arguments, ffi, lib
from ..system import System
from .events import Happened, split
from .laws import Inputs, Law
from .options import JOURNAL_ERRORS
from .runs import Run
from .scheme import Scheme
from .solution import Solution, Statistics
from .steps import MOST, Steps, number_of_steps

SECONDS = 5.0  # from snapshot to snapshot
_CLOSE = 1e-6  # of the field that another machine computes, relative to its largest component


# ---- what a run is of, as data -------------------------------------------------------------------


def describe(
    system: System, scheme: Scheme, run: Run, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Return data for JSON that define a run, to repeat it or compare it with another."""
    times = None if run.watch is None else run.watch.times
    return {
        "dalembert": core.version(),
        "system": of_system(system, run.x[0], run.t0),
        "scheme": scheme._data(),
        **options,
        "inputs": run.inputs is not None,
        "law": None if run.law is None else run.law.about(system),
        "hold": run.hold,
        "t_end": run.steps.t_end,
        "control": run.steps.control,
        "times": None if times is None else base64.b64encode(times.tobytes()).decode(),
    }


def of_system(system: System, x: Array, t: float) -> dict[str, Any]:
    """Return data for JSON that identify a system: its definition, and the field at x."""
    try:
        field = geometry.field(system, *np.split(x, 2), t=t).tolist()
    except (DalembertError, ValueError):
        field = None
    return {
        "name": system.name,
        "parameters": system.parameters,
        "coordinates": list(system.coordinates),
        "inputs": list(system.inputs),
        "of_library": system._source.of_library,
        "identity": system._identity,
        "state": x.tolist(),
        "t": t,
        "field": field,
        **({"units": system.units} if system.units else {}),
    }


def require_same(system: System | None, about: Mapping[str, Any], path: str) -> System:
    """Return the given system, or one of the library; ValueError if it is not that of a file."""
    name, parameters = about["name"], about["parameters"]
    if system is None and about["of_library"]:
        system = systems.get(name, **parameters)
    if system is None:
        raise ValueError(
            f"system is missing: {path} belongs to {name!r} "
            f"({', '.join(about['coordinates'])}), which is not a built-in system; pass it, "
            "on the command line as FILE.py:NAME"
        )
    core.require_system(system)
    if system.parameters != parameters and system.parameters.keys() == parameters.keys():
        other = {key: x for key, x in parameters.items() if system.parameters[key] != x}
        there = ", ".join(f"{key} = {x!r}" for key, x in other.items())
        here = ", ".join(f"{key} = {system.parameters[key]!r}" for key in other)
        raise ValueError(f"system: {path} belongs to one with {there}, but this one has {here}")
    if json.loads(json.dumps(system._identity)) != about["identity"]:
        raise ValueError(f"system: {path} belongs to another system, {name!r}, not to {system!r}")
    field, x = about["field"], np.array(about["state"])
    if field is not None:
        expected = np.array(field)
        found = geometry.field(system, *np.split(x, 2), t=about["t"])
        if not abs(found - expected).max() <= _CLOSE * abs(expected).max():
            raise ValueError(
                f"system: {path} belongs to another system: at its first state the field was "
                f"{expected}, but here it is {found}"
            )
    units = about.get("units", {}) | system.units
    for name, unit in about.get("units", {}).items():
        if units[name] != unit:
            raise ValueError(
                f"system: {path} has {name} in {unit}, but this system has it in {units[name]}"
            )
    return system if units == system.units else system.with_units(**units)


def _shown(law: Mapping[str, Any] | None) -> str:
    """Return the expressions of inputs as text."""
    if law is None:
        return "no expressions"
    return ", ".join(f"{name} = {shown}" for name, shown in law["shown"].items())


# ---- the file ------------------------------------------------------------------------------------


class Journal:
    """An open journal; ``info`` is its ``dal_journal_info``, ``about`` the result of `describe`."""

    def __init__(self, path: str, handle: Any, goes_on: bool) -> None:
        self.path, self._handle, self._tells = path, handle, goes_on
        self.info = ffi.new("dal_journal_info *")
        lib.dal_journal_describe(handle, self.info)
        text = ffi.buffer(self.info.description, self.info.description_size)[:]
        try:
            self.about = json.loads(text)
            self.about["system"]["identity"]
        except (ValueError, KeyError, TypeError):
            raise ValueError(
                f"{path}: the journal was written by a C program, and does not contain its system"
            ) from None

    @classmethod
    def create(
        cls, path: Any, run: Run, scheme: Scheme, about: dict[str, Any], errors: str | None
    ) -> Journal:
        """Create the journal of a run that has not begun."""
        goes_on = _goes_on(errors)
        text = json.dumps(about).encode()
        record, kept = scheme._record_of(run.system)
        identity = json.dumps(about["system"]["identity"]).encode()
        described = ffi.new("char[]", text)
        options = ffi.new("dal_journal_options *", {"goes_on": goes_on, "seconds": SECONDS})
        options.description, options.description_size = described, len(text)
        options.fingerprint = hashlib.sha256(identity).digest()
        name = _name(path)
        handle = core.make(
            "journal", os.fsencode(name), run.run, record, options, owner=(run.run, kept)
        )
        del described
        return cls(os.fsdecode(name), handle, bool(goes_on))

    @classmethod
    def open(cls, path: Any, *, writes: bool = False, errors: str | None = None) -> Journal:
        """Open an existing journal; warn if its end is damaged."""
        goes_on = _goes_on(errors)
        name = _name(path)
        os.stat(name)  # an OSError of the usual kind, if it is not there
        options = ffi.new("dal_journal_options *", {"goes_on": goes_on, "seconds": SECONDS})
        given = os.fsencode(name), writes, options
        handle = core.make("journal", *given, new=lib.dal_journal_open)
        journal = cls(os.fsdecode(name), handle, bool(goes_on))
        if journal.info.cut and not journal.info.is_written:
            warnings.warn(
                f"{name}: the last {journal.info.cut} bytes are not a complete record, "
                "because the run was killed or the file is damaged; they are ignored",
                DalembertWarning, stacklevel=3,
            )  # fmt: skip
        return journal

    def system(self, given: System | None) -> System:
        """Return the system of the run: the given one, or one of the library."""
        return require_same(given, self.about["system"], self.path)

    def scheme(self, given: Scheme | None = None) -> Scheme:
        """Return the scheme of the run; C checks the given one."""
        if given is not None:
            return Scheme.of(given)
        if self.about["scheme"] is None:
            name = core.string(self.info.scheme)
            raise ValueError(
                f"scheme is missing: the scheme of {self.path}, {name!r}, is made of "
                "functions; pass it"
            )
        return Scheme._from_data(self.about["scheme"])

    def require_law(self, system: System, inputs: Inputs) -> None:
        """Raise ValueError unless inputs are the expressions of the run, if it had any."""
        there = self.about.get("law")
        here = inputs.about(system) if isinstance(inputs, Law) else None
        if (there and there["key"]) == (here and here["key"]) or inputs is None:
            return
        raise ValueError(
            f"inputs: the run of {self.path} has {_shown(there)}, but these are "
            f"{_shown(here)}; expected the same"
        )

    def times(self) -> Array | None:
        """Return the output times of the run, None if it stores rows."""
        text = self.about["times"]
        return None if text is None else np.frombuffer(base64.b64decode(text)).copy()

    def steps(self, t_end: float | None = None, steps: int | None = None) -> Steps:
        """Return the steps of the run, to a new end if given."""
        t0, h, about = float(self.info.t0), float(self.info.h), self.about
        if about["control"]:
            end = about["t_end"] if t_end is None else arguments.number(t_end, "t_end")
            return Steps(t0, end, math.nan, MOST, about["control"])
        if t_end is None and steps is None:
            steps = int(self.info.steps)
        last = t0 + int(self.info.done) * h
        t_end = None if t_end is None else arguments.number(t_end, "t_end")
        if t_end is not None and (t_end - last) / h < -0.5:
            raise ValueError(
                f"t_end = {t_end:g} is before the end of the journal (t = {last:g}): expected a "
                "later time"
            )
        count = number_of_steps(t0, h, t_end, steps)
        return Steps(t0, t0 + count * h, h, count, {})

    def resume(self, run: Run) -> None:
        """Set a run to the state of the last snapshot."""
        if run.steps.varies:
            run.make_room(int(self.info.records) + 1)
        run.x[0] = self.about["system"]["state"]  # of output times, C has no rows
        error = ffi.new("dal_error *")
        status = core.attempt(lib.dal_journal_resume, self._handle, run.run, error)
        core.check(status, error, run.system.kind)
        run.journal = self

    def tell(self) -> None:
        """Warn, once, that the file is no longer written while the run continues."""
        error = lib.dal_journal_error(self._handle)
        if self._tells and error.status == lib.DAL_EIO:
            self._tells = False
            warnings.warn(
                f"the run continues without its journal: {core.words(error)}", DalembertWarning,
                stacklevel=5,
            )  # fmt: skip

    def close(self, run: Any = None, saves: bool = False) -> None:
        """Write pending records, and a snapshot if ``saves``, and let others write."""
        if saves:
            lib.dal_journal_save(run)
        if run is not None:
            run.journal = ffi.NULL
        ffi.release(self._handle)

    # ---- what it holds -----------------------------------------------------------------------

    def records(self) -> Any:
        """Return the records, memory-mapped."""
        info = self.info
        fields = [
            ("checksum", "u4"), ("kind", "u4"), ("number", "u8"), ("step", "u8"), ("t", "f8"),
            ("x", "f8", (2 * info.n,)), ("reaction", "f8", (info.m,)),
            ("input", "f8", (info.input_rows, info.inputs)),
        ]  # fmt: skip
        kind, count = np.dtype(fields), int(info.records)
        if count == 0:
            return np.zeros(0, kind)
        return np.memmap(self.path, kind, "r", int(info.begin), (count,))

    def solution(self, system: System | None, scheme: Scheme | None) -> Solution:
        """Return the run so far; its states stay in the file."""
        system, scheme, info = self.system(system), self.scheme(scheme), self.info
        steps, stride = self.steps(), int(info.stride)
        t0, h = steps.t0, steps.h
        records = self.records()
        kinds = records["kind"]
        is_end = kinds == lib.DAL_RECORD_END
        is_row = is_end | (kinds == lib.DAL_RECORD_ROW)
        rows = records if is_row.all() else records[is_row]
        states = records[is_end | (kinds == lib.DAL_RECORD_TIME)] if info.has_times else rows
        ended = bool(is_end.any())
        x, reactions, times = states["x"], states["reaction"][1:], None
        if len(states) == 0:  # it has not come to an output time, or anywhere
            x = np.array([self.about["system"]["state"]])
        if info.has_times:
            times = np.array(states["t"]) if len(states) else np.array([t0])
            reactions = np.full((len(x) - 1, system.m), np.nan)
        elif steps.varies:
            times = np.array(rows["t"]) if len(rows) else np.array([t0])
        elif ended:
            times = np.append(t0 + np.arange(len(rows) - 1) * stride * h, rows["t"][-1])
        done = max(int(info.done), (len(rows) - 1 - ended) * stride)
        if steps.varies:
            done = int(rows["step"][-1]) if len(rows) else 0
            end = float(rows["t"][-1]) if len(rows) else t0
            over = ended or end == steps.t_end
            words, rest = f"{done} steps", "" if over else f" of {steps.t_end:g}"
        else:
            over = ended or done >= info.steps
            end = states["t"][-1] if ended else t0 + done * h
            words, rest = f"{done} steps" if over else f"{done} of {info.steps} steps", ""
        happened = dict(zip(("t_events", "x_events", "x_after"), split(self._events(records))))
        return Solution(
            system=system, scheme=scheme, t0=t0, h=h, stride=stride, x=x, times=times,
            reactions=reactions,
            status=lib.DAL_SUCCESS if over and not ended else lib.DAL_STOPPED,
            message=f"{words} to t = {end:g}{rest}, from {self.path}",
            inputs=self._inputs(rows, done + ended, steps), hold=self.about["hold"],
            control=steps.control,
            stats=Statistics(steps=done, worst_residual=np.nan), **happened,
        )  # fmt: skip

    def _inputs(self, rows: Any, done: int, steps: Steps) -> Array:
        """Return the available rows of inputs for so many steps."""
        info = self.info
        if info.inputs == 0:
            return np.zeros((0, len(self.about["system"]["inputs"])))
        if steps.varies:  # the row after each begins, and which it is of those
            ahead, hold = steps.direction, self.about["hold"]
            begins = steps.t0 + ahead * hold * np.arange(steps.holds(hold))  # as C has them
            row = np.searchsorted(ahead * rows["t"], ahead * begins, side="right")
            row = row[row < len(rows)]
            place = np.arange(len(row)) - np.searchsorted(row, row)
            return np.array(rows["input"][row, place])
        hold, stride = int(info.input_steps), int(info.stride)
        first = np.arange(-(-done // hold)) * hold  # step of each
        row = first // stride + 1
        there = row < len(rows)
        place = first[there] // hold - -(-(row[there] - 1) * stride // hold)
        return np.array(rows["input"][row[there], place])

    def _events(self, records: Any) -> Happened:
        """Return the events in the records; one after a reset follows on that of its event."""
        ends = np.flatnonzero(records["kind"] == lib.DAL_RECORD_AFTER)
        kinds = lib.DAL_RECORD_EVENT, lib.DAL_RECORD_RESET
        found = np.flatnonzero(np.isin(records["kind"], kinds))
        x = np.array(records["x"][found])
        after = np.full_like(x, np.nan)
        after[np.searchsorted(found, ends) - 1] = records["x"][ends]
        numbers, times = np.array(records["number"][found]), np.array(records["t"][found])
        return Happened(int(self.info.events), numbers, times, x, after)


def _goes_on(errors: str | None) -> int:
    """Return whether a run continues if its journal cannot be written, as by default."""
    return 1 if errors is None else arguments.choice(errors, "journal_errors", JOURNAL_ERRORS)


def _name(path: Any) -> str | bytes:
    """Return the name of a file; raise ValueError if C would truncate it."""
    name: str | bytes = os.fspath(path)
    if not name or b"\0" in os.fsencode(name):
        raise ValueError(f"journal = {name!r}: expected the name of a file")
    return name


def is_journal(path: Path) -> bool:
    """Return whether a file begins like a journal."""
    with open(path, "rb") as file:
        return file.read(6) == b"dalrun"
