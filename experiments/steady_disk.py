"""A disk that rolls in a steady circle.

C. Le Saux, R. I. Leine, C. Glocker: Dynamics of a rolling disk in the presence of dry friction, J.
Nonlinear Sci. 15 (2005) 27-61, doi:10.1007/s00332-004-0655-4, section 5.

System: a thin disk of mass m = 0.3048 and radius r = 0.05, g = 9.81, inertia m r^2/4 and m r^2/2,
which rolls without slip; the contact runs on a circle of radius R = 10 r, the lean is beta = 5
degrees (these values as in an example of the program cardillo, which follows the paper). Printed
are equations: with rho = r/R (5.10) the spin is alpha' = -rho gamma' (5.11) and gamma'^2 = 4 (g/r)
sin(beta)/((6 - 5 rho sin(beta)) rho cos(beta)) (5.12); their values stand in the table.

Here: the spin for which the lean stays, found from accelerations of the library and from Newton
and Euler; the circle, its period and its closing from runs; a perturbed circle against an
independent solution; the speed above which upright rolling is stable, gamma'^2 = g/(3 r), which is
a result of the textbooks (for example Neimark and Fufaev 1972).
"""

from __future__ import annotations

from typing import Any

import common
import newton_euler
import numpy as np
from scipy.optimize import brentq

import dalembert as dal

M, R, G, BETA, CIRCLE = 0.3048, 0.05, 9.81, np.deg2rad(5), 0.5
RHO = R / CIRCLE
SPIN = np.sqrt(4 * (G / R) * np.sin(BETA) / ((6 - 5 * RHO * np.sin(BETA)) * RHO * np.cos(BETA)))
PERIOD = 2 * np.pi / (RHO * SPIN)
PARTS = {"m": M, "r": R, "A": M * R**2 / 4, "C": M * R**2 / 2, "g": G}
Q0 = np.array([0.0, CIRCLE - R * np.sin(BETA), 0.0, BETA, 0.0])


def state(q: np.ndarray, rates: tuple[float, float, float]) -> np.ndarray:
    """Return v in D for rates of yaw, lean and spin."""
    alpha, beta = q[2], q[3]
    omega = rates[2] + rates[0] * np.sin(beta)
    across = R * rates[1] * np.cos(beta)
    return np.array([R * omega * np.cos(alpha) + across * np.sin(alpha),
                     R * omega * np.sin(alpha) - across * np.cos(alpha), *rates])  # fmt: skip


