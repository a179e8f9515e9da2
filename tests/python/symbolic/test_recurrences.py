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
SHIM_OF_FOUR = """
#include <string.h>
DAL_API int differ(const double *y, const double *low, int exact)
{
    enum { ORDER = %d, SIZE = (ORDER + 1) * 128 };
    static double one[SIZE] __attribute__((aligned(64)));
    static double four[4][SIZE] __attribute__((aligned(64)));
    static double work[400000] __attribute__((aligned(64)));
    const dal_series *const series = &model_series;
    dal_series_at at[4];
    const dal_series_at *of[4];
    const void *p[4];
    double *Y[4];
    int found = 0;
    for (int i = 0; i < 4; i++) {
        const size_t begin = (size_t)i * (series->states + 4);
        static const double parameters[4] = {2.5, 0.3, 1.5, 4.0};
        at[i] = (dal_series_at){.t = 0.25 * i, .unit = i == 1 ? 0.25 : 0.5, .exact = (size_t)exact,
                                .y = y + begin, .low = low + begin};
        of[i] = &at[i];
        p[i] = &parameters[i];
        Y[i] = four[i];
    }
    series->expand_four(of, ORDER, Y, work, p);
    for (int i = 0; i < 4; i++) {
        series->expand(&at[i], ORDER, one, work, p[i]);
        found += memcmp(one, four[i], (ORDER + 1) * series->width * sizeof(double)) != 0;
    }
    return found;
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
    columns = 2 * size + len(series.switches) + len(series.exponents)
    width = -(-columns // 4) * 4
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


def test_four_at_once():
    """Each has the bits that it has alone, with a time, a unit and numbers of its own."""
    walls = ("Abs", "Max", "Min", "sign", "Heaviside", "Piecewise")
    smooth = [f for name, f in FUNCTIONS.items() if name not in walls]
    x, *others = coordinates = z[: len(smooth) + 1]
    force = {q: f(s / 9 + x / 2) for q, f in zip(others, smooth)} | {x: sp.sin(1e5 * x + c * x)}
    system = dal.System.from_sympy(
        sum(q.d**2 for q in coordinates) / 2, [], force=force, parameters={c: 2.5},
        coordinates=coordinates,
    )  # fmt: skip
    program = codegen.program(system._model, part="four series").source + SHIM_OF_FOUR
    with tempfile.NamedTemporaryFile(suffix=".so") as file:
        file.write(compiler.compile_program(compiler.find(), program))
        file.flush()
        library = ctypes.CDLL(file.name)
    starts = np.random.default_rng(4).uniform(0.4, 0.9, (4, 2 * len(coordinates) + 4))
    given = [np.ascontiguousarray(x) for x in (starts, 1e-17 * starts)]
    for exact in (0, 10):
        assert library.differ(*(ctypes.c_void_p(x.ctypes.data) for x in given), exact) == 0


PUSHES = {
    "waves": (sp.sin(s) * sp.cos(2 * s) + z[0] * sp.cos(1 + c * s), False),
    "a power": (s**4, False), "a high one": (s**5, True), "narrow waves": (sp.cos(s) ** 6, True),
    "a pulse": (sp.exp(-((s - 3) ** 2)), False), "a start": (sp.tanh(s - 3), True),
    "a chirp": (sp.sin(s**2), True), "of the state too": (sp.cos(s + z[0]), True),
    "over a wave": (1 / (2 + sp.cos(s)), True), "none": (sp.cos(z[0]) ** 9, False),
    "narrow in an angle": (sp.cos(z[0]) ** 20, True), "branches": (sp.acos(sp.sin(z[0])), True),
}  # fmt: skip


@pytest.mark.parametrize("name", PUSHES)
def test_whether_something_may_come(name):
    force, expected = PUSHES[name]
    system = dal.System.from_sympy(z[0].d ** 2 / 2, [], force={z[0]: force}, parameters={c: 1})
    assert series_of(system._model, motion(system._model)).is_doubtful == expected


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
