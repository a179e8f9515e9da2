"""Random mechanical systems for the campaign: sums of terms c F(a.z + b) G(w.z), z = (q, v, t).

All their derivatives are then a few lines, in double, in long double and with 55 digits; and
nothing here is computed by the library.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mpmath
import numpy as np
import sympy as sp

import dalembert as dal

mpmath.mp.dps = 55
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

    def translate(self, c: Any) -> None:
        """Put z - c in place of z, where no G depends on what c moves."""
        self.b = self.b - self.A @ c

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
        self.F, self.G = both = np.empty((2, 3, len(u)), dtype=u.dtype)
        for side, name, where in terms.groups:
            both[side][:, where] = FUNCTIONS[name]((u, s)[side][where], np)
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
        self.timed = self.rheonomic = False  # the force, the constraints depend on time
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

    def translated(self, c: Any) -> Any:
        """Move the origin of z to c, but for coordinates that a G depends on; return c."""
        every = (self.lagrangian, self.phi, self.force)
        c = np.where(sum(abs(terms.W).sum(0) for terms in every), 0.0, c)
        for terms in every:
            terms.translate(c)
        return c

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

    def mu(self, q: Any, v: Any, t: Any = 0.0) -> Any:
        return self.phi.at(self.z(q, v, t)).jacobian()[:, self.n : -1]

    def acceleration(self, t: Any, q: Any, v: Any) -> tuple[Any, Any]:
        """Return (dv/dt, lambda) in long double: the saddle point system, refined three times."""
        n, m, z = self.n, self.m, self.z(q, v, t)
        H, J = self.L_hessian(z), self.phi.at(z).jacobian()
        L_q = self.lagrangian.at(z).jacobian()[0, :n]
        A = np.zeros((n + m, n + m), dtype=z.dtype)
        A[:n, :n], A[:n, n:], A[n:, :n] = H[n:, n:], -J[:, n:-1].T, J[:, n:-1]
        force, along = self.force.at(z).value(), J[:, :n] @ v + J[:, -1]
        b = np.concatenate([L_q - H[n:, :n] @ v + force, -along])
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
        if self.rheonomic:
            given = {key: timeless(f) if callable(f) else f for key, f in given.items()}
        given |= self.constraints()
        if self.forced:
            given["force"] = lambda t, q, v: self.force.at(self.z(q, v, t)).value()
            given["force_q"] = lambda t, q, v: self.force.at(self.z(q, v, t)).jacobian()[:, :n]
            given["force_v"] = lambda t, q, v: self.force.at(self.z(q, v, t)).jacobian()[:, n:-1]
        for key, function in given.items():
            if callable(function):
                given[key] = self.counted(function)
        return dal.System(**given, steady=self.steady)

    def constraints(self) -> dict[str, Any]:
        """Return what `library` gives of them: functions of (t, q, v), (t, q) or without t."""
        n, phi = self.n, self.phi
        zero = np.zeros(n)

        def affine_q(t: Any, q: Any) -> Any:
            return phi.at(self.z(q, zero, t)).jacobian()[:, :n]

        given: dict[str, Any] = {}
        if self.m and self.kind == "nonlinear":
            given["constraint"] = lambda t, q, v: phi.at(self.z(q, v, t)).value()
            given["constraint_v"] = lambda t, q, v: self.mu(q, v, t)
            given["constraint_q"] = lambda t, q, v: phi.at(self.z(q, v, t)).jacobian()[:, :n]
        elif self.m:
            given["mu"] = lambda t, q: self.mu(q, zero, t)
            given["mu_v_q"] = lambda t, q, v: (
                phi.at(self.z(q, v, t)).jacobian()[:, :n] - affine_q(t, q)
            )
            if self.kind == "affine":
                given["affine"] = lambda t, q: phi.at(self.z(q, zero, t)).value()
                given["affine_derivative"] = affine_q
        if not self.rheonomic:
            return {key: functools.partial(function, 0.0) for key, function in given.items()}
        given["constraint_t"] = lambda t, q, v: phi.at(self.z(q, v, t)).jacobian()[:, -1]
        return given | {"time_dependent": True}

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
        z = [*q, *v, dal.time]
        L = sum(
            sp.Float(self.M[i, j]) * v[i] * v[j] / 2
            for i in range(self.n) for j in range(self.n) if self.M[i, j]
        )  # fmt: skip
        return L + self.lagrangian.expressions(z)[0], {
            "constraints": self.phi.expressions(z),
            "coordinates": q,
            "force": dict(zip(q, self.force.expressions(z), strict=True)) if self.forced else None,
        }


def timeless(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that takes a time, too, and does not look at it."""
    return lambda t, *arguments: function(*arguments)


