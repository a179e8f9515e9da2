"""
Sections of a chaotic stone
===========================

Two systems that conserve their energy are seen in Poincare sections.  The contact oscillator is a
particle with a blade in R^3.  The rattleback is a stone that rolls on a table, and reverses its
spin.

``python poincare_sections.py [PICTURE.png]`` prints how well the energy is conserved in the
sections, and the periods and multipliers of periodic orbits.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
import sympy as sp

import dalembert as dal
from dalembert.show.palette import COLOURS



def closest(states, returns):
    """Return the number of the state that is nearest to a later one: a guess for an orbit."""
    apart = (states[returns:] - states[:-returns]) / np.maximum(np.ptp(states, axis=0), 1e-9)
    return int(np.linalg.norm(apart, axis=1).argmin())


# %%
# The contact oscillator
# ----------------------
# The section is y = 0.  There the blade forbids a velocity along x.  All starts have the same
# energy and the same energy of y, which is conserved too.  So x and z determine the state.

x, y, z = dal.coordinates("x y z")
contact = dal.systems.contact_oscillator(eps=1.5)
section = dal.section(contact, y)
energy, along_y = 1.5, 0.7

clouds = []
for z0 in np.linspace(-1.2, 1.0, 12):
    q = np.array([0.3, 0.0, z0])
    rest = 2 * (energy - along_y) - 2 * float(contact.energy(q, np.zeros(3)))
    if rest < 0:
        continue
    t, q, v = section.points(q, [0, np.sqrt(2 * along_y), np.sqrt(rest)], count=700)
    clouds.append((q, v))
    if np.ptp(contact.energy(q, v)) > 1e-12:
        sys.exit("the energy was expected to be conserved")
print(f"contact oscillator: {len(clouds)} motions of 700 returns, to t = {t[-1]:.0f}")

# %%
# The motion that stays closest together surrounds a stable periodic orbit.  The one that goes
# farthest comes back near itself after three returns, near an unstable one.

clouds.sort(key=lambda cloud: np.ptp(cloud[0][:, 0]))
orbits = []
for returns, (q, v) in ((1, clouds[0]), (3, clouds[-1])):
    near = closest(np.hstack([q, v]), returns)
    orbit = section.orbit(q[near], v[near], returns=returns, energy=energy)
    orbits.append(orbit)
    print(f"  a periodic orbit: period {orbit.period:.10f}, residual {orbit.residual:.0e}")
    print("  sizes of the multipliers", abs(orbit.multipliers).round(6))
if abs(orbits[0].multipliers).max() > 1 + 1e-6 or abs(orbits[1].multipliers).max() < 1.001:
    sys.exit("the first orbit was expected to be stable, the other one unstable")

# %%
# The rattleback
# --------------
# An ellipsoid with the semi-axes a, b, c rolls without slipping.  Its centre of mass is h below its
# centre, and its principal axes are turned by delta about the vertical one (Kane and Levinson
# 1982).  The coordinates are x and y of the centre of mass, and the yaw psi, roll phi and pitch
# theta.

q = x, y, psi, phi, theta = dal.coordinates("x y psi phi theta")
a, b, c, h, g = map(sp.Rational, ("0.2", "0.03", "0.02", "0.01", "9.81"))
A, B, C = map(sp.Rational, ("2e-4", "16e-4", "17e-4"))
delta = sp.Symbol("delta", real=True)


def turned(angle, axis):
    """Return the rotation about a coordinate axis."""
    i, j = [k for k in range(3) if k != axis]
    matrix = sp.eye(3)
    matrix[i, i] = matrix[j, j] = sp.cos(angle)
    sign = -1 if axis == 1 else 1
    matrix[i, j], matrix[j, i] = -sign * sp.sin(angle), sign * sp.sin(angle)
    return matrix


pitch, roll = turned(theta, 1), turned(phi, 0)
rotation = turned(psi, 2) * roll * pitch
up = rotation[2, :].T  # the vertical, as the body has it
squares = sp.diag(a**2, b**2, c**2)
depth = sp.sqrt((up.T * squares * up)[0])  # of the lowest point below the centre
centre = sp.Matrix([0, 0, h])
height = depth - h * up[2]
omega = pitch.T * (roll.T * sp.Matrix([0, 0, psi.d]) + sp.Matrix([phi.d, 0, 0]))
omega += sp.Matrix([0, theta.d, 0])
inertia = turned(delta, 2) * sp.diag(A, B, C) * turned(delta, 2).T
rate = height.diff(phi) * phi.d + height.diff(theta) * theta.d
contact_point = centre - squares * up / depth
slip = rotation * omega.cross(contact_point)
stone = dal.System.from_sympy(
    L=(x.d**2 + y.d**2 + rate**2) / 2 + (omega.T * inertia * omega)[0] / 2 - g * height,
    constraints=[x.d + slip[0], y.d + slip[1]],
    coordinates=q, parameters={delta: np.radians(-2)}, name="rattleback",
)  # fmt: skip

# %%
# Spun against its preferred direction it begins to rattle, and turns back.

q0 = [0, 0, 0, 0.01, 0.01]
v0 = stone.consistent(q0, [0, 0, -5, 0, 0], keep=["psi", "phi", "theta"])
run = dal.integrate(stone, q0=q0, v0=v0, t_end=30)
print(f"rattleback: spin {run.v[0, 2]:.2f}, then {run.v[:, 2].max():.2f};", end=" ")
print(f"energy to {np.ptp(run.energy) / run.energy[0]:.0e}")

# %%
# At a higher energy it tumbles.  The section has the states where the roll turns back.  Nothing
# depends on x, y and psi, so a periodic orbit need not repeat them.

names = ["phi", "theta", "v_psi", "v_phi", "v_theta"]
turns = dal.section(stone, phi.d, returning=names)
q0 = [0, 0, 0, 0.3, 0.09]
v0 = stone.consistent(q0, [0, 0, 2, 0, 0], keep=["psi", "phi", "theta"])
t, q_turn, v_turn = turns.points(q0, v0, count=1500)
spread = np.ptp(stone.energy(q_turn, v_turn)) / stone.energy(q0, v0)
print(f"  1500 returns to t = {t[-1]:.0f}, energy to {spread:.0e}")

# %%
# A return that is close after two crossings is a guess for a periodic orbit.

near = closest(np.hstack([q_turn[:, 3:], v_turn[:, 2:]]), 2)
energy = float(stone.energy(q_turn[near], v_turn[near]))
unstable = turns.orbit(q_turn[near], v_turn[near], returns=2, energy=energy)
print(f"  a periodic orbit: period {unstable.period:.10f}, residual {unstable.residual:.0e}")
print("  sizes of the multipliers", abs(unstable.multipliers).round(4))
if abs(unstable.multipliers[0]) < 1.1:
    sys.exit("the orbit was expected to be unstable")

# %%
# Left: each colour is one motion of the contact oscillator, and the cross is its periodic orbit.
# Right: one motion of the rattleback.

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4.4), layout="constrained")
for k, (points, _) in enumerate(clouds):
    left.plot(points[:, 0], points[:, 2], ".", markersize=1.2, color=COLOURS[k % len(COLOURS)])
for orbit in orbits:
    left.plot(orbit.q[0], orbit.q[2], "k+", markersize=10)
left.set(xlabel="x", ylabel="z", title="contact oscillator, y = 0")
right.plot(q_turn[:, 3], v_turn[:, 2], ".", markersize=1.2, color=COLOURS[0])
right.plot(unstable.q[3], unstable.v[2], "k+", markersize=10)
right.set(xlabel="roll", ylabel="spin", title="rattleback, where the roll turns back")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
