/* step.h - schemes, and what makes their steps. */
#ifndef DAL__STEP_H
#define DAL__STEP_H

#include "dalembert/family.h"
#include "discrete/discrete.h"
#include "ground/archive.h"

/* Those that the build list names, the one of records without a family first; NULL at the end. */
extern const dal_family *const dal__families[];
const dal_family *dal__scheme_family(const dal_scheme *scheme);

/* The decimal number at the start of text, *end behind it; NaN if there is none.  strtod would want
 * the decimal point of the host's locale. */
double dal__parse_number(const char *text, const char **end);

/* The sub-steps of a record: its own, or the only one {beta, 1}. */
size_t dal__scheme_count(const dal_scheme *scheme);
dal_substep dal__scheme_substep(const dal_scheme *scheme, size_t j);
/* DAL_EINVAL unless the record has what all families know: moved nodes, no sub-steps. */
int dal__scheme_check_plain(const dal_scheme *scheme, const char *family, dal_error *error);
/* A number of system and scheme, but for callbacks and what is behind data. */
double dal__scheme_identify(const dal_system *system, const dal_scheme *scheme);
/* A number of a text. */
double dal__digest_text(const char *text);

/* One beta-step of any system by the full Newton iteration on all n + m unknowns. */
typedef struct newton {
    size_t n, m;
    int max_iterations;
    bool warm;                      /* the last step is a guess for the next */
    double *rate, *lambda;          /* [n], [m] its (v' - v)/h and kappa/h */
    double *z, *step, *x;           /* [n+m] w and kappa, [n+m], [2n] */
    double *R1, *R2, *B;            /* [n], [m], [m*n] */
    dal__linear K, S;               /* of n and of m equations */
    double *y, *KZ, *r;             /* [n], [m*n], [m] */
    double inverse;                 /* log2 of 1/|det S| of the last one */
    dal_mechanics *mech;            /* of the step that is being solved */
    dal_stats *stats;
    dal_mechanics whole;            /* which makes it, with all entries and K, of curved systems */
} newton;

void dal__newton_reserve(newton *solver, const dal_system *system, arena *a);
void dal__newton_bind(newton *solver, const dal_system *system, int max_iterations);
/* Forgets the last step. */
void dal__newton_forget(newton *solver);
/* The last step, as save and restore of a family; of a solver without memory there is none. */
size_t dal__newton_save(const newton *solver, double *values);
void dal__newton_restore(newton *solver, const double *values);
/* One beta-scheme with step h (of either sign) at time t from x[2n], in place; kappa[m] = h lambda.
 * end, alpha, kept: as in dal__step_begin.  What was done is added to stats; the text of a failure
 * is in mech->error. */
int dal__newton_step(newton *solver, dal_mechanics *mech, double t, double end, double alpha,
                     double beta, double h, bool kept, double *x, double *kappa, dal_stats *stats);

/* Whether the energy jumps (jump.c): looked at now and then, never where something does work or
 * depends on time, or by schemes of order 1, which drift by design. */
typedef struct dal__jump {
    bool looking;
    double shift, energy, kinetic; /* of the states' D_eps; at the start; the largest seen */
    size_t step;                   /* where the energy was seen to have jumped; 0: nowhere */
    double change;                 /* by how much */
    double undone;                 /* what else it would have changed by: see scaling.c */
    double strayed;                /* the largest change that was seen */
} dal__jump;
/* The errors of the callbacks; then only DAL_EUSER.  The text is in mech->error. */
int dal__jump_start(dal__jump *jump, dal_mechanics *mech, int order, double shift,
                    const double *x);
int dal__jump_look(dal__jump *jump, dal_mechanics *mech, size_t step, const double *x);
void dal__jump_save(dal__jump *jump, dal__archive *a);

/* Where a motion was. */
typedef struct dal__place {
    double t, h, worst, undone; /* worst_residual; of the jump */
    size_t first, scaled, unscaled;
    double *x;               /* [2n+m] with the impulse */
    double *memory;          /* what the family saves */
} dal__place;
void dal__place_reserve(dal_stepper *stepper, dal__place *place, arena *a);
void dal__remember(dal_stepper *stepper, dal__place *place);
void dal__go_back(dal_stepper *stepper, const dal__place *place);

/* Steps that keep the energy (scaling.c), whatever controls their size. */
typedef struct dal__scaling {
    bool wanted;
    double energy;     /* that is kept */
    dal__place before; /* a step */
    arena arena;
} dal__scaling;
/* What the options say of them; DAL_EINVAL, DAL_EUNSUPPORTED. */
int dal__scaling_make(dal_stepper *stepper, const dal_options *options, dal_error *error);
/* *energy <- that of x[2n], where they start, which is 0 where they are not wanted.  The errors of
 * the callbacks, DAL_EUNSUPPORTED; the text is in mech->error. */
int dal__scaling_start(dal_stepper *stepper, const double *x, double *energy);
/* DAL_EUNSUPPORTED, in the name of who asks, unless L is of second degree in v at x[2n]; the text
 * is in mech->error.  The errors of the callbacks. */
int dal__check_degree(dal_mechanics *mech, double t, const double *x, const char *name);
/* Steps of motion->h by the scheme, up to so many, which keep the energy if that is wanted; *made
 * <- how many.  The caller counts them.  The error is in motion->error. */
int dal__scheme_steps(dal_stepper *stepper, size_t steps, size_t *made);

/* A control determines the size of the steps.  Each is a file, and control.c lists them; its data
 * are stepper->controlled. */
