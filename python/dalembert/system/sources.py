"""Sources of systems: each creates a C system, can be pickled, and adds its Python parts."""

from __future__ import annotations

import dataclasses
import pickle
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .. import core
from ..core import (
    KINDS,
    Array,
    Handle,
    arguments,
    ffi,
    lib,
    pointers,
)
from ..core.functions import Function, OfPoint, OfState
from ..core.records import options_of
from ..symbolic import evaluation, given
from . import sparsity
from .definition import About, SystemOptions

_MOST_COORDINATES = 10_000  # of dense matrices: n^2 numbers each, n^3 operations in a step
_MOST_OF_ALL = 10_000_000  # with a sparsity

# What each function makes no sense without.
_NEEDS = {
    "gradient": "potential(q) -> V",
    "hessian": "potential(q) -> V",
    "lagrangian": "lagrangian_q(q, v) -> dL/dq and lagrangian_v(q, v) -> dL/dv",
    **dict.fromkeys(
        [f"lagrangian_{x}" for x in ("q", "v", "qq", "vq", "vv", "vt")], "lagrangian(q, v) -> L"
    ),
    "force_q": "force(t, q, v) -> f",
    "force_v": "force(t, q, v) -> f",
    "mu_v_q": "mu(q)",
    "affine": "mu(q)",
    "affine_derivative": "affine(q) -> a",
    "constraint": "constraint_v(q, v) -> dphi/dv",
    "constraint_v": "constraint(q, v) -> phi",
    "constraint_q": "constraint(q, v) -> phi",
}


class Made(NamedTuple):
    """A C system and its parts in Python."""

    handle: Any  # ``dal_system *``
    exact: Function | None = None  # the exact solution, unless C has it
    invariants: Mapping[str, Function] = {}  # first integrals, unless C has them
    has_exact: bool | None = None  # whether there is an exact solution; None: ask C
    model: Any = None  # of a system from expressions


class Source:
    """The definition of a system; it is pickled as its numbers, functions and expressions."""

    of_library = False  # True: `systems.get` with the name and the parameters makes it again
    calls_python = False  # True: a step may take any time

    def make(self) -> Made:
        """Create the system."""
        raise NotImplementedError

    def named(self) -> dict[str, Function | None]:
        """Return the functions of the user by name, None if not given."""
        return {}

    def identity(self) -> Any:
        """Return data for JSON that identify the system as far as possible."""
        raise NotImplementedError

    def with_values(self, values: dict[str, float]) -> Source:
        """Return the source with other values of the parameters, itself if it has none."""
        return dataclasses.replace(self, values=values) if hasattr(self, "values") else self

    def require_picklable(self, name: str) -> None:
        """Raise PicklingError, with the line to change, if a function cannot be pickled."""
        for key, function in self.named().items():
            try:
                pickle.dumps(function)
            except Exception as error:
                raise pickle.PicklingError(
                    f"the system {name!r} cannot be pickled, because its {key} = {function!r} "
                    "cannot; define it with def at the top level of a module"
                ) from error


def _new(
    definition: Any,
    names: Sequence[str],
    inputs: Sequence[str],
    about: Mapping[str, str],
    mass: Array | None,
    state: Array | None,
    owner: Any,
) -> Any:
    """Return the C system of a definition, with its names, texts, mass and initial data."""
    c_names, c_inputs = core.strings(list(names)), core.strings(list(inputs))
    definition.coordinates, definition.input_names = c_names[0], c_inputs[0]
    texts = [(key, ffi.new("char[]", arguments.text(x, key).encode())) for key, x in about.items()]
    for key, text in texts:
        setattr(definition, key, text)
    if mass is not None and mass.ndim == 1:
        definition.masses = core.pointer(mass)
    else:
        definition.mass = ffi.NULL if mass is None else core.pointer(mass)
    definition.state = ffi.NULL if state is None else core.pointer(state)
    handle = core.make("system", definition, owner=owner)
    del c_names, c_inputs, texts
    return handle


