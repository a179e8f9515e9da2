"""Energy and Poincare section of the contact oscillator.

R. McLachlan, M. Perlmutter: Integrators for nonholonomic mechanical systems, J. Nonlinear Sci. 16
(2006) 283-328, doi:10.1007/s00332-005-0698-1, section 5.2. Data of the authors' code,
https://github.com/olivierverdier/odelab (`ContactOscillator` and its tests), which has been run for
the numbers under "printed": the paper has pictures.

System: L = (x'^2 + y'^2 + z'^2)/2 - (x^2 + y^2 + z^2 + eps x^2 z^2)/2, x' + y z' = 0; E = 3/2, H_y
= (y'^2 + y^2)/2 = 1/2, h = 2 sin(pi/N), with which y of leapfrog comes back after N steps, so that
a section needs no interpolation. eps = 0: N = 40, start at y = 1, z = -sqrt(1/2) (100 returns), and
ten z in +-0.9 sqrt(2); eps = 0.3: N = 15, start at y = 0, y' = 1, the same ten.

Here also: for eps = 0 the equations of (x, z, z') for given y(t) are linear, so the section of the
flow, and that of leapfrog, is a linear map of R^3. Reversible, it has eigenvalues 1 and exp(+-ia),
or c and 1/c; with the former nothing grows, ever. The map is measured; that of the flow is from
DOP853 in (z, z').
"""

from __future__ import annotations

from typing import Any

import common
import numpy as np
from scipy.integrate import solve_ivp

import dalembert as dal

TEN = np.linspace(-0.9, 0.9, 10) * np.sqrt(2)


def start(z: Any, eps: float, y: int) -> tuple[np.ndarray, np.ndarray]:
    """Return q0, v0 with E = 3/2, H_y = 1/2 and z' = 0 at y = 1 (at rest) or y = 0."""
    z = np.asarray(z)
    x = np.sqrt((2 - z**2) / (1 + eps * z**2))
    zero = 0 * z
    return np.stack([x, zero + y, z], -1), np.stack([zero, zero + 1 - y, zero], -1)


