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
 * factored once a stage at the predicted velocity.  The unknown part of v' - v is M^-1 mu^T kappa,
 * and V_q if it acts at q~'.  It is predicted from those of the three stages before, so these two
 * evaluations of the constraint are independent.  After a correction mu is evaluated at the q~'
 * recovered from the *stored* state, unless only V_q still changes.
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
 * The array residue is the rounding error of x (compensated summation): the exact sum is x +
 * residue.  Every stage starts from it; predictions use x alone, so they do not wait for residue.
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
 * and includes this file once for each.  The stages are in stage.h and momentum.h, over numbers and
 * decisions of any type: here double and bool, in lanes.h vectors.  All compilations execute the
 * same operations in the same order, except for terms that are 0, so they give the same bits (build
 * with -ffp-contract=off).
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
    double A, B;
    double w0, w1, w2;       /* weights of V_q at q~, q_k, q~' */
    double span;             /* A + B */
    double t_start, t_node, t_end; /* times of q~, q_k, q~' since the step began, in units of h */
    bool linear;             /* B = 0: mu(q~') is mu(q_k) */
    double reuse;            /* largest weight of V_q(q~'), here or as start of the next stage */
    double predict_3[3];     /* weights of the last unknown parts of v' - v in the next */
    bool momentum;           /* a stage of momentum.h; then V_q stands for -(L_q + f), and */
    size_t kind;             /* which of its stages have the same beta */
    double predict_4[5][4];  /* weights of the last changes of v, by how many there are */
} dal_stage;

/* Masks of the entries that may be nonzero: bit a*n + i for entry (a, i), so n <= 8; or
 * DAL_KERNEL_ALL.  Terms with other entries are omitted. */
typedef struct dal_pattern {
    unsigned long long inverse; /* M^-1 */
    unsigned long long mu, Z;   /* and Z = mu M^-1 */
    unsigned long long N;
    unsigned long long dv;      /* [n] entries of v' not known in advance, because of Z, or V_q at
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

#define dal_real double
#define dal_flag bool
#define dal_exchange size_t
#define DAL_ARRAYS(name) dal_##name
#include <dalembert/arrays.h>
#undef dal_real
#undef dal_flag
#undef dal_exchange

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
    bool constant_rate; /* coordinates that mu depends on may move uniformly, see stage.h */
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
    bool history_known;    /* dv_history is known */
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

    /* The arrays from at.x to at.N are one block, divided by dal_kernel_layout.  So the step
     * routine reaches its parts by constant offsets, and callbacks see the same addresses at every
     * call. */
    dal_arrays at;
    dal_balance balance;
    double *saved;         /* [2n+m] x and impulse before a step of several stages */

    dal_stats stats;
    struct {
        dal_failure kind;
        int returned;
    } failure;
};

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
/* The status of an iteration that needs another correction. */
enum { DAL_KERNEL_AGAIN = 2 };
/* The time c steps after the beginning of step number. */
#define DAL_KERNEL_TIME(k, number, c) ((k)->t0 + ((number) + (c)) * (k)->h)

#define DAL_KERNEL_JOIN_(a, b) a##b
#define DAL_KERNEL_JOIN(a, b) DAL_KERNEL_JOIN_(a, b)

#if defined(__GNUC__)
#define DAL_KERNEL_INLINE static inline __attribute__((always_inline))
#define DAL_KERNEL_NOINLINE static __attribute__((noinline, unused))
#define DAL_KERNEL_RARE(condition) __builtin_expect(!!(condition), 0)
#else
#define DAL_KERNEL_NOINLINE static
#define DAL_KERNEL_INLINE static inline
#define DAL_KERNEL_RARE(condition) (condition)
#endif

