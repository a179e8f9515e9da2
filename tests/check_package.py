"""A package stands alone, and its metadata agree with each other.

Usage: ``python check_package.py PACKAGE``, in an environment in which PACKAGE, a wheel or an sdist,
is installed with the extra ``sym``; for a wheel best where no other GSL can be loaded.
"""

from __future__ import annotations

import ctypes
import sys
from importlib.metadata import distribution
from pathlib import Path

import dalembert as dal

PACKAGE = Path(dal.__file__).parent


def check_installed(package: Path) -> None:
    """Compare the name of ``package`` with what is installed here, and its licences."""
    installed = distribution("dalembert")
    name, version = package.name.removesuffix(".tar.gz").split("-")[:2]
    versions = {version, installed.version, dal.__version__}
    assert name == "dalembert" and len(versions) == 1, (package.name, versions)
    assert PACKAGE.is_relative_to(sys.prefix), f"{PACKAGE} is not that of the package"
    texts = {path.name: path.read_text() for path in installed.files
             if path.parent.name == "licenses"}  # fmt: skip
    assert texts.keys() == {"LICENSE", "NOTICE"}, texts.keys()
    assert "GNU GENERAL PUBLIC LICENSE\n                       Version 3" in texts["LICENSE"]
    assert "dalembert/gsl.txt" in texts["NOTICE"]
    assert installed.metadata["License-Expression"] == "GPL-3.0-or-later"


def check_tags(wheel: Path) -> None:
    """Compare the tags of ``wheel`` with what its metadata say."""
    _, _, python, abi, platform = wheel.stem.split("-")
    requires = distribution("dalembert").metadata["Requires-Python"]
    assert abi == "abi3", wheel
    assert requires == f">={python[2]}.{python[3:]}", f"{wheel.name} requires Python {requires}"
    assert platform.startswith("manylinux"), f"{wheel.name} runs on this machine only"


def check_functions() -> None:
    """Use the core, and what finds the header files that generated code needs."""
    arguments = {"q0": [0, 1, 0], "v0": [1, 1, 1], "h": 0.01, "t_end": 1}
    x, y, z = dal.coordinates("x y z")
    own = dal.System.from_sympy(L=(x.d**2 + y.d**2 + z.d**2) / 2, constraints=[z.d - y * x.d])
    runs = [dal.integrate(system, "midpoint", **arguments)
            for system in (dal.systems.particle(), own)]  # fmt: skip
    for run in runs:
        assert run.success and abs(run.residual).max() < 1e-13, run
    dal.integrate(own, "reference", **arguments)  # makes GSL work


def loaded_gsl() -> dict[str, Path]:
    """The files of GSL in this process."""
    lines = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    paths = {Path(line.split(maxsplit=5)[5]) for line in lines if "/" in line}
    return {path.name.split("-")[0]: path for path in paths if path.name.startswith("libgsl")}


def check_gsl() -> None:
    """The GSL in this process is the wheel's, and the wheel says where its source is."""
    found = loaded_gsl()
    assert found.keys() == {"libgsl", "libgslcblas"}, found
    for path in found.values():
        assert path.parent == PACKAGE.with_name("dalembert.libs"), f"{path} is not the wheel's"
    library = ctypes.CDLL(str(found["libgsl"]))
    release = ctypes.c_char_p.in_dll(library, "gsl_version").value.decode()
    source = f"https://ftp.gnu.org/gnu/gsl/gsl-{release}.tar.gz"
    assert source in (PACKAGE / "gsl.txt").read_text().split(), f"gsl.txt lacks {source}"


def main(name: str) -> None:
    package = Path(name)
    check_installed(package)
    check_functions()
    if package.suffix == ".whl":
        check_tags(package)
        check_gsl()
    print(f"{package.name}: in {PACKAGE}, with {sorted(map(str, loaded_gsl().values()))}")


if __name__ == "__main__":
    main(*sys.argv[1:])
