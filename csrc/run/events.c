/* What happens between the steps of a run. */
#include "run/events.h"
#include "run/run.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { SAVED = 5 };      /* numbers of a guard */
#define SAME 1e-6        /* an event elsewhere, as part of its size */
#define TOGETHER 0x1p-44 /* parts of a step that differ by no more are the same */
#define RUSH 0x1p17      /* roundings of the time, in which there are fewer resets than the most */
#define NEAREST 1e-12    /* g at a zero is no more, as part of its size */
#define AT_REST 0x1p-20  /* a rate after a reset is none, as part of that before it */

/* ---- making -------------------------------------------------------------------------------- */

static int check_list(const dal_event *list, size_t count, dal_error *error)
{
    if (count > 0 && !list) return dal__fail(error, DAL_EINVAL, "list is NULL");
    for (size_t i = 0; i < count; i++) {
        if (!list[i].g) return dal__fail(error, DAL_EINVAL, "list[%zu].g is NULL", i);
        if ((int)list[i].consistency < DAL_CHECK || list[i].consistency > DAL_ASSUME)
            return dal__fail(error, DAL_EINVAL, "list[%zu].consistency = %d is not a "
                             "dal_consistency", i, (int)list[i].consistency);
    }
    return DAL_SUCCESS;
}

static int allocate(dal_events **events, const dal_stepper *stepper, size_t count,
                    dal_error *error)
{
    const size_t n = stepper->mech.n, m = stepper->mech.m;
    dal_events shape = {.stepper = stepper, .count = count, .n = n, .m = m}, *self;
    arena a = {0};
    dal__reserve(&a, &self, 1, sizeof *self);
    dal__reserve(&a, &shape.list, count, sizeof *shape.list);
    dal__reserve(&a, &shape.guards, count, sizeof *shape.guards);
    dal__reserve(&a, &shape.before, count, sizeof *shape.before);
    dal__reserve(&a, &shape.along, count, sizeof *shape.along);
    dal__reserve(&a, &shape.solver.state, 1, gsl_root_fsolver_brent->size);
    DAL__RESERVE(&a, dal_stepper_saved(stepper), &shape.saved);
    DAL__RESERVE(&a, m, &shape.impulse, &shape.whole, &shape.parts);
    DAL__RESERVE(&a, 2 * n, &shape.begin, &shape.end, &shape.x, &shape.line, &shape.last);
    const int status = dal__allocate(&a, error);
    if (status) return status;
    *self = shape;
    self->arena = a;
    self->solver.type = gsl_root_fsolver_brent;
    *events = self;
    return DAL_SUCCESS;
}

/* The series of events along the pieces of the motion, if the scheme has such. */
static int make_series(dal_events *self, dal_error *error)
{
    const dal_series *const series = self->stepper->motion.system->def.series;
    int status = DAL_SUCCESS;
    for (size_t i = 0; !status && i < self->count; i++) {
        if (!self->list[i].series || !dal__taylor_has_pieces(self->stepper)) continue;
        status = dal__along_new(&self->along[i], &self->list[i], series, self->n, error);
        status = dal__fail_because(error, status, error, "list[%zu].series: ", i);
    }
    return status;
}

int dal_events_new(dal_events **events, const dal_stepper *stepper, const dal_scheme *scheme,
                   const dal_event *list, size_t count, dal_error *error)
{
    int status =
        DAL__REQUIRE(error, {"events", events}, {"stepper", stepper}, {"scheme", scheme});
    if (!status) status = check_list(list, count, error);
    if (!status) status = dal__stepper_check_scheme(stepper, scheme, "events", error);
    if (status) return status;
    dal_events *self;
    status = allocate(&self, stepper, count, error);
    if (status) return status;
    dal_scheme moved = *scheme;
    moved.nodes = DAL_MOVED_NODES;
    status = dal_stepper_new(&self->probe, stepper->motion.system, &moved,
                             &(dal_options){.max_iterations = stepper->motion.max_iterations,
                                            .keep_energy = stepper->scaling.wanted},
                             error);
    if (count > 0) memcpy(self->list, list, count * sizeof *list);
    if (!status) status = make_series(self, error);
    if (status) {
        dal_events_free(self);
        return status;
    }
    *events = self;
    return DAL_SUCCESS;
}

