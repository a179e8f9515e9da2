/* bench_step.c - what a step costs: against a loop written by hand, and in evaluations of mu. */
#include "bench.h"
#include "hand_loop.h"

#include <math.h>

/* Repetitions of about two milliseconds each. */
enum { REPETITIONS = 200, HAND_STEPS = 200000, LIBRARY_STEPS = 40000 };

/* Seconds that a stepper takes for one step, from the initial data. */
static double time_step(dal_stepper *stepper, const dal_system_def *def, double h)
{
    bench_start(stepper, def, h);
    const double start = bench_now();
    bench_require(dal_advance(stepper, LIBRARY_STEPS, NULL, NULL), "dal_advance");
    return (bench_now() - start) / LIBRARY_STEPS;
}

static double time_hand_loop(const dal_system_def *def, double h)
{
    double x[6];
    for (int i = 0; i < 6; i++) x[i] = def->state[i];
    const double start = bench_now();
    hand_compensated_loop(HAND_STEPS, h, x);
    return (bench_now() - start) / HAND_STEPS;
}

/* The largest difference of the states after so many steps: both must make the same step. */
static double difference(dal_stepper *stepper, const dal_system_def *def, double h, size_t steps)
{
    double x[6], largest = 0.0;
    for (int i = 0; i < 6; i++) x[i] = def->state[i];
    hand_compensated_loop(steps, h, x);
    bench_start(stepper, def, h);
    bench_require(dal_advance(stepper, steps, NULL, NULL), "dal_advance");
    for (int i = 0; i < 6; i++) largest = fmax(largest, fabs(dal_stepper_state(stepper)[i] - x[i]));
    return largest;
}

static bool compare_with_hand_loop(void)
{
    const dal_system_def *const def = &bench_systems[BENCH_PARTICLE];
    const double h = 0.01;
    dal_system *system;
    bench_require(dal_system_new(&system, def, NULL), "dal_system_new");
    dal_stepper *const constant = bench_stepper(BY_LIBRARY, system);
    dal_stepper *const run_time = bench_stepper(BY_ANY_SIZES, system);

    double hand = INFINITY, with_constants = INFINITY, with_run_time = INFINITY;
    for (int repetition = 0; repetition < REPETITIONS; repetition++) {
        bench_keep_least(&with_constants, time_step(constant, def, h));
        bench_keep_least(&with_run_time, time_step(run_time, def, h));
        bench_keep_least(&hand, time_hand_loop(def, h));
    }

    printf("step of the particle, midpoint, h = %g\n", h);
    bench_report("loop by hand, compensated sums", 1e9 * hand, "ns");
    bench_report("library, constant (n, m)", 1e9 * with_constants, "ns");
    bench_report("library, run-time sizes", 1e9 * with_run_time, "ns");
    bool kept = bench_at_most("constant (n, m) / by hand", with_constants / hand, 4.5);
    kept &= bench_at_most("run-time sizes / by hand", with_run_time / hand, 9.5);
    kept &= bench_at_most("difference of the states after 1000 steps",
                          difference(constant, def, h, 1000), 0.0);
    dal_stepper_free(constant);
    dal_stepper_free(run_time);
    dal_system_free(system);
    return kept;
}

static bool count_evaluations(void)
{
    static const double h[] = {0.01, 0.001};
    const size_t steps = 10000;
    bool kept = true;
    printf("evaluations of the constraint a step, midpoint, V = 0: one more where not steady\n");
    for (int i = 0; i < BENCH_SYSTEMS; i++) {
        dal_system *system;
        bench_require(dal_system_new(&system, &bench_systems[i], NULL), "dal_system_new");
        dal_stepper *const stepper = bench_stepper(BY_LIBRARY, system);
        for (size_t j = 0; j < sizeof h / sizeof *h; j++) {
            char what[64];
            dal_stats stats;
            bench_start(stepper, &bench_systems[i], h[j]);
            bench_require(dal_advance(stepper, steps, NULL, NULL), "dal_advance");
            dal_stepper_stats(stepper, &stats);
            snprintf(what, sizeof what, "%s, h = %g", bench_systems[i].name, h[j]);
            kept &= bench_at_most(what, (double)stats.constraint_calls / (double)steps,
                                   bench_systems[i].steady ? 2.2 : 3.2);
        }
        dal_stepper_free(stepper);
        dal_system_free(system);
    }
    return kept;
}

int main(void)
{
    bool kept = compare_with_hand_loop();
    kept &= count_evaluations();
    return kept ? EXIT_SUCCESS : EXIT_FAILURE;
}
