"""What the headers of the library declare, with the comments: see the directive in headers.py.

A comment belongs to the declarations below it up to a blank line, or to the member that it stands
behind; one that is followed by a blank line stands by itself.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

INCLUDE = Path(__file__).resolve().parents[2] / "include"
HEADERS = tuple(
    f"dalembert{name}.h"
    for name in (
        "", "/inspect", "/stepper", "/run", "/deformation", "/geometry", "/discrete", "/family",
        "/events", "/journal", "/ensemble", "/study", "/taylor",
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


def plain(comment: str) -> str:
    """Return the text of a comment without the stars in front of its lines."""
    first, *rest = comment.strip().splitlines() or [""]
    starred = any(re.match(r"\s*\*( |$)", line) for line in rest)
    rest = [re.sub(r"^\s*\*( |$)", "", line) for line in rest]
    if not starred and all(line.startswith("   ") for line in rest if line.strip()):
        rest = textwrap.dedent("\n".join(rest)).splitlines()
    return "\n".join([first, *rest])


def pieces(text: str) -> Iterator[tuple[str, str, bool]]:
    """Yield (kind, text, whether it ends a group) of comments and declarations.

    The kind is ``above`` or ``behind`` for comments, ``code`` for declarations.  A group ends with
    a blank line, and with a comment that another one follows.
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
        after = r"[ \t]*\n\s*\n|\s*$" if kind == "code" else r"[ \t]*\n\s*\n|\s*$|\s*/\*"
        blank = re.match(after, text[end:]) is not None
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
        base, rest = re.match(r"((?:const |struct )*\w+ )(.*)", code).groups()
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
    text = re.sub(r"^struct \w+;.*\n", "", text, flags=re.M)  # which other headers define
    found: list[Entry] = []
    open_group, comment = False, ""
    for kind, code, blank in pieces(text):
        if kind == "above":
            words = plain(code[2:-2])
            if heading := HEADING.fullmatch(words):
                found.append(Entry("heading", comment=heading[1]))
            elif blank:
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


def complaints() -> list[str]:
    """Return what has no comment, one line each."""
    found = []
    for header in HEADERS:
        for entry in read(header)[1]:
            if entry.kind not in ("heading", "prose") and not entry.comment:
                opaque = entry.kind == "struct" and not entry.members
                if not opaque and not any(member.comment for member in entry.members):
                    found.append(f"{header}: {', '.join(entry.names)} has no comment")
    return found
