/* The order (p, s) of a scheme, measured by refining the step.
 *
 * p and s are slopes of the error of one step from exact data, minus 1: p of the state, s of the
 * scheme's own multiplier against lambda(t0 + h).  For kept nodes the data are those that the run
 * starts from, which need not lie in D; the ODE (h) is defined there by the same formula.
 *
 * What has to hold.  A record promises (p, s) for a step from the set that it keeps.  The order p
 * holds if the error of one step has the slope p + 1, or those at t_end the slope p: with p = 8 the
 * error of a step reaches roundoff before its slope has settled, the one at t_end, greater by 1/h,
 * does not.  Kept nodes started in D (DAL_INITIAL_D) jump to D_eps in their first step, which costs
 * that step one order in both (E12), and the run none: for that start the first step has to have
 * (p - 1, s - 1), and the errors at t_end the slope p. */
#include "dalembert/run.h"
#include "dalembert/study.h"
#include "step/embedded.h"
#include "step/scheme.h"
#include "step/stepper.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { BLOCK = 256, FEWEST_POINTS = 3 };

static const double SLACK = 0.2;           /* by which an order may fall short of its promise */
static const double ANOTHER = 0.75;        /* by so much less, of integers, it is another one */
static const double ABOVE_FLOOR = 100.0;   /* an error counts beyond so many times the floor */
static const double AT_FLOOR = 10.0;       /* errors up to so many times the floor are roundoff */
static const double STEP_ROUNDINGS = 4.0;  /* the floor of one step in u times scale, */
static const double RUN_ROUNDINGS = 50.0;  /* and of a short run, in which they add up; */
static const double WALK = 4.0;            /* N sub-steps have so many times the root of N */
static const double SETTLED = 0.25;        /* by which the slopes between neighbours may differ */
static const double RESOLVED = 0.5;        /* of the solution: a larger error says nothing */
static const double SMALLEST_RANGE = 2.0;  /* of h over the points that count */
static const double ENERGY = 1e-8;         /* changes of the energy below are not told */
static const double DEFAULT_TOLERANCE = 1e-13;

typedef struct study {
    const dal_system *system;
    const dal_scheme *scheme;
    const dal_order_def *def;
    size_t n, m;
    bool kept;          /* kept nodes */
    double shift;       /* 1 - beta of a record with a single sub-step, else NaN */
    double tolerance;   /* of the flow */
    double accuracy;    /* of the reference at t_end */
    dal_mechanics *mech;
    dal_stepper *stepper;
    dal_flow *flow;     /* NULL where the exact solution serves */
    double *x0;         /* [2n]: def->x0 in D to roundoff */
    double *end;        /* [2n]: the reference at t_end */
    double *end_lambda; /* [m] */
    double *start;      /* [2n]: what the run starts from */
    double *exact;      /* [2n] */
    double *rows;       /* [(BLOCK + 1)*2n] */
    double *energy, *relative;            /* [BLOCK + 1] */
    double *lambda, *expected, *reaction; /* [m] */
    double *h, *errors;                   /* [count] those of all fits; of a fit */
    dal_order_point *points;              /* [count] */
    dal__watch watch;                     /* sees the steps of all runs so far */
    dal_error *error;
    arena memory;
} study;

/* ---- fits ------------------------------------------------------------------------------- */

static bool is_above(double error, double least) { return isfinite(error) && error > least; }

/* The slopes between neighbours, of the points above least. */
static void compare_slopes(size_t count, const double *h, const double *errors, double least,
                           dal_fit *fit)
{
    double flattest = INFINITY, steepest = -INFINITY, shortest = INFINITY;
    for (size_t i = 0; i < count; i++) {
        size_t next = count;
        for (size_t k = 0; k < count; k++)
            if (is_above(errors[k], least) && fabs(h[k]) > fabs(h[i])
                && (next == count || fabs(h[k]) < fabs(h[next])))
                next = k;
        if (next == count || !is_above(errors[i], least)) continue;
        const double slope = log(errors[next] / errors[i]) / log(fabs(h[next] / h[i]));
        flattest = fmin(flattest, slope);
        steepest = fmax(steepest, slope);
        if (fabs(h[i]) < shortest) {
            shortest = fabs(h[i]);
            fit->finest = slope;
        }
    }
    fit->spread = steepest - flattest;
}

