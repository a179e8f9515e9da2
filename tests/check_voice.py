"""Sentences are those of a textbook, by the rule of CONTRIBUTING.md, as far as a pattern can tell.

Usage: ``python check_voice.py [--list [PATH...] | --shrink]``

It reads the prose of README.md, CONTRIBUTING.md, docs/, examples and notebooks, the docstrings of
the package, the comments of the public headers, all texts in the code (messages, reports) and the
help of the commands.  It compares the number of findings with voice.toml, which may only shrink.  A
file with more findings fails, and so does one with fewer until ``--shrink`` has lowered its number.
``--list`` prints the findings of all files, or of those whose path begins with PATH.

The rules are in ``RULES``, each with a sentence that breaks it and one that does not.  The end of a
sentence is a point, a question mark or a semicolon; a formula or a piece of code is one word.
"""

from __future__ import annotations

import ast
import json
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
EXCEPTIONS = ROOT / "tests" / "voice.toml"
MOST_WORDS = 25
FEWEST_WORDS = 4  # fewer in a literal are a name, fewer in prose a heading
OPENINGS = r"[Oo]f|[Ww]hat(?:ever)?(?! =)|[Ww]ho(?:ever|m|se)?|Where(?:ver)?"
HOMELY = (
    r"go(?:es|ing|ne)? on|went on|mend(?:s|ed|ing)?|seal(?:s|ed|ing)?|hire[sd]?|whoever|meanwhile|"
    r"anew|as ever|hand(?:s|ed|ing)? (?:on|over)|look(?:s|ed|ing)? at"
)


class Rule(NamedTuple):
    """A rule: its name, whether a sentence breaks it, one that does, and one that does not."""

    name: str
    broken: Callable[[str], object]
    bad: str
    good: str


def words(sentence: str) -> int:
    """Count the words of a sentence; a sign alone is none."""
    return sum(any(letter.isalnum() for letter in word) for word in sentence.split())


RULES = [
    Rule(
        "opens with Of, What, Who or Where",
        lambda s: (
            words(s) >= FEWEST_WORDS
            and not s.endswith("?")
            and re.match(rf"\W*(?:{OPENINGS})\b", s)
        ),
        "Of two processes that begin, one has it.",
        "Where do I put a new scheme?",
    ),
    Rule(
        '"what" in place of a noun',
        lambda s: re.search(r"\bwhat(?:ever)?\b(?! to\b| =|.*\?)", s, re.IGNORECASE),
        "Return what the step has changed.",
        "The page of What is D? says what to type instead.",
    ),
    Rule(
        f"more than {MOST_WORDS} words",
        lambda s: words(s) > MOST_WORDS,
        "The step " + "is long and " * 8,
        "The step " + "is long and " * 7 + "ends - here.",
    ),
    Rule(
        '"that of" twice',
        lambda s: len(re.findall(r"\b(?:that|those) of\b", s)) > 1,
        "The error is that of the run and that of the reference.",
        "The error is that of the run.",
    ),
    Rule(
        "a homely word",
        lambda s: re.search(rf"\b(?:{HOMELY})\b", s, re.IGNORECASE),
        "The same call goes on after a crash.",
        "The same call resumes the run after a crash.",
    ),
]


class Text(NamedTuple):
    """A paragraph, a table's cell or a message, with the line where it begins."""

    kind: str
    path: str
    line: int
    body: str


class Finding(NamedTuple):
    """A sentence that breaks a rule."""

    kind: str
    path: str
    line: int
    rule: str
    sentence: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.rule} [{self.kind}]: {self.sentence}"


# ---- sentences -----------------------------------------------------------------------------


def one_word(match: re.Match[str]) -> str:
    """Replace code or a formula by a word, on as many lines."""
    return "X" + "\n" * match[0].count("\n")


