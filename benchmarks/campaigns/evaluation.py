"""A random campaign of evaluation: formulas in doubles, in Python and in C, against 50 digits.

    ./dev shell python benchmarks/campaigns/evaluation.py --count 2000 [--seed 1]

The value of a formula, read into the graph and printed, may differ from that of SymPy by 4 u times
the size of its terms, see derivatives.py.
"""

from __future__ import annotations

import argparse
import random
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np
import sympy as sp
from derivatives import Draw, Entry, Formula, Unsuitable, size

import dalembert as dal
from dalembert.core import ffi, pointer
from dalembert.symbolic import evaluation, printing

BAR, U = 4.0, 2.0**-53
KINDS = "sum product F P W J"

Expr = Any


@dataclass
class Case:
    """A formula at a point, its value, and the size of its terms."""

    formula: Expr
    at: dict[Expr, float]

    def __post_init__(self) -> None:
        """Raise Unsuitable if it is not defined there, or near a wall."""
        f = Formula(self.formula, [], self.at)
        self.value, self.size = f([]), f.sizes([])[0]
        exact = {s: sp.Rational(x) for s, x in self.at.items()}
        doubles = {x: sp.Rational(x) for x in self.formula.atoms(sp.Float)}
        value = self.formula.xreplace(doubles).evalf(50, subs=exact)
        assert size(mpmath.mpf(value) - self.value) <= 1e-40 * self.size, self.formula

    def error(self, got: float) -> float:
        """Return the error of a double, in u times the size of the terms."""
        return Entry("", got, self.value, self.size).error / U


def cases(source: random.Random, count: int) -> list[Case]:
    """Return random formulas at points."""
    symbols = sp.symbols("x y w a", real=True)
    power = sp.Symbol("n")
    draw, found = Draw(source, power), list[Case]()

    def one(depth: int) -> Expr:
        return draw(list(symbols), depth, KINDS)

    while len(found) < count:
        form = source.choice([
            lambda: one(source.randint(1, 3)),
            lambda: one(2) - sum(one(source.randint(0, 1)) for _ in range(12)),
            lambda: one(2) * sp.Mul(*(one(source.randint(0, 1)) for _ in range(5))),
            lambda: one(2) / (one(1) / one(1) - one(1) / (one(1) * one(1))),
        ])  # fmt: skip
        at = {s: source.choice([-1, 1]) * source.uniform(0.2, 1.7) for s in symbols}
        try:
            found.append(Case(form(), at | {power: source.uniform(1.2, 3.4)}))
        except (Unsuitable, RecursionError, ZeroDivisionError):
            continue
    return found


def in_python(given: Sequence[Case]) -> list[float]:
    """Return the values of formulas as Python functions."""
    return [printing.function({"z": [*c.at]}, [c.formula])([*c.at.values()])[0] for c in given]


def in_c(given: Sequence[Case]) -> list[float]:
    """Return the values of formulas in C: as the components of a force, in parameters."""
    n = len(given)
    q = dal.coordinates([f"q{i}" for i in range(n)])
    parameters, force = {}, {}
    for k, (x, c) in enumerate(zip(q, given)):
        own = {s: sp.Symbol(f"{s}{k}", **s.assumptions0) for s in c.at}
        force[x] = c.formula.xreplace(own)
        parameters |= {own[s]: a for s, a in c.at.items() if s in c.formula.free_symbols}
    system = dal.System.from_sympy(
        sum(x.d**2 for x in q) / 2, [], q, force=force, parameters=parameters
    )
    library = evaluation.library(system._model, "steps")
    assert library is not None, "this needs a C compiler"
    values, zero, found = np.array([*system.parameters.values()]), np.zeros(n), np.full(n, np.nan)
    point = [0.0, *[pointer(zero)] * 3]
    ctx = ffi.cast("void *", values.ctypes.data)
    assert library.definition.force(*point, pointer(found), ffi.NULL, ffi.NULL, ctx) == 0
    return list(found)


def campaign(count: int, seed: int = 1, size: int = 100) -> list[tuple[float, str]]:
    """Return the error of each of 2 ``count`` values, and a description; C has ``size`` at once."""
    found = []
    with mpmath.workdps(60):
        for k in range(0, count, size):
            given = cases(random.Random(f"{seed} {k}"), min(size, count - k))
            for name, evaluated in (("Python", in_python), ("C", in_c)):
                for c, got in zip(given, evaluated(given)):
                    error = c.error(got)
                    found.append((error, f"{name}: {error:.2f} u of {c.formula} at {c.at}"))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description="Values of random formulas.")
    parser.add_argument("--count", type=int, default=2000, help="number of random formulas")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random formulas")
    given = parser.parse_args()
    found = sorted(campaign(given.count, given.seed), reverse=True)
    print(*(text for error, text in found if error > BAR or error == found[0][0]), sep="\n")
    return int(found[0][0] > BAR)


if __name__ == "__main__":
    sys.exit(main())
