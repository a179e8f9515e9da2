"""A random campaign of events in runs of the scheme "taylor", judged with 50 digits.

    DALEMBERT_CFLAGS=-O1 ./dev shell python benchmarks/campaigns/events.py --count 10000 [--seed 1]

``--first K --count 1`` runs set K alone; ``--show`` prints progress.

Set k of seed S is made from (S, k) alone: a system whose motion is known in closed form, one to
four guards, and some runs with random data.  Guards are waves with up to 200 radians in a unit of
time, their products and exponentials, polynomials, quotients, narrow hills, kinks, jumps,
waves that nearly touch zero, and functions without a zero.

The judge shares nothing with the library.  It puts the closed form into the guard, and divides the
time into cells.  Bounds of g and of dg/dt over a cell, from interval arithmetic, show that it has
no zero, or that g is monotone in it with other signs at its ends.  All else is divided again, down
to 1e-11 of the times.  The zeros are corrected by Newton's method in mpmath, and jumps bisected.

Errors of times are relative to a scale: the largest of |t|, |t0|, and S / |dg/dt|, where u S is
what a rounding of the state and of each operation does to g.  A crossing is

    found     a time of the library is near, and no nearer to another;
    missed    there is none;
    false     a time of the library without a crossing;
    close     its cell was too small to decide, or it is within 1e-9 of another or of the ends;
    untold    close, the number of times is not that of mpmath, and there was no warning.

The exit code is 1 if any is missed, false, untold, or has an error above 1e-13 of its scale.
"""

from __future__ import annotations

import argparse
import collections
import functools
import math
import multiprocessing
import os
import random
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from typing import Any
from unittest import mock

import mpmath
import numpy as np
import sympy as sp
from derivatives import limited

import dalembert as dal

BAR = 1e-13  # of the error of a time, relative to its scale
NEAR = 1e-9  # closer crossings are counted apart
PAIR = 1e-6  # and those which are closer to one of them
LEAST = 1e-11  # of the times, the width of the least cells
WIDER = 2, 16, 128, 1024, 8192  # least cells that are added to a zone
CELLS = 192  # at the beginning
U = 2.0**-53
ROUNDED = 64 * U  # times S: what of g is not known in doubles
RUNS = 12  # of a set
SECONDS = 60  # of the library, for a run
STEEP = 1e200  # a bound of the rate of a jump

Expr = Any
mp = mpmath.MPContext()
mp.dps = 50

# ---- arithmetic ----------------------------------------------------------------------------------


def pair(a: Any, b: Any, function: Callable[[Any, Any], Any]) -> tuple[Any, Any]:
    """Return the bounds of a product or quotient."""
    found = [function(x, y) for x in a for y in b]
    return functools.reduce(np.fmin, found), functools.reduce(np.fmax, found)


def wave(lo: Any, hi: Any) -> tuple[Any, Any]:
    """Return the bounds of the sine."""
    a, b, turn = np.sin(lo), np.sin(hi), 2 * np.pi
    top = np.floor(hi / turn - 0.25) > np.floor(lo / turn - 0.25)
    bottom = np.floor(hi / turn + 0.25) > np.floor(lo / turn + 0.25)
    return np.where(bottom, -1.0, np.minimum(a, b)), np.where(top, 1.0, np.maximum(a, b))


class Number:
    """Operators that intervals and sizes derive from their sums, products and powers."""

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __rmul__(self, other: Any) -> Any:
        return self * other

    def __sub__(self, other: Any) -> Any:
        return self + (-other)

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __truediv__(self, other: Any) -> Any:
        return self * (other**-1 if isinstance(other, Number) else 1.0 / other)

    def __rtruediv__(self, other: Any) -> Any:
        return self**-1 * other


