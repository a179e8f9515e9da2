/* dalembert/study.h - what the order of a scheme is, measured; and schemes embedded in the flow
 * of a perturbed ODE.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_STUDY_H
#define DALEMBERT_STUDY_H

#include <dalembert/geometry.h>

#ifdef __cplusplus
extern "C" {
#endif

/* <cdef> */

/* ---- orders -------------------------------------------------------------------------- */

/* A fitted order: errors ~ h^slope over the points that count. */
typedef struct dal_fit {
    double slope;    /* NaN if fewer than three points count */
    double spread;   /* by how much the slopes between neighbours differ: where it is more than
                        0.25 the errors are not yet a power of h */
    double finest;   /* the slope between the two smallest h */
    size_t points;   /* how many counted */
    int exact;       /* 1: every error is at the level of roundoff; of the states in a study, also
                        that those of one order less than promised would not be */
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
    double q, v, multipliers;         /* at t_end, against the reference; lambda(q, v) by lambdax */
    double local_state;               /* (q, v) after one step from exact data (porder) */
    double local_multipliers;         /* lambda(q, v) after that step */
    double local_reaction;            /* the scheme's own multiplier of that step against
                                         lambda(t0 + h) (pdisc) */
    double local_midpoint;            /* the same against lambda(t0 + h/2) */
    double residual, residual_eps;    /* worst relative residual of D and of D_eps over the run;
                                         residual_eps is NaN for a record with several sub-steps */
    double energy;                    /* max |E - E0| / max(|E0|, 1) over the run */
    int failed;                       /* status of the run; nonzero: the errors are NaN */
    unsigned counted;                 /* bit 1 << k: the point counted in the dal_order_fit k */
} dal_order_point;

typedef struct dal_order {
    dal_fit state;        /* slope - 1 is p */
    dal_fit multipliers;  /* slope - 1 is the order of lambda(q, v), which should be p */
    dal_fit reaction;     /* slope - 1 is s of (p, s), as in the paper; over the finer half of the
                             steps, because its h^2 term is there at any order */
    dal_fit midpoint;     /* slope of the reaction at the middle of the step, minus 1 */
    dal_fit global_q, global_v, global_multipliers; /* slopes at t_end */
    dal_fit global_state;                           /* that of the larger error of q and v */
    double p, s;          /* state.slope - 1, reaction.slope - 1 (firstorder, secondorder) */
    double floor;         /* of the errors at t_end: those below 100 floor do not count; it is
                             higher for runs of many sub-steps, and lower for one-step errors */
    double reference;     /* accuracy of the reference solution; 0 for an exact one */
    int keeps_D, keeps_D_eps; /* 1: residual within 4 n u after every step of every run */
    int holds;            /* the verdict: 1 if the set that the nodes promise is kept, s >=
                             multiplier_order - 0.2 (or exact), and p or the slope at t_end is at
                             least order - 0.2 or exact (the one-step errors of high orders can
                             reach roundoff before their slope settles); slopes that still change
                             must be within 0.75 of it at the smallest h.  0 if not: a slope that
                             has settled falls short by more than 0.75, and so does the other one,
                             or that of its two smallest h.  -1 if the record promises nothing; -2
                             if it is not settled: too few points count, a slope falls short that
                             has not settled, the slope at t_end falls short where that of one step
                             does not, or the runs do not resolve the solution (an error at t_end
                             beyond half of the largest component of its ends, or a run that failed
                             with a smaller step).  -3 if it is not measurable in double: so it
                             would be -2, and smaller h are no use, for their errors are
                             roundoff.  With DAL_INITIAL_D the promise for the first step is (order
                             - 1, multiplier_order - 1), and order at t_end (E12) */
    char text[508];       /* the verdict in words */
} dal_order;

/* What a study runs over. */
typedef struct dal_order_def {
    double t0, t_end;
    const double *x0;           /* [2n] in D (for DAL_INITIAL_D_EPS it is moved there) */
    const size_t *steps;        /* [count] numbers of steps over t_end - t0 */
    size_t count;
    dal_initial initial;        /* for kept nodes */
    double tolerance;           /* of the flow where there is no exact solution; 0: 1e-13 */
    dal_watch_fn watch;         /* or NULL; it sees the number of steps made, of all runs */
    void *watch_ctx;
} dal_order_def;

/* The name of the scheme of order 2 whose steps cost least on system.  "leapfrog", a pair of
 * sub-steps, is solved as one stage.  "midpoint" where that pair takes two: if M depends on q, the
 * constraints are affine or nonlinear, or a force may depend on v.  "leapfrog" for NULL. */
DAL_API const char *dal_scheme_usual(const dal_system *system);

