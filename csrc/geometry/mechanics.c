/* Mechanics on D: energy, C, lambda, the vector field, projections.
 *
 * Throughout mu is phi_v, Z holds the rows M^-1 mu^a with M = L_vv, and C = mu Z^T. */
#include "geometry/geometry.h"
#include "dalembert/residual.h"

#include <math.h>
#include <string.h>

void dal__mechanics_reserve(dal_mechanics *mech, const dal_system *system, arena *a)
{
    const size_t n = system->def.n, m = system->def.m;
    dal__evaluator_reserve(&mech->eval, system, a);
    const bool lean = mech->eval.lean, nonlinear = system->def.kind == DAL_NONLINEAR;
    const size_t mn = dal__entries(&mech->eval), nn = dal__times(n, n), twice = dal__times(2, n);
    DAL__RESERVE(a, n, &mech->forms.q, &mech->force, &mech->w, &mech->step, &mech->momentum,
                 &mech->reach, &mech->node, &mech->trial, &mech->place);
    DAL__RESERVE(a, m, &mech->forms.phi, &mech->forms.phi_t, &mech->forms.moves, &mech->lambda);
    DAL__RESERVE(a, mn, &mech->forms.mu, &mech->forms.dmu, &mech->gram.Z, &mech->muk);
    if (!lean) DAL__RESERVE(a, nn, &mech->hessian);
    DAL__RESERVE(a, twice, &mech->point);
    dal__linear_reserve_pattern(&mech->gram.C, m, lean ? system->pattern : NULL, a);
    if (!system->mass) {
        dal__metric *const metric = &mech->metric;
        DAL__RESERVE(a, n, &metric->unit, &metric->per_unit, &mech->L_vt);
        DAL__RESERVE(a, nn, &metric->M, &metric->factor, &mech->L_vq, &mech->L_vv);
        DAL__RESERVE(a, twice + 1, &metric->formed_at);
    }
    if (system->def.force && !lean) DAL__RESERVE(a, nn, &mech->f_q, &mech->f_v);
    if (nonlinear) DAL__RESERVE(a, mn, &mech->chetaev);
    if (nonlinear) DAL__RESERVE(a, nn, &mech->bend);
}

void dal__mechanics_bind(dal_mechanics *mech, const dal_system *system)
{
    mech->n = system->def.n;
    mech->m = system->def.m;
    if (system->mass)
        mech->metric = (dal__metric){.M = system->mass, .masses = system->masses,
                                     .unit = system->unit, .per_unit = system->per_unit};
    dal__evaluator_bind(&mech->eval, system);
}

int dal__mechanics_new(dal_mechanics **mechanics, const dal_system *system, bool dense,
                       dal_error *error)
{
    dal_mechanics shape = {.eval.dense = dense}, *self;
    int status = DAL__REQUIRE(error, {"mechanics", mechanics}, {"system", system});
    if (status) return status;
    dal__reserve(&shape.arena, &self, 1, sizeof *self);
    dal__mechanics_reserve(&shape, system, &shape.arena);
    status = dal__allocate(&shape.arena, error);
    if (status) return status;
    *self = shape;
    dal__mechanics_bind(self, system);
    *mechanics = self;
    return DAL_SUCCESS;
}

int dal_mechanics_new(dal_mechanics **mechanics, const dal_system *system, dal_error *error)
{
    return dal__mechanics_new(mechanics, system, false, error);
}

void dal_mechanics_free(dal_mechanics *mechanics)
{
    if (mechanics) dal__release(&mechanics->arena);
}

const dal_error *dal_mechanics_error(const dal_mechanics *mechanics) { return &mechanics->error; }

int dal_mechanics_input(dal_mechanics *mechanics, const double *u)
{
    if (!mechanics) return DAL_EINVAL;
    return dal__evaluator_input(&mechanics->eval, u, &mechanics->error);
}

int dal__require_finite(dal_mechanics *mech, const char *name, size_t count, const double *x)
{
    return DAL__REQUIRE_FINITE(&mech->error, {name, count, x});
}

/* What public functions ask for first: somewhere for the output of this name to go, and finite
 * shift, t and x[2n]. */
