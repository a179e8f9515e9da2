"""Generation of C from a model: callbacks, step routine, and definition of the system.

The program contains texts of the user only in string constants that are escaped byte by byte.  C
programs also contain names of parameters that are not reserved in C and C++. Each callback computes
common subexpressions of its outputs once, and those of a single output only if it is requested.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import keyword
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import sympy
from sympy.logic.boolalg import BooleanFalse, BooleanTrue

from .model import FUNCTIONS, Function, Model, nearest
from .pattern import MOST, field_zeros, pattern

GENERATOR = 4  # changes with what is generated, as the files of this module do

# Above this number of coordinates a step routine of the model's own, whose arrays are on the stack,
# gains nothing over the library's.
_LARGEST = 32

# What the step routine and the field alone call.
_MAYBE_UNUSED = ("t", "q", "v", "u", "start", "phi_t", "L_vt", "M", "mu", "g", "C")
_OF_STEPS = ("balance", "pull", "terms")

# Above this number of zeros they are written to an output by a loop.
_MOST_ZEROS = 64

# Above this number of operations a callback is a function that the step routine calls.
_INLINED = 400

_SIGNATURES = {
    "potential": "double t, const double *q, double *V, double *V_q, double *V_qq",
    "constraint": "double t, const double *q, const double *v, double *phi, double *phi_v, "
    "double *phi_q, double *phi_t",
    "lagrangian": "double t, const double *q, const double *v, double *L, double *L_q, "
    "double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt",
    "force": "double t, const double *q, const double *v, const double *u, double *f, "
    "double *f_q, double *f_v",
    "balance": "double t, const double *q, const double *v, const double *u, double *L_v, "
    "double *F, double *L_vq, double *L_vv, double *F_q, double *F_v",
    "pull": "double t, const double *q, const double *u, double *V_q",
    "terms": "double t, const double *q, const double *v, const double *u, double *F, double *M, "
    "double *mu, double *g, double *C",
    "exact": "double t, const double *start, double *x",
    "invariant": "double t, const double *start, double *values",
    "mass": "double *M",
    "state": "double *x",
}


def _signature(model: Model, name: str) -> str:
    """Return the arguments of a callback."""
    signature = _SIGNATURES[name]
    if name == "constraint" and model.is_driven:
        return signature.replace("double *phi,", "const double *u, double *phi,")
    return signature


@dataclass
class Program:
    """C source, line by line.

    Attributes
    ----------
    lines : list of (str, callable or None)
        A line, and a function that returns a description of its result and its expression; None if
        it has no expression.
    """

    lines: list[tuple[str, Callable[[], tuple[str, Any]] | None]] = field(default_factory=list)

    @property
    def source(self) -> str:
        """The source code."""
        return "".join(f"{line}\n" for line, _ in self.lines)

    def add(self, text: str) -> None:
        """Add lines without an expression."""
        self.lines.extend((line, None) for line in text.split("\n"))

    def origin(self, number: int, shown: Callable[[Any], Any]) -> str:
        """Return the result that a line, counted from 1, computes, in terms of ``shown``."""
        _, origin = self.lines[number - 1]
        if origin is None:
            return ""
        what, expression = origin()
        return f"{what} = {shown(expression)}"


def is_compact(model: Model) -> bool:
    """Return whether steps of a model benefit from the sparsity of its constraints.

    The library then supplies the steps, and the program has no step routine.
    """
    derived, n = model.derived, model.n
    if n <= MOST or model.m == 0 or derived.mass is None or derived.kind != "linear":
        return False
    is_diagonal = all(e == 0 for k, e in enumerate(derived.mass) if k % (n + 1) != 0)
    return is_diagonal and 2 * len(model.sparsity[0]) <= model.m * n


def program(
    model: Model, name: str | None = None, system: Any = None, compact: bool | None = None,
    lanes: bool = False,
) -> Program:  # fmt: skip
    """Return the program of a model.

    Parameters
    ----------
    model : Model
    name : str, optional
        If given, the program ends with a constructor ``name_system`` for C, with the names, the
        help and the values of parameters of ``system``.  Otherwise it ends with the data that the
        package loads.
    compact : bool, optional
        Whether the system declares the sparsity of its constraints, so that the library supplies
        the steps.  Default: `is_compact`.
    lanes : bool, optional
        Whether the program also has a step routine for several members at once, see `has_lanes`.
    """
    made, body = Program(), Program()
    derived = model.derived
    compact = is_compact(model) if compact is None else compact
    fast = model.n <= _LARGEST and not compact
    made.add(
        f"/* Generated by dalembert: a system of {model.n} coordinates and {model.m} velocity\n"
        " * constraints.  Compile with -ffp-contract=off: then all compilations of the step\n"
        " * routine give the same bits. */\n"
        "#include <dalembert.h>" + "\n#include <dalembert/kernel.h>" * fast
        + "\n#include <dalembert/lanes.h>" * lanes
        + "\n#include <math.h>\n#include <stddef.h>\n"
    )  # fmt: skip
    powers: set[int] = set()
    own_field = fast and model.n <= MOST  # in large models it would gain nothing
    for function in (*derived.functions, *([model.terms] if own_field else ())):
        if compact and function.name in ("mass", "constraint"):
            function = _alone(model, function)
        if fast or function.name not in _OF_STEPS:
            _function(body, model, function, fast, Printer(powers))
    if fast:
        _kernel(body, model)
        if own_field:
            _field(body, model)
        if lanes:
            _lanes(body, model)
        _compiled(body, model, lanes)
    for exponent in sorted(powers):
        _power(made, exponent)
    for helper, rest in _HELPERS.items():
        if any(f"{helper}(" in line for line, _ in body.lines):
            made.add(f"static inline double {helper}{rest}")
    made.lines += body.lines
    if compact:
        _sparsity(made, model)
    if model.parameters:
        _parameters(made, model)
    definition = _definition(model, fast, compact)
    if name is None:
        _for_the_package(made, model, definition)
    else:
        _constructor(made, model, definition, name, system, compact)
    return made


# Where an argument is no number, they are none.
_HELPERS = {
    "model_sign": """(double x)
{
    return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x;
}""",
    "model_step": """(double x, double at_zero)
{
    return x > 0.0 ? 1.0 : x < 0.0 ? 0.0 : x == 0.0 ? at_zero : x;
}""",
    "model_larger": "(double a, double b) { return a > b || a != a ? a : b; }",
    "model_smaller": "(double a, double b) { return a < b || a != a ? a : b; }",
}


def _power(made: Program, exponent: int, vector: bool = False) -> None:
    """Write x^exponent as products, by repeated squaring."""
    steps, name, have = [], "x", 1
    for bit in bin(exponent)[3:]:
        steps.append(f"const double s{2 * have} = {name} * {name};")
        name, have = f"s{2 * have}", 2 * have
        if bit == "1":
            steps.append(f"const double s{have + 1} = {name} * x;")
            name, have = f"s{have + 1}", have + 1
    text = f"static inline double model_power_{exponent}(double x) {{ "
    text += " ".join(steps) + f" return {name}; }}"
    if vector:
        text = text.replace("double", "dal_vec")
        text = text.replace(f"model_power_{exponent}", f"DAL_LANES(model_power_{exponent})")
    made.add(text)


# ---- callbacks ---------------------------------------------------------------------------------


def _function(
    made: Program, model: Model, function: Function, fast: bool, print_c: Printer
) -> None:
    """Write a callback: common subexpressions, then each requested output."""
    give, values = function.engine.give, _written(function)
    temporaries, reduced = function.engine.cse([e for x in values.values() for e in x.values()])
    temporaries = [(give(s), give(e)) for s, e in temporaries]
    left = map(give, reduced)
    values = {output: dict(zip(entries, left)) for output, entries in values.items()}
    computed = [*(e for x in values.values() for e in x.values()), *(e for _, e in temporaries)]
    signature, real = _signature(model, function.name), print_c.real
    takes_inputs = "double *u" in signature
    inline = fast and function.name in ("constraint", "potential", *_OF_STEPS)
    inline = inline and _are_few(computed)
    used = {s.name for e in computed for s in e.free_symbols}

    made.add("DAL_KERNEL_INLINE int" if inline else "static int")
    name = print_c.name(f"model_{function.name}")
    made.add(f"{name}({signature}, const double *p)\n{{".replace("double", real))
    n = model.n
    arrays = [("start", 2 * n)] if "start" in signature else [("q", n), ("v", n)]
    arrays += [("u", len(model.u))] if takes_inputs else []
    arrays.append(("p", len(model.p)))
    places = (f"{name}[{i}]" for name, count in arrays for i in range(count))
    inputs = model.u if takes_inputs else ()
    for symbol, place in zip((*model.q, *model.v, *inputs, *model.p), places):
        if symbol.name in used:
            made.add(f"    const {real} {symbol.name} = {place};")
    unused = [i for i in _names(signature) if i in _MAYBE_UNUSED]
    made.add("    " + ", ".join(f"(void){name}" for name in [*unused, "p"]) + ";")
    _outputs(made, model, function, temporaries, values, print_c)
    made.add("    return 0;\n}\n")
    if function.name not in ("mass", "state", *_OF_STEPS) and real == "double":
        names = ", ".join(_names(signature))
        made.add(f"static int model_call_{function.name}({signature}, void *ctx)\n{{")
        made.add(f"    return model_{function.name}({names}, ctx);\n}}\n")


def _alone(model: Model, function: Function) -> Function:
    """Return a function with only the diagonal of M, or only the entries of the sparsity."""
    n = model.n
    kept = [i * n + j for i, j in zip(*model.sparsity)]
    of_matrices = {"M": range(0, n * n, n + 1), "phi_v": kept, "phi_q": kept}
    outputs = {
        x: [entries[k] for k in of_matrices[x]] if x in of_matrices else entries
        for x, entries in function.outputs.items()
    }
    return dataclasses.replace(function, outputs=outputs)


def _written(function: Function) -> dict[str, dict[int, Any]]:
    """Return the entries of each output that are written one by one, without most zeros."""
    found = {}
    for output, expressions in function.outputs.items():
        there = {k: e for k, e in enumerate(expressions) if e != 0}
        few = len(expressions) - len(there) <= _MOST_ZEROS
        found[output] = dict(enumerate(expressions)) if few else there
    return found


def _outputs(
    made: Program,
    model: Model,
    function: Function,
    temporaries: Sequence[tuple[Any, Any]],
    values: dict[str, dict[int, Any]],
    print_c: Printer,
) -> None:
    """Write the computation of the outputs; shared subexpressions come first."""
    users = _users(temporaries, values)

    def compute(left: str, expression: Any, what: str) -> None:
        try:
            line = f"{left} = {print_c.whole(expression)};"
        except ValueError as error:
            raise ValueError(f"{what} of the {function.name}: {error}") from None
        made.lines.append((line, functools.partial(_origin, what, expression, temporaries)))

    def parts(are_here: Callable[[set[str]], bool], indent: str) -> None:
        for symbol, expression in temporaries:
            if are_here(users[symbol]):
                what = f"a part of {' and '.join(sorted(users[symbol]))}"
                compute(f"{indent}const {print_c.real} {symbol.name}", expression, what)

    parts(lambda by: len(by) > 1, "    ")
    for output, entries in values.items():
        made.add(f"    if ({output}) {{")
        parts(lambda by, output=output: by == {output}, "        ")
        size = len(function.outputs[output])
        if len(entries) < size:
            zero = print_c.whole(sympy.Integer(0))
            made.add(f"        for (size_t i = 0; i < {size}; i++) {output}[i] = {zero};")
        is_matrix = size > model.n and size in (model.n**2, model.n * model.m)
        for k, expression in entries.items():
            index = f"{k // model.n}, {k % model.n}" if is_matrix else f"{k}"
            compute(f"        {output}[{k}]", expression, f"{output}[{index}]")
        made.add("    }")


def _are_few(expressions: Sequence[Any]) -> bool:
    """Return whether expressions have few enough operations for inlining."""
    left = _INLINED
    return all((left := left - sympy.count_ops(e)) >= 0 for e in expressions)


def _names(signature: str) -> list[str]:
    """Return the names of the arguments."""
    return [part.split()[-1].lstrip("*") for part in signature.split(",")]


def _users(
    temporaries: Sequence[tuple[Any, Any]], values: dict[str, dict[int, Any]]
) -> dict[Any, set[str]]:
    """Return for each temporary the outputs that depend on it."""
    users: dict[Any, set[str]] = {symbol: set() for symbol, _ in temporaries}
    for output, entries in values.items():
        for expression in entries.values():
            for symbol in expression.free_symbols & users.keys():
                users[symbol].add(output)
    for symbol, expression in reversed(temporaries):
        for part in expression.free_symbols & users.keys():
            users[part] |= users[symbol]
    return users


def _origin(what: str, expression: Any, temporaries: Sequence[tuple[Any, Any]]) -> tuple[str, Any]:
    """Return the description of a result, and its expression without temporaries."""
    known: dict[Any, Any] = {}
    for symbol, part in temporaries:
        known[symbol] = part.xreplace(known)
    return what, expression.xreplace(known)


# ---- the step routine --------------------------------------------------------------------------


def _kernel(made: Program, model: Model) -> None:
    """Include kernel.h with the sizes and the callbacks of the model."""
    derived, zeros = model.derived, pattern(model)
    macros = {"N": model.n, "M": model.m}
    constrain = "((void)(k), (void)(t), (void)(q), (void)(v), (void)(mu), (void)(N), 0)"
    constrain_all = constrain.replace("(void)(mu)", "(void)(phi), (void)(mu)")
    if model.m > 0:
        made.add(_INSIDE["constraint"].format(u="k->input, " if model.is_driven else ""))
        constrain = "model_inside_constraint(k, t, q, v, NULL, mu, N)"
        constrain_all = "model_inside_constraint(k, t, q, v, phi, mu, N)"
    macros["KERNEL"] = "model_steps"
    macros["KERNEL_CONSTRAINT(k, t, q, v, mu, N)"] = constrain
    if initializer := zeros.initializer():
        macros["KERNEL_PATTERN"] = initializer
    macros["KERNEL_STEADY"] = int(zeros.steady) + int(zeros.apart)
    counted = {"potential": derived.function("potential"), "force": derived.function("force")}
    counted["lagrangian"] = derived.function("lagrangian")
    count = "".join(f"    k->stats.{x}_calls++;\n" for x, there in counted.items() if there)
    if derived.has_momenta:
        made.add(_INSIDE["balance"].format(count=count))
        values = "model_inside_balance(k, t, q, v, L_v, F, NULL, NULL, NULL, NULL)"
        macros |= {
            "KERNEL_MOMENTA": "",
            "KERNEL_MASS": int(derived.mass is not None and derived.kind == "linear"),
            "KERNEL_KIND(k)": f"DAL_{derived.kind.upper()}",
            "KERNEL_FORMS(k, t, q, v, phi, mu, N)": constrain_all,
            "KERNEL_BALANCE(k, t, q, v, L_v, F, L_vq, L_vv, F_q, F_v)":
                "model_inside_balance(k, t, q, v, L_v, F, L_vq, L_vv, F_q, F_v)",
            "KERNEL_VALUES(k, t, q, v, L_v, F, late)": values,
            "KERNEL_START(k, t, q, v, L_v, F)": "model_start(k, t, q, v, L_v, F)",
        }  # fmt: skip
    elif derived.is_positional or counted["potential"] is not None:
        name, u = ("pull", "k->input, ") if derived.is_positional else ("potential", "NULL, ")
        tail = "V_q" if derived.is_positional else "V_q, NULL"
        made.add(_INSIDE["pull"].format(count=count, call=f"model_{name}(t, q, {u}{tail}"))
        macros["KERNEL_POTENTIAL(k, t, q, V_q)"] = "model_inside_pull(k, t, q, V_q)"
    for name, text in macros.items():
        made.add(f"#define DAL_{name} {text}".rstrip())
    made.add("#include <dalembert/kernel.h>\n")


def _field(made: Program, model: Model) -> None:
    """Write the ODE on D."""
    n, m, moves = model.n, model.m, model.derived.mass is None
    sizes = {"F": n, "mu": m * n, "g": m, "Z": m * n, "C": m * m, "lambda": m, "w": 2 * n}
    sizes |= {"M": n * n} if moves else {}
    arrays = ", ".join(f"{name}[{max(size, 1)}]" for name, size in sizes.items())
    members = ", ".join(f".{name} = {name}" for name in sizes)
    masses = "" if moves else ", .inverse = mass_inverse"
    known = "C" in model.terms.outputs
    masses += ", .given = true" if known else ""
    given = "(void)mass_inverse" if moves else "if (!mass_inverse) return 0"
    made.add(
        "static int model_field(double t, const double *x, const double *u,\n"
        "    const double *mass_inverse, double *xdot, void *ctx)\n{\n"
        f"    double {arrays};\n"
        f"    const dal_field_terms at = {{{members}{masses}}};\n"
        f"    {given};\n"
        f"    (void)model_terms(t, x, x + {n}, u, F, {'M' if moves else 'NULL'}, "
        f"{'mu, g' if m else 'NULL, NULL'}, {'C' if known else 'NULL'}, ctx);\n"
        f"    return dal_field_solve({n}, {m}, (dal_field_zeros){field_zeros(model)}, &at, "
        f"x + {n}, xdot);\n}}\n"
    )


def _compiled(made: Program, model: Model, lanes: bool) -> None:
    """Write the object for the member ``compiled`` of the definition."""
    made.add(
        "static const dal_compiled model_compiled = {\n"
        "    DAL_COMPILED_ABI, sizeof(dal_kernel), model_steps, "
        f"{int(model.derived.has_momenta)}, {int(model.force is not None)}, "
        f"{'model_lanes' if lanes else 'NULL'}, "
        f"{'model_field' if model.n <= MOST else 'NULL'}}};\n"
    )


_INSIDE = {
    "constraint": """DAL_KERNEL_INLINE int model_inside_constraint(dal_kernel *k, double t,
    const double *q, const double *v, double *phi, double *mu, double *N)
{{
    k->stats.constraint_calls++;
    return model_constraint(t, q, v, {u}phi, mu, N, NULL, k->constraint_ctx);
}}
""",
    "pull": """DAL_KERNEL_INLINE int model_inside_pull(dal_kernel *k, double t, const double *q,
    double *V_q)
{{
{count}    return {call}, k->constraint_ctx);
}}
""",
    "balance": """DAL_KERNEL_INLINE int model_inside_balance(dal_kernel *k, double t,
    const double *q, const double *v, double *L_v, double *F, double *L_vq, double *L_vv,
    double *F_q, double *F_v)
{{
{count}    return model_balance(t, q, v, k->input, L_v, F, L_vq, L_vv, F_q, F_v, k->constraint_ctx);
}}

