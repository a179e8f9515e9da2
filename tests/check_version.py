"""The version is what the tags of git say, wherever the tree came from.

Usage: ``python check_version.py SOURCE_ROOT``

Repositories with few commits and the version.py of the tree are cloned, archived and copied.  Also:
CHANGELOG.md and CITATION.cff have the same newest release, and a tree with the tag of a release is
that one.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

NAMES = ("version.py", ".gitattributes")
CHANGES = "# Changelog\n\n## [Unreleased]\n\n## [1.2.3] - 2030-12-31\n\n## [1.2.2] - 2030-01-01\n"
# In the order of PEP 440, which pip, pkg-config and meson have in common for these.
FORM = re.compile(r"\d+\.\d+\.\d+(\+(\d+\.)?(g[0-9a-f]{7,}|unknown))?")
QUIET = {
    "GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1", "PATH": os.environ["PATH"],
    "GIT_AUTHOR_NAME": "a", "GIT_AUTHOR_EMAIL": "a@b", "GIT_COMMITTER_NAME": "a",
    "GIT_COMMITTER_EMAIL": "a@b",
}  # fmt: skip


def git(folder: Path, *words: str) -> bytes:
    done = subprocess.run(["git", *words], cwd=folder, env=QUIET, capture_output=True)
    if done.returncode:
        sys.exit(f"git {' '.join(words)}: {done.stderr.decode()}")
    return done.stdout


def version(folder: Path, **env: str) -> str:
    """Return what version.py in a folder prints."""
    done = subprocess.run(
        [sys.executable, folder / "version.py"], capture_output=True, text=True,
        env={"PATH": QUIET["PATH"]} | env,
    )  # fmt: skip
    return (done.stdout + done.stderr).strip()


def make(folder: Path, source: Path) -> Path:
    """Make a repository of one commit."""
    folder.mkdir()
    for name in NAMES:
        shutil.copy(source / name, folder)
    (folder / "CHANGELOG.md").write_text(CHANGES)
    git(folder, "init", "--quiet")
    git(folder, "add", ".")
    git(folder, "commit", "--quiet", "-m", "one")
    return folder


def archive(repository: Path, folder: Path) -> Path:
    """Unpack what `git archive` writes, as meson dist does for an sdist."""
    folder.mkdir()
    subprocess.run(["tar", "x"], cwd=folder, input=git(repository, "archive", "HEAD"), check=True)
    return folder


def clone(repository: Path, folder: Path, *words: str) -> Path:
    git(repository, "clone", "--quiet", *words, repository.as_uri(), str(folder))
    return folder


def cases(work: Path, source: Path) -> list[tuple[str, str, str]]:
    """Return what each tree is, the version that it has to have, and the one that it has."""
    found = []

    def case(what: str, expected: str, folder: Path, **env: str) -> None:
        found.append((what, expected, version(folder, **env)))

    here = make(work / "repository", source)
    place = "g" + git(here, "rev-parse", "--short", "HEAD").decode().strip()
    case("no tag", f"1.2.3+{place}", here)
    case("an archive without a tag", f"1.2.3+{place}", archive(here, work / "a1"))
    git(here, "tag", "version-one")
    case("a tag that is no version", f"1.2.3+{place}", here)
    git(here, "tag", "v1.2.4")
    case("a tag", "1.2.4", here)
    case("an archive of a tag", "1.2.4", archive(here, work / "a2"))
    other = make(work / "other", source)
    case("GIT_DIR of another", "1.2.4", here, GIT_DIR=str(other / ".git"))
    for text in "two", "three":
        git(here, "commit", "--quiet", "--allow-empty", "-m", text)
    for tag in "as-submitted", "v2.0.0-rc1", "v3":
        git(here, "tag", tag)
    place = "g" + git(here, "rev-parse", "--short", "HEAD").decode().strip()
    case("commits after a tag", f"1.2.4+2.{place}", here)
    case("an archive after a tag", f"1.2.4+2.{place}", archive(here, work / "a3"))
    case("a clone", f"1.2.4+2.{place}", clone(here, work / "full"))
    case("a shallow clone", f"1.2.3+{place}", clone(here, work / "one", "--depth=1"))
    git(here, "worktree", "add", "--quiet", str(work / "tree"))
    case("a worktree", f"1.2.4+2.{place}", work / "tree")

    inner = here / "inner"
    shutil.copytree(source, inner, ignore=lambda folder, names: {*names} - {*NAMES})
    (inner / "CHANGELOG.md").write_text(CHANGES)
    case("a copy within another repository", "1.2.3+unknown", inner)
    nested = archive(here, here / "nested")
    case("an archive within another repository", f"1.2.4+2.{place}", nested)
    case("no git", "1.2.3+unknown", here, PATH=str(work))
    case("an archive, no git", f"1.2.4+2.{place}", nested, PATH=str(work))
    (inner / "CHANGELOG.md").write_text("# Changelog\n")
    found.append(("no release", "True", str("CHANGELOG.md has no heading" in version(inner))))
    return found


def releases(source: Path) -> str | None:
    """Compare the newest release in the changelog with that of the citation, and with a tag."""
    changes = (source / "CHANGELOG.md").read_text(encoding="utf-8")
    cited = (source / "CITATION.cff").read_text(encoding="utf-8")
    newest = re.search(r"^## \[(\d\S+)\] - (\S+)$", changes, re.MULTILINE)
    fields = dict(re.findall(r"^(version|date-released): (\S+)$", cited, re.MULTILINE))
    if newest is None or list(newest.groups()) != [*fields.values()]:
        return f"CHANGELOG.md begins with {newest and newest[0]}, and CITATION.cff has {fields}"
    own = version(source)
    if FORM.fullmatch(own) is None:
        return f"{own} is not of the form of a version"
    if "+" not in own and own != newest[1]:
        return f"the tag says {own}, and CHANGELOG.md {newest[1]}"
    return None


def main(root: str) -> str | None:
    source = Path(root)
    with tempfile.TemporaryDirectory() as folder:
        found = cases(Path(folder).resolve(), source)
    wrong = [f"{what}: expected {expected}, found {got}" for what, expected, got in found
             if got != expected]  # fmt: skip
    wrong += filter(None, [releases(source)])
    print(f"{len(found)} trees; this one is {version(source)}")
    return "\n".join(wrong) or None


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
