/* The discrete flow: its exact identities, its symmetries, all ways to start it, and that all
 * compilations and the oracle agree.
 *
 * ROUNDOFF is what one step may err by, relative to sum |q| + sum |v|: Newton stops at 4 u, and the
 * factor 16 is for the condition of C, which is below 10 for the states used here. */
#include "fixtures.h"
#include "check.h"

#include "step/beta.h"
#include "step/scheme.h"
#include "step/stepper.h"

#define ROUNDOFF (64 * U)

enum { MOST_N = 48, MOST_M = 8, MOST_NAMES = 24 };

static const char *const all_systems[] = {"particle", "particle_oscillator", "knife_edge", "sleigh",
                                          "disk", "heisenberg", "contact_oscillator", "robot",
                                          "chaotic", "generic4"};
enum { SYSTEMS = sizeof all_systems / sizeof all_systems[0] };

static const double betas[] = {0.0, 0.25, 0.5, 0.75, 1.0};
enum { BETAS = sizeof betas / sizeof betas[0] };

/* ---- helpers ----------------------------------------------------------------------------- */

static dal_scheme beta_scheme(double beta) { return (dal_scheme){.name = "beta", .beta = beta}; }

/* steps steps from x0 as it is; x <- the state, reaction (or NULL) <- the mean reaction. */
static void flow_from(const dal_system *system, const dal_scheme *scheme, double h,
                      dal_initial initial, size_t steps, const double *x0, double *x,
                      double *reaction)
{
    dal_stepper *const stepper = open_stepper(system, scheme, NULL);
    int status = dal_stepper_start(stepper, 0.0, h, x0, DAL_ASSUME, initial);
    if (!status) status = dal_advance(stepper, steps, reaction, NULL);
    check_true(status == DAL_SUCCESS, dal_stepper_error(stepper)->text, system->def.name, __LINE__);
    memcpy(x, dal_stepper_state(stepper), 2 * dal_system_n(system) * sizeof *x);
}

static void flow(const dal_system *system, const dal_scheme *scheme, double h, size_t steps,
                 const double *x0, double *x, double *reaction)
{
    flow_from(system, scheme, h, DAL_INITIAL_NONE, steps, x0, x, reaction);
}

/* ---- the equations and the energy of a step ---------------------------------------------- */

/* Whether x1, h lambda solve the equations of the beta-scheme, their terms being of the size that
 * scale says; and the identity of the energy,
 *   E1 - E0 = V1 - V0 - (h/2)(v + v1).[(1-beta) V_q(q1) + beta V_q(q)]
 *           + (h/2) lambda.mu(q_k)(v + v1),
 * which follows from them. */
static void check_equations(dal_mechanics *mechanics, const dal_system *system, double beta,
                            double h, const double *x, const double *x1, const double *lambda)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    const double *const v = x + n, *const v1 = x1 + n;
    double R1[MOST_N], R2[MOST_M], muk[MOST_M * MOST_N], kappa[MOST_M], g0[MOST_N], g1[MOST_N];
    double V0 = 0.0, V1 = 0.0, E0 = NAN, E1 = NAN;
    for (size_t a = 0; a < m; a++) kappa[a] = h * lambda[a];
    CHECK(dal_step_equations(mechanics, 0.0, beta, h, x, v1, kappa, R1, R2, NULL, NULL, muk) == 0);
    memset(g0, 0, sizeof g0);
    memset(g1, 0, sizeof g1);
    if (system->def.potential) {
        CHECK(system->def.potential(0.0, x, &V0, g0, NULL, system->def.ctx) == 0);
        CHECK(system->def.potential(0.0, x1, &V1, g1, NULL, system->def.ctx) == 0);
    }
    CHECK(dal_energy(mechanics, 0.0, x, &E0) == 0 && dal_energy(mechanics, 0.0, x1, &E1) == 0);

    const double *const M = mass_of(system);
    const double extent = sum_of_sizes(2 * n, x) + sum_of_sizes(2 * n, x1)
                        + fabs(h) * (sum_of_sizes(n, g0) + sum_of_sizes(n, g1))
                        + sum_of_sizes(m, kappa);
    const double scale = sum_of_sizes(n * n, M) / (double)n * extent;
    for (size_t i = 0; i < n; i++) {
        CHECK_NEAR(R1[i], 0.0, ROUNDOFF * scale);
        CHECK_NEAR(x1[i], x[i] + h * ((1 - beta) * v[i] + beta * v1[i]), 4 * U * extent);
    }
    for (size_t a = 0; a < m; a++) CHECK_NEAR(R2[a], 0.0, ROUNDOFF * extent);

    double work = V1 - V0;
    for (size_t i = 0; i < n; i++) {
        const double force = h / 2 * ((1 - beta) * g1[i] + beta * g0[i]);
        work -= (v[i] + v1[i]) * force;
        for (size_t a = 0; a < m; a++)
            work += lambda[a] * h / 2 * muk[a * n + i] * (v[i] + v1[i]);
    }
    const double sizes = fabs(E0) + fabs(E1) + fabs(V0) + fabs(V1) + scale * extent;
    CHECK_NEAR(E1 - E0, work, ROUNDOFF * sizes);
}

static void test_equations_of(const dal_system *system, const double *x0)
{
    const size_t n = dal_system_n(system);
    dal_mechanics *const mechanics = open_mechanics(system);
    for (size_t b = 0; b < BETAS; b++)
        for (int sign = -1; sign <= 1; sign += 2) {
            const dal_scheme scheme = beta_scheme(betas[b]);
            const double h = 0.05 * sign;
            double x[2 * MOST_N], lambda[MOST_M];
            dal_stepper *const stepper = start_stepper(system, &scheme, h, x0);
            for (int k = 0; k < 12; k++) {
                memcpy(x, dal_stepper_state(stepper), 2 * n * sizeof *x);
                CHECK(dal_step(stepper, lambda) == DAL_SUCCESS);
                const double *const x1 = dal_stepper_state(stepper);
                check_equations(mechanics, system, betas[b], h, x, x1, lambda);
                CHECK(residual_of(system, 0.0, x1) <= DAL_RESIDUAL_BOUND(n));
            }
            release(stepper);
        }
}

/* beta = 0: the reaction in closed form, lambda = -C^-1 mu w / h at q1 = q + h v with w = v - h
 * M^-1 V_q(q1). */
static void test_explicit_reaction(const dal_system *system, const double *x, double h)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    const dal_scheme scheme = beta_scheme(0.0);
    dal_mechanics *const mechanics = open_mechanics(system);
    double y[2 * MOST_N], lambda[MOST_M], C[MOST_M * MOST_M], impulse[MOST_M], end[2 * MOST_N];
    double kick[MOST_N] = {0.0}, factor[MOST_N * MOST_N], inverse[MOST_N];
    for (size_t i = 0; i < n; i++) y[i] = x[i] + h * x[n + i];
    if (system->def.potential) {
        CHECK(system->def.potential(0.0, y, NULL, kick, NULL, system->def.ctx) == 0);
        memcpy(factor, mass_of(system), n * n * sizeof *factor);
        CHECK(dal__cholesky(n, factor, inverse, NULL, NULL));
        dal__cholesky_solve(n, factor, kick);
    }
    for (size_t i = 0; i < n; i++) y[n + i] = x[n + i] - h * kick[i];
    CHECK(dal_gram(mechanics, 0.0, y, C) == 0
          && dal_residual(mechanics, 0.0, 0.0, y, impulse) == 0);
    CHECK(dal__cholesky(m, C, inverse, NULL, NULL));
    dal__cholesky_solve(m, C, impulse);
    flow(system, &scheme, h, 1, x, end, lambda);
    for (size_t a = 0; a < m; a++)
        CHECK_NEAR(h * lambda[a], -impulse[a], ROUNDOFF * sum_of_sizes(2 * n, y));
}