static int require(dal_mechanics *mech, const char *name, const double *output, double shift,
                   double t, const double *x)
{
    if (!mech) return DAL_EINVAL;
    return DAL__REQUIRE_FINITE(&mech->error, {name, 0, output}, {"shift", 1, &shift}, {"t", 1, &t},
                               {"x", 2 * mech->n, x});
}

/* ---- M and C ----------------------------------------------------------------------------- */

/* The factor of metric.M, which is that at (t, q, v), and its units. */
static int factor_metric(dal_mechanics *mech, double t, const double *q, const double *v)
{
    const size_t n = mech->n;
    dal__metric *const metric = &mech->metric;
    size_t row = 0;
    double pivot = 0.0;
    metric->formed = false;
    dal__copy(n * n, metric->M, metric->factor);
    if (!dal__cholesky(n, metric->factor, metric->unit, &row, &pivot)) {
        const double value = metric->M[row * n + row];
        const dal__entry entry = {NULL, "L_vv", row, row, value};
        return dal__fail_entry(&mech->error, DAL_ESINGULAR, &entry, " = %g: L_vv is not positive "
                               "definite to working precision (pivot %zu of its Cholesky factor is "
                               "%g). If a constraint mu v = 0 fixes the directions without mass, "
                               "add c (mu v)^2/2 to L; for a quaternion p this is c (p . p')^2/2",
                               value, row, pivot);
    }
    for (size_t i = 0; i < n; i++) {
        metric->unit[i] = sqrt(metric->unit[i]);
        metric->per_unit[i] = 1.0 / metric->unit[i];
    }
    dal__copy(n, q, metric->formed_at);
    dal__copy(n, v, metric->formed_at + n);
    metric->formed_at[2 * n] = t;
    metric->age = mech->eval.system->age;
    metric->formed = true;
    return DAL_SUCCESS;
}

int dal__form_metric(dal_mechanics *mech, double t, const double *q, const double *v)
{
    if (mech->eval.constant_mass) return DAL_SUCCESS;
    const dal__jet wanted = {.L_vv = mech->metric.M};
    mech->metric.formed = false;
    const int status = dal__lagrangian(&mech->eval, t, q, v, &wanted, &mech->error);
    return status ? status : factor_metric(mech, t, q, v);
}

int dal__renew_metric(dal_mechanics *mech, double t, const double *q, const double *v)
{
    const size_t n = mech->n, calls = mech->eval.lagrangian_calls;
    const dal__metric *const metric = &mech->metric;
    const double *const at = metric->formed_at;
    if (mech->eval.constant_mass) return DAL_SUCCESS;
    if (metric->formed && metric->age == mech->eval.system->age
        && memcmp(at, q, n * sizeof *q) == 0 && memcmp(at + n, v, n * sizeof *v) == 0
        && at[2 * n] == t)
        return DAL_SUCCESS;
    const int status = dal__form_metric(mech, t, q, v);
    mech->eval.lagrangian_calls = calls;
    return status;
}

void dal__accelerate(const dal_mechanics *mech, const double *f, double *y)
{
    const size_t n = mech->n;
    const double *const inverse = mech->eval.system->mass_inverse;
    if (!mech->eval.constant_mass) {
        dal__copy(n, f, y);
        dal__cholesky_solve(n, mech->metric.factor, y);
    } else if (!mech->metric.masses) {
        dal__apply(n, n, inverse, f, y);
    } else {
        for (size_t i = 0; i < n; i++) y[i] = inverse[i] * f[i];
    }
}

void dal__weigh(const dal_mechanics *mech, const double *x, double *y)
{
    if (mech->eval.constant_mass) dal__apply_mass(mech->eval.system, x, y);
    else dal__apply(mech->n, mech->n, mech->metric.M, x, y);
}

void dal__form_Z(dal_mechanics *mech, const double *mu)
{
    const dal_rows *const rows = mech->eval.rows;
    const double *const inverse = mech->eval.system->mass_inverse;
    for (size_t e = 0; rows && e < dal_rows_entries(rows); e++)
        mech->gram.Z[e] = inverse[rows->column[e]] * mu[e];
    if (rows) return;
    for (size_t a = 0; a < mech->m; a++)
        dal__accelerate(mech, mu + a * mech->n, mech->gram.Z + a * mech->n);
}

/* C <- mu Z^T of the forms. */
static void form_gram(dal_mechanics *mech)
{
    dal__linear_multiply(&mech->gram.C, mech->eval.rows, mech->n, mech->forms.mu, mech->gram.Z);
}

