/* Floor 6: one beta-step by gsl_multiroot hybridsj in all n + m unknowns (w, kappa).
 *
 * Slow, and on purpose: it shares no formula with kernel.h, so it is a check of it. */
#include "internal.h"

#include <gsl/gsl_multiroots.h>
#include <math.h>
#include <string.h>

struct multiroot {
    dal_mechanics mech;
    size_t n, m;
    gsl_multiroot_fdfsolver *solver;
    gsl_multiroot_function_fdf equations;
    double beta, h;
    const double *start;           /* [2n] the state that the step starts from */
    double *K, *B, *muk;           /* [n*n], [m*n], [m*n] */
    double *w, *kappa, *R1, *R2;   /* [n], [m], [n], [m] */
    double *x;                     /* [2n] the new state */
    double *guess;                 /* [n+m] */
    size_t iterations;
    int status;                    /* of the last evaluation: hybridsj does not hand it on */
    dal_error error;
    arena arena;
};

const char *dal__multiroot_message(const multiroot *solver) { return solver->error.text; }
size_t dal__multiroot_iterations(const multiroot *solver) { return solver->iterations; }
evaluator *dal__multiroot_evaluator(multiroot *solver) { return &solver->mech.eval; }

static int evaluate(const gsl_vector *unknown, void *ctx, gsl_vector *f, gsl_matrix *J)
{
    multiroot *const s = ctx;
    const size_t n = s->n, m = s->m;
    for (size_t i = 0; i < n; i++) s->w[i] = gsl_vector_get(unknown, i);
    for (size_t a = 0; a < m; a++) s->kappa[a] = gsl_vector_get(unknown, n + a);
    if (!dal__all_finite(n, s->w) || !dal__all_finite(m, s->kappa)) {
        s->status = dal__fail(&s->mech.error, DAL_ENOCONV, "hybridsj took an infinite step: its "
                              "Jacobian is singular, or h = %g is too large", s->h);
        return GSL_EBADFUNC;
    }
    s->status = dal_step_equations(&s->mech, s->beta, s->h, s->start, s->w, s->kappa, s->R1, s->R2,
                                   J ? s->K : NULL, J ? s->B : NULL, J ? s->muk : NULL);
    if (s->status) return GSL_EBADFUNC;
    for (size_t i = 0; f && i < n; i++) gsl_vector_set(f, i, s->R1[i]);
    for (size_t a = 0; f && a < m; a++) gsl_vector_set(f, n + a, s->R2[a]);
    if (!J) return GSL_SUCCESS;
    gsl_matrix_set_zero(J);
    for (size_t i = 0; i < n; i++) {
        for (size_t j = 0; j < n; j++) gsl_matrix_set(J, i, j, s->K[i * n + j]);
        for (size_t a = 0; a < m; a++) {
            gsl_matrix_set(J, i, n + a, -s->muk[a * n + i]);
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

int dal__multiroot_new(multiroot **solver, const dal_system *system, dal_error *error)
{
    const size_t n = system->def.n, m = system->def.m, mn = dal__times(m, n);
    multiroot shape = {.n = n, .m = m}, *self;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    dal__mechanics_reserve(&shape.mech, system, &memory);
    dal__reserve(&memory, &shape.K, dal__times(n, n), sizeof(double));
    dal__reserve(&memory, &shape.B, mn, sizeof(double));
    dal__reserve(&memory, &shape.muk, mn, sizeof(double));
    dal__reserve(&memory, &shape.w, n, sizeof(double));
    dal__reserve(&memory, &shape.kappa, m, sizeof(double));
    dal__reserve(&memory, &shape.R1, n, sizeof(double));
    dal__reserve(&memory, &shape.R2, m, sizeof(double));
    dal__reserve(&memory, &shape.x, dal__times(2, n), sizeof(double));
    dal__reserve(&memory, &shape.guess, n + m, sizeof(double));
    const int status = dal__allocate(&memory, error);
    if (status) return status;
    *self = shape;
    self->arena = memory;
    dal__mechanics_bind(&self->mech, system);
    self->equations = (gsl_multiroot_function_fdf){residual, jacobian, both, n + m, self};
    self->solver = gsl_multiroot_fdfsolver_alloc(gsl_multiroot_fdfsolver_hybridsj, n + m);
    if (!self->solver) {
        dal__multiroot_free(self);
        return dal__fail(error, DAL_ENOMEM, "gsl_multiroot_fdfsolver_alloc failed for %zu unknowns",
                         n + m);
    }
    *solver = self;
    return DAL_SUCCESS;
}

void dal__multiroot_free(multiroot *solver)
{
    if (!solver) return;
    if (solver->solver) gsl_multiroot_fdfsolver_free(solver->solver);
    arena memory = solver->arena; /* the object lies inside it */
    dal__release(&memory);
}

/* Iterates until the steps are at the level of roundoff, or no longer shrink. */
static int iterate(multiroot *s)
{
    enum { MOST = 200 };
    double last = HUGE_VAL;
    for (s->iterations = 1; s->iterations <= MOST; s->iterations++) {
        const int returned = gsl_multiroot_fdfsolver_iterate(s->solver);
        if (s->status) {
            s->error = s->mech.error;
            return s->status;
        }
        const gsl_vector *const unknown = gsl_multiroot_fdfsolver_root(s->solver);
        const gsl_vector *const change = gsl_multiroot_fdfsolver_dx(s->solver);
        double size = 0.0, scale = 0.0;
        for (size_t i = 0; i < s->n; i++) {
            size += fabs(gsl_vector_get(change, i));
            scale += fabs(gsl_vector_get(unknown, i)) + fabs(s->start[s->n + i]);
        }
        if (!(size <= DBL_MAX)) break;
        const bool stuck = returned == GSL_ENOPROG || returned == GSL_ENOPROGJ;
        if (size <= 4.0 * DAL_ROUNDOFF * scale) return DAL_SUCCESS;
        if ((stuck || (s->iterations >= 2 && size >= last)) && size <= 1e-11 * scale)
            return DAL_SUCCESS;
        if (returned && !stuck) break;
        if (stuck) break;
        last = size;
    }
    return dal__fail(&s->error, DAL_ENOCONV, "hybridsj did not converge in %zu iterations",
                     s->iterations);
}

int dal__multiroot_step(multiroot *solver, double beta, double h, double *x, double *kappa)
{
    multiroot *const s = solver;
    const size_t n = s->n, m = s->m;
    s->beta = beta;
    s->h = h;
    s->start = x;
    s->status = DAL_SUCCESS;
    memcpy(s->guess, x + n, n * sizeof *s->guess);
    memset(s->guess + n, 0, m * sizeof *s->guess);
    const gsl_vector_const_view guess = gsl_vector_const_view_array(s->guess, n + m);
    gsl_multiroot_fdfsolver_set(s->solver, &s->equations, &guess.vector);
    int status = s->status;
    if (status)
        s->error = s->mech.error;
    else
        status = iterate(s);
    if (status) return status;

    const gsl_vector *const root = gsl_multiroot_fdfsolver_root(s->solver);
    for (size_t i = 0; i < n; i++) {
        const double w = gsl_vector_get(root, i);
        s->x[i] = x[i] + (1.0 - beta) * h * x[n + i] + beta * h * w;
        s->x[n + i] = w;
    }
    if (!dal__all_finite(2 * n, s->x))
        return dal__fail(&s->error, DAL_EDOMAIN, "the new state overflows with h = %g", h);
    status = dal_project(&s->mech, 0.0, s->x, NULL); /* the final correction */
    if (status) {
        s->error = s->mech.error;
        return status;
    }
    memcpy(x, s->x, 2 * n * sizeof *x);
    for (size_t a = 0; a < m; a++) kappa[a] = gsl_vector_get(root, n + a);
    return DAL_SUCCESS;
}
