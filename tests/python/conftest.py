"""Systems and formulas that the tests of the Python package share.

The formulas are transcribed into NumPy from the definitions, so that what the core computes is
compared with something computed another way.
"""

import io
import os
import signal
from html.parser import HTMLParser

import numpy as np
import pytest

import dalembert as dal
from dalembert import compiler

os.environ["MPLBACKEND"] = "Agg"  # pictures without windows

U = 2.0**-53  # unit roundoff


def relative_residual(M, mu, v, phi=None, moves=0.0):
    """Largest |phi^a| / (sum_i |mu^a_i| d_i max_j |v_j| / d_j + |phi^a - mu^a v| + moves^a).

    d_i = sqrt((M^-1)_ii), and phi = mu v if it is not given; moves^a = sum_i |dphi^a/dq_i q_i|
    where phi is not linear or mu depends on v, for nodes that are kept.
    """
    d = np.sqrt(np.diag(np.linalg.inv(M)))
    linear = mu @ v
    phi = linear if phi is None else phi
    size = np.abs(mu) @ d * np.max(np.abs(v) / d) + np.abs(phi - linear) + moves
    return float(np.max(np.abs(phi) / size))


class Own:
    """A system in R^4 with two constraints, a full mass matrix and a quartic potential.

    Its functions are methods, so that it pickles, and count how often they are called.
    """

    n, m = 4, 2
    mass = np.array(
        [[2.0, 0.3, 0.0, 0.1], [0.3, 1.5, 0.2, 0.0], [0.0, 0.2, 1.0, 0.1], [0.1, 0.0, 0.1, 0.8]]
    )
    stiffness = np.array([1.0, 0.5, 2.0, 1.5])
    q0 = np.array([0.3, -0.2, 0.4, 0.5])

    def __init__(self):
        self.calls = 0

    def potential(self, q):
        return float(self.stiffness @ q**2 / 2 + (q[0] * q[3]) ** 2 / 4)

    def gradient(self, q):
        self.calls += 1
        g = self.stiffness * q
        g[0] += q[0] * q[3] ** 2 / 2
        g[3] += q[3] * q[0] ** 2 / 2
        return g

    def hessian(self, q):
        H = np.diag(self.stiffness)
        H[0, 0] += q[3] ** 2 / 2
        H[3, 3] += q[0] ** 2 / 2
        H[0, 3] = H[3, 0] = q[0] * q[3]
        return H

    def mu(self, q):
        self.calls += 1
        return np.array(
            [[-np.sin(q[2]), np.cos(q[2]), 0.3 * q[3], 0.0], [q[1], 0.0, 1.0, np.cos(q[0])]]
        )

    def mu_v_q(self, q, v):
        return np.array(
            [
                [0.0, 0.0, -np.cos(q[2]) * v[0] - np.sin(q[2]) * v[1], 0.3 * v[2]],
                [-np.sin(q[0]) * v[3], v[0], 0.0, 0.0],
            ]
        )

    def system(self, **changes):
        """Return it as a System, with some arguments changed."""
        arguments = {
            "mass": self.mass,
            "mu": self.mu,
            "mu_v_q": self.mu_v_q,
            "potential": self.potential,
            "gradient": self.gradient,
            "hessian": self.hessian,
            "q0": self.q0,
            "v0": self.v0(),
            "name": "own",
            **changes,
        }
        return dal.System(**arguments)

    def v0(self):
        """Return a velocity in D at q0."""
        return self.project(self.q0, np.array([0.5, -0.3, 0.2, 0.4]))

    # ---- formulas --------------------------------------------------------------------------

    def project(self, q, v):
        """v - M^-1 mu^T C^-1 mu v."""
        mu = self.mu(q)
        Z = np.linalg.solve(self.mass, mu.T)
        return v - Z @ np.linalg.solve(mu @ Z, mu @ v)

    def acceleration(self, q, v):
        """vdot and lambda from the saddle point system [[M, -mu^T], [mu, 0]]."""
        mu = self.mu(q)
        A = np.block([[self.mass, -mu.T], [mu, np.zeros((2, 2))]])
        b = np.concatenate([-self.gradient(q), -self.mu_v_q(q, v) @ v])
        x = np.linalg.solve(A, b)
        return x[:4], x[4:]

    def beta_step(self, beta, h, q, v):
        """One step of the beta-scheme by Newton on all n + m unknowns: q, v and lambda."""
        qk = q + (1 - beta) * h * v
        muk, g0 = self.mu(qk), self.gradient(q)
        w, kappa = v.copy(), np.zeros(2)
        for _ in range(12):
            q1 = qk + beta * h * w
            mu = self.mu(q1)
            kick = h * ((1 - beta) * self.gradient(q1) + beta * g0)
            R = np.concatenate([self.mass @ (w - v) + kick - muk.T @ kappa, mu @ w])
            K = self.mass + h**2 * beta * (1 - beta) * self.hessian(q1)
            B = mu + beta * h * self.mu_v_q(q1, w)
            d = np.linalg.solve(np.block([[K, -muk.T], [B, np.zeros((2, 2))]]), -R)
            w, kappa = w + d[:4], kappa + d[4:]
        return qk + beta * h * w, w, kappa / h

    def residual(self, q, v):
        """See `relative_residual`."""
        return relative_residual(self.mass, self.mu(q), v)


