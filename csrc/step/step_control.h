/* step_control.h - the interface of the controls of the step size. */
#ifndef DAL__STEP_CONTROL_H
#define DAL__STEP_CONTROL_H

#include "dalembert.h"
#include "ground/archive.h"

/* A control determines the size of the steps.  Each is a file, and step_control.c lists them; its
 * data are stepper->control_data. */
typedef struct dal__step_control {
    const char *name;        /* "steps of fixed size" */
    bool varies;             /* each step begins where the one before ended, and has its own size;
                                a run of them is for a time, stepper->until, not for a number */
    /* Whether the options ask for it: the first that says so is made. */
    bool (*wanted)(const dal_options *options);
    /* NULL: nothing to be made.  DAL_EINVAL, DAL_EUNSUPPORTED. */
    int (*make)(dal_stepper *stepper, const dal_options *options, dal_error *error);
    /* DAL_EINVAL in stepper->error unless steps may begin at t with h, infinite if the control is
     * to find it. */
    int (*check)(dal_stepper *stepper, double t, double h);
    /* *first <- the size of a first step from the consistent x[2n] at t, by h.  Nothing changes on
     * failure.  The errors of the field, whose text is in mech->error.  NULL: it is h. */
    int (*start)(dal_stepper *stepper, double t, double h, const double *x, double *first);
    /* As dal__scheme_steps. */
    int (*step)(dal_stepper *stepper, size_t steps, size_t *made);
    /* The state has become another one.  NULL: it does not matter. */
    void (*land)(dal_stepper *stepper);
    /* The data that the next step depends on.  NULL: none. */
    void (*save)(dal_stepper *stepper, dal__archive *a);
} dal__step_control;
extern const dal__step_control dal__fixed_steps, dal__controlled_steps, dal__reversible_steps;
const dal__step_control *dal__step_control_of(const dal_options *options);

#endif /* DAL__STEP_CONTROL_H */
