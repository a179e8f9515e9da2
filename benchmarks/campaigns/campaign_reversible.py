"""A random campaign of reversible steps: wells, walls, encounters, pendulums and stiff springs.

    ./dev shell python benchmarks/campaigns/campaign_reversible.py --seed 1 --count 500

``--repeat CASE`` runs one of them.

It is not part of the test suites.  Case k of seed S is made from (S, k) alone.  A case has 1 to 4
degrees of freedom, a constraint or none, and may start at rest, in the flat middle of its well, or
at speeds and places down to 1e-30.  The energy is that of the formula, by SymPy; its change is
relative to the largest kinetic energy, but for roundoff of V.  A run is

    good      the energy changes by at most 1e-6;
    warned    it changes by more, and a warning says that steps were not reversible;
    refused   an error of ours;
    hard      it changes by more than 1e-6, and that of leapfrog at equal cost by more than 1e-4,
              and by more than this;
    SILENT    none of these, or a state or time that is no number.

A run of more than 20,000 steps is cut there.  The cost of a step is that of 19 leapfrogs: its 10
stages and 9 evaluations of the field."""

from __future__ import annotations

import argparse
import collections
import warnings
from typing import Any

import numpy as np
import sympy as sp

import dalembert as dal

NAMES = dal.coordinates("x y z u")
KINDS = ("well", "wall", "encounter", "pendulum", "springs")
COST = 19
MOST = 20_000


def potential(kind: str, q: list[Any], rng: np.random.Generator) -> Any:
    """Return a random V of a kind."""

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    if kind == "encounter":
        distance = sp.sqrt(q[0] ** 2 + q[1] ** 2 + log(1e-4, 1e-2))
        return -1 / distance + log(0.01, 0.1) * sum(a**2 for a in q)
    if kind == "pendulum":
        return sum(log(0.2, 2) * (1 - sp.cos(a)) ** int(rng.choice([1, 2])) for a in q)
    if kind == "springs":
        return log(0.05, 1) * q[0] ** 4 + sum(log(0.1, 1e3) * a**2 / 2 for a in q)
    coupling = log(0.05, 0.5) * q[0] ** 2 * q[1] ** 2 if len(q) > 1 else 0
    if kind == "well":
        return coupling + sum(log(0.1, 3) * a ** int(rng.choice([2, 4, 4, 6, 8])) / 4 for a in q)
    steep = [log(3, 100) for _ in q]
    return coupling + sum(
        sp.exp(k * (a - 1)) + sp.exp(-k * (a + 1)) for k, a in zip(steep, q, strict=True)
    )


def case(seed: int, k: int) -> tuple[str, dal.System, Any, Any, Any, Any, float]:
    """Return kind, system, functions T and V, and a start and an end."""
    rng = np.random.default_rng([seed, k])
    kind = str(rng.choice(KINDS))
    n = int(rng.choice([1, 1, 2, 2, 3, 4]))
    n = max(n, 2) if kind == "encounter" else n
    q = list(NAMES[:n])
    V = potential(kind, q, rng)
    masses = rng.uniform(0.3, 3, size=n)
    T = sum(float(m) * a.d**2 / 2 for m, a in zip(masses, q, strict=True))
    forms = []
    if n >= 3 and rng.random() < 0.7:
        x, y, z = q[:3]
        c = float(rng.uniform(0.1, 1))
        forms = [
            z.d - c * y * x.d, z.d - (1 + x**4) * y.d, z.d - x * y.d + y * x.d,
            sp.sin(z) * x.d - sp.cos(z) * y.d,
        ][int(rng.integers(4)) :][:1]  # fmt: skip
    system = dal.System.from_sympy(T - V, forms, coordinates=q)
    place = rng.uniform(-0.7, 0.7, size=n) * 10.0 ** -rng.choice([0, 0, 0, rng.integers(1, 31)])
    speed = rng.normal(size=n) * 10.0 ** -rng.choice([0, 0, 0, 0, rng.integers(1, 21)])
    if rng.random() < 0.1:
        place *= 0
    elif rng.random() < 0.15:
        speed *= 0
    of_V = sp.lambdify([q], V)
    t_end = float(np.exp(rng.uniform(np.log(20), np.log(100))))
    return kind, system, masses, of_V, place, speed, t_end


def change(run: Any, masses: Any, of_V: Any) -> float:
    """Return the largest change of the energy, relative to the largest kinetic energy."""
    kinetic = (run.v**2 @ masses) / 2
    V = of_V(run.q.T)
    moved = abs(kinetic + V - kinetic[0] - V[0]).max() - 1e-14 * (1 + abs(V).max())
    return float(max(moved, 0.0) / kinetic.max())


def judge(seed: int, k: int) -> tuple[str, str]:
    """Return the verdict on a case, and why."""
    kind, system, masses, of_V, q, v, t_end = case(seed, k)
    head = f"{kind}, n = {system.n}, m = {system.m}: "
    ask = {"h": "reversible", "consistent": "project"}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            run = dal.integrate(system, "bm6", q, v, t_end=t_end, **ask,
                                observer=lambda step, t, q, v: step >= MOST)  # fmt: skip
            if run.t[-1] != t_end:
                t_end = run.t[-1]
                caught.clear()
                run = dal.integrate(system, "bm6", q, v, t_end=t_end, **ask)
        except dal.DalembertError as error:
            return "refused", head + str(error)
    told = any("not reversible" in str(w.message) for w in caught)
    moved = change(run, masses, of_V) if np.isfinite(run.t).all() else np.nan
    text = f"{head}{run.stats.steps} steps, {run.stats.rejected} again, {run.stats.resets} resets"
    text += f", energy off by {moved:.1e}, warned: {told}"
    if moved <= 1e-6:
        return "good, but warned of" if told else "good", text
    if told and np.isfinite(moved):
        return "warned", text
    steps = COST * (run.stats.steps + run.stats.rejected)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            plain = dal.integrate(system, "leapfrog", q, v, h=t_end / steps, steps=steps,
                                  consistent="project", stride=COST)  # fmt: skip
            other = change(plain, masses, of_V)
        except dal.DalembertError:
            other = np.inf
    return "hard" if other > max(1e-4, moved) else "SILENT", f"{text}; leapfrog {other:.1e}"


def main() -> None:
    """Print the cases that are not good, and how many there are of each."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--count", type=int, default=500)
    ask.add_argument("--repeat", type=int)
    given = ask.parse_args()
    found: collections.Counter[str] = collections.Counter()
    print(f"seed {given.seed}")
    for k in range(given.count) if given.repeat is None else [given.repeat]:
        verdict, text = judge(given.seed, k)
        found[verdict] += 1
        if verdict != "good" or given.repeat is not None:
            print(f"{k}: {verdict}: {text}", flush=True)
    print(dict(found))
    raise SystemExit(found["SILENT"] > 0)


if __name__ == "__main__":
    main()
