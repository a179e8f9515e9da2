/* Floor 1: one ordinary differential equation, by an adaptive method of GSL.
 *
 * The loop over steps is our own, over gsl_odeiv2_step and gsl_odeiv2_control: it refuses a step
 * that is not finite (GSL takes NaN for accurate), takes a shorter one where the field says that
 * it left its domain, and leaves GSL no reason to raise its handler.  The driver is there because
 * the multistep methods ask it for the tolerance. */
#include "internal.h"

#include <gsl/gsl_errno.h>
#include <gsl/gsl_odeiv2.h>

#include <math.h>
#include <string.h>

/* Accepted and refused steps of one integration; far more than any sensible one takes. */
enum { MOST_STEPS = 10000000 };

/* Below it steps are refused for their roundoff. */
static const double LEAST_TOLERANCE = 4.0 * DAL_ROUNDOFF;

/* The first step is a fraction of what the field suggests and of the interval. */
static const double FIRST_STEP = 0.00618033988749895;
static const double FIRST_FRACTION = 0.381966011250105;

/* GSL would report the iteration matrix 1 - h J of msbdf through its handler were it singular to
 * the last bit, as it is for round h and J with h J = 1.  The Jacobian is made too large by this
 * share, which is harmless as Newton's method corrects it, and which no round numbers undo. */
static const double NUDGE = 6.18033988749895e-10;

struct ode {
    size_t N;
    dal_flow_method method;
    double tolerance;
    dal__field_fn field;
    void *ctx;
    gsl_odeiv2_system system;
    gsl_odeiv2_driver *driver;
    double t0;       /* time is t0 + elapsed, so that short intervals lose no digits */
    double elapsed;
    double h;        /* suggested for the next step, with the sign of the direction */
    unsigned order;  /* of the multistep method when the last accepted step began */
    dal_error fault; /* of the field in the last attempt */
    size_t evaluations;
    double *state, *before;                   /* [N] */
    double *slope, *slope_after, *step_error; /* [N] */
    double *point, *right, *left;             /* [N]: of the differenced Jacobian */
    arena arena;
};

