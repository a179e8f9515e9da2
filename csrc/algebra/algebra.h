/* algebra.h - dense linear algebra, Newton's iteration, ordinary differential equations. */
#ifndef DAL__ALGEBRA_H
#define DAL__ALGEBRA_H

#include "dalembert/lu.h"
#include "dalembert/rows.h"
#include "ground/archive.h"
#include "ground/ground.h"

#include <math.h>
#include <string.h>

double dal__dot(size_t n, const double *a, const double *b);
/* max |x_i|, 0 for n = 0; max |x_i - y_i|, or NaN where one of them is; sum |x_i|. */
double dal__largest(size_t n, const double *x);
double dal__largest_difference(size_t n, const double *x, const double *y);
double dal__sum_of_sizes(size_t n, const double *x);

/* y[n] <- x, which may overlap; y[n], which may be NULL, <- 0; y[n] <- x + h v, where y may be x or
 * v; y[n] <- y + c x. */
static inline void dal__copy(size_t n, const double *x, double *y)
{
    if (n > 0) memmove(y, x, n * sizeof *y);
}

static inline void dal__clear(size_t n, double *y)
{
    if (y) memset(y, 0, n * sizeof *y);
}

static inline void dal__move(size_t n, const double *x, double h, const double *v, double *y)
{
    for (size_t i = 0; i < n; i++) y[i] = x[i] + h * v[i];
}

static inline void dal__add(size_t n, double c, const double *x, double *y)
{
    for (size_t i = 0; i < n; i++) y[i] += c * x[i];
}

/* x, which may be NULL, becomes NaN: so an output that is never written is found as not finite. */
static inline void dal__forget(size_t count, double *x)
{
    size_t i = 0;
    for (; x && i + 2 < count; i += 3) x[i] = x[i + 1] = x[i + 2] = (double)NAN;
    for (; x && i < count; i++) x[i] = (double)NAN;
}

/* A[n*n] <- (A + A^T)/2. */
void dal__symmetrise(size_t n, double *A);
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

/* G[m*m] is the Gram matrix of m rows that are scaled to length 1, or 0.  Pivots are chosen by what
 * is left of a row, the earliest of those of about the same size, as long as its square is above
 * least.  Returns the rank r; order[m] <- the r independent rows, then the others; row k >= r of G
 * <- the coefficients of row order[k] in those, and on the diagonal the square of what is left; of
 * k < r the pivots.  Rank 0 and order[0] = m if G is not finite. */
size_t dal__independent_rows(size_t m, double *G, double least, size_t *order);

/* x[n] <- A^-1 x from the factor. */
void dal__cholesky_solve(size_t n, const double *factor, double *x);

/* ---- polynomials --------------------------------------------------------------------------- */

enum { DAL_ROOTS_MOST = 40 };

typedef struct dal__sign_changes {
    size_t count;
    double at[DAL_ROOTS_MOST]; /* in (0, 1), in order */
    int first, last;           /* the sign after 0, and before 1; 0 if all values are noise */
    bool begins, ends;         /* with noise */
    double touch;              /* where the polynomial first comes to zero without such a change, or
                                  too close to tell; or NaN */
} dal__sign_changes;

/* The places where sum c_k s^k, k <= order <= DAL_ROOTS_MOST, changes its sign.  Values up to
 * noise, or up to the rounding of the sum, count as zero. */
void dal__find_sign_changes(size_t order, const double *c, double noise,
                            dal__sign_changes *found);

/* ---- linear equations ---------------------------------------------------------------------- */

/* A diagonal block, decoupled from the others, with all entries within width of the diagonal; or
 * with width = size, all of them stored. */
typedef struct dal__block {
    size_t begin, size, width;
    size_t offset; /* of its entries */
} dal__block;

/* Which entries of X Y^T may be other than 0, and where they are stored, for X and Y with the same
 * rows. */
typedef struct dal__pattern {
    size_t size, blocks, stored;
    dal__block *block;      /* [blocks] */
    size_t *order;          /* [size] row, and column, order[k] comes k-th */
    size_t *first, *column; /* [size+1] and [first[size]], as in a dal_rows; and */
    size_t *place;          /* the places of these entries */
    arena arena;
} dal__pattern;

/* DAL_ENOMEM. */
int dal__pattern_new(dal__pattern **pattern, const dal_rows *rows, dal_error *error);
void dal__pattern_free(dal__pattern *pattern);

/* As dal_lu_factor, and the other two, of a matrix A[m*length], see band.c. */
static inline size_t dal__band_length(size_t width) { return 3 * width + 1; }
int dal__band_factor(size_t m, size_t width, double *A, double *sizes, size_t *row);
void dal__band_solve(const dal_lu_factors *self, const double *b, double *x);
void dal__band_solve_transposed(const dal_lu_factors *self, double *b, double *x);

