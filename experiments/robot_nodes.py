"""The mobile robot by the discrete Lagrange-d'Alembert equations on nodes, without the library.

L = |v|^2/2 - 10 sin(theta), x' = theta' cos(phi), y' = theta' sin(phi). L_d = h L at q + beta_L
(q' - q), the constraint at q + beta_D (q' - q), the reaction acts at the node.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import fsolve

START = np.zeros(4), np.array([1, 0, 0.5, 1.0])


def forms(q: np.ndarray) -> np.ndarray:
    """Return mu."""
    return np.array([[1, 0, 0, -np.cos(q[2])], [0, 1, 0, -np.sin(q[2])]])


def slope(q: np.ndarray) -> np.ndarray:
    """Return the gradient of V."""
    return np.array([0, 0, 0, 10 * np.cos(q[3])])


def nodes(beta_L: float, beta_D: float, h: float, steps: int) -> np.ndarray:
    """Return q_0, q_1, ..., where the state at t = 0 lies at beta_D between q_-1 and q_0."""
    q, v = START
    before, now = q - beta_D * h * v, q + (1 - beta_D) * h * v
    found = [now]
    for _ in range(steps):

        def equations(u: np.ndarray, q: np.ndarray = now, p: np.ndarray = before) -> np.ndarray:
            r, multipliers = u[:4], u[4:]
            ahead, behind = slope(q + beta_L * (r - q)), slope(p + beta_L * (q - p))
            forces = (1 - beta_L) * ahead + beta_L * behind
            balance = (r - 2 * q + p) / h + h * forces - forms(q).T @ multipliers
            return np.concatenate([balance, forms(q + beta_D * (r - q)) @ (r - q)])

        u = fsolve(equations, np.concatenate([2 * now - before, np.zeros(2)]), xtol=1e-11)
        before, now = now, u[:4]
        found.append(now)
    return np.array(found)
