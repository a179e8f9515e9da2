"""
Three gaits of a snakeboard
===========================

A rider moves arms and axles as sines of the time.  With equal frequencies the board drives, with 2
: 1 it turns on the spot, with 3 : 2 it parks sideways.

The angles psi of the rotor and phi of the axles are prescribed, so constraints and Lagrangian
depend on time.  The model is due to Lewis, Ostrowski, Murray and Burdick (1994) and to Bloch,
Krishnaprasad, Marsden and Murray (1996)::

    L = m (v_x^2 + v_y^2)/2 + (m r^2 - J0) v_theta^2/2 + J0 (v_theta + psi')^2/2
    front axle:   sin(theta + phi) v_x - cos(theta + phi) v_y - r cos(phi) v_theta = 0
    back axle:    sin(theta - phi) v_x - cos(theta - phi) v_y + r cos(phi) v_theta = 0

``python snakeboard_gait.py [PICTURE.png]`` prints the displacement of the board after four periods,
checks it against the reduced equation, and prints the residual of the wheels' constraints.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
import sympy

import dalembert as dal

t = dal.time
x, y, theta = dal.coordinates("x y theta")
m, r, J0, rotor, axles, w_rotor, w_axles = sympy.symbols("m r J0 rotor axles w_rotor w_axles")
psi, phi = rotor * sympy.sin(w_rotor * t), axles * sympy.sin(w_axles * t)
turning = r * sympy.cos(phi) * theta.d
board = dal.System.from_sympy(
    L=m * (x.d**2 + y.d**2) / 2
    + (m * r**2 - J0) * theta.d**2 / 2
    + J0 * (theta.d + psi.diff(t)) ** 2 / 2,
    constraints=[
        sympy.sin(theta + phi) * x.d - sympy.cos(theta + phi) * y.d - turning,
        sympy.sin(theta - phi) * x.d - sympy.cos(theta - phi) * y.d + turning,
    ],
    coordinates=[x, y, theta],
    parameters={m: 6.0, r: 0.2, J0: 0.1, rotor: 1.0, axles: 0.5, w_rotor: 1.0, w_axles: 1.0},
    name="board",
)

# %%
# An independent solution
# -----------------------
# On D the board has a single velocity u, forwards, and ``v_theta = u k`` with ``k = tan(phi)/r``::
#
#     (m + m r^2 k^2) u' + m r^2 k k' u + J0 k psi'' = 0
#
# This equation shares only the parameters with the run.


def reduced(values, t_end, steps):
    """Return (x, y, theta) at the end by the reduced equation and a Runge-Kutta method."""
    m, r, J0, rotor, axles, w_rotor, w_axles = values

    def rate(t, state):
        u, _, _, theta = state
        phi, dphi = axles * np.sin(w_axles * t), axles * w_axles * np.cos(w_axles * t)
        k, dk = np.tan(phi) / r, dphi / (r * np.cos(phi) ** 2)
        push = -J0 * k * -rotor * w_rotor**2 * np.sin(w_rotor * t)
        du = (push - m * r**2 * k * dk * u) / (m + m * r**2 * k**2)
        return np.array([du, u * np.cos(theta), u * np.sin(theta), u * k])

    state, h = np.zeros(4), t_end / steps
    for t in h * np.arange(steps):
        one = rate(t, state)
        two = rate(t + h / 2, state + h / 2 * one)
        three = rate(t + h / 2, state + h / 2 * two)
        four = rate(t + h, state + h * three)
        state = state + h / 6 * (one + 2 * two + 2 * three + four)
    return state[1:]


# %%
# The runs
# --------

gaits = {"drive": (1.0, 1.0), "rotate": (2.0, 1.0), "park": (3.0, 2.0)}
h, periods = 2 * np.pi / 500, 4
runs = {}
for name, (fast, slow) in gaits.items():
    gait = board.with_parameters(w_rotor=fast, w_axles=slow)
    run = runs[name] = dal.integrate(
        gait, "leapfrog-kl6", [0, 0, 0], [0, 0, 0], h=h, steps=500 * periods, stride=5
    )
    expected = reduced(gait.parameters.values(), run.t[-1], 8000)
    error = abs(run.q[-1] - expected).max()
    way = ", ".join(f"{value:+.6f}" for value in run.q[-1])
    print(f"{name:7} (x, y, theta) = {way}; wheels roll to {run.residual.max():.1e}")
    if not (error < 1e-10 and run.residual.max() < 1e-14):
        sys.exit(f"expected the end of the reduced equation, and D(t) to roundoff: off by {error}")

# %%
# The motion
# ----------
# A body for the pictures, to scale: the board, its axles, and the arms of the rider.

draw = dal.plot.bodies


def rider(gait):
    """Return the function of (t, q, v) that draws the board with this gait."""
    _, r, _, rotor, axles, w_rotor, w_axles = gait.parameters.values()

    def placed(q, angle, points):
        c, s = np.cos(angle), np.sin(angle)
        return q[:2] + r * np.array(points) @ [[c, s], [-s, c]]

    def shapes(t, q, v):
        psi, phi = rotor * np.sin(w_rotor * t), axles * np.sin(w_axles * t)
        deck = [(-1.05, -0.15), (1.05, -0.15), (1.05, 0.15), (-1.05, 0.15)]
        found = [draw.polygon(placed(q, q[2], deck))]
        for constraint, side in enumerate((1, -1)):
            axle = placed(q, q[2], (side, 0.0))
            ends = axle + placed(0 * q, q[2] + side * phi, [(0, -0.32), (0, 0.32)])
            found += [draw.line(*ends), draw.dot(axle, constraint)]
            found += [draw.blade(end, q[2] + side * phi, 0.4 * r) for end in ends]
        arms = placed(q, q[2] + psi, [(-0.45, 0.0), (0.45, 0.0)])
        return [*found, draw.line(*arms), *map(draw.dot, arms)]

    return shapes


figure = plt.figure(figsize=(9.0, 7.0), layout="constrained")
axes = figure.subplot_mosaic([["drive", "drive"], ["rotate", "park"]], height_ratios=(1, 1.7))
for (name, run), count in zip(runs.items(), (11, 5, 9), strict=True):
    ax = dal.plot.snapshots(run, rider(run.system), axes[name], count=count)
    ax.set_title("{}, {:g} : {:g}".format(name, *gaits[name]), loc="left")
    ax.set(xlabel="x (m)", ylabel="y (m)")
axes["drive"].set_ylim(-0.75, 0.75)
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)

# %%
# The driving gait as a film, with the reactions at the axles, which propel the board.

dal.plot.animate(runs["drive"], rider(runs["drive"].system), fps=12, seconds=8)
