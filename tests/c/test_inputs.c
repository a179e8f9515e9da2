/* Inputs of the force and of constraints: constant over a step, changed between steps.
 *
 * A cart on a blade with the heading theta, with a brake, a motor that pushes it ahead, one that
 * turns it, and a wind from the side, which the blade takes:
 *     f = (u0 - brake s) e + u2 n,  f_theta = u1,  e = (cos theta, sin theta),  n = (sin theta,
 *     -cos theta),  so with v = s e, omega = theta':
 *     s' = (u0 - brake s)/m,  omega' = u1/J,  lambda = -m s omega - u2. */
#include "fixtures.h"
#include "check.h"
#include "dalembert/run.h"

enum { N = 3, INPUTS = 3, HOLDS = 4, STEPS = 24 };
static const double m = 2.0, J = 0.75, brake = 0.6;
static const double mass[9] = {2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.75};
static const double start[6] = {0.3, -0.2, 0.4, 0.92106099400288508, 0.38941834230865049, 1.1};
static const double table[HOLDS * INPUTS] = {1.5, -0.8, 0.7, -2.0, 1.9, 0.0,
                                             0.4, 0.3,  -1.2, 3.0, -2.5, 2.2};

/* ctx: NULL, or how wrong f_q is, in units of u0. */
static int motors(double t, const double *q, const double *v, const double *u, double *f,
                  double *f_q, double *f_v, void *ctx)
{
    const double sine = sin(q[2]), cosine = cos(q[2]), wrong = ctx ? *(const double *)ctx : 0.0;
    if (f) {
        f[0] = u[0] * cosine - brake * v[0] + u[2] * sine;
        f[1] = u[0] * sine - brake * v[1] - u[2] * cosine;
        f[2] = u[1];
    }
    if (f_q) {
        memset(f_q, 0, 9 * sizeof *f_q);
        f_q[2] = -u[0] * sine + u[2] * cosine + wrong * u[0];
        f_q[5] = u[0] * cosine + u[2] * sine;
    }
    if (f_v) memcpy(f_v, (double[]){-brake, 0, 0, 0, -brake, 0, 0, 0, 0}, 9 * sizeof *f_v);
    return 0;
}

static dal_system *open_cart(const double *wrong)
{
    static const char *const names[] = {"push", "turn", "wind"};
    const dal_system_def def = {.n = N, .m = 1, .mass = mass, .constraint = plane_blade,
                                .force = motors, .inputs = INPUTS, .input_names = names,
                                .name = "cart", .state = start, .ctx = (void *)wrong};
    return new_system(&def);
}

/* ---- the solution, by its own equations ---------------------------------------------------- */

/* d/dt of (x, y, theta, s, omega, work of the motors and the brake). */
static void rates(const double *u, const long double y[6], long double dy[6])
{
    const long double s = y[3], push = u[0] - brake * s;
    dy[0] = s * cosl(y[2]);
    dy[1] = s * sinl(y[2]);
    dy[2] = y[4];
    dy[3] = push / m;
    dy[4] = u[1] / J;
    dy[5] = push * s + u[1] * y[4];
}

/* y after a time T, by the classical Runge-Kutta method with an error of about 1e-16. */
static void solve(const double *u, double T, long double y[6])
{
    enum { PARTS = 2000 };
    const long double h = T / PARTS;
    for (int part = 0; part < PARTS; part++) {
        static const long double node[4] = {0, 0.5L, 0.5L, 1}, weight[4] = {1, 2, 2, 1};
        long double k[4][6], moved[6];
        for (int i = 0; i < 4; i++) {
            for (int j = 0; j < 6; j++) moved[j] = y[j] + (i ? node[i] * h * k[i - 1][j] : 0);
            rates(u, moved, k[i]);
        }
        for (int j = 0; j < 6; j++)
            for (int i = 0; i < 4; i++) y[j] += h / 6 * weight[i] * k[i][j];
    }
}

