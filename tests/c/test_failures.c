/* Everything around the library fails: callbacks at each of their calls, matrices that are
 * singular, iterations that diverge, sizes that overflow, pointers that are NULL.  What it owes
 * then is the status that the header names, a message with the numbers, states and outputs bit for
 * bit as they were, and an object that goes on as if nothing had happened.  GSL's handler aborts
 * throughout. */
#include "fixtures.h"
#include "check.h"

#include <ctype.h>
#include <gsl/gsl_errno.h>
#include <stdlib.h>
#include <string.h>

enum { MOST = 8, MOST_FORMS = 2, STEPS = 4, STATE_BYTES = MOST * sizeof(double) };

static bool has_number(const char *text)
{
    while (*text && !isdigit((unsigned char)*text)) text++;
    return *text != '\0';
}

static bool all_are(size_t count, const double *x, double value)
{
    for (size_t i = 0; i < count; i++)
        if (x[i] != value) return false;
    return true;
}

static void fill(size_t count, double *x, double value)
{
    for (size_t i = 0; i < count; i++) x[i] = value;
}

/* An answer that no function gives. */
static const double UNTOUCHED = -77.25;

/* ---- a system whose callbacks fail as they are told to ----------------------------------- */

typedef enum callback { CONSTRAINT, POTENTIAL, CALLBACKS } callback;

typedef enum disturbance {
    REFUSE,    /* return 1 */
    STOP,      /* return -1 */
    WRITE_NAN, /* in the last entry of every output */
    WRITE_INF,
    WRITE_NOTHING
} disturbance;

typedef struct fault {
    dal_system *inner;        /* the system that is disturbed */
    callback where;
    disturbance what;
    size_t call, from, until; /* in calls from <= call < until of that callback */
    size_t lost;              /* calls of both where q was not finite */
} fault;

static void plan_fault(fault *f, callback where, disturbance what, size_t from, size_t until)
{
    *f = (fault){f->inner, where, what, 0, from, until, 0};
}

static void repair(fault *f) { f->until = 0; }

static bool strikes(fault *f, callback where)
{
    if (where != f->where) return false;
    const size_t call = f->call++;
    return f->from <= call && call < f->until;
}

/* What a callback that refuses or stops leaves in its outputs is of no use to anyone. */
static void spoil(const fault *f, size_t count, double *output)
{
    if (!output) return;
    if (f->what == REFUSE || f->what == STOP) fill(count, output, (double)NAN);
    else output[count - 1] = f->what == WRITE_NAN ? (double)NAN : -(double)INFINITY;
}

static int answer(const fault *f) { return f->what == REFUSE ? 1 : f->what == STOP ? -1 : 0; }

static int status_of(disturbance what) { return what == STOP ? DAL_EUSER : DAL_EDOMAIN; }

static int faulty_constraint(double t, const double *q, const double *v, double *phi,
                             double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    fault *const f = ctx;
    const dal_system_def *const def = &f->inner->def;
    const bool hit = strikes(f, CONSTRAINT);
    f->lost += !dal__all_finite(def->n, q);
    if (hit && f->what == WRITE_NOTHING) return 0;
    const int returned = def->constraint(t, q, v, phi, phi_v, phi_q, NULL, def->ctx);
    if (!hit) return returned;
    spoil(f, def->m, phi);
    spoil(f, def->m * def->n, phi_v);
    spoil(f, def->m * def->n, phi_q);
    return answer(f);
}

static int faulty_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                            void *ctx)
{
    fault *const f = ctx;
    const dal_system_def *const def = &f->inner->def;
    const bool hit = strikes(f, POTENTIAL);
    f->lost += !dal__all_finite(def->n, q);
    if (hit && f->what == WRITE_NOTHING) return 0;
    const int returned = def->potential(t, q, V, V_q, V_qq, def->ctx);
    if (!hit) return returned;
    spoil(f, 1, V);
    spoil(f, def->n, V_q);
    spoil(f, def->n * def->n, V_qq);
    return answer(f);
}

/* "free": generic4 without its constraints. */
static dal_system *open_any(const char *name)
{
    if (strcmp(name, "free") != 0) return open_system(name);
    double state[MOST];
    generic4_state(state);
    const dal_system_def unconstrained = {.n = 4, .mass = generic4_mass,
                                          .potential = generic4_potential, .state = state};
    return new_system(&unconstrained);
}

/* The system called name, with callbacks that obey f; x[2n] <- its default state. */
static dal_system *open_faulty(const char *name, unsigned missing, fault *f, double *x)
{
    *f = (fault){.inner = open_any(name)};
    CHECK(dal_system_state(f->inner, x) == 0);
    dal_system_def def = f->inner->def;
    def.ctx = f;
    def.missing = missing;
    if (def.constraint) def.constraint = faulty_constraint;
    if (def.potential) def.potential = faulty_potential;
    def.exact = NULL;
    def.invariants = 0;
    return new_system(&def);
}

static bool has(const fault *f, callback where)
{
    return where == CONSTRAINT ? f->inner->def.constraint != NULL : f->inner->def.potential != NULL;
}

/* ---- a run that is disturbed at every call ------------------------------------------------ */

typedef struct bench {
    fault f;
    dal_system *system;
    dal_stepper *stepper;
    dal_initial initial;
    size_t n, m;
    double x0[MOST];
    double rows[STEPS + 1][MOST], reactions[STEPS][MOST_FORMS]; /* of the undisturbed run */
    size_t calls[CALLBACKS];                                    /* in it, its start included */
    double tolerance;
    size_t refused, recovered; /* disturbances that failed a step, and that did not */
} bench;

static const double h = 0.125;

static int start(bench *b)
{
    return dal_stepper_start(b->stepper, 0.5, h, b->x0, DAL_CHECK, b->initial);
}

static void open_bench(bench *b, const char *system, unsigned missing, const char *scheme_name,
                       way by)
{
    dal_scheme scheme;
    *b = (bench){0};
    b->system = open_faulty(system, missing, &b->f, b->x0);
    b->n = dal_system_n(b->system);
    b->m = dal_system_m(b->system);
    CHECK(dal_scheme_find(&scheme, scheme_name, NULL) == 0);
    b->stepper = open_stepper_by(by, b->system, &scheme);
    b->initial = scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_D : DAL_INITIAL_NONE;
    for (callback where = 0; where < CALLBACKS; where++) {
        plan_fault(&b->f, where, REFUSE, 0, 0);
        CHECK(start(b) == 0);
        CHECK(dal_advance(b->stepper, STEPS, NULL, NULL) == 0);
        b->calls[where] = b->f.call;
    }
    CHECK(start(b) == 0);
    memcpy(b->rows[0], dal_stepper_state(b->stepper), 2 * b->n * sizeof(double));
    double scale = 1.0;
    for (size_t k = 1; k <= STEPS; k++) {
        CHECK(dal_step(b->stepper, b->reactions[k - 1]) == 0);
        memcpy(b->rows[k], dal_stepper_state(b->stepper), 2 * b->n * sizeof(double));
        for (size_t i = 0; i < 2 * b->n; i++) scale = fmax(scale, fabs(b->rows[k][i]));
    }
    /* a step is solved to 64 u of the state's scale, by whatever path, and the steps add up */
    b->tolerance = 64 * DAL_ROUNDOFF * scale * STEPS;
}

static void check_state(const bench *b, const double *x, size_t step)
{
    double worst = 0.0;
    for (size_t i = 0; i < 2 * b->n; i++) {
        const double error = fabs(x[i] - b->rows[step][i]);
        if (!(error <= worst)) worst = error; /* NaN too */
    }
    CHECK_NEAR(worst, 0.0, b->tolerance);
}

/* One step; if it fails nothing but counters and the message has changed. */
static int careful_step(bench *b)
{
    double before[MOST], reaction[MOST_FORMS];
    const double *const state = dal_stepper_state(b->stepper);
    const double t = dal_stepper_time(b->stepper);
    dal_stats stats, after;
    dal_stepper_stats(b->stepper, &stats);
    memcpy(before, state, 2 * b->n * sizeof *before);
    fill(MOST_FORMS, reaction, UNTOUCHED);
    const int status = dal_step(b->stepper, reaction);
    if (!status) return status;
    dal_stepper_stats(b->stepper, &after);
    CHECK(memcmp(before, state, 2 * b->n * sizeof *before) == 0);
    CHECK(dal_stepper_time(b->stepper) == t && after.steps == stats.steps);
    CHECK(all_are(MOST_FORMS, reaction, UNTOUCHED));
    const char *const text = dal_stepper_error(b->stepper)->text;
    CHECK(strncmp(text, "step ", 5) == 0 && strstr(text, "h = 0.125") != NULL);
    return status;
}

/* A start; if it fails the stepper stands where it stood. */
static int careful_start(bench *b)
{
    double before[MOST];
    const double t = dal_stepper_time(b->stepper);
    memcpy(before, dal_stepper_state(b->stepper), 2 * b->n * sizeof *before);
    const int status = start(b);
    if (!status) return status;
    CHECK(memcmp(before, dal_stepper_state(b->stepper), 2 * b->n * sizeof *before) == 0);
    CHECK(dal_stepper_time(b->stepper) == t);
    CHECK(strstr(dal_stepper_error(b->stepper)->text,
                 b->f.where == CONSTRAINT ? "constraint" : "potential") != NULL);
    return status;
}

