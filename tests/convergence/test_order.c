/* Orders, measured: every named scheme on many systems by the study that the library offers.
 *
 * A promise is a lower bound of the slope, 0.2 below the order.  Equality is asserted where theory
 * says that an order is lost: there the slope has to stay 0.2 below the next order as well. */
#include "check.h"
#include "dalembert/study.h"
#include "generic4.h"

#include <string.h>

enum { MOST_POINTS = 12, MOST = 12 };

static const double SLACK = 0.2;

static const char *const systems[] = {"particle", "particle_oscillator", "knife_edge", "sleigh",
                                      "heisenberg", "contact_oscillator", "generic4"};
enum { SYSTEMS = sizeof systems / sizeof systems[0] };

/* A study and all that has to be freed or printed afterwards. */
typedef struct measurement {
    const char *system_name;
    char scheme_name[64];
    dal_order_point points[MOST_POINTS];
    size_t count;
    dal_order order;
    bool printed;
} measurement;

static dal_system *open_system(const char *name, double *x)
{
    dal_system *system = NULL;
    dal_error error = {0};
    const int status = strcmp(name, "generic4") == 0
                           ? generic4_new(&system, &error)
                           : dal_system_builtin(&system, name, NULL, NULL, 0, &error);
    check_true(status == 0, error.text, name, __LINE__);
    CHECK(dal_system_state(system, x) == 0);
    return system;
}

static dal_scheme find_scheme(const char *name)
{
    dal_scheme scheme = {0};
    dal_error error = {0};
    check_true(dal_scheme_find(&scheme, name, &error) == 0, error.text, name, __LINE__);
    return scheme;
}

/* A study from the system's own initial data.  The contact oscillator's are at rest, where D_eps
 * and D meet; kept nodes start from others. */
static measurement measure(const char *system_name, const dal_scheme *scheme, dal_initial initial,
                           double t_end, size_t count, const size_t *steps)
{
    const double moving[6] = {1.2, 0.5, -0.7, 0.4, 1.0, -0.8};
    double x0[MOST];
    dal_error error = {0};
    measurement result = {.system_name = system_name, .count = count};
    dal_system *system = open_system(system_name, x0);
    if (initial != DAL_INITIAL_NONE && strcmp(system_name, "contact_oscillator") == 0)
        memcpy(x0, moving, sizeof moving);
    const dal_order_def def = {.t_end = t_end, .x0 = x0, .steps = steps, .count = count,
                               .initial = initial, .tolerance = 1e-14};
    snprintf(result.scheme_name, sizeof result.scheme_name, "%s%s", scheme->name,
             initial == DAL_INITIAL_NONE ? "" : initial == DAL_INITIAL_D ? " from D"
             : initial == DAL_INITIAL_D_EPS ? " from D_eps"
             : initial == DAL_INITIAL_PROJECT ? " projected" : " shifted");
    const int status = dal_order_study(system, scheme, &def, result.points, &result.order, &error);
    check_true(status == 0, error.text, system_name, __LINE__);
    dal_system_free(system);
    return result;
}

/* ---- the table, when something is wrong ---------------------------------------------------- */

static double local_order(const dal_order_point *a, const dal_order_point *b, double error_a,
                          double error_b)
{
    return log(error_a / error_b) / log(a->h / b->h);
}

#define COLUMN(member)                                            \
    fprintf(stderr, " %10.3e %5.2f", p->member,                   \
            k ? local_order(p - 1, p, p[-1].member, p->member) : NAN)

static void print_table(measurement *result)
{
    if (result->printed) return;
    result->printed = true;
    const dal_order *const o = &result->order;
    fprintf(stderr, "\n%s on %s: errors and local orders\n%10s %16s %16s %16s %16s %16s %16s %16s "
            "%10s %10s\n", result->scheme_name, result->system_name, "h", "q", "v", "multipliers",
            "step: state", "multipliers", "reaction", "midpoint", "D", "D_eps");
    for (size_t k = 0; k < result->count; k++) {
        const dal_order_point *const p = &result->points[k];
        fprintf(stderr, "%10.4g", p->h);
        COLUMN(q);
        COLUMN(v);
        COLUMN(multipliers);
        COLUMN(local_state);
        COLUMN(local_multipliers);
        COLUMN(local_reaction);
        COLUMN(local_midpoint);
        fprintf(stderr, " %10.3e %10.3e%s\n", p->residual, p->residual_eps,
                p->failed ? dal_strerror(p->failed) : "");
    }
    fprintf(stderr, "fitted slopes %.3f %.3f %.3f %.3f %.3f %.3f %.3f; floor %.1e\n%s\n",
            o->global_q.slope, o->global_v.slope, o->global_multipliers.slope, o->state.slope,
            o->multipliers.slope, o->reaction.slope, o->midpoint.slope, o->floor, o->text);
}

/* ---- expectations -------------------------------------------------------------------------- */

static void expect(measurement *result, bool met, const char *what, double expected,
                   const dal_fit *fit)
{
    check_record(met);
    if (met) return;
    print_table(result);
    fprintf(stderr, "FAILED: %s on %s: slope of %s: expected %.1f, measured %.3f from %zu points%s"
            "\n", result->scheme_name, result->system_name, what, expected, fit->slope,
            fit->points, fit->exact ? " (exact)" : "");
}

static void expect_at_least(measurement *result, const dal_fit *fit, double expected,
                            const char *what)
{
    expect(result, fit->exact || fit->slope >= expected - SLACK, what, expected, fit);
}

static void expect_equal(measurement *result, const dal_fit *fit, double expected,
                         const char *what)
{
    expect(result, fabs(fit->slope - expected) <= SLACK, what, expected, fit);
}

