/* kernel.h - the step routine of every scheme, for every system with constant mass.
 *
 * A record of sub-steps {beta, fraction} becomes a list of stages.  With q~ and v the state, A, B
 * and the weights those of struct dal_stage, a stage is
 *
 *     q_k = q~ + A h v
 *     M (v' - v) = -h [start V_q(q~) + node V_q(q_k) + end V_q(q~')] + mu(q_k)^T kappa
 *     q~' = q_k + B h v',      mu(q~') v' = 0
 *
 * which is the beta-scheme (DAELd1, DAELd2, Facil) for A = 1-beta, B = beta, and the fused pair
 * (0, a), (1, b) for A = a, B = b: V then enters at the node only, and kappa is the only unknown.
 * lambda = kappa / ((A+B) h).
 *
 * How it is solved.  Newton on (v', kappa) with the Hessian of V dropped needs one m x m matrix
 *     S = (mu(q~') + B h N) M^-1 mu(q_k)^T,      N = d(mu v)/dq,
 * factored once a stage at the predicted velocity; the prediction comes from the multipliers and
 * the gradients of the three stages before.  The iteration stops when an estimate of its next
 * residual is below roundoff, so that most stages evaluate the constraint twice.  At the end the
 * residual of D at the *stored* q~' is predicted from the last evaluation, its rounding included,
 * and mended; where that does not suffice, and in the first two steps after a start, one more
 * evaluation is made.  What does not contract, leaves the domain of a callback or is not finite
 * goes to dal_kernel_solve: the full Newton matrix with the Hessian, and halved steps.
 *
 * One text, many compilations.  The includer defines
 *     DAL_KERNEL                  name of the function to define: int (dal_kernel *, size_t, size_t *)
 *     DAL_N, DAL_M                sizes as constants; or neither, for sizes from the dal_kernel
 *     DAL_KERNEL_CONSTRAINT(k, q, v, mu, N)   and   DAL_KERNEL_POTENTIAL(k, q, V_q)
 *                                 how to call the system; by default through the pointers
 * and includes this file once for each.  All compilations make the same operations in the same
 * order, so they give the same bits (build with -ffp-contract=off).  Nothing here allocates, and
 * nothing here needs libdalembert or GSL. */
#ifndef DALEMBERT_KERNEL_H
#define DALEMBERT_KERNEL_H

#include "dalembert.h"
#include "lu.h"

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

typedef struct dal_stage {
    double before, after;    /* A, B */
    double start, node, end; /* weights of V_q at q~, q_k, q~' */
    double span;             /* A + B */
    double ahead[3];         /* lambda is predicted as ahead[0] l1 + ahead[1] l2 + ahead[2] l3 */
    double ahead_force[3];   /* V_q at q~' likewise from those at the last three ends */
    double rate;             /* 1 / (span h): from impulses to forces */
} dal_stage;

/* What stopped a stage. */
typedef enum dal_failure {
    DAL_FAILED_CONSTRAINT, /* the callback returned nonzero: see returned */
    DAL_FAILED_POTENTIAL,
    DAL_FAILED_FINITE,     /* something is NaN or Inf */
    DAL_FAILED_SINGULAR_S, /* the Schur complement */
    DAL_FAILED_SINGULAR_K, /* M + h^2 B end V_qq */
    DAL_FAILED_SINGULAR_C, /* mu M^-1 mu^T in the final correction */
    DAL_FAILED_CONVERGE
} dal_failure;

