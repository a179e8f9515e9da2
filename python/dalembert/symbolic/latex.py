"""The equations of a model as LaTeX."""

from __future__ import annotations

from typing import Any

import sympy

from .functions import in_doubles
from .symbols import Expr

Model = Any  # of model.py, which calls this


def _latex_symbol(name: str) -> str:
    """Return a name as LaTeX; an unusual one letter by letter, so that it cannot be a command."""
    if name.replace("_", "").isalnum() and name.isascii():
        return str(sympy.latex(sympy.Symbol(name)))
    safe = "".join(c if c.isalnum() else " " for c in name)
    return rf"\mathtt{{{safe}}}"


def latex(model: Model) -> str:
    """Return L, mu and the ODE on D as LaTeX, in an aligned environment."""
    letters = (*model.parameters, *model.inputs)
    names: dict[Expr, str] = dict(zip((*model.p, *model.u), map(_latex_symbol, letters)))
    for q, v, name in zip(model.q, model.v, model.coordinates):
        names |= {q: _latex_symbol(name), v: rf"\dot{{{_latex_symbol(name)}}}"}

    def tex(expression: Expr) -> str:
        return str(sympy.latex(expression, symbol_names=names))

    derived, n, m = model.derived, model.n, model.m
    form = r"\mu" if derived.kind == "linear" else r"\varphi_v"
    lines = [f"L &= {tex(model.L)}"]
    if m > 0 and derived.kind == "linear":
        mu = _matrix(model, "constraint", "phi_v", m)
        lines.append(rf"\mu &= {tex(mu)}, \quad \mu \dot q = 0")
    elif m > 0:
        lines.append(rf"\varphi &= {tex(_matrix(model, 'constraint', 'phi', m))} = 0")
    if derived.mass is not None:
        mass, pull = "M", "-V_q" * (derived.function("potential") is not None)
        lines.append(rf"M &= {tex(_matrix(model, 'mass', 'M', n))}")
        if pull:
            lines.append(rf"V_q &= {tex(_matrix(model, 'potential', 'V_q', n))}")
    else:
        mass, pull = "L_{vv}", r"L_q - L_{vq} \dot q"
        L_q, L_vq, L_vv = (_matrix(model, "lagrangian", x, n) for x in ("L_q", "L_vq", "L_vv"))
        lines.append(rf"L_{{vv}} &= {tex(L_vv)}")
        pulled = L_q - L_vq * sympy.Matrix(model.v)
        if model.is_time_dependent:
            pull += r" - L_{vt}"
            pulled -= _matrix(model, "lagrangian", "L_vt", n)
        lines.append(rf"{pull} &= {tex(pulled)}")
    if model.force is not None:
        pull = f"{pull} + f".removeprefix(" + ")
        lines.append(rf"f &= {tex(sympy.Matrix(n, 1, list(model.force)))}")
    react = rf" + {form}^T \lambda" if m > 0 else ""
    lines.append(rf"{mass} \ddot q &= {f'{pull}{react}'.removeprefix(' + ') or '0'}")
    if m > 0:
        inverse, turn = f"{mass}^{{-1}}", r"\varphi_q \dot q"
        turned = _matrix(model, "constraint", "phi_q", m) * sympy.Matrix(model.v)
        if model.is_time_dependent:
            turn += r" + \varphi_t"
            turned += _matrix(model, "constraint", "phi_t", m)
        pulled = rf" + {form} {inverse} ({pull})" if pull else ""
        lines.append(rf"\lambda &= -({form} {inverse} {form}^T)^{{-1}} \left({turn}{pulled}\right)")
        lines.append(rf"{turn} &= {tex(turned)}")
    return r"\begin{aligned}" + r" \\ ".join(lines) + r"\end{aligned}"


def _matrix(model: Model, name: str, output: str, rows: int) -> Expr:
    """Return an output of a function as a matrix of so many rows."""
    entries = [*map(in_doubles, model.derived.expressions(name, output))]
    return sympy.Matrix(rows, len(entries) // rows, entries)