void dal_events_free(dal_events *events)
{
    if (!events) return;
    for (size_t i = 0; i < events->count; i++) dal__along_free(events->along[i]);
    dal_stepper_free(events->probe);
    free(events->crossings);
    free(events->happened);
    free(events->states);
    dal__release(&events->arena);
}

void dal__events_forget(dal_events *events)
{
    for (size_t i = 0; i < events->count; i++) events->guards[i] = (guard){0};
    events->known = events->valued = false;
    events->doubts = events->times_done = events->step = events->rush = 0;
    events->rush_began = (double)NAN;
}

size_t dal_events_doubts(const dal_events *events, size_t *event, double *t, double *g)
{
    if (event) *event = events->doubt_event;
    if (t) *t = events->doubt_t;
    if (g) *g = events->doubt_g;
    return events->doubts;
}

size_t dal_events_saved(const dal_events *events) { return SAVED * events->count; }

/* Whether the guards are those of the state of the stepper. */
static bool is_here(const dal_events *e)
{
    const dal_motion *const motion = &e->stepper->motion;
    return e->known && e->step == motion->steps
        && memcmp(e->last, motion->x, 2 * e->n * sizeof *motion->x) == 0;
}

void dal_events_save(const dal_events *events, double *values)
{
    const bool here = is_here(events);
    for (size_t i = 0; i < events->count; i++, values += SAVED) {
        const guard *const g = &events->guards[i];
        const double of[SAVED] = {g->side, g->waits, (double)g->happened, g->size,
                                  here ? g->begin : (double)NAN};
        memcpy(values, of, sizeof of);
    }
}

static bool is_of_a_guard(const double *values)
{
    const double side = values[0], waits = values[1], happened = values[2];
    return (side == 0.0 || fabs(side) == 1.0) && (waits == 0.0 || waits == 1.0) && happened >= 0.0
        && happened <= 0x1p53 && happened == floor(happened) && values[3] >= 0.0
        && isfinite(values[3]) && !isinf(values[4]);
}

int dal_events_restore(dal_events *events, const double *values, size_t count, dal_error *error)
{
    int status = DAL__REQUIRE(error, {"events", events}, {"values", values || count == 0});
    if (status) return status;
    if (count != dal_events_saved(events))
        return dal__fail(error, DAL_EINVAL, "count = %zu: expected %zu numbers for %zu events",
                         count, dal_events_saved(events), events->count);
    for (size_t i = 0; i < events->count; i++)
        if (!is_of_a_guard(values + SAVED * i))
            return dal__fail(error, DAL_EINVAL, "values[%zu]: not the saved state of an event",
                             SAVED * i);
    events->known = events->stepper->started;
    events->valued = false;
    for (size_t i = 0; i < events->count; i++, values += SAVED) {
        events->guards[i] = (guard){.side = (int)values[0], .waits = values[1] != 0.0,
                                    .happened = (size_t)values[2], .size = values[3],
                                    .begin = values[4]};
        if (isnan(values[4])) events->known = false; /* nobody had looked at it */
    }
    if (events->known) {
        memcpy(events->last, events->stepper->motion.x, 2 * events->n * sizeof(double));
        events->step = events->stepper->motion.steps;
    }
    return DAL_SUCCESS;
}

/* The guards after a step. */
static void settle(dal_events *e)
{
    for (size_t i = 0; i < e->count; i++) {
        guard *const g = &e->guards[i];
        const int side = dal__sign(g->end);
        const double rounding = fmax(dal__event_rounding(g), 8.0 * g->near);
        const bool is_rounding = side != 0 && fabs(g->end) <= rounding;
        if (!g->waits && is_rounding && (g->side == 0 || e->along[i])) {
            /* a rounding does not tell the side */
        } else if (!g->waits || side == g->side) {
            g->side = side;
            g->waits = false;
        }
        g->crossed = false;
        g->begin = g->end;
    }
}

