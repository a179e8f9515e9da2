/* The step routine compiled for one system, with its callbacks inside, as a program does that
 * brings its own kernel: the same bits as the library's, and what is refused. */
#include "fixtures.h"
#include "check.h"

#include "dalembert/kernel.h"
#include "step/beta.h"
#include "step/stepper.h"

/* What the callbacks of uneven_edge read; its kernel gets it as ctx. */
typedef struct blade {
    double slope, wobble, turn; /* the plane turns at this rate, and what wobbles with it */
    int refuses;                /* what the constraint returns where x > 0.1 */
} blade;

DAL_KERNEL_INLINE int blade_potential(double t, const double *q, double *V, double *V_q,
                                      double *V_qq, const blade *b)
{
    const double heading = q[2] + b->turn * t;
    if (V) *V = -b->slope * q[0] + b->wobble * sin(heading);
    if (V_q) {
        V_q[0] = -b->slope;
        V_q[1] = 0.0;
        V_q[2] = b->wobble * cos(heading);
    }
    if (V_qq) {
        memset(V_qq, 0, 9 * sizeof *V_qq);
        V_qq[8] = -b->wobble * sin(heading);
    }
    return 0;
}

DAL_KERNEL_INLINE int blade_constraint(double t, const double *q, const double *v, double *phi,
                                       double *phi_v, double *phi_q, double *phi_t, const blade *b)
{
    const double s = sin(q[2] + b->turn * t), c = cos(q[2] + b->turn * t);
    if (phi) phi[0] = s * v[0] - c * v[1];
    if (phi_v) {
        phi_v[0] = s;
        phi_v[1] = -c;
        phi_v[2] = 0.0;
    }
    if (phi_q) {
        phi_q[0] = phi_q[1] = 0.0;
        phi_q[2] = c * v[0] + s * v[1];
    }
    if (phi_t) *phi_t = b->turn * (c * v[0] + s * v[1]);
    return q[0] > 0.1 ? b->refuses : 0;
}

static int potential(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    return blade_potential(t, q, V, V_q, V_qq, ctx);
}

static int constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    return blade_constraint(t, q, v, phi, phi_v, phi_q, phi_t, ctx);
}

static int inside_potential(dal_kernel *k, double t, const double *q, double *V_q)
{
    k->stats.potential_calls++;
    return blade_potential(t, q, NULL, V_q, NULL, k->potential_ctx);
}

static int inside_constraint(dal_kernel *k, double t, const double *q, const double *v, double *mu,
                            double *N)
{
    k->stats.constraint_calls++;
    return blade_constraint(t, q, v, NULL, mu, N, NULL, k->constraint_ctx);
}

/* mu = (s, -c, 0) for M = diag, so Z too; V_q has its first and last entry, and N only the last. */
#define DAL_N 3
#define DAL_M 1
#define DAL_KERNEL blade_step
#define DAL_KERNEL_CONSTRAINT(k, t, q, v, mu, N) inside_constraint(k, t, q, v, mu, N)
#define DAL_KERNEL_POTENTIAL(k, t, q, V_q) inside_potential(k, t, q, V_q)
#define DAL_KERNEL_PATTERN {0x111ULL, 0x3ULL, 0x3ULL, 0x4ULL, 0x7ULL, 0x5ULL, 0x0ULL, 0, 0, 0, 0}
#define DAL_KERNEL_STEADY 1
#include "dalembert/kernel.h"

/* The same, with nothing said about what is 0. */
#define DAL_N 3
#define DAL_M 1
#define DAL_KERNEL blade_step_in_full
#define DAL_KERNEL_CONSTRAINT(k, t, q, v, mu, N) inside_constraint(k, t, q, v, mu, N)
#define DAL_KERNEL_POTENTIAL(k, t, q, V_q) inside_potential(k, t, q, V_q)
#include "dalembert/kernel.h"

