/* What is left of a stage that the step routine of kernel.h does not finish by itself: the
 * full Newton iteration, and the residual of D evaluated at what is stored. */
#include "step/beta.h"
#include "dalembert/residual.h"

#include <math.h>
#include <string.h>

static const dal_pattern everything = {DAL_KERNEL_ALL, DAL_KERNEL_ALL, DAL_KERNEL_ALL,
                                       DAL_KERNEL_ALL, DAL_KERNEL_ALL};

static int is_not_finite(dal_kernel *k)
{
    return dal_kernel_fail(k, DAL_EDOMAIN, DAL_FAILED_FINITE);
}

/* The callbacks at the iterate w of solve and time t, and goal, which is all of v' but Z^T kappa.
 * DAL_EDOMAIN: outside their domain or not finite; the reason is in k->failure. */
static int evaluate(dal_kernel *k, double t, const dal_stage *s)
{
    const dal_arrays *const at = &k->at;
    const size_t n = k->n, m = k->m;
    const double b = s->after * k->h;
    for (size_t i = 0; i < n; i++) at->point[i] = at->node[i] + b * at->w[i];
    double total = 0.0;
    memcpy(at->goal, at->base, n * sizeof *at->goal);
    if (m > 0) {
        const int returned = dal_kernel_constraint(k, t, at->point, at->w, at->mu, at->N);
        if (returned) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        total += dal_kernel_sum(m * n, at->mu) + dal_kernel_sum(m * n, at->N);
    }
    if (k->potential && s->end != 0.0) {
        k->stats.potential_calls++;
        const int returned = k->potential(t, at->point, NULL, k->force1, k->K, k->potential_ctx);
        if (returned) return dal_kernel_refused(k, DAL_FAILED_POTENTIAL, returned);
        dal_kernel_accelerate(k, n, everything.inverse, k->force1, at->goal);
        for (size_t i = 0; i < n; i++) at->goal[i] = at->base[i] - k->h * s->end * at->goal[i];
        total += dal_kernel_sum(n, k->force1) + dal_kernel_sum(n * n, k->K);
    }
    return total <= DBL_MAX ? DAL_SUCCESS : is_not_finite(k);
}

/* y <- K^-1 (-R1) and Z <- the rows K^-1 mu_node^a, with K = M + h B h end V_qq in k->K; *sign <-
 * that of det K where it is not 1. */
static int linearise(dal_kernel *k, const dal_stage *s, int *sign)
{
    const dal_arrays *const at = &k->at;
    const size_t n = k->n, m = k->m;
    if (!k->potential || s->end == 0.0) { /* K = M */
        for (size_t i = 0; i < n; i++) {
            k->y[i] = at->base[i] - at->w[i];
            if (m > 0) k->y[i] += dal_kernel_column(n, m, everything.Z, at->Z, i, at->kappa);
        }
        return DAL_SUCCESS;
    }
    const double weight = k->h * s->end;
    for (size_t i = 0; i < n; i++) {
        double sum = -weight * k->force1[i];
        for (size_t j = 0; j < n; j++) {
            const double bend = weight * s->after * k->h * k->K[i * n + j];
            sum -= k->mass[i * n + j] * (at->w[j] - at->base[j]);
            k->K[i * n + j] = k->mass[i * n + j] + bend;
            if (i == j) /* the sizes of row and column, see lu.h */
                k->K_sizes[i] = k->K_sizes[n + i] = sqrt(k->mass[i * n + i] + fabs(bend));
        }
        if (m > 0) sum += dal_kernel_column(n, m, everything.mu, at->mu_node, i, at->kappa);
        k->R[i] = sum;
    }
    *sign = dal_lu_factor(n, k->K, k->K_sizes, k->K_row);
    if (*sign == 0)
        return dal_kernel_fail(k, DAL_ESINGULAR, DAL_FAILED_SINGULAR_K);
    dal_lu_solve(n, k->K, k->K_row, k->R, k->y);
    for (size_t a = 0; a < m; a++)
        dal_lu_solve(n, k->K, k->K_row, at->mu_node + a * n, at->Z + a * n);
    return DAL_SUCCESS;
}

/* How far V_q moves v' when q~' moves by itself, with V_qq in k->K: times u it is what is not known
 * of w. */
static double bent(const dal_kernel *k, const dal_stage *s)
{
    const size_t n = k->n;
    double sum = 0.0;
    for (size_t l = 0; k->potential && s->end != 0.0 && l < n * n; l++)
        sum += fabs(k->h * s->end * k->K[l] * k->at.point[l % n]) * k->unit[l / n];
    return sum;
}

static double moves(const void *ctx) { return *(const double *)ctx; }

/* w and kappa after a Newton step with the full matrix [[K, -mu_node^T], [mu + B h N, 0]], where
 * the callbacks were evaluated; *sign <- that of its determinant. */
static int make_step(dal_kernel *k, const dal_stage *s, int *sign)
{
    const dal_arrays *const at = &k->at;
    const size_t n = k->n, m = k->m;
    const double b = s->after * k->h;
    *sign = 1;
    const int status = linearise(k, s, sign);
    if (status) return status;
    k->stats.iterations++;
    *sign *= dal_kernel_factor(k, n, m, everything, b, at);
    if (*sign == 0) return dal_kernel_fail(k, DAL_ESINGULAR, DAL_FAILED_SINGULAR_S);
    for (size_t a = 0; a < m; a++) {
        double sum = 0.0;
        for (size_t i = 0; i < n; i++)
            sum += at->mu[a * n + i] * at->w[i]
                 + (at->mu[a * n + i] + b * at->N[a * n + i]) * k->y[i];
        at->r[a] = -sum;
    }
    dal_lu_solve(m, at->S, at->row, at->r, at->d);
    for (size_t i = 0; i < n; i++) {
        at->step[i] = k->y[i];
        if (m > 0) at->step[i] += dal_kernel_column(n, m, everything.Z, at->Z, i, at->d);
        at->w[i] += at->step[i];
    }
    for (size_t a = 0; a < m; a++) at->kappa[a] += at->d[a];
    return DAL_SUCCESS;
}

