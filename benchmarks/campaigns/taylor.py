"""A random campaign of the scheme "taylor", judged by extrapolation with 33 digits.

    DALEMBERT_CFLAGS=-O1 ./dev shell python benchmarks/campaigns/taylor.py --models 2000 [--seed 1]

``--first K --models 1`` runs model K alone; ``--show`` prints progress.

Model k of seed S is made from (S, k) alone.  It has 2 to 6 coordinates, 1 to 3 constraints, which
are linear, affine or nonlinear and may depend on time, and units from 1e-30 to 1e30.  The
judge shares nothing with the library: SymPy derives the equations with multipliers from the
formulas, a C program evaluates them in __float128, eliminates with complete pivoting and integrates
(q, v) by Gragg's extrapolation, twice, with different orders.

Errors are relative to the largest size of each coordinate in the motion; that of a velocity is at
least a tenth of what the kinetic energy allows.  The condition is that of
the judge: how much a relative change of the start, of the times and of all constants grows.  A
model is

    right        the errors at some rows are at most 1e-13 (1 + condition), energies keep to 1e-12,
                 and the residual of each row to 4 n u;
    wrong        they are not, and there was no error;
    singular     the library ended with an error where the judge cannot follow the motion either;
                 the rows before are right;
    refused      it ended with an error, and the judge can follow;
    passed       it did not end, and the judge found a singularity;
    unsuitable   the judge needs too many evaluations, or does not agree with itself to 1e-22, or
                 the condition is above 1e9.
"""

from __future__ import annotations

import argparse
import collections
import ctypes
import functools
import itertools
import math
import os
import random
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import sympy as sp
from derivatives import limited

import dalembert as dal

BAR, ENERGY = 1e-13, 1e-12
AGREEMENT, CONDITION = 1e-22, 1e9
U = 2.0**-53
BENT = 1e-13  # the relative change that gives the condition
EVALUATIONS = 40_000
SECONDS = 60  # of the library, for a model

Expr = Any

# ---- the judge -----------------------------------------------------------------------------------

HEAD = """
#include <quadmath.h>

typedef __float128 Q;
typedef void function(const Q *p, const Q *z, Q *out);
typedef struct {
    int n, m, P;
    function *terms;   /* M, F, mu, g, phi */
    function *more;    /* phi_q, phi_t, the energy, the size of its terms */
} model;

enum { N = 6, R = 3, S = N + R, ROOM = N * N + N + 2 * R * N + 4 * R, MOST = 24 };

static inline Q power(Q x, int k)
{
    Q y = 1;
    for (; k > 0; k >>= 1, x *= x)
        if (k & 1) y *= x;
    return y;
}
"""

