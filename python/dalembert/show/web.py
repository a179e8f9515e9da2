"""HTML by the templates of the package: self-contained, no script, no network, the same bytes."""

from __future__ import annotations

import functools
import html
import io
import re
from collections.abc import Collection
from typing import Any

from ..core import extras
from ..symbolic import formula

__all__ = ["figure", "math", "render", "require", "svg"]


def require() -> None:
    """Raise an ImportError with the line to type if what pages need is not installed."""
    for package in ("matplotlib", "jinja2"):
        extras.require(package, "a page")


def render(name: str, **values: Any) -> Any:
    """Return a template with values put in, as text that is escaped already."""
    return _mark(_templates().get_template(name).render(values))


@functools.cache
def _templates() -> Any:
    jinja2 = extras.require("jinja2", "a page")
    found = jinja2.Environment(
        loader=jinja2.PackageLoader(__package__), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    found.filters["math"] = math
    found.filters["sentence"] = lambda text: (
        text[:1].upper() + text[1:].removesuffix(".") + "." if text else ""
    )
    return found


def math(text: str, coordinates: Collection[str] = ()) -> Any:
    """Return a formula as HTML, see `dalembert.symbolic.formula`."""
    return _mark(formula.mathml(text, coordinates))


def _mark(text: str) -> Any:
    return extras.require("markupsafe", "a page").Markup(text)


def figure(width: float, height: float, layout: str | None = "constrained") -> Any:
    """Return a figure of matplotlib of this size in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout=layout)


def svg(figure: Any, name: str, label: str) -> Any:
    """Return a figure as inline SVG: ids that begin with the name, a fixed salt, no date.

    The label is what a reader hears who does not see it.
    """
    import matplotlib

    buffer = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata=nothing)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", text)
    return _mark(text.replace("<svg ", f'<svg role="img" aria-label="{html.escape(label)}" ', 1))
