/* The same with stages of momentum.h: n <= 6, m <= 4 as constants, and any sizes. */
#define DAL_ROW_MOMENTA
#include "step/kernel_rows.h"

dal_kernel_fn dal__kernel_any_with_momenta(void) { return kernel_any; }

dal_kernel_fn dal__kernel_with_momenta(size_t n, size_t m)
{
    const dal_kernel_fn fixed = kernel_for(n, m);
    return fixed ? fixed : kernel_any;
}
