"""How well the estimate of the error of a run tells an h that is too large, on random runs.

    ./dev shell python benchmarks/campaigns/step_errors.py --seed 1 --runs 1000 [--show]

It is not part of the test suites.  Run k of seed S is made from (S, k) alone.  The systems keep
their energy, lose it, are driven, or grow; they have 1 to 8 coordinates, no constraint or linear,
affine and nonlinear ones, a mass that is constant or not.  Schemes of order 1, 2, 4 and 6 make 50
to 20000 steps.  The motion is known from the adaptive flow, to 1e-11.

The error of a run is that of its last state: of each q relative to the way that it has gone, of
each v relative to its largest value; of all these the largest.  No size is less than a thousandth
of the largest of its kind.  Printed are how many runs with an error above 10 % are warned of, and
how many below 1 %; then steps that were made again; then the time with the estimate, relative to
that without.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import sympy as sp

import dalembert as dal

Draw = Callable[[np.random.Generator], tuple[dict[str, float], Any, Any]]
SCHEMES = {
    "constant": {
        1: ("explicit", "endpoint"), 2: ("leapfrog", "midpoint"),
        4: ("bm4", "leapfrog-suzuki4", "leapfrog-yoshida4"), 6: ("bm6", "leapfrog-kl6"),
    },
    "general": {
        1: ("explicit", "endpoint"), 2: ("midpoint",), 4: ("midpoint-suzuki4", "midpoint-yoshida4"),
        6: ("midpoint-kl6",),
    },
}  # fmt: skip
LENGTHS = {1: (-4, -1.2), 2: (-2.7, -0.3), 4: (-1.7, 0), 6: (-1.2, 0.3)}  # of steps, log10


def systems() -> dict[str, tuple[dal.System, Draw, str]]:
    """Return systems, with what draws parameters and initial data, and which schemes they take."""
    made: dict[str, tuple[dal.System, Draw, str]] = {}
    x, y, z, th = dal.coordinates("x y z theta")
    a, b, c, w = sp.symbols("a b c w", real=True)
    t = dal.time
    T2, T3 = (x.d**2 + y.d**2) / 2, (x.d**2 + y.d**2 + z.d**2) / 2

    def add(name: str, L: Any, draw: Draw, kind: str = "constant", phi: Any = (), **force: Any):
        used = [L, *phi, *force.values()]
        symbols = [p for p in (a, b, c, w) if any(sp.sympify(e).has(p) for e in used)]
        coordinates = {"x": x, "y": y}
        made[name] = (
            dal.System.from_sympy(
                L, phi, parameters=dict.fromkeys(symbols, 1.0), name=name,
                force={coordinates[k]: e for k, e in force.items()} or None,
            ), draw, kind,
        )  # fmt: skip

    add(
        "pendulum",
        x.d**2 / 2 + sp.cos(x),
        lambda r: ({}, [r.uniform(-2.8, 2.8)], [r.choice([0, r.uniform(-2.5, 2.5)])]),
    )
    add(
        "wells",
        x.d**2 / 2 + x**2 / 2 - x**4 / 4,
        lambda r: ({}, [r.uniform(0.05, 1.8)], [r.uniform(-0.5, 0.5)]),
    )
    add(
        "damped",
        T2 - x**2 / 2 - (y - x) ** 2 * 2 - a * x**4 / 4,
        lambda r: (
            {"a": r.uniform(0, 1), "c": 10 ** r.uniform(-3, 0.3)},
            r.uniform(-1, 1, 2),
            r.uniform(-1, 1, 2),
        ),
        "general",
        x=-c * x.d,
        y=-c * y.d,
    )
    add(
        "driven",
        x.d**2 / 2 - x**2 / 2 - a * x**4 / 4,
        lambda r: (
            {
                "a": r.choice([0, r.uniform(0, 1)]),
                "b": r.uniform(0, 2),
                "c": r.choice([1e-3, 10 ** r.uniform(-2, 0)]),
                "w": r.uniform(0.2, 3),
            },
            r.uniform(-1, 1, 1),
            r.uniform(-1, 1, 1),
        ),
        "general",
        x=-c * x.d + b * sp.cos(w * t),
    )
    add(
        "mathieu",
        T2 - (1 + c * sp.cos(w * t)) * x**2 / 2 - y**2,
        lambda r: (
            {"c": r.uniform(0, 0.4), "w": r.choice([2, r.uniform(1.5, 2.5)])},
            r.uniform(-1, 1, 2),
            r.uniform(-1, 1, 2),
        ),
    )
    add(
        "henon",
        T2 - (x**2 + y**2) / 2 - (x**2 * y - y**3 / 3),
        lambda r: ({}, r.uniform(-0.35, 0.35, 2), r.uniform(-0.3, 0.3, 2)),
    )
    add(
        "comet",
        T2 + 1 / sp.sqrt(x**2 + y**2 + sp.Rational(1, 100)),
        lambda r: ({}, [1, 0], [r.uniform(-0.2, 0.2), r.uniform(0.4, 1.2)]),
    )
    add(
        "saddle",
        T2 + a * x**2 / 2 - y**2 / 2,
        lambda r: ({"a": 10 ** r.uniform(-3, -1)}, r.uniform(-1, 1, 2), r.uniform(-1, 1, 2)),
    )
    add(
        "two pendulums",
        x.d**2 + y.d**2 / 2 + x.d * y.d * sp.cos(x - y) + 2 * sp.cos(x) + sp.cos(y),
        lambda r: ({}, r.uniform(-1, 1, 2) * r.choice([0.3, 1, 2]), [0, 0]),
        "general",
    )
    add(
        "spherical",
        (x.d**2 + sp.sin(x) ** 2 * y.d**2) / 2 - sp.cos(x),
        lambda r: ({}, [r.uniform(1.2, 2.5), 0], [r.uniform(-0.5, 0.5), r.uniform(0.4, 1.5)]),
        "general",
    )

    def blade(r: np.random.Generator) -> Any:
        angle, speed = r.uniform(0, 6), r.uniform(-1, 1)
        return (
            {"a": r.uniform(0, 0.6), "b": r.uniform(0, 1)},
            [r.uniform(-1, 1), 0, angle],
            [speed * np.cos(angle), speed * np.sin(angle), r.uniform(-1.5, 1.5)],
        )

    add(
        "blade",
        (x.d**2 + y.d**2 + th.d**2) / 2 - a * x - b * sp.cos(x),
        blade,
        phi=[sp.sin(th) * x.d - sp.cos(th) * y.d],
    )

    def in_space(r: np.random.Generator) -> Any:
        q, v, B = r.uniform(-1, 1, 3), r.uniform(-1, 1, 2), r.uniform(0, 0.5)
        return {"a": r.uniform(0, 1), "b": B}, q, [*v, q[1] * v[0] + B * np.sin(q[1])]

    add(
        "affine",
        T3 - (x**2 + 2 * y**2 + z**2) / 2 - a * z**4 / 4,
        in_space,
        phi=[z.d - y * x.d - b * sp.sin(y)],
    )

    def on_cone(r: np.random.Generator) -> Any:
        v = r.uniform(0.3, 1, 2)
        return (
            {"a": r.uniform(0.2, 1), "b": r.uniform(0, 0.2)},
            r.uniform(-1, 1, 3),
            [*v, np.hypot(*v)],
        )

    add(
        "cone",
        T3 - a * (x**2 + y**2) / 2 - b * z,
        on_cone,
        "general",
        phi=[x.d**2 + y.d**2 - z.d**2],
    )
    q = dal.coordinates(" ".join(f"q{i}" for i in range(8)))
    stretched = [q[0], *(q[i + 1] - q[i] for i in range(7)), q[7]]
    add(
        "chain",
        sum(u.d**2 for u in q) / 2 - sum(u**2 / 2 + a * u**4 / 4 for u in stretched),
        lambda r: (
            {"a": r.choice([0, r.uniform(0, 1)])},
            r.uniform(-1, 1, 8) * r.choice([0.3, 1]),
            r.uniform(-1, 1, 8),
        ),
    )

    def five(r: np.random.Generator) -> Any:
        p, v = r.uniform(-1, 1, 5), r.uniform(-1, 1, 3)
        return {"a": r.uniform(0, 1)}, p, [*v, np.cos(p[2]) * v[1], p[1] * v[0]]

    add(
        "five",
        sum(u.d**2 - (i + 1) * u**2 for i, u in enumerate(q[:5])) / 2 - a * q[0] ** 2 * q[3] ** 2,
        five,
        phi=[q[4].d - q[1] * q[0].d, q[3].d - sp.cos(q[2]) * q[1].d],
    )
    add(
        "relaxing",
        x.d**2 / 2 - x**2 / 2,
        lambda r: ({"c": 10 ** r.uniform(-2, 0.5)}, r.uniform(-2, 2, 1), r.uniform(-2, 2, 1)),
        "general",
        x=c * (1 - x**2) * x.d,
    )
    speed = sp.sqrt(x.d**2 + y.d**2)
    add(
        "drag",
        T2 - y,
        lambda r: ({"c": 10 ** r.uniform(-2, 0.5)}, [0, 0], r.uniform(0.1, 2, 2)),
        "general",
        x=-c * x.d * speed,
        y=-c * y.d * speed,
    )
    for name in (
        "rolling_disc",
        "two_wheeled_robot",
        "contact_oscillator",
        "chaotic",
        "roller_racer",
        "snakeboard",
        "sleigh_with_rotor",
        "ball_on_table",
        "genmass",
    ):
        own = getattr(dal.systems, name)()

        def near(r: np.random.Generator, own: dal.System = own) -> Any:
            p = own.q0 + 0.05 * r.normal(size=own.n)
            v = own.v0 * r.uniform(0.7, 1.3) + 0.1 * r.normal(size=own.n)
            return {}, p, own.project(p, v)

        simple = name in ("contact_oscillator", "chaotic")
        made[name] = own, near, "constant" if simple else "general"
    return made  # fmt: skip


def sizes(x: Any) -> Any:
    """Return the sizes of the numbers of a state, over a run."""
    n = x.shape[1] // 2
    ways, speeds = np.ptp(x[:, :n], axis=0), abs(x[:, n:]).max(axis=0)
    return np.concatenate([np.maximum(s, 1e-3 * s.max()) for s in (ways, speeds)])


def one(of: dict[str, Any], seed: int, k: int) -> dict[str, Any] | None:
    """Return what is known of a run; None if it fails, or its motion is not known."""
    r = np.random.default_rng([seed, k])
    name = sorted(of)[r.integers(len(of))]
    system, draw, kind = of[name]
    parameters, q, v = draw(r)
    system = system.with_parameters(**parameters) if parameters else system
    order = int(r.choice([1, 2, 2, 2, 4, 4, 6]))
    scheme = str(r.choice(SCHEMES[kind][order]))
    steps = int(np.exp(r.uniform(np.log(50), np.log(20000))))
    h = 10 ** r.uniform(*LENGTHS[order])
    try:
        run = dal.integrate(system, scheme, q, v, h=h, steps=steps)
        known = dal.integrate(
            system, "reference", q, v, h=steps * h / 20, steps=20, tolerance=1e-11
        )
    except (RuntimeError, ArithmeticError, ValueError):
        return None
    size = np.maximum(np.maximum(sizes(run.x), sizes(known.x)), 1e-300)
    error = (abs(run.x[-1] - known.x[-1]) / size).max()
    warned = any(text.startswith(("h is too", "h may be too")) for text in run_doubts(run))
    return {
        "k": k, "name": name, "scheme": scheme, "order": order, "steps": steps, "h": h,
        "error": error, "estimate": run.stats.error, "warned": warned, "whole": run.stats.whole,
        "remade": run.stats.remade / steps,
    }  # fmt: skip


def run_doubts(run: Any) -> list[str]:
    """Return what a run is warned of."""
    return list(dal.run.integration.doubts(run))


def costs() -> None:
    """Print times with the estimate relative to those without, of runs that are not suspect."""
    for name, scheme, h in (
        ("contact_oscillator", "leapfrog", 0.002), ("knife_edge", "midpoint", 0.002),
        ("rolling_disc", "midpoint", 0.001), ("contact_oscillator", "bm4", 0.02),
    ):  # fmt: skip
        system = getattr(dal.systems, name)()
        for steps in (1000, 3000, 10_000):
            taken: dict[bool, list[float]] = {True: [], False: []}
            for _ in range(300 if steps < 10_000 else 60):
                for check in taken:
                    began = time.perf_counter()
                    run = dal.integrate(system, scheme, h=h, steps=steps, check_h=check)
                    taken[check].append(time.perf_counter() - began)
            ratio = np.min(taken[True]) / np.min(taken[False])
            print(f"{name} by {scheme}, {steps} steps: {ratio:.3f}, whole {run.stats.whole}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--no-costs", action="store_true", help="only the runs")
    parser.add_argument("--show", action="store_true", help="print the runs that are told wrongly")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    of = systems()
    found = [one(of, given.seed, k) for k in range(given.first, given.first + given.runs)]
    runs = [run for run in found if run]
    print(f"{len(runs)} runs of {len(found)}; the others fail, with or without the estimate")
    for title, these, right in (
        ("above 10 %", [r for r in runs if r["error"] > 0.1], True),
        ("1 % to 10 %", [r for r in runs if 0.01 <= r["error"] <= 0.1], None),
        ("below 1 %", [r for r in runs if r["error"] < 0.01], False),
    ):
        told = sum(r["warned"] for r in these)
        print(f"error {title}: {len(these)} runs, {told} warned of")
        for r in these:
            if given.show and right is not None and r["warned"] != right:
                print("   ", {k: f"{v:.4g}" if isinstance(v, float) else v for k, v in r.items()})
    long = [r for r in runs if r["steps"] >= 1000]
    for title, these in (
        ("below 0.3 %", [r for r in long if r["error"] < 0.003]),
        ("0.3 % to 1 %", [r for r in long if 0.003 <= r["error"] < 0.01]),
        ("1 % to 10 %", [r for r in long if 0.01 <= r["error"] <= 0.1]),
        ("above 10 %", [r for r in long if r["error"] > 0.1]),
    ):
        again = np.sort([r["remade"] for r in these])
        whole = sum(r["whole"] for r in these)
        quantiles = [f"{again[int(k * (len(again) - 1))]:.2f}" for k in (0.5, 0.75, 0.9, 1.0)]
        print(
            f"runs of 1000 steps and more, error {title}: {len(these)}, of which {whole} were made "
            f"again whole; steps made more, per step: {', '.join(quantiles)} (1/2, 3/4, 0.9, all)"
        )
    if not given.no_costs:
        costs()


if __name__ == "__main__":
    main()
