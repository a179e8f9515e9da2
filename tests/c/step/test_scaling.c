/* Steps that keep the energy by scaled velocities: what they are, what they keep, and where they
 * cannot. */
#include "fixtures.h"
#include "check.h"

#include "dalembert/ensemble.h"
#include "dalembert/events.h"
#include "dalembert/family.h"
#include "step/stepper.h"

enum { MOST_2N = 16, MOST_SAVED = 220 };

static const dal_options keep = {.keep_energy = 1};

static dal_stepper *keeping(const dal_system *system, const char *scheme)
{
    const dal_scheme record = find_scheme(scheme);
    return open_stepper(system, &record, &keep);
}

static void begin(dal_stepper *stepper, const double *x, double h)
{
    double state[MOST_2N];
    if (!x) need(dal_system_state(stepper->motion.system, state), "state", "none");
    need(dal_stepper_start(stepper, 0.0, h, x ? x : state, DAL_CHECK, DAL_INITIAL_NONE), "start",
         dal_stepper_error(stepper)->text);
}

static double energy_of(dal_mechanics *mechanics, const double *x)
{
    double E = NAN;
    need(dal_energy(mechanics, 0.0, x, &E), "energy", "");
    return E;
}

/* Whether two states differ by the low part at most that only one of their steppers has. */
static bool is_near(size_t n, const double *x, const double *y)
{
    for (size_t i = 0; i < n; i++)
        if (!(fabs(x[i] - y[i]) <= DBL_EPSILON * (1.0 + fabs(y[i])))) return false;
    return true;
}

/* v^T M v by the metric of the public header. */
static double twice_kinetic(dal_mechanics *mechanics, size_t n, const double *x)
{
    double M[MOST_2N * MOST_2N / 4], sum = 0.0;
    need(dal_metric(mechanics, 0.0, x, M), "metric", "");
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++) sum += x[n + i] * M[i * n + j] * x[n + j];
    return sum;
}

/* ---- systems of these tests ----------------------------------------------------------------- */

/* Three quartic oscillators in the contact structure z' = y x'. */
static int quartic(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    (void)t, (void)ctx;
    if (V) *V = 0.0;
    if (V_qq) memset(V_qq, 0, 9 * sizeof *V_qq);
    for (int i = 0; i < 3; i++) {
        const double k = i == 1 ? 2.0 : 1.0;
        if (V) *V += 0.25 * k * q[i] * q[i] * q[i] * q[i];
        if (V_q) V_q[i] = k * q[i] * q[i] * q[i];
        if (V_qq) V_qq[4 * i] = 3.0 * k * q[i] * q[i];
    }
    return 0;
}

static int contact(double t, const double *q, const double *v, double *phi, double *phi_v,
                   double *phi_q, double *phi_t, void *ctx)
{
    (void)t, (void)phi_t, (void)ctx;
    if (phi) phi[0] = v[2] - q[1] * v[0];
    if (phi_v) {
        phi_v[0] = -q[1];
        phi_v[1] = 0.0;
        phi_v[2] = 1.0;
    }
    if (phi_q) {
        phi_q[0] = phi_q[2] = 0.0;
        phi_q[1] = -v[0];
    }
    return 0;
}

/* L = (M(q) v.v)/2 + x^2 z' - |q|^2/2, M = diag(2 + cos y, 1, 1 + x^2), and c (v.v)^2, with a large
 * mass beside it, where c, at ctx, is not 0: what is not given is differenced. */
static int gyroscopic(double t, const double *q, const double *v, double *L, double *L_q,
                      double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                      void *ctx)
{
    const double c = *(const double *)ctx, heavy = c == 0.0 ? 0.0 : 1e12;
    const double M[3] = {2.0 + cos(q[1]) + heavy, 1.0, 1.0 + q[0] * q[0]};
    const double speed = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], x = q[0];
    (void)t, (void)L_qq, (void)L_vq, (void)L_vt;
    if (L) {
        *L = x * x * v[2] + c * speed * speed;
        for (int i = 0; i < 3; i++) *L += 0.5 * (M[i] * v[i] * v[i] - q[i] * q[i]);
    }
    if (L_q) {
        L_q[0] = 2.0 * x * v[2] + x * v[2] * v[2] - q[0];
        L_q[1] = -0.5 * sin(q[1]) * v[0] * v[0] - q[1];
        L_q[2] = -q[2];
    }
    for (int i = 0; i < 3; i++) {
        if (L_v) L_v[i] = M[i] * v[i] + (i == 2 ? x * x : 0.0) + 4.0 * c * speed * v[i];
        for (int j = 0; L_vv && j < 3; j++)
            L_vv[3 * i + j] =
                (i == j ? M[i] + 4.0 * c * speed : 0.0) + 8.0 * c * v[i] * v[j];
    }
    return 0;
}

