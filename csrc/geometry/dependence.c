/* Which constraints depend on others, for every message about the rank of mu. */
#include "geometry/geometry.h"

#include <stdio.h>

/* Rows that may be examined without a matrix of m rows, where C is stored by blocks. */
enum { MOST_OF_BLOCK = 32 };

/* Some rows of mu, and where their scaled Gram matrix is worked out. */
typedef struct rows {
    size_t count;
    const size_t *which; /* [count], ascending; NULL: all */
    double *G, *size;    /* [count*count]; [count] lengths, that of mu^a is sqrt(mu^a M^-1 mu^a) */
    size_t *order;       /* [count] */
} rows;

static size_t row_of(const rows *self, size_t k)
{
    return self->which ? self->which[k] : k;
}

/* Whether the lengths are of use: a row is 0, or its length does not underflow. */
static bool build_G(const dal_mechanics *mech, const double *mu, const double *Z, const rows *self)
{
    const dal_rows *const stored = mech->eval.rows;
    const size_t n = mech->n, count = self->count;
    for (size_t k = 0; k < count; k++)
        for (size_t l = 0; l < count; l++) {
            const size_t a = row_of(self, k), b = row_of(self, l);
            self->G[k * count + l] = stored ? dal_rows_product(stored, mu, a, Z, b)
                                            : dal__dot(n, mu + a * n, Z + b * n);
        }
    for (size_t k = 0; k < count; k++) {
        const double square = self->G[k * count + k];
        self->size[k] = sqrt(square);
        if (square == 0.0 && dal__row_extent(mech, Z, row_of(self, k), mech->metric.per_unit) > 0.0)
            return false;
    }
    for (size_t k = 0; k < count; k++)
        for (size_t l = 0; l < count; l++) {
            const double lengths = self->size[k] * self->size[l];
            self->G[k * count + l] = lengths > 0.0 ? self->G[k * count + l] / lengths : 0.0;
        }
    return true;
}

/* How far row order[k], of length 1, is from the sum that G says it is. */
static double distance(dal_mechanics *mech, const double *Z, const rows *self, size_t rank,
                       size_t k)
{
    double *const w = mech->w, most = 0.0;
    dal__clear(mech->n, w);
    dal__row_add(mech, 1.0 / self->size[self->order[k]], Z, row_of(self, self->order[k]), w);
    for (size_t j = 0; j < rank; j++)
        dal__row_add(mech, -self->G[k * self->count + j] / self->size[self->order[j]], Z,
                     row_of(self, self->order[j]), w);
    for (size_t i = 0; i < mech->n; i++) most = fmax(most, fabs(w[i]) * mech->metric.per_unit[i]);
    return most;
}

/* " = 2 constraints[0]", or what follows it, with the digits that an error leaves. */
static void add_term(dal_error *error, double factor, double relative, size_t row, bool first)
{
    enum { DIGITS = 6 };
    const double known = floor(-log10(relative));
    char number[32];
    snprintf(number, sizeof number, "%.*g", known > 1.0 ? (int)fmin(known, DIGITS) : 1,
             fabs(factor));
    const bool is_one = strcmp(number, "1") == 0;
    dal__add_words(error, "%s%s%sconstraints[%zu]", first ? factor < 0.0 ? "-" : ""
                   : factor < 0.0 ? " - " : " + ", is_one ? "" : number, is_one ? "" : " ", row);
}

/* The record of a relation that has none yet gets a further row. */
static void add_row(dal_error *error, size_t row, double factor)
{
    if (error->rows == DAL_LENGTH(error->dependent)) return;
    error->factor[error->rows] = factor;
    error->dependent[error->rows++] = row;
}

