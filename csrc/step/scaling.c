/* Steps that keep the energy E: a step Phi of the scheme between two scalings of the velocity,
 * which keep v in D where D is linear in v.
 *
 * From x = (q, v), with T2 = v^T L_vv v, the derivative of E when v is scaled:
 *     y = Phi(q, v),                 s = -(E(y) - E_0) / (T2(x) + T2(y)),
 *     (q', w) = Phi(q, (1 + s) v),   v' = c w,   c^2 = 1 - 2 (E(q', w) - E_0) / T2(q', w),
 * where c is 1 + s but for terms of order s^2: but for these the step is as symmetric as Phi.  As L
 * is of second degree in v, E(q', v') is E_0 to roundoff.  E_0 is the energy of the start or of the
 * last reset, not of the step before, so that roundoff does not add up.
 *
 * The scalings push along the momenta, M v and M w, and these have no part along mu^T: the impulse
 * is that of Phi(q, (1 + s) v), and M (v' - v) is that of V and mu^T impulse, and s M v + (c-1) M w
 * beside them.
 *
 * The changes of the energy that the scalings undo add up to the drift of plain steps.  If h is too
 * large, or V_q is not the gradient of V, no motion has such a sum: energy_jump.c checks it. */
#include "step/scaling.h"

#include "step/stepper.h"
#include "step/step_control.h"

#include <math.h>
#include <string.h>

#define LIMIT 0.5 /* of |s| and |c - 1| */
/* A defect of so many u of the terms of the energy is roundoff, which no scaling would mend. */
#define ROUNDOFF 4.0
/* L is of second degree in v where L_vv at another v differs by no more than this part: differences
 * are good to 1e-12. */
#define SAME 1e-9

static int check_system(const dal_system *system, dal_error *error)
{
    const dal_system_def *const def = &system->def;
    const char *const what = def->kind == DAL_AFFINE ? "affine constraints (a scaled v leaves D)"
                           : def->kind != DAL_LINEAR ? "nonlinear constraints (a scaled v leaves D)"
                           : def->force ? "a force, which does work"
                           : def->driven ? "inputs in its constraints, which do work"
                           : !dal__is_autonomous(system) ? "an explicit dependence on time" : NULL;
    if (!what) return DAL_SUCCESS;
    return dal__fail(error, DAL_EUNSUPPORTED, "options.keep_energy: not possible for \"%s\", "
                     "because it has %s", def->name, what);
}

int dal__scaling_make(dal_stepper *self, const dal_options *options, dal_error *error)
{
    const int wanted = options ? options->keep_energy : 0;
    if (wanted == 0) return DAL_SUCCESS;
    if (wanted != 1)
        return dal__fail(error, DAL_EINVAL, "options.keep_energy = %d: expected 0 or 1", wanted);
    if (self->scheme.nodes == DAL_KEPT_NODES)
        return dal__fail(error, DAL_EUNSUPPORTED, "options.keep_energy: not possible with the kept "
                         "nodes of \"%s\", because a scaled v leaves D_eps; choose a scheme with "
                         "moved nodes", self->scheme.name);
    if (!self->scheme.symmetric || !self->family->forget_velocity)
        return dal__fail(error, DAL_EUNSUPPORTED, "options.keep_energy: not possible with \"%s\"; "
                         "choose a symmetric scheme of the family beta, for example leapfrog",
                         self->scheme.name);
    const int status = check_system(self->motion.system, error);
    if (status) return status;
    dal__snapshot_reserve(self, &self->scaling.before, &self->scaling.arena);
    self->scaling.wanted = true;
    return dal__allocate(&self->scaling.arena, error);
}

/* *E <- the energy (or NULL), *twice <- T2, of x[2n]. */
static int measure(dal_mechanics *mech, const double *x, double *E, double *twice)
{
    const size_t n = mech->n;
    const double *const v = x + n;
    double L = 0.0;
    if (mech->eval.constant_mass) {
        const int status = E ? dal__energy(mech, 0.0, x, E) : DAL_SUCCESS;
        dal__weigh(mech, v, mech->step);
        *twice = dal__dot(n, v, mech->step);
        return status;
    }
    const dal__jet wanted = {.L = E ? &L : NULL, .L_v = E ? mech->momentum : NULL,
                             .L_vv = mech->L_vv};
    const int status = dal__lagrangian(&mech->eval, 0.0, x, v, &wanted, &mech->error);
    if (status) return status;
    if (E) *E = dal__dot(n, v, mech->momentum) - L;
    dal__apply(n, n, mech->L_vv, v, mech->step);
    *twice = dal__dot(n, v, mech->step);
    return DAL_SUCCESS;
}

