"""
D in coordinates
================

Charts of D give states between the rows of a run, and a curve from one state to another.

A Chaplygin sleigh turns.  Its run is stored every 0.4 units of time.  Between the rows ``run(t)``
interpolates coordinates xi = (q, v_independent) and therefore stays in D to roundoff.  A cubic
through the same data leaves D.  The blade turns out of the initial coordinates, so the chart
changes on the way.

``python charts.py [PICTURE.png]`` prints the distance from D and the error against the exact motion
for each interpolation.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import dalembert as dal

# %%
# Between the rows
# ----------------

sleigh = dal.systems.sleigh()
run = dal.integrate(sleigh, "leapfrog-kl8", h=0.4, t_end=8)
t = np.linspace(0.0, 8.0, 801)
inside = run(t)


def cubic(times):
    """Return (q, v) of the cubic Hermite interpolation of all components."""
    k = np.minimum((times / run.h).astype(int), len(run.t) - 2)
    s = (times / run.h - k)[:, None]
    a, b = 1 - 3 * s**2 + 2 * s**3, s * (1 - s) ** 2 * run.h
    c, d = 3 * s**2 - 2 * s**3, s**2 * (s - 1) * run.h
    vdot = sleigh.acceleration(run.q, run.v)
    q = a * run.q[k] + b * run.v[k] + c * run.q[k + 1] + d * run.v[k + 1]
    v = a * run.v[k] + b * vdot[k] + c * run.v[k + 1] + d * vdot[k + 1]
    return q, v


exact = np.array([np.concatenate(sleigh.exact(time)) for time in t])
residuals, errors = {}, {}
for name, (q, v) in {"run(t)": (inside.q, inside.v), "cubic": cubic(t)}.items():
    residuals[name] = sleigh.relative_residual(q, v)
    errors[name] = np.abs(np.concatenate([q, v], axis=1) - exact).max(axis=1)
    print(f"{name:7s} off D by {residuals[name].max():.1e}, error {errors[name].max():.1e}")
chart = dal.Chart(sleigh, run.q[0], run.v[0])
print(f"{inside.chart_changes} changes of the chart, at first {chart!r}")

# %%
# A curve in D
# ------------
# The curve c(tau) = psi(chi_0 xi_1 + chi_1 xi_2) leads from the first state to the fourth inside D,
# with all derivatives zero at both ends.

tau = np.linspace(0.0, 1.0, 201)
q, v = chart.curve(run.q[0], run.v[0], run.q[3], run.v[3], tau)
curve_residual = sleigh.relative_residual(q, v).max()
print(f"the curve from t = 0 to t = {run.t[3]:g} is off D by {curve_residual:.1e}")
if max(residuals["run(t)"].max(), curve_residual) > 1e-15 or residuals["cubic"].max() < 1e-6:
    sys.exit("run(t) and the curve were expected in D, the cubic outside")

# %%

figure, (left, right) = plt.subplots(1, 2, figsize=(12.0, 4.4), layout="constrained")
for (name, residual), style in zip(residuals.items(), ("-", "--"), strict=True):
    left.semilogy(t, np.maximum(residual, 1e-18), style, linewidth=0.9, label=name)
left.axhline(4 * 3 * 2.0**-53, color="0.6", linewidth=0.8, linestyle=":", label="4 n u")
left.set(xlabel="time t", ylabel="residual of D", ylim=(1e-18, 1e-3))
left.set_title("between the rows of a run, h = 0.4")
right.plot(inside.q[:, 0], inside.q[:, 1], "-", linewidth=0.9, label="run(t)")
right.plot(run.q[:, 0], run.q[:, 1], "o", markersize=4, label="stored states")
right.plot(q[:, 0], q[:, 1], "--", color="0.2", linewidth=1.6, label="c(tau)")
right.set(xlabel="x", ylabel="y", aspect="equal")
right.set_title("the centre of mass, and a curve in D")
for ax in (left, right):
    ax.legend(frameon=False)
figure.suptitle("Chaplygin sleigh: states in D by coordinates of D")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
