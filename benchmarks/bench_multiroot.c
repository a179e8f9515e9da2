/* bench_multiroot.c - the step of the library against gsl_multiroot hybridsj on the same equations.
 *
 * Two opponents: the family of tests/oracle/multiroot.c, which starts from nothing and
 * checks everything, and a lean loop as one would write it by hand for speed: no checks, straight
 * into GSL's storage, started from the extrapolated unknowns of the last steps, ended as soon as
 * the equations hold to roundoff. */
#include "bench.h"

#include <gsl/gsl_multiroots.h>
#include <math.h>
#include <string.h>

enum { REPETITIONS = 30, SCHUR_STEPS = 20000, HYBRIDSJ_STEPS = 1000, MAX_N = 4, MAX_M = 2 };

static const double step_size = 0.01;

/* ---- the midpoint step by hybridsj, V = 0, diagonal mass --------------------------------- */

typedef struct lean {
    const dal_system_def *def;
    double q[MAX_N], v[MAX_N];                /* the state, at the node q_k while a step is made */
    double mu_node[MAX_M * MAX_N];
    double last[MAX_N + MAX_M], before[MAX_N + MAX_M]; /* unknowns of the two last steps */
    gsl_multiroot_function_fdf equations;
    gsl_multiroot_fdfsolver *solver;
} lean;

/* f = (M (w - v) - mu(q_k)^T kappa, mu(q~') w) with q~' = q_k + h/2 w, unknown (w, kappa). */
static int lean_both(const gsl_vector *unknown, void *ctx, gsl_vector *f, gsl_matrix *J)
{
    const lean *const s = ctx;
    const size_t n = s->def->n, m = s->def->m, size = n + m;
    const double *const w = unknown->data, *const kappa = w + n, half = 0.5 * step_size;
    double q[MAX_N] = {0}, mu[MAX_M * MAX_N], N[MAX_M * MAX_N];
    for (size_t i = 0; i < n; i++) q[i] = s->q[i] + half * w[i];
    s->def->constraint(0.0, q, w, NULL, mu, J ? N : NULL, NULL, NULL);
    for (size_t i = 0; f && i < n; i++) {
        double sum = s->def->mass[i * n + i] * (w[i] - s->v[i]);
        for (size_t a = 0; a < m; a++) sum -= s->mu_node[a * n + i] * kappa[a];
        f->data[i] = sum;
    }
    for (size_t a = 0; f && a < m; a++) {
        double sum = 0.0;
        for (size_t i = 0; i < n; i++) sum += mu[a * n + i] * w[i];
        f->data[n + a] = sum;
    }
    if (!J) return GSL_SUCCESS;
    memset(J->data, 0, size * size * sizeof *J->data);
    for (size_t i = 0; i < n; i++) {
        J->data[i * size + i] = s->def->mass[i * n + i];
        for (size_t a = 0; a < m; a++) {
            J->data[i * size + n + a] = -s->mu_node[a * n + i];
            J->data[(n + a) * size + i] = mu[a * n + i] + half * N[a * n + i];
        }
    }
    return GSL_SUCCESS;
}

static int lean_f(const gsl_vector *unknown, void *ctx, gsl_vector *f)
{
    return lean_both(unknown, ctx, f, NULL);
}

static int lean_df(const gsl_vector *unknown, void *ctx, gsl_matrix *J)
{
    return lean_both(unknown, ctx, NULL, J);
}

static void lean_start(lean *s)
{
    const size_t n = s->def->n;
    memcpy(s->q, s->def->state, n * sizeof *s->q);
    memcpy(s->v, s->def->state + n, n * sizeof *s->v);
    memset(s->last, 0, sizeof s->last);
    memcpy(s->last, s->v, n * sizeof *s->v);
    memcpy(s->before, s->last, sizeof s->last);
}

