/* dalembert/run.h - runs with inputs, controllers, events, output times and an estimate of the
 * error.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_RUN_H
#define DALEMBERT_RUN_H

#include <dalembert.h>

DAL_BEGIN_DECLARATIONS

/* <cdef> */
/* ---- runs ------------------------------------------------------------------------------ */

/* Controller: u[inputs] <- the inputs of the steps that begin at step, at time t and state x[2n].
 * The return value is that of an observer. */
typedef int (*dal_control_fn)(size_t step, double t, const double *x, double *u, void *ctx);

/* Called for each event, in the order of time, after its step and before the state of the step is
 * stored.  The arguments are the number of the event, its step, counted as for an observer, and its
 * time; the state x[2n] there, and the state after[2n] after its reset, or NULL.  The return value
 * is that of an observer. */
typedef int (*dal_happened_fn)(size_t event, size_t step, double t, const double *x,
                               const double *after, void *ctx);

/* A run of a stepper: zero-initialise it, set the members above t_begin, then call dal_run_go. */
typedef struct dal_run {
    dal_stepper *stepper;   /* started */
    size_t steps, stride;   /* every stride-th state is stored; steps must be a multiple of
                               stride */
    double *x;              /* [(steps/stride + 1)*2n] or NULL: the states; row 0 is the initial
                               one */
    double *reactions;      /* [(steps/stride)*m] or NULL: the mean reaction over each interval,
                               including the impulses of jumps; it belongs to the middle of the
                               interval.  NaN for a scheme without multipliers */
    double *inputs;         /* [ceil(steps/input_steps)*inputs]: row k applies to the steps from
                               k input_steps to (k+1) input_steps - 1 of the run; NULL: the inputs
                               of the stepper */
    size_t input_steps;     /* 0 is 1 */
    dal_control_fn control; /* or NULL: writes each row of inputs when its steps begin */
    void *control_ctx;
    dal_observer_fn observer; /* or NULL */
    void *observer_ctx;
    dal_watch_fn watch;     /* or NULL: called within long steps, with their time */
    void *watch_ctx;
    struct dal_events *events; /* events of the stepper, see dalembert/events.h; or NULL */
    dal_happened_fn happened; /* or NULL */
    void *happened_ctx;
    const double *times;    /* [time_count] output times in the order of the run; requires events */
    size_t time_count;
    double *x_at_times;     /* [time_count*2n]: the states at times, in the set that the scheme
                               preserves */
    struct dal_journal *journal; /* see dalembert/journal.h; or NULL */
    int unchecked;          /* 1: no estimate of the error.  Otherwise a run with steps of size h,
                               by a scheme that has an order, computes one by steps of other sizes.
                               A run of less than 1000 steps, or with suspect samples, is repeated
                               after its end with 2h, 4h or 8h.  If these are inconclusive it is
                               repeated with h/2.  The bits of the run do not depend on the
                               estimate, and observers, controls and events are not called again */
    size_t checks;          /* number of steps still to be repeated after the last step.  Call
                               dal_run_go until it is 0; then dal_stats has the estimate */
    double until;           /* end time for variable steps; the run ends there, or after `steps`.
                               The array x needs room for one more row, because the last state is
                               always stored */
    double input_duration;  /* for variable steps, instead of input_steps: row k of inputs applies
                               from t_begin + k input_duration to the beginning of the next row */
    double *row_times;      /* for variable steps: the times of the rows of x; or NULL */
    double t_begin, row_time; /* set by the run for variable steps: its initial time; time of the
                                 last row */
    size_t row_step;          /* step of the last row */
    size_t rows_set, rows_set_before; /* rows of inputs passed to the stepper so far, and before the
                                         last row of x.  If the stepper already has the first row,
                                         set rows_set to 1, and control is not called for it */
    size_t done;            /* steps taken */
    size_t stored;          /* rows of x that are valid */
    size_t times_done;      /* rows of x_at_times that are valid */
    int ended;              /* 1: a terminal event ended the run; its state is the last row of x,
                               and the stepper is before the step */
    double t_end;           /* time of the terminal event */
} dal_run;

/* Takes at most budget further steps of the run, so that the caller can check clocks and signals in
 * between.  The run is complete when done equals steps.  The results do not depend on budget.
 * After DAL_STOPPED, or after the cause of a failure was removed, another call continues the run.
 * Errors: DAL_STOPPED; DAL_EINVAL; the errors of dal_step. */
DAL_API int dal_run_go(dal_run *run, size_t budget);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_RUN_H */
