"""Records of options: each argument of a function, written down once.

A record is a frozen dataclass.  A field has the meaning of the option and the check of its value.
A function takes its signature and the section Parameters of its docstring from a record.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import textwrap
import warnings
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass
from typing import Any, ClassVar, Concatenate, ParamSpec, Self, TypeVar

from . import arguments
from .documentation import Shared

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True)
class Option:
    """An option."""

    type: str  # for documentation
    help: str  # the meaning; without it, type and meaning are those of the next option
    default: Any
    uses: tuple[str, ...] | None  # the kinds of run to which it applies; None: all
    instead: str  # advice where it does not apply
    needs: str  # an option without which it has no effect
    read: Callable[[Any, str], Any] | None  # (value, name) -> the value as the run uses it
    choices: Mapping[str, int]  # the words that are allowed, with their numbers in C
    c: str  # the member of ``dal_options``
    parse: Any  # reads the value on a command line, which has no such option if None
    metavar: str

    def take(self, value: Any, name: str) -> Any:
        """Return a given value as the run uses it; raise ValueError if it is out of range."""
        if self.choices:
            arguments.choice(value, name, dict(self.choices))
        return self.read(value, name) if self.read else value


def meaning(
    type: str, help: str = "", *, default: Any = MISSING, uses: str = "", instead: str = "",
    needs: str = "", read: Any = None, choices: Mapping[str, int] = {}, c: str = "",
    parse: Any = None, metavar: str = "",
) -> dict[str, Option]:  # fmt: skip
    """Return the metadata of the field of an option, which is required unless it has a default."""
    kinds, parse = tuple(uses.split()) or None, str if choices and parse is None else parse
    return {"option": Option(
        type, inspect.cleandoc(help), default, kinds, instead, needs, read, choices, c, parse,
        metavar,
    )}  # fmt: skip


def option(type: str, help: str = "", *, default: Any = None, **more: Any) -> Any:
    """Return the field of an option that may be left out."""
    return dataclasses.field(default=default, metadata=meaning(type, help, default=default, **more))


def extended(record: Any, name: str, more: str = "", **changes: Any) -> dict[str, Option]:
    """Return the metadata of an option of a record, with more to say about it."""
    told = options_of(record)[name]
    help = "\n\n".join(filter(None, (told.help, inspect.cleandoc(more))))
    return {"option": dataclasses.replace(told, **{"help": help, **changes})}


def _options_of(record: Any) -> dict[str, Option]:
    """Return the options of a record by name, in the order of its signature."""
    fields = sorted(dataclasses.fields(record), key=lambda field: bool(field.kw_only))
    return {field.name: field.metadata["option"] for field in fields}


options_of: Callable[[Any], dict[str, Option]] = functools.cache(_options_of)


def takes(record: Callable[P, Any]) -> Callable[[Callable[..., R]], Callable[P, R]]:
    """Give a function the signature of a record, and its docstring the text of the options."""
    return lambda function: _signed(function, record, [])


def method(
    record: Callable[P, Any],
) -> Callable[[Callable[..., R]], Callable[Concatenate[Any, P], R]]:
    """Give a method the signature of a record, as `takes` does for a function."""
    first = inspect.Parameter("self", inspect.Parameter.POSITIONAL_ONLY)
    return lambda function: _signed(function, record, [first])


def _signed(function: Any, record: Any, first: list[inspect.Parameter]) -> Any:
    parameters = [*first, *inspect.signature(record).parameters.values()]
    returns = function.__annotations__["return"]
    function.__signature__ = inspect.Signature(parameters, return_annotation=returns)
    return documents(record)(function)


def documents(record: Any) -> Shared:
    """Return the decorator that writes the options of a record into a docstring."""
    lines = ["The options.\n\nParameters\n----------"]
    names: list[str] = []
    for name, one in options_of(record).items():
        names.append(name)
        if one.help:
            optional = ", optional" * (one.default is not MISSING)
            lines += [f"{', '.join(names)} : {one.type}{optional}"]
            lines += [textwrap.indent(one.help, "    ")]
            names.clear()
    made: Shared = type("Options", (Shared,), {"__doc__": "\n".join(lines)})()
    return made


class Record:
    """The common part of all records."""

    renamed: ClassVar[Mapping[str, str]] = {}  # names of options by former names, which warn

    @classmethod
    def of(cls, name: str, args: tuple[Any, ...], given: dict[str, Any]) -> Self:
        """Return the record of the arguments of a call of the function ``name``."""
        for old in sorted(given.keys() & cls.renamed.keys()):
            new = cls.renamed[old]
            warnings.warn(
                f"{name}({old}=...) is deprecated: write {new}=", DeprecationWarning, stacklevel=3
            )
            if new not in given:
                given[new] = given.pop(old)
        try:
            return cls(*args, **given)
        except TypeError:
            unknown = sorted(given.keys() - options_of(cls).keys())
            hint = arguments.suggestion(unknown[0], options_of(cls)) if unknown else ""
            try:
                inspect.signature(cls).bind(*args, **given)
            except TypeError as error:
                raise TypeError(f"{name}(): {error}; {hint}".rstrip("; ")) from None
            raise

    def having(self, **values: Any) -> Self:
        """Return the record with other values."""
        made = object.__new__(type(self))
        vars(made).update(vars(self), **values)
        return made

    @property
    def numbers(self) -> dict[str, Any]:
        """The given options that are numbers or words, by name: data for JSON."""
        listed = options_of(type(self))
        return {
            name: x for name, x in vars(self).items()
            if isinstance(x, (bool, int, float, str)) and x != listed[name].default
        }  # fmt: skip
