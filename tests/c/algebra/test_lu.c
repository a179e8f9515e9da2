/* Cholesky and LU factors: solutions against GSL and against exact ones, growth of the elements,
 * and what counts as singular. */
#include "fixtures.h"
#include "check.h"
#include "dalembert/lu.h"
#include "dalembert/residual.h"

#include <gsl/gsl_linalg.h>

enum { MOST = 60 };

typedef struct matrix {
    size_t m;
    double entry[MOST * MOST];
} matrix;

/* ---- matrices ----------------------------------------------------------------------------- */

typedef enum kind { DENSE, BANDED, CYCLIC, BLOCK, CHAIN, KINDS } kind;

/* A random matrix of dimension m; most have a condition below 1e4. */
static void fill(matrix *A, kind k, size_t m, unsigned *seed)
{
    A->m = m;
    for (size_t i = 0; i < m; i++)
        for (size_t j = 0; j < m; j++) {
            const size_t apart = i > j ? i - j : j - i;
            const size_t around = apart < m - apart ? apart : m - apart;
            const bool there = k == DENSE || (k == BANDED && apart <= 2)
                            || (k == CYCLIC && around <= 1) || (k == BLOCK && i / 4 == j / 4)
                            || (k == CHAIN && apart <= 1);
            double entry = there ? next_number(seed) : 0.0;
            if (k == CHAIN && there) entry = apart == 0 ? 1.26 : 0.05; /* rows (.5, 1, .1) of mu */
            if (k == CYCLIC && apart == 0) entry += 3.0;
            A->entry[i * m + j] = entry;
        }
}

/* The same with rows and columns in other units, 10^-e to 10^e. */
static matrix rescaled(const matrix *A, double e, unsigned *seed)
{
    matrix B = *A;
    for (int side = 0; side < 2; side++)
        for (size_t i = 0; i < A->m; i++) {
            const double unit = pow(10.0, e * next_number(seed));
            for (size_t j = 0; j < A->m; j++)
                B.entry[side ? j * A->m + i : i * A->m + j] *= unit;
        }
    return B;
}

/* Two random reflections around a diagonal from 1 down to 1/condition, geometrically. */
static void fill_with_condition(matrix *A, size_t m, double condition, bool symmetric,
                                unsigned *seed)
{
    double u[2][MOST];
    A->m = m;
    for (int side = 0; side < 2; side++) {
        double square = 0.0;
        for (size_t i = 0; i < m; i++) {
            u[side][i] = next_number(seed);
            square += u[side][i] * u[side][i];
        }
        for (size_t i = 0; i < m; i++) u[side][i] /= sqrt(square);
    }
    const double *const left = u[0], *const right = u[symmetric ? 0 : 1];
    for (size_t i = 0; i < m; i++)
        for (size_t j = 0; j < m; j++) {
            double sum = 0.0;
            for (size_t k = 0; k < m; k++) {
                const double d = pow(condition, -(double)k / (double)(m - 1));
                sum += d * ((i == k) - 2.0 * left[i] * left[k])
                       * ((j == k) - 2.0 * right[j] * right[k]);
            }
            A->entry[i * m + j] = sum;
        }
    for (size_t i = 0; symmetric && i < m; i++)
        for (size_t j = 0; j < i; j++) A->entry[i * m + j] = A->entry[j * m + i];
}

static double largest_row_sum(size_t m, const double *A)
{
    double most = 0.0;
    for (size_t i = 0; i < m; i++) most = fmax(most, dal__sum_of_sizes(m, A + i * m));
    return most;
}

/* The condition in the largest row sum and the sign of the determinant, by GSL. */
static double condition_of(const matrix *A, int *determinant)
{
    const size_t m = A->m;
    static double factor[MOST * MOST], inverse[MOST * MOST];
    static size_t exchanges[MOST];
    int sign;
    memcpy(factor, A->entry, m * m * sizeof *factor);
    gsl_matrix_view LU = gsl_matrix_view_array(factor, m, m);
    gsl_matrix_view out = gsl_matrix_view_array(inverse, m, m);
    gsl_permutation p = {m, exchanges};
    gsl_linalg_LU_decomp(&LU.matrix, &p, &sign);
    *determinant = gsl_linalg_LU_sgndet(&LU.matrix, sign);
    if (gsl_linalg_LU_invert(&LU.matrix, &p, &out.matrix)) return INFINITY;
    return largest_row_sum(m, A->entry) * largest_row_sum(m, inverse);
}

