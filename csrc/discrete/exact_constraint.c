/* The exact discrete constraint D_d^E, by the reference flow. */
#include "discrete/discrete.h"
#include "dalembert/lu.h"

#include <math.h>

/* What the search for v0 works with. */
typedef struct search {
    dal_flow *flow;
    dal_mechanics *mech;
    double t0, h;
    const double *q1;
    double *x, *end; /* [2n] (q0, v0); what the flow makes of it */
    double *miss;    /* [n] (q1 - q(h))/h */
    double *defect;  /* [m] mu miss */
    arena arena;
} search;

/* miss and defect of x; end <- what of the miss lies along D, in its first n entries. */
static int shoot(search *s)
{
    dal_mechanics *const mech = s->mech;
    const size_t n = mech->n;
    dal__copy(2 * n, s->x, s->end);
    int status = dal__flow_apply(s->flow, s->t0, s->h, s->end, false);
    if (status) return status;
    for (size_t i = 0; i < n; i++) s->miss[i] = s->end[i] = (s->q1[i] - s->end[i]) / s->h;
    if (mech->m == 0) return DAL_SUCCESS;
    status = dal__forms_at(mech, s->t0, 0.0, s->x, false);
    if (!status) status = dal__factor_gram(mech);
    if (status) return status;
    for (size_t a = 0; a < mech->m; a++)
        s->defect[a] = mech->lambda[a] = dal__row_dot(mech, mech->forms.mu, a, s->miss);
    dal__solve_gram(mech, mech->lambda);
    for (size_t a = 0; a < mech->m; a++)
        dal__row_add(mech, -mech->lambda[a], mech->gram.Z, a, s->end);
    return DAL_SUCCESS;
}

/* v0 += the part along D of the miss: that of v0 is identity + O(h). */
static int find_velocity(search *s)
{
    enum { MOST = 60 };
    const size_t n = s->mech->n;
    double *const v = s->x + n;
    const double extent = dal__sum_of_sizes(n, s->x) + dal__sum_of_sizes(n, s->q1);
    double last = HUGE_VAL, size = 0.0, scale = 0.0;
    for (int iteration = 1; iteration <= MOST; iteration++) {
        int status = dal_project(s->mech, s->t0, 0.0, s->x, NULL);
        if (!status) status = shoot(s);
        if (status) return status;
        size = dal__sum_of_sizes(n, s->end);
        scale = dal__sum_of_sizes(n, v) + dal__sum_of_sizes(n, s->miss);
        /* what the flow and the digits of the nodes leave of a quotient by h */
        const double noise = 4.0 * DAL_ROUNDOFF * scale + (dal__flow_tolerance(s->flow)
                             + DAL_ROUNDOFF) * (extent + scale) / fabs(s->h);
        if (size <= noise) return dal__require_output(&s->mech->error, "defect", s->mech->m,
                                                      s->defect);
        if (iteration == MOST || !(size <= DBL_MAX) || size > 1e3 * fmin(last, scale)) break;
        dal__add(n, 1.0, s->end, v);
        last = size;
    }
    return dal__fail(&s->mech->error, DAL_ENOCONV, "no velocity at q0 leads to q1: the last "
                     "velocity misses by %.3g of %.3g; h = %g is too large", size, scale, s->h);
}

int dal_exact_velocity(dal_flow *flow, double t0, double h, const double *q0, const double *q1,
                       double *v0, double *defect)
{
    if (!flow) return DAL_EINVAL;
    search s = {.flow = flow, .mech = dal__flow_mechanics(flow), .t0 = t0, .h = h, .q1 = q1};
    const size_t n = s.mech->n, m = s.mech->m;
    dal_error *const error = &s.mech->error;
    int status = DAL__REQUIRE_FINITE(error, {"v0", 0, v0}, {"t0", 1, &t0}, {"q0", n, q0},
                                     {"q1", n, q1});
    if (!status) status = dal__require_step(error, h);
    if (status) return status;
    DAL__RESERVE(&s.arena, dal__times(2, n), &s.x, &s.end);
    DAL__RESERVE(&s.arena, n, &s.miss);
    DAL__RESERVE(&s.arena, m, &s.defect);
    status = dal__allocate(&s.arena, error);
    if (status) return status;
    for (size_t i = 0; i < n; i++) {
        s.x[i] = q0[i];
        s.x[n + i] = (q1[i] - q0[i]) / h;
    }
    status = find_velocity(&s);
    if (!status)
        status = DAL__DELIVER(error, {"v0", n, s.x + n, v0}, {"defect", m, s.defect, defect});
    dal__release(&s.arena);
    return status;
}
