"""
An environment for learning
===========================

A robot as an environment for reinforcement learning, with the ``reset`` and ``step`` of Gymnasium.
Its episodes are runs of the integrator, bit for bit.

The class has the two methods of a ``gymnasium.Env`` and needs only dalembert and NumPy.  An agent
pushes and turns a cart on a blade, which cannot slip sideways, towards the origin.  An action lasts
for 20 steps of the scheme.  An episode can be saved at any time and resumed.

``python environment.py [PICTURE.png]`` prints the rewards of some episodes with a simple rule.  It
checks that each episode is, bit for bit, the run with the same inputs.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
import sympy

import dalembert as dal
from dalembert.show.palette import COLOURS


def make_cart():
    """Return the system: a blade at (x, y) with heading theta, and friction."""
    x, y, theta = dal.coordinates("x y theta")
    push, turn = sympy.symbols("push turn")
    along = sympy.Matrix([sympy.cos(theta), sympy.sin(theta)])
    return dal.System.from_sympy(
        L=(x.d**2 + y.d**2) / 2 + theta.d**2 / 8,
        constraints=[sympy.sin(theta) * x.d - sympy.cos(theta) * y.d],
        force={
            x: push * along[0] - x.d / 2, y: push * along[1] - y.d / 2, theta: turn - theta.d / 4
        },
        inputs=[push, turn],
        name="cart",
    )  # fmt: skip


# %%
# The environment
# ---------------
# A `dalembert.Stepper` holds the state of a run, and computes steps with given inputs.  It is
# created once; an agent calls only its ``step``, which is cheap, a million times.


class CartEnv:
    """Drive to the origin: the observation is (q, v), the action (push, turn) in [-1, 1]."""

    actions_last, longest, h = 20, 200, 0.005

    def __init__(self):
        self.system = make_cart()
        self.stepper = None

    def reset(self, seed=None):
        """Begin an episode at a random state, at rest; return the observation and the info."""
        source = np.random.default_rng(seed)
        q = np.array([*source.uniform(-2, 2, 2), source.uniform(-np.pi, np.pi)])
        if self.stepper is None:
            self.stepper = dal.Stepper(self.system, "midpoint", q, np.zeros(3), h=self.h)
        self.stepper.reset(q, np.zeros(3), t=0.0)
        self.actions = 0
        return self.stepper.x, {}

    def step(self, action):
        """Apply an action; return observation, reward, terminated, truncated, info."""
        self.stepper.step(np.clip(action, -1.0, 1.0), steps=self.actions_last)
        self.actions += 1
        x = self.stepper.x
        reward = -np.hypot(x[0], x[1]) * self.h * self.actions_last
        return x, reward, bool(np.hypot(x[0], x[1]) < 0.05), self.actions == self.longest, {}


# %%
# An agent
# --------
# In place of a trained network, a rule drives to the origin, forwards or backwards, whichever is
# shorter.


def rule(x):
    """Return an action: turn towards the origin, and drive in proportion to its distance ahead."""
    ahead = -(np.cos(x[2]) * x[0] + np.sin(x[2]) * x[1])
    beside = np.sin(x[2]) * x[0] - np.cos(x[2]) * x[1]
    speed = np.cos(x[2]) * x[3] + np.sin(x[2]) * x[4]
    aim = np.arctan2(beside, ahead) if ahead > 0 else np.arctan2(-beside, -ahead)
    return np.array([2.0 * ahead - 1.5 * speed, 2.0 * aim - 0.7 * x[5]])


# %%
# Episodes
# --------
# The actions of the agent are a table of inputs, and the run with this table has the bits of the
# episode.

env, runs = CartEnv(), []
for seed in range(5):
    x, _ = env.reset(seed)
    total, done, states, inputs = 0.0, False, [x], []
    while not done:
        action = np.clip(rule(x), -1.0, 1.0)
        x, reward, terminated, truncated, _ = env.step(action)
        total, done = total + reward, terminated or truncated
        states.append(x)
        inputs.append(action)
    print(f"episode {seed}: {len(inputs):3d} actions, reward {total:8.4f}, arrived: {terminated}")
    run = dal.integrate(
        env.system, "midpoint", *np.split(states[0], 2), h=env.h, stride=env.actions_last,
        steps=len(inputs) * env.actions_last, inputs=inputs, hold=env.actions_last,
    )  # fmt: skip
    if not np.array_equal(run.x, np.array(states)):
        sys.exit("the episode was expected to be the run with these inputs, bit for bit")
    runs.append(run)

# %%
# The longest episode
# -------------------
# Since an episode is a run, every function for runs applies to it, for instance a film.

draw = dal.plot.bodies
outline = np.array([(-0.16, -0.1), (0.12, -0.1), (0.2, 0.0), (0.12, 0.1), (-0.16, 0.1)])


def cart(t, q, v):
    """Return the shapes of the cart at q, and of its target."""
    cos, sin = np.cos(q[2]), np.sin(q[2])
    return [
        draw.circle((0, 0), 0.05),
        draw.polygon(q[:2] + outline @ [[cos, sin], [-sin, cos]]),
        draw.blade(q[:2], q[2], 0.2, constraints=0),
    ]


dal.plot.animate(max(runs, key=len), cart, fps=12, seconds=4, multipliers=False)

# %%
# All episodes; later ones are darker.  Some carts drive backwards.

figure, ax = plt.subplots(figsize=(6.0, 5.4), layout="constrained")
for seed, run in enumerate(runs):
    dal.plot.snapshots(run, cart, ax, count=5)
    ax.plot(run.q[:, 0], run.q[:, 1], color=COLOURS[seed], linewidth=2.5, label=f"episode {seed}")
ax.set(xlim=(-2.1, 2.1), ylim=(-1.5, 2.2), xlabel="x", ylabel="y")
ax.set_title("from five places to the origin", loc="left")
ax.set_title("", loc="right")
ax.legend(frameon=False, loc="upper right")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
