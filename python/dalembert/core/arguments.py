"""Conversion of arguments, and of results of the user's functions, for C, with error messages."""

from __future__ import annotations

import difflib
import inspect
import math
import operator
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Pair = tuple[Array, Array]


def array(value: ArrayLike, name: str, *shapes: tuple[int | None, ...]) -> Array:
    """Return ``value`` as C-contiguous doubles of one of the shapes.

    ``None`` in a shape stands for any length.  For the shape (1,) a number is accepted.  Raises
    ValueError, with the name, the value and the expected shape, for anything else than real finite
    numbers of such a shape.
    """
    try:
        result = _reals(value)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name}: expected real numbers of shape {_shapes(shapes)}, got {error}"
        ) from error
    if result.ndim == 0 and (1,) in shapes:
        result = result.reshape(1)
    if result.shape not in shapes and not any(_fits(result, shape) for shape in shapes):
        raise ValueError(f"{name}: expected shape {_shapes(shapes)}, got {result.shape}")
    if np.count_nonzero(np.isfinite(result)) != result.size:
        where = tuple(int(k) for k in np.argwhere(~np.isfinite(result))[0])
        index = f"[{', '.join(map(str, where))}]" if where else ""
        raise ValueError(f"{name}{index} = {result[where]}: expected finite numbers")
    return result


def _reals(value: Any) -> Array:
    """Return an array-like value as doubles that C can read; raise TypeError or ValueError."""
    if type(value) is np.ndarray and value.dtype == np.float64:
        result = np.ascontiguousarray(value).reshape(value.shape)
        return result if result.flags.aligned else result.copy()
    rows = value if isinstance(value, (list, tuple)) else [value]
    for row in rows:
        if isinstance(row, np.ma.MaskedArray) and np.ma.is_masked(row):
            raise ValueError("masked values")
    given = np.asarray(value)
    if value is None or given.dtype.kind not in "biufO":
        raise TypeError("None" if value is None else f"values of type {given.dtype}")
    try:
        result = np.asarray(given, dtype=np.float64, order="C")
    except OverflowError:
        raise ValueError("an integer beyond the largest double, 1.8e308") from None
    except (TypeError, ValueError):
        raise ValueError(shown(value)) from None
    return result if result.flags.aligned else result.copy()


def _fits(array: Array, shape: tuple[int | None, ...]) -> bool:
    return array.ndim == len(shape) and all(
        wanted in (None, length) for wanted, length in zip(shape, array.shape)
    )


def _shapes(shapes: Iterable[tuple[int | None, ...]]) -> str:
    """Return shapes in Python notation, with N for any length."""
    found = []
    for shape in shapes:
        lengths = ", ".join("N" if k is None else str(k) for k in shape)
        found.append({0: "() (a number)", 1: f"({lengths},)"}.get(len(shape), f"({lengths})"))
    return " or ".join(found)


def number(value: Any, name: str) -> float:
    """Return ``value`` as a finite float; ValueError otherwise."""
    if type(value) is float and math.isfinite(value):
        return value
    try:
        result = _reals(value)
    except (TypeError, ValueError):
        result = None
    if result is None or result.shape != () or not np.isfinite(result):
        raise ValueError(f"{name} = {shown(value)}: expected a finite number")
    return float(result)


def tolerance(value: Any) -> float:
    """Return ``value`` as a tolerance of the reference flow; ValueError otherwise."""
    result = number(value, "tolerance")
    if not 2.0**-51 <= result <= 0.1:
        raise ValueError(
            f"tolerance = {result!r}: expected a number from 4.4e-16 (roundoff) to 0.1"
        )
    return result


def step_size(value: Any, t: float, name: str = "h") -> float:
    """Return ``value`` as a step size at time t, negative to go backwards; raise ValueError."""
    h = number(value, name)
    if h == 0.0:
        raise ValueError(f"{name} = 0: expected a number other than 0, negative to go back in time")
    if not math.isfinite(t):
        raise ValueError(f"{name} = {h!r} leads to the time t = {t!r}: expected a finite time")
    if abs(h) < sys.float_info.min:
        raise ValueError(f"{name} = {h!r}: expected at least {sys.float_info.min:.1e} in size")
    if t + h == t:
        raise ValueError(
            f"{name} = {h!r} does not change the time t = {t!r}: expected at least "
            f"{np.spacing(abs(t)):.1e} in size"
        )
    return h


def integer(
    value: Any, name: str, least: int, most: int = 2**63 - 1, kind: str = "an integer"
) -> int:
    """Return ``value`` as an integer in least .. most; ValueError otherwise."""
    try:
        result = operator.index(value)
    except TypeError:
        raise ValueError(f"{name} = {shown(value)}: expected {kind}") from None
    if not least <= result <= most:
        bound = f"at least {least}" if result < least else f"at most {most}"
        raise ValueError(f"{name} = {shown(result)}: expected {bound}")
    return result


def text(value: Any, name: str) -> str:
    """Return ``value`` if it is a string without NUL; raise ValueError otherwise."""
    if not isinstance(value, str) or "\0" in value:
        raise ValueError(f"{name} = {shown(value)}: expected a string")
    return value


def names(value: Any, name: str, expected: str) -> list[str]:
    """Return several strings as a list; ValueError otherwise.

    A string of letters only, such as "xyz", stands for its letters; "x y" and "x, y" are errors.
    """
    try:
        result = list(value)
    except TypeError:
        result = [None]
    one = isinstance(value, str) and not value.isalpha()
    if one or not all(isinstance(each, str) for each in result):
        raise ValueError(f"{name} = {shown(value)}: expected {expected}")
    return [text(each, name) for each in result]