/* vddot[n] <- the second derivative of v along the motion through x: vdot differenced along it. */
static void second_derivative(dal_mechanics *mechanics, size_t n, const double *x, double *vddot)
{
    const double d = 0x1p-16; /* errs by d^2 and u/d: 1e-9 */
    double xdot[2 * MOST_N], y[2 * MOST_N], up[MOST_N], down[MOST_N];
    CHECK(dal_field(mechanics, 0.0, x, xdot) == 0);
    for (size_t i = 0; i < 2 * n; i++) y[i] = x[i] + d * xdot[i];
    CHECK(dal_acceleration(mechanics, 0.0, y, up) == 0);
    for (size_t i = 0; i < 2 * n; i++) y[i] = x[i] - d * xdot[i];
    CHECK(dal_acceleration(mechanics, 0.0, y, down) == 0);
    for (size_t i = 0; i < n; i++) vddot[i] = (up[i] - down[i]) / (2 * d);
}

/* A step in powers of h: v + h vdot for every beta, and for beta = 1/2 h^2 vddot/2 besides.  What
 * is left after these two terms is O(h^2) and O(h^3): from h to h/4 it falls by 16 and by 64, up to
 * terms of the next order, a few h. */
static void test_expansions(const dal_system *system, const double *x)
{
    const size_t n = dal_system_n(system);
    dal_mechanics *const mechanics = open_mechanics(system);
    double vdot[MOST_N], vddot[MOST_N], rest[2][MOST_N], end[2 * MOST_N];
    CHECK(dal_acceleration(mechanics, 0.0, x, vdot) == 0);
    second_derivative(mechanics, n, x, vddot);
    for (size_t b = 0; b < BETAS; b++) {
        const dal_scheme scheme = beta_scheme(betas[b]);
        const bool symmetric = betas[b] == 0.5;
        for (int k = 0; k < 2; k++) {
            const double h = k == 0 ? 0x1p-7 : 0x1p-9;
            flow(system, &scheme, h, 1, x, end, NULL);
            for (size_t i = 0; i < n; i++)
                rest[k][i] = end[n + i] - x[n + i] - h * vdot[i]
                           - (symmetric ? h * h / 2 * vddot[i] : 0.0);
        }
        const double coarse = dal__largest(n, rest[0]), fine = dal__largest(n, rest[1]);
        if (coarse <= ROUNDOFF * sum_of_sizes(2 * n, x)) continue; /* the disk, at beta = 1/2 */
        check_near(log2(coarse / fine) / 2, symmetric ? 3.0 : 2.0, 0.2, "power of h",
                   system->def.name, (int)b);
    }
}

/* Every built-in system; sizes beyond the compiled ones, with M diagonal and full. */
static void test_equations(void)
{
    double x[2 * MOST_N];
    for (size_t s = 0; s < SYSTEMS; s++) {
        dal_system *const system = open_system(all_systems[s]);
        moved_state(system, x);
        test_equations_of(system, x);
        test_explicit_reaction(system, x, 0.05);
        test_explicit_reaction(system, x, -0.05);
        test_expansions(system, x);
        release(system);
    }
    static const size_t sizes[][2] = {{1, 0}, {3, 2}, {6, 5}, {8, 4}, {9, 1}, {12, 6}};
    for (size_t s = 0; s < sizeof sizes / sizeof sizes[0]; s++)
        for (int full = 0; full < 2; full++) {
            wide w;
            dal_system *const system = open_wide(&w, sizes[s][0], sizes[s][1], full, true);
            test_equations_of(system, w.state);
            release(system);
        }
    const char *const names[] = {"pairs"};
    const double pairs = 10.0;
    dal_system *const large = open_builtin("chaotic", 1, names, &pairs);
    moved_state(large, x);
    test_equations_of(large, x);
}

/* ---- what is conserved ------------------------------------------------------------------- */

/* Roundings of q, v and p do not add up: where the error of the scheme is below them, that of the
 * energy stays at that of one evaluation of it, some 10 u, or, for the angle of a blade that has
 * turned far, at its rounding.  Without what x lacks it is 30 to 300 times as much. */
static void test_roundings(void)
{
    static const struct {
        const char *system, *scheme;
        double h, bound;
    } runs[] = {{"particle_oscillator", "leapfrog-ss10", 0.02, 30 * U},
                {"contact_oscillator", "leapfrog-ss10", 0.02, 30 * U},
                {"sleigh", "leapfrog-ss10", 0.02, 30 * U},
                {"disk", "leapfrog-ss10", 0.02, 30 * U},
                {"knife_edge", "leapfrog-ss10", 0.02, 300 * U},
                {"genmass", "midpoint-kl8", 0.01, 30 * U},
                {"n_trailer", "midpoint-kl8", 0.01, 6000 * U}};
    for (size_t r = 0; r < sizeof runs / sizeof *runs; r++) {
        dal_system *const system = open_system(runs[r].system);
        dal_mechanics *const mechanics = open_mechanics(system);
        const dal_scheme scheme = find_scheme(runs[r].scheme);
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        double x[2 * MOST_N], E0 = NAN, E = NAN, largest = 0.0;
        CHECK(dal_system_state(system, x) == 0 && dal_energy(mechanics, 0.0, x, &E0) == 0);
        CHECK(dal_stepper_start(stepper, 0.0, runs[r].h, x, DAL_PROJECT, DAL_INITIAL_NONE) == 0);
        for (int k = 0; k < 10; k++) {
            CHECK(dal_advance(stepper, 400, NULL, NULL) == 0);
            CHECK(dal_energy(mechanics, 0.0, dal_stepper_state(stepper), &E) == 0);
            largest = fmax(largest, fabs(E - E0));
        }
        check_true(largest <= runs[r].bound * fmax(1.0, fabs(E0)), "roundings add up",
                   runs[r].system, __LINE__);
        release(system);
    }
}

/* An angle that turns evenly, by half of its last digit in half a step: it is rounded to where it
 * is, whatever the roundings before. */
static void test_even_turns(void)
{
    static const char *const schemes[] = {"leapfrog", "midpoint", "leapfrog-suzuki4", "0.3"};
    dal_system *const system = open_system("particle");
    for (size_t k = 0; k < DAL_LENGTH(schemes); k++) {
        const double x[6] = {0.0, 0x1p53, 0.0, 0.0, 1.0, 0.0};
        dal_stepper *const stepper = start_named(system, schemes[k], 1.0, x);
        for (int step = 1; step <= 1000; step++) {
            CHECK(dal_step(stepper, NULL) == 0);
            CHECK(fabs(dal_stepper_state(stepper)[1] - 0x1p53 - step) <= 4.0);
        }
        release(stepper);
    }
}

/* The heading of the free disk, after many steps, is the exact one but for its own rounding. */
static void test_free_heading(void)
{
    enum { STEPS = 20000 };
    static const char *const schemes[] = {"leapfrog", "midpoint"};
    const double steps[] = {0.1, 0.07};
    dal_system *const system = open_system("disk");
    for (int k = 0; k < 4; k++) {
        double x[8] = {0.0, 0.0, 0.1, 1000.3, 0.0, 0.0, 0.4, 0.7};
        dal_mechanics *const mechanics = open_mechanics(system);
        CHECK(dal_project(mechanics, 0.0, 0.0, x, NULL) == 0);
        dal_stepper *const stepper = start_named(system, schemes[k / 2], steps[k % 2], x);
        CHECK(dal_advance(stepper, STEPS, NULL, NULL) == 0);
        const double *const end = dal_stepper_state(stepper);
        const long double exact = (long double)x[3] + (long double)STEPS * steps[k % 2] * x[7];
        CHECK(end[7] == x[7]);
        CHECK(fabsl(end[3] - exact) <= nextafter(end[3], HUGE_VAL) - end[3]);
        release(mechanics);
    }
}

/* Midpoint conserves E where lambda.mu(q_k)(v + v1) = 0: on the disk, on heisenberg with its
 * quadratic V.  A step errs by 4 u E at most, where Newton stops, and its errors may all be of one
 * sign.  (On heisenberg other schemes err by h^2.) */
