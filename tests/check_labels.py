"""docs/paper-to-code.md is true: its names exist, and the labels of the headers stand in it.

Usage: ``python check_labels.py paper-to-code.md PACKAGE HEADER...``

The table is the list of the paper's labels.  Of each row

- every function, type, field and constant of the column C is in the header, and every name of the
  column Python in the package;
- every link leads somewhere, a test is defined in the file that the link leads to, and tests and
  examples use something of their row.

Of the headers, every label in a comment (in parentheses) is in the table, in a row that names what
the comment is about.
"""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from typing import NamedTuple

from check_symbols import declared, read

LABELS = 165  # of the paper
COLUMNS = ["label", "says", "C", "Python", "tests", "shown in"]
# What a test runs besides its own text.
COMPANIONS = {"test_errata.py": "docs/errata.py"}
# Single words in parentheses that are no labels.
WORDS = {"Chetaev", "NaN", "beta", "odeiv2", "parentheses"}


class Row(NamedTuple):
    """One line of the table; links are (text, target)."""

    label: str
    C: list[str]
    Python: list[str]
    tests: list[tuple[str, str]]
    shown: list[tuple[str, str]]


def read_table(text: str) -> tuple[list[Row], list[str]]:
    """Return the rows of the tables, and what is wrong with their form."""
    rows, wrong = [], []
    for line in text.splitlines():
        if not line.startswith("|") or re.fullmatch(r"[| -]+", line):
            continue
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells == COLUMNS:
            continue
        if len(cells) != len(COLUMNS) or not all(cells):
            wrong.append(f"not a row of {len(COLUMNS)} cells, all of them filled: {line}")
            continue
        names = [re.findall(r"`(?:dal\.)?([^`]+)`", cell) for cell in cells]
        links = [re.findall(r"\[([^\]]+)\]\(([^)]+)\)", cell) for cell in cells]
        if len(names[0]) != 1 or not (names[2] and names[3] and links[4] and links[5]):
            wrong.append(f"no label, function, test or example is read from: {line}")
            continue
        rows.append(Row(names[0][0], names[2], names[3], links[4], links[5]))
    labels = [row.label for row in rows]
    wrong += [f"{label} has two rows" for label in sorted(set(labels)) if labels.count(label) > 1]
    if len(rows) + len(wrong) != LABELS:
        wrong.append(f"{len(rows)} rows, {LABELS} labels in the paper")
    return rows, wrong


# ---- what there is -------------------------------------------------------------------------


def c_names(header: str) -> set[str]:
    """Functions, types, fields as type.field, and constants that ``header`` declares."""
    text = re.sub(r"/\*.*?\*/", "", header, flags=re.S)
    names = declared(header) | set(re.findall(r"^typedef .*?\b(dal_\w+);", text, flags=re.M))
    names |= set(re.findall(r"^typedef .*?\(\*(dal_\w+)\)", text, flags=re.M))
    for kind, body, name in re.findall(
        r"^typedef (struct|enum) \w+ \{(.*?)^\} (dal_\w+);", text, flags=re.S | re.M
    ):
        names.add(name)
        if kind == "enum":
            names |= set(re.findall(r"\bDAL_\w+", body))
        else:
            names |= {f"{name}.{field}" for field in re.findall(r"(\w+)(?:\[\w+\])?[;,]", body)}
    return names


def _assigned(node: ast.stmt) -> list[str]:
    """Names that a statement of a module or a class defines."""
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        return [node.name]
    if isinstance(node, ast.ImportFrom):
        return [alias.asname or alias.name for alias in node.names]
    targets = getattr(node, "targets", [getattr(node, "target", None)])
    return [target.id for target in targets if isinstance(target, ast.Name)]


def python_names(package: Path) -> set[str]:
    """What ``package`` exports, with a point before what its classes and modules contain."""
    names: set[str] = set()
    for path in package.rglob("*.py"):
        module = ast.parse(path.read_text(encoding="utf-8"))
        for node in module.body:
            if path.parent == package and path.stem == "__init__":
                names.update(_assigned(node))
                continue
            owner = path.parent.name if path.stem == "__init__" else path.stem
            names.update(f"{owner}.{name}" for name in _assigned(node))
            if not isinstance(node, ast.ClassDef):
                continue
            members = [name for inner in node.body for name in _assigned(inner)]
            members += [
                inner.attr
                for inner in ast.walk(node)
                if isinstance(inner, ast.Attribute)
                and isinstance(inner.ctx, ast.Store)
                and isinstance(inner.value, ast.Name)
                and inner.value.id == "self"
            ]
            names.update(f"{node.name}.{member}" for member in members)
    return names


def defines(text: str, function: str) -> bool:
    """Whether a C or Python source defines ``function`` at its outer level."""
    name = re.escape(function)
    return re.search(rf"^(?:def |static [\w *]*\b){name}\(", text, flags=re.M) is not None


def section(text: str, anchor: str) -> str | None:
    """Return the part of a Markdown text under the heading with this anchor, if there is one."""
    parts = re.split(r"^(#+ .*)$", text, flags=re.M)
    for heading, body in zip(parts[1::2], parts[2::2]):
        title = heading.lstrip("#").strip().lower()
        if re.sub(r"[^\w\- ]", "", title).replace(" ", "-") == anchor:
            return body
    return None


