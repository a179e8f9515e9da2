/* Many steps into the caller's arrays: rows, strides, mean reactions, observers, going on, and what
 * is there after a failure. */
#include "fixtures.h"
#include "check.h"
#include "dalembert/run.h"

enum { STEPS = 24, N2 = 8, M = 2, EMPTY = 7 };

static void fill(size_t count, double *x)
{
    for (size_t i = 0; i < count; i++) x[i] = EMPTY;
}

/* ---- rows ---------------------------------------------------------------------------------- */

/* The rows are the states of single steps, to the bit; a reaction is the mean over its stride. */
static void check_rows(const char *scheme, double h, size_t stride)
{
    dal_system *const system = open_system("disk");
    dal_stepper *const run = start_at(system, scheme, 1.5, h, NULL);
    dal_stepper *const single = start_at(system, scheme, 1.5, h, NULL);
    double x[(STEPS + 1) * N2 + 1], reactions[STEPS * M + 1];
    size_t done = 99;
    fill(sizeof x / sizeof *x, x);
    fill(sizeof reactions / sizeof *reactions, reactions);
    CHECK(dal_integrate(run, STEPS, stride, x, reactions, NULL, NULL, &done) == DAL_SUCCESS);
    CHECK(done == STEPS);
    CHECK(memcmp(x, dal_stepper_state(single), N2 * sizeof *x) == 0);
    for (size_t row = 1; row <= STEPS / stride; row++) {
        double sum[M] = {0};
        for (size_t k = 0; k < stride; k++) {
            double reaction[M];
            CHECK(dal_step(single, reaction) == DAL_SUCCESS);
            for (size_t a = 0; a < M; a++) sum[a] += reaction[a];
        }
        CHECK(memcmp(x + row * N2, dal_stepper_state(single), N2 * sizeof *x) == 0);
        for (size_t a = 0; a < M; a++) /* stride additions of numbers below 1 */
            CHECK_NEAR(reactions[(row - 1) * M + a], sum[a] / (double)stride, 4 * U * STEPS);
    }
    const size_t rows = STEPS / stride;
    CHECK(x[(rows + 1) * N2] == EMPTY && reactions[rows * M] == EMPTY);
    CHECK(dal_stepper_time(run) == 1.5 + STEPS * h);
}

/* A second call goes on where the first stopped: the bits of one call. */
static void test_continuing(void)
{
    dal_system *const system = open_system("generic4");
    const char *const schemes[] = {"leapfrog", "midpoint", "midpoint-nodes", "leapfrog-yoshida4"};
    for (size_t j = 0; j < 4; j++) {
        dal_stepper *const one = start_at(system, schemes[j], 0.0, 0.03, NULL);
        dal_stepper *const two = start_at(system, schemes[j], 0.0, 0.03, NULL);
        double x[(STEPS + 1) * N2], y[(STEPS + 1) * N2];
        size_t done;
        CHECK(dal_integrate(one, STEPS, 2, x, NULL, NULL, NULL, NULL) == DAL_SUCCESS);
        CHECK(dal_integrate(two, 10, 2, y, NULL, NULL, NULL, &done) == DAL_SUCCESS && done == 10);
        CHECK(dal_integrate(two, STEPS - 10, 2, y + 5 * N2, NULL, NULL, NULL, &done) == 0);
        CHECK(done == STEPS - 10);
        CHECK(memcmp(x, y, (STEPS / 2 + 1) * N2 * sizeof *x) == 0);
        CHECK(dal_stepper_time(one) == dal_stepper_time(two));
        release(two);
    }
}

/* No steps: row 0 and nothing else.  No arrays: the state still moves. */
static void test_empty(void)
{
    dal_system *const system = open_system("disk");
    dal_stepper *const stepper = start_at(system, "leapfrog", 0.0, 0.1, NULL);
    double x[2 * N2], reactions[M] = {EMPTY, EMPTY};
    size_t done = 99;
    fill(2 * N2, x);
    CHECK(dal_integrate(stepper, 0, 3, x, reactions, NULL, NULL, &done) == 0 && done == 0);
    CHECK(memcmp(x, dal_stepper_state(stepper), N2 * sizeof *x) == 0);
    CHECK(x[N2] == EMPTY && reactions[0] == EMPTY);
    CHECK(dal_integrate(stepper, 6, 3, NULL, NULL, NULL, NULL, &done) == 0 && done == 6);
    CHECK(memcmp(x, dal_stepper_state(stepper), N2 * sizeof *x) != 0);

    /* Without constraints there are no reactions to write. */
    wide w;
    dal_system *const free_system = open_wide(&w, 3, 0, false, true);
    const dal_scheme leapfrog = find_scheme("leapfrog");
    dal_stepper *const oscillator = start_stepper(free_system, &leapfrog, 0.1, w.state);
    CHECK(dal_integrate(oscillator, 4, 2, NULL, reactions, NULL, NULL, NULL) == DAL_SUCCESS);
    CHECK(reactions[0] == EMPTY);
}

