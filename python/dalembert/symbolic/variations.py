"""C of the variational equations of a model: Taylor series of derivatives along motions.

The series of a motion are known there, so those of its derivatives are linear recurrences.
Derivatives in four directions are computed at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .expansion import Writer, places, written_values
from .graph import Node, below
from .model import Model
from .motion import Motion
from .printing import Program
from .recurrences import BRANCHING, Series
from .symbols import TIME


class Directions:
    """Symbols of the directions of derivatives: of the states, and of parameters and inputs.

    Derivatives of order 1 are in a direction a; those of order 2 in a and b.
    """

    def __init__(self, model: Model, motion: Motion, order: int) -> None:
        read = model.derived.read
        self.y = [*map(read, model.q), *motion.w]
        self.x = [*map(read, model.q), *map(read, model.v)]
        self.z = [*map(read, model.p), *map(read, model.u)]
        self.graph = read(TIME).graph
        self.names = "a" if order == 1 else "ab"
        several = ("a",) if order == 1 else ("a", "b", "ab")
        self.states = [self._symbols(f"{name}_y", self.y) for name in several]
        self.others = [self._symbols(f"{name}_z", self.z) for name in self.names]
        self.at_x = self._symbols("a_x", self.x)

    def _symbols(self, prefix: str, of: Sequence[Node]) -> list[Node]:
        return [self.graph.symbol(f"{prefix}{i}") for i in range(len(of))]

    def of_states(self, nodes: Sequence[Node]) -> list[list[Node]]:
        """Return the derivatives of nodes in (t, y, z): in a, or in a, in b, and in both."""
        found = []
        for states, others in zip(self.states, self.others):
            direction = dict(zip(self.y, states)) | dict(zip(self.z, others))
            found.append(self.graph.along(nodes, direction))
        if len(self.names) == 1:
            return found
        a, b, both = self.states
        direction = dict(zip(self.y, b)) | dict(zip(self.z, self.others[1])) | dict(zip(a, both))
        return [*found, self.graph.along(found[0], direction)]


def variations(made: Program, model: Model, motion: Motion, order: int) -> None:
    """Write the variational equations of a model, as a ``dal_variation_series``."""
    at = Directions(model, motion, order)
    rates = at.of_states([*motion.velocity, *motion.rates])
    states = {x: rate for xs, each in zip(at.states, rates) for x, rate in zip(xs, each)}
    series = _series(model, motion, at, states)
    columns = [*states, *(x for xs in at.others for x in xs)]
    wide = {x.value: f"columns[{i}]" for i, x in enumerate(columns)}
    read = model.derived.read
    time, p, u = read(TIME), [*map(read, model.p)], [*map(read, model.u)]
    known, low = places({"p": p, "u": u, "y": at.y}, time, "p[{}]", "at->{}")
    writer = Writer(series, known | wide, low, wide=wide)
    shared, both = len(writer.shared), len(writer.both_wide)
    room = 8 * (writer.vectors + shared + both)
    made.add("#ifdef __GNUC__")
    made.add(
        _EXPAND.format(narrow=writer.vectors, shared=shared, both=both)
        + "    const double *const p = parameters, unit = at->unit;\n"
        "    const dal_four zero = {0.0};\n"
        "    (void)p, (void)A, (void)B, (void)C, (void)D, (void)E, (void)F, (void)zero;\n"
        "    (void)states, (void)y_width;"
    )
    made.lines += [f"    {line}" for line in writer.lines()]
    made.add("}\n")
    made.add(_LEAD.format(width=writer.width, moving=len(states)))
    velocity = [e for each in at.of_states(motion.velocity) for e in each]
    arrays = {"y": at.y, "u": u, "columns": columns, "p": p}
    written_values(made, "velocity_along", "values", velocity, arrays, time)
    direction = dict(zip([*at.x, *at.z], [*at.at_x, *at.others[0]]))
    quasi = at.graph.along(motion.quasi, direction)
    arrays = {"x": at.x, "u": u, "columns": [*at.at_x, *at.others[0]], "p": p}
    written_values(made, "quasi_along", "values", quasi, arrays, time)
    sizes = (order, len(at.y), len(p), len(u), len(series.functions), writer.width, room)
    made.add(
        "static const dal_variation_series model_variations = {\n"
        f"    DAL_SERIES_ABI, {', '.join(map(str, sizes))},\n"
        "    model_vary, model_decay_of_four, model_lead, model_velocity_along,\n"
        "    model_quasi_along};\n"
        "#define MODEL_VARIATIONS &model_variations\n#else\n#define MODEL_VARIATIONS NULL\n#endif\n"
    )


def _series(
    model: Model, motion: Motion, at: Directions, states: Mapping[Node, Node]
) -> Series:
    """Return the recurrences of the columns, with the switches of the series of the motion.

    Its functions are the derivatives of the switches.
    """
    time, rates = model.derived.read(TIME), [*motion.velocity, *motion.rates]
    branches = [e for e in below(rates) if e.op in BRANCHING]
    base = Series(dict(zip(at.y, rates)), time, functions=branches)
    differences: dict[int, Node] = {}
    for e, prepared in zip(branches, base.functions):
        if prepared in base.sides:
            switch, sign = base.sides[prepared]
            differences[switch] = at.graph.scaled(sign, _difference(e))
    slopes = at.of_states([differences[i] for i in sorted(differences)])[0]
    count = len(slopes) if len(at.names) == 1 else 0
    found = Series(states, time, at.y, [*slopes[:count], *branches])
    number: dict[int, tuple[int, int]] = {}
    for prepared, known in zip(found.functions[count:], base.functions):
        if prepared in found.sides:
            (one, sign), (other, sign_known) = found.sides[prepared], base.sides[known]
            number[one] = other, sign * sign_known
    found.sides = {e: (number[k][0], s * number[k][1]) for e, (k, s) in found.sides.items()}
    found.functions = found.functions[:count]
    return found


def _difference(e: Node) -> Node:
    """Return the number whose sign chooses the branch of a function."""
    return e.args[0] if len(e.args) == 1 or e.op == "step" else e.args[0] - e.args[1]


_EXPAND = """static void model_vary(const dal_series_at *at, size_t order, const double *states,
                       size_t y_width, const dal_four *columns, dal_four *Y, double *work,
                       const void *parameters)
{{
    const size_t rows = order + 1;
    dal_four *const D = (dal_four *)work, *const E = D + rows * {shared};
    dal_four *const F = E + rows * {both};
    dal_four *const A = (dal_four *)(F + rows * {both}), *const B = A + rows * {narrow};
    double *const C = (double *)(B + rows * {narrow});
"""

_LEAD = """static void model_decay_of_four(size_t order, const dal_four *Y, double *decay)
{{
    dal_series_decay(4 * {width}, order, (const double *)Y, decay);
}}

static void model_lead(size_t order, double s, const dal_four *Y, dal_four *columns)
{{
    dal_four change[{width}];
    dal_series_sum(4 * {width}, order, s, (const double *)Y, (double *)change);
    for (size_t i = 0; i < {moving}; i++) columns[i] += change[i];
}}
"""
