"""Change the project in one place after the other, and see which changes no test notices.

The special changes stand in mutations.toml: for each file rows of an old text, which occurs in it
once, a new one, and names of tests of which one has to fail; then, if need be, which of several
occurrences (``index``), or why no test can fail (``reason``).  Small ones are drawn at random
(draw.py) in csrc and include, or where --within says, and the quick tests have to notice them.
Everything happens in copies of the tree.

    ./dev shell python tests/mutate.py -k plot --jobs 2
    ./dev shell python tests/mutate.py --draw 100 --seed 7 --from 40
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import hashlib
import json
import os
import queue
import random
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import draw

try:
    import tomllib
except ImportError:
    print("mutate.py needs Python 3.11 or later")
    sys.exit(77)  # to meson: skipped

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "tests/mutations.toml"


class Mutation:
    """One change of one file, and the tests that have to notice it."""

    def __init__(self, file, old, new, tests, index=None, reason=""):
        self.file, self.tests, self.reason = file, tests.split(), reason
        self.name = f"{file}: {' '.join(old.split())} -> {' '.join(new.split()) or 'nothing'}"
        self.text = (ROOT / file).read_text(encoding="utf-8")
        parts = self.text.split(old)
        many = len(parts) - 1
        if old == new or not tests or (many != 1 if index is None else not 0 <= index < many):
            raise ValueError(f"{self.name}: the old text occurs {many} times, index = {index}")
        cut = 1 + (index or 0)
        self.changed = old.join(parts[:cut]) + new + old.join(parts[cut:])


class Drawn:
    """A small change of one file, drawn at random from all of them."""

    def __init__(self, places, dice):
        self.file, (start, end, new) = dice.choice(places)
        self.text = (ROOT / self.file).read_text(encoding="utf-8")
        self.changed = self.text[:start] + new + self.text[end:]
        old = " ".join(self.text[start:end].split())
        self.name = f"{self.file}:{draw.line_of(self.text, start)}: {old} -> {new or 'nothing'}"


def places(within):
    """Return every (file, change) in some folders."""
    listed = subprocess.run(["git", "ls-files", "--", *within], cwd=ROOT, stdout=-1, check=True)
    files = [x for x in listed.stdout.decode().split() if x.endswith((".c", ".h", ".py"))]
    return [(x, y) for x in files for y in draw.changes(x, (ROOT / x).read_text("utf-8"))]


class Tree:
    """A copy of the tree with a build directory of its own."""

    def __init__(self, folder, options=()):
        self.root, self.build = folder, folder / "build"
        listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        files = subprocess.run(listed, cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout
        for name in filter(None, files.decode().split("\0")):
            if (ROOT / name).is_file():  # not one that was removed
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, folder / name)
        self.run("meson", "setup", self.build, "-Dpython=enabled", *options)
        targets = {x["id"]: x["filename"] for x in self.introspect("--targets")}
        self.tests = {}
        for test in self.introspect("--tests"):
            made = [os.path.relpath(x, self.build) for i in test["depends"] for x in targets[i]]
            self.tests[test["name"]] = (test, made)

    def run(self, *command, check=True, **options):
        """Return the status of a command, None after its time; or, unless it may fail, stop."""
        quiet = {"stdin": subprocess.DEVNULL, "stdout": -1, "stderr": subprocess.STDOUT}
        with subprocess.Popen(command, **{"cwd": self.root, **quiet, **options},
                              start_new_session=True) as process:  # fmt: skip
            output, status = b"", None
            try:
                output, _ = process.communicate(timeout=None if check else self.limit)
                status = process.returncode
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, 9)
        if check and status:
            raise RuntimeError(f"it does not build\n{output.decode()[-2000:]}")
        return status

    def introspect(self, what):
        command = ["meson", "introspect", what, self.build]
        return json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)

    def make(self, names):
        """Build what the tests need."""
        self.run("ninja", "-C", self.build, *sorted({x for n in names for x in self.tests[n][1]}))

    def objects(self):
        """Return a digest of the library's object files, without where their sources are."""
        found = sorted((self.build / "csrc").glob("*.p/*.o"))
        return hashlib.sha256(b"".join(path.read_bytes() for path in found)).hexdigest()

    def first_to_fail(self, names, limits):
        """Return which is the first of the tests that fails or takes too long, or None."""
        for name in names:
            self.make([name])
            test = self.tests[name][0]
            self.limit = limits.get(name, test["timeout"])
            status = self.run(*test["cmd"], check=False, cwd=test["workdir"] or self.build,
                              env={**os.environ, **test["env"]})  # fmt: skip
            if status != 0:
                return name + ", which runs out of time" * (status is None)
        return None

    @contextlib.contextmanager
    def changed(self, mutation):
        path = self.root / mutation.file
        path.write_text(mutation.changed, encoding="utf-8")
        try:
            yield
        finally:
            path.write_text(mutation.text, encoding="utf-8")

    def judge(self, mutation, limits):
        """Return whether all is well with a mutation of the list, and what happened."""
        try:
            with self.changed(mutation):
                failed = self.first_to_fail(mutation.tests, limits)
        except RuntimeError as error:
            return False, str(error)
        reason = f", although {mutation.reason}" if mutation.reason else ""
        if failed:
            return not reason, f"caught by {failed}{reason}"
        return bool(reason), f"survives: {mutation.reason or 'for no reason'}"


