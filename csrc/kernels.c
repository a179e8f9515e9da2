/* Floor 6: the compilations of the step routine: n <= 8, m <= 4 as constants, and any sizes. */
#include "internal.h"
#include "kernel.h"

#define DAL_KERNEL kernel_any
#include "kernel.h"

#define DAL_ROW 1
#include "kernel_row.h"
#define DAL_ROW 2
#include "kernel_row.h"
#define DAL_ROW 3
#include "kernel_row.h"
#define DAL_ROW 4
#include "kernel_row.h"
#define DAL_ROW 5
#include "kernel_row.h"
#define DAL_ROW 6
#include "kernel_row.h"
#define DAL_ROW 7
#include "kernel_row.h"
#define DAL_ROW 8
#include "kernel_row.h"

dal_kernel_fn dal__kernel_for(size_t n, size_t m, dal_sizes sizes)
{
    static const dal_kernel_fn table[8][5] = {
        {kernel_1_0, NULL, NULL, NULL, NULL},
        {kernel_2_0, kernel_2_1, NULL, NULL, NULL},
        {kernel_3_0, kernel_3_1, kernel_3_2, NULL, NULL},
        {kernel_4_0, kernel_4_1, kernel_4_2, kernel_4_3, NULL},
        {kernel_5_0, kernel_5_1, kernel_5_2, kernel_5_3, kernel_5_4},
        {kernel_6_0, kernel_6_1, kernel_6_2, kernel_6_3, kernel_6_4},
        {kernel_7_0, kernel_7_1, kernel_7_2, kernel_7_3, kernel_7_4},
        {kernel_8_0, kernel_8_1, kernel_8_2, kernel_8_3, kernel_8_4},
    };
    const dal_kernel_fn fixed = n <= 8 && m <= 4 ? table[n - 1][m] : NULL;
    return fixed && sizes == DAL_SIZES_AUTO ? fixed : kernel_any;
}
