/* Many steps into the caller's arrays: rows, strides, mean reactions, observers, going on, and what
 * is there after a failure. */
#include "fixtures.h"
#include "check.h"

enum { STEPS = 24, N2 = 8, M = 2, EMPTY = 7 };

static dal_stepper *started(const dal_system *system, const char *scheme, double t0, double h)
{
    const dal_scheme record = find_scheme(scheme);
    dal_stepper *const stepper = open_stepper(system, &record, NULL);
    double x[N2];
    need(dal_system_state(system, x), "state", "");
    need(dal_stepper_start(stepper, t0, h, x, DAL_CHECK,
                           record.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE),
         scheme, dal_stepper_message(stepper));
    return stepper;
}

static void fill(size_t count, double *x)
{
    for (size_t i = 0; i < count; i++) x[i] = EMPTY;
}

/* ---- rows ---------------------------------------------------------------------------------- */

/* The rows are the states of single steps, to the bit; a reaction is the mean over its stride. */
static void check_rows(const char *scheme, double h, size_t stride)
{
    dal_system *const system = open_system("disk");
    dal_stepper *const run = started(system, scheme, 1.5, h);
    dal_stepper *const single = started(system, scheme, 1.5, h);
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
    dal_stepper_free(run);
    dal_stepper_free(single);
    dal_system_free(system);
}

/* A second call goes on where the first stopped: the bits of one call. */
static void test_continuing(void)
{
    dal_system *const system = open_system("generic4");
    const char *const schemes[] = {"leapfrog", "midpoint", "midpoint-nodes", "leapfrog-yoshida4"};
    for (size_t j = 0; j < 4; j++) {
        dal_stepper *const one = started(system, schemes[j], 0.0, 0.03);
        dal_stepper *const two = started(system, schemes[j], 0.0, 0.03);
        double x[(STEPS + 1) * N2], y[(STEPS + 1) * N2];
        size_t done;
        CHECK(dal_integrate(one, STEPS, 2, x, NULL, NULL, NULL, NULL) == DAL_SUCCESS);
        CHECK(dal_integrate(two, 10, 2, y, NULL, NULL, NULL, &done) == DAL_SUCCESS && done == 10);
        CHECK(dal_integrate(two, STEPS - 10, 2, y + 5 * N2, NULL, NULL, NULL, &done) == 0);
        CHECK(done == STEPS - 10);
        CHECK(memcmp(x, y, (STEPS / 2 + 1) * N2 * sizeof *x) == 0);
        CHECK(dal_stepper_time(one) == dal_stepper_time(two));
        dal_stepper_free(one);
        dal_stepper_free(two);
    }
    dal_system_free(system);
}

