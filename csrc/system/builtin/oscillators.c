/* Oscillators that are coupled by a constraint, a potential, or the metric. */
#include "system/builtin/builtin.h"

#include <stdio.h>

/* v_x = -sum_i y_i v_zi with q = (x, y_1..y_pairs, z_1..z_pairs): mu = (1, 0..0, y_1..y_pairs) */
static inline void constraint_gears(size_t pairs, const double *q, const double *v, double *phi,
                                    double *phi_v, double *phi_q)
{
    const double *y = q + 1, *v_z = v + 1 + pairs;
    if (phi) phi[0] = v[0];
    if (phi_v) phi_v[0] = 1.0;
    if (phi_q) phi_q[0] = 0.0;
    for (size_t i = 0; i < pairs; i++) {
        if (phi) phi[0] += y[i] * v_z[i];
        if (phi_v) {
            phi_v[1 + i] = 0.0;
            phi_v[1 + pairs + i] = y[i];
        }
        if (phi_q) {
            phi_q[1 + i] = v_z[i];
            phi_q[1 + pairs + i] = 0.0;
        }
    }
}

/* ---- contact_oscillator (McLachlan & Perlmutter): q = (x, y, z), mu = (1, 0, y) ---------- */

/* Energy 3/2, of which H_y = 1/2. */
static void contact_oscillator_state(const double *p, double *x)
{
    const double z = -sqrt(0.5);
    set3(x, sqrt((2.0 - z * z) / (1.0 + p[0] * z * z)), 1.0, z);
}

/* V = (x^2 + y^2 + z^2 + eps x^2 z^2)/2 */
POTENTIAL(contact_oscillator_potential)
{
    const double *p = ctx, eps = p[0], x = q[0], y = q[1], z = q[2];
    if (V) *V = (x * x + y * y + (1.0 + eps * x * x) * z * z) / 2;
    if (V_q) set3(V_q, x * (1.0 + eps * z * z), y, z * (1.0 + eps * x * x));
    const double V_xz = 2 * eps * x * z;
    if (V_qq)
        set(V_qq, 9, (double[]){1.0 + eps * z * z, 0.0, V_xz,
                                0.0, 1.0, 0.0,
                                V_xz, 0.0, 1.0 + eps * x * x});
    return 0;
}

CONSTRAINT(contact_oscillator_constraint)
{
    constraint_gears(1, q, v, phi, phi_v, phi_q);
    return 0;
}

/* The driver y is free; so its energy and that of the pair (x, z), v_x = -y v_z, are constant. */
INVARIANT(contact_oscillator_invariant)
{
    const double *p = ctx, eps = p[0];
    const double xx = x[0] * x[0], yy = x[1] * x[1], zz = x[2] * x[2];
    values[0] = (x[4] * x[4] + yy) / 2;
    values[1] = (xx + (1.0 + eps * xx) * zz + (1.0 + yy) * x[5] * x[5]) / 2;
    return 0;
}

const builtin dal__contact_oscillator = {
    .name = "contact_oscillator",
    .help = "oscillators x, z with coupling eps x^2 z^2, v_x = -y v_z driven by oscillator y",
    .description = "Two oscillators x and z, coupled by the constraint and by a term of size eps "
                   "in the potential. The ratio y of the gearbox between them is a free "
                   "oscillator. The initial energy is 3/2, of which y has 1/2.",
    .source = "R. McLachlan, M. Perlmutter: Integrators for nonholonomic mechanical systems, "
              "J. Nonlinear Sci. 16 (2006) 283-328",
    .formulas = "L = (v_x^2 + v_y^2 + v_z^2)/2 - (x^2 + y^2 + z^2 + eps x^2 z^2)/2\n"
                "v_x + y v_z = 0",
    .m = 1, .coordinates = {"x", "y", "z"},
    .parameters = {{"eps", 0.0, NOT_NEGATIVE}},
    .state = contact_oscillator_state,
    .potential = contact_oscillator_potential,
    .constraint = contact_oscillator_constraint, .steady = DAL_STEADY_PROVED,
    .invariants = {"(v_y^2 + y^2)/2", "(x^2 + (1 + eps x^2) z^2 + (1 + y^2) v_z^2)/2"},
    .invariant = contact_oscillator_invariant,
};

/* ---- chaotic (McLachlan & Perlmutter): q = (x, y_1..y_pairs, z_1..z_pairs) --------------- */

static size_t chaotic_pairs(const double *p) { return (size_t)p[0]; }

static void chaotic_sizes(const double *p, size_t *n, size_t *m)
{
    *n = 2 * chaotic_pairs(p) + 1;
    *m = 1;
}

/* x, y1, y2, ..., z1, z2, ... */
static void chaotic_coordinate(const double *p, size_t i, char text[NAME_SIZE])
{
    const size_t pairs = chaotic_pairs(p);
    if (i == 0) snprintf(text, NAME_SIZE, "x");
    else snprintf(text, NAME_SIZE, "%c%zu", i <= pairs ? 'y' : 'z', i <= pairs ? i : i - pairs);
}

