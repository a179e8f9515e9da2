"""The nonholonomic RATTLie of S. Hante for a disk that rolls, written out again, in NumPy.

States are elements of SE(3) with body velocities (Omega, U) and momenta p = M (Omega, U).  A step
has half a kick with the horizontal force of the last node and the vertical force that brings the
disk back to the ground, a drift along exp(h D), and half a kick with the force that brings the
velocity back into D; between them the momentum M D is carried by the inverse transposed tangent
operators of -h D and h D.
"""

from __future__ import annotations

import newton_euler
import numpy as np
from newton_euler import UP, cross


def series(matrix: np.ndarray, first: int) -> np.ndarray:
    """Return the sum of matrix^k first!/(k + first)!: the exponential for first = 0."""
    total, term = np.eye(len(matrix)), np.eye(len(matrix))
    for k in range(1, 14):
        term = term @ matrix / (k + first)
        total += term
    return total


def carried(w: np.ndarray, momentum: np.ndarray) -> np.ndarray:
    """Return T(w)^-T momentum, with T(w) = sum (-ad w)^k/(k + 1)! of SE(3)."""
    ad = np.zeros((6, 6))
    ad[:3, :3] = ad[3:, 3:] = cross(w[:3])
    ad[3:, :3] = cross(w[3:])
    return np.linalg.solve(series(-ad, 1).T, momentum)


def moved(place: np.ndarray, turn: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the place and the rotation matrix after exp(w)."""
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = cross(w[:3]), w[3:]
    grown = series(matrix, 0)
    return place + turn @ grown[:3, 3], turn @ grown[:3, :3]


def solve(disk: newton_euler.Disk, place: np.ndarray, turn: np.ndarray, body: np.ndarray, h: float,
          steps: int, stride: int) -> list[np.ndarray]:  # fmt: skip
    """Return places, rotation matrices, angular velocities and forces at every stride-th node.

    The horizontal forces are those of the method, the vertical ones belong to the state: the method
    has two at a node, each of order 1.
    """
    mass = np.array([disk.A, disk.A, disk.C, disk.m, disk.m, disk.m])

    def contact(turn: np.ndarray) -> np.ndarray:
        """Return the velocity of the point of contact, as a matrix over (Omega, U)."""
        return np.hstack([cross(disk.to_centre(turn)) @ turn, turn])

    def kick(turn: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the generalized force of gravity and of the ground."""
        weight = np.concatenate([np.zeros(3), turn.T @ (-disk.m * disk.g * UP)])
        return weight + contact(turn).T @ force

    speed = turn.T @ np.cross(turn @ body, disk.to_centre(turn))
    momentum = mass * np.concatenate([body, speed])
    force = disk.forces(turn, body)[1]
    found = [(place, turn, body, force)]
    for k in range(1, steps + 1):
        # unknowns: D and the vertical force; the matrix of the equations for h = 0
        upward = contact(turn)[2]
        matrix = np.diag([*mass, 0.0])
        matrix[:6, 6], matrix[6, :6] = -h / 2 * upward, upward
        pushed = momentum + h / 2 * kick(turn, np.array([force[0], force[1], 0.0]))
        u = np.array([*(momentum / mass), force[2]])
        for _ in range(60):
            there, facing = moved(place, turn, h * u[:6])
            balance = carried(-h * u[:6], mass * u[:6]) - pushed - h / 2 * u[6] * upward
            above = (there[2] - disk.to_centre(facing)[2]) / h
            change = np.linalg.solve(matrix, np.array([*balance, above]))
            u -= change
            if abs(change[:6]).max() < 1e-13 * abs(u[:6]).max():
                break
        else:
            raise RuntimeError(f"step {k} with h = {h}: not converged")
        place, turn = moved(place, turn, h * u[:6])
        momentum = carried(h * u[:6], mass * u[:6])
        forms = contact(turn)
        free = momentum + h / 2 * kick(turn, np.zeros(3))
        force = -np.linalg.solve(h / 2 * (forms / mass) @ forms.T, forms @ (free / mass))
        momentum = free + h / 2 * forms.T @ force
        if k % stride == 0:
            body = momentum[:3] / mass[:3]
            shown = np.array([*force[:2], disk.forces(turn, body)[1][2]])
            found.append((place, turn, body, shown))
    return [np.array(column) for column in zip(*found)]
