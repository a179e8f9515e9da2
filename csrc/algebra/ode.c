/* One ordinary differential equation, by an adaptive method: an explicit one, a multistep one,
 * which is GSL's, and a stiff one.
 *
 * The loop over steps is our own, also over gsl_odeiv2_step: it refuses a step that is not finite
 * (GSL takes NaN for accurate), takes a shorter one where the field says that it left its domain,
 * and leaves GSL no reason to raise its handler.  GSL's implicit methods would: they hand a
 * singular matrix 1 - h J to its LU, and allocate in every step.  Its driver and control follow a
 * null pointer when memory runs out; so they are our own, for msadams, which asks them for the
 * tolerance. */
#include "algebra/algebra.h"

#include <gsl/gsl_errno.h>
#include <gsl/gsl_odeiv2.h>

#include <math.h>

/* Below it steps are refused for their roundoff. */
static const double LEAST_TOLERANCE = 4.0 * DAL_ROUNDOFF;

/* The first step is a fraction of what the field suggests and of the interval. */
static const double FIRST_STEP = 0.00618033988749895;
static const double FIRST_FRACTION = 0.381966011250105;
static const double SHORTER = 0.6;

enum { RK8PD_ORDER = 8 };

/* The roundoff of the field is looked at where steps move the state by no more than this part, by
 * a change of the state by that part of it, so small that the field is linear there; a step may
 * have an error of so many times the roundoff. */
static const double SHORT = 0x1p-5, SHIFT = 0x1p-42, NOISE = 4.0;

/* RODAS of order 4 with an embedded method of order 3, L-stable and stiffly accurate, so that it
 * sees the field where a step ends: E. Hairer and G. Wanner, Solving Ordinary Differential
 * Equations II, 2nd edition, IV.7.  Of stage i: where on the step it is; its share of f_t; how the
 * stages before it enter the state that it sees, and its right side. */
enum { STAGES = 6, RODAS_ORDER = 3 };
static const double GAMMA = 0.25;
static const struct {
    double at, f_t, a[STAGES - 1], c[STAGES - 1];
} stages[STAGES] = {
    {0.0, 0.25, {0.0}, {0.0}},
    {0.386, -0.1043, {1.544}, {-5.6688}},
    {0.21, 0.1035, {0.9466785280815826, 0.2557011698983284},
     {-2.430093356833875, -0.2063599157091915}},
    {0.63, -0.0362, {3.314825187068521, 2.896124015972201, 0.9986419139977817},
     {-0.1073529058151375, -9.594562251023355, -20.47028614809616}},
    {1.0, 0.0, {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895},
     {7.496443313967647, -10.24680431464352, -33.99990352819905, 11.7089089320616}},
    {1.0, 0.0, {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895, 1.0},
     {8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136,
      -6.058818238834054}},
};

struct ode {
    size_t N;
    dal_flow_method method;
    double tolerance;
    dal__field_fn field;
    void *ctx;
    gsl_odeiv2_step *step;      /* of msadams, else NULL */
    gsl_odeiv2_system system;
    gsl_odeiv2_control control; /* reads level */
    gsl_odeiv2_driver driver;
    double level;               /* the tolerance of this integration */
    double t0;       /* time is t0 + elapsed, so that short intervals lose no digits */
    double elapsed;
    double longest;  /* step */
    double h;        /* suggested for the next step, with the sign of the direction */
    bool current;    /* the Jacobian is that of the state */
    dal_error fault; /* of the field in the last attempt */
    size_t evaluations;
    double *state, *before;                   /* [N] */
    double *slope, *slope_after, *step_error; /* [N] */
    double *shifted, *noise;                  /* [N] */
    dal__rk8pd rk8pd;
    /* of rodas */
    double *point, *right, *left, *rate;      /* [N]; rate: the derivative of the field by time */
    double *jacobian, *scale;                 /* [N*N] */
    dal__linear matrix;
    double *stage;                            /* [STAGES*N] */
    arena arena;
};

static const char *const names[] = {[DAL_FLOW_RK8PD] = "rk8pd", [DAL_FLOW_MSADAMS] = "msadams",
                                    [DAL_FLOW_RODAS] = "rodas"};

