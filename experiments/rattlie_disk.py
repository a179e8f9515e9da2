"""A rolling disk in RATTLie's coordinates: convergence of q, v and the multipliers.

S. Hante, M. Arnold: RATTLie, a variational Lie group integration scheme for constrained mechanical
systems, J. Comput. Appl. Math. 387 (2021) 112492, and the programs RATTLie_nonhol and rolling_disk
of S. Hante (github.com/StHante), from which the data are: the files config.lua and diss_conf.lua.

System: a disk m = 15, r = 1, J = m (1/4, 1/4, 1/2), g = 9.81, with the body's angular velocity (0,
15, 5) at the start, upright with its centre at (0, 0, 1) (config.lua), or leaning by 15 degrees
(diss_conf.lua); t_end = 2, 2 * 2^8 to 2 * 2^21 steps, states compared at multiples of 1/128 with
the run of most steps: max over t of |error|/sqrt(number of components) of q (quaternion and
place), of v (angular and linear velocity in the body), of the holonomic multiplier l and the two
nonholonomic ones lnh. The scheme is claimed to have order 2 in all of them (from memory of the
paper; the programs print no numbers).

Here: yaw alpha, lean beta and spin gamma instead of quaternions; at the start alpha = 0, beta = 0
or 15 degrees, gamma = 0, alpha' cos(beta) = 15, beta' = 0, gamma' + alpha' sin(beta) = 5. They are
singular where the disk lies flat, which the motion does not come near. From them q and v of
RATTLie are computed. Its multipliers are the force of the ground divided by minus the height of
the centre: lnh the horizontal components, l the vertical one; the horizontal force is lambda of
the library. RATTLie itself is written out again in rattlie.py. Errors are those against Newton and
Euler with a rotation matrix, not against the own finest run.
"""

from __future__ import annotations

from typing import Any

import common
import newton_euler
import numpy as np
import rattlie
from scipy.spatial.transform import Rotation

import dalembert as dal

PARTS = {"m": 15.0, "r": 1.0, "A": 15 / 4, "C": 15 / 2, "g": 9.81}
SCHEMES = {"RATTLie": 2, "midpoint": 2, "leapfrog": 2, "midpoint-suzuki4": 4}
NAMES = ("q", "v", "l", "lnh")
T_END, EVERY = 2.0, 1 / 128


