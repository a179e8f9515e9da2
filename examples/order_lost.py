"""
The order that kept nodes lose
==============================

A scheme of order 2 has order 1 at the nodes of the paper.  The states are not less accurate; they
are read half a step too late.

The Chaplygin sleigh by the midpoint scheme has order 2 at moved nodes.  At kept nodes the order is
1 for every start: from data in D, whose first step jumps to D_eps; from data projected to D_eps; or
from data shifted by ``(q, v) -> (q + h v/2, v)``.  In the last case no accuracy is lost: these are
the states of the run at moved nodes, shifted, and ``(q - h v/2, v)`` has order 2 again.

``python order_lost.py [PICTURE.png]`` prints the error of (q, v) at t = 1 against the exact
solution, for several steps h.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import dalembert as dal
from dalembert.show.palette import COLOURS

system = dal.systems.sleigh()
exact = np.concatenate(system.exact(1.0))
counts = [8, 12, 16, 24, 32, 48, 64, 96, 128]
steps = 1.0 / np.array(counts)


def error(scheme, initial, count, back=0.0):
    """Return the error at t = 1 of (q - back h v, v) after count steps."""
    run = dal.integrate(system, scheme, h=1.0 / count, steps=count, initial=initial)
    end = np.concatenate([run.q[-1] - back / count * run.v[-1], run.v[-1]])
    return abs(end - exact).max()


# %%
# The data of a curve: scheme, start, how far q is moved back, and the expected order.

curves = {
    "moved nodes": ("midpoint", None, 0.0, 2),
    "kept nodes, start in D": ("midpoint-nodes", "D", 0.0, 1),
    "kept nodes, start projected to D_ε": ("midpoint-nodes", "project", 0.0, 1),
    "kept nodes, start shifted": ("midpoint-nodes", "shift", 0.0, 1),
    "the same, at q - h v/2": ("midpoint-nodes", "shift", 0.5, 2),
}
errors = {}
print(f"{'error at h =':38}  1/8        1/32       1/128      order")
for name, (scheme, initial, back, order) in curves.items():
    found = np.array([error(scheme, initial, count, back) for count in counts])
    slope = np.polyfit(np.log(steps), np.log(found), 1)[0]
    print(f"{name:38}", *(f" {x:.1e}  " for x in found[[0, 4, 8]]), f" {slope:.2f}")
    if abs(slope - order) > 0.1:
        sys.exit(f"order {order} was expected")
    errors[name] = found

# %%
# Left: a few long steps.  The sledge of the exact motion is grey; blue and orange are the states of
# the runs.  Moved nodes lie on the motion, up to an error of order 2.  Kept nodes with a shifted
# start are ahead by ``h v/2``, the thick lines.  Right: this is the error of order 1.


def outline(q, size=0.25):
    """Return the corners of a sledge at q, which points along its heading."""
    shape = np.array([(-0.7, -0.5), (0.5, -0.5), (1, 0), (0.5, 0.5), (-0.7, 0.5), (-0.7, -0.5)])
    c, s = np.cos(q[2]), np.sin(q[2])
    return (q[:2] + size * shape @ [[c, s], [-s, c]]).T


figure, (way, ax) = plt.subplots(
    1, 2, figsize=(9.6, 5.4), width_ratios=(1, 1.25), layout="constrained"
)
h, steps_drawn = 0.8, 5
path = np.array([system.exact(t)[0] for t in np.linspace(0, h * steps_drawn + 0.2, 200)])
way.plot(*path[:, :2].T, color="0.6", linewidth=1, zorder=1)
moved = dal.integrate(system, "midpoint", h=h, steps=steps_drawn)
kept = dal.integrate(system, "midpoint-nodes", h=h, steps=steps_drawn, initial="shift")
for k, t in enumerate(moved.t):
    way.fill(*outline(system.exact(t)[0]), color="0.87", zorder=0)
    for run, colour in ((moved, COLOURS[0]), (kept, COLOURS[1])):
        way.plot(*outline(run.q[k]), color=colour, linewidth=1.4)
        way.plot(*run.q[k, :2], "o", color=colour, markersize=5)
    way.plot(*np.array([moved.q[k, :2], kept.q[k, :2]]).T, color=COLOURS[1], linewidth=2.5)
way.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title=f"h = {h:g} s")
styles = {
    "moved nodes": (COLOURS[0], "o", "-", 9),
    "kept nodes, start in D": (COLOURS[4], "s", "--", 9),
    "kept nodes, start projected to D_ε": (COLOURS[3], "+", ":", 9),
    "kept nodes, start shifted": (COLOURS[1], "^", "-.", 6),
    "the same, at q - h v/2": (COLOURS[6], "x", ":", 7),
}
for name, (colour, marker, line, size) in styles.items():
    ax.loglog(
        steps, errors[name], color=colour, marker=marker, linestyle=line, markersize=size,
        markerfacecolor="none", label=name,
    )  # fmt: skip
for order, at in ((1, errors["kept nodes, start in D"]), (2, errors["moved nodes"])):
    guide = 0.45 * at[0] * (steps / steps[0]) ** order
    ax.loglog(steps, guide, color="0.6", linewidth=0.8)
    ax.annotate(
        f"slope {order}", (steps[4], guide[4]), (4, -12), textcoords="offset points",
        color="0.3", fontsize="small",
    )  # fmt: skip
ax.set_xlabel("step h (s)")
ax.set_ylabel("error of (q, v) at t = 1 s (m, rad, s)")
ax.set_title("errors against the step")
figure.legend(loc="outside lower center", ncols=2, frameon=False)
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
