/* The compilations of the step routine with stages of momentum.h. */
#include "step/beta.h"

#define DAL_KERNEL_MOMENTA
#define DAL_KERNEL kernel_any_with_momenta
#include "dalembert/kernel.h"

dal_kernel_fn dal__kernel_any_with_momenta(void) { return kernel_any_with_momenta; }

dal_kernel_fn dal__kernel_with_momenta(size_t n, size_t m)
{
    (void)n;
    (void)m;
    return kernel_any_with_momenta;
}
