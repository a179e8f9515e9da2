/* Floor 3: mechanics on D: energy, C, lambda, the vector field, projections, equations of a step.
 *
 * Throughout Z holds the rows M^-1 mu^a, so that C = mu Z^T. */
#include "internal.h"
#include "lu.h"

#include <math.h>
#include <string.h>

void dal__mechanics_reserve(dal_mechanics *mech, const dal_system *system, arena *a)
{
    const size_t n = system->def.n, m = system->def.m;
    const size_t mn = dal__times(m, n), mm = dal__times(m, m);
    dal__evaluator_reserve(&mech->eval, system, a);
    dal__reserve(a, &mech->mu, mn, sizeof(double));
    dal__reserve(a, &mech->dmu, mn, sizeof(double));
    dal__reserve(a, &mech->Z, mn, sizeof(double));
    dal__reserve(a, &mech->C, mm, sizeof(double));
    dal__reserve(a, &mech->scale, mm, sizeof(double));
    dal__reserve(a, &mech->row, m, sizeof(size_t));
    dal__reserve(a, &mech->force, n, sizeof(double));
    dal__reserve(a, &mech->q, n, sizeof(double));
    dal__reserve(a, &mech->w, n, sizeof(double));
    dal__reserve(a, &mech->step, n, sizeof(double));
    dal__reserve(a, &mech->lambda, m, sizeof(double));
    dal__reserve(a, &mech->residual, m, sizeof(double));
    dal__reserve(a, &mech->hessian, dal__times(n, n), sizeof(double));
}

void dal__mechanics_bind(dal_mechanics *mech, const dal_system *system)
{
    mech->n = system->def.n;
    mech->m = system->def.m;
    dal__evaluator_bind(&mech->eval, system);
}

int dal_mechanics_new(dal_mechanics **mechanics, const dal_system *system, dal_error *error)
{
    dal__fail(error, DAL_SUCCESS, "%s", "");
    if (!mechanics || !system)
        return dal__fail(error, DAL_EINVAL, "%s is NULL", mechanics ? "system" : "mechanics");
    arena memory = {0};
    dal_mechanics shape = {0}, *self;
    dal__reserve(&memory, &self, 1, sizeof *self);
    dal__mechanics_reserve(&shape, system, &memory);
    const int status = dal__allocate(&memory, error);
    if (status) return status;
    *self = shape;
    self->arena = memory;
    dal__mechanics_bind(self, system);
    *mechanics = self;
    return DAL_SUCCESS;
}

void dal_mechanics_free(dal_mechanics *mechanics)
{
    if (!mechanics) return;
    arena memory = mechanics->arena; /* the object lies inside it */
    dal__release(&memory);
}

const char *dal_mechanics_message(const dal_mechanics *mechanics) { return mechanics->error.text; }

static double dot(size_t n, const double *a, const double *b)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

static const double *velocity(const dal_mechanics *mech, const double *x) { return x + mech->n; }

static int null_argument(dal_mechanics *mech, const char *name)
{
    return dal__fail(&mech->error, DAL_EINVAL, "%s is NULL", name);
}

static int require_finite(dal_mechanics *mech, const char *name, size_t count, const double *x)
{
    if (!x) return null_argument(mech, name);
    for (size_t i = 0; i < count; i++)
        if (!isfinite(x[i]))
            return dal__fail(&mech->error, DAL_EINVAL, "%s[%zu] = %g is not finite", name, i, x[i]);
    return DAL_SUCCESS;
}

/* B Z^T with the scale of its entries; C for B = mu. */
static void form_gram(dal_mechanics *mech, const double *B)
{
    const size_t n = mech->n, m = mech->m;
    for (size_t a = 0; a < m; a++)
        for (size_t b = 0; b < m; b++) {
            double sum = 0.0, scale = 0.0;
            for (size_t i = 0; i < n; i++) {
                const double term = B[a * n + i] * mech->Z[b * n + i];
                sum += term;
                scale += fabs(term);
            }
            mech->C[a * m + b] = sum;
            mech->scale[a * m + b] = scale;
        }
}

static int factor_gram(dal_mechanics *mech)
{
    if (dal_lu_factor(mech->m, mech->n, mech->C, mech->scale, mech->row)) return DAL_SUCCESS;
    return dal__fail(&mech->error, DAL_ESINGULAR, "mu M^-1 mu^T is singular: mu does not have full "
                     "rank, or two constraints coincide (pivot %zu of %zu)", mech->row[0], mech->m);
}

