/* dalembert/deformation.h - systems with deformed constraints of another system.  The rules of
 * dalembert.h hold. */
#ifndef DALEMBERT_DEFORMATION_H
#define DALEMBERT_DEFORMATION_H

#include <dalembert.h>

DAL_BEGIN_DECLARATIONS

/* <cdef> */

/* The deformation g[m] in phi + delta g, with its derivatives g_v[m*n], g_q[m*n], g_t[m]. */
typedef int (*dal_deformation_fn)(double t, const double *q, const double *v, double *g,
                                  double *g_v, double *g_q, double *g_t, void *ctx);

/* Creates a system: *system <- base with the constraints phi + delta g = 0 (deformation, DefCons,
 * DefDAE).  The given kind is that of phi + delta g as a function of v.  For this system dal_gram,
 * dal_multipliers and dal_field compute C_delta, lambda_delta and h_delta (Ceps, heps).  The value
 * of missing is DAL_MISSING_PHI_Q if g_q is not provided, plus DAL_MISSING_PHI_T if g_t is not.
 * Only if base is time_dependent may g depend on t, and g_t is requested.  Both base and ctx must
 * outlive the system.  Exact solution, invariants, initial data, description, source and formulas
 * are not copied.
 * Errors: DAL_EINVAL (NULL, delta not finite, kind, missing); DAL_ENOMEM; DAL_EUNSUPPORTED (m n >
 * 4000). */
DAL_API int dal_system_deform(dal_system **system, const dal_system *base, dal_deformation_fn g,
                              void *ctx, double delta, dal_constraint_kind kind, unsigned missing,
                              dal_error *error);

/* Creates a system: *system <- base with the nonlinear constraints phi(t, q - shift v, v) = 0.  For
 * shift = (1 - beta) h its D is the D_eps that the beta-scheme with kept nodes preserves
 * (deformedCons, originalnodes).  The system base must outlive it and provide phi_q.
 * Errors: as for dal_system_deform. */
DAL_API int dal_system_deform_nodes(dal_system **system, const dal_system *base, double shift,
                                    dal_error *error);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_DEFORMATION_H */
