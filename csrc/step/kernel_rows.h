/* kernel_rows.h - the step routine for any sizes, as kernel_any, and with n <= 6, m <= 4 as
 * constants; with DAL_ROW_MOMENTA defined, with stages of momentum.h. */
#include "step/beta.h"

#ifdef DAL_ROW_MOMENTA
#define DAL_KERNEL_MOMENTA
#endif
#define DAL_KERNEL kernel_any
#include "dalembert/kernel.h"

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

/* The one for these sizes, or NULL. */
static dal_kernel_fn kernel_for(size_t n, size_t m)
{
    static const dal_kernel_fn *const rows[] = {row_1, row_2, row_3, row_4, row_5, row_6};
    return m <= 4 && n <= DAL_LENGTH(rows) ? rows[n - 1][m] : NULL;
}
