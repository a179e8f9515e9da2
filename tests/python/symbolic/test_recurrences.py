"""Taylor coefficients in C against derivatives with many digits."""

import ctypes
import functools
import tempfile

import mpmath
import numpy as np
import pytest
import sympy as sp

import dalembert as dal
from dalembert import compiler
from dalembert.symbolic import codegen, formula, recurrences
from dalembert.symbolic.motion import motion, series_of

ORDER = 20
SHIM = """
DAL_API void tried(double t, const double *y, const double *low, double unit, const double *side,
                   double *Y)
{
    static double work[100000] __attribute__((aligned(64)));
    const double crossed[64] = {0.0};
    const dal_series_at at = {.t = t, .unit = unit, .exact = 10, .y = y, .low = low, .side = side,
                              .crossed = crossed};
    model_series.expand(&at, %d, Y, work, (const double[]){2.5, 0.3});
}
""" % ORDER  # fmt: skip

s, c = dal.time, sp.Symbol("c")
z = dal.coordinates("z0:40")

# Functions of a, with values of a at t = 0 between 0.2 and 0.7.
FUNCTIONS = {
    "product": lambda a: a**2 * sp.sin(a) * (1 + a), "quotient": lambda a: sp.cos(a) / (1 + a**2),
    "inverse": lambda a: 1 / (2 + a), "power": lambda a: (1 + a) ** 7 / a**3,
    "root": lambda a: sp.sqrt(1 + a),
    "inverse of a root": lambda a: (1 + a**2) ** sp.Rational(-3, 2),
    "third root": lambda a: a ** sp.Rational(1, 3), "parameter as exponent": lambda a: (1 + a) ** c,
    "exponent": lambda a: (1 + a) ** (1 + a),
    "two arguments": lambda a: sp.atan2(a, 1 + a**2),
} | {
    name: getattr(sp, name) for name in formula.FUNCTIONS
    if name not in ("Abs", "sqrt", "acosh", "atan2")
} | {
    "acosh": lambda a: sp.acosh(2 + a),
    "Abs": lambda a: sp.Abs(a - 1) + sp.Abs(a), "Max": lambda a: sp.Max(a, a**2, 0) * a,
    "Min": lambda a: sp.Min(sp.sin(a), 1 - a**2), "sign": lambda a: a * sp.sign(a - 1),
    "Heaviside": lambda a: sp.exp(a) * sp.Heaviside(a),
    "Piecewise": lambda a: sp.Piecewise((a**2, a > 2), (sp.cos(a), (a > 0) & (a < 1)), (a, True)),
}  # fmt: skip

ARGUMENTS = {
    "linear": s / 3 + sp.Rational(1, 5),
    "endless": z[0] / 2 + sp.Rational(1, 5),
}


@functools.cache
def coefficients(kind):
    """Return the coefficients in C of all functions of an argument, and the argument.

    The coordinate 0 is x = t/2 + t^2/3 under a constant force; the speed of coordinate i is the
    integral of function i.
    """
    a = ARGUMENTS[kind]
    coordinates = z[: len(FUNCTIONS) + 1]
    force = dict(zip(coordinates, [sp.Rational(2, 3), *(f(a) for f in FUNCTIONS.values())]))
    system = dal.System.from_sympy(
        sum(x.d**2 for x in coordinates) / 2, [], force=force, parameters={c: 2.5},
        coordinates=coordinates,
    )  # fmt: skip
    model = system._model
    size = len(coordinates)
    series = series_of(model, motion(model))
    width = -(-(2 * size + len(series.switches)) // 4) * 4
    y = np.zeros(width)
    y[size] = 0.5
    block = np.zeros((ORDER + 1) * width + 8)
    Y = block[(64 - block.ctypes.data % 64) // 8 % 8 :][: (ORDER + 1) * width]
    program = codegen.program(model, part="series").source + SHIM
    found = compiler.compile_program(compiler.find(), program)
    with tempfile.NamedTemporaryFile(suffix=".so") as file:
        file.write(found)
        file.flush()
        library = ctypes.CDLL(file.name)
    pointer = ctypes.POINTER(ctypes.c_double)
    library.tried.argtypes = [ctypes.c_double, pointer, pointer, ctypes.c_double, pointer, pointer]
    side = np.zeros(len(series.switches) + 1)
    for _ in range(4):  # sides are those of the switches
        given, rest, sides, out = (
            x.ctypes.data_as(pointer) for x in (y, np.zeros(width), side, Y)
        )
        library.tried(0.0, given, rest, 0.25, sides, out)
        first = Y[2 * size : 2 * size + len(series.switches)]
        side[: len(first)] = np.sign(first)
    return Y.reshape(ORDER + 1, width)[:, : 2 * size].copy(), size


@pytest.mark.parametrize("kind", ["linear", "endless"])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_coefficients(name, kind):
    """To order 20, in a unit of 1/4; a coefficient of the function is that of the force."""
    found, size = coefficients(kind)
    i = 1 + list(FUNCTIONS).index(name)
    t = sp.Symbol("t", real=True)
    a = ARGUMENTS[kind].xreplace({s: t, z[0]: t / 2 + t**2 / 3})
    f = sp.lambdify(t, FUNCTIONS[name](a).xreplace({c: sp.Rational(5, 2)}), "mpmath")
    with mpmath.workdps(60):
        exact = mpmath.taylor(f, 0, ORDER - 1)
        exact = [x * mpmath.mpf(0.25) ** k for k, x in enumerate(exact)]
    speed = found[:, size + i]
    scale = max(abs(x) for x in exact)
    for k in range(1, ORDER + 1):
        expected = float(exact[k - 1]) * 0.25 / k
        assert abs(speed[k] - expected) <= 1e-15 * k * (abs(expected) + 1e-3 * float(scale)), k
    place = found[2:, i]
    np.testing.assert_allclose(place, 0.25 * speed[1:-1] / np.arange(2, ORDER + 1), rtol=4e-16)


def test_all_functions_have_a_rule():
    known = {*recurrences.RULES, "sqrt", "atan2", "fabs"}
    assert {"fabs" if x == "Abs" else x for x in formula.FUNCTIONS} <= known


def test_degrees():
    """A constant speed is not a series, and what is linear takes no convolution."""
    x, y, theta = dal.coordinates("x y theta")
    blade = dal.System.from_sympy(
        (x.d**2 + y.d**2 + theta.d**2) / 2 - x, [sp.sin(theta) * x.d - sp.cos(theta) * y.d]
    )
    series = series_of(blade._model, motion(blade._model))
    assert len(series.pairs) == 2  # of the speed with sine and cosine
    free = dal.System.from_sympy((x.d**2 + y.d**2) / 2 - y * 3, [])
    series = series_of(free._model, motion(free._model))
    degrees = [series.degree[e] for e in series.states]
    assert degrees == [1, 2, 0, 1] and not series.pairs
