"""
Exact discrete constraints
==========================

A sleigh connects pairs of positions in time h, and a scheme connects slightly different pairs.
This example compares the exact discrete constraint with the discretized one.

For the Chaplygin sleigh, and the schemes of the family rho^beta::

    D_d^E = {(q0, q(h)) : v0 in D}           pairs on solutions in D
    D_d   = {mu(g) (q1 - q0)/h = 0}          with g = (1 - beta) q0 + beta q1

Neither set contains the other.  The distance of a pair of D_d^E from D_d is ``|phi_d|``.  The
distance of a pair of D_d from D_d^E is ``|mu (q1 - q(h))/h|``; here q(h) follows from the velocity
in D at q0 that leads as close to q1 as D allows.  Both are O(h), and O(h^2) for beta = 1/2.

``python exact_constraints.py [PICTURE.png]`` prints both distances for several h and beta.
"""

import re
import sys

import matplotlib.pyplot as plt
import numpy as np

import dalembert as dal
from dalembert.show.palette import COLOURS

sleigh = dal.systems.sleigh()

# %%
# Positions that the sleigh can reach
# -----------------------------------
# From one position q0 the velocities of D lead to a surface in the space of (x, y, theta).  The
# picture shows its sections with planes of a given rotation in h = 1: the possible positions of the
# centre of mass at that time.  The sleigh itself is drawn at q0.

a = sleigh.parameters["a"]
rates = np.linspace(-4.0, 4.0, 81)
ends = np.array(
    [
        [sleigh.exact(1.0, [0, 0, 0], [speed, a * rate, rate])[0] for rate in rates]
        for speed in np.linspace(-2.0, 2.6, 47)
    ]
)
figure, ax = plt.subplots(figsize=(6.0, 4.6), layout="constrained")
for turn, colour in zip((-1.6, -0.8, 0.0, 0.8, 1.6), COLOURS):
    x, y = ([np.interp(turn, row[:, 2], row[:, k]) for row in ends] for k in (0, 1))
    ax.plot(x, y, color=colour, linewidth=2.5, label=f"{turn:g}")
    along = np.array([np.cos(turn / 2), np.sin(turn / 2)])
    across = a * turn * np.array([-along[1], along[0]])
    ax.plot(*(across + np.outer([-2.0, 2.6], along)).T, "--", color=colour)
sledge = a * np.array([(-1.7, -0.4), (-0.2, -0.5), (0.7, 0.0), (-0.2, 0.5), (-1.7, 0.4)])
ax.fill(*sledge.T, color="0.85", edgecolor="0.3", zorder=2)
ax.plot([-1.4 * a, -0.6 * a], [0, 0], color="0.3", linewidth=4)
ax.set(xlim=(-2.0, 4.4), ylim=(-2.4, 2.4), aspect="equal")
ax.set(xlabel="x", ylabel="y")
angles = ax.legend(frameon=False, loc="upper right", title="turned by (rad)")
ax.add_artist(angles)
kinds = [ax.plot([], [], line, color="black")[0] for line in ("-", "--")]
ax.legend(kinds, ["exact, $D_d^E$", r"$D_d$, $\beta$ = 0.5"], frameon=False, loc="lower right")
if not (np.diff(ends[:, :, 2]) > 0).all():
    sys.exit("the faster it turns at first, the farther the sleigh was expected to turn")

# %%
# The distances
# -------------

q0, v0 = sleigh.q0, sleigh.v0
betas = [0.0, 0.5, 1.0]
steps = [0.4 / 2**k for k in range(7)]


def of_exact_pair(beta, h):
    """Return |phi_d| of a pair of D_d^E."""
    q1 = dal.reference(sleigh, t=h, tolerance=1e-14).q
    return abs(dal.Discrete(sleigh, beta).constraint(h, q0, q1)).max()


def of_discrete_pair(beta, h):
    """Return the defect with respect to D_d^E of the pair of D_d that belongs to (q0, v0)."""
    pair = dal.Discrete(sleigh, beta).nodes(h, q0, v0)
    _, defect = dal.exact_velocity(sleigh, h, *pair, tolerance=1e-14)
    return abs(defect).max()


defects = {
    "pairs of D_d^E, distance from D_d": of_exact_pair,
    "pairs of D_d, distance from D_d^E": of_discrete_pair,
}
found = {
    title: np.array([[measure(beta, h) for h in steps] for beta in betas])
    for title, measure in defects.items()
}
for title, values in found.items():
    print(title)
    print("         h", *(f"   beta = {beta:g}" for beta in betas))
    for h, row in zip(steps, values.T):
        print(f"{h:10.5f}", *(f"{value:11.3e}" for value in row))
    slopes = np.log2(values[:, -2] / values[:, -1])
    print("     slope", *(f"{slope:11.3f}" for slope in slopes))
    expected = [2 if beta == 0.5 else 1 for beta in betas]
    if abs(slopes - expected).max() > 0.1:
        sys.exit(f"slopes {expected} were expected")

# %%
# The steeper curve in each picture belongs to beta = 1/2.

study, axes = plt.subplots(1, 2, figsize=(9.0, 4.0), sharey=True, layout="constrained")
for ax, (title, values) in zip(axes, found.items()):
    for beta, row, marker, colour in zip(betas, values, "os^", COLOURS):
        ax.loglog(steps, row, marker=marker, color=colour, label=rf"$\beta$ = {beta:g}")
    for order, at in ((1, values[0]), (2, values[1])):
        guide = 0.4 * at[-1] * (np.array(steps) / steps[-1]) ** order
        ax.loglog(steps, guide, color="0.6", linewidth=0.8, linestyle="--")
        ax.annotate(f"slope {order}", (steps[3], guide[3]), (4, -10),
                    textcoords="offset points", color="0.4", fontsize=8)  # fmt: skip
    ax.set_title(re.sub(r"D_d(\^E)?", r"$D_d\1$", title), fontsize="medium")
    ax.set_xlabel("step h")
axes[0].set_ylabel("defect")
axes[0].legend(frameon=False)
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
