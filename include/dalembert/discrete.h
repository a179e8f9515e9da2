/* dalembert/discrete.h - discrete Lagrange-d'Alembert equations: difference maps, discrete
 * Lagrangians and constraints, and their maps on pairs of nodes.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_DISCRETE_H
#define DALEMBERT_DISCRETE_H

#include <dalembert/geometry.h>

#ifdef __cplusplus
extern "C" {
#endif

/* <cdef> */

/* ---- discretisation -------------------------------------------------------------------- */

/* A finite difference map rho(q0, q1) = (g, f) for the step h (FDM, roloc): a position and a
 * velocity made of two nodes, with g(q, q) = q, f(q, q) = 0 and df/dq1 = 1/h on the diagonal.
 * g[n], f[n]; the derivatives g_0[i*n+j] = dg_i/dq0_j, g_1 = dg/dq1, f_0 = df/dq0, f_1 = df/dq1,
 * [n*n] each.  q0[n], q1[n]; h may be negative. */
typedef int (*dal_map_fn)(double h, const double *q0, const double *q1, double *g, double *f,
                          double *g_0, double *g_1, double *f_0, double *f_1, void *ctx);

/* Zero-initialise, then set what is needed. */
typedef struct dal_difference_map {
    double beta;     /* in [0, 1].  With map NULL: rho^beta, g = (1-beta) q0 + beta q1 and
                        f = (q1-q0)/h (robeta; ro1, ro2 are 0 and 1/2).  Else where between the
                        nodes g lies, which only what depends on time has to know */
    dal_map_fn map;  /* of the user's own, or NULL */
    int differenced; /* 1: map gives g and f only; central differences then cost about 1e-12 of
                        D_r L_d, which the orbit sees, and nothing of phi_d */
    void *ctx;
} dal_difference_map;

/* The data of a scheme of the family pair, which "pair:A:B" is for rho^A and rho^B: its steps are
 * those of dal_discrete_advance. */
typedef struct dal_pair {
    dal_difference_map lagrangian, constraint; /* of L_d, of D_d */
} dal_pair;

/* A system with difference maps: the discrete Lagrangian L_d = h L o rho (aprox, Ld1), the discrete
 * constraint D_d = {phi_d = phi o rho' = 0} (DiscNHSet; of dimension 2n - m, E14), rho and rho'
 * maps that may differ, and their discrete Lagrange-d'Alembert equations
 *   D_2 L_d(q_(k-1), q_k) + f^+ + D_1 L_d(q_k, q_(k+1)) + f^- + h mu(q_k)^T lambda_(k+1) = 0,
 *   phi_d(q_k, q_(k+1)) = 0                                                             (DLA)
 * with f^- = h g_0^T f, f^+ = h g_1^T f for a generalized force f at rho.  lambda is a force; that
 * of the paper is -h lambda (E16).  mu(q_k) is phi_v(q_k, (v_k + v_(k+1))/2) with v the velocity
 * of rho' if phi is nonlinear.  Without constraints these are the discrete Euler-Lagrange equations
 * (discreteeq), and what is said of lambda[m], phi_d[m] is empty.
 *
 * The pair (q_(k-1), q_k) belongs to the state (q~_k, v_k) = rho'(q_(k-1), q_k) and to its time
 * t_k, which is the t of the functions below.  There phi_d is evaluated; L and f at t_k + (beta -
 * beta') h with the beta of rho and of rho', and mu(q_k) at t_k + (1 - beta') h. */
typedef struct dal_discrete dal_discrete;

/* lagrangian: rho; constraint: rho', or NULL: the same.  They are copied, their ctx is borrowed.
 * DAL_EINVAL (NULL, beta not in [0, 1]), DAL_ENOMEM. */
DAL_API int dal_discrete_new(dal_discrete **discrete, const dal_system *system,
                             const dal_difference_map *lagrangian,
                             const dal_difference_map *constraint, dal_error *error);
DAL_API void dal_discrete_free(dal_discrete *discrete);
/* What the last failure was, with the numbers; "" if there was none. */
DAL_API const dal_error *dal_discrete_error(const dal_discrete *discrete);
/* As dal_mechanics_input. */
DAL_API int dal_discrete_input(dal_discrete *discrete, const double *u);

/* Errors of the functions below: DAL_EINVAL (NULL, not finite, h = 0), DAL_EUSER, DAL_EDOMAIN, and
 * what is said. */

/* x[2n] <- rho'(q0, q1) (roloc).  q0[n], q1[n]. */
DAL_API int dal_discrete_state(dal_discrete *discrete, double h, const double *q0,
                               const double *q1, double *x);

/* q0[n], q1[n] <- the pair of nodes with rho'(q0, q1) = x[2n]: how a run on nodes starts from a
 * state, which gives a pair of D_d if x lies in D (E17).  rho^beta: q0 = q - beta h v, q1 = q +
 * (1-beta) h v; else by Newton.  Also DAL_ESINGULAR, DAL_ENOCONV. */
DAL_API int dal_discrete_nodes(dal_discrete *discrete, double t, double h, const double *x,
                               double *q0, double *q1);

/* *L_d; D1[n] = dL_d/dq0; D2[n] = dL_d/dq1; D12[i*n+j] = d2L_d/dq0_i dq1_j.  For a map of the
 * user's own D12 is good to about 1e-10, because its second derivatives are differenced.  Outputs
 * may be NULL. */
DAL_API int dal_discrete_lagrangian(dal_discrete *discrete, double t, double h, const double *q0,
                                    const double *q1, double *L_d, double *D1, double *D2,
                                    double *D12);