static void expect_flag(measurement *result, bool met, const char *what)
{
    check_record(met);
    if (met) return;
    print_table(result);
    fprintf(stderr, "FAILED: %s on %s: %s\n", result->scheme_name, result->system_name, what);
}

/* What a record of order p promises: in one step, at t_end, and for the set that it keeps.  With
 * p >= 6 the error of one step reaches roundoff before its slope has settled: there it has to be
 * clear of p, the slope of a method of order p - 1. */
static void expect_order(measurement *result, int p)
{
    const dal_order *const o = &result->order;
    expect_at_least(result, &o->state, p >= 6 ? p + 2 * SLACK : p + 1, "the state after a step");
    expect_at_least(result, &o->reaction, 1, "the reaction at the end of a step");
    expect_at_least(result, &o->global_state, p, "the state at t_end");
    expect_at_least(result, &o->global_multipliers, p, "lambda(q, v) at t_end");
    if (p < 6) expect_at_least(result, &o->multipliers, p + 1, "lambda(q, v) after a step");
    expect_flag(result, o->keeps_D, "D is not kept");
    expect_flag(result, o->holds == 1, o->text);
}

/* ---- the orders of the records ------------------------------------------------------------- */

/* Numbers of steps are not all dyadic.  Coarse ones show high orders, whose errors are at roundoff
 * soon; fine ones the order of the reaction. */
static const struct order_case {
    const char *scheme;
    int p;
    bool symmetric;
    double t_end;
    size_t count, steps[MOST_POINTS];
} order_cases[] = {
    {"explicit", 1, false, 1.0, 6, {40, 60, 80, 100, 120, 160}},
    {"endpoint", 1, false, 1.0, 6, {40, 60, 80, 100, 120, 160}},
    {"midpoint", 2, true, 1.0, 6, {20, 30, 40, 50, 60, 80}},
    {"leapfrog", 2, true, 1.0, 6, {20, 30, 40, 50, 60, 80}},
    {"leapfrog-mirror", 2, true, 1.0, 6, {20, 30, 40, 50, 60, 80}},
    {"midpoint-yoshida4", 4, true, 1.0, 9, {12, 16, 20, 25, 32, 50, 100, 200, 400}},
    {"leapfrog-yoshida4", 4, true, 1.0, 9, {12, 16, 20, 25, 32, 50, 100, 200, 400}},
    {"midpoint-suzuki4", 4, true, 1.0, 9, {8, 10, 12, 16, 20, 30, 100, 200, 400}},
    {"leapfrog-suzuki4", 4, true, 1.0, 9, {8, 10, 12, 16, 20, 30, 100, 200, 400}},
    {"bm4", 4, true, 1.0, 9, {10, 12, 16, 20, 25, 32, 100, 200, 400}},
    {"bm6", 6, true, 3.0, 11, {4, 5, 6, 8, 10, 12, 14, 16, 100, 200, 400}},
    {"midpoint-kl6", 6, true, 2.0, 11, {4, 5, 6, 8, 10, 12, 16, 20, 100, 200, 400}},
    {"leapfrog-kl6", 6, true, 2.0, 11, {4, 5, 6, 8, 10, 12, 16, 20, 100, 200, 400}},
    {"midpoint-kl8", 8, true, 2.0, 12, {3, 4, 5, 6, 7, 8, 10, 12, 14, 100, 200, 400}},
    {"leapfrog-kl8", 8, true, 2.0, 12, {3, 4, 5, 6, 7, 8, 10, 12, 14, 100, 200, 400}},
};

static void test_orders(void)
{
    for (size_t c = 0; c < sizeof order_cases / sizeof order_cases[0]; c++) {
        const struct order_case *const k = &order_cases[c];
        const dal_scheme scheme = find_scheme(k->scheme);
        CHECK(scheme.order == k->p);
        for (size_t i = 0; i < SYSTEMS; i++) {
            /* The errors on the sleigh are so small that its steps have to be longer. */
            const double t_end = k->t_end * (strcmp(systems[i], "sleigh") == 0 ? 1.5 : 1.0);
            measurement result = measure(systems[i], &scheme, DAL_INITIAL_NONE, t_end, k->count,
                                         k->steps);
            expect_order(&result, k->p);
            if (k->p == 1)
                expect_equal(&result, &result.order.global_state, 1, "the state at t_end");
        }
    }
}

/* The verdict on every named scheme where the mass depends on q, where the constraints are affine,
 * and on more than four coordinates.  An interval suits the motion: errors of order 6 have to stand
 * clear of roundoff.  Those of order 8, of no other, may reach it before they are a power of h. */
static void test_general_systems(void)
{
    static const struct {
        const char *name;
        double t_end;
    } general[] = {{"sleigh_contact", 2.0}, {"genmass", 1.0},      {"snakeboard", 4.0},
                   {"ball_on_table", 4.0},  {"rolling_disc", 1.0}, {"n_trailer", 1.0}};
    static const size_t steps[] = {5, 6, 8, 10, 12, 16, 20, 40, 200, 300, 400, 600};
    static const size_t fine[] = {200, 300, 400, 600, 800, 1200};
    for (size_t c = 0; c < sizeof order_cases / sizeof order_cases[0]; c++) {
        const dal_scheme scheme = find_scheme(order_cases[c].scheme);
        for (size_t i = 0; i < sizeof general / sizeof general[0]; i++) {
            const bool low = scheme.order <= 2;
            measurement result = measure(general[i].name, &scheme, DAL_INITIAL_NONE,
                                         general[i].t_end, low ? 6 : 12, low ? fine : steps);
            const bool open = scheme.order == 8 && result.order.holds == -3;
            expect_flag(&result, result.order.holds == 1 || open, result.order.text);
            expect_flag(&result, result.order.keeps_D, "D is not kept");
            if (low)
                expect_equal(&result, &result.order.global_state, scheme.order,
                             "the state at t_end");
        }
    }
}

