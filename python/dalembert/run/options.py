"""The table of options that apply to each kind of run."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..core import arguments
from .scheme import Scheme

WORDS = ("auto", "reversible")  # what h may be instead of a number


class Kind(NamedTuple):
    """A kind of run: the words that describe it, and the options that apply to it."""

    asked_by: str
    options: frozenset[str]


def _kind(asked_by: str, options: str) -> Kind:
    return Kind(asked_by, frozenset([*options.split(), *_ALL]))


_ALL = ("t0", "t_end", "stride", "consistent", "observer", "progress", "throw", "t_eval")
_RUN = "max_iterations events journal journal_errors"

KINDS = {
    "fixed": _kind("a fixed step at moved nodes", f"steps energy inputs hold check_h {_RUN}"),
    "kept": _kind("a fixed step at kept nodes", f"steps initial inputs hold check_h {_RUN}"),
    "auto": _kind("h = 'auto'", f"tolerance h_max energy inputs hold {_RUN}"),
    "reversible": _kind("h = 'reversible'", f"eps energy {_RUN}"),
    "flow": _kind(
        "the scheme 'reference'",
        "steps method tolerance inputs hold events journal journal_errors",
    ),
    "series": _kind("method = 'taylor'", "steps method tolerance"),
}

_FIXED = {"fixed", "kept"}

# Advice for an option that the kind of run does not use, where it is not another kind of run.
_INSTEAD = {
    "steps": "give t_end instead, because the steps vary",
    "initial": "remove it, because only schemes with kept nodes take it, such as 'midpoint-nodes'",
}

# Options that have an effect only beside another one.
_NEEDS = {"hold": "inputs", "journal_errors": "journal"}


def word_of(h: Any) -> str | None:
    """Return the word given for a step size, None for a number."""
    if not isinstance(h, str):
        return None
    if h not in WORDS:
        raise ValueError(
            f"h = {h!r}: {arguments.suggestion(h, WORDS)}expected a number or one of "
            f"{', '.join(map(repr, WORDS))}"
        )
    return h


def kind_of(scheme: Scheme, word: str | None = None, method: Any = None) -> str:
    """Return the kind of a run by a scheme; raise ValueError if the word for h is unknown."""
    if word is not None and (scheme.is_reference or scheme.nodes == "kept"):
        flow = scheme.is_reference
        why = "chooses its own step sizes" if flow else "has kept nodes, whose D_eps depends on h"
        raise ValueError(
            f"h = {word!r} with the scheme {scheme.name!r}, which {why}; expected a number"
        )
    if scheme.is_reference:
        return "series" if scheme.is_series or method == "taylor" else "flow"
    return word or ("kept" if scheme.nodes == "kept" else "fixed")


def require(kind: str, **given: Any) -> None:
    """Raise ValueError for a given option that has no effect on a run of this kind.

    None and an empty sequence count as not given.
    """
    there = {name: value for name, value in given.items() if not _is_nothing(value)}
    for name, value in there.items():
        if name not in KINDS[kind].options:
            takers = {key for key in KINDS if name in KINDS[key].options}
            here = _FIXED if kind in _FIXED and not _FIXED & takers else {kind}
            # Series are a method of the scheme 'reference', which takes all of their options.
            advice = f"remove it, or take {_or(_in_words(takers - {'series'}))}"
            raise ValueError(
                f"{name} = {arguments.shown(value)}: not used with {_or(_in_words(here))}; "
                f"{_INSTEAD.get(name, advice)}"
            )
        if _NEEDS.get(name, name) not in there:
            raise ValueError(
                f"{name} = {arguments.shown(value)}: not used without {_NEEDS[name]}; "
                f"remove it, or give {_NEEDS[name]}"
            )
    if "t_eval" not in there:
        return
    if "observer" in there and kind == "series":
        raise ValueError(
            "observer and t_eval are both given: expected one of the two with method = "
            "'taylor'; the methods rk8pd, msadams and rodas support both"
        )
    if "stride" in there and "observer" not in there:
        raise ValueError(
            f"stride = {arguments.shown(given['stride'])}: not used with t_eval, which sets the "
            "stored times; remove one of the two"
        )


def _in_words(kinds: set[str]) -> list[str]:
    """Return the names of kinds of runs; the two with a fixed step together have one name."""
    both = kinds >= _FIXED
    rest = kinds - _FIXED if both else kinds
    return ["a fixed step"] * both + [KINDS[kind].asked_by for kind in KINDS if kind in rest]


def _is_nothing(value: Any) -> bool:
    return value is None or (isinstance(value, (list, tuple)) and len(value) == 0)


def _or(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
