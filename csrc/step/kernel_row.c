/* The step routine for n = DAL_ROW coordinates and m < n constraints, m <= 4, all as constants, and
 * the table DAL_ROW_TABLE of them by m.  With DAL_KERNEL_MOMENTA they have stages of momentum.h.
 * The build compiles this file for each n <= 6 and both kinds, side by side. */
#include "step/beta.h"

#ifdef DAL_KERNEL_MOMENTA
#define DAL_ROW_MOMENTA
#endif

#define DAL_N DAL_ROW
#define DAL_M 0
#define DAL_KERNEL without_constraints
#include "dalembert/kernel.h"

#if DAL_ROW > 1
#define DAL_N DAL_ROW
#define DAL_M 1
#define DAL_KERNEL with_1
#ifdef DAL_ROW_MOMENTA
#define DAL_KERNEL_MOMENTA
#endif
#include "dalembert/kernel.h"
#endif

#if DAL_ROW > 2
#define DAL_N DAL_ROW
#define DAL_M 2
#define DAL_KERNEL with_2
#ifdef DAL_ROW_MOMENTA
#define DAL_KERNEL_MOMENTA
#endif
#include "dalembert/kernel.h"
#endif

#if DAL_ROW > 3
#define DAL_N DAL_ROW
#define DAL_M 3
#define DAL_KERNEL with_3
#ifdef DAL_ROW_MOMENTA
#define DAL_KERNEL_MOMENTA
#endif
#include "dalembert/kernel.h"
#endif

#if DAL_ROW > 4
#define DAL_N DAL_ROW
#define DAL_M 4
#define DAL_KERNEL with_4
#ifdef DAL_ROW_MOMENTA
#define DAL_KERNEL_MOMENTA
#endif
#include "dalembert/kernel.h"
#endif

const dal_kernel_fn DAL_ROW_TABLE[5] = {
    without_constraints,
#if DAL_ROW > 1
    with_1,
#endif
#if DAL_ROW > 2
    with_2,
#endif
#if DAL_ROW > 3
    with_3,
#endif
#if DAL_ROW > 4
    with_4,
#endif
};
