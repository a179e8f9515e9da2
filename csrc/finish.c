/* Floor 6: what is left of a stage that the step routine of kernel.h does not finish by itself: the
 * full Newton iteration, and the residual of D evaluated at what is stored. */
#include "internal.h"
#include "kernel.h"

#include <math.h>
#include <string.h>

static const dal_pattern everything = {DAL_KERNEL_ALL, DAL_KERNEL_ALL, DAL_KERNEL_ALL,
                                       DAL_KERNEL_ALL, DAL_KERNEL_ALL};

static int is_not_finite(dal_kernel *k)
{
    return dal_kernel_fail(k, DAL_EDOMAIN, DAL_FAILED_FINITE);
}

/* The callbacks at the iterate w of solve.  DAL_EDOMAIN: outside their domain or not finite; the
 * reason is in k->failure. */
static int evaluate(dal_kernel *k, const dal_stage *s)
{
    const dal_arrays *const at = &k->at;
    const size_t n = k->n, m = k->m;
    const double b = s->after * k->h;
    for (size_t i = 0; i < n; i++) at->point[i] = at->node[i] + b * at->w[i];
    double total = 0.0;
    if (m > 0) {
        const int returned = dal_kernel_constraint(k, at->point, at->w, at->mu, at->N);
        if (returned) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        total += dal_kernel_sum(m * n, at->mu) + dal_kernel_sum(m * n, at->N);
    }
    if (k->potential && s->end != 0.0) {
        k->stats.potential_calls++;
        const int returned = k->potential(at->point, NULL, k->force1, k->K, k->potential_ctx);
        if (returned) return dal_kernel_refused(k, DAL_FAILED_POTENTIAL, returned);
        total += dal_kernel_sum(n, k->force1) + dal_kernel_sum(n * n, k->K);
    }
    return total <= DBL_MAX ? DAL_SUCCESS : is_not_finite(k);
}

/* y <- K^-1 (-R1) and Z <- the rows K^-1 mu_node^a, with K = M + h B h end V_qq in k->K. */
static int linearise(dal_kernel *k, const dal_stage *s)
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
            k->K_scale[i * n + j] = fabs(k->mass[i * n + j]) + fabs(bend);
        }
        if (m > 0) sum += dal_kernel_column(n, m, everything.mu, at->mu_node, i, at->kappa);
        k->R[i] = sum;
    }
    if (!dal_lu_factor(n, 2, k->K, k->K_scale, k->K_row))
        return dal_kernel_fail(k, DAL_ESINGULAR, DAL_FAILED_SINGULAR_K);
    dal_lu_solve(n, k->K, k->K_row, k->R, k->y);
    for (size_t a = 0; a < m; a++)
        dal_lu_solve(n, k->K, k->K_row, at->mu_node + a * n, at->Z + a * n);
    return DAL_SUCCESS;
}

/* Newton with the full matrix [[K, -mu_node^T], [mu + B h N, 0]] from w = v, kappa = 0; a step that
 * leaves the domain of a callback is halved.  On success w, kappa, mu, N and point are set. */
static int solve(dal_kernel *k, const dal_stage *s)
{
    enum { HALVINGS = 40 };
    const dal_arrays *const at = &k->at;
    const size_t n = k->n, m = k->m;
    const double b = s->after * k->h;
    double last = HUGE_VAL;
    int halvings = 0;
    if (!(dal_kernel_sum(m * n, at->Z) + dal_kernel_sum(n, at->base) <= DBL_MAX))
        return is_not_finite(k);
    k->stats.full_newtons++;
    memcpy(at->w, at->x + n, n * sizeof *at->w);
    memset(at->kappa, 0, m * sizeof *at->kappa);
    for (int iteration = 1; iteration <= k->max_iterations; iteration++) {
        int status;
        while ((status = evaluate(k, s)) == DAL_EDOMAIN && iteration > 1 && halvings++ < HALVINGS) {
            for (size_t i = 0; i < n; i++) at->w[i] -= at->step[i] *= 0.5;
            for (size_t a = 0; a < m; a++) at->kappa[a] -= at->d[a] *= 0.5;
            k->stats.halvings++;
        }
        if (!status) status = linearise(k, s);
        if (status) return status;
        k->stats.iterations++;
        if (!dal_kernel_factor(n, m, everything, b, at))
            return dal_kernel_fail(k, DAL_ESINGULAR, DAL_FAILED_SINGULAR_S);
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
        const double size = dal_kernel_sum(n, at->step);
        const double scale = dal_kernel_sum(n, at->w) + dal_kernel_sum(n, at->x + n)
                           + dal_kernel_sum(n, at->base);
        k->failure.iterations = iteration;
        k->failure.size = size;
        k->failure.scale = scale;
        if (!(size <= DBL_MAX)) break;
        if (size <= 4.0 * DAL_KERNEL_U * scale) return DAL_SUCCESS;
        /* far from the origin mu moves by more than that with one rounding of q */
        const double floor = 1e-11 + 16.0 * DAL_KERNEL_U * dal_kernel_sum(n, at->point);
        if (iteration >= 2 && size <= floor * scale && size >= last) return DAL_SUCCESS;
        last = size;
    }
    return dal_kernel_fail(k, DAL_ENOCONV, DAL_FAILED_CONVERGE);
}

