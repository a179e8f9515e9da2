"""C functions as callbacks: of numba, ctypes, cffi and SciPy; at C speed, no Python in the step."""

import ctypes
import gc
import pickle
import weakref

import cffi
import numba
import numpy as np
import pytest
import scipy

import dalembert as dal
from dalembert import compiler
from dalembert.core import pointers

SOURCE = r"""
#include <math.h>
int constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
               double *phi_q, double *phi_t, void *ctx)
{
    (void)t, (void)phi_t, (void)ctx;
    if (phi) phi[0] = v[2] - q[1] * v[0];
    if (phi_v) { phi_v[0] = -q[1]; phi_v[1] = 0; phi_v[2] = 1; }
    if (phi_q) { phi_q[0] = 0; phi_q[1] = -v[0]; phi_q[2] = 0; }
    return 0;
}
int potential(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double *k = ctx;
    (void)t;
    if (V) *V = (k[0] * q[0] * q[0] + k[1] * q[1] * q[1] + k[2] * q[2] * q[2]) / 2;
    for (int i = 0; V_q && i < 3; i++) V_q[i] = k[i] * q[i];
    for (int i = 0; V_qq && i < 9; i++) V_qq[i] = i % 4 ? 0 : k[i / 4];
    return 0;
}
int drag(double t, const double *q, const double *v, const double *u, double *f, double *f_q,
         double *f_v, void *ctx)
{
    const double *k = ctx;
    (void)t, (void)q, (void)u;
    for (int i = 0; f && i < 3; i++) f[i] = -k[3] * v[i];
    for (int i = 0; f_q && i < 9; i++) f_q[i] = 0;
    for (int i = 0; f_v && i < 9; i++) f_v[i] = i % 4 ? 0 : -k[3];
    return 0;
}
int lagrangian(double t, const double *q, const double *v, double *L, double *L_q, double *L_v,
               double *L_qq, double *L_vq, double *L_vv, double *L_vt, void *ctx)
{
    const double *k = ctx;
    (void)t, (void)L_vt;
    if (L) *L = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - k[0] * q[0] * q[0] - k[1] * q[1] * q[1]
                 - k[2] * q[2] * q[2]) / 2;
    for (int i = 0; L_q && i < 3; i++) L_q[i] = -k[i] * q[i];
    for (int i = 0; L_v && i < 3; i++) L_v[i] = v[i];
    for (int i = 0; L_qq && i < 9; i++) L_qq[i] = i % 4 ? 0 : -k[i / 4];
    for (int i = 0; L_vq && i < 9; i++) L_vq[i] = 0;
    for (int i = 0; L_vv && i < 9; i++) L_vv[i] = i % 4 == 0;
    return 0;
}
int refuse(double t, const double *q, const double *v, double *phi, double *phi_v, double *phi_q,
           double *phi_t, void *ctx)
{
    if (q[0] > 1) return -1;
    return constraint(t, q, v, phi, phi_v, phi_q, phi_t, ctx);
}
"""
ARGUMENTS = {"constraint": 8, "potential": 6, "drag": 8, "lagrangian": 11, "refuse": 8}
START = {"q0": [0.5, 0.3, -0.2], "v0": [1.0, 0.7, 0.3]}
SPRINGS = np.array([1.0, 2.0, 1.5, 0.1])


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    found = compiler.find()
    assert found is not None, "these tests need a C compiler"
    path = tmp_path_factory.mktemp("pointers") / "own.so"
    path.write_bytes(compiler.compile_program(found, SOURCE, lambda line: ""))
    return path


def of_ctypes(library, name):
    function = getattr(ctypes.CDLL(str(library)), name)
    function.argtypes = [ctypes.c_double] + [ctypes.c_void_p] * (ARGUMENTS[name] - 1)
    return function


def of_cffi(library, name):
    ffi = cffi.FFI()
    signature = ["double"] + ["void *"] * (ARGUMENTS[name] - 1)
    ffi.cdef(f"int {name}({', '.join(signature)});")
    opened = ffi.dlopen(str(library))
    return ffi.addressof(opened, name)