enum { QUARTIC, GYROSCOPIC, NOT_QUADRATIC };

static dal_system *open_own(int which)
{
    static const double mass[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    static const double state[6] = {0.5, 0.3, -0.2, 1.0, 0.7, 0.3}, none = 0.0, some = 1e-3;
    dal_system_def def = {.n = 3, .m = 1, .constraint = contact, .state = state};
    if (which == QUARTIC) {
        def.mass = mass;
        def.potential = quartic;
    } else {
        def.lagrangian = gyroscopic;
        def.missing = DAL_MISSING_L_QQ | DAL_MISSING_L_VQ;
        def.ctx = (void *)(which == GYROSCOPIC ? &none : &some);
    }
    return new_system(&def);
}

/* ---- what a step is ------------------------------------------------------------------------- */

/* By the formulas, with plain steps that are started anew, and E, T by the public functions. */
static void step_by_hand(dal_stepper *plain, dal_mechanics *mechanics, double E, double h,
                         double *x)
{
    const size_t n = plain->mech.n;
    double y[MOST_2N];
    memcpy(y, x, 2 * n * sizeof *y);
    for (int pass = 0; pass < 2; pass++) {
        need(dal_stepper_start(plain, 0.0, h, y, DAL_ASSUME, DAL_INITIAL_NONE), "start", "");
        need(dal_step(plain, NULL), "step", "");
        const double *const z = dal_stepper_state(plain);
        const double defect = energy_of(mechanics, z) - E, after = twice_kinetic(mechanics, n, z);
        const double s = -defect / (twice_kinetic(mechanics, n, x) + after);
        const double c = pass == 0 ? 1.0 + s : sqrt(1.0 - 2.0 * defect / after);
        memcpy(y, pass == 0 ? x : z, 2 * n * sizeof *y);
        for (size_t i = n; i < 2 * n; i++) y[i] *= c;
    }
    memcpy(x, y, 2 * n * sizeof *y);
}

/* The step is that of the formulas; its impulse that of the second plain step, so that M (v' - v) -
 * mu^T impulse and the impulse of V differ by a part along M v and M v'. */
static void test_step(void)
{
    const char *const schemes[] = {"leapfrog", "leapfrog-mirror", "midpoint", "leapfrog-kl6",
                                   "bm4"};
    for (int which = QUARTIC; which <= GYROSCOPIC; which++)
        for (size_t s = 0; s < sizeof schemes / sizeof schemes[0]; s++) {
            const double h = s % 2 ? -0.15 : 0.15;
            dal_system *const system = open_own(which);
            dal_mechanics *const mechanics = open_mechanics(system);
            dal_stepper *const stepper = keeping(system, schemes[s]);
            dal_stepper *const plain = open_named(system, schemes[s]);
            double x[6], reaction, expected;
            begin(stepper, NULL, h);
            memcpy(x, dal_stepper_state(stepper), sizeof x);
            const double E = energy_of(mechanics, x);
            for (int k = 0; k < 20; k++) {
                step_by_hand(plain, mechanics, E, h, x);
                CHECK(dal_step(stepper, &reaction) == DAL_SUCCESS);
                CHECK(largest_difference(6, x, dal_stepper_state(stepper)) < 1e-12);
                need(dal__stepper_reaction(plain, h, &expected), "reaction", "");
                CHECK_NEAR(reaction, expected, 1e-11);
            }
            const dal_stats stats = stats_of(stepper);
            CHECK(stats.scaled == 20 && stats.unscaled == 0 && stats.steps == 20);
            release(system);
        }
    /* one leapfrog of the quartic system: what is not V and not the reaction is along v and v' */
    dal_system *const system = open_own(QUARTIC);
    dal_stepper *const stepper = keeping(system, "leapfrog");
    double x[6], reaction, force[3], rest[3];
    const double h = 0.2;
    begin(stepper, NULL, h);
    for (int k = 0; k < 50; k++) {
        memcpy(x, dal_stepper_state(stepper), sizeof x);
        CHECK(dal_step(stepper, &reaction) == DAL_SUCCESS);
        const double *const y = dal_stepper_state(stepper), *const v = x + 3, *const w = y + 3;
        /* the node is q + h (1 + s) v / 2 and q' - h w / (2 c): where the two lines meet */
        double F = NAN, most = 0.0;
        const double vv = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
        const double vw = v[0] * w[0] + v[1] * w[1] + v[2] * w[2];
        const double ww = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
        double vd = 0.0, wd = 0.0, node[3];
        for (int i = 0; i < 3; i++) {
            vd += v[i] * (y[i] - x[i]);
            wd += w[i] * (y[i] - x[i]);
        }
        const double a = (vd * ww - wd * vw) / (vv * ww - vw * vw);
        for (int i = 0; i < 3; i++) node[i] = x[i] + a * v[i];
        quartic(0.0, node, &F, force, NULL, NULL);
        const double mu[3] = {-node[1], 0.0, 1.0};
        for (int i = 0; i < 3; i++)
            rest[i] = w[i] - v[i] + h * force[i] - h * reaction * mu[i];
        const double normal[3] = {v[1] * w[2] - v[2] * w[1], v[2] * w[0] - v[0] * w[2],
                                  v[0] * w[1] - v[1] * w[0]};
        for (int i = 0; i < 3; i++) most += normal[i] * rest[i];
        CHECK(fabs(2.0 * a / h - 1.0) < 0.1 && fabs(2.0 * a / h - 1.0) > 1e-9);
        CHECK(fabs(most) < 1e-11); /* the lines meet to roundoff over the sine of their angle */
    }
}

/* ---- what it keeps -------------------------------------------------------------------------- */

static void test_kept(void)
{
    static const struct {
        const char *system, *scheme;
        double h;
        size_t steps;
    } runs[] = {{"contact_oscillator", "leapfrog", 0.1, 20000}, {NULL, "bm6", 0.25, 20000},
                {NULL, "leapfrog", -0.1, 20000}, {"particle_oscillator", "midpoint", 0.1, 5000},
                {"uneven_edge", "leapfrog-kl6", 0.1, 5000}, {"generic4", "leapfrog", 0.05, 5000},
                {"gyroscopic", "leapfrog-kl8", 0.3, 2000}, {"chaotic", "leapfrog", 0.1, 5000},
                {"particle", "leapfrog-suzuki4", 0.3, 5000}, {"robot", "bm4", 0.1, 5000}};
    for (size_t r = 0; r < sizeof runs / sizeof runs[0]; r++) {
        const char *const name = runs[r].system;
        const size_t steps = brief() ? 200 : runs[r].steps;
        dal_system *const system = !name ? open_own(QUARTIC)
                                 : strcmp(name, "gyroscopic") == 0 ? open_own(GYROSCOPIC)
                                                                   : open_system(name);
        dal_mechanics *const mechanics = open_mechanics(system);
        const size_t n = dal_system_n(system);
        dal_stepper *const stepper = keeping(system, runs[r].scheme);
        dal_stepper *const other = keeping(system, runs[r].scheme);
        dal_stepper *const plain = open_named(system, runs[r].scheme);
        double reaction[4], sum[4] = {0.0}, worst = 0.0, size = 0.0, error = 0.0;
        dal_stats stats, of_plain;
        begin(stepper, NULL, runs[r].h);
        begin(other, NULL, runs[r].h);
        begin(plain, NULL, runs[r].h);
        const double E = energy_of(mechanics, dal_stepper_state(stepper));
        for (size_t k = 0; k < steps; k++) {
            if (dal_step(stepper, reaction)) break;
            const double *const x = dal_stepper_state(stepper);
            worst = fmax(worst, residual_of(system, 0.0, x));
            size = fmax(size, fabs(E) + twice_kinetic(mechanics, n, x));
            error = fmax(error, fabs(energy_of(mechanics, x) - E));
            for (size_t a = 0; a < dal_system_m(system); a++) sum[a] += reaction[a];
        }
        dal_stepper_stats(stepper, &stats);
        CHECK(error <= 8.0 * U * (double)n * size);
        CHECK(worst <= 4.0 * (double)n * U && worst <= stats.worst_residual);
        CHECK(stats.worst_residual <= 4.0 * (double)n * U);
        CHECK(stats.unscaled == 0 && stats.jump_step == 0);
        /* in one piece: the same bits, the same mean */
        CHECK(dal_advance(other, steps, reaction, NULL) == DAL_SUCCESS);
        CHECK(memcmp(dal_stepper_state(other), dal_stepper_state(stepper), 2 * n * sizeof sum[0])
              == 0);
        for (size_t a = 0; a < dal_system_m(system); a++)
            CHECK_NEAR(reaction[a], sum[a] / (double)steps, 1e-10 * (1.0 + fabs(sum[a])));
        /* twice the calls of the constraint, the predictor is not forgotten */
        CHECK(dal_advance(plain, steps, NULL, NULL) == DAL_SUCCESS);
        dal_stepper_stats(plain, &of_plain);
        CHECK((double)stats.constraint_calls < 2.1 * (double)of_plain.constraint_calls);
        CHECK((double)stats.constraint_calls + 200.0 > (double)of_plain.constraint_calls
              * (1.0 + (double)stats.scaled / (double)stats.steps));
        release(system);
    }
}

/* There and back: the start, but for terms of order s^2, h^(2p) here. */
static double come_back(const dal_system *system, double h)
{
    const size_t steps = (size_t)(10.0 / h), N = 2 * dal_system_n(system);
    double start[MOST_2N], x[MOST_2N];
    dal_stepper *const stepper = keeping(system, "leapfrog");
    begin(stepper, NULL, h);
    memcpy(start, dal_stepper_state(stepper), N * sizeof *x);
    CHECK(dal_advance(stepper, steps, NULL, NULL) == DAL_SUCCESS);
    memcpy(x, dal_stepper_state(stepper), N * sizeof *x);
    begin(stepper, x, -h);
    CHECK(dal_advance(stepper, steps, NULL, NULL) == DAL_SUCCESS);
    const double error = largest_difference(N, start, dal_stepper_state(stepper));
    return error;
}

/* One step, of h and of h/2, from the same state against the flow: the order is the scheme's. */
static void test_order(void)
{
    const char *const schemes[] = {"leapfrog", "midpoint", "leapfrog-suzuki4", "bm4"};
    for (int which = QUARTIC; which <= GYROSCOPIC; which++) {
        dal_system *const system = open_own(which);
        for (size_t s = 0; s < sizeof schemes / sizeof schemes[0]; s++) {
            const int order = find_scheme(schemes[s]).order;
            double errors[2];
            for (int k = 0; k < 2; k++) {
                const double h = (order == 2 ? 0.05 : 0.2) / (1 << k);
                dal_stepper *const stepper = keeping(system, schemes[s]);
                dal_stepper *const exact = open_named(system, "reference");
                begin(stepper, NULL, h);
                begin(exact, NULL, h);
                CHECK(dal_step(stepper, NULL) == 0 && dal_step(exact, NULL) == 0);
                errors[k] =
                    largest_difference(6, dal_stepper_state(stepper), dal_stepper_state(exact));
                release(stepper);
            }
            CHECK_NEAR(log2(errors[0] / errors[1]), order + 1.0, 0.4);
        }
        release(system);
    }
    dal_system *const system = open_own(QUARTIC);
    const double far = come_back(system, 0.1), near = come_back(system, 0.05);
    CHECK(far < 1e-4 && near < far / 8.0);
}

/* ---- where it cannot ------------------------------------------------------------------------ */

static int swinging(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double *const edge = ctx;
    (void)t;
    if (edge && q[0] > *edge) return 1;
    if (V) *V = -cos(q[0]);
    if (V_q) *V_q = sin(q[0]);
    if (V_qq) *V_qq = cos(q[0]);
    return 0;
}

static int slope(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    (void)t, (void)ctx;
    if (V) *V = -1e154 * q[0];
    if (V_q) *V_q = -1e154;
    if (V_qq) *V_qq = 0.0;
    return 0;
}

static dal_system *open_pendulum(double *edge)
{
    static const double mass = 1.0, state[2] = {0.0, 1.0};
    const dal_system_def def = {.n = 1, .mass = &mass, .potential = swinging, .state = state,
                                .ctx = edge};
    return new_system(&def);
}

static void test_limits(void)
{
    dal_system *const system = open_pendulum(NULL);
    dal_mechanics *const mechanics = open_mechanics(system);
    dal_stepper *const stepper = keeping(system, "leapfrog");
    dal_stepper *const plain = open_named(system, "leapfrog");
    dal_stats stats, before;
    const double at_rest[2] = {0.0, 0.0}, hanging[2] = {1.0, 0.0}, tiny[2] = {1e-7, 0.0};

    /* at rest where nothing moves it, and so near that all is roundoff: plain steps, and no word */
    for (int k = 0; k < 2; k++) {
        begin(stepper, k ? tiny : at_rest, 0.1);
        begin(plain, k ? tiny : at_rest, 0.1);
        CHECK(dal_advance(stepper, 200, NULL, NULL) == DAL_SUCCESS);
        CHECK(dal_advance(plain, 200, NULL, NULL) == DAL_SUCCESS);
        dal_stepper_stats(stepper, &stats);
        CHECK(stats.scaled == 0 && stats.unscaled == 0 && stats.jump_step == 0);
        CHECK(memcmp(dal_stepper_state(stepper), dal_stepper_state(plain), sizeof tiny) == 0);
    }
    /* from rest on a slope: the energy is kept from the first step on */
    begin(stepper, hanging, 0.1);
    const double E = energy_of(mechanics, hanging);
    for (int k = 0; k < 100; k++) {
        CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
        CHECK(fabs(energy_of(mechanics, dal_stepper_state(stepper)) - E) < 4.0 * U);
    }
    dal_stepper_stats(stepper, &stats);
    CHECK(stats.unscaled == 0);

    /* a step that is far too long: where the energy is lost it is counted, the step is the plain
     * one, and the next ones bring it back */
    begin(stepper, hanging, 0.5);
    size_t lost = 0, mended = 0;
    for (int k = 0; k < 2000; k++) {
        double x[2];
        memcpy(x, dal_stepper_state(stepper), sizeof x);
        dal_stepper_stats(stepper, &before);
        CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
        dal_stepper_stats(stepper, &stats);
        const double error = fabs(energy_of(mechanics, dal_stepper_state(stepper)) - E);
        const bool plainly = stats.unscaled > before.unscaled;
        begin(plain, x, 0.5);
        CHECK(dal_step(plain, NULL) == DAL_SUCCESS);
        const double *const y = dal_stepper_state(plain);
        const double s = (E - energy_of(mechanics, y)) / (x[1] * x[1] + y[1] * y[1]);
        CHECK(plainly || (error <= 8.0 * U && fabs(s) <= 0.5));
        if (plainly) {
            CHECK(is_near(2, dal_stepper_state(stepper), y)); /* and what x lacks */
            lost++;
        } else if (lost > mended) {
            mended = lost;
        }
    }
    CHECK(lost > 10 && lost < 200 && mended >= lost - 1 && stats.scaled + lost == 2000);
    CHECK(stats.jump_step == 0);
    /* nor is a velocity scaled by more where the energy could be reached so, perhaps by turning it
     * round */
    for (int i = 0; i < 600; i++) {
        const double x[2] = {0.1 * (i % 30), 0.1 * (i / 30)};
        begin(plain, x, 2.5);
        begin(stepper, x, 2.5);
        CHECK(dal_step(plain, NULL) == DAL_SUCCESS && dal_step(stepper, NULL) == DAL_SUCCESS);
        const double *const y = dal_stepper_state(plain);
        const double s = (energy_of(mechanics, x) - energy_of(mechanics, y))
                       / (x[1] * x[1] + y[1] * y[1]);
        dal_stepper_stats(stepper, &stats);
        if (stats.scaled) CHECK(fabs(s) <= 0.5);
    }
    /* longer still: what the plain step would do to the energy is seen as the jump that it is */
    begin(stepper, hanging, 1.5);
    CHECK(dal_advance(stepper, 64, NULL, NULL) == DAL_SUCCESS);
    dal_stepper_stats(stepper, &stats);
    CHECK(stats.jump_step == 64 && fabs(stats.jump) > 0.5 * stats.largest_kinetic);

    /* and so is a drift that was undone step by step */
    dal_system *const drifting = open_own(GYROSCOPIC);
    dal_stepper *const held = keeping(drifting, "leapfrog");
    begin(held, NULL, 0.4);
    const double last = held->scaling.energy;
    CHECK(dal_advance(held, 20000, NULL, NULL) == DAL_SUCCESS);
    dal_stepper_stats(held, &stats);
    CHECK(stats.jump_step > 64 && stats.unscaled == 0);
    dal_mechanics *const measures = open_mechanics(drifting);
    CHECK_NEAR(energy_of(measures, dal_stepper_state(held)), last, 1e-14);

    /* an energy that overflows is not kept */
    const double mass = 1.0, fast[2] = {0.0, 1.2e154}, faster[2] = {0.0, 2.0e154};
    const dal_system_def def = {.n = 1, .mass = &mass, .potential = slope};
    dal_system *const steep = new_system(&def);
    dal_stepper *const falling = keeping(steep, "leapfrog");
    begin(falling, fast, 1.0);
    CHECK(dal_step(falling, NULL) == DAL_SUCCESS);
    dal_stepper_stats(falling, &stats);
    CHECK(stats.unscaled == 1);
    CHECK(dal_stepper_start(falling, 0.0, 1.0, faster, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EDOMAIN);
}

/* A callback that fails now: what the first, or the second, plain step of a step does then. */
typedef struct fuse {
    int calls, until, returns;
} fuse;

static int fused(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    fuse *const f = ctx;
    if (f->calls++ == f->until) return f->returns;
    return pendulum(t, q, V, V_q, V_qq, NULL);
}

static void test_failures(void)
{
    const double mass = 1.0, state[2] = {0.3, 1.0};
    fuse f = {.until = -1};
    const dal_system_def def = {.n = 1, .mass = &mass, .potential = fused, .state = state,
                                .ctx = &f};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = keeping(system, "leapfrog");
    dal_stepper *const plain = open_named(system, "leapfrog");
    double x[2], saved[MOST_SAVED], again[MOST_SAVED];
    dal_stats stats;
    const size_t count = dal_stepper_saved(stepper);
    CHECK(count <= MOST_SAVED);
    begin(stepper, NULL, 0.1);
    CHECK(dal_advance(stepper, 3, NULL, NULL) == DAL_SUCCESS);
    f.calls = 0;
    memcpy(x, dal_stepper_state(stepper), sizeof x);
    CHECK(dal_stepper_save(stepper, saved) == DAL_SUCCESS);
    CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
    const int calls = f.calls;
    begin(plain, x, 0.1);
    CHECK(dal_step(plain, NULL) == DAL_SUCCESS);
    CHECK(calls == 4); /* V_q at the node, V at the end: twice */
    for (int returns = -1; returns <= 1; returns += 2)
        for (int k = 0; k < calls; k++) {
            CHECK(dal_stepper_restore(stepper, saved, count) == DAL_SUCCESS);
            f = (fuse){.until = k, .returns = returns};
            const int status = dal_step(stepper, NULL);
            const bool through = returns > 0 && k > 0; /* the plain step exists */
            f.until = -1;
            CHECK(status == (through ? DAL_SUCCESS : returns > 0 ? DAL_EDOMAIN : DAL_EUSER));
            CHECK(through ? is_near(2, dal_stepper_state(stepper), dal_stepper_state(plain))
                          : memcmp(dal_stepper_state(stepper), x, sizeof x) == 0);
            dal_stepper_stats(stepper, &stats);
            CHECK(stats.unscaled == through && stats.steps == 3 + (size_t)through);
            if (through) continue;
            CHECK(dal_step(stepper, NULL) == DAL_SUCCESS && dal_stepper_save(stepper, again) == 0);
        }
    /* an error of a start */
    f = (fuse){.until = 1, .returns = -1};
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, state, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EUSER);
    CHECK(f.calls == 2);
    f = (fuse){.until = 2, .returns = 1}; /* the energy that is to be kept */
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, state, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EDOMAIN);
}

