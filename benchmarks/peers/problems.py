"""The problems: Lagrangian, constraints, force and start of each, and the equations they lead to.

Everything here is SymPy alone: `Problem.equations` eliminates the multipliers by hand,

    v' = M^-1 (F + mu^T lambda),   lambda = -(mu M^-1 mu^T)^-1 (mu M^-1 F + (mu v)_q v + (mu v)_t),

with M = L_vv and F = f + L_q - L_vq v, so that all peers solve the same equations, and dalembert
gets the Lagrangian, the constraints and the force as they stand.  Who reduces by hand goes on, to
n - m velocities w in a basis of D, v = B(q) w, which every problem here has for all q:

    w' = (B^T M B)^-1 B^T (F - M (B w)_q B w).

`Problem.odes` has both, as systems of first order.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy as sp

t = sp.Symbol("t")


@dataclass(frozen=True)
class Equations:
    """What of a problem is computed with; each is a SymPy expression or matrix in (t, q, v)."""

    M: sp.Matrix  # n x n
    F: sp.Matrix  # n, force, all inertial forces but M v', and -V_q
    mu: sp.Matrix  # m x n
    D: sp.Matrix  # m x n, (mu v)_q
    force: sp.Matrix  # n, F without what the velocities in L contribute: -V_q + f
    acceleration: sp.Matrix  # n, v' without multipliers
    free: sp.Matrix  # n, M^-1 F
    pull: sp.Matrix  # n x m, M^-1 mu^T
    energy: sp.Expr
    constant_mass: bool
    velocity_force: bool  # F depends on v


@dataclass(frozen=True)
class Problem:
    """A system and its start; all numbers are exact."""

    name: str
    title: str
    text: str  # formulas, for the page
    q: tuple[sp.Symbol, ...]
    v: tuple[sp.Symbol, ...]
    L: sp.Expr
    constraints: tuple[sp.Expr, ...]
    q0: tuple[Any, ...]
    v0: tuple[Any, ...]
    basis: sp.Matrix  # n x (n - m), B(q)
    force: dict[sp.Symbol, sp.Expr] = field(default_factory=dict)
    reversible: bool = True  # run backwards, the motion is itself again
    pace: int = 1  # all steps are so many times shorter than on other problems

    @property
    def conserves(self) -> bool:
        """Whether the energy is an invariant."""
        return not self.force

    @property
    def start(self) -> list[float]:
        return [float(x) for x in (*self.q0, *self.v0)]

    @functools.cached_property
    def equations(self) -> Equations:
        q, v = sp.Matrix(self.q), sp.Matrix(self.v)
        p = sp.Matrix([self.L]).jacobian(v)
        M = p.jacobian(v).applyfunc(sp.trigsimp)
        f = sp.Matrix([self.force.get(x, 0) for x in self.q])
        V_q = -sp.Matrix([self.L.subs(dict.fromkeys(self.v, 0))]).jacobian(q).T
        F = (f + sp.Matrix([self.L]).jacobian(q).T - p.jacobian(q) * v).expand()
        phi = sp.Matrix(self.constraints)
        mu, D = phi.jacobian(v), phi.jacobian(q)
        inverse = M.inv().applyfunc(sp.simplify)
        free, pull = inverse * F, inverse * mu.T
        C = (mu * pull).applyfunc(sp.simplify)
        rest = mu * free + D * v + phi.diff(t)
        multipliers = -(C.inv() * rest)
        energy = (p * v)[0] - self.L
        return Equations(
            M, F, mu, D, f - V_q, free + pull * multipliers, free, pull, sp.expand(energy),
            not M.free_symbols, any(F.has(x) for x in self.v),
        )  # fmt: skip

    @functools.cached_property
    def odes(self) -> tuple[Ode, Ode]:
        """The ODE for (q, v), and that for (q, w) with v = B(q) w."""
        e, B, q, v = self.equations, self.basis, sp.Matrix(self.q), sp.Matrix(self.v)
        assert (e.mu * B).applyfunc(sp.simplify).is_zero_matrix
        w = sp.Matrix(sp.symbols(f"w0:{B.cols}"))
        moved = (B * w).jacobian(q) * B * w
        F = e.F.subs(dict(zip(v, B * w)), simultaneous=True)
        matrix = (B.T * e.M * B).applyfunc(sp.simplify)
        rates = matrix.inv().applyfunc(sp.simplify) * (B.T * (F - e.M * moved))
        return (
            Ode("", (*q, *v), (*v, *e.acceleration), len(q), None),
            Ode(" in D", (*q, *w), (*(B * w), *rates.applyfunc(sp.trigsimp)), len(q), B),
        )


class Ode:
    """y' = f(t, y), and what y is for a state x = (q, v); of n coordinates."""

    def __init__(self, name: str, symbols: tuple[sp.Symbol, ...], rates: tuple[sp.Expr, ...],
                 n: int, basis: sp.Matrix | None) -> None:  # fmt: skip
        self.name, self.symbols, self.rates, self.n = name, symbols, rates, n
        if basis is not None:
            q, w, v = symbols[:n], symbols[n:], sp.Matrix(sp.symbols(f"v0:{n}"))
            gram = (basis.T * basis).applyfunc(sp.simplify)
            within = gram.inv().applyfunc(sp.simplify) * basis.T * v
            self._within = sp.lambdify([(*q, *v)], [*q, *within], cse=True)
            self._velocity = sp.lambdify([symbols], list(basis * sp.Matrix(w)), cse=True)
        self._reduced = basis is not None

    def into(self, x: np.ndarray) -> np.ndarray:
        """Return y of a state x."""
        if not self._reduced:
            return x
        return np.array(self._within(x.tolist()))

    def out_of(self, y: np.ndarray) -> np.ndarray:
        """Return the states of rows y."""
        if not self._reduced:
            return y
        states = np.empty((len(y), 2 * self.n))
        states[:, : self.n] = y[:, : self.n]
        for i, x in enumerate(self._velocity(y.T), self.n):
            states[:, i] = x
        return states