/* The error that a step may make of y, relative and absolute. */
static double tolerated(double level, double y) { return level * fabs(y) + level; }

static int allowed(void *level, double y, double dydt, double h, size_t i, double *error)
{
    (void)dydt, (void)h, (void)i;
    *error = tolerated(*(const double *)level, y);
    return GSL_SUCCESS;
}

static const gsl_odeiv2_control_type control_type = {.name = "dalembert", .errlevel = allowed};

/* The field, as GSL calls it.  What fails leaves its status and text in fault. */

static int faulty(ode *self, const char *what, double elapsed)
{
    dal__not_finite(&self->fault, what, self->t0 + elapsed);
    return GSL_EBADFUNC;
}

/* dydt[N] <- the field at y[N]. */
static int evaluate(double elapsed, const double y[], double dydt[], void *params)
{
    ode *const self = params;
    if (!dal__all_finite(self->N, y)) return faulty(self, "state", elapsed);
    self->evaluations++;
    if (self->field(self->t0 + elapsed, y, dydt, self->ctx, &self->fault)) return GSL_EBADFUNC;
    return dal__all_finite(self->N, dydt) ? GSL_SUCCESS : faulty(self, "field", elapsed);
}

/* The Jacobian of the field at the state by central differences, error O(d^2) + O(u/d), where d is
 * a part of a number, or of its change in a step of h; what is 0 and stays so has a column of 0,
 * which next to nothing multiplies. */
static int difference(ode *self, double h)
{
    const size_t N = self->N;
    const double *const y = self->state;
    dal__copy(self->N, y, self->point);
    for (size_t j = 0; j < N; j++) {
        const double d = cbrt(DBL_EPSILON) * fmax(fabs(y[j]), fabs(h * self->slope[j]));
        const double above = y[j] + d, below = y[j] - d;
        self->point[j] = above;
        int status = evaluate(self->elapsed, self->point, self->right, self);
        self->point[j] = below;
        if (!status) status = evaluate(self->elapsed, self->point, self->left, self);
        self->point[j] = y[j];
        if (status) return status;
        for (size_t i = 0; i < N; i++)
            self->jacobian[i * N + j] =
                above > below ? (self->right[i] - self->left[i]) / (above - below) : 0.0;
    }
    self->current = true;
    return GSL_SUCCESS;
}

/* rate <- the derivative of the field by time where the step begins, one-sided of order 2, as there
 * may be no field before.  It looks no farther than 1/32 of the step. */
static int differ_in_time(ode *self, double h)
{
    const double d = h / 64.0;
    int status = evaluate(self->elapsed + d, self->state, self->right, self);
    if (!status) status = evaluate(self->elapsed + 2.0 * d, self->state, self->left, self);
    for (size_t i = 0; !status && i < self->N; i++)
        self->rate[i] = (4.0 * (self->right[i] - self->slope[i]) - (self->left[i] - self->slope[i]))
                      / (2.0 * d);
    return status;
}

/* matrix <- the factors of 1/(gamma h) - J. */
static bool factor(ode *self, double h)
{
    const size_t N = self->N;
    const double one = 1.0 / (GAMMA * h);
    for (size_t i = 0; i < N * N; i++) {
        const double diagonal = i % (N + 1) == 0 ? one : 0.0;
        self->matrix.A[i] = diagonal - self->jacobian[i];
        self->scale[i] = fabs(diagonal) + fabs(self->jacobian[i]);
    }
    dal__linear_balance(&self->matrix, self->scale);
    return dal__linear_factor(&self->matrix) != 0;
}

