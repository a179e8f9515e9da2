"""Random chains of bodies: as models in SymPy, and in numbers by Kane's method.

A body has joints, one coordinate each, which turn about axes of its own frame or slide along them.
Behind them it is a bar along its first axis with its mass in the middle.  The joints follow each
other from the frame at the end of the bar before, or, if it is absolute, from the axes of space.
"""

import random
from dataclasses import dataclass, field

import numpy as np
import sympy

import dalembert as dal

GRAVITY, RADIUS = sympy.Rational(981, 100), sympy.Rational(3, 10)


@dataclass(frozen=True)
class Body:
    """A body; ``parent`` and ``first`` are the numbers of the body before, and of a coordinate."""

    parent: int
    first: int
    joints: tuple[tuple[str, int], ...]
    length: sympy.Rational
    mass: sympy.Rational
    inertia: tuple[sympy.Rational, ...]
    is_absolute: bool


@dataclass(frozen=True)
class Chain:
    """A chain of n coordinates, in a plane or in space.

    The first body of a chain with a "knife" slides along a blade; with "rolling" it has a wheel,
    too, whose turn is the fourth coordinate.
    """

    is_planar: bool
    constraint: str = "none"
    bodies: list[Body] = field(default_factory=list)

    @property
    def n(self) -> int:
        return sum(len(b.joints) for b in self.bodies)


def random_chain(n, is_planar, is_absolute, constraint, seed=5):
    """Return a chain; the numbers of its bodies are random, and so are joints that slide."""
    source = random.Random(f"{seed} {n} {is_planar} {is_absolute} {constraint}")
    chain = Chain(is_planar, constraint)

    def among(least, most):
        return sympy.Rational(source.randint(least, most), 100)

    def add(*joints, is_absolute=False, length=None):
        a, b, c = (among(2, 5) for _ in range(3))
        is_wheel = length == 0
        chain.bodies.append(Body(
            0 if constraint == "rolling" and len(chain.bodies) == 2 else len(chain.bodies) - 1,
            chain.n, joints, among(20, 60) if length is None else length, among(50, 200),
            (a, b, a if is_wheel else c), is_absolute,
        ))  # fmt: skip

    if constraint != "none":
        add(("slide", 0), ("slide", 1), ("turn", 2))
    if constraint == "rolling":
        add(("turn", 1), length=0)
    while chain.n < n:
        if chain.bodies and not is_absolute and source.random() < 0.25:
            add(("slide", source.randint(0, 1 if is_planar else 2)))
        elif is_planar:
            add(("turn", 2), is_absolute=is_absolute)
        elif is_absolute:
            add(*[("turn", axis) for axis in (2, 0, 2)[: n - chain.n]], is_absolute=True)
        else:
            add(("turn", source.randint(0, 2)))
    return chain