DAL_KERNEL_NOINLINE int model_start(dal_kernel *k, double t, const double *q, const double *v,
    double *L_v, double *F)
{{
    return model_inside_balance(k, t, q, v, L_v, F, NULL, NULL, NULL, NULL);
}}
""",
}


# ---- the step routine of several members at once -----------------------------------------------


# How many lanes there are in a vector, and what the compiler is told to use for them.
_SETS = {8: "avx512f,avx512dq", 4: "avx2", 2: ""}

_BEGIN = """#ifdef __clang__
#pragma clang attribute push(__attribute__((target("{target}"))), apply_to = function)
#else
#pragma GCC push_options
#pragma GCC target("{target}")
#endif"""

_END = """#ifdef __clang__
#pragma clang attribute pop
#else
#pragma GCC pop_options
#endif"""

_VECTOR_HELPERS = """DAL_KERNEL_INLINE dal_vec DAL_LANES(model_sign)(dal_vec x)
{
    return DAL_LANES(choose)(x > 0.0, DAL_LANES(all_of)(1.0),
                             DAL_LANES(choose)(x < 0.0, DAL_LANES(all_of)(-1.0), x));
}
DAL_KERNEL_INLINE dal_vec DAL_LANES(model_step)(dal_vec x, dal_vec at_zero)
{
    return DAL_LANES(choose)(x > 0.0, DAL_LANES(all_of)(1.0), DAL_LANES(choose)(x < 0.0,
        DAL_LANES(all_of)(0.0), DAL_LANES(choose)(x == 0.0, at_zero, x)));
}
DAL_KERNEL_INLINE dal_vec DAL_LANES(model_larger)(dal_vec a, dal_vec b)
{
    return DAL_LANES(choose)((a > b) | (a != a), a, b);
}
DAL_KERNEL_INLINE dal_vec DAL_LANES(model_smaller)(dal_vec a, dal_vec b)
{
    return DAL_LANES(choose)((a < b) | (a != a), a, b);
}
"""

