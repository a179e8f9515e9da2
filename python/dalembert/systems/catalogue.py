"""Systems of the library in SymPy: cars, robots, a gearbox, a control case.

They are functions of `dalembert.systems` like those written in C.  A call imports SymPy; each
system is compiled once, see `dalembert.compiler`.  The docstring of a function is the source of the
help, description and source of its system.

>>> import dalembert as dal
>>> car = dal.systems.steered_car(l=0.4)
>>> print(car)  # doctest: +ELLIPSIS
<System steered_car(x, y, theta, phi): 4 coordinates, 2 constraints; parameters m = 1, ...>
>>> car.invariants
('v_theta + v_phi', 'm (v_x^2 + v_y^2) + J v_theta^2')
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any

from ..core import arguments, extras
from ..symbolic import formula, symbols
from ..system import System

__all__ = [
    "cvt",
    "disguised",
    "roller_racer",
    "sleigh_with_rotor",
    "steered_car",
    "two_wheeled_robot",
]


_ABOUT: dict[str, dict[str, str]] = {}


def about(name: str) -> dict[str, str]:
    """Return help, description and source of a system, without SymPy."""
    return _ABOUT[name]


def _system(
    coordinates: str,
    *,
    L: str,
    constraints: Sequence[str],
    q0: str,
    v0: str,
    invariants: Sequence[str] = (),
    positive: str = "",
    **where: str,
) -> Callable[[Callable[..., None]], Callable[..., System]]:
    """Decorate a function: replace it by one that returns the system of these formulas.

    The decorated function supplies the parameters, which are numbers, and the docstring, to which
    formulas and initial data are added.  The names of coordinates, and of positive parameters, are
    separated by blanks.  ``where`` defines other names in the formulas; see `symbolic.formula`.
    """

    def decorate(describe: Callable[..., None]) -> Callable[..., System]:
        name, call = describe.__name__, tuple(coordinates.split())
        parameters = inspect.signature(describe).parameters.values()
        signature = inspect.Signature([*parameters], return_annotation="System")

        @functools.wraps(describe)
        def make(*args: float, **given: float) -> System:
            values = signature.bind(*args, **given)
            values.apply_defaults()
            numbers = values.kwargs
            for key, value in numbers.items():
                arguments.number(value, key)
            if not extras.is_there("sympy"):
                raise ImportError(f"the system {name} needs SymPy: pip install sympy")
            sympy = extras.require("sympy", f"the system {name}")
            assumed = dict.fromkeys(positive.split(), True)
            known = {x: sympy.Symbol(x, positive=assumed.get(x)) for x in numbers}
            q = [symbols.Coordinate(x, call) for x in call]
            known |= {"pi": sympy.pi, **{x.name: x for x in q}, **{f"v_{x}": x.d for x in q}}

            def read(text: str) -> Any:
                (found,) = formula.read(text)
                return found.xreplace({x: known[x.name] for x in found.free_symbols}).doit()

            known |= {key: read(text) for key, text in where.items()}
            made = System.from_sympy(
                read(L), [*map(read, constraints)], q, numbers, name=name, **about(name),
                q0=[*map(read, q0.split(","))], v0=[*map(read, v0.split(","))],
                invariants={text: read(text) for text in invariants},
            )  # fmt: skip
            made._source.of_library = True
            return made

        before, _, references = inspect.cleandoc(describe.__doc__ or "").partition("\n\nRef")
        head, *own = before.split("\n\nParameters")
        summary, *paragraphs = head.split("\n\n")
        prose = " ".join(x for x in paragraphs if not x.startswith(" ")).replace("::", ".")
        source = references.partition("-\n")[2].partition("\n\n")[0]
        told = (("help", summary), ("description", prose), ("source", source))
        _ABOUT[name] = {key: " ".join(text.split()) for key, text in told}
        lines = [f"L = {L}", *(f"{x} = 0" for x in constraints)]
        lines += [f"where {key} = {text}" for key, text in where.items()]
        make.__doc__ = "\n\n".join([
            head, "Formulas::", "    " + "\n    ".join(lines), *(f"Parameters{x}" for x in own),
            f"Returns\n-------\nSystem\n    Starts at q0 = ({q0}), v0 = ({v0}).",
            f"Ref{references}",
        ])  # fmt: skip
        make.__signature__ = signature  # type: ignore[attr-defined]
        return make

    return decorate


@_system(
    "x y theta phi",
    L="(m (v_x^2 + v_y^2) + J v_theta^2 + K (v_theta + v_phi)^2)/2",
    constraints=[
        "-sin(theta) v_x + cos(theta) v_y",
        "-sin(theta + phi) v_x + cos(theta + phi) v_y + l cos(phi) v_theta",
    ],
    q0="0, 0, 1/5, 3/10",
    v0="cos(1/5), sin(1/5), tan(3/10)/l, 0.5",
    invariants=["v_theta + v_phi", "m (v_x^2 + v_y^2) + J v_theta^2"],
    positive="m J K l",
)
def steered_car(
    *, m: float = 1.0, J: float = 0.2, K: float = 0.1, l: float = 0.5
) -> None:
    """Car with rear axle at (x, y), front axle (inertia K) at distance l, steered by phi.

    Coordinates x, y, theta, phi: middle of the rear axle, where the centre of mass is, heading, and
    angle of the front axle to it.  Both axles move along themselves only.

    No constraint acts on phi, so the momentum of the front axle and the energy of the rest are
    constant.

    Parameters
    ----------
    m, J, K : float
        Mass, inertia without the front axle, inertia of the front axle; positive.
    l : float
        Distance of the axles; positive.

    References
    ----------
    M. Kobilarov, J. E. Marsden, G. S. Sukhatme: Geometric discretization of nonholonomic
    systems with symmetries, Discrete Contin. Dyn. Syst. Ser. S 3 (2010) 61-84
    """


@_system(
    "x y theta phi",
    L="(m (v_x^2 + v_y^2) + J v_theta^2 + K (v_theta + v_phi)^2)/2",
    constraints=[
        "-sin(theta) v_x + cos(theta) v_y",
        "-sin(theta + phi) v_x + cos(theta + phi) v_y + (d1 cos(phi) + d2) v_theta + d2 v_phi",
    ],
    q0="0, 0, 0, 2/5",
    v0="1, 0, 1/2, (sin(2/5) - (d1 cos(2/5) + d2)/2)/d2",
    positive="m J K d1 d2",
)
def roller_racer(
    *,
    m: float = 1.0,
    J: float = 0.2,
    K: float = 0.05,
    d1: float = 0.5,
    d2: float = 0.2,
) -> None:
    """Roller racer: two bodies in a hinge, each on an axle; it drives by swinging the handle.

    Coordinates x, y, theta, phi: middle of the rear axle, heading of the body, and angle of the
    handle to it.  The body (m, J) has its centre of mass at (x, y); the handle (K) has no mass.
    The hinge is d1 ahead of the rear axle, and the axle of the handle d2 ahead of the hinge.

    Besides the energy there is an invariant with an elliptic integral, which the system does not
    list.  Its formula is in the docstring, where u is the speed along the heading and N is
    `sin(phi)^2/m + d1^2 cos(phi)^2/J`::

        atan2(sqrt(1 + K N/d2^2) (u sin(phi) - d1 theta' cos(phi)),
              d1 u cos(phi) sqrt(m/J) + theta' sin(phi) sqrt(J/m))
        - integral of d1/(sqrt(m J) N sqrt(1 + K N/d2^2)) over phi

    The handle finally comes to rest, and the racer moves in a circle.

    Parameters
    ----------
    m, J, K : float
        Mass and inertia of the body, inertia of the handle; positive.
    d1, d2 : float
        Distances of the axles from the hinge; positive.

    References
    ----------
    P. S. Krishnaprasad, D. P. Tsakiris: Oscillations, SE(2)-snakes and motion control: a
    study of the roller racer, Dyn. Syst. 16 (2001) 347-397
    """


@_system(
    "x y theta right left",
    # (u, w + a theta') has the length of (x', y') + a theta' (-sin(theta), cos(theta))
    L="(m (v_x^2 + v_y^2 + 2 a v_theta w + (a v_theta)^2) + J v_theta^2"
    " + I (v_right^2 + v_left^2))/2",
    constraints=["w", "u + b v_theta - r v_right", "u - b v_theta - r v_left"],
    q0="0, 0, 3/10, 0, 0",
    v0="cos(3/10)/5, sin(3/10)/5, 1, (1/5 + b)/r, (1/5 - b)/r",
    invariants=[
        "r (right - left) - 2 b theta",
        "m a theta/sqrt(A B) - atan(sqrt(A/B) u/v_theta)",
    ],
    positive="m J I b r",
    u="cos(theta) v_x + sin(theta) v_y",
    w="-sin(theta) v_x + cos(theta) v_y",
    A="m + 2 I/r^2",
    B="J + m a^2 + 2 I b^2/r^2",
)
def two_wheeled_robot(
    *,
    m: float = 2.0,
    J: float = 0.3,
    I: float = 0.05,
    a: float = 0.2,
    b: float = 0.3,
    r: float = 0.1,
) -> None:
    """Robot on two wheels (inertia I, radius r) at distance b either side, centre of mass a ahead.

    Coordinates x, y, theta, right, left: middle of the axle, heading, angles of the wheels.  The
    speed along the heading is `u = v_x cos(theta) + v_y sin(theta)`; w is the speed across it.

    One of the constraints is holonomic: `r (right - left) - 2 b theta` is constant.  The rest is a
    sleigh.  Its second invariant contains `A = m + 2 I/r^2` and `B = J + m a^2 + 2 I b^2/r^2`.

    Parameters
    ----------
    m, J, I : float
        Mass and inertia of the robot about its centre of mass, inertia of a wheel; positive.
    a : float
        Distance of the centre of mass ahead of the axle.
    b, r : float
        Half the distance of the wheels, and their radius; positive.

    References
    ----------
    G. Campion, G. Bastin, B. d'Andréa-Novel: Structural properties and classification of
    kinematic and dynamic models of wheeled mobile robots, IEEE Trans. Robot. Autom. 12 (1996)
    47-62
    """


@_system(
    "x y z",
    L="(v_x^2 + v_y^2 + v_z^2)/2 - (x^2 + z^2)/2 - y^2/2 - c y^3",
    constraints=["v_x + y v_z"],
    q0="1, 0.5, 0",
    v0="0, 0, 0",
    invariants=["v_y^2/2 + y^2/2 + c y^3", "(x^2 + z^2 + (1 + y^2) v_z^2)/2"],
)
def cvt(*, c: float = 0.2) -> None:
    """Gearbox (CVT) between oscillators x and z, whose ratio y swings in V = y^2/2 + c y^3.

    Coordinates x, y, z: the two oscillators, with y, the driver, between them.

    No force couples the driver to the pair x, z: the energy of each is constant.  For `c = 0` the
    system is `contact_oscillator`; otherwise the driver swings off centre.

    Parameters
    ----------
    c : float
        Asymmetry of the driver, which stays near 0 below the energy 1/(54 c^2).

    References
    ----------
    K. Modin, O. Verdier: What makes nonholonomic integrators work?, Numer. Math. 145 (2020)
    405-435
    """


@_system(
    "x y theta psi",
    L="(m (v_x^2 + v_y^2) + J v_theta^2 + K (v_theta + v_psi)^2)/2 - k psi^2/2",
    constraints=["-sin(theta) v_x + cos(theta) v_y - a v_theta"],
    q0="0, 0, 3/10, 0.6",
    v0="cos(3/10)/5 - a sin(3/10), sin(3/10)/5 + a cos(3/10), 1, -0.5",
    positive="m J K",
)
def sleigh_with_rotor(
    *,
    m: float = 1.5,
    J: float = 0.8,
    a: float = 0.4,
    K: float = 0.3,
    k: float = 0.5,
) -> None:
    """Chaplygin sleigh (m, J, a) with a rotor of inertia K on a torsion spring k.

    Coordinates x, y, theta, psi: centre of mass, where the rotor turns, heading, and angle of the
    rotor to the sleigh.  The blade, a distance a behind, moves along itself only.

    No constraint acts on psi, so only the torque `-k psi` of the spring changes the momentum `K
    (v_theta + v_psi)` of the rotor.  It is an invariant besides the energy for `k = 0` only.
    Without the spring the rotor does not affect the sleigh, which moves like `sleigh`.  With the
    spring, the rotor finally stops and the sleigh moves straight.

    Parameters
    ----------
    m, J, K : float
        Mass of the whole, inertia of the sleigh and of the rotor; positive.
    a : float
        Distance of the centre of mass ahead of the blade.
    k : float
        Stiffness of the spring.

    References
    ----------
    I. A. Bizyaev, A. V. Borisov, I. S. Mamaev: The Chaplygin sleigh with parametric
    excitation: chaotic dynamics and nonholonomic acceleration, Regul. Chaotic Dyn. 22 (2017)
    955-975, where the motion inside the sleigh is given instead
    """


@_system(
    "x y1 y2 y3 z1 z2 z3",
    L="(v_x^2 + v_y1^2 + v_y2^2 + v_y3^2 + v_z1^2 + v_z2^2 + v_z3^2)/2"
    " - (x^2 + y1^2 + y2^2 + y3^2 + z1^2 + z2^2 + z3^2 + z1^2 z2^2)/2"
    " - (y1^2 z1^2 + y2^2 z2^2 + y3^2 z3^2)/2",
    constraints=["v_x + z1 v_z1 + z2 v_z2 + z3 v_z3"],
    q0="cos(pi/9), 0.6, 0.4, 0.2, 1, 1, 1",
    v0="0, sin(pi/9), 0, 0, 0, 0, 0",
    invariants=["x + (z1^2 + z2^2 + z3^2)/2"],
)
def disguised() -> None:
    """Quartic oscillators with v_x = -sum z_i v_zi, a holonomic constraint in disguise.

    Coordinates x, y1, y2, y3, z1, z2, z3; the Lagrangian and the start of `chaotic`.

    The constraint is the time derivative of the invariant.  The system is a control case for
    properties of nonholonomic systems, and for `check`.

    References
    ----------
    The Lagrangian is that of R. McLachlan, M. Perlmutter: Integrators for nonholonomic mechanical
    systems, J. Nonlinear Sci. 16 (2006) 283-328

    Examples
    --------
    >>> import dalembert as dal
    >>> dal.systems.disguised().check().growth
    (6, 6)
    """
