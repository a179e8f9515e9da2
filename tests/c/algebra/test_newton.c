/* Newton's iteration: what it finds, halves, refuses and says; and that none of this depends on
 * units. */
#include "fixtures.h"
#include "check.h"

enum { MOST = 4 };

/* ---- one unknown ---------------------------------------------------------------------------- */

typedef enum equation {
    LOGARITHM,    /* log z = 0, not defined for z <= 0 */
    NO_ROOT,      /* z^2 + 1 = 0 */
    CUBE,         /* z^3 = 1, with the derivative 0 at 0 */
    DOUBLE_ROOT,  /* z^2 = 0, to which Newton converges linearly */
    ARCTANGENT,   /* atan z = 0, from which Newton is led away if it starts far out */
    SQUARE,       /* z^2 = 1, with a determinant that is negative at -1 */
    STOPPING,     /* the same, with a callback that stops at its third call */
    CORNER,       /* z = 1 where z <= 3, not defined beyond nor below -3: 1000 from z = 0 */
    OVERFLOWING,  /* z = 0, but for a second unknown which is infinite */
} equation;

typedef struct problem {
    equation which;
    size_t calls;
    bool signs; /* are told */
    dal__root root;
    dal_error error;
    arena memory;
} problem;

static int find_step(dal__newton *self)
{
    problem *const p = self->ctx;
    dal__root *const root = &p->root;
    const double z = self->z[0];
    double f = z * z - 1.0, slope = 2.0 * z;
    p->calls++;
    switch (p->which) {
    case LOGARITHM:
        if (!(z > 0.0)) return DAL_EDOMAIN;
        f = log(z), slope = 1.0 / z;
        break;
    case NO_ROOT: f = z * z + 1.0; break;
    case CUBE: f = pow(z, 3.0) - 1.0, slope = 3.0 * z * z; break;
    case DOUBLE_ROOT: f = z * z; break;
    case ARCTANGENT: f = atan(z), slope = 1.0 / (1.0 + z * z); break;
    case SQUARE: break;
    case STOPPING:
        if (p->calls == 3) return dal__fail(&p->error, DAL_EUSER, "enough");
        break;
    case CORNER:
        if (fabs(z) > 3.0) return DAL_EDOMAIN;
        f = z - 1.0, slope = z == 0.0 ? 1e-3 : 1.0;
        break;
    case OVERFLOWING: f = z, slope = 1.0; break;
    }
    root->residual[0] = f;
    root->J.A[0] = slope;
    root->scale[0] = fabs(slope);
    if (p->signs && slope < 0.0) self->sign = -1;
    const int status = dal__root_step(root, "flat", &p->error);
    if (p->which == OVERFLOWING) self->step[1] = INFINITY;
    return status;
}

static const double one = 1.0;

static dal__newton open_problem(problem *p, equation which, double guess)
{
    *p = (problem){.which = which};
    dal__root_reserve(&p->root, 2, &p->memory);
    need(dal__allocate(&p->memory, NULL), "root", "");
    p->root.J.size = 1;
    p->root.z[0] = guess;
    return (dal__newton){.find_step = find_step, .ctx = p, .size = 1, .measured = 1, .n = 1,
                         .per_unit = &one, .z = p->root.z, .step = p->root.step};
}

static void test_roots(void)
{
    static const struct {
        equation which;
        int status;
        double guess, root;
        int halvings;
    } cases[] = {
        {LOGARITHM, DAL_SUCCESS, 1.5, 1.0, 0},
        {LOGARITHM, DAL_SUCCESS, 10.0, 1.0, 3}, /* to -13, halved twice to 4.2; to -1.8, halved */
        {LOGARITHM, DAL_SUCCESS, 1e6, 1.0, -1},
        {LOGARITHM, DAL_EDOMAIN, -1.0, NAN, 0}, /* there is no step to halve */
        {NO_ROOT, DAL_ENOCONV, 0.7, NAN, 0},
        {CUBE, DAL_SUCCESS, 3.0, 1.0, 0},
        {CUBE, DAL_ESINGULAR, 0.0, NAN, 0},
        {DOUBLE_ROOT, DAL_ENOCONV, 1.0, NAN, 0},
        {ARCTANGENT, DAL_SUCCESS, 1.0, 0.0, 0},
        {ARCTANGENT, DAL_ENOCONV, 2.0, NAN, 0},
        {SQUARE, DAL_SUCCESS, -3.0, -1.0, 0},
        {STOPPING, DAL_EUSER, 3.0, NAN, 0},
        {CORNER, DAL_SUCCESS, 0.0, 1.0, 9}, /* 1000/2^9 < 3 */
    };
    for (size_t c = 0; c < DAL_LENGTH(cases); c++) {
        problem p;
        dal__newton newton = open_problem(&p, cases[c].which, cases[c].guess);
        check_true(dal__newton_run(&newton, &p.error) == cases[c].status, "test_roots", "status",
                   (int)c);
        if (!cases[c].status) CHECK_NEAR(newton.z[0], cases[c].root, 4 * U);
        if (cases[c].halvings >= 0) CHECK(newton.progress.halvings == cases[c].halvings);
        if (cases[c].status == DAL_ESINGULAR) CHECK(strcmp(p.error.text, "flat") == 0);
        if (cases[c].status == DAL_EUSER) CHECK(strcmp(p.error.text, "enough") == 0);
        if (cases[c].status == DAL_EUSER) CHECK(p.calls == 3);
        dal__release(&p.memory);
    }
}

