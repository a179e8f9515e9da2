"""The site works from a file: its search finds, and no page asks a network.

Usage: ``python check_search.py HTML [BROWSER]``, a Chromium, by default the one in the path.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

# What is typed, and a page among those that are found.
QUERIES = {
    "dal_stepper_new": "reference/c/runs.html",
    "convergence": "reference/python/studies.html",
    "Chaplygin sleigh": "catalogue/sleigh.html",
    "journal": "reference/files.html",
    # Words of the index of a page, which are not in its text.
    "crash": "howto/journal.html",
    "step length": "howto/steps.html",
    "license": "howto/cite.html",
}


def main(folder: str, browser: str | None = None) -> str | None:
    root, wrong = Path(folder).resolve(), []
    asked: list[str] = []
    with sync_playwright() as play:
        path = browser or shutil.which("chromium") or shutil.which("chromium-browser")
        page = play.chromium.launch(executable_path=path, args=["--no-sandbox"]).new_page()
        page.on("request", lambda x: asked.append(x.url))
        for query, wanted in QUERIES.items():
            page.goto((root / "index.html").as_uri())
            page.keyboard.press("Control+k")
            page.keyboard.type(query)
            page.keyboard.press("Enter")
            page.wait_for_selector("#search-results p.search-summary", timeout=20_000)
            page.wait_for_timeout(1000)
            found = page.eval_on_selector_all("#search-results li a", "all => all.map(a => a.href)")
            if not any(wanted in address for address in found):
                wrong.append(f"{query!r} finds {found}, not {wanted}")
    wrong += [f"asked for {x}" for x in asked if not x.startswith(("file:", "data:"))]
    if not wrong:
        print(f"{len(QUERIES)} searches, {len(asked)} files")
    return "\n".join(wrong) or None


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