/* Divides block[10*n + 3*entries] into x ... N, with entries the number of entries of mu. */
static inline void dal_kernel_layout(dal_kernel *k, size_t entries, double *block)
{
    const size_t n = k->n;
    k->at.x = block;
    k->at.node = block + 2 * n;
    k->at.point = block + 3 * n;
    k->at.w = block + 4 * n;
    k->at.dv_history = block + 5 * n;
    k->at.residue = block + 8 * n;
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
static inline double dal_kernel_time(const dal_kernel *k, double number, double c)
{
    return DAL_KERNEL_TIME(k, number, c);
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
    for (size_t i = 0; i < 3 * k->n; i++) k->at.dv_history[i] *= ratio;
    for (size_t i = 0; i < 4 * k->n * k->kinds; i++) k->history[i] *= ratio;
    for (size_t a = 0; k->kinds > 0 && a < k->m; a++) k->latest[a] *= ratio;
}

/* The state of the predictor, as after a start; and residue. */
static inline void dal_kernel_forget(dal_kernel *k)
{
    k->history_known = false;
    k->forced = false;
    k->carried = false;
    for (size_t i = 0; i < k->kinds; i++) k->known[i] = 0;
    for (size_t i = 0; i < 3 * k->n; i++) k->at.dv_history[i] = 0.0;
    for (size_t i = 0; i < 2 * k->n; i++) k->at.residue[i] = 0.0;
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
#define DAL_KERNEL_HAS_FORCE true
#define DAL_KERNEL_PLAIN false
#else
#ifdef DAL_KERNEL_MOMENTA
#define DAL_KERNEL_HAS_FORCE true
#else
#define DAL_KERNEL_HAS_FORCE false
#endif
#define DAL_KERNEL_PLAIN (!DAL_KERNEL_HAS_FORCE)
#define DAL_KERNEL_POTENTIAL(k, t, q, V_q) 0
#endif
#elif defined(DAL_KERNEL_MOMENTA)
#define DAL_KERNEL_INSIDE 0
#define DAL_KERNEL_HAS_FORCE true
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
#define DAL_KERNEL_HAS_FORCE ((k)->potential != NULL)
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

/* ---- primitives for double and bool; lanes.h defines those for vectors */
#ifndef DAL_KERNEL_LANES
#define DAL_KERNEL_LANES 0
#define dal_real double
#define dal_flag bool
#define dal_exchange size_t
#define dal_kernel_of dal_kernel
#define dal_arrays_of dal_arrays
#define dal_masses_of dal_masses
#define dal_balance_of dal_balance
#define dal_traits_of dal_traits
#define dal_progress_of dal_progress
#define dal_momentum_traits_of dal_momentum_traits
#define DAL_NUMBER(x) (x)
#define DAL_ABS(x) fabs(x)
#define DAL_SQRT(x) sqrt(x)
#define DAL_FLAG(x) (x)
#define DAL_SELECT(which, a, b) ((which) ? (a) : (b))
#define DAL_TAKE(all, which, value, old) (value) /* as select, but value if all is true */
#define DAL_ANY(which) (which)
#define DAL_EVERY(which) (which)
#define DAL_NOT(which) (!(which))
#define DAL_AND(a, b) ((a) && (b))
#define DAL_OR(a, b) ((a) || (b))
#define DAL_ALSO(a, b) ((a) & (b)) /* and, both evaluated */
#define DAL_COUNT_ITERATION(k, work, which) ((k)->stats.iterations++)
#define DAL_LEAVE_UNLESS(open, condition) \
    if (!(condition)) return 1
#define DAL_GOING(k) true /* the lanes that make the stage */
#define DAL_REFUSED(k, kind, returned) dal_kernel_refused(k, kind, returned)
#define DAL_FAIL(k, status, kind) dal_kernel_fail(k, status, kind)
#define DAL_FACTOR_LU(m, A, sizes, row) (dal_lu_factor(m, A, sizes, row) > 0)
#define DAL_SOLVE_LU(m, A, row, b, x) dal_lu_solve(m, A, row, b, x)
#define DAL_ROWS_DOT(rows, A, a, x) dal_rows_dot(rows, A, a, x)
#define DAL_ROWS_EXTENT(rows, A, a, x) dal_rows_extent(rows, A, a, x)
#define DAL_ROWS_COLUMN(rows, A, i, c) dal_rows_column(rows, A, i, c)
#define DAL_CONSTRAINT(k, work, which, t, q, v, mu, N) DAL_KERNEL_CONSTRAINT(k, t, q, v, mu, N)
#define DAL_POTENTIAL(k, work, which, t, q, V_q) DAL_KERNEL_POTENTIAL(k, t, q, V_q)
#define DAL_DRAG(k, t, q, v, V_q) dal_kernel_drag(k, t, q, v, V_q)
#define DAL_FORMS(k, work, which, t, q, v, phi, mu, N) DAL_KERNEL_FORMS(k, t, q, v, phi, mu, N)
#define DAL_BALANCE(k, work, which, t, q, v, L_v, F, L_vq, L_vv, F_q, F_v) \
    DAL_KERNEL_BALANCE(k, t, q, v, L_v, F, L_vq, L_vv, F_q, F_v)
#define DAL_VALUES(k, work, which, t, q, v, L_v, F, late) \
    DAL_KERNEL_VALUES(k, t, q, v, L_v, F, late)
#define DAL_START(k, t, q, v, L_v, F) DAL_KERNEL_START(k, t, q, v, L_v, F)
#define DAL_COUNT_START(counts, which)
/* the weights of the last changes of v; and one more of them is known */
#define DAL_WEIGHTS(name, k, s) const double *const name = (s)->predict_4[(k)->known[(s)->kind]]
#define DAL_KNOW_ONE_MORE(k, kind, which) \
    ((k)->known[kind] = (unsigned char)((k)->known[kind] + ((k)->known[kind] < 4)))
#define DAL_FRESH(name, size, old) dal_real *const name = (old) /* for results of some lanes */
#define DAL_EXCHANGES(name) size_t name[DAL_KERNEL_M]
#define DAL_TALLY(name) bool *const name = NULL
#endif

#define DAL_KERNEL_CONSTANT_RATE(k) \
    (DAL_KERNEL_STEADY > 1 || (DAL_KERNEL_STEADY < 0 && (k)->constant_rate))

#define DAL_KERNEL_PART(name) DAL_KERNEL_JOIN(DAL_KERNEL, _##name)
#define DAL_KERNEL_COPY DAL_KERNEL_PART(copy)

#ifdef DAL_N
#define DAL_KERNEL_M (DAL_M > 0 ? DAL_M : 1)
#define DAL_KERNEL_SIZES const size_t n = DAL_N, m = DAL_M; (void)n, (void)m
#else
#define DAL_KERNEL_SIZES const size_t n = k->n, m = k->m; (void)n, (void)m
#endif
/* An array passed to callbacks, unless they are compiled with the kernel. */
#if DAL_KERNEL_INSIDE
#define DAL_KERNEL_SHARED(name, size, offset) dal_real name[size]
#else
#define DAL_KERNEL_SHARED(name, size, offset) dal_real *const name = x + (offset)
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
DAL_KERNEL_INLINE void DAL_KERNEL_COPY(size_t n, const dal_real *from, dal_real *to)
{
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) to[i] = from[i];
}

#ifdef DAL_N
/* M^-1 and its units, with 1 and 0 as constants where the compilation knows them. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(take_masses)(const dal_kernel_of *k, dal_real *mass_inverse,
                                                    dal_real *unit, dal_real *per_unit)
{
    const dal_pattern has = DAL_KERNEL_PATTERN;
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < DAL_N * DAL_N; i++)
        mass_inverse[i] = has.one >> i / DAL_N & 1 ? DAL_NUMBER(i % (DAL_N + 1) == 0 ? 1.0 : 0.0)
                                                   : k->mass_inverse[i];
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < DAL_N; i++) {
        unit[i] = has.one >> i & 1 ? DAL_NUMBER(1.0) : k->unit[i];
        per_unit[i] = has.one >> i & 1 ? DAL_NUMBER(1.0) : k->per_unit[i];
    }
}
#endif

/* With an infinite w stored is infinite too, or NaN where b = 0. */
DAL_KERNEL_INLINE dal_flag DAL_KERNEL_PART(is_finite)(size_t n, const dal_arrays_of *work)
{
    dal_real total = DAL_NUMBER(-0.0);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) total += work->stored[i];
    return DAL_ABS(total) <= DBL_MAX;
}

