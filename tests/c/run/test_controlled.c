/* Error-controlled steps: what they keep, where they end, and runs of them. */
#include "fixtures.h"
#include "check.h"

#include "dalembert/events.h"
#include "step/controlled.h"
#include "step/embedded.h"
#include "step/scheme.h"
#include "step/stepper.h"

enum { MOST = 20000, MOST_2N = 16 };

static dal_stepper *controlled(const dal_system *system, const char *scheme, double tolerance)
{
    const dal_scheme record = find_scheme(scheme);
    return open_stepper(system, &record, &(dal_options){.tolerance = tolerance});
}

static const dal__controlled *of_steps(const dal_stepper *stepper) { return stepper->control_data; }

static void begin(dal_stepper *stepper, const dal_system *system, double t0, double h)
{
    double x[MOST_2N];
    need(dal_system_state(system, x), "state", "");
    need(dal_stepper_start(stepper, t0, h, x, DAL_CHECK, DAL_INITIAL_NONE), "start",
         dal_stepper_error(stepper)->text);
}

/* x[2n] <- the state at t by the flow of the ODE. */
static void flow_to(const dal_system *system, double t, double *x)
{
    dal_stepper *const stepper = open_named(system, "reference");
    begin(stepper, system, 0.0, t);
    need(dal_step(stepper, NULL), "reference", dal_stepper_error(stepper)->text);
    memcpy(x, dal_stepper_state(stepper), 2 * dal_system_n(system) * sizeof *x);
}

/* ---- the estimate --------------------------------------------------------------------------- */

/* The weights of a record whose stages are pairs of sub-steps. */
static int weigh(const char *name, size_t together, double *weight, size_t *stages)
{
    const dal_scheme scheme = find_scheme(name);
    size_t ends[80];
    int q = -1;
    *stages = dal__scheme_count(&scheme) / together;
    for (size_t i = 0; i < *stages; i++) ends[i] = (i + 1) * together;
    const dal__composition of = {.substep = scheme.substeps, .stages = *stages, .ends = ends,
                                 .order = scheme.order};
    CHECK(dal__embedded_weights(&of, weight, &q, NULL) == DAL_SUCCESS);
    return q;
}

/* The orders and the largest weights that least squares by singular values give (NumPy). */
static void test_weights(void)
{
    static const struct {
        const char *name;
        size_t together;
        int q;
        double largest;
    } known[] = {
        {"leapfrog-suzuki4", 2, 3, 2.4048287678}, {"leapfrog-yoshida4", 2, 2, 1.0},
        {"leapfrog-kl6", 2, 4, 2.0130883967},     {"leapfrog-kl8", 2, 6, 17.5754564747},
        {"leapfrog-ss10", 2, 8, 27.2601166863},   {"midpoint-kl8", 1, 6, 17.5754564747},
        {"bm4", 2, 3, 4.8407430813},              {"bm6", 2, 4, 49.2912264590},
        {"bm4", 1, 3, 1.3647055904},              {"bm6", 1, 5, 7.7267946740},
        {"leapfrog", 2, 0, 0.0},
    };
    for (size_t k = 0; k < sizeof known / sizeof known[0]; k++) {
        double weight[81], sum = 0.0, largest = 0.0;
        size_t stages;
        CHECK(weigh(known[k].name, known[k].together, weight, &stages) == known[k].q);
        if (known[k].q == 0) continue;
        for (size_t i = 0; i <= stages; i++) {
            sum += weight[i];
            largest = fmax(largest, fabs(weight[i]));
        }
        CHECK(weight[stages] == 1.0);
        CHECK_NEAR(sum, 0.0, 1e-12 * largest);
        CHECK_NEAR(largest, known[k].largest, 1e-7 * largest);
    }
    const dal_substep mixed[] = {{0.0, 0.5}, {0.5, 0.25}, {1.0, 0.25}};
    const size_t ends[] = {1, 2, 3};
    double weight[4];
    int q = -1;
    CHECK(dal__embedded_weights(&(dal__composition){mixed, 3, ends, 4}, weight, &q, NULL) == 0);
    CHECK(q == 0);
}

