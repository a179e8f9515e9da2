/* kernel.h - the step routine of every scheme, for every system.
 *
 * A scheme of sub-steps {beta, fraction} becomes a list of stages.  Let q~ and v be the state, and
 * A, B and the weights those of struct dal_stage.  For constant mass, linear constraints and no
 * force that depends on v (V includes other forces), a stage is
 *
 *     q_k = q~ + A h v
 *     M (v' - v) = -h [start V_q(q~) + node V_q(q_k) + end V_q(q~')] + mu(q_k)^T kappa
 *     q~' = q_k + B h v',      mu(q~') v' = 0
 *
 * This is the beta-scheme (DAELd1, DAELd2, Facil) for A = 1-beta, B = beta.  It is the fused pair
 * (0, a), (1, b) for A = a, B = b; V then enters at the node only, and kappa is the only unknown.
 * Stages of other systems are in momentum.h.  The multiplier is lambda = kappa / ((A+B) h).
 *
 * Terms at q~, q_k, q~' are evaluated at the times t, t + A h and t + (A+B) h.  Each time is
 * t0 + (k + c) h with the step number k and a constant c of the stage, so rounding errors do not
 * accumulate.  The end of a step is dal_stepper_time to the bit.
 *
 * Solution.  Newton's iteration for (v', kappa) without the Hessian of V needs one m x m matrix
 *     S = (mu(q~') + B h N) M^-1 mu(q_k)^T,      N = d(mu v)/dq,
 * factored once a stage at the predicted velocity.  The pull is the part of v' - v that is not
 * known in advance: M^-1 mu^T kappa, and V_q if it acts at q~'.  It is predicted from the pulls of
 * the three stages before, so these two evaluations of the constraint are independent.  After a
 * correction mu is evaluated at the q~' recovered from the *stored* state, unless only V_q still
 * changes.
 *
 * The stage is complete when the residual of D there (residual.h) is at most half of its bound of 4
 * n u.  Otherwise this evaluation serves the next correction.  If the residual is a rounding of v'
 * or q~', v' is corrected at that q~'.  So most stages evaluate the constraint three times, and the
 * stored state lies in D because its residual was checked.
 *
 * The function dal_kernel.finish completes a stage that does not contract, leaves the domain of a
 * callback or is not finite.  It uses the full Newton matrix with the Hessian, and halved steps.
 * It also completes a stage with det S < 0.  As h goes to 0, det S tends to the positive
 * determinant of mu M^-1 mu^T; a change of sign means that the solution is spurious.
 *
 * The array low is the rounding error of x (compensated summation): the exact sum is x + low.
 * Every stage starts from x + low; predictions use x alone, so they do not wait for low.
 *
 * In a steady system mu depends only on coordinates on which no constraint force acts (a blade with
 * a free heading).  If V does not act at q~' either, mu(q~') is known before v'.  The equations are
 * then linear in kappa, and the first correction is the solution.  If the system is proved to be
 * steady, mu is not evaluated again.  If it is only declared, it is evaluated, and a false
 * declaration is detected.
 *
 * One text, many compilations.  The includer defines
 *     DAL_KERNEL                  name of the function: int (dal_kernel *, size_t, size_t *)
 *     DAL_N, DAL_M                sizes as constants; or neither, for sizes from the dal_kernel
 *     DAL_KERNEL_CONSTRAINT(k, t, q, v, mu, N)   and   DAL_KERNEL_POTENTIAL(k, t, q, V_q)
 *                                 how to call the system, the second only where there is a V; the
 *                                 routine then makes the steps of moved nodes only.  By default the
 *                                 pointers are called
 *     DAL_KERNEL_PATTERN          with these, if wanted: a dal_pattern, in braces
 *     DAL_KERNEL_STEADY           with these, if wanted: 0 if the system is not steady, 1 if it is,
 *                                 2 if besides V pushes no coordinate that mu depends on
 *     DAL_KERNEL_MOMENTA          for systems with stages of momentum.h; with the callbacks inside
 *                                 also DAL_KERNEL_MASS, 0 if all stages are of these, and
 *                                 DAL_KERNEL_KIND, _FORMS, _BALANCE, _VALUES, _START: how the
 *                                 system is called, as they are written below for pointers
 * and includes this file once for each.  All compilations execute the same operations in the same
 * order, except for terms that are 0, so they give the same bits (build with -ffp-contract=off).
 * Nothing here allocates memory or needs libdalembert or GSL. */
#ifndef DALEMBERT_KERNEL_H
#define DALEMBERT_KERNEL_H

#include <dalembert/field.h>
#include <dalembert/lu.h>
#include <dalembert/residual.h>
#include <dalembert/rows.h>
#include <dalembert/stepper.h>

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>

typedef struct dal_stage {
    double before, after;    /* A, B */
    double start, node, end; /* weights of V_q at q~, q_k, q~' */
    double span;             /* A + B */
    double t_start, t_node, t_end; /* times of q~, q_k, q~' since the step began, in units of h */
    bool linear;             /* B = 0: mu(q~') is mu(q_k) */
    double reuse;            /* largest weight of V_q(q~'), here or as start of the next stage */
    double ahead[3];         /* the pull is predicted as ahead[0] p1 + ahead[1] p2 + ahead[2] p3 */
    bool momentum;           /* a stage of momentum.h; then V_q stands for -(L_q + f), and */
    size_t kind;             /* which of its stages have the same beta */
    double past[5][4];       /* weights of the last changes of v, by how many there are */
} dal_stage;

/* Masks of the entries that may be nonzero: bit a*n + i for entry (a, i), so n <= 8; or
 * DAL_KERNEL_ALL.  Terms with other entries are omitted. */
typedef struct dal_pattern {
    unsigned long long inverse; /* M^-1 */
    unsigned long long mu, Z;   /* and Z = mu M^-1 */
    unsigned long long N;
    unsigned long long pull;    /* [n] entries of v' not known in advance, because of Z, or V_q at
                                   q~' */
    unsigned long long kick;    /* [n] M^-1 V_q */
    unsigned long long one;     /* [n] coordinates with mass 1 that M does not couple with others */
    unsigned long long L_vq, F_q, F_v; /* for stages of momentum.h, where Z = mu K^-1, */
    unsigned long long K;       /* and the factors of K */
} dal_pattern;

/* The cause of the failure of a stage. */
typedef enum dal_failure {
    DAL_FAILED_CONSTRAINT, /* the callback returned nonzero: see returned */
    DAL_FAILED_POTENTIAL,
    DAL_FAILED_BALANCE,    /* the Lagrangian or the force: see returned */
    DAL_FAILED_STEADY,     /* the system is not steady, although declared */
    DAL_FAILED_FINISH      /* see finish */
} dal_failure;

/* The vectors and matrices of a stage. */
typedef struct dal_arrays {
    double *x;                    /* [2n] the state */
    double *pull;                 /* [3n] the pulls of the last stages, the latest first */
    double *low;                  /* [2n] rounding error of x: the exact sum is x + low */
    double *node, *point, *w;     /* [n] q_k, q~' of the last evaluation, the current v' */
    double *mu_node, *mu, *N;     /* [m*n] */
    double *base, *goal, *step;   /* [n] the known part of v', all of it but Z^T kappa, w' - w */
    double *seen;                 /* [n] the v' at whose q~' mu was evaluated last */
    double *stored;               /* [n] the position of the new state */
    double *from;                 /* [n] q_k including low */
    double *lead, *push;          /* [n] the known part of q~' - q~ and of v' - v, and low */
    double *move;                 /* [2n] q~' - q~ and v' - v, before they are rounded to x' */
    double *Z;                    /* [m*n] row a is M^-1 mu_node^a */
    double *S, *sizes, *r, *d, *kappa; /* [m*m], [5*m] (see lu.h), [m] */
    size_t *row;                  /* [m] */
    /* as in dal_kernel; constants if the compilation knows that M is 1 */
    const double *mass_inverse, *unit, *per_unit;
    size_t next;                  /* distance in mass_inverse to the next entry of the diagonal */
    /* only for variable sizes: */
    const dal_rows *rows;         /* stored entries of [m*n]; NULL: all */
    bool dragged;                 /* V_q stands for -(L_q + f), f at the velocity there */
} dal_arrays;

