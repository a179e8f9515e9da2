"""Compute the states of the library's systems at t = 0, 1 and 10 to 30 digits, by two methods.

usage: python make_references.py OUTPUT.json [NAME...]

The equations of motion are read from the formulas of each system, with its default parameters taken
as the decimals that they are written as, and its default data from START or from its expressions.
They are integrated by Taylor series (mpmath) and by extrapolation of the midpoint rule (Gragg,
Bulirsch, Stoer), in 45 digits; what is written is what both agree upon.  Minutes for each system.
"""

import json
import sys
from pathlib import Path

import mpmath
import sympy

import dalembert as dal
from dalembert.symbolic import expressions

TIMES = (1, 10)
WORKING, WRITTEN, AGREED = 45, 30, 33

# Default data (q, v) of the systems in C, which have them as code only, and of one in SymPy.
OSCILLATORS = "cos(pi/9), 3/5, 2/5, 1/5, 1, 1, 1, 0, sin(pi/9), 0, 0, 0, 0, 0"
START = {
    "particle": "1/2, 3/10, -1/5, 1, 7/10, 3/10",
    "particle_oscillator": "1/2, 3/10, -1/5, 1, 7/10, 3/10",
    "knife_edge": "0, 0, 1/5, cos(1/5)/2, sin(1/5)/2, 6/5",
    "sleigh": "0, 0, 3/10, cos(3/10)/5 - a*sin(3/10), sin(3/10)/5 + a*cos(3/10), 1",
    "sleigh_contact": "-a*cos(3/10), -a*sin(3/10), 3/10, cos(3/10)/5, sin(3/10)/5, 1",
    "disk": "0, 0, 1/10, 2/5, R*11/10*cos(2/5), R*11/10*sin(2/5), 11/10, 9/10",
    "heisenberg": "4/5, 1/5, 1/10, 3/10, 1/2, 17/50",
    "contact_oscillator": "sqrt(3/2), 1, -sqrt(1/2), 0, 0, 0",
    "robot": "0, 0, 0, 0, R, 0, 1/2, 1",
    "chaotic": OSCILLATORS,
    "disguised": OSCILLATORS,
    "genmass": "2/5, -3/10, 1/5, 3/5, 1/2, -305/1032",
    # spin: that of the steady circle whose yaw is -1/10 of it, at a lean of pi/36
    "rolling_disc": "0, r*(10 - sin(pi/36)), 0, pi/36, 0, "
    "r*spin*(1 - sin(pi/36)/10), 0, -spin/10, 0, spin",
    "ball_on_table": "1/2, -1/5, 0, 0, 0, 3/10, 2/5, (Omega/2 - 2/5)/a, (-Omega/5 + 3/10)/a, 7/10",
    "snakeboard": "0, 0, 0, 0, 2/5, -r*3/10/tan(2/5), 0, 3/10, 1/2, 1/20",
    "n_trailer": "0, 0, 1/5, 1/2, 3/10, 0, cos(1/5), sin(1/5), "
    "1/2, -sin(3/10)/d, cos(3/10)*sin(1/5)/d, cos(3/10)*cos(1/5)*sin(3/10)/d",
}
SPIN = "sqrt(m*g*r*s/(c/10*((C + m*r**2)*(1 - s/10) + A*s/10)))"


# ---- a system, exactly ---------------------------------------------------------------------------


def model_of(system):
    """Return the model of a system, and its parameters as decimals."""
    found = system._model or expressions.model(system)
    return found, {p: sympy.Rational(repr(x)) for p, x in zip(found.p, system.parameters.values())}


def exact_start(system):
    """Return the default data as exact expressions."""
    model, values = model_of(system)
    if system.name in START:
        local = dict(zip(system.parameters, values.values()))
        if "spin" in START[system.name]:
            lean = {"s": sympy.sin(sympy.pi / 36), "c": sympy.cos(sympy.pi / 36)}
            local["spin"] = sympy.sympify(SPIN, locals={**local, **lean})
        return [sympy.sympify(text, locals=local) for text in START[system.name].split(", ")]
    if model.state is None:  # numbers, which have to be short decimals
        state = [sympy.Rational(repr(x)) for x in (*system.q0.tolist(), *system.v0.tolist())]
        assert all(x.q <= 1000 for x in state), state
        return state
    return [sympy.nsimplify(e, rational=True).xreplace(values) for e in model.state]


# ---- the motion ----------------------------------------------------------------------------------


