"""The built-in systems, written a second time with SymPy, against those written in C.

The twins are written from the mechanics: velocities of points, kinetic minus potential energy.
What the C files have as expanded derivatives comes from differentiation here.
"""

import numpy as np
import pytest
import sympy
from conftest import U
from sympy import Rational, cos, sin

import dalembert as dal
from dalembert import compiler, core


def square(*components):
    return sum(c**2 for c in components)


def free(q):
    """Kinetic energy of mass 1 in every direction."""
    return square(*(x.d for x in q)) / 2


def springs(q, *k):
    return sum(stiffness * x**2 for stiffness, x in zip(k, q)) / 2


# ---- L and phi of each, as functions of coordinates and parameters ----------------------------


def particle(q):
    x, y, z = q
    return free(q), [z.d - y * x.d]


def particle_oscillator(q, k1, k2, k3):
    x, y, z = q
    return free(q) - springs(q, k1, k2, k3), [z.d - y * x.d]


def heisenberg(q, k1, k2, k3):
    x, y, z = q
    return free(q) - springs(q, k1, k2, k3), [z.d - (x * y.d - y * x.d)]


def contact_oscillator(q, eps):
    x, y, z = q
    return free(q) - (square(x, y, z) + eps * x**2 * z**2) / 2, [x.d + y * z.d]


def chaotic(q, pairs):
    x, y, z = q[0], q[1:4], q[4:]
    V = (square(*q) + z[0] ** 2 * z[1] ** 2 + sum(a**2 * b**2 for a, b in zip(y, z))) / 2
    return free(q) - V, [x.d + sum(a * b.d for a, b in zip(y, z))]


def genmass(q):
    q1, q2, q3 = q
    M = sympy.Matrix(
        [
            [2 + q2**2 / 4, q3 / 5, Rational(1, 10)],
            [q3 / 5, Rational(3, 2) + cos(q1) / 3, q1 / 6],
            [Rational(1, 10), q1 / 6, 1 + q1**2 / 3],
        ]
    )
    v = sympy.Matrix([x.d for x in q])
    b = sympy.Matrix([q2 * q3 / 4, sin(q1) / 3, -q1 * q2 / 5])
    V = springs(q, 1, 2, Rational(3, 2)) + q1**4 / 4 + q1 * q2 * q3 / 5
    L = (v.T * M * v)[0] / 2 + b.dot(v) - V
    return L, [[-q2, q1 / 2 + q3 / 4, 1 + q1**2 / 5]]


def knife_edge(q, m, J, gs):
    x, y, theta = q
    L = m * square(x.d, y.d) / 2 + J * theta.d**2 / 2 + m * gs * x
    return L, [sin(theta) * x.d - cos(theta) * y.d]


def sleigh(q, m, J, a):
    """The blade, at r - a e, does not move along the normal n of e."""
    x, y, theta = q
    blade = x.d + a * theta.d * sin(theta), y.d - a * theta.d * cos(theta)
    L = m * square(x.d, y.d) / 2 + J * theta.d**2 / 2
    return L, [-sin(theta) * blade[0] + cos(theta) * blade[1]]


def sleigh_contact(q, m, J, a):
    """The centre of mass is at r + a e."""
    x, y, theta = q
    centre = x.d - a * theta.d * sin(theta), y.d + a * theta.d * cos(theta)
    L = m * square(*centre) / 2 + J * theta.d**2 / 2
    return L, [-sin(theta) * x.d + cos(theta) * y.d]


def disk(q, m, I, J, R):
    x, y, theta, phi = q
    L = (m * square(x.d, y.d) + I * theta.d**2 + J * phi.d**2) / 2
    return L, [x.d - R * cos(phi) * theta.d, y.d - R * sin(phi) * theta.d]


def robot(q, m, I, J, R, k):
    x, y, phi, theta = q
    L = (m * square(x.d, y.d) + I * phi.d**2 + J * theta.d**2) / 2 - k * sin(theta)
    return L, [x.d - R * cos(phi) * theta.d, y.d - R * sin(phi) * theta.d]


