/* bench_flow.c - the scheme reference against GSL's rk8pd on the ODE on D written by hand.
 *
 * The same method, tolerance and times at which states are wanted, from the same state: the scheme
 * on a system with callbacks, or on a model compiled by the Python package; and GSL's driver on
 * hand_flows.c.  The scheme also keeps D, and looks at all that it is given.
 *
 * Usage: bench_flow for the systems of the library, or bench_flow SYSTEM MODEL.so PARAMETER...
 * STATE..., MODEL.so as bench_flow.py made it from expressions.  A last argument "once" makes one
 * run of each without a clock, for callgrind. */
#include "bench.h"
#include "hand_flows.h"

#include <dlfcn.h>
#include <gsl/gsl_errno.h>
#include <gsl/gsl_odeiv2.h>
#include <math.h>
#include <string.h>

enum { REPETITIONS = 100, STEPS = 40, MOST = 8, SIZE = 8 };
static const double TOLERANCE = 1e-11, STRIDE = 5.0;

typedef struct pair_of {
    const char *system;
    hand_flow *by_hand;
    size_t n, parameters;
    double of_builtin, of_model; /* bars of the ratio of times */
} pair_of;

static const pair_of pairs[] = {
    {"particle", hand_flow_particle, 3, 0, 2.0, 1.2}, /* the inner steps are as long as STRIDE */
    {"particle_oscillator", hand_flow_particle_oscillator, 3, 3, 1.8, 1.0},
    {"knife_edge", hand_flow_knife_edge, 3, 3, 1.8, 1.3},
    {"sleigh", hand_flow_sleigh, 3, 4, 1.4, 1.15},
    {"robot", hand_flow_robot, 4, 5, 2.0, 1.2},
};

typedef struct bench {
    const pair_of *pair;
    double p[MOST], state[2 * SIZE];
    double ours[2 * SIZE], theirs[2 * SIZE]; /* at the end */
    size_t our_calls, their_calls;
    dal_stepper *stepper;
} bench;

static double flow_of_library(bench *b)
{
    dal_stats stats;
    bench_require(dal_stepper_start(b->stepper, 0.0, STRIDE, b->state, DAL_PROJECT,
                                    DAL_INITIAL_NONE), "dal_stepper_start");
    const double begin = bench_now();
    for (size_t k = 0; k < STEPS; k++)
        bench_require(dal_advance(b->stepper, 1, NULL, NULL), "dal_advance");
    const double seconds = bench_now() - begin;
    dal_stepper_stats(b->stepper, &stats);
    b->our_calls = stats.evaluations;
    memcpy(b->ours, dal_stepper_state(b->stepper), 2 * b->pair->n * sizeof *b->ours);
    return seconds;
}

static int counted(double t, const double x[], double rates[], void *ctx)
{
    bench *const b = ctx;
    b->their_calls++;
    return b->pair->by_hand(t, x, rates, b->p);
}

static double flow_by_hand(bench *b, bool count)
{
    gsl_odeiv2_system system = {b->pair->by_hand, NULL, 2 * b->pair->n, b->p};
    if (count) system = (gsl_odeiv2_system){counted, NULL, 2 * b->pair->n, b};
    const double begin = bench_now();
    gsl_odeiv2_driver *const driver = gsl_odeiv2_driver_alloc_y_new(
        &system, gsl_odeiv2_step_rk8pd, 1e-2, TOLERANCE, TOLERANCE);
    double t = 0.0, x[2 * SIZE];
    memcpy(x, b->state, sizeof x);
    for (size_t k = 1; k <= STEPS; k++)
        if (gsl_odeiv2_driver_apply(driver, &t, (double)k * STRIDE, x)) exit(EXIT_FAILURE);
    gsl_odeiv2_driver_free(driver);
    const double seconds = bench_now() - begin;
    memcpy(b->theirs, x, sizeof x);
    return seconds;
}

