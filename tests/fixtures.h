/* fixtures.h - what several C tests need: systems, schemes and steppers by name, a few systems that
 * are not built in, and a sequence of numbers.  Whatever cannot be made ends the program.
 *
 * The functions whose names begin with open_, new_ or start_ return objects that nobody has to
 * free: they are freed when the program ends, the newest first.  Loops over many give them back by
 * release(). */
#ifndef DALEMBERT_TESTS_FIXTURES_H
#define DALEMBERT_TESTS_FIXTURES_H

#include "check.h"
#include "generic4.h"
#include "dalembert/discrete.h"
#include "dalembert/study.h"
#include "oracle/multiroot.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double U = 0x1p-53; /* unit roundoff */

static inline void need(int status, const char *what, const char *text)
{
    if (status == DAL_SUCCESS) return;
    fprintf(stderr, "%s: %s: %s\n", what, dal_strerror(status), text);
    exit(2);
}

/* ---- objects that are freed when the program ends ------------------------------------------ */

typedef enum owned_kind {
    OWNED_SYSTEM, OWNED_MECHANICS, OWNED_CHART, OWNED_FLOW, OWNED_DISCRETE, OWNED_STEPPER
} owned_kind;

static struct {
    struct {
        owned_kind kind;
        void *object;
    } *list;
    size_t count, room;
} owned;

static inline void free_owned(size_t first)
{
    while (owned.count > first) {
        void *const object = owned.list[--owned.count].object;
        switch (owned.list[owned.count].kind) {
        case OWNED_SYSTEM: dal_system_free(object); break;
        case OWNED_MECHANICS: dal_mechanics_free(object); break;
        case OWNED_CHART: dal_chart_free(object); break;
        case OWNED_FLOW: dal_flow_free(object); break;
        case OWNED_DISCRETE: dal_discrete_free(object); break;
        case OWNED_STEPPER: dal_stepper_free(object); break;
        }
    }
}

static inline void free_all_owned(void)
{
    free_owned(0);
    free(owned.list);
}

/* Frees an object and all that was opened after it. */
static inline void release(const void *object)
{
    size_t first = owned.count;
    while (first > 0 && owned.list[first - 1].object != object) first--;
    need(first > 0 ? DAL_SUCCESS : DAL_EINVAL, "release", "nothing of the kind is open");
    free_owned(first - 1);
}

/* The object, if it was made without an error. */
static inline void *own(owned_kind kind, void *object, int status, const char *what,
                        const dal_error *error)
{
    need(status, what, error->text);
    if (!owned.list) atexit(free_all_owned);
    if (owned.count == owned.room) {
        owned.room = 2 * owned.room + 64;
        owned.list = realloc(owned.list, owned.room * sizeof *owned.list);
        if (!owned.list) exit(2);
    }
    owned.list[owned.count].kind = kind;
    owned.list[owned.count++].object = object;
    return object;
}

/* One that is made of an object's address and an error record, both of which it names. */
#define OWN(kind, type, what, call)                                            \
    type *object = NULL;                                                       \
    dal_error error = {0};                                                     \
    const int status = call;                                                   \
    return own(OWNED_##kind, object, status, what, &error)

static inline dal_system *new_system(const dal_system_def *def)
{
    OWN(SYSTEM, dal_system, def->name ? def->name : "system", dal_system_new(&object, def, &error));
}

/* ---- uneven_edge: a knife edge that turns unevenly -----------------------------------------
 * M = diag(2, 2, 3/4), V = -5 x + sin(theta)/10, mu = (sin theta, -cos theta, 0).  Its heading
 * grows without end and its speed passes through 0 again and again. */

static inline int uneven_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                                   void *ctx)
{
    if (V) *V = -5.0 * q[0] + sin(q[2]) / 10;
    if (V_q) {
        V_q[0] = -5.0;
        V_q[1] = 0.0;
        V_q[2] = cos(q[2]) / 10;
    }
    if (V_qq) {
        memset(V_qq, 0, 9 * sizeof *V_qq);
        V_qq[8] = -sin(q[2]) / 10;
    }
    return 0;
}

