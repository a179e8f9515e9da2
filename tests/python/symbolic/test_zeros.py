"""What is zero: only what is proved to be, and so are the entries that a step routine leaves out.

Walls, pieces and numbers of any size are compiled.
"""

import functools
import random
import re

import mpmath
import numpy as np
import pytest
import sympy
from conftest import U
from sympy import (
    Abs, Float, Heaviside, Max, Min, Piecewise, Rational, acos, asin, atan, cos, cosh, cot, csc,
    exp, log, pi, sec, sign, sin, sinh, sqrt, tan, tanh,
)  # fmt: skip
from sympy.parsing.sympy_parser import (
    implicit_multiplication, parse_expr, standard_transformations,
)  # fmt: skip

import dalembert as dal
import dalembert.symbolic.printing as printing
import dalembert.symbolic.given as symbolic
from dalembert.symbolic.pattern import pattern
from dalembert.symbolic.zeros import is_zero

a, b, c, m = sympy.symbols("a b c m", real=True)
TURN = sin(a) ** 2 + cos(a) ** 2


# ---- the question -----------------------------------------------------------------------------


ZERO = [
    TURN - 1, (a + b) ** 2 - a**2 - 2 * a * b - b**2, sin(2 * a) - 2 * sin(a) * cos(a),
    1 / (a + 1) - 1 / (b + 1) - (b - a) / ((a + 1) * (b + 1)), cos(a) - 2 * cos(a / 2) ** 2 + 1,
    tan(a) - sin(a) / cos(a), sec(a) ** 2 - tan(a) ** 2 - 1, cot(a) * tan(a) - 1,
    csc(a) * sin(a) - 1, m * (sin(a - b) * cos(b) + cos(a - b) * sin(b) - sin(a)),
    exp(a + b) - exp(a) * exp(b), cosh(a) ** 2 - sinh(a) ** 2 - 1, exp(a / 2) ** 2 * exp(-a) - 1,
    tanh(a / 2) - sinh(a) / (1 + cosh(a)), (sqrt(a + b) - 1) * (sqrt(a + b) + 1) - a - b + 1,
    1 / sqrt(1 + a**2) - sqrt(1 + a**2) / (1 + a**2), Float(0.5) * a - a / 2,
    sin(b * (a + 1)) - sin(a * b + b), 1 / (1 + 1 / a) - a / (a + 1),
    cos(3 * a) - 4 * cos(a) ** 3 + 3 * cos(a), 1 / (TURN + a) - 1 / (1 + a),
    Max(0, a) * (b + 1) - Max(0, a) * b - Max(0, a), a ** Rational(2, 3) * a ** Rational(1, 3) - a,
    exp(log(a)) - a, sqrt(a**2) - Abs(a), sympy.expand((a + sin(b)) ** 6) - (a + sin(b)) ** 6,
]  # fmt: skip

NOT_PROVED = [
    a - b, Float("1e-60") * a, Float(0.1) + Float(0.2) - Float(0.3), sin(17 * a) - cos(a),
    exp(a) - 1, sqrt(a**2) - a, log(a * b) - log(a) - log(b), pi * a, m**a - m, TURN - 2,
    # zero at most points, or where it was tried
    Max(0, a - 2), Min(0, a + 2), Piecewise((0, a < 2), (1, True)), Heaviside(a - 2),
    Abs(a) - a, Max(0, Abs(a) - 2) ** 2, sign(a) - 1, Abs(a - b) + Abs(b - a) - 2 * (a - b),
    # defined nowhere, or not everywhere
    a + b * (TURN - 1) / (sin(2 * a) - 2 * sin(a) * cos(a)), 1 / (TURN - 1),
    sympy.nan, sympy.zoo * a, a * sympy.oo,
    # true, but out of reach: kept, which costs time alone
    Max(0, a) * Max(0, -a), asin(a) + acos(a) - pi / 2, atan(a) + atan(1 / a) - sign(a) * pi / 2,
    (a + b + sin(c)) ** 200,
]  # fmt: skip


@pytest.mark.parametrize("e", ZERO, ids=str)
def test_proved(e):
    assert is_zero(e) and is_zero(-m * e / (1 + c**2))
    assert not is_zero(e + a / 10**300)


def test_not_proved():
    for e in NOT_PROVED:
        assert not is_zero(e), e