/* y <- x with q moved by shift v. */
static void move(const dal_events *e, double shift, const double *x, double *y)
{
    memcpy(y, x, 2 * e->n * sizeof *y);
    if (shift != 0.0)
        for (size_t i = 0; i < e->n; i++) y[i] += shift * x[e->n + i];
}

/* ---- times --------------------------------------------------------------------------------- */

/* The states at times of the run up to theta, in the set that the scheme keeps. */
static int make_times(dal_events *e, dal_run *run, double theta)
{
    const double end = dal__time_at(e, theta), direction = e->h > 0.0 ? 1.0 : -1.0;
    for (; e->times_done < run->time_count; e->times_done++) {
        const double t = run->times[e->times_done];
        const double near = theta == 1.0 ? 4.0 * DAL_ROUNDOFF * fmax(fabs(t), fabs(end)) : 0.0;
        if (direction * (t - end) > near) break;
        const double at = direction * (end - t) <= near ? theta : fmax((t - e->t) / e->h, e->from);
        const int status = dal__reach(e, at, e->x);
        if (status) return status;
        e->unscaled += e->lost;
        move(e, e->shift, e->x, run->x_at_times + e->times_done * 2 * e->n);
    }
    return DAL_SUCCESS;
}

/* ---- laws ---------------------------------------------------------------------------------- */

int dal_law_control(size_t step, double t, const double *x, double *u, void *law)
{
    const dal_law *const self = law;
    const int returned = self->values(t, x, u, self->ctx);
    (void)step;
    if (returned > 0) dal__forget(self->count, u);
    return returned < 0 ? returned : 0;
}

int dal_law_reset(double t, double *x, void *law)
{
    const dal_law *const self = law;
    const int returned = self->values(t, x, self->scratch, self->ctx);
    if (!returned) memcpy(x, self->scratch, self->count * sizeof *x);
    return returned;
}

/* ---- resets -------------------------------------------------------------------------------- */

/* The impulse of the way to theta, where reach has just been. */
static void add_impulse(dal_events *e, double theta)
{
    const double *const impulse = theta == 1.0 ? e->whole : e->probe->motion.impulse;
    for (size_t a = 0; a < e->m; a++) e->parts[a] += impulse[a];
}

/* x[2n] <- what the reset makes of it. */
static int reset(dal_events *e, const crossing *c, double *x)
{
    const dal_event *const one = &e->list[c->event];
    dal_stepper *const probe = e->probe;
    const double t = dal__time_at(e, c->theta);
    const int returned = one->reset(t, x, one->reset_ctx);
    if (returned)
        return dal__fail(e->error, dal__callback_status(returned), "the reset of event %zu "
                         "returned %d at t = %g", c->event, returned, t);
    const int status =
        dal_stepper_start(probe, t, e->h, x, one->consistency, DAL_INITIAL_NONE);
    if (!status) memcpy(x, probe->motion.x, 2 * e->n * sizeof *x);
    e->energy = probe->scaling.energy;
    return dal__fail_because(e->error, status, &probe->error, "after the reset of event %zu at t = "
                             "%g: ", c->event, t);
}

/* The side of a guard whose reset has led to g = begin, where it was at and moved with a rate. */
static int leave(dal_events *e, size_t event, double at, double rate)
{
    guard *const g = &e->guards[event];
    double after;
    g->side = dal__sign(g->begin);
    g->crossed = false;
    g->waits = fabs(g->begin) <= fmax(dal__event_rounding(g), 8.0 * fabs(at));
    if (!g->waits) return DAL_SUCCESS;
    const int status = dal__event_rate(e, event, e->from, e->begin, g->begin, 1.0, &after);
    if (status) return status;
    if (fabs(after) <= AT_REST * fabs(rate))
        return dal__event_rests(e, event, "rate of g: %g", after / e->h);
    g->side = dal__sign(after);
    return DAL_SUCCESS;
}

