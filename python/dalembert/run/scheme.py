"""Schemes: compositions of beta-schemes, or data of another family."""

from __future__ import annotations

import ctypes
import functools
import os
from dataclasses import dataclass, field, replace
from typing import Any

from .. import core
from ..core import arguments, ffi, lib, require_system
from ..discrete import DifferenceMap
from ..system import System
from ..system.twins import twin

METHODS = {
    "rk8pd": lib.DAL_FLOW_RK8PD,
    "msadams": lib.DAL_FLOW_MSADAMS,
    "rodas": lib.DAL_FLOW_RODAS,
    "taylor": -1,  # a scheme of its own
}
NODES = {"moved": lib.DAL_MOVED_NODES, "kept": lib.DAL_KEPT_NODES}
INITIAL = {
    "D": lib.DAL_INITIAL_D,
    "D_eps": lib.DAL_INITIAL_D_EPS,
    "project": lib.DAL_INITIAL_PROJECT,
    "shift": lib.DAL_INITIAL_SHIFT,
}


@dataclass(frozen=True, repr=False)
class Scheme:
    """A scheme: a composition of beta-schemes, each over a fraction of the step.

    Parameters
    ----------
    substeps : sequence of (beta, fraction)
        beta in [0, 1]; the fractions are not 0 and sum to 1.
    nodes : {"moved", "kept"}, optional
        The positions of the states.  "moved" nodes (1 - beta) q_{k-1} + beta q_k preserve D. "kept"
        nodes q_k preserve D_eps = {mu(q - (1 - beta) h v) v = 0} and require a single sub-step.
    name : str, optional
        A name of at most 39 bytes; default "own".
    help, reference : str, optional
        A description of one line, and the source in the literature.
    order, multiplier_order : int, optional
        The promised orders (p, s): local errors O(h^(p+1)) of q and v, and O(h^(s+1)) of the
        scheme's own multipliers.  Order 0 promises nothing.
    symmetric : bool, optional
        True if the scheme is its own adjoint on D.

    Raises
    ------
    ValueError
        If an argument is invalid.  The message names it.

    Examples
    --------
    >>> import dalembert as dal
    >>> theta = dal.Scheme([(0.3, 1.0)], name="beta 0.3")
    >>> dal.integrate(dal.systems.particle(), theta, h=0.1, steps=10).success
    True
    """

    substeps: tuple[tuple[float, float], ...]
    nodes: str = "moved"
    name: str = "own"
    help: str = ""
    reference: str = ""
    order: int = 0
    multiplier_order: int = 0
    symmetric: bool = False
    _record: Any = field(init=False, repr=False, compare=False)  # the dal_scheme
    _kept: Any = field(init=False, repr=False, compare=False)  # what the dal_scheme points to
    _source: tuple[Any, ...] = field(init=False, repr=False, default=())  # of another family
    _maps: Any = field(init=False, repr=False, compare=False, default=None)  # of a pair, one's own

    def __post_init__(self) -> None:
        name = arguments.text(self.name, "name").encode()
        if not 0 < len(name) < 40:
            raise ValueError(f"name = {self.name!r}: expected 1 to 39 bytes, got {len(name)}")
        if isinstance(self.substeps, str):
            raise ValueError(
                f"substeps = {self.substeps!r}: expected several pairs (beta, fraction); for "
                "a named scheme, use Scheme.find"
            )
        if isinstance(self.substeps, (list, tuple)) and len(self.substeps) == 0:
            raise ValueError("substeps is empty: expected at least one (beta, fraction)")
        pairs = arguments.array(self.substeps, "substeps", (None, 2))
        self._set(substeps=tuple((float(b), float(f)) for b, f in pairs))
        kept = (
            ffi.new("dal_substep[]", list(self.substeps)),
            ffi.new("char[]", arguments.text(self.help, "help").encode()),
            ffi.new("char[]", arguments.text(self.reference, "reference").encode()),
        )
        record = ffi.new("dal_scheme *")
        record.name = name
        record.help, record.reference = kept[1], kept[2]
        if self.substeps and (len(self.substeps) > 1 or self.substeps[0][1] != 1.0):
            record.count, record.substeps = len(self.substeps), kept[0]
        elif self.substeps:
            record.beta = self.substeps[0][0]
        record.nodes = arguments.choice(self.nodes, "nodes", NODES)
        record.order = arguments.integer(self.order, "order", 0, 2**31 - 1)
        record.multiplier_order = arguments.integer(
            self.multiplier_order, "multiplier_order", -(2**31), 2**31 - 1
        )
        record.symmetric = bool(self.symmetric)
        self._set(_record=record, _kept=kept)
        _validator()._c("stepper", record, ffi.NULL)

    @classmethod
    def find(cls, name: str) -> Scheme:
        """Return the scheme of this name.

        Parameters
        ----------
        name : str
            "explicit", "midpoint", "endpoint", a number in [0, 1] (beta), "leapfrog",
            "leapfrog-mirror"; with "-nodes" for kept nodes; "leapfrog" and "midpoint" with
            "-suzuki4", "-yoshida4", "-kl6", "-kl8", "-ss10"; "bm4", "bm6"; "pair:A:B", see `pair`;
            "reference" or "taylor", the flow of the ODE on D; or ``"FILE:SYMBOL"``, see
            `from_library`.  ``-`` and ``_`` are equivalent.

        Raises
        ------
        ValueError
            If there is no such scheme.  The message lists the names.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Scheme.find("leapfrog").substeps
        ((0.0, 0.5), (1.0, 0.5))
        """
        path, _, symbol = arguments.text(name, "scheme").rpartition(":")
        return cls.from_library(path, symbol) if path.endswith(".so") else cls._named(name)

    @classmethod
    @functools.lru_cache(maxsize=256)
    def _named(cls, name: str) -> Scheme:
        """Return the scheme of a name, cached because schemes are immutable."""
        record = ffi.new("dal_scheme *")
        error = ffi.new("dal_error *")
        status = lib.dal_scheme_find(record, name.encode(), error)
        if status < 0:
            meant = arguments.suggestion(name, [s.name for s in schemes()])
            raise core.failure(status, f"{core.words(error)}; {meant}".rstrip("; "))
        return cls._read(record, ("find", name))

    @classmethod
    def pair(cls, lagrangian: Any = 0.5, constraint: Any = None) -> Scheme:
        """Return the velocity integrator of two difference maps (VNI).

        Parameters
        ----------
        lagrangian, constraint : float or DifferenceMap, optional
            The maps rho for L_d and rho' for D_d; a number is the beta of rho^beta.  The default of
            ``constraint`` is the map ``lagrangian``.  The steps are those of `Discrete.advance`.

        Examples
        --------
        >>> import dalembert as dal
        >>> run = dal.integrate(dal.systems.robot(), dal.Scheme.pair(0.25, 0.5), h=0.1, steps=10)
        >>> bool(run.residual.max() < 1e-15)
        True
        """
        maps = [
            one if isinstance(one, DifferenceMap) else DifferenceMap(one)
            for one in (lagrangian, lagrangian if constraint is None else constraint)
        ]
        first, second = (one.beta for one in maps)
        name = f"pair:{first!r}:{second!r}"
        if len(name) > 39:  # of a dal_scheme; the numbers themselves are in its data
            name = f"pair:{first:.14g}:{second:.14g}"
        betas = {"lagrangian": {"beta": first}, "constraint": {"beta": second}}
        data = ffi.new("dal_pair *", betas)
        self = cls._of_family(name, ("pair", *maps), data)
        self._set(_maps=maps if any(one.map for one in maps) else None)
        return self

    @classmethod
    def flow(cls, method: str = "rk8pd", tolerance: float = 1e-13) -> Scheme:
        """Return the scheme "reference" with a method and a tolerance, as for `integrate`.

        The method "taylor" is the scheme of this name.
        """
        if arguments.choice(method, "method", METHODS) < 0:
            return cls.taylor(tolerance)
        return cls._flow(method, arguments.tolerance(tolerance))

    @classmethod
    def taylor(cls, tolerance: float = 1e-15) -> Scheme:
        """Return the scheme "taylor": the flow of the ODE on D by Taylor series.

        Parameters
        ----------
        tolerance : float, optional
            Admissible error of a step, relative to the change of each coordinate in it, in
            [4.4e-16, 0.1].

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Scheme.taylor(1e-9).tolerance
        1e-09
        """
        return cls._taylor(arguments.tolerance(tolerance))

    @classmethod
    @functools.lru_cache(maxsize=64)
    def _taylor(cls, tolerance: float) -> Scheme:
        data = ffi.new("dal_taylor_scheme *", {"tolerance": tolerance})
        return cls._of_family("taylor", ("taylor", tolerance), data)

    @classmethod
    @functools.lru_cache(maxsize=64)
    def _flow(cls, method: str, tolerance: float) -> Scheme:
        numbers = {"method": METHODS[method], "tolerance": tolerance}
        data = ffi.new("dal_flow_scheme *", numbers)
        return cls._of_family("reference", ("flow", method, tolerance), data)

    @classmethod
    def from_library(cls, path: str, symbol: str) -> Scheme:
        """Return the ``dal_scheme`` called ``symbol`` in a shared library, with its own family.

        Compile the library with ``dalembert/family.h``.  If it calls libdalembert, link it with
        this version.  `find` accepts the scheme as "path:symbol".

        Raises
        ------
        ValueError
            If there is no such library, or no such symbol in it.
        """
        try:
            library = ctypes.CDLL(os.path.abspath(path))
            address = ctypes.addressof(ctypes.c_char.in_dll(library, symbol))
        except (OSError, ValueError) as error:
            raise ValueError(f"scheme = {path}:{symbol}: {error}") from None
        record = ffi.cast("dal_scheme *", address)
        return cls._read(record, ("from_library", os.path.abspath(path), symbol), kept=library)

    @classmethod
    def _of_family(cls, name: str, source: tuple[Any, ...], data: Any = ffi.NULL) -> Scheme:
        """Return the scheme of a name with other data."""
        record = ffi.new("dal_scheme *")
        core.check(lib.dal_scheme_find(record, name.encode(), ffi.NULL))
        record.data = data
        return cls._read(record, source, data)

    @classmethod
    def of(cls, value: Scheme | str | float) -> Scheme:
        """Return a scheme given as an object, by its name, or by its beta."""
        if isinstance(value, Scheme):
            return value
        if isinstance(value, str):
            return cls.find(value)
        try:
            beta = float(value)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(
                f"scheme = {arguments.shown(value)}: expected a Scheme, the name of a scheme, "
                "or a number beta"
            ) from None
        if not 0.0 <= beta <= 1.0:
            raise ValueError(f"scheme = {arguments.shown(value)}: expected beta in [0, 1]")
        # Not by its text: what C reads as a decimal point depends on the locale.
        symmetric = beta == 0.5
        return replace(
            cls.find("0"),
            substeps=((beta, 1.0),),
            name=repr(beta),
            order=2 if symmetric else 1,
            symmetric=symmetric,
        )

    @classmethod
    def usual(cls, system: System, word: str | None = None) -> Scheme:
        """Return the default scheme of a run with a number or a word for its step size.

        For a number it is the scheme of order 2 with the cheapest steps.  It is "midpoint" if the
        mass matrix depends on q, the constraints are affine or nonlinear, or a force depends on v.
        Otherwise it is "leapfrog", which then solves its two sub-steps at once.  For "auto" it is
        the composition of order 8 of that scheme, and for "reversible" "bm6".  For "own" it is
        "taylor", or "reference" if the system has no Taylor series.
        """
        if word == "own":
            has_series = system._model is not None and twin(system, "series") is not None
            return cls.find("taylor" if has_series else "reference")
        if word == "reversible":
            return cls.find("bm6")
        base = core.string(lib.dal_scheme_usual(system._handle))
        return cls.find(f"{base}-kl8" if word == "auto" else base)

    @classmethod
    def _read(cls, record: Any, source: tuple[Any, ...], kept: Any = None) -> Scheme:
        """Return the scheme of a ``dal_scheme``, which ``source`` would create again."""
        given = {
            "nodes": "kept" if record.nodes == lib.DAL_KEPT_NODES else "moved",
            **{key: core.string(getattr(record, key)) for key in ("name", "help", "reference")},
            **{key: getattr(record, key) for key in ("order", "multiplier_order")},
            "symmetric": bool(record.symmetric),
        }
        if record.family == ffi.NULL:
            pairs = tuple((s.beta, s.fraction) for s in record.substeps[0 : record.count])
            return cls(substeps=pairs or ((record.beta, 1.0),), **given)
        own = ffi.new("dal_scheme *", record[0])
        self = cls.__new__(cls)
        self._set(**given, substeps=(), _record=own, _kept=(kept, record), _source=source)
        return self

    def _set(self, **values: Any) -> None:
        """Set attributes of this immutable object during its creation."""
        for key, value in values.items():
            object.__setattr__(self, key, value)

    @functools.cached_property
    def family(self) -> str:
        """The family of the steps: "beta", "pair", "flow", "taylor", or that of a library."""
        return core.string(lib.dal_scheme_family(self._record))

    @property
    def is_flow(self) -> bool:
        """True for the flow of the ODE on D: the schemes "reference" and "taylor"."""
        return self.family in ("flow", "taylor")

    @property
    def tolerance(self) -> float | None:
        """Tolerance of "reference" or "taylor" if it was given; None for other schemes."""
        return self._source[-1] if self._source[:1] in (("flow",), ("taylor",)) else None

    def _record_of(self, system: System) -> tuple[Any, Any]:
        """Return the ``dal_scheme`` for a system, and the objects to keep alive."""
        if self._maps is None:
            return self._record, self
        definitions, kept = zip(*(one._definition(system.n) for one in self._maps))
        lagrangian, constraint = (each[0] for each in definitions)
        data = ffi.new("dal_pair *", {"lagrangian": lagrangian, "constraint": constraint})
        record = ffi.new("dal_scheme *", self._record[0])
        record.data = data
        return record, (self, data, kept)

    def _stepped(self, system: System) -> System:
        """Return the system compiled for the steps, itself if there is none."""
        found = twin(system, "series" if self.family == "taylor" else "steps")
        return system if found is None else found

    def is_explicit(self, system: System) -> bool:
        """Return whether a step on this system is a sequence of linear solves."""
        require_system(system)
        return bool(lib.dal_scheme_is_explicit(self._record, system._handle))

    def shift(self, h: float) -> float:
        """Return the shift (1 - beta) h of the D_eps that kept nodes preserve.

        Raises
        ------
        NotImplementedError
            For a record with several sub-steps, which has no D_eps.
        """
        shift = ffi.new("double *")
        status = lib.dal_scheme_shift(self._record, shift)
        core.check(
            status,
            f"{self.name!r} has several sub-steps, and so no D_eps; expected a scheme with one",
        )
        return float(shift[0]) * arguments.number(h, "h")

    def _initial(self, name: str | None) -> int:
        """Return the ``dal_initial`` of an argument ``initial``, which kept nodes require."""
        if self.nodes == "moved":
            return int(lib.DAL_INITIAL_NONE)
        if name is None:
            raise ValueError(
                f"initial is missing: {self.name!r} has kept nodes, so choose one of "
                f"{', '.join(map(repr, INITIAL))}. For data in D, 'shift' moves q0 and 'project' "
                "moves v0"
            )
        return arguments.choice(name, "initial", INITIAL)

    def _data(self) -> Any:
        """Return data for JSON that define the scheme; None if it contains code."""
        constructor, *given = self._source or ("", *self.__reduce__()[1])
        if constructor == "pair":
            given = [one.beta for one in given] if self._maps is None else None
        return None if constructor == "from_library" or given is None else [constructor, *given]

    @classmethod
    def _from_data(cls, data: Any) -> Scheme:
        """Return the scheme of `_data`."""
        constructor, *given = data
        return getattr(cls, constructor)(*given) if constructor else cls(*given)

    def __str__(self) -> str:
        return self.name

    def __repr__(self) -> str:
        promised = f", order {self.order}" if self.order else ""
        if not self.substeps:
            return f"<Scheme {self.name}: family {self.family}{promised}>"
        few = ", ".join(f"({beta:g}, {fraction:g})" for beta, fraction in self.substeps[:4])
        many = f", ..., {len(self.substeps)} in all" if len(self.substeps) > 4 else ""
        return f"<Scheme {self.name}: (beta, fraction) = {few}{many}; {self.nodes} nodes{promised}>"

    def __reduce__(self) -> tuple[Any, ...]:
        if self._source:
            constructor, *given = self._source
            return getattr(Scheme, constructor), tuple(given)
        return Scheme, (
            self.substeps, self.nodes, self.name, self.help, self.reference, self.order,
            self.multiplier_order, self.symmetric,
        )  # fmt: skip


@functools.cache
def _validator() -> System:
    """Return a system on which C can validate a scheme: a free particle on a line."""
    return System(mass=[1.0], name="free particle")


def schemes() -> list[Scheme]:
    """Return the named schemes.

    Examples
    --------
    >>> import dalembert as dal
    >>> "leapfrog" in [scheme.name for scheme in dal.schemes()]
    True
    """
    found = []
    for i in range(lib.dal_scheme_count()):
        record = ffi.new("dal_scheme *")
        core.check(lib.dal_scheme_at(record, i))
        found.append(Scheme._read(record, ("find", core.string(record.name))))
    return found