def test_one_letter_one_meaning():
    """cos(a) inside a sine is seen before it is known that a/2 occurs, or after it."""
    for e in sympy.symbols("e:8", real=True):
        inside = sin(cos(e))
        nothing = inside * (b + 1) - inside * b - inside
        assert is_zero(nothing + cos(e) - 2 * cos(e / 2) ** 2 + 1)
        assert not is_zero(nothing + cos(e) - cos(e / 2))


def test_long_ones_are_given_up():
    """The question stays open; no one waits for an expansion of 10^9 terms."""
    factors = [a + b + c + m + sin(k * a) + cos(k * b) for k in range(1, 13)]
    assert not is_zero(sympy.Mul(*factors) - sympy.Mul(*factors[1:], factors[0] + TURN - 1))


# ---- systems against 40 digits ----------------------------------------------------------------


DIGITS = 60


def number(e, at):
    """Return the value of an expression with 60 digits: no derivative, nothing simplified."""
    return _function(e, tuple(at))(*at.values())


@functools.cache
def _function(e, symbols):
    return sympy.lambdify(symbols, e, "mpmath")


def slope(e, x, at):
    """Return a derivative by central differences: to 20 digits, away from what jumps."""
    h = mpmath.mpf(10) ** -20 * (1 + abs(at[x]))
    return (number(e, at | {x: at[x] + h}) - number(e, at | {x: at[x] - h})) / (2 * h)


def slopes(e, xs, ys, at):
    """Return the matrix of second derivatives by differences of fourth order, to 20 digits."""
    h = mpmath.mpf(10) ** -12

    def value(x, i, y, j):
        moved = dict(at)
        moved[x] += i * h
        moved[y] += j * h
        return number(e, moved)

    def weights():
        return ((-2, 1), (-1, -8), (1, 8), (2, -1))

    return mpmath.matrix([
        [sum(r * s * value(x, i, y, j) for i, r in weights() for j, s in weights()) / (144 * h * h)
         for y in ys] for x in xs])  # fmt: skip


def motion(L, phi, force, q, v, at):
    """Return energy, residual and acceleration, from the definitions alone."""
    n, count = len(q), len(phi)
    L_v = [slope(L, x, at) for x in v]
    energy = sum(p * at[x] for p, x in zip(L_v, v)) - number(L, at)
    M, coupling = slopes(L, v, v, at), slopes(L, v, q, at)
    A, right = mpmath.zeros(n + count), mpmath.zeros(n + count, 1)
    unit = abs(M[0, 0])  # of mass: the solver takes no matrix of mixed sizes
    for i in range(n):
        pull = slope(L, q[i], at) + number(force[i], at)
        right[i] = (pull - sum(coupling[i, j] * at[v[j]] for j in range(n))) / unit
        for j in range(n):
            A[i, j] = M[i, j] / unit
    for row, e in enumerate(phi, start=n):
        mu = [slope(e, x, at) for x in v]
        size = max(map(abs, mu))
        for i in range(n):
            A[row, i] = mu[i] / size
            A[i, row] = -A[row, i]
        right[row] = -sum(slope(e, x, at) * at[u] for x, u in zip(q, v)) / size
    found = mpmath.lu_solve(A, right)
    return energy, [number(e, at) for e in phi], list(found)[:n]


def agrees(system, L, phi, force, state, tolerance=1e-9):
    """Compare a system with the definitions at a state."""
    symbols = [sympy.Symbol(f"{letter}{i}", real=True) for letter in "qv" for i in range(system.n)]
    q, v = symbols[: system.n], symbols[system.n :]
    given = [x for pair in (COORDINATES, [x.d for x in COORDINATES]) for x in pair]
    rename = dict(zip(given, symbols))
    L, *others = (sympy.sympify(e).xreplace(rename) for e in (L, *phi, *force))
    with mpmath.workdps(DIGITS):
        at = dict(zip(symbols, map(mpmath.mpf, state)))
        energy, residual, acceleration = motion(
            L, others[: len(phi)], others[len(phi) :], q, v, at
        )
        got = np.split(np.array(state, dtype=float), 2)
        assert system.energy(*got) == pytest.approx(float(energy), rel=tolerance)
        np.testing.assert_allclose(
            system.residual(*got), np.array(residual, dtype=float), rtol=tolerance, atol=0
        )
        expected = np.array(acceleration, dtype=float)
        size = tolerance * np.abs(expected).max() + 64 * U  # of terms of size 1 that cancel
        np.testing.assert_allclose(system.acceleration(*got), expected, rtol=0, atol=size)


