"""Optional packages: matplotlib, Jinja2, rich, SymPy, latex2mathml, tqdm, xarray."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import warnings
from collections.abc import Callable, Iterator
from typing import Any

from . import arguments


# Whether a bar is wanted, or a function of what is done and of all.
Progress = bool | Callable[[Any, Any], Any]
Show = Callable[..., Any]  # of how much is done; of how much there is, where that has grown


# Packages on PyPI whose name is not that of their module.
_PACKAGES = {"PIL": "pillow"}


def require(module: str, purpose: str) -> Any:
    """Import a module of an optional package; an ImportError has the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        name = module.partition(".")[0]
        package = _PACKAGES.get(name, name)
        raise ImportError(f"{purpose} needs {package}: pip install {package}") from error


class Later:
    """A module of this package that needs SymPy, imported on first use."""

    def __init__(self, package: str, name: str) -> None:
        self._module = f"{package}.{name}"

    def __getattr__(self, name: str) -> Any:
        require("sympy", "a system from expressions")
        return getattr(importlib.import_module(self._module), name)


def is_there(package: str) -> bool:
    """Return whether a package is installed."""
    return importlib.util.find_spec(package) is not None


def progress(
    wanted: Progress, total: float | None, unit: str, doing: str = ""
) -> contextlib.AbstractContextManager[Show]:
    """Provide a function that shows the progress, by a bar, by a user's function, or not at all.

    A bar begins with ``doing``, which is for long waits in seconds; without a total it has a number
    alone.

    Raises ValueError if ``wanted`` is neither a truth value nor callable, and ImportError if a bar
    is wanted and tqdm is not installed.
    """
    if callable(wanted):
        show = wanted
        return contextlib.nullcontext(lambda done, most=total: show(done, most))
    if not isinstance(wanted, bool):
        raise ValueError(
            f"progress = {arguments.shown(wanted)}: expected True, False or a function"
        )
    return _bar(total, unit, doing) if wanted else _SILENCE


_SILENCE = contextlib.nullcontext(lambda done, most=0.0: None)


@contextlib.contextmanager
def _bar(total: float | None, unit: str, doing: str) -> Iterator[Show]:
    with warnings.catch_warnings():  # that a notebook without ipywidgets shows a plain bar
        warnings.filterwarnings("ignore", "IProgress not found")
        tqdm = require("tqdm.auto", "progress=True").tqdm
    line = "{desc}: {n:.0f} " + unit + " |{bar}|" * (total is not None) if doing else None
    with tqdm(total=total, unit=unit, unit_scale=True, desc=doing, bar_format=line) as bar:

        def show(done: float, most: float | None = total) -> None:
            bar.total = most
            bar.update(done - bar.n)

        yield show
