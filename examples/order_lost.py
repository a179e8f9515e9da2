"""The order that kept nodes lose, and where it went.

The Chaplygin sleigh by the midpoint scheme, of order 2 at moved nodes.  At kept nodes the order is
1, however the run starts: from data in D, where its first step jumps to D_eps; from data projected
to D_eps; or from data shifted by (q, v) -> (q + h v/2, v).  In the last case nothing is lost: these
are the states of the run at moved nodes, shifted, and (q - h v/2, v) is of order 2 again.

Prints the error of (q, v) at t = 1 against the exact solution, for several steps h.

    python order_lost.py [PICTURE.png]
"""

import sys

import numpy as np

import dalembert as dal

system = dal.systems.sleigh()
exact = np.concatenate(system.exact(1.0))
counts = [8, 12, 16, 24, 32, 48, 64, 96, 128]
steps = 1.0 / np.array(counts)


def error(scheme, initial, count, back=0.0):
    """Return the error at t = 1 of (q - back h v, v) after count steps."""
    run = dal.integrate(system, scheme, h=1.0 / count, steps=count, initial=initial)
    end = np.concatenate([run.q[-1] - back / count * run.v[-1], run.v[-1]])
    return abs(end - exact).max()


# What a curve shows: scheme, start, how far q is moved back, and the order that is expected.
curves = {
    "moved nodes": ("midpoint", None, 0.0, 2),
    "kept nodes, start in D": ("midpoint-nodes", "D", 0.0, 1),
    "kept nodes, start projected to D_eps": ("midpoint-nodes", "project", 0.0, 1),
    "kept nodes, start shifted": ("midpoint-nodes", "shift", 0.0, 1),
    "the same, seen at q - h v/2": ("midpoint-nodes", "shift", 0.5, 2),
}
errors = {}
print(f"{'error at h =':38}  1/8        1/32       1/128      order")
for name, (scheme, initial, back, order) in curves.items():
    found = np.array([error(scheme, initial, count, back) for count in counts])
    slope = np.polyfit(np.log(steps), np.log(found), 1)[0]
    print(f"{name:38}", *(f" {x:.1e}  " for x in found[[0, 4, 8]]), f" {slope:.2f}")
    if abs(slope - order) > 0.1:
        sys.exit(f"order {order} was expected")
    errors[name] = found

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    styles = [("o", "-", 9), ("s", "--", 9), ("+", ":", 9), ("^", "-.", 6), ("x", ":", 7)]
    figure, ax = plt.subplots(figsize=(9.4, 4.6), layout="constrained")
    for (name, found), (marker, line, size) in zip(errors.items(), styles):
        ax.loglog(steps, found, marker=marker, linestyle=line, markersize=size, label=name,
                  markerfacecolor="none")  # fmt: skip
    for order, at in ((1, errors["kept nodes, start in D"]), (2, errors["moved nodes"])):
        guide = 0.45 * at[0] * (steps / steps[0]) ** order
        ax.loglog(steps, guide, color="0.6", linewidth=0.8)
        ax.annotate(f"slope {order}", (steps[4], guide[4]), (4, -12), textcoords="offset points",
                    color="0.3", fontsize="small")  # fmt: skip
    ax.set_xlabel("step h (user's units of time)")
    ax.set_ylabel("error of (q, v) at t = 1 (user's units)")
    ax.set_title("Chaplygin sleigh, midpoint: moved and kept nodes")
    ax.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(sys.argv[1], dpi=110)
