/* Reversible steps: that they lead back, what they keep, where they end, and runs of them. */
#include "fixtures.h"
#include "check.h"

#include "dalembert/events.h"
#include "step/reversible.h"
#include "step/stepper.h"

enum { MOST_2N = 16, MOST = 4000 };

static dal__reversible *of_steps(const dal_stepper *stepper) { return stepper->control_data; }

/* ---- orbit: a planet that turns a screw -----------------------------------------------------
 * Kepler's motion of (x, y), V = -1 / sqrt(x^2 + y^2), and z' = c (x y' - y x'), with masses 1.
 * The reaction vanishes: the orbit is an ellipse, and z grows by c times the angular momentum. */

typedef struct orbit {
    double time, twist; /* unit of time; c */
} orbit;

static int attraction(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double unit = ((const orbit *)ctx)->time, k = 1.0 / (unit * unit);
    const double r2 = q[0] * q[0] + q[1] * q[1], r = sqrt(r2), r3 = r * r2;
    (void)t;
    if (!(r > 1e-3)) return 1;
    if (V) *V = -k / r;
    if (V_q) memset(V_q, 0, 3 * sizeof *V_q);
    if (V_qq) memset(V_qq, 0, 9 * sizeof *V_qq);
    for (int i = 0; i < 2; i++) {
        if (V_q) V_q[i] = k * q[i] / r3;
        for (int j = 0; V_qq && j < 2; j++)
            V_qq[3 * i + j] = k * ((i == j) / r3 - 3.0 * q[i] * q[j] / (r3 * r2));
    }
    return 0;
}

static int screw(double t, const double *q, const double *v, double *phi, double *phi_v,
                 double *phi_q, double *phi_t, void *ctx)
{
    const double c = ((const orbit *)ctx)->twist;
    (void)t, (void)phi_t;
    if (phi) *phi = v[2] + c * (q[1] * v[0] - q[0] * v[1]);
    if (phi_v) memcpy(phi_v, (double[]){c * q[1], -c * q[0], 1.0}, 3 * sizeof *phi_v);
    if (phi_q) memcpy(phi_q, (double[]){-c * v[1], c * v[0], 0.0}, 3 * sizeof *phi_q);
    return 0;
}

/* From its aphelion, with eccentricity 0.9 and half axis 1: its period is 2 pi units. */
static dal_system *open_orbit(orbit *of, double *state)
{
    static const double masses[3] = {1.0, 1.0, 1.0};
    const double v = sqrt(0.1 / 1.9) / of->time;
    memcpy(state, (double[]){1.9, 0.0, 0.0, 0.0, v, 1.9 * of->twist * v}, 6 * sizeof *state);
    const dal_system_def def = {.n = 3, .m = 1, .masses = masses, .potential = attraction,
                                .constraint = screw, .state = state, .ctx = of, .name = "orbit"};
    return new_system(&def);
}

static dal_stepper *reversible(const dal_system *system, const char *scheme, double eps)
{
    const dal_scheme record = find_scheme(scheme);
    return open_stepper(system, &record, &(dal_options){.eps = eps});
}

static void begin_at(dal_stepper *stepper, double t0, double ahead, const double *x)
{
    need(dal_stepper_start(stepper, t0, ahead * (double)INFINITY, x, DAL_CHECK, DAL_INITIAL_NONE),
         "start", dal_stepper_error(stepper)->text);
}

static void begin(dal_stepper *stepper, const dal_system *system)
{
    double x[MOST_2N];
    need(dal_system_state(system, x), "state", "");
    begin_at(stepper, 0.0, 1.0, x);
}

/* The largest |E - E_0| in steps up to t; with fresh, rho is made sigma after each step. */
static double drift(dal_stepper *stepper, dal_mechanics *mechanics, double t, double E0, bool fresh)
{
    double worst = 0.0, E = 0.0;
    while (dal_stepper_time(stepper) < t) {
        if (fresh) of_steps(stepper)->settled = false;
        if (dal_step(stepper, NULL)) exit(2);
        if (dal_energy(mechanics, 0.0, dal_stepper_state(stepper), &E)) exit(2);
        worst = fmax(worst, fabs(E - E0));
    }
    return worst;
}

static void copy_scales(dal_stepper *stepper, const dal__reversible *from)
{
    dal__reversible *const of = of_steps(stepper);
    of->rho = from->rho;
    of->speed = from->speed;
    of->fastest = from->fastest;
    of->settled = from->settled;
}