/* Row order[k] in words, and in the record, if it is the first. */
static void add_relation(dal_mechanics *mech, const double *Z, const rows *self, size_t rank,
                         size_t k, dal_error *error)
{
    const size_t count = self->count, *const order = self->order;
    const double *const c = self->G + k * count, length = self->size[order[k]];
    const bool record = error->rows == 0;
    size_t terms = 0;
    if (record) add_row(error, row_of(self, order[k]), 1.0);
    dal__add_words(error, "constraints[%zu]", row_of(self, order[k]));
    if (!(length > 0.0)) {
        dal__add_words(error, " vanishes");
        return;
    }
    double left = distance(mech, Z, self, rank, k), total = 1.0, least = 1.0;
    for (size_t j = 0; j < rank; j++) {
        total += fabs(c[j]);
        least = fmin(least, self->G[j * count + j]);
    }
    const double rounding = 4.0 * (double)(mech->n + count) * DAL_ROUNDOFF * total;
    const double unknown = (left + rounding) / sqrt(least);
    for (size_t j = 0; j < rank; j++) terms += fabs(c[j]) > unknown;
    dal__add_words(error, terms == 1 ? " equals " : " = ");
    terms = 0;
    for (size_t row = 0; row < count; row++) /* in ascending order */
        for (size_t j = 0; j < rank; j++) {
            const double factor = c[j] * length / self->size[order[j]];
            if (order[j] != row || !(fabs(c[j]) > unknown)) continue;
            add_term(error, factor, unknown / fabs(c[j]), row_of(self, row), terms++ == 0);
            if (record) add_row(error, row_of(self, row), factor);
        }
    if (left > rounding) dal__add_words(error, " up to %.1g", left);
}

/* Adds all relations of these rows; whether there was one. */
static bool add_relations(dal_mechanics *mech, const double *mu, const double *Z, double least,
                          const rows *self, dal_error *error)
{
    if (!build_G(mech, mu, Z, self)) return false;
    const size_t rank = dal__independent_rows(self->count, self->G, least, self->order);
    if (rank == self->count || self->order[0] == self->count) return false;
    for (size_t row = 0, said = 0; row < self->count; row++)
        for (size_t k = rank; k < self->count; k++) {
            if (self->order[k] != row) continue;
            dal__add_words(error, said++ ? "; " : ": ");
            add_relation(mech, Z, self, rank, k, error);
        }
    dal__add_words(error, mech->eval.system->def.kind == DAL_LINEAR
                   ? " here" : " here, in its dependence on v");
    return true;
}

/* The block's rows, in ascending order. */
static void sort_rows(const dal__pattern *pattern, const dal__block *block, size_t *which)
{
    for (size_t k = 0; k < block->size; k++) {
        size_t place = k;
        for (; place > 0 && which[place - 1] > pattern->order[block->begin + k]; place--)
            which[place] = which[place - 1];
        which[place] = pattern->order[block->begin + k];
    }
}

bool dal__name_dependent(dal_mechanics *mech, const double *mu, const double *Z, double least,
                         dal_error *error)
{
    dal__linear *const C = &mech->gram.C;
    const dal__pattern *const pattern = C->pattern;
    bool said = false;
    if (!error) return false;
    if (!pattern) {
        const rows all = {mech->m, NULL, C->A, C->sizes, C->row};
        said = add_relations(mech, mu, Z, least, &all, error);
    }
    for (size_t b = 0; pattern && b < pattern->blocks && !said; b++) {
        const dal__block *const block = pattern->block + b;
        size_t which[MOST_OF_BLOCK], order[MOST_OF_BLOCK];
        double G[MOST_OF_BLOCK * MOST_OF_BLOCK], size[MOST_OF_BLOCK];
        if (block->size > MOST_OF_BLOCK) continue;
        sort_rows(pattern, block, which);
        const rows these = {block->size, which, G, size, order};
        said = add_relations(mech, mu, Z, least, &these, error);
    }
    return said;
}

bool dal__name_rank_lost(dal_mechanics *mech, const double *mu)
{
    dal__build_Z(mech, mu);
    return dal__name_dependent(mech, mu, mech->gram.Z, DAL_RANK_ALMOST_LOST, &mech->error);
}

void dal__name_turned(dal_mechanics *mech)
{
    const dal_rows *const stored = mech->eval.rows;
    const size_t n = mech->n;
    const double *const mu = mech->forms.mu, *const Z = mech->gram.Z;
    size_t named = 0;
    dal__build_Z(mech, mech->muk);
    for (size_t a = 0; a < mech->m; a++) {
        const double along = stored ? dal_rows_product(stored, mu, a, Z, a)
                                    : dal__dot(n, mu + a * n, Z + a * n);
        if (along >= 0.0) continue;
        dal__add_words(&mech->error, "%sconstraints[%zu]", named++ ? ", " : "; ", a);
    }
    if (named > 0)
        dal__add_words(&mech->error, " turn%s by more than a right angle in this step",
                       named == 1 ? "s" : "");
}
