/* The family flow: a step is the flow of the ODE on D over h, by an adaptive method. */
#include "geometry/geometry.h"
#include "step/scheme.h"

#include <math.h>

extern const dal_family dal__family_flow;

static const dal_scheme records[] = {
    {.name = "reference", .family = &dal__family_flow,
     .help = "adaptive integration of the ODE on D: best for short accurate runs",
     .reference = "Prince and Dormand 1981: rk8pd; GSL odeiv2: msadams; Hairer and "
                  "Wanner 1996: rodas"},
};

static int make(void **method, dal_motion *motion, dal_error *error)
{
    const dal_flow_scheme defaults = {0}, *const data = motion->scheme->data;
    const dal_flow_scheme *const chosen = data ? data : &defaults;
    const double tolerance = chosen->tolerance != 0.0 ? chosen->tolerance : DAL_FLOW_TOLERANCE;
    dal_flow *flow;
    int status = dal__scheme_check_plain(motion->scheme, "flow", error);
    if (!status)
        status = dal_flow_new(&flow, motion->system, chosen->method, DAL_FLOW_X, tolerance, error);
    if (status) return status;
    dal__flow_guard(flow, motion->guards);
    *method = flow;
    return DAL_SUCCESS;
}

static void release(void *method) { dal_flow_free(method); }

static void start(void *method, dal_motion *motion)
{
    (void)motion;
    dal__flow_forget(method);
}

static int advance(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    const size_t evaluations = dal_flow_evaluations(method);
    int status = dal_flow_input(method, motion->input);
    dal_flow_watch(method, motion->watch, motion->watch_ctx);
    for (*done = 0; !status && *done < steps; *done += !status)
        status = dal__flow_step(method, motion->t0, motion->h,
                                motion->steps - motion->first + *done, motion->x,
                                &motion->stats->worst_residual);
    motion->stats->evaluations += dal_flow_evaluations(method) - evaluations;
    if (status) *motion->error = *dal_flow_error(method);
    return status;
}

/* Of a run to a finite time: its first step. */
static const double PART = 0x1p-9;

static int own_end(void *method, dal_motion *motion, double until, double *end)
{
    const double *const inner = dal__flow_inner(method);
    const double t = motion->t0 + (double)(motion->steps - motion->first) * motion->h;
    const double left = isfinite(until) ? fabs(until - t) : fmax(1.0, fabs(t));
    const double first = motion->steps > 0 ? fabs(motion->h) : PART * left;
    const double size = inner && *inner > 0.0 ? *inner : first;
    *end = t + copysign(size, motion->h);
    return DAL_SUCCESS;
}

/* The method and the tolerance, which other steps would be made by, and the inner size. */
enum { METHOD, TOLERANCE, INNER, SAVED };

static size_t save(const void *method, double *values)
{
    dal_flow *const flow = (dal_flow *)method;
    const double *const inner = dal__flow_inner(flow);
    if (inner && values) {
        values[METHOD] = dal__flow_method(flow);
        values[TOLERANCE] = dal__flow_tolerance(flow);
        values[INNER] = *inner;
    }
    return inner ? SAVED : DAL_NOT_RESUMABLE;
}

static int accepts(const void *method, const double *values)
{
    return values[METHOD] == dal__flow_method(method)
        && values[TOLERANCE] == dal__flow_tolerance(method) && values[INNER] >= 0.0;
}

static void restore(void *method, const double *values)
{
    *dal__flow_inner(method) = values[INNER];
}

const dal_family dal__family_flow = {
    .name = "flow",
    .schemes = records,
    .count = DAL_LENGTH(records),
    .no_reaction = 1, /* the flow has no multiplier of its own */
    .make = make,
    .free = release,
    .start = start,
    .advance = advance,
    .own_end = own_end,
    .save = save,
    .accepts = accepts,
    .restore = restore,
};
