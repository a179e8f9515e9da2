/* A member of an ensemble: its run from start to end, and its results. */
#include "run/member.h"

#include "run/events.h"

#include <string.h>

/* ---- results ------------------------------------------------------------------------------- */

/* NaN for rows of a result of one member, where it is wanted. */
static void forget(double *result, size_t member, size_t size)
{
    if (result) dal__forget(size, result + member * size);
}

static void forget_results(const dal__worker *self)
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

/* Energy, residual and multipliers of a row, whose state x[2n] is that after so many steps.  What
 * is not finite there, or not defined, stays NaN. */
static void measure(dal__worker *self, size_t row, size_t step, double t, const double *x)
{
    const dal_members *const members = self->members;
    const dal_run *const run = &self->run;
    const size_t m = self->system->def.m, width = self->system->def.inputs;
    const size_t at = self->member * self->rows + row, input_steps = dal__input_steps(run);
    double *const energy = members->energy, *const residual = members->residual;
    double *const multipliers = members->multipliers;
    double *u = run->inputs;
    if (!self->mech) return;
    /* of constraints that depend on inputs those that the state lies in the D of */
    const bool driven = self->system->def.driven;
    const bool before = dal__run_is_over(run) || (driven && !run->ended);
    const bool varies = dal__run_varies(run);
    const bool begins = !before && !varies && step % input_steps == 0;
    if (u && varies) u += (run->rows_set > 0 ? run->rows_set - 1 : 0) * width;
    else if (u) u += (before && step > 0 ? step - 1 : step) / input_steps * width;
    if (members->control && multipliers && begins && !driven)
        dal_law_control(step, t, x, u, &self->control); /* as the run will at once */
    const double shift = self->stepper->shift * self->stepper->motion.h;
    if (energy) dal__trajectory(self->mech, t, 0.0, 0, shift, 1, x, u, energy + at, NULL, NULL,
                                NULL, NULL);
    if (residual) dal__trajectory(self->mech, t, 0.0, 0, shift, 1, x, u, NULL, NULL, NULL,
                                  residual + at, NULL);
    if (multipliers) dal__trajectory(self->mech, t, 0.0, 0, shift, 1, x, u, NULL,
                                     multipliers + at * m, NULL, NULL, NULL);
}

/* A dal_observer_fn: the row that was stored last, at its time as that of a trajectory. */
static int observe(size_t step, double t, const double *x, void *ctx)
{
    dal__worker *const self = ctx;
    const dal_motion *const motion = &self->stepper->motion;
    const size_t row = self->run.stored - 1;
    (void)t;
    measure(self, row, step, motion->t0 + (double)row * ((double)self->run.stride * motion->h), x);
    return 0;
}

/* How often each event has happened: guards do not know of the step in which a member ended. */
static void count_events(const dal__worker *self, size_t *happened)
{
    const dal_events *const e = self->events;
    for (size_t i = 0; i < self->members->event_count; i++) happened[i] = e->guards[i].happened;
    for (size_t j = 0; self->run.ended && j < e->happenings; j++) happened[e->happened[j].event]++;
}

/* Stores the results that a member has at its end. */
static void conclude(dal__worker *self)
{
    const dal_members *const members = self->members;
    const dal_run *const run = &self->run;
    const size_t N = 2 * self->system->def.n, k = self->member, last = run->stored - 1;
    const double t = run->ended ? run->t_end : dal_stepper_time(self->stepper);
    const bool is_over = run->ended || dal__run_is_over(run);
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
    if (run->ended || (members->stride == 0 && is_over))
        measure(self, run->ended ? last * (members->stride > 0) : 0, run->done, t, x);
}

/* ---- a member ------------------------------------------------------------------------------ */

static const double *initial_state(const dal__worker *self)
{
    const dal_members *const members = self->members;
    return members->x ? ROW_OF(members, x, self->member) : self->system->def.state;
}

int dal__member_bind(dal__worker *self)
{
    const dal_members *const members = self->members;
    const char *const all = members->parameters;
    return dal__system_change(self->own, all + self->member * members->parameters_next,
                              &self->stepper->error);
}

/* Set the first inputs before the start: if constraints depend on inputs, the initial data must lie
 * in D for these. */
static int first_inputs(dal__worker *self)
{
    const dal_members *const members = self->members;
    dal_stepper *const stepper = self->stepper;
    const double *const x = initial_state(self);
    if (members->inputs) return dal_stepper_input(stepper, ROW_OF(members, inputs, self->member));
    if (!members->control || !x) return DAL_SUCCESS;
    const int returned = dal_law_control(0, members->t0, x, self->inputs, &self->control);
    if (returned)
        return dal__fail(&stepper->error, DAL_EUSER, "control returned %d at the start", returned);
    return dal_stepper_input(stepper, self->inputs);
}

