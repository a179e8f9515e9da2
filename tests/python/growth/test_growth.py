"""Growth vectors of D: against brackets by algebra, the literature, and by functions alone."""

import itertools
import math
import random
import re
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest
import sympy
from sympy import Abs, Heaviside, Max, Min, Piecewise, cos, exp, sin, sqrt

import dalembert as dal
from dalembert import growth, pages
from dalembert.core import extras
import dalembert.symbolic.expressions as expressions
import dalembert.symbolic.functions as allowed
import dalembert.symbolic.given as symbolic
from dalembert.growth import algebra, functions

x, y, z, w, u = dal.coordinates("x y z w u")
RIGHT = np.pi / 2


def model_of(rows, q, parameters=None):
    """Return a model with free motion and these constraints; nothing is compiled."""
    found, values = symbolic.make_model(
        sum(c.d**2 for c in q) / 2, rows, q, parameters, None, None, None, None
    )
    return found, values


def examine(rows, q, at=None, parameters=None):
    """Return what is found at a general point, or at one."""
    found, values = model_of(rows, q, parameters)
    place = np.full(len(q), 0.4)
    return algebra.examine(
        found, values, place, None if at is None else np.array(at, dtype=float)
    )


def trailers(count):
    """Return coordinates and constraints of a car with trailers at distance 1."""
    X, Y, *angles = q = dal.coordinates("X Y " + " ".join(f"a{i}" for i in range(count + 1)))
    v_x, v_y, rows = X.d, Y.d, []
    for i, a in enumerate(angles):
        if i > 0:
            v_x, v_y = v_x + sin(a) * a.d, v_y - cos(a) * a.d
        rows.append(sin(a) * v_x - cos(a) * v_y)
    return rows, q


# ---- functions that a model may have -------------------------------------------------------------


SMOOTH = [
    *(f(y) for f in allowed.FUNCTIONS if f not in (sympy.acosh, sympy.atan2)),
    sympy.acosh(2 + y), sympy.atan2(y, 1 - y), sympy.sec(y), sympy.csc(y), sympy.cot(y), y**5,
    y**-3, sqrt(y), y ** sympy.Rational(-7, 3), y**sympy.pi, (1 + y) ** y, 3**y, y**1.5,
    Piecewise((y**2, y > 1), (cos(y), True)), Piecewise((y, y > 0)), Max(y, y**2), Min(y**2, 1 - y),
    sympy.sign(y) * y, Heaviside(y) * y**2,
    Piecewise((y, (y > 2) | sympy.Not(y < 0)), (y**4, (y > -1) & sympy.Ne(y, 2))),
]  # fmt: skip


@pytest.mark.parametrize("e", SMOOTH)
def test_functions_of_models(e):
    """z.d = (f(y) - f'(0.4) y) x.d bends at y = 0.4 to second order, where f does."""
    straight = e - y * e.diff(y).subs(y, 0.4)
    found = examine([z.d - straight * x.d], [x, y, z], [0.1, 0.4, 0.2])
    linear = e.diff(y, 2).subs(y, 0.4) == 0
    assert found.growth == ((2, 2) if linear else (2, 2, 3))


@pytest.mark.parametrize(
    "e",
    [
        Abs(y), sqrt(y), 1 / y, sympy.log(y), sympy.asin(y + 2), sympy.sign(y) * y, Max(y, -y),
        Piecewise((y, y > 0), (y**2, True)), Piecewise((y, y > 1)), sympy.log(y - 1), y**0.5,
        Piecewise((y, sympy.Eq(y, 0)), (1, True)), sqrt(y - 1), Heaviside(y) * y, Abs(sin(y)),
    ],
)  # fmt: skip
def test_where_mu_is_not_smooth(e):
    found = examine([z.d - e * x.d], [x, y, z], [0.1, 0.0, 0.2])
    assert found.growth is None
    assert re.match("mu is not (smooth|defined) there|found no point", found.growth_note)


# ---- against algebra -----------------------------------------------------------------------------