COORDINATES = x, y, z = dal.coordinates("x y z")
HIDDEN = sin(x) ** 2 + cos(x) ** 2 - 1


def act(source):
    """Return an expression that is zero in places, and a range of x where it acts."""
    edge = source.choice([-3, Rational(-1, 2), 0, 2, 5])
    u = x - edge
    k = source.randint(1, 5)
    walls = [
        Max(0, u) ** 2, Max(0, u), -Min(0, -u) ** 3, u * Heaviside(u), u**2 * (1 + sign(u)),
        (u + Abs(u)) * cos(y), Piecewise((0, x < edge), (u**2 * (2 + sin(y)), True)),
        Piecewise((0, (x < edge) & (y < 9)), (k * u, (x < edge + 50) | (z > 7)), (y, True)),
        Piecewise((0, sympy.Not(x >= edge)), (sinh(u / 2), True)),
        Max(0, Min(u, 40)) * exp(-y / 3), Max(HIDDEN, u) * (1 + y**2), sqrt(u**2) + u,
        exp(log(u**2) / 2) + u, Piecewise((1, x < edge), (1 + u, True)) - 1,
        Max(0, 1 - Abs(u - 1)) * k + Max(0, u - Rational(1, 4)) * y,
    ]  # fmt: skip
    return source.choice(walls), edge


@pytest.mark.parametrize("seed", range(6))
def test_random_systems(seed):
    """Terms that vanish nearly everywhere, at points where they act, in units of any size."""
    source = random.Random(seed)
    unit = Float(10) ** source.choice([-60, -34, -12, 0, 0, 0, 12, 60])
    terms, edges = zip(*(act(source) for _ in range(3)))
    mass = [source.choice([1, 2, TURN.subs(a, x), 1 + terms[1] ** 2]) for _ in range(2)]
    L = unit * ((mass[0] * x.d**2 + mass[1] * y.d**2 + 2 * z.d**2) / 2 - terms[0] + HIDDEN * y)
    if source.random() < 0.3:
        L += unit * Max(0, terms[2]) ** 2 * y.d  # gyroscopic behind a wall
    width = Float(10) ** source.choice([-60, 0, 0, 60])
    form = source.choice([
        [z.d - y * x.d + HIDDEN], [z.d - (y + terms[1]) * x.d], [z.d + x * y.d - terms[1]],
        [width * (z.d + x.d * terms[1])], [z.d - Max(0, x.d) * y.d], [],
        [z.d - y * x.d, y.d - 2 * Piecewise((1, x < edges[1]), (3, True)) * x.d + terms[1] * z.d],
    ])  # fmt: skip
    force = [0, 0, 0]
    if source.random() < 0.5:
        force = [-unit * sign(x.d) * terms[2], unit * Heaviside(x - edges[2]) * y.d, 0]
    system = dal.System.from_sympy(
        L, form, COORDINATES, force=dict(zip(COORDINATES, force)) if any(force) else None
    )
    # the terms act on the right of all edges, and within 1/4 of the last one
    for place in (max(edges) + 0.21875, max(edges) + 3.40625, min(edges) - 1.15625):
        at = [place, 0.3125, 0.71875, 1.1875, 0.8125, -0.46875]
        agrees(system, L, form, force, [float(e) for e in at])
    if is_zero(terms[0]) or seed == 0:
        return
    assert system.mass is None or not any(term in mass for term in terms)


# ---- what is kept, what is not -----------------------------------------------------------------


T = (x.d**2 + y.d**2 + z.d**2) / 2


def made(L, constraints=(), **options):
    return dal.System.from_sympy(L, constraints, COORDINATES, **options)


def test_walls_stop_a_body():
    """Thrown at a soft wall it comes back; the energy is that of a harmonic half turn."""
    soft = made(T - 50 * Max(0, Abs(x) - 2) ** 2)
    run = dal.integrate(soft, "leapfrog", [0, 0, 0], [1, 0, 0], h=0.001, t_end=5)
    # to the wall, half a period of the oscillator, and back to x = -1/2 at t = 2 + pi/10 + ...
    expected = 2 - (5 - 2 - np.pi / 10)
    assert run.q[-1, 0] == pytest.approx(expected, abs=1e-4)
    assert run.stats.potential_calls >= 5000 and soft.mass is not None
    assert bool(soft.check([3, 0, 0], [1, 0, 0]))


