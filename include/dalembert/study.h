/* dalembert/study.h - measured orders of schemes, and schemes embedded in the flow of a perturbed
 * ODE.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_STUDY_H
#define DALEMBERT_STUDY_H

#include <dalembert/geometry.h>

DAL_BEGIN_DECLARATIONS

/* <cdef> */

/* ---- orders -------------------------------------------------------------------------- */

/* A fitted order: the errors of the points that count are proportional to h^slope. */
typedef struct dal_fit {
    double slope;    /* NaN if fewer than three points count */
    double spread;   /* largest difference of slopes between neighbours; above 0.25 the errors are
                        not yet a power of h */
    double finest;   /* slope between the two smallest h */
    size_t points;   /* number of points that count */
    int exact;       /* 1: every error is at the level of roundoff.  For the states in a study
                        moreover the errors of an order one less than promised would be larger */
} dal_fit;

/* The fits of a study. */
typedef enum dal_order_fit {
    DAL_FIT_STATE, DAL_FIT_MULTIPLIERS, DAL_FIT_REACTION, DAL_FIT_MIDPOINT,
    DAL_FIT_GLOBAL_Q, DAL_FIT_GLOBAL_V, DAL_FIT_GLOBAL_MULTIPLIERS, DAL_FIT_GLOBAL_STATE
} dal_order_fit;

/* One step size of a study.  Errors are largest components of differences. */
typedef struct dal_order_point {
    double h;
    size_t steps;
    double q, v, multipliers;         /* errors at t_end; multipliers are those of
                                         dal_multipliers */
    double local_state;               /* error of (q, v) after one step from exact data (porder) */
    double local_multipliers;         /* error of lambda(q, v) after that step */
    double local_reaction;            /* the scheme's own multiplier of that step, compared with
                                         lambda(t0 + h) (pdisc) */
    double local_midpoint;            /* the same, compared with lambda(t0 + h/2) */
    double residual, residual_eps;    /* worst relative residual of D and of D_eps over the run;
                                         residual_eps is NaN for a scheme with several sub-steps */
    double energy;                    /* max |E - E0| / max(|E0|, 1) over the run */
    int failed;                       /* status of the run; if nonzero, the errors are NaN */
    unsigned counted;                 /* bit 1 << k is set if the point counts in the dal_order_fit
                                         k */
} dal_order_point;

typedef struct dal_order {
    dal_fit state;        /* slope - 1 is p */
    dal_fit multipliers;  /* slope - 1 is the order of lambda(q, v), which should be p */
    dal_fit reaction;     /* slope - 1 is s of (p, s), as in the paper.  The fit uses the finer half
                             of the steps, because of an h^2 term at any order */
    dal_fit midpoint;     /* slope - 1 is the order of the reaction at the middle of the step */
    dal_fit global_q, global_v, global_multipliers; /* slopes at t_end */
    dal_fit global_state;                           /* slope of the larger error of q and v */
    double p, s;          /* state.slope - 1, reaction.slope - 1 (firstorder, secondorder) */
    double floor;         /* errors at t_end below 100 floor do not count.  The floor is higher for
                             runs of many sub-steps, and lower for one-step errors */
    double reference;     /* accuracy of the reference solution; 0 for an exact one */
    int keeps_D, keeps_D_eps; /* 1: residual within 4 n u after every step of every run */
    int holds;            /* the verdict. 1: the promise holds.  The set of the nodes is preserved;
                             s >= multiplier_order - 0.2 (or exact); p or the slope at t_end is at
                             least order - 0.2 (or exact).  Slopes that still change must be within
                             0.75 of it at the smallest h. (One-step errors of high orders can reach
                             roundoff before their slope settles.) 0: it does not hold.  A slope
                             that has settled falls short by more than 0.75, and so does the other
                             one, or the slope of its two smallest h. -1: the scheme promises
                             nothing. -2: undecided.  Too few points count; or a slope that has not
                             settled falls short; or the slope at t_end falls short, that of one
                             step does not; or the runs do not resolve the solution.  The last case
                             is an error at t_end above half of the largest component of the states,
                             or a failed run with a smaller step. -3: not measurable in double
                             precision.  It would be -2, and the errors of smaller h are roundoff.
                             With DAL_INITIAL_D the promise for the first step is (order - 1,
                             multiplier_order - 1), and order at t_end (E12) */
    char text[508];       /* the verdict in words */
} dal_order;

/* The runs of a study. */
typedef struct dal_order_def {
    double t0, t_end;
    const double *x0;           /* [2n] in D (for DAL_INITIAL_D_EPS it is moved to D_eps) */
    const size_t *steps;        /* [count] numbers of steps over t_end - t0 */
    size_t count;
    dal_initial initial;        /* start of runs with kept nodes */
    double tolerance;           /* tolerance of the flow, if there is no exact solution; 0: 1e-13 */
    dal_watch_fn watch;         /* or NULL; called with the number of steps taken in all runs */
    void *watch_ctx;
} dal_order_def;

/* Returns the name of the cheapest scheme of order 2 for system.  It is "midpoint" if M depends on
 * q, the constraints are affine or nonlinear, or a force may depend on v.  Otherwise, and for NULL,
 * it is "leapfrog", whose pair of sub-steps is then solved as one stage. */
