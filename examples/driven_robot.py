"""
A robot finds its way
=====================

A robot on two driven wheels follows a feedback law for its torques, and stops at a wall.

The wheels roll without slipping, in SymPy's formulas::

    L = m (v_x^2 + v_y^2)/2 + I v_theta^2/2 + J (v_left^2 + v_right^2)/2
    both wheels:  v_forward -+ b v_theta = r v_left, r v_right

The torques of the wheels are inputs, constant over 10 steps.  A computer reads the state 100 times
a second and steers towards a target behind the wall.  The run ends at the wall, in D to roundoff.

``python driven_robot.py [PICTURE.png]`` prints the point of impact and the energy balance.  The
energy changes by the work of the torques; the constraints of the wheels do no work.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
import sympy

import dalembert as dal
from dalembert.show.palette import COLOURS

x, y, theta, left, right = dal.coordinates("x y theta left right")
torques = sympy.symbols("torque_left torque_right")
m, inertia, wheel, r, b = sympy.symbols("m I J r b")
forward = sympy.cos(theta) * x.d + sympy.sin(theta) * y.d
robot = dal.System.from_sympy(
    L=m * (x.d**2 + y.d**2) / 2 + inertia * theta.d**2 / 2 + wheel * (left.d**2 + right.d**2) / 2,
    constraints=[
        sympy.sin(theta) * x.d - sympy.cos(theta) * y.d,
        forward - b * theta.d - r * left.d,
        forward + b * theta.d - r * right.d,
    ],
    coordinates=[x, y, theta, left, right],
    parameters={m: 8.0, inertia: 0.3, wheel: 0.002, r: 0.05, b: 0.15},
    force={left: torques[0], right: torques[1]},
    inputs=torques,
    name="robot",
    q0=np.zeros(5),
    v0=np.zeros(5),
)

# %%
# The controller
# --------------
# It is a function of (t, q, v), called once for every ten steps.  In between, its torques are held,
# as in the amplifiers of a real robot.

target, wall = np.array([4.0, 3.0]), 3.0
h, hold, t_end = 1e-3, 10, 20.0


def feedback(t, q, v):
    """Return the torques that turn the robot towards the target at 0.8 m/s."""
    aim = np.arctan2(*(target - q[:2])[::-1])
    turn = (aim - q[2] + np.pi) % (2 * np.pi) - np.pi
    speed = v[0] * np.cos(q[2]) + v[1] * np.sin(q[2])
    push, twist = 0.3 * (0.8 * np.cos(turn) - speed), 0.05 * turn - 0.03 * v[2]
    return np.array([push - twist, push + twist])


# %%
# The run
# -------
# An event ends the run when x reaches the wall.  The last state is the state at that instant, not
# at the end of the step.

hit = dal.Event(x - wall, direction=1, terminal=True)
run = dal.integrate(robot, "leapfrog", h=h, t_end=t_end, inputs=feedback, hold=hold, events=[hit])
# The torques are constant over a step: their work in it is torque times rotation of the wheels.
steps = np.minimum(np.arange(len(run.t) - 1) // hold, len(run.inputs) - 1)
turned = np.diff(run.q[:, 3:], axis=0)
work = np.concatenate([[0.0], np.cumsum(np.sum(run.inputs[steps] * turned, axis=1))])
error = abs(run.energy - run.energy[0] - work).max()
print(f"the wall is hit at t = {run.t[-1]:.6f}, y = {run.q[-1, 1]:.6f}")
print(f"energy at the end {run.energy[-1]:.6f}, balance kept to {error:.1e}")
print(f"wheels roll to {run.residual.max():.1e}")
if not (run.status == 1 and abs(run.q[-1, 0] - wall) < 1e-12 and run.residual.max() < 1e-14):
    sys.exit("the run was expected to end at the wall, in D to roundoff")
if not error < 1e-4 * work[-1]:
    sys.exit("expected the change of the energy to equal the work of the torques")

# %%
# The path to the wall
# --------------------
# The robot from above, with its hull and its wheels.  The trails mark where the wheels have rolled:
# the length of each is r times the angle by which its wheel has turned.

draw = dal.plot.bodies
radius = 0.2
bricks = np.array([(0.0, -0.4), (0.12, -0.4), (0.12, 3.4), (0.0, 3.4)]) + [wall + radius, 0.0]


def seen(t, q, v):
    """Return the robot at q, the target, and the wall, which the hull touches at the end."""
    ahead = np.array([np.cos(q[2]), np.sin(q[2])])
    side = 0.15 * np.array([-ahead[1], ahead[0]])
    return [
        draw.polygon(bricks),
        draw.dot(target),
        draw.circle(q[:2], radius),
        draw.line(q[:2], q[:2] + radius * ahead),
        draw.blade(q[:2] + side, q[2], 0.16, constraints=1),
        draw.blade(q[:2] - side, q[2], 0.16, constraints=2),
    ]


dal.plot.animate(run, seen, fps=12, seconds=6, multipliers=False)

# %%

ax = dal.plot.snapshots(run, seen, count=8)
figure = ax.figure
ax.set_title("the path to the wall; lengths in m", loc="left", fontsize="medium")
note = ax.annotate("target", target, (0, -16), textcoords="offset points", ha="center")

# %%
# The inputs
# ----------
# The torques of the feedback law, and the energy balance with them:

other, (torque, balance) = plt.subplots(2, 1, figsize=(7.0, 5.0), sharex=True, layout="constrained")
for k, name in enumerate(("left", "right")):
    t = np.arange(len(run.inputs)) * hold * h
    torque.step(t, run.inputs[:, k], where="post", color=COLOURS[k], label=name)
torque.set(ylabel="torque (N m)", title="inputs, held for 10 steps")
balance.plot(run.t, run.energy - run.energy[0], color=COLOURS[0], label="energy")
balance.plot(run.t, work, "--", color=COLOURS[1], label="work of the torques")
balance.set(xlabel="t (s)", ylabel="energy, work (J)")
for axis in (torque, balance):
    axis.legend(frameon=False)
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
