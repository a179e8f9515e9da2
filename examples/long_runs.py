"""
A band, or a drift
==================

Over long times a symmetric scheme keeps the energy in a band if the motion is reversible; otherwise
the energy drifts.

The particle with ``dz = y dx`` is held by springs.  Run backwards, its motion is a motion too.
With a gyroscopic term, which is linear in the velocity, it is not::

    L = (v_x^2 + v_y^2 + v_z^2)/2 - (x^2 + 2 y^2 + 3/2 z^2)/2  [+ x^2 v_z],    v_z = y v_x

The energy is a first integral of both motions, and D is kept to roundoff in all runs.

``python long_runs.py [PICTURE.png [T_END]]`` prints the largest error of the energy up to a 16th, a
quarter and all of T_END (default 1600), and the residual of D.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np
import sympy as sp

import dalembert as dal
from dalembert.show.palette import COLOURS

t_end = float(sys.argv[2]) if len(sys.argv) > 2 else 1600.0
x, y, z = dal.coordinates("x y z")
kinetic = (x.d**2 + y.d**2 + z.d**2) / 2
springs = (x**2 + 2 * y**2 + sp.Rational(3, 2) * z**2) / 2
terms = {"reversible": 0, "gyroscopic": x**2 * z.d}

# %%
# Symmetric schemes of order 2, 6 and 8.  The adaptive reference is shown for comparison: it is not
# symmetric, and its error is small because its steps are.

schemes = {"leapfrog": 0.1, "leapfrog-kl6": 0.25, "leapfrog-kl8": 0.25, "reference": 0.25}
runs = {}
print(
    "system      scheme           h    ",
    f"to t = {t_end / 16:g}, {t_end / 4:g}, {t_end:g}   residual of D",
)
for name, term in terms.items():
    system = dal.System.from_sympy(kinetic - springs + term, [z.d - y * x.d])
    for scheme, h in schemes.items():
        stride = 20 if scheme == "reference" else 2
        run = runs[name, scheme] = dal.integrate(
            system, scheme, [0.5, 0.3, -0.2], [1, 0.7, 0.3],
            h=h, t_end=t_end, stride=stride,
            tolerance=1e-12 if scheme == "reference" else None,
            check_h=False,  # the energy counts, not the state
        )  # fmt: skip
        error = abs(run.energy - run.energy[0])
        most = [error[: len(error) // part + 1].max() for part in (16, 4, 1)]
        print(
            f"{name}  {scheme:14} {h:5g}   ",
            "  ".join(f"{e:.1e}" for e in most),
            f"    {run.residual.max():.1e}",
        )
        if scheme == "reference":
            continue
        if run.residual.max() > 12 * 2.0**-53:
            sys.exit("D was expected to be kept to roundoff")
        if name == "reversible" and most[2] > 2 * most[0]:
            sys.exit("the energy was expected to stay in a band")
        if name == "gyroscopic" and most[2] < 4 * most[0]:
            sys.exit("the energy was expected to drift")

# %%
# Above: the motion by ``leapfrog`` in the plane of x and z.  Without the gyroscopic term the late
# orbit coincides with the early one; with it the orbit grows by the spurious energy.  Below: the
# largest error of the energy so far.  It is constant in a band, and proportional to time in a
# drift.  A higher order reduces the drift, but does not remove it.

figure, axes = plt.subplots(
    2, 2, sharex="row", sharey="row", figsize=(8.6, 6.8), layout="constrained"
)
for (above, below), name in zip(axes.T, terms, strict=True):
    run = runs[name, "leapfrog"]
    part = int(np.clip(len(run.t) // 10, 1, 800))
    late = f"t = {run.t[-part]:.0f} to {run.t[-1]:.0f}"
    above.plot(*run.q[-part:, [0, 2]].T, color=COLOURS[1], linewidth=1.1, label=late)
    early = f"t = 0 to {run.t[part]:.0f}"
    above.plot(*run.q[:part, [0, 2]].T, color=COLOURS[0], linewidth=1.1, label=early)
    above.set(xlabel="x", title=name)
    for scheme, colour in zip(schemes, COLOURS[1:], strict=False):
        run = runs[name, scheme]
        error = np.maximum.accumulate(abs(run.energy - run.energy[0]))
        below.loglog(run.t[1:], error[1:], linewidth=2, color=colour, label=scheme)
    below.set(xlabel="t", xlim=(t_end / 1600, t_end))
axes[0, 0].set_ylabel("z")
axes[1, 0].set_ylabel("largest error of E so far")
for ax in axes[:, 1]:
    ax.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
figure.suptitle("One term is not reversible, and the energy drifts")
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
