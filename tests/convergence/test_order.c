/* Orders, measured: every named scheme on seven systems by the study that the library offers.
 *
 * A promise is a lower bound of the slope, 0.2 below the order.  Equality is asserted where theory
 * says that an order is lost: there the slope has to stay 0.2 below the next order as well. */
#include "../c/check.h"
#include "../generic4.h"

#include <string.h>

enum { MOST_POINTS = 12, MOST = 8 };

static const double SLACK = 0.2;

static const char *const systems[] = {"particle", "particle_oscillator", "knife_edge", "sleigh",
                                      "heisenberg", "contact_oscillator", "generic4"};
enum { SYSTEMS = sizeof systems / sizeof systems[0] };

/* A study and all that has to be freed or printed afterwards. */
typedef struct measurement {
    const char *system_name;
    char scheme_name[48];
    dal_order_point points[MOST_POINTS];
    size_t count;
    dal_order order;
    dal_fit run; /* of the larger error of q and v at t_end */
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

static void fit_run(measurement *result)
{
    double h[MOST_POINTS], errors[MOST_POINTS];
    for (size_t k = 0; k < result->count; k++) {
        h[k] = result->points[k].h;
        errors[k] = fmax(result->points[k].q, result->points[k].v);
    }
    dal_fit_order(result->count, h, errors, result->order.floor, &result->run);
}

static measurement measure(const char *system_name, const dal_scheme *scheme, dal_initial initial,
                           double t_end, size_t count, const size_t *steps)
{
    double x0[MOST];
    dal_error error = {0};
    measurement result = {.system_name = system_name, .count = count};
    dal_system *system = open_system(system_name, x0);
    const dal_order_def def = {.t_end = t_end, .x0 = x0, .steps = steps, .count = count,
                               .initial = initial, .tolerance = 1e-14};
    snprintf(result.scheme_name, sizeof result.scheme_name, "%s%s", scheme->name,
             initial == DAL_INITIAL_NONE ? "" : initial == DAL_INITIAL_D ? " from D"
             : initial == DAL_INITIAL_D_EPS ? " from D_eps"
             : initial == DAL_INITIAL_PROJECT ? " projected" : " shifted");
    const int status = dal_order_study(system, scheme, &def, result.points, &result.order, &error);
    check_true(status == 0, error.text, system_name, __LINE__);
    dal_system_free(system);
    fit_run(&result);
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
    expect_at_least(result, &result->run, p, "the state at t_end");
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
            measurement result = measure(systems[i], &scheme, DAL_INITIAL_NONE, k->t_end, k->count,
                                         k->steps);
            expect_order(&result, k->p);
            if (k->p == 1) expect_equal(&result, &result.run, 1, "the state at t_end");
        }
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

int main(void)
{
    test_orders();
    test_midpoint_reactions();
    return check_done();
}
