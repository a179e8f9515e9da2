"""Where the energy drifts, and what then helps.

K. Modin, O. Verdier: What makes nonholonomic integrators work?, Numer. Math. 145 (2020) 405-435,
doi:10.1007/s00211-020-01126-y, arXiv:1707.04514. From the abstract: "no method performs well on all
problems"; reversibility is the main mechanism behind near conservation, and the usual problems all
are reversible and integrable. Their parameters were not to be had; the code that goes with the
paper, https://github.com/olivierverdier/odelab, has one non-reversible system
(`NonReversibleContactOscillator`): momenta p - grad S, S = cos(z), that is, dS/dt taken from L. It
does not change the motion. Numbers of that code, N = 40, 100 periods, max |E - E(0)|: McLachlan
0.29, Spark 2 0.70, Spark 3 2.2e-3 (their start is not recorded).

Here: systems of our own parameters. For each it is measured whether leapfrog is reversible, by 100
steps forth, the reversal q -> S q, v -> -S v, and 100 steps back, and by how much the largest error
of the energy grows from t_end/16 to t_end. Then the rate of the drift where there is one, for
schemes of all orders with two steps each. The gearbox has x' + f(y) z' = 0 and a driver y with a V
of its own.
"""

from __future__ import annotations

import time
import warnings
from typing import Any, NamedTuple

import common
import numpy as np
import sympy as sp

import dalembert as dal

x, y, z = dal.coordinates("x y z")
FREE = (x.d**2 + y.d**2 + z.d**2) / 2
HALF, SOME = sp.Rational(1, 2), sp.Rational(3, 10)
GEAR, WHEEL, ROLL = x.d + y * z.d, x.d + sp.cos(y) * z.d, z.d - y * x.d
KNIFE = sp.sin(z) * x.d - sp.cos(z) * y.d
PAIR, SPRINGS = FREE - (x**2 + z**2) / 2, FREE - (x**2 + 2 * y**2 + 3 * HALF * z**2) / 2
WELL = FREE + x / 2 - (x**2 + y**2) / 2
AT_GEAR = [1.0, 0.5, 0.3], [-0.2, 0.3, 0.4]
TURNING = [1.0, 0.0, 0.3], [-0.4, 3.0, 0.4]
AT_ROLL = [0.5, 0.3, -0.2], [1.0, 0.7, 0.3]
AT_KNIFE = [0.3, 0.2, 0.1], [np.cos(0.1) / 2, np.sin(0.1) / 2, 1.0]
AT_CONTACT = [np.sqrt(1.5), 1.0, -np.sqrt(0.5)], [0.0, 0.0, 0.0]
ORBIT, SCHEME = "reversible, the motion not its own mirror image: drifts", "not reversible: drifts"
N40 = 2 * np.sin(np.pi / 40)
SCHEMES = {"leapfrog": 1, "midpoint": 1, "leapfrog-suzuki4": 2}  # their steps, in leapfrogs


class Case(NamedTuple):
    """A system, its start, the step of leapfrog, and what is expected."""

    name: str
    L: Any
    constraint: Any
    start: tuple[list[float], list[float]]
    h: float
    why: str = ""  # it drifts
    signs: tuple[int, int, int] = (1, 1, 1)  # S, of the reversal


