"""A recommended scheme and step, found by trial runs."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import geometry
from ..core import Array, DalembertError, arguments, require_system
from ..core.documentation import Common
from ..run import Scheme, Solution, integrate
from ..run.integration import quietly
from ..system import System

SECONDS = 0.02  # of the first try, which says how much of the motion can be looked at
FEWEST = 32  # steps in it
LEAST, MOST = 1e-13, 0.1  # what can be asked for
ATTEMPTS = 5  # of a scheme, to find its step
MARGIN = 0.5  # of the accuracy: what is aimed at
ENOUGH = 0.1  # an error below that part of the accuracy has too short a step
WORK = 20.0  # a scheme that needs so many times the work of the cheapest so far is given up,
LONGEST = 0.2  # and one that needs so many seconds to be tried
GROWTH = 3.0  # the largest power of the time with which regular motions lose accuracy
ROWS, MOST_ROWS = 100, 10**5  # of the run that is recommended, at least and at most
DRIFT = 2.0  # that of phases where the energy drifts, as it does with controlled steps


@dataclass(frozen=True)
class Tried:
    """A scheme and its trial run.

    Attributes
    ----------
    scheme : str
    h : float or "auto"
        At most ``abs(t_end - t0) / 100`` if it is a number.
    tolerance : float or None
        Tolerance of "auto", "reference" or "taylor".
    steps : int
        Number of steps to t_end.
    error : float
        Expected error of the state at t_end, relative to ``1 + abs(x_i)``, for this step; NaN if
        every run failed.  It is never below the error of the reference solution.
    seconds : float
        Expected run time.
    h_max : float or None
        Longest step of "auto"; None if 100 steps or more are made without it.
    """

    scheme: str
    h: float | str
    tolerance: float | None
    steps: int
    error: float
    seconds: float
    h_max: float | None = None

    @property
    def how(self) -> str:
        """The scheme and its step, in words."""
        step = f"h = {self.h:.4g}" if isinstance(self.h, float) else f"h = {self.h!r}"
        if self.tolerance is not None:
            step += f", tolerance = {self.tolerance:.1g}"
        if self.h_max is not None:
            step += f", h_max = {self.h_max:.4g}"
        return f"{self.scheme}, {step}"


@dataclass(frozen=True)
class Recommendation:
    """The result of `recommend`.

    Attributes
    ----------
    arguments : dict
        Arguments of `integrate`: ``dal.integrate(system, q0, v0, **found.arguments)``.
    scheme : str
    h : float or "auto"
    error : float
        Expected error of the state at t_end, relative to ``1 + abs(x_i)``.
    seconds : float
        Expected run time.
    why : str
        The reasons for the choice.
    tried : tuple of Tried
        All trials, the best first.
    """

    arguments: dict[str, Any]
    scheme: str
    h: float | str
    error: float
    seconds: float
    why: str
    tried: tuple[Tried, ...]

    def __repr__(self) -> str:
        lines = [f"<{self.tried[0].how}: error {self.error:.0e}, {_time(self.seconds)}", self.why]
        width = max(len(one.how) for one in self.tried)
        for one in self.tried:
            error = "not reached" if math.isnan(one.error) else f"error {one.error:.0e}"
            lines.append(f"  {one.how:{width}}  {error}, {_time(one.seconds)}")
        return "\n".join(lines) + ">"


def _time(seconds: float) -> str:
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.2g} {unit}"
    return f"{seconds * 1e6:.0f} us"


@Common("ValueError", "Recommendation")
def recommend(
    system: System,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    *,
    t_end: float,
    accuracy: float = 1e-6,
    t0: float = 0.0,
    inputs: Any = None,
) -> Recommendation:
    """Find the scheme and step that reach an accuracy in the shortest run time.

    The function compares trial runs with the reference flow, for some hundred milliseconds in all.
    If t_end is too far, the runs end earlier, and times and errors are extrapolated.  Errors are
    assumed to grow with the power of time observed in the trial; for variable steps at least with
    its square.  Changes of the motion after the trial are not taken into account.

    No step is longer than ``abs(t_end - t0) / 100``, so that the run stores at least 100 states
    after the first.  Errors and times are measured with the limited steps; the error can therefore
    be far below the accuracy.

    Parameters
    ----------
    t_end : float
        End time.
    t0 : float, optional
        Initial time, default 0.
    accuracy : float, optional
        Admissible error of the state at t_end, relative to ``1 + abs(x_i)``, in [1e-13, 0.1];
        default 1e-6.
    inputs : array_like, shape (k,), or mapping, optional
        Inputs of a system that has k of them, constant over the whole run.

    Raises
    ------
    ValueError
        If an argument is out of range, or no trial reaches the accuracy.  The message then has the
        trial with the smallest error.
    NotOnConstraintError, SingularError, ConvergenceError, DomainError
        If the trial runs cannot follow the motion.

    Examples
    --------
    >>> import dalembert as dal
    >>> system = dal.systems.knife_edge()
    >>> found = dal.recommend(system, t_end=50, accuracy=1e-6)
    >>> run = dal.integrate(system, **found.arguments)
    >>> q = system.exact(50)[0]
    >>> bool((abs(run.q[-1] - q) < 1e-6 * (1 + abs(q))).all())
    True
    """
    require_system(system)
    t0, t_end = arguments.number(t0, "t0"), arguments.number(t_end, "t_end")
    if t_end == t0:
        raise ValueError(f"t_end = {t_end!r}: expected a time other than t0 = {t0!r}")
    accuracy = arguments.number(accuracy, "accuracy")
    if not LEAST <= accuracy <= MOST:
        raise ValueError(f"accuracy = {accuracy!r}: expected {LEAST:g} to {MOST:g}")
    if callable(inputs):
        raise ValueError(f"inputs = {inputs!r}: expected numbers, constant over the whole run")
    x0 = geometry.initial_state(system, q0, v0)
    with quietly():
        pilot = _Pilot(system, x0, t0, t_end, inputs)
        found = [_with_stride(one, t_end - t0) for one in _try_all(pilot, accuracy)]
    tried = sorted(found, key=lambda one: _rank(one, accuracy))
    best = tried[0]
    if not best.error <= accuracy:
        raise ValueError(
            f"accuracy = {accuracy:g}: no trial reached it at t = {t_end:g}; the smallest "
            f"error is that of {best.how}, {best.error:.0e}{pilot.doubt}"
        )
    given: dict[str, Any] = {"scheme": best.scheme, "h": best.h, "t_end": t_end}
    if _stride(best) > 1:
        given["stride"] = _stride(best)
    if best.h_max is not None:
        given["h_max"] = best.h_max
    if t0 != 0.0:
        given["t0"] = t0
    if best.tolerance is not None:
        given["tolerance"] = best.tolerance
    return Recommendation(
        given, best.scheme, best.h, best.error, best.seconds, _why(pilot, tried, accuracy),
        tuple(tried),
    )  # fmt: skip


def _with_stride(one: Tried, span: float) -> Tried:
    """Return a trial whose number of fixed steps is a multiple of the stride."""
    if one.steps == 0 or one.tolerance is not None:
        return one
    stride = _stride(one)
    steps = stride * math.ceil(one.steps / stride)
    return replace(one, h=span / steps, steps=steps)


def _stride(one: Tried) -> int:
    """Return the stride for at most MOST_ROWS stored states."""
    return 1 if Scheme.find(one.scheme).is_flow else math.ceil(one.steps / MOST_ROWS)


def _rank(one: Tried, accuracy: float) -> tuple[bool, float]:
    """Return the sort key: accurate trials first by their time, then the others by their error."""
    if one.error <= accuracy:
        return False, one.seconds
    return True, math.inf if math.isnan(one.error) else one.error


def _why(pilot: _Pilot, tried: list[Tried], accuracy: float) -> str:
    """Return the reasons for the first trial, in words."""
    best = tried[0]
    accurate = [one for one in tried if one.error <= accuracy]
    words = [f"It is the fastest of {len(accurate)} that reach {accuracy:g}"]
    if len(accurate) > 1:
        words.append(f"; the next takes {accurate[1].seconds / best.seconds:.2g} times as long")
    words.append(".")
    fewest = math.ceil(pilot.fewest / pilot.part)
    if any(one.h_max is not None or one.steps == fewest for one in tried):
        words.append(
            f" Steps are at most |t_end - t0| / {ROWS} = {pilot.longest:.4g} long, so that a run "
            "stores enough states for a plot."
        )
    if pilot.part < 1.0:
        words.append(
            f" The trials ended at t = {pilot.end:g} and were extrapolated: errors grow like "
            f"t^{pilot.power(best.tolerance):.1f}{pilot.doubt}."
        )
        if not pilot.system.is_forced and best.h == "auto":
            words.append(
                " Over long times, fixed steps keep the energy of a reversible motion in a "
                "band; these variable steps do not."
            )
    return "".join(words)


class _Pilot:
    """The part of the motion used for trial runs, and its reference solution."""

    def __init__(self, system: System, x0: Array, t0: float, t_end: float, inputs: Any) -> None:
        self.system, self.x0, self.t0, self.t_end, self.inputs = system, x0, t0, t_end, inputs
        base = self.base = Scheme.usual(system).name
        compiled = [Scheme.find(name)._stepped(system) for name in (base, "taylor")]
        self.has_series = compiled[1] is not system
        begin = time.thread_time()
        first = self.run(
            f"{base}-kl8", t_end, h="auto", tolerance=1e-8,
            observer=lambda step, *_: step >= FEWEST and time.thread_time() - begin > SECONDS,
        )  # fmt: skip
        self.end = float(first.t[-1])
        self.part = (self.end - t0) / (t_end - t0)
        self.longest = abs(t_end - t0) / ROWS
        self.fewest = math.ceil(ROWS * self.part)  # steps of fixed size
        self.h = float(np.median(np.abs(np.diff(first.t))))
        # a quarter, a half, and the whole
        quarter = (self.end - t0) / 4
        exact = self.run("reference", self.end, h=quarter, tolerance=1e-14)
        self.exact = exact.x[[1, 2, 4]]
        again = self.run("reference", self.end, h=quarter, tolerance=1e-13)
        self.accuracy = float(self._errors(again)[2])  # what cannot be seen
        self.growth = self._growth(first)

    @property
    def doubt(self) -> str:
        """A reservation about the extrapolation, or ""."""
        if self.growth >= GROWTH:
            return (
                ", or faster, because the motion may be chaotic; then no scheme is accurate "
                "for long"
            )
        return ""

    def run(self, scheme: Any, end: float, **how: Any) -> Solution:
        """Return a run from the initial data."""
        q0, v0 = np.split(self.x0, 2)
        how.setdefault("h", 1.0)
        return integrate(  # its own errors are known here
            self.system, scheme, q0, v0, t0=self.t0, t_end=end, inputs=self.inputs,
            check_h=False, **how,
        )  # fmt: skip

    def _errors(self, run: Solution) -> Array:
        """Return the errors at a quarter, a half and the whole, relative to ``1 + abs(x_i)``."""
        x = run.x[[-4, -3, -1]] if len(run.x) > 3 else run.x[[-1, -1, -1]]
        return (np.abs(x - self.exact) / (1.0 + np.abs(self.exact))).max(axis=1)

    def _growth(self, first: Solution) -> float:
        """Return the power of time with which errors grow."""
        if self.part == 1.0:
            return 1.0
        quarter = (self.end - self.t0) / 4
        coarse = self.run(
            f"{self.base}-kl8", self.end, h="auto", tolerance=1e-5,
            t_eval=self.t0 + quarter * np.arange(1, 5),
        )  # fmt: skip
        errors = self._errors(coarse)
        power = math.log2(max(errors[2], 1e-15) / max(errors[1], 1e-15))
        return min(max(power, 1.0), GROWTH)

    def power(self, tolerance: float | None) -> float:
        """Return the power of time with which errors of a scheme are expected to grow."""
        return self.growth if tolerance is None else max(self.growth, DRIFT)

    def error(self, run: Solution, tolerance: float | None = None) -> float:
        """Return the expected error at t_end of a run up to the end of the pilot."""
        here = (np.abs(run.x[-1] - self.exact[2]) / (1.0 + np.abs(self.exact[2]))).max()
        return max(float(here), self.accuracy) * self.part ** -self.power(tolerance)


def _try_all(pilot: _Pilot, accuracy: float) -> Iterator[Tried]:
    """Yield a trial of each scheme with the longest step that seems accurate enough."""
    base, cheapest = pilot.base, math.inf
    for name in ("bm6", f"{base}-kl8", f"{base}-kl6", "bm4", f"{base}-ss10", base):
        one = _with_step(pilot, Scheme.find(name), accuracy, WORK * cheapest)
        if one.error <= accuracy:
            cheapest = min(cheapest, one.seconds)
        yield one
    for name in ("bm6", f"{base}-kl8"):
        yield _with_tolerance(pilot, name, "auto", accuracy)
    span = pilot.t_end - pilot.t0
    rows = math.ceil(abs(span) / pilot.h)
    for name in ("reference", *["taylor"] * pilot.has_series):
        yield _with_tolerance(pilot, name, span / min(max(rows, ROWS), MOST_ROWS), accuracy)


def _with_step(pilot: _Pilot, scheme: Scheme, accuracy: float, most: float) -> Tried:
    """Return a trial of a scheme with the longest fixed step that seems accurate enough."""
    span = pilot.end - pilot.t0
    h = pilot.h * len(scheme.substeps) / 34
    found, failed = list[Tried](), Tried(scheme.name, math.nan, None, 0, math.nan, math.inf)
    for _ in range(ATTEMPTS):
        steps = max(pilot.fewest, math.ceil(abs(span) / h))
        begin = time.thread_time()
        try:
            run = pilot.run(scheme, pilot.end, h=span / steps, stride=steps)
        except DalembertError:
            h /= 3.0
            continue
        spent = time.thread_time() - begin  # which other processes leave alone
        seconds = spent / pilot.part
        count = math.ceil(steps / pilot.part)
        whole = (pilot.t_end - pilot.t0) / count
        error = pilot.error(run)
        found.append(Tried(scheme.name, whole, None, count, error, seconds))
        if ENOUGH * accuracy <= error <= accuracy:
            break
        if steps == pilot.fewest and error <= accuracy:
            break
        factor = (MARGIN * accuracy / max(error, 1e-16)) ** (1.0 / scheme.order)
        factor = min(max(factor, 0.05), 4.0)
        h = abs(span) / steps * factor
        if seconds / factor > most or spent / factor > LONGEST:
            break
    return min([*found, failed], key=lambda one: _rank(one, accuracy))


def _with_tolerance(pilot: _Pilot, name: str, h: Any, accuracy: float) -> Tried:
    """Return a trial with the largest tolerance that seems small enough."""
    least = 1e-14  # below which all is roundoff
    most = MOST if pilot.part == 1.0 else accuracy  # what is to come may need shorter steps
    step: Any = h
    if h != "auto":
        span = pilot.end - pilot.t0
        step = span / math.ceil(span / h)
    tolerance = max(least, accuracy * pilot.part ** pilot.power(least))
    h_max = None
    found, failed = list[Tried](), Tried(name, h, tolerance, 0, math.nan, math.inf)
    for _ in range(ATTEMPTS):
        # Of "auto" only the last state is stored.
        given = {"stride": 2**40, "h_max": h_max} if h == "auto" else {}
        begin = time.thread_time()
        try:
            run = pilot.run(name, pilot.end, h=step, tolerance=tolerance, **given)
        except DalembertError:
            break
        seconds = (time.thread_time() - begin) / pilot.part
        error = pilot.error(run, tolerance)
        steps = math.ceil(run.stats.steps / pilot.part)
        if h == "auto" and h_max is None and steps < ROWS:
            h_max = pilot.longest
            continue
        found.append(Tried(name, h, tolerance, steps, error, seconds, h_max))
        if ENOUGH * accuracy <= error <= accuracy or (tolerance == least and error > accuracy):
            break
        if h_max is not None and error <= accuracy:  # a larger tolerance hardly changes the steps
            break
        factor = MARGIN * accuracy / max(error, 1e-16)
        tolerance = min(max(tolerance * min(max(factor, 1e-3), 1e3), least), most)
    return min([*found, failed], key=lambda one: _rank(one, accuracy))