static inline int uneven_constraint(double t, const double *q, const double *v, double *phi,
                                    double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    const double s = sin(q[2]), c = cos(q[2]);
    (void)ctx;
    if (phi) phi[0] = s * v[0] - c * v[1];
    if (phi_v) {
        phi_v[0] = s;
        phi_v[1] = -c;
        phi_v[2] = 0.0;
    }
    if (phi_q) {
        phi_q[0] = phi_q[1] = 0.0;
        phi_q[2] = c * v[0] + s * v[1];
    }
    return 0;
}

static inline int uneven_new(dal_system **system, dal_error *error)
{
    const double mass[9] = {2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.75};
    const double state[6] = {0.0, 0.0, 0.2, 0.5 * cos(0.2), 0.5 * sin(0.2), 1.2};
    const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .potential = uneven_potential,
                                .constraint = uneven_constraint, .name = "uneven_edge",
                                .state = state};
    return dal_system_new(system, &def, error);
}

static inline int named_new(dal_system **system, const char *name, dal_error *error)
{
    if (strcmp(name, "generic4") == 0) return generic4_new(system, error);
    if (strcmp(name, "uneven_edge") == 0) return uneven_new(system, error);
    return dal_system_builtin(system, name, NULL, NULL, 0, error);
}

/* A built-in system, or one of these two. */
static inline dal_system *open_system(const char *name)
{
    OWN(SYSTEM, dal_system, name, named_new(&object, name, &error));
}

/* A built-in system with these parameters. */
static inline dal_system *open_builtin(const char *name, size_t count, const char *const *names,
                                       const double *values)
{
    OWN(SYSTEM, dal_system, name,
        dal_system_builtin(&object, name, names, values, count, &error));
}

static inline dal_system *open_deformed(const dal_system *base, dal_deformation_fn g, void *ctx,
                                        double delta, dal_constraint_kind kind, unsigned missing)
{
    OWN(SYSTEM, dal_system, "deformed",
        dal_system_deform(&object, base, g, ctx, delta, kind, missing, &error));
}

static inline dal_system *open_deformed_nodes(const dal_system *base, double shift)
{
    OWN(SYSTEM, dal_system, "deformed", dal_system_deform_nodes(&object, base, shift, &error));
}

static inline dal_mechanics *open_mechanics(const dal_system *system)
{
    OWN(MECHANICS, dal_mechanics, dal_system_name(system),
        dal_mechanics_new(&object, system, &error));
}

static inline dal_chart *open_chart(const dal_system *system)
{
    OWN(CHART, dal_chart, dal_system_name(system), dal_chart_new(&object, system, &error));
}

static inline dal_discrete *open_discrete(const dal_system *system,
                                          dal_difference_map lagrangian,
                                          const dal_difference_map *constraint)
{
    OWN(DISCRETE, dal_discrete, dal_system_name(system),
        dal_discrete_new(&object, system, &lagrangian, constraint, &error));
}

static inline dal_flow *open_flow(const dal_system *system, dal_flow_method method,
                                  dal_flow_coordinates coordinates, double tolerance)
{
    OWN(FLOW, dal_flow, dal_system_name(system),
        dal_flow_new(&object, system, method, coordinates, tolerance, &error));
}

/* How many of the named schemes need no series: all but the last one, "taylor". */
static inline size_t schemes_for_callbacks(void) { return dal_scheme_count() - 1; }

static inline dal_scheme find_scheme(const char *name)
{
    dal_scheme scheme = {0};
    dal_error error = {0};
    need(dal_scheme_find(&scheme, name, &error), name, error.text);
    return scheme;
}

static inline dal_stepper *open_stepper(const dal_system *system, const dal_scheme *scheme,
                                        const dal_options *options)
{
    OWN(STEPPER, dal_stepper, scheme->name,
        dal_stepper_new(&object, system, scheme, options, &error));
}

static inline dal_stepper *open_named(const dal_system *system, const char *scheme_name)
{
    const dal_scheme scheme = find_scheme(scheme_name);
    return open_stepper(system, &scheme, NULL);
}