/* The sizes of mu Z^T for dal__linear: a coordinate that no row of Z moves counts for nothing. */
static void size_product(dal_mechanics *mech)
{
    const size_t n = mech->n, m = mech->m;
    const dal_rows *const rows = mech->eval.rows;
    const double *const Z = mech->gram.Z, *const mu = mech->forms.mu;
    double *const sizes = mech->gram.C.sizes, *const moves = mech->w;
    dal__clear(n, moves);
    for (size_t a = 0; a < m; a++) {
        const size_t begin = rows ? rows->first[a] : a * n;
        const size_t end = rows ? rows->first[a + 1] : begin + n;
        sizes[m + a] = 0.0;
        for (size_t e = begin; e < end; e++) {
            const size_t i = rows ? rows->column[e] : e - begin;
            if (Z[e] != 0.0) moves[i] = mech->metric.unit[i];
            sizes[m + a] = fmax(sizes[m + a], fabs(Z[e]) * mech->metric.per_unit[i]);
        }
    }
    for (size_t a = 0; a < m; a++) sizes[a] = dal__row_extent(mech, mu, a, moves);
}

static int lost_rank(dal_mechanics *mech)
{
    dal__fail(&mech->error, DAL_ESINGULAR, "mu M^-1 mu^T is singular");
    if (!dal__name_dependent(mech, mech->forms.mu, mech->gram.Z, dal__rank_lost(mech),
                             &mech->error))
        dal__add_words(&mech->error, ": mu does not have full rank");
    return DAL_ESINGULAR;
}

/* The LU factors of mu Z^T, where Z need not be that of mu, and may leave coordinates out. */
static int factor_product(dal_mechanics *mech)
{
    form_gram(mech);
    size_product(mech);
    return dal__linear_factor(&mech->gram.C) ? DAL_SUCCESS : lost_rank(mech);
}

int dal__factor_gram(dal_mechanics *mech)
{
    dal__linear *const C = &mech->gram.C;
    dal__form_Z(mech, mech->forms.mu);
    if (C->pattern) return factor_product(mech);
    form_gram(mech);
    return dal__cholesky(mech->m, C->A, C->sizes, NULL, NULL) ? DAL_SUCCESS : lost_rank(mech);
}

void dal__solve_gram(const dal_mechanics *mech, double *y)
{
    const dal__linear *const C = &mech->gram.C;
    if (C->pattern) dal__linear_solve(C, y, y);
    else dal__cholesky_solve(mech->m, C->A, y);
}

int dal_metric(dal_mechanics *mech, double t, const double *x, double *M)
{
    int status = require(mech, "M", M, 0.0, t, x);
    if (!status) status = dal__form_metric(mech, t, x, x + mech->n);
    if (status) return status;
    if (mech->eval.constant_mass) return dal_system_mass(mech->eval.system, M);
    dal__copy(mech->n * mech->n, mech->metric.M, M);
    return DAL_SUCCESS;
}

int dal_gram(dal_mechanics *mech, double t, const double *x, double *C)
{
    int status = require(mech, "C", C, 0.0, t, x);
    if (!status) status = dal__form_metric(mech, t, x, x + mech->n);
    if (!status) /* without phi, which may overflow */
        status = dal__constraint(&mech->eval, t, x, x + mech->n, NULL, mech->forms.mu, NULL,
                                 NULL, &mech->error);
    if (status) return status;
    dal__copy(mech->n, x, mech->forms.q);
    dal__form_Z(mech, mech->forms.mu);
    form_gram(mech);
    const dal__linear *const gram = &mech->gram.C;
    const dal__pattern *const pattern = gram->pattern;
    const size_t m = mech->m;
    if (!pattern) return DAL__DELIVER(&mech->error, {"C", m * m, gram->A, C});
    status = dal__require_output(&mech->error, "C", pattern->stored, gram->A);
    if (status) return status;
    dal__clear(m * m, C);
    for (size_t a = 0; a < m; a++)
        for (size_t k = pattern->first[a]; k < pattern->first[a + 1]; k++)
            C[a * m + pattern->column[k]] = gram->A[pattern->place[k]];
    return DAL_SUCCESS;
}

/* ---- energy and power -------------------------------------------------------------------- */

