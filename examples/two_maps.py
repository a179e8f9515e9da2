"""
One map for L, another for D
============================

The Lagrangian and the constraint are discretised by different maps.  The map of the constraint
alone decides whether the energy drifts, and the best pair is not the symmetric one.

The mobile robot has L_d by rho^beta_L and D_d by rho^beta_D (arXiv 1605.02666), the difference maps
from ``(q_0, q_1)`` to ``((1-beta) q_0 + beta q_1, (q_1 - q_0)/h)``.  The mass is constant, so L_d
of beta_L and of 1/2 differ by O(h^3) and by a term without effect on the discrete equations.
Therefore the energy stays bounded for beta_D = 1/2.  The width of the band depends on beta_L, and
1/2 is not the best.  Every run keeps D to roundoff.

``python two_maps.py [PICTURE.png]`` prints for each pair of maps the range of E - E(0), and the
worst residual of D.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import dalembert as dal
from dalembert.show.palette import COLOURS

robot = dal.systems.robot()
# Steps so large that the maps differ; the warning of a large h is turned off.
h, steps = 0.05, 2000
pairs = [(0.5, 0.5), (0.25, 0.5), (0.0, 0.5), (0.5, 0.0), (0.5, 1.0)]

# %%
# ``Scheme.pair`` steps by two maps.  `dalembert.Discrete` does the same on nodes, one step at a
# time, and exposes the intermediate quantities; here it checks the last step of each run.

runs, errors = {}, {}
print("beta_L  beta_D    min E - E(0)    max E - E(0)  residual of D")
for pair in pairs:
    run = runs[pair] = dal.integrate(robot, dal.Scheme.pair(*pair), h=h, steps=steps, check_h=False)
    q, v, _ = dal.Discrete(robot, *pair).advance(h, run.q[-2], run.v[-2], t=run.t[-2])
    if max(abs(q - run.q[-1]).max(), abs(v - run.v[-1]).max()) > 1e-11:
        sys.exit("a step of the run is not that of the discrete mechanics")
    errors[pair] = run.energy - run.energy[0]
    low, high = errors[pair].min(), errors[pair].max()
    print(f"{pair[0]:6g}  {pair[1]:6g}    {low:12.3e}    {high:12.3e}    {run.residual.max():9.1e}")

bands = {pair: np.ptp(error) for pair, error in errors.items()}
if not bands[0.25, 0.5] < bands[0.5, 0.5] < 0.1 * bands[0.5, 0.0]:
    sys.exit("the energy was expected to be a matter of D_d, and best for two maps")

# %%
# Left: the path of the robot, a rosette.  With a one-sided map for D, in orange, the energy grows,
# and so do the petals.  Right: the energies.  If the map of the constraint is the midpoint map, the
# map of L changes only the width of a band of some hundredths.

figure = plt.figure(figsize=(10.5, 5.2), layout="constrained")
axes = figure.subplot_mosaic([["way", "midpoint"], ["way", "one-sided"]], width_ratios=(1, 1))
colours = dict(zip(pairs, (COLOURS[k] for k in (0, 2, 4, 3, 1)), strict=True))
for pair in ((0.5, 1.0), (0.5, 0.5)):
    axes["way"].plot(*runs[pair].q[:, :2].T, color=colours[pair], linewidth=1.1)
axes["way"].set(xlabel="x", ylabel="y", aspect="equal")
for pair, error in errors.items():
    ax = axes["midpoint" if pair[1] == 0.5 else "one-sided"]
    label = f"$\\beta_L$ = {pair[0]:g}, $\\beta_D$ = {pair[1]:g}"
    ax.plot(runs[pair].t, error, linewidth=0.9, color=colours[pair], label=label)
axes["midpoint"].set_title("$D_d$ by the midpoint map")
axes["one-sided"].set_title("$D_d$ by a one-sided map")
axes["one-sided"].set_xlabel("t")
for name in ("midpoint", "one-sided"):
    axes[name].set_ylabel("E - E(0)")
figure.legend(loc="outside lower center", ncols=5, frameon=False, fontsize="small")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