def field(system):
    """Return the function (q, v) -> (v, v') of mpmath, from the saddle point system."""
    model, values = model_of(system)
    q, v, n, m = model.q, model.v, model.n, model.m
    L = model.L.xreplace(values)
    phi = sympy.Matrix([e.xreplace(values) for e in model.constraints])
    L_v = sympy.Matrix([L]).jacobian(v)
    phi_v = phi.jacobian(v)
    K = sympy.zeros(n + m)
    K[:n, :n] = L_v.jacobian(v)
    K[:n, n:] = -phi_v.T
    K[n:, :n] = phi_v
    pull = sympy.Matrix([L]).jacobian(q).T - L_v.jacobian(q) * sympy.Matrix(v)
    right = [*pull, *(-phi.jacobian(q) * sympy.Matrix(v))]
    evaluate = sympy.lambdify([*q, *v], [*K, *right], "mpmath", cse=True)

    def slope(x):
        numbers = [mpmath.mpf(e) for e in evaluate(*x)]
        size = n + m
        rows = [[*numbers[i * size : (i + 1) * size], numbers[size**2 + i]] for i in range(size)]
        return [*x[n:], *solve(rows)[:n]]

    return slope


def solve(rows):
    """Return the solution of a linear system, given as rows with the right side at their end."""
    size = len(rows)
    for i in range(size):
        k = max(range(i, size), key=lambda k: abs(rows[k][i]))
        rows[i], rows[k] = rows[k], rows[i]
        for row in rows[i + 1 :]:
            if row[i]:
                factor = row[i] / rows[i][i]
                row[i:] = [a - factor * b for a, b in zip(row[i:], rows[i][i:])]
    x = [mpmath.mpf(0)] * size
    for i in reversed(range(size)):
        known = sum(rows[i][k] * x[k] for k in range(i + 1, size))
        x[i] = (rows[i][size] - known) / rows[i][i]
    return x


def taylor(slope, start, times):
    """Return the states at some times, by Taylor series."""
    solution = mpmath.odefun(lambda t, x: slope(x), 0, start, tol=mpmath.mpf(10) ** -(AGREED + 5))
    return [list(solution(t)) for t in times]


def extrapolated(slope, start, times, steps=16, columns=16):
    """Return the states at some times, by extrapolation of the midpoint rule, order 32."""
    found, x, t = [], list(start), 0
    for end in times:
        h = mpmath.mpf(1) / steps
        while t < end * steps:
            x = one_step(slope, x, h, columns)
            t += 1
        found.append(x)
    return found


def one_step(slope, x, H, columns):
    table = []
    f = slope(x)
    for j in range(1, columns + 1):
        count = 2 * j
        h = H / count
        before, now = x, [a + h * b for a, b in zip(x, f)]
        for _ in range(count - 1):
            before, now = now, [a + 2 * h * b for a, b in zip(before, slope(now))]
        row = [now]
        for k in range(1, j):
            ratio = mpmath.mpf(j) ** 2 / mpmath.mpf(j - k) ** 2 - 1
            row.append([a + (a - b) / ratio for a, b in zip(row[k - 1], table[-1][k - 1])])
        table.append(row)
    return table[-1][-1]


def written(a):
    """Return a number with 30 digits, and at most 30 of them behind the point."""
    behind = WRITTEN + int(mpmath.floor(mpmath.log10(abs(a)))) + 1 if a else 0
    return mpmath.nstr(a, min(behind, WRITTEN)) if behind > 0 else "0.0"


def main(output, *names):
    path = Path(output)
    found = json.loads(path.read_text(encoding="ascii")) if path.exists() else {}
    for name in names or (*dal.systems.names(), *dal.systems.names_in_sympy()):
        system = dal.systems.get(name)
        with mpmath.workdps(WORKING):
            start = [mpmath.mpf(sympy.N(e, WORKING)) for e in exact_start(system)]
            slope = field(system)
            one, other = taylor(slope, start, TIMES), extrapolated(slope, start, TIMES)
            worst = max(abs(a - b) for x, y in zip(one, other) for a, b in zip(x, y))
            print(f"{name}: the two methods differ by {mpmath.nstr(worst, 3)}", flush=True)
            assert worst < mpmath.mpf(10) ** -AGREED
            states = {}
            for t, x in zip((0, *TIMES), (start, *one)):
                digits = list(map(written, x))
                states[str(t)] = {"q": digits[: system.n], "v": digits[system.n :]}
            found[name] = states
        rows = [f'"{key}": {json.dumps(found[key])}' for key in sorted(found)]
        path.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="ascii")


if __name__ == "__main__":
    main(*sys.argv[1:])
