"""Draws the pictures of these pages beside them: `./dev shell python docs/explanation/pictures.py`.

    python pictures.py            all of them
    python pictures.py order-lost only that one
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import sympy as sp
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

import dalembert as dal

BLUE, ORANGE, GREEN, PURPLE = dal.plot.COLOURS[:4]
GREY = "0.5"


def d_and_d_eps() -> Figure:
    """Draw the residuals of D and of D_eps, at moved and at kept nodes."""
    system, h = dal.systems.particle_oscillator(), 0.1
    figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.0), sharey=True, layout="constrained")
    for ax, (scheme, start, title) in zip(
        axes, (("midpoint", None, "moved nodes"), ("midpoint-nodes", "shift", "kept nodes"))
    ):
        run = dal.integrate(system, scheme, h=h, t_end=60, initial=start)
        for shift, colour, name in (
            (0.0, BLUE, r"$\mathbf{D}$:  $\mu(q)\,v$"),
            (h / 2, ORANGE, r"$\mathbf{D}_\varepsilon$:  $\mu(q - \frac{h}{2} v)\,v$"),
        ):
            size = abs(system.residual(run.q, run.v, shift))[:, 0]
            kept = size.max() < 1e-13
            ax.semilogy(run.t, np.maximum(size, 1e-17), ".", color=colour, markersize=2)
            ax.text(30, 1e-14 if kept else 1e-6, name, color=colour, ha="center")
        ax.set_title(title)
        ax.set_xlabel("t")
    axes[0].set_ylabel("size of the constraint")
    return figure


def order_lost() -> Figure:
    """Draw the errors of the sleigh at t = 1 for nodes and starts."""
    sleigh = dal.systems.sleigh()
    exact = np.concatenate(sleigh.exact(1.0))
    counts = np.array([8, 12, 16, 24, 32, 48, 64, 96, 128])
    figure, ax = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for name, scheme, start, back, style in (
        ("kept nodes, from D", "midpoint-nodes", "D", 0.0, {"color": ORANGE, "marker": "s"}),
        ("kept nodes, projected", "midpoint-nodes", "project", 0.0,
         {"color": PURPLE, "marker": "+", "linestyle": ":"}),
        ("kept nodes, shifted", "midpoint-nodes", "shift", 0.0, {"color": GREEN, "marker": "^"}),
        ("the same, at $q - hv/2$", "midpoint-nodes", "shift", 0.5,
         {"color": GREEN, "marker": "x", "linestyle": ":"}),
        ("moved nodes", "midpoint", None, 0.0, {"color": BLUE, "marker": "o"}),
    ):  # fmt: skip
        errors = []
        for count in counts:
            run = dal.integrate(sleigh, scheme, h=1 / count, steps=int(count), initial=start)
            end = np.concatenate([run.q[-1] - back / count * run.v[-1], run.v[-1]])
            errors.append(abs(end - exact).max())
        ax.loglog(1 / counts, errors, label=name, markerfacecolor="none", **style)
    for slope, at, size in ((1, 0.03, 8e-4), (2, 0.03, 3e-6)):
        x = np.array([at, 2 * at])
        ax.loglog(x, size * (x / at) ** slope, color=GREY, linewidth=0.8)
        ax.annotate(f"slope {slope}", (1.4 * at, size * 1.4**slope), (0, -12),
                    textcoords="offset points", color="0.3", fontsize="small")  # fmt: skip
    ax.set_xlabel("h")
    ax.set_ylabel("error of (q, v) at t = 1")
    ax.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def conservation() -> Figure:
    """Draw the largest error of the energy so far: a band, a walk, and a drift."""
    x, y, z = dal.coordinates("x y z")
    springs = (x.d**2 + y.d**2 + z.d**2 - x**2 - 2 * y**2 - sp.Rational(3, 2) * z**2) / 2
    given = dal.systems.particle_oscillator()
    gyroscopic = dal.System.from_sympy(
        springs + x**2 * z.d, [z.d - y * x.d], q0=given.q0, v0=given.v0
    )
    figure, ax = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
    for name, system, h, t_end, colour in (
        ("with a gyroscopic term, h = 0.1: drift", gyroscopic, 0.1, 2600.0, ORANGE),
        ("chaotic, h = 0.2: walk", dal.systems.chaotic(), 0.2, 200_000.0, GREEN),
        ("springs, h = 0.1: band", given, 0.1, 200_000.0, BLUE),
    ):
        run = dal.integrate(system, "leapfrog", h=h, t_end=t_end, stride=5)
        error = np.maximum.accumulate(abs(run.energy - run.energy[0])) / run.energy[0]
        few = np.unique(np.geomspace(1, len(error) - 1, 300).astype(int))
        ax.loglog(run.t[few], error[few], color=colour, label=name)
    ax.set_xlabel("t")
    ax.set_ylabel("largest |E/E(0) - 1| so far")
    ax.legend(frameon=False)
    return figure


def not_vakonomic() -> Figure:
    """Draw paths from one start by d'Alembert's principle and by the stationary action."""
    particle, t_end = dal.systems.particle(), 8.0

    def vakonomic(t: float, state: np.ndarray) -> list[float]:
        _, y, _, a, b, c, kappa = state
        rate = -(a * b + kappa * y * b) / (1 + y**2)
        return [a, b, c, rate * y + kappa * b, -kappa * a, -rate, rate]

    figure, ax = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for kappa, style in ((1.0, "-."), (0.0, "--"), (-particle.v0[2], ":")):
        found = solve_ivp(vakonomic, (0, t_end), [*particle.q0, *particle.v0, kappa], "DOP853",
                          rtol=1e-10, atol=1e-10, max_step=0.05)  # fmt: skip
        label = rf"vakonomic, $\kappa(0)$ = {kappa:g}" + (", or substituted" if kappa < 0 else "")
        ax.plot(*found.y[:2], style, color=ORANGE, label=label)
    run = dal.integrate(particle, "leapfrog-kl8", h=0.05, t_end=t_end)
    ax.plot(run.q[:, 0], run.q[:, 1], color=BLUE, linewidth=2, label="nonholonomic")
    ax.plot(*particle.q0[:2], "ko", label="start")
    ax.set_xlabel("x")
    ax.set_ylabel("y")
    ax.legend(frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


PICTURES: dict[str, Callable[[], Figure]] = {
    draw.__name__.replace("_", "-"): draw
    for draw in (d_and_d_eps, order_lost, conservation, not_vakonomic)
}

if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        file = Path(__file__).with_name(f"{name}.png")
        PICTURES[name]().savefig(file, dpi=100, metadata={"Software": None})
