/* run.h - what a run does in a step besides the step. */
#ifndef DAL__RUN_H
#define DAL__RUN_H

#include "dalembert/events.h"
#include "step/step.h"

/* One step of the run, with the events and the times asked for that lie in it.  A failure leaves
 * the stepper, the events and the run as they were.  run->ended: the run ends within the step, at
 * run->t_end in the state end[2n], which the set of the scheme has; then the stepper stands before
 * the step, and reaction[m] (unless NULL) is the mean of the force since the state stored last.
 * *made <- whether the stepper has made the step. */
int dal__events_step(dal_run *run, double *end, double *reaction, size_t *made);
/* DAL_EINVAL for what is wrong with the events and the times of a run. */
int dal__events_check(const dal_run *run);

/* The status of a function of the user that watches the run, by this name. */
int dal__heed(const dal_run *run, const char *name, int returned);

#endif /* DAL__RUN_H */