BODY = r"""
typedef struct {
    const Q *M, *F, *mu, *g, *phi;
    Q d[N], r[R];  /* units of the coordinates and of the rows */
    Q out[ROOM];
} point;

static void point_at(const model *s, const Q *p, const Q *z, point *x)
{
    int n = s->n, m = s->m;
    s->terms(p, z, x->out);
    x->M = x->out, x->F = x->M + n * n, x->mu = x->F + n, x->g = x->mu + m * n;
    x->phi = x->g + m;
    for (int i = 0; i < n; i++) x->d[i] = 1 / sqrtq(x->M[i * n + i]);
    for (int a = 0; a < m; a++) {
        Q sum = 0;
        for (int i = 0; i < n; i++) sum += fabsq(x->mu[a * n + i]) * x->d[i];
        x->r[a] = sum > 0 ? 1 / sum : 1;
    }
}

/* Solve A x = b for `right` right-hand sides, which follow the k columns of A. */
static int solved(int k, int right, Q A[S][S + N], Q x[S][N])
{
    int column[S];
    for (int i = 0; i < k; i++) column[i] = i;
    for (int s = 0; s < k; s++) {
        int row = s, best = s;
        for (int i = s; i < k; i++)
            for (int j = s; j < k; j++)
                if (fabsq(A[i][j]) > fabsq(A[row][best])) row = i, best = j;
        if (!(fabsq(A[row][best]) > 1e-30Q)) return 0;
        for (int j = 0; j < k + right; j++) {
            Q y = A[s][j];
            A[s][j] = A[row][j], A[row][j] = y;
        }
        for (int i = 0; i < k; i++) {
            Q y = A[i][s];
            A[i][s] = A[i][best], A[i][best] = y;
        }
        int c = column[s];
        column[s] = column[best], column[best] = c;
        for (int i = s + 1; i < k; i++) {
            if (A[i][s] == 0) continue;
            Q f = A[i][s] / A[s][s];
            for (int j = s + 1; j < k + right; j++) A[i][j] -= f * A[s][j];
        }
    }
    for (int c = 0; c < right; c++)
        for (int i = k - 1; i >= 0; i--) {
            Q sum = A[i][k + c];
            for (int j = i + 1; j < k; j++) sum -= A[i][j] * x[column[j]][c];
            x[column[i]][c] = sum / A[i][i];
        }
    return 1;
}

/* a <- the solution of M a = F + mu^T lambda, mu a = -g. */
static int balance(const model *s, const point *x, const Q *F, const Q *g, Q *a)
{
    int n = s->n, m = s->m;
    Q A[S][S + N], y[S][N];
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) A[i][j] = x->M[i * n + j] * x->d[i] * x->d[j];
        A[i][n + m] = F[i] * x->d[i];
        for (int b = 0; b < m; b++) {
            A[n + b][i] = x->mu[b * n + i] * x->d[i] * x->r[b];
            A[i][n + b] = -A[n + b][i];
        }
    }
    for (int b = 0; b < m; b++) {
        for (int c = 0; c < m; c++) A[n + b][n + c] = 0;
        A[n + b][n + m] = -g[b] * x->r[b];
    }
    if (!solved(n + m, 1, A, y)) return 0;
    for (int i = 0; i < n; i++) a[i] = y[i][0] * x->d[i];
    return 1;
}

static int rates(const model *s, const Q *p, const Q *z, Q *dz, point *x)
{
    int n = s->n;
    point_at(s, p, z, x);
    for (int i = 0; i < n; i++) dz[i] = z[n + i];
    dz[2 * n] = 1;
    if (!balance(s, x, x->F, x->g, dz + n)) return 0;
    for (int i = 0; i < 2 * n; i++)
        if (!finiteq(dz[i])) return 0;
    return 1;
}

static int moved_once(const model *s, const Q *p, Q *z)
{
    static const Q none[N];
    Q dv[N];
    point x;
    point_at(s, p, z, &x);
    if (!balance(s, &x, none, x.phi, dv)) return 0;
    for (int i = 0; i < s->n; i++) z[s->n + i] += dv[i];
    return 1;
}

static int projected(const model *s, const Q *p, Q *z)
{
    for (int k = 0; k < 7; k++)  /* Newton's method: phi may be nonlinear */
        if (!moved_once(s, p, z)) return 0;
    return 1;
}

static Q larger(Q a, Q b) { return a > b ? a : b; }

/* Add what z says to the sizes of the coordinates. */
static void sized(const model *s, const point *x, const Q *z, Q H, Q *scale)
{
    int n = s->n;
    Q twice = 0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) twice += z[n + i] * x->M[i * n + j] * z[n + j];
    for (int i = 0; i < n; i++) {
        Q speed = 0.1Q * sqrtq(twice) * x->d[i];
        scale[i] = larger(scale[i], larger(fabsq(z[i]), speed * fabsq(H)));
        scale[n + i] = larger(scale[n + i], larger(fabsq(z[n + i]), speed));
    }
}

/* One step of Gragg's method with K columns; *error <- its estimate.  2: no number. */
static int step(const model *s, int K, const Q *p, const Q *z, const Q *rate, Q H, Q *scale,
                Q *next, Q *error)
{
    int N2 = 2 * s->n + 1;
    Q T[MOST][2 * N + 1], a[2 * N + 1], b[2 * N + 1], slope[2 * N + 1];
    point x;
    for (int j = 0; j < K; j++) {
        int count = 2 * (j + 1);
        Q h = H / count, last[2 * N + 1];
        for (int i = 0; i < N2; i++) a[i] = z[i], b[i] = z[i] + h * rate[i];
        for (int k = 1; k < count; k++) {
            if (!rates(s, p, b, slope, &x)) return 2;
            for (int i = 0; i < N2; i++) {
                Q c = a[i] + 2 * h * slope[i];
                a[i] = b[i], b[i] = c;
            }
        }
        for (int i = 0; i < N2; i++) {
            Q y = b[i];  /* T[k] is that of the last j; it becomes that of this one */
            for (int k = 0; k < j; k++) {
                Q ratio = (Q)(j + 1) / (j - k);
                Q better = y + (y - T[k][i]) / (ratio * ratio - 1);
                T[k][i] = y, y = better;
            }
            last[i] = T[j][i] = y;
        }
        if (j == K - 1) {
            *error = 0;
            for (int i = 0; i < N2; i++) next[i] = last[i];
            sized(s, &x, next, H, scale);
            for (int i = 0; i < N2 - 1; i++) {
                Q e = fabsq(T[K - 1][i] - T[K - 2][i]);
                if (!finiteq(next[i])) return 2;
                if (e > 0) *error = larger(*error, e / scale[i]);
            }
        }
    }
    return 0;
}

static void given(const model *s, const double *p, const double *bent, double t, const double *y,
                  const double *shift, Q *P, Q *z)
{
    for (int k = 0; k < s->P; k++) P[k] = (Q)p[k] * (1 + (bent ? (Q)bent[k] : 0));
    for (int i = 0; i < 2 * s->n; i++) z[i] = (Q)y[i] + (shift ? (Q)shift[i] : 0);
    z[2 * s->n] = t;
}

/* y <- a state on D, rounded. */
int start(int which, const double *p, double t, double *y)
{
    const model *s = &all[which];
    Q P[s->P + 1], z[2 * N + 1];
    given(s, p, 0, t, y, 0, P, z);
    if (!projected(s, P, z)) return 1;
    for (int i = 0; i < 2 * s->n; i++) y[i] = (double)z[i];
    return 0;
}

/* Follow the motion from times[0]; out <- the states at all times, each number as two doubles.
   1: too many evaluations; 2: singular. */
int follow(int which, int K, double tolerance, const double *p, const double *bent,
           const double *y, const double *shift, int rows, const double *times, double first,
           long most, double *out, double *sizes, double *reached, long *used)
{
    const model *s = &all[which];
    int N2 = 2 * s->n, status = 0;
    Q P[s->P + 1], z[2 * N + 1], next[2 * N + 1], rate[2 * N + 1], scale[2 * N] = {0}, error;
    Q H = first, least = 1e-25Q * ((Q)times[rows - 1] - times[0]);
    point x;
    given(s, p, bent, times[0], y, shift, P, z);
    if (!projected(s, P, z)) return 2;
    *used = 0;
    for (int r = 0; r < rows; r++) {
        while (z[N2] != times[r]) {
            if (!rates(s, P, z, rate, &x)) { status = 2; goto end; }
            sized(s, &x, z, H, scale);
            for (;;) {
                Q left = times[r] - z[N2], h = H;
                if (fabsq(left) <= fabsq(H) * 1.001Q) h = left;
                else if (fabsq(left) < 2 * fabsq(H)) h = left / 2;
                *used += K * (K + 1);
                if (*used > most) { status = 1; goto end; }
                Q trial[2 * N];
                for (int i = 0; i < N2; i++) trial[i] = scale[i];
                int failed = step(s, K, P, z, rate, h, trial, next, &error);
                Q ratio = 0.1Q;
                if (!failed) {
                    ratio = error > 0 ? powq(tolerance / error, 1 / (2 * K - 1.0Q)) * 0.9Q : 3;
                    ratio = ratio > 3 ? 3 : ratio < 0.1Q ? 0.1Q : ratio;
                }
                if (!failed && error <= tolerance) {
                    for (int i = 0; i < N2; i++) z[i] = next[i], scale[i] = trial[i];
                    z[N2] = h == left ? (Q)times[r] : z[N2] + h;
                    if (h == H || ratio < 1) H = h * ratio;
                    else if (fabsq(h * ratio) > fabsq(H)) H = h * ratio;
                    break;
                }
                H = h * ratio;
                if (fabsq(H) < fabsq(least)) { status = 2; goto end; }
            }
        }
        for (int i = 0; i < N2; i++) {
            double high = (double)z[i];
            out[2 * (r * N2 + i)] = high;
            out[2 * (r * N2 + i) + 1] = (double)(z[i] - high);
        }
    }
end:
    *reached = (double)z[N2];
    for (int i = 0; i < N2; i++) sizes[i] = (double)scale[i];
    return status;
}

/* For each state: the largest |phi|, relative to what rounding of places, t, v and p does to it, to
   the size in docs/residual.md, and to the sum of its terms, unless it is much less than this size;
   the change of the energy since the first state, less what rounding of q and v may do to it, and
   the size of its terms. */
int measures(int which, const double *p, int rows, const double *times, const double *y,
             double *out)
{
    const model *s = &all[which];
    int n = s->n, m = s->m;
    Q P[s->P + 1], z[2 * N + 1], more[ROOM], E0 = 0;
    for (int r = 0; r < rows; r++, out += 5) {
        point x;
        Q A[S][S + N], inverse[S][N], norm = 0, d[N];
        given(s, p, 0, times[r], y + 2 * n * r, 0, P, z);
        point_at(s, P, z, &x);
        s->more(P, z, more);
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) {
                A[i][j] = x.M[i * n + j] * x.d[i] * x.d[j];
                A[i][n + j] = i == j;
            }
        if (!solved(n, n, A, inverse)) return 2;
        for (int i = 0; i < n; i++) {
            d[i] = sqrtq(inverse[i][i]) * x.d[i];
            norm = larger(norm, fabsq(z[n + i]) / d[i]);
        }
        out[0] = out[1] = out[2] = 0;
        Q far = 0, bent[R] = {0};
        for (int c = 0; c < s->P; c++) {
            point y;
            Q kept = P[c];
            P[c] *= 1 + 0x1p-52Q;
            point_at(s, P, z, &y);
            for (int a = 0; a < m; a++) bent[a] += fabsq(y.phi[a] - x.phi[a]) * 0x1p52Q;
            P[c] = kept;
        }
        for (int i = 0; i < n; i++) far = larger(far, fabsq(z[i]) / d[i]);
        for (int a = 0; a < m; a++) {
            Q sum = 0, bound = 0, along = 0, moved = fabsq(more[m * n + a] * z[2 * n]) + bent[a];
            for (int i = 0; i < n; i++) {
                Q mu = x.mu[a * n + i];
                along += mu * z[n + i];
                sum += fabsq(mu * z[n + i]);
                bound += fabsq(mu) * d[i] * norm;
                moved += fabsq(more[a * n + i]) * d[i] * far;
            }
            Q apart = fabsq(x.phi[a] - along), phi = fabsq(x.phi[a]);
            if (apart < 1e-30Q * sum) apart = 0;
            bound += apart;
            if (phi == 0) continue;
            out[0] = (double)larger(out[0], phi / (bound + moved));
            out[1] = (double)larger(out[1], phi / (apart > 0 ? bound + moved : bound));
            if (sum + apart > 0.01Q * bound) out[2] = (double)larger(out[2], phi / (sum + apart));
        }
        Q E = more[m * n + m], size = more[m * n + m + 1], rounded = 0;
        for (int i = 0; i < 2 * n; i++) {
            Q kept = z[i];
            z[i] *= 1 + 0x1p-52Q;
            s->more(P, z, more);
            rounded += fabsq(more[m * n + m] - E);
            z[i] = kept;
        }
        if (r == 0) E0 = E;
        out[3] = (double)larger(0, fabsq(E - E0) - rounded);
        out[4] = (double)size;
    }
    return 0;
}
"""


