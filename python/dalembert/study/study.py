"""The results of step-size refinement: the numbers of `dal_order_study`, and the verdict."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from .. import core
from ..core import Array, ffi, lib
from ..run import Scheme
from ..system import System


def order(x: float) -> str:
    """Return an order with two decimals, "-" if it is unknown."""
    return "-" if not math.isfinite(x) else f"{round(x, 2) + 0.0:.2f}"  # no -0.00


def worst(values: Array) -> float:
    """Return the largest value that is not NaN."""
    return max((float(x) for x in values if math.isfinite(x)), default=math.nan)


def _listing(names: list[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


# The arrays of a study, and what they are in a dal_order_point.
COLUMNS = {
    "h": "h",
    **{f"{x}_error": x for x in ("q", "v", "energy")},
    "multiplier_error": "multipliers",
    "local_error": "local_state",
    "local_multiplier_error": "local_multipliers",
    **{f"{x}_error": x for x in ("local_reaction", "local_midpoint")},
    **{x: x for x in ("residual", "residual_eps", "failed")},
}


@dataclass(frozen=True)
class Fit:
    """A fitted order: errors proportional to ``h**slope`` over the points that count.

    Attributes
    ----------
    slope : float
        NaN if fewer than three points count.
    points : int
        Number of errors that counted, those above 100 times the floor.  At ``t_end`` the floor is
        higher for runs of many steps, whose roundoff accumulates.
    exact : bool
        True if every error is at the level of roundoff, so there is no slope to fit.  Errors of an
        order below the promise would be visible.
    counted : tuple of bool
        Which errors counted.
    """

    slope: float
    points: int
    exact: bool
    counted: tuple[bool, ...]

    @classmethod
    def read(cls, fit: Any, counted: Iterable[bool]) -> Fit:
        """Return the fit of a ``dal_fit``."""
        return cls(float(fit.slope), int(fit.points), bool(fit.exact), tuple(counted))

    @classmethod
    def of(cls, h: Array, errors: Array, floor: float) -> Fit:
        """Return the fit of those errors over step sizes that exceed the floor."""
        fit, counted = ffi.new("dal_fit *"), ffi.new("unsigned char[]", len(h))
        lib.dal_fit_order(len(h), core.pointer(h), core.pointer(errors), floor, fit, counted)
        return cls.read(fit, map(bool, counted))

    def order(self, loss: int = 0) -> str:
        """Return ``slope - loss`` in words: a number, "exact", or "-" if unknown."""
        if self.exact:
            return "exact"
        return order(self.slope - loss)


@dataclass(frozen=True, eq=False, repr=False)
class Study:
    """The results of step-size refinement of one scheme on one system.

    Arrays have shape ``(k,)``, one entry for each step size.  An error is the largest component of
    a difference, in the user's units; it is NaN if the run failed.

    Attributes
    ----------
    system, scheme : System, Scheme
    q0, v0 : ndarray, shape (n,)
        Initial data in D.
    t0, t_end : float
        Interval of time.
    initial : str or None
        The meaning of the initial data for kept nodes.
    steps : ndarray of int
        Numbers of steps, in the given order.
    h : ndarray
        Step sizes ``(t_end - t0) / steps``.
    q_error, v_error, multiplier_error : ndarray
        Errors at ``t_end``; the multipliers are those of the formula lambda(q, v).
    local_error, local_multiplier_error : ndarray
        Errors of (q, v) and of lambda(q, v) after one step from exact data.
    local_reaction_error, local_midpoint_error : ndarray
        Errors of the scheme's own multiplier of that step, compared with lambda at the end and at
        the middle of the step.
    residual, residual_eps : ndarray
        Worst relative residual of D and of D_eps over the run.  The second is NaN for a scheme with
        several sub-steps, which has no D_eps.
    energy_error : ndarray
        ``max |E - E0| / max(|E0|, 1)`` over the run.
    failed : ndarray of int
        Status of each run, 0 for success.
    fits : dict of str to Fit
        Fits by name.  One-step errors: "state", "multipliers", "reaction", "midpoint".  Errors at
        ``t_end``: "global_q", "global_v", "global_multipliers", "global_state".
    p, s : float
        Measured order of (q, v) and of the scheme's own multipliers, slopes of the one-step
        errors minus 1.
    floor : float
        Errors at ``t_end`` below ``100 * floor`` do not count.
    reference : float
        Accuracy of the reference solution, 0 for an exact one.
    keeps_D, keeps_D_eps : bool
        Whether the residual stayed at roundoff after every step of every run.
    holds : bool or None
        The verdict; None if nothing is promised or the errors are inconclusive.
    measurable : bool
        False if they are inconclusive because smaller steps would reduce them to roundoff.  The
        promised order cannot be measured in double precision from these data over this interval.
    text : str
        The verdict in words.
    """

    system: System
    scheme: Scheme
    q0: Array
    v0: Array
    t0: float
    t_end: float
    initial: str | None
    steps: NDArray[np.int64]
    h: Array
    q_error: Array
    v_error: Array
    multiplier_error: Array
    local_error: Array
    local_multiplier_error: Array
    local_reaction_error: Array
    local_midpoint_error: Array
    residual: Array
    residual_eps: Array
    energy_error: Array
    failed: NDArray[np.int64]
    fits: dict[str, Fit]
    p: float
    s: float
    floor: float
    reference: float
    keeps_D: bool
    keeps_D_eps: bool
    holds: bool | None
    measurable: bool
    text: str

    @property
    def state_error(self) -> Array:
        """Error of (q, v) at ``t_end``, the larger of the two, shape (k,)."""
        return np.maximum(self.q_error, self.v_error)

    @property
    def q_orders(self) -> Array:
        """Local orders of ``q_error`` between neighbours, shape (k,).

        An entry is NaN if it is the first, or if an error is too close to roundoff to count.
        """
        return self._local_orders(self.q_error, "global_q")

    @property
    def v_orders(self) -> Array:
        """Local orders of ``v_error``, as for `q_orders`."""
        return self._local_orders(self.v_error, "global_v")

    @property
    def multiplier_orders(self) -> Array:
        """Local orders of ``multiplier_error``, as for `q_orders`."""
        return self._local_orders(self.multiplier_error, "global_multipliers")

    def _local_orders(self, error: Array, fit: str) -> Array:
        clear = np.where(self.fits[fit].counted, error, np.nan)
        orders = np.full(len(error), np.nan)
        orders[1:] = np.diff(np.log(clear)) / np.diff(np.log(np.abs(self.h)))
        return orders

    @property
    def promised(self) -> tuple[int, int]:
        """The (p, s) that the scheme promises for a step from this start.

        With kept nodes, a start in D jumps to D_eps in the first step, which costs one order of
        each.
        """
        jump = self.initial == "D" and self.scheme.shift(1.0) > 0.0
        return self.scheme.order - jump, self.scheme.multiplier_order - jump

    @property
    def promise(self) -> str:
        """The promised (p, s) in words; "nothing" for a scheme without a promise."""
        return "nothing" if self.scheme.order == 0 else str(self.promised)

    @property
    def keeps(self) -> str:
        """The set that the runs preserved to roundoff: "D", "D_eps", "D and D_eps" or "neither"."""
        kept = [
            name for name, is_kept in (("D", self.keeps_D), ("D_eps", self.keeps_D_eps)) if is_kept
        ]
        return " and ".join(kept) or "neither"

    @property
    def verdict(self) -> str:
        """The verdict in one or two words.

        One of "holds", "exact" (to roundoff), "fails", "no promise", "undecided" and "not
        measurable" (in double precision).
        """
        if not self.measurable:
            return "not measurable"
        if self.holds is None:
            return "no promise" if self.scheme.order == 0 else "undecided"
        if self.fits["state"].exact and self.fits["global_state"].exact and self.holds:
            return "exact"
        return "holds" if self.holds else "fails"

    def __repr__(self) -> str:
        return (
            f"<Study of {self.scheme.name} on {self.system.name}: p = {order(self.p)}, "
            f"s = {order(self.s)}, {self.verdict}>"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, strings and lists, ready for JSON.

        Numbers that are not finite become None.
        """
        computed = ("q_orders", "v_orders", "multiplier_orders", "verdict")
        names = [*(x.name for x in dataclasses.fields(self)), *computed]
        described = {
            "system": self.system.name,
            "parameters": self.system.parameters,
            "scheme": self.scheme.name,
            "nodes": self.scheme.nodes,
            "promised": dict(zip("ps", self.promised)),
            "fits": {key: dataclasses.asdict(fit) for key, fit in self.fits.items()},
        }
        return {
            key: _plain(x) for key, x in ({x: getattr(self, x) for x in names} | described).items()
        }


