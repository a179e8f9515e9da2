/* Steps of the scheme's own size, for a family that knows where they end. */
#include "step/step_control.h"

#include "step/stepper.h"

#include <math.h>

static bool wanted(const dal_options *options) { return options->own_steps; }

static int make(dal_stepper *self, const dal_options *options, dal_error *error)
{
    (void)options;
    if (self->family->own_end) return DAL_SUCCESS;
    return dal__fail(error, DAL_EUNSUPPORTED, "scheme \"%s\" has no steps of its own size; give h, "
                     "or choose the scheme taylor", self->scheme.name);
}

/* An infinite h has only a direction. */
static double direction(double t, double h)
{
    return isinf(h) ? copysign(fmax(1.0, fabs(t)), h) : h;
}

static int check(dal_stepper *self, double t, double h)
{
    return dal__stepper_check_times(self, t, direction(t, h));
}

static int start(dal_stepper *self, double t, double h, const double *x, double *first)
{
    (void)self, (void)x;
    *first = direction(t, h);
    return DAL_SUCCESS;
}

static int step(dal_stepper *self, size_t steps, size_t *made)
{
    dal_motion *const motion = &self->motion;
    const double t = dal_stepper_time(self), ahead = dal__stepper_direction(self);
    double end;
    (void)steps; /* one at a time */
    int status = self->family->own_end(self->method, motion, self->until, &end);
    if (!status) {
        const bool is_last = ahead * (end - self->until) >= 0.0;
        status = dal__variable_step(self, t, is_last ? dal__variable_last(self, t) : end - t);
    }
    *made = !status;
    return status;
}

const dal__step_control dal__own_steps = {
    .name = "steps of the scheme's own size", .varies = true, .wanted = wanted, .make = make,
    .check = check, .start = start, .step = step};
