/* Floor 4: the reference flow, the ODE on D (h) by an adaptive method of GSL.
 *
 * The loop over steps is our own, over gsl_odeiv2_step and gsl_odeiv2_control: it refuses a step
 * that is not finite (GSL takes NaN for accurate), takes a shorter one where a callback says that
 * it left its domain, and leaves GSL no reason to raise its handler.  The driver is there because
 * the multistep methods ask it for the tolerance. */
#include "internal.h"

#include <gsl/gsl_errno.h>
#include <gsl/gsl_odeiv2.h>

#include <math.h>
#include <string.h>

/* Accepted and refused steps of one integration; far more than any sensible one takes. */
enum { MOST_STEPS = 10000000 };

/* How much looser the second integration is that the accuracy is estimated from. */
static const double LOOSER = 10.0;

/* The first step is a fraction of what the field suggests and of the interval.  No input makes the
 * step sizes that follow from these a round number: the iteration matrix 1 - h J of msbdf, which
 * GSL would report through its handler were it singular to the last bit, would be so only for an
 * exact coincidence such as h^2 k = 1. */
static const double FIRST_STEP = 0.00618033988749895;
static const double FIRST_FRACTION = 0.381966011250105;

struct dal_flow {
    dal_mechanics mech;
    dal_flow_method method;
    double tolerance;
    gsl_odeiv2_system ode;
    gsl_odeiv2_driver *driver;
    double t0;      /* time is t0 + elapsed, so that short intervals lose no digits */
    double elapsed;
    double h;       /* suggested for the next step, with the sign of the direction */
    unsigned order; /* of the multistep method when the last accepted step began */
    int failure;    /* of the field in the last attempt */
    size_t evaluations;
    double *state, *before, *result;             /* [2n] */
    double *slope, *slope_after, *step_error;    /* [2n] */
    double *point, *right, *left;                /* [2n]: of the differenced Jacobian */
    dal_error error;
    arena arena;
};

static size_t dimension(const dal_flow *flow) { return 2 * flow->mech.n; }

static void copy(const dal_flow *flow, double *to, const double *from)
{
    memcpy(to, from, dimension(flow) * sizeof *to);
}

static double largest(size_t count, const double *x)
{
    double most = 0.0;
    for (size_t i = 0; i < count; i++) most = fmax(most, fabs(x[i]));
    return most;
}

static const char *method_name(dal_flow_method method)
{
    switch (method) {
    case DAL_FLOW_RK8PD: return "rk8pd";
    case DAL_FLOW_MSADAMS: return "msadams";
    case DAL_FLOW_MSBDF: return "msbdf";
    }
    return NULL;
}

static const gsl_odeiv2_step_type *method_type(dal_flow_method method)
{
    switch (method) {
    case DAL_FLOW_RK8PD: return gsl_odeiv2_step_rk8pd;
    case DAL_FLOW_MSADAMS: return gsl_odeiv2_step_msadams;
    case DAL_FLOW_MSBDF: return gsl_odeiv2_step_msbdf;
    }
    return NULL;
}

/* The vector field, as GSL calls it. */

static int failed_field(dal_flow *flow, int status)
{
    flow->failure = status;
    return GSL_EBADFUNC;
}

/* dydt[2n] <- the field at y[2n]; on failure its status and text are kept. */
static int field(double elapsed, const double y[], double dydt[], void *params)
{
    dal_flow *const flow = params;
    dal_error *const error = &flow->mech.error;
    const double t = flow->t0 + elapsed;
    if (!dal__all_finite(dimension(flow), y))
        return failed_field(flow, dal__fail(error, DAL_EDOMAIN, "the state at t = %.17g is not "
                                            "finite", t));
    flow->evaluations++;
    const int status = dal_field(&flow->mech, t, y, dydt);
    if (status) return failed_field(flow, status);
    if (!dal__all_finite(dimension(flow), dydt))
        return failed_field(flow, dal__fail(error, DAL_EDOMAIN, "the acceleration at t = %.17g is "
                                            "not finite", t));
    return GSL_SUCCESS;
}

/* dfdy[2n*2n] <- the Jacobian of the field by central differences, error O(d^2) + O(u/d). */
static int field_jacobian(double elapsed, const double y[], double *dfdy, double dfdt[],
                          void *params)
{
    dal_flow *const flow = params;
    const size_t N = dimension(flow);
    copy(flow, flow->point, y);
    for (size_t j = 0; j < N; j++) {
        const double d = cbrt(DBL_EPSILON) * (1.0 + fabs(y[j]));
        const double above = y[j] + d, below = y[j] - d;
        flow->point[j] = above;
        int status = field(elapsed, flow->point, flow->right, flow);
        flow->point[j] = below;
        if (status == GSL_SUCCESS) status = field(elapsed, flow->point, flow->left, flow);
        flow->point[j] = y[j];
        if (status != GSL_SUCCESS) return status;
        for (size_t i = 0; i < N; i++)
            dfdy[i * N + j] = (flow->right[i] - flow->left[i]) / (above - below);
    }
    if (!dal__all_finite(N * N, dfdy))
        return failed_field(flow, dal__fail(&flow->mech.error, DAL_EDOMAIN, "the differenced "
                                            "Jacobian at t = %.17g is not finite",
                                            flow->t0 + elapsed));
    memset(dfdt, 0, N * sizeof *dfdt);
    return GSL_SUCCESS;
}