/* Steps until the motion has its scales, which then are made too large to change again. */
static void settle(dal_stepper *stepper)
{
    if (dal_advance(stepper, 300, NULL, NULL)) exit(2);
    of_steps(stepper)->speed *= 2.0;
    of_steps(stepper)->fastest *= 2.0;
    of_steps(stepper)->settled = false;
    if (dal_advance(stepper, 20, NULL, NULL)) exit(2);
}

/* ---- what they keep ------------------------------------------------------------------------- */

/* With rho of the step before, and v or time turned round, as many steps lead back, but for
 * roundoff and its growth; D is kept, and each time is the sum of the one before and h. */
static void test_back(void)
{
    static const char *const systems[] = {"orbit", "knife_edge", "robot", "contact_oscillator",
                                          "uneven_edge", "particle_oscillator", "disk"};
    static const char *const schemes[] = {"bm6", "leapfrog-kl8", "midpoint-suzuki4"};
    enum { STEPS = 150 };
    for (size_t s = 0; s < DAL_LENGTH(systems); s++)
        for (size_t k = 0; k < DAL_LENGTH(schemes); k++)
            for (int turned = 0; turned < 2; turned++) {
                orbit of = {1.0, 1.0};
                double x0[MOST_2N], x[MOST_2N];
                dal_system *const system =
                    s == 0 ? open_orbit(&of, x0) : open_system(systems[s]);
                const size_t n = dal_system_n(system);
                dal_stepper *const stepper = reversible(system, schemes[k], 0.125);
                need(dal_system_state(system, x0), "state", "");
                begin_at(stepper, 0.0, 1.0, x0);
                settle(stepper);
                const size_t resets = stats_of(stepper).resets;
                dal__reversible then = *of_steps(stepper);
                memcpy(x0, dal_stepper_state(stepper), 2 * n * sizeof *x0);
                double longest = 0.0, shortest = HUGE_VAL;
                for (int i = 0; i < STEPS; i++) {
                    const double t = dal_stepper_time(stepper);
                    then = *of_steps(stepper);
                    CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
                    const double h = dal_stepper_h(stepper);
                    CHECK(dal_stepper_time(stepper) - t == h && t + h == dal_stepper_time(stepper));
                    CHECK(residual_of(system, 0.0, dal_stepper_state(stepper)) <= 4.0 * n * U);
                    longest = fmax(longest, h);
                    shortest = fmin(shortest, h);
                }
                CHECK(stats_of(stepper).resets == resets);
                memcpy(x, dal_stepper_state(stepper), 2 * n * sizeof *x);
                for (size_t i = n; turned && i < 2 * n; i++) x[i] = -x[i];
                begin_at(stepper, 0.0, turned ? 1.0 : -1.0, x);
                copy_scales(stepper, &then);
                for (int i = 0; i < STEPS; i++) CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
                memcpy(x, dal_stepper_state(stepper), 2 * n * sizeof *x);
                for (size_t i = n; turned && i < 2 * n; i++) x[i] = -x[i];
                for (size_t i = 0; i < 2 * n; i++) /* 1e-12 h of roundoff in each h */
                    CHECK_NEAR(x[i], x0[i], 2e-9 * (1.0 + fabs(x0[i])));
                if (s == 0) CHECK(longest > 15.0 * shortest);
                release(system);
            }
}

/* The energy comes and goes over 60 periods; with h = eps / sigma(x_n) it is lost, period by
 * period. */
static void test_energy(void)
{
    orbit of = {1.0, 1.0};
    double x[6], E0 = 0.0, worst[2][2];
    const double period = 2.0 * acos(-1.0);
    dal_system *const system = open_orbit(&of, x);
    dal_mechanics *const mechanics = open_mechanics(system);
    CHECK(dal_energy(mechanics, 0.0, x, &E0) == DAL_SUCCESS);
    for (int fresh = 0; fresh < 2; fresh++) {
        dal_stepper *const stepper = reversible(system, "bm6", 0.15);
        begin(stepper, system);
        for (int k = 0; k < 2; k++)
            worst[fresh][k] = drift(stepper, mechanics, 30.0 * (k + 1) * period, E0, fresh);
        CHECK(stats_of(stepper).resets <= 1);
        release(stepper);
    }
    CHECK(worst[0][0] < 2e-7 && worst[0][1] < 1.01 * worst[0][0]);
    CHECK(worst[1][0] > 3.0 * worst[0][0] && worst[1][1] > 1.9 * worst[1][0]);
}