class Draws:
    """The changes drawn from a seed: the k-th is the same whichever were drawn before."""

    SUITES = ("c", "convergence", "python", "house")

    def __init__(self, tree, options):
        self.tree, self.seed, self.places = tree, options.seed, places(options.within)
        chosen = options.suite or self.SUITES
        self.rank, self.limits, self.caught = {}, {}, collections.Counter()
        for name, (test, _) in tree.tests.items():
            suites = {suite.split(":")[1] for suite in test["suite"]}
            if "not-quick" not in suites and (found := suites.intersection(chosen)):
                self.rank[name] = self.SUITES.index(found.pop())
        for name in self.order(""):
            began = time.monotonic()
            if tree.first_to_fail([name], {}):
                sys.exit(f"{name} fails as the project is")
            self.limits[name] = max(options.limit, 5 * (time.monotonic() - began))
        self.objects = tree.objects()

    def order(self, file):
        """Return the tests: suite by suite, and those first that have caught most."""
        own = {f"{prefix}{Path(file).stem}" for prefix in ("", "py_")}
        return sorted(self.rank, key=lambda x: (self.rank[x], x not in own, -self.caught[x], x))

    def judge(self, k):
        """Return the name of the k-th change and which test catches it, or None."""
        dice = random.Random(f"{self.seed} {k}")
        while True:
            mutation = Drawn(self.places, dice)
            with self.tree.changed(mutation), contextlib.suppress(RuntimeError):
                self.tree.make(["floors"])  # the library
                if mutation.file.endswith(".py") or self.tree.objects() != self.objects:
                    break
        with self.tree.changed(mutation):
            try:
                caught = self.tree.first_to_fail(self.order(mutation.file), self.limits)
            except RuntimeError:
                caught = "the build"
        self.caught[caught] += 1
        return mutation.name, caught


def draw_all(options):
    """Draw changes, and print what becomes of each; the status of the program."""
    with tempfile.TemporaryDirectory(prefix="mutate-") as folder:
        quick = ("--buildtype=plain", "-Doptimization=1")
        draws, survived = Draws(Tree(Path(folder), quick), options), []
        for k in range(options.first, options.draw):
            began = time.monotonic()
            name, caught = draws.judge(k)
            if not caught:
                survived.append(k)
            print("  " if caught else "!!", f"{k}: {name}")
            what = f"caught by {caught}" if caught else "survives"
            print(f"     {what} ({time.monotonic() - began:.0f} s)", flush=True)
        print(f"seed {options.seed}: {len(survived)} of {options.draw - options.first} survive "
              f"{' '.join(map(str, survived))}")  # fmt: skip
    return int(bool(survived))


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-k", default="", metavar="PATTERN", help="only those that contain it")
    parser.add_argument("--jobs", type=int, default=1, help="copies of the tree at a time")
    parser.add_argument("--limit", type=float, default=20, help="seconds for a test, default 20; "
                        "more where it takes more than a third of them as the library is")
    parser.add_argument("--list", action="store_true", help="only show them, if they still apply")
    parser.add_argument("--draw", type=int, metavar="N", help="draw N small changes instead")
    parser.add_argument("--seed", type=int, default=random.randrange(10**6), help="of the draw")
    parser.add_argument("--from", dest="first", type=int, default=0, metavar="K",
                        help="continue the draw at number K")
    parser.add_argument("--within", nargs="+", default=["csrc", "include"], metavar="FOLDER",
                        help="folders or files to draw in; default csrc include")
    parser.add_argument("--suite", nargs="+", choices=Draws.SUITES,
                        help="suites that have to notice; default all of them")
    return parser.parse_args()


def read():
    """Return the mutations of the list."""
    table = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    return [
        Mutation(file, *row[:3], **(row[3] if row[3:] else {}))
        for file, rows in table.items() for row in rows
    ]  # fmt: skip


def main():
    options = arguments()
    if options.draw:
        return draw_all(options)
    try:
        mutations = [x for x in read() if options.k in x.name]
    except (OSError, ValueError) as error:
        return str(error)
    if options.list:
        print(*(x.name for x in mutations), f"{len(mutations)} mutations", sep="\n")
        return 0
    with tempfile.TemporaryDirectory(prefix="mutate-") as folder:
        trees, good = queue.Queue(), 0
        for i in range(options.jobs):
            (Path(folder) / str(i)).mkdir()
            trees.put(tree := Tree(Path(folder) / str(i)))
        broken, limits = set(), {}
        for name in sorted({name for x in mutations for name in x.tests}):
            began = time.monotonic()
            if tree.first_to_fail([name], {}):
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
