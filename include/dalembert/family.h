/* dalembert/family.h - what makes the steps of a scheme: for families of your own.
 *
 * A stepper owns the state, checks initial data, keeps the time, and says which step failed; a
 * family makes steps.  A scheme of your own is a dal_scheme whose family points to a constant
 * dal_family; tests/family_heun.c is one of thirty lines.  Beside beta (schemes.c has the list)
 * the library has the families pair and flow.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_FAMILY_H
#define DALEMBERT_FAMILY_H

#include <dalembert/geometry.h>

/* What is stepped.  A family changes x, impulse and stats, and may exchange where x points to. */
typedef struct dal_motion {
    const dal_system *system;
    const dal_scheme *scheme;  /* the stepper's copy; what it points to lives while make runs */
    dal_mechanics *mechanics;  /* of system, for whatever the family evaluates */
    int max_iterations;        /* of Newton in a step */
    double t0, h;              /* x is the state at t0 + (steps - first) h */
    size_t steps;              /* made since the start; the stepper counts them */
    size_t first;              /* 0; of steps whose size varies, which have an h each, steps */
    double *x;                 /* [2n] */
    const double *input;       /* [inputs] of the force over the next step; mechanics has them */
    double *impulse;           /* [m] h lambda of every step is added */
    double *estimate;          /* [2n] of error-controlled steps, one at a time; else NULL */
    dal_stats *stats;
    struct dal__guards *guards; /* the library's own */
    dal_watch_fn watch;        /* or NULL: asked by steps that may take long, with the time */
    void *watch_ctx;
    dal_error *error;          /* what went wrong in the last step, without its number: what
                                  mechanics says of itself is there */
} dal_motion;

/* A function that is NULL has nothing to do; advance is needed.  method is what make made. */
typedef struct dal_family {
    const char *name;
    const dal_scheme *schemes; /* [count] those with a name */
    size_t count;
    const char *help;          /* in words, the other names that parse knows */
    /* 1: *scheme <- the scheme of this name; 0: there is none */
    int (*parse)(dal_scheme *scheme, const char *name);
    /* Checks motion->scheme and makes what its steps need; later calls do not allocate. */
    int (*make)(void **method, dal_motion *motion, dal_error *error);
    void (*free)(void *method);
    /* x is new: forget what was remembered of steps. */
    void (*start)(void *method, dal_motion *motion);
    /* steps steps from x at t0 + (motion->steps - first) h; *done <- how many succeeded.  On
     * failure x and impulse are those after the last good one. */
    int (*advance)(void *method, dal_motion *motion, size_t steps, size_t *done);
    /* What the next step depends on beside x, to values and from them; save returns how many they
     * are, also for values NULL, or DAL_NOT_RESUMABLE. */
    size_t (*save)(const void *method, double *values);
    /* 1: save can have given these values, which are finite, for such a method; NULL: always */
    int (*accepts)(const void *method, const double *values);
    void (*restore)(void *method, const double *values);
    /* For error-controlled steps: *q <- advance puts an estimate of the error of q and v, which is
     * O(h^(q+1)), to motion->estimate if that is not NULL; 0: it has none.  *noise <- the roundoff
     * in it, in units of that of a state.  And motion->h is ratio times that of the step before:
     * what is remembered of steps is for this h from now on. */
    int (*estimates)(void *method, int *q, double *noise, dal_error *error);
    void (*rescale)(void *method, double ratio);
    /* For steps that keep the energy: v of x is another one, and q is not; forget what depends on
     * v, but for guesses.  NULL: they are refused. */
    void (*forget_velocity)(void *method);
    int no_reaction;           /* 1: its steps have no multiplier; reactions are NaN */
} dal_family;

/* What save returns where steps cannot be resumed. */
#define DAL_NOT_RESUMABLE ((size_t)-1)

#endif /* DALEMBERT_FAMILY_H */
