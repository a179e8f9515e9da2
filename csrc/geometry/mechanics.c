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
    const size_t mn = dal__times(m, n), nn = dal__times(n, n);
    const size_t general = system->mass ? 0 : nn, forced = system->def.force ? nn : 0;
    const bool nonlinear = system->def.kind == DAL_NONLINEAR;
    double **const vectors[] = {&mech->force, &mech->q, &mech->w, &mech->step, &mech->momentum,
                                &mech->reach, &mech->node, &mech->trial, &mech->place};
    double **const forms[] = {&mech->mu, &mech->dmu, &mech->Z, &mech->muk};
    double **const multipliers[] = {&mech->phi, &mech->phi_t, &mech->lambda, &mech->residual};
    double **const matrices[] = {&mech->L_vq, &mech->L_vv, &mech->factor};
    dal__evaluator_reserve(&mech->eval, system, a);
    dal__reserve_doubles(a, DAL_LENGTH(vectors), vectors, n);
    dal__reserve_doubles(a, DAL_LENGTH(forms), forms, mn);
    dal__reserve_doubles(a, DAL_LENGTH(multipliers), multipliers, m);
    dal__reserve_doubles(a, DAL_LENGTH(matrices), matrices, general);
    dal__reserve(a, &mech->L_vt, system->mass ? 0 : n, sizeof(double));
    dal__reserve(a, &mech->f_q, forced, sizeof(double));
    dal__reserve(a, &mech->f_v, forced, sizeof(double));
    dal__reserve(a, &mech->chetaev, nonlinear ? mn : 0, sizeof(double));
    dal__reserve(a, &mech->bend, nonlinear ? nn : 0, sizeof(double));
    dal__reserve(a, &mech->point, dal__times(2, n), sizeof(double));
    dal__linear_reserve(&mech->C, m, a);
    dal__reserve(a, &mech->units, system->mass ? 0 : n, sizeof(double));
    dal__reserve(a, &mech->per_units, system->mass ? 0 : n, sizeof(double));
    dal__reserve(a, &mech->formed_at, system->mass ? 0 : dal__times(2, n) + 1, sizeof(double));
    dal__reserve(a, &mech->hessian, nn, sizeof(double));
}