/* ---- LU ----------------------------------------------------------------------------------- */

typedef struct factors {
    double LU[MOST * MOST], sizes[5 * MOST];
    size_t row[MOST];
} factors;

/* As where nothing is known of the entries but their values. */
static int factor(const matrix *A, factors *f)
{
    static double scale[MOST * MOST];
    for (size_t k = 0; k < A->m * A->m; k++) scale[k] = fabs(A->entry[k]);
    memcpy(f->LU, A->entry, A->m * A->m * sizeof *scale);
    dal__linear linear = {.size = A->m, .A = f->LU, .sizes = f->sizes, .row = f->row};
    dal__linear_balance(&linear, scale);
    return dal__linear_factor(&linear);
}

/* The largest entry of the scaled U over the largest of the scaled A. */
static double growth(const matrix *A, const factors *f)
{
    const size_t m = A->m;
    double after = 0.0, before = 0.0;
    for (size_t i = 0; i < m; i++)
        for (size_t j = 0; j < m; j++) {
            const double unit = f->sizes[m + j];
            const double entry = j == i ? 1.0 / f->LU[i * m + i] : f->LU[i * m + j];
            if (j >= i) after = fmax(after, fabs(entry) / (f->sizes[f->row[i]] * unit));
            before = fmax(before, fabs(A->entry[i * m + j]) / (f->sizes[i] * unit));
        }
    return after / before;
}

static double solve_error(const matrix *A, const factors *f, const double *x)
{
    double b[MOST], y[MOST];
    dal__apply(A->m, A->m, A->entry, x, b);
    dal_lu_solve(A->m, f->LU, f->row, b, y);
    return largest_difference(A->m, x, y) / dal__largest(A->m, x);
}

/* b = A x adds its own rounding, which the condition enlarges as it does that of the factors. */
static void test_random(void)
{
    enum { TRIALS = 2000 };
    unsigned seed = 11;
    static matrix A;
    static factors f;
    double worst = 0.0, most = 0.0;
    for (int k = 0; k < KINDS; k++)
        for (int trial = 0; trial < (brief() ? TRIALS / 20 : TRIALS); trial++) {
            const size_t m = 1 + (size_t)(fabs(next_number(&seed)) * MOST) % MOST;
            double x[MOST];
            fill(&A, (kind)k, m, &seed);
            int sign;
            const double condition = condition_of(&A, &sign);
            if (!(condition < 1e6)) continue;
            CHECK(factor(&A, &f) == sign);
            for (size_t i = 0; i < m; i++) x[i] = next_number(&seed);
            worst = fmax(worst, solve_error(&A, &f, x) / ((double)m * U * condition));
            most = fmax(most, growth(&A, &f));
        }
    CHECK(worst > 0.0 && worst <= 100.0);
    CHECK(most > 1.0 && most <= 100.0);
}

/* Small integers: A x is exact, so x is the exact solution. */
static void test_exact(void)
{
    unsigned seed = 5;
    static matrix A;
    static factors f;
    for (int trial = 0; trial < 2000; trial++) {
        const size_t m = 1 + (size_t)trial % 8;
        double x[MOST];
        A.m = m;
        for (size_t k = 0; k < m * m; k++) A.entry[k] = round(9.0 * next_number(&seed));
        for (size_t i = 0; i < m; i++) x[i] = round(99.0 * next_number(&seed)) + 0.5;
        int sign;
        const double condition = condition_of(&A, &sign);
        if (!(condition < 1e6)) continue;
        CHECK(factor(&A, &f) == sign);
        CHECK(solve_error(&A, &f, x) <= 100.0 * (double)m * U * condition);
    }
    const double A2[4] = {0, 3, 2, 0}, b[2] = {6, 4};
    double x[2];
    A.m = 2;
    memcpy(A.entry, A2, sizeof A2);
    CHECK(factor(&A, &f) != 0); /* a zero pivot is no obstacle */
    dal_lu_solve(2, f.LU, f.row, b, x);
    CHECK(x[0] == 2.0 && x[1] == 2.0);
}

