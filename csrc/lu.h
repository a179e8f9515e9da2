/* lu.h - LU factors of a dense matrix whose entries are sums that may cancel.
 *
 * Along with A goes scale, which holds for each entry the sum of the absolute values of the terms
 * that were added up to it.  Pivots are chosen relative to their scale, and a pivot that is not
 * larger than the rounding error of its own sum counts as zero.  So the test for singularity does
 * not change when rows, columns or coordinates are rescaled, and an exact 0 = 1 - 1 and a 1e-17
 * that ought to be 0 are found alike.  The elimination adds its terms to the scale; but of the
 * errors that these terms bring along only the largest counts: their sum would double at each
 * pivot, and every large matrix would be singular.  Header only: generated code has no library to
 * link. */
#ifndef DALEMBERT_LU_H
#define DALEMBERT_LU_H

#include <float.h>
#include <math.h>
#include <stddef.h>

/* Where m is a constant these have to be seen by the optimiser. */
#if defined(__GNUC__)
#define DAL_LU_INLINE static inline __attribute__((always_inline))
#else
#define DAL_LU_INLINE static inline
#endif

/* A[m*m] becomes its factors, rows permuted as in row[m], the diagonal of U inverted.  terms: the
 * number of terms of each entry.  Returns 1; or 0 if A is singular or NaN, and
 * then row[0] is the pivot.  With an Inf in A what dal_lu_solve returns is not finite. */
DAL_LU_INLINE int dal_lu_factor(size_t m, size_t terms, double *A, double *scale, size_t *row)
{
    const double tolerance = 4.0 * (double)terms * DBL_EPSILON;
    for (size_t i = 0; i < m; i++) row[i] = i;
    for (size_t j = 0; j < m; j++) {
        size_t best = j;
        for (size_t i = j + 1; i < m; i++)
            if (fabs(A[i * m + j]) * scale[best * m + j] > fabs(A[best * m + j]) * scale[i * m + j]
                || A[best * m + j] == 0.0)
                best = i;
        if (best != j) {
            for (size_t k = 0; k < m; k++) {
                const double a = A[j * m + k], s = scale[j * m + k];
                A[j * m + k] = A[best * m + k];
                A[best * m + k] = a;
                scale[j * m + k] = scale[best * m + k];
                scale[best * m + k] = s;
            }
            const size_t swap = row[j];
            row[j] = row[best];
            row[best] = swap;
        }
        if (!(fabs(A[j * m + j]) > tolerance * scale[j * m + j])) {
            row[0] = j;
            return 0;
        }
        const double inverse = 1.0 / A[j * m + j];
        A[j * m + j] = inverse;
        for (size_t i = j + 1; i < m; i++) {
            const double l = A[i * m + j] * inverse;
            A[i * m + j] = l;
            for (size_t k = j + 1; k < m; k++) {
                const double term = l * A[j * m + k], before = fabs(l) * scale[j * m + k];
                A[i * m + k] -= term;
                if (before > scale[i * m + k]) scale[i * m + k] = before;
                scale[i * m + k] += fabs(term);
            }
        }
    }
    return 1;
}

/* x[m] <- A^-1 b[m] from the factors; x and b may not overlap. */
DAL_LU_INLINE void dal_lu_solve(size_t m, const double *A, const size_t *row, const double *b,
                                double *x)
{
    if (m == 1) { /* without the detour through row[], which the optimiser does not see through */
        x[0] = b[0] * A[0];
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

#endif /* DALEMBERT_LU_H */
