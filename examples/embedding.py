"""
A scheme as a flow
==================

The steps of a scheme lie on a solution of a perturbed differential equation.  The perturbation has
the period h, and its size measures the order.

One step of a scheme of order p is the time-h map of ::

    xidot = f(xi) + h^p g(t/h, xi)

in coordinates xi of D, with a periodic g that stays bounded as h -> 0.  For the particle by
midpoint, p = 2: the curves of ``|g|`` over one period nearly agree for three steps h.  With p - 1
or p + 1 in the formula, the maximum of ``|g|`` vanishes or grows with h -> 0; only p gives a limit.

``python embedding.py [PICTURE.png]`` prints the maxima, the measured order, and the distance
between the time-h map and the scheme.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import dalembert as dal
from dalembert.show.palette import COLOURS

# %%
# A curve through the steps
# -------------------------
# A particle in a harmonic potential, with steps so large that they are visible.  The curve is
# smooth, a motion in D, and contains each state that the scheme computes.

oscillator, h, steps = dal.systems.particle_oscillator(), 0.7, 10
flow = dal.embedding(oscillator, "leapfrog", h=h)
curve = flow.curve(np.linspace(0.0, steps, 40 * steps + 1))
made = dal.integrate(oscillator, "leapfrog", h=h, steps=steps, check_h=False)
exact = dal.integrate(oscillator, "reference", h=h / 40, steps=40 * steps)

figure, ax = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
ax.plot(exact.q[:, 0], exact.q[:, 1], "--", color="0.55", label="exact motion")
ax.plot(curve[:, 0], curve[:, 1], color=COLOURS[0], linewidth=2, label="perturbed flow")
ax.plot(made.q[:, 0], made.q[:, 1], "o", color=COLOURS[1], markersize=9, label="leapfrog, h = 0.7")
ax.set(xlabel="x", ylabel="y", aspect="equal")
ax.legend(frameon=False)
if abs(curve[::40, :3] - made.q).max() > 1e-10:
    sys.exit("the curve was expected to go through the states of the scheme")

# %%
# The size of g
# -------------
# The maximum of ``|g|`` over a period, for nine steps and three p in the formula:

particle = dal.systems.particle()
scheme = dal.Scheme.find("midpoint")
steps = 0.25 / 1.5 ** np.arange(9)
orders = [scheme.order - 1, scheme.order, scheme.order + 1]

embedding = dal.embedding(particle, scheme, h=0.2)
print(embedding)
bounds = {
    p: np.array([dal.embedding(particle, scheme, h, order=p).bound() for h in steps])
    for p in orders
}
print("       h", *(f"max |g|, p = {p}" for p in orders))
for h, row in zip(steps, zip(*bounds.values())):
    print(f"{h:8.5f}", *(f"{value:14.5f}" for value in row))
measured = embedding.measured_order(steps)
print(f"measured order {measured.slope:.3f} from {measured.points} steps")
for p, values in bounds.items():
    slope = np.polyfit(np.log(steps), np.log(values), 1)[0]
    if abs(slope - (scheme.order - p)) > 0.05:
        sys.exit(f"max |g| for p = {p} was expected to behave as h^{scheme.order - p}")

# %%
# The time-h map is the scheme, up to the accuracy of the flow:

run = dal.integrate(particle, scheme, h=embedding.h, steps=1)
end = embedding.chart.drop(run.q[-1], run.v[-1])
miss = abs(embedding.flow(0.0, embedding.h) - end).max()
print(f"time-h map against the scheme {miss:.1e}")
if miss > 1e-10:
    sys.exit("the time-h map was expected to be the scheme")

# %%
# Left: the shape of g over a period.  Right: the three values of p.

study, axes = plt.subplots(1, 2, figsize=(9.0, 4.0), layout="constrained")
embedding.plot(hs=[0.2, 0.1, 0.05], ax=axes[0])
for (p, values), marker, line in zip(bounds.items(), "os^", ("--", "-", ":")):
    role = {-1: " (too small)", 0: " (the order)", 1: " (too large)"}[p - scheme.order]
    axes[1].loglog(steps, values, marker=marker, linestyle=line, label=f"p = {p}{role}")
axes[1].set_xlabel("step h")
axes[1].set_ylabel("largest |g| over a period")
axes[1].set_title("particle: midpoint, which order?")
axes[1].legend(frameon=False)
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
