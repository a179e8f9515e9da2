"""Energy kept exactly by discrete gradients, beside schemes that keep D and not the energy.

E. Celledoni, M. Farre Puiggali, E. H. Hoiseth, D. Martin de Diego: Energy-preserving integrators
applied to nonholonomic systems, J. Nonlinear Sci. (2018), arXiv:1605.02845. From the abstract:
integrators by discrete gradients on the dual of D, with its almost-Poisson bracket, keep
constraints and energy; they are compared with others on a chaotic quartic system, the Chaplygin
sleigh, the Suslov problem and a gearbox driven by an asymmetric pendulum, V = -cos(y) + a sin(2y).
Their parameters and numbers were not to be had: these are our own.

Here: that idea, with the midpoint discrete gradient of Gonzalez, in quasi-momenta p of a basis B(q)
of D: v = B G^-1 p, G = B^T M B, H = p G^-1 p/2 + V and q' = B H_p, p' = -B^T H_q + C H_p, C_ab =
-(M v).[X_a, X_b]. Solutions to judge by: DOP853, which does not use the library.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import common
import numpy as np
import sympy as sp
from chaotic_walk import data, quartic
from scipy.integrate import solve_ivp

import dalembert as dal

SCHEMES = ("leapfrog", "midpoint", "leapfrog-suzuki4")


class OnDual:
    """The motion on the dual of D in (q, p): its field, and steps by a discrete gradient.

    ``mass`` has the masses, ``basis`` the columns X_a of B; states have the shape (n + k, members).
    """

    def __init__(
        self, q: Sequence[Any], mass: Sequence[Any], V: Any, basis: Sequence[Sequence[Any]]
    ) -> None:
        X, M = sp.Matrix(basis).T, sp.diag(*mass)
        self.n, k = X.shape
        p = sp.Matrix(sp.symbols(f"p:{k}"))
        inverse = (X.T * M * X).inv()
        momentum = M * X * inverse * p
        columns = [X[:, a] for a in range(k)]
        C = sp.Matrix(k, k, lambda a, b: -momentum.dot(
            columns[b].jacobian(q) * columns[a] - columns[a].jacobian(q) * columns[b]))  # fmt: skip
        H, at = (p.T * inverse * p)[0] / 2 + V, [*q, *p]
        zero = sp.zeros(self.n, self.n)
        Pi = zero.row_join(X).col_join((-X.T).row_join(C))
        slope = sp.symbols(f"g:{self.n + k}")
        self.energy = sp.lambdify([at], H, cse=True)
        self._gradient = sp.lambdify([at], [sp.diff(H, c) for c in at], cse=True)
        self._turn = sp.lambdify([at, slope], list(Pi * sp.Matrix(slope)), cse=True)
        self._to = sp.lambdify([q, sp.symbols(f"v:{self.n}")],
                               list(X.T * M * sp.Matrix(sp.symbols(f"v:{self.n}"))))  # fmt: skip
        self.velocity = sp.lambdify([at], list(X * inverse * p), cse=True)

    def state(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return (q, p) of (q, v) in D, given with the coordinates last."""
        q, v = np.atleast_2d(q).T, np.atleast_2d(v).T
        return np.vstack([q, self._rows(self._to(q, v), q)])

    def field(self, w: np.ndarray) -> np.ndarray:
        """Return dw/dt."""
        return self._rows(self._turn(w, self._gradient(w)), w)

    @staticmethod
    def _rows(of: Sequence[Any], like: np.ndarray) -> np.ndarray:
        return np.array([np.broadcast_to(x, like.shape[1:]) for x in of], float)

    def step(self, w: np.ndarray, h: float) -> np.ndarray:
        """Return the state after a step, by fixed point iteration to roundoff."""
        new, last = w + h * self.field(w), np.inf
        for _ in range(200):
            mid, d = (w + new) / 2, new - w
            slope = self._rows(self._gradient(mid), w)
            lack = self.energy(new) - self.energy(w) - (slope * d).sum(axis=0)
            slope += lack / (d**2).sum(axis=0) * d
            again = w + h * self._rows(self._turn(mid, slope), w)
            change, new = abs(again - new).max(), again
            if change < 1e-15 or (change < 1e-12 and change >= last):
                return new
            last = change
        raise RuntimeError(f"no convergence with h = {h}: try a smaller one")


