/* How near C = mu M^-1 mu^T comes to losing its rank.
 *
 * Where it does two branches of a motion may meet, as at the dead centre of a linkage: a position
 * constraint that is off by e then has pivots of e where it should be 0, and the motion turns into
 * the other branch.  So a pivot that is less than the error of the steps is a doubt. */
#include "geometry/geometry.h"

#include <math.h>

/* Rows whose pivots are up to so many times the least one have part in it. */
static const double ALIKE = 100.0;
enum { ROWS = 52 }; /* that a double can count */

void dal__rank_reserve(dal__rank *rank, size_t m, arena *a)
{
    DAL__RESERVE(a, m, &rank->largest);
}

void dal__rank_start(dal__rank *rank, size_t m)
{
    dal__clear(m, rank->largest);
    *rank = (dal__rank){.largest = rank->largest, .least = 1.0};
}

void dal__rank_copy(size_t m, const dal__rank *from, dal__rank *to)
{
    double *const largest = to->largest;
    dal__copy(m, from->largest, largest);
    *to = *from;
    to->largest = largest;
}

/* The least pivot of C, which is factored, beside its largest; *rows <- whose they are. */
static double compare(dal__rank *rank, const dal__linear *C, size_t m, size_t *rows)
{
    double least = 1.0;
    for (size_t a = 0; a < m; a++) {
        const double pivot = 1.0 / C->sizes[a];
        rank->largest[a] = fmax(rank->largest[a], pivot);
        least = fmin(least, pivot / rank->largest[a]);
    }
    *rows = 0;
    for (size_t a = 0; a < m && a < ROWS; a++)
        if (1.0 / C->sizes[a] <= ALIKE * least * rank->largest[a]) *rows |= (size_t)1 << a;
    return least;
}

int dal__rank_look(dal__rank *rank, dal_mechanics *mech, double t, double shift, double allowed,
                   const double *x)
{
    evaluator *const e = &mech->eval;
    const size_t calls[] = {e->constraint_calls, e->lagrangian_calls};
    if (mech->m == 0 || mech->gram.C.pattern) return DAL_SUCCESS;
    int status = dal__forms_at(mech, t, shift, x, false);
    e->constraint_calls = calls[0];
    e->lagrangian_calls = calls[1];
    if (status) return status == DAL_EUSER ? status : DAL_SUCCESS;
    size_t rows = 0;
    status = dal__factor_gram(mech);
    const double least = status ? 0.0 : compare(rank, &mech->gram.C, mech->m, &rows);
    if (least < rank->least) {
        rank->least = least;
        rank->t = t;
        rank->rows = rows;
    }
    rank->doubts += least < allowed;
    return DAL_SUCCESS;
}