/* The third of the ten initial data of energy 3.06 for three pairs, y_i = 3/5, 2/5, 1/5; with other
 * numbers of pairs the y_i go down to 0 in as many steps. */
static void chaotic_state(const double *p, double *x)
{
    const size_t pairs = chaotic_pairs(p), n = 2 * pairs + 1;
    const double angle = 0.34906585039886591538; /* pi/9 */
    x[0] = cos(angle);
    for (size_t i = 0; i < pairs; i++) {
        x[1 + i] = 3.0 * (double)(pairs - i) / (5.0 * (double)pairs);
        x[1 + pairs + i] = 1.0;
    }
    x[n + 1] = sin(angle);
}

/* V = (|q|^2 + z_1^2 z_2^2 + sum_i y_i^2 z_i^2)/2, without z_1^2 z_2^2 for a single pair. */
POTENTIAL(chaotic_potential)
{
    const size_t pairs = chaotic_pairs(ctx), n = 2 * pairs + 1;
    const double *y = q + 1, *z = y + pairs;
    const double z1 = pairs > 1 ? z[0] : 0.0, z2 = pairs > 1 ? z[1] : 0.0;
    if (V) {
        double sum = q[0] * q[0] + z1 * z1 * z2 * z2;
        for (size_t i = 0; i < pairs; i++) sum += y[i] * y[i] * (1.0 + z[i] * z[i]) + z[i] * z[i];
        *V = sum / 2;
    }
    if (V_q) {
        double *V_y = V_q + 1, *V_z = V_y + pairs;
        V_q[0] = q[0];
        for (size_t i = 0; i < pairs; i++) {
            V_y[i] = y[i] * (1.0 + z[i] * z[i]);
            V_z[i] = z[i] * (1.0 + y[i] * y[i]);
        }
        if (pairs > 1) {
            V_z[0] += z1 * z2 * z2;
            V_z[1] += z2 * z1 * z1;
        }
    }
    if (V_qq) {
        dal__clear(n * n, V_qq);
        V_qq[0] = 1.0;
        for (size_t i = 0; i < pairs; i++) {
            double *row_y = V_qq + (1 + i) * n, *row_z = row_y + pairs * n;
            row_y[1 + i] = 1.0 + z[i] * z[i];
            row_z[1 + pairs + i] = 1.0 + y[i] * y[i];
            row_y[1 + pairs + i] = row_z[1 + i] = 2 * y[i] * z[i];
        }
        if (pairs > 1) {
            double *row = V_qq + (1 + pairs) * n, *next = row + n;
            row[1 + pairs] += z2 * z2;
            next[2 + pairs] += z1 * z1;
            row[2 + pairs] = next[1 + pairs] = 2 * z1 * z2;
        }
    }
    return 0;
}

CONSTRAINT(chaotic_constraint)
{
    constraint_gears(chaotic_pairs(ctx), q, v, phi, phi_v, phi_q);
    return 0;
}

const builtin dal__chaotic = {
    .name = "chaotic",
    .help = "chaotic quartic oscillator with v_x = -sum y_i v_zi; 2 pairs + 1 coordinates",
    .description = "Oscillators `x`, `y_i` and `z_i` with i = 1, ..., pairs, coupled by quartic "
                   "terms; without the term `z1^2 z2^2` for a single pair. The initial data are "
                   "one of the ten sets of energy 3.06 that the source has for three pairs.",
    .source = "R. McLachlan, M. Perlmutter: Integrators for nonholonomic mechanical systems, "
              "J. Nonlinear Sci. 16 (2006) 283-328",
    .formulas = "L = (v_x^2 + sum_i(v_y_i^2 + v_z_i^2))/2 - (x^2 + z1^2 z2^2 + sum_i(y_i^2 + z_i^2 "
                "+ y_i^2 z_i^2))/2\n"
                "v_x + sum_i(y_i v_z_i) = 0",
    .sizes = chaotic_sizes, .coordinate = chaotic_coordinate,
    .parameters = {{"pairs", 3.0, WHOLE, 1000}},
    .state = chaotic_state,
    .potential = chaotic_potential,
    .constraint = chaotic_constraint, .steady = DAL_STEADY_PROVED,
};

/* ---- genmass: q = (q1, q2, q3), a Lagrangian in which nothing vanishes -------------------- */

/* L = v^T M v/2 + b v - V with
 * M = [2 + q2^2/4, q3/5, 1/10; q3/5, 3/2 + cos(q1)/3, q1/6; 1/10, q1/6, 1 + q1^2/3],
 * b = (q2 q3/4, sin(q1)/3, -q1 q2/5), V = (q1^2 + 2 q2^2 + 3 q3^2/2)/2 + q1^4/4 + q1 q2 q3/5 */