int dal__check_degree(dal_mechanics *mech, double t, const double *x, const char *name)
{
    const size_t n = mech->n;
    const double *const M = mech->metric.M, *const other = mech->L_vv;
    bool same = true;
    int status = dal__build_metric(mech, t, x, x + n);
    if (status) return status;
    for (size_t i = 0; i < n; i++) mech->reach[i] = 2.0 * x[n + i] + mech->metric.unit[i];
    const dal__jet wanted = {.L_vv = mech->L_vv};
    status = dal__lagrangian(&mech->eval, t, x, mech->reach, &wanted, &mech->error);
    if (status == DAL_EUSER) return status;
    for (size_t i = 0; !status && i < n; i++)
        for (size_t j = 0; j < n; j++) {
            const double size = sqrt(M[i * (n + 1)] * M[j * (n + 1)]);
            if (!(fabs(M[i * n + j] - other[i * n + j]) <= SAME * size)) same = false;
        }
    if (!status && same) return DAL_SUCCESS;
    return dal__fail(&mech->error, DAL_EUNSUPPORTED, "%s: expected L quadratic in v, but L_vv at "
                     "another velocity is %s", name,
                     status ? "not defined" : "different from its initial value");
}

int dal__scaling_start(dal_stepper *self, const double *x, double *energy)
{
    dal_mechanics *const mech = &self->mech;
    double twice;
    *energy = 0.0;
    if (!self->scaling.wanted) return DAL_SUCCESS;
    const int status =
        mech->eval.constant_mass ? DAL_SUCCESS : dal__check_degree(mech, 0.0, x, "keep_energy");
    if (status) return status;
    const int measured = measure(mech, x, energy, &twice);
    if (measured || isfinite(*energy)) return measured;
    return dal__fail(&mech->error, DAL_EDOMAIN, "the initial energy is %g: expected a finite "
                     "number", *energy);
}

/* ---- a step --------------------------------------------------------------------------------- */

/* The motion with a scaled velocity. */
static void scale(dal_stepper *self, double c)
{
    const size_t n = self->mech.n;
    double *const v = self->motion.x + n;
    for (size_t i = 0; i < n; i++) v[i] *= c;
    self->family->forget_velocity(self->method);
}

/* The scheme's own step, from where the step began. */
static int make(dal_stepper *self)
{
    size_t done;
    return self->family->advance(self->method, &self->motion, 1, &done);
}

/* The velocity after Phi, scaled; DAL_ENOCONV where it may not be. */
static int finish(dal_stepper *self)
{
    dal_motion *const motion = &self->motion;
    double E, twice;
    const int status = measure(&self->mech, motion->x, &E, &twice);
    if (status) return status;
    const double c = sqrt(1.0 - 2.0 * (E - self->scaling.energy) / twice);
    if (!(fabs(c - 1.0) <= LIMIT)) return DAL_ENOCONV;
    scale(self, c);
    /* scaling moves the residual of D by a rounding, and mostly it was at most half its bound */
    const double bound = dal__residual_bound(&self->mech);
    double *const worst = &motion->stats->worst_residual;
    if (self->mech.m > 0) *worst += DAL_ROUNDOFF;
    return *worst <= 0.5 * bound + DAL_ROUNDOFF
               ? DAL_SUCCESS : dal__mend(&self->mech, 0.0, 0.0, false, motion->x, worst);
}

/* The step with the velocity scaled by 1 + s and then back to the energy. */
static int make_scaled(dal_stepper *self, double s)
{
    double *const worst = &self->motion.stats->worst_residual;
    dal__snapshot_restore(self, &self->scaling.before);
    scale(self, 1.0 + s);
    *worst = 0.0; /* that of this step alone */
    int status = make(self);
    if (!status) status = finish(self);
    *worst = fmax(*worst, self->scaling.before.worst);
    return status;
}

static int scaled_step(dal_stepper *self)
{
    dal_mechanics *const mech = &self->mech;
    dal_stats *const stats = self->motion.stats;
    double E = NAN, before, after = 0.0;
    dal__snapshot_take(self, &self->scaling.before);
    int status = measure(mech, self->motion.x, NULL, &before);
    if (!status) status = make(self);
    if (status) {
        dal__snapshot_restore(self, &self->scaling.before);
        return status;
    }
    status = measure(mech, self->motion.x, &E, &after);
    const double defect = E - self->scaling.energy, s = -defect / (before + after);
    const double noise = ROUNDOFF * DAL_ROUNDOFF * (fabs(E) + after);
    if (defect == 0.0 || fabs(defect) < noise) return DAL_SUCCESS; /* nor where both are infinite */
    const bool possible = fabs(s) <= LIMIT;
    if (possible) status = make_scaled(self, s);
    if (possible && status == DAL_SUCCESS) {
        stats->scaled++;
        self->energy_jump.undone += defect;
        return DAL_SUCCESS;
    }
    if (possible || dal__is_final(status)) dal__snapshot_restore(self, &self->scaling.before);
    if (dal__is_final(status)) return status;
    stats->unscaled++;
    status = possible ? make(self) : DAL_SUCCESS; /* which is the step that it was */
    if (status) dal__snapshot_restore(self, &self->scaling.before);
    return status;
}

int dal__scheme_steps(dal_stepper *self, size_t steps, size_t *made)
{
    if (!self->scaling.wanted)
        return self->family->advance(self->method, &self->motion, steps, made);
    const int status = scaled_step(self);
    *made = !status;
    return status;
}