/* One step from the same state with smaller and smaller h: the estimate falls with h^(q+1). */
static void test_order_of_the_estimate(void)
{
    static const struct {
        const char *system, *scheme;
        int q;
        double h;
    } cases[] = {{"uneven_edge", "leapfrog-suzuki4", 3, 0.1}, {"generic4", "leapfrog-kl6", 4, 0.1},
                 {"generic4", "bm4", 3, 0.1}, {"rolling_disc", "midpoint-kl6", 4, 0.2},
                 {"uneven_edge", "leapfrog-kl8", 6, 0.3}};
    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        dal_system *const system = open_system(cases[k].system);
        dal_stepper *const stepper = controlled(system, cases[k].scheme, 0.1);
        CHECK(of_steps(stepper)->q == cases[k].q);
        double sizes[2];
        for (int i = 0; i < 2; i++) {
            begin(stepper, system, 0.0, cases[k].h / (1 << i));
            CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
            sizes[i] = 0.0;
            for (size_t j = 0; j < 2 * dal_system_n(system); j++)
                sizes[i] = fmax(sizes[i], fabs(of_steps(stepper)->estimate[j]));
        }
        CHECK_NEAR(log2(sizes[0] / sizes[1]), cases[k].q + 1, 0.5);
        release(system);
    }
}

/* ---- steps ---------------------------------------------------------------------------------- */

/* From a first step found by itself, both ways: the error is of the size of the tolerance or less,
 * D is kept, each time is the sum of the one before and h, and the last is the one asked for. */
static void test_accuracy(void)
{
    static const char *const systems[] = {"particle", "particle_oscillator", "knife_edge", "sleigh",
                                          "robot", "contact_oscillator", "generic4"};
    static const struct {
        const char *scheme;
        double tolerance;
    } ways[] = {{"leapfrog-kl8", 1e-8}, {"leapfrog-suzuki4", 1e-6}, {"bm6", 1e-8},
                {"midpoint-kl6", 1e-8}, {"leapfrog-ss10", 1e-9}};
    for (size_t s = 0; s < sizeof systems / sizeof systems[0]; s++)
        for (size_t w = 0; w < sizeof ways / sizeof ways[0]; w++) {
            dal_system *const system = open_system(systems[s]);
            dal_stepper *const stepper = controlled(system, ways[w].scheme, ways[w].tolerance);
            const size_t n = dal_system_n(system);
            const double end = w % 2 ? -7.3 : 7.3;
            double exact[MOST_2N], error = 0.0;
            begin(stepper, system, 0.0, copysign((double)INFINITY, end));
            CHECK(dal_stepper_until(stepper, end) == DAL_SUCCESS);
            for (double t = 0.0; t != end;) {
                if (dal_step(stepper, NULL)) break;
                const double now = dal_stepper_time(stepper), h = dal_stepper_h(stepper);
                CHECK(now - t == h && t + h == now);
                CHECK(residual_of(system, 0.0, dal_stepper_state(stepper)) <= 4.0 * n * U);
                t = now;
            }
            CHECK(dal_stepper_time(stepper) == end);
            flow_to(system, end, exact);
            for (size_t i = 0; i < 2 * n; i++)
                error = fmax(error, fabs(dal_stepper_state(stepper)[i] - exact[i])
                                        / (1.0 + fabs(exact[i])));
            CHECK(error <= 10.0 * ways[w].tolerance);
            CHECK(dal_step(stepper, NULL) == DAL_EINVAL);
            CHECK(strstr(dal_stepper_error(stepper)->text, "has reached the end of its steps"));
            release(system);
        }
}

/* A tighter tolerance costs steps, a longest step is kept, and a first step that is far too long is
 * made again. */
static void test_lengths(void)
{
    dal_system *const system = open_system("particle_oscillator");
    const dal_scheme kl8 = find_scheme("leapfrog-kl8");
    size_t steps[2];
    for (int k = 0; k < 2; k++) {
        dal_stepper *const stepper = controlled(system, "leapfrog-kl8", k ? 1e-11 : 1e-5);
        begin(stepper, system, 0.0, 50.0);
        CHECK(dal_stepper_until(stepper, 100.0) == DAL_SUCCESS);
        while (dal_stepper_time(stepper) < 100.0 && !dal_step(stepper, NULL))
            CHECK(of_steps(stepper)->error <= 1.0);
        const dal_stats stats = stats_of(stepper);
        CHECK(stats.rejected > 0 && stats.rejected < 20);
        steps[k] = stats.steps;
        release(stepper);
    }
    CHECK_NEAR(log10((double)steps[1] / (double)steps[0]), 6.0 / 8.0, 0.1);
    dal_stepper *const stepper =
        open_stepper(system, &kl8, &(dal_options){.tolerance = 1e-3, .h_max = 0.125});
    begin(stepper, system, 0.0, (double)INFINITY);
    for (int k = 0; k < 50; k++) {
        CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
        CHECK(dal_stepper_h(stepper) <= 0.125);
    }
    CHECK_NEAR(dal_stepper_time(stepper), 6.25, 0.5);
}