def by_algebra(forms, n, point, length):
    """Return the dimensions from brackets as polynomials, at a rational point, exactly.

    ``forms[a][j]`` is minus the velocity of coordinate n - 1 - a for a unit one of coordinate j.
    """
    basis = []
    for j in range(n - len(forms)):
        field = [forms[0][0].ring.one * (i == j) for i in range(n)]
        for a, form in enumerate(forms):
            field[n - 1 - a] = -form[j]
        basis.append(field)
    x = forms[0][0].ring.gens

    def bracket(X, Y):
        return [
            sum(X[j] * Y[i].diff(x[j]) - Y[j] * X[i].diff(x[j]) for j in range(n)) for i in range(n)
        ]

    found, last, values = [], basis, []
    for k in range(length):
        values += [[e(*point) for e in field] for field in last]
        found.append(sympy.Matrix(values).rank())
        pairs = itertools.product(basis, last) if k > 0 else itertools.combinations(basis, 2)
        last = [bracket(X, Y) for X, Y in pairs]
    return tuple(found)


@pytest.mark.parametrize(
    ("n", "m", "length", "seed"), [(3, 1, 4, 0), (3, 1, 4, 1), (4, 1, 3, 0), (4, 2, 4, 1)]
)
def test_against_brackets_by_algebra(n, m, length, seed):
    """Random polynomial forms, at points where many of them vanish: singular ones."""
    source = random.Random(seed)
    q = dal.coordinates(" ".join(f"c{i}" for i in range(n)))
    ring = sympy.QQ[q].ring

    def polynomial():
        monomials = [source.choices(ring.gens, k=k) for k in (0, 1, 1, 2, 2, 2)]
        return sum((source.randint(-3, 3) * sympy.prod(e, ring.one) for e in monomials), ring.zero)

    forms = [[polynomial() for _ in range(n - m)] for _ in range(m)]
    rows = [
        q[n - 1 - a].d + sum(e.as_expr() * c.d for e, c in zip(form, q))
        for a, form in enumerate(forms)
    ]
    places = [[source.choice([0, 0, 1, -1]) for _ in q] for _ in range(3)]
    general = by_algebra(forms, n, [Fraction(source.randint(5, 30), 7) for _ in q], length)
    for place in places:
        found = examine(rows, q, place)
        expected = by_algebra(forms, n, place, length)
        for got, dimensions in ((found.growth, expected), (found.general_growth, general)):
            assert (*got, *[got[-1]] * length)[:length] == dimensions


# ---- known growth vectors ------------------------------------------------------------------------


def goursat(n):
    """dz_{i+1} = z_i dx: chained form."""
    q = dal.coordinates(" ".join(f"c{i}" for i in range(n)))
    return [q[i + 1].d - q[i] * q[0].d for i in range(1, n - 1)], q


def ball(twist):
    """A ball that rolls on a plane, with Euler angles; without twist: omega_3 = 0."""
    X, Y, a, b, c = q = dal.coordinates("X Y a b c")
    omega = [cos(a) * b.d + sin(a) * sin(b) * c.d, sin(a) * b.d - cos(a) * sin(b) * c.d]
    rows = [X.d - omega[1], Y.d + omega[0]]
    return (rows if twist else [*rows, a.d + cos(b) * c.d]), q


def generic(n, m, seed):
    """dz_a = sum of sines of all coordinates: it grows as fast as any."""
    source = random.Random(seed)
    q = dal.coordinates(" ".join(f"c{i}" for i in range(n)))
    rows = [
        q[n - 1 - a].d
        + sum(sin(sum(source.randint(-9, 9) * c for c in q) / 4) * c.d for c in q[1 : n - m])
        for a in range(m)
    ]
    return rows, q


KNOWN = {
    "particle": (([z.d - y * x.d], [x, y, z]), (2, 3)),
    "knife edge": (([sin(z) * x.d - cos(z) * y.d], [x, y, z]), (2, 3)),
    "disk": (([x.d - cos(w) * z.d, y.d - sin(w) * z.d], [x, y, z, w]), (2, 3, 4)),
    "heisenberg": (([z.d + y * x.d - x * y.d], [x, y, z]), (2, 3)),
    "contact": (([w.d - x * y.d - z * u.d], [x, y, z, w, u]), (4, 5)),
    "engel": (goursat(4), (2, 3, 4)),
    **{f"goursat {n}": (goursat(n), tuple(range(2, n + 1))) for n in (5, 7)},
    "ball": (ball(True), (3, 5)),
    "ball without twist": (ball(False), (2, 3, 5)),
    "free, two fields": (generic(5, 3, 1), (2, 3, 5)),
    "free, three fields": (generic(6, 3, 1), (3, 6)),
    "one field": (([x.d - y * z.d, y.d - z.d], [x, y, z]), (1, 1)),
    **{f"{k} trailers": (trailers(k), tuple(range(2, k + 4))) for k in range(1, 4)},
}  # fmt: skip


