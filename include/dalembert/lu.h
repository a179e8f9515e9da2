/* lu.h - LU factors of a dense matrix, and a test of singularity.
 *
 * The rows and columns of A have sizes r_i and c_j, such that no term in the sum A_ij is much
 * larger than r_i c_j.  The scaled matrix is A_ij / (r_i c_j).  It does not change if rows, columns
 * or coordinates are rescaled together with their sizes, and it is small if terms cancel.  Pivots
 * are the largest of the scaled column, so |L| <= 1 and elements grow little.  A is singular if the
 * larger of 1 and the scaled matrix, times the estimated size of its inverse, is above
 * DAL_LU_CONDITION.  The scaling is not carried out, because it would not change a digit.  Header
 * only: generated code has no library to link. */
#ifndef DALEMBERT_LU_H
#define DALEMBERT_LU_H

#include <math.h>
#include <stddef.h>

/* If m is a constant, these must be visible to the optimiser. */
#if defined(__GNUC__)
#define DAL_LU_INLINE static inline __attribute__((always_inline))
#define DAL_LU_RARE static __attribute__((noinline, unused)) /* cold would spread to its callers */
#define DAL_LU_MOSTLY(condition) __builtin_expect(!!(condition), 1)
#else
#define DAL_LU_INLINE static inline
#define DAL_LU_RARE static inline
#define DAL_LU_MOSTLY(condition) (condition)
#endif

/* Above this condition number the solution has no correct digits: 1e15 u is 0.1. */
#define DAL_LU_CONDITION 1e15

/* For m = 2, a matrix is regular under two conditions: the product of the pivots is positive and at
 * least its size over this factor; the entry above the second is less than its size times this
 * factor.  With |L| <= 1 and pivots not above 2^4 of their sizes, they are above 2^-12.  The x of
 * dal_lu_is_regular is then at most 2^13 for the second row and 2^12 (1 + 2^8 2^13) for the first;
 * times m and 2^8 this is below 2^43. */
#define DAL_LU_EASY 0x1p8

/* x[m] <- A^-1 b[m] from the factors; x and b may not overlap. */
DAL_LU_INLINE void dal_lu_solve(size_t m, const double *A, const size_t *row, const double *b,
                                double *x)
{
    if (m == 1) { /* without the detour through row[], which the optimiser does not see through */
        x[0] = b[0] * A[0];
        return;
    }
    if (m == 2) {
        const double upper = row[0] ? b[1] : b[0], lower = row[0] ? b[0] : b[1];
        x[1] = (lower - A[2] * upper) * A[3];
        x[0] = (upper - A[1] * x[1]) * A[0];
        return;
    }
    for (size_t i = 0; i < m; i++) {
        double sum = b[row[i]];
        for (size_t k = 0; k < i; k++) sum -= A[i * m + k] * x[k];
        x[i] = sum;
    }
    for (size_t i = m; i-- > 0;) {
        double sum = x[i];
        for (size_t k = i + 1; k < m; k++) sum -= A[i * m + k] * x[k];
        x[i] = sum * A[i * m + i];
    }
}

/* x[m] <- A^-T b[m]; b is destroyed. */
static inline void dal_lu_solve_transposed(size_t m, const double *A, const size_t *row, double *b,
                                           double *x)
{
    for (size_t i = 0; i < m; i++) {
        for (size_t k = 0; k < i; k++) b[i] -= A[k * m + i] * b[k];
        b[i] *= A[i * m + i];
    }
    for (size_t i = m; i-- > 0;) {
        for (size_t k = i + 1; k < m; k++) b[i] -= A[k * m + i] * b[k];
        x[row[i]] = b[i];
    }
}

/* 1/|det A|, the product of the inverted pivots in the factors of A[m*m], m > 0. */
DAL_LU_INLINE double dal_lu_inverse_determinant(size_t m, const double *A)
{
    double product = A[0];
    for (size_t i = 1; i < m; i++) product *= A[i * (m + 1)];
    return fabs(product);
}

/* The factors of a matrix, and functions that solve with them, like the two above. */
typedef struct dal_lu_factors {
    void (*solve)(const struct dal_lu_factors *self, const double *b, double *x);
    void (*solve_transposed)(const struct dal_lu_factors *self, double *b, double *x);
    size_t m;
    const double *A;
    const size_t *row;
    size_t width; /* for the factors of others */
} dal_lu_factors;

