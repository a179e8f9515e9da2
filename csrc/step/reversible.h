/* reversible.h - what reversible steps remember. */
#ifndef DAL__REVERSIBLE_H
#define DAL__REVERSIBLE_H

#include <stdbool.h>

typedef struct dal__reversible {
    double eps;
    double most_error;       /* of a step by its estimate, in units of the speed */
    double noise;            /* roundoff of the estimate, in units of that of a state */
    double rho;              /* of the next step */
    double speed, fastest;   /* v0^2, and the square of the largest rate so far */
    bool settled;            /* rho has come to sigma since the start, or the last reset of x */
    double *field, *away, *there; /* [2n] that at x, a state near it, its field */
    double *jerk;            /* [2n] of the last look at x, and of this one */
    double *estimate;        /* [2n] of the error of a step */
} dal__reversible;

#endif /* DAL__REVERSIBLE_H */