class Jet(Number):
    """Bounds of a function and of its derivative over cells."""

    def __init__(self, value: Any, rate: Any) -> None:
        self.value, self.rate = value, rate

    @staticmethod
    def of(x: Any) -> Jet:
        return x if isinstance(x, Jet) else Jet((x, x), (0.0, 0.0))

    def __add__(self, other: Any) -> Jet:
        (a, b), (c, d) = self.value, self.rate
        o = Jet.of(other)
        return Jet((a + o.value[0], b + o.value[1]), (c + o.rate[0], d + o.rate[1]))

    def __neg__(self) -> Jet:
        (a, b), (c, d) = self.value, self.rate
        return Jet((-b, -a), (-d, -c))

    def __mul__(self, other: Any) -> Jet:
        if other is self:
            return self**2
        o, times = Jet.of(other), np.multiply
        (a, b), (c, d) = pair(self.value, o.rate, times), pair(self.rate, o.value, times)
        return Jet(pair(self.value, o.value, times), (a + c, b + d))

    def chain(self, value: Any, slope: Any) -> Jet:
        return Jet(value, pair(slope, self.rate, np.multiply))

    @staticmethod
    def power(x: Any, k: int) -> Any:
        a, b = x
        if k == 0:
            return 1.0, 1.0
        if k < 0:  # the judge has no poles
            c, d = Jet.power(x, -k)
            return 1 / d, 1 / c
        if k % 2:
            return a**k, b**k
        inner = np.where((a < 0) & (b > 0), 0.0, np.minimum(abs(a), abs(b)))
        return inner**k, np.maximum(abs(a), abs(b)) ** k

    def __pow__(self, k: Any) -> Jet:
        a, b = Jet.power(self.value, int(k) - 1)
        slope = (k * a, k * b) if k > 0 else (k * b, k * a)
        return self.chain(Jet.power(self.value, int(k)), slope)

    def sin(self) -> Jet:
        a, b = self.value
        return self.chain(wave(a, b), wave(a + np.pi / 2, b + np.pi / 2))

    def cos(self) -> Jet:
        return (self + np.pi / 2).sin()

    def exp(self) -> Jet:
        found = np.exp(self.value[0]), np.exp(self.value[1])
        return self.chain(found, found)

    def sqrt(self) -> Jet:
        a, b = np.sqrt(self.value[0]), np.sqrt(self.value[1])
        return self.chain((a, b), (0.5 / b, 0.5 / a))

    def asinh(self) -> Jet:
        a, b = np.arcsinh(self.value[0]), np.arcsinh(self.value[1])
        c, d = Jet.power(self.value, 2)
        return self.chain((a, b), (1 / np.sqrt(1 + d), 1 / np.sqrt(1 + c)))

    def sign(self) -> Jet:
        a, b = np.sign(self.value[0]), np.sign(self.value[1])
        steep = np.where((a == b) & (a != 0), 0.0, STEEP)
        return Jet((a, b), (-steep, steep))

    def Abs(self) -> Jet:  # noqa: N802 - as SymPy has it
        return Jet.Max(self, -self)

    def Max(self, other: Any) -> Jet:  # noqa: N802
        one, two = Jet.of(self), Jet.of(other)
        (a, b), (c, d) = one.value, two.value
        first, second = a > d, c > b
        low, high = (
            np.where(first, x, np.where(second, y, of(x, y)))
            for x, y, of in zip(one.rate, two.rate, (np.minimum, np.maximum))
        )
        return Jet((np.maximum(a, c), np.maximum(b, d)), (low, high))

    def Min(self, other: Any) -> Jet:  # noqa: N802
        return -Jet.Max(-self, -other)


class Size(Number):
    """A number, and S: u S is what roundings do to it."""

    def __init__(self, value: Any, size: Any) -> None:
        self.value, self.size = value, size

    @staticmethod
    def of(x: Any) -> Size:
        return x if isinstance(x, Size) else Size(x, abs(x))

    def __add__(self, other: Any) -> Size:
        o = Size.of(other)
        value = self.value + o.value
        return Size(value, self.size + o.size + abs(value))

    def __neg__(self) -> Size:
        return Size(-self.value, self.size)

    def __mul__(self, other: Any) -> Size:
        o = Size.of(other)
        value = self.value * o.value
        size = abs(self.value) * o.size + self.size * abs(o.value) + abs(value)
        return Size(value, size)

    def chain(self, value: Any, slope: Any) -> Size:
        return Size(value, abs(slope) * self.size + abs(value))

    def __pow__(self, k: Any) -> Size:
        return self.chain(self.value ** float(k), float(k) * self.value ** (float(k) - 1))

    def sin(self) -> Size:
        return self.chain(np.sin(self.value), np.cos(self.value))

    def cos(self) -> Size:
        return self.chain(np.cos(self.value), np.sin(self.value))

    def exp(self) -> Size:
        return self.chain(np.exp(self.value), np.exp(self.value))

    def sign(self) -> Size:
        return Size(np.sign(self.value), 1.0)

    def Abs(self) -> Size:  # noqa: N802
        return Size(abs(self.value), self.size)

    def Max(self, other: Any) -> Size:  # noqa: N802
        one, two = Size.of(self), Size.of(other)
        size = np.where(one.value > two.value, one.size, two.size)
        return Size(np.maximum(one.value, two.value), size)

    def Min(self, other: Any) -> Size:  # noqa: N802
        return -Size.Max(-self, -other)


NAMES = {  # of SymPy: of numpy, of mpmath
    "sin": (np.sin, mp.sin), "cos": (np.cos, mp.cos), "exp": (np.exp, mp.exp),
    "sqrt": (np.sqrt, mp.sqrt), "asinh": (np.arcsinh, mp.asinh), "sign": (np.sign, mp.sign),
    "Abs": (abs, abs), "Max": (np.maximum, max), "Min": (np.minimum, min),
}  # fmt: skip


def function(name: str) -> Callable[..., Any]:
    """Return a function of doubles, of numbers of mpmath, of jets or of sizes."""
    doubles, digits = NAMES[name]

    def call(*x: Any) -> Any:
        for kind in Jet, Size:
            if any(isinstance(a, kind) for a in x):
                return getattr(kind, name)(*x)
        return (digits if any(isinstance(a, mp.mpf) for a in x) else doubles)(*x)

    return call


FUNCTIONS = {name: function(name) for name in NAMES}


def compiled(arguments: Sequence[Expr], result: Any) -> Callable[..., Any]:
    """Return a function for all kinds of numbers; SymPy takes some names from math."""
    if isinstance(result, sp.Expr):
        for kind in sp.sign, sp.Abs, sp.Max, sp.Min:
            result = result.replace(kind, sp.Function(kind.__name__))
    found = sp.lambdify(arguments, result, [FUNCTIONS], cse=True)
    found.__globals__.update(FUNCTIONS)
    return found


