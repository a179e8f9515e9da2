/* dalembert/geometry.h - mechanics on D: energy, multipliers, projections, charts, the flow of the
 * ODE on D, and the check of a system.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_GEOMETRY_H
#define DALEMBERT_GEOMETRY_H

#include <dalembert/deformation.h>
#include <dalembert/stepper.h>

DAL_BEGIN_DECLARATIONS

/* <cdef> */

/* ---- examination ----------------------------------------------------------------------- */

/* A derivative compared with central differences.  Their distance decreases until they agree with
 * the derivative or with each other. */
typedef struct dal_difference {
    double error;           /* worst |given - differenced| / (1 + |differenced|) */
    double given, expected; /* the two numbers at that entry */
    size_t row, column;
    int checked;            /* 0: not provided, or no entry could be judged */
    int wrong;              /* 1: the two numbers disagree */
    size_t unjudged;        /* entries not compared because differences do not converge */
} dal_difference;

/* The results of dal_system_check at one point. */
typedef struct dal_check {
    int passed;              /* 1: all checks passed */
    dal_difference V_q, V_qq, phi_q, phi_t;
    dal_difference phi_v;    /* for affine and nonlinear constraints, compared with phi */
    dal_difference L_q, L_v, L_qq, L_vq, L_vv, L_vt, f_q, f_v;
    double linearity;        /* worst |mu(q) at v - mu(q) at another v|; 0 unless the constraint is
                                nonlinear */
    size_t rank;             /* rank of mu(q); should be m (FullRank, RegularitySet) */
    double condition;        /* condition number of mu(q) in the mass metric: sqrt of that of C */
    double mass_min;         /* smallest eigenvalue of M, which is L_vv at x */
    double kernel_min;       /* smallest eigenvalue of M on ker mu (EUDAETh with "> 0", E1);
                                INFINITY for m = n */
    double residual;         /* as dal_relative_residual */
    double curvature;        /* largest length of [X,Y] across D, computed from N(q,X)Y - N(q,Y)X
                                with N(q,w) = d(mu w)/dq.  The fields X and Y are from an
                                orthonormal basis of D_q.  NaN unless the constraints are linear */
    int integrable;          /* 1: the curvature vanishes here and nearby, so the constraints may be
                                holonomic */
    dal_error finding;       /* the first failure; or the summary, of status 0, whose output "D" is
                                the part about the integrability of D */
} dal_check;

/* Checks a system at x[2n] and time t: *report <- the results.  Functions of v are also checked at
 * another velocity, if they are defined there, and functions of time at t + 1.  The inputs are of
 * the size of 1; they are 0 for the check of x itself.  Values of a callback other than the force
 * that differ at another time are a failure, unless the system is time_dependent.
 *
 * The mass is checked at x.  The curvature and integrable (else NaN, 0) are computed for linear
 * constraints that do not depend on inputs.  The condition (else NaN) is computed if M is positive
 * definite.  Failures of the system are in the report.  The return value concerns the check itself.
 * Errors: DAL_EINVAL; DAL_ENOMEM; DAL_EUSER; DAL_EDOMAIN.  A callback that is not finite, or writes
 * nothing, leads to passed = 0 and DAL_EDOMAIN. */
DAL_API int dal_system_check(const dal_system *system, double t, const double *x,
                             dal_check *report, dal_error *error);

/* ---- geometry -------------------------------------------------------------------------- */

/* Mechanics on D: a system and the workspace for its evaluation. */
typedef struct dal_mechanics dal_mechanics;

/* Create and free a mechanics object; NULL may be freed.  Errors: DAL_EINVAL; DAL_ENOMEM. */
DAL_API int dal_mechanics_new(dal_mechanics **mechanics, const dal_system *system,
                              dal_error *error);
DAL_API void dal_mechanics_free(dal_mechanics *mechanics);
/* Returns the record of the last failure; its text is "" if there was none. */
DAL_API const dal_error *dal_mechanics_error(const dal_mechanics *mechanics);

