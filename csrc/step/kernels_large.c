/* The compilations for n = 7 and 8, apart because they take almost as long as the rest. */
#include "step/beta.h"

#define DAL_ROW 7
#include "step/kernel_row.h"
#define DAL_ROW 8
#include "step/kernel_row.h"

dal_kernel_fn dal__kernel_of_many(size_t n, size_t m)
{
    return n == 7 ? row_7[m] : n == 8 ? row_8[m] : NULL;
}
