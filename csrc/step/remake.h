/* remake.h - steps computed again with another size. */
#ifndef DAL__REMAKE_H
#define DAL__REMAKE_H

#include "step/snapshot.h"
#include "geometry/geometry.h"

/* Steps of the motion that are computed again with another h (remake.c). */
typedef struct dal__remake {
    dal__snapshot here, there; /* of the motion; of the other steps, between two calls */
    dal_stats stats;        /* the rest of the motion */
    dal__calls calls;
    size_t steps, paused;   /* of the motion; of the other steps */
    double *input, *applied; /* [inputs] */
    dal_watch_fn watch;
    struct dal__guards guards; /* of the other steps: the run has its own */
    arena arena;
} dal__remake;
int dal__remake_make(dal_stepper *stepper, dal_error *error);
/* Save the motion; restore it. */
void dal__remake_begin(dal_stepper *stepper);
void dal__remake_end(dal_stepper *stepper);
/* Between the two: start with steps of h at x[2n] and t, a state of steps of `from`; compute so
 * many steps, false if one fails. */
void dal__remake_start(dal_stepper *stepper, double t, double from, const double *x, double h);
bool dal__remake_steps(dal_stepper *stepper, size_t steps);
/* Save the other steps before an end; resume them after the next begin. */
void dal__remake_pause(dal_stepper *stepper);
void dal__remake_resume(dal_stepper *stepper);

#endif /* DAL__REMAKE_H */
