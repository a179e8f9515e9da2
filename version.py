#!/usr/bin/env python3
"""Print the version of this tree; meson.build asks for it.

Tags of git are versions: v1.2.3 is 1.2.3, and the fifth commit after it 1.2.3+5.g1234abc.  Where
no tag is in reach, as in a shallow clone, the newest release in CHANGELOG.md stands for it:
1.2.3+g1234abc.  What `git archive` writes, an sdist too, has in ARCHIVE what git knew.  A copy
without git is 1.2.3+unknown.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

# See .gitattributes.
ARCHIVE = "$Format:%(describe:tags=true,match=v[0-9]*.[0-9]*.[0-9]*,exclude=*-*) %h$"
ROOT = Path(__file__).resolve().parent


def git(*words: str) -> str:
    """Return what git says of this folder, not of one around it; nothing where it fails."""
    env = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    env["GIT_CEILING_DIRECTORIES"] = str(ROOT.parent)
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, env=env, capture_output=True, text=True)
    except OSError:
        return ""
    return done.stdout.strip()


def version(described: str, commit: str, changes: str) -> str:
    """Return the version from ``git describe``, the commit and the text of the changelog."""
    if tagged := re.fullmatch(r"v(\d+\.\d+\.\d+)(?:-(\d+)-(g[0-9a-f]+))?", described):
        release, distance, place = tagged.groups()
        return f"{release}+{distance}.{place}" if distance else release
    newest = re.search(r"^## \[(\d+\.\d+\.\d+)\]", changes, re.MULTILINE)
    if newest is None:
        raise SystemExit("CHANGELOG.md has no heading of a release, as '## [1.2.3] - 2030-12-31'")
    return f"{newest[1]}+{f'g{commit}' if commit else 'unknown'}"


def main() -> None:
    if ARCHIVE.startswith("$"):
        described = git("describe", "--tags", "--match=v[0-9]*.[0-9]*.[0-9]*", "--exclude=*-*")
        commit = git("rev-parse", "--short", "HEAD")
    else:
        *rest, commit = ARCHIVE.split()
        described = " ".join(rest)
    print(version(described, commit, (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")))


if __name__ == "__main__":
    main()