# ---- systems -------------------------------------------------------------------------------------

T0, T = sp.Symbol("t0"), dal.time
POOL = {
    kind: [sp.Symbol(f"{kind}{i}", real=True) for i in range(8)]
    for kind in ("w", "a", "c", "m", "d", "s")
}
PARAMETERS = [p for some in POOL.values() for p in some]


@dataclass(frozen=True)
class Known:
    """A system, and its motion in closed form, in t, t0, the initial data and own parameters."""

    name: str
    names: str  # of the coordinates
    L: str
    constraints: tuple[str, ...]
    force: dict[str, str]
    own: tuple[str, ...]  # parameters of the system
    motion: Callable[..., list[Expr]]  # of (t - t0, q0, v0, parameters): the positions
    data: Callable[[random.Random], tuple[list[float], list[float], list[float]]]

    def text(self) -> str:
        """Return the arguments of `from_sympy` as Python."""
        force = f", force={{{', '.join(f'{q}: {f}' for q, f in self.force.items())}}}"
        return f"{self.L}, [{', '.join(self.constraints)}]{force if self.force else ''}"


def uniform(source: random.Random, count: int, size: float = 1.0) -> list[float]:
    return [source.uniform(-size, size) for _ in range(count)]


def away(source: random.Random, low: float, high: float) -> float:
    return source.choice([-1, 1]) * source.uniform(low, high)


def free_data(source: random.Random) -> tuple[list[float], list[float], list[float]]:
    return uniform(source, 2), uniform(source, 2, 1.5), []


def springs_data(source: random.Random) -> tuple[list[float], list[float], list[float]]:
    own = [source.uniform(0.5, 2), source.uniform(2, 5), source.uniform(5, 20)]
    v = [a * b for a, b in zip(uniform(source, 3), own)]
    return uniform(source, 3), v, own


def falling_data(source: random.Random) -> tuple[list[float], list[float], list[float]]:
    own = [source.uniform(0.5, 3), source.uniform(0.2, 2)]
    return uniform(source, 2), uniform(source, 2, 2), own


def blade_data(source: random.Random) -> tuple[list[float], list[float], list[float]]:
    x, y, theta = uniform(source, 3)
    speed, omega = away(source, 0.2, 1.5), away(source, 0.3, 3)
    v = [speed * math.cos(theta), speed * math.sin(theta), omega]
    return [x, y, theta], v, [source.choice([0.0, source.uniform(-1, 1)])]


def particle_data(source: random.Random) -> tuple[list[float], list[float], list[float]]:
    q, u = uniform(source, 3), away(source, 0.3, 1.5)
    return q, [u, away(source, 0.3, 1.5), q[1] * u], []


def springs(t: Expr, q: Any, v: Any, k: Any) -> list[Expr]:
    return [a * sp.cos(w * t) + b / w * sp.sin(w * t) for a, b, w in zip(q, v, k)]


def falling(t: Expr, q: Any, v: Any, own: Any) -> list[Expr]:
    g, c = own
    decay = (1 - sp.exp(-c * t)) / c
    return [q[0] + v[0] * decay, q[1] - g / c * t + (v[1] + g / c) * decay]


def blade(t: Expr, q: Any, v: Any, own: Any) -> list[Expr]:
    (x, y, start), (u, w, omega), (g,) = q, v, own
    theta, B = start + omega * t, g / omega
    A = u * sp.cos(start) + w * sp.sin(start) - B * sp.sin(start)

    def place(a: Expr) -> tuple[Expr, Expr]:
        return (A * sp.sin(a) + B * sp.sin(a) ** 2 / 2,
                B * (a / 2 - sp.sin(2 * a) / 4) - A * sp.cos(a))  # fmt: skip

    (a, b), (c, d) = place(theta), place(start)
    return [x + (a - c) / omega, y + (b - d) / omega, theta]


def particle(t: Expr, q: Any, v: Any, own: Any) -> list[Expr]:
    (x, y, z), (u, w, _) = q, v
    now = y + w * t
    c = u * sp.sqrt(1 + y**2) / w
    return [x + c * (sp.asinh(now) - sp.asinh(y)), now,
            z + c * (sp.sqrt(1 + now**2) - sp.sqrt(1 + y**2))]  # fmt: skip


SYSTEMS = (
    Known("free", "x y", "(x.d**2 + y.d**2)/2", (), {}, (),
          lambda t, q, v, own: [a + b * t for a, b in zip(q, v)], free_data),
    Known("springs", "x y z",
          "(x.d**2 + y.d**2 + z.d**2 - (k0*x)**2 - (k1*y)**2 - (k2*z)**2)/2", (), {},
          ("k0", "k1", "k2"), springs, springs_data),
    Known("falling", "x y", "(x.d**2 + y.d**2)/2 - k0*y", (), {"x": "-k1*x.d", "y": "-k1*y.d"},
          ("k0", "k1"), falling, falling_data),
    Known("blade", "x y theta", "(x.d**2 + y.d**2 + theta.d**2)/2 + k0*x",
          ("sin(theta)*x.d - cos(theta)*y.d",), {}, ("k0",), blade, blade_data),
    Known("particle", "x y z", "(x.d**2 + y.d**2 + z.d**2)/2", ("z.d - y*x.d",), {}, (), particle,
          particle_data),
)  # fmt: skip