typedef struct dal_kernel {
    size_t n, m;
    dal_constraint_fn constraint;
    dal_potential_fn potential; /* NULL: V = 0 */
    void *constraint_ctx, *potential_ctx;
    const double *mass, *mass_inverse; /* [n*n] */
    bool diagonal;
    size_t stages;
    const dal_stage *stage;
    bool kept;    /* kept nodes: the state is (q~ + shift h v, v) */
    double shift; /* 1 - beta */
    int max_iterations;

    double h;
    double *x;             /* [2n] the state */
    double *impulse;       /* [m] sum of kappa since dal_advance began */
    bool multipliers;      /* lambda1, lambda2, lambda3 are known */
    double *lambda1, *lambda2, *lambda3;        /* [m] of the last stages, the latest first */
    bool forces;           /* force0, force2, force3 are known */
    double *force0, *force1, *force2, *force3;  /* [n] V_q at q~, at q~', at the q~ before */
    double contraction;    /* of the modified Newton iteration, by the last measurement */
    int start_up;          /* steps that still take an evaluated correction */

    /* Workspace at fixed addresses, so that callbacks see the same buffers at every call. */
    double *saved;                /* [2n] */
    double *node, *point, *w;     /* [n] q_k, the current q~', the current v' */
    double *base, *step;          /* [n] the explicit part of v', the last change of w */
    double *stored, *moved;       /* [n] see dal_kernel_place */
    double *mu_node, *mu, *N, *Z; /* [m*n] */
    double *S, *scale, *r, *d, *kappa; /* [m*m], [m*m], [m] */
    size_t *row;                       /* [m] */
    double *K, *K_scale, *y, *KZ, *R;  /* [n*n], [n*n], [n], [m*n], [n]: dal_kernel_solve only */
    size_t *K_row;                     /* [n] */

    dal_stats stats;
    struct {
        dal_failure kind;
        int returned, iterations;
        double size, scale;
    } failure;
} dal_kernel;

#define DAL_KERNEL_U (DBL_EPSILON / 2)

static inline int dal_kernel_fail(dal_kernel *k, int status, dal_failure kind)
{
    k->failure.kind = kind;
    return status;
}

static inline int dal_kernel_refused(dal_kernel *k, dal_failure kind, int returned)
{
    k->failure.returned = returned;
    return dal_kernel_fail(k, returned > 0 ? DAL_EDOMAIN : DAL_EUSER, kind);
}

static inline int dal_kernel_constraint(dal_kernel *k, const double *q, const double *v, double *mu,
                                        double *N)
{
    k->stats.constraint_calls++;
    return k->constraint(q, v, NULL, mu, N, k->constraint_ctx);
}

static inline int dal_kernel_potential(dal_kernel *k, const double *q, double *V_q)
{
    k->stats.potential_calls++;
    return k->potential(q, NULL, V_q, NULL, k->potential_ctx);
}

static inline double dal_kernel_sum(size_t n, const double *x)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++) sum += fabs(x[i]);
    return sum;
}

/* y <- M^-1 f. */
static inline void dal_kernel_accelerate(const dal_kernel *k, size_t n, const double *f, double *y)
{
    const double *const inverse = k->mass_inverse;
    if (k->diagonal) {
        for (size_t i = 0; i < n; i++) y[i] = inverse[i * n + i] * f[i];
        return;
    }
    for (size_t i = 0; i < n; i++) {
        double sum = 0.0;
        for (size_t j = 0; j < n; j++) sum += inverse[i * n + j] * f[j];
        y[i] = sum;
    }
}

/* S <- (mu + b N) Z^T, factored. */
static inline int dal_kernel_factor(size_t n, size_t m, const double *mu, const double *N, double b,
                                    const double *Z, double *S, double *scale, size_t *row)
{
    for (size_t a = 0; a < m; a++)
        for (size_t c = 0; c < m; c++) {
            double sum = 0.0, size = 0.0;
            for (size_t i = 0; i < n; i++) {
                const double term = (mu[a * n + i] + b * N[a * n + i]) * Z[c * n + i];
                sum += term;
                size += fabs(term);
            }
            S[a * m + c] = sum;
            scale[a * m + c] = size;
        }
    return dal_lu_factor(m, n, S, scale, row);
}

/* The residual of D at the q~' that the stored state gives back, r <- -(mu w + N moved): mu and N
 * were evaluated at a point that lies moved away.  True if it is within limit for every constraint,
 * relative to sum_i |mu^a_i w_i|; then *worst is kept up to date, and *least is the smallest sum. */
static inline bool dal_kernel_settled(size_t n, size_t m, const double *mu, const double *N,
                                      const double *w, const double *moved, double limit, double *r,
                                      double *least, double *worst)
{
    bool settled = true;
    double largest = *worst, smallest = DBL_MAX;
    for (size_t a = 0; a < m; a++) {
        double sum = 0.0, scale = 0.0;
        for (size_t i = 0; i < n; i++) {
            const double term = mu[a * n + i] * w[i];
            sum += term;
            scale += fabs(term);
        }
        for (size_t i = 0; i < n; i++) sum += N[a * n + i] * moved[i];
        r[a] = -sum;
        if (!(fabs(sum) <= limit * scale)) settled = false;
        if (fabs(sum) > largest * scale) largest = fabs(sum) / scale;
        if (scale < smallest) smallest = scale;
    }
    *least = smallest;
    if (settled) *worst = largest;
    return settled;
}

