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
 * factored once a stage at the predicted velocity.  What is predicted is the pull, the part of
 * v' - v that is not known in advance (M^-1 mu^T kappa, and V_q where it acts at q~'), from those
 * of the three stages before; so the two evaluations of the constraint do not wait for each other.
 * The iteration stops when an estimate of its next residual is below roundoff, so that most stages
 * evaluate the constraint twice.  At the end the residual of D at the *stored* q~' is predicted
 * from the last evaluation, the rounding of q~' included, and mended; where that does not suffice,
 * in the first two steps after a start, and in every 64th step, one more evaluation is made.  What
 * does not contract, leaves the domain of a callback or is not finite goes to dal_kernel_solve: the
 * full Newton matrix with the Hessian, and halved steps.
 *
 * One text, many compilations.  The includer defines
 *     DAL_KERNEL                  name of the function: int (dal_kernel *, size_t, size_t *)
 *     DAL_N, DAL_M                sizes as constants; or neither, for sizes from the dal_kernel
 *     DAL_KERNEL_CONSTRAINT(k, q, v, mu, N)   and   DAL_KERNEL_POTENTIAL(k, q, V_q)
 *                                 how to call the system, the second only where there is a V; the
 *                                 routine then makes the steps of moved nodes only.  By default the
 *                                 pointers are called
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
    double reuse;            /* largest weight of V_q(q~'), here or as start of the next stage */
    double ahead[3];         /* the pull is predicted as ahead[0] p1 + ahead[1] p2 + ahead[2] p3 */
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

/* Everything down to max_iterations, the arrays, h and x are set by the owner, who then calls
 * dal_kernel_forget; the rest belongs to the step routine. */
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
    double *impulse;       /* [m] sum of kappa since dal_advance began */
    double extent;         /* sum |v_i| */
    bool pulled;           /* the history of pulls is known */
    bool forced;           /* force0 is known */
    double *force0, *force1;        /* [n] V_q at q~ and at q~' */
    double contraction;    /* of the modified Newton iteration over B end, as last measured */
    size_t age;            /* steps since the start, or since a failure */
    bool audited;          /* this step evaluates the residual that others predict */
    double trust;          /* relative residual that may be left; 0 in the first steps */
    bool distrusted;       /* a prediction was wrong: from now on every step does */

    /* One block, laid out by dal_kernel_share: the step routine reaches its parts by constant
     * offsets, and callbacks see the same addresses at every call. */
    double *x;                    /* [2n] the state */
    double *node, *point, *w;     /* [n] q_k, the current q~', the current v' */
    double *pull;                 /* [3n] the pulls of the last stages, the latest first */
    double *mu_node, *mu, *N;     /* [m*n] */

    double *saved;                /* [2n] */
    double *base, *goal, *step;   /* [n] the known part of v', all of it but Z^T kappa, w' - w */
    double *stored, *moved;       /* [n] see dal_kernel_place */
    double *Z;                    /* [m*n] */
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
enum { DAL_KERNEL_START_UP = 2, DAL_KERNEL_AUDIT = 64 }; /* steps at first, and between audits */

#if defined(__GNUC__)
#define DAL_KERNEL_INLINE static inline __attribute__((always_inline))
#define DAL_KERNEL_COLD static __attribute__((cold, noinline)) /* saves a third of compiling */
#else
#define DAL_KERNEL_INLINE static inline
#define DAL_KERNEL_COLD static
#endif

static inline size_t dal_kernel_shared(size_t n, size_t m) { return 8 * n + 3 * m * n; }

/* Lays x ... N out in block[dal_kernel_shared(n, m)]. */
static inline void dal_kernel_share(dal_kernel *k, double *block)
{
    const size_t n = k->n, m = k->m;
    k->x = block;
    k->node = block + 2 * n;
    k->point = block + 3 * n;
    k->w = block + 4 * n;
    k->pull = block + 5 * n;
    k->mu_node = block + 8 * n;
    k->mu = k->mu_node + m * n;
    k->N = k->mu + m * n;
}

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

