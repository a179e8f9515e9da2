/* LU factors of a band matrix, as those of lu.h: the same pivots, sizes and what is singular.  Row
 * i, with columns i - width to i + 2 width, is stored one after the other; rows that change places
 * widen the upper triangle, while those of L stay where they were. */
#include "algebra/algebra.h"
#include "dalembert/lu.h"

#include <math.h>

/* A band matrix of this width. */
typedef struct band {
    size_t size, width, length;
    double *A;
} band;

static double *entry(const band *self, size_t i, size_t j)
{
    return self->A + i * self->length + self->width + j - i;
}

/* Behind the last row, or column, that is not 0 in column, or row, k. */
static size_t below(const band *self, size_t k)
{
    return k + self->width < self->size ? k + self->width + 1 : self->size;
}

static size_t beyond(const band *self, size_t k)
{
    return k + 2 * self->width < self->size ? k + 2 * self->width + 1 : self->size;
}

static void swap(double *a, double *b)
{
    const double c = *a;
    *a = *b;
    *b = c;
}

static band band_of(const dal_lu_factors *self)
{
    return (band){self->m, self->width, dal__band_length(self->width), (double *)self->A};
}

void dal__band_solve(const dal_lu_factors *self, const double *b, double *x)
{
    const band of = band_of(self);
    for (size_t i = 0; i < of.size; i++) x[i] = b[i];
    for (size_t k = 0; k < of.size; k++) {
        swap(x + k, x + self->row[k]);
        for (size_t i = k + 1; i < below(&of, k); i++) x[i] -= *entry(&of, i, k) * x[k];
    }
    for (size_t i = of.size; i-- > 0;) {
        double sum = x[i];
        for (size_t k = i + 1; k < beyond(&of, i); k++) sum -= *entry(&of, i, k) * x[k];
        x[i] = sum * *entry(&of, i, i);
    }
}

void dal__band_solve_transposed(const dal_lu_factors *self, double *b, double *x)
{
    const band of = band_of(self);
    for (size_t i = 0; i < of.size; i++) {
        b[i] *= *entry(&of, i, i);
        for (size_t k = i + 1; k < beyond(&of, i); k++) b[k] -= *entry(&of, i, k) * b[i];
    }
    for (size_t k = of.size; k-- > 0;) {
        for (size_t i = k + 1; i < below(&of, k); i++) b[k] -= *entry(&of, i, k) * b[i];
        swap(b + k, b + self->row[k]);
    }
    for (size_t i = 0; i < of.size; i++) x[i] = b[i];
}

/* As dal_lu_is_regular; x[3*size] is scratch, row_size that of the rows of A. */
static int is_regular(const band *of, const dal_lu_factors *factors, const double *row_size,
                      const double *column_size, double *x)
{
    const size_t m = of->size;
    double *const size = x + m, bound = 0.0, largest = 1.0;
    for (size_t i = 0; i < m; i++) x[i] = size[i] = row_size[i];
    for (size_t k = 0; k < m; k++) {
        swap(x + k, x + factors->row[k]);
        swap(size + k, size + factors->row[k]);
        for (size_t i = k + 1; i < below(of, k); i++) x[i] += fabs(*entry(of, i, k)) * x[k];
    }
    for (size_t i = m; i-- > 0;) {
        const double inverse = fabs(*entry(of, i, i));
        double sum = x[i];
        largest = fmax(largest, 1.0 / (inverse * size[i] * column_size[i]));
        for (size_t k = i + 1; k < beyond(of, i); k++) {
            const double above = fabs(*entry(of, i, k));
            sum += above * x[k];
            largest = fmax(largest, above / (size[i] * column_size[k]));
        }
        x[i] = sum * inverse;
        if (isnan(x[i])) return 0; /* no row above need know */
        bound = fmax(bound, x[i] * column_size[i]);
    }
    /* a column of A has no more entries than this: m itself would refuse long chains */
    const double entries = fmin((double)m, 2.0 * (double)of->width + 1.0);
    const double most = DAL_LU_CONDITION / (entries * largest);
    return bound <= most || dal_lu_inverse_norm(factors, row_size, column_size, x) <= most;
}

int dal__band_factor(size_t m, size_t width, double *A, double *sizes, size_t *row)
{
    const band of = {m, width, dal__band_length(width), A};
    double *const scratch = sizes + 2 * m;
    int sign = 1;
    for (size_t i = 0; i < m; i++) scratch[i] = sizes[i];
    for (size_t j = 0; j < m; j++) {
        size_t best = j;
        for (size_t i = j + 1; i < below(&of, j); i++)
            if (fabs(*entry(&of, i, j)) * scratch[best]
                > fabs(*entry(&of, best, j)) * scratch[i])
                best = i;
        row[j] = best;
        if (best != j) {
            for (size_t k = j; k < beyond(&of, j); k++) swap(entry(&of, j, k), entry(&of, best, k));
            swap(scratch + j, scratch + best);
            sign = -sign;
        }
        double *const pivot = entry(&of, j, j);
        if (*pivot < 0.0) sign = -sign;
        *pivot = 1.0 / *pivot;
        for (size_t i = j + 1; i < below(&of, j); i++) {
            const double l = *entry(&of, i, j) * *pivot;
            *entry(&of, i, j) = l;
            for (size_t k = j + 1; k < beyond(&of, j); k++)
                *entry(&of, i, k) -= l * *entry(&of, j, k);
        }
    }
    const dal_lu_factors factors = {dal__band_solve, dal__band_solve_transposed, m, A, row, width};
    return is_regular(&of, &factors, sizes, sizes + m, scratch) ? sign : 0;
}
