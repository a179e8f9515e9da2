/* Where a motion is, to come back to. */
#include "step/place.h"

#include "step/stepper.h"

#include <string.h>

void dal__place_reserve(dal_stepper *stepper, dal__place *place, arena *a)
{
    const dal_family *const family = stepper->family;
    const size_t kept = family->save ? family->save(stepper->method, NULL) : 0;
    DAL__RESERVE(a, 2 * stepper->mech.n + stepper->mech.m, &place->x);
    DAL__RESERVE(a, kept, &place->memory);
}

void dal__remember(dal_stepper *stepper, dal__place *place)
{
    const dal_motion *const motion = &stepper->motion;
    const size_t N = 2 * stepper->mech.n;
    memcpy(place->x, motion->x, N * sizeof *place->x);
    memcpy(place->x + N, motion->impulse, stepper->mech.m * sizeof *place->x);
    place->t = motion->t0;
    place->h = motion->h;
    place->first = motion->first;
    place->worst = motion->stats->worst_residual;
    place->undone = stepper->jump.undone;
    place->scaled = motion->stats->scaled;
    place->unscaled = motion->stats->unscaled;
    if (stepper->family->save) stepper->family->save(stepper->method, place->memory);
}

void dal__go_back(dal_stepper *stepper, const dal__place *place)
{
    dal_motion *const motion = &stepper->motion;
    const size_t N = 2 * stepper->mech.n;
    memcpy(motion->x, place->x, N * sizeof *place->x);
    memcpy(motion->impulse, place->x + N, stepper->mech.m * sizeof *place->x);
    motion->t0 = place->t;
    motion->h = place->h;
    motion->first = place->first;
    motion->stats->worst_residual = place->worst;
    stepper->jump.undone = place->undone;
    motion->stats->scaled = place->scaled;
    motion->stats->unscaled = place->unscaled;
    if (stepper->family->restore) stepper->family->restore(stepper->method, place->memory);
}