static void test_exact_energy(void)
{
    enum { STEPS = 20000 };
    const char *const names[] = {"disk", "heisenberg"};
    for (size_t s = 0; s < 2; s++) {
        dal_system *const system = open_system(names[s]);
        dal_mechanics *const mechanics = open_mechanics(system);
        const dal_scheme midpoint = find_scheme("midpoint");
        const dal_scheme mirror = find_scheme("leapfrog-mirror");
        double x[2 * MOST_N], E0 = NAN, E = NAN;
        CHECK(dal_system_state(system, x) == 0 && dal_energy(mechanics, 0.0, x, &E0) == 0);
        flow(system, &midpoint, 0.1, STEPS, x, x, NULL);
        CHECK(dal_energy(mechanics, 0.0, x, &E) == 0);
        CHECK_NEAR(E, E0, 4 * U * E0 * STEPS);
        CHECK(dal_system_state(system, x) == 0);
        flow(system, &mirror, 0.1, 7, x, x, NULL);
        CHECK(dal_energy(mechanics, 0.0, x, &E) == 0);
        if (s == 1) CHECK(fabs(E - E0) > 1e-5 * E0);
        release(system);
    }
}

/* xi.Mv for a constant xi in D_q under which L is invariant: v_y of the particle, v_theta of the
 * knife edge, v_phi of the disk.  One addition a step, hence u |v_i| each. */
static void test_momenta(void)
{
    enum { STEPS = 1000 };
    static const struct {
        const char *name;
        size_t component;
    } table[] = {{"particle", 1}, {"knife_edge", 2}, {"disk", 3}};
    const char *const schemes[] = {"explicit", "0.3", "midpoint", "endpoint", "leapfrog",
                                   "leapfrog-mirror", "leapfrog-kl6", "midpoint-nodes"};
    for (size_t s = 0; s < 3; s++)
        for (size_t j = 0; j < sizeof schemes / sizeof schemes[0]; j++) {
            dal_system *const system = open_system(table[s].name);
            const dal_scheme scheme = find_scheme(schemes[j]);
            const dal_initial initial =
                scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE;
            const size_t i = dal_system_n(system) + table[s].component;
            double x0[2 * MOST_N], x[2 * MOST_N];
            CHECK(dal_system_state(system, x0) == 0);
            flow_from(system, &scheme, 0.01, initial, STEPS, x0, x, NULL);
            CHECK_NEAR(x[i], x0[i], STEPS * U * fabs(x0[i]));
            release(system);
        }
}

/* ---- adjoints and symmetries ------------------------------------------------------------- */

/* x -> scheme with h -> adjoint with -h -> x on D. */
static void check_inverse(const dal_system *system, const dal_scheme *scheme,
                          const dal_scheme *adjoint, double h, bool inverse)
{
    const size_t n = dal_system_n(system);
    double x0[2 * MOST_N], x1[2 * MOST_N], x[2 * MOST_N], there[MOST_M], back[MOST_M];
    moved_state(system, x0);
    flow(system, scheme, h, 1, x0, x1, there);
    flow(system, adjoint, -h, 1, x1, x, back);
    const double extent = sum_of_sizes(2 * n, x0) + sum_of_sizes(2 * n, x1);
    const double steps = (double)dal__scheme_count(scheme) + 1; /* fractions are below 2 */
    const double difference = largest_difference(2 * n, x, x0);
    if (!inverse) {
        CHECK(difference > 1e-5);
        return;
    }
    CHECK(largest_difference(2 * n, x1, x0) > 0.01);
    CHECK_NEAR(difference, 0.0, ROUNDOFF * steps * extent);
    /* the same impulse both ways: kappa is as good as v, and lambda = kappa/h */
    for (size_t a = 0; a < dal_system_m(system); a++)
        CHECK_NEAR(back[a], there[a], 4 * ROUNDOFF * steps * extent / fabs(h));
}

static void test_adjoints(void)
{
    for (size_t s = 0; s < SYSTEMS; s++) {
        dal_system *const system = open_system(all_systems[s]);
        for (size_t b = 0; b < BETAS; b++) {
            const dal_scheme scheme = beta_scheme(betas[b]), adjoint = beta_scheme(1 - betas[b]);
            check_inverse(system, &scheme, &adjoint, 0.07, true);
            check_inverse(system, &scheme, &adjoint, -0.07, true);
        }
        for (size_t j = 0; j < schemes_for_callbacks(); j++) {
            dal_scheme scheme;
            CHECK(dal_scheme_at(&scheme, j) == DAL_SUCCESS);
            if (scheme.nodes == DAL_MOVED_NODES && !scheme.family)
                check_inverse(system, &scheme, &scheme, 0.05, scheme.symmetric);
        }
        release(system);
    }
}

/* Errors of 8 u extent a step, carried along by a motion in which neighbours part linearly in time,
 * add up to 8 u extent N^2 over N steps there and back. */
static void test_there_and_back(void)
{
    enum { STEPS = 500 };
    const char *const schemes[] = {"midpoint", "leapfrog", "leapfrog-mirror", "leapfrog-suzuki4"};
    for (size_t s = 0; s < SYSTEMS; s++)
        for (size_t j = 0; j < sizeof schemes / sizeof schemes[0]; j++) {
            dal_system *const system = open_system(all_systems[s]);
            const dal_scheme scheme = find_scheme(schemes[j]);
            const size_t n = dal_system_n(system);
            double x0[2 * MOST_N], x1[2 * MOST_N], x[2 * MOST_N];
            moved_state(system, x0);
            flow(system, &scheme, 0.02, STEPS, x0, x1, NULL);
            flow(system, &scheme, -0.02, STEPS, x1, x, NULL);
            const double extent = sum_of_sizes(2 * n, x0) + sum_of_sizes(2 * n, x1);
            CHECK(largest_difference(2 * n, x1, x0) > 0.1);
            CHECK_NEAR(largest_difference(2 * n, x, x0), 0.0, 8 * U * extent * STEPS * STEPS);
            release(system);
        }
}

/* R Phi_h R = Phi_-h with R(q, v) = (q, -v).  Every operation of a step is odd or even under R and
 * h -> -h, and so is rounding: the bits agree. */
static void test_reversibility(void)
{
    for (size_t s = 0; s < SYSTEMS; s++)
        for (size_t j = 0; j < schemes_for_callbacks(); j++) {
            dal_system *const system = open_system(all_systems[s]);
            const size_t n = dal_system_n(system), m = dal_system_m(system);
            dal_scheme scheme;
            CHECK(dal_scheme_at(&scheme, j) == DAL_SUCCESS);
            const dal_initial initial =
                scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_D : DAL_INITIAL_NONE;
            const bool reacts = strcmp(scheme.name, "reference") != 0;
            double x[2 * MOST_N], y[2 * MOST_N], lambda[MOST_M], mirrored[MOST_M];
            moved_state(system, x);
            memcpy(y, x, 2 * n * sizeof *y);
            for (size_t i = n; i < 2 * n; i++) y[i] = -y[i];
            flow_from(system, &scheme, 0.02, initial, 20, y, y, mirrored);
            for (size_t i = n; i < 2 * n; i++) y[i] = -y[i];
            flow_from(system, &scheme, -0.02, initial, 20, x, x, lambda);
            CHECK(largest_difference(2 * n, x, y) == 0.0);
            for (size_t a = 0; a < m; a++)
                CHECK(reacts ? lambda[a] == mirrored[a] : isnan(lambda[a]) && isnan(mirrored[a]));
            release(system);
        }
}

