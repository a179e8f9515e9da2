"""The colours of all plots and pages, on white paper and on dark pages.

The colours of lines are those of Okabe and Ito without the yellow, which is too light on white.
Each has a name, which is also the name of a variable in style sheets.
"""

from __future__ import annotations

from collections.abc import Mapping

LINES = {
    "blue": "#0072b2", "vermilion": "#d55e00", "green": "#009e73", "purple": "#cc79a7",
    "orange": "#e69f00", "sky": "#56b4e9",
}  # fmt: skip
LINES_ON_DARK = {
    "blue": "#2f90d6", "vermilion": "#ff8a3d", "green": "#2fc79b", "purple": "#ee9fca",
    "orange": "#ffb52e", "sky": "#8fd0f5",
}  # fmt: skip
BLACK = "#000000"
COLOURS = (*LINES.values(), BLACK)
PAPER = "#ffffff"
GROUND = "#d1d1d1"  # of films, and of maps where nothing has happened
FAILED = "#888888"

# The variables of style sheets; a page of either kind has all of them.
LIGHT = LINES | {
    "paper": PAPER, "ink": "#1a1a1a", "quiet": "#666666", "line": "#bbbbbb", "rule": "#e6e6e6",
    "faint": "#f4f4f2", "ground": GROUND, "bar": "#404040", "good": "#007700", "bad": "#aa1111",
}  # fmt: skip
DARK = LINES_ON_DARK | {
    "paper": "#16181b", "ink": "#e8e8e8", "quiet": "#a0a4a8", "line": "#4b4f55", "rule": "#2a2d31",
    "faint": "#22252a", "ground": "#4a4e54", "bar": "#c8c8c8", "good": "#7fd48a", "bad": "#ff8a80",
}  # fmt: skip


def variables(colours: Mapping[str, str]) -> str:
    """Return the declarations of colours for a style sheet."""
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())
