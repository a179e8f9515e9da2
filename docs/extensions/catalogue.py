"""The catalogue of systems in the site: the pages of ``dalembert.pages`` with its navigation.

They are made anew where the package or the library is newer.  Words in raw HTML are found by the
search of Sphinx too.
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from sphinx.application import Sphinx

import dalembert

TITLE = "Catalogue of systems"


def body(page: str) -> str:
    """Return what stands below the heading of a page."""
    found = re.search(r"</h1>(.*)</body>", page, flags=re.S)
    assert found
    return found[1]


def raw(html: str) -> str:
    """Return HTML as a block of MyST, each part under a heading that the navigation knows."""
    first, *rest = re.split(r"<h2>(.*?)</h2>", html)
    parts = ["", f"{{raw}} html\n<div class='system'>{first}</div>\n"]
    for title, text in zip(rest[::2], rest[1::2]):
        parts += [f"## {title}\n\n", f"{{raw}} html\n<div class='system'>{text}</div>\n"]
    fence = "`" * 5
    return "".join(
        part if k % 2 == 0 else f"{fence}{part}{fence}\n\n" for k, part in enumerate(parts)
    )


def write(folder: Path) -> None:
    """Write the pages as sources of the site."""
    with tempfile.TemporaryDirectory() as place:
        index, *pages = dalembert.pages.write(place)
        folder.mkdir(exist_ok=True)
        for path in pages:
            text = f"# {path.stem}\n\n{raw(body(path.read_text(encoding='utf-8')))}"
            (folder / f"{path.stem}.md").write_text(text, encoding="utf-8")
        cards = body(index.read_text(encoding="utf-8"))
    names = "\n".join(path.stem for path in pages)
    text = f"`````{{raw}} html\n<div class='system'>{cards}</div>\n`````\n"
    text = f"# {TITLE}\n\n{text}\n```{{toctree}}\n:hidden:\n\n{names}\n```\n"
    (folder / "index.md").write_text(text, encoding="utf-8")


def generate(app: Sphinx) -> None:
    folder = Path(app.srcdir) / "catalogue"
    package = Path(dalembert.__file__).parent
    newest = max(
        path.stat().st_mtime
        for pattern in ("*.py", "*.html", "*.json", "*.so")
        for path in package.rglob(pattern)
    )
    index = folder / "index.md"
    if not index.exists() or index.stat().st_mtime < newest:
        write(folder)


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("builder-inited", generate)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
