"""
A ball on a turntable
=====================

A ball that rolls on a rotating table moves in a circle, with 2/7 of the table's rate if it is
homogeneous.  On the table it draws loops.

The table rotates with the rate Omega, so the constraints are affine, and the table does work::

    L = m (v_x^2 + v_y^2)/2 + J |omega|^2/2
    v_x = a omega_y - Omega y,     v_y = -a omega_x + Omega x

The circle has the rate ``k Omega`` with ``k = J/(J + m a^2)`` (Neimark and Fufaev 1972).  This is
2/7 for a homogeneous ball with ``J = 2/5 m a^2``, and 2/5 for a hollow one with ``J = 2/3 m a^2``.

``python ball_on_turntable.py [PICTURE.png]`` prints for both balls the rate of the circle, its
deviation from a circle, and the error against the exact solution.  It also prints the moving
energy, which is conserved while the energy is not, and the residual of D.
"""

import sys
from fractions import Fraction

import matplotlib.pyplot as plt
import numpy as np

import dalembert as dal
from dalembert.show.palette import COLOURS

m, a, Omega = 1.0, 0.1, 2 * np.pi / 4  # the table turns once in 4 s
balls = {"homogeneous": Fraction(2, 5), "hollow": Fraction(2, 3)}
q0, v0 = [0.35, 0.0, 0.0, 0.0, 0.0], [0.0, 0.45, 0.0, 0.0, 0.0]

# %%
# The runs end when the track on the table closes.  The table has then turned 7 times, or 5, and the
# ball has completed two circles.

runs = {}
for name, factor in balls.items():
    system = dal.systems.ball_on_table(m=m, J=float(factor) * m * a**2, a=a, Omega=Omega)
    rate = factor / (1 + factor)
    turns = rate.denominator
    start = system.consistent(q0, v0, keep=["x", "y"])
    run = runs[name] = dal.integrate(
        system, "leapfrog-kl8", q0, start, h=0.01, steps=round(turns * 4 / 0.01), stride=2
    )
    # The circle through three points of the track, then the angle around its centre.
    x, y = run.q[:, :2].T
    few = run.q[[0, len(x) // 5, len(x) // 3], :2]
    centre = np.linalg.solve(2 * np.diff(few, axis=0), np.diff(np.sum(few**2, axis=1)))
    radius = np.hypot(x - centre[0], y - centre[1])
    angle = np.unwrap(np.arctan2(y - centre[1], x - centre[0]))
    seen = (angle[-1] - angle[0]) / (Omega * run.t[-1])
    error = abs(run.q - [system.exact(t, q0, start)[0] for t in run.t]).max()
    moving = run.energy - m * Omega * (x * run.v[:, 1] - y * run.v[:, 0])
    print(f"{name:11} rate {seen:.12f} of the table's; {rate} = {float(rate):.12f}")
    print(f"  round to {np.ptp(radius) / radius[0]:.1e}, off the exact solution by {error:.1e}")
    print(f"  energy {run.energy.min():.3f} to {run.energy.max():.3f} J, ", end="")
    print(f"moving energy kept to {np.ptp(moving):.1e} J, D to {run.residual.max():.1e}")
    if not (abs(seen - rate) < 1e-10 and np.ptp(radius) < 1e-10 and error < 1e-9):
        sys.exit("the contact was expected to go round in a circle with the rate J/(J + m a^2)")
    if not (np.ptp(moving) < 1e-12 and run.residual.max() < 5 * 5 * 2.0**-53):
        sys.exit("the moving energy was expected to be kept, and D to roundoff")

# %%
# Left: the view from beside the table, at every full turn of it.  The table rotates below the ball.
# In rotating coordinates the circle becomes the track on the table, until it closes.

figure, axes = plt.subplots(1, 3, figsize=(11.4, 4.2), layout="constrained")
axes[0].set(xlabel="x (m)", ylabel="y (m)")
dal.plot.snapshots(runs["homogeneous"], ax=axes[0], count=8)
axes[0].set_title("from the room", loc="left")
axes[0].set_title("", loc="right")
reach = 1.1 * max(np.hypot(*run.q[:, :2].T).max() for run in runs.values())
for ax, (name, run), colour in zip(axes[1:], runs.items(), (COLOURS[0], COLOURS[2]), strict=True):
    track = (run.q[:, 0] + 1j * run.q[:, 1]) * np.exp(-1j * Omega * run.t)
    ax.add_patch(plt.Circle((0, 0), reach, facecolor="0.96", edgecolor="0.75"))
    for spoke in reach * np.exp(1j * np.pi * np.arange(3) / 3):
        ends = np.array([-spoke, spoke])
        ax.plot(ends.real, ends.imag, color="0.85", linewidth=0.8)
    ax.plot(track.real, track.imag, color=colour, linewidth=1.8)
    ax.add_patch(plt.Circle((track[-1].real, track[-1].imag), a, color=colour, zorder=3))
    ax.set(aspect="equal")
    ax.axis("off")
    ax.set_title(f"from the table, {name}", loc="left")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)

# %%
# A film in the frame of the room: the ball completes 2 circles while the table turns 7 times.

dal.plot.animate(runs["homogeneous"], fps=12, seconds=10)
