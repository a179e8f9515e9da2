/* How far a run is, and whether it may go on. */
#include "run/run.h"

#include <math.h>

bool dal__run_is_over(const dal_run *run)
{
    return run->done == run->steps
        || (dal__run_varies(run) && dal_stepper_time(run->stepper) == run->until);
}

int dal__run_callback_status(const dal_run *run, const char *name, int returned)
{
    if (returned > 0) return DAL_STOPPED;
    if (returned == 0) return DAL_SUCCESS;
    return dal__fail(&run->stepper->error, DAL_EUSER, "%s returned %d at step %zu", name, returned,
                     run->stepper->motion.steps);
}

/* A row that would start within roundoff of the end starts at the end. */
double dal__run_begin_of_inputs(const dal_run *run, size_t k)
{
    const double t = run->t_begin + (double)k * run->input_duration;
    return fabs(t - run->until) <= 8.0 * DAL_ROUNDOFF * fabs(run->until) ? run->until : t;
}

/* DAL_EINVAL unless the end and the inputs of a run with steps of varying size are valid. */
static int check_varied(const dal_run *run)
{
    dal_error *const error = &run->stepper->error;
    const double direction = dal__stepper_direction(run->stepper);
    const double t = dal_stepper_time(run->stepper);
    if (!isfinite(run->until) || direction * (run->until - t) < 0.0)
        return dal__fail(error, DAL_EINVAL, "until = %g: expected a time from t = %g on, in the "
                         "direction of the steps", run->until, t);
    if (run->inputs && !(direction * run->input_duration > 0.0 && isfinite(run->input_duration)))
        return dal__fail(error, DAL_EINVAL, "input_duration = %g: expected the time for which a "
                         "row of inputs applies, with the sign of the steps", run->input_duration);
    return DAL_SUCCESS;
}

int dal__run_check(const dal_run *run)
{
    dal_error *const error = &run->stepper->error;
    if (run->stride == 0 || (run->steps % run->stride > 0 && !dal__run_varies(run)))
        return dal__fail(error, DAL_EINVAL, "steps = %zu: expected a multiple of stride = %zu",
                         run->steps, run->stride);
    if (run->control && !run->inputs)
        return dal__fail(error, DAL_EINVAL, "control is not NULL, but inputs is NULL: expected an "
                         "array for the values of control");
    if (run->inputs && run->stepper->motion.system->def.inputs == 0)
        return dal__fail(error, DAL_EINVAL, "inputs is not NULL, but the system has no inputs; "
                         "pass NULL");
    int status = dal__stepper_started(run->stepper);
    if (!status && dal__run_varies(run)) status = check_varied(run);
    return status ? status : dal__events_check(run);
}