/* Without V. */
#define DAL_N 3
#define DAL_M 1
#define DAL_KERNEL free_blade_step
#define DAL_KERNEL_CONSTRAINT(k, t, q, v, mu, N) inside_constraint(k, t, q, v, mu, N)
#define DAL_KERNEL_PATTERN {0x111ULL, 0x3ULL, 0x3ULL, 0x4ULL, 0x3ULL, 0x0ULL, 0x0ULL, 0, 0, 0, 0}
#define DAL_KERNEL_STEADY 1
#include "dalembert/kernel.h"

/* Of stages with V at nodes only, the general text. */
static int blade_step_in_general(dal_kernel *k, size_t steps, size_t *done)
{
    k->plain = false;
    return blade_step(k, steps, done);
}

static int step_in_general(dal_kernel *k, size_t steps, size_t *done)
{
    k->plain = false;
    return dal__kernel_for(k->n, k->m, false)(k, steps, done);
}

static const dal_compiled compiled = {DAL_COMPILED_ABI, sizeof(dal_kernel), blade_step, 0, 0,
                                      NULL, NULL};
static const dal_compiled compiled_in_general = {DAL_COMPILED_ABI, sizeof(dal_kernel),
                                                 blade_step_in_general, 0, 0, NULL, NULL};
static const dal_compiled compiled_in_full = {DAL_COMPILED_ABI, sizeof(dal_kernel),
                                              blade_step_in_full, 0, 0, NULL, NULL};
static const dal_compiled compiled_free = {DAL_COMPILED_ABI, sizeof(dal_kernel), free_blade_step, 0,
                                           0, NULL, NULL};

static const double mass[9] = {2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.75};
static const double state[6] = {0.0, 0.0, 0.2, 0.49003328892062081, 0.099334665397530605, 1.2};

/* With values that only the copy made by dal_system_new still has. */
static dal_system_def blade_def(blade *b)
{
    return (dal_system_def){.n = 3, .m = 1, .mass = mass, .potential = potential,
                            .constraint = constraint, .state = state, .ctx = b,
                            .ctx_size = sizeof *b, .compiled = &compiled,
                            .steady = DAL_STEADY_PROVED};
}

typedef enum variety { STEADY, IN_FULL, FREE, TURNING, IN_GENERAL } variety;

static dal_system *open_blade_as(variety kind, int refuses)
{
    blade b = {.slope = 5.0, .wobble = 0.1, .refuses = refuses};
    dal_system_def def = blade_def(&b);
    if (kind == IN_FULL || kind == TURNING) {
        b.turn = def.time_dependent = kind == TURNING;
        def.compiled = &compiled_in_full;
        def.steady = 0;
    } else if (kind == IN_GENERAL) {
        def.compiled = &compiled_in_general;
    } else if (kind == FREE) {
        def.compiled = &compiled_free;
        def.potential = NULL;
    }
    dal_system *const system = new_system(&def);
    b = (blade){.slope = NAN, .wobble = NAN};
    return system;
}

static dal_system *open_blade(int refuses) { return open_blade_as(STEADY, refuses); }

/* One text, two compilations: every record gives the same bits and the same counts, in one call or
 * in several. */
static void test_same_bits(variety kind)
{
    enum { STEPS = 1000, CALLS = 10 };
    const char *const names[] = {"explicit", "midpoint", "endpoint", "0.3", "leapfrog",
                                 "midpoint-nodes", "midpoint-suzuki4", "leapfrog-kl8"};
    dal_system *const system = open_blade_as(kind, 0);
    for (size_t j = 0; j < sizeof names / sizeof *names; j++) {
        const dal_scheme scheme = find_scheme(names[j]);
        const dal_initial initial =
            scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE;
        dal_stepper *const own = open_stepper(system, &scheme, NULL);
        dal_stepper *const library = open_stepper_by(BY_ANY_SIZES, system, &scheme);
        double one, two;
        dal_stats a, b;
        CHECK(dal_stepper_start(own, 0.0, 0.02, state, DAL_CHECK, initial) == 0);
        CHECK(dal_stepper_start(library, 0.0, 0.02, state, DAL_CHECK, initial) == 0);
        for (int call = 0; call < CALLS; call++)
            CHECK(dal_advance(own, STEPS / CALLS, &one, NULL) == 0);
        CHECK(dal_advance(library, STEPS - STEPS / CALLS, NULL, NULL) == 0);
        CHECK(dal_advance(library, STEPS / CALLS, &two, NULL) == 0);
        CHECK(memcmp(dal_stepper_state(own), dal_stepper_state(library), 6 * sizeof one) == 0);
        CHECK(one == two);
        CHECK(largest_difference(6, dal_stepper_state(own), state) > 0.1);
        dal_stepper_stats(own, &a);
        dal_stepper_stats(library, &b);
        CHECK(a.constraint_calls == b.constraint_calls && a.constraint_calls > STEPS);
        CHECK(a.potential_calls == b.potential_calls);
        CHECK(kind == FREE ? a.potential_calls == 0 : a.potential_calls >= STEPS);
        CHECK(a.iterations == b.iterations && a.worst_residual == b.worst_residual);
        release(library);
    }
}

