"""Write the C source of the extension ``dalembert._core``.

Usage: ``python _ffi_build.py HEADER... _core.c``, with each header after those that it includes.

The declarations are the parts of the public headers between their cdef marks, so C and Python
cannot disagree.  Only the trampolines, through which C calls Python, are added here.
"""

from __future__ import annotations

import sys
from pathlib import Path

from cffi import FFI

OPENING, CLOSING = "/* <cdef> */", "/* </cdef> */"

TRAMPOLINES = """
extern "Python" int dal_py_potential(double t, const double *q, double *V, double *V_q,
                                     double *V_qq, void *ctx);
extern "Python" int dal_py_lagrangian(double t, const double *q, const double *v, double *L,
                                      double *L_q, double *L_v, double *L_qq, double *L_vq,
                                      double *L_vv, double *L_vt, void *ctx);
extern "Python" int dal_py_force(double t, const double *q, const double *v, const double *u,
                                 double *f, double *f_q, double *f_v, void *ctx);
extern "Python" int dal_py_linear(double t, const double *q, const double *v, double *phi,
                                  double *phi_v, double *phi_q, double *phi_t, void *ctx);
extern "Python" int dal_py_affine(double t, const double *q, const double *v, double *phi,
                                  double *phi_v, double *phi_q, double *phi_t, void *ctx);
extern "Python" int dal_py_nonlinear(double t, const double *q, const double *v, double *phi,
                                     double *phi_v, double *phi_q, double *phi_t, void *ctx);
extern "Python" int dal_py_driven_linear(double t, const double *q, const double *v,
                                         const double *u, double *phi, double *phi_v,
                                         double *phi_q, double *phi_t, void *ctx);
extern "Python" int dal_py_driven_affine(double t, const double *q, const double *v,
                                         const double *u, double *phi, double *phi_v,
                                         double *phi_q, double *phi_t, void *ctx);
extern "Python" int dal_py_driven_nonlinear(double t, const double *q, const double *v,
                                            const double *u, double *phi, double *phi_v,
                                            double *phi_q, double *phi_t, void *ctx);
extern "Python" int dal_py_deformation(double t, const double *q, const double *v, double *g,
                                       double *g_v, double *g_q, double *g_t, void *ctx);
extern "Python" int dal_py_exact(double t, const double *x0, double *x, void *ctx);
extern "Python" int dal_py_map(double h, const double *q0, const double *q1, double *g, double *f,
                               double *g_0, double *g_1, double *f_0, double *f_1, void *ctx);
extern "Python" int dal_py_watch(double t, void *ctx);
extern "Python" int dal_py_observer(size_t step, double t, const double *x, void *ctx);
extern "Python" int dal_py_control(size_t step, double t, const double *x, double *u, void *ctx);
extern "Python" int dal_py_event(double t, const double *x, double *g, void *ctx);
extern "Python" int dal_py_reset(double t, double *x, void *ctx);
extern "Python" int dal_py_law(double t, const double *x, double *values, void *ctx);
"""

# Macros whose values are no integers.
CONSTANTS = "static const double DAL_LARGE_ERROR;\n"

# For tests and benchmarks alone, as is what private headers have between the marks: the steps of a
# stepper are made by the compilation for any sizes.
FOR_TESTS = "void dal__beta_any_sizes(dal_stepper *stepper);\n"


def declarations(header: str) -> str:
    """Return the declarations between the cdef marks of ``header``, without the export macro.

    Raises
    ------
    ValueError
        Unless each of the two marks occurs exactly once, in order.
    """
    if header.count(OPENING) != 1 or header.count(CLOSING) != 1:
        raise ValueError(f"expected {OPENING} and {CLOSING} exactly once each")
    start, end = header.index(OPENING) + len(OPENING), header.index(CLOSING)
    if end < start:
        raise ValueError(f"expected {OPENING} before {CLOSING}")
    return header[start:end].replace("DAL_API ", "")


def write_extension(headers: list[Path], output: Path) -> None:
    """Write to ``output`` the C source of the extension for the functions of ``headers``.

    The source includes public headers, in the folder of the first or below it, not private ones.
    """
    ffi = FFI()
    root = headers[0].parent
    public = [header for header in headers if header.is_relative_to(root)]
    texts = {header: declarations(header.read_text(encoding="utf-8")) for header in headers}
    own = "".join(text for header, text in texts.items() if header not in public) + FOR_TESTS
    ffi.cdef("".join(texts[header] for header in public) + CONSTANTS + TRAMPOLINES + own)
    names = [header.relative_to(root) for header in public]
    ffi.set_source("dalembert._core", "".join(f"#include <{name}>\n" for name in names) + own)
    ffi.emit_c_code(str(output))


if __name__ == "__main__":
    *headers, output = map(Path, sys.argv[1:])
    write_extension(headers, output)
