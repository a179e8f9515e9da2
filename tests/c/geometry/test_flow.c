/* The reference flow against end states known to 40 digits, and what it does when it fails. */
#include "fixtures.h"
#include "check.h"

#include <gsl/gsl_errno.h>

#include <stdlib.h>

enum { MOST = 8 }; /* 2n of every system here */

static double distance(size_t count, const double *x, const double *y)
{
    double most = 0.0;
    for (size_t i = 0; i < count; i++) most = fmax(most, fabs(x[i] - y[i]));
    return most;
}

/* A system, and its default state. */
static dal_system *open_with_state(const char *name, double *x)
{
    dal_system *const system = open_system(name);
    CHECK(dal_system_state(system, x) == 0);
    return system;
}

/* ---- accuracy --------------------------------------------------------------------------- */

/* (q, v) at t from the default initial data: Taylor series in 60 digits. */
static const struct reference {
    const char *system;
    double t;
    double x[MOST];
} references[] = {
    {"particle", 1, {1.3735561649080223, 1.0, 0.3521175800333429,
                     0.73824115301167, 0.7, 0.73824115301167}},
    {"particle", 10, {4.064629556214217, 7.3, 9.232286200838644,
                      0.14169460933113004, 0.7, 1.0343706481172494}},
    {"particle_oscillator", 1, {1.1439959959416228, 0.5357023074752382, 0.1100712766705667,
                                0.23832643131642248, -0.3099130128462029, 0.1276720191885464}},
    {"particle_oscillator", 10, {0.6546678706556645, 0.49347803828297676, -0.06399666757520531,
                                 -0.8810431038781765, -0.42773689514089125, -0.4347754225445475}},
    {"knife_edge", 1, {0.8651718647289546, 1.1234192704979873, 1.4,
                       0.36358110591014764, 2.108000973213705, 1.2}},
    {"knife_edge", 10, {0.03717424560897144, 10.879342265446859, 12.2,
                        -0.6163900143482525, 0.23650492226720837, 1.2}},
    {"sleigh", 1, {0.002867684296890628, 0.5304690164223095, 1.2127750752191182,
                   -0.11365446998042633, 0.613317767595246, 0.8034192290673797}},
    {"sleigh", 10, {-6.585181179260977, 2.996724547912102, 3.055700793331697,
                    -0.8535355900954138, 0.06883775710444374, 0.011594150246734084}},
    {"disk", 1, {0.49120853243730855, 0.5591587414903213, 1.2, 1.3,
                 0.2059740980409323, 0.7419398027712386, 1.1, 0.9}},
    {"disk", 10, {-0.3119722733095279, 1.643311786388145, 11.1, 9.4,
                  -0.769763642367109, 0.019077077599085755, 1.1, 0.9}},
    {"heisenberg", 1, {0.6645571576008581, 0.39182793591424186, 0.32578351584557813,
                       -0.5529995954769378, -0.19142201509668547, 0.08946981980225739}},
    {"heisenberg", 10, {-0.7387746750636096, -0.05478366888033176, -0.7585748207022781,
                        0.20408203001140934, -0.44147463226948397, 0.33733064036028554}},
    {"generic4", 1, {0.2625443845814668, 0.35860290101218156, 0.15549855954341574,
                     -0.04349780210580245, -0.03301031336766506, 0.4917747198524348,
                     -0.2034374499238544, -0.6047385688062604}},
    {"generic4", 10, {0.25178565003731523, -0.191920552440453, 0.5284525103313278,
                      -0.016126714604329098, -0.11437694097625344, 0.28287985921159464,
                      0.0873345206605238, 0.6830740371106078}},
};

/* q'' = a force, of which the motion from (0, 1) is known. */
typedef enum push { SPRING, GRAVITY, STEP, PULSE, WAVE } push;

static int pushing(double t, const double *q, const double *v, const double *u, double *f,
                   double *f_q, double *f_v, void *ctx)
{
    (void)v, (void)f_q, (void)f_v;
    switch (*(const push *)ctx) {
    case SPRING: f[0] = -q[0]; break;
    case GRAVITY: f[0] = 1.0; break;
    case STEP: f[0] = t > 1e-3; break;
    case PULSE: f[0] = exp(-25.0 * (t - 5.0) * (t - 5.0)); break;
    case WAVE: f[0] = cos(t); break;
    }
    return 0;
}

static void pushed(push by, double t0, double t1, double *x)
{
    const double T = t1 - t0, late = T - 1e-3, c = 5.0 * (t1 - 5.0), root = sqrt(acos(-1.0));
    switch (by) {
    case SPRING: x[0] = sin(T), x[1] = cos(T); break;
    case GRAVITY: x[0] = T + 0.5 * T * T, x[1] = 1.0 + T; break;
    case STEP: x[0] = T + 0.5 * late * late, x[1] = 1.0 + late; break;
    case PULSE:
        x[1] = 1.0 + root / 10.0 * (erf(c) + 1.0);
        x[0] = T + root / 50.0 * (c * (erf(c) + 1.0) + exp(-c * c) / root);
        break;
    case WAVE:
        x[1] = 1.0 + sin(t1) - sin(t0);
        x[0] = (1.0 - sin(t0)) * T - cos(t1) + cos(t0);
        break;
    }
}