/* Quadratic convergence is seen in advance: the last step is not made to be found to be roundoff,
 * unless something lags behind it. */
static void test_iterations(void)
{
    int made[2];
    for (int lagging = 0; lagging < 2; lagging++) {
        problem p;
        dal__newton newton = open_problem(&p, SQUARE, 1.3);
        newton.lagging = lagging;
        CHECK(dal__newton_run(&newton, &p.error) == 0 && newton.z[0] == 1.0);
        made[lagging] = newton.progress.iteration;
        CHECK(p.calls == (size_t)made[lagging]);
        dal__release(&p.memory);
    }
    CHECK(made[0] == 5 && made[1] == 6);
}

/* Steps that lead out of the domain however often they are halved. */
static int nowhere(dal__newton *self)
{
    size_t *const calls = self->ctx;
    self->step[0] = 1.0;
    return ++*calls > 1 ? DAL_EDOMAIN : DAL_SUCCESS;
}

static void test_halving_in_vain(void)
{
    double z[1] = {0.0}, step[1];
    size_t calls = 0;
    dal__newton newton = {.find_step = nowhere, .ctx = &calls, .size = 1, .measured = 1, .n = 1,
                          .per_unit = &one, .z = z, .step = step};
    CHECK(dal__newton_run(&newton, NULL) == DAL_EDOMAIN);
    CHECK(calls == 42 && newton.progress.halvings == 40);
}

/* A determinant that is negative on the way: where it says which solution is meant. */
static void test_branch(void)
{
    for (int signs = 0; signs < 2; signs++)
        for (int side = -1; side <= 1; side += 2) {
            problem p;
            dal__newton newton = open_problem(&p, SQUARE, 1.5 * side);
            p.signs = signs;
            const bool refused = signs && side < 0;
            CHECK(dal__newton_run(&newton, &p.error) == (refused ? DAL_ENOCONV : DAL_SUCCESS));
            if (refused) CHECK(strcmp(p.error.text, DAL__BRANCH_TEXT) == 0 && p.calls == 1);
            else CHECK(newton.z[0] == side);
            dal__release(&p.memory);
        }
}

static void test_texts(void)
{
    problem p;
    double far = 0.0, first = 0.0, scale = 0.0;
    int iterations = 0, end = 0;
    dal__newton newton = open_problem(&p, ARCTANGENT, 2.0);
    CHECK(dal__newton_run(&newton, &p.error) == DAL_ENOCONV);
    CHECK(sscanf(p.error.text, "Newton did not converge: its updates add up to %lf, the first was "
                 "%lf (size of the unknowns %lf); try a smaller%n", &far, &first, &scale,
                 &end) == 3);
    CHECK(strcmp(p.error.text + end, " h") == 0);
    CHECK_NEAR(first, 5.0 * atan(2.0), 5e-3 * first);
    CHECK(far > first && scale > 0.0);
    dal__release(&p.memory);

    newton = open_problem(&p, DOUBLE_ROOT, 1.0);
    newton.most = 7;
    newton.advice = "it is a double root";
    CHECK(dal__newton_run(&newton, &p.error) == DAL_ENOCONV && p.calls == 7);
    CHECK(sscanf(p.error.text, "Newton did not converge in %d iterations: the last update was "
                 "%lf (size of the unknowns %lf); it is a double %n", &iterations, &first,
                 &scale, &end) == 3);
    CHECK(iterations == 7 && strcmp(p.error.text + end, "root") == 0);
    CHECK_NEAR(first, 0x1p-7, 1e-5);
    dal__release(&p.memory);

    /* no solution is one that is not finite, in an unknown that is not measured either */
    newton = open_problem(&p, OVERFLOWING, 1.0);
    newton.size = 2;
    CHECK(dal__newton_run(&newton, &p.error) == DAL_ENOCONV && p.calls == 1);
    CHECK(strstr(p.error.text, "in 1 iterations") != NULL);
    dal__release(&p.memory);
}

/* ---- units ---------------------------------------------------------------------------------- */

/* w_i = far angles turned: w = (cos, sin)(q) at q = far + h w, in the units of w and q, of which q
 * is rounded; and then the same of a second pair, if there are four unknowns. */
typedef struct turning {
    double unit[2], far, h;
    double moves; /* how far the rounding of q moves w */
    dal__root root;
} turning;