def uses(text: str, row: Row, language: str) -> bool:
    """Whether a text has something of the row in it; prose (.md) may also have its label."""
    patterns = []
    for name in row.Python if language != ".c" else []:
        owner, _, member = name.rpartition(".")
        attribute = owner[:1].isupper() and language == ".py"
        patterns.append(rf"(?:\.|def ){member}\b" if attribute else rf"\b{member}\b")
    if language != ".py":
        patterns += [rf"\b{name}\b" for name in row.C if "." not in name]
    if language == ".md":
        patterns.append(rf"\b{re.escape(row.label)}\b")
    return any(re.search(pattern, text) for pattern in patterns)


# ---- checks --------------------------------------------------------------------------------


def check_links(row: Row, table: Path) -> list[str]:
    """Follow the links of a row: what is wrong with them."""
    found = []
    root = table.parent.parent
    for links, is_test in ((row.tests, True), (row.shown, False)):
        for name, target in links:
            file, _, anchor = target.partition("#")
            path = table.parent / file
            if not path.is_file():
                found.append(f"{row.label}: there is no {target}")
                continue
            text = path.read_text(encoding="utf-8")
            if is_test and not defines(text, name):
                found.append(f"{row.label}: {target} defines no {name}")
            if is_test != (root / "tests" in path.resolve().parents):
                found.append(f"{row.label}: {target} is in the wrong column")
            if anchor:
                part = section(text, anchor)
                if part is None:
                    found.append(f"{row.label}: there is no {target}")
                    continue
                text = part
            if path.name in COMPANIONS:
                text += (root / COMPANIONS[path.name]).read_text(encoding="utf-8")
            if not uses(text, row, path.suffix):
                found.append(f"{row.label}: {target} uses nothing of {row.C + row.Python}")
    return found


def comments(header: str) -> list[tuple[str, set[str]]]:
    """Return the comments of ``header``, each with the names of what it is about."""
    found = []
    for match in re.finditer(r"/\*(.*?)\*/", header, flags=re.S):
        before = header[: match.start()]
        after = re.split(r"\n\s*\n|/\*", header[match.end() :], maxsplit=1)[0]
        opened = re.split(r"^typedef (?:struct|enum) (dal_\w+) \{", before, flags=re.M)
        if len(opened) > 1 and "\n}" not in opened[-1]:  # a member's
            line = before.rpartition("\n")[2]
            about = {opened[-2], *re.findall(r"\bDAL_\w+", line)}
        else:
            about = declared(after)
            about |= set(re.findall(r"^typedef .*?\(\*(dal_\w+)\)", after, flags=re.M))
            about |= set(re.findall(r"^typedef (?:struct|enum) (dal_\w+)", after, flags=re.M))
        text = re.sub(r"\s+", " ", re.sub(r"\n \*", "\n", match[1]))
        found.append((text, about))
    return found


def citation(group: str, labels: set[str]) -> tuple[list[str], list[str]]:
    """Return the labels in a pair of parentheses, and the words that stand like labels there.

    An item between commas or semicolons is a label, or has one in it that no English word can be
    taken for.  A point of the errata may stand among labels.
    """
    cited, others = [], []
    items = [item.strip() for item in re.split("[,;]", group)]
    for item in items:
        if item in labels:
            cited.append(item)
        elif re.fullmatch(r"[A-Za-z]\w*", item):
            others += [] if re.fullmatch(r"E\d+", item) else [item]
        else:
            words = re.findall(r"[A-Za-z][\w-]*", item)
            cited += [
                word for word in words if word in labels and (len(word) > 8 or not word.islower())
            ]
    if others and all(len(label) == 1 for label in cited):  # (g, f), or no citation at all
        alone = len(items) == 1 and len(items[0]) > 2 and "_" not in items[0]
        return [], [item for item in others if alone and item not in WORDS]
    return cited, others


def check_header(header: str, rows: list[Row]) -> list[str]:
    """Look up the labels of the header: what is not in the table, or elsewhere."""
    names = {row.label: {name.split(".")[0] for name in row.C} for row in rows}
    found = []
    quoted = set()
    for text, about in comments(header):
        for group in re.findall(r"(?<=\s)\(([^()]*)\)", text):
            cited, others = citation(group, names.keys())
            quoted.update(cited)
            found += [f"({group}) in the header: {item} is not in the table" for item in others]
            found += [
                f"({label}) is in the header at {sorted(about)}, its row has {sorted(names[label])}"
                for label in cited
                if about and not about & names[label]
            ]
    if len(quoted) < LABELS // 3:
        found.append(f"only {len(quoted)} labels are found in the header")
    return found


def main(table: str, package: str, *headers: str) -> str | None:
    rows, wrong = read_table(Path(table).read_text(encoding="utf-8"))
    text = read(headers)
    in_c, in_python = c_names(text), python_names(Path(package))
    for row in rows:
        wrong += [f"{row.label}: the header has no {name}" for name in row.C if name not in in_c]
        wrong += [
            f"{row.label}: the package has no {name}"
            for name in row.Python
            if name not in in_python
        ]
        wrong += check_links(row, Path(table).resolve())
    wrong += check_header(text, rows)
    if not wrong:
        tests = {test for row in rows for test in row.tests}
        functions = {name for row in rows for name in row.C}
        print(f"{len(rows)} labels, {len(functions)} names of the header, {len(tests)} tests")
    return "\n".join(wrong) or None


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
