"""Examples do what they say.

Usage: ``python check_examples.py PROGRAM EXAMPLE.py [ARGUMENT...]``: a C example and its Python
twin print the same words and the same numbers.

Usage: ``python check_examples.py EXAMPLE.py``: a script finds what it expects, which its exit
status tells.

Both draw a picture, whose name is the last argument.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
from pathlib import Path

# Both run the same steps, but a compiler may contract or reorder the operations of an example's own
# functions: 1e4 steps of roundoff 1e-16 each, and a few digits to spare.
RELATIVE = 1e-9
ROUNDOFF = 1e-11  # numbers below are errors of roundoff, of which only the size is common


def output(*command: str) -> list[str]:
    """Run an example, which has to succeed; the words that it prints."""
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{command}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout.replace(",", " ").split()


def same(one: str, other: str) -> bool:
    """Compare two words: as numbers if both are."""
    if one == other:
        return True
    try:
        a, b = float(one), float(other)
    except ValueError:
        return False
    return math.isclose(a, b, rel_tol=RELATIVE, abs_tol=ROUNDOFF)


def numbers(words: list[str]) -> int:
    """Count the words with a digit."""
    return sum(any(c.isdigit() for c in word) for word in words)


def drawn(script: str, *arguments: str) -> list[str]:
    """Run a script that is to draw a picture too; the words that it prints."""
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "picture.png"
        words = output(sys.executable, script, *arguments, str(picture))
        if not picture.read_bytes().startswith(b"\x89PNG"):
            sys.exit(f"{script}: the picture is no PNG")
    return words


def alone(script: str) -> str | None:
    """Run a script without a twin."""
    words = drawn(script)
    if numbers(words) == 0:
        return f"{script} prints no number"
    print(f"{numbers(words)} numbers")
    return None


def twins(program: str, script: str, *arguments: str) -> str | None:
    """Compare what a C program and its Python twin print."""
    in_c = output(str(Path(program).resolve()))
    in_python = drawn(script, *arguments)
    for k, (one, other) in enumerate(zip(in_c, in_python)):
        if not same(one, other):
            return f"word {k}: {program} prints {one!r}, {script} prints {other!r}"
    if len(in_c) != len(in_python):
        return f"{program} prints {len(in_c)} words, {script} prints {len(in_python)}"
    if numbers(in_c) == 0:
        return f"{program} prints no number"
    print(f"{numbers(in_c)} numbers agree")
    return None


if __name__ == "__main__":
    sys.exit(alone(*sys.argv[1:]) if len(sys.argv) == 2 else twins(*sys.argv[1:]))
