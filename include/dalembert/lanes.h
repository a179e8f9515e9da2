/* lanes.h - the step routine of kernel.h for several members of an ensemble at once.
 *
 * Each member has a lane: its own time, step, masses, parameters, inputs and state.  A number in
 * kernel.h is here a vector with a component for each lane, which fits into a register.  A lane
 * executes the operations of kernel.h in their order, so its results do not depend on other lanes.
 * Without functions of a vector math library they are bitwise those of the scalar routine.  If one
 * lane needs an operation, all execute it, and the others discard the result.
 *
 * This is the fast path alone: moved nodes, callbacks that never refuse.  A lane stops before a
 * step in which the scalar routine would call dal_kernel.finish or look.  It also stops if only an
 * estimate of the inverse could show that S is regular.  The scalar routine continues from there.
 *
 * Here are the types and primitives of vectors; the text is that of kernel.h, compiled for each set
 * of instructions.  The includer defines
 *     DAL_LANES(name)             that name with an ending of its own for each set
 *     DAL_LANES_VECTOR            lanes of a vector: 8 for AVX-512, 4 for AVX2, 2 for what all have
 * and includes this file, which declares dal_vec, dal_mask and the functions that callbacks need;
 * then it defines
 *     DAL_N, DAL_M                the sizes, DAL_N <= 8
 *     DAL_LANES_PATTERN, DAL_LANES_STEADY   as those of kernel.h, both needed
 *     DAL_LANES_CONSTRAINT(t, q, v, phi, mu, N, u, p)   unless DAL_M is 0; phi, mu or N may be NULL
 *     DAL_LANES_FORCE(t, q, V_q, u, p)                   where there is a V
 *     DAL_LANES_BALANCE(t, q, v, L_v, F, L_vq, L_vv, F_q, F_v, u, p)   for stages of momentum.h,
 *                                 with DAL_LANES_MASS and DAL_LANES_KIND, as those of kernel.h
 * and includes it again.  That makes the function DAL_LANES(advance), a dal_lanes_fn.  All of it
 * stands where the compiler was told to use the set.  Build with -ffp-contract=off. */
#ifndef DALEMBERT_LANES_H
#define DALEMBERT_LANES_H

#include <dalembert/kernel.h>

#include <stdint.h>

/* Vectors whose stages alternate, so that one need not wait for its own results.
 * Measured: worth a third with AVX2. */
enum { DAL_LANES_INTERLEAVED = 2 };

/* The common data of all lanes, and the numbers of the lanes: DAL_LANES_INTERLEAVED times as many
 * vectors as dal_lanes_layout says; and as many for a step of several stages. */
typedef struct dal_lanes_block {
    const dal_stage *stage;
    size_t stages;
    bool plain, constant_rate; /* as of a dal_kernel */
    bool momenta;              /* the system has stages of momentum.h */
    int steady;
    size_t kinds, parameters, inputs;
    double *numbers, *saved;
} dal_lanes_block;

/* The operations of this routine that are counted. */
enum { DAL_LANES_ITERATIONS, DAL_LANES_CONSTRAINTS, DAL_LANES_FORCES, DAL_LANES_COUNTED };

/* The places of the vectors of a lane.  A flag is 1 or 0. */
typedef struct dal_lanes_layout {
    size_t t0, h, range, mass, mass_inverse, unit, per_unit, parameters, inputs; /* given */
    size_t going, history_known, forced, carried;                                /* flags */
    size_t number, worst;  /* of the step; residual */
    size_t counts;         /* [DAL_LANES_COUNTED] */
    size_t x, dv_history, residue, force, impulse, momentum, latest, latest_span, history, known;
    size_t end; /* after the vectors that a step changes */
    size_t forms, point;
    size_t count; /* of all */
} dal_lanes_layout;

static inline size_t dal_lanes_next(dal_lanes_layout *at, size_t size)
{
    at->count += size;
    return at->count - size;
}