int dal__energy(dal_mechanics *mech, double t, const double *x, double *E)
{
    const size_t n = mech->n;
    const double *const v = x + n;
    double V = 0.0, L = 0.0;
    int status;
    if (mech->eval.constant_mass) {
        status = dal__potential(&mech->eval, t, x, &V, NULL, NULL, &mech->error);
        if (status) return status;
        dal__weigh(mech, v, mech->step);
        *E = 0.5 * dal__dot(n, v, mech->step) + V;
        return DAL_SUCCESS;
    }
    const dal__jet wanted = {.L = &L, .L_v = mech->step};
    status = dal__lagrangian(&mech->eval, t, x, v, &wanted, &mech->error);
    if (!status) *E = dal__dot(n, v, mech->step) - L;
    return status;
}

int dal_energy(dal_mechanics *mech, double t, const double *x, double *E)
{
    double value = 0.0;
    int status = require(mech, "E", E, 0.0, t, x);
    if (!status) status = dal__energy(mech, t, x, &value);
    return status ? status : DAL__DELIVER(&mech->error, {"E", 1, &value, E});
}

/* ---- residuals --------------------------------------------------------------------------- */

/* forms.q <- q - shift v of x[2n]. */
static void move_node(dal_mechanics *mech, double shift, const double *x)
{
    const size_t n = mech->n;
    dal__move(n, x, -shift, x + n, mech->forms.q);
}

/* phi and mu of the forms at (q, v), which stand there, and phi_q if slopes. */
static int evaluate_forms(dal_mechanics *mech, double t, const double *v, bool slopes)
{
    dal__forms *const at = &mech->forms;
    return dal__constraint(&mech->eval, t, at->q, v, at->phi, at->mu, slopes ? at->dmu : NULL, NULL,
                           &mech->error);
}

int dal__forms_at(dal_mechanics *mech, double t, double shift, const double *x, bool slopes)
{
    const double *const v = x + mech->n;
    move_node(mech, shift, x);
    int status = dal__form_metric(mech, t, mech->forms.q, v);
    if (!status) status = evaluate_forms(mech, t, v, slopes);
    return status ? status : dal__require_output(&mech->error, "phi", mech->m, mech->forms.phi);
}

int dal_residual(dal_mechanics *mech, double t, double shift, const double *x, double *residual)
{
    int status = require(mech, "residual", residual, shift, t, x);
    if (!status) status = dal__forms_at(mech, t, shift, x, false);
    if (!status) dal__copy(mech->m, mech->forms.phi, residual);
    return status;
}

int dal__measure_moves(dal_mechanics *mech, double t, double shift, const double *v)
{
    dal__forms *const at = &mech->forms;
    const bool linear = mech->eval.system->def.kind == DAL_LINEAR;
    dal__clear(mech->m, at->moves);
    if (linear && shift == 0.0) return DAL_SUCCESS;
    const int status = dal__constraint(&mech->eval, t, at->q, v, NULL, NULL, at->dmu,
                                       linear ? NULL : at->phi_t, &mech->error);
    for (size_t a = 0; !status && a < mech->m; a++) {
        at->moves[a] = dal__row_extent(mech, at->dmu, a, at->q);
        if (shift != 0.0) at->moves[a] += fabs(shift) * dal__row_extent(mech, at->dmu, a, v);
        if (!linear) at->moves[a] += fabs(at->phi_t[a] * t);
    }
    return status;
}

double dal__relative_residual(const dal_mechanics *mech, const double *mu, const double *phi,
                              const double *v, const double *moves)
{
    const size_t n = mech->n;
    const double speed = dal_residual_speed(n, mech->metric.per_unit, v);
    double worst = 0.0;
    for (size_t a = 0; a < mech->m; a++) {
        const double form = dal__row_extent(mech, mu, a, mech->metric.unit);
        const double unit = form * speed <= DBL_MAX ? 1.0 : DBL_MIN, size = unit * fabs(phi[a]);
        const double scale = unit * form * speed
                           + unit * fabs(phi[a] - dal__row_dot(mech, mu, a, v))
                           + (moves ? unit * moves[a] : 0.0);
        if (!(fabs(phi[a]) <= DBL_MAX && scale <= DBL_MAX)) return HUGE_VAL;
        if (size > worst * scale) worst = size / scale;
    }
    return worst;
}

