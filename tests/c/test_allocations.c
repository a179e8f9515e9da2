/* Memory: malloc fails at each allocation of everything that allocates, and a step asks for none.
 *
 * Two counters.  The linker sends the library's own calls (and not GSL's) to __wrap_malloc and its
 * kin, where they can be made to fail.  The definitions of malloc and its kin below stand before
 * those of the C library for the whole process, GSL included; there they are counted. */
#define _GNU_SOURCE /* RTLD_NEXT */
#include "check.h"
#include "dalembert/discrete.h"
#include "dalembert/ensemble.h"
#include "dalembert/study.h"
#include "generic4.h"
#include "oracle/multiroot.h"

#include <ctype.h>
#include <dlfcn.h>
#include <gsl/gsl_errno.h>
#include <gsl/gsl_vector.h>
#include <stdlib.h>
#include <string.h>

/* ---- the whole process -------------------------------------------------------------------- */

static struct {
    size_t calls; /* that allocate */
    long live;    /* blocks now */
    size_t fail_from, fail_until;
} process = {.fail_from = SIZE_MAX};

/* The next definitions, after those of this file. */
static struct {
    bool sought;
    void *(*malloc)(size_t);
    void *(*calloc)(size_t, size_t);
    void *(*realloc)(void *, size_t);
    void (*free)(void *);
} next;

/* Through memcpy, as C has no cast from object to function pointers. */
static void find(const char *name, void *function)
{
    void *const found = dlsym(RTLD_NEXT, name);
    memcpy(function, &found, sizeof found);
}

static void find_all(void)
{
    if (next.sought) return;
    next.sought = true;
    find("malloc", &next.malloc);
    find("calloc", &next.calloc);
    find("realloc", &next.realloc);
    find("free", &next.free);
}

/* The call is counted; whether it is to fail. */
static bool process_fails(void)
{
    const size_t call = process.calls++;
    return process.fail_from <= call && call < process.fail_until;
}

static void *counted(void *block)
{
    if (block) process.live++;
    return block;
}

void *malloc(size_t size)
{
    find_all();
    return process_fails() ? NULL : counted(next.malloc(size));
}

void *calloc(size_t count, size_t size)
{
    find_all();
    return process_fails() ? NULL : counted(next.calloc(count, size));
}

void *realloc(void *block, size_t size)
{
    find_all();
    if (process_fails()) return NULL;
    return block ? next.realloc(block, size) : counted(next.realloc(block, size));
}

void free(void *block)
{
    find_all();
    if (!block || !next.free) return; /* dlsym frees an old message before it finds free */
    process.live--;
    next.free(block);
}

/* ---- the library's own -------------------------------------------------------------------- */

static struct {
    size_t calls, fail_from, fail_until;
} own = {.fail_from = SIZE_MAX};

static bool own_fails(void)
{
    const size_t call = own.calls++;
    return own.fail_from <= call && call < own.fail_until;
}

void *__real_malloc(size_t size);
void *__real_calloc(size_t count, size_t size);
void *__real_realloc(void *block, size_t size);
void *__wrap_malloc(size_t size);
void *__wrap_calloc(size_t count, size_t size);
void *__wrap_realloc(void *block, size_t size);

void *__wrap_malloc(size_t size) { return own_fails() ? NULL : __real_malloc(size); }

void *__wrap_calloc(size_t count, size_t size)
{
    return own_fails() ? NULL : __real_calloc(count, size);
}

void *__wrap_realloc(void *block, size_t size)
{
    return own_fails() ? NULL : __real_realloc(block, size);
}

static void fail_own(size_t from, size_t until)
{
    own.calls = 0;
    own.fail_from = from;
    own.fail_until = until;
}

static void fail_process(size_t from, size_t until)
{
    process.calls = 0;
    process.fail_from = from;
    process.fail_until = until;
}

static void fail_nothing(void)
{
    fail_own(SIZE_MAX, SIZE_MAX);
    fail_process(SIZE_MAX, SIZE_MAX);
}

/* Both counters count what they should. */
static void test_counters(void)
{
    const size_t calls = process.calls;
    const long live = process.live;
    gsl_vector *vector = gsl_vector_alloc(3); /* by GSL: data, block, vector */
    CHECK(process.calls == calls + 3 && process.live == live + 3);
    gsl_vector_free(vector);
    CHECK(process.live == live);

    own.calls = 0;
    arena memory = {0};
    double *array;
    dal__reserve(&memory, &array, 5, sizeof *array);
    CHECK(dal__allocate(&memory, NULL) == 0);
    CHECK(own.calls == 1 && process.calls == calls + 4);
    dal__release(&memory);
    CHECK(process.live == live);
}