/* For a system with these sizes; momenta, and how many kinds of stages of momentum.h. */
static inline dal_lanes_layout dal_lanes_layout_of(size_t n, size_t m, bool momenta, size_t kinds,
                                                   size_t parameters, size_t inputs)
{
    dal_lanes_layout at = {0};
    const size_t some = momenta ? 1 : 0;
    at.t0 = dal_lanes_next(&at, 1);
    at.h = dal_lanes_next(&at, 1);
    at.range = dal_lanes_next(&at, 2);
    at.mass = dal_lanes_next(&at, some * n * n);
    at.mass_inverse = dal_lanes_next(&at, n * n);
    at.unit = dal_lanes_next(&at, n);
    at.per_unit = dal_lanes_next(&at, n);
    at.parameters = dal_lanes_next(&at, parameters);
    at.inputs = dal_lanes_next(&at, inputs);
    at.going = dal_lanes_next(&at, 1);
    at.history_known = dal_lanes_next(&at, 1);
    at.forced = dal_lanes_next(&at, 1);
    at.carried = dal_lanes_next(&at, 1);
    at.number = dal_lanes_next(&at, 1);
    at.worst = dal_lanes_next(&at, 1);
    at.counts = dal_lanes_next(&at, DAL_LANES_COUNTED);
    at.x = dal_lanes_next(&at, 2 * n);
    at.dv_history = dal_lanes_next(&at, 3 * n);
    at.residue = dal_lanes_next(&at, 2 * n);
    at.force = dal_lanes_next(&at, n);
    at.impulse = dal_lanes_next(&at, m);
    at.momentum = dal_lanes_next(&at, some * n);
    at.latest = dal_lanes_next(&at, some * m);
    at.latest_span = dal_lanes_next(&at, some);
    at.history = dal_lanes_next(&at, 4 * n * kinds);
    at.known = dal_lanes_next(&at, kinds);
    at.end = at.count;
    at.forms = dal_lanes_next(&at, some * m * n);
    at.point = dal_lanes_next(&at, some * n);
    return at;
}

/* Takes a number of steps of the active lanes. */
typedef void (*dal_lanes_fn)(const dal_lanes_block *block, size_t steps);

/* A compilation.  The member lanes of a dal_compiled points to an array of these, the widest first,
 * that ends with vector = 0. */
struct dal_lanes_routine {
    size_t vector, parameters, inputs; /* lanes of a vector; sizes of the system */
    dal_lanes_fn advance;
};

#ifdef __has_builtin
#define DAL_LANES_HAS_BUILTIN(f) __has_builtin(f)
#else
#define DAL_LANES_HAS_BUILTIN(f) 0
#endif

#endif /* DALEMBERT_LANES_H */

/* ---- vectors, once for each set of instructions ----------------------------------------- */

#if defined(DAL_LANES) && !defined(DAL_N)

/* Names that differ, for types that do. */
#define dal_vec DAL_LANES(dal_vec)
#define dal_mask DAL_LANES(dal_mask)

typedef double dal_vec __attribute__((vector_size(8 * DAL_LANES_VECTOR)));
typedef int64_t dal_mask __attribute__((vector_size(8 * DAL_LANES_VECTOR))); /* -1 or 0 */

DAL_KERNEL_INLINE dal_vec DAL_LANES(all_of)(double x) { return x - (dal_vec){0}; }

DAL_KERNEL_INLINE dal_vec DAL_LANES(choose)(dal_mask which, dal_vec a, dal_vec b)
{
    return (dal_vec)(((dal_mask)a & which) | ((dal_mask)b & ~which));
}

DAL_KERNEL_INLINE dal_vec DAL_LANES(fabs)(dal_vec x)
{
    return (dal_vec)((dal_mask)x & INT64_MAX);
}

DAL_KERNEL_INLINE bool DAL_LANES(any)(dal_mask which)
{
#if DAL_LANES_VECTOR == 8 && DAL_LANES_HAS_BUILTIN(__builtin_ia32_ptestmq512)
    typedef long long words __attribute__((vector_size(64)));
    return __builtin_ia32_ptestmq512((words)which, (words)which, -1) != 0;
#elif DAL_LANES_VECTOR == 4 && DAL_LANES_HAS_BUILTIN(__builtin_ia32_movmskpd256)
    return __builtin_ia32_movmskpd256((dal_vec)which) != 0;
#else
    int64_t some = 0;
    for (int i = 0; i < DAL_LANES_VECTOR; i++) some |= which[i];
    return some != 0;
#endif
}

/* Functions of the math library, for lane after lane. */
#define DAL_LANES_EACH(f) \
    DAL_KERNEL_NOINLINE dal_vec DAL_LANES(f)(dal_vec x) \
    { \
        for (int i = 0; i < DAL_LANES_VECTOR; i++) x[i] = f(x[i]); \
        return x; \
    }