/* sigma on a circle by hand: |a| = |v| = |j| = v0 = 1, s^2 = 2, own^4 = 1/4 + 1/2; the differences
 * are those of chords of 0.01. */
static void test_sigma(void)
{
    orbit of = {1.0, 0.0};
    double x[6];
    dal_system *const system = open_orbit(&of, x);
    dal_stepper *const stepper = reversible(system, "bm6", 0.15);
    memcpy(x, (double[]){1.0, 0.0, 0.0, 0.0, 1.0, 0.0}, sizeof x);
    begin_at(stepper, 0.0, 1.0, x);
    CHECK(dal_advance(stepper, 100, NULL, NULL) == DAL_SUCCESS && of_steps(stepper)->settled);
    const double own2 = sqrt(0.75);
    CHECK_NEAR(of_steps(stepper)->speed, 1.0, 1e-9);
    CHECK_NEAR(of_steps(stepper)->rho, sqrt(own2 * (1.0 + 0.02 * 0.02 + 0.36 * 0.36)), 1e-4);
}

/* The same steps by other forms of D, in another unit of time, and with other coordinates. */
static void test_invariance(void)
{
    static const char *const systems[] = {"contact_oscillator", "uneven_edge", "generic4"};
    enum { STEPS = 60 };
    double rho[STEPS], x[MOST_2N];
    for (size_t s = 0; s < DAL_LENGTH(systems); s++)
        for (int mixed = 0; mixed < 2; mixed++) {
            static dal__reversible settled;
            dal_system *const base = open_system(systems[s]);
            dal_system *const system = mixed ? open_mixed(base) : base;
            dal_stepper *const stepper = reversible(system, "bm6", 0.15);
            if (!mixed) {
                begin(stepper, base);
                settle(stepper);
                memcpy(x, dal_stepper_state(stepper), 2 * dal_system_n(base) * sizeof *x);
                settled = *of_steps(stepper);
            }
            begin_at(stepper, 0.0, 1.0, x);
            copy_scales(stepper, &settled);
            for (int k = 0; k < STEPS; k++) {
                CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
                if (mixed && k < 20) /* but for the states near x, in D by O(h^3) */
                    CHECK_NEAR(of_steps(stepper)->rho / rho[k], 1.0, 1e-5);
                rho[k] = of_steps(stepper)->rho;
            }
            release(base);
        }
    for (int k = 0; k < 2; k++) {
        orbit of = {k ? 0x1p7 : 1.0, 1.0};
        double state[6];
        dal_system *const system = open_orbit(&of, state);
        dal_stepper *const stepper = reversible(system, "bm6", 0.15);
        begin(stepper, system);
        for (int i = 0; i < STEPS; i++) {
            CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
            if (k) CHECK_NEAR(of_steps(stepper)->rho * of.time / rho[i], 1.0, 1e-9);
            rho[i] = of_steps(stepper)->rho;
        }
        release(system);
    }
}

/* rho stays near sigma, and the energy where it was: also where nothing pushes at the start, from
 * rest, and from next to rest. */
static void test_motions(void)
{
    static const struct {
        const char *name;
        size_t i;
        double from, scale;
    } cases[] = {{"robot", 3, 0.0, 1.0}, {"robot", 3, 0.0, 1e-6}, {"robot", 3, 0.3, 1.0},
                 {"robot", 3, 1.5, 1.0}, {"knife_edge", 0, 0.0, 1.0},
                 {"contact_oscillator", 0, 0.0, 0.0}, {"particle_oscillator", 0, 0.0, 1.0},
                 {"disk", 0, 0.0, 1.0}};
    for (size_t c = 0; c < DAL_LENGTH(cases); c++) {
        double x[MOST_2N], E0 = 0.0;
        dal_system *const system = open_system(cases[c].name);
        const size_t n = dal_system_n(system);
        dal_mechanics *const mechanics = open_mechanics(system);
        dal_stepper *const stepper = reversible(system, "leapfrog-kl8", 0.1875);
        dal_system_state(system, x);
        x[cases[c].i] += cases[c].from;
        for (size_t i = n; i < 2 * n; i++) x[i] *= cases[c].scale;
        begin_at(stepper, 0.0, 1.0, x);
        CHECK(dal_energy(mechanics, 0.0, x, &E0) == DAL_SUCCESS);
        CHECK(drift(stepper, mechanics, 100.0, E0, false) < 2e-7 * (1.0 + fabs(E0)));
        CHECK(stats_of(stepper).resets <= 10); /* in 600 steps and more */
        release(system);
    }
}

