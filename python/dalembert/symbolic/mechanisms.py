"""Conversion of models of sympy.physics.mechanics to arguments of `System.from_sympy`.

A Lagrangian needs coordinates.  So the velocity of a mass centre has to be the derivative of a
position, and an angular velocity has to belong to an orientation.  This is tested with 60 digits at
a random state, because the expressions are too long for proofs.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from typing import Any

import mpmath
import sympy
from sympy.core.function import AppliedUndef

from .given import input_symbols

Expr = Any
Rule = dict[Expr, Expr]
Numbers = Any  # a vector or a matrix of mpmath


# ---- what is taken -----------------------------------------------------------------------------


def _refuse_kane(value: Any) -> None:
    from sympy.physics.mechanics import KanesMethod

    if isinstance(value, KanesMethod):
        raise ValueError(
            "a KanesMethod contains no Lagrangian, and its constraints only after "
            "elimination. Pass a mechanics.System to System.from_mechanics_system, with the "
            "coordinates, speeds, bodies, loads and velocity constraints. It needs one "
            "kinematic differential equation for each speed, dependent ones included"
        )


def from_method(method: Any, inputs: Any = ()) -> dict[str, Any]:
    """Return the arguments of from_sympy for a LagrangesMethod."""
    from sympy.physics.mechanics import LagrangesMethod

    _refuse_kane(method)
    if not isinstance(method, LagrangesMethod):
        raise ValueError(f"lm = {method!r}: expected a sympy.physics.mechanics.LagrangesMethod")
    q = list(method.q)
    V, force = _forces(method.forcelist, method.inertial, _Motion(q, {}), inputs)
    return {
        "L": method._L[0] - V,
        "constraints": list(method.coneqs),
        "positions": list(method._hol_coneqs or ()),
        "coordinates": q,
        "force": force,
    }


def from_system(system: Any, inputs: Any = ()) -> dict[str, Any]:
    """Return the arguments of from_sympy for a mechanics.System."""
    from sympy.physics import mechanics

    _refuse_kane(system)
    if not isinstance(system, mechanics.System):
        raise ValueError(f"system = {system!r}: expected a sympy.physics.mechanics.System")
    if len(system.u_aux):
        raise ValueError(f"auxiliary speeds {list(system.u_aux)} are not supported; remove them")
    q, rule = list(system.q), _velocities(system)
    known = (_orientation(body, system.frame) for body in system.bodies)
    motion = _Motion(q, rule, [R for R in known if R is not None])
    for body in system.bodies:
        _require_coordinates(body, system.frame, system.fixed_point, motion)
    loads = [*system.loads, *(load for act in system.actuators for load in act.to_loads())]
    V, force = _forces(loads, system.frame, motion, inputs)
    constraints = [*system.nonholonomic_constraints]
    if len(system.velocity_constraints) > len(constraints):
        constraints = list(system.velocity_constraints)
    L = mechanics.Lagrangian(system.frame, *system.bodies)
    return {
        "L": (L.subs(rule).doit() if rule else L) - V,
        "constraints": [c.subs(rule) for c in constraints],
        "positions": list(system.holonomic_constraints),
        "coordinates": q,
        "force": force,
    }


def _velocities(system: Any) -> Rule:
    """Return the generalized speeds in terms of the velocities.

    The kinematic differential equations are linear in the speeds.
    """
    speeds = [u for u in system.u if not isinstance(u, sympy.Derivative)]
    equations = list(system.kdes)
    if not speeds:
        return {}
    if len(equations) != len(speeds):
        free = [u for u in speeds if not any(e.has(u) for e in equations)] or speeds
        raise ValueError(
            f"speeds {free}: there are {len(equations)} kinematic differential equations for "
            f"{len(speeds)} speeds; expected one for each speed, which relates it to "
            "velocities. Add missing coordinates, such as those of a point, with "
            "system.add_coordinates, and equations, such as u - x.diff(), with system.add_kdes"
        )
    A, b = sympy.linear_eq_to_matrix(equations, speeds)
    try:
        return dict(zip(speeds, A.LUsolve(b)))
    except sympy.matrices.exceptions.NonInvertibleMatrixError:
        raise ValueError(
            f"kdes {equations} do not determine the speeds {speeds}; expected an equation for "
            "each speed, for example u - x.diff()"
        ) from None


# ---- numbers at a random state -----------------------------------------------------------------

_DIGITS, _APART = 60, mpmath.mpf(10) ** -12


class _Motion:
    """Expressions of a mechanism as numbers, along motions through a random state.

    The state is the point (0, 0) of a surface (t, q)(a, b); v is the derivative along a line of it.

    Parameters
    ----------
    q : list
        The coordinates.
    rule : dict
        The generalized speeds in terms of the velocities.
    orientations : iterable of Matrix, optional
        Orientations of the bodies.  Their quaternions are normalised to length 1, without which
        they are not rotations.
    """

    def __init__(self, q: list[Expr], rule: Rule, orientations: Iterable[Expr] = ()) -> None:
        from sympy.physics.mechanics import dynamicsymbols

        self.q, self.rule, self.time = q, rule, dynamicsymbols._t
        self.rates = [x.diff(self.time) for x in q]
        self._start, *self._lines = (
            mpmath.matrix([_number(f"{letter} {x}") for x in q]) for letter in "qab"
        )
        self._quaternions: list[tuple[list[int], Callable[..., Numbers]]] = []
        settled: set[int] = set()
        for R in orientations:
            own = [i for i, x in enumerate(q) if R.has(x) and i not in settled]
            settled.update(own)
            function = self.function(R)
            if abs(_length(function, *self._state(0, 0)) - 1) > 1e-9:
                self._quaternions.append((own, function))

    def function(self, expressions: Expr) -> Callable[..., Numbers]:
        """Return a matrix of expressions as a function of (t, q, v), with arbitrary parameters."""
        n = len(self.q)
        t, *names = sympy.symbols(f"t x:{2 * n}", cls=sympy.Dummy)
        state = dict(zip([self.time, *self.q, *self.rates], [t, *names]))
        found = sympy.Matrix(expressions).xreplace(self.rule).xreplace(state)
        if unknown := found.atoms(AppliedUndef):
            raise ValueError(
                f"{unknown.pop().func} is an unknown function in a position or a velocity; add it "
                f"to the coordinates, or write it as a function of {self.time}"
            )
        numbers = {e: _number(e) for e in found.free_symbols - {t, *names}}
        return sympy.lambdify([t, names[:n], names[n:]], found.xreplace(numbers), "mpmath")

    def _state(self, a: Any, b: Any) -> tuple[Any, Numbers]:
        """Return (t, q)."""
        t, q = _number("t") + a + b, self._start + a * self._lines[0] + b * self._lines[1]
        for own, function in self._quaternions:
            length = mpmath.sqrt(_length(function, t, q))
            for i in own:
                q[i] /= length
        return t, q

    def _at(
        self, function: Callable[..., Numbers], a: Any = 0, b: Any = 0, line: int = 0
    ) -> Numbers:
        """Return a function of (t, q, v) on the surface, with v along its first or second line."""
        v = _slope(lambda s: self._state(*((a, b + s) if line else (a + s, b)))[1])
        return function(*self._state(a, b), v)

    def is_rate(self, position: Expr, velocity: Expr) -> bool:
        """Return whether a matrix is the derivative of another."""
        place, rate = self.function(position), self.function(velocity)
        with mpmath.workdps(_DIGITS):
            found = _slope(lambda s: self._at(place, s))
            return _agree(found, self._at(rate), self._at(place))

    def is_angular(self, orientation: Expr, velocity: Expr) -> bool:
        """Return whether an angular velocity belongs to an orientation, both in a fixed frame."""
        turn, rate = self.function(orientation), self.function(velocity)
        with mpmath.workdps(_DIGITS):
            R = self._at(turn)
            W = _slope(lambda s: self._at(turn, s)) * R.T
            return _agree(mpmath.matrix([W[2, 1], W[0, 2], W[1, 0]]), self._at(rate), R)

    def is_integrable(self, velocity: Expr, turns: bool = False) -> bool:
        """Return whether a velocity is that of a position, or of an orientation.

        The condition on f is that d_a f(b) - d_b f(a) is 0 for a position.  For an orientation it
        is f(b) x f(a), in the rotating frame.
        """
        rate = self.function(velocity)
        with mpmath.workdps(_DIGITS):
            one, two = self._at(rate), self._at(rate, line=1)
            found = _slope(lambda s: self._at(rate, s, 0, 1))
            expected = _slope(lambda s: self._at(rate, 0, s, 0)) + turns * _cross(two, one)
            return _agree(found, expected, mpmath.matrix([*one, *two]))


def _number(e: Any) -> Any:
    """Return a number between a quarter and one for a symbol, always the same."""
    found = mpmath.mpf(random.Random(str(e)).uniform(0.25, 1))
    if getattr(e, "is_integer", False):
        found = mpmath.mpf(3)
    return -found if getattr(e, "is_negative", False) else found


def _length(orientation: Callable[..., Numbers], t: Any, q: Numbers) -> Any:
    """Return the length of the axes of a body: 1, or the squared norm of a quaternion."""
    return mpmath.norm(orientation(t, q, q)) / mpmath.sqrt(3)


def _slope(f: Callable[[Any], Numbers]) -> Numbers:
    return (f(_APART) - f(-_APART)) / (2 * _APART)


def _cross(a: Numbers, b: Numbers) -> Numbers:
    order = ((1, 2), (2, 0), (0, 1))
    return mpmath.matrix([a[i] * b[j] - a[j] * b[i] for i, j in order])


def _agree(a: Numbers, b: Numbers, size: Numbers) -> bool:
    """Return whether numbers agree, up to the rounding of doubles in the expressions."""
    return bool(
        mpmath.norm(a - b) <= 1e-9 * (mpmath.norm(a) + mpmath.norm(b)) + 1e-12 * mpmath.norm(size)
    )


# ---- bodies ------------------------------------------------------------------------------------


def _orientation(body: Any, frame: Any) -> Expr | None:
    """Return the matrix whose columns are the axes of a body; None if it is unknown."""
    from sympy.physics.mechanics import RigidBody

    try:
        return frame.dcm(body.frame) if isinstance(body, RigidBody) else None
    except ValueError:
        return None


def _require_coordinates(body: Any, frame: Any, fixed: Any, motion: _Motion) -> None:
    """Raise ValueError if velocities of a body are not derivatives."""
    from sympy.physics.mechanics import RigidBody

    centre, R = body.masscenter, _orientation(body, frame)
    velocity = centre.vel(frame)
    what = f"{body.name}: the velocity {velocity} of its mass centre {centre} in {frame}"
    components = _components(velocity, frame, what)
    try:
        position = centre.pos_from(fixed)
    except ValueError:
        if not motion.is_integrable(components):
            raise _no_derivative(what, "the derivative of any position", frame) from None
    else:
        if not motion.is_rate(position.to_matrix(frame), components):
            raise _no_derivative(what, f"the derivative of its position {position}", frame)
    if not isinstance(body, RigidBody):
        return
    omega = body.frame.ang_vel_in(frame)
    what = f"{body.name}: the angular velocity {omega} of its frame {body.frame} in {frame}"
    if R is None:
        if not motion.is_integrable(_components(omega, body.frame, what), turns=True):
            raise _no_derivative(what, "that of any orientation", frame)
    elif not motion.is_angular(R, omega.to_matrix(frame)):
        raise _no_derivative(what, "that of its orientation", frame)


def _components(vector: Any, frame: Any, what: str) -> Expr:
    """Return a vector as a matrix; ValueError if the orientation of its frames is unknown."""
    try:
        return vector.to_matrix(frame)
    except ValueError as error:
        raise ValueError(
            f"{what}: {error}; expected an orientation of each frame, for example "
            "A.orient_axis(N, theta, N.z)"
        ) from None


def _no_derivative(what: str, of: str, frame: Any) -> ValueError:
    return ValueError(
        f"{what} is not {of}. A Lagrangian needs velocities of coordinates. Derive the "
        "kinematic differential equations from positions and orientations; for example, the "
        f"speed u along A.x of a point at r = x*{frame}.x + y*{frame}.y has u - "
        f"r.dt({frame}).dot(A.x)"
    )


# ---- loads -------------------------------------------------------------------------------------


def _forces(
    loads: Iterable[Any], frame: Any, motion: _Motion, inputs: Any
) -> tuple[Expr, Rule | None]:
    """Return the potential and the generalized force of loads; None if there is no force.

    A load that is constant in the inertial frame has a potential: -F r for a force F on a point at
    r.  A constant component f of the generalized force, for example of a torque, has the potential
    -f q.
    """
    from sympy.physics.mechanics import Point

    V, force = sympy.Integer(0), dict.fromkeys(motion.q, sympy.Integer(0))
    loads, varying = list(loads or []), [*input_symbols(inputs).values(), motion.time]
    if loads and frame is None:
        raise ValueError("forcelist is given without frame: its forces need the inertial frame")

    def is_constant(e: Expr) -> bool:
        return not e.has(AppliedUndef, sympy.Derivative, *varying)

    for place, vector in loads:
        try:
            stays = is_constant(vector.to_matrix(frame))
        except ValueError:  # frames without an orientation
            stays = False
        work = _work(place, vector, frame, motion) if stays and isinstance(place, Point) else None
        if work is not None:
            V -= work
            continue
        for x, component in _generalized(place, vector, frame, motion).items():
            for term in sympy.Add.make_args(component):
                if stays and is_constant(term):
                    V -= term * x
                else:
                    force[x] += term
    return V, force if any(force.values()) else None


def _work(point: Any, force: Any, frame: Any, motion: _Motion) -> Expr | None:
    """Return F r of a constant force F on a point at r; None if its power is not d/dt (F r)."""
    power = sympy.Matrix([point.vel(frame).dot(force)])
    for fixed in _at_rest(point, frame):
        work = sympy.Matrix([point.pos_from(fixed).dot(force)])
        if motion.is_rate(work, power):
            return work[0]
    return None


def _at_rest(point: Any, frame: Any) -> list[Any]:
    """Return the points without a velocity that define the position of a point."""
    found = [point]
    for one in found:
        found += [other for other in one._pos_dict if other not in found]
    return [one for one in found if one._vel_dict.get(frame) == 0]


def _generalized(place: Any, vector: Any, frame: Any, motion: _Motion) -> Rule:
    """Return the generalized force of a force on a point, or a torque on a frame."""
    from sympy.physics.mechanics import Point

    at = place.vel(frame) if isinstance(place, Point) else place.ang_vel_in(frame)
    found = dict.fromkeys(motion.q, sympy.Integer(0))
    for x, rate in zip(motion.q, motion.rates):
        for u, expression in {rate: rate, **motion.rule}.items():
            slope = expression.diff(rate)
            if slope != 0 and (u == rate or at.free_dynamicsymbols(frame)):
                found[x] += slope * at.diff(u, frame, var_in_dcm=False).dot(vector)
    return {x: e.subs(motion.rule).doit() if motion.rule else e for x, e in found.items()}
