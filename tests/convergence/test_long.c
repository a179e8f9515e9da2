/* Long runs: D kept to roundoff after every one of up to 1e6 steps, without growth; D_eps likewise
 * for kept nodes; energy bounded without drift.
 *
 * mu is evaluated here, at the states that the stepper shows, after every step.  Angles of the
 * knife edge reach 1e4: there rounding q alone changes mu by 1e4 u, which a correction at an
 * unrounded q would leave. */
#include "check.h"
#include "fixtures.h"

enum { TENTHS = 10 };

/* One run. */
typedef struct run {
    const char *system, *scheme;
    dal_initial initial; /* not DAL_INITIAL_NONE: kept nodes, D_eps */
    double h;
    size_t steps;
} run;

static const run runs[] = {
    {"particle", "midpoint", DAL_INITIAL_NONE, 0.01, 200000},
    {"particle", "leapfrog", DAL_INITIAL_NONE, 0.01, 500000},
    {"sleigh", "midpoint", DAL_INITIAL_NONE, 0.01, 200000},
    {"sleigh", "leapfrog", DAL_INITIAL_NONE, 0.01, 200000},
    {"disk", "midpoint", DAL_INITIAL_NONE, 0.01, 200000},
    {"disk", "leapfrog", DAL_INITIAL_NONE, 0.01, 200000},
    {"knife_edge", "midpoint", DAL_INITIAL_NONE, 0.01, 1000000},
    {"knife_edge", "leapfrog", DAL_INITIAL_NONE, 0.01, 1000000},
    {"particle_oscillator", "midpoint", DAL_INITIAL_NONE, 0.01, 200000},
    {"particle_oscillator", "leapfrog", DAL_INITIAL_NONE, 0.01, 200000},
    {"generic4", "midpoint", DAL_INITIAL_NONE, 0.01, 200000},
    {"generic4", "leapfrog", DAL_INITIAL_NONE, 0.01, 200000},
    {"particle", "midpoint-nodes", DAL_INITIAL_PROJECT, 0.01, 200000},
    {"sleigh", "midpoint-nodes", DAL_INITIAL_SHIFT, 0.01, 200000},
    {"disk", "midpoint-nodes", DAL_INITIAL_D, 0.01, 200000},
    {"knife_edge", "midpoint-nodes", DAL_INITIAL_SHIFT, 0.01, 500000},
    {"particle_oscillator", "midpoint-nodes", DAL_INITIAL_PROJECT, 0.01, 200000},
    {"generic4", "midpoint-nodes", DAL_INITIAL_SHIFT, 0.01, 200000},
    {"disk", "explicit-nodes", DAL_INITIAL_SHIFT, 0.01, 100000},
    {"disk", "endpoint-nodes", DAL_INITIAL_SHIFT, 0.01, 100000},
    {"knife_edge", "0.3-nodes", DAL_INITIAL_PROJECT, 0.01, 100000},
    {"uneven_edge", "midpoint", DAL_INITIAL_NONE, 0.05, 200000},
    {"uneven_edge", "leapfrog", DAL_INITIAL_NONE, 0.05, 200000},
    {"uneven_edge", "leapfrog-mirror", DAL_INITIAL_NONE, 0.05, 200000},
    {"uneven_edge", "midpoint-nodes", DAL_INITIAL_SHIFT, 0.05, 200000},
    {"uneven_edge", "explicit-nodes", DAL_INITIAL_SHIFT, 0.05, 200000},
    {"generic4", "leapfrog-suzuki4", DAL_INITIAL_NONE, 0.1, 100000},
    {"disk", "midpoint-kl8", DAL_INITIAL_NONE, 0.5, 20000},
    {"snakeboard", "leapfrog", DAL_INITIAL_NONE, 0.0001, 200000}, /* singular at t = 23.4 */
    {"sleigh_contact", "midpoint", DAL_INITIAL_NONE, 0.01, 200000},
    {"sleigh_contact", "midpoint-nodes", DAL_INITIAL_SHIFT, 0.01, 200000},
    {"genmass", "midpoint", DAL_INITIAL_NONE, 0.01, 200000},
    {"genmass", "leapfrog", DAL_INITIAL_NONE, 0.01, 200000},
    {"genmass", "midpoint-nodes", DAL_INITIAL_PROJECT, 0.01, 200000},
    {"rolling_disc", "midpoint", DAL_INITIAL_NONE, 0.01, 200000},
    {"n_trailer", "midpoint", DAL_INITIAL_NONE, 0.02, 50000},
    {"ball_on_table", "midpoint", DAL_INITIAL_NONE, 0.01, 200000},
    {"ball_on_table", "leapfrog-mirror", DAL_INITIAL_NONE, 0.01, 200000},
};

