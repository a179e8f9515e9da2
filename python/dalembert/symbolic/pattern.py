"""The entries of a model's matrices that are zero everywhere, which its step routine omits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .graph import below
from .model import Model

MOST = 8  # coordinates; n*n bits have to fit into a word of 64

Rows = list[list[bool]]


@dataclass(frozen=True)
class Pattern:
    """The entries that may be nonzero, as in ``dal_pattern`` of kernel.h.

    Attributes
    ----------
    inverse, mu, Z, N, pull, kick, one, L_vq, F_q, F_v, K : list of list of bool
        Row by row; ``pull``, ``kick`` and ``one`` have one row.
    steady : bool
        Whether no constraint force acts on a coordinate that mu depends on, and nothing depends on
        time.
    apart : bool
        Whether the system is steady, and V_q does not act on such a coordinate either.
    """

    inverse: Rows
    mu: Rows
    Z: Rows
    N: Rows
    pull: Rows
    kick: Rows
    one: Rows
    L_vq: Rows
    F_q: Rows
    F_v: Rows
    K: Rows
    steady: bool
    apart: bool

    def initializer(self) -> str | None:
        """Return the ``dal_pattern`` in C; None if there are too many coordinates."""
        if len(self.inverse) > MOST:
            return None
        matrices = (
            self.inverse, self.mu, self.Z, self.N, self.pull, self.kick, self.one,
            self.L_vq, self.F_q, self.F_v, self.K,
        )  # fmt: skip
        masks = [  # the bits a*n + i of the entries (a, i)
            sum(1 << int(k) for k in np.flatnonzero(rows)) for rows in matrices
        ]
        return "{" + ", ".join(f"{mask:#x}ULL" for mask in masks) + "}"


def pattern(model: Model) -> Pattern:
    """Return the pattern of a model.

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
    of_momenta = derived.has_momenta

    def rows(entries: Sequence[Any]) -> Any:
        return np.array([not e.is_zero for e in entries], dtype=bool).reshape(-1, n)

    forms = derived.entries("constraint", "phi_v")
    mu, N = rows(forms), rows(derived.entries("constraint", "phi_q"))
    mass = rows(derived.entries("balance", "L_vv") if of_momenta else derived.mass or ())
    none = np.zeros((n, n), dtype=bool)
    slopes = [none] * 3
    if of_momenta:
        slopes = [rows(derived.entries("balance", x)) for x in ("L_vq", "F_q", "F_v")]
    K = np.any([mass, *slopes], axis=0)
    # coordinates that M, or K, couples, through others too, fill a block
    inverse, inverse_of_K = _closed(mass), _closed(K)
    Z = mu @ inverse_of_K.T
    pushed = Z.any(axis=0)
    of_force = (("balance", "F"), ("pull", "V_q"), ("potential", "V_q"))
    force = next((x for name in of_force if (x := derived.entries(*name))), ())
    kick = (rows(force) @ inverse).any(axis=0)
    pull = pushed | kick
    # what mu depends on: not only where it has a derivative
    bending = {e.value for e in below(forms) if e.op == "symbol"}
    steady = model.m > 0 and not model.is_time_dependent and not of_momenta
    bends = np.array([q.name in bending for q in model.q], dtype=bool)
    steady = steady and not (pushed & bends).any()
    alone, M = inverse.sum(axis=0) == 1, derived.mass
    one = np.array([M is not None and M[i * n + i].value == 1 for i in range(n)]) & alone
    matrices = (
        inverse, mu, Z, N, pull[None], kick[None], one[None],
        *slopes, _filled(K) if of_momenta else none,
    )  # fmt: skip
    apart = steady and not (kick & bends).any()
    return Pattern(*(x.tolist() for x in matrices), bool(steady), bool(apart))


def field_zeros(model: Model) -> str:
    """Return the ``dal_field_zeros`` of field.h in C, for at most `MOST` coordinates."""
    n, terms = model.n, model.derived.terms.outputs

    def rows(entries: Sequence[Any], columns: int = n) -> Any:
        return np.array([not e.is_zero for e in entries], dtype=bool).reshape(-1, columns)

    mass = rows(model.derived.mass or terms["M"])
    inverse, L = _closed(mass), np.tril(_filled(mass), -1)
    mu = rows(terms["mu"]) if model.m > 0 else np.zeros((1, n), dtype=bool)
    matrices = inverse, L, rows(terms["F"]), mu, mu @ inverse
    masks = [sum(1 << int(k) for k in np.flatnonzero(x)) for x in matrices]
    return "{" + ", ".join(f"{mask:#x}ULL" for mask in masks) + "}"


def _closed(coupled: Any) -> Any:
    """Return the pairs of coordinates coupled through others: the entries of the inverse."""
    closed, before = coupled, None
    while not np.array_equal(closed, before):
        before = closed
        wide = closed.astype(np.float32)  # of bool, numpy multiplies matrices slowly
        closed = wide @ wide > 0
    return closed


def _filled(coupled: Any) -> Any:
    """Return the entries of the factors L and U."""
    filled = coupled.copy()
    for j in range(len(filled)):
        filled[j + 1 :, j + 1 :] |= np.outer(filled[j + 1 :, j], filled[j, j + 1 :])
    return filled
