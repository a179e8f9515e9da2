/* Beta-steps by gsl_multiroot hybridsj in all n + m unknowns (w, kappa).
 *
 * Slow, and on purpose: it shares no formula with kernel.h, so it is a check of it. */
#include "oracle/multiroot.h"

#include "discrete/discrete.h"
#include "step/beta.h"
#include "step/scheme.h"
#include "step/stepper.h"

#include <gsl/gsl_multiroots.h>
#include <math.h>
#include <string.h>

typedef struct multiroot {
    size_t n, m;
    size_t substeps;
    dal_substep *substep;
    gsl_multiroot_fdfsolver *solver;
    gsl_multiroot_function_fdf equations;
    dal_mechanics *mech;           /* of the step that is being solved */
    double *K, *B;                 /* [n*n], [m*n] */
    double *w, *kappa, *R1, *R2;   /* [n], [m], [n], [m] */
    double *x;                     /* [2n] the new state */
    double *impulse;               /* [m] of the steps so far */
    double *guess;                 /* [n+m] */
    int status;                    /* of the last evaluation: hybridsj does not hand it on */
    arena arena;
} multiroot;

static int evaluate(const gsl_vector *unknown, void *ctx, gsl_vector *f, gsl_matrix *J)
{
    multiroot *const s = ctx;
    const size_t n = s->n, m = s->m;
    for (size_t i = 0; i < n; i++) s->w[i] = gsl_vector_get(unknown, i);
    for (size_t a = 0; a < m; a++) s->kappa[a] = gsl_vector_get(unknown, n + a);
    if (!dal__all_finite(n, s->w) || !dal__all_finite(m, s->kappa)) {
        s->status = dal__fail(&s->mech->error, DAL_ENOCONV, "hybridsj took an infinite step: its "
                              "Jacobian is singular, or h = %g is too large", s->mech->start.h);
        return GSL_EBADFUNC;
    }
    s->status = dal__step_at(s->mech, s->w, s->kappa, s->R1, s->R2, J ? s->K : NULL, NULL,
                             J ? s->B : NULL);
    if (s->status) return GSL_EBADFUNC;
    for (size_t i = 0; f && i < n; i++) gsl_vector_set(f, i, s->R1[i]);
    for (size_t a = 0; f && a < m; a++) gsl_vector_set(f, n + a, s->R2[a]);
    if (!J) return GSL_SUCCESS;
    gsl_matrix_set_zero(J);
    for (size_t i = 0; i < n; i++) {
        for (size_t j = 0; j < n; j++) gsl_matrix_set(J, i, j, s->K[i * n + j]);
        for (size_t a = 0; a < m; a++) {
            gsl_matrix_set(J, i, n + a, -s->mech->muk[a * n + i]);
            gsl_matrix_set(J, n + a, i, s->B[a * n + i]);
        }
    }
    return GSL_SUCCESS;
}

static int residual(const gsl_vector *x, void *ctx, gsl_vector *f)
{
    return evaluate(x, ctx, f, NULL);
}

static int jacobian(const gsl_vector *x, void *ctx, gsl_matrix *J)
{
    return evaluate(x, ctx, NULL, J);
}

static int both(const gsl_vector *x, void *ctx, gsl_vector *f, gsl_matrix *J)
{
    return evaluate(x, ctx, f, J);
}

static void release(void *method)
{
    multiroot *const solver = method;
    if (solver->solver) gsl_multiroot_fdfsolver_free(solver->solver);
    arena memory = solver->arena; /* the object lies inside it */
    dal__release(&memory);
}

static int make(void **method, dal_motion *motion, dal_error *error)
{
    const size_t n = dal_system_n(motion->system), m = dal_system_m(motion->system), mn = m * n;
    multiroot shape = {.n = n, .m = m, .substeps = dal__scheme_count(motion->scheme)}, *self;
    arena memory = {0};
    int status = dal__beta_check(motion->scheme, error);
    if (status) return status;
    dal__reserve(&memory, &self, 1, sizeof *self);
    dal__reserve(&memory, &shape.substep, shape.substeps, sizeof *shape.substep);
    dal__reserve(&memory, &shape.K, n * n, sizeof(double));
    dal__reserve(&memory, &shape.B, mn, sizeof(double));
    dal__reserve(&memory, &shape.w, n, sizeof(double));
    dal__reserve(&memory, &shape.kappa, m, sizeof(double));
    dal__reserve(&memory, &shape.R1, n, sizeof(double));
    dal__reserve(&memory, &shape.R2, m, sizeof(double));
    dal__reserve(&memory, &shape.x, 2 * n, sizeof(double));
    dal__reserve(&memory, &shape.impulse, m, sizeof(double));
    dal__reserve(&memory, &shape.guess, n + m, sizeof(double));
    status = dal__allocate(&memory, error);
    if (status) return status;
    *self = shape;
    self->arena = memory;
    for (size_t j = 0; j < self->substeps; j++)
        self->substep[j] = dal__scheme_substep(motion->scheme, j);
    self->equations = (gsl_multiroot_function_fdf){residual, jacobian, both, n + m, self};
    self->solver = gsl_multiroot_fdfsolver_alloc(gsl_multiroot_fdfsolver_hybridsj, n + m);
    *method = self;
    return DAL_SUCCESS;
}

