"""
The order of a scheme
=====================

The order of a scheme is measured.  As the step is refined, the errors decrease with a power of it,
which is compared with the promised order.

The knife edge on an incline, from the default initial data of the built-in system, for t from 0
to 1::

    L = m (v_x^2 + v_y^2)/2 + J v_theta^2/2 + m g x,   sin(theta) v_x - cos(theta) v_y = 0

``python order.py [SCHEME [PICTURE.png]]`` prints for each step size the errors of q, v and the
multiplier lambda(q, v) at t = 1, and the worst residual of D.  It then prints the orders (p, s),
the promised ones, and the verdict.  Here p and s are slopes of the errors of one step, minus 1.
``print(study)`` prints a table of the same, and ``examples/order.c`` prints this one in C.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import dalembert as dal
from dalembert.show.palette import COLOURS

scheme = sys.argv[1] if len(sys.argv) > 1 else "midpoint"
knife_edge = dal.systems.knife_edge()
study = dal.convergence(knife_edge, scheme, t_end=1, steps=[80, 120, 160, 240, 320, 480])

print(f"{study.scheme.name} on {study.system.name}")
print("         h    error of q    of v          of lambda     residual of D")
for h, q, v, multiplier, residual in zip(
    study.h, study.q_error, study.v_error, study.multiplier_error, study.residual
):
    print(f"{h:10.7f}    {q:.3e}     {v:.3e}     {multiplier:.3e}     {residual:.1e}")
print(
    f"(p, s)   measured {study.p:.3f} {study.s:.3f}"
    f"   promised {study.scheme.order} {study.scheme.multiplier_order}"
)
print(study.text)
if study.holds is False:
    sys.exit(1)

# %%
# The measurement
# ---------------
# Left: the blade moves down the incline with steps that are much too large; smaller steps come
# closer to the exact motion.  Right: the errors of the study.  The slope 2 means that half the step
# has a quarter of the error, also for the multiplier.

figure, (way, errors) = plt.subplots(1, 2, figsize=(8.0, 4.2), layout="constrained")
for steps, colour, marker in zip((4, 6, 10), COLOURS[1:], "os^"):
    run = dal.integrate(knife_edge, scheme, h=3.0 / steps, steps=steps, check_h=False)
    way.plot(run.q[:, 1], run.q[:, 0], marker=marker, color=colour, label=f"h = {run.h:g}")
exact = np.array([knife_edge.exact(t)[0] for t in np.linspace(0.0, 3.0, 200)])
way.plot(exact[:, 1], exact[:, 0], color="black", linewidth=2.0, label="exact")
way.set(xlabel="y", ylabel="x, downhill")
way.invert_yaxis()
way.legend(frameon=False)

dal.plot.convergence(study, errors, quantity="q")
errors.lines[0].set_label("q")
errors.plot(study.h, study.v_error, "s--", color=COLOURS[1], label="v")
errors.plot(study.h, study.multiplier_error, "^-.", color=COLOURS[2], label=r"$\lambda$")
errors.set(ylabel="error at t = 1", title=scheme)
errors.legend(frameon=False)
if len(sys.argv) > 2:
    figure.savefig(sys.argv[2], dpi=110)
