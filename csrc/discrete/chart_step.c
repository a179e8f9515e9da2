/* One beta-step in the coordinates of a chart, with the multiplier eliminated. */
#include "dalembert/residual.h"
#include "discrete/discrete.h"

#include <math.h>

/* solution <- B_k^-T y_dependent with B_k factored: mu_k^T solution equals y in the dependent
 * components.  y[i*stride]. */
static void match_dependent(dal_chart *chart, const double *y, size_t stride)
{
    for (size_t a = 0; a < chart->m; a++) chart->right[a] = y[chart->place[a] * stride];
    dal__linear_solve_transposed(&chart->B, chart->right, chart->solution);
}

/* kappa += what makes R1_dependent = 0, and R1 with it. */
static void balance_dependent(dal_chart *chart)
{
    match_dependent(chart, chart->R1, 1);
    dal__add(chart->m, 1.0, chart->solution, chart->kappa);
    dal__add_reaction(chart->n, chart->m, -1.0, chart->mech.muk, chart->solution, chart->R1);
}

/* G <- [H^T K; d phi/dw] with the n-m rows H^T = [-A(q_k)^T, I], and its sizes. */
static void build_G(dal_chart *chart)
{
    const dal_mechanics *const mech = &chart->mech;
    const size_t n = chart->n, m = chart->m, free = n - m;
    const size_t *const place = chart->place + m;
    double *const sizes = chart->G.sizes;
    for (size_t k = 0; k < n; k++) {
        match_dependent(chart, chart->K + k, n);
        for (size_t j = 0; j < free; j++) {
            double sum = chart->K[place[j] * n + k];
            for (size_t a = 0; a < m; a++)
                sum -= mech->muk[a * n + place[j]] * chart->solution[a];
            chart->G.A[j * n + k] = sum;
        }
    }
    dal__copy(m * n, chart->slope, chart->G.A + free * n);
    for (size_t j = 0; j < free; j++) sizes[j] = mech->metric.per_unit[place[j]];
    for (size_t a = 0; a < m; a++)
        sizes[free + a] = dal_residual_row_norm(n, mech->metric.unit, chart->slope + a * n);
    dal__copy(n, mech->metric.per_unit, sizes + n);
}

/* step[n] <- the Newton step of w for H^T R1 = 0, phi = 0; kappa <- that of R1_dependent = 0 at
 * w. */
static int find_step(dal__newton *equations)
{
    dal_chart *const chart = equations->ctx;
    dal_mechanics *const mech = &chart->mech;
    const size_t n = chart->n, m = chart->m, free = n - m;
    int status = dal__step_at(mech, chart->w, chart->kappa, chart->R1, chart->R2, chart->K,
                              NULL, chart->slope);
    if (!status) status = dal__chart_factor(chart, mech->muk);
    if (status) return status;
    balance_dependent(chart);
    build_G(chart);
    for (size_t j = 0; j < free; j++) chart->y[j] = -chart->R1[chart->place[m + j]];
    for (size_t a = 0; a < m; a++) chart->y[free + a] = -chart->R2[a];
    if (!dal__linear_factor(&chart->G)) {
        dal__fail(&mech->error, DAL_ESINGULAR, "the step equations in these dependent coordinates "
                  "are singular with h = %g", mech->start.h);
        if (!dal__name_rank_lost(mech, mech->muk) && !dal__name_rank_lost(mech, mech->forms.mu))
            dal__add_words(&mech->error, DAL__RANK_OR_H);
        return DAL_ESINGULAR;
    }
    dal__linear_solve(&chart->G, chart->y, chart->step);
    equations->base = mech->start.base;
    return DAL_SUCCESS;
}

static double moves(void *ctx) { return dal__step_moves(&((dal_chart *)ctx)->mech); }

static int solve_step(dal_chart *chart)
{
    dal_mechanics *const mech = &chart->mech;
    const size_t n = chart->n;
    dal__newton equations = {.find_step = find_step, .moves = moves, .ctx = chart, .size = n,
                             .measured = n, .n = n, .per_unit = mech->metric.per_unit,
                             .z = chart->w, .step = chart->step, .lagging = true}; /* kappa */
    dal__copy(n, mech->start.v, chart->w);
    dal__clear(chart->m, chart->kappa);
    return dal__newton_run(&equations, &mech->error);
}

int dal_chart_step(dal_chart *chart, double t, double beta, double h, double *xi, double *lambda_E)
{
    if (!chart) return DAL_EINVAL;
    dal_mechanics *const mech = &chart->mech;
    const size_t n = chart->n;
    int status = dal__require_beta(mech, beta);
    if (!status) status = dal__require_step(&mech->error, h);
    if (!status) status = dal__chart_state(chart, t, xi);
    if (!status) status = dal__step_begin(mech, t, t + h, beta, beta, h, false, chart->x);
    if (!status) status = solve_step(chart);
    if (status) return status;
    dal__move(n, mech->node, beta * h, chart->w, chart->y);
    dal__copy(n, chart->w, chart->y + n);
    if (!dal__all_finite(2 * n, chart->y))
        return dal__fail(&mech->error, DAL_EDOMAIN, "the new state overflows with h = %g; try a "
                         "smaller h", h);
    dal__chart_drop(chart, chart->y, xi);
    dal__chart_reduce(chart, mech->muk, chart->kappa, chart->R2);
    for (size_t a = 0; lambda_E && a < chart->m; a++) lambda_E[a] = chart->R2[a] / h;
    return DAL_SUCCESS;
}
