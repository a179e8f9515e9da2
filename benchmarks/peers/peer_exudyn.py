"""Exudyn: a multibody code; a generic body with a vector of constraints on the level of velocities.

Forces, mass matrix and constraints are user functions in Python, which call machine code of numba.
Its own symbolic user functions cannot index vectors of n components, so they are of no use here.
`TrapezoidalIndex2` is its solver for such constraints; of order 2, with a full Newton iteration.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import sympy as sp
from common import T_STATE, Method, Refused, need, python_function, stopwatch
from problems import Problem


def methods(problem: Problem) -> Iterator[Method | Refused]:
    exu, items = need("exudyn"), need("exudyn.itemInterface")
    e, n, m = problem.equations, len(problem.q), len(problem.constraints)
    arguments = {"q": problem.q, "v": problem.v}
    with stopwatch() as compiled:
        forces = python_function("force", arguments, {"out": e.F})
        masses = python_function("mass", arguments, {"out": e.M})
        rows = python_function("rows", arguments, {
            "out": sp.Matrix([list(e.mu.row(a)) for a in range(m)]),
            "phi": sp.Matrix(problem.constraints),
        })  # fmt: skip
        start = np.array(problem.start)
        forces(0.0, start[:n], start[n:], np.empty(n))
        masses(0.0, start[:n], start[n:], np.empty((n, n)))
        rows(0.0, start[:n], start[n:], np.empty((m, n)), np.empty(m))

    def force(mbs: Any, t: float, item: int, q: Any, v: Any) -> np.ndarray:
        out = np.empty(n)
        forces(t, np.asarray(q), np.asarray(v), out)
        return out

    def mass(mbs: Any, t: float, item: int, q: Any, v: Any) -> np.ndarray:
        out = np.empty((n, n))
        masses(t, np.asarray(q), np.asarray(v), out)
        return out

    def constraint(mbs: Any, t: float, item: int, q: Any, v: Any, level: bool) -> np.ndarray:
        out, phi = np.empty((m, n)), np.empty(m)
        rows(t, np.asarray(q), np.asarray(v), out, phi)
        return phi

    def jacobian(mbs: Any, t: float, item: int, q: Any, v: Any, level: bool) -> np.ndarray:
        out, phi = np.empty((m, n)), np.empty(m)
        rows(t, np.asarray(q), np.asarray(v), out, phi)
        return out

    def build(state: np.ndarray) -> Any:
        system = exu.SystemContainer().AddSystem()
        node = system.AddNode(items.NodeGenericODE2(
            numberOfODE2Coordinates=n, referenceCoordinates=[0.0] * n,
            initialCoordinates=list(state[:n]), initialCoordinates_t=list(state[n:]),
        ))  # fmt: skip
        out = np.empty((n, n))
        masses(0.0, state[:n], state[n:], out)
        varying = {} if e.constant_mass else {"massMatrixUserFunction": mass}
        body = system.AddObject(items.ObjectGenericODE2(
            nodeNumbers=[node], massMatrix=out, forceUserFunction=force, **varying
        ))  # fmt: skip
        ground = system.AddNode(items.NodePointGround())
        system.AddObject(items.CoordinateVectorConstraint(
            markerNumbers=[
                system.AddMarker(items.MarkerNodeCoordinates(nodeNumber=ground)),
                system.AddMarker(items.MarkerObjectODE2Coordinates(objectNumber=body)),
            ],
            scalingMarker0=np.zeros((m, n)), velocityLevel=True,
            constraintUserFunction=constraint, jacobianUserFunction=jacobian,
        ))  # fmt: skip
        system.Assemble()
        return system

    def solve(steps: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
        states = np.empty((len(times) - 1, 2 * n))
        system = build(state)
        with warnings.catch_warnings(), _quiet():
            warnings.simplefilter("ignore")
            settings = exu.SimulationSettings()
            time = settings.timeIntegration
            time.newton.useModifiedNewton = False
            settings.solutionSettings.writeSolutionToFile = False
            for k in range(len(times) - 1):
                time.startTime, time.endTime = times[k], times[k + 1]
                time.numberOfSteps = round((times[k + 1] - times[k]) * steps / T_STATE)
                if not system.SolveDynamic(settings, exu.DynamicSolverType.TrapezoidalIndex2,
                                           updateInitialValues=True):  # fmt: skip
                    raise RuntimeError("a step fails")
                data = system.systemData
                states[k, :n] = data.GetODE2Coordinates()
                states[k, n:] = data.GetODE2Coordinates_t()
        return states

    yield Method("Exudyn", "steps", (400, 1000, 4000, 10000), solve, compiled[0], 2, 1000)


class _quiet:
    """Standard output of C++ goes nowhere: Exudyn warns there of the memory of user functions."""

    def __enter__(self) -> None:
        self.saved, self.nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
        os.dup2(self.nowhere, 1)

    def __exit__(self, *_: object) -> None:
        os.dup2(self.saved, 1)
        os.close(self.saved)
        os.close(self.nowhere)