/* hybridsj anew from unknown, which may be its own. */
static void start(multiroot *s, const gsl_vector *unknown)
{
    const size_t size = s->n + s->m;
    for (size_t i = 0; i < size; i++) s->guess[i] = gsl_vector_get(unknown, i);
    const gsl_vector_const_view guess = gsl_vector_const_view_array(s->guess, size);
    gsl_multiroot_fdfsolver_set(s->solver, &s->equations, &guess.vector);
}

/* Iterates until the steps are at the level of roundoff, or no longer shrink. */
static int iterate(multiroot *s, dal_stats *stats)
{
    enum { MOST = 200 };
    double last = HUGE_VAL;
    int iteration = 1;
    for (; iteration <= MOST; iteration++) {
        const int returned = gsl_multiroot_fdfsolver_iterate(s->solver);
        stats->iterations++;
        if (s->status) return s->status;
        const gsl_vector *const unknown = gsl_multiroot_fdfsolver_root(s->solver);
        const gsl_vector *const change = gsl_multiroot_fdfsolver_dx(s->solver);
        double size = 0.0, scale = s->mech->start.base;
        for (size_t i = 0; i < s->n; i++) {
            size += fabs(gsl_vector_get(change, i));
            scale += fabs(gsl_vector_get(unknown, i));
        }
        if (!(size <= DBL_MAX)) break;
        const bool stuck = returned == GSL_ENOPROG || returned == GSL_ENOPROGJ;
        if (size <= 4.0 * DAL_ROUNDOFF * scale) return DAL_SUCCESS;
        if ((stuck || (iteration >= 2 && size >= last)) && size <= 1e-11 * scale)
            return DAL_SUCCESS;
        if (returned && !stuck) break;
        last = size;
        /* a guess near 0 gives a trust region of that size, too small for the way to the root */
        if (stuck) {
            start(s, unknown);
            if (s->status) return s->status;
            last = HUGE_VAL;
        }
    }
    return dal__fail(&s->mech->error, DAL_ENOCONV, "hybridsj did not converge in %d iterations",
                     iteration);
}

/* hybridsj does not notice that a constraint that is satisfied vanishes, or follows from others. */
static int refuse_singular(multiroot *s)
{
    const double t = s->mech->start.end;
    const dal__forms *const at = &s->mech->forms;
    int status = dal__constraint(&s->mech->eval, t, at->q, s->w, NULL, at->mu, NULL, NULL,
                                 &s->mech->error);
    if (!status) status = dal__build_metric(s->mech, t, at->q, s->w);
    if (status || s->m == 0) return status;
    return dal__factor_gram(s->mech);
}

/* One beta-scheme from x[2n], in place, into s->kappa. */
static int solve(multiroot *s, dal_mechanics *mech, double t, double end, double beta, double h,
                 bool kept, double *x, dal_stats *stats)
{
    const size_t n = s->n, m = s->m;
    s->mech = mech;
    s->status = dal__step_begin(mech, t, end, beta, beta, h, kept, x);
    if (s->status) return s->status;
    memcpy(s->guess, x + n, n * sizeof *s->guess);
    memset(s->guess + n, 0, m * sizeof *s->guess);
    const gsl_vector_const_view guess = gsl_vector_const_view_array(s->guess, n + m);
    start(s, &guess.vector);
    int status = s->status ? s->status : iterate(s, stats);
    if (status) return status;

    const gsl_vector *const root = gsl_multiroot_fdfsolver_root(s->solver);
    for (size_t i = 0; i < n; i++) s->w[i] = gsl_vector_get(root, i);
    status = refuse_singular(s);
    if (status) return status;
    status = dal__step_settle(mech, s->w, s->x, &stats->worst_residual);
    if (status) return status;
    memcpy(x, s->x, 2 * n * sizeof *x);
    for (size_t a = 0; a < m; a++) s->kappa[a] = gsl_vector_get(root, n + a);
    return DAL_SUCCESS;
}

static int advance(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    multiroot *const self = method;
    const bool kept = motion->scheme->nodes == DAL_KEPT_NODES;
    const double h = motion->h;
    double *const x = motion->mechanics->point; /* [2n] */
    for (*done = 0; *done < steps; ++*done) {
        double passed = 0.0;
        memcpy(x, motion->x, 2 * self->n * sizeof *x);
        memcpy(self->impulse, motion->impulse, self->m * sizeof *x);
        for (size_t j = 0; j < self->substeps; j++) {
            const dal_substep s = self->substep[j];
            const double number = (double)(motion->steps + *done);
            const double next = j + 1 < self->substeps ? passed + s.fraction : 1.0;
            const int status =
                solve(self, motion->mechanics, motion->t0 + (number + passed) * h,
                      motion->t0 + (number + next) * h, s.beta, s.fraction * h, kept, x,
                      motion->stats);
            if (status) return status;
            for (size_t a = 0; a < self->m; a++) self->impulse[a] += self->kappa[a];
            passed = next;
        }
        memcpy(motion->x, x, 2 * self->n * sizeof *x);
        memcpy(motion->impulse, self->impulse, self->m * sizeof *x);
    }
    return DAL_SUCCESS;
}

const dal_family multiroot_family = {
    .name = "multiroot", .make = make, .free = release, .advance = advance};