static void form_Z(dal_mechanics *mech, const double *mu)
{
    const size_t n = mech->n;
    for (size_t a = 0; a < mech->m; a++)
        dal__apply(n, n, mech->eval.system->mass_inverse, mu + a * n, mech->Z + a * n);
}

/* Energy. */

int dal_energy(dal_mechanics *mechanics, const double *x, double *E)
{
    if (!mechanics) return DAL_EINVAL;
    if (!E) return null_argument(mechanics, "E");
    dal_mechanics *const mech = mechanics;
    const size_t n = mech->n;
    double V = 0.0;
    int status = require_finite(mech, "x", 2 * n, x);
    if (!status) status = dal__potential(&mech->eval, x, &V, NULL, NULL, &mech->error);
    if (status) return status;
    dal__apply(n, n, mech->eval.system->mass, velocity(mech, x), mech->step);
    *E = 0.5 * dot(n, velocity(mech, x), mech->step) + V;
    return DAL_SUCCESS;
}

/* Residuals. */

/* mu at q - shift v; with a contiguous copy of that point in mech->q. */
static int forms_at(dal_mechanics *mech, double shift, const double *x, double *dmu)
{
    const size_t n = mech->n;
    const double *const v = velocity(mech, x);
    for (size_t i = 0; i < n; i++) mech->q[i] = x[i] - shift * v[i];
    return dal__constraint(&mech->eval, mech->q, v, mech->mu, dmu, &mech->error);
}

int dal_residual(dal_mechanics *mechanics, double shift, const double *x, double *residual)
{
    if (!mechanics) return DAL_EINVAL;
    if (!residual) return null_argument(mechanics, "residual");
    dal_mechanics *const mech = mechanics;
    int status = require_finite(mech, "shift", 1, &shift);
    if (!status) status = require_finite(mech, "x", 2 * mech->n, x);
    if (!status) status = forms_at(mech, shift, x, NULL);
    if (status) return status;
    dal__apply(mech->m, mech->n, mech->mu, velocity(mech, x), residual);
    return DAL_SUCCESS;
}

/* max_a |mu^a v| / sum_i |mu^a_i v_i| with the forms in mech->mu. */
static double relative_residual(const dal_mechanics *mech, const double *v)
{
    double worst = 0.0;
    for (size_t a = 0; a < mech->m; a++) {
        double sum = 0.0, scale = 0.0;
        for (size_t i = 0; i < mech->n; i++) {
            const double term = mech->mu[a * mech->n + i] * v[i];
            sum += term;
            scale += fabs(term);
        }
        if (fabs(sum) > worst * scale) worst = fabs(sum) / scale;
    }
    return worst;
}

int dal_relative_residual(dal_mechanics *mechanics, double shift, const double *x, double *worst)
{
    if (!mechanics) return DAL_EINVAL;
    if (!worst) return null_argument(mechanics, "worst");
    dal_mechanics *const mech = mechanics;
    int status = require_finite(mech, "shift", 1, &shift);
    if (!status) status = require_finite(mech, "x", 2 * mech->n, x);
    if (!status) status = forms_at(mech, shift, x, NULL);
    if (status) return status;
    *worst = relative_residual(mech, velocity(mech, x));
    return DAL_SUCCESS;
}

/* The ODE on D. */

int dal_gram(dal_mechanics *mechanics, const double *q, double *C)
{
    if (!mechanics) return DAL_EINVAL;
    if (!C) return null_argument(mechanics, "C");
    dal_mechanics *const mech = mechanics;
    int status = require_finite(mech, "q", mech->n, q);
    memset(mech->w, 0, mech->n * sizeof *mech->w); /* linear constraints: mu does not depend on v */
    if (!status) status = dal__constraint(&mech->eval, q, mech->w, mech->mu, NULL, &mech->error);
    if (status) return status;
    form_Z(mech, mech->mu);
    form_gram(mech, mech->mu);
    memcpy(C, mech->C, mech->m * mech->m * sizeof *C);
    return DAL_SUCCESS;
}