def systems() -> dict[str, tuple[Any, ...]]:
    """Return name: (system, the same on the dual, q0, v0, h, an energy of a part, or None)."""
    q = dal.coordinates("x y1 y2 y3 z1 z2 z3")
    y, z = q[1:4], q[4:]
    V = (sum(c**2 for c in q) + z[0] ** 2 * z[1] ** 2 + sum(a**2 * b**2 for a, b in zip(y, z))) / 2
    unit = sp.eye(7)
    basis = [list(unit.row(i)) for i in (1, 2, 3)]
    basis += [[-y[i], 0, 0, 0, *unit.row(4 + i)[4:]] for i in range(3)]
    out = {"chaotic quartic": (quartic(), OnDual(q, [1] * 7, V, basis),
                               *data(np.arange(10) * np.pi / 18), 0.1, None)}  # fmt: skip

    q = x, y, s = dal.coordinates("x y theta")  # of the centre of mass, the blade 1 behind it
    c, d = sp.cos(s), sp.sin(s)
    sleigh = dal.System.from_sympy((x.d**2 + y.d**2 + s.d**2) / 2, [-d * x.d + c * y.d - s.d])
    dual = OnDual(q, [1, 1, 1], sp.Integer(0), [[c, d, 0], [-d, c, 1]])
    out["Chaplygin sleigh"] = sleigh, dual, [[0.0, 0, 0]], [[0.0, 1, 1]], 0.1, None

    q = x, y, z = dal.coordinates("x y z")
    driver = -sp.cos(y) + sp.Rational(3, 10) * sp.sin(2 * y)
    V = driver + (x**2 + z**2) / 2
    gearbox = dal.System.from_sympy((x.d**2 + y.d**2 + z.d**2) / 2 - V, [x.d + sp.cos(y) * z.d])
    dual = OnDual(q, [1, 1, 1], V, [[0, 1, 0], [-sp.cos(y), 0, 1]])
    part = sp.lambdify([y, y.d], y.d**2 / 2 + driver)
    out["gearbox, turning"] = gearbox, dual, [[1.0, 0, 0.3]], [[-0.4, 3.0, 0.4]], 0.1, part
    return out


