/* stepper.h - the stepper. */
#ifndef DAL__STEPPER_H
#define DAL__STEPPER_H

#include "dalembert/family.h"
#include "step/energy_jump.h"
#include "step/estimate.h"
#include "step/scaling.h"
#include "step/step_control.h"

struct dal_stepper {
    dal_motion motion;
    const dal_family *family;
    void *method;          /* what the family made */
    dal_scheme scheme;
    double identity;       /* a number of its system and scheme, to tell others apart by */
    double shift;          /* 1 - beta of kept nodes, else 0 */
    dal_mechanics mech;
    dal_stats stats;
    double *fresh;         /* [2n] initial data being examined */
    double *applied;       /* [inputs] in whose D the state is, if constraints depend on them */
    dal__energy_jump energy_jump;
    struct dal__guards guards;
    const dal__step_control *step_control;
    void *control_data;    /* made by step_control */
    double until;          /* a time at which a step is to end, or infinite */
    dal__variable variable;
    dal__scaling scaling;
    dal__remake remake;
    dal__estimate estimate;
    bool started;
    dal_error error;
    arena arena;
};

/* DAL_EINVAL unless it is started; unless steps of h lead on from t0. */
int dal__stepper_started(dal_stepper *stepper);
int dal__stepper_check_times(dal_stepper *stepper, double t0, double h);
/* DAL_EINVAL unless the scheme is that of the stepper; DAL_EUNSUPPORTED if its steps cannot be
 * resumed, for that which is named. */
int dal__stepper_check_scheme(const dal_stepper *stepper, const dal_scheme *scheme,
                              const char *name, dal_error *error);
/* 1, or -1 if its steps, of a stepper that is started, lead back. */
static inline double dal__stepper_direction(const dal_stepper *stepper)
{
    return stepper->motion.h > 0.0 ? 1.0 : -1.0;
}
/* dal_advance in parts, of a stepper that is started: the steps, whose impulses are added up, fewer
 * where those whose size varies are to end; the mean reaction over the time that has passed. */
void dal__stepper_forget_impulse(dal_stepper *stepper);
int dal__stepper_advance(dal_stepper *stepper, size_t steps, size_t *made);
/* Before a step: where inputs have changed D the velocity jumps into it; the impulse of the jump is
 * added to those of the steps.  The errors of dal_project. */
int dal__stepper_enter_D(dal_stepper *stepper);
int dal__stepper_reaction(dal_stepper *stepper, double elapsed, double *reaction);
/* The state after the last step becomes x[2n], from where the motion is another one: the predictor
 * is forgotten, and the energy is that from now on; kept: that which is kept, if one is.  The
 * errors of the callbacks. */
int dal__stepper_land(dal_stepper *stepper, const double *x, double kept);
/* Looks at the energy of the state now.  DAL_EUSER. */
int dal__stepper_look(dal_stepper *stepper);
/* Has the steps of a beta-scheme made by the compilation for any sizes: for tests. */
void dal__beta_any_sizes(dal_stepper *stepper);

#endif /* DAL__STEPPER_H */