/* mu -> B(q) mu: the same orbit, lambda = B(q_k)^T lambda', q_k the node where mu^T lambda acts. */
static void test_mixing(void)
{
    enum { STEPS = 50 };
    const char *const schemes[] = {"explicit", "0.25", "midpoint", "0.75", "endpoint", "leapfrog"};
    static const double node[] = {1.0, 0.75, 0.5, 0.25, 0.0, 0.5}; /* q_k = q~ + node h v */
    const double h = 0.05;
    for (size_t s = 0; s < SYSTEMS; s++)
        for (size_t j = 0; j < sizeof schemes / sizeof schemes[0]; j++) {
            dal_system *const system = open_system(all_systems[s]);
            dal_system *const mixed = open_mixed(system);
            const dal_scheme scheme = find_scheme(schemes[j]);
            const size_t n = dal_system_n(system), m = dal_system_m(system);
            dal_stepper *const two = open_stepper(mixed, &scheme, NULL);
            double x[2 * MOST_N], q[MOST_N], lambda[MOST_M], other[MOST_M], expected[MOST_M];
            moved_state(system, x);
            dal_stepper *const one = start_stepper(system, &scheme, h, x);
            CHECK(dal_stepper_start(two, 0.0, h, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
            for (int k = 1; k <= STEPS; k++) {
                memcpy(x, dal_stepper_state(one), 2 * n * sizeof *x);
                CHECK(dal_step(one, lambda) == 0 && dal_step(two, other) == 0);
                const double *const x1 = dal_stepper_state(one), *const x2 = dal_stepper_state(two);
                const double extent = sum_of_sizes(2 * n, x1), error = ROUNDOFF * k * extent;
                CHECK_NEAR(largest_difference(2 * n, x1, x2), 0.0, error);
                for (size_t i = 0; i < n; i++) q[i] = x[i] + node[j] * h * x[n + i];
                unmix(m, q, other, expected);
                CHECK_NEAR(largest_difference(m, lambda, expected), 0.0, 4 * error / h);
            }
            release(system);
        }
}

/* ---- relations between schemes ----------------------------------------------------------- */

/* Without V the pair (0, 1/2), (1, 1/2) is the midpoint scheme; with V it is not. */
static void test_leapfrog_is_midpoint(void)
{
    enum { STEPS = 100 };
    const char *const names[] = {"particle", "sleigh", "disk", "particle_oscillator"};
    const dal_scheme leapfrog = find_scheme("leapfrog"), midpoint = find_scheme("midpoint");
    for (size_t s = 0; s < 4; s++) {
        dal_system *const system = open_system(names[s]);
        const size_t n = dal_system_n(system), m = dal_system_m(system);
        double x0[2 * MOST_N], x1[2 * MOST_N], x2[2 * MOST_N], one[MOST_M], two[MOST_M];
        moved_state(system, x0);
        flow(system, &leapfrog, 0.1, STEPS, x0, x1, one);
        flow(system, &midpoint, 0.1, STEPS, x0, x2, two);
        const double error = ROUNDOFF * STEPS * sum_of_sizes(2 * n, x1);
        if (s < 3) {
            CHECK_NEAR(largest_difference(2 * n, x1, x2), 0.0, error);
            CHECK_NEAR(largest_difference(m, one, two), 0.0, error / 0.1);
        } else {
            CHECK(largest_difference(2 * n, x1, x2) > 1e-4);
        }
        release(system);
    }
}

/* V enters leapfrog at the node and its mirror at the ends of the step: drift, kick, drift and
 * kick, drift, kick where there is no constraint.  M = diag, V = wide's: by hand. */
static void test_no_constraint(void)
{
    const double h = 0.1;
    wide w;
    dal_system *const system = open_wide(&w, 3, 0, false, true);
    const dal_scheme leapfrog = find_scheme("leapfrog"), mirror = find_scheme("leapfrog-mirror");
    double x[6], y[6], g[3];
    memcpy(y, w.state, sizeof y);
    for (int k = 0; k < 10; k++) {
        for (size_t i = 0; i < 3; i++) y[i] += h / 2 * y[3 + i];
        wide_potential(0.0, y, NULL, g, NULL, &w);
        for (size_t i = 0; i < 3; i++) y[3 + i] -= h * g[i] / w.mass[4 * i];
        for (size_t i = 0; i < 3; i++) y[i] += h / 2 * y[3 + i];
    }
    flow(system, &leapfrog, h, 10, w.state, x, NULL);
    CHECK_NEAR(largest_difference(6, x, y), 0.0, ROUNDOFF * 10);
    memcpy(y, w.state, sizeof y);
    for (int k = 0; k < 10; k++) {
        for (int half = 0; half < 2; half++) {
            wide_potential(0.0, y, NULL, g, NULL, &w);
            for (size_t i = 0; i < 3; i++) y[3 + i] -= h / 2 * g[i] / w.mass[4 * i];
            for (size_t i = 0; half == 0 && i < 3; i++) y[i] += h * y[3 + i];
        }
    }
    flow(system, &mirror, h, 10, w.state, x, NULL);
    CHECK_NEAR(largest_difference(6, x, y), 0.0, ROUNDOFF * 10);
}

/* A record of the user's own: {0.3, 1/4}, {0.7, 3/4} is the two steps one after the other, its
 * reaction the mean weighted by their lengths; {0.3, 1/2}, {0.7, 1/2} is symmetric.  The sub-steps
 * are copied. */
static void test_own_record(void)
{
    const double h = 0.08;
    for (size_t s = 0; s < SYSTEMS; s++) {
        dal_system *const system = open_system(all_systems[s]);
        const size_t n = dal_system_n(system), m = dal_system_m(system);
        dal_substep parts[2] = {{0.3, 0.25}, {0.7, 0.75}};
        const dal_scheme own = {.name = "own", .count = 2, .substeps = parts};
        const dal_scheme first = beta_scheme(0.3), second = beta_scheme(0.7);
        double x0[2 * MOST_N], x1[2 * MOST_N], reaction[MOST_M], l1[MOST_M], l2[MOST_M];
        moved_state(system, x0);
        dal_stepper *const stepper = open_stepper(system, &own, NULL);
        parts[0].beta = parts[1].beta = 0.5;
        CHECK(dal_stepper_start(stepper, 0.0, h, x0, DAL_ASSUME, DAL_INITIAL_NONE) == 0);
        CHECK(dal_step(stepper, reaction) == 0);
        flow(system, &first, h / 4, 1, x0, x1, l1);
        flow(system, &second, 0.75 * h, 1, x1, x1, l2);
        const double error = 2 * ROUNDOFF * sum_of_sizes(2 * n, x1);
        CHECK_NEAR(largest_difference(2 * n, dal_stepper_state(stepper), x1), 0.0, error);
        for (size_t a = 0; a < m; a++)
            CHECK_NEAR(reaction[a], 0.25 * l1[a] + 0.75 * l2[a], 4 * error / h);
        release(stepper);

        parts[0] = (dal_substep){0.3, 0.5};
        parts[1] = (dal_substep){0.7, 0.5};
        check_inverse(system, &own, &own, h, true);
        parts[1].beta = 0.3;
        check_inverse(system, &own, &own, h, false);
        const dal_scheme named = find_scheme("0.3");
        flow(system, &own, h, 5, x0, x0, NULL);
        moved_state(system, x1);
        flow(system, &named, h / 2, 10, x1, x1, NULL);
        CHECK_NEAR(largest_difference(2 * n, x0, x1), 0.0, 5 * error);
        release(system);
    }
}

/* Particle on D, spec of the reaction: lambda = v_x v_y/(1 + y_q y1), y_q = y + (1-beta) h v_y; and
 * the mean over steps is the mean. */
static void test_reactions(void)
{
    enum { STEPS = 16 };
    const double h = 0.1;
    dal_system *const system = open_system("particle");
    for (size_t b = 0; b < BETAS; b++) {
        const dal_scheme scheme = beta_scheme(betas[b]);
        double x[6], x0[6], lambda = NAN, mean = NAN, sum = 0.0;
        CHECK(dal_system_state(system, x0) == 0);
        dal_stepper *const stepper = start_stepper(system, &scheme, h, x0);
        for (int k = 0; k < STEPS; k++) {
            memcpy(x, dal_stepper_state(stepper), sizeof x);
            CHECK(dal_step(stepper, &lambda) == 0);
            const double y = x[1] + h * x[4], yq = x[1] + (1 - betas[b]) * h * x[4];
            CHECK_NEAR(lambda, x[3] * x[4] / (1 + yq * y), ROUNDOFF * sum_of_sizes(6, x) / h);
            sum += lambda;
        }
        flow(system, &scheme, h, STEPS, x0, x, &mean);
        CHECK_NEAR(mean, sum / STEPS, STEPS * ROUNDOFF / h);
        mean = 7.0; /* no steps, no mean */
        CHECK(dal_advance(stepper, 0, &mean, NULL) == DAL_SUCCESS && mean == 7.0);
        release(stepper);
    }
}

/* ---- kept nodes -------------------------------------------------------------------------- */

/* Kept nodes are S Phi S^-1 with S(q, v) = (q + (1-beta) h v, v): from data of D moved by S, and
 * from data used as they are, where S^-1 x is not in D and the first step jumps there. */
static void check_conjugate(const dal_system *system, double beta, double h)
{
    enum { STEPS = 40 };
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    const dal_scheme moved = beta_scheme(beta);
    dal_scheme kept = moved;
    kept.nodes = DAL_KEPT_NODES;
    const double shift = (1 - beta) * h;
    double x0[2 * MOST_N], x[2 * MOST_N], y[2 * MOST_N], here[MOST_M], there[MOST_M];
    moved_state(system, x0);
    for (int jump = 0; jump < 2; jump++) {
        memcpy(y, x0, 2 * n * sizeof *y);
        for (size_t i = 0; jump && i < n; i++) y[i] -= shift * y[n + i];
        flow(system, &moved, h, STEPS, y, y, there);
        for (size_t i = 0; i < n; i++) y[i] += shift * y[n + i];
        flow_from(system, &kept, h, jump ? DAL_INITIAL_D : DAL_INITIAL_SHIFT, STEPS, x0, x, here);
        const double error = ROUNDOFF * STEPS * (sum_of_sizes(2 * n, x) + sum_of_sizes(2 * n, x0));
        CHECK_NEAR(largest_difference(2 * n, x, y), 0.0, error);
        CHECK_NEAR(largest_difference(m, here, there), 0.0, error / fabs(h));
        CHECK(residual_of(system, shift, x) <= DAL_RESIDUAL_BOUND(n));
        if (beta < 1 && strcmp(system->def.name, "heisenberg") != 0) /* there D_eps is D */
            CHECK(residual_of(system, 0.0, x) > 1e-5);
    }
}

/* PROJECT: v moved along M^-1 mu^T onto D_eps, and that state is used; D_EPS accepts it, and
 * refuses data of D. */
static void check_starts(const dal_system *system, double h)
{
    const size_t n = dal_system_n(system);
    const double shift = h / 2;
    dal_mechanics *const mechanics = open_mechanics(system);
    dal_stepper *const stepper = open_named(system, "midpoint-nodes");
    double x0[2 * MOST_N], x[2 * MOST_N], distance = NAN;
    moved_state(system, x0);
    memcpy(x, x0, 2 * n * sizeof *x);
    CHECK(dal_project(mechanics, 0.0, shift, x, &distance) == DAL_SUCCESS);
    CHECK(dal_stepper_start(stepper, 0.0, h, x0, DAL_CHECK, DAL_INITIAL_PROJECT) == DAL_SUCCESS);
    CHECK_NEAR(largest_difference(2 * n, dal_stepper_state(stepper), x), 0.0,
               ROUNDOFF * sum_of_sizes(2 * n, x));
    const dal_stats stats = stats_of(stepper);
    CHECK_NEAR(stats.initial_correction, distance, ROUNDOFF * sum_of_sizes(2 * n, x));

    CHECK(dal_stepper_start(stepper, 0.0, h, x, DAL_CHECK, DAL_INITIAL_D_EPS) == DAL_SUCCESS);
    CHECK_NEAR(largest_difference(2 * n, dal_stepper_state(stepper), x), 0.0,
               ROUNDOFF * sum_of_sizes(2 * n, x));
    CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
    CHECK(residual_of(system, shift, dal_stepper_state(stepper)) <= DAL_RESIDUAL_BOUND(n));

    memcpy(x, dal_stepper_state(stepper), 2 * n * sizeof *x);
    CHECK(dal_stepper_start(stepper, 0.0, h, x0, DAL_CHECK, DAL_INITIAL_D_EPS) == DAL_EOFFD);
    CHECK(strstr(dal_stepper_error(stepper)->text, "D_eps") != NULL);
    CHECK(largest_difference(2 * n, x, dal_stepper_state(stepper)) == 0.0);
    CHECK(dal_stepper_start(stepper, 0.0, h, x0, DAL_CHECK, DAL_INITIAL_D) == DAL_SUCCESS);
    CHECK(largest_difference(n, x0, dal_stepper_state(stepper)) == 0.0);
    CHECK(dal_stepper_start(stepper, 0.0, h, x0, DAL_CHECK, DAL_INITIAL_SHIFT) == DAL_SUCCESS);
    for (size_t i = 0; i < n; i++)
        CHECK_NEAR(dal_stepper_state(stepper)[i], x0[i] + shift * x0[n + i],
                   ROUNDOFF * sum_of_sizes(2 * n, x0));
}

static void test_kept_nodes(void)
{
    for (size_t s = 0; s < SYSTEMS; s++) {
        dal_system *const system = open_system(all_systems[s]);
        for (size_t b = 0; b < BETAS; b++) {
            check_conjugate(system, betas[b], 0.02);
            check_conjugate(system, betas[b], -0.02);
        }
        if (strcmp(all_systems[s], "heisenberg") != 0) check_starts(system, 0.02);
        release(system);
    }
    /* The jump from D: without V the first lambda tends to lambda/2 (E12). */
    dal_system *const particle = open_system("particle");
    const dal_scheme kept = find_scheme("midpoint-nodes");
    double x[6], lambda = NAN;
    CHECK(dal_system_state(particle, x) == 0);
    const double expected = x[3] * x[4] / (1 + x[1] * x[1]) / 2;
    flow_from(particle, &kept, 1e-6, DAL_INITIAL_D, 1, x, x, &lambda);
    CHECK_NEAR(lambda, expected, 4e-6); /* O(h); u/h is 1e-10 */
}

/* ---- starts ------------------------------------------------------------------------------ */

static void check_refused(dal_stepper *stepper, double t0, double h, const double *x,
                          int consistency, int initial, int expected, const char *words)
{
    double before[6];
    const double t = dal_stepper_time(stepper);
    dal_stats stats, after;
    memcpy(before, dal_stepper_state(stepper), sizeof before);
    dal_stepper_stats(stepper, &stats);
    const int status = dal_stepper_start(stepper, t0, h, x, (dal_consistency)consistency,
                                         (dal_initial)initial);
    CHECK(status == expected);
    const char *const text = dal_stepper_error(stepper)->text;
    check_true(strstr(text, words) != NULL, text, words, __LINE__);
    CHECK(memcmp(before, dal_stepper_state(stepper), sizeof before) == 0);
    dal_stepper_stats(stepper, &after);
    CHECK(dal_stepper_time(stepper) == t && after.steps == stats.steps);
}

static void test_starts(void)
{
    dal_system *const system = open_system("particle");
    dal_stepper *const stepper = open_named(system, "midpoint");
    dal_stepper *const nodes = open_named(system, "midpoint-nodes");
    double x0[6], off[6], lambda = 7.0;
    size_t done = 9;
    CHECK(dal_system_state(system, x0) == 0);

    CHECK(dal_step(stepper, &lambda) == DAL_EINVAL && lambda == 7.0);
    CHECK(strstr(dal_stepper_error(stepper)->text, "not started") != NULL);
    CHECK(dal_advance(stepper, 3, &lambda, &done) == DAL_EINVAL && done == 0 && lambda == 7.0);

    CHECK(dal_stepper_start(stepper, 2.0, 0.25, x0, DAL_CHECK, DAL_INITIAL_NONE) == DAL_SUCCESS);
    CHECK(dal_stepper_error(stepper)->text[0] == '\0');
    CHECK(dal_advance(stepper, 3, NULL, &done) == DAL_SUCCESS && done == 3);
    CHECK(dal_stepper_time(stepper) == 2.75);

    memcpy(off, x0, sizeof off); /* mu v = 0.5, sum |mu_i| max |v_i| = 1.3 */
    off[5] += 0.5;
    check_refused(stepper, 0.0, 0.1, off, DAL_CHECK, 0, DAL_EOFFD, "0.385");
    check_refused(stepper, 0.0, 0.0, x0, DAL_CHECK, 0, DAL_EINVAL, "h = 0");
    check_refused(stepper, 0.0, NAN, x0, DAL_CHECK, 0, DAL_EINVAL, "h = ");
    check_refused(stepper, 0.0, INFINITY, x0, DAL_CHECK, 0, DAL_EINVAL, "h = inf");
    check_refused(stepper, 0.0, 1e-310, x0, DAL_CHECK, 0, DAL_EINVAL, "h = "); /* 1/h is not */
    check_refused(stepper, 1e17, 1.0, x0, DAL_CHECK, 0, DAL_EINVAL, "does not change t0");
    check_refused(stepper, NAN, 0.1, x0, DAL_CHECK, 0, DAL_EINVAL, "t0 = ");
    check_refused(stepper, 0.0, 0.1, NULL, DAL_CHECK, 0, DAL_EINVAL, "x is NULL");
    check_refused(stepper, 0.0, 0.1, x0, 3, 0, DAL_EINVAL, "consistency = 3");
    check_refused(stepper, 0.0, 0.1, x0, DAL_CHECK, 5, DAL_EINVAL, "initial = 5");
    check_refused(stepper, 0.0, 0.1, x0, DAL_CHECK, DAL_INITIAL_D, DAL_EINVAL, "initial = 1");
    memcpy(off, x0, sizeof off);
    off[2] = NAN;
    check_refused(stepper, 0.0, 0.1, off, DAL_ASSUME, 0, DAL_EINVAL, "q[2]");
    off[2] = 0.0;
    off[4] = -INFINITY;
    check_refused(stepper, 0.0, 0.1, off, DAL_ASSUME, 0, DAL_EINVAL, "v[1] = -inf");
    CHECK(dal_stepper_start(nodes, 0.0, 0.1, x0, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(nodes)->text, "initial") != NULL);
    CHECK(dal_step(nodes, NULL) == DAL_EINVAL); /* still not started */
    const double fast[6] = {1.7e308, 0.3, 0.0, 1e308, 0.0, 0.3e308};
    CHECK(dal_stepper_start(nodes, 0.0, 10.0, fast, DAL_ASSUME, DAL_INITIAL_SHIFT) == DAL_EDOMAIN);
    CHECK(strstr(dal_stepper_error(nodes)->text, "q + 5 v overflows") != NULL);
    CHECK(dal_stepper_start(NULL, 0.0, 0.1, x0, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EINVAL);
    CHECK(dal_step(stepper, NULL) == DAL_SUCCESS && dal_stepper_time(stepper) == 3.0);

    /* Nearly consistent data are mended; projected data are the nearest of D; assumed ones stay. */
    memcpy(off, x0, sizeof off);
    off[5] += 1e-9;
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, off, DAL_CHECK, DAL_INITIAL_NONE) == DAL_SUCCESS);
    CHECK(residual_of(system, 0.0, dal_stepper_state(stepper)) <= DAL_RESIDUAL_BOUND(3));
    const dal_stats stats = stats_of(stepper);
    CHECK_NEAR(stats.initial_residual, 1e-9 / 1.3, 1e-9 * 1e-6);
    CHECK_NEAR(stats.initial_correction, 1e-9 / sqrt(1.09), 1e-9 * 1e-6);
    off[5] = x0[5] + 0.5; /* Z C^-1 mu v = (-y, 0, 1) 0.5 / (1 + y^2) */
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, off, DAL_PROJECT, DAL_INITIAL_NONE) == DAL_SUCCESS);
    CHECK_NEAR(dal_stepper_state(stepper)[3], x0[3] + 0.3 * 0.5 / 1.09, 8 * U);
    CHECK_NEAR(dal_stepper_state(stepper)[5], x0[5] + 0.5 - 0.5 / 1.09, 8 * U);
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, off, DAL_ASSUME, DAL_INITIAL_NONE) == DAL_SUCCESS);
    CHECK(memcmp(dal_stepper_state(stepper), off, sizeof off) == 0);
}