/* Making. */

int dal_flow_new(dal_flow **flow, const dal_system *system, dal_flow_method method,
                 double tolerance, dal_error *error)
{
    dal__fail(error, DAL_SUCCESS, "%s", "");
    if (!flow || !system)
        return dal__fail(error, DAL_EINVAL, "%s is NULL", flow ? "system" : "flow");
    if (!method_type(method))
        return dal__fail(error, DAL_EINVAL, "method = %d is not a dal_flow_method", (int)method);
    if (!(tolerance > 0.0 && tolerance <= 0.1))
        return dal__fail(error, DAL_EINVAL, "tolerance = %g is not in (0, 0.1]", tolerance);

    arena memory = {0};
    dal_flow shape = {.method = method, .tolerance = tolerance}, *self;
    const size_t N = 2 * dal_system_n(system);
    double **const arrays[] = {&shape.state, &shape.before, &shape.result,
                               &shape.slope, &shape.slope_after, &shape.step_error,
                               &shape.point, &shape.right, &shape.left};
    dal__reserve(&memory, &self, 1, sizeof *self);
    dal__mechanics_reserve(&shape.mech, system, &memory);
    for (size_t i = 0; i < sizeof arrays / sizeof arrays[0]; i++)
        dal__reserve(&memory, arrays[i], N, sizeof(double));
    const int status = dal__allocate(&memory, error);
    if (status) return status;

    *self = shape;
    self->arena = memory;
    dal__mechanics_bind(&self->mech, system);
    self->ode = (gsl_odeiv2_system){field, field_jacobian, N, self};
    self->driver = gsl_odeiv2_driver_alloc_y_new(&self->ode, method_type(method), FIRST_STEP,
                                                 tolerance, tolerance);
    if (!self->driver) {
        dal__release(&memory);
        return dal__fail(error, DAL_ENOMEM, "out of memory for the workspace of %s",
                         method_name(method));
    }
    *flow = self;
    return DAL_SUCCESS;
}

void dal_flow_free(dal_flow *flow)
{
    if (!flow) return;
    gsl_odeiv2_driver_free(flow->driver);
    arena memory = flow->arena; /* the object lies inside it */
    dal__release(&memory);
}

const char *dal_flow_message(const dal_flow *flow) { return flow->error.text; }

size_t dal_flow_evaluations(const dal_flow *flow) { return flow->evaluations; }

/* Integration. */

/* The failure of the mechanics is the failure of the flow. */
static int pass_on(dal_flow *flow, int status)
{
    flow->error = flow->mech.error;
    return status;
}

/* Ready to integrate from x[2n] at t0 over about span, to which elapsed time is measured. */
static int begin(dal_flow *flow, double t0, double span, const double *x, double tolerance)
{
    flow->t0 = t0;
    flow->elapsed = 0.0;
    flow->order = 1;
    copy(flow, flow->state, x);
    if (field(0.0, flow->state, flow->slope, flow)) return pass_on(flow, flow->failure);
    gsl_odeiv2_control_init(flow->driver->c, tolerance, tolerance, 1.0, 0.0);
    gsl_odeiv2_step_reset(flow->driver->s);
    const size_t N = dimension(flow);
    const double change = FIRST_STEP * (1.0 + largest(N, x)) / largest(N, flow->slope);
    flow->h = copysign(fmin(change, FIRST_FRACTION * fabs(span)), span);
    return DAL_SUCCESS;
}

/* One step of size h from elapsed time; on refusal the state is as it was.  Either way flow->h is
 * the size to go on with. */
static bool attempt(dal_flow *flow, double h)
{
    gsl_odeiv2_step *const step = flow->driver->s;
    const unsigned order = gsl_odeiv2_step_order(step);
    flow->failure = DAL_SUCCESS;
    flow->h = h;
    copy(flow, flow->before, flow->state);
    const int status = gsl_odeiv2_step_apply(step, flow->elapsed, h, flow->state, flow->step_error,
                                             flow->slope, flow->slope_after, &flow->ode);
    const bool finite = status == GSL_SUCCESS && dal__all_finite(dimension(flow), flow->state) &&
                        dal__all_finite(dimension(flow), flow->step_error);
    if (finite && gsl_odeiv2_control_hadjust(flow->driver->c, step, flow->state, flow->step_error,
                                             flow->slope_after, &flow->h) != GSL_ODEIV_HADJ_DEC) {
        copy(flow, flow->slope, flow->slope_after);
        flow->order = order;
        return true;
    }
    copy(flow, flow->state, flow->before);
    if (!finite) flow->h = 0.5 * h;
    /* A multistep method is interrupted halfway by a field that fails; and one whose order fell by
     * two since the step that it goes back to would call GSL's handler. */
    const bool interrupted = flow->failure || (status == GSL_SUCCESS && !finite);
    if (interrupted || flow->order > gsl_odeiv2_step_order(step) + 1) gsl_odeiv2_step_reset(step);
    return false;
}