typedef struct dal_masses {
    const double *mass_inverse, *unit, *per_unit;
} dal_masses;

/* The additional arrays of a stage of momentum.h. */
typedef struct dal_balance {
    double *known;                /* [n] the part of p' that is known at the start */
    double *reaction, *residual;  /* [n] mu_k^T kappa; the residual of the balance */
    double *share;                /* [n] fraction of the residual that is momentum */
    double *phi;                  /* [m] */
    double *L_v, *F;              /* [n] at the last evaluation, F = L_q + f */
    double *unit, *per_unit;      /* [n] of residual.h for L_vv */
    double *L_vq, *L_vv, *F_q, *F_v; /* [n*n] at the prediction */
    double *K, *factors;          /* [n*n] */
} dal_balance;

/* Computes L_v[n] and F[n], each or NULL; and either all or none of L_vq[n*n], L_vv[n*n], F_q[n*n]
 * = dF/dq and F_v[n*n] = dF/dv.  Terms of F_q may be omitted. */
typedef int (*dal_balance_fn)(double t, const double *q, const double *v, double *L_v, double *F,
                              double *L_vq, double *L_vv, double *F_q, double *F_v, void *ctx);

/* The owner sets all members down to finish, the arrays, t0, h and x, and then calls
 * dal_kernel_forget.  The other members belong to the step routine. */
struct dal_kernel {
    size_t n, m;
    dal_constraint_fn constraint;
    dal_potential_fn potential; /* NULL: V = 0; includes -f if f depends on t and q only */
    dal_balance_fn balance_of;  /* for stages of momentum.h */
    void *constraint_ctx, *potential_ctx, *balance_ctx;
    const double *input;        /* inputs of the force, for callbacks compiled with the kernel */
    dal_constraint_kind kind;
    const double *mass;                /* [n*n], NULL if it is not constant, */
    const double *mass_inverse;        /* [n*n] and its inverse */
    const double *unit, *per_unit;     /* [n] d_i and 1/d_i of residual.h */
    bool diagonal;
    int steady;   /* a dal_steady if V acts at no q~', else 0 */
    bool turns;   /* coordinates that mu depends on may move uniformly, see dal_kernel_leave */
    size_t stages;
    const dal_stage *stage;
    bool kept;    /* kept nodes: the state is (q~ + shift h v, v) */
    bool plain;   /* V = 0, or acts at nodes q_k only; and moved nodes */
    double shift; /* 1 - beta */
    /* Completes a stage, with results in at.stored and at.w.  Unless solved, by the full Newton
     * iteration from at.x, with kappa; else by evaluating and correcting the residual of D at the
     * stored state. */
    int (*finish)(dal_kernel *k, double number, const dal_stage *s, bool solved);
    /* at.d[m] <- the moves of residual.h at at.point, at.w and the time t. */
    int (*measure)(dal_kernel *k, double t);
    /* Called if 1/|det S| of a stage leaves the range: determines how close C comes to losing rank
     * during the step from at.x.  Sets a new range. */
    int (*look)(dal_kernel *k, double number, const dal_stage *s, double inverse);
    /* For systems with at.rows.  The function factor computes and factors S of the stage from at.Z
     * and mu + b N, with at.S[0] <- log2 of 1/|det S|.  It returns the sign of the determinant, 0
     * if S is singular.  The function solve computes at.d <- S^-1 at.r. */
    int (*factor)(dal_kernel *k, double b);
    void (*solve)(const dal_kernel *k);

    double range[2];       /* bounds of 1/|det S|, or with at.rows of its log2, see look */
    double t0, h;          /* step k begins at t0 + k h */
    size_t number;         /* the k of the next step */
    const double *weight;  /* [stages+1] weights, and the array for the sum of weight[i] (Y_i - Y_0)
                              over the */
    double *estimate;      /* states Y_i between the stages of a step, [2n]; or NULL */
    double *impulse;       /* [m] sum of kappa since dal_advance began */
    bool pulled;           /* the history of pulls is known */
    bool forced;           /* force0 is known */
    double *force0, *force1;        /* [n] V_q at q~ and at q~' */
    bool carried;          /* momentum is known */
    double *momentum;               /* [n] p at q~ */
    double *forms;                  /* [m*n] mu at the node of a stage whose q~' is that node */
    bool formed;           /* and so is mu at the node of the next stage in the same step */
    double *latest, latest_span;    /* [m] kappa of the last stage, and its span */
    double *history;                /* [4*n] for each kind of stage: v' - v, the latest first */
    size_t kinds;
    unsigned char *known;           /* number of known v' - v for each kind */

    /* The arrays from at.x to at.N are one block, divided by dal_kernel_share.  So the step routine
     * reaches its parts by constant offsets, and callbacks see the same addresses at every call. */
    dal_arrays at;
    dal_balance balance;
    double *saved;         /* [2n+m] x and impulse before a step of several stages */

    dal_stats stats;
    struct {
        dal_failure kind;
        int returned;
    } failure;
};

/* The constant properties of a stage; compile-time constants if they are known. */
typedef struct dal_traits {
    const dal_stage *stage;
    double number; /* number of the step, from 0 */
    double t_end;  /* time of the end of the stage */
    dal_pattern has;
    bool plain, kept, potential, steady;
    bool turns;  /* as in dal_kernel, for moved nodes */
    bool ends;     /* V_q acts at the unknown q~' */
    bool known;    /* mu(q~') needs no evaluation */
    bool apart;    /* V_q is not needed either: it is evaluated after S, which need not wait for the
                      state */
} dal_traits;

#define DAL_KERNEL_U (DBL_EPSILON / 2)
/* Half of the bound on the residual. */
#define DAL_KERNEL_LIMIT(n) (2.0 * (double)(n) * DAL_KERNEL_U)

/* When the iteration stops, the residual of the force equation is at most 1/DAL_KERNEL_SAFETY of a
 * rounding of v'.  It has the same sign in each step, and accumulates in the energy. */
#define DAL_KERNEL_SAFETY 256.0
/* While V_q is not balanced, mu is not evaluated if the next correction is expected to be less than
 * this many roundings, 2^-31 of v'.  Terms linear in mu then have an error of its square. */
#define DAL_KERNEL_PASSING 0x1p20
/* Largest number of corrections, each at most half of the one before, before the full Newton
 * iteration. */
enum { DAL_KERNEL_CORRECTIONS = 16 };

#if defined(__GNUC__)
#define DAL_KERNEL_INLINE static inline __attribute__((always_inline))
#define DAL_KERNEL_APART static __attribute__((noinline, unused))
#define DAL_KERNEL_RARE(condition) __builtin_expect(!!(condition), 0)
#else
#define DAL_KERNEL_APART static
#define DAL_KERNEL_INLINE static inline
#define DAL_KERNEL_RARE(condition) (condition)
#endif