static void copy(const ode *self, double *to, const double *from)
{
    memcpy(to, from, self->N * sizeof *to);
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

/* The field, as GSL calls it.  What fails leaves its status and text in fault. */

static int faulty(ode *self, const char *what, double elapsed)
{
    dal__fail(&self->fault, DAL_EDOMAIN, "the %s at t = %.17g is not finite", what,
              self->t0 + elapsed);
    return GSL_EBADFUNC;
}

/* dydt[N] <- the field at y[N]. */
static int evaluate(double elapsed, const double y[], double dydt[], void *params)
{
    ode *const self = params;
    if (!dal__all_finite(self->N, y)) return faulty(self, "state", elapsed);
    self->evaluations++;
    const int status = self->field(self->t0 + elapsed, y, dydt, self->ctx, &self->fault);
    if (status) {
        self->fault.status = status;
        return GSL_EBADFUNC;
    }
    return dal__all_finite(self->N, dydt) ? GSL_SUCCESS : faulty(self, "field", elapsed);
}

/* dfdy[N*N] <- the Jacobian of the field by central differences, error O(d^2) + O(u/d).  No method
 * here reads dfdt[N]. */
static int difference(double elapsed, const double y[], double *dfdy, double dfdt[], void *params)
{
    ode *const self = params;
    const size_t N = self->N;
    copy(self, self->point, y);
    for (size_t j = 0; j < N; j++) {
        const double d = cbrt(DBL_EPSILON) * (1.0 + fabs(y[j]));
        const double above = y[j] + d, below = y[j] - d;
        self->point[j] = above;
        int status = evaluate(elapsed, self->point, self->right, self);
        self->point[j] = below;
        if (status == GSL_SUCCESS) status = evaluate(elapsed, self->point, self->left, self);
        self->point[j] = y[j];
        if (status != GSL_SUCCESS) return status;
        for (size_t i = 0; i < N; i++)
            dfdy[i * N + j] = (1.0 + NUDGE) * (self->right[i] - self->left[i]) / (above - below);
    }
    if (!dal__all_finite(N * N, dfdy)) return faulty(self, "differenced Jacobian", elapsed);
    memset(dfdt, 0, N * sizeof *dfdt);
    return GSL_SUCCESS;
}

/* Making. */

int dal__ode_new(ode **integrator, size_t N, dal_flow_method method, double tolerance,
                 dal__field_fn field, void *ctx, dal_error *error)
{
    if (!method_type(method))
        return dal__fail(error, DAL_EINVAL, "method = %d is not a dal_flow_method", (int)method);
    if (!(tolerance >= LEAST_TOLERANCE && tolerance <= 0.1))
        return dal__fail(error, DAL_EINVAL, "tolerance = %g is not in [%.1e, 0.1]: no step is more "
                         "accurate than roundoff", tolerance, LEAST_TOLERANCE);

    if (method == DAL_FLOW_MSBDF && dal__times(N, N) > PTRDIFF_MAX / sizeof(double))
        return dal__fail(error, DAL_ENOMEM, "the size of the Jacobian overflows"); /* in GSL */

    arena memory = {0};
    ode shape = {.N = N, .method = method, .tolerance = tolerance, .field = field, .ctx = ctx};
    ode *self;
    double **const arrays[] = {&shape.state, &shape.before, &shape.slope, &shape.slope_after,
                               &shape.step_error, &shape.point, &shape.right, &shape.left};
    dal__reserve(&memory, &self, 1, sizeof *self);
    for (size_t i = 0; i < sizeof arrays / sizeof arrays[0]; i++)
        dal__reserve(&memory, arrays[i], N, sizeof(double));
    const int status = dal__allocate(&memory, error);
    if (status) return status;

    *self = shape;
    self->arena = memory;
    self->system = (gsl_odeiv2_system){evaluate, difference, N, self};
    self->driver = gsl_odeiv2_driver_alloc_y_new(&self->system, method_type(method), FIRST_STEP,
                                                 tolerance, tolerance);
    if (!self->driver) {
        dal__release(&memory);
        return dal__fail(error, DAL_ENOMEM, "out of memory for the workspace of %s",
                         method_name(method));
    }
    *integrator = self;
    return DAL_SUCCESS;
}

void dal__ode_free(ode *self)
{
    if (!self) return;
    gsl_odeiv2_driver_free(self->driver);
    arena memory = self->arena; /* the object lies inside it */
    dal__release(&memory);
}

double *dal__ode_state(ode *self) { return self->state; }

double dal__ode_elapsed(const ode *self) { return self->elapsed; }

size_t dal__ode_evaluations(const ode *self) { return self->evaluations; }

/* Integration. */

/* The failure of the field is the failure of the integration. */
static int pass_on(const ode *self, dal_error *error)
{
    if (error) *error = self->fault;
    return self->fault.status;
}

int dal__ode_restart(ode *self, double end, dal_error *error)
{
    const double span = end - self->elapsed;
    if (evaluate(self->elapsed, self->state, self->slope, self)) return pass_on(self, error);
    gsl_odeiv2_step_reset(self->driver->s);
    self->order = 1;
    const double change =
        FIRST_STEP * (1.0 + dal__largest(self->N, self->state))
        / dal__largest(self->N, self->slope);
    self->h = copysign(fmin(change, FIRST_FRACTION * fabs(span)), span);
    return DAL_SUCCESS;
}

int dal__ode_begin(ode *self, double t0, double span, const double *y, double factor,
                   dal_error *error)
{
    const double tolerance = factor * self->tolerance;
    self->t0 = t0;
    self->elapsed = 0.0;
    memmove(self->state, y, self->N * sizeof *y); /* y may be the state */
    gsl_odeiv2_control_init(self->driver->c, tolerance, tolerance, 1.0, 0.0);
    return dal__ode_restart(self, span, error);
}

/* One step of size h from elapsed time; on refusal the state is as it was.  Either way self->h is
 * the size to go on with. */
static bool attempt(ode *self, double h)
{
    gsl_odeiv2_step *const step = self->driver->s;
    const unsigned order = gsl_odeiv2_step_order(step);
    self->fault.status = DAL_SUCCESS;
    self->h = h;
    copy(self, self->before, self->state);
    const int status = gsl_odeiv2_step_apply(step, self->elapsed, h, self->state, self->step_error,
                                             self->slope, self->slope_after, &self->system);
    const bool finite = status == GSL_SUCCESS && dal__all_finite(self->N, self->state) &&
                        dal__all_finite(self->N, self->step_error);
    if (finite && gsl_odeiv2_control_hadjust(self->driver->c, step, self->state, self->step_error,
                                             self->slope_after, &self->h) != GSL_ODEIV_HADJ_DEC) {
        copy(self, self->slope, self->slope_after);
        self->order = order;
        return true;
    }
    copy(self, self->state, self->before);
    if (!finite) self->h = 0.5 * h;
    /* A multistep method is interrupted halfway by a field that fails; and one whose order fell by
     * two since the step that it goes back to would call GSL's handler. */
    const bool interrupted = self->fault.status || (status == GSL_SUCCESS && !finite);
    if (interrupted || self->order > gsl_odeiv2_step_order(step) + 1) gsl_odeiv2_step_reset(step);
    return false;
}

static int collapsed(const ode *self, double h, dal_error *error)
{
    if (self->fault.status) return pass_on(self, error);
    return dal__fail(error, DAL_ENOCONV,
                     "%s: the step size collapsed to h = %g at t = %.17g (tolerance %g)",
                     method_name(self->method), h, self->t0 + self->elapsed, self->tolerance);
}

/* One attempt at a step towards elapsed time end, which lies ahead. */
static int attempt_towards(ode *self, double end, bool *accepted, dal_error *error)
{
    const double left = end - self->elapsed;
    const bool last = fabs(self->h) >= fabs(left);
    /* Two halves instead of a step and a very short one. */
    const double h = last ? left : fabs(self->h) > 0.5 * fabs(left) ? 0.5 * left : self->h;
    *accepted = attempt(self, h);
    if (*accepted) {
        if (!last && self->elapsed + h == self->elapsed) return collapsed(self, h, error);
        self->elapsed = last ? end : self->elapsed + h;
    } else if (self->fault.status == DAL_EUSER || self->fault.status == DAL_STOPPED ||
               !(fabs(self->h) > DBL_EPSILON * fabs(end))) {
        return collapsed(self, self->h, error);
    }
    return DAL_SUCCESS;
}

int dal__ode_step(ode *self, double end, dal_error *error)
{
    int status = DAL_SUCCESS;
    bool accepted = self->elapsed == end;
    while (!status && !accepted) status = attempt_towards(self, end, &accepted, error);
    return status;
}

int dal__ode_reach(ode *self, double end, dal_error *error)
{
    int status = DAL_SUCCESS;
    bool accepted;
    for (size_t steps = 0; !status && self->elapsed != end; steps++) {
        if (steps == MOST_STEPS)
            return dal__fail(error, DAL_ENOCONV, "%s: %d steps did not lead beyond t = %.17g, the "
                             "last of size h = %g (tolerance %g)", method_name(self->method),
                             MOST_STEPS, self->t0 + self->elapsed, self->h, self->tolerance);
        status = attempt_towards(self, end, &accepted, error);
    }
    return status;
}