/* At the least tolerance roundoff decides, and steps are no shorter than its estimate wants. */
static void test_least_tolerance(void)
{
    static const char *const schemes[] = {"bm6", "leapfrog-kl8", "leapfrog-kl6", "leapfrog-ss10"};
    dal_system *const system = open_system("knife_edge");
    for (size_t s = 0; s < sizeof schemes / sizeof schemes[0]; s++) {
        dal_stepper *const stepper = controlled(system, schemes[s], 1e-14);
        dal_stats stats = {0};
        double exact[MOST_2N];
        begin(stepper, system, 0.0, (double)INFINITY);
        CHECK(dal_stepper_until(stepper, 60.0) == DAL_SUCCESS);
        while (dal_stepper_time(stepper) < 60.0 && stats.steps < MOST) {
            if (dal_step(stepper, NULL)) break;
            dal_stepper_stats(stepper, &stats);
        }
        CHECK(dal_stepper_time(stepper) == 60.0 && stats.rejected < stats.steps / 8);
        flow_to(system, 60.0, exact);
        CHECK(largest_difference(6, dal_stepper_state(stepper), exact) < 1e-10);
        release(stepper);
    }
}

/* On a straight line estimate and error are roundoff: they say nothing of one another, and no step
 * is longer than the tolerance allows. */
static void test_straight_line(void)
{
    dal_system *const system = open_system("particle");
    for (int k = 0; k < 3; k++) {
        dal_stepper *const stepper = controlled(system, k ? "leapfrog-kl8" : "bm6",
                                                k < 2 ? 1e-9 : 1e-13);
        double x[6] = {1.0, 0.3, 0.7, 1.0 / 3.0, 0.0, 0.1}; /* z' = y x' */
        need(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE), "start", "");
        CHECK(dal_stepper_until(stepper, 1e3) == DAL_SUCCESS);
        while (dal_stepper_time(stepper) < 1e3 && !dal_step(stepper, NULL)) continue;
        const dal_stats stats = stats_of(stepper);
        CHECK(of_steps(stepper)->error_ratio == 1.0);
        CHECK(stats.uncontrolled == 0 && stats.steps < 100);
        for (size_t i = 0; i < 3; i++) x[i] += 1e3 * x[3 + i];
        CHECK(largest_difference(6, dal_stepper_state(stepper), x) < 1e-11);
        release(stepper);
    }
}

/* Where an angle has become large its roundoff is that of the estimate: steps do not shrink. */
static void test_large_coordinates(void)
{
    dal_system *const system = open_system("knife_edge");
    dal_stepper *const stepper = controlled(system, "bm6", 1e-14);
    dal_stats stats = {0};
    double x[MOST_2N];
    dal_system_state(system, x);
    x[2] = 2e4; /* the angle */
    need(dal_stepper_start(stepper, 0.0, (double)INFINITY, x, DAL_PROJECT, DAL_INITIAL_NONE),
         "start", dal_stepper_error(stepper)->text);
    CHECK(dal_stepper_until(stepper, 5.0) == DAL_SUCCESS);
    while (dal_stepper_time(stepper) < 5.0 && stats.steps < MOST) {
        if (dal_step(stepper, NULL)) break;
        dal_stepper_stats(stepper, &stats);
    }
    CHECK(dal_stepper_time(stepper) == 5.0);
}

/* V is defined for q_0 < 1 only. */
static int cliff(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    (void)t, (void)ctx;
    if (q[0] >= 1.0) return 1;
    if (V) *V = -log(1.0 - q[0]) / 4.0;
    if (V_q) {
        V_q[0] = 1.0 / (4.0 * (1.0 - q[0]));
        V_q[1] = 0.0;
    }
    if (V_qq) {
        memset(V_qq, 0, 4 * sizeof *V_qq);
        V_qq[0] = 1.0 / (4.0 * (1.0 - q[0]) * (1.0 - q[0]));
    }
    return 0;
}

