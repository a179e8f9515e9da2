"""
A killed run
============

A run that is killed resumes from its journal.  The end is bitwise identical to an uninterrupted
run.

A robot drives by a feedback law and is reflected by a wall; its run keeps a journal.  A child
process is killed in the middle, as by ``kill -9``, a power cut, a batch system, or lack of memory.
Its journal is read, drawn and resumed.

``python killed_run.py [PICTURE.png]`` prints the length of the killed run, and whether the resumed
run has the bits of the uninterrupted one.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np

import dalembert as dal
from dalembert.show.palette import COLOURS

h, steps = 4e-3, 5_000


def forms(q):
    return [[np.sin(q[2]), -np.cos(q[2]), 0.0]]


def turning(q, v):
    return [[0.0, 0.0, np.cos(q[2]) * v[0] + np.sin(q[2]) * v[1]]]


def force(t, q, v, u):
    return [u[0] * np.cos(q[2]), u[0] * np.sin(q[2]), u[1]]


robot = dal.System(
    mass=[8.0, 8.0, 0.3], mu=forms, mu_v_q=turning, force=force,
    inputs=["push", "turn"], coordinates=["x", "y", "theta"], name="robot", q0=[0, 0, -1.27],
    v0=[0, 0, 0],
)  # fmt: skip
wall = dal.Event(lambda t, q, v: q[1] + 0.8, direction=-1, reset=lambda q, v: (q, -v))


def feedback(t, q, v):
    """Return the inputs that lead along a curve at 0.5 m/s."""
    ahead = v[0] * np.cos(q[2]) + v[1] * np.sin(q[2])
    return [4.0 * (0.5 - ahead), 0.3 * (np.cos(0.6 * t) - v[2])]


# %%
# The run that will be killed
# ---------------------------
# The argument ``journal`` of `dalembert.integrate` names a file.  The stored rows are written to it
# several times a second.  The script starts itself once more, as the child that computes this run.

given = {"inputs": feedback, "events": [wall]}
options = {"h": h, "steps": steps, "stride": 5, "hold": 25}

if len(sys.argv) > 2 and sys.argv[1] == "--child":  # this is the run that will be killed
    dal.integrate(robot, "leapfrog", **options, **given, journal=sys.argv[2])
    sys.exit()

# %%
# Kill and resume it
# ------------------
# The file contains no callbacks, so they are passed again.

with tempfile.TemporaryDirectory() as folder:
    path = os.path.join(folder, "run.dal")
    child = subprocess.Popen([sys.executable, sys.argv[0], "--child", path])
    left = None
    while left is None or left.t[-1] < 4.0:  # the journal can be read during the run
        time.sleep(0.05)
        if child.poll() is not None:
            sys.exit("the run was expected to take longer")
        if os.path.exists(path) and os.path.getsize(path) > 10_000:
            left = dal.load(path, robot)
    child.send_signal(signal.SIGKILL)
    child.wait()
    left = dal.load(path, robot)
    print(f"killed: {left.message.split(', from')[0]}")
    run = dal.resume(path, robot, **given)
    t_left, q_left = left.t.copy(), left.q.copy()  # the file will be removed
whole = dal.integrate(robot, "leapfrog", **options, **given)
same = np.array_equal(run.x, whole.x) and np.array_equal(run.inputs, whole.inputs)
print(f"resumed: {run.message}, {len(run.t_events[0])} times at the wall; the same bits: {same}")
if not (same and len(t_left) < len(run.t) and np.array_equal(q_left, run.q[: len(q_left)])):
    sys.exit("expected the bits of the run that was never killed")

# %%
# The part of the killed process, and the complete run:

draw = dal.plot.bodies


def seen(t, q, v):
    """Return the robot at q, and the wall that its hull touches when y is -0.8."""
    ahead = np.array([np.cos(q[2]), np.sin(q[2])])
    side = 0.1 * np.array([-ahead[1], ahead[0]])
    return [
        draw.line((-0.2, -0.95), (4.0, -0.95)),
        draw.circle(q[:2], 0.15),
        draw.line(q[:2], q[:2] + 0.15 * ahead),
        draw.blade(q[:2] + side, q[2], 0.12),
        draw.blade(q[:2] - side, q[2], 0.12),
        draw.dot(q[:2], constraints=0),
    ]


ax = dal.plot.snapshots(run, seen, count=10)
ax.plot(q_left[:, 0], q_left[:, 1], color=COLOURS[3], linewidth=4.0)
ax.plot(*q_left[-1, :2], "X", color=COLOURS[3], markersize=14)
ax.annotate("killed", q_left[-1, :2], (0, 14), textcoords="offset points", ha="center")
ax.set_title("a run that was killed; lengths in m", loc="left", fontsize="medium")
if len(sys.argv) > 1:
    ax.figure.savefig(sys.argv[1], dpi=110)
