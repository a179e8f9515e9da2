/* vector_systems.h - the systems of tests/data/vectors.json, written from the formulas and
 * parameters that stand there, and not from the library's own. */
#ifndef DALEMBERT_TESTS_VECTOR_SYSTEMS_H
#define DALEMBERT_TESTS_VECTOR_SYSTEMS_H

#include "generic4.h"

/* a[count] <- values; a NULL a is not wanted. */
static inline void vector_set(double *a, size_t count, const double *values)
{
    if (a) memcpy(a, values, count * sizeof *a);
}

/* V = (k1 x^2 + k2 y^2 + k3 z^2)/2 */
static inline void vector_springs(const double *k, const double *q, double *V, double *V_q,
                                  double *V_qq)
{
    if (V) *V = 0.5 * (k[0] * q[0] * q[0] + k[1] * q[1] * q[1] + k[2] * q[2] * q[2]);
    vector_set(V_q, 3, (double[]){k[0] * q[0], k[1] * q[1], k[2] * q[2]});
    vector_set(V_qq, 9, (double[]){k[0], 0.0, 0.0, 0.0, k[1], 0.0, 0.0, 0.0, k[2]});
}

/* One constraint in R^3: phi = mu v, with mu and d(mu v)/dq given. */
static inline void vector_form(const double *mu, const double *derivative, const double *v,
                               double *phi, double *phi_v, double *phi_q)
{
    if (phi) *phi = mu[0] * v[0] + mu[1] * v[1] + mu[2] * v[2];
    vector_set(phi_v, 3, mu);
    vector_set(phi_q, 3, derivative);
}

/* ---- particle, particle_osc: mu = (-y, 0, 1) --------------------------------------------- */

static inline int vector_particle_constraint(double t, const double *q, const double *v,
                                             double *phi, double *phi_v, double *phi_q,
                                             double *phi_t, void *ctx)
{
    vector_form((double[]){-q[1], 0.0, 1.0}, (double[]){0.0, -v[0], 0.0}, v, phi, phi_v, phi_q);
    return 0;
}

/* V = x^2/2 + y^2 + 3 z^2/4 */
static inline int vector_particle_osc_potential(double t, const double *q, double *V, double *V_q,
                                                double *V_qq, void *ctx)
{
    vector_springs((double[]){1.0, 2.0, 1.5}, q, V, V_q, V_qq);
    return 0;
}

/* ---- knife: V = -m gs x, mu = (sin theta, -cos theta, 0), m = 2, J = 3/4, gs = 5/2 -------- */

static inline int vector_knife_potential(double t, const double *q, double *V, double *V_q,
                                         double *V_qq, void *ctx)
{
    if (V) *V = -5.0 * q[0];
    vector_set(V_q, 3, (double[]){-5.0, 0.0, 0.0});
    vector_set(V_qq, 9, (double[9]){0.0});
    return 0;
}

static inline int vector_knife_constraint(double t, const double *q, const double *v, double *phi,
                                          double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    const double s = sin(q[2]), c = cos(q[2]);
    (void)ctx;
    vector_form((double[]){s, -c, 0.0}, (double[]){0.0, 0.0, c * v[0] + s * v[1]}, v, phi, phi_v,
                phi_q);
    return 0;
}

/* ---- sleigh: mu = (-sin theta, cos theta, -a), m = 3/2, J = 4/5, a = 2/5 ------------------ */

static inline int vector_sleigh_constraint(double t, const double *q, const double *v, double *phi,
                                           double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    const double s = sin(q[2]), c = cos(q[2]);
    (void)ctx;
    vector_form((double[]){-s, c, -0.4}, (double[]){0.0, 0.0, -c * v[0] - s * v[1]}, v, phi, phi_v,
                phi_q);
    return 0;
}

/* ---- disk: mu^1 = (1, 0, -R cos phi, 0), mu^2 = (0, 1, -R sin phi, 0), R = 7/10 ------------ */

static inline int vector_disk_constraint(double t, const double *q, const double *v, double *phi,
                                         double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    const double R = 0.7, s = sin(q[3]), c = cos(q[3]);
    (void)ctx;
    vector_set(phi, 2, (double[]){v[0] - R * c * v[2], v[1] - R * s * v[2]});
    vector_set(phi_v, 8, (double[]){1.0, 0.0, -R * c, 0.0, 0.0, 1.0, -R * s, 0.0});
    vector_set(phi_q, 8, (double[]){0.0, 0.0, 0.0, R * s * v[2], 0.0, 0.0, 0.0, -R * c * v[2]});
    return 0;
}

/* ---- heis: V = (x^2 + 9/4 y^2 + z^2/2)/2, mu = (y, -x, 1) ---------------------------------- */

