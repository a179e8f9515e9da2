/* controlled.h - what error-controlled steps remember. */
#ifndef DAL__CONTROLLED_H
#define DAL__CONTROLLED_H

#include "step/snapshot.h"

typedef struct dal__controlled {
    int q, order;            /* the estimate is O(h^(q+1)), the error O(h^(order+1)) */
    double tolerance, h_max; /* 0: no limit */
    double allowed;          /* error of a step */
    double noise, seen;      /* the roundoff of the estimate by its weights, and as it was seen */
    double h, error;         /* the next step to be tried; the error of the last, in units of what
                                is allowed */
    double error_ratio;      /* the error of a step, relative to a power of its estimate */
    double *estimate, *field; /* [2n] */
    dal__snapshot after;     /* a step */
} dal__controlled;

#endif /* DAL__CONTROLLED_H */