static void test_saved(void)
{
    for (int which = QUARTIC; which <= GYROSCOPIC; which++) {
        dal_system *const system = open_own(which);
        dal_stepper *const one = keeping(system, "leapfrog-suzuki4");
        dal_stepper *const other = keeping(system, "leapfrog-suzuki4");
        dal_stepper *const plain = open_named(system, "leapfrog-suzuki4");
        const size_t count = dal_stepper_saved(one);
        double values[MOST_SAVED], bad[MOST_SAVED];
        dal_stats a, b;
        CHECK(count <= MOST_SAVED);
        begin(one, NULL, 0.2);
        begin(plain, NULL, 0.2);
        CHECK(dal_advance(one, 37, NULL, NULL) == DAL_SUCCESS);
        CHECK(dal_stepper_save(one, values) == DAL_SUCCESS);
        CHECK(dal_stepper_restore(plain, values, count) == DAL_EINVAL);
        CHECK(strstr(dal_stepper_error(plain)->text, "keep_energy = 1; expected 0") != NULL);
        CHECK(dal_stepper_save(plain, bad) == DAL_SUCCESS);
        CHECK(dal_stepper_restore(other, bad, count) == DAL_EINVAL);
        CHECK(dal_stepper_restore(other, values, count) == DAL_SUCCESS);
        CHECK(dal_advance(one, 100, NULL, NULL) == 0 && dal_advance(other, 100, NULL, NULL) == 0);
        CHECK(memcmp(dal_stepper_state(one), dal_stepper_state(other), 6 * sizeof *bad) == 0);
        dal_stepper_stats(one, &a);
        dal_stepper_stats(other, &b);
        CHECK(a.scaled == b.scaled && a.constraint_calls == b.constraint_calls);
        CHECK(one->scaling.energy == other->scaling.energy);
        CHECK(one->energy_jump.undone == other->energy_jump.undone);
        CHECK(one->energy_jump.undone != 0.0);
        for (size_t i = count - 1; i < count; i--) { /* no number may lead astray without a word */
            memcpy(bad, values, count * sizeof *bad);
            bad[i] = -1.5;
            if (dal_stepper_restore(other, bad, count) == DAL_SUCCESS) dal_step(other, NULL);
        }
        release(system);
    }
}