/* x[6] <- the state after HOLDS times T with the inputs of the table; *work <- what they did. */
static void expect(double T, double *x, double *work)
{
    long double y[6] = {start[0], start[1], start[2], 1.0L, start[5], 0.0L};
    for (size_t k = 0; k < HOLDS; k++) solve(table + k * INPUTS, T, y);
    const double c = (double)cosl(y[2]), s = (double)sinl(y[2]), v = (double)y[3];
    memcpy(x, (double[]){(double)y[0], (double)y[1], (double)y[2], v * c, v * s, (double)y[4]},
           6 * sizeof *x);
    *work = (double)y[5];
}

/* ---- orders -------------------------------------------------------------------------------- */

static double error_of(const dal_system *system, const char *scheme, double T, size_t hold,
                       double *balance)
{
    double inputs[HOLDS * INPUTS], x[6], work, energy[2], row[12];
    dal_mechanics *const mechanics = open_mechanics(system);
    dal_stepper *const stepper = start_at(system, scheme, 0.0, T / (double)hold, start);
    memcpy(inputs, table, sizeof inputs);
    dal_run run = {.stepper = stepper, .steps = HOLDS * hold, .stride = HOLDS * hold, .x = row,
                   .inputs = inputs, .input_steps = hold};
    need(dal_run_go(&run, SIZE_MAX), scheme, dal_stepper_error(stepper)->text);
    CHECK(memcmp(inputs, table, sizeof inputs) == 0);
    expect(T, x, &work);
    CHECK(dal_trajectory(mechanics, 0.0, 1.0, 0.0, 2, row, NULL, energy, NULL, NULL, NULL, NULL)
          == 0);
    *balance = fabs(energy[1] - energy[0] - work);
    const double error = largest_difference(6, row + 6, x);
    return error;
}

/* The error, and that of the energy balance, from one h to half of it. */
static void check_order(const dal_system *system, const char *scheme, size_t hold, double order)
{
    double coarse_balance, fine_balance;
    const double coarse = error_of(system, scheme, 0.8, hold, &coarse_balance);
    const double fine = error_of(system, scheme, 0.8, 2 * hold, &fine_balance);
    const double slope = log2(coarse / fine);
    CHECK(slope > order - 0.25 && slope < order + 1.2);
    CHECK(fine_balance <= fmax(coarse_balance / exp2(order - 0.4), 64 * U));
    if (!(slope > order - 0.25 && slope < order + 1.2))
        fprintf(stderr, "%s: order %.2f\n", scheme, slope);
}

static void test_orders(const dal_system *system)
{
    check_order(system, "endpoint", 64, 1.0);
    check_order(system, "midpoint", 16, 2.0);
    check_order(system, "leapfrog", 16, 2.0);
    check_order(system, "pair:0.5:0.5", 16, 2.0);
    check_order(system, "leapfrog-suzuki4", 8, 4.0);
    check_order(system, "midpoint-kl6", 4, 6.0);
    check_order(system, "leapfrog-kl8", 4, 8.0);
    double balance;
    CHECK(error_of(system, "reference", 0.8, 4, &balance) < 1e-12 && balance < 1e-12);
}

/* ---- one way or another, the same bits ----------------------------------------------------- */

typedef struct controller {
    size_t hold;
    int calls, answer;
    bool silent;
    double moved; /* the most that the start may differ from the data */
} controller;

static int control(size_t step, double t, const double *x, double *u, void *ctx)
{
    controller *const self = ctx;
    self->calls++;
    CHECK(step % self->hold == 0 && t == (double)step * 0.05 && isnan(u[0]) && isnan(u[2]));
    CHECK(step > 0 || largest_difference(6, x, start) <= self->moved);
    if (!self->silent)
        memcpy(u, table + step / self->hold % HOLDS * INPUTS, INPUTS * sizeof *u);
    return step >= 4 * self->hold ? self->answer : 0;
}