#define DAL_LANES_EACH_OF_TWO(f) \
    DAL_KERNEL_NOINLINE dal_vec DAL_LANES(f)(dal_vec x, dal_vec y) \
    { \
        for (int i = 0; i < DAL_LANES_VECTOR; i++) x[i] = f(x[i], y[i]); \
        return x; \
    }

/* The same functions of libmvec.  Their results do not depend on other lanes, and have errors of at
 * most 4 units in the last place.  The calling convention of clang for vectors depends on its
 * command line; only for two lanes it always agrees with libmvec. */
#undef DAL_LANES_LIBRARY
#if DAL_LANES_VECTOR == 8 && !defined(__clang__)
#define DAL_LANES_LIBRARY "_ZGVeN8"
#define DAL_LANES_PASSED 8
#elif DAL_LANES_VECTOR == 4 && !defined(__clang__)
#define DAL_LANES_LIBRARY "_ZGVdN4"
#define DAL_LANES_PASSED 4
#else
#define DAL_LANES_LIBRARY "_ZGVbN2"
#define DAL_LANES_PASSED 2
#endif
typedef double DAL_LANES(passed) __attribute__((vector_size(8 * DAL_LANES_PASSED)));
enum { DAL_LANES(parts) = DAL_LANES_VECTOR / DAL_LANES_PASSED };
#undef DAL_LANES_PASSED

typedef union DAL_LANES(divided) {
    dal_vec whole;
    DAL_LANES(passed) part[DAL_LANES(parts)];
} DAL_LANES(divided);