double dal__forms_move(const dal_mechanics *mech, const double *mu, const double *slope,
                       const double *q, const double *slope_t, double t)
{
    double moves = 0.0;
    for (size_t a = 0; a < mech->m; a++) /* as phi is a residual: by the size of its form */
        moves += (dal__row_extent(mech, slope, a, q) + (slope_t ? fabs(slope_t[a] * t) : 0.0))
               / dal__row_extent(mech, mu, a, mech->metric.unit);
    return moves;
}

bool dal__is_consistent(const dal_mechanics *mech, const double *mu, const double *phi,
                        const double *v, const double *moves)
{
    const size_t n = mech->n;
    const double speed = dal_residual_speed(n, mech->metric.per_unit, v);
    for (size_t a = 0; a < mech->m; a++) {
        const double form = dal__row_extent(mech, mu, a, mech->metric.unit);
        const double terms = fabs(phi[a] - dal__row_dot(mech, mu, a, v))
                           + dal__row_extent(mech, mu, a, v);
        const double scale = form * speed + moves[a];
        if (!(fabs(phi[a]) <= DAL_CONSISTENT * terms + dal__residual_bound(mech) * scale))
            return false;
    }
    return true;
}

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
        if (!along_Z) dal__form_Z(mech, at->mu);
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
        status = factor_product(mech);
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

int dal__lies_in_D(dal_mechanics *mech, double t, double shift, const double *x, double *relative,
                   bool *consistent)
{
    const dal__forms *const at = &mech->forms;
    int status = dal__forms_at(mech, t, shift, x, false);
    if (status) return status;
    status = dal__measure_moves(mech, t, shift, x + mech->n);
    if (status) return status;
    *relative = dal__relative_residual(mech, at->mu, at->phi, x + mech->n, at->moves);
    *consistent = dal__is_consistent(mech, at->mu, at->phi, x + mech->n, at->moves);
    return dal__require_output(&mech->error, "residual", 1, relative);
}

int dal_relative_residual(dal_mechanics *mech, double t, double shift, const double *x,
                          double *worst)
{
    double relative;
    bool consistent;
    int status = require(mech, "worst", worst, shift, t, x);
    if (!status) status = dal__lies_in_D(mech, t, shift, x, &relative, &consistent);
    if (!status) *worst = relative;
    return status;
}

/* ---- the ODE on D ------------------------------------------------------------------------ */

/* force <- L_q - L_vq v - L_vt + f; the metric is that at x afterwards. */
static int form_force(dal_mechanics *mech, double t, const double *x)
{
    const size_t n = mech->n;
    const double *const v = x + n;
    dal__jet wanted = {.L_q = mech->force};
    const bool general = !mech->eval.constant_mass;
    if (general) {
        mech->metric.formed = false;
        wanted.L_vq = mech->L_vq;
        wanted.L_vv = mech->metric.M;
        wanted.L_vt = mech->L_vt;
    }
    int status = dal__lagrangian(&mech->eval, t, x, v, &wanted, &mech->error);
    if (!status && general) status = factor_metric(mech, t, x, v);
    if (status) return status;
    for (size_t i = 0; general && i < n; i++)
        mech->force[i] = mech->force[i] - dal__dot(n, mech->L_vq + i * n, v) - mech->L_vt[i];
    if (!mech->eval.system->def.force) return DAL_SUCCESS;
    status = dal__force(&mech->eval, t, x, v, mech->step, NULL, NULL, &mech->error);
    if (!status) dal__add(n, 1.0, mech->step, mech->force);
    return status;
}

/* force and lambda at x[2n], with the metric, the forms but for phi, and the gram; the arguments
 * are checked, as require does. */
static int solve_multipliers(dal_mechanics *mech, const char *name, const double *output, double t,
                             const double *x)
{
    int status = require(mech, name, output, 0.0, t, x);
    if (status) return status;
    const size_t n = mech->n, m = mech->m;
    const dal__forms *const at = &mech->forms;
    const double *const v = x + n;
    dal__copy(n, x, at->q);
    status = form_force(mech, t, x);
    if (!status)
        status = dal__constraint(&mech->eval, t, x, v, NULL, at->mu, at->dmu, at->phi_t,
                                 &mech->error);
    if (status || m == 0) return status;
    status = dal__factor_gram(mech);
    if (status) return status;
    for (size_t a = 0; a < m; a++)
        mech->lambda[a] = -dal__row_dot(mech, mech->gram.Z, a, mech->force)
                        - dal__row_dot(mech, at->dmu, a, v) - at->phi_t[a];
    dal__solve_gram(mech, mech->lambda);
    return dal__require_output(&mech->error, "lambda", m, mech->lambda);
}

