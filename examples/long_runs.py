"""Energy over long times: in a band, and with a drift where a term is not reversible.

The particle (dz = y dx) on springs is reversible: a motion run backwards is a motion again.  With a
gyroscopic term, which is linear in v, it is not.  D is kept to roundoff on both.

Prints the largest error of the energy up to a 16th, a quarter and all of t_end, and the residual.

    python long_runs.py [PICTURE.png [T_END]]
"""

import sys

import numpy as np
import sympy as sp

import dalembert as dal

t_end = float(sys.argv[2]) if len(sys.argv) > 2 else 1600.0
x, y, z = dal.coordinates("x y z")
kinetic = (x.d**2 + y.d**2 + z.d**2) / 2
springs = (x**2 + 2 * y**2 + sp.Rational(3, 2) * z**2) / 2
terms = {"reversible": 0, "gyroscopic": x**2 * z.d}
schemes = {"leapfrog": 0.1, "leapfrog-kl6": 0.25, "leapfrog-kl8": 0.25, "reference": 0.25}

errors, times = {}, {}
print("system      scheme           h    ",
      f"to t = {t_end / 16:g}, {t_end / 4:g}, {t_end:g}   residual of D")
for name, term in terms.items():
    system = dal.System.from_sympy(kinetic - springs + term, [z.d - y * x.d])
    for scheme, h in schemes.items():
        run = dal.integrate(system, scheme, [0.5, 0.3, -0.2], [1, 0.7, 0.3], h=h, t_end=t_end,
                            stride=20,
                            tolerance=1e-12)
        error = abs(run.energy - run.energy[0])
        most = [error[: len(error) // part + 1].max() for part in (16, 4, 1)]
        print(f"{name}  {scheme:14} {h:5g}   ", "  ".join(f"{e:.1e}" for e in most),
              f"    {run.residual.max():.1e}")
        times[name, scheme], errors[name, scheme] = run.t, error
        if scheme == "reference":
            continue
        if run.residual.max() > 12 * 2.0**-53:
            sys.exit("D was expected to be kept to roundoff")
        if name == "reversible" and most[2] > 2 * most[0]:
            sys.exit("the energy was expected to stay in a band")
        if name == "gyroscopic" and most[2] < 4 * most[0]:
            sys.exit("the energy was expected to drift")

if len(sys.argv) > 1:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, sharey=True, figsize=(9, 4), layout="constrained")
    for ax, name in zip(axes, terms):
        for scheme in schemes:
            ax.loglog(times[name, scheme][1:], np.maximum.accumulate(errors[name, scheme])[1:],
                      label=scheme)
        ax.set_title(name)
        ax.set_xlabel("t")
    axes[0].set_ylabel("largest error of the energy so far")
    axes[0].legend()
    figure.savefig(sys.argv[1])