# ---- random cases --------------------------------------------------------------------------------

SCHEMES = [*dal.schemes(), dal.Scheme.find("reference"), dal.Scheme.of(0.3),
           dal.Scheme.find("0.3-nodes")]  # fmt: skip
STRUCTURES = ("dense", "sparse", "one-term", "chain", "cyclic", "steady", "blades", "dependent")
MASSES = ("scalar", "diagonal", "dense-mass", "banded", "decades", "general")


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
        L, given = self.mechanism.formulas()
        forces = {x: e for x, e in (given["force"] or {}).items() if e != 0}
        return "\n".join(
            [
                f"{self.name}: {' '.join(sorted(self.tags))}",
                f"  L = {L}",
                *(f"  0 = {e}" for e in given["constraints"]),
                *(f"  force {x}: {e}" for x, e in forces.items()),
                f"  q0 = {self.q0.tolist()}",
                f"  v0 = {self.v0.tolist()}",
                f"  {self.scheme.name}, h = {self.h!r}, steps = {self.steps}, t0 = {self.t0!r}, "
                f"{self.options}, steady = {self.mechanism.steady}",
            ]
        )


def make(seed: int, index: int) -> Case:
    """Return a case, of (seed, index) alone."""
    rng = np.random.default_rng([seed, index])
    while (case := Maker(rng).case(f"--seed {seed} --repeat {index}")) is None:
        pass
    return case