/* Sets the inputs u[inputs] of the following evaluations; initially they are 0.  Errors:
 * DAL_EINVAL. */
DAL_API int dal_mechanics_input(dal_mechanics *mechanics, const double *u);

/* In this section M is L_vv, D = {phi(t, q, v) = 0}, and mu is phi_v, all at time t.  For linear
 * constraints phi is mu v.  Errors of the functions below: DAL_EINVAL; DAL_EUSER; DAL_EDOMAIN;
 * DAL_ESINGULAR if C or M has to be inverted and is singular. */

/* Computes the energy: *E <- L_v v - L, which is v^T M v / 2 + V(q) for constant mass.  It is
 * conserved on D, unless there is a force, L depends on t, or the constraint forces do work
 * (dal_power). */
DAL_API int dal_energy(dal_mechanics *mechanics, double t, const double *x, double *E);

/* Computes the power of the constraint forces, *constraint <- lambda . (phi_v v), and of the force,
 * *force <- f . v. The first is 0 on D for linear constraints.  Their sum minus dL/dt at fixed q, v
 * is dE/dt.  Either may be NULL. */
DAL_API int dal_power(dal_mechanics *mechanics, double t, const double *x, double *constraint,
                      double *force);

/* Computes the mass matrix: M[n*n] <- L_vv at x (metric). */
DAL_API int dal_metric(dal_mechanics *mechanics, double t, const double *x, double *M);

/* Computes the residual: residual[m] <- phi(q - shift v, v).  It is 0 on D for shift = 0.  For
 * shift = (1 - beta) h it is 0 on the deformation D_eps that the beta-scheme with kept nodes
 * preserves (deformedCons). */
DAL_API int dal_residual(dal_mechanics *mechanics, double t, double shift, const double *x,
                         double *residual);

/* Computes the relative residual: *worst <- the largest over all a of
 *     |phi^a| / (sum_i |mu^a_i| d_i max_j |v_j| / d_j + |phi^a - mu^a v| + moves^a),
 *     moves^a = sum_i |dphi^a/dq_i| (|q_i - shift v_i| + |shift v_i|) + |dphi^a/dt t|
 * at (q - shift v, v); 0 if phi is 0.  Here d_i = sqrt((M^-1)_ii) is the largest |v_i| of a
 * velocity with v^T M v = 1.  For linear constraints |phi^a - mu^a v| is 0, and moves^a has no last
 * term and is 0 for shift = 0 (docs/residual.md).  The value does not change if forms or
 * coordinates are rescaled.
 * Also DAL_ESINGULAR (M(q) is not positive definite). */
DAL_API int dal_relative_residual(dal_mechanics *mechanics, double t, double shift,
                                  const double *x, double *worst);

/* Computes the matrix C[m*m] <- mu M^-1 mu^T at x (lemmaC; Ceps). */
DAL_API int dal_gram(dal_mechanics *mechanics, double t, const double *x, double *C);

/* Computes the multipliers: lambda[m] <- -C^-1 (phi_q v + phi_t + mu f_v) with f_v = M^-1 (L_q -
 * L_vq v - L_vt + f) (f, lambdax, lambdaQV).  For constant mass without force f_v is -M^-1 V_q.
 * The formula applies off D as well. */
DAL_API int dal_multipliers(dal_mechanics *mechanics, double t, const double *x, double *lambda);

/* Computes the acceleration: vdot[n] <- f_v + M^-1 mu^T lambda (soODE). */
DAL_API int dal_acceleration(dal_mechanics *mechanics, double t, const double *x, double *vdot);

/* Computes the vector field h of the ODE on D: xdot[2n] <- (v, vdot) (h, ODEManifold, ODExMec,
 * heps). */
DAL_API int dal_field(dal_mechanics *mechanics, double t, const double *x, double *xdot);

