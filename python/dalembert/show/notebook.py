"""Displays of systems, runs, checks and schemes in notebooks."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from .. import geometry
from ..core import extras, residual_bound
from ..geometry import Check
from ..run import Scheme, Solution
from ..system import System
from . import panels, web
from .table import Table, number

FEW = 8  # coordinates, parameters, sub-steps in one line


def _few(words: list[str]) -> str:
    return ", ".join(words[:FEW]) + ", ..." * (len(words) > FEW)


def _facts(rows: list[tuple[str, Any]]) -> Table:
    return Table(["", ""], [(name, str(x)) for name, x in rows if x != ""], 2, style="facts")


def system(self: System) -> str | None:
    """Return a system for a notebook: its formulas, coordinates, parameters and initial data."""
    if not extras.is_there("jinja2"):
        return None
    names, values = self.coordinates, self.parameters.items()
    kind = "" if self.has_constant_mass else "general Lagrangian"
    traits = [kind, "force" * self.is_forced, "driven" * self.is_driven]
    traits.append("depends on time" * self.is_time_dependent)
    rows = [
        ("coordinates", _few([f"{x} ({u})" if (u := self.unit(x)) else x for x in names])),
        ("constraints", f"{self.m}, {self.kind}" if self.m else "none"),
        ("has", ", ".join(x for x in traits if x)),
        ("inputs", _few([*self.inputs])),
        ("parameters", _few([f"{name} = {x:g}" for name, x in values])),
    ]
    if self.q0 is not None and self.v0 is not None:
        rows += [
            (what, _few([f"{x:g}" for x in values]))
            for what, values in (("starts at", self.q0), ("with velocity", self.v0))
        ]
    sections = [(self.name, web.sentence(self.help), panels.equations(self))]
    return web.notebook([*sections, ("", "", _facts(rows))])


def run(self: Solution) -> str | None:
    """Return a run for a notebook: its summary, residual, energy, path and counters."""
    if not extras.is_there("jinja2"):
        return None
    unit = panels.unit(self.system, "t")
    every = f", every {self.stride} steps" if self.stride > 1 else ""
    how = self._how if self.control else self._how + unit
    rows = [
        ("run", f"{self.scheme.name}, {how}: {len(self.x)} states at t = {self.t[0]:g} .. "
         f"{self.t[-1]:g}{unit}{every}"),
        ("D_ε" if self.nodes == "kept" else "D", _kept(self)),
        ("energy", _energy(self)),
        ("ended", self.message),
    ]  # fmt: skip
    cost = [
        (name.replace("_", " "), f"{x:.2g}" if isinstance(x, float) else str(x))
        for name, x in dataclasses.asdict(self.stats).items()
        if x and x == x and not isinstance(x, tuple)
    ]
    title = f"{self.system.name}: {'a run' if self.success else 'a run that failed'}"
    sections = [
        (title, "", web.side_by_side([_facts(rows).html(), *_picture(self)])),
        ("Cost of the run", "", [("", "", Table(["", ""], cost, 1))]),
    ]
    return web.notebook(sections)


def _kept(self: Solution) -> str:
    """Return the verdict on the set that the scheme preserves, for the whole run or some states."""
    if self.system.m == 0:
        return "no constraints"
    size, where = self.stats.worst_residual, "after every step"
    if math.isnan(size) or self.scheme.is_flow:
        rows = panels.some(self)[int(self.nodes == "kept") :]  # which may start in D
        state = self.q[rows], self.v[rows], self.shift, self.t[rows]
        size = float(max(geometry.relative_residual(self.system, *state), default=0.0))
        where = f"at {len(rows)} of {len(self.x)} states"
    bound = residual_bound(self.system.n)
    kept = "kept to roundoff" if size <= bound else "not kept to roundoff"
    return f"{kept}: relative residual at most {number(size)} {where}"


def _energy(self: Solution) -> str:
    """Return the energy at the start, and its change until the end, in words."""
    ends = [0, -1]
    first, last = geometry.energy(self.system, self.q[ends], self.v[ends], self.t[ends])
    free = "" if self.system.conserves_energy else ", where it is not conserved"
    unit = panels.unit(self.system, "energy")
    return f"{first:.6g}{unit} at the start, {last - first:+.1e}{unit} at the end{free}"


def _picture(self: Solution) -> list[web.HTML]:
    """Return the path, or nothing if it cannot be drawn; a notebook shows the rest all the same."""
    try:
        return [panels.motion(self, "run")]
    except Exception:  # of matplotlib, or because it is not installed
        return []


def check(self: Check) -> str | None:
    """Return a check for a notebook."""
    (verdict, text), *lines = self._lines()
    facts = _facts([(verdict, text), *lines])
    return web.notebook([("Check", "", facts)])


def scheme(self: Scheme) -> str | None:
    """Return a scheme for a notebook: its promise and its sub-steps."""
    steps = [f"({beta:g}, {fraction:g})" for beta, fraction in self.substeps]
    promised = f"p = {self.order}, s = {self.multiplier_order}" if self.order else "nothing"
    rows = [
        ("promises", promised),
        ("keeps", "D_ε, at kept nodes" if self.nodes == "kept" else "D"),
        ("symmetric", "yes" if self.symmetric else "no"),
        ("family", self.family),
        (f"{len(steps)} sub-steps (beta, fraction)" if steps else "", _few(steps)),
        ("from", self.reference),
    ]
    return web.notebook([(self.name, web.sentence(self.help), _facts(rows))])


def attach() -> None:
    """Attach the notebook displays to the classes."""
    for kind, shown in ((System, system), (Solution, run), (Check, check), (Scheme, scheme)):
        setattr(kind, "_repr_html_", shown)
