/* The reference flow, the ODE on D (h) by the adaptive integrator of ode.c; in the states
 * x, or in the coordinates xi of charts (ODExi). */
#include "geometry/geometry.h"

#include <math.h>

/* How much looser the second integration is that the accuracy is estimated from. */
static const double LOOSER = 10.0;

/* And at the most such a share of the interval is a step of it.  Where the tolerance lets steps
 * grow freely both integrations would else take the same ones, and make the same error. */
static const double LONGEST = 0.0578;

/* Numbers of the field between two looks at the clock, each of which costs a quarter of the field
 * of a small system; in a large one it is read at every evaluation. */
enum { PER_LOOK = 128 };

/* Inner steps after which the state is moved back into D.  It leaves D by roundings and by what the
 * tolerance allows, and the ODE keeps what mu v is then: the velocity is off by as much all the
 * time, which in a long interval is far more than the tolerance.  A multistep method has to start
 * anew there, from short steps. */
enum { PER_MEND = 24, PER_MEND_OF_MULTISTEP = 1024 };

/* The error of a position constraint that inner steps of a tolerance add up to, see rank.c. */
static const double PER_TOLERANCE = 10.0;

struct dal_flow {
    bool in_xi;
    dal_chart chart;         /* but for its mechanics in xi only */
    size_t chart_changes;
    double t0;               /* where the integration began */
    ode *integrator;
    double tolerance;
    double *result, *state;  /* [2n] */
    dal_flow_method method;
    struct {                 /* of dal__flow_step */
        bool going;
        double inner;        /* size of the inner steps to begin with; 0: not known */
        size_t first;        /* number of the step where integration began */
    } steps;
    bool in_D;               /* the state is to stay there */
    size_t unmended;         /* inner steps since it was there to roundoff */
    struct dal__guards *guards; /* of a stepper, or own */
    struct dal__guards own;
    dal__watch watch;
    size_t unwatched;        /* numbers of the field since the clock was read */
    arena arena;
};

dal_mechanics *dal__flow_mechanics(dal_flow *flow) { return &flow->chart.mech; }

static dal_error *error_of(dal_flow *flow) { return &flow->chart.mech.error; }

static size_t dimension(const dal_flow *flow) { return 2 * flow->chart.mech.n; }

/* Whether to go on at time t. */
static int ask(dal_flow *flow, double t, dal_error *error)
{
    if (!flow->watch.function || (flow->unwatched += dimension(flow)) < PER_LOOK)
        return DAL_SUCCESS;
    flow->unwatched = 0;
    return dal__ask(&flow->watch, t, error);
}

/* dydt <- the field on D at y, which is x[2n] or xi[2n-m], of the flow ctx. */
static int field(double t, const double *y, double *dydt, void *ctx, dal_error *error)
{
    dal_flow *const flow = ctx;
    int status = ask(flow, t, error);
    if (status) return status;
    status = flow->in_xi ? dal_chart_field(&flow->chart, t, y, dydt)
                         : dal__field(&flow->chart.mech, t, y, dydt);
    if (status) *error = *error_of(flow);
    return status;
}

/* Making. */

int dal_flow_new(dal_flow **flow, const dal_system *system, dal_flow_method method,
                 dal_flow_coordinates coordinates, double tolerance, dal_error *error)
{
    int status = DAL__REQUIRE(error, {"flow", flow}, {"system", system});
    if (status) return status;
    if (coordinates != DAL_FLOW_X && coordinates != DAL_FLOW_XI)
        return dal__fail(error, DAL_EINVAL, "coordinates = %d is not a dal_flow_coordinates",
                         (int)coordinates);

    dal_flow shape = {.in_xi = coordinates == DAL_FLOW_XI, .tolerance = tolerance,
                      .method = method}, *self;
    const size_t n = system->def.n, N = shape.in_xi ? 2 * n - system->def.m : 2 * n;
    dal__reserve(&shape.arena, &self, 1, sizeof *self);
    if (shape.in_xi) dal__chart_reserve(&shape.chart, system, &shape.arena);
    else dal__mechanics_reserve(&shape.chart.mech, system, &shape.arena);
    DAL__RESERVE(&shape.arena, 2 * n, &shape.result, &shape.state);
    dal__rank_reserve(&shape.own.rank, n, system->def.m, &shape.arena);
    status = dal__allocate(&shape.arena, error);
    if (status) return status;
    *self = shape;
    self->guards = &self->own;
    self->own.allowed = PER_TOLERANCE * tolerance;
    if (self->in_xi) dal__chart_bind(&self->chart, system);
    else dal__mechanics_bind(&self->chart.mech, system);
    status = dal__ode_new(&self->integrator, N, method, tolerance, field, self, error);
    if (status) dal_flow_free(self);
    else *flow = self;
    return status;
}