def rolling_disc(q, m, r, A, C, g):
    """The centre moves with the roll in the plane of the disc, and with the lean across it."""
    x, y, alpha, beta, gamma = q
    spin = gamma.d + sin(beta) * alpha.d
    height = r * cos(beta)
    rise = height.diff(beta) * beta.d
    T = m * square(x.d, y.d, rise) + A * square(beta.d, cos(beta) * alpha.d) + C * spin**2
    along, across = r * spin, -height * beta.d
    return T / 2 - m * g * height, [
        x.d - along * cos(alpha) + across * sin(alpha),
        y.d - along * sin(alpha) - across * cos(alpha),
    ]


def ball_on_table(q, m, J, a, Omega):
    """r' + omega x (-a e_3), the velocity of the lowest point, is Omega e_3 x r."""
    x, y, *turns = q
    omega = sympy.Matrix([angle.d for angle in turns])
    up, r = sympy.Matrix([0, 0, 1]), sympy.Matrix([x, y, 0])
    lowest = sympy.Matrix([x.d, y.d, 0]) + omega.cross(-a * up) - (Omega * up).cross(r)
    return m * square(x.d, y.d) / 2 + J * square(*omega) / 2, list(lowest[:2])


def snakeboard(q, m, r, J0, J1):
    """The rotor turns by theta + psi; with the axles the inertia of all about the middle is m r^2.

    An axle stands at -r or r along the board, and does not move along its own normal.
    """
    x, y, theta, psi, phi = q
    board = m * square(x.d, y.d) + (m * r**2 - J0) * theta.d**2
    rest = J0 * (theta.d + psi.d) ** 2 + 2 * J1 * phi.d**2
    rows = []
    for place, heading in ((-r, theta + phi), (r, theta - phi)):
        axle = x.d - place * theta.d * sin(theta), y.d + place * theta.d * cos(theta)
        rows.append(sympy.expand_trig(cos(heading)) * axle[1]
                    - sympy.expand_trig(sin(heading)) * axle[0])  # fmt: skip
    return (board + rest) / 2, rows


def n_trailer(q, trailers, d, m, J):
    x, y, *headings = q
    place = sympy.Matrix([x, y])
    L, rows = 0, []
    for i, theta in enumerate(headings):
        e = sympy.Matrix([cos(theta), sin(theta)])
        if i > 0:
            place = place - d * e
        velocity = sum((place.diff(c) * c.d for c in q), sympy.zeros(2, 1))
        L += (m * velocity.dot(velocity) + J * theta.d**2) / 2
        rows.append(e[0] * velocity[1] - e[1] * velocity[0])
    return L, rows


TWINS = {
    make.__name__: make
    for make in (
        particle, particle_oscillator, heisenberg, contact_oscillator, chaotic, genmass,
        knife_edge, sleigh, sleigh_contact, disk, robot, rolling_disc, ball_on_table, snakeboard,
        n_trailer,
    )
}  # fmt: skip


def pair_of(name):
    """Return the system in C, and the one in SymPy with the same parameters."""
    in_c = dal.systems.get(name)
    q = dal.coordinates(in_c.coordinates)
    symbols = sympy.symbols(list(in_c.parameters))
    L, rows = TWINS[name](q, *symbols)
    values = dict(zip(symbols, in_c.parameters.values()))
    return in_c, dal.System.from_sympy(L, rows, q, values, name=name)


# ---- agreement ---------------------------------------------------------------------------------


def test_every_builtin_system_has_a_twin():
    assert set(TWINS) == {name for name in dal.systems.names()}


def forms(system, q):
    """Return mu(q): the residual of each unit velocity, without that of no velocity."""
    zero = system.residual(q, np.zeros(system.n))
    return np.array([system.residual(q, e) - zero for e in np.eye(system.n)]).T


