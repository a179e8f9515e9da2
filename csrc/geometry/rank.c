/* How near C = mu M^-1 mu^T comes to losing its rank.
 *
 * Where it does two branches of a motion may meet, as at the dead centre of a linkage: a position
 * constraint that is off by e then has pivots of e where it should be 0, and the motion turns into
 * the other branch.  So a pivot that is less than the error of the steps is a doubt.
 *
 * The pivot of row a is the square of its part u = w^T mu across the others.  In a step of h u
 * changes by d = w^T (mu(q + h v) - mu(q)), and at a dead centre it passes through 0.  A scheme of
 * order 2 or more follows the right branch where |u| is more than UNRESOLVED |d|: measured, 2600
 * runs by six schemes beside a crossing of two curves, none that was wrong or refused above 1.8.
 * The position constraint of one of order 1 is off by about h, and there none of 400 was wrong with
 * |u|^2 above 1.2 |d| times the largest |u|. */
#include "geometry/geometry.h"

#include <math.h>

/* Rows whose pivots are up to so many times the least one have part in it. */
static const double ALIKE = 100.0;
enum { ROWS = 52 }; /* that a double can count */

static const double UNRESOLVED = 2.0, UNRESOLVED_BY_ORDER_1 = 2.0;

/* Where pivots at both ends of a step are above this part of the largest they say nothing: a step
 * may turn mu, as that of a wheel, by any angle. */
static const double SMALL = 0.3;

/* The log2 by which a determinant falls below the largest, or then below the last one that was
 * looked at, or rises above the largest, before C is looked at. */
static const double FALL = 2.0, FURTHER = 0.6, RISE = 2.0;

void dal__rank_reserve(dal__rank *rank, size_t n, size_t m, arena *a)
{
    DAL__RESERVE(a, m, &rank->largest, &rank->found, &rank->weight);
    DAL__RESERVE(a, dal__times(3, n), &rank->part);
}

void dal__rank_find(dal__rank *rank, dal_mechanics *mech)
{
    const dal__linear *const C = &mech->gram.C;
    const bool factored = mech->m > 0 && !C->pattern && !dal__factor_gram(mech);
    if (C->pattern) dal__build_Z(mech, mech->forms.mu);
    rank->inverse = factored ? 0.0 : (double)NAN;
    for (size_t a = 0; a < mech->m; a++) {
        rank->found[a] = C->pattern ? dal_rows_product(mech->eval.rows, mech->forms.mu, a,
                                                       mech->gram.Z, a)
                       : factored ? 1.0 / C->sizes[a] : 0.0;
        if (factored) rank->inverse -= 2.0 * log2(C->A[a * (mech->m + 1)]);
    }
}

/* Set the range around the log2 of 1/|det| of a matrix, NaN if it is unknown. */
static void set_range(dal__rank *rank, double inverse)
{
    const bool known = !isnan(inverse);
    rank->range[0] = known ? inverse - RISE : 1.0;
    rank->range[1] = known ? inverse + FALL : 0.0;
}

void dal__rank_start(dal__rank *rank, size_t m)
{
    rank->least = 1.0;
    rank->t = 0.0;
    rank->rows = rank->doubts = 0;
    set_range(rank, rank->inverse);
    dal__copy(m, rank->found, rank->largest);
}

void dal__rank_copy(size_t m, const dal__rank *from, dal__rank *to)
{
    const dal__rank own = *to;
    dal__copy(m, from->largest, own.largest);
    *to = *from;
    to->largest = own.largest;
    to->found = own.found;
    to->weight = own.weight;
    to->part = own.part;
}

void dal__rank_save(dal__rank *rank, size_t m, dal__archive *a)
{
    dal__archive_real(a, &rank->least);
    dal__archive_real(a, &rank->t);
    dal__archive_counter(a, &rank->rows);
    dal__archive_counter(a, &rank->doubts);
    dal__archive_any(a, &rank->range[0]);
    dal__archive_any(a, &rank->range[1]);
    dal__archive_vector(a, m, rank->largest);
}

bool dal__rank_strays(dal__rank *rank, double inverse)
{
    double *const range = rank->range;
    const bool first = range[0] > range[1];
    if (range[0] <= inverse && inverse <= range[1]) return false;
    if (first || inverse < range[0]) set_range(rank, inverse);
    else range[1] = inverse + FURTHER;
    return !first;
}

/* Record the pivot of row a at time t if it is the least so far. */
static void note(dal__rank *rank, size_t m, double t, size_t a, double pivot)
{
    const double least = pivot / rank->largest[a];
    if (!(least < rank->least)) return;
    rank->least = least;
    rank->t = t;
    rank->rows = 0;
    for (size_t b = 0; b < m && b < ROWS; b++)
        if (b == a || rank->found[b] <= ALIKE * least * rank->largest[b])
            rank->rows |= (size_t)1 << b;
}

/* weight[m] <- C^-1 times unit vector a, by its factors. */
static void solve_row(dal__rank *rank, dal_mechanics *mech, size_t a)
{
    dal__clear(mech->m, rank->weight);
    rank->weight[a] = 1.0;
    dal__solve_gram(mech, rank->weight);
}

/* The row that C of a pattern, which is factored, says most of: of the vector y that is nearest to
 * C y = 0, found by C y <- D y, with D the largest pivots.  All pivots would take m solutions. */
