"""The points of docs/errata.md, computed: `./dev shell python docs/errata.py`.

Every point of the paper that the library does not follow is evaluated twice, as printed and as
corrected, and both are compared with the library.  The entries of the table are errors or
quantities that must not vanish.  Errors have to vanish with a certain order in the step h (the
slope of their logarithm, as h^2.00) or altogether (0 is roundoff).  If an entry compares two
forms, the printed form comes first.

    python docs/errata.py              the whole table
    python docs/errata.py --only E7    the rows of one point, or of several
    python docs/errata.py --write      put the table into docs/errata.md
"""

from __future__ import annotations

import argparse
import functools
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.linalg import det, inv, norm, solve, svd

import dalembert as dal
from dalembert.show.table import Table, text

DOCUMENT = Path(__file__).with_name("errata.md")
BEGIN, END = "<!-- table: docs/errata.py --write -->", "<!-- end of table -->"

U = 2.0**-53
ROUNDOFF = 1e-12  # far above the roundoff of every quantity here, far below every error
H = 2.0 ** -np.arange(4, 10)  # steps of the slopes; local errors stay above 1e-10


# ---- rows ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """One line of the table: values of the two forms, and whether only the corrected one is right.

    "-" stands where the paper prints nothing that could be computed.
    """

    quantity: str
    printed: str
    corrected: str
    shown: bool

    @property
    def verdict(self) -> str:
        """Return the result of the row in words."""
        if not self.shown:
            return "NOT SHOWN"
        return "confirmed" if self.printed == "-" else "printed form fails"


def order(quantity: str, p: float, printed: Sequence[float], corrected: Sequence[float]) -> Row:
    """Compare the slopes of two errors at the steps H; the right one is p."""
    slopes = [np.polyfit(np.log2(H), np.log2(errors), 1)[0] for errors in (printed, corrected)]
    shown = abs(slopes[0] - p) > 0.5 and abs(slopes[1] - p) < 0.2
    return Row(quantity, *(f"h^{round(slope, 2) + 0.0:.2f}" for slope in slopes), shown)


def zero(quantity: str, printed: float | None, corrected: float, bound: float = ROUNDOFF) -> Row:
    """Compare two errors of which the right one is 0 up to the bound."""
    shown = corrected <= bound and (printed is None or printed > 5 * bound)
    return Row(quantity, _number(printed, bound), _number(corrected, bound), shown)


def nonzero(quantity: str, printed: float, corrected: float) -> Row:
    """Compare two quantities that must not vanish."""
    shown = printed <= ROUNDOFF and corrected > 1e-2
    return Row(quantity, _number(printed), _number(corrected), shown)


def _number(x: float | None, bound: float = ROUNDOFF) -> str:
    return "-" if x is None else "0" if x <= bound else f"{x:.2g}"


Rows = Iterator[Row]
POINTS: dict[str, tuple[str, Callable[[], Rows]]] = {}  # place in the paper, what computes it


def point(name: str, place: str) -> Callable[[Callable[[], Rows]], Callable[[], Rows]]:
    """Register a function that yields the rows of a point."""

    def register(rows: Callable[[], Rows]) -> Callable[[], Rows]:
        POINTS[name] = (place, rows)
        return rows

    return register


# ---- calculus ------------------------------------------------------------------------------


def along(f: Callable[[Any], Any], q: Any, d: Any) -> Any:
    """Return the derivative of f at q along d, by a complex step: exact to roundoff."""
    return f(q + 1e-30j * np.asarray(d)).imag / 1e-30


def along_twice(f: Callable[[Any], Any], q: Any, d: Any) -> Any:
    """Return the second derivative of f at q along d, to about 1e-9."""
    t = 1e-4
    return (along(f, q + t * d, d) - along(f, q - t * d, d)) / (2 * t)


def error(x: Any, y: Any = 0.0) -> float:
    """Return the largest component of a difference."""
    return float(np.max(np.abs(np.asarray(x) - y)))


# ---- systems -------------------------------------------------------------------------------

# Four coordinates, mu = (A(q), 1) with two constraints, a full mass matrix: nothing in it is
# symmetric, affine or diagonal by chance.
MASS = np.array(
    [
        [2, 1 / 5, 1 / 3, 1 / 10],
        [1 / 5, 3 / 2, -1 / 10, 1 / 4],
        [1 / 3, -1 / 10, 1, 1 / 5],
        [1 / 10, 1 / 4, 1 / 5, 5 / 4],
    ]
)
INVERSE = inv(MASS)


def connection(q: Any) -> Any:
    """Return A(q) of the system with four coordinates."""
    a, b, c, d = q
    return np.array(
        [
            [np.sin(b) / 2 + c**2 / 5, a * d / 3],
            [c / 4 + a**2 / 6, np.cos(a) / 3 + b * d / 7 + a * c / 5],
        ]
    )


def forms(q: Any) -> Any:
    """Return mu(q) of the system with four coordinates."""
    return np.hstack([connection(q), np.eye(2)])


def potential(q: Any) -> Any:
    """Return V(q) of the system with four coordinates."""
    a, b, c, d = q
    return (a**2 + 2 * b**2 + 1.5 * c**2 + d**2) / 2 + a * b * c / 5 + c**4 / 4


def gradient(q: Any) -> Any:
    """Return V_q of the system with four coordinates."""
    return np.array([along(potential, q, e) for e in np.eye(4)])


def bent(q: Any, d: Any, w: Any) -> Any:
    """Return Dmu(q)[d] w: mu differentiated along d, applied to w.  Not symmetric in d and w."""
    return along(forms, q, d) @ w


def bending(q: Any, w: Any) -> Any:
    """Return the matrix d(mu w)/dq."""
    return np.column_stack([bent(q, e, w) for e in np.eye(4)])


@functools.cache
def four(with_potential: bool = True) -> dal.System:
    """Return the system with four coordinates."""
    q0 = np.array([0.3, -0.2, 0.4, 0.5])
    free = np.array([1.0, -0.6])
    return dal.System(
        mass=MASS,
        mu=forms,
        mu_v_q=bending,
        potential=potential if with_potential else None,
        gradient=gradient if with_potential else None,
        name="four",
        q0=q0,
        v0=np.concatenate([free, -connection(q0) @ free]),
    )


def particle_forms(q: Any) -> Any:
    """Return mu(q) of the particle, for complex q too."""
    return np.array([[-q[1], 0, 1]])


particle = dal.systems.particle()
sleigh = dal.systems.sleigh()


def matrix(system: dal.System, q: Any) -> Any:
    """Return mu(q) of a system of the library, from mu(q) v for unit vectors v."""
    return system.residual(np.tile(q, (system.n, 1)), np.eye(system.n)).T


def step(
    system: dal.System, scheme: str, h: float, q: Any = None, v: Any = None, **options: Any
) -> tuple[Any, Any, Any]:
    """Return q, v and the scheme's own multiplier after one step."""
    run = dal.integrate(system, scheme, q, v, h=h, steps=1, **options)
    return run.q[1], run.v[1], run.reactions[0]