@pytest.mark.parametrize("name", KNOWN)
def test_known(name):
    (rows, q), expected = KNOWN[name]
    found = examine(rows, q)
    assert found.growth == found.general_growth == expected and found.growth_note == ""
    assert found.exact and bool(found.holonomic) == (expected[-1] < len(q))


@pytest.mark.parametrize("symbolic", [True, False])
def test_progress_is_in_dimensions(symbolic):
    system = dal.systems.n_trailer(trailers=1)
    if not symbolic:
        car = system
        system = dal.System(
            mass=np.eye(4),
            mu=lambda q: np.transpose([car.residual(q, e) for e in np.eye(4)]),
            q0=car.q0,
            v0=np.zeros(4),
        )
    told, v = [], np.zeros(4)
    assert system.check(system.q0, v, progress=lambda *x: told.append(x)).growth == (2, 3, 4)
    done, totals = zip(*told, strict=True)
    assert set(totals) == {4} and list(done) == sorted(done)
    assert set(done) == set(range(1, 5))
    told.clear()
    system.check(progress=lambda *x: told.append(x))
    assert told[-1] == (2, 2)


def test_partially_integrable():
    """A product of a non-integrable and an integrable D; the sum of what both do."""
    found = examine([w.d - y * z.d, x.d + u * u.d], [x, y, z, w, u])
    assert found.growth == (3, 4, 4)
    assert found.holonomic == ("constraints[1]: u*u.d + x.d = 0",)
    assert not found.exact  # that brackets stay in a larger D is seen, not proved
    hidden = examine([w.d - y * z.d + x.d, x.d + exp(x) * (w.d - y * z.d)], [x, y, z, w])
    assert hidden.growth == (2, 3, 3) and hidden.holonomic == ("1 of the constraints together",)


def test_many_closed_forms():
    """Nothing is proved of so many, but seen."""
    q = dal.coordinates(" ".join(f"c{i}" for i in range(7)))
    found = examine([a.d - b.d for a, b in itertools.pairwise(q)][:5], q)
    assert found.growth == (2, 2) and not found.exact and len(found.holonomic) == 5


# ---- singular points -----------------------------------------------------------------------------


SINGULAR = [
    (([z.d - y**2 * x.d], [x, y, z]), [0.3, 0, 0.2], (2, 2, 3)),  # Martinet
    (([z.d - y**5 * x.d], [x, y, z]), [0.3, 0, 0.2], (2, 2, 2, 2, 2, 3)),
    (([z.d - (y - 0.1) ** 2 * x.d], [x, y, z]), [0.3, 0.1, 0.2], (2, 2, 3)),
    # Jean: the car with two trailers, at right angles
    (trailers(2), [0.1, 0.2, 0.3, 0.3 + RIGHT, 0.5], (2, 3, 4, 4, 5)),
    (trailers(2), [0.1, 0.2, 0.3, 0.5, 0.5 + RIGHT], (2, 3, 4, 5)),
]  # fmt: skip


@pytest.mark.parametrize(("system", "q", "expected"), SINGULAR)
def test_singular_points(system, q, expected):
    rows, coordinates = system
    found = examine(rows, coordinates, q)
    assert found.growth == expected and found.growth_note == ""
    assert found.general_growth == KNOWN.get(f"{len(q) - 3} trailers", [0, (2, 3)])[1]


@pytest.mark.parametrize("distance", [1e-3, 1e-12])
def test_close_to_a_singular_point(distance):
    """Regular, as far as the digits of q tell."""
    rows, q = trailers(2)
    found = examine(rows, q, [0.1, 0.2, 0.3, 0.3 + RIGHT + distance, 0.5])
    assert found.growth == (2, 3, 4, 5)