/* Steps of any size keep the energy, and still lead along the motion that the reference gives. */
static void test_any_size(void)
{
    static const dal_options options[] = {{.keep_energy = 1, .tolerance = 1e-9},
                                          {.keep_energy = 1, .eps = 0.05}};
    const double end = 3.0;
    for (int which = QUARTIC; which <= GYROSCOPIC; which++)
        for (size_t k = 0; k < DAL_LENGTH(options); k++) {
            dal_system *const system = open_own(which);
            if (k == 1 && !system->mass) continue; /* no reversible steps */
            const dal_scheme record = find_scheme("leapfrog-kl6"), exact = find_scheme("reference");
            dal_stepper *const stepper = open_stepper(system, &record, &options[k]);
            dal_stepper *const reference = open_stepper(system, &exact, NULL);
            dal_mechanics *const mechanics = open_mechanics(system);
            dal_stats stats;
            begin(stepper, NULL, (double)INFINITY);
            begin(reference, NULL, end);
            const double E = energy_of(mechanics, dal_stepper_state(stepper));
            CHECK(dal_stepper_until(stepper, end) == 0 && dal_step(reference, NULL) == 0);
            while (dal_stepper_time(stepper) < end && dal_step(stepper, NULL) == 0)
                CHECK_NEAR(energy_of(mechanics, dal_stepper_state(stepper)), E, 16.0 * U * fabs(E));
            CHECK(dal_stepper_time(stepper) == end);
            /* a step that is taken back does not count */
            const double undone = stepper->energy_jump.undone;
            dal__snapshot_take(stepper, &stepper->variable.before);
            CHECK(dal__variable_step(stepper, end, 0.1) == DAL_SUCCESS);
            CHECK(stepper->energy_jump.undone != undone);
            dal__snapshot_restore(stepper, &stepper->variable.before);
            CHECK(stepper->energy_jump.undone == undone);
            for (size_t i = 0; i < 2 * system->def.n; i++)
                CHECK_NEAR(dal_stepper_state(stepper)[i], dal_stepper_state(reference)[i], 1e-6);
            dal_stepper_stats(stepper, &stats);
            CHECK(stats.scaled > 0 && stats.scaled + stats.unscaled <= stats.steps);
            release(system);
        }
}