class Maker:
    """Makes one case; what it chooses stands in its tags."""

    def __init__(self, rng: Any) -> None:
        self.rng, self.tags = rng, set()
        self.n = n = int(min(12, 1 + rng.geometric(0.22)))
        self.m = int(min(6, n - 1, rng.choice([0, 1, 1, 1, 2, 2, 2, 3, 3, 4, 5, 6])))
        self.mech = Mechanism(n, self.m)
        self.structure = self.choose(*STRUCTURES) if self.m else self.choose("free")
        # steady: the forms depend on the last coordinate only, and have no term with its velocity
        self.movers = n - 1 if self.structure == "steady" else n

    def choose(self, *choices: str, p: Any = None) -> str:
        picked = str(self.rng.choice(choices, p=p))
        self.tags.add(picked)
        return picked

    def chance(self, p: float, tag: str) -> bool:
        if self.rng.random() >= p:
            return False
        self.tags.add(tag)
        return True

    def any(self) -> int:
        return int(self.rng.integers(self.n))

    def mass(self) -> None:
        n, rng, mech = self.n, self.rng, self.mech
        steady = self.structure == "steady"
        mass = self.choose(*(MASSES[:2] + MASSES[4:] if steady else MASSES))
        mech.steady = steady and mass != "general" and self.chance(0.7, "declared-steady")
        size = 10 ** rng.uniform(-3, 3, n) if mass == "decades" else rng.uniform(0.5, 2, n)
        mech.M = np.diag(np.full(n, size[0]) if mass == "scalar" else size)
        if mass == "banded":
            off = float(rng.choice([0.04, 0.3, 0.6])) * np.eye(n, k=1)
            mech.M = 1.26 * np.eye(n) + off + off.T
        if mass in ("dense-mass", "general"):
            X = rng.normal(size=(n, n))
            mech.M = X @ np.diag(10 ** rng.uniform(-1.5, 0, n)) @ X.T + 0.1 * np.eye(n)
            mech.M = (mech.M + mech.M.T) / 2
        if mass != "general":
            return
        mech.constant_mass = False
        for _ in range(rng.integers(1, 4)):
            w, c = rng.normal(size=n) * (rng.random(n) < 0.6), rng.uniform(0.1, 1)
            mech.M += np.outer(w, w) * c  # so that the sum stays positive definite
            F = str(rng.choice(["sin", "cos", "inverse"]))
            a, b = {self.any(): rng.normal()}, rng.normal()
            mech.lagrangian.add({0: 0.45 * c}, F, a, b, "x2", dict(enumerate(w, n)))
        if self.chance(0.4, "gyroscopic"):
            for i in range(n):
                c, a = {0: rng.normal()}, {self.any(): 1.0}
                mech.lagrangian.add(c, "sin", a, 0.3, "x", {n + i: 1.0})

    def potential(self) -> None:
        rng, L = self.rng, self.mech.lagrangian
        for _ in range(int(rng.choice([0, 0, 1, 2, self.n]))):
            i, j = self.any(), self.any()
            form = self.choose("gravity", "spring", "wall", "pendulum", "quartic", "well")
            if form == "gravity":
                L.add({0: -rng.normal()}, "x", {i: 1.0})
            elif form == "spring":
                a = {i: 1.0} if i == j else {i: 1.0, j: -1.0}
                L.add({0: -(10 ** rng.uniform(-2, 2))}, "x2", a)
            elif form == "wall":
                c, a = {0: -(10 ** rng.uniform(0, 3))}, {i: rng.choice([-1.0, 1.0])}
                L.add(c, "wall", a, -rng.uniform(0, 2))
                self.mech.smooth = False
            elif form == "pendulum":
                L.add({0: rng.normal()}, "cos", {i: 1.0} if i == j else {i: 1.0, j: 1.0})
            elif form == "quartic":
                L.add({0: -rng.uniform(0, 1)}, "x2", {i: 1.0}, 0.0, "x2", {j: 1.0})
            else:
                L.add({0: 10 ** rng.uniform(-1, 1)}, "inverse", {i: rng.uniform(0.5, 2)})

    def force(self) -> None:
        n, rng, force = self.n, self.rng, self.mech.force
        if self.mech.steady or not self.chance(0.15, "forced"):
            return
        self.mech.forced = True
        for i in range(n):
            form, j = self.choose("drag", "drive", "field", "gyroscope"), self.any()
            self.mech.timed |= form in ("drive", "field")
            if form == "drag":
                force.add({i: -(10 ** rng.uniform(-2, 1))}, G="x", w={n + i: 1.0})
            elif form == "drive":
                force.add({i: rng.normal()}, "cos", {2 * n: rng.uniform(0.5, 3)}, rng.normal())
            elif form == "field":
                force.add({i: rng.normal()}, "sin", {j: 1.0, 2 * n: 0.3})
            elif i != j:
                force.add({i: 1.0}, "cos", {j: 1.0}, 0.0, "x", {n + j: 1.0})
                force.add({j: -1.0}, "cos", {j: 1.0}, 0.0, "x", {n + i: 1.0})

    def forms(self) -> None:
        """Add the linear part of the constraints."""
        n, m, movers, rng, phi = self.n, self.m, self.movers, self.rng, self.mech.phi
        constant = self.chance(0.25, "constant-forms")
        link = rng.choice([(0.5, 1, 0.1), (1, 10, 1), (1, -0.9, 1e-3)])
        noise = rng.choice([0.0, 0.05, 0.7])

        def entry(a: int, i: int, c: float, vary: float) -> None:
            w = {n + i: 1.0}
            phi.add({a: c}, G="x", w=w)
            if not constant and rng.random() < vary:
                along = {self.any() if movers == n else n - 1: rng.choice([1.0, rng.normal()])}
                F, b = str(rng.choice(["x", "sin", "cos", "inverse"])), float(rng.normal())
                b *= rng.integers(2)
                phi.add({a: c * rng.uniform(-0.7, 0.7)}, F, along, b, "x", w)

        dependent = rng.normal(size=(m, movers))
        if self.structure == "dependent" and m > 1:
            dependent[-1] *= 10 ** rng.uniform(-6, -1)
            dependent[-1] += rng.normal(size=m - 1) @ dependent[:-1]
        for a in range(m):
            if self.structure == "dependent":
                for i in range(movers):
                    phi.add({a: dependent[a, i]}, G="x", w={n + i: 1.0})
            elif self.structure == "sparse":
                for i in rng.choice(movers, size=min(movers, 3), replace=False):
                    entry(a, int(i), rng.normal(), 0.5)
            elif self.structure == "one-term":
                c, F = 10 ** rng.uniform(-2, 2), "one" if constant else "root"
                phi.add({a: c}, F, {self.any(): 1.0}, 0.0, "x", {n + a: 1.0})
            elif self.structure in ("chain", "cyclic"):
                stride = 2 if 2 * m < movers else 1
                ring = max(m, 2) if self.structure == "cyclic" and stride == 1 else movers
                for i, c in enumerate(link):
                    j = (a * stride + i) % ring
                    entry(a, min(j, movers - 1), c * (1 + noise * rng.uniform(-1, 1)), 0.3)
            elif self.structure in ("steady", "blades") and n > 2:
                i, j = (int(x) for x in rng.choice(n - 1, 2, replace=False))
                shift = float(rng.normal()) * rng.integers(2)
                phi.add({a: -1.0}, "sin", {n - 1: 1.0}, shift, "x", {n + i: 1.0})
                phi.add({a: 1.0}, "cos", {n - 1: 1.0}, shift, "x", {n + j: 1.0})
                if self.structure == "blades":
                    phi.add({a: rng.normal()}, G="x", w={2 * n - 1: 1.0})
            else:
                for i in range(movers):
                    entry(a, i, rng.normal(), 0.4)
        if self.structure == "dependent" and not constant:
            phi.add({0: 0.5}, "sin", {0: 1.0}, 0.0, "x", {n: 1.0})

    def beyond_linear(self) -> None:
        """Add what is not linear in the constraints."""
        n, rng, mech = self.n, self.rng, self.mech
        if self.m == 0 or self.structure == "steady":
            self.tags.add("linear")
            return
        mech.kind = self.choose("linear", "affine", "nonlinear", p=[0.68, 0.16, 0.16])
        follows = mech.kind == "affine" and self.chance(0.3, "baumgarte")
        for a in range(self.m):
            if follows:  # k (y - f(x)), f = sin or cos
                k = 10 ** rng.uniform(0, 3)
                mech.phi.add({a: k}, "x", {self.any(): 1.0}, rng.normal())
                mech.phi.add({a: k}, str(rng.choice(["sin", "cos"])), {self.any(): 1.0})
            elif mech.kind == "affine":
                F = str(rng.choice(["one", "x", "sin"]))
                mech.phi.add({a: rng.normal()}, F, {self.any(): 1.0}, rng.normal())
            elif mech.kind == "nonlinear":
                w = dict(enumerate(rng.normal(size=n), n))
                F = str(rng.choice(["one", "cos"]))
                mech.phi.add({a: 0.3 * rng.normal()}, F, {self.any(): 1.0}, 0.0, "x2", w)
                mech.phi.add({a: rng.normal() * rng.integers(2)})
        mech.rheonomic = self.chance(0.2, "rheonomic")
        for a in range(self.m if mech.rheonomic else 0):
            F, omega = str(rng.choice(["x", "sin", "cos"])), rng.uniform(0.3, 2)
            if mech.kind == "linear":
                w = {n + self.any(): 1.0}
                mech.phi.add({a: 0.5 * rng.normal()}, "sin", {2 * n: omega}, 0.0, "x", w)
            else:
                mech.phi.add({a: rng.normal()}, F, {2 * n: omega}, rng.normal())

    def offset(self, S: Any, tau: float) -> Any:
        """Move the origin of coordinates and time; return where to."""
        n, rng = self.n, self.rng
        c = np.zeros(2 * n + 1)
        if self.chance(0.3, "offset"):
            c[:n] = S * rng.choice([-1, 1], n) * 10 ** rng.uniform(0, 5, n)
            c[:n][rng.random(n) < 0.4] = 0.0
            if self.mech.timed or self.mech.rheonomic:
                c[-1] = tau * rng.choice([-1, 1]) * 10 ** rng.uniform(0, 6)
        return self.mech.translated(c)

    def units(self) -> tuple[Any, float]:
        """Change the units; return those of coordinates and time."""
        n, rng = self.n, self.rng
        if not self.chance(0.25, "units"):
            return np.ones(n), 1.0
        wide = 10 * rng.random()
        S, tau, E = 10 ** rng.uniform(-wide, wide, n), *(10 ** rng.uniform(-wide, wide, 2))
        self.mech.rescaled(S, tau, E, 10 ** rng.uniform(-wide, wide, self.m))
        return S, float(tau)

    def start(self, S: Any, tau: float) -> tuple[Any, Any]:
        """Return initial data, off D."""
        n, rng = self.n, self.rng
        q0, v0 = rng.normal(size=n), rng.normal(size=n)
        if self.chance(0.25, "zeros"):
            q0[rng.random(n) < 0.6] = 0.0
        if self.chance(0.08, "origin"):
            q0[:] = 0.0
        if self.chance(0.15, "rest"):
            v0[:] = 0.0
        elif self.chance(0.1, "few-velocities"):
            v0[rng.random(n) < 0.7] = 0.0
        return q0 * S, v0 * S / tau

    def case(self, name: str) -> Case | None:
        """Return the case, or None where there are no consistent data to start from."""
        rng, mech = self.rng, self.mech
        for part in (self.mass, self.potential, self.force, self.forms, self.beyond_linear):
            part()
        S, tau = self.units()
        origin = self.offset(S, tau)
        mech.freeze()
        q0, off = self.start(S, tau)
        q0 = q0 + origin[: self.n]
        t0 = float(origin[-1])
        if mech.timed or mech.rheonomic:
            t0 += tau * float(rng.choice([0.0, rng.normal() * 10]))
        v0, condition = consistent(mech, q0, off, t0)
        if not condition <= (1e12 if self.structure == "dependent" else 1e6):
            return None
        scheme = SCHEMES[int(rng.random() * len(SCHEMES))]
        self.tags |= {scheme.name, f"n{self.n}", f"m{self.m}"}
        large = self.chance(0.2, "large-h")
        h = 10 ** (rng.uniform(-0.6, 0.7) if large else rng.uniform(-3.5, -0.6))
        most = 150 if len(scheme.substeps) < 3 else 30
        steps = int(min(10 ** rng.uniform(0, math.log10(most)), max(1, 40 / h)))
        if scheme.is_flow:
            h, steps = min(h, 0.5), min(steps, 5)
        h *= tau * float(rng.choice([-1, 1], p=[0.1, 0.9]))
        case = Case(name, self.tags, mech, scheme, q0, v0, h, steps, t0, unit=tau)
        if scheme.nodes == "kept":
            case.options["initial"] = self.choose("D", "project", "shift")
        if mech.kind == "linear" and self.chance(0.1, "project"):
            case.options["consistent"], case.v0 = "project", off
        if not (self.n <= 4 and self.chance(0.08, "sympy")):
            self.chance(0.1, "no-hessians")
        for check, p in (("step", 0.4), ("multipliers", 0.3), ("order", 0.06), ("reference", 0.06)):
            if rng.random() < p:
                case.checks.add(check)
        return case