/* Divides block[10*n + 3*entries] into x ... N, with entries the number of entries of mu. */
static inline void dal_kernel_share(dal_kernel *k, size_t entries, double *block)
{
    const size_t n = k->n;
    k->at.x = block;
    k->at.node = block + 2 * n;
    k->at.point = block + 3 * n;
    k->at.w = block + 4 * n;
    k->at.pull = block + 5 * n;
    k->at.low = block + 8 * n;
    k->at.mu_node = block + 10 * n;
    k->at.mu = k->at.mu_node + entries;
    k->at.N = k->at.mu + entries;
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

static inline int dal_kernel_constraint(dal_kernel *k, double t, const double *q, const double *v,
                                        double *mu, double *N)
{
    k->stats.constraint_calls++;
    return k->constraint(t, q, v, NULL, mu, N, NULL, k->constraint_ctx);
}

static inline int dal_kernel_potential(dal_kernel *k, double t, const double *q, double *V_q)
{
    k->stats.potential_calls++;
    return k->potential(t, q, NULL, V_q, NULL, k->potential_ctx);
}

static inline int dal_kernel_drag(dal_kernel *k, double t, const double *q, const double *v,
                                  double *V_q)
{
    const int returned =
        k->balance_of(t, q, v, NULL, V_q, NULL, NULL, NULL, NULL, k->balance_ctx);
    for (size_t i = 0; i < k->n; i++) V_q[i] = -V_q[i];
    return returned;
}

static inline int dal_kernel_forms(dal_kernel *k, double t, const double *q, const double *v,
                                   double *phi, double *mu, double *N)
{
    k->stats.constraint_calls++;
    return k->constraint(t, q, v, phi, mu, N, NULL, k->constraint_ctx);
}

/* The time c steps after the beginning of step number. */
DAL_KERNEL_INLINE double dal_kernel_time(const dal_kernel *k, double number, double c)
{
    return k->t0 + (number + c) * k->h;
}

/* Row a of A[..*n], whose pattern is mask, times x[n].  Sums begin with their first term, or with
 * -0.  The compiler can omit x + -0 = x, whereas 0 + x costs an addition on the critical path. */
DAL_KERNEL_INLINE double dal_kernel_dot(size_t n, unsigned long long mask, const double *A,
                                        size_t a, const double *x)
{
    double sum = DAL_KERNEL_HAS(mask, a * n) ? A[a * n] * x[0] : -0.0;
    for (size_t i = 1; i < n; i++)
        if (DAL_KERNEL_HAS(mask, a * n + i)) sum += A[a * n + i] * x[i];
    return sum;
}

/* Component i of Z^T c, for m > 0. */
DAL_KERNEL_INLINE double dal_kernel_column(size_t n, size_t m, unsigned long long mask,
                                           const double *Z, size_t i, const double *c)
{
    double sum = DAL_KERNEL_HAS(mask, i) ? Z[i] * c[0] : -0.0;
    for (size_t a = 1; a < m; a++)
        if (DAL_KERNEL_HAS(mask, a * n + i)) sum += Z[a * n + i] * c[a];
    return sum;
}

/* y <- M^-1 f. */
DAL_KERNEL_INLINE void dal_kernel_accelerate(const dal_kernel *k, const dal_arrays *at, size_t n,
                                             unsigned long long mask, const double *f, double *y)
{
    const double *const inverse = at->mass_inverse;
    if (mask == DAL_KERNEL_ALL && k->diagonal) {
        for (size_t i = 0; i < n; i++) y[i] = inverse[i * at->next] * f[i];
        return;
    }
    for (size_t i = 0; i < n; i++) y[i] = dal_kernel_dot(n, mask, inverse, i, f);
}

/* |mu^a| of residual.h for row a of mu[m*n]. */
DAL_KERNEL_INLINE double dal_kernel_form(const dal_arrays *at, size_t n, unsigned long long mask,
                                         const double *mu, size_t a)
{
    if (at->rows) return dal_rows_extent(at->rows, mu, a, at->unit);
    double sum = -0.0;
    for (size_t i = 0; i < n; i++)
        if (DAL_KERNEL_HAS(mask, a * n + i)) sum += fabs(mu[a * n + i]) * at->unit[i];
    return sum;
}

/* Row a of mu[m*n], or of a similar matrix, times x[n]; component i of Z^T c. */
DAL_KERNEL_INLINE double dal_kernel_product(const dal_arrays *at, size_t n, unsigned long long mask,
                                            const double *mu, size_t a, const double *x)
{
    return at->rows ? dal_rows_dot(at->rows, mu, a, x) : dal_kernel_dot(n, mask, mu, a, x);
}

DAL_KERNEL_INLINE double dal_kernel_reaction(const dal_arrays *at, size_t n, size_t m,
                                             unsigned long long mask, size_t i, const double *c)
{
    return at->rows ? dal_rows_column(at->rows, at->Z, i, c)
                    : dal_kernel_column(n, m, mask, at->Z, i, c);
}

/* The number of stored entries of [m*n]. */
DAL_KERNEL_INLINE size_t dal_kernel_entries(const dal_arrays *at, size_t n, size_t m)
{
    return at->rows ? dal_rows_entries(at->rows) : m * n;
}

/* The largest number of terms in a sum of mu w, which is n in the bound of the residual. */
DAL_KERNEL_INLINE size_t dal_kernel_terms(const dal_arrays *at, size_t n)
{
    return at->rows ? at->rows->terms : n;
}

/* Z <- M^-1 mu_node. */
DAL_KERNEL_INLINE void dal_kernel_direct(const dal_kernel *k, const dal_arrays *at, size_t n,
                                         size_t m, unsigned long long mask)
{
    if (at->rows)
        for (size_t e = 0; e < dal_rows_entries(at->rows); e++)
            at->Z[e] = at->mass_inverse[at->rows->column[e]] * at->mu_node[e];
    else
        for (size_t a = 0; a < m; a++)
            dal_kernel_accelerate(k, at, n, mask, at->mu_node + a * n, at->Z + a * n);
}

/* d <- S^-1 r. */
DAL_KERNEL_INLINE void dal_kernel_solve(const dal_kernel *k, const dal_arrays *at, size_t m)
{
    if (at->rows) k->solve(k);
    else dal_lu_solve(m, at->S, at->row, at->r, at->d);
}

/* S <- (mu + b N) Z^T, factored.  The sizes of its rows are the norms of mu and b N in the metric,
 * the sizes of its columns the norms of mu_node.  If there is one entry, its size is the sum of its
 * terms. */
DAL_KERNEL_INLINE int dal_kernel_factor(size_t n, size_t m, dal_pattern has, double b,
                                        const dal_arrays *at)
{
    double terms = -0.0;
    for (size_t a = 0; a < m; a++) {
        double size = -0.0;
        for (size_t c = 0; c < m; c++) at->S[a * m + c] = -0.0;
        for (size_t i = 0; i < n; i++) {
            const bool turns = DAL_KERNEL_HAS(has.N, a * n + i);
            if (!turns && !DAL_KERNEL_HAS(has.mu, a * n + i)) continue;
            const double mu = at->mu[a * n + i], row = turns ? mu + b * at->N[a * n + i] : mu;
            const double entry = turns ? fabs(mu) + fabs(row) : fabs(mu);
            if (m > 1) size += entry * at->unit[i];
            for (size_t c = 0; c < m; c++) {
                if (!DAL_KERNEL_HAS(has.Z, c * n + i)) continue;
                const double term = row * at->Z[c * n + i];
                at->S[a * m + c] += term;
                terms += turns ? entry * fabs(at->Z[c * n + i]) : fabs(term);
            }
        }
        at->sizes[a] = m > 1 ? size : terms;
        at->sizes[m + a] = m > 1 ? dal_kernel_form(at, n, has.mu, at->mu_node, a) : 1.0;
    }
    return dal_lu_factor(m, at->S, at->sizes, at->row);
}

/* From node i to q~'_i with the velocity w_i, by way.  If turns is true, the velocity constant and
 * both ways equal, they have the same number of ulps of q. So the node is in the middle to the bit.
 * Then a uniformly turning blade loses no energy to the rounding of a large angle.  Each way has
 * half of low: its rounding error is in low twice, and the next two ways remove all of it. */
DAL_KERNEL_INLINE double dal_kernel_leave(const dal_stage *s, size_t n, bool turns,
                                          const dal_arrays *at, size_t i, double w, double way)
{
    return turns && s->before == s->after && w == at->x[n + i] && at->low[n + i] == 0.0
               ? at->node[i] + (at->node[i] - at->x[i]) : at->from[i] + way;
}

/* Computes the stored position from the node and the new velocity; point <- the q~' recovered from
 * it.  With kept nodes q_{k+1} = q_k + h v' is stored, and q~' is recovered as q_{k+1} - (1-beta) h
 * v'. */
DAL_KERNEL_INLINE void dal_kernel_place(const dal_kernel *k, const dal_stage *s, size_t n,
                                        bool kept, bool turns, const dal_arrays *at)
{
    const double reach = (kept ? s->span : s->after) * k->h, shift = k->shift * k->h;
    for (size_t i = 0; i < n; i++) {
        const double way = reach * at->w[i];
        at->move[i] = at->lead[i] + way;
        at->stored[i] = dal_kernel_leave(s, n, turns, at, i, at->w[i], way);
        at->point[i] = kept ? at->stored[i] - shift * at->w[i] : at->stored[i];
    }
}

/* r <- -mu w, with mu at the stored q~'. Returns true if the residual of every constraint is within
 * half of its bound.  If so, stats.worst_residual is raised if the residual exceeds it.  Returns
 * false if r is not finite. */
DAL_KERNEL_INLINE bool dal_kernel_settled(dal_kernel *k, size_t n, size_t m, dal_pattern has,
                                          const dal_arrays *at)
{
    const double limit = DAL_KERNEL_LIMIT(dal_kernel_terms(at, n));
    double largest = k->stats.worst_residual;
    const double speed = dal_residual_speed(n, at->per_unit, at->w);
    const double seen = (largest < limit ? largest : limit) * speed;
    bool settled = true, raised = false;
    for (size_t a = 0; a < m; a++) {
        const double sum = dal_kernel_product(at, n, has.mu, at->mu, a, at->w);
        const double form = dal_kernel_form(at, n, has.mu, at->mu, a);
        at->r[a] = -sum;
        /* nor if both are infinite; form * speed may overflow */
        if (DAL_KERNEL_RARE(!(form * seen > fabs(sum)))) {
            if (!(form * (limit * speed) - fabs(sum) >= 0.0)) settled = false;
            if (fabs(sum) > largest * (form * speed)) largest = fabs(sum) / (form * speed);
            raised = true;
        }
    }
    if (raised && settled) k->stats.worst_residual = largest;
    return settled;
}

/* Whether r may be roundoff: of w, the sum of goal and Z^T kappa, and of q~', through N.  No
 * correction would reduce it. */
DAL_KERNEL_INLINE bool dal_kernel_is_roundoff(size_t n, size_t m, dal_pattern has,
                                              const dal_arrays *at)
{
    const double terms = dal_residual_speed(n, at->per_unit, at->w)
                       + dal_residual_speed(n, at->per_unit, at->goal);
    bool roundoff = true;
    for (size_t a = 0; a < m; a++) {
        double shifted = 0.0;
        for (size_t i = 0; !at->rows && i < n; i++)
            if (DAL_KERNEL_HAS(has.N, a * n + i))
                shifted += fabs(at->N[a * n + i]) * (fabs(at->point[i]) + fabs(at->stored[i]));
        if (at->rows)
            shifted = dal_rows_extent(at->rows, at->N, a, at->point)
                    + dal_rows_extent(at->rows, at->N, a, at->stored);
        const double form = dal_kernel_form(at, n, has.mu, at->mu, a);
        const double bound = 2.0 * (double)dal_kernel_terms(at, n) * form * terms;
        if (!(2.0 * DAL_KERNEL_U * (bound + shifted) - fabs(at->r[a]) >= 0.0)) roundoff = false;
    }
    return roundoff;
}

/* One correction of w and kappa, from V_q(point) in k->force1 if ends, and mu and N at the q~' of
 * seen[n].  If first, kappa was 0.  The equations are v' = goal + Z^T kappa and mu v' + b N (v' -
 * seen) = 0.  The term b N (v' - seen) is the change of mu v' with q~'. */
DAL_KERNEL_INLINE void dal_kernel_newton(const dal_kernel *k, const dal_stage *s, size_t n,
                                         size_t m, dal_pattern has, bool ends, bool first,
                                         const double *seen, const dal_arrays *at)
{
    const double h = k->h, b = s->after * h;
    if (ends) dal_kernel_accelerate(k, at, n, has.inverse, k->force1, at->goal);
    for (size_t i = 0; i < n; i++) {
        const double kick = ends && DAL_KERNEL_HAS(has.kick, i) ? h * s->end * at->goal[i] : 0.0;
        at->move[n + i] = at->push[i] - kick;
        at->goal[i] = at->base[i] - kick;
        at->step[i] = at->goal[i];
        if (!first && m > 0 && DAL_KERNEL_HAS(has.pull, i))
            at->step[i] += dal_kernel_reaction(at, n, m, has.Z, i, at->kappa);
    }
    for (size_t a = 0; a < m; a++) {
        double sum = dal_kernel_product(at, n, has.mu, at->mu, a, at->step);
        if (has.N) {
            double turn = -0.0;
            if (at->rows)
                for (size_t e = at->rows->first[a]; e < at->rows->first[a + 1]; e++)
                    turn += at->N[e] * (at->step[at->rows->column[e]] - seen[at->rows->column[e]]);
            for (size_t i = 0; !at->rows && i < n; i++)
                if (DAL_KERNEL_HAS(has.N, a * n + i) && DAL_KERNEL_HAS(has.pull, i))
                    turn += at->N[a * n + i] * (at->step[i] - seen[i]);
            sum += b * turn;
        }
        at->r[a] = -sum;
    }
    dal_kernel_solve(k, at, m);
    for (size_t a = 0; a < m; a++) /* 0 + d would be waited for */
        at->kappa[a] = first ? at->d[a] : at->kappa[a] + at->d[a];
    for (size_t i = 0; i < n; i++) {
        if (!DAL_KERNEL_HAS(has.pull, i)) continue;
        const double reaction = m > 0 ? dal_kernel_reaction(at, n, m, has.Z, i, at->kappa) : -0.0;
        const double next = at->goal[i] + reaction;
        at->move[n + i] += reaction;
        at->step[i] = next - at->w[i];
        at->w[i] = next;
    }
}

/* Whether V_q need not be evaluated again after a correction of size, if the one before was last.
 * Corrections shrink by the same factor again, and the next stage may give V_q more weight. */
DAL_KERNEL_INLINE bool dal_kernel_is_balanced(const dal_stage *s, bool first, double size,
                                              double last, double noise)
{
    if (first || size <= noise) return size <= noise;
    return DAL_KERNEL_SAFETY * size * (size / last) * s->reuse <= noise * fabs(s->end);
}

/* Adds the contribution of the state x[2n] after stage index to the estimate. */
static inline void dal_kernel_estimate(dal_kernel *k, size_t index, size_t n, const double *x)
{
    const double weight = k->weight[index + 1];
    for (size_t i = 0; i < 2 * n; i++) {
        const double term = weight * (x[i] - k->saved[i]);
        k->estimate[i] = index == 0 ? term : k->estimate[i] + term;
    }
}

/* The predictor for steps of another size, ratio times the last. */
static inline void dal_kernel_rescale(dal_kernel *k, double ratio)
{
    for (size_t i = 0; i < 3 * k->n; i++) k->at.pull[i] *= ratio;
    for (size_t i = 0; i < 4 * k->n * k->kinds; i++) k->history[i] *= ratio;
    for (size_t a = 0; k->kinds > 0 && a < k->m; a++) k->latest[a] *= ratio;
}

/* The state of the predictor, as after a start; and low. */
static inline void dal_kernel_forget(dal_kernel *k)
{
    k->pulled = false;
    k->forced = false;
    k->carried = false;
    for (size_t i = 0; i < k->kinds; i++) k->known[i] = 0;
    for (size_t i = 0; i < 3 * k->n; i++) k->at.pull[i] = 0.0;
    for (size_t i = 0; i < 2 * k->n; i++) k->at.low[i] = 0.0;
}

#endif /* DALEMBERT_KERNEL_H */

/* ---- the step routine, once for each inclusion ------------------------------------------ */

#ifdef DAL_KERNEL

#ifndef DAL_KERNEL_MASS
#define DAL_KERNEL_MASS 1
#endif
#ifdef DAL_KERNEL_CONSTRAINT
#define DAL_KERNEL_INSIDE 1
#ifdef DAL_KERNEL_POTENTIAL
#define DAL_KERNEL_PULLED true
#define DAL_KERNEL_PLAIN false
#else
#ifdef DAL_KERNEL_MOMENTA
#define DAL_KERNEL_PULLED true
#else
#define DAL_KERNEL_PULLED false
#endif
#define DAL_KERNEL_PLAIN (!DAL_KERNEL_PULLED)
#define DAL_KERNEL_POTENTIAL(k, t, q, V_q) 0
#endif
#elif defined(DAL_KERNEL_MOMENTA)
#define DAL_KERNEL_INSIDE 0
#define DAL_KERNEL_PULLED true
#define DAL_KERNEL_KIND(k) (k)->kind
#define DAL_KERNEL_FORMS(k, t, q, v, phi, mu, N) dal_kernel_forms(k, t, q, v, phi, mu, N)
#define DAL_KERNEL_BALANCE(k, t, q, v, L_v, F, L_vq, L_vv, F_q, F_v) \
    (k)->balance_of(t, q, v, L_v, F, L_vq, L_vv, F_q, F_v, (k)->balance_ctx)
#define DAL_KERNEL_VALUES(k, t, q, v, L_v, F, late) \
    (k)->balance_of(t, q, v, L_v, (late) ? (F) : NULL, NULL, NULL, NULL, NULL, (k)->balance_ctx)
#define DAL_KERNEL_START(k, t, q, v, L_v, F) DAL_KERNEL_VALUES(k, t, q, v, L_v, F, true)
#define DAL_KERNEL_CONSTRAINT(k, t, q, v, mu, N) dal_kernel_constraint(k, t, q, v, mu, N)
#define DAL_KERNEL_POTENTIAL(k, t, q, V_q) 0 /* force0 is always known before */
#else
#define DAL_KERNEL_INSIDE 0
#define DAL_KERNEL_PULLED ((k)->potential != NULL)
#define DAL_KERNEL_PLAIN false
#define DAL_KERNEL_CONSTRAINT(k, t, q, v, mu, N) dal_kernel_constraint(k, t, q, v, mu, N)
#define DAL_KERNEL_POTENTIAL(k, t, q, V_q) dal_kernel_potential(k, t, q, V_q)
#endif
#ifndef DAL_KERNEL_PATTERN
#define DAL_KERNEL_PATTERN \
    {DAL_KERNEL_ALL, DAL_KERNEL_ALL, DAL_KERNEL_ALL, DAL_KERNEL_ALL, DAL_KERNEL_ALL, \
     DAL_KERNEL_ALL, 0, DAL_KERNEL_ALL, DAL_KERNEL_ALL, DAL_KERNEL_ALL, DAL_KERNEL_ALL}
#endif
#ifndef DAL_KERNEL_STEADY
#define DAL_KERNEL_STEADY -1
#endif

#define DAL_KERNEL_TURNS(k) \
    (DAL_KERNEL_STEADY > 1 || (DAL_KERNEL_STEADY < 0 && (k)->turns))

#define DAL_KERNEL_JOIN_(a, b) a##b
#define DAL_KERNEL_JOIN(a, b) DAL_KERNEL_JOIN_(a, b)
#define DAL_KERNEL_PART(name) DAL_KERNEL_JOIN(DAL_KERNEL, _##name)
#define DAL_KERNEL_COPY DAL_KERNEL_PART(copy)

#ifdef DAL_N
#define DAL_KERNEL_M (DAL_M > 0 ? DAL_M : 1)
#define DAL_KERNEL_SIZES const size_t n = DAL_N, m = DAL_M; (void)m
#else
#define DAL_KERNEL_SIZES const size_t n = k->n, m = k->m; (void)m
#endif
/* An array passed to callbacks, unless they are compiled with the kernel. */
#if DAL_KERNEL_INSIDE
#define DAL_KERNEL_SHARED(name, size, offset) double name[size]
#else
#define DAL_KERNEL_SHARED(name, size, offset) double *const name = x + (offset)
#endif

/* A variable index would keep an array in memory, also in rarely executed code, in which the
 * compiler does not unroll loops by itself. */
#if DAL_KERNEL_INSIDE && DAL_N <= 8 && defined(__GNUC__)
#define DAL_KERNEL_UNROLL _Pragma("GCC unroll 64")
#else
#define DAL_KERNEL_UNROLL
#endif

/* The same for triangles, which stay loops also where callbacks are outside. */
#if defined(DAL_N) && DAL_N <= 8 && defined(__GNUC__)
#define DAL_KERNEL_UNFOLD _Pragma("GCC unroll 64")
#else
#define DAL_KERNEL_UNFOLD
#endif

/* memcpy would want arrays in memory too. */
DAL_KERNEL_INLINE void DAL_KERNEL_COPY(size_t n, const double *from, double *to)
{
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) to[i] = from[i];
}

