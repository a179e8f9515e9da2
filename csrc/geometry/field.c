/* The ODE on D: multipliers and the vector field. */
#include "geometry/geometry.h"

#include <math.h>

/* force <- L_q - L_vq v - L_vt + f; the metric is that at x afterwards. */
static int build_force(dal_mechanics *mech, double t, const double *x)
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
    if (!status && general) status = dal__factor_metric(mech, t, x, v);
    if (status) return status;
    for (size_t i = 0; general && i < n; i++)
        mech->force[i] = mech->force[i] - dal__dot(n, mech->L_vq + i * n, v) - mech->L_vt[i];
    if (!mech->eval.system->def.force) return DAL_SUCCESS;
    status = dal__force(&mech->eval, t, x, v, mech->step, NULL, NULL, &mech->error);
    if (!status) dal__add(n, 1.0, mech->step, mech->force);
    return status;
}

int dal__solve_multipliers(dal_mechanics *mech, const char *name, const double *output, double t,
                             const double *x)
{
    int status = dal__require_state(mech, name, output, 0.0, t, x);
    if (status) return status;
    const size_t n = mech->n, m = mech->m;
    const dal__forms *const at = &mech->forms;
    const double *const v = x + n;
    dal__copy(n, x, at->q);
    status = build_force(mech, t, x);
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
static void build_field(dal_mechanics *mech, const double *x)
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
    const int status = dal__solve_multipliers(mech, "lambda", lambda, t, x);
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
    if (e->potential_force) {
        dal__forget(n, mech->force);
        e->calls.potential += e->potential_force_ctx != e;
        const int returned =
            e->potential_force(t, x, NULL, mech->force, NULL, e->potential_force_ctx);
        *name = e->potential_force_ctx == e ? e->refused : "potential";
        if (returned) return returned;
        for (size_t i = 0; i < n; i++) mech->force[i] = -mech->force[i];
    }
    if (m == 0) return 0;
    dal__forget(m * n, at->mu);
    dal__forget(m * n, at->dmu);
    dal__forget(m, phi_t);
    e->calls.constraint += e->constraint_ctx != e;
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
        .lambda = mech->lambda, .w = gram->C.sizes};
    dal_field_zeros has = DAL_FIELD_ALL;
    const char *name = NULL;
    const int returned = call_for_terms(mech, n, m, t, x, &name);
    if (returned) *status = dal__refuse(&mech->error, name, returned);
    if (!mech->eval.potential_force) has.F = 0;
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

/* The field where nothing compiled for the system gave it. */
static int field_in_full(dal_mechanics *mech, double t, const double *x, double *xdot)
{
    int status = DAL_SUCCESS;
    if (field_at_once(mech, t, x, xdot, &status)) return DAL_SUCCESS;
    if (!status) status = dal__solve_multipliers(mech, "xdot", xdot, t, x);
    if (status) return status;
    const size_t n = mech->n;
    build_field(mech, x);
    return DAL__DELIVER(&mech->error, {"v", n, mech->point, xdot},
                        {"vdot", n, mech->point + n, xdot + n});
}

int dal__field(dal_mechanics *mech, double t, const double *x, double *xdot)
{
    evaluator *const e = &mech->eval;
    const dal_system_def *const def = &e->system->def;
    if (!e->field) return field_in_full(mech, t, x, xdot);
    e->calls.constraint += mech->m > 0;
    e->calls.potential += def->potential != NULL;
    e->calls.lagrangian += def->lagrangian != NULL;
    e->calls.force += def->force != NULL;
    return e->field(t, x, e->input, e->system->mass_inverse, xdot, def->ctx)
        ? DAL_SUCCESS : field_in_full(mech, t, x, xdot);
}

int dal_field(dal_mechanics *mech, double t, const double *x, double *xdot)
{
    int status = dal__require_state(mech, "xdot", xdot, 0.0, t, x);
    if (!status) status = dal__field(mech, t, x, mech->point);
    if (!status) dal__copy(2 * mech->n, mech->point, xdot);
    return status;
}

int dal_acceleration(dal_mechanics *mech, double t, const double *x, double *vdot)
{
    int status = dal__require_state(mech, "vdot", vdot, 0.0, t, x);
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
    if (!status) status = dal__solve_multipliers(mech, "x", x, t, x);
    if (status) return status;
    for (size_t a = 0; a < m; a++) /* hatLambday: C is still factored */
        at->phi[a] = -weight * (dal__row_dot(mech, at->dmu, a, ghat)
                                + dal__row_dot(mech, at->mu, a, ghat + n));
    dal__solve_gram(mech, at->phi);
    dal__add(m, 1.0, at->phi, mech->lambda);
    build_field(mech, x);
    dal__add(2 * n, weight, ghat, mech->point);
    return DAL__DELIVER(&mech->error, {"lambda", m, mech->lambda, lambda},
                        {"xdot", 2 * n, mech->point, xdot});
}
