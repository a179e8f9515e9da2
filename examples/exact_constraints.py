"""The exact discrete constraint D_d^E of the Chaplygin sleigh against D_d of rho^beta.

    D_d^E = {(q0, q(h)) : v0 in D}           pairs on solutions in D
    D_d   = {mu(g) (q1 - q0)/h = 0}          with g = (1 - beta) q0 + beta q1

Neither contains the other.  Prints how far a pair of D_d^E is from D_d, |phi_d|, and how far a
pair of D_d is from D_d^E: |mu (q1 - q(h))/h|, where q(h) comes from the velocity in D at q0 that
leads as close to q1 as D allows.  Both are O(h), and O(h^2) for beta = 1/2.

    python exact_constraints.py [PICTURE.png]
"""

import re
import sys

import numpy as np

import dalembert as dal

sleigh = dal.systems.sleigh()
q0, v0 = sleigh.q0, sleigh.v0
betas = [0.0, 0.5, 1.0]
steps = [0.4 / 2**k for k in range(7)]


def of_exact_pair(beta, h):
    """Return |phi_d| of a pair of D_d^E."""
    q1 = dal.reference(sleigh, t=h, tolerance=1e-14).q
    return abs(dal.Discrete(sleigh, beta).constraint(h, q0, q1)).max()


def of_discrete_pair(beta, h):
    """Return the defect with respect to D_d^E of the pair of D_d that belongs to (q0, v0)."""
    pair = dal.Discrete(sleigh, beta).nodes(h, q0, v0)
    _, defect = dal.exact_velocity(sleigh, h, *pair, tolerance=1e-14)
    return abs(defect).max()


defects = {
    "pairs of D_d^E, distance from D_d": of_exact_pair,
    "pairs of D_d, distance from D_d^E": of_discrete_pair,
}
found = {
    title: np.array([[measure(beta, h) for h in steps] for beta in betas])
    for title, measure in defects.items()
}
for title, values in found.items():
    print(title)
    print("         h", *(f"   beta = {beta:g}" for beta in betas))
    for h, row in zip(steps, values.T):
        print(f"{h:10.5f}", *(f"{value:11.3e}" for value in row))
    slopes = np.log2(values[:, -2] / values[:, -1])
    print("     slope", *(f"{slope:11.3f}" for slope in slopes))
    expected = [2 if beta == 0.5 else 1 for beta in betas]
    if abs(slopes - expected).max() > 0.1:
        sys.exit(f"slopes {expected} were expected")

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10.0, 4.2), sharey=True, layout="constrained")
    for ax, (title, values) in zip(axes, found.items()):
        for beta, row, marker in zip(betas, values, "os^"):
            ax.loglog(steps, row, marker=marker, markersize=5, label=f"$\\beta$ = {beta:g}")
        for order, at in ((1, values[0]), (2, values[1])):
            guide = 0.4 * at[-1] * (np.array(steps) / steps[-1]) ** order
            ax.loglog(steps, guide, color="0.6", linewidth=0.8, linestyle="--")
            ax.annotate(f"slope {order}", (steps[3], guide[3]), (4, -10),
                        textcoords="offset points", color="0.4", fontsize=8)  # fmt: skip
        ax.set_title(re.sub(r"D_d(\^E)?", r"$D_d\1$", title))
        ax.set_xlabel("step h")
    axes[0].set_ylabel("defect")
    axes[0].legend(frameon=False)
    figure.suptitle("Chaplygin sleigh")
    figure.savefig(sys.argv[1], dpi=110)