/* V_q at q, and at the velocity v for a force that depends on it. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(pull)(dal_kernel *k, const dal_arrays *at, double t,
                                            const double *q, const double *v, double *V_q)
{
    (void)t, (void)q, (void)V_q;
    return at->dragged ? dal_kernel_drag(k, t, q, v, V_q) : DAL_KERNEL_POTENTIAL(k, t, q, V_q);
}

/* base, push += the contribution of V at q_k, or at q~. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(kick)(dal_kernel *k, const dal_traits *o,
                                            const dal_arrays *at)
{
    const dal_stage *const s = o->stage;
    DAL_KERNEL_SIZES;
    const double *const x = at->x;
    const double h = k->h;
    const bool at_node = o->plain || s->node != 0.0;
    double *const force = !at_node ? k->force0
                        : o->plain && DAL_KERNEL_INSIDE ? at->seen : k->force1;
    if (o->plain && DAL_KERNEL_INSIDE)
        for (size_t i = 0; i < n; i++) force[i] = 0.0; /* or some compilers warn */
    if (at_node || !k->forced) {
        const double shift = o->kept ? k->shift * h : 0.0;
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) /* q_k; or q~, where q~' will be */
            at->point[i] = at_node ? at->node[i] : x[i] - shift * x[n + i];
        const double t = dal_kernel_time(k, o->number, at_node ? s->t_node : s->t_start);
        const int returned = DAL_KERNEL_PART(pull)(k, at, t, at->point, x + n, force);
        if (returned) return dal_kernel_refused(k, DAL_FAILED_POTENTIAL, returned);
    }
    const double weight = h * (at_node ? s->node : s->start);
    dal_kernel_accelerate(k, at, n, o->has.inverse, force, at->step);
    for (size_t i = 0; i < n; i++)
        if (DAL_KERNEL_HAS(o->has.kick, i)) {
            at->push[i] -= weight * at->step[i];
            at->base[i] -= weight * at->step[i];
        }
    return DAL_SUCCESS;
}

