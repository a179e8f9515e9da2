"""The wheel stands alone: it brings its own GSL, and its metadata agree with each other.

Usage: ``python check_wheel.py WHEEL``, in an environment in which WHEEL is installed with the
extra ``sym``, best where no other GSL can be loaded.
"""

from __future__ import annotations

import sys
from importlib.metadata import distribution
from pathlib import Path

import dalembert as dal


def check_metadata(wheel: Path) -> None:
    """Compare the tags of ``wheel`` with what its metadata say."""
    name, version, python, abi, platform = wheel.stem.split("-")
    installed = distribution(name)
    major, minor = python[2], python[3:]
    assert (name, version, abi) == ("dalembert", dal.__version__, "abi3"), wheel
    assert installed.metadata["Requires-Python"] == f">={major}.{minor}", (
        f"{wheel.name} requires Python {installed.metadata['Requires-Python']}"
    )
    assert platform.startswith("manylinux"), f"{wheel.name} runs on this machine only"
    licenses = {path.name for path in installed.files if path.parent.name == "licenses"}
    assert licenses == {"LICENSE", "NOTICE"}, licenses


def check_functions() -> None:
    """Use the core, and what finds the header files that generated code needs."""
    arguments = {"q0": [0, 1, 0], "v0": [1, 1, 1], "h": 0.01, "t_end": 1}
    x, y, z = dal.coordinates("x y z")
    own = dal.System.from_sympy(L=(x.d**2 + y.d**2 + z.d**2) / 2, constraints=[z.d - y * x.d])
    runs = [dal.integrate(system, "midpoint", **arguments)
            for system in (dal.systems.particle(), own)]
    for run in runs:
        assert run.success and abs(run.residual).max() < 1e-13, run
    dal.integrate(own, "reference", **arguments)  # makes GSL work


def loaded_gsl() -> set[Path]:
    """The files of GSL in this process."""
    lines = Path("/proc/self/maps").read_text(encoding="utf-8").splitlines()
    paths = {Path(line.split(maxsplit=5)[5]) for line in lines if "/" in line}
    return {path for path in paths if path.name.startswith("libgsl")}


def main(wheel: str) -> None:
    check_metadata(Path(wheel))
    check_functions()
    package = Path(dal.__file__).parent
    assert package.is_relative_to(sys.prefix), f"{package} is not the package of the wheel"
    found = loaded_gsl()
    for library in ("libgsl", "libgslcblas"):
        (path,) = [path for path in found if path.name.split("-")[0] == library]
        assert path.parent == package.with_name("dalembert.libs"), f"{path} is not the wheel's"
    assert len(found) == 2, found
    print(f"{Path(wheel).name}: {dal.__version__} in {package}, with {sorted(map(str, found))}")


if __name__ == "__main__":
    main(*sys.argv[1:])
