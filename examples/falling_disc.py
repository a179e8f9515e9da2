"""
A coin that rolls and leans
===========================

A disc rolls on a table: it leans into its curve, wobbles and rises again, while the point of
contact never slips.

The coordinates are x and y below the centre, the yaw alpha, the lean beta and the spin gamma
(O'Reilly 1996)::

    L = (m (v_x^2 + v_y^2 + r^2 sin(beta)^2 v_beta^2) + A (v_beta^2 + cos(beta)^2 v_alpha^2)
         + C omega^2)/2 - m g r cos(beta),        omega = v_gamma + v_alpha sin(beta)
    v_x - r omega cos(alpha) - r v_beta cos(beta) sin(alpha) = 0
    v_y - r omega sin(alpha) + r v_beta cos(beta) cos(alpha) = 0

``python falling_disc.py [PICTURE.png]`` prints the range of the lean, and the errors of energy and
constraint.  It also prints the distance from a solution of Newton's and Euler's equations.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import dalembert as dal
from dalembert.show.palette import COLOURS

m, r, g = 1.0, 0.5, 9.81
A, C = m * r**2 / 4, m * r**2 / 2  # a homogeneous disc
disc = dal.systems.rolling_disc(m=m, r=r, A=A, C=C, g=g)

# %%
# The disc starts nearly upright, with some yaw and spin.  The velocities v_x and v_y follow from
# the rolling constraint; ``consistent`` computes them.

q0 = [0.0, 0.0, 0.0, 0.1, 0.0]
v0 = disc.consistent(q0, [0.0, 0.0, 1.5, 0.0, 4.0], keep=["alpha", "beta", "gamma"])
run = dal.integrate(disc, "leapfrog-kl8", q0, v0, h=0.01, t_end=4.0)
lean = np.degrees(run.q[:, 3])
print(f"the disc leans by {lean.min():.3f} to {lean.max():.3f} degrees")

# %%
# The same without angles
# -----------------------
# Newton's and Euler's equations are formulated for the centre c, the unit normal e of the disc and
# the angular velocity.  The force at the contact follows from the rolling condition.  They share
# neither coordinates nor multipliers with the run, and are solved by a method of order 8 with small
# steps.


def contact(e, rate=None):
    """Return the vector from the centre to the contact, or its rate if that of e is given."""
    up = np.array([0.0, 0.0, 1.0])
    w = up - e[2] * e
    length = np.linalg.norm(w)
    if rate is None:
        return -r * w / length
    dw = -rate[2] * e - e[2] * rate
    return -r * (dw / length - w * (w @ dw) / length**3)


def newton_euler(t, state):
    _, e, omega = np.split(state, 3)
    turned = np.cross(omega, e)
    to_foot, moved = contact(e), contact(e, turned)
    square = np.eye(3) * r**2 - np.outer(to_foot, to_foot)
    inertia = A * np.eye(3) + (C - A) * np.outer(e, e) + m * square
    torque = np.cross(to_foot, m * np.cross(moved, omega) + [0.0, 0.0, m * g])
    torque -= (C - A) * (omega @ e) * turned
    return [*np.cross(to_foot, omega), *turned, *np.linalg.solve(inertia, torque)]


def seen(q):
    """Return centre and normal of the disc at q, and the directions of alpha' and beta'."""
    alpha, beta = q[2:4]
    ahead = np.array([np.cos(alpha), np.sin(alpha), 0.0])
    up = np.array([np.sin(beta) * ahead[1], -np.sin(beta) * ahead[0], np.cos(beta)])
    return np.array([q[0], q[1], r * np.cos(beta)]), np.cross(up, ahead), ahead


c, e, ahead = seen(run.q[0])
omega = run.v[0, 2] * np.array([0, 0, 1]) + run.v[0, 3] * ahead + run.v[0, 4] * e
other = solve_ivp(
    newton_euler, (0, run.t[-1]), [*c, *e, *omega], "DOP853", rtol=1e-12, atol=1e-12, t_eval=run.t
)  # fmt: skip
same = np.array([np.concatenate(seen(q)[:2]) for q in run.q])
error = abs(same - other.y[:6].T).max()
print(f"centre and normal are those of Newton and Euler to {error:.1e}")
print(f"energy kept to {np.ptp(run.energy) / run.energy[0]:.1e}, rolls to {run.residual.max():.1e}")
if not (error < 1e-8 and np.ptp(run.energy) < 1e-9 and run.residual.max() < 1e-14):
    sys.exit("expected the solution of Newton and Euler, the energy, and D to roundoff")

# %%
# The path of the disc, and its lean over time; the dots are the other solution.

figure, (space, ax) = plt.subplots(
    2, 1, figsize=(7.6, 6.6), height_ratios=(3.2, 1), layout="constrained"
)
dal.plot.snapshots(run, ax=space, count=12)
ax.plot(run.t, lean, color=COLOURS[0], label="run in D")
other_lean = np.degrees(np.arcsin(other.y[5]))
ax.plot(run.t[::20], other_lean[::20], "o", color=COLOURS[1], markersize=4, label="Newton, Euler")
ax.set(xlabel="t (s)", ylabel="lean (degrees)", xlim=(0, run.t[-1]), ylim=(0, 58))
ax.legend(frameon=False, ncols=2, loc="upper right")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)

# %%
# As a film, with the force that keeps it from slipping.

dal.plot.animate(run, fps=15, seconds=6)
