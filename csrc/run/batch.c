/* Members of an ensemble side by side, in the lanes of step/lanes.h. */
#include "run/member.h"

/* The number of steps to the next row of a lane. */
static size_t to_next_row(const dal__lane *one)
{
    return one->run.stored * one->run.stride - one->expected;
}

/* Stepper, system and run become those of the member in a lane. */
static void unload(dal__worker *self, size_t first, size_t number)
{
    self->member = first + number;
    if (self->own) dal__member_bind(self); /* which it had before, without fault */
    dal__lanes_unload(self->lanes, number, self->stepper);
    self->run = self->lane[number].run;
    self->run.done = dal__lanes_made(self->lanes, number);
}

/* Stores a row of a lane, or completes its member without lanes if it has stopped before a step. */
static void lane_update(dal__worker *self, size_t first, size_t number)
{
    dal__lane *const one = &self->lane[number];
    dal_run *const run = &self->run;
    int status = DAL_SUCCESS;
    unload(self, first, number);
    const bool goes = run->done == one->expected && run->done < run->steps && !self->stopped;
    if (goes) status = dal_run_go(run, 0); /* which stores the row */
    one->run = *run;
    one->goes = goes && !status;
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
            goes = !status && self->run.steps > 0;
            if (!goes) status = dal__member_finish(self, status);
        }
        self->lane[i] = (dal__lane){.goes = goes, .run = self->run};
        if (goes) dal__lanes_load(self->lanes, i, self->stepper);
        else dal__member_report(self, status);
    }
}

/* The number of steps until a lane reaches a row, or until the clock is read; 0 if no lane goes. */
static size_t plan_steps(const dal__worker *self)
{
    size_t steps = 0;
    for (size_t i = 0; i < self->width; i++) {
        const size_t next = self->lane[i].goes ? to_next_row(&self->lane[i]) : 0;
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
        bool at_row = false;
        dal__lanes_advance(self->lanes, steps);
        if (self->watch.function && !self->stopped)
            dal__worker_poll(self, (double)(first - self->first), began);
        for (size_t i = 0; i < self->width; i++) {
            dal__lane *const one = &self->lane[i];
            if (!one->goes) continue;
            one->expected += steps;
            const bool here = to_next_row(one) == 0;
            at_row = at_row || here;
            if (here || self->stopped || dal__lanes_made(self->lanes, i) < one->expected)
                lane_update(self, first, i);
        }
        /* rows are those of all lanes at once, or the ends of some */
        if (at_row && self->members->stride > 0) dal__lanes_forget_impulses(self->lanes);
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
