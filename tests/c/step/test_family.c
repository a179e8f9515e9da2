/* A family that is no part of the library, loaded while the program runs, on the public headers:
 * it integrates, keeps D, has its order in a study, and goes on from what was saved.
 *
 * The argument is the module that tests/family_heun.c was made into. */
#include "check.h"
#include "dalembert/family.h"
#include "dalembert/inspect.h"
#include "dalembert/study.h"

#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>

enum { N2 = 8, M = 2, STEPS = 200 };

static const dal_scheme *load(const char *path, void **module)
{
    *module = dlopen(path, RTLD_NOW);
    const dal_scheme *const scheme = *module ? dlsym(*module, "heun_scheme") : NULL;
    if (scheme) return scheme;
    fprintf(stderr, "%s\n", dlerror());
    exit(2);
}

static dal_stepper *started(const dal_system *system, const dal_scheme *scheme, double h)
{
    dal_stepper *stepper = NULL;
    dal_error error;
    double x[N2];
    check_true(dal_stepper_new(&stepper, system, scheme, NULL, &error) == 0, error.text, "new",
               __LINE__);
    CHECK(dal_system_state(system, x) == 0);
    CHECK(dal_stepper_start(stepper, 0.0, h, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    return stepper;
}

/* The disk has an exact solution: the error of Heun's method is of order h^2, and D is kept. */
static void test_runs(const dal_system *system, const dal_scheme *scheme)
{
    static double rows[(STEPS + 1) * N2], reactions[STEPS * M], relative[STEPS + 1];
    double error[2] = {0.0, 0.0};
    for (int k = 0; k < 2; k++) {
        const double h = k == 0 ? 0.02 : 0.01;
        dal_stepper *const stepper = started(system, scheme, h);
        dal_mechanics *mechanics = NULL;
        double exact[N2];
        size_t done = 0, good = 0;
        CHECK(dal_mechanics_new(&mechanics, system, NULL) == 0);
        CHECK(dal_integrate(stepper, STEPS, 1, rows, reactions, NULL, NULL, &done) == 0);
        CHECK(done == STEPS && dal_stepper_time(stepper) == STEPS * h);
        CHECK(dal_trajectory(mechanics, 0.0, h, 0.0, STEPS + 1, rows, NULL, NULL, NULL, NULL,
                             relative, &good) == 0);
        for (size_t row = 0; row <= STEPS; row++) CHECK(relative[row] <= 4 * 4 * 0x1p-53);
        for (size_t i = 0; i < STEPS * M; i++) CHECK(isnan(reactions[i]));
        CHECK(dal_system_exact(system, 1.0, rows, exact) == 0);
        const double *const at_1 = rows + (k == 0 ? 50 : 100) * N2;
        for (size_t i = 0; i < N2; i++) error[k] = fmax(error[k], fabs(at_1[i] - exact[i]));
        dal_mechanics_free(mechanics);
        dal_stepper_free(stepper);
    }
    CHECK(error[0] > 1e-6);
    CHECK_NEAR(log2(error[0] / error[1]), 2.0, 0.1);
}

static void test_order(const dal_system *system, const dal_scheme *scheme)
{
    static const size_t steps[] = {16, 32, 64, 128, 256, 512};
    enum { COUNT = sizeof steps / sizeof *steps };
    dal_order_point points[COUNT];
    dal_order order;
    dal_error error;
    double x[N2];
    CHECK(dal_system_state(system, x) == 0);
    const dal_order_def def = {.t_end = 1.0, .x0 = x, .steps = steps, .count = COUNT};
    check_true(dal_order_study(system, scheme, &def, points, &order, &error) == 0, error.text,
               "study", __LINE__);
    CHECK_NEAR(order.p, 2.0, 0.2);
    CHECK_NEAR(order.global_state.slope, 2.0, 0.2);
    check_true(order.keeps_D == 1 && order.holds == 1, order.text, "holds", __LINE__);
    dal_scheme vain = *scheme;
    vain.order = 3;
    CHECK(dal_order_study(system, &vain, &def, points, &order, NULL) == 0 && order.holds == 0);
}

/* It saves nothing of its own: what the stepper keeps is enough. */
static void test_saved(const dal_system *system, const dal_scheme *scheme)
{
    enum { MOST = 128 };
    dal_stepper *const one = started(system, scheme, 0.05);
    dal_stepper *const two = started(system, scheme, -0.1);
    double values[MOST];
    const size_t count = dal_stepper_saved(one);
    if (count > MOST) exit(2);
    CHECK(dal_advance(one, 70, NULL, NULL) == 0);
    CHECK(dal_stepper_save(one, values) == 0);
    CHECK(dal_stepper_restore(two, values, count) == 0);
    CHECK(dal_advance(one, 70, NULL, NULL) == 0 && dal_advance(two, 70, NULL, NULL) == 0);
    CHECK(memcmp(dal_stepper_state(one), dal_stepper_state(two), N2 * sizeof *values) == 0);
    CHECK(dal_stepper_time(one) == dal_stepper_time(two));
    dal_scheme library;
    dal_stepper *other = NULL;
    CHECK(dal_scheme_find(&library, "midpoint", NULL) == 0);
    CHECK(dal_stepper_new(&other, system, &library, NULL, NULL) == 0);
    CHECK(dal_stepper_restore(other, values, count) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(other)->text, "another system or scheme") != NULL);
    dal_stepper_free(other);
    dal_stepper_free(one);
    dal_stepper_free(two);
}

/* What goes wrong in a step is said as by the families of the library, and has changed nothing. */
static void test_failure(const dal_system *system, const dal_scheme *scheme)
{
    dal_stepper *const stepper = started(system, scheme, 0.1);
    double x[N2], reaction[M] = {7.0, 7.0};
    CHECK(dal_system_state(system, x) == 0);
    for (size_t i = 0; i < N2; i++) x[i] = i < N2 / 2 ? 1e308 : 0.0;
    x[N2 / 2 + 3] = 1e308;
    CHECK(dal_stepper_start(stepper, 0.0, 10.0, x, DAL_ASSUME, DAL_INITIAL_NONE) == 0);
    CHECK(dal_step(stepper, reaction) < 0 && reaction[0] == 7.0);
    CHECK(strncmp(dal_stepper_error(stepper)->text, "step 1 (t = 0, h = 10): ", 24) == 0);
    CHECK(strlen(dal_stepper_error(stepper)->text) > 24);
    CHECK(memcmp(x, dal_stepper_state(stepper), sizeof x) == 0);
    dal_stepper_free(stepper);
}

/* One that leaves everything where it is: nothing but advance is needed. */
static int stay(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    CHECK(!method && motion->x);
    *done = steps;
    return DAL_SUCCESS;
}

static int refuse(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    CHECK(!method && motion->x && steps > 0);
    *done = 0;
    return DAL_ENOCONV;
}

static void test_parts(const dal_system *system)
{
    const dal_family still = {.name = "still", .advance = stay}, without_name = {.advance = stay};
    const dal_family without_advance = {.name = "still"};
    const dal_family silent = {.name = "silent", .advance = refuse};
    const dal_scheme scheme = {.name = "own", .family = &still};
    const dal_scheme refusing = {.name = "own", .family = &silent};
    dal_stepper *stepper = NULL;
    dal_error error;
    double x[2 * N2];
    size_t done = 0;
    CHECK(dal_stepper_new(&stepper, system, &(dal_scheme){.name = "a", .family = &without_name},
                          NULL, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "family->name is NULL") != NULL);
    CHECK(dal_stepper_new(&stepper, system, &(dal_scheme){.name = "a", .family = &without_advance},
                          NULL, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "family->advance is NULL") != NULL && !stepper);
    CHECK(dal_stepper_new(&stepper, system, &scheme, NULL, &error) == 0);
    CHECK(dal_system_state(system, x) == 0);
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_advance(stepper, 10, NULL, &done) == 0 && done == 10);
    CHECK(dal_stepper_time(stepper) == 10 * 0.1);
    dal_stepper_free(stepper);
    CHECK(dal_stepper_new(&stepper, system, &refusing, NULL, &error) == 0);
    x[0] = (double)NAN;
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EINVAL);
    CHECK(dal_system_state(system, x) == 0);
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_step(stepper, NULL) == DAL_ENOCONV);
    CHECK(strstr(dal_stepper_error(stepper)->text, "step 1 (t = 0, h = 0.1): an iteration did not "
                 "converge") != NULL);
    dal_stepper_free(stepper);
}

int main(int count, char **words)
{
    if (count != 2) return 2;
    void *module;
    const dal_scheme *const scheme = load(words[1], &module);
    dal_system *system = NULL;
    CHECK(dal_system_builtin(&system, "disk", NULL, NULL, 0, NULL) == 0);
    CHECK(strcmp(dal_scheme_family(scheme), "heun") == 0);
    CHECK(!dal_scheme_is_explicit(scheme, system));
    test_runs(system, scheme);
    test_order(system, scheme);
    test_saved(system, scheme);
    test_failure(system, scheme);
    test_parts(system);
    dal_system_free(system);
    dlclose(module);
    return check_done();
}
