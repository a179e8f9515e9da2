"""A robot on two driven wheels finds its way by a feedback law, and stops at a wall.

    L = m (v_x^2 + v_y^2)/2 + I v_theta^2/2 + J (v_left^2 + v_right^2)/2
    both wheels roll without slipping:  v_forward -+ b v_theta = r v_left, r v_right

The torques of the wheels are inputs, constant over 10 steps: a computer looks at the state 100
times a second and aims at a target behind the wall.  The run ends at the wall, in D to roundoff.

Prints where the robot hits the wall, and the energy balance: the work of the torques is what the
energy has changed by, and the wheels' constraints do none.

    python driven_robot.py [PICTURE.png]
"""

import sys

import numpy as np
import sympy

import dalembert as dal

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
target, wall = np.array([4.0, 3.0]), 3.0
h, hold, t_end = 1e-3, 10, 20.0


def feedback(t, q, v):
    """Return the torques that turn the robot towards the target and let it drive at 0.8 m/s."""
    aim = np.arctan2(*(target - q[:2])[::-1])
    turn = (aim - q[2] + np.pi) % (2 * np.pi) - np.pi
    speed = v[0] * np.cos(q[2]) + v[1] * np.sin(q[2])
    push, twist = 0.3 * (0.8 * np.cos(turn) - speed), 0.05 * turn - 0.03 * v[2]
    return np.array([push - twist, push + twist])


hit = dal.Event(x - wall, direction=1, terminal=True)
run = dal.integrate(
    robot, "leapfrog", h=h, t_end=t_end, inputs=feedback, hold=hold, events=[hit]
)
# The torques are constant over a step: their work in it is that times the turn of the wheels.
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
    sys.exit("the work of the torques was expected to be what the energy changes by")

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (way, torque) = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    way.plot(run.q[:, 0], run.q[:, 1], color="#0072B2")
    way.axvline(wall, color="black", linewidth=3.0)
    way.plot(*target, "x", color="#D55E00")
    way.text(*target - [0.1, 0.0], "target", color="#D55E00", ha="right", va="center")
    way.set(xlabel="x (m)", ylabel="y (m)", aspect="equal", title="the way to the wall")
    for k, (name, colour) in enumerate(zip(("left", "right"), ("#0072B2", "#D55E00"))):
        t = np.arange(len(run.inputs)) * hold * h
        torque.step(t, run.inputs[:, k], where="post", color=colour, label=name)
    torque.set(xlabel="t (s)", ylabel="torque (N m)", title="inputs, held for 10 steps")
    torque.legend()
    figure.savefig(sys.argv[1], dpi=110)
