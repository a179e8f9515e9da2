/* Many runs, one after the other, by a stepper that is started anew for each. */
#include "dalembert/ensemble.h"
#include "run/events.h"
#include "run/run.h"

#include <math.h>
#include <string.h>

/* What makes the members of a range. */
typedef struct worker {
    const dal_members *members;
    const dal_system *system; /* of the member: own, if there are parameters */
    dal_system *own;
    dal_stepper *stepper;
    dal_mechanics *mech;      /* what measures the states; NULL where nothing is measured */
    dal_events *events;       /* or NULL */
    size_t member, rows, reactions; /* of each member */
    dal_run run;              /* of the member */
    int refused;              /* what measuring it has failed with */
    size_t piece;             /* steps between two looks at the clock */
    dal__watch watch;
    int stopped;              /* DAL_STOPPED or DAL_EUSER: by the watch */
    arena arena;
} worker;

/* Row `member` of what is given for all of them. */
#define ROW_OF(members, what, member) ((members)->what + (member) * (members)->what##_next)

/* ---- arguments ----------------------------------------------------------------------------- */

static int check_members(const dal_system *system, const dal_members *members, size_t first,
                         size_t count, dal_error *error)
{
    int status = DAL__REQUIRE(error, {"members.h", members->h}, {"members.steps", members->steps},
                              {"members.events", members->events || members->event_count == 0});
    if (status) return status;
    if (first > members->count || count > members->count - first)
        return dal__fail(error, DAL_EINVAL, "first = %zu and count = %zu: there are %zu members",
                         first, count, members->count);
    if (members->parameters && dal_system_parameter_size(system) == 0)
        return dal__fail(error, DAL_EINVAL, "members.parameters is not NULL, and the system has "
                         "none that could be changed");
    if (members->inputs && system->def.inputs == 0)
        return dal__fail(error, DAL_EINVAL, "members.inputs is not NULL, but the system has none");
    if (!members->x && !system->def.state)
        return dal__fail(error, DAL_EINVAL, "members.x is NULL, and the system has no initial data "
                         "by default");
    if (members->stride > 0 && members->steps_next > 0)
        return dal__fail(error, DAL_EINVAL, "members.steps_next = %zu with stride = %zu: expected "
                         "the same number of steps for all, or stride = 0", members->steps_next,
                         members->stride);
    if (members->stride > 0 && *members->steps % members->stride > 0)
        return dal__fail(error, DAL_EINVAL, "members.steps = %zu is not a multiple of stride = %zu",
                         *members->steps, members->stride);
    return DAL_SUCCESS;
}

/* ---- results ------------------------------------------------------------------------------- */

/* NaN for rows of a result of one member, where it is wanted. */
static void forget(double *result, size_t member, size_t size)
{
    if (result) dal__forget(size, result + member * size);
}

static void forget_results(const worker *self)
{
    const dal_members *const members = self->members;
    const size_t n = self->system->def.n, m = self->system->def.m, k = self->member;
    forget(members->states, k, self->rows * 2 * n);
    forget(members->energy, k, self->rows);
    forget(members->residual, k, self->rows);
    forget(members->multipliers, k, self->rows * m);
    forget(members->reactions, k, self->reactions * m);
    forget(members->t_end, k, 1);
    if (members->stats) members->stats[k] = (dal_stats){0};
    if (members->done) members->done[k] = 0;
    if (members->ended_by) members->ended_by[k] = members->event_count;
    if (members->doubts) members->doubts[k] = 0;
    for (size_t i = 0; members->happened && i < members->event_count; i++)
        members->happened[k * members->event_count + i] = 0;
}

/* Energy, residual and multipliers of a row, whose state x[2n] is that after so many steps. */
static void measure(worker *self, size_t row, size_t step, double t, const double *x)
{
    const dal_members *const members = self->members;
    const dal_run *const run = &self->run;
    const size_t m = self->system->def.m, width = self->system->def.inputs;
    const size_t at = self->member * self->rows + row, hold = dal__hold(run);
    double *const energy = members->energy, *const residual = members->residual;
    double *const multipliers = members->multipliers;
    const double *u = run->inputs;
    if (!self->mech) return;
    if (u) u += (step < run->steps || step == 0 ? step : step - 1) / hold * width;
    const double shift = self->stepper->shift * self->stepper->motion.h;
    self->refused = dal__trajectory(self->mech, t, 0.0, 0, shift, 1, x, u,
                                    energy ? energy + at : NULL,
                                    multipliers ? multipliers + at * m : NULL, NULL,
                                    residual ? residual + at : NULL, NULL);
}