typedef struct dal__control {
    const char *name;        /* "steps of fixed size" */
    bool varies;             /* each step begins where the one before ended, and has its own size;
                                a run of them is for a time, stepper->until, not for a number */
    /* Whether the options ask for it: the first that says so is made. */
    bool (*wanted)(const dal_options *options);
    /* NULL: nothing to be made.  DAL_EINVAL, DAL_EUNSUPPORTED. */
    int (*make)(dal_stepper *stepper, const dal_options *options, dal_error *error);
    /* DAL_EINVAL in stepper->error unless steps may begin at t with h, infinite if the control is
     * to find it. */
    int (*check)(dal_stepper *stepper, double t, double h);
    /* *first <- the size of a first step from the consistent x[2n] at t, by h.  Nothing changes on
     * failure.  The errors of the field, whose text is in mech->error.  NULL: it is h. */
    int (*start)(dal_stepper *stepper, double t, double h, const double *x, double *first);
    /* As dal__scheme_steps. */
    int (*step)(dal_stepper *stepper, size_t steps, size_t *made);
    /* The state has become another one.  NULL: it does not matter. */
    void (*land)(dal_stepper *stepper);
    /* The data that the next step depends on.  NULL: none. */
    void (*save)(dal_stepper *stepper, dal__archive *a);
} dal__control;
extern const dal__control dal__fixed_steps, dal__controlled_steps, dal__reversible_steps;
const dal__control *dal__control_of(const dal_options *options);

/* Data that the controls of steps of varying size share (vary.c). */
typedef struct dal__vary {
    dal__place before;       /* a step */
    arena arena;             /* of what the control has made, too */
} dal__vary;
/* Memory for all that a control has reserved in stepper->vary.arena, and for the place before. */
int dal__vary_make(dal_stepper *stepper, dal_error *error);
/* The step of such a control: one step by step(stepper), whose next size is *h before and after it.
 * First it checks that steps still lead on, and that C keeps its rank where they become short. */
int dal__vary_advance(dal_stepper *stepper, int (*step)(dal_stepper *stepper), const double *h,
                      size_t *made);
/* A step of h from t, where the stepper stands; the caller counts it. */
int dal__vary_step(dal_stepper *stepper, double t, double h);
/* Whether a step failed for a reason that a shorter one would not have. */
static inline bool dal__is_final(int status)
{
    return status == DAL_EUSER || status == DAL_STOPPED || status == DAL_EINVAL;
}
/* The step from t that ends at the time where one is to end. */
double dal__vary_last(const dal_stepper *stepper, double t);

/* Steps of the motion that are computed again with another h (remake.c). */
typedef struct dal__remake {
    dal__place here, there; /* of the motion; of the other steps, between two calls */
    dal_stats stats;        /* the rest of the motion */
    size_t calls[4], steps, paused; /* the last: of the other steps */
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
/* The estimate of the error of a run (run/guard.c).  Numbers of steps are those of the run. */
typedef struct dal__guard {
    const dal_run *run;      /* the run that it belongs to */
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

struct dal_stepper {
    dal_motion motion;
    const dal_family *family;
    void *method;          /* what the family made */
    dal_scheme scheme;
    double identity;       /* a number of its system and scheme, to tell others apart by */
    double shift;          /* 1 - beta of kept nodes, else 0 */
    dal_mechanics mech;
    dal_stats stats;
    double *fresh;         /* [2n] initial data being examined */
    double *applied;       /* [inputs] in whose D the state is, if constraints depend on them */
    dal__jump jump;
    struct dal__guards guards;
    const dal__control *control;
    void *controlled;      /* what it has made */
    double until;          /* a time at which a step is to end, or infinite */
    dal__vary vary;
    dal__scaling scaling;
    dal__remake remake;
    dal__guard guard;
    bool started;
    dal_error error;
    arena arena;
};

/* DAL_EINVAL unless it is started; unless steps of h lead on from t0. */
int dal__stepper_started(dal_stepper *stepper);
int dal__stepper_check_times(dal_stepper *stepper, double t0, double h);
/* 1, or -1 if its steps, of a stepper that is started, lead back. */
static inline double dal__stepper_ahead(const dal_stepper *stepper)
{
    return stepper->motion.h > 0.0 ? 1.0 : -1.0;
}
/* dal_advance in parts, of a stepper that is started: the steps, whose impulses are added up, fewer
 * where those whose size varies are to end; the mean reaction over the time that has passed. */
void dal__stepper_forget_impulse(dal_stepper *stepper);
int dal__stepper_advance(dal_stepper *stepper, size_t steps, size_t *made);
/* Before a step: where inputs have changed D the velocity jumps into it; the impulse of the jump is
 * added to those of the steps.  The errors of dal_project. */
int dal__stepper_turn(dal_stepper *stepper);
int dal__stepper_reaction(dal_stepper *stepper, double elapsed, double *reaction);
/* The state after the last step becomes x[2n], from where the motion is another one: the predictor
 * is forgotten, and the energy is that from now on; kept: that which is kept, if one is.  The
 * errors of the callbacks. */
int dal__stepper_land(dal_stepper *stepper, const double *x, double kept);
/* Looks at the energy of the state now.  DAL_EUSER. */
int dal__stepper_look(dal_stepper *stepper);
/* Has the steps of a beta-scheme made by the compilation for any sizes: for tests. */
void dal__beta_any_sizes(dal_stepper *stepper);

#endif /* DAL__STEP_H */