void dal_fit_order(size_t count, const double *h, const double *errors, double floor,
                   dal_fit *fit, unsigned char *counted)
{
    const double least = ABOVE_FLOOR * floor;
    double sum_x = 0.0, sum_y = 0.0, sum_xx = 0.0, sum_xy = 0.0, shortest = INFINITY, longest = 0.0;
    size_t points = 0, finite = 0, above = 0;
    for (size_t i = 0; i < count; i++) {
        const bool counts = is_above(errors[i], least);
        if (counted) counted[i] = counts;
        finite += isfinite(errors[i]) != 0;
        above += is_above(errors[i], AT_FLOOR * floor);
        if (!counts) continue;
        const double x = log(fabs(h[i])), y = log(errors[i]);
        points++;
        sum_x += x;
        sum_y += y;
        sum_xx += x * x;
        sum_xy += x * y;
        shortest = fmin(shortest, fabs(h[i]));
        longest = fmax(longest, fabs(h[i]));
    }
    *fit = (dal_fit){.slope = NAN, .spread = NAN, .finest = NAN, .points = points,
                     .exact = finite > 0 && above == 0};
    if (points < FEWEST_POINTS || longest < SMALLEST_RANGE * shortest) return;
    const double N = (double)points;
    fit->slope = (N * sum_xy - sum_x * sum_y) / (N * sum_xx - sum_x * sum_x);
    compare_slopes(count, h, errors, least, fit);
}

/* The exact solution starts at time 0; a system that does not depend on time cannot tell that from
 * t0. */
static bool has_exact(const study *self)
{
    const dal_system_def *const def = &self->system->def;
    return def->exact && (dal__is_autonomous(self->system) || self->def->t0 == 0.0);
}

/* The largest component of the ends of the solution. */
static double size_of_states(const study *self)
{
    const size_t N = 2 * self->n;
    return fmax(dal__largest(N, self->x0), dal__largest(N, self->end));
}

/* What errors are measured against: the accuracy of the reference, or so many roundings of a state.
 * The flow that stands in for an exact solution off D promises its tolerance. */
static double error_floor(const study *self, double roundings)
{
    const double scale = fmax(size_of_states(self), dal__largest(self->m, self->end_lambda));
    const bool stands_in = self->flow && has_exact(self);
    return fmax(stands_in ? self->tolerance : self->accuracy, roundings * DAL_ROUNDOFF * scale);
}

/* The error of a point that a fit is of; in the order of dal_order_fit, as the fits are below. */
static double error_of(const dal_order_point *point, dal_order_fit which)
{
    const double errors[] = {
        point->local_state, point->local_multipliers,
        point->local_reaction, point->local_midpoint,
        point->q, point->v,
        point->multipliers,
        fmax(point->q, point->v),
    };
    return errors[which];
}

/* The floor of one error, where the common one of its fit is too low.  Reactions are impulses over
 * h, and so is their roundoff.  That of errors at t_end is a walk of as many steps as the run has
 * sub-steps; measured with up to 2e6 sub-steps over up to 100 units of time, it stays below 50 of
 * these floors, and for most systems below 5. */
static double own_floor(const study *self, const dal_order_point *point, dal_order_fit which,
                        double floor)
{
    const double substeps = (double)point->steps * (double)dal__scheme_count(self->scheme);
    if (which >= DAL_FIT_GLOBAL_Q)
        return error_floor(self, fmax(RUN_ROUNDINGS, WALK * sqrt(substeps)));
    return which < DAL_FIT_REACTION ? floor : floor * fmax(1.0, 1.0 / fabs(point->h));
}

/* The fit over the steps that are not longer than longest; the points that counted are marked.  An
 * error that does not stand clear of its own floor is lowered to where it does not stand clear of
 * the common one either. */
static dal_fit fit_errors(study *self, dal_order_fit which, double floor, double longest)
{
    const size_t count = self->def->count;
    const unsigned bit = 1u << which;
    dal_fit fit;
    for (size_t i = 0; i < count; i++) {
        const dal_order_point *const point = &self->points[i];
        const double own = own_floor(self, point, which, floor), error = error_of(point, which);
        self->errors[i] = fabs(point->h) > longest ? NAN
                        : error <= AT_FLOOR * own ? fmin(error, floor)
                        : error <= ABOVE_FLOOR * own ? fmin(error, ABOVE_FLOOR * floor) : error;
    }
    dal_fit_order(count, self->h, self->errors, floor, &fit, NULL);
    for (size_t i = 0; i < count; i++) {
        unsigned *const counted = &self->points[i].counted;
        const bool counts = is_above(self->errors[i], ABOVE_FLOOR * floor);
        *counted = counts ? *counted | bit : *counted & ~bit;
    }
    return fit;
}