def consistent(mech: Mechanism, q: Any, v: Any, t: float) -> tuple[Any, float]:
    """Return v moved onto D, and the condition of mu M^-1 mu^T after scaling; inf: no success."""
    condition = 1.0
    if mech.m == 0:
        return v, condition
    M = mech.metric(q)
    for _ in range(12):
        mu = mech.mu(q, v, t)
        row, column = scales(M, mu)
        d, r = column[: mech.n], row[mech.n :]
        Z = np.linalg.solve(M * np.outer(d, d), (mu * d).T * r)
        C = (r[:, None] * mu * d) @ Z
        condition = np.linalg.cond(C) if np.isfinite(C).all() else math.inf
        if not condition < 1e13:
            return v, math.inf
        v = v - d * (Z @ np.linalg.solve(C, r * mech.phi.at(mech.z(q, v, t)).value()))
    at = mech.phi.at(mech.z(q, v, t))
    left = (abs(row[mech.n :] * at.value()) - 4 * 2.0**-53 * row[mech.n :] * at.sizes()[0]).max()
    return v, condition if left <= 1e-13 * max(1e-300, abs(v / d).max()) else math.inf


def scales(M: Any, mu: Any) -> tuple[Any, Any]:
    """Return the factors of rows and columns of a saddle point matrix with M and mu."""
    d = 1 / np.sqrt(np.diag(M).astype(float))
    s = (abs(mu.astype(float)) * d).sum(1)
    s[s == 0] = 1
    return np.concatenate([d, 1 / s]), np.concatenate([d, 1 / s])
