"""Models: a Lagrangian and constraints as SymPy expressions, and derived functions.

All expressions use canonical symbols, ``q0 ... v0 ... p0 ... t``.  The user's names are never part
of a generated program, and models that differ in names alone are compiled once.  Nothing is
simplified and no matrix is inverted, because both can take minutes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import itertools
import math
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import sympy
from sympy.core.function import AppliedUndef
from sympy.logic.boolalg import Boolean

try:
    import symengine
except ImportError:
    symengine = None

from . import formula
from .zeros import PIECES, is_zero, of_sympy

Expr = Any  # sympy has no types
Rule = dict[Expr, Expr]


# ---- symbols ---------------------------------------------------------------------------------


class _Called(sympy.Symbol):
    """A symbol with the names of the call of `dalembert.coordinates` that created it.

    The names are part of the symbol.  So the order of coordinates follows from the expressions of a
    system, independent of other calls.
    """

    __slots__ = ("call",)

    def __new__(cls, name: str, call: tuple[str, ...] = ()) -> Any:
        made = sympy.Symbol.__xnew__(cls, name, real=True)
        made.call = call or (name,)
        return made

    def __getnewargs_ex__(self) -> tuple[Any, ...]:
        return (self.name, self.call), {}

    def _hashable_content(self) -> tuple[Any, ...]:
        return (*super()._hashable_content(), self.call)


class Velocity(_Called):
    """The velocity ``x.d`` of a coordinate."""

    __slots__ = ()

    @property
    def coordinate(self) -> Coordinate:
        """The coordinate of this velocity."""
        return Coordinate(self.name.removesuffix(".d"), self.call)

    def _latex(self, printer: Any) -> str:
        return rf"\dot{{{printer._print(sympy.Symbol(self.coordinate.name))}}}"


class Coordinate(_Called):
    """A coordinate: a SymPy symbol with its velocity `d`, from `dalembert.coordinates`."""

    __slots__ = ()

    @property
    def d(self) -> Velocity:
        """The velocity of the coordinate, a symbol too."""
        return Velocity(f"{self.name}.d", self.call)

    def diff(self, *symbols: Any, **assumptions: Any) -> Expr:
        """Return a derivative; raise ValueError for the time derivative, for SymPy it is 0."""
        if any(str(s) == "t" and not isinstance(s, Coordinate) for s in symbols):
            raise ValueError(f"{self.name}.diff(t): write {self.name}.d for the velocity")
        return super().diff(*symbols, **assumptions)


# When a call of `dalembert.coordinates` with these names was made first, and when last.
_made: dict[tuple[str, ...], tuple[int, int]] = {}
_numbers = itertools.count()


def make_coordinates(names: Sequence[str]) -> tuple[Coordinate, ...]:
    """Return a coordinate for each name."""
    call, now = tuple(names), next(_numbers)
    _made[call] = _made.get(call, (now, now))[0], now
    return tuple(Coordinate(name, call) for name in names)


def in_order(found: Iterable[Coordinate]) -> list[Coordinate]:
    """Return coordinates in the order of their names in calls, and of the calls.

    Raises
    ------
    ValueError
        If the calls contradict each other, or the order of their first and last execution differs.
    """
    by_name = {x.name: x for x in found}
    calls = {x.call for x in found}
    whole = [call for call in calls if by_name.keys() <= {*call}]
    several = sorted(whole or calls, key=lambda call: _made.get(call, (-1, -1))[0])
    order = list(dict.fromkeys(name for call in several for name in call if name in by_name))
    last = [_made.get(call, (-1, -1))[1] for call in several]
    if (not whole and (last != sorted(last) or -1 in last)) or any(
        [name for name in order if name in call] != [name for name in call if name in by_name]
        for call in calls
    ):
        shown = " and ".join(f"dalembert.coordinates({' '.join(c)!r})" for c in sorted(calls))
        raise ValueError(
            f"coordinates is missing: the order of {', '.join(sorted(order))} is ambiguous, "
            f"because their symbols are of {shown}"
        )
    return [by_name[name] for name in order]


@functools.cache
def canonical(letter: str, count: int) -> tuple[Expr, ...]:
    """Return the symbols letter0, letter1, ..."""
    return tuple(sympy.Symbol(f"{letter}{i}", real=True) for i in range(count))


TIME = sympy.Symbol("t", real=True)


class Time(sympy.Symbol):
    """The time in user's expressions, `dalembert.time`; no other symbol is equal to it."""

    __slots__ = ()

    def __new__(cls) -> Any:
        return sympy.Symbol.__xnew__(cls, TIME.name, real=True)

    def __getnewargs_ex__(self) -> tuple[Any, ...]:
        return (), {}


