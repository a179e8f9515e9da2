"""The directive ``header``: what a header of the library declares, with its comments.

``.. header:: dalembert/study.h`` shows a header, with ``:section: schemes`` only its part under
this heading, with ``:head:`` also the comment at its head.  comments.py reads the headers; neither
Doxygen nor Breathe can say that a comment is about several declarations or members.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from comments import HEADERS, INCLUDE, Entry, read
from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import nested_parse_with_titles


def known() -> dict[str, str]:
    """Return the kind of everything that has a name."""
    found: dict[str, str] = {}
    for header in HEADERS:
        for entry in read(header)[1]:
            found |= dict.fromkeys(entry.names, entry.kind)
            for member in entry.members:
                if member.kind == "enumerator":
                    found |= dict.fromkeys(member.names, member.kind)
    return found


def inline(text: str, kinds: dict[str, str]) -> str:
    """Return text in which names are links and nothing else is markup."""
    roles = {"function": "func", "enumerator": "enumerator", "macro": "macro"}

    def replace(match: re.Match[str]) -> str:
        name = match[0]
        if re.match(r"`\w", name):
            return f"`{name}`\\ "
        if not re.match(r"(dal|DAL)_", name):
            return "\\" + name
        if name not in kinds:
            return f"``{name}``" if name[-1] != "_" else name[:-1] + "\\_"
        return f":c:{roles.get(kinds[name], 'type')}:`{name}`\\ "

    return re.sub(r"\b(?:dal|DAL)_\w*|`\w+`|[\\*_|`]", replace, text)


def prose(text: str, kinds: dict[str, str]) -> list[str]:
    """Return a comment as lines: paragraphs, lists with numbers, and formulas as they are."""
    found: list[str] = []
    for paragraph in re.split(r"\n\s*\n", text):
        words: list[str] = []
        for line in paragraph.splitlines():
            deep = len(line) - len(line.lstrip())
            if numbered := re.match(r"\s+(\d+\.) (.*)", line):
                found += [*_close(words, kinds), f"{numbered[1]} {inline(numbered[2], kinds)}"]
                words = []
            elif deep >= 4 and re.match(r"\d+\.", found[-1] if found else "") and not words:
                found[-1] += " " + inline(line.strip(), kinds)
            elif deep:
                found += [*_close(words, kinds), "| ``" + line.strip() + "``"]
                words = []
            else:
                words.append(line.strip())
        found += _close(words, kinds)
    return found


def _close(words: list[str], kinds: dict[str, str]) -> list[str]:
    return ["", inline(" ".join(words), kinds), ""] if words else []


def indented(lines: Iterable[str]) -> list[str]:
    return ["   " + line for line in lines]


def rst(entries: Iterable[Entry], kinds: dict[str, str]) -> Iterator[str]:
    """Yield the lines of entries as directives of the C domain."""
    for entry in entries:
        yield ""
        if entry.kind == "prose":
            yield from prose(entry.comment, kinds)
            continue
        head = f".. c:{entry.kind}:: "
        for k, signature in enumerate(entry.signatures):
            yield signature.rjust(len(signature) + len(head)) if k else head + signature
        yield ""
        yield from indented(prose(entry.comment, kinds))
        yield from indented(rst(entry.members, kinds))


def choose(entries: list[Entry], sections: list[str]) -> list[Entry]:
    """Return the entries under some headings, without these; without headings all."""
    if not sections:
        return [entry for entry in entries if entry.kind != "heading"]
    found: list[Entry] = []
    inside, left = False, set(sections)
    for entry in entries:
        if entry.kind == "heading":
            inside = entry.comment in sections
            left.discard(entry.comment)
        elif inside:
            found.append(entry)
    if left:
        raise ValueError(f"there is no section {', '.join(sorted(left))}")
    return found


class Header(SphinxDirective):
    """See the module."""

    required_arguments = 1
    option_spec = {"section": directives.unchanged, "head": directives.flag}

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        for header in HEADERS:
            self.env.note_dependency(str(INCLUDE / header))
        self.env.note_dependency(__file__)
        head, entries = read(name)
        kinds = known()
        sections = [x.strip() for x in self.options.get("section", "").split(",") if x.strip()]
        lines = list(rst(choose(entries, sections), kinds))
        if "head" in self.options:
            lines = [*prose(head.partition(" - ")[2], kinds), *lines]
        node = nodes.Element()
        node.document = self.state.document
        nested_parse_with_titles(self.state, StringList(lines, str(INCLUDE / name)), node)
        return node.children


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("header", Header)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