/* ---- functions that differ in lanes */
#if !DAL_KERNEL_LANES
/* old <- fresh in these lanes: they are one array. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(take)(size_t n, bool all, bool which, const double *fresh,
                                             double *old)
{
    (void)n, (void)all, (void)which, (void)fresh, (void)old;
}

/* V_q at q~' becomes that at q~. */
DAL_KERNEL_INLINE void DAL_KERNEL_PART(pass_on)(dal_kernel *k, const dal_arrays *work, size_t n,
                                                bool ends, bool all, bool made, double *force1)
{
    (void)work, (void)n, (void)all, (void)made;
    if (!ends) return;
    k->force1 = k->force0;
    k->force0 = force1;
}

/* Check of C if the determinant of the factored S leaves its range. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(look)(dal_kernel *k, const dal_traits *traits,
                                            const dal_arrays *work, bool *open)
{
    DAL_KERNEL_SIZES;
    (void)open;
    if (m == 0) return DAL_SUCCESS;
    const double inverse = work->rows ? work->S[0] : dal_lu_inverse_determinant(m, work->S);
    if (DAL_KERNEL_RARE(!(k->range[0] <= inverse && inverse <= k->range[1]))) {
        DAL_KERNEL_COPY(2 * n, work->x, k->at.x);
        return k->look(k, traits->number, traits->stage, inverse);
    }
    return DAL_SUCCESS;
}

/* k->finish completes the stage; a state that is not finite is not solved. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(hand_over)(dal_kernel *k, const dal_traits *traits,
                                                 const dal_arrays *work, bool *solved, bool *made)
{
    DAL_KERNEL_SIZES;
    *solved = *solved && DAL_KERNEL_PART(is_finite)(n, work);
    DAL_KERNEL_COPY(2 * n, work->x, k->at.x);
    DAL_KERNEL_COPY(n, work->w, k->at.w);
    DAL_KERNEL_COPY(n, work->v_known, k->at.v_known);
    DAL_KERNEL_COPY(n, work->stored, k->at.stored);
    const int status = k->finish(k, traits->number, traits->stage, *solved);
    if (status) return status;
    DAL_KERNEL_COPY(n, k->at.w, work->w);
    DAL_KERNEL_COPY(n, k->at.stored, work->stored);
    DAL_KERNEL_UNROLL
    for (size_t i = 0; i < n; i++) { /* finish rounds, and does not say how */
        work->dx[i] = work->stored[i] - work->x[i];
        work->dx[n + i] = work->w[i] - work->x[n + i];
    }
    if (!*solved) DAL_KERNEL_COPY(m, k->at.kappa, work->kappa);
    *made = true;
    return DAL_SUCCESS;
}
#endif