/* Newton from w = v, kappa = 0; a step that leaves the domain of a callback is halved.  On success
 * w, kappa, mu, N and point are set. */
static int solve(dal_kernel *k, double t, const dal_stage *s)
{
    const dal_arrays *const at = &k->at;
    const size_t n = k->n, m = k->m;
    double of_V = 0.0;
    dal__progress p = {.moves = moves, .ctx = &of_V};
    if (!(dal_kernel_sum(m * n, at->Z) + dal_kernel_sum(n, at->base) <= DBL_MAX))
        return is_not_finite(k);
    k->stats.full_newtons++;
    memcpy(at->w, at->x + n, n * sizeof *at->w);
    memset(at->kappa, 0, m * sizeof *at->kappa);
    for (p.iteration = 1; p.iteration <= k->max_iterations; p.iteration++) {
        int status, sign;
        while (dal__newton_halve(&p, status = evaluate(k, t, s), n, at->w, at->step))
            k->stats.halvings++;
        if (!status) of_V = bent(k, s);
        if (!status) status = make_step(k, s, &sign);
        if (status) return status;
        p.scale = dal_residual_extent(n, k->per_unit, at->w)
                + dal_residual_extent(n, k->per_unit, at->base)
                + dal_residual_extent(n, k->per_unit, at->goal);
        k->failure.iterations = p.iteration;
        k->failure.size = dal_residual_extent(n, k->per_unit, at->step);
        k->failure.scale = p.scale;
        const dal__verdict verdict = dal__newton_judge(&p, k->failure.size);
        k->failure.first = p.first;
        k->failure.travelled = p.travelled;
        if (sign < 0 && verdict != DAL__LOST)
            return dal_kernel_fail(k, DAL_ENOCONV, DAL_FAILED_BRANCH);
        if (verdict == DAL__DONE) return DAL_SUCCESS;
        if (verdict == DAL__LOST) return dal_kernel_fail(k, DAL_ENOCONV, DAL_FAILED_ROOT);
    }
    return dal_kernel_fail(k, DAL_ENOCONV, DAL_FAILED_CONVERGE);
}

/* The final correction v' <- v' - Z' C'^-1 mu(q~') v' at the q~' that the stored node gives back,
 * with evaluations of its own.  Works on at.w and at.stored.  Each pass leaves its own roundoff of
 * what it takes away; a kept node follows v', so that it gives back the same q~' but for a
 * rounding. */
static int correct(dal_kernel *k, double t)
{
    enum { MOST = 8 }; /* a pass leaves of the residual as much as the condition times u */
    const dal_arrays *const at = &k->at;
    const size_t n = k->n, m = k->m;
    const double shift = k->shift * k->h;
    const double before = dal_residual_speed(n, k->per_unit, at->w);
    for (int pass = 1;; pass++) {
        for (size_t i = 0; i < n; i++) at->point[i] = at->stored[i] - shift * at->w[i];
        const int returned = dal_kernel_constraint(k, t, at->point, at->w, at->mu,
                                                   pass > MOST ? at->N : NULL);
        k->stats.corrections++;
        if (returned) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        if (!(dal_kernel_sum(m * n, at->mu) <= DBL_MAX)) return is_not_finite(k);
        if (dal_kernel_settled(k, n, m, everything, at, DAL_KERNEL_LIMIT(n)))
            return DAL_SUCCESS;
        if (pass > MOST) /* the rounding of a large node may move mu by more */
            return k->kept && dal_kernel_is_roundoff(k, n, m, everything, at)
                        && dal_kernel_settled(k, n, m, everything, at, DBL_MAX)
                       ? DAL_SUCCESS
                       : dal_kernel_fail(k, DAL_ESINGULAR, DAL_FAILED_SINGULAR_C);
        for (size_t a = 0; a < m; a++)
            dal_kernel_accelerate(k, n, everything.inverse, at->mu + a * n, at->Z + a * n);
        for (size_t a = 0; a < m; a++)
            for (size_t c = 0; c < m; c++)
                at->S[a * m + c] = dal__dot(n, at->mu + a * n, at->Z + c * n);
        if (!dal__cholesky(m, at->S, at->sizes, NULL, NULL))
            return dal_kernel_fail(k, DAL_ESINGULAR, DAL_FAILED_SINGULAR_C);
        dal__cholesky_solve(m, at->S, at->r);
        for (size_t i = 0; i < n; i++)
            at->w[i] += dal_kernel_column(n, m, everything.Z, at->Z, i, at->r);
        /* A velocity across D is zero. */
        if (dal_residual_speed(n, k->per_unit, at->w) <= DAL_RESIDUAL_BOUND(n) * before)
            memset(at->w, 0, n * sizeof *at->w);
        for (size_t i = 0; i < n; i++) at->stored[i] = at->point[i] + shift * at->w[i];
    }
}

int dal__kernel_finish(dal_kernel *k, double t_end, const dal_stage *s, bool solved)
{
    if (!solved) {
        const int status = solve(k, t_end, s);
        if (status) return status;
        dal_kernel_place(k, s, k->n, k->kept, &k->at);
    }
    if (!(dal_kernel_sum(k->n, k->at.stored) + dal_kernel_sum(k->n, k->at.w) <= DBL_MAX))
        return is_not_finite(k);
    return k->m > 0 ? correct(k, t_end) : DAL_SUCCESS;
}