# ---- jumps -----------------------------------------------------------------------------------


class _Jump(Exception):
    """A derivative that needs a DiracDelta of args[1], by the symbol args[0]."""


def _gradient(e: Expr, symbols: Collection[Expr]) -> Rule:
    """Return the derivatives of an expression by those symbols that occur in it.

    The results are those of ``sympy.diff``, which would traverse all terms of all sums for each
    symbol.
    """
    if not e.is_Add and not e.is_Mul:
        e = e.replace(_is_parametric, lambda power: _Power(*power.args))
        found = {s: sympy.diff(e, s) for s in e.free_symbols if s in symbols}
        return {s: slope.replace(_Power, sympy.Pow) for s, slope in found.items()}
    slopes: dict[Expr, list[Expr]] = {}
    for i, part in enumerate(e.args):
        for s, slope in _gradient(part, symbols).items():
            slopes.setdefault(s, []).append(
                slope if e.is_Add else sympy.Mul(*e.args[:i], slope, *e.args[i + 1 :])
            )
    return {s: sympy.Add(*found) for s, found in slopes.items()}


class _Power(sympy.Function):
    """x^n with a parameter n; SymPy's derivative n x^n / x is 0/0 at x = 0."""

    def fdiff(self, argindex: int = 1) -> Expr:
        x, n = self.args
        return sympy.Piecewise((0, sympy.Eq(n, 0)), (n * _Power(x, n - 1), True))


def _is_parametric(e: Expr) -> bool:
    """Return whether an expression is a power whose exponent is constant but not rational."""
    return bool(e.is_Pow and not e.exp.is_Rational and not e.base.is_number and _is_constant(e.exp))


def _as_function(found: Expr, symbol: Expr, almost: bool) -> Expr:
    """Return a derivative by a symbol as a function.

    A DiracDelta is dropped if its factor vanishes with its argument, as in the derivative of x^2
    sign(x).  If `almost`, it is always dropped, for a derivative that may be wrong at jumps.
    """
    for delta in found.atoms(sympy.DiracDelta):
        mark = sympy.Dummy(real=True)
        marked = found.xreplace({delta: mark})
        if not almost and not _is_without_jump(marked.diff(mark), delta.args[0], symbol):
            raise _Jump(symbol, delta.args[0])
        found = marked.xreplace({mark: sympy.Integer(0)})
    return found.replace(_is_inverse, _bounded) if almost else found


def _is_inverse(e: Expr) -> bool:
    """Return whether a power may be infinite on one side of a wall, as 1/sqrt(Max(0, x))."""
    return e.is_Pow and not e.exp.is_nonnegative and e.base.has(sympy.Max, sympy.Min, sympy.Abs)


def _bounded(e: Expr) -> Expr:
    """Return a power that is 1 if its base is 0, so that a step function as factor makes it 0."""
    return sympy.Piecewise((e.base, sympy.Ne(e.base, 0)), (1, True)) ** e.exp


def _is_without_jump(factor: Expr, argument: Expr, symbol: Expr) -> bool:
    """Return whether a factor is proved to vanish with the argument of its DiracDelta.

    The jump is the factor divided by the slope of the argument: sign(x^3) jumps although 3 x^2
    vanishes.
    """
    if _vanishes_with(factor, argument):
        return True
    slope = argument.diff(symbol)
    terms = map(sympy.factor_terms, sympy.Add.make_args(factor))
    height = sympy.Add(*(term / sympy.factor_terms(slope) for term in terms))
    return all(_vanishes_with(height, part) for part in _zero_with(argument))


_Step = sympy.Function("_Step")


def _vanishes_with(factor: Expr, argument: Expr) -> bool:
    """Return whether a factor is proved to vanish with an argument.

    A step function may have any value at its jump: sign(x)^3 is 0 at 0 and yet jumps.
    """
    factor = factor.replace(sympy.sign, lambda u: 2 * _Step(u) - 1)
    factor = factor.replace(sympy.Heaviside, lambda u, _: _Step(u))
    places = [factor.subs(argument, 0).subs(-argument, 0)]
    for s in argument.free_symbols:
        slope = argument.diff(s)
        if slope != 0 and _is_constant(slope):
            places.append(factor.xreplace({s: sympy.expand(s - argument / slope)}))
    return any(
        is_zero(e.replace(_Step, lambda u: sympy.Heaviside(u) if u.is_nonzero else _Step(u)))
        for e in places
    )


