/* The ground: one allocation carved into arrays, sizes that overflow; Cholesky and LU factors of
 * small matrices, and what counts as singular. */
#include "../fixtures.h"
#include "check.h"
#include "lu.h"

enum { MOST = 8 };

static void test_arena(void)
{
    arena a = {0};
    double *x, *y;
    char *text;
    size_t *none;
    dal_error error;
    dal__reserve(&a, &x, 3, sizeof *x);
    dal__reserve(&a, &text, 1, 1);
    dal__reserve(&a, &none, 0, sizeof *none);
    dal__reserve(&a, &y, 100, sizeof *y);
    CHECK(dal__allocate(&a, &error) == DAL_SUCCESS);
    CHECK((uintptr_t)x % 64 == 0 && (uintptr_t)text % 64 == 0 && (uintptr_t)y % 64 == 0);
    CHECK((char *)x + 3 * sizeof *x <= text && text + 1 <= (char *)y);
    CHECK((char *)(y + 100) <= (char *)a.block + a.size + 64 && (char *)x >= (char *)a.block);
    double sum = *text;
    for (size_t i = 0; i < 100; i++) sum += fabs(y[i]) + fabs(x[i % 3]);
    CHECK(sum == 0.0);
    for (size_t i = 0; i < 100; i++) y[i] = 1.0;
    CHECK(x[0] == 0.0 && *text == 0);
    dal__release(&a);
    CHECK(a.block == NULL);
    dal__release(&a);
}

static void test_overflow(void)
{
    CHECK(dal__times(0, SIZE_MAX) == 0 && dal__times(SIZE_MAX, 0) == 0);
    CHECK(dal__times(3, 5) == 15 && dal__times(SIZE_MAX, 1) == SIZE_MAX);
    CHECK(dal__times(SIZE_MAX / 2 + 1, 2) == SIZE_MAX);
    CHECK(dal__times(SIZE_MAX, SIZE_MAX) == SIZE_MAX);
    static const size_t counts[][2] = {{SIZE_MAX, 1}, {SIZE_MAX / 8 + 2, 8}, {PTRDIFF_MAX, 1},
                                       {PTRDIFF_MAX / 8, 8}};
    for (size_t i = 0; i < 4; i++) {
        arena a = {0};
        double *first = NULL, *second = NULL;
        dal_error error = {0};
        dal__reserve(&a, &first, 4, sizeof *first);
        dal__reserve(&a, &second, counts[i][0], counts[i][1]);
        CHECK(dal__allocate(&a, &error) == DAL_ENOMEM && error.status == DAL_ENOMEM);
        CHECK(strstr(error.text, "overflow") != NULL && !first && !second && !a.block);
    }
    arena halves = {0}; /* each fits, the sum does not */
    char *one, *two;
    dal__reserve(&halves, &one, PTRDIFF_MAX / 2, 1);
    dal__reserve(&halves, &two, PTRDIFF_MAX / 2, 1);
    CHECK(dal__allocate(&halves, NULL) == DAL_ENOMEM);
}

static void test_status(void)
{
    dal_error error = {.status = 5, .text = "before"};
    for (int status = DAL_EUNSUPPORTED; status <= DAL_STOPPED; status++) {
        CHECK(strlen(dal_strerror(status)) > 0);
        CHECK(strcmp(dal_strerror(status), "unknown status") != 0);
    }
    CHECK(strcmp(dal_strerror(-99), "unknown status") == 0);
    CHECK(strcmp(dal_strerror(2), "unknown status") == 0);
    CHECK(dal__fail(&error, DAL_EINVAL, "n = %d", 3) == DAL_EINVAL);
    CHECK(error.status == DAL_EINVAL && strcmp(error.text, "n = 3") == 0);
    CHECK(dal__fail(NULL, DAL_ENOMEM, "%s", "nobody listens") == DAL_ENOMEM);
    dal__fail(&error, DAL_EINVAL, "%0600d", 1);
    CHECK(strlen(error.text) == sizeof error.text - 1);
    CHECK(dal__callback_status(0) == 0 && dal__callback_status(3) == DAL_EDOMAIN);
    CHECK(dal__callback_status(-3) == DAL_EUSER);
    int major, minor, patch;
    CHECK(sscanf(dal_version(), "%d.%d.%d", &major, &minor, &patch) == 3);
}

static void test_all_finite(void)
{
    double x[3] = {1.0, -1e308, 5e-324};
    CHECK(dal__all_finite(3, x) && dal__all_finite(0, x));
    const double bad[] = {NAN, INFINITY, -INFINITY};
    for (size_t k = 0; k < 3; k++)
        for (size_t i = 0; i < 3; i++) {
            double y[3] = {1.0, -1e308, 2.0};
            y[i] = bad[k];
            CHECK(!dal__all_finite(3, y) && dal__all_finite(i, y));
        }
}

static void test_apply(void)
{
    const double A[6] = {1, 2, 3, 4, 5, 6}, x[3] = {1, -1, 2};
    double y[2];
    dal__apply(2, 3, A, x, y);
    CHECK(y[0] == 5.0 && y[1] == 11.0);
}