/* ---- allocations that fail ---------------------------------------------------------------- */

enum { MOST = 8, COUNT = 3 };

/* What the makers are made from. */
static dal_system *particle, *generic4, *sleigh;
static dal_mechanics *mechanics;
static dal_flow *reference;
static double state[MOST];

typedef enum maker {
    SYSTEM, SYSTEM_DIAGONAL, SYSTEM_SPARSE, BUILTIN, DEFORMED, DEFORMED_NODES, MECHANICS, CHART,
    FLOW_RK8PD, FLOW_MSADAMS, FLOW_RODAS, FLOW_IN_XI, STEPPER, STEPPER_PAIR, STEPPER_FLOW, DISCRETE,
    EMBEDDING, CHECK_SYSTEM, STUDY, STUDY_EXACT, EXACT, INVARIANT, VELOCITY, ENSEMBLE, MAKERS
} maker;

static const unsigned char untouched = 0x55;

/* Everything that can be an output. */
typedef struct outputs {
    dal_system *system;
    dal_mechanics *mechanics;
    dal_chart *chart;
    dal_flow *flow;
    dal_stepper *stepper;
    dal_discrete *discrete;
    dal_embedding *embedding;
    dal_check check;
    dal_order_point points[COUNT];
    dal_order order;
    double x[MOST], distance;
} outputs;

static int make_stepper(outputs *out, const char *name, dal_error *error)
{
    dal_scheme scheme;
    CHECK(dal_scheme_find(&scheme, name, NULL) == 0);
    return dal_stepper_new(&out->stepper, generic4, &scheme, NULL, error);
}

static int make_study(outputs *out, const dal_system *system, dal_error *error)
{
    static const size_t steps[COUNT] = {2, 4, 8};
    static const double in_D[6] = {0.1, 0.5, 0.2, 1.0, 0.7, 0.5}; /* of the particle */
    dal_scheme scheme;
    const dal_order_def def = {.t_end = 0.25, .x0 = system == particle ? in_D : state,
                               .steps = steps, .count = COUNT, .tolerance = 1e-6};
    CHECK(dal_scheme_find(&scheme, "midpoint", NULL) == 0);
    return dal_order_study(system, &scheme, &def, out->points, &out->order, error);
}

/* Never called. */
static int no_deformation(double t, const double *q, const double *v, double *g, double *g_v,
                          double *g_q, double *g_t, void *ctx)
{
    return -1;
}

static int make_flow(outputs *out, dal_flow_method method, dal_flow_coordinates coordinates,
                     dal_error *error)
{
    return dal_flow_new(&out->flow, generic4, method, coordinates, 1e-6, error);
}

static int make_embedding(outputs *out, dal_error *error)
{
    dal_scheme scheme;
    const dal_embedding_def def = {.scheme = &scheme, .h = 0.1};
    CHECK(dal_scheme_find(&scheme, "midpoint", NULL) == 0);
    return dal_embedding_new(&out->embedding, generic4, &def, error);
}

/* Never called. */
static int no_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                         double *phi_q, double *phi_t, void *ctx)
{
    return -1;
}

static int make_sparse(outputs *out, dal_error *error)
{
    static const double masses[4] = {1.0, 2.0, 3.0, 4.0};
    static const size_t row[4] = {0, 0, 1, 1}, column[4] = {0, 1, 1, 3};
    const dal_sparsity sparsity = {4, row, column};
    const dal_system_def def = {.n = 4, .m = 2, .masses = masses, .sparsity = &sparsity,
                                .constraint = no_constraint, .missing = DAL_MISSING_PHI_Q};
    return dal_system_new(&out->system, &def, error);
}

static int beyond(double t, const double *x, double *g, void *ctx)
{
    *g = x[0] - 100.0;
    return 0;
}

