/* Floor 3: a system examined at one state: its derivatives, the rank of mu, the definiteness of M,
 * and whether D is involutive.
 *
 * Eigenvalues and singular values are those of products with the Cholesky factor L of M = L L^T:
 * of M on R^n the squares of those of L, of M on ker mu those of X L with the rows of X an
 * orthonormal basis, of mu in the mass metric those of mu L^-T. */
#include "internal.h"

#include <gsl/gsl_linalg.h>

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* A derivative may be off by this much, relative to 1 + its size.  The differences are far better,
 * unless the function oscillates within 1/80 of the unit of q. */
static const double derivative_tolerance = 1e-7;

/* Errors of roundoff in sums of terms that were computed in a few operations. */
static const double sum_tolerance = 1e-12;

/* Curvature that comes from roundoff and differences, relative to the terms that cancel, and as
 * 1/length. */
static const double curvature_tolerance = 1e-8, curvature_floor = 1e-10;

typedef struct examination {
    dal_mechanics mech;
    const dal_system *system;
    const double *x, *q, *v;      /* the state, and its halves */
    size_t n, m;
    dal_check found;
    double *point, *other;        /* [n]: a moved q, and a velocity that is not in D */
    const double *velocity;       /* [n]: of the mu v that is differenced */
    double *value, *slope;        /* [n] scratch of the differences */
    double *gradient, *hessian;   /* [n], [n*n] */
    double *forms;                /* [m*n] */
    double *phi;                  /* [m] */
    double *factor;               /* [n*n] L */
    double *rows, *squares;       /* [n*n], [n]: whose singular values are sought */
    double *QR, *tau;             /* [n*m], [m]: mu^T = Q R */
    double *X;                    /* [(n-m)*n] rows: an orthonormal basis of ker mu */
    double *N;                    /* [(n-m)*m*n] N(q, X_k) = d(mu X_k)/dq */
} examination;

/* Keeps the first thing that is wrong. */
#if defined(__GNUC__)
__attribute__((format(printf, 2, 3)))
#endif
static void complain(dal_check *found, const char *format, ...)
{
    if (found->text[0]) return;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(found->text, sizeof found->text, format, arguments);
    va_end(arguments);
}

/* ---- derivatives ------------------------------------------------------------------------- */

static int value_V(const double *q, double *V, void *ctx)
{
    dal_mechanics *const mech = &((examination *)ctx)->mech;
    return dal__potential(&mech->eval, q, V, NULL, NULL, &mech->error);
}

static int value_V_q(const double *q, double *V_q, void *ctx)
{
    dal_mechanics *const mech = &((examination *)ctx)->mech;
    return dal__potential(&mech->eval, q, NULL, V_q, NULL, &mech->error);
}

static int value_phi(const double *q, double *phi, void *ctx)
{
    examination *const ex = ctx;
    dal_mechanics *const mech = &ex->mech;
    const int status = dal__constraint(&mech->eval, q, ex->velocity, NULL, ex->forms, NULL,
                                       &mech->error);
    if (!status) dal__apply(ex->m, ex->n, ex->forms, ex->velocity, phi);
    return status;
}

/* The rows x n matrix of derivatives given[] against differences of f. */
static int compare(examination *ex, dal__function f, size_t rows, const double *given,
                   dal_difference *worst)
{
    for (size_t j = 0; j < ex->n; j++) {
        memcpy(ex->point, ex->q, ex->n * sizeof *ex->point);
        const int status = dal__difference(f, ex, ex->point, j, rows, ex->value, ex->slope, 1);
        if (status) return status;
        for (size_t i = 0; i < rows; i++) {
            const double number = given[i * ex->n + j], expected = ex->slope[i];
            const double error = fabs(number - expected) / (1.0 + fabs(expected));
            if (worst->checked && error <= worst->error) continue;
            *worst = (dal_difference){.error = error, .given = number, .expected = expected,
                                      .row = i, .column = j, .checked = 1};
        }
    }
    return DAL_SUCCESS;
}

/* size: of the values that were differenced, whose roundoff (a few u) is divided by the spacing
 * 2^-12 of the differences. */
static void judge(examination *ex, const char *name, const char *function, double size,
                  const dal_difference *worst)
{
    if (worst->error <= derivative_tolerance + 32.0 * DAL_ROUNDOFF * 0x1p12 * size) return;
    complain(&ex->found, "%s[%zu,%zu] is given as %.10g, but differences of %s are %.10g (error "
             "%.1e)", name, worst->row, worst->column, worst->given, function, worst->expected,
             worst->error);
}

