"""The equations of a model on D: velocities w in a basis of the kernel of the constraints.

    q' = E(t, q) w + e(t, q),   w' = (E^T M E)^-1 E^T (F - M (E' w + e'))

The basis is built by regular operations on columns, one constraint after the other:

- A pivot, an entry of the row that is a nonzero constant, removes its column.
- A turn of two columns whose entries a, b have a constant a^2 + b^2.
- A pair: the row has two entries only, with the kernel (b, -a) without their common factor.
- A pivot that is nowhere 0, without a division: the other columns are multiplied by it.
- Quaternions: a row of three or four entries, among four columns.

So E has full rank wherever the constraints have.  Several bases, and several ways to write the
equations, are tried; those with the fewest convolutions are taken, see `convolutions`.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from . import convolutions
from .forms import (
    ONE,
    UNIT,
    Forms,
    Polynomial,
    TooLong,
    by_coefficients,
    inverted,
    lowest,
    scaled,
    total,
    written,
)
from .graph import PIECE, Graph, Node, below, mask_of
from .symbols import TIME

Model = Any  # of model.py, which calls this
Column = list[Polynomial]
_Rates = Callable[[list[Node]], list[Node]]  # from the nodes of some polynomials

_BASES = 6  # that are compared
_TRIES = 60  # operations in the search
_WIDE = 4  # constraints from which a basis is made as for chains only
_LONGEST = 150  # nodes of a letter whose rate is written in normal form
_SHORT = 20  # nodes of a term that is written in normal form
_LONG = 16  # terms of an entry that is not kept as a node
_PATIENCE = 30_000  # products of terms in the equations for a basis
_DEAR = 100  # convolutions from which no more than two bases are compared
_LARGEST_BASIS = 50  # terms of a basis that is not the only one
_LARGEST = 300  # terms of all equations
_SEVERAL = 150  # terms of all equations that are written in all ways
_THOROUGH = 2  # bases, and kinds of equations for each, that are written in all ways
_UNEVEN = 1.25  # what a basis may cost less whose energy depends on q, and so on the roundoff of q
_LARGEST_BLOCK = 3  # that is inverted by Cramer's rule


class NotReduced(ValueError):
    """There are no equations on D in closed form; the text says why."""


@dataclass(frozen=True)
class Reduced:
    """The equations of a model on D: q' = E(t, q) w + e(t, q), w' = rates.

    Attributes
    ----------
    w : tuple of Node
        The k = n - m symbols w0 ... of the graph of the model.
    E : tuple of Node
        n x k, row by row; in t, q, p and u.
    e : tuple of Node
        The n components, which are 0 unless the constraints are affine.
    velocity : tuple of Node
        E w + e.
    rates : tuple of Node
        w', in t, q, w, p and u.
    quasi : tuple of Node
        w in t, q, v, p and u; if v is not in D, of a v in D nearby.
    how : tuple of str
        The operations on columns.
    cost : int
        The number of convolutions of the Taylor series.
    """

    w: tuple[Node, ...]
    E: tuple[Node, ...]
    e: tuple[Node, ...]
    velocity: tuple[Node, ...]
    rates: tuple[Node, ...]
    quasi: tuple[Node, ...]
    how: tuple[str, ...]
    cost: int


@dataclass(frozen=True)
class _Basis:
    """Columns that span the kernel of some rows, and rows whose products with them are 1 or 0."""

    columns: list[Column]
    duals: list[Column]
    shift: Column
    how: tuple[str, ...] = ()
    is_divided: bool = False  # whether a row was divided by what may vanish


@dataclass(frozen=True)
class _Option:
    """An operation on columns that makes a row 0: its kind, the row without a factor, columns.

    The weights of the columns are those of squares of entries, where these are added.
    """

    kind: str
    row: int
    entries: list[Polynomial]
    shift: Polynomial
    is_divided: bool
    at: tuple[int, ...]
    place: tuple[int, ...] = field(compare=False)
    weights: Sequence[Polynomial] = ()


_KINDS = ("pivot", "turn", "pair", "pivot without division", "quaternion")


def reduced(model: Model) -> Reduced:
    """Return the equations of a model on D.

    Raises
    ------
    NotReduced
        If the constraints are nonlinear, leave no velocity, or no basis is found.
    """
    return _Reduction(model).best()


def in_chart(model: Model, dependent: Collection[int]) -> Reduced:
    """Return the equations for w = the velocities of all coordinates but m dependent ones.

    They are singular where those do not determine the others.

    Raises
    ------
    NotReduced
        As for `reduced`, or if they determine the others nowhere.
    """
    return _Reduction(model).in_chart(dependent)


class _Reduction:
    """The search for the equations of a model."""

    def __init__(self, model: Model) -> None:
        if model.derived.kind == "nonlinear":
            raise NotReduced("the constraints are not linear in the velocities")
        if model.m >= model.n:
            raise NotReduced("the constraints leave no velocity")
        self.model, self.derived = model, model.derived
        self.graph, self._copies = Graph(), dict[Node, Node]()
        self.n, self.m, self.k = model.n, model.m, model.n - model.m
        read = self.derived.read
        self.q, self.v, self.p, (self.t,) = (
            self.copied([read(s) for s in part]) for part in (model.q, model.v, model.p, [TIME])
        )
        self.w = [self.graph.symbol(f"w{j}") for j in range(self.k)]
        terms = self.derived.terms.outputs
        self.M, self.F, self.mu, self.g = (
            self.copied(x) for x in (
                self.derived.mass or terms["M"], terms["F"], terms.get("mu", ()),
                terms.get("g", ()),
            )
        )  # fmt: skip
        self.L, self.L_q, self.L_v = (
            self.copied(self.derived.entries("lagrangian", name)) for name in ("L", "L_q", "L_v")
        )
        self.f = self.copied(self.derived.entries("force", "f"))
        self.phi = self.copied(self.derived.entries("constraint", "phi"))
        self.rest = dict.fromkeys(self.v, self.graph.zero)
        self.a = self.graph.replaced(self.phi, self.rest)
        if self.derived.kind == "linear":
            self.a = [self.graph.zero] * self.m
        self.signs = {
            p: sign for p, words in zip(self.p, model.assumptions)
            if (sign := _sign(words)) is not None
        }  # fmt: skip
        self.moving = [*self.q, self.t], [*self.v, *self.w]
        several = [e for e in below([*self.mu, *self.M, *self.F]) if e.op in ("sin", "cos", "tan")]
        has_sums = any(e.args[0].op in ("+", "-", "*") for e in several)
        self.searches: list[tuple[bool, bool, int]] = []  # expands sines, is for chains, bases
        if self.m < _WIDE:
            self.searches += [(True, False, _BASES), (False, False, 2)][: 1 + has_sums]
        if self.m > 2:
            self.searches.append((False, True, 1))

    def best(self) -> Reduced:
        """Return the equations with the least cost."""
        found: list[tuple[int, _Equations]] = []
        for expands, is_chain, count in self.searches:
            seen = set()
            forms = Forms(self.graph, *self.moving, self.signs, expands)
            for basis in itertools.islice(_Search(self, forms, is_chain).bases(), count):
                key = tuple(frozenset(e.items()) for column in basis.columns for e in column)
                is_long = sum(len(e) for column in basis.columns for e in column) > _LARGEST_BASIS
                if key not in seen and not (found and is_long):
                    seen.add(key)
                    equations = _Equations(self, forms, basis)
                    found.append((equations.begin(), equations))
                if len(found) > 1 and min(cost for cost, _ in found) > _DEAR:
                    break
        if not found:
            raise NotReduced("no operation on columns makes the constraints 0 in closed form")
        several = sorted(found, key=lambda x: x[0] * x[1].weight)[:_THOROUGH]
        _, best = min(
            ((x.weight, x.best()) for _, x in several), key=lambda x: x[0] * x[1].cost
        )
        return self.returned(best)

    def in_chart(self, dependent: Collection[int]) -> Reduced:
        """Return the equations with the velocities of some coordinates eliminated."""
        forms = Forms(self.graph, *self.moving, self.signs)
        search = _Search(self, forms, False)
        basis, left = search.start(), list(range(self.n))
        rows = list(range(self.m))
        try:
            while rows:
                option, j = search.pivot(rows, basis, [i in dependent for i in left])
                basis = search.applied(option, basis)
                rows.remove(option.row)
                del left[j]
        except TooLong:
            raise NotReduced("the dependent velocities are too long in closed form") from None
        equations = _Equations(self, forms, basis)
        equations.begin()
        return self.returned(equations.best())

    def returned(self, best: Reduced) -> Reduced:
        """Return equations in the graph of the model."""
        graph, copies = self.derived.read.graph, dict[Node, Node]()

        def back(nodes: Sequence[Node]) -> tuple[Node, ...]:
            return tuple(_copied(graph, nodes, copies))

        return Reduced(
            back(best.w), back(best.E), back(best.e), back(best.velocity), back(best.rates),
            back(best.quasi), best.how, best.cost,
        )  # fmt: skip

    def copied(self, nodes: Sequence[Node]) -> list[Node]:
        """Return nodes of the model in the graph of the search, which is thrown away."""
        return _copied(self.graph, nodes, self._copies)

    @functools.cached_property
    def squares(self) -> list[tuple[Node, Node, Node]] | None:
        """T as factors and pairs of rates of positions, whose products are added; None if not."""
        if not self.L:
            return None
        graph, found = self.graph, list[tuple[Node, Node, Node]]()
        moves, changes = mask_of(self.v), mask_of([*self.q, *self.v, self.t])
        left = [(graph.one, self.L[0])]
        while left:
            factor, e = left.pop()
            if not e.reach & moves:
                continue
            if e.op in ("+", "-"):
                left += [(factor, e.args[0]), (factor if e.op == "+" else -factor, e.args[1])]
            elif e.op == "*" and not e.args[0].reach & changes:
                left.append((factor * e.args[0], e.args[1]))
            elif e.op == "*" and not e.args[1].reach & changes:
                left.append((factor * e.args[1], e.args[0]))
            elif e.op == "*" or (e.op == "pow" and e.value == 2):
                found.append((factor, e.args[0], e.args[-1]))
            else:
                return None
        rates = {e for _, *pair in found for e in pair}
        return found if all(map(self.is_rate, rates)) else None

    def is_rate(self, e: Node) -> bool:
        """Return whether a node is linear in v, and the rate of a function of q."""
        graph, moves = self.graph, mask_of(self.v)
        if e.reach & (PIECE | self.t.bit) or not graph.replaced([e], self.rest)[0].is_zero:
            return False
        slopes = graph.gradient(e, self.v)
        if any(x.reach & moves for x in slopes.values()):
            return False
        curls = {
            (i, j): x for i, v in enumerate(self.v) if v in slopes
            for j, x in enumerate(
                graph.gradient(slopes[v], self.q).get(q, graph.zero) for q in self.q
            ) if not x.is_zero
        }  # fmt: skip
        return all(curls.get((j, i)) is x for (i, j), x in curls.items())


def _copied(graph: Graph, nodes: Sequence[Node], copies: dict[Node, Node]) -> list[Node]:
    """Return nodes of another graph in this one."""
    for e in below(nodes):
        if e not in copies:
            copies[e] = graph.make(e.op, *(copies[a] for a in e.args), value=e.value)
    return [copies[e] for e in nodes]


def _sign(words: Sequence[str]) -> int | None:
    """Return the sign of a parameter that is not 0 by its assumptions, 0 if unknown, or None."""
    if "positive" in words:
        return 1
    if "negative" in words:
        return -1
    return 0 if "nonzero" in words else None


# ---- the basis -----------------------------------------------------------------------------------


class _Search:
    """Bases of the kernel of the constraints.

    For a chain the rows with the fewest entries come first, and an entry is left as it is unless
    its normal form costs less.
    """

    def __init__(self, reduction: _Reduction, forms: Forms, is_chain: bool) -> None:
        self.reduction, self.forms, self.is_chain = reduction, forms, is_chain
        self.n, self.m, self.graph = reduction.n, reduction.m, reduction.graph
        n = self.n
        self.mu = [
            [forms.factor(e) for e in reduction.mu[r * n : (r + 1) * n]] for r in range(self.m)
        ]  # fmt: skip
        self.a = [forms.factor(e) for e in reduction.a]
        self.left = _TRIES + self.m
        self._products: dict[tuple[int, int], Polynomial] = {}
        self._kept: list[Column] = []  # so that their identity is not that of others

    def start(self) -> _Basis:
        unit = [[UNIT if i == j else {} for i in range(self.n)] for j in range(self.n)]
        return _Basis(unit, [list(c) for c in unit], [{} for _ in range(self.n)])

    def bases(self) -> Iterator[_Basis]:
        yield from self._bases(list(range(self.m)), self.start())

    def pivot(
        self, rows: list[int], basis: _Basis, allowed: Sequence[bool]
    ) -> tuple[_Option, int]:
        """Return the shortest pivot in allowed columns, which may vanish, and its column."""
        found = []
        for r in rows:
            entries = [self.product(r, c) for c in basis.columns]
            shift = total((self.a[r], 1), (self.product(r, basis.shift), 1))
            found += [
                (len(x), _Option("pivot", r, entries, shift, True, (j,), ()), j)
                for j, x in enumerate(entries) if x and allowed[j]
            ]  # fmt: skip
        if not found:
            raise NotReduced("the independent velocities do not determine the dependent ones")
        _, option, j = min(found, key=lambda x: x[0])
        return option, j

    def _bases(self, rows: list[int], basis: _Basis) -> Iterator[_Basis]:
        if not rows:
            yield basis
            return
        counts: dict[str, int] = {}
        for option in self.options(rows, basis):
            counts[option.kind] = counts.get(option.kind, 0) + 1
            if counts[option.kind] > 2:
                continue
            self.left -= 1
            if self.left < 0:
                return
            try:
                after = self.applied(option, basis)
            except TooLong:
                continue
            yield from self._bases([r for r in rows if r != option.row], after)

    def product(self, r: int, column: Column) -> Polynomial:
        """Return the product of a constraint and a column."""
        key = r, id(column)
        if key not in self._products:
            self._kept.append(column)
            self._products[key] = self._product(r, column)
        return self._products[key]

    def _product(self, r: int, column: Column) -> Polynomial:
        forms = self.forms
        found = None
        try:
            parts = [(forms.multiplied(x, e), 1) for x, e in zip(self.mu[r], column) if x and e]
            found = forms.reduced(total(*parts))
            if len(found) <= 3:
                return found
        except TooLong:
            pass
        # the constraint itself, whose parts may be shared
        values = {v: forms.node(e) for v, e in zip(self.reduction.v, column)}
        (node,) = self.graph.replaced([self.reduction.phi[r]], values)
        node = node - self.reduction.a[r]
        degrees = dict.fromkeys([*self.reduction.q, self.reduction.t], convolutions.MANY)
        if found is not None and (
            len(found) <= _LONG
            and convolutions.cost_of([forms.node(found)], degrees)
            <= convolutions.cost_of([node], degrees)
            or not self.is_chain
        ):
            return found
        return forms.letter(node)

    def options(self, rows: list[int], basis: _Basis) -> list[_Option]:
        """Return the operations that make a row 0, the best first."""
        forms, columns = self.forms, basis.columns
        found: list[_Option] = []

        def add(
            kind: str, at: tuple[int, ...], length: int = 0, weights: Sequence[Polynomial] = ()
        ) -> None:
            places = (len(there), _KINDS.index(kind), length)
            if not self.is_chain:
                places = places[1], places[0], length
            found.append(_Option(kind, r, entries, shift, is_divided, at, places, weights))

        for r in rows:
            entries = [self.product(r, c) for c in columns]
            shift = total((self.a[r], 1), (self.product(r, basis.shift), 1))
            there = [j for j, x in enumerate(entries) if x]
            if not there:
                return []
            entries, shift, is_divided = self.without_factor(entries, shift)
            for j in there:
                sign = forms.sign(entries[j])
                if sign is not None:
                    kind = _KINDS[0] if forms.is_constant(entries[j]) else _KINDS[3]
                    add(kind, (j,), sum(map(bool, columns[j])))
            for i, j in itertools.combinations(there, 2):
                if max(len(entries[i]), len(entries[j])) > _LONG:
                    continue
                for weights in self.weights(columns[i], columns[j]):
                    size = self.size(entries, (i, j), weights)
                    if forms.is_constant(size) and forms.sign(size) is not None:
                        add("turn", (i, j), 0, weights)
                        break
            if len(there) == 2:
                weights = self.weights(*(columns[j] for j in there))[-1]
                add("pair", (there[0], there[1]), 0, weights)
            if len(there) in (3, 4) and len(columns) >= 4:
                free = [j for j in range(len(columns)) if j not in there]
                add("quaternion", tuple([*there, *free][:4]), 0, [UNIT] * 4)
        if any(x.kind != "quaternion" for x in found):
            found = [x for x in found if x.kind != "quaternion"]
        return sorted(found, key=lambda x: x.place)

    def without_factor(
        self, entries: list[Polynomial], shift: Polynomial
    ) -> tuple[list[Polynomial], Polynomial, bool]:
        """Return a row divided by the common factor of its entries, and whether that may vanish."""
        forms = self.forms
        there = [x for x in entries if x]
        factor = there[0] if len(there) == 1 else forms.content(there)
        divided = [forms.quotient(x, factor) if x else x for x in entries]
        parts = [x for x in divided if x is not None]
        if factor == UNIT or len(parts) < len(divided):
            return entries, shift, False
        return parts, forms.over(shift, factor) if shift else shift, forms.sign(factor) is None

    def weights(self, one: Column, other: Column) -> list[list[Polynomial]]:
        """Return weights of two columns: ones, and if they differ those by the inverse of M.

        Only velocities themselves have such, if their masses are constant and positive.  With them
        the size of a row does not depend on the units of the coordinates.
        """
        forms, masses = self.forms, []
        for column in (one, other):
            places = [i for i, e in enumerate(column) if e]
            if len(places) > 1 or column[places[0]] != UNIT:
                return [[UNIT, UNIT]]
            masses.append(forms.of(self.reduction.M[places[0] * (self.n + 1)]))
        is_fit = all(forms.is_constant(x) and forms.sign(x) == 1 for x in masses)
        if not is_fit or masses[0] == masses[1]:
            return [[UNIT, UNIT]]
        return [[UNIT, UNIT], masses[::-1]]

    def size(
        self, entries: list[Polynomial], at: Sequence[int], weights: Sequence[Polynomial]
    ) -> Polynomial:
        """Return the weighted sum of the squares of some entries."""
        forms = self.forms
        squares = (forms.multiplied(entries[j], entries[j]) for j in at)
        parts = ((forms.multiplied(x, w), 1) for x, w in zip(squares, weights))
        return forms.reduced(total(*parts))

    def combined(self, *parts: tuple[Column, Polynomial]) -> Column:
        """Return a sum of multiples of columns."""
        forms = self.forms
        found = []
        for several in zip(*(column for column, _ in parts)):
            e = _dot(forms, several, [factor for _, factor in parts])
            found.append(forms.letter(forms.node(e)) if len(e) > _LONG else e)
        return found

    def applied(self, option: _Option, basis: _Basis) -> _Basis:
        """Return the basis after an operation."""
        forms, columns, duals = self.forms, basis.columns, basis.duals
        x, at = option.entries, option.at
        others = [j for j in range(len(columns)) if j not in at]
        new: list[Column] = []
        dual: list[Column] = []
        if option.kind.startswith("pivot"):
            (j,) = at
            inverse = forms.inverse(x[j])
            along = [(columns[j], inverse)]
            for i in others:
                if not x[i]:
                    new.append(columns[i])
                    dual.append(duals[i])
                elif option.kind == "pivot":
                    share = forms.times(scaled(x[i], -1), inverse)
                    new.append(self.combined((columns[i], UNIT), (columns[j], share)))
                    dual.append(duals[i])
                else:
                    new.append(self.combined((columns[i], x[j]), (columns[j], scaled(x[i], -1))))
                    dual.append(self.combined((duals[i], inverse)))
        else:
            weights = option.weights
            inverse = forms.inverse(self.size(x, at, weights))
            shares = [forms.times(w, inverse) for w in weights]
            along = [(columns[j], forms.times(x[j], f)) for j, f in zip(at, shares)]
            for signs in _KERNEL[len(at)]:
                parts = [(at[i], scaled(x[at[j]], s)) for i, (j, s) in enumerate(signs)]
                new.append(self.combined(*((columns[i], f) for i, f in parts)))
                dual.append(self.combined(*(
                    (duals[i], forms.times(f, shares[j])) for (i, f), (j, _) in zip(parts, signs)
                )))  # fmt: skip
            for i in others:
                if x[i]:
                    back = [(c, forms.times(scaled(x[i], -1), f)) for c, f in along]
                    new.append(self.combined((columns[i], UNIT), *back))
                else:
                    new.append(columns[i])
                dual.append(duals[i])
        shift = basis.shift
        if option.shift:
            left = scaled(option.shift, -1)
            shift = self.combined((shift, UNIT), *((c, forms.times(left, f)) for c, f in along))
        names = self.reduction.model.coordinates
        where = " ".join(names[i] for i in sorted({
            next(i for i, e in enumerate(columns[j]) if e) for j in at
        }))  # fmt: skip
        how = *basis.how, f"{option.kind} {where}"
        return _Basis(new, dual, shift, how, basis.is_divided or option.is_divided)


# Kernels of a row by the places of their entries, and the signs.
_KERNEL: dict[int, list[tuple[tuple[int, int], ...]]] = {
    2: [((1, 1), (0, -1))],
    4: [
        ((1, -1), (0, 1), (3, -1), (2, 1)),
        ((2, -1), (3, 1), (0, 1), (1, -1)),
        ((3, -1), (2, -1), (1, 1), (0, 1)),
    ],
}


# ---- the equations -------------------------------------------------------------------------------


class _Equations:
    """The equations for a basis."""

    def __init__(self, reduction: _Reduction, forms: Forms, basis: _Basis) -> None:
        self.reduction, self.forms = reduction, forms
        self.graph, self.n, self.k = reduction.graph, reduction.n, reduction.k
        signs = [_direction(c) for c in basis.columns]
        self.columns = [[scaled(e, s) for e in c] for c, s in zip(basis.columns, signs)]
        self.duals = [[scaled(e, s) for e in c] for c, s in zip(basis.duals, signs)]
        self.shift, self.how, self.is_divided = basis.shift, basis.how, basis.is_divided
        self.w = [forms.letter(x) for x in reduction.w]
        self.v = [forms.letter(x) for x in reduction.v]
        self.V = [
            total((self.shift[i], 1), *(
                (forms.multiplied(c[i], x), 1) for c, x in zip(self.columns, self.w)
            ))
            for i in range(self.n)
        ]  # fmt: skip
        self.found: list[tuple[int, list[Node], list[Node]]] = []
        self.is_even = False  # whether E^T M E is constant
        self.ways: list[tuple[int, list[Polynomial], _Rates]] = []

    @property
    def weight(self) -> float:
        """The factor of the cost by which bases are compared."""
        return 1.0 if self.is_even else _UNEVEN

    def begin(self) -> int:
        """Write all kinds of equations in one way; return the least cost."""
        self.attempt(self.by_nodes)
        for named in (False, True):
            self.forms.left = _PATIENCE
            self.attempt(functools.partial(self.by_forms, named))
        return min(x[0] for x in self.found)

    def best(self) -> Reduced:
        """Return the equations with the least cost after trying all ways to write them."""
        reduction, forms, graph = self.reduction, self.forms, self.graph
        least = min(x[0] for x in self.found)
        for cost, polynomials, make in sorted(self.ways, key=lambda x: x[0])[:_THOROUGH]:
            if cost <= 1.4 * least + 2 and sum(map(len, polynomials)) <= _SEVERAL:
                self.write_all(polynomials, make)
        cost, velocity, rates = min(self.found, key=lambda x: x[0])
        E = [forms.node(c[i]) for i in range(self.n) for c in self.columns]
        e = [forms.node(x) for x in self.shift]
        apart = [x - y for x, y in zip(reduction.v, e)]
        quasi = [
            graph.sum(forms.node(x) * y for x, y in zip(row, apart) if x) for row in self.duals
        ]
        return Reduced(
            tuple(reduction.w), tuple(E), tuple(e), tuple(velocity), tuple(rates), tuple(quasi),
            self.how, cost,
        )  # fmt: skip

    def attempt(self, way: Callable[[], None]) -> None:
        try:
            way()
        except TooLong:
            pass

    def add(self, velocity: Sequence[Node], rates: Sequence[Node]) -> int:
        """Keep equations, in which velocities may stand for their values; return their cost."""
        reduction = self.reduction
        rates = self.graph.replaced(rates, dict(zip(reduction.v, velocity)))
        ode = {**dict(zip(reduction.q, velocity)), **dict(zip(reduction.w, rates))}
        ode[reduction.t] = self.graph.one
        cost = convolutions.cost(ode)
        self.found.append((cost, list(velocity), list(rates)))
        return cost

    # ---- on the graph ----------------------------------------------------------------------

    def by_nodes(self) -> None:
        """Make equations in which nothing is expanded."""
        reduction, forms, graph = self.reduction, self.forms, self.graph
        columns = [[forms.node(e) for e in c] for c in self.columns]
        shift = [forms.node(e) for e in self.shift]
        velocity = self.sum(columns, shift)
        turned = graph.along(velocity, self.motion)
        force = [f - a for f, a in zip(reduction.F, self.momentum(turned))]
        r = [_sum(graph, c, force) for c in columns]
        m = [[graph.zero] * self.k for _ in range(self.k)]
        for j, c in enumerate(columns):
            along = self.momentum(c)
            for i in range(j + 1):
                m[i][j] = m[j][i] = _sum(graph, columns[i], along)
        self.add(velocity, _solved(m, r))
        if reduction.squares:
            self.by_squares(columns, shift, velocity)

    @property
    def motion(self) -> dict[Node, Node]:
        reduction = self.reduction
        return dict(zip(reduction.q, reduction.v)) | {reduction.t: self.graph.one}

    def sum(self, columns: Sequence[Sequence[Node]], shift: Sequence[Node]) -> list[Node]:
        """Return columns times w, and a shift."""
        graph, w = self.graph, self.reduction.w
        return [_sum(graph, row, w) + e for *row, e in zip(*columns, shift)]

    def by_squares(
        self, columns: list[list[Node]], shift: list[Node], velocity: Sequence[Node]
    ) -> None:
        """Make the same equations, if T is made of rates of positions, without L_vq.

        For a rate u = b(q) v the part of F - M (E' w + e') in D is u' for constant w, times b E.
        """
        reduction, graph, k = self.reduction, self.graph, self.k
        squares = reduction.squares or []
        rates = list(dict.fromkeys(e for _, *pair in squares for e in pair))
        along = [graph.replaced(rates, dict(zip(reduction.v, c))) for c in (*columns, shift)]
        turned = [graph.along(x, self.motion) for x in along]
        slow = dict(zip(rates, self.sum(turned[:k], turned[k])))
        parts = dict(zip(rates, zip(*along)))
        still = graph.replaced(reduction.L_q, reduction.rest)
        force = [a + b for a, b in zip(still, reduction.f or [graph.zero] * self.n)]
        m = [[graph.zero] * k for _ in range(k)]
        r = []
        for i, j in itertools.combinations_with_replacement(range(k), 2):
            m[i][j] = m[j][i] = self.gathered(
                c * (parts[a][i] * parts[b][j] + parts[a][j] * parts[b][i]) for c, a, b in squares
            )
        for i in range(k):
            lost = (c * (parts[a][i] * slow[b] + parts[b][i] * slow[a]) for c, a, b in squares)
            r.append(_sum(graph, columns[i], force) - self.gathered(lost))
        self.add(velocity, _solved(m, r))

    def gathered(self, terms: Iterable[Node]) -> Node:
        """Return a sum; the short terms together are in normal form, if that has fewer terms."""
        forms, short, others = self.forms, list[Node](), list[Node]()
        for e in terms:
            (short if len(below([e])) <= _SHORT else others).append(e)
        form = total(*((forms.of(e), 1) for e in short))
        if len(form := forms.reduced(form)) < len(short):
            short = [forms.node(form)]
        return self.graph.sum([*short, *others])

    def momentum(self, x: Sequence[Node]) -> list[Node]:
        """Return M times a vector."""
        reduction, graph, n = self.reduction, self.graph, self.n
        if reduction.derived.mass is not None:
            return [_sum(graph, reduction.M[i * n : (i + 1) * n], x) for i in range(n)]
        return graph.along(reduction.L_v, dict(zip(reduction.v, x)))

    # ---- in normal forms -------------------------------------------------------------------

    def by_forms(self, named: bool) -> None:
        """Make equations in normal forms, with v as it is, if ``named``, or in terms of w."""
        reduction, forms, n = self.reduction, self.forms, self.n
        M = [[forms.factor(e) for e in reduction.M[i * n : (i + 1) * n]] for i in range(n)]
        rule = {
            self.place(v): x for v, x in zip(reduction.v, self.V)
            if not named or len(x) <= 1 and all(not self.depends(g) for t in x for g, _ in t)
        }  # fmt: skip
        V = [self.replaced(v, rule) for v in self.v]
        F = [self.replaced(forms.of(e), rule) for e in reduction.F]
        if sum(map(len, self.V)) > _LARGEST // 2:
            raise TooLong
        self.rates: dict[int, Polynomial] = {}
        slow = [self.rate(e, V, rule) for e in self.V]
        force = [total((f, 1), (_dot(forms, row, slow), -1)) for f, row in zip(F, M)]
        r = [_dot(forms, c, force) for c in self.columns]
        pulled = [[_dot(forms, row, c) for row in M] for c in self.columns]
        m = [[_dot(forms, c, x) for x in pulled] for c in self.columns]
        self.is_even = all(forms.is_constant(x) for row in m for x in row)
        self.solve(m, r)
        if reduction.m and reduction.derived.mass is not None and not self.is_divided:
            self.attempt(lambda: self.by_multipliers(M, F, rule))

    def place(self, node: Node) -> int:
        return self.forms.place(node)

    def depends(self, g: int) -> bool:
        """Return whether a letter depends on coordinates."""
        mask = mask_of([*self.reduction.q, self.reduction.t])
        return bool(self.forms.letters[g].reach & mask)

    def replaced(self, a: Polynomial, rule: Mapping[int, Polynomial]) -> Polynomial:
        """Return a polynomial with some letters replaced by polynomials."""
        parts: list[tuple[Polynomial, int]] = []
        for term, x in a.items():
            found: Polynomial = {tuple((g, k) for g, k in term if g not in rule): x}
            for g, k in term:
                if g in rule:
                    factor = rule[g] if k > 0 else self.forms.inverse(rule[g])
                    for _ in range(abs(k)):
                        found = self.forms.times(found, factor)
            parts.append((found, 1))
        return total(*parts)

    def rate(
        self, a: Polynomial, V: Sequence[Polynomial], rule: Mapping[int, Polynomial]
    ) -> Polynomial:
        """Return the rate of a polynomial while w is constant."""
        parts = []
        for term, x in a.items():
            for g, k in term:
                if g not in self.rates:
                    self.rates[g] = self.rate_of(g, V, rule)
                slope = self.rates[g]
                if slope:
                    rest = {tuple((h, j - (h == g)) for h, j in term if j != (h == g)): x * k}
                    parts.append((self.forms.multiplied(rest, slope), 1))
        return self.forms.reduced(total(*parts))

    def rate_of(
        self, g: int, V: Sequence[Polynomial], rule: Mapping[int, Polynomial]
    ) -> Polynomial:
        reduction, forms = self.reduction, self.forms
        e = forms.letters[g]
        if e in reduction.q:
            return V[reduction.q.index(e)]
        if e is reduction.t:
            return UNIT
        if not e.reach & mask_of([*reduction.q, reduction.t]):
            return {}
        if len(below([e])) > _LONGEST:
            raise TooLong
        (found,) = self.graph.along([e], self.motion)
        return self.replaced(forms.of(found), rule)

    def solve(self, m: list[list[Polynomial]], r: list[Polynomial]) -> None:
        """Keep the solutions of m w' = r."""
        forms = self.forms
        blocks = _blocks(m)
        cramer: list[list[tuple[Polynomial, Polynomial]]] = [[] for _ in r]
        apart, joint = dict[int, tuple[Polynomial, Polynomial]](), True
        for block in blocks:
            if len(block) > _LARGEST_BLOCK:
                joint = False
                continue
            inside = [[m[i][j] for j in block] for i in block]
            adjugate, determinant = self.inverted(inside)
            for i, row in zip(block, adjugate):
                cramer[i] = [(x, r[j]) for x, j in zip(row, block) if x]
                above = forms.reduced(total(*((forms.times(x, y), 1) for x, y in cramer[i])))
                apart[i] = self.simplified(above, determinant)
        if joint:
            fractions = [x for i in range(self.k) for x in apart[i]]
            self.keep(fractions, lambda x: [a / b for a, b in zip(x[::2], x[1::2])])
        several = [block for block in blocks if len(block) > 1]
        if several and not all(forms.is_constant(m[i][j]) for b in several for i in b for j in b):
            flat = [x for row in m for x in row]
            self.keep([*r, *flat], lambda nodes: _solved(
                [nodes[self.k * (i + 1) : self.k * (i + 2)] for i in range(self.k)],
                nodes[: self.k],
            ))  # fmt: skip

    def inverted(self, m: list[list[Polynomial]]) -> tuple[list[list[Polynomial]], Polynomial]:
        """Return the adjugate and the determinant of a matrix of at most 3 rows."""
        forms, size = self.forms, len(m)

        def minor(rows: list[int], columns: list[int]) -> Polynomial:
            if not rows:
                return UNIT
            parts = []
            for s, j in enumerate(columns):
                if m[rows[0]][j]:
                    rest = minor(rows[1:], [c for c in columns if c != j])
                    parts.append((forms.times(m[rows[0]][j], rest), -1 if s % 2 else 1))
            return forms.reduced(total(*parts))

        every = list(range(size))
        adjugate = [
            [
                scaled(
                    minor([x for x in every if x != j], [x for x in every if x != i]),
                    -1 if (i + j) % 2 else 1,
                )
                for j in every
            ]
            for i in every
        ]
        return adjugate, minor(every, every)

    def simplified(self, above: Polynomial, below: Polynomial) -> tuple[Polynomial, Polynomial]:
        """Return a fraction without the factors that are found."""
        forms = self.forms
        if not above:
            return {}, UNIT
        if forms.is_constant(below):
            return forms.times(above, forms.inverse(below)), UNIT
        factor = lowest({**above, **below})
        if factor != ONE:
            above, below = (forms.multiplied(x, {inverted(factor): 1}) for x in (above, below))
        if len(below) == 1:
            return forms.times(above, forms.inverse(below)), UNIT
        if len(above) <= 2 * _LONG:
            common = forms.content([above, below])
            if len(common) > 1:
                parts = forms.quotient(above, common), forms.quotient(below, common)
                if parts[0] is not None and parts[1] is not None:
                    above, below = parts[0], parts[1]
        if forms.is_constant(below):
            return forms.times(above, forms.inverse(below)), UNIT
        return above, below

    def by_multipliers(
        self, M: list[list[Polynomial]], F: list[Polynomial], rule: Mapping[int, Polynomial]
    ) -> None:
        """Keep the equations by multipliers, if each w is a component of v."""
        reduction, forms, n, m = self.reduction, self.forms, self.n, self.reduction.m
        if m > _LARGEST_BLOCK:
            return
        places = []
        for j in range(self.k):
            place = next((
                i for i in range(n) if not self.shift[i]
                and all(c[i] == (UNIT if c is self.columns[j] else {}) for c in self.columns)
            ), None)  # fmt: skip
            if place is None:
                return
            places.append(place)
        inverse = [[dict[Any, Any]() for _ in range(n)] for _ in range(n)]
        for block in _blocks(M):
            if len(block) > _LARGEST_BLOCK:
                return
            adjugate, determinant = self.inverted([[M[i][j] for j in block] for i in block])
            for i, row in zip(block, adjugate):
                for j, x in zip(block, row):
                    inverse[i][j] = forms.over(x, determinant)
        mu = [[forms.factor(e) for e in reduction.mu[r * n : (r + 1) * n]] for r in range(m)]
        g = [self.replaced(forms.of(e), rule) for e in reduction.g]
        free = [_dot(forms, row, F) for row in inverse]
        pull = [[_dot(forms, row, x) for x in mu] for row in inverse]
        C = [[_dot(forms, x, [row[s] for row in pull]) for s in range(m)] for x in mu]
        rest = [scaled(total((_dot(forms, x, free), 1), (y, 1)), -1) for x, y in zip(mu, g)]
        adjugate, determinant = self.inverted(C)
        above = [_dot(forms, row, rest) for row in adjugate]
        below = determinant
        if m == 1:
            below = C[0][0]
        fractions = [self.simplified(x, below) for x in above]
        flat = [x for pair in fractions for x in pair]

        def rates(nodes: list[Node]) -> list[Node]:
            multipliers = [
                forms.letter(a / b) for a, b in zip(nodes[::2], nodes[1::2])
            ]  # fmt: skip
            found = [
                total((free[i], 1), *(
                    (forms.multiplied(x, y), 1) for x, y in zip(pull[i], multipliers)
                )) for i in places
            ]  # fmt: skip
            return min(
                (written(forms, found, pairs, nests) for pairs in (False, True)
                 for nests in (0, 1, -1)),
                key=lambda x: convolutions.cost_of(x, dict.fromkeys(
                    [*reduction.q, *reduction.v, *reduction.w], convolutions.MANY)),
            )  # fmt: skip

        self.keep(flat, rates)

    # ---- as nodes --------------------------------------------------------------------------

    def keep(self, polynomials: list[Polynomial], rates: _Rates) -> None:
        """Keep velocities and polynomials, which make rates, written in one way for now."""
        several, n = [*self.V, *polynomials], self.n
        if sum(map(len, several)) > _LARGEST:
            return
        nodes = written(self.forms, several, True, 1)
        self.ways.append((self.add(nodes[:n], rates(nodes[n:])), several, rates))

    def write_all(self, polynomials: list[Polynomial], rates: _Rates) -> None:
        """Write polynomials in all ways."""
        forms, n = self.forms, self.n
        letters = {self.place(x) for x in (*self.reduction.w, *self.reduction.v)}
        for several in self.turned(polynomials):
            ways = [
                written(forms, several, pairs, nests)
                for pairs in (False, True) for nests in (0, 1, -1)
            ]  # fmt: skip
            if sum(map(len, several)) <= 100:
                ways.append(by_coefficients(forms, several, letters))
            for nodes in ways:
                self.add(nodes[:n], rates(nodes[n:]))

    def turned(self, polynomials: list[Polynomial]) -> Iterator[list[Polynomial]]:
        """Yield polynomials with squares of cosines or sines, where there are some."""
        forms = self.forms
        squares = {g for a in polynomials for t in a for g, k in t if k > 1}
        sines = [s for s, c in forms.pairs.items() if c in squares][:2]
        for count in range(len(sines) + 1):
            for some in itertools.combinations(sines, count):
                yield [forms.reduced(a, some) for a in polynomials]


