"""Build the site: ``python docs/build_site.py FOLDER [OPTION...]``, options of sphinx-build.

FOLDER/html has the pages.  What Sphinx and its extensions write among the sources goes to
FOLDER/source/docs, a copy of docs/; so nothing is written in the repository.  Links that stand
beside this copy lead to what lies beside docs/.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent


def mirror(target: Path) -> None:
    """Copy docs/ as far as it has changed, and make links to what lies beside it."""
    target.mkdir(parents=True, exist_ok=True)
    for path in DOCS.parent.iterdir():
        if path != DOCS and not (target / path.name).is_symlink():
            (target / path.name).symlink_to(path)
    here, listed = target / "docs", target / "copied"
    files = {
        path.relative_to(DOCS)
        for path in DOCS.rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    old = listed.read_text(encoding="utf-8").splitlines() if listed.exists() else []
    for name in set(map(Path, old)) - files:
        (here / name).unlink(missing_ok=True)
    for name in files:
        copy = here / name
        copy.parent.mkdir(parents=True, exist_ok=True)
        if not copy.exists() or copy.read_bytes() != (DOCS / name).read_bytes():
            shutil.copyfile(DOCS / name, copy)
    listed.write_text("\n".join(map(str, sorted(files))), encoding="utf-8")


def main(folder: str, *options: str) -> int:
    place = Path(folder).resolve()
    mirror(place / "source")
    command = [
        sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q", *options,
        "-d", place / "doctrees", place / "source" / "docs", place / "html",
    ]  # fmt: skip
    status = subprocess.run(command).returncode
    if status == 0:
        print(f"the site is {place / 'html' / 'index.html'}")
    return status


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