static inline dal_stepper *open_stepper_by(way by, const dal_system *system,
                                           const dal_scheme *scheme)
{
    OWN(STEPPER, dal_stepper, scheme->name, new_stepper_by(by, &object, system, scheme, &error));
}

/* It stands at x, which lies in D, at time 0. */
static inline dal_stepper *start_stepper(const dal_system *system, const dal_scheme *scheme,
                                         double h, const double *x)
{
    dal_stepper *const stepper = open_stepper(system, scheme, NULL);
    need(dal_stepper_start(stepper, 0.0, h, x, DAL_CHECK, DAL_INITIAL_NONE), scheme->name,
         dal_stepper_error(stepper)->text);
    return stepper;
}

static inline dal_stepper *start_named(const dal_system *system, const char *scheme_name, double h,
                                       const double *x)
{
    const dal_scheme scheme = find_scheme(scheme_name);
    return start_stepper(system, &scheme, h, x);
}

/* At x, or where the system starts if that is NULL; kept nodes at what belongs to it. */
static inline dal_stepper *start_at(const dal_system *system, const char *scheme_name, double t0,
                                    double h, const double *x)
{
    enum { MOST_2N = 96 };
    const dal_scheme scheme = find_scheme(scheme_name);
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    double state[MOST_2N];
    if (!x) need(dal_system_state(system, state), "state", scheme_name);
    need(dal_stepper_start(stepper, t0, h, x ? x : state, DAL_CHECK,
                           scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE),
         scheme_name, dal_stepper_error(stepper)->text);
    return stepper;
}

static inline dal_stats stats_of(const dal_stepper *stepper)
{
    dal_stats stats;
    dal_stepper_stats(stepper, &stats);
    return stats;
}

/* The library must never provoke it. */
static inline void abort_on_gsl_error(const char *reason, const char *file, int line, int number)
{
    fprintf(stderr, "%s:%d: GSL's handler was called: %s (%d)\n", file, line, reason, number);
    abort();
}

/* The next of a fixed sequence of numbers in [-1, 1]. */
static inline double next_number(unsigned *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return (double)*seed / 2147483648.0 - 1.0;
}

/* The default state of a system, moved a little and projected onto D. */
static inline void moved_state(const dal_system *system, double *x)
{
    unsigned seed = 7;
    need(dal_system_state(system, x), "state", "");
    for (size_t i = 0; i < 2 * dal_system_n(system); i++) x[i] += 0.2 * next_number(&seed);
    dal_mechanics *const mechanics = open_mechanics(system);
    need(dal_project(mechanics, 0.0, 0.0, x, NULL), "project",
         dal_mechanics_error(mechanics)->text);
    release(mechanics);
}

static inline double sum_of_sizes(size_t count, const double *x)
{
    double sum = 0.0;
    for (size_t i = 0; i < count; i++) sum += fabs(x[i]);
    return sum;
}

static inline double largest_difference(size_t count, const double *x, const double *y)
{
    double worst = 0.0;
    for (size_t i = 0; i < count; i++) {
        const double d = fabs(x[i] - y[i]);
        if (!(d <= worst)) worst = d; /* NaN is kept */
    }
    return worst;
}

/* M of a system of constant mass, until the next call; or NULL. */
static inline const double *mass_of(const dal_system *system)
{
    enum { MOST = 48 };
    static double M[MOST * MOST];
    if (dal_system_n(system) > MOST) exit(2);
    return dal_system_mass(system, M) ? NULL : M;
}

/* (M^-1)_ii at (q, v), by elimination in M next to the identity. */
static inline void inverse_diagonal(const dal_system *system, const double *x, double *diagonal)
{
    enum { MOST = 48 };
    const size_t n = system->def.n;
    double A[MOST][2 * MOST], M[MOST * MOST];
    if (n > MOST) exit(2);
    if (dal_system_mass(system, M)) {
        dal_mechanics *const mechanics = open_mechanics(system);
        if (dal_metric(mechanics, 0.0, x, M)) exit(2);
        release(mechanics);
    }
    for (size_t i = 0; i < n; i++) {
        for (size_t j = 0; j < n; j++) {
            A[i][j] = M[i * n + j];
            A[i][n + j] = i == j;
        }
    }
    for (size_t k = 0; k < n; k++)
        for (size_t i = 0; i < n; i++) {
            const double factor = A[i][k] / A[k][k];
            for (size_t j = k; i != k && j < 2 * n; j++) A[i][j] -= factor * A[k][j];
        }
    for (size_t i = 0; i < n; i++) diagonal[i] = A[i][n + i] / A[i][i];
}

