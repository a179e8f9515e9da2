/* internal.h - what the files of csrc/ share and the header does not show.
 *
 * One section for each floor; a file calls only its own floor or lower ones.  Private functions
 * that cross files are called dal__name. */
#ifndef DALEMBERT_INTERNAL_H
#define DALEMBERT_INTERNAL_H

#include "dalembert.h"

#include <float.h>
#include <stdbool.h>
#include <stdint.h>

/* Unit roundoff u = 2^-53, and the bound on the residual of D (residual.h) after every step. */
#define DAL_ROUNDOFF (DBL_EPSILON / 2)
#define DAL_RESIDUAL_BOUND(n) (4.0 * (double)(n) * DAL_ROUNDOFF)
/* The same of initial data that are taken to be meant to lie in D. */
#define DAL_CONSISTENT 1e-8

#define DAL_LENGTH(array) (sizeof(array) / sizeof(array)[0])

/* ---- floor 0: status.c, arena.c --------------------------------------------------------- */

#if defined(__GNUC__)
__attribute__((format(printf, 3, 4)))
#endif
/* Writes the text (printf format) and the status to error, which may be NULL; returns status. */
int dal__fail(dal_error *error, int status, const char *format, ...);

/* DAL_EDOMAIN unless x[count], an output of this name, is NULL or finite. */
int dal__require_output(dal_error *error, const char *name, size_t count, const double *x);

/* Status of what a user's callback returned: 0, DAL_EDOMAIN for > 0, DAL_EUSER for < 0. */
int dal__callback_status(int returned);

/* Seconds, of the time of day: it may be set back or forward. */
double dal__clock(void);

/* A caller's watch, asked every so many seconds. */
#define DAL_WATCH_SECONDS 0.05
typedef struct dal__watch {
    dal_watch_fn function; /* or NULL */
    void *ctx;
    double asked;          /* when */
} dal__watch;

/* Asks the watch, unless that was done a moment ago.  DAL_STOPPED, DAL_EUSER. */
int dal__ask(dal__watch *watch, double far, dal_error *error);

/* A plan of arrays that share one allocation.  Usage: an arena {0}; dal__reserve for each array;
 * dal__allocate once; then the pointers are valid until dal__release. */
typedef struct arena {
    struct {
        void *slot; /* address of the pointer to set */
        size_t offset;
    } part[128];
    size_t parts, size;
    bool overflow;
    void *block;
} arena;

/* Plans count elements of size bytes for *slot (the address of a pointer to any object type). */
void dal__reserve(arena *a, void *slot, size_t count, size_t size);
/* The same of doubles for each of slot[slots]. */
void dal__reserve_doubles(arena *a, size_t slots, double **const slot[], size_t count);
/* Zero-filled memory for all that was reserved; DAL_ENOMEM. */
int dal__allocate(arena *a, dal_error *error);
void dal__release(arena *a);

/* a*b, or SIZE_MAX where that overflows. */
size_t dal__times(size_t a, size_t b);

bool dal__all_finite(size_t count, const double *x);

/* ---- floor 1: dense.c, roots.c, lu.h, ode.c --------------------------------------------- */

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

/* ---- floor 2: system.c, systems*.c, evaluator.c ----------------------------------------- */

struct dal_system {
    dal_system_def def;      /* the strings, mass and state point into the arena */
    double *mass;            /* M[n*n]; NULL for a general Lagrangian, as the next */
    double *mass_inverse;    /* M^-1[n*n] */
    double *unit, *per_unit; /* [n] d_i and 1/d_i of residual.h */
    bool diagonal;           /* M is diagonal */
    size_t parameters;       /* of a built-in system */
    const char *const *parameter_names;
    double *parameter_values;
    arena arena;
};

/* dal_system_new for a built-in system: names must be static, values are copied and become ctx. */
int dal__system_make(dal_system **system, const dal_system_def *def, size_t parameters,
                     const char *const *names, const double *values, dal_error *error);

/* dal_system_new with a ctx of size bytes that the system keeps a copy of. */
int dal__system_wrap(dal_system **system, const dal_system_def *def, const void *ctx, size_t size,
                     dal_error *error);

/* The callbacks of a system as the rest of the library calls them: derivatives that the user does
 * not give are differenced, calls are counted.  One evaluator for each thread.  potential and
 * constraint may be called directly with their ctx (the hot path does, and counts by itself). */
typedef struct evaluator {
    const dal_system *system;
    dal_potential_fn potential; /* NULL: V = 0 */
    void *potential_ctx;
    dal_constraint_fn constraint;
    void *constraint_ctx;
    bool constant_mass;
    double *point, *gradient, *forms; /* scratch of the differences: [n], [n], [m*n] */
    double time;                      /* where what does not move stands in a difference, */
    const double *position, *velocity; /* [n] */
    size_t potential_calls, constraint_calls, lagrangian_calls, force_calls;
} evaluator;