def plain(text: str) -> str:
    """Return a text with one word for each piece of code and each formula, and without marks."""
    text = re.sub(r":[\w:]+:(?=`)", "", text)  # a role of Sphinx
    code, formula = r"(`+)(?!`).+?(?<!`)\1(?!`)", r"\$[^$\n]+(?:\n[^$\n]+)?\$"
    text = re.sub(f"{code}|{formula}", one_word, text, flags=re.DOTALL)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)  # a link, or a picture
    text = re.sub(r"</?\w[^<>]*>|\*\*|__", "", text)
    return re.sub(r"%%|%[-+#0-9.*]*(?:l|z|h)*[a-zA-Z](?!\w)", "X", text)


def sentences(text: Text) -> Iterator[tuple[int, str]]:
    """Yield the sentences of a text, each with its line."""
    body = plain(text.body)
    body = re.sub(r"\b(e\.g|i\.e|cf|vs|al|Fig|Sec|eq)\.", r"\1", body)
    at = 0
    for end in [*re.finditer(r"[.?!][\"')]*(?=\s+[^\sa-z])|;(?=\s)", body), None]:
        part = body[at : end.end() if end else None]
        said = re.sub(r"^\s*(?:[-*+]|\d+\.) ", "", part).strip()
        if said:
            start = at + part.index(said)
            yield text.line + body.count("\n", 0, start), " ".join(said.split())
        at = end.end() if end else at


def findings(texts: list[Text]) -> list[Finding]:
    """Return the sentences that break a rule, in the order of their places."""
    return sorted(
        Finding(text.kind, text.path, line, rule.name, sentence)
        for text in texts
        for line, sentence in sentences(text)
        for rule in RULES
        if rule.broken(sentence)
    )


# ---- texts ---------------------------------------------------------------------------------


def paragraphs(kind: str, path: str, line: int, lines: list[str]) -> Iterator[Text]:
    """Yield the paragraphs of lines, the first of which has the number ``line``.

    A blank line ends a paragraph, and so does a line that begins another item of a list.
    """
    begin = 0
    for k in range(len(lines) + 1):
        ends = k == len(lines) or not lines[k].strip()
        if ends or re.match(r"\s*(?:[-*+]|\d+\.) ", lines[k]):
            if body := "\n".join(lines[begin:k]).strip():
                yield Text(kind, path, line + begin, body)
            begin = k + ends


def blank(match: re.Match[str]) -> str:
    """Replace a part by as many empty lines."""
    return "\n" * match[0].count("\n")


def markdown(kind: str, path: str, text: str) -> Iterator[Text]:
    """Yield the prose of a page: paragraphs, headings, items of lists, cells of tables."""
    # Front matter, fenced code, displayed formulas, comments; then code that is indented.
    text = re.sub(
        r"\A---\n.*?^---$|^( *)(`{3,}).*?^\1\2$|^\$\$.*?\$\$$|<!--.*?-->", blank, text,
        flags=re.MULTILINE | re.DOTALL,
    )  # fmt: skip
    text = re.sub(r"(?<=\n\n)(?: {4}.*\n+)+", blank, text)
    lines = text.splitlines()
    for k, line in enumerate(lines):
        if re.match(r" *(?::::|:[\w-]+:)", line):  # a directive, or an option of one
            lines[k] = ""
        elif line.startswith(("|", "#")):
            for cell in re.split(r"(?<!\\)\|", line):
                yield Text(kind, path, k + 1, cell.strip("# "))
            lines[k] = ""
    yield from paragraphs(kind, path, 1, lines)


ENTRIES = {"Parameters", "Other Parameters", "Returns", "Yields", "Raises", "Warns", "Attributes"}