/* The result is never farther from the truth than ten times what is claimed, also where both
 * integrations could take the same few steps. */
static void test_claims(void)
{
    static const struct {
        push by;
        double t0, t1;
    } cases[] = {{SPRING, 0.0, 1e-9}, {SPRING, 0.0, 0.05}, {SPRING, 0.0, 0.2}, {SPRING, 0.0, 0.5},
                 {SPRING, 0.0, -3.0}, {SPRING, 0.0, 1e3}, {GRAVITY, 0.0, 10.0},
                 {GRAVITY, 0.0, 1e4}, {GRAVITY, 0.0, 0.1}, {GRAVITY, 0.0, 1e-3},
                 {STEP, 0.0, 10.0}, {PULSE, 0.0, 10.0}, {PULSE, -6.0, 16.0},
                 {PULSE, -20.0, 25.0}, {WAVE, 1e8, 1e8 + 10.0}, {WAVE, 3e9, 3e9 + 1.0},
                 {WAVE, -1e8, -1e8 + 1e-6}};
    static const double mass[1] = {1.0};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        push by = cases[i].by;
        const dal_system_def def = {.n = 1, .mass = mass, .force = pushing, .ctx = &by,
                                    .missing = DAL_MISSING_F_Q | DAL_MISSING_F_V};
        double exact[2] = {0};
        dal_system *const system = new_system(&def);
        pushed(by, cases[i].t0, cases[i].t1, exact);
        for (dal_flow_method method = DAL_FLOW_RK8PD; method <= DAL_FLOW_RODAS; method++)
            for (int digits = 4; digits <= (brief() ? 4 : 10); digits += 3) {
                if (method == DAL_FLOW_MSADAMS && by >= STEP) continue; /* see the header */
                double x[2] = {0.0, 1.0}, accuracy;
                dal_flow *flow = open_flow(system, method, DAL_FLOW_X, pow(10.0, -digits));
                CHECK(dal_flow_apply(flow, cases[i].t0, cases[i].t1, x, &accuracy) == 0);
                CHECK_NEAR(distance(2, x, exact), 0.0, 10.0 * accuracy);
                /* what rounds the state, and moves the time by an ulp */
                const double least = 4.0 * fmax(fabs(x[0]), fabs(x[1]))
                                   + fabs(cases[i].t1 * x[1]);
                CHECK(accuracy >= DAL_ROUNDOFF * least);
                const double span = fabs(cases[i].t1 - cases[i].t0);
                const double most = 1e3 * pow(10.0, -digits) * (1.0 + fabs(x[0])) * (1.0 + span)
                                  + 10.0 * DAL_ROUNDOFF * fabs(cases[i].t0);
                CHECK(accuracy <= most || by == PULSE); /* that one of the two may have missed */
                CHECK(accuracy <= 100 * DAL_ROUNDOFF || span > 1e-9 || cases[i].t0 != 0.0);
                release(flow);
            }
        release(system);
    }
}

/* A method may make an error of its tolerance in every step, and the dynamics lets errors grow:
 * share is the number of such errors a unit of time.  rk8pd takes 1 to 5 steps a unit, most of
 * them far better than they have to be; the multistep methods, which start with order 1, take 50 to
 * 200. */
static void test_reference(dal_flow_method method, double tolerance, double share)
{
    for (size_t i = 0; i < sizeof references / sizeof references[0]; i++) {
        const struct reference *const r = &references[i];
        double x0[MOST], x[MOST], back[MOST], accuracy, residual;
        dal_system *system = open_with_state(r->system, x0);
        const size_t n = dal_system_n(system);
        dal_flow *flow = open_flow(system, method, DAL_FLOW_X, tolerance);

        memcpy(x, x0, sizeof x);
        CHECK(dal_flow_apply(flow, 0.0, r->t, x, &accuracy) == 0);
        CHECK_NEAR(distance(2 * n, x, r->x), 0.0, share * tolerance * r->t);
        /* The estimate is the error of a run ten times as loose; or, where that has to take shorter
         * steps and is the better one, that of this run. */
        CHECK(2.0 * accuracy >= distance(2 * n, x, r->x));
        CHECK(accuracy <= 10 * share * tolerance * r->t);

        dal_mechanics *const mechanics = open_mechanics(system);
        CHECK(dal_relative_residual(mechanics, 0.0, 0.0, x, &residual) == 0);
        CHECK(residual <= DAL_RESIDUAL_BOUND(n));

        memcpy(back, x, sizeof back);
        CHECK(dal_flow_apply(flow, r->t, 0.0, back, NULL) == 0);
        CHECK_NEAR(distance(2 * n, back, x0), 0.0, 10 * share * tolerance * r->t);
        CHECK(dal_flow_error(flow)->text[0] == '\0');

        release(system);
    }
}

/* Over 1e-12 the state moves by h f(x) and h^2 more: the smallest intervals lose nothing, whatever
 * the clock shows. */