/* So many sleighs with parameters of their own, an event that does not happen, and all results. */
static int make_ensemble(size_t count, const char *name, dal_error *error)
{
    enum { MEMBERS = 50, STEPS = 10 };
    static double values[MEMBERS][3], states[MEMBERS][6], energy[MEMBERS], residual[MEMBERS];
    static double multipliers[MEMBERS], reactions[MEMBERS];
    static dal_stats stats[MEMBERS];
    const double h = 0.01;
    const size_t steps = STEPS;
    const dal_event event = {.g = beyond};
    dal_scheme scheme;
    for (size_t k = 0; k < MEMBERS; k++)
        for (size_t i = 0; i < 3; i++) values[k][i] = 1.0 + 0.01 * (double)(k + i);
    const dal_members members = {
        .count = MEMBERS, .parameters = values, .parameters_next = sizeof values[0], .h = &h,
        .steps = &steps, .events = &event, .event_count = 1, .states = states[0],
        .energy = energy, .residual = residual, .multipliers = multipliers,
        .reactions = reactions, .stats = stats};
    CHECK(dal_scheme_find(&scheme, name, NULL) == 0);
    return dal_ensemble_run(sleigh, &scheme, NULL, &members, 0, count, NULL, NULL, error);
}

static int make(maker what, outputs *out, dal_error *error)
{
    static const double diagonal[4] = {1.0, 0.0, 0.0, 2.0};
    const dal_system_def plane = {.n = 2, .mass = diagonal};
    const dal_difference_map map = {.beta = 0.5};
    switch (what) {
    case SYSTEM: return generic4_new(&out->system, error);
    case SYSTEM_DIAGONAL: return dal_system_new(&out->system, &plane, error);
    case SYSTEM_SPARSE: return make_sparse(out, error);
    case BUILTIN: return dal_system_builtin(&out->system, "chaotic", NULL, NULL, 0, error);
    case DEFORMED:
        return dal_system_deform(&out->system, generic4, no_deformation, NULL, 0.5, DAL_LINEAR, 0,
                                 error);
    case DEFORMED_NODES:
        return dal_system_deform_nodes(&out->system, generic4, 0.5, error);
    case MECHANICS: return dal_mechanics_new(&out->mechanics, generic4, error);
    case CHART: return dal_chart_new(&out->chart, generic4, error);
    case FLOW_RK8PD: return make_flow(out, DAL_FLOW_RK8PD, DAL_FLOW_X, error);
    case FLOW_MSADAMS: return make_flow(out, DAL_FLOW_MSADAMS, DAL_FLOW_X, error);
    case FLOW_RODAS: return make_flow(out, DAL_FLOW_RODAS, DAL_FLOW_X, error);
    case FLOW_IN_XI: return make_flow(out, DAL_FLOW_RK8PD, DAL_FLOW_XI, error);
    case STEPPER: return make_stepper(out, "leapfrog-suzuki4", error);
    case STEPPER_PAIR: return make_stepper(out, "pair:0.25:0.5", error);
    case STEPPER_FLOW: return make_stepper(out, "reference", error);
    case DISCRETE: return dal_discrete_new(&out->discrete, generic4, &map, NULL, error);
    case EMBEDDING: return make_embedding(out, error);
    case CHECK_SYSTEM: return dal_system_check(generic4, 0.0, state, &out->check, error);
    case STUDY: return make_study(out, generic4, error);
    case STUDY_EXACT: return make_study(out, particle, error); /* each exact state allocates */
    case EXACT: return dal_system_exact(particle, 1.0, state, out->x);
    case INVARIANT: return dal_system_invariant(particle, 0.0, state, out->x);
    case VELOCITY:
        return dal_exact_velocity(reference, 0.0, 0.1, state, state, out->x, NULL);
    case ENSEMBLE: return make_ensemble(2, "midpoint", error);
    case MAKERS: break;
    }
    return DAL_EINVAL;
}

/* These have no error record of their own; EXACT and INVARIANT no message at all. */
static const char *message(maker what, const dal_error *error)
{
    if (what == VELOCITY) return dal_flow_error(reference)->text;
    if (what == EXACT || what == INVARIANT) return dal_strerror(DAL_ENOMEM);
    CHECK(error->status == DAL_ENOMEM);
    return error->text;
}

static void prepare(outputs *out)
{
    memset(out, untouched, sizeof *out);
    memcpy(out->x, state, sizeof out->x);
}