/* ---- wells and walls ------------------------------------------------------------------------ */

typedef struct well {
    double power, steepness; /* V = x^power / power, or exp(k (x - 1)) + exp(-k (x + 1)) */
} well;

static double energy_in(const well *of, double x, double v)
{
    const double k = of->steepness;
    return 0.5 * v * v + (k > 0.0 ? exp(k * (x - 1.0)) + exp(-k * (x + 1.0))
                                  : pow(x, of->power) / of->power);
}

static int inside(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const well *const of = ctx;
    const double x = q[0], k = of->steepness, p = of->power;
    const double right = exp(k * (x - 1.0)), left = exp(-k * (x + 1.0));
    (void)t;
    if (V) *V = energy_in(of, x, 0.0);
    if (V_q) *V_q = k > 0.0 ? k * (right - left) : pow(x, p - 1.0);
    if (V_qq) *V_qq = k > 0.0 ? k * k * (right + left) : (p - 1.0) * pow(x, p - 2.0);
    return 0;
}

/* What is flat in its middle: from there, from next to it, from rest at the edge; with steps that
 * begin too long or too short by many orders.  The energy is the closed form above. */
static void test_wells(void)
{
    static const double masses[1] = {1.0};
    static const struct {
        well of;
        double x, v;
    } cases[] = {{{4.0, 0.0}, 0.0, 1.0}, {{4.0, 0.0}, 1e-8, 1.0}, {{4.0, 0.0}, 1e-30, 1.0},
                 {{4.0, 0.0}, 1.0, 0.0}, {{4.0, 0.0}, 0.7, 0.3}, {{6.0, 0.0}, 0.0, 2.0},
                 {{2.0, 20.0}, 6e-17, 1.0}, {{2.0, 20.0}, 0.9, 0.0}, {{2.0, 100.0}, 1e-3, 1.0}};
    for (size_t c = 0; c < DAL_LENGTH(cases); c++) {
        const double x[2] = {cases[c].x, cases[c].v};
        const dal_system_def def = {.n = 1, .masses = masses, .potential = inside, .state = x,
                                    .ctx = (void *)&cases[c].of};
        dal_system *const system = new_system(&def);
        dal_stepper *const stepper = reversible(system, "bm6", 0.168);
        begin_at(stepper, 0.0, 1.0, x);
        const double E0 = energy_in(&cases[c].of, x[0], x[1]);
        double worst = 0.0, longest = 0.0;
        while (dal_stepper_time(stepper) < 50.0 && !dal_step(stepper, NULL)) {
            const double *const now = dal_stepper_state(stepper);
            worst = fmax(worst, fabs(energy_in(&cases[c].of, now[0], now[1]) - E0));
            longest = fmax(longest, dal_stepper_h(stepper));
        }
        CHECK(dal_stepper_time(stepper) >= 50.0 && worst < 1e-6 * E0 && longest < 1.0);
        CHECK(stats_of(stepper).resets <= 4 && stats_of(stepper).rejected > 0);
        release(system);
    }
    /* next to rest in the flat middle: a straight line, where all estimates are roundoff */
    const well flat = {8.0, 0.0};
    const double slow[2] = {4.48739104e-05, -5.1190761e-16};
    const dal_system_def of_slow = {.n = 1, .masses = masses, .potential = inside, .state = slow,
                                    .ctx = (void *)&flat};
    dal_system *const middle = new_system(&of_slow);
    dal_stepper *const drifting = reversible(middle, "bm6", 0.168);
    begin_at(drifting, 0.0, 1.0, slow);
    CHECK(dal_stepper_until(drifting, 40.0) == DAL_SUCCESS);
    for (int k = 0; k < 50 && dal_stepper_time(drifting) < 40.0; k++)
        CHECK(dal_step(drifting, NULL) == DAL_SUCCESS);
    CHECK(dal_stepper_time(drifting) == 40.0);
    CHECK_NEAR(dal_stepper_state(drifting)[0], slow[0] + 40.0 * slow[1], 4.0 * U * slow[0]);
    /* squares of this overflow: no time may be NaN */
    const well quartic = {4.0, 0.0};
    const double x[2] = {0.0, 1e160};
    const dal_system_def def = {.n = 1, .masses = masses, .potential = inside, .state = x,
                                .ctx = (void *)&quartic};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = reversible(system, "bm6", 0.168);
    begin_at(stepper, 0.0, 1.0, x);
    CHECK(dal_step(stepper, NULL) < 0 && dal_stepper_time(stepper) == 0.0);
}