static double inverse_norm(size_t m, factors *f)
{
    const dal_lu_factors by = {dal_lu_solve_by, dal_lu_solve_transposed_by, m, f->LU, f->row, m};
    return dal_lu_inverse_norm(&by, f->sizes, f->sizes + m, f->sizes + 2 * m);
}

/* Up to 1e12 there is an answer, in any units; beyond 1e15 there is none. */
static void test_condition(void)
{
    unsigned seed = 17;
    static matrix A, B;
    static factors f;
    for (int trial = 0; trial < 60; trial++) {
        const size_t m = 2 + (size_t)trial % 30;
        double x[MOST];
        for (size_t i = 0; i < m; i++) x[i] = next_number(&seed);
        for (double condition = 1e4; condition < 1e13; condition *= 1e4) {
            fill_with_condition(&A, m, condition, false, &seed);
            CHECK(factor(&A, &f) != 0);
            CHECK(solve_error(&A, &f, x) <= 100.0 * (double)m * U * condition);
            const double estimate = inverse_norm(m, &f);
            B = rescaled(&A, 20.0, &seed);
            CHECK(factor(&B, &f) != 0);
            const double again = inverse_norm(m, &f);
            CHECK(again < 16.0 * estimate && estimate < 16.0 * again);
        }
        fill_with_condition(&A, m, 1e18, false, &seed);
        B = rescaled(&A, 20.0, &seed);
        CHECK(factor(&A, &f) == 0 && factor(&B, &f) == 0);
    }
    const double apart[4] = {1, 0, 0, 1e-20};
    A.m = 2;
    memcpy(A.entry, apart, sizeof apart);
    CHECK(factor(&A, &f) != 0);
}

/* Two rows, and columns, that are the same but for a rounding, which leaves a pivot as small. */
static void test_coincidence(void)
{
    unsigned seed = 29;
    static matrix A;
    static factors f;
    for (int trial = 0; trial < 400; trial++) {
        const size_t m = 2 + (size_t)trial % 20, j = (size_t)trial % (m - 1), k = j + 1;
        double X[MOST][MOST];
        for (size_t i = 0; i < m; i++)
            for (size_t l = 0; l < m; l++) X[i][l] = next_number(&seed);
        for (size_t l = 0; l < m; l++) X[k][l] = X[j][l];
        A.m = m;
        for (size_t i = 0; i < m; i++)
            for (size_t l = 0; l < m; l++) A.entry[i * m + l] = dal__dot(m, X[i], X[l]);
        A.entry[k * m + k] *= 1.0 + 2.0 * (1 + trial % 4) * U;
        CHECK(factor(&A, &f) == 0);
    }
}

/* Rows that a vector of ones, or of changing signs, does not tell apart: two with others between
 * them, and e1 + e2 = e3 + e4 for unit vectors; but for 2e-8. */
static void test_hidden_coincidence(void)
{
    static const double unit[4][3] = {{3, 4, 0}, {3, -4, 0}, {3, 0, 4}, {3, 0, -4}};
    static matrix A;
    static factors f;
    for (size_t m = 8; m <= MOST; m += 4)
        for (size_t first = 0; first + 7 <= m; first++)
            for (int pairs = 0; pairs < 2; pairs++) {
                double X[MOST][MOST + 4] = {{0.0}};
                for (size_t i = 0; i < m; i++) X[i][i] = 1.0, X[i][i + 1] = 0.25;
                for (size_t k = 0; k < (pairs ? 4 : 2); k++) {
                    const size_t i = first + (size_t[]){0, 6, 2, 4}[k];
                    for (size_t l = 0; l < m + 4; l++) X[i][l] = 0.0;
                    for (size_t l = 0; l < 3; l++) X[i][m + l] = unit[pairs ? k : 0][l];
                }
                X[first + (pairs ? 4 : 6)][m + 3] = 1e-7;
                A.m = m;
                for (size_t i = 0; i < m; i++)
                    for (size_t l = 0; l < m; l++)
                        A.entry[i * m + l] = dal__dot(m + 4, X[i], X[l]);
                CHECK(factor(&A, &f) == 0);
            }
}