/* From the node and the new velocity to what is stored; moved is how far the q~' that it gives back
 * lies from the point of the last evaluation.  With kept nodes q_{k+1} = q_k + h v' is stored, and
 * its reader recovers q~' as q_{k+1} - (1-beta) h v'. */
static inline void dal_kernel_place(const dal_kernel *k, const dal_stage *s, size_t n,
                                    const double *node, const double *w, const double *point,
                                    double *stored, double *moved)
{
    if (k->kept) {
        const double h = s->span * k->h, shift = k->shift * k->h;
        for (size_t i = 0; i < n; i++) {
            stored[i] = node[i] + h * w[i];
            moved[i] = (stored[i] - shift * w[i]) - point[i];
        }
    } else {
        const double b = s->after * k->h;
        for (size_t i = 0; i < n; i++) {
            stored[i] = node[i] + b * w[i];
            moved[i] = stored[i] - point[i];
        }
    }
}

/* The state of the predictor, as after a start. */
static inline void dal_kernel_forget(dal_kernel *k)
{
    k->multipliers = false;
    k->forces = false;
    k->contraction = 1.0;
    k->start_up = 2;
    for (size_t a = 0; a < k->m; a++) k->lambda1[a] = k->lambda2[a] = k->lambda3[a] = 0.0;
}

#endif /* DALEMBERT_KERNEL_H */

/* ---- off the hot path, once for a file that compiles a step routine ---------------------- */

#if defined(DAL_KERNEL) && !defined(DALEMBERT_KERNEL_SOLVE)
#define DALEMBERT_KERNEL_SOLVE

/* The final correction v' <- v' - Z' C'^-1 mu(q~') v' at the stored q~', with an evaluation of its
 * own.  Works on k->stored and k->w; k->point is the q~' that belongs to them. */
static int dal_kernel_correct(dal_kernel *k)
{
    enum { MOST = 4 };
    const size_t n = k->n, m = k->m;
    const double limit = 2.0 * (double)n * DAL_KERNEL_U, shift = k->kept ? k->shift * k->h : 0.0;
    memset(k->moved, 0, n * sizeof *k->moved);
    for (int pass = 0; pass < MOST; pass++) {
        bool same = pass > 0;
        for (size_t i = 0; i < n; i++) {
            const double q = k->stored[i] - shift * k->w[i];
            if (q != k->point[i]) same = false;
            k->point[i] = q;
        }
        if (!same) {
            const int returned = dal_kernel_constraint(k, k->point, k->w, k->mu, NULL);
            k->stats.corrections++;
            if (returned) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        }
        double least;
        if (dal_kernel_settled(n, m, k->mu, k->N, k->w, k->moved, limit, k->r, &least,
                               &k->stats.worst_residual))
            return DAL_SUCCESS;
        for (size_t a = 0; a < m; a++) dal_kernel_accelerate(k, n, k->mu + a * n, k->Z + a * n);
        if (!dal_kernel_factor(n, m, k->mu, k->N, 0.0, k->Z, k->S, k->scale, k->row)) {
            if (!(dal_kernel_sum(m * n, k->mu) <= DBL_MAX))
                return dal_kernel_fail(k, DAL_EDOMAIN, DAL_FAILED_FINITE);
            return dal_kernel_fail(k, DAL_ESINGULAR, DAL_FAILED_SINGULAR_C);
        }
        dal_lu_solve(m, k->S, k->row, k->r, k->d);
        for (size_t i = 0; i < n; i++)
            for (size_t a = 0; a < m; a++) k->w[i] += k->Z[a * n + i] * k->d[a];
    }
    return DAL_SUCCESS; /* the last correction is at the level of roundoff; D is checked no further */
}

/* The callbacks at the iterate w of dal_kernel_solve.  Positive: outside their domain or not finite,
 * with the reason in k->failure. */
