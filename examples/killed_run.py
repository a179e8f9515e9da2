"""A run that is killed, and goes on as if nothing had been.

A robot drives by a feedback law and is thrown back by a wall; its run keeps a journal.  A child
process is killed in the middle, as by `kill -9`, a power cut of the batch system, or no memory.
What it has left is read and drawn, and gone on with: the end has the bits of the run that nobody
has killed.

    python killed_run.py [PICTURE.png]
"""

import os
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np

import dalembert as dal

h, steps = 2e-3, 10_000


def forms(q):
    return [[np.sin(q[2]), -np.cos(q[2]), 0.0]]


def turning(q, v):
    return [[0.0, 0.0, np.cos(q[2]) * v[0] + np.sin(q[2]) * v[1]]]


def force(t, q, v, u):
    return [u[0] * np.cos(q[2]), u[0] * np.sin(q[2]), u[1]]


robot = dal.System(
    mass=[8.0, 8.0, 0.3], forms=forms, forms_velocity_derivative=turning, force=force,
    inputs=["push", "turn"], coordinates=["x", "y", "theta"], name="robot", q0=[0, 0, 0.3],
    v0=[0, 0, 0],
)  # fmt: skip
wall = dal.Event(lambda t, q, v: q[0] - 0.8, direction=1, reset=lambda q, v: (q, -v))


def feedback(t, q, v):
    """Return the inputs that lead along a curve at 0.5 m/s."""
    ahead = v[0] * np.cos(q[2]) + v[1] * np.sin(q[2])
    return [4.0 * (0.5 - ahead), 0.3 * (np.cos(0.6 * t) - v[2])]


given = {"inputs": feedback, "events": [wall]}
options = {"h": h, "steps": steps, "stride": 10, "hold": 50}

if len(sys.argv) > 2 and sys.argv[1] == "--child":  # this is the run that will be killed
    dal.integrate(robot, "leapfrog", **options, **given, journal=sys.argv[2])
    sys.exit()

with tempfile.TemporaryDirectory() as folder:
    path = os.path.join(folder, "run.dal")
    child = subprocess.Popen([sys.executable, __file__, "--child", path])
    left = None
    while left is None or left.t[-1] < 4.0:  # anybody may read it meanwhile
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
    t_left, q_left = left.t.copy(), left.q.copy()  # the file goes
whole = dal.integrate(robot, "leapfrog", **options, **given)
same = np.array_equal(run.x, whole.x) and np.array_equal(run.inputs, whole.inputs)
print(f"gone on: {run.message}, {len(run.t_events[0])} times at the wall; the same bits: {same}")
if not (same and len(t_left) < len(run.t) and np.array_equal(q_left, run.q[: len(q_left)])):
    sys.exit("expected the bits of the run that was never killed")

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(7.0, 5.0), layout="constrained")
    ax.plot(run.q[:, 0], run.q[:, 1], color="#0072B2", label="gone on with")
    ax.plot(q_left[:, 0], q_left[:, 1], color="#D55E00", linewidth=2.0, label="before the kill")
    ax.plot(*q_left[-1, :2], "o", color="#D55E00")
    ax.axvline(0.8, color="black", linewidth=3.0)
    ax.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="a run that was killed")
    ax.legend(loc="center left", bbox_to_anchor=(1.1, 0.5))
    figure.savefig(sys.argv[1], dpi=110)