class Writer:
    """Expressions as C, each subexpression once."""

    def __init__(self, z: list[Expr], constants: list[Expr]) -> None:
        self.names = {x: f"z[{i}]" for i, x in enumerate(z)}
        self.names |= {x: f"p[{k}]" for k, x in enumerate(constants)}
        self.lines: list[str] = []

    def of(self, e: Expr) -> str:
        if e not in self.names:
            text = self.text(e)
            if e.is_Number:
                return text
            self.names[e] = f"a{len(self.lines)}"
            self.lines.append(f"    const Q {self.names[e]} = {text};")
        return self.names[e]

    def text(self, e: Expr) -> str:
        if e.is_Rational:
            return f"({e.p}.0Q / {e.q}.0Q)" if e.q != 1 else f"({e.p}.0Q)"
        if e.is_Add or e.is_Mul:
            return (" + " if e.is_Add else " * ").join(map(self.of, e.args))
        if e.is_Pow:
            base, k = self.of(e.base), e.exp
            if not (k.is_Rational and k.q in (1, 2)):
                return f"powq({base}, {self.of(k)})"
            if k.q == 2:
                base = f"sqrtq({base})"
            return f"{'1 / ' if k < 0 else ''}power({base}, {abs(k.p)})"
        if isinstance(e, sp.conjugate):  # of what SymPy does not know to be real
            return self.of(e.args[0])
        if e is sp.pi:
            return "M_PIq"
        name = "fabs" if isinstance(e, sp.Abs) else e.func.__name__
        return f"{name}q({', '.join(map(self.of, e.args))})"

    def function(self, name: str, outputs: list[Expr]) -> str:
        ends = [f"    out[{i}] = {self.of(sp.sympify(e))};" for i, e in enumerate(outputs)]
        return "\n".join([
            f"static void {name}(const Q *p, const Q *z, Q *out)", "{", *self.lines, *ends, "}\n"
        ])  # fmt: skip


def derived(model: Model, index: int) -> str:
    """Return the functions of a model in C."""
    q, v, t, L = model.q, model.v, model.t, model.L
    z, constants = [*q, *v, t], [*model.values]
    L_v = [sp.diff(L, a) for a in v]
    M = [sp.diff(e, a) for e in L_v for a in v]
    F = [
        sp.diff(L, a) - sum(sp.diff(e, b) * c for b, c in zip(q, v)) - sp.diff(e, t) + f
        for a, e, f in zip(q, L_v, model.force)
    ]
    phi = model.rows
    phi_q = [sp.diff(e, a) for e in phi for a in q]
    phi_t = [sp.diff(e, t) for e in phi]
    mu = [sp.diff(e, a) for e in phi for a in v]
    n = len(q)
    g = [sum(a * b for a, b in zip(phi_q[k * n : k * n + n], v)) + e for k, e in enumerate(phi_t)]
    energy = sum(a * e for a, e in zip(v, L_v)) - L
    return Writer(z, constants).function(f"terms{index}", [*M, *F, *mu, *g, *phi]) + Writer(
        z, constants
    ).function(f"more{index}", [*phi_q, *phi_t, energy, model.size])