def _zero_with(e: Expr) -> list[Expr]:
    """Return expressions such that one of them is 0 wherever e is 0."""
    if e.is_Mul:
        return [part for factor in e.args for part in _zero_with(factor)]
    if e.is_Pow and e.exp.is_positive:
        return _zero_with(e.base)
    if isinstance(e, _ONE_ZERO):
        return _zero_with(e.args[0])
    return [] if e.is_nonzero or _is_constant(e) else [e]


# Real functions that are 0 at 0 alone.
_ONE_ZERO = of_sympy("Abs sinh tanh asinh asin atan erf")


def _is_constant(e: Expr) -> bool:
    """Return whether an expression has no symbols except parameters, and so counts as nonzero."""
    return all(s.name[0] == "p" for s in e.free_symbols)


@contextlib.contextmanager
def _naming(model: Model, where: str) -> Iterator[None]:
    """Add the user's names to errors about jumps."""
    try:
        yield
    except _Jump as jump:
        x, argument = map(model.shown, jump.args)
        raise ValueError(
            f"{where}: its derivative by {x} needs DiracDelta({argument}), because it jumps "
            f"where {argument} = 0. Write a Piecewise, whose jumps exert no force, or a "
            "smooth step of width w, such as (1 + tanh(x/w))/2 for Heaviside(x)"
        ) from None


# ---- two ways to differentiate ---------------------------------------------------------------


# What SymEngine differentiates as SymPy does; for the rest it lacks assumptions or rules.
_SMOOTH = of_sympy(
    "Add Mul Pow Symbol Number NumberSymbol exp log sin cos tan asin acos atan sinh cosh tanh"
)


class _SymPy:
    """Derivatives, by the symbols that occur, and common subexpressions, with SymPy."""

    name = f"sympy {sympy.__version__}"

    @staticmethod
    def take(expression: Expr) -> Expr:
        return expression

    give = take

    @staticmethod
    def gradient(expression: Expr, symbols: Sequence[Expr], almost: bool = False) -> Rule:
        slopes = _gradient(expression, {*symbols})
        return {x: _as_function(slopes[x], x, almost) for x in symbols if x in slopes}

    @staticmethod
    def cse(expressions: list[Expr]) -> tuple[list[tuple[Expr, Expr]], list[Expr]]:
        found, reduced = sympy.cse(
            expressions, sympy.numbered_symbols("x"), order="none", list=False
        )
        conditions: Rule = {}  # what is no number stays where it is
        temporaries = []
        for symbol, e in found:
            e = e.xreplace(conditions)
            if isinstance(e, Boolean) and not e.is_Symbol:
                conditions[symbol] = e
            else:
                temporaries.append((symbol, e))
        return temporaries, [e.xreplace(conditions) for e in reduced]


class _SymEngine:
    """The same with SymEngine, 60 to 80 times faster."""

    name = f"symengine {getattr(symengine, '__version__', '')}"

    @staticmethod
    def take(expression: Expr) -> Expr:
        return symengine.sympify(expression)

    @staticmethod
    def gradient(expression: Expr, symbols: Sequence[Expr], almost: bool = False) -> Rule:
        occurring = expression.free_symbols  # and what is smooth has no jumps
        return {x: symengine.diff(expression, x) for x in symbols if x in occurring}

    @staticmethod
    def cse(expressions: list[Expr]) -> tuple[list[tuple[Expr, Expr]], list[Expr]]:
        return symengine.cse(expressions)

    @staticmethod
    def give(expression: Expr) -> Expr:
        found = sympy.sympify(expression)
        # SymEngine's symbols have no assumptions; only those of the model have any.
        return found.xreplace({s: sympy.Symbol(s.name, real=True) for s in found.free_symbols})


def engine_for(expressions: Iterable[Expr]) -> Any:
    """Return the fastest installed engine that supports the expressions."""
    return _SymEngine if symengine is not None and _are_smooth(expressions) else _SymPy


def _are_smooth(expressions: Iterable[Expr]) -> bool:
    """Return whether all functions in the expressions are smooth."""
    seen: set[Expr] = set()
    left = list(expressions)
    while left:
        e = left.pop()
        if e not in seen:
            if not isinstance(e, _SMOOTH) or _is_parametric(e):
                return False
            seen.add(e)
            left += e.args
    return True


