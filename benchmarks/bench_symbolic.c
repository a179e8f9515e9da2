/* bench_symbolic.c - a model compiled by the Python package, against what is written by hand.
 *
 * Usage: bench_symbolic SYSTEM MODEL.so [PARAMETER...], SYSTEM the index of a bench_system,
 * MODEL.so the same system as bench_symbolic.py made it from expressions. */
#include "bench.h"
#include "hand_loop.h"

#include <dlfcn.h>
#include <math.h>
#include <string.h>

enum { REPETITIONS = 200, HAND_STEPS = 200000, STEPS = 40000, CALLS = 40000, MOST = 8 };

/* Seconds for a step, from the initial data. */
static double time_step(dal_stepper *stepper, const dal_system_def *def)
{
    bench_start(stepper, def, 0.01);
    const double start = bench_now();
    bench_require(dal_advance(stepper, STEPS, NULL, NULL), "dal_advance");
    return (bench_now() - start) / STEPS;
}

static double time_hand_loop(hand_loop *loop, const dal_system_def *def)
{
    double x[6];
    memcpy(x, def->state, sizeof x);
    const double start = bench_now();
    loop(HAND_STEPS, 0.01, x);
    return (bench_now() - start) / HAND_STEPS;
}

/* Seconds for a call of the constraint as a step makes it, with mu and d(mu v)/dq; each call waits
 * for the one before. */
static double time_constraint(const dal_system_def *def)
{
    double x[2 * MOST], mu[MOST * MOST], N[MOST * MOST];
    memcpy(x, def->state, 2 * def->n * sizeof *x);
    const double start = bench_now();
    for (int k = 0; k < CALLS; k++) {
        bench_require(def->constraint(0.0, x, x + def->n, NULL, mu, N, NULL, def->ctx),
                      "constraint");
        for (size_t i = 0; i < def->n; i++) x[i] += 1e-6 * (mu[i] + N[i]);
    }
    return (bench_now() - start) / CALLS;
}

static dal_stepper *open_stepper(dal_system **system, const dal_system_def *def)
{
    dal_error error;
    bench_require(dal_system_new(system, def, &error), error.text);
    return bench_stepper(BY_LIBRARY, *system);
}

int main(int count, char **words)
{
    if (count < 3) return EXIT_FAILURE;
    const dal_system_def *const hand = &bench_systems[atoi(words[1])];
    void *const library = dlopen(words[2], RTLD_NOW);
    const dal_system_def *const model = library ? dlsym(library, "dal_model") : NULL;
    if (!model) {
        fprintf(stderr, "%s\n", dlerror());
        return EXIT_FAILURE;
    }
    double parameters[MOST] = {0.0};
    for (int i = 3; i < count && i < 3 + MOST; i++) parameters[i - 3] = atof(words[i]);
    dal_system_def def = *model;
    def.mass = hand->mass;
    def.state = hand->state;
    def.ctx = parameters;
    def.ctx_size = sizeof parameters;

    dal_system *own, *by_hand;
    dal_stepper *const inlined = open_stepper(&own, &def);
    dal_stepper *const called = open_stepper(&by_hand, hand);
    double compensated = INFINITY, plain = INFINITY; /* loops by hand */
    double fast = INFINITY, slow = INFINITY, ours = INFINITY, theirs = INFINITY;
    for (int repetition = 0; repetition < REPETITIONS; repetition++) {
        bench_keep_least(&fast, time_step(inlined, hand));
        bench_keep_least(&slow, time_step(called, hand));
        bench_keep_least(&ours, time_constraint(&def));
        bench_keep_least(&theirs, time_constraint(hand));
        if (atoi(words[1]) != BENCH_PARTICLE) continue;
        bench_keep_least(&compensated, time_hand_loop(hand_compensated_loop, hand));
        bench_keep_least(&plain, time_hand_loop(hand_plain_loop, hand));
    }
    printf("%s from expressions, midpoint, h = 0.01\n", hand->name);
    bench_report("step with the callbacks inside", 1e9 * fast, "ns");
    bench_report("step of the library, callbacks by hand", 1e9 * slow, "ns");
    bool kept = true;
    if (atoi(words[1]) == BENCH_PARTICLE) {
        bench_report("loop by hand, compensated sums", 1e9 * compensated, "ns");
        bench_report("loop by hand, plain sums", 1e9 * plain, "ns");
        kept &= bench_at_most("step / loop by hand, compensated", fast / compensated, 1.5);
        bench_report("step / loop by hand, plain", fast / plain, "");
    }
    kept &= bench_at_most("step / step of the library", fast / slow, 1.2);
    kept &= bench_at_most("callback / callback by hand", ours / theirs, 1.15);
    dal_stepper_free(inlined);
    dal_stepper_free(called);
    dal_system_free(own);
    dal_system_free(by_hand);
    return kept ? EXIT_SUCCESS : EXIT_FAILURE;
}
