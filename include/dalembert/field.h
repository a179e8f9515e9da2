/* field.h - the ODE on D at one state, for every system that is not stored by rows.
 *
 *     M dv/dt = F + mu^T lambda,   mu dv/dt = -g,   so   C lambda = -(mu M^-1 F + g)
 *
 * with M = L_vv, F = L_q - L_vq v - L_vt + f, mu = phi_v, g = phi_q v + phi_t, C = mu M^-1 mu^T.
 * C, and M if it is not constant, are factored as L D L^T, without a root.  The criterion of
 * acceptance is the usual one.  For the matrix scaled to a unit diagonal, its size times the trace
 * of its inverse may be at most DAL_LU_CONDITION.  This product is not below the condition number.
 *
 * One text, many compilations, as in kernel.h: if sizes and patterns are constants, only the
 * nonzero products remain.  The caller determines the cause of a failure.  A number that is not
 * finite enters the result, since 0 times NaN is NaN.  Header only: generated code has no library
 * to link. */
#ifndef DALEMBERT_FIELD_H
#define DALEMBERT_FIELD_H

#include <dalembert.h>
#include <dalembert/lu.h>

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>

/* Whether an entry of a matrix may be nonzero: bit a*n + i for entry (a, i), so n <= 8; or
 * DAL_KERNEL_ALL.  Terms with other entries are omitted. */
#define DAL_KERNEL_ALL (~0ULL)
#define DAL_KERNEL_HAS(mask, index) \
    ((mask) == DAL_KERNEL_ALL || ((mask) != 0 && ((mask) >> (index) & 1)))

typedef struct dal_kernel dal_kernel;

/* Takes a number of steps of kernel; *done <- the number of successful steps. */
typedef int (*dal_kernel_fn)(dal_kernel *kernel, size_t steps, size_t *done);

/* xdot[2n] <- the field of the ODE on D at x[2n], by field.h. The arguments include the inputs
 * u[inputs] of the force, M^-1[n*n] if M is constant, and ctx of the callbacks.  Returns 0 on
 * failure; the library then determines the cause. */
typedef int (*dal_field_fn)(double t, const double *x, const double *u, const double *mass_inverse,
                            double *xdot, void *ctx);

/* A step routine compiled for one system, for the member compiled of its dal_system_def. */
#define DAL_COMPILED_ABI 15u
typedef struct dal_lanes_routine dal_lanes_routine;
typedef struct dal_compiled {
    unsigned abi;  /* DAL_COMPILED_ABI, */
    size_t size;   /* and sizeof(dal_kernel), as its compiler saw them */
    dal_kernel_fn advance;
    int momenta;   /* 1: with DAL_KERNEL_MOMENTA, */
    int forced;    /* 1: with a force */
    const dal_lanes_routine *lanes; /* see lanes.h; NULL: there are none */
    dal_field_fn field;             /* or NULL */
} dal_compiled;

/* Masks of the entries that may be nonzero, as in a dal_pattern. */
typedef struct dal_field_zeros {
    unsigned long long inverse; /* M^-1, and L^-1 where M is not constant */
    unsigned long long L;       /* of that M */
    unsigned long long F;       /* [n]; 0: F need not be given */
    unsigned long long mu, Z;   /* and Z = mu M^-1 */
} dal_field_zeros;

#define DAL_FIELD_ALL \
    {DAL_KERNEL_ALL, DAL_KERNEL_ALL, DAL_KERNEL_ALL, DAL_KERNEL_ALL, DAL_KERNEL_ALL}

/* The terms of the field, and the workspace. */
typedef struct dal_field_terms {
    const double *F, *mu, *g; /* [n], [m*n], [m] */
    const double *inverse;    /* M^-1: its diagonal where M is diagonal, */
    size_t next;              /* from one entry to the next of it; or [n*n], and 0; unless */
    double *M;                /* [n*n], which is overwritten, is given */
    double *Z;                /* [m*n] */
    double *C;                /* [m*m] */
    bool given;               /* C is known before, its lower triangle at least */
    double *lambda;           /* [m] */
    double *w;                /* [2*m], and [2*n] if there is an M */
} dal_field_terms;

/* Defines a function, for numbers of a type, that factors A[n*n] as L D L^T.  The lower half of A
 * is read; L, D^-1 and L^T replace A.  Returns false unless definite is true and each pivot exceeds
 * least times its entry of diagonal[n]. */
#define DAL_FIELD_ELIMINATION(name, real, flag, UNROLL) \
    DAL_LU_INLINE flag name(size_t n, unsigned long long mask, real *A, const real *diagonal, \
                            double least, flag definite) \
    { \
        UNROLL \
        for (size_t j = 0; j < n; j++) { \
            const real pivot = A[j * n + j], inverse = 1.0 / pivot; \
            definite = definite & (pivot > least * diagonal[j]); \
            A[j * n + j] = inverse; \
            UNROLL \
            for (size_t i = j + 1; i < n; i++) { \
                if (!DAL_KERNEL_HAS(mask, i * n + j)) continue; \
                const real entry = A[i * n + j]; \
                A[i * n + j] = A[j * n + i] = entry * inverse; \
                UNROLL \
                for (size_t c = j + 1; c <= i; c++) \
                    if (DAL_KERNEL_HAS(mask, c * n + j)) A[i * n + c] -= entry * A[j * n + c]; \
            } \
        } \
        return definite; \
    }
DAL_FIELD_ELIMINATION(dal_field_eliminate, double, bool, )

/* Replaces A[n*n] by these factors.  Returns whether A is positive definite and not too
 * ill-conditioned.  The array w[2*n] is workspace. */
