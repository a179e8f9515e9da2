"""
Your own system
===============

A user-defined system from formulas in plain Python: a cart with two wheels on an incline, which
rolls sideways along a cycloid.

q = (x, y, phi, left, right): the middle of the axle, which is the centre of mass, with x downhill;
the heading; the rotation angles of the wheels::

    L = m (v_x^2 + v_y^2)/2 + J v_phi^2/2 + I (v_left^2 + v_right^2)/2 + m g x
    -sin(phi) v_x + cos(phi) v_y                       = 0    the wheels do not slip sideways
     cos(phi) v_x + sin(phi) v_y - b v_phi - R v_left  = 0    nor along their planes
     cos(phi) v_x + sin(phi) v_y + b v_phi - R v_right = 0
    q = 0, v = (0, 0, w, -b w/R, b w/R) at t = 0: it turns on the spot and is released

First integrals: the energy, v_phi, and R (right - left) - 2 b phi.  The exact motion is a
cycloid.  With a = g m/(m + 2 I/R^2) the cart never rolls down by more than a/(2 w^2); it drifts
sideways by pi a/w^2 in each turn.

``python own_system.py [PICTURE.png]`` prints the findings of System.check, these two lengths for
ten turns beside the exact ones, and the errors of energy, first integrals and constraints.
``examples/own_system.c`` prints the same in C.
"""

import sys
from math import cos, pi, sin

import matplotlib.pyplot as plt
import numpy as np

import dalembert as dal

m, J = 2.0, 0.3  # of the whole cart
I, R = 0.05, 0.25  # of a wheel
b = 0.4  # half the length of the axle
g = 1.5  # the downhill part of the acceleration of gravity
w = 1.25
turns, steps_a_turn = 10, 200


def forms(q):
    s, c = sin(q[2]), cos(q[2])
    return [[-s, c, 0, 0, 0], [c, s, -b, -R, 0], [c, s, b, 0, -R]]


def mu_v_q(q, v):
    """Return d(mu v)/dq, which contains only the heading."""
    s, c = sin(q[2]), cos(q[2])
    sideways, along = -c * v[0] - s * v[1], -s * v[0] + c * v[1]
    return [[0, 0, sideways, 0, 0], [0, 0, along, 0, 0], [0, 0, along, 0, 0]]


# %%
# The system
# ----------
# The derivative of the forms is optional; without it differences are used, and a step is slower.
# The check compares it with differences, and tests whether the constraints are nonholonomic.

cart = dal.System(
    mass=[m, m, J, I, I],
    mu=forms,
    mu_v_q=mu_v_q,
    potential=lambda q: -m * g * q[0],
    gradient=lambda q: [-m * g, 0, 0, 0, 0],
    hessian=lambda q: [[0] * 5] * 5,
    name="cart",
    coordinates=["x", "y", "phi", "left", "right"],
    q0=[0, 0, 0, 0, 0],
    v0=[0, 0, w, -b * w / R, b * w / R],
    invariants={
        "v_phi": lambda q, v: v[2],
        "R (right - left) - 2 b phi": lambda q, v: R * (q[4] - q[3]) - 2 * b * q[2],
    },
)
check = cart.check()
print(f"check: {check.text}")
if not check:
    sys.exit(1)

# %%
# Ten turns
# ---------

h = 2 * pi / (w * steps_a_turn)
run = dal.integrate(cart, "leapfrog", h=h, steps=turns * steps_a_turn)
v_phi, slip = cart.invariant(run.q, run.v).values()
a = g * m / (m + 2 * I / (R * R))


def off(values):
    """Return the largest |value - first value|."""
    return abs(values - values[0]).max()


print(f"rolls down by up to  {run.q[:, 0].max():.6f}, exactly {a / (2 * w * w):.6f}")
print(f"drifts in {turns} turns   {run.q[-1, 1]:.6f}, exactly {turns * pi * a / (w * w):.6f}")
print(f"energy               {run.energy[0]:.6f}, off by {off(run.energy):.3e}")
print(f"v_phi                {v_phi[0]:.6f}, off by {off(v_phi):.1e}")
print(f"R (right - left) - 2 b phi    off by {off(slip):.1e}")
print(f"worst residual of D  {run.residual.max():.1e}")

# %%
# The motion
# ----------
# The view from above, with the downhill direction drawn downwards.  The middle of the axle moves
# along the cycloid, and after each half turn it returns to its initial height.

draw = dal.plot.bodies


def seen(t, q, v):
    """Return the cart from above: a wedge between the wheels, and the wheels."""
    middle = np.array([q[1], -q[0]])
    ahead = np.array([sin(q[2]), -cos(q[2])])
    side = b * np.array([-ahead[1], ahead[0]])
    return [
        draw.polygon([middle + side, middle - side, middle + 0.4 * ahead]),
        draw.blade(middle + side, q[2] - pi / 2, 2 * R, constraints=1),
        draw.blade(middle - side, q[2] - pi / 2, 2 * R, constraints=2),
        draw.dot(middle, constraints=0),
    ]


short = dal.integrate(cart, "leapfrog", h=h, steps=3 * steps_a_turn // 2)
dal.plot.animate(short, seen, fps=12, seconds=5, multipliers=False)

# %%

figure, ax = plt.subplots(figsize=(7.2, 3.6), layout="constrained")
ax = dal.plot.snapshots(short, seen, ax, count=6)
ax.set(xlabel="y, sideways", ylabel="-x, uphill")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
