"""Bodies: the shapes that represent the state of a system in films and snapshots.

A body is a function of ``(t, q, v)`` that returns shapes: outlines, bars, blades, dots and arrows,
in the plane or in space.  Each system of the catalogue has one.  For your own system, write a
function:

>>> import dalembert as dal
>>> draw = dal.plot.bodies
>>> def skater(t, q, v):
...     x, y, theta = q
...     return [draw.circle((x, y), 0.3), draw.blade((x, y), theta, 1.0, constraints=0)]
>>> run = dal.integrate(dal.systems.knife_edge(), "leapfrog", h=0.02, t_end=5)
>>> film = dal.plot.animate(run, skater)

A shape with ``constraints`` is a contact: its middle leaves a trail, and the reaction of these
constraints is drawn there.  If no shape is a contact, the dots leave trails.  The bodies of the
library are drawn to scale; parts without a size in the model (a blade, a sledge around it) have a
visible size.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..core import Array, arguments
from ..geometry import residual
from ..run import Solution

__all__ = ["ROLES", "Shape", "arrow", "blade", "circle", "dot", "line", "polygon"]

# In the order of the pages' script: what a shape is, which says how it is drawn.
ROLES = ("ground", "plane", "body", "bar", "blade", "dot", "velocity", "reaction")


@dataclass(frozen=True, eq=False)
class Shape:
    """Points, and their role in a drawing.

    Attributes
    ----------
    role : str
        One of ``bodies.ROLES``: "body" and "plane" are closed and filled; "ground", "bar" and
        "blade" are lines; "dot" is one point; "velocity" and "reaction" are arrows from the first
        point to the second.
    points : ndarray, shape (K, 2) or (K, 3)
        In the user's units of length.
    constraints : tuple of int
        Numbers of the constraints whose reaction acts at the mean of the points.

    Examples
    --------
    >>> Shape("bar", [[0, 0], [1, 0]]).points.shape
    (2, 2)
    """

    role: str
    points: Any
    constraints: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        arguments.choice(self.role, "role", dict.fromkeys(ROLES, 0))
        points = arguments.array(self.points, "points", (None, 2), (None, 3))
        least = {"dot": 1, "body": 3, "plane": 3}.get(self.role, 2)
        if len(points) < least:
            raise ValueError(
                f"points: expected at least {least} for a {self.role}, got {len(points)}"
            )
        object.__setattr__(self, "points", points)

    @property
    def middle(self) -> Array:
        """The mean of the points, shape (2,) or (3,)."""
        return np.asarray(self.points.mean(axis=0))


Body = Callable[[float, Array, Array], Iterable[Shape]]


def polygon(points: ArrayLike) -> Shape:
    """Return a closed, filled outline.

    Parameters
    ----------
    points : array_like, shape (K, 2) or (K, 3)

    Examples
    --------
    >>> polygon([(0, 0), (1, 0), (0, 1)]).role
    'body'
    """
    return Shape("body", points)


def circle(centre: ArrayLike, radius: float) -> Shape:
    """Return a filled circle in the plane.

    Parameters
    ----------
    centre : array_like, shape (2,)
    radius : float

    Examples
    --------
    >>> circle((1, 2), 0.5).middle.round(9).tolist()
    [1.0, 2.0]
    """
    centre = arguments.array(centre, "centre", (2,))
    return Shape("body", centre + arguments.number(radius, "radius") * _ROUND)


def line(*points: ArrayLike) -> Shape:
    """Return a thin line through points: a bar, an axle, a spoke.

    Parameters
    ----------
    *points : array_like, shape (2,) or (3,)

    Examples
    --------
    >>> line((0, 0), (1, 0)).role
    'bar'
    """
    return Shape("bar", points)


def blade(
    centre: ArrayLike, heading: float, length: float, constraints: int | Sequence[int] = ()
) -> Shape:
    """Return a blade, or a wheel seen from above, as a thick line along its direction of motion.

    Parameters
    ----------
    centre : array_like, shape (2,)
    heading : float
        Angle to the x axis.
    length : float
    constraints : int or sequence of int, optional
        Numbers of the constraints that guide it.

    Examples
    --------
    >>> blade((0, 0), 0.0, 2.0).points.tolist()
    [[-1.0, 0.0], [1.0, 0.0]]
    """
    centre = arguments.array(centre, "centre", (2,))
    half = arguments.number(length, "length") / 2 * direction(arguments.number(heading, "heading"))
    return Shape("blade", centre + [-half, half], _numbers(constraints))


def dot(place: ArrayLike, constraints: int | Sequence[int] = ()) -> Shape:
    """Return a marked point: a centre of mass, a point of contact.

    Parameters
    ----------
    place : array_like, shape (2,) or (3,)
    constraints : int or sequence of int, optional
        Numbers of the constraints whose reaction acts there.

    Examples
    --------
    >>> dot((1, 2), constraints=[0, 1]).constraints
    (0, 1)
    """
    place = arguments.array(place, "place", (2,), (3,))
    return Shape("dot", [place], _numbers(constraints))


def arrow(place: ArrayLike, vector: ArrayLike) -> Shape:
    """Return an arrow in the style of velocities.

    Parameters
    ----------
    place, vector : array_like, shape (2,) or (3,)
        Start of the arrow, and the vector from there to its tip, in units of length.

    Examples
    --------
    >>> arrow((1, 0), (2, 1)).points.tolist()
    [[1.0, 0.0], [3.0, 1.0]]
    """
    place = arguments.array(place, "place", (2,), (3,))
    return Shape("velocity", [place, place + arguments.array(vector, "vector", place.shape)])


def _numbers(constraints: int | Sequence[int]) -> tuple[int, ...]:
    each = [constraints] if np.ndim(constraints) == 0 else constraints
    return tuple(arguments.integer(x, "constraints", 0) for x in each)  # type: ignore[union-attr]


# ---- geometry ------------------------------------------------------------------------------------

_ANGLES = np.linspace(0, 2 * np.pi, 40, endpoint=False)
_ROUND = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
# A sledge that looks along x, of length 1 and about half as wide; and a box, of sides 1.
_SLEDGE = np.array(
    [(-0.3, -0.16), (0.35, -0.2), (0.6, -0.12), (0.7, 0), (0.6, 0.12), (0.35, 0.2), (-0.3, 0.16)]
)
_BOX = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])


def direction(angle: float) -> Array:
    """Return the unit vector at an angle to the x axis."""
    return np.array([np.cos(angle), np.sin(angle)])


def _normal(angle: float) -> Array:
    return np.array([-np.sin(angle), np.cos(angle)])


def _placed(points: Array, at: ArrayLike, heading: float) -> Array:
    """Return points given in the frame of a body."""
    return np.asarray(at) + points @ np.array([direction(heading), _normal(heading)])


def size(points: Array) -> float:
    """Return the longest side of the box around points; 1 for a single point."""
    longest = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    return longest if longest > 0 else 1.0


def forms(run: Solution, t: Array, q: Array, v: Array, columns: Sequence[int]) -> Array:
    """Return some columns of mu = phi_v at states, shape (N, m, number of columns).

    They are differences of phi, exact up to roundoff if phi is affine in v.  Otherwise the step is
    small compared with v.
    """
    speed = np.abs(v).max(axis=1)
    at_least = np.finfo(float).tiny if run.system.kind == "nonlinear" else 1.0
    step = 1e-5 * np.maximum(at_least, speed)
    pushes = np.zeros((len(columns), *v.shape))
    for k, column in enumerate(columns):
        pushes[k, :, column] = step
    around = np.concatenate([v + pushes, v - pushes]).reshape(-1, run.system.n)
    many = 2 * len(columns)
    phi = residual(run.system, np.tile(q, (many, 1)), around, t=np.tile(t, many))
    ahead, behind = phi.reshape(2, len(columns), len(q), run.system.m)
    return np.asarray(np.moveaxis((ahead - behind) / (2 * step[:, None]), 0, 2))


# ---- points --------------------------------------------------------------------------------------


def point(run: Solution, coordinates: Sequence[int]) -> Body:
    """Return a dot at some coordinates, with its velocity, in space with the plane of D."""
    places = list(coordinates)
    where, v = run.q[:, places], run.v[:, places]
    whole = size(where)
    scale = 0.15 * whole / max(float(np.abs(v).max()), 1e-300)
    every = range(run.system.m)
    flat = len(places) == 1
    tangent = len(places) == 3 == run.system.n and run.system.m == 1

    def shapes(t: float, q: Array, v: Array) -> list[Shape]:
        at, rate = q[places], v[places]
        if flat:
            at, rate = np.append(at, 0.0), np.append(rate, 0.0)
        found = [arrow(at, scale * rate), dot(at, every)]
        if tangent:
            mu = forms(run, np.array([t]), q[None], v[None], places)[0, 0]
            # The columns behind the first are orthogonal to it, and span the plane.
            plane = np.linalg.svd(mu[None])[2][1:]
            found.insert(0, Shape("plane", at + 0.12 * whole * _ROUND @ plane))
        return found

    return shapes


def _in_space(run: Solution) -> Body:
    return point(run, range(3))


# The parameters of a system, the size of the path in the plane of x and y, and the state.
_Drawing = Callable[[Mapping[str, float], float, float, Array, Array], list[Shape]]


def _drawn(shapes: _Drawing) -> Callable[[Solution], Body]:
    """Return a function that makes the body of a run from a drawing."""

    def make(run: Solution) -> Body:
        return functools.partial(shapes, run.system.parameters, size(run.q[:, :2]))

    return make


@_drawn
def _pairs(p: Any, whole: float, t: float, q: Array, v: Array) -> list[Shape]:
    """Draw the oscillators (y_i, z_i) of `chaotic` and `disguised` as dots in one plane."""
    pairs = len(q) // 2
    return [dot((q[1 + i], q[1 + pairs + i])) for i in range(pairs)]


# ---- blades --------------------------------------------------------------------------------------


@_drawn
def _knife_edge(p: Any, whole: float, t: float, q: Array, v: Array) -> list[Shape]:
    length = 0.12 * whole
    return [blade(q[:2], q[2], length, 0), dot(q[:2] + 0.5 * length * direction(q[2]))]


def _sleigh(ahead: float, rotor: float = 0.0) -> Callable[[Solution], Body]:
    """Return a sledge whose (x, y) is ``ahead`` times a ahead of the blade."""

    @_drawn
    def make(p: Any, whole: float, t: float, q: Array, v: Array) -> list[Shape]:
        a = p["a"]
        length = max(2.2 * abs(a), 0.08 * whole)
        side = length if a >= 0 else -length
        foot = q[:2] - ahead * a * direction(q[2])
        centre = foot + a * direction(q[2])
        found = [
            polygon(_placed(side * _SLEDGE, foot, q[2])),
            blade(foot, q[2], 0.5 * length, 0),
            dot(centre),
        ]
        if rotor:
            arm = rotor * length * direction(q[2] + q[3])
            found[2:2] = [circle(centre, rotor * length), line(centre - arm, centre + arm)]
        return found

    return make


# ---- wheels in space -----------------------------------------------------------------------------


def _wheel(
    heading: int, roll: int, radius: str, lean: int | None = None
) -> Callable[[Solution], Body]:
    """Return a wheel with a mark on its rim; the arguments are the indices of its angles in q.

    A material point has the angle s from the lowest point at roll = 0.
    """

    @_drawn
    def make(p: Any, whole: float, t: float, q: Array, v: Array) -> list[Shape]:
        r = p[radius]
        ahead = np.append(direction(q[heading]), 0.0)
        tilt = 0.0 if lean is None else q[lean]
        aside = np.append(-_normal(q[heading]), 0.0)
        up = np.array([0, 0, np.cos(tilt)]) + np.sin(tilt) * aside
        foot = np.append(q[:2], 0.0) - r * np.sin(tilt) * aside
        centre = foot + r * up

        def rim(angle: Any) -> Array:
            s = np.atleast_1d(q[roll] + angle)[:, None]
            return centre - r * (np.sin(s) * ahead + np.cos(s) * up)

        spokes = [line(rim(s)[0], rim(s + np.pi)[0]) for s in (0, np.pi / 2)]
        # The rim begins below, whatever the roll: its first point is the contact.
        return [
            polygon(rim(_ANGLES - q[roll])), *spokes, Shape("blade", rim(_RIM)), dot(foot, (0, 1)),
        ]  # fmt: skip

    return make


_RIM = np.linspace(-0.2, 0.2, 5)


def _ball(run: Solution) -> Body:
    """Return a ball seen from above; spokes of the table show its rotation."""
    a, turn = run.system.parameters["a"], run.system.parameters["Omega"]
    reach = float(np.hypot(*run.q[:, :2].T).max()) + 1.3 * a
    spokes = np.arange(3) * np.pi / 3

    def shapes(t: float, q: Array, v: Array) -> list[Shape]:
        ends = [reach * direction(turn * t + s) for s in spokes]
        rim = reach * np.concatenate([_ROUND, _ROUND[:1]])
        return [
            Shape("ground", rim), *(Shape("ground", [-x, x]) for x in ends),
            circle(q[:2], a), dot(q[:2], (0, 1)),
        ]  # fmt: skip

    return shapes


# ---- vehicles ------------------------------------------------------------------------------------


def _axle(
    centre: Array, heading: float, width: float, length: float, constraint: int
) -> list[Shape]:
    """Return two wheels and the axle between them; the reaction acts at its middle."""
    side = width * _normal(heading)
    return [
        line(centre - side, centre + side),
        blade(centre - side, heading, length),
        blade(centre + side, heading, length),
        dot(centre, constraint),
    ]


@_drawn
def _snakeboard(p: Any, whole: float, t: float, q: Array, v: Array) -> list[Shape]:
    r, at, theta, psi, phi = p["r"], q[:2], q[2], q[3], q[4]
    arm = 0.45 * r * direction(theta + psi)
    back, front = at - r * direction(theta), at + r * direction(theta)
    return [
        polygon(_placed(_BOX * (2.1 * r, 0.3 * r), at, theta)),
        *_axle(back, theta + phi, 0.32 * r, 0.4 * r, 0),
        *_axle(front, theta - phi, 0.32 * r, 0.4 * r, 1),
        line(at - arm, at + arm),
        dot(at + arm),
        dot(at - arm),
    ]


@_drawn
def _n_trailer(p: Any, whole: float, t: float, q: Array, v: Array) -> list[Shape]:
    d, at, found = p["d"], q[:2], []
    for i, theta in enumerate(q[2:]):
        if i > 0:
            behind = at - d * direction(theta)
            found.append(line(at, behind))
            at = behind
        long = 0.55 * d if i == 0 else 0.4 * d
        found.append(polygon(_placed(_BOX * (long, 0.36 * d), at, theta)))
        found += _axle(at, theta, 0.26 * d, 0.28 * d, i)
    return found


@_drawn
def _steered_car(p: Any, whole: float, t: float, q: Array, v: Array) -> list[Shape]:
    l, at, theta, phi = p["l"], q[:2], q[2], q[3]
    ahead = l * direction(theta)
    return [
        polygon(_placed(_BOX * (1.5 * l, 0.5 * l), at + ahead / 2, theta)),
        *_axle(at, theta, 0.34 * l, 0.34 * l, 0),
        *_axle(at + ahead, theta + phi, 0.34 * l, 0.34 * l, 1),
    ]


@_drawn
def _roller_racer(p: Any, whole: float, t: float, q: Array, v: Array) -> list[Shape]:
    d1, d2, at, theta, phi = p["d1"], p["d2"], q[:2], q[2], q[3]
    width = 0.35 * (d1 + d2)
    hinge = at + d1 * direction(theta)
    front = hinge + d2 * direction(theta + phi)
    seat = [(-0.25 * width, -width), (-0.25 * width, width), (d1, 0)]
    return [
        polygon(_placed(np.array(seat), at, theta)),
        line(hinge, front),
        *_axle(at, theta, width, 0.6 * width, 0),
        *_axle(front, theta + phi, 0.6 * width, 0.6 * width, 1),
        dot(hinge),
    ]


@_drawn
def _two_wheeled_robot(p: Any, whole: float, t: float, q: Array, v: Array) -> list[Shape]:
    a, b, r, at, theta = p["a"], p["b"], p["r"], q[:2], q[2]
    side = b * _normal(theta)
    return [
        circle(at, 0.9 * b),
        line(at - side, at + side),
        line(at, at + a * direction(theta)),
        blade(at - side, theta, 2 * r, 1),
        blade(at + side, theta, 2 * r, 2),
        dot(at, 0),
        dot(at + a * direction(theta)),
    ]


# ---- which system has which ----------------------------------------------------------------------

_MADE: dict[str, Callable[[Solution], Body]] = {
    "particle": _in_space,
    "particle_oscillator": _in_space,
    "heisenberg": _in_space,
    "contact_oscillator": _in_space,
    "cvt": _in_space,
    "genmass": _in_space,
    "chaotic": _pairs,
    "disguised": _pairs,
    "knife_edge": _knife_edge,
    "sleigh": _sleigh(1.0),
    "sleigh_with_rotor": _sleigh(1.0, 0.22),
    "sleigh_contact": _sleigh(0.0),
    "disk": _wheel(3, 2, "R"),
    "robot": _wheel(2, 3, "R"),
    "rolling_disc": _wheel(2, 4, "r", lean=3),
    "ball_on_table": _ball,
    "snakeboard": _snakeboard,
    "n_trailer": _n_trailer,
    "steered_car": _steered_car,
    "roller_racer": _roller_racer,
    "two_wheeled_robot": _two_wheeled_robot,
}


PAIRS = tuple(name for name, make in _MADE.items() if make is _pairs)
IN_SPACE = tuple(name for name, make in _MADE.items() if make is _in_space)


def of(run: Solution) -> Body | None:
    """Return the body of a system of the library; None for other systems."""
    system = run.system
    return _MADE[system.name](run) if system._source.of_library else None