static int dal_kernel_evaluate(dal_kernel *k, const dal_stage *s)
{
    const size_t n = k->n, m = k->m;
    const double b = s->after * k->h;
    for (size_t i = 0; i < n; i++) k->point[i] = k->node[i] + b * k->w[i];
    double total = 0.0;
    if (m > 0) {
        const int returned = dal_kernel_constraint(k, k->point, k->w, k->mu, k->N);
        if (returned) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        total += dal_kernel_sum(m * n, k->mu) + dal_kernel_sum(m * n, k->N);
    }
    if (k->potential && s->end != 0.0) {
        k->stats.potential_calls++;
        const int returned =
            k->potential(k->point, NULL, k->force1, k->K, k->potential_ctx);
        if (returned) return dal_kernel_refused(k, DAL_FAILED_POTENTIAL, returned);
        total += dal_kernel_sum(n, k->force1) + dal_kernel_sum(n * n, k->K);
    }
    return total <= DBL_MAX ? DAL_SUCCESS : dal_kernel_fail(k, DAL_EDOMAIN, DAL_FAILED_FINITE);
}

/* y <- K^-1 (-R1) and KZ <- the rows K^-1 mu_node^a, with K = M + h B h end V_qq in k->K. */
static int dal_kernel_linearise(dal_kernel *k, const dal_stage *s)
{
    const size_t n = k->n, m = k->m;
    if (!k->potential || s->end == 0.0) { /* K = M */
        for (size_t i = 0; i < n; i++) {
            double sum = k->base[i] - k->w[i];
            for (size_t a = 0; a < m; a++) sum += k->Z[a * n + i] * k->kappa[a];
            k->y[i] = sum;
        }
        memcpy(k->KZ, k->Z, m * n * sizeof *k->KZ);
        return DAL_SUCCESS;
    }
    const double weight = k->h * s->end;
    for (size_t i = 0; i < n; i++) {
        double sum = -weight * k->force1[i];
        for (size_t j = 0; j < n; j++) {
            const double bend = weight * s->after * k->h * k->K[i * n + j];
            sum -= k->mass[i * n + j] * (k->w[j] - k->base[j]);
            k->K[i * n + j] = k->mass[i * n + j] + bend;
            k->K_scale[i * n + j] = fabs(k->mass[i * n + j]) + fabs(bend);
        }
        for (size_t a = 0; a < m; a++) sum += k->mu_node[a * n + i] * k->kappa[a];
        k->R[i] = sum;
    }
    if (!dal_lu_factor(n, 2, k->K, k->K_scale, k->K_row))
        return dal_kernel_fail(k, DAL_ESINGULAR, DAL_FAILED_SINGULAR_K);
    dal_lu_solve(n, k->K, k->K_row, k->R, k->y);
    for (size_t a = 0; a < m; a++)
        dal_lu_solve(n, k->K, k->K_row, k->mu_node + a * n, k->KZ + a * n);
    return DAL_SUCCESS;
}

/* Newton with the full matrix [[K, -mu_node^T], [mu + B h N, 0]] from w = v, kappa = 0; a step that
 * leaves the domain of a callback is halved.  On success w, kappa, mu, N and point are set. */
