/* rows.h - sparse matrices such as mu and N = d(mu v)/dq, for systems with many coordinates and
 * constraints in few of them.  Sums run over columns, or rows, in ascending order, as for dense
 * matrices, so omitting zeros changes no bit.  Header only: generated code has no library to link.
 */
#ifndef DALEMBERT_ROWS_H
#define DALEMBERT_ROWS_H

#include <math.h>
#include <stddef.h>

/* The stored entries of a matrix [m*n], by rows. */
typedef struct dal_rows {
    size_t m, n;
    const size_t *first;  /* [m+1] row a has the entries first[a] to first[a+1], */
    const size_t *column; /* [entries] in these columns */
    const size_t *above;  /* [n+1] column i has those from above[i] to above[i+1] of */
    const size_t *entry;  /* [entries] these entries, */
    const size_t *row;    /* [entries] in these rows */
    size_t terms;         /* the largest number of entries of a row or column, plus 1; replaces n in
                             the bound of the residual, see docs/residual.md */
} dal_rows;

static inline size_t dal_rows_entries(const dal_rows *rows) { return rows->first[rows->m]; }

/* Row a of A times x[n]. */
static inline double dal_rows_dot(const dal_rows *rows, const double *A, size_t a, const double *x)
{
    double sum = -0.0;
    for (size_t e = rows->first[a]; e < rows->first[a + 1]; e++) sum += A[e] * x[rows->column[e]];
    return sum;
}

/* sum_i |A_ai x_i|. */
static inline double dal_rows_extent(const dal_rows *rows, const double *A, size_t a,
                                     const double *x)
{
    double sum = -0.0;
    for (size_t e = rows->first[a]; e < rows->first[a + 1]; e++)
        sum += fabs(A[e] * x[rows->column[e]]);
    return sum;
}

/* Row a of A times row b of B. */
static inline double dal_rows_product(const dal_rows *rows, const double *A, size_t a,
                                      const double *B, size_t b)
{
    double sum = -0.0;
    for (size_t e = rows->first[a], f = rows->first[b];
         e < rows->first[a + 1] && f < rows->first[b + 1];) {
        const size_t i = rows->column[e], j = rows->column[f];
        if (i == j) sum += A[e] * B[f];
        e += i <= j;
        f += j <= i;
    }
    return sum;
}

/* Component i of A^T c. */
static inline double dal_rows_column(const dal_rows *rows, const double *A, size_t i,
                                     const double *c)
{
    double sum = -0.0;
    for (size_t k = rows->above[i]; k < rows->above[i + 1]; k++)
        sum += A[rows->entry[k]] * c[rows->row[k]];
    return sum;
}

#endif /* DALEMBERT_ROWS_H */