class Prepared:
    """A system of the library, and its motion as a function."""

    def __init__(self, known: Known) -> None:
        self.known = known
        self.q = list(dal.coordinates(known.names))
        self.v = [x.d for x in self.q]
        self.state = [*self.q, *self.v]
        self.own = [sp.Symbol(name, real=True) for name in known.own]
        scope = {str(x): x for x in (*self.q, *self.own)} | {"sin": sp.sin, "cos": sp.cos}
        self.system = eval(
            f"make({known.text()}, parameters=values)",
            scope | {"make": dal.System.from_sympy,
                     "values": dict.fromkeys([*self.own, *PARAMETERS], 1.0)},
        )  # fmt: skip
        n, time = len(self.q), sp.Symbol("time")
        q0, v0 = (sp.symbols(f"{name}0:{n}_0") for name in "qv")
        places = [sp.sympify(x) for x in known.motion(time, q0, v0, self.own)]
        later = T - T0
        whole = [x.subs(time, later) for x in (*places, *(x.diff(time) for x in places))]
        self.motion = compiled([T, T0, *q0, *v0, *self.own], whole)


@functools.cache
def prepared(name: str) -> Prepared:
    return Prepared(next(x for x in SYSTEMS if x.name == name))


# ---- guards --------------------------------------------------------------------------------------


@dataclass
class Guard:
    """An expression, and those whose sign it has, for jumps."""

    kind: str
    g: Expr
    jumps: list[Expr] = field(default_factory=list)


class Draw:
    """Random guards of a system; their numbers are parameters, drawn anew for each run."""

    def __init__(self, source: random.Random, system: Prepared) -> None:
        self.source, self.system = source, system
        self.used: dict[str, int] = collections.Counter()
        self.levels: list[tuple[str, Expr]] = []  # parameters that are values of a form
        self.waves: list[tuple[str, Expr]] = []  # parameters that make waves of a form

    def take(self, kind: str) -> Expr:
        found = POOL[kind][self.used[kind] % 8]
        self.used[kind] += 1
        return found

    def level(self, form: Expr) -> Expr:
        """Return a parameter that the form has as its value at some time of the run."""
        if self.used["m"] == 8:
            return self.take("c")
        found = self.take("m")
        self.levels.append((str(found), form))
        return found

    def one(self) -> Expr:
        return self.source.choice([*self.system.state, *self.system.q, T])

    def form(self) -> Expr:
        """Return a linear or quadratic form."""
        kind = self.source.random()
        a, b = self.one(), self.one()
        if kind < 0.4:
            return a
        if kind < 0.6:
            return a + self.take("a") * b
        return a * b if kind < 0.85 else a * b + self.take("a") * self.one()

    def wave(self, form: Expr = None) -> Expr:
        shape, w = self.source.choice([sp.sin, sp.cos]), self.take("w")
        form = self.form() if form is None else form
        self.waves.append((str(w), form))
        return shape(w * form + self.take("c"))

    def guard(self) -> Guard:
        kind = self.source.choice(sorted(KINDS))
        found = KINDS[kind](self)
        g, jumps = found if isinstance(found, tuple) else (found, [])
        if not g.has(*self.system.state, T):
            return self.guard()
        return Guard(kind, g, jumps)


def sums(draw: Draw) -> Expr:
    return sp.Add(*(draw.take("a") * draw.wave() for _ in range(draw.source.randint(2, 4))))


def products(draw: Draw) -> Expr:
    return draw.wave() * draw.wave() - draw.take("a") / 2


def polynomials(draw: Draw) -> Expr:
    a = [draw.form() for _ in range(3)]
    whole = a[0] * a[1] + draw.take("a") * a[2] ** 2 - a[1]
    return whole - draw.level(whole)


def exponentials(draw: Draw) -> Expr:
    return sp.exp(draw.take("a") * draw.wave()) - 1 + draw.take("a") * draw.wave() / 4


def hills(draw: Draw) -> Expr:
    form = draw.form()
    return sp.exp(-(((form - draw.level(form)) / draw.take("s")) ** 2)) - draw.take("d")


def quotients(draw: Draw) -> Expr:
    a, b = draw.form(), draw.form()
    whole = a / (1 + b**2)
    return whole - draw.level(whole) + draw.take("a") * draw.wave() / 4


def poles(draw: Draw) -> Expr:
    """Nearly a pole."""
    form = draw.form()
    return draw.wave() + draw.take("s") / (draw.take("s") ** 2 + (form - draw.level(form)) ** 2)


def kinks(draw: Draw) -> Expr:
    a, b = draw.wave(), draw.wave()
    return draw.source.choice([
        lambda: sp.Abs(a) - draw.take("d"),
        lambda: sp.Max(a, b) - draw.take("d"),
        lambda: sp.Min(a, draw.form()) + draw.take("d"),
        lambda: sp.Abs(a - b) - draw.take("d"),
        lambda: sp.Max(a, -draw.take("d")) * b + draw.take("a") / 4,
    ])()  # fmt: skip