static void release(maker what, outputs *out)
{
    if (what <= DEFORMED_NODES) dal_system_free(out->system);
    if (what == DISCRETE) dal_discrete_free(out->discrete);
    if (what == EMBEDDING) dal_embedding_free(out->embedding);
    if (what == MECHANICS) dal_mechanics_free(out->mechanics);
    if (what == CHART) dal_chart_free(out->chart);
    if (FLOW_RK8PD <= what && what <= FLOW_IN_XI) dal_flow_free(out->flow);
    if (STEPPER <= what && what <= STEPPER_FLOW) dal_stepper_free(out->stepper);
}

/* The k-th allocation fails, for every k, alone or with all that follow it: nothing is made,
 * nothing is leaked, and the text says memory. */
static void test_failing(maker what)
{
    for (int alone = 0; alone <= 1; alone++)
        for (size_t k = 0;; k++) {
            outputs out, before;
            dal_error error = {0};
            prepare(&out);
            before = out;
            const long live = process.live;
            fail_own(k, alone ? k + 1 : SIZE_MAX);
            const int status = make(what, &out, &error);
            const size_t made = own.calls;
            fail_nothing();
            if (!status) {
                CHECK(k > 0 && made == k); /* none was left to fail */
                release(what, &out);
                CHECK(process.live == live);
                break;
            }
            CHECK(status == DAL_ENOMEM);
            CHECK(strstr(message(what, &error), "memory") != NULL);
            CHECK(memcmp(&out, &before, sizeof out) == 0);
            CHECK(process.live == live);
        }
}

/* Every allocation fails once in turn, GSL's own included, whose handler returns: nothing is made,
 * the text says memory, and nothing is leaked but what GSL itself forgets, a block at each of so
 * many places: in msadams_alloc one. */
static void test_failing_gsl(maker what, size_t forgetful)
{
    gsl_error_handler_t *const handler = gsl_set_error_handler_off();
    size_t forgot = 0;
    for (size_t k = 0;; k++) {
        outputs out, before;
        dal_error error = {0};
        prepare(&out);
        before = out;
        const long live = process.live;
        fail_process(k, k + 1);
        const int status = make(what, &out, &error);
        const size_t asked = process.calls;
        fail_nothing();
        if (!status) {
            CHECK(k > 0 && asked == k); /* none was left to fail */
            release(what, &out);
            CHECK(process.live == live);
            break;
        }
        CHECK(status == DAL_ENOMEM);
        CHECK(strstr(message(what, &error), "memory") != NULL);
        CHECK(memcmp(&out, &before, sizeof out) == 0);
        CHECK(process.live == live || process.live == live + 1);
        forgot += process.live != live;
    }
    CHECK(forgot <= forgetful);
    gsl_set_error_handler(handler);
}

/* What GSL forgets is no leak of ours. */
const char *__lsan_default_suppressions(void);
const char *__lsan_default_suppressions(void) { return "leak:libgsl"; }

/* A size that malloc refuses: the number of bytes is in the text. */
static void test_message(void)
{
    outputs out;
    dal_error error;
    prepare(&out);
    fail_own(0, 1);
    CHECK(make(MECHANICS, &out, &error) == DAL_ENOMEM);
    fail_nothing();
    const char *text = error.text;
    while (*text && !isdigit((unsigned char)*text)) text++;
    CHECK(strtoul(text, NULL, 10) >= 4 * 4 * sizeof(double)); /* its Hessian alone */
}

/* ---- steps that do not allocate ----------------------------------------------------------- */

enum { STEPS = 10000, STRIDE = 10, ROWS = STEPS / STRIDE + 1 };

static double rows[ROWS * MOST], reactions[ROWS * 2], energy[ROWS], multipliers[ROWS * 2],
    residual[ROWS * 2], relative[ROWS];

static int observing(size_t step, double t, const double *x, void *ctx)
{
    (void)step, (void)t, (void)x, (void)ctx;
    return 0;
}