# ---- functions ---------------------------------------------------------------------------------


@dataclass
class Functions(Source):
    """The common part of systems of Python functions and of C functions.

    The record ``asked`` has checked values; mass, state and sparsity are its arrays.
    """

    asked: Any  # SystemOptions
    mass: Array | None
    state: Array | None
    sparsity: sparsity.Sparsity | None

    def __post_init__(self) -> None:
        self.given = {key: vars(self.asked)[key] for key in core.functions.FUNCTIONS}

    def named(self) -> dict[str, Function | None]:
        return {**self.given, **self.asked.invariants}

    def identity(self) -> Any:
        one = self.asked
        given = sorted(name for name, function in self.named().items() if function is not None)
        mass = None if self.mass is None else self.mass.tolist()
        numbers = [one.n, one.m, one.steady, one.time_dependent]
        entries = self.sparsity and [x.tolist() for x in self.sparsity[:2]]
        more = [one.positional, entries] if one.positional or entries else []
        more += ["driven"] * one.driven
        return ["functions", given, numbers, mass, one.coordinates, one.inputs, *more]

    def define(
        self, callbacks: dict[str, Any], kind: int, missing: int, ctx: Any, kept: Any
    ) -> Any:
        """Return the C system."""
        one, values = self.asked, vars(self.asked)
        given = {name: int(values[name]) for name in ("n", "m", *_TRAITS)}
        given |= {"inputs": len(one.inputs), "kind": kind, "missing": missing, "ctx": ctx}
        definition = ffi.new("dal_system_def *", given | callbacks)
        if self.sparsity is not None:
            rows, columns, _ = self.sparsity
            addresses = (ffi.from_buffer("size_t[]", x) for x in (rows, columns))
            pattern = ffi.new("dal_sparsity *", [len(rows), *addresses])
            definition.sparsity = pattern
        about = {key: values[key] for key in (*options_of(About), "formulas")}
        names = one.coordinates, one.inputs
        return _new(definition, *names, about, self.mass, self.state, (ctx, kept))


_TRAITS = ("steady", "time_dependent", "positional")  # of a dal_system_def


class PythonFunctions(Functions):
    """A system of Python functions."""

    calls_python = True

    def make(self) -> Made:
        one, given, kind = self.asked, self.given, "linear"
        if one.m > 0:
            kind = "affine" if one.affine is not None else kind
            kind = "nonlinear" if one.constraint is not None else kind
        timed = one.time_dependent
        entries = None if self.sparsity is None else len(self.sparsity.rows)
        callables = core.Callables(one.n, one.m, len(one.inputs), timed, entries, **given)
        callbacks = {
            key: getattr(lib, f"dal_py_{key}")
            for key in ("lagrangian", "potential", "force", "exact")
            if given[key] is not None
        }
        if one.m > 0:
            name = "driven" if one.driven else "constraint"
            callbacks[name] = getattr(lib, f"dal_py_{'driven_' * one.driven}{kind}")
        handle = self.define(
            callbacks, KINDS[kind], core.functions.missing(given, one.m, kind, timed),
            ffi.new_handle(callables), callables,
        )  # fmt: skip
        return Made(handle, None, one.invariants, one.exact is not None)


class CFunctions(Functions):
    """A system of C functions."""

    def make(self) -> Made:
        one, compiled = self.asked, _compiled(self.given, self.asked.driven)
        kind = arguments.choice("linear" if one.kind is None else one.kind, "kind", KINDS)
        outputs = core.functions.MISSING
        missing = sum({arguments.choice(x, "missing", outputs) for x in one.missing or ()})
        context, kept = pointers.context(one.ctx, compiled)
        names = {"constraint": "driven"} if one.driven else {}
        callbacks = {
            name: ffi.cast(f"dal_{name}_fn", x.address)
            for key, x in compiled.items() if (name := names.get(key, key))
        }  # fmt: skip
        handle = self.define(callbacks, kind, missing, context, kept)
        return Made(handle, one.exact, one.invariants, one.exact is not None)