/* ---- where they end, saved, refused --------------------------------------------------------- */

/* Only the last step is shortened; one that goes on from there knows by how much. */
static void test_until(void)
{
    dal_system *const system = open_system("contact_oscillator");
    dal_stepper *const one = reversible(system, "bm6", 0.15);
    dal_stepper *const other = reversible(system, "bm6", 0.15);
    double rho = 0.0;
    for (int back = 0; back < 2; back++) {
        double x[MOST_2N];
        const double end = back ? -5.25 : 5.25;
        dal_system_state(system, x);
        begin_at(one, 0.0, back ? -1.0 : 1.0, x);
        begin_at(other, 0.0, back ? -1.0 : 1.0, x);
        CHECK(dal_stepper_until(one, -end) == DAL_EINVAL);
        CHECK(dal_stepper_until(one, end) == DAL_SUCCESS);
        while (dal_stepper_time(one) != end) {
            rho = of_steps(one)->rho;
            CHECK(dal_step(one, NULL) == DAL_SUCCESS && dal_step(other, NULL) == DAL_SUCCESS);
            if (dal_stepper_time(one) == end) break;
            CHECK(dal_stepper_h(one) == dal_stepper_h(other));
        }
        CHECK(fabs(dal_stepper_h(one)) < fabs(dal_stepper_h(other)));
        CHECK(dal_step(one, NULL) == DAL_EINVAL);
        CHECK(dal_stepper_until(one, 2.0 * end) == DAL_SUCCESS);
        CHECK(dal_step(one, NULL) == DAL_SUCCESS && stats_of(one).resets == 0);
        CHECK_NEAR(of_steps(one)->rho, rho, 0.2 * rho);
    }
}

/* rho belongs to the middle of its step.  After a step that was cut short it is the one of the
 * uncut motion in the middle of the step that follows, but for the bend of rho. */
static void test_cut(void)
{
    enum { STEPS = 60 };
    orbit of = {1.0, 1.0};
    double x[6], middle[STEPS], rho[STEPS], t[STEPS + 1];
    dal_system *const system = open_orbit(&of, x);
    dal_stepper *const whole = reversible(system, "bm6", 0.1);
    dal_stepper *const cut = reversible(system, "bm6", 0.1);
    begin(whole, system);
    settle(whole);
    const dal__reversible settled = *of_steps(whole);
    memcpy(x, dal_stepper_state(whole), sizeof x);
    begin_at(whole, 0.0, 1.0, x);
    copy_scales(whole, &settled);
    for (int k = 0; k < STEPS; k++) {
        t[k] = dal_stepper_time(whole);
        rho[k] = of_steps(whole)->rho;
        CHECK(dal_step(whole, NULL) == DAL_SUCCESS);
        t[k + 1] = dal_stepper_time(whole);
        middle[k] = 0.5 * (t[k] + t[k + 1]);
    }
    CHECK(stats_of(whole).resets == 0);
    double worst = 0.0, change = 0.0;
    for (int k = 1; k + 2 < STEPS; k++)
        for (double part = 0.25; part < 1.0; part += 0.25) {
            begin_at(cut, 0.0, 1.0, x);
            copy_scales(cut, &settled);
            const double end = t[k] + part * (t[k + 1] - t[k]);
            CHECK(dal_stepper_until(cut, end) == DAL_SUCCESS);
            while (dal_stepper_time(cut) < end) CHECK(dal_step(cut, NULL) == DAL_SUCCESS);
            const double at = end + 0.05 / of_steps(cut)->rho;
            const double share = (at - middle[k]) / (middle[k + 1] - middle[k]);
            const double between = rho[k] + share * (rho[k + 1] - rho[k]);
            worst = fmax(worst, fabs(of_steps(cut)->rho / between - 1.0));
            change = fmax(change, fabs(rho[k + 1] / rho[k] - 1.0));
        }
    CHECK(worst < 0.01 && change > 0.1);
}

