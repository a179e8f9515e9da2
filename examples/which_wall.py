"""
Which wall is first?
====================

A sleigh starts in the middle of a sloping room.  The wall that it hits first is a map of its
initial velocities, with thin bands in it.  Thousands of runs that end by events compute this map.

Each pair of a speed along the blade and a rate of turning is a member of the ensemble::

    L = m (v_x^2 + v_y^2)/2 + J v_theta^2/2 - m g y
    -sin(theta) v_x + cos(theta) v_y = a v_theta

Its run ends at the first wall by terminal events.  They are expressions, so C evaluates them.

``python which_wall.py [PICTURE.png] [COUNT]`` prints the number of hits of each wall, and the run
time: 15 s for a million runs on two threads.
"""

import math
import sys
import time

import matplotlib.pyplot as plt
import numpy as np
import sympy
from matplotlib.colors import ListedColormap

import dalembert as dal
from dalembert.show.palette import COLOURS, GROUND

count = int(sys.argv[2]) if len(sys.argv) > 2 else 22500
x, y, theta = dal.coordinates("x y theta")
m, J, a, g = sympy.symbols("m J a g", positive=True)
sleigh = dal.System.from_sympy(
    m * (x.d**2 + y.d**2) / 2 + J * theta.d**2 / 2 - m * g * y,
    [-sympy.sin(theta) * x.d + sympy.cos(theta) * y.d - a * theta.d],
    parameters={m: 1.0, J: 0.5, a: 0.2, g: 0.4},
    name="sleigh on a slope",
)
walls = {"right": x - 1, "left": -1 - x, "top": y - 1, "bottom": -1 - y}

# %%
# All members at once.  The initial heading is along x, across the slope.

side = round(math.sqrt(count))
speed, turning = np.linspace(-1.5, 1.5, side), np.linspace(-3, 3, side)
u, w = np.meshgrid(speed, turning, indexing="ij")
q0 = np.zeros(3)
v0 = np.stack([u, 0.2 * w, w], axis=-1)

start = time.perf_counter()
runs = dal.ensemble(
    sleigh, "midpoint", q0, v0, h=0.02, t_end=40,
    events=[dal.Event(wall, terminal=True) for wall in walls.values()],
    axes={"speed": speed, "turning": turning}, progress=count > 100_000,
)  # fmt: skip
print(runs)
each = 1e6 * (time.perf_counter() - start) / len(runs)
print(f"{each:.0f} us a run of {runs.done.mean():.0f} steps")
for k, name in enumerate(walls):
    here = runs.ended_by == k
    print(f"{name:>7}: {here.mean():6.1%}, after {runs.t[here].mean():.2f} s in the mean")

# %%
# Each run ended on its wall, in D; one of them, repeated, has the same bits.

hit = runs.ended_by >= 0
place = np.array([runs.q[:, 0], -runs.q[:, 0], runs.q[:, 1], -runs.q[:, 1]])
if abs(place[runs.ended_by[hit], np.flatnonzero(hit)] - 1).max() > 1e-13:
    sys.exit("the runs were expected to end on their walls")
if not (runs.success.all() and runs.worst_residual.max() < 4 * 3 * 2.0**-53):
    sys.exit("all members were expected to go through, in D to roundoff")
again = runs.member(len(runs) // 3)
if not (again.q[-1] == runs.q[len(runs) // 3]).all():
    sys.exit("a member was expected to be the same when it is run alone")

# %%
# The map, and the paths of the marked runs in the room.

colours = ListedColormap([GROUND, COLOURS[0], COLOURS[1], COLOURS[2], COLOURS[4]])
figure, (where, way) = plt.subplots(1, 2, figsize=(9.6, 4.9), layout="constrained")
grid = runs.ended_by.reshape(runs.shape).T
where.pcolormesh(speed, turning, grid, cmap=colours, vmin=-1.5, vmax=3.5, rasterized=True)
where.set(xlabel="speed along the blade (m/s)", ylabel="rate of turning (rad/s)")
where.set_title(f"the first wall, {len(runs)} runs")
row = int(0.65 * side)  # of the map, at a rate of 0.9 rad/s
for k in range(side // 40, side, side // 16):
    run = runs.member(k * side + row)
    colour = colours(int(runs.ended_by[k * side + row]) + 1)
    where.plot(speed[k], turning[row], "o", markersize=6, color=colour, markeredgecolor="white")
    way.plot(run.q[:, 0], run.q[:, 1], linewidth=1.4, color=colour)
corners = {"right": (1, 1, -1, 1), "left": (-1, -1, -1, 1), "top": (-1, 1, 1, 1)}
corners["bottom"] = (-1, 1, -1, -1)
for k, name in enumerate(walls):
    x0, x1, y0, y1 = corners[name]
    way.plot([x0, x1], [y0, y1], linewidth=7, color=colours(k + 1), solid_capstyle="butt")
    turned = 90 * (x0 == x1)
    at = 1.11 * np.array([x0 + x1, y0 + y1]) / 2
    way.text(*at, name, color=colours(k + 1), rotation=turned, ha="center", va="center")
way.annotate("downhill", (-0.5, 0.35), (-0.5, 0.7), color="0.4", ha="center",
             arrowprops={"arrowstyle": "->", "color": "0.4"})  # fmt: skip
way.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))
way.set_title("the runs of the dots")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