def function(value: Any, name: str, taken: str = "") -> Any:
    """Return a value if it is None or callable; else raise ValueError, with the arguments."""
    if value is None:
        return value
    if not callable(value):
        raise ValueError(f"{name} = {shown(value)}: expected a function")
    if not taken or inspect.isbuiltin(value):
        return value
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):  # of a function that is not written in Python
        return value
    try:
        signature.bind(*taken.split(", "))
    except TypeError as error:
        raise ValueError(
            f"{name} is a function of {signature}: expected a function of ({taken})"
        ) from error
    return value


def mapping(value: Any, name: str) -> dict[Any, Any]:
    """Return a mapping as a dict, an empty one for None; ValueError for anything else."""
    if not isinstance(value, Mapping | None):
        raise ValueError(f"{name} = {shown(value)}: expected a mapping from names to values")
    return dict(value or {})


def units(value: Any, coordinates: Sequence[str]) -> dict[str, str]:
    """Return units of coordinates, of the time "t" and of the "energy"; ValueError otherwise.

    A name that denotes two of these has no unit.
    """
    found, known = mapping(value, "units"), [*coordinates, "t", "energy"]
    for key, unit in found.items():
        if known.count(key) != 1:
            what = "is also a coordinate" if key in known else "is unknown"
            expected = ", ".join(x for x in known if known.count(x) == 1)
            hint = "" if key in known else suggestion(key, known)
            raise ValueError(f"units: {shown(key)} {what}; {hint}expected some of {expected}")
        if not isinstance(unit, str) or not unit.strip() or not unit.isprintable():
            raise ValueError(
                f"units[{key!r}] = {shown(unit)}: expected the name of a unit, for example 'm'"
            )
    return found


def parameter(value: Any, name: str) -> float:
    """Return the value of a parameter, which may be a SymPy number; ValueError otherwise."""
    try:
        return number(float(value) if hasattr(value, "is_number") else value, name)
    except TypeError:
        raise ValueError(f"{name} = {value!r}: expected a real number") from None


def inputs(
    given: Any, names: Sequence[str], count: int, which: str = "a state", name: str = "inputs"
) -> Array:
    """Return inputs as rows, shape (count, k); zeros for None, ValueError if that fails.

    They are given as an array of shape (k,) or (count, k), or as a mapping that has all k names.  A
    value of the mapping is a number or an array of shape (count,).  For messages, ``name`` is the
    name of the argument, and ``which`` the owner of a row.
    """
    width = len(names)
    if given is None:
        return np.zeros((count, width))
    if width == 0:
        raise ValueError(f"{name} = {shown(given)}: the system has no inputs; remove it")
    if not isinstance(given, Mapping):
        rows = array(given, name, (width,), (count, width))
        return np.ascontiguousarray(np.broadcast_to(rows, (count, width)))
    for key in given:
        if key not in names:
            raise ValueError(
                f"{name}: {key!r} is not an input; {suggestion(key, names)}expected "
                f"{', '.join(names)}"
            )
    if missing := [key for key in names if key not in given]:
        raise ValueError(f"{name}: {missing[0]} is missing; expected {', '.join(names)}")
    columns = [array(given[key], f"{name}[{key!r}]", (), (count,)) for key in names]
    return np.column_stack([np.broadcast_to(column, (count,)) for column in columns])


def pair(first: Any, second: Any, names: tuple[str, str], otherwise: str = "") -> None:
    """Raise ValueError if one of two arguments is given without the other."""
    if (first is None) != (second is None):
        there, missing = names if second is None else names[::-1]
        raise ValueError(
            f"{there} is given without {missing}: expected both, or neither{otherwise}"
        )


def choice(value: Any, name: str, choices: dict[str, int]) -> int:
    """Return the number of an option given by name; ValueError otherwise."""
    if not isinstance(value, str) or value not in choices:
        raise ValueError(
            f"{name} = {shown(value)}: {suggestion(value, choices)}expected "
            f"{'one of ' * (len(choices) > 1)}{', '.join(map(repr, choices))}"
        )
    return choices[value]


def truth(value: Any, name: str, default: bool) -> bool:
    """Return a truth value, or the default for None; ValueError otherwise."""
    if value is None:
        return default
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{name} = {shown(value)}: expected True or False")
    return bool(value)


def suggestion(value: Any, names: Iterable[str]) -> str:
    """Return "did you mean ...? " with the name closest to ``value``, or ""."""
    plain = {name.replace("-", "_").lower(): name for name in names}
    asked = value.replace("-", "_").lower() if isinstance(value, str) else ""
    nearest = difflib.get_close_matches(asked, plain, n=1)
    return f"did you mean {plain[nearest[0]]!r}? " if nearest else ""


def shown(value: Any) -> str:
    """Return the repr of a value, truncated if it is long, for a message."""
    try:
        text = repr(value)
    except Exception:  # an integer of more digits than Python prints, or an object of the user's
        return f"a value of type {type(value).__name__}"
    return text if len(text) <= 200 else f"{text[:200]}..."


def shape(value: Any) -> Any:
    """Return the shape of a callback's result, or in words why it has none."""
    try:
        return "None" if value is None else np.shape(value)
    except ValueError:
        return "rows of different lengths"


def returned(value: Any, shape: tuple[int, ...], name: str) -> Array:
    """Return the result of the callback ``name`` as doubles of ``shape``; C checks for NaN.

    The ValueError for another type or shape has the name, the result and the expected shape.
    """
    try:
        result = _reals(value)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name} returned no real numbers ({error}): expected shape {_shapes([shape])}"
        ) from error
    if result.shape != shape:
        raise ValueError(f"{name} returned shape {result.shape}: expected {_shapes([shape])}")
    return result
