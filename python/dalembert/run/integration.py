"""Integration: many steps of a scheme, from initial data or from a journal."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import core, geometry
from ..core import (
    Array,
    DalembertError,
    DalembertWarning,
    arguments,
    extras,
    lib,
)
from ..core.memory import require_memory
from ..core.records import takes
from ..system import System
from .dense import Dense
from .events import CONSISTENCY, Watch
from .journal import Journal, describe
from .laws import take_inputs
from .options import IntegrateOptions, ResumeOptions, in_c, kind_of
from .runs import Plan, Run, first_inputs, idle_steppers, started_stepper
from .scheme import Scheme
from .solution import Solution, rank_doubt
from .steps import Steps


@takes(IntegrateOptions)
def integrate(*args: Any, **given: Any) -> Solution:
    """Integrate a system with steps of fixed, error-controlled or reversible size.

    Returns
    -------
    Solution

    Raises
    ------
    ValueError
        If an argument is out of range, or does not apply to this kind of run.  The message has its
        name, its value and the expected values.
    MemoryError
        If the states do not fit in memory; nothing was allocated.
    NotOnConstraintError
        If the initial data are not in D; the message has the residual.
    SingularError, ConvergenceError, DomainError
        If a step failed.  ``.step`` and ``.t`` locate it; ``.partial`` is a Solution with the
        states so far.
    JournalError
        If the journal cannot be created, or, with ``journal_errors="stop"``, written.
    ZenoError
        If events accumulate, or the system rests on one after its reset.
    NotImplementedError
        If the system or the scheme does not support an option, such as ``energy="keep"``.
    Exception
        Any exception raised by the observer or by a function of the system, and KeyboardInterrupt.
        They have ``.partial`` too.

    Warns
    -----
    DalembertWarning
        If the result is doubtful:

        - q0, or the end of the run, violates a position constraint;
        - a coordinate is so large that doubles do not resolve the motion;
        - h is too large, or the energy jumped although nothing does work;
        - the energy was not kept in some steps of ``energy="keep"``;
        - many steps needed the full Newton iteration, so h is large for this system, or its
          constraints are nearly dependent;
        - the constraints nearly lost rank, or steps shrank to a tiny part of their usual size;
        - it cannot be decided whether an event happened;
        - the journal was not written to the end.

    Notes
    -----
    C code runs without the interpreter's lock; several threads may run the same system.

    Examples
    --------
    >>> import dalembert as dal
    >>> run = dal.integrate(dal.systems.particle(), "midpoint", [0, 1, 0], [1, 1, 1],
    ...                     h=0.01, t_end=10)
    >>> bool(run.residual.max() < 1e-15)
    True
    """
    asked = IntegrateOptions.of("integrate", args, given).read()
    system, scheme, sizes = asked.system, asked.scheme, Steps.of(asked)
    assert isinstance(scheme, Scheme)
    stride = sizes.stride(asked.stride)
    chosen = with_method(scheme, asked.method, asked.tolerance if scheme.is_flow else None)
    x0 = geometry.initial_state(system, asked.q0, asked.v0)
    consistency = CONSISTENCY[asked.consistent]
    doubt_start(system, x0, asked.t0, consistency)
    times = None if asked.t_eval is None else _times(asked.t_eval, sizes)
    inputs = take_inputs(system, asked.inputs)
    hold = sizes.hold(asked.hold, inputs)
    if not sizes.varies:
        rows = sizes.count // stride if times is None else len(times)
        size = 8 * ((rows + 1) * (2 * system.n + 1) + rows * system.m)
        stored = f"steps = {sizes.count} with stride = {stride}: {rows + 1} states"
        require_memory(size, stored, "use a larger stride")

    first = first_inputs(system, inputs, sizes.holds(hold), x0, asked.t0)
    of_c = in_c(asked.of_c)
    idle = idle_steppers(system, chosen, of_c)
    stepper = started_stepper(
        system, chosen, x0, t0=asked.t0, h=sizes.first, consistency=consistency,
        initial=scheme._initial(asked.initial), options=of_c, idle=idle, inputs=first,
    )  # fmt: skip

    def begin(run: Run) -> None:
        if asked.journal is not None:
            about = describe(system, chosen, run, asked.of_c)
            run.journal = Journal.create(asked.journal, run, chosen, about, asked.journal_errors)

    watched = asked.events or times is not None
    watch = Watch(system, stepper, chosen, asked.events, times) if watched else None
    plan = Plan(asked, system, chosen, stepper, sizes, stride, inputs, hold, watch, first)
    if not asked.dense:
        solution = _make(begin, plan)
    else:
        dense = Dense(system, chosen)
        with dense.keeping(stepper):
            solution = _make(begin, dataclasses.replace(plan, dense=dense))
    idle.append(stepper)
    return solution


@takes(ResumeOptions)
def resume(*args: Any, **given: Any) -> Solution:
    """Resume a run from its journal; the result is bitwise identical to an uninterrupted run.

    Scheme, step size and output times are those of the journal.  Pass the inputs and events of the
    whole run again, if it has any; expressions of inputs have to be the same.  States after the
    last snapshot are computed again and compared with the journal.

    Only the error of the resumed part can be estimated.  ``stats.error`` has it if it exceeds 0.05,
    with the warning that h is too large; otherwise it is nan.

    Returns
    -------
    Solution
        The whole run.

    Raises
    ------
    ValueError
        If the file is not a journal, or another process is writing it.  Also if the system, inputs,
        events or scheme differ from those of the journal.  The message says which.
    JournalError
        If the file cannot be read.
    NotImplementedError
        If no snapshot in the file is intact; `load` may still read states.
    SingularError, ConvergenceError, DomainError, ZenoError, Exception
        As for `integrate`.

    Warns
    -----
    DalembertWarning
        As for `integrate`, and if the end of the file was damaged and has been cut off.

    Examples
    --------
    >>> import os, tempfile
    >>> import dalembert as dal
    >>> path = os.path.join(tempfile.mkdtemp(), "run.dal")
    >>> run = dal.integrate(dal.systems.sleigh(), h=0.01, t_end=1, journal=path)
    >>> longer = dal.resume(path, t_end=2)
    >>> whole = dal.integrate(dal.systems.sleigh(), h=0.01, t_end=2)
    >>> bool((longer.x == whole.x).all())
    True
    """
    asked = ResumeOptions.of("resume", args, given)
    journal = Journal.open(asked.path, writes=True, errors=asked.journal_errors)
    about = journal.about
    system, record = journal.system(asked.system), journal.scheme(asked.scheme)
    read = asked.taken(kind_of(record, about["control"].get("h")), journal=journal)
    sizes = journal.steps(read.t_end, read.steps)
    stride = sizes.stride(int(journal.info.stride))
    inputs = take_inputs(system, read.inputs)
    journal.require_law(system, inputs)
    if about["inputs"] and inputs is None:
        raise ValueError(
            f"inputs is missing: the run of {journal.path} has inputs, so pass the same"
        )
    c_record, kept = record._record_of(system)
    handle = record._stepped(system)._handle
    stepper = core.make(
        "stepper", handle, c_record, in_c({**about, **sizes.control}), owner=(handle, kept)
    )
    times, hold = journal.times(), about["hold"]
    watched = read.events or times is not None
    watch = Watch(system, stepper, record, read.events, times) if watched else None
    plan = Plan(read, system, record, stepper, sizes, stride, inputs, hold, watch)
    return _make(journal.resume, plan)


def _make(begin: Callable[[Any], None], plan: Plan) -> Solution:
    """Return the solution of a `Run`, or raise its error with the solution so far."""
    with extras.progress(plan.asked.progress, *plan.steps.progress) as show:
        run = Run(plan, show)
        begin(run)
        run.make()
    solution, error = run.solution(), run.error
    if error is None:
        _warn(solution, run.watch)
        _warn_of_drift(solution)
    elif plan.asked.throw or not isinstance(error, DalembertError):
        with contextlib.suppress(AttributeError, TypeError):
            error.partial = solution  # type: ignore[attr-defined]
        try:
            raise error
        finally:
            del error, run  # else the traceback would keep itself alive
    return solution


# ---- arguments -----------------------------------------------------------------------------


def with_method(record: Scheme, method: str | None, tolerance: float | None) -> Scheme:
    """Return the scheme; "reference" gets this method and tolerance, "taylor" this tolerance."""
    if method is None and tolerance is None:
        return record
    is_plain = record in (Scheme.find("reference"), Scheme.find("taylor"))
    if record.family == "taylor" and method not in (None, "taylor"):
        raise ValueError(
            f"method = {method!r}: not used with the scheme 'taylor'; remove it, or take the "
            "scheme 'reference'"
        )
    made = Scheme.taylor if "taylor" in (record.family, method) else Scheme.flow
    given = {} if made == Scheme.taylor or method is None else {"method": method}
    flow = made(**given, **({} if tolerance is None else {"tolerance": tolerance}))
    if not is_plain and record != flow:
        raise ValueError(
            f"method = {method!r}, tolerance = {tolerance!r}: the scheme already has a method "
            "and a tolerance; remove them, or pass the name of the scheme"
        )
    return flow


def _times(given: ArrayLike, steps: Steps) -> Array:
    """Return t_eval; raise ValueError for times outside the run or out of order."""
    times = np.ascontiguousarray(arguments.array(given, "t_eval", (None,)))
    t0, end = steps.t0, steps.t_end
    if len(times) == 0:
        raise ValueError("t_eval: expected at least one time")
    ahead = steps.direction
    along = ahead * times
    in_order = np.count_nonzero(along[1:] < along[:-1]) == 0
    if in_order and along[0] >= ahead * t0 and along[-1] <= ahead * end:
        return times
    outside = (ahead * (times - t0) < 0) | (ahead * (times - end) > 4e-16 * abs(end))
    if outside.any():
        t = float(times[outside][0])
        raise ValueError(
            f"t_eval contains {t!r}: expected times of the run, from {t0!r} to {end!r}"
        )
    if not in_order:
        raise ValueError("t_eval: expected times in the order of the run")
    return times


class _Quiet(threading.local):
    """The list that collects the warnings of this thread, or None."""

    warned: list[str] | None = None


_quiet = _Quiet()


@contextlib.contextmanager
def quietly() -> Iterator[list[str]]:
    """Collect the warnings of runs in this thread in a list instead of issuing them."""
    before, _quiet.warned = _quiet.warned, []
    try:
        yield _quiet.warned
    finally:
        _quiet.warned = before


def _warn(solution: Solution, watch: Watch | None = None) -> None:
    """Warn of doubts about a run that ended without error."""
    for doubt in itertools.chain(doubts(solution), watch.doubts() if watch else ()):
        _say(doubt, 5)


def _say(doubt: str, stacklevel: int) -> None:
    if _quiet.warned is None:
        warnings.warn(doubt, DalembertWarning, stacklevel=stacklevel)
    else:
        _quiet.warned.append(doubt)


def doubt_start(system: System, x: Array, t: float, consistency: int = lib.DAL_CHECK) -> None:
    """Warn of initial data that spoil every run, unless assumed consistent.

    They violate a position constraint, or a coordinate is so large that the acceleration is
    another one at the next double.
    """
    if consistency == lib.DAL_ASSUME:
        return
    n = system.n
    if off := system.off_positions(x[:n], t):
        _say(
            f"q0 violates a position constraint, and so will the motion: {off}; change q0, or "
            "pass consistent='assume'", 4,
        )  # fmt: skip
    for i in [i for i, place in enumerate(x[:n].tolist()) if abs(place) > LARGE]:
        beside = x.copy()
        beside[i] = np.nextafter(x[i], 0.0)
        states = np.array([x, beside])
        with contextlib.suppress(Exception):  # the run raises it
            here, there = geometry.acceleration(system, states[:, :n], states[:, n:], t)
            if abs(there - here).max() > COARSE * abs(np.array([here, there])).max():
                _say(
                    f"q0[{i}] = {x[i]:g} is too large: the next double is "
                    f"{np.spacing(x[i]):g} away, and the acceleration there differs. Subtract "
                    "whole turns from an angle, or move the origin of a length", 4,
                )  # fmt: skip


def _warn_of_drift(solution: Solution) -> None:
    """Warn if a run has drifted off a position constraint that its initial data satisfied."""
    system = solution.system
    if system._model is None or not system._model.positions:
        return
    q, t = solution.q, solution.t
    if not system.off_positions(q[0], t[0]) and (off := system.off_positions(q[-1], t[-1])):
        _say(
            f"the run has drifted off a position constraint: {off}; the steps "
            f"({solution._how}) satisfy only its time derivative. Take shorter steps, or a "
            "scheme of higher order",
            5,
        )


LARGE = 1e9  # below it doubles have seven digits behind the point
COARSE = 1e-3  # of the acceleration, from one double to the next


def _at(solution: Any) -> str:
    """Return a text with the time of the step after which the energy jumped, and its size."""
    if solution.control:
        return f" ({solution._how})"
    t = solution.t0 + solution.stats.jump_step * solution.h
    return f" (t = {t:g}, h = {solution.h:g})"


SHORT = 1e-6  # steps, relative to the usual ones, which nearly singular motions take
DRIFT = 1e-6  # of the energy, in units of the largest kinetic energy


def _drift(solution: Any) -> float:
    """Return the largest lasting change of the energy of reversible steps; 0 if it only oscillates.

    The unit is the largest kinetic energy.  Changes of 1e-14 of the potential energy are roundoff;
    changes at resets are not counted.
    """
    system, v, E = solution.system, solution.v, solution.energy.copy()
    for times, before, after in zip(solution.t_events, solution.x_events, solution.x_after):
        reset = ~np.isnan(after).any(axis=1)
        for t, *x in zip(times[reset], before[reset], after[reset]):
            earlier, later = system.energy(*np.split(np.array(x), 2, axis=1))
            E[abs(solution.t - solution.t[0]) >= abs(t - solution.t[0])] -= later - earlier
    kinetic = np.einsum("ki,ij,kj->k", v, system.mass, v) / 2
    noise = 1e-14 * (abs(E - kinetic).max() + kinetic.max())
    change = np.maximum(abs(E - E[0]) - noise, 0.0) / kinetic.max()
    stays = change[-(len(E) // 4 + 1) :].min() > change.max() / 2
    return float(change.max()) if stays or solution.stats.resets > 10 else 0.0


def doubts(solution: Any) -> Iterator[str]:
    """Yield the doubts that the statistics raise about a run that ended without error."""
    system, stats = solution.system, vars(solution).get("_counts") or solution.stats
    bound = core.residual_bound(system.n)
    if stats.worst_residual > bound:
        yield (
            f"the relative residual of the constraint is {stats.worst_residual:.1e}, more "
            f"than {bound:.1e}, because the kept nodes are so far from the origin that "
            "rounding dominates"
        )
    if stats.whole and stats.error > lib.DAL_LARGE_ERROR:
        how = solution._how
        least = "at least " if stats.whole == 2 else ""
        size = f"{least}about {100 * stats.error:.0f} % of its size"
        about = size if stats.error < 1.0 else "larger than its size"
        yield (
            f"h may be too large ({how}): its error is unknown, because a run with h / 2 failed"
            if np.isinf(stats.error)
            else f"h is too large ({how}): the estimated error of the last state is {about} "
            "(stats.error). Try h / 2. For statistics of a chaotic motion, whose error is "
            "always large, turn this estimate off with check_h=False"
        )
    elif stats.jump_step:
        changed = "would have changed" if stats.scaled else "has changed"
        yield (
            f"the energy {changed} by {stats.jump:.3g} at step "
            f"{stats.jump_step}{_at(solution)}, and the largest kinetic energy is "
            f"{stats.largest_kinetic:.3g}. Nothing does work on this system, so the steps are "
            "too long, or gradient does not belong to potential: see check()"
        )
    if stats.unscaled:
        yield (
            f"the energy was not kept in {stats.unscaled} of {stats.steps} steps, because the "
            "velocity would have changed by more than half. These are plain steps of the "
            "scheme; a smaller h makes them rarer"
        )
    if stats.uncontrolled > 0.05 * stats.steps:
        yield (
            f"{stats.uncontrolled} of {stats.steps} steps have a larger error than the "
            f"tolerance allows ({solution._how}), because roundoff hides their estimated "
            "error; take a larger tolerance, or try another scheme"
        )
    if solution.control.get("h") == "reversible" and (drift := _drift(solution)) > DRIFT:
        yield (
            f"the energy has changed by {drift:.1e} of the largest kinetic energy. Some steps "
            f"were not reversible ({stats.resets} of {stats.steps}, and those of first "
            f"encounters; {solution._how}), because the rate of the motion changed too fast; "
            "take a smaller eps, or h='auto'"
        )
    simple = system.has_constant_mass and system.kind == "linear" and not system.is_forced
    if simple and stats.full_newtons > 0.1 * stats.substeps:
        yield (
            f"{stats.full_newtons} of {stats.substeps} sub-steps needed the full Newton "
            "iteration, because the simpler one did not converge. The steps are long for this "
            f"system ({solution._how}), or its constraints are nearly dependent"
        )
    if stats.rank_doubts:
        yield rank_doubt(stats)
    elif stats.least_step < SHORT:
        yield (
            f"at t = {stats.least_step_t:g} the steps shrank to {stats.least_step:.1e} of their "
            "usual size: the motion is nearly singular there, as in a collision, and amplifies "
            "errors; compare runs with other tolerances"
            + (f" (least pivot of mu M^-1 mu^T: {stats.least_pivot:.1e})" if system.m else "")
        )