# What libmvec has had from its beginning; sqrt, which is rounded right, it has not at all.
_EARLY = ("sin", "cos", "exp", "log", "pow")


def has_lanes(model: Model) -> bool:
    """Return whether several members can be stepped at once."""
    return model.n <= MOST


def _lanes(made: Program, model: Model) -> None:
    """Include lanes.h for each set of instructions, with the sizes and callbacks of the model."""
    derived = model.derived
    made.add("#ifdef __GNUC__")
    for vector, target in _SETS.items():
        if target:
            made.add("#ifdef __x86_64__\n" + _BEGIN.format(target=target))
        made.add(f"#define DAL_LANES(name) name##_{vector}\n#define DAL_LANES_VECTOR {vector}")
        made.add("#include <dalembert/lanes.h>\n")
        _vector_callbacks(made, model)
        macros = {"N": model.n, "M": model.m}
        zeros = pattern(model)
        macros["LANES_PATTERN"] = zeros.initializer()
        macros["LANES_STEADY"] = int(zeros.steady) + int(zeros.apart)
        if model.m > 0:
            u = "u, " if model.is_driven else ""
            macros["LANES_CONSTRAINT(t, q, v, phi, mu, N, u, p)"] = (
                f"(void)DAL_LANES(model_constraint)(t, q, v, {u}phi, mu, N, NULL, p)"
            )
        force = _force(model)
        if force == "balance":
            macros |= {
                "LANES_MASS": int(derived.mass is not None and derived.kind == "linear"),
                "LANES_KIND": f"DAL_{derived.kind.upper()}",
                "LANES_BALANCE(t, q, v, L_v, F, L_vq, L_vv, F_q, F_v, u, p)":
                    "(void)DAL_LANES(model_balance)(t, q, v, u, L_v, F, L_vq, L_vv, F_q, F_v, p)",
            }  # fmt: skip
        elif force:
            arguments = "t, q, u, V_q" if force == "pull" else "t, q, NULL, V_q, NULL"
            macros["LANES_FORCE(t, q, V_q, u, p)"] = (
                f"(void)DAL_LANES(model_{force})({arguments}, p)"
            )
        for name, text in macros.items():
            made.add(f"#define DAL_{name} {text}")
        made.add("#include <dalembert/lanes.h>")
        if target:
            made.add(_END + "\n#endif")
    made.add("#endif\n\nstatic const dal_lanes_routine model_lanes[] = {")
    made.add("#ifdef __GNUC__")
    for vector, target in _SETS.items():
        entry = f"    {{{vector}, {len(model.p)}, {len(model.inputs)}, advance_{vector}}},"
        made.add(f"#ifdef __x86_64__\n{entry}\n#endif" if target else entry)
    made.add("#endif\n    {0, 0, 0, NULL}};\n")