void dal_flow_free(dal_flow *flow)
{
    if (!flow) return;
    dal__ode_free(flow->integrator);
    dal__release(&flow->arena);
}

void dal_flow_watch(dal_flow *flow, dal_watch_fn watch, void *ctx)
{
    if (!flow || (flow->watch.function == watch && flow->watch.ctx == ctx))
        return; /* the clock of the same watch goes on */
    flow->watch = (dal__watch){.function = watch, .ctx = ctx};
    flow->unwatched = PER_LOOK; /* asked at the next evaluation */
}

const dal_error *dal_flow_error(const dal_flow *flow) { return &flow->chart.mech.error; }

int dal_flow_input(dal_flow *flow, const double *u)
{
    return flow ? dal_mechanics_input(&flow->chart.mech, u) : DAL_EINVAL;
}

size_t dal_flow_chart_changes(const dal_flow *flow) { return flow->chart_changes; }

void dal_flow_stats(const dal_flow *flow, dal_stats *stats)
{
    *stats = (dal_stats){0};
    dal__guards_report(flow->guards, stats);
}

size_t dal_flow_evaluations(const dal_flow *flow)
{
    return dal__ode_evaluations(flow->integrator);
}

double dal__flow_tolerance(const dal_flow *flow) { return flow->tolerance; }

dal_flow_method dal__flow_method(const dal_flow *flow) { return flow->method; }

/* Integration.  The failure of the chart, or its mechanics, is that of the flow. */

/* Ready to integrate from x[2n] at t0 over about span; in_D: x lies there, and is kept there. */
static int begin(dal_flow *flow, double t0, double span, const double *x, double factor, bool in_D)
{
    const int status = flow->in_xi ? dal_chart_choose(&flow->chart, t0, NULL, x) : DAL_SUCCESS;
    if (status) return status;
    if (flow->in_xi) dal__chart_drop(&flow->chart, x, flow->chart.y);
    flow->t0 = t0;
    flow->in_D = in_D && flow->chart.mech.m > 0 && !flow->in_xi;
    flow->unmended = 0;
    if (flow->guards == &flow->own && factor == 1.0) { /* not for the accuracy, once more */
        dal_mechanics *const mech = &flow->chart.mech;
        const int looked = dal__forms_at(mech, t0, 0.0, x, false);
        if (looked) return looked;
        dal__rank_find(&flow->own.rank, mech);
        dal__rank_start(&flow->own.rank, mech->m);
    }
    flow->own.creep = (dal__creep){0};
    return dal__ode_begin(flow->integrator, t0, span, flow->in_xi ? flow->chart.y : x, factor,
                          error_of(flow));
}

/* flow->state <- psi(xi) of the integrator at time t, in a chart that is well conditioned there. */
static int renew_chart(dal_flow *flow, double t, double end)
{
    double *const xi = dal__ode_state(flow->integrator);
    int changed = 0, status = dal_chart_lift(&flow->chart, t, xi, flow->state);
    if (!status) status = dal_chart_renew(&flow->chart, t, flow->state, &changed);
    if (status || !changed) return status;
    flow->chart_changes++;
    dal__chart_drop(&flow->chart, flow->state, xi);
    return dal__ode_restart(flow->integrator, end, error_of(flow));
}

/* Its steps depend on those before. */
static bool is_multistep(const dal_flow *flow) { return flow->method == DAL_FLOW_MSADAMS; }

/* x[2n], where the field has just been looked at, so that C is regular there, moves into D. */
static int settle(dal_mechanics *mech, double t, double *x)
{
    if (mech->m == 0 || mech->eval.system->def.kind == DAL_NONLINEAR)
        return dal_project(mech, t, 0.0, x, NULL);
    return dal__mend(mech, t, 0.0, false, x, &mech->relative);
}

/* The state of the integrator, at time t, moves into D. */
static int mend(dal_flow *flow, double t, double end)
{
    const int status = settle(&flow->chart.mech, t, dal__ode_state(flow->integrator));
    flow->unmended = 0;
    if (status) return status;
    return is_multistep(flow) ? dal__ode_restart(flow->integrator, end, error_of(flow))
                              : dal__ode_renew(flow->integrator, error_of(flow));
}

/* After an inner step. */
static int guard(dal_flow *flow)
{
    struct dal__guards *const guards = flow->guards;
    const double t = flow->t0 + dal__ode_elapsed(flow->integrator);
    const double h = dal__ode_suggested(flow->integrator);
    dal__creep_step(&guards->creep, t, h);
    if (flow->in_xi || !dal__creep_is_short(&guards->creep, h))
        return DAL_SUCCESS;
    return dal__rank_look(&guards->rank, &flow->chart.mech, t, 0.0, guards->allowed,
                          dal__ode_state(flow->integrator));
}

