/* Where the events of a step cross zero. */
#include "run/events.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { HALVINGS = 12 }; /* in which a guard that was reset has to show its sign */
#define NEARBY 0x1p-10  /* the part of a step over which the rate of g is differenced */
#define SAME_PLACE 1e-9 /* of a step: places of one crossing by two ways to compute it */
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

/* The piece of the step, if it has only one: that of the span, unless a reset has led elsewhere. */
static bool find_piece(const dal_events *e, dal__piece *piece)
{
    return !e->landed && dal__taylor_piece(e->stepper, e->t, piece);
}

int dal__reach(dal_events *e, double theta, double *x)
{
    dal__piece piece;
    memcpy(x, theta == 1.0 ? e->end : e->begin, 2 * e->n * sizeof *x);
    e->lost = 0;
    if (theta == 1.0) return DAL_SUCCESS;
    if (!find_piece(e, &piece))
        return dal__probe(e, dal__time_at(e, e->from), (theta - e->from) * e->h, x);
    const int status = dal__taylor_state(e->probe, &piece, dal__time_at(e, theta), x);
    return dal__fail_because(e->error, status, &e->probe->error, "a state within step %zu (t = "
                             "%g): ", e->step + 1, e->t);
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

/* Visits the first piece: its rate of g. */
typedef struct first_rate {
    dal__along *along;
    double rate;
    dal_error *error;
} first_rate;

static int find_first_rate(const dal__piece *piece, double from, double to, void *ctx)
{
    first_rate *const self = ctx;
    (void)to;
    return dal__along_rate(self->along, piece, from, &self->rate, self->error);
}

/* *rate <- dg/dtheta by series, of the motion that leads to x or goes on from there.  Returns false
 * if there are none. */
static bool find_rate_of_series(dal_events *e, size_t event, double theta, const double *x,
                                double ahead, double *rate)
{
    dal__piece piece;
    dal_error ignored = {0};
    const double t = dal__time_at(e, theta);
    first_rate first = {.along = e->along[event], .error = &ignored};
    if (!first.along) return false;
    if (ahead < 0.0) {
        if (!find_piece(e, &piece)
            || dal__along_rate(first.along, &piece, t, &first.rate, &ignored)) return false;
    } else if (dal_stepper_start(e->probe, t, e->h, x, DAL_ASSUME, DAL_INITIAL_NONE)
               || dal__taylor_visit(e->probe, t, find_first_rate, &first)) {
        return false;
    }
    *rate = first.rate * e->h;
    return true;
}

int dal__event_rate(dal_events *e, size_t event, double theta, const double *x, double g,
                   double ahead, double *rate)
{
    if (find_rate_of_series(e, event, theta, x, ahead, rate)) return DAL_SUCCESS;
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

static int add(dal_events *e, size_t event, double theta, int to, size_t *found)
{
    const int status = dal__grow(&e->crossings, *found, &e->room, sizeof *e->crossings, e->error);
    if (!status)
        e->crossings[(*found)++] = (crossing){.event = event, .theta = theta, .to = to};
    return status;
}

/* Where event crosses to the side between low and high, at which g is known. */
static int locate(dal_events *e, size_t event, double low, double at_low, double high,
                  double at_high, int to, size_t *found)
{
    search s = {.events = e, .event = event, .low = low, .at_low = at_low, .high = high,
                .at_high = at_high, .function = value_at};
    double theta;
    const int status = find_zero(&s, &theta);
    return status ? status : add(e, event, theta, to, found);
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

static void doubt(dal_events *e, size_t event, double t, double g)
{
    if (e->doubts++ > 0) return;
    e->doubt_event = event;
    e->doubt_t = t;
    e->doubt_g = g;
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
    if (fabs(at) <= error) doubt(e, event, dal__time_at(e, theta), at);
    if (s * at >= 0.0) return DAL_SUCCESS;
    status = locate(e, event, e->from, g->begin, theta, at, -s, found);
    return status ? status : locate(e, event, theta, at, 1.0, g->end, s, found);
}

/* ---- after a reset -------------------------------------------------------------------------- */

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

/* ---- by series ----------------------------------------------------------------------------- */

/* Looks at an event in one piece of the span after the other. */
typedef struct look {
    dal_events *events;
    size_t event, *found;
    int side;         /* of zero, where the piece begins; 0: not known */
    double zero;      /* a value there that is zero, and left; < 0: none */
    double zero_since; /* in the last piece, or NaN */
} look;

static double theta_at(const dal_events *e, double t)
{
    return fmin(fmax((t - e->t) / e->h, e->from), 1.0);
}

static int look_at_piece(const dal__piece *piece, double from, double to, void *ctx)
{
    look *const self = ctx;
    dal_events *const e = self->events;
    const double zero = self->zero;
    int status = dal__along_look(e->along[self->event], piece, from, to, zero, &e->watch,
                                 e->error);
    if (status) return status;
    const dal__found found = dal__along_found(e->along[self->event]);
    self->zero = -1.0;
    self->zero_since = found.zero_since;
    if (self->side == 0) self->side = found.first;
    if (self->side * found.first < 0) {
        if (isinf(zero))
            return dal__event_rests(e, self->event, "g goes to the side %g", found.first);
        status = add(e, self->event, theta_at(e, from), -self->side, self->found);
        self->side *= -1;
    }
    for (size_t k = 0; !status && k < found.count; k++) {
        self->side *= -1;
        status = add(e, self->event, theta_at(e, found.t[k]), self->side, self->found);
    }
    if (status || isnan(found.touch)) return status;
    double g;
    status = value_at(e, self->event, theta_at(e, found.touch), &g);
    if (!status) doubt(e, self->event, found.touch, g);
    return status;
}

/* All crossings of an event by its series.  DAL_EDOMAIN if it has none here. */
static int find_by_series(dal_events *e, size_t event, size_t *found)
{
    const guard *const g = &e->guards[event];
    const double from = dal__time_at(e, e->from), to = dal__time_at(e, 1.0);
    const size_t before = *found;
    const double rounding = fmax(dal__event_rounding(g), 8.0 * g->near);
    const double zero = g->waits ? HUGE_VAL : rounding;
    look here = {.events = e, .event = event, .found = found, .side = g->side, .zero = zero,
                 .zero_since = (double)NAN};
    dal__piece piece;
    int status;
    if (from == to) return DAL_SUCCESS; /* a step of any size ends at a reset */
    if (find_piece(e, &piece)) {
        status = look_at_piece(&piece, from, to, &here);
    } else {
        status = dal_stepper_start(e->probe, from, to - from, e->begin, DAL_ASSUME,
                                   DAL_INITIAL_NONE);
        if (!status) status = dal__taylor_visit(e->probe, to, look_at_piece, &here);
        if (status && !e->error->status) *e->error = e->probe->error;
    }
    if (status || here.side * g->end > 0.0 || here.side == 0) return status;
    const bool is_known = *found > before && e->crossings[*found - 1].theta > 1.0 - SAME_PLACE;
    if (is_known && g->end == 0.0) return DAL_SUCCESS;
    if (is_known && fabs(g->end) <= dal__event_rounding(g)) {
        *found -= 1; /* at the end, where g is still on the side before: the next step finds it */
        return DAL_SUCCESS;
    }
    const double theta = isnan(here.zero_since) ? 1.0 : theta_at(e, here.zero_since);
    return add(e, event, theta, -here.side, found);
}

/* ---- the crossings of a span --------------------------------------------------------------- */

/* The crossings of an event, from its values at the ends of the span.  If those suggest a minimum
 * between them, it is searched for. */
static int find_by_values(dal_events *e, size_t event, size_t *found)
{
    const guard *const g = &e->guards[event];
    if (g->side == 0) return DAL_SUCCESS;
    if (g->waits) return find_after_reset(e, event, found);
    if (g->side * g->end > 0.0) return look_closely(e, event, found);
    return locate(e, event, e->from, g->begin, 1.0, g->end, -g->side, found);
}

static int compare_places(const void *a, const void *b)
{
    const crossing *const one = a, *const other = b;
    if (one->theta != other->theta) return one->theta < other->theta ? -1 : 1;
    return (one->event > other->event) - (one->event < other->event);
}

int dal__find_crossings(dal_events *e, size_t *found)
{
    *found = 0;
    for (size_t i = 0; i < e->count; i++) {
        const guard *const g = &e->guards[i];
        const size_t before = *found;
        int status = DAL_EDOMAIN;
        if (g->due || g->jumped) {
            status = add(e, i, e->from, -g->side, found);
        } else if (e->from >= 1.0) {
            continue;
        } else if (e->along[i]) {
            status = find_by_series(e, i, found);
            if (status == DAL_EDOMAIN) *e->error = (dal_error){0};
        }
        if (status == DAL_EDOMAIN) {
            *found = before;
            status = find_by_values(e, i, found);
        }
        if (status) return status;
    }
    if (*found > 1) qsort(e->crossings, *found, sizeof *e->crossings, compare_places);
    return DAL_SUCCESS;
}
