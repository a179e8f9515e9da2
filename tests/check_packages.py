"""A module of the package imports its own floor or lower ones, and no circle.

Usage: ``python check_packages.py PACKAGE FLOOR...`` where a FLOOR is a package, or a module beside
them, the lowest first.  ``__init__`` and ``__main__`` stand on top.

Also: nothing is imported for type checkers alone, and no function imports the package itself.
Modules that need SymPy may be imported late, by ``Later(package, name)``, which counts as any
import.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

TOP = ["__init__", "__main__"]
LATE = "core.extras"  # the one module that imports others by name


def modules(package: Path) -> dict[str, Path]:
    """Return the files of a package by name, ``core.errors`` or ``core.__init__``."""
    found = {path: path.relative_to(package).with_suffix("") for path in package.rglob("*.py")}
    return {".".join(name.parts): path for path, name in found.items()} | {"_core": package}


def imports(
    tree: ast.Module, name: str, package: str, known: set[str]
) -> Iterator[tuple[str, int]]:
    """Yield the modules of the package that one imports, and the lines."""
    place = name.split(".")[:-1]
    for node in ast.walk(tree):
        targets: list[list[str]] = []
        if isinstance(node, ast.ImportFrom):
            path = node.module.split(".") if node.module else []
            if node.level:
                path = place[: len(place) + 1 - node.level] + path
            elif path[0] != package:
                continue
            else:
                path = path[1:]
            targets = [[*path, alias.name] for alias in node.names]
        elif isinstance(node, ast.Import):
            paths = [alias.name.split(".") for alias in node.names]
            targets = [path[1:] for path in paths if path[0] == package]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Later"):
            targets = [[*place, ast.literal_eval(node.args[1])]]
        for target in targets:
            found = (".".join(x) for x in (target, [*target, "__init__"],
                                           [*target[:-1], "__init__"], target[:-1]))
            yield next(x for x in found if x in known), node.lineno


def in_functions(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield what stands in functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from ast.walk(node)


def complaints(package: Path, floors: list[str]) -> list[str]:
    """What is wrong with the house, one line each."""
    files = modules(package)
    order = ["_core", "_ffi_build", *floors, *TOP]
    found, graph = [], {}
    for name, path in sorted(files.items()):
        if path == package:
            continue
        if name.split(".")[0] not in order:
            found.append(f"{name} is on no floor")
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        floor = order.index(name.split(".")[0])
        used = list(imports(tree, name, package.name, set(files)))
        graph[name] = {other for other, _ in used}
        found += [
            f"{name}, line {line}: imports {other}, which stands above"
            for other, line in used
            if order.index(other.split(".")[0]) > floor
        ]
        inside = {node.lineno for node in in_functions(tree) if isinstance(node, ast.stmt)}
        found += [
            f"{name}, line {line}: imports {other} in a function"
            for other, line in used
            if line in inside
        ]
        for node in ast.walk(tree):
            word = getattr(node, "id", getattr(node, "attr", ""))
            if word == "TYPE_CHECKING":
                found.append(f"{name}, line {node.lineno}: an import for type checkers alone")
            if word in ("import_module", "__import__") and name != LATE:
                found.append(f"{name}, line {node.lineno}: imports by name; {LATE}.Later does")
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found.append("a circle: " + ", which imports ".join(reversed(error.args[1])))
    return found


if __name__ == "__main__":
    wrong = complaints(Path(sys.argv[1]), sys.argv[2:])
    sys.exit("\n".join(wrong) or None)