/* The stepper at the beginning of the member, as if it were new. */
static int begin(dal__worker *self)
{
    const dal_members *const members = self->members;
    dal_stepper *const stepper = self->stepper;
    const size_t k = self->member;
    int status = self->own ? dal__member_bind(self) : DAL_SUCCESS;
    if (status) return status;
    dal__clear(self->system->def.inputs, stepper->mech.eval.own_input);
    if (self->system->def.driven) status = first_inputs(self);
    if (status) return status;
    if (self->events) dal__events_forget(self->events);
    return dal_stepper_start(stepper, members->t0, *ROW_OF(members, h, k),
                             initial_state(self), members->consistency, members->initial);
}

/* A dal_watch_fn of what takes long within a step. */
static int relay(double far, void *ctx)
{
    dal__worker *const self = ctx;
    if (self->stopped) return self->stopped == DAL_STOPPED ? 1 : -1; /* another member was told */
    const int returned = dal__relay(far, &self->watch);
    if (returned) self->stopped = dal__run_callback_status(&self->run, "watch", returned);
    return returned;
}

static void prepare_run(dal__worker *self)
{
    const dal_members *const members = self->members;
    const size_t n = self->system->def.n, m = self->system->def.m, k = self->member;
    const size_t steps = *ROW_OF(members, steps, k), stride = members->stride;
    dal_run *const run = &self->run;
    *run = (dal_run){.stepper = self->stepper, .steps = steps, .events = self->events,
                     .stride = stride > 0 ? stride : steps > 0 ? steps : 1,
                     .input_steps = members->input_steps, .until = members->until,
                     .input_duration = members->input_duration, .unchecked = 1,
                     .watch = self->watch.function ? relay : NULL, .watch_ctx = self};
    if (members->inputs) run->inputs = (double *)ROW_OF(members, inputs, k); /* which are read */
    if (members->control) {
        run->inputs = self->inputs;
        run->control = dal_law_control;
        run->control_ctx = &self->control;
        run->rows_set = self->system->def.driven != NULL; /* see first_inputs */
    }
    if (members->reactions) run->reactions = members->reactions + k * self->reactions * m;
    if (stride > 0 && members->states) run->x = members->states + k * self->rows * 2 * n;
    if (stride > 0 && self->mech) {
        run->observer = observe;
        run->observer_ctx = self;
    }
}

void dal__worker_poll(dal__worker *self, double done, double began)
{
    const bool soon = dal__clock() - began < DAL_WATCH_SECONDS / 4.0;
    if (soon && self->piece < SIZE_MAX / 2) self->piece *= 2;
    else if (!soon && self->piece > 1) self->piece /= 2;
    self->watch.made = done;
    self->stopped = dal__ask(&self->watch, self->watch.made, &self->stepper->error);
}

int dal__member_finish(dal__worker *self, int status)
{
    const dal_run *const run = &self->run;
    if (run->ended) status = DAL_SUCCESS;
    else if (self->stopped && !dal__run_is_over(run)) status = DAL_STOPPED;
    conclude(self);
    return status;
}

/* Part of the run that is made. */
static double part_of(const dal_run *run)
{
    if (dal__run_is_over(run)) return 1.0;
    if (!dal__run_varies(run)) return (double)run->done / (double)run->steps;
    return (dal_stepper_time(run->stepper) - run->t_begin) / (run->until - run->t_begin);
}

int dal__member_complete(dal__worker *self)
{
    dal_run *const run = &self->run;
    const bool watched = self->watch.function;
    int status = DAL_SUCCESS;
    do {
        const double began = watched ? dal__clock() : 0.0;
        status = dal_run_go(run, self->stopped ? 0 : watched ? self->piece : SIZE_MAX);
        if (watched && !status && !self->stopped)
            dal__worker_poll(self, (double)(self->member - self->first) + part_of(run), began);
    } while (!status && !self->stopped && !dal__run_is_over(run));
    return dal__member_finish(self, status);
}

void dal__member_report(const dal__worker *self, int status)
{
    const dal_members *const members = self->members;
    if (members->status) members->status[self->member] = status;
    dal_error *const error = members->errors ? &members->errors[self->member] : NULL;
    if (error && status < 0) *error = self->stepper->error;
    else if (error) error->status = DAL_SUCCESS, error->text[0] = '\0';
}

int dal__member_open(dal__worker *self)
{
    forget_results(self);
    if (self->stopped) return DAL_STOPPED;
    const int status = begin(self);
    if (!status) prepare_run(self);
    return status;
}