def array(x: Any) -> Any:
    return np.ascontiguousarray(x, float)


def address(x: Any) -> Any:
    return ctypes.c_void_p(None if x is None else x.ctypes.data)


@dataclass
class Followed:
    """Where the judge went: the sum of two doubles for each number of each row."""

    status: int
    high: Any
    low: Any
    scale: Any
    reached: float
    evaluations: int

    def away(self, x: Any, rows: Any = slice(None)) -> Any:
        """Return the relative error of the states x at some rows."""
        return (abs((x - self.high[rows]) - self.low[rows]) / self.safe).max(1)

    @property
    def safe(self) -> Any:
        return np.where(self.scale > 0, self.scale, np.inf)

    def apart(self, other: Followed) -> Any:
        difference = (self.high - other.high) + (self.low - other.low)
        return (abs(difference) / self.safe).max(1)


class Judge:
    """The motions of some models in C."""

    def __init__(self, models: list[Model], folder: str) -> None:
        self.models = models
        table = ", ".join(
            f"{{{len(x.q)}, {len(x.rows)}, {len(x.values)}, terms{k}, more{k}}}"
            for k, x in enumerate(models)
        )
        functions = "".join(derived(x, k) for k, x in enumerate(models))
        source, library = Path(folder, "judge.c"), Path(folder, f"judge{id(self)}.so")
        source.write_text(f"{HEAD}{functions}static const model all[] = {{{table}}};\n{BODY}")
        command = ["gcc", "-O1", "-w", "-fPIC", "-shared", str(source), "-o", str(library)]
        subprocess.run([*command, "-lquadmath"], check=True)
        self.library = ctypes.CDLL(str(library))

    def constants(self, k: int) -> Any:
        return array([*self.models[k].values.values(), 0.0])

    def start(self, k: int) -> Any:
        """Return the start on D, rounded, or None if the constraints are dependent there."""
        x = self.models[k]
        y = array([*x.q0, *x.v0])
        failed = self.library.start(
            k, address(self.constants(k)), ctypes.c_double(x.t0), address(y)
        )
        return None if failed or not np.isfinite(y).all() else y

    def follow(
        self, k: int, y: Any, times: Any, columns: int, tolerance: float, bent: Any = None,
        shift: Any = None,
    ) -> Followed:  # fmt: skip
        """Follow the motion from y through times; the first one is that of y."""
        times, y = array(times), array(y)
        out, scale = np.zeros((len(times), len(y), 2)), np.zeros(len(y))
        reached, used = ctypes.c_double(), ctypes.c_long()
        first = math.copysign(0.1 * self.models[k].tau, times[-1] - times[0])
        status = self.library.follow(
            k, columns, ctypes.c_double(tolerance), address(self.constants(k)), address(bent),
            address(y), address(shift), len(times), address(times), ctypes.c_double(first),
            ctypes.c_long(EVALUATIONS), address(out), address(scale), ctypes.byref(reached),
            ctypes.byref(used),
        )  # fmt: skip
        return Followed(status, out[..., 0], out[..., 1], scale, reached.value, used.value)

    def measures(self, k: int, times: Any, y: Any) -> Any:
        """Return what the function of this name in C does."""
        out, times, y = np.zeros((len(times), 5)), array(times), array(y)
        self.library.measures(
            k, address(self.constants(k)), len(times), address(times), address(y), address(out)
        )
        return out


# ---- random models -------------------------------------------------------------------------------


@dataclass
class Model:
    """A model in symbols, its constants and its start."""

    q: list[Expr]
    v: list[Expr]
    t: Expr
    L: Expr
    rows: list[Expr]
    force: list[Expr]
    values: dict[Expr, float]
    size: Expr  # of the terms of the energy
    q0: list[float]
    v0: list[float]
    t0: float
    t_end: float
    tau: float  # the unit of time
    bends: list[bool]  # whether a constant is changed for the condition, not a unit
    conservative: bool
    parameters: bool  # whether the library gets the constants as parameters
    even: bool  # whether the rows of the second run have one distance

    def system(self) -> dal.System:
        x = dal.coordinates([str(a) for a in self.q])
        known: dict[Expr, Expr] = {self.t: dal.time, **dict(zip(self.q, x))}
        known |= {a: b.d for a, b in zip(self.v, x)}
        if not self.parameters:
            known |= {c: sp.Rational(value) for c, value in self.values.items()}  # exact
        force = {a: e.xreplace(known) for a, e in zip(x, self.force) if e != 0}
        return dal.System.from_sympy(
            self.L.xreplace(known), [e.xreplace(known) for e in self.rows], x,
            force=force or None, parameters=self.values if self.parameters else None,
        )  # fmt: skip

    def script(self, y: Any, more_rows: dict[str, Any]) -> str:
        """Return a script that repeats the run of the library."""
        names, q = ", ".join(map(str, self.values)), ", ".join(map(str, self.q))
        text = functools.partial(sp.sstr, sympy_integers=True)
        n = len(self.q)
        constants = [f"{c} = Rational({value!r})" for c, value in self.values.items()]
        force = ", ".join(f"{a}: {text(e)}" for a, e in zip(self.q, self.force) if e != 0)
        more = ""
        if self.parameters:
            constants = [f"{names}, = constants = symbols({names!r}, seq=True)"]
            values = [*self.values.values()]
            more = f", parameters=dict(zip(constants, {values}))"
        return "\n".join([
            "from sympy import *", "import dalembert as dal",
            f"{q}, = q = dal.coordinates({[*map(str, self.q)]})", "t = dal.time", *constants,
            f"L = {text(self.L)}", f"rows = [{', '.join(map(text, self.rows))}]",
            f"force = {{{force}}}",
            f"system = dal.System.from_sympy(L, rows, q, force=force{more})",
            f"start = {y[:n].tolist()}, {y[n:].tolist()}",
            f"time = dict(t0={self.t0!r}, t_end={self.t_end!r}, consistent='project')",
            "run = dal.integrate(system, 'taylor', *start, **time)",
            f"rows = dal.integrate(system, 'taylor', *start, **time, **{more_rows})",
            "print(run, run.q[-1], run.v[-1], rows.q, rows.v)",
        ])  # fmt: skip


