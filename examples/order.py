"""The order of a scheme, measured: step-size refinement on the knife edge on an incline.

    L = m (v_x^2 + v_y^2)/2 + J v_theta^2/2 + m g x,   sin(theta) v_x - cos(theta) v_y = 0
    the default initial data of the built-in system; t from 0 to 1

Prints, for each step size, the errors of q, v and of the multiplier lambda(q, v) at t = 1 and
the largest |mu v| / sum |mu_i v_i|; then the orders (p, s) beside what the scheme promises, and
the verdict.  p and s are slopes of the errors of one step, minus 1.  ``print(study)`` prints a
table of the same.

    python order.py [SCHEME]
"""

import sys

import dalembert as dal

scheme = sys.argv[1] if len(sys.argv) > 1 else "midpoint"
study = dal.convergence(
    dal.systems.knife_edge(), scheme, t_end=1, steps=[80, 120, 160, 240, 320, 480]
)

print(f"{study.scheme.name} on {study.system.name}")
print("         h    error of q    of v          of lambda     of mu v")
for h, q, v, multiplier, residual in zip(
    study.h, study.q_error, study.v_error, study.multiplier_error, study.residual
):
    print(f"{h:10.7f}    {q:.3e}     {v:.3e}     {multiplier:.3e}     {residual:.1e}")
print(
    f"(p, s)   measured {study.p:.3f} {study.s:.3f}"
    f"   promised {study.scheme.order} {study.scheme.multiplier_order}"
)
print(study.text)
sys.exit(study.holds is False)