def default_engine() -> str:
    """Return the name and version of the engine for smooth models."""
    return _SymPy.name if symengine is None else _SymEngine.name


# ---- the model -------------------------------------------------------------------------------


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
        return _latex(self)


def _structure(e: Expr) -> str:
    """Return a text that two expressions share only if they are equal.

    ``srepr`` does the same, but sorts again and takes ten times as long.
    """
    if not e.args:
        return str(sympy.srepr(e))
    return f"{type(e).__name__}({', '.join(map(_structure, e.args))})"


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
            functions.append(Function(name, {output: expressions}, _SymPy))
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
    functions = [Function("mass", {"M": mass}, _SymPy)]
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


def in_doubles(e: Expr, digits: int = 15) -> Expr:
    """Return an expression whose long numbers are replaced by doubles of so many digits."""
    return e.xreplace({
        x: sympy.Float(nearest(x), digits) for x in e.atoms(sympy.Rational, sympy.Float)
        if x.is_Float or max(abs(x.p), x.q) >= 2**53
    })  # fmt: skip


def nearest(x: Expr, where: str = "") -> float:
    """Return the double nearest to a number; raise ValueError if it is out of range."""
    try:
        found = x.p / x.q if x.is_Rational else float(x)
    except OverflowError:
        found = math.inf
    if math.isinf(found) or (x != 0 and abs(found) < sys.float_info.min):
        size = "large" if math.isinf(found) else "small"
        raise ValueError(f"{where}{': ' * bool(where)}{sympy.N(x, 5)} is too {size} for a double")
    return found


def with_default(e: Expr) -> Expr:
    """Return an expression for `lambdify`: a Piecewise without a default becomes NaN there."""
    return e.replace(
        lambda part: isinstance(part, sympy.Piecewise) and part.args[-1].cond != sympy.true,
        lambda part: part.func(*part.args, (sympy.nan, True)),
    )


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
    if engine is _SymPy:
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


# ---- LaTeX -----------------------------------------------------------------------------------


def _latex_symbol(name: str) -> str:
    """Return a name as LaTeX; an unusual one letter by letter, so that it cannot be a command."""
    if name.replace("_", "").isalnum() and name.isascii():
        return str(sympy.latex(sympy.Symbol(name)))
    safe = "".join(c if c.isalnum() else " " for c in name)
    return rf"\mathtt{{{safe}}}"


def _latex(model: Model) -> str:
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


# ---- what may occur in a model ---------------------------------------------------------------


# Functions that both C and the math module have, or that are printed by their definition.
FUNCTIONS = {getattr(sympy, x): x for x in formula.FUNCTIONS if x not in ("Abs", "sqrt")}
FUNCTIONS[sympy.Abs] = "fabs"

_STRUCTURE = (
    *of_sympy(
        "Add Mul Pow Symbol Rational Float NumberSymbol sec csc cot sign Heaviside Max Min "
        "Piecewise Rel And Or Not"
    ),
    sympy.functions.elementary.piecewise.ExprCondPair,
    sympy.logic.boolalg.BooleanAtom,
)


def require_known(
    expression: Expr, where: str, shown: Callable[[Expr], Expr] = lambda e: e
) -> None:
    """Raise ValueError if an expression has a part that cannot be compiled."""
    for e in sympy.preorder_traversal(expression):
        if isinstance(e, (*_STRUCTURE, *FUNCTIONS)):
            if isinstance(e, sympy.Float | sympy.Rational):
                nearest(e, where)
            continue
        if isinstance(e, AppliedUndef):
            hint = "write its formula instead"
            if [str(x) for x in e.args] == [TIME.name]:
                hint = (
                    "list a coordinate in coordinates=, and an input of a force or a "
                    "constraint in inputs=. Replace a generalized speed by velocities, with "
                    f"its kinematic differential equation, for example by .subs({shown(e)}, "
                    "...)"
                )
            raise ValueError(f"{where}: {shown(e)} is an unknown function; {hint}")
        names = {f.__name__ for f in (*FUNCTIONS, *_STRUCTURE) if issubclass(f, sympy.Function)}
        raise ValueError(
            f"{where}: {shown(e)} ({type(e).__name__}) cannot be compiled; expected "
            "expressions of "
            f"{', '.join(sorted({*names, 'sqrt', 'Max', 'Min', 'And', 'Or', 'Not'}))}"
        )
