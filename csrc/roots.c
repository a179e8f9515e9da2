/* Floor 1: Newton's iteration on equations that come with their derivative. */
#include "internal.h"
#include "lu.h"

#include <math.h>

void dal__root_reserve(dal__root *root, size_t most, arena *a)
{
    double **const vectors[] = {&root->z, &root->residual, &root->step};
    dal__reserve_doubles(a, DAL_LENGTH(vectors), vectors, most);
    dal__reserve(a, &root->J, dal__times(most, most), sizeof(double));
    dal__reserve(a, &root->scale, dal__times(most, most), sizeof(double));
    dal__reserve(a, &root->row, most, sizeof(size_t));
}

bool dal__newton_is_done(const dal__progress *p)
{
    /* far from the origin what depends on q moves by more than 1e-11 with one rounding of q */
    const double floor = 1e-11 + 16.0 * DAL_ROUNDOFF * p->extent;
    if (p->size <= 4.0 * DAL_ROUNDOFF * p->scale) return true;
    if (p->iteration < 2) return false;
    if (p->size >= p->last) return p->size <= floor * p->scale;
    return !p->lagging && p->size * (p->size / p->last) <= DAL_ROUNDOFF / 16.0 * p->scale;
}

/* The equations at z; a step that led out of their domain is halved. */
static int evaluate(dal__root *root, const dal__equations *e, bool may_halve)
{
    enum { HALVINGS = 40 };
    int status, halvings = 0;
    while ((status = e->at(e->ctx, root->z, root->residual, root->J, root->scale)) == DAL_EDOMAIN
           && may_halve && halvings++ < HALVINGS)
        for (size_t i = 0; i < e->size; i++) root->z[i] -= root->step[i] *= 0.5;
    return status;
}

int dal__find_root(dal__root *root, const dal__equations *e, dal_error *error)
{
    enum { MOST = 50 };
    dal__progress p = {.last = HUGE_VAL};
    root->base = root->extent = 0.0;
    for (p.iteration = 1; p.iteration <= MOST; p.iteration++) {
        const int status = evaluate(root, e, p.iteration > 1);
        if (status) return status;
        dal__equilibrate(e->size, root->scale, root->step);
        if (!dal_lu_factor(e->size, e->size, root->J, root->scale, root->row))
            return dal__fail(error, DAL_ESINGULAR, "%s", e->singular);
        dal_lu_solve(e->size, root->J, root->row, root->residual, root->step);
        for (size_t i = 0; i < e->size; i++) root->z[i] += root->step[i] = -root->step[i];
        p.size = dal__sum_of_sizes(e->measured, root->step);
        p.scale = dal__sum_of_sizes(e->measured, root->z) + root->base;
        p.extent = root->extent;
        if (!dal__all_finite(e->size, root->z)) break;
        if (dal__newton_is_done(&p)) return DAL_SUCCESS;
        p.last = p.size;
    }
    return dal__fail(error, DAL_ENOCONV, "Newton did not converge: last change %.3g of %.3g; try a "
                     "smaller h", p.size, p.scale);
}
