/* dalembert/inspect.h - names, sizes and properties of systems and schemes.  The rules of
 * dalembert.h hold. */
#ifndef DALEMBERT_INSPECT_H
#define DALEMBERT_INSPECT_H

#include <dalembert.h>

DAL_BEGIN_DECLARATIONS

/* <cdef> */
/* ---- systems --------------------------------------------------------------------------- */

/* Return the number of built-in systems, the name of the i-th, and a description of one line; NULL
 * if i is too large. */
DAL_API size_t dal_builtin_count(void);
DAL_API const char *dal_builtin_name(size_t i);
DAL_API const char *dal_builtin_help(size_t i);

/* Return the description of one line, and the sum of dal_missing. */
DAL_API const char *dal_system_help(const dal_system *system);
DAL_API unsigned dal_system_missing(const dal_system *system);
/* Return the texts of the definition, "" if not given. */
DAL_API const char *dal_system_description(const dal_system *system);
DAL_API const char *dal_system_source(const dal_system *system);
DAL_API const char *dal_system_formulas(const dal_system *system);
DAL_API const char *dal_system_coordinate(const dal_system *system, size_t i); /* NULL: i >= n */
DAL_API size_t dal_system_inputs(const dal_system *system);
DAL_API const char *dal_system_input_name(const dal_system *system, size_t i); /* or NULL */
/* M[n*n] (or NULL) <- the mass matrix.  Errors: DAL_EUNSUPPORTED if it is not constant. */
DAL_API int dal_system_mass(const dal_system *system, double *M);
/* Return the sparsity of the definition, or NULL. */
DAL_API const dal_sparsity *dal_system_sparsity(const dal_system *system);
DAL_API dal_constraint_kind dal_system_kind(const dal_system *system);
DAL_API int dal_system_is_forced(const dal_system *system); /* 1: there is a generalized force */
DAL_API int dal_system_is_driven(const dal_system *system); /* 1: constraints depend on inputs */
DAL_API int dal_system_is_time_dependent(const dal_system *system); /* as of the definition */
/* 1: its Taylor series are compiled; 2: also those of four motions at once. */
DAL_API int dal_system_has_series(const dal_system *system);

/* Return the parameters of a built-in system; your own systems have none. */
DAL_API size_t dal_system_parameters(const dal_system *system);
DAL_API const char *dal_system_parameter_name(const dal_system *system, size_t i); /* or NULL */
DAL_API double dal_system_parameter(const dal_system *system, size_t i);           /* or NaN */
/* Returns the number of bytes that an ensemble may replace for each member: the size of ctx if it
 * was copied; that of the parameter values, in their order, of a built-in system; else 0. */
DAL_API size_t dal_system_parameter_size(const dal_system *system);

/* The first integrals besides the energy: their number and names, and values[count] at x[2n] and
 * time t.
 * Errors: DAL_EUNSUPPORTED if there are none; DAL_EUSER; DAL_EDOMAIN; DAL_ENOMEM. */
DAL_API size_t dal_system_invariants(const dal_system *system);
DAL_API const char *dal_system_invariant_name(const dal_system *system, size_t i); /* or NULL */
DAL_API int dal_system_invariant(const dal_system *system, double t, const double *x,
                                 double *values);

/* ---- schemes --------------------------------------------------------------------------- */

/* The table of named schemes: their number, and the i-th.  Errors: DAL_EINVAL if i is too large. */
DAL_API size_t dal_scheme_count(void);
DAL_API int dal_scheme_at(dal_scheme *scheme, size_t i);

/* Returns the name of the family that computes the steps: "beta", "pair", "flow", or your own. */
DAL_API const char *dal_scheme_family(const dal_scheme *scheme);

/* Returns 1 if every step of scheme on system is a sequence of linear solves without iteration,
 * else 0.  The condition is: beta = 0 in every sub-step, constant mass, no force, and linear or
 * affine constraints. */
DAL_API int dal_scheme_is_explicit(const dal_scheme *scheme, const dal_system *system);

/* *shift <- 1 - beta, for a scheme with a single sub-step: its D_eps has the shift (1 - beta) h.
 * Errors: DAL_EUNSUPPORTED for a scheme with several sub-steps. */
DAL_API int dal_scheme_shift(const dal_scheme *scheme, double *shift);

/* *eps <- the default eps of reversible steps (dal_options) of scheme: 0.8 / sum_j |fraction_j|
 * over its sub-steps, at most 0.2.
 * Errors: DAL_EUNSUPPORTED unless the scheme is a self-adjoint composition of more than two
 * sub-steps with moved nodes, such as bm6 and leapfrog-kl8. */
DAL_API int dal_scheme_eps(const dal_scheme *scheme, double *eps, dal_error *error);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_INSPECT_H */
