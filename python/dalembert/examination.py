"""What is found when a system is examined at a state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from . import _lib, geometry
from ._lib import ffi, lib

if TYPE_CHECKING:
    from .system import System

__all__ = ["Check", "Difference", "examine"]


@dataclass(frozen=True)
class Difference:
    """A derivative compared with central differences.

    Attributes
    ----------
    error : float
        Worst ``|given - differenced| / (1 + |differenced|)`` over the entries.
    given, expected : float
        The two numbers at that entry.
    row, column : int
        Which entry it is.
    checked : bool
        False if the derivative was not provided, so that there is nothing to compare.
    """

    error: float
    given: float
    expected: float
    row: int
    column: int
    checked: bool

    @classmethod
    def read(cls, found: Any) -> Difference:
        """Return the comparison of a ``dal_difference``."""
        return cls(
            error=found.error,
            given=found.given,
            expected=found.expected,
            row=int(found.row),
            column=int(found.column),
            checked=bool(found.checked),
        )

    def __str__(self) -> str:
        if not self.checked:
            return "not given, nothing to compare"
        return (
            f"worst error {self.error:.1e} at [{self.row}, {self.column}]: "
            f"given {self.given:.10g}, by differences {self.expected:.10g}"
        )


@dataclass(frozen=True)
class Check:
    """What `System.check` found at one state; true if all is as it should be.

    Attributes
    ----------
    passed : bool
        True if everything below is as it should be.
    V_q, V_qq, phi_q : Difference
        gradient, hessian and forms_velocity_derivative against differences.
    linearity : float
        Worst change of mu(q) with v; mu must not depend on v.
    rank : int
        Of mu(q); should be m.
    condition : float
        Condition number of mu(q) in the mass metric.
    mass_min, kernel_min : float
        Smallest eigenvalues of the mass matrix M on R^n and on ker mu.
    residual : float
        ``max_a |mu^a v| / sum_i |mu^a_i v_i|``: 0 if the velocity lies in D.
    curvature : float
        Largest curvature of D over an orthonormal basis; 0 if D is integrable here.
    integrable : bool
        True if the curvature vanishes here: D may be a holonomic constraint in disguise.
    text : str
        The first thing found wrong, or a summary.
    """

    passed: bool
    V_q: Difference
    V_qq: Difference
    phi_q: Difference
    linearity: float
    rank: int
    condition: float
    mass_min: float
    kernel_min: float
    residual: float
    curvature: float
    integrable: bool
    text: str

    def __bool__(self) -> bool:
        return self.passed

    def __str__(self) -> str:
        lines = [
            ("", ("passed: " if self.passed else "FAILED: ") + self.text),
            ("gradient (V_q)", self.V_q),
            ("hessian (V_qq)", self.V_qq),
            ("d(mu v)/dq (phi_q)", self.phi_q),
            ("change of mu with v", f"{self.linearity:.1e}"),
            ("rank of mu", self.rank),
            ("condition of mu", f"{self.condition:.3g}"),
            ("smallest mass", f"{self.mass_min:.6g}, on ker mu {self.kernel_min:.6g}"),
            ("|mu v|, relative", f"{self.residual:.1e}"),
            ("curvature of D", f"{self.curvature:.3g}" + (", integrable" * self.integrable)),
        ]
        return "\n".join(f"{name:20} {value}" if name else str(value) for name, value in lines)


def examine(system: System, q: ArrayLike | None, v: ArrayLike | None) -> Check:
    """Return what the core finds at a state; see `System.check`."""
    x = np.concatenate(geometry.initial(system, q, v, "q", "v"))
    report = ffi.new("dal_check *")
    error = ffi.new("dal_error *")
    status = _lib.attempt(lib.dal_system_check, system._handle, _lib.pointer(x), report, error)
    # A callback that is not finite is a finding; an exception of the user's is not.
    if status < 0 and not (status == lib.DAL_EDOMAIN and _lib.string(report.text)):
        raise _lib.failure(status, _lib.string(error.text))
    return Check(
        passed=bool(report.passed) and status == lib.DAL_SUCCESS,
        V_q=Difference.read(report.V_q),
        V_qq=Difference.read(report.V_qq),
        phi_q=Difference.read(report.phi_q),
        linearity=report.linearity,
        rank=int(report.rank),
        condition=report.condition,
        mass_min=report.mass_min,
        kernel_min=report.kernel_min,
        residual=report.residual,
        curvature=report.curvature,
        integrable=bool(report.integrable),
        text=_lib.in_python(_lib.string(report.text)),
    )
