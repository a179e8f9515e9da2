/* dalembert/events.h - events between the steps of a run, and states at given times.
 *
 * An event happens when a function g of the state changes sign.  A step of the scheme from the last
 * state, of the length that leads to g = 0, computes the state at the event.  So it lies in D to
 * roundoff and has the order of the scheme.  The same holds for states at times between the steps.
 * The scheme taylor has a polynomial for each step, which gives these states, and all crossings of
 * events that have series.
 * Events without a reset, and output times, do not change the bits of the run.  The rules of
 * dalembert.h hold. */
#ifndef DALEMBERT_EVENTS_H
#define DALEMBERT_EVENTS_H

#include <dalembert/run.h>

DAL_BEGIN_DECLARATIONS

/* <cdef> */
/* ---- events ---------------------------------------------------------------------------- */

struct dal_event_series; /* dalembert/series.h */

/* *g <- g(t, q, v) at x[2n].  The return value is that of a callback of a system. */
typedef int (*dal_event_fn)(double t, const double *x, double *g, void *ctx);

/* The state x[2n] at an event <- the state from which the run continues.  The return value is that
 * of a callback of a system. */
typedef int (*dal_reset_fn)(double t, double *x, void *ctx);

/* Functions of the state, computed by one compiled callback: the inputs of a run, or the state
 * after an event. */
typedef struct dal_law {
    dal_invariant_fn values; /* the [count] values at x[2n] and time t */
    size_t count;            /* number of inputs, or 2n */
    void *ctx;               /* context of values */
    double *scratch;         /* [count], for a reset; use such a law in one run at a time */
} dal_law;

/* The control of a dal_run whose control_ctx is a dal_law: u[count] <- values(t, x).  If values
 * returns > 0, the inputs are NaN, and the run fails. */
DAL_API int dal_law_control(size_t step, double t, const double *x, double *u, void *law);

/* The reset of a dal_event whose reset_ctx is a dal_law: x[count] <- values(t, x). */
DAL_API int dal_law_reset(double t, double *x, void *law);

typedef struct dal_event {
    dal_event_fn g;
    int direction;        /* > 0: only if g increases along the run; < 0: only if it decreases; 0:
                             both */
    size_t terminal;      /* the run ends at this occurrence of the event, 1 the first; 0: it
                             continues */
    dal_reset_fn reset;   /* or NULL; not called at the end of the run */
    dal_consistency consistency; /* whether the state of reset is checked, projected, or used
                                    unchanged */
    void *ctx, *reset_ctx; /* contexts of g and of reset */
    const struct dal_event_series *series; /* the Taylor series of g alone, compiled for the system
                                              of the run; or NULL.  With it the scheme taylor finds
                                              all zeros */
} dal_event;

/* The events of a run, and their state during the run.  A sign change of g from the beginning to
 * the end of a step is detected.  Two sign changes within a step are detected if g moves towards
 * zero at its beginning and away from zero at its end.  A state with g = 0 counts when it is
 * reached, not when it is left.  After a reset the rest of the step is computed again, and searched
 * for further events.  For a scheme with kept nodes, g and reset are evaluated at the moved states,
 * q - (1-beta) h v, which lie in D; happened receives these states. */
typedef struct dal_events dal_events;

/* Creates the events of the run of a stepper, with the scheme of the stepper.  The array
 * list[count] is copied; count may be 0 if only output times are needed.
 * Errors: DAL_EINVAL; DAL_ENOMEM; DAL_EUNSUPPORTED (the steps of the scheme cannot be resumed). */
DAL_API int dal_events_new(dal_events **events, const dal_stepper *stepper,
                           const dal_scheme *scheme, const dal_event *list, size_t count,
                           dal_error *error);
DAL_API void dal_events_free(dal_events *events);

/* Returns the number of undecided events.  In these g approached zero within a step to less than
 * the error of the step, without a sign change over the step.  *event, *t, *g <- the number, time
 * and value of the first one; each may be NULL. */
DAL_API size_t dal_events_doubts(const dal_events *events, size_t *event, double *t, double *g);

/* Save and restore all data, besides those of the stepper, that determine the events of later
 * steps.  Restored into events of the same list, the run continues with bitwise identical results.
 * On failure the events are unchanged.
 * Errors: DAL_EINVAL (data of another list). */
DAL_API size_t dal_events_saved(const dal_events *events);
DAL_API void dal_events_save(const dal_events *events, double *values);
DAL_API int dal_events_restore(dal_events *events, const double *values, size_t count,
                               dal_error *error);

/* All events of a run, in the order of time: zero-initialise it but for n, and give dal_run
 * dal_keep_event as `happened`, and it as `happened_ctx`. */
typedef struct dal_kept_events {
    size_t n;         /* coordinates */
    size_t count, room;
    size_t *event;    /* [count] the number of each */
    double *t;        /* [count] its time */
    double *x;        /* [count*4n] the state, and that after its reset, or NaN */
} dal_kept_events;

/* Returns < 0 if there is no memory; the run then fails with DAL_EUSER. */
DAL_API int dal_keep_event(size_t event, size_t step, double t, const double *x,
                           const double *after, void *kept);
/* Frees the arrays, also after a failure. */
DAL_API void dal_kept_events_free(dal_kept_events *kept);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_EVENTS_H */