def start(lean: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (q, v) of the library for RATTLie's data."""
    yaw = 15 / np.cos(lean)
    v = [5.0, 0, yaw, 0, 5 - yaw * np.sin(lean)]  # x' = r (gamma' + alpha' sin(beta))
    return np.array([0, 0, 0, lean, 0]), np.array(v)


def quantities(places: np.ndarray, turns: np.ndarray, bodies: np.ndarray,
               forces: np.ndarray) -> list[np.ndarray]:  # fmt: skip
    """Return q, v, l, lnh of RATTLie, one row for each time."""
    p = Rotation.from_matrix(turns).as_quat(canonical=True)
    disk = newton_euler.Disk(**PARTS)
    speeds = [turn.T @ np.cross(turn @ body, disk.to_centre(turn))
              for turn, body in zip(turns, bodies)]  # fmt: skip
    scaled = -forces / places[:, 2:]
    return [np.hstack([p, places]), np.hstack([bodies, speeds]), scaled[:, 2:], scaled[:, :2]]


def of_library(disc: dal.System, run: dal.Solution) -> list[np.ndarray]:
    """Return the same of a run of the library."""
    q, v = run.q, run.v
    beta, height = q[:, 3], PARTS["r"] * np.cos(q[:, 3])
    # the vertical force from z = r cos(beta)
    lean2 = np.array([disc.acceleration(a, b)[3] for a, b in zip(q, v)])
    rise = -PARTS["r"] * (np.cos(beta) * v[:, 3] ** 2 + np.sin(beta) * lean2)
    forces = np.column_stack([run.multipliers, PARTS["m"] * (rise + PARTS["g"])])
    places = np.column_stack([q[:, :2], height])
    turns = newton_euler.attitude(*q[:, 2:].T)
    return quantities(places, turns, newton_euler.body_rate(q, v), forces)


def error(found: list[np.ndarray], exact: list[np.ndarray]) -> list[float]:
    """Return the errors as RATTLie's scripts measure them; a quaternion has two signs."""
    q, exact_q = found[0].copy(), exact[0]
    q[:, :4] *= np.sign((q[:, :4] * exact_q[:, :4]).sum(1, keepdims=True))
    return [float(np.sqrt(((a - b) ** 2).mean(1)).max())
            for a, b in zip([q, *found[1:]], exact)]  # fmt: skip


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    disc, other = dal.systems.rolling_disc(**PARTS), newton_euler.Disk(**PARTS)
    rows, curves = [], {}
    powers = {"midpoint": range(9, 12) if quick else range(8, 22)}
    powers["RATTLie"] = powers["midpoint-suzuki4"] = range(7, 10 if quick else 13)
    powers["leapfrog"] = powers["midpoint"]
    for lean in (0.0, np.deg2rad(15)):
        name = f"lean {np.rad2deg(lean):.0f} degrees"
        q0, v0 = start(lean)
        body = newton_euler.body_rate(q0, v0)
        rows.append(common.holds(
            f"{name}: Omega at the start", "(0, 15, 5)",
            f"({body[0] + 0:.12g}, {body[1]:.12g}, {body[2]:.12g})",
            abs(body - [0, 15, 5]).max() < 1e-13, "to 1e-13"))  # fmt: skip
        t = np.arange(0, T_END + EVERY / 2, EVERY)
        place, turn = np.array([0, 0, PARTS["r"] * np.cos(lean)]), newton_euler.attitude(*q0[2:])
        places, turns, bodies = other.solve(place, turn, body, t, 1e-13)
        forces = np.array([other.forces(*x)[1] for x in zip(turns, bodies)])
        exact = quantities(places, turns, bodies, forces)
        most = np.rad2deg(abs(np.arcsin(turns[:, 2, 2])).max())
        for scheme, order in SCHEMES.items():
            used, errors = powers[scheme], []
            for k in used:
                if scheme == "RATTLie":
                    found = rattlie.solve(other, place, turn, body, 2.0**-k, 2 * 2**k, 2 ** (k - 7))
                    errors.append(error(quantities(*found), exact))
                else:
                    found = dal.integrate(disc, scheme, q0, v0, h=2.0**-k, steps=2 * 2**k,
                                          stride=2 ** (k - 7))  # fmt: skip
                    errors.append(error(of_library(disc, found), exact))
            h, at = 2.0 ** -np.array(used), errors[used.index(9)]
            curves[name, scheme] = h, np.array(errors)
            slopes = []
            for column, values in zip(np.array(errors).T, exact):
                # roundoff of the finest runs, and the tolerance of the other solution, are below
                clear = column > 1e-9 * abs(values).max()
                if clear.sum() < 3:
                    raise RuntimeError("too few errors are clear of roundoff")
                slopes.append(common.slope(h[clear][-4:], column[clear][-4:]))
            printed = {"RATTLie": "2 in all", "midpoint-suzuki4": "-"}
            bound = 4e-3 if order == 2 else 1e-7
            rows += [
                common.holds(
                    f"{name}, {scheme}: orders of {', '.join(NAMES)}",
                    printed.get(scheme, "2 in all (RATTLie)"),
                    ", ".join(f"{x:.3f}" for x in slopes),
                    max(abs(x - order) for x in slopes) < 0.05, f"all {order} to 0.05"),
                common.holds(
                    f"{name}, {scheme}: errors of the same with h = 2^-9", "-",
                    ", ".join(f"{x:.1e}" for x in at), at[0] < bound, f"that of q below {bound:g}"),
            ]  # fmt: skip
        rows.append(common.holds(
            f"{name}: the farthest from upright, flat is 90", "-", f"{most:.2f} degrees",
            most < 80, "below 80 degrees: the coordinates are regular"))  # fmt: skip
    return rows, curves


def draw(data: Any) -> Any:
    """Draw the errors over the step."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.8), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    names = sorted({name for name, _ in data})
    for ax, name in zip(axes, names):
        for scheme, style in {"RATTLie": "--", "midpoint": "-", "midpoint-suzuki4": ":"}.items():
            h, errors = data[name, scheme]
            for k, (what, marker) in enumerate(zip(NAMES, "osd^")):
                label = f"{what}, {scheme}"
                ax.loglog(h, errors[:, k], style + marker, ms=3, lw=0.8, color=f"C{k}", label=label)
        h = data[name, "midpoint"][0]
        ax.loglog(h, 1e5 * h**2, "k-", lw=0.5, label="slope 2")
        ax.set(title=name, xlabel="h", ylim=(1e-13, None))
    axes[0].set_ylabel("error, as RATTLie measures it")
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside right", fontsize="x-small")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