static void test_saved(void)
{
    enum { SAVED = 200 };
    dal_system *const system = open_system("robot");
    dal_stepper *const one = reversible(system, "bm6", 0.125);
    dal_stepper *const other = reversible(system, "bm6", 0.125);
    dal_stepper *const strange = reversible(system, "bm6", 0.1);
    dal_stepper *const plain = open_named(system, "bm6");
    const size_t count = dal_stepper_saved(one), N = 2 * dal_system_n(system);
    double values[SAVED], bad[SAVED], x[MOST_2N];
    CHECK(count <= SAVED);
    begin(one, system);
    dal_system_state(system, x);
    need(dal_stepper_start(plain, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE), "start", "");
    CHECK(dal_stepper_until(one, 4.0) == DAL_SUCCESS);
    while (dal_stepper_time(one) < 4.0 && !dal_step(one, NULL)) continue;
    CHECK(dal_stepper_until(one, (double)INFINITY) == DAL_SUCCESS);
    CHECK(dal_stepper_save(one, values) == DAL_SUCCESS);
    CHECK(dal_stepper_restore(strange, values, count) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(strange)->text, "eps = 0.125") != NULL);
    CHECK(dal_stepper_restore(plain, values, count) == DAL_EINVAL);
    CHECK(dal_stepper_restore(other, values, count) == DAL_SUCCESS);
    for (int k = 0; k < 100; k++) {
        CHECK(dal_step(one, NULL) == DAL_SUCCESS && dal_step(other, NULL) == DAL_SUCCESS);
        CHECK(dal_stepper_time(one) == dal_stepper_time(other));
        CHECK(memcmp(dal_stepper_state(one), dal_stepper_state(other), N * sizeof *bad) == 0);
    }
    enum { RHO = 12, SETTLED = 15 }; /* among them v0^2 and the square of the largest rate */
    for (size_t i = 0; i < count; i++) { /* of which most are counters, or positive */
        memcpy(bad, values, count * sizeof *bad);
        bad[i] = -1.5;
        const int status = dal_stepper_restore(other, bad, count);
        if (i >= RHO && i <= SETTLED) CHECK(status == DAL_EINVAL);
        if (status == DAL_SUCCESS) dal_step(other, NULL);
    }
}

static void test_refused(void)
{
    dal_system *const system = open_system("knife_edge");
    dal_system *const curved = open_system("rolling_disc");
    dal_system *const affine = open_system("ball_on_table");
    STEPPER_REFUSED(system, "leapfrog", "a symmetric composition", .eps = 0.1);
    STEPPER_REFUSED(system, "midpoint", "a symmetric composition", .eps = 0.1);
    STEPPER_REFUSED(system, "explicit", "a symmetric composition", .eps = 0.1);
    STEPPER_REFUSED(system, "reference", "a symmetric composition", .eps = 0.1);
    STEPPER_REFUSED(system, "pair:0.5:0.5", "a symmetric composition", .eps = 0.1);
    STEPPER_REFUSED(system, "midpoint-nodes", "a symmetric composition", .eps = 0.1);
    STEPPER_REFUSED(system, "bm6", "options.eps = 0.25: expected a positive number up to 0.2",
            .eps = 0.25);
    STEPPER_REFUSED(system, "bm6", "options.eps = -0.1", .eps = -0.1);
    STEPPER_REFUSED(system, "bm6", "options.eps = nan", .eps = (double)NAN);
    STEPPER_REFUSED(system, "bm6", "tolerance = 0.001", .eps = 0.1, .tolerance = 1e-3);
    STEPPER_REFUSED(system, "bm6", "h_max = 1", .eps = 0.1, .h_max = 1.0);
    STEPPER_REFUSED(curved, "bm6", "a mass that depends on q, or terms", .eps = 0.1);
    STEPPER_REFUSED(affine, "bm6", "constraints that are not linear", .eps = 0.1);
    dal_system_def def = system->def;
    dal_system *other = NULL;
    def.compiled = NULL;
    def.ctx = system->def.ctx;
    def.ctx_size = 0;
    def.exact = NULL;
    def.steady = 0;
    def.time_dependent = 1;
    other = new_system(&def);
    STEPPER_REFUSED(other, "bm6", "dependence on time", .eps = 0.1);
    def.time_dependent = 0;
    def.force = no_force;
    other = new_system(&def);
    STEPPER_REFUSED(other, "bm6", "a force", .eps = 0.1);

    static const dal_substep crooked[] = {{0.5, 0.25}, {0.5, 0.5}, {0.5, 0.125}, {0.5, 0.125}};
    static const dal_substep lopsided[] = {{0.0, 0.25}, {0.5, 0.5}, {0.0, 0.25}};
    dal_scheme scheme = {.name = "own", .count = 4, .substeps = crooked, .symmetric = 1};
    double eps = -1.0;
    dal_error error = {0};
    CHECK(dal_scheme_eps(&scheme, &eps, &error) == DAL_EUNSUPPORTED && eps == -1.0);
    scheme.count = 3;
    scheme.substeps = lopsided;
    CHECK(dal_scheme_eps(&scheme, &eps, &error) == DAL_EUNSUPPORTED && eps == -1.0);
    CHECK(dal_scheme_eps(NULL, &eps, &error) == DAL_EINVAL);
    CHECK(dal_scheme_eps(&scheme, NULL, &error) == DAL_EINVAL);
    scheme = find_scheme("bm6");
    CHECK(dal_scheme_eps(&scheme, &eps, &error) == DAL_SUCCESS);
    CHECK_NEAR(eps, 0.8 / 5.940912118990053, 1e-14); /* by Python, from the numbers in the paper */
    scheme = find_scheme("midpoint-suzuki4");
    CHECK(dal_scheme_eps(&scheme, &eps, &error) == DAL_SUCCESS && eps == 0.2);
}

