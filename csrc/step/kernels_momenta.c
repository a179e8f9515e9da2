/* The compilations of the step routine with stages of momentum.h: n <= 6, m <= 4 as constants, and
 * any sizes. */
#include "step/beta.h"

#define DAL_KERNEL_MOMENTA
#define DAL_KERNEL kernel_any
#include "dalembert/kernel.h"

#define DAL_ROW_MOMENTA
#define DAL_ROW 1
#include "step/kernel_row.h"
#define DAL_ROW 2
#include "step/kernel_row.h"
#define DAL_ROW 3
#include "step/kernel_row.h"
#define DAL_ROW 4
#include "step/kernel_row.h"
#define DAL_ROW 5
#include "step/kernel_row.h"
#define DAL_ROW 6
#include "step/kernel_row.h"

dal_kernel_fn dal__kernel_any_with_momenta(void) { return kernel_any; }

dal_kernel_fn dal__kernel_with_momenta(size_t n, size_t m)
{
    static const dal_kernel_fn *const rows[] = {row_1, row_2, row_3, row_4, row_5, row_6};
    return m <= 4 && n <= DAL_LENGTH(rows) ? rows[n - 1][m] : kernel_any;
}