/* The side of another guard after a reset.  At zero, where it crosses at the same time, or is on a
 * way of its own from there; or, as one that has crossed before, on neither side. */
static void pass(guard *g)
{
    const double rounding = fmax(dal__event_rounding(g), g->near);
    const bool small = fabs(g->begin) <= 1024.0 * rounding;
    if (g->due || (g->waits && small)) return;
    g->side = small && g->crossed ? 0 : dal__sign(g->begin);
    g->waits = g->crossed = false;
}

/* A step whose size varies ends at a reset: what follows has steps of its own. */
static void end_step(dal_run *run, double t)
{
    dal_motion *const motion = &run->stepper->motion;
    motion->t0 = t;
    motion->first = motion->steps;
}

/* The span from the event on; happening has the state before and after it.  A guard that has jumped
 * was not near zero. */
static int begin_anew(dal_events *e, const crossing *c, const happening *now, bool jumped)
{
    const double t = dal__time_at(e, c->theta);
    double rate = 0.0, at = 0.0;
    int status = jumped ? DAL_SUCCESS : dal__event_value(e, c->event, t, now->x, &at);
    if (!status && !jumped)
        status = dal__event_rate(e, c->event, c->theta, now->x, at, -1.0, &rate);
    if (status) return status;
    const bool is_rounding = fabs(rate) <= dal__event_rounding(&e->guards[c->event]);
    if (is_rounding && rate * c->to < 0.0) { /* it has crossed by a rounding */
        e->from = c->theta;
        return dal__event_rests(e, c->event, "rate of g: %g", rate / e->h);
    }

    memcpy(e->begin, now->after, 2 * e->n * sizeof *e->begin);
    memcpy(e->x, now->after, 2 * e->n * sizeof *e->x);
    const double end = dal__time_at(e, 1.0);
    e->probe->motion.kept = e->stepper->motion.kept; /* from here on the motion is that of probe */
    status = dal__probe(e, t, end - t, e->x);
    e->probe->motion.kept = NULL;
    e->unscaled += e->lost;
    memcpy(e->end, e->x, 2 * e->n * sizeof *e->end);
    memcpy(e->whole, e->probe->motion.impulse, e->m * sizeof *e->whole);
    e->from = c->theta;
    e->landed = true;
    for (size_t i = 0; !status && i < e->count; i++) {
        guard *const g = &e->guards[i];
        status = dal__event_value(e, i, t, e->begin, &g->begin);
        if (!status && i != c->event) pass(g);
    }
    if (!status) status = leave(e, c->event, at, rate);
    for (size_t i = 0; !status && i < e->count; i++)
        status = dal__event_value(e, i, end, e->end, &e->guards[i].end);
    return status;
}

/* ---- a step -------------------------------------------------------------------------------- */

/* The state at an event, which resets and the end of the run then have. */
static int enter(dal_events *e, dal_run *run, const crossing *c, happening *now)
{
    const dal_event *const one = &e->list[c->event];
    guard *const g = &e->guards[c->event];
    int status = DAL_SUCCESS;
    g->happened++;
    run->ended = one->terminal > 0 && g->happened >= one->terminal;
    *now = (happening){.event = c->event, .t = dal__time_at(e, c->theta), .x = now->x,
                       .after = now->after, .reset = one->reset && !run->ended};
    if (now->reset || run->ended) status = make_times(e, run, c->theta);
    if (!status) status = dal__reach(e, c->theta, now->x);
    if (!status) e->unscaled += e->lost;
    if (status || (!now->reset && !run->ended)) return status;
    add_impulse(e, c->theta);
    run->t_end = now->t;
    memcpy(now->after, now->x, 2 * e->n * sizeof *now->x);
    return now->reset ? reset(e, c, now->after) : DAL_SUCCESS;
}