/* phi_d[m] (DiscNHSet, Ff); D1[m*n] = dphi_d/dq0; D2[m*n] = dphi_d/dq1.  Outputs may be NULL. */
DAL_API int dal_discrete_constraint(dal_discrete *discrete, double t, double h, const double *q0,
                                    const double *q1, double *phi_d, double *D1, double *D2);

/* The discrete Legendre transforms: minus[n] <- p^- = -D_1 L_d - f^-,
 * the momentum at q0; plus[n] <- p^+ = D_2 L_d + f^+, that at q1.  Either may be NULL.  Along an
 * orbit p^-(q_k, q_(k+1)) - p^+(q_(k-1), q_k) = h mu(q_k)^T lambda_(k+1). */
DAL_API int dal_discrete_momenta(dal_discrete *discrete, double t, double h, const double *q0,
                                 const double *q1, double *minus, double *plus);

/* The discrete momentum of a symmetry whose generator is xi0[n] at q0 and xi1[n] at q1: *minus <-
 * p^- . xi0, *plus <- p^+ . xi1.  Either may be NULL.  If L_d is invariant, the two are equal for
 * every pair; so without forces their value is constant along an orbit if m = 0 or mu(q_k) xi(q_k)
 * vanishes. */
DAL_API int dal_discrete_momentum(dal_discrete *discrete, double t, double h, const double *q0,
                                  const double *q1, const double *xi0, const double *xi1,
                                  double *minus, double *plus);

/* residual[n+m] <- the left sides of the two equations above (DLAa, DLAb) for three nodes [n] each
 * and lambda[m]; t is the time of (q_before, q). */
DAL_API int dal_discrete_residual(dal_discrete *discrete, double t, double h,
                                  const double *q_before, const double *q, const double *q_after,
                                  const double *lambda, double *residual);

/* The matrix that has to be invertible where q_after is to be found (REG, RegularityDLA, E15):
 *   matrix[(n+m)*(n+m)] = [[D_1 D_2 L_d + df^-/dq1, mu(q)^T], [D_2 phi_d, 0]] at (q, q_after),
 * with mu = phi_v(q, f) if phi is nonlinear; t is the time of the pair before.  Its determinant is
 * *sign exp(*logarithm), with *sign = 0 and -Inf where it vanishes to working precision, and equals
 * (-1/h)^n det K det S with the K and S = B K^-1 mu^T of dal_step_equations.  *condition: of the
 * matrix with its first n columns multiplied by h, which has a limit as h goes to 0; Inf if the
 * determinant vanishes.  Outputs may be NULL. */
DAL_API int dal_discrete_regularity(dal_discrete *discrete, double t, double h, const double *q,
                                    const double *q_after, double *matrix, int *sign,
                                    double *logarithm, double *condition);

/* The node map F (NHFlow): the pair q0[n], q1[n] at time t becomes (q_k, q_(k+1)), by Newton with
 * the regularity matrix; lambda[m] (or NULL) <- lambda_(k+1).  The pair need not lie in D_d, where
 * F is a map: elsewhere this step goes there.  Also DAL_ESINGULAR, DAL_ENOCONV. */
DAL_API int dal_discrete_step(dal_discrete *discrete, double t, double h, double *q0, double *q1,
                              double *lambda);

/* steps steps on nodes.  Rows 0 and 1 of nodes[(steps+2)*n] are a pair of D_d at time t0; row k + 2
 * and lambda[steps*m] (or NULL), row k, are made by step k.  (q1 - q0)/h is carried along, so what
 * it loses to the size of the nodes, u |q|/h, it loses once.  On failure *done (or NULL) steps are
 * good.  Also DAL_EOFFD (the first pair does not lie in D_d, as for DAL_CHECK),
 * DAL_ESINGULAR, DAL_ENOCONV. */
DAL_API int dal_discrete_run(dal_discrete *discrete, double t0, double h, size_t steps,
                             double *nodes, double *lambda, size_t *done);

/* The velocity integrator rho' F rho'^-1 (VNI, propoDcont, diagram): x[2n] at time t -> the state
 * at t + h; lambda[m] (or NULL) <- lambda_(k+1).  Afterwards x lies in D to roundoff, as after
 * dal_step.  With both maps rho^beta it is the beta-scheme; with maps of the user's own the nodes
 * lose u |q|/h of v in each step.  Also DAL_ESINGULAR, DAL_ENOCONV. */
DAL_API int dal_discrete_advance(dal_discrete *discrete, double t, double h, double *x,
                                 double *lambda);

/* Where (q0, q1) stands to the exact discrete constraint D_d^E = {(q0, q(h)) : v0 in D}, the q(h)
 * that the flow reaches from (q0, v0) in time h: v0[n] <- the velocity of D at q0 whose q(h)
 * misses q1 only in the direction M^-1 mu^T, across D; defect[m] (or NULL) <- mu (q1 - q(h))/h,
 * which is 0 if and only if the pair lies in D_d^E; mu and M at (q0, v0).  t0 is the time of q0.
 * By iteration with the flow, which contracts by O(h); the text of a failure is that of the flow.
 * DAL_EINVAL, DAL_ENOMEM, DAL_ESINGULAR, DAL_ENOCONV (h is too large), DAL_EUSER, DAL_EDOMAIN. */
DAL_API int dal_exact_velocity(dal_flow *flow, double t0, double h, const double *q0,
                               const double *q1, double *v0, double *defect);

/* </cdef> */

#ifdef __cplusplus
}
#endif
#endif /* DALEMBERT_DISCRETE_H */
