"""Generation of C from a model: callbacks, step routine, and definition of the system.

The program contains texts of the user only in string constants that are escaped byte by byte.  C
programs also contain names of parameters that are not reserved in C and C++. Each callback computes
common subexpressions of its outputs once, and those of a single output only if it is requested.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Sequence
from typing import Any

from .constructor import constructor
from .derive import Function
from .expansion import along, expansion
from .graph import Node, below
from .model import Model
from .motion import motion
from .pattern import MOST, field_zeros, pattern
from .printing import LANES, C, Program, Text, spelled
from .variations import variations

GENERATOR = 4  # changes with what is generated, as the files of this module do

# Above this number of coordinates a step routine of the model's own, whose arrays are on the stack,
# gains nothing over the library's.
_LARGEST = 32

# What the step routine and the field alone call.
_MAYBE_UNUSED = ("t", "q", "v", "u", "start", "phi_t", "L_vt", "M", "mu", "g", "C")
_OF_STEPS = ("balance", "pull", "terms")

# The outputs that a step asks for less often than for the others of their function.
_SECOND = ("V_qq", "phi_q", "phi_t", "L_qq", "L_vq", "L_vv", "L_vt", "f_q", "f_v", "F_q", "F_v")

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


def has_steps(model: Model) -> bool:
    """Return whether a model has a step routine, see kernel.h; if not, the library supplies it."""
    return model.n <= _LARGEST and not is_compact(model)


def is_compact(model: Model) -> bool:
    """Return whether steps of a model benefit from the sparsity of its constraints.

    The library then supplies the steps, and the program has no step routine.
    """
    derived, n = model.derived, model.n
    if n <= MOST or model.m == 0 or derived.mass is None or derived.kind != "linear":
        return False
    is_diagonal = all(e.is_zero for k, e in enumerate(derived.mass) if k % (n + 1) != 0)
    return is_diagonal and 2 * len(model.sparsity[0]) <= model.m * n


def program(
    model: Model, name: str | None = None, system: Any = None, compact: bool | None = None,
    part: str = "", of: Model | None = None,
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
    part : {"", "steps", "lanes", "series", "four series", "variations", ...}, optional
        The parts of the program besides the functions of the model.  "steps": the step routine, see
        `has_steps`.  "lanes": also one for several members at once, see `has_lanes`.  "series": the
        Taylor series.  "four series": also those of four members at once.  "variations", "second
        variations": also those of derivatives, of order 1 or 2.  A constructor has steps and
        series.
    of : Model, optional
        Another model, along whose motions the invariants get Taylor series.
    """
    lanes, varied = part == "lanes", VARIED.get(part, 0)
    series = part in ("series", "four series") or name is not None or varied > 0
    made, body = Program(), Program()
    derived = model.derived
    compact = is_compact(model) if compact is None else compact
    fast = (lanes or part == "steps" or name is not None) and model.n <= _LARGEST and not compact
    made.add(
        f"/* Generated by dalembert: a system of {model.n} coordinates and {model.m} velocity\n"
        " * constraints.  Compile with -ffp-contract=off: then all compilations of the step\n"
        " * routine give the same bits. */\n"
        "#include <dalembert.h>" + "\n#include <dalembert/kernel.h>" * fast
        + "\n#include <dalembert/lanes.h>" * lanes
        + "\n#include <dalembert/series.h>" * (series or of is not None)
        + "\n#include <math.h>\n#include <stddef.h>\n"
    )  # fmt: skip
    own_field = fast and model.n <= MOST  # in large models it would gain nothing
    for function in (*derived.functions, *([derived.terms] if own_field else ())):
        if compact and function.name in ("mass", "constraint"):
            function = _alone(model, function)
        if not fast and function.name in _OF_STEPS:
            continue
        if function.name == "balance" and _is_balance(model):
            _balance(body, model)
        else:
            _function(body, model, function, fast)
    if fast:
        _kernel(body, model)
        if own_field:
            _field(body, model)
        if lanes:
            _lanes(body, model)
        _compiled(body, model, lanes)
    if series:
        expansion(body, model, motion(model), part == "four series")
    if varied:
        variations(body, model, motion(model), varied)
    if of is not None:
        along(body, of, _motion_of(of), [of.derived.read(e) for e in model.invariants])
    if any("MODEL_CUT" in line for line in body.lines):
        made.add(_CUT)
    for helper, rest in _HELPERS.items():
        if any(f"{helper}(" in line for line in body.lines):
            made.add(f"static inline double {helper}{rest}")
    made.lines += body.lines
    if compact:
        _sparsity(made, model)
    if model.parameters:
        _parameters(made, model)
    definition = _definition(model, fast, compact)
    if series:
        definition.append(".series = MODEL_SERIES")
    if varied:
        definition.append(".variations = MODEL_VARIATIONS")
    if name is None:
        _for_the_package(made, model, definition)
    else:
        constructor(made, model, definition, name, system, compact)
    return made


_motion_of = functools.lru_cache(maxsize=16)(motion)  # of the runs of several events

VARIED = {"variations": 1, "second variations": 2}

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


# In long functions compilers take a time that grows with the square of the length.  After a cut all
# values are in memory.
_CUT = """#ifdef __GNUC__
#define MODEL_CUT(part) __asm__ volatile("" : : "r"(part) : "memory")
#else
#define MODEL_CUT(part) (void)(part)
#endif"""

_BETWEEN_CUTS = 50  # statements; with more the time grows, and with less the length of the code


# ---- callbacks ---------------------------------------------------------------------------------


