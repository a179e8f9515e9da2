/* events.h - a step that is looked into.
 *
 * It is looked at in spans: the whole of it, or, after a reset, what is left.  Within a span a
 * place is a part theta of the step, and its state is a step of the scheme from where the span
 * begins. */
#ifndef DAL__EVENTS_H
#define DAL__EVENTS_H

#include "dalembert/events.h"
#include "step/along.h"
#include "step/stepper.h"
#include "step/taylor.h"

#include <gsl/gsl_roots.h>

enum { DAL_MOST_RESETS = 100 }; /* within a step */

typedef struct guard {
    int side;        /* of zero that g is on: 1 or -1; 0: on zero */
    bool waits;      /* a reset sends it there, and it has not been seen there yet */
    bool due;        /* it crosses where the span begins: together with a reset, or */
    bool jumped;     /* with the velocity, where inputs have changed D */
    bool crossed;    /* in this span */
    size_t happened;
    double size;     /* the largest |g| seen */
    double near;     /* |g| at its last crossing, which the rounding of the time leaves */
    double begin, end; /* g at the ends of the span */
} guard;

typedef struct crossing {
    size_t event;
    double theta;
    int to;          /* the side */
} crossing;

typedef struct happening {
    size_t event;
    double t;
    double *x, *after; /* [2n] each */
    bool reset;
} happening;

struct dal_events {
    const dal_stepper *stepper; /* that of the run */
    dal_stepper *probe;         /* the scheme, with moved nodes */
    size_t count, n, m;
    dal_event *list;
    guard *guards, *before;     /* [count], and what they were before the step */
    double *saved, *impulse;    /* of the stepper before the step */
    size_t doubts_before;
    double t, h, shift;         /* of the step; the stepper's states are moved by shift v */
    double from, *begin, *end;  /* the span: where it begins, and the states at its ends */
    double *x, *line;           /* [2n] */
    double energy;              /* that the span keeps, if the steps do; how often the probe */
    size_t lost, unscaled;      /* could not: in its last step; in states that were taken from it */
    double *whole, *parts;      /* [m] the impulse of the span; the sum of those before it */
    dal__along **along;         /* [count] the series of events, or NULL */
    crossing *crossings;        /* [room] */
    size_t room;
    happening *happened;        /* [room_happened] in this step */
    size_t happenings, room_happened, resets;
    double rush_began;          /* since then resets have followed so fast on one another, and */
    size_t rush;                /* there were so many */
    double *states;             /* [room_happened*4n] those before and after */
    size_t step;                /* steps before it */
    size_t times_done;          /* of the run */
    bool landed;                /* a reset has led the step elsewhere */
    double *last;               /* [2n] the stepper's state there */
    bool known, valued;         /* sides are those of last; and so are values */
    gsl_root_fsolver solver;
    size_t doubts, doubt_event;
    double doubt_t, doubt_g;
    dal__watch watch;           /* that of the run */
    dal_error *error;
    arena arena;
};

/* theta in time; x[2n] <- the state there; *g <- an event at a state. */
double dal__time_at(const dal_events *e, double theta);
int dal__reach(dal_events *e, double theta, double *x);
int dal__event_value(dal_events *e, size_t event, double t, const double *x, double *g);
/* x[2n] in place <- the state after a step of the scheme, of any length; its impulse is that of the
 * probe. */
int dal__probe(dal_events *e, double t, double length, double *x);
/* *rate <- dg/dtheta at x, where g is known: the change along the tangent, whose acceleration is
 * the mean one of the span; over a short way ahead (1), or back (-1). */
int dal__event_rate(dal_events *e, size_t event, double theta, const double *x, double g,
                    double ahead, double *rate);
/* What is not more than this is a rounding of zero. */
double dal__event_rounding(const guard *g);
static inline int dal__sign(double x) { return (x > 0.0) - (x < 0.0); }

/* The crossings of the span, by time, and in the order of the list: e->crossings[*found]. */
int dal__find_crossings(dal_events *e, size_t *found);
/* The failure of a guard that was reset and does not leave zero; what: the words with a value. */
int dal__event_rests(dal_events *e, size_t event, const char *what, double value);

#endif /* DAL__EVENTS_H */
