/* bench_stage.c - a stage of leapfrog with a potential, of a model compiled by the Python package,
 * against the same stage written by hand: with the compensated sums of the library, and with plain
 * ones.
 *
 * Usage: bench_stage SYSTEM MODEL.so HAND.so PARAMETER... STATE..., SYSTEM the name of a pair_of,
 * MODEL.so the same system as bench_stage.py made it from expressions, HAND.so hand_stages.c. */
#include "bench.h"
#include "hand_stages.h"

#include <dlfcn.h>
#include <math.h>
#include <string.h>

enum { REPETITIONS = 300, CHECKED = 1000, STAGES = 20000, MOST = 17, SIZE = 8 };

typedef struct pair_of {
    const char *system;
    size_t n, parameters;
    bool same_bits; /* by hand and of the library, with compensated sums */
} pair_of;

static const pair_of pairs[] = {
    {"particle_oscillator", 3, 3, true},
    {"contact_oscillator", 3, 1, true},
    {"knife_edge", 3, 3, true},
    {"robot", 4, 5, false},
    {"sleigh", 3, 4, false},
};

/* The functions that are timed; all start from state, with steps of size h. */
typedef struct bench {
    const pair_of *pair;
    hand_fn *compensated, *plain; /* of hand_stages.h */
    const double *p, *state;
    double h;
    size_t count; /* stages of a step */
    hand_stage stage[MOST];
    dal_stepper *stepper;
} bench;

/* Weights of the parabola through the values at three times, the latest first, at the time t; or
 * the last value, where these lie too close together. */
static void look_ahead(const double times[3], double t, double weight[3])
{
    double sum = 0.0;
    for (int i = 0; i < 3; i++) {
        const double other = times[(i + 1) % 3], last = times[(i + 2) % 3];
        weight[i] = (t - other) / (times[i] - other) * ((t - last) / (times[i] - last));
        sum += fabs(weight[i]);
    }
    if (sum <= 10.0) return;
    weight[0] = 1.0;
    weight[1] = weight[2] = 0.0;
}

/* The stages of a record of fused pairs. */
static void plan(bench *b, const dal_scheme *scheme)
{
    b->count = scheme->count / 2;
    if (b->count > MOST) exit(EXIT_FAILURE);
    for (size_t j = 0; j < b->count; j++) {
        const dal_substep *const part = scheme->substeps + 2 * j;
        if (part[0].beta != 0.0 || part[1].beta != 1.0) exit(EXIT_FAILURE);
        hand_stage *const s = &b->stage[j];
        s->before = part[0].fraction * b->h;
        s->after = part[1].fraction * b->h;
        s->span = b->h * (part[0].fraction + part[1].fraction);
    }
    for (size_t j = 0; j < b->count; j++) {
        hand_stage *const s = &b->stage[j];
        double times[3], start = 0.0, spans[3];
        for (size_t back = 1; back <= 3; back++) {
            const hand_stage *const past = &b->stage[(j + 3 * b->count - back) % b->count];
            start -= past->span;
            times[back - 1] = start + past->before;
            spans[back - 1] = past->span;
        }
        look_ahead(times, s->before, s->ahead);
        for (int i = 0; i < 3; i++) s->ahead[i] *= s->span / spans[i];
    }
}

static void start(const bench *b)
{
    bench_require(dal_stepper_start(b->stepper, 0.0, b->h, b->state, DAL_CHECK, DAL_INITIAL_NONE),
                  "dal_stepper_start");
}

/* Seconds for a stage. */
static double time_stage(const bench *b)
{
    const size_t steps = STAGES / b->count;
    start(b);
    const double begin = bench_now();
    bench_require(dal_advance(b->stepper, steps, NULL, NULL), "dal_advance");
    return (bench_now() - begin) / (double)(steps * b->count);
}

static double time_by_hand(const bench *b, hand_fn *hand)
{
    const size_t steps = STAGES / b->count;
    double x[2 * SIZE];
    memcpy(x, b->state, 2 * b->pair->n * sizeof *x);
    const double begin = bench_now();
    hand(steps, b->count, b->stage, b->p, x);
    return (bench_now() - begin) / (double)(steps * b->count);
}