static inline void dal_lu_solve_by(const dal_lu_factors *self, const double *b, double *x)
{
    dal_lu_solve(self->m, self->A, self->row, b, x);
}

static inline void dal_lu_solve_transposed_by(const dal_lu_factors *self, double *b, double *x)
{
    dal_lu_solve_transposed(self->m, self->A, self->row, b, x);
}

/* Component i of a vector of 1-norm 1 or less: a column; or for m all columns at once; or for m + 1
 * all, with independent weights from -1 to 1. */
static inline double dal_lu_start(size_t m, size_t column, size_t i)
{
    if (column < m) return column == i ? 1.0 : 0.0;
    if (column == m) return 1.0 / (double)m;
    unsigned long mixed = (i + 1) * 2654435761UL & 0xffffffffUL;
    mixed = (mixed ^ mixed >> 15) * 2246822519UL & 0xffffffffUL;
    return ((double)(mixed >> 8) * 0x1p-23 - 1.0) / (double)m;
}

/* The 1-norm of the inverse of the scaled matrix, or a little less.  It is that of the best column
 * found by ascent (W. W.  Hager, SIAM J.  Sci.  Stat.  Comput. 5, 1984), from all columns at once,
 * then from all with weights.  The first start fails if two rows, or the sums of two pairs, almost
 * coincide.  Alternating signs (N. J.  Higham, ACM Trans.  Math.  Softw. 14, 1988) fail if there is
 * one row between these rows.  The array scratch[3*m] is workspace. */
DAL_LU_RARE double dal_lu_inverse_norm(const dal_lu_factors *factors, const double *row_size,
                                       const double *column_size, double *scratch)
{
    const size_t m = factors->m;
    enum { MOST = 5 };
    double *const x = scratch, *const y = x + m, *const z = y + m, norm = 0.0;
    for (size_t start = m; start <= m + 1; start++) {
        size_t column = start;
        double last = 0.0;
        for (int climb = 0; climb < MOST; climb++) {
            for (size_t i = 0; i < m; i++) x[i] = row_size[i] * dal_lu_start(m, column, i);
            factors->solve(factors, x, y);
            double sum = 0.0, most = 0.0, here = 0.0;
            for (size_t i = 0; i < m; i++) {
                sum += fabs(y[i] * column_size[i]);
                y[i] = copysign(column_size[i], y[i]);
            }
            if (isnan(sum)) return sum;
            if (sum <= last) break;
            last = sum;
            factors->solve_transposed(factors, y, z);
            size_t best = 0;
            for (size_t i = 0; i < m; i++) {
                const double slope = z[i] * row_size[i];
                here += slope * dal_lu_start(m, column, i);
                if (fabs(slope) > most) most = fabs(slope), best = i;
            }
            if (most <= here) break;
            column = best;
        }
        if (last > norm) norm = last;
    }
    return norm;
}

/* Whether the scaled matrix is regular.  A bound costs O(m^2): no row sum of the inverse exceeds
 * the solution x of M(L) M(U) x = 1.  Here M has the absolute values of the entries, with a minus
 * off the diagonal.  For large m the bound is often far too large; then the inverse is estimated.
 */
DAL_LU_INLINE int dal_lu_is_regular(size_t m, const double *A, const size_t *row,
                                    const double *row_size, const double *column_size,
                                    double *scratch)
{
    double *const x = scratch, largest = 1.0, bound = 0.0; /* largest: of the scaled U */
    for (size_t i = 0; i < m; i++) {
        double sum = row_size[row[i]];
        for (size_t k = 0; k < i; k++) sum += fabs(A[i * m + k]) * x[k];
        x[i] = sum;
    }
    for (size_t i = m; i-- > 0;) {
        const double size = row_size[row[i]];
        double sum = x[i];
        if (fabs(A[i * m + i]) * largest * size * column_size[i] < 1.0)
            largest = 1.0 / (fabs(A[i * m + i]) * size * column_size[i]);
        for (size_t k = i + 1; k < m; k++) {
            sum += fabs(A[i * m + k]) * x[k];
            if (fabs(A[i * m + k]) > largest * size * column_size[k])
                largest = fabs(A[i * m + k]) / (size * column_size[k]);
        }
        x[i] = sum * fabs(A[i * m + i]);
        if (!(x[i] * column_size[i] <= bound)) bound = x[i] * column_size[i]; /* also NaN */
    }
    const double most = DAL_LU_CONDITION / ((double)m * largest);
    if (bound <= most) return 1;
    const dal_lu_factors factors = {dal_lu_solve_by, dal_lu_solve_transposed_by, m, A, row, m};
    return dal_lu_inverse_norm(&factors, row_size, column_size, scratch) <= most;
}

