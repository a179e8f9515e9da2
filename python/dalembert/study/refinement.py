"""Step-size refinement: the measured order of a scheme, compared with its promise."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import core, geometry
from ..core import arguments, extras, ffi, lib, require_system
from ..core.documentation import Common
from ..core.extras import Progress
from ..run import Scheme
from ..run.integration import doubt_start
from ..run.options import kind_of, require
from ..run import schemes as named_schemes
from ..system import System
from .study import COLUMNS, Fit, Studies, Study

# Numbers of steps over one unit of time: what tells the order of the reactions, and low orders,
# and the candidates for high orders; COARSE is also how many units a longer step may take.
FINE = (80, 120, 160, 240, 320, 480, 640)
COARSE = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 64, 80)
LONGEST = 16  # of the default intervals
TOLERANCE = 1e-14  # of the reference flow
MOST_STEPS = 10**9  # of all runs together, unless the caller says that more are meant

FITS = (  # in the order of dal_order_fit
    "state", "multipliers", "reaction", "midpoint",
    "global_q", "global_v", "global_multipliers", "global_state",
)  # fmt: skip


@Common("ValueError", "Study")
def convergence(
    system: System,
    scheme: Scheme | str | float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    *,
    t_end: float | None = None,
    t0: float = 0.0,
    steps: Sequence[int] | None = None,
    initial: str | None = None,
    tolerance: float | None = None,
    max_steps: int = MOST_STEPS,
    progress: Progress = False,
) -> Study:
    """Measure the order of a scheme by refining the step size.

    Parameters
    ----------
    scheme : Scheme, str or float, optional
        A scheme, its name, or beta.  Default: the default of `integrate` for a number h.
    t_end, t0 : float, optional
        Interval of time, in the user's units.  The default is one unit.  Without ``steps`` it is 2,
        4, 8 or 16 if the errors of a high order are too close to roundoff over less.
    steps : sequence of int, optional
        Different numbers of steps over the interval.  The default depends on the promised order;
        for high orders the steps are as small as roundoff allows.
    initial : {"D", "D_eps", "project", "shift"}, optional
        The meaning of the initial data, as for `integrate`; required for kept nodes and allowed
        only there.
    tolerance : float, optional
        Tolerance of the reference flow, in [4.4e-16, 0.1]; default 1e-14.  Not allowed if errors
        are measured against the exact solution of the system.
    max_steps : int, optional
        Largest total number of steps of all runs.  A larger study raises ValueError before the
        first run.

    Raises
    ------
    dalembert.DalembertError
        If the reference flow fails.  A run that fails does not raise; its entries in the study are
        NaN.

    Examples
    --------
    >>> import dalembert as dal
    >>> study = dal.convergence(dal.systems.particle(), "midpoint", t_end=1)
    >>> study.holds, round(study.fits["global_q"].slope)
    (True, 2)
    """
    require_system(system)
    record = Scheme.usual(system) if scheme is None else Scheme.of(scheme)
    t0 = arguments.number(t0, "t0")
    require(kind_of(record), {"initial": initial})
    if tolerance is not None and not _has_flow(system, record, t0):
        raise ValueError(
            f"tolerance = {arguments.shown(tolerance)}: not used, because errors are "
            f"measured against the exact solution of {system.name!r}, not the reference flow; "
            "remove it"
        )
    start = record._initial(initial)
    x0 = geometry.initial_state(system, q0, v0)
    doubt_start(system, x0, t0)
    max_steps = arguments.integer(max_steps, "max_steps", 1)
    options = {"t0": t0, "initial": initial, "tolerance": tolerance, "max_steps": max_steps}

    def probe(duration: float, tried: Sequence[int]) -> Study:
        return convergence(system, record, q0, v0, t_end=t0 + duration, steps=tried, **options)

    if t_end is None:
        t_end = t0 + (_default_duration(record.order, probe) if steps is None else 1.0)
    t_end = arguments.number(t_end, "t_end")
    if steps is None:
        _require_few(_default_total(record.order, t_end - t0), max_steps)
        steps = _default_steps(record.order, t_end - t0, probe)
    numbers = _counts(steps)
    _require_few(sum(numbers), max_steps)
    c_numbers = ffi.new("size_t[]", numbers)
    definition = {
        "t0": t0, "t_end": t_end, "x0": core.pointer(x0), "initial": start,
        "steps": c_numbers, "count": len(numbers),
        "tolerance": TOLERANCE if tolerance is None else arguments.tolerance(tolerance),
    }  # fmt: skip
    measured = _measure(system, record, definition, sum(numbers), progress)
    q, v = np.split(x0, 2)
    return Study(
        system=system, scheme=record, q0=q, v0=v, t0=t0, t_end=t_end, initial=initial,
        steps=np.array(numbers), **measured,
    )  # fmt: skip


def _has_flow(system: System, record: Scheme, t0: float) -> bool:
    """Return whether a study uses the reference flow: kept nodes, or no exact solution."""
    known = system._has_exact is None and system.has_exact  # to C
    autonomous = not (system.is_forced or system.is_time_dependent)
    return record.nodes == "kept" or not (known and (autonomous or t0 == 0.0))


def _measure(
    system: System, record: Scheme, given: dict[str, Any], total: int, progress: Progress
) -> dict[str, Any]:
    """Return the measurements of C for a ``dal_order_def``, by the names of a `Study`."""
    definition = ffi.new("dal_order_def *", given)
    points = ffi.new("dal_order_point[]", given["count"])
    order, error = ffi.new("dal_order *"), ffi.new("dal_error *")
    with extras.progress(progress, total, "step") as show:
        context = ffi.new_handle(lambda made: show(int(made)))
        definition.watch, definition.watch_ctx = lib.dal_py_watch, context
        scheme, kept = record._record_of(system)
        handle = record._stepped(system)._handle
        status = core.attempt(
            lib.dal_order_study, handle, scheme, definition, points, order, error
        )
        del kept
        core.check(status, error, system.kind)
        show(total)
    columns = {x: np.array([getattr(point, y) for point in points]) for x, y in COLUMNS.items()}
    return {
        **columns,
        "fits": {
            name: Fit.read(getattr(order, name), [bool(x.counted >> k & 1) for x in points])
            for k, name in enumerate(FITS)
        },
        **{name: getattr(order, name) for name in ("p", "s", "floor", "reference")},
        **{name: bool(getattr(order, name)) for name in ("keeps_D", "keeps_D_eps")},
        "holds": {1: True, 0: False}.get(order.holds),
        "measurable": order.holds != -3,
        "text": core.string(order.text),
    }


def studies(
    system: System,
    schemes: Iterable[Scheme | str | float] | Scheme | str | float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    *,
    t_end: float | None = None,
    t0: float = 0.0,
    steps: Sequence[int] | None = None,
    initial: str | None = None,
    tolerance: float | None = None,
    max_steps: int = MOST_STEPS,
    progress: bool | Callable[[float, int], Any] = False,
) -> Studies:
    """Measure the order of several schemes on one system.

    Parameters
    ----------
    system : System
    schemes : Scheme, str or float, or iterable of them, optional
        Default: every named scheme.
    initial : {"D", "D_eps", "project", "shift"}, optional
        The meaning of the initial data for schemes with kept nodes, default "D_eps".  Not allowed
        if no scheme has kept nodes.
    progress : bool or callable, optional
        True: show a tqdm bar.  A function is called as ``progress(done, total)`` with numbers of
        schemes, including fractions.
    q0, v0, t_end, t0, steps, tolerance, max_steps
        As for `convergence`.  The default of t_end is that of the scheme of highest order, for all
        schemes; max_steps limits the total over all schemes.

    Returns
    -------
    Studies
        In the order of ``schemes``.

    Raises
    ------
    ValueError, dalembert.DalembertError
        As for `convergence`.
    KeyboardInterrupt, Exception
        Any exception during the studies, such as KeyboardInterrupt; ``.partial`` has the finished
        studies.

    Examples
    --------
    >>> import dalembert as dal
    >>> found = dal.studies(dal.systems.particle(), ["midpoint", "leapfrog"])
    >>> found.holds
    True
    """
    if schemes is None:
        schemes = [scheme for scheme in named_schemes() if scheme.order > 0]
    elif isinstance(schemes, str) or not isinstance(schemes, Iterable):
        schemes = [schemes]
    records = [Scheme.of(scheme) for scheme in schemes]
    t0 = arguments.number(t0, "t0")
    applies = {
        "initial": [record.nodes == "kept" for record in records],
        "tolerance": [_has_flow(system, record, t0) for record in records],
    }
    for name, value in (("initial", initial), ("tolerance", tolerance)):
        if value is not None and not any(applies[name]):
            raise ValueError(
                f"{name} = {arguments.shown(value)}: not used by any of these schemes; "
                "remove it"
            )
    max_steps = arguments.integer(max_steps, "max_steps", 1)
    # The highest order first: it has the longest default interval.
    places = sorted(range(len(records)), key=lambda i: -records[i].order)
    found: dict[int, Study] = {}
    if steps is not None:
        steps = _counts(steps)
        _require_few(len(records) * sum(steps), max_steps)
    elif t_end is not None:
        duration = arguments.number(t_end, "t_end") - t0
        _require_few(sum(_default_total(record.order, duration) for record in records), max_steps)
    options = {"t0": t0, "steps": steps, "max_steps": max_steps}
    with _kept(found), extras.progress(progress, len(records), "scheme") as show:
        for i in places:
            found[i] = convergence(
                system, records[i], q0, v0, t_end=t_end, **options,
                initial=(initial or "D_eps") if applies["initial"][i] else None,
                tolerance=tolerance if applies["tolerance"][i] else None,
                progress=lambda made, total: show(len(found) + made / total),
            )  # fmt: skip
            t_end = found[i].t_end
    return Studies(found[i] for i in range(len(records)))


@contextlib.contextmanager
def _kept(found: dict[int, Study]) -> Iterator[None]:
    """Attach the finished studies to any exception, as ``.partial``."""
    try:
        yield
    except BaseException as error:
        error.partial = Studies(found[i] for i in sorted(found))  # type: ignore[attr-defined]
        raise


def _default_duration(order: int, probe: Callable[..., Study]) -> int:
    """Return the shortest interval that reveals this order, or 1 if none does."""
    duration = 1
    while order > 2 and duration <= LONGEST:
        if not math.isnan(_clear(probe(duration, COARSE)).slope):
            return duration
        duration *= 2
    return 1


def _clear(study: Study) -> Fit:
    """Return the fit of the one-step errors above the floor of the errors at the end.

    So the steps chosen reveal the order at the end too.
    """
    return Fit.of(study.h, study.local_error, study.floor)


def _units(duration: float) -> int:
    """Return the number of units of time, rounded."""
    if not math.isfinite(duration):
        raise ValueError(f"t_end - t0 = {duration:g}: expected a finite interval of time")
    return max(1, round(abs(duration)))


def _default_total(order: int, duration: float) -> int:
    """Return the largest number of steps that the default may take, trials included."""
    units = _units(duration)
    tried = 0 if order <= 2 else (sum(COARSE) + 4) * units + sum(COARSE) + len(COARSE)
    return sum(FINE) * units + 2 * tried


def _default_steps(order: int, duration: float, probe: Callable[..., Study]) -> list[int]:
    """Choose numbers of steps whose errors reveal the order.

    One-step errors h^(p+1) have to exceed the floor.  The steps are as small as that allows,
    because errors are a power of h only in the limit.  Up to order 2 any small h will do.  For a
    higher order ``probe`` tries steps from 1/80 of a unit of time to all of it.  The finest steps
    over a factor of two are chosen.  The reactions, of low order for any p, also need small h:
    their errors c1 h + c2 h^2 may change sign at large h.  C fits the finer half.
    """
    units = _units(duration)
    if order <= 2:
        return [count * units for count in FINE]
    longer = {math.ceil(units / k) for k in COARSE}
    tried = probe(duration, sorted({*longer, *COARSE, *(count * units for count in COARSE)}))
    clear = [int(x) for x in tried.steps[np.array(_clear(tried).counted)]]
    finest = [count for count in clear if 2 * count >= clear[-1]]
    chosen = clear[-max(len(finest), 3) :] or [count * units for count in COARSE[:3]]
    if chosen[-1] < 2 * chosen[0]:
        chosen = clear[-len(chosen) - 1 :]
    return sorted({*chosen, *(count * units for count in FINE)})


def _counts(steps: Iterable[int]) -> list[int]:
    """Return the numbers of steps; raise ValueError unless they are distinct positive integers."""
    places: dict[int, int] = {}
    try:
        for i, count in enumerate(steps):
            if isinstance(count, bool):
                raise ValueError(f"steps[{i}] = {count}: expected an integer")
            number = arguments.integer(count, f"steps[{i}]", 1)
            if number in places:
                raise ValueError(
                    f"steps[{i}] = {number}: steps[{places[number]}] has the same value; "
                    "expected different numbers"
                )
            places[number] = i
    except TypeError:
        raise ValueError(
            f"steps = {arguments.shown(steps)}: expected several numbers of steps"
        ) from None
    if not places:
        raise ValueError("steps is empty: expected at least one number of steps")
    return list(places)


def _require_few(total: int, most: int) -> None:
    """Raise ValueError if a study would take more steps than ``most``."""
    if total > most:
        raise ValueError(
            f"the study would take {total} steps in total, more than max_steps = {most}. Take "
            f"fewer steps or a shorter interval, or allow it with max_steps={total} "
            f"(--max-steps {total})"
        )
