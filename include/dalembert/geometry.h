/* dalembert/geometry.h - mechanics on D: energy, multipliers, projections, charts, the flow of
 * the ODE on D, and the examination of a system.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_GEOMETRY_H
#define DALEMBERT_GEOMETRY_H

#include <dalembert/deformation.h>

#ifdef __cplusplus
extern "C" {
#endif

/* <cdef> */

/* ---- examination ----------------------------------------------------------------------- */

/* A derivative compared with central differences, over a smaller and smaller distance until they
 * agree with it, or with each other. */
typedef struct dal_difference {
    double error;           /* worst |given - differenced| / (1 + |differenced|) */
    double given, expected; /* the two numbers at that entry */
    size_t row, column;
    int checked;            /* 0: not provided, or no entry was judged: nothing to compare */
    int wrong;              /* 1: the two numbers are not the same */
    size_t unjudged;        /* entries where differences do not converge: not compared */
} dal_difference;

/* What dal_system_check found at one point. */
typedef struct dal_check {
    int passed;              /* 1: all below is as it should be */
    dal_difference V_q, V_qq, phi_q, phi_t;
    dal_difference phi_v;    /* of affine and nonlinear constraints, against phi */
    dal_difference L_q, L_v, L_qq, L_vq, L_vv, L_vt, f_q, f_v;
    double linearity;        /* worst |mu(q) at v - mu(q) at another v|, which must not depend on v
                                unless the constraint is nonlinear */
    size_t rank;             /* of mu(q); should be m (FullRank, RegularitySet) */
    double condition;        /* of mu(q) in the mass metric: sqrt of the condition of C */
    double mass_min;         /* smallest eigenvalue of M, which is L_vv at x */
    double kernel_min;       /* smallest eigenvalue of M on ker mu (EUDAETh with "> 0", E1);
                                INFINITY for m = n */
    double residual;         /* as dal_relative_residual */
    double curvature;        /* largest length of [X,Y] across D, X and Y from an orthonormal basis
                                of D_q: by N(q,X)Y - N(q,Y)X with N(q,w) = d(mu w)/dq; NaN unless
                                the constraints are linear */
    int integrable;          /* 1: it vanishes here and nearby: D may be a holonomic constraint */
    dal_error finding;       /* the first thing found wrong; or the summary, of status 0, whose
                                output "D" are the words on whether D is integrable */
} dal_check;

/* *report <- the system examined at x[2n] and time t; what depends on v also at another velocity,
 * where it is defined there, and at time t + 1; inputs are of the size of 1, and 0 where x is to
 * lie in D.  That a callback besides the force gives other numbers at another time is a finding,
 * unless the system is time_dependent.  The mass is examined at x, curvature and integrable (NaN,
 * 0) only of linear constraints that do not depend on inputs, and condition (NaN) only if M is
 * positive definite.  Findings are in the report; the return value is for what prevents the
 * examination: DAL_EINVAL, DAL_ENOMEM, DAL_EUSER, DAL_EDOMAIN (a callback that is not finite or
 * writes nothing is a finding of its own: passed = 0 and DAL_EDOMAIN). */
DAL_API int dal_system_check(const dal_system *system, double t, const double *x,
                             dal_check *report, dal_error *error);

/* ---- geometry -------------------------------------------------------------------------- */

/* Mechanics on D: a system with the workspace to evaluate it. */
typedef struct dal_mechanics dal_mechanics;

/* DAL_EINVAL, DAL_ENOMEM.  To free NULL is allowed. */
DAL_API int dal_mechanics_new(dal_mechanics **mechanics, const dal_system *system,
                              dal_error *error);
DAL_API void dal_mechanics_free(dal_mechanics *mechanics);
/* What the last failure was, with the numbers; "" if there was none. */
DAL_API const dal_error *dal_mechanics_error(const dal_mechanics *mechanics);

/* The inputs are u[inputs] in what follows; 0 at first.  DAL_EINVAL. */
DAL_API int dal_mechanics_input(dal_mechanics *mechanics, const double *u);

/* In this section M is L_vv, and D = {phi(t, q, v) = 0}; mu is phi_v, and phi is mu v where the
 * constraints are linear; all of them at time t.  Errors of the functions below: DAL_EINVAL,
 * DAL_EUSER, DAL_EDOMAIN; DAL_ESINGULAR where C or M is inverted. */

/* *E <- L_v v - L, which is v^T M v / 2 + V(q) for constant mass; a first integral on D unless
 * there is a force, L depends on t, or the constraint forces work (dal_power). */
DAL_API int dal_energy(dal_mechanics *mechanics, double t, const double *x, double *E);