/* lambda in mech->lambda, V_q in mech->force, mu in mech->mu. */
static int solve_multipliers(dal_mechanics *mech, const double *x)
{
    const size_t n = mech->n, m = mech->m;
    const double *const v = velocity(mech, x);
    int status = require_finite(mech, "x", 2 * n, x);
    if (!status) status = dal__potential(&mech->eval, x, NULL, mech->force, NULL, &mech->error);
    if (!status)
        status = dal__constraint(&mech->eval, x, v, mech->mu, mech->dmu, &mech->error);
    if (status || m == 0) return status;
    form_Z(mech, mech->mu);
    form_gram(mech, mech->mu);
    for (size_t a = 0; a < m; a++)
        mech->residual[a] = dot(n, mech->Z + a * n, mech->force) - dot(n, mech->dmu + a * n, v);
    status = factor_gram(mech);
    if (!status) dal_lu_solve(m, mech->C, mech->row, mech->residual, mech->lambda);
    return status;
}

int dal_multipliers(dal_mechanics *mechanics, double t, const double *x, double *lambda)
{
    (void)t;
    if (!mechanics) return DAL_EINVAL;
    if (!lambda) return null_argument(mechanics, "lambda");
    const int status = solve_multipliers(mechanics, x);
    if (status) return status;
    memcpy(lambda, mechanics->lambda, mechanics->m * sizeof *lambda);
    return DAL_SUCCESS;
}

int dal_acceleration(dal_mechanics *mechanics, double t, const double *x, double *vdot)
{
    (void)t;
    if (!mechanics) return DAL_EINVAL;
    if (!vdot) return null_argument(mechanics, "vdot");
    dal_mechanics *const mech = mechanics;
    const size_t n = mech->n;
    const int status = solve_multipliers(mech, x);
    if (status) return status;
    for (size_t i = 0; i < n; i++) {
        double sum = -mech->force[i];
        for (size_t a = 0; a < mech->m; a++) sum += mech->mu[a * n + i] * mech->lambda[a];
        mech->step[i] = sum;
    }
    dal__apply(n, n, mech->eval.system->mass_inverse, mech->step, vdot);
    return DAL_SUCCESS;
}

int dal_field(dal_mechanics *mechanics, double t, const double *x, double *xdot)
{
    if (!mechanics) return DAL_EINVAL;
    if (!xdot) return null_argument(mechanics, "xdot");
    const size_t n = mechanics->n;
    const int status = dal_acceleration(mechanics, t, x, mechanics->w);
    if (status) return status;
    memmove(xdot, x + n, n * sizeof *xdot);
    memcpy(xdot + n, mechanics->w, n * sizeof *xdot);
    return DAL_SUCCESS;
}

/* Projections. */

static double mass_norm(dal_mechanics *mech, const double *d)
{
    dal__apply(mech->n, mech->n, mech->eval.system->mass, d, mech->step);
    return sqrt(fmax(0.0, dot(mech->n, d, mech->step)));
}

/* x takes the velocity mech->w, unless that overflowed. */
static int accept(dal_mechanics *mech, double *x, double *distance)
{
    const size_t n = mech->n;
    for (size_t i = 0; i < n; i++)
        if (!isfinite(mech->w[i]))
            return dal__fail(&mech->error, DAL_EDOMAIN, "the consistent velocity overflows: "
                             "v[%zu] = %g from %g", i, mech->w[i], x[n + i]);
    for (size_t i = 0; i < n; i++) {
        const double w = mech->w[i];
        mech->w[i] -= x[n + i];
        x[n + i] = w;
    }
    if (distance) *distance = mass_norm(mech, mech->w);
    return DAL_SUCCESS;
}

/* The velocity w of D_q or D_eps on the ray v + M^-1 mu(q)^T kappa, in mech->w.  Its equation
 * mu(q - shift w) w = 0 is linear for shift = 0; then the second pass mends the roundoff of the
 * first. */
