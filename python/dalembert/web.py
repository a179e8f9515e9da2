"""What the HTML pages have in common: self-contained, no script, no network, the same bytes."""

from __future__ import annotations

import html
import io
import re
from typing import Any

__all__ = ["figure", "page", "svg"]

CSS = """
:root { color-scheme: light; }
body { font: 17px/1.55 Georgia, "Times New Roman", serif; color: #111; background: #fff;
       max-width: 62rem; margin: 2.5rem auto; padding: 0 1.25rem; }
h1 { font-size: 1.75rem; line-height: 1.25; margin: 0 0 .75rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .4rem; border-bottom: 1px solid #bbb; }
.eyebrow { font: 600 .8rem/1.4 system-ui, sans-serif; letter-spacing: .06em; color: #555;
           margin: 0 0 .35rem; }
figure { margin: .8rem 0 0; }
figure svg { width: 100%; height: auto; }
figcaption, .note { font-size: .92rem; color: #333; max-width: 46rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font: .82rem/1.5 system-ui, sans-serif;
        font-variant-numeric: tabular-nums; margin: .6rem 0 1.2rem; }
caption { text-align: left; font-weight: 600; padding: .3rem 0; }
th, td { text-align: right; padding: .12rem 0 .12rem 1.1rem; white-space: pre; }
th:first-child, td:first-child { padding-left: 0; }
th { border-bottom: 1px solid #777; font-weight: 600; vertical-align: bottom; }
.left { text-align: left; }
.fails { font-weight: 700; color: #a11; }
code, pre { font: .85rem/1.5 ui-monospace, "DejaVu Sans Mono", monospace; }
pre { background: #f4f4f2; padding: .7rem .9rem; white-space: pre-wrap; overflow-wrap: anywhere; }
summary { cursor: pointer; font-size: 1.2rem; font-weight: 700; margin-top: 2rem; }
@page { margin: 16mm; }
@media print {
  body { font-size: 10.5pt; margin: 0; max-width: none; padding: 0; }
  figure, table { break-inside: avoid; }
  h2 { break-after: avoid; }
  details::details-content { content-visibility: visible; height: auto; }
}
"""


def page(title: str, body: str, css: str = "") -> str:
    """Return a page with the style of all; title as text, body as HTML, css is added."""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(title)}</title>
<style>{CSS}{css}</style>
</head>
<body>
{body}
</body>
</html>
"""


def figure(width: float, height: float, layout: str | None = "constrained") -> Any:
    """Return a figure of matplotlib of this size in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout=layout)


def svg(figure: Any, name: str, label: str, caption: str = "") -> str:
    """Return a figure as inline SVG: ids that begin with the name, a fixed salt, no date.

    The label is what a reader hears who does not see it; caption as HTML.
    """
    import matplotlib

    buffer = io.StringIO()
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata=nothing)
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", text)
    text = text.replace("<svg ", f'<svg role="img" aria-label="{html.escape(label)}" ', 1)
    below = f"<figcaption>{caption}</figcaption>\n" if caption else ""
    return f"<figure>\n{text}{below}</figure>"