/* *constraint <- lambda . (phi_v v), the power of the constraint forces, which is 0 on D for linear
 * constraints; *force <- f . v.  dE/dt is their sum, less dL/dt at fixed q, v.  Either may
 * be NULL. */
DAL_API int dal_power(dal_mechanics *mechanics, double t, const double *x, double *constraint,
                      double *force);

/* M[n*n] <- L_vv at x (metric). */
DAL_API int dal_metric(dal_mechanics *mechanics, double t, const double *x, double *M);

/* residual[m] <- phi(q - shift v, v).  shift = 0 is D; shift = (1 - beta) h is the deformation
 * D_eps that the beta-scheme with kept nodes preserves (deformedCons). */
DAL_API int dal_residual(dal_mechanics *mechanics, double t, double shift, const double *x,
                         double *residual);

/* *worst <- the largest of all a of
 *     |phi^a| / (sum_i |mu^a_i| d_i max_j |v_j| / d_j + |phi^a - mu^a v| + moves^a),
 *     moves^a = sum_i |dphi^a/dq_i| (|q_i - shift v_i| + |shift v_i|) + |dphi^a/dt t|
 * at (q - shift v, v); 0 where phi is 0.  d_i = sqrt((M^-1)_ii) is the largest |v_i| of a velocity
 * with v^T M v = 1.  For linear constraints |phi^a - mu^a v| is 0, and moves^a is without its last
 * term, and 0 for shift = 0 (docs/residual.md).  It does not change when forms or coordinates are
 * rescaled.  Also DAL_ESINGULAR (M(q) is not positive definite). */
DAL_API int dal_relative_residual(dal_mechanics *mechanics, double t, double shift,
                                  const double *x, double *worst);

/* C[m*m] <- mu M^-1 mu^T at x (lemmaC; Ceps). */
DAL_API int dal_gram(dal_mechanics *mechanics, double t, const double *x, double *C);

/* lambda[m] <- -C^-1 (phi_q v + phi_t + mu f_v) with f_v = M^-1 (L_q - L_vq v - L_vt + f), which is
 * -M^-1 V_q for constant mass and no force (f, lambdax, lambdaQV); defined off D as well. */
DAL_API int dal_multipliers(dal_mechanics *mechanics, double t, const double *x, double *lambda);

/* vdot[n] <- f_v + M^-1 mu^T lambda (soODE). */
DAL_API int dal_acceleration(dal_mechanics *mechanics, double t, const double *x, double *vdot);

/* xdot[2n] <- (v, vdot): the vector field h of the ODE on D (h, ODEManifold, ODExMec, heps). */
DAL_API int dal_field(dal_mechanics *mechanics, double t, const double *x, double *xdot);

/* The DAE of motion with the perturbation weight ghat[2n] = weight (ghat_q, ghat_v),
 *   qdot = v + weight ghat_q,  vdot = f_v + M^-1 mu^T lambda + weight ghat_v,  phi(q, v) = 0
 * (PerturbedDAE): xdot[2n] <- its vector field on D (ODEPert; the form ODEPert2 is wrong, E2),
 * lambda[m] <- its multiplier, that of dal_multipliers - weight C^-1 (phi_q ghat_q + mu ghat_v)
 * (hatLambday).  Either may be NULL.  Tangent to D for every ghat (hatperp); if (ghat_q, ghat_v) is
 * tangent to D itself, lambda is that of the unperturbed problem (LargeRemark). */
DAL_API int dal_perturbed(dal_mechanics *mechanics, double t, double weight, const double *x,
                          const double *ghat, double *xdot, double *lambda);

/* x[2n]: v <- the velocity of D (shift = 0) or of D_eps on v + M^-1 mu(q)^T R^m, by Newton; for
 * linear and affine constraints and shift = 0 that is v - M^-1 mu^T C^-1 phi, the nearest
 * consistent velocity in the metric M.  *distance (or NULL) <- the length of the correction in
 * that metric. Also DAL_ENOCONV. */
DAL_API int dal_project(dal_mechanics *mechanics, double t, double shift, double *x,
                        double *distance);

/* x[2n]: v <- the velocity in D_q nearest in the metric M with v_i unchanged where keep[i] is not 0
 * (keep[n], or NULL: none): data to start from (InitialData).  For nonlinear constraints one that
 * is consistent, found by Newton.
 * DAL_ESINGULAR if the kept components leave too little freedom; also DAL_ENOCONV. */
DAL_API int dal_consistent(dal_mechanics *mechanics, double t, const unsigned char *keep,
                           double *x, double *distance);