/* The k-th call disturbed, once or from then on, and mended after the failure. */
static void disturb(bench *b, callback where, disturbance what, size_t k, bool once)
{
    size_t failures = 0;
    plan_fault(&b->f, where, what, k, once ? k + 1 : SIZE_MAX);
    int status = careful_start(b);
    if (status) {
        failures++;
        CHECK(status == status_of(what));
        if (what == STOP) CHECK(b->f.call == k + 1);
        if (!once) CHECK(careful_start(b) == status);
        repair(&b->f);
        CHECK(careful_start(b) == 0);
    }
    for (size_t step = 1; step <= STEPS; step++) {
        const bool over = once && b->f.call > k; /* then nothing is left of it */
        const size_t lost = b->f.lost;
        status = careful_step(b);
        if (over) CHECK(b->f.lost == lost);
        if (status) {
            failures++;
            CHECK(status == status_of(what));
            if (what == STOP) CHECK(b->f.call == k + 1);
            /* what was not finite at its first evaluation only cannot be found again */
            if (!once || what == REFUSE || what == STOP)
                CHECK(strstr(dal_stepper_error(b->stepper)->text,
                             where == CONSTRAINT ? "constraint" : "potential") != NULL);
            if (!once) CHECK(careful_step(b) == status);
            repair(&b->f);
            CHECK(careful_step(b) == 0);
        }
        check_state(b, dal_stepper_state(b->stepper), step);
    }
    CHECK(b->f.call > k);
    CHECK(failures <= 1);
    if (what == STOP || !once) CHECK(failures == 1);
    b->refused += failures;
    b->recovered += !failures;
}

static const char *const schemes[] = {"explicit", "midpoint", "endpoint", "leapfrog",
                                      "midpoint-nodes", "leapfrog-suzuki4", "leapfrog-mirror"};
enum { SCHEMES = sizeof schemes / sizeof schemes[0] };

static void test_disturbed_steps(const char *system, unsigned missing, way by, size_t every)
{
    if (brief()) every *= 7;
    size_t recovered = 0;
    for (size_t i = 0; i < SCHEMES; i++) {
        bench b;
        open_bench(&b, system, missing, schemes[i], by);
        for (callback where = 0; where < CALLBACKS; where++) {
            if (!has(&b.f, where)) continue;
            CHECK(b.calls[where] > STEPS);
            for (disturbance what = REFUSE; what < WRITE_NOTHING; what++)
                for (size_t k = 0; k < b.calls[where]; k += every) {
                    disturb(&b, where, what, k, true);
                    disturb(&b, where, what, k, false);
                }
        }
        CHECK(b.refused > 0);
        recovered += b.recovered;
        release(b.f.inner);
    }
    /* a single refusal inside the iteration is survived; hybridsj survives none */
    CHECK((recovered > 0) == (by != BY_MULTIROOT));
}

/* ---- many steps --------------------------------------------------------------------------- */

/* dal_integrate stops at the failure with what it had stored, and goes on from there. */
static void test_disturbed_integration(const char *system, const char *scheme)
{
    bench b;
    open_bench(&b, system, 0, scheme, BY_LIBRARY);
    const size_t n = b.n, m = b.m;
    for (callback where = 0; where < CALLBACKS; where++)
        for (disturbance what = REFUSE; what < WRITE_NOTHING; what++)
            for (size_t k = 0; k < b.calls[where]; k++) {
                double rows[(STEPS + 1) * MOST], reactions[STEPS * MOST_FORMS];
                size_t done = 99;
                plan_fault(&b.f, where, what, SIZE_MAX, SIZE_MAX);
                CHECK(start(&b) == 0);
                b.f.from = b.f.call + k;
                fill((STEPS + 1) * MOST, rows, UNTOUCHED);
                fill(STEPS * MOST_FORMS, reactions, UNTOUCHED);
                int status = dal_integrate(b.stepper, STEPS, 1, rows, reactions, NULL, NULL, &done);
                if (!status) { /* fewer calls after the start than k */
                    CHECK(done == STEPS);
                    continue;
                }
                CHECK(status == status_of(what) && done <= STEPS); /* it looks at the energy last */
                CHECK(memcmp(rows + 2 * n * done, dal_stepper_state(b.stepper),
                             2 * n * sizeof *rows) == 0);
                CHECK(all_are((STEPS - done) * 2 * n, rows + 2 * n * (done + 1), UNTOUCHED));
                CHECK(all_are((STEPS - done) * m, reactions + m * done, UNTOUCHED));
                repair(&b.f);
                status = dal_integrate(b.stepper, STEPS - done, 1, rows + 2 * n * done,
                                       reactions + m * done, NULL, NULL, NULL);
                CHECK(status == 0);
                for (size_t row = 0; row <= STEPS; row++) check_state(&b, rows + 2 * n * row, row);
                for (size_t row = 0; row < STEPS; row++)
                    for (size_t a = 0; a < m; a++) /* an impulse over h */
                        CHECK_NEAR(reactions[m * row + a], b.reactions[row][a], b.tolerance / h);
            }
}

/* In the middle of a stride: the stepper stands after its last good step, between two rows. */
static void test_disturbed_stride(void)
{
    bench b;
    open_bench(&b, "generic4", 0, "leapfrog", BY_LIBRARY);
    size_t between = 0;
    for (size_t k = 0; k < b.calls[CONSTRAINT]; k++) {
        double rows[3 * MOST], reactions[2 * MOST_FORMS];
        size_t done = 99;
        plan_fault(&b.f, CONSTRAINT, STOP, SIZE_MAX, SIZE_MAX);
        CHECK(start(&b) == 0);
        b.f.from = b.f.call + k;
        fill(3 * MOST, rows, UNTOUCHED);
        fill(2 * MOST_FORMS, reactions, UNTOUCHED);
        if (dal_integrate(b.stepper, STEPS, 2, rows, reactions, NULL, NULL, &done) == 0) break;
        const dal_stats stats = stats_of(b.stepper);
        between += stats.steps % 2;
        CHECK(done == stats.steps - stats.steps % 2);
        check_state(&b, dal_stepper_state(b.stepper), stats.steps);
        CHECK(all_are(2 * b.n, rows + 2 * b.n * (done / 2 + 1), UNTOUCHED));
        CHECK(all_are(b.m, reactions + b.m * (done / 2), UNTOUCHED));
        repair(&b.f);
        double mean[MOST_FORMS];
        fill(MOST_FORMS, mean, UNTOUCHED);
        plan_fault(&b.f, CONSTRAINT, STOP, 0, 1);
        CHECK(dal_advance(b.stepper, 3, mean, &done) == DAL_EUSER);
        CHECK(done == 0 && all_are(MOST_FORMS, mean, UNTOUCHED));
    }
    CHECK(between > 0);
}

/* Stops at the call of its number. */
typedef struct watch {
    size_t call, stop_at;
    int answer;
} watch;

static int watching(size_t step, double t, const double *x, void *ctx)
{
    watch *const w = ctx;
    (void)x;
    CHECK(t == 0.5 + (double)step * h);
    return w->call++ == w->stop_at ? w->answer : 0;
}

static void test_observer(void)
{
    bench b;
    open_bench(&b, "generic4", 0, "midpoint", BY_LIBRARY);
    for (size_t k = 0; k <= STEPS; k++)
        for (int sign = -1; sign <= 1; sign += 2) {
            double rows[(STEPS + 1) * MOST];
            size_t done = 99;
            watch w = {0, k, 5 * sign};
            fill((STEPS + 1) * MOST, rows, UNTOUCHED);
            CHECK(start(&b) == 0);
            CHECK(dal_integrate(b.stepper, STEPS, 1, rows, NULL, watching, &w, &done)
                  == (sign > 0 ? DAL_STOPPED : DAL_EUSER));
            CHECK(w.call == k + 1 && done == k);
            if (sign < 0) CHECK(strstr(dal_stepper_error(b.stepper)->text, "returned -5") != NULL);
            CHECK(all_are((STEPS - k) * 2 * b.n, rows + 2 * b.n * (k + 1), UNTOUCHED));
            w.stop_at = SIZE_MAX;
            CHECK(dal_integrate(b.stepper, STEPS - k, 1, rows + 2 * b.n * k, NULL, watching, &w,
                                NULL) == 0);
            /* the pause costs not one bit */
            for (size_t row = 0; row <= STEPS; row++)
                CHECK(memcmp(rows + 2 * b.n * row, b.rows[row], 2 * b.n * sizeof *rows) == 0);
        }
}

