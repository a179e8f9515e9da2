"""The list of options of a run, from which calls, commands and files take theirs.

A function has a record of its options, a frozen dataclass.  A field has the meaning of the option
and the kinds of run that use it.  It also has the check of its value, and its names in C and on the
command line.  The records share groups of fields: a new option of a group is one of all of them.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

from numpy.typing import ArrayLike

from .. import core
from ..core import Array, arguments, ffi, lib, require_system
from ..core.extras import Progress
from ..core.records import Option, Record, extended, meaning, option, options_of
from ..system import System
from . import events
from .scheme import INITIAL, METHODS, Scheme

WORDS = ("auto", "reversible", "own")  # what h may be instead of a number
TOLERANCE = 1e-9  # of "auto"
_PARTS = 16  # of an own step, in runs with events that are functions
JOURNAL_ERRORS = {"warn": 1, "stop": 0}


# ---- kinds of runs -------------------------------------------------------------------------------


class Kind(NamedTuple):
    """A kind of run: the words that describe it, and the options that apply to it."""

    asked_by: str
    options: frozenset[str]


_ASKED_BY = {
    "fixed": "a fixed step at moved nodes",
    "kept": "a fixed step at kept nodes",
    "auto": "h = 'auto'",
    "reversible": "h = 'reversible'",
    "own": "h = 'own'",
    "flow": "the schemes 'reference' and 'taylor'",
}
_FIXED = {"fixed", "kept"}
_STEPS = "fixed kept auto reversible"
_IN_C = f"{_STEPS} own flow"
_DRIVEN = "fixed kept auto own flow"


def word_of(h: Any) -> str | None:
    """Return the word given for a step size, None for a number."""
    if h is None:
        return "own"
    if not isinstance(h, str):
        return None
    if h not in WORDS:
        raise ValueError(
            f"h = {h!r}: {arguments.suggestion(h, WORDS)}expected a number or one of "
            f"{', '.join(map(repr, WORDS))}"
        )
    return h


def kind_of(scheme: Scheme, word: str | None = None) -> str:
    """Return the kind of a run by a scheme; raise ValueError if the word for h is unknown."""
    if word == "own" and not scheme.is_flow:
        raise ValueError(
            f"h is missing, or 'own', with the scheme {scheme.name!r}: only the schemes 'taylor' "
            "and 'reference' have steps of their own size; give h a number"
            + ("" if scheme.nodes == "kept" else ", 'auto' or 'reversible'")
        )
    if word not in (None, "own") and (scheme.is_flow or scheme.nodes == "kept"):
        flow, expected = scheme.is_flow, "a number"
        why = "has kept nodes, whose D_eps depends on h"
        if flow:
            why, expected = "chooses its own step sizes", "a number, or no h"
        raise ValueError(
            f"h = {word!r} with the scheme {scheme.name!r}, which {why}; expected {expected}"
        )
    return word or ("flow" if scheme.is_flow else "kept" if scheme.nodes == "kept" else "fixed")


def require(
    kind: str, given: Mapping[str, Any], listed: Mapping[str, Option] | None = None
) -> None:
    """Raise ValueError for a given option that has no effect on a run of this kind.

    None, False and an empty sequence count as not given.
    """
    there = {name: value for name, value in given.items() if not _is_nothing(value)}
    for name, value in there.items():
        one = (listed or LIST).get(name)  # an option beside these has been checked before
        if one is None:
            continue
        if one.uses is not None and kind not in one.uses:
            takers = {*one.uses}
            here = _FIXED if kind in _FIXED and not _FIXED & takers else {kind}
            advice = f"remove it, or take {_or(_in_words(takers))}"
            raise ValueError(
                f"{name} = {arguments.shown(value)}: not used with {_or(_in_words(here))}; "
                f"{one.instead or advice}"
            )
        if one.needs and one.needs not in there:
            raise ValueError(
                f"{name} = {arguments.shown(value)}: not used without {one.needs}; "
                f"remove it, or give {one.needs}"
            )
    if "t_eval" not in there:
        return
    if "stride" in there and "observer" not in there:
        raise ValueError(
            f"stride = {arguments.shown(given['stride'])}: not used with t_eval, which sets the "
            "stored times; remove one of the two"
        )


def _in_words(kinds: set[str]) -> list[str]:
    """Return the names of kinds of runs; the two with a fixed step together have one name."""
    both = kinds >= _FIXED
    rest = kinds - _FIXED if both else kinds
    return ["a fixed step"] * both + [_ASKED_BY[kind] for kind in _ASKED_BY if kind in rest]


def _is_nothing(value: Any) -> bool:
    return value is None or value is False or (isinstance(value, (list, tuple)) and not value)


def _or(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


# ---- a record ------------------------------------------------------------------------------------


class RunRecord(Record):
    """The common part of the records of runs."""

    def taken(self, kind: str, **beside: Any) -> Self:
        """Return the record with checked values, for a run of this kind with options ``beside``."""
        listed = options_of(type(self))
        given = {name: x for name, x in vars(self).items() if x is not listed[name].default}
        require(kind, {**given, **beside}, listed)
        return self.having(**{name: listed[name].take(x, name) for name, x in given.items()})


@dataclass(frozen=True, eq=False, repr=False)
class Options(RunRecord):
    """The options with which every run begins."""

    system: System = field(metadata=meaning("System", "The system."))
    scheme: Scheme | str | float | None = option("Scheme, str or float", """
        A scheme, its name, or beta.  "taylor" is the flow of the ODE on D by Taylor series, for
        systems from expressions; "reference" is the same by an adaptive method.  They are the best
        choice for accurate runs, and the default without h.  Otherwise the default is the cheapest
        scheme of order 2.  It is "midpoint" if the mass matrix depends on q, the constraints are
        affine or nonlinear, or a force depends on v; otherwise "leapfrog".  With ``h="auto"`` it is
        "midpoint-kl8" or "leapfrog-kl8", with ``h="reversible"`` "bm6".
    """, parse=str, metavar="NAME")  # fmt: skip
    q0: ArrayLike | None = option("array_like", parse=list, metavar="X,Y,...")
    v0: ArrayLike | None = option(
        "array_like, shape (n,)",
        "Initial data in the user's units; pass both or neither.  Default: the system's initial "
        "data.",
        parse=list, metavar="X,Y,...",
    )  # fmt: skip

    def read(self) -> Self:
        """Return the record with checked values and a `Scheme`; raise ValueError otherwise."""
        given: Any = self
        require_system(given.system)
        word, named = word_of(given.h), given.scheme is not None
        scheme = Scheme.of(given.scheme) if named else Scheme.usual(given.system, word)
        kind = kind_of(scheme, word)
        found: dict[str, Any] = {"scheme": scheme}
        if given.h is None:
            found["h"] = word
        if kind == "auto":
            tolerance = TOLERANCE if given.tolerance is None else given.tolerance
            found["tolerance"] = _positive(tolerance, "tolerance")
        if kind == "reversible" and given.eps is None:
            eps, error = ffi.new("double *"), ffi.new("dal_error *")
            core.check(lib.dal_scheme_eps(scheme._record, eps, error), error)
            found["eps"] = eps[0]
        scheme._initial(given.initial)
        return self.taken(kind).having(**found)

    @property
    def control(self) -> dict[str, Any]:
        """The word for the step size and its numbers; empty for steps of fixed size."""
        given: Any = self
        if not isinstance(given.h, str):
            return {}
        if given.h == "own":  # the tolerance belongs to the scheme
            known = vars(self).get("events", ())
            has_functions = not all(events.is_expression(one.g) for one in known)
            is_long = given.scheme.family == "taylor" and has_functions
            return {"h": given.h, "parts": _PARTS} if is_long else {"h": given.h}
        numbers = {name: getattr(given, name) for name in ("tolerance", "h_max", "eps")}
        return {"h": given.h, **{name: x for name, x in numbers.items() if x is not None}}

    @property
    def of_c(self) -> dict[str, Any]:
        """The given options that are members of ``dal_options``, by name."""
        given: Any = self
        if given.scheme.is_flow:  # whose tolerance belongs to the scheme
            return given.control
        listed = options_of(type(self))
        return {name: x for name, x in vars(self).items() if x is not None and listed[name].c}


def in_c(values: Mapping[str, Any]) -> Any:
    """Return the shared, read-only ``dal_options`` of options by name; others are ignored."""
    listed = options_of(IntegrateOptions)
    if values.get("h") == "own":
        return _in_c((("own_steps", values.get("parts", 1)),))
    taken = ((listed[name], x) for name, x in values.items() if name in listed and x is not None)
    return _in_c(tuple((one.c, one.choices.get(x, x)) for one, x in taken if one.c))


@functools.lru_cache(maxsize=64)
def _in_c(values: tuple[tuple[str, Any], ...]) -> Any:
    return ffi.new("dal_options *", dict(values))


# ---- the options ---------------------------------------------------------------------------------


def _positive(value: Any, name: str) -> float:
    result = arguments.number(value, name)
    if not result > 0.0:  # C looks at its size; 0 is none there
        raise ValueError(f"{name} = {value!r}: expected a positive number")
    return result


def step(text: str) -> float | str:
    """Return a number, or a word for the step size."""
    try:
        return float(text)
    except ValueError:
        return text


# fmt: off
@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Size:
    h: float | str | None = option('float, "auto", "reversible" or "own"', """
        Step size; negative to integrate backwards.  A number is never changed.

        "own", the default: steps of the scheme's own size, for "taylor" and "reference".  Each step
        is stored, or every stride-th, or the states at t_eval.  With events that are functions, not
        expressions, a step of "taylor" is made in 16 parts, because it may be half an oscillation.

        "auto": each step is as long as ``tolerance`` allows.  The estimate of its error costs no
        evaluation.  Requires a composition of moved nodes.  Use it if the time scale of the motion
        varies.

        "reversible": the step follows the time scale of the motion and is chosen symmetrically in
        time.  The energy of a reversible system then does not drift.  Use it for repeated close
        approaches over long times only.  Requires a symmetric composition and constant mass,
        without forces, inputs or dependence on time.  The run warns if irreversible steps changed
        the energy by more than 1e-6 of the largest kinetic energy.""", parse=step, metavar="H")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Extent:
    t_end: float | None = option("float", """
        End time.  ``(t_end - t0) / h`` has to be an integer, to a relative 1e-9.  If h is a word,
        the last step ends exactly at t_end.""", read=arguments.number, parse=float, metavar="T")
    steps: int | None = option("int", """
        Number of steps, 0 is allowed.  Pass exactly one of t_end and steps; t_end if h is a word.
    """, uses="fixed kept flow", instead="give t_end instead, because the steps vary",
        read=partial(arguments.integer, least=0), parse=int, metavar="N")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Step:
    t0: float = option(
        "float", "Initial time.", default=0.0, read=arguments.number, parse=float, metavar="T")
    tolerance: float | None = option("float", """
        Admissible error for "auto": that of the state at t = 100, relative to ``1 + abs(x_i)``, if
        the motion is not chaotic; default 1e-9.  For "reference": relative and absolute tolerance
        of each step, in [4.4e-16, 0.1]; default 1e-13.  For "taylor": that of a step, relative to
        the change of each coordinate in it; default 1e-15.
    """, uses="auto own flow", c="tolerance", parse=float, metavar="E")
    h_max: float | None = option(
        "float", 'Longest step of "auto"; default: no limit.', uses="auto", read=_positive,
        c="h_max", parse=float, metavar="H")
    eps: float | None = option("float", """
        Step of "reversible" in units of the time scale of the motion, at most 0.2.  Default: the
        value of the scheme, 0.13 for bm6.
    """, uses="reversible", read=_positive, c="eps", parse=float, metavar="E")
    consistent: str = option('{"check", "project", "assume"}', """
        The treatment of a v0 that violates the constraint: "check" raises an error (default),
        "project" projects it in the mass metric, "assume" uses it unchanged.
    """, default="check", choices=events.CONSISTENCY)
    initial: str | None = option('{"D", "D_eps", "project", "shift"}', """
        The meaning of the initial data; required for kept nodes, and allowed only there.  "D": the
        data lie in D and are used unchanged; the first step jumps to D_eps.  "D_eps": the data lie
        in D_eps.  "project": project the velocity from D onto D_eps.  "shift": move q to the node q
        + (1 - beta) h v.  The run is then that of the moved nodes, observed at the nodes.
    """, uses="kept", choices=INITIAL,
        instead="remove it, because only schemes with kept nodes take it, such as 'midpoint-nodes'")
    max_iterations: int | None = option("int", """
        Largest number of full Newton iterations in a sub-step; default 50.  Not for "reference".
    """, uses=_STEPS, read=partial(arguments.integer, least=1, most=2**31 - 1),
        c="max_iterations", parse=int, metavar="N")
    energy: str | None = option('{"keep"}', """
        "keep": conserve the energy to roundoff by scaling the velocity before and after each step,
        within D.  A run takes twice as long.  Steps of h/2 without it are closer to the exact
        motion, so use it only if the energy itself matters over long times.  Requires a symmetric
        scheme (leapfrog, midpoint, their compositions, bm4, bm6), constraints linear in v, and a
        system without forces or dependence on time.
    """, uses="fixed auto reversible", choices={"keep": 1}, c="keep_energy")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Sampling:
    stride: int | None = option("int", """
        Store every stride-th state; default 1.  The number of steps has to be a multiple of it.  If
        h is a word, the last state is always stored.
    """, read=partial(arguments.integer, least=1), parse=int, metavar="K")
    hold: float | None = option("int or float", """
        Number of steps for which a row of inputs applies; default 1.  An array has ceil(steps /
        hold) rows.  With "auto", hold is a time, and steps end when the inputs change.  An array
        then has ceil((t_end - t0) / hold) rows; default: one row for the whole run.
    """, uses=_DRIVEN, needs="inputs")
    method: str | None = option('{"rk8pd", "msadams", "rodas", "taylor"}', """
        Method of "reference"; default "rk8pd".  "taylor" is the scheme of this name.
    """, uses="own flow", choices=METHODS)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Inputs:
    inputs: Any = option("array_like, mapping or callable", """
        Inputs of a system that has k of them, constant over a step.  Default: 0.  ``run.inputs``
        returns them.

        - An array of shape (steps, k), or (k,) for all steps.
        - A mapping from names to numbers or arrays of shape (steps,).
        - A controller ``inputs(t, q, v) -> (k,)``, called at the beginning of each hold.
        - A mapping from names to expressions of time, coordinates, velocities and parameters,
          ``{tau: -K * x}``.  They are compiled, and evaluated like a controller.

        If the constraints depend on inputs, v0 has to satisfy them with the first inputs.  A change
        of the inputs then moves the velocity into the new D, as an impact does.""", uses=_DRIVEN)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Events:
    events: Any = option("sequence", """
        Events: functions ``g(t, q, v)``, expressions, or `Event`.  An event happens when g changes
        sign.  Functions may have the attributes ``terminal``, ``direction``, ``reset`` and
        ``consistent``.""", default=(), uses=_IN_C, read=lambda value, name: events.take(value))


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Watching:
    observer: Callable[[int, float, Array, Array], Any] | None = option("callable", """
        ``observer(step, t, q, v)`` is called at every stored state; a true result stops the run.
    """, read=partial(arguments.function, taken="step, t, q, v"))
    progress: Progress = option("bool or callable", """
        True: show a tqdm bar.  A function is called as ``progress(done, total)`` several times a
        second, with numbers of steps, or with times if h is a word.  While h is checked the total
        includes the repeated steps.""", default=False)
    throw: bool = option("bool", """
        False: if a step fails, return the states so far instead of raising; ``status`` and
        ``message`` of the Solution have the error.""", default=True)
    journal_errors: str | None = option('{"warn", "stop"}', """
        The response if the journal cannot be written, for example on a full disk: continue without
        it and warn (default), or raise `JournalError`.
    """, uses=_IN_C, needs="journal", choices=JOURNAL_ERRORS)
    check_h: bool | None = option("bool", """
        Whether to estimate the error of the last state, and to warn if h is too large; the default
        for steps of fixed size.  Turn it off for statistics of a chaotic motion, whose error is
        always large.
    """, uses="fixed kept", read=partial(arguments.truth, default=False), parse=bool)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class IntegrateOptions(Watching, Events, Inputs, Sampling, Step, Extent, Size, Options):
    """The options of `integrate`."""

    t_eval: ArrayLike | None = option("array_like, shape (N,)", """
        Times at which states are stored, in the order of the run, instead of every stride-th state.
        Steps of the scheme lead to these states: they have its order and lie in the set that it
        preserves.""", parse=list, metavar="T,T,...")
    dense: bool = option("bool", """
        True: keep the polynomials of the steps of "taylor", from which ``run(t)`` then takes its
        states, in about a microsecond each.  A step takes 300 bytes for each of the 2n - m numbers
        of a state on D, rounded up to a multiple of four; ``run.dense.nbytes`` is the memory of
        all.""", default=False, uses="own flow")
    journal: str | os.PathLike[str] | None = option("str or path", """
        A new file for the results.  Stored states are written several times a second, and every
        five seconds a snapshot.  After a crash, `load` returns the states in the file, and `resume`
        continues the run with bitwise identical results.
    """, uses=_IN_C, parse=Path, metavar="FILE")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class StepperOptions(Inputs, Step, Size, Options):
    """The options of `Stepper`."""

    inputs: Any = option("array_like, shape (k,), or mapping", """
        Initial inputs, by default 0; `step` may change them.  If the constraints depend on inputs,
        v0 has to satisfy them with these.""", uses=_DRIVEN)


@dataclass(frozen=True, eq=False, repr=False)
class _Journalled(RunRecord):
    path: str | os.PathLike[str] = field(metadata=meaning("str or path", "The journal."))
    system: System | None = option(
        "System", "The system of the run; not needed if it comes with the library.")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ResumeOptions(Watching, Events, Inputs, Extent, _Journalled):
    """The options of `resume`."""

    t_end: float | None = field(default=None, metadata=extended(
        Extent, "t_end", help="New end time of the whole run; default: that of the journal."))
    steps: int | None = field(default=None, metadata=extended(
        Extent, "steps", help="New number of steps of the whole run, instead of t_end."))
    scheme: Scheme | None = option(
        "Scheme", "The scheme of the run; required if it is not a scheme of the library.")

# fmt: on

KINDS = {
    kind: Kind(words, frozenset(
        name for name, one in options_of(IntegrateOptions).items()
        if (one.uses is None or kind in one.uses) and name not in ("h", *options_of(Options))
    ))
    for kind, words in _ASKED_BY.items()
}  # fmt: skip
LIST = options_of(IntegrateOptions)