def critical(disc: dal.System) -> float:
    """Return the square of the spin at which upright rolling straight on becomes stable.

    With small lean and yaw beta'' = a beta + b alpha', alpha'' = c beta', so that
    beta'' = (a + b c) beta + const.
    """

    def stiffness(spin: float) -> float:
        def acceleration(beta: float, yaw: float, lean: float) -> np.ndarray:
            q = np.array([0, 0, 0, beta, 0])
            return disc.acceleration(q, state(q, (yaw, lean, spin)))

        small = 1e-4
        a = (acceleration(small, 0, 0) - acceleration(-small, 0, 0))[3] / (2 * small)
        b = (acceleration(0, small, 0) - acceleration(0, -small, 0))[3] / (2 * small)
        c = (acceleration(0, 0, small) - acceleration(0, 0, -small))[2] / (2 * small)
        return a + b * c

    return brentq(stiffness, 1.0, 50.0) ** 2


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    disc, other = dal.systems.rolling_disc(**PARTS), newton_euler.Disk(**PARTS)

    def falls(spin: float) -> float:
        return disc.acceleration(Q0, state(Q0, (-RHO * spin, 0, spin)))[3]

    def falls_too(spin: float) -> float:
        # the axis n keeps its height: d/dt of up . (omega x n) = up . (omega' x n + omega x n')
        v = state(Q0, (-RHO * spin, 0, spin))
        turn, body = newton_euler.attitude(*Q0[2:]), newton_euler.body_rate(Q0, v)
        n, omega = turn[:, 2], turn @ body
        rate = other.forces(turn, body)[0]
        return (np.cross(rate, n) + np.cross(omega, np.cross(omega, n)))[2]

    rows = [
        common.near("gamma', where the lean stays: (5.12)", SPIN, brentq(falls, 1, 100), 1e-10,
                    digits=12),
        common.near("the same by Newton and Euler", SPIN, brentq(falls_too, 1, 100), 1e-10,
                    digits=12),
    ]  # fmt: skip
    v0 = state(Q0, (-RHO * SPIN, 0, SPIN))

    def around(t: float, q: np.ndarray, v: np.ndarray) -> float:
        return q[2] + 2 * np.pi

    steps = 400
    runs = {}
    for scheme, within in (("leapfrog", 1e-3), ("midpoint", 1e-3), ("midpoint-kl8", 1e-11)):
        circle = dal.integrate(disc, scheme, Q0, v0, h=PERIOD / steps, steps=steps)
        longer = dal.integrate(disc, scheme, Q0, v0, h=PERIOD / steps, steps=steps + 10,
                               events=[around])  # fmt: skip
        if scheme == "midpoint-kl8":
            rows.append(
                common.near("alpha': (5.11)", -RHO * SPIN, circle.v[:, 2].mean(), 1e-10, digits=12)
            )
            rows.append(
                common.near(
                    "period, 2 pi/|alpha'|", PERIOD, longer.t_events[0][0], 1e-10, digits=12
                )
            )
            radius = np.hypot(circle.q[:, 0], circle.q[:, 1])
            rows.append(
                common.near(
                    "radius of the circle of the centre, R - r sin(beta)",
                    CIRCLE - R * np.sin(BETA),
                    radius.mean(),
                    1e-11,
                    digits=12,
                )
            )
        gap = np.hypot(*(circle.q[-1] - circle.q[0])[:2])
        rows.append(
            common.holds(
                f"{scheme}, {steps} steps a turn: the circle closes",
                "closed",
                f"open by {gap:.1e}",
                gap < within,
                f"below {within:.0e} (order of the scheme)",
            )
        )
        runs[scheme] = circle  # fmt: skip

    orders = []
    for n in (200, 400, 800):
        circle = dal.integrate(disc, "midpoint", Q0, v0, h=PERIOD / n, steps=n)
        orders.append(np.hypot(*(circle.q[-1] - circle.q[0])[:2]))
    rows.append(common.near("midpoint: order of the gap, 200 to 800 steps", 2,
                            np.log2(orders[0] / orders[2]) / 2, 0.1, digits=3))  # fmt: skip

    # Perturbed: the lean swings, and the circle is a rosette
    v1, t_end = state(Q0, (-RHO * SPIN, 0.5, SPIN)), 2.0 if quick else 3 * PERIOD
    n = round(t_end / 0.01)
    t = np.linspace(0, t_end, n + 1)
    found = dal.integrate(disc, "midpoint-kl8", Q0, v1, h=t_end / n, steps=n)
    place = np.array([*Q0[:2], R * np.cos(BETA)])
    turn, body = newton_euler.attitude(*Q0[2:]), newton_euler.body_rate(Q0, v1)
    places, turns, _ = other.solve(place, turn, body, t)
    ours = np.column_stack([found.q[:, :2], R * np.cos(found.q[:, 3])])
    off = max(abs(ours - places).max(),
              abs(newton_euler.attitude(*found.q[:, 2:].T) - turns).max())  # fmt: skip
    rows.append(common.holds(
        f"perturbed, beta' = 0.5, to t = {t_end:.3g}: place and attitude",
        "independent: Newton and Euler",
        f"off by {off:.1e}", off < 1e-8, "below 1e-8"))  # fmt: skip
    lean = np.rad2deg(found.q[:, 3])
    rows.append(common.holds(
        "the same: the lean", "-", f"between {lean.min():.3f} and {lean.max():.3f} degrees",
        0 < lean.min() and lean.max() < 15, "stays between 0 and 15 degrees"))  # fmt: skip
    rows.append(common.near(
        "upright rolling is stable above gamma'^2 = g/(3 r)", G / (3 * R), critical(disc), 1e-4,
        digits=8, source="textbooks"))  # fmt: skip
    return rows, (runs["midpoint-kl8"], found)


def draw(data: Any) -> Any:
    """Draw the circle, the perturbed one, and the lean."""
    from matplotlib.figure import Figure

    circle, found = data
    figure = Figure(figsize=(8, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(found.q[:, 0], found.q[:, 1], lw=0.9, label="beta' = 0.5 at the start")
    left.plot(circle.q[:, 0], circle.q[:, 1], lw=1.2, label="steady")
    left.set(aspect="equal", xlabel="x of the centre (m)", ylabel="y (m)")
    right.plot(found.t, np.rad2deg(found.q[:, 3]), lw=0.9)
    right.plot(circle.t, np.rad2deg(circle.q[:, 3]), lw=1.2)
    right.set(xlabel="t (s)", ylabel="lean (degrees)")
    left.legend(fontsize="small", loc="center")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
