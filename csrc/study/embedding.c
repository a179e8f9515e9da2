/* A scheme as the period map of a periodically perturbed flow (pertODE, propoDisc).
 *
 * With F the flow of the ODE in xi, f its field, Phi the scheme with step h and chi_0, chi_1 the
 * cut-off functions, the curve G~(tau, y) = chi_0 F(h tau, y) + chi_1 F(h tau - h, Phi(y)) leads
 * from y to Phi(y) while tau goes from 0 to 1 (Gdef, Gtilde).  The field that has these curves as
 * solutions is f + h^p g(tau, xi), 1-periodic in tau.  g at z takes the y whose curve passes
 * through z at tau (ztilde), by a contraction with the factor O(h^(p+1)), and no derivative of G~
 * (gdefinition):
 *     h^p g = (chi_0'/h) (F1 - F2) + chi_0 f(F1) + chi_1 f(F2) - f(z),
 * F1 = F(h tau, y), F2 = F(h tau - h, Phi(y)). */
#include "dalembert/study.h"
#include "step/stepper.h"

#include <math.h>

static const double DEFAULT_TOLERANCE = 1e-14; /* of the flow, times h^-(p+1) in g */
static const double RUN_TOLERANCE = 1e-12;     /* of the perturbed flow, */
enum { STEPS_A_PERIOD = 1000 };                /* which takes about 50 of them */
static const double MOST_PERIODS = 0x1p53;     /* beyond, tau has no phase */

struct dal_embedding {
    const dal_system *system;
    dal_chart *chart;
    dal_stepper *stepper;
    dal_flow *flow;       /* NULL: the exact solution */
    ode *perturbed;
    double h, tolerance;
    int order;
    size_t width;         /* 2n - m */
    dal__watch watch;     /* sees the steps of the curve */
    double *x, *moved;    /* [2n] */
    double *y, *next, *F1, *F2, *field1, *field2, *field0; /* [width] */
    dal_error error;
    arena arena;
};

const dal_error *dal_embedding_error(const dal_embedding *embedding) { return &embedding->error; }
dal_chart *dal_embedding_chart(dal_embedding *embedding) { return embedding->chart; }
int dal_embedding_order(const dal_embedding *embedding) { return embedding->order; }

/* ---- making ------------------------------------------------------------------------------ */

static int perturbed_field(double t, const double *z, double *zdot, void *ctx, dal_error *error);

static int check_def(const dal_system *system, const dal_embedding_def *def, dal_error *error)
{
    if (dal__require_step(error, def->h)) return DAL_EINVAL;
    if (def->order < 0)
        return dal__fail(error, DAL_EINVAL, "order = %d: expected 0 or a positive number",
                         def->order);
    if (def->order == 0 && def->scheme->order <= 0)
        return dal__fail(error, DAL_EINVAL, "order = 0: expected a positive order, because the "
                         "record of the scheme promises none");
    if (def->tolerance != 0.0 && dal__check_tolerance(def->tolerance, error)) return DAL_EINVAL;
    if (!dal__is_autonomous(system))
        return dal__fail(error, DAL_EUNSUPPORTED, "%s: expected an autonomous system",
                         system->def.force ? "a force may depend on time"
                         : system->def.driven ? "inputs drive the constraints"
                                              : "the system depends on time");
    return DAL_SUCCESS;
}

/* The parts that are objects of their own. */
static int make_parts(dal_embedding *self, const dal_embedding_def *def, dal_error *error)
{
    dal_scheme moved = *def->scheme; /* of kept nodes the conjugate by S is embedded */
    moved.nodes = DAL_MOVED_NODES;
    int status = dal_chart_new(&self->chart, self->system, error);
    if (!status) status = dal_stepper_new(&self->stepper, self->system, &moved, NULL, error);
    if (!status && (def->numerical || !self->system->def.exact))
        status = dal_flow_new(&self->flow, self->system, DAL_FLOW_RK8PD, DAL_FLOW_X,
                              self->tolerance, error);
    if (!status)
        status = dal__ode_new(&self->perturbed, self->width, DAL_FLOW_RK8PD, RUN_TOLERANCE,
                              perturbed_field, self, error);
    return status;
}