/* memcpy would want arrays of the stack in memory, and not in registers. */
DAL_KERNEL_INLINE void dal_kernel_copy(size_t n, const double *from, double *to)
{
    for (size_t i = 0; i < n; i++) to[i] = from[i];
}

/* Sums begin with their first term: 0.0 + x costs an addition, and it is on the critical path. */
DAL_KERNEL_INLINE double dal_kernel_sum(size_t n, const double *x)
{
    double sum = n > 0 ? fabs(x[0]) : 0.0;
    for (size_t i = 1; i < n; i++) sum += fabs(x[i]);
    return sum;
}

DAL_KERNEL_INLINE double dal_kernel_dot(size_t n, const double *a, const double *b)
{
    double sum = a[0] * b[0];
    for (size_t i = 1; i < n; i++) sum += a[i] * b[i];
    return sum;
}

/* Component i of Z^T c, for m > 0. */
DAL_KERNEL_INLINE double dal_kernel_column(size_t n, size_t m, const double *Z, size_t i,
                                       const double *c)
{
    double sum = Z[i] * c[0];
    for (size_t a = 1; a < m; a++) sum += Z[a * n + i] * c[a];
    return sum;
}

/* y <- M^-1 f. */
DAL_KERNEL_INLINE void dal_kernel_accelerate(const dal_kernel *k, size_t n, const double *f,
                                             double *y)
{
    const double *const inverse = k->mass_inverse;
    if (k->diagonal) {
        for (size_t i = 0; i < n; i++) y[i] = inverse[i * n + i] * f[i];
        return;
    }
    for (size_t i = 0; i < n; i++) y[i] = dal_kernel_dot(n, inverse + i * n, f);
}

