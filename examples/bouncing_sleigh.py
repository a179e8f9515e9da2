"""
A sleigh in a box
=================

The blade of a sleigh prevents sideways slip, and the walls of a box reflect it by events with
resets.

The blade constrains the sleigh; the box is on an incline, with x downhill::

    sin(theta) v_x - cos(theta) v_y = 0

At a wall an impulse acts along the normal of the wall and across the blade.  The velocity after it
lies in D again.  It reverses the part of the velocity towards the wall, as far as D
allows.  Both impulses are computed in the metric of the mass, so the energy is conserved.

``python bouncing_sleigh.py [PICTURE.png]`` prints the walls in the order of the impacts, the
distance of the sleigh from them, and the conserved quantities.  D holds to roundoff; neither blade
nor walls change the energy.
"""

import sys

import numpy as np

import dalembert as dal
from dalembert.show.palette import COLOURS

system = dal.systems.knife_edge(gs=0.25)
M = system.mass
walls = {"left": (0, -1.0), "right": (0, 1.0), "bottom": (1, -1.0), "top": (1, 1.0)}

# %%
# The reset at a wall
# -------------------
# A reset receives the state at a wall and returns the state from which the run continues.  The
# normal of the wall is a covector; its component in D, orthogonal in the metric M, is the direction
# of the impulse.  A state outside D would be refused.


def bounce(coordinate):
    """Return the reset at a wall: the impulse in D that reverses the velocity towards it."""

    def reset(q, v):
        mu = np.array([np.sin(q[2]), -np.cos(q[2]), 0.0])
        normal = np.linalg.solve(M, np.eye(3)[coordinate])
        normal -= np.linalg.solve(M, mu) * (mu @ normal) / (mu @ np.linalg.solve(M, mu))
        return q, v - 2.0 * v[coordinate] / normal[coordinate] * normal

    return reset


def event(coordinate, at):
    """Return the event at a wall, met from inside."""
    return dal.Event(
        lambda t, q, v: at - q[coordinate] if at > 0 else q[coordinate] - at,
        direction=-1, reset=bounce(coordinate),
    )  # fmt: skip


# %%
# The run
# -------
# The instant of an impact is computed by steps of the scheme itself, so the sleigh is at its wall
# to roundoff, and in D.

start = [0.0, 0.0, 0.2], [1.5 * np.cos(0.2), 1.5 * np.sin(0.2), 0.7]
given = {"h": 0.02, "events": [event(*wall) for wall in walls.values()]}
run = dal.integrate(system, "leapfrog-kl6", *start, t_end=20.0, **given)
hits = sorted((t, name) for name, times in zip(walls, run.t_events) for t in times)
print("walls:", " ".join(name for _, name in hits))
touch = max(
    abs(q[:, coordinate] - at).max(initial=0.0)
    for q, (coordinate, at) in zip(run.q_events, walls.values())
)
drift = abs(run.energy - run.energy[0]).max()
after = max(
    system.relative_residual(q, v).max() for q, v in zip(run.q_after, run.v_after) if len(q)
)
print(f"{len(hits)} bounces, each at its wall to {touch:.1e}")
print(f"D is kept to {max(run.residual.max(), after):.1e}, the energy to {drift:.1e}")
if not (len(hits) > 5 and touch < 1e-12 and run.residual.max() < 1e-14 and drift < 1e-6):
    sys.exit("bounces at the walls were expected, that keep D and the energy")
if abs(run.q[:, :2]).max() > 1.0 + 1e-12:
    sys.exit("the sleigh was expected to stay in the box")

# %%
# The motion
# ----------
# A function returns the shapes to draw: the sledge, its blade, whose middle leaves the trail, and
# the box.  Move the slider:

draw = dal.plot.bodies
sledge = 0.2 * np.array([(-0.6, -0.3), (0.3, -0.35), (0.8, 0), (0.3, 0.35), (-0.6, 0.3)])


def in_box(t, q, v):
    """Return the shapes of the sledge at q, and of the box."""
    cos, sin = np.cos(q[2]), np.sin(q[2])
    return [
        draw.line((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)),
        draw.polygon(q[:2] + sledge @ [[cos, sin], [-sin, cos]]),
        draw.blade(q[:2], q[2], 0.2, constraints=0),
    ]


dal.plot.animate(run, in_box, fps=12, seconds=12, multipliers=False)

# %%
# The first impacts in one picture.  The middle of the blade meets the walls.  There the speed along
# the blade is reversed, because D allows no other direction.  The sledge rotates as before, and
# therefore returns on another curve.

first = dal.integrate(system, "leapfrog-kl6", *start, t_end=8.0, **given)
ax = dal.plot.snapshots(first, in_box, count=15)
ax.set_title("a sleigh in a box, x downhill", loc="left", fontsize="medium")
for q in first.q_events:
    ax.plot(q[:, 0], q[:, 1], "o", color=COLOURS[3], markersize=6)
if len(sys.argv) > 1:
    ax.figure.savefig(sys.argv[1], dpi=110)
