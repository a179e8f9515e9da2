"""A scheme as the time-h map of a perturbed flow, and the order that this measures.

One step of a scheme of order p is the time-h map of

    xidot = f(xi) + h^p g(t/h, xi)

with a periodic g that stays bounded as h -> 0.  On the left |g| over one period for the particle by
midpoint, p = 2: the curves for three steps h nearly agree.  On the right its maximum over h with
p - 1, p and p + 1 in the formula: only with the true p it neither vanishes nor grows.

Prints the maxima, the measured order, and how far the time-h map is from the scheme.

    python embedding.py [PICTURE.png]
"""

import sys

import numpy as np

import dalembert as dal

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

run = dal.integrate(particle, scheme, h=embedding.h, steps=1)
end = embedding.chart.drop(run.q[-1], run.v[-1])
miss = abs(embedding.flow(0.0, embedding.h) - end).max()
print(f"time-h map against the scheme {miss:.1e}")
if miss > 1e-10:
    sys.exit("the time-h map was expected to be the scheme")

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    embedding.plot(hs=[0.2, 0.1, 0.05], ax=axes[0])
    for (p, values), marker, line in zip(bounds.items(), "os^", ("--", "-", ":")):
        role = {-1: " (too small)", 0: " (the order)", 1: " (too large)"}[p - scheme.order]
        axes[1].loglog(steps, values, marker=marker, linestyle=line, label=f"p = {p}{role}")
    axes[1].set_xlabel("step h (user's units of time)")
    axes[1].set_ylabel("largest |g| over a period (user's units)")
    axes[1].set_title("particle: midpoint, which order?")
    axes[1].legend(frameon=False)
    figure.savefig(sys.argv[1], dpi=110)
