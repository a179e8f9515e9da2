"""The directive ``header``: what a header of the library declares, with its comments.

``.. header:: dalembert/study.h`` shows a header, with ``:section: schemes runs`` only its parts
under these headings.  A comment belongs to the declarations below it up to a blank line, or to the
member that it stands behind; one that is followed by a blank line stands by itself.  Neither
Doxygen nor Breathe can say that a comment is about several declarations.

``complaints`` tells which functions, structs and enums have no comment (tests/check_headers.py).
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import nested_parse_with_titles

INCLUDE = Path(__file__).resolve().parents[2] / "include"
HEADERS = tuple(
    f"dalembert{name}.h"
    for name in (
        "", "/deformation", "/geometry", "/discrete", "/family", "/events", "/journal",
        "/ensemble", "/study",
    )
)  # fmt: skip
COMMENT = re.compile(r"/\*(.*?)\*/", flags=re.S)
HEADING = re.compile(r"-{3,} (.+?) -{3,}")


@dataclass
class Entry:
    """Declarations with one comment: of functions, of a type, or of members of one."""

    kind: str  # function, struct, enum, type, macro, member, enumerator; or heading, prose
    names: list[str] = field(default_factory=list)
    signatures: list[str] = field(default_factory=list)
    comment: str = ""
    members: list[Entry] = field(default_factory=list)


# ---- from C to entries -------------------------------------------------------------------------


def plain(comment: str) -> str:
    """Return the text of a comment without the stars in front of its lines."""
    first, *rest = comment.strip().splitlines() or [""]
    rest = [re.sub(r"^\s*\* ?", "", line) if "*" in line[:4] else line for line in rest]
    if all(line.startswith(" " * 12) for line in rest if line.strip()):  # behind a member
        rest = textwrap.dedent("\n".join(rest)).splitlines()
    return "\n".join([first, *rest])


def pieces(text: str) -> Iterator[tuple[str, str, bool]]:
    """Yield (kind, text, whether a blank line follows) of comments and declarations.

    The kind is ``above`` or ``behind`` for comments, ``code`` for declarations.
    """
    at = 0
    while match := re.compile(r"\s*(?:(/\*.*?\*/)|(#define .*)|([^;{]*))", re.S).match(text, at):
        comment, macro, _ = match.groups()
        start, end = match.end() - len(match[0].lstrip()), match.end()
        if start == end:
            return
        if macro:
            macro, end = macro.splitlines()[0], start + len(macro.splitlines()[0])
        elif not comment:  # up to the semicolon outside of braces
            depth, end = 0, start
            while text[end] != ";" or depth:
                inner = COMMENT.match(text, end)
                depth += (text[end] == "{") - (text[end] == "}")
                end = inner.end() if inner else end + 1
            end += 1
        before = text[text.rfind("\n", 0, start) + 1 : start]
        kind = "code" if not comment else "behind" if before.strip() else "above"
        blank = re.match(r"[ \t]*\n\s*\n|\s*$", text[end:]) is not None
        yield kind, text[start:end], blank
        at = end


def enumerators(body: str) -> Iterator[Entry]:
    """Yield the enumerators of a body, those of a line with the comment behind them."""
    for match in re.finditer(r"([^\n/]*\bDAL_[^\n/]*)(?:/\*(.*?)\*/)?", body, flags=re.S):
        signatures = [one.strip() for one in match[1].split(",") if one.strip()]
        names = [one.split()[0] for one in signatures]
        yield Entry("enumerator", names, signatures, plain(match[2] or ""))


def members(body: str) -> Iterator[Entry]:
    """Yield the members of a struct, and comments that stand by themselves."""
    waiting: Entry | None = None
    above = ""
    for kind, text, _ in pieces(body):
        if kind == "behind" and waiting:
            if above:
                yield Entry("prose", comment=above)
            waiting.comment, above = plain(text[2:-2]), ""
            continue
        if waiting:
            waiting.comment, above = waiting.comment or above, ""
            yield waiting
            waiting = None
        if kind == "above":
            above = plain(text[2:-2])
            continue
        code = " ".join(text.rstrip(";").split())
        if "(" in code:
            waiting = Entry("member", [re.search(r"\(\*(\w+)\)", code)[1]], [code])
            continue
        base, rest = re.match(r"((?:const |struct |unsigned )*\w+ (?:const )?)(.*)", code).groups()
        if code.startswith("unsigned "):
            base, rest = "unsigned ", code.removeprefix("unsigned ")
        signatures = [base + one.strip() for one in rest.split(",")]
        names = [re.search(r"(\w+)(?:\[\w+\])?$", one)[1] for one in signatures]
        waiting = Entry("member", names, signatures)
    if waiting:
        waiting.comment = waiting.comment or above
        yield waiting


def declaration(code: str) -> Entry:
    """Return the entry of one declaration."""
    flat = " ".join(COMMENT.sub("", code).rstrip(";").split())
    if found := re.match(r"typedef (struct|enum) \w+ \{(.*)\} (\w+);", code, flags=re.S):
        kind, body, name = found.groups()
        inner = list((members if kind == "struct" else enumerators)(body))
        return Entry(kind, [name], [name], members=inner)
    if found := re.fullmatch(r"typedef struct (\w+) \1", flat):
        return Entry("struct", [found[1]], [found[1]])
    if found := re.fullmatch(r"typedef (.*\(\*(\w+)\).*)", flat):
        return Entry("type", [found[2]], [found[1]])
    if found := re.match(r"#define (\w+)", flat):
        return Entry("macro", [found[1]], [found[1]])
    flat = flat.removeprefix("DAL_API ")
    return Entry("function", [re.search(r"(\w+)\(", flat)[1]], [flat])


def read(header: str) -> tuple[str, list[Entry]]:
    """Return the comment at the head of a header, and its entries."""
    text = (INCLUDE / header).read_text(encoding="utf-8")
    head = plain(COMMENT.match(text)[1])
    if "/* <cdef> */" in text:
        text = text.partition("/* <cdef> */")[2].partition("/* </cdef> */")[0]
    else:
        text = re.sub(r"#endif[^\n]*\n?$", "", text.partition("#include <dalembert")[2])
        text = text.partition("\n")[2]
    found: list[Entry] = []
    open_group = forward = False
    comment = ""
    for kind, code, blank in pieces(text):
        if re.match(r"struct \w+;", code):  # which another header defines
            open_group = forward = True
            continue
        forward, behind_forward = False, forward
        if behind_forward and kind == "behind":
            continue
        if kind == "above":
            words = plain(code[2:-2])
            if heading := HEADING.fullmatch(words):
                found.append(Entry("heading", comment=heading[1]))
            elif blank or re.match(r"\s*/\*", text[text.find(code) + len(code) :]):
                found.append(Entry("prose", comment=words))
            else:
                comment = words
            open_group = False
            continue
        if kind == "behind":
            words = plain(code[2:-2])
            alone = len(found[-1].names) == 1 and not found[-1].comment
            more = words if alone else f"{found[-1].names[-1]}: {words}"
            found[-1].comment = "\n\n".join(filter(None, [found[-1].comment, more]))
        else:
            entry = declaration(code)
            if open_group and entry.kind == found[-1].kind == "function":
                found[-1].names += entry.names
                found[-1].signatures += entry.signatures
            else:
                entry.comment, comment = comment, ""
                found.append(entry)
        open_group = not blank
    return head, found


# ---- from entries to reStructuredText ----------------------------------------------------------


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
        if not re.match(r"(dal|DAL)_", name):
            return "\\" + name
        if name not in kinds:
            return f"``{name}``" if name[-1] != "_" else name[:-1] + "\\_"
        return f":c:{roles.get(kinds[name], 'type')}:`{name}`\\ "

    return re.sub(r"\b(?:dal|DAL)_\w*|[\\*_|`]", replace, text)


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


def complaints() -> list[str]:
    """What has no comment, one line each."""
    found = []
    for header in HEADERS:
        for entry in read(header)[1]:
            if entry.kind not in ("heading", "prose") and not entry.comment:
                opaque = entry.kind == "struct" and not entry.members
                if not opaque and not any(member.comment for member in entry.members):
                    found.append(f"{header}: {', '.join(entry.names)} has no comment")
    return found


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_directive("header", Header)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
