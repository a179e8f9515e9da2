"""Energy of a chaotic system over 1e8 steps: a random walk.

R. McLachlan, M. Perlmutter: Integrators for nonholonomic mechanical systems, J. Nonlinear Sci. 16
(2006) 283-328, doi:10.1007/s00332-005-0698-1.  The system and the ten initial data are those of the
authors' code, https://github.com/olivierverdier/odelab (`ChaoticOscillator`, its test); the
statement that the energy error is a random walk, whose mean square grows linearly with t, is quoted
from memory.

System: q = (x, y_1 ... y_3, z_1 ... z_3), x' + sum y_i z_i' = 0, and
L = |q'|^2/2 - (|q|^2 + z_1^2 z_2^2 + sum y_i^2 z_i^2)/2.  Initial data on E = 3.06, j = 0 ... 9:
x = cos(alpha), y_1' = sin(alpha), alpha = j pi/18, y = (0.6, 0.4, 0.2), z = (1, 1, 1), else 0.

Here: ensembles of 64 with alpha = k pi/126, which have the ten among them.  The mean square of
E(t + tau) - E(t), over members and t, less that of one stored row, 1/2000 of a run, which is the
bounded oscillation, is fitted by a power of tau from 1/40 to 1/4 of a run; its deviation is by
bootstrap of the members.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import common
import numpy as np

import dalembert as dal

ROWS = 2000
BETWEEN = np.unique(np.geomspace(ROWS // 40, ROWS // 4, 12).astype(int))  # lags of the fit
LAGS = np.unique(np.geomspace(1, ROWS // 4, 30).astype(int))  # lags of the picture
ORDER = {"leapfrog": 2, "midpoint": 2, "leapfrog-suzuki4": 4}
# scheme, h, steps, every how many of the 64 members: each, or each 7th, which are the ten
FULL = [("leapfrog", 0.05, 10**8, 7), ("leapfrog", 0.05, 2 * 10**7, 1),
        ("leapfrog", 0.1, 4 * 10**6, 1), ("leapfrog", 0.2, 10**6, 1), ("midpoint", 0.1, 10**6, 1),
        ("midpoint", 0.2, 2 * 10**5, 1), ("leapfrog-suzuki4", 0.2, 10**6, 1),
        ("leapfrog-suzuki4", 0.3, 10**6, 1)]  # fmt: skip
QUICK = [("leapfrog", 0.1, 10**6, 7), ("leapfrog", 0.1, 2 * 10**5, 1),
         ("leapfrog", 0.2, 2 * 10**5, 1), ("midpoint", 0.2, 6 * 10**4, 1),
         ("leapfrog-suzuki4", 0.4, 10**5, 1)]  # fmt: skip


def quartic() -> dal.System:
    """Return the system, compiled."""
    q = dal.coordinates("x y1 y2 y3 z1 z2 z3")
    x, y, z = q[0], q[1:4], q[4:]
    springs = sum(c**2 for c in q) + z[0] ** 2 * z[1] ** 2
    coupling = sum(a**2 * b**2 for a, b in zip(y, z))
    L = sum(c.d**2 for c in q) / 2 - (springs + coupling) / 2
    return dal.System.from_sympy(L, [x.d + sum(a * b.d for a, b in zip(y, z))])


def data(alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return initial data q0, v0, shape (..., 7), on E = 3.06."""
    q0, v0 = np.zeros((2, *np.shape(alpha), 7))
    q0[..., 0], v0[..., 1] = np.cos(alpha), np.sin(alpha)
    q0[..., 1:] = 0.6, 0.4, 0.2, 1, 1, 1
    return q0, v0


def squares(energy: np.ndarray, lags: Sequence[int]) -> np.ndarray:
    """Return the mean square over t of E(t + lag) - E(t), shape (members, lags)."""
    return np.array([((energy[:, lag:] - energy[:, :-lag]) ** 2).mean(axis=1) for lag in lags]).T


