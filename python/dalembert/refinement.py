"""Step-size refinement: the order of a scheme, measured and compared with what it promises."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _lib, arguments, extras, geometry
from ._lib import ffi, lib
from .scheme import Scheme
from .scheme import schemes as named_schemes
from .study import Fit, Studies, Study, counts
from .system import System, require_system

__all__ = ["convergence", "studies"]

# Numbers of steps over one unit of time: what tells the order of the reactions, and low orders,
# and the candidates for high orders; COARSE is also how many units a longer step may take.
FINE = (80, 120, 160, 240, 320, 480, 640)
COARSE = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 64, 80)
LONGEST = 16  # of the default intervals

FITS = (
    "state",
    "multipliers",
    "reaction",
    "midpoint",
    "global_q",
    "global_v",
    "global_multipliers",
)


def convergence(
    system: System,
    scheme: Scheme | str | float,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    *,
    t_end: float | None = None,
    t0: float = 0.0,
    steps: Sequence[int] | None = None,
    initial: str | None = None,
    tolerance: float = 1e-14,
) -> Study:
    """Measure the order of a scheme by refining the step size.

    Parameters
    ----------
    system : System
    scheme : Scheme, str or float
        A record, the name of one, or beta.
    q0, v0 : array_like, shape (n,), optional
        Initial data in D, in the user's units.  Default: those of the system.
    t_end, t0 : float, optional
        Interval of time, in the user's units.  Default: one unit; without ``steps`` 2, 4, 8 or 16
        where the errors of a high order over less than that are too close to roundoff.
    steps : sequence of int, optional
        Numbers of steps over the interval.  The default depends on the promised order: small
        steps, for high orders as small as the round-off floor allows.
    initial : {"D", "D_eps", "project", "shift"}, optional
        How runs with kept nodes start; they refuse to start without.
    tolerance : float, optional
        Of the reference flow where the system has no exact solution.  Default: 1e-14.

    Returns
    -------
    Study

    Raises
    ------
    ValueError
        If an argument is out of range; the text names it.
    dalembert.DalembertError
        If the reference flow fails.  A run that fails is a failed entry of the study instead.

    Examples
    --------
    >>> import dalembert as dal
    >>> study = dal.convergence(dal.systems.particle(), "midpoint", t_end=1)
    >>> study.holds, round(study.fits["global_q"].slope)
    (True, 2)
    """
    require_system(system)
    record = Scheme.of(scheme)
    if record.is_reference:
        raise ValueError("scheme = 'reference': expected one with a step size to refine")
    t0 = arguments.number(t0, "t0")
    start = record._initial(initial)
    x0 = np.concatenate(geometry.initial(system, q0, v0))

    def probe(duration: float, candidates: Sequence[int]) -> Study:
        return convergence(
            system,
            record,
            q0,
            v0,
            t0=t0,
            steps=candidates,
            initial=initial,
            t_end=t0 + duration,
            tolerance=tolerance,
        )

    if t_end is None:
        t_end = t0 + (_default_duration(record.order, probe) if steps is None else 1.0)
    t_end = arguments.number(t_end, "t_end")
    if steps is None:
        steps = _default_steps(record.order, t_end - t0, probe)
    numbers = _counts(steps)
    c_numbers = ffi.new("size_t[]", numbers)
    definition = ffi.new(
        "dal_order_def *",
        {
            "t0": t0,
            "t_end": t_end,
            "x0": _lib.pointer(x0),
            "steps": c_numbers,
            "count": len(numbers),
            "initial": start,
            "tolerance": arguments.number(tolerance, "tolerance"),
        },
    )
    points = ffi.new("dal_order_point[]", len(numbers))
    order, error = ffi.new("dal_order *"), ffi.new("dal_error *")
    status = _lib.attempt(
        lib.dal_order_study, system._handle, record._record, definition, points, order, error
    )
    if status < 0:
        raise _lib.failure(status, _lib.string(error.text), kind=system.kind)

    def column(member: str) -> Any:
        return np.array([getattr(point, member) for point in points])

    h, q_error, v_error = column("h"), column("q"), column("v")
    state = ffi.new("dal_fit *")
    worse = np.maximum(q_error, v_error)
    lib.dal_fit_order(len(h), _lib.pointer(h), _lib.pointer(worse), order.floor, state)
    fits = {name: Fit.read(getattr(order, name)) for name in FITS}

    return Study(
        system=system,
        scheme=record,
        q0=x0[: system.n],
        v0=x0[system.n :],
        t0=t0,
        t_end=t_end,
        initial=initial,
        steps=np.array(numbers),
        h=h,
        q_error=q_error,
        v_error=v_error,
        multiplier_error=column("multipliers"),
        local_error=column("local_state"),
        local_multiplier_error=column("local_multipliers"),
        local_reaction_error=column("local_reaction"),
        local_midpoint_error=column("local_midpoint"),
        residual=column("residual"),
        residual_eps=column("residual_eps"),
        energy_error=column("energy"),
        failed=column("failed"),
        fits={**fits, "global_state": Fit.read(state)},
        p=order.p,
        s=order.s,
        floor=order.floor,
        reference=order.reference,
        keeps_D=bool(order.keeps_D),
        keeps_D_eps=bool(order.keeps_D_eps),
        holds={1: True, 0: False}.get(order.holds),
        text=_lib.string(order.text),
    )


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
    tolerance: float = 1e-14,
    progress: bool | Callable[[int, int], Any] = False,
) -> Studies:
    """Measure the order of several schemes on one system.

    Parameters
    ----------
    system : System
    schemes : Scheme, str or float, or iterable of them, optional
        Default: every named scheme.
    initial : {"D", "D_eps", "project", "shift"}, optional
        How runs with kept nodes start.  Default: "D_eps"; schemes with moved nodes need none.
    progress : bool or callable, optional
        True: a bar of tqdm.  A function is called as ``progress(done, total)`` with numbers of
        schemes.
    q0, v0, t_end, t0, steps, tolerance
        As in `convergence`; the default of t_end is that of the highest order, for all schemes.

    Returns
    -------
    Studies
        In the order of ``schemes``.

    Raises
    ------
    ValueError, dalembert.DalembertError
        As `convergence`.

    Examples
    --------
    >>> import dalembert as dal
    >>> found = dal.studies(dal.systems.particle(), ["midpoint", "leapfrog"])
    >>> found.holds
    True
    """
    if schemes is None:
        schemes = named_schemes()
    elif isinstance(schemes, str) or not isinstance(schemes, Iterable):
        schemes = [schemes]
    records = [Scheme.of(scheme) for scheme in schemes]
    # The highest order first: it has the longest default interval.
    places = sorted(range(len(records)), key=lambda i: -records[i].order)
    found: dict[int, Study] = {}
    with extras.progress(progress, len(records), "scheme") as show:
        for i in places:
            found[i] = convergence(
                system,
                records[i],
                q0,
                v0,
                t_end=t_end,
                t0=t0,
                steps=steps,
                initial=(initial or "D_eps") if records[i].nodes == "kept" else None,
                tolerance=tolerance,
            )
            t_end = found[i].t_end
            show(len(found))
    return Studies(found[i] for i in range(len(records)))


def _default_duration(order: int, probe: Callable[..., Study]) -> int:
    """Return the shortest interval over which errors of this order tell it, 1 if none does."""
    duration = 1
    while order > 2 and duration <= LONGEST:
        tried = probe(duration, COARSE)
        clear = tried.steps[counts(tried.local_error, tried.floor)]
        if len(clear) >= 3 and clear[-1] >= 2 * clear[0]:
            return duration
        duration *= 2
    return 1


def _default_steps(order: int, duration: float, probe: Callable[..., Study]) -> list[int]:
    """Choose numbers of steps whose errors tell the order.

    One-step errors h^(p+1) have to stand clear of the floor, with h as small as that allows: they
    are a power of h only in the limit.  Up to order 2 any small h will do.  For a higher order
    ``probe`` studies some steps over about a unit of time, and some over all of it, and the finest
    over a factor of two are taken.  The reactions, whose order is low whatever p is, need the small
    h too: their errors c1 h + c2 h^2 may change their sign where h is not (the core fits the finer
    half).
    """
    units = max(1, round(abs(duration)))
    if order <= 2:
        return [count * units for count in FINE]
    tried = probe(duration / units, COARSE)
    longer = {math.ceil(units / k) for k in COARSE}
    whole = tried if units == 1 else probe(duration, sorted({*longer, *COARSE}))

    def above_floor(study: Study) -> list[int]:
        return [int(count) for count in study.steps[counts(study.local_error, whole.floor)]]

    clear = sorted({*above_floor(whole), *(count * units for count in above_floor(tried))})
    finest = [count for count in clear if 2 * count >= clear[-1]]
    chosen = clear[-max(len(finest), 3) :] or [count * units for count in COARSE[:3]]
    if chosen[-1] < 2 * chosen[0]:
        chosen = clear[-len(chosen) - 1 :]
    return sorted({*chosen, *(count * units for count in FINE)})


def _counts(steps: Iterable[int]) -> list[int]:
    try:
        found = [arguments.integer(count, f"steps[{i}]", 1) for i, count in enumerate(steps)]
    except TypeError:
        raise ValueError(f"steps = {steps!r}: expected several numbers of steps") from None
    if not found:
        raise ValueError("steps is empty: expected numbers of steps")
    return found
