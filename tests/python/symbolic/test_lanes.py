"""Members stepped together by a compiled model: as each alone, whoever its neighbours are."""

import dataclasses
import shutil

import numpy as np
import pytest
import sympy
from sympy import Heaviside, Max, Min, Piecewise, Rational, cos, exp, sign, sin, sqrt, tanh

import dalembert as dal
from dalembert import compiler
from dalembert.core import ffi, lib
from dalembert.symbolic import codegen
from dalembert.symbolic.evaluation import library

U = 2.0**-53
MOST = 16  # lanes
SCHEMES = ["explicit", "midpoint", "endpoint", "0.3", "leapfrog-kl8"]


def free(q):
    return sum(x.d**2 for x in q) / 2


def particle():
    x, y, z = q = dal.coordinates("x y z")
    return dal.System.from_sympy(free(q), [z.d - y * x.d])


def particle_oscillator():
    x, y, z = q = dal.coordinates("x y z")
    k1, k2 = sympy.symbols("k1 k2")
    V = (k1 * x**2 + k2 * y**2 + 1.5 * z**2) / 2
    return dal.System.from_sympy(free(q) - V, [z.d - y * x.d], parameters={k1: 1, k2: 2})


def contact_oscillator():
    x, y, z = q = dal.coordinates("x y z")
    V = (x**2 + y**2 + z**2 + Rational(3, 10) * x**2 * z**2) / 2
    return dal.System.from_sympy(free(q) - V, [x.d + y * z.d])


def knife_edge():
    x, y, theta = dal.coordinates("x y theta")
    m, J = sympy.symbols("m J")
    L = m * (x.d**2 + y.d**2) / 2 + J * theta.d**2 / 2 + 5 * x
    return dal.System.from_sympy(L, [sin(theta) * x.d - cos(theta) * y.d], parameters={m: 2, J: 1})


def sleigh():
    x, y, theta = dal.coordinates("x y theta")
    m, J, a = sympy.symbols("m J a")
    L = (m * (x.d**2 + y.d**2) + J * theta.d**2) / 2
    row = -sin(theta) * x.d + cos(theta) * y.d - a * theta.d
    return dal.System.from_sympy(L, [row], parameters={m: 1.5, J: 0.4, a: 0.3})


def robot():
    x, y, phi, theta = dal.coordinates("x y phi theta")
    R, k = sympy.symbols("R k")
    L = (3 * (x.d**2 + y.d**2) + phi.d**2 + theta.d**2) / 2 - k * sin(theta)
    rows = [x.d - R * cos(phi) * theta.d, y.d - R * sin(phi) * theta.d]
    return dal.System.from_sympy(L, rows, parameters={R: 0.7, k: 0.8})


def pivoting():
    """Three rows in units of their own whose order of pivots changes on the way, and a full M."""
    a, b, c, d, e, f = q = dal.coordinates("a b c d e f")
    s = sympy.Symbol("s")
    L = free(q) + s * (a.d * b.d + c.d * d.d) / 4 - (a**2 + b**2 + c**2 + d**2 * e**2 + f**2) / 2
    rows = [a * a.d + b * b.d + d.d / 5, 1000 * (b * a.d - a * b.d + c * c.d + e.d / 5),
            (c * b.d + a * c.d + f.d / 5 + d * e.d) / 50]  # fmt: skip
    return dal.System.from_sympy(L, rows, parameters={s: 1})


def unconstrained():
    x, y = q = dal.coordinates("x y")
    return dal.System.from_sympy(free(q) - (x**2 + y**2 + x**2 * y**2) / 2)


def jumping():
    """Everything that is a choice, in V, which is smooth enough, and in mu."""
    x, y, z = q = dal.coordinates("x y z")
    k = sympy.Symbol("k")
    V = k * Max(0, x) ** 2 + Min(y, k) ** 2 * sign(y) * y + Heaviside(z) * z**3
    V += Piecewise((x**2 * y**2, (x > 0) & (y > 0)), (x**4, (z < 0) | ~(y > k)), (x**6, True))
    row = z.d - (y + abs(x) * x) * x.d + sqrt(2) * Max(x, y) ** 2 * y.d
    return dal.System.from_sympy(free(q) - V - (x**2 + y**2 + z**2) / 2, [row], parameters={k: 1})