/* A step out of the domain is made again, shorter; and the turning point is passed. */
static void test_domain(void)
{
    const double mass[4] = {1.0, 0.0, 0.0, 1.0}, state[4] = {0.0, 0.0, 1.0, 1.0};
    const dal_system_def def = {.n = 2, .mass = mass, .potential = cliff, .state = state};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = controlled(system, "leapfrog-kl6", 1e-8);
    begin(stepper, system, 0.0, 3.0);
    CHECK(dal_stepper_until(stepper, 3.0) == DAL_SUCCESS);
    while (dal_stepper_time(stepper) < 3.0 && !dal_step(stepper, NULL)) continue;
    const double *const x = dal_stepper_state(stepper);
    const dal_stats stats = stats_of(stepper);
    CHECK(dal_stepper_time(stepper) == 3.0 && x[2] < -0.9 && stats.rejected > 0);
    CHECK_NEAR(0.5 * x[2] * x[2] - log(1.0 - x[0]) / 4.0, 0.5, 1e-6);
}

/* What was saved goes on bit for bit, also in another stepper; and is refused elsewhere. */
static void test_saved(void)
{
    enum { SAVED = 200 };
    dal_system *const system = open_system("contact_oscillator");
    dal_stepper *const one = controlled(system, "leapfrog-kl6", 1e-7);
    dal_stepper *const other = controlled(system, "leapfrog-kl6", 1e-7);
    dal_stepper *const strange = controlled(system, "leapfrog-kl6", 1e-6);
    dal_stepper *const plain = open_named(system, "leapfrog-kl6");
    const size_t count = dal_stepper_saved(one), N = 2 * dal_system_n(system);
    double values[SAVED], bad[SAVED];
    CHECK(count <= SAVED);
    begin(one, system, 0.3, (double)INFINITY);
    begin(plain, system, 0.3, 0.1);
    CHECK(dal_advance(one, 37, NULL, NULL) == DAL_SUCCESS);
    CHECK(dal_stepper_save(one, values) == DAL_SUCCESS);
    CHECK(dal_stepper_restore(strange, values, count) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(strange)->text, "tolerance = 1e-07") != NULL);
    CHECK(dal_stepper_restore(plain, values, count) == DAL_EINVAL);
    CHECK(dal_stepper_restore(other, values, count) == DAL_SUCCESS);
    for (int k = 0; k < 100; k++) {
        CHECK(dal_step(one, NULL) == DAL_SUCCESS && dal_step(other, NULL) == DAL_SUCCESS);
        CHECK(dal_stepper_time(one) == dal_stepper_time(other));
        CHECK(memcmp(dal_stepper_state(one), dal_stepper_state(other), N * sizeof *bad) == 0);
    }
    enum { NEXT_H = 13 };
    memcpy(bad, values, count * sizeof *bad);
    bad[NEXT_H] = -bad[NEXT_H];
    CHECK(dal_stepper_restore(other, bad, count) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(other)->text, "values[13]") != NULL);
    CHECK(strstr(dal_stepper_error(other)->text, "not of the sign of h") != NULL);
    for (size_t i = count - 1; i < count; i--) { /* no number may lead astray without a word */
        memcpy(bad, values, count * sizeof *bad);
        bad[i] = -1.5;
        if (dal_stepper_restore(other, bad, count) == DAL_SUCCESS) dal_step(other, NULL);
    }
}