/* Starts that have no rate or are at rest, a size of one's own, and whoever wants steps of h. */
static void test_starts(void)
{
    dal_system *const system = open_system("knife_edge");
    dal_stepper *const stepper = reversible(system, "bm6", 0.125);
    double x[MOST_2N];
    CHECK(dal_stepper_until(stepper, 1.0) == DAL_EINVAL);
    dal_system_state(system, x);
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(stepper)->text, "expected INFINITY") != NULL);
    CHECK(dal_stepper_start(stepper, 0.0, (double)NAN, x, DAL_CHECK, DAL_INITIAL_NONE)
          == DAL_EINVAL);
    x[5] = 0.0; /* it does not turn: a straight line */
    begin_at(stepper, 0.0, 1.0, x);
    CHECK(dal_advance(stepper, 30, NULL, NULL) == DAL_SUCCESS && dal_stepper_h(stepper) > 1e3);
    begin(stepper, system);

    dal_system *const spring = open_system("particle_oscillator");
    dal_stepper *const still = reversible(spring, "bm6", 0.125);
    memset(x, 0, sizeof x);
    CHECK(dal_stepper_start(still, 0.0, (double)INFINITY, x, DAL_CHECK, DAL_INITIAL_NONE)
          == DAL_EDOMAIN);
    CHECK(strstr(dal_stepper_error(still)->text, "stays there") != NULL);
}

/* A step that fails leaves rho and all else as it was; rho that has gone astray is reset, and said
 * so. */
static int fails; /* so many calls from now */

static int failing(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    if (fails > 0 && --fails == 0) return -1;
    return attraction(t, q, V, V_q, V_qq, ctx);
}

static void test_failure(void)
{
    enum { SAVED = 200 };
    static const double masses[3] = {1.0, 1.0, 1.0};
    orbit of = {1.0, 1.0};
    double state[6], before[SAVED], after[SAVED];
    open_orbit(&of, state);
    const dal_system_def def = {.n = 3, .m = 1, .masses = masses, .potential = failing,
                                .constraint = screw, .state = state, .ctx = &of};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = reversible(system, "bm6", 0.15);
    dal_stepper *const other = reversible(system, "bm6", 0.15);
    const size_t count = dal_stepper_saved(stepper);
    begin(stepper, system);
    begin(other, system);
    CHECK(count <= SAVED && dal_advance(stepper, 300, NULL, NULL) == DAL_SUCCESS);
    CHECK(dal_advance(other, 300, NULL, NULL) == DAL_SUCCESS);
    for (int k = 1; k < 40; k++) {
        const double rho = of_steps(stepper)->rho, h = dal_stepper_h(stepper);
        const double t = dal_stepper_time(stepper);
        fails = k;
        if (dal_step(stepper, NULL) == DAL_SUCCESS) {
            fails = 0; /* it has fewer calls: this one is good */
            break;
        }
        CHECK(of_steps(stepper)->rho == rho && dal_stepper_h(stepper) == h);
        CHECK(dal_stepper_time(stepper) == t);
    }
    CHECK(dal_step(other, NULL) == DAL_SUCCESS);
    CHECK(dal_stepper_save(stepper, before) == DAL_SUCCESS);
    CHECK(dal_stepper_save(other, after) == DAL_SUCCESS);
    CHECK(memcmp(dal_stepper_state(stepper), dal_stepper_state(other), 6 * sizeof(double)) == 0);
    CHECK(of_steps(stepper)->rho == of_steps(other)->rho && fails == 0);

    const size_t resets = stats_of(stepper).resets;
    of_steps(other)->rho *= 3.0;     /* its step is too short */
    of_steps(stepper)->rho *= 0.375; /* and this one is too long: it is made again */
    const size_t again = stats_of(stepper).rejected;
    CHECK(dal_step(other, NULL) == DAL_SUCCESS && dal_step(stepper, NULL) == DAL_SUCCESS);
    CHECK(stats_of(other).resets == resets + 1 && stats_of(stepper).resets == resets + 1);
    CHECK(stats_of(stepper).rejected == again + 1);
}

