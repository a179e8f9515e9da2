/* The library against numbers that were computed with 60 digits (tests/data): single steps, runs,
 * the equations of a step, formulas on D and off it, end states of the flow.
 *
 * Every system is tested as C callbacks that are written here from the formulas in the data, and a
 * second time as the library's own where it has one. */
#include "check.h"
#include "fixtures.h"
#include "vector_systems.h"

#include <float.h>

enum { N = 4, M = 2 }; /* the largest system */

/* A number of steps; x1 is the state after them.  A NULL pointer: not in the data. */
typedef struct run_vector {
    const char *group, *system;
    const char *scheme;  /* NULL: the beta-scheme */
    double beta;
    dal_initial initial; /* DAL_INITIAL_NONE: moved nodes */
    double h;
    size_t steps;
    double x[2 * N], x1[2 * N];
    const double *reaction, *multipliers, *energy; /* of the last step; at x1 */
} run_vector;

/* The continuous problem at a point of D and at a velocity off D. */
typedef struct point_vector {
    const char *system;
    double x[2 * N], energy, f_v[N], vdot[N], multipliers[M];
    double C[M * M], mass[N * N], mu[M * N], gamma[M]; /* gamma = d(mu v)/dq v */
    double off_x[2 * N], off_multipliers[M], off_vdot[N], projected_v[N];
} point_vector;

/* The equations of a step at a point where they do not hold. */
typedef struct equations_vector {
    const char *system;
    double beta, h, x[2 * N], w[N], kappa[M];
    double R1[N], R2[M], K[N * N], B[M * N], mu_k[M * N];
} equations_vector;

/* The velocity v1 in D_eps along M^-1 mu^T from x in D. */
typedef struct projection_vector {
    const char *system;
    double beta, h, x[2 * N], v1[N];
} projection_vector;

/* A, B, psi(xi) and the multipliers of [A, I] for a choice of dependent coordinates. */
typedef struct chart_vector {
    const char *system;
    size_t dependent[M]; /* ascending */
    double xi[2 * N], A[M * N], B[M * M], v_dep[M], multipliers[M], multipliers_E[M];
} chart_vector;

/* A step of the node map. */
typedef struct node_vector {
    const char *system;
    double beta, h, before[N], q[N], after[N], multipliers[M];
} node_vector;

/* The state of the flow at time t. */
typedef struct reference_vector {
    const char *system;
    double t, x0[2 * N], x[2 * N], multipliers[M], energy;
} reference_vector;

#include "vectors_data.h"

#define LENGTH(array) (sizeof(array) / sizeof(array)[0])

static const double u = DBL_EPSILON / 2;

/* Of the largest component of a vector, or of 1: the data are rounded when they are read, and so is
 * each operation of the longest runs, some hundred one after the other; 1e-13 is 900 u. */
static const double tolerance = 1e-13;

/* ---- what is tested ----------------------------------------------------------------------- */

typedef struct subject {
    const vector_system *is;
    const char *kind;
    size_t n, m; /* m = 0: without its constraints */
    dal_system *system;
    dal_mechanics *mechanics;
} subject;

enum { CALLBACKS, UNCONSTRAINED, BUILTIN, KINDS };

static subject open_subject(const vector_system *is, int kind)
{
    static const char *const kinds[KINDS] = {"callbacks", "callbacks, no constraint", "built in"};
    subject s = {.is = is, .kind = kinds[kind], .n = is->n, .m = kind == UNCONSTRAINED ? 0 : is->m};
    const dal_system_def def = {.n = s.n, .m = s.m, .mass = is->mass, .potential = is->potential,
                                .lagrangian = is->lagrangian,
                                .constraint = s.m > 0 ? is->constraint : NULL};
    s.system = kind == BUILTIN ? open_system(is->builtin) : new_system(&def);
    s.mechanics = open_mechanics(s.system);
    CHECK(dal_system_n(s.system) == s.n && dal_system_m(s.system) == s.m);
    return s;
}

/* ---- comparisons -------------------------------------------------------------------------- */

static double largest(size_t count, const double *a)
{
    double most = 0.0;
    for (size_t i = 0; i < count; i++) most = fmax(most, fabs(a[i]));
    return most;
}

/* |got - expected| <= absolute in every component; where and what say what was compared. */
static void compare_within(double absolute, const char *where, const char *what, size_t count,
                           const double *got, const double *expected)
{
    for (size_t i = 0; i < count; i++) {
        const bool near = fabs(got[i] - expected[i]) <= absolute;
        check_record(near);
        if (!near)
            fprintf(stderr, "%s: %s[%zu] = %.17g, expected %.17g: differs by %.3g > %.3g\n", where,
                    what, i, got[i], expected[i], fabs(got[i] - expected[i]), absolute);
    }
}