class Studies(Sequence[Study]):
    """Studies of several schemes on one system; a sequence of `Study`."""

    def __init__(self, items: Iterable[Study]) -> None:
        self._items = tuple(items)

    def __len__(self) -> int:
        return len(self._items)

    @overload
    def __getitem__(self, index: int) -> Study: ...

    @overload
    def __getitem__(self, index: slice) -> Studies: ...

    def __getitem__(self, index: int | slice) -> Study | Studies:
        if isinstance(index, slice):
            return Studies(self._items[index])
        return self._items[index]

    @property
    def holds(self) -> bool | None:
        """False if a verdict fails, True if none fails and one holds, else None."""
        verdicts = {study.holds for study in self}
        return False if False in verdicts else True if True in verdicts else None

    def sentence(self) -> str:
        """Return the verdict of all studies in one sentence."""
        if not self:
            return "No scheme was studied."
        system = self[0].system.name
        failing = [study.scheme.name for study in self if study.holds is False]
        holding = [study for study in self if study.holds]
        undecided = [x.scheme.name for x in self if x.holds is None and x.measurable]
        hidden = [study.scheme.name for study in self if not study.measurable]
        rest = f"; no verdict on {_listing(undecided)}" if undecided else ""
        if hidden:
            rest += f"; the order of {_listing(hidden)} is not measurable in double precision"
        if failing:
            fail = "fails" if len(failing) == 1 else "fail"
            return (
                f"On {system}, {_listing(failing)} {fail}; {len(holding)} of {len(self)} "
                f"schemes hold{rest}."
            )
        if not holding:
            names = [study.scheme.name for study in self]
            return f"On {system} there is no verdict on {_listing(names)}{rest if hidden else ''}."
        size = max(worst(x.residual if x.keeps_D else x.residual_eps) for x in holding)
        if len(holding) == 1:
            return (
                f"On {system}, {holding[0].scheme.name} has its promised order and keeps its "
                f"constraint set to {size:.1e}{rest}."
            )
        who = "both" if len(holding) == 2 else f"all {len(holding)}" if not rest else len(holding)
        return (
            f"On {system}, {who} schemes have their promised order and keep their constraint "
            f"set to {size:.1e}{rest}."
        )

    def __repr__(self) -> str:
        return f"<Studies of {', '.join(study.scheme.name for study in self)}>"

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers, strings and lists, ready for JSON."""
        return {
            "version": core.version(),
            "holds": self.holds,
            "text": self.sentence(),
            "studies": [study.to_dict() for study in self],
        }


def _plain(x: Any) -> Any:
    """Return numbers, arrays and containers as JSON types; None for numbers that are not finite."""
    if isinstance(x, dict):
        return {key: _plain(value) for key, value in x.items()}
    if isinstance(x, np.ndarray):
        x = x.tolist()
    if isinstance(x, list | tuple):
        return [*map(_plain, x)]
    return None if isinstance(x, float) and not math.isfinite(x) else x