int dal_embedding_new(dal_embedding **embedding, const dal_system *system,
                      const dal_embedding_def *def, dal_error *error)
{
    int status = DAL__REQUIRE(error, {"embedding", embedding}, {"system", system}, {"def", def},
                              {"def->scheme", def && def->scheme});
    if (!status) status = check_def(system, def, error);
    if (status) return status;
    const size_t n = system->def.n, width = 2 * n - system->def.m;
    dal_embedding shape = {.system = system, .h = def->h, .width = width,
                           .order = def->order ? def->order : def->scheme->order,
                           .tolerance = def->tolerance > 0.0 ? def->tolerance : DEFAULT_TOLERANCE};
    dal_embedding *self;
    arena memory = {0};
    dal__reserve(&memory, &self, 1, sizeof *self);
    DAL__RESERVE(&memory, 2 * n, &shape.x, &shape.moved);
    DAL__RESERVE(&memory, width, &shape.y, &shape.next, &shape.F1, &shape.F2, &shape.field1,
                 &shape.field2, &shape.field0);
    status = dal__allocate(&memory, error);
    if (status) return status;
    *self = shape;
    self->arena = memory;
    status = make_parts(self, def, error);
    if (status) {
        dal_embedding_free(self);
        return status;
    }
    *embedding = self;
    return DAL_SUCCESS;
}

void dal_embedding_free(dal_embedding *embedding)
{
    if (!embedding) return;
    dal__ode_free(embedding->perturbed);
    dal_flow_free(embedding->flow);
    dal_stepper_free(embedding->stepper);
    dal_chart_free(embedding->chart);
    dal__release(&embedding->arena);
}

void dal_embedding_watch(dal_embedding *embedding, dal_watch_fn watch, void *ctx)
{
    if (!embedding) return;
    embedding->watch = (dal__watch){.function = watch, .ctx = ctx};
    dal_flow_watch(embedding->flow, dal__relay, &embedding->watch);
}

/* ---- the flow and the scheme in xi ------------------------------------------------------- */

static int chart_result(dal_embedding *self, int status, const char *what)
{
    return dal__fail_because(&self->error, status, dal_chart_error(self->chart), "%s: ", what);
}

/* x <- psi(z). */
static int lift(dal_embedding *self, const double *z, double *x)
{
    return chart_result(self, dal_chart_lift(self->chart, 0.0, z, x), "chart");
}

/* result <- F(t, z); they may be the same. */
static int flow(dal_embedding *self, double t, const double *z, double *result)
{
    int status = lift(self, z, self->x);
    if (status) return status;
    if (self->flow) {
        status = dal_flow_apply(self->flow, 0.0, t, self->x, NULL);
        if (status)
            return dal__fail_because(&self->error, status, dal_flow_error(self->flow), "flow: ");
    } else {
        status = dal_system_exact(self->system, t, self->x, self->moved);
        if (status)
            return dal__fail(&self->error, status, "exact solution: %s", dal_strerror(status));
        dal__copy(2 * self->system->def.n, self->moved, self->x);
    }
    dal__chart_drop(self->chart, self->x, result);
    return DAL_SUCCESS;
}

/* result <- Phi(z); they may be the same. */
static int step(dal_embedding *self, const double *z, double *result)
{
    int status = lift(self, z, self->x);
    if (!status)
        status = dal_stepper_start(self->stepper, 0.0, self->h, self->x, DAL_ASSUME,
                                   DAL_INITIAL_NONE);
    if (!status) status = dal_step(self->stepper, NULL);
    if (status)
        return dal__fail_because(&self->error, status, dal_stepper_error(self->stepper),
                                 "scheme: ");
    dal__chart_drop(self->chart, dal_stepper_state(self->stepper), result);
    return DAL_SUCCESS;
}

static int field(dal_embedding *self, const double *z, double *zdot)
{
    return chart_result(self, dal_chart_field(self->chart, 0.0, z, zdot), "field");
}

/* ---- curves ------------------------------------------------------------------------------ */