/* A start forgets: the same data give the same bits, whatever was done before. */
static void test_restart(void)
{
    dal_system *const system = open_system("generic4");
    const char *const names[] = {"midpoint", "leapfrog", "leapfrog-yoshida4", "endpoint"};
    for (size_t j = 0; j < 4; j++) {
        const dal_scheme scheme = find_scheme(names[j]);
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        double x0[8], x[8], other[8] = {0};
        CHECK(dal_system_state(system, x0) == 0);
        CHECK(dal_stepper_start(stepper, 0.0, 0.2, other, DAL_ASSUME, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(stepper, 17, NULL, NULL) == 0);
        CHECK(dal_stepper_start(stepper, 0.0, 0.05, x0, DAL_ASSUME, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(stepper, 30, NULL, NULL) == 0);
        flow(system, &scheme, 0.05, 30, x0, x, NULL);
        CHECK(largest_difference(8, x, dal_stepper_state(stepper)) == 0.0);
        release(stepper);
    }
}

/* ---- options and statistics -------------------------------------------------------------- */

static void test_options(void)
{
    dal_system *const system = open_system("particle");
    const dal_scheme midpoint = find_scheme("midpoint"), none = {.beta = 2.0};
    const dal_options negative = {.max_iterations = -2};
    dal_stepper *stepper = NULL;
    dal_error error;
    CHECK(dal_stepper_new(&stepper, system, &midpoint, &negative, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "max_iterations = -2") && error.status == DAL_EINVAL && !stepper);
    CHECK(dal_stepper_new(&stepper, system, &none, NULL, &error) == DAL_EINVAL && !stepper);
    CHECK(strstr(error.text, "beta = 2") != NULL);
    CHECK(dal_stepper_new(NULL, system, &midpoint, NULL, &error) == DAL_EINVAL);
    CHECK(dal_stepper_new(&stepper, NULL, &midpoint, NULL, &error) == DAL_EINVAL && !stepper);
    CHECK(dal_stepper_new(&stepper, system, NULL, NULL, NULL) == DAL_EINVAL && !stepper);
    dal_stepper_free(NULL);
}

/* Constant sizes and run-time sizes make the same operations in the same order: the same bits. */
static void test_sizes(void)
{
    enum { STEPS = 1000 };
    const char *const names[] = {"leapfrog", "midpoint-nodes"};
    for (size_t n = 1; n <= 8; n++)
        CHECK(dal__kernel_for(n, n, false) == dal__kernel_any(false)
              && dal__kernel_for(n, n, true) == dal__kernel_any(true));
    for (size_t n = 1; n <= 6; n++)
        for (size_t m = 0; m < n && m <= 4; m++)
            for (int kind = 0; kind < 4; kind++) {
                wide w;
                dal_system *const system = open_wide(&w, n, m, kind % 2 == 0, kind / 2 == 0);
                const dal_scheme scheme = find_scheme(names[kind == 0 || kind == 3]);
                const dal_initial initial =
                    scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE;
                dal_stepper *const fixed = open_stepper(system, &scheme, NULL);
                dal_stepper *const any = open_stepper_by(BY_ANY_SIZES, system, &scheme);
                double one[MOST_M], two[MOST_M];
                CHECK(dal__kernel_for(n, m, false) != dal__kernel_any(false));
                CHECK(dal_stepper_start(fixed, 0.0, 0.05, w.state, DAL_CHECK, initial) == 0);
                CHECK(dal_stepper_start(any, 0.0, 0.05, w.state, DAL_CHECK, initial) == 0);
                CHECK(dal_advance(fixed, STEPS, one, NULL) == DAL_SUCCESS);
                CHECK(dal_advance(any, STEPS, two, NULL) == DAL_SUCCESS);
                CHECK(memcmp(dal_stepper_state(fixed), dal_stepper_state(any),
                             2 * n * sizeof(double)) == 0);
                CHECK(memcmp(one, two, m * sizeof(double)) == 0);
                CHECK(largest_difference(2 * n, w.state, dal_stepper_state(any)) > 0.0);
                release(system);
            }
}

/* The oracle, which solves for all n + m unknowns, shares no formula with the step routine. */
static void test_multiroot(void)
{
    const char *const names[] = {"explicit", "0.25", "midpoint", "endpoint", "leapfrog",
                                 "leapfrog-mirror", "midpoint-nodes", "midpoint-yoshida4"};
    for (size_t s = 0; s < SYSTEMS; s++)
        for (size_t j = 0; j < sizeof names / sizeof names[0]; j++) {
            dal_system *const system = open_system(all_systems[s]);
            const size_t n = dal_system_n(system), m = dal_system_m(system);
            const dal_scheme scheme = find_scheme(names[j]);
            const dal_initial initial =
                scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE;
            double x0[2 * MOST_N], x[2 * MOST_N], lambda[MOST_M], other[MOST_M];
            moved_state(system, x0);
            dal_stepper *const slow = open_stepper_by(BY_MULTIROOT, system, &scheme);
            CHECK(dal_stepper_start(slow, 0.0, 0.05, x0, DAL_ASSUME, initial) == 0);
            CHECK(dal_step(slow, other) == DAL_SUCCESS);
            flow_from(system, &scheme, 0.05, initial, 1, x0, x, lambda);
            const double extent = sum_of_sizes(2 * n, x);
            CHECK_NEAR(largest_difference(2 * n, dal_stepper_state(slow), x), 0.0, 64 * U * extent);
            CHECK_NEAR(largest_difference(m, other, lambda), 0.0, 256 * U * extent / 0.05);
            const dal_stats stats = stats_of(slow);
            CHECK(stats.steps == 1 && stats.iterations > 0 && dal_stepper_time(slow) == 0.05);
            release(system);
        }
}

/* Where a predicted velocity or residual could mislead: from rest, with the gradient of one stage
 * reused by the next in another weight, in stages without a span.  Each step is compared with one
 * of the oracle from the same state. */
static void test_corners(void)
{
    static const dal_substep near_one[] = {{0.99, 1.0}}, uneven[] = {{0.9, 0.5}, {0.1, 0.5}},
                             mixed[] = {{0.3, 0.5}, {0.0, 0.5}},
                             no_span[] = {{0.0, 0.5}, {1.0, -0.5}, {0.5, 1.0}};
    const dal_scheme records[] = {{.name = "near one", .count = 1, .substeps = near_one},
                                  {.name = "uneven", .count = 2, .substeps = uneven},
                                  {.name = "mixed", .count = 2, .substeps = mixed},
                                  {.name = "no span", .count = 3, .substeps = no_span},
                                  {.name = "midpoint", .beta = 0.5},
                                  {.name = "endpoint", .beta = 1.0}};
    const char *const names[] = {"particle_oscillator", "robot", "generic4", "chaotic"};
    for (size_t s = 0; s < sizeof names / sizeof names[0]; s++)
        for (size_t j = 0; j < sizeof records / sizeof records[0]; j++) {
            dal_system *const system = open_system(names[s]);
            const size_t n = dal_system_n(system);
            dal_stepper *const stepper = open_stepper(system, &records[j], NULL);
            dal_stepper *const slow = open_stepper_by(BY_MULTIROOT, system, &records[j]);
            double x[2 * MOST_N];
            CHECK(dal_system_state(system, x) == 0);
            const bool at_rest = s % 2 == 0 && j != 3; /* hybridsj finds no way out of no_span */
            for (size_t i = 0; at_rest && i < n; i++) x[n + i] = 0.0;
            CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
            for (int step = 0; step < 40; step++) {
                CHECK(dal_stepper_start(slow, 0.0, 0.1, dal_stepper_state(stepper), DAL_ASSUME,
                                        DAL_INITIAL_NONE) == 0);
                CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
                CHECK(dal_step(slow, NULL) == DAL_SUCCESS);
                const double *const y = dal_stepper_state(slow);
                CHECK_NEAR(largest_difference(2 * n, dal_stepper_state(stepper), y), 0.0,
                           ROUNDOFF * sum_of_sizes(2 * n, y));
            }
            release(system);
        }
}

/* From rest d(mu v)/dq is 0, and tells nothing of how mu bends: the first step iterates. */
static int bent_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                           double *phi_q, double *phi_t, void *ctx)
{
    if (phi) phi[0] = q[0] * v[0] + (2 * q[1] + q[0]) * v[1] + v[2];
    if (phi_v) phi_v[0] = q[0], phi_v[1] = 2 * q[1] + q[0], phi_v[2] = 1.0;
    if (phi_q) phi_q[0] = v[0] + v[1], phi_q[1] = 2 * v[1], phi_q[2] = 0.0;
    return 0;
}

static int slope_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                           void *ctx)
{
    if (V) *V = q[2];
    if (V_q) V_q[0] = V_q[1] = 0.0, V_q[2] = 1.0;
    for (int i = 0; V_qq && i < 9; i++) V_qq[i] = 0.0;
    return 0;
}