/* t = t0 + k h, one product and one sum, however many steps and calls there were. */
static void test_time(void)
{
    dal_system *const system = open_system("particle");
    const double t0 = 0.3, steps[] = {0.1, -0.1, 1e-3};
    for (size_t j = 0; j < 3; j++) {
        dal_stepper *const stepper = start_at(system, "explicit", t0, steps[j], NULL);
        for (size_t k = 1; k <= 300; k++) {
            CHECK(dal_integrate(stepper, 3, 1, NULL, NULL, NULL, NULL, NULL) == DAL_SUCCESS);
            CHECK(dal_stepper_time(stepper) == t0 + (double)(3 * k) * steps[j]);
        }
        release(stepper);
    }
}

/* ---- observers ------------------------------------------------------------------------------ */

typedef struct watch {
    size_t calls, from, stride, stop_at, fail_at;
    double t0, h, last[N2];
} watch;

static int observe(size_t step, double t, const double *x, void *ctx)
{
    watch *const w = ctx;
    CHECK(step == w->from + w->calls * w->stride);
    CHECK(t == w->t0 + (double)step * w->h);
    memcpy(w->last, x, sizeof w->last);
    w->calls++;
    if (step == w->stop_at) return 3;
    return step == w->fail_at ? -3 : 0;
}

static void test_observer(void)
{
    const double h = 0.1, t0 = 2.0;
    dal_system *const system = open_system("disk");
    dal_stepper *const stepper = start_at(system, "midpoint", t0, h, NULL);
    double x[(STEPS + 1) * N2], reactions[STEPS * M];
    size_t done = 99;
    watch w = {.stride = 4, .stop_at = 999, .fail_at = 999, .t0 = t0, .h = h};
    CHECK(dal_integrate(stepper, 12, 4, x, reactions, observe, &w, &done) == DAL_SUCCESS);
    CHECK(w.calls == 4 && done == 12 && !memcmp(w.last, x + 3 * N2, sizeof w.last));

    /* It stops after row 2 of the next call: steps count from the start, done from the call. */
    w = (watch){.from = 12, .stride = 4, .stop_at = 20, .fail_at = 999, .t0 = t0, .h = h};
    fill(sizeof x / sizeof *x, x);
    CHECK(dal_integrate(stepper, 16, 4, x, reactions, observe, &w, &done) == DAL_STOPPED);
    CHECK(w.calls == 3 && done == 8 && x[2 * N2] != EMPTY && x[3 * N2] == EMPTY);
    CHECK(memcmp(x + 2 * N2, dal_stepper_state(stepper), N2 * sizeof *x) == 0);
    CHECK(dal_stepper_time(stepper) == t0 + 20 * h);

    w = (watch){.from = 20, .stride = 4, .stop_at = 999, .fail_at = 24, .t0 = t0, .h = h};
    CHECK(dal_integrate(stepper, 16, 4, x, reactions, observe, &w, &done) == DAL_EUSER);
    CHECK(w.calls == 2 && done == 4 && dal_stepper_time(stepper) == t0 + 24 * h);
    CHECK(strstr(dal_stepper_error(stepper)->text, "observer returned -3 at step 24") != NULL);

    w = (watch){.from = 24, .stride = 4, .stop_at = 24, .fail_at = 999, .t0 = t0, .h = h};
    fill(sizeof x / sizeof *x, x); /* it sees row 0 first */
    CHECK(dal_integrate(stepper, 16, 4, x, NULL, observe, &w, &done) == DAL_STOPPED);
    CHECK(w.calls == 1 && done == 0 && x[0] != EMPTY && x[N2] == EMPTY);
    CHECK(dal_stepper_time(stepper) == t0 + 24 * h);
}

/* ---- in parts ----------------------------------------------------------------------------- */

enum { LONG = 2000, MOST_2N = 16, MOST_M = 4 };

/* What an observer has seen, in one number for all of it; it may want no more, once. */
typedef struct witness {
    size_t calls, stop_at;
    double sum;
} witness;

static int testify(size_t step, double t, const double *x, void *ctx)
{
    witness *const w = ctx;
    w->sum = 0.75 * w->sum + (double)step + t + x[0] + x[1];
    w->calls++;
    if (w->calls != w->stop_at) return 0;
    w->stop_at = 0;
    return 1;
}

typedef struct record {
    double x[(LONG + 1) * MOST_2N], reactions[LONG * MOST_M];
    size_t stops;
    witness seen;
} record;