LAGRANGIAN(genmass_lagrangian)
{
    const double q1 = q[0], q2 = q[1], q3 = q[2], v1 = v[0], v2 = v[1], v3 = v[2];
    const double s = sin(q1) / 3, c = cos(q1) / 3;
    const double M11 = 2 + q2 * q2 / 4, M22 = 1.5 + c, M33 = 1 + q1 * q1 / 3;
    const double M12 = q3 / 5, M13 = 0.1, M23 = q1 / 6;
    const double b1 = q2 * q3 / 4, b2 = s, b3 = -q1 * q2 / 5;
    if (L) {
        const double V = (q1 * q1 + 2 * q2 * q2 + 1.5 * q3 * q3) / 2 + q1 * q1 * q1 * q1 / 4
            + q1 * q2 * q3 / 5;
        *L = (M11 * v1 * v1 + M22 * v2 * v2 + M33 * v3 * v3) / 2 + M12 * v1 * v2 + M13 * v1 * v3
            + M23 * v2 * v3 + b1 * v1 + b2 * v2 + b3 * v3 - V;
    }
    if (L_q)
        set3(L_q,
             -s * v2 * v2 / 2 + v2 * v3 / 6 + q1 * v3 * v3 / 3 + c * v2 - q2 * v3 / 5
                 - q1 - q1 * q1 * q1 - q2 * q3 / 5,
             q2 * v1 * v1 / 4 + q3 * v1 / 4 - q1 * v3 / 5 - 2 * q2 - q1 * q3 / 5,
             v1 * v2 / 5 + q2 * v1 / 4 - 1.5 * q3 - q1 * q2 / 5);
    if (L_v)
        set3(L_v, M11 * v1 + M12 * v2 + M13 * v3 + b1, M12 * v1 + M22 * v2 + M23 * v3 + b2,
             M13 * v1 + M23 * v2 + M33 * v3 + b3);
    if (L_qq) {
        const double L_12 = -v3 / 5 - q3 / 5, L_13 = -q2 / 5, L_23 = v1 / 4 - q1 / 5;
        set3(L_qq, -c * v2 * v2 / 2 + v3 * v3 / 3 - s * v2 - 1 - 3 * q1 * q1, L_12, L_13);
        set3(L_qq + 3, L_12, v1 * v1 / 4 - 2, L_23);
        set3(L_qq + 6, L_13, L_23, -1.5);
    }
    if (L_vq) {
        set3(L_vq, 0.0, q2 * v1 / 2 + q3 / 4, v2 / 5 + q2 / 4);
        set3(L_vq + 3, -s * v2 + v3 / 6 + c, 0.0, v1 / 5);
        set3(L_vq + 6, v2 / 6 + 2 * q1 * v3 / 3 - q2 / 5, -q1 / 5, 0.0);
    }
    if (L_vv) {
        set3(L_vv, M11, M12, M13);
        set3(L_vv + 3, M12, M22, M23);
        set3(L_vv + 6, M13, M23, M33);
    }
    return 0;
}

/* mu = (-q2, q1/2 + q3/4, 1 + q1^2/5) */
CONSTRAINT(genmass_constraint)
{
    const double mu[3] = {-q[1], q[0] / 2 + q[2] / 4, 1 + q[0] * q[0] / 5};
    if (phi) phi[0] = dal__dot(3, mu, v);
    if (phi_v) set(phi_v, 3, mu);
    if (phi_q) set3(phi_q, v[1] / 2 + 2 * q[0] * v[2] / 5, -v[0], v[1] / 4);
    return 0;
}

const builtin dal__genmass = {
    .name = "genmass",
    .help = "a general system: full mass matrix M(q), gyroscopic terms b(q) v, quartic potential",
    .description = "Not a mechanism but a Lagrangian in which no term vanishes, for tests of "
                   "general statements. It has a full mass matrix that depends on the coordinates, "
                   "terms linear in the velocities, and a quartic potential.",
    .source = "constructed for the tests of this library",
    .formulas = "L = ((2 + q2^2/4) v_q1^2 + (3/2 + cos(q1)/3) v_q2^2 + (1 + q1^2/3) v_q3^2)/2 "
                "+ q3 v_q1 v_q2/5 + v_q1 v_q3/10 + q1 v_q2 v_q3/6 "
                "+ q2 q3 v_q1/4 + sin(q1) v_q2/3 - q1 q2 v_q3/5 - V\n"
                "-q2 v_q1 + (q1/2 + q3/4) v_q2 + (1 + q1^2/5) v_q3 = 0\n"
                "where V = (q1^2 + 2 q2^2 + 3 q3^2/2)/2 + q1^4/4 + q1 q2 q3/5",
    .m = 1, .coordinates = {"q1", "q2", "q3"},
    .start = {0.4, -0.3, 0.2, 0.6, 0.5, -305.0 / 1032},
    .lagrangian = genmass_lagrangian,
    .constraint = genmass_constraint,
};