def timed():
    """Time in V and mu, a force without velocities, and more functions of the math library."""
    x, y, z = q = dal.coordinates("x y z")
    t, w = dal.time, sympy.Symbol("w")
    row = z.d - (y + sin(w * t) / 2) * x.d + tanh(x) * y.d
    force = {x: exp(-(x**2)) * cos(t), y: -y / (1 + x**2) ** Rational(3, 2)}
    L = free(q) - z**2 / 2 - sympy.erf(x + y) / 9
    return dal.System.from_sympy(L, [row], parameters={w: 2}, force=force)


def heavy():
    """M(q), with a row whose terms change sign."""
    x, y, z = dal.coordinates("x y z")
    T = (1 + y**2) * x.d**2 + y.d**2 + (1 + x**2 / 2) * z.d**2 + y * x.d * z.d / 4
    return dal.System.from_sympy(T / 2 - x**2 - y**2 * z**2, [z.d - y * x.d])


def loose():
    """M(q) without constraints."""
    x, y = dal.coordinates("x y")
    return dal.System.from_sympy(((1 + y**2) * x.d**2 + y.d**2) / 2 - x**2 - y**2 / 2)


def dragged():
    """Constant mass, and a force that depends on v and on time: stages with and without momenta."""
    x, y, z = q = dal.coordinates("x y z")
    force = {x: -(x.d**3) / 10 + dal.time * y / 9, y: x * y.d / 5}
    return dal.System.from_sympy(free(q) - x**2, [z.d - y * x.d], force=force)


def turntable():
    """Affine rows."""
    x, y, a, b, c = q = dal.coordinates("x y a b c")
    rows = [x.d - 3 * b.d / 10 + y / 5, y.d + 3 * a.d / 10 - x / 5]
    return dal.System.from_sympy(free(q) - x**2 / 10, rows)


def curved():
    """A row that is not linear in v."""
    x, y, z = q = dal.coordinates("x y z")
    return dal.System.from_sympy(free(q) + x**2 / 10, [z.d - x.d**2 / 2 + x.d * y.d / 3 + y / 5])


def long():
    """Many operations, whose values are stored on the way."""
    x, y, z = q = dal.coordinates("x y z")
    V = sum((x + k * y / 7) ** 4 * (1 + (y - sqrt(k) * z) ** 2 / k) for k in range(1, 31)) / 900
    return dal.System.from_sympy(free(q) - V - (x**2 + y**2 + z**2) / 2, [z.d - y * x.d])


ALGEBRAIC = [
    particle_oscillator, pivoting, unconstrained, jumping, heavy, loose, dragged, turntable,
    curved, long,
]  # fmt: skip


class Lanes:
    """The lanes of a system and a scheme."""

    def __init__(self, like, vector=0):
        made = ffi.new("dal__lanes **")
        assert lib.dal__lanes_new(made, like._handle, ffi.NULL) == 0
        self.like, self.vector = like, vector
        self.handle = ffi.gc(made[0], lib.dal__lanes_free)
        self.width = lib.dal__lanes_use(self.handle, vector)

    def load(self, lane, stepper):
        lib.dal__lanes_load(self.handle, lane, stepper._handle)

    def advance(self, steps):
        lib.dal__lanes_advance(self.handle, steps)

    def made(self, lane):
        return lib.dal__lanes_made(self.handle, lane)

    def state(self, lane):
        x = np.zeros(2 * self.like.system.n)
        lib.dal__lanes_state(self.handle, lane, ffi.cast("double *", x.ctypes.data))
        return x

    def unload(self, lane, stepper):
        lib.dal__lanes_unload(self.handle, lane, stepper._handle)