/* The longest of the finer half of the steps. */
static double median_step(const study *self)
{
    const size_t count = self->def->count;
    const size_t half = count / 2 > FEWEST_POINTS ? count / 2 : FEWEST_POINTS;
    double median = INFINITY;
    for (size_t i = 0; i < count; i++) {
        size_t finer = 0;
        for (size_t k = 0; k < count; k++)
            finer += fabs(self->points[k].h) <= fabs(self->points[i].h);
        if (finer >= half) median = fmin(median, fabs(self->points[i].h));
    }
    return median;
}

/* The fit of the reaction over the finer half of the steps, if that says anything.  Its errors are
 * c1 h + c2 h^2 whatever p is: where a high order wants coarse steps, the second term still
 * matters, and where the two have opposite signs the errors of the coarse steps have no slope at
 * all. */
static dal_fit fit_reaction(study *self, double floor)
{
    const dal_fit fine = fit_errors(self, DAL_FIT_REACTION, floor, median_step(self));
    return isnan(fine.slope) ? fit_errors(self, DAL_FIT_REACTION, floor, INFINITY) : fine;
}

/* ---- the reference ---------------------------------------------------------------------- */

/* exact <- the solution at t that starts in start at t0, expected <- its lambda.  Off D there is
 * only the flow. */
static int expect(study *self, double t)
{
    const double t0 = self->def->t0;
    int status;
    if (self->flow) {
        dal__copy(2 * self->n, self->start, self->exact);
        status = dal__flow_apply(self->flow, t0, t - t0, self->exact, !self->kept);
    } else {
        status = dal_system_exact(self->system, t - t0, self->start, self->exact);
    }
    return status ? status : dal_multipliers(self->mech, t, self->exact, self->expected);
}

/* The state and lambda at t_end, and how well they are known. */
static int solve_reference(study *self)
{
    const dal_order_def *const def = self->def;
    int status;
    if (has_exact(self)) {
        status = dal_system_exact(self->system, def->t_end - def->t0, self->x0, self->end);
        if (status)
            return dal__fail(self->error, status, "the exact solution at t_end = %g: %s",
                             def->t_end, dal_strerror(status));
    } else {
        dal__copy(2 * self->n, self->x0, self->end);
        status = dal_flow_apply(self->flow, def->t0, def->t_end, self->end, &self->accuracy);
        if (status)
            return dal__fail_because(self->error, status, dal_flow_error(self->flow),
                                     "reference flow: ");
    }
    status = dal_multipliers(self->mech, def->t_end, self->end, self->end_lambda);
    return dal__fail_because(self->error, status, dal_mechanics_error(self->mech), "%s", "");
}

/* ---- one step size ---------------------------------------------------------------------- */

/* The stepper at the initial data.  DAL_INITIAL_D_EPS wants them in D_eps. */
static int start_run(study *self, double h)
{
    dal__copy(2 * self->n, self->x0, self->start);
    if (self->kept && self->def->initial == DAL_INITIAL_D_EPS) {
        const int status = dal_project(self->mech, self->def->t0, self->shift * h, self->start,
                                       NULL);
        if (status) return status;
    }
    return dal_stepper_start(self->stepper, self->def->t0, h, self->start, DAL_CHECK,
                             self->def->initial);
}

/* The errors of one step from exact data. */
static int measure_step(study *self, double h, dal_order_point *point)
{
    const size_t n = self->n, m = self->m;
    const double t0 = self->def->t0;
    const double *const state = dal_stepper_state(self->stepper);
    dal__copy(2 * n, state, self->start);
    int status = dal_step(self->stepper, self->reaction);

    if (!status) status = expect(self, t0 + 0.5 * h);
    if (status) return status;
    point->local_midpoint = dal__largest_difference(m, self->reaction, self->expected);

    status = expect(self, t0 + h);
    if (!status) status = dal_multipliers(self->mech, t0 + h, state, self->lambda);
    if (status) return status;
    point->local_state = dal__largest_difference(2 * n, state, self->exact);
    point->local_multipliers = dal__largest_difference(m, self->lambda, self->expected);
    point->local_reaction = dal__largest_difference(m, self->reaction, self->expected);
    return DAL_SUCCESS;
}

