/* Particles of mass 1 in space: the free one, on springs, in the Heisenberg group. */
#include "system/builtin/builtin.h"

/* V = (k1 x^2 + k2 y^2 + k3 z^2)/2 */
POTENTIAL(potential_springs)
{
    const double *k = ctx;
    if (V) *V = (k[0] * q[0] * q[0] + k[1] * q[1] * q[1] + k[2] * q[2] * q[2]) / 2;
    if (V_q) set3(V_q, k[0] * q[0], k[1] * q[1], k[2] * q[2]);
    if (V_qq) set(V_qq, 9, (double[]){k[0], 0.0, 0.0, 0.0, k[1], 0.0, 0.0, 0.0, k[2]});
    return 0;
}

/* ---- particle and particle_oscillator: q = (x, y, z), mu = (-y, 0, 1) ------------------- */

CONSTRAINT(particle_constraint)
{
    if (phi) phi[0] = v[2] - q[1] * v[0];
    if (phi_v) set3(phi_v, -q[1], 0.0, 1.0);
    if (phi_q) set3(phi_q, 0.0, -v[0], 0.0);
    return 0;
}

/* v_y = w and v_x s = c are constant, s = sqrt(1 + y^2); x1 - x0 = c (asinh y1 - asinh y0)/w and
 * z1 - z0 = c (s1 - s0)/w.  The difference of the asinh is asinh(y1 s0 - y0 s1) = asinh(w t r), and
 * r has a form without cancellation for y0, y1 of one sign and another for the rest. */
EXACT(particle_exact)
{
    (void)ctx;
    const double y0 = x0[1], w = x0[4], y1 = y0 + w * t;
    const double s0 = hypot(1.0, y0), s1 = hypot(1.0, y1), c = x0[3] * s0;
    double r = 1.0;
    if (y0 * y1 > 0.0) r = (y1 + y0) / (y1 * s0 + y0 * s1);
    else if (y0 != y1) r = (y1 * s0 - y0 * s1) / (y1 - y0);
    const double arc = w * t * r;
    x[0] = x0[0] + c * t * r * (arc == 0.0 ? 1.0 : asinh(arc) / arc);
    x[1] = y1;
    x[2] = x0[2] + c * t * ((y1 + y0) / (s0 + s1));
    set3(x + 3, c / s1, w, c / s1 * y1);
    return 0;
}

INVARIANT(particle_invariant)
{
    values[0] = x[4];
    values[1] = x[3] * hypot(1.0, x[1]);
    return 0;
}

INVARIANT(particle_oscillator_invariant)
{
    const double *k = ctx;
    values[0] = (x[4] * x[4] + k[1] * x[1] * x[1]) / 2;
    return 0;
}

const builtin dal__particle = {
    .name = "particle",
    .help = "free particle with v_z = y v_x",
    .description = "A particle of mass 1 in space that climbs as it moves along x, the more the "
                   "larger y is. It is the example of the paper on which this library is based.",
    .source = "R. M. Rosenberg: Analytical Dynamics of Discrete Systems, Plenum Press, 1977; "
              "L. Bates, J. Śniatycki: Nonholonomic reduction, Rep. Math. Phys. 32 (1993) 99-115",
    .formulas = "L = (v_x^2 + v_y^2 + v_z^2)/2\n"
                "v_z - y v_x = 0",
    .m = 1, .coordinates = {"x", "y", "z"},
    .start = {0.5, 0.3, -0.2, 1.0, 0.7, 0.3},
    .constraint = particle_constraint, .steady = DAL_STEADY_CONSTANT_RATE,
    .exact = particle_exact,
    .invariants = {"v_y", "v_x sqrt(1 + y^2)"}, .invariant = particle_invariant,
};

const builtin dal__particle_oscillator = {
    .name = "particle_oscillator",
    .help = "particle with v_z = y v_x on springs k1, k2, k3",
    .description = "The particle of `particle` on springs of stiffness k1, k2, k3 along x, y, z. "
                   "The oscillator y is free, and drives the rest.",
    .source = "J. Cortés, S. Martínez: Non-holonomic integrators, Nonlinearity 14 (2001) "
              "1365-1392; L. C. García-Naranjo, M. Vermeeren: Structure preserving "
              "discretization of time-reparametrized Hamiltonian systems with application to "
              "nonholonomic mechanics, J. Comput. Dyn. 8 (2021) 241-271",
    .formulas = "L = (v_x^2 + v_y^2 + v_z^2)/2 - (k1 x^2 + k2 y^2 + k3 z^2)/2\n"
                "v_z - y v_x = 0",
    .m = 1, .coordinates = {"x", "y", "z"},
    .parameters = {{"k1", 1.0, FINITE}, {"k2", 2.0, FINITE}, {"k3", 1.5, FINITE}},
    .start = {0.5, 0.3, -0.2, 1.0, 0.7, 0.3},
    .potential = potential_springs,
    .constraint = particle_constraint, .steady = DAL_STEADY_PROVED,
    .invariants = {"(v_y^2 + k2 y^2)/2"}, .invariant = particle_oscillator_invariant,
};

/* ---- heisenberg: q = (x, y, z), mu = (y, -x, 1) ------------------------------------------ */

CONSTRAINT(heisenberg_constraint)
{
    if (phi) phi[0] = q[1] * v[0] - q[0] * v[1] + v[2];
    if (phi_v) set3(phi_v, q[1], -q[0], 1.0);
    if (phi_q) set3(phi_q, -v[1], v[0], 0.0);
    return 0;
}

const builtin dal__heisenberg = {
    .name = "heisenberg",
    .help = "particle with v_z = x v_y - y v_x on springs k1, k2, k3",
    .description = "A particle of mass 1 on springs of stiffness k1, k2, k3; D is the contact "
                   "structure of the Heisenberg group. With k1 = k2 and k3 = 0 the constraint "
                   "takes no force.",
    .source = "R. W. Brockett: Control theory and singular Riemannian geometry, in: New Directions "
              "in Applied Mathematics, Springer, 1982; A. M. Bloch: Nonholonomic Mechanics and "
              "Control, Springer, 2003",
    .formulas = "L = (v_x^2 + v_y^2 + v_z^2)/2 - (k1 x^2 + k2 y^2 + k3 z^2)/2\n"
                "y v_x - x v_y + v_z = 0",
    .m = 1, .coordinates = {"x", "y", "z"},
    .parameters = {{"k1", 1.0, FINITE}, {"k2", 2.25, FINITE}, {"k3", 0.5, FINITE}},
    .start = {0.8, 0.2, 0.1, 0.3, 0.5, 0.34},
    .potential = potential_springs,
    .constraint = heisenberg_constraint,
};