def _symbols(names: str) -> tuple[tuple[sp.Symbol, ...], tuple[sp.Symbol, ...]]:
    q = tuple(sp.symbols(names))
    return q, tuple(sp.Symbol(f"v_{x}") for x in q)


R = sp.Rational


def springs() -> Problem:
    (x, y, z), (u, v, w) = q, vel = _symbols("x y z")
    return Problem(
        "springs", "particle on springs",
        "`L = |v|²/2 - (x² + 2 y² + 3/2 z²)/2`, `z' = y x'`",
        q, vel, (u**2 + v**2 + w**2) / 2 - (x**2 + 2 * y**2 + R(3, 2) * z**2) / 2,
        (w - y * u,),
        (R(1, 2), R(3, 10), R(-1, 5)), (1, R(7, 10), R(3, 10)),
        sp.Matrix([[1, 0], [0, 1], [y, 0]]),
    )  # fmt: skip


def knife_edge() -> Problem:
    (x, y, phi), (u, v, omega) = q, vel = _symbols("x y phi")
    return Problem(
        "knife_edge", "knife edge on an incline",
        "`L = |v|²/2 + x/2`, `sin(phi) x' = cos(phi) y'`; the motion is a sum of sines",
        q, vel, (u**2 + v**2 + omega**2) / 2 + x / 2,
        (sp.sin(phi) * u - sp.cos(phi) * v,),
        (0, 0, 0), (R(1, 2), 0, 1),
        sp.Matrix([[sp.cos(phi), 0], [sp.sin(phi), 0], [0, 1]]),
    )  # fmt: skip


def sleigh() -> Problem:
    (x, y, theta), (u, v, omega) = q, vel = _symbols("x y theta")
    return Problem(
        "sleigh", "sleigh in a well",
        "`L = (x'² + y'²)/2 + theta'²/4 - (x² + y²)/2`, "
        "`cos(theta) y' = sin(theta) x' + theta'/5`",
        q, vel, (u**2 + v**2) / 2 + omega**2 / 4 - (x**2 + y**2) / 2,
        (-sp.sin(theta) * u + sp.cos(theta) * v - omega / 5,),
        (R(1, 2), 0, 0), (R(1, 2), R(1, 5), 1),
        sp.Matrix([[sp.cos(theta), -sp.sin(theta) / 5], [sp.sin(theta), sp.cos(theta) / 5],
                   [0, 1]]),
    )  # fmt: skip


def contact() -> Problem:
    (x, y, z), (u, v, w) = q, vel = _symbols("x y z")
    return Problem(
        "contact", "contact oscillator",
        "`L = |v|²/2 - (x² + y² + z² + 3/10 x² z²)/2`, `x' = -y z'`",
        q, vel,
        (u**2 + v**2 + w**2) / 2 - (x**2 + y**2 + z**2 + R(3, 10) * x**2 * z**2) / 2,
        (u + y * w,),
        (R(13, 10), 0, R(1, 5)), (0, 1, 0),
        sp.Matrix([[-y, 0], [0, 1], [1, 0]]),
    )  # fmt: skip