/* The residual of D, or of D_eps, as the header defines it, at time 0. */
static inline double residual_of(const dal_system *system, double shift, const double *x)
{
    enum { MOST_N = 48, MOST_ENTRIES = 160 };
    const size_t n = system->def.n, m = system->def.m;
    double y[2 * MOST_N], mu[MOST_ENTRIES], phi[MOST_N], square[MOST_N], worst = 0.0, speed = 0.0;
    double slope[MOST_ENTRIES] = {0};
    const bool linear = system->def.kind == DAL_LINEAR, moves = !linear || shift != 0.0;
    if (n > MOST_N || m * n > MOST_ENTRIES) exit(2);
    for (size_t i = 0; i < n; i++) {
        y[i] = x[i] - shift * x[n + i];
        y[n + i] = x[n + i];
    }
    if (m > 0 && system->def.constraint(0.0, y, y + n, linear ? NULL : phi, mu,
                                        moves ? slope : NULL, NULL, system->def.ctx))
        exit(2);
    if (m > 0) inverse_diagonal(system, y, square);
    for (size_t i = 0; m > 0 && i < n; i++) speed = fmax(speed, fabs(y[n + i]) / sqrt(square[i]));
    for (size_t a = 0; a < m; a++) {
        double sum = 0.0, size = 0.0;
        for (size_t i = 0; i < n; i++) {
            sum += mu[a * n + i] * y[n + i];
            size += fabs(mu[a * n + i]) * sqrt(square[i]) * speed;
            size += fabs(slope[a * n + i]) * (fabs(y[i]) + fabs(shift * y[n + i]));
        }
        if (!linear) {
            size += fabs(phi[a] - sum);
            sum = phi[a];
        }
        if (!(fabs(sum) <= worst * size)) worst = fabs(sum) / size;
    }
    return worst;
}

/* ---- callbacks of a few lines ------------------------------------------------------------- */

/* A force that is zero makes a system a general one, whose steps are those of momentum.h. */
static inline int zero_force(size_t n, double *f, double *f_q, double *f_v)
{
    if (f) memset(f, 0, n * sizeof *f);
    if (f_q) memset(f_q, 0, n * n * sizeof *f_q);
    if (f_v) memset(f_v, 0, n * n * sizeof *f_v);
    return 0;
}

#define FORCE_ARGUMENTS                                                                        \
    double t, const double *q, const double *v, const double *u, double *f, double *f_q,       \
        double *f_v, void *ctx

static inline int no_force_1(FORCE_ARGUMENTS) { return zero_force(1, f, f_q, f_v); }
static inline int no_force_2(FORCE_ARGUMENTS) { return zero_force(2, f, f_q, f_v); }
static inline int no_force(FORCE_ARGUMENTS) { return zero_force(3, f, f_q, f_v); }

/* These are given and never called. */
static inline int never_force(FORCE_ARGUMENTS) { return -1; }

static inline int never_constraint(double t, const double *q, const double *v, double *phi,
                                   double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    return -1;
}

static inline int never_lagrangian(double t, const double *q, const double *v, double *L,
                                   double *L_q, double *L_v, double *L_qq, double *L_vq,
                                   double *L_vv, double *L_vt, void *ctx)
{
    return -1;
}

/* V = k q^2/2; k is the ctx. */
static inline int spring(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double k = *(const double *)ctx;
    if (V) *V = k * q[0] * q[0] / 2;
    if (V_q) *V_q = k * q[0];
    if (V_qq) *V_qq = k;
    return 0;
}