/* Energy and residuals of the states in rows 1..count, of the steps first to first + count - 1; row
 * 0 is where the block began. */
static int watch_block(study *self, double h, size_t first, size_t count, double energy0,
                       dal_order_point *point)
{
    const double *const x = self->rows + 2 * self->n;
    const double t0 = self->def->t0;
    int status = dal__trajectory(self->mech, t0, h, first, 0.0, count, x, NULL, self->energy, NULL,
                                 NULL, self->relative, NULL);
    if (status) return status;
    for (size_t k = 0; k < count; k++) {
        const double error = fabs(self->energy[k] - energy0) / fmax(fabs(energy0), 1.0);
        point->energy = fmax(point->energy, error);
    }
    point->residual = fmax(point->residual, dal__largest(count, self->relative));
    if (isnan(self->shift)) return DAL_SUCCESS;
    status = dal__trajectory(self->mech, t0, h, first, self->shift * h, count, x, NULL, NULL, NULL,
                             NULL, self->relative, NULL);
    if (status) return status;
    point->residual_eps = fmax(point->residual_eps, dal__largest(count, self->relative));
    return DAL_SUCCESS;
}

/* The run to t_end: what it keeps on the way, and its errors there.  Blocks begin with one step and
 * grow as long as they are short in time, so that the watch is asked often enough however long a
 * step takes. */
static int measure_run(study *self, double h, size_t steps, dal_order_point *point)
{
    const size_t n = self->n;
    double energy0;
    int status = dal_energy(self->mech, self->def->t0, dal_stepper_state(self->stepper), &energy0);
    for (size_t made = 0, block = 1; !status && made < steps;) {
        const size_t count = steps - made < block ? steps - made : block;
        const double began = dal__clock();
        dal_run run = {.stepper = self->stepper, .steps = count, .stride = 1, .x = self->rows,
                       .unchecked = 1}; /* the study measures the errors */
        status = dal_run_go(&run, SIZE_MAX);
        if (!status) status = watch_block(self, h, made + 1, count, energy0, point);
        made += count;
        self->watch.made += (double)count;
        if (!status) status = dal__ask(&self->watch, self->watch.made, self->error);
        if (block < BLOCK && dal__clock() - began < 0.1 * DAL_WATCH_SECONDS) block *= 2;
    }
    const double *const state = dal_stepper_state(self->stepper);
    if (!status) status = dal_multipliers(self->mech, self->def->t_end, state, self->lambda);
    if (status) return status;
    point->q = dal__largest_difference(n, state, self->end);
    point->v = dal__largest_difference(n, state + n, self->end + n);
    point->multipliers = dal__largest_difference(self->m, self->lambda, self->end_lambda);
    return DAL_SUCCESS;
}

/* NaN is what has not been measured; fmax drops it. */
static dal_order_point unmeasured_point(double h, size_t steps, int status)
{
    return (dal_order_point){.h = h, .steps = steps, .q = NAN, .v = NAN, .multipliers = NAN,
                             .local_state = NAN, .local_multipliers = NAN, .local_reaction = NAN,
                             .local_midpoint = NAN, .residual = NAN, .residual_eps = NAN,
                             .energy = NAN, .failed = status};
}

/* One line of the table.  A run that fails is a failed point; but a callback or a watch that says
 * stop is obeyed, and a lack of memory says nothing of the scheme. */
static int measure_point(study *self, size_t which)
{
    const size_t steps = self->def->steps[which];
    const double h = (self->def->t_end - self->def->t0) / (double)steps;
    dal_order_point *const point = &self->points[which];
    self->h[which] = h;
    *point = unmeasured_point(h, steps, DAL_SUCCESS);
    int status = start_run(self, h);
    if (!status) status = measure_step(self, h, point);
    if (!status) status = start_run(self, h);
    if (!status) status = measure_run(self, h, steps, point);
    if (status) *point = unmeasured_point(h, steps, status);
    if (status == DAL_STOPPED || status == DAL_EUSER || status == DAL_ENOMEM)
        return dal__fail(self->error, status, "%s the run with h = %g",
                         status == DAL_ENOMEM ? "out of memory in" : "a callback stopped", h);
    return DAL_SUCCESS;
}

/* ---- the verdict ------------------------------------------------------------------------ */

