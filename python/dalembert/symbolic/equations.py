"""The equations of motion on D as SymPy expressions, for people."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

import sympy

from .graph import below
from .latex import writer
from .model import Model
from .motion import agrees
from .printing import C, Program, Text, spelled
from .reduced import NotReduced, Reduced, in_chart
from .symbols import TIME, Time

Expr = Any


class Equations(NamedTuple):
    """The equations of motion on D: q' = E w + e, and w' = rates.

    Attributes
    ----------
    w : tuple of sympy.Symbol
        The n - m quasi-velocities.
    E : sympy.Matrix, n x (n - m)
        A basis of the kernel of mu, in the coordinates, the time, parameters and inputs.
    e : sympy.Matrix, n x 1
        0 unless the constraints are affine.
    rates : sympy.Matrix, (n - m) x 1
        The rates of w.
    how : tuple of str
        The operations on columns that led to E.
    tex : str
        The same as LaTeX, in an aligned environment.
    c : str
        The same as two C functions, ``velocity`` and ``rates``.
    coordinates : tuple of str
        Their names.
    """

    w: tuple[Expr, ...]
    E: Expr
    e: Expr
    rates: Expr
    how: tuple[str, ...]
    tex: str
    c: str
    coordinates: tuple[str, ...]

    def _repr_latex_(self) -> str:
        return f"${self.tex}$"

    def lines(self) -> list[tuple[str, str]]:
        """Return pairs of a text and a formula as plain text: velocities, then rates of w."""
        velocities = self.E * sympy.Matrix(self.w) + self.e
        named = [(f"v_{name}", x) for name, x in zip(self.coordinates, velocities)]
        named += [(f"rate of {x}", rate) for x, rate in zip(self.w, self.rates)]
        return [(name, str(x).replace("**", "^").replace("*", " ")) for name, x in named]


_LONG = 120  # operations of a formula that is factored


def _factored(e: Expr) -> Expr:
    """Return a formula in factors, if that is shorter."""
    if not 0 < e.count_ops() <= _LONG:
        return e
    return min(e, sympy.factor(e), key=lambda x: x.count_ops())


def _free(taken: set[str], count: int) -> str:
    """Return a letter whose numbered names are not taken."""
    letters = ("w", "omega", "quasi")
    return next(x for x in letters if not {f"{x}{i + 1}" for i in range(count)} & taken)


def equations(model: Model, dependent: Collection[int] | None = None) -> Equations:
    """Return the equations of a model, in the user's names.

    If ``dependent`` are the numbers of m coordinates, w are the velocities of the others.

    Raises
    ------
    NotImplementedError
        If no basis of D is found in closed form.
    """
    try:
        found = model.reduced if dependent is None else in_chart(model, dependent)
    except NotReduced as reason:
        raise NotImplementedError(f"no equations on D in closed form: {reason}") from None
    if not agrees(model, found):
        raise NotImplementedError("the equations on D that were found are wrong; please report it")
    n, k = model.n, len(found.w)
    read = model.derived.read
    taken = {*model.coordinates, *model.parameters, *model.inputs}
    w = tuple(sympy.Symbol(f"{_free(taken, k)}{i + 1}", real=True) for i in range(k))
    names = dict(zip(map(read.formula, found.w), w)) | {TIME: Time()}
    parts = (found.E, found.e, found.rates)
    canonical = [[_factored(read.formula(x)) for x in part] for part in parts]
    E, e, rates = (
        sympy.Matrix(n if i < 2 else k, k if i == 0 else 1, part)
        for i, part in enumerate(canonical)
    )
    tex = writer(model, dict(zip(map(read.formula, found.w), map(sympy.latex, w))))
    column = sympy.Matrix([read.formula(x) for x in found.w])
    shift = f" + {tex(e)}" if any(x != 0 for x in e) else ""
    lines = [
        rf"\dot q &= {tex(E)} {tex(column)}{shift}",
        *(rf"\dot {tex(x)} &= {tex(rate)}" for x, rate in zip(column, rates)),
    ]
    text = r"\begin{aligned}" + r" \\ ".join(lines) + r"\end{aligned}"
    if dependent is not None:
        E = E.applyfunc(sympy.trigsimp)
    E, e, rates = (model.shown(x).xreplace(names) for x in (E, e, rates))
    return Equations(w, E, e, rates, found.how, text, _in_c(model, found), model.coordinates)


def _in_c(model: Model, found: Reduced) -> str:
    """Return two functions of the time, q[n], w[n - m], the inputs u and the parameters p."""
    read, made = model.derived.read, Program()
    arrays = {"q": model.q, "u": model.u, "p": model.p}
    places = {read(x).value: f"{name}[{i}]" for name, x in arrays.items() for i, x in enumerate(x)}
    places |= {x.value: f"w[{i}]" for i, x in enumerate(found.w)} | {read(TIME).value: "t"}
    made.add("#include <math.h>\n")
    for name, out, nodes in (("velocity", "v", found.velocity), ("rates", "w_t", found.rates)):
        nodes = spelled(nodes)
        text = Text(nodes, C, places)
        made.add(f"void {name}(double t, const double *q, const double *w, const double *u,\n"
                 f"     {' ' * len(name)} const double *p, double *{out})\n{{")  # fmt: skip
        made.add("    (void)t, (void)q, (void)w, (void)u, (void)p;")
        made.lines += [f"    {line}" for line in text.names(below(nodes), nodes)]
        made.lines += [f"    {out}[{i}] = {text.whole(e)};" for i, e in enumerate(nodes)]
        made.add("}\n")
    return made.source.rstrip() + "\n"