/* A start that is refused in the middle of a run leaves not one bit behind. */
static void test_refused_start(way by)
{
    bench b;
    open_bench(&b, "generic4", 0, "midpoint", by);
    double bad[MOST];
    memcpy(bad, b.x0, sizeof bad);
    bad[4] += 0.125;
    CHECK(start(&b) == 0);
    for (size_t step = 1; step <= STEPS; step++) {
        const double times[] = {NAN, INFINITY, 0.0};
        const double steps[] = {0.0, NAN, INFINITY, -INFINITY, 4.9406564584124654e-324, 1e-310};
        for (size_t i = 0; i < 2; i++)
            CHECK(dal_stepper_start(b.stepper, times[i], h, b.x0, DAL_CHECK, DAL_INITIAL_NONE)
                  == DAL_EINVAL);
        for (size_t i = 0; i < sizeof steps / sizeof steps[0]; i++) {
            CHECK(dal_stepper_start(b.stepper, 0.0, steps[i], b.x0, DAL_CHECK, DAL_INITIAL_NONE)
                  == DAL_EINVAL);
            CHECK(strstr(dal_stepper_error(b.stepper)->text, "h = ") != NULL);
        }
        CHECK(dal_stepper_start(b.stepper, 0.0, h, bad, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EOFFD);
        CHECK(has_number(dal_stepper_error(b.stepper)->text));
        for (size_t i = 0; i < 2 * b.n; i++) {
            double x[MOST];
            memcpy(x, b.x0, sizeof x);
            x[i] = i % 2 ? (double)NAN : -(double)INFINITY;
            CHECK(dal_stepper_start(b.stepper, 0.0, h, x, DAL_PROJECT, DAL_INITIAL_NONE)
                  == DAL_EINVAL);
            CHECK(strstr(dal_stepper_error(b.stepper)->text, i < b.n ? "q[" : "v[") != NULL);
        }
        CHECK(dal_stepper_start(b.stepper, 0.0, h, b.x0, (dal_consistency)7, DAL_INITIAL_NONE)
              == DAL_EINVAL);
        CHECK(dal_stepper_start(b.stepper, 0.0, h, b.x0, DAL_CHECK, (dal_initial)9) == DAL_EINVAL);
        CHECK(dal_stepper_start(b.stepper, 0.0, h, b.x0, DAL_CHECK, DAL_INITIAL_D) == DAL_EINVAL);
        CHECK(dal_step(b.stepper, NULL) == 0);
        CHECK(memcmp(dal_stepper_state(b.stepper), b.rows[step], 2 * b.n * sizeof *bad) == 0);
        CHECK(dal_stepper_time(b.stepper) == 0.5 + (double)step * h);
    }
}

/* ---- outputs that are never written ------------------------------------------------------- */

/* Writes all that is asked for but one output. */
typedef enum output { V, V_Q, V_QQ, PHI_V, PHI_Q, OUTPUTS } output;

static int forgetful_potential(double t, const double *q, double *V_, double *V_q, double *V_qq,
                               void *ctx)
{
    const output forgotten = *(const output *)ctx;
    return generic4_potential(t, q, forgotten == V ? NULL : V_, forgotten == V_Q ? NULL : V_q,
                              forgotten == V_QQ ? NULL : V_qq, NULL);
}

static int forgetful_constraint(double t, const double *q, const double *v, double *phi,
                                double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    const output forgotten = *(const output *)ctx;
    return generic4_constraint(t, q, v, phi, forgotten == PHI_V ? NULL : phi_v,
                               forgotten == PHI_Q ? NULL : phi_q, NULL, NULL);
}

static void test_nothing_written(void)
{
    static const char *const names[OUTPUTS] = {"V[0,0]", "V_q[0,0]", "V_qq[0,0]", "phi_v[0,0]",
                                               "phi_q[0,0]"};
    for (output forgotten = V; forgotten < OUTPUTS; forgotten++) {
        const dal_system_def def = {.n = 4, .m = 2, .mass = generic4_mass, .ctx = &forgotten,
                                    .potential = forgetful_potential,
                                    .constraint = forgetful_constraint};
        double x[MOST], E = UNTOUCHED;
        generic4_state(x);
        dal_system *const system = new_system(&def);
        dal_mechanics *const mechanics = open_mechanics(system);
        if (forgotten == V) {
            CHECK(dal_energy(mechanics, 0.0, x, &E) == DAL_EDOMAIN && E == UNTOUCHED);
            CHECK(strstr(dal_mechanics_error(mechanics)->text, names[V]) != NULL);
        }
        for (size_t i = 0; i < WAYS * SCHEMES && forgotten != V; i++) {
            dal_scheme scheme;
            CHECK(dal_scheme_find(&scheme, schemes[i % SCHEMES], NULL) == 0);
            dal_stepper *const stepper = open_stepper_by((way)(i / SCHEMES), system, &scheme);
            const dal_initial initial = scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT
                                                                       : DAL_INITIAL_NONE;
            CHECK(dal_stepper_start(stepper, 0.0, h, x, DAL_CHECK, initial) == DAL_EDOMAIN);
            CHECK(strstr(dal_stepper_error(stepper)->text, names[forgotten]) != NULL);
            CHECK(dal_step(stepper, NULL) == DAL_EINVAL);
            release(stepper);
        }
        for (dal_flow_method method = DAL_FLOW_RK8PD; method <= DAL_FLOW_RODAS; method++) {
            if (forgotten == V || forgotten == V_QQ) break; /* it asks for neither */
            double before[MOST];
            memcpy(before, x, sizeof x);
            dal_flow *const flow = open_flow(system, method, DAL_FLOW_X, 1e-6);
            CHECK(dal_flow_apply(flow, 0.0, 1.0, x, &E) == DAL_EDOMAIN && E == UNTOUCHED);
            CHECK(memcmp(x, before, sizeof x) == 0);
            CHECK(strstr(dal_flow_error(flow)->text, names[forgotten]) != NULL);
            release(flow);
        }
        release(system);
    }
}

/* ---- mechanics ---------------------------------------------------------------------------- */

typedef enum question {
    ENERGY, RESIDUAL, RELATIVE, GRAM, MULTIPLIERS, ACCELERATION, FIELD, PROJECT, PROJECT_SHIFTED,
    CONSISTENT, EQUATIONS, QUESTIONS
} question;

/* x[8] = answers[0..8) is the state, changed in place by some; the other outputs follow. */
enum { ANSWERS = MOST + 40 };

static int ask(dal_mechanics *mechanics, question about, double *answers)
{
    static const double w[4] = {0.1, -0.2, 0.3, 0.4}, kappa[2] = {0.5, -0.6};
    static const unsigned char keep[4] = {0, 1, 0, 0};
    double *const x = answers, *const out = answers + MOST;
    switch (about) {
    case ENERGY: return dal_energy(mechanics, 0.0, x, out);
    case RESIDUAL: return dal_residual(mechanics, 0.0, 0.1, x, out);
    case RELATIVE: return dal_relative_residual(mechanics, 0.0, 0.1, x, out);
    case GRAM: return dal_gram(mechanics, 0.0, x, out);
    case MULTIPLIERS: return dal_multipliers(mechanics, 0.0, x, out);
    case ACCELERATION: return dal_acceleration(mechanics, 0.0, x, out);
    case FIELD: return dal_field(mechanics, 0.0, x, out);
    case PROJECT: return dal_project(mechanics, 0.0, 0.0, x, out);
    case PROJECT_SHIFTED: return dal_project(mechanics, 0.0, 0.1, x, out);
    case CONSISTENT: return dal_consistent(mechanics, 0.0, keep, x, out);
    case EQUATIONS:
        return dal_step_equations(mechanics, 0.0, 0.5, h, x, w, kappa, out, out + 4, out + 6,
                                  out + 22, out + 30);
    case QUESTIONS: break;
    }
    return DAL_EINVAL;
}

static void reset_answers(double *answers, const double *x)
{
    fill(ANSWERS, answers, UNTOUCHED);
    memcpy(answers, x, STATE_BYTES);
    answers[5] += 0.25; /* off D, so that projections have something to do */
}

static void test_disturbed_mechanics(unsigned missing)
{
    fault f;
    double x[MOST], before[ANSWERS], answers[ANSWERS];
    dal_system *system = open_faulty("generic4", missing, &f, x);
    dal_mechanics *const mechanics = open_mechanics(system);
    reset_answers(before, x);
    for (question about = ENERGY; about < QUESTIONS; about++) {
        double good[ANSWERS];
        size_t calls[CALLBACKS];
        for (callback where = 0; where < CALLBACKS; where++) {
            plan_fault(&f, where, REFUSE, 0, 0);
            memcpy(good, before, sizeof good);
            CHECK(ask(mechanics, about, good) == 0);
            calls[where] = f.call;
        }
        CHECK(calls[CONSTRAINT] + calls[POTENTIAL] > 0);
        CHECK(memcmp(good, before, sizeof good) != 0);
        for (callback where = 0; where < CALLBACKS; where++)
            for (disturbance what = REFUSE; what <= WRITE_NOTHING; what++)
                for (size_t k = 0; k < calls[where]; k++) { /* for good: halved steps go on */
                    plan_fault(&f, where, what, k, SIZE_MAX);
                    memcpy(answers, before, sizeof answers);
                    CHECK(ask(mechanics, about, answers) == status_of(what));
                    CHECK(memcmp(answers, before, sizeof answers) == 0);
                    const char *const text = dal_mechanics_error(mechanics)->text;
                    CHECK(has_number(text));
                    CHECK(strstr(text, where == CONSTRAINT ? "constraint" : "potential") != NULL);
                    repair(&f);
                    CHECK(ask(mechanics, about, answers) == 0);
                    CHECK(memcmp(answers, good, sizeof answers) == 0);
                }
    }
}

/* Rows before the failure are valid, the others untouched. */
static void test_disturbed_rows(void)
{
    enum { ROWS = 3, EACH = 1 + 2 + 2 + 1 };
    fault f;
    double x[MOST], rows[ROWS * MOST], good[ROWS * EACH], out[ROWS * EACH];
    dal_system *system = open_faulty("generic4", 0, &f, x);
    dal_mechanics *const mechanics = open_mechanics(system);
    for (size_t i = 0; i < ROWS * MOST; i++) rows[i] = x[i % MOST] * (1.0 + 0.125 * (double)i);
    for (callback where = 0; where < CALLBACKS; where++) {
        double *const columns[4] = {out, out + ROWS, out + 3 * ROWS, out + 5 * ROWS};
        const size_t widths[4] = {1, 2, 2, 1};
        size_t done = 99;
        plan_fault(&f, where, STOP, 0, 0);
        CHECK(dal_trajectory(mechanics, 0.0, h, 0.1, ROWS, rows, NULL, columns[0], columns[1],
                             columns[2], columns[3], &done) == 0);
        CHECK(done == ROWS);
        memcpy(good, out, sizeof good);
        const size_t calls = f.call;
        CHECK(calls >= ROWS);
        for (size_t k = 0; k < calls; k++) {
            fill(ROWS * EACH, out, UNTOUCHED);
            plan_fault(&f, where, STOP, k, k + 1);
            CHECK(dal_trajectory(mechanics, 0.0, h, 0.1, ROWS, rows, NULL, columns[0], columns[1],
                                 columns[2], columns[3], &done) == DAL_EUSER);
            CHECK(done == k / (calls / ROWS));
            for (size_t c = 0; c < 4; c++) {
                const size_t valid = done * widths[c], all = ROWS * widths[c];
                CHECK(memcmp(columns[c], good + (columns[c] - out), valid * sizeof *out) == 0);
                CHECK(all_are(all - valid, columns[c] + valid, UNTOUCHED));
            }
        }
    }
}

/* ---- exact solutions and invariants ------------------------------------------------------- */

/* The callbacks write before they fail, or never. */
static int spoiling_exact(double t, const double *x0, double *x, void *ctx)
{
    const fault *const f = ctx;
    if (f->what == WRITE_NOTHING) return 0;
    for (size_t i = 0; i < 8; i++) x[i] = x0[i] + t;
    spoil(f, 8, x);
    return answer(f);
}

static int spoiling_invariant(double t, const double *x, double *values, void *ctx)
{
    const fault *const f = ctx;
    if (f->what == WRITE_NOTHING) return 0;
    values[0] = values[1] = x[0];
    spoil(f, 2, values);
    return answer(f);
}

static void test_exact_and_invariants(void)
{
    static const char *const names[2] = {"one", "two"};
    fault f = {0};
    double x0[MOST], x[MOST], values[2];
    generic4_state(x0);
    const dal_system_def def = {.n = 4, .m = 2, .mass = generic4_mass,
                                .constraint = generic4_constraint, .exact = spoiling_exact,
                                .invariants = 2, .invariant_names = names,
                                .invariant = spoiling_invariant, .ctx = &f};
    dal_system *const system = new_system(&def);
    for (f.what = REFUSE; f.what <= WRITE_NOTHING; f.what++) {
        fill(MOST, x, UNTOUCHED);
        fill(2, values, UNTOUCHED);
        CHECK(dal_system_exact(system, 1.0, x0, x) == status_of(f.what));
        CHECK(dal_system_invariant(system, 0.0, x0, values) == status_of(f.what));
        CHECK(all_are(MOST, x, UNTOUCHED) && all_are(2, values, UNTOUCHED));
    }
    CHECK(dal_system_exact(system, NAN, x0, x) == DAL_EINVAL);
    CHECK(dal_system_exact(system, INFINITY, x0, x) == DAL_EINVAL);
}

/* ---- the reference flow ------------------------------------------------------------------- */

static void test_disturbed_flow(dal_flow_method method, size_t every)
{
    if (brief()) every *= 7;
    enum { ROWS = 5 };
    const double tolerance = 1e-6;
    fault f;
    double x0[MOST], x[MOST], end[MOST], rows[ROWS * MOST];
    dal_system *system = open_faulty("generic4", 0, &f, x0);
    dal_flow *const flow = open_flow(system, method, DAL_FLOW_X, tolerance);
    for (callback where = 0; where < CALLBACKS; where++) {
        plan_fault(&f, where, REFUSE, 0, 0);
        memcpy(end, x0, sizeof end);
        CHECK(dal_flow_apply(flow, 0.0, 1.0, end, NULL) == 0);
        const size_t calls = f.call;
        CHECK(calls > 10);
        for (disturbance what = REFUSE; what < WRITE_NOTHING; what++)
            for (size_t k = 0; k < calls; k += every)
                for (int once = 0; once <= 1; once++) {
                    double accuracy = UNTOUCHED;
                    size_t done = 99;
                    plan_fault(&f, where, what, k, once ? k + 1 : SIZE_MAX);
                    memcpy(x, x0, sizeof x);
                    int status = dal_flow_apply(flow, 0.0, 1.0, x, k % 2 ? &accuracy : NULL);
                    CHECK(status == status_of(what) || (once && what != STOP && status == 0));
                    if (status) {
                        CHECK(memcmp(x, x0, sizeof x) == 0 && accuracy == UNTOUCHED);
                        CHECK(has_number(dal_flow_error(flow)->text));
                        if (what == STOP) CHECK(f.call == k + 1);
                    } else {
                        for (size_t i = 0; i < MOST; i++) /* a restart makes some more errors */
                            CHECK_NEAR(x[i], end[i], 1000 * tolerance);
                    }
                    plan_fault(&f, where, what, k, once ? k + 1 : SIZE_MAX);
                    fill(ROWS * MOST, rows, UNTOUCHED);
                    memcpy(rows, x0, sizeof x0);
                    status = dal_flow_trajectory(flow, 0.0, 0.25, ROWS - 1, rows, &done);
                    CHECK(status == status_of(what) || (once && what != STOP && status == 0)
                          || (status == 0 && f.call <= k));
                    CHECK((done == ROWS - 1) == (status == 0));
                    CHECK(all_are((ROWS - 1 - done) * MOST, rows + (done + 1) * MOST, UNTOUCHED));
                    CHECK(dal__all_finite((done + 1) * MOST, rows));
                }
        /* as good as new */
        plan_fault(&f, where, REFUSE, 0, 0);
        memcpy(x, x0, sizeof x);
        CHECK(dal_flow_apply(flow, 0.0, 1.0, x, NULL) == 0);
        CHECK(memcmp(x, end, sizeof x) == 0);
    }
}

/* ---- the order study ---------------------------------------------------------------------- */

static void test_disturbed_study(const char *scheme_name, size_t every)
{
    if (brief()) every *= 7;
    static const size_t steps[3] = {2, 4, 8};
    enum { COUNT = 3 };
    fault f;
    double x0[MOST];
    dal_scheme scheme;
    dal_error error;
    dal_system *system = open_faulty("generic4", 0, &f, x0);
    CHECK(dal_scheme_find(&scheme, scheme_name, NULL) == 0);
    const dal_order_def def = {.t_end = 0.5, .x0 = x0, .steps = steps, .count = COUNT,
                               .tolerance = 1e-6};
    dal_order_point points[COUNT], good[COUNT], untouched[COUNT];
    dal_order order, untouched_order;
    memset(untouched, 0x55, sizeof untouched);
    memset(&untouched_order, 0x55, sizeof untouched_order);
    for (callback where = 0; where < CALLBACKS; where++) {
        plan_fault(&f, where, REFUSE, 0, 0);
        CHECK(dal_order_study(system, &scheme, &def, good, &order, &error) == 0);
        const size_t calls = f.call;
        size_t failed_points = 0;
        for (disturbance what = REFUSE; what < WRITE_NOTHING; what++)
            for (size_t k = 0; k < calls; k += every)
                for (int once = 0; once <= 1; once++) {
                    plan_fault(&f, where, what, k, once ? k + 1 : SIZE_MAX);
                    memcpy(points, untouched, sizeof points);
                    memcpy(&order, &untouched_order, sizeof order);
                    const int status =
                        dal_order_study(system, &scheme, &def, points, &order, &error);
                    CHECK(error.status == status);
                    if (status) {
                        CHECK(status == status_of(what) && has_number(error.text));
                        CHECK(memcmp(points, untouched, sizeof points) == 0);
                        CHECK(memcmp(&order, &untouched_order, sizeof order) == 0);
                    } else {
                        CHECK(what != STOP);
                        for (size_t i = 0; i < COUNT; i++) {
                            CHECK(points[i].failed == 0 || points[i].failed == DAL_EDOMAIN);
                            failed_points += points[i].failed != 0;
                            if (points[i].failed) CHECK(isnan(points[i].q));
                            else CHECK_NEAR(points[i].q, good[i].q, 1e-3); /* of the reference */
                        }
                    }
                }
        CHECK(failed_points > 0);
    }
}

/* ---- singular, indefinite, divergent ------------------------------------------------------ */

/* n = 3, m = 2: (1, q_1, 0) and a row that is zero, the same, or free of it. */
typedef enum deficiency { ZERO_ROW, EQUAL_ROWS, DOUBLED_ROW } deficiency;

static int deficient_constraint(double t, const double *q, const double *v, double *phi,
                                double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    const double factor = (const double[]){0.0, 1.0, 1.0 / 3.0}[*(const deficiency *)ctx];
    if (phi) {
        phi[0] = v[0] + q[0] * v[1];
        phi[1] = factor * phi[0];
    }
    if (phi_v) {
        const double row[3] = {1.0, q[0], 0.0};
        for (size_t i = 0; i < 6; i++) phi_v[i] = (i < 3 ? 1.0 : factor) * row[i % 3];
    }
    if (phi_q) {
        memset(phi_q, 0, 6 * sizeof *phi_q);
        phi_q[0] = v[1];
        phi_q[3] = factor * v[1];
    }
    return 0;
}

static void test_singular_constraints(void)
{
    static const double mass[9] = {1.0, 0.25, 0.0, 0.25, 2.0, 0.0, 0.0, 0.0, 3.0};
    const double x0[6] = {0.3, 0.0, 0.0, -0.3, 1.0, 2.0};
    for (deficiency kind = ZERO_ROW; kind <= DOUBLED_ROW; kind++) {
        const dal_system_def def = {.n = 3, .m = 2, .mass = mass, .ctx = &kind,
                                    .constraint = deficient_constraint};
        double x[6], out[6];
        memcpy(x, x0, sizeof x);
        fill(6, out, UNTOUCHED);
        dal_system *const system = new_system(&def);
        dal_mechanics *const mechanics = open_mechanics(system);
        dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-6);
        CHECK(dal_multipliers(mechanics, 0.0, x, out) == DAL_ESINGULAR);
        CHECK(has_number(dal_mechanics_error(mechanics)->text));
        CHECK(dal_acceleration(mechanics, 0.0, x, out) == DAL_ESINGULAR);
        CHECK(dal_field(mechanics, 0.0, x, out) == DAL_ESINGULAR);
        CHECK(dal_project(mechanics, 0.0, 0.0, x, out) == DAL_ESINGULAR);
        CHECK(dal_project(mechanics, 0.0, 0.1, x, out) == DAL_ESINGULAR);
        CHECK(dal_consistent(mechanics, 0.0, (const unsigned char[3]){0, 0, 1}, x, out)
              == DAL_ESINGULAR);
        CHECK(dal_flow_apply(flow, 0.0, 1.0, x, out) == DAL_ESINGULAR);
        for (size_t i = 0; i < WAYS * SCHEMES; i++) {
            dal_scheme scheme;
            CHECK(dal_scheme_find(&scheme, schemes[i % SCHEMES], NULL) == 0);
            dal_stepper *const stepper = open_stepper_by((way)(i / SCHEMES), system, &scheme);
            const dal_initial initial = scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_D
                                                                       : DAL_INITIAL_NONE;
            CHECK(dal_stepper_start(stepper, 0.0, h, x, DAL_CHECK, initial) == DAL_ESINGULAR);
            CHECK(dal_stepper_start(stepper, 0.0, h, x, DAL_ASSUME, initial) == 0);
            const int status = dal_step(stepper, out);
            CHECK(status == DAL_ESINGULAR
                  || (i / SCHEMES == BY_MULTIROOT && status == DAL_ENOCONV));
            CHECK(strstr(dal_stepper_error(stepper)->text, "step 1 ") != NULL);
            CHECK(memcmp(dal_stepper_state(stepper), x0, sizeof x0) == 0);
            release(stepper);
        }
        CHECK(memcmp(x, x0, sizeof x) == 0 && all_are(6, out, UNTOUCHED));
        release(system);
    }
}

