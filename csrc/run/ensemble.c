/* Many runs, one after the other, by a stepper that is started anew for each. */
#include "dalembert/ensemble.h"
#include "run/events.h"
#include "run/run.h"
#include "step/lanes.h"

#include <math.h>
#include <string.h>

/* A member in a lane. */
typedef struct lane {
    bool goes;
    size_t expected; /* steps that it has made, if it has not stopped */
    dal_run run;
} lane;

/* What makes the members of a range. */
typedef struct worker {
    const dal_members *members;
    const dal_system *system; /* of the member: own, if there are parameters */
    dal_system *own;
    dal_stepper *stepper;
    dal_mechanics *mech;      /* what measures the states; NULL where nothing is measured */
    dal_events *events;       /* or NULL */
    dal_law *laws;            /* [events] of their resets */
    dal_law control;
    double *inputs;           /* [holds*inputs] that the control has written */
    dal__lanes *lanes;        /* or NULL, and */
    size_t width;             /* how many there are */
    lane *lane;               /* [width] */
    size_t member, rows, reactions; /* of each member */
    dal_run run;              /* of the member */
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
        return dal__fail(error, DAL_EINVAL, "first = %zu, count = %zu: expected a range within the "
                         "%zu members", first, count, members->count);
    if (members->parameters && dal_system_parameter_size(system) == 0)
        return dal__fail(error, DAL_EINVAL, "members.parameters is not NULL, but the system has no "
                         "parameters that can be changed; pass NULL");
    if ((members->inputs || members->control) && system->def.inputs == 0)
        return dal__fail(error, DAL_EINVAL, "members.%s is not NULL, but the system has no inputs; "
                         "pass NULL", members->inputs ? "inputs" : "control");
    if (members->inputs && members->control)
        return dal__fail(error, DAL_EINVAL, "members.inputs and members.control are both given: "
                         "expected one of them");
    if (!members->x && !system->def.state)
        return dal__fail(error, DAL_EINVAL, "members.x is NULL, but the system has no default "
                         "initial data");
    if (members->stride > 0 && members->steps_next > 0)
        return dal__fail(error, DAL_EINVAL, "members.steps_next = %zu with stride = %zu: expected "
                         "the same number of steps for all, or stride = 0", members->steps_next,
                         members->stride);
    if (members->stride > 0 && *members->steps % members->stride > 0)
        return dal__fail(error, DAL_EINVAL, "members.steps = %zu: expected a multiple of stride = "
                         "%zu", *members->steps, members->stride);
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

/* Energy, residual and multipliers of a row, whose state x[2n] is that after so many steps.  What
 * is not finite there, or not defined, stays NaN. */
static void measure(worker *self, size_t row, size_t step, double t, const double *x)
{
    const dal_members *const members = self->members;
    const dal_run *const run = &self->run;
    const size_t m = self->system->def.m, width = self->system->def.inputs;
    const size_t at = self->member * self->rows + row, hold = dal__hold(run);
    double *const energy = members->energy, *const residual = members->residual;
    double *const multipliers = members->multipliers;
    double *u = run->inputs;
    if (!self->mech) return;
    /* of constraints that depend on inputs those that the state lies in the D of */
    const bool driven = self->system->def.driven;
    const bool before = step == run->steps || (driven && !run->ended);
    if (u) u += (before && step > 0 ? step - 1 : step) / hold * width;
    if (members->control && multipliers && !before && !driven && step % hold == 0)
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
    worker *const self = ctx;
    const dal_motion *const motion = &self->stepper->motion;
    const size_t row = self->run.stored - 1;
    (void)t;
    measure(self, row, step, motion->t0 + (double)row * ((double)self->run.stride * motion->h), x);
    return 0;
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
    if (run->ended || (members->stride == 0 && is_over))
        measure(self, run->ended ? last * (members->stride > 0) : 0, run->done, t, x);
}

/* ---- a member ------------------------------------------------------------------------------ */

static const double *initial_state(const worker *self)
{
    const dal_members *const members = self->members;
    return members->x ? ROW_OF(members, x, self->member) : self->system->def.state;
}

static int bind_parameters(worker *self)
{
    const dal_members *const members = self->members;
    const char *const all = members->parameters;
    return dal__system_change(self->own, all + self->member * members->parameters_next,
                              &self->stepper->error);
}

/* Set the first inputs before the start: if constraints depend on inputs, the initial data must lie
 * in D for these. */
static int first_inputs(worker *self)
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
static int begin(worker *self)
{
    const dal_members *const members = self->members;
    dal_stepper *const stepper = self->stepper;
    const size_t k = self->member;
    int status = self->own ? bind_parameters(self) : DAL_SUCCESS;
    if (status) return status;
    dal__clear(self->system->def.inputs, stepper->mech.eval.own_input);
    if (self->system->def.driven) status = first_inputs(self);
    if (status) return status;
    if (self->events) dal__events_forget(self->events);
    return dal_stepper_start(stepper, members->t0, *ROW_OF(members, h, k),
                             initial_state(self),
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
                     .hold = members->hold, .unchecked = 1,
                     .watch = self->watch.function ? relay : NULL,
                     .watch_ctx = self};
    if (members->inputs) run->inputs = (double *)ROW_OF(members, inputs, k); /* which are read */
    if (members->control) {
        run->inputs = self->inputs;
        run->control = dal_law_control;
        run->control_ctx = &self->control;
        run->handed = self->system->def.driven != NULL; /* see first_inputs */
    }
    if (members->reactions) run->reactions = members->reactions + k * self->reactions * m;
    if (stride > 0 && members->states) run->x = members->states + k * self->rows * 2 * n;
    if (stride > 0 && self->mech) {
        run->observer = observe;
        run->observer_ctx = self;
    }
}

/* Whether the watch wants to stop, which is asked some twenty times a second.  far: how many
 * members are done. */
static void ask(worker *self, double far, double began)
{
    const bool soon = dal__clock() - began < DAL_WATCH_SECONDS / 4.0;
    if (soon && self->piece < SIZE_MAX / 2) self->piece *= 2;
    else if (!soon && self->piece > 1) self->piece /= 2;
    self->watch.made = far;
    self->stopped = dal__ask(&self->watch, self->watch.made, &self->stepper->error);
}

/* The member is over, or cannot go on: what it has failed with, if it has. */
static int finish(worker *self, int status)
{
    const dal_run *const run = &self->run;
    if (run->ended) status = DAL_SUCCESS;
    else if (self->stopped && run->done < run->steps) status = DAL_STOPPED;
    conclude(self);
    return status;
}

/* Part of the steps that are made. */
static double part_of(const dal_run *run)
{
    return run->steps > 0 ? (double)run->done / (double)run->steps : 1.0;
}

/* The rest of a member, from where its run is. */
static int go_on(worker *self, size_t first)
{
    dal_run *const run = &self->run;
    const bool watched = self->watch.function;
    int status = DAL_SUCCESS;
    do {
        const double began = watched ? dal__clock() : 0.0;
        status = dal_run_go(run, self->stopped ? 0 : watched ? self->piece : SIZE_MAX);
        if (watched && !status && !self->stopped)
            ask(self, (double)(self->member - first) + part_of(run), began);
    } while (!status && !self->stopped && run->done < run->steps);
    return finish(self, status);
}

/* What has become of a member. */
static void tell(const worker *self, int status)
{
    const dal_members *const members = self->members;
    if (members->status) members->status[self->member] = status;
    dal_error *const error = members->errors ? &members->errors[self->member] : NULL;
    if (error && status < 0) *error = self->stepper->error;
    else if (error) error->status = DAL_SUCCESS, error->text[0] = '\0';
}

/* The member at its beginning, with its run; else what is the matter with it. */
static int open_member(worker *self)
{
    forget_results(self);
    if (self->stopped) return DAL_STOPPED;
    const int status = begin(self);
    if (!status) prepare_run(self);
    return status;
}

static void make_range(worker *self, size_t first, size_t count)
{
    for (self->member = first; self->member < first + count; self->member++) {
        const int status = open_member(self);
        tell(self, status ? status : go_on(self, first));
    }
}

/* ---- lanes --------------------------------------------------------------------------------- */

/* Steps from where a lane is to its next row. */
static size_t to_next_row(const lane *one)
{
    return one->run.stored * one->run.stride - one->expected;
}

/* The stepper, and the system, are those of a lane where it is now. */
static void take_out(worker *self, size_t first, size_t number)
{
    self->member = first + number;
    if (self->own) bind_parameters(self); /* which it had before, without fault */
    dal__lanes_unload(self->lanes, number, self->stepper);
    self->run = self->lane[number].run;
    self->run.done = dal__lanes_made(self->lanes, number);
}

/* A lane that is at a row, or has stopped before a step, or is to stop.  What has stopped goes on
 * by itself. */
static void attend(worker *self, size_t begin, size_t first, size_t number)
{
    lane *const one = &self->lane[number];
    dal_run *const run = &self->run;
    int status = DAL_SUCCESS;
    take_out(self, first, number);
    const bool goes = run->done == one->expected && run->done < run->steps && !self->stopped;
    if (goes) status = dal_run_go(run, 0); /* which stores the row */
    one->run = *run;
    one->goes = goes && !status;
    if (!one->goes) tell(self, status ? finish(self, status) : go_on(self, begin));
}

/* So many members from the first on, at their beginning. */
static void fill_lanes(worker *self, size_t first, size_t count)
{
    dal__lanes_stop(self->lanes);
    for (size_t i = 0; i < self->width; i++) {
        self->lane[i].goes = false;
        if (i >= count) continue;
        self->member = first + i;
        int status = open_member(self);
        bool goes = false;
        if (!status) {
            status = dal_run_go(&self->run, 0);
            goes = !status && self->run.steps > 0;
            if (!goes) status = finish(self, status);
        }
        self->lane[i] = (lane){.goes = goes, .run = self->run};
        if (goes) dal__lanes_load(self->lanes, i, self->stepper);
        else tell(self, status);
    }
}

/* Steps until the next of the lanes is at a row, or until it is time to look at the clock; 0 if
 * none goes. */
static size_t plan_steps(const worker *self)
{
    size_t steps = 0;
    for (size_t i = 0; i < self->width; i++) {
        const size_t next = self->lane[i].goes ? to_next_row(&self->lane[i]) : 0;
        if (next > 0 && (steps == 0 || next < steps)) steps = next;
    }
    return self->watch.function && steps > self->piece ? self->piece : steps;
}

static void make_lanes(worker *self, size_t begin, size_t first, size_t count)
{
    size_t steps;
    fill_lanes(self, first, count);
    while ((steps = plan_steps(self)) > 0) {
        const double began = self->watch.function ? dal__clock() : 0.0;
        bool at_row = false;
        dal__lanes_advance(self->lanes, steps);
        if (self->watch.function && !self->stopped) ask(self, (double)(first - begin), began);
        for (size_t i = 0; i < self->width; i++) {
            lane *const one = &self->lane[i];
            if (!one->goes) continue;
            one->expected += steps;
            const bool here = to_next_row(one) == 0;
            at_row = at_row || here;
            if (here || self->stopped || dal__lanes_made(self->lanes, i) < one->expected)
                attend(self, begin, first, i);
        }
        /* rows are those of all lanes at once, or the ends of some */
        if (at_row && self->members->stride > 0) dal__lanes_forget_impulses(self->lanes);
    }
}

static void make_range_in_lanes(worker *self, size_t first, size_t count)
{
    for (size_t made = 0; made < count;) {
        const size_t left = count - made, some = left < self->width ? left : self->width;
        make_lanes(self, first, first + made, some);
        made += some;
    }
}

/* ---- the worker ---------------------------------------------------------------------------- */

static void dismiss(worker *self)
{
    dal__lanes_free(self->lanes);
    dal_events_free(self->events);
    dal_mechanics_free(self->mech);
    dal_stepper_free(self->stepper);
    dal_system_free(self->own);
    dal__release(&self->arena);
}

/* A law, with the ctx of the system where it has none of its own. */
static dal_law law_of(const worker *self, const dal_law *given)
{
    dal_law law = *given;
    if (!law.ctx) law.ctx = self->system->def.ctx;
    return law;
}

/* The rows of inputs of the longest of the members. */
static size_t most_holds(const dal_members *members, size_t first, size_t count)
{
    const size_t hold = members->hold > 0 ? members->hold : 1;
    size_t most = 0;
    for (size_t k = first; k < first + count; k++) {
        const size_t steps = *ROW_OF(members, steps, k);
        if (steps > most) most = steps;
    }
    return most / hold + (most % hold > 0);
}

/* The events, with the ctx of the system where they have none of their own. */
static int make_events(worker *self, const dal_scheme *scheme, dal_event *list, dal_error *error)
{
    const dal_members *const members = self->members;
    for (size_t i = 0; i < members->event_count; i++) {
        list[i] = members->events[i];
        if (!list[i].ctx) list[i].ctx = self->system->def.ctx;
        if (!members->resets || !members->resets[i].values) continue;
        double *const scratch = self->laws[i].scratch;
        self->laws[i] = law_of(self, &members->resets[i]);
        self->laws[i].scratch = scratch;
        list[i].reset = dal_law_reset;
        list[i].reset_ctx = &self->laws[i];
    }
    return dal_events_new(&self->events, self->stepper, scheme, list, members->event_count, error);
}

static bool use_lanes(const dal_members *members, const dal_options *options)
{
    return members->lanes && members->event_count == 0 && !members->inputs
        && !(options && options->keep_energy);
}

static int hire(worker *self, const dal_system *system, const dal_scheme *scheme,
                const dal_options *options, size_t holds, dal_error *error)
{
    const dal_members *const members = self->members;
    const size_t N = 2 * system->def.n;
    dal_event *list;
    double *scratch;
    self->width = use_lanes(members, options) ? dal__lanes_width(system, scheme) : 0;
    dal__reserve(&self->arena, &list, members->event_count, sizeof *list);
    dal__reserve(&self->arena, &self->lane, self->width, sizeof *self->lane);
    dal__reserve(&self->arena, &self->laws, members->event_count, sizeof *self->laws);
    dal__reserve(&self->arena, &scratch, members->event_count * N, sizeof *scratch);
    dal__reserve(&self->arena, &self->inputs, holds, system->def.inputs * sizeof *self->inputs);
    int status = dal__allocate(&self->arena, error);
    for (size_t i = 0; !status && i < members->event_count; i++)
        self->laws[i].scratch = scratch + i * N;
    self->system = system;
    if (!status && members->parameters) {
        status = dal__system_copy(&self->own, system, error);
        self->system = self->own;
    }
    if (!status && members->control) self->control = law_of(self, members->control);
    if (!status && options && (options->tolerance != 0.0 || options->eps != 0.0))
        status = dal__fail(error, DAL_EUNSUPPORTED, "options.%s = %g: expected 0, because the "
                           "members of an ensemble take steps of fixed size h",
                           options->eps != 0.0 ? "eps" : "tolerance",
                           options->eps != 0.0 ? options->eps : options->tolerance);
    if (!status) status = dal_stepper_new(&self->stepper, self->system, scheme, options, error);
    if (!status && (members->energy || members->residual || members->multipliers))
        status = dal_mechanics_new(&self->mech, self->system, error);
    if (!status && self->width > 0)
        status = dal__lanes_new(&self->lanes, self->stepper, error);
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
    const size_t holds = members->control ? most_holds(members, first, count) : 0;
    status = hire(&self, system, scheme, options, holds, error);
    if (!status && self.lanes) make_range_in_lanes(&self, first, count);
    else if (!status) make_range(&self, first, count);
    if (self.stopped) status = dal__fail(error, self.stopped, "%s", self.stepper->error.text);
    dismiss(&self);
    return status;
}