/* The residual and the Jacobian [[K, -mu_k^T], [B, 0]] of one step of the beta-scheme from x[2n] at
 * time t, at a trial velocity w[n] and impulse kappa[m] = h lambda (DAELd1, DAELd2, Facil):
 *   q_k = q + (1-beta) h v,  q1 = q_k + beta h w,  F = L_q + f,
 *   R1[n] = L_v(q1, w) - L_v(q, v) - h ((1-beta) F(q1, w) + beta F(q, v)) - mu_k^T kappa,
 *   R2[m] = phi(q1, w),  mu_k = phi_v(q_k, (v+w)/2), which is mu(q_k) unless phi is nonlinear,
 *   K[n*n] = dR1/dw,  B[m*n] = dR2/dw = phi_v + beta h phi_q at (q1, w);
 * what stands at q, q_k and q1 is evaluated at the times t, t + (1-beta) h and t + h.
 * For constant mass and no force K = M + h^2 beta (1-beta) V_qq(q1).  muk[m*n] <- mu_k.  Every
 * output may be NULL. */
DAL_API int dal_step_equations(dal_mechanics *mechanics, double t, double beta, double h,
                               const double *x, const double *w, const double *kappa, double *R1,
                               double *R2, double *K, double *B, double *muk);

/* Evaluates count rows (q, v) of x[count*2n], row k at time t0 + k h and with row k of the inputs,
 * as many as the system has for each row (NULL: those of dal_mechanics_input; of constraints that
 * depend on inputs those that the row satisfies): energy[count]; multipliers[count*m] by lambdax,
 * which have the order of the rows (rmkpdisc); residual[count*m] = phi(q - shift v, v);
 * relative[count] as dal_relative_residual.  Outputs may be NULL.  On failure *done (or NULL) is
 * the number of rows that were evaluated. */
DAL_API int dal_trajectory(dal_mechanics *mechanics, double t0, double h, double shift,
                           size_t count, const double *x, const double *inputs, double *energy,
                           double *multipliers, double *residual, double *relative, size_t *done);

/* ---- geometry: charts of D --------------------------------------------------------------- */

/* D written by m dependent velocities as functions of the rest (Ehresmann connection): with B =
 * phi_v[:, dependent] and A = B^-1 phi_v[:, independent] the coordinates are xi = (q,
 * v_independent), 2n - m numbers, and psi(xi) is the state of D with v_dependent = -A
 * v_independent, for affine constraints -A v_independent - B^-1 a; for nonlinear ones it is found
 * by Newton.  A and B have their rows and columns in the order of dal_chart_dependent and
 * dal_chart_independent.
 *
 * A chart is a system, a choice of the dependent coordinates and the workspace.  Its functions need
 * a choice: DAL_EINVAL before the first one.  Their other errors: DAL_EINVAL, DAL_EUSER,
 * DAL_EDOMAIN; DAL_ESINGULAR where B is singular; for nonlinear constraints DAL_ENOCONV. */
typedef struct dal_chart dal_chart;

/* DAL_EINVAL, DAL_ENOMEM.  To free NULL is allowed. */
DAL_API int dal_chart_new(dal_chart **chart, const dal_system *system, dal_error *error);
DAL_API void dal_chart_free(dal_chart *chart);
/* What the last failure was, with the numbers, or the last change that dal_chart_renew made; "" if
 * there was neither. */
DAL_API const dal_error *dal_chart_error(const dal_chart *chart);
/* As dal_mechanics_input. */
DAL_API int dal_chart_input(dal_chart *chart, const double *u);

/* Chooses dependent[m], in any order; NULL: by pivoting at x[2n], with the components of v in the
 * units 1/sqrt(M_ii), so that the choice does not depend on the units of q, and with exchanges
 * until no entry of A exceeds 5/4 in them, so that it hardly depends on which forms describe D
 * either.  Newton for nonlinear constraints starts at the v_dependent of x. */
DAL_API int dal_chart_choose(dal_chart *chart, double t, const size_t *dependent, const double *x);

/* The choice: [m] and [n-m] indices, ascending, borrowed; NULL before the first one. */
DAL_API const size_t *dal_chart_dependent(const dal_chart *chart);
DAL_API const size_t *dal_chart_independent(const dal_chart *chart);

/* *condition <- the largest singular value of [A, I] at x in the units 1/sqrt(M_ii): how much
 * larger v can be than v_independent.  It is the condition of B once the forms are made
 * orthonormal, 1 at best, and the same for mu and any B(q) mu; INFINITY where B is singular. */
DAL_API int dal_chart_condition(dal_chart *chart, double t, const double *x, double *condition);

