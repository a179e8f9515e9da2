/* vector_systems.h - the systems of tests/data/vectors.json with a constant mass matrix, written
 * from the formulas and parameters that stand there, and not from the library's own. */
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

static inline int vector_particle_constraint(const double *q, const double *v, double *phi,
                                             double *phi_v, double *phi_q, void *ctx)
{
    (void)ctx;
    vector_form((double[]){-q[1], 0.0, 1.0}, (double[]){0.0, -v[0], 0.0}, v, phi, phi_v, phi_q);
    return 0;
}

/* V = x^2/2 + y^2 + 3 z^2/4 */
static inline int vector_particle_osc_potential(const double *q, double *V, double *V_q,
                                                double *V_qq, void *ctx)
{
    (void)ctx;
    vector_springs((double[]){1.0, 2.0, 1.5}, q, V, V_q, V_qq);
    return 0;
}

/* ---- knife: V = -m gs x, mu = (sin theta, -cos theta, 0), m = 2, J = 3/4, gs = 5/2 -------- */

static inline int vector_knife_potential(const double *q, double *V, double *V_q, double *V_qq,
                                         void *ctx)
{
    (void)ctx;
    if (V) *V = -5.0 * q[0];
    vector_set(V_q, 3, (double[]){-5.0, 0.0, 0.0});
    vector_set(V_qq, 9, (double[9]){0.0});
    return 0;
}

static inline int vector_knife_constraint(const double *q, const double *v, double *phi,
                                          double *phi_v, double *phi_q, void *ctx)
{
    const double s = sin(q[2]), c = cos(q[2]);
    (void)ctx;
    vector_form((double[]){s, -c, 0.0}, (double[]){0.0, 0.0, c * v[0] + s * v[1]}, v, phi, phi_v,
                phi_q);
    return 0;
}

/* ---- sleigh: mu = (-sin theta, cos theta, -a), m = 3/2, J = 4/5, a = 2/5 ------------------ */

static inline int vector_sleigh_constraint(const double *q, const double *v, double *phi,
                                           double *phi_v, double *phi_q, void *ctx)
{
    const double s = sin(q[2]), c = cos(q[2]);
    (void)ctx;
    vector_form((double[]){-s, c, -0.4}, (double[]){0.0, 0.0, -c * v[0] - s * v[1]}, v, phi, phi_v,
                phi_q);
    return 0;
}

/* ---- disk: mu^1 = (1, 0, -R cos phi, 0), mu^2 = (0, 1, -R sin phi, 0), R = 7/10 ------------ */

static inline int vector_disk_constraint(const double *q, const double *v, double *phi,
                                         double *phi_v, double *phi_q, void *ctx)
{
    const double R = 0.7, s = sin(q[3]), c = cos(q[3]);
    (void)ctx;
    vector_set(phi, 2, (double[]){v[0] - R * c * v[2], v[1] - R * s * v[2]});
    vector_set(phi_v, 8, (double[]){1.0, 0.0, -R * c, 0.0, 0.0, 1.0, -R * s, 0.0});
    vector_set(phi_q, 8, (double[]){0.0, 0.0, 0.0, R * s * v[2], 0.0, 0.0, 0.0, -R * c * v[2]});
    return 0;
}

/* ---- heis: V = (x^2 + 9/4 y^2 + z^2/2)/2, mu = (y, -x, 1) ---------------------------------- */

static inline int vector_heis_potential(const double *q, double *V, double *V_q, double *V_qq,
                                        void *ctx)
{
    (void)ctx;
    vector_springs((double[]){1.0, 2.25, 0.5}, q, V, V_q, V_qq);
    return 0;
}

static inline int vector_heis_constraint(const double *q, const double *v, double *phi,
                                         double *phi_v, double *phi_q, void *ctx)
{
    (void)ctx;
    vector_form((double[]){q[1], -q[0], 1.0}, (double[]){-v[1], v[0], 0.0}, v, phi, phi_v, phi_q);
    return 0;
}

/* ---- the table --------------------------------------------------------------------------- */

typedef struct vector_system {
    const char *name;    /* in the vectors */
    const char *builtin; /* in the library, NULL where it has none */
    size_t n, m;
    const double *mass;  /* [n*n] */
    dal_potential_fn potential; /* NULL: V = 0 */
    dal_constraint_fn constraint;
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
    {"particle", "particle", 3, 1, vector_mass_one, NULL, vector_particle_constraint},
    {"particle_osc", "particle_oscillator", 3, 1, vector_mass_one, vector_particle_osc_potential,
     vector_particle_constraint},
    {"knife", "knife_edge", 3, 1, vector_mass_knife, vector_knife_potential,
     vector_knife_constraint},
    {"sleigh", "sleigh", 3, 1, vector_mass_sleigh, NULL, vector_sleigh_constraint},
    {"disk", "disk", 4, 2, vector_mass_disk, NULL, vector_disk_constraint},
    {"heis", "heisenberg", 3, 1, vector_mass_one, vector_heis_potential, vector_heis_constraint},
    {"generic4", NULL, 4, 2, generic4_mass, generic4_potential, generic4_constraint},
};

#endif /* DALEMBERT_TESTS_VECTOR_SYSTEMS_H */