def _force(model: Model) -> str | None:
    """Return the function with the forces of the steps, if there is one."""
    if model.derived.has_momenta:
        return "balance"
    if model.derived.is_positional:
        return "pull"
    return "potential" if model.derived.function("potential") is not None else None


def _vector_callbacks(made: Program, model: Model) -> None:
    """Write the callbacks of the steps, and their functions, for vectors."""
    powers: set[int] = set()
    body, print_c = Program(), VectorPrinter(powers)
    for function in model.derived.functions:
        if function.name in ("constraint", _force(model)):
            _function(body, model, function, True, print_c)
    for name in sorted(print_c.called):
        ending = f"_OF_TWO({name})" if name in ("pow", "atan2") else f"({name})"
        if name == "sqrt":
            made.add(f"DAL_LANES_EACH{ending}")
            continue
        made.add(f"#if DAL_LANES_LIBMVEC >= {1 if name in _EARLY else 2}")
        made.add(f"DAL_LANES_AT_ONCE{ending}\n#else\nDAL_LANES_EACH{ending}\n#endif")
    for exponent in sorted(powers):
        _power(made, exponent, vector=True)
    made.add(_VECTOR_HELPERS)
    made.lines += body.lines


# ---- the system --------------------------------------------------------------------------------


def _sparsity(made: Program, model: Model) -> None:
    """Write the rows and columns of the entries of the Jacobians of the constraints."""
    for what, places in zip(("row", "column"), model.sparsity):
        made.add(f"static const size_t model_{what}[] = {{{', '.join(map(str, places))}}};")
    count = len(model.sparsity[0])
    made.add(f"static const dal_sparsity model_sparsity = {{{count}, model_row, model_column}};\n")