/* S <- (mu + b N) Z^T, factored. */
DAL_KERNEL_INLINE int dal_kernel_factor(size_t n, size_t m, const double *mu, const double *N,
                                        double b, const double *Z, double *S, double *scale,
                                        size_t *row)
{
    for (size_t a = 0; a < m; a++)
        for (size_t c = 0; c < m; c++) {
            double sum = (mu[a * n] + b * N[a * n]) * Z[c * n], size = fabs(sum);
            for (size_t i = 1; i < n; i++) {
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
 * relative to sum_i |mu^a_i w_i|; then *worst is kept up to date, and *least is the smallest sum.
 * Never true if a component of mu, w or moved is not finite: 0 times it is NaN. */
DAL_KERNEL_INLINE bool dal_kernel_settled(size_t n, size_t m, const double *mu, const double *N,
                                      const double *w, const double *moved, double limit, double *r,
                                      double *least, double *worst)
{
    bool settled = true;
    double largest = *worst, smallest = DBL_MAX;
    for (size_t a = 0; a < m; a++) {
        double sum = mu[a * n] * w[0], scale = fabs(sum);
        for (size_t i = 1; i < n; i++) {
            const double term = mu[a * n + i] * w[i];
            sum += term;
            scale += fabs(term);
        }
        sum += dal_kernel_dot(n, N + a * n, moved);
        r[a] = -sum;
        if (!(limit * scale - fabs(sum) >= 0.0)) settled = false; /* nor if both are infinite */
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
DAL_KERNEL_INLINE void dal_kernel_place(const dal_kernel *k, const dal_stage *s, size_t n,
                                        bool kept, const double *node, const double *w,
                                        const double *point, double *stored, double *moved)
{
    if (kept) {
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
    k->pulled = false;
    k->forced = false;
    k->contraction = HUGE_VAL;
    k->age = 0;
    k->distrusted = false;
    memset(k->pull, 0, 3 * k->n * sizeof *k->pull);
    k->extent = dal_kernel_sum(k->n, k->x + k->n);
}

#endif /* DALEMBERT_KERNEL_H */

/* ---- off the hot path, once for a file that compiles a step routine ---------------------- */

#if defined(DAL_KERNEL) && !defined(DALEMBERT_KERNEL_SOLVE)
#define DALEMBERT_KERNEL_SOLVE

/* The final correction v' <- v' - Z' C'^-1 mu(q~') v' at the stored q~', with an evaluation of its
 * own.  Works on k->stored and k->w; k->point is the q~' that belongs to them.  foretold: the
 * residual was predicted to be within limit.  Where it is far from it, mu has a roundoff that no
 * prediction knows of, as sin(a + b) has for large angles, and they are no longer relied on. */
DAL_KERNEL_COLD int dal_kernel_correct(dal_kernel *k, bool foretold)
{
    enum { MOST = 4 };
    const size_t n = k->n, m = k->m;
    const double limit = 2.0 * (double)n * DAL_KERNEL_U, shift = k->kept ? k->shift * k->h : 0.0;
    if (!(dal_kernel_sum(n, k->stored) + dal_kernel_sum(n, k->w) <= DBL_MAX))
        return dal_kernel_fail(k, DAL_EDOMAIN, DAL_FAILED_FINITE);
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
        double least, unused = 0.0;
        const bool last = pass == MOST - 1; /* what is left then is roundoff, and is reported */
        if (dal_kernel_settled(n, m, k->mu, k->N, k->w, k->moved, last ? DBL_MAX : limit, k->r,
                               &least, &k->stats.worst_residual))
            break;
        if (foretold && pass == 0
            && !dal_kernel_settled(n, m, k->mu, k->N, k->w, k->moved, 1.5 * limit, k->r, &least,
                                   &unused))
            k->distrusted = true;
        for (size_t a = 0; a < m; a++) dal_kernel_accelerate(k, n, k->mu + a * n, k->Z + a * n);
        if (!dal_kernel_factor(n, m, k->mu, k->N, 0.0, k->Z, k->S, k->scale, k->row)) {
            if (!(dal_kernel_sum(m * n, k->mu) <= DBL_MAX))
                return dal_kernel_fail(k, DAL_EDOMAIN, DAL_FAILED_FINITE);
            return dal_kernel_fail(k, DAL_ESINGULAR, DAL_FAILED_SINGULAR_C);
        }
        dal_lu_solve(m, k->S, k->row, k->r, k->d);
        for (size_t i = 0; i < n; i++) {
            k->w[i] += dal_kernel_column(n, m, k->Z, i, k->d);
            /* q~' is not changed: a kept node moves with v', and gives back the same q~' */
            if (k->kept) k->stored[i] = k->point[i] + shift * k->w[i];
        }
    }
    return dal_kernel_sum(n, k->w) + dal_kernel_sum(n, k->stored) <= DBL_MAX
               ? DAL_SUCCESS
               : dal_kernel_fail(k, DAL_EDOMAIN, DAL_FAILED_FINITE);
}

/* The callbacks at the iterate w of dal_kernel_solve.  DAL_EDOMAIN: outside their domain or not
 * finite; the reason is in k->failure. */
DAL_KERNEL_COLD int dal_kernel_evaluate(dal_kernel *k, const dal_stage *s)
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
DAL_KERNEL_COLD int dal_kernel_linearise(dal_kernel *k, const dal_stage *s)
{
    const size_t n = k->n, m = k->m;
    if (!k->potential || s->end == 0.0) { /* K = M */
        for (size_t i = 0; i < n; i++) {
            k->y[i] = k->base[i] - k->w[i];
            if (m > 0) k->y[i] += dal_kernel_column(n, m, k->Z, i, k->kappa);
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
        if (m > 0) sum += dal_kernel_column(n, m, k->mu_node, i, k->kappa);
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
DAL_KERNEL_COLD int dal_kernel_solve(dal_kernel *k, const dal_stage *s)
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
            k->step[i] = k->y[i];
            if (m > 0) k->step[i] += dal_kernel_column(n, m, k->KZ, i, k->d);
            k->w[i] += k->step[i];
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
        /* far from the origin mu moves by more than that with one rounding of q */
        const double floor = 1e-11 + 16.0 * DAL_KERNEL_U * dal_kernel_sum(n, k->point);
        if (iteration >= 2 && size <= floor * scale && size >= last) return DAL_SUCCESS;
        last = size;
    }
    return dal_kernel_fail(k, DAL_ENOCONV, DAL_FAILED_CONVERGE);
}

#endif /* DALEMBERT_KERNEL_SOLVE */

/* ---- the hot path, once for each inclusion ---------------------------------------------- */

#ifdef DAL_KERNEL

#ifdef DAL_KERNEL_CONSTRAINT
#define DAL_KERNEL_INSIDE 1
#ifdef DAL_KERNEL_POTENTIAL
#define DAL_KERNEL_PULLED true
#else
#define DAL_KERNEL_PULLED false
#define DAL_KERNEL_POTENTIAL(k, q, V_q) 0
#endif
#else
#define DAL_KERNEL_INSIDE 0
#define DAL_KERNEL_PULLED ((k)->potential != NULL)
#define DAL_KERNEL_CONSTRAINT(k, q, v, mu, N) dal_kernel_constraint(k, q, v, mu, N)
#define DAL_KERNEL_POTENTIAL(k, q, V_q) dal_kernel_potential(k, q, V_q)
#endif

#define DAL_KERNEL_JOIN_(a, b) a##b
#define DAL_KERNEL_JOIN(a, b) DAL_KERNEL_JOIN_(a, b)
#define DAL_KERNEL_STAGE DAL_KERNEL_JOIN(DAL_KERNEL, _stage)

/* Arrays that no callback sees: on the stack, for the registers, where sizes are constants. */
#ifdef DAL_N
#define DAL_KERNEL_M (DAL_M > 0 ? DAL_M : 1)
#define DAL_KERNEL_ARRAY(type, name, size) type name[size]
#else
#define DAL_KERNEL_M 0
#define DAL_KERNEL_ARRAY(type, name, size) type *const name = k->name
#endif

/* plain is a constant where this is inlined: V = 0 and moved nodes, so that what serves only the
 * others costs nothing. */
DAL_KERNEL_INLINE int DAL_KERNEL_STAGE(dal_kernel *const k, const dal_stage *const s,
                                       const bool plain)
{
#ifdef DAL_N
    const size_t n = DAL_N, m = DAL_M;
#else
    const size_t n = k->n, m = k->m;
#endif
    DAL_KERNEL_ARRAY(double, base, DAL_N);
    DAL_KERNEL_ARRAY(double, goal, DAL_N);
    DAL_KERNEL_ARRAY(double, step, DAL_N);
    DAL_KERNEL_ARRAY(double, stored, DAL_N);
    DAL_KERNEL_ARRAY(double, moved, DAL_N);
    DAL_KERNEL_ARRAY(double, Z, DAL_KERNEL_M * DAL_N);
    DAL_KERNEL_ARRAY(double, S, DAL_KERNEL_M * DAL_KERNEL_M);
    DAL_KERNEL_ARRAY(double, scale, DAL_KERNEL_M * DAL_KERNEL_M);
    DAL_KERNEL_ARRAY(size_t, row, DAL_KERNEL_M);
    DAL_KERNEL_ARRAY(double, r, DAL_KERNEL_M);
    DAL_KERNEL_ARRAY(double, d, DAL_KERNEL_M);
    DAL_KERNEL_ARRAY(double, kappa, DAL_KERNEL_M);
    const double h = k->h, b = s->after * h;
    const double limit = 2.0 * (double)n * DAL_KERNEL_U;
    const bool linear = b == 0.0;                    /* mu(q~') is mu(q_k) */
    const bool kept = !plain && !DAL_KERNEL_INSIDE && k->kept;
    const bool potential = !plain && DAL_KERNEL_PULLED;
    const bool ends = potential && s->end != 0.0;    /* V_q at the unknown q~' */
    double *const x = k->x; /* the others as dal_kernel_share laid them out */
    double *const node = x + 2 * n, *const w = x + 4 * n, *const pull = x + 5 * n;
    double *const mu_node = x + 8 * n, *const N = mu_node + 2 * m * n;
    double *const point = linear ? node : x + 3 * n;
    double *const mu = linear ? mu_node : mu_node + m * n;

    const double before = kept ? 0.0 : s->before * h; /* a kept node is the state */
    for (size_t i = 0; i < n; i++) node[i] = x[i] + before * x[n + i];
    /* The part of v' that is known, and its prediction. */
    double known = k->extent; /* the scale that roundoff has, together with the new velocity */
    for (size_t i = 0; i < n; i++) base[i] = x[n + i];
    if (potential) {
        double *const force = s->node != 0.0 ? k->force1 : k->force0;
        if (s->node != 0.0 || !k->forced) {
            double *const start = s->node != 0.0 ? node : x + 3 * n; /* q~, where q~' will be */
            const double shift = kept ? k->shift * h : 0.0;
            for (size_t i = 0; s->node == 0.0 && i < n; i++) start[i] = x[i] - shift * x[n + i];
            const int returned = DAL_KERNEL_POTENTIAL(k, start, force);
            if (returned) return dal_kernel_refused(k, DAL_FAILED_POTENTIAL, returned);
        }
        const double weight = h * (s->node != 0.0 ? s->node : s->start);
        dal_kernel_accelerate(k, n, force, step);
        for (size_t i = 0; i < n; i++) base[i] -= weight * step[i];
        known += dal_kernel_sum(n, base);
    }
    /* The latest pull enters last, and q~' does not wait for v': this is the critical path. */
    for (size_t i = 0; i < n; i++) {
        const double early = base[i] + (s->ahead[1] * pull[n + i] + s->ahead[2] * pull[2 * n + i]);
        w[i] = early + s->ahead[0] * pull[i];
        if (!linear) point[i] = (node[i] + b * early) + b * s->ahead[0] * pull[i];
    }

    /* mu at the prediction, and then at the node: more has to wait for the first. */
    int predicted = 0; /* what the callback returned there */
    if (linear) {
        if (m > 0) memset(N, 0, m * n * sizeof *N); /* nothing depends on v' */
    } else {
        if (m > 0) predicted = DAL_KERNEL_CONSTRAINT(k, point, w, mu, N);
        if (predicted < 0) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, predicted);
    }
    if (m > 0) {
        const int returned = DAL_KERNEL_CONSTRAINT(k, node, x + n, mu_node, NULL);
        if (returned) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        for (size_t a = 0; a < m; a++) dal_kernel_accelerate(k, n, mu_node + a * n, Z + a * n);
    }
    for (size_t a = 0; a < m; a++) kappa[a] = 0.0;

    /* Newton on (v', kappa), Hessian dropped, S frozen. */
    const double bending = fabs(s->after * s->end), lasting = fabs(s->after) * s->reuse;
    double last = HUGE_VAL, travelled = 0.0, reached = 0.0, bend = 0.0, least = 0.0;
    bool solved = false, settled = false;
    for (int iteration = 1; !solved; iteration++) {
        int returned = iteration == 1 ? predicted : 0;
        if (!linear && iteration > 1) {
            for (size_t i = 0; i < n; i++) point[i] = node[i] + b * w[i];
            if (m > 0) returned = DAL_KERNEL_CONSTRAINT(k, point, w, mu, iteration == 2 ? N : NULL);
            if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
        }
        if (ends && returned == 0) {
            returned = DAL_KERNEL_POTENTIAL(k, point, k->force1);
            if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_POTENTIAL, returned);
        }
        if (returned > 0) break;
        if (iteration == 1) {
            if (!dal_kernel_factor(n, m, mu, N, b, Z, S, scale, row)) break;
            bend = 10.0 * fabs(b) * dal_kernel_sum(m * n, N);
        }
        k->stats.iterations++;

        /* The first equation is v' = goal + Z^T kappa; (mu + b N) step = -mu w is the second. */
        if (ends) dal_kernel_accelerate(k, n, k->force1, goal);
        for (size_t i = 0; i < n; i++) {
            goal[i] = ends ? base[i] - h * s->end * goal[i] : base[i];
            step[i] = goal[i] - w[i];
        }
        if (iteration > 1 && m > 0)
            for (size_t i = 0; i < n; i++) step[i] += dal_kernel_column(n, m, Z, i, kappa);
        for (size_t a = 0; a < m; a++) {
            double sum = mu[a * n] * w[0] + (mu[a * n] + b * N[a * n]) * step[0];
            for (size_t i = 1; i < n; i++)
                sum += mu[a * n + i] * w[i] + (mu[a * n + i] + b * N[a * n + i]) * step[i];
            r[a] = -sum;
        }
        dal_lu_solve(m, S, row, r, d);
        for (size_t a = 0; a < m; a++) /* 0 + d would be waited for */
            kappa[a] = iteration > 1 ? kappa[a] + d[a] : d[a];
        for (size_t i = 0; i < n; i++) {
            const double next = m > 0 ? goal[i] + dal_kernel_column(n, m, Z, i, kappa) : goal[i];
            step[i] = next - w[i];
            w[i] = next;
        }

        const double size = dal_kernel_sum(n, step);
        reached = dal_kernel_sum(n, w);
        const double extent = known + reached;
        const double noise = 4.0 * DAL_KERNEL_U * extent;
        if (!(size <= DBL_MAX)) break;
        travelled += size;
        if (ends && iteration > 1) /* it goes as h^2 B end V_qq; 4 is for safety */
            k->contraction = 4.0 * (size > noise ? size : noise) / (last * bending);
        /* with V_q at q~' it may be the iteration that does not contract, not roundoff */
        const bool stuck = !ends && iteration > 1 && size <= 1e-11 * extent && size >= last;
        const bool close = (size <= noise) | stuck; /* no branches: they could not be foretold */
        /* What is left of the first equation, here or in the next stage, has one sign from step to
         * step and adds up in the energy: it has to be a small part of a rounding. */
        if (close || !ends || 64.0 * k->contraction * lasting * size <= noise) {
            dal_kernel_place(k, s, n, kept, node, w, point, stored, moved);
            settled = dal_kernel_settled(n, m, mu, N, w, moved, limit, r, &least,
                                         &k->stats.worst_residual);
            /* bend travelled size / reached: what is left of the residual after this step, at most.
             * N knows how mu bends only if the prediction is near: not where it moved as much as it
             * is large, not in the first steps, whose pull is unknown, and not where N is 0. */
            solved = close | (bend * travelled * size < k->trust * least * (reached - 2.0 * size));
        }
        if (!solved && (iteration >= 10 || (iteration >= 3 && size > 0.5 * last))) break;
        if (solved && ends && iteration == 1) k->contraction *= 2.0; /* measure again some day */
        last = size;
    }
    if (!solved) {
        dal_kernel_copy(n, base, k->base);
        dal_kernel_copy(m * n, Z, k->Z);
        const int status = dal_kernel_solve(k, s);
        if (status) return status;
        dal_kernel_copy(m, k->kappa, kappa);
        reached = dal_kernel_sum(n, w);
        dal_kernel_place(k, s, n, kept, node, w, point, stored, moved);
        settled = false;
    }

    /* The residual of D at what is stored. */
    if (m > 0) {
        if (solved && !settled) {
            dal_lu_solve(m, S, row, r, d);
            for (size_t i = 0; i < n; i++) w[i] += dal_kernel_column(n, m, Z, i, d);
            for (size_t i = 0; kept && i < n; i++)
                moved[i] = (stored[i] - k->shift * h * w[i]) - point[i];
            settled = dal_kernel_settled(n, m, mu, N, w, moved, limit, r, &least,
                                         &k->stats.worst_residual);
        }
        /* The prediction of the residual is as good as N, which belongs to an earlier w: not at
         * all where the velocity passes through zero, or where N was not asked for. */
        const bool doubtful = reached < 1e-3 * known || (linear && kept);
        if (!settled || doubtful || k->audited) {
            dal_kernel_copy(n, stored, k->stored);
            const int status = dal_kernel_correct(k, settled && !doubtful);
            if (status) return status;
            dal_kernel_copy(n, k->stored, stored);
        }
    }
    if (m == 0 && !(dal_kernel_sum(n, stored) <= DBL_MAX)) /* else that has been seen to */
        return dal_kernel_fail(k, DAL_EDOMAIN, DAL_FAILED_FINITE);

    for (size_t i = 0; i < n; i++) {
        pull[2 * n + i] = pull[n + i];
        pull[n + i] = pull[i];
        pull[i] = w[i] - base[i];
        x[i] = stored[i];
        x[n + i] = w[i];
    }
    k->extent = reached;
    for (size_t a = 0; a < m; a++) k->impulse[a] += kappa[a];
    if (!k->pulled) { /* the best guess of the past */
        memcpy(pull + n, pull, n * sizeof *pull);
        memcpy(pull + 2 * n, pull, n * sizeof *pull);
        k->pulled = true;
    }
    if (ends) {
        double *const force = k->force0;
        k->force0 = k->force1;
        k->force1 = force;
    }
    k->forced = ends && solved; /* dal_kernel_solve may stop 1e-11 away */
    return DAL_SUCCESS;
}

/* steps steps of k.  *done <- how many were made; on failure the state is that after the last. */
static int DAL_KERNEL(dal_kernel *k, size_t steps, size_t *done)
{
    int status = DAL_SUCCESS;
    size_t made = 0;
    for (; made < steps; made++) {
        const bool fresh = k->age < DAL_KERNEL_START_UP;
        k->trust = fresh ? 0.0 : 2.0 * (double)k->n * DAL_KERNEL_U;
        k->audited = fresh || k->distrusted || k->age % DAL_KERNEL_AUDIT == 0;
        if (k->stages > 1) memcpy(k->saved, k->x, 2 * k->n * sizeof *k->x);
#if DAL_KERNEL_INSIDE /* compiled once, when the user waits for it */
        for (size_t j = 0; j < k->stages && !status; j++)
            status = DAL_KERNEL_STAGE(k, k->stage + j, !DAL_KERNEL_PULLED);
#else
        if (k->potential || k->kept) {
            for (size_t j = 0; j < k->stages && !status; j++)
                status = DAL_KERNEL_STAGE(k, k->stage + j, false);
        } else {
            for (size_t j = 0; j < k->stages && !status; j++)
                status = DAL_KERNEL_STAGE(k, k->stage + j, true);
        }
#endif
        if (status) break;
        k->age++;
    }
    if (status && k->stages > 1) {
        memcpy(k->x, k->saved, 2 * k->n * sizeof *k->x);
        dal_kernel_forget(k);
    }
    k->stats.steps += made;
    *done = made;
    return status;
}

#undef DAL_KERNEL_INSIDE
#undef DAL_KERNEL_PULLED
#undef DAL_KERNEL_ARRAY
#undef DAL_KERNEL_M
#undef DAL_KERNEL_STAGE
#undef DAL_KERNEL_JOIN
#undef DAL_KERNEL_JOIN_
#undef DAL_KERNEL_CONSTRAINT
#undef DAL_KERNEL_POTENTIAL
#undef DAL_KERNEL
#undef DAL_N
#undef DAL_M
#endif /* DAL_KERNEL */
