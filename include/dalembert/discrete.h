/* dalembert/discrete.h - discrete Lagrange-d'Alembert equations: difference maps, discrete
 * Lagrangians and constraints, and their maps on pairs of nodes.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_DISCRETE_H
#define DALEMBERT_DISCRETE_H

#include <dalembert/geometry.h>

DAL_BEGIN_DECLARATIONS

/* <cdef> */

/* ---- discretisation -------------------------------------------------------------------- */

/* A finite difference map rho(q0, q1) = (g, f) for the step h (FDM, roloc).  It computes a position
 * g[n] and a velocity f[n] from the nodes q0[n], q1[n].  On the diagonal, g(q, q) = q, f(q, q) = 0
 * and df/dq1 = 1/h.  The derivatives are g_0[i*n+j] = dg_i/dq0_j, g_1 = dg/dq1, f_0 = df/dq0 and
 * f_1 = df/dq1, [n*n] each.  The step h may be negative. */
typedef int (*dal_map_fn)(double h, const double *q0, const double *q1, double *g, double *f,
                          double *g_0, double *g_1, double *f_0, double *f_1, void *ctx);

/* A difference map: zero-initialise it, then set members. */
typedef struct dal_difference_map {
    double beta;     /* in [0, 1].  With map NULL: rho^beta, g = (1-beta) q0 + beta q1 and f =
                        (q1-q0)/h (robeta; ro1, ro2 are 0 and 1/2).  Otherwise the position of g
                        between the nodes, which only affects functions of time */
    dal_map_fn map;  /* your own map, or NULL */
    int differenced; /* 1: map provides g and f only.  Central differences then cause a relative
                        error of about 1e-12 in D_r L_d, and so in the orbit, but none in phi_d */
    void *ctx;
} dal_difference_map;

/* The data of a scheme of the family pair.  For rho^A and rho^B it is the scheme "pair:A:B".  Its
 * steps are those of dal_discrete_advance. */
typedef struct dal_pair {
    dal_difference_map lagrangian, constraint; /* maps of L_d and of D_d */
} dal_pair;

/* A system with difference maps rho and rho', which may differ.  They define the discrete
 * Lagrangian L_d = h L o rho (aprox, Ld1).  The discrete constraint is D_d = {phi_d = phi o rho' =
 * 0} (DiscNHSet), of dimension 2n - m (E14).  The discrete Lagrange-d'Alembert equations are
 *     D_2 L_d(q_(k-1), q_k) + f^+ + D_1 L_d(q_k, q_(k+1)) + f^- + h mu(q_k)^T lambda_(k+1) = 0,
 *     phi_d(q_k, q_(k+1)) = 0                                                             (DLA)
 * with f^- = h g_0^T f, f^+ = h g_1^T f for a generalized force f at rho.  The multiplier lambda is
 * a force; the multiplier of the paper is -h lambda (E16).  If phi is nonlinear, mu(q_k) is
 * phi_v(q_k, (v_k + v_(k+1))/2) with v the velocity of rho'.  Without constraints these are the
 * discrete Euler-Lagrange equations (discreteeq), and lambda[m] and phi_d[m] are empty.
 *
 * The pair (q_(k-1), q_k) belongs to the state (q~_k, v_k) = rho'(q_(k-1), q_k) and to its time
 * t_k, the argument t of the functions below.  There phi_d is evaluated.  With beta of rho and
 * beta' of rho', the time of L and f is t_k + (beta - beta') h.  The time of mu(q_k) is t_k + (1 -
 * beta') h. */
typedef struct dal_discrete dal_discrete;

/* Creates a dal_discrete with lagrangian as rho and constraint as rho'; NULL means the same map.
 * The maps are copied, their ctx is borrowed.
 * Errors: DAL_EINVAL (NULL, beta not in [0, 1]); DAL_ENOMEM. */
DAL_API int dal_discrete_new(dal_discrete **discrete, const dal_system *system,
                             const dal_difference_map *lagrangian,
                             const dal_difference_map *constraint, dal_error *error);
DAL_API void dal_discrete_free(dal_discrete *discrete);
/* Returns the record of the last failure; its text is "" if there was none. */
DAL_API const dal_error *dal_discrete_error(const dal_discrete *discrete);
/* Sets the inputs as dal_mechanics_input does. */
DAL_API int dal_discrete_input(dal_discrete *discrete, const double *u);

/* Errors of the functions below: DAL_EINVAL (NULL, not finite, h = 0); DAL_EUSER; DAL_EDOMAIN; and
 * those listed after "Also". */

/* Computes the state of a pair of nodes q0[n], q1[n]: x[2n] <- rho'(q0, q1) (roloc). */
DAL_API int dal_discrete_state(dal_discrete *discrete, double h, const double *q0,
                               const double *q1, double *x);

/* Computes the nodes from which a run starts: q0[n], q1[n] <- the pair with rho'(q0, q1) = x[2n].
 * It lies in D_d if x lies in D (E17).  For rho^beta, q0 = q - beta h v and q1 = q + (1-beta) h v;
 * other maps need Newton's iteration.
 * Also DAL_ESINGULAR, DAL_ENOCONV. */
DAL_API int dal_discrete_nodes(dal_discrete *discrete, double t, double h, const double *x,
                               double *q0, double *q1);

/* Computes *L_d and its derivatives D1[n] = dL_d/dq0, D2[n] = dL_d/dq1 and D12[i*n+j] = d2L_d/dq0_i
 * dq1_j.  For your own map D12 is accurate to about 1e-10, because the second derivatives of the
 * map are differenced.  Outputs may be NULL. */
DAL_API int dal_discrete_lagrangian(dal_discrete *discrete, double t, double h, const double *q0,
                                    const double *q1, double *L_d, double *D1, double *D2,
                                    double *D12);

