/* Newton's iteration on equations that come with their derivative. */
#include "algebra/algebra.h"
#include "dalembert/lu.h"
#include "dalembert/residual.h"

#include <math.h>

void dal__root_reserve(dal__root *root, size_t most, arena *a)
{
    double **const vectors[] = {&root->z, &root->residual, &root->step};
    dal__reserve_doubles(a, DAL_LENGTH(vectors), vectors, most);
    dal__reserve(a, &root->J, dal__times(most, most), sizeof(double));
    dal__reserve(a, &root->scale, dal__times(most, most), sizeof(double));
    dal__reserve(a, &root->sizes, dal__times(5, most), sizeof(double));
    dal__reserve(a, &root->row, most, sizeof(size_t));
}

/* Where steps may stop to shrink because they are roundoff: far from the origin what depends on q
 * moves by more than 1e-11 with one rounding of q. */
static double floor_of(const dal__progress *p)
{
    return (1e-11 + 16.0 * DAL_ROUNDOFF * p->extent) * p->scale;
}

static bool is_done(const dal__progress *p)
{
    if (p->size <= 4.0 * DAL_ROUNDOFF * p->scale) return true;
    if (p->iteration < 2) return false;
    if (p->size >= p->last) return p->size <= floor_of(p);
    return !p->lagging && p->size * (p->size / p->last) <= DAL_ROUNDOFF / 16.0 * p->scale;
}

dal__verdict dal__newton_judge(dal__progress *p, double size)
{
    p->last = p->size;
    p->size = size;
    p->travelled += size;
    if (p->iteration == 1) p->first = size;
    if (p->iteration <= 2) {
        const double ratio = p->iteration == 1 ? 0.0 : size / p->first;
        p->reach = ratio < 1.0 ? p->first / (1.0 - fmax(ratio, 0.5)) : p->first;
    }
    if (!(size <= DBL_MAX)) return DAL__LOST;
    if (is_done(p)) return DAL__DONE;
    return p->travelled > p->reach * (1.0 + 1e-6) && size > floor_of(p) ? DAL__LOST : DAL__GOING;
}

void dal__newton_halve(dal__progress *p)
{
    p->size *= 0.5;
    p->travelled -= p->size;
}

/* The equations at z; a step that led out of their domain is halved. */
static int evaluate(dal__root *root, const dal__equations *e, dal__progress *p)
{
    enum { HALVINGS = 40 };
    int status, halvings = 0;
    while ((status = e->at(e->ctx, root->z, root->residual, root->J, root->scale)) == DAL_EDOMAIN
           && p->iteration > 1 && halvings++ < HALVINGS) {
        dal__newton_halve(p);
        for (size_t i = 0; i < e->size; i++) root->z[i] -= root->step[i] *= 0.5;
    }
    return status;
}

static double extent(const dal__equations *e, const double *z)
{
    return e->per_unit ? dal_residual_extent(e->measured, e->per_unit, z)
                       : dal__sum_of_sizes(e->measured, z);
}

int dal__find_root(dal__root *root, const dal__equations *e, dal_error *error)
{
    enum { MOST = 50 };
    dal__progress p = {0};
    root->base = root->extent = 0.0;
    for (p.iteration = 1; p.iteration <= MOST; p.iteration++) {
        const int status = evaluate(root, e, &p);
        if (status) return status;
        dal__sizes(e->size, root->scale, root->sizes);
        if (!dal_lu_factor(e->size, root->J, root->sizes, root->row))
            return dal__fail(error, DAL_ESINGULAR, "%s", e->singular);
        dal_lu_solve(e->size, root->J, root->row, root->residual, root->step);
        for (size_t i = 0; i < e->size; i++) root->z[i] += root->step[i] = -root->step[i];
        p.scale = extent(e, root->z) + root->base;
        p.extent = root->extent;
        if (!dal__all_finite(e->size, root->z)) break;
        const dal__verdict verdict =
            dal__newton_judge(&p, extent(e, root->step));
        if (verdict == DAL__DONE) return DAL_SUCCESS;
        if (verdict == DAL__LOST) break;
    }
    return dal__fail(error, DAL_ENOCONV, "Newton did not converge: last change %.3g of %.3g; try a "
                     "smaller h", p.size, p.scale);
}