static inline int vector_heis_potential(double t, const double *q, double *V, double *V_q,
                                        double *V_qq, void *ctx)
{
    vector_springs((double[]){1.0, 2.25, 0.5}, q, V, V_q, V_qq);
    return 0;
}

static inline int vector_heis_constraint(double t, const double *q, const double *v, double *phi,
                                         double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    vector_form((double[]){q[1], -q[0], 1.0}, (double[]){-v[1], v[0], 0.0}, v, phi, phi_v, phi_q);
    return 0;
}

/* ---- the table --------------------------------------------------------------------------- */

/* ---- sleigh_contact, genmass: L = v^T M(q) v / 2 + b(q) v - V(q) in R^3 ------------------- */

/* M, b, V at a point and their derivatives: M_q[j] = dM/dq_j, M_qq[j][k], b_q[i][j] = db_i/dq_j,
 * b_qq[i][j][k] = d2b_i/dq_j dq_k. */
typedef struct vector_metric {
    double M[3][3], M_q[3][3][3], M_qq[3][3][3][3];
    double b[3], b_q[3][3], b_qq[3][3][3];
    double V, V_q[3], V_qq[3][3];
} vector_metric;

static inline double vector_square(double (*A)[3], const double *v)
{
    double sum = 0.0;
    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++) sum += v[i] * A[i][j] * v[j];
    return sum;
}

static inline void vector_jet(vector_metric *g, const double *v, double *L, double *L_q,
                              double *L_v, double *L_qq, double *L_vq, double *L_vv)
{
    if (L) *L = 0.5 * vector_square(g->M, v) - g->V;
    for (size_t i = 0; i < 3; i++) {
        if (L) *L += g->b[i] * v[i];
        if (L_q) {
            L_q[i] = 0.5 * vector_square(g->M_q[i], v) - g->V_q[i];
            for (size_t k = 0; k < 3; k++) L_q[i] += g->b_q[k][i] * v[k];
        }
        if (L_v) {
            L_v[i] = g->b[i];
            for (size_t k = 0; k < 3; k++) L_v[i] += g->M[i][k] * v[k];
        }
        for (size_t j = 0; j < 3; j++) {
            const size_t ij = 3 * i + j;
            if (L_qq) {
                L_qq[ij] = 0.5 * vector_square(g->M_qq[i][j], v) - g->V_qq[i][j];
                for (size_t k = 0; k < 3; k++) L_qq[ij] += g->b_qq[k][i][j] * v[k];
            }
            if (L_vq) {
                L_vq[ij] = g->b_q[i][j];
                for (size_t k = 0; k < 3; k++) L_vq[ij] += g->M_q[j][i][k] * v[k];
            }
            if (L_vv) L_vv[ij] = g->M[i][j];
        }
    }
}

/* m = 3/2, J = 4/5, a = 2/5 */
static inline int vector_contact_lagrangian(double t, const double *q, const double *v, double *L,
                                            double *L_q, double *L_v, double *L_qq, double *L_vq,
                                            double *L_vv, double *L_vt, void *ctx)
{
    const double am = 0.4 * 1.5, s = am * sin(q[2]), c = am * cos(q[2]);
    (void)ctx;
    vector_metric g = {.M = {{1.5, 0.0, -s}, {0.0, 1.5, c}, {-s, c, 0.8 + 0.4 * am}}};
    g.M_q[2][0][2] = g.M_q[2][2][0] = -c;
    g.M_q[2][1][2] = g.M_q[2][2][1] = -s;
    g.M_qq[2][2][0][2] = g.M_qq[2][2][2][0] = s;
    g.M_qq[2][2][1][2] = g.M_qq[2][2][2][1] = -c;
    vector_jet(&g, v, L, L_q, L_v, L_qq, L_vq, L_vv);
    return 0;
}

/* mu = (-sin theta, cos theta, 0) */
static inline int vector_contact_constraint(double t, const double *q, const double *v,
                                            double *phi, double *phi_v, double *phi_q,
                                            double *phi_t, void *ctx)
{
    const double s = sin(q[2]), c = cos(q[2]);
    (void)ctx;
    vector_form((double[]){-s, c, 0.0}, (double[]){0.0, 0.0, -c * v[0] - s * v[1]}, v, phi, phi_v,
                phi_q);
    return 0;
}

/* M = ((2 + y^2/4, z/5, 1/10), (z/5, 3/2 + cos(x)/3, x/6), (1/10, x/6, 1 + x^2/3)),
 * b = (y z/4, sin(x)/3, -x y/5), V = x^4/4 + x^2/2 + x y z/5 + y^2 + 3 z^2/4, q = (x, y, z). */