/* F1 <- F(h tau, y), F2 <- F(h tau - h, Phi(y)). */
static int branches(dal_embedding *self, double tau, const double *y)
{
    int status = flow(self, self->h * tau, y, self->F1);
    if (!status) status = step(self, y, self->F2);
    if (!status) status = flow(self, self->h * (tau - 1.0), self->F2, self->F2);
    return status;
}

/* Of the flow: its tolerance, or roundoff where it is exact. */
static double accuracy(const dal_embedding *self)
{
    return self->flow ? self->tolerance : 4.0 * DAL_ROUNDOFF;
}

/* tau modulo 1, below 1 also where that rounds to 1. */
static double phase_of(double tau)
{
    const double phase = tau - floor(tau);
    return phase < 1.0 ? phase : 0.0;
}

/* self->y <- the y with G~(tau, y) = z, 0 <= tau < 1; F1 and F2 are those of y.  A change that does
 * not shrink any more is either the accuracy of the flow, or that of an iteration which
 * diverges. */
static int solve_source(dal_embedding *self, double tau, const double *z)
{
    enum { MOST = 100 };
    const size_t width = self->width;
    const double small = 1e4 * accuracy(self) * (1.0 + dal__largest(width, z));
    double chi1, last = INFINITY;
    dal_cutoff(tau, NULL, &chi1, NULL);
    int status = flow(self, -self->h * tau, z, self->y);
    if (!status) status = branches(self, tau, self->y);
    if (chi1 == 0.0) return status;
    for (int iteration = 1; !status && iteration <= MOST; iteration++) {
        for (size_t i = 0; i < width; i++)
            self->next[i] = z[i] - chi1 * (self->F2[i] - self->F1[i]);
        status = flow(self, -self->h * tau, self->next, self->next);
        if (status) break;
        const double change = dal__largest_difference(width, self->next, self->y);
        if (!(change < last)) break;
        dal__copy(width, self->next, self->y);
        status = branches(self, tau, self->y);
        if (change == 0.0) return status;
        last = change;
    }
    if (status || last <= small) return status;
    return dal__fail(&self->error, DAL_ENOCONV, "found no curve through z at tau = %g (last update "
                     "%g): h = %g is too large", tau, last, self->h);
}

/* A time of this name, finite coordinates z[width] that the caller calls name, an output, and a
 * choice of the chart. */
static int check_arguments(dal_embedding *self, const char *time_name, double time,
                           const char *name, const double *z, const char *output_name,
                           const double *output)
{
    if (!self) return DAL_EINVAL;
    if (!isfinite(time))
        return dal__fail(&self->error, DAL_EINVAL, "%s = %g is not finite", time_name, time);
    const int status = DAL__REQUIRE_FINITE(&self->error, {name, self->width, z},
                                           {output_name, 0, output});
    return status ? status : chart_result(self, dal__chart_ready(self->chart), "chart");
}

int dal_embedding_curve(dal_embedding *self, double tau, const double *y, double *G)
{
    int status = check_arguments(self, "", 0.0, "y", y, "G", G);
    if (!status && !(tau >= 0.0 && tau <= MOST_PERIODS))
        status = dal__fail(&self->error, DAL_EINVAL, "tau = %g: expected a number in [0, %g]", tau,
                           MOST_PERIODS);
    if (status) return status;
    dal__copy(self->width, y, self->y);
    double *const made = &self->watch.made;
    for (*made = 0.0; !status && tau > 1.0; tau -= 1.0, ++*made) {
        status = step(self, self->y, self->y);
        if (!status) status = dal__ask(&self->watch, *made, &self->error);
    }
    if (!status) status = branches(self, tau, self->y);
    if (status) return status;
    double chi0, chi1;
    dal_cutoff(tau, &chi0, &chi1, NULL);
    for (size_t i = 0; i < self->width; i++) G[i] = chi0 * self->F1[i] + chi1 * self->F2[i];
    return DAL_SUCCESS;
}