def _dot(forms: Forms, a: Sequence[Polynomial], b: Sequence[Polynomial]) -> Polynomial:
    return forms.reduced(total(*((forms.multiplied(x, y), 1) for x, y in zip(a, b) if x and y)))


def _sum(graph: Graph, a: Sequence[Node], b: Sequence[Node]) -> Node:
    """Return the sum of products."""
    return graph.sum(x * y for x, y in zip(a, b))


def _direction(column: Column) -> int:
    """Return -1 if most entries of a column begin with a minus sign."""
    firsts = [next(iter(e.values())) for e in column if e]
    return -1 if sum(1 if x > 0 else -1 for x in firsts) < 0 else 1


def _blocks(m: Sequence[Sequence[Any]]) -> list[list[int]]:
    """Return the indices of the independent blocks of a symmetric matrix."""
    left, found = list(range(len(m))), []
    while left:
        block = [left.pop(0)]
        for i in block:
            block += (more := [j for j in left if m[i][j]])
            left = [j for j in left if j not in more]
        found.append(sorted(block))
    return found


def _solved(m: list[list[Node]], r: list[Node]) -> list[Node]:
    """Return the solution of m x = r by L D L^T, for a positive matrix; zeros stay zeros."""
    m, r, k = [list(row) for row in m], list(r), len(r)
    for j in range(k):
        for i in range(j + 1, k):
            if m[i][j].is_zero:
                continue
            share = m[i][j] / m[j][j]
            for c in range(j + 1, i + 1):
                if not m[c][j].is_zero:
                    m[i][c] = m[c][i] = m[i][c] - share * m[c][j]
            r[i] = r[i] - share * r[j]
    for i in reversed(range(k)):
        rest = (m[c][i] * r[c] for c in range(i + 1, k) if not m[c][i].is_zero)
        r[i] = (r[i] - r[i].graph.sum(rest)) / m[i][i]
    return r