/* Every built-in system has the same bits by the text for V at nodes only, or nowhere, and by the
 * general one. */
static void test_nodes_only(void)
{
    static const dal_compiled general = {DAL_COMPILED_ABI, sizeof(dal_kernel), step_in_general, 0,
                                         0, NULL, NULL};
    const char *const names[] = {"leapfrog", "leapfrog-suzuki4", "leapfrog-kl6", "leapfrog-kl8",
                                 "leapfrog-mirror", "explicit"};
    size_t compared = 0;
    for (size_t which = 0; which < dal_builtin_count(); which++) {
        dal_system *system = NULL, *other = NULL;
        system = open_system(dal_builtin_name(which));
        dal_system_def def = system->def;
        const size_t n = def.n;
        def.compiled = &general;
        if (!def.mass || def.kind != DAL_LINEAR || def.force || n > 8) {
            release(system);
            continue;
        }
        other = new_system(&def);
        for (size_t j = 0; j < sizeof names / sizeof *names; j++) {
            const dal_scheme scheme = find_scheme(names[j]);
            dal_stepper *const two = open_stepper(other, &scheme, NULL);
            double x[8], y[8]; /* reactions */
            dal_stats a, b;
            dal_stepper *const one = start_stepper(system, &scheme, 0.05, def.state);
            CHECK(dal_stepper_start(two, 0.0, 0.05, def.state, DAL_CHECK, DAL_INITIAL_NONE) == 0);
            CHECK(dal_advance(one, 300, x, NULL) == 0 && dal_advance(two, 300, y, NULL) == 0);
            CHECK(memcmp(dal_stepper_state(one), dal_stepper_state(two), 2 * n * sizeof(double))
                  == 0);
            CHECK(memcmp(x, y, def.m * sizeof *x) == 0);
            dal_stepper_stats(one, &a);
            dal_stepper_stats(two, &b);
            CHECK(a.constraint_calls == b.constraint_calls && a.iterations == b.iterations);
            CHECK(a.potential_calls == b.potential_calls);
            CHECK(a.worst_residual == b.worst_residual);
            release(two);
            compared++;
        }
        release(system);
    }
    CHECK(compared >= 50);
}

/* The same where the full Newton iteration takes over, which sees only what it is handed, and where
 * it fails too. */