/* The same for m = 2, with copies as arguments, so that the arrays of the caller need no memory. */
DAL_LU_RARE int dal_lu_are_regular(double inverse, double b, double l, double rest, int swap,
                                   double upper, double lower, double c, double d)
{
    const double A[] = {inverse, b, l, rest}, columns[] = {c, d};
    const double rows[] = {swap ? lower : upper, swap ? upper : lower};
    const size_t row[] = {swap ? 1 : 0, swap ? 0 : 1};
    double scratch[6];
    return dal_lu_is_regular(2, A, row, rows, columns, scratch);
}

/* Like dal_lu_factor for m = 2, with the pivoted rows (a, b) and (c, d).  The operations are the
 * same, with constant indices for the optimiser. */
DAL_LU_INLINE int dal_lu_factor_rows(double a, double b, double c, double d, double upper,
                                     double lower, int swap, double *A, const double *sizes,
                                     size_t *row)
{
    const double inverse = 1.0 / a, l = c * inverse, rest = d - l * b;
    row[0] = swap ? 1 : 0;
    row[1] = swap ? 0 : 1;
    A[0] = inverse;
    A[1] = b;
    A[2] = l;
    A[3] = 1.0 / rest;
    if (DAL_LU_MOSTLY(a * rest * DAL_LU_EASY > upper * sizes[2] * (lower * sizes[3])
                      && fabs(b) < DAL_LU_EASY * (upper * sizes[3])))
        return swap ? -1 : 1;
    if (!dal_lu_are_regular(A[0], b, l, A[3], swap, upper, lower, sizes[2], sizes[3])) return 0;
    return (swap != (a < 0.0)) != (rest < 0.0) ? -1 : 1;
}

/* Factors A[m*m] in place, with rows permuted as in row[m] and the diagonal of U inverted.  The
 * array sizes[5*m] has the sizes of the rows, then of the columns; the rest is workspace.  Returns
 * the sign of det A, or 0 if A is singular or NaN.  With an Inf in A the residual of the result of
 * dal_lu_solve is not finite or not small. */
DAL_LU_INLINE int dal_lu_factor(size_t m, double *A, double *sizes, size_t *row)
{
    if (m == 0) return 1;
    if (m == 1) {
        const double pivot = A[0];
        A[0] = 1.0 / pivot;
        row[0] = 0;
        if (pivot * DAL_LU_CONDITION > sizes[0] * sizes[1]) return 1;
        return -pivot * DAL_LU_CONDITION > sizes[0] * sizes[1] ? -1 : 0;
    }
    if (m == 2) {
        const double a = A[0], b = A[1], c = A[2], d = A[3], r = sizes[0], s = sizes[1];
        return fabs(c) * r > fabs(a) * s ? dal_lu_factor_rows(c, d, a, b, s, r, 1, A, sizes, row)
                                         : dal_lu_factor_rows(a, b, c, d, r, s, 0, A, sizes, row);
    }
    int sign = 1;
    for (size_t i = 0; i < m; i++) row[i] = i;
    for (size_t j = 0; j < m; j++) {
        size_t best = j;
        for (size_t i = j + 1; i < m; i++)
            if (fabs(A[i * m + j]) * sizes[row[best]] > fabs(A[best * m + j]) * sizes[row[i]])
                best = i;
        if (best != j) {
            for (size_t k = 0; k < m; k++) {
                const double a = A[j * m + k];
                A[j * m + k] = A[best * m + k];
                A[best * m + k] = a;
            }
            const size_t swap = row[j];
            row[j] = row[best];
            row[best] = swap;
            sign = -sign;
        }
        if (A[j * m + j] < 0.0) sign = -sign;
        const double inverse = 1.0 / A[j * m + j];
        A[j * m + j] = inverse;
        for (size_t i = j + 1; i < m; i++) {
            const double l = A[i * m + j] * inverse;
            A[i * m + j] = l;
            for (size_t k = j + 1; k < m; k++) A[i * m + k] -= l * A[j * m + k];
        }
    }
    return dal_lu_is_regular(m, A, row, sizes, sizes + m, sizes + 2 * m) ? sign : 0;
}

#endif /* DALEMBERT_LU_H */