/* flow->state <- the state at elapsed time end, which is the time t1. */
static int reach(dal_flow *flow, double end, double t1)
{
    ode *const integrator = flow->integrator;
    dal_error *const error = error_of(flow);
    int status = DAL_SUCCESS;
    while (!status && dal__ode_elapsed(integrator) != end) {
        const double left = fabs(end - dal__ode_elapsed(integrator));
        status = dal__creep_check(&flow->guards->creep, flow->t0 + dal__ode_elapsed(integrator),
                                  left, error);
        if (!status) status = dal__ode_step(integrator, end, error);
        if (!status) status = guard(flow);
        if (status) break;
        const double elapsed = dal__ode_elapsed(integrator);
        if (flow->in_xi)
            status = renew_chart(flow, elapsed == end ? t1 : flow->t0 + elapsed, end);
        else if (flow->in_D && elapsed != end
                 && ++flow->unmended >= (is_multistep(flow) ? PER_MEND_OF_MULTISTEP : PER_MEND))
            status = mend(flow, flow->t0 + elapsed, end);
    }
    if (!status && !flow->in_xi)
        dal__copy(dimension(flow), dal__ode_state(integrator), flow->state);
    return status;
}

/* Off D the ODE keeps phi, and is left to it. */
static int starts_in_D(dal_flow *flow, double t0, const double *x, bool *in_D)
{
    double relative;
    return dal__lies_in_D(&flow->chart.mech, t0, 0.0, x, &relative, in_D);
}

/* flow->state <- x[2n] at t0 taken to t1 = t0 + span. */
static int integrate(dal_flow *flow, double t0, double span, double t1, const double *x,
                     double factor, bool project)
{
    bool in_D = false;
    int status = project ? starts_in_D(flow, t0, x, &in_D) : DAL_SUCCESS;
    if (!status) status = begin(flow, t0, span, x, factor, in_D);
    if (!status && factor > 1.0) dal__ode_shorten(flow->integrator, LONGEST * fabs(span));
    if (!status) status = reach(flow, span, t1);
    if (status || !project || flow->in_xi) return status; /* psi(xi) lies in D */
    return dal_project(&flow->chart.mech, t1, 0.0, flow->state, NULL);
}

static int require_interval(dal_flow *flow, double t0, double t1, const double *x)
{
    dal_error *const error = error_of(flow);
    if (!isfinite(t0) || !isfinite(t1) || !isfinite(t1 - t0))
        return dal__fail(error, DAL_EINVAL, "t0 = %g, t1 = %g: expected a finite interval", t0,
                         t1);
    return DAL__REQUIRE_FINITE(error, {"x", dimension(flow), x});
}

int dal__flow_apply(dal_flow *flow, double t0, double span, double *x, bool project)
{
    if (span == 0.0) return DAL_SUCCESS;
    const int status = integrate(flow, t0, span, t0 + span, x, 1.0, project);
    if (!status) dal__copy(dimension(flow), flow->state, x);
    return status;
}

/* The terms of which the acceleration is the sum, of the coordinate where they are largest: a
 * reaction may take all that a force gives.  They are as dal_multipliers left them. */
static double largest_force(dal_mechanics *mech)
{
    dal__accelerate(mech, mech->force, mech->w);
    for (size_t i = 0; i < mech->n; i++) mech->w[i] = fabs(mech->w[i]);
    for (size_t e = 0; e < dal__entries(&mech->eval); e++) mech->gram.Z[e] = fabs(mech->gram.Z[e]);
    for (size_t a = 0; a < mech->m; a++)
        dal__row_add(mech, fabs(mech->lambda[a]), mech->gram.Z, a, mech->w);
    return dal__largest(mech->n, mech->w);
}

/* *error <- what roundoff does at the least: to the result; all the time to velocity and
 * acceleration, where nearly dependent forms make more of it; and to the time that they depend
 * on. */