def functions(given: SystemOptions) -> Functions:
    """Return the source of a system of functions, see `dalembert.System`, or raise ValueError."""
    values, invariants = vars(given), given.invariants
    mass, n, m = given.mass, given.n, given.m
    by_name = {key: values[key] for key in core.functions.FUNCTIONS}
    require_named(invariants)
    driven = bool(given.driven)
    compiled = _compiled(by_name, driven)
    inputs = _input_names(given.inputs, by_name["force"], driven)
    if driven and not inputs:
        raise ValueError("driven = True: expected inputs= as well, on which the constraints depend")
    if driven and by_name["mu"] is None and by_name["constraint"] is None:
        raise ValueError("driven = True: expected constraints")
    timed = bool(given.time_dependent)
    for key, function in {**by_name, **(invariants or {})}.items():
        if function is not None and key in core.functions.OF_TIME and not timed:
            raise ValueError(f"{key} is given: expected time_dependent=True as well")
        if key not in compiled:
            taken = core.functions.taken(key, len(inputs), timed, driven)
            arguments.function(function, key, taken)
    if compiled:
        _require_compiled(by_name, compiled, mass, m)
    else:
        _require_parts(by_name, mass, timed)
        for key in ("kind", "missing", "ctx"):
            if values[key] is not None:
                raise ValueError(
                    f"{key} = {arguments.shown(values[key])}: expected C functions, because Python "
                    "functions do not use it"
                )
    arguments.pair(given.q0, given.v0, ("q0", "v0"))
    sparse = given.sparsity is not None
    most = _MOST_OF_ALL if sparse else _MOST_COORDINATES
    matrix, names = _mass_and_names(mass, n, given.coordinates, given.q0, most)
    size, state = len(names), None
    pattern = sparsity.read(given.sparsity, size, m) if sparse else None
    positional = bool(given.positional)
    if positional and by_name["force"] is None:
        raise ValueError("positional = True: expected a force")
    if pattern is not None:
        _require_linear(by_name, bool(compiled))
        m = pattern.m
    if given.q0 is not None:
        both = (arguments.array(values[key], key, (size,)) for key in ("q0", "v0"))
        state = np.concatenate([*both])
    if compiled:
        m = arguments.integer(0 if m is None else m, "m", 0)
    else:
        functions = by_name["mu"], by_name["constraint"]
        last = (np.zeros(len(inputs)),) if driven else ()
        m = _number_of_constraints(*functions, m, size, state, timed, last)
    lines = arguments.names(given.formulas, "formulas", "several lines")
    asked = given.having(
        n=size, m=m, coordinates=names, inputs=inputs, driven=driven, positional=positional,
        time_dependent=timed, steady=bool(given.steady), invariants=dict(invariants or {}),
        formulas="\n".join(lines), **dict.fromkeys(("mass", "q0", "v0", "sparsity", "units")),
    )  # fmt: skip
    return (CFunctions if compiled else PythonFunctions)(asked, matrix, state, pattern)


def _input_names(given: Sequence[str] | int | None, force: Any, driven: bool) -> list[str]:
    """Return the names of the inputs, as given, or u0, u1, ... for a number."""
    if given is None:
        return []
    if isinstance(given, int) and not isinstance(given, bool):
        given = [f"u{i}" for i in range(arguments.integer(given, "inputs", 0, _MOST_COORDINATES))]
    names = arguments.names(given, "inputs", "several names, as ['left', 'right'], or a number")
    if len(set(names)) != len(names):
        raise ValueError(f"inputs = {names!r}: expected different names")
    if names and force is None and not driven:
        raise ValueError(
            f"inputs = {names!r}: expected a force that uses them; for constraints that "
            "depend on inputs, pass driven=True"
        )
    return names


