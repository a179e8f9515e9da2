"""The step sizes of a run: fixed, error-controlled or reversible."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..core import arguments
from .laws import is_control

MOST = 2**62  # steps, where nobody knows how many they will be


@dataclass(frozen=True)
class Steps:
    """The steps from t0 to t_end."""

    t0: float
    t_end: float
    h: float  # NaN if the size varies
    count: int  # number of steps, or its limit if the size varies
    control: Mapping[str, Any]  # "h", the word for it, and its numbers; empty for fixed size

    @classmethod
    def of(cls, asked: Any) -> Steps:
        """Return the steps that the options of a run define."""
        t0, t_end, control = asked.t0, asked.t_end, asked.control
        if not control:
            h = arguments.step_size(asked.h, t0)
            count = number_of_steps(t0, h, t_end, asked.steps)
            return cls(t0, t0 + count * h, h, count, {})
        if t_end is None:
            raise ValueError(
                f"t_end is missing: with h = {asked.h!r} the number of steps is not known"
            )
        if abs(t_end - t0) / control.get("h_max", math.inf) > 2.0**53:  # steps of roundoff
            raise ValueError(f"h_max = {asked.h_max} is too small for t_end - t0 = {t_end - t0:g}")
        return cls(t0, t_end, math.nan, MOST, control)

    @property
    def varies(self) -> bool:
        """Whether the step size varies."""
        return bool(self.control)

    @property
    def direction(self) -> float:
        """1 if time increases along the run, else -1."""
        return math.copysign(1.0, self.t_end - self.t0 if self.varies else self.h)

    @property
    def first(self) -> float:
        """The initial h for C; if it is infinite, C determines the first step."""
        return self.direction * math.inf if self.varies else self.h

    @property
    def how(self) -> str:
        """The step size, or its control, in words."""
        return how(self.h, self.control)

    def stride(self, given: int | None) -> int:
        """Return the stride, default 1; raise ValueError unless it divides the number of steps."""
        stride, count = 1 if given is None else given, self.count
        if not self.varies and count % stride:
            less = count - count % stride
            raise ValueError(
                f"steps = {count}: expected a multiple of stride = {stride}, {less} or "
                f"{less + stride}"
            )
        return stride

    def hold(self, given: Any, inputs: Any) -> float:
        """Return the number of steps, or the time, for which a row of inputs applies."""
        if not self.varies:
            kind = "a whole number of steps"
            return 1 if given is None else arguments.integer(given, "hold", 1, kind=kind)
        if given is None and is_control(inputs):
            raise ValueError(
                f"hold is missing: with h = {self.control['h']!r} give the time for which the "
                "inputs that the controller returns apply"
            )
        if given is None:
            return abs(self.t_end - self.t0) or 1.0
        time = arguments.number(given, "hold")
        if not time > 0.0:
            raise ValueError(f"hold = {time!r}: expected a positive time")
        return time

    def holds(self, hold: float) -> int:
        """Return the number of rows of inputs."""
        if not self.varies:
            return -(-self.count // int(hold))
        rows = abs(self.t_end - self.t0) / hold
        if rows > MOST:
            raise ValueError(f"hold = {hold!r} is too small for {abs(self.t_end - self.t0):g}")
        near = round(rows)
        return near if abs(rows - near) <= 1e-9 * rows else math.ceil(rows)

    @property
    def progress(self) -> tuple[Any, str]:
        """The total for the progress, and its unit."""
        return (abs(self.t_end - self.t0), "t") if self.varies else (self.count, "step")


def how(h: float, control: Mapping[str, Any]) -> str:
    """Return the step size, or its control, in words."""
    if not control:
        return f"h = {h:g}"
    numbers = [f"{key} = {x:g}" for key, x in control.items() if key != "h"]
    return ", ".join([f"h = {control['h']!r}", *numbers])


def number_of_steps(t0: float, h: float, t_end: float | None, steps: int | None) -> int:
    """Return the number of steps; raise ValueError if it is not an integer."""
    if (t_end is None) == (steps is None):
        given = "none" if steps is None else "both"
        raise ValueError(f"t_end and steps: expected one of them, got {given}")
    if t_end is None:
        steps = arguments.integer(steps, "steps", 0)
        arguments.step_size(h, t0 + steps * h)
        return steps
    t_end = arguments.number(t_end, "t_end")
    ratio = (t_end - t0) / h
    if ratio < 0.0:
        raise ValueError(
            f"t_end = {t_end:g}: expected a time after t0 = {t0:g} in the direction of h = {h:g}"
        )
    if not ratio < 2**63:
        raise ValueError(f"h = {h:g} is too small for t_end - t0 = {t_end - t0:g}")
    arguments.step_size(h, t_end)
    steps = round(ratio)
    is_none = steps == 0 and abs(t_end - t0) > 2e-15 * max(abs(t0), abs(t_end))
    if abs(ratio - steps) > 1e-9 * max(1.0, ratio) or is_none:
        counts = [k for k in (math.floor(ratio), math.ceil(ratio)) if k > 0]
        ends = [_shortest(t0 + k * h, max(abs(t0), abs(t_end))) for k in counts]
        sizes = [_shortest((t_end - t0) / k, abs(h)) for k in counts[::-1]]
        raise ValueError(
            f"t_end = {t_end!r} is {ratio:.10g} steps of h = {h!r} from t0 = {t0!r}: expected "
            f"a whole number; take t_end = {' or '.join(ends)}, or h = {' or '.join(sizes)}"
        )
    return steps


def _shortest(x: float, scale: float) -> str:
    """Return the shortest decimal that differs from x by roundoff of numbers of this scale."""
    rounded = (float(f"{x:.{digits}g}") for digits in range(1, 18))
    return repr(next(each for each in rounded if abs(each - x) <= 2.0**-50 * scale))