def of_scipy(library, name, given=SPRINGS):
    ctx = ctypes.cast(ctypes.c_void_p(given.ctypes.data), ctypes.c_void_p)
    return scipy.LowLevelCallable(of_ctypes(library, name), ctx)


@pytest.mark.parametrize("make", [of_ctypes, of_cffi, of_scipy])
def test_same_run_as_the_built_in_system(library, make):
    """The same formulas in C: the same run as the library's own, but for roundings."""
    ctx = {} if make is of_scipy else {"ctx": SPRINGS}
    own = dal.System(
        mass=[1, 1, 1],
        potential=make(library, "potential"),
        constraint=make(library, "constraint"),
        m=1,
        steady=True,
        **ctx,
        **START,
    )
    assert (own.n, own.m, own.kind, own.differenced) == (3, 1, "linear", ())
    twin = dal.systems.particle_oscillator(k1=1, k2=2, k3=1.5)
    run = dal.integrate(own, "leapfrog", h=0.01, steps=500)
    expected = dal.integrate(twin, "leapfrog", START["q0"], START["v0"], h=0.01, steps=500)
    np.testing.assert_allclose(run.y, expected.y, rtol=0, atol=1e-14)
    np.testing.assert_allclose(run.reactions, expected.reactions, rtol=0, atol=1e-12)
    assert own.check()


def test_a_context_lives_as_long_as_the_system_in_c(library):
    springs = SPRINGS.copy()
    alive = weakref.ref(springs)
    own = dal.System(mass=[1, 1, 1], potential=of_ctypes(library, "potential"), ctx=springs)
    del springs
    gc.collect()
    assert alive() is not None
    handle = own._handle
    del own
    gc.collect()
    assert alive() is not None
    del handle
    gc.collect()
    assert alive() is None


def test_force_and_lagrangian(library, in_python):
    """The four callbacks together, against the same system from expressions."""
    x, y, z = dal.coordinates("x y z")
    T = (x.d**2 + y.d**2 + z.d**2) / 2
    twin = dal.System.from_sympy(
        T - x**2 / 2 - y**2 - 3 * z**2 / 4,
        [z.d - y * x.d],
        force={q: -q.d / 10 for q in (x, y, z)},
        **START,
    )
    by_mass = {"mass": [1, 1, 1], "potential": of_ctypes(library, "potential")}
    for energy in (by_mass, {"lagrangian": of_ctypes(library, "lagrangian"), "n": 3}):
        own = dal.System(
            **energy,
            constraint=of_ctypes(library, "constraint"),
            force=of_ctypes(library, "drag"),
            m=1,
            ctx=SPRINGS,
            **START,
        )
        assert own.is_forced and own.check()
        run = dal.integrate(own, "midpoint", h=0.01, steps=200)
        expected = dal.integrate(twin, "midpoint", h=0.01, steps=200)
        # each step is solved to roundoff: 200 of them, numbers of size 3
        np.testing.assert_allclose(run.y, expected.y, rtol=0, atol=200 * 64 * 2.0**-53)


def test_missing_outputs_are_differenced(library):
    own = dal.System(
        mass=[1, 1, 1],
        constraint=of_ctypes(library, "constraint"),
        m=1,
        missing=["phi_q"],
        **START,
    )
    assert own.differenced == ("mu_v_q",)
    given = dal.systems.particle()
    # phi_q is linear in q and v here: differences are exact but for roundoff
    np.testing.assert_allclose(
        own.multipliers(own.q0, own.v0), given.multipliers(own.q0, own.v0), rtol=1e-12
    )


def test_what_a_callback_returns_stops_the_run(library):
    own = dal.System(mass=[1, 1, 1], constraint=of_ctypes(library, "refuse"), m=1, **START)
    with pytest.raises(dal.DalembertError, match="constraint returned -1") as caught:
        dal.integrate(own, "midpoint", h=0.01, steps=1000)
    assert 10 < caught.value.step < 1000