def docstring(path: str, line: int, text: str) -> Iterator[Text]:
    """Yield the prose of a docstring: no doctests, no names and types of parameters."""
    lines = ast.literal_eval(repr(text)).splitlines()
    margin = min((len(x) - len(x.lstrip()) for x in lines[1:] if x.strip()), default=0)
    lines = [lines[0], *(x[margin:] for x in lines[1:])]
    section, example, literal = "", False, False
    for k, each in enumerate(lines):
        if k + 1 < len(lines) and re.fullmatch(r"-{3,}", lines[k + 1].strip()):
            section, lines[k], lines[k + 1] = each.strip(), "", ""
            continue
        example = bool(each.strip()) and (example or each.lstrip().startswith(">>>"))
        literal = literal and (not each.strip() or each.startswith("    "))
        entry = section in ENTRIES and not each.startswith(" ")
        if example or literal or entry or section in ("Examples", "See Also") and ":" in each:
            lines[k] = ""
        literal = literal or each.rstrip().endswith("::")
    yield from paragraphs("docstrings", path, line, lines)


def literal(node: ast.expr) -> list[str]:
    """Return the texts that an expression may be, with a word for each value put into them."""
    if isinstance(node, ast.Constant):
        return [node.value] if isinstance(node.value, str) else []
    if isinstance(node, ast.JoinedStr):
        parts = [part.value if isinstance(part, ast.Constant) else "X" for part in node.values]
        return ["".join(map(str, parts))]
    return []


def is_text(body: str) -> bool:
    """Whether a literal is for people: some words, and no source of a program."""
    return len(re.findall(r"[^\W\d_]{2,}", body)) >= FEWEST_WORDS and not re.search(
        r"[;{]\n|^\s*#|^ *(?:static|extern) ", body
    )


def python(path: str, source: str) -> Iterator[Text]:
    """Yield the docstrings of a module, the help of its commands and its messages."""
    tree, seen, helps = ast.parse(source), set(), set()
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and literal(first.value):
                seen.add(first.value)
                yield from docstring(path, first.lineno, literal(first.value)[0])
        elif isinstance(node, ast.JoinedStr):
            seen.update(node.values)
        elif isinstance(node, ast.Attribute) and node.attr == "split":  # a list of names
            seen.add(node.value)
        elif isinstance(node, ast.keyword) and node.arg in ("help", "description", "epilog"):
            helps.update(ast.walk(node.value))
    for node in ast.walk(tree):
        kind = "help" if node in helps and "/cli/" in path else "messages"
        if node not in seen and isinstance(node, ast.expr):
            for body in literal(node):
                if kind == "help" or is_text(body):
                    yield Text(kind, path, node.lineno, body)


def script(path: str, source: str) -> Iterator[Text]:
    """Yield the prose of a script of the gallery: also the texts between its blocks of code."""
    yield from python(path, source)
    for match in re.finditer(r"^# %%\n((?:#.*\n)+)", source, flags=re.MULTILINE):
        lines = re.sub(r"(?m)^# ?(?:[-=]{3,}$)?", "", match[1]).splitlines()
        yield from paragraphs("docs", path, source.count("\n", 0, match.start(1)) + 1, lines)


def notebook(path: str, source: str) -> Iterator[Text]:
    """Yield the prose of a notebook; a line is that in its cell."""
    for cell in json.loads(source)["cells"]:
        if cell["cell_type"] == "markdown":
            yield from markdown("docs", path, "".join(cell["source"]))


def c_parts(source: str) -> Iterator[tuple[int, str, str]]:
    """Yield the comments and the literals of a source of C: line, first character, content.

    Formulas in a comment, which are indented, are left out.
    """
    string = r'"(?:[^"\\\n]|\\.)*"'
    comments, strings = r"/\*(?P<c>.*?)\*/", rf"(?P<s>{string}(?:[\s\\]*(?:PRI\w+\s*)?{string})*)"
    for match in re.finditer(rf"{comments}|{strings}|'(?:\\.|[^'\\])+'", source, flags=re.DOTALL):
        line = source.count("\n", 0, match.start()) + 1
        if match["c"] is not None:
            yield line, "/", re.sub(r"(?m)^ *\*(?: {4,}.*)?", "", match["c"])
        elif match["s"]:
            pieces = [piece[1:-1] for piece in re.findall(string, match["s"])]
            yield line, '"', "".join(pieces).replace('\\"', '"').replace("\\n", "\n")


