"""Results of the check of a system at a state."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from .. import core
from ..core import Handle, ffi, functions, lib
from . import mechanics

DERIVATIVES = (
    "V_q", "V_qq", "L_q", "L_v", "L_qq", "L_vq", "L_vv", "L_vt", "f_q", "f_v", "phi_v", "phi_q",
    "phi_t",
)  # fmt: skip


NUMBERS = ("linearity", "rank", "condition", "mass_min", "kernel_min", "residual", "curvature")


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
        Indices of that entry.
    checked : bool
        False if the derivative was not provided, or no entry could be judged.
    wrong : bool
        True if the two numbers disagree.
    unjudged : int
        Number of entries omitted because their differences do not converge.
    """

    error: float
    given: float
    expected: float
    row: int
    column: int
    checked: bool
    wrong: bool = False
    unjudged: int = 0

    @classmethod
    def read(cls, found: Any) -> Difference:
        """Return the comparison of a ``dal_difference``."""
        truth = {name: bool(getattr(found, name)) for name in ("checked", "wrong")}
        return cls(**core.members(found) | truth)

    def __str__(self) -> str:
        left = (
            f"{self.unjudged} not judged: finite differences do not converge"
            if self.unjudged
            else ""
        )
        if not self.checked:
            return left or "not given, nothing to compare"
        return (
            f"largest error {self.error:.1e} at [{self.row}, {self.column}]: given "
            f"{self.given:.10g}, by finite differences {self.expected:.10g}"
            + (f"; {left}" if left else "")
        )


