/* scaling.h - steps that keep the energy. */
#ifndef DAL__SCALING_H
#define DAL__SCALING_H

#include "step/snapshot.h"
#include "geometry/geometry.h"

/* Steps that keep the energy (scaling.c), whatever controls their size. */
typedef struct dal__scaling {
    bool wanted;
    double energy;     /* that is kept */
    dal__snapshot before; /* a step */
    arena arena;
} dal__scaling;
/* Takes the options for it; DAL_EINVAL, DAL_EUNSUPPORTED. */
int dal__scaling_make(dal_stepper *stepper, const dal_options *options, dal_error *error);
/* *energy <- that of x[2n], where they start, which is 0 where they are not wanted.  The errors of
 * the callbacks, DAL_EUNSUPPORTED; the text is in mech->error. */
int dal__scaling_start(dal_stepper *stepper, const double *x, double *energy);
/* DAL_EUNSUPPORTED, in the name of who asks, unless L is of second degree in v at x[2n]; the text
 * is in mech->error.  The errors of the callbacks. */
int dal__check_degree(dal_mechanics *mech, double t, const double *x, const char *name);
/* Steps of motion->h by the scheme, up to so many, which keep the energy if that is wanted; *made
 * <- how many.  The caller counts them.  The error is in motion->error. */
int dal__scheme_steps(dal_stepper *stepper, size_t steps, size_t *made);

#endif /* DAL__SCALING_H */
