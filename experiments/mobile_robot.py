"""Discrete Lagrange-d'Alembert against Runge-Kutta: the energy of a robot and of a particle.

J. Cortes, S. Martinez: Non-holonomic integrators, Nonlinearity 14 (2001) 1365-1392,
doi:10.1088/0951-7715/14/5/322, section on examples (from memory of the paper: two pictures of the
energy, bounded for the discrete Lagrange-d'Alembert algorithm, decaying for the method of Runge
and Kutta of order 4).

Systems: the mobile robot, L = (x'^2 + y'^2 + phi'^2 + theta'^2)/2 - 10 sin(theta), x' = theta'
cos(phi), y' = theta' sin(phi), with h = 0.2 from q = 0, v = (1, 0, 0, 1) to t = 10, as in a test
of the program odelab of O. Verdier; the same turning, v = (1, 0, 1/2, 1); and the particle z' = y
x' with V = x^2 + y^2 (from memory; data of our own).

Their algorithm, with L_d = h L((q + q')/2, (q' - q)/h) and the constraint at (q + q')/2, is
`midpoint` of the library seen at its nodes; here it is also solved on nodes without the library,
to show that.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import common
import numpy as np
import robot_nodes
from scipy.integrate import solve_ivp

import dalembert as dal

H = 0.2
Field = Callable[[float, np.ndarray], np.ndarray]


def robot_rate(_: float, w: np.ndarray) -> np.ndarray:
    """Return the rates of (x, y, phi, theta, phi', theta'): 2 theta'' = -10 cos(theta)."""
    _, _, phi, theta, turn, roll = w
    return np.array([roll * np.cos(phi), roll * np.sin(phi), turn, roll, 0, -5 * np.cos(theta)])


def robot_energy(w: np.ndarray) -> np.ndarray:
    """Return the energy of the same."""
    return w[..., 5] ** 2 + w[..., 4] ** 2 / 2 + 10 * np.sin(w[..., 3])


def particle_rate(_: float, w: np.ndarray) -> np.ndarray:
    """Return the rates of (x, y, x', y'): z' = y x' eliminated."""
    x, y, vx, vy = w
    return np.array([vx, vy, -(2 * x + y * vx * vy) / (1 + y**2), -2 * y])


def particle_energy(w: np.ndarray) -> np.ndarray:
    """Return the energy of the same."""
    x, y, vx, vy = np.moveaxis(w, -1, 0)
    return ((1 + y**2) * vx**2 + vy**2) / 2 + x**2 + y**2


def runge_kutta(rate: Field, w: np.ndarray, steps: int) -> np.ndarray:
    """Return the states of the classical method of order 4."""
    states = [w]
    for _ in range(steps):
        one = rate(0, w)
        two = rate(0, w + H / 2 * one)
        three = rate(0, w + H / 2 * two)
        w = w + H / 6 * (one + 2 * two + 2 * three + rate(0, w + H * three))
        states.append(w)
    return np.array(states)


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    robot = dal.systems.robot()
    particle = dal.systems.particle_oscillator(k1=2, k2=2, k3=0)
    rows, curves = [], {}

    steps = 50
    found = dal.integrate(
        robot, "midpoint", *robot_nodes.START, h=H, steps=steps, check_h=False  # theirs
    )
    nodes = found.q + H / 2 * found.v  # q_k from the moved node and the velocity before it
    off = abs(nodes - robot_nodes.nodes(0.5, 0.5, H, steps)).max()
    rows.append(common.holds(
        "turning robot, t = 10: the algorithm on nodes, solved without the library",
        "the algorithm of the paper", f"midpoint is off by {off:.1e}", off < 1e-9,
        "below 1e-9: midpoint is the algorithm"))  # fmt: skip

    starts = {
        "robot": (robot, [0, 0, 0, 0], [1, 0, 0, 1], robot_rate, [0, 0, 0, 0, 0, 1],
                  robot_energy),
        "turning robot": (robot, [0, 0, 0, 0], [1, 0, 0.5, 1], robot_rate, [0, 0, 0, 0, 0.5, 1],
                          robot_energy),
        "particle": (particle, [1, 0, 0], [0.5, 1, 0], particle_rate, [1, 0, 0.5, 1],
                     particle_energy),
    }  # fmt: skip
    long = 200.0 if quick else 2000.0
    for name, (system, q0, v0, rate, w0, energy) in starts.items():
        w0 = np.array(w0, float)
        exact = solve_ivp(rate, (0, 10), w0, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        size = len(system.q0) if system is robot else 2
        end = dal.integrate(system, "reference", q0, v0, h=0.2, steps=50).q[-1, :size]
        rows.append(common.holds(
            f"{name}, t = 10: the exact motion", "independent: solve_ivp",
            f"reference is off by {abs(end - exact[:size]).max():.1e}",
            abs(end - exact[:size]).max() < 1e-9, "below 1e-9"))  # fmt: skip
        ours = dal.integrate(system, "midpoint", q0, v0, h=H, t_end=long, check_h=False)
        theirs = energy(runge_kutta(rate, w0, round(long / H)))
        bands = {"DLA (midpoint)": ours.energy - ours.energy[0], "RK4": theirs - theirs[0]}
        curves[name] = ours.t, bands
        spread = {}
        for method, error in bands.items():
            part = [abs(error[: len(error) // k + 1]).max() for k in (16, 4, 1)]
            spread[method] = part
            text = ", ".join(f"{x:.2e}" for x in part)
            if method == "RK4":
                claim, test, criterion = "decays", error[-1] < -3 * part[0], "lost 3 times as much"
            else:
                claim, test, criterion = "bounded", part[2] < 1.1 * part[0], "wider by below 10 %"
            rows.append(common.holds(
                f"{name}, {method}: max |E - E(0)| to t = {long / 16:g}, {long / 4:g}, {long:g}",
                claim, text, test, criterion))  # fmt: skip
        rows.append(common.holds(
            f"{name}, DLA: worst residual of D", "-", f"{ours.residual.max():.1e}",
            ours.residual.max() < 4 * system.n * 2.0**-53, "below 4 n u"))  # fmt: skip
    return rows, curves


def draw(data: Any) -> Any:
    """Draw the energies."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.2), layout="constrained")
    for ax, (name, (t, bands)) in zip(figure.subplots(1, 3), data.items()):
        for method, error in reversed(bands.items()):
            every = slice(None, None, max(1, len(t) // 2000))
            ax.plot(t[every], error[every], lw=0.6, label=method)
        ax.set(xlabel="t", title=f"{name}, h = 0.2: E - E(0)")
        ax.legend(fontsize="small")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
