"""The nonholonomic particle as a Hamiltonian system in another time: energy and volume.

L. C. Garcia-Naranjo, M. Vermeeren: Structure preserving discretization of time-reparametrized
Hamiltonian systems with application to nonholonomic mechanics, J. Comput. Dyn. 8 (2021) 241-271,
and its notebook nonholonomic_particle.ipynb (github.com/mvermeeren/conf-ham-sys-2020), from which
the data are.

System: L = |v|^2/2 - V, z' = y x', with V = (x^2 + y^2)/2 or 0; z is left out. In p_x = sqrt(1 +
y^2) x', p_y = y'/sqrt(1 + y^2) it is conformally Hamiltonian with the factor N = 1/sqrt(1 + y^2),
and dp_x dx dp_y dy/N is preserved. From (p_x, x, p_y, y) = (1, 0, 1, 0) with h = 0.25 to t = 10;
and the vertices of a 600-cell of radius 0.01 around it to t = 30. The paper has pictures: H in a
band, and the volume of the convex hull of the vertices, times the mean of 1/N, which is constant
up to small oscillations for variational integrators of L_d = N (L + E) at a fixed E.

Here: schemes of the library on the same data, and the integrator called M there, the variational
one at midpoints with E = H at the start, written out again. The volume is measured as in the
paper, and by the determinant of the derivative of all steps, which needs no hull.
"""

from __future__ import annotations

import itertools
from typing import Any

import common
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve
from scipy.spatial import ConvexHull

import dalembert as dal

H, T_END, T_CLOUD, RADIUS = 0.25, 10.0, 30.0, 0.01
START = np.array([1.0, 0.0, 1.0, 0.0])
SCHEMES = ("explicit", "midpoint", "leapfrog", "leapfrog-kl6")


