/* dalembert/stepper.h - end time, saved state and diagnostics of a stepper.  The rules of
 * dalembert.h hold. */
#ifndef DALEMBERT_STEPPER_H
#define DALEMBERT_STEPPER_H

#include <dalembert.h>

DAL_BEGIN_DECLARATIONS

/* If the error of dal_stats exceeds this, h is too large. */
#define DAL_LARGE_ERROR 0.05

/* <cdef> */
/* ---- steppers -------------------------------------------------------------------------- */

/* Sets the time at which error-controlled and reversible steps end exactly.  It applies until
 * another time, or an infinite one, is set.  A step from this time is DAL_EINVAL.  In a reversible
 * run only the last step is shortened, and it is not reversible; output times of a run do not
 * affect its steps.
 * Errors: DAL_EINVAL (not started; t has passed); DAL_EUNSUPPORTED (steps of size h). */
DAL_API int dal_stepper_until(dal_stepper *stepper, double t);

/* Save and restore all data that determine the following steps.  The first function returns their
 * number, 0 if the steps of the scheme cannot be resumed (multistep flows).  The second writes that
 * many values.  The third reads them, also into a stepper of the same system and scheme in another
 * process.  Its steps are then bitwise identical.  On failure the stepper is unchanged.
 * Errors: DAL_EINVAL (not started; data of another version, system or scheme; wrong count);
 * DAL_EUNSUPPORTED. */
DAL_API size_t dal_stepper_saved(const dal_stepper *stepper);
DAL_API int dal_stepper_save(dal_stepper *stepper, double *values);
DAL_API int dal_stepper_restore(dal_stepper *stepper, const double *values, size_t count);

/* Counters and diagnostics since the start. */
typedef struct dal_stats {
    size_t steps;
    size_t substeps;            /* sub-steps of the scheme; a fused pair counts as one */
    size_t iterations;          /* Newton iterations */
    size_t constraint_calls, potential_calls;
    size_t lagrangian_calls, force_calls;
    size_t evaluations;         /* evaluations of the vector field by the reference flow */
    size_t corrections;         /* final corrections that took an additional evaluation */
    size_t full_newtons;        /* sub-steps in which the modified Newton iteration was replaced by
                                   the full one, or, if all use the full one, it was restarted */
    size_t rejected;            /* error-controlled or reversible steps that were repeated with a
                                   shorter step */
    size_t uncontrolled;        /* error-controlled steps longer than the tolerance allows, because
                                   the estimate of their error is roundoff for any length */
    size_t scaled, unscaled;    /* for keep_energy: steps repeated with scaled velocities; plain
                                   steps that changed the energy because scaling was not possible,
                                   and states at events and output times with another energy */
    size_t resets;              /* irreversible steps of reversible runs, in which rho was reset to
                                   the rate of the motion.  Either rho had departed from it, or the
                                   step was repeated.  A smaller eps reduces their number.  Counted
                                   after the scales of rho are known */
    size_t halvings;            /* Newton steps halved because a callback left its domain */
    double worst_residual;      /* largest dal_relative_residual, after any step, of the set that
                                   the scheme preserves */
    double initial_residual;    /* relative residual of the data given to dal_stepper_start */
    double initial_correction;  /* distance by which these were moved, in the mass metric */
    unsigned differenced;       /* dal_missing: derivatives that were differenced */
    size_t jump_step;           /* the first step after which the energy was found changed, by jump,
                                   by more than half of the largest kinetic energy: h is too large.
                                   0 if there is none.  Changes undone by keep_energy count.  The
                                   energy is checked in every 64th step and at the end of
                                   dal_integrate.  It is not checked with a force, dependence on
                                   time, constraints that are not linear, or a scheme of order 1 */
    double jump, largest_kinetic;
    double least_pivot;         /* least pivot 1/(C^-1)_aa of C = mu M^-1 mu^T, relative to the
                                   largest pivot of the same row so far; 1 if none became smaller.
                                   Near 0 the constraints lose rank, and branches of the motion may
                                   meet.  Checked when variable steps are much shorter than usual.
                                   In steps of size h it is checked if det C decreases or the full
                                   Newton iteration is needed, but not for your own families */
    double least_pivot_t;       /* time of this pivot */
    size_t least_pivot_rows;    /* the sum of 2^a over the rows a < 52 that contribute to it; 0 if
                                   unknown */
    size_t rank_doubts;         /* number of checks at which a pivot was below the tolerance (ten
                                   times that of "reference"), or passes 0 within about two steps of
                                   h */
    double least_step;          /* shortest variable step, relative to the mean of the steps before
                                   it; 1 for steps of size h */
    double least_step_t;        /* when */
    double error;               /* approximate error of the state at the end of a run, relative to
                                   its size: the range of a q, the largest |v|.  It uses `remade`
                                   steps of another size.  With whole = 1 they repeat the run or its
                                   first 131072 steps; h is too large if the error exceeds
                                   DAL_LARGE_ERROR.  With whole = 0 they repeat samples; the sum of
                                   their errors usually exceeds the error.  With whole = 2 they
                                   repeat the steps since a reset or a resume; their error is
                                   reported only if it exceeds DAL_LARGE_ERROR.
                                   INFINITY: steps of h/2 failed, and those of h are suspect.
                                   NAN: no estimate, see dal_run */
    size_t remade, whole;
} dal_stats;

/* *stats <- those of the stepper. */
DAL_API void dal_stepper_stats(const dal_stepper *stepper, dal_stats *stats);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_STEPPER_H */
