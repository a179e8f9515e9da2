/* Where the events of a step cross zero. */
#include "run/events.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { HALVINGS = 12 }; /* in which a guard that was reset has to show its sign */
#define NEARBY 0x1p-10  /* the part of a step over which the rate of g is differenced */
#define LEAST_LEFT 0x1p-24 /* of a step, over which the change of v is more than its rounding */

/* ---- states within a step ------------------------------------------------------------------ */

double dal__time_at(const dal_events *e, double theta)
{
    return theta == 1.0 ? dal_stepper_time(e->stepper) : e->t + theta * e->h;
}

int dal__probe(dal_events *e, double t, double length, double *x)
{
    dal_stepper *const probe = e->probe;
    dal__stepper_forget_impulse(probe);
    e->lost = 0;
    if (t + length == t) return DAL_SUCCESS;
    probe->motion.watch = e->stepper->motion.watch;
    probe->motion.watch_ctx = e->stepper->motion.watch_ctx;
    int status = dal_stepper_start(probe, t, length, x, DAL_ASSUME, DAL_INITIAL_NONE);
    probe->scaling.energy = e->energy;
    if (!status) status = dal_step(probe, NULL);
    if (!status) memcpy(x, probe->motion.x, 2 * e->n * sizeof *x);
    e->lost = probe->motion.stats->unscaled;
    return dal__fail_because(e->error, status, &probe->error, "a state within step %zu (t = %g): ",
                             e->step + 1, e->t);
}

int dal__reach(dal_events *e, double theta, double *x)
{
    memcpy(x, theta == 1.0 ? e->end : e->begin, 2 * e->n * sizeof *x);
    e->lost = 0;
    if (theta == 1.0) return DAL_SUCCESS;
    return dal__probe(e, dal__time_at(e, e->from), (theta - e->from) * e->h, x);
}

int dal__event_value(dal_events *e, size_t event, double t, const double *x, double *g)
{
    const dal_event *const one = &e->list[event];
    *g = NAN;
    const int returned = one->g(t, x, g, one->ctx);
    if (returned)
        return dal__fail(e->error, dal__callback_status(returned), "event %zu returned %d at t = "
                         "%g", event, returned, t);
    if (!isfinite(*g))
        return dal__fail(e->error, DAL_EDOMAIN, "event %zu: g = %g at t = %g is not finite", event,
                         *g, t);
    e->guards[event].size = fmax(e->guards[event].size, fabs(*g));
    return DAL_SUCCESS;
}

static int value_at(dal_events *e, size_t event, double theta, double *g)
{
    const int status = dal__reach(e, theta, e->x);
    return status ? status : dal__event_value(e, event, dal__time_at(e, theta), e->x, g);
}

int dal__event_rate(dal_events *e, size_t event, double theta, const double *x, double g,
                   double ahead, double *rate)
{
    const size_t n = e->n;
    const double *const v0 = e->begin + n, *const v1 = e->end + n;
    const double left = 1.0 - e->from;
    const bool known = left > LEAST_LEFT; /* how v changes in it */
    const double part = ahead * NEARBY * (known ? left : 1.0);
    for (size_t i = 0; i < n; i++) {
        e->line[i] = x[i] + part * e->h * x[n + i];
        e->line[n + i] = x[n + i] + (known ? part / left * (v1[i] - v0[i]) : 0.0);
    }
    double there;
    const int status =
        dal__event_value(e, event, dal__time_at(e, theta) + part * e->h, e->line, &there);
    *rate = (there - g) / part;
    return status;
}

double dal__event_rounding(const guard *g) { return 64.0 * DAL_ROUNDOFF * g->size; }

/* ---- zeros --------------------------------------------------------------------------------- */

/* A function of theta with known values at the ends of an interval. */
typedef struct search {
    dal_events *events;
    size_t event;
    double low, at_low, high, at_high;
    int (*function)(dal_events *e, size_t event, double theta, double *value);
    int status;
    double last;
} search;