/* A = B B^T + 1 has a condition below 1 + |B|^2 < 50; a solution errs by a few n u times that. */
static void test_cholesky(void)
{
    unsigned seed = 3;
    for (size_t n = 1; n <= MOST; n++) {
        double B[MOST * MOST], A[MOST * MOST], factor[MOST * MOST], x[MOST], b[MOST];
        for (size_t k = 0; k < n * n; k++) B[k] = next_number(&seed);
        for (size_t i = 0; i < n; i++)
            for (size_t j = 0; j < n; j++) {
                A[i * n + j] = i == j;
                for (size_t k = 0; k < n; k++) A[i * n + j] += B[i * n + k] * B[j * n + k];
            }
        memcpy(factor, A, sizeof A);
        CHECK(dal__cholesky(n, factor, NULL, NULL));
        for (size_t i = 0; i < n; i++)
            for (size_t j = 0; j < n; j++) {
                double sum = 0.0;
                for (size_t k = 0; k < n; k++) sum += factor[i * n + k] * factor[j * n + k];
                CHECK_NEAR(sum, A[i * n + j], 4 * (double)n * U * (A[i * n + i] + A[j * n + j]));
                if (j > i) CHECK(factor[i * n + j] == 0.0);
            }
        for (size_t i = 0; i < n; i++) x[i] = next_number(&seed);
        dal__apply(n, n, A, x, b);
        dal__cholesky_solve(n, factor, b);
        CHECK_NEAR(largest_difference(n, x, b), 0.0, 4 * (double)n * U * 50);
    }
    size_t row = 99;
    double pivot = NAN;
    double indefinite[4] = {1, 2, 2, 1}; /* pivot 1: 1 - 4 */
    CHECK(!dal__cholesky(2, indefinite, &row, &pivot) && row == 1 && pivot == -3.0);
    double semidefinite[4] = {1, 1, 1, 1};
    CHECK(!dal__cholesky(2, semidefinite, &row, &pivot) && row == 1 && pivot == 0.0);
    double zero[1] = {0.0}, negative[1] = {-2.0}, unknown[1] = {NAN};
    CHECK(!dal__cholesky(1, zero, &row, &pivot) && row == 0 && pivot == 0.0);
    CHECK(!dal__cholesky(1, negative, NULL, NULL) && !dal__cholesky(1, unknown, NULL, NULL));
    double tiny[4] = {1e-300, 0, 0, 1e300}; /* scales differ, nothing cancels */
    CHECK(dal__cholesky(2, tiny, NULL, NULL));
}

/* ---- LU --------------------------------------------------------------------------------- */

/* A = L R^T with inner size terms, as the Schur complement is made, and the scale of A. */
static void product(size_t m, size_t terms, const double *L, const double *R, double *A,
                    double *scale)
{
    for (size_t a = 0; a < m; a++)
        for (size_t b = 0; b < m; b++) {
            double sum = 0.0, size = 0.0;
            for (size_t i = 0; i < terms; i++) {
                sum += L[a * terms + i] * R[b * terms + i];
                size += fabs(L[a * terms + i] * R[b * terms + i]);
            }
            A[a * m + b] = sum;
            scale[a * m + b] = size;
        }
}

static int factor_product(size_t m, size_t terms, const double *L, const double *R, double *A,
                          size_t *row)
{
    double scale[MOST * MOST];
    product(m, terms, L, R, A, scale);
    return dal_lu_factor(m, terms, A, scale, row);
}

/* Random matrices have conditions below 1e4 here. */
static void test_lu(void)
{
    unsigned seed = 11;
    for (size_t m = 1; m <= MOST; m++)
        for (int trial = 0; trial < 20; trial++) {
            double L[MOST * MOST], one[MOST * MOST] = {0}, A[MOST * MOST], scale[MOST * MOST];
            double LU[MOST * MOST], x[MOST], b[MOST], y[MOST];
            size_t row[MOST];
            for (size_t k = 0; k < m * m; k++) L[k] = next_number(&seed);
            for (size_t i = 0; i < m; i++) {
                L[i * m + (i + 1) % m] += 2.0; /* far from diagonal: rows have to be exchanged */
                one[i * m + i] = 1.0;
                x[i] = next_number(&seed);
            }
            product(m, m, L, one, A, scale);
            memcpy(LU, A, sizeof LU);
            CHECK(dal_lu_factor(m, m, LU, scale, row) == 1);
            dal__apply(m, m, A, x, b);
            dal_lu_solve(m, LU, row, b, y);
            CHECK_NEAR(largest_difference(m, x, y), 0.0, (double)m * U * 1e4);
        }
    double A[4] = {0, 3, 2, 0}, scale[4] = {0, 3, 2, 0}, b[2] = {6, 4}, x[2];
    size_t row[2];
    CHECK(dal_lu_factor(2, 1, A, scale, row) == 1); /* a zero pivot is no obstacle */
    dal_lu_solve(2, A, row, b, x);
    CHECK(x[0] == 2.0 && x[1] == 2.0);
}