/* One step of rodas, as gsl_odeiv2_step_apply. */
static int rosenbrock(ode *self, double h)
{
    const size_t N = self->N;
    int status = self->current ? GSL_SUCCESS : difference(self, h);
    if (!status) status = differ_in_time(self, h);
    if (!status && !factor(self, h)) status = GSL_ESING;
    for (size_t s = 0; !status && s < STAGES; s++) {
        dal__copy(self->N, self->state, self->point);
        for (size_t r = 0; r < s; r++)
            dal__add(N, stages[s].a[r], self->stage + r * N, self->point);
        status = evaluate(self->elapsed + stages[s].at * h, self->point, self->right, self);
        if (status) return status;
        dal__add(N, h * stages[s].f_t, self->rate, self->right);
        for (size_t r = 0; r < s; r++)
            dal__add(N, stages[s].c[r] / h, self->stage + r * N, self->right);
        dal__linear_solve(&self->matrix, self->right, self->stage + s * N);
    }
    if (status) return status;
    dal__copy(self->N, self->stage + (STAGES - 1) * N, self->step_error);
    dal__copy(N, self->point, self->state);
    dal__add(N, 1.0, self->step_error, self->state);
    return evaluate(self->elapsed + h, self->state, self->slope_after, self);
}

/* One step of rk8pd, in the same way. */
static int explicit_step(ode *self, double h)
{
    const int status = dal__rk8pd_step(&self->rk8pd, self->t0, self->elapsed, h, self->state,
                                       self->slope, self->step_error, &self->fault);
    return status ? GSL_EBADFUNC
                  : evaluate(self->elapsed + h, self->state, self->slope_after, self);
}

/* Making. */

static void plan(ode *shape, arena *memory)
{
    const size_t N = shape->N, N2 = dal__times(N, N);
    DAL__RESERVE(memory, N, &shape->state, &shape->before, &shape->slope, &shape->slope_after,
                 &shape->step_error, &shape->noise);
    DAL__RESERVE(memory, dal__times(3, N), &shape->shifted);
    if (shape->method == DAL_FLOW_RK8PD) dal__rk8pd_reserve(&shape->rk8pd, N, memory);
    if (shape->method != DAL_FLOW_RODAS) return;
    DAL__RESERVE(memory, N, &shape->point, &shape->right, &shape->left, &shape->rate);
    DAL__RESERVE(memory, N2, &shape->jacobian, &shape->scale);
    DAL__RESERVE(memory, dal__times(STAGES, N), &shape->stage);
    dal__linear_reserve(&shape->matrix, N, memory);
}

int dal__check_tolerance(double tolerance, dal_error *error)
{
    if (tolerance >= LEAST_TOLERANCE && tolerance <= 0.1) return DAL_SUCCESS;
    return dal__fail(error, DAL_EINVAL, "tolerance = %g: expected a number from %.1e (roundoff) to "
                     "0.1", tolerance, LEAST_TOLERANCE);
}

int dal__ode_new(ode **integrator, size_t N, dal_flow_method method, double tolerance,
                 dal__field_fn field, void *ctx, dal_error *error)
{
    if ((size_t)method >= DAL_LENGTH(names))
        return dal__fail(error, DAL_EINVAL, "method = %d is not a dal_flow_method", (int)method);
    int status = dal__check_tolerance(tolerance, error);
    if (status) return status;

    ode shape = {.N = N, .method = method, .tolerance = tolerance, .field = field, .ctx = ctx,
                 .rk8pd = {.field = field, .ctx = ctx}};
    ode *self;
    dal__reserve(&shape.arena, &self, 1, sizeof *self);
    plan(&shape, &shape.arena);
    status = dal__allocate(&shape.arena, error);
    if (status) return status;

    *self = shape;
    *integrator = self;
    if (method != DAL_FLOW_MSADAMS) return DAL_SUCCESS;
    self->system = (gsl_odeiv2_system){evaluate, NULL, N, self};
    self->control = (gsl_odeiv2_control){&control_type, &self->level};
    self->driver = (gsl_odeiv2_driver){.sys = &self->system, .c = &self->control};
    self->step = gsl_odeiv2_step_alloc(gsl_odeiv2_step_msadams, N);
    if (!self->step) {
        dal__release(&self->arena);
        *integrator = NULL;
        return dal__fail(error, DAL_ENOMEM, "out of memory for the workspace of %s",
                         names[method]);
    }
    gsl_odeiv2_step_set_driver(self->step, &self->driver);
    return DAL_SUCCESS;
}

