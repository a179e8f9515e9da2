"""A random campaign: random systems, all schemes, judged by code that shares nothing with ours.

    ./dev shell python tests/campaign.py --seed 1 --minutes 10 [--only KIND] [--repeat CASE]

It needs SciPy's neighbours only: NumPy, mpmath and SymPy, and is quicker with gmpy2.  It is not
part of the test suites.  Case k of seed S is made from (S, k) alone, so that `--seed S --repeat k`
makes it again and says more about it.

A system is a sum of terms c F(a.z + b) G(w.z), with z = (q, v, t) and F, G from a short list: then
all derivatives are a few lines, in double, in long double and with 55 digits.  What is looked for
is a silent error, that is success without a warning and

    bound      a stored state where |mu^a v| > 4 n u s^a, or more than stats.worst_residual tells;
    step       a step that is not the solution of the equations of the scheme that is connected with
               h = 0, by more than 100 u cond (see `Substep.limit`);
    reaction   the same for the multipliers, of the scheme and by the formula;
    order      one-step errors that fall with less than h^(p + 0.8);
    reference  a reference state farther from the solution than ten times the accuracy it claims;
    energy     a jump of the energy by more than half of the largest kinetic energy; no number.

A false alarm is an exception, or a warning about D, where the oracle finds nothing wrong.
"""

from __future__ import annotations

import argparse
import collections
import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import mpmath
import numpy as np
import sympy as sp
from sympy.physics.mechanics import dynamicsymbols
from tqdm import tqdm

import dalembert as dal

mpmath.mp.dps = 55
U = 2.0**-53
mpf = mpmath.mpf
vector = np.vectorize(mpf, otypes=[object])


# ---- systems as sums of terms ------------------------------------------------------------------


def inverse(x: Any, _: Any) -> tuple[Any, Any, Any]:
    d = 1 / (1 + x * x)
    return d, -2 * x * d * d, (6 * x * x - 2) * d**3


def root(x: Any, lib: Any) -> tuple[Any, Any, Any]:
    s = lib.sqrt(1 + x * x)
    return s, x / s, 1 / s**3


def wall(x: Any, _: Any) -> tuple[Any, Any, Any]:
    y = x * (x > 0)
    return y * y, 2 * y, 2 * (x > 0) + 0 * x


def sine(x: Any, lib: Any) -> tuple[Any, Any, Any]:
    s, c = lib.sin(x), lib.cos(x)
    return s, c, -s


def cosine(x: Any, lib: Any) -> tuple[Any, Any, Any]:
    s, c = lib.sin(x), lib.cos(x)
    return c, -s, -c


FUNCTIONS: dict[str, Callable[[Any, Any], tuple[Any, Any, Any]]] = {  # with two derivatives
    "one": lambda x, _: (1 + 0 * x, 0 * x, 0 * x),
    "x": lambda x, _: (x, 1 + 0 * x, 0 * x),
    "x2": lambda x, _: (x * x, 2 * x, 2 + 0 * x),
    "sin": sine,
    "cos": cosine,
    "inverse": inverse,
    "root": root,
    "wall": wall,
}
SYMBOLIC: dict[str, Callable[[Any], Any]] = {
    "one": lambda x: sp.Integer(1),
    "x": lambda x: x,
    "x2": lambda x: x**2,
    "sin": sp.sin,
    "cos": sp.cos,
    "inverse": lambda x: 1 / (1 + x**2),
    "root": lambda x: sp.sqrt(1 + x**2),
    "wall": lambda x: sp.Max(0, x) ** 2,
}


class Terms:
    """r sums of terms c F(a.z + b) G(w.z) of z, which has N components."""

    def __init__(self, N: int, r: int) -> None:
        self.N, self.r = N, r
        self.F: list[str] = []
        self.G: list[str] = []
        self.A, self.W, self.C = np.zeros((0, N)), np.zeros((0, N)), np.zeros((0, r))
        self.b = np.zeros(0)

    def add(self, c: Any, F: str = "one", a: Any = None, b: float = 0.0, G: str = "one",
            w: Any = None) -> None:  # fmt: skip
        """Add a term; c is {row: number}, a and w are {component: number}."""
        self.F.append(F)
        self.G.append(G)
        self.b = np.append(self.b, b)
        self.C = np.vstack([self.C, spread(c, self.r)])
        self.A = np.vstack([self.A, spread(a, self.N)])
        self.W = np.vstack([self.W, spread(w, self.N)])

    def freeze(self) -> Terms:
        """Prepare what the evaluation needs."""
        self.groups = [
            (side, name, np.array([k for k, f in enumerate(names) if f == name]))
            for side, names in enumerate((self.F, self.G))
            for name in sorted(set(names))
        ]
        self.rows = [
            [[(int(j), mpf(row[j])) for j in np.flatnonzero(row)] for row in matrix]
            for matrix in (self.A, self.W, self.C)
        ]
        self.b_mp = [mpf(x) for x in self.b]
        return self

    def at(self, z: Any) -> At:
        """Evaluate at z in double or long double."""
        return At(self, z)

    def exactly(self, z: list[Any]) -> tuple[list[Any], Callable[[list[Any]], list[Any]]]:
        """Return the values at z of mpf, and the gradient of c.values as a function of c."""
        value, parts = [mpf(0)] * self.r, []
        for a, w, c, b, F, G in zip(*self.rows, self.b_mp, self.F, self.G, strict=True):
            f = FUNCTIONS[F](mpmath.fsum(x * z[j] for j, x in a) + b, mpmath)
            g = FUNCTIONS[G](mpmath.fsum(x * z[j] for j, x in w), mpmath)
            parts.append((a, w, c, f[1] * g[0], f[0] * g[1]))
            for i, x in c:
                value[i] += x * f[0] * g[0]

        def gradient(weights: list[Any]) -> list[Any]:
            found = [mpf(0)] * self.N
            for a, w, c, along_a, along_w in parts:
                weight = mpmath.fsum(x * weights[i] for i, x in c)
                for j, x in a:
                    found[j] += weight * along_a * x
                for j, x in w:
                    found[j] += weight * along_w * x
            return found

        return value, gradient

    def expressions(self, z: list[Any]) -> list[Any]:
        """Return the sums in SymPy."""

        def linear(row: Any) -> Any:
            return sum((sp.Float(x) * z[j] for j, x in enumerate(row) if x), sp.Integer(0))

        found = [sp.Integer(0)] * self.r
        for k in range(len(self.F)):
            shift = sp.Float(self.b[k]) if self.b[k] else 0
            term = SYMBOLIC[self.F[k]](linear(self.A[k]) + shift)
            term *= SYMBOLIC[self.G[k]](linear(self.W[k]))
            for i in np.flatnonzero(self.C[k]):
                found[i] += sp.Float(self.C[k, i]) * term
        return found


def spread(entries: Any, size: int) -> Any:
    row = np.zeros(size)
    for i, x in (entries or {}).items():
        row[i] = x
    return row


