"""The site is whole: its links lead somewhere, and it needs no network.

Usage: ``python check_site.py HTML``

- Every link inside leads to a page that is there, with the anchor that it names.
- No page loads anything from elsewhere: scripts, style sheets, pictures, fonts.
- Links to elsewhere are those listed here.
- Pictures say in words what they show.
- The name of a scheme in prose is no link.
- Every public name of the package, and every function of the headers, has an entry.
"""

from __future__ import annotations

import re
import sys
import zlib
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import dalembert

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "docs" / "extensions"))
import comments  # noqa: E402

ELSEWHERE = {"arxiv.org", "doi.org", "github.com"}
# A literal of the prose that docs/extensions/names.py has made a link.
LINKED = re.compile(
    r'<a (?![^>]*nav-link)[^>]*><code class="docutils literal [^>]*><span class="pre">([^<]*)<'
)
LOADS = {"script": "src", "img": "src", "link": "href", "source": "src", "iframe": "src"}
MODULES = ("plot", "report", "pages", "systems")  # whose __all__ is public too


class Page(HTMLParser):
    """The anchors of a page, its links, and what it loads."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors, self.links, self.loads = {""}, [], []
        self.silent: list[str] = []  # pictures without words, but for those beside a link
        self.text = path.read_text(encoding="utf-8")
        self.feed(self.text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        self.anchors |= {x for x in (given.get("id"), given.get("name")) if x}
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        source, shown = given.get("src") or "", given.get("alt") or ""
        if tag == "img" and "_images/" in source and not source.endswith("_thumb.png"):
            if len(shown) < 40 or "$" in shown:
                self.silent.append(f"{source} is described as {shown!r}")
        if given.get(LOADS.get(tag, "")):
            self.loads.append(given[LOADS[tag]])


def check_links(root: Path, pages: dict[Path, Page]) -> list[str]:
    """Follow what leads to a file; name what leads elsewhere."""
    wrong = []
    for path, page in pages.items():
        where = path.relative_to(root)
        for address in {*page.links, *page.loads}:
            parts = urlsplit(address)
            if parts.scheme == "data":
                continue
            if parts.scheme or parts.netloc:
                if address in page.loads:
                    wrong.append(f"{where} loads {address}")
                elif parts.hostname not in ELSEWHERE:
                    wrong.append(f"{where}: {address} leads elsewhere")
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if target.is_dir():
                target /= "index.html"
            if not target.is_file():
                wrong.append(f"{where}: there is no {address}")
            elif target in pages and unquote(parts.fragment) not in pages[target].anchors:
                wrong.append(f"{where}: {address} has no such anchor")
    for path in root.rglob("*.css"):
        for address in re.findall(r"(?:url\(|@import )[\"']?([^\"')]+)", path.read_text("utf-8")):
            if re.match(r"(https?:)?//", address):
                wrong.append(f"{path.relative_to(root)} loads {address}")
    return wrong


def check_schemes(root: Path, pages: dict[Path, Page]) -> list[str]:
    """Name the links from a scheme to a function of the same name."""
    schemes = {scheme.name for scheme in dalembert.schemes()}
    return [
        f"{path.relative_to(root)}: the scheme {name} is a link"
        for path, page in pages.items()
        for name in schemes.intersection(LINKED.findall(page.text))
    ]


def entries(root: Path) -> set[str]:
    """Return the names of the inventory."""
    packed = (root / "objects.inv").read_bytes().split(b"\n", 4)[4]
    return {line.split()[0] for line in zlib.decompress(packed).decode().splitlines()}


def check_names(found: set[str]) -> list[str]:
    """Name what is public and has no entry."""
    modules = {name: getattr(dalembert, name) for name in MODULES}
    wanted = {f"dalembert.{name}" for name in dalembert.__all__ if name not in modules}
    wanted -= {"dalembert.geometry"}  # its functions are methods of System
    for name, module in modules.items():
        wanted |= {f"dalembert.{name}.{one}" for one in module.__all__}
    for one in ("Study.plot", "Studies.plot", "Embedding.plot", "Ensemble.plot", "Study.show",
                "plot.animate", "plot.snapshots", "plot.bodies.Shape"):  # fmt: skip
        wanted.add(f"dalembert.{one}")
    for header in comments.HEADERS:
        wanted |= {x for entry in comments.read(header)[1] for x in entry.names}
    return [f"{name} has no entry" for name in sorted(wanted - found)]


def main(folder: str) -> str | None:
    root = Path(folder).resolve()
    pages = {path: Page(path) for path in root.rglob("*.html") if "_static" not in path.parts}
    wrong = check_links(root, pages) + check_names(entries(root))
    wrong += check_schemes(root, pages)
    wrong += [f"{path.relative_to(root)}: {x}" for path in pages for x in pages[path].silent]
    if not wrong:
        links = sum(len(page.links) for page in pages.values())
        print(f"{len(pages)} pages, {links} links")
    return "\n".join(sorted(set(wrong))) or None


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