def jumps(draw: Draw) -> tuple[Expr, list[Expr]]:
    form = draw.form()
    inner = form - draw.level(form) if draw.source.random() < 0.5 else draw.wave(form)
    return draw.wave() + draw.take("a") * sp.sign(inner), [inner]


def grazes(draw: Draw) -> Expr:
    """Waves whose tops are 10^-k over zero or below it."""
    return draw.source.choice([-1, 1]) * (draw.wave() - draw.take("g"))


def nothing(draw: Draw) -> Expr:
    return draw.source.choice([
        lambda: sp.exp(draw.wave()) * (2 + draw.wave()),
        lambda: sp.Integer(3) / 2 + draw.wave() / 4 + draw.wave(),
        lambda: draw.wave() ** 2 + draw.take("d"),
        lambda: sp.exp(-((draw.form() / draw.take("s")) ** 2)) + draw.take("d"),
    ])()  # fmt: skip


POOL["g"] = [sp.Symbol(f"g{i}", real=True) for i in range(8)]
PARAMETERS += POOL["g"]
KINDS: dict[str, Callable[[Draw], Any]] = {
    x.__name__: x
    for x in (sums, products, polynomials, exponentials, hills, quotients, poles, kinks, jumps,
              grazes, nothing)
}  # fmt: skip


def values(source: random.Random) -> dict[str, float]:
    """Return random values of the parameters of guards; levels come later."""
    found = {}
    for kind, symbols in POOL.items():
        for p in symbols:
            found[str(p)] = {
                "w": lambda: 200 ** source.uniform(0, 1),
                "a": lambda: away(source, 0.3, 1.5),
                "c": lambda: source.uniform(-3, 3),
                "m": lambda: 0.0,
                "d": lambda: source.uniform(0.05, 0.95),
                "s": lambda: 10 ** source.uniform(-4, -0.5),
                "g": lambda: 1 + source.choice([-1, 1]) * 10 ** source.uniform(-15.5, -1),
            }[kind]()
    return found


# ---- the judge -----------------------------------------------------------------------------------


@dataclass
class Crossing:
    """Where g changes its sign; one that is close may be none, or two."""

    t: Any
    scale: float
    count: int = 1
    close: bool = False