/* Evaluates the DAE of motion with the perturbation weight ghat[2n] = weight (ghat_q, ghat_v),
 *     qdot = v + weight ghat_q,  vdot = f_v + M^-1 mu^T lambda + weight ghat_v,  phi(q, v) = 0
 * (PerturbedDAE): xdot[2n] <- its vector field on D (ODEPert; the form ODEPert2 is wrong, E2),
 * lambda[m] <- its multiplier.  This is dal_multipliers minus weight C^-1 (phi_q ghat_q + mu
 * ghat_v) (hatLambday).  Either output may be NULL.  The field is tangent to D for every ghat
 * (hatperp).  If (ghat_q, ghat_v) is tangent to D, lambda is that of the unperturbed problem
 * (LargeRemark). */
DAL_API int dal_perturbed(dal_mechanics *mechanics, double t, double weight, const double *x,
                          const double *ghat, double *xdot, double *lambda);

/* Projects x[2n]: v <- the velocity in D (shift = 0) or in D_eps on v + M^-1 mu(q)^T R^m, by
 * Newton's iteration.  For linear and affine constraints and shift = 0 it is v - M^-1 mu^T C^-1
 * phi, the nearest consistent velocity in the metric M.  *distance (or NULL) <- the length of the
 * correction in this metric.
 * Also DAL_ENOCONV. */
DAL_API int dal_project(dal_mechanics *mechanics, double t, double shift, double *x,
                        double *distance);

/* Computes initial data (InitialData): v in x[2n] <- the velocity in D_q nearest in the metric M,
 * with v_i unchanged if keep[i] is not 0 (keep[n]; NULL: all may change).  For nonlinear
 * constraints Newton's iteration computes a consistent velocity.
 * Also DAL_ESINGULAR if the unchanged components leave too little freedom; DAL_ENOCONV. */
DAL_API int dal_consistent(dal_mechanics *mechanics, double t, const unsigned char *keep,
                           double *x, double *distance);

/* Computes the residual and the Jacobian [[K, -mu_k^T], [B, 0]] of one step of the beta-scheme from
 * x[2n] at time t.  The trial velocity is w[n], the impulse kappa[m] = h lambda (DAELd1, DAELd2,
 * Facil):
 *     q_k = q + (1-beta) h v,  q1 = q_k + beta h w,  F = L_q + f,
 *     R1[n] = L_v(q1, w) - L_v(q, v) - h ((1-beta) F(q1, w) + beta F(q, v)) - mu_k^T kappa,
 *     R2[m] = phi(q1, w),  mu_k = phi_v(q_k, (v+w)/2), which is mu(q_k) unless phi is nonlinear,
 *     K[n*n] = dR1/dw,  B[m*n] = dR2/dw = phi_v + beta h phi_q at (q1, w).
 * Terms at q, q_k and q1 are evaluated at the times t, t + (1-beta) h and t + h.  For constant mass
 * without force K = M + h^2 beta (1-beta) V_qq(q1).  muk[m*n] <- mu_k.  Every output may be NULL.
 */
DAL_API int dal_step_equations(dal_mechanics *mechanics, double t, double beta, double h,
                               const double *x, const double *w, const double *kappa, double *R1,
                               double *R2, double *K, double *B, double *muk);

/* Evaluates count rows (q, v) of x[count*2n].  Row k has the time t0 + k h and row k of the inputs
 * (NULL: those of dal_mechanics_input).  If constraints depend on inputs, row k of these has to be
 * the inputs that the state satisfies.  The outputs are energy[count]; multipliers[count*m] as
 * dal_multipliers, which have the order of the rows (rmkpdisc); residual[count*m] = phi(q - shift
 * v, v); relative[count] as dal_relative_residual.  Outputs may be NULL.  On failure *done (or
 * NULL) <- the number of rows evaluated. */
DAL_API int dal_trajectory(dal_mechanics *mechanics, double t0, double h, double shift,
                           size_t count, const double *x, const double *inputs, double *energy,
                           double *multipliers, double *residual, double *relative, size_t *done);

/* ---- geometry: charts of D --------------------------------------------------------------- */