def test_kinds_behind_a_wall():
    cases = [
        (T, [z.d - y * x.d - Max(0, x - 2)], "affine", True),
        (T, [z.d - y * x.d - Float("1e-60")], "affine", True),
        (T, [z.d - y * x.d * Piecewise((1, x < 2), (3, True))], "linear", True),
        (T, [z.d - Piecewise((1, x.d < 2), (3, True)) * x.d], "nonlinear", True),
        (T, [z.d - Piecewise((1, x.d < 2), (3, True)) - x.d], "nonlinear", True),
        (T, [z.d - Max(0, x.d - 9)], "nonlinear", True),
        (T + Max(0, x - 2) * y.d, [], "linear", False),
        (T + Float("1e-60") * x * y.d, [], "linear", False),
        (T * Piecewise((1, x < 2), (3, True)), [], "linear", False),
        (T + Piecewise((0, x.d < 2), (1, True)), [], "linear", False),
        (T + x.d**2 * Max(0, Abs(x) - 2), [], "linear", False),
        (T + sympy.atan(x.d) + sympy.atan(1 / x.d), [], "linear", False),
        (T + HIDDEN * x.d**4, [HIDDEN * x.d**2 + z.d - y * x.d], "linear", True),
        (T, [(z.d + y) * 2 - 2 * y + x.d], "linear", True),
        (T, [TURN.subs(a, x) * z.d + x.d**2 - x.d * (x.d - y)], "linear", True),
        (T, [z.d + cos(x)], "affine", True),
        (T, [sqrt(x.d**2 + y.d**2) - 2], "nonlinear", True),
    ]
    for L, constraints, kind, constant in cases:
        of_kind(L, constraints, kind, constant)


def of_kind(L, constraints, kind, constant, parameters=None):
    model, _ = symbolic.make_model(L, constraints, COORDINATES, parameters)
    found = model.derived
    assert (found.kind, found.mass is not None) == (kind, constant), (L, constraints)


def test_structure_decides_before_a_proof():
    """A factor that no proof expands; M is constant, and constraints linear, by what is in them."""
    long = sympy.prod(x + y + z + sin(k * x) + cos(k * y) for k in range(1, 8))
    cases = [
        (T, [long * (z.d + x.d) - y * x.d], "linear", True),
        (T, [long * (z.d + x.d + y) - y * x.d], "affine", True),
        (T, [long * (z.d + x.d) ** 2 - y * x.d], "nonlinear", True),
        (T, [long * (z.d + Max(0, x.d)) - y * x.d], "nonlinear", True),
        (m * (T - long), [], "linear", True),
        (m * (T - long * (x.d + y)), [], "linear", False),
        (m * (T - long * Piecewise((0, x.d < 2), (1, True))), [], "linear", False),
    ]
    for L, constraints, kind, constant in cases:
        of_kind(L, constraints, kind, constant, {m: 1})


def test_what_turns_at_a_constant_rate():
    """Energies in axes that turn depend on time only where something else does."""
    late = Piecewise((x, 1 / dal.time > 2), (0, True))
    for extra, timed in ((0, False), (x * sin(dal.time), True), (late, True)):
        s, c = (f(z + 2 * dal.time) for f in (sin, cos))
        L = ((c * x.d + s * y.d) ** 2 + (c * y.d - s * x.d) ** 2 + z.d**2) / 2 + extra
        row = c * (c * x.d) + s * s * x.d - z.d
        model, _ = symbolic.make_model(L, [row], COORDINATES, None)
        assert model.is_time_dependent == timed
        assert dal.time not in model.constraints[0].free_symbols


def test_a_jump_of_mu_is_not_steady():
    """It has no derivative, but mu depends on x, which the reaction pushes."""
    smooth, jumping = ([z.d - k * y.d - 2 * x.d] for k in (3, Piecewise((1, x < 2), (3, True))))
    assert pattern(made(T, smooth)._model).steady
    system = made(T, jumping)
    assert not pattern(system._model).steady
    state = [3, 1, 1], system.project([3, 1, 1], [1, 2, 3])
    assert bool(system.check(*state)) and system.check(*state).growth == (2, 2)


