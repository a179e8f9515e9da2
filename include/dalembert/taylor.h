/* dalembert/taylor.h - what the polynomials of Taylor series give besides the steps.
 *
 * A step of the scheme "taylor" is a polynomial, or a few of them.  Kept, they give the state at
 * all times of a run.  The rules of dalembert.h hold. */
#ifndef DALEMBERT_TAYLOR_H
#define DALEMBERT_TAYLOR_H

#include <dalembert.h>

DAL_BEGIN_DECLARATIONS

/* <cdef> */
/* ---- dense output -------------------------------------------------------------------------- */

/* The polynomials of a motion.  A step of the default tolerance takes some 220 (2n - m) bytes for
 * each piece. */
typedef struct dal_dense dal_dense;

/* Creates them for motions of a system, of a scheme of the family taylor.
 * Errors: DAL_EINVAL; DAL_ENOMEM; DAL_EUNSUPPORTED (another family, or no series). */
DAL_API int dal_dense_new(dal_dense **dense, const dal_system *system, const dal_scheme *scheme,
                          dal_error *error);
DAL_API void dal_dense_free(dal_dense *dense);

/* From now on the stepper, of this system and scheme, keeps its polynomials in dense, instead of
 * those that it had; NULL: it keeps none.  Free dense after that, or after the stepper.
 * Errors: DAL_EINVAL (a stepper of another system or scheme). */
DAL_API int dal_stepper_keep(dal_stepper *stepper, dal_dense *dense);

/* Returns how many polynomials there are; *bytes, which may be NULL, <- their memory. */
DAL_API size_t dal_dense_count(const dal_dense *dense, size_t *bytes);

/* x[count*2n] <- the states at times in the motion, in any order: as exact as those of the steps,
 * in D to roundoff.  At the time of a reset it is the state after it.
 * Errors: DAL_EINVAL (a time outside); DAL_EDOMAIN; DAL_ESINGULAR; x is then unspecified. */
DAL_API int dal_dense_states(dal_dense *dense, size_t count, const double *t, double *x);
DAL_API const dal_error *dal_dense_error(const dal_dense *dense);

/* </cdef> */

DAL_END_DECLARATIONS
#endif /* DALEMBERT_TAYLOR_H */
