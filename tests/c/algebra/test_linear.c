/* The five functions of a linear solver: equations and their transposes, the sign of the
 * determinant, what is singular, and sizes that make units no matter. */
#include "fixtures.h"
#include "check.h"

enum { MOST = 6 };

static dal__linear open_linear(size_t size, arena *memory)
{
    dal__linear self;
    dal__linear_reserve(&self, size, memory);
    need(dal__allocate(memory, NULL), "linear", "");
    return self;
}

/* As where nothing is known of the entries but their values. */
static int factor(dal__linear *self, const double *A)
{
    double scale[MOST * MOST];
    for (size_t k = 0; k < self->size * self->size; k++) {
        self->A[k] = A[k];
        scale[k] = fabs(A[k]);
    }
    dal__linear_balance(self, scale);
    return dal__linear_factor(self);
}

/* A x = b and A^T x = b of every size that was reserved for, with rows and columns in units from
 * 1e-60 to 1e60. */
static void test_equations(void)
{
    arena memory = {0};
    dal__linear self = open_linear(MOST, &memory);
    unsigned seed = 7;
    CHECK(self.size == MOST);
    for (int trial = 0; trial < 600; trial++) {
        const size_t m = (size_t)trial % (MOST + 1);
        double A[MOST * MOST], b[MOST], x[MOST], y[MOST], row[MOST], column[MOST];
        for (size_t i = 0; i < m; i++) {
            row[i] = pow(10.0, 60.0 * next_number(&seed));
            column[i] = pow(10.0, 60.0 * next_number(&seed));
            x[i] = next_number(&seed) / column[i];
        }
        for (size_t i = 0; i < m; i++)
            for (size_t j = 0; j < m; j++)
                A[i * m + j] = (next_number(&seed) + (i == j ? 4.0 : 0.0)) * row[i] * column[j];
        self.size = m;
        CHECK(factor(&self, A) == 1); /* the diagonal dominates */
        dal__apply(m, m, A, x, b);
        dal__linear_solve(&self, b, y);
        for (size_t i = 0; i < m; i++) CHECK_NEAR(y[i] * column[i], x[i] * column[i], 1e3 * U);
        for (size_t i = 0; i < m; i++) x[i] *= column[i] / row[i];
        for (size_t j = 0; j < m; j++) {
            b[j] = 0.0;
            for (size_t i = 0; i < m; i++) b[j] += A[i * m + j] * x[i];
        }
        dal__linear_solve_transposed(&self, b, y);
        for (size_t i = 0; i < m; i++) CHECK_NEAR(y[i] * row[i], x[i] * row[i], 1e3 * U);
    }
    dal__release(&memory);
}

static void test_sign(void)
{
    static const struct {
        size_t size;
        double A[9];
        int sign;
    } cases[] = {
        {1, {3}, 1},
        {1, {-1e-300}, -1},
        {1, {0}, 0},
        {2, {0, 1, 1, 0}, -1},
        {2, {0, -2, 3, 0}, 1},
        {2, {1e200, 1, 1, -1e-150}, -1},
        {2, {1, 2, 0.5, 1}, 0},
        {2, {1, 0.1, 10, 1}, 0},
        {2, {NAN, 1, 1, 2}, 0},
        {3, {0, 1, 0, 0, 0, 1, 1, 0, 0}, 1},
        {3, {1, 2, 3, 4, 5, 6, 7, 8, 9}, 0},
        {3, {1, 2, 3, 4, 5, 6, 7, 8, 10}, -1},
    };
    arena memory = {0};
    dal__linear self = open_linear(3, &memory);
    for (size_t i = 0; i < DAL_LENGTH(cases); i++) {
        self.size = cases[i].size;
        check_true(factor(&self, cases[i].A) == cases[i].sign, "test_sign", "sign", (int)i);
    }
    dal__release(&memory);
}

/* What is left of 1 - 1 is singular where the sizes say that there were ones, and only there. */
static void test_sizes(void)
{
    arena memory = {0};
    dal__linear self = open_linear(2, &memory);
    for (int cancelled = 0; cancelled < 2; cancelled++) {
        const double A[4] = {1.0, 0.0, 0.0, 1e-16};
        memcpy(self.A, A, sizeof A);
        for (size_t k = 0; k < 4; k++) self.sizes[k] = k % 2 && !cancelled ? 1e-8 : 1.0;
        CHECK(dal__linear_factor(&self) == (cancelled ? 0 : 1));
    }
    dal__release(&memory);
}

int main(void)
{
    test_equations();
    test_sign();
    test_sizes();
    return check_done();
}
