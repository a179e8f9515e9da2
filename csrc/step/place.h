/* place.h - a state of a stepper that it can return to. */
#ifndef DAL__PLACE_H
#define DAL__PLACE_H

#include "dalembert.h"
#include "ground/ground.h"

/* Where a motion was. */
typedef struct dal__place {
    double t, h, worst, undone; /* worst_residual; of the jump */
    size_t first, scaled, unscaled;
    double *x;               /* [2n+m] with the impulse */
    double *memory;          /* what the family saves */
} dal__place;
void dal__place_reserve(dal_stepper *stepper, dal__place *place, arena *a);
void dal__remember(dal_stepper *stepper, dal__place *place);
void dal__go_back(dal_stepper *stepper, const dal__place *place);

#endif /* DAL__PLACE_H */
