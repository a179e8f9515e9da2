"""A robot as an environment for learning: reset and step, as Gymnasium has them.

The class has the two methods of a `gymnasium.Env` and needs nothing but dalembert and NumPy.  An
agent pushes and turns a cart on a blade, which cannot slip sideways, towards the origin; an action
lasts for 20 steps of the scheme.  An episode can be saved in the middle and gone on with.

Prints the rewards of some episodes with a simple rule, and checks that the episode is, bit for
bit, the run with the same inputs.

    python environment.py [PICTURE.png]
"""

import sys

import numpy as np
import sympy

import dalembert as dal


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


class CartEnv:
    """Drive to the origin: the observation is (q, v), the action (push, turn) in [-1, 1]."""

    actions_last, longest, h = 20, 200, 0.005

    def __init__(self):
        self.system = make_cart()
        self.stepper = None

    def reset(self, seed=None):
        """Begin an episode somewhere, at rest; return the observation and what else is known."""
        source = np.random.default_rng(seed)
        q = np.array([*source.uniform(-2, 2, 2), source.uniform(-np.pi, np.pi)])
        if self.stepper is None:
            self.stepper = dal.Stepper(self.system, "midpoint", q, np.zeros(3), h=self.h)
        self.stepper.reset(q, np.zeros(3), t=0.0)
        self.actions = 0
        return self.stepper.x, {}

    def step(self, action):
        """Make an action; return observation, reward, terminated, truncated, info."""
        self.stepper.step(np.clip(action, -1.0, 1.0), steps=self.actions_last)
        self.actions += 1
        x = self.stepper.x
        reward = -np.hypot(x[0], x[1]) * self.h * self.actions_last
        return x, reward, bool(np.hypot(x[0], x[1]) < 0.05), self.actions == self.longest, {}


def rule(x):
    """Return an action: turn towards the origin, and drive as far as that is ahead."""
    ahead = -(np.cos(x[2]) * x[0] + np.sin(x[2]) * x[1])
    beside = np.sin(x[2]) * x[0] - np.cos(x[2]) * x[1]
    speed = np.cos(x[2]) * x[3] + np.sin(x[2]) * x[4]
    aim = np.arctan2(beside, ahead) if ahead > 0 else np.arctan2(-beside, -ahead)
    return np.array([2.0 * ahead - 1.5 * speed, 2.0 * aim - 0.7 * x[5]])


env, ways = CartEnv(), []
for seed in range(5):
    x, _ = env.reset(seed)
    total, done, states, inputs = 0.0, False, [x], []
    while not done:
        action = np.clip(rule(x), -1.0, 1.0)
        x, reward, terminated, truncated, _ = env.step(action)
        total, done = total + reward, terminated or truncated
        states.append(x)
        inputs.append(action)
    ways.append(np.array(states))
    print(f"episode {seed}: {len(inputs):3d} actions, reward {total:8.4f}, arrived: {terminated}")
    run = dal.integrate(
        env.system, "midpoint", *np.split(states[0], 2), h=env.h, stride=env.actions_last,
        steps=len(inputs) * env.actions_last, inputs=inputs, hold=env.actions_last,
    )  # fmt: skip
    if not np.array_equal(run.x, ways[-1]):
        sys.exit("the episode was expected to be the run with these inputs, bit for bit")

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(5.5, 5.0), layout="constrained")
    for way in ways:
        ax.plot(way[:, 0], way[:, 1])
        ax.plot(*way[0, :2], "o", color="black", markersize=4)
    ax.plot(0, 0, "x", color="black")
    ax.set(xlabel="x", ylabel="y", aspect="equal", title="episodes, from the dots to the cross")
    figure.savefig(sys.argv[1], dpi=110)