static int examine_potential(examination *ex)
{
    dal_mechanics *const mech = &ex->mech;
    const unsigned missing = ex->system->def.missing;
    const bool has_V_q = !(missing & DAL_MISSING_V_Q), has_V_qq = !(missing & DAL_MISSING_V_QQ);
    if (!ex->system->def.potential) return DAL_SUCCESS;
    double V;
    int status = dal__potential(&mech->eval, ex->q, &V, ex->gradient, has_V_qq ? ex->hessian : NULL,
                                &mech->error);
    if (!status && has_V_q) status = compare(ex, value_V, 1, ex->gradient, &ex->found.V_q);
    if (!status && has_V_qq) status = compare(ex, value_V_q, ex->n, ex->hessian, &ex->found.V_qq);
    if (status) return status;
    if (has_V_q) judge(ex, "V_q", "V", fabs(V), &ex->found.V_q);
    if (has_V_qq) {
        /* a differenced gradient has lost the spacing's worth of digits before */
        const double size = dal__largest(ex->n, ex->gradient) + (has_V_q ? 0.0 : 0x1p12 * fabs(V));
        judge(ex, "V_qq", "V_q", size, &ex->found.V_qq);
    }
    return DAL_SUCCESS;
}

/* phi_q at two velocities: at the given one it may vanish altogether. */
static int examine_phi_q(examination *ex)
{
    dal_mechanics *const mech = &ex->mech;
    const double *const velocities[2] = {ex->v, ex->other};
    double size = 0.0;
    if (ex->system->def.missing & DAL_MISSING_PHI_Q) return DAL_SUCCESS;
    for (int k = 0; k < 2; k++) {
        ex->velocity = velocities[k];
        int status = dal__constraint(&mech->eval, ex->q, ex->velocity, NULL, mech->mu, mech->dmu,
                                     &mech->error);
        if (!status) status = compare(ex, value_phi, ex->m, mech->dmu, &ex->found.phi_q);
        if (status) return status;
        size = fmax(size, dal__largest(ex->n, ex->velocity) * dal__largest(ex->m * ex->n, mech->mu));
    }
    judge(ex, "phi_q", "phi_v v", size, &ex->found.phi_q);
    return DAL_SUCCESS;
}

/* ---- linearity --------------------------------------------------------------------------- */

/* mu must be the same at both velocities; and phi, where the callback gives it, mu v.  Leaves mu
 * in mech.mu. */
static int examine_linearity(examination *ex)
{
    dal_mechanics *const mech = &ex->mech;
    const dal_system_def *const def = &ex->system->def;
    const size_t n = ex->n, m = ex->m;
    int status = dal__constraint(&mech->eval, ex->q, ex->v, NULL, mech->mu, NULL, &mech->error);
    if (!status)
        status = dal__constraint(&mech->eval, ex->q, ex->other, NULL, ex->forms, NULL, &mech->error);
    if (status) return status;
    ex->found.linearity = 0.0;
    for (size_t k = 0; k < m * n; k++) {
        const double change = fabs(ex->forms[k] - mech->mu[k]);
        if (change > sum_tolerance * fabs(mech->mu[k]))
            complain(&ex->found, "phi_v[%zu,%zu] is %.10g at v and %.10g at another velocity: mu "
                     "must not depend on v", k / n, k % n, mech->mu[k], ex->forms[k]);
        ex->found.linearity = fmax(ex->found.linearity, change);
    }
    for (size_t a = 0; a < m; a++) ex->phi[a] = (double)NAN;
    const int returned = def->constraint(ex->q, ex->other, ex->phi, ex->forms, NULL, def->ctx);
    if (returned)
        return dal__fail(&mech->error, dal__callback_status(returned), "constraint returned %d "
                         "when phi was asked for", returned);
    for (size_t a = 0; a < m; a++) {
        double sum = 0.0, scale = 0.0;
        for (size_t i = 0; i < n; i++) {
            sum += mech->mu[a * n + i] * ex->other[i];
            scale += fabs(mech->mu[a * n + i] * ex->other[i]);
        }
        if (isfinite(ex->phi[a]) && fabs(ex->phi[a] - sum) > sum_tolerance * scale)
            complain(&ex->found, "phi[%zu] is given as %.10g, but phi_v v is %.10g: linear "
                     "constraints have phi = mu v", a, ex->phi[a], sum);
    }
    return DAL_SUCCESS;
}

/* ---- rank and definiteness --------------------------------------------------------------- */

static double smallest(size_t count, const double *x)
{
    double least = x[0];
    for (size_t i = 1; i < count; i++) least = fmin(least, x[i]);
    return least;
}

