"""Models of sympy.physics.mechanics: what is taken from them, and what has no coordinates."""

import numpy as np
import pytest
import sympy
from conftest import U, refused, runge_kutta
from sympy.physics import mechanics
from sympy.physics.mechanics import dynamicsymbols

import dalembert as dal
from dalembert import core
from dalembert.symbolic import mechanisms


def sleigh_method(frame=None, forces=None):
    x, y, theta = dynamicsymbols("x y theta")
    m, J, a = sympy.symbols("m J a")
    t = dynamicsymbols._t
    L = (m * (x.diff(t) ** 2 + y.diff(t) ** 2) + J * theta.diff(t) ** 2) / 2 - m * x
    row = -sympy.sin(theta) * x.diff(t) + sympy.cos(theta) * y.diff(t) - a * theta.diff(t)
    values = {m: 1.5, J: 0.8, a: 0.4}
    method = mechanics.LagrangesMethod(
        L, [x, y, theta], nonhol_coneqs=[row], frame=frame, forcelist=forces
    )
    return method, values


def test_lagranges_method_round_trip():
    """The motion of SymPy's own rhs(), solved otherwise, and the documented sign of lambda."""
    method, values = sleigh_method()
    system = dal.System.from_lagranges_method(method, parameters=values)
    assert system.coordinates == ("x", "y", "theta") and system.mass is not None
    method.form_lagranges_equations()
    assert dal.System.from_lagranges_method(method, values)._model.key == system._model.key
    state = [*method.q, *method.q.diff(dynamicsymbols._t)]
    plain = sympy.symbols("s:6")
    rule = dict(zip(state, plain))
    backwards = dict(reversed(rule.items()))  # derivatives before functions
    rhs = sympy.lambdify([plain], list(method.rhs().subs(values).subs(backwards)))
    q0 = np.array([0.1, -0.2, 0.3])
    v0 = system.project(q0, np.array([0.4, 0.8, 1.0]))
    field = lambda t, s: np.array(rhs(s)[:6], dtype=float)  # noqa: E731
    end = runge_kutta(field, np.array([*q0, *v0]), 2.0, 800)  # h^4 = 4e-11
    run = dal.integrate(system, "leapfrog-kl8", q0, v0, h=0.02, t_end=2)
    np.testing.assert_allclose(run.y[:, -1], end, rtol=0, atol=1e-9)

    ours = system.multipliers(q0, v0)
    at = {**dict(zip(plain, [*q0, *v0])), **values}
    solved = method.rhs().subs(backwards).subs(at)
    np.testing.assert_allclose(float(solved[6]), ours[0], rtol=1e-12)
    accelerations = dict(zip(method.q.diff(dynamicsymbols._t, 2), system.acceleration(q0, v0)))
    equations = method.eom.subs(accelerations).subs(backwards).subs(at)
    multiplier = method.lam_vec[0]
    for equation in equations:  # they hold for -lambda
        assert abs(float(equation.subs(multiplier, -ours[0]))) < 1e-12


def test_forces_of_lagranges_method():
    """A force on a point and a torque become the generalized force."""
    N = mechanics.ReferenceFrame("N")
    body = mechanics.ReferenceFrame("B")
    x, y, theta = dynamicsymbols("x y theta")
    body.orient_axis(N, theta, N.z)
    centre = mechanics.Point("C")
    centre.set_vel(N, x.diff() * N.x + y.diff() * N.y)
    method, values = sleigh_method(N, [(centre, 3 * body.x), (body, -theta.diff() * N.z)])
    system = dal.System.from_lagranges_method(method, values)
    assert system.is_forced
    q, v = [0.1, 0.2, 0.7], [1.0, 2.0, 3.0]
    power = 3 * (np.cos(0.7) * 1.0 + np.sin(0.7) * 2.0) - 9.0
    _, force = power_of(system, q, v)
    assert force == pytest.approx(power, rel=16 * U)
    with pytest.raises(ValueError, match="inertial frame"):
        dal.System.from_lagranges_method(sleigh_method(None, [(centre, N.x)])[0], values)


def power_of(system, q, v):
    with system._mechanics.lend() as mechanics_of:
        x = np.array([*q, *v])
        found = np.zeros(2)
        core.check(
            core.lib.dal_power(
                mechanics_of, 0.0, core.pointer(x), core.pointer(found),
                core.pointer(found[1:]),
            )
        )  # fmt: skip
    return found