class At:
    """Terms at a point: values, derivatives, and what rounding can do to them in units of u."""

    def __init__(self, terms: Terms, z: Any) -> None:
        self.terms = terms
        u, s = (terms.A * z).sum(1) + terms.b, (terms.W * z).sum(1)
        self.FG = np.empty((2, 3, len(u)), dtype=u.dtype)
        for side, name, where in terms.groups:
            self.FG[side][:, where] = FUNCTIONS[name]((u, s)[side][where], np)
        self.F, self.G = self.FG
        self.z = z

    def value(self) -> Any:
        return (self.F[0] * self.G[0]) @ self.terms.C

    def jacobian(self) -> Any:
        C, A, W = self.terms.C, self.terms.A, self.terms.W
        F, G = self.F, self.G
        return C.T @ ((F[1] * G[0])[:, None] * A) + C.T @ ((F[0] * G[1])[:, None] * W)

    def hessian(self, c: Any) -> Any:
        """Return that of c.value."""
        A, W, F, G = self.terms.A, self.terms.W, self.F, self.G
        weight = (self.terms.C @ c)[:, None]
        mixed = A.T @ (weight * (F[1] * G[1])[:, None] * W)
        return (A.T @ (weight * (F[2] * G[0])[:, None] * A) + mixed + mixed.T
                + W.T @ (weight * (F[0] * G[2])[:, None] * W))  # fmt: skip

    def sizes(self, c: Any = None) -> tuple[Any, Any]:
        """Return bounds of the rounding errors of the values, and of the gradient of c.value."""
        A, W, C = (abs(matrix) for matrix in (self.terms.A, self.terms.W, self.terms.C))
        F, G = abs(self.F), abs(self.G)
        u, s = A @ abs(self.z) + abs(self.terms.b), W @ abs(self.z)
        value = (F[0] * G[0] + F[1] * G[0] * u + F[0] * G[1] * s) @ C
        weight = 1.0 if c is None else C @ abs(c)
        along_a = F[1] * G[0] + F[2] * G[0] * u + F[1] * G[1] * s
        along_w = F[0] * G[1] + F[1] * G[1] * u + F[0] * G[2] * s
        return value, (weight * along_a) @ A + (weight * along_w) @ W


class TooLong(Exception):
    """The library has called a function too often: nothing is learnt from such a case."""