def rotation(axis, angle, sin=sympy.sin, cos=sympy.cos):
    """Return the rows of the matrix of a rotation about an axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = [[int(k == l) for l in range(3)] for k in range(3)]
    R[i][i], R[i][j], R[j][i], R[j][j] = cos(angle), -sin(angle), sin(angle), cos(angle)
    return R


# ---- as a model --------------------------------------------------------------------------------


def model(chain):
    """Return L, constraints, and coordinates, as a user writes them: by velocities of points.

    In a plane the direction of a bar is that of a sum of angles.
    """
    q = dal.coordinates([f"c{i}" for i in range(chain.n)])
    zero, L, ends = sympy.zeros(3, 1), sympy.Integer(0), []
    for b in chain.bodies:
        R, angle, spin, place, velocity = ends[b.parent] if ends else (
            sympy.eye(3), 0, zero, zero, zero
        )  # fmt: skip
        if b.is_absolute:
            R, angle, spin = sympy.eye(3), 0, zero
        for (kind, axis), x in zip(b.joints, q[b.first :]):
            e = sympy.Matrix([int(axis == i) for i in range(3)])
            if kind == "slide":
                place, velocity = place + R * e * x, velocity + R * (e * x.d + spin.cross(e * x))
            elif chain.is_planar and axis == 2:
                angle, spin = angle + x, spin + e * x.d
                R = sympy.Matrix(rotation(2, angle))
            elif b.length == 0:  # a wheel: its moments are the same in all positions
                spin += e * x.d
            else:
                turn = sympy.Matrix(rotation(axis, x))
                R, spin = R * turn, turn.T * spin + e * x.d
        bar = sympy.Matrix([b.length, 0, 0])
        along, swing = R * bar, R * spin.cross(bar)
        middle, height = velocity + swing / 2, (place + along / 2)[1 if chain.is_planar else 2]
        L += b.mass * (middle.dot(middle) / 2 - GRAVITY * height)
        L += sum(I * w**2 for I, w in zip(b.inertia, spin)) / 2
        ends.append((R, angle, spin, place + along, velocity + swing))
    rows = [[c * x.d for c, x in zip(row, q)] for row in forms(chain, q, sympy.sin, sympy.cos)]
    return L, [sum(row) for row in rows], q


def forms(chain, q, sin=np.sin, cos=np.cos):
    """Return the first entries of the rows of mu(q), of the blade and of the wheel."""
    if chain.constraint == "none":
        return []
    blade, wheel = [-sin(q[2]), cos(q[2])], [cos(q[2]), sin(q[2]), 0, -RADIUS]
    return [blade, wheel] if chain.constraint == "rolling" else [blade]


# ---- in numbers --------------------------------------------------------------------------------


def jacobians(chain, q):
    """Return for each body the Jacobians of the velocity of its middle and of its angular velocity
    in space, and its rotation; q may be complex.
    """
    n, made, ends = chain.n, [], []
    start = np.eye(3, dtype=q.dtype), *np.zeros((2, 3, n), q.dtype)
    for b in chain.bodies:
        R, J, W = ends[b.parent] if ends else start
        if b.is_absolute:
            R, W = np.eye(3, dtype=q.dtype), np.zeros((3, n), q.dtype)
        for k, (kind, axis) in enumerate(b.joints, b.first):
            own = np.outer(R[:, axis], np.arange(n) == k)
            if kind == "turn":
                R, W = R @ np.array(rotation(axis, q[k], np.sin, np.cos)), W + own
            else:
                J = J + np.cross(W, R[:, [axis]] * q[k], axis=0) + own
        swing = np.cross(W, R[:, [0]] * float(b.length), axis=0)
        made.append((J + swing / 2, W, R))
        ends.append((R, J + swing, W))
    return made


def mu_of(chain, q):
    """Return mu(q)."""
    rows = forms(chain, q)
    mu = np.zeros((len(rows), chain.n), q.dtype)
    for a, row in enumerate(rows):
        mu[a, : len(row)] = row
    return mu


def acceleration(chain, q, v):
    """Return dv/dt by Kane's method, and the condition number of the equations.

    Rates along v are imaginary parts at q + i h v.
    """
    step = 1e-30
    moved = q + 1j * step * v
    M, Q = np.zeros((chain.n, chain.n)), np.zeros(chain.n)
    down = -float(GRAVITY) * (np.arange(3) == (1 if chain.is_planar else 2))
    both = zip(jacobians(chain, q), jacobians(chain, moved))
    for b, ((J, W, R), (there, turned, _)) in zip(chain.bodies, both):
        inertia = R @ np.diag([float(x) for x in b.inertia]) @ R.T
        spin, bias, turning = W @ v, (there @ v).imag / step, (turned @ v).imag / step
        M += float(b.mass) * J.T @ J + W.T @ inertia @ W
        Q += float(b.mass) * J.T @ (down - bias)
        Q -= W.T @ (inertia @ turning + np.cross(spin, inertia @ spin))
    mu = mu_of(chain, q)
    A = np.block([[M, -mu.T], [mu, np.zeros(2 * [len(mu)])]])
    right = np.concatenate([Q, -(mu_of(chain, moved) @ v).imag / step])
    return np.linalg.solve(A, right)[: chain.n], np.linalg.cond(A)


def state(chain, seed):
    """Return random q and v, with v in D."""
    source = np.random.default_rng(seed)
    q, v = source.uniform(0.2, 0.9, chain.n), source.normal(size=chain.n)
    mu = mu_of(chain, q)
    return q, v - np.linalg.pinv(mu) @ mu @ v
