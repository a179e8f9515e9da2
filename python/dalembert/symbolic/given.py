"""Conversion of the user's formulas to a `model.Model`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from sympy.core.function import AppliedUndef

from ..core import arguments
from .functions import require_known
from .model import Model
from .printing import function
from .symbols import (
    TIME, Canonical, Coordinate, Rule, Time, Velocity, canonical, in_order, make_coordinates,
)  # fmt: skip
from .zeros import PIECES, is_zero

Expr = Any


def named(names: str | Sequence[str]) -> tuple[Any, ...]:
    """Return coordinates, see `dalembert.coordinates`."""
    if isinstance(names, str):
        try:
            words = [s.name for s in sympy.symbols(names, seq=True)] if names.strip() else []
        except ValueError as error:
            raise ValueError(f"names = {names!r}: {error}") from None
    else:
        words = _several(names, "names")
    for word in words:
        arguments.text(word, "names")
    if not words or len(set(words)) != len(words):
        raise ValueError(f"names = {names!r}: expected at least one name, all different")
    return make_coordinates(words)


# ---- what was given ----------------------------------------------------------------------------


def take(
    *given: Any,
    force: Any,
    inputs: Any,
    q0: Any,
    v0: Any,
    exact: Any,
    invariants: Mapping[str, Any] | None,
    positions: Any = (),
) -> dict[str, Any]:
    """Return the model, the values of its parameters, and arguments that are numbers or functions.

    For invariants that are expressions the function is None.
    """
    state = None if q0 is None and v0 is None else initial_data(q0, v0)
    named = arguments.mapping(invariants, "invariants")
    by_expressions = is_expressions(exact)
    model, values = make_model(
        *given,
        force,
        state,
        exact if by_expressions else None,
        {key: e for key, e in named.items() if is_expressions(e)},
        inputs,
        positions,
    )
    return {
        "model": model,
        "values": values,
        "state": None if state is None or model.state is not None else _numbers(state),
        "exact": None if by_expressions else exact,
        "invariants": {key: None if is_expressions(e) else e for key, e in named.items()},
    }


def make_model(
    L: Expr,
    constraints: Any,
    coordinates: Iterable[Any] | None,
    parameters: Mapping[Any, Any] | None,
    force: Any = None,
    state: Mapping[str, list[Any]] | None = None,
    exact: Any = None,
    invariants: Mapping[str, Any] | None = None,
    inputs: Iterable[Any] = (),
    positions: Any = (),
) -> tuple[Model, dict[str, float]]:
    """Return the model and the values of its parameters; ValueError for unknown symbols."""
    L = _expression(L, "L")
    given = _constraints(constraints)
    forces = None if force is None else _force(force) or None
    pairs = _pairs(coordinates, L, [*_flat(given), *(forces or {}).values(),
                                           *(x for x in forces or {} if isinstance(x, sympy.Expr))])
    n = len(pairs)
    names = [name for name, _, _ in pairs]
    if n == 0:
        raise ValueError("coordinates is missing: L contains none")
    if len(set(names)) != n:
        raise ValueError(f"coordinates = {names}: expected different names")
    symbols_of = [str(s) for _, *both in pairs for s in both]
    if twice := [s for s in symbols_of if symbols_of.count(s) > 1]:
        raise ValueError(
            f"coordinates: {twice[0]} stands for two of the coordinates and velocities; "
            "expected a different symbol for each"
        )
    values, symbols = _parameters(parameters)
    taken = {*names, *symbols_of}
    if both := sorted(values.keys() & taken):
        raise ValueError(
            f"parameters: {both[0]} is a coordinate or a velocity; expected another name"
        )
    acting = input_symbols(inputs)
    if both := sorted(acting.keys() & (taken | values.keys())):
        raise ValueError(
            f"inputs: {both[0]} is also the name of a coordinate, a velocity or a parameter; "
            "expected another name"
        )
    translate = Translation(pairs, values, symbols, acting)
    lagrangian = _without_time(translate(L, "L", translate.clock))
    phi = [_without_time(translate.constraint(a, one)) for a, one in enumerate(given)]
    if len(phi) > n:
        raise ValueError(f"constraints: {len(phi)} on {n} coordinates; expected at most {n}")
    components = None if forces is None else translate.force(forces)
    for key, u in zip(acting, translate.inputs.values()):
        if not any(u in e.free_symbols for e in (*(components or ()), *phi)):
            raise ValueError(
                f"inputs: {key} has no effect, because neither the force nor a constraint "
                "depends on it; remove it"
            )
    start = None if state is None else _expressions_of(state, names, translate)
    for e in start or ():
        if e.free_symbols - set(translate.rule.values()):
            raise ValueError(f"(q0, v0): {e}: expected numbers, or expressions of parameters")
    timed = any(TIME in e.free_symbols for e in (lagrangian, *phi))
    model = Model(
        coordinates=tuple(names),
        parameters=tuple(values),
        L=lagrangian,
        constraints=tuple(phi),
        force=components,
        state=start,
        exact=None if exact is None else translate.several(exact, "exact", translate.any_clock),
        invariants=tuple(
            translate(_expression(e, key), f"invariants[{key!r}]", translate.clock if timed else {})
            for key, e in (invariants or {}).items()
        ),
        assumptions=tuple(_assumed({key, *translate.used[key.name]}) for key in symbols),
        inputs=tuple(acting),
        positions=tuple(_positions(positions, translate)),
    )
    _require_derivatives(model, list(values.values()))
    return model, values


def _positions(given: Any, translate: Translation) -> Iterator[Expr]:
    """Yield the constraints on coordinates alone, in canonical symbols."""
    for k, one in enumerate(_constraints(given, "positions")):
        where = f"positions[{k}]"
        if isinstance(one, list):
            raise ValueError(f"{where}: expected an expression that vanishes, not coefficients")
        found = translate(one, where, translate.clock)
        if not found.free_symbols & {*translate.q}:
            raise ValueError(f"{where} = {one}: expected an expression with a coordinate")
        if found.free_symbols & {*translate.v}:
            raise ValueError(
                f"{where} = {one}: expected an expression of the coordinates, without a velocity"
            )
        yield found


def _require_derivatives(model: Model, values: list[float]) -> None:
    """Raise ValueError unless the time derivatives of the positions are among the constraints.

    The test uses general states and constraints phi = mu v + a; nonlinear constraints are not
    tested.
    """
    n, m, k, source = model.n, model.m, len(model.positions), np.random.default_rng(1)
    if k == 0:
        return
    rates = [sympy.diff(e, TIME) for e in model.positions]
    slopes = [sympy.diff(e, x) for e in model.constraints for x in model.v]
    state = {"t": TIME, "q": model.q, "v": model.v, "p": [*model.p, *model.u]}
    values = [*values, *source.uniform(0.2, 1.0, len(model.u))]
    at = function(state, [*rates, *model.constraints, *slopes])
    for scale in (1.0, -1.0, 10.0, -10.0, 0.1):
        t, q, v = 1.0, scale * source.uniform(0.2, 1.0, n), source.uniform(0.2, 1.0, n)
        found, other = (np.array(at(t, q, w, values)) for w in (v, 2.0 * v))
        G = np.reshape(model.at_positions(t, q, values[: len(model.p)])[k:], (k, n))
        if not np.isfinite([*found, *other, *G.flat]).all():
            continue  # outside of the domain
        mu = found[k + m :].reshape(m, n)
        if not np.allclose(found[k + m :], other[k + m :], rtol=1e-9, atol=1e-12):
            return
        rows = np.column_stack([mu, found[k : k + m] - mu @ v])
        wanted = np.column_stack([G, found[:k]])
        rest = wanted - np.linalg.lstsq(rows.T, wanted.T, rcond=None)[0].T @ rows
        for i in np.flatnonzero(abs(rest).max(axis=1) > 1e-8 * abs(wanted).max(axis=1)):
            raise ValueError(
                f"positions[{i}] = {model.shown(model.positions[i])}: its time derivative is "
                "not a combination of the constraints; add it to them"
            )
        return


class Translation:
    """Translation of the user's coordinates, velocities and parameters to canonical symbols.

    ``clock`` has the symbols of the time.  ``any_clock`` also has the symbol t if coordinates are
    not functions of it, because it may be a forgotten parameter.
    """

    def __init__(
        self,
        pairs: list[tuple[str, Expr, Expr]],
        values: dict[str, float],
        symbols: list[Expr],
        inputs: dict[str, Expr],
    ) -> None:
        n = len(pairs)
        self.names, positions, velocities = map(list, zip(*pairs))
        self.values = values
        self.q, self.v = canonical("q", n), canonical("v", n)
        self.rule = dict(zip(values, canonical("p", len(values))))
        self.used: dict[str, set[Expr]] = {symbol.name: set() for symbol in symbols}
        self.positions, self.velocities = positions, velocities
        self.inputs = dict(zip(inputs.values(), canonical("u", len(inputs))))
        self.states = dict(zip([*positions, *velocities], [*self.q, *self.v]))
        times = [q.args[0] for q in positions if not q.is_Symbol]
        self.clock: Rule = dict.fromkeys([Time(), *times[:1]], TIME)
        self.any_clock: Rule = self.clock if times else {**self.clock, _PLAIN_TIME: TIME}
        # symbols of the same name, of other calls of dalembert.coordinates
        called = Coordinate | Velocity
        self.same = {_kind_and_name(s): c for s, c in self.states.items() if isinstance(s, called)}

    def __call__(
        self, expression: Expr, where: str, clock: Rule | None = None, with_inputs: bool = False
    ) -> Expr:
        """Return an expression in canonical symbols; raise ValueError for unknown symbols.

        Without a clock the expression must not depend on time.
        """
        if with_inputs:
            _refuse_rates(expression, where, self.inputs)
            expression = expression.xreplace(self.inputs)
        elif acting := sorted(str(u) for u in self.inputs if expression.has(u)):
            raise ValueError(
                f"{where} contains the input {acting[0]}: only forces and constraints may "
                "depend on inputs"
            )
        if expression.has(sympy.Derivative):
            _refuse_rates(expression, where)
        named = {s: _kind_and_name(s) for s in expression.atoms(Coordinate, Velocity)}
        found = expression.xreplace({s: self.same[k] for s, k in named.items() if k in self.same})
        if found.has(sympy.Derivative):
            found = found.doit()
        unknown = {d for d in found.atoms(sympy.Derivative) if d not in self.velocities}
        if unknown:
            raise ValueError(f"{where}: {unknown.pop()} is not the velocity of a coordinate")
        # equal names, whatever the assumptions
        own = Canonical | Coordinate | Velocity | Time
        plain = {s: s.name for s in found.free_symbols if not isinstance(s, own)}
        matching = {s: self.rule[name] for s, name in plain.items() if name in self.rule}
        for symbol in matching:
            self.used[symbol.name].add(symbol)
            if len(self.used[symbol.name]) > 1:
                raise ValueError(
                    f"{where}: {symbol} is the name of two symbols, one of them "
                    f"{' and '.join(_assumed(self.used[symbol.name])) or 'not as the other'}; "
                    "expected one symbol for each parameter, or another name"
                )
        found = found.xreplace(self.states | matching)
        allowed = {*self.q, *self.v, *self.rule.values()}
        if clock:
            found = found.xreplace(clock)
            allowed.add(TIME)
        if with_inputs:
            allowed.update(self.inputs.values())
        names_of = {c: s for s, c in (self.states | matching).items()}
        require_known(found, where, lambda e: e.xreplace(names_of))
        left = found.free_symbols - allowed
        if left & (self.any_clock.keys() | {TIME}):
            hint = "for the time, write dalembert.time" if clock else "it may not depend on time"
            raise ValueError(f"{where}: unknown symbol t; {hint}")
        self.require_none(sorted(map(str, left)), where)
        return found

    def require_none(self, left: list[str], where: str) -> None:
        """Raise ValueError for unknown symbols."""
        if twins := [name for name in left if name.removesuffix(".d") in self.names]:
            raise ValueError(
                f"{where}: this {twins[0]} differs from the symbol of the coordinates; "
                "expected the one returned by dalembert.coordinates, or given in coordinates="
            )
        if left:
            raise ValueError(
                f"{where}: {', '.join(left)} is neither a coordinate ({', '.join(self.names)}) nor "
                f"a parameter ({', '.join(self.values) or 'there are none'})"
                + (", nor in inputs=" if where.startswith(("force", "constraints")) else "")
            )

    def constraint(self, a: int, given: Any) -> Expr:
        """Return the expression that vanishes; a form of n coefficients is applied to v."""
        where, n = f"constraints[{a}]", len(self.q)
        if not isinstance(given, list):
            return self(given, where, self.clock, True)
        if len(given) != n:
            raise ValueError(f"{where}: expected {n} coefficients, got {len(given)}")
        row = [self(c, where, self.clock, True) for c in given]
        for i, c in enumerate(row):
            if c.free_symbols & set(self.v):
                raise ValueError(
                    f"{where}: coefficient {i}, {given[i]}, contains a velocity. A list gives "
                    "the coefficients of a one-form mu(q), which are multiplied by the "
                    "velocities; for an equation, pass one expression"
                )
        return sympy.Add(*(c * v for c, v in zip(row, self.v)))

    def force(self, given: Rule) -> tuple[Expr, ...]:
        """Return the n components of a force."""
        components = dict.fromkeys(self.q, sympy.Integer(0))
        for key, expression in given.items():
            if key in self.names:
                key = self.positions[self.names.index(key)]
            position = self.states.get(key, self.same.get(_kind_and_name(key)))
            if position not in components:
                raise ValueError(f"force: {key} is not a coordinate ({', '.join(self.names)})")
            components[position] += self(
                expression, f"force[{key}]", self.any_clock, True
            )
        return tuple(components.values())

    def several(self, given: Any, name: str, clock: Rule | None = None) -> tuple[Expr, ...]:
        """Return the 2n components of a state."""
        found, count = [_expression(e, name) for e in _several(given, name)], 2 * len(self.q)
        if len(found) != count:
            raise ValueError(f"{name}: expected {count} expressions, got {len(found)}")
        return tuple(self(e, f"{name}[{i}]", clock) for i, e in enumerate(found))


_PLAIN_TIME = sympy.Symbol("t")


def _without_time(e: Expr) -> Expr:
    """Return an expression at t = 0 if it is proved to be independent of time."""
    if any(TIME in part.free_symbols for part in e.atoms(*PIECES)):
        return e
    still = e.xreplace({TIME: sympy.Integer(0)})
    return still if still != e and is_zero(e - still) else e


def _kind_and_name(symbol: Expr) -> tuple[type, str]:
    """Return the key of a coordinate or velocity that is the same in all calls."""
    return type(symbol), str(symbol)


def _refuse_rates(expression: Expr, where: str, inputs: Iterable[Expr] = ()) -> None:
    """Raise ValueError for Derivative(x, t) of a coordinate with velocity x.d, of a velocity, and
    of an input, which would be 0.
    """
    for rate in expression.atoms(sympy.Derivative):
        if not any(_is_time(s) and not isinstance(s, Velocity) for s in rate.variables):
            continue
        for x in sorted(rate.expr.atoms(Coordinate), key=str):
            raise ValueError(f"{where}: {rate}: write {x.d} for the velocity of {x}")
        if rate.has(Velocity):
            raise ValueError(f"{where}: {rate} is an acceleration; expected velocities at most")
        for u in filter(rate.has, inputs):
            raise ValueError(
                f"{where}: {rate} is the rate of the input {u}, which is unknown; make the rate "
                "an input too"
            )


def initial_data(q0: Any, v0: Any) -> dict[str, list[Any]]:
    """Return the elements of q0 and v0, by these names."""
    arguments.pair(q0, v0, ("q0", "v0"))
    state = {"q0": q0, "v0": v0}
    for name, given in state.items():
        if isinstance(given, str | bytes | Mapping) or not isinstance(given, Iterable):
            raise ValueError(
                f"{name} = {arguments.shown(given)}: expected a list of numbers, one for each "
                "coordinate"
            )
    return {name: list(given) for name, given in state.items()}


def _expressions_of(
    state: Mapping[str, list[Any]], names: list[str], translate: Translation
) -> tuple[Expr, ...] | None:
    """Return the 2n components of a state with expressions, None if all are numbers."""
    n = len(names)
    for name, given in state.items():
        if any(map(np.ndim, given)):
            raise ValueError(f"{name} has shape {arguments.shape(given)}: expected ({n},)")
        if len(given) != n:
            raise ValueError(
                f"{name} has {len(given)} number{'s' * (len(given) != 1)}: expected {n}, one for "
                f"each of {', '.join(names)}"
            )
    both = [*state["q0"], *state["v0"]]
    is_constant = not any(getattr(x, "free_symbols", None) for x in both)
    return None if is_constant else translate.several(both, "(q0, v0)")


def _numbers(state: Mapping[str, list[Any]]) -> np.ndarray:
    """Return the 2n components of a state of numbers."""
    return np.array(
        [
            arguments.parameter(x, f"{name}[{i}]")
            for name, given in state.items()
            for i, x in enumerate(given)
        ]
    )


def is_expressions(value: Any) -> bool:
    """Return whether a value consists of expressions, not of a function of the user."""
    return value is not None and (not callable(value) or hasattr(value, "free_symbols"))


def _expression(value: Any, name: str) -> Expr:
    """Return one expression."""
    if isinstance(value, str):
        raise ValueError(f"{name} = {value!r}: expected a SymPy expression, not a text")
    try:
        found = sympy.sympify(value)
    except (sympy.SympifyError, TypeError) as error:
        raise ValueError(f"{name} = {value!r}: expected a SymPy expression") from error
    if isinstance(found, sympy.MatrixBase) and found.shape == (1, 1):
        found = found[0]
    if not isinstance(found, sympy.Expr):
        raise ValueError(f"{name} = {value!r}: expected a SymPy expression")
    if wrong := found.atoms(*map(type, (sympy.nan, sympy.oo, -sympy.oo, sympy.zoo))):
        raise ValueError(f"{name} contains {wrong.pop()}: expected finite numbers")
    return found


def _constraints(given: Any, name: str = "constraints") -> list[Any]:
    """Return for each constraint an expression that vanishes, or a list of n coefficients."""
    if given is None:
        return []
    if isinstance(given, sympy.MatrixBase):
        if given.shape[1] > 1:  # one-forms
            rows = range(given.shape[0])
            return [[given[i, j] for j in range(given.shape[1])] for i in rows]
        given = list(given)
    if isinstance(given, sympy.Expr | sympy.Eq):
        given = [given]
    found: list[Any] = []
    for a, one in enumerate(_several(given, name)):
        where = f"{name}[{a}]"
        if isinstance(one, sympy.Eq):
            found.append(_expression(one.lhs - one.rhs, where))
        elif isinstance(one, list | tuple | sympy.Tuple | sympy.MatrixBase | np.ndarray):
            found.append([_expression(c, where) for c in one])
        elif one is True or one is False or one in (sympy.true, sympy.false):
            raise ValueError(f"{where} = {one}: expected an equation that depends on the state")
        else:
            found.append(_expression(one, where))
    return found


def _several(given: Any, name: str) -> list[Any]:
    """Return the elements of a sequence; raise ValueError for other values."""
    if isinstance(given, str | bytes) or not isinstance(given, Iterable):
        raise ValueError(f"{name} = {given!r}: expected a sequence")
    return list(given)


def _flat(given: Iterable[Any]) -> list[Expr]:
    return [e for one in given for e in (one if isinstance(one, list) else [one])]


def input_symbols(given: Any) -> dict[str, Expr]:
    """Return the symbols of the inputs, by their names."""
    found: dict[str, Expr] = {}
    for one in _several(given, "inputs"):
        is_function = isinstance(one, AppliedUndef) and len(one.args) == 1
        if isinstance(one, Time):
            raise ValueError("inputs: the time is known already; leave it out")
        if not is_function and not isinstance(one, sympy.Symbol):
            raise ValueError(f"inputs: {one!r}: expected a symbol or a dynamicsymbol")
        name = arguments.text(str(one.func) if is_function else one.name, "inputs")
        if name in found:
            raise ValueError(f"inputs: {name} occurs twice")
        found[name] = one
    return found


def _force(given: Any) -> Rule:
    """Return the given components of a force, by coordinate."""
    found = {}
    for key, value in arguments.mapping(given, "force").items():
        if not isinstance(key, sympy.Expr | str):
            raise ValueError(f"force: {key!r}: expected a coordinate as the key")
        found[key] = _expression(value, f"force[{key}]")
    return found


def _pairs(given: Any, L: Expr, others: list[Expr]) -> list[tuple[str, Expr, Expr]]:
    """Return name, symbol and velocity of each coordinate, as given or found in the expressions.

    A function of time in L is a coordinate; elsewhere it may be an input.
    """
    if given is None:
        made = set().union(*(e.atoms(Coordinate) for e in [L, *others]))
        moving = set().union(*(e.atoms(Velocity) for e in [L, *others]))
        made |= {v.coordinate for v in moving}
        functions = L.atoms(AppliedUndef)
        moved = {f for f in functions if len(f.args) == 1 and _is_time(f.args[0])}
        given = [*in_order(made), *sorted(moved, key=str)]
    elif isinstance(given, Mapping):
        given = list(given.items())
    found = []
    for one in _several(given, "coordinates"):
        if isinstance(one, Coordinate):
            found.append((one.name, one, one.d))
        elif isinstance(one, AppliedUndef) and len(one.args) == 1:
            found.append((str(one.func), one, sympy.Derivative(one, one.args[0])))
        elif isinstance(one, list | tuple | sympy.Tuple) and len(one) == 2:
            q, v = one
            symbols = sympy.Symbol | AppliedUndef
            if not isinstance(q, symbols) or not isinstance(v, symbols | sympy.Derivative):
                raise ValueError(f"coordinates: {one!r}: expected a pair of symbols")
            found.append((str(q.func) if isinstance(q, AppliedUndef) else q.name, q, v))
        else:
            raise ValueError(
                f"coordinates: {one!r}: expected one of dalembert.coordinates, a dynamicsymbol, "
                "or a pair of symbols (q, v)"
            )
    return found


def _is_time(argument: Expr) -> bool:
    """Return whether a function of this argument is a coordinate, that is, not of a coordinate."""
    return bool(argument.is_Symbol) and not isinstance(argument, Coordinate)


def _parameters(given: Mapping[Any, Any] | None) -> tuple[dict[str, float], list[Expr]]:
    """Return the values of parameters by name, and their symbols."""
    values, symbols = {}, []
    for key, value in arguments.mapping(given, "parameters").items():
        symbol = sympy.Symbol(key) if isinstance(key, str) else key
        if not isinstance(symbol, sympy.Symbol):
            raise ValueError(f"parameters: {key!r}: expected a symbol, or its name")
        if symbol.name in values:
            raise ValueError(f"parameters: {symbol.name} occurs twice")
        values[arguments.text(symbol.name, "parameters")] = arguments.parameter(value, symbol.name)
        symbols.append(symbol)
    return values, symbols


# What SymPy uses of a symbol when it simplifies, and so has to hold of its value; the first that
# does not is named, so the stronger ones stand first.
_ASSUMED: dict[str, tuple[str, Callable[[float], bool]]] = {
    "positive": ("a positive number", lambda x: x > 0),
    "negative": ("a negative number", lambda x: x < 0),
    "nonnegative": ("a number >= 0", lambda x: x >= 0),
    "nonpositive": ("a number <= 0", lambda x: x <= 0),
    "nonzero": ("a number other than 0", lambda x: x != 0),
    "integer": ("a whole number", lambda x: x == math.floor(x)),
}


def _assumed(symbols: Iterable[Expr]) -> tuple[str, ...]:
    """Return the assumptions of all symbols of the same parameter."""
    return tuple(word for word in _ASSUMED if any(getattr(s, f"is_{word}") for s in symbols))


def require_assumed(model: Model, values: Mapping[str, float]) -> None:
    """Raise ValueError if the value of a parameter violates an assumption of its symbol."""
    for (name, value), words in zip(values.items(), model.assumptions):
        for word in words:
            expected, holds = _ASSUMED[word]
            if not holds(value):
                raise ValueError(f"{name} = {value:.15g}: expected {expected}")