static void test_refused(void)
{
    dal_system *const system = open_system("knife_edge");
    STEPPER_REFUSED(system, "leapfrog", "no error estimate", .tolerance = 1e-6);
    STEPPER_REFUSED(system, "explicit", "no error estimate", .tolerance = 1e-6);
    STEPPER_REFUSED(system, "reference", "no error estimate", .tolerance = 1e-6);
    STEPPER_REFUSED(system, "pair:0.5:0.5", "no error estimate", .tolerance = 1e-6);
    STEPPER_REFUSED(system, "midpoint-nodes", "depends on h", .tolerance = 1e-6);
    STEPPER_REFUSED(system, "leapfrog-kl6", "options.tolerance = 1", .tolerance = 1.0);
    STEPPER_REFUSED(system, "leapfrog-kl6", "options.tolerance = -1", .tolerance = -1.0);
    STEPPER_REFUSED(system, "leapfrog-kl6", "options.tolerance = 1e-15", .tolerance = 1e-15);
    STEPPER_REFUSED(system, "leapfrog-kl6", "options.tolerance = nan", .tolerance = (double)NAN);
    STEPPER_REFUSED(system, "leapfrog-kl6", "options.tolerance = 0", .h_max = 1.0);
    STEPPER_REFUSED(system, "leapfrog-kl6", "options.h_max = -1", .tolerance = 1e-6, .h_max = -1.0);
    const dal_scheme kl6 = find_scheme("leapfrog-kl6");
    dal_stepper *const plain = open_stepper(system, &kl6, NULL);
    dal_stepper *const stepper = controlled(system, "leapfrog-kl6", 1e-6);
    double x[MOST_2N];
    CHECK(dal_stepper_until(NULL, 1.0) == DAL_EINVAL);
    CHECK(dal_stepper_until(plain, 1.0) == DAL_EUNSUPPORTED);
    CHECK(dal_stepper_until(stepper, 1.0) == DAL_EINVAL);
    dal_system_state(system, x);
    CHECK(dal_stepper_start(plain, 0.0, (double)INFINITY, x, DAL_CHECK, DAL_INITIAL_NONE)
          == DAL_EINVAL);
    CHECK(dal_stepper_start(stepper, 0.0, (double)NAN, x, DAL_CHECK, DAL_INITIAL_NONE)
          == DAL_EINVAL);
    begin(stepper, system, 1.0, -(double)INFINITY);
    CHECK(dal_stepper_until(stepper, 2.0) == DAL_EINVAL);
    CHECK(dal_stepper_until(stepper, (double)NAN) == DAL_EINVAL);
    CHECK(dal_stepper_until(stepper, 1.0) == DAL_SUCCESS);
    CHECK(dal_step(stepper, NULL) == DAL_EINVAL && dal_stepper_time(stepper) == 1.0);
    dal_run run = {.stepper = stepper, .steps = 5, .stride = 1, .until = 3.0};
    CHECK(dal_run_go(&run, 1) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(stepper)->text, "until = 3") != NULL);
}

/* ---- runs ----------------------------------------------------------------------------------- */

static double rows[(MOST + 2) * MOST_2N], times[MOST + 2], reactions[MOST + 1];

/* Rows every stride-th step, and the last; mean reactions over the time between. */
static void test_rows(void)
{
    dal_system *const system = open_system("particle_oscillator");
    const size_t N = 2 * dal_system_n(system);
    size_t done = 0;
    for (size_t stride = 1; stride <= 7; stride += 6) {
        dal_stepper *const stepper = controlled(system, "leapfrog-kl6", 1e-8);
        begin(stepper, system, 2.0, (double)INFINITY);
        dal_run run = {.stepper = stepper, .steps = MOST, .stride = stride, .until = 12.5,
                       .x = rows, .row_times = times, .reactions = reactions};
        while (run.stored == 0 || times[run.stored - 1] != 12.5)
            if (dal_run_go(&run, 5)) break; /* in pieces */
        if (stride == 1) done = run.done;
        CHECK(run.done == done && run.stored == (done + stride - 1) / stride + 1);
        CHECK(times[0] == 2.0 && times[run.stored - 1] == 12.5);
        CHECK(memcmp(rows + (run.stored - 1) * N, dal_stepper_state(stepper), N * sizeof *rows)
              == 0);
        dal_mechanics *const mechanics = open_mechanics(system);
        for (size_t k = 0; k + 1 < run.stored; k++) {
            double middle[MOST_2N], lambda[1];
            CHECK(times[k] < times[k + 1]);
            if (stride > 1) continue;
            for (size_t i = 0; i < N; i++)
                middle[i] = 0.5 * (rows[k * N + i] + rows[(k + 1) * N + i]);
            CHECK(dal_multipliers(mechanics, 0.0, middle, lambda) == DAL_SUCCESS);
            const double h = times[k + 1] - times[k];
            CHECK_NEAR(reactions[k], lambda[0], 3.0 * h * h);
        }
        release(stepper);
    }
}