def test_a_leaf_that_is_never_left():
    found = examine([z.d - y * z * x.d], [x, y, z], [0.1, 0.2, 0.0])
    assert found.growth == (2, 2) and found.general_growth == (2, 3)
    assert found.growth_note == "brackets of more than 11 fields are not formed"


def test_no_growth_vector():
    kink = examine([z.d - Abs(y) * x.d], [x, y, z], [0.1, 0.0, 0.2])
    assert kink.growth is None and kink.general_growth == (2, 3)
    assert kink.growth_note == "mu is not smooth there: y is 0"
    near = examine([z.d - Abs(sin(y)) * x.d], [x, y, z], [0.1, np.pi, 0.2])  # sin(y) is 1e-16
    assert near.growth is None and near.growth_note == "mu is not smooth there: sin(y) is 0"
    lost = examine([z * z.d - y * x.d], [x, y, z], [0.1, 0.0, 0.0])
    assert lost.growth is None and lost.growth_note == "mu has rank 0 instead of 1"
    nowhere = examine([z.d - sqrt(-1 - y**2) * x.d], [x, y, z])
    assert nowhere.growth is None and nowhere.general_growth is None
    assert "found no point" in nowhere.growth_note


def test_a_domain_away_from_the_unit_cube():
    """General points are sought near the state as well."""
    rows, q = [z.d - sqrt(y - 100) * x.d], [x, y, z]
    found, values = model_of(rows, q)
    near = np.array([0.0, 101.0, 0.0])
    assert algebra.examine(found, values, near).growth == (2, 3)


# ---- where mu bends only in places -------------------------------------------------------------

BENT = [
    (Max(0, y - 1) ** 3, 2.0), (Heaviside(y - 2) * (y - 2) ** 2, 3.0), (Abs(y - 2) + y - 2, 3.0),
    (Piecewise((y, y > 5), (5, True)), 6.0), (exp(-((y - 50) ** 2)), 50.5),
    (1 + sympy.tanh(100 * (y - 3)), 3.0), (Max(0, y - sympy.Rational(21, 20)) ** 3, 1.1),
]  # fmt: skip


@pytest.mark.parametrize(("e", "at"), BENT)
def test_bent_at_the_state(e, at):
    """It is at the state that D has to be integrable, wherever else it is."""
    found = examine([z.d - e * x.d], [x, y, z], [0, at, 0])
    assert found.growth == found.general_growth == (2, 3)
    assert found.integrable is False and found.holonomic == ()


def test_flat_around_the_state():
    """What is flat around the state may be bent elsewhere, and that is said."""
    found = examine([z.d - Max(0, y - 100) ** 3 * x.d], [x, y, z], [0, 0, 0])
    assert found.growth == (2, 2) and found.integrable and not found.exact
    assert "only those near this point were examined" in found.growth_note
    assert found.holonomic[0].endswith(" = 0, as far as points nearby show")


@pytest.mark.parametrize(("bend", "at"), [(1.0, 2.0), (1.05, 1.1), (1.0, 1.05)])
def test_bent_functions(bend, at):
    """The points nearby may lie where it is flat."""
    system = dal.System(mass=np.ones(3), mu=lambda q: [[-(max(0, q[1] - bend) ** 3), 0, 1]])
    report = system.check([0, at, 0], np.zeros(3))
    assert report.growth == report.general_growth == (2, 3)
    assert not report.integrable and report.holonomic == ()


@pytest.mark.parametrize("unit", ["1e-31", "1e100"])
def test_unit_of_a_form(unit):
    for factor in (sympy.Float(unit), sympy.Rational(unit)):
        one = examine([factor * (z.d - y * x.d)], [x, y, z])
        assert one.growth == (2, 3) and one.holonomic == () and one.exact
        for rows in ([factor * (z.d - y * x.d), w.d - z * x.d],
                     [z.d - y * x.d, factor * (w.d - z * x.d)]):  # fmt: skip
            two = examine(rows, [x, y, z, w])
            assert two.growth == (2, 3, 4) and two.holonomic == () and two.exact
        flat = examine([factor * (x * z.d + z * x.d)], [x, y, z])
        assert flat.integrable and len(flat.holonomic) == 1


