"""Systems: the catalogue, systems of the user's own, and what they say about themselves."""

import copy
import pickle

import numpy as np
import pytest

import dalembert as dal
from conftest import particle_derivative, particle_forms


# ---- the catalogue -------------------------------------------------------------------------


def test_every_system_is_a_function():
    names = dal.systems.names()
    assert {"particle", "knife_edge", "sleigh", "disk", "heisenberg", "chaotic"} <= set(names)
    for name in names:
        make = getattr(dal.systems, name)
        system = make()
        assert system.name == name
        assert make.__name__ == name and name in dir(dal.systems)
        assert system.help in make.__doc__
        assert ", ".join(system.coordinates) in make.__doc__
        assert all(f"{key} : float, default" in make.__doc__ for key in system.parameters)
        assert system.q0.shape == system.v0.shape == (system.n,)
        assert system.relative_residual(system.q0, system.v0) <= 1e-8


def test_parameters():
    disk = dal.systems.disk(R=2)
    assert disk.parameters["R"] == 2.0
    np.testing.assert_array_equal(disk.residual([0, 0, 0, 0], [1, 0, 1, 0]), [1 - 2.0, 0])
    assert dal.systems.get("knife-edge").name == "knife_edge"


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: dal.systems.get("nonsense"), "nonsense'; choose one of: particle"),
        (lambda: dal.systems.get("slegh"), "did you mean 'sleigh'"),
        (lambda: dal.systems.known_states("knife-egde"), "did you mean 'knife_edge'"),
        (lambda: dal.systems.get(10**5000), "no system a value of type int; choose"),
        (lambda: dal.systems.disk(radius=1), "no 'radius'; it has m, I, J, R"),
        (lambda: dal.systems.disk(r=1), "no 'r'; did you mean 'R'"),
        (lambda: dal.systems.n_trailer(trailer=1), "no 'trailer'; did you mean 'trailers'"),
        (lambda: dal.systems.disk().with_parameters(j=1), "no 'j'; did you mean 'J'"),
        (lambda: dal.systems.disk(R=10**400), "R = 1000.*: expected a finite number"),
        (lambda: dal.systems.disk(R=np.nan), "R = nan"),
        (lambda: dal.systems.disk(R="1"), "R = .*: expected a finite number"),
    ],
)
def test_wrong_names_and_parameters(call, text):
    with pytest.raises(ValueError, match=text):
        call()


def test_unknown_attribute():
    with pytest.raises(AttributeError, match="did you mean 'particle'"):
        dal.systems.partcle  # noqa: B018


def test_representations():
    assert repr(dal.systems.sleigh()) == (
        "<System sleigh(x, y, theta): 3 coordinates, 1 constraint; "
        "parameters m = 1.5, J = 0.8, a = 0.4>"
    )
    assert repr(dal.systems.particle()) == "<System particle(x, y, z): 3 coordinates, 1 constraint>"
    free = dal.System(mass=[1.0], q0=[0], v0=[1], coordinates=["x"])
    assert repr(free) == "<System system(x): 1 coordinate, no constraints>"
    assert "5 coordinates, 2 affine constraints;" in repr(dal.systems.ball_on_table())


def test_exact_solution_of_the_particle(particle):
    t = 2.0
    q0, v0 = np.array([0.0, 0.0, 0.0]), np.array([1.0, 1.0, 0.0])
    q, v = particle.exact(t, q0, v0)
    # From y = t: v_x = 1 / sqrt(1 + t^2), z = sqrt(1 + t^2) - 1, x = asinh t.
    np.testing.assert_allclose(q, [np.arcsinh(t), t, np.sqrt(1 + t**2) - 1], rtol=1e-14)
    np.testing.assert_allclose(v, np.array([1, 0, t]) / np.sqrt(1 + t**2) + [0, 1, 0], rtol=1e-14)
    many = particle.exact([0.0, t], q0, v0)
    np.testing.assert_array_equal(many[0], [q0, q])
    np.testing.assert_array_equal(many[1], [v0, v])
    assert particle.has_exact


def test_no_exact_solution(own):
    assert not own.system().has_exact
    with pytest.raises(NotImplementedError, match="own"):
        own.system().exact(1.0)


def test_invariants_of_the_catalogue():
    for name in dal.systems.names():
        system = dal.systems.get(name)
        values = system.invariant(np.stack([system.q0] * 2), np.stack([system.v0] * 2))
        assert tuple(values) == system.invariants
        assert all(x.shape == (2,) and x[0] == x[1] for x in values.values())


# ---- systems of the user's own -------------------------------------------------------------