# What may be assumed of a parameter.
_ASSUMED = {
    "positive": "{p} > 0.0",
    "negative": "{p} < 0.0",
    "nonnegative": "{p} >= 0.0",
    "nonpositive": "{p} <= 0.0",
    "nonzero": "{p} != 0.0",
    "integer": "{p} == floor({p})",
}


def _parameters(made: Program, model: Model) -> None:
    """Write the functions for mass and initial data with other parameters."""
    made.add(
        "static int model_parameters(double *mass, double *state, const void *ctx)\n{\n"
        "    const double *const p = ctx;\n    (void)mass, (void)state, (void)p;"
    )
    for k, words in enumerate(model.assumptions):
        for word in words:
            made.add(f"    if (!({_ASSUMED[word].format(p=f'p[{k}]')})) return 1;")
    for name in ("mass", "state"):
        if model.derived.function(name) is not None:
            made.add(f"    if ({name}) model_{name}({name}, p);")
    made.add("    return 0;\n}\n")


def _definition(model: Model, fast: bool, compact: bool) -> list[str]:
    """Return the initializers of a dal_system_def that do not depend on parameters."""
    derived = model.derived
    found = [f".n = {model.n}", f".m = {model.m}", f".kind = DAL_{derived.kind.upper()}"]
    for name in ("lagrangian", "potential", "constraint", "force", "exact", "invariant"):
        if derived.function(name) is not None:
            member = "driven" if name == "constraint" and model.is_driven else name
            found.append(f".{member} = model_call_{name}")
    if model.inputs:
        found.append(f".inputs = {len(model.inputs)}")
    if model.is_time_dependent:
        found.append(".time_dependent = 1")
    if model.parameters:
        found.append(".parameters = model_parameters")
    if derived.is_positional:
        found.append(".positional = 1")
    if fast:
        found.append(".compiled = &model_compiled")
    if compact:
        found.append(".sparsity = &model_sparsity")
    if derived.mass is not None and derived.kind == "linear":
        zeros = pattern(model)
        found.append(f".steady = {2 * int(zeros.steady) + int(zeros.apart)}")
    return found