/* A point with a force u that is switched: v' = u, so that all is known. */
static int thrust(double t, const double *q, const double *v, const double *u, double *f,
                  double *f_q, double *f_v, void *ctx)
{
    (void)t, (void)q, (void)v, (void)ctx;
    if (f) {
        f[0] = u[0];
        f[1] = 0.0;
    }
    if (f_q) memset(f_q, 0, 4 * sizeof *f_q);
    if (f_v) memset(f_v, 0, 4 * sizeof *f_v);
    return 0;
}

static int count_control(size_t step, double t, const double *x, double *u, void *ctx)
{
    size_t *const calls = ctx;
    (void)step, (void)x;
    CHECK(t == 0.5 + 0.3 * (double)*calls);
    u[0] = (double)++*calls;
    return 0;
}

/* Stops the run once, at the second switch. */
static int stop_once(size_t step, double t, const double *x, double *u, void *ctx)
{
    size_t *const calls = ctx;
    (void)step, (void)t, (void)x;
    if (++*calls == 2) return 1;
    u[0] = *calls == 1 ? 1.0 : (double)(*calls - 1);
    return 0;
}

static void test_inputs(void)
{
    const double mass[4] = {1.0, 0.0, 0.0, 1.0}, state[4] = {0.0, 0.0, 0.0, 1.0};
    const dal_system_def def = {.n = 2, .mass = mass, .force = thrust, .inputs = 1, .state = state};
    dal_system *const system = new_system(&def);
    for (int controlled_by = 0; controlled_by < 2; controlled_by++) {
        dal_stepper *const stepper = controlled(system, "midpoint-suzuki4", 1e-6);
        double u[5] = {1.0, 2.0, 3.0, 4.0, 5.0}, v = 0.0;
        size_t calls = 0;
        begin(stepper, system, 0.5, (double)INFINITY);
        dal_run run = {.stepper = stepper, .steps = MOST, .stride = 1, .until = 1.85, .x = rows,
                       .row_times = times, .inputs = u, .input_duration = 0.3};
        if (controlled_by) {
            run.control = count_control;
            run.control_ctx = &calls;
        }
        CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS);
        CHECK(run.rows_set == 5 && (!controlled_by || calls == 5));
        for (int k = 0; k < 5; k++) {
            size_t at = 0;
            while (at < run.stored && times[at] != 0.5 + 0.3 * k) at++;
            CHECK(at < run.stored); /* a step ends at each switch */
            CHECK_NEAR(rows[4 * at + 2], v, 1e-14);
            v += 0.3 * (k + 1);
        }
        CHECK_NEAR(dal_stepper_state(stepper)[2], 3.0 + 0.15 * 5.0, 1e-13);
        release(stepper);
    }
    /* 3 * 0.3 is less than 0.9: there are three rows all the same; and a controller that stopped is
     * asked again */
    for (int stops = 0; stops < 2; stops++) {
        dal_stepper *const stepper = controlled(system, "midpoint-suzuki4", 1e-6);
        double u[4] = {1.0, 2.0, 3.0, 1e9};
        size_t calls = 0;
        begin(stepper, system, 0.0, (double)INFINITY);
        dal_run run = {.stepper = stepper, .steps = MOST, .stride = 1, .until = 0.9, .inputs = u,
                       .input_duration = 0.3};
        if (stops) {
            run.control = stop_once;
            run.control_ctx = &calls;
            CHECK(dal_run_go(&run, SIZE_MAX) == DAL_STOPPED && run.rows_set == 1);
        }
        CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS && run.rows_set == 3);
        CHECK_NEAR(dal_stepper_state(stepper)[2], 0.3 * (1.0 + 2.0 + 3.0), 1e-13);
        release(stepper);
    }
    const double refused[4] = {0.0, -0.3, (double)INFINITY, NAN};
    for (size_t k = 0; k < 4; k++) {
        dal_stepper *const stepper = controlled(system, "midpoint-suzuki4", 1e-6);
        double u = 1.0;
        begin(stepper, system, 0.0, (double)INFINITY);
        dal_run run = {.stepper = stepper, .steps = MOST, .stride = 1, .until = 0.9, .inputs = &u,
                       .input_duration = refused[k]};
        CHECK(dal_run_go(&run, SIZE_MAX) == DAL_EINVAL);
        CHECK(strstr(dal_stepper_error(stepper)->text, "input_duration = "));
        release(stepper);
    }
}