def _function(
    made: Program, model: Model, function: Function, fast: bool, is_vector: bool = False
) -> set[str]:
    """Write a callback; return the functions of the math library that it calls."""
    real = "dal_vec" if is_vector else "double"
    signature, name = _signature(model, function.name), f"model_{function.name}"
    outputs = _spelled(function)
    nodes = [e for entries in outputs.values() for e in entries.values()]
    every = below(nodes)
    is_few = sum(bool(e.args) for e in every) <= _INLINED
    inline = fast and is_few and function.name in ("constraint", "potential", *_OF_STEPS)
    if function.name == "lagrangian":
        inline = fast and is_few and _is_balance(model)
    used = {e.value for e in every if e.op == "symbol"}

    made.add("DAL_KERNEL_INLINE int" if inline else "static int")
    named = f"DAL_LANES({name})" if is_vector else name
    made.add(f"{named}({signature}, const double *p)\n{{".replace("double", real))
    n, takes_inputs = model.n, "double *u" in signature
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
    text = Text(nodes, LANES if is_vector else C, in_array=not is_few)
    place = len(made.lines)
    _outputs(made, model, function, outputs, text)
    if not is_few:
        lines, made.lines[place:] = made.lines[place:], [f"    {real} part[{text.count + 1}];"]
        for k, line in enumerate(lines):
            is_cut = (k + 1) % _BETWEEN_CUTS == 0 and line.endswith(";")
            made.lines += [line, "    MODEL_CUT(part);"] if is_cut else [line]
    made.add("    return 0;\n}\n")
    if function.name not in ("mass", "state", *_OF_STEPS) and not is_vector:
        names = ", ".join(_names(signature))
        made.add(f"static int model_call_{function.name}({signature}, void *ctx)\n{{")
        made.add(f"    return {name}({names}, ctx);\n}}\n")
    return text.called


def _is_balance(model: Model) -> bool:
    """Return whether the function of the Lagrangian is that of the balance too."""
    return model.derived.mass is None and model.force is None


def _balance(made: Program, model: Model, is_vector: bool = False) -> None:
    """Write the balance by means of the function of the Lagrangian."""
    text = _BALANCE.format(signature=_signature(model, "balance"), n=model.n)
    if is_vector:
        text = text.replace("double", "dal_vec")
        for name in ("model_balance", "model_lagrangian"):
            text = text.replace(name, f"DAL_LANES({name})")
    made.add(text)


_BALANCE = """DAL_KERNEL_INLINE int
model_balance({signature}, const double *p)
{{
    (void)u;
    const int status = model_lagrangian(t, q, v, NULL, F, L_v, F_q, L_vq, L_vv, NULL, p);
    for (int i = 0; F_v && i < {n}; i++) /* L_vq is asked for with it */
        for (int j = 0; j < {n}; j++) F_v[i * {n} + j] = L_vq[j * {n} + i];
    return status;
}}
"""


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


def _spelled(function: Function) -> dict[str, dict[int, Node]]:
    """Return the entries of each output that are written one by one, without most zeros."""
    found = {}
    for output, entries in function.outputs.items():
        there = {k: e for k, e in enumerate(entries) if not e.is_zero}
        few = len(entries) - len(there) <= _MOST_ZEROS
        found[output] = dict(enumerate(entries)) if few else there
    nodes = iter(spelled([e for entries in found.values() for e in entries.values()]))
    return {x: {k: next(nodes) for k in entries} for x, entries in found.items()}


def _outputs(
    made: Program, model: Model, function: Function, outputs: dict[str, dict[int, Node]],
    text: Text,
) -> None:  # fmt: skip
    """Write the computation of the outputs.

    Parts that several outputs share come before them.  Those that second derivatives alone share
    come after the other outputs, and after a return if no second derivative is asked for.
    """
    users: dict[Node, set[str]] = {}
    for output, entries in outputs.items():
        for e in below(entries.values()):
            users.setdefault(e, set()).add(output)
    nodes = sorted(users, key=lambda e: e.index)
    levels = [[x for x in outputs if x not in _SECOND], [x for x in outputs if x in _SECOND]]
    for level in filter(None, levels):
        shared = [
            e for e in nodes
            if len(users[e]) > 1 and (level is levels[1]) == (users[e] <= {*levels[1]})
        ]  # fmt: skip
        lines = text.names(shared, ())
        if lines and level is levels[1]:
            made.add(f"    if (!{' && !'.join(level)}) return 0;")
        made.lines += [f"    {line}" for line in lines]
        for output in level:
            made.add(f"    if ({output}) {{")
            entries, size = outputs[output], len(function.outputs[output])
            own = (e for e in nodes if users[e] == {output})
            for line in text.names(own, entries.values()):
                made.add(f"        {line}")
            if len(entries) < size:
                made.add(f"        for (size_t i = 0; i < {size}; i++) {output}[i] = {text.zero};")
            for k, e in entries.items():
                made.add(f"        {output}[{k}] = {text.whole(e)};")
            made.add("    }")


def _names(signature: str) -> list[str]:
    """Return the names of the arguments."""
    return [part.split()[-1].lstrip("*") for part in signature.split(",")]


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
    known = "C" in model.derived.terms.outputs
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
    body, called = Program(), set[str]()
    wanted = ["constraint", _force(model)]
    if _is_balance(model):
        wanted = ["constraint", "lagrangian"]
    for function in model.derived.functions:
        if function.name in wanted:
            called |= _function(body, model, function, True, is_vector=True)
    if _is_balance(model):
        _balance(body, model, is_vector=True)
    for name in sorted(called):
        ending = f"_OF_TWO({name})" if name in ("pow", "atan2") else f"({name})"
        if name == "sqrt":
            made.add(f"DAL_LANES_EACH{ending}")
            continue
        made.add(f"#if DAL_LANES_LIBMVEC >= {1 if name in _EARLY else 2}")
        made.add(f"DAL_LANES_AT_ONCE{ending}\n#else\nDAL_LANES_EACH{ending}\n#endif")
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
