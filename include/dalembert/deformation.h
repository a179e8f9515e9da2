/* dalembert/deformation.h - systems whose constraints are those of another system, deformed.  The
 * rules of dalembert.h hold. */
#ifndef DALEMBERT_DEFORMATION_H
#define DALEMBERT_DEFORMATION_H

#include <dalembert.h>

#ifdef __cplusplus
extern "C" {
#endif

/* <cdef> */

/* g[m] of the deformation phi + delta g; g_v[m*n], g_q[m*n], g_t[m] its derivatives. */
typedef int (*dal_deformation_fn)(double t, const double *q, const double *v, double *g,
                                  double *g_v, double *g_q, double *g_t, void *ctx);

/* *system <- base with the constraints phi + delta g = 0 (deformation, DefCons, DefDAE): a system
 * as any other, of the given kind (of phi + delta g as a function of v), with C_delta,
 * lambda_delta and h_delta (Ceps, heps) from dal_gram, dal_multipliers and dal_field.  missing:
 * DAL_MISSING_PHI_Q if g_q is not provided, DAL_MISSING_PHI_T if g_t is not.  g may depend on t,
 * and g_t is asked for, only where base is time_dependent.  base and ctx must outlive it; exact
 * solution, invariants, initial data, description, source and formulas are not taken over.
 * DAL_EINVAL (NULL, delta not finite, kind, missing), DAL_ENOMEM, DAL_EUNSUPPORTED (m n > 4000). */
DAL_API int dal_system_deform(dal_system **system, const dal_system *base, dal_deformation_fn g,
                              void *ctx, double delta, dal_constraint_kind kind, unsigned missing,
                              dal_error *error);

/* *system <- base with the constraints phi(t, q - shift v, v) = 0, nonlinear: for shift = (1 -
 * beta) h its D is the D_eps that the beta-scheme with kept nodes preserves (deformedCons,
 * originalnodes). base must outlive it and provide phi_q.  Errors as of dal_system_deform. */
DAL_API int dal_system_deform_nodes(dal_system **system, const dal_system *base, double shift,
                                    dal_error *error);

/* </cdef> */

#ifdef __cplusplus
}
#endif
#endif /* DALEMBERT_DEFORMATION_H */
