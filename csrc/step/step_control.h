/* step_control.h - the interface of the controls of the step size. */
#ifndef DAL__STEP_CONTROL_H
#define DAL__STEP_CONTROL_H

#include "ground/archive.h"
#include "step/snapshot.h"

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
extern const dal__step_control dal__fixed_steps, dal__own_steps, dal__controlled_steps,
                               dal__reversible_steps;
const dal__step_control *dal__step_control_of(const dal_options *options);

/* Data that the controls of variable steps share (variable.c). */
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

#endif /* DAL__STEP_CONTROL_H */