/* Steps, runs and failures of one scheme. */
static void test_steps(const dal_system *system, const dal_scheme *scheme, way by, size_t steps)
{
    double x[16];
    dal_stepper *stepper = NULL;
    dal_stats stats;
    const bool kept = scheme->nodes == DAL_KEPT_NODES;
    const dal_initial initial = kept ? DAL_INITIAL_PROJECT : DAL_INITIAL_NONE;
    CHECK(dal_system_state(system, x) == 0);
    CHECK(new_stepper_by(by, &stepper, system, scheme, NULL) == 0);
    const size_t calls = process.calls;
    CHECK(dal_stepper_start(stepper, 0.0, 1e-3, x, DAL_CHECK, initial) == 0);
    for (size_t k = 0; k < steps / 2; k++) CHECK(dal_step(stepper, reactions) == 0);
    CHECK(dal_advance(stepper, steps / 2, reactions, NULL) == 0);
    dal_stepper_stats(stepper, &stats);
    CHECK(stats.steps == steps);
    CHECK(dal_stepper_start(stepper, 0.0, -1e-3, x, DAL_PROJECT, initial) == 0);
    CHECK(dal_integrate(stepper, steps, STRIDE, rows, reactions, observing, NULL, NULL) == 0);
    CHECK(dal_stepper_start(stepper, 0.0, NAN, x, DAL_CHECK, initial) == DAL_EINVAL);
    /* too far for most: to say why takes none either */
    if (dal_stepper_start(stepper, 0.0, 1e200, x, DAL_CHECK, initial) == 0)
        dal_advance(stepper, 20, NULL, NULL);
    CHECK(process.calls == calls);
    dal_stepper_free(stepper);
}

static void test_trajectory(void)
{
    double x[MOST], distance;
    size_t done;
    for (size_t k = 0; k < ROWS; k++) memcpy(rows + k * MOST, state, sizeof state);
    memcpy(x, state, sizeof x);
    const size_t calls = process.calls;
    CHECK(dal_trajectory(mechanics, 0.0, 0.1, 0.1, ROWS, rows, NULL, energy, multipliers, residual,
                         relative, &done) == 0);
    CHECK(done == ROWS);
    CHECK(dal_project(mechanics, 0.0, 0.1, x, &distance) == 0);
    CHECK(process.calls == calls);
}

/* Steps on nodes and on states. */
static void test_discrete(void)
{
    const dal_difference_map map = {.beta = 0.5};
    double x[MOST], nodes[12 * MOST / 2], lambda[2];
    dal_discrete *discrete = NULL;
    memcpy(x, state, sizeof x);
    CHECK(dal_discrete_new(&discrete, generic4, &map, NULL, NULL) == 0);
    const size_t calls = process.calls;
    CHECK(dal_discrete_nodes(discrete, 0.0, 0.01, x, nodes, nodes + MOST / 2) == 0);
    CHECK(dal_discrete_run(discrete, 0.0, 0.01, 10, nodes, NULL, NULL) == 0);
    CHECK(dal_discrete_advance(discrete, 0.0, 0.01, x, lambda) == 0);
    CHECK(dal_discrete_advance(discrete, 0.0, NAN, x, lambda) == DAL_EINVAL);
    CHECK(process.calls == calls);
    dal_discrete_free(discrete);
}

static void test_chart(void)
{
    enum { STATES = 7 };
    double xi[MOST], x[MOST], out[STATES * MOST], t[STATES], J[MOST * MOST];
    dal_chart *chart = NULL;
    for (size_t k = 0; k < ROWS; k++) memcpy(rows + k * MOST, state, sizeof state);
    for (size_t k = 0; k < STATES; k++) t[k] = 0.03 * (double)k;
    CHECK(dal_chart_new(&chart, generic4, NULL) == 0);
    const size_t calls = process.calls;
    CHECK(dal_chart_renew(chart, 0.0, state, NULL) == 0 && dal_chart_drop(chart, state, xi) == 0);
    CHECK(dal_chart_step(chart, 0.0, 0.5, 0.1, xi, NULL) == 0);
    CHECK(dal_chart_lift(chart, 0.0, xi, x) == 0
          && dal_chart_jacobian(chart, 0.0, xi, J, NULL) == 0);
    CHECK(dal_chart_interpolate(chart, 0.0, 0.1, 0.0, ROWS, rows, STATES, t, out, NULL, NULL) == 0);
    CHECK(process.calls == calls);
    dal_chart_free(chart);
}

static void test_embedding(void)
{
    outputs out;
    double G[MOST], g[MOST];
    CHECK(make_embedding(&out, NULL) == 0);
    CHECK(dal_chart_choose(dal_embedding_chart(out.embedding), 0.0, NULL, state) == 0);
    CHECK(dal_chart_drop(dal_embedding_chart(out.embedding), state, G) == 0);
    const size_t calls = process.calls;
    CHECK(dal_embedding_curve(out.embedding, 2.5, G, g) == 0);
    CHECK(dal_embedding_field(out.embedding, 0.5, G, g) == 0);
    CHECK(dal_embedding_flow(out.embedding, 0.0, 0.01, G) == 0);
    CHECK(process.calls == calls);
    dal_embedding_free(out.embedding);
}