def test_properties(own):
    system = own.system(help="a line", coordinates=["a", "b", "c", "d"])
    assert (system.n, system.m, system.name, system.help) == (4, 2, "own", "a line")
    assert (system.description, system.source, system.formulas) == ("", "", ())
    assert system.coordinates == ("a", "b", "c", "d")
    assert system.parameters == {} and system.invariants == () and system.differenced == ()
    np.testing.assert_array_equal(system.mass, own.mass)
    np.testing.assert_array_equal(system.q0, own.q0)
    np.testing.assert_array_equal(system.v0, own.v0())
    assert not (system.mass.flags.writeable or system.q0.flags.writeable)
    assert "own(a, b, c, d)" in repr(system)
    assert "chaotic(x, y1, " in repr(dal.systems.chaotic(pairs=400))
    assert len(repr(dal.systems.chaotic(pairs=400))) < 120


def test_description_source_and_formulas(own):
    about = {"description": "größe", "source": "a book", "formulas": ("L = T", "v_a = 0")}
    system = own.system(**about)
    for one in (system, pickle.loads(pickle.dumps(system))):
        assert {key: getattr(one, key) for key in about} == about
    deformed = system.at_kept_nodes(0.1)
    assert (deformed.description, deformed.source, deformed.formulas) == ("", "", ())


def test_every_system_of_the_library_says_where_it_is_from():
    for name in dal.systems.names():
        system = dal.systems.get(name)
        assert system.description.endswith(".") and len(system.source) > 10
        assert system.source.split()[0] in getattr(dal.systems, name).__doc__
        assert "\n    " + system.formulas[0] + "\n" in getattr(dal.systems, name).__doc__


def test_mass_as_number_vector_and_matrix():
    for mass in (2, [2, 2], [[2, 0], [0, 2]]):
        system = dal.System(mass=mass, n=2)
        np.testing.assert_array_equal(system.mass, 2 * np.eye(2))
    assert dal.System(mass=1, coordinates="xyz").n == 3
    assert dal.System(mass=1, q0=[0, 0], v0=[0, 0]).n == 2


def test_arrays_of_the_user_are_copied():
    mass, q0 = np.eye(2), np.zeros(2)
    system = dal.System(mass=mass, q0=q0, v0=q0)
    mass *= 5
    q0 += 1
    again = pickle.loads(pickle.dumps(system))
    for s in (system, again):
        np.testing.assert_array_equal(s.mass, np.eye(2))
        np.testing.assert_array_equal(s.q0, [0, 0])


def test_defaults():
    system = dal.System(mass=[1, 1])
    assert (system.m, system.coordinates, system.q0, system.v0) == (0, ("q0", "q1"), None, None)


def test_differenced_are_named(own):
    assert own.system(gradient=None, hessian=None).differenced == ("gradient", "hessian")
    bare = own.system(mu_v_q=None)
    assert bare.differenced == ("mu_v_q",)
    assert dal.System(mass=[1]).differenced == ()


def test_former_names_of_the_constraints():
    """z' = y x' without forces: lambda = x' y' / (1 + y^2)."""
    functions = lambda q: [[-q[1], 0, 1]], lambda q, v: [[0, -v[0], 0]]  # noqa: E731
    former = dict(zip(("forms", "forms_velocity_derivative"), functions))
    with pytest.warns(DeprecationWarning) as warned:
        system = dal.System(mass=[1, 1, 1], **former)
    words = [str(one.message) for one in warned]
    assert words == [
        "System(forms=...) is deprecated: write mu=",
        "System(forms_velocity_derivative=...) is deprecated: write mu_v_q=",
    ]
    assert {one.filename for one in warned} == {__file__} and system.differenced == ()
    assert float(system.multipliers([0, 2, 0], [3, 1, 6])[0]) == pytest.approx(3 / 5, rel=1e-14)
    with pytest.warns(DeprecationWarning), pytest.raises(TypeError, match="'forms'"):
        dal.System(mass=[1, 1, 1], mu=functions[0], forms=functions[0])


