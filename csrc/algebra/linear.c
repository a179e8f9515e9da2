/* Linear equations, by the dense elimination of lu.h. */
#include "algebra/algebra.h"
#include "dalembert/lu.h"

#include <math.h>

void dal__linear_reserve(dal__linear *self, size_t size, arena *a)
{
    self->size = size;
    DAL__RESERVE(a, dal__times(size, size), &self->A);
    DAL__RESERVE(a, dal__times(5, size), &self->sizes);
    dal__reserve(a, &self->row, size, sizeof(size_t));
}

/* size[count] of the rows (or columns), with other[count] that of the other side: such that the
 * geometric mean of their scaled entries, of those above least, is 1. */
static void balance(size_t count, const double *scale, bool rows, double least, double *size,
                    const double *other)
{
    for (size_t k = 0; k < count; k++) {
        double sum = 0.0;
        size_t entries = 0;
        for (size_t l = 0; l < count; l++) {
            const double entry = rows ? scale[k * count + l] : scale[l * count + k];
            if (!(entry > least * size[k] * other[l])) continue;
            sum += log2(entry) - log2(other[l]);
            entries++;
        }
        if (entries > 0) size[k] = exp2(sum / (double)entries);
    }
}

/* In turns, as A. R. Curtis and J. K. Reid do it (J. Inst. Maths Applics 10, 1972): it follows when
 * rows and columns are rescaled, where largest entries would depend on who comes first.  Entries
 * that are found to be small may be roundoff, which has no size, and are then left out. */
void dal__linear_balance(dal__linear *self, const double *scale)
{
    enum { ALL = 12, SWEEPS = 20 };
    const double small = 1e-4;
    const size_t count = self->size;
    double *const rows = self->sizes, *const columns = rows + count;
    for (size_t k = 0; k < 2 * count; k++) rows[k] = 1.0;
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        balance(count, scale, true, sweep < ALL ? 0.0 : small, rows, columns);
        balance(count, scale, false, sweep < ALL ? 0.0 : small, columns, rows);
    }
    for (size_t i = 0; i < count; i++) {
        rows[i] = 0.0;
        for (size_t k = 0; k < count; k++)
            rows[i] = fmax(rows[i], scale[i * count + k] / columns[k]);
    }
}

int dal__linear_factor(dal__linear *self)
{
    return dal_lu_factor(self->size, self->A, self->sizes, self->row);
}

void dal__linear_solve(const dal__linear *self, const double *b, double *x)
{
    dal_lu_solve(self->size, self->A, self->row, b, x);
}

void dal__linear_solve_transposed(const dal__linear *self, double *b, double *x)
{
    dal_lu_solve_transposed(self->size, self->A, self->row, b, x);
}