def test_units_of_any_size():
    """An electron in a weak field: the acceleration does not depend on the unit of mass."""
    for unit in (9.109e-31, 1e-60, 1e60):
        fall = made(unit * T - unit * 1e-3 * z, [z.d - y * x.d])
        expected = [-5e-4, 0, -5e-4]
        np.testing.assert_allclose(fall.acceleration([0, 1, 0], [0, 0, 0]), expected, rtol=4 * U)
    tiny = Float("1e-160")  # its square is no double; a product of both is not needed
    assert made(T - sin(tiny * x) / tiny).acceleration([1, 0, 0], [0, 0, 0])[0] == -1
    assert made(T - 7).energy([0, 0, 0], [0, 0, 0]) == 7
    with pytest.raises(ValueError, match=r"V_qq.* of the potential: .*E-320 is too small for a do"):
        made(T - sin(tiny * x))
    for size, word in (("1e-310", "small"), ("1e400", "large")):
        with pytest.raises(ValueError, match=f"^L: .* is too {word} for a double"):
            made(T - Float(size) * x)


def test_numbers_that_are_no_quotient_of_doubles():
    """Each is the double that is nearest; as a factor, inside a function, and in Python."""
    ratios = [
        Rational(10**400 + 1, 10**399 + 7), Rational(2**53 + 1, 3 * 2**60 + 1),
        Rational(-(10**30), 10**31 + 9),
    ]  # fmt: skip
    expected = np.array([r.p / r.q for r in ratios])  # of integers: rounded once
    system = made(T - sum(r * u + cos(r * u) for r, u in zip(ratios, COORDINATES)))
    np.testing.assert_array_equal(system.acceleration([0, 0, 0], [0, 0, 0]), -expected)
    found = system.acceleration([1, 1, 1], [0, 0, 0])
    np.testing.assert_allclose(found, expected * (np.sin(expected) - 1), rtol=8 * U)
    for ratio, value in zip(ratios, expected):
        assert float(printing.Printer(set())(ratio).strip("()")) == value


def test_jumps_of_derivatives():
    """A DiracDelta that its factor takes away is none; another one is refused by name."""
    at = [3, 0.5, 0.2], [1, 2, 0.3]
    smooth = {
        Heaviside(x - 2) * (x - 2) ** 2: -2, Abs(x) * x: -6, Max(0, x - 2): -1, Abs(x): -1,
        (x - 2) * Heaviside(x - 2): -1, sign(x - 2) * (x - 2) ** 3: -3, Abs(sqrt(x - 2)): -0.5,
        Max(0, 16 - x**2) ** 2: 4 * 3 * 7, Abs(log(x)): -1 / 3,
        Piecewise((0, x < 2), (4 * x, True)): -4,
        Heaviside(x - 2) * (x - 2) * sign(x + 1): -1, Heaviside(x * y) * x * y: -0.5,
    }  # fmt: skip
    shares = sympy.symbols(f"share:{len(smooth)}")
    total = sum(p * V for p, V in zip(shares, smooth))
    every = made(T - total, parameters=dict.fromkeys(shares, 0))
    for share, (V, expected) in zip(shares, smooth.items()):
        found = every.with_parameters(**{share.name: 1})
        assert found.acceleration(*at)[0] == pytest.approx(expected, rel=8 * U), V
        assert bool(found.check(*at)), V
    cubic = made(T + Abs(x.d) ** 3 / 6)  # M = 1 + |v_x|
    assert cubic.metric(at[0], [-2, 2, 1])[0, 0] == 3
    friction = made(T, force={x: -sign(x.d) / 4, y: -Heaviside(y, 0), z: Heaviside(z)})
    np.testing.assert_array_equal(friction.acceleration([0, 0, 0], [1, 1, 1]), [-0.25, 0, 0.5])
    for L, constraints, where, what in [
        (T - Heaviside(x - 2), [], "L: .* by x ", "DiracDelta\\(x - 2\\)"),
        (T - sign(y) * (x - 1), [], "L: .* by y ", "DiracDelta\\(y\\)"),
        (T + Abs(x.d) / 4, [], "L: .* by x.d ", "DiracDelta\\(x.d\\)"),
        (T + sign(z - 1) ** 3, [], "L: .* by z ", "DiracDelta\\(z - 1\\)"),
        (T + (1 - 2 * Heaviside(z)) ** 3 * cos(z), [], "L: .* by z ", "DiracDelta\\(z\\)"),
        (T + Heaviside(x * y) * x, [], "L: .* by [xy] ", "DiracDelta\\(x.y\\)"),
        (T, [z.d - y * x.d, y.d - Heaviside(z - 1) * x.d], "constraints.1.: .* by z ", "z - 1"),
    ]:
        with pytest.raises(ValueError, match=f"{where}.*{what}.*Piecewise.*tanh"):
            made(L, constraints)