HALF = sp.Rational(1, 2)


class Draw:
    """Random terms of dimensionless coordinates x, velocities y and time t."""

    def __init__(self, source: random.Random) -> None:
        self.source = source
        self.values: dict[Expr, float] = {}
        self.bends: list[bool] = []

    def define(self, value: float, bends: bool = True) -> Expr:
        c = sp.Symbol(f"c{len(self.values)}", real=True)
        self.values[c] = value
        self.bends.append(bends)
        return c

    def positive(self, low: float = 0.3, high: float = 2.0) -> Expr:
        value = self.source.uniform(low, high)
        return self.define(value if self.source.random() < 0.3 else round(value, 2))

    def number(self) -> Expr:
        c = self.positive()
        self.values[c] *= self.source.choice([-1, 1])
        return c

    def linear(self, x: list[Expr]) -> Expr:
        """Return a coordinate, a difference or a sum."""
        a, b = self.source.sample(x, 2)
        kind = self.source.randrange(5)
        return [a, self.number() * a, a - b, a + self.number() * b, a + self.number()][kind]

    def pair(self, x: list[Expr]) -> tuple[Expr, Expr]:
        a, b = self.source.sample(x, 2)
        return a, b

    def potential(self, x: list[Expr]) -> Expr:
        return self.source.choice([*POTENTIALS.values()])(self, x)

    def bounded(self, x: list[Expr]) -> Expr:
        return self.source.choice(BOUNDED)(self.linear(x))

    def coefficient(self, x: list[Expr]) -> Expr:
        """Return a coefficient of a constraint."""
        if self.source.random() < 0.3:
            return self.number()
        return self.number() * self.source.choice(COEFFICIENTS)(self.linear(x))


BOUNDED: tuple[Callable[[Expr], Expr], ...] = (
    sp.sin, sp.cos, sp.sin, sp.cos, sp.tanh, sp.atan, lambda a: 1 / (1 + a**2),
    lambda a: sp.exp(-(a**2)), lambda a: a / sp.sqrt(1 + a**2), lambda a: sp.tan(HALF * sp.sin(a)),
    lambda a: sp.asin(HALF * sp.cos(a)), lambda a: sp.sin(a) ** 3,
)  # fmt: skip
COEFFICIENTS: tuple[Callable[[Expr], Expr], ...] = (
    *BOUNDED, lambda a: a, lambda a: a**2, lambda a: sp.exp(a / 3), lambda a: sp.sqrt(1 + a**2),
)  # fmt: skip
POTENTIALS: dict[str, Callable[[Draw, list[Expr]], Expr]] = {
    "gravity": lambda d, x: d.number() * d.source.choice(x),
    "spring": lambda d, x: d.positive() * d.linear(x) ** 2 / 2,
    "quartic": lambda d, x: d.positive() * d.linear(x) ** 4 / 4,
    "coupled": lambda d, x: d.positive() * sp.prod(a**2 for a in d.pair(x)) / 2,
    "cubic": lambda d, x: d.number() * d.linear(x) ** 3 / 9,
    "monkey": lambda d, x: d.number() * d.linear(x) ** 2 * d.source.choice(x) / 9,
    "sine": lambda d, x: d.number() * sp.sin(d.linear(x)),
    "cosine": lambda d, x: d.number() * sp.cos(d.linear(x)),
    "product": lambda d, x: d.number() * sp.cos(d.linear(x)) * d.bounded(x),
    "root": lambda d, x: d.number() * sp.sqrt(1 + d.linear(x) ** 2),
    "exponential": lambda d, x: d.positive() * sp.exp(d.linear(x) / 2),
    "wall": lambda d, x: d.positive() * sp.exp(-3 * d.source.choice(x)) / 3,
    "bell": lambda d, x: d.number() * sp.exp(-(d.linear(x) ** 2)),
    "power": lambda d, x: (d.positive() + d.linear(x) ** 2) ** d.positive(0.4, 1.7),
    "third": lambda d, x: d.positive() * (1 + d.linear(x) ** 2) ** sp.Rational(4, 3) / 2,
    "pole": lambda d, x: -d.positive() / sp.sqrt(sum((a - d.number()) ** 2 for a in d.pair(x))),
    "soft pole": lambda d, x: (
        -d.positive() / sp.sqrt(sum(a**2 for a in d.pair(x)) + d.positive(0.05, 0.5) ** 2)
    ),
    "negative": lambda d, x: (d.positive() + d.linear(x) ** 2) ** -d.positive(0.4, 2.6),
    "five halves": lambda d, x: (1 + d.linear(x) ** 2) ** sp.Rational(-5, 2) * d.number(),
    "nested": lambda d, x: d.number() * sp.sin(d.linear(x) + d.bounded(x)),
    "exponent": lambda d, x: (2 + d.bounded(x) / 2) ** d.bounded(x),
    "polynomial": lambda d, x: d.positive() * d.linear(x) ** 6 / 20 + d.linear(x) ** 5 / 30,
    "hyperbolic": lambda d, x: d.positive() * sp.cosh(d.linear(x) / 2),
    "arsinh": lambda d, x: d.number() * sp.asinh(d.linear(x)),
    "error": lambda d, x: d.number() * sp.erf(d.linear(x)),
    "direction": lambda d, x: d.number() * sp.sin(2 * sp.atan2(*d.pair(x))),
    "barrier": lambda d, x: d.positive() / d.source.choice(x) ** 2,
    "well": lambda d, x: -d.positive() / (1 + d.linear(x) ** 2),
    "step": lambda d, x: d.number() * sp.tanh(d.linear(x)),
    "logarithm": lambda d, x: d.number() * sp.log(1 + d.linear(x) ** 2),
    "angle": lambda d, x: d.number() * sp.atan(d.linear(x)),
}


MASSES = [*["diagonal"] * 5, *["dense"] * 3, *["general"] * 4, "decades", "relativistic"]
KINDS = [*["linear"] * 14, *["affine"] * 4, "timed", "timed", "nonlinear"]