static void lean_step(lean *s)
{
    enum { MOST = 20 };
    const size_t n = s->def->n, size = n + s->def->m;
    const double half = 0.5 * step_size;
    double guess[MAX_N + MAX_M], scale = 0.0;
    for (size_t i = 0; i < n; i++) {
        s->q[i] += half * s->v[i];
        scale += fabs(s->v[i]);
    }
    s->def->constraint(0.0, s->q, s->v, NULL, s->mu_node, NULL, NULL, NULL);
    for (size_t i = 0; i < size; i++) {
        guess[i] = 2.0 * s->last[i] - s->before[i];
        s->before[i] = s->last[i];
    }
    const gsl_vector_const_view start = gsl_vector_const_view_array(guess, size);
    gsl_multiroot_fdfsolver_set(s->solver, &s->equations, &start.vector);
    for (int iteration = 0; iteration < MOST; iteration++) {
        if (gsl_multiroot_fdfsolver_iterate(s->solver)) break;
        if (gsl_multiroot_test_residual(s->solver->f, 1e-15 * scale) == GSL_SUCCESS) break;
    }
    memcpy(s->last, s->solver->x->data, size * sizeof *s->last);
    for (size_t i = 0; i < n; i++) {
        s->v[i] = s->last[i];
        s->q[i] += half * s->v[i];
    }
}

/* ---- the comparison ---------------------------------------------------------------------- */

/* Seconds of one step. */
static double time_stepper(dal_stepper *stepper, const dal_system_def *def, size_t steps)
{
    bench_start(stepper, def, step_size);
    const double start = bench_now();
    bench_require(dal_advance(stepper, steps, NULL, NULL), "dal_advance");
    return (bench_now() - start) / (double)steps;
}

static double time_lean(lean *s, size_t steps)
{
    lean_start(s);
    const double start = bench_now();
    for (size_t k = 0; k < steps; k++) lean_step(s);
    return (bench_now() - start) / (double)steps;
}

/* The largest difference of three states that should be the same. */
static double difference(const dal_stepper *schur, const dal_stepper *multiroot, const lean *s)
{
    const double *const x = dal_stepper_state(schur), *const y = dal_stepper_state(multiroot);
    double largest = 0.0;
    for (size_t i = 0, n = s->def->n; i < n; i++) {
        largest = fmax(largest, fmax(fabs(x[i] - y[i]), fabs(x[n + i] - y[n + i])));
        largest = fmax(largest, fmax(fabs(x[i] - s->q[i]), fabs(x[n + i] - s->v[i])));
    }
    return largest;
}

static bool compare(const dal_system_def *def)
{
    dal_system *system;
    bench_require(dal_system_new(&system, def, NULL), "dal_system_new");
    dal_stepper *const schur = bench_stepper(BY_LIBRARY, system);
    dal_stepper *const multiroot = bench_stepper(BY_MULTIROOT, system);
    lean by_hand = {.def = def};
    by_hand.equations =
        (gsl_multiroot_function_fdf){lean_f, lean_df, lean_both, def->n + def->m, &by_hand};
    by_hand.solver =
        gsl_multiroot_fdfsolver_alloc(gsl_multiroot_fdfsolver_hybridsj, def->n + def->m);

    double fast = INFINITY, slow = INFINITY, lean_time = INFINITY;
    for (int repetition = 0; repetition < REPETITIONS; repetition++) {
        bench_keep_least(&fast, time_stepper(schur, def, SCHUR_STEPS));
        bench_keep_least(&slow, time_stepper(multiroot, def, HYBRIDSJ_STEPS));
        bench_keep_least(&lean_time, time_lean(&by_hand, HYBRIDSJ_STEPS));
    }
    time_stepper(schur, def, HYBRIDSJ_STEPS);

    printf("step of the %s, midpoint, h = %g\n", def->name, step_size);
    bench_report("library", 1e9 * fast, "ns");
    bench_report("family multiroot", 1e9 * slow, "ns");
    bench_report("lean loop over hybridsj", 1e9 * lean_time, "ns");
    bool kept = bench_at_least("family multiroot / library", slow / fast, 10.0);
    kept &= bench_at_least("lean loop over hybridsj / library", lean_time / fast, 8.0);
    /* 1000 steps, roundoff 1e-15 each in numbers of size 10 */
    kept &= bench_at_most("difference of the states after 1000 steps / 1e-11",
                          1e11 * difference(schur, multiroot, &by_hand), 1.0);
    gsl_multiroot_fdfsolver_free(by_hand.solver);
    dal_stepper_free(schur);
    dal_stepper_free(multiroot);
    dal_system_free(system);
    return kept;
}

int main(void)
{
    bool kept = true;
    for (int i = 0; i < BENCH_SYSTEMS; i++) kept &= compare(&bench_systems[i]);
    return kept ? EXIT_SUCCESS : EXIT_FAILURE;
}