def test_pieces_without_a_default():
    """Outside them nothing is known: a DomainError, compiled and not."""
    unknown, case = log(1 - x), sympy.Symbol("case")  # beyond x = 1

    def chosen(parts):
        return Piecewise(*((part, case < k + 1) for k, part in enumerate(parts)), (0, True))

    potentials = Piecewise((x**2, x < 1)), Max(0, unknown), Min(unknown, 9)
    pushes = [sign(unknown), Heaviside(unknown)]
    pushes += [extreme(unknown, log(1 + y)) for extreme in (Max, Min)]
    pushes += [extreme(unknown, log(3 - y)) for extreme in (Max, Min)]  # in the other order
    pushes.append(sign(exp(500 * x) - exp(400 * x)))  # infinite, both
    for part, count in (
        (made(T - chosen(potentials), parameters={case: 0}), len(potentials)),
        (made(T, force={x: chosen(pushes)}, parameters={case: 0}), len(pushes)),
    ):
        for k in range(count):
            one = part.with_parameters(case=k)
            assert np.isfinite(one.acceleration([0.5, 1, 0], [0, 0, 0])).all()
            with pytest.raises(dal.DomainError):
                one.acceleration([2, 0, 0], [0, 0, 0])
        none = part.with_parameters(case=count)
        assert (none.acceleration([2, 0, 0], [0, 0, 0]) == 0).all()


def test_without_a_compiler(monkeypatch):
    """Python functions of the same expressions."""
    L = (
        T - 50 * Max(0, Abs(x) - 2) ** 2 - Piecewise((x, x < 5)) - (x - 1) ** 2 * Heaviside(x - 1)
        - Rational(10**400 + 1, 10**399 + 7) * y - Float(0.1 + 0.2) * z - (y - 1) * sign(y - 1)
    )  # fmt: skip
    cases = [(L, [z.d - y * x.d - Min(0, 2 - x)], {x: -sign(x.d)}), (L * Max(1, x), [], None)]
    at = [3, 0.5, 0.2], [1, 2, 0.3]
    for case, constraints, force in cases:
        fast = made(case, constraints, force=force)
        with monkeypatch.context() as change:
            change.setenv("CC", "/nowhere/cc")
            with pytest.warns(dal.DalembertWarning, match="no C compiler"):
                slow = made(case, constraints, force=force, invariants={"p": Float(0.1 + 0.2) * x})
        assert slow.invariant(*at) == {"p": (0.1 + 0.2) * 3}
        assert slow.energy(*at) == pytest.approx(fast.energy(*at), rel=8 * U)
        np.testing.assert_allclose(slow.acceleration(*at), fast.acceleration(*at), rtol=64 * U)
        with pytest.raises((dal.DomainError, ValueError)):
            slow.acceleration([6, 0, 0], [0, 0, 0])


def test_what_is_printed_is_compiled():
    """The formulas, read by SymPy, give the energy of the compiled system."""
    L = T - 50 * Max(0, Abs(x) - 2) ** 2 - Float("9.109e-34") * z - Heaviside(x - 1) * (x - 1) ** 2
    system = made(L, [z.d - Max(0, x - 2) * x.d])
    names = {f"v_{e.name}": e.d for e in COORDINATES} | {e.name: e for e in COORDINATES}
    L_read, row = (
        parse_expr(
            re.sub("^L = | = 0$", "", line).replace("^", "**"), names,
            (*standard_transformations, implicit_multiplication),
        )
        for line in system.formulas
    )  # fmt: skip
    at = dict(zip([*COORDINATES, *(e.d for e in COORDINATES)], [3, 0.5, 0.25, 1, 2, 0.5]))
    energy = float((2 * T - L_read).subs(at))
    state = [3, 0.5, 0.25], [1, 2, 0.5]
    assert system.energy(*state) == pytest.approx(energy, rel=4 * U)
    assert system.residual(*state) == pytest.approx([float(row.subs(at))], rel=4 * U)
    assert "9.109e-34 z" in system.formulas[0]


# ---- the entries that a step routine leaves out ------------------------------------------------


def model(L, constraints, q, parameters=None):
    return symbolic.make_model(L, constraints, list(q), parameters)[0]