def kinetic(draw: Draw, x: list[Expr], y: list[Expr], kind: str) -> list[Expr]:
    """Return the terms of a positive definite kinetic energy."""
    source = draw.source
    terms = [draw.positive(0.5) * a**2 / 2 for a in y]
    if kind == "decades":
        terms = [draw.define(10 ** source.uniform(-1.5, 1.5)) * a**2 / 2 for a in y]
    if kind == "relativistic":
        terms.append(draw.positive() * sp.sqrt(1 + sum(a**2 for a in source.sample(y, 2))))
    if kind in ("dense", "general"):
        for _ in range(source.randint(1, 2)):
            among = source.sample(y, source.randint(2, len(y)))
            terms.append(draw.positive() * sum(draw.number() * a for a in among) ** 2 / 2)
    if kind == "general":
        for _ in range(source.randint(1, 3)):
            among = source.sample(y, source.randint(1, min(2, len(y))))
            a = draw.linear(x)
            factor = source.choice([
                1 + HALF * sp.sin(a), 1 / (1 + a**2), sp.sqrt(1 + a**2), a**2, sp.exp(a / 3),
            ])  # fmt: skip
            terms.append(factor * sum(draw.number() * b for b in among) ** 2 / 2)
    return terms


def constraints(draw: Draw, x: list[Expr], y: list[Expr], t: Expr, m: int, kind: str) -> list[Expr]:
    """Return m constraints."""
    source, n = draw.source, len(x)
    order = source.sample(range(n), n)
    rows = []
    for k in range(m):
        i = order[k]
        others = [j for j in range(n) if j != i]
        j = source.choice(others)
        form = source.choice(["blade", "roll", "linear", "linear", "Heisenberg", "constant"])
        if form == "blade":
            angle = source.choice(x)
            row = sp.sin(angle) * y[i] - sp.cos(angle) * y[j]
            if source.random() < 0.4:
                row += draw.coefficient(x) * y[source.randrange(n)]
        elif form == "roll":
            row = y[i] - draw.number() * draw.bounded(x) * y[j]
        elif form == "Heisenberg" and n > 2:
            a, b = source.sample(others, 2)
            row = y[i] - HALF * (x[a] * y[b] - x[b] * y[a])
        elif form == "constant":
            row = y[i] + sum(draw.number() * y[j] for j in source.sample(others, min(2, n - 1)))
        else:
            among = source.sample(others, source.randint(1, len(others)))
            row = source.choice([sp.Integer(1), draw.number()]) * y[i]
            row += sum(draw.coefficient(x) * y[j] for j in among)
        if kind == "timed" and source.random() < 0.6:
            row += HALF * sp.sin(draw.positive() * t) * y[source.randrange(n)]
        if kind in ("affine", "timed") and source.random() < 0.8:
            row += source.choice([
                draw.number(), draw.number() * draw.bounded(x), draw.number() * source.choice(x),
            ])  # fmt: skip
            if kind == "timed":
                row += draw.number() * sp.cos(draw.positive() * t)
        if kind == "nonlinear":
            row += draw.number() / 5 * source.choice([
                sum(a**2 for a in y), y[i] * y[j], sp.sqrt(1 + y[i] ** 2), y[j] ** 3 / 3,
            ])  # fmt: skip
        rows.append(row)
    if m > 1 and source.random() < 0.05:  # nearly dependent
        rows[-1] = rows[0] + draw.define(10 ** source.uniform(-4, -1)) * rows[-1]
    return rows


def forces(draw: Draw, x: list[Expr], y: list[Expr], t: Expr) -> tuple[list[Expr], bool]:
    """Return random forces, and whether they do no work."""
    source, n = draw.source, len(x)
    found = [sp.Integer(0)] * n
    if source.random() < 0.3:  # gyroscopic
        i, j = source.sample(range(n), 2)
        c = draw.number() * source.choice([sp.Integer(1), draw.bounded(x)])
        found[i] += c * y[j]
        found[j] -= c * y[i]
        return found, True
    for i in range(n):
        kind = source.choice(["none", "none", "drag", "air", "drive", "field", "product"])
        if kind == "drag":
            found[i] -= draw.define(10 ** source.uniform(-2, 1)) * y[i]
        elif kind == "air":
            found[i] -= draw.positive() / 3 * y[i] * sp.sqrt(1 + sum(a**2 for a in y))
        elif kind == "drive":
            found[i] += draw.number() * sp.cos(draw.positive() * t + draw.number())
        elif kind == "field":
            found[i] += draw.number() * sp.sin(draw.linear(x) + draw.positive() * t)
        elif kind == "product":
            found[i] += draw.number() / 5 * y[source.randrange(n)] * y[source.randrange(n)]
    return found, not any(found)


