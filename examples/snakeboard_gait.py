"""A snakeboard whose rider turns rotor and axles as told: constraints and Lagrangian of the time.

    L = m (v_x^2 + v_y^2)/2 + (m r^2 - J0) v_theta^2/2 + J0 (v_theta + psi')^2/2
    front axle:   sin(theta + phi) v_x - cos(theta + phi) v_y - r cos(phi) v_theta = 0
    back axle:    sin(theta - phi) v_x - cos(theta - phi) v_y + r cos(phi) v_theta = 0

The angles psi of the rotor and phi of the axles are gaits, sines of the time (Lewis, Ostrowski,
Murray and Burdick 1994; Bloch, Krishnaprasad, Marsden and Murray 1996).  With equal frequencies the
board drives, with 2 : 1 it turns on the spot, with 3 : 2 it parks sideways.

Prints how far the board has gone after the gait.  It is checked against the reduced equation: on D
the board has a single velocity u, forwards, v_theta = u k with k = tan(phi)/r, and

    (m + m r^2 k^2) u' + m r^2 k k' u + J0 k psi'' = 0.

    python snakeboard_gait.py [PICTURE.png]
"""

import sys

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
gaits = {"drive": (1.0, 1.0), "rotate": (2.0, 1.0), "park": (3.0, 2.0)}
h, periods = 2 * np.pi / 500, 4


def reduced(values, t_end, steps):
    """Return (x, y, theta) at the end by the reduced equation and the method of Runge and Kutta."""
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


runs = {}
for name, (fast, slow) in gaits.items():
    gait = board.with_parameters(w_rotor=fast, w_axles=slow)
    run = runs[name] = dal.integrate(
        gait, "leapfrog-kl6", [0, 0, 0], [0, 0, 0], h=h, steps=500 * periods
    )
    expected = reduced(gait.parameters.values(), run.t[-1], 8000)
    error = abs(run.q[-1] - expected).max()
    way = ", ".join(f"{value:+.6f}" for value in run.q[-1])
    print(f"{name:7} (x, y, theta) = {way}; wheels roll to {run.residual.max():.1e}")
    if not (error < 1e-10 and run.residual.max() < 1e-14):
        sys.exit(f"expected the end of the reduced equation, and D(t) to roundoff: off by {error}")

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12.0, 4.0), layout="constrained")
    for ax, (name, run) in zip(axes, runs.items()):
        ax.plot(run.q[:, 0], run.q[:, 1], color="#0072B2")
        for px, py, angle in run.q[::100]:
            along = 0.02 * np.array([np.cos(angle), np.sin(angle)])
            ax.plot([px - along[0], px + along[0]], [py - along[1], py + along[1]], color="#D55E00")
        ax.set(xlabel="x (m)", ylabel="y (m)", title=name, aspect="equal")
    figure.savefig(sys.argv[1], dpi=110)