/* The largest difference of the states after some steps, in units of the largest component. */
static double disagreement(const bench *b, hand_fn *hand)
{
    double x[2 * SIZE], largest = 0.0, size = 0.0;
    memcpy(x, b->state, 2 * b->pair->n * sizeof *x);
    hand(CHECKED, b->count, b->stage, b->p, x);
    start(b);
    bench_require(dal_advance(b->stepper, CHECKED, NULL, NULL), "dal_advance");
    const double *const ours = dal_stepper_state(b->stepper);
    for (size_t i = 0; i < 2 * b->pair->n; i++) {
        largest = fmax(largest, fabs(x[i] - ours[i]));
        size = fmax(size, fabs(ours[i]));
    }
    return largest / size;
}

static bool agree(const bench *b, const char *what, hand_fn *hand, double bar)
{
    const double apart = disagreement(b, hand);
    printf("  %-52s %8.0e   <= %-4g %s\n", what, apart, bar, apart <= bar ? "ok" : "MISSED");
    return apart <= bar;
}

static bool compare(bench *b, const dal_system *system, const char *name)
{
    dal_scheme scheme;
    double ours = INFINITY, compensated = INFINITY, plain = INFINITY;
    bench_require(dal_scheme_find(&scheme, name, NULL), "dal_scheme_find");
    bench_require(dal_stepper_new(&b->stepper, system, &scheme, NULL, NULL), "dal_stepper_new");
    plan(b, &scheme);
    for (int repetition = 0; repetition < REPETITIONS; repetition++) {
        bench_keep_least(&ours, time_stage(b));
        bench_keep_least(&compensated, time_by_hand(b, b->compensated));
        bench_keep_least(&plain, time_by_hand(b, b->plain));
    }
    printf("%s from expressions, a stage of %s, h = %g\n", b->pair->system, name, b->h);
    bench_report("of the library", 1e9 * ours, "ns");
    bench_report("by hand, compensated sums", 1e9 * compensated, "ns");
    bench_report("by hand, plain sums", 1e9 * plain, "ns");
    bool kept = bench_at_most("of the library / by hand, compensated", ours / compensated, 1.5);
    bench_report("of the library / by hand, plain", ours / plain, "");
    kept &= agree(b, "compensated: states after 1000 steps differ by", b->compensated,
                  b->pair->same_bits ? 0.0 : 1e-14);
    kept &= agree(b, "plain: states after 1000 steps differ by", b->plain, 1e-12);
    dal_stepper_free(b->stepper);
    return kept;
}

/* The function of a library; the program ends if there is none. */
static void *find(const char *path, const char *name)
{
    void *const library = dlopen(path, RTLD_NOW), *const found = library ? dlsym(library, name)
                                                                         : NULL;
    if (found) return found;
    fprintf(stderr, "%s: %s\n", path, dlerror());
    exit(EXIT_FAILURE);
}

int main(int count, char **words)
{
    bench b = {.h = 0.01};
    for (size_t i = 0; count > 1 && i < sizeof pairs / sizeof *pairs; i++)
        if (strcmp(pairs[i].system, words[1]) == 0) b.pair = &pairs[i];
    if (!b.pair || (size_t)count != 4 + b.pair->parameters + 2 * b.pair->n) return EXIT_FAILURE;
    double p[SIZE], state[2 * SIZE], mass[SIZE * SIZE];
    for (size_t i = 0; i < b.pair->parameters; i++) p[i] = atof(words[4 + i]);
    for (size_t i = 0; i < 2 * b.pair->n; i++) state[i] = atof(words[4 + b.pair->parameters + i]);
    b.p = p;
    b.state = state;
    void (*fill)(double *, const double *);
    *(void **)&fill = find(words[2], "dal_model_mass");
    char function[64];
    snprintf(function, sizeof function, "hand_compensated_%s", b.pair->system);
    *(void **)&b.compensated = find(words[3], function);
    snprintf(function, sizeof function, "hand_plain_%s", b.pair->system);
    *(void **)&b.plain = find(words[3], function);
    fill(mass, p);
    dal_system_def def = *(const dal_system_def *)find(words[2], "dal_model");
    def.mass = mass;
    def.state = state;
    def.ctx = p;
    def.ctx_size = sizeof p;
    dal_system *system;
    dal_error error;
    bench_require(dal_system_new(&system, &def, &error), error.text);
    bool kept = compare(&b, system, "leapfrog");
    kept &= compare(&b, system, "leapfrog-kl8");
    dal_system_free(system);
    return kept ? EXIT_SUCCESS : EXIT_FAILURE;
}