DAL_LU_INLINE bool dal_field_factor(size_t n, unsigned long long L, unsigned long long inverse,
                                    double *A, double *w)
{
    double *const diagonal = w, *const column = w + n;
    double trace = 0.0;
    for (size_t j = 0; j < n; j++) diagonal[j] = A[j * n + j];
    (void)dal_field_eliminate(n, L, A, diagonal, 0.0, true);
    for (size_t j = 0; j < n; j++) { /* the columns of L^-1 */
        double entry = A[j * n + j]; /* (A^-1)_jj */
        if (!(entry > 0.0)) return false;
        if (n == 1) break; /* the condition is 1 */
        column[j] = 1.0;
        for (size_t i = j + 1; i < n; i++) {
            if (!DAL_KERNEL_HAS(inverse, i * n + j)) continue;
            double sum = -0.0;
            for (size_t k = j; k < i; k++)
                if (DAL_KERNEL_HAS(L, i * n + k) && DAL_KERNEL_HAS(inverse, k * n + j))
                    sum -= A[i * n + k] * column[k];
            column[i] = sum;
            entry += sum * sum * A[i * n + i];
        }
        trace += diagonal[j] * entry;
    }
    return (double)n * trace <= DAL_LU_CONDITION;
}

/* x[n] <- A^-1 x of these factors. */
DAL_LU_INLINE void dal_field_substitute(size_t n, unsigned long long L, const double *A, double *x)
{
    for (size_t i = 1; i < n; i++)
        for (size_t k = 0; k < i; k++)
            if (DAL_KERNEL_HAS(L, i * n + k)) x[i] -= A[i * n + k] * x[k];
    for (size_t i = 0; i < n; i++) x[i] *= A[i * n + i];
    for (size_t i = n; i-- > 0;)
        for (size_t k = i + 1; k < n; k++)
            if (DAL_KERNEL_HAS(L, k * n + i)) x[i] -= A[k * n + i] * x[k];
}

/* y[n] <- M^-1 f, for an f with these entries. */
DAL_LU_INLINE void dal_field_accelerate(size_t n, dal_field_zeros has, const dal_field_terms *w,
                                        unsigned long long given, const double *f, double *y)
{
    if (w->M) {
        for (size_t i = 0; i < n; i++) y[i] = DAL_KERNEL_HAS(given, i) ? f[i] : 0.0;
        dal_field_substitute(n, has.L, w->M, y);
        return;
    }
    for (size_t i = 0; i < n; i++) {
        double sum = -0.0;
        if (w->next && DAL_KERNEL_HAS(given, i)) sum = w->inverse[i * w->next] * f[i];
        for (size_t j = 0; !w->next && j < n; j++)
            if (DAL_KERNEL_HAS(has.inverse, i * n + j) && DAL_KERNEL_HAS(given, j))
                sum += w->inverse[i * n + j] * f[j];
        y[i] = sum;
    }
}

/* Row a of a mask[m*n]. */
DAL_LU_INLINE unsigned long long dal_field_row(unsigned long long mask, size_t n, size_t a)
{
    return mask == DAL_KERNEL_ALL ? mask : mask >> a * n & ((1ULL << n) - 1);
}

/* xdot[2n] <- (v, dv/dt) at v[n].  Returns whether M and C are regular, and xdot is finite if v is.
 */
DAL_LU_INLINE bool dal_field_solve(size_t n, size_t m, dal_field_zeros has,
                                   const dal_field_terms *w, const double *v, double *xdot)
{
    double *const Z = w->Z, *const C = w->C, *const vdot = xdot + n;
    const double *const mu = w->mu;
    if (w->M && !dal_field_factor(n, has.L, has.inverse, w->M, w->w)) return false;
    for (size_t i = 0; i < n; i++) xdot[i] = v[i];
    if (has.F) dal_field_accelerate(n, has, w, has.F, w->F, vdot);
    for (size_t a = 0; a < m; a++) {
        double sum = -0.0;
        dal_field_accelerate(n, has, w, dal_field_row(has.mu, n, a), mu + a * n, Z + a * n);
        for (size_t i = 0; has.F && i < n; i++)
            if (DAL_KERNEL_HAS(has.mu, a * n + i)) sum += mu[a * n + i] * vdot[i];
        w->lambda[a] = -(sum + w->g[a]); /* last, as v is in a stage */
        for (size_t b = 0; !w->given && b <= a; b++) {
            double entry = -0.0;
            for (size_t i = 0; i < n; i++)
                if (DAL_KERNEL_HAS(has.mu, a * n + i) && DAL_KERNEL_HAS(has.Z, b * n + i))
                    entry += mu[a * n + i] * Z[b * n + i];
            C[a * m + b] = entry;
        }
    }
    if (!dal_field_factor(m, DAL_KERNEL_ALL, DAL_KERNEL_ALL, C, w->w)) return false;
    dal_field_substitute(m, DAL_KERNEL_ALL, C, w->lambda);
    double total = 0.0; /* not finite where an entry is not */
    for (size_t i = 0; i < n; i++) {
        double sum = has.F ? 0.0 + vdot[i] : 0.0; /* which leaves no -0.0 */
        for (size_t a = 0; a < m; a++)
            if (DAL_KERNEL_HAS(has.Z, a * n + i)) sum += Z[a * n + i] * w->lambda[a];
        vdot[i] = sum;
        total += sum;
    }
    return fabs(total) <= DBL_MAX;
}

#endif /* DALEMBERT_FIELD_H */