DAL_API const char *dal_scheme_usual(const dal_system *system);

/* Refines the step size of scheme on system, and writes points[count] and *order.  A run that fails
 * is a failed point, not a failed study.
 * Errors: DAL_EINVAL; DAL_ENOMEM; DAL_STOPPED (nothing is written); the errors of the reference
 * flow. */
DAL_API int dal_order_study(const dal_system *system, const dal_scheme *scheme,
                            const dal_order_def *def, dal_order_point *points, dal_order *order,
                            dal_error *error);

/* Fits the slope of log(error) over log(h) by least squares, for h[count] and errors[count].  Only
 * points with error > 100 floor count, at least three over a factor of two in h.  The array
 * counted[count] (or NULL) gets 1 for these points, 0 for the others. */
DAL_API void dal_fit_order(size_t count, const double *h, const double *errors, double floor,
                           dal_fit *fit, unsigned char *counted);

/* ---- runs: embedding --------------------------------------------------------------------- */

/* A scheme Phi of order p and step h as the period map of a flow that is perturbed periodically in
 * time.  Let xi be the coordinates of a chart, f the field of the ODE on D in them and F its flow.
 * There is a 1-periodic g(tau, xi), bounded as h -> 0, such that Phi is the time-h map of
 *     xidot = f(xi) + h^p g(t/h, xi)          (pertODE, propoDisc; on D: Coro, perturbedNhODExi).
 * As h -> 0 it tends to -chi_0'(tau) d(xi), d the error constant of dal_embedding_limit.  With p +
 * 1 in place of p, g grows as 1/h; with p - 1, it tends to 0.  So g measures p (porder, pdisc). */
typedef struct dal_embedding dal_embedding;

typedef struct dal_embedding_def {
    const dal_scheme *scheme; /* any scheme; for kept nodes the moved-node map is embedded, which is
                                 conjugate by (q, v) -> (q - (1-beta) h v, v) */
    double h;                 /* the period, not 0 */
    int order;                /* p; 0: the order of the scheme */
    double tolerance;         /* tolerance of the flow; 0: 1e-14 */
    int numerical;            /* 1: use the reference flow even if there is an exact solution */
} dal_embedding_def;

/* Creates an embedding.
 * Errors: DAL_EINVAL; DAL_ENOMEM; DAL_EUNSUPPORTED (a system with a force, or time_dependent). */
DAL_API int dal_embedding_new(dal_embedding **embedding, const dal_system *system,
                              const dal_embedding_def *def, dal_error *error);
DAL_API void dal_embedding_free(dal_embedding *embedding);
DAL_API const dal_error *dal_embedding_error(const dal_embedding *embedding);

/* Returns the chart of the coordinates xi in the functions below, borrowed.  Call dal_chart_choose
 * for it first. */
DAL_API dal_chart *dal_embedding_chart(dal_embedding *embedding);
/* Sets a progress callback for all computations with the embedding; NULL removes it.  Its argument
 * is the number of steps of the scheme in dal_embedding_curve. */
DAL_API void dal_embedding_watch(dal_embedding *embedding, dal_watch_fn watch, void *ctx);
/* Returns p. */
DAL_API int dal_embedding_order(const dal_embedding *embedding);
/* Returns the approximate noise in g: the accuracy of the flow (4 u for an exact solution) times
 * h^-(p+1).  If g is not larger, its values are roundoff. */
DAL_API double dal_embedding_noise(const dal_embedding *embedding);

/* Errors of the functions below: DAL_EINVAL (also before the choice of the chart); the errors of
 * charts, flows and steps; DAL_ENOCONV if h is too large.  The time tau is in units of h. */

/* Computes a point of the curve that starts in y[2n-m]: G[2n-m] <- G~(tau, y), 0 <= tau <= 2^53
 * (Gdef, Gtilde, period0).  The curve passes through Phi(y) at tau = 1, Phi(Phi(y)) at tau = 2,
 * ..., with one step for each. */
DAL_API int dal_embedding_curve(dal_embedding *embedding, double tau, const double *y, double *G);

/* Computes y[2n-m] <- the start of the curve that passes through z[2n-m] at tau - floor(tau)
 * (ztilde). */
DAL_API int dal_embedding_source(dal_embedding *embedding, double tau, const double *z, double *y);

/* Computes g[2n-m] at (tau, z[2n-m]) (gdefinition, period1).  The Jacobian of dal_chart_jacobian
 * maps g to a vector tangent to D (tildeg). */
DAL_API int dal_embedding_field(dal_embedding *embedding, double tau, const double *z, double *g);

/* Computes d[2n-m] <- (Phi(z) - F(h, z)) / h^(p+1). */
DAL_API int dal_embedding_limit(dal_embedding *embedding, const double *z, double *d);

/* Integrates z[2n-m] from t0 to t1 along the perturbed ODE, with a tolerance of 1e-12. */
DAL_API int dal_embedding_flow(dal_embedding *embedding, double t0, double t1, double *z);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_STUDY_H */