/* Order 10 shows between h so large that errors are no power of it yet, and roundoff, where steps
 * that are all finer stand. */
static void test_order_ten(void)
{
    static const size_t coarse[] = {4, 5, 6, 7, 8, 9}, fine[] = {40, 60, 80, 100, 120, 160};
    const char *const names[] = {"leapfrog-ss10", "midpoint-ss10"};
    for (size_t i = 0; i < 2; i++) {
        const dal_scheme scheme = find_scheme(names[i]);
        measurement result = measure("knife_edge", &scheme, DAL_INITIAL_NONE, 6.0, 6, coarse);
        expect_at_least(&result, &result.order.global_state, 10, "the state at t_end");
        expect_flag(&result, result.order.keeps_D && result.order.holds != 0, result.order.text);
        result = measure("knife_edge", &scheme, DAL_INITIAL_NONE, 2.0, 6, fine);
        expect_flag(&result, result.order.keeps_D && result.order.holds == 1, result.order.text);
        expect_flag(&result, strstr(result.order.text, "Exact to roundoff") != NULL, "exact");
    }
}

/* (pdisc): the multiplier of a symmetric record belongs to the middle of its step, to order 2. */
static void test_midpoint_reactions(void)
{
    static const size_t steps[] = {100, 150, 200, 250, 300, 400};
    for (size_t c = 0; c < sizeof order_cases / sizeof order_cases[0]; c++) {
        if (!order_cases[c].symmetric) continue;
        const dal_scheme scheme = find_scheme(order_cases[c].scheme);
        for (size_t i = 0; i < SYSTEMS; i++) {
            measurement result = measure(systems[i], &scheme, DAL_INITIAL_NONE, 1.0, 6, steps);
            expect_at_least(&result, &result.order.midpoint, 2, "the reaction in the middle");
        }
    }
}

/* ---- where an order is lost ---------------------------------------------------------------- */

static const size_t plain_steps[] = {40, 60, 80, 100, 120, 160};
enum { PLAIN = sizeof plain_steps / sizeof plain_steps[0] };

/* Kept nodes: the states are the nodes, which lie (1 - beta) h ahead of their time label, so the
 * order is 1 however the run starts.  A step from D_eps has (1, 0).  The first step from D has
 * (0, -1), E12, but on Heisenberg's system, where D_eps is D for beta = 1/2, and for beta = 1,
 * where it is D for every system. */
static void test_kept_nodes(const char *name, bool jumps)
{
    static const dal_initial starts[] = {DAL_INITIAL_D, DAL_INITIAL_D_EPS, DAL_INITIAL_PROJECT,
                                         DAL_INITIAL_SHIFT};
    const dal_scheme scheme = find_scheme(name);
    for (size_t i = 0; i < SYSTEMS; i++)
        for (size_t k = 0; k < sizeof starts / sizeof starts[0]; k++) {
            measurement result = measure(systems[i], &scheme, starts[k], 1.0, PLAIN, plain_steps);
            const dal_order *const o = &result.order;
            const bool heisenberg = strcmp(systems[i], "heisenberg") == 0;
            expect_equal(&result, &result.order.global_state, 1, "the state at t_end");
            if (starts[k] == DAL_INITIAL_D && jumps && !heisenberg) {
                expect_equal(&result, &o->state, 1, "the state after the first step from D");
                expect_equal(&result, &o->reaction, 0, "the reaction of the first step from D");
                expect_flag(&result, fabs(o->p) <= SLACK && fabs(o->s + 1) <= SLACK, "(0, -1)");
            } else {
                expect_at_least(&result, &o->state, 2, "the state after a step");
                expect_at_least(&result, &o->reaction, 1, "the reaction at the end of a step");
            }
            expect_flag(&result, o->keeps_D_eps, "D_eps is not kept");
            if (jumps && !heisenberg) expect_flag(&result, !o->keeps_D, "D is kept");
            expect_flag(&result, o->holds == 1, o->text);
        }
}

/* Two records of the same four sub-steps: 0, 1 in turn is symmetric and has order 2, twice 0 and
 * then twice 1 is not and has order 1.  Neither promises anything. */
static void test_own_records(void)
{
    const dal_substep in_turn[4] = {{0, 0.25}, {1, 0.25}, {0, 0.25}, {1, 0.25}};
    const dal_substep explicit_only[2] = {{0, 0.5}, {0, 0.5}};
    const dal_scheme alternating = {.name = "0 1 0 1", .count = 4, .substeps = in_turn};
    const dal_scheme one_sided = {.name = "0 0", .count = 2, .substeps = explicit_only};
    const dal_scheme quarter = {.name = "beta = 1/4", .beta = 0.25};
    for (size_t i = 0; i < SYSTEMS; i++) {
        measurement second = measure(systems[i], &alternating, DAL_INITIAL_NONE, 1.0, PLAIN,
                                     plain_steps);
        measurement first = measure(systems[i], &one_sided, DAL_INITIAL_NONE, 1.0, PLAIN,
                                    plain_steps);
        measurement between = measure(systems[i], &quarter, DAL_INITIAL_NONE, 1.0, PLAIN,
                                      plain_steps);
        expect_at_least(&second, &second.order.state, 3, "the state after a step");
        expect_at_least(&second, &second.order.global_state, 2, "the state at t_end");
        expect_equal(&first, &first.order.global_state, 1, "the state at t_end");
        expect_equal(&between, &between.order.global_state, 1, "the state at t_end");
        expect_flag(&second, second.order.holds == -1 && second.order.keeps_D, second.order.text);
        expect_flag(&first, isnan(first.points[0].residual_eps), "D_eps of several sub-steps");
        if (strcmp(systems[i], "heisenberg") != 0) /* where D_eps is D */
            expect_flag(&between, between.points[0].residual_eps > 1e-4, "D_eps is kept");
    }
}

