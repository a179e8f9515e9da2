/* Floor 1: small dense linear algebra. */
#include "internal.h"

#include <math.h>

void dal__apply(size_t rows, size_t columns, const double *A, const double *x, double *y)
{
    for (size_t i = 0; i < rows; i++) {
        double sum = 0.0;
        for (size_t j = 0; j < columns; j++) sum += A[i * columns + j] * x[j];
        y[i] = sum;
    }
}

bool dal__cholesky(size_t n, double *A, size_t *row, double *pivot)
{
    for (size_t j = 0; j < n; j++) {
        const double diagonal = A[j * n + j];
        double d = diagonal;
        for (size_t k = 0; k < j; k++) d -= A[j * n + k] * A[j * n + k];
        if (!(d > 8.0 * (double)n * DAL_ROUNDOFF * diagonal)) {
            if (row) *row = j;
            if (pivot) *pivot = d;
            return false;
        }
        const double root = sqrt(d);
        A[j * n + j] = root;
        for (size_t i = j + 1; i < n; i++) {
            double sum = A[i * n + j];
            for (size_t k = 0; k < j; k++) sum -= A[i * n + k] * A[j * n + k];
            A[i * n + j] = sum / root;
            A[j * n + i] = 0.0;
        }
    }
    return true;
}

void dal__cholesky_solve(size_t n, const double *factor, double *x)
{
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < i; k++) x[i] -= factor[i * n + k] * x[k];
        x[i] /= factor[i * n + i];
    }
    for (size_t i = n; i-- > 0;) {
        for (size_t k = i + 1; k < n; k++) x[i] -= factor[k * n + i] * x[k];
        x[i] /= factor[i * n + i];
    }
}
