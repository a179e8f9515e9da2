"""The gaits of the snakeboard: drive, rotate and park.

A. M. Bloch, P. S. Krishnaprasad, J. E. Marsden, R. M. Murray: Nonholonomic mechanical systems with
symmetry, Arch. Ration. Mech. Anal. 136 (1996) 21-99, after A. Lewis, J. Ostrowski, R. Murray, J.
Burdick: Nonholonomic mechanics and locomotion, the snakeboard example, IEEE Int. Conf. Robot.
Autom. (1994); also told by J. E. Marsden, in Mechanics, Dynamics, and Symmetry.

System: a board (m, r) whose rider turns the rotor (J0) by psi(t) and both axles by phi(t) and
-phi(t), sines of the time. Printed are three pictures, and words: with equal frequencies the board
drives; with a rotor twice as fast as the axles it "essentially rotates in place"; with 3 : 2 it
parks, sideways. The parameters of the pictures could not be had; those here are our own, m = 6, r
= 0.2, J0 = 0.1, amplitudes 1 and 0.5 times a scale s.

Here: how far each gait goes, and how the net motion of a cycle grows with s. By the symmetries of
the equations x is odd in both amplitudes, theta is odd in that of the rotor and even in that of
the axles, and y the other way round; the leading powers of the three gaits are s^2, s^3 and s^5.
Each is compared with solve_ivp on the reduced equation, in which u is the speed, k = tan(phi)/r
and theta' = u k: (m + m r^2 k^2) u' + m r^2 k k' u + J0 k psi'' = 0.
"""

from __future__ import annotations

from typing import Any

import common
import numpy as np
import sympy
from scipy.integrate import solve_ivp

import dalembert as dal

M, R, J0, ROTOR, AXLES = 6.0, 0.2, 0.1, 1.0, 0.5
GAITS = {"drive": (1, 1), "rotate": (2, 1), "park": (3, 2)}
STEPS, CYCLES = 400, 6
# net motions of a cycle: what, its index, its leading power of s
MOTIONS = {"drive": (("x", 0, 2), ("theta", 2, 3)), "rotate": (("theta", 2, 3),),
           "park": (("y", 1, 5),)}  # fmt: skip


def board() -> dal.System:
    """Return the board with prescribed angles, as in examples/snakeboard_gait.py."""
    t, (x, y, theta) = dal.time, dal.coordinates("x y theta")
    rotor, axles, fast, slow = sympy.symbols("rotor axles fast slow")
    psi, phi = rotor * sympy.sin(fast * t), axles * sympy.sin(slow * t)
    inner = sympy.Float(M * R**2 - J0)
    turning = R * sympy.cos(phi) * theta.d
    return dal.System.from_sympy(
        L=M * (x.d**2 + y.d**2) / 2 + inner * theta.d**2 / 2
        + J0 * (theta.d + psi.diff(t)) ** 2 / 2,
        constraints=[sympy.sin(theta + phi) * x.d - sympy.cos(theta + phi) * y.d - turning,
                     sympy.sin(theta - phi) * x.d - sympy.cos(theta - phi) * y.d + turning],
        coordinates=[x, y, theta],
        parameters={rotor: ROTOR, axles: AXLES, fast: 1.0, slow: 1.0},
        name="board",
    )  # fmt: skip