/* A record that promises too much does not hold, in p as in s. */
static void test_false_promises(void)
{
    dal_scheme liar = find_scheme("explicit");
    liar.order = 2;
    measurement result = measure("generic4", &liar, DAL_INITIAL_NONE, 1.0, PLAIN, plain_steps);
    expect_flag(&result, result.order.holds == 0, result.order.text);
    liar = find_scheme("midpoint");
    liar.multiplier_order = 1;
    result = measure("generic4", &liar, DAL_INITIAL_NONE, 1.0, PLAIN, plain_steps);
    expect_flag(&result, result.order.holds == 0, result.order.text);
    CHECK(strstr(result.order.text, "Does not hold.") != NULL);
    /* From D both have to hold, the first step and the slope at t_end.  On Heisenberg's system
     * D_eps is D, and the step loses no order; the slope is 1 and not 2. */
    liar = find_scheme("midpoint-nodes");
    liar.order = 2;
    liar.multiplier_order = 0;
    result = measure("heisenberg", &liar, DAL_INITIAL_D, 1.0, PLAIN, plain_steps);
    expect_flag(&result, result.order.state.slope > 2 - SLACK, "the step reaches (1, -1)");
    expect_flag(&result, result.order.holds == 0, result.order.text);
    const dal_scheme honest = find_scheme("midpoint");
    result = measure("generic4", &honest, DAL_INITIAL_NONE, 1.0, 2, plain_steps);
    expect_flag(&result, result.order.holds == -2, result.order.text); /* two points say nothing */
}

/* Over a long interval the roundoff of the fine steps grows, and must not be taken for errors. */
static void test_long_intervals(void)
{
    static const size_t steps[] = {30, 45, 60, 90, 120, 180, 2400, 4800, 9600, 19200};
    const char *const names[] = {"leapfrog-kl8", "midpoint-kl8"};
    for (size_t i = 0; i < 2; i++) {
        const dal_scheme scheme = find_scheme(names[i]);
        measurement result = measure("particle", &scheme, DAL_INITIAL_NONE, 30.0,
                                     sizeof steps / sizeof steps[0], steps);
        expect_flag(&result, result.order.holds == 1, result.order.text);
        expect_at_least(&result, &result.order.global_q, 7.5, "q at t_end");
        /* Three one-step errors whose slope has not settled, and no three at t_end. */
        static const size_t coarse[] = {60, 90, 120, 180, 240, 360};
        result = measure("particle", &scheme, DAL_INITIAL_NONE, 30.0, 6, coarse);
        expect_flag(&result, result.order.state.slope < 9 - SLACK, "the slope has settled");
        expect_flag(&result, isnan(result.order.global_q.slope), "three points count at t_end");
        expect_flag(&result, result.order.holds == -3, result.order.text);
    }
}

/* Where roundoff hides the order the verdict says so, whether three errors stand clear of it or
 * none; not where steps are few, or where it is the reference that hides it.  What else is promised
 * may be broken, and a lower order than promised is not hidden as long as its slopes are seen. */
static void test_hidden_orders(void)
{
    static const size_t steps[] = {1, 2, 3, 4, 5, 6, 8, 10, 12, 80, 160, 320};
    enum { COUNT = sizeof steps / sizeof *steps, FEW = 4 };
    dal_scheme scheme = find_scheme("leapfrog-ss10");
    measurement result = measure("particle_oscillator", &scheme, DAL_INITIAL_NONE, 1.0, COUNT,
                                 steps);
    expect_flag(&result, result.order.holds == -3, result.order.text);
    expect_flag(&result, strstr(result.order.text, "Not measurable in double, because the order")
                != NULL, "in words");
    scheme.multiplier_order = 1;
    result = measure("particle_oscillator", &scheme, DAL_INITIAL_NONE, 1.0, COUNT, steps);
    expect_flag(&result, result.order.holds == 0, "s = 0 is seen");
    scheme.multiplier_order = 0;
    result = measure("particle_oscillator", &scheme, DAL_INITIAL_NONE, 1.0, FEW, steps);
    expect_flag(&result, result.order.holds == -2, "finer steps tell more");

    scheme = find_scheme("leapfrog-kl8");
    result = measure("disk", &scheme, DAL_INITIAL_NONE, 1.0, COUNT, steps);
    expect_flag(&result, result.order.holds == -3, result.order.text);
    expect_flag(&result, strstr(result.order.text, "fewer than three errors") != NULL, "in words");

    const char *const names[] = {"leapfrog-kl8", "leapfrog-suzuki4", "bm6"};
    static const size_t fine[] = {4, 5, 6, 7, 8, 10, 80, 160, 320};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        scheme = find_scheme(names[i]);
        scheme.order = 10;
        result = measure("knife_edge", &scheme, DAL_INITIAL_NONE, 2.0, 9, fine);
        expect_flag(&result, result.order.holds == 0, result.order.text);
    }
    /* slopes at t_end of 13, 11 and 9: their mean is no order */
    static const size_t coarse[] = {32, 40, 48, 64, 1280, 2560};
    scheme = find_scheme("leapfrog-kl8");
    scheme.order = 10;
    result = measure("contact_oscillator", &scheme, DAL_INITIAL_NONE, 16.0, 6, coarse);
    expect_flag(&result, result.order.global_state.slope > 10.0, "the mean is beyond 10");
    expect_flag(&result, result.order.holds == 0, result.order.text);
}