static void compare(const char *where, const char *what, size_t count, const double *got,
                    const double *expected)
{
    compare_within(tolerance * fmax(1.0, largest(count, expected)), where, what, count, got,
                   expected);
}

static void check_in(const char *where, const char *what, bool condition)
{
    check_true(condition, what, where, 0);
}

static void check_residual(const subject *s, const char *where, double shift, const double *x)
{
    check_in(where, "the residual is at most 4 n u",
             residual_of(s->system, shift, x) <= 4.0 * (double)s->n * u);
}

/* Roundoff of kappa/h for a kappa that is the solution of C kappa = -mu w: mu w is rounded to
 * n u |mu| |v|, so kappa to n u |M v|/|mu|, a few times over in a step. */
static double reaction_noise(const subject *s, double h, const double *x)
{
    double mu[M * N], mass[N * N], least = HUGE_VAL, momentum = 0.0;
    const double *const v = x + s->n;
    CHECK(dal_metric(s->mechanics, 0.0, x, mass) == 0);
    CHECK(s->is->constraint(0.0, x, v, NULL, mu, NULL, NULL, NULL) == 0);
    for (size_t a = 0; a < s->m; a++) least = fmin(least, largest(s->n, mu + a * s->n));
    for (size_t i = 0; i < s->n; i++) {
        double p = 0.0;
        for (size_t j = 0; j < s->n; j++) p += mass[i * s->n + j] * v[j];
        momentum = fmax(momentum, fabs(p));
    }
    return 4.0 * (double)s->n * u * momentum / (fabs(h) * least);
}

/* ---- steps and runs ----------------------------------------------------------------------- */

/* The steps of r, each made three times: by the default; by the step routine for any sizes, with
 * the same bits; and from the same state by gsl_multiroot, which promises 64 u of the state.
 * reaction[m] <- that of the last step. */
static void make_steps(const subject *s, const run_vector *r, const char *where,
                       dal_stepper *const *stepper, double *reaction)
{
    const size_t n = s->n, m = s->m;
    const double shift = r->initial == DAL_INITIAL_NONE ? 0.0 : (1.0 - r->beta) * r->h;
    for (size_t k = 0; k < r->steps; k++) {
        double runtime_reaction[M], multiroot_reaction[M];
        const double *const x = dal_stepper_state(stepper[BY_LIBRARY]);
        check_in(where, "start of multiroot",
                 dal_stepper_start(stepper[BY_MULTIROOT], 0.0, r->h, x, DAL_ASSUME, r->initial)
                     == 0);
        check_in(where, dal_stepper_error(stepper[BY_LIBRARY])->text,
                 dal_step(stepper[BY_LIBRARY], reaction) == 0);
        check_in(where, dal_stepper_error(stepper[BY_ANY_SIZES])->text,
                 dal_step(stepper[BY_ANY_SIZES], runtime_reaction) == 0);
        check_in(where, dal_stepper_error(stepper[BY_MULTIROOT])->text,
                 dal_step(stepper[BY_MULTIROOT], multiroot_reaction) == 0);

        const double *const runtime = dal_stepper_state(stepper[BY_ANY_SIZES]);
        check_in(where, "the compilation for any sizes gives the same bits",
                 memcmp(runtime, x, 2 * n * sizeof *x) == 0 &&
                     memcmp(runtime_reaction, reaction, m * sizeof *reaction) == 0);
        compare_within(64 * u * largest(2 * n, x), where, "multiroot: x", 2 * n,
                       dal_stepper_state(stepper[BY_MULTIROOT]), x);
        if (m > 0) {
            compare_within(16 * reaction_noise(s, r->h, x), where, "multiroot: reaction", m,
                           multiroot_reaction, reaction);
            check_residual(s, where, shift, x);
        }
    }
}

