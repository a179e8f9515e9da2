/* Newton's iteration: the only one outside of the step routine, which has a rule of its own. */
#include "algebra/algebra.h"

#include <math.h>

/* Steps that are the rounding of the point. */
static double rounding_of(const dal__progress *p)
{
    return 16.0 * DAL_ROUNDOFF * (p->moves ? p->moves(p->ctx) : 0.0);
}

/* Where steps may stop to shrink because they are roundoff. */
static double floor_of(const dal__progress *p) { return 1e-11 * p->scale + rounding_of(p); }

static bool is_done(const dal__progress *p)
{
    if (p->size <= 4.0 * DAL_ROUNDOFF * p->scale) return true;
    if (p->iteration < 2) return false;
    if (p->size >= p->last) return p->size <= floor_of(p);
    /* below their rounding equations have another slope than Newton's, or none */
    if (p->size > 0.5 * p->last && p->size <= rounding_of(p)) return true;
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

bool dal__newton_halve(dal__progress *p, int status, size_t size, double *z, double *step)
{
    enum { MOST = 40 };
    if (status != DAL_EDOMAIN || !(p->size > 0.0) || p->halvings == MOST) return false;
    p->halvings++;
    p->size *= 0.5;
    p->travelled -= p->size;
    for (size_t i = 0; i < size; i++) z[i] -= step[i] *= 0.5;
    return true;
}

static double extent(const dal__newton *self, const double *z)
{
    double sum = 0.0;
    for (const double *const end = z + self->measured; z < end; z += self->n)
        for (size_t i = 0; i < self->n; i++) sum += fabs(z[i]) * self->per_unit[i];
    return sum;
}

int dal__newton_run(dal__newton *self, dal_error *error)
{
    enum { MOST = 50 };
    const char *const advice = self->advice ? self->advice : "try a smaller h";
    dal__progress *const p = &self->progress;
    dal__verdict verdict = DAL__GOING;
    *p = (dal__progress){.lagging = self->lagging, .moves = self->moves, .ctx = self->ctx};
    while (verdict == DAL__GOING && p->iteration < (self->most ? self->most : MOST)) {
        int status;
        do {
            status = self->find_step(self);
        } while (dal__newton_halve(p, status, self->size, self->z, self->step));
        if (status) return status;
        p->iteration++;
        dal__add(self->size, 1.0, self->step, self->z);
        p->scale = extent(self, self->z) + self->base;
        verdict = dal__newton_judge(p, extent(self, self->step));
        if (!dal__all_finite(self->size, self->z)) break;
        if (self->sign < 0 && verdict != DAL__LOST)
            return dal__fail(error, DAL_ENOCONV, DAL__BRANCH_TEXT);
        if (verdict == DAL__DONE) return DAL_SUCCESS;
    }
    if (verdict == DAL__LOST && p->size <= DBL_MAX)
        return dal__fail(error, DAL_ENOCONV, "Newton did not converge: its updates add up to %.3g, "
                         "the first was %.3g (size of the unknowns %.3g); %s", p->travelled,
                         p->first, p->scale, advice);
    return dal__fail(error, DAL_ENOCONV, "Newton did not converge in %d iterations: the last "
                     "update was %.3g (size of the unknowns %.3g); %s", p->iteration, p->size,
                     p->scale, advice);
}

void dal__root_reserve(dal__root *root, size_t most, arena *a)
{
    DAL__RESERVE(a, most, &root->z, &root->residual, &root->step);
    DAL__RESERVE(a, dal__times(most, most), &root->scale);
    dal__linear_reserve(&root->J, most, a);
}

int dal__root_step(dal__root *root, const char *singular, dal_error *error)
{
    dal__linear_balance(&root->J, root->scale);
    if (!dal__linear_factor(&root->J)) return dal__fail(error, DAL_ESINGULAR, "%s", singular);
    dal__linear_solve(&root->J, root->residual, root->step);
    for (size_t i = 0; i < root->J.size; i++) root->step[i] = -root->step[i];
    return DAL_SUCCESS;
}