static int dal_kernel_solve(dal_kernel *k, const dal_stage *s)
{
    enum { HALVINGS = 40 };
    const size_t n = k->n, m = k->m;
    const double b = s->after * k->h;
    double last = HUGE_VAL;
    int halvings = 0;
    if (!(dal_kernel_sum(m * n, k->Z) + dal_kernel_sum(n, k->base) <= DBL_MAX))
        return dal_kernel_fail(k, DAL_EDOMAIN, DAL_FAILED_FINITE);
    k->stats.full_newtons++;
    memcpy(k->w, k->x + n, n * sizeof *k->w);
    memset(k->kappa, 0, m * sizeof *k->kappa);
    for (int iteration = 1; iteration <= k->max_iterations; iteration++) {
        int status;
        while ((status = dal_kernel_evaluate(k, s)) == DAL_EDOMAIN && iteration > 1
               && halvings++ < HALVINGS) {
            for (size_t i = 0; i < n; i++) k->w[i] -= k->step[i] *= 0.5;
            for (size_t a = 0; a < m; a++) k->kappa[a] -= k->d[a] *= 0.5;
            k->stats.halvings++;
        }
        if (status) return status;
        status = dal_kernel_linearise(k, s);
        if (status) return status;
        k->stats.iterations++;
        if (!dal_kernel_factor(n, m, k->mu, k->N, b, k->KZ, k->S, k->scale, k->row))
            return dal_kernel_fail(k, DAL_ESINGULAR, DAL_FAILED_SINGULAR_S);
        for (size_t a = 0; a < m; a++) {
            double sum = 0.0;
            for (size_t i = 0; i < n; i++)
                sum += k->mu[a * n + i] * k->w[i]
                     + (k->mu[a * n + i] + b * k->N[a * n + i]) * k->y[i];
            k->r[a] = -sum;
        }
        dal_lu_solve(m, k->S, k->row, k->r, k->d);
        for (size_t i = 0; i < n; i++) {
            double step = k->y[i];
            for (size_t a = 0; a < m; a++) step += k->KZ[a * n + i] * k->d[a];
            k->step[i] = step;
            k->w[i] += step;
        }
        for (size_t a = 0; a < m; a++) k->kappa[a] += k->d[a];
        const double size = dal_kernel_sum(n, k->step);
        const double scale = dal_kernel_sum(n, k->w) + dal_kernel_sum(n, k->x + n)
                           + dal_kernel_sum(n, k->base);
        k->failure.iterations = iteration;
        k->failure.size = size;
        k->failure.scale = scale;
        if (!(size <= DBL_MAX)) break;
        if (size <= 4.0 * DAL_KERNEL_U * scale) return DAL_SUCCESS;
        if (iteration >= 2 && size <= 1e-11 * scale && size >= last) return DAL_SUCCESS;
        last = size;
    }
    return dal_kernel_fail(k, DAL_ENOCONV, DAL_FAILED_CONVERGE);
}

#endif /* DALEMBERT_KERNEL_SOLVE */

/* ---- the hot path, once for each inclusion ---------------------------------------------- */

#ifdef DAL_KERNEL

#ifndef DAL_KERNEL_CONSTRAINT
#define DAL_KERNEL_CONSTRAINT(k, q, v, mu, N) dal_kernel_constraint(k, q, v, mu, N)
#define DAL_KERNEL_POTENTIAL(k, q, V_q) dal_kernel_potential(k, q, V_q)
#endif

#define DAL_KERNEL_JOIN_(a, b) a##b
#define DAL_KERNEL_JOIN(a, b) DAL_KERNEL_JOIN_(a, b)
#define DAL_KERNEL_STAGE DAL_KERNEL_JOIN(DAL_KERNEL, _stage)

