"""The scheme reference on models from SymPy, against GSL's rk8pd on the ODE on D by hand in C.

Usage: ``python bench_flow.py BENCH_FLOW [ARGUMENT...]``, the program made from bench_flow.c, and
what it is told in the end.

Ratios within one run.  Fails if a bar is missed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile

import bench_stage

import dalembert as dal
from dalembert.symbolic import evaluation


def particle() -> dal.System:
    x, y, z = dal.coordinates("x y z")
    return dal.System.from_sympy((x.d**2 + y.d**2 + z.d**2) / 2, [z.d - y * x.d],
                                 q0=[0.5, 0.3, -0.2], v0=[1, 0.7, 0.3])  # fmt: skip


SYSTEMS = (particle, bench_stage.particle_oscillator, bench_stage.knife_edge, bench_stage.sleigh,
           bench_stage.robot)  # fmt: skip


def main(program: str, *arguments: str) -> int:
    kept = [subprocess.run([program, *arguments], check=False).returncode == 0]
    with tempfile.TemporaryDirectory() as directory:
        os.environ["DALEMBERT_CACHE"] = directory
        for make in SYSTEMS:
            system = make()
            assert system.q0 is not None and system.v0 is not None
            model = str(evaluation.library(system._model, "steps").path)
            state = [*system.q0, *system.project(system.q0, system.v0)]
            words = [repr(float(x)) for x in (*system.parameters.values(), *state)]
            command = [program, make.__name__, model, *words, *arguments]
            kept.append(subprocess.run(command, check=False).returncode == 0)
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
