/* newton.h - the full Newton iteration of a beta-step. */
#ifndef DAL__NEWTON_H
#define DAL__NEWTON_H

#include "geometry/geometry.h"

/* One beta-step of any system by the full Newton iteration on all n + m unknowns. */
typedef struct newton {
    size_t n, m;
    int max_iterations;
    bool warm;                      /* the last step is a guess for the next */
    double *rate, *lambda;          /* [n], [m] its (v' - v)/h and kappa/h */
    double *z, *step, *x;           /* [n+m] w and kappa, [n+m], [2n] */
    double *R1, *R2, *B;            /* [n], [m], [m*n] */
    dal__linear K, S;               /* of n and of m equations */
    double *y, *KZ, *r;             /* [n], [m*n], [m] */
    double inverse;                 /* log2 of 1/|det S| of the last one */
    dal_mechanics *mech;            /* of the step that is being solved */
    dal_stats *stats;
    dal_mechanics whole;            /* for full_newton: with all entries and K */
} newton;

void dal__newton_reserve(newton *solver, const dal_system *system, arena *a);
void dal__newton_bind(newton *solver, const dal_system *system, int max_iterations);
/* Forgets the last step. */
void dal__newton_forget(newton *solver);
/* The last step, as save and restore of a family; of a solver without memory there is none. */
size_t dal__newton_save(const newton *solver, double *values);
void dal__newton_restore(newton *solver, const double *values);
/* One beta-scheme with step h (of either sign) at time t from x[2n], in place; kappa[m] = h lambda.
 * end, alpha, kept: as in dal__step_begin.  Operations are counted in stats; the text of a failure
 * is in mech->error. */
int dal__newton_step(newton *solver, dal_mechanics *mech, double t, double end, double alpha,
                     double beta, double h, bool kept, double *x, double *kappa, dal_stats *stats);

#endif /* DAL__NEWTON_H */