static inline int DAL_KERNEL_STAGE(dal_kernel *const k, const dal_stage *const s)
{
#ifdef DAL_N
    const size_t n = DAL_N, m = DAL_M;
#else
    const size_t n = k->n, m = k->m;
#endif
    const double h = k->h, b = s->after * h;
    const double limit = 2.0 * (double)n * DAL_KERNEL_U;
    const bool linear = b == 0.0;                             /* mu(q~') is mu(q_k) */
    const bool ends = k->potential && s->end != 0.0;          /* V_q at the unknown q~' */
    const double *const q = k->x, *const v = k->x + n;
    double *const node = k->node, *const w = k->w, *const base = k->base, *const step = k->step;
    double *const Z = k->Z, *const N = k->N, *const kappa = k->kappa;
    double *const point = linear ? node : k->point;
    double *const mu = linear ? k->mu_node : k->mu;

    k->stats.substeps++;
    for (size_t i = 0; i < n; i++) node[i] = k->kept ? q[i] : q[i] + s->before * h * v[i];
    if (m > 0) {
        const int returned =
            DAL_KERNEL_CONSTRAINT(k, node, v, k->mu_node, linear && k->kept ? N : NULL);
        if (returned) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        if (linear && !k->kept) memset(N, 0, m * n * sizeof *N); /* nothing moves */
        for (size_t a = 0; a < m; a++)
            dal_kernel_accelerate(k, n, k->mu_node + a * n, Z + a * n);
    }

    /* The part of v' that is known, and its prediction. */
    for (size_t i = 0; i < n; i++) base[i] = v[i];
    if (k->potential) {
        double *const force = s->node != 0.0 ? k->force1 : k->force0;
        if (s->node != 0.0 || !k->forces) {
            const double *at = node;
            if (s->node == 0.0) { /* q~ itself */
                const double shift = k->kept ? k->shift * h : 0.0;
                for (size_t i = 0; i < n; i++) k->point[i] = q[i] - shift * v[i];
                at = k->point;
            }
            const int returned = DAL_KERNEL_POTENTIAL(k, at, force);
            if (returned) return dal_kernel_refused(k, DAL_FAILED_POTENTIAL, returned);
        }
        dal_kernel_accelerate(k, n, force, step);
        const double weight = s->node != 0.0 ? s->node : s->start;
        for (size_t i = 0; i < n; i++) base[i] -= h * weight * step[i];
    }
    for (size_t a = 0; a < m; a++)
        kappa[a] = s->span * h * (s->ahead[0] * k->lambda1[a] + s->ahead[1] * k->lambda2[a]
                                  + s->ahead[2] * k->lambda3[a]);
    for (size_t i = 0; i < n; i++) {
        double sum = base[i];
        for (size_t a = 0; a < m; a++) sum += Z[a * n + i] * kappa[a];
        w[i] = sum;
    }
    if (ends) {
        if (!k->forces) { /* nothing to extrapolate yet */
            memcpy(k->force2, k->force0, n * sizeof *k->force2);
            memcpy(k->force3, k->force0, n * sizeof *k->force3);
        }
        for (size_t i = 0; i < n; i++)
            k->force1[i] = s->ahead_force[0] * k->force0[i] + s->ahead_force[1] * k->force2[i]
                         + s->ahead_force[2] * k->force3[i];
        dal_kernel_accelerate(k, n, k->force1, step);
        for (size_t i = 0; i < n; i++) w[i] -= h * s->end * step[i];
    }
    const double known = dal_kernel_sum(n, v) + dal_kernel_sum(n, base);

    /* Newton on (v', kappa), Hessian dropped, S frozen. */
    double last = HUGE_VAL, travelled = 0.0, bend = 0.0, least = 0.0;
    bool solved = false, placed = false, settled = false;
    for (int iteration = 1; !solved; iteration++) {
        int returned = 0;
        if (!linear) {
            for (size_t i = 0; i < n; i++) point[i] = node[i] + b * w[i];
            if (m > 0) returned = DAL_KERNEL_CONSTRAINT(k, point, w, mu, iteration == 1 ? N : NULL);
            if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        }
        if (ends && returned == 0) {
            returned = DAL_KERNEL_POTENTIAL(k, point, k->force1);
            if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_POTENTIAL, returned);
        }
        if (returned > 0) break;
        if (iteration == 1) {
            if (!dal_kernel_factor(n, m, mu, N, b, Z, k->S, k->scale, k->row)) break;
            bend = 10.0 * fabs(b) * dal_kernel_sum(m * n, N);
        }
        k->stats.iterations++;

        if (ends) {
            dal_kernel_accelerate(k, n, k->force1, step);
            for (size_t i = 0; i < n; i++) {
                double sum = base[i] - h * s->end * step[i] - w[i];
                for (size_t a = 0; a < m; a++) sum += Z[a * n + i] * kappa[a];
                step[i] = sum;
            }
        } else {
            for (size_t i = 0; i < n; i++) step[i] = 0.0;
        }
        for (size_t a = 0; a < m; a++) {
            double sum = 0.0;
            for (size_t i = 0; i < n; i++)
                sum += mu[a * n + i] * w[i] + (mu[a * n + i] + b * N[a * n + i]) * step[i];
            k->r[a] = -sum;
        }
        dal_lu_solve(m, k->S, k->row, k->r, k->d);
        for (size_t a = 0; a < m; a++) kappa[a] += k->d[a];
        for (size_t i = 0; i < n; i++) {
            double sum = step[i];
            for (size_t a = 0; a < m; a++) sum += Z[a * n + i] * k->d[a];
            step[i] = sum;
            w[i] += sum;
        }

        const double size = dal_kernel_sum(n, step), scale = known + dal_kernel_sum(n, w);
        const double noise = 4.0 * DAL_KERNEL_U * scale;
        if (!(size <= DBL_MAX)) break;
        travelled += size;
        placed = false;
        if (ends && iteration >= 2) k->contraction = 4.0 * (size > noise ? size : noise) / last;
        if (size <= noise || (iteration >= 2 && size <= 1e-11 * scale && size >= last)) {
            solved = true;
        } else if (!ends || k->contraction * size <= noise) {
            /* what is left of the residual after this step, at most */
            const double doubt = bend * travelled * size;
            dal_kernel_place(k, s, n, node, w, point, k->stored, k->moved);
            settled = dal_kernel_settled(n, m, mu, N, w, k->moved, limit, k->r, &least,
                                         &k->stats.worst_residual);
            placed = true;
            solved = doubt <= limit * least * scale;
        }
        if (!solved && (iteration >= 10 || (iteration >= 3 && size > 0.5 * last))) break;
        if (solved && ends && iteration == 1) k->contraction *= 2.0; /* measure again some day */
        last = size;
    }
    if (!solved) {
        const int status = dal_kernel_solve(k, s);
        if (status) return status;
        settled = false;
    }

    /* The residual of D at what is stored. */
    if (!placed || !solved) dal_kernel_place(k, s, n, node, w, point, k->stored, k->moved);
    if (m > 0) {
        if (solved && !placed)
            settled = dal_kernel_settled(n, m, mu, N, w, k->moved, limit, k->r, &least,
                                         &k->stats.worst_residual);
        if (solved && !settled) {
            dal_lu_solve(m, k->S, k->row, k->r, k->d);
            for (size_t i = 0; i < n; i++)
                for (size_t a = 0; a < m; a++) w[i] += Z[a * n + i] * k->d[a];
            for (size_t i = 0; k->kept && i < n; i++)
                k->moved[i] = (k->stored[i] - k->shift * h * w[i]) - point[i];
            settled = dal_kernel_settled(n, m, mu, N, w, k->moved, limit, k->r, &least,
                                         &k->stats.worst_residual);
        }
        if (!settled || k->start_up > 0) {
            const int status = dal_kernel_correct(k);
            if (status) return status;
        }
    }
    double zero = 0.0; /* NaN if any number of the new state is not finite */
    for (size_t i = 0; i < n; i++) zero += k->stored[i] * 0.0 + w[i] * 0.0;
    if (zero != 0.0) return dal_kernel_fail(k, DAL_EDOMAIN, DAL_FAILED_FINITE);

    for (size_t i = 0; i < n; i++) {
        k->x[i] = k->stored[i];
        k->x[n + i] = w[i];
    }
    double *const lambda = k->lambda3;
    k->lambda3 = k->lambda2;
    k->lambda2 = k->lambda1;
    k->lambda1 = lambda;
    for (size_t a = 0; a < m; a++) {
        k->impulse[a] += kappa[a];
        lambda[a] = kappa[a] * s->rate;
    }
    if (!k->multipliers) {
        memcpy(k->lambda2, lambda, m * sizeof *lambda);
        memcpy(k->lambda3, lambda, m * sizeof *lambda);
        k->multipliers = true;
    }
    if (ends) {
        double *const force = k->force3;
        k->force3 = k->force2;
        k->force2 = k->force0;
        k->force0 = k->force1;
        k->force1 = force;
    }
    k->forces = ends;
    return DAL_SUCCESS;
}

/* steps steps of k.  *done <- how many were made; on failure the state is that after the last. */
static int DAL_KERNEL(dal_kernel *k, size_t steps, size_t *done)
{
    for (*done = 0; *done < steps; ++*done) {
        if (k->stages > 1) memcpy(k->saved, k->x, 2 * k->n * sizeof *k->x);
        for (size_t j = 0; j < k->stages; j++) {
            const int status = DAL_KERNEL_STAGE(k, k->stage + j);
            if (status) {
                if (k->stages > 1) {
                    memcpy(k->x, k->saved, 2 * k->n * sizeof *k->x);
                    dal_kernel_forget(k);
                }
                return status;
            }
        }
        if (k->start_up > 0) k->start_up--;
        k->stats.steps++;
    }
    return DAL_SUCCESS;
}

#undef DAL_KERNEL_STAGE
#undef DAL_KERNEL_JOIN
#undef DAL_KERNEL_JOIN_
#undef DAL_KERNEL_CONSTRAINT
#undef DAL_KERNEL_POTENTIAL
#undef DAL_KERNEL
#undef DAL_N
#undef DAL_M
#endif /* DAL_KERNEL */