static void test_handed_over(void)
{
    enum { STEPS = 200 };
    const char *const names[] = {"midpoint", "0.3", "midpoint-suzuki4"};
    dal_system *const system = open_blade_as(IN_FULL, 0);
    size_t full = 0;
    for (size_t j = 0; j < sizeof names / sizeof *names; j++) {
        const dal_scheme scheme = find_scheme(names[j]);
        dal_stepper *const library = open_stepper_by(BY_ANY_SIZES, system, &scheme);
        dal_stats a, b;
        dal_stepper *const own = start_stepper(system, &scheme, 3.0, state);
        CHECK(dal_stepper_start(library, 0.0, 3.0, state, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        int status = 0;
        for (int step = 0; step < STEPS && !status; step++) {
            status = dal_step(own, NULL);
            CHECK(dal_step(library, NULL) == status);
            CHECK(memcmp(dal_stepper_state(own), dal_stepper_state(library), sizeof state) == 0);
        }
        CHECK(strcmp(dal_stepper_error(own)->text, dal_stepper_error(library)->text) == 0);
        dal_stepper_stats(own, &a);
        dal_stepper_stats(library, &b);
        CHECK(a.full_newtons == b.full_newtons);
        full += a.full_newtons;
        release(library);
    }
    CHECK(full > STEPS);
}

/* A blade whose potential refuses after so many calls; never if that is negative. */
typedef struct hesitant {
    blade shape;
    int calls;
} hesitant;

static int hesitant_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                              void *ctx)
{
    hesitant *const self = ctx;
    if (self->calls == 0) return 1;
    if (self->calls > 0) self->calls--;
    return potential(t, q, V, V_q, V_qq, &self->shape);
}

static int hesitant_constraint(double t, const double *q, const double *v, double *phi,
                               double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    return constraint(t, q, v, phi, phi_v, phi_q, phi_t, &((hesitant *)ctx)->shape);
}

/* A step of several stages that fails in any of them, and is then made again, is that of a stepper
 * started where it failed: nothing of the failed one is left. */
static void test_made_again(void)
{
    hesitant self = {.shape = {.slope = 5.0, .wobble = 0.1}};
    dal_system_def def = blade_def(&self.shape);
    def.compiled = NULL;
    def.steady = 0;
    def.constraint = hesitant_constraint;
    def.potential = hesitant_potential;
    def.ctx = &self;
    def.ctx_size = 0;
    dal_system *const system = new_system(&def);
    const dal_scheme scheme = find_scheme("midpoint-suzuki4");
    dal_stepper *const one = open_stepper(system, &scheme, NULL);
    dal_stepper *const two = open_stepper(system, &scheme, NULL);
    int failed = 0;
    for (int calls = 0; calls < 40; calls++) {
        self.calls = -1;
        CHECK(dal_stepper_start(one, 0.0, 0.1, state, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(one, 3, NULL, NULL) == 0);
        double before[6];
        memcpy(before, dal_stepper_state(one), sizeof before);
        self.calls = calls;
        const int status = dal_step(one, NULL);
        if (!status) break; /* it takes no more */
        self.calls = -1;
        failed++;
        CHECK(status == DAL_EDOMAIN);
        CHECK(memcmp(dal_stepper_state(one), before, sizeof before) == 0);
        CHECK(dal_stepper_start(two, 0.0, 0.1, before, DAL_ASSUME, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(one, 5, NULL, NULL) == 0 && dal_advance(two, 5, NULL, NULL) == 0);
        CHECK(memcmp(dal_stepper_state(one), dal_stepper_state(two), sizeof before) == 0);
    }
    CHECK(failed >= 10); /* two for each of five stages */
}

/* What overflows is seen also where it is in nothing that is computed with: mu = (1, 1/2, 0). */
static int level_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                            double *phi_q, double *phi_t, void *ctx)
{
    if (phi) *phi = v[0] + 0.5 * v[1];
    if (phi_v) {
        phi_v[0] = 1.0;
        phi_v[1] = 0.5;
        phi_v[2] = 0.0;
    }
    if (phi_q) memset(phi_q, 0, 3 * sizeof *phi_q);
    return 0;
}

static int inside_level(dal_kernel *k, double t, const double *q, const double *v, double *mu,
                        double *N)
{
    k->stats.constraint_calls++;
    return level_constraint(t, q, v, NULL, mu, N, NULL, k->constraint_ctx);
}

#define DAL_N 3
#define DAL_M 1
#define DAL_KERNEL level_step
#define DAL_KERNEL_CONSTRAINT(k, t, q, v, mu, N) inside_level(k, t, q, v, mu, N)
#define DAL_KERNEL_PATTERN {0x111ULL, 0x3ULL, 0x3ULL, 0x0ULL, 0x3ULL, 0x0ULL, 0x0ULL, 0, 0, 0, 0}
#include "dalembert/kernel.h"

static void test_overflow(void)
{
    static const dal_compiled level = {DAL_COMPILED_ABI, sizeof(dal_kernel), level_step, 0, 0,
                                       NULL, NULL};
    const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = level_constraint,
                                .compiled = &level};
    const double x[6] = {0.0, 0.0, 0.0, 1.0, -2.0, 1e307};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = open_named(system, "midpoint");
    CHECK(dal_stepper_start(stepper, 0.0, 8.0, x, DAL_ASSUME, DAL_INITIAL_NONE) == 0);
    size_t done = 0;
    CHECK(dal_advance(stepper, 5, NULL, &done) == DAL_EDOMAIN && done == 2);
    CHECK(strstr(dal_stepper_error(stepper)->text, "new state overflows") != NULL);
    CHECK(dal_stepper_state(stepper)[2] == 16e307);
}

/* A declaration changes how a step is solved, not its solution; and it saves iterations. */
static void test_steady(void)
{
    enum { STEPS = 200 };
    const char *const names[] = {"explicit", "endpoint", "leapfrog", "leapfrog-kl6", "midpoint"};
    dal_system *const declared = open_blade_as(STEADY, 0);
    dal_system *const undeclared = open_blade_as(IN_FULL, 0);
    for (size_t j = 0; j < sizeof names / sizeof *names; j++) {
        const dal_scheme scheme = find_scheme(names[j]);
        dal_stepper *const two = open_stepper(undeclared, &scheme, NULL);
        dal_stats a, b;
        dal_stepper *const one = start_stepper(declared, &scheme, 0.02, state);
        CHECK(dal_stepper_start(two, 0.0, 0.02, state, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(one, STEPS, NULL, NULL) == 0 && dal_advance(two, STEPS, NULL, NULL) == 0);
        /* each sub-step errs by a few roundings of |x| < 100, and errors grow with time at most */
        CHECK_NEAR(largest_difference(6, dal_stepper_state(one), dal_stepper_state(two)), 0.0,
                   100 * U * 9 * STEPS);
        dal_stepper_stats(one, &a);
        dal_stepper_stats(two, &b);
        const bool ends = strcmp(names[j], "midpoint") == 0; /* V acts at q~' */
        CHECK(ends ? a.iterations == b.iterations : a.iterations == a.substeps);
        CHECK(a.worst_residual <= DAL_RESIDUAL_BOUND(3));
        release(two);
    }
}

/* The same constraint with the centre of mass beside the blade: a reaction turns it. */
static int beside(double t, const double *q, const double *v, double *phi, double *phi_v,
                  double *phi_q, double *phi_t, void *ctx)
{
    const int returned = constraint(t, q, v, phi, phi_v, phi_q, NULL, ctx);
    if (phi) phi[0] += 0.5 * v[2];
    if (phi_v) phi_v[2] = 0.5;
    return returned;
}

/* v_x + x v_y = 0 and v_z = 0: only the first reaction pushes x, on which only the first form
 * depends. */
static int two_forms(double t, const double *q, const double *v, double *phi, double *phi_v,
                     double *phi_q, double *phi_t, void *ctx)
{
    if (phi) phi[0] = v[0] + q[0] * v[1], phi[1] = v[2];
    if (phi_v) {
        memset(phi_v, 0, 6 * sizeof *phi_v);
        phi_v[0] = phi_v[5] = 1.0;
        phi_v[1] = q[0];
    }
    if (phi_q) {
        memset(phi_q, 0, 6 * sizeof *phi_q);
        phi_q[0] = v[1];
    }
    return 0;
}

static void test_false_declaration_of_two(void)
{
    const double mass[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    const double x[6] = {0.5, 0.0, 0.0, -0.5, 1.0, 0.0};
    const dal_system_def def = {.n = 3, .m = 2, .mass = mass, .constraint = two_forms,
                                .steady = DAL_STEADY_DECLARED};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = open_named(system, "midpoint");
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(stepper)->text, "mu depends on coordinate 0") != NULL);
}

/* A declaration that is false is refused where it can be seen; where it cannot, at rest, the first
 * step that moves finds out, and every step before it lies in D. */
static void test_false_declaration(void)
{
    blade b = {.slope = 5.0};
    dal_system_def def = blade_def(&b);
    def.compiled = NULL;
    def.constraint = beside;
    def.steady = DAL_STEADY_DECLARED;
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = open_named(system, "leapfrog");
    double x[6] = {0.0, 0.0, 0.3, 1.0, 0.0, 0.0};
    CHECK(dal_stepper_start(stepper, 0.0, 0.01, x, DAL_PROJECT, DAL_INITIAL_NONE) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(stepper)->text, "mu depends on coordinate 2") != NULL);
    x[3] = 0.0;
    CHECK(dal_stepper_start(stepper, 0.0, 0.01, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    int status = DAL_SUCCESS;
    for (int step = 0; step < 300 && !status; step++) {
        status = dal_step(stepper, NULL);
        CHECK(residual_of(system, 0.0, dal_stepper_state(stepper)) <= DAL_RESIDUAL_BOUND(3));
    }
    CHECK(status == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(stepper)->text, "a reaction changed mu") != NULL);
}

/* The library's step routine is not the one that is used: this one counts its calls.  Of kept nodes
 * it knows nothing. */
static int count_steps(dal_kernel *k, size_t steps, size_t *done)
{
    k->stats.halvings++;
    return blade_step(k, steps, done);
}

static void test_it_is_used(void)
{
    static const dal_compiled counting = {DAL_COMPILED_ABI, sizeof(dal_kernel), count_steps, 0, 0,
                                          NULL, NULL};
    blade b = {.slope = 5.0, .wobble = 0.1};
    dal_system_def def = blade_def(&b);
    def.compiled = &counting;
    dal_system *const system = new_system(&def);
    const dal_scheme scheme = find_scheme("midpoint");
    for (way by = 0; by < WAYS; by++) {
        dal_stepper *const stepper = open_stepper_by(by, system, &scheme);
        CHECK(dal_stepper_start(stepper, 0.0, 0.02, state, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(stepper, 5, NULL, NULL) == 0);
        const dal_stats stats = stats_of(stepper);
        CHECK(stats.steps == 5 && stats.halvings == (by == BY_LIBRARY));
        release(stepper);
    }
}

/* What a callback returns comes out as from the library, and the state is that before the step. */
static void test_refusals_of_callbacks(void)
{
    const int returned[] = {-1, 1}, status[] = {DAL_EUSER, DAL_EDOMAIN};
    for (size_t j = 0; j < 2; j++) {
        dal_system *const system = open_blade(returned[j]);
        const dal_scheme scheme = find_scheme("midpoint");
        dal_stepper *const library = open_stepper_by(BY_ANY_SIZES, system, &scheme);
        size_t one = 0, two = 0;
        dal_stepper *const own = start_stepper(system, &scheme, 0.02, state);
        CHECK(dal_stepper_start(library, 0.0, 0.02, state, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(own, 1000, NULL, &one) == status[j]);
        CHECK(dal_advance(library, 1000, NULL, &two) == status[j]);
        CHECK(one == two && one > 3 && one < 1000);
        CHECK(strcmp(dal_stepper_error(own)->text, dal_stepper_error(library)->text) == 0);
        CHECK(memcmp(dal_stepper_state(own), dal_stepper_state(library), 6 * sizeof(double)) == 0);
        release(system);
    }
}

/* What is wrong is said by the stepper, in words. */
static void refused(const dal_system_def *def, const char *words)
{
    const dal_scheme scheme = find_scheme("midpoint");
    dal_stepper *stepper = NULL;
    dal_error error;
    dal_system *const system = new_system(def);
    CHECK(dal_stepper_new(&stepper, system, &scheme, NULL, &error) == DAL_EINVAL && !stepper);
    CHECK(error.status == DAL_EINVAL && strstr(error.text, words) != NULL);
}

/* The same by the system, which has no kernel to say it of. */
static void refused_at_once(const dal_system_def *def, const char *words)
{
    dal_system *system = NULL;
    dal_error error;
    CHECK(dal_system_new(&system, def, &error) == DAL_EINVAL && !system);
    CHECK(error.status == DAL_EINVAL && strstr(error.text, words) != NULL);
}

/* No field of the blade. */
static int stand(double t, const double *x, const double *u, const double *mass_inverse,
                 double *xdot, void *ctx)
{
    (void)t, (void)x, (void)u, (void)mass_inverse, (void)ctx;
    memset(xdot, 0, 6 * sizeof *xdot);
    return 1;
}

/* A field is that of the compilation, unless it is of another library. */
static void test_compiled_field(void)
{
    blade b = {.slope = 5.0, .wobble = 0.1};
    for (unsigned older = 0; older < 2; older++) {
        const dal_compiled other = {DAL_COMPILED_ABI - older, sizeof(dal_kernel), blade_step, 0, 0,
                                    NULL, stand};
        dal_system_def def = blade_def(&b);
        double xdot[6];
        def.compiled = &other;
        dal_system *const system = new_system(&def);
        dal_mechanics *const mech = open_mechanics(system);
        CHECK(dal_field(mech, 0.0, state, xdot) == 0);
        CHECK(xdot[0] == (older ? state[3] : 0.0));
        release(system);
    }
}

static void test_bad_definitions(void)
{
    blade b = {.slope = 5.0, .wobble = 0.1};
    const dal_compiled larger = {DAL_COMPILED_ABI, sizeof(dal_kernel) + 8, blade_step, 0, 0,
                                 NULL, NULL};
    const dal_compiled older = {DAL_COMPILED_ABI - 1, sizeof(dal_kernel), blade_step, 0, 0,
                                NULL, NULL};
    const dal_system_def good = blade_def(&b);
    dal_system_def def = good;
    def.compiled = &larger;
    refused(&def, "compile it with the kernel.h of this library");
    def.compiled = &older;
    refused(&def, "number 14");
    def = good;
    def.steady = 0;
    def.force = no_force;
    refused(&def, "a different system");
    def.force = NULL;
    def.kind = DAL_AFFINE;
    refused(&def, "a different system");
    def.kind = DAL_LINEAR;
    def.missing = DAL_MISSING_PHI_Q;
    refused(&def, "missing");
    def.missing = 0;
    def.mass = NULL;
    def.potential = NULL;
    def.lagrangian = never_lagrangian;
    refused(&def, "a different system");
    def = good;
    def.ctx = NULL;
    refused_at_once(&def, "ctx is NULL");
    def = good;
    def.compiled = NULL;
    def.kind = DAL_AFFINE;
    refused_at_once(&def, "steady = 2: expected 0, because the constraints are not linear");
    def = good;
    def.steady = DAL_STEADY_CONSTANT_RATE + 1;
    refused_at_once(&def, "steady = 4: expected a dal_steady");
    def.steady = -1;
    refused_at_once(&def, "steady = -1: expected a dal_steady");
}

/* A deformation is another system: it has neither the kernel nor the size of the ctx of its
 * base. */
static void test_deformed(void)
{
    dal_system *const base = open_blade(0);
    dal_system *const shifted = open_deformed_nodes(base, 0.01);
    dal_mechanics *const mech = open_mechanics(shifted), *const plain = open_mechanics(base);
    double residual, expected, x[6];
    memcpy(x, state, sizeof x);
    x[4] += 0.3;
    CHECK(dal_residual(mech, 0.0, 0.0, x, &residual) == 0);
    CHECK(dal_residual(plain, 0.0, 0.01, x, &expected) == 0);
    CHECK_NEAR(residual, expected, 8 * U);
}

int main(void)
{
    test_same_bits(STEADY);
    test_same_bits(IN_FULL);
    test_same_bits(FREE);
    test_same_bits(TURNING);
    test_same_bits(IN_GENERAL);
    test_nodes_only();
    test_handed_over();
    test_made_again();
    test_overflow();
    test_steady();
    test_false_declaration();
    test_false_declaration_of_two();
    test_it_is_used();
    test_refusals_of_callbacks();
    test_compiled_field();
    test_bad_definitions();
    test_deformed();
    return check_done();
}