def run(quick: bool) -> tuple[list[common.Row], Any]:
    """Return the rows, and what is drawn."""
    rows, drawn, check = [], {}, 2.0
    for name, (system, dual, q0, v0, h, part) in systems().items():
        q0, v0 = np.asarray(q0), np.asarray(v0)
        start = dual.state(q0, v0)
        steps, n = (500 if quick else 20000), dual.n
        # the reference, at t = 2, and the error of each method there
        ends = [solve_ivp(lambda t, w: dual.field(w[:, None])[:, 0], (0, check), w, "DOP853",
                          rtol=1e-12, atol=1e-13).y[:, -1] for w in start.T]  # fmt: skip
        exact = np.array(ends).T

        w, path = start, [start]
        for _ in range(steps):
            w = dual.step(w, h)
            path.append(w)
        paths = np.array(path)  # (rows, n + k, members)
        energy = np.array([dual.energy(w) for w in path])
        at = round(check / h)
        off = {"discrete gradient": abs(path[at][:n] - exact[:n]).max()}
        most, slips = {"discrete gradient": abs(energy - energy[0]).max()}, {}
        errors = abs(energy - energy[0])
        kinds = {"discrete gradient": (h * np.arange(steps + 1), errors.max(axis=1))}
        if part is not None:
            rate = np.array([dual.velocity(w)[1] for w in path])
            slips["discrete gradient"] = part(paths[:, 1], rate)[:, 0]
        for scheme in SCHEMES:
            with warnings.catch_warnings():  # that the energy drifts, which is the subject
                warnings.simplefilter("ignore", dal.DalembertWarning)
                runs = [dal.integrate(system, scheme, a, b, h=h, steps=steps, progress=False,
                                      check_h=False)
                        for a, b in zip(q0, v0)]  # fmt: skip
            off[scheme] = max(abs(r.q[at] - e[:n]).max() for r, e in zip(runs, exact.T))
            errors = np.array([abs(r.energy - r.energy[0]) for r in runs])
            kinds[scheme], most[scheme] = (runs[0].t, errors.max(axis=0)), errors.max()
            if part is not None:
                slips[scheme] = part(runs[0].q[:, 1], runs[0].v[:, 1])
        drawn[name] = kinds
        if slips:
            drawn["energy of the driver"] = {
                s: (kinds[s][0], abs(e - e[0])) for s, e in slips.items()}  # fmt: skip
        what = f"{name}, h = {h:g}"
        rows.append(common.holds(
            f"{what}: discrete gradient, max |E - E(0)| to t = {h * steps:g}", "exact",
            f"{most['discrete gradient']:.0e}", most["discrete gradient"] < 1e-9,
            "below 1e-9"))  # fmt: skip
        drifts = part is not None and not quick  # where it has had the time
        rows.append(common.holds(
            f"{what}: the same of our schemes", "not exact",
            ", ".join(f"{s} {most[s]:.1e}" for s in SCHEMES),
            most["leapfrog"] > 0.3 if drifts else 1e-9 < most["leapfrog"] < 0.2,
            "leapfrog above 0.3: drifts" if drifts
            else "leapfrog below 0.2, above 1e-9"))  # fmt: skip
        rows.append(common.holds(
            f"{what}: error of q at t = {check:g}, against DOP853", "independent",
            ", ".join(f"{s} {e:.1e}" for s, e in off.items()),
            off["discrete gradient"] > 10 * off["leapfrog-suzuki4"],
            "discrete gradient above 10 times suzuki4"))  # fmt: skip
        w = start
        for _ in range(2 * at):
            w = dual.step(w, h / 2)
        rows.append(common.near(
            f"{what}: order of the discrete gradient, from h and h/2", 2,
            np.log2(off["discrete gradient"] / abs(w[:n] - exact[:n]).max()), 0.3, digits=3,
            source="p"))  # fmt: skip
        if part is not None:
            moves = {s: np.ptp(e) for s, e in slips.items()}
            rows.append(common.holds(
                f"{what}: range of the energy of the driver, in truth constant", "-",
                ", ".join(f"{s} {e:.1e}" for s, e in moves.items()),
                moves["leapfrog"] < 0.05 and (quick or moves["discrete gradient"] > 1),
                "leapfrog below 0.05"
                + ("" if quick else ", discrete gradient above 1: drifts")))  # fmt: skip
    return rows, drawn


def draw(drawn: Any) -> Any:
    """Draw the largest error of the energy so far."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(drawn), figsize=(12, 3.6), layout="constrained")
    for ax, (name, kinds) in zip(axes, drawn.items()):
        for scheme, (t, error) in kinds.items():
            chosen = np.unique(np.geomspace(1, len(t) - 1, 150).astype(int))
            so_far = np.maximum.accumulate(error)[chosen]
            ax.loglog(t[chosen], np.maximum(so_far, 1e-17), lw=1.2, label=scheme)
        ax.set(xlabel="t", title=name)
    axes[0].set_ylabel("largest |E - E(0)| so far")
    axes[0].legend(fontsize=7)
    return figure


if __name__ == "__main__":
    common.main(run, draw)
