"""Schemes as records: beta-schemes one after the other, each over a fraction of the step."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, replace
from typing import Any

from .. import core
from ..core import arguments, ffi, lib, require_system
from ..system import System

__all__ = ["Scheme", "schemes"]

NODES = {"moved": lib.DAL_MOVED_NODES, "kept": lib.DAL_KEPT_NODES}
INITIAL = {
    "D": lib.DAL_INITIAL_D,
    "D_eps": lib.DAL_INITIAL_D_EPS,
    "project": lib.DAL_INITIAL_PROJECT,
    "shift": lib.DAL_INITIAL_SHIFT,
}


@dataclass(frozen=True, repr=False)
class Scheme:
    """A scheme as a record: beta-schemes one after the other, each over a fraction of the step.

    Parameters
    ----------
    substeps : sequence of (beta, fraction)
        beta in [0, 1]; the fractions are not 0 and sum to 1.
    nodes : {"moved", "kept"}, optional
        Where the states are: "moved" nodes (1 - beta) q_{k-1} + beta q_k keep D; "kept" nodes q_k
        keep D_eps = {mu(q - (1 - beta) h v) v = 0} and need a single sub-step.
    name : str, optional
        At most 39 bytes.
    help, reference : str, optional
        One line about the scheme, and where it comes from.
    order, multiplier_order : int, optional
        What is promised, (p, s): local errors O(h^(p+1)) of q and v and O(h^(s+1)) of the scheme's
        own multipliers.  order 0: nothing is promised.
    symmetric : bool, optional
        True if the scheme is its own adjoint on D.

    Raises
    ------
    ValueError
        If the record is not valid; the text says what.

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

    def __post_init__(self) -> None:
        name = arguments.text(self.name, "name").encode()
        if not 0 < len(name) < 40:
            raise ValueError(f"name = {self.name!r}: expected 1 to 39 bytes, got {len(name)}")
        if not self.is_reference:
            if isinstance(self.substeps, str):
                raise ValueError(
                    f"substeps = {self.substeps!r}: expected several (beta, fraction); Scheme.find "
                    "has the schemes with a name"
                )
            if isinstance(self.substeps, (list, tuple)) and len(self.substeps) == 0:
                raise ValueError("substeps is empty: expected at least one (beta, fraction)")
            pairs = arguments.array(self.substeps, "substeps", (None, 2))
            object.__setattr__(self, "substeps", tuple((float(b), float(f)) for b, f in pairs))
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
        object.__setattr__(self, "_record", record)
        object.__setattr__(self, "_kept", kept)
        if not self.is_reference:
            _validator()._c("stepper", record, ffi.NULL)

    @classmethod
    def find(cls, name: str) -> Scheme:
        """Return the scheme of this name, "reference" for the reference flow.

        Parameters
        ----------
        name : str
            "explicit", "midpoint", "endpoint", a number in [0, 1] (beta), "leapfrog",
            "leapfrog-mirror"; with "-nodes" for kept nodes; "leapfrog" and "midpoint" with
            "-suzuki4", "-yoshida4", "-kl6", "-kl8".  ``-`` and ``_`` are the same.

        Raises
        ------
        ValueError
            If there is no such scheme; the text lists what there is.

        Examples
        --------
        >>> import dalembert as dal
        >>> dal.Scheme.find("leapfrog").substeps
        ((0.0, 0.5), (1.0, 0.5))
        """
        if arguments.text(name, "scheme") == REFERENCE.name:
            return REFERENCE
        record = ffi.new("dal_scheme *")
        error = ffi.new("dal_error *")
        status = lib.dal_scheme_find(record, name.encode(), error)
        if status < 0:
            meant = arguments.suggestion(name, [*(s.name for s in schemes()), REFERENCE.name])
            text = core.string(error.text).replace("; there are", f"; {meant}there are")
            raise core.failure(status, f"{text}; integrate takes reference too, the flow of GSL")
        return cls._read(record)

    @classmethod
    def of(cls, value: Scheme | str | float) -> Scheme:
        """Return a scheme that is given as itself, by its name, or by its beta."""
        if isinstance(value, Scheme):
            return value
        if isinstance(value, str):
            return cls.find(value)
        try:
            beta = float(value)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(
                f"scheme = {arguments.shown(value)}: expected a Scheme, the name of one, or beta"
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
    def _read(cls, record: Any) -> Scheme:
        """Return the scheme of a ``dal_scheme``."""
        count = int(record.count)
        return cls(
            substeps=tuple((s.beta, s.fraction) for s in record.substeps[0:count])
            if count
            else ((record.beta, 1.0),),
            nodes="kept" if record.nodes == lib.DAL_KEPT_NODES else "moved",
            name=core.string(record.name),
            help=core.string(record.help),
            reference=core.string(record.reference),
            order=int(record.order),
            multiplier_order=int(record.multiplier_order),
            symmetric=bool(record.symmetric),
        )

    @property
    def is_reference(self) -> bool:
        """True for the reference flow, which has no sub-steps."""
        return self.name == "reference" and len(self.substeps) == 0

    def is_explicit(self, system: System) -> bool:
        """Return whether a step on this system is a sequence of linear solves."""
        require_system(system)
        return not self.is_reference and bool(
            lib.dal_scheme_is_explicit(self._record, system._handle)
        )

    def shift(self, h: float) -> float:
        """Return the shift (1 - beta) h of the D_eps that kept nodes keep.

        Raises
        ------
        NotImplementedError
            For a record with several sub-steps, which has no D_eps.
        """
        shift = ffi.new("double *")
        status = lib.dal_scheme_shift(self._record, shift)
        core.check(status, f"{self.name!r} has no single sub-step, and so no D_eps")
        return float(shift[0]) * arguments.number(h, "h")

    def _initial(self, name: str | None) -> int:
        """Return the ``dal_initial`` of an argument ``initial``, which kept nodes need.

        Raises
        ------
        ValueError
            If kept nodes are not told how to start, or moved ones are.
        """
        if self.nodes == "moved":
            if name is not None:
                raise ValueError(
                    f"initial = {name!r}: {self.name!r} has moved nodes, it takes none"
                )
            return int(lib.DAL_INITIAL_NONE)
        if name is None:
            raise ValueError(
                f"initial: needed, because {self.name!r} has kept nodes: one of "
                f"{', '.join(map(repr, INITIAL))}"
            )
        return arguments.choice(name, "initial", INITIAL)

    def __str__(self) -> str:
        return self.name

    def __repr__(self) -> str:
        if self.is_reference:
            return f"<Scheme {self.name}: the adaptive flow of GSL>"
        promised = f", order {self.order}" if self.order else ""
        few = ", ".join(f"({beta:g}, {fraction:g})" for beta, fraction in self.substeps[:4])
        many = f", ..., {len(self.substeps)} in all" if len(self.substeps) > 4 else ""
        return f"<Scheme {self.name}: (beta, fraction) = {few}{many}; {self.nodes} nodes{promised}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return Scheme, (
            self.substeps, self.nodes, self.name, self.help, self.reference, self.order,
            self.multiplier_order, self.symmetric,
        )  # fmt: skip


@functools.cache
def _validator() -> System:
    """Return a system on which the core can try a record: a free particle on a line."""
    return System(mass=[1.0], name="free particle")


REFERENCE = Scheme(
    (),
    name="reference",
    help="adaptive integration of the ODE on D: best for short accurate runs",
    reference="GSL odeiv2: rk8pd, msadams; Hairer and Wanner 1996: rodas",
)


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
        found.append(Scheme._read(record))
    return found