def flow(field: Callable[[Any], Any], x: Any, t: float) -> Any:
    """Return the state a time t after x, by Runge and Kutta: also for data that are not in D."""
    count = 16
    h = t / count
    for _ in range(count):
        k1 = field(x)
        k2 = field(x + h / 2 * k1)
        k3 = field(x + h / 2 * k2)
        k4 = field(x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def field(system: dal.System) -> Callable[[Any], Any]:
    """Return x -> (v, vdot) of a system, defined off D as well."""
    return lambda x: system.field(x[: system.n], x[system.n :])


# ---- the continuous problem ----------------------------------------------------------------


@point("E1", "theorem EUDAETh (i)")
def definite_on_the_kernel() -> Rows:
    mu = np.array([[0.0, 1.0]])  # phi = v_2, so that z = (1, 0)

    def determinant(*diagonal: float) -> float:
        return abs(float(det(np.block([[np.diag(diagonal), -mu.T], [mu, np.zeros((1, 1))]]))))

    yield nonzero(
        "saddle point determinant, phi = v_2: A = diag(0, 1) with <Az, z> = 0; A = diag(1, 0)",
        determinant(0, 1),
        determinant(1, 0),
    )


@point("E2", "lemma lemmaMinv, eq. ODEPert2")
def perturbed_field() -> Rows:
    system = four()
    q, v, small = system.q0, system.v0, 0.01  # small: eps^p
    push_q, push_v = np.random.default_rng(1).standard_normal((2, 4))
    mu = forms(q)
    Z, gram = INVERSE @ mu.T, system.gram(q)
    projector = Z @ solve(gram, mu)
    saddle = np.block([[MASS, -mu.T], [mu, np.zeros((2, 2))]])
    forces = small * MASS @ push_v - gradient(q)
    exact = solve(saddle, np.concatenate([forces, -bent(q, v + small * push_q, v)]))[:4]
    short = system.acceleration(q, v) - small * Z @ solve(gram, bent(q, push_q, v))
    whole = short + small * (push_v - projector @ push_v)
    trace = np.trace(projector)
    text = "trace of m^-1 mu^T C^-1 mu against n (of m^-1 m), against m (of the projector)"
    yield zero(text, abs(trace - system.n), abs(trace - system.m))
    text = "acceleration / eps^p against the saddle point system, ODEPert2 and ODEPert"
    yield zero(text, error(short, exact) / small, error(whole, exact) / small)
    text = "particle, beta = 0, h = 0.2: period map of ODEPert2, of ODEPert, with g~, against Phi"
    start, end = np.concatenate([particle.q0, particle.v0]), step(particle, "explicit", 0.2)[:2]
    misses = (
        error(flow(perturbed_particle(0.2, printed), [*start, 0.0], 0.2)[:6], np.concatenate(end))
        for printed in (True, False)
    )
    yield zero(text, *misses, 1e-5)  # the period is integrated in 16 steps of order 4


def perturbed_particle(h: float, printed: bool) -> Callable[[Any], Any]:
    """Return the field of (q, v, t) for beta = 0 and ghat = g~, by ODEPert2 or by ODEPert."""
    embedding = dal.embedding(particle, "explicit", h)

    def of(x: Any) -> Any:
        q, v, t = x[:3], x[3:6], x[6]
        push = embedding.g_tilde(t / h, embedding.chart.drop(q, v))
        if printed:
            push[3:] = 0.0
        return np.append(particle.perturbed(q, v, push, weight=h)[0], 1.0)

    return of


@point("E13", "proof of lemma lemmaC")
def gram_matrix() -> Rows:
    flat = dal.System(mass=1.0, n=3, mu=lambda q: [[1, 0, 0], [0, 1, 0]])
    C = flat.gram([0, 0, 0])
    yield nonzero(
        "mu = first two unit vectors: least |<mu^a, Z^b>|, least eigenvalue of C",
        float(np.abs(C).min()),
        float(np.linalg.eigvalsh(C).min()),
    )


# ---- discrete mechanics --------------------------------------------------------------------


@point("E15", "proposition REG")
def regularity() -> Rows:
    system, h = four(False), 0.1
    q, v = system.q0, system.v0
    second = forms(q + h / 2 * v) + h / 2 * bending(q + h / 2 * v, v)  # h D2 phi_d at (q, q + h v)
    right, left = (svd(mu)[2][2:] for mu in (forms(q), second))  # bases of D, of its kernel
    pairing = left @ MASS @ right.T  # -h D2D1L_d of midpoint, because V = 0
    functional = pairing[0]  # of the first w; n - m = 2, so that some v in D is orthogonal to it
    blind = np.array([-functional[1], functional[0]]) / norm(functional)
    yield nonzero(
        "h |<D2D1L_d w, v>|: least over unit v in D; largest, for the worst unit w",
        abs(float(functional @ blind)),
        float(svd(pairing)[1].min()),
    )
    # y = -1, h v_y = 2: y' = 1 and mu(q~') mu(q_k)^T = 1 + y y' = 0.
    singular = ([0, -1, 0], [1, 2, -1])
    try:
        step(particle, "endpoint", 1.0, *singular)
        refused = 1.0
    except dal.SingularError:
        refused = 0.0
    schur = matrix(particle, [0, 1, 0]) @ matrix(particle, [0, -1, 0]).T
    yield zero(
        "particle, beta = 1, y = -1, h v_y = 2: Schur complement; the library refuses the step",
        None,
        error(schur) + refused,
    )


@point("E17", "remark on the end points of the nodes")
def start_of_the_nodes() -> Rows:
    at_once, shifted = [], []
    q0, v0 = particle.q0, particle.v0
    end = np.concatenate(particle.exact(1.0))
    for h in H:
        for errors, q in ((at_once, q0 - h / 2 * v0), (shifted, q0)):
            options = {"h": h, "t_end": 1.0, "consistent": "project"}
            run = dal.integrate(particle, "midpoint", q, v0, **options)
            errors.append(error(run.x[-1], end))
    text = "particle, midpoint at t = 1: q_0 = q~_0, and q_0 = q~_0 + h v_0 / 2"
    yield order(text, 2, at_once, shifted)


# ---- the scheme (1,0) ----------------------------------------------------------------------


@point("E5", "decomposition after proposition firstorder")
def decomposition_of_explicit() -> Rows:
    system = four()
    q, v = system.q0, system.v0
    reaction = (INVERSE @ forms(q).T @ system.multipliers(q, v))[:2]
    kick = (INVERSE @ gradient(q))[:2]
    minus, plus = [], []
    for h in H:
        after = step(system, "explicit", h)[1][:2]
        minus.append(error(v[:2] - h * kick - h * reaction, after))
        plus.append(error(v[:2] - h * kick + h * reaction, after))
    yield order("v^a_{k+1} against the scheme, reaction with sign - and +", 2, minus, plus)


@point("E9", "eq. LamExp, estimate in proposition firstorder")
def derivative_of_the_multiplier() -> Rows:
    system, t = four(), 1e-5
    q, v = system.q0, system.v0
    vdot, gram = system.acceleration(q, v), system.gram(q)

    def difference(dq: Any, dv: Any) -> Any:
        ends = (system.multipliers(q + s * dq, v + s * dv) for s in (t, -t))
        return np.subtract(*ends) / (2 * t)

    # The printed term is 2 (d_j mu_i) v vdot: either vector may be the direction.
    readings = [2 * bent(q, v, vdot), 2 * bent(q, vdot, v)]
    right = bent(q, v, vdot) + bent(q, vdot, v)
    exact, fixed = difference(v, vdot), difference(v, 0.0)
    yield zero(
        "d lambda/dt along the flow, the better reading of the printed term",
        min(error(fixed - solve(gram, term), exact) for term in readings),
        error(fixed - solve(gram, right), exact),
        1e-8,  # of the difference quotients
    )
    second = along_twice(forms, q, v) @ v
    slopes: list[list[float]] = [[], [], []]
    for h in H:
        gap = system.multipliers(*dal.reference(system, t=h)[:2]) - step(system, "explicit", h)[2]
        for errors, term in zip(slopes, (*readings, right)):
            errors.append(error(gap + h * solve(gram, second / 2 + term)))
    better = min(slopes[:2], key=lambda errors: errors[-1])
    yield order("lambda(t_k + h) - lambda_{k+1} minus its leading term", 2, better, slopes[2])


# ---- the scheme (2,0) ----------------------------------------------------------------------


@point("E3", "eq. DAELd2c")
def missing_step() -> Rows:
    system = four()
    q, v = system.q0, system.v0
    impulse, force = [], []
    for h in H:
        q1, v1, _ = step(system, "midpoint", h)
        momentum = MASS @ (v1 - v) + h / 2 * (gradient(q) + gradient(q1))
        kappa = np.linalg.lstsq(forms(q + h / 2 * v).T, momentum, rcond=None)[0]
        impulse.append(error(kappa, system.multipliers(q, v)))
        force.append(error(kappa / h, system.multipliers(q, v)))
    yield order("multiplier solved from DAELd2c against lambda(q, v)", 1, impulse, force)


@point("E4", "after eq. DAELd2, 'becomes explicit'")
def one_linear_solve() -> Rows:
    h, q, v = 0.1, sleigh.q0, sleigh.v0
    node = q + h / 2 * v
    Z = inv(sleigh.mass) @ matrix(sleigh, node).T
    mu = matrix(sleigh, node + h / 2 * v)
    w = v - Z @ solve(mu @ Z, mu @ v)
    q1, v1, _ = step(sleigh, "midpoint", h)
    yield zero(
        "sleigh (V = 0), h = 0.1: |mu v| after one linear solve, after the library's step",
        error(sleigh.residual(node + h / 2 * w, w)),
        error(sleigh.residual(q1, v1)),
    )


@point("E6", "decomposition after proposition secondorder")
def decomposition_of_midpoint() -> Rows:
    names = ("place", "exact", "middle", "end", "bare", "pulled")
    errors: dict[str, list[float]] = {name: [] for name in names}
    free, loaded = four(False), four()
    q, v = free.q0, free.v0

    def series(node: Any, w: Any, h: float) -> Any:
        bends = bent(q, v, v) / 2 + bent(node, w, w) / 2 + h / 4 * along_twice(forms, q, v) @ v
        return -solve(free.gram(node), bends)

    for h in H:
        node = q + h / 2 * v
        q1, v1, reaction = step(free, "midpoint", h)
        exact = dal.reference(free, t=h).q
        for name, at in (("place", node), ("exact", q1)):
            dependent = node[2:] - h / 2 * connection(at) @ v1[:2]
            errors[name].append(error(dependent, exact[2:]))
        there = np.concatenate([v1[:2], -connection(node) @ v1[:2]])
        errors["middle"].append(error(series(node, there, h), reaction))
        errors["end"].append(error(series(node, v1, h), reaction))
        q1, v1, reaction = step(loaded, "midpoint", h)
        pull = (gradient(q) + gradient(q1)) / 2
        bare = series(node, v1, h)
        errors["bare"].append(error(bare, reaction))
        bare += solve(free.gram(node), forms(node) @ INVERSE @ pull)
        errors["pulled"].append(error(bare, reaction))
    place, exact, middle, end, bare, pulled = errors.values()
    text = "local error of q~^alpha_{k+1}, with A(q~_{k+1/2}) and with A(q~_{k+1})"
    yield order(text, 3, place, exact)
    text = "lambda~ with A^gamma(q~_{k+1/2}) and with A^gamma(q~_{k+1}), against the scheme"
    yield order(text, 2, middle, end)
    text = "lambda~ for V != 0, without and with gradients, against the scheme"
    yield order(text, 2, bare, pulled)
    q1, v1, reaction = step(loaded, "midpoint", 0.1)
    moved = v + 0.1 * INVERSE @ forms(q + 0.05 * v).T @ reaction
    kick = 0.05 * INVERSE @ (gradient(q) + gradient(q1))
    text = "v^a_{k+1} for V != 0, h = 0.1, without and with gradients, against the scheme"
    yield zero(text, error(moved[:2], v1[:2]), error((moved - kick)[:2], v1[:2]))


@point("E8", "proof of proposition secondorder")
def sign_of_the_multiplier() -> Rows:
    lead = sleigh.multipliers(sleigh.q0, sleigh.v0)  # -C^-1 (v grad mu v), because V = 0
    plus, minus = [], []
    for h in H:
        reaction = step(sleigh, "midpoint", h)[2]
        plus.append(error(reaction, -lead))
        minus.append(error(reaction, lead))
    text = "sleigh: lambda_{k+1} against C^-1 (v grad mu v), against -C^-1 (...)"
    yield order(text, 1, plus, minus)


def truncated(
    mu: Callable[[Any], Any], mass: Any, q: Any, v: Any, h: float, end: Any, sign: int
) -> Any:
    """Return lambda_{k+1} by lamdaGR (V = 0); end: v and lambda after the step of the scheme."""
    v1, reaction = end
    node = q + h / 2 * v
    Z = solve(mass, mu(node).T)
    inverse = inv(mu(node) @ Z)
    R = -inverse @ along(mu, node, v1) @ Z @ inverse / 2
    bends = along(mu, q, v) @ v + h / 2 * along_twice(mu, q, v) @ v
    return -(inverse + h * R) @ (bends + sign * h / 2 * along(mu, node, Z @ reaction) @ v)


@point("E10", "eq. lamdaGR and the display after it")
def missing_plus() -> Rows:
    system = four(False)
    q, v = system.q0, system.v0
    minus, plus = [], []
    for h in H:
        end = step(system, "midpoint", h)[1:]
        minus.append(error(truncated(forms, MASS, q, v, h, end, -1), end[1]))
        plus.append(error(truncated(forms, MASS, q, v, h, end, 1), end[1]))
    yield order("lamdaGR against the scheme, last term with sign - and +", 2, minus, plus)


@point("E25", "'reduces to the standard trapezoidal rule'")
def trapezoidal_rule() -> Rows:
    flat = dal.System(mass=MASS, potential=potential, gradient=gradient)
    curved = dal.System(
        n=1,
        lagrangian=lambda q, v: (1 + q[0] ** 2) * v[0] ** 2 / 2,
        lagrangian_q=lambda q, v: q * v**2,
        lagrangian_v=lambda q, v: (1 + q**2) * v,
    )

    def residual(system: dal.System, q: Any, v: Any) -> float:
        run = dal.integrate(system, "midpoint", q, v, h=0.1, steps=1)
        forces = system.acceleration(run.q, run.v)
        return error(run.v[1] - run.v[0], 0.05 * forces.sum(axis=0))

    yield zero(
        "h = 0.1, m = 0: residual of the trapezoidal rule, mass 1 + q^2 and constant mass",
        residual(curved, [0.6], [0.8]),
        residual(flat, four().q0, four().v0),
    )


# ---- the particle --------------------------------------------------------------------------


@point("E7", "eqs. tildenodes0, tildenodes")
def moved_nodes() -> Rows:
    backward, trapezoidal = [], []
    for h in H:
        q1, v1, _ = step(particle, "midpoint", h)
        exact = particle.exact(h)[0]
        backward.append(np.abs(particle.q0 + h * v1 - exact))
        trapezoidal.append(np.abs(q1 - exact))
    for i, name in ((0, "x"), (2, "z")):
        printed, right = ([row[i] for row in errors] for errors in (backward, trapezoidal))
        text = f"local error of {name}~, with h v_{{k+1}} and with (h/2)(v_k + v_{{k+1}})"
        yield order(text, 3, printed, right)


@point("E11", "particle, 'employing the equation (lamdaGR)'")
def closed_form() -> Rows:
    h, q, v = 0.1, particle.q0, particle.v0
    end = step(particle, "midpoint", h)[1:]
    series = truncated(particle_forms, particle.mass, q, v, h, end, 1)
    worst = 0.0
    for beta, scheme in ((0.0, "explicit"), (0.5, "midpoint"), (1.0, "endpoint")):
        node, after = q[1] + (1 - beta) * h * v[1], q[1] + h * v[1]
        reaction = step(particle, scheme, h)[2]
        worst = max(worst, error(v[0] * v[1] / (1 + node * after), reaction))
    text = "h = 0.1: lambda_{k+1} by lamdaGR, by the displayed closed form, against the scheme"
    yield zero(text, error(series, end[1]), worst)


@point("E23", "eq. Facil, 'according to the results in the previous section'")
def endpoint_scheme() -> Rows:
    system = four()
    x = np.concatenate([system.q0, system.v0])
    back = step(system, "explicit", -0.1)[:2]
    again = np.concatenate(step(system, "endpoint", 0.1, *back)[:2])
    text = "h = 0.1: beta = 1 after beta = 0 with -h, against the identity on D"
    yield zero(text, None, error(again, x))
    study = dal.convergence(system, "endpoint", t_end=1.0, steps=[16, 32, 64, 128])
    text = "beta = 1 with V != 0: (p, s) fitted by the library against (1, 0), within 0.2"
    yield zero(text, None, max(abs(study.p - 1), abs(study.s)), 0.2)


@point("E12", "original nodes, 'from second to first'; last proposition")
def kept_nodes_from_D() -> Rows:
    system = four()
    q, n = system.q0, system.n
    errors: dict[str, tuple[list[float], list[float]]] = {"D": ([], []), "D_eps": ([], [])}
    for h in H:
        for initial, (velocity, multiplier) in errors.items():
            v = system.v0 if initial == "D" else system.project(q, system.v0, shift=h / 2)
            exact = flow(field(system), np.concatenate([q, v]), h)
            _, v1, reaction = step(system, "midpoint-nodes", h, q, v, initial=initial)
            velocity.append(error(v1, exact[n:]))
            multiplier.append(error(reaction, system.multipliers(exact[:n], exact[n:])))
    (v_D, lambda_D), (v_eps, lambda_eps) = errors.values()
    yield order("v after one step, data in D and in D_ε", 2, v_D, v_eps)
    yield order("multiplier of that step, data in D and in D_ε", 1, lambda_D, lambda_eps)
    h, q, (vx, vy, vz) = 0.1, particle.q0, particle.v0
    reaction = step(particle, "midpoint-nodes", h, initial="D")[2]
    y, middle = q[1], q[1] + h / 2 * vy
    text = "particle, h = 0.1, data in D: relative error of lambda_1 displayed, and in general form"
    displayed, general = vx * vy, (middle * vx - vz) / h
    ratios = [x / (1 + y * middle) / reaction[0] for x in (displayed, general)]
    yield zero(text, *(abs(ratio - 1) for ratio in ratios))
    study = dal.convergence(particle, "midpoint-nodes", initial="D", steps=[16, 32, 64, 128])
    text = "particle, data in D: slope of the error at t_end against 1, within 0.2"
    yield zero(text, None, abs(study.fits["global_state"].slope - 1), 0.2)


@point("E22", "'up to small bounded oscillatory variations'")
def constraint_along_a_run() -> Rows:
    h, steps = 0.05, 2000
    moved = dal.integrate(particle, "midpoint", h=h, steps=steps)
    kept = dal.integrate(particle, "midpoint-nodes", h=h, steps=steps, initial="shift")
    bound = 4 * particle.n * U
    yield zero(
        f"particle, h = 0.05: residual of D over {steps} steps, at q_k and at q~_k",
        *(float(particle.relative_residual(run.q, run.v).max()) for run in (kept, moved)),
        bound,
    )
    yield zero(
        "the same, h = 0.1, 1e5 steps: multiplier simplified by mu v_k = 0, residual form",
        swinging_particle(simplified=True),
        swinging_particle(simplified=False),
        bound,
    )


def swinging_particle(simplified: bool) -> float:
    """Return the worst relative residual of 1e5 midpoint steps; v_y is reflected at |y| = 2."""
    h, worst = 0.1, 0.0
    _, y, _ = particle.q0.tolist()
    vx, vy, vz = particle.v0.tolist()
    for _ in range(100_000):
        node, after = y + h / 2 * vy, y + h * vy
        kappa = h * vx * vy if simplified else after * vx - vz
        kappa /= 1 + after * node
        vx, vz, y = vx - kappa * node, vz + kappa, after
        size = (1 + abs(y)) * max(abs(vx), abs(vy), abs(vz))
        worst = max(worst, abs(vz - y * vx) / size)
        if abs(y) > 2 and y * vy > 0:
            vy = -vy
    return worst


@point("E24", "D_ε, remark deformation, eqs. DefCons and heps")
def deformed_constraint() -> Rows:
    system, h = four(), 0.1
    v = system.project(system.q0, system.v0, shift=h / 2)
    run = dal.integrate(
        system, "midpoint-nodes", system.q0, v, h=h, steps=20, initial="D_eps"
    )
    first_order = [forms(q) @ v - h / 2 * bent(q, v, v) for q, v in zip(run.q, run.v)]
    text = "h = 0.1, 20 steps: mu v - (h/2) Dmu[v]v, and mu(q - h v/2) v"
    yield zero(text, error(first_order), error(system.residual(run.q, run.v, shift=h / 2)))
    q0, v0, n = particle.q0, particle.v0, 3
    deformed, conjugate = [], []
    for h in H:
        v = particle.project(q0, v0, shift=h / 2)
        x = np.concatenate(step(particle, "midpoint-nodes", h, q0, v, initial="D_eps")[:2])
        start = np.concatenate([q0, v])
        deformed.append(error(flow(field(deformed_particle(h / 2)), start, h), x))
        start[:n] -= h / 2 * v
        exact = np.concatenate(particle.exact(h, start[:n], v))
        exact[:n] += h / 2 * exact[n:]
        conjugate.append(error(exact, x))
    text = "particle, one step at original nodes against heps on D_{h/2}, against S F S^-1"
    yield order(text, 3, deformed, conjugate)
    system, v = deformed_particle(0.05), particle.project(q0, v0, shift=0.05)
    power = v @ system.acceleration(q0, v)
    text = "particle, heps on D_{h/2}, h = 0.1: dE/dt against lambda_delta delta v_x v_y"
    yield zero(text, None, abs(power - system.multipliers(q0, v)[0] * 0.05 * v[0] * v[1]))


def deformed_particle(delta: float) -> dal.System:
    """Return the particle on D_delta, v_z - y v_x + delta v_x v_y = 0."""
    return dal.System(
        mass=[1, 1, 1],
        constraint=lambda q, v: [v[2] - q[1] * v[0] + delta * v[0] * v[1]],
        constraint_v=lambda q, v: [[-q[1] + delta * v[1], delta * v[0], 1]],
        constraint_q=lambda q, v: [[0, -v[0], 0]],
        m=1,
    )


# ---- the table -----------------------------------------------------------------------------

TITLES = ("point", "place", "quantity", "printed form", "corrected form", "verdict")


def table(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the rows of some points as text, in the order of their numbers."""
    return [
        (name, POINTS[name][0], row.quantity, row.printed, row.corrected, row.verdict)
        for name in sorted(names, key=lambda name: int(name[1:]))
        for row in POINTS[name][1]()
    ]


def markdown(rows: Sequence[tuple[str, ...]]) -> str:
    """Return the rows as a table of Markdown, in which nothing looks like emphasis."""
    lines = [TITLES, ("---",) * len(TITLES)]
    lines += [tuple(re.sub(r"([|_~*<])", r"\\\1", cell) for cell in row) for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def write(rows: Sequence[tuple[str, ...]]) -> None:
    """Put the table into the document, between its two marks."""
    text = DOCUMENT.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    after = rest.split(END)[1]
    DOCUMENT.write_text(f"{before}{BEGIN}\n{markdown(rows)}\n{END}{after}", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Compute the points of docs/errata.md.")
    parser.add_argument("--only", nargs="+", choices=sorted(POINTS), metavar="POINT",
                        help="these points only, such as E7")
    parser.add_argument("--write", action="store_true", help="put the table into docs/errata.md")
    options = parser.parse_args(arguments)
    if options.write and options.only:
        parser.error("--write: the document holds all points, without --only")
    rows = table(options.only or list(POINTS))
    print(text(Table(list(TITLES), rows, len(TITLES)).lines(sys.maxsize)))
    if options.write:
        write(rows)
    return 0 if all("NOT SHOWN" not in row for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