/* A table, a controller, budgets of any size, and a loop of the caller's. */
static void check_ways(const dal_system *system, const char *scheme, size_t stride, size_t hold)
{
    enum { ROWS = STEPS + 1 };
    const size_t holds = (STEPS + hold - 1) / hold;
    double inputs[STEPS * INPUTS], written[STEPS * INPUTS], rows[4][ROWS * 6] = {0};
    double reactions[4][STEPS] = {0};
    for (size_t k = 0; k < STEPS * INPUTS; k++) inputs[k] = table[k % (HOLDS * INPUTS)];
    controller self = {.hold = hold, .moved = strstr(scheme, "-nodes") ? 0.05 : 4 * U};
    const size_t budgets[] = {SIZE_MAX, 1, 5};
    for (size_t way = 0; way < 3; way++) {
        dal_stepper *const stepper = start_at(system, scheme, 0.0, 0.05, start);
        dal_run run = {.stepper = stepper, .steps = STEPS, .stride = stride, .x = rows[way],
                       .reactions = reactions[way], .inputs = way ? written : inputs,
                       .input_steps = hold == 1 ? 0 : hold, .control = way ? control : NULL,
                       .control_ctx = &self};
        self.calls = 0;
        while (run.done < STEPS) CHECK(dal_run_go(&run, budgets[way]) == DAL_SUCCESS);
        CHECK(self.calls == (way ? (int)holds : 0));
        CHECK(!way || memcmp(written, inputs, holds * INPUTS * sizeof *inputs) == 0);
        release(stepper);
    }
    dal_stepper *const stepper = start_at(system, scheme, 0.0, 0.05, start);
    memcpy(rows[3], start, sizeof start);
    if (dal_stepper_state(stepper)[0] != start[0])
        memcpy(rows[3], dal_stepper_state(stepper), sizeof start);
    for (size_t k = 0; k < STEPS; k++) {
        if (k % hold == 0) CHECK(dal_stepper_input(stepper, inputs + k / hold * INPUTS) == 0);
        CHECK(dal_step(stepper, NULL) == DAL_SUCCESS);
        if ((k + 1) % stride == 0)
            memcpy(rows[3] + (k + 1) / stride * 6, dal_stepper_state(stepper), sizeof start);
    }
    const size_t used = STEPS / stride;
    for (size_t way = 1; way < 4; way++)
        CHECK(memcmp(rows[way], rows[0], (used + 1) * 6 * sizeof(double)) == 0);
    for (size_t way = 1; way < 3; way++)
        CHECK(memcmp(reactions[way], reactions[0], used * sizeof(double)) == 0
              || isnan(reactions[0][0]));
}

static void test_ways(const dal_system *system)
{
    static const char *const schemes[] = {"midpoint", "leapfrog-kl6", "midpoint-nodes",
                                          "pair:0:0.5", "reference"};
    for (size_t i = 0; i < sizeof schemes / sizeof *schemes; i++) {
        check_ways(system, schemes[i], 1, 1);
        check_ways(system, schemes[i], 4, 3);
        check_ways(system, schemes[i], 3, 5);
    }
}

/* ---- who else evaluates the force ---------------------------------------------------------- */

static int midpoint_map(double h, const double *q0, const double *q1, double *g, double *f,
                        double *g_0, double *g_1, double *f_0, double *f_1, void *ctx)
{
    for (size_t i = 0; i < N; i++) {
        if (g) g[i] = 0.5 * (q0[i] + q1[i]);
        if (f) f[i] = (q1[i] - q0[i]) / h;
        for (size_t j = 0; j < N; j++) {
            if (g_0) g_0[i * N + j] = i == j ? 0.5 : 0.0;
            if (g_1) g_1[i * N + j] = i == j ? 0.5 : 0.0;
            if (f_0) f_0[i * N + j] = i == j ? -1.0 / h : 0.0;
            if (f_1) f_1[i * N + j] = i == j ? 1.0 / h : 0.0;
        }
    }
    return 0;
}