static int drag(double t, const double *q, const double *v, const double *u, double *f, double *f_q,
                double *f_v, void *ctx)
{
    (void)t, (void)q, (void)u, (void)ctx;
    if (f) f[0] = -v[0];
    if (f_q) *f_q = 0.0;
    if (f_v) *f_v = -1.0;
    return 0;
}

static void refuse(const dal_system *system, const char *name, dal_options options,
                   const char *words)
{
    const dal_scheme scheme = find_scheme(name);
    dal_stepper *stepper = NULL;
    dal_error error = {0};
    const int status = dal_stepper_new(&stepper, system, &scheme, &options, &error);
    CHECK(status == (options.keep_energy == 1 ? DAL_EUNSUPPORTED : DAL_EINVAL) && !stepper);
    CHECK(strstr(error.text, words) != NULL);
}

/* Symmetric, with moved nodes, but not of the family beta. */
static int go_nowhere(void *method, dal_motion *motion, size_t steps, size_t *done)
{
    (void)method, (void)motion;
    *done = steps;
    return DAL_SUCCESS;
}

static void test_refused(void)
{
    dal_system *const edge = open_system("knife_edge");
    refuse(edge, "explicit", keep, "\"explicit\"; choose a symmetric");
    refuse(edge, "reference", keep, "\"reference\"; choose a symmetric");
    refuse(edge, "pair:0.5:0.5", keep, "choose a symmetric scheme of the family beta");
    refuse(edge, "midpoint-nodes", keep, "kept nodes");
    refuse(edge, "leapfrog", (dal_options){.keep_energy = 2}, "keep_energy = 2");
    static const dal_family nowhere = {.name = "nowhere", .advance = go_nowhere};
    const dal_scheme scheme = {.name = "nowhere", .family = &nowhere, .symmetric = 1};
    dal_stepper *stepper = NULL;
    CHECK(dal_stepper_new(&stepper, edge, &scheme, &keep, NULL) == DAL_EUNSUPPORTED);

    const double mass[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    const dal_system_def defs[] = {
        {.n = 3, .m = 1, .mass = mass, .constraint = contact, .kind = DAL_AFFINE},
        {.n = 3, .m = 1, .mass = mass, .constraint = contact, .kind = DAL_NONLINEAR},
        {.n = 1, .mass = mass, .force = drag},
        {.n = 1, .mass = mass, .potential = swinging, .time_dependent = 1}};
    const char *const words[] = {"has affine constraints", "has nonlinear constraints",
                                 "has a force", "dependence on time"};
    for (int i = 0; i < 4; i++) {
        dal_system *const system = new_system(&defs[i]);
        refuse(system, "leapfrog", keep, words[i]);
        release(system);
    }
    /* L of another degree in v is found at the start */
    dal_system *const other = open_own(NOT_QUADRATIC);
    double x[6];
    dal_system_state(other, x);
    stepper = keeping(other, "leapfrog");
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EUNSUPPORTED);
    CHECK(strstr(dal_stepper_error(stepper)->text, "quadratic in v") != NULL);
    memset(x + 3, 0, 3 * sizeof *x); /* and from rest too */
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EUNSUPPORTED);
}