static double error_of(const dal_order_point *point, dal_order_fit which)
{
    switch (which) {
    case DAL_FIT_STATE: return point->local_state;
    case DAL_FIT_MULTIPLIERS: return point->local_multipliers;
    case DAL_FIT_REACTION: return point->local_reaction;
    case DAL_FIT_MIDPOINT: return point->local_midpoint;
    case DAL_FIT_GLOBAL_Q: return point->q;
    case DAL_FIT_GLOBAL_V: return point->v;
    case DAL_FIT_GLOBAL_MULTIPLIERS: return point->multipliers;
    case DAL_FIT_GLOBAL_STATE: return fmax(point->q, point->v);
    }
    return NAN;
}

/* Each fit is the least squares line through the points that are marked as counted, and these are
 * as many as it says: whoever shows the fit need not find out again what it rests on.  The roundoff
 * of the runs of many steps does not count. */
static void test_counted(void)
{
    static const size_t steps[] = {50, 100, 200, 400, 800, 1600, 3200, 6400, 12800};
    enum { COUNT = sizeof steps / sizeof *steps, FITS = DAL_FIT_GLOBAL_STATE + 1 };
    const dal_scheme scheme = find_scheme("leapfrog-suzuki4");
    const double x0[6] = {0.0, 1.0, 0.0, 1.0, 1.0, 1.0};
    double unused[6];
    dal_order_point points[COUNT];
    dal_order order;
    dal_system *system = open_system("particle", unused);
    const dal_order_def def = {.t_end = 2.0, .x0 = x0, .steps = steps, .count = COUNT};
    CHECK(dal_order_study(system, &scheme, &def, points, &order, NULL) == 0);
    const dal_fit *const fits[FITS] = {
        &order.state, &order.multipliers, &order.reaction, &order.midpoint, &order.global_q,
        &order.global_v, &order.global_multipliers, &order.global_state};
    for (int which = 0; which < FITS; which++) {
        double n = 0.0, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0;
        for (size_t i = 0; i < COUNT; i++) {
            if (!(points[i].counted & 1u << which)) continue;
            const double log_h = log(points[i].h);
            const double log_error = log(error_of(&points[i], (dal_order_fit)which));
            n++;
            x += log_h;
            y += log_error;
            xx += log_h * log_h;
            xy += log_h * log_error;
        }
        CHECK(n == (double)fits[which]->points);
        if (n < 3.0) CHECK(isnan(fits[which]->slope));
        else CHECK_NEAR(fits[which]->slope, (n * xy - x * y) / (n * xx - x * x), 1e-9);
    }
    CHECK_NEAR(order.global_state.slope, 4.0, 0.01);
    CHECK(order.global_state.points == 3);
    CHECK(!(points[8].counted & 1u << DAL_FIT_GLOBAL_STATE));
    CHECK(order.reaction.points == 4 && !(points[4].counted & 1u << DAL_FIT_REACTION));
    CHECK(strncmp(order.text, "Holds. Order (p, s)", 19) == 0);
    CHECK(strstr(order.text, "order 4.00 at t_end; D kept to") != NULL);
    CHECK(order.keeps_D && !order.keeps_D_eps); /* there is none for several sub-steps */
    /* in any order of the steps, also with the median first */
    const size_t shuffled[COUNT] = {1600, 50, 100, 200, 400, 800, 3200, 6400, 12800};
    const dal_order_def again = {.t_end = 2.0, .x0 = x0, .steps = shuffled, .count = COUNT};
    dal_order other;
    CHECK(dal_order_study(system, &scheme, &again, points, &other, NULL) == 0);
    CHECK(other.reaction.points == 4);
    CHECK_NEAR(other.reaction.slope, order.reaction.slope, 1e-9);
    dal_system_free(system);
}

typedef struct watcher {
    size_t calls;
    double last;
    int answer; /* at the second call */
} watcher;

static int watch(double made, void *ctx)
{
    watcher *const self = ctx;
    CHECK(made >= self->last);
    self->last = made;
    return ++self->calls < 2 ? 0 : self->answer;
}

/* Off D a flow stands in for the exact solution, and no error is known better than it is. */
static void test_flow_that_stands_in(void)
{
    double x0[MOST];
    dal_order_point points[PLAIN];
    dal_order order;
    const dal_scheme kept = find_scheme("midpoint-nodes");
    dal_system *system = open_system("particle", x0);
    const dal_order_def def = {.t_end = 1.0, .x0 = x0, .steps = plain_steps, .count = PLAIN,
                               .initial = DAL_INITIAL_D_EPS, .tolerance = 1e-7};
    CHECK(dal_order_study(system, &kept, &def, points, &order, NULL) == 0);
    CHECK(order.reference == 0.0 && order.floor == 1e-7);
    dal_system_free(system);
}

/* A watch ends a study in its runs and in its reference, at once; nothing is written. */
static void test_watch(void)
{
    static const size_t long_run[] = {4000000000u}, short_run[] = {10};
    static const struct {
        const char *system;
        double t_end;
        const size_t *steps;
    } cases[] = {{"particle", 1.0, long_run}, {"generic4", 1e6, short_run}};
    const dal_scheme scheme = find_scheme("leapfrog");
    for (size_t c = 0; c < 2; c++)
        for (int answer = -1; answer <= 1; answer += 2) {
            double x0[MOST];
            dal_order_point point = {.h = 7.0}, before = point;
            dal_order order = {.p = 7.0};
            dal_error error;
            watcher seen = {.answer = answer};
            dal_system *system = open_system(cases[c].system, x0);
            const dal_order_def def = {.t_end = cases[c].t_end, .x0 = x0, .steps = cases[c].steps,
                                       .count = 1, .watch = watch, .watch_ctx = &seen};
            const int expected = answer > 0 ? DAL_STOPPED : DAL_EUSER;
            CHECK(dal_order_study(system, &scheme, &def, &point, &order, &error) == expected);
            CHECK(error.status == expected && error.text[0] != '\0');
            CHECK(seen.calls == 2 && (seen.last > 0.0) == (c == 0));
            CHECK(memcmp(&point, &before, sizeof point) == 0);
            CHECK(order.p == 7.0);
            dal_system_free(system);
        }
}