static void test_from_rest(void)
{
    const double mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, x0[6] = {0.5, 0.4, 0.0, 0.0, 0.0, 0.0};
    const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = bent_constraint,
                                .potential = slope_potential};
    const char *const names[] = {"leapfrog", "midpoint", "endpoint"};
    dal_system *const system = new_system(&def);
    for (size_t j = 0; j < sizeof names / sizeof names[0]; j++) {
        const dal_scheme scheme = find_scheme(names[j]);
        dal_stepper *const slow = open_stepper_by(BY_MULTIROOT, system, &scheme);
        double x[6];
        CHECK(dal_stepper_start(slow, 0.0, 0.5, x0, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        CHECK(dal_step(slow, NULL) == DAL_SUCCESS);
        flow(system, &scheme, 0.5, 1, x0, x, NULL);
        CHECK_NEAR(largest_difference(6, dal_stepper_state(slow), x), 0.0,
                   ROUNDOFF * sum_of_sizes(6, x));
        release(slow);
    }
}

/* A blade whose angle is the sum of two coordinates: far from the origin the rounding of the sum is
 * one that no derivative tells of. */
static int sum_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                          double *phi_q, double *phi_t, void *ctx)
{
    const double s = sin(q[2] + q[3]), c = cos(q[2] + q[3]);
    (void)ctx;
    if (phi) phi[0] = s * v[0] - c * v[1];
    if (phi_v) phi_v[0] = s, phi_v[1] = -c, phi_v[2] = phi_v[3] = 0.0;
    if (phi_q) phi_q[0] = phi_q[1] = 0.0, phi_q[2] = phi_q[3] = c * v[0] + s * v[1];
    return 0;
}