static inline int vector_genmass_lagrangian(double t, const double *q, const double *v, double *L,
                                            double *L_q, double *L_v, double *L_qq, double *L_vq,
                                            double *L_vv, double *L_vt, void *ctx)
{
    const double x = q[0], y = q[1], z = q[2];
    (void)ctx;
    vector_metric g = {
        .M = {{2 + y * y / 4, z / 5, 0.1},
              {z / 5, 1.5 + cos(x) / 3, x / 6},
              {0.1, x / 6, 1 + x * x / 3}},
        .b = {y * z / 4, sin(x) / 3, -x * y / 5},
        .b_q = {{0, z / 4, y / 4}, {cos(x) / 3, 0, 0}, {-y / 5, -x / 5, 0}},
        .V = x * x * x * x / 4 + x * x / 2 + x * y * z / 5 + y * y + 0.75 * z * z,
        .V_q = {x * x * x + x + y * z / 5, x * z / 5 + 2 * y, x * y / 5 + 1.5 * z},
        .V_qq = {{3 * x * x + 1, z / 5, y / 5}, {z / 5, 2, x / 5}, {y / 5, x / 5, 1.5}},
    };
    g.M_q[0][1][1] = -sin(x) / 3;
    g.M_q[0][1][2] = g.M_q[0][2][1] = 1.0 / 6;
    g.M_q[0][2][2] = 2 * x / 3;
    g.M_q[1][0][0] = y / 2;
    g.M_q[2][0][1] = g.M_q[2][1][0] = 0.2;
    g.M_qq[0][0][1][1] = -cos(x) / 3;
    g.M_qq[0][0][2][2] = 2.0 / 3;
    g.M_qq[1][1][0][0] = 0.5;
    g.b_qq[0][1][2] = g.b_qq[0][2][1] = 0.25;
    g.b_qq[1][0][0] = -sin(x) / 3;
    g.b_qq[2][0][1] = g.b_qq[2][1][0] = -0.2;
    vector_jet(&g, v, L, L_q, L_v, L_qq, L_vq, L_vv);
    return 0;
}

/* mu = (-y, x/2 + z/4, 1 + x^2/5) */
static inline int vector_genmass_constraint(double t, const double *q, const double *v,
                                            double *phi, double *phi_v, double *phi_q,
                                            double *phi_t, void *ctx)
{
    const double x = q[0], y = q[1], z = q[2];
    (void)ctx;
    vector_form((double[]){-y, x / 2 + z / 4, 1 + x * x / 5},
                (double[]){v[1] / 2 + 2 * x / 5 * v[2], -v[0], v[1] / 4}, v, phi, phi_v, phi_q);
    return 0;
}

/* ---- the table ---------------------------------------------------------------------------- */

typedef struct vector_system {
    const char *name;    /* in the vectors */
    const char *builtin; /* in the library, NULL where it has none */
    size_t n, m;
    const double *mass;  /* [n*n] or NULL: there is a Lagrangian */
    dal_potential_fn potential; /* NULL: V = 0 */
    dal_constraint_fn constraint;
    dal_lagrangian_fn lagrangian;
} vector_system;

static const double vector_mass_one[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
static const double vector_mass_knife[9] = {2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.75};
static const double vector_mass_sleigh[9] = {1.5, 0.0, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0, 0.8};
static const double vector_mass_disk[16] = {
    1.2, 0.0, 0.0, 0.0,
    0.0, 1.2, 0.0, 0.0,
    0.0, 0.0, 0.5, 0.0,
    0.0, 0.0, 0.0, 0.3,
};

static const vector_system vector_systems[] = {
    {"particle", "particle", 3, 1, vector_mass_one, NULL, vector_particle_constraint, NULL},
    {"particle_osc", "particle_oscillator", 3, 1, vector_mass_one, vector_particle_osc_potential,
     vector_particle_constraint, NULL},
    {"knife", "knife_edge", 3, 1, vector_mass_knife, vector_knife_potential,
     vector_knife_constraint, NULL},
    {"sleigh", "sleigh", 3, 1, vector_mass_sleigh, NULL, vector_sleigh_constraint, NULL},
    {"disk", "disk", 4, 2, vector_mass_disk, NULL, vector_disk_constraint, NULL},
    {"heis", "heisenberg", 3, 1, vector_mass_one, vector_heis_potential, vector_heis_constraint,
     NULL},
    {"generic4", NULL, 4, 2, generic4_mass, generic4_potential, generic4_constraint, NULL},
    {"sleigh_contact", NULL, 3, 1, NULL, NULL, vector_contact_constraint,
     vector_contact_lagrangian},
    {"genmass", NULL, 3, 1, NULL, NULL, vector_genmass_constraint, vector_genmass_lagrangian},
};

#endif /* DALEMBERT_TESTS_VECTOR_SYSTEMS_H */