void dal__mechanics_bind(dal_mechanics *mech, const dal_system *system)
{
    mech->n = system->def.n;
    mech->m = system->def.m;
    mech->metric = system->mass ? system->mass : mech->L_vv;
    mech->unit = system->mass ? system->unit : mech->units;
    mech->per_unit = system->mass ? system->per_unit : mech->per_units;
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

const dal_error *dal_mechanics_error(const dal_mechanics *mechanics) { return &mechanics->error; }

static const double *velocity(const dal_mechanics *mech, const double *x) { return x + mech->n; }

int dal__null_argument(dal_mechanics *mech, const char *name)
{
    return dal__fail(&mech->error, DAL_EINVAL, "%s is NULL", name);
}

int dal__require_finite(dal_mechanics *mech, const char *name, size_t count, const double *x)
{
    if (!x) return dal__null_argument(mech, name);
    for (size_t i = 0; i < count; i++)
        if (!isfinite(x[i]))
            return dal__fail(&mech->error, DAL_EINVAL, "%s[%zu] = %g is not finite", name, i, x[i]);
    return DAL_SUCCESS;
}

static int require_state(dal_mechanics *mech, double t, const double *x)
{
    const int status = dal__require_finite(mech, "t", 1, &t);
    return status ? status : dal__require_finite(mech, "x", 2 * mech->n, x);
}

/* ---- M and C ----------------------------------------------------------------------------- */

static int singular_metric(dal_mechanics *mech, size_t row, double pivot)
{
    const double value = mech->L_vv[row * mech->n + row];
    const dal__entry entry = {NULL, "L_vv", row, row, value};
    return dal__fail_entry(&mech->error, DAL_ESINGULAR, &entry, " = %g: L_vv is not positive "
                           "definite to working precision, pivot %zu of its Cholesky factor is %g",
                           value, row, pivot);
}

/* The factor of the metric in mech->L_vv, which is that at (t, q, v), and its units. */
static int factor_metric(dal_mechanics *mech, double t, const double *q, const double *v)
{
    const size_t n = mech->n;
    size_t row = 0;
    double pivot = 0.0;
    mech->formed = false;
    memcpy(mech->factor, mech->L_vv, n * n * sizeof *mech->factor);
    if (!dal__cholesky(n, mech->factor, mech->units, &row, &pivot))
        return singular_metric(mech, row, pivot);
    for (size_t i = 0; i < n; i++) {
        mech->units[i] = sqrt(mech->units[i]);
        mech->per_units[i] = 1.0 / mech->units[i];
    }
    memcpy(mech->formed_at, q, n * sizeof *q);
    memcpy(mech->formed_at + n, v, n * sizeof *v);
    mech->formed_at[2 * n] = t;
    mech->formed = true;
    return DAL_SUCCESS;
}

int dal__form_metric(dal_mechanics *mech, double t, const double *q, const double *v)
{
    if (mech->eval.constant_mass) return DAL_SUCCESS;
    const dal__jet wanted = {.L_vv = mech->L_vv};
    const int status = dal__lagrangian(&mech->eval, t, q, v, &wanted, &mech->error);
    return status ? status : factor_metric(mech, t, q, v);
}

int dal__renew_metric(dal_mechanics *mech, double t, const double *q, const double *v)
{
    const size_t n = mech->n, calls = mech->eval.lagrangian_calls;
    if (mech->eval.constant_mass) return DAL_SUCCESS;
    if (mech->formed && memcmp(mech->formed_at, q, n * sizeof *q) == 0
        && memcmp(mech->formed_at + n, v, n * sizeof *v) == 0 && mech->formed_at[2 * n] == t)
        return DAL_SUCCESS;
    const int status = dal__form_metric(mech, t, q, v);
    mech->eval.lagrangian_calls = calls;
    return status;
}

void dal__accelerate(const dal_mechanics *mech, const double *f, double *y)
{
    if (mech->eval.constant_mass) {
        dal__apply(mech->n, mech->n, mech->eval.system->mass_inverse, f, y);
        return;
    }
    memcpy(y, f, mech->n * sizeof *y);
    dal__cholesky_solve(mech->n, mech->factor, y);
}

void dal__form_Z(dal_mechanics *mech, const double *mu)
{
    for (size_t a = 0; a < mech->m; a++)
        dal__accelerate(mech, mu + a * mech->n, mech->Z + a * mech->n);
}

static void form_gram(dal_mechanics *mech)
{
    const size_t n = mech->n, m = mech->m;
    for (size_t a = 0; a < m; a++)
        for (size_t b = 0; b < m; b++)
            mech->C.A[a * m + b] = dal__dot(n, mech->mu + a * n, mech->Z + b * n);
}

int dal__factor_gram(dal_mechanics *mech)
{
    size_t row = 0;
    dal__form_Z(mech, mech->mu);
    form_gram(mech);
    if (dal__cholesky(mech->m, mech->C.A, mech->C.sizes, &row, NULL)) return DAL_SUCCESS;
    return dal__fail(&mech->error, DAL_ESINGULAR, "mu M^-1 mu^T is singular: mu does not have full "
                     "rank, or two constraints coincide (pivot %zu of %zu)", row, mech->m);
}

void dal__solve_gram(const dal_mechanics *mech, double *y)
{
    dal__cholesky_solve(mech->m, mech->C.A, y);
}

/* The LU factors of mu Z^T, where Z need not be that of mu, and may leave coordinates out. */
static int factor_product(dal_mechanics *mech)
{
    const size_t n = mech->n, m = mech->m;
    form_gram(mech);
    for (size_t a = 0; a < m; a++) {
        mech->C.sizes[a] = 0.0;
        mech->C.sizes[m + a] = dal_residual_speed(n, mech->per_unit, mech->Z + a * n);
    }
    for (size_t i = 0; i < n; i++) {
        bool moves = false;
        for (size_t a = 0; a < m; a++) moves = moves || mech->Z[a * n + i] != 0.0;
        for (size_t a = 0; moves && a < m; a++)
            mech->C.sizes[a] += fabs(mech->mu[a * n + i]) * mech->unit[i];
    }
    if (dal__linear_factor(&mech->C)) return DAL_SUCCESS;
    return dal__fail(&mech->error, DAL_ESINGULAR, "mu M^-1 mu^T is singular: mu does not have full "
                     "rank, or two constraints coincide");
}

int dal_metric(dal_mechanics *mechanics, double t, const double *x, double *M)
{
    if (!mechanics) return DAL_EINVAL;
    if (!M) return dal__null_argument(mechanics, "M");
    dal_mechanics *const mech = mechanics;
    int status = require_state(mech, t, x);
    if (!status) status = dal__form_metric(mech, t, x, velocity(mech, x));
    if (!status) memcpy(M, mech->metric, mech->n * mech->n * sizeof *M);
    return status;
}

int dal_gram(dal_mechanics *mechanics, double t, const double *x, double *C)
{
    if (!mechanics) return DAL_EINVAL;
    if (!C) return dal__null_argument(mechanics, "C");
    dal_mechanics *const mech = mechanics;
    int status = require_state(mech, t, x);
    if (!status) status = dal__forms_at(mech, t, 0.0, x, NULL);
    if (status) return status;
    dal__form_Z(mech, mech->mu);
    form_gram(mech);
    return DAL__DELIVER(&mech->error, {"C", mech->m * mech->m, mech->C.A, C});
}

/* ---- energy and power -------------------------------------------------------------------- */

int dal__energy(dal_mechanics *mech, double t, const double *x, double *E)
{
    const size_t n = mech->n;
    const double *const v = velocity(mech, x);
    double V = 0.0, L = 0.0;
    int status;
    if (mech->eval.constant_mass) {
        status = dal__potential(&mech->eval, t, x, &V, NULL, NULL, &mech->error);
        if (status) return status;
        dal__apply(n, n, mech->metric, v, mech->step);
        *E = 0.5 * dal__dot(n, v, mech->step) + V;
        return DAL_SUCCESS;
    }
    const dal__jet wanted = {.L = &L, .L_v = mech->step};
    status = dal__lagrangian(&mech->eval, t, x, v, &wanted, &mech->error);
    if (!status) *E = dal__dot(n, v, mech->step) - L;
    return status;
}

int dal_energy(dal_mechanics *mechanics, double t, const double *x, double *E)
{
    if (!mechanics) return DAL_EINVAL;
    if (!E) return dal__null_argument(mechanics, "E");
    double value = 0.0;
    int status = require_state(mechanics, t, x);
    if (!status) status = dal__energy(mechanics, t, x, &value);
    return status ? status : DAL__DELIVER(&mechanics->error, {"E", 1, &value, E});
}

/* ---- residuals --------------------------------------------------------------------------- */

int dal__forms_at(dal_mechanics *mech, double t, double shift, const double *x, double *dmu)
{
    const size_t n = mech->n;
    const double *const v = velocity(mech, x);
    for (size_t i = 0; i < n; i++) mech->q[i] = x[i] - shift * v[i];
    int status = dal__form_metric(mech, t, mech->q, v);
    if (!status)
        status = dal__constraint(&mech->eval, t, mech->q, v, mech->phi, mech->mu, dmu, NULL,
                                 &mech->error);
    return status ? status : dal__require_output(&mech->error, "phi", mech->m, mech->phi);
}

int dal_residual(dal_mechanics *mechanics, double t, double shift, const double *x,
                 double *residual)
{
    if (!mechanics) return DAL_EINVAL;
    if (!residual) return dal__null_argument(mechanics, "residual");
    dal_mechanics *const mech = mechanics;
    int status = dal__require_finite(mech, "shift", 1, &shift);
    if (!status) status = require_state(mech, t, x);
    if (!status) status = dal__forms_at(mech, t, shift, x, NULL);
    if (!status) memcpy(residual, mech->phi, mech->m * sizeof *residual);
    return status;
}

double dal__relative_residual(const dal_mechanics *mech, const double *mu, const double *phi,
                              const double *v)
{
    const size_t n = mech->n;
    const double speed = dal_residual_speed(n, mech->per_unit, v);
    double worst = 0.0;
    for (size_t a = 0; a < mech->m; a++) {
        const double form = dal_residual_form(n, mech->unit, mu + a * n);
        const double unit = form * speed <= DBL_MAX ? 1.0 : DBL_MIN, size = unit * fabs(phi[a]);
        const double scale = unit * form * speed
                           + unit * fabs(phi[a] - dal__dot(n, mu + a * n, v));
        if (!(fabs(phi[a]) <= DBL_MAX && scale <= DBL_MAX)) return HUGE_VAL;
        if (size > worst * scale) worst = size / scale;
    }
    return worst;
}

double dal__forms_move(const dal_mechanics *mech, const double *mu, const double *slope,
                       const double *q)
{
    const size_t n = mech->n;
    double moves = 0.0;
    for (size_t a = 0; a < mech->m; a++) { /* as phi is a residual: by the size of its form */
        double moved = 0.0;
        for (size_t i = 0; i < n; i++) moved += fabs(slope[a * n + i] * q[i]);
        moves += moved / dal_residual_form(n, mech->unit, mu + a * n);
    }
    return moves;
}

bool dal__is_consistent(const dal_mechanics *mech, const double *mu, const double *phi,
                        const double *v)
{
    const size_t n = mech->n;
    const double speed = dal_residual_speed(n, mech->per_unit, v);
    for (size_t a = 0; a < mech->m; a++) {
        const double *const form = mu + a * n;
        double terms = fabs(phi[a] - dal__dot(n, form, v));
        for (size_t i = 0; i < n; i++) terms += fabs(form[i] * v[i]);
        if (!(fabs(phi[a]) <= DAL_CONSISTENT * terms
              + DAL_RESIDUAL_BOUND(n) * dal_residual_form(n, mech->unit, form) * speed))
            return false;
    }
    return true;
}

/* Whether phi may be what the rounding of a large node x[n] makes of 0. */
static bool is_rounding_of_node(dal_mechanics *mech, double t, double shift, const double *x)
{
    const size_t n = mech->n;
    const double speed = dal_residual_speed(n, mech->per_unit, velocity(mech, x));
    if (dal__forms_at(mech, t, shift, x, mech->dmu)) return false;
    for (size_t a = 0; a < mech->m; a++) {
        double bound = DAL_RESIDUAL_BOUND(n) * speed
                     * dal_residual_form(n, mech->unit, mech->mu + a * n);
        for (size_t i = 0; i < n; i++)
            bound += 2.0 * DAL_ROUNDOFF * fabs(mech->dmu[a * n + i])
                   * (fabs(mech->q[i]) + fabs(x[i]));
        if (!(fabs(mech->phi[a]) <= bound)) return false;
    }
    return true;
}

/* The velocity of x, or w, moves by -Z^T (mu Z^T)^-1 phi with the factors in C. */
static void find_change(dal_mechanics *mech, double *change)
{
    dal__linear_solve(&mech->C, mech->phi, mech->lambda);
    for (size_t i = 0; i < mech->n; i++) {
        double sum = 0.0;
        for (size_t a = 0; a < mech->m; a++) sum += mech->Z[a * mech->n + i] * mech->lambda[a];
        change[i] = -sum; /* where it is 0 a velocity of -0.0 stays one */
    }
}

int dal__mend(dal_mechanics *mech, double t, double shift, bool along_Z, double *x,
              double *relative)
{
    enum { MOST = 8 }; /* a pass leaves of the residual as much as the condition times u */
    const size_t n = mech->n;
    double *const v = x + n;
    const double before = dal_residual_speed(n, mech->per_unit, v);
    for (int pass = 1;; pass++) {
        int status = dal__forms_at(mech, t, shift, x, NULL);
        if (status) return status;
        *relative = dal__relative_residual(mech, mech->mu, mech->phi, v);
        if (*relative <= DAL_RESIDUAL_BOUND(n) / (pass <= MOST ? 2.0 : 1.0)) return DAL_SUCCESS;
        if (pass > MOST && shift != 0.0 && is_rounding_of_node(mech, t, shift, x))
            return DAL_SUCCESS;
        if (pass > MOST)
            return dal__fail(&mech->error, DAL_ESINGULAR, "mu M^-1 mu^T is singular to working "
                             "precision: the residual of D stays at %.3g", *relative);
        if (!along_Z) dal__form_Z(mech, mech->mu);
        status = factor_product(mech);
        if (status) return status;
        find_change(mech, mech->step);
        for (size_t i = 0; i < n; i++) v[i] += mech->step[i];
        /* A velocity across D, of which each pass leaves its own roundoff, is zero. */
        const double speed = dal_residual_speed(n, mech->per_unit, v);
        if (pass == MOST && speed <= DAL_RESIDUAL_BOUND(n) * before)
            memset(v, 0, n * sizeof *v);
        for (size_t i = 0; shift != 0.0 && i < n; i++) x[i] = mech->q[i] + shift * v[i];
    }
}

int dal__lies_in_D(dal_mechanics *mech, double t, double shift, const double *x, double *relative,
                   bool *consistent)
{
    int status = dal__forms_at(mech, t, shift, x, NULL);
    if (status) return status;
    *relative = dal__relative_residual(mech, mech->mu, mech->phi, velocity(mech, x));
    status = dal__require_output(&mech->error, "residual", 1, relative);
    if (status) return status;
    *consistent = dal__is_consistent(mech, mech->mu, mech->phi, velocity(mech, x));
    return DAL_SUCCESS;
}

int dal_relative_residual(dal_mechanics *mechanics, double t, double shift, const double *x,
                          double *worst)
{
    if (!mechanics) return DAL_EINVAL;
    if (!worst) return dal__null_argument(mechanics, "worst");
    dal_mechanics *const mech = mechanics;
    double relative;
    bool consistent;
    int status = dal__require_finite(mech, "shift", 1, &shift);
    if (!status) status = require_state(mech, t, x);
    if (!status) status = dal__lies_in_D(mech, t, shift, x, &relative, &consistent);
    if (!status) *worst = relative;
    return status;
}

/* ---- the ODE on D ------------------------------------------------------------------------ */

/* mech->force <- L_q - L_vq v - L_vt + f; M is that at x afterwards. */
static int form_force(dal_mechanics *mech, double t, const double *x)
{
    const size_t n = mech->n;
    const double *const v = velocity(mech, x);
    const bool general = !mech->eval.constant_mass;
    const dal__jet wanted = {.L_q = mech->force, .L_vq = general ? mech->L_vq : NULL,
                             .L_vv = general ? mech->L_vv : NULL,
                             .L_vt = general ? mech->L_vt : NULL};
    int status = dal__lagrangian(&mech->eval, t, x, v, &wanted, &mech->error);
    if (!status && general) status = factor_metric(mech, t, x, v);
    if (status) return status;
    for (size_t i = 0; general && i < n; i++)
        mech->force[i] = mech->force[i] - dal__dot(n, mech->L_vq + i * n, v) - mech->L_vt[i];
    if (!mech->eval.system->def.force) return DAL_SUCCESS;
    status = dal__force(&mech->eval, t, x, v, mech->step, NULL, NULL, &mech->error);
    for (size_t i = 0; !status && i < n; i++) mech->force[i] += mech->step[i];
    return status;
}

/* lambda in mech->lambda, L_q - L_vq v - L_vt + f in mech->force, mu in mech->mu. */
static int solve_multipliers(dal_mechanics *mech, double t, const double *x)
{
    const size_t n = mech->n, m = mech->m;
    int status = require_state(mech, t, x);
    if (status) return status;
    const double *const v = velocity(mech, x);
    status = form_force(mech, t, x);
    if (!status)
        status = dal__constraint(&mech->eval, t, x, v, NULL, mech->mu, mech->dmu, mech->phi_t,
                                 &mech->error);
    if (status || m == 0) return status;
    status = dal__factor_gram(mech);
    if (status) return status;
    for (size_t a = 0; a < m; a++)
        mech->lambda[a] = -dal__dot(n, mech->Z + a * n, mech->force)
                        - dal__dot(n, mech->dmu + a * n, v) - mech->phi_t[a];
    dal__solve_gram(mech, mech->lambda);
    return dal__require_output(&mech->error, "lambda", m, mech->lambda);
}

int dal_multipliers(dal_mechanics *mechanics, double t, const double *x, double *lambda)
{
    if (!mechanics) return DAL_EINVAL;
    if (!lambda) return dal__null_argument(mechanics, "lambda");
    const int status = solve_multipliers(mechanics, t, x);
    if (status) return status;
    memcpy(lambda, mechanics->lambda, mechanics->m * sizeof *lambda);
    return DAL_SUCCESS;
}

int dal_acceleration(dal_mechanics *mechanics, double t, const double *x, double *vdot)
{
    if (!mechanics) return DAL_EINVAL;
    if (!vdot) return dal__null_argument(mechanics, "vdot");
    dal_mechanics *const mech = mechanics;
    const size_t n = mech->n;
    int status = solve_multipliers(mech, t, x);
    if (status) return status;
    for (size_t i = 0; i < n; i++) {
        double sum = mech->force[i];
        for (size_t a = 0; a < mech->m; a++) sum += mech->mu[a * n + i] * mech->lambda[a];
        mech->step[i] = sum;
    }
    dal__accelerate(mech, mech->step, mech->q);
    return DAL__DELIVER(&mech->error, {"vdot", n, mech->q, vdot});
}

int dal_field(dal_mechanics *mechanics, double t, const double *x, double *xdot)
{
    if (!mechanics) return DAL_EINVAL;
    if (!xdot) return dal__null_argument(mechanics, "xdot");
    const size_t n = mechanics->n;
    const int status = dal_acceleration(mechanics, t, x, mechanics->w);
    if (status) return status;
    memmove(xdot, x + n, n * sizeof *xdot);
    memcpy(xdot + n, mechanics->w, n * sizeof *xdot);
    return DAL_SUCCESS;
}

int dal_perturbed(dal_mechanics *mechanics, double t, double weight, const double *x,
                  const double *ghat, double *xdot, double *lambda)
{
    if (!mechanics) return DAL_EINVAL;
    dal_mechanics *const mech = mechanics;
    const size_t n = mech->n, m = mech->m;
    int status = dal__require_finite(mech, "weight", 1, &weight);
    if (!status) status = dal__require_finite(mech, "ghat", 2 * n, ghat);
    if (!status) status = solve_multipliers(mech, t, x);
    if (status) return status;
    for (size_t a = 0; a < m; a++) /* hatLambday: C is still factored */
        mech->phi[a] = -weight * (dal__dot(n, mech->dmu + a * n, ghat)
                                  + dal__dot(n, mech->mu + a * n, ghat + n));
    dal__solve_gram(mech, mech->phi);
    for (size_t a = 0; a < m; a++) mech->lambda[a] += mech->phi[a];
    for (size_t i = 0; i < n; i++) {
        mech->step[i] = mech->force[i];
        for (size_t a = 0; a < m; a++) mech->step[i] += mech->mu[a * n + i] * mech->lambda[a];
    }
    dal__accelerate(mech, mech->step, mech->w);
    for (size_t i = 0; xdot && i < n; i++) {
        const double v = x[n + i]; /* xdot may be x, or ghat */
        mech->q[i] = v + weight * ghat[i];
        mech->w[i] += weight * ghat[n + i];
    }
    return DAL__DELIVER(&mech->error, {"lambda", m, mech->lambda, lambda},
                        {"xdot", n, mech->q, xdot}, {"xdot", n, mech->w, xdot ? xdot + n : NULL});
}

int dal_power(dal_mechanics *mechanics, double t, const double *x, double *constraint,
              double *force)
{
    if (!mechanics) return DAL_EINVAL;
    dal_mechanics *const mech = mechanics;
    const size_t n = mech->n;
    double of_constraint = 0.0;
    int status = solve_multipliers(mech, t, x);
    if (status) return status;
    const double *const v = velocity(mech, x);
    for (size_t a = 0; a < mech->m; a++)
        of_constraint += mech->lambda[a] * dal__dot(n, mech->mu + a * n, v);
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
    dal__apply(mech->n, mech->n, mech->metric, d, mech->step);
    return largest * sqrt(fmax(0.0, dal__dot(mech->n, d, mech->step)));
}

/* x takes the velocity of mech->point, unless that overflowed. */
static int accept(dal_mechanics *mech, double *x, double *distance)
{
    const size_t n = mech->n;
    const double *const w = velocity(mech, mech->point);
    for (size_t i = 0; i < n; i++) mech->q[i] = w[i] - x[n + i];
    const double moved = mass_norm(mech, mech->q);
    return DAL__DELIVER(&mech->error, {"consistent velocity", n, w, x + n},
                        {"distance", 1, &moved, distance});
}

typedef struct shifted {
    dal_mechanics *mech;
    double t, shift;
} shifted;

/* Of the velocity w of mech->point for phi(q - shift w, w) = 0, along Z as it is. */
static int find_step(dal__newton *equations)
{
    const shifted *const s = equations->ctx;
    dal_mechanics *const mech = s->mech;
    const double shift = s->shift;
    const double *const q = mech->point, *const w = velocity(mech, q);
    for (size_t i = 0; i < mech->n; i++) mech->q[i] = q[i] - shift * w[i];
    int status = dal__constraint(&mech->eval, s->t, mech->q, w, mech->phi, mech->mu,
                                 shift != 0.0 ? mech->dmu : NULL, NULL, &mech->error);
    if (status) return status;
    if (shift != 0.0) equations->moves = dal__forms_move(mech, mech->mu, mech->dmu, mech->q);
    for (size_t k = 0; shift != 0.0 && k < mech->m * mech->n; k++)
        mech->mu[k] -= shift * mech->dmu[k];
    status = factor_product(mech);
    if (!status) find_change(mech, equations->step);
    return status;
}

/* The velocity of mech->point <- that of D, or of D_eps, which belongs to it; Z says along what. */
static int find_velocity(dal_mechanics *mech, double t, double shift)
{
    const size_t n = mech->n;
    double relative, *const w = mech->point + n;
    int status = DAL_SUCCESS;
    if (shift != 0.0 || mech->eval.system->def.kind == DAL_NONLINEAR) {
        shifted s = {mech, t, shift};
        dal__newton equations = {.find_step = find_step, .ctx = &s, .size = n, .measured = n,
                                 .n = n, .per_unit = mech->per_unit, .z = w, .step = mech->step,
                                 .base = dal_residual_extent(n, mech->per_unit, w),
                                 .advice = "there may be no such velocity of D here"};
        status = dal__newton_run(&equations, &mech->error);
    }
    if (status || shift != 0.0) return status;
    status = dal__mend(mech, t, 0.0, true, mech->point, &relative);
    return status ? status : factor_product(mech); /* without full rank it is refused for any v */
}

int dal_project(dal_mechanics *mechanics, double t, double shift, double *x, double *distance)
{
    if (!mechanics) return DAL_EINVAL;
    dal_mechanics *const mech = mechanics;
    int status = dal__require_finite(mech, "shift", 1, &shift);
    if (!status) status = require_state(mech, t, x);
    if (!status) status = dal__forms_at(mech, t, 0.0, x, NULL);
    if (status) return status;
    dal__form_Z(mech, mech->mu);
    memcpy(mech->point, x, 2 * mech->n * sizeof *x);
    if (mech->m > 0) status = find_velocity(mech, t, shift);
    return status ? status : accept(mech, x, distance);
}

/* Z <- the directions in which the free components alone may move, [M_ff^-1 mu_f^T, 0]: those of
 * the saddle point system of min (w-v)^T M (w-v) with mu w = 0 and w_i = v_i for the kept i. */
static int form_free_Z(dal_mechanics *mech, const unsigned char *keep, size_t *free_count)
{
    const size_t n = mech->n, m = mech->m;
    double *factor, *column;
    arena scratch = {0};
    dal__reserve(&scratch, &factor, dal__times(n, n), sizeof *factor);
    dal__reserve(&scratch, &column, n, sizeof *column);
    const int status = dal__allocate(&scratch, &mech->error);
    if (status) return status;

    size_t entries = 0, count = 0;
    for (size_t i = 0; i < n; i++) {
        if (keep[i]) continue;
        count++;
        for (size_t j = 0; j < n; j++)
            if (!keep[j]) factor[entries++] = mech->metric[i * n + j];
    }
    /* a principal part of M is definite, as M is */
    dal__cholesky(count, factor, column, NULL, NULL);
    memset(mech->Z, 0, m * n * sizeof *mech->Z);
    for (size_t a = 0; a < m; a++) {
        size_t k = 0;
        for (size_t i = 0; i < n; i++)
            if (!keep[i]) column[k++] = mech->mu[a * n + i];
        dal__cholesky_solve(count, factor, column);
        k = 0;
        for (size_t i = 0; i < n; i++)
            if (!keep[i]) mech->Z[a * n + i] = column[k++];
    }
    dal__release(&scratch);
    *free_count = count;
    return DAL_SUCCESS;
}

int dal_consistent(dal_mechanics *mechanics, double t, const unsigned char *keep, double *x,
                   double *distance)
{
    if (!keep) return dal_project(mechanics, t, 0.0, x, distance);
    if (!mechanics) return DAL_EINVAL;
    dal_mechanics *const mech = mechanics;
    const size_t n = mech->n, m = mech->m;
    size_t free_count = 0;
    int status = require_state(mech, t, x);
    if (!status) status = dal__forms_at(mech, t, 0.0, x, NULL);
    if (!status && m > 0) status = form_free_Z(mech, keep, &free_count);
    if (status) return status;
    memcpy(mech->point, x, 2 * n * sizeof *x);
    if (m > 0) status = find_velocity(mech, t, 0.0);
    if (status == DAL_ESINGULAR)
        return dal__fail(&mech->error, DAL_ESINGULAR, "%zu of %zu components are kept: mu "
                         "restricted to the other %zu has rank below m = %zu", n - free_count, n,
                         free_count, m);
    if (status == DAL_ENOCONV && free_count < n)
        return dal__fail(&mech->error, DAL_ENOCONV, "no velocity of D was found with %zu of %zu "
                         "components kept: there may be none", n - free_count, n);
    return status ? status : accept(mech, x, distance);
}

/* ---- many states ------------------------------------------------------------------------- */

int dal__trajectory(dal_mechanics *mech, double t0, double h, size_t first, double shift,
                    size_t count, const double *x, double *energy, double *multipliers,
                    double *residual, double *relative, size_t *done)
{
    const size_t n = mech->n, m = mech->m;
    int status = dal__require_finite(mech, "shift", 1, &shift);
    for (size_t k = 0; !status && k < count; k++, x += 2 * n) {
        const double t = t0 + (double)(first + k) * h;
        double E = 0.0, worst = 0.0;
        bool consistent;
        status = require_state(mech, t, x);
        if (!status && energy) status = dal_energy(mech, t, x, &E);
        if (!status && multipliers) status = solve_multipliers(mech, t, x);
        if (!status && (residual || relative))
            status = dal__lies_in_D(mech, t, shift, x, &worst, &consistent);
        if (status) return status;
        /* nothing of a row is written before all of it is known */
        if (energy) energy[k] = E;
        if (multipliers) memcpy(multipliers + k * m, mech->lambda, m * sizeof *multipliers);
        if (residual) memcpy(residual + k * m, mech->phi, m * sizeof *residual);
        if (relative) relative[k] = worst;
        if (done) *done = k + 1;
    }
    return status;
}

int dal_trajectory(dal_mechanics *mechanics, double t0, double h, double shift, size_t count,
                   const double *x, double *energy, double *multipliers, double *residual,
                   double *relative, size_t *done)
{
    if (done) *done = 0;
    if (!mechanics) return DAL_EINVAL;
    if (!x && count > 0) return dal__null_argument(mechanics, "x");
    return dal__trajectory(mechanics, t0, h, 0, shift, count, x, energy, multipliers, residual,
                           relative, done);
}
