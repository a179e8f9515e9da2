"""The symbols of models: coordinates, their velocities, and the time.

All formulas of a model use canonical symbols, ``q0 ... v0 ... p0 ... u0 ... t``.  The user's names
are never part of a generated program, and models that differ in names alone are compiled once.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import sympy

Expr = Any  # sympy has no types
Rule = dict[Expr, Expr]


class _Called(sympy.Symbol):
    """A symbol with the names of the call of `dalembert.coordinates` that created it.

    The names are part of the symbol.  So the order of coordinates follows from the expressions of a
    system, independent of other calls.
    """

    __slots__ = ("call",)

    def __new__(cls, name: str, call: tuple[str, ...] = ()) -> Any:
        made = sympy.Symbol.__xnew__(cls, name, real=True)
        made.call = call or (name,)
        return made

    def __getnewargs_ex__(self) -> tuple[Any, ...]:
        return (self.name, self.call), {}

    def _hashable_content(self) -> tuple[Any, ...]:
        return (*super()._hashable_content(), self.call)


class Velocity(_Called):
    """The velocity ``x.d`` of a coordinate."""

    __slots__ = ()

    @property
    def coordinate(self) -> Coordinate:
        """The coordinate of this velocity."""
        return Coordinate(self.name.removesuffix(".d"), self.call)

    def _latex(self, printer: Any) -> str:
        return rf"\dot{{{printer._print(sympy.Symbol(self.coordinate.name))}}}"


class Coordinate(_Called):
    """A coordinate: a SymPy symbol with its velocity `d`, from `dalembert.coordinates`."""

    __slots__ = ()

    @property
    def d(self) -> Velocity:
        """The velocity of the coordinate, a symbol too."""
        return Velocity(f"{self.name}.d", self.call)

    def diff(self, *symbols: Any, **assumptions: Any) -> Expr:
        """Return a derivative; raise ValueError for the time derivative, for SymPy it is 0."""
        if any(str(s) == "t" and not isinstance(s, Coordinate) for s in symbols):
            raise ValueError(f"{self.name}.diff(t): write {self.name}.d for the velocity")
        return super().diff(*symbols, **assumptions)


# When a call of `dalembert.coordinates` with these names was made first, and when last.
_made: dict[tuple[str, ...], tuple[int, int]] = {}
_numbers = itertools.count()


def make_coordinates(names: Sequence[str]) -> tuple[Coordinate, ...]:
    """Return a coordinate for each name."""
    call, now = tuple(names), next(_numbers)
    _made[call] = _made.get(call, (now, now))[0], now
    return tuple(Coordinate(name, call) for name in names)


def in_order(found: Iterable[Coordinate]) -> list[Coordinate]:
    """Return coordinates in the order of their names in calls, and of the calls.

    Raises
    ------
    ValueError
        If the calls contradict each other, or the order of their first and last execution differs.
    """
    by_name = {x.name: x for x in found}
    calls = {x.call for x in found}
    whole = [call for call in calls if by_name.keys() <= {*call}]
    several = sorted(whole or calls, key=lambda call: _made.get(call, (-1, -1))[0])
    order = list(dict.fromkeys(name for call in several for name in call if name in by_name))
    last = [_made.get(call, (-1, -1))[1] for call in several]
    if (not whole and (last != sorted(last) or -1 in last)) or any(
        [name for name in order if name in call] != [name for name in call if name in by_name]
        for call in calls
    ):
        shown = " and ".join(f"dalembert.coordinates({' '.join(c)!r})" for c in sorted(calls))
        raise ValueError(
            f"coordinates is missing: the order of {', '.join(sorted(order))} is ambiguous, "
            f"because their symbols are of {shown}"
        )
    return [by_name[name] for name in order]


class Canonical(sympy.Symbol):
    """A symbol of the formulas of models, which no symbol of a user is equal to."""

    __slots__ = ()

    def __new__(cls, name: str) -> Any:
        return sympy.Symbol.__xnew__(cls, name, real=True)

    def __getnewargs_ex__(self) -> tuple[Any, ...]:
        return (self.name,), {}


@functools.cache
def canonical(letter: str, count: int) -> tuple[Expr, ...]:
    """Return the symbols letter0, letter1, ..."""
    return tuple(Canonical(f"{letter}{i}") for i in range(count))


TIME = sympy.Symbol("t", real=True)


class Time(sympy.Symbol):
    """The time in user's expressions, `dalembert.time`; no other symbol is equal to it."""

    __slots__ = ()

    def __new__(cls) -> Any:
        return sympy.Symbol.__xnew__(cls, TIME.name, real=True)

    def __getnewargs_ex__(self) -> tuple[Any, ...]:
        return (), {}
