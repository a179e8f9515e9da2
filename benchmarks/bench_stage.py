"""A stage of leapfrog with a potential, of models from SymPy, against the same stage by hand in C.

By hand it is written with the compensated sums of the library, and with plain ones.

Usage: ``python bench_stage.py BENCH_STAGE HAND_STAGES``, the program made from bench_stage.c and
the file hand_stages.c, which is compiled here as models are: by the same compiler with its flags.

Ratios within one run.  Fails if a bar is missed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import sympy
from sympy import Rational, cos, sin

import dalembert as dal
from dalembert import compiler
from dalembert.symbolic import evaluation


def particle_oscillator() -> dal.System:
    x, y, z = dal.coordinates("x y z")
    k1, k2, k3 = sympy.symbols("k1 k2 k3")
    L = (x.d**2 + y.d**2 + z.d**2 - k1 * x**2 - k2 * y**2 - k3 * z**2) / 2
    return dal.System.from_sympy(L, [z.d - y * x.d], parameters={k1: 1, k2: 2, k3: 1.5},
                                 q0=[0.5, 0.3, -0.2], v0=[1, 0.7, 0.3])


def contact_oscillator() -> dal.System:
    """With a number, not a parameter: the program by hand gets it as one."""
    x, y, z = dal.coordinates("x y z")
    V = (x**2 + y**2 + z**2 + Rational(3, 10) * x**2 * z**2) / 2
    return dal.System.from_sympy((x.d**2 + y.d**2 + z.d**2) / 2 - V, [x.d + y * z.d],
                                 q0=[1.1, 0.0, -0.7], v0=[0, 1, 0.3])


def knife_edge() -> dal.System:
    x, y, theta = dal.coordinates("x y theta")
    m, J, gs = sympy.symbols("m J gs")
    L = m * (x.d**2 + y.d**2) / 2 + J * theta.d**2 / 2 + m * gs * x
    return dal.System.from_sympy(L, [sin(theta) * x.d - cos(theta) * y.d],
                                 parameters={m: 2, J: 0.75, gs: 2.5},
                                 q0=[0, 0, 0.2], v0=[0.5, 0.1, 1.2])


def robot() -> dal.System:
    x, y, phi, theta = dal.coordinates("x y phi theta")
    m, inertia, J, R, k = sympy.symbols("m I J R k")
    L = (m * (x.d**2 + y.d**2) + inertia * phi.d**2 + J * theta.d**2) / 2 - k * sin(theta)
    rows = [x.d - R * cos(phi) * theta.d, y.d - R * sin(phi) * theta.d]
    return dal.System.from_sympy(L, rows, parameters={m: 1.2, inertia: 0.5, J: 0.3, R: 0.7, k: 0.8},
                                 q0=[0, 0, 0, 0], v0=[0.7, 0, 0.5, 1])


def sleigh() -> dal.System:
    x, y, theta = dal.coordinates("x y theta")
    m, J, a, k = sympy.symbols("m J a k")
    L = (m * (x.d**2 + y.d**2) + J * theta.d**2 - k * (x**2 + y**2)) / 2
    return dal.System.from_sympy(L, [-sin(theta) * x.d + cos(theta) * y.d - a * theta.d],
                                 parameters={m: 1.5, J: 0.4, a: 0.3, k: 1},
                                 q0=[0.3, -0.2, 0.3], v0=[0.2, 0.3, 1])


SYSTEMS: tuple[Callable[[], dal.System], ...] = (
    particle_oscillator, contact_oscillator, knife_edge, robot, sleigh,
)  # fmt: skip


def compile_by_hand(source: str, directory: str) -> str:
    """Compile a file as a model is compiled."""
    found = compiler.find()
    assert found is not None
    path = str(Path(directory) / "hand.so")
    subprocess.run([*found.command, *compiler.FLAGS, source, "-o", path, "-lm"], check=True)
    return path


def main(program: str, source: str) -> int:
    with tempfile.TemporaryDirectory() as directory:
        os.environ["DALEMBERT_CACHE"] = directory
        by_hand, kept = compile_by_hand(source, directory), []
        for make in SYSTEMS:
            system = make()
            assert system.q0 is not None and system.v0 is not None
            model = str(evaluation.library(system._model, "steps").path)
            values = system.parameters.values() or [0.3]
            state = [*system.q0, *system.project(system.q0, system.v0)]
            words = [repr(float(x)) for x in (*values, *state)]
            done = subprocess.run([program, make.__name__, model, by_hand, *words], check=False)
            kept.append(done.returncode == 0)
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