/* Computes phi_d[m] (DiscNHSet, Ff) and its derivatives D1[m*n] = dphi_d/dq0 and D2[m*n] =
 * dphi_d/dq1.  Outputs may be NULL. */
DAL_API int dal_discrete_constraint(dal_discrete *discrete, double t, double h, const double *q0,
                                    const double *q1, double *phi_d, double *D1, double *D2);

/* Computes the discrete Legendre transforms: minus[n] <- p^- = -D_1 L_d - f^-, the momentum at q0;
 * plus[n] <- p^+ = D_2 L_d + f^+, the momentum at q1.  Either may be NULL.  Along an orbit p^-(q_k,
 * q_(k+1)) - p^+(q_(k-1), q_k) = h mu(q_k)^T lambda_(k+1). */
DAL_API int dal_discrete_momenta(dal_discrete *discrete, double t, double h, const double *q0,
                                 const double *q1, double *minus, double *plus);

/* Computes the discrete momentum of a symmetry with generator xi0[n] at q0 and xi1[n] at q1: *minus
 * <- p^- . xi0, *plus <- p^+ . xi1.  Either may be NULL.  If L_d is invariant, the two are equal
 * for every pair.  Without forces their value is then constant along an orbit if m = 0 or mu(q_k)
 * xi(q_k) vanishes. */
DAL_API int dal_discrete_momentum(dal_discrete *discrete, double t, double h, const double *q0,
                                  const double *q1, const double *xi0, const double *xi1,
                                  double *minus, double *plus);

/* Computes the residual of the equations: residual[n+m] <- the left sides of (DLAa, DLAb) for three
 * nodes of n numbers each and lambda[m]; t is the time of (q_before, q). */
DAL_API int dal_discrete_residual(dal_discrete *discrete, double t, double h,
                                  const double *q_before, const double *q, const double *q_after,
                                  const double *lambda, double *residual);

/* Computes the matrix that has to be invertible to determine q_after (REG, RegularityDLA, E15),
 *     matrix[(n+m)*(n+m)] = [[D_1 D_2 L_d + df^-/dq1, mu(q)^T], [D_2 phi_d, 0]] at (q, q_after),
 * with mu = phi_v(q, f) if phi is nonlinear; t is the time of the preceding pair.  Its determinant
 * is *sign exp(*logarithm), with *sign = 0 and -Inf if it vanishes to working precision.  It equals
 * (-1/h)^n det K det S with the K and S = B K^-1 mu^T of dal_step_equations.  *condition <- the
 * condition number of the matrix with its first n columns multiplied by h, which has a limit as h
 * goes to 0; Inf if the determinant vanishes.  Outputs may be NULL. */
DAL_API int dal_discrete_regularity(dal_discrete *discrete, double t, double h, const double *q,
                                    const double *q_after, double *matrix, int *sign,
                                    double *logarithm, double *condition);

/* Applies the node map F (NHFlow), by Newton's iteration with the regularity matrix.  The pair
 * q0[n], q1[n] at time t becomes (q_k, q_(k+1)), and lambda[m] (or NULL) <- lambda_(k+1).  F is a
 * map of D_d; a pair outside D_d is also accepted, and the new pair lies in D_d.
 * Also DAL_ESINGULAR, DAL_ENOCONV. */
DAL_API int dal_discrete_step(dal_discrete *discrete, double t, double h, double *q0, double *q1,
                              double *lambda);

/* Takes a number of steps on nodes.  Rows 0 and 1 of nodes[(steps+2)*n] are a pair of D_d at time
 * t0.  Step k computes row k + 2 and row k of lambda[steps*m] (or NULL).  The run keeps (q1 - q0)/h
 * as a variable, so its rounding error due to the size of the nodes, u |q|/h, occurs only once.
 * *done (or NULL) <- the number of successful steps.
 * Also DAL_EOFFD (the first pair does not lie in D_d, as for DAL_CHECK), DAL_ESINGULAR,
 * DAL_ENOCONV. */
DAL_API int dal_discrete_run(dal_discrete *discrete, double t0, double h, size_t steps,
                             double *nodes, double *lambda, size_t *done);

/* Takes a step of the velocity integrator rho' F rho'^-1 (VNI, propoDcont, diagram).  The state
 * x[2n] at time t becomes that at t + h, and lambda[m] (or NULL) <- lambda_(k+1).  Afterwards x
 * lies in D to roundoff, as after dal_step.  If both maps are rho^beta, this is the beta-scheme.
 * With your own maps the nodes cause a rounding error u |q|/h of v in each step.
 * Also DAL_ESINGULAR, DAL_ENOCONV. */
DAL_API int dal_discrete_advance(dal_discrete *discrete, double t, double h, double *x,
                                 double *lambda);

/* Compares a pair (q0, q1) with the exact discrete constraint D_d^E = {(q0, q(h)) : v0 in D}. Here
 * q(h) is the position that the flow reaches from (q0, v0) in time h.  The results are v0[n] <- the
 * velocity in D at q0 whose q(h) misses q1 only in the direction M^-1 mu^T; defect[m] (or NULL) <-
 * mu (q1 - q(h))/h, with mu and M at (q0, v0).  The defect is 0 if and only if the pair lies in
 * D_d^E.  The time of q0 is t0.  The iteration with the flow contracts by O(h).  Failures are
 * recorded in the flow.
 * Errors: DAL_EINVAL; DAL_ENOMEM; DAL_ESINGULAR; DAL_ENOCONV (h is too large); DAL_EUSER;
 * DAL_EDOMAIN. */
DAL_API int dal_exact_velocity(dal_flow *flow, double t0, double h, const double *q0,
                               const double *q1, double *v0, double *defect);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_DISCRETE_H */