static int collapsed(dal_flow *flow, double h)
{
    if (flow->failure) return pass_on(flow, flow->failure);
    return dal__fail(&flow->error, DAL_ENOCONV,
                     "%s: the step size collapsed to h = %g at t = %.17g (tolerance %g)",
                     method_name(flow->method), h, flow->t0 + flow->elapsed, flow->tolerance);
}

/* Integrates the state to elapsed time end. */
static int reach(dal_flow *flow, double end)
{
    const double smallest = DBL_EPSILON * fabs(end);
    for (size_t steps = 0; flow->elapsed != end; steps++) {
        if (steps == MOST_STEPS)
            return dal__fail(&flow->error, DAL_ENOCONV, "%s: %d steps did not lead beyond "
                             "t = %.17g, the last of size h = %g (tolerance %g)",
                             method_name(flow->method), MOST_STEPS, flow->t0 + flow->elapsed,
                             flow->h, flow->tolerance);
        const double left = end - flow->elapsed;
        const bool last = fabs(flow->h) >= fabs(left);
        /* Two halves instead of a step and a very short one. */
        const double h = last ? left : fabs(flow->h) > 0.5 * fabs(left) ? 0.5 * left : flow->h;
        if (attempt(flow, h)) {
            if (!last && flow->elapsed + h == flow->elapsed) return collapsed(flow, h);
            flow->elapsed = last ? end : flow->elapsed + h;
        } else if (flow->failure == DAL_EUSER || !(fabs(flow->h) > smallest)) {
            return collapsed(flow, flow->h);
        }
    }
    return DAL_SUCCESS;
}

/* flow->state <- x[2n] at t0 taken to t1. */
static int integrate(dal_flow *flow, double t0, double t1, const double *x, double tolerance,
                     bool project)
{
    int status = begin(flow, t0, t1 - t0, x, tolerance);
    if (!status) status = reach(flow, t1 - t0);
    if (status || !project) return status;
    status = dal_project(&flow->mech, 0.0, flow->state, NULL);
    return status ? pass_on(flow, status) : DAL_SUCCESS;
}

static int require_interval(dal_flow *flow, double t0, double t1, const double *x)
{
    if (!x) return dal__fail(&flow->error, DAL_EINVAL, "x is NULL");
    if (!isfinite(t0) || !isfinite(t1) || !isfinite(t1 - t0))
        return dal__fail(&flow->error, DAL_EINVAL, "from t0 = %g to t1 = %g is not a finite "
                         "interval", t0, t1);
    for (size_t i = 0; i < dimension(flow); i++)
        if (!isfinite(x[i]))
            return dal__fail(&flow->error, DAL_EINVAL, "x[%zu] = %g is not finite", i, x[i]);
    return DAL_SUCCESS;
}

int dal__flow_apply(dal_flow *flow, double t0, double t1, double *x, bool project)
{
    if (!flow) return DAL_EINVAL;
    int status = require_interval(flow, t0, t1, x);
    if (status || t1 == t0) return status;
    status = integrate(flow, t0, t1, x, flow->tolerance, project);
    if (!status) copy(flow, x, flow->state);
    return status;
}

int dal_flow_apply(dal_flow *flow, double t0, double t1, double *x, double *accuracy)
{
    if (!flow) return DAL_EINVAL;
    if (!accuracy) return dal__flow_apply(flow, t0, t1, x, true);
    int status = require_interval(flow, t0, t1, x);
    if (status) return status;
    if (t1 == t0) {
        *accuracy = 0.0;
        return DAL_SUCCESS;
    }
    status = integrate(flow, t0, t1, x, flow->tolerance, true);
    if (status) return status;
    copy(flow, flow->result, flow->state);
    status = integrate(flow, t0, t1, x, LOOSER * flow->tolerance, true);
    if (status) return status;
    double difference = 0.0;
    for (size_t i = 0; i < dimension(flow); i++)
        difference = fmax(difference, fabs(flow->result[i] - flow->state[i]));
    copy(flow, x, flow->result);
    *accuracy = difference;
    return DAL_SUCCESS;
}

int dal_flow_trajectory(dal_flow *flow, double t0, double h, size_t steps, double *x, size_t *done)
{
    if (done) *done = 0;
    if (!flow) return DAL_EINVAL;
    const size_t N = dimension(flow);
    int status = require_interval(flow, t0, t0 + (double)steps * h, x);
    if (!status && h == 0.0) status = dal__fail(&flow->error, DAL_EINVAL, "h = 0");
    if (status || steps == 0) return status;
    status = begin(flow, t0, h, x, flow->tolerance);
    for (size_t k = 1; !status && k <= steps; k++) {
        /* The rows are projected, the integration goes on without: it need not start anew. */
        status = reach(flow, (double)k * h);
        if (status) break;
        copy(flow, flow->result, flow->state);
        status = dal_project(&flow->mech, 0.0, flow->result, NULL);
        if (status) return pass_on(flow, status);
        copy(flow, x + k * N, flow->result);
        if (done) *done = k;
    }
    return status;
}