/* What the record promises for the first step of the run. */
typedef struct promise {
    int p, s;
} promise;

/* From D to D_eps, which is another set unless beta = 1. */
static bool starts_with_jump(const study *self)
{
    return self->kept && self->shift > 0.0 && self->def->initial == DAL_INITIAL_D;
}

static promise promise_of_step(const study *self)
{
    const int lost = starts_with_jump(self) ? 1 : 0;
    return (promise){self->scheme->order - lost, self->scheme->multiplier_order - lost};
}

static bool is_known(const dal_fit *fit) { return fit->exact || !isnan(fit->slope); }

/* A slope of at least least, within the slack; an exact result has every order.  Slopes that still
 * change must not have left it where h is smallest. */
static bool reaches(const dal_fit *fit, int least)
{
    return fit->exact || (fit->slope >= least - SLACK
                          && (fit->spread <= SETTLED || fit->finest >= least - ANOTHER));
}

/* Falls short, and says so: slopes that still change with h are no order yet. */
static bool falls_short(const dal_fit *fit, int least)
{
    return !fit->exact && fit->slope < least - ANOTHER && fit->spread <= SETTLED;
}

/* Whether a run resolves the solution: it is not off by as much as the solution is large. */
static bool resolves(const study *self, const dal_order_point *point)
{
    return fmax(point->q, point->v) <= RESOLVED * size_of_states(self);
}

/* Whether all runs do, and none fails with a smaller step than another that does not. */
static bool is_resolved(const study *self)
{
    double longest = 0.0, failing = INFINITY;
    for (size_t i = 0; i < self->def->count; i++) {
        const dal_order_point *const point = &self->points[i];
        if (point->failed) failing = fmin(failing, fabs(point->h));
        else if (!resolves(self, point)) return false;
        else longest = fmax(longest, fabs(point->h));
    }
    return failing >= longest;
}

/* A fit beside the slope that is promised. */
typedef struct part {
    bool known, holds, falls_short;
    bool below; /* falls short, or does so where h is smallest */
    bool sunk;  /* the error of the smallest step is roundoff */
    bool few;   /* fewer than three over a factor of two count and resolve the solution */
} part;

static part part_of(const study *self, dal_order_fit which, const dal_fit *fit, int least)
{
    double smallest = INFINITY, shortest = INFINITY, longest = 0.0;
    size_t clear = 0;
    part part = {.known = is_known(fit), .holds = reaches(fit, least),
                 .falls_short = falls_short(fit, least)};
    part.below = part.falls_short || (!fit->exact && fit->finest < least - ANOTHER);
    for (size_t i = 0; i < self->def->count; i++) {
        const dal_order_point *const point = &self->points[i];
        const bool counts = point->counted >> which & 1u;
        const double h = fabs(point->h);
        if (point->failed) continue;
        if (h < smallest) {
            smallest = h;
            part.sunk = !counts;
        }
        if (!counts || !resolves(self, point)) continue;
        clear++;
        shortest = fmin(shortest, h);
        longest = fmax(longest, h);
    }
    part.few = clear < FEWEST_POINTS || longest < SMALLEST_RANGE * shortest;
    return part;
}

