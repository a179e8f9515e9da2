/* The compilations of the step routine: n <= 8, m <= 4 as constants, and any sizes. */
#include "step/kernel_rows.h"

dal_kernel_fn dal__kernel_any(void) { return kernel_any; }

dal_kernel_fn dal__kernel_for(size_t n, size_t m)
{
    dal_kernel_fn fixed = kernel_for(n, m);
    if (!fixed && m <= 4) fixed = dal__kernel_of_many(n, m);
    return fixed ? fixed : kernel_any;
}