/* GSL sees numbers alone: after a failure the last one again, and then is not asked further. */
static double value_for_gsl(double theta, void *params)
{
    search *const s = params;
    if (theta == s->low) return s->at_low;
    if (theta == s->high) return s->at_high;
    double value;
    if (!s->status) s->status = s->function(s->events, s->event, theta, &value);
    return s->last = s->status ? s->last : value;
}

/* *theta <- where the function, which has other signs at the ends, is zero to rounding. */
static int find_zero(search *s, double *theta)
{
    enum { ITERATIONS = 100 };
    gsl_root_fsolver *const solver = &s->events->solver;
    gsl_function function = {.function = value_for_gsl, .params = s};
    *theta = s->high;
    if (s->at_high == 0.0) return DAL_SUCCESS;
    if (dal__sign(s->at_low) == dal__sign(s->at_high))
        return dal__fail(s->events->error, DAL_EINVAL, "event %zu: g = %g at t = %g had the "
                         "opposite sign in an earlier call: it must depend only on the state and "
                         "the time", s->event, s->at_low, dal__time_at(s->events, s->low));
    s->last = s->at_low;
    gsl_root_fsolver_set(solver, &function, s->low, s->high);
    for (int k = 0; k < ITERATIONS && !s->status; k++) {
        gsl_root_fsolver_iterate(solver);
        if (s->last == 0.0 || solver->x_upper - solver->x_lower <= 4.0 * DAL_ROUNDOFF) break;
    }
    *theta = solver->root;
    return s->status;
}

/* Where event crosses to the side between low and high, at which g is known. */
static int locate(dal_events *e, size_t event, double low, double at_low, double high,
                  double at_high, int to, size_t *found)
{
    search s = {.events = e, .event = event, .low = low, .at_low = at_low, .high = high,
                .at_high = at_high, .function = value_at};
    crossing *const c = &e->crossings[*found];
    *c = (crossing){.event = event, .to = to};
    *found += 1;
    return find_zero(&s, &c->theta);
}

/* ---- grazing ------------------------------------------------------------------------------- */

/* The rate of g along the motion, by states on both sides. */
static int slope_at(dal_events *e, size_t event, double theta, double *slope)
{
    const double part = NEARBY * (1.0 - e->from);
    const double low = fmax(theta - part, e->from), high = fmin(theta + part, 1.0);
    double below, above;
    int status = value_at(e, event, low, &below);
    if (!status) status = value_at(e, event, high, &above);
    if (!status) *slope = (above - below) / (high - low);
    return status;
}

/* The least value in a span of the cubic with these values and rates at its ends; its rates have
 * other signs there. */
static double least_of_cubic(double g0, double rate0, double g1, double rate1)
{
    double least = fmin(g0, g1);
    const double a = 2.0 * (g0 - g1) + rate0 + rate1, b = 3.0 * (g1 - g0) - 2.0 * rate0 - rate1;
    const double root = sqrt(fmax(b * b - 3.0 * a * rate0, 0.0));
    const double places[2] = {-rate0 / (b + root), -rate0 / (b - root)};
    for (int i = 0; i < 2; i++) {
        const double s = places[i];
        if (s > 0.0 && s < 1.0) least = fmin(least, g0 + s * (rate0 + s * (b + s * a)));
    }
    return least;
}

/* By how much the error of the step moves g at theta: one step against two halves. */
static int uncertainty_at(dal_events *e, size_t event, double theta, double g, double *error)
{
    const double t = dal__time_at(e, e->from), half = 0.5 * (theta - e->from) * e->h;
    double again = g; /* where it cannot be evaluated status says so */
    memcpy(e->x, e->begin, 2 * e->n * sizeof *e->x);
    int status = dal__probe(e, t, half, e->x);
    if (!status) status = dal__probe(e, t + half, half, e->x);
    if (!status) status = dal__event_value(e, event, dal__time_at(e, theta), e->x, &again);
    *error = fabs(again - g) + dal__event_rounding(&e->guards[event]);
    return status;
}