/* Step-size refinement of scheme on system: points[count] and *order.
 * DAL_EINVAL, DAL_ENOMEM, DAL_STOPPED (nothing is written), and the errors of the reference flow.
 * A run that fails is a failed point, not a failed study. */
DAL_API int dal_order_study(const dal_system *system, const dal_scheme *scheme,
                            const dal_order_def *def, dal_order_point *points, dal_order *order,
                            dal_error *error);

/* The least squares slope of log(error) over log(h) for the points with error > 100 floor (at
 * least three over a factor of two in h).  h[count], errors[count]; counted[count] (or NULL) <- 1
 * for these points, 0 for the others. */
DAL_API void dal_fit_order(size_t count, const double *h, const double *errors, double floor,
                           dal_fit *fit, unsigned char *counted);

/* ---- runs: embedding --------------------------------------------------------------------- */

/* A scheme Phi of order p and step h is the period map of a flow that is perturbed periodically in
 * time: with xi the coordinates of a chart, f the field of the ODE on D in them and F its flow,
 * there is a 1-periodic g(tau, xi), bounded as h -> 0, such that Phi is the time-h map of
 *     xidot = f(xi) + h^p g(t/h, xi)          (pertODE, propoDisc; on D: Coro, perturbedNhODExi).
 * For h -> 0 it tends to -chi_0'(tau) d(xi), d the error constant of dal_embedding_limit.  With
 * p + 1 in place of p it grows as 1/h, with p - 1 it tends to 0: so it measures p (porder,
 * pdisc). */
typedef struct dal_embedding dal_embedding;

typedef struct dal_embedding_def {
    const dal_scheme *scheme; /* any record; of kept nodes the moved-node map is embedded, which is
                                 its conjugate by (q, v) -> (q - (1-beta) h v, v) */
    double h;                 /* the period, not 0 */
    int order;                /* p; 0: the order of the record */
    double tolerance;         /* of the flow; 0: 1e-14 */
    int numerical;            /* 1: the reference flow even where there is an exact solution */
} dal_embedding_def;

/* DAL_EINVAL, DAL_ENOMEM, DAL_EUNSUPPORTED (a system with a force, which may depend on
 * time, or one that is time_dependent). */
DAL_API int dal_embedding_new(dal_embedding **embedding, const dal_system *system,
                              const dal_embedding_def *def, dal_error *error);
DAL_API void dal_embedding_free(dal_embedding *embedding);
DAL_API const dal_error *dal_embedding_error(const dal_embedding *embedding);

/* The chart whose xi the functions below take and give: dal_chart_choose it first.  Borrowed. */
DAL_API dal_chart *dal_embedding_chart(dal_embedding *embedding);
/* Has watch asked by all that computes with the embedding, with the number of steps of the scheme
 * that dal_embedding_curve has made; NULL: nobody. */
DAL_API void dal_embedding_watch(dal_embedding *embedding, dal_watch_fn watch, void *ctx);
/* p. */
DAL_API int dal_embedding_order(const dal_embedding *embedding);
/* About how much of g is noise: the accuracy of the flow (4 u for an exact solution) times
 * h^-(p+1).  Where g is not larger, it says nothing. */
DAL_API double dal_embedding_noise(const dal_embedding *embedding);

/* Errors of the functions below: DAL_EINVAL (also where the chart has no choice yet), the errors of
 * charts, flows and steps, and DAL_ENOCONV where h is too large.  tau is in units of h. */

/* G[2n-m] <- the curve G~(tau, y) that starts in y[2n-m] and goes through Phi(y) at tau = 1,
 * through Phi(Phi(y)) at tau = 2, ..., a step for each; 0 <= tau <= 2^53 (Gdef, Gtilde,
 * period0). */
DAL_API int dal_embedding_curve(dal_embedding *embedding, double tau, const double *y, double *G);

/* y[2n-m] <- the start of the curve that goes through z[2n-m] at tau - floor(tau) (ztilde). */
DAL_API int dal_embedding_source(dal_embedding *embedding, double tau, const double *z, double *y);

/* g[2n-m] at (tau, z[2n-m]) (gdefinition, period1).  Its image in the state, a vector tangent to D,
 * is that of the Jacobian of dal_chart_jacobian (tildeg). */
DAL_API int dal_embedding_field(dal_embedding *embedding, double tau, const double *z, double *g);

/* d[2n-m] <- (Phi(z) - F(h, z)) / h^(p+1). */
DAL_API int dal_embedding_limit(dal_embedding *embedding, const double *z, double *d);

/* z[2n-m] at t0 -> at t1, along the perturbed ODE to a tolerance of 1e-12. */
DAL_API int dal_embedding_flow(dal_embedding *embedding, double t0, double t1, double *z);

/* </cdef> */

#ifdef __cplusplus
}
#endif
#endif /* DALEMBERT_STUDY_H */
