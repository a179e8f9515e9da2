"""The vertical rolling disk: a variational integrator of another Lagrangian against ours.

O. E. Fernandez, A. M. Bloch, P. J. Olver: Variational integrators for Hamiltonizable nonholonomic
systems, J. Geom. Mech. 4 (2012), number 2, which sets variational integrators beside nonholonomic
ones (the abstract; its data could not be had), with the Lagrangian of O. E. Fernandez, A. M.
Bloch: Equivalence of the dynamics of nonholonomic and variational nonholonomic systems for certain
initial data, J. Phys. A 41 (2008) 344005 (from memory of the paper; checked here).

System: L = (m (x'^2 + y'^2) + I theta'^2 + J phi'^2)/2, x' = R theta' cos(phi), y' = R theta'
sin(phi). Without constraints, from data in D, the same motion is that of K = -m (x'^2 + y'^2)/2 +
m R theta' (x' cos(phi) + y' sin(phi)) + I theta'^2/2 + J phi'^2/2: x and y are cyclic, and their
momenta are the constraints. All constants 1, phi' = 2, theta' = 1, h = 0.1 to t = 1 and t = 1000,
h = 0.01 to t = 50: the data of a test of the program odelab, O. Verdier, with which the errors at
t = 1 were measured for the method of R. McLachlan and M. Perlmutter (J. Nonlinear Sci. 16 (2006)
283-328).

Here: `midpoint` of the library, the midpoint variational integrator of K on nodes without the
library, the exact circle, and the exact circle of the scheme: with both rates kept, chords of
length h R theta' at headings of the nodes, whose radius is (h phi'/2)/tan(h phi'/2) of the exact
one at moved nodes.
"""

from __future__ import annotations

from typing import Any

import common
import numpy as np
from scipy.optimize import fsolve

import dalembert as dal

TURN, ROLL = 2.0, 1.0  # phi', theta'; q = (x, y, theta, phi)
Q0, V0 = np.zeros(4), np.array([ROLL, 0.0, ROLL, TURN])
U = 2.0**-53


def exact(t: np.ndarray) -> np.ndarray:
    """Return q at the times t."""
    rho = ROLL / TURN
    return np.stack([rho * np.sin(TURN * t), rho * (1 - np.cos(TURN * t)), ROLL * t, TURN * t], -1)


def variational(h: float, steps: int) -> np.ndarray:
    """Return nodes by the discrete Euler-Lagrange equations of K((q + q')/2, (q' - q)/h)."""

    def slopes(q: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phi, (x, y, theta, turn) = (q[3] + r[3]) / 2, (r - q) / h
        c, s = np.cos(phi), np.sin(phi)
        by_q = np.array([0, 0, 0, theta * (y * c - x * s)])
        return by_q, np.array([theta * c - x, theta * s - y, theta + x * c + y * s, turn])

    before, now = Q0 - h / 2 * V0, Q0 + h / 2 * V0
    nodes = [before, now]
    for _ in range(steps):
        by_q, by_v = slopes(before, now)
        momentum = by_v + h / 2 * by_q

        def balance(r: np.ndarray, q: np.ndarray = now, p: np.ndarray = momentum) -> np.ndarray:
            by_q, by_v = slopes(q, r)
            return by_v - h / 2 * by_q - p

        before, now = now, fsolve(balance, 2 * now - before, xtol=1e-11)
        nodes.append(now)
    return np.array(nodes)


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    disk = dal.systems.disk(m=1, I=1, J=1, R=1)
    rows = []

    def go(scheme: str, h: float, t_end: float) -> dal.Solution:
        return dal.integrate(disk, scheme, Q0, V0, h=h, t_end=t_end)

    for h, measured in ((0.1, 2.36e-3), (0.05, 5.90e-4)):
        off = abs(go("midpoint", h, 1.0).q[-1] - exact(np.array(1.0))).max()
        rows.append(common.near(
            f"error of q at t = 1, h = {h:g}", measured, off, 0.01 * measured, digits=3,
            source="McLachlan-Perlmutter in odelab"))  # fmt: skip
    steps = 200 if quick else 1000
    found = go("midpoint", 0.1, steps * 0.1)
    nodes = variational(0.1, steps)
    middles, chords = (nodes[1:] + nodes[:-1]) / 2, np.diff(nodes, axis=0) / 0.1
    rows.append(common.holds(
        f"variational integrator of K, h = 0.1, {steps} steps: |x' - theta' cos(phi)| and of y",
        "the momenta are the constraints, kept", f"{abs(disk.residual(middles, chords)).max():.1e}",
        abs(disk.residual(middles, chords)).max() < 1e-9, "below 1e-9"))  # fmt: skip
    gap = max(abs(found.q - middles).max(), abs(found.v - chords).max())
    rows.append(common.holds(
        "the same against midpoint of the library: state", "the same motion",
        f"off by {gap:.1e}", gap < 1e-8, "below 1e-8: the two integrators are one"))  # fmt: skip

    for h, t_end in ((0.01, 50.0), (0.1, 1000.0)):
        found = go("midpoint", h, t_end)
        # the moved nodes lie on a circle around (0, rho'), where the exact ones have (0, rho)
        rho = ROLL / TURN * (h * TURN / 2) / np.tan(h * TURN / 2)
        radius = np.hypot(found.q[:, 0], found.q[:, 1] - rho)
        far = radius[np.argmax(abs(radius - rho))]
        rows.append(common.near(
            f"h = {h:g}, to t = {t_end:g}: distance from (0, rho'), where it is farthest from rho'",
            rho, far, 1e-9, digits=10, source="closed form"))  # fmt: skip
        rates = abs(found.v[:, 2:] - [ROLL, TURN]).max()
        rows.append(common.holds(
            f"h = {h:g}, to t = {t_end:g}: theta', phi', E", "constant",
            f"rates change by {rates:.1e}, E by {abs(found.energy - found.energy[0]).max():.1e}",
            max(rates, abs(found.energy - found.energy[0]).max()) < 1e-12,
            "below 1e-12"))  # fmt: skip
    worst = abs(go("explicit", 0.1, 50.0).energy - 3.0).max()
    rows.append(common.holds(
        "explicit, h = 0.1, to t = 50: energy lost, of 3", "-", f"{worst:.2f}", worst > 0.5,
        "above 0.5"))  # fmt: skip
    return rows, {s: go(s, 0.1, 6.3) for s in ("midpoint", "explicit")}


def draw(data: Any) -> Any:
    """Draw the paths."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6, 3.6), layout="constrained")
    ax = figure.subplots()
    path = exact(np.linspace(0, np.pi, 200))
    ax.plot(path[:, 0], path[:, 1], "k", lw=0.7, label="exact")
    for (name, run), marker in zip(data.items(), "o^"):
        ax.plot(run.q[:, 0], run.q[:, 1], marker, ms=3, label=f"{name}, h = 0.1")
    ax.set(aspect="equal", xlabel="x", ylabel="y")
    ax.legend(fontsize="small")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