/* Large matrices that are well conditioned: what a pivot could have lost does not add up. */
static void test_large_lu(void)
{
    enum { N = 120 };
    static double A[N * N], scale[N * N], LU[N * N];
    static size_t row[N];
    unsigned seed = 3;
    for (int kind = 0; kind < 2; kind++) {
        double x[N], b[N], y[N];
        for (size_t i = 0; i < N; i++)
            for (size_t j = 0; j < N; j++) {
                const double lower = i > j ? 0.9 : i == j ? 1.0 : 0.0; /* x_i - x_(i-1) decays */
                A[i * N + j] = kind == 0 ? next_number(&seed) - 0.5 : lower;
                scale[i * N + j] = kind == 0 ? fabs(A[i * N + j]) : 1.0;
            }
        for (size_t i = 0; i < N; i++) x[i] = next_number(&seed);
        dal__apply(N, N, A, x, b);
        memcpy(LU, A, sizeof A);
        CHECK(dal_lu_factor(N, 2, LU, scale, row) == 1);
        dal_lu_solve(N, LU, row, b, y);
        CHECK_NEAR(largest_difference(N, x, y), 0.0, N * U * 1e4);
    }
}

static void test_singular(void)
{
    size_t row[MOST] = {99};
    double A[MOST * MOST];
    const double exact[2] = {1.0, -1.0}, ones[2] = {1.0, 1.0};
    CHECK(factor_product(1, 2, exact, ones, A, row) == 0 && row[0] == 0); /* 1 - 1 */
    const double almost[3] = {0.1, 0.2, -0.3}, three[3] = {1.0, 1.0, 1.0};
    CHECK(0.1 + 0.2 - 0.3 != 0.0); /* 5.6e-17 that ought to be 0 */
    CHECK(factor_product(1, 3, almost, three, A, row) == 0);
    const double small[2] = {1e-17, 0.0}; /* small, but not by cancellation */
    CHECK(factor_product(1, 2, small, ones, A, row) == 1 && A[0] == 1.0 / 1e-17);
    const double near[2] = {1.0, -1.0 + 1e-12}; /* cancels, and 1e-12 is left that is certain */
    CHECK(factor_product(1, 2, near, ones, A, row) == 1);
    double nothing[1] = {0.0}, unknown[1] = {NAN}, size[1] = {1.0};
    CHECK(dal_lu_factor(1, 1, nothing, size, row) == 0);
    CHECK(dal_lu_factor(1, 1, unknown, size, row) == 0);

    /* Two constraints that coincide, with coefficients that are not exact in binary. */
    const double mu[6] = {0.1, 0.7, 0.3, 0.3, 2.1, 0.9};
    CHECK(factor_product(2, 3, mu, mu, A, row) == 0 && row[0] == 1);
    const double apart[6] = {0.1, 0.7, 0.3, 0.3, 2.1, 0.9 + 1e-6};
    CHECK(factor_product(2, 3, apart, apart, A, row) == 1);
}

/* Rows and columns scaled by powers of two change no decision, and no bit of the solution but its
 * own scale; so do coordinates. */
static void test_rescaling(void)
{
    enum { M = 3, TERMS = 5 };
    static const int left[M] = {0, 300, -250}, right[M] = {-120, 0, 77};
    static const int coordinate[TERMS] = {0, 100, -90, 33, -7};
    unsigned seed = 5;
    for (int trial = 0; trial < 40; trial++) {
        double L[M * TERMS], R[M * TERMS], L2[M * TERMS], R2[M * TERMS], A[M * M], A2[M * M];
        double b[M], b2[M], x[M], x2[M];
        size_t row[M], row2[M];
        for (size_t k = 0; k < M * TERMS; k++) {
            L[k] = next_number(&seed);
            R[k] = next_number(&seed);
        }
        for (size_t i = 0; trial % 2 == 1 && i < TERMS; i++) L[TERMS + i] = 0.3 * L[i];
        for (size_t a = 0; a < M; a++) {
            b[a] = next_number(&seed);
            b2[a] = ldexp(b[a], left[a]);
            for (size_t i = 0; i < TERMS; i++) {
                L2[a * TERMS + i] = ldexp(L[a * TERMS + i], left[a] + coordinate[i]);
                R2[a * TERMS + i] = ldexp(R[a * TERMS + i], right[a] - coordinate[i]);
            }
        }
        const int regular = factor_product(M, TERMS, L, R, A, row);
        CHECK(regular == (trial % 2 == 0));
        CHECK(factor_product(M, TERMS, L2, R2, A2, row2) == regular);
        if (!regular) continue;
        dal_lu_solve(M, A, row, b, x);
        dal_lu_solve(M, A2, row2, b2, x2);
        for (size_t a = 0; a < M; a++) CHECK(ldexp(x2[a], right[a]) == x[a]);
    }
}

int main(void)
{
    test_arena();
    test_overflow();
    test_status();
    test_all_finite();
    test_apply();
    test_cholesky();
    test_lu();
    test_large_lu();
    test_singular();
    test_rescaling();
    return check_done();
}