def _for_the_package(made: Program, model: Model, definition: list[str]) -> None:
    made.add("/* The package finds this by its name. */")
    made.add(f"DAL_API const dal_system_def dal_model = {{{', '.join(definition)}}};")
    for name, out in (("mass", "M"), ("state", "x")):
        if model.derived.function(name) is not None:
            head = f"void dal_model_{name}(double *{out}, const double *p)"
            made.add(f"DAL_API {head};\n{head}\n{{\n    model_{name}({out}, p);\n}}")


def c_string(text: str) -> str:
    """Return a text as a C string constant; all but plain letters are escaped."""
    plain = set(b"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789 _,.;:()=+-*^'")
    return '"' + "".join(chr(b) if b in plain else f"\\{b:03o}" for b in text.encode()) + '"'


# Words of C and C++, names of the constructor, and macros that begin like names of parameters.
_TAKEN = frozenset(
    "alignas alignof and and_eq asm auto bitand bitor bool break case catch char char16_t char32_t "
    "char8_t class co_await co_return co_yield compl concept const const_cast consteval constexpr "
    "constinit continue decltype default delete do double dynamic_cast else enum explicit export "
    "extern false float for friend goto if inline int long mutable namespace new noexcept not "
    "not_eq nullptr operator or or_eq private protected public register reinterpret_cast requires "
    "restrict return short signed sizeof static static_assert static_cast struct switch template "
    "this thread_local throw true try typedef typeid typename typeof typeof_unqual union unsigned "
    "using virtual void volatile wchar_t while xor xor_eq coordinates def description error "
    "formulas help input_names invariants mass p source state system I complex errno i386 "
    "imaginary linux math_errhandling stderr stdin stdout unix L_ctermid L_cuserid L_tmpnam "
    "P_tmpdir".split()
)
_MACRO = re.compile(r"[A-Z]{3,}\w*|[A-Z]{2}_\w*|M_([A-Z]|[12]_)\w*|(dal|DAL|model)_\w*")

_LONGEST = 4095  # of a string constant, in C compilers that keep to the standard


def parameter_names(given: Iterable[str]) -> list[str]:
    """Return a name in C and C++ for each parameter.

    A reserved name gets a "_"; names that are not identifiers become p0, p1, ...
    """
    found: list[str] = []
    for k, key in enumerate(given):
        name = key if re.fullmatch(r"(?!.*__)[A-Za-z]\w*", key, re.ASCII) else f"p{k}"
        name += "_" * (name in _TAKEN or _MACRO.fullmatch(name) is not None)
        while name in found:
            name += "_"
        found.append(name)
    return found