#include <dalembert/stage.h>

/* Each kind of stage.  With the callbacks inside, the step is one function, so that the state stays
 * in registers; with pointers, one for each kind, which compiles faster. */
#if DAL_KERNEL_INSIDE && !DAL_KERNEL_LANES
#define DAL_KERNEL_WHOLE DAL_KERNEL_INLINE
#else
#define DAL_KERNEL_WHOLE DAL_KERNEL_NOINLINE
#endif

DAL_KERNEL_WHOLE int DAL_KERNEL_PART(stage_in_general)(dal_kernel_of *k, dal_real number,
                                                       const dal_stage *s,
                                                       const dal_masses_of *masses, dal_real *x,
                                                       dal_real *dv_history)
{
    return DAL_KERNEL_PART(stage)(k, number, s, false, masses, x, dv_history);
}

#ifndef DAL_KERNEL_MOMENTA
DAL_KERNEL_WHOLE int DAL_KERNEL_PART(plain_stage)(dal_kernel_of *k, dal_real number,
                                                  const dal_stage *s, const dal_masses_of *masses,
                                                  dal_real *x, dal_real *dv_history)
{
    return DAL_KERNEL_PART(stage)(k, number, s, true, masses, x, dv_history);
}
#endif

#ifdef DAL_KERNEL_MOMENTA
/* From k->at.x: momentum <- L_v in some lanes, and force0 <- -F in others. */
DAL_KERNEL_NOINLINE int DAL_KERNEL_PART(push)(dal_kernel_of *k, dal_real number, const dal_stage *s,
                                              dal_flag momenta, dal_flag forces)
{
    DAL_KERNEL_SIZES;
    const dal_real *const x = k->at.x, shift = (k->kept ? k->shift : 0.0) * k->h;
    dal_real *const q = k->at.point;
    DAL_FRESH(p, DAL_N, k->momentum);
    DAL_FRESH(F, DAL_N, k->force0);
    for (size_t i = 0; i < n; i++) q[i] = x[i] - shift * x[n + i];
    const int returned = DAL_START(k, DAL_KERNEL_TIME(k, number, s->t_start), q, x + n,
                                   DAL_ANY(momenta) ? p : NULL, DAL_ANY(forces) ? F : NULL);
    if (returned) return DAL_REFUSED(k, DAL_FAILED_BALANCE, returned);
    DAL_KERNEL_PART(take)(n, false, momenta, p, k->momentum);
    for (size_t i = 0; DAL_ANY(forces) && i < n; i++)
        k->force0[i] = DAL_TAKE(false, forces, -F[i], k->force0[i]);
    return DAL_SUCCESS;
}

