"""
Which constraint is kept
========================

A scheme keeps one constraint to roundoff: D if its nodes are moved, D_eps if they are kept.  A
constraint that seems to be violated is a different one.

The same steps satisfy both, evaluated at different nodes::

    D      mu(q) v = 0
    D_eps  mu(q - (1 - beta) h v) v = 0      with beta = 1/2 here

The particle in a harmonic potential, by midpoint.  With moved nodes it stays in D to roundoff, and
O(h) away from D_eps; with kept nodes it stays in D_eps to roundoff, and O(h) away from D.  Neither
drifts.

``python kept_nodes.py [PICTURE.png]`` prints the largest ``|phi|`` of both constraints over a run,
for two steps h.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import dalembert as dal
from dalembert.show.palette import COLOURS

system = dal.systems.particle_oscillator()
t_end, steps = 100.0, [0.1, 0.05]
# Kept nodes start from data in D with a shift to D_eps.
schemes = {"midpoint": None, "midpoint-nodes": "shift"}


def run(scheme, h):
    """Return the times, phi of D and phi of D_eps, in a run from the same data in D.

    h is large, to make D_eps visible, so its size is not checked.
    """
    found = dal.integrate(
        system, scheme, h=h, t_end=t_end, initial=schemes[scheme], check_h=False
    )
    shifts = (0.0, h / 2)
    return found.t, [system.residual(found.q, found.v, shift)[:, 0] for shift in shifts]


runs = {(scheme, h): run(scheme, h) for scheme in schemes for h in steps}
print("scheme              h       D          D_eps")
for (scheme, h), (_, residuals) in runs.items():
    in_D, in_D_eps = (abs(residual).max() for residual in residuals)
    print(f"{scheme:15}  {h:5g}    {in_D:.1e}    {in_D_eps:.1e}")
    kept, other = (in_D, in_D_eps) if scheme == "midpoint" else (in_D_eps, in_D)
    if not kept < 1e-14 < 0.1 * h < other:
        sys.exit("one constraint was expected to be kept to roundoff, and the other not")

# %%
# Two axes of a cross
# -------------------
# Each dot is one of every four states: its distance from D and from D_eps.  Moved nodes lie on one
# axis and kept nodes on the other, to roundoff.  Half the step makes the cross half as large.

figure, axes = plt.subplots(1, 2, figsize=(8, 4.2), sharex=True, sharey=True, layout="constrained")
for ax, h in zip(axes, steps):
    for scheme, name, colour in zip(schemes, ("moved nodes", "kept nodes"), COLOURS):
        _, (in_D, in_D_eps) = runs[scheme, h]
        ax.plot(in_D[::4], in_D_eps[::4], "o", color=colour, alpha=0.35, markersize=7)
        ax.plot([], [], "o", color=colour, label=name)
    ticks = [-0.04, -0.02, 0.0, 0.02, 0.04]
    ax.set(title=f"h = {h:g}", xticks=ticks, yticks=ticks, aspect="equal")
    ax.set_xlabel(r"off $D$:  $\mu(q)\,v$")
axes[0].set_ylabel(r"off $D_\varepsilon$:  $\mu(q - h v/2)\,v$")
axes[0].legend(frameon=False, loc="upper left")
for ax in axes:
    ax.grid(color="0.92")

# %%
# Over time
# ---------
# The same for the larger step, with a logarithmic axis.  An exact zero cannot be shown there: it is
# drawn at 1e-17.

names = [r"$D$:  $\mu(q)\,v$", r"$D_\varepsilon$:  $\mu(q - h v/2)\,v$"]
over_time, axes = plt.subplots(1, 2, figsize=(9.0, 4.0), sharey=True, layout="constrained")
for ax, scheme, title in zip(axes, schemes, ("moved nodes", "kept nodes")):
    t, residuals = runs[scheme, steps[0]]
    for name, colour, residual in zip(names, COLOURS[2:], map(abs, residuals)):
        ax.semilogy(t, np.maximum(residual, 1e-17), color=colour, linewidth=0.8)
        height = 1e-15 if residual.max() < 1e-14 else 1e-6
        ax.text(t_end / 2, height, name, color=colour, ha="center", fontsize="large")
    ax.axhline(2.0**-53, color="black", linewidth=1.0, linestyle="--")
    ax.text(0.0, 1.6e-16, "unit roundoff u", fontsize="small")
    ax.set_title(f"{title} ({scheme})")
    ax.set_xlabel("time t")
axes[0].set_ylabel("size of the constraint, $|\\phi|$")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