/* A chart of D, in which m dependent velocities are functions of the others (Ehresmann connection).
 * With B = phi_v[:, dependent] and A = B^-1 phi_v[:, independent] the coordinates are xi = (q,
 * v_independent), 2n - m numbers.  The state psi(xi) of D has v_dependent = -A v_independent, or -A
 * v_independent - B^-1 a for affine constraints.  For nonlinear constraints Newton's iteration
 * computes it.  The rows and columns of A and B have the order of dal_chart_dependent and
 * dal_chart_independent.
 *
 * A chart consists of a system, a choice of the dependent coordinates and the workspace.  Before
 * the first choice its functions return DAL_EINVAL.  Their other errors are DAL_EINVAL; DAL_EUSER;
 * DAL_EDOMAIN; DAL_ESINGULAR if B is singular; for nonlinear constraints DAL_ENOCONV. */
typedef struct dal_chart dal_chart;

/* Create and free a chart object; NULL may be freed.  Errors: DAL_EINVAL; DAL_ENOMEM. */
DAL_API int dal_chart_new(dal_chart **chart, const dal_system *system, dal_error *error);
DAL_API void dal_chart_free(dal_chart *chart);
/* Returns the record of the last failure, or of the last change by dal_chart_renew; its text is ""
 * if there was neither. */
DAL_API const dal_error *dal_chart_error(const dal_chart *chart);
/* Sets the inputs as dal_mechanics_input does. */
DAL_API int dal_chart_input(dal_chart *chart, const double *u);

/* Chooses the dependent coordinates dependent[m], in any order.  NULL: they are chosen by pivoting
 * at x[2n].  The components of v are in the units 1/sqrt(M_ii), so the choice does not depend on
 * the units of q.  Exchanges follow until no entry of A exceeds 5/4 in these units, so the choice
 * hardly depends on the forms that describe D.  Newton's iteration for nonlinear constraints starts
 * from v_dependent of x. */
DAL_API int dal_chart_choose(dal_chart *chart, double t, const size_t *dependent, const double *x);

/* Return the chosen indices, [m] and [n-m], ascending, borrowed; NULL before the first choice. */
DAL_API const size_t *dal_chart_dependent(const dal_chart *chart);
DAL_API const size_t *dal_chart_independent(const dal_chart *chart);

/* Computes *condition <- the largest singular value of [A, I] at x in the units 1/sqrt(M_ii), which
 * is the largest ratio of v to v_independent.  It equals the condition number of B for orthonormal
 * forms, is at least 1, and is the same for mu and any B(q) mu.  It is INFINITY if B is singular.
 */
DAL_API int dal_chart_condition(dal_chart *chart, double t, const double *x, double *condition);

/* Keeps the choice if its condition at x is at most 10 sqrt(1 + m (n-m)), else chooses again.  A
 * choice by pivoting starts eight times below this limit, so it does not alternate.  *changed (or
 * NULL) <- 1 if the dependent coordinates changed, as in the first choice, else 0; dal_chart_error
 * then describes the change.  For nonlinear constraints Newton's iteration starts from v_dependent
 * of x from then on. */
DAL_API int dal_chart_renew(dal_chart *chart, double t, const double *x, int *changed);

/* Computes A[m*(n-m)] and B[m*m] at x[2n]; either may be NULL. */
DAL_API int dal_chart_connection(dal_chart *chart, double t, const double *x, double *A,
                                 double *B);

/* Splits v = hor + ver: hor[n] <- the velocity in D with v_independent of x; ver[n] <- the rest,
 * zero in the independent components.  For linear constraints both are linear in v.  Either may be
 * NULL. */
DAL_API int dal_chart_split(dal_chart *chart, double t, const double *x, double *hor, double *ver);

/* Computes x[2n] <- psi(xi[2n-m]) (Embedd), with |phi_a| <= 4 n u of the size of its terms. */
DAL_API int dal_chart_lift(dal_chart *chart, double t, const double *xi, double *x);

/* Computes xi[2n-m] <- (q, v_independent) of x[2n], the left inverse of psi. */
DAL_API int dal_chart_drop(dal_chart *chart, const double *x, double *xi);

