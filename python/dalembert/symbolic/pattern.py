"""Which entries of a model's matrices are zero everywhere: what its step routine leaves out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .model import Model

_MOST = 8  # coordinates; n*n bits have to fit into a word of 64

Rows = list[list[bool]]


@dataclass(frozen=True)
class Pattern:
    """The entries that may be other than zero, as ``dal_pattern`` of kernel.h.

    Attributes
    ----------
    inverse, mu, Z, N, pull, kick, one : list of list of bool
        Row by row; the last three have one row.
    steady : bool
        Whether no reaction pushes a coordinate that mu depends on, and nothing depends on time.
    apart : bool
        Whether it is steady, and V pushes no such coordinate either.
    """

    inverse: Rows
    mu: Rows
    Z: Rows
    N: Rows
    pull: Rows
    kick: Rows
    one: Rows
    steady: bool
    apart: bool

    def initializer(self) -> str | None:
        """Return the ``dal_pattern`` in C; None if there are too many coordinates for one."""
        if len(self.inverse) > _MOST:
            return None
        masks = [  # the bits a*n + i of the entries (a, i)
            sum(1 << int(k) for k in np.flatnonzero(rows))
            for rows in (self.inverse, self.mu, self.Z, self.N, self.pull, self.kick, self.one)
        ]
        return "{" + ", ".join(f"{mask:#x}ULL" for mask in masks) + "}"


def pattern(model: Model) -> Pattern:
    """Return the pattern of a model of constant mass with linear constraints.

    Parameters
    ----------
    model : Model

    Examples
    --------
    >>> import dalembert as dal
    >>> from dalembert.symbolic.pattern import pattern
    >>> x, y, z = dal.coordinates("x y z")
    >>> particle = dal.System.from_sympy((x.d**2 + y.d**2 + z.d**2) / 2, [z.d - y * x.d])
    >>> found = pattern(particle._model)
    >>> found.mu, found.pull, found.steady
    ([[True, False, True]], [[True, False, True]], True)
    """
    n, derived = model.n, model.derived
    assert derived.mass is not None

    def rows(entries: Sequence[Any]) -> Any:
        return np.array([e != 0 for e in entries], dtype=bool).reshape(-1, n)

    forms = derived.expressions("constraint", "phi_v")
    mu, N = rows(forms), rows(derived.expressions("constraint", "phi_q"))
    inverse = rows(derived.mass)
    for _ in range(n.bit_length()):  # coordinates that M couples, through others too, fill a block
        inverse = inverse @ inverse
    Z = mu @ inverse
    pushed = Z.any(axis=0)
    kick = (rows(derived.expressions("potential", "V_q")) @ inverse).any(axis=0)
    pull = pushed | kick
    # what mu depends on: not only where it has a derivative
    bending = {s.name for e in forms for s in e.free_symbols}
    steady = model.m > 0 and not model.is_time_dependent
    bends = np.array([q.name in bending for q in model.q], dtype=bool)
    steady = steady and not (pushed & bends).any()
    alone = inverse.sum(axis=0) == 1
    one = np.array([derived.mass[i * n + i] == 1 for i in range(n)], dtype=bool) & alone
    found = (rows.tolist() for rows in (inverse, mu, Z, N, pull[None], kick[None], one[None]))
    return Pattern(*found, bool(steady), bool(steady and not (kick & bends).any()))