/* ---- runs ----------------------------------------------------------------------------------- */

static int wall(double t, const double *x, double *g, void *ctx)
{
    (void)t, (void)ctx;
    *g = x[0] - 0.9;
    return 0;
}

static int bounce(double t, double *x, void *ctx)
{
    (void)t, (void)ctx;
    for (int i = 3; i < 6; i++) x[i] *= -0.9;
    return 0;
}

typedef struct bounces {
    dal_mechanics *mechanics;
    double energy; /* since the last of them */
    size_t count;
} bounces;

static int bounced(size_t event, size_t step, double t, const double *x, const double *after,
                   void *ctx)
{
    bounces *const b = ctx;
    (void)event, (void)step, (void)t;
    CHECK_NEAR(energy_of(b->mechanics, x), b->energy, 1e-14);
    b->energy = energy_of(b->mechanics, after);
    b->count++;
    return 0;
}

static int look(size_t step, double t, const double *x, void *ctx)
{
    const bounces *const b = ctx;
    (void)step, (void)t;
    CHECK_NEAR(energy_of(b->mechanics, x), b->energy, 1e-14);
    return 0;
}

/* Each reset is a new start: its energy is kept to the next, also within steps, and at output
 * times. */
static void test_events(void)
{
    enum { STEPS = 300, TIMES = 3 };
    dal_system *const system = open_own(QUARTIC);
    const dal_scheme leapfrog = find_scheme("leapfrog");
    const dal_event list[1] = {{.g = wall, .direction = 1, .reset = bounce}};
    const double wanted[TIMES] = {0.013, 0.1777, 0.25};
    double at[TIMES * 6];
    dal_error error = {0};
    dal_stepper *const stepper = keeping(system, "leapfrog");
    begin(stepper, NULL, 0.1);
    bounces b = {.mechanics = open_mechanics(system)};
    const double E = b.energy = energy_of(b.mechanics, dal_stepper_state(stepper));
    dal_events *events = NULL;
    need(dal_events_new(&events, stepper, &leapfrog, list, 1, &error), "events", error.text);
    dal_run run = {.stepper = stepper, .steps = STEPS, .stride = 1, .events = events,
                   .times = wanted, .time_count = TIMES, .x_at_times = at, .happened = bounced,
                   .happened_ctx = &b, .observer = look, .observer_ctx = &b};
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS);
    CHECK(b.count >= 3 && b.energy < 0.9 * E);
    for (int k = 0; k < TIMES; k++) CHECK_NEAR(energy_of(b.mechanics, at + 6 * k), E, 1e-14);
    dal_events_free(events);
}