/* Computes J[2n*(2n-m)] <- dpsi/dxi (EhresJota), and left[(2n-m)*2n] <- its left inverse, the
 * derivative of dal_chart_drop (Inverse).  Either may be NULL. */
DAL_API int dal_chart_jacobian(dal_chart *chart, double t, const double *xi, double *J,
                               double *left);

/* Computes the field of the ODE on D in these coordinates: xidot[2n-m] <- left h(psi(xi)), also if
 * psi depends on t (ODExi, ODEred, ODExiConnec; ODExiEps). */
DAL_API int dal_chart_field(dal_chart *chart, double t, const double *xi, double *xidot);

/* Convert the multipliers of mu to those of the forms [A, I], and back, so that mu^T lambda = [A,
 * I]^T lambda_E: lambda_E[m] <- B^T lambda; lambda[m] <- B^-T lambda_E, with B at x[2n].  The
 * arrays may overlap. */
DAL_API int dal_chart_multipliers(dal_chart *chart, double t, const double *x,
                                  const double *lambda, double *lambda_E);
DAL_API int dal_chart_multipliers_back(dal_chart *chart, double t, const double *x,
                                       const double *lambda_E, double *lambda);

/* Takes one beta-step with moved nodes from xi[2n-m] at time t, in place, with the multiplier
 * eliminated (the decompositions that follow firstorder and secondorder).  With R1 of
 * dal_step_equations for kappa = 0, and A, B at q_k, the equations are
 *     R1_independent - A^T R1_dependent = 0,  phi(q1, w) = 0.
 * lambda_E[m] (or NULL) <- R1_dependent / h, the multiplier of [A, I] at q_k.
 * Also DAL_ENOCONV for all constraints. */
DAL_API int dal_chart_step(dal_chart *chart, double t, double beta, double h, double *xi,
                           double *lambda_E);

/* ---- geometry: curves in D --------------------------------------------------------------- */

/* Computes the cut-off functions chi_0 = (1 + tanh cot(pi tau)) / 2 and chi_1 = 1 - chi_0 for 0 <
 * tau < 1, and *slope <- dchi_0/dtau (CutOff).  The results are (1, 0, 0) for tau <= 0, (0, 1, 0)
 * for tau >= 1, and NaN for NaN.  The relative error of both functions is a few u |log chi|,
 * without cancellation.  All derivatives vanish at the ends.  Every output may be NULL. */
DAL_API void dal_cutoff(double tau, double *chi0, double *chi1, double *slope);

/* Computes a point of a curve in D: x[2n] <- c(tau) = psi(chi_0 xi1 + chi_1 xi2) (yD,
 * InterpolationD).  It is x1[2n] for tau <= 0 and x2[2n] for tau >= 1.  Both ends have to lie in D;
 * this is not checked, and only their q and v_independent are used.  For nonlinear constraints
 * Newton's iteration starts from chi_0 v1 + chi_1 v2.
 * Errors: as for a chart. */
DAL_API int dal_chart_curve(dal_chart *chart, double t, const double *x1, const double *x2,
                            double tau, double *x);

/* Interpolates between the rows (q, v) of x[rows*2n] at times t0 + k h, k < rows: out[count*2n] <-
 * the states at the times t[count].  The times, in any order, lie between t0 and t0 + (rows-1) h
 * (up to 1e-9 of that).  At the time of a row the result is that row.
 *
 * Hermite interpolation of xi determines q from q, v and vdot in degree 5, and v_independent from v
 * and vdot in degree 3.  The map psi then gives the state.  So the states lie in D to roundoff and
 * add an error O(h^4) to that of the rows.  For D pass shift = 0.  For rows of kept nodes shift is
 * (1-beta) times the step of the scheme; then q - shift v is interpolated, and the states lie in
 * D_eps.  If the first row does not lie in D_eps, as with DAL_INITIAL_D, the states jump after it.
 *
 * The dependent coordinates are chosen by pivoting in the middle of each interval, and again at a
 * state at which this choice is ill conditioned.  *changes (or NULL) <- the number of changes from
 * one state to the next.  The choice of the chart is neither needed nor changed.  On failure *done
 * (or NULL) <- the number of states computed.
 * Errors: DAL_EINVAL; DAL_EUSER; DAL_EDOMAIN; DAL_ESINGULAR; DAL_ENOCONV. */
