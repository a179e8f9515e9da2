"""A thousand skates in a row on springs: 3000 coordinates, 1000 constraints.

Each blade touches its own three coordinates, and the system says so: ``forms`` returns these
entries alone.  A step then takes time and memory in proportion to the number of skates.
"""

import sys
import time

import numpy as np

import dalembert as dal

COUNT = 1000
OWN = np.arange(3 * COUNT).reshape(COUNT, 3)  # the coordinates x, y, heading of each skate
SPARSITY = np.repeat(np.arange(COUNT), 3), OWN.ravel()  # rows and columns


def forms(q):
    heading = q[OWN[:, 2]]
    return np.stack([-np.sin(heading), np.cos(heading), 0 * heading], axis=1).ravel()


def forms_velocity_derivative(q, v):
    heading, (x, y) = q[OWN[:, 2]], v[OWN[:, :2]].T
    turn = -np.cos(heading) * x - np.sin(heading) * y
    return np.stack([0 * turn, 0 * turn, turn], axis=1).ravel()


def springs(q):
    """Return the vectors between neighbours and how much longer than 1 they are."""
    d = np.diff(q[OWN[:, :2]], axis=0)
    return d, np.hypot(*d.T) - 1


def potential(q):
    return float(np.sum(springs(q)[1] ** 2) / 2)


def gradient(q):
    d, stretch = springs(q)
    pull = d * (stretch / (1 + stretch))[:, None]
    result = np.zeros((COUNT, 3))
    result[1:, :2] += pull
    result[:-1, :2] -= pull
    return result.ravel()


skates = dal.System(
    mass=np.ones(3 * COUNT), forms=forms, forms_velocity_derivative=forms_velocity_derivative,
    potential=potential, gradient=gradient, sparsity=SPARSITY, name="skates",
)

heading = 0.3 * np.sin(np.arange(COUNT))
q0 = np.stack([np.arange(COUNT), 0 * heading, heading], axis=1).ravel()
v0 = np.stack([np.cos(heading), np.sin(heading), 0 * heading + 0.5], axis=1).ravel()
start = time.perf_counter()
run = dal.integrate(skates, "midpoint", q0, v0, h=0.02, steps=500, stride=50)
each = 1e3 * (time.perf_counter() - start) / 500
print(run)
print(f"{each:.2f} ms a step; residual of D {abs(run.residual).max():.1e}")
print(f"energy {run.energy[0]:.6f}, changed by at most {np.ptp(run.energy):.1e}")
assert abs(run.residual).max() < 1e-15 and np.ptp(run.energy) < 1e-4 * run.energy[0]

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(11.0, 3.0), layout="constrained")
    first = 24
    for k, color in ((0, "#999999"), (4, "#56B4E9"), (10, "#0072B2")):
        x, y, angle = run.q[k, OWN[:first]].T
        ax.plot(x, y, color=color, lw=1, label=f"t = {run.t[k]:g}")
        for px, py, turned in zip(x, y, angle):
            along = 0.3 * np.array([np.cos(turned), np.sin(turned)])
            ax.plot([px - along[0], px + along[0]], [py - along[1], py + along[1]], color=color,
                    lw=2.5)
    ax.set(xlabel="x (m)", ylabel="y (m)", title=f"the first {first} of {COUNT} skates",
           aspect="equal")
    figure.legend(loc="outside right upper", frameon=False)
    figure.savefig(sys.argv[1], dpi=110)