def test_number_of_constraints_is_asked_for_at_q0():
    asked = []

    def forms(q):
        asked.append(q)
        return np.ones((1, 2))

    assert dal.System(mass=[1, 1], mu=forms, q0=[3, 4], v0=[1, -1]).m == 1
    np.testing.assert_array_equal(asked, [[3, 4]])
    dal.System(mass=[1, 1], mu=forms, m=1)
    assert len(asked) == 1


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"mass": [[1, 2], [3, 4]]}, "mass is not symmetric"),
        ({"mass": [[1, 2], [2, 1]]}, "mass is not positive definite"),
        ({"mass": [1, -1]}, "mass is not positive definite"),
        ({"mass": [1, np.nan]}, r"mass\[1\] = nan"),
        ({"mass": np.ones((2, 3))}, "square"),
        ({"mass": 1}, "n is missing"),
        ({"mass": [1, 1], "n": 3}, "n = 3"),
        ({"mass": [1, 1], "coordinates": ["x"]}, "coordinates"),
        ({"mass": [1, 1, 1], "coordinates": "x y"}, "coordinates = 'x y': expected several names"),
        ({"mass": [1, 1, 1], "coordinates": "x,y"}, "coordinates = 'x,y': expected several names"),
        ({"mass": [1, 1], "coordinates": ["x", "x"]}, "expected 2 different names"),
        ({"mass": [1, 1], "coordinates": 2}, "coordinates = 2: expected several names"),
        ({"mass": [1, 1], "q0": [0, 0]}, "q0 is given without v0: expected both, or neither$"),
        ({"mass": [1, 1], "v0": [0, 0]}, "v0 is given without q0"),
        ({"mass": [1, 10**400]}, "mass: .*an integer beyond the largest double"),
        ({"mass": np.ma.array([1, 2], mask=[0, 1])}, "mass: .*got masked values"),
        ({"mass": [1, 1], "invariants": b"x"}, "invariants = b'x': expected a mapping"),
        ({"mass": [1, 1], "invariants": {1: abs}}, "invariants = {1.*names that are strings"),
        ({"mass": [1, 1], "kind": 10**5000}, "kind = a value of type int: expected C functions"),
        ({"mass": [1, 1], "q0": [0, 0], "v0": [0]}, r"v0: expected shape \(2,\), got \(1,\)"),
        ({"mass": [1, 1], "gradient": lambda q: q}, "gradient is given without potential"),
        ({"mass": [1, 1], "hessian": lambda q: q}, "hessian is given without potential"),
        ({"mass": [1, 1], "mu_v_q": lambda q, v: q}, "without mu"),
        ({"mass": [1, 1], "potential": 3.0}, "potential = 3.0: expected a function"),
        ({"mass": [1, 1], "mu": lambda q: [1, 0]}, r"mu returned \(2,\): .*\(m, 2\)"),
        ({"mass": [1, 1], "mu": lambda q: np.ones((3, 2))}, "m = 3"),
        ({"mass": [1, 1], "m": 1}, "expected mu or"),
        ({"mass": 1, "n": "a"}, "n = .a.: expected an integer"),
        ({"mass": 1, "n": -1}, "n = -1: expected at least 1"),
        ({"mass": 1, "n": 2**62}, f"n = {2**62}: expected at most 10000"),
        ({"mass": 1, "n": 2, "invariants": {"p": None}}, r"invariants\['p'\] = None: expected a"),
        ({"mass": [1, 1], "m": 1.5, "mu": lambda q: [[1, 0]]}, "m = 1.5: expected an integer"),
        ({"mass": 1, "n": 2, "name": 3}, "name = 3: expected a string"),
        ({"mass": 1, "n": 2, "source": b"x"}, "source = b'x': expected a string"),
        ({"mass": 1, "n": 2, "formulas": [3]}, r"formulas = \[3\]: expected several lines"),
        ({"mass": 1, "n": 2, "formulas": None}, "formulas = None: expected several lines"),
        ({"mass": 1, "n": 2, "formulas": "L = T"}, "formulas = 'L = T': expected several lines"),
    ],
)
def test_wrong_definitions(arguments, text):
    with pytest.raises(ValueError, match=text):
        dal.System(**arguments)


def test_exact_and_invariants_of_the_user():
    free = dal.System(
        mass=[2, 2],
        exact=lambda t, q, v: (q + t * v, v),
        invariants={"p": lambda q, v: 2 * v[0]},
        q0=[0, 1],
        v0=[3, 4],
    )
    q, v = free.exact([1.0, 2.0])
    np.testing.assert_array_equal(q, [[3, 5], [6, 9]])
    np.testing.assert_array_equal(v, [[3, 4], [3, 4]])
    assert free.has_exact and free.invariants == ("p",)
    assert free.invariant([0, 0], [5, 0]) == {"p": 10.0}


# ---- check ---------------------------------------------------------------------------------


def test_check_passes(own, particle):
    report = own.system().check()
    assert report and report.passed, report.text
    assert report.rank == 2
    np.testing.assert_allclose(report.mass_min, np.linalg.eigvalsh(own.mass)[0], rtol=1e-10)
    assert report.residual <= 4 * 4 * 2.0**-53
    assert report.V_q.checked and report.V_qq.checked and report.phi_q.checked
    found = particle.check()
    assert not found.integrable and found.curvature > 0.1
    assert repr(found) == f"<Check: passed: {found.text}>"
    assert repr(particle.check([0, 1, 0], [1, 1, 3])).startswith("<Check: FAILED: ")


def test_check_finds_a_wrong_sign(own):
    report = own.system(gradient=lambda q: -own.gradient(q)).check()
    assert not report
    assert report.V_q.error > 0.1
    np.testing.assert_allclose(report.V_q.given, -report.V_q.expected, rtol=1e-6)
    assert "gradient" in str(report)