static int turn(dal__newton *self)
{
    turning *const t = self->ctx;
    dal__root *const root = &t->root;
    const size_t N = self->size;
    t->moves = 0.0;
    memset(root->J.A, 0, N * N * sizeof *root->J.A);
    for (size_t k = 0; k < N; k += 2) {
        const double *const z = self->z + k, *const u = t->unit;
        const double q = t->far * u[0] + t->h * z[0], angle = q / u[0];
        const double value[2] = {cos(angle) * u[0], sin(angle) * u[1]};
        const double slope[2] = {-sin(angle), cos(angle) * u[1] / u[0]};
        double *const J = root->J.A + k * N + k;
        for (size_t i = 0; i < 2; i++) {
            root->residual[k + i] = z[i] - value[i];
            J[i * N] = (i == 0) - t->h * slope[i];
            J[i * N + 1] = i == 1;
            t->moves += fabs(slope[i] * q) / u[i];
        }
    }
    for (size_t k = 0; k < N * N; k++) root->scale[k] = fabs(root->J.A[k]);
    return dal__root_step(root, "singular", NULL);
}

static double moves(void *ctx) { return ((turning *)ctx)->moves; }

/* In other units the same is found, in as many iterations.  Far out the steps stop to shrink where
 * they are what the rounding of q makes of them, which has to be told. */
static void test_units(void)
{
    static const double fars[] = {0.0, 1e3, 1e6, 1e8};
    for (size_t f = 0; f < DAL_LENGTH(fars); f++)
        for (size_t pairs = 1; pairs <= 2; pairs++)
            for (int told = 0; told < 2; told++) {
                double found[5][MOST];
                int status[5], iterations[5];
                static const int exponents[5][2] = {{0, 0}, {20, 20}, {-20, -20}, {20, -20},
                                                    {-40, 0}};
                for (size_t k = 0; k < 5; k++) {
                    arena memory = {0};
                    turning t = {.far = fars[f], .h = 0.5};
                    dal__root_reserve(&t.root, MOST, &memory);
                    need(dal__allocate(&memory, NULL), "root", "");
                    for (size_t i = 0; i < 2; i++) t.unit[i] = ldexp(1.0, exponents[k][i]);
                    const double per_unit[2] = {1.0 / t.unit[0], 1.0 / t.unit[1]};
                    t.root.J.size = 2 * pairs;
                    dal__newton newton = {.find_step = turn, .ctx = &t, .size = 2 * pairs, .n = 2,
                                          .measured = 2 * pairs, .per_unit = per_unit,
                                          .z = t.root.z, .step = t.root.step,
                                          .moves = told ? moves : NULL};
                    status[k] = dal__newton_run(&newton, NULL);
                    iterations[k] = newton.progress.iteration;
                    for (size_t i = 0; i < 2 * pairs; i++)
                        found[k][i] = newton.z[i] * per_unit[i % 2];
                    dal__release(&memory);
                    CHECK(status[k] == status[0] && iterations[k] == iterations[0]);
                    CHECK_NEAR(largest_difference(2 * pairs, found[k], found[0]), 0.0, 0.0);
                }
                if (told) CHECK(status[0] == DAL_SUCCESS);
                if (told && fars[f] == 0.0) CHECK_NEAR(found[0][0], cos(0.5 * found[0][0]), 4 * U);
            }
}

/* An unknown that is not measured is not waited for. */
static int follow(dal__newton *self)
{
    self->step[0] = 1.0 - self->z[0];
    self->step[1] = self->progress.iteration < 4 ? ldexp(1.0, -3 * self->progress.iteration) : 0.0;
    return DAL_SUCCESS;
}

static void test_measure(void)
{
    for (size_t measured = 1; measured <= 2; measured++) {
        double z[2] = {0.0, 0.0}, step[2];
        const double per_unit[1] = {1.0};
        dal__newton newton = {.find_step = follow, .size = 2, .measured = measured, .n = 1,
                              .per_unit = per_unit, .z = z, .step = step};
        CHECK(dal__newton_run(&newton, NULL) == DAL_SUCCESS);
        CHECK(z[0] == 1.0 && z[1] == (measured == 1 ? 1.125 : 1.125 + 0x9p-9));
    }
}

/* A base that is far larger than the unknowns: its roundoff is theirs. */
static int settle(dal__newton *self)
{
    self->base = *(const double *)self->ctx;
    const int made = self->progress.iteration;
    self->step[0] = made == 0 ? 1.0 : made % 2 ? 1e-9 : -1e-9;
    return DAL_SUCCESS;
}

static void test_base(void)
{
    for (int large = 0; large < 2; large++) {
        double z[1] = {0.0}, step[1], base = large ? 1e3 : 0.0;
        dal__newton newton = {.find_step = settle, .ctx = &base, .size = 1, .measured = 1, .n = 1,
                              .per_unit = &one, .z = z, .step = step, .lagging = true};
        CHECK(dal__newton_run(&newton, NULL) == (large ? DAL_SUCCESS : DAL_ENOCONV));
        CHECK(newton.progress.iteration == (large ? 3 : 50));
    }
}

int main(void)
{
    test_roots();
    test_iterations();
    test_halving_in_vain();
    test_branch();
    test_texts();
    test_units();
    test_measure();
    test_base();
    return check_done();
}