/* A regular matrix.  Set the sizes of its rows and columns with A, or by dal__linear_balance.  A
 * size smaller than the reserved one may be set first, except with a pattern. */
typedef struct dal__linear {
    size_t size;
    const dal__pattern *pattern; /* or NULL: all entries may be other than 0 */
    double *A;     /* [size*size] by rows, or [stored] by the pattern; then its factors */
    double *sizes; /* [2*size] of rows, then of columns, see lu.h; [5*size] with the scratch */
    size_t *row;   /* [size] */
    double *work;  /* [5*size] of a pattern */
} dal__linear;

void dal__linear_reserve(dal__linear *self, size_t size, arena *a);
/* The same for a pattern, which it borrows; NULL: all entries. */
void dal__linear_reserve_pattern(dal__linear *self, size_t size, const dal__pattern *pattern,
                                 arena *a);
/* A <- X Y^T, of these rows where there is a pattern, else X[size*n], Y[size*n]. */
void dal__linear_multiply(dal__linear *self, const dal_rows *rows, size_t n, const double *X,
                          const double *Y);
/* The sizes of a matrix of which nothing is known but scale[size*size], the sums of the absolute
 * values of the terms of its entries. */
void dal__linear_balance(dal__linear *self, const double *scale);
/* The sign of the determinant; 0 if the matrix is singular, or NaN. */
int dal__linear_factor(dal__linear *self);
/* log2 of 1/|det A| by the factors. */
double dal__linear_log_inverse(const dal__linear *self);
/* x[size] <- A^-1 b, or A^-T b, where b is destroyed; x and b may not overlap, but be the same
 * where there is a pattern. */
void dal__linear_solve(const dal__linear *self, const double *b, double *x);
void dal__linear_solve_transposed(const dal__linear *self, double *b, double *x);
/* About the 1-norm of the inverse of the scaled matrix, of a pattern. */
double dal__linear_inverse_norm(const dal__linear *self);

/* ---- steps of a size of their own ------------------------------------------------------------ */

/* How an integrator that chooses the size of its steps advances (creep.c); zero at a start. */
typedef struct dal__creep {
    double count, length;   /* steps, and the sum of their sizes */
    double longest;
    double shortest, t;     /* the shortest beside the mean of those before; 0: none is; when */
    double mark;            /* the time `since` steps ago */
    size_t since;
} dal__creep;
/* A step has led to t, and the next would have the size |h|. */
void dal__creep_step(dal__creep *self, double t, double h);
/* Before each step, from t: DAL_ENOCONV if the last 10^4 have led nowhere, beside the longest one
 * and the span that is left. */
int dal__creep_check(dal__creep *self, double t, double span, dal_error *error);
void dal__creep_save(dal__creep *self, dal__archive *a);
static inline double dal__creep_shortest(const dal__creep *self)
{
    return self->shortest > 0.0 ? self->shortest : 1.0;
}
/* Whether |h| is much less than the mean. */
static inline bool dal__creep_is_short(const dal__creep *self, double h)
{
    return 2.0 * fabs(h) * self->count < self->length;
}

/* ---- Newton's iteration --------------------------------------------------------------------- */

/* Where Newton's iteration stands. */
typedef struct dal__progress {
    int iteration, halvings; /* the steps that were made; how often one was halved */
    double scale;  /* roundoff of the unknowns is relative to it */
    /* How far they move, to first order, when the point that the equations were evaluated at
     * becomes twice itself: times u, by the rounding of that point.  NULL: not at all. */
    double (*moves)(void *ctx);
    void *ctx;
    bool lagging;  /* something is wanted that is one step behind */
    double size, last;              /* of the last step, and of the one before */
    double first, travelled, reach; /* of the first; of all together; how far they may lead */
} dal__progress;

typedef enum dal__verdict { DAL__GOING, DAL__DONE, DAL__LOST } dal__verdict;

/* After a step of size.  DONE: it is roundoff; or the next one would be, if it is smaller by the
 * same factor, unless something is lagging; or the steps are small and no longer shrink.  LOST: not
 * finite, or they lead farther than first / (1 - ratio), with the ratio of the second to the first,
 * at least 1/2: as far as they would if they went on to shrink so.  What lies beyond may be a
 * solution that no small h leads to (theorem of Newton and Kantorovich).
 *
 * Small is 1e-11 of the scale, or 16 roundings of a point far from the origin: mu(q) turns by u |q|
 * mu' when q is rounded, and the unknowns with it.  Size, scale and moves are all measured in the
 * units of the unknowns, so no verdict depends on those of the coordinates. */
dal__verdict dal__newton_judge(dal__progress *p, double size);
/* Whether the equations are to be evaluated again, as they returned DAL_EDOMAIN after a step: then
 * z[size] has gone back half of it.  Not more than 40 times in all. */
bool dal__newton_halve(dal__progress *p, int status, size_t size, double *z, double *step);
/* Of what is DONE where the determinant of the Newton matrix is negative.  As h goes to 0 it goes
 * to that of M and mu M^-1 mu^T, which is positive, so it has changed its sign on the way. */