@pytest.mark.parametrize("unit", [-30, -40, -60])
def test_unit_of_a_coordinate(unit):
    found = examine([z.d - sympy.Integer(10) ** unit * y * x.d], [x, y, z])
    assert found.growth == (2, 3) and found.integrable is False and found.holonomic == ()


# ---- by functions alone --------------------------------------------------------------------------


BUILT_IN = {
    "particle": (2, 3), "knife_edge": (2, 3), "sleigh": (2, 3), "disk": (2, 3, 4),
    "heisenberg": (2, 3), "chaotic": (6, 7), "rolling_disc": (3, 4, 5), "snakeboard": (3, 4, 5),
}  # fmt: skip


@pytest.mark.parametrize("name", BUILT_IN)
def test_one_answer(name, monkeypatch):
    """With SymPy it is proved what the functions show; pages and checks say the same."""
    system = dal.systems.get(name)
    there = extras.is_there
    for exact in (True, False):
        monkeypatch.setattr(extras, "is_there", lambda x: there(x) and (exact or x != "sympy"))
        for report in (system.check(), system.check(system.q0, system.v0)):
            assert report.growth == report.general_growth == BUILT_IN[name]
            assert report.growth_note == "" and report.exact == exact and not report.integrable
            assert report.digits == (30 if exact else 16)
        how = "proved" if exact else "seen at random points, to 16 digits"
        said = dict(pages._distribution(system, report))["growth vector of D"]
        assert said == f"{BUILT_IN[name]}: D is bracket generating; {how}"


def test_proofs_overrule_what_is_seen(in_python):
    """A curvature below what differences see is one all the same."""
    small = sympy.Rational(1, 10**13)
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2 + z.d**2) / 2, [z.d - small * y * x.d], [x, y, z],
        q0=[0.1, 0.2, 0.3], v0=[0, 0, 0],
    )  # fmt: skip
    report = system.check()
    assert report.curvature < 1e-12 and not report.integrable and report.exact
    assert report.growth == (2, 3) and report.text.endswith("; D is not integrable")
    assert "disguise" not in str(report)
    plain = dal.System(mass=np.ones(3), mu=lambda q: [[-1e-13 * q[1], 0, 1]])
    seen = plain.check([0.1, 0.2, 0.3], np.zeros(3))
    assert seen.integrable and not seen.exact  # as far as 16 digits tell


@pytest.mark.parametrize("count", [1, 2])
def test_trailers_in_c(count):
    system = dal.systems.n_trailer(trailers=count)
    found, report = functions.examine(system, system.q0, system.q0), system.check()
    assert found.growth == found.general_growth == report.growth == tuple(range(2, count + 4))
    assert found.growth_note == report.growth_note == "" and report.exact


def test_formulas_that_say_something_else(monkeypatch):
    """Then only the functions count, as far as their digits go: 5 fields."""
    model_of_heisenberg = expressions.model(dal.systems.heisenberg())
    assert growth.agree(model_of_heisenberg, dal.systems.heisenberg(), np.ones(3))
    for name in ("particle", "disk"):
        system = dal.systems.get(name)
        assert not growth.agree(model_of_heisenberg, system, system.q0)
    monkeypatch.setattr(growth, "agree", lambda *_: False)
    report = dal.systems.n_trailer(trailers=4).check()
    assert report.growth == (2, 3, 4, 5, 6) and not report.exact
    assert report.growth_note == "brackets of more than 5 fields are not formed"


@pytest.mark.parametrize("derivative", [True, False])
def test_functions_of_python(derivative):
    """With and without derivatives, at general points and where they do less."""

    def slope(q, v):
        return [[0, -2 * q[1] * v[0], 0, 0], [0, 0, -v[0], 0]]

    system = dal.System(
        mass=np.ones(4),
        mu=lambda q: [[-(q[1] ** 2), 0, 1, 0], [-q[2], 0, 0, 1]],
        mu_v_q=slope if derivative else None,
        q0=[0.1, 0.2, 0.3, 0.4],
        v0=[0, 0, 0, 0],
    )
    q = dal.coordinates("x y z w")
    rows = [q[2].d - q[1] ** 2 * q[0].d, q[3].d - q[2] * q[0].d]
    assert system.check().growth == examine(rows, q).growth == (2, 3, 4)
    place = [0.3, 0.0, 0.5, 0.2]
    report = system.check(place, np.zeros(4))
    assert report.growth == examine(rows, q, place).growth == (2, 2, 3, 4)
    assert report.general_growth == (2, 3, 4)
    assert "at a general point   (2, 3, 4)" in str(report)