/* ---- predict: the part of v' that is known, and the pull */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(predict)(dal_kernel *k, const dal_traits *o,
                                               const dal_arrays *at)
{
    const dal_stage *const s = o->stage;
    DAL_KERNEL_SIZES;
    const double *const x = at->x, *const pull = at->pull;
    const double h = k->h, b = s->after * h;
    const double before = o->kept ? 0.0 : s->before * h; /* a kept node is the state */
    for (size_t i = 0; i < n; i++) {
        const double way = before * x[n + i], near = x[i] + way;
        const bool even = o->turns && at->low[n + i] == 0.0; /* as where v is constant */
        at->lead[i] = at->low[i] + way;
        at->from[i] = even ? x[i] + (0.5 * at->low[i] + way) : near + at->low[i];
        at->node[i] = even || (s->linear && !o->kept) ? at->from[i] : near;
        at->push[i] = at->low[n + i];
        at->base[i] = x[n + i] + at->low[n + i];
    }
    if (o->potential && !o->apart) {
        const int status = DAL_KERNEL_PART(kick)(k, o, at);
        if (status) return status;
    }
    /* The latest pull is added last; q~' does not wait for v', and predictions do not wait for low,
     * because this is the critical path.  A steady coordinate is not predicted, but known to the
     * bit. */
    for (size_t i = 0; i < n; i++) {
        const bool pulled = !o->steady && DAL_KERNEL_HAS(o->has.pull, i);
        double early = o->steady || o->potential ? at->base[i] : x[n + i];
        if (pulled) early += s->ahead[1] * pull[n + i] + s->ahead[2] * pull[2 * n + i];
        at->w[i] = early;
        at->point[i] = o->steady || o->turns
                           ? dal_kernel_leave(s, n, o->turns, at, i, early, b * early)
                           : at->node[i] + b * early;
        if (pulled) {
            at->w[i] += s->ahead[0] * pull[i];
            at->point[i] += b * s->ahead[0] * pull[i];
        }
    }
    return DAL_SUCCESS;
}

