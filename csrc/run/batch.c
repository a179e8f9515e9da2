/* Members of an ensemble side by side, in the lanes of step/lanes.h. */
#include "run/member.h"

/* The number of steps to the next row of a lane. */
static size_t to_next_row(const dal__lane *one)
{
    return one->run.stored * one->run.stride - one->expected;
}

/* Whether the next step of a run has inputs of its own. */
static bool inputs_change(const dal_run *run)
{
    return run->inputs && run->done < run->steps && run->done % run->input_steps == 0;
}

/* The number of steps to where a lane has to be unloaded. */
static size_t to_next_stop(const dal__lane *one)
{
    const size_t row = to_next_row(one);
    const size_t row_of_inputs = one->run.inputs
        ? one->run.input_steps - one->expected % one->run.input_steps : row;
    return row_of_inputs < row ? row_of_inputs : row;
}

/* Stepper, system and run become those of the member in a lane. */
static void unload(dal__worker *self, size_t first, size_t number)
{
    self->member = first + number;
    if (self->own) dal__member_bind(self); /* which it had before, without fault */
    dal__lanes_unload(self->lanes, number, self->stepper);
    self->run = self->lane[number].run;
    self->run.done = self->lane[number].loaded + dal__lanes_made(self->lanes, number);
}

/* Loads the member of the stepper and the run into a lane, after the steps without lanes: one that
 * lanes cannot make, and the first one with new inputs. */
static int reload(dal__worker *self, size_t number, bool stopped)
{
    dal_run *const run = &self->run;
    int status = stopped ? dal_run_go(run, 1) : DAL_SUCCESS;
    if (!status && inputs_change(run)) status = dal_run_go(run, 1);
    const bool goes = !status && run->done < run->steps;
    self->lane[number] = (dal__lane){.goes = goes, .run = *run, .loaded = run->done,
                                     .expected = run->done};
    if (goes) dal__lanes_load(self->lanes, number, self->stepper);
    return status;
}

/* Stores a row of a lane.  Completes its member without lanes if it has stopped before the first
 * step since it was loaded. */
static void lane_update(dal__worker *self, size_t first, size_t number)
{
    dal__lane *const one = &self->lane[number];
    dal_run *const run = &self->run;
    int status = DAL_SUCCESS;
    unload(self, first, number);
    const bool stops = run->done < one->expected;
    const bool goes = run->done < run->steps && !self->stopped
                   && (!stops || run->done > one->loaded);
    const size_t stored = run->stored;
    if (goes) status = dal_run_go(run, 0); /* which stores the row */
    if (run->stored > stored) dal__lanes_forget_impulse(self->lanes, number);
    one->run = *run;
    one->goes = goes && !status;
    if (one->goes && (stops || inputs_change(run))) status = reload(self, number, stops);
    if (one->goes) return;
    status = status ? dal__member_finish(self, status) : dal__member_complete(self);
    dal__member_report(self, status);
}

/* Starts count members from first on, one in each lane. */
static void load(dal__worker *self, size_t first, size_t count)
{
    dal__lanes_stop(self->lanes);
    for (size_t i = 0; i < self->width; i++) {
        self->lane[i].goes = false;
        if (i >= count) continue;
        self->member = first + i;
        int status = dal__member_open(self);
        bool goes = false;
        if (!status) {
            status = dal_run_go(&self->run, 0);
            if (!status) status = reload(self, i, false);
            goes = self->lane[i].goes;
            if (!goes) status = dal__member_finish(self, status);
        }
        if (!goes) dal__member_report(self, status);
    }
}

/* The number of steps until a lane is at a row or at other inputs, or until the clock is read; 0 if
 * no lane goes. */
static size_t plan_steps(const dal__worker *self)
{
    size_t steps = 0;
    for (size_t i = 0; i < self->width; i++) {
        const size_t next = self->lane[i].goes ? to_next_stop(&self->lane[i]) : 0;
        if (next > 0 && (steps == 0 || next < steps)) steps = next;
    }
    return self->watch.function && steps > self->piece ? self->piece : steps;
}

/* Runs count members from first on, at most one in each lane. */
static void batch_run(dal__worker *self, size_t first, size_t count)
{
    size_t steps;
    load(self, first, count);
    while ((steps = plan_steps(self)) > 0) {
        const double began = self->watch.function ? dal__clock() : 0.0;
        dal__lanes_advance(self->lanes, steps);
        if (self->watch.function && !self->stopped)
            dal__worker_poll(self, (double)(first - self->first), began);
        for (size_t i = 0; i < self->width; i++) {
            dal__lane *const one = &self->lane[i];
            if (!one->goes) continue;
            one->expected += steps;
            const bool here = to_next_row(one) == 0;
            const bool inputs = one->run.inputs && one->expected % one->run.input_steps == 0;
            if (here || inputs || self->stopped
                || one->loaded + dal__lanes_made(self->lanes, i) < one->expected)
                lane_update(self, first, i);
        }
    }
}

void dal__batches_run(dal__worker *self, size_t count)
{
    for (size_t made = 0; made < count;) {
        const size_t left = count - made, some = left < self->width ? left : self->width;
        batch_run(self, self->first + made, some);
        made += some;
    }
}