static void test_far_from_the_origin(void)
{
    const double mass[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 3};
    const dal_system_def def = {.n = 4, .m = 1, .mass = mass, .constraint = sum_constraint};
    const double x0[8] = {0.0, 0.0, 1.0e4, 0.3, cos(1.0e4 + 0.3), sin(1.0e4 + 0.3), 1.0, -0.4};
    const char *const names[] = {"midpoint", "leapfrog-mirror", "midpoint-nodes"};
    for (size_t j = 0; j < sizeof names / sizeof names[0]; j++) {
        const dal_scheme scheme = find_scheme(names[j]);
        const bool kept = scheme.nodes == DAL_KEPT_NODES;
        dal_system *const system = new_system(&def);
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        dal_mechanics *const mechanics = open_mechanics(system);
        int above = 0;
        double relative;
        CHECK(dal_stepper_start(stepper, 0.0, 0.01, x0, DAL_CHECK,
                                kept ? DAL_INITIAL_PROJECT : DAL_INITIAL_NONE) == 0);
        for (int step = 0; step < 20000; step++) {
            CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
            CHECK(dal_relative_residual(mechanics, 0.0, kept ? 0.005 : 0.0,
                                        dal_stepper_state(stepper),
                                        &relative) == DAL_SUCCESS);
            above += relative > DAL_RESIDUAL_BOUND(4);
        }
        CHECK(above == 0);
        release(system);
    }
}

