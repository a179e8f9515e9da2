/* Many runs by one stepper, which is started again for each. */
#include "run/member.h"
#include "step/taylor.h"

#include <math.h>

/* ---- arguments ----------------------------------------------------------------------------- */

/* Whether the steps have sizes of their own. */
static bool varies(const dal_options *options)
{
    return options && (options->tolerance != 0.0 || options->eps != 0.0);
}

/* DAL_EINVAL for the end, the rows and the inputs of members with steps of variable size. */
static int check_varied(const dal_members *members, dal_error *error)
{
    const double rows = (members->until - members->t0) / members->input_duration;
    if (members->stride > 0)
        return dal__fail(error, DAL_EINVAL, "members.stride = %zu: expected 0, because the size of "
                         "the steps varies", members->stride);
    if (!isfinite(members->until))
        return dal__fail(error, DAL_EINVAL, "members.until = %g: expected a finite time",
                         members->until);
    if ((members->inputs || members->control) && !(rows >= 0.0 && rows < 0x1p53))
        return dal__fail(error, DAL_EINVAL, "members.input_duration = %g: expected a time in the "
                         "direction of the steps", members->input_duration);
    return DAL_SUCCESS;
}

static int check_members(const dal_system *system, const dal_options *options,
                         const dal_members *members, size_t first, size_t count, dal_error *error)
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
    if (varies(options)) return check_varied(members, error);
    if (members->stride > 0 && members->steps_next > 0)
        return dal__fail(error, DAL_EINVAL, "members.steps_next = %zu with stride = %zu: expected "
                         "the same number of steps for all, or stride = 0", members->steps_next,
                         members->stride);
    if (members->stride > 0 && *members->steps % members->stride > 0)
        return dal__fail(error, DAL_EINVAL, "members.steps = %zu: expected a multiple of stride = "
                         "%zu", *members->steps, members->stride);
    return DAL_SUCCESS;
}

/* ---- the worker ---------------------------------------------------------------------------- */

static void worker_free(dal__worker *self)
{
    dal__lanes_free(self->lanes);
    dal__sides_free(self->sides);
    dal_events_free(self->events);
    dal_mechanics_free(self->mech);
    dal_stepper_free(self->stepper);
    dal_system_free(self->own);
    dal__release(&self->arena);
}

/* A law, with the ctx of the system where it has none of its own. */
static dal_law law_of(const dal__worker *self, const dal_law *given)
{
    dal_law law = *given;
    if (!law.ctx) law.ctx = self->system->def.ctx;
    return law;
}

/* The rows of inputs of the longest of the members. */
static size_t most_input_rows(const dal_options *options, const dal_members *members,
                              size_t first, size_t count)
{
    if (varies(options))
        return (size_t)ceil((members->until - members->t0) / members->input_duration) + 1;
    const size_t input_steps = members->input_steps > 0 ? members->input_steps : 1;
    size_t most = 0;
    for (size_t k = first; k < first + count; k++) {
        const size_t steps = *ROW_OF(members, steps, k);
        if (steps > most) most = steps;
    }
    return most / input_steps + (most % input_steps > 0);
}

/* The events, with the ctx of the system where they have none of their own. */
static int make_events(dal__worker *self, const dal_scheme *scheme, dal_event *list,
                       dal_error *error)
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

static bool use_lanes(const dal_system *system, const dal_members *members,
                      const dal_options *options)
{
    const bool lasting = members->input_steps >= DAL__LANES_INPUT_STEPS && !system->def.driven;
    return members->lanes && members->event_count == 0 && !members->control
        && (!members->inputs || lasting)
        && !(options && options->keep_energy) && !varies(options);
}

/* Whether members are advanced in places of side.c, by series of four at once. */
static bool use_sides(const dal__worker *self, const dal_options *options)
{
    return use_lanes(self->system, self->members, options) && !self->members->inputs
        && !(options && options->own_steps) && dal__taylor_has_four(self->stepper);
}

static int worker_init(dal__worker *self, const dal_system *system, const dal_scheme *scheme,
                       const dal_options *options, size_t input_rows, dal_error *error)
{
    const dal_members *const members = self->members;
    const size_t N = 2 * system->def.n;
    dal_event *list;
    double *scratch;
    self->width = use_lanes(system, members, options) ? dal__lanes_width(system, scheme) : 0;
    dal__reserve(&self->arena, &list, members->event_count, sizeof *list);
    dal__reserve(&self->arena, &self->lane, self->width, sizeof *self->lane);
    dal__reserve(&self->arena, &self->laws, members->event_count, sizeof *self->laws);
    dal__reserve(&self->arena, &scratch, members->event_count * N, sizeof *scratch);
    dal__reserve(&self->arena, &self->inputs, input_rows,
                 system->def.inputs * sizeof *self->inputs);
    int status = dal__allocate(&self->arena, error);
    for (size_t i = 0; !status && i < members->event_count; i++)
        self->laws[i].scratch = scratch + i * N;
    self->system = system;
    if (!status && members->parameters) {
        status = dal__system_copy(&self->own, system, error);
        self->system = self->own;
    }
    if (!status && members->control) self->control = law_of(self, members->control);
    if (!status) status = dal_stepper_new(&self->stepper, self->system, scheme, options, error);
    if (!status && (members->energy || members->residual || members->multipliers))
        status = dal_mechanics_new(&self->mech, self->system, error);
    if (!status && use_sides(self, options))
        status = dal__sides_new(&self->sides, self, options, error);
    if (!status && self->width > 0)
        status = dal__lanes_new(&self->lanes, self->stepper, error);
    if (!status && members->event_count > 0) status = make_events(self, scheme, list, error);
    return status;
}

static void run_members(dal__worker *self, size_t count)
{
    for (self->member = self->first; self->member < self->first + count; self->member++) {
        const int status = dal__member_open(self);
        dal__member_report(self, status ? status : dal__member_complete(self));
    }
}

int dal_ensemble_run(const dal_system *system, const dal_scheme *scheme, const dal_options *options,
                     const dal_members *members, size_t first, size_t count, dal_watch_fn watch,
                     void *ctx, dal_error *error)
{
    int status =
        DAL__REQUIRE(error, {"system", system}, {"scheme", scheme}, {"members", members});
    if (!status) status = check_members(system, options, members, first, count, error);
    if (status) return status;
    const size_t stride = members->stride, rows = stride > 0 ? *members->steps / stride + 1 : 1;
    dal__worker self = {.members = members, .first = first, .rows = rows,
                        .reactions = stride > 0 ? rows - 1 : 1, .piece = 1,
                        .watch = {.function = watch, .ctx = ctx}};
    const size_t input_rows =
        members->control ? most_input_rows(options, members, first, count) : 0;
    status = worker_init(&self, system, scheme, options, input_rows, error);
    if (!status && self.lanes) dal__batches_run(&self, count);
    else if (!status && self.sides) dal__sides_run(&self, count);
    else if (!status) run_members(&self, count);
    if (self.stopped) status = dal__fail(error, self.stopped, "%s", self.stepper->error.text);
    worker_free(&self);
    return status;
}