def _mass_and_names(
    mass: ArrayLike | None,
    n: int | None,
    coordinates: Sequence[str] | None,
    q0: ArrayLike | None,
    most: int,
) -> tuple[Array | None, list[str]]:
    """Return M or its diagonal, if given, and the names of the coordinates, of the same size."""
    if coordinates is not None:
        coordinates = arguments.names(coordinates, "coordinates", "several names, as ['x', 'y']")
    told = None if n is None else arguments.integer(n, "n", 1, most)
    for one in (coordinates, q0):
        if told is None and one is not None:
            told = int(np.size(one))
    matrix = None if mass is None else _mass_matrix(mass, n, told)
    size = told if matrix is None else len(matrix)
    if size is None:
        raise ValueError("n is missing: neither coordinates nor q0 determine it")
    names = [f"q{i}" for i in range(size)] if coordinates is None else coordinates
    if len(names) != size or len(set(names)) != size:
        raise ValueError(f"coordinates = {coordinates!r}: expected {size} different names")
    return matrix, names


def _compiled(given: Mapping[str, Any], driven: bool) -> dict[str, pointers.Pointer]:
    """Return those functions that are C functions."""
    names = [key for key in pointers.ARGUMENTS if key != "driven"]
    of = {"constraint": "driven"} if driven else {}
    found = {key: pointers.find(key, given[key], of.get(key)) for key in names}
    return {key: pointer for key, pointer in found.items() if pointer is not None}


# ---- what comes with the library, expressions, deformations ------------------------------------


@dataclass
class BuiltIn(Source):
    """A system of the library, written in C."""

    name: str
    values: Mapping[str, Any]
    of_library = True

    def identity(self) -> Any:
        return ["built in", self.name]

    def make(self) -> Made:
        numbers = [arguments.number(value, key) for key, value in self.values.items()]
        values = np.array(numbers, dtype=float)
        c_names, kept = core.strings(list(self.values))
        c_name = ffi.new("char[]", self.name.encode())
        given = c_name, c_names, core.pointer(values), len(values)
        handle = core.make("system", *given, new=lib.dal_system_builtin)
        del kept
        return Made(handle)


@dataclass
class Expressions(Source):
    """A system of expressions: a model, and values of its parameters.

    An invariant that is None is an expression of the model.  The ``part`` is that of
    `codegen.program`: with "lanes", steps can advance several members of an ensemble at once.
    """

    model: Any
    values: dict[str, float]
    about: dict[str, str]
    state: Array | None
    exact: Function | None
    invariants: dict[str, Function | None]
    of_library: bool = False
    part: str = ""

    def named(self) -> dict[str, Function | None]:
        return {"exact": self.exact, **self.invariants}

    def identity(self) -> Any:
        model = self.model
        return ["expressions", model.key, model.coordinates, model.parameters, model.inputs]

    def make(self) -> Made:
        model, state, n = self.model, self.state, self.model.n
        given.require_assumed(model, self.values)
        numbers = evaluation.Evaluation(model, self.values)
        library = evaluation.library(model, self.part)
        if model.state is not None:
            state = numbers.matrix(library, "state", (2 * n,))
        is_compact = library is not None and library.definition[0].sparsity != ffi.NULL
        mass = numbers.matrix(library, "mass", (n,) if is_compact else (n, n))
        in_c = library is not None and not any(self.invariants.values())
        invariants = {} if in_c else numbers.invariants(self.invariants)
        arguments.function(self.exact, "exact")
        exact = None if self.exact is None else numbers.bound(self.exact)
        if library is None:
            numbers.warn(self.about["name"])
            found = dict.fromkeys(core.functions.FUNCTIONS) | numbers.in_python()
            asked = SystemOptions(
                **found, **self.about, n=n, m=model.m, coordinates=list(model.coordinates),
                inputs=list(model.inputs), invariants=invariants, driven=model.is_driven,
                time_dependent=model.is_time_dependent, formulas="",
            )  # fmt: skip
            made = PythonFunctions(asked, mass, state, None).make()
        else:
            handle = self._from_library(library, numbers, mass, state, in_c)
            made = Made(handle, None, invariants, None)
        if exact is not None:
            made = made._replace(exact=exact, has_exact=True)
        return made._replace(model=model)

    def _from_library(
        self, library: Any, numbers: Any, mass: Array | None, state: Array | None, in_c: bool
    ) -> Any:
        """Return the C system of a compiled model; ``in_c``: its invariants are C functions."""
        definition = ffi.new("dal_system_def *", library.definition[0])
        c_invariants, kept = core.strings(list(self.invariants))
        if self.values:
            definition.ctx = core.pointer(numbers.parameters)
            definition.ctx_size = numbers.parameters.nbytes
        if definition.invariant != ffi.NULL and in_c:
            definition.invariants = len(self.invariants)
            definition.invariant_names = c_invariants
        names = self.model.coordinates, self.model.inputs
        handle = _new(definition, *names, self.about, mass, state, library)
        del kept
        return handle