@dataclass(frozen=True, repr=False)
class Check:
    """The results of `System.check` at one state; true if all checks pass.

    Attributes
    ----------
    passed : bool
        True if all checks pass.
    kind : {"linear", "affine", "nonlinear"}
        How the constraints depend on v.
    general, forced, timed : bool
        Whether the system has a general Lagrangian, has a force, depends on time.
    V_q, V_qq : Difference
        gradient and hessian.
    L_q, L_v, L_qq, L_vq, L_vv, L_vt : Difference
        The derivatives of a general Lagrangian, lagrangian_q and so on.
    f_q, f_v : Difference
        force_q and force_v.
    phi_v, phi_q, phi_t : Difference
        The derivatives of the constraints: phi_v is mu or constraint_v; phi_q is d(mu v)/dq or
        constraint_q; phi_t is constraint_t.
    linearity : float
        Worst change of mu with v; 0 unless the constraints are nonlinear.
    rank : int
        Rank of mu; should be m.
    condition : float
        Condition number of mu in the mass metric.
    mass_min, kernel_min : float
        Smallest eigenvalues of the mass matrix M at the state, on R^n and on ker mu.  For m = n
        ``kernel_min`` is infinite.
    residual : float
        `System.relative_residual` of the velocity: 0 in D.
    curvature : float
        Largest curvature of D over an orthonormal basis; 0 if D is integrable here.  NaN unless the
        constraints are linear.
    integrable : bool
        True if D is integrable at general points, so that the constraints are holonomic.  The
        growth vector decides; if it is unknown, the curvature at the state and nearby decides.  If
        mu is piecewise (Max, Abs, Piecewise, ...), the result holds for a neighbourhood of the
        state only, unless ``exact``.
    text : str
        The first failure, or a summary.
    text_on_D : str
        The end of the summary: whether D is integrable.
    growth : tuple of int or None
        Growth vector of D: the dimensions of D, D + [D, D], ... The point is q if given, else a
        general point near the initial data.  It ends with n if D is bracket generating, and with n
        - k twice if k constraints are holonomic.  For other ends see ``growth_note``.  None if it
        is unknown, or the constraints are not linear.
    general_growth : tuple of int or None
        The growth vector at a general point: the largest of several, most of them near the state.
        If ``growth`` differs, q is a singular point, or mu is simpler there than elsewhere.
    growth_note : str
        Why ``growth`` has another end, or for which points it is known; or "".
    holonomic : tuple of str
        For systems from `System.from_sympy`: the constraints that are holonomic by themselves, and
        the number that are if combined.
    exact : bool
        True if D is proved to be integrable, or bracket generating.  A proof needs expressions,
        from `System.from_sympy` or from complete formulas.  False if the result is based on random
        points.
    digits : int
        Number of digits used at random points: 30 with expressions, 16 with functions.
    still : tuple of str
        For affine constraints from `System.from_sympy`: their terms without a velocity, in case one
        is missing by mistake.
    """

    passed: bool
    kind: str
    general: bool
    forced: bool
    timed: bool
    V_q: Difference
    V_qq: Difference
    L_q: Difference
    L_v: Difference
    L_qq: Difference
    L_vq: Difference
    L_vv: Difference
    L_vt: Difference
    f_q: Difference
    f_v: Difference
    phi_v: Difference
    phi_q: Difference
    phi_t: Difference
    linearity: float
    rank: int
    condition: float
    mass_min: float
    kernel_min: float
    residual: float
    curvature: float
    integrable: bool
    text: str
    text_on_D: str = ""
    growth: tuple[int, ...] | None = None
    general_growth: tuple[int, ...] | None = None
    growth_note: str = ""
    holonomic: tuple[str, ...] = ()
    exact: bool = False
    digits: int = 16
    still: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return self.passed

    def with_distribution(self, found: Any) -> Check:
        """Return the check with further results about D, consistent about integrability."""
        if found.integrable and found.digits == 16 and not self.integrable:
            found = dataclasses.replace(found, integrable=False)  # curved at one of the points
        known = dataclasses.asdict(found)
        if found.integrable is None or found.integrable == self.integrable:
            return dataclasses.replace(self, **(known | {"integrable": self.integrable}))
        said = f"D is {'' if found.integrable else 'not '}integrable" if self.passed else ""
        text = self.text.removesuffix(self.text_on_D) + said
        return dataclasses.replace(self, **(known | {"text": text, "text_on_D": said}))

    def _lines(self) -> list[tuple[str, Any]]:
        """Return the results with their names, the verdict first."""
        curvature = f"{self.curvature:.3g}" + (", integrable" * self.integrable)
        if self.passed and math.isnan(self.curvature):
            curvature = "- (D changes with inputs)"
        on_kernel = f", on ker mu {self.kernel_min:.6g}" if self.kernel_min < math.inf else ""
        lines: list[tuple[str, Any]] = [
            ("passed" if self.passed else "FAILED", self.text),
            *self._derivatives(),
            ("change of mu with v", f"{self.linearity:.1e}"),
            ("rank of mu", self.rank),
            ("condition of mu", f"{self.condition:.3g}"),
            ("smallest mass", f"{self.mass_min:.6g}{on_kernel}"),
            ("|phi|, relative", f"{self.residual:.1e}"),
            ("curvature of D", curvature if self.kind == "linear" else f"- ({self.kind})"),
        ]
        if self.growth is not None:
            how = "" if self.exact else " (seen at points)"
            note = f"; {self.growth_note}" if self.growth_note else ""
            lines.append(("growth vector of D", f"{self.growth}{how}{note}"))
        elif self.growth_note:
            lines.append(("growth vector of D", f"not known; {self.growth_note}"))
        if self.general_growth != self.growth:
            lines.append(("at a general point", self.general_growth))
        lines += [("without a velocity", text) for text in self.still]
        return lines + [("holonomic in disguise", text) for text in self.holonomic]

    def __str__(self) -> str:
        (verdict, text), *lines = self._lines()
        return "\n".join([f"{verdict}: {text}", *(f"{name:20} {x}" for name, x in lines)])

    def __repr__(self) -> str:
        return f"<Check: {'passed' if self.passed else 'FAILED'}: {self.text}>"

    def _derivatives(self) -> list[tuple[str, Difference]]:
        """Return the derivatives that a system of this kind may have."""
        wanted = ["L_q", "L_v", "L_qq", "L_vq", "L_vv"] if self.general else ["V_q", "V_qq"]
        wanted += ["L_vt"] * (self.general and self.timed) + ["f_q", "f_v"] * self.forced
        wanted += ["phi_t"] * self.timed + ["phi_v"] * (self.kind != "linear")
        names = functions.outputs(self.kind)
        found = [(f"{names[output]} ({output})", getattr(self, output)) for output in wanted]
        last = {"linear": "d(mu v)/dq (phi_q)", "affine": "phi_q"}
        return [*found, (last.get(self.kind, "constraint_q (phi_q)"), self.phi_q)]


def examine(system: Handle, q: ArrayLike | None, v: ArrayLike | None, t: float = 0.0) -> Check:
    """Return the results of C at a state; see `System.check`."""
    x = mechanics.initial_state(system, q, v, "q", "v")
    report, error = ffi.new("dal_check *"), ffi.new("dal_error *")
    status = core.attempt(lib.dal_system_check, system._handle, t, x, report, error)
    finding = ffi.addressof(report, "finding")
    # A callback that is not finite is a finding; an exception of the user's is not.
    if status < 0 and not (status == lib.DAL_EDOMAIN and core.string(finding.text)):
        core.check(status, error, system.kind)
    is_summary = core.string(finding.output) == "D"
    on_D = ffi.string(finding.text)[finding.begin :] if is_summary else b""
    return Check(
        passed=bool(report.passed) and status == lib.DAL_SUCCESS,
        kind=system.kind,
        general=not system.has_constant_mass,
        forced=system.is_forced,
        timed=system.is_time_dependent,
        **{name: Difference.read(ffi.addressof(report, name)) for name in DERIVATIVES},
        **{name: getattr(report, name) for name in NUMBERS},
        integrable=bool(report.integrable),
        text=core.words(finding, system.kind),
        text_on_D=on_D.decode(),
    )