static void test_small_intervals(dal_flow_method method)
{
    double x0[MOST], x[MOST], slope[MOST], accuracy;
    dal_system *system = open_with_state("generic4", x0);
    dal_flow *flow = open_flow(system, method, DAL_FLOW_X, 1e-13);
    dal_mechanics *const mechanics = open_mechanics(system);
    CHECK(dal_field(mechanics, 0.0, x0, slope) == 0);
    for (int sign = -1; sign <= 1; sign += 2) {
        const double h = sign * 1e-12;
        memcpy(x, x0, sizeof x);
        CHECK(dal_flow_apply(flow, 0.0, h, x, &accuracy) == 0);
        for (size_t i = 0; i < 8; i++)
            CHECK_NEAR(x[i], x0[i] + h * slope[i], 8 * DBL_EPSILON); /* some roundings of x <= 1 */
    }
    const double later = 1e3 + 1e-12; /* some ten ulps after 1e3 */
    memcpy(x, x0, sizeof x);
    CHECK(dal_flow_apply(flow, 1e3, later, x, NULL) == 0);
    for (size_t i = 0; i < 8; i++)
        CHECK_NEAR(x[i], x0[i] + (later - 1e3) * slope[i], 8 * DBL_EPSILON);
    memcpy(x, x0, sizeof x);
    CHECK(dal_flow_apply(flow, 2.5, 2.5, x, &accuracy) == 0);
    CHECK(accuracy == 0.0 && memcmp(x, x0, sizeof x) == 0);
}

/* Off D the field is defined by the same formula and keeps mu v; dal__flow_apply without the
 * projection shows it, with the projection the end lies in D. */
static void test_off_D(void)
{
    double x[MOST], projected[MOST], rows[4 * MOST], before[2], after[2], residual[2];
    dal_system *system = open_with_state("generic4", x);
    dal_flow *flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-13);
    dal_mechanics *const mechanics = open_mechanics(system);
    x[4] += 0.25;
    memcpy(projected, x, sizeof x);
    memcpy(rows, x, sizeof x);
    CHECK(dal_residual(mechanics, 0.0, 0.0, x, before) == 0);
    CHECK(fabs(before[0]) > 0.1);
    CHECK(dal_flow_apply(flow, 1.0, 1.0, x, NULL) == 0); /* over no time nothing is projected */
    CHECK(memcmp(x, projected, sizeof x) == 0);
    CHECK(dal__flow_apply(flow, 0.0, 9.0, x, false) == 0);
    CHECK(dal_residual(mechanics, 0.0, 0.0, x, after) == 0);
    CHECK_NEAR(distance(2, before, after), 0.0, 1e-11);
    CHECK(dal__flow_apply(flow, 0.0, 9.0, projected, true) == 0);
    CHECK(dal_residual(mechanics, 0.0, 0.0, projected, residual) == 0);
    CHECK_NEAR(distance(2, residual, (double[2]){0.0, 0.0}), 0.0, 64 * DBL_EPSILON);
    CHECK(dal_project(mechanics, 0.0, 0.0, x, NULL) == 0);
    CHECK_NEAR(distance(8, x, projected), 0.0, 1e-10); /* nor before the end */
    CHECK(dal_flow_trajectory(flow, 0.0, 3.0, 3, rows, NULL) == 0);
    CHECK_NEAR(distance(8, rows + 3 * 8, projected), 0.0, 1e-10);
}

/* The rows of a trajectory are the flow's, forwards and backwards, also where they are dense. */
static void test_trajectory(dal_flow_method method, double h)
{
    enum { STEPS = 40 };
    double x0[MOST], x[MOST], rows[(STEPS + 1) * 8], residual;
    size_t done = 0;
    dal_system *system = open_with_state("generic4", x0);
    dal_flow *flow = open_flow(system, method, DAL_FLOW_X, 1e-11);
    dal_mechanics *const mechanics = open_mechanics(system);
    memcpy(rows, x0, sizeof x0);
    CHECK(dal_flow_trajectory(flow, 1.5, h, STEPS, rows, &done) == 0);
    CHECK(done == STEPS);
    for (size_t k = 1; k <= STEPS; k += 13) {
        memcpy(x, x0, sizeof x);
        CHECK(dal_flow_apply(flow, 1.5, 1.5 + (double)k * h, x, NULL) == 0);
        CHECK_NEAR(distance(8, x, rows + 8 * k), 0.0, 1e-8); /* 1000 tolerances */
        CHECK(dal_relative_residual(mechanics, 0.0, 0.0, rows + 8 * k, &residual) == 0);
        CHECK(residual <= DAL_RESIDUAL_BOUND(4));
    }
}

/* ---- failures --------------------------------------------------------------------------- */

static const double identity[4] = {1.0, 0.0, 0.0, 1.0};

/* Callbacks that fail as they are told to. */
typedef struct fault {
    size_t call, from, until; /* fails in calls from <= call < until */
    int answer;               /* 0: gives NaN */
} fault;

static bool fails(fault *f)
{
    const size_t call = f->call++;
    return call >= f->from && call < f->until;
}

/* V = |q|^2 / 2 for n = 2. */
static int faulty_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                            void *ctx)
{
    fault *const f = ctx;
    const bool now = fails(f);
    if (now && f->answer) return f->answer;
    if (V) *V = now ? NAN : 0.5 * (q[0] * q[0] + q[1] * q[1]);
    if (V_q) {
        V_q[0] = now ? NAN : q[0];
        V_q[1] = q[1];
    }
    if (V_qq) memcpy(V_qq, identity, sizeof identity);
    return 0;
}

