/* Steps of the scheme's own size, for a family that knows where they end. */
#include "step/step_control.h"

#include "step/stepper.h"

#include <math.h>

/* A step of the family in equal parts, as many as the options ask for. */
typedef struct own_steps {
    double parts, end, part; /* the end of the step, and the length of a part */
} own_steps;

static bool wanted(const dal_options *options) { return options->own_steps != 0; }

static int make(dal_stepper *self, const dal_options *options, dal_error *error)
{
    if (options->own_steps < 0)
        return dal__fail(error, DAL_EINVAL, "options.own_steps = %d: expected a positive number",
                         options->own_steps);
    const dal_family *const family = self->family;
    const bool is_multistep = family->save && family->save(self->method, NULL) == DAL_NOT_RESUMABLE;
    if (!family->own_end || is_multistep)
        return dal__fail(error, DAL_EUNSUPPORTED, "scheme \"%s\" has no steps of its own size; "
                         "give h, or choose the scheme taylor", self->scheme.name);
    own_steps *made;
    dal__reserve(&self->variable.arena, &made, 1, sizeof *made);
    const int status = dal__allocate(&self->variable.arena, error);
    if (status) return status;
    made->parts = options->own_steps;
    self->control_data = made;
    return DAL_SUCCESS;
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

static void land(dal_stepper *self)
{
    own_steps *const data = self->control_data;
    data->end = data->part = 0.0;
}

static int start(dal_stepper *self, double t, double h, const double *x, double *first)
{
    (void)x;
    *first = direction(t, h);
    land(self);
    return DAL_SUCCESS;
}

static int step(dal_stepper *self, size_t steps, size_t *made)
{
    own_steps *const data = self->control_data;
    dal_motion *const motion = &self->motion;
    const double t = dal_stepper_time(self), ahead = dal__stepper_direction(self);
    double end;
    (void)steps; /* one at a time */
    int status = self->family->own_end(self->method, motion, self->until, &end);
    if (!status) {
        if (end != data->end || data->part == 0.0) {
            data->end = end;
            data->part = (end - t) / data->parts;
        }
        const double rest = end - t, part = data->part; /* no part that is a rounding */
        const bool is_rest = fabs(rest) < 1.5 * fabs(part) || t + part == t;
        const double h = is_rest ? rest : (t + part) - t;
        const bool is_last = ahead * (t + h - self->until) >= 0.0;
        status = dal__variable_step(self, t, is_last ? dal__variable_last(self, t) : h);
    }
    *made = !status;
    return status;
}

static void save(dal_stepper *self, dal__archive *a)
{
    own_steps *const data = self->control_data;
    dal__archive_same(a, "own_steps", data->parts);
    dal__archive_real(a, &data->end);
    dal__archive_real(a, &data->part);
}

const dal__step_control dal__own_steps = {
    .name = "steps of the scheme's own size", .varies = true, .wanted = wanted, .make = make,
    .check = check, .start = start, .step = step, .land = land, .save = save};