/* Where L and its derivatives are to go; what is NULL is not wanted.  As in dal_lagrangian_fn. */
typedef struct dal__jet {
    double *L, *L_q, *L_v, *L_qq, *L_vq, *L_vv;
} dal__jet;

void dal__evaluator_reserve(evaluator *e, const dal_system *system, arena *a);
void dal__evaluator_bind(evaluator *e, const dal_system *system);

/* Calls that check: status of the callback; DAL_EDOMAIN if an output is not finite.  The text
 * names the callback, the component and the value. */
int dal__potential(evaluator *e, const double *q, double *V, double *V_q, double *V_qq,
                   dal_error *error);
int dal__constraint(evaluator *e, const double *q, const double *v, double *phi, double *phi_v,
                    double *phi_q, dal_error *error);
/* Of every system: that of constant mass has the jet of v^T M v / 2 - V. */
int dal__lagrangian(evaluator *e, const double *q, const double *v, const dal__jet *jet,
                    dal_error *error);
/* Of every system: zeros where there is no force. */
int dal__force(evaluator *e, double t, const double *q, const double *v, double *f, double *f_q,
               double *f_v, dal_error *error);

/* f[count] at q; returns 0, or what its callback returned. */
typedef int (*dal__function)(const double *q, double *f, void *ctx);

/* slope[count], stride apart, <- df/dq_j at point[n] by central differences of order 4.
 * value[count] is scratch; point is moved and put back.  Returns what f returned, at once if that
 * is not 0. */
int dal__difference(dal__function f, void *ctx, double *point, size_t j, size_t count,
                    double *value, double *slope, size_t stride);
/* The distance of these points at a coordinate q. */
double dal__spacing(double q);

/* ---- floor 3: mechanics.c, step_equations.c, connection.c, curve.c, check.c -------------- */

/* A dal_mechanics may be part of another object: reserve in its arena, bind after allocation. */
struct dal_mechanics {
    evaluator eval;
    size_t n, m;
    double *phi;                  /* [m] */
    double *mu, *dmu;             /* [m*n]: phi_v and phi_q, that is mu(q) and d(mu v)/dq */
    double *Z;                    /* [m*n]: row a is M^-1 mu^a */
    double *C, *sizes;            /* [m*m], [5*m]: mu M^-1 mu^T or its factors; see lu.h */
    size_t *row;                  /* [m] */
    double *force, *q, *w, *step; /* [n] */
    double *lambda, *residual;    /* [m] */
    double *point;                /* [2n] of jump.c */
    double *hessian;              /* [n*n]: L_qq, or V_qq */
    double *L_vq, *f_q, *f_v;     /* [n*n]; NULL where nothing needs them */
    double *L_vv, *factor;        /* [n*n]: M where it is not constant, and its Cholesky factor */
    double *units, *per_units;    /* [n]: where M is not constant, what the next two point to */
    const double *unit, *per_unit; /* [n] d_i and 1/d_i of residual.h, */
    const double *metric;         /* [n*n] and M at the last point where it was asked for */
    /* of the equations of a step */
    double *momentum, *reach;     /* [n] L_v(q, v), h beta F(t, q, v) */
    double *node, *muk;           /* [n], [m*n] q_k, mu_k */
    double *trial, *chetaev, *bend; /* [n], [m*n], [n*n] of nonlinear constraints: where mu_k^T
                                       kappa is differenced, its value and its derivative */
    struct {
        double t, beta, h;
        bool kept;
        const double *v;          /* [n] */
        double base;              /* see dal__step_base */
    } start;                      /* of the step that dal__step_begin began */
    dal_error error;
    arena arena; /* used only by dal_mechanics_new */
};

void dal__mechanics_reserve(dal_mechanics *mech, const dal_system *system, arena *a);
void dal__mechanics_bind(dal_mechanics *mech, const dal_system *system);

/* The helpers of mechanics.c leave the text of their failure in mech->error. */