/* No steps: row 0 and nothing else.  No arrays: the state still moves. */
static void test_empty(void)
{
    dal_system *const system = open_system("disk");
    dal_stepper *const stepper = started(system, "leapfrog", 0.0, 0.1);
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
    dal_stepper *const oscillator = open_stepper(free_system, &leapfrog, NULL);
    CHECK(dal_stepper_start(oscillator, 0.0, 0.1, w.state, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_integrate(oscillator, 4, 2, NULL, reactions, NULL, NULL, NULL) == DAL_SUCCESS);
    CHECK(reactions[0] == EMPTY);
    dal_stepper_free(oscillator);
    dal_system_free(free_system);
    dal_stepper_free(stepper);
    dal_system_free(system);
}

/* t = t0 + k h, one product and one sum, however many steps and calls there were. */
static void test_time(void)
{
    dal_system *const system = open_system("particle");
    const double t0 = 0.3, steps[] = {0.1, -0.1, 1e-3};
    for (size_t j = 0; j < 3; j++) {
        dal_stepper *const stepper = started(system, "explicit", t0, steps[j]);
        for (size_t k = 1; k <= 300; k++) {
            CHECK(dal_integrate(stepper, 3, 1, NULL, NULL, NULL, NULL, NULL) == DAL_SUCCESS);
            CHECK(dal_stepper_time(stepper) == t0 + (double)(3 * k) * steps[j]);
        }
        dal_stepper_free(stepper);
    }
    dal_system_free(system);
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
    dal_stepper *const stepper = started(system, "midpoint", t0, h);
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
    CHECK(strstr(dal_stepper_message(stepper), "observer returned -3 at step 24") != NULL);

    w = (watch){.from = 24, .stride = 4, .stop_at = 24, .fail_at = 999, .t0 = t0, .h = h};
    fill(sizeof x / sizeof *x, x); /* it sees row 0 first */
    CHECK(dal_integrate(stepper, 16, 4, x, NULL, observe, &w, &done) == DAL_STOPPED);
    CHECK(w.calls == 1 && done == 0 && x[0] != EMPTY && x[N2] == EMPTY);
    CHECK(dal_stepper_time(stepper) == t0 + 24 * h);
    dal_stepper_free(stepper);
    dal_system_free(system);
}

/* ---- errors --------------------------------------------------------------------------------- */

static void test_arguments(void)
{
    dal_system *const system = open_system("disk");
    const dal_scheme leapfrog = find_scheme("leapfrog");
    dal_stepper *const fresh = open_stepper(system, &leapfrog, NULL);
    dal_stepper *const stepper = started(system, "leapfrog", 0.0, 0.1);
    double x[N2], before[N2];
    size_t done = 99;
    fill(N2, x);
    memcpy(before, dal_stepper_state(stepper), sizeof before);
    CHECK(dal_integrate(NULL, 4, 2, x, NULL, NULL, NULL, &done) == DAL_EINVAL && done == 0);
    CHECK(dal_integrate(fresh, 4, 2, x, NULL, NULL, NULL, &done) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_message(fresh), "not started") != NULL && x[0] == EMPTY);
    CHECK(dal_integrate(stepper, 5, 2, x, NULL, NULL, NULL, &done) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_message(stepper), "steps = 5") != NULL);
    CHECK(strstr(dal_stepper_message(stepper), "stride = 2") != NULL);
    CHECK(dal_integrate(stepper, 5, 0, x, NULL, NULL, NULL, &done) == DAL_EINVAL && done == 0);
    CHECK(x[0] == EMPTY && memcmp(before, dal_stepper_state(stepper), sizeof before) == 0);
    dal_stepper_free(fresh);
    dal_stepper_free(stepper);
    dal_system_free(system);
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
    dal_system *system = NULL;
    CHECK(dal_system_new(&system, &def, NULL) == DAL_SUCCESS);
    const char *const schemes[] = {"explicit", "midpoint", "leapfrog-yoshida4"};
    for (size_t j = 0; j < 3; j++) {
        const dal_scheme scheme = find_scheme(schemes[j]);
        dal_stepper *const stepper = started(system, schemes[j], 0.0, 0.1);
        dal_stepper *const other = open_stepper(particle, &scheme, NULL);
        double x[(STEPS + 1) * 6], reactions[STEPS], x0[6], mean = NAN;
        size_t done = 99, good = 99;
        CHECK(dal_system_state(system, x0) == 0);
        fill(sizeof x / sizeof *x, x);
        fill(STEPS, reactions);
        CHECK(dal_integrate(stepper, STEPS, 4, x, reactions, NULL, NULL, &done) == DAL_EDOMAIN);
        CHECK(done >= 4 && done < STEPS && done % 4 == 0);
        CHECK(x[done / 4 * 6] != EMPTY && x[(done / 4 + 1) * 6] == EMPTY);
        CHECK(reactions[done / 4 - 1] != EMPTY && reactions[done / 4] == EMPTY);
        CHECK(strstr(dal_stepper_message(stepper), "constraint returned 1") != NULL);

        const size_t steps = (size_t)lround(dal_stepper_time(stepper) / 0.1);
        CHECK(steps >= done && steps < done + 4);
        CHECK(dal_stepper_start(other, 0.0, 0.1, x0, DAL_CHECK, DAL_INITIAL_NONE) == DAL_SUCCESS);
        CHECK(dal_advance(other, steps, NULL, NULL) == DAL_SUCCESS);
        CHECK(largest_difference(6, dal_stepper_state(other), dal_stepper_state(stepper)) == 0.0);
        char words[32];
        snprintf(words, sizeof words, "step %zu ", steps + 1);
        CHECK(strstr(dal_stepper_message(stepper), words) != NULL);
        CHECK(dal_advance(stepper, 3, &mean, &good) == DAL_EDOMAIN && good == 0 && isnan(mean));
        dal_stepper_free(stepper);
        dal_stepper_free(other);
    }
    dal_system_free(system);
    dal_system_free(particle);
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
    const dal_scheme scheme = find_scheme("leapfrog");
    dal_system *system = NULL;
    dal_stats stats;
    need(dal_system_new(&system, &def, NULL), "steep", "");
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    CHECK(dal_stepper_start(stepper, 0.0, 1.0, x0, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_advance(stepper, 28, NULL, NULL) == 0);
    CHECK(dal_integrate(stepper, 1, 1, NULL, NULL, NULL, NULL, NULL) == 0);
    dal_stepper_stats(stepper, &stats);
    CHECK(dal__all_finite(2, dal_stepper_state(stepper)) && stats.jump_step == 29);
    CHECK(isinf(stats.jump));
    dal_stepper_free(stepper);
    dal_system_free(system);
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

static int no_force(double t, const double *q, const double *v, double *f, double *f_q, double *f_v,
                    void *ctx)
{
    (void)t, (void)q, (void)v, (void)ctx;
    if (f) memset(f, 0, 2 * sizeof *f);
    if (f_q) memset(f_q, 0, 4 * sizeof *f_q);
    if (f_v) memset(f_v, 0, 4 * sizeof *f_v);
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
        .force = flags & FORCED ? no_force : NULL,
        .kind = flags & AFFINE ? DAL_AFFINE : DAL_LINEAR};
    dal_scheme scheme = find_scheme(name);
    const double x[4] = {0.0, 0.0, v, 0.0};
    dal_system *system = NULL;
    dal_error error = {0};
    if (scheme.nodes == DAL_KEPT_NODES) scheme.order = 0; /* a record of the user's own */
    need(dal_system_new(&system, &def, &error), "stairs", error.text);
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    dal_stats stats, last;
    need(dal_stepper_start(stepper, 0.0, 1.0 / JUMP_H, x, DAL_CHECK,
                           scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE),
         name, dal_stepper_message(stepper));
    CHECK(dal_advance(stepper, steps, NULL, NULL) == 0);
    dal_stepper_stats(stepper, &stats);
    CHECK(dal_integrate(stepper, 0, 1, NULL, NULL, NULL, NULL, NULL) == 0);
    dal_stepper_stats(stepper, &last); /* a look is not counted */
    CHECK(last.potential_calls == stats.potential_calls);
    CHECK(last.lagrangian_calls == stats.lagrangian_calls);
    dal_stepper_free(stepper);
    dal_system_free(system);
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
    test_arguments();
    test_failure();
    test_infinite_energy();
    test_jumps();
    return check_done();
}