def exponent(energy: np.ndarray) -> tuple[float, float]:
    """Return the power of the lag in the mean square, and its deviation by bootstrap of members."""
    of_members, random = squares(energy, BETWEEN) - squares(energy, [1]), np.random.default_rng(1)

    def fit(chosen: Any) -> float:
        return np.polyfit(np.log(BETWEEN - 1), np.log(of_members[chosen].mean(axis=0)), 1)[0]

    members = len(of_members)
    again = [fit(random.integers(members, size=members)) for _ in range(200)]
    return float(fit(slice(None))), float(np.std(again))


def diffusion(energy: np.ndarray, t: np.ndarray) -> float:
    """Return the mean square over the time, at a lag of a 10th, less that of one row."""
    lag = ROWS // 10
    return (squares(energy, [lag]) - squares(energy, [1])).mean() / (t[lag] - t[1])


def by_hand(q: np.ndarray, v: np.ndarray, h: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return t and energies of leapfrog, written here: a check that does not use the library."""

    def force(q: np.ndarray) -> np.ndarray:
        y, z, out = q[:, 1:4], q[:, 4:], -q
        out[:, 1:4] -= y * z * z
        out[:, 4:] -= y * y * z
        out[:, 4:6] -= z[:, :2] * z[:, 1::-1] ** 2
        return out

    def energy() -> np.ndarray:
        y, z = q[:, 1:4], q[:, 4:]
        fourth = (y * z) ** 2
        return ((v**2 + q**2).sum(axis=1) + fourth.sum(axis=1) + (z[:, 0] * z[:, 1]) ** 2) / 2

    rows = [energy()]
    mu = np.zeros_like(q)
    mu[:, 0] = 1
    for step in range(1, steps + 1):
        node = q + h / 2 * v
        mu[:, 4:] = node[:, 1:4]
        free, reaction = v + h * force(node), np.zeros((len(q), 1))
        for _ in range(20):
            v = free + reaction * mu
            q = node + h / 2 * v
            phi = v[:, 0] + (q[:, 1:4] * v[:, 4:]).sum(axis=1)
            slope = 1 + (q[:, 1:4] * mu[:, 4:] + h / 2 * mu[:, 1:4] * v[:, 4:]).sum(axis=1)
            if abs(phi).max() < 1e-14:
                break
            reaction -= (phi / slope)[:, None]
        if step % (steps // ROWS) == 0:
            rows.append(energy())
    return np.linspace(0, h * steps, ROWS + 1), np.array(rows).T


def lyapunov(system: dal.System) -> np.ndarray:
    """Return the growth rates of a distance of 1e-10 up to t = 100, one for each of the ten."""
    alpha = np.arange(10) * np.pi / 18
    q0, v0 = data(np.stack([alpha, alpha + 1e-10]))
    ends = dal.ensemble(system, "leapfrog-kl6", q0, v0, h=0.1, t_end=100, progress=False)
    away = np.hstack([ends.q[10:] - ends.q[:10], ends.v[10:] - ends.v[:10]])
    return np.log(np.linalg.norm(away, axis=1) / 1e-10) / 100


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    system, alpha = quartic(), np.arange(64) * np.pi / 126
    q0, v0 = data(alpha)
    rates, rows = lyapunov(system), []
    rows.append(common.near("E of the ten initial data", 3.06, float(
        system.energy(q0[::7], v0[::7]).max()), 1e-14, source="odelab"))  # fmt: skip
    rows.append(common.holds(
        "growth of a distance of 1e-10 to t = 100, exp(a t), the ten", "chaotic",
        f"a from {rates.min():.2f} to {rates.max():.2f}", rates.min() > 0.05,
        "all above 0.05"))  # fmt: skip

    found, constants = {}, {}
    for scheme, h, steps, every in QUICK if quick else FULL:
        with warnings.catch_warnings():  # energies that have changed by much, which is the subject
            warnings.simplefilter("ignore", dal.DalembertWarning)
            many = dal.ensemble(system, scheme, q0[::every], v0[::every], h=h, steps=steps,
                                stride=steps // ROWS, keep=["energy"], lanes=True,
                                progress=False)  # fmt: skip
        energy, who = many["energy"] - many["energy"][:, :1], "the ten" if every > 1 else "64"
        power, deviation = exponent(energy)
        found[who, scheme, h] = many.t, energy
        if every == 1:
            constants[scheme, h] = diffusion(energy, many.t)
        rows.append(common.near(
            f"{who}, {scheme}, h = {h:g}, {steps:.0e} steps: mean square like tau^a, a", 1, power,
            0.3 if quick or every > 1 else 0.1, digits=3, source="linear",
            note=f"deviation {deviation:.2f}; to t = {many.t[-1]:g}: mean square "
            f"{(energy[:, -1] ** 2).mean():.1e}, mean {energy[:, -1].mean():.1e}"))  # fmt: skip
    for scheme, order in ORDER.items():
        h = sorted(step for name, step in constants if name == scheme)
        if len(h) > 1:
            power = common.slope(h, [constants[scheme, step] for step in h])
            rows.append(common.near(
                f"{scheme}: mean square / t like h^b, b", 2 * order, power,
                0.25 * order, digits=3, source="2 p",
                note="mean square / t = " + ", ".join(
                    f"{constants[scheme, step]:.1e} (h = {step:g})" for step in h)))  # fmt: skip
    t, energy = by_hand(q0, v0, 0.2, 60_000 if quick else 200_000)
    ratio = diffusion(energy - energy[:, :1], t) / constants["leapfrog", 0.2]
    rows.append(common.holds(
        f"mean square / t, h = 0.2, t = {t[-1]:g}: the scheme written in NumPy, by leapfrog",
        "independent", f"{ratio:.2f}", 0.6 < ratio < 1.6, "between 0.6 and 1.6"))  # fmt: skip

    scheme, h, *_ = (QUICK if quick else FULL)[0]
    short = dal.ensemble(system, scheme, q0[::7], v0[::7], h=h, t_end=200, keep=["energy"],
                         stride=5, progress=False)  # fmt: skip
    square = ((short["energy"] - short["energy"][:, :1]) ** 2).mean(axis=0)
    early, late = (square[(short.t > a) & (short.t <= 2 * a)].mean() for a in (50, 100))
    rows.append(common.holds(
        f"the ten, {scheme}, h = {h:g}: mean square to t = 200", "-",
        f"{early:.1e} in (50, 100), {late:.1e} in (100, 200)", 0.5 < late / early < 1.5,
        "not seen to grow: less than 1.5 times"))  # fmt: skip
    t, energy = found["the ten", scheme, h]
    square = (energy**2).mean(axis=0)
    rows.append(common.holds(
        f"the ten, {scheme}, h = {h:g}: mean square to a 100th, a 10th, all of t = {t[-1]:g}",
        "grows", ", ".join(f"{square[i]:.1e}" for i in (ROWS // 100, ROWS // 10, ROWS)),
        square[-1] > 10 * late, "at the end 10 times that of t <= 200"))  # fmt: skip
    return rows, found


def draw(found: Any) -> Any:
    """Draw the energy errors of the ten, and the mean squares of all against the time between."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for (who, scheme, h), (t, energy) in found.items():
        if who == "the ten":
            left.plot(t[::10], energy[:, ::10].T, lw=0.6)
            left.set(xlabel="t", ylabel="E(t) - E(0)", title=f"the ten, {scheme}, h = {h:g}")
        else:
            tau = t[LAGS] - t[0]
            right.loglog(tau, squares(energy, LAGS).mean(axis=0), ".-", ms=3, lw=0.8,
                         label=f"{scheme}, h = {h:g}")  # fmt: skip
    right.plot([1e3, 1e5], [1e-5, 1e-3], "k:", lw=1, label="like t")
    right.set(xlabel="time between", ylabel="mean square of the change of E", title="64 members")
    figure.legend(loc="outside right center", fontsize=7)
    return figure


if __name__ == "__main__":
    common.main(run, draw)