/* Of the scaled matrix the estimate is below the norm of the inverse, and hardly ever far below. */
static void test_estimate(void)
{
    unsigned seed = 23;
    static matrix A;
    static factors f;
    double worst = 1.0, sum = 0.0;
    size_t judged = 0;
    for (int trial = 0; trial < 500; trial++) {
        const size_t m = 2 + (size_t)trial % 40;
        double norm = 0.0, e[MOST], y[MOST];
        fill(&A, (kind)(trial % KINDS), m, &seed);
        if (factor(&A, &f) == 0) continue;
        for (size_t k = 0; k < 2 * m; k++) f.sizes[k] = pow(10.0, 3.0 * next_number(&seed));
        for (size_t j = 0; j < m; j++) {
            double column = 0.0;
            for (size_t i = 0; i < m; i++) e[i] = i == j ? f.sizes[j] : 0.0;
            dal_lu_solve(m, f.LU, f.row, e, y);
            for (size_t i = 0; i < m; i++) column += fabs(y[i]) * f.sizes[m + i];
            norm = fmax(norm, column);
        }
        const double found = inverse_norm(m, &f);
        CHECK(found <= norm * (1.0 + 1e-9));
        worst = fmin(worst, found / norm);
        sum += found / norm;
        judged++;
    }
    CHECK(worst >= 0.4 && sum >= 0.98 * (double)judged && judged > 400);
}

/* Triangles whose inverse is known: 1 and k in one row, K + 1 in the inverse; and 1, -1 below it,
 * with 2^(m-2) in the inverse. */
static void test_triangles(void)
{
    static matrix A;
    static factors f;
    for (int large = 0; large < 2; large++) {
        double two[4] = {1.0, large ? 1e8 : 1e7, 0.0, 1.0}, sizes[10] = {1, 1, 1, 1};
        CHECK(dal_lu_factor(2, two, sizes, f.row) == !large);
        A.m = large ? 60 : 40;
        for (size_t i = 0; i < A.m; i++)
            for (size_t j = 0; j < A.m; j++)
                f.LU[i * A.m + j] = i == j ? 1.0 : i > j ? -1.0 : 0.0;
        for (size_t k = 0; k < 2 * A.m; k++) f.sizes[k] = 1.0;
        CHECK(dal_lu_factor(A.m, f.LU, f.sizes, f.row) == !large);
    }
}

/* ---- singular ------------------------------------------------------------------------------ */

/* C = L R^T of forms with terms entries, with the sizes that forms have where M = 1. */
static int factor_product(size_t m, size_t terms, const double *L, const double *R, factors *f)
{
    double unit[8];
    for (size_t i = 0; i < terms; i++) unit[i] = 1.0;
    for (size_t a = 0; a < m; a++) {
        for (size_t b = 0; b < m; b++)
            f->LU[a * m + b] = dal__dot(terms, L + a * terms, R + b * terms);
        f->sizes[a] = dal_residual_row_norm(terms, unit, L + a * terms);
        f->sizes[m + a] = dal_residual_row_norm(terms, unit, R + a * terms);
    }
    return dal_lu_factor(m, f->LU, f->sizes, f->row);
}

