"""Change the library in one place after the other, and see which changes no test notices.

The mutations stand in mutations.toml: ``file``; ``old``, a text that occurs in it once, or
``index`` says which; ``new``; ``tests``, names for `meson test` of which one has to fail; and, if
none can, the ``reason``.  Everything happens in copies of the tree.  To run some of them:

    ./dev shell python tests/mutate.py -k plot --jobs 2
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

try:
    import tomllib
except ImportError:
    print("mutate.py needs Python 3.11 or later")
    sys.exit(77)  # to meson: skipped

ROOT = Path(__file__).resolve().parents[1]


class Mutation:
    """One change of one file, and the tests that have to notice it."""

    def __init__(self, file, old, new, tests, index=None, reason=""):
        self.file, self.tests, self.reason = file, tests, reason
        self.name = f"{file}: {' '.join(old.split())} -> {' '.join(new.split()) or 'nothing'}"
        self.text = (ROOT / file).read_text(encoding="utf-8")
        parts = self.text.split(old)
        many = len(parts) - 1
        if old == new or not tests or (many != 1 if index is None else not 0 <= index < many):
            raise ValueError(f"{self.name}: the old text occurs {many} times, index = {index}")
        cut = 1 + (index or 0)
        self.changed = old.join(parts[:cut]) + new + old.join(parts[cut:])


class Tree:
    """A copy of the tree with a build directory of its own."""

    def __init__(self, folder):
        self.root, self.build = folder, folder / "build"
        listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        files = subprocess.run(listed, cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout
        for name in filter(None, files.decode().split("\0")):
            if (ROOT / name).is_file():  # not one that was removed
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, folder / name)
        self.run("meson", "setup", self.build, "-Dpython=enabled", check=True)
        targets = {x["id"]: x["filename"] for x in self.introspect("--targets")}
        self.tests = {}
        for test in self.introspect("--tests"):
            made = [os.path.relpath(x, self.build) for i in test["depends"] for x in targets[i]]
            self.tests[test["name"]] = (test["timeout"], made)

    def run(self, *command, **options):
        quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        done = subprocess.run(command, cwd=self.root, stdin=subprocess.DEVNULL, **quiet, **options)
        return done.stdout if done.returncode else ""

    def introspect(self, what):
        command = ["meson", "introspect", what, self.build]
        return json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)

    def make(self, names):
        """Build what the tests need."""
        made = sorted({x for name in names for x in self.tests[name][1]})
        if output := self.run("ninja", "-C", self.build, *made):
            raise RuntimeError("it does not build\n" + output[-2000:])

    def first_to_fail(self, names, limits):
        """Return which is the first of the tests that fails or takes too long, or None."""
        self.make(names)
        for name in names:
            factor = str(limits[name] / self.tests[name][0])
            test = ["meson", "test", "-C", self.build, "--no-rebuild", "-t", factor, name]
            if output := self.run(*test):
                return name + ", which runs out of time" * ("TIMEOUT" in output)
        return None

    def judge(self, mutation, limits):
        """Return whether all is well with a mutation, and what happened."""
        path = self.root / mutation.file
        path.write_text(mutation.changed, encoding="utf-8")
        try:
            failed = self.first_to_fail(mutation.tests, limits)
        except RuntimeError as error:
            return False, str(error)
        finally:
            path.write_text(mutation.text, encoding="utf-8")
        reason = f", although {mutation.reason}" if mutation.reason else ""
        if failed:
            return not reason, f"caught by {failed}{reason}"
        return bool(reason), f"survives: {mutation.reason or 'for no reason'}"


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-k", default="", metavar="PATTERN", help="only those that contain it")
    parser.add_argument("--jobs", type=int, default=1, help="copies of the tree at a time")
    parser.add_argument("--limit", type=float, default=20, help="seconds for a test, default 20; "
                        "more where it takes more than a third of them as the library is")
    parser.add_argument("--list", action="store_true", help="only show them, if they still apply")
    return parser.parse_args()


def main():
    options = arguments()
    table = tomllib.loads((ROOT / "tests/mutations.toml").read_text(encoding="utf-8"))
    try:
        mutations = [Mutation(**entry) for entry in table["mutation"]]
    except (OSError, ValueError) as error:
        return str(error)
    mutations = [x for x in mutations if options.k in x.name]
    if options.list:
        print(*(x.name for x in mutations), f"{len(mutations)} mutations", sep="\n")
        return 0
    with tempfile.TemporaryDirectory(prefix="mutate-") as folder:
        trees, good = queue.Queue(), 0
        for i in range(options.jobs):
            (Path(folder) / str(i)).mkdir()
            trees.put(tree := Tree(Path(folder) / str(i)))
        names = sorted({name for x in mutations for name in x.tests})
        tree.make(names)
        broken, limits = set(), {}
        for name in names:
            began = time.monotonic()
            if tree.first_to_fail([name], {name: tree.tests[name][0]}):
                broken.add(name)
            limits[name] = max(options.limit, 3 * (time.monotonic() - began))

        def judge(mutation):
            if bad := broken.intersection(mutation.tests):
                return False, f"{', '.join(bad)}: fails as the library is", 0.0
            began, tree = time.monotonic(), trees.get()
            try:
                return *tree.judge(mutation, limits), time.monotonic() - began
            finally:
                trees.put(tree)

        with ThreadPoolExecutor(options.jobs) as pool:
            for mutation, (well, what, took) in zip(mutations, pool.map(judge, mutations)):
                print("  " if well else "!!", mutation.name)
                print(f"     {what} ({took:.0f} s)", flush=True)
                good += well
        print(f"{len(mutations)} mutations, {len(mutations) - good} not as they should be")
        return int(good < len(mutations))


if __name__ == "__main__":
    sys.exit(main())
