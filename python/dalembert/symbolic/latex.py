"""The equations of a model as LaTeX, from the user's own expressions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import sympy

from .symbols import TIME

Expr = Any
Model = Any  # of model.py, which calls this


def _latex_symbol(name: str) -> str:
    """Return a name as LaTeX; an unusual one letter by letter, so that it cannot be a command."""
    if name.replace("_", "").isalnum() and name.isascii():
        return str(sympy.latex(sympy.Symbol(name)))
    safe = "".join(c if c.isalnum() else " " for c in name)
    return rf"\mathtt{{{safe}}}"


def writer(model: Model, more: Mapping[Expr, str]) -> Callable[[Expr], str]:
    """Return a function that writes expressions of a model, and of more symbols, as LaTeX."""
    letters = (*model.parameters, *model.inputs)
    names: dict[Expr, str] = dict(zip((*model.p, *model.u), map(_latex_symbol, letters)))
    for q, v, name in zip(model.q, model.v, model.coordinates):
        names |= {q: _latex_symbol(name), v: rf"\dot{{{_latex_symbol(name)}}}"}
    names |= more
    return lambda e: str(sympy.latex(_in_doubles(e), symbol_names=names))


def latex(model: Model) -> str:
    """Return L, mu and the ODE on D as LaTeX, in an aligned environment."""
    tex = writer(model, {})
    derived, n, m = model.derived, model.n, model.m
    form = r"\mu" if derived.kind == "linear" else r"\varphi_v"
    lines = [f"L &= {tex(model.L)}"]
    if m > 0 and derived.kind == "linear":
        mu = _slopes(model.constraints, model.v).xreplace(dict.fromkeys(model.v, sympy.Integer(0)))
        lines.append(rf"\mu &= {tex(mu)}, \quad \mu \dot q = 0")
    elif m > 0:
        lines.append(rf"\varphi &= {tex(_column(model.constraints))} = 0")
    v = _column(model.v)
    if derived.mass is not None:
        V = -model.L.xreplace(dict.fromkeys(model.v, sympy.Integer(0)))
        mass, pull = "M", "-V_q" * (derived.function("potential") is not None)
        M = sympy.Matrix(n, n, [derived.read.formula(e) for e in derived.mass])
        lines.append(rf"M &= {tex(M)}")
        if pull:
            lines.append(rf"V_q &= {tex(_slopes([V], model.q).T)}")
    else:
        mass, pull = "L_{vv}", r"L_q - L_{vq} \dot q"
        L_q, L_v = (_slopes([model.L], x).T for x in (model.q, model.v))
        lines.append(rf"L_{{vv}} &= {tex(_slopes(L_v, model.v))}")
        pulled = L_q - _slopes(L_v, model.q) * v
        if model.is_time_dependent:
            pull += r" - L_{vt}"
            pulled -= _slopes(L_v, [TIME])
        lines.append(rf"{pull} &= {tex(pulled)}")
    if model.force is not None:
        pull = f"{pull} + f".removeprefix(" + ")
        lines.append(rf"f &= {tex(_column(model.force))}")
    react = rf" + {form}^T \lambda" if m > 0 else ""
    lines.append(rf"{mass} \ddot q &= {f'{pull}{react}'.removeprefix(' + ') or '0'}")
    if m > 0:
        inverse, turn = f"{mass}^{{-1}}", r"\varphi_q \dot q"
        turned = _slopes(model.constraints, model.q) * v
        if model.is_time_dependent:
            turn += r" + \varphi_t"
            turned += _slopes(model.constraints, [TIME])
        pulled = rf" + {form} {inverse} ({pull})" if pull else ""
        lines.append(rf"\lambda &= -({form} {inverse} {form}^T)^{{-1}} \left({turn}{pulled}\right)")
        lines.append(rf"{turn} &= {tex(turned)}")
    return r"\begin{aligned}" + r" \\ ".join(lines) + r"\end{aligned}"


def _column(expressions: Iterable[Expr]) -> Expr:
    return sympy.Matrix([*expressions])


def _slopes(expressions: Iterable[Expr], symbols: Sequence[Expr]) -> Expr:
    """Return the matrix of derivatives."""
    return sympy.Matrix([[sympy.diff(e, x) for x in symbols] for e in expressions])


def _in_doubles(e: Expr) -> Expr:
    """Return an expression with 15 digits of its long numbers."""
    return e.xreplace({
        x: sympy.Float(x, 15) for x in e.atoms(sympy.Rational, sympy.Float)
        if x.is_Float or max(abs(x.p), x.q) >= 2**53
    })  # fmt: skip
