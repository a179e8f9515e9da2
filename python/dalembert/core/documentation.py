"""Sections that many docstrings share are written once and inserted by a decorator."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])


class Shared:
    """Parameters and exceptions that the docstrings of several functions share.

    The docstring of a subclass has the shared entries, besides those of its base.  Its object is a
    decorator, which completes the docstring of a function.  The section Parameters gets an entry
    for each parameter, its own or the shared one.  A shared entry marked ``optional`` is for
    parameters with a default, any other entry for those without.  The section Raises begins with
    the exceptions of the object.

    Parameters
    ----------
    raised : str, optional
        Names of exceptions, separated by commas.
    returns : str, optional
        The section Returns.
    """

    _shared: dict[tuple[str, bool], str] = {}
    _reasons: dict[str, str] = {}

    def __init_subclass__(cls) -> None:
        _, sections = _sections(cls.__doc__ or "")
        cls._shared = cls._shared | {
            (name, ", optional" in rest.partition("\n")[0]): rest
            for names, rest in _entries(sections.get("Parameters", ""))
            for name in names.split(", ")
        }
        cls._reasons = cls._reasons | dict(_entries(sections.get("Raises", "")))

    def __init__(self, raised: str = "", returns: str = "") -> None:
        self._raised, self._returns = raised.split(", ") if raised else [], returns

    def __call__(self, function: Function) -> Function:
        """Complete the docstring of a function, and return the function."""
        if not function.__doc__:  # under python -OO
            return function
        head, own = _sections(function.__doc__)
        raises = [name + self._reasons[name] for name in self._raised]
        sections = {
            "Parameters": self._parameters(function, own.pop("Parameters", "")),
            "Returns": own.pop("Returns", self._returns),
            "Raises": "\n".join([*raises, own.pop("Raises", "")]),
        } | own
        function.__doc__ = "\n\n".join(
            [head]
            + [f"{k}\n{'-' * len(k)}\n{body.strip()}" for k, body in sections.items() if body]
        )
        return function

    def _parameters(self, function: Callable[..., Any], own: str) -> str:
        """Return the entries of all parameters; neighbours with the same text are one entry."""
        its = {x.strip("*"): entry for entry in _entries(own) for x in entry[0].split(", ")}
        found: list[tuple[str, str]] = []
        for name, parameter in inspect.signature(function).parameters.items():
            rest = self._shared.get((name, parameter.default is not parameter.empty), "")
            if name in its:
                found += [its[name]] * (its[name] not in found)
            elif rest and found and found[-1][1] == rest:
                found[-1] = (f"{found[-1][0]}, {name}", rest)
            elif rest:
                found.append((name, rest))
        return "\n".join(names + rest for names, rest in found)


def _sections(docstring: str) -> tuple[str, dict[str, str]]:
    """Return the beginning of a docstring, and its sections by their titles."""
    head, *rest = re.split(r"^(\w+)\n---+\n", inspect.cleandoc(docstring), flags=re.MULTILINE)
    return head.strip(), dict(zip(rest[::2], rest[1::2]))


def _entries(section: str) -> list[tuple[str, str]]:
    """Return the names of each entry of a section, and the rest of the entry."""
    entry = r"^(\S.*?)((?: : .*)?(?:\n(?=[ \n]).*)*)$"
    return re.findall(entry, section.strip(), re.MULTILINE)


class Common(Shared):
    """Parameters and exceptions of functions in several modules.

    Parameters
    ----------
    system : System
    run : Solution
    q0, v0 : array_like, shape (n,), optional
        Initial data in D, in the user's units; pass both or neither.  Default: the system's initial
        data.
    progress : bool or callable, optional
        True: show a tqdm bar.  A function is called as ``progress(done, total)``, with numbers of
        steps, frames or pages.
    ax : matplotlib axes, optional
        Default: new axes.

    Raises
    ------
    ValueError
        If an argument is out of range.  The message names it.
    ImportError
        If an optional package is not installed.  The message has the command that installs it.
    OSError
        If the file cannot be written; the message has its name.
    """
