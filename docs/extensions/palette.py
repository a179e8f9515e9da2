"""The colours of the package as variables of the site, in its light and its dark theme."""

from __future__ import annotations

from pathlib import Path

from dalembert.show import palette
from sphinx.application import Sphinx


def add(app: Sphinx) -> None:
    """Write the style sheet."""
    folder = Path(app.doctreedir) / "palette"
    folder.mkdir(parents=True, exist_ok=True)
    text = "".join(
        f'html[data-theme="{theme}"] {{ {palette.variables(colours)} }}\n'
        for theme, colours in (("light", palette.LIGHT), ("dark", palette.DARK))
    )
    (folder / "palette.css").write_text(text, encoding="utf-8")
    app.config.html_static_path.append(str(folder))
    app.add_css_file("palette.css")


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("builder-inited", add)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