static void test_flow(dal_flow_method method)
{
    double x[MOST], accuracy;
    size_t done;
    dal_flow *flow = NULL;
    memcpy(x, state, sizeof x);
    CHECK(dal_flow_new(&flow, generic4, method, DAL_FLOW_X, 1e-6, NULL) == 0);
    const size_t calls = process.calls;
    CHECK(dal_flow_apply(flow, 0.0, 1.0, x, &accuracy) == 0);
    memcpy(rows, x, sizeof x);
    CHECK(dal_flow_trajectory(flow, 1.0, -0.01, 100, rows, &done) == 0 && done == 100);
    CHECK(dal_flow_apply(flow, 0.0, NAN, x, NULL) == DAL_EINVAL);
    CHECK(process.calls == calls);
    dal_flow_free(flow);
}

/* Memory is asked for once, however many members there are. */
static void test_ensemble(const char *scheme)
{
    size_t calls[2];
    for (size_t i = 0; i < 2; i++) {
        const size_t before = process.calls;
        CHECK(make_ensemble(i == 0 ? 1 : 50, scheme, NULL) == 0);
        calls[i] = process.calls - before;
    }
    CHECK(calls[0] > 0 && calls[0] == calls[1]);
}

int main(void)
{
    test_counters();
    CHECK(dal_system_builtin(&sleigh, "sleigh", NULL, NULL, 0, NULL) == 0);
    CHECK(dal_system_builtin(&particle, "particle", NULL, NULL, 0, NULL) == 0);
    CHECK(generic4_new(&generic4, NULL) == 0);
    CHECK(dal_mechanics_new(&mechanics, generic4, NULL) == 0);
    CHECK(dal_flow_new(&reference, generic4, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-6, NULL) == 0);
    generic4_state(state);

    for (maker what = SYSTEM; what < MAKERS; what++) test_failing(what);
    test_message();
    for (maker what = SYSTEM; what < MAKERS; what++)
        test_failing_gsl(what, what == FLOW_MSADAMS);

    for (size_t i = 0; i + 1 < dal_scheme_count(); i += brief() ? 5 : 1) { /* not taylor */
        dal_scheme scheme;
        CHECK(dal_scheme_at(&scheme, i) == 0);
        const size_t steps = scheme.family ? STEPS / 10 : STEPS;
        test_steps(generic4, &scheme, BY_LIBRARY, steps);
        test_steps(particle, &scheme, BY_LIBRARY, STEPS / 10);
        if (scheme.family) continue;
        test_steps(generic4, &scheme, BY_ANY_SIZES, STEPS / 10);
        test_steps(generic4, &scheme, BY_MULTIROOT, STEPS / 100);
    }
    static const char *const pairs[] = {"pair:0.25:0.5", "pair:0:1"};
    for (size_t i = 0; i < DAL_LENGTH(pairs); i++) {
        dal_scheme scheme;
        CHECK(dal_scheme_find(&scheme, pairs[i], NULL) == 0);
        test_steps(generic4, &scheme, BY_LIBRARY, STEPS / 10);
    }
    /* Lagrangians of any form, affine and nonlinear constraints. */
    static const char *const others[] = {"sleigh_contact", "ball_on_table"};
    for (size_t k = 0; k < 2; k++) {
        dal_system *general = NULL;
        CHECK(dal_system_builtin(&general, others[k], NULL, NULL, 0, NULL) == 0);
        for (size_t i = 0; i + 1 < dal_scheme_count(); i++) {
            dal_scheme scheme;
            CHECK(dal_scheme_at(&scheme, i) == 0);
            test_steps(general, &scheme, BY_LIBRARY, STEPS / 100);
        }
        dal_system_free(general);
    }
    test_trajectory();
    test_discrete();
    test_chart();
    test_embedding();
    test_ensemble("midpoint");
    test_ensemble("leapfrog-kl6");
    test_ensemble("pair:0.25:0.5");
    test_ensemble("reference");
    for (dal_flow_method method = DAL_FLOW_RK8PD; method <= DAL_FLOW_RODAS; method++)
        test_flow(method);

    dal_system_free(sleigh);
    dal_flow_free(reference);
    dal_mechanics_free(mechanics);
    dal_system_free(generic4);
    dal_system_free(particle);
    return check_done();
}