/* The smallest eigenvalue of A A^T; destroys A[count*n]. */
static double smallest_eigenvalue(examination *ex, size_t count, double *A)
{
    const double unit = dal__singular_values(count, ex->n, A, ex->squares);
    return unit * unit * smallest(count, ex->squares);
}

static void examine_mass(examination *ex)
{
    const size_t n = ex->n;
    memcpy(ex->factor, ex->system->mass, n * n * sizeof *ex->factor);
    dal__cholesky(n, ex->factor, NULL, NULL); /* definite, or there would be no system */
    memcpy(ex->rows, ex->factor, n * n * sizeof *ex->rows);
    ex->found.mass_min = smallest_eigenvalue(ex, n, ex->rows);
}

/* Rank of mu with rows of length 1, so that constraints may have different units. */
static size_t rank_of(examination *ex, const double *mu)
{
    const size_t n = ex->n, m = ex->m;
    for (size_t a = 0; a < m; a++) {
        const double *const form = mu + a * n;
        const double unit = dal__largest(n, form);
        double square = 0.0;
        for (size_t i = 0; i < n && unit > 0.0; i++) square += form[i] / unit * (form[i] / unit);
        for (size_t i = 0; i < n; i++)
            ex->rows[a * n + i] = unit > 0.0 ? form[i] / unit / sqrt(square) : 0.0;
    }
    dal__singular_values(m, n, ex->rows, ex->squares);
    const double least = 4.0 * (double)n * DBL_EPSILON * sqrt(dal__largest(m, ex->squares));
    size_t rank = 0;
    for (size_t a = 0; a < m; a++) rank += sqrt(ex->squares[a]) > least;
    return rank;
}

/* Condition of mu L^-T, whose rows are y = L^-1 mu^a. */
static double condition_of(examination *ex, const double *mu)
{
    const size_t n = ex->n, m = ex->m;
    for (size_t a = 0; a < m; a++) {
        double *const y = ex->rows + a * n;
        for (size_t i = 0; i < n; i++)
            y[i] = (mu[a * n + i] - dal__dot(i, ex->factor + i * n, y)) / ex->factor[i * n + i];
    }
    dal__singular_values(m, n, ex->rows, ex->squares);
    const double least = smallest(m, ex->squares);
    return least > 0.0 ? sqrt(dal__largest(m, ex->squares) / least) : (double)INFINITY;
}

/* X and R from mu^T = Q R: the columns of Q after the first m are orthogonal to the forms. */
static void split(examination *ex, const double *mu)
{
    const size_t n = ex->n, m = ex->m;
    for (size_t i = 0; i < n; i++)
        for (size_t a = 0; a < m; a++) ex->QR[i * m + a] = mu[a * n + i];
    gsl_matrix_view QR = gsl_matrix_view_array(ex->QR, n, m);
    gsl_vector_view tau = gsl_vector_view_array(ex->tau, m);
    gsl_linalg_QR_decomp(&QR.matrix, &tau.vector);
    memset(ex->X, 0, (n - m) * n * sizeof *ex->X);
    for (size_t k = 0; k < n - m; k++) {
        double *const x = ex->X + k * n;
        gsl_vector_view column = gsl_vector_view_array(x, n);
        x[m + k] = 1.0;
        gsl_linalg_QR_Qvec(&QR.matrix, &tau.vector, &column.vector);
    }
}

/* The smallest eigenvalue of X M X^T = (X L)(X L)^T. */
static double kernel_min(examination *ex)
{
    const size_t n = ex->n, count = ex->n - ex->m;
    for (size_t k = 0; k < count; k++)
        for (size_t j = 0; j < n; j++) {
            double sum = 0.0; /* L is lower triangular */
            for (size_t i = j; i < n; i++) sum += ex->X[k * n + i] * ex->factor[i * n + j];
            ex->rows[k * n + j] = sum;
        }
    return smallest_eigenvalue(ex, count, ex->rows);
}

/* mu in mech.mu.  Also asks for lambda: C, which all schemes invert, squares the condition. */
static int examine_rank(examination *ex)
{
    dal_mechanics *const mech = &ex->mech;
    dal_check *const found = &ex->found;
    found->rank = rank_of(ex, mech->mu);
    found->condition = condition_of(ex, mech->mu);
    if (found->rank < ex->m) {
        complain(found, "mu has rank %zu instead of %zu: a constraint vanishes or follows from the "
                 "others", found->rank, ex->m);
        return DAL_SUCCESS;
    }
    split(ex, mech->mu);
    found->kernel_min = kernel_min(ex);
    if (!(found->mass_min > 0.0 && found->kernel_min > 0.0))
        complain(found, "M is not positive definite on ker mu: its smallest eigenvalue is %g",
                 found->kernel_min);
    const int status = dal_multipliers(mech, 0.0, ex->x, mech->lambda);
    if (status != DAL_ESINGULAR) return status;
    complain(found, "mu M^-1 mu^T is singular to working precision: the condition of mu is %.3g",
             found->condition);
    return DAL_SUCCESS;
}