def test_numba():
    """A cfunc has no Python in it, and gives the bits of C."""
    pointer = numba.types.CPointer(numba.types.double)
    wanted = pointers.numba_wanted()

    @numba.cfunc(numba.types.int32(numba.types.double, *[pointer] * 6, numba.types.voidptr))
    def constraint(t, q, v, phi, phi_v, phi_q, phi_t, ctx):
        if wanted(phi):
            phi[0] = v[2] - q[1] * v[0]
        if wanted(phi_v):
            phi_v[0] = -q[1]
            phi_v[1] = 0.0
            phi_v[2] = 1.0
        if wanted(phi_q):
            phi_q[0] = 0.0
            phi_q[1] = -v[0]
            phi_q[2] = 0.0
        return 0

    own = dal.System(mass=[1, 1, 1], constraint=constraint, m=1, steady=True, **START)
    run = dal.integrate(own, "midpoint", h=0.01, steps=500)
    expected = dal.integrate(dal.systems.particle(), "midpoint", *START.values(), h=0.01, steps=500)
    np.testing.assert_array_equal(run.y, expected.y)


def test_exact_and_invariants_stay_python(library):
    own = dal.System(
        mass=[1, 1, 1],
        constraint=of_ctypes(library, "constraint"),
        m=1,
        exact=dal.systems.particle().exact,
        invariants={"v_y": lambda q, v: v[1]},
        **START,
    )
    q, v = own.exact(2.0)
    run = dal.integrate(own, "leapfrog-kl8", h=0.05, t_end=2)
    # order 8 with h = 1/20 and 680 solved stages: roundoff is what is left
    np.testing.assert_allclose(run.q[-1], q, rtol=0, atol=1e-12)
    assert own.has_exact and own.invariant(q, v)["v_y"] == 0.7


def test_refused(library):
    constraint = of_ctypes(library, "constraint")
    good = {"mass": [1, 1, 1], "constraint": constraint, "m": 1}
    cases = [
        ({**good, "potential": of_ctypes(library, "drag")}, "8 arguments, expected the 6"),
        ({**good, "potential": lambda q: 0.0}, "together with the C function constraint"),
        ({**good, "mu": lambda q: [[1, 0, 0]]}, "together with the C function"),
        ({"mass": [1, 1, 1], "constraint": constraint}, "m = None"),
        ({"constraint": constraint, "m": 1, "n": 3}, "mass and lagrangian"),
        ({**good, "lagrangian": of_ctypes(library, "lagrangian")}, "mass and lagrangian"),
        ({**good, "kind": "cubic"}, "kind = 'cubic'"),
        ({**good, "missing": ["V"]}, "missing = 'V'"),
        ({**good, "ctx": "parameters"}, "ctx = 'parameters'"),
        ({**good, "ctx": True}, "ctx = True: expected an array, an address, or a pointer"),
        ({**good, "ctx": -1}, "ctx = -1: expected at least 0"),
        ({**good, "ctx": 2**64}, f"ctx = {2**64}: expected at most {2**64 - 1}"),
        ({**good, "ctx": SPRINGS[::2]}, "ctx: expected a contiguous array"),
        ({**good, "constraint": ctypes.CFUNCTYPE(ctypes.c_int)(0)}, "NULL"),
        (
            {**good, "constraint": of_scipy(library, "constraint"),
             "potential": of_scipy(library, "potential", SPRINGS.copy())},
            "ctx: the callbacks have different user_data",
        ),
        ({"mass": [1, 1], "kind": "linear"}, "expected C functions"),
        ({"mass": [1, 1], "ctx": 5}, "expected C functions"),
    ]
    for arguments, words in cases:
        with pytest.raises(ValueError, match=words):
            dal.System(**arguments)


def test_pointers_do_not_pickle(library):
    own = dal.System(mass=[1, 1, 1], constraint=of_ctypes(library, "constraint"), m=1)
    with pytest.raises(pickle.PicklingError, match="constraint"):
        pickle.dumps(own)