def make(seed: int, index: int) -> Model:
    """Return a model, of (seed, index) alone."""
    source = random.Random(f"{seed} {index}")
    draw = Draw(source)
    n = source.randint(2, 6)
    m = source.randint(1, min(3, n - 1))
    q = [sp.Symbol(f"x{i}", real=True) for i in range(n)]
    v = [sp.Symbol(f"x{i}.d", real=True) for i in range(n)]
    t = sp.Symbol("t", real=True)

    def unit(large: int) -> Expr:
        power = source.uniform(-large, large)
        return draw.define(float(f"{10**power:.3g}") if large else 1.0, False)

    large = source.choice([0, 0, 0, 3, 30])
    one = sp.Integer(1)
    x, y, time, energy, units, s, second = q, v, t, one, [one] * n, [1.0] * n, 1.0
    if large:
        length, tau, mass = (unit(large) for _ in range(3))
        separate = source.random() < 0.3
        units = [unit(large) if separate else length for _ in q]
        energy = mass * length**2 / tau**2
        x, y = [a / b for a, b in zip(q, units)], [a * tau / b for a, b in zip(v, units)]
        time = t / tau
        s, second = [draw.values[a] for a in units], draw.values[tau]

    apart = [0.0] * n
    if source.random() < 0.1:  # far from the origin
        apart = [b * 10 ** source.uniform(0, 5) * source.choice([-1, 0, 1]) for b in s]
        shifts = [draw.define(a) if a else one * 0 for a in apart]
        x = [(a - c) / b for a, b, c in zip(q, units, shifts)]

    T = kinetic(draw, x, y, source.choice(MASSES))
    V = [draw.potential(x) for _ in range(source.randint(0, 3))]
    if source.random() < 0.7:
        V += [draw.positive() * a**2 / 2 for a in x if source.random() < 0.7]
    timed = source.random() < 0.1
    if timed:
        V.append(draw.number() * sp.cos(draw.positive() * time) * source.choice(x))
    gyroscopic = [
        draw.bounded(x) * draw.number() * source.choice(y)
        for _ in range(source.choice([0, 0, 0, 1, 2]))
    ]
    kind = source.choice(KINDS)
    rows = constraints(draw, x, y, time, m, kind)
    force, idle = [sp.Integer(0)] * n, True
    if source.random() < 0.35:
        force, idle = forces(draw, x, y, time)
    if large:
        force = [energy / b * e for e, b in zip(force, units)]
        rows = [unit(large) * e for e in rows]
    L = energy * sp.Add(*T, *gyroscopic, *(-e for e in V))
    size = energy * sp.Add(*T, *map(sp.Abs, V))
    used = set().union(*(e.free_symbols for e in (L, size, *units, *rows, *force)))
    at = {c: value for c, value in draw.values.items() if c in used}
    bends = [b for c, b in zip(draw.values, draw.bends) if c in used]
    q0, v0 = ([source.uniform(-1.5, 1.5) for _ in q] for _ in range(2))
    if source.random() < 0.3:
        q0 = [round(a, 1) for a in q0]
    if source.random() < 0.2:
        q0 = [a if source.random() < 0.5 else 0.0 for a in q0]
    if source.random() < 0.15:
        v0 = [0.0] * n
    t0 = second * round(source.choice([9, 9, 1e5]) * source.uniform(-1, 1), 1)
    t0 *= source.random() < 0.3
    span = second * 10 ** source.uniform(-0.3, 1.3) * source.choice([1] * 9 + [-1])
    return Model(
        q, v, t, L, rows, force, at, size, [a * b + c for a, b, c in zip(q0, s, apart)],
        [a * b / second for a, b in zip(v0, s)], t0, t0 + span, second, bends,
        idle and not timed and kind == "linear", source.random() < 0.3, source.random() < 0.3,
    )  # fmt: skip


# ---- verdicts ------------------------------------------------------------------------------------


@dataclass
class Outcome:
    """The verdict on a model, and its numbers."""

    verdict: str
    text: str = ""
    error: float = 0.0  # relative to 1 + condition
    raw: float = 0.0
    condition: float = 0.0
    energy: float = 0.0
    residual: Any = field(default_factory=lambda: np.zeros(3))  # in n u, see ``measures``
    steps: int = 0
    script: str = ""
    said: list[str] = field(default_factory=list)  # warnings


def judged(judge: Judge, k: int, rng: Any) -> Outcome:
    """Return the verdict on a model of a judge."""
    model = judge.models[k]
    y, n = judge.start(k), len(model.q)
    if y is None:
        return Outcome("unsuitable", "the constraints are dependent at the start")
    ends = [model.t0, model.t_end]
    inner = sorted(rng.uniform(*sorted(ends), 3), reverse=ends[1] < ends[0])
    asked = [float(a) for a in inner] + [model.t_end]
    options: dict[str, Any] = {"t_eval": asked}
    if model.even and model.t_end > model.t0:
        options = {"h": (model.t_end - model.t0) / 4}
    script = model.script(y, options)
    given: dict[str, Any] = {"t0": model.t0, "t_end": model.t_end, "consistent": "project"}
    found: list[Any] = []
    error: BaseException | None = None
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            with limited(SECONDS):
                system = model.system()
                for more in ({}, options):
                    found.append(dal.integrate(system, "taylor", y[:n], y[n:], **given, **more))
        except Exception as raised:  # noqa: BLE001
            error = raised
    result = compared(judge, k, y, found, error, rng)
    result.script, result.said = script, [str(w.message) for w in said]
    return result


