/* dalembert/ensemble.h - many runs of a system: other initial data, parameters, step sizes.
 *
 * A member is a run.  What fails, leaves a domain or does not converge is the end of that member
 * alone, and each has the bits that it would have by itself, whatever the others do and in whatever
 * order, and on however many threads, they are made.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_ENSEMBLE_H
#define DALEMBERT_ENSEMBLE_H

#include <dalembert/events.h>

#ifdef __cplusplus
extern "C" {
#endif

/* <cdef> */
/* ---- ensembles ------------------------------------------------------------------------- */

/* Members: zero-initialise, then set what is wanted.  What is given for them is rows, `next`
 * numbers apart; next = 0: the first row is that of all of them. */
typedef struct dal_members {
    size_t count;
    const double *x;            /* [2n] initial data; NULL: those of the system by default, with
                                   the parameters of the member */
    size_t x_next;
    const void *parameters;     /* [dal_system_parameter_size] bytes; NULL: those of the system */
    size_t parameters_next;     /* in bytes */
    const double *h;            /* [1] */
    size_t h_next;
    const size_t *steps;        /* [1], multiples of stride, if that is not 0, and then all the
                                   same */
    size_t steps_next;
    const double *inputs;       /* [ceil(steps/hold)*inputs] as of a dal_run; NULL: 0 */
    size_t inputs_next, hold;
    const dal_law *control;     /* or NULL: of the inputs, evaluated where they change; a ctx that
                                   is NULL is that of the member's system */
    double t0;
    dal_consistency consistency;
    dal_initial initial;
    const dal_event *events;    /* [event_count] or NULL; a ctx that is NULL is that of the
                                   member's system: its parameters */
    size_t event_count;
    const dal_law *resets;      /* [event_count] or NULL: the resets of those events whose values
                                   are not NULL, with a ctx as that of control; scratch is own */
    int lanes;                  /* 1: several members are stepped at once by vector instructions,
                                   where the system was compiled for it and there are neither
                                   events nor inputs.  A member then does not depend on the others
                                   either, but its bits are of this kind of machine */
    size_t stride;              /* 0: one row of results for each member, its end; else
                                   steps/stride + 1, the first that of its beginning */
    /* Results, each NULL if it is not wanted, and NaN where the member has not come to, or where
     * energy, residual or multipliers are not defined.  In D_eps for kept nodes. */
    double *states;             /* [count*rows*2n]; the last row of a member that a terminal event
                                   has ended is the state there */
    double *energy, *residual;  /* [count*rows] */
    double *multipliers;        /* [count*rows*m] as of dal_trajectory; residual: its relative */
    double *reactions;          /* [count*(rows-1)*m] as of a dal_run, [count*m] for stride = 0 */
    double *t_end;              /* [count] the time that the member has come to */
    size_t *done;               /* [count] steps made */
    size_t *happened;           /* [count*event_count] how often each event has */
    size_t *ended_by;           /* [count] the event that has ended the member, else event_count */
    size_t *doubts;             /* [count] as of dal_events_doubts */
    int *status;                /* [count] 0; or what it has failed with; DAL_STOPPED: unfinished */
    dal_stats *stats;           /* [count] */
    dal_error *errors;          /* [count] in words; text is empty where nothing has failed */
} dal_members;

/* Runs the members first, ..., first + count - 1.  Threads may do so at once with ranges that do
 * not meet, as far as the callbacks of the system may.  Memory is allocated once a call, not for
 * members.  watch (or NULL) sees how many members of the range are done; those that it does not let
 * go on are DAL_STOPPED, and the one that was being made has its rows until then.  options may be
 * NULL.
 * DAL_EINVAL (an argument that is wrong for all: the text names it; a system without parameters),
 * DAL_ENOMEM, DAL_EUNSUPPORTED (events with a scheme that cannot be resumed), DAL_STOPPED,
 * DAL_EUSER (of the watch); DAL_SUCCESS also where members fail. */
DAL_API int dal_ensemble_run(const dal_system *system, const dal_scheme *scheme,
                             const dal_options *options, const dal_members *members, size_t first,
                             size_t count, dal_watch_fn watch, void *ctx, dal_error *error);

/* </cdef> */

#ifdef __cplusplus
}
#endif
#endif /* DALEMBERT_ENSEMBLE_H */