/* mu at the node, unless it is that of the stage before. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(form_node)(dal_kernel *k, const dal_traits *o,
                                                 const dal_arrays *at)
{
    DAL_KERNEL_SIZES;
#ifdef DAL_KERNEL_MOMENTA
    if (k->formed && o->stage->before == 0.0) {
        DAL_KERNEL_COPY(m * n, k->forms, at->mu_node);
        return 0;
    }
#endif
    return DAL_KERNEL_CONSTRAINT(k, dal_kernel_time(k, o->number, o->stage->t_node), at->node,
                                 at->x + n, at->mu_node, NULL);
}

/* ---- look: check of C if the determinant of the factored S leaves its range */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(look)(dal_kernel *k, const dal_traits *o,
                                            const dal_arrays *at)
{
    DAL_KERNEL_SIZES;
    if (m == 0) return DAL_SUCCESS;
    const double inverse = at->rows ? at->S[0] : dal_lu_inverse_determinant(m, at->S);
    if (DAL_KERNEL_RARE(!(k->range[0] <= inverse && inverse <= k->range[1]))) {
        DAL_KERNEL_COPY(2 * n, at->x, k->at.x);
        return k->look(k, o->number, o->stage, inverse);
    }
    return DAL_SUCCESS;
}

/* ---- factor: S, with mu at the prediction, and then at the node: more has to wait for the first.
 * Like iterate it returns > 0 where the stage is left to k->finish. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(factor)(dal_kernel *k, const dal_traits *o,
                                              const dal_arrays *at)
{
    const dal_stage *const s = o->stage;
    DAL_KERNEL_SIZES;
    int returned = 0;
    if (m > 0 && !s->linear)
        returned = DAL_KERNEL_CONSTRAINT(k, o->t_end, at->point, at->w, at->mu,
                                         o->steady ? NULL : at->N);
    if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
    if (m > 0) {
        const int status = DAL_KERNEL_PART(form_node)(k, o, at);
        if (status) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, status);
        dal_kernel_direct(k, at, n, m, o->has.inverse);
    }
    const size_t entries = dal_kernel_entries(at, n, m);
    if (s->linear) DAL_KERNEL_COPY(entries, at->mu_node, at->mu);
    if (s->linear || (o->steady && o->has.N)) {
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < entries; i++) at->N[i] = 0.0;
    }
    if (o->ends && returned == 0)
        returned = DAL_KERNEL_PART(pull)(k, at, o->t_end, at->point, at->w, k->force1);
    if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_POTENTIAL, returned);
    if (returned > 0) return 1;
    const double b = s->after * k->h;
    const int sign = at->rows ? k->factor(k, b) : dal_kernel_factor(n, m, o->has, b, at);
    return sign <= 0 ? 1 : DAL_KERNEL_PART(look)(k, o, at);
}

/* ---- iterate: Newton on (v', kappa), Hessian dropped, S frozen */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(iterate)(dal_kernel *k, const dal_traits *o,
                                               const dal_arrays *at, bool *settled)
{
    const dal_stage *const s = o->stage;
    DAL_KERNEL_SIZES;
    double last = HUGE_VAL;
    bool passed = false; /* mu was not evaluated after the last correction */
    bool anew = true;    /* nor after the one before, so that this one may be larger */
    if (o->ends) DAL_KERNEL_COPY(n, at->w, at->seen);
    for (int iteration = 1; iteration <= DAL_KERNEL_CORRECTIONS; iteration++) {
        bool balanced = true;
        int returned = 0;
        k->stats.iterations++;
        dal_kernel_newton(k, s, n, m, o->has, o->ends, iteration == 1, o->ends ? at->seen : at->w,
                          at);
        dal_kernel_place(k, s, n, o->kept, o->turns, at);
        if (!o->known || o->ends) {
            double size = -0.0;
            for (size_t i = 0; i < n; i++)
                if (DAL_KERNEL_HAS(o->has.pull, i)) size += fabs(at->step[i]) * at->per_unit[i];
            const double noise =
                8.0 * DAL_KERNEL_U * dal_residual_extent(n, at->per_unit, at->goal);
            if (o->ends) balanced = dal_kernel_is_balanced(s, anew, size, last, noise);
            if (!(anew || size <= 0.5 * last || size <= noise)) break;
            anew = passed && balanced;
            passed = !balanced && size * (size / last) <= DAL_KERNEL_PASSING * noise;
            last = size;
        }
        if (!o->known && !passed) {
            returned = DAL_KERNEL_CONSTRAINT(k, o->t_end, at->point, at->w, at->mu, NULL);
            if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_CONSTRAINT, returned);
            if (o->ends) DAL_KERNEL_COPY(n, at->w, at->seen);
        }
        if (!balanced && returned == 0)
            returned = DAL_KERNEL_PART(pull)(k, at, o->t_end, at->point, at->w, k->force1);
        if (returned < 0) return dal_kernel_refused(k, DAL_FAILED_POTENTIAL, returned);
        if (returned > 0) break;
        if (!balanced) continue;
        *settled = dal_kernel_settled(k, n, m, o->has, at);
        if (*settled || o->known || dal_kernel_is_roundoff(n, m, o->has, at)) return DAL_SUCCESS;
        if (o->steady) return dal_kernel_fail(k, DAL_EINVAL, DAL_FAILED_STEADY);
    }
    return 1;
}

/* With an infinite w stored is infinite too, or NaN where b = 0. */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(is_finite)(size_t n, const dal_arrays *at)
{
    double total = -0.0;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) total += at->stored[i];
    return fabs(total) <= DBL_MAX;
}

/* ---- settle: whether the stored state is finite and has a small residual; a kept node would lead
 * to another q~' */
DAL_KERNEL_INLINE bool DAL_KERNEL_PART(settle)(dal_kernel *k, const dal_traits *o,
                                               const dal_arrays *at, bool solved, bool settled)
{
    DAL_KERNEL_SIZES;
    if (DAL_KERNEL_RARE(m > 0 && solved && !settled && !o->kept)) {
        dal_kernel_solve(k, at, m);
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) {
            const double mended = at->w[i] + dal_kernel_reaction(at, n, m, o->has.Z, i, at->d);
            at->move[n + i] += mended - at->w[i];
            at->w[i] = mended;
        }
        settled = dal_kernel_settled(k, n, m, o->has, at);
    }
    return settled && DAL_KERNEL_PART(is_finite)(n, at);
}

