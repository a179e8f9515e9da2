"""
A roller racer
==============

A toy without pedals: its rider swings the handle, the wheels do not slip sideways, and it starts
from rest.  It moves forwards with a short handle and backwards with a long one.

Body (mass m, inertia J) and handle (inertia K) are joined by a hinge, each on an axle
(Krishnaprasad and Tsakiris 2001; ``dal.systems.roller_racer``).  The arms are a spring and a damper
that follow a swing::

    L = (m (v_x^2 + v_y^2) + J v_theta^2 + K (v_theta + v_phi)^2)/2
    torque on phi:  k (swing sin(w t) - phi) - c v_phi
    -sin(theta) v_x + cos(theta) v_y = 0
    -sin(theta + phi) v_x + cos(theta + phi) v_y + (d1 cos(phi) + d2) v_theta + d2 v_phi = 0

``python roller_racer.py [PICTURE.png]`` prints for both handles the distance and the speed of the
racer, and the rolling residual.  It compares both with a solution of the reduced equations.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
import sympy
from scipy.integrate import solve_ivp

import dalembert as dal

given = {"m": 1.0, "J": 0.2, "K": 0.05, "d1": 0.5, "d2": 0.1}
arms = {"k": 20.0, "c": 1.0, "swing": 0.9, "w": 5.0}
x, y, theta, phi = dal.coordinates("x y theta phi")
m, J, K, d1, d2 = sympy.symbols(list(given))
k, c, swing, w = sympy.symbols(list(arms))
sin, cos = sympy.sin, sympy.cos
handle = (d1 * cos(phi) + d2) * theta.d + d2 * phi.d
racer = dal.System.from_sympy(
    L=(m * (x.d**2 + y.d**2) + J * theta.d**2 + K * (theta.d + phi.d) ** 2) / 2,
    constraints=[
        -sin(theta) * x.d + cos(theta) * y.d,
        -sin(theta + phi) * x.d + cos(theta + phi) * y.d + handle,
    ],
    coordinates=[x, y, theta, phi],
    parameters=given | arms,
    force={phi: k * (swing * sin(w * dal.time) - phi) - c * phi.d},
    name="roller racer",
)

# %%
# The reduced equations
# ---------------------
# On D there are two velocities, u along the heading and ``v_phi``, and the body turns with
# ``v_theta = a(phi) u + b(phi) v_phi``.  D'Alembert's principle in the directions of u and phi::
#
#     m u' + a (J v_theta' + K (v_theta' + v_phi')) = 0
#     b J v_theta' + (b + 1) K (v_theta' + v_phi') = torque
#
# They have no multipliers, and are solved by another method.


def reduced(t, state, m, J, K, d1, d2, k, c, swing, w):
    """Return the rate of (x, y, theta, phi, u, v_phi)."""
    theta, phi, u, swings = state[2:]
    D, dD = d1 * np.cos(phi) + d2, -d1 * np.sin(phi) * swings
    a, b = np.sin(phi) / D, -d2 / D
    da, db = (np.cos(phi) * swings * D - np.sin(phi) * dD) / D**2, d2 * dD / D**2
    rest = da * u + db * swings  # v_theta' = a u' + b v_phi' + rest
    inertia = [
        [m + (J + K) * a**2, (J + K) * a * b + K * a],
        [(J + K) * a * b + K * a, J * b**2 + K * (b + 1) ** 2],
    ]
    torque = k * (swing * np.sin(w * t) - phi) - c * swings
    push = [-(J + K) * a * rest, torque - (J * b + K * (b + 1)) * rest]
    rates = np.linalg.solve(inertia, push)
    return [u * np.cos(theta), u * np.sin(theta), a * u + b * swings, swings, *rates]


runs = {}
for name, length, t_end in (("short", 0.1, 13.0), ("long", 0.2, 6.0)):
    system = racer.with_parameters(d2=length)
    run = runs[name] = dal.integrate(
        system, "leapfrog-kl6", np.zeros(4), np.zeros(4), h=0.005, t_end=t_end, stride=4
    )
    values = tuple(system.parameters.values())
    other = solve_ivp(
        reduced, (0, t_end), np.zeros(6), "DOP853", args=values, rtol=1e-12, atol=1e-12
    )
    error = abs(run.q[-1] - other.y[:4, -1]).max()
    speed = run.v[-1, 0] * np.cos(run.q[-1, 2]) + run.v[-1, 1] * np.sin(run.q[-1, 2])
    print(f"{name:5} handle: x = {run.q[-1, 0]:+.6f} m at t = {t_end:g} s, speed {speed:+.3f} m/s")
    print(f"  reduced equations to {error:.1e}, wheels roll to {run.residual.max():.1e}")
    if not (error < 1e-8 and run.residual.max() < 1e-14):
        sys.exit("expected the end of the reduced equations, and D to roundoff")
if not runs["long"].q[-1, 0] < -1 < 1 < runs["short"].q[-1, 0]:
    sys.exit("the racer was expected to drive forwards, and backwards with a long handle")

# %%
# Seat, hinge and handle to scale, with the wheels and their tracks.

draw = dal.plot.bodies


def toy(system):
    """Return the function of (t, q, v) that draws the racer."""
    d1, d2 = (system.parameters[name] for name in ("d1", "d2"))

    def axle(at, angle, half, constraint):
        side = half * np.array([-np.sin(angle), np.cos(angle)])
        wheels = [draw.blade(at + side, angle, 0.12), draw.blade(at - side, angle, 0.12)]
        return [draw.line(at - side, at + side), *wheels, draw.dot(at, constraint)]

    def shapes(t, q, v):
        ahead, side = np.array([[np.cos(q[2]), np.sin(q[2])], [-np.sin(q[2]), np.cos(q[2])]])
        hinge, turned = q[:2] + d1 * ahead, q[2] + q[3]
        front = hinge + d2 * np.array([np.cos(turned), np.sin(turned)])
        seat = [q[:2] - 0.06 * ahead + 0.2 * side, q[:2] - 0.06 * ahead - 0.2 * side, hinge]
        found = [draw.polygon(seat), draw.line(hinge, front)]
        return [*found, *axle(q[:2], q[2], 0.2, 0), *axle(front, turned, 0.13, 1)]

    return shapes


figure, axes = plt.subplots(2, 1, figsize=(9.0, 4.8), layout="constrained")
for ax, (name, run) in zip(axes, runs.items(), strict=True):
    ax.set(xlabel="x (m)", ylabel="y (m)")
    dal.plot.snapshots(run, toy(run.system), ax, count=11)
    ax.set_title(f"{name} handle", loc="left")
    ax.set(xlim=np.mean(ax.get_xlim()) + [-3.7, 3.7], ylim=(-0.7, 0.7))
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)

# %%
# As a film, with the forces of the floor on the axles.

dal.plot.animate(runs["short"], toy(runs["short"].system), fps=12, seconds=12)