def into(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (q, v) of states (p_x, x, p_y, y)."""
    p, x, r, y = np.moveaxis(w, -1, 0)
    root = np.sqrt(1 + y**2)
    vx = p / root
    return np.stack([x, y, 0 * x], -1), np.stack([vx, r * root, y * vx], -1)


def out_of(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return (p_x, x, p_y, y)."""
    root = np.sqrt(1 + q[..., 1] ** 2)
    return np.stack([v[..., 0] * root, q[..., 0], v[..., 1] / root, q[..., 1]], -1)


def hamiltonian(w: np.ndarray, springs: float) -> np.ndarray:
    """Return H of states."""
    p, x, r, y = np.moveaxis(w, -1, 0)
    return (p**2 + (1 + y**2) * r**2 + springs * (x**2 + y**2)) / 2


def reduced(springs: float, w0: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the exact motion at the times t."""

    def rate(_: float, w: np.ndarray) -> list[float]:
        (p, x, r, y), root = w, np.sqrt(1 + w[3] ** 2)
        return [-springs * x / root, p / root, -y * (r**2 + springs) / root, r * root]

    return solve_ivp(rate, (t[0], t[-1]), w0, "DOP853", t, rtol=1e-12, atol=1e-13).y.T


def variational(springs: float, w0: np.ndarray, steps: int) -> np.ndarray:
    """Return the states of M: L_d = h N(ym) (L(xm, ym, dx/h, dy/h) + E), with E = H(w0)."""
    energy = hamiltonian(w0, springs)

    def slopes(x: float, y: float, dx: float, dy: float) -> tuple[np.ndarray, np.ndarray]:
        n = 1 / np.sqrt(1 + y**2)
        value = ((1 + y**2) * dx**2 + dy**2 - springs * (x**2 + y**2)) / 2 + energy
        by_q = [-n * springs * x, n * (y * dx**2 - springs * y) - y * n**3 * value]
        return np.array(by_q), np.array([n * (1 + y**2) * dx, n * dy])

    def momenta(q: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        by_q, by_v = slopes(*(q + r) / 2, *(r - q) / H)
        return by_v - H / 2 * by_q, by_v + H / 2 * by_q

    q, p, states = w0[[1, 3]], w0[[0, 2]], [w0]
    for _ in range(steps):
        r = fsolve(lambda r, q=q, p=p: momenta(q, r)[0] - p, q + H * p, xtol=1e-11)
        q, p = r, momenta(q, r)[1]
        states.append(np.array([p[0], q[0], p[1], q[1]]))
    return np.array(states)


def six_hundred_cell() -> np.ndarray:
    """Return its 120 vertices on the unit sphere."""
    golden = (1 + np.sqrt(5)) / 2
    found = {tuple(v) for sign in (1.0, -1.0) for v in sign * np.eye(4)}
    found |= set(itertools.product((0.5, -0.5), repeat=4))
    even = [p for p in itertools.permutations(range(4))
            if sum(p[i] > p[j] for i in range(4) for j in range(i + 1, 4)) % 2 == 0]  # fmt: skip
    for signs in itertools.product((1, -1), repeat=3):
        values = [signs[0] * golden / 2, signs[1] / 2, signs[2] / golden / 2, 0.0]
        found |= {tuple(values[k] for k in p) for p in even}
    return np.array(sorted(found))


def hull_volume(cloud: np.ndarray) -> float:
    """Return the measure of the hull of a centre and its shell: as the notebook does."""
    weight = np.sqrt(1 + cloud[:, 3] ** 2)
    return (weight[0] / 3 + 2 * weight[1:].mean() / 3) * ConvexHull(cloud).volume


def one_run(system: dal.System, scheme: str, w0: np.ndarray, t_end: float) -> np.ndarray:
    """Return (p_x, x, p_y, y) along a run of the library, whose h is as large as theirs."""
    found = dal.integrate(system, scheme, *into(w0), h=H, t_end=t_end, check_h=False)
    return out_of(found.q, found.v)


def determinants(system: dal.System, scheme: str, t_end: float) -> np.ndarray:
    """Return det(dw(t)/dw(0)) N(0)/N(t) along a run, which is 1 if the measure is kept.

    The product of the determinants of single steps, from differences of order 4.
    """
    small = 1e-3
    w = one_run(system, scheme, START, t_end)
    around = w[:-1, None, None] + small * np.array([2, 1, -1, -2])[:, None, None] * np.eye(4)
    ends = dal.ensemble(system, scheme, *into(around), h=H, steps=1, progress=False)
    moved = out_of(ends.q, ends.v).reshape(around.shape)
    slopes = np.tensordot(moved, [-1, 8, -8, 1], (1, 0)) / (12 * small)
    weight = np.sqrt(1 + w[:, 3] ** 2)
    steps_of = np.linalg.det(slopes) * weight[1:] / weight[:-1]
    return np.concatenate([[1.0], np.cumprod(steps_of)])


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    free, springs = dal.systems.particle(), dal.systems.particle_oscillator(k1=1, k2=1, k3=0)
    t = H * np.arange(round(T_END / H) + 1)
    rows: list[common.Row] = []
    exact = reduced(1.0, START, t)
    end = one_run(springs, "reference", START, T_END)[-1]
    rows.append(common.holds(
        "springs, t = 10: the exact motion, reference of the library", "independent: solve_ivp",
        f"off by {abs(end - exact[-1]).max():.1e}", abs(end - exact[-1]).max() < 1e-9,
        "below 1e-9"))  # fmt: skip

    # figures 5.3, 5.5 and 5.6: H and the error with h = 0.25 to t = 10
    for name, system, k in (("springs", springs, 1.0), ("free", free, 0.0)):
        exact = reduced(k, START, t)
        motions = {"M": variational(k, START, len(t) - 1)}
        motions |= {s: one_run(system, s, START, T_END) for s in SCHEMES}
        errors = {s: np.linalg.norm(w - exact, axis=1).max() for s, w in motions.items()}
        for scheme, w in motions.items():
            band = abs(hamiltonian(w, k) - 1).max()
            bound = {"explicit": 1.0, "leapfrog-kl6": 1e-3}.get(scheme, 0.05)
            who = "M of the paper" if scheme == "M" else scheme
            claim = "in a band" if scheme == "M" else "-"
            rows.append(
                common.holds(
                    f"{name}, {who}: max |H - 1|, max |error|",
                    claim,
                    f"{band:.2e}, {errors[scheme]:.2e}",
                    band < bound,
                    f"|H - 1| below {bound:g}",
                )
            )
    # figures 5.2 and 5.4: the volume, to t = 30
    shell = START + RADIUS * six_hundred_cell()
    rows.append(
        common.near("vertices of the 600-cell", 120, len(shell), 0, digits=3, source="notebook")
    )
    every, volumes = 8 if quick else 1, {}
    times = H * np.arange(0, round(T_CLOUD / H) + 1, every)
    for scheme in ("reference", *(() if quick else ("M",)), *SCHEMES):
        paths = []
        for w in (START, *shell):
            if scheme == "M":  # every vertex has its own E, as in the notebook
                paths.append(variational(1.0, w, round(T_CLOUD / H))[::every])
            elif scheme == "reference":
                paths.append(reduced(1.0, w, times))
            else:
                paths.append(one_run(springs, scheme, w, T_CLOUD)[::every])
        measured = np.array([hull_volume(c) for c in np.swapaxes(paths, 0, 1)])
        change = volumes[scheme] = measured / measured[0] - 1
        who, claim = {"M": ("M of the paper", "kept, but for small oscillations"),
                      "reference": ("exact motion", "kept")}.get(scheme, (scheme, "-"))  # fmt: skip
        test, criterion = abs(change).max() < 0.01, "below 0.01"
        if scheme in ("reference", "leapfrog-kl6"):
            test, criterion = abs(change).max() < 1e-3, "below 1e-3; the hull is bent by O(r^2)"
        if scheme == "explicit":
            test, criterion = change[-1] < -0.5, "lost by more than half"
        rows.append(common.holds(
            f"springs, {who}: change of the volume to t = {T_CLOUD:g}", claim,
            f"{change.min():+.1e} to {change.max():+.1e}", test, criterion))  # fmt: skip
    long = 100.0 if quick else 1000.0
    for scheme in SCHEMES:
        change = determinants(springs, scheme, long) - 1
        early = change[: len(change) // 10]
        if scheme == "explicit":
            test, criterion = change[-1] < -0.95, "all but lost"
        else:
            test = np.ptp(change) < 1.2 * np.ptp(early)
            criterion = "a band, wider by less than 20 %"
        rows.append(common.holds(
            f"springs, {scheme}: the same by the determinant", "-",
            f"{early.min():+.1e} to {early.max():+.1e} to t = {long / 10:g}, "
            f"{change.min():+.1e} to {change.max():+.1e} to t = {long:g}",
            test, criterion))  # fmt: skip
    return rows, (times, volumes)


def draw(data: Any) -> Any:
    """Draw the volumes."""
    from matplotlib.figure import Figure

    times, volumes = data
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for k, (name, change) in enumerate(volumes.items()):
        (left if name == "explicit" else right).plot(times, change, f"C{k}", lw=1, label=name)
    for ax in (left, right):
        ax.set(xlabel="t", title="relative change of the volume, 600-cell")
        ax.legend(fontsize="small")
    return figure


if __name__ == "__main__":
    common.main(run, draw)
