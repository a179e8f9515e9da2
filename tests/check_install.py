"""What `meson install` gives a C user: library, header and dalembert.pc, and programs that build.

Usage: ``python check_install.py BUILD VERSION README MESON COMPILER... -- EXAMPLE.c...``

Installs into a temporary directory, then does what the README tells a C user to do with its own
program and the examples: ``cc example.c $(pkg-config --cflags --libs dalembert)``, and runs the
result.  All name the same version.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path


PRINT_VERSION = """#include <dalembert.h>
#include <stdio.h>
int main(void) { return puts(dal_version()) < 0; }
"""


def output(command: list[str], **options) -> str:
    """Run ``command``; its standard output.  On failure the check ends with what it printed."""
    done = subprocess.run(command, capture_output=True, text=True, **options)
    if done.returncode:
        printed = done.stdout + done.stderr
        sys.exit(f"{shlex.join(command)}: exit status {done.returncode}\n{printed}")
    return done.stdout


def only(root: Path, name: str) -> Path:
    """The one file called ``name`` under ``root``."""
    found = [path for path in root.rglob(name)]
    if len(found) != 1:
        sys.exit(f"expected one {name} among the installed files, found {found}")
    return found[0]


def blocks(page: Path) -> list[str]:
    """The programs in C in a page."""
    found = re.findall(r"^```c\b[^\n]*\n(.*?)^```$", page.read_text(encoding="utf-8"), re.M | re.S)
    return found or sys.exit(f"{page} has no block of C")


def main(build: str, version: str, readme: str, meson: str, *rest: str) -> None:
    split = rest.index("--")
    compiler, examples = list(rest[:split]), list(rest[split + 1 :])
    pkg_config = os.environ.get("PKG_CONFIG", "pkg-config")
    with tempfile.TemporaryDirectory() as directory:
        root = Path(directory)
        output([meson, "install", "-C", build, "--no-rebuild", "--tags", "runtime,devel",
                "--destdir", directory])
        only(root, "dalembert.h")
        only(root, "kernel.h")
        only(root, "libdalembert.a")
        library = only(root, "libdalembert.so.0")
        soname = re.search(r"SONAME.*\[(.*)\]", output(["readelf", "--dynamic", str(library)]))
        if soname is None or soname[1] != "libdalembert.so.0":
            sys.exit(f"{library}: expected soname libdalembert.so.0, found {soname and soname[1]}")

        env = dict(os.environ)
        for variable, path in (("PKG_CONFIG_PATH", only(root, "dalembert.pc").parent),
                               ("LD_LIBRARY_PATH", library.parent)):
            env[variable] = os.pathsep.join(filter(None, [str(path), env.get(variable)]))
        flags = output([pkg_config, "--cflags", "--libs", "dalembert"], env=env).split()
        kernel = root / "own_kernel.c"
        kernel.write_text("#define DAL_KERNEL own_kernel\n#include <dalembert/kernel.h>\n")
        output([*compiler, "-c", str(kernel), "-o", str(root / "own_kernel.o"), *flags], env=env)
        programs = [PRINT_VERSION, *blocks(Path(readme))]
        for k, text in enumerate(programs):
            path = root / f"program-{k}.c"
            path.write_text(text, encoding="utf-8")
            examples.append(str(path))
        for example in examples:
            program = str(root / Path(example).stem)
            output([*compiler, "-Wall", "-Werror", example, "-o", program, *flags], env=env)
            output([program], env=env, cwd=directory)
            print(f"{Path(example).name}: built and run")
        found = [output([str(root / "program-0")], env=env).strip(),
                 output([pkg_config, "--modversion", "dalembert"], env=env).strip()]
        if found != [version, version]:
            sys.exit(f"expected version {version}, found {found} of the library and dalembert.pc")


if __name__ == "__main__":
    main(*sys.argv[1:])