#define DAL_LANES_AT_ONCE(f) \
    DAL_LANES(passed) DAL_LANES(all_##f)(DAL_LANES(passed)) __asm__(DAL_LANES_LIBRARY "v_" #f); \
    DAL_KERNEL_INLINE dal_vec DAL_LANES(f)(dal_vec x) \
    { \
        DAL_LANES(divided) d = {x}; \
        for (int i = 0; i < DAL_LANES(parts); i++) d.part[i] = DAL_LANES(all_##f)(d.part[i]); \
        return d.whole; \
    }
#define DAL_LANES_AT_ONCE_OF_TWO(f) \
    DAL_LANES(passed) DAL_LANES(all_##f)(DAL_LANES(passed), DAL_LANES(passed)) \
        __asm__(DAL_LANES_LIBRARY "vv_" #f); \
    DAL_KERNEL_INLINE dal_vec DAL_LANES(f)(dal_vec x, dal_vec y) \
    { \
        DAL_LANES(divided) d = {x}, e = {y}; \
        for (int i = 0; i < DAL_LANES(parts); i++) \
            d.part[i] = DAL_LANES(all_##f)(d.part[i], e.part[i]); \
        return d.whole; \
    }

#endif /* DAL_LANES && !DAL_N */

/* ---- the step routine, once for each set of instructions -------------------------------- */

#if defined(DAL_LANES) && defined(DAL_N)

#define dal_real dal_vec
#define dal_flag dal_mask
#define dal_exchange dal_mask
#define dal_kernel_of DAL_LANES(kernel)
#define dal_arrays_of DAL_LANES(arrays)
#define dal_masses_of DAL_LANES(masses)
#define dal_balance_of DAL_LANES(balance)
#define dal_traits_of DAL_LANES(traits)
#define dal_progress_of DAL_LANES(progress)
#define dal_momentum_traits_of DAL_LANES(momentum_traits)
#define DAL_ARRAYS(name) DAL_LANES(name)
#include <dalembert/arrays.h>

#define DAL_NUMBER(x) DAL_LANES(all_of)(x)
#define DAL_ABS(x) DAL_LANES(fabs)(x)
#define DAL_SQRT(x) DAL_LANES(square_root)(x)
#define DAL_FLAG(x) ((dal_mask){0} - (int64_t)(x))
#define DAL_SELECT(which, a, b) DAL_LANES(choose)(which, a, b)
#define DAL_TAKE(all, which, value, old) ((all) ? (value) : DAL_LANES(choose)(which, value, old))
#define DAL_ANY(which) DAL_LANES(any)(which)
#define DAL_EVERY(which) (!DAL_LANES(any)(~(which)))
#define DAL_NOT(which) (~(which))
#define DAL_AND(a, b) ((a) & (b))
#define DAL_OR(a, b) ((a) | (b))
#define DAL_ALSO(a, b) ((a) & (b))
#define DAL_COUNT_ITERATION(k, work, which) ((work)->tally[DAL_LANES_ITERATIONS] -= (which))
#define DAL_LEAVE_UNLESS(open, condition) ((open) &= (condition))
#define DAL_GOING(k) ((k)->going)
#define DAL_REFUSED(k, kind, returned) ((void)(returned), -1)
#define DAL_FAIL(k, status, kind) 1
#define DAL_FACTOR_LU(m, A, sizes, row) DAL_LANES(factor_lu)(A, sizes, row)
#define DAL_SOLVE_LU(m, A, row, b, x) DAL_LANES(solve_lu)(A, row, b, x)
#define DAL_ROWS_DOT(rows, A, a, x) DAL_NUMBER(0.0) /* there are no rows */
#define DAL_ROWS_EXTENT(rows, A, a, x) DAL_NUMBER(0.0)
#define DAL_ROWS_COLUMN(rows, A, i, c) DAL_NUMBER(0.0)
#define DAL_DRAG(k, t, q, v, V_q) 0
#define DAL_FRESH(name, size, old) dal_vec name[size]
#define DAL_EXCHANGES(name) dal_mask name[DAL_KERNEL_M * DAL_KERNEL_M]
#if DAL_M > 0
#define DAL_CONSTRAINT(k, work, which, t, q, v, mu, N) \
    ((work)->tally[DAL_LANES_CONSTRAINTS] -= (which), \
     DAL_LANES_CONSTRAINT(t, q, v, NULL, mu, N, (k)->input, (k)->p), 0)
#define DAL_FORMS(k, work, which, t, q, v, phi, mu, N) \
    ((work)->tally[DAL_LANES_CONSTRAINTS] -= (which), \
     DAL_LANES_CONSTRAINT(t, q, v, phi, mu, N, (k)->input, (k)->p), 0)
#else
#define DAL_CONSTRAINT(k, work, which, t, q, v, mu, N) ((void)(mu), 0)
#define DAL_FORMS(k, work, which, t, q, v, phi, mu, N) ((void)(mu), 0)
#endif
#ifdef DAL_LANES_FORCE
#define DAL_POTENTIAL(k, work, which, t, q, V_q) \
    ((work)->tally[DAL_LANES_FORCES] -= (which), DAL_LANES_FORCE(t, q, V_q, (k)->input, (k)->p), 0)
#define DAL_KERNEL_POTENTIAL
#else
#define DAL_POTENTIAL(k, work, which, t, q, V_q) 0
#endif
#ifdef DAL_LANES_BALANCE
#define DAL_KERNEL_MOMENTA
#define DAL_KERNEL_MASS DAL_LANES_MASS
#define DAL_KERNEL_KIND(k) DAL_LANES_KIND
#define DAL_BALANCE(k, work, which, t, q, v, L_v, F, L_vq, L_vv, F_q, F_v) \
    ((work)->tally[DAL_LANES_FORCES] -= (which), \
     DAL_LANES_BALANCE(t, q, v, L_v, F, L_vq, L_vv, F_q, F_v, (k)->input, (k)->p), 0)
#define DAL_VALUES(k, work, which, t, q, v, L_v, F, late) \
    DAL_BALANCE(k, work, which, t, q, v, L_v, F, NULL, NULL, NULL, NULL)
#define DAL_START(k, t, q, v, L_v, F) \
    (DAL_LANES_BALANCE(t, q, v, L_v, F, NULL, NULL, NULL, NULL, (k)->input, (k)->p), 0)
#define DAL_COUNT_START(counts, which) ((counts)[DAL_LANES_FORCES] -= (which))
#define DAL_WEIGHTS(name, k, s) \
    dal_vec name[4]; \
    DAL_LANES(weights)(s, (k)->known[(s)->kind], name)
#define DAL_KNOW_ONE_MORE(k, kind, which) \
    ((k)->known[kind] += DAL_LANES(count)((which) & ((k)->known[kind] < 4.0)))
#endif
#define DAL_TALLY(name) dal_mask name[DAL_LANES_COUNTED] = {{0}}
#define DAL_KERNEL DAL_LANES(step)
#define DAL_LANES_PART(name) DAL_KERNEL_JOIN(DAL_KERNEL, _##name)
#define DAL_KERNEL_LANES 1
#define DAL_KERNEL_CONSTRAINT
#define DAL_KERNEL_PATTERN DAL_LANES_PATTERN
#define DAL_KERNEL_STEADY DAL_LANES_STEADY

typedef struct DAL_LANES(stats) {
    dal_vec worst_residual;
    dal_mask counts[DAL_LANES_COUNTED]; /* integers */
} DAL_LANES(stats);

/* The members of a dal_kernel with these names, of all lanes of a vector. */
typedef struct DAL_LANES(kernel) {
    bool plain, kept, constant_rate, diagonal, formed;
    int steady;
    double shift;
    dal_vec t0, h, range[2], number, latest_span;
    dal_mask going, history_known, forced, carried;
    DAL_LANES(stats) stats;
    struct {
        dal_vec *x, *point;
    } at;
    dal_vec *dv_history, *force0, *impulse, *momentum, *forms, *latest, *history, *known;
    const dal_vec *mass, *mass_inverse, *unit, *per_unit, *p, *input;
    /* which no lane has */
    dal_vec *force1;
    int (*factor)(const struct DAL_LANES(kernel) *k, dal_vec b);
    void (*solve)(const struct DAL_LANES(kernel) *k);
} DAL_LANES(kernel);

DAL_KERNEL_INLINE dal_vec DAL_LANES(count)(dal_mask which)
{
    return DAL_LANES(choose)(which, DAL_LANES(all_of)(1.0), DAL_LANES(all_of)(0.0));
}

DAL_KERNEL_INLINE dal_vec DAL_LANES(square_root)(dal_vec x)
{
    for (int i = 0; i < DAL_LANES_VECTOR; i++) x[i] = sqrt(x[i]);
    return x;
}

/* The weights of the last changes of v, of which so many are known. */
DAL_KERNEL_INLINE void DAL_LANES(weights)(const dal_stage *s, dal_vec known, dal_vec *weight)
{
    for (size_t i = 0; i < 4; i++) weight[i] = DAL_LANES(all_of)(s->predict_4[4][i]);
    if (!DAL_LANES(any)(known < 4.0)) return;
    for (size_t count = 0; count < 4; count++)
        for (size_t i = 0; i < 4; i++)
            weight[i] = DAL_LANES(choose)(known == (double)count,
                                          DAL_LANES(all_of)(s->predict_4[count][i]), weight[i]);
}

/* ---- LU factors, as in lu.h, but with masks of the rows that were exchanged: of rows a and c, in
 * the column a */
DAL_KERNEL_INLINE void DAL_LANES(swap)(dal_mask which, dal_vec *a, dal_vec *b)
{
    const dal_vec first = *a;
    *a = DAL_LANES(choose)(which, *b, *a);
    *b = DAL_LANES(choose)(which, first, *b);
}

/* The bound of dal_lu_is_regular. */
DAL_KERNEL_INLINE dal_mask DAL_LANES(is_regular)(const dal_vec *A, const dal_vec *sizes)
{
    enum { m = DAL_M > 0 ? DAL_M : 1 };
    dal_vec x[m], largest = DAL_LANES(all_of)(1.0), bound = DAL_LANES(all_of)(0.0);
    for (size_t i = 0; i < m; i++) {
        x[i] = sizes[i];
        for (size_t k = 0; k < i; k++) x[i] += DAL_LANES(fabs)(A[i * m + k]) * x[k];
    }
    for (size_t i = m; i-- > 0;) {
        const dal_vec pivot = DAL_LANES(fabs)(A[i * m + i]), *const column = sizes + m;
        largest = DAL_LANES(choose)(pivot * largest * sizes[i] * column[i] < 1.0,
                                    1.0 / (pivot * sizes[i] * column[i]), largest);
        for (size_t k = i + 1; k < m; k++) {
            const dal_vec entry = DAL_LANES(fabs)(A[i * m + k]);
            x[i] += entry * x[k];
            largest = DAL_LANES(choose)(entry > largest * sizes[i] * column[k],
                                        entry / (sizes[i] * column[k]), largest);
        }
        x[i] *= pivot;
        bound = DAL_LANES(choose)(x[i] * column[i] <= bound, bound, x[i] * column[i]);
    }
    return bound <= DAL_LU_CONDITION / ((double)m * largest);
}

/* Returns whether A is known to be regular with a positive determinant. */
DAL_KERNEL_INLINE dal_mask DAL_LANES(factor_lu)(dal_vec *A, dal_vec *sizes, dal_mask *swapped)
{
    enum { m = DAL_M > 0 ? DAL_M : 1 };
    if (m == 1) {
        const dal_vec pivot = A[0];
        A[0] = 1.0 / pivot;
        return pivot * DAL_LU_CONDITION > sizes[0] * sizes[1];
    }
    dal_mask negative = {0};
    for (size_t j = 0; j < m; j++) {
        dal_vec best = DAL_LANES(fabs)(A[j * m + j]), size = sizes[j];
        dal_mask place = (int64_t)j - (dal_mask){0};
        for (size_t i = j + 1; i < m; i++) {
            const dal_vec entry = DAL_LANES(fabs)(A[i * m + j]);
            const dal_mask larger = entry * size > best * sizes[i];
            best = DAL_LANES(choose)(larger, entry, best);
            size = DAL_LANES(choose)(larger, sizes[i], size);
            place = (larger & (int64_t)i) | (~larger & place);
        }
        for (size_t i = j + 1; i < m; i++) {
            const dal_mask swap = swapped[j * m + i] = place == (int64_t)i;
            for (size_t k = 0; k < m; k++) DAL_LANES(swap)(swap, &A[j * m + k], &A[i * m + k]);
            DAL_LANES(swap)(swap, &sizes[j], &sizes[i]);
            negative ^= swap;
        }
        negative ^= A[j * m + j] < 0.0;
        const dal_vec inverse = 1.0 / A[j * m + j];
        A[j * m + j] = inverse;
        for (size_t i = j + 1; i < m; i++) {
            const dal_vec l = A[i * m + j] * inverse;
            A[i * m + j] = l;
            for (size_t k = j + 1; k < m; k++) A[i * m + k] -= l * A[j * m + k];
        }
    }
    return DAL_LANES(is_regular)(A, sizes) & ~negative;
}

DAL_KERNEL_INLINE void DAL_LANES(solve_lu)(const dal_vec *A, const dal_mask *swapped,
                                           const dal_vec *r, dal_vec *x)
{
    enum { m = DAL_M > 0 ? DAL_M : 1 };
    if (m == 1) {
        x[0] = r[0] * A[0];
        return;
    }
    for (size_t i = 0; i < m; i++) x[i] = r[i];
    for (size_t j = 0; j < m; j++)
        for (size_t i = j + 1; i < m; i++) DAL_LANES(swap)(swapped[j * m + i], &x[j], &x[i]);
    for (size_t i = 0; i < m; i++)
        for (size_t k = 0; k < i; k++) x[i] -= A[i * m + k] * x[k];
    for (size_t i = m; i-- > 0;) {
        for (size_t k = i + 1; k < m; k++) x[i] -= A[i * m + k] * x[k];
        x[i] *= A[i * m + i];
    }
}

/* ---- functions that differ from those for one member */

/* old <- fresh in these lanes, or in all. */
DAL_KERNEL_INLINE void DAL_LANES_PART(take)(size_t n, bool all, dal_mask which,
                                            const dal_vec *fresh, dal_vec *old)
{
    for (size_t i = 0; i < n; i++) old[i] = DAL_TAKE(all, which, fresh[i], old[i]);
}

DAL_KERNEL_INLINE void DAL_LANES_PART(pass_on)(DAL_LANES(kernel) *k, const DAL_LANES(arrays) *work,
                                               size_t n, bool ends, bool all, dal_mask made,
                                               const dal_vec *force1)
{
    if (ends) DAL_LANES_PART(take)(n, all, made, force1, k->force0);
    _Pragma("GCC unroll 8")
    for (size_t i = 0; i < DAL_LANES_COUNTED; i++)
        k->stats.counts[i] += all ? work->tally[i] : work->tally[i] & made;
}

/* Lanes stop if C has to be checked. */
DAL_KERNEL_INLINE int DAL_LANES_PART(look)(const DAL_LANES(kernel) *k,
                                           const DAL_LANES(traits) *traits,
                                           const DAL_LANES(arrays) *work, dal_mask *open)
{
    (void)traits;
    if (DAL_M == 0) return 0;
    dal_vec inverse = work->S[0];
    for (size_t a = 1; a < DAL_M; a++) inverse *= work->S[a * (DAL_M + 1)];
    inverse = DAL_LANES(fabs)(inverse);
    *open &= (inverse >= k->range[0]) & (inverse <= k->range[1]);
    return DAL_LANES(any)(*open) ? 0 : 1;
}

/* Lanes that have not made the stage stop. */
DAL_KERNEL_INLINE int DAL_LANES_PART(hand_over)(DAL_LANES(kernel) *k,
                                                const DAL_LANES(traits) *traits,
                                                const DAL_LANES(arrays) *work, dal_mask *solved,
                                                const dal_mask *made)
{
    (void)traits, (void)work, (void)solved;
    k->going = *made;
    return 0;
}

#ifdef DAL_KERNEL_MOMENTA
/* The terms of phi at a moved state are not evaluated: lanes that need them stop. */
DAL_KERNEL_INLINE dal_mask DAL_LANES_PART(is_moved)(const DAL_LANES(kernel) *k,
                                                    const DAL_LANES(traits) *traits,
                                                    const DAL_LANES(momentum_traits) *mom,
                                                    const DAL_LANES(arrays) *work, dal_mask which,
                                                    dal_mask *open)
{
    (void)k, (void)traits, (void)work;
    if (!mom->linear) *open &= ~which;
    return (dal_mask){0};
}
#endif

enum { DAL_LANES(n) = DAL_N, DAL_LANES(m) = DAL_M };
#include <dalembert/kernel.h>

/* ---- steps */
#define DAL_KERNEL DAL_LANES(step)

static void DAL_LANES(open)(const dal_lanes_block *block, const dal_lanes_layout *at,
                            dal_vec *numbers, DAL_LANES(kernel) *k)
{
    *k = (DAL_LANES(kernel)){
        .plain = block->plain, .constant_rate = block->constant_rate, .steady = block->steady,
        .t0 = numbers[at->t0], .h = numbers[at->h],
        .range = {numbers[at->range], numbers[at->range + 1]}, .number = numbers[at->number],
        .going = numbers[at->going] != 0.0, .history_known = numbers[at->history_known] != 0.0,
        .forced = numbers[at->forced] != 0.0, .carried = numbers[at->carried] != 0.0,
        .stats.worst_residual = numbers[at->worst],
        .at = {numbers + at->x, numbers + at->point}, .dv_history = numbers + at->dv_history,
        .force0 = numbers + at->force, .impulse = numbers + at->impulse,
        .momentum = numbers + at->momentum, .forms = numbers + at->forms,
        .latest = numbers + at->latest, .history = numbers + at->history,
        .known = numbers + at->known, .mass = numbers + at->mass,
        .mass_inverse = numbers + at->mass_inverse, .unit = numbers + at->unit,
        .per_unit = numbers + at->per_unit, .p = numbers + at->parameters,
        .input = numbers + at->inputs};
    if (block->momenta) k->latest_span = numbers[at->latest_span];
    for (size_t i = 0; i < DAL_LANES_COUNTED; i++)
        k->stats.counts[i] = __builtin_convertvector(numbers[at->counts + i], dal_mask);
}

static void DAL_LANES(close)(const dal_lanes_block *block, const dal_lanes_layout *at,
                             const DAL_LANES(kernel) *k, dal_vec *numbers)
{
    numbers[at->number] = k->number;
    numbers[at->going] = DAL_LANES(count)(k->going);
    numbers[at->history_known] = DAL_LANES(count)(k->history_known);
    numbers[at->forced] = DAL_LANES(count)(k->forced);
    numbers[at->carried] = DAL_LANES(count)(k->carried);
    if (block->momenta) numbers[at->latest_span] = k->latest_span;
    numbers[at->worst] = k->stats.worst_residual;
    for (size_t i = 0; i < DAL_LANES_COUNTED; i++)
        numbers[at->counts + i] = __builtin_convertvector(k->stats.counts[i], dal_vec);
}

/* Keeps the arrays that a step of several stages may have to restore. */
DAL_KERNEL_INLINE void DAL_LANES(save)(const dal_lanes_layout *at, const dal_vec *numbers,
                                       dal_vec *saved)
{
    for (size_t i = at->x; i < at->end; i++) saved[i] = numbers[i];
}

/* Restores the lanes that have not made all stages of a step to the state before it. */
static void DAL_LANES(take_back)(const dal_lanes_layout *at, const dal_vec *saved,
                                 const DAL_LANES(kernel) *before, dal_vec *numbers,
                                 DAL_LANES(kernel) *k)
{
    const dal_mask going = k->going;
    for (size_t i = at->x; i < at->end; i++)
        numbers[i] = DAL_LANES(choose)(going, numbers[i], saved[i]);
    k->history_known = (k->history_known & going) | (before->history_known & ~going);
    k->forced = (k->forced & going) | (before->forced & ~going);
    k->carried = (k->carried & going) | (before->carried & ~going);
    k->latest_span = DAL_LANES(choose)(going, k->latest_span, before->latest_span);
    k->stats.worst_residual =
        DAL_LANES(choose)(going, k->stats.worst_residual, before->stats.worst_residual);
    for (size_t i = 0; i < DAL_LANES_COUNTED; i++)
        k->stats.counts[i] = (k->stats.counts[i] & going) | (before->stats.counts[i] & ~going);
}

/* A stage of the active lanes. */
DAL_KERNEL_INLINE void DAL_LANES(make_stage)(const dal_lanes_block *block, DAL_LANES(kernel) *k,
                                             const dal_stage *s)
{
    if (!DAL_LANES(any)(k->going)) return;
#ifdef DAL_LANES_BALANCE
    (void)block;
    (void)DAL_LANES_PART(stage_of_either)(k, k->number, s, NULL, k->at.x, k->dv_history);
#else
    if (block->plain)
        (void)DAL_LANES_PART(plain_stage)(k, k->number, s, NULL, k->at.x, k->dv_history);
    else
        (void)DAL_LANES_PART(stage_in_general)(k, k->number, s, NULL, k->at.x, k->dv_history);
#endif
}

static void DAL_LANES(advance)(const dal_lanes_block *block, size_t steps)
{
    enum { INTERLEAVED = DAL_LANES_INTERLEAVED };
    const dal_lanes_layout at = dal_lanes_layout_of(
        DAL_LANES(n), DAL_LANES(m), block->momenta, block->kinds, block->parameters, block->inputs);
    const bool several = block->stages > 1;
    dal_vec *numbers[INTERLEAVED], *saved[INTERLEAVED];
    DAL_LANES(kernel) kernel[INTERLEAVED], before[INTERLEAVED];
    for (size_t b = 0; b < INTERLEAVED; b++) {
        numbers[b] = (dal_vec *)block->numbers + b * at.count;
        saved[b] = (dal_vec *)block->saved + b * at.count;
        DAL_LANES(open)(block, &at, numbers[b], &kernel[b]);
    }
    for (size_t step = 0; step < steps; step++) {
        dal_mask some = {0};
        for (size_t b = 0; b < INTERLEAVED; b++) {
            some |= kernel[b].going;
            kernel[b].formed = false;
            if (!several) continue;
            before[b] = kernel[b];
            DAL_LANES(save)(&at, numbers[b], saved[b]);
        }
        if (!DAL_LANES(any)(some)) break;
        for (const dal_stage *s = block->stage; s < block->stage + block->stages; s++)
            for (size_t b = 0; b < INTERLEAVED; b++) DAL_LANES(make_stage)(block, &kernel[b], s);
        for (size_t b = 0; b < INTERLEAVED; b++) {
            if (several && DAL_LANES(any)(before[b].going & ~kernel[b].going))
                DAL_LANES(take_back)(&at, saved[b], &before[b], numbers[b], &kernel[b]);
            kernel[b].number += DAL_LANES(count)(kernel[b].going);
        }
    }
    for (size_t b = 0; b < INTERLEAVED; b++)
        DAL_LANES(close)(block, &at, &kernel[b], numbers[b]);
}

#undef DAL_KERNEL
#undef DAL_LANES_PART
#undef DAL_LANES_FORCE
#undef DAL_LANES_BALANCE
#undef DAL_LANES_MASS
#undef DAL_LANES_KIND
#undef DAL_LANES_CONSTRAINT
#undef DAL_LANES_PATTERN
#undef DAL_LANES_STEADY
#undef DAL_LANES_VECTOR
#undef DAL_LANES
#undef dal_vec
#undef dal_mask
#endif /* DAL_LANES && DAL_N */
