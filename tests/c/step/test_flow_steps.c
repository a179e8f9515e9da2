/* The family flow: steps of the flow of the ODE on D. */
#include "fixtures.h"
#include "check.h"

enum { MOST_2N = 16, MOST_M = 4, STEPS = 100 };

static const dal_flow_method methods[] = {DAL_FLOW_RK8PD, DAL_FLOW_MSADAMS, DAL_FLOW_RODAS};

static dal_scheme reference(const dal_flow_scheme *data)
{
    dal_scheme scheme = find_scheme("reference");
    scheme.data = data;
    return scheme;
}

static void start(dal_stepper *stepper, const dal_system *system, double t0, double h)
{
    double x[MOST_2N];
    need(dal_system_state(system, x), "state", "");
    need(dal_stepper_start(stepper, t0, h, x, DAL_CHECK, DAL_INITIAL_NONE), "start",
         dal_stepper_error(stepper)->text);
}

/* Against the exact solution, forwards and backwards: as accurate as the tolerance says, in D after
 * every step, and the statistics know. */
static void test_exact(void)
{
    static const char *const names[] = {"particle", "disk", "knife_edge"};
    for (size_t s = 0; s < DAL_LENGTH(names); s++)
        for (size_t j = 0; j < DAL_LENGTH(methods); j++)
            for (int sign = -1; sign <= 1; sign += 2) {
                const dal_flow_scheme data = {methods[j], 1e-9};
                const dal_scheme scheme = reference(&data);
                const double h = 0.02 * sign;
                dal_system *const system = open_system(names[s]);
                const size_t n = dal_system_n(system), N = 2 * n;
                dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
                double x0[MOST_2N], exact[MOST_2N], worst = 0.0;
                start(stepper, system, 0.0, h);
                memcpy(x0, dal_stepper_state(stepper), N * sizeof *x0);
                for (size_t k = 1; k <= STEPS; k++) {
                    double reaction[MOST_M] = {7.0, 7.0, 7.0, 7.0};
                    CHECK(dal_step(stepper, reaction) == 0);
                    for (size_t a = 0; a < MOST_M; a++)
                        CHECK(a < dal_system_m(system) ? isnan(reaction[a]) : reaction[a] == 7.0);
                    const double *const x = dal_stepper_state(stepper);
                    CHECK(dal_system_exact(system, (double)k * h, x0, exact) == 0);
                    /* errors of 1e-9 of the state in each inner step, of which some are in one */
                    check_near(largest_difference(N, x, exact), 0.0,
                               1e-8 * (double)k * (1.0 + sum_of_sizes(N, exact)), names[s], "exact",
                               (int)j);
                    CHECK(residual_of(system, 0.0, x) <= DAL_RESIDUAL_BOUND(n));
                    worst = fmax(worst, residual_of(system, 0.0, x));
                }
                const dal_stats stats = stats_of(stepper);
                CHECK(stats.steps == STEPS && stats.substeps == STEPS);
                CHECK(stats.evaluations >= STEPS && stats.iterations == 0);
                CHECK(stats.worst_residual >= 0.5 * worst); /* added up in another order */
                CHECK(stats.worst_residual <= DAL_RESIDUAL_BOUND(n));
                release(system);
            }
}

/* A tolerance is worth its evaluations; 0 is 1e-13, to the bit, and so is no data. */
static void test_tolerance(void)
{
    static const dal_flow_scheme data[] = {{DAL_FLOW_RK8PD, 1e-5}, {DAL_FLOW_RK8PD, 1e-9},
                                           {DAL_FLOW_RK8PD, 1e-13}, {DAL_FLOW_RK8PD, 0.0}};
    enum { COUNT = DAL_LENGTH(data) + 1 };
    dal_system *const system = open_system("generic4");
    double x[COUNT][MOST_2N];
    size_t evaluations[COUNT];
    for (size_t j = 0; j < COUNT; j++) {
        const dal_scheme scheme = reference(j + 1 < COUNT ? &data[j] : NULL);
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        start(stepper, system, 0.0, 2.0);
        CHECK(dal_advance(stepper, 10, NULL, NULL) == 0);
        memcpy(x[j], dal_stepper_state(stepper), 8 * sizeof(double));
        const dal_stats stats = stats_of(stepper);
        evaluations[j] = stats.evaluations;
        release(stepper);
    }
    CHECK(evaluations[0] < evaluations[1] && evaluations[1] < evaluations[2]);
    CHECK(largest_difference(8, x[0], x[2]) > largest_difference(8, x[1], x[2]));
    CHECK(memcmp(x[2], x[3], 8 * sizeof(double)) == 0 && evaluations[2] == evaluations[3]);
    CHECK(memcmp(x[2], x[4], 8 * sizeof(double)) == 0 && evaluations[2] == evaluations[4]);
}

