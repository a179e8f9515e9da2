/* Projections of a velocity onto D or D_eps, in the metric M. */
#include "geometry/geometry.h"
#include "dalembert/residual.h"

#include <math.h>

/* The velocity of x, or w, moves by -Z^T (mu Z^T)^-1 phi with the factors in C. */
static void find_change(dal_mechanics *mech, double *change)
{
    dal__linear_solve(&mech->gram.C, mech->forms.phi, mech->lambda);
    dal__clear(mech->n, change);
    for (size_t a = 0; a < mech->m; a++)
        dal__row_add(mech, mech->lambda[a], mech->gram.Z, a, change);
    for (size_t i = 0; i < mech->n; i++)
        change[i] = -change[i]; /* where it is 0 a velocity of -0.0 stays one */
}

int dal__mend(dal_mechanics *mech, double t, double shift, bool along_Z, double *x,
              double *relative)
{
    enum { MOST = 8 }; /* a pass leaves of the residual as much as the condition times u */
    const size_t n = mech->n;
    double *const v = x + n;
    const dal__forms *const at = &mech->forms;
    const double before = dal_residual_speed(n, mech->metric.per_unit, v);
    double last = HUGE_VAL;
    for (int pass = 1;; pass++) {
        const double bound = dal__residual_bound(mech) / (pass <= MOST ? 2.0 : 1.0);
        int status = dal__forms_at(mech, t, shift, x, false);
        if (status) return status;
        const double without = dal__relative_residual(mech, at->mu, at->phi, v, NULL);
        *relative = without;
        if (without <= bound) return DAL_SUCCESS;
        if (without > 0.5 * last || pass > MOST) { /* it stays: is it the rounding of q and t? */
            status = dal__measure_moves(mech, t, shift, v);
            if (status) return status;
            *relative = dal__relative_residual(mech, at->mu, at->phi, v, at->moves);
            if (*relative <= bound) return DAL_SUCCESS;
        }
        last = without;
        if (!along_Z) dal__build_Z(mech, at->mu);
        if (pass > MOST) {
            dal__fail(&mech->error, DAL_ESINGULAR, "the relative residual of the constraint stays "
                      "at %.3g, allowed is %.3g", *relative, bound);
            if (!dal__name_dependent(mech, at->mu, mech->gram.Z, DAL_RANK_ALMOST_LOST,
                                     &mech->error))
                dal__add_words(&mech->error, ": mu M^-1 mu^T is singular to working precision, or "
                               "terms of phi cancel (write (y - 100)^2 instead of y^2 - 200 y + "
                               "10000)");
            return DAL_ESINGULAR;
        }
        status = dal__factor_product(mech);
        if (status) return status;
        find_change(mech, mech->step);
        dal__add(n, 1.0, mech->step, v);
        /* A velocity across D, of which each pass leaves its own roundoff, is zero. */
        const double speed = dal_residual_speed(n, mech->metric.per_unit, v);
        if (pass == MOST && speed <= dal__residual_bound(mech) * before)
            dal__clear(n, v);
        if (shift != 0.0) dal__move(n, at->q, shift, v, x);
    }
}

/* sqrt(d^T M d); d[n] is destroyed, as its squares might overflow. */
static double mass_norm(dal_mechanics *mech, double *d)
{
    const double largest = dal__largest(mech->n, d);
    for (size_t i = 0; largest > 0.0 && i < mech->n; i++) d[i] /= largest;
    dal__weigh(mech, d, mech->step);
    return largest * sqrt(fmax(0.0, dal__dot(mech->n, d, mech->step)));
}

static double moves(void *ctx)
{
    dal_mechanics *const mech = ctx;
    return dal__velocity_moves(mech, mech->t, mech->shift, mech->point + mech->n);
}

/* The step of Newton for phi(q - shift v, v) = 0 with v of mech->point, along the rows of Z. */
static int find_step(dal__newton *equations)
{
    dal_mechanics *const mech = equations->ctx;
    const dal__forms *const at = &mech->forms;
    const double shift = mech->shift;
    dal__move_node(mech, shift, mech->point);
    int status = dal__evaluate_forms(mech, mech->t, mech->point + mech->n, shift != 0.0);
    if (status) return status;
    if (shift != 0.0) dal__add(dal__entries(&mech->eval), -shift, at->dmu, at->mu);
    status = dal__factor_product(mech);
    if (!status) find_change(mech, equations->step);
    return status;
}