/* point <- (v, M^-1 (force + mu^T lambda)). */
static void form_field(dal_mechanics *mech, const double *x)
{
    const size_t n = mech->n;
    dal__copy(n, mech->force, mech->step);
    for (size_t a = 0; a < mech->m; a++)
        dal__row_add(mech, mech->lambda[a], mech->forms.mu, a, mech->step);
    dal__copy(n, x + n, mech->point);
    dal__accelerate(mech, mech->step, mech->point + n);
}

int dal_multipliers(dal_mechanics *mech, double t, const double *x, double *lambda)
{
    const int status = solve_multipliers(mech, "lambda", lambda, t, x);
    if (!status) dal__copy(mech->m, mech->lambda, lambda);
    return status;
}

/* ---- the same, where nothing is looked at but the result --------------------------------- */

/* *name <- the callback that did not return 0, and what it returned; force, mu, and phi_t <- g. */
DAL_LU_INLINE int call_for_terms(dal_mechanics *mech, size_t n, size_t m, double t,
                                 const double *x, const char **name)
{
    evaluator *const e = &mech->eval;
    const dal__forms *const at = &mech->forms;
    double *const phi_t = e->system->def.time_dependent ? at->phi_t : NULL;
    if (e->pull) {
        dal__forget(n, mech->force);
        e->potential_calls += e->pull_ctx != e;
        const int returned = e->pull(t, x, NULL, mech->force, NULL, e->pull_ctx);
        *name = e->pull_ctx == e ? e->refused : "potential";
        if (returned) return returned;
        for (size_t i = 0; i < n; i++) mech->force[i] = -mech->force[i];
    }
    if (m == 0) return 0;
    dal__forget(m * n, at->mu);
    dal__forget(m * n, at->dmu);
    dal__forget(m, phi_t);
    e->constraint_calls += e->constraint_ctx != e;
    const int returned =
        e->constraint(t, x, x + n, NULL, at->mu, at->dmu, phi_t, e->constraint_ctx);
    *name = "constraint";
    for (size_t a = 0; a < m; a++) {
        double along = phi_t ? phi_t[a] : 0.0;
        for (size_t i = 0; i < n; i++) along += at->dmu[a * n + i] * x[n + i];
        at->phi_t[a] = along;
    }
    return returned;
}

/* Whether xdot[2n] <- the field, of constant mass and without a force of v; else *status may say
 * why not, or it has to be looked at.  next is that of dal_field_terms. */
DAL_LU_INLINE bool field_of(dal_mechanics *mech, size_t n, size_t m, size_t next, double t,
                            const double *x, double *xdot, int *status)
{
    const dal__forms *const at = &mech->forms;
    const dal__gram *const gram = &mech->gram;
    const dal_field_terms terms = {
        .F = mech->force, .mu = at->mu, .g = at->phi_t, .next = next,
        .inverse = mech->eval.system->mass_inverse, .Z = gram->Z, .C = gram->C.A,
        .share = gram->C.sizes, .lambda = mech->lambda, .w = gram->C.sizes + m};
    dal_field_zeros has = DAL_FIELD_ALL;
    const char *name = NULL;
    const int returned = call_for_terms(mech, n, m, t, x, &name);
    if (returned) *status = dal__refuse(&mech->error, name, returned);
    if (!mech->eval.pull) has.F = 0;
    return !returned && dal_field_solve(n, m, has, &terms, x + n, xdot);
}

/* The same of any system; for the sizes that small ones have. */
static bool field_at_once(dal_mechanics *mech, double t, const double *x, double *xdot, int *status)
{
    const evaluator *const e = &mech->eval;
    const dal_system *const system = e->system;
    const size_t n = mech->n, m = mech->m;
    if (e->field || !e->constant_mass || mech->gram.C.pattern || e->rows
        || dal__is_dragged(system))
        return false;
    const size_t next = system->masses ? 1 : system->diagonal ? n + 1 : 0;
    if (n == 3 && m == 1 && next == 4) return field_of(mech, 3, 1, 4, t, x, xdot, status);
    if (n == 4 && m == 2 && next == 5) return field_of(mech, 4, 2, 5, t, x, xdot, status);
    return field_of(mech, n, m, next, t, x, xdot, status);
}