@dataclass
class Deformed(Source):
    """A system with the constraints phi + delta g = 0."""

    calls_python = True

    base: Handle
    g: Function
    delta: float
    g_v: Function
    g_q: Function | None
    g_t: Function | None
    kind: str

    def named(self) -> dict[str, Function | None]:
        return {"g": self.g, "g_v": self.g_v, "g_q": self.g_q, "g_t": self.g_t}

    def identity(self) -> Any:
        given = [name for name, function in self.named().items() if function is not None]
        return ["deformed", self.base._identity, self.delta, given, self.kind]

    def make(self) -> Made:
        base = self.base
        timed = base.is_time_dependent
        callables = core.Callables(base.n, base.m, 0, timed, **self.named())
        context = ffi.new_handle(callables)
        missing = lib.DAL_MISSING_PHI_Q if self.g_q is None else 0
        missing |= lib.DAL_MISSING_PHI_T if timed and self.g_t is None else 0
        return Made(
            core.make(
                "system", base._handle, lib.dal_py_deformation, context, self.delta,
                KINDS[self.kind], missing, owner=(base, callables, context),
                new=lib.dal_system_deform,
            )
        )  # fmt: skip


@dataclass
class AtKeptNodes(Source):
    """A system with the constraints phi(q - shift v, v) = 0."""

    base: Handle
    shift: float

    def identity(self) -> Any:
        return ["at kept nodes", self.base._identity, self.shift]

    def make(self) -> Made:
        given, new = (self.base._handle, self.shift), lib.dal_system_deform_nodes
        return Made(core.make("system", *given, owner=self.base, new=new))


# ---- what has to go together ---------------------------------------------------------------------


def require_named(invariants: Any) -> None:
    """Raise ValueError if invariants are neither None nor a mapping from names."""
    named = arguments.mapping(invariants, "invariants")
    arguments.names(named, "invariants", "names that are strings")
    for name, value in named.items():
        if value is None:
            raise ValueError(f"invariants[{name!r}] = None: expected a function or an expression")


def _require_parts(functions: dict[str, Function | None], mass: Any, timed: bool) -> None:
    """Raise ValueError if functions are incompatible, or one of a group is missing."""
    given = {key for key, function in functions.items() if function is not None}
    if mass is not None:
        given.add("mass")
    for one, other in (
        ("mass", "lagrangian"),
        ("potential", "lagrangian"),
        ("mu", "constraint"),
    ):
        if one in given and other in given:
            raise ValueError(f"{one} and {other} are both given: expected one of the two")
    for key in core.functions.FUNCTIONS:
        needed = _NEEDS.get(key, "")
        names = [part.split("(")[0] for part in needed.split(" and ")] if needed else []
        if key in given and not given.issuperset(names):
            needed = re.sub(r"\((?!t)", "(t, ", needed) if timed else needed
            raise ValueError(f"{key} is given without {needed}")
    if "constraint_t" in given and not given & {"mu", "constraint"}:
        raise ValueError("constraint_t is given without mu or constraint")
    if not given & {"mass", "lagrangian"}:
        raise ValueError("mass is missing: expected a mass or a lagrangian")
    derivatives = given & {"mu_v_q", "affine_derivative"}
    if "affine" in given and len(derivatives) == 1:
        raise ValueError(
            f"{derivatives.pop()} is given alone: expected both mu_v_q and "
            "affine_derivative, or neither"
        )


