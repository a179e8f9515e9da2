/* A run: what comes in, what is stored, and who watches. */
#include "run/events.h"
#include "run/run.h"

#include <math.h>
#include <string.h>

enum { MOST_AT_ONCE = 4096 }; /* steps, after which a journal looks at the time */

/* Whether the state now is to be stored, and is not yet. */
static bool is_due(const dal_run *run)
{
    if (!dal__run_varies(run)) return run->done == run->stored * run->stride;
    const size_t since = run->done - run->row_step;
    return run->stored == 0 || since >= run->stride || (since > 0 && dal__run_is_over(run));
}

/* Where the mean reaction since the row before goes; NULL if there is none, or nobody wants it. */
static double *reaction_of_row(const dal_run *run)
{
    if (run->stored == 0) return NULL;
    return run->reactions ? run->reactions + (run->stored - 1) * run->stepper->mech.m
                          : dal__journal_reaction(run);
}

/* Stores the state now and tells the observer of it; DAL_STOPPED or DAL_EUSER if it wants no
 * more. */
static int store(dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    const dal_motion *const motion = &stepper->motion;
    const size_t N = 2 * stepper->mech.n;
    double *const reaction = reaction_of_row(run);
    const double t = dal_stepper_time(stepper);
    const double elapsed =
        dal__run_varies(run) ? t - run->row_time : (double)run->stride * motion->h;
    int status = reaction ? dal__stepper_reaction(stepper, elapsed, reaction) : DAL_SUCCESS;
    if (!status) status = dal__journal_row(run, motion->x, reaction);
    if (status) return status;
    dal__stepper_forget_impulse(stepper);
    if (run->x) memcpy(run->x + run->stored * N, motion->x, N * sizeof *run->x);
    if (run->row_times) run->row_times[run->stored] = t;
    if (run->stored == 0) run->t_begin = t;
    run->row_time = t;
    run->row_step = run->done;
    run->rows_set_before = run->stored > 0 ? run->rows_set : 0;
    run->stored++;
    if (!run->observer) return DAL_SUCCESS;
    const int returned = run->observer(motion->steps, t, motion->x, run->observer_ctx);
    return dal__run_callback_status(run, "observer", returned);
}

/* Whether the inputs change here; *row <- to which. */
static bool inputs_change(const dal_run *run, size_t *row)
{
    const size_t input_steps = dal__input_steps(run);
    if (!run->inputs) return false;
    *row = dal__run_varies(run) ? run->rows_set : run->done / input_steps;
    if (!dal__run_varies(run)) return run->done % input_steps == 0;
    const double since = dal_stepper_time(run->stepper) - dal__run_begin_of_inputs(run, *row);
    return dal__stepper_direction(run->stepper) * since >= 0.0;
}

/* Where the inputs change, those of the steps that follow. */
static int set_inputs(dal_run *run)
{
    dal_stepper *const stepper = run->stepper;
    const dal_motion *const motion = &stepper->motion;
    const size_t width = motion->system->def.inputs;
    size_t row;
    if (!inputs_change(run, &row)) return DAL_SUCCESS;
    double *const u = run->inputs + row * width;
    int status = DAL_SUCCESS;
    if (run->control && run->rows_set <= row) {
        dal__forget(width, u);
        const int returned = run->control(motion->steps, dal_stepper_time(stepper), motion->x, u,
                                          run->control_ctx);
        status = dal__run_callback_status(run, "control", returned);
    }
    if (status) return status;
    status = dal_stepper_input(stepper, u);
    if (!status) run->rows_set = row + 1; /* else it is set again */
    return dal__fail_because(&stepper->error, status, &stepper->error,
                             "the inputs of step %zu (t = %g): ", motion->steps + 1,
                             dal_stepper_time(stepper));
}

/* Where the next step is to end at the latest, if its size varies. */
static int limit_steps(const dal_run *run)
{
    const double change = run->inputs ? dal__run_begin_of_inputs(run, run->rows_set) : run->until;
    const bool sooner = dal__stepper_direction(run->stepper) * (change - run->until) < 0.0;
    return dal_stepper_until(run->stepper, sooner ? change : run->until);
}

/* For how many steps the inputs are what they are now, up to most: rows of a table that follow and
 * are the same go in one. */
static size_t steps_of_inputs(const dal_run *run, size_t most)
{
    if (dal__run_varies(run)) return most;
    const size_t input_steps = dal__input_steps(run), row = run->done / input_steps;
    const size_t width = run->inputs ? run->stepper->motion.system->def.inputs : 0;
    size_t steps = input_steps - run->done % input_steps;
    if (!run->inputs) return most;
    for (const double *u = run->inputs + row * width; !run->control && steps < most; u += width) {
        if (memcmp(u, u + width, width * sizeof *u) != 0) break;
        steps += input_steps;
    }
    return steps < most ? steps : most;
}

