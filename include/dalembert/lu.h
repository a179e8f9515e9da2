/* lu.h - LU factors of a dense matrix, and whether it is singular.
 *
 * With A go the sizes of its rows and columns, r_i and c_j: of the terms that were added up to A_ij
 * none is much larger than r_i c_j.  Then A_ij / (r_i c_j) is the scaled matrix.  It does not
 * change when rows, columns or coordinates are rescaled together with their sizes, and where the
 * terms cancel it is small.  Pivots are the largest of the scaled column, so |L| <= 1 and elements
 * grow little.  Singular means that the scaled matrix, or 1 if it is smaller, times the estimated
 * size of its inverse is above DAL_LU_CONDITION.  Nothing is in fact scaled: that would not change
 * a digit.  Header only: generated code has no library to link. */
#ifndef DALEMBERT_LU_H
#define DALEMBERT_LU_H

#include <math.h>
#include <stddef.h>

/* Where m is a constant these have to be seen by the optimiser. */
#if defined(__GNUC__)
#define DAL_LU_INLINE static inline __attribute__((always_inline))
#define DAL_LU_RARE static __attribute__((noinline, unused))
#define DAL_LU_MOSTLY(condition) __builtin_expect(!!(condition), 1)
#else
#define DAL_LU_INLINE static inline
#define DAL_LU_RARE static inline
#define DAL_LU_MOSTLY(condition) (condition)
#endif

/* Whether the compiler knows m, and it is small: then an index that is not known is asked for, so
 * that every element has a place of its own, a register. */
#if defined(__GNUC__)
#define DAL_LU_SMALL(m) (__builtin_constant_p(m) && (m) <= 4)
#else
#define DAL_LU_SMALL(m) 0
#endif

#if defined(__GNUC__)
#define DAL_LU_UNROLL _Pragma("GCC unroll 4")
#else
#define DAL_LU_UNROLL
#endif

/* From here on the solution would have no digits: 1e15 u is 0.1. */
#define DAL_LU_CONDITION 1e15

/* Where m <= 4 and no scaled pivot is below 1/DAL_LU_EASY, the matrix is regular: |L| <= 1, and no
 * entry of the scaled A is above 1, so that none of U is above 2^(m-1) = 8, and no entry of the
 * inverse above 2^8 (1 + 2^8 2^3)^3 2^3 < 2^45, which times m = 4 and 8 is below 2^50. */
#define DAL_LU_EASY 0x1p8

/* b[row], for row < m. */
DAL_LU_INLINE double dal_lu_pick(size_t m, const double *b, size_t row)
{
    if (!DAL_LU_SMALL(m)) return b[row];
    double found = b[0];
    DAL_LU_UNROLL
    for (size_t i = 1; i < m; i++) found = row == i ? b[i] : found;
    return found;
}