/* ---- involutivity ------------------------------------------------------------------------ */

/* The length of the vector orthogonal to D that mu maps to r: that of R^-T r; destroys r[m]. */
static double length_across(const examination *ex, double *r)
{
    const size_t m = ex->m;
    const double *const R = ex->QR;
    double square = 0.0;
    for (size_t a = 0; a < m; a++) {
        for (size_t b = 0; b < a; b++) r[a] -= R[b * m + a] * r[b];
        r[a] /= R[a * m + a];
        square += r[a] * r[a];
    }
    return sqrt(square);
}

/* Vector fields X, Y in D have mu [X, Y] = N(q,X) Y - N(q,Y) X.  *curvature <- the length of [X, Y]
 * across D, the largest over the basis; *scale <- that of its two terms, the largest.  Neither
 * depends on how mu is scaled or combined. */
static int examine_curvature(examination *ex, const double *q, double *curvature, double *scale)
{
    dal_mechanics *const mech = &ex->mech;
    const size_t n = ex->n, m = ex->m, count = n - m;
    int status = dal__constraint(&mech->eval, q, ex->v, NULL, mech->mu, NULL, &mech->error);
    if (status) return status;
    split(ex, mech->mu);
    for (size_t k = 0; k < count && !status; k++)
        status = dal__constraint(&mech->eval, q, ex->X + k * n, NULL, NULL, ex->N + k * m * n,
                                 &mech->error);
    if (status) return status;
    double *const here = ex->value, *const there = ex->slope, *const bracket = ex->phi;
    *curvature = *scale = 0.0;
    for (size_t k = 0; k < count; k++)
        for (size_t l = 0; l < k; l++) {
            dal__apply(m, n, ex->N + k * m * n, ex->X + l * n, here);
            dal__apply(m, n, ex->N + l * m * n, ex->X + k * n, there);
            for (size_t a = 0; a < m; a++) bracket[a] = here[a] - there[a];
            *curvature = fmax(*curvature, length_across(ex, bracket));
            *scale = fmax(*scale, fmax(length_across(ex, here), length_across(ex, there)));
        }
    return DAL_SUCCESS;
}

static bool is_flat(double curvature, double scale)
{
    return curvature <= curvature_tolerance * scale + curvature_floor;
}

/* The curvature may vanish at a single point; so D counts as integrable only if that is so at some
 * points nearby as well, as far as they are in the domain of the constraint. */
static int examine_involutivity(examination *ex)
{
    enum { NEARBY = 4 };
    double scale;
    if (ex->n - ex->m == 1) { /* a single field commutes with itself */
        ex->found.curvature = 0.0;
        ex->found.integrable = 1;
        return DAL_SUCCESS;
    }
    int status = examine_curvature(ex, ex->q, &ex->found.curvature, &scale);
    if (status) return status;
    bool flat = is_flat(ex->found.curvature, scale);
    for (int k = 1; k <= NEARBY && flat; k++) {
        double curvature;
        for (size_t i = 0; i < ex->n; i++)
            ex->point[i] = ex->q[i] + 0.1 * (1.0 + fabs(ex->q[i])) * cos((double)(i + 1) * k);
        status = examine_curvature(ex, ex->point, &curvature, &scale);
        if (status == DAL_EDOMAIN) continue;
        if (status) return status;
        flat = is_flat(curvature, scale);
    }
    ex->found.integrable = flat;
    return DAL_SUCCESS;
}

/* ---- the report -------------------------------------------------------------------------- */

static int examine_constraint(examination *ex)
{
    dal_check *const found = &ex->found;
    int status = examine_phi_q(ex);
    if (!status) status = examine_linearity(ex);
    if (!status) status = examine_rank(ex);
    if (!status) status = dal_relative_residual(&ex->mech, 0.0, ex->x, &found->residual);
    if (!status && found->rank == ex->m) status = examine_involutivity(ex);
    if (!status && !(found->residual <= DAL_CONSISTENT))
        complain(found, "(q, v) is not in D: |mu v| is %.3g of sum |mu_i v_i|, more than %g",
                 found->residual, DAL_CONSISTENT);
    return status;
}