@pytest.mark.parametrize("name", TWINS)
def test_twin(name, in_python):
    """What both compute at three states of D, and 100 steps from there.

    Callbacks of both are sums of a few terms of the size of the state or of the result, each
    within 64 u of its scale.  Where a linear system is solved, its matrix K has that error, and the
    solution the condition of K times that.  So has the end of 100 steps: they are a motion of one
    unit of time, in which errors add up like a random walk and hardly grow.
    """
    in_c, twin = pair_of(name)
    assert (twin.n, twin.m, twin.kind) == (in_c.n, in_c.m, in_c.kind)
    assert (twin.mass is None) == (in_c.mass is None)
    if in_c.mass is not None:
        np.testing.assert_allclose(twin.mass, in_c.mass, rtol=2 * U)
    source = np.random.default_rng(11)
    for _ in range(3):
        q = in_c.q0 + source.uniform(-0.3, 0.3, in_c.n)
        v = in_c.project(q, in_c.v0 + source.uniform(-0.3, 0.3, in_c.n))
        metric, mu = in_c.metric(q, v), forms(in_c, q)
        K = np.block([[metric, -mu.T], [mu, np.zeros((in_c.m, in_c.m))]])
        condition = np.linalg.cond(K)

        def near(what, *arguments, factor=1.0):
            one, other = (getattr(s, what)(*arguments) for s in (in_c, twin))
            size = max(1.0, np.abs(one).max())
            np.testing.assert_allclose(other, one, rtol=0, atol=64 * U * size * factor)

        near("metric", q, v)
        np.testing.assert_allclose(forms(twin, q), mu, rtol=0, atol=64 * U * max(1, abs(mu).max()))
        near("residual", q, source.uniform(-1, 1, in_c.n))
        near("energy", q, v)
        near("multipliers", q, v, factor=condition)
        near("acceleration", q, v, factor=condition)
        runs = [dal.integrate(s, "midpoint", q, v, h=0.01, steps=100) for s in (in_c, twin)]
        size = max(1.0, np.abs(runs[0].y).max())
        error = np.abs(runs[1].y - runs[0].y).max()
        assert error <= 64 * U * size * condition


# ---- the step routine of a model ---------------------------------------------------------------


# Constant masses with and without a potential, blades, masses and moments of q, affine
# constraints, as many coordinates as 7, and a system that is written in SymPy only.
ROUTINES = (
    "particle_oscillator", "chaotic", "sleigh", "robot", "genmass", "ball_on_table", "roller_racer",
)  # fmt: skip


@pytest.mark.parametrize("name", ROUTINES)
@pytest.mark.parametrize("scheme", ["leapfrog", "leapfrog-kl8", "leapfrog-mirror", "midpoint"])
def test_its_own_routine(name, scheme):
    """What is generated, with constants for what is 0 or 1, has the bits of the library's text.

    Where momenta enter they are computed by other expressions: 200 steps then agree like those of
    `test_twin`.
    """
    start, system = pair_of(name) if name in TWINS else [getattr(dal.systems, name)()] * 2
    ends = []
    for any_sizes in (False, True):
        stepper = dal.Stepper(system, scheme, start.q0, start.v0, h=0.02)
        if any_sizes:
            core.lib.dal__beta_any_sizes(stepper._handle)
        stepper.step(steps=200)
        ends.append(np.concatenate([stepper.x, stepper.reaction]))
    if system._model.derived.has_momenta:
        size = max(1.0, np.abs(ends[0]).max())
        np.testing.assert_allclose(*ends, rtol=0, atol=2**14 * U * size)
    else:
        np.testing.assert_array_equal(*ends)


def test_what_the_processor_has_changes_no_bit(monkeypatch, tmp_path):
    """A library that is compiled for this processor makes the steps of one for any."""
    monkeypatch.setenv("DALEMBERT_CACHE", str(tmp_path))
    runs = []
    for flags in (compiler.FLAGS, [flag for flag in compiler.FLAGS if "avx" not in flag]):
        monkeypatch.setattr(compiler, "FLAGS", tuple(flags))
        compiler._generator.cache_clear()
        built_in, twin = pair_of("sleigh_contact")
        start = built_in.q0, built_in.v0
        runs.append(dal.integrate(twin, "midpoint", *start, h=0.02, steps=500, stride=10))
    monkeypatch.undo()
    compiler._generator.cache_clear()
    np.testing.assert_array_equal(runs[0].q, runs[1].q)
    np.testing.assert_array_equal(runs[0].v, runs[1].v)
