"""Lines of output that are longer than code may be, as messages of errors are, are wrapped."""

from __future__ import annotations

import re

from docutils import nodes
from sphinx.application import Sphinx

LONGEST = 96  # characters; tables of numbers are narrower, and are not to be wrapped
OUTPUT = ("text", "none", "default")


def mark(app: Sphinx, tree: nodes.document) -> None:
    """Give the class ``wrapped`` to the blocks that have such a line.

    Those that have columns too are of the class ``columns``: not wrapped on small screens.
    """
    for block in tree.findall(nodes.literal_block):
        output = block.get("language", "default") in OUTPUT
        if output and any(len(line) > LONGEST for line in block.astext().splitlines()):
            block["classes"].append("wrapped")
            if re.search(r"\S {3,}\S", block.astext()):
                block["classes"].append("columns")


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("doctree-read", mark)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