/* f = (0, 0, 1/t): the force is asked for at the time of the stepper, which is t0 + k h. */
static int harmonic(double t, const double *q, const double *v, const double *u, double *f,
                    double *f_q, double *f_v, void *ctx)
{
    (void)q, (void)v, (void)ctx;
    if (f) f[0] = f[1] = 0.0, f[2] = 1.0 / t;
    if (f_q) memset(f_q, 0, 9 * sizeof *f_q);
    if (f_v) memset(f_v, 0, 9 * sizeof *f_v);
    return 0;
}

static void test_time(void)
{
    dal_system *const edge = open_system("uneven_edge");
    dal_system_def def = edge->def;
    def.force = harmonic;
    def.potential = NULL;
    dal_system *const system = new_system(&def);
    for (size_t j = 0; j < DAL_LENGTH(methods); j++) {
        const dal_flow_scheme data = {methods[j], 1e-9};
        const dal_scheme scheme = reference(&data);
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        start(stepper, system, 1.0, 0.25);
        const double omega = dal_stepper_state(stepper)[5];
        for (size_t k = 1; k <= 12; k++) { /* M_33 = 3/4: omega grows by 4/3 ln t */
            CHECK(dal_step(stepper, NULL) == 0 && dal_stepper_time(stepper) == 1.0 + 0.25 * k);
            CHECK_NEAR(dal_stepper_state(stepper)[5], omega + 4.0 / 3.0 * log(1.0 + 0.25 * k),
                       1e-7);
        }
        release(stepper);
    }
}

/* Many steps in one call or each by itself, and after a start that forgets: the same bits and
 * counts, of multistep methods too. */
static void test_calls(void)
{
    dal_system *const system = open_system("generic4");
    for (size_t j = 0; j < DAL_LENGTH(methods); j++) {
        const dal_flow_scheme data = {methods[j], 1e-8};
        const dal_scheme scheme = reference(&data);
        dal_stepper *const one = open_stepper(system, &scheme, NULL);
        dal_stepper *const two = open_stepper(system, &scheme, NULL);
        dal_stats first, second;
        start(two, system, 3.0, -0.7);
        CHECK(dal_advance(two, 3, NULL, NULL) == 0);
        start(one, system, 0.0, 0.05);
        start(two, system, 0.0, 0.05);
        dal_stepper_stats(two, &second);
        CHECK(second.evaluations == 0 && second.steps == 0);
        CHECK(dal_advance(one, STEPS, NULL, NULL) == 0);
        for (size_t k = 0; k < STEPS; k++) CHECK(dal_step(two, NULL) == 0);
        CHECK(memcmp(dal_stepper_state(one), dal_stepper_state(two), 8 * sizeof(double)) == 0);
        dal_stepper_stats(one, &first);
        dal_stepper_stats(two, &second);
        CHECK(first.evaluations == second.evaluations);
        CHECK(first.worst_residual == second.worst_residual);
        release(two);
    }
}

/* uneven_edge up to the wall at ctx. */
static int walled(double t, const double *q, const double *v, double *phi, double *phi_v,
                  double *phi_q, double *phi_t, void *ctx)
{
    if (q[0] > *(const double *)ctx) return 1;
    return uneven_constraint(t, q, v, phi, phi_v, phi_q, phi_t, NULL);
}

/* A step that fails says so, and has changed nothing: where the cause is removed it is made as if
 * it had not failed. */