static inline int pendulum(double t, const double *q, double *V, double *V_q, double *V_qq,
                           void *ctx)
{
    if (V) *V = -cos(q[0]);
    if (V_q) *V_q = sin(q[0]);
    if (V_qq) *V_qq = cos(q[0]);
    return 0;
}

/* g = v_x v_y, in three dimensions. */
static inline int product(double t, const double *q, const double *v, double *g, double *g_v,
                          double *g_q, double *g_t, void *ctx)
{
    if (g) g[0] = v[0] * v[1];
    if (g_v) memcpy(g_v, (double[]){v[1], v[0], 0.0}, 3 * sizeof *g_v);
    if (g_q) memset(g_q, 0, 3 * sizeof *g_q);
    return 0;
}

/* ---- wide: a system of any size without symmetry ------------------------------------------
 * mu^a_i = delta_ai + sin(q_j + 0.7 a + 0.3 i)/7 with j = (2 a + 3 i + 1) mod n,
 * V = sum_i q_i^2/2 + q_i^4/8 + q_i q_(i+1)/5. */

enum { WIDE_N = 16 };

typedef struct wide {
    size_t n, m;
    double mass[WIDE_N * WIDE_N], state[2 * WIDE_N];
} wide;

static inline int wide_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                                 void *ctx)
{
    const size_t n = ((const wide *)ctx)->n;
    if (V) *V = 0.0;
    if (V_qq) memset(V_qq, 0, n * n * sizeof *V_qq);
    for (size_t i = 0; i < n; i++) {
        const size_t next = (i + 1) % n, last = (i + n - 1) % n;
        const double s = q[i];
        if (V) *V += s * s / 2 + s * s * s * s / 8 + s * q[next] / 5;
        if (V_q) V_q[i] = s + s * s * s / 2 + (q[next] + q[last]) / 5;
        if (V_qq) {
            V_qq[i * n + i] += 1.0 + 1.5 * s * s;
            V_qq[i * n + next] += 0.2;
            V_qq[i * n + last] += 0.2;
        }
    }
    return 0;
}

static inline int wide_constraint(double t, const double *q, const double *v, double *phi,
                                  double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    const size_t n = ((const wide *)ctx)->n, m = ((const wide *)ctx)->m;
    if (phi) memset(phi, 0, m * sizeof *phi);
    if (phi_q) memset(phi_q, 0, m * n * sizeof *phi_q);
    for (size_t a = 0; a < m; a++)
        for (size_t i = 0; i < n; i++) {
            const size_t j = (2 * a + 3 * i + 1) % n;
            const double angle = q[j] + 0.7 * (double)a + 0.3 * (double)i;
            const double form = (a == i ? 1.0 : 0.0) + sin(angle) / 7;
            if (phi) phi[a] += form * v[i];
            if (phi_v) phi_v[a * n + i] = form;
            if (phi_q) phi_q[a * n + j] += cos(angle) / 7 * v[i];
        }
    return 0;
}

/* w is filled and has to outlive the system.  Its state lies in D. */
static inline dal_system *open_wide(wide *w, size_t n, size_t m, bool full_mass, bool potential)
{
    unsigned seed = (unsigned)(16 * n + m);
    *w = (wide){.n = n, .m = m};
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++)
            w->mass[i * n + j] = i == j ? 1.0 + 0.25 * (double)i
                               : full_mass ? 0.2 / (double)(1 + (i > j ? i - j : j - i)) : 0.0;
    const dal_system_def def = {.n = n, .m = m, .mass = w->mass,
                                .potential = potential ? wide_potential : NULL,
                                .constraint = m > 0 ? wide_constraint : NULL, .ctx = w,
                                .name = "wide"};
    dal_system *const system = new_system(&def);
    for (size_t i = 0; i < 2 * n; i++) w->state[i] = next_number(&seed);
    dal_mechanics *const mechanics = open_mechanics(system);
    need(dal_project(mechanics, 0.0, 0.0, w->state, NULL), "wide",
         dal_mechanics_error(mechanics)->text);
    release(mechanics);
    return system;
}