class Judge:
    """The crossings of a guard along the motion of a run."""

    def __init__(self, system: Prepared, guard: Guard) -> None:
        self.motion = system.motion
        arguments = [T, *system.state, *PARAMETERS]
        self.function = compiled(arguments, guard.g)
        self.inner = [compiled(arguments, x) for x in guard.jumps]

    def begin(self, t0: float, end: float, data: list[float], parameters: list[float]) -> None:
        self.t0, self.end, self.data, self.parameters = t0, end, data, parameters
        self.low, self.high = min(t0, end), max(t0, end)
        self.exact = [mp.mpf(x) for x in (t0, *data)], [mp.mpf(x) for x in parameters]
        self.sized = [Size.of(x) for x in parameters]
        grid = np.linspace(self.low, self.high, 101)
        self.sizes = [np.max(abs(x)) for x in self.state(grid)]
        self.least = LEAST * max(self.high - self.low, abs(self.low), abs(self.high))

    def state(self, t: Any) -> list[Any]:
        return self.motion(t, self.t0, *self.data)

    def value(self, t: Any, of: Any = None) -> Any:
        found = (of or self.function)(t, *self.state(t), *self.parameters)
        return found + 0 * t

    def bounds(self, a: Any, b: Any, of: Any = None) -> Jet:
        t = Jet((a, b), (1.0, 1.0))
        return Jet.of((of or self.function)(t, *self.state(t), *self.parameters))

    def size(self, t: Any, of: Any = None) -> Any:
        """Return S; each part of the state has its largest value as size."""
        state = [Size(x + 0 * t, y) for x, y in zip(self.state(t), self.sizes)]
        return Size.of((of or self.function)(Size.of(t), *state, *self.sized)).size

    def digits(self, t: Any) -> Any:
        first, parameters = self.exact
        return self.function(t, *self.motion(t, *first), *parameters)

    def cells(self) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
        """Return cells with one simple zero, and the least ones that are not decided."""
        edges = np.linspace(self.low, self.high, CELLS + 1)
        a, b = edges[:-1], edges[1:]
        simple, rest = [], []
        while len(a):
            m, r = (a + b) / 2, (b - a) / 2
            jet = self.bounds(a, b)
            (low, high), (least, most) = jet.value, jet.rate
            g, rounded = self.value(m), ROUNDED * self.size(m)
            steep = np.maximum(abs(least), abs(most)) * np.ones_like(m)
            free = (low > rounded) | (high < -rounded) | (abs(g) > r * steep + rounded)
            monotone = ~free & ((least > 0) | (most < 0)) & (steep < STEEP / 1e50)
            at = np.where(monotone)[0]
            if len(at):
                left, right = self.value(a[at]), self.value(b[at])
                clear = np.minimum(abs(left), abs(right)) > 2 * rounded[at]
                same = np.sign(left) == np.sign(right)
                free[at[clear & same]] = True
                simple += [(a[i], b[i]) for i in at[clear & ~same]]
                free[at[clear & ~same]] = True
            small = ~free & (2 * r <= self.least)
            rest += list(zip(a[small], b[small]))
            kept = ~free & ~small
            a, m, b = a[kept], m[kept], b[kept]
            a, b = np.concatenate([a, m]), np.concatenate([m, b])
        return simple, rest

    def newton(self, cells: list[tuple[float, float]]) -> Iterator[Crossing]:
        """Yield the simple zeros in cells."""
        a, b = np.array(cells).T
        start, width = np.sign(self.value(a)), b - a
        for _ in range(48):
            m = (a + b) / 2
            first = np.sign(self.value(m)) == start
            a, b = np.where(first, m, a), np.where(first, b, m)
        m = (a + b) / 2
        sizes, rates = self.size(m), self.bounds(m, m).rate[0] + 0 * m
        for t, size, rate, w in zip(m, sizes, rates, width):
            at, rate = mp.mpf(float(t)), float(rate)
            for _ in range(8):
                change = self.digits(at) / rate
                at -= change
                if abs(change) <= 1e-9 * w and abs(change) < 1e-11:
                    break
                rate = float(self.bounds(float(at), float(at)).rate[0])
            else:
                raise ArithmeticError(f"Newton's method does not converge at t = {t!r}")
            yield Crossing(at, self.scale(float(at), size, rate))

    def scale(self, t: float, size: Any, rate: Any) -> float:
        with np.errstate(divide="ignore"):
            return max(abs(t), abs(self.t0), float(size / abs(np.float64(rate))))

    def zones(self, cells: list[tuple[float, float]]) -> Iterator[tuple[float, float]]:
        """Yield adjacent cells as one."""
        last: tuple[float, float] | None = None
        for a, b in sorted(cells):
            if last and a - last[1] <= 8 * self.least:
                last = last[0], b
            else:
                if last:
                    yield last
                last = a, b
        if last:
            yield last

    def decided(self, zone: tuple[float, float]) -> Crossing:
        """Return what mpmath finds in a zone."""
        for wider in WIDER:
            a = max(self.low, zone[0] - wider * self.least)
            b = min(self.high, zone[1] + wider * self.least)
            jet = self.bounds(np.array([a]), np.array([b]))
            ends = self.value(np.array([a, b]))
            clear = np.all(abs(ends) > 2 * ROUNDED * self.size(np.array([a, b])))
            if jet.rate[0][0] <= 0 <= jet.rate[1][0]:
                break
            if clear and ends[0] * ends[1] < 0:
                return next(self.newton([(a, b)]))
        low, high = mp.mpf(a), mp.mpf(b)
        first = mp.sign(self.digits(low))
        if first * self.digits(high) < 0:
            for _ in range(100):
                m = (low + high) / 2
                if mp.sign(self.digits(m)) == first:
                    low = m
                else:
                    high = m
            t = float(low)
            if clear and self.inner and steeper(jet):
                return Crossing(low, self.jump(t))
            return Crossing(low, self.scale(t, 1.0, 1.0), close=True)
        for _ in range(120):  # the value next to zero
            one, two = (2 * low + high) / 3, (low + 2 * high) / 3
            if first * (self.digits(one) - self.digits(two)) < 0:
                high = two
            else:
                low = one
        crosses = first * self.digits(low) < 0
        return Crossing(low, self.scale(float(low), 1.0, 1.0), 2 if crosses else 0, close=True)

    def jump(self, t: float) -> float:
        """Return the scale of the time of a jump."""
        found = []
        for of in self.inner:
            at = np.array([t])
            size, rate = self.size(at, of)[0], np.ravel(self.bounds(at, at, of).rate[0])[0]
            found.append((abs(self.value(at, of)[0]) / size, self.scale(t, size, rate)))
        return min(found)[1]

    def crossings(self) -> list[Crossing]:
        simple, rest = self.cells()
        found = list(self.newton(simple)) if simple else []
        found += [self.decided(zone) for zone in self.zones(rest)]
        found.sort(key=lambda x: x.t)
        found = [x for x, y in zip(found, [None, *found]) if not y or x.t - y.t > 1e-20]
        near = NEAR * max(1.0, self.least / LEAST)
        for one, two in zip(found, found[1:]):
            if two.t - one.t < near:
                one.close = two.close = True
        for one, two in [*zip(found, found[1:]), *zip(found[::-1], found[-2::-1])]:
            if one.close and abs(two.t - one.t) < PAIR:
                two.close = True  # of a pair of zeros with one that is not known in doubles
        for one in found:
            one.close |= bool(one.t - self.low < near or self.high - one.t < near)
        return found


def steeper(jet: Jet) -> bool:
    """Return whether the cell may have a jump."""
    return bool(np.max(np.abs(np.array(jet.rate))) > STEEP / 1e50)


# ---- verdicts ------------------------------------------------------------------------------------

COUNTS = "pairs", "crossings", "found", "missed", "false", "close", "untold", "refused", "told"