/* A run of LONG steps by so many at a time, which the observer interrupts at one of its calls. */
static void run_in_parts(const dal_system *system, const char *scheme, size_t stride, size_t budget,
                         size_t stop_at, record *r)
{
    dal_stepper *const stepper = start_at(system, scheme, 0.25, 0.01, NULL);
    const size_t N = 2 * dal_system_n(system);
    fill(DAL_LENGTH(r->x), r->x);
    fill(DAL_LENGTH(r->reactions), r->reactions);
    r->stops = 0;
    r->seen = (witness){.stop_at = stop_at};
    dal_run run = {.stepper = stepper, .steps = LONG, .stride = stride, .x = r->x,
                   .reactions = r->reactions, .observer = testify, .observer_ctx = &r->seen};
    CHECK(dal_run_go(&run, 0) == (stop_at == 1 ? DAL_STOPPED : DAL_SUCCESS));
    CHECK(run.done == 0 && run.stored == 1 && r->seen.calls == 1); /* where it begins */
    r->stops += stop_at == 1;
    while (run.done < LONG) {
        const size_t before = run.done, left = LONG - before;
        const int status = dal_run_go(&run, budget);
        const size_t made = run.done - before;
        CHECK(status == DAL_SUCCESS ? made == (left < budget ? left : budget)
                                    : status == DAL_STOPPED && made <= budget);
        CHECK(run.stored == run.done / stride + 1 && r->seen.calls == run.stored);
        CHECK(dal_stepper_time(stepper) == 0.25 + (double)run.done * 0.01);
        r->stops += status == DAL_STOPPED;
    }
    CHECK(memcmp(dal_stepper_state(stepper), r->x + (run.stored - 1) * N, N * sizeof *r->x) == 0);
    CHECK(dal_run_go(&run, budget) == DAL_SUCCESS && run.done == LONG); /* it is over */
    CHECK(r->seen.calls == LONG / stride + 1);
}

/* However many steps at a time, and wherever the observer stops it once: the same rows, reactions
 * and calls of the observer, to the bit. */
static void test_budgets(void)
{
    static const size_t strides[] = {1, 10, 1000}, budgets[] = {1, 7, 64, 1000, SIZE_MAX};
    static const struct {
        const char *system, *scheme;
    } cases[] = {{"generic4", "leapfrog-suzuki4"}, {"genmass", "midpoint"}, {"disk", "leapfrog"},
                 {"particle", "midpoint-nodes"}, {"generic4", "pair:0.25:0.5"},
                 {"particle_oscillator", "reference"}};
    record *const whole = malloc(sizeof *whole), *const parts = malloc(sizeof *parts);
    if (!whole || !parts) exit(2);
    for (size_t c = 0; c < DAL_LENGTH(cases); c++) {
        dal_system *const system = open_system(cases[c].system);
        for (size_t s = 0; s < DAL_LENGTH(strides); s += brief() ? 2 : 1) {
            run_in_parts(system, cases[c].scheme, strides[s], LONG, 0, whole);
            for (size_t b = 0; b < DAL_LENGTH(budgets); b++)
                for (size_t stop = 0; stop <= 2; stop++) {
                    const size_t rows = LONG / strides[s] + 1;
                    const size_t stop_at = stop == 2 ? rows / 2 + 1 : stop;
                    run_in_parts(system, cases[c].scheme, strides[s], budgets[b], stop_at, parts);
                    CHECK(parts->stops == (stop_at > 0));
                    CHECK(memcmp(whole->x, parts->x, sizeof whole->x) == 0);
                    const size_t size = sizeof whole->reactions; /* NaN has its bits */
                    CHECK(memcmp(whole->reactions, parts->reactions, size) == 0);
                    CHECK(whole->seen.sum == parts->seen.sum);
                }
        }
        release(system);
    }
    free(whole);
    free(parts);
}

/* generic4 whose constraint refuses, once, at one of its calls. */
static int fragile(double t, const double *q, const double *v, double *phi, double *phi_v,
                   double *phi_q, double *phi_t, void *ctx)
{
    size_t *const left = ctx;
    if (*left > 0 && --*left == 0) return -1;
    return generic4_constraint(t, q, v, phi, phi_v, phi_q, phi_t, NULL);
}