def reduced(fast: float, slow: float, scale: float, t: np.ndarray) -> np.ndarray:
    """Return (x, y, theta) at the times t."""

    def rate(t: float, state: np.ndarray) -> list[float]:
        u, _, _, theta = state
        phi, dphi = scale * AXLES * np.sin(slow * t), scale * AXLES * slow * np.cos(slow * t)
        k, dk = np.tan(phi) / R, dphi / (R * np.cos(phi) ** 2)
        twist = -scale * ROTOR * fast**2 * np.sin(fast * t)
        du = -(M * R**2 * k * dk * u + J0 * k * twist) / (M + M * R**2 * k**2)
        return [du, u * np.cos(theta), u * np.sin(theta), u * k]

    start = np.zeros(4)
    return solve_ivp(rate, (t[0], t[-1]), start, "DOP853", t, rtol=1e-12, atol=1e-14).y[1:].T


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    made, rows, paths = board(), [], {}
    period = 2 * np.pi
    scales = np.array([0.1, 0.2]) if quick else np.array([0.05, 0.1, 0.2, 0.4])
    for name, (fast, slow) in GAITS.items():
        gait = made.with_parameters(fast=fast, slow=slow)

        def go(scale: float, cycles: int, gait: dal.System = gait) -> dal.Solution:
            moving = gait.with_parameters(rotor=scale * ROTOR, axles=scale * AXLES)
            return dal.integrate(moving, "leapfrog-kl6", [0, 0, 0], [0, 0, 0], h=period / STEPS,
                                 steps=STEPS * cycles)  # fmt: skip

        found = paths[name] = go(1.0, CYCLES)
        exact = reduced(fast, slow, 1.0, found.t)
        off = abs(found.q - exact).max()
        rows.append(common.holds(
            f"{name} {fast}:{slow}, {CYCLES} cycles from rest", "independent: solve_ivp",
            f"off by {off:.1e}", off < 1e-9, "below 1e-9"))  # fmt: skip
        x, y, theta = found.q[-1]
        here = f"x {x:+.4f} m, y {y:+.4f} m, theta {theta:+.4f}"
        if name == "drive":
            each = np.diff(found.q[::STEPS, 0])
            rows.append(common.holds(
                "drive: net motion", "drives, as riders do from rest", here,
                abs(x) > 20 * abs(y) and (np.diff(abs(each[:4])) > 0).all(),
                "|x| above 20 |y|, each of the first four cycles goes farther"))  # fmt: skip
        elif name == "rotate":
            far = np.hypot(*found.q[:, :2].T).max()
            rows.append(
                common.holds(
                    "rotate: net motion",
                    "rotates in place",
                    f"{here}; at most {far:.3f} m away",
                    abs(theta) > np.pi and far < R,
                    "more than half a turn, never farther than r",
                )
            )
        else:
            rest = max(abs(x), abs(theta))
            rows.append(common.holds(
                "park: net motion", "sideways", here, abs(y) > 0.5 and rest < 1e-9,
                "|y| above 0.5 m; x and theta below 1e-9"))  # fmt: skip
        ends = np.array([abs(go(s, 1).q[-1]) for s in scales])
        for what, index, power in MOTIONS[name]:
            slope = common.slope(scales, ends[:, index])
            rows.append(common.holds(
                f"{name}: power of the amplitudes in {what} of one cycle", "-", f"{slope:.3f}",
                abs(slope - power) < 0.25, f"{power} by the symmetries, to 0.25"))  # fmt: skip
        rows.append(common.holds(
            f"{name}: worst residual of D", "-", f"{found.residual.max():.1e}",
            found.residual.max() < 4 * 3 * 2.0**-53, "below 4 n u"))  # fmt: skip
    return rows, paths


def draw(data: Any) -> Any:
    """Draw the paths of the middle of the board."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.4), layout="constrained")
    for ax, (name, run) in zip(figure.subplots(1, 3), data.items()):
        fast, slow = GAITS[name]
        ax.plot(run.q[:, 0], run.q[:, 1], lw=0.9)
        ax.plot(*run.q[::STEPS, :2].T, "o", ms=3, color="C1")
        for x, y, theta in run.q[:: STEPS // 2]:
            size = 0.1 if name == "drive" else 0.02
            dx, dy = size * np.cos(theta), size * np.sin(theta)
            ax.plot([x - dx, x + dx], [y - dy, y + dy], lw=0.8, color="0.5")
        ax.set(title=f"{name}, {fast}:{slow}, {CYCLES} cycles", xlabel="x (m)", ylabel="y (m)")
        if name != "drive":
            ax.set_aspect("equal", adjustable="datalim")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
