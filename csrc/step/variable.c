/* Steps whose size varies: each begins where the one before ended. */
#include "step/step_control.h"

#include "step/stepper.h"

#include <math.h>

int dal__variable_make(dal_stepper *self, dal_error *error)
{
    dal__snapshot_reserve(self, &self->variable.before, &self->variable.arena);
    return dal__allocate(&self->variable.arena, error);
}

int dal__variable_step(dal_stepper *self, double t, double h)
{
    dal_motion *const motion = &self->motion;
    size_t done = 0;
    if (self->family->rescale) self->family->rescale(self->method, h / motion->h);
    motion->t0 = t;
    motion->h = h;
    motion->first = motion->steps;
    motion->error->text[0] = '\0';
    return dal__scheme_steps(self, 1, &done);
}

int dal__variable_advance(dal_stepper *self, int (*step)(dal_stepper *stepper), const double *h,
                          size_t *made)
{
    struct dal__guards *const guards = &self->guards;
    dal_motion *const motion = &self->motion;
    const double t = dal_stepper_time(self);
    int status = dal__creep_check(&guards->creep, t, fabs(self->until - t), motion->error);
    if (!status && dal__creep_is_short(&guards->creep, *h))
        status = dal__rank_look(&guards->rank, &self->mech, t, 0.0, guards->allowed, motion->x);
    if (!status) status = step(self);
    if (!status) dal__creep_step(&guards->creep, motion->t0 + motion->h, *h);
    *made = !status;
    return status;
}

double dal__variable_last(const dal_stepper *self, double t)
{
    const double until = self->until, left = until - t;
    for (int side = -1; side <= 1; side += 2) {    /* t + left may be rounded to its neighbour */
        const double next = nextafter(left, side * (double)INFINITY);
        if (t + left != until && t + next == until) return next;
    }
    return left;
}

int dal_stepper_until(dal_stepper *stepper, double t)
{
    if (!stepper) return DAL_EINVAL;
    dal_error *const error = &stepper->error;
    if (!stepper->step_control->varies)
        return dal__fail(error, DAL_EUNSUPPORTED, "until needs steps of variable size; this "
                         "stepper has a fixed h");
    const int status = dal__stepper_started(stepper);
    if (status) return status;
    if (!(dal__stepper_direction(stepper) * (t - dal_stepper_time(stepper)) >= 0.0))
        return dal__fail(error, DAL_EINVAL, "t = %g: expected a time from %g on, in the direction "
                         "of the steps", t, dal_stepper_time(stepper));
    stepper->until = t;
    return DAL_SUCCESS;
}