/* Write the events of the step, and the times after times_done, to the journal; call happened. */
static int report(const dal_run *run, size_t times_done)
{
    const dal_events *const e = run->events;
    const size_t step = e->step + (size_t)run->ended;
    int status = dal__journal_times(run, times_done);
    for (size_t k = 0; k < e->happenings; k++) {
        const happening *const one = &e->happened[k];
        const double *const after = one->reset ? one->after : NULL;
        if (!status) status = dal__journal_event(run, one->event, step, one->t, one->x, after);
    }
    for (size_t k = 0; run->happened && k < e->happenings; k++) {
        const happening *const one = &e->happened[k];
        const int returned = run->happened(one->event, step, one->t, one->x,
                                           one->reset ? one->after : NULL, run->happened_ctx);
        const int answer = dal__run_callback_status(run, "happened", returned);
        if (!status) status = answer;
    }
    return status;
}

/* A step with what happens in it; where the run ends in it the state there is one more row. */
static int look_and_step(dal_run *run, size_t *made)
{
    const size_t N = 2 * run->stepper->mech.n;
    double *const row = run->x ? run->x + run->stored * N : run->stepper->fresh;
    double *const reaction = reaction_of_row(run);
    const size_t times_done = run->times_done;
    int status = dal__events_step(run, row, reaction, made);
    if (!status) status = report(run, times_done);
    if (!run->ended) return status;
    if (run->row_times) run->row_times[run->stored] = run->t_end;
    if (!status) status = dal__journal_row(run, row, reaction);
    run->stored++;
    return status ? status : DAL_STOPPED;
}

/* At the end of a call with this status, which is returned, or that of the journal. */
static int pause_journal(const dal_run *run, int status)
{
    if (!run->journal) return status;
    const dal_error error = run->stepper->error;
    const int kept = dal__journal_pause(run, status);
    if (!status) return kept;
    run->stepper->error = error;
    return status;
}

int dal_run_go(dal_run *run, size_t budget)
{
    if (!run || !run->stepper) return DAL_EINVAL;
    dal_motion *const motion = &run->stepper->motion;
    int status = dal__run_check(run);
    if (status) return status;
    if (run->checks > 0) dal__estimate_check(run, budget);
    else dal__estimate_begin(run);
    if (run->ended) return DAL_STOPPED;
    if (run->checks > 0) return DAL_SUCCESS;
    if (run->control && run->done == 0 && run->rows_set == 1)
        dal__copy(motion->system->def.inputs, motion->input, run->inputs);
    status = dal__journal_begin(run);
    if (!status && is_due(run)) status = store(run);
    motion->watch = run->watch;
    motion->watch_ctx = run->watch_ctx;
    while (!status && budget > 0 && !dal__run_is_over(run)) {
        const size_t since = dal__run_varies(run) ? run->done - run->row_step
                                                : run->done % run->stride;
        size_t made = 0, left = run->stride - since;
        if (left > run->steps - run->done) left = run->steps - run->done;
        status = set_inputs(run);
        if (!status && dal__run_varies(run)) status = limit_steps(run);
        if (status) break;
        if (left > budget) left = budget;
        left = steps_of_inputs(run, left);
        if (run->journal && left > MOST_AT_ONCE) left = MOST_AT_ONCE;
        if (left > dal__estimate_stop(run)) left = dal__estimate_stop(run);
        if (run->events) status = look_and_step(run, &made);
        else status = dal__stepper_advance(run->stepper, left, &made);
        budget -= made;
        run->done += made;
        if (!status) dal__estimate_look(run);
        if (!status && is_due(run)) status = store(run);
        if (!status && run->journal) status = dal__journal_look(run, made);
    }
    motion->watch = NULL;
    if (!status && run->done == 0 && dal__run_is_over(run)) dal__events_no_steps(run);
    if (!status && dal__run_is_over(run)) status = dal__stepper_look(run->stepper);
    status = pause_journal(run, status);
    if (run->ended ? status == DAL_STOPPED : !status && dal__run_is_over(run))
        dal__estimate_check(run, budget);
    return status;
}

int dal_integrate(dal_stepper *stepper, size_t steps, size_t stride, double *x, double *reactions,
                  dal_observer_fn observer, void *ctx, size_t *done)
{
    dal_run run = {.stepper = stepper, .steps = steps, .stride = stride, .x = x,
                   .reactions = reactions, .observer = observer, .observer_ctx = ctx};
    const int status = dal_run_go(&run, SIZE_MAX);
    if (done) *done = run.stored > 0 ? (run.stored - 1) * stride : 0;
    return status;
}