/* The verdict, and where it is -2 or -3 the reason in words. */
static int judge(const study *self, const dal_order *order, const char **why)
{
    *why = "";
    if (self->scheme->order == 0) return -1;
    const promise of_step = promise_of_step(self);
    const bool both = starts_with_jump(self);
    const part step = part_of(self, DAL_FIT_STATE, &order->state, of_step.p + 1);
    const part run = part_of(self, DAL_FIT_GLOBAL_STATE, &order->global_state, self->scheme->order);
    const part reaction = dal__scheme_family(self->scheme)->no_reaction
        ? (part){.holds = true, .known = true}
        : part_of(self, DAL_FIT_REACTION, &order->reaction, of_step.s + 1);
    const bool reached = both ? step.holds && run.holds : step.holds || run.holds;
    /* where either will do, one that falls short says nothing as long as the other may not */
    const bool missed = both ? step.falls_short || run.falls_short
                      : (step.falls_short && run.below) || (run.falls_short && step.below);
    const bool few = !reaction.known || !(reached || missed || (step.known && run.known));
    const bool resolved = is_resolved(self);
    const bool changes = !(reached || missed) || !(reaction.holds || reaction.falls_short);
    const bool lost = reached && run.known && !run.holds;
    if (!few && resolved && !changes && !lost)
        return reached && reaction.holds && (self->kept ? order->keeps_D_eps : order->keeps_D);

    const bool open = resolved ? !(reached || missed) : run.few && step.few;
    const bool hidden = run.sunk && ((step.sunk && open) || (resolved && lost));
    if (hidden && resolved && reaction.falls_short) return 0; /* p is hidden, s is not */
    if (hidden && self->tolerance > DEFAULT_TOLERANCE)
        *why = "Not settled, because too few errors exceed that of the reference, or they show no "
               "order yet: take a smaller tolerance";
    else if (hidden && run.few && step.few)
        *why = "Not measurable in double, because fewer than three errors lie between roundoff and "
               "the solution: take larger h that resolve it, or a longer interval";
    else if (hidden)
        *why = "Not measurable in double, because the order still changes with h where the errors "
               "reach roundoff: take a longer interval";
    else if (few)
        *why = "Not settled, because fewer than three errors over a factor of two in h exceed "
               "roundoff: take more numbers of steps, or a longer interval";
    else if (!resolved)
        *why = "Not settled, because an error at t_end is as large as the solution, or a finer run "
               "failed: take fine steps, or a shorter interval";
    else if (changes)
        *why = "Not settled, because the order still changes with h: take finer steps";
    else
        *why = "Not settled, because the errors at t_end do not have the order of one step: take "
               "finer steps, and check that the motion is smooth";
    return hidden && self->tolerance <= DEFAULT_TOLERANCE ? -3 : -2;
}

/* 1 if the residual of D, or of D_eps, is within the bound at every state of every run that did not
 * fail. */
static int is_kept(const study *self, bool eps, double *worst)
{
    *worst = 0.0;
    size_t runs = 0;
    for (size_t i = 0; i < self->def->count; i++) {
        const dal_order_point *const point = &self->points[i];
        const double residual = eps ? point->residual_eps : point->residual;
        if (point->failed) continue;
        if (!(residual <= *worst)) *worst = residual;
        runs++;
    }
    return runs > 0 && *worst <= DAL_RESIDUAL_BOUND(self->n);
}

/* text <- a fitted order: the slope minus lost, "exact", or "?". */
static const char *order_text(const dal_fit *fit, double lost, char text[16])
{
    if (fit->exact) snprintf(text, 16, "exact");
    else if (isnan(fit->slope)) snprintf(text, 16, "?");
    else snprintf(text, 16, "%.2f", round(100.0 * (fit->slope - lost)) / 100.0 + 0.0);
    return text;
}

static const char *verdict_word(const dal_order *order, const char *why)
{
    switch (order->holds) {
    case 1: return order->state.exact && order->global_state.exact ? "Exact to roundoff" : "Holds";
    case 0: return "Does not hold";
    case -1: return "The scheme promises no order";
    default: return why;
    }
}

/* Where nothing does work on the system, whether its energy changes alike at every step size. */
static bool loses_energy(study *self)
{
    const dal_system_def *const def = &self->system->def;
    dal_fit fit;
    for (size_t i = 0; i < self->def->count; i++) self->errors[i] = self->points[i].energy;
    dal_fit_order(self->def->count, self->h, self->errors, ENERGY / ABOVE_FLOOR, &fit, NULL);
    return dal__is_autonomous(self->system) && def->kind == DAL_LINEAR && is_resolved(self)
        && fit.slope < 0.5;
}

/* The verdict in words, with the numbers that it rests on. */
static void write_verdict(study *self, double worst, const char *why, dal_order *order)
{
    char p[16], s[16], at_end[16], promised[64] = "", kept[64] = "", failed[128] = "";
    size_t failures = 0, last = 0;
    for (size_t i = 0; i < self->def->count; i++)
        if (self->points[i].failed) {
            failures++;
            last = i;
        }
    if (failures)
        snprintf(failed, sizeof failed, "; %zu of %zu runs failed (%s)", failures,
                 self->def->count, dal_strerror(self->points[last].failed));
    if (self->scheme->order != 0) {
        const promise of_step = promise_of_step(self);
        snprintf(promised, sizeof promised, ", promised (%d, %d)%s", of_step.p, of_step.s,
                 starts_with_jump(self) ? " for the first step from D" : "");
    }
    if (self->m > 0 && failures < self->def->count)
        snprintf(kept, sizeof kept, "; %s %s %.1e at every step", self->kept ? "D_eps" : "D",
                 (self->kept ? order->keeps_D_eps : order->keeps_D) ? "kept to" : "violated by",
                 worst);
    snprintf(order->text, sizeof order->text,
             "%s. Order (p, s) = (%s, %s) over %zu point%s%s, order %s at t_end%s%s%s.",
             verdict_word(order, why), order_text(&order->state, 1.0, p),
             order_text(&order->reaction, 1.0, s), order->state.points,
             order->state.points == 1 ? "" : "s", promised,
             order_text(&order->global_state, 0.0, at_end), kept, failed,
             loses_energy(self) ? "; nothing does work on the system, but its energy changes as "
             "much at the smallest h: gradient may not belong to potential, see check" : "");
}