DAL_API int dal_chart_interpolate(dal_chart *chart, double t0, double h, double shift, size_t rows,
                                  const double *x, size_t count, const double *t, double *out,
                                  size_t *changes, size_t *done);

/* ---- flow ------------------------------------------------------------------------------ */

typedef enum dal_flow_coordinates {
    DAL_FLOW_X = 0, /* the ODE in the states x (h) */
    DAL_FLOW_XI = 1 /* the ODE in the coordinates of a chart (ODExi, ODExiConnec), which is replaced
                       when it becomes ill conditioned: every step lies in D */
} dal_flow_coordinates;

/* The flow of the ODE on D by an adaptive method of GSL (odeiv2), or by rodas. */
typedef struct dal_flow dal_flow;

/* Creates a flow.  The relative and absolute tolerance of each step lies in [4 u, 0.1], u = 2^-53;
 * 1e-13 gives about the best accuracy.  Errors: DAL_EINVAL; DAL_ENOMEM. */
DAL_API int dal_flow_new(dal_flow **flow, const dal_system *system, dal_flow_method method,
                         dal_flow_coordinates coordinates, double tolerance, dal_error *error);
DAL_API void dal_flow_free(dal_flow *flow);
DAL_API const dal_error *dal_flow_error(const dal_flow *flow);
/* Sets the inputs as dal_mechanics_input does. */
DAL_API int dal_flow_input(dal_flow *flow, const double *u);

/* Sets a progress callback, which is called with the current time in all computations with the
 * flow; NULL removes it. */
DAL_API void dal_flow_watch(dal_flow *flow, dal_watch_fn watch, void *ctx);

/* Integrates from x[2n] at t0 to t1 (t1 < t0 is allowed), and projects the result onto D (ODEflow).
 * If x lies in D, the solution is projected every few steps, because the ODE preserves any
 * deviation from D; so intervals may be long.  This is not required: off D the same ODE is
 * integrated, which preserves phi, and only the result is projected.  In xi the part of v off D is
 * dropped at once.
 *
 * *accuracy (or NULL) <- an estimate of the error.  It is the largest component of the difference
 * to a second result, or roundoff if that is larger.  The second integration has ten times the
 * tolerance and steps of at most 1/17 of the interval.  Both integrations may miss short events,
 * such as a short push during a long rest: integrate from one such event to the next.
 * DAL_FLOW_MSADAMS takes two evaluations for a step, and is for smooth forces only.
 * Errors: DAL_EINVAL; DAL_EUSER; DAL_EDOMAIN; DAL_ESINGULAR; DAL_ENOCONV (the step size collapsed);
 * DAL_STOPPED.  In all these cases x is unchanged. */
DAL_API int dal_flow_apply(dal_flow *flow, double t0, double t1, double *x, double *accuracy);

/* Computes rows 1..steps of x[(steps+1)*2n] from row 0 in D (not checked): the states at t0 + k h,
 * projected.  On failure *done (or NULL) <- the number of valid rows after row 0.
 * Errors: as for dal_flow_apply. */
DAL_API int dal_flow_trajectory(dal_flow *flow, double t0, double h, size_t steps, double *x,
                                size_t *done);

/* Returns the number of changes of the chart so far; 0 except for DAL_FLOW_XI. */
DAL_API size_t dal_flow_chart_changes(const dal_flow *flow);

/* Returns the number of evaluations of the vector field so far. */
DAL_API size_t dal_flow_evaluations(const dal_flow *flow);

/* *stats <- least_pivot, least_pivot_t, least_pivot_rows, rank_doubts, least_step and least_step_t
 * of the last integration, and 0 for all other members.  A flow in xi does not check pivots. */
DAL_API void dal_flow_stats(const dal_flow *flow, dal_stats *stats);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_GEOMETRY_H */