/* DAL_EINVAL unless x[count] is there and finite; name is that of the argument. */
int dal__require_finite(dal_mechanics *mech, const char *name, size_t count, const double *x);
int dal__null_argument(dal_mechanics *mech, const char *name);
/* M at (q, v) and what solving with it needs.  DAL_ESINGULAR if it is not positive definite. */
int dal__form_metric(dal_mechanics *mech, const double *q, const double *v);
/* y[n] <- M^-1 f[n], M that of the last dal__form_metric; y and f may not overlap. */
void dal__accelerate(const dal_mechanics *mech, const double *f, double *y);
/* Z <- the rows M^-1 mu^a. */
void dal__form_Z(dal_mechanics *mech, const double *mu);
/* The Cholesky factor of C = mu Z^T with the Z of mu. */
int dal__factor_gram(dal_mechanics *mech, const double *mu);
/* y[m] <- C^-1 y. */
void dal__solve_gram(const dal_mechanics *mech, double *y);
/* The residual of residual.h, the largest of all a, in the units of the last dal__form_metric. */
double dal__relative_residual(const dal_mechanics *mech, const double *mu, const double *phi,
                              const double *v);
/* Whether v is so near to D that it is meant to lie in it: |mu^a v| <= 1e-8 sum_i |mu^a_i v_i| + 4
 * n u s^a, with phi and a^a where residual.h has them. */
bool dal__is_consistent(const dal_mechanics *mech, const double *mu, const double *phi,
                        const double *v);
/* *E <- the energy at x[2n], which may overflow. */
int dal__energy(dal_mechanics *mech, const double *x, double *E);
/* Both, of x[2n] and the D or D_eps of shift. */
int dal__lies_in_D(dal_mechanics *mech, double shift, const double *x, double *relative,
                   bool *consistent);
/* w[n] moves along Z into D at q; *relative <- what is left of the residual, within its bound.  phi
 * and mu are those of (q, w), before and after.  DAL_ESINGULAR. */
int dal__mend(dal_mechanics *mech, const double *q, double *w, double *relative);

/* The equations of dal_step_equations in parts.  First what depends on t, beta, h and x alone,
 * which are those of that function and have been checked; kept: x is (q_k, v), the state of kept
 * nodes.  Then the rest, as often as needed; K_sizes[2*n]: those of the rows and columns of K (see
 * lu.h); mu_k is in mech->muk; outputs may be NULL.  At last x[2n] <- the new state, with w[n] the
 * velocity that was found, corrected so that phi at the q~' that x gives back is roundoff; the
 * residual raises *worst.  The x of dal__step_begin must stay until the last dal__step_at. */
int dal__step_begin(dal_mechanics *mech, double t, double beta, double h, bool kept,
                    const double *x);
int dal__step_at(dal_mechanics *mech, const double *w, const double *kappa, double *R1, double *R2,
                 double *K, double *K_sizes, double *B);
/* What the roundoff of w is relative to beside w: the sizes of v and of the terms of R1, as changes
 * of velocity, at the last dal__step_at that gave R1 and K.  They may be far larger than w: at
 * rest, where a reaction balances a force. */
double dal__step_base(const dal_mechanics *mech);
int dal__step_settle(dal_mechanics *mech, double *w, double *x, double *worst);

/* A chart of D, connection.c.  It may be part of another object, as a dal_mechanics may. */
struct dal_chart {
    dal_mechanics mech;
    size_t n, m, width;      /* width = 2n - m, that of xi */
    bool chosen;
    size_t *place;           /* [n]: the dependent coordinates, then the independent ones */
    double *branch;          /* [m] v_dependent where Newton starts */
    double *B, *B_sizes, *A; /* [m*m] factors, [5*m], [m*(n-m)] */
    size_t *row;             /* [m] */
    double *right, *solution; /* [m] */
    double *x, *y;           /* [2n] */
    double *tableau;         /* [m*n] */
    size_t *former, *owner;  /* [n], [m] */
    /* of dal_chart_step */
    double *w, *R1, *step;   /* [n] */
    double *R2, *kappa;      /* [m] */
    double *K, *G;           /* [n*n] */
    double *G_sizes;         /* [5*n] */
    double *slope;           /* [m*n] */
    size_t *G_row;           /* [n] */
    /* of dal_chart_interpolate */
    double *first, *second;  /* [3n] (q, v, vdot) at the ends of an interval */
    size_t *kept_place;      /* [n] the caller's choice */
    double *kept_branch;     /* [m] */
    size_t *last_place;      /* [n] that of the state before */
    arena arena;             /* used only by dal_chart_new */
};

void dal__chart_reserve(dal_chart *chart, const dal_system *system, arena *a);
void dal__chart_bind(dal_chart *chart, const dal_system *system);

/* dal_chart_lift without checking its arguments; for nonlinear constraints Newton starts at the
 * v_dependent that stands in x[2n].  On failure x is spoiled. */
int dal__chart_lift(dal_chart *chart, const double *xi, double *x);
/* dal_chart_drop, the same. */
void dal__chart_drop(const dal_chart *chart, const double *x, double *xi);
/* DAL_EINVAL unless there is a choice. */
int dal__chart_ready(dal_chart *chart);
/* Whether dal_chart_renew would keep the choice at x, and its condition. */
int dal__chart_keeps(dal_chart *chart, const double *x, double *condition, bool *keeps);

