"""The discrete Lagrangian and the discrete constraint from different maps (arXiv 1605.02666).

The mobile robot, L_d by rho^beta_L and D_d by rho^beta_D.  The mass is constant, so L_d of beta_L
and of 1/2 differ by a term that the discrete equations do not see, and O(h^3): whether the energy
drifts is a matter of D_d alone, and stays bounded for beta_D = 1/2.  How wide the band is depends
on beta_L, and 1/2 is not the best.  Every run keeps D to roundoff.

Prints for each pair of maps the range of E - E(0), and the largest |mu v| / sum |mu_i v_i|.

    python two_maps.py [PICTURE.png]
"""

import sys

import numpy as np

import dalembert as dal

robot = dal.systems.robot()
h, steps = 0.05, 2000
pairs = [(0.5, 0.5), (0.25, 0.5), (0.0, 0.5), (0.5, 0.0), (0.5, 1.0)]

errors = {}
print("beta_L  beta_D    min E - E(0)    max E - E(0)      of mu v")
for pair in pairs:
    run = dal.integrate(robot, dal.Scheme.pair(*pair), h=h, steps=steps)
    # the same step by the discrete mechanics on nodes, which shows all that is in between
    q, v, _ = dal.Discrete(robot, *pair).advance(h, run.q[-2], run.v[-2], t=run.t[-2])
    if max(abs(q - run.q[-1]).max(), abs(v - run.v[-1]).max()) > 1e-11:
        sys.exit("a step of the run is not that of the discrete mechanics")
    errors[pair] = run.energy - run.energy[0]
    low, high = errors[pair].min(), errors[pair].max()
    print(f"{pair[0]:6g}  {pair[1]:6g}    {low:12.3e}    {high:12.3e}    {run.residual.max():9.1e}")

bands = {pair: np.ptp(error) for pair, error in errors.items()}
if not bands[0.25, 0.5] < bands[0.5, 0.5] < 0.1 * bands[0.5, 0.0]:
    sys.exit("the energy was expected to be a matter of D_d, and best for two maps")

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    t = h * np.arange(steps + 1)
    figure, axes = plt.subplots(1, 2, figsize=(12.0, 4.4), layout="constrained")
    for (beta_L, beta_D), error in errors.items():
        ax = axes[0] if beta_D == 0.5 else axes[1]
        label = f"$\\beta_L$ = {beta_L:g}, $\\beta_D$ = {beta_D:g}"
        ax.plot(t, error, linewidth=0.9, label=label)
    axes[0].set_title("$D_d$ by the midpoint map")
    axes[1].set_title("$D_d$ by a one-sided map")
    axes[0].set_ylabel("E - E(0)")
    for ax in axes:
        ax.set_xlabel("t")
        ax.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)
        ax.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3)
    figure.suptitle(f"Mobile robot, h = {h:g}: energy with one map and with two")
    figure.savefig(sys.argv[1], dpi=110)