/* A general Lagrangian of the same system. */
static int general(double t, const double *q, const double *v, double *L, double *L_q,
                   double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt, void *ctx)
{
    double V = 0.0, Mv[4];
    (void)ctx, (void)L_vt;
    generic4_potential(t, q, &V, L_q, L_qq, NULL);
    dal__apply(4, 4, generic4_mass, v, Mv);
    if (L) *L = 0.5 * dal__dot(4, v, Mv) - V;
    for (size_t i = 0; L_q && i < 4; i++) L_q[i] = -L_q[i];
    for (size_t k = 0; L_qq && k < 16; k++) L_qq[k] = -L_qq[k];
    if (L_v) memcpy(L_v, Mv, sizeof Mv);
    if (L_vq) memset(L_vq, 0, 16 * sizeof *L_vq);
    if (L_vv) memcpy(L_vv, generic4_mass, sizeof generic4_mass);
    return 0;
}

/* A failure in the middle of a stride, in any sub-step: the rows before it stand, and the run goes
 * on.  What a step that failed had gathered of impulses is in no reaction. */
static void test_mended(void)
{
    static const char *const schemes[] = {"leapfrog", "leapfrog-suzuki4", "midpoint-yoshida4",
                                          "pair:0.25:0.5"};
    enum { MADE = 12, STRIDE = 4, ROWS = MADE / STRIDE };
    for (int as = 0; as < 2; as++)
        for (size_t j = 0; j < DAL_LENGTH(schemes); j++) {
            size_t left = 0, failures = 0;
            double state[N2], rows[2][(ROWS + 1) * N2], reactions[2][ROWS * M];
            generic4_state(state);
            const dal_system_def def = {
                .n = 4, .m = 2, .mass = as ? NULL : generic4_mass,
                .lagrangian = as ? general : NULL,
                .potential = as ? NULL : generic4_potential, .constraint = fragile, .ctx = &left,
                .state = state};
            dal_system *const system = new_system(&def);
            for (size_t calls = 0; calls < 400; calls += 3) {
                left = 0;
                dal_stepper *const stepper = start_at(system, schemes[j], 0.0, 0.2, NULL);
                const int k = calls > 0;
                dal_run run = {.stepper = stepper, .steps = MADE, .stride = STRIDE, .x = rows[k],
                               .reactions = reactions[k]};
                fill((ROWS + 1) * N2, rows[k]);
                fill(ROWS * M, reactions[k]);
                left = calls;
                int status = dal_run_go(&run, SIZE_MAX);
                CHECK(status == DAL_SUCCESS || (k && status == DAL_EUSER));
                if (status) {
                    failures++;
                    CHECK(run.done < MADE && run.stored == run.done / STRIDE + 1);
                    for (size_t i = run.stored * N2; i < (ROWS + 1) * N2; i++)
                        CHECK(rows[1][i] == EMPTY);
                    for (size_t i = (run.stored - 1) * M; i < ROWS * M; i++)
                        CHECK(reactions[1][i] == EMPTY);
                    CHECK(dal_stepper_time(stepper) == (double)run.done * 0.2);
                    status = dal_run_go(&run, SIZE_MAX);
                }
                CHECK(status == DAL_SUCCESS && run.done == MADE && run.stored == ROWS + 1);
                /* predictions begin anew, each step is solved to 64 u of the state */
                CHECK_NEAR(largest_difference((ROWS + 1) * N2, rows[0], rows[k]), 0.0,
                           64 * MADE * U * sum_of_sizes(N2, dal_stepper_state(stepper)));
                CHECK_NEAR(largest_difference(ROWS * M, reactions[0], reactions[k]), 0.0,
                           256 * MADE * U * sum_of_sizes(N2, dal_stepper_state(stepper)) / 0.2);
                release(stepper);
            }
            CHECK(failures >= 10);
            release(system);
        }
}

/* v_x = 0 on a steep slope: the impulses of some steps overflow in their sum, and no state does. */
static int still(double t, const double *q, const double *v, double *phi, double *phi_v,
                 double *phi_q, double *phi_t, void *ctx)
{
    (void)t, (void)q, (void)phi_t, (void)ctx;
    if (phi) phi[0] = v[0];
    if (phi_v) phi_v[0] = 1.0, phi_v[1] = 0.0;
    if (phi_q) phi_q[0] = phi_q[1] = 0.0;
    return 0;
}

static int slope(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    (void)t;
    const double *const steepness = ctx;
    if (V) *V = *steepness * q[0];
    if (V_q) V_q[0] = *steepness, V_q[1] = 0.0;
    if (V_qq) memset(V_qq, 0, 4 * sizeof *V_qq);
    return 0;
}

