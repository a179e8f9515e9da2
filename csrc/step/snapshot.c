/* A state of a stepper that it can return to. */
#include "step/snapshot.h"

#include "step/stepper.h"

void dal__snapshot_reserve(dal_stepper *stepper, dal__snapshot *snapshot, arena *a)
{
    const dal_family *const family = stepper->family;
    const size_t kept = family->save ? family->save(stepper->method, NULL) : 0;
    DAL__RESERVE(a, 2 * stepper->mech.n + stepper->mech.m, &snapshot->x);
    DAL__RESERVE(a, kept, &snapshot->memory);
}

void dal__snapshot_take(dal_stepper *stepper, dal__snapshot *snapshot)
{
    const dal_motion *const motion = &stepper->motion;
    const size_t N = 2 * stepper->mech.n;
    dal__copy(N, motion->x, snapshot->x);
    dal__copy(stepper->mech.m, motion->impulse, snapshot->x + N);
    snapshot->t = motion->t0;
    snapshot->h = motion->h;
    snapshot->first = motion->first;
    snapshot->worst = motion->stats->worst_residual;
    snapshot->undone = stepper->energy_jump.undone;
    snapshot->scaled = motion->stats->scaled;
    snapshot->unscaled = motion->stats->unscaled;
    if (stepper->family->save) stepper->family->save(stepper->method, snapshot->memory);
}

void dal__snapshot_restore(dal_stepper *stepper, const dal__snapshot *snapshot)
{
    dal_motion *const motion = &stepper->motion;
    const size_t N = 2 * stepper->mech.n;
    dal__copy(N, snapshot->x, motion->x);
    dal__copy(stepper->mech.m, snapshot->x + N, motion->impulse);
    motion->t0 = snapshot->t;
    motion->h = snapshot->h;
    motion->first = snapshot->first;
    motion->stats->worst_residual = snapshot->worst;
    stepper->energy_jump.undone = snapshot->undone;
    motion->stats->scaled = snapshot->scaled;
    motion->stats->unscaled = snapshot->unscaled;
    if (stepper->family->restore) stepper->family->restore(stepper->method, snapshot->memory);
}