#define DAL__BRANCH_TEXT \
    "Newton converged to a spurious solution (the determinant of its matrix is negative): h is " \
    "probably too large. If a smaller h does not help, check whether the constraints lose rank here"

/* Equations for the unknowns z[size].  The caller has its own linear algebra: find_step sets step,
 * and what else is below it, or returns a status, which ends the iteration and is for find_step to
 * explain; but DAL_EDOMAIN, which leaves step as it is, only after a step was halved in vain.  The
 * sum of |dz_i| per_unit_i over the first measured unknowns decides, against that of z and base. */
typedef struct dal__newton dal__newton;
struct dal__newton {
    int (*find_step)(dal__newton *self);
    void *ctx;
    size_t size, measured, n;
    const double *per_unit; /* [n], used again for the next n unknowns */
    int most;               /* iterations; 0: 50 */
    bool lagging;
    const char *advice;     /* where it does not converge; NULL: try a smaller h */
    double *z, *step;       /* [size]: the guess, then the solution; the last step */
    double base;            /* 0 unless set */
    double (*moves)(void *ctx); /* see dal__progress */
    int sign;               /* of the determinant of the Newton matrix, if it should be positive */
    dal__progress progress; /* afterwards */
};

/* DAL_ENOCONV, with the text in error. */
int dal__newton_run(dal__newton *self, dal_error *error);

/* What equations whose Newton matrix has no structure need. */
typedef struct dal__root {
    double *z, *residual, *step; /* [J.size] */
    double *scale;               /* of J, see dal__linear_balance */
    dal__linear J;
} dal__root;

void dal__root_reserve(dal__root *root, size_t most, arena *a);
/* step <- -J^-1 residual; J is destroyed.  DAL_ESINGULAR, with this text. */
int dal__root_step(dal__root *root, const char *singular, dal_error *error);

/* dydt[N] <- the field at y[N], which is finite, and time t.  Returns 0, or a dal_status that it
 * has written to error with its text, error never NULL: DAL_EUSER and DAL_STOPPED end the
 * integration, after any other a shorter step is tried. */
typedef int (*dal__field_fn)(double t, const double *y, double *dydt, void *ctx, dal_error *error);

/* DAL_EDOMAIN: what, as "state", is not finite at time t. */
static inline int dal__not_finite(dal_error *error, const char *what, double t)
{
    return dal__fail(error, DAL_EDOMAIN, "the %s at t = %.17g is not finite", what, t);
}

/* The explicit method rk8pd, of order 8, for y' = field(t, y), y[N]. */
typedef struct dal__rk8pd {
    size_t N;
    dal__field_fn field;
    void *ctx;
    size_t evaluations;             /* of the field */
    double *start, *point, *slopes, *difference; /* workspace */
} dal__rk8pd;

void dal__rk8pd_reserve(dal__rk8pd *self, size_t N, arena *a);
/* y[N], at time t0 + elapsed with slope[N], <- the state after h, and step_error[N] <- its
 * difference to that of order 7; neither has been looked at.  Errors of the field, DAL_EDOMAIN:
 * y is as it was. */
int dal__rk8pd_step(dal__rk8pd *self, double t0, double elapsed, double h, double *y,
                    const double *slope, double *step_error, dal_error *error);

/* y' = field(t, y) by an adaptive method.  Time is t0 + elapsed, and elapsed time is what is
 * counted, so that short intervals lose no digits. */
typedef struct ode ode;

/* Whether a flow may be asked for this tolerance. */
int dal__check_tolerance(double tolerance, dal_error *error);
/* N >= 1; tolerance as of dal_flow_new; ctx is handed to the field.  DAL_EINVAL, DAL_ENOMEM.
 * GSL's workspace is made here and never later, see rule 7 of the header. */
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
/* The size of the next step; to begin with this size, at most span, instead of one guessed. */
double dal__ode_suggested(const ode *self);
void dal__ode_suggest(ode *self, double span, double size);
/* The same from where it stands, after its state was changed, towards elapsed time end. */
int dal__ode_restart(ode *self, double end, dal_error *error);
/* After a change so small that steps go on with the same size; of a method of single steps. */
int dal__ode_renew(ode *self, dal_error *error);

/* One accepted step towards elapsed time end, in the direction it began with, none at the end of
 * it; steps end at end.  The field's errors where no step is short enough, DAL_ENOCONV (the step
 * size collapsed).  After an error the state is that of the last accepted step, and integration
 * begins anew. */
int dal__ode_step(ode *self, double end, dal_error *error);

double *dal__ode_state(ode *self); /* [N]; whoever changes it restarts, or renews */
double dal__ode_elapsed(const ode *self);
size_t dal__ode_evaluations(const ode *self); /* of the field, since it was made */

#endif /* DAL__ALGEBRA_H */
