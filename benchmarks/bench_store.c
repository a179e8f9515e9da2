/* bench_store.c - seconds of a stored run from C, for bench_python.py: `bench_store STEPS`.
 *
 * The particle, midpoint; every state and every reaction goes into freshly allocated arrays, whose
 * pages are part of the time. */
#include "bench.h"

int main(int count, char **arguments)
{
    const size_t steps = count == 2 ? strtoul(arguments[1], NULL, 10) : 0;
    if (steps == 0) {
        fprintf(stderr, "usage: bench_store STEPS\n");
        return EXIT_FAILURE;
    }
    dal_system *system;
    bench_require(dal_system_builtin(&system, "particle", NULL, NULL, 0, NULL),
                  "dal_system_builtin");
    double x0[6];
    bench_require(dal_system_state(system, x0), "dal_system_state");
    dal_stepper *const stepper = bench_stepper(BY_LIBRARY, system);
    bench_require(dal_stepper_start(stepper, 0.0, 0.01, x0, DAL_CHECK, DAL_INITIAL_NONE),
                  "dal_stepper_start");

    const double start = bench_now();
    double *const x = malloc((steps + 1) * sizeof x0), *const reactions = malloc(steps * sizeof *x);
    if (!x || !reactions) bench_require(DAL_ENOMEM, "malloc");
    bench_require(dal_integrate(stepper, steps, 1, x, reactions, NULL, NULL, NULL),
                  "dal_integrate");
    printf("%.9f\n", bench_now() - start);

    free(x);
    free(reactions);
    dal_stepper_free(stepper);
    dal_system_free(system);
    return EXIT_SUCCESS;
}