/* A row whose reaction is not finite is not stored, and nothing takes its place. */
static void test_pending(void)
{
    const double mass[4] = {1.0, 0.0, 0.0, 1.0}, x0[4] = {0.0, 0.0, 0.0, 1.0};
    double steepness = 4e307;
    const dal_system_def def = {.n = 2, .m = 1, .mass = mass, .potential = slope,
                                .constraint = still, .ctx = &steepness};
    double x[4 * 4], reactions[3];
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = open_named(system, "explicit");
    need(dal_stepper_start(stepper, 0.0, 0.5, x0, DAL_CHECK, DAL_INITIAL_NONE), "still", "");
    fill(DAL_LENGTH(x), x);
    dal_run run = {.stepper = stepper, .steps = 30, .stride = 10, .x = x,
                   .reactions = reactions};
    for (int again = 0; again < 3; again++) { /* ten impulses of 2e307 each */
        CHECK(dal_run_go(&run, 10) == DAL_EDOMAIN && run.done == 10 && run.stored == 1);
        check_true(strstr(dal_stepper_error(stepper)->text, "reaction[0]") != NULL,
                   dal_stepper_error(stepper)->text, "reaction", __LINE__);
        CHECK(x[4] == EMPTY);
    }
    run.reactions = NULL; /* then it may go on */
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS && run.done == 30 && run.stored == 4);
    for (size_t row = 0; row < 4; row++) CHECK(x[4 * row + 1] == 5.0 * (double)row);
}

/* How often it was asked, and what it answers. */
typedef struct guard {
    size_t calls;
    int answer;
    double from, to;
} guard;

static int keep_watch(double far, void *ctx)
{
    guard *const g = ctx;
    CHECK(g->from <= far && far <= g->to);
    g->calls++;
    return g->answer;
}

/* A step of the reference flow that takes long is stopped within it: nothing has changed, and the
 * run goes on to the same bits.  Short steps leave the watch in peace. */
static void test_watch(void)
{
    const dal_scheme scheme = find_scheme("reference");
    dal_system *const system = open_system("generic4");
    double x0[N2], x[2][4 * N2];
    CHECK(dal_system_state(system, x0) == 0);
    for (int watched = 0; watched < 2; watched++) {
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        guard g = {.answer = 1, .from = 0.5, .to = 0.5 + 3 * 40.0};
        dal_run run = {.stepper = stepper, .steps = 3, .stride = 1, .x = x[watched],
                       .watch = watched ? keep_watch : NULL, .watch_ctx = &g};
        CHECK(dal_stepper_start(stepper, 0.5, 40.0, x0, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        fill(4 * N2, x[watched]);
        CHECK(dal_run_go(&run, 1) == (watched ? DAL_STOPPED : DAL_SUCCESS));
        if (watched) { /* in the middle of the first step */
            CHECK(g.calls == 1 && run.done == 0 && run.stored == 1 && x[1][N2] == EMPTY);
            CHECK(memcmp(dal_stepper_state(stepper), x[1], N2 * sizeof *x0) == 0);
            CHECK(strstr(dal_stepper_error(stepper)->text, "watch function returned 1") != NULL);
            g.answer = -1;
            run.watch_ctx = &(guard){.answer = -1, .from = g.from, .to = g.to};
            CHECK(dal_run_go(&run, 1) == DAL_EUSER && run.done == 0);
            run.watch_ctx = &g;
            g.answer = 0;
        }
        CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS && run.done == 3 && run.stored == 4);
        CHECK(dal_advance(stepper, 1, NULL, NULL) == DAL_SUCCESS); /* nobody watches that */
        release(stepper);
    }
    CHECK(memcmp(x[0], x[1], sizeof x[0]) == 0);

    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    guard g = {.from = 0.0, .to = LONG};
    dal_run run = {.stepper = stepper, .steps = LONG, .stride = 1, .watch = keep_watch,
                   .watch_ctx = &g};
    CHECK(dal_stepper_start(stepper, 0.0, 0.01, x0, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS);
    CHECK(g.calls >= 1 && g.calls < LONG / 4); /* of which it would be asked in each */
}

/* ---- errors --------------------------------------------------------------------------------- */

static void test_arguments(void)
{
    dal_system *const system = open_system("disk");
    dal_stepper *const fresh = open_named(system, "leapfrog");
    dal_stepper *const stepper = start_at(system, "leapfrog", 0.0, 0.1, NULL);
    double x[N2], before[N2];
    size_t done = 99;
    fill(N2, x);
    memcpy(before, dal_stepper_state(stepper), sizeof before);
    CHECK(dal_integrate(NULL, 4, 2, x, NULL, NULL, NULL, &done) == DAL_EINVAL && done == 0);
    CHECK(dal_integrate(fresh, 4, 2, x, NULL, NULL, NULL, &done) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(fresh)->text, "not started") != NULL && x[0] == EMPTY);
    CHECK(dal_integrate(stepper, 5, 2, x, NULL, NULL, NULL, &done) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(stepper)->text, "steps = 5") != NULL);
    CHECK(strstr(dal_stepper_error(stepper)->text, "stride = 2") != NULL);
    CHECK(dal_integrate(stepper, 5, 0, x, NULL, NULL, NULL, &done) == DAL_EINVAL && done == 0);
    CHECK(x[0] == EMPTY && memcmp(before, dal_stepper_state(stepper), sizeof before) == 0);
    dal_run run = {.steps = 4, .stride = 2};
    CHECK(dal_run_go(NULL, 3) == DAL_EINVAL && dal_run_go(&run, 3) == DAL_EINVAL);
    run.stepper = fresh;
    CHECK(dal_run_go(&run, 3) == DAL_EINVAL && run.done == 0 && run.stored == 0);
    run = (dal_run){.stepper = stepper, .steps = 4, .stride = 0};
    CHECK(dal_run_go(&run, 3) == DAL_EINVAL && run.done == 0 && run.stored == 0);
}

