"""Models: a Lagrangian and constraints as SymPy expressions, and derived functions.

Nothing is simplified and no matrix is inverted, because both can take minutes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from . import latex
from .derivatives import Jump, SymPy, engine_for
from .functions import in_doubles, with_default
from .symbols import TIME, Coordinate, Expr, Rule, canonical
from .zeros import PIECES, is_zero


def _of_each(f: Callable[[Expr], Expr], entries: Iterable[Expr]) -> list[Expr]:
    """Return f of each entry; most entries may be 0, and f of 0 is computed once."""
    zero = f(sympy.Integer(0))
    return [zero if e == 0 else f(e) for e in entries]


@dataclass(frozen=True)
class Function:
    """A function of the generated program: its outputs, in order, with their expressions."""

    name: str
    outputs: dict[str, Sequence[Expr]]
    engine: Any


@dataclass(frozen=True)
class Derived:
    """The type of a model, and the functions generated from it.

    Attributes
    ----------
    kind : {"linear", "affine", "nonlinear"}
        How the constraints depend on v.
    mass : tuple of expressions or None
        M, row by row, if it is constant and L = v^T M v / 2 - V(q); depends on parameters only.
    functions : tuple of Function
        potential, lagrangian, constraint, force, mass, ..., if present.
    is_positional : bool
        Whether there is a force, and it does not depend on v.
    """

    kind: str
    mass: tuple[Expr, ...] | None
    functions: tuple[Function, ...]
    is_positional: bool

    @property
    def has_momenta(self) -> bool:
        """Whether steps need L_v: for M(q), a force that depends on v, or other than linear
        constraints.
        """
        dragged = self.function("force") is not None and not self.is_positional
        return self.mass is None or self.kind != "linear" or dragged

    def function(self, name: str) -> Function | None:
        """Return the function of this name, None if the model has none."""
        return next((f for f in self.functions if f.name == name), None)

    def entries(self, name: str, output: str) -> Sequence[Expr]:
        """Return an output of a function as its engine's expressions; empty if absent."""
        function = self.function(name)
        return [] if function is None else function.outputs[output]

    def expressions(self, name: str, output: str) -> list[Expr]:
        """Return an output of a function as SymPy expressions; empty if absent."""
        function = self.function(name)
        return [] if function is None else _of_each(function.engine.give, function.outputs[output])