/* A dal_observer_fn: the row that was stored last, at its time as that of a trajectory. */
static int observe(size_t step, double t, const double *x, void *ctx)
{
    worker *const self = ctx;
    const dal_motion *const motion = &self->stepper->motion;
    const size_t row = self->run.stored - 1;
    (void)t;
    measure(self, row, step, motion->t0 + (double)row * ((double)self->run.stride * motion->h), x);
    return self->refused ? -1 : 0;
}

/* How often each event has happened: guards do not know of the step in which a member ended. */
static void count_events(const worker *self, size_t *happened)
{
    const dal_events *const e = self->events;
    for (size_t i = 0; i < self->members->event_count; i++) happened[i] = e->guards[i].happened;
    for (size_t j = 0; self->run.ended && j < e->happenings; j++) happened[e->happened[j].event]++;
}

/* What is known when the member is over. */
static void conclude(worker *self)
{
    const dal_members *const members = self->members;
    const dal_run *const run = &self->run;
    const size_t N = 2 * self->system->def.n, k = self->member, last = run->stored - 1;
    const double t = run->ended ? run->t_end : dal_stepper_time(self->stepper);
    const bool is_over = run->ended || run->done == run->steps;
    const double *const x = !run->ended ? self->stepper->motion.x
                          : run->x ? run->x + last * N : self->stepper->fresh;
    if (members->t_end) members->t_end[k] = t;
    if (members->done) members->done[k] = run->done;
    if (members->stats) dal_stepper_stats(self->stepper, &members->stats[k]);
    if (members->happened) count_events(self, members->happened + k * members->event_count);
    if (members->doubts && self->events)
        members->doubts[k] = dal_events_doubts(self->events, NULL, NULL, NULL);
    if (run->ended && members->ended_by)
        members->ended_by[k] = self->events->happened[self->events->happenings - 1].event;
    if (members->stride == 0 && is_over && members->states)
        memcpy(members->states + k * N, x, N * sizeof *x);
    if (!self->refused && (run->ended || (members->stride == 0 && is_over)))
        measure(self, run->ended ? last * (members->stride > 0) : 0, run->done, t, x);
}

/* ---- a member ------------------------------------------------------------------------------ */

/* The stepper at the beginning of the member, as if it were new. */
static int begin(worker *self)
{
    const dal_members *const members = self->members;
    dal_stepper *const stepper = self->stepper;
    const size_t k = self->member;
    int status = DAL_SUCCESS;
    if (self->own)
        status = dal__system_change(self->own, (const char *)members->parameters
                                               + k * members->parameters_next, &stepper->error);
    if (status) return status;
    dal__clear(self->system->def.inputs, stepper->mech.eval.own_input);
    if (self->events) dal__events_forget(self->events);
    return dal_stepper_start(stepper, members->t0, *ROW_OF(members, h, k),
                             members->x ? ROW_OF(members, x, k) : self->system->def.state,
                             members->consistency, members->initial);
}

/* A dal_watch_fn of what takes long within a step. */
static int relay(double far, void *ctx)
{
    worker *const self = ctx;
    const int returned = dal__relay(far, &self->watch);
    if (returned) self->stopped = dal__heed(&self->run, "watch", returned);
    return returned;
}

static void prepare_run(worker *self)
{
    const dal_members *const members = self->members;
    const size_t n = self->system->def.n, m = self->system->def.m, k = self->member;
    const size_t steps = *ROW_OF(members, steps, k), stride = members->stride;
    dal_run *const run = &self->run;
    *run = (dal_run){.stepper = self->stepper, .steps = steps, .events = self->events,
                     .stride = stride > 0 ? stride : steps > 0 ? steps : 1,
                     .hold = members->hold, .watch = self->watch.function ? relay : NULL,
                     .watch_ctx = self};
    if (members->inputs) run->inputs = (double *)ROW_OF(members, inputs, k); /* which are read */
    if (members->reactions) run->reactions = members->reactions + k * self->reactions * m;
    if (stride > 0 && members->states) run->x = members->states + k * self->rows * 2 * n;
    if (stride > 0 && self->mech) {
        run->observer = observe;
        run->observer_ctx = self;
    }
}

