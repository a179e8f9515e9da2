"""A thousand million steps of a chaotic system: residual of D, energy, and what it costs.

Not a publication but a number that we have not found published: runs with velocity constraints are
shown for 1e3 to 1e6 steps.  System and initial data: those of chaotic_walk.py, alpha = pi/9.

Here: one run each of leapfrog and a composition of order 4, on one thread, with a journal; 1e4 rows
are stored.  The residual of D is taken twice, in units of 4 n u with u = 2^-53: by the library
after every step; and at the rows in long double, with the Euclidean norm of v in its scale.
The energy is set beside the random walk of chaotic_walk.py: mean square = D t.
"""

from __future__ import annotations

import resource
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import common
import numpy as np
from chaotic_walk import data, quartic

import dalembert as dal

UNIT = 4 * 7 * 2.0**-53
WALKS = {("leapfrog", 0.05): 6e-10, ("leapfrog-suzuki4", 0.2): 1.5e-11}  # D, of chaotic_walk.py


def residuals(found: dal.Solution) -> np.ndarray:
    """Return |mu v| / (sum |mu_i| norm(v)) at the rows, in long double."""
    q, v = found.q.astype(np.longdouble), found.v.astype(np.longdouble)
    phi = v[:, 0] + (q[:, 1:4] * v[:, 4:]).sum(axis=1)
    size = 1 + abs(q[:, 1:4]).sum(axis=1)
    return abs(phi) / (size * np.sqrt((v**2).sum(axis=1)))


def memory() -> float:
    """Return the largest memory of the process so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    system, steps = quartic(), 10**6 if quick else 10**9
    q0, v0 = data(np.pi / 9)
    rows, drawn = [], {}
    for (scheme, h), diffusion in WALKS.items():
        dal.integrate(system, scheme, q0, v0, h=h, steps=1000, progress=False)  # compiles
        before, wall, cpu = memory(), time.perf_counter(), time.process_time()
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore", dal.DalembertWarning)  # the energy, which is looked at
            path = Path(folder) / "run.dal"
            found = dal.integrate(system, scheme, q0, v0, h=h, steps=steps, stride=steps // 10**4,
                                  journal=path, progress=False, check_h=False)  # fmt: skip
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            size, same = path.stat().st_size / 1e6, dal.load(path, system)
            same = np.array_equal(same.q, found.q) and np.array_equal(same.v, found.v)
        more, what = memory() - before, f"{scheme}, h = {h:g}, t = {found.t[-1]:.3g}"
        worst = found.stats.worst_residual / UNIT
        rows.append(common.holds(
            f"{what}: worst residual of D after {steps:.0e} steps", "-",
            f"{worst:.2f} x 4 n u s", found.stats.steps == steps and 0 < worst <= 1,
            f"at most 1, 4 n u = {UNIT:.1e}"))  # fmt: skip
        by_formula = residuals(found) / UNIT
        tenth = len(by_formula) // 10
        early, late = by_formula[1:tenth].mean(), by_formula[-tenth:].mean()
        rows.append(common.holds(
            f"{what}: |mu v| / (sum |mu_i| norm(v)) at 1e4 rows, in long double", "-",
            f"at most {by_formula.max():.2f}; mean {early:.4f} in the first tenth, {late:.4f} in "
            "the last", by_formula.max() <= 1 and abs(late / early - 1) < 0.2,
            "at most 1, means within 20 %"))  # fmt: skip
        error = found.energy - found.energy[0]
        walked = np.sqrt(diffusion * found.t[-1])
        rows.append(common.holds(
            f"{what}: max of E(t) - E(0), E(0) = {found.energy[0]:.3g}", "-",
            f"{abs(error).max():.1e}", abs(error).max() < 4 * walked,
            f"sqrt(D t) = {walked:.1e}; below 4 of it"))  # fmt: skip
        rows.append(common.holds(
            f"{what}: cost", "-",
            f"{cpu / steps * 1e9:.0f} ns of cpu a step, {wall:.2g} s in all; {more:.1f} MB of "
            f"memory more; journal of {size:.1f} MB", same and more < 50,
            "below 50 MB, and the journal has the bits of the run"))  # fmt: skip
        drawn[what] = found.t, error, by_formula
    return rows, drawn


def draw(drawn: Any) -> Any:
    """Draw energy and residual."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, len(drawn), figsize=(10, 5), layout="constrained", sharex="col")
    for (above, below), (what, (t, error, residual)) in zip(axes.T, drawn.items()):
        above.plot(t[::10], error[::10], lw=0.6)
        above.set_title(what)
        above.ticklabel_format(style="sci", scilimits=(-2, 4))
        below.semilogy(t[1::10], residual[1::10], ".", ms=1.5)
        below.axhline(1, color="k", ls=":", lw=1)
        below.set(xlabel="t", ylim=(1e-5, 3))
    axes[0, 0].set_ylabel("E(t) - E(0)")
    axes[1, 0].set_ylabel(r"$|\mu v|\, /\, (4 n u \Sigma_i |\mu_i|\, \Vert v\Vert)$")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
