"""GSL: rk8pd, Prince-Dormand of order 8(9), called from C on the reduced ODE in C.

On the ODE for (q, v), and on that in a basis of D, which the motion cannot leave.
"""

from __future__ import annotations

import ctypes
import os
import shlex
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from common import Method, Missing, Refused, c_function, stopwatch
from problems import Ode, Problem

FLAGS = ["-O3", "-march=native", "-shared", "-fPIC"]


def methods(problem: Problem) -> Iterator[Method | Refused]:
    for ode in problem.odes:
        yield _method(ode)


def _method(ode: Ode) -> Method:
    with stopwatch() as compiled:
        library = _compile(ode)
    size = len(ode.symbols)
    pointer = ctypes.POINTER(ctypes.c_double)
    library.gsl_flow.argtypes = [ctypes.c_double, pointer, ctypes.c_size_t, pointer, pointer]

    def solve(tolerance: float, state: np.ndarray, times: np.ndarray) -> np.ndarray:
        states, y = np.empty((len(times) - 1, size)), ode.into(state)
        status = library.gsl_flow(tolerance, y.ctypes.data_as(pointer), len(times),
                                  times.ctypes.data_as(pointer),
                                  states.ctypes.data_as(pointer))  # fmt: skip
        if status != 0:
            raise RuntimeError("too many steps" if status == 11 else f"GSL says {status}")
        return ode.out_of(states)

    return Method(f"GSL rk8pd{ode.name}", "tolerance",
                  (1e-4, 1e-6, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-14), solve,
                  compiled[0])  # fmt: skip


def _compile(ode: Ode) -> ctypes.CDLL:
    """Write field.h, compile it with gsl_flow.c, and load what comes out."""
    gsl = os.environ.get("GSL_FLAGS") or _pkg_config()
    with tempfile.TemporaryDirectory() as directory:
        header, made = Path(directory, "field.h"), Path(directory, "flow.so")
        header.write_text(
            "#include <math.h>\n"
            f"enum {{ SIZE = {len(ode.symbols)} }};\n{c_function('field', ode)}"
        )
        command = [*shlex.split(os.environ.get("CC", "cc")), *FLAGS, f"-I{directory}",
                   str(Path(__file__).with_name("gsl_flow.c")), "-o", str(made),
                   *shlex.split(gsl), "-lm"]  # fmt: skip
        try:
            subprocess.run(command, check=True, capture_output=True, text=True)
        except FileNotFoundError:
            raise Missing("a C compiler is not installed") from None
        except subprocess.CalledProcessError as error:
            if "gsl" in error.stderr and ("No such file" in error.stderr
                                          or "cannot find" in error.stderr):  # fmt: skip
                raise Missing("GSL is not installed for compilers") from None
            raise RuntimeError(error.stderr) from None
        return ctypes.CDLL(str(made))


def _pkg_config() -> str:
    try:
        return subprocess.run([os.environ.get("PKG_CONFIG", "pkg-config"), "--cflags", "--libs",
                               "gsl"], check=True, capture_output=True,
                              text=True).stdout  # fmt: skip
    except (FileNotFoundError, subprocess.CalledProcessError):
        return "-lgsl -lgslcblas"