/* v_1 = q_2 v_2. */
static int faulty_constraint(double t, const double *q, const double *v, double *phi,
                             double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    fault *const f = ctx;
    const bool now = fails(f);
    if (now && f->answer) return f->answer;
    if (phi) *phi = now ? NAN : v[0] - q[1] * v[1];
    if (phi_v) {
        phi_v[0] = now ? NAN : 1.0;
        phi_v[1] = -q[1];
    }
    if (phi_q) {
        phi_q[0] = 0.0;
        phi_q[1] = now ? NAN : -v[1];
    }
    return 0;
}

static dal_system *plane(dal_potential_fn potential, void *ctx)
{
    const dal_system_def def = {.n = 2, .mass = identity, .potential = potential, .ctx = ctx};
    return new_system(&def);
}

/* A callback that fails for good, from the k-th call on, for every k of both integrations. */
static void test_failing(dal_flow_method method, dal_flow_coordinates coordinates, int answer,
                         int expected)
{
    const double x0[4] = {1.0, 0.0, 0.0, 0.5};
    fault f = {.answer = answer, .from = SIZE_MAX, .until = SIZE_MAX};
    const dal_system_def def = {.n = 2, .m = 1, .mass = identity, .potential = faulty_potential,
                                .constraint = faulty_constraint, .ctx = &f};
    dal_system *const system = new_system(&def);
    dal_flow *flow = open_flow(system, method, coordinates, 1e-4);
    double x[4], accuracy;
    memcpy(x, x0, sizeof x);
    f.call = 0;
    CHECK(dal_flow_apply(flow, 0.0, 1.0, x, &accuracy) == 0);
    const size_t calls = f.call;
    CHECK(calls > 10);
    for (size_t k = 0; k < calls; k += brief() ? 1 + calls / 4 : 1) {
        accuracy = -1.0;
        f = (fault){.answer = answer, .from = k, .until = SIZE_MAX};
        memcpy(x, x0, sizeof x);
        CHECK(dal_flow_apply(flow, 0.0, 1.0, x, &accuracy) == expected);
        CHECK(memcmp(x, x0, sizeof x) == 0 && accuracy == -1.0);
        CHECK(strstr(dal_flow_error(flow)->text, "potential")
              || strstr(dal_flow_error(flow)->text, "constraint"));
        if (expected == DAL_EUSER) CHECK(f.call == k + 1); /* stop means stop */
    }
}

/* One refused evaluation costs a shorter step, not the run; and the next run is as good as new. */
static void test_recovery(dal_flow_method method)
{
    const double x0[4] = {1.0, 0.0, 0.0, 0.5};
    const double exact[4] = {cos(2.0), 0.5 * sin(2.0), -sin(2.0), 0.5 * cos(2.0)};
    fault f = {.from = SIZE_MAX, .until = SIZE_MAX};
    dal_system *system = plane(faulty_potential, &f);
    dal_flow *flow = open_flow(system, method, DAL_FLOW_X, 1e-9);
    double x[4];
    memcpy(x, x0, sizeof x);
    CHECK(dal_flow_apply(flow, 0.0, 2.0, x, NULL) == 0);
    const size_t calls = f.call;
    for (size_t k = 1; k < calls; k += 7) {
        memcpy(x, x0, sizeof x);
        f = (fault){.from = k, .until = k + 1};
        CHECK(dal_flow_apply(flow, 0.0, 2.0, x, NULL) == 0);
        CHECK(f.call > k);
        CHECK_NEAR(distance(4, x, exact), 0.0, 1e-6); /* 1000 tolerances */
    }
}

/* V = -|q|^4 / 4: q'' = |q|^2 q; from q = (1, 0), v = (1/sqrt 2, 0) the state is infinite at
 * t = sqrt 2. */
static int explosive_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                               void *ctx)
{
    const double r2 = q[0] * q[0] + q[1] * q[1];
    (void)ctx;
    if (V) *V = -0.25 * r2 * r2;
    if (V_q) {
        V_q[0] = -r2 * q[0];
        V_q[1] = -r2 * q[1];
    }
    if (V_qq) {
        V_qq[0] = -r2 - 2 * q[0] * q[0];
        V_qq[1] = V_qq[2] = -2 * q[0] * q[1];
        V_qq[3] = -r2 - 2 * q[1] * q[1];
    }
    return 0;
}

static void test_collapse(dal_flow_method method)
{
    const double x0[4] = {1.0, 0.0, sqrt(0.5), 0.0};
    dal_system *system = plane(explosive_potential, NULL);
    dal_flow *flow = open_flow(system, method, DAL_FLOW_X, 1e-6);
    double x[4], rows[11 * 4];
    memcpy(x, x0, sizeof x);
    CHECK(dal_flow_apply(flow, 0.0, 2.0, x, NULL) == DAL_ENOCONV);
    CHECK(memcmp(x, x0, sizeof x) == 0);
    CHECK(strstr(dal_flow_error(flow)->text, "collapsed to h = ") != NULL);
    CHECK(strstr(dal_flow_error(flow)->text, "at t = 1.41") != NULL);

    /* Rows before the end of time are good, the others are as they were. */
    size_t done = 99;
    for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) rows[i] = -7.0;
    memcpy(rows, x0, sizeof x0);
    CHECK(dal_flow_trajectory(flow, 0.0, 0.2, 10, rows, &done) == DAL_ENOCONV);
    CHECK(done == 7);
    for (size_t k = 0; k <= done; k++) /* q = sqrt 2 / (sqrt 2 - t), errors grow as q'' */
        CHECK_NEAR(rows[4 * k] / (sqrt(2.0) / (sqrt(2.0) - 0.2 * (double)k)), 1.0, 1e-2);
    for (size_t i = 4 * (done + 1); i < sizeof rows / sizeof rows[0]; i++) CHECK(rows[i] == -7.0);
}

