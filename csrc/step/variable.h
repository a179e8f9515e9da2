/* variable.h - parts shared by controls of variable steps. */
#ifndef DAL__VARIABLE_H
#define DAL__VARIABLE_H

#include "step/snapshot.h"

typedef struct dal__variable {
    dal__snapshot before;    /* a step */
    arena arena;             /* with the data of the control */
} dal__variable;
/* Allocates what a control has reserved in stepper->variable.arena, and the snapshot. */
int dal__variable_make(dal_stepper *stepper, dal_error *error);
/* The step of such a control: one step by step(stepper), whose next size is *h before and after it.
 * First it checks that steps still lead on, and that C keeps its rank where they become short. */
int dal__variable_advance(dal_stepper *stepper, int (*step)(dal_stepper *stepper), const double *h,
                          size_t *made);
/* A step of h from t, where the stepper stands; the caller counts it. */
int dal__variable_step(dal_stepper *stepper, double t, double h);
/* Whether a step failed for a reason that a shorter one would not have. */
static inline bool dal__is_final(int status)
{
    return status == DAL_EUSER || status == DAL_STOPPED || status == DAL_EINVAL;
}
/* The step from t that ends at the time where one is to end. */
double dal__variable_last(const dal_stepper *stepper, double t);

#endif /* DAL__VARIABLE_H */