static void test_geometry(const dal_system *system)
{
    const double u[INPUTS] = {1.5, -0.8, 0.7}, zero[INPUTS] = {0}, bad[INPUTS] = {1, NAN, 0};
    const double e[2] = {cos(start[2]), sin(start[2])}, omega = start[5];
    const double along = 1.0; /* the speed */
    const double lambda = -m * along * omega - u[2], ahead = (u[0] - brake * along) / m;
    const double xdot[6] = {start[3], start[4], omega, ahead * e[0] - omega * e[1],
                            ahead * e[1] + omega * e[0], u[1] / J};
    dal_mechanics *const mechanics = open_mechanics(system);
    double field[6], constraint, force, multipliers[2], twice[12], inputs[6];
    CHECK(dal_mechanics_input(mechanics, u) == 0 && dal_field(mechanics, 0.0, start, field) == 0);
    CHECK_NEAR(largest_difference(6, field, xdot), 0.0, 32 * U);
    CHECK(dal_power(mechanics, 0.0, start, &constraint, &force) == 0);
    CHECK_NEAR(force, (u[0] - brake * along) * along + u[1] * omega, 32 * U);
    memcpy(twice, start, sizeof start);
    memcpy(twice + 6, start, sizeof start);
    memcpy(inputs, zero, sizeof zero);
    memcpy(inputs + 3, (double[]){9, 9, 4}, sizeof zero);
    CHECK(dal_trajectory(mechanics, 0, 1, 0, 2, twice, inputs, NULL, multipliers, NULL, NULL, NULL)
          == 0);
    CHECK_NEAR(multipliers[0], lambda + u[2], 32 * U);
    CHECK_NEAR(multipliers[1], lambda + u[2] - 4, 64 * U);
    CHECK(dal_multipliers(mechanics, 0, start, multipliers) == 0); /* those that were set */
    CHECK_NEAR(multipliers[0], lambda, 32 * U);
    inputs[4] = INFINITY;
    size_t done = 9;
    CHECK(dal_trajectory(mechanics, 0, 1, 0, 2, twice, inputs, NULL, multipliers, NULL, NULL, &done)
          == DAL_EINVAL && done == 1);
    CHECK(strcmp(dal_mechanics_error(mechanics)->text, "inputs[1] = inf is not finite") == 0);
    CHECK(dal_mechanics_input(mechanics, bad) == DAL_EINVAL
          && dal_mechanics_input(mechanics, NULL) == DAL_EINVAL
          && dal_mechanics_input(NULL, u) == DAL_EINVAL);
    CHECK(dal_multipliers(mechanics, 0, start, multipliers) == 0);
    CHECK_NEAR(multipliers[0], lambda, 32 * U);

    double xi[5], xidot[5], dropped[5];
    dal_chart *const chart = open_chart(system);
    CHECK(dal_chart_choose(chart, 0.0, NULL, start) == 0 && dal_chart_drop(chart, start, xi) == 0
          && dal_chart_drop(chart, xdot, dropped) == 0);
    CHECK(dal_chart_input(chart, u) == 0 && dal_chart_field(chart, 0.0, xi, xidot) == 0);
    CHECK_NEAR(largest_difference(5, xidot, dropped), 0.0, 64 * U);
    CHECK(dal_chart_input(NULL, u) == DAL_EINVAL && dal_chart_input(chart, bad) == DAL_EINVAL);

    double x[6], end[6], work;
    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_XI, 1e-13);
    memcpy(x, start, sizeof x);
    for (size_t k = 0; k < HOLDS; k++)
        CHECK(dal_flow_input(flow, table + k * INPUTS) == 0
              && dal_flow_apply(flow, 0.5 * (double)k, 0.5 * (double)(k + 1), x, NULL) == 0);
    expect(0.5, end, &work);
    CHECK_NEAR(largest_difference(6, x, end), 0.0, 1e-12);
    CHECK(dal_flow_input(NULL, u) == DAL_EINVAL && dal_flow_input(flow, bad) == DAL_EINVAL);
}