/* The particle's forms, up to x = 1.7; ctx is the particle. */
static int walled(double t, const double *q, const double *v, double *phi, double *phi_v,
                  double *phi_q, double *phi_t, void *ctx)
{
    if (q[0] > 1.7) return 1;
    const dal_system *const particle = ctx;
    return particle->def.constraint(t, q, v, NULL, phi_v, phi_q, NULL, particle->def.ctx);
}

/* A step that fails ends the run: the rows before it stand, done says how many, and the stepper
 * stands after the last good step, which need not be a stored one. */
static void test_failure(void)
{
    dal_system *const particle = open_system("particle");
    dal_system_def def = particle->def;
    def.constraint = walled;
    def.ctx = particle;
    def.exact = NULL;
    def.invariants = 0;
    dal_system *const system = new_system(&def);
    const char *const schemes[] = {"explicit", "midpoint", "leapfrog-yoshida4"};
    for (size_t j = 0; j < 3; j++) {
        dal_stepper *const stepper = start_at(system, schemes[j], 0.0, 0.1, NULL);
        dal_stepper *const other = open_named(particle, schemes[j]);
        double x[(STEPS + 1) * 6], reactions[STEPS], x0[6], mean = NAN;
        size_t done = 99, good = 99;
        CHECK(dal_system_state(system, x0) == 0);
        fill(sizeof x / sizeof *x, x);
        fill(STEPS, reactions);
        CHECK(dal_integrate(stepper, STEPS, 4, x, reactions, NULL, NULL, &done) == DAL_EDOMAIN);
        CHECK(done >= 4 && done < STEPS && done % 4 == 0);
        CHECK(x[done / 4 * 6] != EMPTY && x[(done / 4 + 1) * 6] == EMPTY);
        CHECK(reactions[done / 4 - 1] != EMPTY && reactions[done / 4] == EMPTY);
        CHECK(strstr(dal_stepper_error(stepper)->text, "constraint returned 1") != NULL);

        const size_t steps = (size_t)lround(dal_stepper_time(stepper) / 0.1);
        CHECK(steps >= done && steps < done + 4);
        CHECK(dal_stepper_start(other, 0.0, 0.1, x0, DAL_CHECK, DAL_INITIAL_NONE) == DAL_SUCCESS);
        CHECK(dal_advance(other, steps, NULL, NULL) == DAL_SUCCESS);
        CHECK(largest_difference(6, dal_stepper_state(other), dal_stepper_state(stepper)) == 0.0);
        char words[32];
        snprintf(words, sizeof words, "step %zu ", steps + 1);
        CHECK(strstr(dal_stepper_error(stepper)->text, words) != NULL);
        CHECK(dal_advance(stepper, 3, &mean, &good) == DAL_EDOMAIN && good == 0 && isnan(mean));
        release(other);
    }
}

static int steep(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    if (V) *V = 5e5 * q[0] * q[0];
    if (V_q) V_q[0] = 1e6 * q[0];
    if (V_qq) V_qq[0] = 1e6;
    return 0;
}

/* A step a thousand times too large: each grows by 1e6, and the energy is infinite while the state
 * is not.  That is a jump too. */
static void test_infinite_energy(void)
{
    const double mass = 1.0, x0[2] = {1.0, 0.0};
    const dal_system_def def = {.n = 1, .mass = &mass, .potential = steep};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = start_named(system, "leapfrog", 1.0, x0);
    CHECK(dal_advance(stepper, 28, NULL, NULL) == 0);
    CHECK(dal_integrate(stepper, 1, 1, NULL, NULL, NULL, NULL, NULL) == 0);
    const dal_stats stats = stats_of(stepper);
    CHECK(dal__all_finite(2, dal_stepper_state(stepper)) && stats.jump_step == 29);
    CHECK(isinf(stats.jump));
}

/* ---- an energy that jumps ------------------------------------------------------------------ */

