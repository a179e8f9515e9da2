/* The family pair: its steps are those of dal_discrete_advance, for any two maps; with twice the
 * same map those of the beta-scheme. */
#include "fixtures.h"
#include "check.h"

enum { MOST_2N = 16, MOST_M = 4, STEPS = 50 };

static const double h = 0.02, t0 = 0.7;

static const char *const names[] = {"particle",      "generic4",      "disk",      "genmass",
                                    "rolling_disc",  "ball_on_table", "snakeboard", "pushed"};

/* At rest but for the time: what it pushes with has to be asked for at the right one. */
static int push(double t, const double *q, const double *v, const double *u, double *f, double *f_q,
                double *f_v, void *ctx)
{
    (void)v, (void)ctx;
    if (f) {
        f[0] = 3.0 * sin(5.0 * t);
        f[1] = cos(q[0] + t);
        f[2] = 0.5 * t;
    }
    if (f_q) {
        memset(f_q, 0, 9 * sizeof *f_q);
        f_q[3] = -sin(q[0] + t);
    }
    if (f_v) memset(f_v, 0, 9 * sizeof *f_v);
    return 0;
}

static dal_system *open(const char *name)
{
    if (strcmp(name, "pushed") != 0) return open_system(name);
    dal_system *const edge = open_system("uneven_edge");
    dal_system_def def = edge->def;
    def.force = push;
    return new_system(&def);
}

static void start(dal_stepper *stepper, const dal_system *system, double step)
{
    double x[MOST_2N];
    need(dal_system_state(system, x), "state", "");
    need(dal_stepper_start(stepper, t0, step, x, DAL_CHECK, DAL_INITIAL_NONE), "start",
         dal_stepper_error(stepper)->text);
}

/* rho = (q0 + q1)/2 + b, b quadratic in q1 - q0, and rho^1/2 beside it: a map of the user's own. */
static int bent(double step, const double *q0, const double *q1, double *g, double *f, double *g_0,
                double *g_1, double *f_0, double *f_1, void *ctx)
{
    const size_t n = *(const size_t *)ctx;
    (void)g_0, (void)g_1, (void)f_0, (void)f_1; /* differenced */
    for (size_t i = 0; i < n; i++) {
        const double d = q1[i] - q0[i];
        g[i] = 0.5 * (q0[i] + q1[i]) + 0.1 * d * d;
        f[i] = d / step;
    }
    return 0;
}

/* Each step is that of dal_discrete_advance from the same state, with its lambda. */
static void check_steps(const char *name, const dal_scheme *scheme, const dal_pair *maps,
                        double step, double roundings)
{
    dal_system *const system = open(name);
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    dal_stepper *const stepper = open_stepper(system, scheme, NULL);
    double x[MOST_2N], reaction[MOST_M], lambda[MOST_M], sum[MOST_M] = {0.0}, worst = 0.0;
    dal_discrete *const discrete = open_discrete(system, maps->lagrangian, &maps->constraint);
    start(stepper, system, step);
    for (size_t k = 0; k < STEPS; k++) {
        memcpy(x, dal_stepper_state(stepper), 2 * n * sizeof *x);
        const int status = dal_step(stepper, reaction);
        check_true(status == 0, dal_stepper_error(stepper)->text, name, __LINE__);
        check_true(dal_discrete_advance(discrete, t0 + (double)k * step, step, x, lambda) == 0,
                   dal_discrete_error(discrete)->text, name, __LINE__);
        const double *const y = dal_stepper_state(stepper), extent = sum_of_sizes(2 * n, x);
        check_near(largest_difference(2 * n, x, y), 0.0, roundings * U * extent, name,
                   scheme->name, (int)k);
        check_near(largest_difference(m, lambda, reaction), 0.0,
                   4 * roundings * U * extent / fabs(step), name, "reaction", (int)k);
        const double residual = residual_of(system, 0.0, y);
        CHECK(residual <= DAL_RESIDUAL_BOUND(n));
        worst = fmax(worst, residual);
        for (size_t a = 0; a < m; a++) sum[a] += reaction[a];
    }
    CHECK(dal_stepper_time(stepper) == t0 + STEPS * step);
    const dal_stats stats = stats_of(stepper);
    /* that of the fixtures adds up in another order */
    CHECK(stats.worst_residual >= 0.5 * worst && stats.worst_residual <= DAL_RESIDUAL_BOUND(n));
    CHECK(stats.steps == STEPS && stats.substeps == STEPS);

    memcpy(x, dal_stepper_state(stepper), 2 * n * sizeof *x);
    start(stepper, system, step);
    CHECK(dal_advance(stepper, STEPS, reaction, NULL) == 0);
    CHECK(memcmp(x, dal_stepper_state(stepper), 2 * n * sizeof *x) == 0);
    for (size_t a = 0; a < m; a++)
        CHECK_NEAR(reaction[a], sum[a] / STEPS, 4 * STEPS * U * (1.0 + fabs(reaction[a])));
}