int dal_embedding_source(dal_embedding *self, double tau, const double *z, double *y)
{
    int status = check_arguments(self, "tau", tau, "z", z, "y", y);
    if (!status) status = solve_source(self, phase_of(tau), z);
    if (!status) dal__copy(self->width, self->y, y);
    return status;
}

/* ---- the field --------------------------------------------------------------------------- */

/* next <- h^p g at (tau, z); field0 <- f(z). */
static int perturbation(dal_embedding *self, double tau, const double *z)
{
    const double phase = phase_of(tau);
    double chi0, chi1, slope;
    int status = solve_source(self, phase, z);
    if (!status) status = field(self, z, self->field0);
    if (!status) status = field(self, self->F1, self->field1);
    if (!status) status = field(self, self->F2, self->field2);
    if (status) return status;
    dal_cutoff(phase, &chi0, &chi1, &slope);
    for (size_t i = 0; i < self->width; i++)
        self->next[i] = slope / self->h * (self->F1[i] - self->F2[i])
                      + chi0 * (self->field1[i] - self->field0[i])
                      + chi1 * (self->field2[i] - self->field0[i]);
    if (phase == 0.0) dal__clear(self->width, self->next);
    return DAL_SUCCESS;
}

int dal_embedding_field(dal_embedding *self, double tau, const double *z, double *g)
{
    int status = check_arguments(self, "tau", tau, "z", z, "g", g);
    if (!status) status = perturbation(self, tau, z);
    if (status) return status;
    const double scale = pow(self->h, self->order);
    for (size_t i = 0; i < self->width; i++) g[i] = self->next[i] / scale;
    return DAL_SUCCESS;
}

double dal_embedding_noise(const dal_embedding *embedding)
{
    return accuracy(embedding) * pow(fabs(embedding->h), -(embedding->order + 1));
}

int dal_embedding_limit(dal_embedding *self, const double *z, double *d)
{
    int status = check_arguments(self, "", 0.0, "z", z, "d", d);
    if (!status) status = step(self, z, self->F2);
    if (!status) status = flow(self, self->h, z, self->F1);
    if (status) return status;
    const double scale = pow(self->h, self->order + 1);
    for (size_t i = 0; i < self->width; i++)
        self->F1[i] = (self->F2[i] - self->F1[i]) / scale; /* which may underflow */
    return DAL__DELIVER(&self->error, {"d", self->width, self->F1, d});
}

/* ---- the perturbed flow ------------------------------------------------------------------ */

static int perturbed_field(double t, const double *z, double *zdot, void *ctx, dal_error *error)
{
    dal_embedding *const self = ctx;
    int status = dal__ask(&self->watch, self->watch.made, &self->error);
    if (!status) status = perturbation(self, t / self->h, z);
    if (status) {
        *error = self->error;
        return status;
    }
    dal__move(self->width, self->field0, 1.0, self->next, zdot);
    return DAL_SUCCESS;
}

int dal_embedding_flow(dal_embedding *self, double t0, double t1, double *z)
{
    const bool first = !isfinite(t0);
    int status = check_arguments(self, first ? "t0" : "t1", first ? t0 : t1, "z", z, "z", z);
    if (status || t0 == t1) return status;
    /* Where h is too large for the embedding the steps become tiny, and each takes many flows. */
    const double most = STEPS_A_PERIOD * (1.0 + fabs((t1 - t0) / self->h));
    self->watch.made = 0.0;
    status = dal__ode_begin(self->perturbed, t0, t1 - t0, z, 1.0, &self->error);
    for (double steps = 0.0; !status && dal__ode_elapsed(self->perturbed) != t1 - t0; steps++) {
        self->watch.made = fabs(dal__ode_elapsed(self->perturbed) / self->h);
        if (steps >= most)
            return dal__fail(&self->error, DAL_ENOCONV, "%d steps did not complete a period at t = "
                             "%g: h = %g is too large", STEPS_A_PERIOD,
                             t0 + dal__ode_elapsed(self->perturbed), self->h);
        status = dal__ode_step(self->perturbed, t1 - t0, &self->error);
    }
    if (!status) dal__copy(self->width, dal__ode_state(self->perturbed), z);
    return status;
}
