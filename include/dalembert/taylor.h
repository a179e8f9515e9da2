/* dalembert/taylor.h - dense output and derivatives by Taylor series.
 *
 * A step of the scheme "taylor" is a polynomial, or a few of them.  Kept, they give the state at
 * all times of a run.  Along them the derivatives of the motion have series as well.  The rules of
 * dalembert.h hold. */
#ifndef DALEMBERT_TAYLOR_H
#define DALEMBERT_TAYLOR_H

#include <dalembert/run.h>

DAL_BEGIN_DECLARATIONS

/* <cdef> */
/* ---- dense output -------------------------------------------------------------------------- */

/* The polynomials of a motion.  With the default tolerance each takes 264 bytes for each of the
 * numbers (q, w).  Their count is rounded up to a multiple of four. */
typedef struct dal_taylor_dense dal_taylor_dense;

/* Creates them for motions of a system, of a scheme of the family taylor.
 * Errors: DAL_EINVAL; DAL_ENOMEM; DAL_EUNSUPPORTED (another family, or no series). */
DAL_API int dal_taylor_dense_new(dal_taylor_dense **dense, const dal_system *system,
                                 const dal_scheme *scheme, dal_error *error);
DAL_API void dal_taylor_dense_free(dal_taylor_dense *dense);

/* From now on the stepper, of this system and scheme, keeps its polynomials in dense, instead of
 * those that it had; NULL: it keeps none.  Free dense after that, or after the stepper.  Use a
 * dense for one stepper at a time.
 * Errors: DAL_EINVAL (a stepper of another system or scheme). */
DAL_API int dal_taylor_keep(dal_stepper *stepper, dal_taylor_dense *dense);

/* Returns how many polynomials there are; *bytes, which may be NULL, <- their memory. */
DAL_API size_t dal_taylor_dense_count(const dal_taylor_dense *dense, size_t *bytes);

/* x[count*2n] <- the states at times in the motion, in any order: as exact as those of the steps,
 * in D to roundoff.  At the time of a reset it is the state after it.
 * Errors: DAL_EINVAL (a time outside); DAL_EDOMAIN; DAL_ESINGULAR; x is then unspecified. */
DAL_API int dal_taylor_dense_states(dal_taylor_dense *dense, size_t count, const double *t,
                                    double *x);
DAL_API const dal_error *dal_taylor_dense_error(const dal_taylor_dense *dense);

/* ---- derivatives --------------------------------------------------------------------------- */

/* A motion, and its derivatives by its start, by parameters and by constant inputs: the variational
 * equations.  Their series are compiled for the system: `variations` of its definition.  If a
 * force jumps, the derivative of the time of the jump is included.  At a start on a kink or a jump
 * the derivatives are one-sided. */
typedef struct dal_taylor_variations dal_taylor_variations;

/* Creates them for a number of columns.  The order is 1, or 2 for all pairs of columns as well.
 * Errors: DAL_EINVAL; DAL_ENOMEM; DAL_EUNSUPPORTED (another family; the series of this order have
 * not been compiled; constraints that depend on inputs, or without equations on D in closed
 * form). */
DAL_API int dal_taylor_variations_new(dal_taylor_variations **variations, const dal_system *system,
                                      const dal_scheme *scheme, int order, size_t columns,
                                      dal_error *error);
DAL_API void dal_taylor_variations_free(dal_taylor_variations *variations);

/* dx[2n] <- the derivatives of x[2n] in D at time t, tangent to D, from dy[states] of the numbers
 * (q, w) and dz[parameters + inputs], or NULL.  So unit vectors dy give a basis of the tangent
 * space.
 * Errors: DAL_EINVAL. */
DAL_API int dal_taylor_variations_column(dal_taylor_variations *variations, double t,
                                         const double *x, const double *dy, const double *dz,
                                         double *dx);

/* The motion starts from x[2n] in D.  Column k has the derivatives of x in dx[columns*2n], and
 * those of the parameters and of the inputs in dz[columns*(parameters + inputs)], or NULL for
 * none.  They have to be tangent to D: phi_q dq + phi_v dv + phi_z dz = 0.  Second derivatives are
 * those along straight lines in (q, w, z), so at the start they are 0 in these numbers.
 * Errors: DAL_EINVAL; DAL_EOFFD (x, or a column); those of the callbacks. */
DAL_API int dal_taylor_variations_start(dal_taylor_variations *variations, double t,
                                        const double *x, const double *dx, const double *dz);

/* The inputs from now on, [inputs]; they are 0 before. */
DAL_API int dal_taylor_variations_input(dal_taylor_variations *variations, const double *u);

/* Continues to a time.  The watch, or NULL, is asked now and then, as by dal_run.  On failure
 * nothing has changed.
 * Errors: those of steps; DAL_EDOMAIN (the motion touches a jump of the force); DAL_EUNSUPPORTED
 * (second derivatives where a function has a kink). */
DAL_API int dal_taylor_variations_go(dal_taylor_variations *variations, double t_end,
                                     dal_watch_fn watch, void *ctx);

/* The number of the numbers (q, w): 2n - m, or 2n if w is v. */
DAL_API size_t dal_taylor_variations_states(const dal_taylor_variations *variations);

/* The time and the state x[2n] now; the acceleration dv/dt[n] of the motion that led there, NaN at
 * the start; the derivatives dx[columns*2n].  For order 2 the second derivatives d2x[pairs*2n],
 * with the pairs (0, 0), (0, 1), ... (0, columns - 1), (1, 1), ...; else NULL. */
DAL_API double dal_taylor_variations_time(const dal_taylor_variations *variations);
DAL_API const double *dal_taylor_variations_state(const dal_taylor_variations *variations);
DAL_API const double *dal_taylor_variations_acceleration(const dal_taylor_variations *variations);
DAL_API const double *dal_taylor_variations_columns(const dal_taylor_variations *variations);
DAL_API const double *dal_taylor_variations_second(const dal_taylor_variations *variations);
DAL_API const dal_error *dal_taylor_variations_error(const dal_taylor_variations *variations);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_TAYLOR_H */
