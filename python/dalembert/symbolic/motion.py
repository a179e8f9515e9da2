"""The motion of a model as rates of states: of (q, w) on D, or of (q, v)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .graph import Node
from .model import Model
from .recurrences import Series
from .reduced import NotReduced
from .symbols import TIME


@dataclass(frozen=True)
class Motion:
    """The rates of the states (q, w).

    Attributes
    ----------
    w : tuple of Node
        Symbols of the states besides q.
    velocity : tuple of Node
        The rates of q: v as nodes in (t, q, w).
    rates : tuple of Node
        The rates of w.
    quasi : tuple of Node
        w as nodes in (t, q, v).
    in_D : bool
        Whether v lies in D for all w; if not, w is v.
    """

    w: Sequence[Node]
    velocity: Sequence[Node]
    rates: Sequence[Node]
    quasi: Sequence[Node]
    in_D: bool


def motion(model: Model) -> Motion:
    """Return the motion of a model: on D if a basis of D is found."""
    try:
        found = model.reduced
    except NotReduced:
        v = [model.derived.read(x) for x in model.v]
        return Motion(v, v, accelerations(model), v, model.m == 0)
    return Motion(found.w, found.velocity, found.rates, found.quasi, True)


def series_of(model: Model, motion: Motion) -> Series:
    """Return the series of (q, w)."""
    read = model.derived.read
    states = [*map(read, model.q), *motion.w]
    return Series(dict(zip(states, (*motion.velocity, *motion.rates))), read(TIME))


def accelerations(model: Model) -> list[Node]:
    """Return dv/dt as nodes in (t, q, v), with the multipliers eliminated as in field.h."""
    derived, n, m = model.derived, model.n, model.m
    outputs = derived.terms.outputs
    graph = outputs["F"][0].graph
    M = _rows(derived.mass or outputs["M"], n)
    mu = _rows(outputs.get("mu", ()), n)
    free, *Z = solve(M, [list(outputs["F"]), *mu])
    C = [[_dot(row, z) for z in Z] for row in mu]
    right = [_dot(row, free) + g for row, g in zip(mu, outputs.get("g", ()))]
    (lack,) = solve(C, [right])
    return [
        free[i] - graph.sum(Z[a][i] * lack[a] for a in range(m)) for i in range(n)
    ]  # fmt: skip


def _rows(entries: Sequence[Node], n: int) -> list[list[Node]]:
    return [list(entries[i : i + n]) for i in range(0, len(entries), n)]


def _dot(a: Sequence[Node], b: Sequence[Node]) -> Node:
    return a[0].graph.sum(x * y for x, y in zip(a, b) if not (x.is_zero or y.is_zero))


def solve(A: list[list[Node]], rights: list[list[Node]]) -> list[list[Node]]:
    """Return A^-1 times each right side, for a positive definite A, without pivoting."""
    A, rights, n = [[*row] for row in A], [[*x] for x in rights], len(A)
    for j in range(n):
        for i in range(j + 1, n):
            if A[i][j].is_zero:
                continue
            share = A[i][j] / A[j][j]
            for k in range(j + 1, n):
                A[i][k] = A[i][k] - share * A[j][k]
            for x in rights:
                x[i] = x[i] - share * x[j]
    for x in rights:
        for i in reversed(range(n)):
            later = [A[i][k] * x[k] for k in range(i + 1, n) if not A[i][k].is_zero]
            x[i] = (x[i] - x[i].graph.sum(later)) / A[i][i]
    return rights
