"""
The nonholonomic particle
=========================

A free particle in space with one velocity constraint, by the midpoint scheme::

    L = (v_x^2 + v_y^2 + v_z^2)/2,   v_z = y v_x,   that is mu(q) = (-y, 0, 1)
    q = (0, 1, 0), v = (1, 1, 1) at t = 0;  h = 0.01, 1000 steps

``python particle.py [PICTURE.png]`` prints the last position beside the exact one, the band of the
energy, and the worst residual of D, which docs/residual.md defines.
``examples/particle.c`` prints the same in C.
"""

import sys

import dalembert as dal

particle = dal.systems.particle()
q0, v0 = [0, 1, 0], [1, 1, 1]

run = dal.integrate(particle, "midpoint", q0=q0, v0=v0, h=0.01, t_end=10)
exact, _ = particle.exact(10, q0, v0)

print("q(10)  ", *(f"{x:.9f}" for x in run.q[-1]))
print("exact  ", *(f"{x:.9f}" for x in exact))
print(f"energy  from {run.energy.min():.12f} to {run.energy.max():.12f}")
print(f"worst residual of D {run.residual.max():.1e}")

# %%
# At each place D is a plane of velocities, drawn as a disc.  It turns as y grows, and the velocity
# stays in it:

ax = dal.plot.snapshots(run, count=7)
if len(sys.argv) > 1:
    ax.figure.savefig(sys.argv[1], dpi=110)

# %%
# The velocity stays in D to roundoff.  The other picture shows a constraint that the scheme does
# not keep:

axes = dal.plot.drift(run)