void dal__ode_free(ode *self)
{
    if (!self) return;
    gsl_odeiv2_step_free(self->step);
    dal__release(&self->arena);
}

double *dal__ode_state(ode *self) { return self->state; }

double dal__ode_elapsed(const ode *self) { return self->elapsed; }

size_t dal__ode_evaluations(const ode *self)
{
    return self->evaluations + self->rk8pd.evaluations;
}

/* Integration. */

/* The failure of the field is the failure of the integration. */
static int pass_on(const ode *self, dal_error *error)
{
    if (error) *error = self->fault;
    return self->fault.status;
}

int dal__ode_renew(ode *self, dal_error *error)
{
    self->current = false;
    return evaluate(self->elapsed, self->state, self->slope, self) ? pass_on(self, error)
                                                                   : DAL_SUCCESS;
}

int dal__ode_restart(ode *self, double end, dal_error *error)
{
    const double span = end - self->elapsed;
    const int status = dal__ode_renew(self, error);
    if (status) return status;
    if (self->step) gsl_odeiv2_step_reset(self->step);
    const double change =
        FIRST_STEP * (1.0 + dal__largest(self->N, self->state))
        / dal__largest(self->N, self->slope);
    self->h = copysign(fmin(change, FIRST_FRACTION * fabs(span)), span);
    return DAL_SUCCESS;
}

int dal__ode_begin(ode *self, double t0, double span, const double *y, double factor,
                   dal_error *error)
{
    self->level = factor * self->tolerance;
    self->t0 = t0;
    self->elapsed = 0.0;
    self->longest = HUGE_VAL;
    dal__copy(self->N, y, self->state); /* y may be the state */
    return dal__ode_restart(self, span, error);
}

void dal__ode_shorten(ode *self, double longest)
{
    self->longest = longest;
    self->h *= SHORTER;
}

double dal__ode_suggested(const ode *self) { return fabs(self->h); }

void dal__ode_suggest(ode *self, double span, double size)
{
    self->h = copysign(fmin(size, fabs(span)), span);
}

/* The largest estimated error of a step of h in units of what it may be, by the tolerance, or by
 * the noise[N] of the field where that is more. */
static double worst_error(const ode *self, double h, const double *noise)
{
    double worst = DBL_MIN;
    for (size_t i = 0; i < self->N; i++) {
        double most = tolerated(self->level, self->state[i]);
        if (noise) most = fmax(most, fabs(h) * noise[i]);
        worst = fmax(worst, fabs(self->step_error[i]) / most);
    }
    return worst;
}

/* Whether a step of h leads to next to nowhere: steps at a tolerance that the field can keep
 * seldom do. */
static bool is_short(const ode *self, double h)
{
    for (size_t i = 0; i < self->N; i++)
        if (fabs(h * self->slope[i]) > SHORT * (1.0 + fabs(self->state[i]))) return false;
    return true;
}

/* noise[N] <- the roundoff of the field where a step of h ends, by second differences over so
 * little that all else is less. */
static int measure_noise(ode *self, double h)
{
    const size_t N = self->N;
    double *const shifted = self->shifted, *const ahead = shifted + N, *const back = ahead + N;
    dal__clear(N, self->noise);
    for (int k = 1; k <= 2; k++) {
        int status = GSL_SUCCESS;
        for (int sign = -1; !status && sign <= 1; sign += 2) {
            for (size_t i = 0; i < N; i++) shifted[i] = self->state[i] * (1.0 + sign * k * SHIFT);
            status = evaluate(self->elapsed + h, shifted, sign > 0 ? ahead : back, self);
        }
        if (status) return status;
        for (size_t i = 0; i < N; i++) {
            const double f = self->slope_after[i], bend = (ahead[i] - f) + (back[i] - f);
            self->noise[i] = fmax(self->noise[i], NOISE * fabs(bend));
        }
    }
    return GSL_SUCCESS;
}

/* Whether the errors of a step of size h are allowed; self->h <- the size to go on with, for a
 * method of this order.  No step can be more accurate than its field. */
