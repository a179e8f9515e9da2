/* Linear equations, by the dense elimination of lu.h, or by blocks and their bands. */
#include "algebra/algebra.h"

#include <math.h>

void dal__linear_reserve_pattern(dal__linear *self, size_t size, const dal__pattern *pattern,
                                 arena *a)
{
    self->size = size;
    self->pattern = pattern;
    DAL__RESERVE(a, pattern ? pattern->stored : dal__times(size, size), &self->A);
    DAL__RESERVE(a, dal__times(5, size), &self->sizes);
    if (pattern) DAL__RESERVE(a, dal__times(5, size), &self->work);
    dal__reserve(a, &self->row, size, sizeof(size_t));
}

void dal__linear_reserve(dal__linear *self, size_t size, arena *a)
{
    dal__linear_reserve_pattern(self, size, NULL, a);
}

void dal__linear_multiply(dal__linear *self, const dal_rows *rows, size_t n, const double *X,
                          const double *Y)
{
    const size_t m = self->size;
    const dal__pattern *const pattern = self->pattern;
    if (!pattern) {
        for (size_t a = 0; a < m; a++)
            for (size_t b = 0; b < m; b++)
                self->A[a * m + b] = dal__dot(n, X + a * n, Y + b * n);
        return;
    }
    for (size_t k = 0; k < pattern->stored; k++) self->A[k] = 0.0;
    for (size_t a = 0; a < m; a++)
        for (size_t k = pattern->first[a]; k < pattern->first[a + 1]; k++)
            self->A[pattern->place[k]] = dal_rows_product(rows, X, a, Y, pattern->column[k]);
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

/* The sizes of a block, in front of its scratch. */
static double *sizes_of(const dal__linear *self, const dal__block *block)
{
    const size_t *const order = self->pattern->order + block->begin;
    for (size_t k = 0; k < block->size; k++) {
        self->work[k] = self->sizes[order[k]];
        self->work[block->size + k] = self->sizes[self->size + order[k]];
    }
    return self->work;
}

static int factor_block(dal__linear *self, const dal__block *block)
{
    const size_t m = block->size;
    double *const A = self->A + block->offset, *const sizes = sizes_of(self, block);
    size_t *const row = self->row + block->begin;
    return block->width == m ? dal_lu_factor(m, A, sizes, row)
                             : dal__band_factor(m, block->width, A, sizes, row);
}

int dal__linear_factor(dal__linear *self)
{
    const dal__pattern *const pattern = self->pattern;
    if (!pattern) return dal_lu_factor(self->size, self->A, self->sizes, self->row);
    int sign = 1;
    for (size_t k = 0; sign && k < pattern->blocks; k++)
        sign *= factor_block(self, pattern->block + k);
    return sign;
}

double dal__linear_log_inverse(const dal__linear *self)
{
    const dal__block whole = {.size = self->size, .width = self->size};
    const size_t blocks = self->pattern ? self->pattern->blocks : 1;
    double product = 1.0, exponent = 0.0; /* which alone would overflow */
    for (size_t k = 0; k < blocks; k++) {
        const dal__block *const block = self->pattern ? self->pattern->block + k : &whole;
        const bool dense = block->width == block->size;
        const size_t length = dense ? block->size : dal__band_length(block->width);
        const double *const A = self->A + block->offset + (dense ? 0 : block->width);
        for (size_t i = 0; i < block->size; i++) {
            int power = 0;
            product = frexp(product * A[i * length + (dense ? i : 0)], &power);
            exponent += power;
        }
    }
    return exponent + log2(fabs(product));
}

/* What solves with the factors of a block. */
static dal_lu_factors factors_of(const dal__linear *self, const dal__block *block)
{
    const bool dense = block->width == block->size;
    return (dal_lu_factors){.solve = dense ? dal_lu_solve_by : dal__band_solve,
                            .solve_transposed = dense ? dal_lu_solve_transposed_by
                                                      : dal__band_solve_transposed,
                            .m = block->size, .width = block->width,
                            .A = self->A + block->offset, .row = self->row + block->begin};
}

double dal__linear_inverse_norm(const dal__linear *self)
{
    double most = 0.0;
    for (size_t k = 0; k < self->pattern->blocks; k++) {
        const dal__block *const block = self->pattern->block + k;
        const dal_lu_factors factors = factors_of(self, block);
        double *const sizes = sizes_of(self, block), *const columns = sizes + block->size;
        most = fmax(most, dal_lu_inverse_norm(&factors, sizes, columns, columns + block->size));
    }
    return most;
}

/* x <- what each block makes of its part of b. */
static void solve_blocks(const dal__linear *self, const double *b, double *x, bool transposed)
{
    const dal__pattern *const pattern = self->pattern;
    double *const given = self->work, *const found = given + self->size;
    for (size_t k = 0; k < pattern->blocks; k++) {
        const dal__block *const block = pattern->block + k;
        const size_t *const order = pattern->order + block->begin;
        const dal_lu_factors factors = factors_of(self, block);
        for (size_t i = 0; i < block->size; i++) given[i] = b[order[i]];
        if (transposed) factors.solve_transposed(&factors, given, found);
        else factors.solve(&factors, given, found);
        for (size_t i = 0; i < block->size; i++) x[order[i]] = found[i];
    }
}

void dal__linear_solve(const dal__linear *self, const double *b, double *x)
{
    if (self->pattern) solve_blocks(self, b, x, false);
    else dal_lu_solve(self->size, self->A, self->row, b, x);
}

void dal__linear_solve_transposed(const dal__linear *self, double *b, double *x)
{
    if (self->pattern) solve_blocks(self, b, x, true);
    else dal_lu_solve_transposed(self->size, self->A, self->row, b, x);
}