def test_mechanics_system():
    """Bodies, a joint and a knife edge, with generalized speeds, against the same by hand."""
    x, y, theta, u, w, omega = dynamicsymbols("x y theta u w omega")
    m, J = sympy.symbols("m J")
    frame = mechanics.ReferenceFrame("N")
    origin = mechanics.Point("O")
    origin.set_vel(frame, 0)
    made = mechanics.System(frame, origin)
    body = mechanics.ReferenceFrame("B")
    body.orient_axis(frame, theta, frame.z)
    body.set_ang_vel(frame, omega * frame.z)
    centre = origin.locatenew("C", x * frame.x + y * frame.y)
    centre.set_vel(frame, u * frame.x + w * frame.y)
    inertia = (mechanics.inertia(body, 0, 0, J), centre)
    sleigh = mechanics.RigidBody("S", centre, body, m, inertia)
    sleigh.potential_energy = 2 * m * x
    made.add_bodies(sleigh)
    made.add_coordinates(x, y, theta)
    made.add_speeds(u, w, omega)
    made.add_kdes(u - x.diff(), w - y.diff(), omega - theta.diff())
    made.add_loads(mechanics.Torque(body, -omega * frame.z))
    made.add_nonholonomic_constraints(-sympy.sin(theta) * u + sympy.cos(theta) * w)
    system = dal.System.from_mechanics_system(made, {m: 1.5, J: 0.8}, name="sleigh")
    X, Y, T = dal.coordinates("x y theta")
    twin = dal.System.from_sympy(
        (1.5 * (X.d**2 + Y.d**2) + 0.8 * T.d**2) / 2 - 3 * X,
        [-sympy.sin(T) * X.d + sympy.cos(T) * Y.d],
        [X, Y, T],
        force={T: -T.d},
    )
    q, v = [0.1, 0.2, 0.7], [1.0, 2.0, 3.0]
    np.testing.assert_allclose(system.acceleration(q, v), twin.acceleration(q, v), rtol=1e-13)
    assert system.mass is not None and system.is_forced


def car(kdes, position=None, orientation=True, rate=None):
    """A planar body whose mass centre has the velocity u A.x + v A.y, and the coordinates q."""
    q, u = dynamicsymbols("x y th"), dynamicsymbols("u v w")
    N, A = mechanics.ReferenceFrame("N"), mechanics.ReferenceFrame("A")
    O, P = mechanics.Point("O"), mechanics.Point("P")
    if orientation:
        A.orient_axis(N, q[2], N.z)
    axes = (A.x, A.y) if orientation else (N.x, N.y)
    A.set_ang_vel(N, u[2] * A.z if rate is None else rate(u, A))
    P.set_vel(N, u[0] * axes[0] + u[1] * axes[1])
    if position:
        P.set_pos(O, position(q, N))
    body = mechanics.RigidBody("car", P, A, 2, (mechanics.inertia(A, 1, 2, 3), P))
    body.potential_energy = 7 * q[1]
    made = mechanics.System(N, O)
    made.add_coordinates(*q)
    made.add_speeds(*u)
    made.add_kdes(*(speed - along for speed, along in zip(u, kdes(q, [x.diff() for x in q]))))
    made.add_bodies(body)
    return made


def body_fixed(q, v):
    """The velocities along the axes of the car, and its rate."""
    c, s = sympy.cos(q[2]), sympy.sin(q[2])
    return c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]


