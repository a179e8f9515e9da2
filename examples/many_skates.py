"""
A thousand skates
=================

A thousand skates in a row on springs have 3000 coordinates and 1000 constraints.  A step takes time
and memory in proportion to the number of skates.

Each blade constrains only its own coordinates x, y and heading, and the sparsity says so::

    -sin(heading_k) v_x_k + cos(heading_k) v_y_k = 0,        k = 1, ..., 1000
    V = sum_k (distance of skates k and k + 1  -  1)^2/2

``python many_skates.py [PICTURE.png]`` prints the time of a step, the residual of D, and the change
of the energy.
"""

import sys
import time

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection

import dalembert as dal

# %%
# The skates, and the entries of mu
# ---------------------------------
# Row k of mu has entries in the three columns of skate k.  ``SPARSITY`` lists them, and ``mu``
# and the derivative of mu v return only these entries, in the same order.

COUNT = 1000
OWN = np.arange(3 * COUNT).reshape(COUNT, 3)  # the coordinates x, y, heading of each skate
SPARSITY = np.repeat(np.arange(COUNT), 3), OWN.ravel()  # rows and columns


def forms(q):
    heading = q[OWN[:, 2]]
    return np.stack([-np.sin(heading), np.cos(heading), 0 * heading], axis=1).ravel()


def mu_v_q(q, v):
    heading, (x, y) = q[OWN[:, 2]], v[OWN[:, :2]].T
    turn = -np.cos(heading) * x - np.sin(heading) * y
    return np.stack([0 * turn, 0 * turn, turn], axis=1).ravel()


def springs(q):
    """Return the vectors between neighbours, and the extension of the springs beyond length 1."""
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


# %%
# The mass is given as a diagonal; the matrices of a step are then as sparse as mu.

skates = dal.System(
    mass=np.ones(3 * COUNT),
    mu=forms,
    mu_v_q=mu_v_q,
    potential=potential,
    gradient=gradient,
    sparsity=SPARSITY,
    name="skates",
)

# %%
# A run
# -----
# All skates glide along the row, in slightly different directions, and all turn to the left.

heading = 0.3 * np.sin(np.arange(COUNT))
q0 = np.stack([np.arange(COUNT), 0 * heading, heading], axis=1).ravel()
v0 = np.stack([np.cos(heading), np.sin(heading), 0 * heading + 0.5], axis=1).ravel()
start = time.perf_counter()
run = dal.integrate(skates, "midpoint", q0, v0, h=0.02, steps=500, stride=5)
each = 1e3 * (time.perf_counter() - start) / 500
print(run)
print(f"{each:.2f} ms a step; residual of D {abs(run.residual).max():.1e}")
print(f"energy {run.energy[0]:.6f}, changed by at most {np.ptp(run.energy):.1e}")
if not (abs(run.residual).max() < 1e-15 and np.ptp(run.energy) < 1e-4 * run.energy[0]):
    sys.exit("expected D to roundoff, and the energy to a part in 10000")

# %%
# The first twelve skates: their tracks, and the row at five instants, with blades and springs.

figure, ax = plt.subplots(figsize=(9.0, 3.8), layout="constrained")
first = OWN[:12]
colours = plt.get_cmap("viridis")(np.linspace(0, 0.92, len(first)))
for own, colour in zip(first, colours, strict=True):
    ax.plot(*run.q[:, own[:2]].T, color=colour, linewidth=1)
for q in run.q[:: len(run.q) // 4]:
    x, y, angle = q[first.T]
    ax.plot(x, y, color="0.6", linewidth=0.9, zorder=1)
    centre, half = np.array([x, y]).T, 0.28 * np.array([np.cos(angle), np.sin(angle)]).T
    blades = np.stack([centre - half, centre + half], axis=1)
    ax.add_collection(LineCollection(blades, colors=colours, linewidths=4.5, zorder=3))
ax.set(xlabel="x", ylabel="y", aspect="equal")
ax.set_title(f"The first {len(first)} of {COUNT} skates, t = 0 to {run.t[-1]:g}")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
