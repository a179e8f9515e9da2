/* dalembert/family.h - the interface of families, which compute the steps of schemes.
 *
 * A stepper owns the state, checks initial data, counts time, and reports the step that failed; a
 * family computes steps.  To add a scheme, define a dal_scheme whose family points to a constant
 * dal_family; tests/family_heun.c is a short example.  The library has the families beta, pair and
 * flow.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_FAMILY_H
#define DALEMBERT_FAMILY_H

#include <dalembert/geometry.h>

/* The data of a stepper that a family works on.  A family changes x, impulse and stats, and may
 * replace the pointer x. */
typedef struct dal_motion {
    const dal_system *system;
    const dal_scheme *scheme;  /* the stepper's copy; the arrays that it points to are valid during
                                  make */
    dal_mechanics *mechanics;  /* mechanics of system, for the evaluations of the family */
    int max_iterations;        /* limit of Newton iterations in a step */
    double t0, h;              /* x is the state at t0 + (steps - first) h */
    size_t steps;              /* taken since the start, counted by the stepper */
    size_t first;              /* 0; for variable steps, each with its own h, equal to steps */
    double *x;                 /* [2n] */
    const double *input;       /* [inputs] of the next step; mechanics has them already */
    double *impulse;           /* [m]; add h lambda of every step */
    double *estimate;          /* [2n] for error-controlled steps, which are taken one at a time;
                                  else NULL */
    dal_stats *stats;
    struct dal__guards *guards; /* internal to the library, as is */
    struct dal__polynomials *kept;
    dal_watch_fn watch;        /* or NULL: to be called by long steps, with the time */
    void *watch_ctx;
    dal_error *error;          /* the failure of the last step, without the number of the step.
                                  Failures of mechanics are written here too */
} dal_motion;

/* A family of schemes.  All functions except advance may be NULL.  The argument method is the
 * object created by make. */
typedef struct dal_family {
    const char *name;
    const dal_scheme *schemes; /* [count] named schemes */
    size_t count;
    const char *help;          /* the other names that parse accepts, in words */
    /* Returns 1 and *scheme <- the scheme of this name, or 0 if there is none. */
    int (*parse)(dal_scheme *scheme, const char *name);
    /* Checks motion->scheme and allocates the data of its steps; the other functions do not
       allocate memory. */
    int (*make)(void **method, dal_motion *motion, dal_error *error);
    void (*free)(void *method);
    /* Discards all data of earlier steps, because x is new. */
    void (*start)(void *method, dal_motion *motion);
    /* Takes a number of steps from x at time t0 + (motion->steps - first) h; *done <- the number of
     * successful steps.  On failure x and impulse are those after the last successful step. */
    int (*advance)(void *method, dal_motion *motion, size_t steps, size_t *done);
    /* *end <- the time at which the next step ends if the family chooses its size, in a run to
     * until.  NULL: it has no steps of its own. */
    int (*own_end)(void *method, dal_motion *motion, double until, double *end);
    /* Save and restore all data besides x that determine the next step.  The function save returns
     * their number, also if values is NULL, or DAL_NOT_RESUMABLE. */
    size_t (*save)(const void *method, double *values);
    /* Returns 1 if these finite values can be a result of save for such a method.  NULL: always 1.
     */
    int (*accepts)(const void *method, const double *values);
    void (*restore)(void *method, const double *values);
    /* For error-controlled steps.  If motion->estimate is not NULL, advance writes an estimate of
     * the error of q and v to it.  The function estimates returns its order O(h^(q+1)) by *q, 0 if
     * there is no estimate.  *noise <- the roundoff in the estimate, in units of the roundoff of a
     * state.  The function rescale adapts the data of earlier steps to a motion->h that is ratio
     * times that of the step before. */
    int (*estimates)(void *method, int *q, double *noise, dal_error *error);
    void (*rescale)(void *method, double ratio);
    /* For steps that keep the energy: v in x has changed, q has not.  Discards data that depend on
     * v, except initial guesses.  NULL: such steps are not supported. */
    void (*forget_velocity)(void *method);
    int no_reaction;           /* 1: the steps have no multiplier; reactions are NaN */
} dal_family;

/* The result of save if steps cannot be resumed. */
#define DAL_NOT_RESUMABLE ((size_t)-1)

#endif /* DALEMBERT_FAMILY_H */