/* A body of mass 2 in a plane that may not leave y = 0, and V = slope x with a step up where x >
 * at[0], another where x > at[1].  V_q = push: it knows nothing of these steps, so that the energy
 * changes by them. */
typedef struct stairs {
    double slope, push, at[2], up[2];
} stairs;

static int on_stairs(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const stairs *const s = ctx;
    if (V) *V = s->slope * q[0];
    for (int k = 0; V && k < 2; k++)
        if (q[0] > s->at[k]) *V += s->up[k];
    if (V_q) V_q[0] = s->push, V_q[1] = 0.0;
    if (V_qq) memset(V_qq, 0, 4 * sizeof *V_qq);
    return 0;
}

static int lagrangian_on_stairs(double t, const double *q, const double *v, double *L, double *L_q,
                                double *L_v, double *L_qq, double *L_vq, double *L_vv,
                                double *L_vt, void *ctx)
{
    double V, V_q[2];
    on_stairs(t, q, &V, V_q, L_qq, ctx);
    if (L) *L = v[0] * v[0] + v[1] * v[1] - V;
    for (size_t i = 0; i < 2; i++) {
        if (L_q) L_q[i] = -V_q[i];
        if (L_v) L_v[i] = 2.0 * v[i];
    }
    if (L_vq) memset(L_vq, 0, 4 * sizeof *L_vq);
    if (L_vv) L_vv[0] = L_vv[3] = 2.0, L_vv[1] = L_vv[2] = 0.0;
    return 0;
}

static int in_line(double t, const double *q, const double *v, double *phi, double *phi_v,
                   double *phi_q, double *phi_t, void *ctx)
{
    if (phi) phi[0] = v[1];
    if (phi_v) phi_v[0] = 0.0, phi_v[1] = 1.0;
    if (phi_q) phi_q[0] = phi_q[1] = 0.0;
    return 0;
}

enum { JUMP_H = 8, GENERAL = 1, FORCED = 2, AFFINE = 4 }; /* h = 1/8 */

/* The statistics after so many steps from x = 0 with speed v. */
static dal_stats climb(stairs s, const char *name, int flags, double v, size_t steps)
{
    static const double mass[4] = {2.0, 0.0, 0.0, 2.0};
    const dal_system_def def = {
        .n = 2, .m = 1, .constraint = in_line, .ctx = &s,
        .mass = flags & GENERAL ? NULL : mass, .potential = flags & GENERAL ? NULL : on_stairs,
        .lagrangian = flags & GENERAL ? lagrangian_on_stairs : NULL,
        .force = flags & FORCED ? no_force_2 : NULL,
        .kind = flags & AFFINE ? DAL_AFFINE : DAL_LINEAR};
    dal_scheme scheme = find_scheme(name);
    const double x[4] = {0.0, 0.0, v, 0.0};
    if (scheme.nodes == DAL_KEPT_NODES) scheme.order = 0; /* a record of the user's own */
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    dal_stats stats, last;
    need(dal_stepper_start(stepper, 0.0, 1.0 / JUMP_H, x, DAL_CHECK,
                           scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE),
         name, dal_stepper_error(stepper)->text);
    CHECK(dal_advance(stepper, steps, NULL, NULL) == 0);
    dal_stepper_stats(stepper, &stats);
    CHECK(dal_integrate(stepper, 0, 1, NULL, NULL, NULL, NULL, NULL) == 0);
    dal_stepper_stats(stepper, &last); /* a look is not counted */
    CHECK(last.potential_calls == stats.potential_calls);
    CHECK(last.lagrangian_calls == stats.lagrangian_calls);
    return last;
}

/* A jump is a change by more than half of the largest kinetic energy so far, up or down, and the
 * first is told; it is looked for in every 64th step, where x = 8, 16, ..., and at the end. */
