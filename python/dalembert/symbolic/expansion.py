"""C of the Taylor series of a model, see series.h."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from .graph import CONDITIONS, Node, below, mask_of
from .model import Model
from .motion import Motion, series_of
from .printing import C, Program, Text, nearest, spelled
from .recurrences import COMPARED, ENDLESS, RULES, Operand, Pair, Series
from .symbols import TIME


class Writer:
    """The text in C of the coefficients, as statements of ``expand`` of series.h.

    Parameters
    ----------
    series : Series
    places : mapping of str to str
        The text of the values of symbols, by name.
    low : mapping of str to str
        The text of their parts below the last digit.
    four : bool, optional
        Whether the text is that of ``expand_four``.
    wide : collection of str, optional
        Names of symbols that have four values each, as has all that depends on them.
    """

    def __init__(
        self, series: Series, places: Mapping[str, str], low: Mapping[str, str],
        four: bool = False, wide: Collection[str] = (),
    ) -> None:  # fmt: skip
        self.series, self._places, self._below, self.four = series, places, low, four
        self.type = "dal_four" if four else "double"
        self.has_wide = bool(wide)
        self._wide = mask_of(e for e in series.nodes if e.op == "symbol" and e.value in wide)
        self._number = {e: i for i, e in enumerate(series.nodes)}
        groups: list[list[Pair]] = [[], [], []]
        for pair in series.pairs:
            groups[self.is_wide(pair[0][0]) + self.is_wide(pair[1][0])].append(pair)
        self._pairs, self.shared, self.both_wide = groups
        self.vectors = len(self._pairs) if four else -(-len(self._pairs) // 4)
        place = "vectors" if four else "at"
        names = (f"M.{place}", "N", "P")
        self._middle = {pair: f"{name}[{i}]" for name, group in zip(names, groups)
                        for i, pair in enumerate(group)}  # fmt: skip
        columns = len(self._columns())
        self.width = columns if self.has_wide else -(-columns // 4) * 4
        self._low: dict[Node, str | None] = {}
        self._late: dict[Node, int] = {}  # how many operations of an order come before
        for e in series.nodes:
            is_known = series.degree[e] < ENDLESS or e in series.states or not e.args
            self._late[e] = 0 if is_known else 1 + max(self._late[a] for a in e.args)

    def is_wide(self, e: Node) -> bool:
        """Return whether a node has four values, in a text whose other numbers have one."""
        return bool(e.reach & self._wide)

    def type_of(self, e: Node) -> str:
        return "dal_four" if self.is_wide(e) else self.type

    def zero(self, e: Node) -> str:
        return "zero" if self.four or self.is_wide(e) else "0.0"

    def widened(self, text: str | None, e: Node, to: Node) -> str:
        """Return the text of a number of e, or 0, as one of the type of another node."""
        if text is None:
            return self.zero(to)
        return self.as_wide(text, e) if self.is_wide(to) else text

    def lines(self) -> list[str]:
        """Return all statements."""
        series, found = self.series, [*self._first()]
        states = list(series.states)
        live = [e for e in series.nodes if series.degree[e] > 0]
        found += [f"const {self.type} r{self._number[e]} = {x};" for e in live
                  if (x := self._over(e))]  # fmt: skip
        found += [f"const {self.type} g{self._number[e]} = {self._part(e.args[1])} * "
                  f"{self.zeroth(e)} * r{self._number[e]};" for e in live if e.op == "power"]
        found += [f"const {self.type_of(e)} f{self._number[e]} = {self._slope(e)};" for e in live
                  if series.degree[e] == 1]  # fmt: skip
        found += [f"{self.type_of(e)} b{self._number[e]} = {self.zeroth(e)};"
                  for e in self._before()]  # fmt: skip
        found += self._row("0", [self._cell(self.zeroth(x), x) for x in self._columns()])
        found += [f"{self.type_of(x)} d{i} = {self.widened(self.zeroth(rate), rate, x)};"
                  for i, (x, rate) in enumerate(series.states.items())]  # fmt: skip
        found.append(f"for (size_t k = 1; k <{'=' * (not states)} order; k++) {{")
        found += [f"    {line}" for line in self._loop()]
        found.append("}")
        if not states:
            return _used(found)
        last = "d{0} * (unit / (double)order)"
        found += self._row("order", [last.format(i) for i in range(len(states))])
        return _used(found)

    def _cell(self, text: str | None, e: Node) -> str:
        """Return the text of a coefficient, or 0, as a number of a row."""
        if self.has_wide:
            return "zero" if text is None else self.as_wide(text, e)
        return text or self.zero(e)

    def as_wide(self, text: str, e: Node) -> str:
        return text if self.is_wide(e) else f"DAL_SERIES_ALL({text})"

    def _row(self, order: str, coefficients: Sequence[str]) -> list[str]:
        """Return the assignment of coefficients of all columns, four at once."""
        none = "zero" if self.four or self.has_wide else "0.0"
        several = [*coefficients, *[none] * (self.width - len(coefficients))]
        if self.has_wide:
            return [f"Y[{order} * {self.width} + {i}] = {x};" for i, x in enumerate(several)]
        if self.four:
            return [
                f"dal_series_deal(Y, {order} * {self.width} + {i}, "
                f"(const dal_four[]){{{', '.join(several[i : i + 4])}}});"
                for i in range(0, self.width, 4)
            ]
        return [
            f"((dal_four *)Y)[{order} * {self.width // 4} + {i // 4}] = "
            f"(dal_four){{{', '.join(several[i : i + 4])}}};"
            for i in range(0, self.width, 4)
        ]

    def _columns(self) -> list[Node]:
        """Return the series whose coefficients are given to the caller."""
        series = self.series
        return [*series.states, *series.functions, *series.switches, *series.exponents]

    def _before(self) -> list[Node]:
        """Return the series whose coefficient of the order before is needed."""
        series, found = self.series, dict[Node, None]()
        for e in series.nodes:
            if series.degree[e] < ENDLESS or e in series.states:
                continue
            if e.op == "*":
                found |= {b: None for a, b in (e.args, e.args[::-1]) if series.degree[a] == 1}
            elif e.op == "/" and series.degree[e.args[1]] == 1:
                found[e] = None
            elif e.op in RULES and series.degree[e.args[0]] == 1:
                if not RULES[e.op].is_quotient:
                    found[series.other[e]] = None
        return list(found)

    # order 0

    def _first(self) -> list[str]:
        found = []
        for e in self.series.nodes:
            if e.op in ("number", "constant", "nan"):
                continue
            kind = "dal_four_bits" if self.four else "int"
            kind = self.type_of(e) if e.op not in CONDITIONS else kind
            if e in self.series.sides:
                found.append(f"const double s{self._number[e]} = {self._side(e)};")
                found.append(f"const {kind} a{self._number[e]} = {self._branch(e, e.args, 0)};")
                continue
            found.append(f"const {kind} a{self._number[e]} = {self._value(e)};")
            if e.op in ("sin", "cos") and (low := self.low(e.args[0])):
                pair, sign = ("cos", "+") if e.op == "sin" else ("sin", "-")
                angle, name = self.zeroth(e.args[0]), f"a{self._number[e]}"
                one, other = self._call(e.op, angle), self._call(pair, angle)
                found[-1] = f"const {self.type} {name} = {one} {sign} {low} * {other};"
            self._low_part(e, found)
        return found

    def _value(self, e: Node) -> str:
        if e.op == "symbol":
            return self._places[e.value]
        args = [self.zeroth(a) for a in e.args]
        if e.op in ("sqrt", "power"):
            args[0] = self._base(e.args[0])
        if e.op == "*" and (fraction := _fraction(e.args[0])):
            above, below = fraction
            return f"{above} * {self._part(e.args[1])} / {below}"
        if e.op in ("+", "-", "*", "/"):
            return f" {e.op} ".join(f"({x})" if x[0] == "-" else x for x in args)
        if e.op == "choose":
            args[1:] = [self.widened(x, a, e) for x, a in zip(args[1:], e.args[1:])]
        forms = _FOUR if self.four else C.forms
        if e.op in forms:
            return forms[e.op].format(*args)
        return self._call(C.names.get(e.op, e.op), *args)

    def _call(self, name: str, *args: str) -> str:
        """Return a call of a function of numbers."""
        if not self.four:
            return f"{name}({', '.join(args)})"
        each = "DAL_SERIES_EACH" if len(args) == 1 else "DAL_SERIES_EACH_OF_TWO"
        return f"{each}({name}, {', '.join(args)})"

    def _branch(self, e: Node, args: Sequence[Node], order: int) -> str:
        """Return the coefficient of a function with branches: of order 0, or k."""
        side = f"s{self._number[e]}"
        parts = [self._part(a) if order == 0 else self.kth(a) or "0.0" for a in args]
        if e.op in _SIDES:
            return f"{side} {_SIDES[e.op]} 0.0"
        if e.op == "step":
            return f"model_step({side}, {parts[1]})"
        if e.op in ("max", "min"):
            one, other = parts if e.op == "max" else parts[::-1]
            return f"{side} >= 0.0 ? {one} : {other}"
        return side if e.op == "sign" else f"{side} * {parts[0]}"

    def _side(self, e: Node) -> str:
        """Return the sign of the difference of the arguments: that of the switch, if it is known.
        """
        switch, sign = self.series.sides[e]
        other = self._part(e.args[1]) if e.op in COMPARED else "0.0"
        by_value = f"model_sign({self._part(e.args[0])} - {other})"
        known = f"at->side[{switch}]"
        return f"{known} != 0.0 ? {'-' * (sign < 0)}{known} : {by_value}"

    def _base(self, e: Node) -> str:
        """Return the base of a root or a power: Max(0, x) is 0 at the switch.

        Rounding may make it negative there, or so small that no step leads on.
        """
        if e not in self.series.sides or e.op not in ("max", "min"):
            return self.zeroth(e)
        numbers = [repr(nearest(a)) for a in e.args if a.op == "number"]
        if not numbers:
            return self.zeroth(e)
        switch, _ = self.series.sides[e]
        return f"at->crossed[{switch}] == 0.0 ? {self.zeroth(e)} : {numbers[0]}"

    def zeroth(self, e: Node) -> str:
        """Return the name, or the text, of the coefficient of order 0."""
        if e.op not in ("number", "constant", "nan"):
            return f"a{self._number[e]}"
        text = "NAN" if e.op == "nan" else repr(nearest(e))
        return f"DAL_SERIES_ALL({text})" if self.four else text

    def _part(self, e: Node) -> str:
        text = self.zeroth(e)
        return f"({text})" if text[0] == "-" else text

    def low(self, e: Node) -> str | None:
        """Return the part of a value below its last digit, None if it is not known."""
        return self._low.get(e)

    def _low_part(self, e: Node, found: list[str]) -> None:
        """Add the low part of a state, of sums of states, and of multiples of a state.

        So an angle of many turns has the sine of the angle, not that of its rounding.  A distance
        far from the origin keeps its digits.
        """
        name, number = f"a{self._number[e]}", self._number[e]
        if self.is_wide(e):
            return
        if e.op == "symbol":
            if place := self._below.get(e.value):
                self._low[e] = place
        elif e.op in ("+", "-"):
            parts = [self._low.get(a) for a in e.args]
            if not any(parts):
                return
            a, b = map(self._part, e.args)
            sign, sum, back = e.op, f"y{number}", f"z{number}"
            lows = f"{parts[0] or '0.0'} {sign} {parts[1] or '0.0'}"
            found[-1] = f"const {self.type} {sum} = {a} {sign} {b};"
            found += [
                f"const {self.type} {back} = {sum} - {a};",
                f"const {self.type} x{number} = ({a} - ({sum} - {back})) + "
                f"({sign}{b} - {back}) + ({lows});",
                f"const {self.type} {name} = {sum} + x{number};",
                f"const {self.type} l{number} = x{number} - ({name} - {sum});",
            ]
            self._low[e] = f"l{number}"
        elif e.op == "*":
            for one, other in (e.args, e.args[::-1]):
                if (low := self._low.get(one)) and self.series.degree[other] == 0:
                    a, b = self._part(one), self._part(other)
                    found.append(
                        f"const {self.type} l{number} = DAL_SERIES_REST({self.type}, {a}, {b}, "
                        f"{name}) + {b} * {low};"
                    )
                    self._low[e] = f"l{number}"
                    return

    # higher orders

    def _slope(self, e: Node) -> str:
        """Return the coefficient of order 1 of a linear series."""
        series = self.series
        if e in series.states:
            return f"unit * {self._part(series.states[e])}"
        if e is series.time:
            return "unit"
        slopes = [f"f{self._number[a]}" if series.degree[a] == 1 else None for a in e.args]
        if e.op in ("+", "-"):
            if not slopes[0]:
                return slopes[1] if e.op == "+" else f"-{slopes[1]}"
            return " ".join([slopes[0], e.op, slopes[1]] if slopes[1] else slopes[:1])
        one, other = (x or self._part(a) for x, a in zip(slopes, e.args))
        return f"{one} {e.op} {other}"

    def kth(self, e: Node) -> str | None:
        """Return the coefficient of order k, None if it is 0."""
        if self.series.degree[e] == 0:
            return None
        return f"c{self._number[e]}"

    def _over(self, e: Node) -> str | None:
        """Return the divisor of a recurrence, inverted."""
        if self.series.degree[e] < ENDLESS or e in self.series.states:
            return None
        if e.op == "/":
            return f"1.0 / {self._part(e.args[1])}"
        if e.op in ("sqrt", "power"):  # 0 stays 0, which the caller examines
            one = "0.5" if e.op == "sqrt" else "1.0"
            divisor = self.zeroth(e) if e.op == "sqrt" else f"({self._base(e.args[0])})"
            if self.four:
                return f"DAL_SERIES_INVERSE({one}, {divisor})"
            return f"{divisor} == 0.0 ? 0.0 : {one} / {divisor}"
        if e.op == "atan2" or (e.op in RULES and RULES[e.op].is_quotient):
            return f"1.0 / {self._part(self.series.other[e])}"
        return None

    def _loop(self) -> list[str]:
        series, found = self.series, list[str]()
        found.append(f"const bool exact = k < at{'[0]' * self.four}->exact;")
        found.append("const double number = (double)k, inverse = 1.0 / number;")
        found.append(f"const {self.type} divisor = number / unit, factor = inverse * unit;")
        if self.vectors:
            numbers = "" if self.four else f" double at[{4 * self.vectors}];"
            found.append(f"union {{ dal_four vectors[{self.vectors}];{numbers} }} M;")
            found.append(f"dal_series_middle(k, {self.vectors}, A, B, M.vectors);")
        for name, arrays, count, function in (
            ("N", "C, D", len(self.shared), "dal_series_shared"),
            ("P", "E, F", len(self.both_wide), "dal_series_middle"),
        ):
            if count:
                found.append(f"dal_four {name}[{count}];")
                found.append(f"{function}(k, {count}, {arrays}, {name});")
        for i, x in enumerate(series.states):
            if series.degree[x] > 0:
                text = f"DAL_SERIES_OVER(d{i}, exact, divisor, factor)"
                found.append(f"const {self.type_of(x)} c{self._number[x]} = {text};")
        for i, x in enumerate(series.given):
            found.append(f"const double c{self._number[x]} = states[k * y_width + {i}];")
        for e in series.nodes:
            if series.degree[e] > 0 and e not in series.states and e not in series.given:
                is_linear = series.degree[e] == 1
                one = f"k == 1 ? f{self._number[e]} : {self.zero(e)}"
                text = one if is_linear else self._order(e)
                found.append(f"const {self.type_of(e)} c{self._number[e]} = {text};")
        found += self._row("k", [self._cell(self.kth(e), e) for e in self._columns()])
        for names, group in (("CD", self.shared), ("EF", self.both_wide)):
            for c, pair in enumerate(group):
                for name, operand in zip(names, sorted(pair, key=lambda x: self.is_wide(x[0]))):
                    found.append(f"{name}[k * {len(group)} + {c}] = {self._operand(operand)};")
        for name, side in (("A", 0), ("B", 1)):
            operands = [self._operand(pair[side]) for pair in self._pairs]
            if not self.four:
                operands += ["0.0"] * (4 * self.vectors - len(operands))
                fours = (operands[i : i + 4] for i in range(0, len(operands), 4))
                operands = [f"(dal_four){{{', '.join(four)}}}" for four in fours]
            found += [f"{name}[k * {self.vectors} + {c}] = {x};" for c, x in enumerate(operands)]
        found += [f"b{self._number[e]} = {self.kth(e) or self.zero(e)};" for e in self._before()]
        for i, (x, rate) in enumerate(series.states.items()):
            found.append(f"d{i} = {self.widened(self.kth(rate), rate, x)};")
        return found

    def _operand(self, operand: Operand) -> str:
        e, is_weighted = operand
        text = self.kth(e)
        if text is None:
            return self.zero(e)
        if not is_weighted:
            return text
        if e in self.series.states:
            return f"unit * d{list(self.series.states).index(e)}"
        return f"number * {text}"

    def _order(self, e: Node) -> str:
        """Return the text of the coefficient of order k."""
        series, op = self.series, e.op
        M = [self._middle[pair] for pair in series.needs(e)]
        over = f"r{self._number[e]}"
        k = [self.kth(a) for a in e.args]
        zero = [self._part(a) for a in e.args]
        if op in ("+", "-"):
            if k[0] and k[1]:
                return f"{k[0]} {op} {k[1]}"
            text = k[0] or (k[1] or "0.0" if op == "+" else f"-{k[1]}")
            return self.widened(text, e.args[0 if k[0] else 1], e)
        if e in series.sides:
            return self._branch(e, e.args, 1)
        if op == "choose":
            forms = _FOUR if self.four else C.forms
            parts = [self.widened(x, a, e) for x, a in zip(k[1:], e.args[1:])]
            return forms[op].format(self.zeroth(e.args[0]), *parts)
        if op == "*":
            return self._times(e, M)
        if op == "/":
            if not k[1]:
                return f"DAL_SERIES_OVER({k[0]}, exact, {zero[1]}, {over})"
            before = f"f{self._number[e.args[1]]} * b{self._number[e]}"
            part = f"({M[0]} + {k[1]} * {self.zeroth(e)})" if M else before
            return f"({k[0]} - {part}) * {over}" if k[0] else f"-({part}) * {over}"
        if op == "sqrt":
            return f"({k[0]} - {M[0]}) * {over}"
        if op == "power":
            rest = f"DAL_SERIES_OVER({zero[1]} * {M[0]} - {M[1]}, exact, number, inverse)"
            return f"{k[0]} * g{self._number[e]} + {rest} * {over}"
        if op == "atan2":
            one = f"{k[0] or '0.0'} * {zero[1]} - {k[1] or '0.0'} * {zero[0]}"
            rest = f"DAL_SERIES_OVER({M[0]} - {M[1]} - {M[2]}, exact, number, inverse)"
            return f"({one} + {rest}) * {over}"
        return self._function(e, M, k)

    def _times(self, e: Node, M: list[str]) -> str:
        a, b = e.args
        one, other = self._part(a), self._part(b)
        k = [self.kth(a), self.kth(b)]
        if a.op == "number" and a.value == -1:
            return f"-{k[1]}"
        if fraction := _fraction(a):
            above, below = fraction
            return f"DAL_SERIES_OVER({above} * {k[1]}, exact, {below}, 1.0 / {below})"
        if not (k[0] and k[1]):
            return f"{one} * {k[1]}" if k[1] else f"{other} * {k[0]}"
        if M and a is b:
            return f"{M[0]} + 2.0 * {one} * {k[0]}"
        if M:  # what is known last is added last
            terms = [f"{k[0]} * {other}", f"{one} * {k[1]}"]
            first, last = terms if self._late[b] >= self._late[a] else terms[::-1]
            return f"({M[0]} + {first}) + {last}"
        if self.series.degree[a] != 1:
            a, b, one, k = b, a, other, k[::-1]
        return f"{one} * {k[1]} + f{self._number[a]} * b{self._number[b]}"

    def _function(self, e: Node, M: list[str], k: list[str | None]) -> str:
        rule, sign = RULES[e.op], "-" if RULES[e.op].sign < 0 else ""
        other = self.series.other[e]
        if rule.is_quotient:
            own = f"{sign}{k[0]} - DAL_SERIES_OVER({M[0]}, exact, number, inverse)"
            return f"({own}) * r{self._number[e]}"
        if not M:
            before = f"f{self._number[e.args[0]]} * b{self._number[other]}"
            return f"{sign}DAL_SERIES_OVER({before}, exact, number, inverse)"
        rest = f"DAL_SERIES_OVER({M[0]}, exact, number, inverse)"
        return f"{sign}({k[0]} * {self._part(other)} + {rest})"


_NAME = re.compile(r"[A-Za-z_]\w*")
_TYPES = "double |dal_four |dal_four_bits |int |bool "
_ASSIGNED = re.compile(rf" *(?:const )?(?:{_TYPES})?([a-z]\w*) = ")


def _used(lines: list[str]) -> list[str]:
    """Return the statements without variables that no other statement reads."""
    assigned = [found[1] if (found := _ASSIGNED.match(line)) else None for line in lines]
    names = [_NAME.findall(line) for line in lines]
    reads = Counter(name for several in names for name in several)
    reads.subtract(name for name in assigned if name)
    of_name: dict[str, list[int]] = {}
    for i, name in enumerate(assigned):
        if name:
            of_name.setdefault(name, []).append(i)
    left, gone = [name for name in of_name if reads[name] == 0], set[int]()
    while left:
        for i in of_name[left.pop()]:
            gone.add(i)
            for name in names[i]:
                reads[name] -= name != assigned[i]
                if reads[name] == 0 and name != assigned[i] and name in of_name:
                    left.append(name)
    return [line for i, line in enumerate(lines) if i not in gone]


def _fraction(e: Node) -> tuple[float, float] | None:
    """Return numerator and denominator of a number that is not a double, if they are doubles.

    Rounded, it would be a bias of the motion.
    """
    if e.op != "number":
        return None
    above, below = e.value.numerator, e.value.denominator
    is_double = below & (below - 1) == 0
    most = 2**53
    return None if is_double or max(abs(above), below) > most else (float(above), float(below))


# ---- the program -------------------------------------------------------------------------------


def expansion(made: Program, model: Model, motion: Motion, four: bool) -> None:
    """Write the series of a model, as a ``dal_series``; with expand_four, if ``four``."""
    read = model.derived.read
    q, p, u = ([read(x) for x in part] for part in (model.q, model.p, model.u))
    time = read(TIME)
    y = [*q, *motion.w]
    series = series_of(model, motion)
    of = {"p": p, "u": u, "y": y}
    made.add("#ifdef __GNUC__")
    one = Writer(series, *places(of, time, "p[{}]", "at->{}"), False)
    made.add(_EXPAND + "    dal_four *const A = (dal_four *)work, "
             f"*const B = A + order * {one.vectors};\n" * bool(one.vectors)
             + "    const double *const p = parameters, unit = at->unit;\n    (void)p, (void)work;")
    made.lines += [f"    {line}" for line in one.lines()]
    made.add("}\n")
    has_four = four and motion.in_D and not series.sides
    if has_four:
        of_four = places(of, time, "DAL_SERIES_OF(p, [{}])", "DAL_SERIES_OF(at, ->{})")
        writer = Writer(series, *of_four, True)
        made.add(_EXPAND_FOUR + "    dal_four *const A = (dal_four *)work, "
                 f"*const B = A + order * {writer.vectors};\n" * bool(writer.vectors))
        made.lines += [f"    {line}" for line in writer.lines()]
        made.add("}\n")
    made.add(_SUMS.format(width=one.width))
    at_y = {"y": y, "u": u, "p": p}
    written_values(made, "velocity", "v", motion.velocity, at_y, time)
    x = {"x": [*q, *(read(s) for s in model.v)], "u": u, "p": p}
    written_values(made, "quasi", "w", motion.quasi, x, time)
    sizes = (len(y), len(series.switches), len(series.exponents), one.width,
             8 * one.vectors)  # fmt: skip
    flags = int(motion.in_D), int(series.is_doubtful)
    made.add(
        "static const dal_series model_series = {\n"
        f"    DAL_SERIES_ABI, {', '.join(map(str, (*sizes, *flags)))},\n"
        f"    model_expand, {'model_expand_four' if has_four else 'NULL'}, model_decay,\n"
        "    model_sum,\n"
        "    model_slope, model_velocity, model_quasi};\n"
        "#define MODEL_SERIES &model_series\n#else\n#define MODEL_SERIES NULL\n#endif\n"
    )


def along(made: Program, model: Model, motion: Motion, functions: Sequence[Node]) -> None:
    """Write the series of functions of the state along motions, as a ``dal_event_series``."""
    read = model.derived.read
    q, v, p = ([read(x) for x in part] for part in (model.q, model.v, model.p))
    time, y = read(TIME), [*q, *motion.w]
    graph = time.graph
    functions = graph.replaced(functions, dict(zip(v, motion.velocity)))
    series = Series({}, time, y, functions)
    of = {"p": p, "u": [read(x) for x in model.u], "y": y}
    writer = Writer(series, *places(of, time, "p[{}]", "at->{}"), False)
    made.add("#ifdef __GNUC__")
    made.add(_EXPAND_ALONG + "    dal_four *const A = (dal_four *)work, "
             f"*const B = A + (order + 1) * {writer.vectors};\n" * bool(writer.vectors)
             + "    const double *const p = parameters, unit = at->unit;\n"
             "    (void)p, (void)work, (void)unit, (void)states, (void)y_width;")  # fmt: skip
    made.lines += [f"    {line}" for line in writer.lines()]
    made.add("}\n")
    made.add(_DECAY.format(width=writer.width))
    sizes = (len(y), len(functions), len(series.switches), len(series.exponents), writer.width,
             8 * writer.vectors, int(series.is_doubtful))  # fmt: skip
    made.add(
        "DAL_API const dal_event_series dal_model_along = {\n"
        f"    DAL_SERIES_ABI, {', '.join(map(str, sizes))}, model_along, model_decay}};\n#endif\n"
    )


def places(
    of: Mapping[str, Sequence[Node]], time: Node, parameter: str, number: str
) -> tuple[dict[str, str], dict[str, str]]:
    """Return the texts of symbols, by name, and of their parts below the last digit."""
    found = {time.value: number.format("t")}
    found |= {x.value: parameter.format(i) for i, x in enumerate(of["p"])}
    for name in ("u", "y"):
        found |= {x.value: number.format(f"{name}[{i}]") for i, x in enumerate(of[name])}
    low = {x.value: number.format(f"low[{i}]") for i, x in enumerate(of["y"])}
    return found, low | {time.value: "0.0"}


# Operations of numbers of four motions: a condition has all bits or none.
_FOUR = C.forms | {
    "choose": "DAL_SERIES_CHOOSE({}, {}, {})", "and": "({} & {})", "or": "({} | {})",
    "not": "~{}", "true": "~(dal_four_bits){{0}}",
}  # fmt: skip

# A comparison of two numbers is one of the side of their difference with 0.
_SIDES = {"<": "<", "<=": "<=", "==": "==", "!=": "!="}

_EXPAND = """static void model_expand(const dal_series_at *at, size_t order, double *Y,
                         double *work, const void *parameters)
{
"""

_EXPAND_FOUR = """static void model_expand_four(const dal_series_at *const *at, size_t order,
                              double *const *Y, double *work, const void *const *parameters)
{
    const double *const *const p = (const double *const *)parameters;
    const dal_four unit = DAL_SERIES_OF(at, ->unit), zero = {0.0};
    (void)p, (void)work, (void)zero;
"""

_EXPAND_ALONG = """static void model_along(const dal_series_at *at, size_t order,
                        const double *states, size_t y_width, double *Y, double *work,
                        const void *parameters)
{
"""

_DECAY = """static void model_decay(size_t order, const double *Y, double *decay)
{{
    dal_series_decay({width}, order, Y, decay);
}}
"""

_SUMS = _DECAY + """
static void model_sum(size_t order, double s, const double *Y, double *change)
{{
    dal_series_sum({width}, order, s, Y, change);
}}

static void model_slope(size_t order, double s, const double *Y, double *slope)
{{
    dal_series_slope({width}, order, s, Y, slope);
}}
"""


def written_values(
    made: Program, name: str, out: str, nodes: Sequence[Node],
    arrays: Mapping[str, Sequence[Node]], time: Node,
) -> None:  # fmt: skip
    """Write a function of the time, arrays and parameters p, with the values of nodes in ``out``.

    The arguments are the arrays in their order, but for p, then ``out`` and the parameters.
    """
    given = [key for key in arrays if key != "p"]
    listed = ", ".join(f"const double *{key}" for key in given)
    made.add(f"static void model_{name}(double t, {listed},\n    double *{out}, "
             "const void *parameters)\n{")  # fmt: skip
    made.add("    const double *const p = parameters;")
    made.add("    (void)t, (void)p, " + ", ".join(f"(void){key}" for key in (*given, out)) + ";")
    nodes = spelled(nodes)
    where = {x.value: f"{key}[{i}]" for key, x in arrays.items() for i, x in enumerate(x)}
    text = Text(nodes, C, where | {time.value: "t"})
    made.lines += [f"    {line}" for line in text.names(below(nodes), nodes)]
    made.lines += [f"    {out}[{i}] = {text.whole(e)};" for i, e in enumerate(nodes)]
    made.add("}\n")