/* V = 16 (|q_1| - 1/2)^4 for |q_1| > 1/2, nothing inside, and no V for |q_1| >= 1: the long steps
 * of the free motion overshoot.  The count of refusals is the ctx. */
static int walled_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                            void *ctx)
{
    const double depth = fmax(fabs(q[0]) - 0.5, 0.0);
    if (!(depth < 0.5)) {
        ++*(size_t *)ctx;
        return 1;
    }
    if (V) *V = 16.0 * depth * depth * depth * depth;
    if (V_q) {
        V_q[0] = copysign(64.0 * depth * depth * depth, q[0]);
        V_q[1] = 0.0;
    }
    if (V_qq) {
        memset(V_qq, 0, 4 * sizeof *V_qq);
        V_qq[0] = 192.0 * depth * depth;
    }
    return 0;
}

/* Steps that leave the domain of a callback are shortened. */
static void test_domain(dal_flow_method method)
{
    size_t refusals = 0;
    dal_system *system = plane(walled_potential, &refusals);
    dal_flow *flow = open_flow(system, method, DAL_FLOW_X, 1e-8);
    double x[4] = {0.0, 0.0, 1.0, 0.0}, E0, E; /* turns at |q_1| = 0.92 */
    dal_mechanics *const mechanics = open_mechanics(system);
    CHECK(dal_energy(mechanics, 0.0, x, &E0) == 0);
    CHECK(dal_flow_apply(flow, 0.0, 20.0, x, NULL) == 0);
    CHECK(dal_energy(mechanics, 0.0, x, &E) == 0);
    CHECK(refusals > 0);
    CHECK(fabs(x[0]) < 1.0);
    CHECK_NEAR(E, E0, 1e-5); /* 1000 tolerances */
}

/* mu = (q_1, 0): no constraint at all at q_1 = 0, where C is singular. */
static int vanishing_constraint(double t, const double *q, const double *v, double *phi,
                                double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    if (phi) *phi = q[0] * v[0];
    if (phi_v) {
        phi_v[0] = q[0];
        phi_v[1] = 0.0;
    }
    if (phi_q) {
        phi_q[0] = v[0];
        phi_q[1] = 0.0;
    }
    return 0;
}

static void test_singular(void)
{
    const dal_system_def def = {.n = 2, .m = 1, .mass = identity,
                                .constraint = vanishing_constraint};
    dal_system *const system = new_system(&def);
    for (int in = DAL_FLOW_X; in <= DAL_FLOW_XI; in++) {
        dal_flow *flow = open_flow(system, DAL_FLOW_RK8PD, (dal_flow_coordinates)in, 1e-9);
        double x[4] = {0.0, 0.0, 0.0, 1.0};
        CHECK(dal_flow_apply(flow, 0.0, 1.0, x, NULL) == DAL_ESINGULAR);
        CHECK(strstr(dal_flow_error(flow)->text, "constraints[0] vanishes here") != NULL);
        release(flow);
    }
}

/* V = stiffness q_1^2 / 2; the stiffness is the ctx. */
static int spring_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                            void *ctx)
{
    const double stiffness = *(const double *)ctx;
    if (V) *V = 0.5 * stiffness * q[0] * q[0];
    if (V_q) {
        V_q[0] = stiffness * q[0];
        V_q[1] = 0.0;
    }
    if (V_qq) {
        memset(V_qq, 0, 4 * sizeof *V_qq);
        V_qq[0] = stiffness;
    }
    return 0;
}

/* (q, v) of the knife edge of the library at t, in closed form. */
static void slide(double t, double speed, double x[6])
{
    const double omega = 1.2, start = 0.2, g = 2.5, theta = start + omega * t;
    const double a = speed - g / omega * sin(start), v = a + g / omega * sin(theta);
    x[0] = a / omega * (sin(theta) - sin(start))
         + 0.5 * g / (omega * omega) * (sin(theta) + sin(start)) * (sin(theta) - sin(start));
    x[1] = a / omega * (cos(start) - cos(theta))
         + g / (omega * omega) * (0.5 * omega * t - 0.25 * (sin(2.0 * theta) - sin(2.0 * start)));
    x[2] = theta;
    x[3] = v * cos(theta);
    x[4] = v * sin(theta);
    x[5] = omega;
}

