"""
Reversing with a trailer
========================

A trailer that is pushed backwards with straight wheels jack-knifes.  A control law that first
steers the other way brings car and trailer into the lane.

The car has its driven rear axle at (x, y), and a front axle at distance l that is steered by phi.
The trailer is attached to the rear axle by a bar of length d.  With the speed u along the heading
theta and the angle delta = theta - theta1 at the hitch::

    L = m (v_x^2 + v_y^2)/2 + J v_theta^2/2 + K (v_theta + v_phi)^2/2
        + m1 (v_x1^2 + v_y1^2)/2 + J1 v_theta1^2/2,     (x1, y1) = (x, y) - d (cos, sin)(theta1)
    rear axle, front axle and trailer move along themselves only
    force along theta:  500 (-speed - u) N          torque on phi:  2000 (aim - phi) - 200 v_phi

The aim is 0, or follows from the law.  To turn the trailer towards the lane y = 0, the law opens
an angle at the hitch, by an angle of the wheels.

``python reversing_trailers.py [PICTURE.png]`` prints the time at which the first trailer
jack-knifes and the final distance of the other one from the lane.  It also prints the distance of
both from a solution of the reduced equations, and the residual of the rolling constraints.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
import sympy
from scipy.integrate import solve_ivp

import dalembert as dal

# %%
# The law is a formula of the state, for SymPy and for NumPy.  All angles are limited by tanh.

l, d, speed = 2.6, 4.0, 1.5  # m, m, m/s
masses = {"m": 1200.0, "J": 1500.0, "K": 20.0, "m1": 600.0, "J1": 500.0}  # kg, kg m^2


def at_most(angle, limit, tanh):
    return limit * tanh(angle / limit)


def steering(y1, theta, theta1, f):
    """Return the desired angle of the wheels; f has sin, tanh and atan."""
    course = at_most(0.18 * y1, 0.6, f.tanh)  # of the trailer: towards the lane
    delta = theta - theta1
    hitch = at_most(2.0 * (theta1 - course), 0.6, f.tanh)  # turns the trailer to that course
    bend = f.sin(delta) / d - 1.2 * (hitch - delta)  # curvature of the car's path: opens the hitch
    return at_most(f.atan(l * bend), 0.6, f.tanh)


x, y, theta, phi, theta1 = dal.coordinates("x y theta phi theta1")
m, J, K, m1, J1, law = sympy.symbols("m J K m1 J1 law")
sin, cos = sympy.sin, sympy.cos
along = cos(theta) * x.d + sin(theta) * y.d
x1_d, y1_d = x.d + d * sin(theta1) * theta1.d, y.d - d * cos(theta1) * theta1.d
force = 500 * (-speed - along)
aim = law * steering(y - d * sin(theta1), theta, theta1, sympy)
rig = dal.System.from_sympy(
    L=m * (x.d**2 + y.d**2) / 2 + J * theta.d**2 / 2 + K * (theta.d + phi.d) ** 2 / 2
    + m1 * (x1_d**2 + y1_d**2) / 2 + J1 * theta1.d**2 / 2,
    constraints=[
        -sin(theta) * x.d + cos(theta) * y.d,
        -sin(theta + phi) * x.d + cos(theta + phi) * y.d + l * cos(phi) * theta.d,
        -sin(theta1) * x1_d + cos(theta1) * y1_d,
    ],
    coordinates=[x, y, theta, phi, theta1],
    parameters=masses | {"law": 1.0},
    force={
        x: force * cos(theta), y: force * sin(theta), phi: 2000 * (aim - phi) - 200 * phi.d,
    },
    name="car and trailer",
)  # fmt: skip
folded = dal.Event(abs(theta - theta1) - np.radians(80), direction=1, terminal=True)

# %%
# The reduced equations
# ---------------------
# On D there are two velocities, u and v_phi.  D'Alembert's principle in their directions gives two
# equations without multipliers, with ``v_theta = a u``, ``a = tan(phi)/l``, ``v_theta1 = a1 u``,
# ``a1 = sin(delta)/d``, and ``cos(delta) u`` the speed of the trailer.


def reduced(t, state, law):
    """Return the rate of (x, y, theta, phi, theta1, u, v_phi)."""
    _, y, theta, phi, theta1, u, steers = state
    m, J, K, m1, J1 = masses.values()
    delta, a = theta - theta1, np.tan(phi) / l
    c, s = np.cos(delta), np.sin(delta)
    a1, dphi = s / d, steers
    ddelta = (a - a1) * u
    da, da1 = dphi / (l * np.cos(phi) ** 2), c * ddelta / d
    torque = 2000 * (law * steering(y - d * np.sin(theta1), theta, theta1, np) - phi) - 200 * dphi
    push = 500 * (-speed - u) - torque * a - (J * a * da + J1 * a1 * da1 - m1 * c * s * ddelta) * u
    du = push / (m + J * a**2 + m1 * c**2 + J1 * a1**2)
    turns = torque / K - (a * du + da * u)
    return [u * np.cos(theta), u * np.sin(theta), a * u, dphi, a1 * u, du, turns]


# %%
# Both runs begin at rest beside the lane, with an angle of 4 degrees at the hitch.

q0 = [0.0, 3.5, 0.0, 0.0, np.radians(4)]
runs = {}
for name, law in {"wheels straight": 0.0, "steered by the law": 1.0}.items():
    run = runs[name] = dal.integrate(
        rig.with_parameters(law=law), "leapfrog-kl6", q0, np.zeros(5),
        h=0.01, t_end=18, events=[folded], stride=3,
    )  # fmt: skip
    other = solve_ivp(
        reduced, (0, run.t[-1]), [*q0, 0, 0], "DOP853", args=(law,), rtol=1e-11, atol=1e-11
    )
    error = abs(run.q[-1] - other.y[:5, -1]).max()
    print(f"{name}: {-run.q[-1, 0]:.6f} m back in {run.t[-1]:.6f} s, ", end="")
    print("jack-knifed" if run.status == 1 else f"y = {run.q[-1, 1]:.6f} m")
    print(f"  reduced equations to {error:.1e}, wheels roll to {run.residual.max():.1e}")
    if not (error < 1e-7 and run.residual.max() < 1e-14):
        sys.exit("expected the end of the reduced equations, and D to roundoff")
    if run.status != (law == 0) or (law == 1 and abs(run.q[-1, 1]) > 0.1):
        sys.exit("the trailer was expected to jack-knife, and with the law to come into the lane")

# %%
# Car and trailer to scale, reversing to the left.

draw = dal.plot.bodies


def vehicle(t, q, v):
    """Return the shapes of car and trailer."""

    def placed(at, angle, *points):
        c, s = np.cos(angle), np.sin(angle)
        return at + np.array(points) @ [[c, s], [-s, c]]

    def box(at, angle, back, front):
        corners = (back, -0.85), (front, -0.85), (front, 0.85), (back, 0.85)
        return draw.polygon(placed(at, angle, *corners))

    def axle(at, angle, constraint):
        side = 0.75 * np.array([-np.sin(angle), np.cos(angle)])
        wheels = [draw.blade(at + side, angle, 0.7), draw.blade(at - side, angle, 0.7)]
        return [draw.line(at - side, at + side), *wheels, draw.dot(at, constraint)]

    at, (theta, phi, theta1) = q[:2], q[2:]
    front = at + l * np.array([np.cos(theta), np.sin(theta)])
    trailer = at - d * np.array([np.cos(theta1), np.sin(theta1)])
    return [
        box(at, theta, -0.8, l + 0.8),
        draw.line(*placed(at, theta, (1.6, -0.85), (1.9, 0.0), (1.6, 0.85))),
        box(trailer, theta1, -1.4, 1.4),
        draw.line(at, trailer),
        *axle(at, theta, 0),
        *axle(front, theta + phi, 1),
        *axle(trailer, theta1, 2),
    ]


figure, axes = plt.subplots(2, 1, figsize=(9.0, 5.6), layout="constrained")
for ax, (name, run) in zip(axes, runs.items(), strict=True):
    ax.set(xlabel="x (m)", ylabel="y (m)")
    dal.plot.snapshots(run, vehicle, ax, count=5)
    ax.set_title(name, loc="left")
    ax.set(xlim=(-28, 5), ylim=(-2.6, 6.2))
    ax.axhspan(-1.3, 1.3, color="0.93", zorder=0)
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)

# %%
# The controlled run as a film: to turn the trailer one way the wheels first turn the other way.

dal.plot.animate(runs["steered by the law"], vehicle, fps=12, seconds=9, multipliers=False)
