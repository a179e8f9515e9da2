/* step.h - schemes, and what makes their steps. */
#ifndef DAL__STEP_H
#define DAL__STEP_H

#include "discrete/discrete.h"

/* The compilation of the step routine to use for these sizes. */
dal_kernel_fn dal__kernel_for(size_t n, size_t m, dal_sizes sizes);
/* One for n = 7 and 8, m <= 4; else NULL. */
dal_kernel_fn dal__kernel_of_many(size_t n, size_t m);

struct dal_stage;
/* As finish of a dal_kernel. */
int dal__kernel_finish(struct dal_kernel *k, const struct dal_stage *s, bool solved);

/* The sub-steps of a record: its own, or the only one {beta, 1}.  DAL_EINVAL if the record is not
 * valid; the text says why. */
int dal__scheme_check(const dal_scheme *scheme, dal_error *error);
size_t dal__scheme_count(const dal_scheme *scheme);
dal_substep dal__scheme_substep(const dal_scheme *scheme, size_t j);

/* One beta-step of any system by the full Newton iteration on all n + m unknowns. */
typedef struct newton {
    size_t n, m;
    int max_iterations;
    bool warm;                      /* the last step is a guess for the next */
    double *rate, *lambda;          /* [n], [m] its (v' - v)/h and kappa/h */
    double *w, *kappa, *x;          /* [n], [m], [2n] */
    double *R1, *R2, *B;            /* [n], [m], [m*n] */
    double *K, *K_sizes;            /* [n*n], [5*n] */
    size_t *K_row, *S_row;          /* [n], [m] */
    double *y, *KZ, *step;          /* [n], [m*n], [n] */
    double *S, *S_sizes, *r, *d;    /* [m*m], [5*m], [m], [m] */
} newton;

void dal__newton_reserve(newton *solver, const dal_system *system, arena *a);
void dal__newton_bind(newton *solver, const dal_system *system, int max_iterations);
/* Forgets the last step. */
void dal__newton_forget(newton *solver);
/* One beta-scheme with step h (of either sign) at time t from x[2n], in place; kappa[m] = h lambda.
 * kept: as in dal__step_begin.  What was done is added to stats; the text of a failure is in
 * mech->error. */
int dal__newton_step(newton *solver, dal_mechanics *mech, double t, double beta, double h,
                     bool kept, double *x, double *kappa, dal_stats *stats);

/* The same by gsl_multiroot hybridsj. */
typedef struct multiroot multiroot;
int dal__multiroot_new(multiroot **solver, const dal_system *system, dal_error *error);
void dal__multiroot_free(multiroot *solver);
int dal__multiroot_step(multiroot *solver, dal_mechanics *mech, double t, double beta, double h,
                        bool kept, double *x, double *kappa, dal_stats *stats);

/* Whether the energy jumps (jump.c): looked at now and then, never where something does work, or by
 * schemes of order 1, which drift by design. */
typedef struct dal__jump {
    bool looking;
    double shift, energy, kinetic; /* of the states' D_eps; at the start; the largest seen */
    size_t step;                   /* where the energy was seen to have jumped; 0: nowhere */
    double change;                 /* by how much */
} dal__jump;
/* The errors of the callbacks; then only DAL_EUSER.  The text is in mech->error. */
int dal__jump_start(dal__jump *jump, dal_mechanics *mech, int order, double shift,
                    const double *x);
int dal__jump_look(dal__jump *jump, dal_mechanics *mech, size_t step, const double *x);

/* Looks at the energy of the state now.  DAL_EUSER. */
int dal__stepper_look(dal_stepper *stepper);
/* What a stepper was made of, and the record that dal_stepper_message reads. */
const dal_system *dal__stepper_system(const dal_stepper *stepper);
dal_error *dal__stepper_error(dal_stepper *stepper);

#endif /* DAL__STEP_H */
