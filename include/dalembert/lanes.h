/* lanes.h - the step routine of kernel.h for several members of an ensemble at once.
 *
 * Each member has a lane: its own time, step, masses, parameters and state.  A number in kernel.h
 * is here a vector with a component for each lane, which fits into a register.  A lane executes the
 * operations of kernel.h in their order, so its results do not depend on other lanes.  Without
 * functions of a vector math library they are bitwise those of kernel.h.  If one lane needs an
 * operation, all execute it, and the others discard the result: a lane that has converged is
 * frozen.
 *
 * This is the fast path alone: moved nodes, constant mass, linear constraints, callbacks that never
 * refuse, no force that depends on v.  A lane stops before a step in which kernel.h would call
 * dal_kernel.finish or look.  It also stops if only an estimate of the inverse could show that S is
 * regular.  The step routine of kernel.h then continues from there.
 *
 * One text, a compilation for each set of instructions.  The includer defines
 *     DAL_LANES(name)             that name with an ending of its own for each set
 *     DAL_LANES_VECTOR            lanes of a vector: 8 for AVX-512, 4 for AVX2, 2 for what all have
 * and includes this file, which declares dal_vec, dal_mask and the functions that callbacks need;
 * then it defines
 *     DAL_N, DAL_M                the sizes, DAL_N <= 8
 *     DAL_LANES_PATTERN, DAL_LANES_STEADY   as those of kernel.h, both needed
 *     DAL_LANES_CONSTRAINT(t, q, v, mu, N, p)   unless DAL_M is 0; mu or N may be NULL
 *     DAL_LANES_PULL(t, q, V_q, p)              where there is a V
 * and includes it again.  That makes the function DAL_LANES(advance), a dal_lanes_fn.  All of it
 * stands where the compiler was told to use the set.  Build with -ffp-contract=off. */
#ifndef DALEMBERT_LANES_H
#define DALEMBERT_LANES_H

#include <dalembert/kernel.h>

#include <stdint.h>

/* Vectors that take turns in making a stage, so that one need not wait for its own results.
 * Measured: worth a third with AVX2. */
enum { DAL_LANES_TURNS = 2 };

/* The common data of all lanes, and the arrays of the lanes, one set for each vector in turn. */
typedef struct dal_lanes_block {
    const dal_stage *stage;
    size_t stages;
    bool plain, steady;  /* as of a dal_kernel */
    size_t parameters;
    double *given;       /* t0, h, range[2], M^-1[n*n], unit[n], per_unit[n], parameters[] */
    double *carried;     /* from step to step, see below */
} dal_lanes_block;

/* The places of the vectors in carried.  A flag is 1 or 0.  The counters count the operations of
 * this routine. */
enum {
    DAL_LANES_GOING, DAL_LANES_PULLED, DAL_LANES_FORCED, /* flags */
    DAL_LANES_NUMBER, DAL_LANES_WORST,                   /* of the step; residual */
    DAL_LANES_ITERATIONS, DAL_LANES_CONSTRAINT_CALLS, DAL_LANES_PULL_CALLS,
    DAL_LANES_X /* [2n], then pull[3n], low[2n], force[n], impulse[m], at least one */
};

/* Takes a number of steps of the active lanes. */
typedef void (*dal_lanes_fn)(const dal_lanes_block *block, size_t steps);

/* A compilation.  The member lanes of a dal_compiled points to an array of these, the widest first,
 * that ends with vector = 0. */