/* The final correction v' <- v' - Z' C'^-1 mu(q~') v' at the stored q~', with an evaluation of its
 * own.  Works on at.stored and at.w; at.point becomes the q~' that belongs to them.  foretold: the
 * residual was predicted to be within limit.  Where it is far from it, mu has a roundoff that no
 * prediction knows of, as sin(a + b) has for large angles, and they are no longer relied on. */
static int correct(dal_kernel *k, bool foretold)
{
    enum { MOST = 4 };
    const dal_arrays *const at = &k->at;
    const size_t n = k->n, m = k->m;
    const double limit = 2.0 * (double)n * DAL_KERNEL_U, shift = k->kept ? k->shift * k->h : 0.0;
    dal_pattern here = everything; /* mu is evaluated where it is asked for */
    here.N = 0;
    for (int pass = 0; m > 0 && pass < MOST; pass++) {
        bool same = pass > 0;
        for (size_t i = 0; i < n; i++) {
            const double q = at->stored[i] - shift * at->w[i];
            if (q != at->point[i]) same = false;
            at->point[i] = q;
        }
        if (!same) {
            const int returned = dal_kernel_constraint(k, at->point, at->w, at->mu, NULL);
            k->stats.corrections++;
            if (returned) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        }
        dal_progress found;
        double unused = 0.0;
        const bool last = pass == MOST - 1; /* what is left then is roundoff, and is reported */
        if (dal_kernel_settled(n, m, here, at, last ? DBL_MAX : limit, &found,
                               &k->stats.worst_residual))
            break;
        if (foretold && pass == 0
            && !dal_kernel_settled(n, m, here, at, 1.5 * limit, &found, &unused))
            k->distrusted = true;
        for (size_t a = 0; a < m; a++)
            dal_kernel_accelerate(k, n, here.inverse, at->mu + a * n, at->Z + a * n);
        if (!dal_kernel_factor(n, m, here, 0.0, at)) {
            if (!(dal_kernel_sum(m * n, at->mu) <= DBL_MAX)) return is_not_finite(k);
            return dal_kernel_fail(k, DAL_ESINGULAR, DAL_FAILED_SINGULAR_C);
        }
        dal_lu_solve(m, at->S, at->row, at->r, at->d);
        for (size_t i = 0; i < n; i++) {
            at->w[i] += dal_kernel_column(n, m, here.Z, at->Z, i, at->d);
            /* q~' is not changed: a kept node moves with v', and gives back the same q~' */
            if (k->kept) at->stored[i] = at->point[i] + shift * at->w[i];
        }
    }
    return dal_kernel_sum(n, at->w) + dal_kernel_sum(n, at->stored) <= DBL_MAX ? DAL_SUCCESS
                                                                               : is_not_finite(k);
}

int dal__kernel_finish(dal_kernel *k, const dal_stage *s, bool solved, bool foretold)
{
    if (!solved) {
        const int status = solve(k, s);
        if (status) return status;
        dal_kernel_place(k, s, k->n, k->kept, &k->at);
    }
    if (!(dal_kernel_sum(k->n, k->at.stored) + dal_kernel_sum(k->n, k->at.w) <= DBL_MAX))
        return is_not_finite(k);
    return correct(k, foretold);
}