@dataclass
class Verdict:
    """The results of a campaign, or of a set."""

    count: collections.Counter[str] = field(default_factory=collections.Counter)
    kinds: collections.Counter[tuple[str, str]] = field(default_factory=collections.Counter)
    worst: float = 0.0
    above: int = 0
    seconds: collections.Counter[str] = field(default_factory=collections.Counter)
    faults: list[str] = field(default_factory=list)

    def add(self, other: Verdict) -> None:
        self.count += other.count
        self.kinds += other.kinds
        self.worst = max(self.worst, other.worst)
        self.above += other.above
        self.seconds += other.seconds
        self.faults += other.faults

    def note(self, what: str, kind: str, count: int = 1) -> None:
        self.count[what] += count
        self.kinds[kind, what] += count

    @property
    def failed(self) -> bool:
        bad = sum(self.count[x] for x in ("missed", "false", "untold", "refused", "unjudged"))
        return bool(bad or self.above or not self.count["pairs"])

    def __str__(self) -> str:
        rows = ", ".join(f"{self.count[x]} {x}" for x in COUNTS)
        if self.count["unjudged"]:
            rows += f", {self.count['unjudged']} unjudged"
        spent = ", ".join(f"{x} {y:.0f} s" for x, y in sorted(self.seconds.items()))
        return (f"{rows}; errors of times at most {self.worst:.1e} of their scale, {self.above} "
                f"above {BAR:.0e}; {spent}")  # fmt: skip

    def table(self) -> str:
        """Return the counts of each kind of guards."""
        rows = []
        for kind in sorted(KINDS):
            counts = ", ".join(f"{self.kinds[kind, x]} {x}" for x in (*COUNTS[:7], "above"))
            rows.append(f"{kind:13s} {counts}")
        return "\n".join(rows)


def matched(times: Sequence[float], found: list[Crossing]) -> tuple[dict[int, list[float]], Any]:
    """Return the times next to each crossing, and those next to none."""
    at: dict[int, list[float]] = collections.defaultdict(list)
    false = []
    exact = np.array([float(x.t) for x in found])
    for t in times:
        i = int(np.argmin(abs(exact - t))) if len(exact) else -1
        if i >= 0 and abs(t - exact[i]) <= 1e-4:
            at[i].append(t)
        else:
            false.append(t)
    return at, false


def compared(
    verdict: Verdict, kind: str, times: Sequence[float], found: list[Crossing], told: bool
) -> list[str]:
    """Count what a run found of the crossings of a guard; return the faults."""
    said = []
    at, false = matched(times, found)
    for i, one in enumerate(found):
        near = at.get(i, [])
        t = mp.nstr(one.t, 20)
        if one.close:
            verdict.note("close", kind)
            if len(near) != one.count and not told:
                verdict.note("untold", kind)
                said.append(f"untold: {len(near)} of {one.count} close to t = {t}")
            continue
        verdict.note("crossings", kind)
        if not near:
            verdict.note("missed", kind)
            said.append(f"missed: t = {t}")
            continue
        verdict.note("found", kind)
        best = min(near, key=lambda x: abs(x - one.t))
        near.remove(best)
        false += near
        error = float(abs(mp.mpf(best) - one.t)) / one.scale
        verdict.worst = max(verdict.worst, error)
        if not error <= BAR:
            verdict.above += 1
            verdict.note("above", kind)
            said.append(f"error {error:.1e} of the scale {one.scale:.1e}: {best!r}, exact {t}")
    for t in false:
        verdict.note("false", kind)
        said.append(f"false: t = {t!r}")
    return said


SCRIPT = """\
import dalembert as dal
from sympy import *
{names} = dal.coordinates({coordinates!r}); t = dal.time
{symbols} = symbols({spaced!r}, real=True)
system = dal.System.from_sympy({text}, parameters={{{values}}})
run = dal.integrate(system, q0={q0}, v0={v0}, t0={t0!r}, t_end={t_end!r}, events=[{events}])
print(run.t_events)  # of events[{number}] = {g}"""


def script(system: Prepared, guards: list[Guard], number: int, case: dict[str, Any]) -> str:
    """Return a run as a program."""
    used = {str(x) for one in guards for x in one.g.free_symbols}
    given = {k: x for k, x in case["parameters"].items() if k in used or k in system.known.own}
    return SCRIPT.format(
        names=", ".join(map(str, system.q)), coordinates=system.known.names,
        symbols=", ".join(given) or "_", spaced=" ".join(given) or "unused",
        text=system.known.text(), values=", ".join(f"{k}: {x!r}" for k, x in given.items()),
        events=", ".join(str(one.g) for one in guards), number=number, g=guards[number].kind,
        **{k: case[k] for k in ("q0", "v0", "t0", "t_end")},
    )  # fmt: skip


def make(seed: int, index: int) -> tuple[Prepared, list[Guard], list[dict[str, Any]]]:
    """Return a system, guards and runs, of (seed, index) alone."""
    source = random.Random(f"{seed} {index}")
    system = prepared(source.choice(SYSTEMS).name)
    draw = Draw(source, system)
    guards = [draw.guard() for _ in range(source.choice([1, 1, 2, 4]))]
    arguments = [T, *system.state, *PARAMETERS]
    levels, waves = (
        [(name, compiled(arguments, form)) for name, form in some]
        for some in (draw.levels, draw.waves)
    )
    cases = []
    for _ in range(RUNS):
        parameters = values(source)
        q0, v0, own = system.known.data(source)
        t0 = round(source.uniform(-5, 20), 2) if source.random() < 0.1 else 0.0
        t_end = t0 + source.choice([1] * 9 + [-1]) * round(3 ** source.uniform(-1, 1), 3)
        times = np.linspace(t0, t_end, 65)
        states = system.motion(times, t0, *q0, *v0, *own)
        most: dict[str, float] = collections.defaultdict(lambda: 1.0)
        for name, form in waves:
            along = form(times, *states, *parameters.values()) + 0 * times
            most[name] = max(most[name], float(np.max(abs(np.diff(along) / np.diff(times)))))
        for name, fastest in most.items():
            parameters[name] /= fastest
        for name, form in levels:
            t = source.uniform(t0, t_end)
            state = system.motion(t, t0, *q0, *v0, *own)
            parameters[name] = float(form(t, *state, *parameters.values()))
        parameters |= {str(p): x for p, x in zip(system.own, own)}
        cases.append({"q0": q0, "v0": v0, "t0": t0, "t_end": t_end, "parameters": parameters})
    return system, guards, cases


