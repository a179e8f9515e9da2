"""Names of the interface in backticks become links: `dal.integrate`, `Solution.q`, `dal_step`.

A name that is not known stays as it is: prose has names of many things in backticks.  The name of
a scheme is one of these: `reference` is the scheme, `dal.reference` the function.
"""

from __future__ import annotations

import re

from docutils import nodes
import dalembert
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform

SCHEMES = {scheme.name for scheme in dalembert.schemes()}
NAME = re.compile(r"(?:dal\.|dalembert\.)?([A-Za-z_][\w.]*)(?:\(\))?")


class Names(SphinxPostTransform):
    """See the module."""

    default_priority = 5

    def run(self, **_: object) -> None:
        python = self.env.domains.python_domain.objects
        c = {name for name, *_ in self.env.domains["c"].get_objects()}
        for literal in list(self.document.findall(nodes.literal)):
            text = literal.astext()
            match = NAME.fullmatch(text)
            if not match or text in SCHEMES:
                continue
            if isinstance(literal.parent, (nodes.reference, addnodes.pending_xref)):
                continue
            if text in c:
                domain, kind, target = "c", "any", text
            elif f"dalembert.{match[1]}" in python:
                domain, kind, target = "py", "obj", f"dalembert.{match[1]}"
            else:
                continue
            link = addnodes.pending_xref(
                "", refdomain=domain, reftype=kind, reftarget=target, refexplicit=True,
                refdoc=self.env.docname, refwarn=False,
            )  # fmt: skip
            literal.replace_self(link)
            link += literal


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_post_transform(Names)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
