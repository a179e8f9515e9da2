"""A thin disk that rolls, by Newton and Euler with a rotation matrix: the independent solution.

The state is (centre, rotation matrix by rows, body's angular velocity); the third body axis is the
axis of the disk. Nothing of the library enters, and there are no angles that could be singular.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

UP = np.array([0.0, 0.0, 1.0])


def cross(a: np.ndarray) -> np.ndarray:
    """Return the matrix of the cross product with a from the left."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


@dataclass(frozen=True)
class Disk:
    """Mass, radius, inertia about a diameter and about the axis, gravity."""

    m: float
    r: float
    A: float
    C: float
    g: float

    def to_centre(self, turn: np.ndarray) -> np.ndarray:
        """Return the vector from the contact to the centre."""
        n = turn[:, 2]
        up = UP - n[2] * n
        return self.r * up / np.linalg.norm(up)

    def forces(self, turn: np.ndarray, body: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the angular acceleration, in space, and the force of the ground on the disk."""
        n, omega = turn[:, 2], turn @ body
        inertia = turn @ np.diag([self.A, self.A, self.C]) @ turn.T
        # d = r p/|p|, p = up - (up.n) n, n' = omega x n
        p, dn = UP - n[2] * n, np.cross(omega, n)
        dp, size = -dn[2] * n - n[2] * dn, np.linalg.norm(UP - n[2] * n)
        d, dd = self.r * p / size, self.r * (dp / size - p * (p @ dp) / size**3)
        # centre: a = omega' x d + omega x d', m a = F - m g up; spin: (I omega)' = -d x F
        fixed = self.m * (np.cross(omega, dd) + self.g * UP)
        matrix = inertia - self.m * cross(d) @ cross(d)
        right = -np.cross(omega, inertia @ omega) - np.cross(d, fixed)
        rate = np.linalg.solve(matrix, right)
        return rate, fixed + self.m * np.cross(rate, d)

    def solve(self, place: np.ndarray, turn: np.ndarray, body: np.ndarray, t: np.ndarray,
              tolerance: float = 1e-12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Return places, rotation matrices and angular velocities at the times t."""

        def rate(_: float, state: np.ndarray) -> np.ndarray:
            turn, body = state[3:12].reshape(3, 3), state[12:]
            speed = np.cross(turn @ body, self.to_centre(turn))
            # turn' = turn [body], and the body's components of omega' are those of its body rate
            faster = turn.T @ self.forces(turn, body)[0]
            return np.concatenate([speed, (turn @ cross(body)).ravel(), faster])

        start = np.concatenate([place, turn.ravel(), body])
        found = solve_ivp(rate, (t[0], t[-1]), start, "DOP853", t, rtol=tolerance, atol=tolerance)
        if not found.success:
            raise RuntimeError(found.message)
        y = found.y.T
        return y[:, :3], y[:, 3:12].reshape(-1, 3, 3), y[:, 12:]


def attitude(alpha: np.ndarray, beta: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """Return the rotation matrices of the library's yaw, lean and spin, shape (..., 3, 3).

    The heading is e = (cos alpha, sin alpha, 0), the axis n = cos beta (up x e) + sin beta up, and
    d = e x n (up the disk) has the lean too.  At spin 0 the body axes are (-e, d, n).
    """
    (sa, ca), (sb, cb), (sg, cg) = ((np.sin(x), np.cos(x)) for x in (alpha, beta, gamma))
    zero = np.zeros_like(ca)
    e = np.stack([ca, sa, zero], -1)
    n = np.stack([-sa * cb, ca * cb, sb], -1)
    d = np.cross(e, n)
    c, s = cg[..., None], sg[..., None]
    return np.stack([-c * e + s * d, s * e + c * d, n], -1)


def body_rate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the body's angular velocity of states of the library's rolling disc."""
    alpha, beta, gamma = q[..., 2], q[..., 3], q[..., 4]
    turn = attitude(alpha, beta, gamma)
    e = np.stack([np.cos(alpha), np.sin(alpha), 0 * alpha], -1)
    omega = v[..., 2:3] * UP + v[..., 3:4] * e + v[..., 4:5] * turn[..., 2]
    return np.einsum("...ji,...j->...i", turn, omega)