def test_quasi_coordinates():
    """What is no velocity of coordinates is refused by name; a car with the right ones falls."""

    def place(q, N):
        return q[0] * N.x + q[1] * N.y

    def plain(q, v):
        return v

    right = [
        car(body_fixed), car(body_fixed, place), car(plain, orientation=False),
        car(plain, place, orientation=False),
    ]  # fmt: skip
    for made in right:
        system = dal.System.from_mechanics_system(made)
        found = system.acceleration([0.1, 0.2, 0.7], [1, 2, 3])
        np.testing.assert_allclose(found, [0, -3.5, 0], rtol=0, atol=16 * U)
        assert system.energy([0.1, 0.2, 0.7], [1, 2, 3]) == pytest.approx(5 + 13.5 + 1.4)

    def tumbling(u, A):
        return u[0] * A.x + u[1] * A.y + u[2] * A.z

    wrong = [
        (car(plain), r"car: the velocity u\(t\).A.x .* centre P in N is not the derivative of any"),
        (car(plain, place), "P in N is not the derivative of its position"),
        (car(body_fixed, lambda q, N: 2 * place(q, N)), "is not the derivative of its position"),
        (car(body_fixed, rate=lambda u, A: 2 * u[2] * A.z), "angular velocity .* is not that of"),
        (car(plain, place, False, tumbling), "angular velocity .* is not that of any orientation"),
        (
            car(lambda q, v: v[:2]),
            r"speeds \[w\(t\)\]: there are 2 kinematic .* for 3 speeds.*add_kd",
        ),
        (car(lambda q, v: (v[0], v[1], v[2] + dynamicsymbols("w"))), "do not determine the speeds"),
    ]
    refused((lambda made=made: dal.System.from_mechanics_system(made), words)
            for made, words in wrong)  # fmt: skip
    driven = car(plain, place)
    support = dynamicsymbols("z")
    driven.bodies[0].masscenter.set_vel(driven.frame, support.diff() * driven.frame.z)
    with pytest.raises(ValueError, match=r"^z is an unknown function in a position or a vel"):
        dal.System.from_mechanics_system(driven)
    loose = car(plain, place)
    loose.bodies[0].masscenter.set_vel(loose.frame, mechanics.ReferenceFrame("L").x)
    with pytest.raises(ValueError, match="car: .* expected an orientation of each frame"):
        dal.System.from_mechanics_system(loose)


def test_orientations():
    """Euler angles, a spherical joint, and a quaternion, which turns nothing but at length 1."""
    N, O = mechanics.ReferenceFrame("N"), mechanics.Point("O")
    O.set_vel(N, 0)

    def top(q, orient, factor=1):
        A = mechanics.ReferenceFrame("A")
        orient(A)
        A.set_ang_vel(N, factor * A.ang_vel_in(N))
        C = O.locatenew("C", A.z)
        C.v2pt_theory(O, N, A)
        made = mechanics.System(N, O)
        made.add_coordinates(*q)
        made.add_bodies(mechanics.RigidBody("top", C, A, 1, (mechanics.inertia(A, 1, 2, 3), C)))
        return made

    angles, p = dynamicsymbols("a b c"), dynamicsymbols("p:4")
    for q, orient in (
        (angles, lambda A: A.orient_body_fixed(N, angles, "123")),
        (p, lambda A: A.orient_quaternion(N, p)),
    ):
        assert mechanisms.from_system(top(q, orient))["coordinates"] == list(q)
        with pytest.raises(ValueError, match="top: the velocity .* is not the derivative of its"):
            mechanisms.from_system(top(q, orient, 2))
    # the angular velocity of the first one, in axes whose orientation is not given
    A = mechanics.ReferenceFrame("A")
    A.orient_body_fixed(N, angles, "123")
    for sign in (1, -1):
        B, C = mechanics.ReferenceFrame("B"), mechanics.Point("C")
        omega = sign * A.ang_vel_in(N).to_matrix(A)
        B.set_ang_vel(N, omega[0] * B.x + omega[1] * B.y + omega[2] * B.z)
        C.set_vel(N, 0)
        made = mechanics.System(N, O)
        made.add_coordinates(*angles)
        made.add_bodies(mechanics.RigidBody("top", C, B, 1, (mechanics.inertia(B, 1, 2, 3), C)))
        if sign > 0:
            assert mechanisms.from_system(made)["coordinates"] == list(angles)
        else:
            with pytest.raises(ValueError, match="top: .* is not that of any orientation"):
                mechanisms.from_system(made)
    wall, ball = mechanics.RigidBody("wall"), mechanics.RigidBody("ball")
    joined = mechanics.System.from_newtonian(wall)
    joined.add_joints(mechanics.SphericalJoint("J", wall, ball, child_point=ball.x))
    assert len(mechanisms.from_system(joined)["coordinates"]) == 3


