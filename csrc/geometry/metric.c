/* The metric M = L_vv at a state, and Z, the rows M^-1 mu^a. */
#include "geometry/geometry.h"

#include <math.h>
#include <string.h>

int dal__factor_metric(dal_mechanics *mech, double t, const double *q, const double *v)
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

int dal__build_metric(dal_mechanics *mech, double t, const double *q, const double *v)
{
    if (mech->eval.constant_mass) return DAL_SUCCESS;
    const dal__jet wanted = {.L_vv = mech->metric.M};
    mech->metric.formed = false;
    const int status = dal__lagrangian(&mech->eval, t, q, v, &wanted, &mech->error);
    return status ? status : dal__factor_metric(mech, t, q, v);
}

int dal__renew_metric(dal_mechanics *mech, double t, const double *q, const double *v)
{
    const size_t n = mech->n, calls = mech->eval.calls.lagrangian;
    const dal__metric *const metric = &mech->metric;
    const double *const at = metric->formed_at;
    if (mech->eval.constant_mass) return DAL_SUCCESS;
    if (metric->formed && metric->age == mech->eval.system->age
        && memcmp(at, q, n * sizeof *q) == 0 && memcmp(at + n, v, n * sizeof *v) == 0
        && at[2 * n] == t)
        return DAL_SUCCESS;
    const int status = dal__build_metric(mech, t, q, v);
    mech->eval.calls.lagrangian = calls;
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

void dal__build_Z(dal_mechanics *mech, const double *mu)
{
    const dal_rows *const rows = mech->eval.rows;
    const double *const inverse = mech->eval.system->mass_inverse;
    for (size_t e = 0; rows && e < dal_rows_entries(rows); e++)
        mech->gram.Z[e] = inverse[rows->column[e]] * mu[e];
    if (rows) return;
    for (size_t a = 0; a < mech->m; a++)
        dal__accelerate(mech, mu + a * mech->n, mech->gram.Z + a * mech->n);
}

int dal_metric(dal_mechanics *mech, double t, const double *x, double *M)
{
    int status = dal__require_state(mech, "M", M, 0.0, t, x);
    if (!status) status = dal__build_metric(mech, t, x, x + mech->n);
    if (status) return status;
    if (mech->eval.constant_mass) return dal_system_mass(mech->eval.system, M);
    dal__copy(mech->n * mech->n, mech->metric.M, M);
    return DAL_SUCCESS;
}
