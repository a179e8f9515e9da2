/* Floor 1: Newton's iteration on equations that come with their derivative. */
#include "internal.h"
#include "lu.h"

#include <math.h>

void dal__root_reserve(dal__root *root, size_t most, arena *a)
{
    double **const vectors[] = {&root->z, &root->residual, &root->step};
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        dal__reserve(a, vectors[i], most, sizeof(double));
    dal__reserve(a, &root->J, dal__times(most, most), sizeof(double));
    dal__reserve(a, &root->scale, dal__times(most, most), sizeof(double));
    dal__reserve(a, &root->row, most, sizeof(size_t));
}

static double sum_of_sizes(size_t n, const double *x)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++) sum += fabs(x[i]);
    return sum;
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
    double last = HUGE_VAL, size = 0.0, scale = 0.0;
    for (int iteration = 1; iteration <= MOST; iteration++) {
        const int status = evaluate(root, e, iteration > 1);
        if (status) return status;
        if (!dal_lu_factor(e->size, e->size, root->J, root->scale, root->row))
            return dal__fail(error, DAL_ESINGULAR, "%s", e->singular);
        dal_lu_solve(e->size, root->J, root->row, root->residual, root->step);
        for (size_t i = 0; i < e->size; i++) root->z[i] += root->step[i] = -root->step[i];
        size = sum_of_sizes(e->measured, root->step);
        scale = sum_of_sizes(e->measured, root->z) + e->base;
        if (!dal__all_finite(e->size, root->z)) break;
        if (size <= 4.0 * DAL_ROUNDOFF * scale) return DAL_SUCCESS;
        if (iteration >= 2 && size <= 1e-11 * scale && size >= last) return DAL_SUCCESS;
        /* at least linear: the next step would be smaller by the same factor */
        if (iteration >= 2 && size * (size / last) <= DAL_ROUNDOFF / 16.0 * scale)
            return DAL_SUCCESS;
        last = size;
    }
    return dal__fail(error, DAL_ENOCONV, "Newton did not converge: last change %.3g of %.3g; try a "
                     "smaller h", size, scale);
}