static size_t choose_row(dal__rank *rank, dal_mechanics *mech)
{
    enum { PASSES = 3 };
    const size_t m = mech->m;
    double *const y = rank->weight, most = 0.0;
    size_t row = 0;
    for (size_t a = 0; a < m; a++) y[a] = 1.0 + 0.1 * (double)(7 * a % 5); /* of no symmetry */
    for (int pass = 0; pass < PASSES; pass++) {
        for (size_t a = 0; a < m; a++) y[a] *= rank->largest[a];
        dal__solve_gram(mech, y);
    }
    for (size_t a = 0; a < m; a++)
        if (y[a] * y[a] * rank->largest[a] > most) {
            most = y[a] * y[a] * rank->largest[a];
            row = a;
        }
    return row;
}

/* found <- the pivots at x[2n], with C factored; or 0, where it is singular.  *row <- that which is
 * least beside its largest; of a pattern the others are not known. */
static int find_least(dal__rank *rank, dal_mechanics *mech, double t, double shift,
                      const double *x, size_t *row)
{
    const size_t m = mech->m;
    const int status = dal__forms_at(mech, t, shift, x, false);
    if (status) return status;
    const bool factored = !dal__factor_gram(mech), scattered = mech->gram.C.pattern;
    const size_t chosen = factored && scattered ? choose_row(rank, mech) : 0;
    if (factored && scattered) solve_row(rank, mech, chosen);
    *row = chosen;
    for (size_t a = 0; a < m; a++) {
        rank->found[a] = !factored ? 0.0
                       : !scattered ? 1.0 / mech->gram.C.sizes[a]
                       : a == chosen ? 1.0 / rank->weight[a] : rank->largest[a];
        rank->largest[a] = fmax(rank->largest[a], rank->found[a]);
        if (rank->found[a] * rank->largest[*row] < rank->found[*row] * rank->largest[a]) *row = a;
    }
    note(rank, m, t, *row, rank->found[*row]);
    return DAL_SUCCESS;
}

/* |d|^2 of a step of h from x[2n], where C has been factored, with u of this row; *least <- the
 * least |u|^2 on the way, if it is linear, at the time t + *part h; *end <- that at its end.  0
 * where the step leads out of the domain of a callback. */
static int find_change(dal__rank *rank, dal_mechanics *mech, double t, double shift, double h,
                       const double *x, size_t row, double *change, double *least, double *end,
                       double *part)
{
    const size_t n = mech->n, m = mech->m;
    double *const u = rank->part, *const y = u + n, *const Md = y + n;
    const double *const mu = mech->forms.mu;
    solve_row(rank, mech, row);
    dal__clear(n, u);
    for (size_t a = 0; a < m; a++) dal__row_add(mech, rank->found[row] * rank->weight[a], mu, a, u);
    dal__copy(2 * n, x, y);
    dal__add(n, h, x + n, y);
    const int status = dal__forms_at(mech, t + h, shift, y, false);
    if (status == DAL_EDOMAIN) return DAL_SUCCESS;
    if (status) return status;
    for (size_t i = 0; i < n; i++) y[i] = -u[i];
    for (size_t a = 0; a < m; a++) dal__row_add(mech, rank->found[row] * rank->weight[a], mu, a, y);
    dal__accelerate(mech, y, Md);
    const double along = dal__dot(n, u, Md), square = dal__dot(n, y, Md);
    if (square > 0.0) *part = fmax(0.0, fmin(1.0, -along / square));
    *change = square;
    *end = *least + 2.0 * along + square;
    *least = fmax(0.0, *least + *part * (2.0 * along + *part * square));
    return DAL_SUCCESS;
}

int dal__rank_look(dal__rank *rank, dal_mechanics *mech, double t, double shift, double allowed,
                   const double *x)
{
    size_t row;
    if (mech->m == 0) return DAL_SUCCESS;
    const int status = find_least(rank, mech, t, shift, x, &row);
    if (!status) rank->doubts += rank->found[row] < allowed * rank->largest[row];
    return status;
}

int dal__rank_pass(dal__rank *rank, dal_mechanics *mech, double t, double shift, double h,
                   int order, const double *x)
{
    size_t row;
    double change = 0.0, part = 0.0;
    if (mech->m == 0) return DAL_SUCCESS;
    int status = find_least(rank, mech, t, shift, x, &row);
    double least = status ? 1.0 : rank->found[row], end = least;
    if (!status && least > 0.0)
        status = find_change(rank, mech, t, shift, h, x, row, &change, &least, &end,
                             &part);
    if (status) return status;
    note(rank, mech->m, t + part * h, row, least);
    const double first = UNRESOLVED_BY_ORDER_1 * sqrt(change * rank->largest[row]);
    const double next = UNRESOLVED * UNRESOLVED * change;
    const bool small = fmin(rank->found[row], end) <= SMALL * rank->largest[row];
    rank->doubts += small && least <= (order > 1 ? next : fmax(first, next));
    mech->error.text[0] = '\0';
    return DAL_SUCCESS;
}

void dal__guards_report(const struct dal__guards *guards, dal_stats *stats)
{
    stats->least_pivot = guards->rank.least;
    stats->least_pivot_t = guards->rank.t;
    stats->least_pivot_rows = guards->rank.rows;
    stats->rank_doubts = guards->rank.doubts;
    stats->least_step = dal__creep_shortest(&guards->creep);
    stats->least_step_t = guards->creep.t;
}
