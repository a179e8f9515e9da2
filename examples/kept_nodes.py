"""Which constraint a scheme keeps: D at moved nodes, D_eps at kept ones.

    D      mu(q) v = 0
    D_eps  mu(q - (1 - beta) h v) v = 0      with beta = 1/2 here

The particle in a harmonic potential, by midpoint: with moved nodes it stays in D to roundoff, and
O(h) away from D_eps; with kept nodes it stays in D_eps to roundoff, and O(h) away from D.  Neither
drifts: what looks like a violated constraint is another one.

Prints the largest |phi| of either constraint over a run, for two steps h.

    python kept_nodes.py [PICTURE.png]
"""

import sys

import numpy as np

import dalembert as dal

system = dal.systems.particle_oscillator()
t_end, steps = 100.0, [0.1, 0.05]
schemes = {"midpoint": None, "midpoint-nodes": "shift"}  # how kept nodes start from data in D


def run(scheme, h):
    """Return the times and |phi| of D and of D_eps, in a run from the same data in D."""
    found = dal.integrate(system, scheme, h=h, t_end=t_end, initial=schemes[scheme])
    shifts = (0.0, h / 2)
    return found.t, [abs(system.residual(found.q, found.v, shift))[:, 0] for shift in shifts]


runs = {(scheme, h): run(scheme, h) for scheme in schemes for h in steps}
print("scheme              h       D          D_eps")
for (scheme, h), (_, residuals) in runs.items():
    in_D, in_D_eps = (residual.max() for residual in residuals)
    print(f"{scheme:15}  {h:5g}    {in_D:.1e}    {in_D_eps:.1e}")
    kept, other = (in_D, in_D_eps) if scheme == "midpoint" else (in_D_eps, in_D)
    if not kept < 1e-14 < 0.1 * h < other:
        sys.exit("one constraint was expected to be kept to roundoff, and the other not")

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = [r"$D$:  $\mu(q)\,v$", r"$D_\varepsilon$:  $\mu(q - h v/2)\,v$"]
    figure, axes = plt.subplots(1, 2, figsize=(10.0, 4.2), sharey=True, layout="constrained")
    for ax, scheme, title in zip(axes, schemes, ("moved nodes", "kept nodes")):
        t, residuals = runs[scheme, steps[0]]
        for name, colour, residual in zip(names, ("#0072B2", "#D55E00"), residuals):
            # An exact zero has no place on a logarithmic axis: it stands at 1e-17.
            ax.semilogy(t, np.maximum(residual, 1e-17), color=colour, linewidth=0.8)
            height = 1e-15 if residual.max() < 1e-14 else 1e-6
            ax.text(t_end / 2, height, name, color=colour, ha="center", fontsize="large")
        ax.axhline(2.0**-53, color="black", linewidth=1.0, linestyle="--")
        ax.text(0.0, 1.6e-16, "unit roundoff u", fontsize="small")
        ax.set_title(f"{title} ({scheme})")
        ax.set_xlabel("time t (user's units)")
    axes[0].set_ylabel("size of the constraint, $|\\phi|$ (user's units)")
    figure.suptitle(f"Particle in a harmonic potential, h = {steps[0]:g}")
    figure.savefig(sys.argv[1], dpi=110)
