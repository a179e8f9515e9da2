"""The code of a page runs, and prints what the page says.

Usage: ``python check_blocks.py [--pictures] PAGE.md...``

The blocks of a Markdown page run in their order, in a folder of their own:

- ``python``: all of a page in one process, as if they were one script.
- ``console``: the lines after ``$`` run in a shell, with ``\\`` at the end of a line that goes on;
  the lines below them are what they print, and need not be there.  A command that is to fail ends
  in ``# exits with 2``.
- ``c``: a whole program, compiled as ``pkg-config`` says.
- one of these with the name of a file (``python own.py``): written, not run.
- ``text``: what the block of Python or C before it prints; a traceback is compared in its last
  line, which is that of the exception.
- ``sh`` and others: not run; what a reader types once, to install something.

With ``--pictures`` the pictures that the blocks of a page write replace those that it shows.

Words are compared exactly, numbers that are not whole to two parts in a hundred, those below 1e-11,
which are roundoff, not at all.  ``...`` stands for the rest of a line; alone, for any lines.
"""

from __future__ import annotations

import contextlib
import io
import linecache
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import traceback
import types
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

RUN = ("python", "console", "c")
RELATIVE = 2e-2
ROUNDOFF = 1e-11
MARK = "--- end of command"
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


class Wrong(Exception):
    """A block does not do what the page says."""


@dataclass
class Block:
    language: str
    file: str  # "" where it is to be run
    text: str
    line: int  # of its first line of code in the page, from 1


def blocks(page: str) -> list[Block]:
    """Return the blocks of a page with a language, in their order."""
    found = []
    for token in MarkdownIt("commonmark").parse(page):
        words = token.info.removeprefix("{code-block}").split() if token.type == "fence" else []
        if words:
            file = words[1] if len(words) > 1 and words[0] in RUN else ""
            found.append(Block(words[0], file, token.content, token.map[0] + 2))
    return found


def pieces(line: str) -> list[str | float]:
    """Return a line as words and numbers; only numbers that are not whole are floats."""
    found: list[str | float] = []
    end = 0
    for match in NUMBER.finditer(line):
        found += line[end : match.start()].split()
        text = match.group()
        found.append(text if text.lstrip("+-").isdigit() else float(text))
        end = match.end()
    return found + line[end:].split()


def same(one: str, other: str) -> bool:
    """Compare a line of a page with one that was printed."""
    expected, dots, _ = one.partition("...")
    left, right = pieces(expected), pieces(other)
    if len(left) > len(right) or (not dots and len(left) < len(right)):
        return False
    return all(
        (abs(a - b) <= RELATIVE * max(abs(a), abs(b)) or max(abs(a), abs(b)) < ROUNDOFF)
        if isinstance(a, float) and isinstance(b, float)
        else a == b
        for a, b in zip(left, right)
    )


def matches(expected: list[str], printed: list[str]) -> bool:
    """Compare lines; a line of dots stands for any number of them."""
    if not expected:
        return not printed
    if expected[0].strip() == "...":
        return any(matches(expected[1:], printed[k:]) for k in range(len(printed) + 1))
    return bool(printed) and same(expected[0], printed[0]) and matches(expected[1:], printed[1:])


def compare(expected: str, printed: str) -> None:
    """Compare what a page says with what was printed, but for empty lines."""
    left, right = ([x for x in text.splitlines() if x.strip()] for text in (expected, printed))
    if left and left[0].startswith("Traceback"):
        left, right = left[-1:], right[-1:]
    if not matches(left, right):
        raise Wrong("\n".join(["the page says", *left, "and printed is", *right]))