/* Room for one more thing that happens. */
static int make_room(dal_events *e)
{
    const size_t N = 2 * e->n, count = e->happenings;
    const bool is_full = count == e->room_happened;
    size_t room = e->room_happened;
    int status = dal__grow(&e->states, count, &room, 2 * N * sizeof *e->states, e->error);
    if (!status)
        status = dal__grow(&e->happened, count, &e->room_happened, sizeof *e->happened, e->error);
    for (size_t k = 0; !status && is_full && k < room; k++) {
        e->happened[k].x = e->states + 2 * N * k;
        e->happened[k].after = e->states + 2 * N * k + N;
    }
    return status;
}

/* How near to zero g is there: unless it jumps, by the rounding of the time. */
static void find_nearness(dal_events *e, size_t event, const happening *now)
{
    const dal_event *const one = &e->list[event];
    guard *const g = &e->guards[event];
    double at = (double)NAN;
    const bool is_known = one->g(now->t, now->x, &at, one->ctx) == 0 && isfinite(at);
    g->near = is_known ? fmin(fabs(at), NEAREST * g->size) : 0.0;
}

/* What happens at a crossing; *anew: in a span that begins there.  Those after it are [later]. */
static int happen(dal_events *e, dal_run *run, const crossing *c, size_t later, bool *anew)
{
    const int direction = dal__sign(e->list[c->event].direction);
    guard *const g = &e->guards[c->event];
    const bool jumped = *anew = g->jumped; /* it may cross again */
    g->side = c->to;
    g->waits = g->due = g->jumped = false;
    g->crossed = true;
    if (direction != 0 && direction != c->to) return DAL_SUCCESS;
    int status = make_room(e);
    if (status) return status;
    happening *const now = &e->happened[e->happenings++];
    status = enter(e, run, c, now);
    if (!status && e->along[c->event]) find_nearness(e, c->event, now);
    *anew |= now->reset;
    if (status || !now->reset) return status;
    if (e->resets++ == DAL_MOST_RESETS)
        return dal__fail(e->error, DAL_EZENO, "event %zu, t = %g: %d resets in one step of h = %g. "
                         "End the run before they accumulate with a terminal event, or take a "
                         "smaller h", c->event, now->t, (int)DAL_MOST_RESETS, e->h);
    if (!(fabs(now->t - e->rush_began) <= RUSH * DAL_ROUNDOFF * fabs(now->t))) {
        e->rush_began = now->t;
        e->rush = 0;
    } else if (++e->rush == DAL_MOST_RESETS) {
        return dal__fail(e->error, DAL_EZENO, "event %zu, t = %g: %d resets at times that doubles "
                         "hardly tell apart. End the run before they accumulate with a terminal "
                         "event", c->event, now->t, (int)DAL_MOST_RESETS);
    }
    for (size_t k = 1; k <= later && c[k].theta <= c->theta + TOGETHER; k++)
        if (c[k].event != c->event) e->guards[c[k].event].due = true;
    if (dal__run_varies(run)) end_step(run, now->t);
    return begin_anew(e, c, now, jumped);
}

/* The spans of a step that the stepper has made. */
static int look_into(dal_events *e, dal_run *run)
{
    bool anew = true;
    int status = DAL_SUCCESS;
    for (size_t i = 0; !status && i < e->count; i++)
        status = dal__event_value(e, i, dal__time_at(e, 1.0), e->end, &e->guards[i].end);
    while (!status && anew && !run->ended) {
        size_t found;
        anew = false;
        status = dal__find_crossings(e, &found);
        for (size_t k = 0; !status && !anew && !run->ended && k < found; k++) {
            status = happen(e, run, &e->crossings[k], found - k - 1, &anew);
        }
    }
    if (!status && !run->ended) status = make_times(e, run, 1.0);
    return status;
}

