"""Steps with forces and with M(q), against the same step with a potential and constant mass.

Usage: ``python bench_forces.py``.  Minima over interleaved repetitions, ratios within one run.
Fails if a bar is missed.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field

import sympy
from sympy import Rational, cos, sin

import dalembert as dal

REPETITIONS, STEPS, H = 40, 10_000, 0.01


@dataclass
class Case:
    system: dal.System
    scheme: str
    inputs: list[float] | None = None
    start: tuple[list[float], list[float]] | None = None
    least: float = field(default=float("inf"), init=False)

    def run(self) -> None:
        """Keep the least time of a step, in ns."""
        q0, v0 = self.start or (self.system.q0, self.system.v0)
        start = time.perf_counter()
        dal.integrate(self.system, self.scheme, q0, v0, h=H, steps=STEPS, stride=STEPS,
                      inputs=self.inputs, check_h=False)
        self.least = min(self.least, 1e9 * (time.perf_counter() - start) / STEPS)


def sleigh(V: sympy.Expr | int = 0, **force: object) -> dal.System:
    x, y, theta = dal.coordinates("x y theta")
    L = (x.d**2 + y.d**2) / 2 + theta.d**2 / 4 - V
    row = -sin(theta) * x.d + cos(theta) * y.d - Rational(3, 10) * theta.d
    return dal.System.from_sympy(L, [row], [x, y, theta], q0=[0, 0, 0], v0=[1, 0.15, 0.5], **force)


def sleigh_contact() -> dal.System:
    """By the point of the blade, so that M depends on theta."""
    x, y, theta = dal.coordinates("x y theta")
    a = Rational(3, 10)
    centre = x.d - a * theta.d * sin(theta), y.d + a * theta.d * cos(theta)
    L = (centre[0] ** 2 + centre[1] ** 2) / 2 + theta.d**2 / 4
    row = -sin(theta) * x.d + cos(theta) * y.d
    return dal.System.from_sympy(L, [row], [x, y, theta], q0=[0, 0, 0], v0=[1, 0, 0.5])


def main() -> int:
    x, y, theta = dal.coordinates("x y theta")
    u = sympy.Symbol("u")
    V = (x**2 + 2 * y**2) / 2 + 1 - cos(theta)
    pull = {x: -x, y: -2 * y, theta: -sin(theta)}
    drag = {x: -x.d / 10, y: -y.d / 10, theta: -theta.d / 10}
    push, pushed = {theta: u}, {theta: Rational(1, 10)}
    systems = {
        "free": sleigh(), "V": sleigh(V), "f = -V_q": sleigh(force=pull),
        "V, f(v)": sleigh(V, force=drag), "f constant": sleigh(force=pushed),
        "f an input": sleigh(force=push, inputs=[u]), "M(q)": sleigh_contact(),
    }  # fmt: skip
    cases = {
        (name, scheme): Case(system, scheme, [0.1] if "input" in name else None)
        for name, system in systems.items() for scheme in ("leapfrog", "midpoint")
    }  # fmt: skip
    for _ in range(REPETITIONS):
        for case in cases.values():
            case.run()
    for (name, scheme), case in cases.items():
        print(f"  {f'sleigh, {name}, {scheme}':44} {case.least:8.1f} ns")
    kept = True
    for above, below, scheme, bar in (
        ("f = -V_q", "V", "leapfrog", 1.1), ("f = -V_q", "V", "midpoint", 1.1),
        ("V, f(v)", "V", "leapfrog", 1.7), ("V, f(v)", "V", "midpoint", 1.7),
        ("f an input", "f constant", "leapfrog", 1.1),
        ("f an input", "f constant", "midpoint", 1.1), ("M(q)", "free", "midpoint", 2.5),
    ):  # fmt: skip
        ratio = cases[above, scheme].least / cases[below, scheme].least
        kept &= ratio <= bar
        words = f"{above} / {below}, {scheme}"
        print(f"  {words:44} {ratio:8.2f}   <= {bar:<4g} {'ok' if ratio <= bar else 'MISSED'}")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
