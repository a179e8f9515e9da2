"""Order and energy of the nonholonomic particle, at moved and at kept nodes.

F. Jimenez, J. Scheurle: On the discretization of nonholonomic dynamics in R^n, J. Geom. Mech. 7
(2015) 43-80, doi:10.3934/jgm.2015.7.43, arXiv:1407.2116; the example of the particle.

System: L = (x'^2 + y'^2 + z'^2)/2, z' = y x'. The paper has no tables. It claims order (p, s) =
(2, 0) of beta = 1/2 at the moved nodes and (1, 0) at the kept nodes, (1, 0) of beta = 0, closed
forms of a step, and that in all cases the constraint turned out to be preserved "up to small
bounded oscillatory variations"; of the energy it says nothing.

Here: the orders from runs, against the solution in closed form; steps by the closed form against
steps of the library; residual and energy over a long run, of the particle on springs, V = (x^2 + 2
y^2 + 1.5 z^2)/2 (without them it never turns round, and there is no oscillation to see).
"""

from __future__ import annotations

from typing import Any

import common
import numpy as np

import dalembert as dal

U = 2.0**-53
Q0, V0 = (0.0, -1.0, 0.0), (1.0, 0.5, -1.0)


def exact(t: float) -> np.ndarray:
    """Return (q, v) at t of the free particle: v_y and v_x sqrt(1 + y^2) are constant."""
    (x, y0, z), (vx, b, _) = Q0, V0
    c, y = vx * np.hypot(1, y0), y0 + b * t
    x += c / b * (np.arcsinh(y) - np.arcsinh(y0))
    z += c / b * (np.hypot(1, y) - np.hypot(1, y0))
    return np.array([x, y, z, c / np.hypot(1, y), b, c * y / np.hypot(1, y)])


def closed_form(h: float, steps: int, printed: bool) -> np.ndarray:
    """Return (q, v) after steps of beta = 1/2 by the paper's formulas.

    ``printed`` moves x and z by h v', as the paper has it, otherwise by h (v + v')/2.
    """
    x, y, z, vx, vy, vz = *Q0, *V0
    for _ in range(steps):
        node, after = y + h / 2 * vy, y + h * vy
        impulse = h * vx * vy / (1 + node * after)
        new_x, new_z = vx - impulse * node, vz + impulse
        x += h * (new_x if printed else (vx + new_x) / 2)
        z += h * (new_z if printed else (vz + new_z) / 2)
        y, vx, vz = after, new_x, new_z
    return np.array([x, y, z, vx, vy, vz])


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    free, springs = dal.systems.particle(), dal.systems.particle_oscillator()
    t_end, steps = 3.0, 2 ** np.arange(5, 9 if quick else 12)
    h = t_end / steps
    end, rows, errors = exact(t_end), [], {}

    kinds = {"midpoint": (None, 2), "midpoint-nodes": ("shift", 1), "explicit": (None, 1)}
    names = {"midpoint": "beta = 1/2, moved nodes", "midpoint-nodes": "beta = 1/2, kept nodes",
             "explicit": "beta = 0"}  # fmt: skip
    for scheme, (initial, order) in kinds.items():
        errors[scheme], reactions = [], []
        for n in steps:
            found = dal.integrate(
                free, scheme, Q0, V0, h=t_end / n, steps=n, initial=initial, check_h=False
            )
            state = np.hstack([found.q[-1], found.v[-1]])
            errors[scheme].append(abs(state - end).max())
            # its own multiplier of the last step, against lambda at the end of it
            at_end = free.multipliers(end[:3], end[3:])
            reactions.append(abs(found.reactions[-1] - at_end).max())
        rows += [
            common.near(f"{names[scheme]}: order p of the state", order,
                        common.slope(h, errors[scheme]), 0.1, digits=3),
            common.near(f"{names[scheme]}: order of the multiplier, s + 1 with s = 0", 1,
                        common.slope(h, reactions), 0.1, digits=3),
        ]  # fmt: skip

    steps_once = 1000
    found = dal.integrate(free, "midpoint", Q0, V0, h=0.01, steps=steps_once)
    state = np.hstack([found.q[-1], found.v[-1]])
    off = abs(closed_form(0.01, steps_once, printed=False) - state).max()
    rows.append(common.holds(
        "closed form of a step, x and z moved by h (v + v')/2", "a step of beta = 1/2",
        f"after {steps_once} steps off by {off:.0e}", off < 1e-11, "below 1e-11"))  # fmt: skip
    errors["printed"] = [abs(closed_form(t_end / n, n, printed=True) - end).max() for n in steps]
    rows.append(common.near(
        "the same with x and z moved by h v', as printed: order", 2,
        common.slope(h, errors["printed"]), 0.1, digits=3,
        differs="a slip of the print, E7 of the errata"))  # fmt: skip

    long = 1e3 if quick else 1e5
    curves = {}
    for scheme in ("midpoint", "midpoint-nodes"):
        found = dal.integrate(
            springs, scheme, h=0.1, t_end=long, initial=kinds[scheme][0], check_h=False
        )
        part = len(found.t) // 16
        energy = abs(found.energy - found.energy[0])
        residual = abs(springs.residual(found.q, found.v)[:, 0])
        curves[scheme] = found.t[:1000], (found.energy - found.energy[0])[:1000], residual[:1000]
        band, early = energy.max(), energy[:part].max()
        rows.append(common.holds(
            f"{names[scheme]}, springs, h = 0.1: max |E - E(0)|", "-",
            f"{early:.3e} to t = {long / 16:g}, {band:.3e} to t = {long:g}",
            early <= band < 1.1 * early < 0.2, "grows by less than 10 %"))  # fmt: skip
        if scheme == "midpoint":
            bound = 4 * springs.n * U
            rows.append(common.holds(
                f"{names[scheme]}, the same: worst residual of D",
                "small bounded variations", f"{found.residual.max():.1e}",
                found.residual.max() > bound, f"above 4 n u = {bound:.1e}",
                differs="the constraint is kept to roundoff, E22 of the errata"))  # fmt: skip
        else:
            most, early = residual.max(), residual[:part].max()
            rows.append(common.holds(
                f"{names[scheme]}, the same: max |mu v|", "small bounded variations",
                f"{early:.3e} to t = {long / 16:g}, {most:.3e} to t = {long:g}",
                0.01 < early <= most < 1.05 * early, "grows by less than 5 %"))  # fmt: skip
    return rows, (h, errors, names, curves)


def draw(data: Any) -> Any:
    """Errors over the step, and energy and constraint along a run."""
    from matplotlib.figure import Figure

    h, errors, names, curves = data
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for (name, error), marker in zip(errors.items(), "osd^"):
        label = names.get(name, "beta = 1/2, with the printed slip")
        left.loglog(h, error, marker=marker, ms=4, lw=1, label=label)
    left.set(xlabel="h", title="error of the state at t = 3")
    for scheme, (t, energy, residual) in curves.items():
        middle.plot(t, energy, lw=0.8, label=names[scheme])
        right.semilogy(t, np.maximum(residual, 1e-17), lw=0.6, label=names[scheme])
    middle.set(xlabel="t", title="springs, h = 0.1: E - E(0)")
    right.set(xlabel="t", title="|z' - y x'|")
    for ax in (left, middle, right):
        ax.legend(fontsize="x-small", loc="best")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