/* A long interval is as accurate as many short ones: the state stays in D on the way. */
static void test_long_interval(dal_flow_method method, double tolerance, int t, double bound)
{
    const double speed = 0.51;
    if (brief()) t /= 50;
    double exact[6], x[6], start[6];
    dal_system *system = open_with_state("knife_edge", start);
    dal_flow *flow = open_flow(system, method, DAL_FLOW_X, tolerance);
    slide(0.0, speed, start);
    slide(t, speed, exact);
    memcpy(x, start, sizeof x);
    CHECK(dal_flow_apply(flow, 0.0, t, x, NULL) == 0);
    CHECK(distance(6, x, exact) < bound);
    double *const rows = malloc((size_t)(t + 1) * sizeof start); /* each of few inner steps */
    memcpy(rows, start, sizeof start);
    CHECK(dal_flow_trajectory(flow, 0.0, 1.0, (size_t)t, rows, NULL) == 0);
    CHECK(distance(6, rows + t * 6, exact) < bound);
    free(rows);
}

/* A spring of stiffness 1e8 that is almost at rest: rodas steps over it, which it can only with the
 * right Jacobian; the explicit method needs steps of about 1e-4. */
static void test_stiff(void)
{
    double stiffness = 1e8;
    dal_system *system = plane(spring_potential, &stiffness);
    size_t evaluations[2];
    const dal_flow_method methods[2] = {DAL_FLOW_RK8PD, DAL_FLOW_RODAS};
    for (size_t i = 0; i < 2; i++) {
        dal_flow *flow = open_flow(system, methods[i], DAL_FLOW_X, 1e-4);
        double x[4] = {1e-9, 0.0, 0.0, 1.0};
        CHECK(dal_flow_apply(flow, 0.0, 10.0, x, NULL) == 0);
        CHECK_NEAR(x[1], 10.0, 1e-2);
        evaluations[i] = dal_flow_evaluations(flow);
        release(flow);
    }
    CHECK(20 * evaluations[1] < evaluations[0]);
}

/* 1/(gamma h) - J of rodas is singular for gamma h sqrt(k) = 1, gamma = 1/4: intervals and
 * stiffnesses chosen to meet that do not harm, and nothing that grows or overflows reaches GSL's
 * handler. */
static void test_unstable_rodas(void)
{
    for (int exponent = 0; exponent <= 40; exponent += 2) {
        double stiffness = -ldexp(1.0, exponent);
        dal_system *system = plane(spring_potential, &stiffness);
        dal_flow *flow = open_flow(system, DAL_FLOW_RODAS, DAL_FLOW_X, 1e-9);
        const double unit = ldexp(1.0, -exponent / 2);
        for (int factor = 1; factor <= 4; factor++) {
            double x[4] = {1e-3, 0.0, 0.0, 0.0};
            CHECK(dal_flow_apply(flow, 0.0, factor * unit, x, NULL) == 0);
            /* at most 200 steps, in units where v is as large as q, with growth exp(4) */
            CHECK_NEAR(x[0], 1e-3 * cosh(factor), 200e-9 * exp(4.0));
        }
        double rows[9 * 4] = {1e-3}; /* whole rows in one step */
        CHECK(dal_flow_trajectory(flow, 0.0, unit, 8, rows, NULL) == 0);
        CHECK_NEAR(rows[8 * 4] / (1e-3 * cosh(8.0)), 1.0, 1e-3);
        release(system);
    }
}

/* f = -c (v_1 - v_2) (1, -1); c is the ctx. */
static int friction(double t, const double *q, const double *v, const double *u, double *f,
                    double *f_q, double *f_v, void *ctx)
{
    const double c = *(const double *)ctx;
    (void)t, (void)q;
    if (f) {
        f[0] = -c * (v[0] - v[1]);
        f[1] = -c * (v[1] - v[0]);
    }
    if (f_q) memset(f_q, 0, 4 * sizeof *f_q);
    if (f_v) {
        f_v[0] = f_v[3] = -c;
        f_v[1] = f_v[2] = c;
    }
    return 0;
}

/* Two bodies that rub on each other are soon as fast as their mean, which stays; and where 1 is
 * lost in 1 + h c the matrix of rodas is singular in all digits. */
static void test_friction(void)
{
    for (int exponent = 0; exponent <= 300; exponent += exponent >= 18 ? 22 : brief() ? 6 : 1) {
        double c = pow(10.0, exponent);
        const dal_system_def def = {.n = 2, .mass = identity, .force = friction, .ctx = &c};
        dal_system *const system = new_system(&def);
        dal_flow *flow = open_flow(system, DAL_FLOW_RODAS, DAL_FLOW_X, 1e-6);
        const double x0[4] = {0.0, 0.0, 1.0, 0.0};
        double x[4];
        memcpy(x, x0, sizeof x);
        const int status = dal_flow_apply(flow, 0.0, 1.0, x, NULL);
        CHECK(exponent > 12 || status == 0); /* else rounding of v times c is no small force */
        if (status) CHECK(memcmp(x, x0, sizeof x) == 0 && dal_flow_error(flow)->text[0] != '\0');
        const double mean = 0.5, relative = exp(-2.0 * c);
        if (!status) CHECK_NEAR(x[2], mean * (1.0 + relative), 1e-4); /* 100 tolerances */
        if (!status) CHECK_NEAR(x[0], mean * (1.0 + (1.0 - relative) / (2.0 * c)), 1e-4);

        double together[4] = {0.0, 0.0, 1.0, 1.0};
        if (exponent < 17) { /* later it takes millions of steps */
            CHECK(dal_flow_apply(flow, 0.0, 1e3, together, NULL) == 0);
            CHECK_NEAR(distance(4, together, (double[4]){1e3, 1e3, 1.0, 1.0}), 0.0, 1e-1);
        }
        release(system);
    }
}

