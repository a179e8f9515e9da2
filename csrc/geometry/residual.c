/* The residual of D at a state, and whether it is small enough. */
#include "geometry/geometry.h"
#include "dalembert/residual.h"

#include <float.h>
#include <math.h>

void dal__move_node(dal_mechanics *mech, double shift, const double *x)
{
    const size_t n = mech->n;
    dal__move(n, x, -shift, x + n, mech->forms.q);
}

int dal__evaluate_forms(dal_mechanics *mech, double t, const double *v, bool slopes)
{
    dal__forms *const at = &mech->forms;
    return dal__constraint(&mech->eval, t, at->q, v, at->phi, at->mu, slopes ? at->dmu : NULL, NULL,
                           &mech->error);
}

int dal__forms_at(dal_mechanics *mech, double t, double shift, const double *x, bool slopes)
{
    const double *const v = x + mech->n;
    dal__move_node(mech, shift, x);
    int status = dal__build_metric(mech, t, mech->forms.q, v);
    if (!status) status = dal__evaluate_forms(mech, t, v, slopes);
    return status ? status : dal__require_output(&mech->error, "phi", mech->m, mech->forms.phi);
}

int dal_residual(dal_mechanics *mech, double t, double shift, const double *x, double *residual)
{
    int status = dal__require_state(mech, "residual", residual, shift, t, x);
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

double dal__velocity_moves(dal_mechanics *mech, double t, double shift, const double *v)
{
    const dal__forms *const at = &mech->forms;
    double moves = 0.0;
    if (dal__measure_moves(mech, t, shift, v)) return 0.0; /* the next step will say why */
    for (size_t a = 0; a < mech->m; a++)
        moves += at->moves[a] / dal__row_extent(mech, at->mu, a, mech->metric.unit);
    return moves;
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
    int status = dal__require_state(mech, "worst", worst, shift, t, x);
    if (!status) status = dal__lies_in_D(mech, t, shift, x, &relative, &consistent);
    if (!status) *worst = relative;
    return status;
}