static bool compare(bench *b, const dal_system *system, bool is_model, bool once)
{
    const dal_flow_scheme data = {DAL_FLOW_RK8PD, TOLERANCE};
    dal_scheme scheme;
    double ours = INFINITY, theirs = INFINITY, apart = 0.0, size = 0.0;
    bench_require(dal_scheme_find(&scheme, "reference", NULL), "dal_scheme_find");
    scheme.data = &data;
    bench_require(dal_stepper_new(&b->stepper, system, &scheme, NULL, NULL), "dal_stepper_new");
    flow_of_library(b);
    flow_by_hand(b, true);
    for (int repetition = 0; !once && repetition < REPETITIONS; repetition++) {
        bench_keep_least(&ours, flow_of_library(b));
        bench_keep_least(&theirs, flow_by_hand(b, false));
    }
    dal_stepper_free(b->stepper);
    for (size_t i = 0; i < 2 * b->pair->n; i++) {
        apart = fmax(apart, fabs(b->ours[i] - b->theirs[i]));
        size = fmax(size, fabs(b->theirs[i]));
    }
    printf("%s %s: states at t = %g differ by %.0e\n", b->pair->system,
           is_model ? "from expressions" : "of the library", STEPS * STRIDE, apart / size);
    bench_report("evaluations for a state", (double)b->our_calls / STEPS, "");
    bench_report("evaluations / by hand", (double)b->our_calls / (double)b->their_calls, "");
    if (once) return true;
    bench_report("of the library, an evaluation", 1e9 * ours / (double)b->our_calls, "ns");
    bench_report("by hand", 1e9 * theirs / (double)b->their_calls, "ns");
    return bench_at_most("time of the library / by hand", ours / theirs,
                         is_model ? b->pair->of_model : b->pair->of_builtin)
         & (apart <= 1e-6 * size);
}

static bool compare_builtin(bench *b, bool once)
{
    dal_system *system;
    bench_require(dal_system_builtin(&system, b->pair->system, NULL, NULL, 0, NULL),
                  b->pair->system);
    for (size_t i = 0; i < dal_system_parameters(system); i++)
        b->p[i] = dal_system_parameter(system, i); /* the sleigh has no spring */
    bench_require(dal_system_state(system, b->state), "dal_system_state");
    const bool kept = compare(b, system, false, once);
    dal_system_free(system);
    return kept;
}

static void *find(void *library, const char *name)
{
    void *const found = library ? dlsym(library, name) : NULL;
    if (!found) exit(EXIT_FAILURE);
    return found;
}

static bool compare_model(bench *b, char **words, bool once)
{
    double mass[SIZE * SIZE];
    for (size_t i = 0; i < b->pair->parameters; i++) b->p[i] = atof(words[1 + i]);
    for (size_t i = 0; i < 2 * b->pair->n; i++)
        b->state[i] = atof(words[1 + b->pair->parameters + i]);
    void *const library = dlopen(words[0], RTLD_NOW);
    void (*fill)(double *, const double *);
    *(void **)&fill = find(library, "dal_model_mass");
    fill(mass, b->p);
    dal_system_def def = *(const dal_system_def *)find(library, "dal_model");
    def.mass = mass;
    def.state = b->state;
    def.ctx = b->p;
    def.ctx_size = sizeof b->p;
    dal_system *system;
    dal_error error;
    bench_require(dal_system_new(&system, &def, &error), error.text);
    const bool kept = compare(b, system, true, once);
    dal_system_free(system);
    return kept;
}

int main(int count, char **words)
{
    const bool once = strcmp(words[count - 1], "once") == 0;
    const size_t given = (size_t)count - 1 - once;
    bool kept = true;
    for (size_t i = 0; i < sizeof pairs / sizeof *pairs; i++) {
        bench b = {.pair = &pairs[i]};
        if (given > 0 && strcmp(pairs[i].system, words[1]) != 0) continue;
        if (given < 2) kept &= compare_builtin(&b, once);
        else kept &= given == 2 + b.pair->parameters + 2 * b.pair->n
                  && compare_model(&b, words + 2, once);
    }
    return kept ? EXIT_SUCCESS : EXIT_FAILURE;
}
