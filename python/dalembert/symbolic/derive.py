"""The derivatives of a model, its kind and its mass: nodes of one graph."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import operator
import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import sympy

from . import graph as graphs
from .graph import Graph, Node
from .reading import Reader
from .symbols import TIME
from .values import may_vanish, values
from .walls import is_without_jump
from .zeros import is_zero

Expr = Any
Model = Any  # of model.py, which calls this

Matrix = list[Node]  # row by row

_LONGEST = 2000  # operations of what is proved to be 0


@dataclass(frozen=True)
class Function:
    """A function of the generated program: its outputs, in order, with their nodes."""

    name: str
    outputs: dict[str, Sequence[Node]]


@dataclass(frozen=True)
class Derived:
    """The type of a model, and the functions generated from it.

    Attributes
    ----------
    kind : {"linear", "affine", "nonlinear"}
        How the constraints depend on v.
    mass : tuple of Node or None
        M, row by row, if it is constant and L = v^T M v / 2 - V(q); depends on parameters only.
    functions : tuple of Function
        potential, lagrangian, constraint, force, mass, ..., if present; those of the steps are
        balance, with L_v, F = L_q + f and their derivatives, and pull, with V_q - f.
    is_positional : bool
        Whether there is a force, and it does not depend on v.
    read : Reader
        Reads expressions of the model, and writes nodes as expressions.
    make_terms : callable
        Returns `terms`.
    """

    kind: str
    mass: tuple[Node, ...] | None
    functions: tuple[Function, ...]
    is_positional: bool
    read: Reader
    make_terms: Callable[[], Function]

    @functools.cached_property
    def terms(self) -> Function:
        """The terms of the ODE on D, as in field.h; M only if it is not constant."""
        return self.make_terms()

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

    def entries(self, name: str, output: str) -> Sequence[Node]:
        """Return an output of a function; empty if absent."""
        function = self.function(name)
        return [] if function is None else function.outputs[output]

    def expressions(self, name: str, output: str) -> list[Expr]:
        """Return an output of a function as SymPy expressions; empty if absent."""
        return [self.read.formula(e) for e in self.entries(name, output)]


def derive(model: Model) -> Derived:
    """Return the type of a model and its derivatives."""
    return _Derivation(model).derived()


class _Derivation:
    """The graph of a model."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.graph = graph = Graph()
        symbols = (*model.q, *model.v, TIME, *model.p, *model.u)
        nodes = {s: graph.symbol(s.name) for s in symbols}
        self.q, self.v, (self.t,), self.p, self.u = (
            [nodes[s] for s in part] for part in (model.q, model.v, (TIME,), model.p, model.u)
        )
        formulas = (model.L, *model.constraints, *(model.force or ()))
        self.read = Reader(graph, nodes, formulas)
        source = random.Random(1)
        self.point, self.elsewhere = (
            {s.name: source.randint(200, 1100) / 1000 for s in symbols} for _ in range(2)
        )
        self.elsewhere |= {s.name: self.point[s.name] for s in model.p}
        self.n, self.m, self.is_timed = model.n, model.m, model.is_time_dependent
        self.rest: dict[Node, Node] = dict.fromkeys(self.v, graph.zero)

    def derived(self) -> Derived:
        model = self.model
        with self.naming("L"):
            mass, functions = self.energy()
        kind = "linear"
        if model.constraints:
            kind, function = self.constraints()
            functions.append(function)
        if model.force is not None:
            f = [self.read(e) for e in model.force]
            slopes = {"f_q": self.slopes(f, self.q, True), "f_v": self.slopes(f, self.v, True)}
            functions.append(Function("force", {"f": f} | slopes))
        for name, output, expressions in (
            ("state", "x", model.state),
            ("exact", "x", model.exact),
            ("invariant", "values", model.invariants),
        ):
            if expressions:
                functions.append(Function(name, {output: [self.read(e) for e in expressions]}))
        # by what is in it: the derivative of a dry friction, sign(v), is 0 too
        positional = model.force is not None and not any(
            self.read(e).reach & graphs.mask_of(self.v) for e in model.force
        )
        by_name = {f.name: f.outputs for f in functions}
        terms = functools.partial(self.terms, by_name, mass)
        found = Derived(kind, mass, tuple(functions), positional, self.read, terms)
        if found.has_momenta:
            functions.append(self.balance(by_name, mass))
        elif positional:
            V_q = by_name.get("potential", {}).get("V_q", [self.graph.zero] * self.n)
            pull = [a - b for a, b in zip(V_q, by_name["force"]["f"])]
            functions.append(Function("pull", {"V_q": pull}))
        return dataclasses.replace(found, functions=tuple(functions))

    @contextlib.contextmanager
    def naming(self, where: str) -> Iterator[None]:
        """Add the place, in the user's names, to errors about jumps."""
        try:
            yield
        except _Jump as jump:
            x, argument = (self.model.shown(self.read.formula(e)) for e in jump.args)
            raise ValueError(
                f"{where}: its derivative by {x} needs DiracDelta({argument}), because it jumps "
                f"where {argument} = 0. Write a Piecewise, whose jumps exert no force, or a "
                "smooth step of width w, such as (1 + tanh(x/w))/2 for Heaviside(x)"
            ) from None

    # ---- derivatives ---------------------------------------------------------------------------

    def require_smooth(self, nodes: Iterable[Node], variables: Sequence[Node]) -> None:
        """Raise _Jump if a derivative by a variable has a DiracDelta.

        A DiracDelta is dropped if its factor vanishes with its argument, as in the derivative of
        x^2 sign(x).
        """
        for jump, factor in self.graph.jumps(nodes, variables):
            argument = jump.args[0]
            if not is_without_jump(self.read.formula(factor), self.read.formula(argument)):
                raise _Jump(next(x for x in variables if argument.reach & x.bit), argument)

    def gradients(self, nodes: Sequence[Node], variables: Sequence[Node]) -> Matrix:
        """Return the derivatives of nodes by variables, row by row, by reverse differentiation."""
        self.require_smooth(nodes, variables)
        found = []
        for e in nodes:
            slopes = self.graph.gradient(e, variables)
            found += [slopes.get(x, self.graph.zero) for x in variables]
        return self.without_zeros(found)

    def slopes(
        self, nodes: Sequence[Node], variables: Sequence[Node], almost: bool = False,
        is_symmetric: bool = False,
    ) -> Matrix:  # fmt: skip
        """Return the same, by forward differentiation.

        If ``almost``, they may be wrong at jumps, and are finite there.  If ``is_symmetric``, the
        entries below the diagonal are copied from above.
        """
        if not almost:
            self.require_smooth(nodes, variables)
        size = len(variables)
        found = [self.graph.zero] * (len(nodes) * size)
        mask = functools.reduce(operator.or_, (e.reach for e in nodes), 0)
        for j, x in enumerate(variables):
            if not mask & x.bit:
                continue
            rows = [
                i for i, e in enumerate(nodes[: j + 1] if is_symmetric else nodes)
                if e.reach & x.bit
            ]  # fmt: skip
            for i, slope in zip(rows, self.graph.along([nodes[i] for i in rows], {x: 1})):
                found[i * size + j] = slope
        found = self.without_zeros(self.graph.bounded(found) if almost else found)
        if is_symmetric:
            for i, j in itertools.combinations(range(size), 2):
                found[j * size + i] = found[i * size + j]
        return found

    def without_zeros(self, nodes: Matrix) -> Matrix:
        """Return nodes with 0 in place of those that are proved to be 0."""
        there = list(dict.fromkeys(e for e in nodes if not e.is_zero))
        zeros = {e for e, x in zip(there, self.proved(there)) if x}
        return [self.graph.zero if e in zeros else e for e in nodes] if zeros else nodes

    def proved(self, nodes: Sequence[Node]) -> list[bool]:
        """Return whether each node is 0 everywhere: by structure, or by a proof.

        A proof is tried only if the node is 0 at a general point, and not too long.
        """
        unsure = [e for e in nodes if e.reach and not e.is_zero]
        doubtful = {e for e, x in zip(unsure, may_vanish(unsure, self.point)) if x}
        return [
            e.is_zero or (e in doubtful and _length(e) <= _LONGEST and self.is_proved(e))
            for e in nodes
        ]

    def is_proved(self, e: Node) -> bool:
        """Return whether SymPy proves that a node is 0, and has a value for all its parts."""
        try:
            return is_zero(self.read.formula(e))
        except (NotImplementedError, TypeError, ValueError):  # as of Max(1, 1/0)
            return False

    def are_zero(self, nodes: Iterable[Node]) -> bool:
        return all(self.proved(list(nodes)))

    def is_constant(self, nodes: Sequence[Node], values: Mapping[Node, Node]) -> bool:
        """Return whether nodes are proved not to change when symbols take these values."""
        there = self.graph.replaced(nodes, values)
        return self.are_zero(e - c for e, c in zip(nodes, there) if e is not c)

    def are_without(self, nodes: Iterable[Node], e: Node, symbols: Sequence[Node]) -> bool:
        """Return whether derivatives of e are independent of symbols, by inspection.

        The symbols must occur neither in the derivatives nor in a piecewise function in e.
        """
        mask = graphs.mask_of(symbols)
        return not any(x.reach & mask for x in (*nodes, *graphs.pieces(e)))

    # ---- the Lagrangian ------------------------------------------------------------------------

    def energy(self) -> tuple[tuple[Node, ...] | None, list[Function]]:
        """Return M and the functions of mass and potential; or None and that of the Lagrangian."""
        model, n, q, v = self.model, self.n, self.q, self.v
        L = self.read(model.L)
        both = self.gradients([L], [*q, *v])
        L_q, L_v = both[:n], both[n:]
        L_vv = self.slopes(L_v, v, is_symmetric=True)
        for i, name in enumerate(model.coordinates):
            if all(e.is_zero for e in L_vv[i * n : (i + 1) * n]):
                shown = model.shown(model.v[i])
                raise ValueError(
                    f"L contains {shown} not at all or only linearly, so {name} has no mass; "
                    f"expected a kinetic energy of {name}, such as m*{shown}**2/2, in "
                    "velocities, not in generalized speeds"
                )
        mass = self.constant_mass(L, L_v, L_vv)
        if mass is None:
            L_qq, L_vq = self.slopes(L_q, q, True, True), self.slopes(L_v, q)
            outputs = {"L": [L], "L_q": L_q, "L_v": L_v, "L_qq": L_qq, "L_vq": L_vq, "L_vv": L_vv}
            if self.is_timed:
                outputs["L_vt"] = self.slopes(L_v, [self.t])
            return None, [Function("lagrangian", outputs)]
        (V,) = self.graph.replaced([-L], self.rest)
        functions = [Function("mass", {"M": mass})]
        if not self.are_zero([V]):
            V_q = self.gradients([V], q)
            V_qq = self.slopes(V_q, q, True, True)
            functions.insert(0, Function("potential", {"V": [V], "V_q": V_q, "V_qq": V_qq}))
        return mass, functions

    def constant_mass(
        self, L: Node, L_v: Sequence[Node], L_vv: Sequence[Node]
    ) -> tuple[Node, ...] | None:
        """Return M if it is proved that L = v^T M v / 2 - V(q) with a constant M, else None."""
        graph = self.graph
        origin = self.rest | dict.fromkeys((*self.q, self.t), graph.zero)
        if not self.is_constant(L_vv, origin):
            return None
        M = graph.replaced(L_vv, origin)
        at_rest = graph.replaced([*L_v, L], self.rest)
        if self.are_without(L_vv, L, self.v):  # then L = v^T M v / 2 + b(q) v - V(q)
            return tuple(M) if self.are_zero(at_rest[:-1]) else None
        pairs = itertools.product(self.v, repeat=2)
        terms = (e * a * b for e, (a, b) in zip(M, pairs) if not e.is_zero)
        kinetic = Fraction(1, 2) * graph.sum(terms)
        return tuple(M) if self.are_zero([L - at_rest[-1] - kinetic]) else None

    # ---- the constraints -----------------------------------------------------------------------

    def constraints(self) -> tuple[str, Function]:
        """Return the kind of the constraints, and their function.

        They are affine if phi = mu(q) v + a(q) is evident or proved, and linear if a is proved to
        be zero.  Unless they are nonlinear, phi_v is without v.
        """
        n, m, graph = self.n, self.m, self.graph
        variables = [*self.q, *self.v, self.t]
        phi, slopes = [self.read(e) for e in self.model.constraints], []
        for a, e in enumerate(phi):
            with self.naming(f"constraints[{a}]"):
                slopes.append(self.gradients([e], variables))
        forward = [self.slopes([e], variables) for e in phi]
        slopes = min(slopes, forward, key=lambda rows: len(graphs.below(itertools.chain(*rows))))
        phi_q, rows, phi_t = (
            [row[part] for row in slopes]
            for part in (slice(0, n), slice(n, 2 * n), slice(2 * n, None))
        )
        mu = [graph.replaced(row, self.rest) for row in rows]
        shift = graph.replaced(phi, self.rest)
        affine = all(
            self.are_without(row, e, self.v)
            or self.are_zero([e - b - graph.sum(c * x for c, x in zip(at_rest, self.v))])
            for e, b, row, at_rest in zip(phi, shift, rows, mu)
        )
        for a, row in enumerate(mu if affine else rows):
            if self.are_zero(row):
                shown = self.model.shown(self.model.constraints[a])
                end = (
                    "it is 0 for all velocities, so it constrains nothing; remove it"
                    if self.are_zero([phi[a]]) else
                    "expected an expression with a velocity; for a constraint on the coordinates "
                    "alone give its time derivative here, and the constraint itself in positions="
                )  # fmt: skip
                raise ValueError(f"constraints[{a}] = {shown}: {end}")
        kind = "nonlinear"
        if affine:
            kind = "linear" if self.are_zero(shift) else "affine"
        outputs = {"phi": phi, "phi_v": sum(mu if affine else rows, []), "phi_q": sum(phi_q, [])}
        if self.is_timed:
            outputs["phi_t"] = sum(phi_t, [])
        return kind, Function("constraint", outputs)

    # ---- what steps and the field ask for ------------------------------------------------------

    def balance(
        self, given: Mapping[str, Mapping[str, Any]], mass: tuple[Node, ...] | None
    ) -> Function:
        """Return L_v, F = L_q + f, and their derivatives, as ``dal_balance_fn`` of kernel.h."""
        n, none = self.n, [self.graph.zero] * self.n**2
        if mass is None:
            parts = given["lagrangian"]
            L_v, F, L_vq, L_vv, F_q = (parts[x] for x in ("L_v", "L_q", "L_vq", "L_vv", "L_qq"))
            F_v = [L_vq[j * n + i] for i in range(n) for j in range(n)]
        else:
            L_vv, L_vq, F_v = list(mass), none, none
            L_v = [
                self.graph.sum(e * x for e, x in zip(mass[i * n : (i + 1) * n], self.v))
                for i in range(n)
            ]
            parts = given.get("potential", {"V_q": none[:n], "V_qq": none})
            F, F_q = [-e for e in parts["V_q"]], [-e for e in parts["V_qq"]]
        if force := given.get("force"):
            F, F_q, F_v = (
                [a + b for a, b in zip(x, force[name])]
                for name, x in (("f", F), ("f_q", F_q), ("f_v", F_v))
            )
        outputs = {"L_v": L_v, "F": F, "L_vq": L_vq, "L_vv": L_vv, "F_q": F_q, "F_v": F_v}
        return Function("balance", outputs)

    def terms(
        self, given: Mapping[str, Mapping[str, Any]], mass: tuple[Node, ...] | None
    ) -> Function:
        """Return F, mu and g of field.h, M unless it is constant, and C if it is constant."""
        graph, outputs = self.graph, dict[str, Sequence[Node]]()
        motion = dict(zip(self.q, self.v)) | ({self.t: 1} if self.is_timed else {})
        if mass is None:
            parts = given["lagrangian"]
            outputs["M"] = parts["L_vv"]
            F = [a - b for a, b in zip(parts["L_q"], graph.along(parts["L_v"], motion))]
        else:
            V_q = given.get("potential", {}).get("V_q", [graph.zero] * self.n)
            F = [-e for e in V_q]
        if force := given.get("force"):
            F = [a + b for a, b in zip(F, force["f"])]
        outputs["F"] = self.without_zeros(F)
        if self.m > 0:
            parts = given["constraint"]
            outputs["mu"] = parts["phi_v"]
            outputs["g"] = self.without_zeros(graph.along(parts["phi"], motion))
            if C := self.constant_gram(parts["phi_v"], mass):
                outputs["C"] = C
        return Function("terms", outputs)

    def constant_gram(self, mu: Matrix, mass: tuple[Node, ...] | None) -> Matrix | None:
        """Return C = mu M^-1 mu^T if M is diagonal and C is the same everywhere, as for a blade."""
        n, m, graph = self.n, self.m, self.graph
        if mass is None or any(not e.is_zero for k, e in enumerate(mass) if k % (n + 1)):
            return None
        C = [
            graph.sum(
                mu[a * n + i] * mu[b * n + i] / mass[i * n + i] for i in range(n)
                if not (mu[a * n + i].is_zero or mu[b * n + i].is_zero)
            ) for a, b in itertools.product(range(m), repeat=2)
        ]  # fmt: skip
        one, other = (values(C, point) for point in (self.point, self.elsewhere))
        if not all(abs(x - y) <= 1e-9 * abs(x) for x, y in zip(one, other)):
            return None
        there = dict.fromkeys(self.model.q, sympy.Integer(0))
        found = [self.read.formula(e) for e in C]
        constant = [e.xreplace(there) for e in found]
        is_known = all(c.free_symbols <= {*self.model.p} for c in constant)
        if not (is_known and all(is_zero(e - c) for e, c in zip(found, constant))):
            return None
        return [self.read(c) for c in constant]


def _length(e: Node) -> int:
    """Return how many operations a node takes if each is written as often as it is used."""
    found: dict[Node, int] = {}
    for x in graphs.below([e]):
        found[x] = 1 + sum(found[a] for a in x.args)
    return found[e]


class _Jump(Exception):
    """A derivative by the symbol args[0] that needs a DiracDelta of args[1]."""
