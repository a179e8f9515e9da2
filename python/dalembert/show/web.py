"""HTML pages from the templates of the package.

Pages are self-contained: no network, no date, and no script except that of films.
"""

from __future__ import annotations

import contextlib
import functools
import html
import io
import re
import threading
import warnings
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from ..core import DalembertWarning, extras
from ..run import Scheme, Solution, integrate
from ..symbolic import formula
from ..system import System
from .palette import BLACK, DARK, LIGHT, LINES, PAPER, variables

HTML = Any  # markupsafe.Markup: text that is not escaped again
# Its title, prose, and what is below it: a table, a picture, a program, or a list of sections,
# which are folded; "" is left out.
Section = tuple[str, str, Any]

OF_THE_USER = (
    "This is a user-defined system: to reproduce the page, the program that defines it is needed."
)


def require() -> None:
    """Raise ImportError, with the command to type, if a package for pages is not installed."""
    for package in ("matplotlib", "jinja2"):
        extras.require(package, "a page")


def page(title: str, above: str, sections: Iterable[Section], **more: Any) -> str:
    """Return a page; ``above`` is a line of prose above its heading, by default the title."""
    return str(render("page.html", title=title, above=above, sections=sections, **more))


def render(template: str, **values: Any) -> HTML:
    """Return a template with values.

    The value ``coordinates`` has the coordinates in formulas of prose, ``links`` the addresses of
    names.  A name without an address is shown unchanged.  Style sheets use ``colours``, and their
    declarations ``light`` and ``dark``.
    """
    colours = {"light": variables(LIGHT), "dark": variables(DARK), "colours": LIGHT}
    return _mark(_templates().get_template(template).render(values | colours))


@functools.cache
def _templates() -> Any:
    jinja2 = extras.require("jinja2", "a page")
    found = jinja2.Environment(
        loader=jinja2.PackageLoader(__package__),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters.update(prose=jinja2.pass_context(_prose), sentence=sentence)
    return found


def _mark(text: str) -> HTML:
    return extras.require("markupsafe", "a page").Markup(text)


def _prose(context: Mapping[str, Any], words: str) -> HTML:
    """Return text whose parts in backticks become links or formulas."""
    links = context.get("links", {})
    parts: list[Any] = words.split("`")
    for k, part in enumerate(parts):
        if k % 2 and links.get(part):
            parts[k] = _mark('<a href="{}">{}</a>').format(links[part], part)
        elif k % 2 and part not in links:
            parts[k] = _mark(formula.mathml(part, context.get("coordinates", ())))
    return _mark("").join(parts)


def run(system: System, scheme: Scheme | str, **options: Any) -> Solution:
    """Return a run, or the states before its failure."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DalembertWarning)  # the page says the same
        return integrate(system, scheme, throw=False, **options)


def sentence(words: str) -> str:
    """Return a line of help as a sentence."""
    return f"{words[:1].upper()}{words[1:].removesuffix('.')}." if words else ""


def side_by_side(parts: Iterable[HTML]) -> HTML:
    """Return parts beside each other if there is room, otherwise below each other."""
    whole = _mark("\n").join(_mark("<div>{}</div>").format(part) for part in parts)
    return _mark('<div class="panels">\n{}\n</div>').format(whole)


def equation(mathml: str) -> HTML:
    """Return the content of a ``math`` element as a displayed equation."""
    return _mark(f'<math display="inline"><mrow>{mathml}</mrow></math>')


def paragraph(words: str, kind: str = "") -> HTML:
    """Return a paragraph; its kind is a class of the stylesheet."""
    return _mark('<p class="{}">{}</p>').format(kind, words)


# Of Matplotlib all threads share the parameters, and the code that draws.
_drawing = threading.RLock()


@contextlib.contextmanager
def default_style() -> Iterator[None]:
    """Draw in Matplotlib's default style, regardless of the user's; one thread at a time."""
    with _drawing, extras.require("matplotlib.style", "a picture").context("default"):
        yield


def figure(width: float, height: float, layout: str | None = "constrained") -> Any:
    """Return a figure of matplotlib of this size in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout=layout)


def svg(figure: Any, name: str, label: str, caption: str = "") -> HTML:
    """Return a figure as inline SVG: ids that begin with the name, a fixed salt, no date.

    Screen readers read the label.  Black becomes the colour of the text, and white the colour of
    the page, which may be dark; the colours of lines are then lighter.
    """
    import matplotlib

    buffer = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata=nothing, transparent=True)
    _, tag, text = buffer.getvalue().partition("<svg ")
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", text)
    text = text.replace(f": {BLACK}", ": currentColor")
    for name, colour in {"paper": PAPER, **LINES}.items():
        text = text.replace(f": {colour}", f": var(--{name}, {colour})")
    text = f'{tag}role="img" fill="currentColor" aria-label="{html.escape(label)}" {text}'
    frame = _mark("<figure>\n{}<figcaption>{}</figcaption></figure>")
    return frame.format(_mark(text), caption)


def notebook(sections: Iterable[Section], **more: Any) -> str | None:
    """Return sections for a notebook, in its colours; None if Jinja2 is not installed."""
    if not extras.is_there("jinja2"):
        return None
    return str(render("notebook.html", sections=sections, **more))
