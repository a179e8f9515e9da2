/* run.h - what a run does in a step besides the step. */
#ifndef DAL__RUN_H
#define DAL__RUN_H

#include "dalembert/events.h"
#include "dalembert/journal.h"
#include "step/stepper.h"

/* One step of the run, with the events and the times asked for that lie in it.  A failure leaves
 * the stepper, the events and the run as they were.  run->ended: the run ends within the step, at
 * run->t_end in the state end[2n], which the set of the scheme has; then the stepper stands before
 * the step, and reaction[m] (unless NULL) is the mean of the force since the state stored last.
 * *made <- whether the stepper has made the step. */
int dal__events_step(dal_run *run, double *end, double *reaction, size_t *made);
/* The states at the times of a run that makes no steps. */
void dal__events_no_steps(dal_run *run);
/* Resets all guards for a new run. */
void dal__events_forget(dal_events *events);
/* DAL_EINVAL for what is wrong with the events and the times of a run. */
int dal__events_check(const dal_run *run);

/* Whether the size of its steps varies; whether they are all made. */
static inline bool dal__run_varies(const dal_run *run)
{
    return run->stepper->step_control->varies;
}
bool dal__run_is_over(const dal_run *run);

/* The time where row k of inputs begins, of steps whose size varies. */
double dal__run_begin_of_inputs(const dal_run *run, size_t k);

/* The number of steps for which a row of inputs applies. */
static inline size_t dal__input_steps(const dal_run *run)
{
    return run->input_steps > 0 ? run->input_steps : 1;
}

/* DAL_EINVAL for what is wrong with a run. */
int dal__run_check(const dal_run *run);

/* Into the journal of the run, if it has one: a row, number run->stored, with the mean reaction
 * since the one before, or NULL; an event; the states at times since number `before`.  DAL_EIO. */
int dal__journal_row(const dal_run *run, const double *x, const double *reaction);
int dal__journal_event(const dal_run *run, size_t event, size_t step, double t, const double *x,
                       const double *after);
int dal__journal_times(const dal_run *run, size_t before);
/* Where the reaction goes that only the journal wants, [m]; or NULL. */
double *dal__journal_reaction(const dal_run *run);
/* Before steps that follow a failed one: a snapshot, for their predictor may have seen that. */
int dal__journal_begin(const dal_run *run);
/* After some steps: writes a snapshot when due.  At the end of a call with a status: flushes
 * pending records; unless a step failed, also writes a snapshot when due or at the end. */
int dal__journal_look(const dal_run *run, size_t made);
int dal__journal_pause(const dal_run *run, int status);

/* The estimate of the error (estimate.c): start it with a run; the number of steps until it needs
 * the state again; update it there; and finish it after the last step, by at most `budget` steps at
 * a time, until run->checks is 0. */
void dal__estimate_begin(dal_run *run);
size_t dal__estimate_stop(const dal_run *run);
void dal__estimate_look(dal_run *run);
void dal__estimate_check(dal_run *run, size_t budget);

/* Maps the return value of a user callback to a status; name is used in the message. */
int dal__run_callback_status(const dal_run *run, const char *name, int returned);

#endif /* DAL__RUN_H */