static void check_run(const subject *s, const run_vector *r)
{
    const size_t n = s->n, m = s->m;
    dal_stepper *stepper[WAYS] = {NULL};
    dal_error error = {0};
    double reaction[M], value[M], energy;
    char where[160];
    snprintf(where, sizeof where, "%s of %s (%s), %s %g, h = %g, initial %d", r->group, r->system,
             s->kind, r->scheme ? r->scheme : "beta", r->beta, r->h, (int)r->initial);

    dal_scheme scheme = {.beta = r->beta, .nodes = r->initial == DAL_INITIAL_NONE
                                                       ? DAL_MOVED_NODES : DAL_KEPT_NODES};
    if (r->scheme) check_in(where, r->scheme, dal_scheme_find(&scheme, r->scheme, &error) == 0);
    for (way by = 0; by < WAYS; by++) {
        stepper[by] = open_stepper_by(by, s->system, &scheme);
        check_in(where, dal_stepper_error(stepper[by])->text,
                 dal_stepper_start(stepper[by], 0.0, r->h, r->x, DAL_ASSUME, r->initial) == 0);
    }
    make_steps(s, r, where, stepper, reaction);

    const double *const x = dal_stepper_state(stepper[BY_LIBRARY]);
    compare(where, "q", n, x, r->x1);
    compare(where, "v", n, x + n, r->x1 + n);
    if (r->reaction && m > 0)
        compare_within(tolerance * fmax(1.0, largest(m, r->reaction)) + reaction_noise(s, r->h, x),
                       where, "reaction", m, reaction, r->reaction);
    if (r->multipliers) {
        CHECK(dal_multipliers(s->mechanics, 0.0, x, value) == 0);
        compare(where, "multipliers", m, value, r->multipliers);
    }
    if (r->energy) {
        CHECK(dal_energy(s->mechanics, 0.0, x, &energy) == 0);
        compare(where, "energy", 1, &energy, r->energy);
    }
    /* At most 16 without the Hessian of V, and 6 with it, which converge quadratically. */
    const dal_stats stats = stats_of(stepper[BY_LIBRARY]);
    check_in(where, "22 iterations of Newton are enough", stats.iterations <= 22 * stats.substeps);
    release(stepper[0]);
}

/* ---- formulas ----------------------------------------------------------------------------- */

/* unconstrained: the same system without its constraints; its acceleration is f_v. */
static void check_point(const subject *s, const subject *unconstrained,
                        const point_vector *p)
{
    const size_t n = s->n, m = s->m;
    double energy, mass[N * N], C[M * M], lambda[M], vdot[N], xdot[2 * N], mu_k[M * N], x[2 * N];
    char where[80];
    snprintf(where, sizeof where, "continuous of %s (%s)", p->system, s->kind);

    CHECK(dal_metric(s->mechanics, 0.0, p->x, mass) == 0);
    compare(where, "mass", n * n, mass, p->mass);
    CHECK(dal_energy(s->mechanics, 0.0, p->x, &energy) == 0);
    compare(where, "energy", 1, &energy, &p->energy);
    CHECK(dal_gram(s->mechanics, 0.0, p->x, C) == 0);
    compare(where, "C", m * m, C, p->C);
    CHECK(dal_multipliers(s->mechanics, 0.0, p->x, lambda) == 0);
    compare(where, "multipliers", m, lambda, p->multipliers);
    CHECK(dal_acceleration(s->mechanics, 0.0, p->x, vdot) == 0);
    compare(where, "vdot", n, vdot, p->vdot);
    CHECK(dal_acceleration(unconstrained->mechanics, 0.0, p->x, vdot) == 0);
    compare(where, "f_v", n, vdot, p->f_v);
    CHECK(dal_field(s->mechanics, 0.0, p->x, xdot) == 0);
    compare(where, "xdot: v", n, xdot, p->x + n);
    compare(where, "xdot: vdot", n, xdot + n, p->vdot);
    /* beta = 1 has its node at q */
    CHECK(dal_step_equations(s->mechanics, 0.0, 1.0, 0.1, p->x, p->x + n, lambda, NULL, NULL, NULL,
                             NULL, mu_k) == 0);
    compare(where, "mu", m * n, mu_k, p->mu);

    CHECK(dal_multipliers(s->mechanics, 0.0, p->off_x, lambda) == 0);
    compare(where, "off D: multipliers", m, lambda, p->off_multipliers);
    CHECK(dal_acceleration(s->mechanics, 0.0, p->off_x, vdot) == 0);
    compare(where, "off D: vdot", n, vdot, p->off_vdot);
    memcpy(x, p->off_x, sizeof x);
    CHECK(dal_project(s->mechanics, 0.0, 0.0, x, NULL) == 0);
    compare(where, "projection: q", n, x, p->x);
    compare(where, "projection: v", n, x + n, p->projected_v);
    check_residual(s, where, 0.0, x);
}

