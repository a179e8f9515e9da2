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
    DAL__RESERVE(a, m, &rank->largest, &rank->found);
}

void dal__rank_find(dal__rank *rank, dal_mechanics *mech)
{
    const bool factored = mech->m > 0 && !mech->gram.C.pattern && !dal__factor_gram(mech);
    for (size_t a = 0; a < mech->m; a++)
        rank->found[a] = factored ? 1.0 / mech->gram.C.sizes[a] : 0.0;
}

void dal__rank_start(dal__rank *rank, size_t m)
{
    *rank = (dal__rank){.largest = rank->largest, .found = rank->found, .least = 1.0};
    dal__copy(m, rank->found, rank->largest);
}

void dal__rank_copy(size_t m, const dal__rank *from, dal__rank *to)
{
    double *const largest = to->largest, *const found = to->found;
    dal__copy(m, from->largest, largest);
    *to = *from;
    to->largest = largest;
    to->found = found;
}

int dal__rank_look(dal__rank *rank, dal_mechanics *mech, double t, double shift, double allowed,
                   const double *x)
{
    const size_t m = mech->m;
    double least = 1.0;
    if (m == 0 || mech->gram.C.pattern) return DAL_SUCCESS;
    const int status = dal__forms_at(mech, t, shift, x, false);
    if (status) return status;
    dal__rank_find(rank, mech);
    for (size_t a = 0; a < m; a++) {
        rank->largest[a] = fmax(rank->largest[a], rank->found[a]);
        if (rank->found[a] < least * rank->largest[a]) least = rank->found[a] / rank->largest[a];
    }
    if (least < rank->least) {
        rank->least = least;
        rank->t = t;
        rank->rows = 0;
        for (size_t a = 0; a < m && a < ROWS; a++)
            if (rank->found[a] <= ALIKE * least * rank->largest[a]) rank->rows |= (size_t)1 << a;
    }
    rank->doubts += least < allowed;
    return DAL_SUCCESS;
}