static void test_singular(void)
{
    factors f;
    const double exact[2] = {1.0, -1.0}, ones[2] = {1.0, 1.0};
    CHECK(factor_product(1, 2, exact, ones, &f) == 0); /* 1 - 1 */
    const double almost[3] = {0.1, 0.2, -0.3}, three[3] = {1.0, 1.0, 1.0};
    CHECK(0.1 + 0.2 - 0.3 != 0.0); /* 5.6e-17 that ought to be 0 */
    CHECK(factor_product(1, 3, almost, three, &f) == 0);
    const double small[2] = {1e-17, 0.0}; /* small, but not by cancellation */
    CHECK(factor_product(1, 2, small, ones, &f) == 1 && f.LU[0] == 1.0 / 1e-17);
    const double near[2] = {1.0, -1.0 + 1e-12}; /* cancels, and 1e-12 is left that is certain */
    CHECK(factor_product(1, 2, near, ones, &f) == 1);
    for (size_t m = 1; m <= 2; m++) { /* not finite */
        const double bad[] = {0.0, NAN, INFINITY};
        for (size_t k = 0; k < (m == 1 ? 2 : 3); k++) {
            double A[4] = {bad[k], bad[k], bad[k], bad[k]}, sizes[10] = {1, 1, 1, 1};
            CHECK(dal_lu_factor(m, A, sizes, f.row) == 0);
        }
    }
    /* the inverse overflows to NaN in one of the two ways to estimate it, and in the other not */
    const double R = 0x1p40;
    double A[16] = {2.0 / 3.0 * R, 0, 0, 1e-308, 0, 1, 1, 1, 1, 0, 0, 0, 0, 0, 1, 1};
    double sizes[20] = {R, 1, 1, 1, 1, 1, 1, 1};
    CHECK(dal_lu_factor(4, A, sizes, f.row) == 0);
    /* small as all terms are, large beside them, or larger than what is left of the solution */
    const struct {
        double A[9];
        int sign;
    } sized[] = {{{1e-14, 0, 0, 0, 1e-14, 0, 0, 0, 1e-14}, 1},
                 {{1e-16, 0, 0, 0, 1e-16, 0, 0, 0, 1e-16}, 0},
                 {{1, 0, 0, 0, 1e12, 0, 0, 0, 1}, 1},
                 {{1, 0, 0, 0, 1e16, 0, 0, 0, 1}, 0},
                 {{1, 1e6, 1e6, 1e6, 1, 0, 1e6, 0, 1}, -1},
                 {{1, 1e16, 1e16, 1e16, 1, 0, 1e16, 0, 1}, 0}};
    for (size_t k = 0; k < sizeof sized / sizeof *sized; k++) {
        double A[9], sizes[15] = {1, 1, 1, 1, 1, 1};
        memcpy(A, sized[k].A, sizeof A);
        CHECK(dal_lu_factor(3, A, sizes, f.row) == sized[k].sign);
    }
    for (int which = 0; which < 3; which++) { /* a size that is not known is none */
        double A[4] = {1, 0, 0, 1}, sizes[10] = {1, 1, 1, 1};
        sizes[which] = NAN;
        CHECK(dal_lu_factor(2, A, sizes, f.row) == 0);
    }
    for (int sign = -1; sign < 2; sign += 2)
        for (int which = 0; which < 2; which++) {
            double A[1] = {sign * 1e-10}, sizes[5] = {1, 1};
            sizes[which] = 1e4;
            CHECK(dal_lu_factor(1, A, sizes, f.row) == sign);
            A[0] = sign * 1e-10;
            sizes[which] = 1e6;
            CHECK(dal_lu_factor(1, A, sizes, f.row) == 0);
        }
    /* rows that change places take their sizes along: 1e-16 of 1, beside 1 of 1e-10 */
    double crossed[4] = {0, 1e-16, 1e-10, 0}, crossed_sizes[10] = {1, 1e-10, 1, 1};
    CHECK(dal_lu_factor(2, crossed, crossed_sizes, f.row) == 0);
    double nothing[4] = {1, 1, 0, 0}, nothing_sizes[10] = {1, 0, 1, 1};
    CHECK(dal_lu_factor(2, nothing, nothing_sizes, f.row) == 0);
    /* Two constraints that coincide, with coefficients that are not exact in binary. */
    const double mu[6] = {0.1, 0.7, 0.3, 0.3, 2.1, 0.9};
    CHECK(factor_product(2, 3, mu, mu, &f) == 0);
    const double apart[6] = {0.1, 0.7, 0.3, 0.3, 2.1, 0.9 + 1e-6};
    CHECK(factor_product(2, 3, apart, apart, &f) == 1);
}

/* Forms and coordinates in other units, by powers of two: the same decision and the same bits. */
static void test_units(void)
{
    enum { M = 3, TERMS = 5 };
    static const int left[M] = {0, 200, -150}, right[M] = {-120, 0, 77};
    unsigned seed = 5;
    for (int trial = 0; trial < 40; trial++) {
        double L[M * TERMS], R[M * TERMS], L2[M * TERMS], R2[M * TERMS];
        double b[M], b2[M], x[M], x2[M];
        factors f, f2;
        for (size_t k = 0; k < M * TERMS; k++) {
            L[k] = next_number(&seed);
            R[k] = next_number(&seed);
        }
        for (size_t i = 0; trial % 2 == 1 && i < TERMS; i++) L[TERMS + i] = 0.3 * L[i];
        for (size_t a = 0; a < M; a++) {
            b[a] = next_number(&seed);
            b2[a] = ldexp(b[a], left[a]);
            for (size_t i = 0; i < TERMS; i++) {
                L2[a * TERMS + i] = ldexp(L[a * TERMS + i], left[a]);
                R2[a * TERMS + i] = ldexp(R[a * TERMS + i], right[a]);
            }
        }
        const int regular = factor_product(M, TERMS, L, R, &f);
        CHECK((regular != 0) == (trial % 2 == 0));
        CHECK(factor_product(M, TERMS, L2, R2, &f2) == regular);
        if (!regular) continue;
        dal_lu_solve(M, f.LU, f.row, b, x);
        dal_lu_solve(M, f2.LU, f2.row, b2, x2);
        for (size_t a = 0; a < M; a++) CHECK(ldexp(x2[a], right[a]) == x[a]);
    }
}