CASES = [
    Case("contact oscillator, eps = 0.3", PAIR - y**2 / 2 - SOME / 2 * x**2 * z**2, GEAR,
         AT_CONTACT, N40),
    Case("gearbox, f = y, driver y^2/2 + y^3/5, swinging", PAIR - y**2 / 2 - y**3 / 5, GEAR,
         AT_GEAR, N40),
    Case("gearbox, f = y, driver -cos(y) + 0.3 sin(2y), swinging",
         PAIR + sp.cos(y) - SOME * sp.sin(2 * y), GEAR, AT_GEAR, N40),
    Case("particle on springs", SPRINGS, ROLL, AT_ROLL, 0.1),
    Case("knife edge on an incline, in a well", WELL, KNIFE, AT_KNIFE, 0.1),
    Case("particle in a magnetic field, + (x y' - y x')/2", SPRINGS + (x * y.d - y * x.d) / 2, ROLL,
         AT_ROLL, 0.1, signs=(1, -1, -1)),
    Case("gearbox, f = cos(y), driver -cos(y), turning round", PAIR + sp.cos(y), WHEEL, TURNING,
         0.15, signs=(1, -1, 1)),
    Case("gearbox, f = cos(y), driver -cos(y) + 0.3 sin(2y), turning round",
         PAIR + sp.cos(y) - SOME * sp.sin(2 * y), WHEEL, TURNING, 0.15, ORBIT),
    Case("contact oscillator, - d cos(z)/dt", PAIR - y**2 / 2 + sp.sin(z) * z.d, GEAR, AT_CONTACT,
         N40, SCHEME),
    Case("particle on springs, - d cos(z)/dt", SPRINGS + sp.sin(z) * z.d, ROLL, AT_ROLL, 0.1,
         SCHEME),
    Case("knife edge, + d sin(x + phi)/dt", WELL + sp.cos(x + z) * (x.d + z.d), KNIFE, AT_KNIFE,
         0.1, SCHEME),
    Case("particle on springs, + x^2 z'", SPRINGS + x**2 * z.d, ROLL, AT_ROLL, 0.1, SCHEME),
]  # fmt: skip


def back(system: dal.System, case: Case) -> float:
    """Return how far 100 steps of leapfrog forth and back, by the reversal, are from the start."""
    there = dal.integrate(
        system, "leapfrog", *case.start, h=case.h, steps=100, progress=False, check_h=False
    )
    signs = np.array(case.signs)
    here = dal.integrate(system, "leapfrog", signs * there.q[-1], -signs * there.v[-1], h=case.h,
                         steps=100, progress=False)  # fmt: skip
    return float(max(abs(signs * here.q[-1] - there.q[0]).max(),
                     abs(-signs * here.v[-1] - there.v[0]).max()))  # fmt: skip


def errors(system: dal.System, case: Case, scheme: str, h: float, t_end: float) -> Any:
    """Return t, E(t) - E(0) and seconds of cpu time a unit of t."""
    steps, cpu = int(t_end / h) // 16 * 16, time.process_time()
    with warnings.catch_warnings():  # that the energy has changed by much, which is the subject
        warnings.simplefilter("ignore", dal.DalembertWarning)
        found = dal.integrate(system, scheme, *case.start, h=h, steps=steps, stride=4,
                              progress=False)  # fmt: skip
    return found.t, found.energy - found.energy[0], (time.process_time() - cpu) / found.t[-1]