struct dal_lanes_routine {
    size_t vector, parameters; /* lanes of a vector; parameters of the system */
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
    DAL_KERNEL_APART dal_vec DAL_LANES(f)(dal_vec x) \
    { \
        for (int i = 0; i < DAL_LANES_VECTOR; i++) x[i] = f(x[i]); \
        return x; \
    }
#define DAL_LANES_EACH_OF_TWO(f) \
    DAL_KERNEL_APART dal_vec DAL_LANES(f)(dal_vec x, dal_vec y) \
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

#define DAL_LANES_ROWS (DAL_M > 0 ? DAL_M : 1)
#ifdef DAL_LANES_PULL
#define DAL_LANES_HAS_PULL true
#else
#define DAL_LANES_HAS_PULL false
#define DAL_LANES_PULL(t, q, V_q, p) ((void)(t), (void)(q), (void)(V_q), (void)(p))
#endif
#if DAL_M == 0
#define DAL_LANES_CONSTRAINT(t, q, v, mu, N, p) ((void)(t), (void)(q), (void)(v), (void)(mu))
#endif

/* The vectors of dal_lanes_block.carried and .given. */
typedef struct DAL_LANES(state) {
    dal_vec going, pulled, forced, number, worst, iterations, constraint_calls, pull_calls;
    dal_vec x[2 * DAL_N], pull[3 * DAL_N], low[2 * DAL_N], force[DAL_N], impulse[DAL_LANES_ROWS];
} DAL_LANES(state);

typedef struct DAL_LANES(given) {
    dal_vec t0, h, range[2], mass_inverse[DAL_N * DAL_N], unit[DAL_N], per_unit[DAL_N], p[];
} DAL_LANES(given);

typedef struct DAL_LANES(traits) {
    const dal_stage *stage;
    const DAL_LANES(given) *given;
    dal_vec h, t_end;
    dal_pattern has;
    bool plain, steady, turns, ends, known, apart;
} DAL_LANES(traits);

/* As in dal_arrays; force is V_q at q~'. */
typedef struct DAL_LANES(arrays) {
    dal_vec node[DAL_N], w[DAL_N], base[DAL_N], goal[DAL_N], step[DAL_N], seen[DAL_N];
    dal_vec stored[DAL_N], from[DAL_N], lead[DAL_N], push[DAL_N], move[2 * DAL_N], force[DAL_N];
    dal_vec mu_node[DAL_LANES_ROWS * DAL_N], mu[DAL_LANES_ROWS * DAL_N], N[DAL_LANES_ROWS * DAL_N];
    dal_vec Z[DAL_LANES_ROWS * DAL_N], S[DAL_LANES_ROWS * DAL_LANES_ROWS];
    dal_vec sizes[2 * DAL_LANES_ROWS];
    dal_mask swapped[DAL_LANES_ROWS * DAL_LANES_ROWS]; /* rows a and c, in the column a */
    dal_vec r[DAL_LANES_ROWS], d[DAL_LANES_ROWS], kappa[DAL_LANES_ROWS];
    dal_vec last;
    dal_mask anew, passed;
    dal_mask open, solved, settled; /* being iterated; done; and with the residual that it needs */
    dal_vec iterations, constraint_calls, pull_calls;
} DAL_LANES(arrays);

DAL_KERNEL_INLINE dal_vec DAL_LANES(count)(dal_mask which)
{
    return DAL_LANES(choose)(which, DAL_LANES(all_of)(1.0), DAL_LANES(all_of)(0.0));
}

DAL_KERNEL_INLINE dal_vec DAL_LANES(time)(const DAL_LANES(given) *given, const DAL_LANES(state) *c,
                                          double part)
{
    return given->t0 + (c->number + part) * given->h;
}

DAL_KERNEL_INLINE dal_vec DAL_LANES(mass_inverse)(const DAL_LANES(traits) *o, size_t e)
{
    if (o->has.one >> e / DAL_N & 1)
        return DAL_LANES(all_of)(e % (DAL_N + 1) == 0 ? 1.0 : 0.0);
    return o->given->mass_inverse[e];
}

/* Number i of unit or per_unit. */
DAL_KERNEL_INLINE dal_vec DAL_LANES(scale)(const DAL_LANES(traits) *o, const dal_vec *scales,
                                           size_t i)
{
    return o->has.one >> i & 1 ? DAL_LANES(all_of)(1.0) : scales[i];
}

DAL_KERNEL_INLINE dal_vec DAL_LANES(dot)(unsigned long long mask, const dal_vec *A, size_t a,
                                         const dal_vec *x)
{
    dal_vec sum = DAL_LANES(all_of)(-0.0);
    for (size_t i = 0; i < DAL_N; i++)
        if (DAL_KERNEL_HAS(mask, a * DAL_N + i)) sum += A[a * DAL_N + i] * x[i];
    return sum;
}

DAL_KERNEL_INLINE dal_vec DAL_LANES(column)(unsigned long long mask, const dal_vec *Z, size_t i,
                                            const dal_vec *c)
{
    dal_vec sum = DAL_LANES(all_of)(-0.0);
    for (size_t a = 0; a < DAL_M; a++)
        if (DAL_KERNEL_HAS(mask, a * DAL_N + i)) sum += Z[a * DAL_N + i] * c[a];
    return sum;
}

DAL_KERNEL_INLINE void DAL_LANES(accelerate)(const DAL_LANES(traits) *o, const dal_vec *f,
                                             dal_vec *y)
{
    for (size_t i = 0; i < DAL_N; i++) {
        y[i] = DAL_LANES(all_of)(-0.0);
        for (size_t j = 0; j < DAL_N; j++)
            if (DAL_KERNEL_HAS(o->has.inverse, i * DAL_N + j))
                y[i] += DAL_LANES(mass_inverse)(o, i * DAL_N + j) * f[j];
    }
}

DAL_KERNEL_INLINE dal_vec DAL_LANES(form)(const DAL_LANES(traits) *o, const dal_vec *mu, size_t a)
{
    dal_vec sum = DAL_LANES(all_of)(-0.0);
    for (size_t i = 0; i < DAL_N; i++)
        if (DAL_KERNEL_HAS(o->has.mu, a * DAL_N + i))
            sum += DAL_LANES(fabs)(mu[a * DAL_N + i]) * DAL_LANES(scale)(o, o->given->unit, i);
    return sum;
}

DAL_KERNEL_INLINE dal_vec DAL_LANES(speed)(const DAL_LANES(traits) *o, const dal_vec *v)
{
    dal_vec most = DAL_LANES(all_of)(0.0);
    for (size_t i = 0; i < DAL_N; i++) {
        const dal_vec speed = DAL_LANES(fabs)(v[i]) * DAL_LANES(scale)(o, o->given->per_unit, i);
        most = DAL_LANES(choose)(speed > most, speed, most);
    }
    return most;
}

/* ---- LU factors, as in lu.h; true if S is known to be regular with a positive determinant */
DAL_KERNEL_INLINE void DAL_LANES(swap)(dal_mask which, dal_vec *a, dal_vec *b)
{
    const dal_vec first = *a;
    *a = DAL_LANES(choose)(which, *b, *a);
    *b = DAL_LANES(choose)(which, first, *b);
}

/* The bound of dal_lu_is_regular. */
DAL_KERNEL_INLINE dal_mask DAL_LANES(is_regular)(const dal_vec *A, const dal_vec *sizes)
{
    enum { m = DAL_LANES_ROWS };
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

DAL_KERNEL_INLINE dal_mask DAL_LANES(factor_lu)(DAL_LANES(arrays) *at)
{
    enum { m = DAL_LANES_ROWS };
    dal_vec *const A = at->S, *const sizes = at->sizes;
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
            const dal_mask swap = at->swapped[j * m + i] = place == (int64_t)i;
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

DAL_KERNEL_INLINE void DAL_LANES(solve)(const DAL_LANES(arrays) *at, const dal_vec *r, dal_vec *x)
{
    enum { m = DAL_LANES_ROWS };
    const dal_vec *const A = at->S;
    if (m == 1) {
        x[0] = r[0] * A[0];
        return;
    }
    for (size_t i = 0; i < m; i++) x[i] = r[i];
    for (size_t j = 0; j < m; j++)
        for (size_t i = j + 1; i < m; i++) DAL_LANES(swap)(at->swapped[j * m + i], &x[j], &x[i]);
    for (size_t i = 0; i < m; i++)
        for (size_t k = 0; k < i; k++) x[i] -= A[i * m + k] * x[k];
    for (size_t i = m; i-- > 0;) {
        for (size_t k = i + 1; k < m; k++) x[i] -= A[i * m + k] * x[k];
        x[i] *= A[i * m + i];
    }
}

/* ---- predict */
DAL_KERNEL_INLINE void DAL_LANES(kick)(const DAL_LANES(traits) *o, DAL_LANES(state) *c,
                                       DAL_LANES(arrays) *at)
{
    const dal_stage *const s = o->stage;
    const bool at_node = o->plain || s->node != 0.0;
    const dal_vec *force = at->force;
    dal_vec y[DAL_N];
    if (at_node) {
        DAL_LANES_PULL(DAL_LANES(time)(o->given, c, s->t_node), at->node, at->force, o->given->p);
        at->pull_calls += 1.0;
    } else {
        const dal_mask unknown = c->forced == 0.0;
        if (DAL_LANES(any)(unknown & at->open)) {
            DAL_LANES_PULL(DAL_LANES(time)(o->given, c, s->t_start), c->x, at->force, o->given->p);
            for (size_t i = 0; i < DAL_N; i++)
                c->force[i] = DAL_LANES(choose)(unknown, at->force[i], c->force[i]);
            at->pull_calls += DAL_LANES(count)(unknown);
        }
        force = c->force;
    }
    const dal_vec weight = o->h * (at_node ? s->node : s->start);
    DAL_LANES(accelerate)(o, force, y);
    for (size_t i = 0; i < DAL_N; i++)
        if (DAL_KERNEL_HAS(o->has.kick, i)) {
            at->push[i] -= weight * y[i];
            at->base[i] -= weight * y[i];
        }
}

/* As dal_kernel_leave. */
DAL_KERNEL_INLINE dal_vec DAL_LANES(leave)(const DAL_LANES(traits) *o, const DAL_LANES(state) *c,
                                           const DAL_LANES(arrays) *at, size_t i, dal_vec w,
                                           dal_vec way)
{
    const dal_vec next = at->from[i] + way;
    if (!o->turns || o->stage->before != o->stage->after) return next;
    const dal_mask even = (w == c->x[DAL_N + i]) & (c->low[DAL_N + i] == 0.0);
    return DAL_LANES(choose)(even, at->node[i] + (at->node[i] - c->x[i]), next);
}

DAL_KERNEL_INLINE void DAL_LANES(predict)(const DAL_LANES(traits) *o, DAL_LANES(state) *c,
                                          DAL_LANES(arrays) *at)
{
    const dal_stage *const s = o->stage;
    const dal_vec *const x = c->x, *const pull = c->pull;
    const dal_vec before = s->before * o->h, b = s->after * o->h;
    for (size_t i = 0; i < DAL_N; i++) {
        const dal_vec way = before * x[DAL_N + i], near = x[i] + way;
        at->lead[i] = c->low[i] + way;
        at->from[i] = near + c->low[i];
        at->node[i] = s->linear ? at->from[i] : near;
        if (o->turns) {
            const dal_mask even = c->low[DAL_N + i] == 0.0;
            at->from[i] = DAL_LANES(choose)(even, x[i] + (0.5 * c->low[i] + way), at->from[i]);
            at->node[i] = DAL_LANES(choose)(even, at->from[i], at->node[i]);
        }
        at->push[i] = c->low[DAL_N + i];
        at->base[i] = x[DAL_N + i] + c->low[DAL_N + i];
    }
    if (DAL_LANES_HAS_PULL && !o->apart) DAL_LANES(kick)(o, c, at);
    for (size_t i = 0; i < DAL_N; i++) {
        const bool pulled = !o->steady && DAL_KERNEL_HAS(o->has.pull, i);
        dal_vec early = o->steady || DAL_LANES_HAS_PULL ? at->base[i] : x[DAL_N + i];
        if (pulled) early += s->ahead[1] * pull[DAL_N + i] + s->ahead[2] * pull[2 * DAL_N + i];
        at->w[i] = early;
        at->stored[i] = o->steady || o->turns ? DAL_LANES(leave)(o, c, at, i, early, b * early)
                                              : at->node[i] + b * early;
        if (pulled) {
            at->w[i] += s->ahead[0] * pull[i];
            at->stored[i] += b * s->ahead[0] * pull[i];
        }
    }
}

/* ---- factor: S at the prediction, which lies in stored */
DAL_KERNEL_INLINE void DAL_LANES(form_S)(const DAL_LANES(traits) *o, DAL_LANES(arrays) *at)
{
    enum { m = DAL_M };
    const dal_vec b = o->stage->after * o->h;
    dal_vec terms = DAL_LANES(all_of)(-0.0);
    for (size_t a = 0; a < m; a++) {
        dal_vec size = DAL_LANES(all_of)(-0.0);
        for (size_t c = 0; c < m; c++) at->S[a * m + c] = DAL_LANES(all_of)(-0.0);
        for (size_t i = 0; i < DAL_N; i++) {
            const bool turns = DAL_KERNEL_HAS(o->has.N, a * DAL_N + i);
            if (!turns && !DAL_KERNEL_HAS(o->has.mu, a * DAL_N + i)) continue;
            const dal_vec mu = at->mu[a * DAL_N + i];
            const dal_vec row = turns ? mu + b * at->N[a * DAL_N + i] : mu;
            const dal_vec entry =
                turns ? DAL_LANES(fabs)(mu) + DAL_LANES(fabs)(row) : DAL_LANES(fabs)(mu);
            if (m > 1) size += entry * DAL_LANES(scale)(o, o->given->unit, i);
            for (size_t c = 0; c < m; c++) {
                if (!DAL_KERNEL_HAS(o->has.Z, c * DAL_N + i)) continue;
                const dal_vec Z = at->Z[c * DAL_N + i], term = row * Z;
                at->S[a * m + c] += term;
                terms += turns ? entry * DAL_LANES(fabs)(Z) : DAL_LANES(fabs)(term);
            }
        }
        at->sizes[a] = m > 1 ? size : terms;
        at->sizes[m + a] = m > 1 ? DAL_LANES(form)(o, at->mu_node, a) : DAL_LANES(all_of)(1.0);
    }
}

DAL_KERNEL_INLINE dal_mask DAL_LANES(factor)(const DAL_LANES(traits) *o, DAL_LANES(state) *c,
                                             DAL_LANES(arrays) *at)
{
    const dal_stage *const s = o->stage;
    const dal_vec *const p = o->given->p;
    if (DAL_M > 0) {
        if (!s->linear)
            DAL_LANES_CONSTRAINT(o->t_end, at->stored, at->w, at->mu, o->steady ? NULL : at->N, p);
        DAL_LANES_CONSTRAINT(DAL_LANES(time)(o->given, c, s->t_node), at->node, c->x + DAL_N,
                             at->mu_node, NULL, p);
        at->constraint_calls += s->linear ? 1.0 : 2.0;
        for (size_t a = 0; a < DAL_M; a++)
            DAL_LANES(accelerate)(o, at->mu_node + a * DAL_N, at->Z + a * DAL_N);
    }
    for (size_t e = 0; e < DAL_M * DAL_N; e++) {
        if (s->linear) at->mu[e] = at->mu_node[e];
        if (s->linear || (o->steady && o->has.N)) at->N[e] = DAL_LANES(all_of)(0.0);
    }
    if (o->ends) {
        DAL_LANES_PULL(o->t_end, at->stored, at->force, p);
        at->pull_calls += 1.0;
    }
    if (DAL_M == 0) return at->open;
    DAL_LANES(form_S)(o, at);
    const dal_mask regular = DAL_LANES(factor_lu)(at);
    dal_vec inverse = at->S[0];
    for (size_t a = 1; a < DAL_M; a++) inverse *= at->S[a * (DAL_M + 1)];
    inverse = DAL_LANES(fabs)(inverse);
    return regular & at->open & (inverse >= o->given->range[0]) & (inverse <= o->given->range[1]);
}

/* ---- iterate */

/* r <- -mu w; returns those of these lanes whose residual is within half of its bound. */
DAL_KERNEL_INLINE dal_mask DAL_LANES(find_settled)(const DAL_LANES(traits) *o, DAL_LANES(state) *c,
                                                   DAL_LANES(arrays) *at, dal_mask which)
{
    if (DAL_M == 0) return which;
    const dal_vec limit = DAL_LANES(all_of)(DAL_KERNEL_LIMIT(DAL_N));
    const dal_vec speed = DAL_LANES(speed)(o, at->w);
    const dal_vec seen = DAL_LANES(choose)(c->worst < limit, c->worst, limit) * speed;
    dal_vec sum[DAL_LANES_ROWS], form[DAL_LANES_ROWS], largest = c->worst;
    dal_mask rare[DAL_LANES_ROWS], some = {0}, settled = which;
    for (size_t a = 0; a < DAL_M; a++) {
        const dal_vec product = DAL_LANES(dot)(o->has.mu, at->mu, a, at->w);
        form[a] = DAL_LANES(form)(o, at->mu, a);
        at->r[a] = -product;
        sum[a] = DAL_LANES(fabs)(product);
        rare[a] = which & ~(form[a] * seen > sum[a]);
        some |= rare[a];
    }
    if (!DAL_LANES(any)(some)) return which;
    for (size_t a = 0; a < DAL_M; a++) {
        settled &= ~rare[a] | (form[a] * (limit * speed) - sum[a] >= 0.0);
        largest = DAL_LANES(choose)(rare[a] & (sum[a] > largest * (form[a] * speed)),
                                    sum[a] / (form[a] * speed), largest);
    }
    c->worst = DAL_LANES(choose)(settled, largest, c->worst);
    return settled;
}

DAL_KERNEL_INLINE dal_mask DAL_LANES(is_roundoff)(const DAL_LANES(traits) *o,
                                                  const DAL_LANES(arrays) *at)
{
    const dal_vec terms = DAL_LANES(speed)(o, at->w) + DAL_LANES(speed)(o, at->goal);
    dal_mask roundoff = at->open;
    for (size_t a = 0; a < DAL_M; a++) {
        dal_vec shifted = DAL_LANES(all_of)(0.0);
        for (size_t i = 0; i < DAL_N; i++)
            if (DAL_KERNEL_HAS(o->has.N, a * DAL_N + i))
                shifted += DAL_LANES(fabs)(at->N[a * DAL_N + i])
                         * (DAL_LANES(fabs)(at->stored[i]) + DAL_LANES(fabs)(at->stored[i]));
        const dal_vec bound = 2.0 * (double)DAL_N * DAL_LANES(form)(o, at->mu, a) * terms;
        roundoff &=
            2.0 * DAL_KERNEL_U * (bound + shifted) - DAL_LANES(fabs)(at->r[a]) >= 0.0;
    }
    return roundoff;
}

/* The new value in these lanes; in all lanes if no others matter, so that nothing waits for which.
 */
#define DAL_LANES_TAKE(all, which, value, old) \
    ((all) ? (value) : DAL_LANES(choose)(which, value, old))

DAL_KERNEL_INLINE void DAL_LANES(newton)(const DAL_LANES(traits) *o, const DAL_LANES(state) *c,
                                         DAL_LANES(arrays) *at, bool first, bool all)
{
    const dal_stage *const s = o->stage;
    const dal_vec b = s->after * o->h, *const seen = o->ends ? at->seen : at->w;
    dal_vec y[DAL_N], r[DAL_LANES_ROWS], d[DAL_LANES_ROWS];
    if (o->ends) DAL_LANES(accelerate)(o, at->force, y);
    for (size_t i = 0; i < DAL_N; i++) {
        const dal_vec kick = o->ends && DAL_KERNEL_HAS(o->has.kick, i)
                               ? o->h * s->end * y[i] : DAL_LANES(all_of)(0.0);
        at->move[DAL_N + i] = at->push[i] - kick;
        at->goal[i] = at->base[i] - kick;
        at->step[i] = at->goal[i];
        if (!first && DAL_M > 0 && DAL_KERNEL_HAS(o->has.pull, i))
            at->step[i] += DAL_LANES(column)(o->has.Z, at->Z, i, at->kappa);
    }
    for (size_t a = 0; a < DAL_M; a++) {
        dal_vec sum = DAL_LANES(dot)(o->has.mu, at->mu, a, at->step);
        if (o->has.N) {
            dal_vec turn = DAL_LANES(all_of)(-0.0);
            for (size_t i = 0; i < DAL_N; i++)
                if (DAL_KERNEL_HAS(o->has.N, a * DAL_N + i) && DAL_KERNEL_HAS(o->has.pull, i))
                    turn += at->N[a * DAL_N + i] * (at->step[i] - seen[i]);
            sum += b * turn;
        }
        r[a] = -sum;
    }
    if (DAL_M > 0) DAL_LANES(solve)(at, r, d);
    for (size_t a = 0; a < DAL_M; a++)
        at->kappa[a] = first ? d[a]
                     : DAL_LANES_TAKE(all, at->open, at->kappa[a] + d[a], at->kappa[a]);
    for (size_t i = 0; i < DAL_N; i++) {
        if (!DAL_KERNEL_HAS(o->has.pull, i)) continue;
        const dal_vec reaction = DAL_LANES(column)(o->has.Z, at->Z, i, at->kappa);
        const dal_vec next = at->goal[i] + reaction;
        at->move[DAL_N + i] += reaction;
        at->step[i] = next - at->w[i];
        at->w[i] = next; /* a frozen lane keeps its value */
    }
    for (size_t i = 0; i < DAL_N; i++) {
        const dal_vec way = b * at->w[i];
        at->move[i] = at->lead[i] + way;
        at->stored[i] = DAL_LANES(leave)(o, c, at, i, at->w[i], way);
    }
}

/* Whether corrections continue to shrink; balanced <- the lanes in which V_q need not be evaluated
 * again. */
DAL_KERNEL_INLINE void DAL_LANES(judge)(const DAL_LANES(traits) *o, DAL_LANES(arrays) *at,
                                        dal_mask *balanced, bool first)
{
    const dal_stage *const s = o->stage;
    dal_vec size = DAL_LANES(all_of)(-0.0), extent = DAL_LANES(all_of)(-0.0);
    for (size_t i = 0; i < DAL_N; i++) {
        const dal_vec per_unit = DAL_LANES(scale)(o, o->given->per_unit, i);
        if (DAL_KERNEL_HAS(o->has.pull, i)) size += DAL_LANES(fabs)(at->step[i]) * per_unit;
        extent += DAL_LANES(fabs)(at->goal[i]) * per_unit;
    }
    const dal_vec noise = 8.0 * DAL_KERNEL_U * extent;
    if (!first) /* else it may be larger */
        at->open &= at->anew | (size <= 0.5 * at->last) | (size <= noise);
    if (o->ends) {
        const dal_vec next = first ? DAL_LANES(all_of)(0.0) : size * (size / at->last);
        *balanced = size <= noise;
        if (!first)
            *balanced |= ~at->anew
                       & (DAL_KERNEL_SAFETY * next * s->reuse <= noise * fabs(s->end));
        at->anew = at->passed & *balanced;
        at->passed = ~*balanced & (next <= DAL_KERNEL_PASSING * noise);
    } else {
        at->anew = (dal_mask){0};
    }
    at->last = size;
}

/* One correction of the lanes that are open.  The arguments first and all are constants after
 * inlining. */
DAL_KERNEL_INLINE void DAL_LANES(correct)(const DAL_LANES(traits) *o, DAL_LANES(state) *c,
                                          DAL_LANES(arrays) *at, bool first, bool all)
{
    const dal_vec *const p = o->given->p;
    dal_mask balanced = ~(dal_mask){0};
    at->iterations += DAL_LANES(count)(at->open);
    DAL_LANES(newton)(o, c, at, first, all);
    if (!o->known || o->ends) DAL_LANES(judge)(o, at, &balanced, first);
    dal_mask look = at->open;
    if (o->ends) look &= ~at->passed;
    if (!o->known && DAL_LANES(any)(look)) {
        dal_vec mu[DAL_LANES_ROWS * DAL_N];
        DAL_LANES_CONSTRAINT(o->t_end, at->stored, at->w, mu, NULL, p);
        at->constraint_calls += DAL_LANES(count)(look);
        if (all && !(o->ends && DAL_LANES(any)(at->open & ~look))) {
            for (size_t e = 0; e < DAL_M * DAL_N; e++) at->mu[e] = mu[e];
            for (size_t i = 0; o->ends && i < DAL_N; i++) at->seen[i] = at->w[i];
        } else {
            for (size_t e = 0; e < DAL_M * DAL_N; e++)
                at->mu[e] = DAL_LANES(choose)(look, mu[e], at->mu[e]);
            for (size_t i = 0; o->ends && i < DAL_N; i++)
                at->seen[i] = DAL_LANES(choose)(look, at->w[i], at->seen[i]);
        }
    }
    const dal_mask again = at->open & ~balanced;
    if (o->ends && DAL_LANES(any)(again)) {
        dal_vec force[DAL_N];
        DAL_LANES_PULL(o->t_end, at->stored, force, p);
        at->pull_calls += DAL_LANES(count)(again);
        if (all && !DAL_LANES(any)(at->open & balanced)) {
            for (size_t i = 0; i < DAL_N; i++) at->force[i] = force[i];
            return;
        }
        for (size_t i = 0; i < DAL_N; i++)
            at->force[i] = DAL_LANES(choose)(again, force[i], at->force[i]);
    }
    const dal_mask last = at->open & balanced;
    const dal_mask settled = DAL_LANES(find_settled)(o, c, at, last);
    at->settled |= settled;
    dal_mask done = o->known ? last : settled;
    if (!o->known && DAL_LANES(any)(last & ~settled))
        done |= last & DAL_LANES(is_roundoff)(o, at);
    at->solved |= done;
    at->open &= ~done;
}

/* ---- settle, commit */
DAL_KERNEL_INLINE void DAL_LANES(settle)(const DAL_LANES(traits) *o, DAL_LANES(state) *c,
                                         DAL_LANES(arrays) *at)
{
    const dal_mask rest = at->solved & ~at->settled;
    if (DAL_M > 0 && DAL_LANES(any)(rest)) {
        DAL_LANES(solve)(at, at->r, at->d);
        for (size_t i = 0; i < DAL_N; i++) {
            const dal_vec mended = DAL_LANES(choose)(
                rest, at->w[i] + DAL_LANES(column)(o->has.Z, at->Z, i, at->d), at->w[i]);
            at->move[DAL_N + i] += mended - at->w[i];
            at->w[i] = mended;
        }
        at->settled |= DAL_LANES(find_settled)(o, c, at, rest);
    }
    dal_vec total = DAL_LANES(all_of)(-0.0);
    for (size_t i = 0; i < DAL_N; i++) total += at->stored[i];
    at->settled &= at->solved & (DAL_LANES(fabs)(total) <= DBL_MAX);
}

DAL_KERNEL_INLINE void DAL_LANES(commit)(const DAL_LANES(traits) *o, DAL_LANES(state) *c,
                                         const DAL_LANES(arrays) *at, bool all)
{
    const dal_mask made = at->settled, fresh = made & (c->pulled == 0.0);
    const dal_vec zero = DAL_LANES(all_of)(0.0);
    dal_vec *const latest = c->pull, *const past = latest + DAL_N, *const first = past + DAL_N;
    for (size_t i = 0; i < DAL_N; i++) {
        dal_vec *const x = &c->x[i], *const v = x + DAL_N, *const low = &c->low[i];
        low[0] = DAL_LANES_TAKE(all, made, *x - at->stored[i] + at->move[i], low[0]);
        low[DAL_N] = DAL_LANES_TAKE(all, made, *v - at->w[i] + at->move[DAL_N + i], low[DAL_N]);
        if (!o->steady && DAL_KERNEL_HAS(o->has.pull, i)) {
            first[i] = DAL_LANES_TAKE(all, made, past[i], first[i]);
            past[i] = DAL_LANES_TAKE(all, made, latest[i], past[i]);
            latest[i] = DAL_LANES_TAKE(all, made, at->w[i] - at->base[i], latest[i]);
        }
        *x = DAL_LANES_TAKE(all, made, at->stored[i], *x);
        *v = DAL_LANES_TAKE(all, made, at->w[i], *v);
        if (o->ends) c->force[i] = DAL_LANES_TAKE(all, made, at->force[i], c->force[i]);
    }
    if (!o->steady && DAL_LANES(any)(fresh)) {
        for (size_t i = 0; i < DAL_N; i++) {
            past[i] = DAL_LANES(choose)(fresh, latest[i], past[i]);
            first[i] = DAL_LANES(choose)(fresh, latest[i], first[i]);
        }
        c->pulled = DAL_LANES(choose)(fresh, DAL_LANES(all_of)(1.0), c->pulled);
    }
    for (size_t a = 0; a < DAL_M; a++)
        c->impulse[a] = DAL_LANES_TAKE(all, made, c->impulse[a] + at->kappa[a], c->impulse[a]);
    if (DAL_LANES_HAS_PULL && !o->plain)
        c->forced = DAL_LANES_TAKE(all, made, DAL_LANES(all_of)(o->ends), c->forced);
    c->iterations += DAL_LANES_TAKE(all, made, at->iterations, zero);
    c->constraint_calls += DAL_LANES_TAKE(all, made, at->constraint_calls, zero);
    c->pull_calls += DAL_LANES_TAKE(all, made, at->pull_calls, zero);
}

/* A stage of the active lanes; returns the lanes that completed it. */
DAL_KERNEL_INLINE dal_mask DAL_LANES(stage)(const dal_lanes_block *block,
                                            const DAL_LANES(given) *given, const dal_stage *s,
                                            DAL_LANES(state) *c, dal_mask going, bool plain)
{
    DAL_LANES(arrays) at;
    dal_pattern has = DAL_LANES_PATTERN;
    const bool inside = DAL_LANES_STEADY > 0 && plain;
    const bool steady = inside || (DAL_LANES_STEADY != 0 && block->steady);
    if (inside) has.N = 0;
    const DAL_LANES(traits) o = {
        .stage = s, .given = given, .h = given->h, .t_end = DAL_LANES(time)(given, c, s->t_end),
        .has = has, .plain = plain, .steady = steady,
        .turns = DAL_LANES_STEADY > 1,
        .ends = DAL_LANES_HAS_PULL && !plain && s->end != 0.0,
        .known = DAL_M == 0 || steady || s->linear, .apart = plain && DAL_LANES_STEADY > 1};
    at.iterations = at.constraint_calls = at.pull_calls = DAL_LANES(all_of)(0.0);
    at.solved = at.settled = at.passed = (dal_mask){0};
    at.open = going;
    DAL_LANES(predict)(&o, c, &at);
    at.open = DAL_LANES(factor)(&o, c, &at);
    if (o.apart) {
        if (DAL_LANES_HAS_PULL) DAL_LANES(kick)(&o, c, &at);
        for (size_t i = 0; i < DAL_N; i++) at.w[i] = at.base[i];
    }
    if (o.ends)
        for (size_t i = 0; i < DAL_N; i++) at.seen[i] = at.w[i];
    DAL_LANES(correct)(&o, c, &at, true, true);
    for (int i = 2; i <= DAL_KERNEL_CORRECTIONS && DAL_LANES(any)(at.open); i++)
        if (!DAL_LANES(any)(at.solved)) DAL_LANES(correct)(&o, c, &at, false, true);
        else DAL_LANES(correct)(&o, c, &at, false, false);
    DAL_LANES(settle)(&o, c, &at);
    if (!DAL_LANES(any)(~at.settled)) DAL_LANES(commit)(&o, c, &at, true);
    else DAL_LANES(commit)(&o, c, &at, false);
    return at.settled;
}

/* Separate functions, so that no compiler moves the beginning of a stage to a common place. */
DAL_KERNEL_APART dal_mask DAL_LANES(stage_at_nodes)(const dal_lanes_block *block,
                                                    const DAL_LANES(given) *given,
                                                    const dal_stage *s, DAL_LANES(state) *c,
                                                    dal_mask going)
{
    return DAL_LANES(stage)(block, given, s, c, going, true);
}

DAL_KERNEL_APART dal_mask DAL_LANES(stage_in_general)(const dal_lanes_block *block,
                                                      const DAL_LANES(given) *given,
                                                      const dal_stage *s, DAL_LANES(state) *c,
                                                      dal_mask going)
{
    return DAL_LANES(stage)(block, given, s, c, going, false);
}

/* Restores the state before an incomplete step of several stages, as in kernel.h. */
DAL_KERNEL_INLINE void DAL_LANES(take_back)(DAL_LANES(state) *c, const DAL_LANES(state) *saved,
                                            dal_mask going)
{
    dal_vec *const now = (dal_vec *)c;
    const dal_vec *const before = (const dal_vec *)saved;
    for (size_t i = 0; i < sizeof *c / sizeof *now; i++)
        now[i] = DAL_LANES(choose)(going, now[i], before[i]);
}

static void DAL_LANES(advance)(const dal_lanes_block *block, size_t steps)
{
    enum { TURNS = DAL_LANES_TURNS };
    const bool plain = !DAL_LANES_HAS_PULL || block->plain;
    const size_t size = sizeof(DAL_LANES(given)) / sizeof(dal_vec) + block->parameters;
    DAL_LANES(state) *const state = (DAL_LANES(state) *)block->carried, saved[TURNS];
    const DAL_LANES(given) *given[TURNS];
    dal_mask going[TURNS], began[TURNS];
    for (size_t b = 0; b < TURNS; b++) {
        given[b] = (const DAL_LANES(given) *)((const dal_vec *)block->given + b * size);
        going[b] = state[b].going != 0.0;
    }
    for (size_t k = 0; k < steps; k++) {
        dal_mask some = {0};
        for (size_t b = 0; b < TURNS; b++) {
            some |= began[b] = going[b];
            if (block->stages > 1) saved[b] = state[b];
        }
        if (!DAL_LANES(any)(some)) break;
        for (const dal_stage *s = block->stage; s < block->stage + block->stages; s++)
            for (size_t b = 0; b < TURNS; b++)
                if (DAL_LANES(any)(going[b]))
                    going[b] = plain
                        ? DAL_LANES(stage_at_nodes)(block, given[b], s, &state[b], going[b])
                        : DAL_LANES(stage_in_general)(block, given[b], s, &state[b], going[b]);
        for (size_t b = 0; b < TURNS; b++) {
            if (block->stages > 1 && DAL_LANES(any)(began[b] & ~going[b]))
                DAL_LANES(take_back)(&state[b], &saved[b], going[b]);
            state[b].number += DAL_LANES(count)(going[b]);
        }
    }
    for (size_t b = 0; b < TURNS; b++) state[b].going = DAL_LANES(count)(going[b]);
}

#undef DAL_LANES_TAKE
#undef DAL_LANES_ROWS
#undef DAL_LANES_HAS_PULL
#undef DAL_LANES_PULL
#undef DAL_LANES_CONSTRAINT
#undef DAL_LANES_PATTERN
#undef DAL_LANES_STEADY
#undef DAL_N
#undef DAL_M
#undef DAL_LANES_VECTOR
#undef DAL_LANES
#endif /* DAL_LANES && DAL_N */