/* Members have the bits that they have alone, also where lanes were asked for. */
static void test_members(void)
{
    dal_system *const system = open_system("contact_oscillator");
    const dal_scheme leapfrog = find_scheme("leapfrog");
    const size_t steps = 200;
    const double h[3] = {0.1, 0.05, -0.1};
    double states[3 * 6];
    dal_stats stats[3];
    dal_error error = {0};
    const dal_members members = {.count = 3, .h = h, .h_next = 1, .steps = &steps,
                                 .states = states, .stats = stats, .lanes = 1};
    CHECK(dal_ensemble_run(system, &leapfrog, &keep, &members, 0, 3, NULL, NULL, &error) == 0);
    for (int k = 0; k < 3; k++) {
        dal_stepper *const stepper = keeping(system, "leapfrog");
        begin(stepper, NULL, h[k]);
        CHECK(dal_advance(stepper, steps, NULL, NULL) == DAL_SUCCESS);
        CHECK(memcmp(states + 6 * k, dal_stepper_state(stepper), 6 * sizeof *states) == 0);
        CHECK(stats[k].scaled == steps);
        release(stepper);
    }
}

int main(void)
{
    test_step();
    test_kept();
    test_order();
    test_limits();
    test_failures();
    test_saved();
    test_any_size();
    test_refused();
    test_events();
    test_members();
    return check_done();
}