/* In the coordinates of charts: the same states, each in D without being projected, and the chart
 * is changed on the way where the dependent coordinate of the start does not serve all of it. */
static void test_in_xi(const char *name, dal_flow_method method, double tolerance, bool turns)
{
    double x0[MOST], in_x[MOST], in_xi[MOST], rows[21 * MOST], accuracy, relative;
    dal_system *const system = open_with_state(name, x0);
    const size_t N = 2 * dal_system_n(system);
    dal_flow *const plain = open_flow(system, method, DAL_FLOW_X, tolerance);
    dal_flow *const flow = open_flow(system, method, DAL_FLOW_XI, tolerance);
    dal_mechanics *const mech = open_mechanics(system);
    for (int sign = -1; sign <= 1; sign += 2) {
        memcpy(in_x, x0, sizeof in_x);
        memcpy(in_xi, x0, sizeof in_xi);
        CHECK(dal_flow_apply(plain, 0.0, 10.0 * sign, in_x, NULL) == 0);
        CHECK(dal_flow_apply(flow, 0.0, 10.0 * sign, in_xi, &accuracy) == 0);
        /* both have an error of this size, that of some hundred steps of size tolerance */
        CHECK_NEAR(distance(N, in_x, in_xi), 0.0, 1e3 * tolerance * (1.0 + distance(N, in_x, x0)));
        CHECK(accuracy <= 1e4 * tolerance);
    }
    CHECK(turns == (dal_flow_chart_changes(flow) > 0));
    CHECK(dal_flow_chart_changes(plain) == 0);
    memcpy(rows, x0, sizeof x0);
    CHECK(dal_flow_trajectory(flow, 0.0, 0.5, 20, rows, NULL) == 0);
    for (size_t k = 1; k <= 20; k++) {
        CHECK(dal_relative_residual(mech, 0.0, 0.0, rows + k * N, &relative) == 0);
        CHECK(relative <= DAL_RESIDUAL_BOUND(N / 2));
    }
    memcpy(in_x, x0, sizeof in_x);
    CHECK(dal_flow_apply(plain, 0.0, 10.0, in_x, NULL) == 0);
    CHECK_NEAR(distance(N, in_x, rows + 20 * N), 0.0,
               1e3 * tolerance * (1.0 + distance(N, in_x, x0)));
}

/* A change of chart costs no accuracy, as the integrator begins anew there.  The slope of the chart
 * before would spoil a step, by all that the tolerance lets pass. */
static void test_turns(const char *name)
{
    const double tolerance = 1e-8;
    for (size_t i = 0; i < sizeof references / sizeof references[0]; i++) {
        const struct reference *const r = &references[i];
        if (strcmp(r->system, name) != 0 || r->t != 10) continue;
        double x0[MOST], x[MOST];
        dal_system *const system = open_with_state(name, x0);
        const size_t N = 2 * dal_system_n(system);
        dal_flow *flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_XI, tolerance);
        memcpy(x, x0, sizeof x);
        CHECK(dal_flow_apply(flow, 0.0, r->t, x, NULL) == 0);
        const size_t changes = dal_flow_chart_changes(flow);
        CHECK_NEAR(distance(N, x, r->x), 0.0, (double)(5 + changes) * tolerance);
        release(system);
    }
}

static void test_arguments(void)
{
    double x0[MOST] = {0}, x[MOST], accuracy = -1.0;
    dal_error error;
    dal_system *system = open_with_state("particle", x0);
    dal_flow *const none = NULL;
    dal_flow *flow = none;
    CHECK(dal_flow_new(&flow, system, DAL_FLOW_RK8PD, (dal_flow_coordinates)5, 1e-9, &error)
          == DAL_EINVAL);
    CHECK(strstr(error.text, "coordinates = 5") != NULL && flow == NULL);
    CHECK(dal_flow_new(NULL, system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-9, &error) == DAL_EINVAL);
    CHECK(dal_flow_new(&flow, NULL, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-9, &error) == DAL_EINVAL);
    CHECK(dal_flow_new(&flow, system, (dal_flow_method)17, DAL_FLOW_X, 1e-9, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "17") != NULL);
    const double bad_tolerances[] = {0.0, -1e-9, 0.11, NAN, INFINITY};
    for (size_t i = 0; i < sizeof bad_tolerances / sizeof bad_tolerances[0]; i++)
        CHECK(dal_flow_new(&flow, system, DAL_FLOW_RK8PD, DAL_FLOW_X, bad_tolerances[i], &error)
              == DAL_EINVAL);
    CHECK(strstr(error.text, "tolerance = inf") != NULL);
    CHECK(flow == none);

    flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 0.1);
    memcpy(x, x0, sizeof x);
    CHECK(dal_flow_apply(NULL, 0.0, 1.0, x, NULL) == DAL_EINVAL);
    CHECK(dal_flow_apply(flow, 0.0, 1.0, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_flow_apply(flow, 0.0, NAN, x, &accuracy) == DAL_EINVAL);
    CHECK(dal_flow_apply(flow, INFINITY, 1.0, x, &accuracy) == DAL_EINVAL);
    CHECK(dal_flow_apply(flow, -1e308, 1e308, x, &accuracy) == DAL_EINVAL);
    CHECK(dal_flow_trajectory(flow, 0.0, 0.0, 3, x, NULL) == DAL_EINVAL);
    CHECK(dal_flow_trajectory(flow, 0.0, NAN, 3, x, NULL) == DAL_EINVAL);
    CHECK(dal_flow_trajectory(flow, 0.0, 1.0, 0, x, NULL) == 0);
    CHECK(memcmp(x, x0, sizeof x) == 0 && accuracy == -1.0);
    x[4] = NAN;
    CHECK(dal_flow_apply(flow, 0.0, 1.0, x, &accuracy) == DAL_EINVAL);
    CHECK(strstr(dal_flow_error(flow)->text, "x[4]") != NULL);
    dal_flow_free(NULL);
}