/* ---- hand_over: k->finish completes the stage; a state that is not finite is not solved */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(hand_over)(dal_kernel *k, const dal_traits *o,
                                                 const dal_arrays *at, bool *solved)
{
    DAL_KERNEL_SIZES;
    *solved = *solved && DAL_KERNEL_PART(is_finite)(n, at);
    DAL_KERNEL_COPY(2 * n, at->x, k->at.x);
    DAL_KERNEL_COPY(n, at->w, k->at.w);
    DAL_KERNEL_COPY(n, at->base, k->at.base);
    DAL_KERNEL_COPY(n, at->stored, k->at.stored);
    const int status = k->finish(k, o->number, o->stage, *solved);
    if (status) return status;
    DAL_KERNEL_COPY(n, k->at.w, at->w);
    DAL_KERNEL_COPY(n, k->at.stored, at->stored);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) { /* finish rounds, and does not say how */
        at->move[i] = at->stored[i] - at->x[i];
        at->move[n + i] = at->w[i] - at->x[n + i];
    }
    if (!*solved) DAL_KERNEL_COPY(m, k->at.kappa, at->kappa);
    return DAL_SUCCESS;
}

/* ---- commit.  The next stage adds the rounding error of the sum of x and move, so these errors do
 * not accumulate (compensated summation; E. Hairer, R. McLachlan and A. Razakarivony 2008).  Those
 * of move, smaller by h, do accumulate. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(commit)(dal_kernel *k, const dal_traits *o,
                                               const dal_arrays *at, bool solved)
{
    DAL_KERNEL_SIZES;
    double *const x = at->x, *const pull = at->pull;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) {
        if (!o->steady && DAL_KERNEL_HAS(o->has.pull, i)) {
            pull[2 * n + i] = pull[n + i];
            pull[n + i] = pull[i];
            pull[i] = at->w[i] - at->base[i];
        }
        at->low[i] = x[i] - at->stored[i] + at->move[i];
        at->low[n + i] = x[n + i] - at->w[i] + at->move[n + i];
        x[i] = at->stored[i];
        x[n + i] = at->w[i];
    }
    if (DAL_KERNEL_RARE(!o->steady && !k->pulled)) { /* the best guess of the past */
        DAL_KERNEL_UNROLL
        for (size_t i = 0; i < n; i++) pull[n + i] = pull[2 * n + i] = pull[i];
        k->pulled = true;
    }
    for (size_t a = 0; a < m; a++) k->impulse[a] += at->kappa[a];
    if (o->ends) {
        double *const force = k->force0;
        k->force0 = k->force1;
        k->force1 = force;
    }
    if (o->potential && !o->plain) k->forced = o->ends && solved;
}

/* A stage of step number, counted from 0.  The argument plain, a constant after inlining, means
 * moved nodes, and V = 0 or at nodes only.  So code for other cases costs nothing. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(stage)(dal_kernel *const k, const double number,
                                             const dal_stage *const s, const bool plain,
                                             const dal_masses *const masses, double *const x,
                                             double *const pull)
{
    DAL_KERNEL_SIZES;
    (void)masses;
    dal_pattern has = DAL_KERNEL_PATTERN;
#ifdef DAL_N
    DAL_KERNEL_SHARED(node, DAL_N, 2 * n);
    DAL_KERNEL_SHARED(point, DAL_N, 3 * n);
    DAL_KERNEL_SHARED(w, DAL_N, 4 * n);
    DAL_KERNEL_SHARED(mu_node, DAL_KERNEL_M * DAL_N, 10 * n);
    DAL_KERNEL_SHARED(mu, DAL_KERNEL_M * DAL_N, 10 * n + m * n);
    DAL_KERNEL_SHARED(N, DAL_KERNEL_M * DAL_N, 10 * n + 2 * m * n);
    /* not passed to other functions: on the stack, for the registers */
    double base[DAL_N], goal[DAL_N], step[DAL_N], seen[DAL_N], stored[DAL_N];
    double from[DAL_N], lead[DAL_N], push[DAL_N], move[2 * DAL_N];
    double Z[DAL_KERNEL_M * DAL_N], S[DAL_KERNEL_M * DAL_KERNEL_M], sizes[5 * DAL_KERNEL_M];
    double r[DAL_KERNEL_M], d[DAL_KERNEL_M], kappa[DAL_KERNEL_M];
    size_t row[DAL_KERNEL_M];
    const dal_arrays at = {x, pull, pull + 3 * n, node, point, w, mu_node, mu, N, base, goal, step,
                           seen, stored, from, lead, push, move, Z, S, sizes, r, d, kappa, row,
                           masses->mass_inverse, masses->unit, masses->per_unit, n + 1, NULL,
                           false};
#else
    const dal_arrays at = k->at;
#endif
    const bool kept = !plain && !DAL_KERNEL_INSIDE && k->kept;
    const bool potential = DAL_KERNEL_PULLED || at.dragged;
    const bool inside = DAL_KERNEL_STEADY > 0 && plain;
    const int declared = DAL_KERNEL_STEADY == 0 ? 0 : k->steady;
    const bool proved = inside || declared >= DAL_STEADY_PROVED;
    if (inside) has.N = 0;
    const dal_traits o = {.stage = s, .number = number, .has = has, .plain = plain, .kept = kept,
                          .t_end = dal_kernel_time(k, number, s->t_end), .potential = potential,
                          .ends = potential && !plain && s->end != 0.0,
                          .turns = DAL_KERNEL_TURNS(k) && !kept,
                          .steady = inside || declared,
                          .known = m == 0 || proved || (s->linear && !kept),
                          .apart = plain && DAL_KERNEL_STEADY > 1};

    bool settled = false;
    int status = DAL_KERNEL_PART(predict)(k, &o, &at);
    if (status) return status;
    DAL_KERNEL_UNROLL
    for (size_t a = 0; a < m; a++) at.kappa[a] = 0.0;
    status = DAL_KERNEL_PART(factor)(k, &o, &at);
    if (status < 0) return status;
    if (o.apart) {
        const int kicked = DAL_KERNEL_PART(kick)(k, &o, &at);
        if (kicked) return kicked;
        DAL_KERNEL_COPY(n, at.base, at.w);
    }
    bool solved = false, finished = false;
    if (status > 0) {
        DAL_KERNEL_COPY(n, at.node, at.stored);
        DAL_KERNEL_COPY(n, at.base, at.goal);
    } else {
        status = DAL_KERNEL_PART(iterate)(k, &o, &at, &settled);
        if (status < 0) return status;
        solved = status == 0;
        finished = DAL_KERNEL_PART(settle)(k, &o, &at, solved, settled);
    }
    if (DAL_KERNEL_RARE(!finished)) {
        status = DAL_KERNEL_PART(hand_over)(k, &o, &at, &solved);
        if (status) return status;
    }
    DAL_KERNEL_PART(commit)(k, &o, &at, solved);
    return DAL_SUCCESS;
}

/* Each kind of stage.  With the callbacks inside, the step is one function, so that the state stays
 * in registers; with pointers, one for each kind, which compiles faster. */
#if DAL_KERNEL_INSIDE
#define DAL_KERNEL_WHOLE DAL_KERNEL_INLINE
#else
#define DAL_KERNEL_WHOLE DAL_KERNEL_APART
#endif

DAL_KERNEL_WHOLE int DAL_KERNEL_PART(stage_in_general)(dal_kernel *k, double number,
                                                       const dal_stage *s,
                                                       const dal_masses *masses, double *x,
                                                       double *pull)
{
    return DAL_KERNEL_PART(stage)(k, number, s, false, masses, x, pull);
}

