/* Floor 4: the reference flow, the ODE on D (h) by the adaptive integrator of ode.c. */
#include "internal.h"

#include <math.h>
#include <string.h>

/* How much looser the second integration is that the accuracy is estimated from. */
static const double LOOSER = 10.0;

struct dal_flow {
    dal_mechanics mech;
    ode *integrator;
    double tolerance;
    double *result; /* [2n] */
    dal_error error;
    arena arena;
};

static size_t dimension(const dal_flow *flow) { return 2 * flow->mech.n; }

static void copy(const dal_flow *flow, double *to, const double *from)
{
    memcpy(to, from, dimension(flow) * sizeof *to);
}

/* dxdt[2n] <- the field on D at x[2n], of the mechanics ctx. */
static int field(double t, const double *x, double *dxdt, void *ctx, dal_error *error)
{
    dal_mechanics *const mech = ctx;
    const int status = dal_field(mech, t, x, dxdt);
    if (status) *error = mech->error;
    else if (!dal__all_finite(2 * mech->n, dxdt))
        return dal__fail(error, DAL_EDOMAIN, "the acceleration at t = %.17g is not finite", t);
    return status;
}

/* Making. */

int dal_flow_new(dal_flow **flow, const dal_system *system, dal_flow_method method,
                 double tolerance, dal_error *error)
{
    dal__fail(error, DAL_SUCCESS, "%s", "");
    if (!flow || !system)
        return dal__fail(error, DAL_EINVAL, "%s is NULL", flow ? "system" : "flow");

    arena memory = {0};
    dal_flow shape = {.tolerance = tolerance}, *self;
    dal__reserve(&memory, &self, 1, sizeof *self);
    dal__mechanics_reserve(&shape.mech, system, &memory);
    dal__reserve(&memory, &shape.result, 2 * dal_system_n(system), sizeof(double));
    int status = dal__allocate(&memory, error);
    if (status) return status;
    *self = shape;
    self->arena = memory;
    dal__mechanics_bind(&self->mech, system);
    status = dal__ode_new(&self->integrator, dimension(self), method, tolerance, field,
                          &self->mech, error);
    if (status) dal_flow_free(self);
    else *flow = self;
    return status;
}

void dal_flow_free(dal_flow *flow)
{
    if (!flow) return;
    dal__ode_free(flow->integrator);
    arena memory = flow->arena; /* the object lies inside it */
    dal__release(&memory);
}

const char *dal_flow_message(const dal_flow *flow) { return flow->error.text; }

size_t dal_flow_evaluations(const dal_flow *flow)
{
    return dal__ode_evaluations(flow->integrator);
}

dal_mechanics *dal__flow_mechanics(dal_flow *flow) { return &flow->mech; }

double dal__flow_tolerance(const dal_flow *flow) { return flow->tolerance; }

dal_error *dal__flow_error(dal_flow *flow) { return &flow->error; }

/* Integration. */

/* The failure of the mechanics is the failure of the flow. */
static int pass_on(dal_flow *flow, int status)
{
    flow->error = flow->mech.error;
    return status;
}

/* The state of the integrator <- x[2n] at t0 taken to t1. */
static int integrate(dal_flow *flow, double t0, double t1, const double *x, double factor,
                     bool project)
{
    ode *const integrator = flow->integrator;
    int status = dal__ode_begin(integrator, t0, t1 - t0, x, factor, &flow->error);
    if (!status) status = dal__ode_reach(integrator, t1 - t0, &flow->error);
    if (status || !project) return status;
    status = dal_project(&flow->mech, 0.0, dal__ode_state(integrator), NULL);
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
    status = integrate(flow, t0, t1, x, 1.0, project);
    if (!status) copy(flow, x, dal__ode_state(flow->integrator));
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
    status = integrate(flow, t0, t1, x, 1.0, true);
    if (status) return status;
    copy(flow, flow->result, dal__ode_state(flow->integrator));
    status = integrate(flow, t0, t1, x, LOOSER, true);
    if (status) return status;
    double difference = 0.0;
    for (size_t i = 0; i < dimension(flow); i++)
        difference = fmax(difference, fabs(flow->result[i] - dal__ode_state(flow->integrator)[i]));
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
    status = dal__ode_begin(flow->integrator, t0, h, x, 1.0, &flow->error);
    for (size_t k = 1; !status && k <= steps; k++) {
        /* The rows are projected, the integration goes on without: it need not start anew. */
        status = dal__ode_reach(flow->integrator, (double)k * h, &flow->error);
        if (status) break;
        copy(flow, flow->result, dal__ode_state(flow->integrator));
        status = dal_project(&flow->mech, 0.0, flow->result, NULL);
        if (status) return pass_on(flow, status);
        copy(flow, x + k * N, flow->result);
        if (done) *done = k;
    }
    return status;
}