def coupled():
    """M has the blocks {x, theta}, {y}, {z}; V pulls y only; theta turns mu, and is pushed by x."""
    x, y, z, theta = q = dal.coordinates("x y z theta")
    L = x.d**2 + y.d**2 + z.d**2 + theta.d**2 + x.d * theta.d / 2 - y**2
    return model(L, [cos(theta) * x.d + sin(theta) * z.d], q)


def blade():
    x, y, theta = q = dal.coordinates("x y theta")
    return model(x.d**2 + y.d**2 + theta.d**2 + 3 * x, [sin(theta) * x.d - cos(theta) * y.d], q)


def sleigh():
    x, y, theta = q = dal.coordinates("x y theta")
    L = x.d**2 + y.d**2 + theta.d**2
    return model(L, [sin(theta) * x.d - cos(theta) * y.d + theta.d], q)


def chain():
    """M couples neighbours: its inverse is full."""
    q = dal.coordinates("a b c d")
    L = sum(x.d**2 for x in q) + sum(x.d * y.d for x, y in zip(q, q[1:])) / 3
    return model(L, [q[0].d + q[1] * q[2].d], q)


@pytest.mark.parametrize("make", [coupled, blade, sleigh, chain])
def test_entries(make):
    """Against the matrices in numbers, at three points."""
    found, of = pattern(make()), make()
    n = of.n
    outputs = dict(of.derived.function("constraint").outputs)
    matrices = {"inverse": np.zeros((n, n)), "mu": 0, "Z": 0, "N": 0}
    source = np.random.default_rng(3)
    inverse = np.linalg.inv(np.array(of.derived.mass, dtype=float).reshape(n, n))
    for _ in range(3):
        at = {s.name: x for s, x in zip((*of.q, *of.v), source.uniform(0.2, 1.2, 2 * n))}

        def numbers(name):
            values = [sympy.sympify(e).subs(at) for e in outputs[name]]
            return np.array(values, dtype=float).reshape(-1, n)

        mu = numbers("phi_v")
        for name, A in (("inverse", inverse), ("mu", mu), ("Z", mu @ inverse),
                        ("N", numbers("phi_q"))):  # fmt: skip
            matrices[name] = matrices[name] + (np.abs(A) > 1e-12)
    for name, often in matrices.items():
        assert getattr(found, name) == (often > 0).tolist(), name


def test_pull_and_steady():
    assert pattern(coupled()).pull == [[True, True, True, True]]
    assert pattern(blade()).pull == [[True, True, False]]  # V pulls x, the reaction both
    assert pattern(blade()).steady
    assert not pattern(coupled()).steady
    assert not pattern(sleigh()).steady


def test_what_v_pushes():
    assert pattern(blade()).kick == [[True, False, False]]
    assert pattern(coupled()).kick == [[False, True, False, False]]
    assert pattern(sleigh()).kick == [[False] * 3]
    x, y, theta = q = dal.coordinates("x y theta")
    L, row = x.d**2 + x.d * y.d + y.d**2 + theta.d**2, sin(theta) * x.d - cos(theta) * y.d
    assert pattern(model(L - x, [row], q)).kick == [[True, True, False]]  # through M
    assert pattern(blade()).apart
    turned = pattern(model(L - theta**2, [row], q))  # V turns the blade
    assert turned.steady and not turned.apart
    assert not pattern(sleigh()).apart  # nothing pushes theta but the reaction


def test_masses_of_one():
    x, y, z, theta = q = dal.coordinates("x y z theta")
    m = sympy.Symbol("m")
    T = (x.d**2 + y.d**2 + m * z.d**2 + theta.d**2 + x.d * theta.d) / 2
    # x and theta are coupled, and the mass of z may be another tomorrow
    found = pattern(model(T, [z.d - y * x.d], q, {m: 1}))
    assert found.one == [[False, True, False, False]]


def test_initializer():
    text = "{0x111ULL, 0x3ULL, 0x3ULL, 0x4ULL, 0x3ULL, 0x1ULL, 0x0ULL"
    assert pattern(blade()).initializer() == text + ", 0x0ULL" * 4 + "}"
    q = dal.coordinates("a b c d e f g h i")
    large = pattern(model(sum(x.d**2 for x in q), [q[0].d - q[1] * q[2].d], q))
    assert large.initializer() is None  # 81 entries do not fit into a word
    assert large.steady