static bool accurate(ode *self, double h, unsigned order)
{
    double worst = worst_error(self, h, NULL);
    if (worst > 1.1 && is_short(self, h) && measure_noise(self, h) == GSL_SUCCESS)
        worst = worst_error(self, h, self->noise);
    if (worst > 1.1) self->h = h * fmax(0.9 / pow(worst, 1.0 / order), 0.2);
    else if (worst < 0.5) { /* a step may have been shorter than suggested, to end somewhere */
        const double size = fabs(h) * fmin(fmax(0.9 / pow(worst, 1.0 / (order + 1.0)), 1.0), 5.0);
        self->h = copysign(fmax(size, fabs(self->h)), h);
    }
    return worst <= 1.1;
}

/* One step of size h from elapsed time; on refusal the state is as it was.  Either way self->h is
 * the size to go on with. */
static bool attempt(ode *self, double h)
{
    gsl_odeiv2_step *const step = self->step;
    self->fault.status = DAL_SUCCESS;
    dal__copy(self->N, self->state, self->before);
    int status;
    unsigned order = RK8PD_ORDER;
    if (self->method == DAL_FLOW_RK8PD) {
        status = explicit_step(self, h);
    } else if (self->method == DAL_FLOW_RODAS) {
        status = rosenbrock(self, h);
        order = RODAS_ORDER;
    } else {
        status = gsl_odeiv2_step_apply(step, self->elapsed, h, self->state, self->step_error,
                                       self->slope, self->slope_after, &self->system);
        order = gsl_odeiv2_step_order(step);
    }
    if (status == GSL_SUCCESS && accurate(self, h, order)) {
        dal__copy(self->N, self->slope_after, self->slope);
        self->current = false;
        return true;
    }
    dal__copy(self->N, self->before, self->state);
    if (status != GSL_SUCCESS) self->h = 0.5 * h;
    /* A multistep method is interrupted halfway by a field that fails. */
    if (step && self->fault.status) gsl_odeiv2_step_reset(step);
    return false;
}

static int collapsed(const ode *self, double h, dal_error *error)
{
    if (self->fault.status == DAL_EUSER || self->fault.status == DAL_STOPPED)
        return pass_on(self, error);
    if (self->fault.status)
        return dal__fail_because(error, self->fault.status, &self->fault,
                                 "%s: cannot integrate beyond t = %.17g: ", names[self->method],
                                 self->t0 + self->elapsed);
    return dal__fail(error, DAL_ENOCONV,
                     "%s: the step size collapsed to h = %g at t = %.17g (tolerance %g): the "
                     "equations of motion are singular or jump, as in a collision",
                     names[self->method], h, self->t0 + self->elapsed, self->tolerance);
}

/* Whether the edge of the domain of the field is nearer than a rounding of the state: steps of the
 * size to go on with would come closer and closer to it, and never to an end.  A state at rest may
 * be pushed later, so that a step has to be short as well. */
static bool is_at_edge(const ode *self, double end)
{
    return self->fault.status && fabs(self->h) <= 0x1p-33 * fabs(end)
        && fabs(self->h) * dal__largest(self->N, self->slope)
           <= DBL_EPSILON * dal__largest(self->N, self->state);
}

int dal__ode_step(ode *self, double end, dal_error *error)
{
    bool accepted = self->elapsed == end;
    while (!accepted) {
        const double left = end - self->elapsed;
        if (fabs(self->h) > self->longest) self->h = copysign(self->longest, self->h);
        const bool last = fabs(self->h) >= fabs(left);
        /* Two halves instead of a step and a very short one. */
        const double h = last ? left : fabs(self->h) > 0.5 * fabs(left) ? 0.5 * left : self->h;
        accepted = attempt(self, h);
        const bool stuck = accepted ? self->elapsed + h == self->elapsed
            : self->fault.status == DAL_EUSER || self->fault.status == DAL_STOPPED
                  || is_at_edge(self, end) || !(fabs(self->h) > DBL_EPSILON * fabs(end));
        if (stuck) return collapsed(self, accepted ? h : self->h, error);
        if (accepted) self->elapsed = last ? end : self->elapsed + h;
    }
    return DAL_SUCCESS;
}
