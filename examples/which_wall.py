"""Which wall of a sloping floor a sleigh hits first, over many initial velocities.

    L = m (v_x^2 + v_y^2)/2 + J v_theta^2/2 - m g y
    -sin(theta) v_x + cos(theta) v_y = a v_theta

The sleigh starts in the middle of a square, with a speed along its blade and a rate of turning;
each pair of them is a member.  Its run ends at the first wall: terminal events, which are
expressions, so that C looks for them.  The map has thin bands in which another wall is first.

Prints how many hit which wall, and how long that took: 15 s for a million runs on two threads.

    python which_wall.py [PICTURE.png] [COUNT]
"""

import math
import sys
import time

import numpy as np
import sympy

import dalembert as dal

count = int(sys.argv[2]) if len(sys.argv) > 2 else 2500
x, y, theta = dal.coordinates("x y theta")
m, J, a, g = sympy.symbols("m J a g", positive=True)
sleigh = dal.System.from_sympy(
    m * (x.d**2 + y.d**2) / 2 + J * theta.d**2 / 2 - m * g * y,
    [-sympy.sin(theta) * x.d + sympy.cos(theta) * y.d - a * theta.d],
    parameters={m: 1.0, J: 0.5, a: 0.2, g: 0.4},
    name="sleigh on a slope",
)
walls = {"right": x - 1, "left": -1 - x, "top": y - 1, "bottom": -1 - y}
side = round(math.sqrt(count))
speed, turning = np.linspace(-1.5, 1.5, side), np.linspace(-3, 3, side)
u, w = np.meshgrid(speed, turning, indexing="ij")
q0 = np.zeros(3)  # heading along x: across the slope
v0 = np.stack([u, 0.2 * w, w], axis=-1)

start = time.perf_counter()
runs = dal.ensemble(
    sleigh, "midpoint", q0, v0, h=0.02, t_end=40,
    events=[dal.Event(wall, terminal=True) for wall in walls.values()],
    axes={"speed": speed, "turning": turning},
)  # fmt: skip
print(runs)
each = 1e6 * (time.perf_counter() - start) / len(runs)
print(f"{each:.0f} us a run of {runs.done.mean():.0f} steps")
for k, name in enumerate(walls):
    here = runs.ended_by == k
    print(f"{name:>7}: {here.mean():6.1%}, after {runs.t[here].mean():.2f} s in the mean")

# Each run ended on its wall, in D; one of them again.
hit = runs.ended_by >= 0
place = np.array([runs.q[:, 0], -runs.q[:, 0], runs.q[:, 1], -runs.q[:, 1]])
assert abs(place[runs.ended_by[hit], np.flatnonzero(hit)] - 1).max() < 1e-13
assert runs.success.all() and runs.worst_residual.max() < 4 * 3 * 2.0**-53
again = runs.member(len(runs) // 3)
assert (again.q[-1] == runs.q[len(runs) // 3]).all()

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.colors import ListedColormap

    colours = ListedColormap(["#DDDDDD", "#0072B2", "#D55E00", "#009E73", "#E69F00"])
    figure, (where, way) = plt.subplots(1, 2, figsize=(11.0, 4.6), layout="constrained")
    grid = runs.ended_by.reshape(runs.shape).T
    mesh = where.pcolormesh(speed, turning, grid, cmap=colours, vmin=-1.5, vmax=3.5,
                            rasterized=True)  # fmt: skip
    figure.colorbar(mesh, ax=where).set_ticks(range(-1, 4), labels=["none", *walls])
    where.set(xlabel="speed along the blade (m/s)", ylabel="rate of turning (rad/s)",
              title=f"the first wall, {len(runs)} runs")  # fmt: skip
    for k in range(side // 40, side, side // 16):  # a row of the map, where turning is 0.9 rad/s
        number = k * side + int(0.65 * side)
        run = runs.member(number)
        colour = colours(int(runs.ended_by[number]) + 1)
        where.plot(speed[k], turning[int(0.65 * side)], "o", ms=4, mfc=colour, mec="black")
        way.plot(run.q[:, 0], run.q[:, 1], lw=1, color=colour)
    way.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", xlim=(-1.05, 1.05),
             ylim=(-1.05, 1.05), title="the runs of the dots")  # fmt: skip
    figure.savefig(sys.argv[1], dpi=110)