/* Keeps the choice where its condition at x is at most 10 sqrt(1 + m (n-m)), else chooses anew; a
 * choice by pivoting starts eight times below this limit, so it does not flip back.  *changed (or
 * NULL) <- whether the dependent coordinates changed, as they do when first chosen;
 * dal_chart_error then says from which to which.  For nonlinear constraints Newton starts at the
 * v_dependent of x from then on. */
DAL_API int dal_chart_renew(dal_chart *chart, double t, const double *x, int *changed);

/* A[m*(n-m)] and B[m*m] at x[2n], either may be NULL. */
DAL_API int dal_chart_connection(dal_chart *chart, double t, const double *x, double *A,
                                 double *B);

/* v = hor + ver: hor[n] is the velocity of D with the v_independent of x, and ver[n] is zero in the
 * independent components.  For linear constraints both are linear in v.  Either may be NULL. */
DAL_API int dal_chart_split(dal_chart *chart, double t, const double *x, double *hor, double *ver);

/* x[2n] <- psi(xi[2n-m]) (Embedd), with |phi_a| <= 4 n u of the size of its terms. */
DAL_API int dal_chart_lift(dal_chart *chart, double t, const double *xi, double *x);

/* xi[2n-m] <- (q, v_independent) of x[2n]; the left inverse of psi. */
DAL_API int dal_chart_drop(dal_chart *chart, const double *x, double *xi);

/* J[2n*(2n-m)] <- dpsi/dxi (EhresJota), left[(2n-m)*2n] <- its left inverse, the derivative of
 * dal_chart_drop (Inverse); either may be NULL. */
DAL_API int dal_chart_jacobian(dal_chart *chart, double t, const double *xi, double *J,
                               double *left);

/* xidot[2n-m] <- the ODE on D in these coordinates, left h(psi(xi)), also where psi depends on t
 * (ODExi, ODEred, ODExiConnec; ODExiEps). */
DAL_API int dal_chart_field(dal_chart *chart, double t, const double *xi, double *xidot);

/* The multipliers of the forms [A, I] from those of mu, and back: lambda_E[m] <- B^T lambda,
 * lambda[m] <- B^-T lambda_E, B at x[2n]; mu^T lambda = [A, I]^T lambda_E.  They may overlap. */
DAL_API int dal_chart_multipliers(dal_chart *chart, double t, const double *x,
                                  const double *lambda, double *lambda_E);
DAL_API int dal_chart_multipliers_back(dal_chart *chart, double t, const double *x,
                                       const double *lambda_E, double *lambda);

/* One beta-step with moved nodes from xi[2n-m] at time t, in place, with the multiplier eliminated
 * (the decompositions that follow firstorder and secondorder): with R1 that of dal_step_equations
 * for kappa = 0 and A, B at q_k,
 *   R1_independent - A^T R1_dependent = 0,  phi(q1, w) = 0,
 * and lambda_E[m] (or NULL) <- R1_dependent / h, the multiplier of [A, I] at q_k.
 * Also DAL_ENOCONV for all constraints. */
DAL_API int dal_chart_step(dal_chart *chart, double t, double beta, double h, double *xi,
                           double *lambda_E);

/* ---- geometry: curves in D --------------------------------------------------------------- */

/* The cut-off functions chi_0 = (1 + tanh cot(pi tau)) / 2 and chi_1 = 1 - chi_0 on 0 < tau < 1,
 * both without cancellation, to a relative error of a few u |log chi|, and *slope <- dchi_0/dtau
 * (CutOff); (1, 0, 0) for tau <= 0 and
 * (0, 1, 0) for tau >= 1.  All derivatives vanish at the ends.  NaN for NaN.  Every output may be
 * NULL. */
DAL_API void dal_cutoff(double tau, double *chi0, double *chi1, double *slope);

/* x[2n] <- c(tau) = psi(chi_0 xi1 + chi_1 xi2), a curve in D from x1[2n] for tau <= 0 to x2[2n] for
 * tau >= 1, which have to lie in D (yD, InterpolationD; not checked: only their q and v_independent
 * matter).  For nonlinear constraints Newton starts at chi_0 v1 + chi_1 v2.  Errors as above. */
DAL_API int dal_chart_curve(dal_chart *chart, double t, const double *x1, const double *x2,
                            double tau, double *x);