/* A guard with the same sign at both ends, that falls towards zero at the beginning and rises at
 * the end: if it comes near, its least value is looked for, and what is on the other side there. */
static int look_closely(dal_events *e, size_t event, size_t *found)
{
    const guard *const g = &e->guards[event];
    const int s = g->side;
    double rates[2], at, theta, error;
    int status = dal__event_rate(e, event, e->from, e->begin, g->begin, 1.0, &rates[0]);
    if (!status) status = dal__event_rate(e, event, 1.0, e->end, g->end, -1.0, &rates[1]);
    if (status || s * rates[0] >= 0.0 || s * rates[1] <= 0.0) return status;
    const double length = 1.0 - e->from, least = least_of_cubic(
        s * g->begin, s * rates[0] * length, s * g->end, s * rates[1] * length);
    if (least > fmin(fabs(g->begin), fabs(g->end)) - least) return status;

    search lowest = {.events = e, .event = event, .low = e->from, .at_low = rates[0], .high = 1.0,
                     .at_high = rates[1], .function = slope_at};
    status = find_zero(&lowest, &theta);
    if (!status) status = value_at(e, event, theta, &at);
    if (!status) status = uncertainty_at(e, event, theta, at, &error);
    if (status) return status;
    if (fabs(at) <= error && e->doubts++ == 0) {
        e->doubt_event = event;
        e->doubt_t = dal__time_at(e, theta);
        e->doubt_g = at;
    }
    if (s * at >= 0.0) return DAL_SUCCESS;
    status = locate(e, event, e->from, g->begin, theta, at, -s, found);
    return status ? status : locate(e, event, theta, at, 1.0, g->end, s, found);
}

/* ---- the crossings of a span --------------------------------------------------------------- */

int dal__event_rests(dal_events *e, size_t event, const char *what, double value)
{
    char words[64];
    snprintf(words, sizeof words, what, value);
    return dal__fail(e->error, DAL_EZENO, "event %zu, t = %g: the event repeats without end, "
                     "because g stays at zero after the reset (%s). End the run earlier with a "
                     "terminal event, for example on the speed", event, dal__time_at(e, e->from),
                     words);
}

/* A guard that was reset: it has not been seen on its side, where the reset sends it.  Where the
 * step has ended at the reset, the next one shows it. */
static int find_after_reset(dal_events *e, size_t event, size_t *found)
{
    const guard *const g = &e->guards[event];
    double part = 1.0 - e->from, at;
    if (g->side * g->end > 0.0 || fabs(g->end) <= dal__event_rounding(g)
        || dal__time_at(e, e->from) == dal__time_at(e, 1.0)) return DAL_SUCCESS;
    for (int k = 0; k < HALVINGS; k++) {
        part *= 0.5;
        const int status = value_at(e, event, e->from + part, &at);
        if (status) return status;
        if (g->side * at > 0.0)
            return locate(e, event, e->from + part, at, 1.0, g->end, -g->side, found);
    }
    return dal__event_rests(e, event, "later g = %g", g->end);
}

int dal__find_crossings(dal_events *e, size_t *found)
{
    int status = DAL_SUCCESS;
    *found = 0;
    for (size_t i = 0; !status && e->from < 1.0 && i < e->count; i++) {
        const guard *const g = &e->guards[i];
        if (g->side == 0) continue;
        if (g->due || g->jumped) e->crossings[(*found)++] = (crossing){i, e->from, -g->side};
        else if (g->waits) status = find_after_reset(e, i, found);
        else if (g->side * g->end <= 0.0)
            status = locate(e, i, e->from, g->begin, 1.0, g->end, -g->side, found);
        else status = look_closely(e, i, found);
    }
    for (size_t k = 1; k < *found; k++) /* by time, and in the order of the list */
        for (size_t j = k; j > 0 && e->crossings[j].theta < e->crossings[j - 1].theta; j--) {
            const crossing later = e->crossings[j - 1];
            e->crossings[j - 1] = e->crossings[j];
            e->crossings[j] = later;
        }
    return status;
}

