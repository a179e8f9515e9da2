/* The compilations of the step routine: for any sizes here, for small ones in kernel_row.c. */
#include "step/beta.h"

#define DAL_KERNEL any
#include "dalembert/kernel.h"

#define DAL_KERNEL any_with_momenta
#define DAL_KERNEL_MOMENTA
#include "dalembert/kernel.h"

#define TABLES(kind) \
    dal__##kind##_1, dal__##kind##_2, dal__##kind##_3, dal__##kind##_4, dal__##kind##_5, \
    dal__##kind##_6

static const dal_kernel_fn *const plain[] = {TABLES(plain)}, *const momenta[] = {TABLES(momenta)};

dal_kernel_fn dal__kernel_any(bool with_momenta) { return with_momenta ? any_with_momenta : any; }

dal_kernel_fn dal__kernel_for(size_t n, size_t m, bool with_momenta)
{
    if (m >= n || m > 4 || n > DAL_LENGTH(plain)) return dal__kernel_any(with_momenta);
    return (with_momenta ? momenta : plain)[n - 1][m];
}