int dal__field_in_full(dal_mechanics *mech, double t, const double *x, double *xdot)
{
    int status = DAL_SUCCESS;
    if (field_at_once(mech, t, x, xdot, &status)) return DAL_SUCCESS;
    if (!status) status = solve_multipliers(mech, "xdot", xdot, t, x);
    if (status) return status;
    const size_t n = mech->n;
    form_field(mech, x);
    return DAL__DELIVER(&mech->error, {"v", n, mech->point, xdot},
                        {"vdot", n, mech->point + n, xdot + n});
}

int dal_field(dal_mechanics *mech, double t, const double *x, double *xdot)
{
    int status = require(mech, "xdot", xdot, 0.0, t, x);
    if (!status) status = dal__field(mech, t, x, mech->point);
    if (!status) dal__copy(2 * mech->n, mech->point, xdot);
    return status;
}

int dal_acceleration(dal_mechanics *mech, double t, const double *x, double *vdot)
{
    int status = require(mech, "vdot", vdot, 0.0, t, x);
    if (!status) status = dal__field(mech, t, x, mech->point);
    if (!status) dal__copy(mech->n, mech->point + mech->n, vdot);
    return status;
}

int dal_perturbed(dal_mechanics *mech, double t, double weight, const double *x,
                  const double *ghat, double *xdot, double *lambda)
{
    if (!mech) return DAL_EINVAL;
    const size_t n = mech->n, m = mech->m;
    const dal__forms *const at = &mech->forms;
    int status = DAL__REQUIRE_FINITE(&mech->error, {"weight", 1, &weight}, {"ghat", 2 * n, ghat});
    if (!status) status = solve_multipliers(mech, "x", x, t, x);
    if (status) return status;
    for (size_t a = 0; a < m; a++) /* hatLambday: C is still factored */
        at->phi[a] = -weight * (dal__row_dot(mech, at->dmu, a, ghat)
                                + dal__row_dot(mech, at->mu, a, ghat + n));
    dal__solve_gram(mech, at->phi);
    dal__add(m, 1.0, at->phi, mech->lambda);
    form_field(mech, x);
    dal__add(2 * n, weight, ghat, mech->point);
    return DAL__DELIVER(&mech->error, {"lambda", m, mech->lambda, lambda},
                        {"xdot", 2 * n, mech->point, xdot});
}

int dal_power(dal_mechanics *mech, double t, const double *x, double *constraint, double *force)
{
    double of_constraint = 0.0;
    int status = solve_multipliers(mech, "x", x, t, x);
    if (status) return status;
    const size_t n = mech->n;
    const double *const v = x + n;
    for (size_t a = 0; a < mech->m; a++)
        of_constraint += mech->lambda[a] * dal__row_dot(mech, mech->forms.mu, a, v);
    status = dal__force(&mech->eval, t, x, v, mech->step, NULL, NULL, &mech->error);
    if (status) return status;
    const double of_force = dal__dot(n, mech->step, v);
    return DAL__DELIVER(&mech->error, {"constraint", 1, &of_constraint, constraint},
                        {"force", 1, &of_force, force});
}

/* ---- projections ------------------------------------------------------------------------- */

/* sqrt(d^T M d); d[n] is destroyed, as its squares might overflow. */
static double mass_norm(dal_mechanics *mech, double *d)
{
    const double largest = dal__largest(mech->n, d);
    for (size_t i = 0; largest > 0.0 && i < mech->n; i++) d[i] /= largest;
    dal__weigh(mech, d, mech->step);
    return largest * sqrt(fmax(0.0, dal__dot(mech->n, d, mech->step)));
}

double dal__velocity_moves(dal_mechanics *mech, double t, double shift, const double *v)
{
    const dal__forms *const at = &mech->forms;
    double moves = 0.0;
    if (dal__measure_moves(mech, t, shift, v)) return 0.0; /* the next step will say why */
    for (size_t a = 0; a < mech->m; a++)
        moves += at->moves[a] / dal__row_extent(mech, at->mu, a, mech->metric.unit);
    return moves;
}

