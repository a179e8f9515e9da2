"""
A deformed constraint
=====================

On a deformed constraint, which is not a subspace of the velocities, the reaction does work.  The
energy changes by exactly this work.

A free particle, on D and on a deformation of D by a product of velocities::

    D        v_z - y v_x = 0
    D_delta  v_z - y v_x + delta v_x v_y = 0

On D the reaction does no work and the energy is constant.  On D_delta the reaction along d(phi)/dv
has the power lambda delta v_x v_y, and the energy changes by its work.  For delta = h/2, D_delta is
the D_eps in which the midpoint scheme with kept nodes stays.

``python deformed.py [PICTURE.png]`` prints the change of the energy, the work of the reaction, and
the largest ``|phi|``, for several delta.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import dalembert as dal
from dalembert.show.palette import COLOURS
from dalembert.show.plot import LINES

particle = dal.systems.particle()
h, t_end = 0.01, 6.0
deltas = [0.0, 0.05, 0.1, 0.2]


def on_D(delta):
    """Return the particle with its constraint deformed by delta v_x v_y."""
    return particle.deformed(
        lambda q, v: [v[0] * v[1]],
        delta,
        g_v=lambda q, v: [[v[1], v[0], 0.0]],
        g_q=lambda q, v: np.zeros((1, 3)),
    )


# %%
# Energy and work
# ---------------
# The initial velocity is projected, so that each run begins on its own constraint.  The work is
# the integral of the power over the run.

found = {}
print("delta    E(t_end) - E(0)    work of the reaction    largest |phi|")
for delta in deltas:
    system = on_D(delta)
    v0 = system.project(particle.q0, particle.v0)
    run = dal.integrate(system, "reference", particle.q0, v0, h=h, t_end=t_end)
    power, _ = system.power(run.q, run.v)
    # Simpson's rule, of order 4 in h.
    work = h / 3 * (power[0] + power[-1] + 4 * power[1::2].sum() + 2 * power[2:-1:2].sum())
    gain = run.energy - run.energy[0]
    worst = abs(system.residual(run.q, run.v)).max()
    print(f"{delta:5g}    {gain[-1]:15.10f}    {work:20.10f}    {worst:13.1e}")
    if abs(gain[-1] - work) > 1e-9 or worst > 1e-14 or (delta == 0.0) != (gain[-1] < 1e-12):
        sys.exit("the energy was expected to change by the work of the reaction, on D_delta only")
    found[delta] = run, gain, power

# %%
# The curves are the energy and the power of the reaction; the circles are differences of the
# energy, which must agree with this power.

figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
for (delta, (run, gain, power)), colour, line in zip(found.items(), COLOURS, LINES):
    label = rf"$\delta$ = {delta:g}" if delta else r"$\delta$ = 0, on $D$"
    axes[0].plot(run.t, gain, linestyle=line, color=colour)
    axes[1].plot(run.t, power, linestyle=line, color=colour, label=label)
    few, slope = slice(10, None, 45), np.gradient(gain, run.t)
    axes[1].plot(run.t[few], slope[few], "o", markerfacecolor="none", color=colour)
axes[1].plot([], [], "o", markerfacecolor="none", color="black", label="dE/dt by differences")
axes[1].legend(frameon=False)
axes[0].set(ylabel="E - E(0)", title="energy")
axes[1].set(ylabel="power", title="power of the reaction")
for ax in axes:
    ax.set_xlabel("time t")

# %%
# The shape of D
# --------------
# As a set of (v_x, v_y, v_z - y v_x), D is a plane at every place, and D_delta is always the same
# saddle.  The saddle contains v = 0, but sums of its velocities leave it.  The lines on it are the
# velocities of two runs, delta = 0 and 0.2, starting at the dots.

# sphinx_gallery_thumbnail_number = 2
side = np.linspace(-1.5, 1.5, 25)
across, along = np.meshgrid(side, side)
figure = plt.figure(figsize=(6.0, 5.0), layout="constrained")
ax = figure.add_subplot(projection="3d", computed_zorder=False)
for delta, colour, name in ((0.2, COLOURS[1], r"D_\delta"), (0.0, COLOURS[2], "D")):
    run, _, _ = found[delta]
    sheet = across, along, -delta * across * along
    ax.plot_surface(*sheet, color=colour, alpha=0.3, linewidth=0)
    ax.plot_wireframe(*sheet, color=colour, linewidth=0.7, rstride=4, cstride=4)
    offset = run.v[:, 2] - run.q[:, 1] * run.v[:, 0]
    ax.plot(run.v[:, 0], run.v[:, 1], offset, color="black", linewidth=3, zorder=9)
    ax.plot(*run.v[0, :2], offset[0], "o", color="black", markersize=7, zorder=9)
    ax.text(-1.5, 1.6, 2.25 * delta, f"${name}$", color=colour, fontsize=18)
ax.view_init(elev=28, azim=20)
ax.set_box_aspect((1, 1, 0.6), zoom=0.92)
ax.set(xticks=[-1, 0, 1], yticks=[-1, 0, 1], zticks=[-0.4, 0, 0.4])
ax.set(xlabel="$v_x$", ylabel="$v_y$", zlabel="$v_z - y\\,v_x$")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