/* The velocity of mech->point <- that of D, or of D_eps, which belongs to it; Z says along what. */
static int find_velocity(dal_mechanics *mech, double t, double shift)
{
    const size_t n = mech->n;
    const double *const per_unit = mech->metric.per_unit;
    double *const v = mech->point + n;
    int status = DAL_SUCCESS;
    mech->relative = 0.0;
    if (mech->m == 0) return DAL_SUCCESS;
    if (shift != 0.0 || mech->eval.system->def.kind == DAL_NONLINEAR) {
        mech->t = t;
        mech->shift = shift;
        dal__newton equations = {.find_step = find_step, .moves = moves, .ctx = mech, .size = n,
                                 .measured = n, .n = n, .per_unit = per_unit, .z = v,
                                 .step = mech->step, .base = dal_residual_extent(n, per_unit, v),
                                 .advice = shift == 0.0
                                     ? "the constraint may have no solution v here"
                                     : "the constraint of D_eps may have no solution v here"};
        status = dal__newton_run(&equations, &mech->error);
    }
    if (status || shift != 0.0) return status;
    status = dal__mend(mech, t, 0.0, true, mech->point, &mech->relative);
    /* without full rank it is refused for any v */
    return status ? status : dal__factor_product(mech);
}

/* The velocity of x[2n] moves along Z, unless it would overflow. */
static int move_velocity(dal_mechanics *mech, double t, double shift, double *x, double *distance)
{
    const size_t n = mech->n;
    const double *const v = mech->point + n;
    dal__copy(2 * n, x, mech->point);
    const int status = find_velocity(mech, t, shift);
    if (status) return status;
    dal__move(n, v, -1.0, x + n, mech->w);
    const double moved = mass_norm(mech, mech->w);
    return DAL__DELIVER(&mech->error, {"consistent velocity", n, v, x + n},
                        {"distance", 1, &moved, distance});
}

int dal_project(dal_mechanics *mech, double t, double shift, double *x, double *distance)
{
    int status = dal__require_state(mech, "x", x, shift, t, x);
    if (!status) status = dal__forms_at(mech, t, 0.0, x, false);
    if (status) return status;
    dal__build_Z(mech, mech->forms.mu);
    return move_velocity(mech, t, shift, x, distance);
}

void dal__add_impulse_of(dal_mechanics *mech, const double *change, double *impulse)
{
    double *const along = mech->forms.phi;
    for (size_t a = 0; a < mech->m; a++)
        along[a] = dal__row_dot(mech, mech->forms.mu, a, change);
    dal__linear_solve(&mech->gram.C, along, along);
    dal__add(mech->m, 1.0, along, impulse);
}

/* Z <- the directions in which the free components alone may move, [M_ff^-1 mu_f^T, 0]: those of
 * the saddle point system of min (w-v)^T M (w-v) with mu w = 0 and w_i = v_i for the kept i. */
static size_t build_free_Z(dal_mechanics *mech, const unsigned char *keep)
{
    const size_t n = mech->n;
    const dal_rows *const rows = mech->eval.rows;
    double *const factor = mech->hessian;
    size_t free_count = 0;
    for (size_t i = 0; i < n; i++) free_count += !keep[i];
    if (mech->metric.masses) {
        dal__build_Z(mech, mech->forms.mu);
        for (size_t e = 0; e < dal__entries(&mech->eval); e++)
            if (keep[rows ? rows->column[e] : e % n]) mech->gram.Z[e] = 0.0;
        return free_count;
    }
    for (size_t i = 0; i < n; i++) {
        for (size_t j = 0; j < n; j++)
            factor[i * n + j] = keep[i] || keep[j] ? i == j : mech->metric.M[i * n + j];
    }
    dal__cholesky(n, factor, mech->w, NULL, NULL); /* a principal part of M is definite, as M is */
    for (size_t a = 0; a < mech->m; a++) {
        double *const row = mech->gram.Z + a * n;
        for (size_t i = 0; i < n; i++) row[i] = keep[i] ? 0.0 : mech->forms.mu[a * n + i];
        dal__cholesky_solve(n, factor, row);
    }
    return free_count;
}

int dal_consistent(dal_mechanics *mech, double t, const unsigned char *keep, double *x,
                   double *distance)
{
    if (!keep) return dal_project(mech, t, 0.0, x, distance);
    int status = dal__require_state(mech, "x", x, 0.0, t, x);
    if (!status) status = dal__forms_at(mech, t, 0.0, x, false);
    if (status) return status;
    const size_t n = mech->n, free_count = build_free_Z(mech, keep);
    status = move_velocity(mech, t, 0.0, x, distance);
    if (status == DAL_ESINGULAR) {
        dal__fail(&mech->error, DAL_ESINGULAR, "keep fixes %zu of %zu velocities: mu restricted to "
                  "the other %zu has rank below m = %zu; fix fewer", n - free_count, n, free_count,
                  mech->m);
        dal__name_dependent(mech, mech->forms.mu, mech->gram.Z, DAL_RANK_ALMOST_LOST, &mech->error);
    }
    if (status == DAL_ENOCONV && free_count < n)
        return dal__fail(&mech->error, DAL_ENOCONV, "found no velocity that satisfies the "
                         "constraint with %zu of %zu components fixed by keep: there may be none",
                         n - free_count, n);
    return status;
}
