"""Normal forms of nodes: polynomials whose letters are nodes.

A letter is a symbol, the sine or cosine of an angle, a root, or the inverse of a sum.  Any other
node is a letter, too, and left as it is.  The square of a sine is 1 - c^2 for the cosine c.  So a
function that is constant, or 0, is seen to be so in most cases.

A polynomial that becomes too long is a letter of its own.  So chains stay as short as they are.
A sum of places, such as a distance x - c, is a letter in every product.  Far from the origin its
square would lose all digits as x^2 - 2 c x + c^2.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import sympy
from sympy.polys.rings import PolyRing

from .graph import Graph, Node, Number, below, mask_of

# A monomial is its letters and their exponents, by letter; a polynomial has its coefficients.
Monomial = tuple[tuple[int, int], ...]
Polynomial = dict[Monomial, Number]

ONE: Monomial = ()
UNIT: Polynomial = {ONE: 1}

_LONGEST = 60  # terms of the polynomial of a node
_LONGEST_ROOT = 16  # numerator or denominator of a power of a root
_NEAR = 8  # the largest constant of a sum that is expanded
_LARGEST = 4  # multiple of an angle, or power of a sum, that is expanded
_PATIENCE = 4000  # products of terms in one product of polynomials


class TooLong(Exception):
    """A polynomial has too many terms."""


class Forms:
    """Polynomials of the nodes of a graph.

    Parameters
    ----------
    graph : Graph
    places : iterable of Node
        Coordinates and the time.
    rates : iterable of Node
        The other symbols that change with time.  All that are in neither are constants.
    signs : mapping of Node to int
        Constants that are known to be positive (1), negative (-1), or nonzero (0).
    expands : bool, optional
        Whether the sine of a sum is expanded.
    """

    def __init__(
        self, graph: Graph, places: Iterable[Node], rates: Iterable[Node],
        signs: Mapping[Node, int], expands: bool = True,
    ) -> None:  # fmt: skip
        self.graph, self.places, self.mask = graph, mask_of(places), mask_of([*places, *rates])
        self.signs, self.expands = signs, expands
        self.letters: list[Node] = []
        self.left = math.inf  # products of terms
        self.pairs: dict[int, int] = {}  # the cosine of a sine
        self._places: dict[Node, int] = {}
        self._known: dict[Node, Polynomial] = {}
        self._factored: dict[frozenset[Any], list[tuple[Polynomial, int]]] = {}

    # ---- nodes as polynomials --------------------------------------------------------------

    def place(self, node: Node) -> int:
        """Return the number of a letter, a new one for a new node."""
        found = self._places.get(node)
        if found is None:
            found = self._places[node] = len(self.letters)
            self.letters.append(node)
        return found

    def letter(self, node: Node, exponent: int = 1) -> Polynomial:
        return {((self.place(node), exponent),): 1}

    def is_constant(self, a: Polynomial) -> bool:
        """Return whether a polynomial has no letter that changes."""
        return not any(self.letters[g].reach & self.mask for term in a for g, _ in term)

    def of(self, node: Node) -> Polynomial:
        """Return the polynomial of a node."""
        found = self._known.get(node)
        if found is None:
            for e in below([node]):
                if e not in self._known:
                    self._known[e] = self._short(e)
            found = self._known[node]
        return found

    def factor(self, node: Node) -> Polynomial:
        """Return the polynomial of a node for products: of a sum of places, a letter."""
        found = self.of(node)
        return self.letter(node) if self._is_distance(found) else found

    def _is_distance(self, a: Polynomial) -> bool:
        """Return whether a polynomial is the distance of places that may be far from the origin.

        It is linear in several coordinates, or in one with a constant that is a parameter or a
        large number.
        """
        if len(a) < 2:
            return False
        unit = inverted(lowest(a))
        sizes, far = list[Number](), False
        alone: Number = 0
        for term, x in a.items():
            inside = [(self.letters[g], k) for g, k in term if self.is_moving(g)]
            if not inside:
                far, alone = far or bool(joined(term, unit)), x
            elif len(inside) > 1 or inside[0][1] != 1 or not self._is_place(inside[0][0]):
                return False
            else:
                sizes.append(x)
        if not sizes:
            return False
        return far or len(sizes) > 1 or abs(alone) > _NEAR * min(map(abs, sizes))

    def _is_place(self, e: Node) -> bool:
        return e.op == "symbol" and bool(e.reach & self.places)

    def _short(self, e: Node) -> Polynomial:
        try:
            found = self.reduced(self._of(e))
        except TooLong:
            if self.left < 0:
                raise
            return self.letter(e)
        return found if len(found) <= _LONGEST else self.letter(e)

    def _of(self, e: Node) -> Polynomial:
        args = [self._known[a] for a in e.args]
        if e.op == "number":
            return {ONE: e.value} if e.value else {}
        if e.op in ("+", "-"):
            return total((args[0], 1), (args[1], 1 if e.op == "+" else -1))
        if e.op == "*":
            if not any(map(self.is_constant, args)):
                args = [self.factor(a) for a in e.args]
            return self.multiplied(*args)
        if e.op == "pow":
            return self.power(self.factor(e.args[0]), e.value, e.args[0])
        if e.op in ("sin", "cos"):
            cosine, sine = self.angle(args[0], e.args[0])
            return cosine if e.op == "cos" else sine
        if e.op == "tan":
            cosine, sine = self.angle(args[0], e.args[0])
            return times(sine, self.power(cosine, -1))
        return self.letter(e)

    def power(self, a: Polynomial, exponent: Number, node: Node | None = None) -> Polynomial:
        """Return a rational power."""
        if exponent.denominator == 1 and len(a) == 1:
            ((term, x),) = a.items()
            factor = Fraction(x) ** int(exponent)
            return {tuple((g, k * int(exponent)) for g, k in term): plain(factor)}
        if exponent.denominator == 1 and 0 <= exponent <= _LARGEST:
            found = UNIT
            for _ in range(int(exponent)):
                found = self.reduced(times(found, a))
            return found
        base = self.node(a) if node is None else node
        if exponent.denominator == 1:
            inverse = self.graph.power(base, -1 if exponent < 0 else 1)
            return self.letter(inverse, abs(int(exponent)))
        if max(abs(exponent.numerator), exponent.denominator) > _LONGEST_ROOT:  # as of a Float
            whole = math.floor(exponent)
            rest = self.letter(self.graph.power(base, exponent - whole))
            return self.multiplied(rest, self.power(a, whole, base))
        sign = 1 if exponent > 0 else -1
        root = self.graph.power(base, Fraction(sign, exponent.denominator))
        return self.letter(root, abs(exponent.numerator))

    def inverse(self, a: Polynomial) -> Polynomial:
        return self.power(a, -1)

    def angle(self, a: Polynomial, node: Node) -> tuple[Polynomial, Polynomial]:
        """Return the cosine and the sine of an angle."""
        if not self.expands or any(
            x.denominator != 1 or not -_LARGEST <= x <= _LARGEST for x in a.values()
        ):
            return self._pair(node)
        cosine, sine = UNIT, dict[Monomial, Number]()
        for term, count in a.items():
            c, s = self._pair(self._product(term))
            if count < 0:
                s = scaled(s, -1)
            for _ in range(abs(int(count))):
                cosine, sine = (
                    self.reduced(total((times(cosine, c), 1), (times(sine, s), -1))),
                    self.reduced(total((times(sine, c), 1), (times(cosine, s), 1))),
                )
        return cosine, sine

    def _pair(self, node: Node) -> tuple[Polynomial, Polynomial]:
        c, s = (self.place(self.graph.call(name, node)) for name in ("cos", "sin"))
        self.pairs[s] = c
        return {((c, 1),): 1}, {((s, 1),): 1}

    def reduced(self, a: Polynomial, sines: Collection[int] = ()) -> Polynomial:
        """Return a polynomial without squares of sines, or of the cosines to some sines."""
        squares = {g for term in a for g, k in term if k > 1}
        for g in sorted(self.pairs.keys() & squares):
            if g not in sines:
                a = self._without(a, g, self.pairs[g])
        for g in sines:
            a = self._without(a, self.pairs[g], g)
        return a

    def _without(self, a: Polynomial, g: int, other: int) -> Polynomial:
        """Return a polynomial without powers of a sine or cosine, in the other of the two."""
        if not any(h == g and k > 1 for term in a for h, k in term):
            return a
        found: list[tuple[Monomial, Number]] = []
        square: Polynomial = {ONE: 1, ((other, 2),): -1}
        for term, x in a.items():
            exponent = dict(term).get(g, 0)
            if exponent < 2:
                found.append((term, x))
                continue
            rest: Polynomial = {joined(term, ((g, -(exponent - exponent % 2)),)): x}
            for _ in range(exponent // 2):
                rest = times(rest, square)
            found += rest.items()
        return collected(found)

    def multiplied(self, a: Polynomial, b: Polynomial) -> Polynomial:
        """Return a product as it is; raise TooLong if nothing is left of the patience."""
        self.left -= len(a) * len(b)
        if self.left < 0:
            raise TooLong
        return times(a, b)

    def times(self, a: Polynomial, b: Polynomial) -> Polynomial:
        """Return a product in its normal form."""
        return self.reduced(self.multiplied(a, b))

    # ---- what is known of a polynomial -----------------------------------------------------

    def sign(self, a: Polynomial) -> int | None:
        """Return the sign of a polynomial that is nowhere 0, 0 if unknown, or None."""
        if len(a) == 1:
            ((term, x),) = a.items()
            signs = [(self._sign(g), k) for g, k in term]
            if any(sign is None for sign, _ in signs):
                return None
            found = 1 if x > 0 else -1
            for sign, k in signs:
                found *= 1 if k % 2 == 0 else sign or 0
            return found
        for sign in (1, -1):
            if self._is_positive(scaled(a, sign)):
                return sign
        return None

    def _sign(self, g: int) -> int | None:
        e = self.letters[g]
        if e in self.signs:
            return self.signs[e]
        if e.op in ("exp", "cosh"):
            return 1
        if e.op == "constant":
            return 1 if e.value.is_positive else -1 if e.value.is_negative else None
        if e.op == "pow" and not e.args[0].reach & self.mask and e.value < 0:
            return self.sign(self.of(e.args[0]))
        return None

    def _is_positive(self, a: Polynomial) -> bool:
        """Return whether all terms are squares or positive, and those that may vanish are less."""
        sure, lost = False, Fraction(0)
        alone: Number = a.get(ONE, 0)
        for term, x in a.items():
            odd = [g for g, k in term if k % 2]
            signs = [self._sign(g) for g in odd]
            even = [self._sign(g) is not None for g, k in term if k % 2 == 0]
            if x > 0 and all(sign == 1 for sign in signs):
                sure = sure or all(even)
            elif all(self.letters[g].op in ("sin", "cos") and k > 0 for g, k in term) and term:
                lost += max(x, -x)
            else:
                return False
        return alone > lost if lost else sure

    def content(self, row: Sequence[Polynomial]) -> Polynomial:
        """Return a common factor of polynomials that are not 0."""
        common = lowest({term: 1 for a in row for term in a})
        monomial: Polynomial = {common: 1}
        rest = [times(a, {inverted(common): 1}) for a in row]
        if any(len(a) == 1 for a in rest):
            return monomial
        ring, names = self._ring(rest)
        found = None
        for a in rest:
            element = _element(ring, names, a)
            found = element if found is None else found.gcd(element)
        if found is None or found.is_ground:
            return monomial
        return times(monomial, _polynomial(found, names))

    def quotient(self, a: Polynomial, b: Polynomial) -> Polynomial | None:
        """Return a / b if it is a polynomial."""
        if len(b) == 1:
            ((term, x),) = b.items()
            return {joined(t, inverted(term)): plain(Fraction(y) / x) for t, y in a.items()}
        if not a:
            return a
        shift = lowest(a)
        plainer = times(a, {inverted(shift): 1})
        low = lowest(b)
        divisor = times(b, {inverted(low): 1})
        ring, names = self._ring([plainer, divisor])
        whole, rest = divmod(_element(ring, names, plainer), _element(ring, names, divisor))
        if rest:
            return None
        return times(_polynomial(whole, names), {joined(shift, inverted(low)): 1})

    def over(self, a: Polynomial, b: Polynomial) -> Polynomial:
        """Return a / b; the inverse of b is a letter if it does not divide a."""
        found = self.quotient(a, b)
        return times(a, self.inverse(b)) if found is None else found

    def factors(self, a: Polynomial) -> list[tuple[Polynomial, int]]:
        """Return the factors of a polynomial with their exponents."""
        key = frozenset(a.items())
        found = self._factored.get(key)
        if found is None:
            low = lowest(a)
            plainer = times(a, {inverted(low): 1})
            ring, names = self._ring([plainer])
            number, parts = _element(ring, names, plainer).factor_list()
            value = plain(Fraction(int(number.numerator), int(number.denominator)))
            found = [({low: value}, 1)] + [(_polynomial(f, names), k) for f, k in parts]
            self._factored[key] = found
        return found

    def _ring(self, polynomials: Iterable[Polynomial]) -> tuple[PolyRing, list[int]]:
        names = sorted({g for a in polynomials for term in a for g, _ in term})
        return PolyRing([f"x{g}" for g in names] or ["x"], sympy.QQ, sympy.lex), names

    # ---- polynomials as nodes --------------------------------------------------------------

    def node(self, a: Polynomial) -> Node:
        """Return the node of a polynomial, term by term."""
        return self.graph.sum(self.graph.scaled(x, self._product(term)) for term, x in a.items())

    def _product(self, term: Monomial) -> Node:
        """Return the node of a monomial: its constants, times all else."""
        parts: tuple[list[Node], list[Node]] = [], []
        for g, k in term:
            e = self.letters[g]
            parts[bool(e.reach & self.mask)].append(self.graph.power(e, k))
        return self.graph.product(map(self.graph.product, parts))

    def is_moving(self, g: int) -> bool:
        return bool(self.letters[g].reach & self.mask)


# ---- polynomials ---------------------------------------------------------------------------------


def plain(x: Number) -> Number:
    return x.numerator if x.denominator == 1 else x


def collected(terms: Iterable[tuple[Monomial, Number]]) -> Polynomial:
    """Return a sum with like terms combined, without zeros."""
    found: Polynomial = {}
    for term, x in terms:
        found[term] = found.get(term, 0) + x
    return {term: x for term, x in found.items() if x}


def total(*parts: tuple[Polynomial, Number]) -> Polynomial:
    """Return a sum of multiples."""
    return collected((term, x * factor) for a, factor in parts for term, x in a.items())


def scaled(a: Polynomial, factor: Number) -> Polynomial:
    return {term: x * factor for term, x in a.items()}


def joined(one: Monomial, other: Monomial) -> Monomial:
    """Return the product of two monomials."""
    if not one or not other:
        return one or other
    found = dict(one)
    for g, k in other:
        found[g] = found.get(g, 0) + k
    return tuple(sorted((g, k) for g, k in found.items() if k))


def inverted(term: Monomial) -> Monomial:
    return tuple((g, -k) for g, k in term)


def lowest(a: Polynomial) -> Monomial:
    """Return the monomial whose exponents are the least of all terms."""
    terms = [dict(term) for term in a]
    letters = {g for term in terms for g in term}
    found = ((g, min(term.get(g, 0) for term in terms)) for g in sorted(letters))
    return tuple((g, k) for g, k in found if k)


def times(a: Polynomial, b: Polynomial) -> Polynomial:
    """Return a product."""
    if len(a) * len(b) > _PATIENCE:
        raise TooLong
    pairs = itertools.product(a.items(), b.items())
    return collected((joined(one, other), x * y) for (one, x), (other, y) in pairs)


def _element(ring: PolyRing, names: list[int], a: Polynomial) -> Any:
    places = {g: i for i, g in enumerate(names)}
    terms = {}
    for term, x in a.items():
        exponents = [0] * max(len(names), 1)
        for g, k in term:
            exponents[places[g]] = k
        terms[tuple(exponents)] = sympy.QQ(x.numerator, x.denominator)
    return ring.from_dict(terms)


def _polynomial(element: Any, names: list[int]) -> Polynomial:
    return {
        tuple((g, k) for g, k in zip(names, term) if k):
            plain(Fraction(int(x.numerator), int(x.denominator)))
        for term, x in element.items()
    }  # fmt: skip


# ---- many polynomials as nodes -------------------------------------------------------------------


def written(forms: Forms, polynomials: Sequence[Polynomial], pairs: bool, nests: int) -> list[Node]:
    """Return the nodes of polynomials.

    If ``pairs``, two letters that occur together in several monomials are multiplied first.
    Unless ``nests`` is 0, a letter of several terms of a sum is taken out.  If letters have equally
    many terms, it is the first for 1, and the last for -1.
    """
    made = _Writer(forms)
    terms = [{term: made.split(term) for term in a} for a in polynomials]
    if pairs:
        made.pair([x for a in terms for _, x in a.values()])
    found = []
    for a, parts in zip(polynomials, terms):
        several = [(a[t], constants, made.joined(x)) for t, (constants, x) in parts.items()]
        found.append(made.nested(several, nests) if nests else made.sum(several))
    return found


def by_coefficients(
    forms: Forms, polynomials: Sequence[Polynomial], letters: Collection[int]
) -> list[Node]:
    """Return the nodes of polynomials, collected by monomials in some letters.

    Coefficients are written by factors.  Terms with the same coefficient are added first.
    """
    graph, found = forms.graph, []
    for a in polynomials:
        by: dict[Monomial, Polynomial] = {}
        for term, x in a.items():
            inside = tuple((g, k) for g, k in term if g in letters)
            by.setdefault(inside, {})[joined(term, inverted(inside))] = x
        sums: dict[frozenset[Any], list[tuple[Polynomial, Polynomial, Number]]] = {}
        for inside, coefficient in by.items():
            number = next(iter(coefficient.values()))
            unit = {t: plain(Fraction(x) / number) for t, x in coefficient.items()}
            sums.setdefault(frozenset(unit.items()), []).append((unit, {inside: 1}, number))
        found.append(graph.sum(
            factored(forms, terms[0][0]) * forms.node(total(*((b, x) for _, b, x in terms)))
            for terms in sums.values()
        ))  # fmt: skip
    return found


def factored(forms: Forms, a: Polynomial) -> Node:
    """Return the node of a polynomial as a product of its factors."""
    if len(a) < 2:
        return forms.node(a)
    is_small = len(a) <= 12 and len({g for term in a for g, _ in term}) <= 5
    several = forms.factors(a) if is_small else [(a, 1)]
    parts = [(written(forms, [f], False, 1)[0], k) for f, k in several]
    return forms.graph.product(x**k for x, k in parts)


class _Writer:
    """Monomials as constants and a multiset of moving nodes."""

    def __init__(self, forms: Forms) -> None:
        self.forms, self.graph = forms, forms.graph
        self.made: list[tuple[frozenset[tuple[Node, int]], Node]] = []

    def split(self, term: Monomial) -> tuple[Node, dict[Node, int]]:
        """Return the product of the constants of a monomial, and its other letters."""
        constants, moving = [], dict[Node, int]()
        for g, k in term:
            if not self.forms.is_moving(g):
                constants.append(self.graph.power(self.forms.letters[g], k))
            elif k > 0:
                moving[self.forms.letters[g]] = k
            else:
                moving[self.graph.power(self.forms.letters[g], k)] = 1
        return self.graph.product(constants), moving

    def pair(self, monomials: list[dict[Node, int]]) -> None:
        """Replace pairs of letters that occur together most often, until none occurs twice."""
        equal: dict[frozenset[tuple[Node, int]], list[dict[Node, int]]] = {}
        for x in monomials:
            equal.setdefault(frozenset(x.items()), []).append(x)
        left = [several[0] for several in equal.values()]
        counts: Counter[tuple[Node, Node]] = Counter()
        for x in left:
            counts.update(_pairs(x))
        while counts:
            pair, count = max(counts.items(), key=lambda item: item[1])
            if count < 2:
                break
            product = self.graph.make("*", *pair) if pair[0] is not pair[1] else pair[0] ** 2
            need = Counter(pair)
            for x in left:
                if all(x.get(e, 0) >= k for e, k in need.items()):
                    counts.subtract(_pairs(x))
                    for e, k in need.items():
                        x[e] -= k
                        if not x[e]:
                            del x[e]
                    x[product] = x.get(product, 0) + 1
                    counts.update(_pairs(x))
        for several in equal.values():
            for x in several[1:]:
                x.clear()
                x.update(several[0])

    def joined(self, x: Mapping[Node, int]) -> dict[Node, int]:
        return {e: k for e, k in x.items() if k}

    def product(self, x: Mapping[Node, int]) -> Node:
        """Return a product as it stands: its factors are not opened."""
        several = [e**k for e, k in x.items()]
        if not several:
            return self.graph.one
        while len(several) > 1:
            one, other, *rest = sorted(several, key=lambda e: (e.depth, e.index))
            several = [self.graph.make("*", one, other), *rest]
        return several[0]

    def sum(self, terms: list[tuple[Number, Node, dict[Node, int]]]) -> Node:
        return self.graph.sum(
            self.graph.scaled(x, constants * self.product(moving)) for x, constants, moving in terms
        )

    def nested(self, terms: list[tuple[Number, Node, dict[Node, int]]], order: int) -> Node:
        """Return a sum in which letters of several terms are taken out, the most frequent first."""
        counts = Counter(e for _, _, moving in terms for e in moving)
        if not counts or max(counts.values()) < 2:
            return self.sum(terms)
        best = max(counts, key=lambda e: (counts[e], -order * e.index))
        inside = [(x, c, m) for x, c, m in terms if best in m]
        least = min(m[best] for _, _, m in inside)
        rest = [(x, c, m) for x, c, m in terms if best not in m]
        left = [
            (x, c, {e: k - least * (e is best) for e, k in m.items() if k > least * (e is best)})
            for x, c, m in inside
        ]
        outside = self.nested(rest, order) if rest else self.graph.zero
        return best**least * self.nested(left, order) + outside


def _pairs(x: Mapping[Node, int]) -> list[tuple[Node, Node]]:
    """Return the pairs of factors of a monomial."""
    several = sorted(x, key=lambda e: e.index)
    return [*itertools.combinations(several, 2), *((e, e) for e in several if x[e] > 1)]
