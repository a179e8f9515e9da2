"""Mirror the package into the build tree: what is listed, and no module that is not.

Usage: ``python mirror.py SOURCE TARGET STAMP FILE...``
"""

import shutil
import sys
from pathlib import Path

if __name__ == "__main__":
    source, target, stamp, *files = map(Path, sys.argv[1:])
    listed = {target / file.resolve().relative_to(source): file for file in files}
    for left in {path for path in target.rglob("*.py")} - listed.keys():
        left.unlink()
    for copy, file in listed.items():
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)
    stamp.touch()