/* What this test says about a system agrees with the data. */
static void check_transcription(const vector_system *is, const point_vector *p)
{
    double mu[M * N], derivative[M * N], gamma[M] = {0.0};
    CHECK(is->constraint(0.0, p->x, p->x + is->n, NULL, mu, derivative, NULL, NULL) == 0);
    for (size_t a = 0; a < is->m; a++)
        for (size_t j = 0; j < is->n; j++)
            gamma[a] += derivative[a * is->n + j] * p->x[is->n + j];
    compare(is->name, "mu of the test", is->m * is->n, mu, p->mu);
    compare(is->name, "gamma of the test", is->m, gamma, p->gamma);
}

static void check_equations(const subject *s, const equations_vector *e)
{
    const size_t n = s->n, m = s->m;
    double R1[N], R2[M], K[N * N], B[M * N], mu_k[M * N];
    char where[80];
    snprintf(where, sizeof where, "newton of %s (%s)", e->system, s->kind);
    CHECK(dal_step_equations(s->mechanics, 0.0, e->beta, e->h, e->x, e->w, e->kappa, R1, R2, K, B,
                             mu_k) == 0);
    compare(where, "R1", n, R1, e->R1);
    compare(where, "R2", m, R2, e->R2);
    compare(where, "K", n * n, K, e->K);
    compare(where, "B", m * n, B, e->B);
    compare(where, "mu_k", m * n, mu_k, e->mu_k);
}

static void check_projection(const subject *s, const projection_vector *p)
{
    const double shift = (1.0 - p->beta) * p->h;
    double x[2 * N];
    char where[80];
    snprintf(where, sizeof where, "projection of %s (%s), beta %g", p->system, s->kind, p->beta);
    memcpy(x, p->x, sizeof x);
    CHECK(dal_project(s->mechanics, 0.0, shift, x, NULL) == 0);
    compare(where, "q", s->n, x, p->x);
    compare(where, "v", s->n, x + s->n, p->v1);
    check_residual(s, where, shift, x);
}

static void check_chart(const subject *s, const chart_vector *c)
{
    const size_t n = s->n, m = s->m;
    double x[2 * N] = {0.0}, A[M * N], B[M * M], v_dep[M], lambda[M], lambda_E[M];
    char where[80];
    snprintf(where, sizeof where, "ehresmann of %s (%s)", c->system, s->kind);
    dal_chart *const chart = open_chart(s->system);
    memcpy(x, c->xi, n * sizeof *x);
    const char *const text = dal_chart_error(chart)->text;
    check_in(where, text, dal_chart_choose(chart, 0.0, c->dependent, x) == 0);
    check_in(where, text, dal_chart_lift(chart, 0.0, c->xi, x) == 0);
    for (size_t a = 0; a < m; a++) v_dep[a] = x[n + c->dependent[a]];
    compare(where, "v_dep", m, v_dep, c->v_dep);
    CHECK(dal_chart_connection(chart, 0.0, x, A, B) == 0);
    compare(where, "A", m * (n - m), A, c->A);
    compare(where, "B", m * m, B, c->B);
    CHECK(dal_multipliers(s->mechanics, 0.0, x, lambda) == 0);
    compare(where, "multipliers", m, lambda, c->multipliers);
    CHECK(dal_chart_multipliers(chart, 0.0, x, lambda, lambda_E) == 0);
    compare(where, "multipliers of [A, I]", m, lambda_E, c->multipliers_E);
    CHECK(dal_chart_multipliers_back(chart, 0.0, x, c->multipliers_E, lambda) == 0);
    compare(where, "multipliers and back", m, lambda, c->multipliers);
}

/* What passes through the nodes loses u |q|/h of v, and that once more by h of lambda. */
static void check_node(const subject *s, const node_vector *p)
{
    const dal_difference_map map = {.beta = p->beta};
    const size_t n = s->n, m = s->m;
    double q0[N], q1[N], lambda[M], residual[N + M], zero[N + M] = {0.0};
    char where[80];
    snprintf(where, sizeof where, "node of %s (%s), beta %g, h %g", p->system, s->kind, p->beta,
             p->h);
    dal_discrete *const discrete = open_discrete(s->system, map, NULL);
    memcpy(q0, p->before, sizeof q0);
    memcpy(q1, p->q, sizeof q1);
    check_in(where, dal_discrete_error(discrete)->text,
             dal_discrete_step(discrete, 0.0, p->h, q0, q1, lambda) == 0);
    compare(where, "q_k", n, q0, p->q);
    compare(where, "q_(k+1)", n, q1, p->after);
    compare_within(64 * u / (p->h * p->h), where, "lambda", m, lambda, p->multipliers);
    CHECK(dal_discrete_residual(discrete, 0.0, p->h, p->before, p->q, p->after, p->multipliers,
                                residual) == 0);
    compare_within(64 * u / fabs(p->h), where, "residual", n + m, residual, zero);
}