#ifndef DAL_KERNEL_MOMENTA
DAL_KERNEL_WHOLE int DAL_KERNEL_PART(plain_stage)(dal_kernel *k, double number, const dal_stage *s,
                                                  const dal_masses *masses, double *x, double *pull)
{
    return DAL_KERNEL_PART(stage)(k, number, s, true, masses, x, pull);
}
#endif

#ifdef DAL_KERNEL_MOMENTA
/* From k->at.x: L_v, unless momentum is NULL, and -F, if pushed. */
static int DAL_KERNEL_PART(push)(dal_kernel *k, double number, const dal_stage *s, double *momentum,
                                 bool pushed)
{
    DAL_KERNEL_SIZES;
    const double *const x = k->at.x, shift = k->kept ? k->shift * k->h : 0.0;
    double *const q = k->at.point;
    for (size_t i = 0; i < n; i++) q[i] = x[i] - shift * x[n + i];
    const int returned = DAL_KERNEL_START(k, dal_kernel_time(k, number, s->t_start), q, x + n,
                                          momentum, pushed ? k->force0 : NULL);
    if (returned) return dal_kernel_refused(k, DAL_FAILED_BALANCE, returned);
    if (pushed) {
        for (size_t i = 0; i < n; i++) k->force0[i] = -k->force0[i];
        k->forced = true;
    }
    return DAL_SUCCESS;
}

#include <dalembert/momentum.h>

DAL_KERNEL_WHOLE int DAL_KERNEL_PART(momentum_stage)(dal_kernel *k, double number,
                                                     const dal_stage *s, double *x, double *low)
{
    return DAL_KERNEL_PART(momentum)(k, number, s, !DAL_KERNEL_INSIDE && s->linear, x, low);
}

/* A stage of either kind. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(stage_of_either)(dal_kernel *k, double number,
                                                       const dal_stage *s,
                                                       const dal_masses *masses, double *x,
                                                       double *pull)
{
    DAL_KERNEL_SIZES;
    /* with callbacks inside, values known at the node need not be computed again if that is a
       constant */
    if (DAL_KERNEL_INSIDE && !DAL_KERNEL_MASS)
        return DAL_KERNEL_PART(momentum)(k, number, s, false, x, pull + 3 * n);
    if (DAL_KERNEL_INSIDE && s->momentum && s->linear)
        return DAL_KERNEL_PART(momentum)(k, number, s, true, x, pull + 3 * n);
    if (s->momentum) return DAL_KERNEL_PART(momentum_stage)(k, number, s, x, pull + 3 * n);
    int status = DAL_SUCCESS;
    for (size_t i = 0; k->carried && i < n; i++) pull[4 * n + i] = 0.0; /* which is of p */
    if (DAL_KERNEL_RARE(s->start != 0.0 && !k->forced)) {
        DAL_KERNEL_COPY(2 * n, x, k->at.x);
        status = DAL_KERNEL_PART(push)(k, number, s, NULL, true);
    }
    if (!status) status = DAL_KERNEL_PART(stage_in_general)(k, number, s, masses, x, pull);
    k->carried = k->formed = false;
    return status;
}
#endif

/* Takes a number of steps of k; *done <- the number of successful steps.  On failure the state is
 * that after the last of these. */
static int DAL_KERNEL(dal_kernel *k, size_t steps, size_t *done)
{
#ifdef DAL_N
    const size_t n = DAL_N;
#else
    const size_t n = k->n;
#endif
    const size_t stages = k->stages;
    const dal_stage *s = k->stage, *const end = s + stages;
    const double first = (double)k->number, last = first + (double)steps;
    double number = first;
    int status = DAL_SUCCESS;
    const dal_pattern has = DAL_KERNEL_PATTERN;
#if DAL_KERNEL_INSIDE && DAL_KERNEL_MASS && DAL_N <= 8
    double mass_inverse[DAL_N * DAL_N], unit[DAL_N], per_unit[DAL_N];
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < DAL_N * DAL_N; i++)
        mass_inverse[i] = has.one >> i / DAL_N & 1 ? (double)(i % (DAL_N + 1) == 0)
                                                   : k->mass_inverse[i];
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < DAL_N; i++) {
        unit[i] = has.one >> i & 1 ? 1.0 : k->unit[i];
        per_unit[i] = has.one >> i & 1 ? 1.0 : k->per_unit[i];
    }
    const dal_masses masses = {mass_inverse, unit, per_unit};
#else
    (void)has;
    const dal_masses masses = {k->mass_inverse, k->unit, k->per_unit};
#endif
#if DAL_KERNEL_INSIDE
    double x[2 * DAL_N], pull[5 * DAL_N]; /* and low */
    DAL_KERNEL_COPY(2 * n, k->at.x, x);
    DAL_KERNEL_COPY(5 * n, k->at.pull, pull);
#else
    double *const x = k->at.x, *const pull = x + 5 * n;
#endif
    /* one loop for steps and stages: two would carry the state through memory */
    while (number < last) {
        if (DAL_KERNEL_RARE(stages > 1) && s == k->stage) {
            DAL_KERNEL_COPY(2 * n, x, k->saved);
            DAL_KERNEL_COPY(k->m, k->impulse, k->saved + 2 * n);
        }
#ifdef DAL_KERNEL_MOMENTA
        if (s == k->stage) k->formed = false;
        status = DAL_KERNEL_PART(stage_of_either)(k, number, s, &masses, x, pull);
#else
        if (DAL_KERNEL_PLAIN || k->plain)
            status = DAL_KERNEL_PART(plain_stage)(k, number, s, &masses, x, pull);
        else
            status = DAL_KERNEL_PART(stage_in_general)(k, number, s, &masses, x, pull);
#endif
        if (status) break;
        if (DAL_KERNEL_RARE(k->estimate != NULL))
            dal_kernel_estimate(k, (size_t)(s - k->stage), n, x);
        if (++s < end) continue;
        s = k->stage;
        number += 1.0;
    }
#if DAL_KERNEL_INSIDE
    DAL_KERNEL_COPY(2 * n, x, k->at.x);
    DAL_KERNEL_COPY(5 * n, pull, k->at.pull);
#endif
    if (status && stages > 1) {
        DAL_KERNEL_COPY(2 * n, k->saved, k->at.x);
        DAL_KERNEL_COPY(k->m, k->saved + 2 * n, k->impulse);
        dal_kernel_forget(k);
    }
    *done = (size_t)(number - first);
    k->number += *done;
    return status;
}

#undef DAL_KERNEL_INSIDE
#undef DAL_KERNEL_WHOLE
#undef DAL_KERNEL_PULLED
#undef DAL_KERNEL_PLAIN
#undef DAL_KERNEL_SHARED
#undef DAL_KERNEL_SIZES
#undef DAL_KERNEL_UNROLL
#undef DAL_KERNEL_UNFOLD
#undef DAL_KERNEL_M
#undef DAL_KERNEL_COPY
#undef DAL_KERNEL_PART
#undef DAL_KERNEL_JOIN
#undef DAL_KERNEL_JOIN_
#undef DAL_KERNEL_STEADY
#undef DAL_KERNEL_TURNS
#undef DAL_KERNEL_PATTERN
#undef DAL_KERNEL_CONSTRAINT
#undef DAL_KERNEL_POTENTIAL
#undef DAL_KERNEL_MOMENTA
#undef DAL_KERNEL_BALANCE
#undef DAL_KERNEL_VALUES
#undef DAL_KERNEL_START
#undef DAL_KERNEL_FORMS
#undef DAL_KERNEL_KIND
#undef DAL_KERNEL_MASS
#undef DAL_KERNEL
#undef DAL_N
#undef DAL_M
#endif /* DAL_KERNEL */