def rate(t: np.ndarray, error: np.ndarray) -> float:
    """Return |dE/dt| by a line through the errors, up to the first that is above 0.05."""
    until = np.argmax(abs(error) > 0.05) or len(error)
    return abs(float(np.polyfit(t[:until], error[:until], 1)[0]))


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    t_end = 2e3 if quick else 2e4
    rows, drawn, systems, drifting = [], {}, {}, {scheme: [] for scheme in SCHEMES}
    for case in CASES:
        system = systems[case.name] = dal.System.from_sympy(case.L, [case.constraint])
        off, grows, most, drift = back(system, case), [], [], []
        for scheme, factor in SCHEMES.items():
            t, error, _ = errors(system, case, scheme, factor * case.h, t_end)
            error = np.maximum.accumulate(abs(error))
            grows.append(error[-1] / error[len(error) // 16])
            most.append(error[-1])
            drift.append(grows[-1] > 4 or most[-1] > 0.25)
            if scheme == "leapfrog":
                drawn[case.name] = t, error, bool(case.why)
            if drift[-1]:
                drifting[scheme].append(case.name)
        # whether midpoint drifts too where leapfrog does is for the measurement to say
        as_expected = drift[0] and drift[2] if case.why else max(grows) < 1.5
        as_expected &= off > 1e-4 if case.why == SCHEME else off < 1e-8
        rows.append(common.holds(
            f"{case.name}; h = {case.h:.3g}, to t = {t_end:g}", case.why or "reversible: in a band",
            ", ".join(f"{s} {m:.1e} (x {g:.2g})" for s, m, g in zip(SCHEMES, most, grows))
            + f"; back to {off:.0e}", as_expected,
            "leapfrog and its composition grow 4 times or to 0.25" if case.why
            else "grow less than 1.5 times"))  # fmt: skip
    rows.append(common.holds(
        "no method performs well on all", "each drifts on some",
        ", ".join(f"{s} on {len(names)}" for s, names in drifting.items()) + f" of {len(CASES)}",
        all(drifting.values()), "each grows 4 times on one at least"))  # fmt: skip

    case = next(case for case in CASES if case.start is AT_CONTACT and case.why)
    most = {scheme: abs(errors(systems[case.name], case, scheme, N40, 4000 * N40)[1]).max()
            for scheme in SCHEMES}  # fmt: skip
    rows.append(common.holds(
        f"{case.name}; N = 40, 100 periods: max |E - E(0)|",
        "odelab: McLachlan 0.29, Spark 2 0.70, Spark 3 2.2e-3",
        ", ".join(f"{s} {e:.1e}" for s, e in most.items()), most["leapfrog"] > 0.1,
        "leapfrog, which is McLachlan's scheme without the term, above 0.1"))  # fmt: skip

    ends = [dal.integrate(systems["particle on springs" + term], "leapfrog-kl8", *AT_ROLL,
                          h=0.02, t_end=20, progress=False)
            for term in (", - d cos(z)/dt", "")]  # fmt: skip
    off = abs(ends[0].q[-1] - ends[1].q[-1]).max()
    rows.append(common.holds(
        "leave dS/dt out of L: particle on springs", "the same motion",
        f"kl8, h = 0.02, t = 20: off by {off:.0e}; in a band, see above", off < 1e-10,
        "below 1e-10"))  # fmt: skip
    ladder = [("leapfrog", 2, 0.1), ("midpoint", 2, 0.1), ("leapfrog-suzuki4", 4, 0.2),
              ("leapfrog-kl6", 6, 0.25), ("leapfrog-kl8", 8, 0.5)]  # fmt: skip
    for case in (CASES[-1], next(case for case in CASES if case.why == ORBIT)):
        for scheme, order, h in ladder[: 3 if quick else 5]:
            steps = (h, h / 2)
            wide, fine = (errors(systems[case.name], case, scheme, step, t_end) for step in steps)
            slopes = rate(*wide[:2]), rate(*fine[:2])
            rows.append(common.near(
                f"{case.name}: dE/dt of {scheme} like h^b, b", order,
                np.log2(slopes[0] / slopes[1]), 0.1 * order, digits=3, source="p",
                note="; ".join(
                    f"h = {step:g}: {slope:.1e} at {run[2] * 1e6:.2g} us a unit of t"
                    for step, slope, run in zip(steps, slopes, (wide, fine)))))  # fmt: skip
    return rows, drawn


def draw(drawn: Any) -> Any:
    """Draw the largest error so far of leapfrog."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained", sharey=True)
    for name, (t, error, drifts) in drawn.items():
        chosen = np.unique(np.geomspace(1, len(t) - 1, 200).astype(int))
        axes[int(drifts)].loglog(t[chosen], error[chosen], lw=1.2, label=name)
    for ax, title in zip(axes, ("in a band", "drifts")):
        ax.set(xlabel="t", title=f"leapfrog, {title}")
        ax.legend(fontsize=7)
    axes[0].set_ylabel("largest |E - E(0)| so far")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