def linear(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the matrix A with after = before A^T by least squares."""
    return np.linalg.lstsq(before, after, rcond=None)[0].T


def exact_map() -> np.ndarray:
    """Return the section y = 1 of the flow for eps = 0 as a matrix on (x, z, z').

    With x' = -y z' the equations of motion give (1 + y^2) z'' = y x - z - y y' z', y = cos(t).
    """

    def rate(t: float, w: np.ndarray) -> list[float]:
        x, z, u = w
        y, s = np.cos(t), -np.sin(t)
        return [-y * u, u, (y * x - z - y * s * u) / (1 + y * y)]

    once = 0, 2 * np.pi
    return np.array([solve_ivp(rate, once, unit, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
                     for unit in np.eye(3)]).T  # fmt: skip


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    plain, perturbed = (dal.systems.contact_oscillator(eps=eps) for eps in (0.0, 0.3))
    steps, h, rows = 40, 2 * np.sin(np.pi / 40), []
    long = 1000 if quick else 100_000

    # scheme here, of which the numbers are: max |E - E(0)|, the same of E - H_y, within
    same = [("leapfrog", "odelab, McLachlan", 1.45e-2, 1.15e-2, 1e-4),
            ("midpoint", "another code", 7.09e-3, 7.09e-3, 1e-5)]  # fmt: skip
    for scheme, other, printed, radius, within in same:
        found = dal.integrate(
            plain, scheme, *start(-np.sqrt(0.5), 0, 1), h=h, steps=100 * steps, check_h=False
        )  # steps as large as theirs: the energies are compared
        error = found.energy - found.energy[0]
        pair = found.energy - (found.v[:, 1] ** 2 + found.q[:, 1] ** 2) / 2
        what = f"eps = 0, 100 returns, {scheme}"
        rows += [
            common.near(f"{what}: max |E - E(0)|", printed, abs(error).max(), within,
                        digits=3, source=other),
            common.near(f"{what}: the same of E - H_y", radius, abs(pair - pair[0]).max(), within,
                        digits=3, source=other),
        ]  # fmt: skip
    worst = abs(found.constraint).max()
    rows.append(common.holds(f"{what}: max |mu v|", "odelab, McLachlan: 3e-16", f"{worst:.0e}",
                             worst < 1e-14, "below 1e-14"))  # fmt: skip
    for scheme, other, printed in [
        ("leapfrog-suzuki4", "odelab, Spark 3, order 4", 8.8e-6),
        ("leapfrog-kl6", "", None),
    ]:
        found = dal.integrate(plain, scheme, *start(-np.sqrt(0.5), 0, 1), h=h, steps=100 * steps)
        error = abs(found.energy - found.energy[0]).max()
        limit = 3e-5 if printed else 1e-7
        rows.append(common.holds(
            f"eps = 0, 100 returns, {scheme}: max |E - E(0)|",
            f"{other}: {printed:.1e}" if printed else "-", f"{error:.1e}", error < limit,
            f"below {limit:.0e}; a step is that of leapfrog"))  # fmt: skip

    # Ten orbits: the section, its map, and the energy over long times.
    sections = {}
    for name, system, eps, n, y in [
        ("eps = 0", plain, 0.0, 40, 1),
        ("eps = 0.3", perturbed, 0.3, 15, 0),
    ]:
        h = 2 * np.sin(np.pi / n)
        many = dal.ensemble(
            system, "leapfrog", *start(TEN, eps, y), h=h, steps=long * n, stride=n,
            keep=["x", "z", "v_z", "y", "v_y", "energy"], progress=False)  # fmt: skip
        error = abs(many["energy"] - many["energy"][:, :1])
        early = error[:, :101].max()
        rows.append(common.holds(
            f"{name}, N = {n}, ten orbits, leapfrog: max |E - E(0)| on the section, in 100 and "
            f"{long} returns", "bounded", f"{early:.4e}, {error.max():.4e}",
            error.max() < 1.05 * early, "grows by less than 5 %"))  # fmt: skip
        back = max(abs(many["y"] - y).max(), abs(many["v_y"] - (1 - y)).max())
        rows.append(common.holds(
            f"{name}: y and y' come back after N steps", "exactly",
            f"off by {back:.0e} in {long} returns", back < 1e-8, "below 1e-8"))  # fmt: skip
        sections[name] = many["z"], many["v_z"], many["energy"] - many["energy"][:, :1], many["x"]

    z, u, _, x = sections["eps = 0"]
    points = np.stack([x, z, u], -1)[:, :1001]
    A = linear(points[:, :-1].reshape(-1, 3), points[:, 1:].reshape(-1, 3))
    left = abs(points[:, 1:] - points[:, :-1] @ A.T).max()
    rows.append(common.holds("eps = 0: the section of leapfrog is a linear map", "foliated",
                             f"fits to {left:.0e}", left < 1e-11, "below 1e-11"))  # fmt: skip
    values, exact = np.linalg.eigvals(A), exact_map()
    off, angle, of_flow = (
        abs(abs(values) - 1).max(), abs(np.angle(values)).max(),
        abs(np.angle(np.linalg.eigvals(exact))).max())  # fmt: skip
    rows += [
        common.holds("eps = 0: its eigenvalues, 1 and exp(+-ia)", "on the unit circle",
                     f"moduli off by {off:.0e}, a = {angle:.5f}", off < 1e-11 and angle > 0.1,
                     "below 1e-11, a not 0"),
        common.near("eps = 0: a", of_flow, angle, 0.025, digits=5, source="flow, independent",
                    note="h^2 = 0.025"),
    ]  # fmt: skip
    return rows, sections


def draw(sections: Any) -> Any:
    """Draw the sections, and the energy errors on them."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(8, 6), layout="constrained")
    where = {"eps = 0": "y = 1", "eps = 0.3": "y = 0, y' > 0"}
    for (above, below), (name, (z, u, error, _)) in zip(axes.T, sections.items()):
        for k in range(len(z)):
            above.plot(z[k, :200], u[k, :200], ".", ms=1.5)
            below.plot(z[k, :200], error[k, :200], ".", ms=1.5)
        above.set(xlabel="z", ylabel="z'", title=f"leapfrog, {name}, {where[name]}")
        below.set(xlabel="z", ylabel="E - E(0)")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
