"""Processor time from a model to its first step of midpoint, each in a fresh process and cache.

Usage: ``python bench_compile.py [MODEL ...] [--json FILE] [--against FILE] [--repeat N]``.  The
time has two parts: this process (derivatives, generated C) and its children (the C compiler).
Imports and the expressions of the model come before.  Minima over repetitions.  Fails if a bar
is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp
from sympy.physics import mechanics

import dalembert as dal
from dalembert.symbolic import codegen, evaluation, given

# A model: how its system is made, and the coordinates of the step.
Made = tuple[Callable[[], dal.System], Sequence[float] | None]


def rates(q: Sequence[Any], *expressions: Any) -> list[Any]:
    """Return the time derivatives of functions of the coordinates."""
    return [sum(sp.diff(e, x) * x.d for x in e.free_symbols & {*q}) for e in expressions]


def bicycle() -> Made:
    """The Whipple bicycle: 8 coordinates, and 5 constraints of two wheels that roll.

    Parameters of Meijaard, Papadopoulos, Ruina and Schwab, Proc. R. Soc. A 463 (2007) 1955.
    """
    x, y, yaw, roll, pitch, rear, steer, front = q = mechanics.dynamicsymbols(
        "x y yaw roll pitch rear steer front"
    )
    values: dict[Any, float] = {}

    def value(name: str, number: float) -> Any:
        values[sp.Symbol(name)] = number
        return sp.Symbol(name)

    radii = value("rr", 0.3), value("rf", 0.35)
    gravity = value("g", 9.81)
    road = mechanics.ReferenceFrame("N")
    heading = road.orientnew("A", "Axis", [yaw, road.z])
    leaning = heading.orientnew("B", "Axis", [roll, heading.x])
    frame = leaning.orientnew("C", "Axis", [pitch, leaning.y])
    fork = frame.orientnew("E", "Axis", [steer, frame.z])
    wheels = (
        frame.orientnew("D", "Axis", [rear, frame.y]),
        fork.orientnew("F", "Axis", [front, fork.y]),
    )

    contact = mechanics.Point("contact")
    contact.set_vel(road, x.diff() * road.x + y.diff() * road.y)
    hub = contact.locatenew("hub", -radii[0] * leaning.z)
    hub.v2pt_theory(contact, road, leaning)
    head = hub.locatenew("head", value("d1", 0.9534570696121849) * frame.x)
    head.v2pt_theory(hub, road, frame)
    axle = head.locatenew(
        "axle", value("d2", 0.2676445084476887) * fork.z + value("d3", 0.03207142672761929) * fork.x
    )
    axle.v2pt_theory(head, road, fork)
    rider = hub.locatenew(
        "rider",
        value("l1", 0.4707271515135145) * frame.x + value("l2", -0.47792881146460797) * frame.z,
    )
    rider.v2pt_theory(hub, road, frame)
    bars = axle.locatenew(
        "bars",
        value("l3", -0.00597083392418685) * fork.x + value("l4", -0.3699518200282974) * fork.z,
    )
    bars.v2pt_theory(axle, road, fork)

    down = fork.y.cross(road.z).cross(fork.y)
    down = down / sp.sqrt(down.dot(down))
    velocities = (
        hub.vel(road) + wheels[0].ang_vel_in(road).cross(radii[0] * leaning.z),
        axle.vel(road) + wheels[1].ang_vel_in(road).cross(radii[1] * down),
    )
    rows = [velocities[0].dot(e) for e in (heading.x, heading.y)]
    rows += [velocities[1].dot(e) for e in (heading.x, heading.y, heading.z)]
    L = 0
    for point, turning, mass, numbers in (
        (rider, frame, 85.0, (7.178169776497895, 11.0, 4.821830223502103, 3.8225535938357873)),
        (bars, fork, 4.0,
         (0.05841337700152972, 0.06, 0.007586622998470264, 0.009119225261946298)),
        (hub, wheels[0], 2.0, (0.0603, 0.12, 0.0603, 0.0)),
        (axle, wheels[1], 3.0, (0.1405, 0.28, 0.1405, 0.0)),
    ):  # fmt: skip
        letter = turning.name.lower()
        m, *moments = [
            value(f"{k}{letter}", z) for k, z in zip(("m", "I1", "I2", "I3"), (mass, *numbers))
        ]
        I13 = value(f"I13{letter}", numbers[3]) if numbers[3] else 0
        inertia = mechanics.inertia(turning, *moments, 0, 0, I13)
        body = mechanics.RigidBody(letter, point, turning, m, (inertia, point))
        L += body.kinetic_energy(road) + m * gravity * point.pos_from(contact).dot(road.z)
    method = mechanics.LagrangesMethod(L, list(q), nonhol_coneqs=rows)
    at = [0, 0, 0.1, 0.05, np.pi / 10, 0, 0.1, 0]
    return lambda: dal.System.from_lagranges_method(method, values), at


def bodies() -> Made:
    """A pendulum of three rigid bodies in space: 9 Euler angles, each body's from the one before.

    Their joints are balls in the ends of the axes of the bodies.
    """
    q = dal.coordinates([f"{letter}{i}" for i in range(3) for letter in ("yaw", "tilt", "spin")])
    m, length, I1, I3, g = sp.symbols("m l I1 I3 g", positive=True)
    L, turned, spin, end = sp.Integer(0), sp.eye(3), sp.zeros(3, 1), sp.zeros(3, 1)
    for i in range(3):
        a, b, c = q[3 * i : 3 * i + 3]
        own = sp.rot_axis3(-a) * sp.rot_axis1(-b) * sp.rot_axis3(-c)
        spin = own.T * spin + sp.Matrix([
            a.d * sp.sin(b) * sp.sin(c) + b.d * sp.cos(c),
            a.d * sp.sin(b) * sp.cos(c) - b.d * sp.sin(c),
            a.d * sp.cos(b) + c.d,
        ])  # fmt: skip  # in the axes of the body
        turned = turned * own
        along = turned[:, 2] * length
        velocity = sp.Matrix(rates(q, *(end + along / 2)))
        L += m * velocity.dot(velocity) / 2 - m * g * (end + along / 2)[2]
        L += (I1 * (spin[0] ** 2 + spin[1] ** 2) + I3 * spin[2] ** 2) / 2
        end = end + along
    values = {m: 1.0, length: 0.5, I1: 0.02, I3: 0.01, g: 9.81}
    return lambda: dal.System.from_sympy(L, [], q, parameters=values), np.linspace(0.3, 1.2, 9)


def cart(relative: bool, links: int = 24) -> Made:
    """Links in a chain on a cart that rolls on a rail."""
    x, *angles = q = dal.coordinates(["x", *(f"a{i}" for i in range(links))])
    M, m, length, g = sp.symbols("M m l g", positive=True)
    L, X, Y, a = M * x.d**2 / 2, x.d, sp.Integer(0), [sp.Integer(0)] * 2
    height = sp.Integer(0)
    for angle in angles:
        a = [a[0] + angle, a[1] + angle.d] if relative else [angle, angle.d]
        X, Y = X + length * sp.cos(a[0]) * a[1], Y + length * sp.sin(a[0]) * a[1]
        height -= length * sp.cos(a[0])
        L += m * (X**2 + Y**2) / 2 - m * g * height
    values = {M: 2.0, m: 0.1, length: 0.2, g: 9.81}
    at = np.linspace(0.1, 0.4, links + 1) / (links if relative else 1)
    return lambda: dal.System.from_sympy(L, [], q, parameters=values), at


def skates(count: int = 180) -> Made:
    """Knife edges that know nothing of each other."""
    q = dal.coordinates([f"{letter}{i}" for i in range(count) for letter in "xya"])
    x, y, a = q[::3], q[1::3], q[2::3]
    L = sum(c.d**2 for c in q) / 2
    rows = [-sp.sin(a[i]) * x[i].d + sp.cos(a[i]) * y[i].d for i in range(count)]
    return lambda: dal.System.from_sympy(L, rows, q), np.linspace(0.1, 0.4, 3 * count)


def rods(count: int = 100) -> Made:
    """A hanging chain of rods: 2 coordinates of the mass at the end of each."""
    q = dal.coordinates([f"{letter}{i}" for i in range(count) for letter in "xy"])
    x, y = [sp.Integer(0), *q[::2]], [sp.Integer(0), *q[1::2]]
    L = sum(c.d**2 for c in q) / 2 - sum(y[1:])
    lengths = [(x[i + 1] - x[i]) ** 2 + (y[i + 1] - y[i]) ** 2 for i in range(count)]
    rows = [e / 2 for e in rates(q, *lengths)]
    return lambda: dal.System.from_sympy(L, rows, q), np.cumsum(
        np.tile([0.6, -0.8], (count, 1)), 0
    ).ravel()


MODELS: dict[str, tuple[Callable[[], Made], float]] = {  # with the bars of their seconds
    "bicycle": (bicycle, 10.0),
    "bodies": (bodies, 13.0),
    "cart": (lambda: cart(False), 7.0),
    "cart_relative": (lambda: cart(True), 20.0),
    "skates": (skates, 4.0),
    "rods": (rods, 4.0),
    **{name: (lambda name=name: (getattr(dal.systems, name), None), 3.0)
       for name in dal.systems.names_in_sympy()},
}  # fmt: skip


def first_step(name: str) -> dict[str, float]:
    """Return the processor times of this process and of its children."""
    assert codegen.program and evaluation.library and given.make_model  # imported here
    make, q = MODELS[name][0]()
    before, start = os.times(), time.perf_counter()
    system = make()
    at = system.q0 if q is None else q
    v = system.project(at, np.linspace(1.0, 0.5, system.n))
    assert dal.integrate(system, "midpoint", at, v, h=1e-4, steps=1, check_h=False).success
    wall, after = time.perf_counter() - start, os.times()
    return {
        "python": after.user + after.system - before.user - before.system,
        "compiler": after.children_user + after.children_system
        - before.children_user - before.children_system,
        "wall": wall,
        "n": system.n,
        "m": system.m,
    }  # fmt: skip


def measured(name: str, repeat: int) -> dict[str, float]:
    """Return the times of fresh processes: the least of each."""
    found = []
    for _ in range(repeat):
        with tempfile.TemporaryDirectory() as directory:
            done = subprocess.run(
                [sys.executable, __file__, "--inside", name], check=True, text=True,
                stdout=subprocess.PIPE, env=os.environ | {"DALEMBERT_CACHE": directory},
            )  # fmt: skip
        found.append(json.loads(done.stdout.splitlines()[-1]))
    return {key: min(x[key] for x in found) for key in found[0]}


def main() -> int:
    parser = argparse.ArgumentParser(description="Seconds from a model to its first step.")
    parser.add_argument("models", nargs="*", help=f"default: all of {', '.join(MODELS)}")
    parser.add_argument("--json", type=Path, help="file to write the numbers to")
    parser.add_argument("--against", type=Path, help="file of --json, to print ratios to")
    parser.add_argument("--repeat", type=int, default=1, help="number of repetitions")
    parser.add_argument("--inside", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside:
        print(json.dumps(first_step(options.inside)))
        return 0
    if unknown := {*options.models} - {*MODELS}:
        parser.error(f"no model {', '.join(sorted(unknown))}; choose from {', '.join(MODELS)}")
    before = json.loads(options.against.read_text()) if options.against else {}
    print(f"seconds of processor time{'python':>13}{'compiler':>10}{'both':>9}  {'bar':>5}")
    found, missed = {}, []
    for name in options.models or MODELS:
        times = found[name] = measured(name, options.repeat)
        both, bar = times["python"] + times["compiler"], MODELS[name][1]
        text = f"  {name:18} n = {times['n']:3d}, m = {times['m']:3d}"
        text += f"{times['python']:8.2f}{times['compiler']:10.2f}{both:9.2f}  {bar:5g}"
        if old := before.get(name):
            pairs = ("python", "compiler")
            ratios = [times[x] / old[x] for x in pairs] + [both / sum(old[x] for x in pairs)]
            text += "   to before " + " ".join(f"{x:.3f}" for x in ratios)
        print(text + ("   MISSED" if both > bar else ""), flush=True)
        missed += [name] * (both > bar)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1), encoding="utf-8")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