def test_derivatives_by_differences():
    """Their error is the same along all motions, and no direction of its own."""
    system = dal.System(
        mass=np.ones(4), mu=lambda q: [[-math.sin(9 * q[1]), 0, 1, 0], [0, 0, -q[1], 1]]
    )
    assert system.check([0, 0.5, 0, 0], np.zeros(4)).growth == (2, 3, 4)


def test_functions_with_a_small_domain():
    """Errors of the user's functions away from the state are none of the state."""

    def forms(q):
        if abs(q[1] - 0.2) > 1e-2:
            raise ZeroDivisionError("far away")
        return [[-q[1], 0, 1, 0], [-q[2], 0, 0, 1]]

    system = dal.System(mass=np.ones(4), mu=forms, q0=[0.1, 0.2, 0.3, 0.4], v0=np.zeros(4))
    found = functions.examine(system, system.q0, system.q0)
    assert found.growth == found.general_growth == (2, 3, 4) and found.growth_note == ""


def test_functions_that_are_not_smooth():
    system = dal.System(mass=np.ones(4), mu=lambda q: [[-abs(q[1]), 0, 1, 0], [-q[2], 0, 0, 1]])
    report = system.check(np.zeros(4), np.zeros(4))
    assert report.growth is None and report.general_growth == (2, 3, 4)
    assert "not known; mu does not appear to be smooth there" in str(report)


