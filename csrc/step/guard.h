/* guard.h - data of the estimate of the error of a run. */
#ifndef DAL__GUARD_H
#define DAL__GUARD_H

#include "dalembert.h"

enum { DAL__MARKS = 16 };
/* The estimate of the error of a run (run/guard.c).  Numbers of steps are those of the run. */
typedef struct dal__guard {
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
} dal__guard;
/* Reset the estimate: there is none. */
void dal__guard_forget(dal_stepper *stepper);

#endif /* DAL__GUARD_H */