@dataclass(frozen=True, eq=False)
class Model:
    """A Lagrangian and constraints in canonical symbols, and the user's names.

    Attributes
    ----------
    coordinates, parameters : tuple of str
        Names; q0 is the first coordinate, v0 its velocity, p0 the first parameter.
    L : sympy.Expr
        The Lagrangian.
    constraints : tuple of sympy.Expr
        Expressions that vanish; may contain the inputs, which are constant over a step.
    force : tuple of sympy.Expr or None
        The n components of the generalized force; may contain the inputs.  All may contain t.
    state : tuple of sympy.Expr or None
        Default initial data (q, v), in the parameters.
    exact : tuple of sympy.Expr or None
        The exact solution (q, v) at time t, in the initial data q0 ... v0 ...
    invariants : tuple of sympy.Expr
        First integrals besides the energy.
    assumptions : tuple of tuple of str
        The assumptions on the values of each parameter: "positive", ...
    inputs : tuple of str
        Names; u0 is the first input of the force and the constraints.
    positions : tuple of sympy.Expr
        Constraints on q and the time, whose time derivatives are among the constraints.
    """

    coordinates: tuple[str, ...]
    parameters: tuple[str, ...]
    L: Expr
    constraints: tuple[Expr, ...]
    force: tuple[Expr, ...] | None = None
    state: tuple[Expr, ...] | None = None
    exact: tuple[Expr, ...] | None = None
    invariants: tuple[Expr, ...] = ()
    assumptions: tuple[tuple[str, ...], ...] = ()
    inputs: tuple[str, ...] = ()
    positions: tuple[Expr, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        fields = dataclasses.fields(self)
        return Model, tuple(getattr(self, field.name) for field in fields)

    @property
    def n(self) -> int:
        return len(self.coordinates)

    @property
    def m(self) -> int:
        return len(self.constraints)

    @property
    def q(self) -> tuple[Expr, ...]:
        return canonical("q", self.n)

    @property
    def v(self) -> tuple[Expr, ...]:
        return canonical("v", self.n)

    @property
    def p(self) -> tuple[Expr, ...]:
        return canonical("p", len(self.parameters))

    @property
    def u(self) -> tuple[Expr, ...]:
        return canonical("u", len(self.inputs))

    @property
    def is_time_dependent(self) -> bool:
        """Whether L or the constraints depend on time."""
        return any(TIME in e.free_symbols for e in (self.L, *self.constraints))

    @property
    def is_driven(self) -> bool:
        """Whether a constraint depends on inputs."""
        return any(u in e.free_symbols for e in self.constraints for u in self.u)

    @functools.cached_property
    def key(self) -> str:
        """A digest of the model without its names."""
        parts = [
            (self.L,), self.constraints, self.force, self.state, self.exact, self.invariants
        ]  # fmt: skip
        texts = [None if part is None else [_structure(e) for e in part] for part in parts]
        text = repr((self.n, len(self.parameters), len(self.inputs), texts, self.assumptions))
        return hashlib.sha256(text.encode()).hexdigest()

    @functools.cached_property
    def derived(self) -> Derived:
        """Type, mass and derivatives; expensive."""
        return _derive(self)

    @functools.cached_property
    def terms(self) -> Function:
        """The terms of the ODE on D, as in field.h; M only if it is not constant."""
        return _terms(self, self.derived)

    @functools.cached_property
    def sparsity(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Rows and columns, row by row, of the entries that are nonzero in phi_v or phi_q."""
        jacobians = (self.derived.entries("constraint", x) for x in ("phi_v", "phi_q"))
        there = [k for k, both in enumerate(zip(*jacobians)) if any(e != 0 for e in both)]
        return tuple(k // self.n for k in there), tuple(k % self.n for k in there)

    def shown(self, expression: Expr) -> Expr:
        """Return an expression with the user's names."""
        return expression.xreplace(self._names)

    @functools.cached_property
    def _names(self) -> Rule:
        found = dict(zip((*self.p, *self.u), map(sympy.Symbol, (*self.parameters, *self.inputs))))
        for q, v, name in zip(self.q, self.v, self.coordinates):
            coordinate = Coordinate(name)
            found |= {q: coordinate, v: coordinate.d}
        return found

    # ---- as Python functions --------------------------------------------------------------

    def callables(self, name: str) -> dict[str, Callable[..., Any]]:
        """Return a function of Python for each output of a function.

        Its arguments are (q, v, p).  An exact solution, a force, and all functions of a model that
        depends on time have the arguments (t, q, v, p).  Inputs precede p.
        """
        function = self.derived.function(name)
        arguments = [self.q, self.v, self.p]
        if name in ("force", "exact") or (self.is_time_dependent and name not in ("mass", "state")):
            arguments.insert(0, TIME)
        if (name == "force" and self.inputs) or (name == "constraint" and self.is_driven):
            arguments.insert(-1, self.u)
        return {
            output: sympy.lambdify(
                arguments,
                _of_each(
                    lambda e: with_default(in_doubles(function.engine.give(e), 17)), expressions
                ),
                "math",
                cse=True,
            )
            for output, expressions in (function.outputs.items() if function else ())
        }

    @functools.cached_property
    def at_positions(self) -> Callable[..., list[float]]:
        """A function of (t, q, p): the position constraints, then the n slopes of each."""
        slopes = [sympy.diff(e, x) for e in self.positions for x in self.q]
        given = [with_default(e) for e in (*self.positions, *slopes)]
        return sympy.lambdify([TIME, self.q, self.p], given, "math", cse=True)

    # ---- for people ------------------------------------------------------------------------

    def formula(self, expression: Expr) -> str:
        """Return an expression as plain text: v_x for the velocity of x, a blank for a product.

        Terms with velocities come first.
        """
        symbols = (*self.q, *self.v, *self.p, *self.u)
        velocities = [f"v_{name}" for name in self.coordinates]
        names = [*self.coordinates, *velocities, *self.parameters, *self.inputs]
        expression = expression.xreplace(dict(zip(symbols, map(sympy.Symbol, names))))
        moving = {sympy.Symbol(name) for name in names[self.n : 2 * self.n]}
        parts: tuple[list[Expr], list[Expr]] = ([], [])
        for term in sympy.Add.make_args(expression):
            parts[not term.free_symbols & moving].append(term)
        texts = [str(sympy.factor_terms(sympy.Add(*part))) for part in parts if part]
        text = " + ".join(texts).replace("+ -", "- ")
        return text.replace("**", "^").replace("*", " ")

    def still(self) -> tuple[str, ...]:
        """Return the terms without a velocity of each constraint that has some, as plain text."""
        at_rest = dict.fromkeys(self.v, 0)
        found = ((a, phi.xreplace(at_rest)) for a, phi in enumerate(self.constraints))
        return tuple(f"{self.formula(e)}, in constraints[{a}]" for a, e in found if e != 0)

    def formulas(self) -> tuple[str, ...]:
        """Return L, the constraints and the force as plain text, one line each."""
        force = zip(self.coordinates, self.force or ())
        return (
            f"L = {self.formula(self.L)}",
            *(f"{self.formula(phi)} = 0" for phi in self.constraints),
            *(f"f_{name} = {self.formula(f)}" for name, f in force if f != 0),
        )

    def latex(self) -> str:
        """Return L, mu and the ODE on D as LaTeX, in an aligned environment."""
        return latex.latex(self)


def _structure(e: Expr) -> str:
    """Return a text that two expressions share only if they are equal.

    ``srepr`` does the same, but sorts again and takes ten times as long.
    """
    if not e.args:
        return str(sympy.srepr(e))
    return f"{type(e).__name__}({', '.join(map(_structure, e.args))})"


@contextlib.contextmanager
def _naming(model: Model, where: str) -> Iterator[None]:
    """Add the user's names to errors about jumps."""
    try:
        yield
    except Jump as jump:
        x, argument = map(model.shown, jump.args)
        raise ValueError(
            f"{where}: its derivative by {x} needs DiracDelta({argument}), because it jumps "
            f"where {argument} = 0. Write a Piecewise, whose jumps exert no force, or a "
            "smooth step of width w, such as (1 + tanh(x/w))/2 for Heaviside(x)"
        ) from None


def _derive(model: Model) -> Derived:
    """Return the type of a model and its derivatives."""
    q, v = model.q, model.v
    lagrangian, constraints = _exact(model.L), [_exact(e) for e in model.constraints]
    engine = engine_for([lagrangian, *constraints])
    with _naming(model, "L"):
        mass, functions = _energy(model, engine, lagrangian)
    kind = "linear"
    phi_v, phi_q, phi_t = [], [], []
    for a, e in enumerate(constraints):
        with _naming(model, f"constraints[{a}]"):
            phi = [engine.take(e)]
            phi_v += _slopes(engine, phi, v)
            phi_q += _slopes(engine, phi, q)
            phi_t += _slopes(engine, phi, [TIME])
    if constraints:
        kind, phi_v = _kind(model, engine, constraints, phi_v)
        phi = [*map(engine.take, constraints)]
        outputs = {"phi": phi, "phi_v": phi_v, "phi_q": phi_q}
        if model.is_time_dependent:
            outputs["phi_t"] = phi_t
        functions.append(Function("constraint", outputs, engine))
    if model.force is not None:
        engine = engine_for(model.force)
        f = [engine.take(_exact(e)) for e in model.force]
        f_q, f_v = (_slopes(engine, f, symbols, almost=True) for symbols in (q, v))
        functions.append(Function("force", {"f": f, "f_q": f_q, "f_v": f_v}, engine))
    for name, output, expressions in (
        ("state", "x", model.state),
        ("exact", "x", model.exact),
        ("invariant", "values", model.invariants),
    ):
        if expressions:
            functions.append(Function(name, {output: expressions}, SymPy))
    # by what is in it: the derivative of a dry friction, sign(v), is 0 too
    positional = model.force is not None and not any(
        e.free_symbols & {*model.v} for e in model.force
    )
    derived = Derived(kind, mass, tuple(functions), positional)
    if derived.has_momenta:
        functions.append(_balance(model, derived))
    elif positional:
        functions.append(_pull(model, derived))
    return dataclasses.replace(derived, functions=tuple(functions))


def _jet(derived: Derived, engine: Any, name: str, *outputs: str) -> list[list[Expr]]:
    """Return outputs of a function for another engine; empty if the model does not have it."""
    return [_of_each(engine.take, derived.expressions(name, output)) for output in outputs]


def _balance(model: Model, derived: Derived) -> Function:
    """Return L_v, F = L_q + f, and their derivatives, as ``dal_balance_fn`` of kernel.h."""
    n, zero = model.n, sympy.Integer(0)
    engine = engine_for([_exact(e) for e in (model.L, *(model.force or ()))])
    f, f_q, f_v = _jet(derived, engine, "force", "f", "f_q", "f_v")
    none = [engine.take(zero)] * n * n
    if derived.mass is None:
        L_v, F, L_vq, L_vv, F_q = _jet(
            derived, engine, "lagrangian", "L_v", "L_q", "L_vq", "L_vv", "L_qq"
        )
        F_v = [L_vq[j * n + i] for i in range(n) for j in range(n)]
    else:
        L_vv, L_vq, F_v = _of_each(engine.take, derived.mass), none, none
        v = [*map(engine.take, model.v)]
        rows = [L_vv[i * n : (i + 1) * n] for i in range(n)]
        L_v = [sum((e * x for e, x in zip(row, v) if e != 0), engine.take(zero)) for row in rows]
        V_q, V_qq = _jet(derived, engine, "potential", "V_q", "V_qq")
        F, F_q = [-e for e in V_q] or none[:n], [-e for e in V_qq] or none
    if f:
        F, F_q, F_v = (
            [a + b for a, b in zip(*x)] for x in ((F, f), (F_q, f_q), (F_v, f_v))
        )
    outputs = {"L_v": L_v, "F": F, "L_vq": L_vq, "L_vv": L_vv, "F_q": F_q, "F_v": F_v}
    return Function("balance", outputs, engine)


def _pull(model: Model, derived: Derived) -> Function:
    """Return V_q - f of a force that does not depend on v."""
    engine = engine_for([_exact(e) for e in (model.L, *(model.force or ()))])
    (f,), (V_q,) = (
        _jet(derived, engine, *x) for x in (("force", "f"), ("potential", "V_q"))
    )
    return Function("pull", {"V_q": [a - b for a, b in zip(V_q, f)] if V_q else [-e for e in f]},
                    engine)


def _terms(model: Model, derived: Derived) -> Function:
    """Return F, mu and g of field.h, M unless it is constant, and C if it is constant."""
    n, m = model.n, model.m
    engine = engine_for([_exact(e) for e in (model.L, *model.constraints, *(model.force or ()))])
    v, none = [*map(engine.take, model.v)], [engine.take(sympy.Integer(0))] * n

    def along(matrix: list[Expr], rows: int) -> list[Expr]:
        entries = [matrix[i * n : (i + 1) * n] for i in range(rows)]
        return [sum((e * x for e, x in zip(row, v) if e != 0), none[0]) for row in entries]

    (f,) = _jet(derived, engine, "force", "f")
    outputs: dict[str, Sequence[Expr]] = {}
    if derived.mass is None:
        L_q, L_vq, outputs["M"] = _jet(derived, engine, "lagrangian", "L_q", "L_vq", "L_vv")
        F = [a - b for a, b in zip(L_q, along(L_vq, n))]
        if model.is_time_dependent:
            F = [a - b for a, b in zip(F, *_jet(derived, engine, "lagrangian", "L_vt"))]
    else:
        (V_q,) = _jet(derived, engine, "potential", "V_q")
        F = [-e for e in V_q] or none
    outputs["F"] = [a + b for a, b in zip(F, f)] if f else F
    if m > 0:
        outputs["mu"], phi_q = _jet(derived, engine, "constraint", "phi_v", "phi_q")
        outputs["g"] = along(phi_q, m)
        if model.is_time_dependent:
            (phi_t,) = _jet(derived, engine, "constraint", "phi_t")
            outputs["g"] = [a + b for a, b in zip(outputs["g"], phi_t)]
        if C := _constant_gram(model, derived):
            outputs["C"] = _of_each(engine.take, C)
    return Function("terms", outputs, engine)


def _constant_gram(model: Model, derived: Derived) -> list[Expr] | None:
    """Return C = mu M^-1 mu^T if M is diagonal and C is the same everywhere, as for a blade."""
    n, m, M = model.n, model.m, derived.mass
    if M is None or any(M[i * n + j] != 0 for i in range(n) for j in range(n) if i != j):
        return None
    mu = derived.expressions("constraint", "phi_v")
    there = dict.fromkeys(model.q, sympy.Integer(0))
    found = []
    for a, b in itertools.product(range(m), repeat=2):
        terms = (mu[a * n + i] * mu[b * n + i] / M[i * n + i] for i in range(n))
        entry = sympy.Add(*terms)
        constant = entry.xreplace(there)
        if not (constant.free_symbols <= {*model.p} and is_zero(entry - constant)):
            return None
        found.append(constant)
    return found


def _slopes(
    engine: Any, expressions: Iterable[Expr], symbols: Iterable[Expr], almost: bool = False
) -> list[Expr]:
    """Return the derivatives of expressions by symbols, row by row; see `_as_function`."""
    symbols, zero = [*map(engine.take, symbols)], engine.take(sympy.Integer(0))
    slopes = [engine.gradient(e, symbols, almost) for e in expressions]
    return [row.get(x, zero) for row in slopes for x in symbols]


def _energy(
    model: Model, engine: Any, lagrangian: Expr
) -> tuple[tuple[Expr, ...] | None, list[Function]]:
    """Return M and the functions of mass and potential; or None and that of the Lagrangian."""
    q, v = model.q, model.v
    L = [engine.take(lagrangian)]
    L_v = _slopes(engine, L, v)
    L_vv = _symmetric(engine, L_v, v)
    for i, name in enumerate(model.coordinates):
        if all(e == 0 for e in L_vv[i * model.n : (i + 1) * model.n]):
            raise ValueError(
                f"L contains {model.shown(v[i])} not at all or only linearly, so {name} has "
                f"no mass; expected a kinetic energy of {name}, such as "
                f"m*{model.shown(v[i])}**2/2, in velocities, not in generalized speeds"
            )
    mass, potential = _constant_mass(model, engine, lagrangian, L_v, L_vv)
    if mass is None:
        L_q = _slopes(engine, L, q)
        L_qq, L_vq = _symmetric(engine, L_q, q, almost=True), _slopes(engine, L_v, q)
        outputs = {"L": L, "L_q": L_q, "L_v": L_v, "L_qq": L_qq, "L_vq": L_vq, "L_vv": L_vv}
        if model.is_time_dependent:
            outputs["L_vt"] = _slopes(engine, L_v, [TIME])
        return None, [Function("lagrangian", outputs, engine)]
    functions = [Function("mass", {"M": mass}, SymPy)]
    if not is_zero(potential):
        V = [engine.take(potential)]
        V_q = _slopes(engine, V, q)
        outputs = {"V": V, "V_q": V_q, "V_qq": _symmetric(engine, V_q, q, almost=True)}
        functions.insert(0, Function("potential", outputs, engine))
    return mass, functions


def _exact(e: Expr) -> Expr:
    """Return an expression in the form that is differentiated.

    Doubles become rational numbers, without rounding.  Functions that SymPy differentiates only for
    real arguments are replaced by equivalent ones.
    """
    e = e.xreplace({x: sympy.Rational(x) for x in e.atoms(sympy.Float)})
    unsure = {x for x in e.atoms(sympy.Abs, sympy.sign) if not x.args[0].is_extended_real}
    if unsure:
        e = e.replace(
            lambda x: x in unsure and x.func == sympy.Abs,
            lambda x: sympy.Max(x.args[0], -x.args[0]),
        )
        e = e.replace(lambda x: x in unsure, lambda x: 2 * sympy.Heaviside(x.args[0]) - 1)
    return e


def _symmetric(
    engine: Any, gradient: Sequence[Expr], x: Sequence[Expr], almost: bool = False
) -> list[Expr]:
    """Return the matrix of second derivatives; those below the diagonal are copied from above."""
    x, zero = [*map(engine.take, x)], engine.take(sympy.Integer(0))
    upper = [engine.gradient(e, x[i:], almost) for i, e in enumerate(gradient)]
    return [
        upper[min(i, j)].get(x[max(i, j)], zero) for i in range(len(x)) for j in range(len(x))
    ]


def _without(engine: Any, expressions: Iterable[Expr], values: Rule) -> list[Expr]:
    """Return expressions with some symbols replaced by numbers."""
    if engine is SymPy:
        return _of_each(lambda e: e.xreplace(values), expressions)
    taken = {engine.take(s): engine.take(x) for s, x in values.items()}
    return _of_each(lambda e: engine.take(e).subs(taken), expressions)


def _are_without(slopes: Iterable[Expr], e: Expr, symbols: Collection[Expr]) -> bool:
    """Return whether derivatives of e are independent of symbols, by inspection without proof.

    The symbols must occur neither in the derivatives nor in a piecewise function in e.
    """
    parts = (*slopes, *e.atoms(*PIECES))
    return not any(part.free_symbols.intersection(symbols) for part in parts)


def _constant_mass(
    model: Model, engine: Any, L: Expr, L_v: Sequence[Expr], L_vv: Sequence[Expr]
) -> tuple[tuple[Expr, ...] | None, Expr]:
    """Return M if it is proved that L = v^T M v / 2 - V(q) with a constant M, else None; and V."""
    rest = dict.fromkeys(model.v, sympy.Integer(0))
    origin = rest | dict.fromkeys((*model.q, TIME), sympy.Integer(0))
    given = _of_each(engine.give, L_vv)
    M = tuple(_of_each(lambda e: e.xreplace(origin), given))  # if it is the same everywhere
    V = -L.xreplace(rest)
    if not all(e == c or is_zero(e - c) for e, c in zip(given, M)):
        return None, V  # which the whole would tell, but later
    if _are_without(given, L, model.v):  # then L = v^T M v / 2 + b(q) v - V(q)
        b = (engine.give(e).xreplace(rest) for e in L_v)
        return M if all(map(is_zero, b)) else None, V
    pairs = itertools.product(model.v, repeat=2)
    kinetic = sympy.Add(*(e * (a * b / 2) for e, (a, b) in zip(M, pairs) if e != 0))
    return M if is_zero(L + V - kinetic) else None, V


def _kind(
    model: Model, engine: Any, phi: Sequence[Expr], phi_v: list[Expr]
) -> tuple[str, list[Expr]]:
    """Return the kind of the constraints, and phi_v without v unless they are nonlinear.

    Constraints are affine if phi = mu(q) v + a(q) is evident or proved, and linear if a is proved
    to be zero.
    """
    n, rest = model.n, dict.fromkeys(model.v, sympy.Integer(0))
    given = _of_each(engine.give, phi_v)
    mu = _of_each(lambda e: e.xreplace(rest), given)
    shift = [e.xreplace(rest) for e in phi]
    rows = [slice(a * n, (a + 1) * n) for a in range(model.m)]
    affine = all(
        _are_without(given[row], e, model.v)
        or is_zero(e - b - sympy.Add(*(c * x for c, x in zip(mu[row], model.v) if c != 0)))
        for e, b, row in zip(phi, shift, rows)
    )
    for a, row in enumerate(rows):
        if all(map(is_zero, (mu if affine else given)[row])):
            shown = f"constraints[{a}] = {model.shown(model.constraints[a])}"
            if is_zero(engine.give(phi[a])):
                raise ValueError(
                    f"{shown}: it is 0 for all velocities, so it constrains nothing; remove it"
                )
            raise ValueError(
                f"{shown}: expected an expression with a velocity; for a constraint on the "
                "coordinates alone give its time derivative here, and the constraint itself "
                "in positions="
            )
    if not affine:
        return "nonlinear", phi_v
    phi_v = _without(engine, phi_v, rest)
    return "linear" if all(map(is_zero, shift)) else "affine", phi_v