def after(lanes, lane, steps, stepper):
    """Return the state after so many steps: where a lane stops, as C is looked at there, which is
    rare, the stepper makes a step of its own."""
    made, stops = lanes.made(lane), 0
    while made < steps:
        lanes.unload(lane, stepper)
        stepper.step()
        lanes = Lanes(stepper, lanes.vector)
        lanes.load(lane, stepper)
        lanes.advance(steps - made - 1)
        made, stops = made + 1 + lanes.made(lane), stops + 1
    assert stops <= 0.05 * steps + 4
    return lanes.state(lane)


def together(system):
    """Return the system compiled with lanes."""
    return dal.System._of(dataclasses.replace(system._source, part="lanes"))


def members(system, scheme, count=MOST, h=0.01, size=0.6, speed=1.0):
    """Return steppers with parameters and initial data of their own, the same ones for each system
    that differs by its library alone."""
    rng = np.random.default_rng(5)
    made = []
    for _ in range(count):
        own = {key: value * rng.uniform(0.9, 1.1) for key, value in system.parameters.items()}
        one = system.with_parameters(**own) if own else system
        q, v = rng.uniform(-size, size, one.n), rng.uniform(-speed, speed, one.n)
        made.append(dal.Stepper(one, scheme, h=h, q0=q, v0=one.project(q, v, t=0.0)))
    return made


def state(stepper):
    return np.concatenate([stepper.q, stepper.v])


def vectors(system):
    """Return how many lanes there are in a vector, for each set of instructions of this machine."""
    like = dal.Stepper(system, "midpoint", h=0.01, q0=np.zeros(system.n), v0=np.zeros(system.n))
    return [vector for vector in (8, 4, 2) if Lanes(like, vector).width]


@pytest.fixture
def flags(request, monkeypatch, tmp_path):
    """With and without the vector math library, with the flags of users, and by a compiler that
    passes vectors otherwise."""
    if request.param == "clang":
        monkeypatch.setenv("CC", "clang")
    if request.param in ("libm", "users"):
        monkeypatch.setenv("DALEMBERT_CACHE", str(tmp_path))
        monkeypatch.setattr(compiler, "_libraries", {})
    if request.param == "libm":
        monkeypatch.setattr(compiler, "_flags_for_lanes", lambda _: compiler.COMMON)
    if request.param == "users":
        for name in ("COMMON", "FLAGS"):
            plain = tuple(flag for flag in getattr(compiler, name) if flag != "-O0")
            monkeypatch.setattr(compiler, name, plain)
    return request.param


CASES = [(x, "libmvec") for x in (pivoting, unconstrained, jumping, knife_edge, sleigh, timed)]
CASES += [(x, "libmvec") for x in (heavy, loose, dragged, turntable, curved, long)]
CASES += [(timed, "libm"), (particle_oscillator, "users"), (robot, "users")]
CASES += [(robot, "clang")] * (shutil.which("clang") is not None)  # .ci/run installs it


@pytest.mark.parametrize("make, flags", CASES, indirect=["flags"],
                         ids=lambda x: getattr(x, "__name__", x))  # fmt: skip
def test_as_alone(make, flags):
    """300 steps of all lanes, by each set of instructions: the bits of the steps of each member
    alone, but where sin is another one; and D is kept."""
    system = make()
    with_lanes = together(system)
    for scheme in SCHEMES:
        alone = members(system, scheme)
        for stepper in alone:
            stepper.step(steps=300)
        for vector in vectors(with_lanes):
            loaded = members(with_lanes, scheme)
            lanes = Lanes(loaded[0], vector)
            for lane in range(lanes.width):
                lanes.load(lane, loaded[lane])
            lanes.advance(300)
            for lane in range(lanes.width):
                x, expected = after(lanes, lane, 300, loaded[lane]), state(alone[lane])
                if flags == "libm" or make in ALGEBRAIC:
                    np.testing.assert_array_equal(x, expected)
                    continue
                assert np.abs(x - expected).max() <= 1e-12 * np.abs(expected).max()
                one = alone[lane]
                residual = one.system.relative_residual(*np.split(x, 2), t=one.t)
                assert np.max(residual) <= 4 * system.n * U