/* ---- floor 4: flow.c -------------------------------------------------------------------- */

/* dal_flow_apply over span, without checking its arguments and without the accuracy; the projection
 * onto D at the end only if project. */
int dal__flow_apply(dal_flow *flow, double t0, double span, double *x, bool project);

/* What a flow is made of, and the record that dal_flow_message reads. */
dal_mechanics *dal__flow_mechanics(dal_flow *flow);
double dal__flow_tolerance(const dal_flow *flow);
dal_error *dal__flow_error(dal_flow *flow);

/* ---- floor 5: difference_map.c, discrete_lagrangian.c, dla.c, exact_constraint.c ---------- */

/* Two nodes one step h apart, and the difference quotient w = (q1 - q0)/h, which may be known to
 * more digits than the nodes leave. */
typedef struct dal__pair {
    double h;
    const double *q0, *q1, *w; /* [n] */
} dal__pair;

/* A finite difference map, and what it gives at a pair. */
typedef struct dal__rho {
    dal_difference_map map;
    size_t n;
    double *g, *f;              /* [n] */
    double *g_0, *g_1;          /* [n*n] */
    double *f_0, *f_1;          /* [n*n] times h, so that they do not grow as h goes to 0 */
    double *point, *value, *slope; /* [2n], [2n], [2n*2n] of differenced derivatives */
} dal__rho;

void dal__rho_reserve(dal__rho *rho, const dal_difference_map *map, size_t n, arena *a);
/* After the allocation. */
void dal__rho_bind(dal__rho *rho);
/* g and f at the pair, and the derivatives if slopes. */
int dal__rho_at(dal__rho *rho, const dal__pair *pair, bool slopes, dal_error *error);
/* q0, q1 [n] <- the pair with rho(q0, q1) = x[2n]; root for 2n unknowns. */
int dal__rho_invert(dal__rho *rho, dal__root *root, double h, const double *x, double *q0,
                    double *q1, dal_error *error);

struct dal_discrete {
    dal_mechanics mech;
    size_t n, m;
    dal__rho lagrangian, constraint; /* of L_d, of D_d */
    dal__rho moved;                  /* of L_d too: its second derivatives are differenced */
    dal__root root;                  /* for 2n unknowns */
    double *q0, *q1, *w, *node;      /* [n] a pair of our own, and the node between two pairs */
    double *state;                   /* [2n] */
    double *force, *L_v;             /* [n] F = L_q + f and L_v at rho(pair) */
    double *minus, *plus;            /* [n] p^- and p^+ */
    double *L_qq, *L_vq, *L_vv, *f_q, *f_v; /* [n*n] */
    double *X, *X_scale, *Y, *Y_scale;      /* [n*n] products on the way to K */
    double *K, *K_scale;             /* [n*n] dp^-/dw */
    double *phi, *phi_v, *phi_q;     /* [m], [m*n], [m*n] at rho(pair) */
    double *B, *B_scale;             /* [m*n] d phi_d/dw */
    double *muk;                     /* [m*n] the forms along which the constraint reacts */
    double *point, *value, *bend;    /* [n], [n], [n*n] of differences by w or by q1 */
    struct {                         /* of the step that is being solved */
        double t, h;                 /* the time of the pair before */
        const double *node, *kappa;  /* [n] q_k; [m] */
    } step;
    double *momentum, *velocity;     /* [n] p^+_k; v_k */
    arena arena;
};

/* DAL_EINVAL unless h is finite and not 0; unless the nodes are finite too. */
int dal__discrete_step_size(dal_discrete *d, double h);
int dal__discrete_require(dal_discrete *d, double h, const char *name0, const double *q0,
                          const char *name1, const double *q1);
/* d->w <- (q1 - q0)/h; the pair. */
dal__pair dal__discrete_pair(dal_discrete *d, double h, const double *q0, const double *q1);
/* minus, plus [n] (or NULL) <- p^- = -D_1 L_d and p^+ = D_2 L_d, with the forces at time t of the
 * pair if forced; d->K if derivative. */
int dal__discrete_momenta(dal_discrete *d, double t, bool forced, const dal__pair *pair,
                          double *minus, double *plus, bool derivative);
/* d->phi, d->phi_v, and d->B if derivative. */
int dal__discrete_constraint(dal_discrete *d, const dal__pair *pair, bool derivative);

/* ---- floor 6: schemes.c, kernels.c and _large.c, finish.c, newton.c, multiroot.c, stepper.c */

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

#endif /* DALEMBERT_INTERNAL_H */
