/* kernel_row.h - the step routine for n = DAL_ROW and every m < n up to 4, as kernel_n_m, and the
 * row_n of them, by m; with DAL_ROW_MOMENTA defined, those with stages of momentum.h. */
#define DAL_ROW_TABLE_(n) row_##n
#define DAL_ROW_TABLE(n) DAL_ROW_TABLE_(n)
#define DAL_ROW_JOIN_(n, m) kernel_##n##_##m
#define DAL_ROW_JOIN(n, m) DAL_ROW_JOIN_(n, m)

#define DAL_N DAL_ROW
#define DAL_M 0
#define DAL_KERNEL DAL_ROW_JOIN(DAL_ROW, 0)
#ifdef DAL_ROW_MOMENTA
#define DAL_KERNEL_MOMENTA
#endif
#include "dalembert/kernel.h"

#if DAL_ROW > 1
#define DAL_N DAL_ROW
#define DAL_M 1
#define DAL_KERNEL DAL_ROW_JOIN(DAL_ROW, 1)
#ifdef DAL_ROW_MOMENTA
#define DAL_KERNEL_MOMENTA
#endif
#include "dalembert/kernel.h"
#endif

#if DAL_ROW > 2
#define DAL_N DAL_ROW
#define DAL_M 2
#define DAL_KERNEL DAL_ROW_JOIN(DAL_ROW, 2)
#ifdef DAL_ROW_MOMENTA
#define DAL_KERNEL_MOMENTA
#endif
#include "dalembert/kernel.h"
#endif

#if DAL_ROW > 3
#define DAL_N DAL_ROW
#define DAL_M 3
#define DAL_KERNEL DAL_ROW_JOIN(DAL_ROW, 3)
#ifdef DAL_ROW_MOMENTA
#define DAL_KERNEL_MOMENTA
#endif
#include "dalembert/kernel.h"
#endif

#if DAL_ROW > 4
#define DAL_N DAL_ROW
#define DAL_M 4
#define DAL_KERNEL DAL_ROW_JOIN(DAL_ROW, 4)
#ifdef DAL_ROW_MOMENTA
#define DAL_KERNEL_MOMENTA
#endif
#include "dalembert/kernel.h"
#endif

static const dal_kernel_fn DAL_ROW_TABLE(DAL_ROW)[5] = {
    DAL_ROW_JOIN(DAL_ROW, 0),
#if DAL_ROW > 1
    DAL_ROW_JOIN(DAL_ROW, 1),
#endif
#if DAL_ROW > 2
    DAL_ROW_JOIN(DAL_ROW, 2),
#endif
#if DAL_ROW > 3
    DAL_ROW_JOIN(DAL_ROW, 3),
#endif
#if DAL_ROW > 4
    DAL_ROW_JOIN(DAL_ROW, 4),
#endif
};

#undef DAL_ROW_TABLE
#undef DAL_ROW_TABLE_
#undef DAL_ROW_JOIN
#undef DAL_ROW_JOIN_
#undef DAL_ROW