/* What a step costs: without V and with h <= 0.01 the constraint is evaluated twice, and once more
 * where the system is not steady; hardly ever again. */
static void test_statistics(void)
{
    enum { STEPS = 2000 };
    const char *const names[] = {"particle", "sleigh", "disk"};
    const char *const schemes[] = {"midpoint", "leapfrog"};
    for (size_t s = 0; s < 3; s++)
        for (size_t j = 0; j < 2; j++) {
            dal_system *const system = open_system(names[s]);
            const dal_scheme scheme = find_scheme(schemes[j]);
            double x[2 * MOST_N];
            dal_stats start, stats;
            CHECK(dal_system_state(system, x) == 0);
            dal_stepper *const stepper = start_stepper(system, &scheme, 0.01, x);
            dal_stepper_stats(stepper, &start);
            CHECK(start.steps == 0 && start.iterations == 0);
            CHECK(dal_advance(stepper, STEPS, NULL, NULL) == DAL_SUCCESS);
            dal_stepper_stats(stepper, &stats);
            const double calls = (double)(stats.constraint_calls - start.constraint_calls) / STEPS;
            CHECK(s == 1 ? calls >= 3.0 && calls <= 3.2 : calls >= 2.0 && calls <= 2.2);
            CHECK(stats.steps == STEPS && stats.substeps == STEPS);
            CHECK(stats.iterations >= STEPS && stats.potential_calls == start.potential_calls);
            CHECK(stats.full_newtons == 0 && stats.halvings == 0);
            CHECK(stats.worst_residual <= DAL_RESIDUAL_BOUND(dal_system_n(system)));
            CHECK(stats.differenced == 0);
            release(system);
        }
    /* "explicit" evaluates mu once a step, and V_q once. */
    dal_system *const system = open_system("particle_oscillator");
    const dal_scheme scheme = find_scheme("explicit");
    double x[6];
    dal_stats start, stats;
    CHECK(dal_system_state(system, x) == 0);
    dal_stepper *const stepper = start_stepper(system, &scheme, 0.01, x);
    dal_stepper_stats(stepper, &start);
    CHECK(dal_advance(stepper, STEPS, NULL, NULL) == DAL_SUCCESS);
    dal_stepper_stats(stepper, &stats);
    CHECK(stats.potential_calls - start.potential_calls == STEPS);
    CHECK(stats.constraint_calls - start.constraint_calls <= STEPS + STEPS / 5);
}

/* The particle at y = -1 with h v_y = 2: S = 1 + y y1 = 0 exactly for beta = 1. */
static void test_singular_step(void)
{
    const double x0[6] = {0.0, -1.0, 0.0, 1.0, 1.0, -1.0};
    dal_system *const system = open_system("particle");
    dal_stepper *const stepper = open_named(system, "endpoint");
    double lambda = 7.0;
    CHECK(dal_stepper_start(stepper, 0.0, 2.0, x0, DAL_CHECK, DAL_INITIAL_NONE) == DAL_SUCCESS);
    CHECK(dal_step(stepper, &lambda) == DAL_ESINGULAR && lambda == 7.0);
    CHECK(memcmp(dal_stepper_state(stepper), x0, sizeof x0) == 0);
    CHECK(strstr(dal_stepper_error(stepper)->text, "step 1 (t = 0, h = 2)") != NULL);
}

/* ---- looks at the energy ------------------------------------------------------------------ */

/* V = k q^2/2; V itself, which looks alone ask for, may stop. */
typedef struct watched {
    double k;
    bool stops;
} watched;

static int watched_spring(double t, const double *q, double *V, double *V_q, double *V_qq,
                          void *ctx)
{
    const watched *const w = ctx;
    if (V && w->stops) return -1;
    if (V) *V = 0.5 * w->k * q[0] * q[0];
    if (V_q) V_q[0] = w->k * q[0];
    if (V_qq) V_qq[0] = w->k;
    return 0;
}

/* With h^2 k a little above 4 the leapfrog grows.  However the steps are asked for, the look after
 * the 64th finds it; and what stops a look stops the steps. */
static void test_looks(void)
{
    const double mass[1] = {1.0}, x0[2] = {1.0, 0.0};
    watched w = {.k = 4.01};
    const dal_system_def def = {.n = 1, .mass = mass, .potential = watched_spring, .ctx = &w};
    dal_stepper *const stepper = start_named(new_system(&def), "leapfrog", 1.0, x0);
    for (size_t at_once = 1; at_once <= 200; at_once += 9) {
        double kinetic = 0.0;
        CHECK(dal_stepper_start(stepper, 0.0, 1.0, x0, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        for (size_t steps = 0; steps < 200; steps += at_once) {
            CHECK(dal_advance(stepper, at_once, NULL, NULL) == 0);
            const double v = dal_stepper_state(stepper)[1];
            if (steps + at_once == 64) kinetic = 0.5 * v * v;
        }
        const dal_stats stats = stats_of(stepper);
        CHECK(stats.jump_step == 64);
        CHECK(kinetic == 0.0 || stats.largest_kinetic == kinetic);
    }
    size_t done = 0;
    CHECK(dal_stepper_start(stepper, 0.0, 1.0, x0, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    w.stops = true;
    CHECK(dal_advance(stepper, 200, NULL, &done) == DAL_EUSER && done == 64);
    CHECK(strstr(dal_stepper_error(stepper)->text, "potential") != NULL);
}

/* What the predictions of a stage leave to be evaluated: three times in a stage at best, where
 * the parabola, or the line, through the stages before serves; more where their times differ so
 * much that neither does. */
static void test_predictions(void)
{
    static const struct {
        const char *system, *scheme;
        double h, most;
    } cases[] = {{"sleigh", "leapfrog", 0.02, 3.04},          /* 3.24 along lines only */
                 {"generic4", "leapfrog", 0.02, 3.06},        /* 3.14 where weights end at 5 */
                 {"snakeboard", "leapfrog-suzuki4", 0.1, 3.34}, /* 3.44 where they end at 30 */
                 {"sleigh", "leapfrog-suzuki4", 0.02, 3.02},  /* 3.26 without lines */
                 {"sleigh", "leapfrog-kl8", 0.02, 3.02}};     /* 3.92 by pulls of any span */
    for (size_t i = 0; i < DAL_LENGTH(cases); i++) {
        dal_system *const system = open_system(cases[i].system);
        const dal_scheme scheme = find_scheme(cases[i].scheme);
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        double x[16];
        CHECK(dal_system_state(system, x) == 0);
        CHECK(dal_stepper_start(stepper, 0.0, cases[i].h, x, DAL_PROJECT, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(stepper, 400, NULL, NULL) == 0);
        const dal_stats stats = stats_of(stepper);
        CHECK((double)stats.constraint_calls < cases[i].most * (double)stats.substeps);
        release(system);
    }
}

int main(void)
{
    test_equations();
    test_roundings();
    test_even_turns();
    test_free_heading();
    test_exact_energy();
    test_momenta();
    test_adjoints();
    test_there_and_back();
    test_reversibility();
    test_mixing();
    test_leapfrog_is_midpoint();
    test_no_constraint();
    test_own_record();
    test_reactions();
    test_kept_nodes();
    test_starts();
    test_restart();
    test_options();
    test_sizes();
    test_multiroot();
    test_corners();
    test_from_rest();
    test_far_from_the_origin();
    test_statistics();
    test_singular_step();
    test_looks();
    test_predictions();
    return check_done();
}
