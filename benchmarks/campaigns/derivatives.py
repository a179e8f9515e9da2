"""A random campaign of derivatives: generated code against differences with 160 digits.

    ./dev shell python benchmarks/campaigns/derivatives.py --models 500 [--seed 1] [--show]

A model has walls, powers, nested functions, zeros and units from 1e-60 to 1e60.  Several models are
the blocks of one system; each is a system of its own, too.  All outputs of all functions of the
program may differ from differences of the user's formula by 1e-13 of the size of their terms: the
size of a sum is the sum of the sizes, and the chain rule for f(x) has terms of the size of |f'| and
|f''| times the size of x.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import functools
import itertools
import os
import random
import re
import signal
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any
from unittest import mock

import mpmath
import numpy as np
import sympy as sp
from sympy.logic.boolalg import Boolean

import dalembert as dal
from dalembert.symbolic import evaluation

BAR = 1e-13
DIGITS, STEP = 160, mpmath.mpf(10) ** -35
NEAREST = 1e-6  # to a wall, relative to the size of the terms
LARGEST = 250  # power of ten of a number on the way

Expr = Any
real = np.longdouble  # sizes: their range is large


# ---- formulas ----------------------------------------------------------------------------------


class Unsuitable(Exception):
    """A formula is not defined at a point, or is near a wall, or leaves the range of doubles."""


def size(x: Any) -> Any:
    """Return |x| in long double."""
    if not isinstance(x, mpmath.mpf) or not mpmath.isfinite(x):
        raise Unsuitable(f"{x}")
    mantissa, exponent = mpmath.frexp(abs(x))
    if abs(exponent) > 16000:
        raise Unsuitable(f"{x}")
    return np.ldexp(real(float(mantissa)), exponent)


def terms(e: Expr) -> Expr:
    """Return the size of the terms of an expression: of 1 - tanh(x)^2, it is 1 + tanh(x)^2."""
    if e.is_Add or e.is_Mul:
        return e.func(*map(terms, e.args))
    if e.is_Pow and e.exp.is_Integer and e.exp > 0:
        return terms(e.base) ** e.exp
    return sp.Abs(e)


@functools.cache
def partial(f: Any, *order: int) -> Callable[..., Any]:
    """Return the size of the terms of a derivative of a function of SymPy."""
    x = sp.symbols(f"x0:{len(order)}", real=True)
    slope = f(*x)
    for a, k in zip(x, order):
        slope = sp.diff(slope, a, k)
    return sp.lambdify(x, terms(slope), "mpmath")


def number(e: Expr) -> Any:
    """Return a number to all digits; a Float is the double that it is."""
    if e.is_Rational or e.is_Float:
        x = sp.Rational(e)
        return mpmath.mpf(int(x.p)) / int(x.q)
    return mpmath.mpf(sp.N(e, DIGITS + 5))


STEPS = (sp.Abs, sp.sign, sp.Heaviside)
ORDER: dict[str, Callable[[list[Any]], bool]] = {
    "<": lambda x: x[0] < x[1], ">": lambda x: x[0] > x[1],
    "<=": lambda x: x[0] <= x[1], ">=": lambda x: x[0] >= x[1],
}  # fmt: skip
OPERATIONS: dict[Any, Callable[[list[Any]], Any]] = {
    sp.Add: mpmath.fsum,
    sp.Mul: mpmath.fprod,
    sp.Max: max,
    sp.Min: min,
    sp.And: all,
    sp.Or: any,
    sp.Not: lambda x: not x[0],
    sp.sign: lambda x: mpmath.mpf((x[0] > 0) - (x[0] < 0)),
    sp.Heaviside: lambda x: mpmath.mpf(x[0] > 0),
    sp.Abs: lambda x: abs(x[0]),
    sp.Piecewise: lambda x: next(value for value, holds in x if holds),
    sp.functions.elementary.piecewise.ExprCondPair: tuple,
}


def operation(e: Expr) -> Callable[[list[Any]], Any]:
    """Return an operation as a function of the list of its arguments."""
    if e.is_Pow:
        return (lambda x, k=int(e.exp): x[0] ** k) if e.exp.is_Integer else lambda x: x[0] ** x[1]
    if isinstance(e, sp.core.relational.Relational):
        return ORDER[e.rel_op]
    return OPERATIONS.get(e.func) or (lambda x, f=getattr(mpmath, e.func.__name__): f(*x))


class Formula:
    """An expression as a list of operations, with values and sizes of its derivatives."""

    def __init__(self, e: Expr, z: list[Expr], values: dict[Expr, float]) -> None:
        self.z, self.values = z, values
        self.places: dict[Expr, int] = {}
        self.parts: list[tuple[Expr, list[int]]] = []
        self.known: list[Any] = []  # an operation, or a value that is the same everywhere
        self.of(e)

    def of(self, e: Expr) -> int:
        if e not in self.places:
            below = [] if e.is_Atom else [self.of(a) for a in e.args]
            self.places[e] = len(self.parts)
            self.parts.append((e, below))
            self.known.append(operation(e) if below else None if e in self.z else self.atom(e))
        return self.places[e]

    def atom(self, e: Expr) -> Any:
        if e.is_Symbol:
            return mpmath.mpf(self.values[e])
        return bool(e) if isinstance(e, Boolean) else number(e)

    def all_values(self, z: list[Any]) -> list[Any]:
        """Return the values of all operations at a point."""
        at, found = dict(zip(self.z, z)), []
        try:
            for (e, below), known in zip(self.parts, self.known):
                x = known([found[i] for i in below]) if below else known
                found.append(at[e] if x is None else x)
                if isinstance(x, mpmath.mpf) and x and not -1100 < mpmath.mag(x) < 1100:
                    raise Unsuitable(f"{e} leaves the range of doubles")
        except (ZeroDivisionError, ValueError, StopIteration) as error:
            raise Unsuitable(str(error)) from None
        return found

    def __call__(self, z: list[Any]) -> Any:
        x = self.all_values(z)[-1]
        size(x)  # it is finite and real
        return x

    def sizes(self, z: list[Any]) -> tuple[Any, Any, Any]:
        """Return the sizes of the value, of the gradient and of the Hessian."""
        values, N = self.all_values(z), len(self.z)
        found: list[Any] = []
        index = {x: i for i, x in enumerate(self.z)}
        for (e, below), x in zip(self.parts, values):
            if isinstance(e, sp.core.relational.Relational):
                self.apart([values[i] for i in below], [found[i][0] for i in below])
            if not isinstance(x, mpmath.mpf):  # a condition, or a piece
                made = found[below[0]] if below else None
            elif not below:
                at = np.zeros(N, real)
                if e in index:
                    at[index[e]] = 1
                made = size(x), at, np.zeros((N, N), real)
            else:
                made = self.combined(e, x, [found[i] for i in below], [values[i] for i in below])
            for entries in map(np.atleast_1d, made or ()):
                there = np.log10(entries[entries != 0])
                if len(there) and max(abs(there)) > LARGEST:
                    raise Unsuitable(f"{e} is too large or small")
            found.append(made)
        return found[-1]  # type: ignore[no-any-return]

    @staticmethod
    def apart(x: list[Any], s: list[Any]) -> None:
        """Raise Unsuitable if two values are nearly equal."""
        for (a, b), (c, d) in zip(itertools.pairwise(x), itertools.pairwise(s)):
            if size(a - b) <= NEAREST * (c + d):
                raise Unsuitable("near a wall")

    def combined(self, e: Expr, x: Any, parts: list[Any], values: list[Any]) -> Any:
        """Return the sizes of an operation from those of its arguments."""
        if e.is_Add:
            return tuple(sum(s) for s in zip(*parts))
        if e.is_Mul:
            logs = [np.log10(s[0]) for s in parts if s[0]]
            if max(sum(k for k in logs if k > 0), -sum(k for k in logs if k < 0)) > LARGEST:
                raise Unsuitable(f"{e} is too large or small on the way")
            return functools.reduce(product, parts)
        if isinstance(e, sp.Piecewise):
            return parts[next(i for i, (_, holds) in enumerate(values) if holds)]
        if isinstance(e, sp.Max | sp.Min):
            order = sorted(range(len(parts)), key=lambda i: values[i])
            self.apart([values[i] for i in order], [parts[i][0] for i in order])
            return parts[order[-1 if isinstance(e, sp.Max) else 0]]
        if isinstance(e, STEPS):
            self.apart([values[0], mpmath.mpf(0)], [parts[0][0], 0])
            return parts[0] if isinstance(e, sp.Abs) else (size(x), *(0 * s for s in parts[0][1:]))
        function: Any = e.func
        if e.is_Pow and e.exp.is_Integer:
            exponent, parts, values = e.exp, parts[:1], values[:1]
            function = functools.lru_cache(lambda k: lambda x: x**k)(exponent)
            slopes = [
                lambda x, c=sp.ff(exponent, k), r=int(exponent) - k: int(c) * x**r if c else 0 * x
                for k in range(4)
            ]
            return chain(x, parts, lambda i: slopes[sum(i)](*values))
        if not parts[0][0]:  # the power of a wall
            return size(x), *(0 * s for s in parts[0][1:])
        return chain(x, parts, lambda i: partial(function, *i)(*values))


def product(a: Any, b: Any) -> Any:
    cross = np.outer(a[1], b[1])
    return (a[0] * b[0], a[1] * b[0] + a[0] * b[1],
            a[2] * b[0] + cross + cross.T + a[0] * b[2])  # fmt: skip


def chain(x: Any, parts: list[Any], slope: Callable[[tuple[int, ...]], Any]) -> Any:
    """Return the sizes of f(x0, x1, ...); ``slope`` has the derivatives of these orders."""
    count = range(len(parts))

    @functools.cache
    def f(*by: int) -> Any:
        return size(mpmath.mpf(slope(tuple(by.count(k) for k in count))))

    def about(*by: int) -> Any:
        return f(*by) + sum(f(*sorted((*by, k))) * parts[k][0] for k in count)

    hessian = sum(
        about(*sorted((k, j))) * np.outer(parts[k][1], parts[j][1])
        for k, j in itertools.product(count, repeat=2)
    )
    return (about(), sum(about(k) * parts[k][1] for k in count),
            hessian + sum(about(k) * parts[k][2] for k in count))  # fmt: skip


class Differences:
    """A formula at a point: value, gradient and Hessian with some 60 digits, and their sizes."""

    def __init__(self, e: Expr, z: list[Expr], at: list[float], values: dict[Expr, float]) -> None:
        f = Formula(e, z, values)
        x = [mpmath.mpf(a) for a in at]
        self.sizes = f.sizes(x)
        N, h = len(z), [abs(a) * STEP for a in x]

        def moved(*by: tuple[int, int]) -> Any:
            there = list(x)
            for i, sign in by:
                there[i] += sign * h[i]
            return f(there)

        used = [i for i in range(N) if z[i] in e.free_symbols]
        value, gradient = f(x), np.array([mpmath.mpf(0)] * N)
        hessian = np.array([[mpmath.mpf(0)] * N] * N)
        bent = {}
        for i in used:
            up, down = moved((i, 1)), moved((i, -1))
            gradient[i] = (up - down) / (2 * h[i])
            bent[i] = up - 2 * value + down
            hessian[i, i] = bent[i] / h[i] ** 2
        for i, j in itertools.combinations(used, 2):
            both = moved((i, 1), (j, 1)) - 2 * value + moved((i, -1), (j, -1))
            hessian[i, j] = hessian[j, i] = (both - bent[i] - bent[j]) / (2 * h[i] * h[j])
        gradient[self.sizes[1] == 0] = hessian[self.sizes[2] == 0] = mpmath.mpf(0)
        self.values = value, gradient, hessian


# ---- random models -----------------------------------------------------------------------------

HALF = sp.Rational(1, 2)

# Functions with an argument in their domain.
FUNCTIONS: dict[str, Callable[[Expr, Expr], Expr]] = {
    **{f.__name__: (lambda a, b, f=f: f(a))
       for f in (sp.sin, sp.cos, sp.tanh, sp.atan, sp.asinh, sp.erf, sp.erfc)},
    **{f.__name__: (lambda a, b, f=f: f(a / 3)) for f in (sp.sinh, sp.cosh)},
    **{f.__name__: (lambda a, b, f=f: f(a / (1 + a**2))) for f in (sp.tan, sp.sec, sp.exp)},
    **{f.__name__: (lambda a, b, f=f: f(1 + sp.sin(a) / 2)) for f in (sp.csc, sp.cot)},
    **{f.__name__: (lambda a, b, f=f: f(sp.Rational(7, 10) * sp.sin(a)))
       for f in (sp.asin, sp.acos, sp.atanh)},
    "acosh": lambda a, b: sp.acosh(2 + a**2),
    "log": lambda a, b: sp.log(HALF + a**2),
    "sqrt": lambda a, b: sp.sqrt(1 + a**2),
    "atan2": lambda a, b: sp.atan2(a, 2 + b**2),
    "atan2 of both": lambda a, b: sp.atan2(a, b),
}  # fmt: skip
POWERS: dict[str, Callable[[Expr, Expr, Expr], Expr]] = {
    "square": lambda a, b, p: a**2 + b,
    "cube": lambda a, b, p: (a - b) ** 3,
    "inverse": lambda a, b, p: a / (1 + b**2),
    "eighth": lambda a, b, p: (1 + sp.sin(a) / 2) ** 8,
    "large": lambda a, b, p: (1 + sp.sin(a) / 9) ** 70,
    "minus": lambda a, b, p: b * (1 + a**2) ** -3,
    "half": lambda a, b, p: (2 + sp.cos(a)) ** sp.Rational(-3, 2) * b,
    "third": lambda a, b, p: (1 + a**2) ** sp.Rational(5, 3),
    "real": lambda a, b, p: (sp.Float("1.25") + a**2) ** sp.Float("1.7"),
    "parameter": lambda a, b, p: (HALF + a**2) ** p,
    "exponential": lambda a, b, p: p ** sp.sin(a) + b,
    "both": lambda a, b, p: (2 + sp.sin(a)) ** sp.cos(b),
}
WALLS: dict[str, Callable[[Expr, Expr], Expr]] = {
    "Max": lambda a, b: sp.Max(a, b),
    "Min": lambda a, b: sp.Min(a, 0) ** 2 - b,
    "Abs": lambda a, b: sp.Abs(a) * b,
    "drag": lambda a, b: a * sp.Abs(a),
    "spring": lambda a, b: sp.Max(0, a) ** sp.Rational(3, 2),
    "hertz": lambda a, b: sp.Max(0, b - a) ** sp.Rational(4, 3) + a,
    "Piecewise": lambda a, b: sp.Piecewise((sp.sin(a), a > b), (a * b, True)),
    "pieces": lambda a, b: sp.Piecewise(
        (a**2, (a > 0) & (b > 0)), (b, (a < -HALF) | (b >= 1)), (a + sp.cos(b), True)
    ),
    "sign": lambda a, b: a**2 * sp.sign(a) + b,
    "Heaviside": lambda a, b: a**2 * sp.Heaviside(a) - b,
}
CURVED = "drag", "sign", "Heaviside", "pieces"  # with second derivatives
JUMPS: dict[str, Callable[[Expr, Expr], Expr]] = {  # for forces
    "friction": lambda a, b: -sp.sign(a) * (1 + b**2),
    "step": lambda a, b: sp.Heaviside(a - b) * sp.exp(sp.sin(b)),
}
NOTHING: tuple[Callable[[Expr, Expr], Expr], ...] = (  # zeros that have to be seen, or not
    lambda a, b: sp.sin(a) ** 2 + sp.cos(a) ** 2 - 1,
    lambda a, b: (a - b) * (a + b) - sp.expand((a - b) * (a + b)),
)


class Draw:
    """Random expressions of some symbols, each divided by its unit."""

    def __init__(self, source: random.Random, power: Expr) -> None:
        self.source, self.power = source, power

    def coefficient(self) -> Expr:
        return self.source.choice([
            sp.Integer(self.source.choice([-3, -1, 1, 2])),
            sp.Rational(self.source.randint(1, 9), 7),
            sp.Float(repr(round(self.source.uniform(-2, 2), 3))), sp.pi / 4,
        ])  # fmt: skip

    def linear(self, among: list[Expr]) -> Expr:
        chosen = self.source.sample(among, self.source.randint(1, min(2, len(among))))
        return sum((self.coefficient() * x for x in chosen), sp.Integer(0))

    def __call__(self, among: list[Expr], depth: int, kinds: str = "sum product F P W 0") -> Expr:
        if depth == 0:
            return self.linear(among)
        a, b = (self(among, self.source.randint(0, depth - 1), kinds) for _ in range(2))
        kind = self.source.choice(kinds.split())
        if kind == "sum":
            return self.coefficient() * a + self.coefficient() * b + self.coefficient()
        if kind == "product":
            return self.coefficient() * a * b
        if kind == "F":
            return self.source.choice([*FUNCTIONS.values()])(a, b)
        if kind == "P":
            return self.source.choice([*POWERS.values()])(a, b, self.power)
        a, b = self.linear(among), self.linear(among)  # SymPy compares them, which takes long
        curved = [WALLS[name] for name in CURVED]
        table = {"W": WALLS.values(), "J": JUMPS.values(), "C": curved, "0": NOTHING}[kind]
        return self.source.choice([*table])(a, b)


@dataclass
class Block:
    """A random model, and a point."""

    q: list[Expr]
    L: Expr
    rows: list[Expr]
    force: dict[Expr, Expr]
    values: dict[Expr, float]  # of parameters
    inputs: dict[Expr, float]
    at: list[float]  # q, v, t

    @property
    def z(self) -> list[Expr]:
        return [*self.q, *(x.d for x in self.q), dal.time]

    @functools.cached_property
    def exact(self) -> tuple[Differences, list[Differences], list[Differences]]:
        """L, the rows and the force at the point."""
        known, nothing = {**self.values, **self.inputs}, sp.Integer(0)
        return (
            Differences(self.L, self.z, self.at, known),
            [Differences(e, self.z, self.at, known) for e in self.rows],
            [Differences(self.force.get(x, nothing), self.z, self.at, known) for x in self.q],
        )


MASSES, KINDS = ("constant", "general"), ("none", "linear", "affine", "nonlinear")


def block(
    source: random.Random, name: str, depth: int, mass: str, kind: str, timed: bool, t: float
) -> Block:
    """Return a random model with names that begin with ``name``."""
    n = source.randint(2, 4)
    q = dal.coordinates([f"{name}{i}" for i in range(n)])
    values: dict[Expr, float] = {}
    tau = 1.0 if timed else 10.0 ** source.randint(-10, 10)  # all blocks have one time

    def unit(power: int) -> tuple[Expr, float]:
        """Return a unit in one of the ways to write it, and its value."""
        x = float(f"{source.uniform(1, 9):.3g}e{power}")
        if source.random() < 0.4:
            symbol = sp.Symbol(f"{name}U{len(values)}", positive=True)
            values[symbol] = x
            return symbol, x
        return (sp.Float(repr(x)) if source.random() < 0.5 else sp.Rational(repr(x))), x

    large = source.choice([0, 3, 60])
    units = [unit(source.randint(-large, large)) for _ in q]
    energy, _ = unit(source.randint(-large, large))
    power = sp.Symbol(f"{name}n")
    values[power] = round(source.uniform(1.2, 3.4), 2)
    push = sp.Symbol(f"{name}push")
    draw = Draw(source, power)

    x = [a / s for a, (s, _) in zip(q, units)]
    v = [a.d * tau / s if tau != 1 else a.d / s for a, (s, _) in zip(q, units)]
    places = [*x, dal.time] if timed else x
    V = draw(places, depth) + draw(places[:1], 1, "W") * source.randint(0, 1)
    if mass == "constant":
        T = sum(draw.source.randint(2, 5) * a**2 for a in v) / 2
        T += source.randint(0, 1) * v[0] * v[1] / 3
        V = V.xreplace({dal.time: sp.Integer(0)}) if source.random() < 0.5 else V
    else:
        T = sum((2 + source.choice([sp.sin, sp.cos])(draw(places, 1))) * a**2 / 2 for a in v)
        T += v[0] * v[-1] * sp.cos(draw(places, 1)) / 4 + v[-1] * draw(places, 1)
        T += source.choice([
            sp.Integer(0), sp.sqrt(1 + v[0] ** 2 + v[1] ** 2), draw([*places, *v], 1, "C"),
        ])  # fmt: skip
    rows = []
    for k in range(0 if kind == "none" else source.randint(1, n - 1)):
        row = v[k] + sum(draw(places, 1) * a for a in source.sample(v, source.randint(1, n)))
        if kind == "affine":
            row += draw(places, depth)
        if kind == "nonlinear":
            row += draw([*v, *places], depth) + v[k] ** 3
        rows.append(row * unit(source.randint(-large, large))[0])
    force = {}
    if source.random() < 0.6:
        among = [*places, *v, dal.time / tau] + [push] * source.randint(0, 1)
        force = {
            a: energy / s * draw(among, depth, "sum product F P W J 0") if source.random() < 0.7
            else sp.Integer(0) for a, (s, _) in zip(q, units)
        }  # fmt: skip
    at = [source.choice([-1, 1]) * source.uniform(0.3, 1.4) * s for _, s in units]
    at += [source.choice([-1, 1]) * source.uniform(0.3, 1.4) * s / tau for _, s in units]
    there = set().union(
        *(e.free_symbols for e in (T, V, *rows, *force.values())), energy.free_symbols
    )
    return Block(
        [*q], energy * (T - V), rows, force, {s: z for s, z in values.items() if s in there},
        {push: source.uniform(0.5, 1)} if push in there else {}, [*at, t],
    )  # fmt: skip


def blocks(source: random.Random, count: int, label: str, depth: int = 2) -> list[Block]:
    """Return random models of one kind at points where differences can tell."""
    mass, kind = source.choice(MASSES), source.choice(KINDS)
    timed, t = source.random() < 0.3, source.uniform(0.3, 1.4)
    found: list[Block] = []
    while len(found) < count:
        try:
            made = block(source, f"{label}{chr(97 + len(found))}", depth, mass, kind, timed, t)
            assert made.exact
        except (Unsuitable, RecursionError):  # SymPy may turn conditions about for ever
            continue
        found.append(made)
    return found


# ---- comparison --------------------------------------------------------------------------------


def system_of(parts: list[Block]) -> dal.System:
    """Return the system of some blocks."""
    force = {x: f for b in parts for x, f in b.force.items()}
    return dal.System.from_sympy(
        sp.Add(*(b.L for b in parts)), [e for b in parts for e in b.rows],
        [x for b in parts for x in b.q], force=force or None,
        parameters={s: x for b in parts for s, x in b.values.items()},
        inputs=[u for b in parts for u in b.inputs],
    )  # fmt: skip


@dataclass
class Sized:
    """An array of exact numbers, with the sizes of their terms."""

    values: Any
    sizes: Any

    def __getitem__(self, place: Any) -> Sized:
        return Sized(self.values[place], self.sizes[place])

    def __add__(self, other: Sized) -> Sized:
        return Sized(self.values + other.values, self.sizes + other.sizes)

    def __neg__(self) -> Sized:
        return Sized(-self.values, self.sizes)

    def __sub__(self, other: Sized) -> Sized:
        return self + -other

    def __matmul__(self, other: Sized) -> Sized:
        return Sized(self.values @ other.values, self.sizes @ other.sizes)

    def __truediv__(self, exact: Any) -> Sized:
        return Sized(self.values / exact, self.sizes / np.vectorize(size, [real])(exact))

    @property
    def T(self) -> Sized:
        return Sized(self.values.T, self.sizes.T)


def stacked(functions: list[Differences], order: int, *shape: int) -> Sized:
    """Return the values, or the gradients, of functions."""
    values, sizes = np.empty(shape, object), np.zeros(shape, real)
    for k, f in enumerate(functions):
        values[k], sizes[k] = f.values[order], f.sizes[order]
    return Sized(values, sizes)


def expected(b: Block) -> dict[str, dict[str, Sized]]:
    """Return the outputs of the functions of a program, in the order of their arguments."""
    (L, rows, force), n, m = b.exact, len(b.q), len(b.rows)
    q, v, t = slice(0, n), slice(n, 2 * n), 2 * n
    slopes, H = stacked([L], 1, 1, t + 1)[0], Sized(L.values[2], L.sizes[2])
    phi, f = stacked(rows, 0, m), stacked(force, 0, n)
    phi_z, f_z = stacked(rows, 1, m, t + 1), stacked(force, 1, n, t + 1)
    speeds = [mpmath.mpf(x) for x in b.at[v]]
    speed = Sized(np.array(speeds), np.array([*map(size, speeds)]))
    L_q, L_v, L_qq, L_vq, L_vv = slopes[q], slopes[v], H[q, q], H[v, q], H[v, v]
    value = stacked([L], 0, 1)[0]
    twice = speed @ L_v  # of the kinetic energy, where there is a V
    return {
        "potential": {"V": twice / mpmath.mpf(2) - value, "V_q": -L_q, "V_qq": -L_qq},
        "lagrangian": {
            "L": value, "L_q": L_q, "L_v": L_v, "L_qq": L_qq, "L_vq": L_vq, "L_vv": L_vv,
            "L_vt": H[v, t],
        },
        "constraint": {
            "phi": phi, "phi_v": phi_z[:, v], "phi_q": phi_z[:, q], "phi_t": phi_z[:, t],
        },
        "force": {"f": f, "f_q": f_z[:, q], "f_v": f_z[:, v]},
        "mass": {"M": L_vv},
        "balance": {
            "L_v": L_v, "F": L_q + f, "L_vq": L_vq, "L_vv": L_vv, "F_q": L_qq + f_z[:, q],
            "F_v": L_vq.T + f_z[:, v],
        },
        "pull": {"V_q": -L_q - f},
        "terms": {
            "F": L_q + f - L_vq @ speed - H[v, t], "M": L_vv, "mu": phi_z[:, v],
            "g": phi_z[:, q] @ speed + phi_z[:, t],
            "C": phi_z[:, v] / np.diagonal(L_vv.values) @ phi_z[:, v].T,  # if M is diagonal
        },
    }  # fmt: skip


def joined(blocks: list[Sized]) -> Sized:
    """Return the sum of numbers, the concatenation of vectors, or a matrix with these blocks."""
    shapes = np.array([np.shape(b.values) for b in blocks], int)
    whole = np.sum(shapes, 0, int)
    made = Sized(np.full(whole, mpmath.mpf(0)), np.zeros(whole, real))
    for b, end, shape in zip(blocks, np.cumsum(shapes, 0), shapes):
        place = tuple(map(slice, end - shape, end))
        made.values[place] += b.values
        made.sizes[place] += b.sizes
    return made


# The arguments of functions before their outputs; of others they are t, q, v, u.
POINTS = {"mass": "", "potential": "tq", "lagrangian": "tqv", "constraint": "tqv", "pull": "tqu"}


@contextlib.contextmanager
def exporting() -> Iterator[None]:
    """Export all functions of programs, which are compiled into a cache of their own."""
    codegen, made = evaluation.codegen, evaluation.codegen.program

    def program(*given: Any, **options: Any) -> Any:
        found = made(*given, **options)
        pattern = r"^(static|DAL_KERNEL_INLINE) int\s+model_"
        found.lines = [re.sub(pattern, "int model_", found.source, flags=re.M)]
        return found

    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        mock.patch.dict(os.environ, DALEMBERT_CACHE=folder),
        mock.patch.object(codegen, "program", program),
    ):
        yield


def outputs(
    system: dal.System, at: dict[str, Any], exact: dict[str, dict[str, Sized]]
) -> Iterator[tuple[str, Any, Sized]]:
    """Yield all outputs of the compiled functions, each requested alone and with all others."""
    derived, n = system._model.derived, system.n
    library = evaluation.library(system._model, "steps")
    assert library is not None, "this needs a C compiler"
    loaded = ctypes.CDLL(str(library.path))
    parameters = np.array([*system.parameters.values(), 0.0])

    def address(x: Any) -> Any:
        return ctypes.c_double(x) if isinstance(x, float) else ctypes.c_void_p(x.ctypes.data)

    for made in (*derived.functions, derived.terms):
        function = getattr(loaded, f"model_{made.name}", None)
        if function is None:
            assert made.name in ("balance", "pull", "terms") and n > 8  # which the library supplies
            continue
        keys = exact[made.name]
        point = [address(at[x]) for x in POINTS.get(made.name, "tqvu")]

        def call(asked: Sequence[str]) -> dict[str, Any]:
            found = {key: np.full(keys[key].values.shape or 1, np.nan) for key in asked}
            arguments = (address(found[key]) if key in asked else None for key in keys)
            assert function(*point, *arguments, address(parameters)) == 0
            return found

        for key, x in call([*made.outputs]).items():
            asked = ["L_vq", "F_v"] if key == "F_v" else [key]  # it is copied from there
            assert np.array_equal(call(asked)[key], x, equal_nan=True), f"{made.name} {key}"
            if system.sparsity is not None and key in ("M", "phi_v", "phi_q"):
                where = np.diag_indices(n) if key == "M" else system.sparsity
                x, entries = np.zeros_like(x), x.ravel()[: len(where[0])]
                x[where] = entries
            yield f"{made.name} {key}", x, keys[key]


@dataclass
class Entry:
    """An entry of an output beside the exact one; ``error`` is in sizes of the terms."""

    name: str
    got: float
    exact: Any
    size: float

    @property
    def error(self) -> float:
        if not self.size:  # there is nothing: no rounding either
            return 0.0 if self.got == 0 else np.inf
        away = size(mpmath.mpf(float(self.got)) - self.exact) if np.isfinite(self.got) else np.inf
        return float(away / self.size)


def compared(name: str, got: Any, exact: Sized) -> list[Entry]:
    """Return the entries of an output, but not the zeros that belong to two blocks."""
    found = np.reshape(got, exact.values.shape)
    return [
        Entry(f"{name}{[*k]}", found[k], exact.values[k], exact.sizes[k])
        for k in np.ndindex(found.shape) if exact.sizes[k] or found[k] != 0
    ]  # fmt: skip


def solved(A: Sized, c: Sized) -> Sized:
    """Return the solution of linear equations, and the size of what rounding does to it."""
    inverse = np.array((mpmath.matrix(A.values.tolist()) ** -1).tolist()).reshape(A.values.shape)
    x, sizes = inverse @ c.values, np.vectorize(size, [real])
    return Sized(x, sizes(inverse) @ (A.sizes @ sizes(x) + c.sizes))


def acceleration(b: Block) -> Sized:
    """Return dv/dt; without constraints it is a term of it."""
    terms, none = expected(b)["terms"], np.zeros(2 * [len(b.rows)])
    M, mu, F, g = (terms[key] for key in ("M", "mu", "F", "g"))
    A = Sized(*(np.block([[x, y.T], [y, none]])
                for x, y in ((M.values, mu.values), (M.sizes, mu.sizes))))  # fmt: skip
    c = Sized(np.concatenate([F.values, -g.values]), np.concatenate([F.sizes, g.sizes]))
    found, free = solved(A, c)[: len(b.q)], solved(M, F)
    return Sized(found.values, found.sizes + free.sizes)


def judged(parts: list[Block]) -> list[Entry]:
    """Return all entries of the system of some blocks, and of dv/dt if there is one block."""
    system = system_of(parts)
    counts = [len(b.q) for b in parts]
    at = {
        "t": parts[0].at[-1],
        "q": np.concatenate([b.at[:c] for b, c in zip(parts, counts)]),
        "v": np.concatenate([b.at[c:-1] for b, c in zip(parts, counts)]),
        "u": np.array([x for b in parts for x in b.inputs.values()] or [0.0]),
    }
    exact = [expected(b) for b in parts]
    whole = {
        name: {key: joined([e[name][key] for e in exact]) for key in keys}
        for name, keys in exact[0].items()
    }
    found = [e for output in outputs(system, at, whole) for e in compared(*output)]
    if len(parts) == 1:
        with contextlib.suppress(ZeroDivisionError, dal.DalembertError):  # a matrix is singular
            motion = acceleration(parts[0])
            given = {"inputs": at["u"]} if parts[0].inputs else {}
            got = system.acceleration(at["q"], at["v"], t=at["t"], **given)
            found += compared("acceleration", got, motion)
    return found


@contextlib.contextmanager
def limited(seconds: int) -> Iterator[None]:
    """Raise TimeoutError after some seconds; 0: never."""

    def stop(*_: Any) -> None:
        raise TimeoutError(f"not done in {seconds} s")

    before = signal.signal(signal.SIGALRM, stop) if seconds else None
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        if seconds:
            signal.signal(signal.SIGALRM, before)


@dataclass
class Verdict:
    """The results of a campaign.

    Attributes
    ----------
    count : int
        The number of entries that were compared.
    worst : float
        The largest error of the entries that are right.
    wrong, failed : list of str
        Descriptions of wrong entries, and of models that were refused or took too long.
    """

    count: int = 0
    worst: float = 0.0
    wrong: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)

    def judge(self, label: str, parts: list[Block], seconds: int) -> bool:
        """Add the entries of the system of some blocks; return whether there are any."""
        try:
            with limited(seconds):
                made = judged(parts)
        except (
            AssertionError, ValueError, RecursionError, MemoryError, TimeoutError,
            dal.DalembertError,
        ) as error:  # fmt: skip
            what = "" if len(parts) > 1 else f" of {parts[0]}"
            self.failed.append(f"{label}: {type(error).__name__}: {error}"[:300] + what)
            return False
        self.count += len(made)
        self.worst = max([self.worst, *(e.error for e in made if e.error <= BAR)])
        self.wrong += [
            f"{label}: {e.name} = {float(e.got)!r}, exact {mpmath.nstr(e.exact, 17)}, error "
            f"{e.error:.2e} of the terms" for e in made if not e.error <= BAR
        ]  # fmt: skip
        return True


def campaign(
    models: int, seed: int = 1, size: int = 11, depth: int = 2, alone: int | None = None,
    seconds: int = 0, show: Callable[[str], None] = lambda text: None,
) -> Verdict:  # fmt: skip
    """Judge random models, in systems of ``size``; the first ``alone`` are systems, too."""
    found = Verdict()
    with mpmath.workdps(DIGITS), warnings.catch_warnings(), exporting():
        warnings.simplefilter("ignore")
        for k in range(0, models, size):
            parts = blocks(random.Random(f"{seed} {k}"), min(size, models - k), f"b{k}", depth)
            label = f"seed {seed}, models from {k}"
            together = found.judge(label, parts, seconds)
            for i, b in enumerate(parts if not together else parts[:alone]):
                found.judge(f"{label}, number {i}", [b], seconds)
            show(f"{k + len(parts)} models, {found.count} entries, {len(found.wrong)} wrong, the "
                 f"worst of the others {found.worst:.1e}, {len(found.failed)} failed")  # fmt: skip
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description="Derivatives of random models.")
    parser.add_argument("--models", type=int, default=500, help="number of random models")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random models")
    parser.add_argument("--size", type=int, default=11, help="number of models in a system")
    parser.add_argument("--seconds", type=int, default=0, help="limit for each system, 0: none")
    parser.add_argument("--show", action="store_true", help="print progress")
    given = parser.parse_args()
    show: Any = functools.partial(print, flush=True) if given.show else lambda text: None
    found = campaign(given.models, given.seed, given.size, seconds=given.seconds, show=show)
    print(f"{given.models} models, {found.count} entries, {len(found.wrong)} wrong, the worst of "
          f"the others {found.worst:.1e}, {len(found.failed)} systems failed")  # fmt: skip
    print(*found.wrong, *found.failed, sep="\n")
    return int(bool(found.wrong or found.failed) or not found.count)


if __name__ == "__main__":
    sys.exit(main())
