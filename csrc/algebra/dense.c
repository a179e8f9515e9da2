/* Small dense linear algebra. */
#include "algebra/algebra.h"
#include "dalembert/lu.h"

#include <math.h>

double dal__dot(size_t n, const double *a, const double *b)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

double dal__largest(size_t n, const double *x)
{
    double most = 0.0;
    for (size_t i = 0; i < n; i++) most = fmax(most, fabs(x[i]));
    return most;
}

double dal__largest_difference(size_t n, const double *x, const double *y)
{
    double most = 0.0;
    for (size_t i = 0; i < n; i++) {
        const double difference = fabs(x[i] - y[i]);
        if (!(difference <= most) && !isnan(most)) most = difference; /* a NaN stays */
    }
    return most;
}

double dal__sum_of_sizes(size_t n, const double *x)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++) sum += fabs(x[i]);
    return sum;
}

void dal__symmetrise(size_t n, double *A)
{
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < i; j++) {
            const double mean = 0.5 * (A[i * n + j] + A[j * n + i]);
            A[i * n + j] = A[j * n + i] = mean;
        }
}

void dal__apply(size_t rows, size_t columns, const double *A, const double *x, double *y)
{
    for (size_t i = 0; i < rows; i++) {
        double sum = 0.0;
        for (size_t j = 0; j < columns; j++) sum += A[i * columns + j] * x[j];
        y[i] = sum;
    }
}

/* inverse[n] <- the diagonal of A^-1 = L^-T L^-1: entry j is the square of column j of L^-1, which
 * stands in the entries that are not yet known. */
static void invert_diagonal(size_t n, const double *L, double *inverse)
{
    for (size_t j = 0; j < n; j++) {
        double square = 0.0;
        for (size_t i = j; i < n; i++) {
            double sum = i == j ? 1.0 : 0.0;
            for (size_t k = j; k < i; k++) sum -= L[i * n + k] * inverse[k];
            inverse[i] = sum / L[i * n + i];
            square += inverse[i] * inverse[i];
        }
        inverse[j] = square;
    }
}

bool dal__cholesky(size_t n, double *A, double *inverse, size_t *row, double *pivot)
{
    double trace = 0.0, most = 0.0; /* of the inverse of A scaled to a unit diagonal */
    for (size_t j = 0; j < n; j++) {
        double d = A[j * n + j];
        for (size_t k = 0; k < j; k++) d -= A[j * n + k] * A[j * n + k];
        if (row) *row = j;
        if (pivot) *pivot = d;
        if (!(d > 0.0)) return false;
        const double root = sqrt(d);
        A[j * n + j] = root;
        for (size_t i = j + 1; i < n; i++) {
            double sum = A[i * n + j];
            for (size_t k = 0; k < j; k++) sum -= A[i * n + k] * A[j * n + k];
            A[i * n + j] = sum / root;
            A[j * n + i] = 0.0;
        }
    }
    invert_diagonal(n, A, inverse);
    for (size_t j = 0; j < n; j++) {
        const double entry = inverse[j] * dal__dot(j + 1, A + j * n, A + j * n);
        trace += entry;
        if (entry < most) continue;
        most = entry; /* the pivot of j if it came last would be the smallest */
        if (row) *row = j;
        if (pivot) *pivot = 1.0 / inverse[j];
    }
    return (double)n * trace <= DAL_LU_CONDITION;
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

/* Row and column j of G[m*m] trade places with row and column k. */
static void exchange(size_t m, double *G, size_t *order, size_t j, size_t k)
{
    const size_t row = order[j];
    for (size_t i = 0; i < m; i++) {
        const double entry = G[j * m + i];
        G[j * m + i] = G[k * m + i];
        G[k * m + i] = entry;
    }
    for (size_t i = 0; i < m; i++) {
        const double entry = G[i * m + j];
        G[i * m + j] = G[i * m + k];
        G[i * m + k] = entry;
    }
    order[j] = order[k];
    order[k] = row;
}

/* L D L^T with pivots on the diagonal; the coefficients c of a row of L solve c L = that row. */
size_t dal__independent_rows(size_t m, double *G, double least, size_t *order)
{
    const double alike = 0.1;
    size_t rank = 0;
    for (size_t k = 0; k < m; k++) order[k] = k;
    if (!dal__all_finite(m * m, G)) order[0] = m;
    for (; rank < m && order[0] < m; rank++) {
        double most = 0.0;
        size_t best = m;
        for (size_t k = rank; k < m; k++) most = fmax(most, G[k * m + k]);
        if (!(most > least)) break;
        for (size_t k = rank; k < m; k++)
            if (G[k * m + k] > alike * most && (best == m || order[k] < order[best])) best = k;
        exchange(m, G, order, rank, best);
        for (size_t i = rank + 1; i < m; i++) {
            const double l = G[i * m + rank] / G[rank * m + rank];
            for (size_t j = rank + 1; j < m; j++) G[i * m + j] -= l * G[rank * m + j];
            G[i * m + rank] = l;
        }
    }
    for (size_t k = rank; k < m; k++)
        for (size_t j = rank; j-- > 0;)
            for (size_t i = j + 1; i < rank; i++) G[k * m + j] -= G[i * m + j] * G[k * m + i];
    return rank;
}

/* Not by GSL's decompositions, because these report through its handler what does not converge. */
double dal__singular_values(size_t count, size_t n, double *A, double *squares)
{
    enum { SWEEPS = 60 };
    const double unit = dal__largest(count * n, A), tolerance = (double)n * DAL_ROUNDOFF;
    for (size_t k = 0; k < count * n && unit > 0.0; k++) A[k] /= unit;
    for (size_t i = 0; i < count; i++) squares[i] = dal__dot(n, A + i * n, A + i * n);
    bool orthogonal = false;
    for (int sweep = 0; sweep < SWEEPS && !orthogonal; sweep++) {
        orthogonal = true;
        for (size_t i = 0; i < count; i++)
            for (size_t j = i + 1; j < count; j++) {
                double *const a = A + i * n, *const b = A + j * n;
                const double p = dal__dot(n, a, b);
                if (fabs(p) <= tolerance * sqrt(squares[i]) * sqrt(squares[j])) continue;
                const double zeta = (squares[j] - squares[i]) / (2.0 * p);
                const double t = copysign(1.0, zeta) / (fabs(zeta) + hypot(1.0, zeta));
                const double c = 1.0 / hypot(1.0, t), s = c * t;
                for (size_t k = 0; k < n; k++) {
                    const double old = a[k];
                    a[k] = c * old - s * b[k];
                    b[k] = s * old + c * b[k];
                }
                squares[i] = dal__dot(n, a, a);
                squares[j] = dal__dot(n, b, b);
                orthogonal = false;
            }
    }
    return unit;
}