class Page:
    """A page whose blocks run one after the other in the working directory."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.module = types.ModuleType("__main__")
        self.programs = 0

    def python(self, block: Block) -> str:
        """Run a block in the namespace of the page; what it prints, and how it fails."""
        source = "\n" * (block.line - 1) + block.text
        name = f"<{self.name}:{block.line}>"
        linecache.cache[name] = (len(source), None, source.splitlines(keepends=True), name)
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            try:
                exec(compile(source, name, "exec"), self.module.__dict__)
            except Exception:
                printed.write(traceback.format_exc())
        return printed.getvalue()

    def c(self, block: Block) -> str:
        """Compile a program and run it."""
        self.programs += 1
        name = f"program-{self.programs}"
        Path(f"{name}.c").write_text(block.text, encoding="utf-8")
        compiler = os.environ.get("CC", "cc")
        build = f"{compiler} {name}.c $(pkg-config --cflags --libs dalembert) -lm -o {name}"
        return self.shell(f"{build} && ./{name}")

    def console(self, block: Block) -> str:
        """Run commands, and compare what they print with the lines below them."""
        commands: list[tuple[str, list[str]]] = []
        for line in block.text.splitlines():
            if line.startswith("$ "):
                commands.append((line[2:], []))
            elif commands and commands[-1][0].endswith("\\"):
                commands[-1] = (f"{commands[-1][0][:-1]} {line.strip()}", [])
            elif commands:
                commands[-1][1].append(line)
            else:
                raise Wrong(f"{line!r} stands before the first command")
        script = "".join(f"{command}\necho {shlex.quote(MARK)} $?\n" for command, _ in commands)
        printed = self.shell(script).splitlines()
        for command, expected in commands:
            end = next(k for k, line in enumerate(printed) if line.startswith(MARK))
            got, status, printed = printed[:end], printed[end].split()[-1], printed[end + 1 :]
            wanted = re.search(r"# exits with (\d+)$", command)
            if status != (wanted.group(1) if wanted else "0"):
                raise Wrong("\n".join([f"{command}: exit status {status}", *got]))
            if expected:
                compare("\n".join(expected), "\n".join(got))
        return ""

    def shell(self, script: str) -> str:
        done = subprocess.run(
            ["sh", "-c", script], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        if done.returncode:
            raise Wrong(f"exit status {done.returncode}\n{done.stdout}")
        return done.stdout

    def run(self, text: str) -> int:
        """Run all blocks; how many."""
        ran, printed = 0, ""
        sys.modules["__main__"] = self.module
        todo = blocks(text)
        for k, block in enumerate(todo):
            try:
                if block.file:
                    Path(block.file).write_text(block.text, encoding="utf-8")
                elif block.language in RUN:
                    printed = getattr(self, block.language)(block)
                    ran += 1
                    shown = k + 1 < len(todo) and todo[k + 1].language == "text"
                    if not shown and "Traceback (most recent" in printed:
                        raise Wrong(printed)
                elif block.language == "text":
                    compare(block.text, printed)
            except Wrong as error:
                sys.exit(f"{self.name}, line {block.line}: {error}")
        return ran


def put_in_path(folder: Path) -> None:
    """Let shells find this Python, and the command `dalembert` as an installation has it."""
    for name, words in {"python": "", "dalembert": "-m dalembert "}.items():
        path = folder / name
        path.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {words}"$@"\n')
        path.chmod(0o755)
    os.environ["PATH"] = f"{folder}:{os.environ['PATH']}"


def main(*pages: str) -> None:
    os.environ.setdefault("MPLBACKEND", "Agg")
    takes_pictures = pages[:1] == ("--pictures",)
    for page in map(Path, pages[takes_pictures:]):
        text, here = page.read_text(encoding="utf-8"), Path.cwd()
        with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as commands:
            put_in_path(Path(commands))
            os.chdir(folder)
            ran = Page(page.name).run(text)
            os.chdir(here)
            for picture in Path(folder).glob("*.[pg][ni][gf]") if takes_pictures else ():
                shown = re.search(rf"(?:\]\(|{{image}} )([\w/-]*{re.escape(picture.name)})\b", text)
                if shown:
                    shutil.copy(picture, page.parent / shown[1])
        print(f"{page}: {ran} blocks ran")


if __name__ == "__main__":
    main(*sys.argv[1:])