/* Without constraints there is no D to speak of; a text counts its points. */
static void test_unconstrained(void)
{
    static const size_t steps[] = {40};
    static const double mass[] = {1.0}, x0[] = {0.4, 0.9};
    const dal_system_def free_body = {.n = 1, .mass = mass};
    const dal_scheme midpoint = find_scheme("midpoint");
    const dal_order_def def = {.t_end = 1.0, .x0 = x0, .steps = steps, .count = 1};
    dal_order_point point;
    dal_order order;
    dal_system *system = NULL;
    CHECK(dal_system_new(&system, &free_body, NULL) == 0);
    CHECK(dal_order_study(system, &midpoint, &def, &point, &order, NULL) == 0);
    CHECK(strstr(order.text, "kept to") == NULL);
    CHECK(strstr(order.text, "Exact to roundoff.") != NULL);
    dal_system_free(system);
    const measurement single = measure("generic4", &midpoint, DAL_INITIAL_NONE, 1.0, 1, steps);
    CHECK(strstr(single.order.text, "over 1 point,") != NULL);
    CHECK(strstr(single.order.text, "; D kept to ") != NULL);
}

/* ---- numbers that are known ---------------------------------------------------------------- */

/* midpoint on the disk: v and the heading are exact, and lambda depends on nothing else. */
static void test_disk(void)
{
    const dal_scheme midpoint = find_scheme("midpoint");
    measurement result = measure("disk", &midpoint, DAL_INITIAL_NONE, 1.0, PLAIN, plain_steps);
    expect_flag(&result, result.order.multipliers.exact, "lambda(q, v) after a step is exact");
    expect_flag(&result, result.order.global_multipliers.exact, "lambda(q, v) at t_end is exact");
    expect_flag(&result, result.order.global_v.exact, "v at t_end is exact");
    expect_at_least(&result, &result.order.global_q, 2, "q at t_end");
    expect_equal(&result, &result.order.midpoint, 2, "the reaction in the middle");
    expect_flag(&result, result.order.holds == 1, result.order.text);
}

/* One step of the particle in closed form (spec of the beta-schemes on D):
 *   y' = y + h b, y_q = y + (1-beta) h b, s_q = 1 + y' y_q, lambda = a b / s_q,
 *   a' = a (1 + y y_q) / s_q, c' = y' a', x' = x + h ((1-beta) a + beta a'), z' likewise;
 * and the exact solution: a(t) sqrt(1+y(t)^2) is constant, lambda(t) = a(t) b / (1+y(t)^2). */
static void test_particle_step(const char *name, double beta)
{
    static const size_t steps[] = {7};
    const dal_scheme scheme = find_scheme(name);
    const double h = 1.0 / 7.0, y = 0.3, a = 1.0, b = 0.7;
    const double y1 = y + h * b, ym = y + 0.5 * h * b, yq = y + (1 - beta) * h * b;
    const double reaction = a * b / (1 + y1 * yq);
    const double a1 = a * (1 + y * yq) / (1 + y1 * yq);
    const double constant = a * sqrt(1 + y * y);
    const double exact_a1 = constant / sqrt(1 + y1 * y1);
    const double dx = h * ((1 - beta) * a + beta * a1) - constant / b * (asinh(y1) - asinh(y));
    const double dz = h * ((1 - beta) * y * a + beta * y1 * a1) -
                      constant / b * (sqrt(1 + y1 * y1) - sqrt(1 + y * y));
    const double da = a1 - exact_a1, dc = y1 * da;
    const double state = fmax(fmax(fabs(dx), fabs(dz)), fmax(fabs(da), fabs(dc)));
    const double at_end = exact_a1 * b / (1 + y1 * y1);
    const double in_middle = constant * b / pow(1 + ym * ym, 1.5);

    const measurement result = measure("particle", &scheme, DAL_INITIAL_NONE, 1.0, 1, steps);
    const dal_order_point *const p = &result.points[0];
    const double roundoff = 64 * 1.1e-16; /* of numbers about 1; reactions are divided by h */
    CHECK(p->steps == 7);
    CHECK_NEAR(p->h, h, roundoff);
    CHECK_NEAR(p->local_state, state, roundoff);
    CHECK_NEAR(p->local_multipliers, fabs(a1 * b / (1 + y1 * y1) - at_end), roundoff);
    CHECK_NEAR(p->local_reaction, fabs(reaction - at_end), roundoff / h);
    CHECK_NEAR(p->local_midpoint, fabs(reaction - in_middle), roundoff / h);
}

