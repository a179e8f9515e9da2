"""Systems and formulas that the tests of the Python package share.

The formulas are transcribed into NumPy from the definitions, so that what the core computes is
compared with something computed another way.
"""

import numpy as np
import pytest

import dalembert as dal

U = 2.0**-53  # unit roundoff


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

    def forms(self, q):
        self.calls += 1
        return np.array(
            [[-np.sin(q[2]), np.cos(q[2]), 0.3 * q[3], 0.0], [q[1], 0.0, 1.0, np.cos(q[0])]]
        )

    def forms_velocity_derivative(self, q, v):
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
            "forms": self.forms,
            "forms_velocity_derivative": self.forms_velocity_derivative,
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
        mu = self.forms(q)
        Z = np.linalg.solve(self.mass, mu.T)
        return v - Z @ np.linalg.solve(mu @ Z, mu @ v)

    def acceleration(self, q, v):
        """vdot and lambda from the saddle point system [[M, -mu^T], [mu, 0]]."""
        mu = self.forms(q)
        A = np.block([[self.mass, -mu.T], [mu, np.zeros((2, 2))]])
        b = np.concatenate([-self.gradient(q), -self.forms_velocity_derivative(q, v) @ v])
        x = np.linalg.solve(A, b)
        return x[:4], x[4:]

    def beta_step(self, beta, h, q, v):
        """One step of the beta-scheme by Newton on all n + m unknowns: q, v and lambda."""
        qk = q + (1 - beta) * h * v
        muk, g0 = self.forms(qk), self.gradient(q)
        w, kappa = v.copy(), np.zeros(2)
        for _ in range(12):
            q1 = qk + beta * h * w
            mu = self.forms(q1)
            kick = h * ((1 - beta) * self.gradient(q1) + beta * g0)
            R = np.concatenate([self.mass @ (w - v) + kick - muk.T @ kappa, mu @ w])
            K = self.mass + h**2 * beta * (1 - beta) * self.hessian(q1)
            B = mu + beta * h * self.forms_velocity_derivative(q1, w)
            d = np.linalg.solve(np.block([[K, -muk.T], [B, np.zeros((2, 2))]]), -R)
            w, kappa = w + d[:4], kappa + d[4:]
        return qk + beta * h * w, w, kappa / h

    def residual(self, q, v):
        """Largest |mu^a v| / sum_i |mu^a_i v_i|."""
        mu = self.forms(q)
        return float(np.max(np.abs(mu @ v) / (np.abs(mu) @ np.abs(v))))


@pytest.fixture
def own():
    return Own()


@pytest.fixture
def particle():
    return dal.systems.particle()


def particle_forms(q):
    return np.array([[-q[1], 0.0, 1.0]])


def particle_derivative(q, v):
    return np.array([[0.0, -v[0], 0.0]])


@pytest.fixture
def particle_in_python():
    """The particle with Python functions; its runs have the bits of the built-in one."""
    return dal.System(
        mass=[1, 1, 1],
        forms=particle_forms,
        forms_velocity_derivative=particle_derivative,
        coordinates=["x", "y", "z"],
        q0=[0.5, 0.3, -0.2],
        v0=[1, 0.7, 0.3],
        name="particle",
    )