/* Without constraints D is all of TQ. */
static void examine_no_constraint(examination *ex)
{
    ex->found.kernel_min = ex->found.mass_min;
    ex->found.linearity = ex->found.residual = ex->found.curvature = 0.0;
    ex->found.condition = 1.0;
    ex->found.integrable = 1;
}

static void summarize(const examination *ex, dal_check *found)
{
    char *const text = found->text;
    const size_t size = sizeof found->text;
    if (ex->m == 0) {
        snprintf(text, size, "the derivatives given agree with differences; no constraints");
        return;
    }
    char shape[128];
    if (ex->n - ex->m == 1)
        snprintf(shape, sizeof shape, "D has dimension n - m = 1, which is always integrable");
    else if (found->integrable)
        snprintf(shape, sizeof shape, "D is integrable here and nearby: it may be a holonomic "
                 "constraint in disguise");
    else
        snprintf(shape, sizeof shape, "D is not integrable, its curvature here is %.3g",
                 found->curvature);
    snprintf(text, size, "the derivatives given agree with differences; mu has rank %zu and "
             "condition %.3g; (q, v) lies in D to %.1e; %s", found->rank, found->condition,
             found->residual, shape);
}

static void reserve(examination *ex, arena *a)
{
    const size_t n = ex->n, m = ex->m, nn = dal__times(n, n), mn = dal__times(m, n);
    dal__mechanics_reserve(&ex->mech, ex->system, a);
    dal__reserve(a, &ex->point, n, sizeof(double));
    dal__reserve(a, &ex->other, n, sizeof(double));
    dal__reserve(a, &ex->value, n, sizeof(double));
    dal__reserve(a, &ex->slope, n, sizeof(double));
    dal__reserve(a, &ex->gradient, n, sizeof(double));
    dal__reserve(a, &ex->hessian, nn, sizeof(double));
    dal__reserve(a, &ex->forms, mn, sizeof(double));
    dal__reserve(a, &ex->phi, m, sizeof(double));
    dal__reserve(a, &ex->factor, nn, sizeof(double));
    dal__reserve(a, &ex->rows, nn, sizeof(double));
    dal__reserve(a, &ex->squares, n, sizeof(double));
    dal__reserve(a, &ex->QR, mn, sizeof(double));
    dal__reserve(a, &ex->tau, m, sizeof(double));
    dal__reserve(a, &ex->X, dal__times(n - m, n), sizeof(double));
    dal__reserve(a, &ex->N, dal__times(n - m, mn), sizeof(double));
}

/* A velocity in general position, of the size of v. */
static void choose_other(examination *ex)
{
    const double size = 1.0 + dal__largest(ex->n, ex->v);
    for (size_t i = 0; i < ex->n; i++)
        ex->other[i] = ex->v[i] + size * (1.0 + 0.5 * sin((double)(i + 1)));
}

int dal_system_check(const dal_system *system, const double *x, dal_check *report,
                     dal_error *error)
{
    dal__fail(error, DAL_SUCCESS, "%s", "");
    if (!system || !x || !report)
        return dal__fail(error, DAL_EINVAL, "%s is NULL",
                         !system ? "system" : !x ? "x" : "report");
    const size_t n = system->def.n;
    for (size_t i = 0; i < 2 * n; i++)
        if (!isfinite(x[i]))
            return dal__fail(error, DAL_EINVAL, "x[%zu] = %g is not finite", i, x[i]);

    examination ex = {.system = system, .x = x, .q = x, .v = x + n, .n = n, .m = system->def.m};
    dal_check *const found = &ex.found;
    arena memory = {0};
    reserve(&ex, &memory);
    int status = dal__allocate(&memory, error);
    if (status) return status;
    dal__mechanics_bind(&ex.mech, system);
    choose_other(&ex);

    const double unknown = (double)NAN; /* stays where the examination does not come to an end */
    found->linearity = found->condition = found->mass_min = found->kernel_min = unknown;
    found->residual = found->curvature = unknown;
    examine_mass(&ex);
    status = examine_potential(&ex);
    if (!status && ex.m == 0) examine_no_constraint(&ex);
    if (!status && ex.m > 0) status = examine_constraint(&ex);
    if (status) {
        dal__fail(error, status, "%s", ex.mech.error.text);
        snprintf(found->text, sizeof found->text, "%s", ex.mech.error.text);
    }
    found->passed = !found->text[0];
    if (found->passed) summarize(&ex, found);
    dal__release(&memory);
    if (status == DAL_SUCCESS || status == DAL_EDOMAIN) *report = *found;
    return status;
}