#include <dalembert/momentum.h>

DAL_KERNEL_WHOLE int DAL_KERNEL_PART(momentum_stage)(dal_kernel_of *k, dal_real number,
                                                     const dal_stage *s, dal_real *x,
                                                     dal_real *residue)
{
    return DAL_KERNEL_PART(momentum)(k, number, s, !DAL_KERNEL_INSIDE && s->linear, x, residue);
}

/* A stage of either kind. */
DAL_KERNEL_INLINE int DAL_KERNEL_PART(stage_of_either)(dal_kernel_of *k, dal_real number,
                                                       const dal_stage *s,
                                                       const dal_masses_of *masses, dal_real *x,
                                                       dal_real *dv_history)
{
    DAL_KERNEL_SIZES;
    /* with callbacks inside, values known at the node need not be computed again if that is a
       constant */
    if (DAL_KERNEL_INSIDE && !DAL_KERNEL_MASS)
        return DAL_KERNEL_PART(momentum)(k, number, s, false, x, dv_history + 3 * n);
    if (DAL_KERNEL_INSIDE && s->momentum && s->linear)
        return DAL_KERNEL_PART(momentum)(k, number, s, true, x, dv_history + 3 * n);
    if (s->momentum) return DAL_KERNEL_PART(momentum_stage)(k, number, s, x, dv_history + 3 * n);
    int status = DAL_SUCCESS;
    const dal_flag going = DAL_GOING(k), of_p = DAL_AND(going, k->carried);
    for (size_t i = 4 * n; DAL_ANY(of_p) && i < 5 * n; i++) /* residue of p is none of v */
        dv_history[i] = DAL_TAKE(false, of_p, DAL_NUMBER(0.0), dv_history[i]);
    const dal_flag unknown = DAL_AND(going, DAL_NOT(k->forced));
    if (DAL_KERNEL_RARE(s->w0 != 0.0 && DAL_ANY(unknown))) {
        if (!DAL_KERNEL_LANES) DAL_KERNEL_COPY(2 * n, x, k->at.x);
        status = DAL_KERNEL_PART(push)(k, number, s, DAL_FLAG(false), unknown);
        if (status) return status;
        DAL_COUNT_START(k->stats.counts, unknown);
        k->forced = DAL_OR(k->forced, unknown);
    }
    status = DAL_KERNEL_PART(stage_in_general)(k, number, s, masses, x, dv_history);
    k->carried = DAL_AND(k->carried, DAL_NOT(going));
    k->formed = false;
    return status;
}
#endif