/* A pair with maps of the user's own is the pair of the same maps by name. */
static void test_own_maps(const dal_system *system)
{
    const dal_difference_map map = {.beta = 0.5, .map = midpoint_map};
    const dal_pair maps = {map, map};
    dal_scheme own = find_scheme("pair:0.5:0.5");
    own.data = &maps;
    dal_stepper *const steppers[] = {open_stepper(system, &own, NULL),
                                     start_at(system, "pair:0.5:0.5", 0.0, 0.05, start)};
    CHECK(dal_stepper_start(steppers[0], 0.0, 0.05, start, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    for (size_t k = 0; k < HOLDS; k++) {
        double reactions[2];
        for (int i = 0; i < 2; i++)
            CHECK(dal_stepper_input(steppers[i], table + k * INPUTS) == 0
                  && dal_step(steppers[i], &reactions[i]) == 0);
        CHECK_NEAR(largest_difference(6, dal_stepper_state(steppers[0]),
                                      dal_stepper_state(steppers[1])), 0.0, 64 * U);
        CHECK_NEAR(reactions[0], reactions[1], 1e-12);
    }
}

static int no_change(double t, const double *q, const double *v, double *g, double *g_v,
                     double *g_q, double *g_t, void *ctx)
{
    double *const outputs[] = {g_v, g_q};
    if (g) *g = 0.0;
    for (int k = 0; k < 2; k++)
        if (outputs[k]) memset(outputs[k], 0, N * sizeof(double));
    return 0;
}

static void test_deformed(const dal_system *system)
{
    double fields[2][6];
    dal_system *const deformed = open_deformed(system, no_change, NULL, 0.5, DAL_AFFINE, 0);
    CHECK(dal_system_inputs(deformed) == INPUTS
          && strcmp(dal_system_input_name(deformed, 2), "wind") == 0);
    for (int i = 0; i < 2; i++) {
        dal_mechanics *const mechanics = open_mechanics(i ? deformed : system);
        CHECK(dal_mechanics_input(mechanics, table) == 0
              && dal_field(mechanics, 0.0, start, fields[i]) == 0);
        release(mechanics);
    }
    CHECK_NEAR(largest_difference(6, fields[0], fields[1]), 0.0, 16 * U);
}

/* A derivative of the force is wrong only with inputs. */
static void test_check(void)
{
    const double errors[2] = {0.0, 1e-3};
    for (int i = 0; i < 2; i++) {
        dal_system *const system = open_cart(&errors[i]);
        dal_check report;
        CHECK(dal_system_check(system, 0.0, start, &report, NULL) == DAL_SUCCESS);
        CHECK(report.passed == !i && (!i || strstr(report.finding.text, "f_q[0,2]") != NULL));
        release(system);
    }
}

/* ---- failures ------------------------------------------------------------------------------ */

static void test_failures(const dal_system *system)
{
    const double bad[INPUTS] = {0.0, 1.0, INFINITY};
    double inputs[STEPS * INPUTS], row[12], before[6];
    dal_stepper *const stepper = start_at(system, "midpoint", 0.0, 0.05, start);
    CHECK(dal_stepper_input(NULL, table) == DAL_EINVAL);
    CHECK(dal_stepper_input(stepper, NULL) == DAL_EINVAL
          && strcmp(dal_stepper_error(stepper)->text, "u is NULL") == 0);
    CHECK(dal_stepper_input(stepper, table) == 0 && dal_stepper_input(stepper, bad) == DAL_EINVAL
          && strcmp(dal_stepper_error(stepper)->text, "u[2] = inf is not finite") == 0);
    /* the bad ones changed nothing */
    dal_stepper *const other = start_at(system, "midpoint", 0.0, 0.05, start);
    CHECK(dal_stepper_input(other, table) == 0 && dal_step(other, NULL) == 0
          && dal_step(stepper, NULL) == 0);
    CHECK(memcmp(dal_stepper_state(stepper), dal_stepper_state(other), sizeof start) == 0);

    memcpy(before, dal_stepper_state(stepper), sizeof before);
    controller self = {.hold = 1};
    dal_run run = {.stepper = stepper, .steps = STEPS, .stride = STEPS, .x = row,
                   .control = control, .control_ctx = &self};
    CHECK(dal_run_go(&run, 1) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(stepper)->text, "control is not NULL, but inputs is") != NULL);
    for (size_t k = 0; k < STEPS * INPUTS; k++) inputs[k] = k == 3 * INPUTS ? (double)NAN : 0.5;
    run = (dal_run){.stepper = stepper, .steps = STEPS, .stride = STEPS, .inputs = inputs};
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_EINVAL && run.done == 3);
    CHECK(strcmp(dal_stepper_error(stepper)->text,
                 "the inputs of step 5 (t = 0.2): u[0] = nan is not finite") == 0);

    static const int answers[] = {2, -3, 0};
    static const int statuses[] = {DAL_STOPPED, DAL_EUSER, DAL_EINVAL};
    for (int i = 0; i < 3; i++) {
        dal_stepper *const asked = start_at(system, "midpoint", 0.0, 0.05, start);
        self = (controller){.hold = 1, .answer = answers[i], .silent = i == 2,
                            .moved = 4 * U};
        run = (dal_run){.stepper = asked, .steps = STEPS, .stride = STEPS, .inputs = inputs,
                        .control = control, .control_ctx = &self};
        CHECK(dal_run_go(&run, SIZE_MAX) == statuses[i]);
        CHECK(run.done == (i == 2 ? 0 : 4));
        if (i == 1)
            CHECK(strcmp(dal_stepper_error(asked)->text, "control returned -3 at step 4") == 0);
        release(asked);
    }

    dal_system *const none = open_system("knife_edge");
    dal_stepper *const without = open_stepper(none, &(dal_scheme){.beta = 0.5}, NULL);
    run = (dal_run){.stepper = without, .steps = 1, .stride = 1, .inputs = inputs};
    CHECK(dal_run_go(&run, 1) == DAL_EINVAL
          && strstr(dal_stepper_error(without)->text, "but the system has no inputs") != NULL);
    CHECK(dal_stepper_input(without, NULL) == DAL_SUCCESS); /* none are none */
    CHECK(dal_system_inputs(none) == 0 && dal_system_input_name(none, 0) == NULL);
}

