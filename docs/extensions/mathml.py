"""Formulas as MathML, which browsers show without a script, and STIX Two Math to set them in.

The font comes with the package ziamath.  What formulas need of it is in the style sheet itself:
some browsers load no font from another file for pages that are not from a server.
"""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path

import ziamath
from docutils import nodes
from fontTools import subset
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.writers.html5 import HTML5Translator

logger = logging.getLogger(__name__)

FONT = Path(ziamath.__file__).parent / "fonts" / "STIXTwoMath-Regular.ttf"
# Letters, Greek, accents, arrows, operators, brackets; and of the letters for mathematics those
# that are bold, italic, script and double-struck.
CHARACTERS = [
    (0x20, 0x7E), (0xA0, 0xFF), (0x2B0, 0x36F), (0x370, 0x3FF), (0x2010, 0x2044), (0x2057, 0x206F),
    (0x2100, 0x214F), (0x2190, 0x21FF), (0x2200, 0x22FF), (0x2308, 0x230B), (0x27E8, 0x27E9),
    (0x1D400, 0x1D467), (0x1D49C, 0x1D4CF), (0x1D538, 0x1D56B), (0x1D6A8, 0x1D71B),
]  # fmt: skip
# Bars without space; primes, which fonts have raised and small already; a minus after another
# operator or a bracket, which is a sign; and a space after a function without brackets.
PRIME = "&#x02032;"
IMPROVED = [
    (r"<mo([^>]*)>(?:\||&#x0007C;)</mo>", r'<mo\1 lspace="0" rspace="0">|</mo>'),
    (
        rf"<msup>(<m[ion][^>]*>[^<]*</m[ion]>|<mover>(?:(?!</mover>).)*</mover>)"
        rf"<mi>{PRIME}</mi></msup>",
        rf'<mrow>\1<mo lspace="0" rspace="0">{PRIME}</mo></mrow>',
    ),
    (
        r"(?<=&#x000(?:3D|28|5B|2C);</mo>)<mo>&#x02212;</mo>",
        '<mo form="prefix">&#x02212;</mo>',
    ),
    (
        r"(?<!<msup>)(?<!<msub>)(<mi>(?:sin|cos|tan|log|exp)</mi>)(?=<m(?!o))",
        r'\1<mspace width="0.167em" />',
    ),
]


def style_sheet() -> str:
    """Return the rule that defines the font ``Site Math``."""
    options = subset.Options(flavor="woff2", layout_features=["ssty", "dtls", "flac"])
    font = subset.load_font(str(FONT), options)
    part = subset.Subsetter(options)
    part.populate(unicodes=[x for first, last in CHARACTERS for x in range(first, last + 1)])
    part.subset(font)
    buffer = io.BytesIO()
    subset.save_font(font, buffer, options)
    text = base64.b64encode(buffer.getvalue()).decode()
    return (
        '@font-face { font-family: "Site Math"; src: url(data:font/woff2;base64,'
        f'{text}) format("woff2"); }}\nmath {{ font-family: "Site Math", math, serif; }}\n'
    )


def mathml(node: nodes.Element, display: str) -> str:
    """Return the formula of a node; one that cannot be read is a warning, and stands as it is."""
    formula = node.astext().replace("{aligned}", "{align*}")
    try:
        found = convert(formula, display=display)
        if left := re.search(r"\\\w*|&amp;", re.sub("<[^>]*>", "", found)):
            raise ValueError(f"{left[0]} is not known")
    except Exception as error:
        logger.warning("formula %r: %r", formula, error, location=node)
        return f"<code>{formula}</code>"
    for pattern, text in IMPROVED:
        found = re.sub(pattern, text, found)
    return found


def inline(translator: HTML5Translator, node: nodes.math) -> None:
    translator.body.append(mathml(node, "inline"))
    raise nodes.SkipNode


def block(translator: HTML5Translator, node: nodes.math_block) -> None:
    number = f'<span class="eqno">({node["number"]})</span>' if node["number"] else ""
    names = "".join(f'<span id="{name}"></span>' for name in node["ids"])
    translator.body.append(f'<div class="formula">{names}{number}{mathml(node, "block")}</div>\n')
    raise nodes.SkipNode


def add_font(app: Sphinx) -> None:
    folder = Path(app.doctreedir) / "math"
    sheet = folder / "math.css"
    if not sheet.exists() or sheet.stat().st_mtime < Path(__file__).stat().st_mtime:
        folder.mkdir(parents=True, exist_ok=True)
        sheet.write_text(style_sheet(), encoding="utf-8")
    app.config.html_static_path.append(str(folder))
    app.add_css_file("math.css")


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    app.connect("builder-inited", add_font)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