def test_check_needs_a_state():
    with pytest.raises(ValueError, match="q is missing"):
        dal.System(mass=[1]).check()
    with pytest.raises(ValueError, match="without v: expected both, or neither for those of"):
        dal.systems.particle().check([0, 1, 0])


def test_check_without_data_takes_a_state_of_D(in_python):
    x, y, z = dal.coordinates("x y z")
    own = dal.System.from_sympy(
        L=(x.d**2 + y.d**2 + z.d**2) / 2, constraints=[z.d - 100 * y * x.d]
    )
    assert own.check().passed and own.check().residual < 1e-15


# ---- what is given -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "call",
    [
        lambda one, **half: one.exact(0.1, **half),
        lambda one, **half: dal.integrate(one, h=0.1, steps=1, **half),
        lambda one, **half: dal.integrate(one, "reference", h=0.1, steps=1, **half),
        lambda one, **half: dal.reference(one, **half),
        lambda one, **half: dal.convergence(one, "midpoint", **half),
        lambda one, **half: dal.studies(one, "midpoint", **half),
        lambda one, **half: dal.embedding(one, "midpoint", h=0.1, **half),
    ],
)
@pytest.mark.parametrize("half, text", [("q0", "without v0"), ("v0", "without q0")])
def test_half_of_initial_data_is_refused(particle, call, half, text):
    """The other half would be that of the system, which nobody asked for."""
    with pytest.raises(ValueError, match=f"{text}: expected both, or neither for those of the sys"):
        call(particle, **{half: [0, 1, 0]})


def test_masked_values_are_refused(particle):
    free, masked = np.ones(3), np.ma.array([0.0, 1, 0], mask=[0, 1, 0])
    for q in (masked, [masked, masked], [0, np.ma.masked, 0]):
        with pytest.raises(ValueError, match="q: .*got masked values"):
            particle.energy(q, free)
    assert particle.energy(np.ma.array([0.0, 1, 0]), free) == 1.5


def test_a_number_does_for_one_coordinate():
    spring = dal.System(
        mass=1, n=1, potential=lambda q: q[0] ** 2 / 2, gradient=lambda q: q, q0=1.0, v0=0
    )
    assert spring.energy(3.0, 4.0) == 12.5 and spring.acceleration(2, 0).tolist() == [-2.0]
    assert spring.energy([[3.0], [0.0]], [[4.0], [1.0]]).tolist() == [12.5, 0.5]
    assert dal.reference(spring, 2.0, 0.0, t=1.0).q == pytest.approx(2 * np.cos(1), rel=1e-12)
    run = dal.integrate(spring, "midpoint", 2.0, 0.0, h=0.1, steps=1)
    with pytest.raises(ValueError, match=r"q0: expected shape \(1,\), got \(2,\)"):
        dal.integrate(spring, "midpoint", [2.0, 1.0], 0.0, h=0.1, steps=1)
    assert run.x[0].tolist() == [2.0, 0.0]
    with pytest.raises(ValueError, match=r"q0: expected shape \(3,\), got \(\)"):
        dal.integrate(dal.systems.particle(), h=0.1, steps=1, q0=1.0, v0=1.0)


# ---- pickling ------------------------------------------------------------------------------


def test_pickle_of_the_catalogue():
    again = pickle.loads(pickle.dumps(dal.systems.disk(R=2, m=3)))
    assert again.name == "disk"
    assert again.parameters == dal.systems.disk(R=2, m=3).parameters
    assert len(pickle.dumps(again)) < 500


def test_pickle_knows_what_is_of_the_library(in_python):
    """Pages say of a system of the library how `systems` makes it again."""
    for system in (dal.systems.cvt(), dal.systems.cvt().with_parameters(c=2)):
        assert system._source.of_library and pickle.loads(pickle.dumps(system))._source.of_library
    (x,) = dal.coordinates("x")
    own = dal.System.from_sympy(L=x.d**2 / 2)
    assert not pickle.loads(pickle.dumps(own))._source.of_library


def test_pickle_of_the_users_own(own):
    system = own.system()
    again = pickle.loads(pickle.dumps(system))
    assert (
        again.multipliers(own.q0, own.v0()).tolist()
        == system.multipliers(own.q0, own.v0()).tolist()
    )
    assert (again.name, again.m, again.differenced) == ("own", 2, ())
    np.testing.assert_array_equal(again.v0, system.v0)


def test_pickle_of_a_lambda_says_which():
    system = dal.System(
        mass=[1, 1, 1],
        mu=particle_forms,
        mu_v_q=particle_derivative,
        potential=lambda q: 0.0,
        name="local",
    )
    with pytest.raises(pickle.PicklingError, match="'local'.*potential"):
        pickle.dumps(system)
    assert copy.deepcopy(system) is system