/* ---- runs ----------------------------------------------------------------------------------- */

static double rows[(MOST + 2) * MOST_2N], times[MOST + 2], plain_times[MOST + 2];

static int wall(double t, const double *x, double *g, void *ctx)
{
    (void)t, (void)ctx;
    *g = x[0] - 0.4;
    return 0;
}

static int turn_back(double t, double *x, void *ctx)
{
    (void)t, (void)ctx;
    for (int i = 3; i < 6; i++) x[i] = -1.5 * x[i];
    return 0;
}

/* Output times leave the steps alone; a reset of the state is one of rho, and of what follows; and
 * the run ends where it is to end. */
static void test_runs(void)
{
    dal_system *const system = open_system("knife_edge");
    const dal_scheme kl8 = find_scheme("leapfrog-kl8");
    const double wanted[4] = {0.01, 0.2, 0.21, 0.35};
    double at[4 * 6], exact[6];
    dal_error error = {0};
    size_t stored = 0;
    for (int watched = 0; watched < 3; watched++) {
        const dal_event list[1] = {{.g = wall, .direction = 1, .reset = turn_back}};
        dal_stepper *const stepper = reversible(system, "leapfrog-kl8", 0.1875);
        dal_events *events = NULL;
        begin(stepper, system);
        if (watched)
            need(dal_events_new(&events, stepper, &kl8, list, watched - 1u, &error), "events",
                 error.text);
        dal_run run = {.stepper = stepper, .steps = MOST, .stride = 1, .until = 4.75, .x = rows,
                       .row_times = watched ? times : plain_times, .events = events,
                       .times = watched ? wanted : NULL, .time_count = watched ? 4 : 0,
                       .x_at_times = at};
        CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS);
        CHECK(run.row_times[run.stored - 1] == 4.75 && run.done + 1 == run.stored);
        if (watched == 1) {
            CHECK(run.stored == stored);
            CHECK(memcmp(times, plain_times, stored * sizeof *times) == 0);
        }
        stored = run.stored;
        if (watched) {
            dal_scheme reference = find_scheme("reference");
            dal_stepper *const flow = open_stepper(system, &reference, NULL);
            dal_system_state(system, exact);
            need(dal_stepper_start(flow, 0.0, 0.35, exact, DAL_CHECK, DAL_INITIAL_NONE), "flow",
                 "");
            need(dal_step(flow, NULL), "flow", "");
            CHECK(largest_difference(6, at + 18, dal_stepper_state(flow)) < 1e-9);
            release(flow);
        }
        for (size_t k = 0; k < stored; k++) {
            CHECK(residual_of(system, 0.0, rows + 6 * k) <= 12.0 * U);
            if (watched == 2) CHECK(rows[6 * k] <= 0.4 + 1e-12);
        }
        if (watched == 2) {
            size_t turned = 0;
            for (size_t k = 0; k + 1 < stored; k++)
                if (fabs(rows[6 * k] - 0.4) < 1e-12 && rows[6 * k + 3] < 0.0) turned = k;
            CHECK(turned > 0);
            /* the velocity jumps to -3/2 of it, and so do rates; rho does */
            const double h = times[turned + 2] - times[turned + 1];
            CHECK(turned > 2 && h < 0.8 * (times[turned - 1] - times[turned - 2]));
            CHECK(stats_of(stepper).resets == 0);
        }
        dal_events_free(events);
        release(stepper);
    }
}

int main(void)
{
    test_back();
    test_energy();
    test_sigma();
    test_invariance();
    test_motions();
    test_wells();
    test_until();
    test_cut();
    test_saved();
    test_refused();
    test_starts();
    test_failure();
    test_runs();
    return check_done();
}