def c(path: str, source: str) -> Iterator[Text]:
    """Yield the messages of a source of C, and the comments if it is a public header."""
    for line, first, body in c_parts(source):
        if first == '"' and is_text(body):
            for each in body.splitlines():  # formulas, one below the other
                yield Text("messages", path, line, each)
        elif first == "/" and path.startswith("include/"):
            yield from paragraphs("header", path, line, body.splitlines())


def shell(path: str, source: str) -> Iterator[Text]:
    """Yield the help of a script: what follows `cat <<'TEXT'`, and the lines that it says."""
    usage, said = r"cat <<'TEXT'\n(usage.*?)^TEXT$", r"^ *(?:say|stop) (['\"])(.*?)\2"
    for match in re.finditer(f"{usage}|{said}", source, flags=re.MULTILINE | re.DOTALL):
        line = source.count("\n", 0, match.start()) + 1
        lines = (match[1] or match[3]).splitlines()
        # An entry of the usage begins a paragraph, and its name is not part of the sentence.
        for k, each in enumerate(lines):
            if match[1] and re.match(r"  \w", each):
                lines[k] = "- " + each.strip()
        yield from paragraphs("help", path, line + bool(match[1]), lines)


def texts() -> list[Text]:
    """Return all that the rules are about."""
    readers: list[tuple[str, Callable[[str, str], Iterator[Text]]]] = [
        ("README.md", lambda *x: markdown("readme", *x)),
        ("CONTRIBUTING.md", lambda *x: markdown("readme", *x)),
        ("docs/**/*.md", lambda *x: markdown("docs", *x)),
        ("examples/*.py", script),
        ("notebooks/*.ipynb", notebook),
        ("python/dalembert/**/*.py", python),
        ("include/**/*.h", c),
        ("csrc/**/*.[ch]", c),
        ("dev", shell),
    ]
    return [
        text
        for pattern, read in readers
        for path in sorted(ROOT.glob(pattern))
        for text in read(str(path.relative_to(ROOT)), path.read_text(encoding="utf-8"))
    ]


# ---- exceptions ----------------------------------------------------------------------------


def compare(found: list[Finding], allowed: dict[tuple[str, str], int]) -> list[str]:
    """Return the complaints about the numbers of findings, by kind and path."""
    counts = Counter((one.kind, one.path) for one in found)
    wrong = []
    for key in sorted({*counts, *allowed}):
        count, most = counts[key], allowed.get(key, 0)
        if count > most:
            wrong += [str(one) for one in found if (one.kind, one.path) == key]
            wrong.append(f"{key[1]}: {count} findings in its {key[0]}, {most} allowed\n")
        elif count < most:
            wrong.append(
                f"{key[1]}: {count} findings in its {key[0]}, and {EXCEPTIONS.name} allows {most}; "
                "lower it with: python tests/check_voice.py --shrink"
            )
    return wrong


def read_exceptions() -> dict[tuple[str, str], int]:
    """Return the numbers allowed, by kind and path."""
    kinds = tomllib.loads(EXCEPTIONS.read_text(encoding="utf-8"))
    return {(kind, path): n for kind, paths in kinds.items() for path, n in paths.items()}


def shrink(found: list[Finding], allowed: dict[tuple[str, str], int]) -> None:
    """Lower the numbers of voice.toml to the findings."""
    counts = Counter((one.kind, one.path) for one in found)
    head = EXCEPTIONS.read_text(encoding="utf-8").split("[")[0].rstrip()
    lines = [head]
    for kind in sorted({kind for kind, _ in allowed}):
        left = {path: min(n, counts[kind, path]) for (k, path), n in allowed.items() if k == kind}
        rows = [f'"{path}" = {n}' for path, n in sorted(left.items()) if n]
        lines += ["", f"[{kind}]", *rows] if rows else []
    EXCEPTIONS.write_text("\n".join(lines) + "\n", encoding="utf-8")