def rolling_disc() -> Problem:
    q, vel = _symbols("x y alpha beta gamma")
    (x, y, alpha, beta, gamma), (u, v, yaw, lean, spin) = q, vel
    rolled = spin + yaw * sp.sin(beta)
    L = (u**2 + v**2 + (sp.sin(beta) * lean) ** 2) / 2 + R(1, 8) * (
        lean**2 + (yaw * sp.cos(beta)) ** 2
    )
    return Problem(
        "rolling_disc", "rolling disc, M(q)",
        "mass, radius and gravity 1, inertia 1/4 and 1/2; it yaws by `alpha`, leans by `beta`, "
        "rolls by `gamma`; two constraints",
        q, vel, L + rolled**2 / 4 - sp.cos(beta),
        (
            sp.cos(alpha) * u + sp.sin(alpha) * v - rolled,
            -sp.sin(alpha) * u + sp.cos(alpha) * v + lean * sp.cos(beta),
        ),
        (0, 0, 0, 0, 0), (1, R(-1, 5), R(3, 10), R(1, 5), 1),
        sp.Matrix([
            [sp.cos(alpha) * sp.sin(beta), sp.sin(alpha) * sp.cos(beta), sp.cos(alpha)],
            [sp.sin(alpha) * sp.sin(beta), -sp.cos(alpha) * sp.cos(beta), sp.sin(alpha)],
            [1, 0, 0], [0, 1, 0], [0, 0, 1],
        ]),
    )  # fmt: skip


def snakeboard() -> Problem:
    q, vel = _symbols("x y theta psi phi")
    (x, y, theta, psi, phi), (u, v, omega, rotor, steer) = q, vel
    L = (u**2 + v**2 + omega**2 / 4) / 2 + rotor**2 / 20 + rotor * omega / 10 + steer**2 / 20
    return Problem(
        "snakeboard", "snakeboard, driven and braked",
        "`L = (x'² + y'² + theta'²/4)/2 + psi'²/20 + psi' theta'/10 + phi'²/20`, two "
        "constraints, friction, springs, torques: `sin(t)/10` on the rotor, `cos(t)/20` on phi",
        q, vel, L,
        tuple(
            -sp.sin(theta + s * phi) * u + sp.cos(theta + s * phi) * v
            - s * sp.cos(phi) * omega / 2
            for s in (1, -1)
        ),
        (0, 0, 0, 0, 0), (1, 0, 0, 0, R(3, 10)),
        sp.Matrix([
            [sp.cos(phi) * sp.cos(theta), 0, 0], [sp.cos(phi) * sp.sin(theta), 0, 0],
            [-2 * sp.sin(phi), 0, 0], [0, 1, 0], [0, 0, 1],
        ]),
        {
            x: -u / 20, y: -v / 20, theta: -omega / 50,
            psi: sp.sin(t) / 10 - rotor / 50 - psi / 20,
            phi: sp.cos(t) / 20 - steer / 50 - phi / 5,
        },
    )  # fmt: skip


def gyroscopic() -> Problem:
    """In D the field is 1 + x + y: no reflection of x, y or both turns the motion around."""
    plain = springs()
    (x, y, _), (_, v, _) = plain.q, plain.v
    return Problem(
        "gyroscopic", "springs in a magnetic field",
        "that of the particle on springs with `(x + x²/2 + x y) y'` added to L: conservative, not "
        "reversible",
        plain.q, plain.v, plain.L + (x + x**2 / 2 + x * y) * v, plain.constraints, plain.q0,
        plain.v0, plain.basis, reversible=False,
    )  # fmt: skip


def comet() -> Problem:
    """Its data are exact in binary, because the motion multiplies their roundoff by some 1000."""
    (x, y, z), (u, v, w) = q, vel = _symbols("x y z")
    return Problem(
        "comet", "comet",
        "`L = |v|²/2 + 1/sqrt(x² + y²)`, `z' = x y' - y x'`; an ellipse of eccentricity 0.9. "
        "The 17 close approaches up to t = 100 multiply roundoff by some 1000, so small steps end "
        "at 1e-10. All steps are 20 times shorter than on other problems",
        q, vel, (u**2 + v**2 + w**2) / 2 + 1 / sp.sqrt(x**2 + y**2),
        (w - x * v + y * u,),
        (R(3, 32), 0, 0), (0, R(9, 2), R(27, 64)),
        sp.Matrix([[1, 0], [0, 1], [-y, x]]),
        pace=20,
    )  # fmt: skip


PROBLEMS: dict[str, Callable[[], Problem]] = {
    x.__name__: functools.cache(x)
    for x in (springs, knife_edge, sleigh, contact, rolling_disc, snakeboard, gyroscopic, comet)
}