def judged(seed: int, index: int) -> Verdict:
    """Return the verdict on a set."""
    verdict = Verdict()
    system, guards, cases = make(seed, index)
    judges = [Judge(system, one) for one in guards]
    for number, case in enumerate(cases):
        label = f"seed {seed}, set {index}, run {number}, {system.known.name}"
        begun = time.perf_counter()
        try:
            times, told = run(system, guards, case)
        except Exception as error:  # noqa: BLE001
            for one in guards:
                verdict.note("refused", one.kind)
            text = f"{type(error).__name__}: {error}"
            verdict.faults.append(f"{label}: {text}\n{script(system, guards, 0, case)}")
            continue
        finally:
            verdict.seconds["library"] += time.perf_counter() - begun
        verdict.count["told"] += told
        given = case["parameters"]
        own = [given[str(p)] for p in system.own]
        of_guards = [given[str(p)] for p in PARAMETERS]
        for i, (judge, one) in enumerate(zip(judges, guards)):
            verdict.note("pairs", one.kind)
            begun = time.perf_counter()
            try:
                judge.begin(case["t0"], case["t_end"], [*case["q0"], *case["v0"], *own], of_guards)
                with np.errstate(all="ignore"):
                    found = judge.crossings()
            except Exception:  # noqa: BLE001
                verdict.note("unjudged", one.kind)
                verdict.faults.append(f"{label}: {traceback.format_exc()}")
                continue
            verdict.seconds["judge"] += time.perf_counter() - begun
            said = compared(verdict, one.kind, times[i], found, told)
            if said:
                more = f"; {len(said) - 6} more" if len(said) > 6 else ""
                verdict.faults.append(f"{label}, {one.kind}: {'; '.join(said[:6])}{more}\n"
                                      + script(system, guards, i, case))  # fmt: skip
    return verdict


def run(system: Prepared, guards: list[Guard], case: dict[str, Any]) -> tuple[Any, bool]:
    """Return the times of events, and whether there was a warning about them."""
    with warnings.catch_warnings(record=True) as said, limited(SECONDS):
        warnings.simplefilter("always")
        found = dal.integrate(
            system.system.with_parameters(**case["parameters"]), q0=case["q0"], v0=case["v0"],
            t0=case["t0"], t_end=case["t_end"], events=[one.g for one in guards],
        )  # fmt: skip
    times = [[float(t) for t in some] for some in found.t_events]
    return times, any("events[" in str(w.message) for w in said)


def campaign(
    count: int, seed: int = 1, first: int = 0, processes: int = 2,
    show: Callable[[str], None] = lambda text: None,
) -> Verdict:  # fmt: skip
    """Judge sets until there are so many pairs of a guard and a run."""
    found, begin, index = Verdict(), time.monotonic(), first
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        mock.patch.dict(os.environ, DALEMBERT_CACHE=f"{folder}/cache"),
        ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool,
    ):
        waiting: collections.deque[Any] = collections.deque()
        ahead = 0  # pairs of the sets that wait, at least
        while found.count["pairs"] + found.count["refused"] < count:
            while len(waiting) < 2 * processes and ahead < count:
                waiting.append(pool.submit(judged, seed, index))
                index, ahead = index + 1, ahead + RUNS
            if not waiting:
                ahead = found.count["pairs"] + found.count["refused"]
                continue
            one = waiting.popleft().result()
            found.add(one)
            for text in one.faults:
                show(text)
            show(f"{time.monotonic() - begin:.0f} s: {found}")
        for one in waiting:
            one.cancel()
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description='Random events in runs of "taylor".')
    parser.add_argument("--count", type=int, default=10000, help="pairs of a guard and a run")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random sets")
    parser.add_argument("--first", type=int, default=0, help="number of the first set")
    parser.add_argument("--processes", type=int, default=2, help="processes at a time")
    parser.add_argument("--offenders", type=int, default=20, help="print so many faults")
    parser.add_argument("--show", action="store_true", help="print progress")
    given = parser.parse_args()
    show: Any = functools.partial(print, flush=True) if given.show else lambda text: None
    found = campaign(given.count, given.seed, given.first, given.processes, show)
    print(*found.faults[: given.offenders], sep="\n\n")
    if len(found.faults) > given.offenders:
        print(f"\n{len(found.faults) - given.offenders} more guards and runs with faults")
    print(found.table(), found, sep="\n")
    return int(found.failed)


if __name__ == "__main__":
    sys.exit(main())
