/* Members of an ensemble side by side, whose motions are computed four by four, see step/taylor.h.
 * Each has a stepper, and with parameters a system, of its own. */
#include "run/member.h"

#include "step/taylor.h"

#include <stdlib.h>

/* The number of places.  With eight there are mostly four members whose next pieces are due. */
enum { WIDTH = 8 };

/* The member in a place. */
typedef struct beside {
    dal_stepper *stepper;
    dal_system *own;
    dal_run run;
    size_t member;
    bool goes;
} beside;

struct dal__sides {
    beside at[WIDTH];
};

int dal__sides_new(dal__sides **sides, const dal__worker *worker, const dal_options *options,
                   dal_error *error)
{
    dal__sides *const self = calloc(1, sizeof *self);
    int status = self ? DAL_SUCCESS : dal__fail(error, DAL_ENOMEM, "out of memory");
    for (size_t i = 0; !status && i < WIDTH; i++) {
        beside *const one = &self->at[i];
        if (worker->own) status = dal__system_copy(&one->own, worker->own, error);
        const dal_system *const system = one->own ? one->own : worker->system;
        if (!status)
            status = dal_stepper_new(&one->stepper, system, &worker->stepper->scheme, options,
                                     error);
    }
    if (status) dal__sides_free(self);
    else *sides = self;
    return status;
}

void dal__sides_free(dal__sides *sides)
{
    for (size_t i = 0; sides && i < WIDTH; i++) {
        dal_stepper_free(sides->at[i].stepper);
        dal_system_free(sides->at[i].own);
    }
    free(sides);
}

/* Makes the member in a place that of the worker. */
static void take(dal__worker *self, size_t place)
{
    const beside *const one = &self->sides->at[place];
    self->stepper = one->stepper;
    self->run = one->run;
    self->member = one->member;
    if (self->own) dal__member_bind(self); /* which it had before, without fault */
}

/* Puts the member of the worker back into its place, and reports it if it has ended. */
static void put(dal__worker *self, size_t place, int status)
{
    beside *const one = &self->sides->at[place];
    one->run = self->run;
    one->goes = !status && !self->stopped && self->run.done < self->run.steps;
    if (!one->goes) dal__member_report(self, dal__member_finish(self, status));
}

/* Starts a member in a place. */
static void open_member(dal__worker *self, size_t place, size_t member)
{
    beside *const one = &self->sides->at[place];
    dal_system *const own = self->own;
    one->member = self->member = member;
    one->goes = false;
    self->stepper = one->stepper;
    if (own) self->own = one->own;
    int status = dal__member_open(self);
    self->own = own;
    if (status) {
        dal__member_report(self, status);
        return;
    }
    one->run = self->run;
    take(self, place);
    put(self, place, dal_run_go(&self->run, 0)); /* which stores the first row */
}

/* Stores the next row of a member.  If the common step failed, the member makes it alone. */
static void store_row(dal__worker *self, size_t place, const dal__side *side)
{
    take(self, place);
    if (!side->status) self->run.done += side->steps;
    put(self, place, dal_run_go(&self->run, side->status ? side->steps : 0));
}

void dal__sides_run(dal__worker *self, size_t count)
{
    dal_stepper *const first = self->stepper;
    const size_t end = self->first + count;
    size_t next = self->first, going;
    do {
        dal__side side[WIDTH];
        size_t places[WIDTH];
        const double began = self->watch.function ? dal__clock() : 0.0;
        going = 0;
        for (size_t i = 0; i < WIDTH; i++) {
            const beside *const one = &self->sides->at[i];
            while (!one->goes && next < end) open_member(self, i, next++);
            if (!one->goes) continue;
            const dal_run *const run = &one->run;
            one->stepper->motion.watch = run->watch;
            one->stepper->motion.watch_ctx = run->watch_ctx;
            side[going] = (dal__side){.stepper = one->stepper,
                                      .steps = run->stored * run->stride - run->done};
            places[going++] = i;
        }
        dal__taylor_advance(side, going);
        if (self->watch.function && !self->stopped)
            dal__worker_poll(self, (double)(next - self->first - going), began);
        for (size_t k = 0; k < going; k++) store_row(self, places[k], &side[k]);
    } while (going > 0);
    self->stepper = first;
}