/* ---- Cholesky ------------------------------------------------------------------------------ */

static void test_cholesky(void)
{
    unsigned seed = 3;
    static matrix A, B;
    for (int trial = 0; trial < 100; trial++) {
        const size_t n = 3 + (size_t)trial % 30;
        double inverse[MOST], x[MOST], b[MOST], e[MOST];
        for (double condition = 1.0; condition < 1e13; condition *= 1e4) {
            fill_with_condition(&A, n, condition, true, &seed);
            B = A;
            CHECK(dal__cholesky(n, B.entry, inverse, NULL, NULL));
            for (size_t i = 0; i < n; i++)
                for (size_t j = 0; j < n; j++) {
                    const double sum = dal__dot(n, B.entry + i * n, B.entry + j * n);
                    CHECK_NEAR(sum, A.entry[i * n + j], 4 * (double)n * U);
                    if (j > i) CHECK(B.entry[i * n + j] == 0.0);
                }
            for (size_t i = 0; i < n; i++) {
                x[i] = next_number(&seed);
                for (size_t j = 0; j < n; j++) e[j] = i == j;
                dal__cholesky_solve(n, B.entry, e);
                CHECK_NEAR(inverse[i] / e[i], 1.0, 100 * (double)n * U * condition);
            }
            dal__apply(n, n, A.entry, x, b);
            dal__cholesky_solve(n, B.entry, b);
            CHECK_NEAR(largest_difference(n, x, b), 0.0, 100 * (double)n * U * condition);
        }
        fill_with_condition(&A, n + 5, 1e20, true, &seed);
        CHECK(!dal__cholesky(n + 5, A.entry, inverse, NULL, NULL));
    }
    size_t row = 99;
    double pivot = NAN, inverse[2];
    double indefinite[4] = {1, 2, 2, 1}; /* pivot 1: 1 - 4 */
    CHECK(!dal__cholesky(2, indefinite, inverse, &row, &pivot) && row == 1 && pivot == -3.0);
    double semidefinite[4] = {1, 1, 1, 1};
    CHECK(!dal__cholesky(2, semidefinite, inverse, &row, &pivot) && row == 1 && pivot == 0.0);
    double nearly[4] = {1, 1 - 4 * U, 1 - 4 * U, 1};
    CHECK(!dal__cholesky(2, nearly, inverse, &row, &pivot) && pivot < 1e-14);
    /* 1 - c^2 = 2 e of c = 1 - e, and n times the trace of the inverse is 2/e: 1e15 is too much */
    for (int e = 16; e <= 20; e += 4) {
        const double c = 1.0 - e * U;
        double pair[4] = {1, c, c, 1}, inverses[3];
        double with_third[9] = {1, c, 0, c, 1, 0, 0, 0, 1}; /* which has nothing to do with them */
        CHECK(dal__cholesky(2, pair, inverses, NULL, NULL) == (e > 16));
        dal__cholesky(3, with_third, inverses, &row, &pivot);
        CHECK(row == 1 && fabs(pivot / (2 * e * U) - 1.0) < 1e-9);
    }
    double zero[1] = {0.0}, negative[1] = {-2.0}, unknown[1] = {NAN}, infinite[1] = {INFINITY};
    CHECK(!dal__cholesky(1, zero, inverse, &row, &pivot) && row == 0 && pivot == 0.0);
    CHECK(!dal__cholesky(1, negative, inverse, NULL, NULL));
    CHECK(!dal__cholesky(1, unknown, inverse, NULL, NULL));
    CHECK(!dal__cholesky(1, infinite, inverse, NULL, NULL));
    double tiny[4] = {1e-300, 0, 0, 1e300}; /* units differ, nothing cancels */
    CHECK(dal__cholesky(2, tiny, inverse, NULL, NULL));
}