@pytest.fixture
def in_python(monkeypatch):
    """Nothing is compiled: systems and laws from expressions run as Python functions."""
    monkeypatch.setattr(compiler, "library", lambda *_: None)
    with pytest.warns(dal.DalembertWarning, match="no C compiler"):
        yield


@pytest.fixture
def own():
    return Own()


@pytest.fixture
def particle():
    return dal.systems.particle()


def refused(cases, kind=ValueError):
    """Check that each call of (call, words) raises an error with these words."""
    for number, (call, words) in enumerate(cases):
        with pytest.raises(kind, match=words):
            call()
            pytest.fail(f"case {number}: {words}")


def runge_kutta(field, x, t_end, count):
    """Solve x' = field(t, x) from t = 0 by the classical method of order 4."""
    h = t_end / count
    for k in range(count):
        t = k * h
        k1 = field(t, x)
        k2 = field(t + h / 2, x + h / 2 * k1)
        k3 = field(t + h / 2, x + h / 2 * k2)
        k4 = field(t + h, x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


@pytest.fixture
def ctrl_c():
    """SIGINT raises KeyboardInterrupt, also where the tests run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def no_windows(monkeypatch):
    """Nothing is shown, and no figure is left open."""
    from matplotlib import pyplot

    monkeypatch.setattr(pyplot, "show", lambda *_, **__: pytest.fail("a picture was shown"))
    yield
    pyplot.close("all")


@pytest.fixture
def undrawn(monkeypatch):
    """Pictures on pages are empty, which takes no time; what is said about them stays."""
    from matplotlib.figure import Figure

    plain = Figure.savefig

    def save(figure, file, **options):
        if isinstance(file, io.StringIO):
            file.write("<svg ></svg>")
        else:
            plain(figure, file, **options)

    monkeypatch.setattr(Figure, "savefig", save)


def particle_forms(q):
    return np.array([[-q[1], 0.0, 1.0]])


def particle_derivative(q, v):
    return np.array([[0.0, -v[0], 0.0]])


@pytest.fixture
def particle_in_python():
    """The particle with Python functions; its runs have the bits of the built-in one."""
    return dal.System(
        mass=[1, 1, 1],
        mu=particle_forms,
        mu_v_q=particle_derivative,
        coordinates=["x", "y", "z"],
        q0=[0.5, 0.3, -0.2],
        v0=[1, 0.7, 0.3],
        name="particle",
        steady=True,
    )


class General:
    """A system in R^3 with a Lagrangian of its own, a force, and a constraint of any kind.

    L = ((2 + sin x) u^2 + (2 + y^2/4) v^2 + 3 w^2)/2 + cos z u v/2 + w^4/24 + y w + sin x v
        - x^2 y - cos z.
    """

    q0 = np.array([0.4, 0.7, -0.3])
    lagrangians = (
        "lagrangian", "lagrangian_q", "lagrangian_v",
        "lagrangian_qq", "lagrangian_vq", "lagrangian_vv",
    )  # fmt: skip
    forces = ("force", "force_q", "force_v")
    constraints = {
        "linear": ("mu", "mu_v_q"),
        "affine": ("mu", "mu_v_q", "affine", "affine_derivative"),
        "nonlinear": ("constraint", "constraint_v", "constraint_q"),
    }

    def __init__(self, kind):
        self.kind = kind

    @property
    def functions(self):
        """Names of all functions of the system."""
        return (*self.lagrangians, *self.forces, *self.constraints[self.kind])

    def system(self, **changes):
        """Return it as a System, with some arguments changed."""
        arguments = {name: getattr(self, name) for name in self.functions}
        arguments |= {"q0": self.q0, "v0": self.v0(), "coordinates": "xyz", "name": "general"}
        return dal.System(**{**arguments, **changes})

    def v0(self):
        """Return a velocity in D at q0: phi = w - (what u and v tell)."""
        v = np.array([0.5, -0.6, 0.0])
        v[2] -= self.phi(self.q0, v)[0]
        return v

    # ---- functions of the system -----------------------------------------------------------

    def lagrangian(self, q, qdot):
        (x, y, z), (u, v, w) = q, qdot
        kinetic = (2 + np.sin(x)) * u**2 / 2 + (2 + y**2 / 4) * v**2 / 2 + 3 * w**2 / 2
        kinetic += np.cos(z) * u * v / 2 + w**4 / 24 + y * w + np.sin(x) * v
        return kinetic - x**2 * y - np.cos(z)

    def lagrangian_q(self, q, qdot):
        (x, y, z), (u, v, w) = q, qdot
        return np.array(
            [
                np.cos(x) * u**2 / 2 + np.cos(x) * v - 2 * x * y,
                y * v**2 / 4 + w - x**2,
                np.sin(z) - np.sin(z) * u * v / 2,
            ]
        )

    def lagrangian_v(self, q, qdot):
        (x, y, z), (u, v, w) = q, qdot
        return np.array(
            [
                (2 + np.sin(x)) * u + np.cos(z) * v / 2,
                (2 + y**2 / 4) * v + np.cos(z) * u / 2 + np.sin(x),
                3 * w + w**3 / 6 + y,
            ]
        )

    def lagrangian_qq(self, q, qdot):
        (x, y, z), (u, v, _) = q, qdot
        first = -np.sin(x) * u**2 / 2 - np.sin(x) * v - 2 * y
        last = np.cos(z) - np.cos(z) * u * v / 2
        return np.array([[first, -2 * x, 0.0], [-2 * x, v**2 / 4, 0.0], [0.0, 0.0, last]])

    def lagrangian_vq(self, q, qdot):
        (x, y, z), (u, v, _) = q, qdot
        return np.array(
            [
                [np.cos(x) * u, 0.0, -np.sin(z) * v / 2],
                [np.cos(x), y * v / 2, -np.sin(z) * u / 2],
                [0.0, 1.0, 0.0],
            ]
        )

    def lagrangian_vv(self, q, qdot):
        (x, y, z), w = q, qdot[2]
        c = np.cos(z) / 2
        return np.array(
            [[2 + np.sin(x), c, 0.0], [c, 2 + y**2 / 4, 0.0], [0.0, 0.0, 3 + w**2 / 2]]
        )

    def force(self, t, q, qdot):
        (x, y, z), (u, v, w) = q, qdot
        return np.array([np.cos(t) - x * v, y - v**3 / 3, -u * w * np.sin(z)])

    def force_q(self, t, q, qdot):
        z, (u, v, w) = q[2], qdot
        return np.array([[-v, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -u * w * np.cos(z)]])

    def force_v(self, t, q, qdot):
        (x, _, z), (u, v, w) = q, qdot
        s = np.sin(z)
        return np.array([[0.0, -x, 0.0], [0.0, -(v**2), 0.0], [-w * s, 0.0, -u * s]])

    def mu(self, q):
        return np.array([[-np.sin(q[1]), -q[0], 1.0]])

    def mu_v_q(self, q, qdot):
        return np.array([[-qdot[1], -np.cos(q[1]) * qdot[0], 0.0]])

    def affine(self, q):
        return np.array([-np.cos(q[2])])

    def affine_derivative(self, q):
        return np.array([[0.0, 0.0, np.sin(q[2])]])

    def constraint(self, q, qdot):
        (x, y, _), (u, v, w) = q, qdot
        return np.array([w - (1 + x**2) * np.sqrt(1 + u**2 + (y * v) ** 2)])

    def constraint_v(self, q, qdot):
        (x, y, _), (u, v, _) = q, qdot
        factor = -(1 + x**2) / np.sqrt(1 + u**2 + (y * v) ** 2)
        return np.array([[factor * u, factor * y**2 * v, 1.0]])

    def constraint_q(self, q, qdot):
        (x, y, _), (u, v, _) = q, qdot
        root = np.sqrt(1 + u**2 + (y * v) ** 2)
        return np.array([[-2 * x * root, -(1 + x**2) * y * v**2 / root, 0.0]])

    # ---- formulas --------------------------------------------------------------------------

    def phi(self, q, v):
        if self.kind == "nonlinear":
            return self.constraint(q, v)
        return self.mu(q) @ v + (self.affine(q) if self.kind == "affine" else 0.0)

    def phi_v(self, q, v):
        return self.constraint_v(q, v) if self.kind == "nonlinear" else self.mu(q)

    def phi_q(self, q, v):
        if self.kind == "nonlinear":
            return self.constraint_q(q, v)
        shift = self.affine_derivative(q) if self.kind == "affine" else 0.0
        return self.mu_v_q(q, v) + shift

    def energy(self, q, v):
        return self.lagrangian_v(q, v) @ v - self.lagrangian(q, v)

    def acceleration(self, t, q, v):
        """vdot and lambda from the saddle point system [[L_vv, -phi_v^T], [phi_v, 0]]."""
        mu = self.phi_v(q, v)
        A = np.block([[self.lagrangian_vv(q, v), -mu.T], [mu, np.zeros((1, 1))]])
        f = self.lagrangian_q(q, v) - self.lagrangian_vq(q, v) @ v + self.force(t, q, v)
        x = np.linalg.solve(A, np.concatenate([f, -self.phi_q(q, v) @ v]))
        return x[:3], x[3:]

    def beta_step(self, beta, t, h, q, v):
        """One step of the beta-scheme from its equations alone: q, v and lambda."""
        qk = q + (1 - beta) * h * v

        def total(t, q, v):
            return self.lagrangian_q(q, v) + self.force(t, q, v)

        def equations(unknowns):
            w, kappa = unknowns[:3], unknowns[3:]
            q1 = qk + beta * h * w
            kick = h * ((1 - beta) * total(t + h, q1, w) + beta * total(t, q, v))
            change = self.lagrangian_v(q1, w) - self.lagrangian_v(q, v)
            react = self.phi_v(qk, (v + w) / 2).T @ kappa
            return np.concatenate([change - kick - react, self.phi(q1, w)])

        unknowns, d = np.concatenate([v, [0.0]]), 1e-5
        for _ in range(12):  # the differenced Jacobian makes it converge linearly, by 1e-9 or so
            columns = [
                (equations(unknowns + d * e) - equations(unknowns - d * e)) / (2 * d)
                for e in np.eye(4)
            ]
            unknowns = unknowns - np.linalg.solve(np.transpose(columns), equations(unknowns))
        return qk + beta * h * unknowns[:3], unknowns[:3], unknowns[3:] / h

    def residual(self, q, v):
        """See `relative_residual`."""
        M, mu = self.lagrangian_vv(q, v), self.phi_v(q, v)
        if self.kind == "linear":
            return relative_residual(M, mu, v)
        return relative_residual(M, mu, v, self.phi(q, v), abs(self.phi_q(q, v)) @ abs(q))


KINDS = ("linear", "affine", "nonlinear")


@pytest.fixture(params=KINDS)
def general(request):
    return General(request.param)


VOID = {"meta", "br", "hr", "img", "link", "input"}


class Page(HTMLParser):
    """Collects ids, links, tables and text, and checks that tags are closed in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.tags, self.links, self.rows = [], [], [], [], []
        self.words = ""
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.ids += [value for key, value in attrs if key == "id"]
        self.links += [value for key, value in attrs if key == "href" and tag == "a"]
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.ids += [value for key, value in attrs if key == "id"]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" in self.open or "title" in self.open or "svg" in self.open:
            return
        self.words += data
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data

    def cell(self, first, column=1):
        """The entry of the first row that begins like this."""
        return next(row[column] for row in self.rows if row and row[0].startswith(first))
