"""L_d and D_d by different finite difference maps: order and energy.

arXiv:1605.02666, of which only the abstract is known here: the discrete Lagrangian and the
discrete constraint may be made by two finite difference maps; whether or not they are the same,
the order is the same, and in the examples the energy of the choice that is not consistent behaves
better.

Systems of our own, as those of the paper are not known here: the mobile robot, the particle on
springs and the contact oscillator. Maps: rho^beta_L for L_d, rho^beta_D for D_d, `Scheme.pair` of
the library; consistent are beta_L = beta_D.

Here: the orders, and the band of the energy, h = 0.05; for the robot also the discrete equations
solved on nodes without the library.
"""

from __future__ import annotations

from typing import Any

import common
import numpy as np
import robot_nodes

import dalembert as dal

H = 0.05
NARROWEST = dict.fromkeys(
    ("springs", "contact oscillator"), "here the consistent maps have the narrowest band"
)


def order(system: dal.System, pair: tuple[float, float]) -> float:
    """Return the order of the state at t = 1."""
    steps = np.array([20, 40, 80, 160])
    end = dal.integrate(system, "reference", h=1.0, steps=1)
    errors = []
    for n in steps:
        run = dal.integrate(system, dal.Scheme.pair(*pair), h=1 / n, steps=n)
        errors.append(max(abs(run.q[-1] - end.q[-1]).max(), abs(run.v[-1] - end.v[-1]).max()))
    return common.slope(1 / steps, errors)


def bands(system: dal.System, pair: tuple[float, float], t_end: float) -> tuple[float, float]:
    """Return the range of the energy to t_end/16 and to t_end."""
    run = dal.integrate(system, dal.Scheme.pair(*pair), h=H, t_end=t_end)
    return float(np.ptp(run.energy[: len(run.t) // 16])), float(np.ptp(run.energy))


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    systems = {"robot": dal.systems.robot(), "springs": dal.systems.particle_oscillator(),
               "contact oscillator": dal.systems.contact_oscillator()}  # fmt: skip
    rows, curves = [], {}
    for pair in ((0.25, 0.5), (0.0, 1.0)):
        found = dal.integrate(systems["robot"], dal.Scheme.pair(*pair), *robot_nodes.START, h=H,
                              steps=100)  # fmt: skip
        nodes = found.q + (1 - pair[1]) * H * found.v
        off = abs(nodes - robot_nodes.nodes(*pair, H, 100)).max()
        rows.append(common.holds(
            f"robot, maps {pair}: 100 steps on nodes", "independent: the equations on nodes",
            f"off by {off:.1e}", off < 1e-9, "below 1e-9"))  # fmt: skip

    t_end = 800.0 if quick else 8000.0
    for name, system in systems.items():
        for beta_D, expected in ((0.5, 2), (0.0, 1)):
            orders = [order(system, (beta_L, beta_D)) for beta_L in (beta_D, 0.25, 1.0)]
            rows.append(common.holds(
                f"{name}, beta_D = {beta_D:g}: orders for beta_L = {beta_D:g}, 1/4, 1", "the same",
                ", ".join(f"{p:.2f}" for p in orders), max(abs(p - expected) for p in orders) < 0.1,
                f"all {expected} to 0.1"))  # fmt: skip
        (_, wide), (early, narrow) = (bands(system, (0.0, beta), t_end) for beta in (0.0, 0.5))
        rows.append(common.holds(
            f"{name}, beta_L = 0: range of E, beta_D = 0 and beta_D = 1/2", "the second is better",
            f"{wide:.1e} and {narrow:.1e}", narrow < 0.1 * wide and narrow < 1.1 * early,
            "at least 10 times narrower, and a band"))  # fmt: skip
        betas = np.linspace(0, 1, 11 if quick else 21)
        widths = [bands(system, (beta, 0.5), t_end) for beta in betas]
        curves[name] = betas, np.array(widths)[:, 1]
        same = widths[len(betas) // 2][1]
        best = int(np.argmin([w for _, w in widths]))
        rows.append(common.holds(
            f"{name}, beta_D = 1/2: range of E with beta_L = 1/2, and with the best beta_L",
            "the second is better",
            f"{same:.2e}, and {widths[best][1]:.2e} with beta_L = {betas[best]:.2g}",
            widths[best][1] < same, "narrower", differs=NARROWEST.get(name, "")))  # fmt: skip
    return rows, curves


def draw(data: Any) -> Any:
    """Draw the range of the energy over beta_L."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 3.4), layout="constrained")
    ax = figure.subplots()
    for (name, (betas, widths)), marker in zip(data.items(), "osd"):
        ax.semilogy(betas, widths / widths[len(betas) // 2], marker=marker, ms=4, lw=1, label=name)
    ax.axhline(1.0, color="0.6", lw=0.7)
    ax.set(xlabel="beta_L, with beta_D = 1/2", ylabel="range of E / that of beta_L = 1/2")
    ax.legend(fontsize="small")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