def compared(
    judge: Judge, k: int, y: Any, found: list[Any], error: BaseException | None, rng: Any
) -> Outcome:
    """Return the verdict on two runs, or on an error."""
    model = judge.models[k]
    if error is None:
        times = [float(a) for a in found[0].t]
        chosen = sorted({*(int(i) for i in rng.integers(1, len(times), 2)), len(times) - 1})
        return weighed(judge, k, y, found, [chosen, range(len(found[1].t))], rng)
    text = f"{type(error).__name__}: {error}"
    whole = judge.follow(k, y, [model.t0, model.t_end], 15, 1e-24)
    partial = getattr(error, "partial", None)
    at = float(partial.t[-1]) if partial is not None else model.t0
    ahead = (whole.reached - at) / (model.t_end - model.t0)
    if partial is not None and len(partial.t) > 4:
        last = len(partial.t) - 1
        result = weighed(judge, k, y, [partial], [[last // 2, 3 * last // 4]], rng)
        if result.verdict == "wrong":
            result.text += f"; {text}"
            return result
    text = f"{text}; the judge comes to t = {whole.reached!r} with status {whole.status}"
    if whole.status == 0 or ahead > 0.02:
        return Outcome("refused", text)
    return Outcome("passed" if whole.status == 2 and ahead < -0.02 else "singular", text)


def weighed(
    judge: Judge, k: int, y: Any, found: list[Any], rows: list[Any], rng: Any
) -> Outcome:
    """Return the verdict on some rows of runs."""
    model, n = judge.models[k], len(judge.models[k].q)
    times = {model.t0, *(float(run.t[i]) for run, some in zip(found, rows) for i in some)}
    grid = sorted(times, reverse=model.t_end < model.t0)
    main = judge.follow(k, y, grid, 15, 1e-24)
    if main.status == 2:
        return Outcome("passed", f"the judge ends at t = {main.reached!r}")
    if main.status:
        return Outcome("unsuitable", f"the judge comes to t = {main.reached!r}")
    exact = judge.follow(k, y, grid, 18, 1e-25)
    apart = np.inf if exact.status else max(main.apart(exact))
    if not apart <= AGREEMENT:
        return Outcome("unsuitable", f"the judge agrees to {apart:.1e} only")
    condition = np.zeros(len(grid))

    def signs(count: int) -> Any:  # of several sizes, so that no two changes cancel
        return rng.choice([-1, 1], count) * rng.uniform(0.5, 1, count)

    for _ in range(2):
        bent = BENT * signs(len(model.bends) + 1) * [*model.bends, 0]
        shift = BENT * signs(len(y)) * main.scale
        later = [grid[0], *(t * (1 + BENT * float(x)) for t, x in zip(grid[1:], signs(len(grid))))]
        near = judge.follow(k, y, later, 12, 1e-19, array(bent), array(shift))
        if near.status:
            return Outcome("unsuitable", "a motion nearby ends")
        condition = np.maximum(condition, main.apart(near) / BENT)
    result, faults = Outcome("right", condition=float(condition.max())), []
    if not result.condition <= CONDITION:
        return Outcome("unsuitable", f"the condition is {result.condition:.1e}")
    for run, some in zip(found, rows):
        for i in some:
            t, x = float(run.t[i]), np.concatenate([run.q[i], run.v[i]])
            at = grid.index(t)
            away = float(exact.away(x[None], [at])[0])
            size = away / (1 + condition[at])
            if not size <= result.error:
                result.error, result.raw = size, away
            if not size <= BAR:
                j = int(np.nanargmax(abs(x - exact.high[at]) / exact.safe))
                name = f"{'qv'[j // n]}[{j % n}]"
                faults.append(
                    f"t = {t!r}: {name} = {x[j]!r}, exact {exact.high[at, j]!r}, relative error "
                    f"{away:.1e}, condition {condition[at]:.1e}"
                )
        states = np.hstack([run.q, run.v])
        if not np.isfinite(states).all():
            faults.append("a state is no number")
        *residuals, change, size = judge.measures(k, run.t, states).T
        residuals = np.array(residuals) / U
        given = float(np.max(run.residual))
        if not given <= 4 * n * U:
            faults.append(f"run.residual is {given / U:.2f} u, n = {n}")
        result.residual = np.maximum(result.residual, residuals.max(1) / n)
        if not max(residuals[0]) <= 4 * n:
            i = int(np.argmax(residuals[0]))
            faults.append(
                f"t = {run.t[i]!r}: the residual is {residuals[:, i]} u, n = {n}; run.residual has "
                f"{run.residual[i] / U:.2f} u"
            )
        if model.conservative and max(size) > 0:
            lost = float(max(abs(change)) / max(size))
            result.energy = max(result.energy, lost)
            if not lost <= ENERGY:
                faults.append(f"the energy changes by {lost:.1e}")
        result.steps = max(result.steps, len(run.t) - 1)
    if faults:
        result.verdict, result.text = "wrong", "; ".join(dict.fromkeys(faults))
    return result


VERDICTS = "right", "unsuitable", "singular", "passed", "refused", "wrong"


@dataclass
class Verdict:
    """The results of a campaign."""

    count: collections.Counter[str] = field(default_factory=collections.Counter)
    faults: list[str] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    outcomes: list[Outcome] = field(default_factory=list)

    def __str__(self) -> str:
        right = [x for x in self.outcomes if x.verdict == "right"]

        residual = np.max([np.zeros(3), *(x.residual for x in right)], 0)

        def worst(name: str) -> float:
            return max([0.0, *(getattr(x, name) for x in right)])

        return (
            f"{sum(self.count.values())} models: error at most {worst('error'):.1e} (1 + "
            f"condition), median {np.median([x.error for x in right] or [0]):.1e}, "
            f"{sum(x.error > 1e-14 for x in right)} above 1e-14; energy "
            f"{worst('energy'):.1e}; residual {residual[0]:.2f} n u ({residual[1]:.2f}, "
            f"{residual[2]:.2f} of other sizes); {sum(bool(x.said) for x in right)} with warnings; "
            + ", ".join(f"{self.count[name]} {name}" for name in VERDICTS)
        )


def batches(first: int, models: int, size: int) -> Iterator[range]:
    for k in range(first, first + models, size):
        yield range(k, min(k + size, first + models))


def campaign(
    models: int, seed: int = 1, first: int = 0, size: int = 25, seconds: float = math.inf,
    show: Callable[[str], None] = lambda text: None,
) -> Verdict:  # fmt: skip
    """Judge random models; those of ``size`` at a time share a C program of the judge."""
    found, begin = Verdict(), time.monotonic()
    for chosen in batches(first, models, size):
        if time.monotonic() - begin > seconds:
            break
        with (
            tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
            mock.patch.dict(os.environ, DALEMBERT_CACHE=f"{folder}/cache"),
        ):
            judge = Judge([make(seed, k) for k in chosen], folder)
            for i, k in enumerate(chosen):
                result = judged(judge, i, np.random.default_rng([seed, k]))
                found.count[result.verdict] += 1
                found.outcomes.append(result)
                label = f"seed {seed}, model {k}: {result.verdict}: {result.text}"
                if result.verdict in ("wrong", "refused", "passed"):
                    found.faults.append(f"{label}\n{result.script}")
                elif result.verdict != "right":
                    found.others.append(label)
                elif result.error > 1e-15 or result.energy > 1e-14:
                    found.others.append(
                        f"{label}error {result.error:.1e} (1 + condition), energy "
                        f"{result.energy:.1e}, condition {result.condition:.1e}"
                    )
                if result.verdict in ("wrong", "refused", "passed", "singular"):
                    show(label)
        show(f"{time.monotonic() - begin:.0f} s: {found}")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description='Random models for the scheme "taylor".')
    parser.add_argument("--models", type=int, default=500, help="number of random models")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random models")
    parser.add_argument("--first", type=int, default=0, help="number of the first model")
    parser.add_argument("--size", type=int, default=25, help="number of models in a program")
    parser.add_argument("--seconds", type=float, default=math.inf, help="start no more after this")
    parser.add_argument("--show", action="store_true", help="print progress")
    given = parser.parse_args()
    show: Any = functools.partial(print, flush=True) if given.show else lambda text: None
    found = campaign(given.models, given.seed, given.first, given.size, given.seconds, show)
    print(*found.faults, *found.others, sep="\n")
    print(found)
    return int(bool(found.faults) or not found.outcomes)


if __name__ == "__main__":
    sys.exit(main())