static void test_steps(void)
{
    static const char *const pairs[] = {"pair:0.25:0.5", "pair:0.5:0.25", "pair:0:1", "pair:1:0",
                                        "pair:0.5:0.5", "pair:0.75:0.75"};
    static const double betas[][2] = {{0.25, 0.5}, {0.5, 0.25}, {0.0, 1.0},
                                      {1.0, 0.0},  {0.5, 0.5},  {0.75, 0.75}};
    for (size_t s = 0; s < DAL_LENGTH(names); s++)
        for (size_t j = 0; j < DAL_LENGTH(pairs); j += brief() ? 4 : 1) {
            const dal_scheme scheme = find_scheme(pairs[j]);
            const dal_pair maps = {{.beta = betas[j][0]}, {.beta = betas[j][1]}};
            /* two ways to the same equations, each solved to 64 u for nodes, q/h away from v */
            check_steps(names[s], &scheme, &maps, h, 1024);
            check_steps(names[s], &scheme, &maps, -h, 1024);
        }
}

/* Maps of the user's own, as the data of a record of the user's own: to the bit. */
static void test_own_maps(void)
{
    for (size_t s = 0; s < DAL_LENGTH(names); s++) {
        dal_system *const system = open(names[s]);
        size_t n = dal_system_n(system);
        const dal_pair maps = {{.map = bent, .differenced = 1, .beta = 0.5, .ctx = &n},
                               {.beta = 0.5}};
        const dal_pair swapped = {maps.constraint, maps.lagrangian};
        dal_scheme scheme = {.name = "bent", .data = &maps};
        scheme.family = find_scheme("pair:0:0").family;
        if (!brief()) check_steps(names[s], &scheme, &maps, h, 0);
        scheme.data = &swapped;
        check_steps(names[s], &scheme, &swapped, h, 0);
        release(system);
    }
}

/* Twice the same map: the beta-scheme. */
static void test_beta(void)
{
    static const char *const betas[] = {"0", "0.25", "0.5", "1"};
    static const char *const pairs[] = {"pair:0:0", "pair:0.25:0.25", "pair:0.5:0.5", "pair:1:1"};
    for (size_t s = 0; s < DAL_LENGTH(names); s++)
        for (size_t j = 0; j < DAL_LENGTH(pairs); j++) {
            dal_system *const system = open(names[s]);
            const size_t N = 2 * dal_system_n(system), m = dal_system_m(system);
            dal_stepper *const one = open_named(system, betas[j]);
            dal_stepper *const two = open_named(system, pairs[j]);
            double first[MOST_M], second[MOST_M];
            start(one, system, h);
            start(two, system, h);
            CHECK(dal_advance(one, STEPS, first, NULL) == 0);
            CHECK(dal_advance(two, STEPS, second, NULL) == 0);
            const double *const x = dal_stepper_state(one), *const y = dal_stepper_state(two);
            const double error = 64 * U * STEPS * sum_of_sizes(N, x);
            check_near(largest_difference(N, x, y), 0.0, error, names[s], pairs[j], __LINE__);
            CHECK_NEAR(largest_difference(m, first, second), 0.0, error / h);
            release(system);
        }
}

/* The orders that the records promise. */
static void test_orders(void)
{
    static const size_t steps[] = {16, 32, 64, 128, 256};
    static const char *const pairs[] = {"pair:0.25:0.75", "pair:0.5:0.75", "pair:0.5:0.5"};
    dal_system *const system = open_system("generic4");
    double x[8];
    CHECK(dal_system_state(system, x) == 0);
    for (size_t j = 0; j < DAL_LENGTH(pairs); j++) {
        const dal_scheme scheme = find_scheme(pairs[j]);
        const dal_order_def def = {.t_end = 0.5, .x0 = x, .steps = steps,
                                   .count = DAL_LENGTH(steps)};
        dal_order_point points[DAL_LENGTH(steps)];
        dal_order order;
        need(dal_order_study(system, &scheme, &def, points, &order, NULL), pairs[j], "");
        CHECK_NEAR(order.p, scheme.order, 0.2);
        check_true(order.holds == 1 && order.keeps_D == 1, order.text, pairs[j], __LINE__);
    }
}

static void refused(dal_scheme scheme, const char *words)
{
    dal_system *const system = open_system("particle");
    dal_stepper *stepper = NULL;
    dal_error error;
    CHECK(dal_stepper_new(&stepper, system, &scheme, NULL, &error) == DAL_EINVAL && !stepper);
    check_true(strstr(error.text, words) != NULL, error.text, words, __LINE__);
}

static void test_records(void)
{
    const dal_pair maps = {{.beta = 0.75}, {.beta = 0.0}}, wrong = {{.beta = 0.5}, {.beta = 1.5}};
    dal_scheme scheme = find_scheme("pair:0.25:0.5"); /* its data holds, not its name */
    scheme.data = &maps;
    check_steps("particle", &scheme, &maps, h, 1024);
    snprintf(scheme.name, sizeof scheme.name, "my own");
    check_steps("generic4", &scheme, &maps, h, 1024);
    scheme.data = &wrong;
    refused(scheme, "1.5");
    scheme.data = NULL;
    refused(scheme, "\"my own\": expected pair:A:B");
    scheme = find_scheme("pair:0.25:0.5");
    scheme.nodes = DAL_KEPT_NODES;
    refused(scheme, "no sub-steps for the family pair");
    scheme.nodes = DAL_MOVED_NODES;
    scheme.count = 2;
    refused(scheme, "scheme.count = 2");
}

int main(void)
{
    test_steps();
    test_own_maps();
    test_beta();
    test_orders();
    test_records();
    return check_done();
}