/* Whether errors of one order less than promised would be seen at the longest step.  Those of one
 * step are about (rate h)^p of the state, with rate = |v'|/|v|, and those of a run T/h times as
 * large.  Where nothing accelerates every scheme is exact. */
static bool tells_lower_order(study *self, bool at_end, double floor)
{
    const dal_order_def *const def = self->def;
    double v = 0.0, a = 0.0, h = 0.0;
    for (int end = 0; end < 2; end++) {
        const double *const x = end ? self->end : self->x0;
        if (dal_acceleration(self->mech, end ? def->t_end : def->t0, x, self->exact)) return true;
        v = fmax(v, dal__largest(self->n, x + self->n));
        a = fmax(a, dal__largest(self->n, self->exact));
    }
    if (a <= error_floor(self, STEP_ROUNDINGS)) return true;
    for (size_t i = 0; i < def->count; i++) h = fmax(h, fabs(self->points[i].h));
    const double runs = at_end ? fabs(def->t_end - def->t0) / h : 1.0;
    return size_of_states(self) * pow(a / v * h, self->scheme->order) * runs > ABOVE_FLOOR * floor;
}

static void conclude(study *self, dal_order *order)
{
    const double step = error_floor(self, STEP_ROUNDINGS), run = error_floor(self, RUN_ROUNDINGS);
    *order = (dal_order){.floor = run, .reference = self->accuracy};
    dal_fit *const fits[] = {
        &order->state, &order->multipliers,
        &order->reaction, &order->midpoint,
        &order->global_q, &order->global_v,
        &order->global_multipliers,
        &order->global_state,
    };
    for (dal_order_fit which = DAL_FIT_STATE; which <= DAL_FIT_GLOBAL_STATE; which++)
        *fits[which] = which == DAL_FIT_REACTION ? fit_reaction(self, step)
                     : fit_errors(self, which, which < DAL_FIT_GLOBAL_Q ? step : run, INFINITY);
    order->global_state.exact = order->global_state.exact && tells_lower_order(self, true, run);
    order->state.exact = order->state.exact && is_known(&order->global_state)
                         && tells_lower_order(self, false, step);
    order->p = order->state.slope - 1.0;
    order->s = order->reaction.slope - 1.0;
    double worst_D, worst_D_eps;
    order->keeps_D = is_kept(self, false, &worst_D);
    order->keeps_D_eps = is_kept(self, true, &worst_D_eps);
    const char *why;
    order->holds = judge(self, order, &why);
    write_verdict(self, self->kept ? worst_D_eps : worst_D, why, order);
}

/* ---- the study -------------------------------------------------------------------------- */

static int check_def(const dal_system *system, const dal_scheme *scheme,
                     const dal_order_def *def, dal_error *error)
{
    if (!isfinite(def->t0) || !isfinite(def->t_end) || !isfinite(def->t_end - def->t0) ||
        def->t_end == def->t0)
        return dal__fail(error, DAL_EINVAL, "t0 = %g, t_end = %g: expected an interval of finite "
                         "length other than 0", def->t0, def->t_end);
    if (def->count == 0)
        return dal__fail(error, DAL_EINVAL, "count = 0: expected at least one number of steps");
    for (size_t i = 0; i < def->count; i++)
        if (def->steps[i] == 0) return dal__fail(error, DAL_EINVAL, "steps[%zu] = 0: expected a "
                                                 "positive number", i);
    if (DAL__REQUIRE_FINITE(error, {"x0", 2 * dal_system_n(system), def->x0})
        || (def->tolerance != 0.0 && dal__check_tolerance(def->tolerance, error)))
        return DAL_EINVAL;
    const bool kept = scheme->nodes == DAL_KEPT_NODES;
    if (kept != (def->initial != DAL_INITIAL_NONE))
        return dal__fail(error, DAL_EINVAL, "initial = %d: %s", (int)def->initial,
                         kept ? "expected a dal_initial other than DAL_INITIAL_NONE for a scheme "
                                "with kept nodes"
                              : "expected DAL_INITIAL_NONE, because only schemes with kept nodes "
                                "have a choice");
    return DAL_SUCCESS;
}

