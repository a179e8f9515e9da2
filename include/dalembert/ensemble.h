/* dalembert/ensemble.h - many runs of a system: other initial data, parameters, step sizes.
 *
 * A member is a run.  A failure ends that member only.  Each member gives bitwise the same result
 * as a run by itself, for any other members, any order and any number of threads.  The rules of
 * dalembert.h hold. */
#ifndef DALEMBERT_ENSEMBLE_H
#define DALEMBERT_ENSEMBLE_H

#include <dalembert/events.h>
#include <dalembert/stepper.h>

DAL_BEGIN_DECLARATIONS

/* <cdef> */
/* ---- ensembles ------------------------------------------------------------------------- */

/* The members of an ensemble: zero-initialise it, then set members.  Each input is an array of
 * rows, `next` numbers apart.  If next = 0, the first row applies to all members. */
typedef struct dal_members {
    size_t count;
    const double *x;            /* [2n] initial data; NULL: the default initial data, with the
                                   parameters of the member */
    size_t x_next;
    const void *parameters;     /* [dal_system_parameter_size] bytes; NULL: the parameters of the
                                   system */
    size_t parameters_next;     /* in bytes */
    const double *h;            /* [1] */
    size_t h_next;
    const size_t *steps;        /* [1]; if stride is not 0, multiples of it, the same for all
                                   members */
    size_t steps_next;
    const double *inputs;       /* [ceil(steps/input_steps)*inputs] as in a dal_run; NULL: 0 */
    size_t inputs_next, input_steps;
    double until;               /* for steps of variable size, options.tolerance > 0: the end time.
                                   They need stride = 0, and steps is the limit of their number */
    double input_duration;      /* for these, instead of input_steps: as in a dal_run.  The rows of
                                   inputs are those up to until */
    const dal_law *control;     /* or NULL: the law of the inputs, evaluated when they change.  If
                                   its ctx is NULL, it gets the ctx of the member's system */
    double t0;
    dal_consistency consistency;
    dal_initial initial;
    const dal_event *events;    /* [event_count] or NULL; an event whose ctx is NULL gets the ctx of
                                   the member's system, its parameters */
    size_t event_count;
    const dal_law *resets;      /* [event_count] or NULL: the resets of those events for which
                                   values is not NULL, with ctx as for control.  The member scratch
                                   is not used */
    int lanes;                  /* 1: vector instructions advance several members at once, if the
                                   system was compiled for this and there are no events.
                                   Inputs must be an array with input_steps >= 8: steps at which
                                   they change are made without lanes.
                                   A member does not depend on the others, but its bits are specific
                                   to this kind of machine */
    size_t stride;              /* 0: one row of results for each member, the end; else steps/stride
                                   + 1 rows, the first for the beginning */
    /* Results, each may be NULL.  Values are NaN after the failure of a member, and if energy,
     * residual or multipliers are not defined.  For kept nodes the states lie in D_eps. */
    double *states;             /* [count*rows*2n]; if a terminal event ended a member, its last row
                                   is the state there */
    double *energy, *residual;  /* [count*rows] */
    double *multipliers;        /* [count*rows*m] as of dal_trajectory; residual is its output
                                   relative */
    double *reactions;          /* [count*(rows-1)*m] as in a dal_run, [count*m] for stride = 0 */
    double *t_end;              /* [count] the time that the member reached */
    size_t *done;               /* [count] steps taken */
    size_t *happened;           /* [count*event_count] the number of occurrences of each event */
    size_t *ended_by;           /* [count] the event that ended the member, else event_count */
    size_t *doubts;             /* [count] as of dal_events_doubts */
    int *status;                /* [count] 0 or the status of a failure; DAL_STOPPED: unfinished */
    dal_stats *stats;           /* [count] */
    dal_error *errors;          /* [count]; text is empty if the member did not fail */
} dal_members;

/* Runs the members first, ..., first + count - 1.  Several threads may call it at once with
 * disjoint ranges, if the callbacks of the system are thread-safe.  Memory is allocated once per
 * call, not per member.  The function watch (or NULL) gets the number of members of the range that
 * are done.  If it stops the call, the remaining members are DAL_STOPPED, and the current one keeps
 * its rows so far.  The pointer options may be NULL.  The return value is DAL_SUCCESS even if
 * members fail.
 * Errors: DAL_EINVAL (an argument invalid for all members, which the text names; a system without
 * parameters); DAL_ENOMEM; DAL_EUNSUPPORTED (events with a scheme that cannot be resumed);
 * DAL_STOPPED; DAL_EUSER (from watch). */
DAL_API int dal_ensemble_run(const dal_system *system, const dal_scheme *scheme,
                             const dal_options *options, const dal_members *members, size_t first,
                             size_t count, dal_watch_fn watch, void *ctx, dal_error *error);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_ENSEMBLE_H */