#if !DAL_KERNEL_LANES
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
#if DAL_KERNEL_INSIDE && DAL_KERNEL_MASS && DAL_N <= 8
    double mass_inverse[DAL_N * DAL_N], unit[DAL_N], per_unit[DAL_N];
    DAL_KERNEL_PART(take_masses)(k, mass_inverse, unit, per_unit);
    const dal_masses masses = {mass_inverse, unit, per_unit};
#else
    const dal_masses masses = {k->mass_inverse, k->unit, k->per_unit};
#endif
#if DAL_KERNEL_INSIDE
    double x[2 * DAL_N], dv_history[5 * DAL_N]; /* and residue */
    DAL_KERNEL_COPY(2 * n, k->at.x, x);
    DAL_KERNEL_COPY(5 * n, k->at.dv_history, dv_history);
#else
    double *const x = k->at.x, *const dv_history = x + 5 * n;
#endif
    /* one loop for steps and stages: two would carry the state through memory */
    while (number < last) {
        if (DAL_KERNEL_RARE(stages > 1) && s == k->stage) {
            DAL_KERNEL_COPY(2 * n, x, k->saved);
            DAL_KERNEL_COPY(k->m, k->impulse, k->saved + 2 * n);
        }
#ifdef DAL_KERNEL_MOMENTA
        if (s == k->stage) k->formed = false;
        status = DAL_KERNEL_PART(stage_of_either)(k, number, s, &masses, x, dv_history);
#else
        if (DAL_KERNEL_PLAIN || k->plain)
            status = DAL_KERNEL_PART(plain_stage)(k, number, s, &masses, x, dv_history);
        else
            status = DAL_KERNEL_PART(stage_in_general)(k, number, s, &masses, x, dv_history);
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
    DAL_KERNEL_COPY(5 * n, dv_history, k->at.dv_history);
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
#endif

#undef dal_real
#undef dal_flag
#undef dal_exchange
#undef dal_kernel_of
#undef dal_arrays_of
#undef dal_masses_of
#undef dal_balance_of
#undef dal_traits_of
#undef dal_progress_of
#undef DAL_NUMBER
#undef DAL_ABS
#undef DAL_SQRT
#undef DAL_ALSO
#undef dal_momentum_traits_of
#undef DAL_FORMS
#undef DAL_BALANCE
#undef DAL_VALUES
#undef DAL_START
#undef DAL_COUNT_START
#undef DAL_WEIGHTS
#undef DAL_KNOW_ONE_MORE
#undef DAL_TALLY
#undef DAL_FLAG
#undef DAL_SELECT
#undef DAL_TAKE
#undef DAL_ANY
#undef DAL_EVERY
#undef DAL_NOT
#undef DAL_AND
#undef DAL_OR
#undef DAL_COUNT_ITERATION
#undef DAL_LEAVE_UNLESS
#undef DAL_GOING
#undef DAL_REFUSED
#undef DAL_FAIL
#undef DAL_FACTOR_LU
#undef DAL_SOLVE_LU
#undef DAL_ROWS_DOT
#undef DAL_ROWS_EXTENT
#undef DAL_ROWS_COLUMN
#undef DAL_CONSTRAINT
#undef DAL_POTENTIAL
#undef DAL_DRAG
#undef DAL_FRESH
#undef DAL_EXCHANGES
#undef DAL_KERNEL_LANES
#undef DAL_KERNEL_INSIDE
#undef DAL_KERNEL_WHOLE
#undef DAL_KERNEL_HAS_FORCE
#undef DAL_KERNEL_PLAIN
#undef DAL_KERNEL_SHARED
#undef DAL_KERNEL_SIZES
#undef DAL_KERNEL_UNROLL
#undef DAL_KERNEL_UNFOLD
#undef DAL_KERNEL_M
#undef DAL_KERNEL_COPY
#undef DAL_KERNEL_PART
#undef DAL_KERNEL_STEADY
#undef DAL_KERNEL_CONSTANT_RATE
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