/* What a run shows: a loop written by hand sees the same end, energy and residuals. */
static void test_run(void)
{
    static const size_t steps[] = {600}; /* more than one block */
    const dal_scheme scheme = find_scheme("explicit");
    const measurement result = measure("generic4", &scheme, DAL_INITIAL_NONE, 3.0, 1, steps);
    const dal_order_point *const p = &result.points[0];

    double x[8], energy0, energy, residual, worst = 0.0, drift = 0.0;
    dal_system *system = open_system("generic4", x);
    dal_mechanics *mechanics = NULL;
    dal_stepper *stepper = NULL;
    dal_flow *flow = NULL;
    CHECK(dal_mechanics_new(&mechanics, system, NULL) == 0);
    CHECK(dal_stepper_new(&stepper, system, &scheme, NULL, NULL) == 0);
    CHECK(dal_flow_new(&flow, system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-14, NULL) == 0);
    CHECK(dal_stepper_start(stepper, 0.0, 3.0 / 600, x, DAL_PROJECT, DAL_INITIAL_NONE) == 0);
    CHECK(dal_energy(mechanics, 0.0, dal_stepper_state(stepper), &energy0) == 0);
    for (size_t k = 0; k < 600; k++) {
        CHECK(dal_step(stepper, NULL) == 0);
        CHECK(dal_energy(mechanics, 0.0, dal_stepper_state(stepper), &energy) == 0);
        CHECK(dal_relative_residual(mechanics, 0.0, 3.0 / 600, dal_stepper_state(stepper),
                                    &residual) == 0);
        drift = fmax(drift, fabs(energy - energy0) / fmax(fabs(energy0), 1.0));
        worst = fmax(worst, residual);
    }
    CHECK(dal_flow_apply(flow, 0.0, 3.0, x, NULL) == 0);
    double q = 0.0, v = 0.0;
    for (size_t i = 0; i < 4; i++) {
        q = fmax(q, fabs(dal_stepper_state(stepper)[i] - x[i]));
        v = fmax(v, fabs(dal_stepper_state(stepper)[4 + i] - x[4 + i]));
    }
    const double roundoff = 1e-12; /* 600 steps of a few u each, growing with the flow */
    CHECK_NEAR(p->q, q, roundoff);
    CHECK_NEAR(p->v, v, roundoff);
    CHECK_NEAR(p->energy, drift, roundoff);
    CHECK_NEAR(p->residual_eps, worst, roundoff);
    CHECK(p->residual <= 4 * 4 * 1.2e-16);
    dal_flow_free(flow);
    dal_stepper_free(stepper);
    dal_mechanics_free(mechanics);
    dal_system_free(system);
}

/* Backwards the orders are the same. */
static void test_backwards(void)
{
    const dal_scheme scheme = find_scheme("leapfrog");
    measurement result = measure("generic4", &scheme, DAL_INITIAL_NONE, -1.0, PLAIN, plain_steps);
    expect_order(&result, 2);
    expect_flag(&result, result.points[0].h == -1.0 / 40, "h is negative");
}

/* ---- fits ---------------------------------------------------------------------------------- */

static void test_fit(void)
{
    const double h[6] = {0.1, -0.05, 0.03, 0.02, 0.01, 0.005};
    double errors[6];
    dal_fit fit;
    for (size_t i = 0; i < 6; i++) errors[i] = 7.0 * pow(fabs(h[i]), 2.5);
    unsigned char counted[6];
    dal_fit_order(6, h, errors, 1e-12, &fit, counted);
    CHECK_NEAR(fit.slope, 2.5, 1e-13);
    CHECK(fit.points == 6 && !fit.exact && memcmp(counted, "\1\1\1\1\1\1", 6) == 0);

    errors[4] = 5e-9; /* below the floor, or not a number: they do not count */
    errors[5] = NAN;
    dal_fit_order(6, h, errors, 1e-10, &fit, counted);
    CHECK_NEAR(fit.slope, 2.5, 1e-13);
    CHECK(fit.points == 4 && memcmp(counted, "\1\1\1\1\0\0", 6) == 0);
    dal_fit_order(2, h, errors, 1e-12, &fit, NULL); /* two points */
    CHECK(isnan(fit.slope) && fit.points == 2 && !fit.exact);
    const double close[3] = {0.1, 0.08, 0.06}; /* a factor of less than two in h */
    dal_fit_order(3, close, errors, 1e-12, &fit, NULL);
    CHECK(isnan(fit.slope) && fit.points == 3);
    const double noise[6] = {1e-16, 0.0, 2e-16, 1e-16, 0.0, 1e-16};
    dal_fit_order(6, h, noise, 1e-15, &fit, NULL);
    CHECK(isnan(fit.slope) && fit.points == 0 && fit.exact);
    const double nothing[2] = {NAN, NAN};
    dal_fit_order(2, h, nothing, 1e-15, &fit, NULL);
    CHECK(!fit.exact && fit.points == 0);
    const double scattered[3] = {1.0, 2.0, 8.0}; /* least squares by hand: 1.5 log 2 / log 2 */
    const double doubled[3] = {1.0, 2.0, 4.0};
    dal_fit_order(3, doubled, scattered, 0.0, &fit, NULL);
    CHECK_NEAR(fit.slope, 1.5, 1e-14);
    CHECK_NEAR(fit.spread, 1.0, 1e-14); /* slopes 1 and 2 */
    CHECK_NEAR(fit.finest, 1.0, 1e-14);
    const double mixed[4] = {0.3, 1.0, 0.05, 0.4}, bent[4] = {0.3, 9.0, 0.01, 0.9};
    dal_fit_order(4, mixed, bent, 1e-6, &fit, NULL); /* whatever their order */
    CHECK_NEAR(fit.spread, log(3.0) / log(4.0 / 3.0) - log(30.0) / log(6.0), 1e-13);
    CHECK_NEAR(fit.finest, log(30.0) / log(6.0), 1e-13);
}

/* ---- what can go wrong --------------------------------------------------------------------- */