/* ---- singular values ------------------------------------------------------------------------ */

static int descending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x < y) - (x > y);
}

/* Those that a matrix was made with, and as many digits of those of a small part of it. */
static void test_singular_values(void)
{
    unsigned seed = 29;
    static matrix A;
    double squares[MOST];
    for (int trial = 0; trial < 60; trial++) {
        const size_t m = 2 + (size_t)trial % 40;
        const double condition = pow(10.0, trial % 7), unit = trial % 2 ? 1e-200 : 1.0;
        fill_with_condition(&A, m, condition, false, &seed);
        for (size_t k = 0; k < m * m; k++) A.entry[k] *= unit;
        const double found = dal__singular_values(m, m, A.entry, squares) / unit;
        qsort(squares, m, sizeof *squares, descending);
        for (size_t k = 0; k < m; k++)
            CHECK_NEAR(found * sqrt(squares[k]), pow(condition, -(double)k / (double)(m - 1)),
                       16 * (double)m * U);
    }
    double apart[9] = {1, 0, 0, 0, 1e-9, 1e-9, 0, 0, 1e-9}; /* 1e-9 times the golden ratio */
    const double golden = (1.0 + sqrt(5.0)) / 2.0;
    CHECK(dal__singular_values(3, 3, apart, squares) == 1.0);
    qsort(squares, 3, sizeof *squares, descending);
    CHECK_NEAR(1e9 * sqrt(squares[1]), golden, 16 * U);
    CHECK_NEAR(1e9 * sqrt(squares[2]), 1.0 / golden, 16 * U);
    double zero[4] = {0};
    CHECK(dal__singular_values(2, 2, zero, squares) == 0.0 && squares[0] == 0.0);
    CHECK(squares[1] == 0.0);
}

/* ---- sizes of rows and columns -------------------------------------------------------------- */

/* The largest factor between an entry and its row times its column. */
static double unevenness(const matrix *A, const double *sizes)
{
    double most = 1.0;
    for (size_t i = 0; i < A->m; i++)
        for (size_t j = 0; j < A->m; j++) {
            const double ratio = fabs(A->entry[i * A->m + j]) / (sizes[i] * sizes[A->m + j]);
            if (ratio > 0.0) most = fmax(most, fmax(ratio, 1.0 / ratio));
        }
    return most;
}

/* Entries that are a row times a column are found to be so, in any units and however many others
 * are roundoff. */
static void test_sizes(void)
{
    unsigned seed = 31;
    static matrix A, B;
    static double scale[MOST * MOST];
    double worst = 0.0, rounded = 0.0;
    for (int trial = 0; trial < 100; trial++) {
        const size_t m = 2 + (size_t)trial % 30;
        double sizes[2 * MOST], again[2 * MOST];
        A.m = m;
        const bool banded = trial % 2;
        for (size_t i = 0; i < m; i++)
            for (size_t j = 0; j < m; j++)
                A.entry[i * m + j] = banded && (i > j + 2 || j > i + 2)
                                   ? 0.0 : pow(10.0, 0.5 * next_number(&seed));
        B = rescaled(&A, 10.0, &seed);
        dal__linear_balance(&(dal__linear){.size = m, .sizes = sizes}, B.entry);
        worst = fmax(worst, unevenness(&B, sizes));
        for (size_t k = 0; k < m * m; k++) scale[k] = B.entry[k];
        for (size_t i = 0; i < m; i++) /* what was 0 is roundoff of its row and column */
            for (size_t j = 0; j < m; j++)
                if (scale[i * m + j] == 0.0) scale[i * m + j] = U * sizes[i] * sizes[m + j];
        dal__linear_balance(&(dal__linear){.size = m, .sizes = again}, scale);
        rounded = fmax(rounded, unevenness(&B, again));
    }
    CHECK(worst <= 100.0 && rounded <= 200.0);
}

int main(void)
{
    gsl_set_error_handler_off(); /* condition_of is infinite for a singular matrix */
    test_random();
    test_exact();
    test_condition();
    test_coincidence();
    test_hidden_coincidence();
    test_estimate();
    test_triangles();
    test_singular();
    test_units();
    test_cholesky();
    test_singular_values();
    test_sizes();
    return check_done();
}
