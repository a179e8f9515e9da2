/* Energy and power at a state, and what belongs to the states of a trajectory. */
#include "geometry/geometry.h"

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
    int status = dal__require_state(mech, "E", E, 0.0, t, x);
    if (!status) status = dal__energy(mech, t, x, &value);
    return status ? status : DAL__DELIVER(&mech->error, {"E", 1, &value, E});
}

/* ---- many states ------------------------------------------------------------------------- */

int dal_power(dal_mechanics *mech, double t, const double *x, double *constraint, double *force)
{
    double of_constraint = 0.0;
    int status = dal__solve_multipliers(mech, "x", x, t, x);
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

/* *E, lambda, and phi with *worst, each where it is wanted. */
static int evaluate_row(dal_mechanics *mech, double t, double shift, const double *x, double *E,
                        bool lambda, double *worst)
{
    bool consistent;
    int status = dal__require_state(mech, "x", x, shift, t, x);
    if (!status && E) status = dal_energy(mech, t, x, E);
    if (!status && lambda) status = dal__solve_multipliers(mech, "x", x, t, x);
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