def count(system, scheme, lane, lanes):
    """Return what the statistics of a lane count."""
    stepper = members(system, scheme, lane + 1)[lane]
    lanes.unload(lane, stepper)
    found = stepper.stats
    return found.iterations, found.constraint_calls, found.potential_calls, found.worst_residual


@pytest.mark.parametrize("make", [robot, jumping, heavy], ids=lambda make: make.__name__)
def test_neighbours_do_not_matter(make):
    """Lanes in another order, alone, beside others that stop at once or later, in other pieces."""
    system = together(make())
    for scheme in ("midpoint", "leapfrog", "leapfrog-kl8"):
        good = members(system, scheme)
        bad = members(system, scheme, h=1e3), members(system, scheme, speed=1e120)
        for vector in vectors(system):
            lanes = Lanes(good[0], vector)
            width = lanes.width
            for lane in range(width):
                lanes.load(lane, good[lane])
            lanes.advance(300)
            expected = [lanes.state(lane) for lane in range(width)]
            counts = [count(system, scheme, lane, lanes) for lane in range(width)]
            assert all(lanes.made(lane) == 300 for lane in range(width))
            for order in (range(width)[::-1], np.random.default_rng(1).permutation(width)):
                other = Lanes(good[0], vector)
                for lane, member in enumerate(order):
                    other.load(lane, good[member])
                for steps in (1, 99, 200):
                    other.advance(steps)
                for lane, member in enumerate(order):
                    np.testing.assert_array_equal(other.state(lane), expected[member])
            for lane in range(width):
                other = Lanes(good[0], vector)
                for k in range(lane % 3, width, 2):
                    other.load(k, bad[k % 2][k])
                other.load(lane, good[lane])
                other.advance(300)
                np.testing.assert_array_equal(other.state(lane), expected[lane])
                assert count(system, scheme, lane, other) == counts[lane]


def fenced():
    """V is not defined where x > 0.4, nor mu where y > 0.4; what is not taken may overflow."""
    x, y, z = q = dal.coordinates("x y z")
    V = Piecewise((x**2 / 2, x <= Rational(2, 5)))
    row = z.d - Piecewise((y, y <= Rational(2, 5))) * x.d
    return dal.System.from_sympy(free(q) - V, [row])


@pytest.mark.parametrize("scheme", [*SCHEMES, "leapfrog", "midpoint-suzuki4"])
@pytest.mark.parametrize("make, h, size",
                         [(fenced, 0.05, 0.35), (contact_oscillator, 1.5, 1), (pivoting, 0.6, 1),
                          (heavy, 0.5, 0.6), (dragged, 1.0, 1)],
                         ids=["domain", "large steps", "pivots", "M(q)", "drag"])  # fmt: skip
def test_lanes_that_stop_go_on_alone(make, h, size, scheme):
    """What cannot be made side by side is made, or fails, as it would have done alone."""
    system = make()
    with_lanes = together(system)
    alone = members(system, scheme, h=h, size=size)
    loaded = members(with_lanes, scheme, h=h, size=size)
    runs = []
    for stepper in alone:
        states = [state(stepper)]
        try:
            while len(states) <= 60:
                stepper.step()
                states.append(state(stepper))
        except dal.DalembertError:
            pass
        runs.append(states)
    stopped = 0
    for vector in vectors(with_lanes):
        lanes = Lanes(loaded[0], vector)
        for lane in range(lanes.width):
            lanes.load(lane, loaded[lane])
        lanes.advance(60)
        for lane, stepper in zip(range(lanes.width), members(with_lanes, scheme, h=h, size=size)):
            made, states = lanes.made(lane), runs[lane]
            assert made < len(states)
            np.testing.assert_array_equal(lanes.state(lane), states[made])
            stopped += made < 60
            lanes.unload(lane, stepper)
            for expected in states[made + 1 :]:
                stepper.step()
                np.testing.assert_array_equal(state(stepper), expected)
            if len(states) <= 60:
                with pytest.raises(dal.DalembertError):
                    stepper.step()
    if make is fenced or (make is contact_oscillator and scheme in ("midpoint", "0.3")):
        assert stopped > 0


