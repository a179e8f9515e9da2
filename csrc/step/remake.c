/* Compute steps again with another h, and restore the motion afterwards. */
#include "step/estimate.h"

#include "step/stepper.h"

#include <string.h>

int dal__remake_make(dal_stepper *self, dal_error *error)
{
    dal__remake *const remake = &self->remake;
    if (dal_stepper_saved(self) == 0) return DAL_SUCCESS; /* the family cannot restore a motion */
    dal__snapshot_reserve(self, &remake->here, &remake->arena);
    dal__snapshot_reserve(self, &remake->there, &remake->arena);
    DAL__RESERVE(&remake->arena, self->motion.system->def.inputs, &remake->input,
                 &remake->applied);
    dal__rank_reserve(&remake->guards.rank, self->mech.n, self->mech.m, &remake->arena);
    return dal__allocate(&remake->arena, error);
}

void dal__remake_begin(dal_stepper *self)
{
    dal__remake *const remake = &self->remake;
    dal__snapshot_take(self, &remake->here);
    dal__copy(self->motion.system->def.inputs, self->motion.input, remake->input);
    if (self->applied) dal__copy(self->motion.system->def.inputs, self->applied, remake->applied);
    remake->calls = self->mech.eval.calls;
    remake->stats = *self->motion.stats;
    remake->steps = self->motion.steps;
    remake->watch = self->motion.watch;
    self->motion.watch = NULL;
    remake->guards.allowed = self->guards.allowed;
    dal__rank_copy(self->mech.m, &self->guards.rank, &remake->guards.rank);
    self->motion.guards = &remake->guards;
}

void dal__remake_end(dal_stepper *self)
{
    const dal__remake *const remake = &self->remake;
    dal__copy(self->motion.system->def.inputs, remake->input, self->mech.eval.own_input);
    if (self->applied) dal__copy(self->motion.system->def.inputs, remake->applied, self->applied);
    self->motion.guards = &self->guards;
    dal__snapshot_restore(self, &remake->here);
    *self->motion.stats = remake->stats;
    self->motion.steps = remake->steps;
    self->motion.watch = remake->watch;
    self->mech.eval.calls = remake->calls;
}

void dal__remake_start(dal_stepper *self, double t, double from, const double *x, double h)
{
    dal_motion *const motion = &self->motion;
    const size_t n = self->mech.n;
    memmove(motion->x, x, 2 * n * sizeof *x);
    if (self->shift != 0.0) dal__add(n, self->shift * (h - from), motion->x + n, motion->x);
    motion->t0 = t;
    motion->h = h;
    motion->first = motion->steps;
    if (self->applied) dal__forget(motion->system->def.inputs, self->applied);
    if (self->family->start) self->family->start(self->method, motion);
}

bool dal__remake_steps(dal_stepper *self, size_t steps)
{
    dal_motion *const motion = &self->motion;
    int status = dal__stepper_enter_D(self);
    for (size_t left = steps, done = 0; !status && left > 0; left -= done) {
        done = 1;
        status = dal__scheme_steps(self, left, &done);
        motion->steps += done;
        if (done == 0 && !status) return false;
    }
    return !status;
}

void dal__remake_pause(dal_stepper *self)
{
    dal__snapshot_take(self, &self->remake.there);
    self->remake.paused = self->motion.steps;
}

void dal__remake_resume(dal_stepper *self)
{
    dal__snapshot_restore(self, &self->remake.there);
    self->motion.steps = self->remake.paused;
}
