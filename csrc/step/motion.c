/* Where a stepper is, what it has done, and the inputs that act on it. */
#include "step/stepper.h"

#include "step/beta.h"
#include "step/scheme.h"

#include <float.h>
#include <math.h>
#include <string.h>

const dal_error *dal_stepper_error(const dal_stepper *stepper) { return &stepper->error; }
const double *dal_stepper_state(const dal_stepper *stepper) { return stepper->motion.x; }
const double *dal_stepper_inputs(const dal_stepper *stepper) { return stepper->motion.input; }

double dal_stepper_h(const dal_stepper *stepper) { return stepper->motion.h; }

double dal_stepper_time(const dal_stepper *stepper)
{
    const dal_motion *const motion = &stepper->motion;
    return motion->t0 + (double)(motion->steps - motion->first) * motion->h;
}

void dal_stepper_stats(const dal_stepper *stepper, dal_stats *stats)
{
    const evaluator *const e = &stepper->mech.eval;
    const dal_kernel *const kernel = dal__beta_kernel(stepper);
    const size_t stages = kernel ? kernel->stages : dal__scheme_count(&stepper->scheme);
    *stats = *stepper->motion.stats;
    stats->steps = stepper->motion.steps;
    stats->substeps = stats->steps * stages;
    stats->worst_residual *= 1.0 + 2.0 * DBL_EPSILON; /* the step compares without dividing */
    /* the evaluator counts what goes through it; the step routine's calls do if it differences */
    if (e->constraint_ctx == e) stats->constraint_calls = 0;
    if (e->potential_force_ctx == e && !(stepper->motion.system->def.compiled
                                         && stepper->scheme.nodes == DAL_MOVED_NODES))
        stats->potential_calls = 0;
    stats->constraint_calls += e->calls.constraint;
    stats->potential_calls += e->calls.potential;
    stats->lagrangian_calls += e->calls.lagrangian;
    stats->force_calls += e->calls.force;
    stats->differenced = stepper->motion.system->def.missing;
    stats->jump_step = stepper->energy_jump.step;
    stats->jump = stepper->energy_jump.change;
    stats->largest_kinetic = stepper->energy_jump.kinetic;
    dal__guards_report(&stepper->guards, stats);
    stats->remade = stepper->estimate.remade;
    stats->whole = !stepper->estimate.whole ? 0 : stepper->estimate.piece == 0 ? 1 : 2;
    stats->error = stepper->estimate.error;
}

int dal_stepper_input(dal_stepper *stepper, const double *u)
{
    return stepper ? dal__evaluator_input(&stepper->mech.eval, u, &stepper->error) : DAL_EINVAL;
}

int dal__stepper_check_times(dal_stepper *stepper, double t0, double h)
{
    dal_error *const error = &stepper->error;
    if (!isfinite(t0)) return dal__fail(error, DAL_EINVAL, "t0 = %g is not finite", t0);
    if (!isfinite(h) || h == 0.0 || !isfinite(1.0 / h))
        return dal__fail(error, DAL_EINVAL, "h = %g: expected a finite step other than 0", h);
    if (t0 + h == t0)
        return dal__fail(error, DAL_EINVAL, "h = %g does not change t0 = %.17g; take a larger step",
                         h, t0);
    return DAL_SUCCESS;
}

int dal__stepper_started(dal_stepper *stepper)
{
    if (stepper->started) return DAL_SUCCESS;
    return dal__fail(&stepper->error, DAL_EINVAL, "the stepper was not started; call start first");
}

int dal__stepper_enter_D(dal_stepper *stepper)
{
    dal_motion *const motion = &stepper->motion;
    dal_mechanics *const mech = &stepper->mech;
    const dal_family *const family = stepper->family;
    const size_t n = mech->n, size = motion->system->def.inputs * sizeof(double);
    double *const x = stepper->fresh, *const change = mech->w;
    if (!stepper->applied || memcmp(stepper->applied, motion->input, size) == 0)
        return DAL_SUCCESS;
    memcpy(x, motion->x, 2 * n * sizeof *x);
    const int status = dal_project(mech, dal_stepper_time(stepper), 0.0, x, NULL);
    if (status)
        return dal__fail_because(&stepper->error, status, &mech->error,
                                 "the inputs of step %zu (t = %g): ", motion->steps + 1,
                                 dal_stepper_time(stepper));
    dal__move(n, x + n, -1.0, motion->x + n, change);
    dal__add_impulse_of(mech, change, motion->impulse);
    memcpy(motion->x + n, x + n, n * sizeof *x);
    memcpy(stepper->applied, motion->input, size);
    if (family->forget_velocity) family->forget_velocity(stepper->method);
    else if (family->start) family->start(stepper->method, motion);
    return DAL_SUCCESS;
}

void dal__stepper_forget_impulse(dal_stepper *stepper)
{
    memset(stepper->motion.impulse, 0, stepper->mech.m * sizeof *stepper->motion.impulse);
}

int dal__stepper_reaction(dal_stepper *stepper, double elapsed, double *reaction)
{
    dal_stepper *const self = stepper;
    const dal_motion *const motion = &self->motion;
    double *const mean = self->mech.lambda;
    for (size_t a = 0; a < self->mech.m; a++) {
        const bool none = self->family->no_reaction || elapsed == 0.0; /* of a jump alone */
        mean[a] = none ? (double)NAN : motion->impulse[a] / elapsed;
        if (!none && !isfinite(mean[a]))
            return dal__fail(&self->error, DAL_EDOMAIN, "reaction[%zu] = %g is not finite after "
                             "step %zu (t = %g, h = %g)", a, mean[a], motion->steps,
                             dal_stepper_time(self), motion->h);
    }
    memcpy(reaction, mean, self->mech.m * sizeof *reaction);
    return DAL_SUCCESS;
}

void dal__estimate_forget(dal_stepper *stepper)
{
    dal__estimate *const estimate = &stepper->estimate;
    estimate->run = NULL;
    estimate->on = estimate->whole = false;
    estimate->remade = 0;
    estimate->error = (double)NAN;
}