/* The velocity has jumped into the D of new inputs, and guards may have crossed zero with it. */
static int jump(dal_events *e, const dal_motion *motion)
{
    int status = DAL_SUCCESS;
    if (memcmp(e->begin, motion->x, 2 * e->n * sizeof *e->begin) == 0) return DAL_SUCCESS;
    memcpy(e->begin, motion->x, 2 * e->n * sizeof *e->begin); /* the nodes are moved ones */
    for (size_t i = 0; !status && i < e->count; i++) {
        guard *const g = &e->guards[i];
        status = dal__event_value(e, i, e->t, e->begin, &g->begin);
        g->jumped = !g->waits && dal__sign(g->begin) * g->side < 0;
    }
    return status;
}

/* The span is the step that comes, and the guards have values at its beginning. */
static int prepare(dal_events *e, dal_run *run)
{
    const dal_motion *const motion = &run->stepper->motion;
    const size_t N = 2 * e->n;
    const bool same = is_here(e);
    int status = DAL_SUCCESS;
    e->t = dal_stepper_time(run->stepper);
    e->h = motion->h;
    e->shift = run->stepper->shift * e->h;
    e->energy = run->stepper->scaling.energy;
    e->from = 0.0;
    e->times_done = run->times_done;
    e->happenings = e->resets = e->unscaled = 0;
    e->landed = false;
    e->watch.function = motion->watch;
    e->watch.ctx = motion->watch_ctx;
    memset(e->parts, 0, e->m * sizeof *e->parts);
    move(e, -e->shift, motion->x, e->begin);
    for (size_t i = 0; !status && !(same && e->valued) && i < e->count; i++) {
        guard *const g = &e->guards[i];
        double now;
        status = dal__event_value(e, i, e->t, e->begin, &now);
        if (!status && same && fabs(now - g->begin) > SAME * g->size)
            status = dal__fail(e->error, DAL_EINVAL, "event %zu: g = %g at t = %g, but it was %g "
                               "when saved; pass the events of the saved run", i, now, e->t,
                               g->begin);
        if (status || same) continue; /* the value that was saved has the bits of that run */
        *g = (guard){.side = dal__sign(now), .size = fabs(now), .begin = now};
    }
    if (!status) status = dal_stepper_input(e->probe, motion->input);
    if (!status && run->stepper->applied) {
        status = dal__stepper_enter_D(run->stepper);
        if (status) *e->error = run->stepper->error;
        else status = jump(e, motion);
    }
    if (status) return status;
    memcpy(e->last, motion->x, N * sizeof *e->last);
    e->step = motion->steps;
    e->known = e->valued = true;
    if (e->count > 0) memcpy(e->before, e->guards, e->count * sizeof *e->guards);
    e->doubts_before = e->doubts;
    memcpy(e->impulse, motion->impulse, e->m * sizeof *e->impulse);
    return dal_stepper_save(run->stepper, e->saved);
}

/* The stepper stands before the step again. */
static void take_back(dal_events *e, dal_run *run)
{
    dal_stepper_restore(run->stepper, e->saved, dal_stepper_saved(run->stepper));
    memcpy(run->stepper->motion.impulse, e->impulse, e->m * sizeof *e->impulse);
    if (e->count > 0) memcpy(e->guards, e->before, e->count * sizeof *e->guards);
    e->doubts = e->doubts_before;
    run->ended = 0;
}

/* The stepper stands after the step, which resets have changed. */
static int land(dal_events *e, dal_run *run)
{
    double *const impulse = run->stepper->motion.impulse;
    move(e, e->shift, e->end, e->x);
    for (size_t a = 0; a < e->m; a++) impulse[a] = e->impulse[a] + e->parts[a] + e->whole[a];
    return dal__stepper_land(run->stepper, e->x, e->energy);
}

