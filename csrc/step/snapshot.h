/* snapshot.h - a state of a stepper that it can return to. */
#ifndef DAL__SNAPSHOT_H
#define DAL__SNAPSHOT_H

#include "dalembert.h"
#include "ground/ground.h"

typedef struct dal__snapshot {
    double t, h, worst, undone; /* worst_residual; of the jump */
    size_t first, scaled, unscaled;
    double *x;               /* [2n+m] with the impulse */
    double *memory;          /* what the family saves */
} dal__snapshot;
void dal__snapshot_reserve(dal_stepper *stepper, dal__snapshot *snapshot, arena *a);
void dal__snapshot_take(dal_stepper *stepper, dal__snapshot *snapshot);
void dal__snapshot_restore(dal_stepper *stepper, const dal__snapshot *snapshot);

#endif /* DAL__SNAPSHOT_H */
