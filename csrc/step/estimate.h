/* estimate.h - the estimate of the error of a run, by steps that are computed again. */
#ifndef DAL__ESTIMATE_H
#define DAL__ESTIMATE_H

#include "geometry/geometry.h"
#include "step/snapshot.h"

/* Steps of the motion that are computed again with another h (remake.c). */
typedef struct dal__remake {
    dal__snapshot here, there; /* of the motion; of the other steps, between two calls */
    dal_stats stats;        /* the rest of the motion */
    dal__calls calls;
    size_t steps, paused;   /* of the motion; of the other steps */
    double *input, *applied; /* [inputs] */
    dal_watch_fn watch;
    struct dal__guards guards; /* of the other steps: the run has its own */
    arena arena;
} dal__remake;
int dal__remake_make(dal_stepper *stepper, dal_error *error);
/* Save the motion; restore it. */
void dal__remake_begin(dal_stepper *stepper);
void dal__remake_end(dal_stepper *stepper);
/* Between the two: start with steps of h at x[2n] and t, a state of steps of `from`; compute so
 * many steps, false if one fails. */
void dal__remake_start(dal_stepper *stepper, double t, double from, const double *x, double h);
bool dal__remake_steps(dal_stepper *stepper, size_t steps);
/* Save the other steps before an end; resume them after the next begin. */
void dal__remake_pause(dal_stepper *stepper);
void dal__remake_resume(dal_stepper *stepper);

enum { DAL__MARKS = 16 };
/* The estimate of the error of a run (run/estimate.c).  Numbers of steps are those of the run. */
typedef struct dal__estimate {
    const struct dal_run *run; /* the run that it belongs to */
    bool on, over;           /* the run has an estimate; it is complete */
    bool checking;           /* the run is computed again */
    double ratio;            /* r: the size of the other steps is r h */
    bool failed;             /* a step of a window failed */
    double h, elapsed;
    size_t begin, seen;      /* the first step; when the sizes are updated next */
    double *low, *high;      /* [2n] */
    bool open;               /* whether a window is open, */
    size_t window, next;     /* its number of steps; the step where it begins */
    double window_t, *x;     /* [2n] the state there */
    size_t covered;          /* the step where the last one ended */
    double far_q, far_v;     /* the largest sizes there */
    double *sum, *rate;      /* [2n] errors up to there; error per step of the last window */
    double *error_of;        /* [2n] of the last comparison */
    size_t piece;            /* the first step of the piece that can be computed again, */
    double piece_t, *from;   /* [2n] its state there; */
    double *mark;            /* [DAL__MARKS][2n] states to compare with, */
    size_t marks, apart;     /* their number, the steps from one to the next */
    double worst;            /* the largest estimate at the marks */
    double sum_of_most;      /* the sum of the windows after MOST steps */
    size_t first, span, at;  /* computed again: the first step, how many, how many are done */
    double t;
    size_t looked, iterations; /* steps and iterations at the last look of the stepper; */
    double least_effort, most_effort; /* iterations a step between two of them */
    size_t remade;
    bool whole;
    double error;
} dal__estimate;
/* Reset the estimate: there is none. */
void dal__estimate_forget(dal_stepper *stepper);

#endif /* DAL__ESTIMATE_H */