/* x[m] <- A^-1 b[m] from the factors; x and b may not overlap. */
DAL_LU_INLINE void dal_lu_solve(size_t m, const double *A, const size_t *row, const double *b,
                                double *x)
{
    if (m == 1) { /* without the detour through row[], which the optimiser does not see through */
        x[0] = b[0] * A[0];
        return;
    }
    DAL_LU_UNROLL
    for (size_t i = 0; i < m; i++) {
        double sum = dal_lu_pick(m, b, row[i]);
        DAL_LU_UNROLL
        for (size_t k = 0; k < i; k++) sum -= A[i * m + k] * x[k];
        x[i] = sum;
    }
    DAL_LU_UNROLL
    for (size_t i = m; i-- > 0;) {
        double sum = x[i];
        DAL_LU_UNROLL
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

/* The 1-norm of the inverse of the scaled matrix, or a little less: that of the best column found
 * by going uphill from all columns at once (W. W. Hager, SIAM J. Sci. Stat. Comput. 5, 1984).
 * scratch[3*m]. */
DAL_LU_RARE double dal_lu_inverse_norm(size_t m, const double *A, const size_t *row,
                                       const double *row_size, const double *column_size,
                                       double *scratch)
{
    enum { MOST = 5 };
    double *const x = scratch, *const y = x + m, *const z = y + m, norm = 0.0;
    size_t column = m; /* none: all at once */
    for (int climb = 0; climb < MOST; climb++) {
        for (size_t i = 0; i < m; i++)
            x[i] = row_size[i] * (column == m ? 1.0 / (double)m : column == i ? 1.0 : 0.0);
        dal_lu_solve(m, A, row, x, y);
        double sum = 0.0, most = 0.0, here = 0.0;
        for (size_t i = 0; i < m; i++) {
            sum += fabs(y[i] * column_size[i]);
            y[i] = copysign(column_size[i], y[i]);
        }
        if (!(sum > norm)) return sum <= norm ? norm : sum; /* NaN is passed on */
        norm = sum;
        dal_lu_solve_transposed(m, A, row, y, z);
        size_t best = 0;
        for (size_t i = 0; i < m; i++) {
            const double slope = z[i] * row_size[i];
            here += slope * (column == m ? 1.0 / (double)m : column == i ? 1.0 : 0.0);
            if (fabs(slope) > most) most = fabs(slope), best = i;
        }
        if (most <= here) return norm;
        column = best;
    }
    return norm;
}

/* Whether the scaled matrix is regular.  A bound costs O(m^2): the solution x of M(L) M(U) x = 1,
 * where M has the sizes of the entries, those off the diagonal with a minus, is not smaller than
 * any row sum of the inverse.  For large m it is often far too large; then the inverse is
 * estimated. */
DAL_LU_RARE int dal_lu_is_regular(size_t m, const double *A, const size_t *row,
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
    return bound <= most
        || dal_lu_inverse_norm(m, A, row, row_size, column_size, scratch) <= most;
}

/* The same of a small matrix: of copies, so that the arrays themselves need no place in memory. */
DAL_LU_INLINE int dal_lu_is_regular_apart(size_t m, const double *A, const size_t *row,
                                          const double *sizes)
{
    double factors[16], all[20];
    size_t rows[4];
    DAL_LU_UNROLL
    for (size_t i = 0; i < 2 * m; i++) all[i] = sizes[i];
    DAL_LU_UNROLL
    for (size_t i = 0; i < m; i++) rows[i] = row[i];
    DAL_LU_UNROLL
    for (size_t i = 0; i < m * m; i++) factors[i] = A[i];
    return dal_lu_is_regular(m, factors, rows, all, all + m, all + 2 * m);
}

/* Swaps rows j and best > j. */
DAL_LU_INLINE void dal_lu_swap(size_t m, double *A, size_t *row, size_t j, size_t best)
{
    DAL_LU_UNROLL
    for (size_t i = DAL_LU_SMALL(m) ? j + 1 : best; i < m && i <= best; i++) {
        if (i != best) continue;
        DAL_LU_UNROLL
        for (size_t k = 0; k < m; k++) {
            const double a = A[j * m + k];
            A[j * m + k] = A[i * m + k];
            A[i * m + k] = a;
        }
        const size_t swap = row[j];
        row[j] = row[i];
        row[i] = swap;
    }
}

/* A[m*m] becomes its factors, rows permuted as in row[m], the diagonal of U inverted.  sizes[5*m]:
 * those of the rows, then of the columns; the rest is scratch.  Returns the sign of det A; or 0 if
 * A is singular or NaN.  With an Inf in A the residual of what dal_lu_solve returns is not finite
 * or not small. */
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
    int sign = 1, easy = m <= 4;
    DAL_LU_UNROLL
    for (size_t i = 0; i < m; i++) row[i] = i;
    DAL_LU_UNROLL
    for (size_t j = 0; j < m; j++) {
        size_t best = j;
        double most = fabs(A[j * m + j]), size = dal_lu_pick(m, sizes, row[j]);
        DAL_LU_UNROLL
        for (size_t i = j + 1; i < m; i++) {
            const double entry = fabs(A[i * m + j]), other = dal_lu_pick(m, sizes, row[i]);
            if (entry * size > most * other) best = i, most = entry, size = other;
        }
        if (best != j) {
            dal_lu_swap(m, A, row, j, best);
            sign = -sign;
        }
        if (!(most * DAL_LU_EASY - size * sizes[m + j] >= 0.0)) easy = 0; /* also Inf */
        if (A[j * m + j] < 0.0) sign = -sign;
        const double inverse = 1.0 / A[j * m + j];
        A[j * m + j] = inverse;
        DAL_LU_UNROLL
        for (size_t i = j + 1; i < m; i++) {
            const double l = A[i * m + j] * inverse;
            A[i * m + j] = l;
            DAL_LU_UNROLL
            for (size_t k = j + 1; k < m; k++) A[i * m + k] -= l * A[j * m + k];
        }
    }
    if (DAL_LU_MOSTLY(easy)) return sign;
    const int regular = DAL_LU_SMALL(m)
                          ? dal_lu_is_regular_apart(m, A, row, sizes)
                          : dal_lu_is_regular(m, A, row, sizes, sizes + m, sizes + 2 * m);
    return regular ? sign : 0;
}

#endif /* DALEMBERT_LU_H */