static int project(dal_mechanics *mech, double shift, const double *x)
{
    enum { MOST = 50 };
    const size_t n = mech->n, m = mech->m;
    double last = INFINITY;
    int status = forms_at(mech, 0.0, x, NULL);
    if (status) return status;
    form_Z(mech, mech->mu);
    memcpy(mech->w, velocity(mech, x), n * sizeof *mech->w);
    for (int iteration = 1;; iteration++) {
        for (size_t i = 0; i < n; i++) mech->q[i] = x[i] - shift * mech->w[i];
        status = dal__constraint(&mech->eval, mech->q, mech->w, mech->mu,
                                 shift != 0.0 ? mech->dmu : NULL, &mech->error);
        if (status) return status;
        for (size_t a = 0; a < m; a++) mech->residual[a] = -dot(n, mech->mu + a * n, mech->w);
        if (shift != 0.0)
            for (size_t k = 0; k < m * n; k++) mech->mu[k] -= shift * mech->dmu[k];
        form_gram(mech, mech->mu);
        status = factor_gram(mech);
        if (status) return status;
        dal_lu_solve(m, mech->C, mech->row, mech->residual, mech->lambda);
        double size = 0.0, scale = 0.0;
        for (size_t i = 0; i < n; i++) {
            double step = 0.0;
            for (size_t a = 0; a < m; a++) step += mech->Z[a * n + i] * mech->lambda[a];
            mech->w[i] += step;
            size += fabs(step);
            scale += fabs(mech->w[i]) + fabs(velocity(mech, x)[i]);
        }
        if (shift == 0.0 && iteration == 2) return DAL_SUCCESS;
        if (size <= 4.0 * DAL_ROUNDOFF * scale) return DAL_SUCCESS;
        if (iteration >= 2 && size <= 1e-11 * scale && size >= last) return DAL_SUCCESS;
        if (iteration == MOST || !(size <= DBL_MAX))
            return dal__fail(&mech->error, DAL_ENOCONV, "no velocity of D_eps was found in %d "
                             "iterations (shift = %g, last change %g)", iteration, shift, size);
        last = size;
    }
}

int dal_project(dal_mechanics *mechanics, double shift, double *x, double *distance)
{
    if (!mechanics) return DAL_EINVAL;
    dal_mechanics *const mech = mechanics;
    const size_t n = mech->n;
    int status = require_finite(mech, "shift", 1, &shift);
    if (!status) status = require_finite(mech, "x", 2 * n, x);
    if (!status && mech->m > 0) status = project(mech, shift, x);
    if (status) return status;
    if (mech->m == 0) memcpy(mech->w, x + n, n * sizeof *mech->w);
    return accept(mech, x, distance);
}

/* min (w-v)^T M (w-v) with mu w = 0 and w_i = v_i for the kept i: the saddle point system
 *     [[M, -mu^T, -E^T], [mu, 0, 0], [E, 0, 0]] (w - v, kappa, reaction) = (0, -mu v, 0)
 * reduced to the free components f: M_ff d = mu_f^T kappa, mu_f d = -mu v. */
static int consistent(dal_mechanics *mech, const unsigned char *keep)
{
    const size_t n = mech->n, m = mech->m;
    const double *const M = mech->eval.system->mass;
    double *factor, *column;
    arena scratch = {0};
    dal__reserve(&scratch, &factor, dal__times(n, n), sizeof *factor);
    dal__reserve(&scratch, &column, n, sizeof *column);
    const int status = dal__allocate(&scratch, &mech->error);
    if (status) return status;

    size_t entries = 0, free_count = 0;
    for (size_t i = 0; i < n; i++) {
        if (keep[i]) continue;
        free_count++;
        for (size_t j = 0; j < n; j++)
            if (!keep[j]) factor[entries++] = M[i * n + j];
    }
    dal__cholesky(free_count, factor, NULL, NULL); /* a principal part of M is definite, as M is */
    memset(mech->Z, 0, m * n * sizeof *mech->Z);
    for (size_t a = 0; a < m; a++) {
        size_t k = 0;
        for (size_t i = 0; i < n; i++)
            if (!keep[i]) column[k++] = mech->mu[a * n + i];
        dal__cholesky_solve(free_count, factor, column);
        k = 0;
        for (size_t i = 0; i < n; i++)
            if (!keep[i]) mech->Z[a * n + i] = column[k++];
    }
    dal__release(&scratch);

    form_gram(mech, mech->mu);
    if (!dal_lu_factor(m, n, mech->C, mech->scale, mech->row))
        return dal__fail(&mech->error, DAL_ESINGULAR, "%zu of %zu components are kept: mu "
                         "restricted to the other %zu has rank below m = %zu", n - free_count, n,
                         free_count, m);
    for (int pass = 0; pass < 2; pass++) { /* the second mends the roundoff of the first */
        for (size_t a = 0; a < m; a++) mech->residual[a] = -dot(n, mech->mu + a * n, mech->w);
        dal_lu_solve(m, mech->C, mech->row, mech->residual, mech->lambda);
        for (size_t i = 0; i < n; i++)
            for (size_t a = 0; a < m; a++) mech->w[i] += mech->Z[a * n + i] * mech->lambda[a];
    }
    return DAL_SUCCESS;
}