def _head(name: str, system: Any) -> str:
    """Return the declaration of the constructor, without a semicolon."""
    values = "".join(f"double {p}, " for p in parameter_names(system.parameters))
    return f"int {name}_system(dal_system **system, {values}dal_error *error)"


def _comment(system: Any) -> str:
    """Return the comment of the constructor."""
    values = zip(parameter_names(system.parameters), system.parameters.items())
    lines = [f"{p} is {_plain(key)}, {x!r} where this was generated." for p, (key, x) in values]
    lines.append("*system <- the system; as dal_system_new, which returns the status.")
    return "\n".join(f"/* {line} */" for line in lines)


def header(name: str, system: Any) -> str:
    """Return the header of a program with the constructor ``name_system``."""
    guard = f"{name.upper()}_SYSTEM_H"
    return (
        f"/* Generated by dalembert, for C and C++. */\n#ifndef {guard}\n#define {guard}\n\n"
        '#include <dalembert.h>\n\n#ifdef __cplusplus\nextern "C" {\n#endif\n\n'
        f"{_comment(system)}\n{_head(name, system)};\n\n"
        "#ifdef __cplusplus\n}\n#endif\n\n#endif\n"
    )


def _constructor(
    made: Program, model: Model, definition: list[str], name: str, system: Any, compact: bool
) -> None:
    """Write the function that creates the system in a C program."""
    n, head = model.n, _head(name, system)
    made.add(f"{_comment(system)}\n{head};\n\n{head}\n{{")

    def strings(what: str, texts: Sequence[str]) -> None:
        made.add(f"    static const char *const {what}[] = {{{', '.join(map(c_string, texts))}}};")

    strings("coordinates", model.coordinates)
    if model.inputs:
        strings("input_names", model.inputs)
    values = parameter_names(system.parameters)
    made.add(f"    double p[{max(len(values), 1)}] = {{{', '.join(values) or '0.0'}}};")
    texts = {key: getattr(system, key) for key in ("name", "help", "description", "source")}
    texts["formulas"] = "\n".join(system.formulas)
    members = [*definition]
    for key, text in texts.items():
        constant = c_string(text)
        if len(text.encode()) > _LONGEST:
            letters = "".join(f"'\\{b:03o}', " for b in text.encode())
            made.add(f"    static const char {key}[] = {{{letters}0}};")
            constant = key
        members.append(f".{key} = {constant}")
    members += [".coordinates = coordinates", ".ctx = p", ".ctx_size = sizeof p"]
    members += [".input_names = input_names"] * bool(model.inputs)
    sizes = {"mass": n if compact else n * n, "state": 2 * n}
    for what, size in sizes.items():
        if model.derived.function(what) is not None:
            made.add(f"    double {what}[{size}];\n    model_{what}({what}, p);")
            members.append(f".{what}{'es' * (compact and what == 'mass')} = {what}")
    if model.state is None and system.q0 is not None:
        numbers = ", ".join(repr(float(x)) for x in [*system.q0, *system.v0])
        made.add(f"    static const double state[] = {{{numbers}}};")
        members.append(".state = state")
    if model.invariants:
        strings("invariants", system.invariants)
        members += [f".invariants = {len(model.invariants)}", ".invariant_names = invariants"]
    made.add(f"    const dal_system_def def = {{{', '.join(members)}}};")
    made.add("    return dal_system_new(system, &def, error);\n}")


def _plain(text: str) -> str:
    """Return a text with letters and digits, and _ for all other characters."""
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in text)


# ---- expressions -------------------------------------------------------------------------------


# Functions that the math library of C has not: those of _HELPERS, and 1 over one that it has.
_OWN = {sympy.sign: "model_sign", sympy.Heaviside: "model_step"}
_OF_TWO = {sympy.Max: "model_larger", sympy.Min: "model_smaller"}
_INVERSE = {sympy.sec: "cos", sympy.csc: "sin", sympy.cot: "tan"}