/* Returns what stands in ctx. */
static int answer(double t, void *ctx)
{
    CHECK(t >= 0.0 && t <= 1e7);
    return *(const int *)ctx;
}

/* A watch ends an interval that would take hours: nothing is changed, and rows that are there stay;
 * without it the flow goes on as if nothing had been. */
static void test_watch(dal_flow_method method, dal_flow_coordinates coordinates)
{
    double x0[MOST], x[MOST], expected[MOST], rows[3 * MOST];
    dal_system *const system = open_with_state("particle_oscillator", x0);
    const size_t bytes = 2 * dal_system_n(system) * sizeof *x;
    dal_flow *flow = open_flow(system, method, coordinates, 1e-9);
    memcpy(expected, x0, bytes);
    CHECK(dal_flow_apply(flow, 0.0, 1.0, expected, NULL) == 0);
    for (int returned = -1; returned <= 1; returned += 2) {
        const int status = returned > 0 ? DAL_STOPPED : DAL_EUSER;
        dal_flow_watch(flow, answer, &returned);
        memcpy(x, x0, bytes);
        CHECK(dal_flow_apply(flow, 0.0, 1e7, x, NULL) == status);
        CHECK(memcmp(x, x0, bytes) == 0);
        CHECK(strstr(dal_flow_error(flow)->text, "watch"));
        size_t done = 9;
        memcpy(rows, x0, bytes);
        CHECK(dal_flow_trajectory(flow, 0.0, 5e6, 2, rows, &done) == status);
        CHECK(done == 0 && memcmp(rows, x0, bytes) == 0);
    }
    dal_flow_watch(flow, NULL, NULL);
    memcpy(x, x0, bytes);
    CHECK(dal_flow_apply(flow, 0.0, 1.0, x, NULL) == 0);
    CHECK(memcmp(x, expected, bytes) == 0);
    dal_flow_watch(NULL, NULL, NULL);
}

int main(void)
{
    gsl_set_error_handler(abort_on_gsl_error);
    static const struct {
        const char *name;
        bool turns;
    } systems[] = {{"particle", false}, {"particle_oscillator", false}, {"knife_edge", true},
                   {"sleigh", true}, {"disk", false}, {"heisenberg", false}, {"generic4", false}};
    for (size_t i = 0; i < sizeof systems / sizeof *systems; i++) {
        test_in_xi(systems[i].name, DAL_FLOW_RK8PD, 1e-13, systems[i].turns);
        test_in_xi(systems[i].name, DAL_FLOW_MSADAMS, 1e-9, systems[i].turns);
    }
    test_claims();
    test_turns("knife_edge");
    test_turns("sleigh");
    test_reference(DAL_FLOW_RK8PD, 1e-13, 5);
    test_reference(DAL_FLOW_MSADAMS, 1e-11, 200);
    test_reference(DAL_FLOW_RODAS, 1e-8, 200);
    test_off_D();
    test_stiff();
    test_long_interval(DAL_FLOW_RK8PD, 1e-13, 3000, 1e-8);
    test_long_interval(DAL_FLOW_MSADAMS, 1e-10, 3000, 1e-5);
    test_long_interval(DAL_FLOW_RODAS, 1e-8, 100, 1e-6);
    test_unstable_rodas();
    test_friction();
    test_singular();
    test_arguments();
    const dal_flow_method methods[] = {DAL_FLOW_RK8PD, DAL_FLOW_MSADAMS, DAL_FLOW_RODAS};
    for (size_t i = 0; i < sizeof methods / sizeof methods[0]; i++) {
        test_small_intervals(methods[i]);
        test_trajectory(methods[i], 0.05);
        test_trajectory(methods[i], -1e-4);
        test_recovery(methods[i]);
        for (int in = DAL_FLOW_X; in <= DAL_FLOW_XI; in++) {
            test_failing(methods[i], (dal_flow_coordinates)in, 3, DAL_EDOMAIN);
            test_failing(methods[i], (dal_flow_coordinates)in, 0, DAL_EDOMAIN);
            test_failing(methods[i], (dal_flow_coordinates)in, -3, DAL_EUSER);
            test_watch(methods[i], (dal_flow_coordinates)in);
        }
        test_collapse(methods[i]);
        test_domain(methods[i]);
    }
    return check_done();
}