# ---- the check of the check ----------------------------------------------------------------


def example(suffix: str, source: str) -> list[str]:
    """Return the findings in a source, as "kind line"."""
    read = {".md": lambda *x: markdown("docs", *x), ".py": python, ".c": c, ".h": c, "dev": shell,
            "script": script, ".ipynb": notebook}  # fmt: skip
    found = findings(list(read[suffix]("include/x/cli/" + suffix, source)))
    return [f"{one.kind} {one.line}" for one in found]


BAD = RULES[-1].bad
EXAMPLES = [
    (".md", f"# Title\n\n```text\n{BAD}\n```\n\n{BAD}\n", ["docs 7"]),
    (".md", f"| a | {BAD} |\n\n    {BAD}\n", ["docs 1"]),
    (".md", f"First `goes on`\nin $a goes on$. Fine;\n{BAD}\n", ["docs 3"]),
    (".py", f'"""{BAD}\n\nExamples\n--------\n>>> 1\n{BAD}\n"""\n', ["docstrings 1"]),
    (".py", f'def f():\n    """Do.\n\n    Parameters\n    ----------\n    x : {BAD}\n'
            f'        {BAD}\n    """\n', ["docstrings 7"]),
    (".py", 'raise E(f"{name} goes on "\n        "for ever and")\n', ["messages 1"]),
    (".py", 'add("--x", help="goes on")\n', ["help 1"]),
    (".c", 'f("%s goes on"\n  " for ever")\n', ["messages 1"]),
    (".h", f"int x; /* one\n         two.\n         {BAD} */\n", ["header 3"]),
    (".h", f"int x;\n/* Fine. {BAD}\n *\n *     goes on */\n", ["header 2"]),
    ("script", f"# goes on\n\n# %%\n# Head\n# ----\n# {BAD}\n\nx = 1\n", ["docs 6"]),
    (".ipynb", json.dumps({"cells": [{"cell_type": "code", "source": [BAD]},
                                     {"cell_type": "markdown", "source": ["# A\n", BAD]}]}),
     ["docs 2"]),
    ("dev", f"cat <<'TEXT'\nusage: dev\n\n  one   fine\n  two   {BAD}\nTEXT\nsay 'go on'\n",
     ["help 5", "help 7"]),
]  # fmt: skip


def check_itself() -> list[str]:
    """Return the rules and readers that do not do what their examples say."""
    wrong = [
        f'the rule "{rule.name}" is wrong about: {sentence}'
        for rule in RULES
        for sentence, broken in ((rule.bad, True), (rule.good, False))
        if bool(rule.broken(sentence)) != broken
    ]
    wrong += [
        f"expected {expected}, got {example(suffix, source)} in {source!r}"
        for suffix, source, expected in EXAMPLES
        if example(suffix, source) != expected
    ]
    one = [Finding("docs", "a.md", 1, "rule", "sentence")]
    for number, complaints in ((0, 2), (1, 0), (2, 1)):
        if len(compare(one, {("docs", "a.md"): number})) != complaints:
            wrong.append(f"one finding is compared wrongly with {number} allowed")
    return wrong


def main(option: str = "", *paths: str) -> str | None:
    found = findings(texts())
    if option == "--list":
        print(*[one for one in found if one.path.startswith(paths or "")], sep="\n")
        return None
    if option == "--shrink":
        shrink(found, read_exceptions())
    wrong = check_itself() + compare(found, read_exceptions())
    if not wrong:
        kinds = Counter(one.kind for one in found)
        print(*[f"{kind}: {n} exceptions" for kind, n in sorted(kinds.items())], sep=", ")
    return "\n".join(wrong) or None


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