/* ---- end states of the flow --------------------------------------------------------------- */

/* error is that of x; the gradients of lambda and E are at most 10 in these systems. */
static void compare_end(const subject *s, const char *where, double error,
                        const reference_vector *r, const double *x)
{
    double lambda[M], energy;
    compare_within(error, where, "x", 2 * s->n, x, r->x);
    check_residual(s, where, 0.0, x);
    CHECK(dal_multipliers(s->mechanics, 0.0, x, lambda) == 0);
    compare_within(10 * error, where, "multipliers", s->m, lambda, r->multipliers);
    CHECK(dal_energy(s->mechanics, 0.0, x, &energy) == 0);
    compare_within(10 * error, where, "energy", 1, &energy, &r->energy);
}

/* In a unit of time rk8pd takes about 5 steps, each with an error of at most 1e-13 (1 + |x|), and
 * kl8 with h = 1/40 solves 40 * 17 equations that leave some u |x| each, its own error of order 8
 * far below; so 1e-12 a unit of time for both. */
static void check_reference(const subject *s, const reference_vector *r)
{
    char where[80];
    double x[2 * N];
    snprintf(where, sizeof where, "flow of %s (%s), t = %g", r->system, s->kind, r->t);
    dal_flow *const flow = open_flow(s->system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-13);
    memcpy(x, r->x0, sizeof x);
    check_in(where, dal_flow_error(flow)->text, dal_flow_apply(flow, 0.0, r->t, x, NULL) == 0);
    compare_end(s, where, 1e-12 * r->t, r, x);

    const double h = 1.0 / 40.0;
    snprintf(where, sizeof where, "kl8 of %s (%s), t = %g", r->system, s->kind, r->t);
    dal_stepper *const stepper = start_named(s->system, "leapfrog-kl8", h, r->x0);
    check_in(where, dal_stepper_error(stepper)->text,
             dal_advance(stepper, (size_t)lround(r->t / h), NULL, NULL) == 0);
    compare_end(s, where, 1e-12 * r->t, r, dal_stepper_state(stepper));
}

/* ---- all of them -------------------------------------------------------------------------- */

static bool is_of(const subject *s, const char *system) { return strcmp(s->is->name, system) == 0; }

static void check_formulas(const subject *s, const subject *unconstrained)
{
    for (size_t i = 0; i < LENGTH(point_vectors); i++)
        if (is_of(s, point_vectors[i].system)) check_point(s, unconstrained, &point_vectors[i]);
    for (size_t i = 0; i < LENGTH(equations_vectors); i++)
        if (is_of(s, equations_vectors[i].system)) check_equations(s, &equations_vectors[i]);
    for (size_t i = 0; i < LENGTH(projection_vectors); i++)
        if (is_of(s, projection_vectors[i].system)) check_projection(s, &projection_vectors[i]);
    for (size_t i = 0; i < LENGTH(chart_vectors); i++)
        if (is_of(s, chart_vectors[i].system)) check_chart(s, &chart_vectors[i]);
    for (size_t i = 0; i < LENGTH(node_vectors); i++)
        if (is_of(s, node_vectors[i].system)) check_node(s, &node_vectors[i]);
    for (size_t i = 0; i < LENGTH(reference_vectors); i++)
        if (is_of(s, reference_vectors[i].system)) check_reference(s, &reference_vectors[i]);
}

static void check_runs(const subject *s)
{
    for (size_t i = 0; i < LENGTH(run_vectors); i++) {
        const run_vector *const r = &run_vectors[i];
        const bool unconstrained = strcmp(r->group, "unconstrained") == 0;
        if (is_of(s, r->system) && unconstrained == (s->m == 0)) check_run(s, r);
    }
}

int main(void)
{
    for (size_t i = 0; i < LENGTH(vector_systems); i++) {
        const vector_system *const is = &vector_systems[i];
        for (size_t j = 0; j < LENGTH(point_vectors); j++)
            if (strcmp(is->name, point_vectors[j].system) == 0)
                check_transcription(is, &point_vectors[j]);

        const subject unconstrained = open_subject(is, UNCONSTRAINED);
        check_runs(&unconstrained);
        for (int kind = 0; kind < KINDS; kind++) {
            if (kind == UNCONSTRAINED || (kind == BUILTIN && !is->builtin)) continue;
            const subject s = open_subject(is, kind);
            check_formulas(&s, &unconstrained);
            check_runs(&s);
            release(s.system);
        }
        release(unconstrained.system);
    }
    return check_done();
}
