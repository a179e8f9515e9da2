/* algebra.h - dense linear algebra, Newton's iteration, ordinary differential equations. */
#ifndef DAL__ALGEBRA_H
#define DAL__ALGEBRA_H

#include "ground/ground.h"

double dal__dot(size_t n, const double *a, const double *b);
/* max |x_i|, 0 for n = 0; sum |x_i|. */
double dal__largest(size_t n, const double *x);
double dal__sum_of_sizes(size_t n, const double *x);

/* x, which may be NULL, becomes NaN: so an output that is never written is found as not finite. */
void dal__forget(size_t count, double *x);

/* y[rows] = A[rows*columns] x[columns]; y may not overlap. */
void dal__apply(size_t rows, size_t columns, const double *A, const double *x, double *y);

/* Lower Cholesky factor of the symmetric A[n*n] in place, and inverse[n] <- the diagonal of A^-1.
 * False if A is not positive definite, or is so ill-conditioned when it is scaled to a unit
 * diagonal that nothing is left of a solution: n trace(A_scaled^-1), which is not below the
 * condition, is above DAL_LU_CONDITION.  Then *row and *pivot (or NULL) say where. */
bool dal__cholesky(size_t n, double *A, double *inverse, size_t *row, double *pivot);
/* The rows of A[count*n] are rotated in pairs until they are orthogonal (one-sided Jacobi); then
 * their lengths are the singular values.  squares[count] <- their squares, for A divided by its
 * largest entry, which is returned; 0 for A = 0. */
double dal__singular_values(size_t count, size_t n, double *A, double *squares);

/* sizes[2*count] <- the sizes of rows and columns (see lu.h) of a matrix of which nothing is known
 * but scale[count*count], the sums of the absolute values of the terms of its entries. */
void dal__sizes(size_t count, const double *scale, double *sizes);

/* x[n] <- A^-1 x from the factor. */
void dal__cholesky_solve(size_t n, const double *factor, double *x);

/* Where Newton's iteration stands; the caller sets the first line. */
typedef struct dal__progress {
    int iteration;        /* from 1 */
    double scale, extent; /* roundoff of the unknowns is relative to scale; sum |q_i| of the point
                             that the equations are evaluated at, whose own rounding moves them */
    bool lagging;         /* something is wanted that is one step behind */
    double size, last;    /* of the last step, and of the one before */
    double first, travelled, reach; /* of the first; of all together; how far they may lead */
} dal__progress;

typedef enum dal__verdict { DAL__GOING, DAL__DONE, DAL__LOST } dal__verdict;

/* After a step of size.  DONE: it is roundoff; or the next one would be, if it is smaller by the
 * same factor, unless something is lagging; or the steps are small and no longer shrink.  LOST: not
 * finite, or they lead farther than first / (1 - ratio), with the ratio of the second to the first,
 * at least 1/2: as far as they would if they went on to shrink so.  What lies beyond may be a
 * solution that no small h leads to (theorem of Newton and Kantorovich). */
dal__verdict dal__newton_judge(dal__progress *p, double size);
/* The last step is halved. */
void dal__newton_halve(dal__progress *p);
/* Of what is DONE where the determinant of the Newton matrix is negative.  As h goes to 0 it goes
 * to that of M and mu M^-1 mu^T, which is positive, so it has changed its sign on the way. */
#define DAL__BRANCH_TEXT \
    "Newton did not converge to the solution that small steps lead to but to another, where the " \
    "determinant of its matrix is negative: try a smaller h, unless the constraints lose rank here"
/* Of what is LOST but finite: travelled, first, scale. */
#define DAL__LOST_TEXT \
    "Newton did not converge: its steps lead away from the start, %.3g in all where the first " \
    "was %.3g, of %.3g; try a smaller h"

/* size equations in as many unknowns z.  at: residual[size], J[size*size] its derivative and the
 * scale of the entries of J (see lu.h); a status.  The sum |dz_i| over the first measured unknowns
 * decides, each times its per_unit if there is one, against sum |z_i| over the same + base of the
 * root; that and extent are 0 unless at sets them. */
typedef struct dal__equations {
    int (*at)(void *ctx, const double *z, double *residual, double *J, double *scale);
    void *ctx;
    size_t size, measured;
    const double *per_unit; /* [measured], or NULL */
    const char *singular; /* what to say if J is */
} dal__equations;

typedef struct dal__root {
    double *z, *residual, *step; /* [size]: z the guess, then the root */
    double *J, *scale, *sizes;   /* [size*size], [size*size], [5*size] */
    size_t *row;                 /* [size] */
    double base, extent;         /* see dal__progress */
} dal__root;

void dal__root_reserve(dal__root *root, size_t most, arena *a);
/* From the guess in root->z.  DAL_ESINGULAR, DAL_ENOCONV; what at returns is for at to explain,
 * after a step that led to DAL_EDOMAIN has been halved in vain. */
int dal__find_root(dal__root *root, const dal__equations *equations, dal_error *error);

/* dydt[N] <- the field at y[N], which is finite, and time t.  Returns 0, or a dal_status that it
 * has written to error with its text, error never NULL: DAL_EUSER and DAL_STOPPED end the
 * integration, after any other a shorter step is tried. */
typedef int (*dal__field_fn)(double t, const double *y, double *dydt, void *ctx, dal_error *error);

/* y' = field(t, y) by an adaptive method.  Time is t0 + elapsed, and elapsed time is what is
 * counted, so that short intervals lose no digits. */
typedef struct ode ode;

/* N >= 1; tolerance as of dal_flow_new; ctx is handed to the field.  DAL_EINVAL, DAL_ENOMEM.
 * GSL's workspace is made here and never later, see rule 7 of the header. */
/* Whether a flow may be asked for this tolerance. */
int dal__check_tolerance(double tolerance, dal_error *error);
int dal__ode_new(ode **integrator, size_t N, dal_flow_method method, double tolerance,
                 dal__field_fn field, void *ctx, dal_error *error);
void dal__ode_free(ode *self);

/* Ready to integrate from y[N] at t0 over about span, not 0, whose sign is the direction; factor
 * (1, or more: looser) is of the tolerance, up to 1 in all.  Errors of the field. */
int dal__ode_begin(ode *self, double t0, double span, const double *y, double factor,
                   dal_error *error);
/* From here on, until the next beginning, no step is longer; the first one is shorter too.  So it
 * looks at the field elsewhere than without. */
void dal__ode_shorten(ode *self, double longest);
/* The same from where it stands, after its state was changed, towards elapsed time end. */
int dal__ode_restart(ode *self, double end, dal_error *error);

/* Takes the state to elapsed time end, from where it stands in the direction it began with; or one
 * accepted step of that way, none at the end of it.  Steps end at end.  The field's errors where
 * no step is short enough, DAL_ENOCONV (the step size collapsed, or millions of steps did not do;
 * single steps are not counted).  After an error the state is that of the last accepted step, and
 * integration begins anew. */
int dal__ode_reach(ode *self, double end, dal_error *error);
int dal__ode_step(ode *self, double end, dal_error *error);

double *dal__ode_state(ode *self); /* [N]; whoever changes it restarts */
double dal__ode_elapsed(const ode *self);
size_t dal__ode_evaluations(const ode *self); /* of the field, since it was made */

#endif /* DAL__ALGEBRA_H */