/* A sleigh that is thrown back by a wall, and stops at its second visit; output times. */
static int wall(double t, const double *x, double *g, void *ctx)
{
    (void)t, (void)ctx;
    *g = x[0] - 0.4;
    return 0;
}

static int turn_back(double t, double *x, void *ctx)
{
    (void)t, (void)ctx;
    for (int i = 3; i < 6; i++) x[i] = -x[i];
    return 0;
}

static void test_events(void)
{
    dal_system *const system = open_system("knife_edge");
    const dal_scheme kl8 = find_scheme("leapfrog-kl8");
    const dal_event list[1] = {{.g = wall, .direction = 1, .reset = turn_back, .terminal = 3}};
    const double wanted[4] = {0.01, 0.2, 0.5, 0.61};
    double at[4 * 6], exact[6];
    dal_error error = {0};
    dal_stepper *const stepper =
        open_stepper(system, &kl8, &(dal_options){.tolerance = 1e-10, .h_max = 0.5});
    begin(stepper, system, 0.0, (double)INFINITY);
    dal_events *events = NULL;
    need(dal_events_new(&events, stepper, &kl8, list, 1, &error), "events", error.text);
    dal_run run = {.stepper = stepper, .steps = MOST, .stride = 1, .until = 50.0, .x = rows,
                   .row_times = times, .reactions = reactions, .events = events,
                   .times = wanted, .time_count = 4, .x_at_times = at};
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_STOPPED && run.ended && run.times_done == 4);
    const double *const end = rows + (run.stored - 1) * 6;
    CHECK(times[run.stored - 1] == run.t_end);
    CHECK_NEAR(end[0], 0.4, 1e-14);
    size_t turned = 0;
    for (size_t k = 0; k < run.stored; k++) {
        CHECK(residual_of(system, 0.0, rows + 6 * k) <= 12.0 * U);
        if (k > 0) CHECK(times[k] > times[k - 1] && rows[6 * k] <= 0.4 + 1e-12);
        turned += fabs(rows[6 * k] - 0.4) < 1e-12 && rows[6 * k + 3] < 0.0;
    }
    CHECK(turned == 2); /* steps end at the resets, and go on from the states after them */
    flow_to(system, 0.2, exact); /* before the wall */
    CHECK(largest_difference(6, at + 6, exact) < 1e-8);
    dal_events_free(events);
}

static int unit_spring(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    (void)t, (void)ctx;
    if (V) *V = 0.5 * q[0] * q[0];
    if (V_q) V_q[0] = q[0];
    if (V_qq) V_qq[0] = 1.0;
    return 0;
}

/* From (q, v) = (1, 0) of q'' = -q the rates are 1 and, relative to 1 + |q|, 1/2: the first step is
 * the one whose estimate is a hundredth of the tolerance, at most h_max, in either direction. */
static void test_first_step(void)
{
    const double mass = 1.0, x[2] = {1.0, 0.0};
    const dal_system_def def = {.n = 1, .mass = &mass, .potential = unit_spring, .state = x};
    const dal_scheme record = find_scheme("midpoint-suzuki4");
    dal_system *const system = new_system(&def);
    for (int k = 0; k < 4; k++) {
        const double direction = k % 2 ? -1.0 : 1.0, longest = k < 2 ? 0.0 : 1e-3;
        dal_stepper *const stepper =
            open_stepper(system, &record, &(dal_options){.tolerance = 1e-6, .h_max = longest});
        double h = 0.0;
        begin(stepper, system, 0.0, direction * (double)INFINITY);
        const dal__controlled *const of = of_steps(stepper);
        const double either = direction * (double)INFINITY;
        CHECK(dal__controlled_steps.start(stepper, 0.0, either, x, &h) == DAL_SUCCESS);
        const double exact = pow(0.01 * of->tolerance, 1.0 / (of->q + 1.0));
        CHECK_NEAR(h, direction * (longest > 0.0 ? longest : exact), 8.0 * U);
        release(stepper);
    }
}

int main(void)
{
    test_weights();
    test_first_step();
    test_order_of_the_estimate();
    test_accuracy();
    test_lengths();
    test_least_tolerance();
    test_straight_line();
    test_large_coordinates();
    test_domain();
    test_saved();
    test_refused();
    test_rows();
    test_inputs();
    test_events();
    return check_done();
}
