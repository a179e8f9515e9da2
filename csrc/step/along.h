/* along.h - a function of the state along a piece of a motion. */
#ifndef DAL__ALONG_H
#define DAL__ALONG_H

#include "dalembert/events.h"
#include "step/coefficients.h"

typedef struct dal__along dal__along;

/* For an event of a system with n coordinates and series.  DAL_EINVAL if those of the event are of
 * another system; DAL_ENOMEM. */
int dal__along_new(dal__along **self, const dal_event *event, const dal_series *series, size_t n,
                   dal_error *error);
void dal__along_free(dal__along *self);

/* Finds where g changes its sign in the piece, from a time to another.  A value at the beginning of
 * no more than `zero` is zero, and left; < 0: none is.  DAL_EDOMAIN if g has no series there;
 * DAL_ENOMEM; the errors of the watch. */
int dal__along_look(dal__along *self, const dal__piece *piece, double from, double to,
                    double zero, dal__watch *watch, dal_error *error);

/* The results, valid until the next look: the times in the order of the motion, the sign of g at
 * both ends, and a time at which g touches zero, or is too near to tell; or NaN. */
typedef struct dal__found {
    size_t count;
    const double *t;
    int first, last;
    double touch;
    double zero_since; /* the time since which g is zero up to the end, or NaN */
} dal__found;
dal__found dal__along_found(const dal__along *self);

/* *rate <- dg/dt at a time in the piece. */
int dal__along_rate(dal__along *self, const dal__piece *piece, double t, double *rate,
                    dal_error *error);

#endif /* DAL__ALONG_H */
