"""Digests of Python functions: their code, and the values that they refer to."""

from __future__ import annotations

import functools
import hashlib
import pickle
import types
from typing import Any

import numpy as np


def digest(function: Any) -> str:
    """Return a digest of a function, "" for None.

    The digest covers the code of the function and of the functions that it refers to.  It also
    covers numbers, texts and arrays among its globals, closure and defaults.

    Examples
    --------
    >>> from dalembert.ensembles.functions import digest
    >>> digest(lambda x: x + 1) == digest(lambda x: x + 2)
    False
    """
    if function is None:
        return ""
    return hashlib.sha256(_text(function, set()).encode("utf-8", "backslashreplace")).hexdigest()


def _text(value: Any, seen: set[int]) -> str:
    """Return a text for a value that is the same in another process, as far as possible."""
    if id(value) in seen:
        return "again"
    if isinstance(value, types.FunctionType):
        seen.add(id(value))
        return _function(value, seen)
    if isinstance(value, types.MethodType):
        return f"method {_text(value.__func__, seen)} of {_text(value.__self__, seen)}"
    if isinstance(value, functools.partial):
        parts = (value.func, value.args, sorted(value.keywords.items()))
        return f"partial {[_text(part, seen) for part in parts]}"
    if isinstance(value, types.CodeType):
        consts = [_text(x, seen) for x in value.co_consts]
        return f"code {value.co_code.hex()} {value.co_names} {value.co_varnames} {consts}"
    if isinstance(value, np.ndarray) and value.dtype != object:
        return f"array {value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, tuple | list):
        return f"{type(value).__name__} {[_text(x, seen) for x in value]}"
    if isinstance(value, dict):
        return f"dict {[(_text(k, seen), _text(x, seen)) for k, x in value.items()]}"
    if isinstance(value, frozenset | set):
        return f"set {sorted(_text(x, seen) for x in value)}"
    if isinstance(value, int | float | complex | str | bytes | None):
        return repr(value)
    if isinstance(value, types.ModuleType | type | types.BuiltinFunctionType):
        return getattr(value, "__qualname__", value.__name__)
    seen.add(id(value))
    try:  # an object that can be called
        state = _text(getattr(value, "__dict__", {}), seen)
        return f"{_text(type(value).__call__, seen)} {state or pickle.dumps(value).hex()}"
    except Exception:
        return f"{type(value).__module__}.{type(value).__qualname__}"


def _function(function: types.FunctionType, seen: set[int]) -> str:
    code = function.__code__
    names, left = set[str](), [code]
    while left:  # of functions inside it too
        one = left.pop()
        names |= {*one.co_names}
        left += [x for x in one.co_consts if isinstance(x, types.CodeType)]
    found = {name: function.__globals__[name] for name in names if name in function.__globals__}
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    given = [function.__defaults__, function.__kwdefaults__, cells, dict(sorted(found.items()))]
    parts = [code, *given]
    return f"function {[_text(part, seen) for part in parts]}"