/* Whether the watch wants to stop, which is asked some twenty times a second. */
static void ask(worker *self, size_t first, double began)
{
    const dal_run *const run = &self->run;
    const double part = run->steps > 0 ? (double)run->done / (double)run->steps : 1.0;
    const bool soon = dal__clock() - began < DAL_WATCH_SECONDS / 4.0;
    if (soon && self->piece < SIZE_MAX / 2) self->piece *= 2;
    else if (!soon && self->piece > 1) self->piece /= 2;
    self->watch.made = (double)(self->member - first) + part;
    self->stopped = dal__ask(&self->watch, self->watch.made, &self->stepper->error);
}

static int make_member(worker *self, size_t first)
{
    const bool watched = self->watch.function;
    dal_run *const run = &self->run;
    forget_results(self);
    self->refused = DAL_SUCCESS;
    int status = begin(self);
    if (status) return status;
    prepare_run(self);
    do {
        const double began = watched ? dal__clock() : 0.0;
        status = dal_run_go(run, watched ? self->piece : SIZE_MAX);
        if (watched && !status && !self->stopped) ask(self, first, began);
    } while (!status && !self->stopped && run->done < run->steps);
    if (run->ended) status = DAL_SUCCESS;
    else if (self->stopped && run->done < run->steps) status = DAL_STOPPED;
    conclude(self);
    if (!self->refused) return status;
    self->stepper->error = self->mech->error;
    return self->refused;
}

static void make_range(worker *self, size_t first, size_t count)
{
    const dal_members *const members = self->members;
    for (self->member = first; self->member < first + count; self->member++) {
        int status = DAL_STOPPED;
        if (self->stopped) forget_results(self);
        else status = make_member(self, first);
        if (members->status) members->status[self->member] = status;
        dal_error *const error = members->errors ? &members->errors[self->member] : NULL;
        if (error && status < 0) *error = self->stepper->error;
        else if (error) error->status = DAL_SUCCESS, error->text[0] = '\0';
    }
}

/* ---- the worker ---------------------------------------------------------------------------- */

static void dismiss(worker *self)
{
    dal_events_free(self->events);
    dal_mechanics_free(self->mech);
    dal_stepper_free(self->stepper);
    dal_system_free(self->own);
    dal__release(&self->arena);
}

/* The events, with the ctx of the system where they have none of their own. */
static int make_events(worker *self, const dal_scheme *scheme, dal_event *list, dal_error *error)
{
    const dal_members *const members = self->members;
    for (size_t i = 0; i < members->event_count; i++) {
        list[i] = members->events[i];
        if (!list[i].ctx) list[i].ctx = self->system->def.ctx;
    }
    return dal_events_new(&self->events, self->stepper, scheme, list, members->event_count, error);
}

static int hire(worker *self, const dal_system *system, const dal_scheme *scheme,
                const dal_options *options, dal_error *error)
{
    const dal_members *const members = self->members;
    dal_event *list;
    dal__reserve(&self->arena, &list, members->event_count, sizeof *list);
    int status = dal__allocate(&self->arena, error);
    self->system = system;
    if (!status && members->parameters) {
        status = dal__system_copy(&self->own, system, error);
        self->system = self->own;
    }
    if (!status) status = dal_stepper_new(&self->stepper, self->system, scheme, options, error);
    if (!status && (members->energy || members->residual || members->multipliers))
        status = dal_mechanics_new(&self->mech, self->system, error);
    if (!status && members->event_count > 0) status = make_events(self, scheme, list, error);
    return status;
}

int dal_ensemble_run(const dal_system *system, const dal_scheme *scheme, const dal_options *options,
                     const dal_members *members, size_t first, size_t count, dal_watch_fn watch,
                     void *ctx, dal_error *error)
{
    int status =
        DAL__REQUIRE(error, {"system", system}, {"scheme", scheme}, {"members", members});
    if (!status) status = check_members(system, members, first, count, error);
    if (status) return status;
    const size_t stride = members->stride, rows = stride > 0 ? *members->steps / stride + 1 : 1;
    worker self = {.members = members, .rows = rows, .reactions = stride > 0 ? rows - 1 : 1,
                   .piece = 1, .watch = {.function = watch, .ctx = ctx}};
    status = hire(&self, system, scheme, options, error);
    if (!status) make_range(&self, first, count);
    if (self.stopped) status = dal__fail(error, self.stopped, "%s", self.stepper->error.text);
    dismiss(&self);
    return status;
}