static void test_definition(const dal_system *system)
{
    dal_error error = {0};
    dal_system *other = NULL;
    dal_system_def def = {.n = N, .m = 0, .mass = mass, .inputs = 2};
    CHECK(dal_system_new(&other, &def, &error) == DAL_EINVAL
          && strcmp(error.text, "inputs = 2, but force and driven are NULL: expected one of "
                    "them, or inputs = 0") == 0);
    def.force = motors;
    other = new_system(&def);
    CHECK(strcmp(dal_system_input_name(other, 1), "u1") == 0);
    CHECK(dal_system_inputs(system) == INPUTS && dal_system_input_name(system, INPUTS) == NULL);
    CHECK(strcmp(dal_system_input_name(system, 0), "push") == 0);
}

/* ---- inputs in constraints ------------------------------------------------------------------ */

/* x' = u in a field of strength 3, beside y, on which nothing acts; m = 1, so lambda = 3. */
static int ramp(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    (void)t, (void)ctx;
    if (V) *V = 3.0 * q[0];
    if (V_q) V_q[0] = 3.0, V_q[1] = 0.0;
    if (V_qq) memset(V_qq, 0, 4 * sizeof *V_qq);
    return 0;
}

static int conveyor(double t, const double *q, const double *v, const double *u, double *phi,
                    double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    (void)t, (void)q, (void)ctx, (void)phi_t;
    if (phi) phi[0] = v[0] - u[0];
    if (phi_v) phi_v[0] = 1.0, phi_v[1] = 0.0;
    if (phi_q) phi_q[0] = phi_q[1] = 0.0;
    return 0;
}

/* The input is 1 more than before; the run has the first. */
static int climb(size_t step, double t, const double *x, double *u, void *ctx)
{
    (void)t, (void)ctx;
    u[0] = x[2] + 1.0;
    return step == 0 ? -1 : 0;
}

