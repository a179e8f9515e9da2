/* dalembert/events.h - what happens between the steps of a run: events, and states at any times.
 *
 * Where a function g of the state changes its sign an event happens.  Its state is found by a step
 * of the scheme itself, from the last state and of the length that leads to g = 0; so it lies in D
 * to roundoff and has the order of the scheme.  The same holds of states at times between the
 * steps.  What only looks changes no bit of the run.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_EVENTS_H
#define DALEMBERT_EVENTS_H

#include <dalembert.h>

#ifdef __cplusplus
extern "C" {
#endif

/* <cdef> */
/* ---- events ---------------------------------------------------------------------------- */

/* *g <- g(t, q, v) at x[2n].  Returns as a callback of a system. */
typedef int (*dal_event_fn)(double t, const double *x, double *g, void *ctx);

/* x[2n], the state at an event, <- the state from which the run goes on.  Returns as a callback. */
typedef int (*dal_reset_fn)(double t, double *x, void *ctx);

/* Functions of the state by one callback, as models have them compiled: the inputs of a run, or the
 * state after an event. */
typedef struct dal_law {
    dal_invariant_fn values; /* its [count] values at x[2n] and time t */
    size_t count;            /* the inputs, or 2n */
    void *ctx;               /* of values */
    double *scratch;         /* [count], of a reset; a law with one serves one run at a time */
} dal_law;

/* Inputs u[count] <- values(t, x): the control of a dal_run whose control_ctx is a dal_law.  Where
 * values returns > 0 they are NaN, which the run refuses. */
DAL_API int dal_law_control(size_t step, double t, const double *x, double *u, void *law);

/* x[count] <- values(t, x): the reset of a dal_event whose reset_ctx is a dal_law. */
DAL_API int dal_law_reset(double t, double *x, void *law);

typedef struct dal_event {
    dal_event_fn g;
    int direction;        /* > 0: only where g grows along the run; < 0: where it falls; 0: both */
    size_t terminal;      /* the run ends at the event of this number, 1 the first; 0: at none */
    dal_reset_fn reset;   /* or NULL; not called where the run ends */
    dal_consistency consistency; /* of what reset gives: checked, projected, or used as it is */
    void *ctx, *reset_ctx; /* of g, of reset */
} dal_event;

/* The events of a run, and what it remembers of them.  A sign that g has at the end of a step and
 * not at its beginning is a change, and so are two changes within one step where g falls towards
 * zero at its beginning and rises at its end.  A state with g = 0 counts as a change when it is
 * reached and not when it is left.  What lies behind a reset in the same step is looked for anew.
 * The states of a scheme with kept nodes are looked at as the moved ones, q - (1-beta) h v, which
 * lie in D; there g and reset are evaluated, and there happened gets its states. */
typedef struct dal_events dal_events;

/* The stepper is that of the run, and scheme the record that it was made of.  list[count] is
 * copied; count may be 0, where only times are asked for.
 * DAL_EINVAL, DAL_ENOMEM, DAL_EUNSUPPORTED (the steps of the scheme cannot be resumed). */
DAL_API int dal_events_new(dal_events **events, const dal_stepper *stepper,
                           const dal_scheme *scheme, const dal_event *list, size_t count,
                           dal_error *error);
DAL_API void dal_events_free(dal_events *events);

/* How often g came so near to zero within a step, without a change from its beginning to its end,
 * that the error of the step is larger: whether it is reached there cannot be told.  *event, *t,
 * *g <- the first time, as the scheme has it; each may be NULL. */
DAL_API size_t dal_events_doubts(const dal_events *events, size_t *event, double *t, double *g);

/* What the events of later steps depend on besides the stepper, as numbers; after they are restored
 * into events of the same list the run goes on as it would have.  DAL_EINVAL (not of such a list),
 * and the events are as they were. */
DAL_API size_t dal_events_saved(const dal_events *events);
DAL_API void dal_events_save(const dal_events *events, double *values);
DAL_API int dal_events_restore(dal_events *events, const double *values, size_t count,
                               dal_error *error);

/* </cdef> */

#ifdef __cplusplus
}
#endif
#endif /* DALEMBERT_EVENTS_H */