/* The state in which the run ends, and the mean force since the last one that was stored. */
static void end_run(const dal_events *e, const dal_run *run, double *end, double *reaction)
{
    const size_t since = run->done - (run->stored - 1) * run->stride;
    const double elapsed = dal__run_varies(run) ? run->t_end - run->row_time
                                                    : (double)since * e->h + (run->t_end - e->t);
    move(e, e->shift, e->happened[e->happenings - 1].x, end);
    for (size_t a = 0; reaction && a < e->m; a++)
        reaction[a] = run->stepper->family->no_reaction || elapsed == 0.0
                          ? (double)NAN : (e->impulse[a] + e->parts[a]) / elapsed;
}

/* The rest of a step that went well: what it leaves to the run and to the next one. */
static void conclude(dal_events *e, dal_run *run, double *end, double *reaction)
{
    if (run->ended) {
        end_run(e, run, end, reaction);
        take_back(e, run);
        run->ended = 1;
    } else {
        settle(e);
        memcpy(e->last, run->stepper->motion.x, 2 * e->n * sizeof *e->last);
        e->step++;
    }
    run->times_done = e->times_done;
}

int dal__events_step(dal_run *run, double *end, double *reaction, size_t *made)
{
    dal_events *const e = run->events;
    dal_stepper *const stepper = run->stepper;
    dal_error error = {0};
    *made = 0;
    e->error = &error;
    int status = prepare(e, run);
    if (!status) {
        status = dal__stepper_advance(stepper, 1, made);
        if (status) error = stepper->error;
        e->h = stepper->motion.h;
    }
    if (!status) {
        move(e, -e->shift, stepper->motion.x, e->end);
        for (size_t a = 0; a < e->m; a++)
            e->whole[a] = stepper->motion.impulse[a] - e->impulse[a];
        status = look_into(e, run);
    }
    if (!status && e->landed && !run->ended) {
        status = land(e, run);
        if (status) error = stepper->error;
    }
    if (!status) {
        conclude(e, run, end, reaction);
        stepper->motion.stats->unscaled += e->unscaled;
        *made = !run->ended;
        return DAL_SUCCESS;
    }
    if (*made > 0) take_back(e, run);
    *made = 0;
    stepper->error = error;
    return status;
}

void dal__events_no_steps(dal_run *run)
{
    const size_t N = 2 * run->stepper->mech.n;
    for (; run->times_done < run->time_count; run->times_done++)
        dal__copy(N, run->stepper->motion.x, run->x_at_times + run->times_done * N);
}

int dal__events_check(const dal_run *run)
{
    dal_error *const error = &run->stepper->error;
    const dal_motion *const motion = &run->stepper->motion;
    if (!run->events && (run->times || run->happened))
        return dal__fail(error, DAL_EINVAL, "%s is not NULL, but events is NULL; create it with "
                         "dal_events_new", run->times ? "times" : "happened");
    if (!run->events) return DAL_SUCCESS;
    if (run->events->stepper != run->stepper)
        return dal__fail(error, DAL_EINVAL, "events belongs to another stepper: expected the "
                         "stepper of the run");
    if (run->time_count == 0 || run->done > 0) return DAL_SUCCESS;
    if (!run->times || !run->x_at_times)
        return dal__fail(error, DAL_EINVAL, "%s is NULL", run->times ? "x_at_times" : "times");
    const double begin = dal_stepper_time(run->stepper), direction = motion->h > 0.0 ? 1.0 : -1.0;
    const double end = dal__run_varies(run)
        ? run->until : motion->t0 + (double)(motion->steps + run->steps) * motion->h;
    double before = begin;
    for (size_t k = 0; k < run->time_count; k++) {
        const double t = run->times[k];
        const double last = end + direction * 4.0 * DAL_ROUNDOFF * fabs(end);
        if (!(direction * (t - before) >= 0.0 && direction * (last - t) >= 0.0))
            return dal__fail(error, DAL_EINVAL, "times[%zu] = %.17g: expected times from %.17g to "
                             "%.17g, in this order", k, t, begin, end);
        before = t;
    }
    return DAL_SUCCESS;
}