/* Between the rows (q, v) of x[rows*2n], which stand at t0 + k h, k < rows: out[count*2n] <- the
 * states at the times t[count], in any order, between t0 and t0 + (rows-1) h (up to 1e-9 of that).
 * xi is interpolated after Hermite, q from q, v and vdot in degree 5, v_independent from v and vdot
 * in degree 3, and lifted by psi: the states lie in D to roundoff and have an error O(h^4) beside
 * that of the rows.  At the time of a row they are that row.  shift = 0 is D; for rows of kept
 * nodes shift is (1-beta) times the step of the scheme, q - shift v is what is interpolated, and
 * the states lie in D_eps (where the first row does not, as with DAL_INITIAL_D, the states jump
 * behind it).  The coordinates are chosen by pivoting in the middle of each interval, and again at
 * a state where that choice is ill conditioned; *changes (or NULL) <- how often they changed from
 * one state to the next.  The choice of the chart is neither needed nor changed.  On failure *done
 * (or NULL) states were computed.  DAL_EINVAL, DAL_EUSER, DAL_EDOMAIN, DAL_ESINGULAR,
 * DAL_ENOCONV. */
DAL_API int dal_chart_interpolate(dal_chart *chart, double t0, double h, double shift, size_t rows,
                                  const double *x, size_t count, const double *t, double *out,
                                  size_t *changes, size_t *done);

/* ---- flow ------------------------------------------------------------------------------ */

typedef enum dal_flow_coordinates {
    DAL_FLOW_X = 0, /* the ODE in the states x (h) */
    DAL_FLOW_XI = 1 /* the ODE in the coordinates of a chart (ODExi, ODExiConnec), which is changed
                       on the way where it has become ill conditioned: every step lies in D */
} dal_flow_coordinates;

/* The flow of the ODE on D by an adaptive method: GSL's (odeiv2), but for rodas. */
typedef struct dal_flow dal_flow;

/* tolerance: relative and absolute, for each step, in [4 u, 0.1], u = 2^-53; 1e-13 is about the
 * best. */
DAL_API int dal_flow_new(dal_flow **flow, const dal_system *system, dal_flow_method method,
                         dal_flow_coordinates coordinates, double tolerance, dal_error *error);
DAL_API void dal_flow_free(dal_flow *flow);
DAL_API const dal_error *dal_flow_error(const dal_flow *flow);
/* As dal_mechanics_input. */
DAL_API int dal_flow_input(dal_flow *flow, const double *u);

/* Has watch asked, with the time where the flow is, by all that computes with it; NULL: nobody. */
DAL_API void dal_flow_watch(dal_flow *flow, dal_watch_fn watch, void *ctx);

/* x[2n] at t0, which must lie in D, -> x at t1 (t1 < t0 is allowed), projected onto D at the end
 * (ODEflow).
 * What lies in D is moved back there every few steps of the integration, since the ODE would keep
 * what it is off by: intervals may be long.  That x lies in D is not required: off D the same ODE
 * is integrated, which keeps phi, and only the result is projected; in xi the part of v off D is
 * dropped at once.  *accuracy (or NULL) <-
 * estimate of the error, the largest component of the difference to the result at a tolerance ten
 * times as large with steps of at most 1/17 of the interval, or roundoff if that is larger; asking
 * for it costs a second integration.  What happens between the evaluations of both, as a short push
 * in a long rest, is not seen: integrate from one such event to the next.  DAL_FLOW_MSADAMS takes
 * two evaluations for a step, and is for smooth forces only.
 * DAL_EINVAL, DAL_EUSER, DAL_EDOMAIN, DAL_ESINGULAR, DAL_ENOCONV (the step size collapsed),
 * DAL_STOPPED, where x is as it was too. */
DAL_API int dal_flow_apply(dal_flow *flow, double t0, double t1, double *x, double *accuracy);

/* Rows 1..steps of x[(steps+1)*2n] from row 0, which must lie in D (not checked either): the
 * states at t0 + k h, projected.  On failure *done (or NULL) rows after row 0 are valid.  Errors as
 * of dal_flow_apply. */
DAL_API int dal_flow_trajectory(dal_flow *flow, double t0, double h, size_t steps, double *x,
                                size_t *done);

/* Changes of the chart so far; 0 but for DAL_FLOW_XI. */
DAL_API size_t dal_flow_chart_changes(const dal_flow *flow);

/* Evaluations of the vector field so far. */
DAL_API size_t dal_flow_evaluations(const dal_flow *flow);

/* *stats <- least_pivot, least_pivot_t, least_pivot_rows, rank_doubts, least_step and least_step_t
 * of the last integration, and 0 for the rest; a flow in xi does not look at pivots. */
DAL_API void dal_flow_stats(const dal_flow *flow, dal_stats *stats);

/* </cdef> */

#ifdef __cplusplus
}
#endif
#endif /* DALEMBERT_GEOMETRY_H */