class Printer:
    """Expressions as C, from a closed list of functions.

    Attributes
    ----------
    powers : set of int
        Exponents for which `_power` is needed.
    real, nowhere : str
        The type of a number, and the NaN of this type.
    """

    real, nowhere = "double", "NAN"

    def __init__(self, powers: set[int]) -> None:
        self.powers = powers

    def name(self, name: str) -> str:
        """Return the name of a generated function."""
        return name

    def whole(self, e: Any) -> str:
        """Return an expression that is complete, or an argument."""
        return self(e)

    def call(self, name: str, *arguments: str) -> str:
        return f"{name}({', '.join(arguments)})"

    def choice(self, condition: str, value: str, other: str) -> str:
        return f"({condition} ? {value} : {other})"

    def __call__(self, e: Any) -> str:
        if e.is_Symbol:
            return str(e.name)
        if e.is_Add:
            return f"({self._sum(e)})"
        if e.is_Mul:
            return self._product(e)
        if e.is_Pow:
            return self._power(e.base, e.exp)
        if e.is_Number or e.is_NumberSymbol:
            return self._number(e)
        return self._function(e)

    def _sum(self, e: Any) -> str:
        text = ""
        for i, term in enumerate(e.args):
            negative = term.could_extract_minus_sign() and (term.is_Number or term.is_Mul)
            part = self(-term if negative else term)
            text += (" - " if i else "-") + part if negative else (" + " if i else "") + part
        return text

    def _product(self, e: Any) -> str:
        coefficient, factors = e.as_coeff_mul()
        above, below = [], []
        for factor in factors:
            if factor.is_Pow and factor.exp.is_Rational and factor.exp.is_negative:
                below.append(self._power(factor.base, -factor.exp))
            else:
                above.append(self(factor))
        sign = ""
        if coefficient.is_negative:
            sign, coefficient = "-", -coefficient
        if coefficient != 1 or not above:
            above.insert(0, self._number(coefficient))
        text = " * ".join(above)
        if below:
            text += " / " + (below[0] if len(below) == 1 else f"({' * '.join(below)})")
        return f"({sign}{text})"

    def _power(self, base: Any, exponent: Any) -> str:
        if base == sympy.E:
            return self.call("exp", self.whole(exponent))
        if exponent.is_Rational and exponent.is_negative:
            return f"(1.0 / {self._power(base, -exponent)})"
        if exponent == 1:
            return self(base)
        if exponent == sympy.Rational(1, 2):
            return self.call("sqrt", self.whole(base))
        if exponent.is_Integer and 2 <= exponent <= 64:
            self.powers.add(int(exponent))
            return self.call(f"model_power_{int(exponent)}", self.whole(base))
        return self.call("pow", self.whole(base), self.whole(exponent))

    def _number(self, e: Any) -> str:
        text = repr(nearest(e))
        return f"({text})" if text.startswith("-") else text

    def _function(self, e: Any) -> str:
        if isinstance(e, sympy.Piecewise):
            text = self.nowhere
            for value, condition in reversed(e.args):
                text = self.whole(value) if condition == sympy.true else (
                    self.choice(self._condition(condition), self.whole(value), text)
                )
            return text
        parts = map(self.whole, e.args)
        if name := FUNCTIONS.get(e.func) or _OWN.get(e.func):
            return self.call(name, *parts)
        if name := _OF_TWO.get(e.func):
            return functools.reduce(lambda one, other: self.call(name, one, other), parts)
        if name := _INVERSE.get(e.func):
            return f"(1.0 / {self.call(name, next(parts))})"
        raise ValueError(f"{e} ({type(e).__name__}) cannot be written in C")

    _signs = {"and": " && ", "or": " || ", "not": "!", True: "1", False: "0"}

    def _condition(self, e: Any) -> str:
        if isinstance(e, BooleanTrue | BooleanFalse):
            return self._signs[bool(e)]
        if isinstance(e, sympy.core.relational.Relational):
            return f"({self.whole(e.lhs)} {e.rel_op} {self.whole(e.rhs)})"
        if isinstance(e, sympy.Not):
            return f"{self._signs['not']}{self._condition(e.args[0])}"
        if isinstance(e, sympy.And | sympy.Or):
            sign = self._signs["and" if isinstance(e, sympy.And) else "or"]
            return f"({sign.join(map(self._condition, e.args))})"
        raise ValueError(f"{e} ({type(e).__name__}) cannot be written in C")


class VectorPrinter(Printer):
    """Expressions as C for vectors; expressions without symbols remain numbers.

    Attributes
    ----------
    called : set of str
        The functions of the math library that are used.
    """

    real, nowhere = "dal_vec", "DAL_LANES(all_of)(NAN)"
    _signs = {
        "and": " & ", "or": " | ", "not": "~", True: "~(dal_mask){0}", False: "(dal_mask){0}",
    }  # fmt: skip

    def __init__(self, powers: set[int]) -> None:
        super().__init__(powers)
        self.called: set[str] = set()

    def __call__(self, e: Any) -> str:
        return super().__call__(e) if e.free_symbols else Printer(set())(e)

    def name(self, name: str) -> str:
        return f"DAL_LANES({name})"

    def whole(self, e: Any) -> str:
        return self(e) if e.free_symbols else f"DAL_LANES(all_of)({self(e)})"

    def call(self, name: str, *arguments: str) -> str:
        if name != "fabs" and not name.startswith("model_"):
            self.called.add(name)
        return super().call(self.name(name), *arguments)

    def choice(self, condition: str, value: str, other: str) -> str:
        return super().call("DAL_LANES(choose)", condition, value, other)


def c_identifier(name: str | None, default: str) -> str:
    """Return a name for C; raise ValueError if the given one is not an identifier."""
    if name is None:
        plain = _plain(default)
        return plain if plain[:1].isalpha() else f"model_{plain}"
    if not isinstance(name, str) or not name.isascii() or not name.isidentifier():
        raise ValueError(f"name = {name!r}: expected a C identifier")
    if keyword.iskeyword(name) or name.startswith("_"):
        raise ValueError(f"name = {name!r}: expected a C identifier that is not reserved")
    return name