def test_functions_need_no_sympy():
    program = (
        "import sys; sys.modules['sympy'] = sys.modules['mpmath'] = None\n"
        "import dalembert as dal; print(dal.systems.disk().check().growth)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout == "(2, 3, 4)\n"


def test_no_growth_vector_of_other_constraints():
    for report in (
        dal.systems.ball_on_table().check(),
        dal.System(mass=[1, 1]).check([0, 0], [0, 0]),
    ):
        assert report.growth is None and report.growth_note == ""
        assert "growth" not in str(report)


# ---- integrability -------------------------------------------------------------------------------


INTEGRABLE = [
    ([z.d], [x, y, z]),
    ([x * x.d + y * y.d + z * z.d], [x, y, z]),
    ([y * x.d + x * y.d - z.d], [x, y, z]),
    ([exp(x) * (y * x.d + x * y.d + cos(z) * z.d)], [x, y, z]),
    ([cos(x) * y.d + sin(x) * sin(x) * z.d + cos(x) ** 2 * z.d - z.d], [x, y, z]),
    ([z * x.d + z * y.d + (x + y) * z.d], [x, y, z]),
    ([x.d - y * z.d, y.d], [x, y, z, w]),
    ([sin(x) * x.d + w.d, y.d - z * w.d - w * z.d], [x, y, z, w]),
    ([y * x.d - x * y.d], [x, y, z]),
    ([x.d + y.d, z.d + w * x.d + w * y.d], [x, y, z, w]),
    # of forms that are not closed: x dy + y dx times functions, mixed with each other
    ([exp(z) * (x * y.d + y * x.d) + z.d, w.d + x * z.d + x * exp(z) * (x * y.d + y * x.d)],
     [x, y, z, w]),
    ([cos(z) * x.d + sin(z) * y.d, sin(z) * x.d - cos(z) * y.d], [x, y, z, w]),
]  # fmt: skip
NOT_INTEGRABLE = [
    ([-sin(z) * x.d + cos(z) * y.d - z.d / 2], [x, y, z], (2, 3)),
    ([y.d - z * x.d, z.d - w * x.d], [x, y, z, w], (2, 3, 4)),
    ([w.d - y * x.d], [x, y, z, w], (3, 4)),
    ([z.d - y**2 * x.d], [x, y, z], (2, 3)),
    ([exp(x) * z.d - y * x.d], [x, y, z], (2, 3)),
    ([x.d, w.d - y * z.d], [x, y, z, w], (2, 3, 3)),
    ([z.d - y * x.d - w.d, w.d - y * x.d], [x, y, z, w], (2, 3, 3)),
    ([z.d - sympy.Rational(1, 10**6) * y * x.d], [x, y, z], (2, 3)),
]


@pytest.mark.parametrize(("constraints", "q"), INTEGRABLE)
def test_integrable(constraints, q, in_python):
    system = dal.System.from_sympy(sum(c.d**2 for c in q) / 2, constraints, q)
    n, m = len(q), len(constraints)
    state = [0.4, 0.5, 0.6, 0.7][:n], np.zeros(n)
    report = system.check(*state)
    assert report.growth == report.general_growth == (n - m, n - m) and report.exact
    assert report.integrable and report.holonomic
    assert "holonomic in disguise" in str(report)
    seen = functions.examine(system, np.array(state[0]), np.array(state[0]))
    assert seen.growth == seen.general_growth == (n - m, n - m) and seen.growth_note == ""
    assert seen.integrable is True and not seen.exact


@pytest.mark.parametrize(("constraints", "q", "expected"), NOT_INTEGRABLE)
def test_not_integrable(constraints, q, expected, in_python):
    system = dal.System.from_sympy(sum(c.d**2 for c in q) / 2, constraints, q)
    state = [0.4, 0.5, 0.6, 0.7][: len(q)], np.zeros(len(q))
    report = system.check(*state)
    assert report.growth == report.general_growth == expected and not report.integrable
    if expected[-1] < len(q):  # one of the constraints is holonomic, or two together make one
        assert len(report.holonomic) == 1
        alone = constraints[0] == x.d
        assert report.holonomic[0] == (
            "constraints[0]: x.d = 0" if alone else "1 of the constraints together"
        )
    else:
        assert report.exact and report.holonomic == ()
    seen = functions.examine(system, np.array(state[0]), np.array(state[0]))
    assert seen.growth == seen.general_growth == expected and seen.growth_note == ""
    assert seen.integrable is False and not seen.exact


def test_values_of_parameters_decide(in_python):
    """With a = 0 the constraint is a holonomic one."""
    a = sympy.Symbol("a")
    system = dal.System.from_sympy(
        (x.d**2 + y.d**2 + z.d**2) / 2, [z.d - a * y * x.d], [x, y, z], {a: 1}
    )
    state = [0.1, 0.2, 0.3], [0, 0, 0]
    assert system.check(*state).growth == (2, 3)
    plain = system.with_parameters(a=0).check(*state)
    assert plain.growth == (2, 2)
    assert len(plain.holonomic) == 1 and plain.holonomic[0].startswith("constraints[0]: ")


def test_check_finds_a_state_by_itself(in_python):
    system = dal.System.from_sympy((x.d**2 + y.d**2 + z.d**2) / 2, [z.d - y * x.d], [x, y, z])
    assert system.check() and system.check().growth == (2, 3)
    twice = [z.d - y * x.d, 2 * z.d - 2 * y * x.d]
    report = dal.System.from_sympy((x.d**2 + y.d**2 + z.d**2) / 2, twice, [x, y, z]).check()
    assert not report and report.rank == 1 and "rank" in report.text
    assert report.growth is None and "not known; found no point" in str(report)
    assert report.growth_note.endswith("mu has rank 1 instead of 2")
    far = [z.d - sqrt(x - 3) * y * x.d]
    assert dal.System.from_sympy((x.d**2 + y.d**2 + z.d**2) / 2, far, [x, y, z]).check()
    with pytest.raises(ValueError, match="no default initial data"):
        dal.System(mass=[1]).check()


@pytest.mark.parametrize("zero", [sympy.S.Zero, (sin(x) ** 2 + cos(x) ** 2 - 1) * x.d])
def test_a_constraint_that_is_nothing(zero):
    with pytest.raises(ValueError, match=r"constraints\[0\] = .*: it is 0 for all velocities"):
        examine([zero], [x, y, z])