def test_rolling_disc():
    """A disc with six speeds, three of them 0 where it touches, against its known equations."""
    x, y, z, q1, q2, q3 = q = dynamicsymbols("x y z q1:4")
    u = dynamicsymbols("u1:7")
    m, r, g = 1.5, 0.4, 9.81
    N, O, D = mechanics.ReferenceFrame("N"), mechanics.Point("O"), mechanics.Point("D")
    Y = N.orientnew("Y", "Axis", [q1, N.z])
    lean = Y.orientnew("L", "Axis", [q2, Y.x])
    R = lean.orientnew("R", "Axis", [q3, lean.y])
    axes, turn = (lean.x, Y.z.cross(lean.x), Y.z), R.ang_vel_in(N)
    rate = x.diff() * N.x + y.diff() * N.y + z.diff() * N.z
    kdes = [w - turn.dot(a) for w, a in zip(u, (lean.x, lean.y, lean.z))]
    kdes += [w - rate.dot(a) for w, a in zip(u[3:], axes)]
    R.set_ang_vel(N, sum((w * a for w, a in zip(u, (lean.x, lean.y, lean.z))), mechanics.Vector(0)))
    D.set_vel(N, sum((w * a for w, a in zip(u[3:], axes)), mechanics.Vector(0)))
    inertia = mechanics.inertia(lean, m / 4 * r**2, m / 2 * r**2, m / 4 * r**2)
    made = mechanics.System(N, O)
    made.add_coordinates(*q)
    made.add_speeds(*u)
    made.add_kdes(*kdes)
    made.add_bodies(mechanics.RigidBody("disc", D, R, m, (inertia, D)))
    made.apply_uniform_gravity(-g * N.z)
    contact = D.vel(N) + R.ang_vel_in(N).cross(-r * lean.z)
    made.add_nonholonomic_constraints(*(contact.dot(a) for a in axes))
    system = dal.System.from_mechanics_system(made)
    q0 = [0, 0, r * np.cos(0.2), 0.3, 0.2, 0.1]
    v0 = system.consistent(q0, [0, 0, 0, 1.1, 0.4, 6], keep=["q1", "q2", "q3"])
    w1, w2, w3, c, s, t = 1.1, 0.4, 6.0, np.cos(0.2), np.sin(0.2), np.tan(0.2)
    expected = [
        -2 * w2 * w3 / c, 4 * g * s / (5 * r) + np.sin(0.4) * w1**2 / 2 + 6 * c * w1 * w3 / 5,
        -(10 * c * w1 - 12 * t * w3) * w2 / 6,
    ]  # fmt: skip
    np.testing.assert_allclose(system.acceleration(q0, v0)[3:], expected, rtol=1e-12)
    assert not system.is_forced


def hanging(load):
    """A pendulum of length 2 and mass 3, as bodies, with a load; theta = 0 hangs down."""
    theta, u = dynamicsymbols("theta u")
    N, O, P = mechanics.ReferenceFrame("N"), mechanics.Point("O"), mechanics.Point("P")
    A = N.orientnew("A", "Axis", [theta, N.z])
    P.set_pos(O, -2 * A.y)
    A.set_ang_vel(N, u * N.z)
    O.set_vel(N, 0)
    P.v2pt_theory(O, N, A)
    made = mechanics.System(N, O)
    made.add_coordinates(theta)
    made.add_speeds(u)
    made.add_kdes(u - theta.diff())
    made.add_bodies(mechanics.Particle("bob", P, 3))
    for one in load(N, A, P, theta):
        made.add_loads(one)
    return made


def test_constant_loads_have_a_potential():
    """Weights and constant torques are in the energy; what turns or is an input is a force."""
    g, tau = sympy.symbols("g tau")

    def weight(N, A, P, theta):
        return [mechanics.Force(P, -3 * g * N.y), mechanics.Torque(A, 5 * N.z)]

    system = dal.System.from_mechanics_system(hanging(weight), {g: 9.81})
    assert system.conserves_energy and not system.is_forced
    at = [0.5], [2.0]
    assert system.energy(*at) == pytest.approx(6 * 4 - 3 * 9.81 * 2 * np.cos(0.5) - 5 * 0.5)
    fall = (5 - 3 * 9.81 * 2 * np.sin(0.5)) / 12
    np.testing.assert_allclose(system.acceleration(*at), [fall], rtol=8 * U)
    run = dal.integrate(system, "leapfrog", *at, h=0.01, steps=200, energy="keep")
    assert np.ptp(run.energy) < 1e-12

    forces = {
        14: lambda N, A, P, theta: [mechanics.Force(P, 7 * A.x)],
        4.2 * np.cos(0.5): lambda N, A, P, theta: [mechanics.Force(P, 7 * dynamicsymbols._t * N.x)],
        -0.5: lambda N, A, P, theta: [mechanics.Torque(A, -theta * N.z)],
        0.2: lambda N, A, P, theta: [mechanics.Torque(A, tau * N.z)],
        0.3: lambda N, A, P, theta: [mechanics.Torque(A, dynamicsymbols._t * N.z)],
    }
    for expected, load in forces.items():
        given = mechanisms.from_system(hanging(load), [tau])
        (theta,) = given["coordinates"]
        assert sympy.simplify(given["L"] - 6 * theta.diff() ** 2) == 0
        there = given["force"][theta].subs({theta: 0.5, tau: 0.2, dynamicsymbols._t: 0.3})
        assert float(there) == pytest.approx(expected)