static void test_jumps(void)
{
    static const struct {
        stairs s;
        double v;
        size_t steps, step;
        double jump, kinetic;
    } cases[] = {
        {{.at = {1, 1}, .up = {0.49}}, 1, 300, 0, 0, 1},
        {{.at = {1, 1}, .up = {0.51}}, 1, 300, 64, 0.51, 1},
        {{.at = {1, 1}, .up = {-0.49}}, 1, 300, 0, 0, 1},
        {{.at = {1, 1}, .up = {-0.51}}, 1, 300, 64, -0.51, 1},
        {{.at = {1, 1}, .up = {0.51}}, 1, 40, 40, 0.51, 1},
        {{.at = {10, 17}, .up = {0.6, 0.9}}, 1, 300, 128, 0.6, 1},
        /* thrown up, at rest in step 64; and falling from rest, with v = 2 in step 128 */
        {{.slope = 0.25, .push = 0.25, .at = {3.9, 9}, .up = {0.3}}, 1, 64, 0, 0, 1},
        {{.slope = -0.25, .push = -0.25, .at = {3.9, 9}, .up = {0.3}}, 0, 128, 0, 0, 4},
        /* the energy is infinite in the end, as the kinetic energy is; and from the start on */
        {{.push = -1e200, .at = {1, 1}}, 1, 5, 5, INFINITY, INFINITY},
        {{.at = {1, 1}}, 1e200, 100, 0, 0, INFINITY},
    };
    for (size_t j = 0; j < sizeof cases / sizeof *cases; j++)
        for (int flags = 0; flags <= GENERAL; flags++) {
            if (j >= 8 && flags) continue; /* an infinite L is refused */
            const dal_stats stats = climb(cases[j].s, "midpoint", flags, cases[j].v,
                                          cases[j].steps);
            CHECK(stats.jump_step == cases[j].step);
            CHECK_NEAR(stats.jump, cases[j].jump, 32 * U);
            CHECK_NEAR(stats.largest_kinetic, cases[j].kinetic, 32 * U);
        }
    /* nothing is told where work is done, or a scheme of order 1 has its own error */
    const stairs high = {.at = {1, 1}, .up = {5.0}};
    CHECK(climb(high, "leapfrog", 0, 1.0, 300).jump_step == 64);
    CHECK(climb(high, "explicit", 0, 1.0, 300).jump_step == 0);
    CHECK(climb(high, "midpoint", FORCED, 1.0, 300).jump_step == 0);
    CHECK(climb(high, "midpoint", AFFINE, 1.0, 300).jump_step == 0);
    /* kept nodes are half a step ahead of q~: at the start, and in step 64 */
    const stairs ahead = {.at = {8 + 0.25 / JUMP_H, 9}, .up = {5.0}};
    CHECK(climb(ahead, "midpoint-nodes", 0, 1.0, 64).jump_step == 0);
    const stairs behind = {.at = {0.25 / JUMP_H, 9}, .up = {5.0}};
    CHECK(climb(behind, "midpoint-nodes", 0, 1.0, 64).jump_step == 64);
}

static int on_spring(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    (void)t, (void)ctx;
    if (V) *V = 0.5 * (q[0] * q[0] + q[1] * q[1]);
    if (V_q) memcpy(V_q, q, 2 * sizeof *q);
    if (V_qq) V_qq[0] = V_qq[3] = 1.0, V_qq[1] = V_qq[2] = 0.0;
    return 0;
}

/* q = cos t, v = -sin t: the estimate of the error, which a run makes unless it is told not to. */
static void test_error(void)
{
    enum { LONG = 200 };
    static const double masses[2] = {1.0, 1.0}, x[4] = {1.0, 0.0, 0.0, 0.0}, h = 0.3;
    const dal_system_def def = {.n = 2, .m = 1, .constraint = in_line, .masses = masses,
                                .potential = on_spring};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = open_named(system, "leapfrog");
    dal_stats stats;
    for (int unchecked = 0; unchecked <= 1; unchecked++) {
        dal_run run = {.stepper = stepper, .steps = LONG, .stride = LONG, .unchecked = unchecked};
        need(dal_stepper_start(stepper, 0.0, h, x, DAL_CHECK, DAL_INITIAL_NONE), "spring", "");
        int status = DAL_SUCCESS;
        do status = dal_run_go(&run, 7); /* pieces: the checks too */
        while (!status && (run.done < run.steps || run.checks > 0));
        CHECK(status == DAL_SUCCESS && run.done == LONG);
        dal_stepper_stats(stepper, &stats);
        const double *const end = dal_stepper_state(stepper);
        const double by = fmax(fabs(end[0] - cos(LONG * h)) / 2.0, fabs(end[2] + sin(LONG * h)));
        CHECK(by > 0.1 && stats.steps == LONG);
        if (!unchecked) CHECK(stats.whole == 1 && fabs(stats.error / by - 1.0) < 0.35);
        else CHECK(stats.whole == 0 && isnan(stats.error) && stats.remade == 0);
    }
}

int main(void)
{
    for (size_t stride = 1; stride <= STEPS; stride++)
        if (STEPS % stride == 0) {
            check_rows("leapfrog", 0.1, stride);
            check_rows("midpoint", -0.1, stride);
            check_rows("midpoint-nodes", 0.1, stride);
            check_rows("leapfrog-suzuki4", 0.1, stride);
        }
    test_continuing();
    test_empty();
    test_time();
    test_observer();
    test_budgets();
    test_mended();
    test_pending();
    test_watch();
    test_arguments();
    test_failure();
    test_infinite_energy();
    test_error();
    test_jumps();
    return check_done();
}