/* The particle with beta = 1, y = -1, h v_y = 2 is singular: a failed point, not a failed study. */
static void test_failed_points(void)
{
    static const size_t steps[] = {1, 100, 150, 200, 300};
    const double x0[6] = {0.0, -1.0, 0.0, 1.0, 2.0, -1.0};
    double unused[6];
    dal_order_point points[5];
    dal_order order;
    dal_error error = {0};
    const dal_scheme endpoint = find_scheme("endpoint");
    dal_system *system = open_system("particle", unused);
    const dal_order_def def = {.t_end = 1.0, .x0 = x0, .steps = steps, .count = 5};
    CHECK(dal_order_study(system, &endpoint, &def, points, &order, &error) == 0);
    CHECK(points[0].failed == DAL_ESINGULAR);
    CHECK(isnan(points[0].q) && isnan(points[0].local_state) && points[0].h == 1.0);
    CHECK(points[1].failed == 0 && points[1].q > 0.0);
    CHECK(strstr(order.text, "1 of 5 runs failed") != NULL);
    CHECK(order.holds == 1 && order.state.points == 4 && error.text[0] == '\0');
    CHECK(order.keeps_D); /* in all runs that there are, also where the failed one is the last */
    static const size_t failing_last[] = {100, 150, 200, 300, 1};
    const dal_order_def last = {.t_end = 1.0, .x0 = x0, .steps = failing_last, .count = 5};
    CHECK(dal_order_study(system, &endpoint, &last, points, &order, &error) == 0);
    CHECK(points[4].failed == DAL_ESINGULAR && order.keeps_D && order.holds == 1);
    const dal_order_def alone = {.t_end = 1.0, .x0 = x0, .steps = steps, .count = 1};
    CHECK(dal_order_study(system, &endpoint, &alone, points, &order, &error) == 0);
    CHECK(!order.keeps_D && !order.keeps_D_eps); /* by no run */
    dal_system_free(system);
}

static int stopped_constraint(double t, const double *q, const double *v, double *phi,
                              double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    size_t *const calls = ctx;
    return ++*calls > 500 ? -1 : generic4_constraint(t, q, v, phi, phi_v, phi_q, NULL, NULL);
}

static void test_arguments(void)
{
    double x0[8], off[8];
    dal_order_point points[2];
    dal_order order;
    dal_error error;
    static const size_t steps[] = {10, 20}, none[] = {10, 0};
    dal_system *system = open_system("generic4", x0);
    const dal_scheme midpoint = find_scheme("midpoint"), kept = find_scheme("midpoint-nodes");
    const dal_order_def good = {.t_end = 1.0, .x0 = x0, .steps = steps, .count = 2};
    CHECK(dal_order_study(system, &midpoint, &good, points, &order, &error) == 0);
    const dal_order before = order;

#define REFUSED(scheme, status, word, ...)                                                        \
    do {                                                                                          \
        dal_order_def bad = good;                                                                 \
        __VA_ARGS__;                                                                              \
        CHECK(dal_order_study(system, scheme, &bad, points, &order, &error) == status);           \
        CHECK(strstr(error.text, word) != NULL);                                                  \
        CHECK(memcmp(&order, &before, sizeof order) == 0);                                        \
    } while (0)
    REFUSED(&midpoint, DAL_EINVAL, "t_end = nan", bad.t_end = NAN);
    REFUSED(&midpoint, DAL_EINVAL, "t_end = 0", bad.t_end = 0.0);
    REFUSED(&midpoint, DAL_EINVAL, "an interval of finite length", bad.t_end = 0.0);
    REFUSED(&midpoint, DAL_EINVAL, "x0 is NULL", bad.x0 = NULL);
    REFUSED(&midpoint, DAL_EINVAL, "count = 0", bad.count = 0);
    REFUSED(&midpoint, DAL_EINVAL, "steps[1] = 0", bad.steps = none);
    REFUSED(&midpoint, DAL_EINVAL, "tolerance = 1", bad.tolerance = 1.0);
    REFUSED(&midpoint, DAL_EINVAL, "initial = 4", bad.initial = DAL_INITIAL_SHIFT);
    REFUSED(&kept, DAL_EINVAL, "initial = 0", bad.initial = DAL_INITIAL_NONE);
    REFUSED(NULL, DAL_EINVAL, "scheme is NULL", (void)bad);
    memcpy(off, x0, sizeof off);
    off[5] += 0.01;
    REFUSED(&midpoint, DAL_EOFFD, "violates the constraint", bad.x0 = off);
    off[5] = INFINITY;
    REFUSED(&midpoint, DAL_EINVAL, "x0[5] = inf", bad.x0 = off);
    dal_system_free(system);

    /* A callback that says stop is obeyed. */
    size_t calls = 0;
    const dal_system_def def = {.n = 4, .m = 2, .mass = generic4_mass,
                                .potential = generic4_potential,
                                .constraint = stopped_constraint, .ctx = &calls};
    CHECK(dal_system_new(&system, &def, &error) == 0);
    CHECK(dal_order_study(system, &midpoint, &good, points, &order, &error) == DAL_EUSER);
    CHECK(calls == 501);
    dal_system_free(system);
#undef REFUSED
}

int main(void)
{
    test_orders();
    test_general_systems();
    test_order_ten();
    test_midpoint_reactions();
    test_kept_nodes("explicit-nodes", true);
    test_kept_nodes("midpoint-nodes", true);
    test_kept_nodes("endpoint-nodes", false);
    test_own_records();
    test_false_promises();
    test_long_intervals();
    test_hidden_orders();
    test_counted();
    test_flow_that_stands_in();
    test_watch();
    test_unconstrained();
    test_disk();
    test_particle_step("explicit", 0.0);
    test_particle_step("midpoint", 0.5);
    test_particle_step("endpoint", 1.0);
    test_run();
    test_backwards();
    test_fit();
    test_failed_points();
    test_arguments();
    return check_done();
}