int dal_consistent(dal_mechanics *mechanics, const unsigned char *keep, double *x, double *distance)
{
    if (!keep) return dal_project(mechanics, 0.0, x, distance);
    if (!mechanics) return DAL_EINVAL;
    dal_mechanics *const mech = mechanics;
    const size_t n = mech->n;
    int status = require_finite(mech, "x", 2 * n, x);
    if (!status) status = forms_at(mech, 0.0, x, NULL);
    if (status) return status;
    memcpy(mech->w, x + n, n * sizeof *mech->w);
    if (mech->m > 0) status = consistent(mech, keep);
    return status ? status : accept(mech, x, distance);
}

/* The equations of a step. */

int dal_step_equations(dal_mechanics *mechanics, double beta, double h, const double *x,
                       const double *w, const double *kappa, double *R1, double *R2, double *K,
                       double *B, double *muk)
{
    if (!mechanics) return DAL_EINVAL;
    dal_mechanics *const mech = mechanics;
    const size_t n = mech->n, m = mech->m;
    const double *const v = velocity(mech, x), *const M = mech->eval.system->mass;
    if (!(beta >= 0.0 && beta <= 1.0))
        return dal__fail(&mech->error, DAL_EINVAL, "beta = %g is not in [0, 1]", beta);
    int status = require_finite(mech, "h", 1, &h);
    if (!status) status = require_finite(mech, "x", 2 * n, x);
    if (!status) status = require_finite(mech, "w", n, w);
    if (!status && m > 0) status = require_finite(mech, "kappa", m, kappa);
    if (status) return status;

    /* mu at the node q_k goes to Z, mu at q1 to mu; the gradient at q~ to step, at q1 to force */
    for (size_t i = 0; i < n; i++) mech->q[i] = x[i] + (1.0 - beta) * h * v[i];
    status = dal__constraint(&mech->eval, mech->q, v, mech->Z, NULL, &mech->error);
    for (size_t i = 0; i < n; i++) mech->q[i] += beta * h * w[i];
    if (!status)
        status = dal__constraint(&mech->eval, mech->q, w, mech->mu, mech->dmu, &mech->error);
    if (!status) status = dal__potential(&mech->eval, x, NULL, mech->step, NULL, &mech->error);
    if (!status)
        status = dal__potential(&mech->eval, mech->q, NULL, mech->force, K ? mech->hessian : NULL,
                                &mech->error);
    if (status) return status;

    for (size_t i = 0; R1 && i < n; i++) {
        double sum = h * ((1.0 - beta) * mech->force[i] + beta * mech->step[i]);
        for (size_t j = 0; j < n; j++) sum += M[i * n + j] * (w[j] - v[j]);
        for (size_t a = 0; a < m; a++) sum -= mech->Z[a * n + i] * kappa[a];
        R1[i] = sum;
    }
    if (R2) dal__apply(m, n, mech->mu, w, R2);
    for (size_t k = 0; K && k < n * n; k++)
        K[k] = M[k] + h * h * beta * (1.0 - beta) * mech->hessian[k];
    for (size_t k = 0; B && k < m * n; k++) B[k] = mech->mu[k] + beta * h * mech->dmu[k];
    if (muk) memcpy(muk, mech->Z, m * n * sizeof *muk);
    return DAL_SUCCESS;
}

int dal_trajectory(dal_mechanics *mechanics, double t0, double h, double shift, size_t count,
                   const double *x, double *energy, double *multipliers, double *residual,
                   double *relative, size_t *done)
{
    (void)t0, (void)h;
    if (done) *done = 0;
    if (!mechanics) return DAL_EINVAL;
    if (!x && count > 0) return null_argument(mechanics, "x");
    dal_mechanics *const mech = mechanics;
    const size_t n = mech->n, m = mech->m;
    int status = require_finite(mech, "shift", 1, &shift);
    for (size_t k = 0; !status && k < count; k++, x += 2 * n) {
        double E = 0.0;
        status = require_finite(mech, "x", 2 * n, x);
        if (!status && energy) status = dal_energy(mech, x, &E);
        if (!status && multipliers) status = solve_multipliers(mech, x);
        if (!status && (residual || relative)) status = forms_at(mech, shift, x, NULL);
        if (status) return status;
        /* nothing of a row is written before all of it is known */
        if (energy) energy[k] = E;
        if (multipliers) memcpy(multipliers + k * m, mech->lambda, m * sizeof *multipliers);
        if (residual) dal__apply(m, n, mech->mu, x + n, residual + k * m);
        if (relative) relative[k] = relative_residual(mech, x + n);
        if (done) *done = k + 1;
    }
    return status;
}