static void test_bad_mass(void)
{
    const struct {
        double mass[4];
        const char *text;
    } cases[] = {
        {{1.0, 2.0, 2.0, 1.0}, "pivot 1"},
        {{1.0, 0.0, 0.0, -3.0}, "-3"},
        {{0.0, 0.0, 0.0, 1.0}, "pivot 0"},
        {{1.0, 1.0, 1.0, 1.0}, "pivot 1"},
        {{1.0, 0.5, 0.25, 1.0}, "0.25"},
        {{1.0, 0.0, 0.0, NAN}, "mass[1,1] = nan"},
        {{1.0, 0.0, INFINITY, 1.0}, "mass[1,0] = inf"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const dal_system_def def = {.n = 2, .mass = cases[i].mass};
        dal_system *system = NULL;
        dal_error error;
        CHECK(dal_system_new(&system, &def, &error) == DAL_EINVAL);
        CHECK(error.status == DAL_EINVAL && strstr(error.text, cases[i].text) != NULL);
        CHECK(system == NULL);
    }
}

/* The particle at y = -1 with h v_y = 2: mu(q_k) M^-1 mu(q~')^T = (1, 0, 1).(-1, 0, 1) = 0 exactly,
 * and no multiplier turns the velocity into D_q~'. */
static void test_singular_step(void)
{
    const double x0[6] = {0.0, -1.0, 0.0, 1.0, 4.0, -1.0}, length = 0.5;
    for (way by = 0; by < WAYS; by++) {
        dal_system *system = open_system("particle");
        dal_scheme scheme;
        double reaction = UNTOUCHED;
        CHECK(dal_scheme_find(&scheme, "endpoint", NULL) == 0);
        dal_stepper *const stepper = open_stepper_by(by, system, &scheme);
        CHECK(dal_stepper_start(stepper, 0.0, length, x0, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        for (int again = 0; again < 2; again++) {
            const int status = dal_step(stepper, &reaction);
            CHECK(status == DAL_ESINGULAR
                  || (by == BY_MULTIROOT && status == DAL_ENOCONV));
            CHECK(strstr(dal_stepper_error(stepper)->text, "h = 0.5") != NULL);
            CHECK(memcmp(dal_stepper_state(stepper), x0, sizeof x0) == 0);
            CHECK(reaction == UNTOUCHED);
        }
        CHECK(dal_stepper_start(stepper, 0.0, 0.8 * length, x0, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        CHECK(dal_step(stepper, &reaction) == 0);
        release(system);
    }
}

/* The chaotic oscillator by the midpoint scheme with h = 5: after a few steps of the default data
 * Newton finds no solution of the equations of a step. */
static void test_divergence(way by)
{
    dal_system *system = open_system("chaotic");
    dal_scheme scheme;
    double x[14], before[14], reaction = UNTOUCHED;
    int status = DAL_SUCCESS;
    CHECK(dal_system_state(system, x) == 0);
    CHECK(dal_scheme_find(&scheme, "midpoint", NULL) == 0);
    dal_stepper *const stepper = open_stepper_by(by, system, &scheme);
    CHECK(dal_stepper_start(stepper, 0.0, 5.0, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    for (int step = 0; step < 20 && !status; step++) {
        memcpy(before, dal_stepper_state(stepper), sizeof before);
        reaction = UNTOUCHED;
        status = dal_step(stepper, &reaction);
        CHECK(dal__all_finite(14, dal_stepper_state(stepper)));
    }
    CHECK(status == DAL_ENOCONV);
    CHECK(strstr(dal_stepper_error(stepper)->text, "converge") != NULL);
    CHECK(memcmp(before, dal_stepper_state(stepper), sizeof before) == 0);
    CHECK(reaction == UNTOUCHED);
    /* a sensible step goes on from there */
    memcpy(x, before, sizeof x);
    CHECK(dal_stepper_start(stepper, 0.0, 1e-3, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_advance(stepper, 10, NULL, NULL) == 0);
}

/* V = 10 (q ln q - q) for q > 0. */
static int logarithmic_potential(double t, const double *q, double *V_, double *V_q, double *V_qq,
                                 void *ctx)
{
    if (!(q[0] > 0.0)) return 1;
    if (V_) *V_ = 10.0 * (q[0] * log(q[0]) - q[0]);
    if (V_q) *V_q = 10.0 * log(q[0]);
    if (V_qq) *V_qq = 10.0 / q[0];
    return 0;
}

/* Midpoint with h = 2 from q = 1, v = 2: q' + 10 ln q' = 5.  From q' = 5 Newton's first step leads
 * to 5 - 10 ln(5)/3 < 0, where there is no V: half of it does not. */
static void test_halving(void)
{
    const double mass = 1.0, x0[2] = {1.0, 2.0};
    dal_system_def def = {.n = 1, .mass = &mass, .potential = logarithmic_potential};
    const dal_scheme midpoint = {.beta = 0.5};
    for (size_t i = 0; i < 3; i++) {
        def.force = i == 2 ? no_force_1 : NULL;
        dal_system *const system = new_system(&def);
        dal_stepper *const stepper = open_stepper_by(i == 1 ? BY_ANY_SIZES : BY_LIBRARY, system,
                                                     &midpoint);
        CHECK(dal_stepper_start(stepper, 0.0, 2.0, x0, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        CHECK(dal_step(stepper, NULL) == 0);
        const dal_stats stats = stats_of(stepper);
        CHECK(stats.halvings == 1 && stats.full_newtons == 1);
        const double *const x = dal_stepper_state(stepper);
        CHECK_NEAR(x[0] + 10.0 * log(x[0]), 5.0, 64 * DBL_EPSILON); /* of terms up to 5 */
        CHECK_NEAR(x[0], 1.0 + 2.0 + x[1], 8 * DBL_EPSILON);
        release(system);
    }
}

/* Steps far too long, on every system and by every scheme: whatever happens, the state that is
 * shown is finite, and a step that fails has not touched it. */
static void test_blow_up(way by)
{
    static const double lengths[] = {3.0, -40.0, 1e3, 1e60, -1e160, 1e300};
    size_t failures = 0;
    for (size_t s = 0; s < dal_builtin_count(); s++) {
        dal_system *system = open_system(dal_builtin_name(s));
        double x[2 * 7], before[2 * 7];
        const size_t bytes = 2 * dal_system_n(system) * sizeof *x;
        CHECK(bytes <= sizeof x);
        CHECK(dal_system_state(system, x) == 0);
        for (size_t i = 0; i < SCHEMES; i++) {
            dal_scheme scheme;
            CHECK(dal_scheme_find(&scheme, schemes[i], NULL) == 0);
            dal_stepper *const stepper = open_stepper_by(by, system, &scheme);
            const dal_initial initial = scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_D
                                                                       : DAL_INITIAL_NONE;
            for (size_t l = 0; l < sizeof lengths / sizeof lengths[0]; l++) {
                int status = dal_stepper_start(stepper, 0.0, lengths[l], x, DAL_CHECK, initial);
                for (int step = 0; step < 60 && !status; step++) {
                    memcpy(before, dal_stepper_state(stepper), bytes);
                    status = dal_step(stepper, NULL);
                    CHECK(dal__all_finite(bytes / sizeof *x, dal_stepper_state(stepper)));
                }
                if (!status) continue;
                failures++;
                CHECK(status == DAL_EDOMAIN || status == DAL_ENOCONV || status == DAL_ESINGULAR);
                CHECK(memcmp(before, dal_stepper_state(stepper), bytes) == 0);
                CHECK(has_number(dal_stepper_error(stepper)->text));
            }
            release(stepper);
        }
        release(system);
    }
    CHECK(failures > 0);
}

/* The endpoint scheme treats an oscillator as explicitly as a leapfrog: beyond h k^(1/2) = 2 the
 * state grows until it overflows. */
static void test_overflow(way by)
{
    dal_system *system = open_system("particle_oscillator");
    dal_scheme scheme;
    double x[6], before[6];
    int status = DAL_SUCCESS;
    size_t steps = 0;
    CHECK(dal_system_state(system, x) == 0);
    CHECK(dal_scheme_find(&scheme, "endpoint", NULL) == 0);
    dal_stepper *const stepper = open_stepper_by(by, system, &scheme);
    CHECK(dal_stepper_start(stepper, 0.0, 50.0, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    while (!status && steps < 100000) {
        memcpy(before, dal_stepper_state(stepper), sizeof before);
        status = dal_step(stepper, NULL);
        CHECK(dal__all_finite(6, dal_stepper_state(stepper)));
        steps++;
    }
    CHECK(status == DAL_EDOMAIN || status == DAL_ENOCONV || status == DAL_ESINGULAR);
    CHECK(steps >= 1);
    CHECK(memcmp(before, dal_stepper_state(stepper), sizeof before) == 0);
}

/* States and steps put together from the ends of the range of double: a success is finite, a
 * failure has changed nothing. */
static void test_extreme_numbers(void)
{
    static const double palette[] = {0.0, 1.0, -1.0, 4.9406564584124654e-324, 1e-308, 1e-160,
                                     -1e-20, 1e20, -1e100, 1e160, 1e200, -1e308, DBL_MAX};
    enum { COLOURS = sizeof palette / sizeof palette[0], TRIALS = 2000 };
    unsigned long state = 20240229;
#define NEXT (state = (state * 1103515245UL + 12345UL) & 0x7fffffffUL, \
              palette[(state >> 8) % COLOURS])
    const char *const names[] = {"generic4", "particle_oscillator", "robot", "free"};
    size_t successes = 0, steps = 0;
    for (size_t s = 0; s < sizeof names / sizeof names[0]; s++) {
        dal_system *system = open_any(names[s]);
        const size_t N = 2 * dal_system_n(system);
        dal_mechanics *const mechanics = open_mechanics(system);
        for (size_t trial = 0; trial < TRIALS; trial++) {
            double x0[MOST], x[MOST];
            for (size_t i = 0; i < N; i++) x0[i] = NEXT;
            const double shift = NEXT;
            memcpy(x, x0, sizeof x);
            int status = dal_project(mechanics, 0.0, trial % 2 ? shift : 0.0, x, NULL);
            successes += !status;
            CHECK(status ? memcmp(x, x0, N * sizeof *x) == 0 : dal__all_finite(N, x));
            memcpy(x, x0, sizeof x);
            const unsigned char keep[4] = {trial % 3 == 0, trial % 5 == 0, 0, 0};
            status = dal_consistent(mechanics, 0.0, keep, x, NULL);
            CHECK(status ? memcmp(x, x0, N * sizeof *x) == 0 : dal__all_finite(N, x));

            dal_scheme scheme;
            CHECK(dal_scheme_find(&scheme, schemes[trial % SCHEMES], NULL) == 0);
            dal_stepper *const stepper = open_stepper_by((way)(trial / SCHEMES % WAYS), system,
                                                         &scheme);
            const bool kept = scheme.nodes == DAL_KEPT_NODES;
            const dal_initial initial = kept ? (dal_initial)(1 + trial % 4) : DAL_INITIAL_NONE;
            status = dal_stepper_start(stepper, 0.0, NEXT, x0, (dal_consistency)(trial % 2 + 1),
                                       initial);
            for (int step = 0; step < 3 && !status; step++) {
                double before[MOST];
                memcpy(before, dal_stepper_state(stepper), N * sizeof *x);
                CHECK(dal__all_finite(N, before));
                status = dal_step(stepper, NULL);
                steps += !status;
                CHECK(status != DAL_EINVAL && status != DAL_EUSER);
                if (status) CHECK(memcmp(before, dal_stepper_state(stepper), N * sizeof *x) == 0);
                else CHECK(dal__all_finite(N, dal_stepper_state(stepper)));
            }
            release(stepper);
        }
        release(system);
    }
#undef NEXT
    CHECK(successes > 0 && steps > 0);
}

/* ---- sizes -------------------------------------------------------------------------------- */

static int any_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                          double *phi_q, double *phi_t, void *ctx)
{
    return 0;
}

static void test_sizes(void)
{
    const double mass[4] = {1.0, 0.0, 0.0, 1.0};
    const struct {
        size_t n, m;
        int status;
    } cases[] = {
        {0, 0, DAL_EINVAL},
        {0, 1, DAL_EINVAL},
        {2, 3, DAL_EINVAL},
        {2, SIZE_MAX, DAL_EINVAL},
        {2, SIZE_MAX / 8, DAL_EINVAL},
        {SIZE_MAX, 0, DAL_ENOMEM},
        {SIZE_MAX, SIZE_MAX - 1, DAL_ENOMEM},
        {SIZE_MAX / 2 + 1, 1, DAL_ENOMEM},
        {SIZE_MAX / 8, 0, DAL_ENOMEM},
        {SIZE_MAX / 8 + 1, 1, DAL_ENOMEM},          /* 8 n overflows to 0 */
        {(size_t)1 << (4 * sizeof(size_t)), 1, DAL_ENOMEM}, /* n n overflows to 0 */
        {((size_t)1 << (4 * sizeof(size_t))) + 1, 0, DAL_ENOMEM},
        {(size_t)1 << (4 * sizeof(size_t) - 2), 0, DAL_ENOMEM}, /* 8 n n exceeds PTRDIFF_MAX */
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const dal_system_def def = {.n = cases[i].n, .m = cases[i].m, .mass = mass,
                                    .constraint = cases[i].m ? any_constraint : NULL};
        dal_system *system = NULL;
        dal_error error;
        CHECK(dal_system_new(&system, &def, &error) == cases[i].status);
        CHECK(error.status == cases[i].status && has_number(error.text) && system == NULL);
    }
    /* what is missing or superfluous */
    dal_system *system = NULL;
    dal_error error;
    const dal_system_def defs[] = {
        {.n = 2},
        {.n = 2, .m = 1, .mass = mass},
        {.n = 2, .mass = mass, .constraint = any_constraint},
        {.n = 2, .mass = mass, .missing = 64},
        {.n = 2, .m = 1, .mass = mass, .constraint = any_constraint,
         .kind = (dal_constraint_kind)7},
        {.n = 2, .mass = mass, .invariants = 1},
        {.n = 2, .mass = mass, .state = (const double[4]){0.0, NAN, 0.0, 0.0}},
    };
    for (size_t i = 0; i < sizeof defs / sizeof defs[0]; i++) {
        CHECK(dal_system_new(&system, &defs[i], &error) == DAL_EINVAL);
        CHECK(error.text[0] != '\0' && system == NULL);
    }
}

static void test_bad_records(void)
{
    const dal_substep not_one[] = {{0.5, 0.5}, {0.5, 0.25}}, no_beta[] = {{1.5, 1.0}};
    const dal_substep none[] = {{0.5, 0.0}, {0.5, 1.0}}, infinite[] = {{0.5, INFINITY}};
    const dal_substep two[] = {{0.5, 0.5}, {0.5, 0.5}};
    const dal_scheme records[] = {
        {.beta = -0.1}, {.beta = 1.1}, {.beta = NAN}, {.count = 2},
        {.count = 2, .substeps = not_one}, {.count = 1, .substeps = no_beta},
        {.count = 2, .substeps = none}, {.count = 1, .substeps = infinite},
        {.count = 2, .substeps = two, .nodes = DAL_KEPT_NODES}, {.nodes = (dal_nodes)3},
    };
    const dal_options options = {.max_iterations = -5};
    dal_system *system = open_system("particle");
    dal_stepper *stepper = NULL;
    dal_scheme scheme = {.beta = 0.5};
    dal_error error;
    for (size_t i = 0; i < sizeof records / sizeof records[0]; i++) {
        CHECK(dal_stepper_new(&stepper, system, &records[i], NULL, &error) == DAL_EINVAL);
        CHECK(error.text[0] != '\0' && stepper == NULL);
    }
    CHECK(dal_stepper_new(&stepper, system, &scheme, &options, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "-5") != NULL && stepper == NULL);
}

/* ---- NULL --------------------------------------------------------------------------------- */

static void test_null_system(dal_system *system, const double *x)
{
    const char *const names[1] = {NULL};
    static const double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const dal_system_def def = {.n = 3, .mass = unit};
    const double value = 1.0;
    dal_system *none = NULL;
    double out[MOST];
    fill(MOST, out, UNTOUCHED);
    CHECK(dal_system_new(NULL, &def, NULL) == DAL_EINVAL);
    CHECK(dal_system_new(&none, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_system_builtin(NULL, "particle", NULL, NULL, 0, NULL) == DAL_EINVAL);
    CHECK(dal_system_builtin(&none, NULL, NULL, NULL, 0, NULL) == DAL_EINVAL);
    CHECK(dal_system_builtin(&none, "disk", NULL, &value, 1, NULL) == DAL_EINVAL);
    CHECK(dal_system_builtin(&none, "disk", names, NULL, 1, NULL) == DAL_EINVAL);
    CHECK(dal_system_builtin(&none, "disk", names, &value, 1, NULL) == DAL_EINVAL);
    CHECK(none == NULL);
    CHECK(dal_system_state(NULL, out) == DAL_EINVAL);
    CHECK(dal_system_state(system, NULL) == DAL_EINVAL);
    CHECK(dal_system_exact(NULL, 1.0, x, out) == DAL_EINVAL);
    CHECK(dal_system_exact(system, 1.0, NULL, out) == DAL_EINVAL);
    CHECK(dal_system_exact(system, 1.0, x, NULL) == DAL_EINVAL);
    CHECK(dal_system_invariant(NULL, 0.0, x, out) == DAL_EINVAL);
    CHECK(dal_system_invariant(system, 0.0, NULL, out) == DAL_EINVAL);
    CHECK(dal_system_invariant(system, 0.0, x, NULL) == DAL_EINVAL);
    CHECK(all_are(MOST, out, UNTOUCHED));
    dal_system_free(NULL);
}

static void test_null_mechanics(const dal_system *system, const double *x0)
{
    dal_mechanics *mechanics = NULL;
    double x[MOST], out[MOST];
    size_t done = 99;
    memcpy(x, x0, 6 * sizeof *x);
    fill(MOST, out, UNTOUCHED);
    CHECK(dal_mechanics_new(NULL, system, NULL) == DAL_EINVAL);
    CHECK(dal_mechanics_new(&mechanics, NULL, NULL) == DAL_EINVAL && mechanics == NULL);
    mechanics = open_mechanics(system);
    dal_mechanics *const mech = mechanics;
    static int (*const of_state[])(dal_mechanics *, double, const double *, double *) = {
        dal_energy, dal_gram, dal_multipliers, dal_acceleration, dal_field};
    for (size_t k = 0; k < DAL_LENGTH(of_state); k++) {
        CHECK(of_state[k](NULL, 0.0, x, out) == DAL_EINVAL);
        CHECK(of_state[k](mech, 0.0, NULL, out) == DAL_EINVAL);
        CHECK(of_state[k](mech, 0.0, x, NULL) == DAL_EINVAL);
    }
    static int (*const residuals[])(dal_mechanics *, double, double, const double *, double *) = {
        dal_residual, dal_relative_residual};
    for (size_t k = 0; k < DAL_LENGTH(residuals); k++) {
        CHECK(residuals[k](NULL, 0.0, 0.0, x, out) == DAL_EINVAL);
        CHECK(residuals[k](mech, 0.0, 0.0, NULL, out) == DAL_EINVAL);
        CHECK(residuals[k](mech, 0.0, 0.0, x, NULL) == DAL_EINVAL);
    }
    CHECK(dal_residual(mech, 0.0, NAN, x, out) == DAL_EINVAL);
    CHECK(dal_project(NULL, 0.0, 0.0, x, out) == DAL_EINVAL);
    CHECK(dal_project(mech, 0.0, 0.0, NULL, out) == DAL_EINVAL);
    CHECK(dal_project(mech, 0.0, INFINITY, x, out) == DAL_EINVAL);
    CHECK(dal_consistent(NULL, 0.0, NULL, x, out) == DAL_EINVAL);
    CHECK(dal_consistent(mech, 0.0, NULL, NULL, out) == DAL_EINVAL);
    CHECK(dal_consistent(mech, 0.0, (const unsigned char[3]){1, 0, 0}, NULL, out) == DAL_EINVAL);
    CHECK(dal_step_equations(NULL, 0.0, 0.5, h, x, x, x, out, NULL, NULL, NULL, NULL)
          == DAL_EINVAL);
    CHECK(dal_step_equations(mech, 0.0, 0.5, h, NULL, x, x, out, NULL, NULL, NULL, NULL)
          == DAL_EINVAL);
    CHECK(dal_step_equations(mech, 0.0, 0.5, h, x, NULL, x, out, NULL, NULL, NULL, NULL)
          == DAL_EINVAL);
    CHECK(dal_step_equations(mech, 0.0, 0.5, h, x, x, NULL, out, NULL, NULL, NULL, NULL)
          == DAL_EINVAL);
    CHECK(dal_step_equations(mech, 0.0, NAN, h, x, x, x, out, NULL, NULL, NULL, NULL)
          == DAL_EINVAL);
    CHECK(dal_step_equations(mech, 0.0, 0.5, h, x, x, x, NULL, NULL, NULL, NULL, NULL) == 0);
    CHECK(dal_trajectory(NULL, 0.0, h, 0.0, 1, x, NULL, out, NULL, NULL, NULL,
                         &done) == DAL_EINVAL);
    CHECK(dal_trajectory(mech, 0.0, h, 0.0, 1, NULL, NULL, out, NULL, NULL, NULL,
                         &done) == DAL_EINVAL);
    CHECK(dal_trajectory(mech, 0.0, h, NAN, 1, x, NULL, out, NULL, out, NULL, &done) == DAL_EINVAL);
    CHECK(done == 0);
    CHECK(dal_trajectory(mech, 0.0, h, 0.0, 0, NULL, NULL, NULL, NULL, NULL, NULL, NULL) == 0);
    CHECK(memcmp(x, x0, 6 * sizeof *x) == 0 && all_are(MOST, out, UNTOUCHED));
    dal_mechanics_free(NULL);
}

static void test_null_flow(const dal_system *system, double *x)
{
    dal_flow *flow = NULL;
    size_t done = 99;
    CHECK(dal_flow_new(NULL, system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-6, NULL) == DAL_EINVAL);
    CHECK(dal_flow_new(&flow, NULL, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-6, NULL)
          == DAL_EINVAL && flow == NULL);
    flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-6);
    CHECK(dal_flow_apply(NULL, 0.0, 1.0, x, NULL) == DAL_EINVAL);
    CHECK(dal_flow_apply(flow, 0.0, 1.0, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_flow_trajectory(NULL, 0.0, h, 1, x, &done) == DAL_EINVAL && done == 0);
    CHECK(dal_flow_trajectory(flow, 0.0, h, 1, NULL, NULL) == DAL_EINVAL);
    dal_flow_free(NULL);
}

static void test_null_stepper(const dal_system *system, const double *x)
{
    dal_stepper *stepper = NULL;
    dal_scheme scheme;
    double shift = UNTOUCHED, reaction = UNTOUCHED;
    size_t done = 99;
    CHECK(dal_scheme_find(NULL, "leapfrog", NULL) == DAL_EINVAL);
    CHECK(dal_scheme_find(&scheme, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_scheme_at(NULL, 0) == DAL_EINVAL);
    CHECK(dal_scheme_at(&scheme, dal_scheme_count()) == DAL_EINVAL);
    CHECK(dal_scheme_find(&scheme, "leapfrog", NULL) == 0);
    CHECK(dal_scheme_shift(NULL, &shift) == DAL_EINVAL);
    CHECK(dal_scheme_shift(&scheme, NULL) == DAL_EINVAL);
    CHECK(dal_scheme_shift(&scheme, &shift) == DAL_EUNSUPPORTED && shift == UNTOUCHED);
    CHECK(dal_stepper_new(NULL, system, &scheme, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_stepper_new(&stepper, NULL, &scheme, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_stepper_new(&stepper, system, NULL, NULL, NULL) == DAL_EINVAL && stepper == NULL);
    stepper = open_stepper(system, &scheme, NULL);
    CHECK(dal_stepper_start(NULL, 0.0, h, x, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EINVAL);
    CHECK(dal_stepper_start(stepper, 0.0, h, NULL, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EINVAL);
    CHECK(dal_step(NULL, &reaction) == DAL_EINVAL);
    CHECK(dal_advance(NULL, 1, &reaction, &done) == DAL_EINVAL && done == 0);
    done = 99;
    CHECK(dal_integrate(NULL, 1, 1, NULL, NULL, NULL, NULL, &done) == DAL_EINVAL && done == 0);
    /* not started */
    CHECK(dal_step(stepper, &reaction) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(stepper)->text, "not started") != NULL);
    CHECK(dal_advance(stepper, 3, &reaction, NULL) == DAL_EINVAL);
    CHECK(dal_integrate(stepper, 1, 1, NULL, &reaction, NULL, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_stepper_start(stepper, 0.0, h, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_integrate(stepper, 3, 2, NULL, &reaction, NULL, NULL, NULL) == DAL_EINVAL);
    CHECK(has_number(dal_stepper_error(stepper)->text));
    CHECK(dal_integrate(stepper, 3, 0, NULL, &reaction, NULL, NULL, NULL) == DAL_EINVAL);
    CHECK(reaction == UNTOUCHED);
    dal_stepper_free(NULL);
}

static void test_null_study(const dal_system *system, const double *x)
{
    const size_t steps[2] = {4, 0};
    const dal_order_def good = {.t_end = 1.0, .x0 = x, .steps = steps, .count = 1};
    dal_order_def bad[10];
    dal_order_point point;
    dal_order order;
    dal_scheme scheme;
    dal_error error;
    CHECK(dal_scheme_find(&scheme, "leapfrog", NULL) == 0);
    CHECK(dal_order_study(NULL, &scheme, &good, &point, &order, NULL) == DAL_EINVAL);
    CHECK(dal_order_study(system, NULL, &good, &point, &order, NULL) == DAL_EINVAL);
    CHECK(dal_order_study(system, &scheme, NULL, &point, &order, NULL) == DAL_EINVAL);
    CHECK(dal_order_study(system, &scheme, &good, NULL, &order, NULL) == DAL_EINVAL);
    CHECK(dal_order_study(system, &scheme, &good, &point, NULL, NULL) == DAL_EINVAL);
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) bad[i] = good;
    bad[0].x0 = NULL;
    bad[1].steps = NULL;
    bad[2].count = 0;
    bad[3].count = 2;
    bad[4].t_end = bad[4].t0;
    bad[5].t_end = NAN;
    bad[6].tolerance = -1.0;
    bad[7].tolerance = NAN;
    bad[8].initial = DAL_INITIAL_D;
    bad[9].x0 = (const double[6]){NAN};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        CHECK(dal_order_study(system, &scheme, &bad[i], &point, &order, &error) == DAL_EINVAL);
        CHECK(error.status == DAL_EINVAL && error.text[0] != '\0');
    }
}

static void test_null(void)
{
    double x[MOST];
    dal_system *system = open_system("particle");
    CHECK(dal_system_state(system, x) == 0);
    test_null_system(system, x);
    test_null_mechanics(system, x);
    test_null_flow(system, x);
    test_null_stepper(system, x);
    test_null_study(system, x);
    for (int status = -20; status <= 20; status++) CHECK(dal_strerror(status) != NULL);
}

/* ---- outputs that overflow -------------------------------------------------------------- */

enum { OVERFLOWN = 400 };

/* What the functions below are asked with, and where their answers go; some change x in place. */
typedef struct huge {
    dal_mechanics *mech;
    dal_chart *chart;
    dal_discrete *discrete;
    size_t n, m;
    double t, h, shift, x[16], y[16], w[8], kappa[8], ghat[16], *out;
} huge;

typedef int (*huge_fn)(huge *a);

/* ASK(name, call) for each function. */
#define EACH_HUGE(ASK) \
    ASK(energy, dal_energy(a->mech, 0.0, a->x, a->out)) \
    ASK(power, dal_power(a->mech, a->t, a->x, a->out, a->out + 1)) \
    ASK(metric, dal_metric(a->mech, 0.0, a->x, a->out)) \
    ASK(residual, dal_residual(a->mech, 0.0, a->shift, a->x, a->out)) \
    ASK(relative, dal_relative_residual(a->mech, 0.0, a->shift, a->x, a->out)) \
    ASK(gram, dal_gram(a->mech, 0.0, a->x, a->out)) \
    ASK(multipliers, dal_multipliers(a->mech, a->t, a->x, a->out)) \
    ASK(acceleration, dal_acceleration(a->mech, a->t, a->x, a->out)) \
    ASK(field, dal_field(a->mech, a->t, a->x, a->out)) \
    ASK(perturbed, dal_perturbed(a->mech, a->t, a->h, a->x, a->ghat, a->out, a->out + 16)) \
    ASK(project, dal_project(a->mech, 0.0, a->shift, a->x, a->out)) \
    ASK(consistent, dal_consistent(a->mech, 0.0, NULL, a->x, a->out)) \
    ASK(equations, dal_step_equations(a->mech, a->t, 0.25, a->h, a->x, a->w, a->kappa, a->out, \
        a->out + 8, a->out + 16, a->out + 80, a->out + 120)) \
    ASK(trajectory, dal_trajectory(a->mech, a->t, a->h, a->shift, 1, a->x, NULL, a->out, \
        a->out + 1, a->out + 9, a->out + 17, NULL)) \
    ASK(condition, dal_chart_condition(a->chart, 0.0, a->x, a->out)) \
    ASK(renew, dal_chart_renew(a->chart, 0.0, a->x, NULL)) \
    ASK(connection, dal_chart_connection(a->chart, 0.0, a->x, a->out, a->out + 64)) \
    ASK(split, dal_chart_split(a->chart, 0.0, a->x, a->out, a->out + 8)) \
    ASK(lift, dal_chart_lift(a->chart, 0.0, a->x, a->out)) \
    ASK(drop, dal_chart_drop(a->chart, a->x, a->out)) \
    ASK(jacobian, dal_chart_jacobian(a->chart, 0.0, a->x, a->out, a->out + 200)) \
    ASK(chart_field, dal_chart_field(a->chart, a->t, a->x, a->out)) \
    ASK(connected, dal_chart_multipliers(a->chart, 0.0, a->x, a->kappa, a->out)) \
    ASK(disconnected, dal_chart_multipliers_back(a->chart, 0.0, a->x, a->kappa, a->out)) \
    ASK(chart_step, dal_chart_step(a->chart, a->t, 0.5, a->h, a->x, a->out)) \
    ASK(curve, dal_chart_curve(a->chart, 0.0, a->x, a->y, 0.4, a->out)) \
    ASK(state, dal_discrete_state(a->discrete, a->h, a->x, a->y, a->out)) \
    ASK(nodes, dal_discrete_nodes(a->discrete, 0.0, a->h, a->x, a->out, a->out + 8)) \
    ASK(lagrangian, \
        dal_discrete_lagrangian(a->discrete, 0.0, a->h, a->x, a->y, a->out, a->out + 1, \
        a->out + 9, a->out + 17)) \
    ASK(constraint, \
        dal_discrete_constraint(a->discrete, 0.0, a->h, a->x, a->y, a->out, a->out + 8, \
        a->out + 72)) \
    ASK(momenta, dal_discrete_momenta(a->discrete, a->t, a->h, a->x, a->y, a->out, a->out + 8)) \
    ASK(momentum, dal_discrete_momentum(a->discrete, a->t, a->h, a->x, a->y, a->w, a->ghat, \
        a->out, a->out + 1)) \
    ASK(discrete_residual, dal_discrete_residual(a->discrete, a->t, a->h, a->x, a->y, a->w, \
        a->kappa, a->out)) \
    ASK(regularity, dal_discrete_regularity(a->discrete, a->t, a->h, a->x, a->y, a->out, NULL, \
        NULL, NULL)) \
    ASK(node_step, dal_discrete_step(a->discrete, a->t, a->h, a->x, a->y, a->out)) \
    ASK(advance, dal_discrete_advance(a->discrete, a->t, a->h, a->x, a->out)) \
    ASK(exact, dal_system_exact(a->mech->eval.system, a->t, a->x, a->out)) \
    ASK(invariant, dal_system_invariant(a->mech->eval.system, 0.0, a->x, a->out))

#define FUNCTION(name, call) static int huge_##name(huge *a) { return call; }
EACH_HUGE(FUNCTION)
#undef FUNCTION

static const struct {
    const char *name;
    huge_fn ask;
} huge_questions[] = {
#define ROW(name, call) {#name, huge_##name},
    EACH_HUGE(ROW)
#undef ROW
};

/* Of any size up to the largest; small ones and zeros too. */
static double draw_huge(uint64_t *random)
{
    *random = *random * 6364136223846793005u + 1442695040888963407u;
    const double kind = (double)(*random >> 11) * 0x1p-53;
    *random = *random * 6364136223846793005u + 1442695040888963407u;
    const double r = 2.0 * (double)(*random >> 11) * 0x1p-53 - 1.0;
    if (kind < 0.4) return r;
    if (kind < 0.45) return 0.0;
    if (kind < 0.5) return copysign(DBL_MAX, r);
    return copysign(pow(10.0, 308.0 * fabs(r)), kind - 0.75);
}

static void fill_huge(uint64_t *random, size_t count, double *values)
{
    for (size_t i = 0; i < count; i++) values[i] = draw_huge(random);
}

/* Whatever finite numbers go in: success means that finite numbers come out; a failure has a text,
 * and the outputs are as they were. */
static void test_overflown(const char *name)
{
    dal_system *system = open_any(name);
    huge a = {.n = dal_system_n(system), .m = dal_system_m(system)};
    const dal_difference_map lagrangian = {.beta = 0.3}, constraint = {.beta = 0.6};
    double out[OVERFLOWN], x0[16];
    CHECK(dal_system_state(system, x0) == 0);
    a.mech = open_mechanics(system);
    a.chart = open_chart(system);
    a.discrete = open_discrete(system, lagrangian, &constraint);
    a.out = out;
    for (uint64_t seed = 0; seed < 300; seed++)
        for (size_t k = 0; k < DAL_LENGTH(huge_questions); k++) {
            uint64_t random = seed * 1000003u + k;
            a.t = draw_huge(&random), a.h = draw_huge(&random), a.shift = draw_huge(&random);
            memcpy(a.x, x0, sizeof a.x);
            memcpy(a.y, x0, sizeof a.y);
            const double which = draw_huge(&random);
            if (which < 0.3) fill_huge(&random, a.n, a.x); /* else v, or both */
            if (which > -0.3) fill_huge(&random, a.n, a.x + a.n);
            fill_huge(&random, 2 * a.n, a.y);
            fill_huge(&random, a.n, a.w);
            fill_huge(&random, a.m, a.kappa);
            fill_huge(&random, 2 * a.n, a.ghat);
            CHECK(dal_chart_choose(a.chart, 0.0, NULL, x0) == 0);
            fill(OVERFLOWN, out, UNTOUCHED);
            const huge before = a;
            const int status = huge_questions[k].ask(&a);
            bool sound = dal__all_finite(2 * a.n, a.x) && dal__all_finite(OVERFLOWN, out);
            for (size_t i = 0; status && i < OVERFLOWN; i++) sound = sound && out[i] == UNTOUCHED;
            if (status) sound = sound && memcmp(&a, &before, sizeof a) == 0;
            CHECK(sound);
            if (!sound)
                fprintf(stderr, "%s of %s, seed %d: status %d\n", huge_questions[k].name, name,
                        (int)seed, status);
        }
}

int main(void)
{
    gsl_set_error_handler(abort_on_gsl_error);
    test_null();
    test_sizes();
    test_bad_records();
    test_bad_mass();
    test_singular_constraints();
    test_singular_step();
    test_halving();
    test_nothing_written();
    test_exact_and_invariants();
    test_disturbed_mechanics(0);
    test_disturbed_mechanics(DAL_MISSING_V_Q | DAL_MISSING_V_QQ | DAL_MISSING_PHI_Q);
    test_disturbed_mechanics(DAL_MISSING_V_QQ);
    test_disturbed_rows();
    test_observer();
    test_disturbed_stride();
    for (size_t i = 0; i < SCHEMES; i++) test_disturbed_integration("generic4", schemes[i]);
    for (way by = 0; by < WAYS; by++) {
        /* every call; of the many that hybridsj makes a part */
        const size_t every = by == BY_MULTIROOT ? 7 : 1;
        test_disturbed_steps("particle", 0, by, every);
        test_disturbed_steps("particle_oscillator", 0, by, every);
        test_disturbed_steps("generic4", 0, by, every);
        test_disturbed_steps("free", 0, by, every);
        test_refused_start(by);
        test_divergence(by);
        test_blow_up(by);
        test_overflow(by);
    }
    test_disturbed_steps("generic4", DAL_MISSING_V_Q | DAL_MISSING_V_QQ | DAL_MISSING_PHI_Q,
                         BY_LIBRARY, 7);
    test_extreme_numbers();
    static const char *const systems[] = {"particle", "sleigh_contact", "ball_on_table",
                                          "generic4"};
    for (size_t i = 0; i < DAL_LENGTH(systems); i++) test_overflown(systems[i]);
    test_disturbed_flow(DAL_FLOW_RK8PD, 1);
    test_disturbed_flow(DAL_FLOW_MSADAMS, 5);
    test_disturbed_flow(DAL_FLOW_RODAS, 7);
    test_disturbed_study("leapfrog", 3);
    test_disturbed_study("midpoint", 5);
    return check_done();
}