static void test_failure(void)
{
    for (size_t j = 0; j < DAL_LENGTH(methods); j++) {
        const dal_flow_scheme data = {methods[j], 1e-9};
        const dal_scheme scheme = reference(&data);
        dal_system *const edge = open_system("uneven_edge");
        dal_system_def def = edge->def;
        double wall = HUGE_VAL, before[6], mean = 7.0;
        def.constraint = walled;
        def.ctx = &wall;
        dal_system *const system = new_system(&def);
        dal_stepper *const one = open_stepper(system, &scheme, NULL);
        dal_stepper *const two = open_stepper(system, &scheme, NULL);
        start(one, system, 0.0, 0.1);
        start(two, system, 0.0, 0.1);
        size_t done = 99;
        CHECK(dal_advance(two, STEPS, NULL, NULL) == 0);
        wall = 0.3;
        CHECK(dal_advance(one, STEPS, &mean, &done) == DAL_EDOMAIN && done > 1 && done < STEPS);
        CHECK(mean == 7.0 && dal_stepper_time(one) == (double)done * 0.1);
        char words[32];
        snprintf(words, sizeof words, "step %zu (", done + 1);
        CHECK(strstr(dal_stepper_error(one)->text, words) == dal_stepper_error(one)->text);
        CHECK(strstr(dal_stepper_error(one)->text, "constraint returned 1") != NULL);
        memcpy(before, dal_stepper_state(one), sizeof before);
        CHECK(dal_step(one, NULL) == DAL_EDOMAIN);
        CHECK(memcmp(before, dal_stepper_state(one), sizeof before) == 0);
        wall = HUGE_VAL;
        CHECK(dal_advance(one, STEPS - done, NULL, NULL) == 0);
        if (methods[j] == DAL_FLOW_MSADAMS) /* begins anew, 1e-9 in each of its inner steps */
            CHECK_NEAR(largest_difference(6, dal_stepper_state(one), dal_stepper_state(two)), 0.0,
                       1e-5 * sum_of_sizes(6, dal_stepper_state(two)));
        else CHECK(memcmp(dal_stepper_state(one), dal_stepper_state(two), sizeof before) == 0);
        release(edge);
    }
}

/* However short the steps are, the edge of a domain is reached after so many halvings as a double
 * has bits, and not after so many steps as it has numbers. */
static void test_edge(void)
{
    for (size_t j = 0; j < DAL_LENGTH(methods); j++) {
        const dal_flow_scheme data = {methods[j], 1e-9};
        const dal_scheme scheme = reference(&data);
        dal_system *const edge = open_system("uneven_edge");
        dal_system_def def = edge->def;
        double wall = 0.01;
        def.constraint = walled;
        def.ctx = &wall;
        dal_system *const system = new_system(&def);
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        start(stepper, system, 0.0, 1e-4);
        CHECK(dal_advance(stepper, 100000, NULL, NULL) == DAL_EDOMAIN);
        const dal_error *const error = dal_stepper_error(stepper);
        CHECK(strstr(error->text, "constraint returned 1") != NULL);
        CHECK(fabs(dal_stepper_state(stepper)[0] - wall) < 1e-3);
        const dal_stats stats = stats_of(stepper);
        CHECK(stats.evaluations < 40 * stats.steps + 20000);
        release(edge);
    }
}

static void refused(const dal_scheme *scheme, const char *words)
{
    dal_system *const system = open_system("particle");
    dal_stepper *stepper = NULL;
    dal_error error;
    CHECK(dal_stepper_new(&stepper, system, scheme, NULL, &error) == DAL_EINVAL && !stepper);
    check_true(strstr(error.text, words) != NULL, error.text, words, __LINE__);
}

static void test_records(void)
{
    const dal_flow_scheme unknown = {(dal_flow_method)7, 1e-9}, loose = {DAL_FLOW_RODAS, 0.5};
    dal_scheme scheme = reference(&unknown);
    refused(&scheme, "method = 7");
    scheme.data = &loose;
    refused(&scheme, "0.5");
    scheme.data = NULL;
    scheme.nodes = DAL_KEPT_NODES;
    refused(&scheme, "no sub-steps for the family flow");
    scheme.nodes = DAL_MOVED_NODES;
    scheme.count = 1;
    refused(&scheme, "scheme.count = 1");
}

int main(void)
{
    test_exact();
    test_tolerance();
    test_time();
    test_calls();
    test_failure();
    test_edge();
    test_records();
    return check_done();
}