def test_a_force_at_a_contact_is_no_gradient():
    """The point of a rolling wheel that touches is at rest, while its place moves on."""
    x, y, th = dynamicsymbols("x y th")
    N = mechanics.ReferenceFrame("N")
    A = N.orientnew("A", "Axis", [th, N.z])
    O, C = mechanics.Point("O"), mechanics.Point("C")
    O.set_vel(N, 0)
    C.set_pos(O, x * N.x + y * N.y)
    C.set_vel(N, x.diff() * N.x + y.diff() * N.y)
    K = C.locatenew("K", -N.y)
    K.set_vel(N, C.vel(N) + A.ang_vel_in(N).cross(-N.y))
    L = (x.diff() ** 2 + y.diff() ** 2 + th.diff() ** 2) / 2
    loads = [(C, -9 * N.y), (K, 4 * N.x), (A, th.diff() * N.z)]
    method = mechanics.LagrangesMethod(L, [x, y, th], forcelist=loads, frame=N)
    given = mechanisms.from_method(method)
    # 4 at K: 4 (x' + th'), so that the constant torque 4 has a potential, too
    assert sympy.expand(given["L"] - L - (4 * x - 9 * y + 4 * th)) == 0
    assert given["force"] == {x: 0, y: 0, th: th.diff()}


def test_mechanics_refused():
    x, u = dynamicsymbols("x u")
    N = mechanics.ReferenceFrame("N")
    kane = mechanics.KanesMethod(N, [x], [u], kd_eqs=[u - x.diff()])
    for make in (dal.System.from_lagranges_method, dal.System.from_mechanics_system):
        with pytest.raises(
            ValueError, match="KanesMethod contains no Lagrangian.*from_mechanics_system"
        ):
            make(kane)
        with pytest.raises(ValueError, match="expected a sympy.physics.mechanics"):
            make(5)


def test_positions_of_mechanics():
    """A LagrangesMethod, and a System, with holonomic constraints."""
    x, y = mechanics.dynamicsymbols("x y")
    L = (x.diff() ** 2 + y.diff() ** 2) / 2 - 9.81 * y
    lm = mechanics.LagrangesMethod(L, [x, y], hol_coneqs=[x**2 + y**2 - 1])
    frame = mechanics.ReferenceFrame("N")
    origin = mechanics.Point("O")
    bodies = mechanics.System(frame=frame, fixed_point=origin)
    bob = mechanics.Particle("P", origin.locatenew("p", x * frame.x + y * frame.y), 1)
    bob.masscenter.set_vel(frame, x.diff() * frame.x + y.diff() * frame.y)
    bob.potential_energy = 9.81 * y
    bodies.add_bodies(bob)
    bodies.q_ind = [x, y]
    bodies.u_ind = [x.diff(), y.diff()]
    bodies.add_holonomic_constraints(x**2 + y**2 - 1)
    for system in (
        dal.System.from_lagranges_method(lm), dal.System.from_mechanics_system(bodies)
    ):  # fmt: skip
        assert system.m == 1 and system.positions == ("x**2 + y**2 - 1",)
        # at rest on its side: x'' = 0 and y'' = -g on the circle
        np.testing.assert_allclose(system.acceleration([1, 0], [0, 0]), [0, -9.81])
        with pytest.warns(dal.DalembertWarning, match=r"a position constraint.* is 0.21 at"):
            dal.integrate(system, q0=[1.1, 0], v0=[0, 0], h=0.01, steps=1)