static double moves(void *ctx)
{
    dal_mechanics *const mech = ctx;
    return dal__velocity_moves(mech, mech->t, mech->shift, mech->point + mech->n);
}

/* Of the velocity v of mech->point for phi(q - shift v, v) = 0, along Z as it is. */
static int find_step(dal__newton *equations)
{
    dal_mechanics *const mech = equations->ctx;
    const dal__forms *const at = &mech->forms;
    const double shift = mech->shift;
    move_node(mech, shift, mech->point);
    int status = evaluate_forms(mech, mech->t, mech->point + mech->n, shift != 0.0);
    if (status) return status;
    if (shift != 0.0) dal__add(dal__entries(&mech->eval), -shift, at->dmu, at->mu);
    status = factor_product(mech);
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
    return status ? status : factor_product(mech); /* without full rank it is refused for any v */
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
    int status = require(mech, "x", x, shift, t, x);
    if (!status) status = dal__forms_at(mech, t, 0.0, x, false);
    if (status) return status;
    dal__form_Z(mech, mech->forms.mu);
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
static size_t form_free_Z(dal_mechanics *mech, const unsigned char *keep)
{
    const size_t n = mech->n;
    const dal_rows *const rows = mech->eval.rows;
    double *const factor = mech->hessian;
    size_t free_count = 0;
    for (size_t i = 0; i < n; i++) free_count += !keep[i];
    if (mech->metric.masses) {
        dal__form_Z(mech, mech->forms.mu);
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
    int status = require(mech, "x", x, 0.0, t, x);
    if (!status) status = dal__forms_at(mech, t, 0.0, x, false);
    if (status) return status;
    const size_t n = mech->n, free_count = form_free_Z(mech, keep);
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

/* ---- many states ------------------------------------------------------------------------- */

/* *E, lambda, and phi with *worst, each where it is wanted. */
static int evaluate_row(dal_mechanics *mech, double t, double shift, const double *x, double *E,
                        bool lambda, double *worst)
{
    bool consistent;
    int status = require(mech, "x", x, shift, t, x);
    if (!status && E) status = dal_energy(mech, t, x, E);
    if (!status && lambda) status = solve_multipliers(mech, "x", x, t, x);
    if (!status && worst) status = dal__lies_in_D(mech, t, shift, x, worst, &consistent);
    return status;
}

int dal__trajectory(dal_mechanics *mech, double t0, double h, size_t first, double shift,
                    size_t count, const double *x, const double *inputs, double *energy,
                    double *multipliers, double *residual, double *relative, size_t *done)
{
    if (done) *done = 0;
    if (!mech) return DAL_EINVAL;
    const size_t n = mech->n, m = mech->m, width = mech->eval.system->def.inputs;
    evaluator *const e = &mech->eval;
    const bool measured = residual || relative;
    const bool acting = inputs && (multipliers || (measured && e->system->def.driven));
    for (size_t k = 0; k < count; k++, x += 2 * n) {
        const double t = t0 + (double)(first + k) * h;
        double E = 0.0, worst = 0.0;
        const double *const u = acting ? inputs + k * width : e->own_input;
        int status = DAL__REQUIRE_FINITE(&mech->error, {"inputs", width, u});
        e->input = u;
        if (!status)
            status = evaluate_row(mech, t, shift, x, energy ? &E : NULL, multipliers != NULL,
                                  measured ? &worst : NULL);
        e->input = e->own_input;
        if (status) return status;
        /* nothing of a row is written before all of it is known */
        if (energy) energy[k] = E;
        if (multipliers) dal__copy(m, mech->lambda, multipliers + k * m);
        if (residual) dal__copy(m, mech->forms.phi, residual + k * m);
        if (relative) relative[k] = worst;
        if (done) *done = k + 1;
    }
    return DAL_SUCCESS;
}

int dal_trajectory(dal_mechanics *mech, double t0, double h, double shift, size_t count,
                   const double *x, const double *inputs, double *energy, double *multipliers,
                   double *residual, double *relative, size_t *done)
{
    return dal__trajectory(mech, t0, h, 0, shift, count, x, inputs, energy, multipliers, residual,
                           relative, done);
}