static void test_driven(void)
{
    static const double ones[2] = {1.0, 1.0}, rest[4] = {0.0, 0.0, 0.0, 1.0};
    dal_error error = {0};
    dal_system *system = NULL, *bent = NULL;
    dal_system_def def = {.n = 2, .m = 1, .masses = ones, .potential = ramp, .driven = conveyor,
                          .kind = DAL_AFFINE};
    CHECK(dal_system_new(&system, &def, &error) == DAL_EINVAL
          && strcmp(error.text, "driven is not NULL, but inputs = 0: expected at least one "
                                "input") == 0);
    def.inputs = 1;
    def.constraint = plane_blade;
    CHECK(dal_system_new(&system, &def, &error) == DAL_EINVAL
          && strstr(error.text, "constraint and driven are both given") != NULL);
    def.constraint = NULL;
    def.m = 0;
    def.kind = DAL_LINEAR;
    CHECK(dal_system_new(&system, &def, &error) == DAL_EINVAL
          && strcmp(error.text, "m = 0, but driven is not NULL") == 0);
    def.m = 1;
    def.kind = DAL_AFFINE;
    system = new_system(&def);
    CHECK(dal_system_is_driven(system) == 1 && dal_system_is_forced(system) == 0);
    CHECK(dal_system_deform_nodes(&bent, system, 0.1, &error) == DAL_EUNSUPPORTED);
    dal_stepper *stepper = NULL;
    const dal_scheme kept = find_scheme("midpoint-nodes"), record = find_scheme("leapfrog");
    CHECK(dal_stepper_new(&stepper, system, &kept, NULL, &error) == DAL_EUNSUPPORTED
          && strstr(error.text, "choose a scheme with moved nodes") != NULL);

    /* the jump belongs to the step, whose impulse has it; until then the state is as it was */
    stepper = open_stepper(system, &record, NULL);
    double reaction, *const saved = malloc(dal_stepper_saved(stepper) * sizeof *saved);
    const double *const x = dal_stepper_state(stepper);
    CHECK(dal_stepper_start(stepper, 0.0, 0.5, rest, DAL_CHECK, DAL_INITIAL_NONE) == DAL_SUCCESS);
    CHECK(dal_stepper_input(stepper, (double[]){9.0}) == DAL_SUCCESS);
    CHECK(dal_stepper_input(stepper, (double[]){2.0}) == DAL_SUCCESS && x[2] == 0.0);
    CHECK(dal_stepper_save(stepper, saved) == DAL_SUCCESS);
    for (int i = 0; i < 2; i++) {
        CHECK(dal_step(stepper, &reaction) == DAL_SUCCESS);
        CHECK(x[0] == 1.0 && x[1] == 0.5 && x[2] == 2.0 && x[3] == 1.0);
        CHECK(fabs(reaction - (3.0 + 2.0 / 0.5)) < 1e-14);
        CHECK(dal_step(stepper, &reaction) == DAL_SUCCESS && fabs(reaction - 3.0) < 1e-14);
        CHECK(dal_stepper_restore(stepper, saved, dal_stepper_saved(stepper)) == DAL_SUCCESS);
    }
    CHECK(dal_stepper_start(stepper, 0.0, 0.5, rest, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EOFFD);

    double inputs[3], rows[16], reactions[3];
    dal_run run = {.stepper = stepper, .steps = 3, .stride = 1, .x = rows, .inputs = inputs,
                   .reactions = reactions, .control = climb, .rows_set = 1};
    CHECK(dal_stepper_start(stepper, 0.0, 0.5, (double[]){0.0, 0.0, 2.0, 1.0}, DAL_CHECK,
                            DAL_INITIAL_NONE) == DAL_SUCCESS);
    CHECK(dal_run_go(&run, SIZE_MAX) == DAL_SUCCESS);
    CHECK(inputs[0] == 2.0 && inputs[1] == 3.0 && inputs[2] == 4.0);
    CHECK(rows[4] == 1.0 && rows[8] == 2.5 && rows[12] == 4.5 && rows[14] == 4.0);
    CHECK(fabs(reactions[0] - 3.0) < 1e-14 && fabs(reactions[1] - 5.0) < 1e-14);
    free(saved);
}

int main(void)
{
    dal_system *const system = open_cart(NULL);
    test_orders(system);
    test_ways(system);
    test_geometry(system);
    test_own_maps(system);
    test_deformed(system);
    test_check();
    test_failures(system);
    test_definition(system);
    test_driven();
    return check_done();
}