class Mechanism:
    """L = v^T M v / 2 + terms, constraints phi and a force f, all of z = (q, v, t)."""

    def __init__(self, n: int, m: int) -> None:
        self.n, self.m = n, m
        self.M = np.eye(n)
        self.lagrangian, self.phi, self.force = (Terms(2 * n + 1, r) for r in (1, m, n))
        self.kind = "linear"
        self.constant_mass, self.forced, self.smooth, self.steady = True, False, True, False
        self.timed = False
        self.calls = 0

    def freeze(self) -> Mechanism:
        for terms in (self.lagrangian, self.phi, self.force):
            terms.freeze()
        return self

    def rescaled(self, S: Any, tau: float, E: float, rows: Any) -> None:
        """Change the units of coordinates, time, energy and forms."""
        units = np.concatenate([S, S / tau, [tau]])
        for terms, out in ((self.lagrangian, [E]), (self.phi, rows), (self.force, E / S)):
            terms.A /= units
            terms.W /= units
            terms.C *= out
        self.M *= E * tau**2 / np.outer(S, S)

    def z(self, q: Any, v: Any, t: Any = 0.0) -> Any:
        return np.concatenate([q, v, [t]])

    def L_hessian(self, z: Any) -> Any:
        H = self.lagrangian.at(z).hessian(np.ones(1))[:-1, :-1]
        H[self.n :, self.n :] += self.M
        return H

    def metric(self, q: Any) -> Any:
        return self.L_hessian(self.z(q, 0 * q))[self.n :, self.n :]

    def energy(self, q: Any, v: Any) -> tuple[float, float, float]:
        """Return the energy, the kinetic one, and the size of their terms."""
        z = self.z(q, v)
        at, rest = self.lagrangian.at(z), self.lagrangian.at(self.z(q, 0 * v))
        kinetic = v @ self.metric(q) @ v / 2
        size = (abs(at.F[0] * at.G[0]) @ abs(self.lagrangian.C))[0]
        return kinetic - rest.value()[0], kinetic, kinetic + size

    def mu(self, q: Any, v: Any) -> Any:
        return self.phi.at(self.z(q, v)).jacobian()[:, self.n : -1]

    def acceleration(self, t: Any, q: Any, v: Any) -> tuple[Any, Any]:
        """Return (dv/dt, lambda) in long double: the saddle point system, refined three times."""
        n, m, z = self.n, self.m, self.z(q, v, t)
        H, J = self.L_hessian(z), self.phi.at(z).jacobian()
        L_q = self.lagrangian.at(z).jacobian()[0, :n]
        A = np.zeros((n + m, n + m), dtype=z.dtype)
        A[:n, :n], A[:n, n:], A[n:, :n] = H[n:, n:], -J[:, n:-1].T, J[:, n:-1]
        b = np.concatenate([L_q - H[n:, :n] @ v + self.force.at(z).value(), -(J[:, :n] @ v)])
        row, column = scales(H[n:, n:], J[:, n:-1])
        inverse = np.linalg.inv((row[:, None] * A * column).astype(float))
        y = np.zeros(n + m, dtype=z.dtype)
        for _ in range(4):
            y = y + column * (inverse @ (row * (b - A @ y)).astype(float))
        return y[:n], y[n:]

    def library(self, full: bool) -> Any:
        """Return the system of the library, of Python functions; not full: without Hessians.

        They raise TooLong when they have been called more often than `calls` says.
        """
        n, m, L, phi = self.n, self.m, self.lagrangian, self.phi
        zero = np.zeros(n)
        given: dict[str, Any] = {"m": m, "n": n}

        def L_z(q: Any, v: Any) -> Any:
            found = L.at(self.z(q, v)).jacobian()[0, :-1]
            found[n:] += self.M @ v
            return found

        if self.constant_mass:
            given["mass"] = self.M
            if L.F:
                given["potential"] = lambda q: -L.at(self.z(q, zero)).value()[0]
                given["gradient"] = lambda q: -L.at(self.z(q, zero)).jacobian()[0, :n]
                if full:
                    given["hessian"] = lambda q: -self.L_hessian(self.z(q, zero))[:n, :n]
        else:
            given["lagrangian"] = lambda q, v: (
                v @ self.M @ v / 2 + L.at(self.z(q, v)).value()[0]
            )
            given["lagrangian_q"] = lambda q, v: L_z(q, v)[:n]
            given["lagrangian_v"] = lambda q, v: L_z(q, v)[n:]
            given["lagrangian_vv"] = lambda q, v: self.L_hessian(self.z(q, v))[n:, n:]
            given["lagrangian_vq"] = lambda q, v: self.L_hessian(self.z(q, v))[n:, :n]
            if full:
                given["lagrangian_qq"] = lambda q, v: self.L_hessian(self.z(q, v))[:n, :n]
        if m and self.kind == "nonlinear":
            given["constraint"] = lambda q, v: phi.at(self.z(q, v)).value()
            given["constraint_v"] = self.mu
            given["constraint_q"] = lambda q, v: phi.at(self.z(q, v)).jacobian()[:, :n]
        elif m:
            def affine_q(q: Any) -> Any:
                return phi.at(self.z(q, zero)).jacobian()[:, :n]

            given["forms"] = lambda q: self.mu(q, zero)
            given["forms_velocity_derivative"] = lambda q, v: (
                phi.at(self.z(q, v)).jacobian()[:, :n] - affine_q(q)
            )
            if self.kind == "affine":
                given["affine"] = lambda q: phi.at(self.z(q, zero)).value()
                given["affine_derivative"] = affine_q
        if self.forced:
            given["force"] = lambda t, q, v: self.force.at(self.z(q, v, t)).value()
            given["force_q"] = lambda t, q, v: self.force.at(self.z(q, v, t)).jacobian()[:, :n]
            given["force_v"] = lambda t, q, v: self.force.at(self.z(q, v, t)).jacobian()[:, n:-1]
        for key, function in given.items():
            if callable(function):
                given[key] = self.counted(function)
        return dal.System(**given, steady=self.steady)

    def counted(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def count(*arguments: Any) -> Any:
            self.calls -= 1
            if self.calls < 0:
                raise TooLong
            return function(*arguments)

        return count

    def formulas(self) -> tuple[Any, dict[str, Any]]:
        """Return what `System.from_sympy` takes."""
        q = dal.coordinates([f"x{i}" for i in range(self.n)])
        v = [x.d for x in q]
        z = [*q, *v, dynamicsymbols._t]
        L = sum(
            sp.Float(self.M[i, j]) * v[i] * v[j] / 2
            for i in range(self.n) for j in range(self.n) if self.M[i, j]
        )  # fmt: skip
        return L + self.lagrangian.expressions(z)[0], {
            "constraints": self.phi.expressions(z),
            "coordinates": q,
            "force": dict(zip(q, self.force.expressions(z), strict=True)) if self.forced else None,
        }


# ---- random systems ----------------------------------------------------------------------------


@dataclass
class Case:
    """A system, a scheme, and a run of it."""

    name: str
    tags: set[str]
    mechanism: Mechanism
    scheme: Any
    q0: Any
    v0: Any
    h: float
    steps: int
    t0: float = 0.0
    options: dict[str, Any] = field(default_factory=dict)
    checks: set[str] = field(default_factory=set)
    unit: float = 1.0  # of time

    def __str__(self) -> str:
        mech = self.mechanism
        L, given = mech.formulas()
        return "\n".join(
            [
                f"{self.name}: {' '.join(sorted(self.tags))}",
                f"  L = {L}",
                *(f"  0 = {e}" for e in given["constraints"]),
                *(f"  force {x}: {e}" for x, e in (given["force"] or {}).items() if e != 0),
                f"  q0 = {self.q0.tolist()}",
                f"  v0 = {self.v0.tolist()}",
                f"  {self.scheme.name}, h = {self.h!r}, steps = {self.steps}, t0 = {self.t0!r}, "
                f"{self.options}, steady = {mech.steady}",
            ]
        )


STRUCTURES = ("dense", "sparse", "one-term", "chain", "cyclic", "steady", "blades", "dependent")
MASSES = ("scalar", "diagonal", "dense-mass", "banded", "decades", "general")


def make(seed: int, index: int) -> Case:
    """Return a case, of (seed, index) alone."""
    rng = np.random.default_rng([seed, index])
    while True:
        case = attempt(rng, f"--seed {seed} --repeat {index}")
        if case is not None:
            return case


def attempt(rng: Any, name: str) -> Case | None:
    tags: set[str] = set()

    def choose(*choices: str, p: Any = None) -> str:
        picked = str(rng.choice(choices, p=p))
        tags.add(picked)
        return picked

    def chance(p: float, tag: str) -> bool:
        if rng.random() >= p:
            return False
        tags.add(tag)
        return True

    n = int(min(12, 1 + rng.geometric(0.22)))
    m = int(min(6, n - 1, rng.geometric(0.4) - (rng.random() < 0.1)))
    mech = Mechanism(n, m)
    structure = choose(*STRUCTURES) if m else choose("free")
    kind = choose("linear", "affine", "nonlinear", p=[0.76, 0.12, 0.12]) if m else "linear"
    mass = choose(*MASSES)
    steady = structure == "steady" and n > m
    # what depends on the heading only: the last coordinate, which then has no part in the forms
    movers = n - 1 if steady else n
    mech.kind = kind
    if steady:
        kind = mech.kind = "linear"
        tags -= {"affine", "nonlinear"}
        mech.steady, mass = mass != "general", "diagonal" if mass in ("dense-mass", "banded") else mass

    # the mass
    size = 10 ** rng.uniform(-3, 3, n) if mass == "decades" else rng.uniform(0.5, 2, n)
    mech.M = np.diag(np.full(n, size[0]) if mass == "scalar" else size)
    if mass == "banded":
        off = float(rng.choice([0.04, 0.3, 0.6])) * np.eye(n, k=1)
        mech.M = 1.26 * np.eye(n) + off + off.T
    if mass in ("dense-mass", "general"):
        X = rng.normal(size=(n, n))
        mech.M = np.linalg.multi_dot([X, np.diag(10 ** rng.uniform(-1.5, 0, n)), X.T]) + 0.1 * np.eye(n)
        mech.M = (mech.M + mech.M.T) / 2
    L = mech.lagrangian
    if mass == "general":
        mech.constant_mass = False
        for _ in range(rng.integers(1, 4)):
            w = rng.normal(size=n) * (rng.random(n) < 0.6)
            c, j = rng.uniform(0.1, 1), int(rng.integers(n))
            mech.M += np.outer(w, w) * c
            L.add({0: 0.45 * c}, choose("sin", "cos", "inverse"), {j: rng.normal()},
                  rng.normal(), "x2", dict(enumerate(w, n)))  # fmt: skip
        if chance(0.4, "gyroscopic"):
            for i in range(n):
                L.add({0: rng.normal()}, "sin", {int(rng.integers(n)): 1.0}, 0.3, "x", {n + i: 1.0})
    # the potential
    for _ in range(int(rng.choice([0, 0, 1, 2, n]))):
        i, j = (int(x) for x in rng.integers(n, size=2))
        form = choose("gravity", "spring", "wall", "pendulum", "quartic", "well")
        if form == "gravity":
            L.add({0: -rng.normal()}, "x", {i: 1.0})
        elif form == "spring":
            L.add({0: -(10 ** rng.uniform(-2, 2))}, "x2", {i: 1.0} if i == j else {i: 1.0, j: -1.0})
        elif form == "wall":
            L.add({0: -(10 ** rng.uniform(0, 3))}, "wall", {i: rng.choice([-1.0, 1.0])},
                  -rng.uniform(0, 2))  # fmt: skip
            mech.smooth = False
        elif form == "pendulum":
            L.add({0: rng.normal()}, "cos", {i: 1.0} if i == j else {i: 1.0, j: 1.0})
        elif form == "quartic":
            L.add({0: -rng.uniform(0, 1)}, "x2", {i: 1.0}, 0.0, "x2", {j: 1.0})
        else:
            L.add({0: 10 ** rng.uniform(-1, 1)}, "inverse", {i: rng.uniform(0.5, 2)})
    # the force
    if not steady and chance(0.15, "forced"):
        mech.forced = True
        for i in range(n):
            form = choose("drag", "drive", "field", "gyroscope")
            j = int(rng.integers(n))
            if form == "drag":
                mech.force.add({i: -(10 ** rng.uniform(-2, 1))}, w={n + i: 1.0}, G="x")
            elif form == "drive":
                mech.force.add({i: rng.normal()}, "cos", {2 * n: rng.uniform(0.5, 3)}, rng.normal())
                mech.timed = True
            elif form == "field":
                mech.force.add({i: rng.normal()}, "sin", {j: 1.0, 2 * n: 0.3})
                mech.timed = True
            elif i != j:
                mech.force.add({i: 1.0}, "cos", {j: 1.0}, 0.0, "x", {n + j: 1.0})
                mech.force.add({j: -1.0}, "cos", {j: 1.0}, 0.0, "x", {n + i: 1.0})
    forms(rng, mech, structure, movers, chance)
    if kind == "affine":
        for a in range(m):
            mech.phi.add({a: rng.normal()}, str(rng.choice(["one", "x", "sin"])),
                         {int(rng.integers(n)): 1.0}, rng.normal())  # fmt: skip
    if kind == "nonlinear":
        for a in range(m):
            mech.phi.add({a: 0.3 * rng.normal()}, str(rng.choice(["one", "cos"])),
                         {int(rng.integers(n)): 1.0}, 0.0, "x2",
                         dict(enumerate(rng.normal(size=n), n)))  # fmt: skip
            if chance(0.5, "speed"):
                mech.phi.add({a: rng.normal()})

    # units, initial data, scheme
    S, tau = np.ones(n), 1.0
    wide = 10 * rng.random() if chance(0.25, "units") else 0.0
    if wide:
        S = 10 ** rng.uniform(-wide, wide, n)
        tau, E = 10 ** rng.uniform(-wide, wide, 2)
        mech.rescaled(S, float(tau), float(E), 10 ** rng.uniform(-wide, wide, m))
    mech.freeze()
    q0, v0 = rng.normal(size=n), rng.normal(size=n)
    if chance(0.25, "zeros"):
        q0[rng.random(n) < 0.6] = 0.0
    if chance(0.08, "origin"):
        q0[:] = 0.0
    if chance(0.15, "rest"):
        v0[:] = 0.0
    elif chance(0.1, "few-velocities"):
        v0[rng.random(n) < 0.7] = 0.0
    q0, v0 = q0 * S, v0 * S / tau
    off = v0
    found = consistent(mech, q0, v0)
    if found is None:
        return None
    v0, condition = found
    if condition > (1e12 if structure == "dependent" else 1e6):
        return None
    schemes = [*dal.schemes(), REFERENCE, BETA, BETA_NODES]
    scheme = schemes[int(rng.random() * len(schemes))]
    tags.add(scheme.name)
    large = chance(0.2, "large-h")
    h = float(10 ** (rng.uniform(-0.6, 0.7) if large else rng.uniform(-3.5, -0.6)))
    h *= float(rng.choice([-1, 1], p=[0.1, 0.9]))
    most = 200 if len(scheme.substeps) < 3 else 40
    steps = int(min(10 ** rng.uniform(0, math.log10(most)), max(1, 40 / abs(h))))
    case = Case(name, tags, mech, scheme, q0, v0, h * float(tau), steps, unit=float(tau))
    if scheme.is_reference:
        case.steps, case.h = min(steps, 5), math.copysign(min(abs(h), 0.5), h) * float(tau)
    if mech.timed:
        case.t0 = float(rng.choice([0.0, rng.normal() * 10])) * float(tau)
    if scheme.nodes == "kept":
        case.options["initial"] = choose("D", "project", "shift")
    if mech.kind == "linear" and chance(0.1, "project"):
        case.options["consistent"] = "project"
        case.v0 = off
    if not (n <= 4 and chance(0.08, "sympy")):
        chance(0.1, "no-hessians")
    for check, p in (("step", 0.4), ("multipliers", 0.3), ("order", 0.06), ("reference", 0.06)):
        if rng.random() < p:
            case.checks.add(check)
    tags.add(f"n{n}")
    return case


def forms(rng: Any, mech: Mechanism, structure: str, movers: int, chance: Any) -> None:
    """Add the linear part of the constraints; none of its terms has a velocity after movers."""
    n, m, phi = mech.n, mech.m, mech.phi
    constant = chance(0.25, "constant-forms")
    link = rng.choice([(0.5, 1, 0.1), (1, 10, 1), (1, -0.9, 1e-3)])
    noise = rng.choice([0.0, 0.05, 0.7])

    def entry(a: int, i: int, c: float, vary: float) -> None:
        phi.add({a: c}, w={n + i: 1.0}, G="x")
        if not constant and rng.random() < vary:
            j = n - 1 if movers < n else int(rng.integers(n))
            phi.add({a: c * rng.uniform(-0.7, 0.7)}, str(rng.choice(["x", "sin", "cos", "inverse"])),
                    {j: rng.choice([1.0, rng.normal()])}, float(rng.choice([0.0, rng.normal()])),
                    "x", {n + i: 1.0})  # fmt: skip

    if structure == "dependent" and m > 1:
        B = rng.normal(size=(m, movers))
        B[-1] = B[:-1].T @ rng.normal(size=m - 1) + 10 ** rng.uniform(-6, -1) * rng.normal(size=movers)
        for a in range(m):
            for i in range(movers):
                phi.add({a: B[a, i]}, w={n + i: 1.0}, G="x")
        if not constant:
            phi.add({0: 0.5}, "sin", {0: 1.0}, 0.0, "x", {n: 1.0})
        return
    for a in range(m):
        if structure == "sparse":
            for i in rng.choice(movers, size=min(movers, 3), replace=False):
                entry(a, int(i), rng.normal(), 0.5)
        elif structure == "one-term":
            phi.add({a: 10 ** rng.uniform(-2, 2)}, "one" if constant else "root",
                    {int(rng.integers(n)): 1.0}, 0.0, "x", {n + a: 1.0})  # fmt: skip
        elif structure in ("chain", "cyclic"):
            stride = 2 if 2 * m < movers else 1
            ring = m if structure == "cyclic" else movers
            for i, c in enumerate(link):
                j = (a * stride + i) % (movers if stride == 2 else max(ring, 2))
                entry(a, min(j, movers - 1), c * (1 + noise * rng.uniform(-1, 1)), 0.3)
        elif structure in ("steady", "blades") and n > 2:
            i, j = (int(x) for x in rng.choice(max(2, movers - (movers == n)), 2, replace=False))
            shift = float(rng.choice([0.0, rng.normal()]))
            phi.add({a: -1.0}, "sin", {n - 1: 1.0}, shift, "x", {n + i: 1.0})
            phi.add({a: 1.0}, "cos", {n - 1: 1.0}, shift, "x", {n + j: 1.0})
            if structure == "blades":
                phi.add({a: rng.normal()}, w={2 * n - 1: 1.0}, G="x")
        else:
            for i in range(movers):
                entry(a, i, rng.normal(), 0.4)


def consistent(mech: Mechanism, q: Any, v: Any) -> tuple[Any, float] | None:
    """Return v moved onto D, and the condition of mu M^-1 mu^T after scaling."""
    condition = 1.0
    if mech.m == 0:
        return v, condition
    M = mech.metric(q)
    for _ in range(12):
        mu = mech.mu(q, v)
        row, column = scales(M, mu)
        d, r = column[: mech.n], row[mech.n :]
        Z = np.linalg.solve(M * np.outer(d, d), (mu * d).T * r)
        C = (r[:, None] * mu * d) @ Z
        if not np.isfinite(C).all():
            return None
        condition = np.linalg.cond(C)
        if not condition < 1e13:
            return None
        v = v - d * (Z @ np.linalg.solve(C, r * mech.phi.at(mech.z(q, v)).value()))
    left = abs(row[mech.n :] * mech.phi.at(mech.z(q, v)).value()).max()
    return (v, condition) if left <= 1e-13 * max(1e-300, abs(v / d).max()) else None


def scales(M: Any, mu: Any) -> tuple[Any, Any]:
    """Return the factors of rows and columns of a saddle point matrix with M and mu."""
    d = 1 / np.sqrt(np.diag(M).astype(float))
    s = (abs(mu.astype(float)) * d).sum(1)
    s[s == 0] = 1
    return np.concatenate([d, 1 / s]), np.concatenate([d, 1 / s])


REFERENCE = dal.Scheme.find("reference")
BETA, BETA_NODES = dal.Scheme.of(0.3), dal.Scheme.find("0.3-nodes")


# ---- the equations of a scheme ------------------------------------------------------------------


class Substep:
    """The beta-scheme over h from (t, q, v), all mpf: its solution connected with h = 0.

    R1 = L_v(q', w) - L_v(q, v) - h (1-beta) (L_q + f)(q', w) - h beta (L_q + f)(q, v)
         - phi_v(q_k, (v+w)/2)^T kappa,    R2 = phi(q', w),
    q_k = q + (1-beta) h v, q' = q_k + beta h w, f at t and t + h.
    """

    def __init__(self, mech: Mechanism, beta: float, h: Any, t: Any, q: Any, v: Any) -> None:
        self.mech, self.beta = mech, beta
        self.exact = (h, t, q, v)
        self.h, self.t = float(h), float(t)
        self.q, self.v = q.astype(float), v.astype(float)
        M, mu = mech.metric(self.q), mech.mu(self.q, self.v)
        self.row, self.column = scales(M, mu)
        self.moderate = False

    def evaluate(self, y: Any, h: float) -> tuple[Any, Any]:
        """Return (R1, R2) and their Jacobian by y = (w, kappa), scaled; at a step h."""
        mech, n = self.mech, self.mech.n
        w, kappa = y[:n], y[n:]
        a, b = self.beta * h, (1 - self.beta) * h
        qk = self.q + b * self.v
        self.z0, self.zk = mech.z(self.q, self.v, self.t), mech.z(qk, (self.v + w) / 2)
        self.z1 = mech.z(qk + a * w, w, self.t + h)
        p0, p1 = (self.momenta(z) for z in (self.z0, self.z1))
        at1, atk = mech.phi.at(self.z1), mech.phi.at(self.zk)
        self.J1, self.Gk = at1.jacobian(), atk.jacobian()[:, n:-1].T
        self.Hk = atk.hessian(kappa)[n:-1, :-1]
        R1 = p1[0] - p0[0] - b * p1[1] - a * p0[1] - self.Gk @ kappa
        self.H1, self.f1 = mech.L_hessian(self.z1), mech.force.at(self.z1).jacobian()
        self.by_q1 = self.H1[n:, :n] - b * (self.H1[:n, :n] + self.f1[:, :n])
        K = self.H1[n:, n:] - b * (self.H1[:n, n:] + self.f1[:, n:-1]) - self.Hk[:, n:] / 2
        J = np.zeros((len(y), len(y)))
        J[:n, :n], J[:n, n:] = K + a * self.by_q1, -self.Gk
        J[n:, :n] = self.J1[:, n:-1] + a * self.J1[:, :n]
        R = np.concatenate([R1, at1.value()])
        return self.row * R, self.row[:, None] * J * self.column

    def momenta(self, z: Any) -> tuple[Any, Any]:
        """Return L_v and L_q + f."""
        n = self.mech.n
        L_z = self.mech.lagrangian.at(z).jacobian()[0, :-1]
        return L_z[n:] + self.mech.M @ z[n:-1], L_z[:n] + self.mech.force.at(z).value()

    def newton(self, y: Any, h: float) -> tuple[Any, float] | None:
        """Return the solution near y in units of column, and a sign, if Newton contracts there."""
        last = math.inf
        for k in range(14):
            R, J = self.evaluate(self.column * y, h)
            if not (np.isfinite(R).all() and np.isfinite(J).all()):
                return None
            try:
                d = np.linalg.solve(J, -R)
            except np.linalg.LinAlgError:
                return None
            y = y + d
            size, scale = abs(d).max(), max(abs(y).max(), abs(self.v / self.column[: len(self.v)]).max())
            if size <= 1e-13 * scale or (last <= 1e-7 * scale and size > 0.1 * last):
                return y, np.linalg.slogdet(J)[0]
            if size > (0.2 if k == 1 else 0.5) * last:
                return None
            last = size
        return None

    def follow(self, most: float) -> float:
        """Follow the solution from h = 0; return how far it came as a fraction of h."""
        y = np.concatenate([self.v, np.zeros(self.mech.m)]) / self.column
        at = self.newton(y, 0.0)
        if at is None:
            return 0.0
        (self.y, sign), done, size = at, 0.0, most
        before: tuple[Any, float] | None = None
        while done < 1.0:
            size = min(size, 1.0 - done)
            slope = 0.0 if before is None else (self.y - before[0]) / (done - before[1])
            at = self.newton(self.y + size * slope, (done + size) * self.h)
            if at is None or at[1] != sign:
                size /= 2
                if size < 1e-7:
                    return done
                continue
            self.moderate = size == 1.0
            before = self.y, done
            self.y, done, size = at[0], done + size, min(2 * size, most)
        return 1.0

    def is_fold(self) -> bool:
        """Return whether the Jacobian is about singular where the solution was lost."""
        J = self.evaluate(self.column * self.y, self.reached * self.h)[1]
        return not np.linalg.cond(J) < 1e3

    def solve(self, most: float) -> bool:
        """Solve to 50 digits; False if the solution ends before h, or the step is ill posed."""
        mech, n = self.mech, self.mech.n
        self.reached = self.follow(most)
        if self.reached < 1.0:
            return False
        _, self.J = self.evaluate(self.column * self.y, self.h)
        self.condition = np.linalg.cond(self.J, np.inf)
        if not self.condition < 1e13:
            return False
        inverse = np.linalg.inv(self.J)
        h, t, q, v = self.exact
        beta, M = mpf(self.beta), vector(mech.M)
        qk = q + (1 - beta) * h * v
        one = [mpf(1)]

        def momenta(q: Any, v: Any, t: Any) -> tuple[Any, Any]:
            z = [*q, *v, t]
            g = mech.lagrangian.exactly(z)[1](one)
            f = mech.force.exactly(z)[0]
            return vector(g[n:-1]) + M.dot(v), vector(g[:n]) + vector(f)

        p0 = momenta(q, v, t)
        y, size = vector(self.column * self.y), abs(self.y).max() + 1e-300
        for _ in range(14):
            w, kappa = y[:n], y[n:]
            q1 = qk + beta * h * w
            p1 = momenta(q1, w, t + h)
            push = mech.phi.exactly([*qk, *((v + w) / 2), mpf(0)])[1](list(kappa))[n:-1]
            R1 = p1[0] - p0[0] - h * ((1 - beta) * p1[1] + beta * p0[1]) - vector(push)
            R = np.concatenate([R1, mech.phi.exactly([*q1, *w, mpf(0)])[0]])
            d = -inverse @ (R * self.row)
            largest = max(abs(d), default=mpf(0))
            y = y + d * self.column
            if largest <= 1e-45 * size:
                break
        else:
            return False
        self.w, self.kappa = y[:n], y[n:]
        self.q1 = qk + beta * h * self.w
        return True

    def limit(self) -> tuple[Any, Any, Any]:
        """Return what rounding may do to (q', w) and kappa, in units of u, and their derivatives.

        The terms of R1 and R2 are rounded, each with its arguments (`At.sizes`), and |J^-1| times
        this changes the solution; a factorisation that is backward stable in the scaled matrix adds
        its condition times the solution.  Rounding of q' itself and of h adds to q'.
        """
        mech, n, h = self.mech, self.mech.n, self.h
        a, b = self.beta * h, (1 - self.beta) * h
        y = self.column * self.y
        w, kappa = y[:n], y[n:]
        R, J = self.evaluate(y, h)
        one, M = np.ones(1), abs(mech.M)
        L0, L1 = (mech.lagrangian.at(z).sizes(one)[1] for z in (self.z0, self.z1))
        f0, f1 = (mech.force.at(z).sizes()[0] for z in (self.z0, self.z1))
        R1 = M @ (abs(w) + abs(self.v)) + L1[n:-1] + L0[n:-1] + abs(b) * (L1[:n] + f1)
        R1 += abs(a) * (L0[:n] + f0) + mech.phi.at(self.zk).sizes(kappa)[1][n:-1]
        R2 = mech.phi.at(self.z1).sizes()[0]
        inverse = np.linalg.inv(J)
        of_terms = (abs(inverse) @ (self.row * np.concatenate([R1, R2]))).max()
        size = max(abs(self.y).max(), abs(self.v / self.column[:n]).max())
        local = self.column * (of_terms + self.condition * size)
        q1 = abs(self.q) + abs(h) * (abs(self.v) + abs(w)) + abs(a) * local[:n]
        H0, g0 = mech.L_hessian(self.z0), mech.force.at(self.z0).jacobian()
        by_q = self.by_q1 - H0[n:, :n] - a * (H0[:n, :n] + g0[:, :n]) - self.Hk[:, :n]
        by_v = b * self.by_q1 - H0[n:, n:] - a * (H0[:n, n:] + g0[:, n:-1]) - b * self.Hk[:, :n]
        by_v -= self.Hk[:, n:] / 2
        by = np.block([[by_q, by_v], [self.J1[:, :n], b * self.J1[:, :n]]])
        D = -self.column[:, None] * (inverse @ (self.row[:, None] * by))
        I = np.eye(n)
        state = np.block([[I + a * D[:n, :n], b * I + a * D[:n, n:]], [D[:n]]])
        return np.concatenate([q1, local[:n]]), local[n:], (state, D[n:])


@dataclass
class Step:
    """A step by the equations: the new state, the mean reaction, and their limits."""

    x: Any
    reaction: Any
    x_limit: Any
    reaction_limit: Any
    moderate: bool


def exact_step(case: Case, t: Any, x: Any, most: float = 1.0) -> Step | str:
    """Return a step from a stored x, or why there is none."""
    mech, n = case.mechanism, case.mechanism.n
    h = mpf(case.h)
    q, v = vector(x[:n]), vector(x[n:])
    kept = case.scheme.nodes == "kept"
    shift = (1 - mpf(case.scheme.substeps[0][0])) * h if kept else mpf(0)
    q = q - shift * v
    parts, moderate, impulse = [], True, 0 * vector(np.zeros(mech.m))
    before = np.concatenate([abs(x[:n]) + abs(case.h * x[n:]), abs(x[n:])])
    for beta, fraction in case.scheme.substeps:
        step = Substep(mech, beta, h * mpf(fraction), t, q, v)
        if not step.solve(most):
            if step.reached < 1.0 and step.is_fold():
                return f"the solution ends at {step.reached:.4g} of a sub-step of {step.h:.3g}"
            return "ill posed"
        parts.append(step.limit())
        q, v, t = step.q1, step.w, t + h * mpf(fraction)
        impulse = impulse + step.kappa
        moderate = moderate and step.moderate and step.condition < 1e6
    # each local error is carried to the end by the derivative of what comes after it
    later, total, force = np.eye(2 * n), np.zeros(2 * n), np.zeros((mech.m, 2 * n))
    reaction = np.zeros(mech.m)
    for local, kappa, (by_x, kappa_by_x) in reversed(parts):
        total += abs(later) @ local
        reaction += kappa + abs(force) @ local
        force = force @ by_x + kappa_by_x
        later = later @ by_x
    total += abs(later) @ before
    reaction += abs(force) @ before
    if kept:
        q = q + shift * v
        total[:n] += abs(float(shift)) * total[n:]
    return Step(np.concatenate([q, v]), impulse / h, 100 * U * total,
                100 * U * reaction / abs(case.h), moderate)  # fmt: skip


# ---- the flow -----------------------------------------------------------------------------------


def extrapolated(mech: Mechanism, t: float, x: Any, t1: float, tolerance: float) -> Any:
    """Return the state at t1 by extrapolation of the midpoint rule, in long double."""
    n = mech.n
    counts = np.arange(2, 22, 2)
    t, t1, x = np.longdouble(t), np.longdouble(t1), x.astype(np.longdouble)

    def field(t: Any, x: Any) -> Any:
        return np.concatenate([x[n:], mech.acceleration(t, x[:n], x[n:])[0]])

    H, steps = t1 - t, 0
    scale = np.maximum(abs(x), abs(H * field(t, x)))
    scale += 1e-3 * np.repeat([scale[:n].max(), scale[n:].max()], n) + np.longdouble(1e-300)
    while t != t1:
        steps += 1
        if steps > 400:
            return None
        H = t1 - t if abs(H) >= abs(t1 - t) else H
        table: list[Any] = []
        f0, best = field(t, x), (math.inf, None)
        for j, count in enumerate(counts):
            d = H / count
            y0, y1 = x, x + d * f0
            for i in range(1, count):
                y0, y1 = y1, y0 + 2 * d * field(t + i * d, y1)
            row = [(y0 + y1 + d * field(t + H, y1)) / 2]
            for k in range(j):
                row.append(row[k] + (row[k] - table[k]) / ((count / counts[j - k - 1]) ** 2 - 1))
            if j:
                error = float(np.max(abs(row[-1] - row[-2]) / scale))
                best = min(best, (error, j, row[-1])) if math.isfinite(error) else best
            table = row
            if best[0] <= tolerance:
                break
        if best[0] <= 100 * tolerance:
            t, x = t + H, best[-1]
            H *= 1.5 if best[0] <= tolerance else 0.9
            continue
        H /= 2
        if abs(H) < 1e-9 * abs(t1 - t):
            return None
    return x


def flow(mech: Mechanism, t: float, x: Any, t1: float) -> tuple[Any, Any] | None:
    """Return the state at t1 and a bound of its error, from two tolerances; None if unknown."""
    found = [extrapolated(mech, t, x, t1, tolerance) for tolerance in (1e-18, 1e-15)]
    if found[0] is None or found[1] is None:
        return None
    return found[0], abs(found[0] - found[1]) + 1e-18 * abs(found[0])


# ---- what is judged -----------------------------------------------------------------------------


@dataclass
class Finding:
    """Something wrong in a case."""

    what: str  # one of the words of the module's text, or "alarm"
    text: str


class Trial:
    """A case that the library has run, and what is wrong with it."""

    def __init__(self, case: Case) -> None:
        self.case, self.mech = case, case.mechanism
        self.findings: list[Finding] = []
        self.rng = np.random.default_rng(list(case.name.encode()))
        self.error: Exception | None = None
        if "sympy" in case.tags:
            L, given = self.mech.formulas()
            self.system = dal.System.from_sympy(L, **given)
        else:
            self.system = self.mech.library("no-hessians" not in case.tags)

    def integrate(self, **changed: Any) -> Any:
        """Run the case, or one like it; None if it failed with nothing done."""
        case = self.case
        given = {"h": case.h, "steps": case.steps, "t0": case.t0, **case.options, **changed}
        self.error = None
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            try:
                run = dal.integrate(self.system, case.scheme, case.q0, case.v0, **given)
            except (dal.DalembertError, ValueError, ArithmeticError) as error:
                self.error, run = error, getattr(error, "partial", None)
        self.told = [str(w.message) for w in told if issubclass(w.category, dal.DalembertWarning)]
        return run

    def judge(self) -> list[Finding]:
        """Run the case and look for all that can be wrong with it."""
        case = self.case
        self.mech.calls = 100_000
        self.run = self.integrate()
        if self.run is not None and not case.scheme.is_reference:
            bound_kept = self.check_bound()
            if self.error is None and self.told:
                about_D = [text for text in self.told if "constraint is kept" in text]
                if about_D and bound_kept:
                    self.found("alarm", about_D[0])
            if "step" in case.checks:
                self.check_steps()
            self.check_energy()
        if self.run is not None and "multipliers" in case.checks:
            self.check_multipliers()
        if self.error is not None:
            self.check_refusal()
        elif case.scheme.is_reference or "reference" in case.checks:
            self.check_reference()
        if self.error is None and "order" in case.checks and case.scheme.nodes == "moved":
            self.check_order()
        return self.findings

    def found(self, what: str, text: str) -> None:
        """Take note, unless what is wrong was told by a warning or an exception."""
        if what == "alarm" or not (self.told or self.error):
            self.findings.append(Finding(what, text))

    def forms(self, q: Any, v: Any) -> tuple[Any, Any]:
        """Return mu and phi - mu v in double, as the library gets them."""
        if "sympy" in self.case.tags and self.mech.kind == "linear":
            columns = [self.system.residual(q, e) for e in np.eye(self.mech.n)]
            return np.array(columns).T, np.zeros(self.mech.m)
        mu = self.mech.mu(q, v if self.mech.kind == "nonlinear" else 0 * v)
        if self.mech.kind == "linear":
            return mu, np.zeros(self.mech.m)
        if self.mech.kind == "affine":
            return mu, self.mech.phi.at(self.mech.z(q, 0 * v)).value()
        rest = vector(self.mech.phi.at(self.mech.z(q, v)).value()) - vector(mu).dot(vector(v))
        return mu, rest

    def check_bound(self) -> bool:
        """Compare |mu v| with 4 n u s at every stored state."""
        mech, case, run = self.mech, self.case, self.run
        n, kept, limit = mech.n, True, 4 * mech.n * U
        if mech.m == 0:
            return kept
        shift = (1 - case.scheme.substeps[0][0]) * case.h if case.scheme.nodes == "kept" else 0.0
        worst, where, rounding = 0.0, 0, np.zeros(mech.m)
        for k, (q, v) in enumerate(zip(run.q, run.v, strict=True)):
            if k == 0 and shift:
                continue
            if not (np.isfinite(q).all() and np.isfinite(v).all()):
                self.found("energy", f"state {k} is not finite")
                return False
            q = q - shift * v
            mu, rest = self.forms(q, v)
            M = mech.metric(q)
            d = np.sqrt(np.diag(np.linalg.inv(M * np.outer(*2 * [1 / np.sqrt(np.diag(M))]))))
            d = d / np.sqrt(np.diag(M))
            size = abs(mu) @ d
            residual, extra = abs(mu @ v + rest.astype(float)), abs(rest.astype(float))
            if (residual > limit / 4 * (size * math.sqrt(v @ M @ v) + extra)).any():
                residual = abs(vector(mu).dot(vector(v)) + rest)
            if mech.kind == "nonlinear":  # phi itself is rounded by the user's function
                rounding = 4 * U * mech.phi.at(mech.z(q, v)).sizes()[0]
            for a in range(mech.m):
                s = size[a] * math.sqrt(v @ M @ v) + extra[a]
                if residual[a] > limit * s + rounding[a]:
                    kept = False
                    self.found("bound", f"state {k}, form {a}: {float(residual[a] / s) / limit:.3g}"
                               f" times the bound {limit:.2g}; told {run.stats.worst_residual:.2g}")
                    return kept
                s = size[a] * (abs(v) / d).max() + extra[a]
                if k and s and float(residual[a] - rounding[a]) / s > worst:
                    worst, where = float(residual[a] - rounding[a]) / s, k
        if worst > run.stats.worst_residual * (1 + 1e-6) + n * U:
            self.found("bound", f"state {where}: residual {worst:.3g}, stats.worst_residual tells "
                       f"{run.stats.worst_residual:.3g}")  # fmt: skip
        return kept

    def check_steps(self) -> None:
        """Solve the equations of one or two steps, and compare."""
        case, run, n = self.case, self.run, self.mech.n
        last = len(run.x) - 1
        few = 2 if len(case.scheme.substeps) <= 2 else 1
        for k in sorted({last, *self.rng.integers(1, last + 1, few - 1)} if last else ()):
            x, x1 = run.x[k - 1], run.x[k]
            if not (np.isfinite(x).all() and np.isfinite(x1).all()):
                return
            t = mpf(case.t0) + (k - 1) * mpf(case.h)
            step = exact_step(case, t, x)
            if isinstance(step, Step):
                far = abs((vector(x1) - step.x).astype(float)) > step.x_limit
                if far.any():
                    step = exact_step(case, t, x, 1 / 64)  # were we on the right branch?
            if isinstance(step, str):
                if step != "ill posed":
                    self.found("step", f"step {k} is success, but {step}")
                continue
            off = abs((vector(x1) - step.x).astype(float))
            if (off > step.x_limit).any():
                i = int(np.argmax(off / step.x_limit))
                scale = max(abs(step.x[(i // n) * n :][:n])) + 1e-300
                kind = "other root" if off[i] > 1e-4 * scale else "precision"
                self.found("step", f"step {k}, {kind}: component {i} is {x1[i]:.17g}, by the "
                           f"equations {float(step.x[i]):.17g}, limit {step.x_limit[i]:.2g}")
                return
            if self.mech.m:
                off = abs((vector(run.reactions[k - 1]) - step.reaction).astype(float))
                if (off > step.reaction_limit).any():
                    a = int(np.argmax(off / step.reaction_limit))
                    self.found("reaction", f"step {k}: reaction {a} is "
                               f"{run.reactions[k - 1, a]:.17g}, by the equations "
                               f"{float(step.reaction[a]):.17g}, limit {step.reaction_limit[a]:.2g}")

    def check_energy(self) -> None:
        mech, case, run = self.mech, self.case, self.run
        if mech.kind != "linear" or mech.forced or case.scheme.order < 2 or self.error is not None:
            return
        if not np.isfinite(run.x).all():
            return self.found("energy", "a state is not finite")
        energies = np.array([mech.energy(q, v) for q, v in zip(run.q, run.v, strict=True)])
        half = 0.5 * energies[:, 1].max() + 1e-10 * energies[:, 2].max()
        change = abs(energies[-1, 0] - energies[0, 0])
        if not change <= half:
            self.found("energy", f"{energies[0, 0]:.6g} -> {energies[-1, 0]:.6g} in {case.steps} "
                       f"steps, largest kinetic energy {energies[:, 1].max():.3g}")
        return None

    def check_multipliers(self) -> None:
        """Compare lambda(q, v) with a solve in long double, perturbed to know its condition."""
        mech, run = self.mech, self.run
        if mech.m == 0 or not np.isfinite(run.x).all():
            return
        k = int(self.rng.integers(len(run.x)))
        t = np.longdouble(self.case.t0) + k * np.longdouble(self.case.h)
        q, v = run.x[k].astype(np.longdouble).reshape(2, -1)
        values = []
        for i in range(5):
            by = 1 + (i > 0) * 1e-9 * self.rng.uniform(-1, 1, (3, mech.n))
            values.append(mech.acceleration(t * by[2, 0], q * by[0], v * by[1])[1])
        at = mech.L_hessian(mech.z(q, v, t))[mech.n :, mech.n :]
        mu = mech.mu(q, v)
        row, column = scales(at, mu)
        A = np.block([[at, -mu.T], [mu, np.zeros(2 * [mech.m])]]).astype(float)
        condition = np.linalg.cond(row[:, None] * A * column, np.inf)
        acceleration, exact = mech.acceleration(t, q, v)
        size = np.max(abs(np.concatenate([acceleration, exact]) / column))
        spread_of = np.max([abs(value - exact) for value in values], axis=0) / 1e-9
        limit = 100 * U * (condition * size * column[mech.n :] + spread_of)
        off = abs(run.multipliers[k] - exact)
        if condition < 1e13 and not (off <= limit).all():
            a = int(np.argmax(off / limit))
            self.found("reaction", f"multiplier {a} at state {k} is {run.multipliers[k, a]:.17g}, "
                       f"expected {float(exact[a]):.17g}, limit {float(limit[a]):.2g}")

    def check_reference(self) -> None:
        """Compare `reference` with extrapolation in long double."""
        case, run = self.case, self.run
        if not self.mech.smooth or case.options.get("initial") or self.mech.n > 8:
            return
        x0, t0 = run.x[0], case.t0
        t1 = t0 + case.unit * float(self.rng.choice([0.3, 1.0, 2.0]))
        n = self.mech.n
        try:
            told = dal.reference(self.system, x0[:n], x0[n:], t1, t0)
        except (dal.DalembertError, ValueError) as error:
            self.error = error
            if flow(self.mech, t0, x0, t1) is not None:
                self.found("alarm", f"reference to t = {t1}: {error}")
            return
        exact = flow(self.mech, t0, x0, t1)
        if exact is None:
            return
        off = abs(np.concatenate([told.q, told.v]) - exact[0])
        allowed = 10 * max(told.accuracy, 4 * U * abs(exact[0]).max()) + 10 * exact[1].max()
        if not off.max() <= allowed:
            self.found("reference", f"from {t0} to {t1}: off by {float(off.max()):.3g}, claimed "
                       f"{told.accuracy:.3g}; state {float(abs(exact[0]).max()):.3g}, own error "
                       f"{float(exact[1].max()):.2g}")  # fmt: skip

    def check_order(self) -> None:
        """Measure the slope of one-step errors from exact data."""
        case, mech = self.case, self.mech
        p, n = case.scheme.order, mech.n
        if case.scheme.is_reference or not mech.smooth or p == 0 or n > 8:
            return
        x0 = self.run.x[0]
        case.q0, case.v0 = x0[:n], x0[n:]
        d = 1 / np.sqrt(np.diag(mech.metric(case.q0)))
        errors: list[tuple[float, float]] = []
        for j in range(10):
            h = case.unit * (0.5 if p > 2 else 0.1) / 2**j
            run = self.integrate(h=h, steps=1, consistent="assume")
            exact = flow(mech, case.t0, x0, case.t0 + h) if run is not None else None
            if self.error is not None or exact is None:
                continue
            scale = float(max(abs(exact[0][n:] / d).max(), 1e-300))
            size = max(scale, float(abs(x0[:n] / d).max()) / case.unit)
            off = abs(run.x[1] - exact[0])
            error = float(max((off[:n] / d).max() / case.unit, (off[n:] / d).max())) / scale
            if error < 2000 * U * size / scale * max(1.0, len(case.scheme.substeps) / 4):
                break
            errors.append((h, error))
        self.error = None
        slopes = [
            math.log2(a[1] / b[1]) for a, b in zip(errors, errors[1:], strict=False)
            if a[0] == 2 * b[0]
        ]
        if len(slopes) >= 3 and max(slopes[-3:]) - min(slopes[-3:]) < 0.15 and max(slopes[-2:]) < p + 0.8:
            self.found("order", f"slopes {[round(s, 2) for s in slopes]}, promised {p + 1}; errors "
                       f"{[f'{e:.2g}' for _, e in errors]}")  # fmt: skip

    def check_refusal(self) -> None:
        """Call it a false alarm if the equations have a moderate solution."""
        case, error = self.case, self.error
        text = f"{type(error).__name__}: {error}"
        if self.run is None:
            if "dependent" not in case.tags:
                self.found("alarm", f"at the start: {text}")
            return
        k = len(self.run.x) - 1
        if case.scheme.is_reference:
            t0 = case.t0 + k * case.h
            if self.mech.smooth and flow(self.mech, t0, self.run.x[k], t0 + case.h) is not None:
                self.found("alarm", text)
            return
        step = exact_step(case, mpf(case.t0) + k * mpf(case.h), self.run.x[k])
        if isinstance(step, Step) and step.moderate:
            self.found("alarm", f"step {k + 1} has a moderate solution: {text}")


# ---- the campaign -------------------------------------------------------------------------------


def cases(seed: int, only: str | None) -> Iterator[tuple[int, Case]]:
    index = 0
    while True:
        case = make(seed, index)
        if only is None or only in case.tags:
            yield index, case
        index += 1


def main() -> int:
    parser = argparse.ArgumentParser(description="A random campaign.")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--first", type=int, default=0, help="the first case")
    parser.add_argument("--only", metavar="KIND", help="a tag: chain, units, midpoint-kl8, ...")
    parser.add_argument("--repeat", type=int, metavar="CASE", help="one case, with all checks")
    given = parser.parse_args()
    np.seterr(all="ignore")
    if given.repeat is not None:
        case = make(given.seed, given.repeat)
        case.checks |= {"step", "multipliers", "order", "reference"}
        print(case)
        trial = Trial(case)
        for finding in trial.judge():
            print(f"{finding.what}: {finding.text}")
        print(f"told: {trial.told}, error: {trial.error!r}")
        return len(trial.findings)
    made, silent, alarms = (collections.Counter() for _ in range(3))
    index, end = -1, time.monotonic() + 60 * given.minutes
    bar = tqdm(unit=" cases", mininterval=1.0)
    try:
        for index, case in cases(given.seed, given.only):
            if time.monotonic() > end:
                break
            for tag in case.tags:
                made[tag] += 1
            try:
                findings = Trial(case).judge()
            except TooLong:
                made["too-long"] += 1
                continue
            for finding in findings:
                count = alarms if finding.what == "alarm" else silent
                count[finding.what if count is silent else finding.text.split(":")[0]] += 1
                tqdm.write(f"{finding.what.upper()}: {finding.text}\n{case}\n")
            bar.update()
            bar.set_postfix(silent=sum(silent.values()), alarms=sum(alarms.values()), case=index)
    except KeyboardInterrupt:
        pass
    bar.close()
    print("cases by kind:", ", ".join(f"{tag} {count}" for tag, count in sorted(made.items())))
    print(f"silent errors: {sum(silent.values())} {dict(silent)}")
    print(f"false alarms: {sum(alarms.values())} {dict(alarms)}")
    print(f"seed {given.seed}, {bar.n} cases, the last {index}")
    return bool(silent)


if __name__ == "__main__":
    raise SystemExit(main())