static int reserve_arrays(study *self)
{
    const size_t N = 2 * self->n, rows = BLOCK + 1, count = self->def->count;
    DAL__RESERVE(&self->memory, N, &self->x0, &self->end, &self->start, &self->exact);
    DAL__RESERVE(&self->memory, self->m, &self->end_lambda, &self->lambda, &self->expected,
                 &self->reaction);
    DAL__RESERVE(&self->memory, rows, &self->energy, &self->relative);
    DAL__RESERVE(&self->memory, count, &self->h, &self->errors);
    DAL__RESERVE(&self->memory, dal__times(rows, N), &self->rows);
    dal__reserve(&self->memory, &self->points, count, sizeof *self->points);
    return dal__allocate(&self->memory, self->error);
}

/* The objects of the study.  The flow stands in where there is no exact solution: in general, or
 * off D. */
static int make_objects(study *self)
{
    int status = dal_mechanics_new(&self->mech, self->system, self->error);
    if (!status)
        status = dal_stepper_new(&self->stepper, self->system, self->scheme, NULL, self->error);
    if (!status && (self->kept || !has_exact(self)))
        status = dal_flow_new(&self->flow, self->system, DAL_FLOW_RK8PD, DAL_FLOW_X,
                              self->tolerance, self->error);
    if (!status) dal_flow_watch(self->flow, dal__relay, &self->watch);
    return status ? status : reserve_arrays(self);
}

static void release_objects(study *self)
{
    dal_flow_free(self->flow);
    dal_stepper_free(self->stepper);
    dal_mechanics_free(self->mech);
    dal__release(&self->memory);
}

/* x0 <- the initial data, which must lie in D, in D to roundoff. */
static int place_on_D(study *self)
{
    double residual;
    dal__copy(2 * self->n, self->def->x0, self->x0);
    int status = dal_relative_residual(self->mech, self->def->t0, 0.0, self->x0, &residual);
    if (!status && residual > DAL_CONSISTENT)
        return dal__fail(self->error, DAL_EOFFD, "the initial velocity violates the constraint: "
                         "relative residual %.3g, allowed %g", residual, DAL_CONSISTENT);
    if (!status) status = dal_project(self->mech, self->def->t0, 0.0, self->x0, NULL);
    return dal__fail_because(self->error, status, dal_mechanics_error(self->mech), "%s", "");
}

const char *dal_scheme_usual(const dal_system *system)
{
    return !system || dal__has_pairs(system) ? "leapfrog" : "midpoint";
}

int dal_order_study(const dal_system *system, const dal_scheme *scheme, const dal_order_def *def,
                    dal_order_point *points, dal_order *order, dal_error *error)
{
    int status = DAL__REQUIRE(error, {"points", points}, {"order", order}, {"system", system},
                              {"scheme", scheme}, {"def", def}, {"def->x0", def && def->x0},
                              {"def->steps", def && def->steps});
    if (!status) status = check_def(system, scheme, def, error);
    if (status) return status;

    study self = {.system = system, .scheme = scheme, .def = def, .n = dal_system_n(system),
                  .m = dal_system_m(system), .kept = scheme->nodes == DAL_KEPT_NODES,
                  .tolerance = def->tolerance > 0.0 ? def->tolerance : DEFAULT_TOLERANCE,
                  .watch = {.function = def->watch, .ctx = def->watch_ctx}, .error = error};
    if (dal_scheme_shift(scheme, &self.shift)) self.shift = NAN;

    status = make_objects(&self);
    if (!status) status = place_on_D(&self);
    if (!status) status = solve_reference(&self);
    for (size_t i = 0; !status && i < def->count; i++)
        status = measure_point(&self, i);
    if (!status) {
        conclude(&self, order);
        memcpy(points, self.points, def->count * sizeof *points);
    }
    release_objects(&self);
    return status;
}