/* ---- the same D by other forms: mu' = B(q) mu, m <= 2 ------------------------------------- */

/* B[m*m], and B_q[m*m] its derivative by q_j. */
static inline void mixing(size_t m, const double *q, double *B, size_t j, double *B_q)
{
    const double full[4] = {2.0 + sin(q[0]), cos(q[1]) / 2, 0.3, 1.5 + 0.4 * sin(q[2])};
    const double full_q[4] = {j == 0 ? cos(q[0]) : 0.0, j == 1 ? -sin(q[1]) / 2 : 0.0, 0.0,
                              j == 2 ? 0.4 * cos(q[2]) : 0.0};
    for (size_t k = 0; k < m * m; k++) {
        B[k] = full[k];
        B_q[k] = full_q[k];
    }
}

/* The constraint of a blade in the plane, q = (x, y, heading). */
static inline int plane_blade(double t, const double *q, const double *v, double *phi,
                              double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    const double sine = sin(q[2]), cosine = cos(q[2]);
    if (phi) *phi = sine * v[0] - cosine * v[1];
    if (phi_v) memcpy(phi_v, (double[]){sine, -cosine, 0.0}, 3 * sizeof *phi_v);
    if (phi_q) memcpy(phi_q, (double[]){0.0, 0.0, cosine * v[0] + sine * v[1]}, 3 * sizeof *phi_q);
    return 0;
}

/* ctx is the dal_system whose forms are mixed. */
static inline int mixed_constraint(double t, const double *q, const double *v, double *phi,
                                   double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    enum { MOST = 8 };
    const dal_system_def *def = &((const dal_system *)ctx)->def;
    const size_t n = def->n, m = def->m;
    double mu[2 * MOST], N[2 * MOST], muv[2], B[4], B_q[4];
    if (def->constraint(t, q, v, NULL, mu, N, NULL, def->ctx)) return -1;
    dal__apply(m, n, mu, v, muv);
    for (size_t j = 0; j < n; j++) {
        mixing(m, q, B, j, B_q);
        for (size_t a = 0; a < m; a++) {
            double form = 0.0, slope = 0.0;
            for (size_t b = 0; b < m; b++) {
                form += B[a * m + b] * mu[b * n + j];
                slope += B[a * m + b] * N[b * n + j] + B_q[a * m + b] * muv[b];
            }
            if (phi_v) phi_v[a * n + j] = form;
            if (phi_q) phi_q[a * n + j] = slope;
        }
    }
    if (phi) dal__apply(m, m, B, muv, phi);
    return 0;
}

static inline int mixed_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                                  void *ctx)
{
    const dal_system_def *def = &((const dal_system *)ctx)->def;
    return def->potential(t, q, V, V_q, V_qq, def->ctx);
}

static inline dal_system *open_mixed(dal_system *base)
{
    dal_system_def def = base->def;
    def.ctx = base;
    def.steady = 0; /* B(q) mu depends on every coordinate */
    def.constraint = mixed_constraint;
    def.potential = base->def.potential ? mixed_potential : NULL;
    def.exact = NULL;
    def.invariants = 0;
    return new_system(&def);
}

/* f = B(q)^T g: the multipliers of mu from those of mu' = B(q) mu. */
static inline void unmix(size_t m, const double *q, const double *g, double *f)
{
    double B[4], unused[4];
    mixing(m, q, B, 0, unused);
    for (size_t a = 0; a < m; a++) {
        f[a] = 0.0;
        for (size_t b = 0; b < m; b++) f[a] += B[b * m + a] * g[b];
    }
}

/* A stepper of the system with these options is refused with these words. */
#define STEPPER_REFUSED(system, name, words, ...) \
    do { \
        const dal_scheme scheme = find_scheme(name); \
        dal_stepper *made = NULL; \
        dal_error error = {0}; \
        const int status = dal_stepper_new(&made, system, &scheme, &(dal_options){__VA_ARGS__}, \
                                           &error); \
        CHECK(status < 0 && !made && strstr(error.text, words) != NULL); \
    } while (0)

#endif /* DALEMBERT_TESTS_FIXTURES_H */
