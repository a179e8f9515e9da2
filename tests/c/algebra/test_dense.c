/* The ground: one allocation carved into arrays, sizes that overflow; products. */
#include "fixtures.h"
#include "check.h"

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

/* All results that are wanted, or none; what is not wanted may be anything. */
static void test_deliver(void)
{
    const double good[2] = {1.0, 2.0}, bad[2] = {3.0, NAN};
    double first[2] = {7.0, 7.0}, second[2] = {7.0, 7.0};
    dal_error error = {0};
    CHECK(DAL__DELIVER(&error, {"first", 2, good, first}, {"second", 2, bad, second})
          == DAL_EDOMAIN);
    CHECK(first[0] == 7.0 && second[0] == 7.0 && strstr(error.text, "second[1]") != NULL);
    CHECK(DAL__DELIVER(&error, {"first", 2, good, first}, {"second", 2, bad, NULL}) == 0);
    CHECK(first[0] == 1.0 && first[1] == 2.0);
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

/* G <- the Gram matrix of rows[m*3] scaled to length 1, or 0. */
static void build_gram(size_t m, const double (*rows)[3], double *G)
{
    for (size_t a = 0; a < m; a++)
        for (size_t b = 0; b < m; b++) {
            const double lengths =
                sqrt(dal__dot(3, rows[a], rows[a]) * dal__dot(3, rows[b], rows[b]));
            G[a * m + b] = lengths > 0.0 ? dal__dot(3, rows[a], rows[b]) / lengths : 0.0;
        }
}

static void test_independent_rows(void)
{
    double G[16];
    size_t order[4];
    /* the last of those that could be said to depend: e - 2 d, of lengths 1, 5, 5, and 0 */
    const double rows[4][3] = {{1, 0, 0}, {3, 4, 0}, {0, 0, 0}, {1, 4, 0}};
    build_gram(4, rows, G);
    CHECK(dal__independent_rows(4, G, 1e-12, order) == 2 && order[0] == 0 && order[1] == 1);
    const size_t k = order[2] == 3 ? 2 : 3;
    CHECK(order[k] == 3 && order[5 - k] == 2);
    CHECK_NEAR(G[k * 4], -2.0 / sqrt(17.0), 1e-15);
    CHECK_NEAR(G[k * 4 + 1], 5.0 / sqrt(17.0), 1e-15);
    CHECK(G[(5 - k) * 4] == 0.0 && G[(5 - k) * 4 + 1] == 0.0);
    CHECK(fabs(G[5 * k]) < 1e-15 && G[0] == 1.0);
    CHECK_NEAR(G[5], 0.64, 1e-15); /* what is left of the second row: (4/5)^2 */

    /* The second row is nearly the first, and exactly a sum of the others. */
    const double near[3][3] = {{1, 0, 0}, {1, 1e-4, 0}, {0, 1, 0}};
    build_gram(3, near, G);
    CHECK(dal__independent_rows(3, G, 1e-12, order) == 2 && order[2] == 1);
    CHECK(order[0] == 0 && order[1] == 2);
    CHECK_NEAR(G[6], 1.0, 1e-8);
    CHECK_NEAR(G[7], 1e-4, 1e-8);
    build_gram(3, near, G);
    CHECK(dal__independent_rows(1, G, 1e-12, order) == 1);

    G[1] = (double)NAN;
    CHECK(dal__independent_rows(3, G, 1e-12, order) == 0 && order[0] == 3);
}

int main(void)
{
    test_independent_rows();
    test_arena();
    test_overflow();
    test_status();
    test_deliver();
    test_all_finite();
    test_apply();
    return check_done();
}