static int roundoff(dal_flow *flow, double t0, double t1, double *error)
{
    dal_mechanics *const mech = &flow->chart.mech;
    const dal__linear *const C = &mech->gram.C;
    const size_t N = dimension(flow), n = mech->n, m = mech->m;
    const double span = fabs(t1 - t0);
    int status = dal__field(mech, t1, flow->result, flow->state);
    if (!status) status = dal_multipliers(mech, t1, flow->result, mech->lambda);
    if (status) return status;
    double inverse = 0.0; /* the trace of that of C scaled to a unit diagonal, or its norm */
    if (C->pattern) inverse = dal__linear_inverse_norm(C);
    for (size_t a = 0; !C->pattern && a < m; a++)
        inverse += C->sizes[a] * dal__dot(a + 1, C->A + a * m, C->A + a * m);
    const double drift =
        (dal__largest(n, flow->result + n) + 0.5 * span * largest_force(mech)) * span;
    *error = 4.0 * DAL_ROUNDOFF * dal__largest(N, flow->result)
           + DAL_ROUNDOFF * sqrt(inverse) * drift;
    if (!dal__is_autonomous(mech->eval.system))
        *error += DAL_ROUNDOFF * fmax(fabs(t0), fabs(t1)) * dal__largest(N, flow->state);
    return DAL_SUCCESS;
}

int dal_flow_apply(dal_flow *flow, double t0, double t1, double *x, double *accuracy)
{
    if (!flow) return DAL_EINVAL;
    int status = require_interval(flow, t0, t1, x);
    if (status) return status;
    double difference = 0.0, least = 0.0;
    if (t1 != t0) {
        status = integrate(flow, t0, t1 - t0, t1, x, 1.0, true);
        if (status) return status;
        dal__copy(dimension(flow), flow->state, flow->result);
        if (accuracy) status = integrate(flow, t0, t1 - t0, t1, x, LOOSER, true);
        difference = dal__largest_difference(dimension(flow), flow->result, flow->state);
        if (!status && accuracy) status = roundoff(flow, t0, t1, &least);
        if (status) return status;
        dal__copy(dimension(flow), flow->result, x);
    }
    if (accuracy) *accuracy = fmax(difference, least);
    return DAL_SUCCESS;
}

int dal_flow_trajectory(dal_flow *flow, double t0, double h, size_t steps, double *x, size_t *done)
{
    if (done) *done = 0;
    if (!flow) return DAL_EINVAL;
    const size_t N = dimension(flow);
    int status = require_interval(flow, t0, t0 + (double)steps * h, x);
    if (!status && h == 0.0) status = dal__fail(error_of(flow), DAL_EINVAL, "h = 0: expected a "
                                                "step other than 0");
    if (status || steps == 0) return status;
    bool in_D;
    status = starts_in_D(flow, t0, x, &in_D);
    if (!status) status = begin(flow, t0, h, x, 1.0, in_D);
    for (size_t k = 1; !status && k <= steps; k++) {
        const double t = t0 + (double)k * h;
        /* Each row is projected; the integration, which need not start anew, only now and then. */
        status = reach(flow, (double)k * h, t);
        if (status) break;
        dal__copy(dimension(flow), flow->state, flow->result);
        if (!flow->in_xi) status = dal_project(&flow->chart.mech, t, 0.0, flow->result, NULL);
        if (status) return status;
        dal__copy(dimension(flow), flow->result, x + k * N);
        if (done) *done = k;
    }
    return status;
}

/* Single steps. */

void dal__flow_guard(dal_flow *flow, struct dal__guards *guards)
{
    guards->allowed = flow->own.allowed;
    flow->guards = guards;
}

void dal__flow_forget(dal_flow *flow)
{
    flow->steps.going = false;
    flow->steps.inner = 0.0;
}

double *dal__flow_inner(dal_flow *flow) { return is_multistep(flow) ? NULL : &flow->steps.inner; }

int dal__flow_step(dal_flow *flow, double t0, double h, size_t k, double *x, double *worst)
{
    const double t1 = t0 + ((double)k + 1.0) * h;
    dal_mechanics *const mech = &flow->chart.mech;
    int status = DAL_SUCCESS;
    if (!is_multistep(flow) || !flow->steps.going) {
        const double t = t0 + (double)k * h;
        bool in_D = true; /* where a step has ended */
        flow->steps.first = k;
        if (flow->steps.inner == 0.0) status = starts_in_D(flow, t, x, &in_D);
        if (!status) status = begin(flow, t, h, x, 1.0, in_D);
        if (!status && flow->steps.inner != 0.0)
            dal__ode_suggest(flow->integrator, h, flow->steps.inner);
    }
    flow->steps.going = false;
    if (!status) status = reach(flow, (double)(k + 1 - flow->steps.first) * h, t1);
    if (status) return status;
    dal__copy(dimension(flow), flow->state, flow->result);
    status = settle(mech, t1, flow->result);
    if (status) return status;
    *worst = fmax(*worst, mech->relative);
    dal__copy(dimension(flow), flow->result, x);
    flow->steps.inner = dal__ode_suggested(flow->integrator);
    flow->steps.going = true;
    return DAL_SUCCESS;
}