def _require_compiled(
    functions: dict[str, Function | None],
    compiled: Mapping[str, pointers.Pointer],
    mass: Any,
    m: int | None,
) -> None:
    """Raise ValueError if an argument is incompatible with C functions."""
    for key, function in functions.items():
        if function is not None and key != "exact" and key not in compiled:
            raise ValueError(
                f"{key} = {function!r} is given together with the C function "
                f"{next(iter(compiled))}. Expected either only Python functions, or C "
                "functions for potential, constraint, lagrangian and force, with their "
                "derivatives among the outputs"
            )
    if (mass is None) == ("lagrangian" not in compiled):
        raise ValueError("mass and lagrangian: expected exactly one of the two")
    if mass is None and "potential" in compiled:
        raise ValueError("potential and lagrangian are both given: expected one of the two")
    if ("constraint" in compiled) != bool(m):
        raise ValueError(f"m = {m}: expected the number of constraints, with a constraint only")


def _mass_matrix(mass: ArrayLike, n: int | None, told: int | None) -> Array:
    """Return M, or its diagonal for a diagonal or a number; ValueError if the size is wrong."""
    matrix = arguments.array(mass, "mass", (None, None), (None,), ())
    if matrix.ndim == 0:
        if told is None:
            raise ValueError(f"n is missing: mass = {mass!r} does not determine it")
        matrix = np.full(told, float(matrix))
    if matrix.shape[0] != matrix.shape[-1] or matrix.size == 0:
        raise ValueError(f"mass: expected a square matrix, got shape {matrix.shape}")
    if n is not None and len(matrix) != n:
        raise ValueError(f"n = {n}: the mass has shape {matrix.shape}")
    return matrix.copy()


def _require_linear(functions: dict[str, Function | None], compiled: bool) -> None:
    """Raise ValueError unless the functions of a system are compatible with a sparsity."""
    if compiled:
        return
    for key in ("affine", "constraint"):
        if functions[key] is not None:
            raise ValueError(
                f"sparsity is given with {key}: expected linear constraints, given by mu only"
            )
    if functions["mu"] is None:
        raise ValueError("sparsity is given without mu")


def _number_of_constraints(
    mu: OfPoint | None,
    constraint: OfState | None,
    m: int | None,
    n: int,
    state: Array | None,
    timed: bool,
    inputs: tuple[Array, ...],
) -> int:
    """Return m as given, or the number of rows from ``mu`` or ``constraint`` at time 0."""
    if mu is None and constraint is None:
        if m:
            raise ValueError(f"m = {m}: expected mu or constraint as well")
        return 0
    if m is not None:
        return arguments.integer(m, "m", 0)
    point = np.concatenate([np.zeros(n), np.ones(n)]) if state is None else state.copy()
    point.flags.writeable = False
    time = (0.0,) if timed else ()
    if constraint is not None:
        shape = arguments.shape(constraint(*time, point[:n], point[n:], *inputs))
        if len(shape) != 1:
            raise ValueError(
                f"constraint returned {shape}: expected shape (m,), one number for each constraint"
            )
    elif mu is not None:
        shape = arguments.shape(mu(*time, point[:n], *inputs))
        if len(shape) != 2 or shape[1] != n:
            raise ValueError(
                f"mu returned {shape}: expected shape (m, {n}), one row for each constraint"
            )
    return arguments.integer(shape[0], "m", 0)