/* The residual is a few roundings of terms of the size of its scale, whatever the time: the last
 * tenth is as good as the first, but for the chance of which roundings meet, n u. */
static void test_residual(const run *r)
{
    dal_system *const system = open_system(r->system);
    const dal_scheme scheme = find_scheme(r->scheme);
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    const double bound = DAL_RESIDUAL_BOUND(dal_system_n(system));
    double x[12], fraction = 0.0, worst[TENTHS] = {0};
    size_t worst_step = 0, step = 0;
    CHECK(dal_system_state(system, x) == DAL_SUCCESS);
    if (r->initial != DAL_INITIAL_NONE) CHECK(dal_scheme_shift(&scheme, &fraction) == DAL_SUCCESS);
    CHECK(dal_stepper_start(stepper, 0.0, r->h, x, DAL_CHECK, r->initial) == DAL_SUCCESS);
    for (int tenth = 0; tenth < TENTHS; tenth++)
        for (size_t k = 0; k < r->steps / TENTHS; k++) {
            need(dal_step(stepper, NULL), r->system, dal_stepper_error(stepper)->text);
            const double found =
                residual_of(system, fraction * r->h, dal_stepper_state(stepper));
            step++;
            if (found <= worst[tenth]) continue;
            worst[tenth] = found;
            if (found > bound && worst_step == 0) worst_step = step;
        }
    double all = 0.0;
    for (int tenth = 0; tenth < TENTHS; tenth++) all = fmax(all, worst[tenth]);
    const double u_n = U * (double)dal_system_n(system);
    char text[128];
    snprintf(text, sizeof text, "%s, %s: first above 4 n u in step %zu", r->system, r->scheme,
             worst_step);
    check_true(worst_step == 0 && all <= bound, text, __FILE__, __LINE__);
    check_true(worst[TENTHS - 1] <= worst[0] + u_n, r->system, r->scheme, __LINE__);
    printf("%-20s %-16s %8zu steps: worst %.2f n u, first tenth %.2f, last tenth %.2f\n", r->system,
           r->scheme, r->steps, all / u_n, worst[0] / u_n, worst[TENTHS - 1] / u_n);
}

/* Energy of particle_oscillator over 3e5 steps of h = 0.1: it oscillates with O(h^2), here below
 * h^2 (third derivatives of the motion are below 12).  The mean and the largest error of the last
 * tenth are those of the first, up to the chance with which incommensurable phases are met: a
 * twentieth of the largest. */
static void test_energy(const char *name)
{
    enum { STEPS = 300000 };
    const double h = 0.1;
    dal_system *const system = open_system("particle_oscillator");
    dal_mechanics *const mechanics = open_mechanics(system);
    double x[6], E0 = NAN, mean[TENTHS] = {0}, most[TENTHS] = {0};
    CHECK(dal_system_state(system, x) == 0 && dal_energy(mechanics, 0.0, x, &E0) == 0);
    dal_stepper *const stepper = start_named(system, name, h, x);
    for (int tenth = 0; tenth < TENTHS; tenth++)
        for (size_t k = 0; k < STEPS / TENTHS; k++) {
            double E = NAN;
            need(dal_step(stepper, NULL), name, dal_stepper_error(stepper)->text);
            need(dal_energy(mechanics, 0.0, dal_stepper_state(stepper), &E), name, "energy");
            mean[tenth] += (E - E0) / (STEPS / TENTHS);
            most[tenth] = fmax(most[tenth], fabs(E - E0));
        }
    printf("energy, %-12s: mean %.3e to %.3e, largest %.3e to %.3e\n", name, mean[0],
           mean[TENTHS - 1], most[0], most[TENTHS - 1]);
    CHECK(most[0] <= h * h && most[0] > 0.01 * h * h);
    CHECK_NEAR(most[TENTHS - 1], most[0], most[0] / 20);
    CHECK_NEAR(mean[TENTHS - 1], mean[0], most[0] / 20);
}

int main(void)
{
    for (size_t i = 0; i < sizeof runs / sizeof runs[0]; i++) test_residual(runs + i);
    test_energy("midpoint");
    test_energy("leapfrog");
    test_energy("leapfrog-mirror");
    return check_done();
}
