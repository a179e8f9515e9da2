"""A sleigh in a box: its blade keeps it from slipping sideways, the walls throw it back.

At a wall an impulse acts on the runner, along the wall's normal and across the blade, so that the
velocity after it lies in D again: it is the one before it, with the part towards the wall reversed,
as far as D allows.  Both are solved for in the metric of the mass, so that the energy is kept.

Prints the walls in the order in which they were hit, how exactly the sleigh touches them, and what
is kept: D to roundoff, and the energy, which neither blade nor walls change.

    python bouncing_sleigh.py [PICTURE.png]
"""

import sys

import numpy as np

import dalembert as dal

system = dal.systems.knife_edge(gs=0.25)
M = system.mass
walls = {"left": (0, -1.0), "right": (0, 1.0), "bottom": (1, -1.0), "top": (1, 1.0)}


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


start = [0.0, 0.0, 0.2], [1.5 * np.cos(0.2), 1.5 * np.sin(0.2), 0.7]
given = {"h": 0.02, "t_end": 20.0, "events": [event(*wall) for wall in walls.values()]}
run = dal.integrate(system, "leapfrog-kl6", *start, **given)
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

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    times = np.linspace(0.0, 20.0, 8001)
    fine = dal.integrate(system, "leapfrog-kl6", *start, t_eval=times, **given)
    figure, ax = plt.subplots(figsize=(5.5, 5.0), layout="constrained")
    ax.plot(fine.q[:, 0], fine.q[:, 1], linewidth=0.8, color="#0072B2")
    for q in run.q_events:
        ax.plot(q[:, 0], q[:, 1], "o", color="#D55E00", markersize=4)
    ax.set(xlabel="x, downhill", ylabel="y", aspect="equal", title="a sleigh in a box")
    figure.savefig(sys.argv[1], dpi=110)