def singular():
    """The rows coincide where x = 1/2."""
    x, y, z = q = dal.coordinates("x y z")
    return dal.System.from_sympy(free(q), [x.d + y.d + z.d, x.d + (2 * x) * y.d + z.d])


@pytest.mark.parametrize("x, speed", [(0.4, 1), (0.402, 1), (0.6 + 1e-14, -1)])
def test_singular(x, speed):
    """Before a step to where S is singular, to roundoff, or beyond, where its determinant is
    negative, a lane stops."""
    system = together(singular())
    given = {"h": 0.01, "v0": [speed, 0, -speed]}
    alone = dal.Stepper(system, "midpoint", q0=[x, 0, 0], **given)
    alone.step(steps=9)
    for vector in vectors(system):
        stepper, far = (
            dal.Stepper(system, "midpoint", q0=[start, 0, 0], **given) for start in (x, 0.1)
        )
        lanes = Lanes(stepper, vector)
        lanes.load(1, stepper)
        lanes.load(2, far)
        lanes.advance(15)
        assert lanes.made(1) <= 9 and lanes.made(2) == 15
        np.testing.assert_array_equal(after(lanes, 1, 9, stepper), state(alone))
        lanes.load(1, alone)
        lanes.advance(1)
        assert lanes.made(1) == 0


def test_overflow():
    """A lane stops before the step whose position is not finite, as the scalar step does."""
    system = together(particle())
    far = {"h": 1.0, "q0": [1.7e308, 0, 0], "v0": [1e306, 0, 1]}
    stepper, alone = (dal.Stepper(system, "midpoint", **far) for _ in range(2))
    lanes = Lanes(stepper, vectors(system)[0])
    lanes.load(0, stepper)
    lanes.advance(20)
    with pytest.raises(dal.DalembertError, match="overflows"):
        alone.step(steps=20)
    assert 0 < lanes.made(0) < 20
    np.testing.assert_array_equal(lanes.state(0), state(alone))


def width(system, scheme="midpoint"):
    q = np.zeros(system.n)
    record = dal.Stepper(system, scheme, h=0.01, q0=q, v0=system.project(q, q))
    made = ffi.new("dal__lanes **")
    status = lib.dal__lanes_new(made, record._handle, ffi.NULL)
    lib.dal__lanes_free(made[0])
    return status


def test_models_without_lanes():
    """A model with nine coordinates has the ordinary library."""
    pushed = dal.System.from_sympy(free(dal.coordinates(" ".join(f"x{i}" for i in range(9)))))
    assert not codegen.has_lanes(pushed._model)
    assert library(pushed._model, "lanes") is library(pushed._model)
    assert width(together(pushed)) == lib.DAL_EUNSUPPORTED
    system = particle()
    assert library(system._model, "lanes") is not library(system._model)
    assert width(system) == lib.DAL_EUNSUPPORTED
    assert width(together(system)) == 0
    assert width(together(system), "reference") == lib.DAL_EUNSUPPORTED


def test_without_libmvec(monkeypatch, tmp_path):
    """A linker that does not find it: functions are called for lane after lane."""
    found = compiler.find()
    script = tmp_path / "cc"
    script.write_text('#!/bin/sh\ncase " $* " in *" tried.c "*) exit 1 ;; esac\n'
                      f'exec {" ".join(found.command)} "$@"\n')  # fmt: skip
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    assert compiler._flags_for_lanes(compiler.find()) == compiler.COMMON
    system = sleigh()
    stepper, alone = (members(one, "midpoint", 1)[0] for one in (together(system), system))
    lanes = Lanes(stepper, 2)
    lanes.load(0, stepper)
    lanes.advance(50)
    alone.step(steps=50)
    np.testing.assert_array_equal(lanes.state(0), state(alone))
