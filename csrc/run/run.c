/* Many steps into the caller's arrays. */
#include "step/step.h"

#include <string.h>

/* Tells the observer of the state now; DAL_STOPPED or DAL_EUSER if it wants no more. */
static int observe(dal_stepper *stepper, dal_observer_fn observer, void *ctx)
{
    dal_stats stats;
    if (!observer) return DAL_SUCCESS;
    dal_stepper_stats(stepper, &stats);
    const int returned =
        observer(stats.steps, dal_stepper_time(stepper), dal_stepper_state(stepper), ctx);
    if (returned > 0) return DAL_STOPPED;
    if (returned == 0) return DAL_SUCCESS;
    return dal__fail(dal__stepper_error(stepper), DAL_EUSER, "the observer returned %d at step %zu",
                     returned, stats.steps);
}

int dal_integrate(dal_stepper *stepper, size_t steps, size_t stride, double *x, double *reactions,
                  dal_observer_fn observer, void *ctx, size_t *done)
{
    if (done) *done = 0;
    if (!stepper) return DAL_EINVAL;
    const dal_system *const system = dal__stepper_system(stepper);
    const size_t n = system->def.n, m = system->def.m;
    if (stride == 0 || steps % stride != 0)
        return dal__fail(dal__stepper_error(stepper), DAL_EINVAL,
                         "steps = %zu is not a multiple of stride = %zu", steps, stride);
    int status = dal_advance(stepper, 0, NULL, NULL); /* refuses a stepper that was not started */
    if (status) return status;
    if (x) memcpy(x, dal_stepper_state(stepper), 2 * n * sizeof *x);
    status = observe(stepper, observer, ctx);
    for (size_t row = 1; status == DAL_SUCCESS && row <= steps / stride; row++) {
        status = dal_advance(stepper, stride, reactions ? reactions + (row - 1) * m : NULL, NULL);
        if (status) break;
        if (x) memcpy(x + row * 2 * n, dal_stepper_state(stepper), 2 * n * sizeof *x);
        if (done) *done = row * stride;
        status = observe(stepper, observer, ctx);
    }
    return status ? status : dal__stepper_look(stepper);
}
