/* Curves in D: the cut-off functions, the curve between two states, and the states between the rows
 * of a run, against formulas, the flow, and the promise to stay in D. */
#include "fixtures.h"
#include "vector_systems.h"
#include "check.h"

enum { N = 8, ROWS = 65, TIMES = 40 };

static const double pi = 3.14159265358979323846;

/* ---- the cut-off --------------------------------------------------------------------------- */

static void test_cutoff(void)
{
    double a, b, slope, mirror_a, mirror_b, mirror_slope;
    for (int k = 1; k < 1024; k++) {
        const double tau = k / 1024.0; /* 1 - tau is exact */
        dal_cutoff(tau, &a, &b, &slope);
        dal_cutoff(1.0 - tau, &mirror_a, &mirror_b, &mirror_slope);
        CHECK(a == mirror_b && b == mirror_a && slope == mirror_slope);
        CHECK_NEAR(a + b, 1.0, 2 * U);
        CHECK(slope <= 0.0 && slope >= -pi / 2 * (1 + 4 * U));
        /* relative: the exponent 2 w <= 652 has an error of some u, and so has what it gives */
        const long double near = tau <= 0.5 ? tau : 1.0 - tau; /* to the nearer end */
        const long double size = 1.0L / tanl(3.14159265358979323846264338327950288L * near);
        const long double w = tau <= 0.5 ? size : -size;
        const long double exact_a = 1.0L / (1.0L + expl(-2.0L * w));
        const long double exact_b = 1.0L / (1.0L + expl(2.0L * w));
        const long double exact_slope = -6.28318530717958647692528676655900577L * (1.0L + w * w)
                                      * exact_a * exact_b;
        const double tolerance = 8 * U * (1 + 2 * fabs((double)w));
        CHECK_NEAR(a / (double)exact_a, 1.0, tolerance);
        CHECK_NEAR(b / (double)exact_b, 1.0, tolerance);
        CHECK_NEAR(slope / (double)exact_slope, 1.0, tolerance);
    }
    dal_cutoff(0.5, &a, &b, &slope);
    CHECK(a == 0.5 && b == 0.5);
    CHECK_NEAR(slope, -pi / 2, 2 * U);
    const double before[] = {0.0, -0.0, -1.0, -INFINITY, 1e-300, 5e-324};
    const double after[] = {1.0, 1.5, INFINITY, 1.0 - U};
    for (size_t k = 0; k < sizeof before / sizeof *before; k++) {
        dal_cutoff(before[k], &a, &b, &slope);
        CHECK(a == 1.0 && b == 0.0 && slope == 0.0);
    }
    for (size_t k = 0; k < sizeof after / sizeof *after; k++) {
        dal_cutoff(after[k], &a, &b, &slope);
        CHECK(a == 0.0 && b == 1.0 && slope == 0.0);
    }
    dal_cutoff(NAN, &a, &b, &slope);
    CHECK(isnan(a) && isnan(b) && isnan(slope));
    dal_cutoff(0.3, NULL, NULL, NULL);
}

/* ---- between two states --------------------------------------------------------------------- */

static void test_curve_by_hand(void)
{
    dal_system *const system = open_system("particle");
    dal_chart *const chart = open_chart(system);
    const double x1[6] = {0, 1, 0, 2, 1, 2}, x2[6] = {4, 3, 2, 0, 3, 0};
    double x[6] = {7, 7, 7, 7, 7, 7};
    const size_t z = 2;
    CHECK(dal_chart_curve(chart, 0.0, x1, x2, 0.5, x) == DAL_EINVAL && x[0] == 7.0);
    CHECK(strstr(dal_chart_error(chart)->text, "no dependent coordinates") != NULL);
    CHECK(dal_chart_choose(chart, 0.0, &z, x1) == 0);
    CHECK(dal_chart_curve(chart, 0.0, x1, x2, 0.5, x) == 0);
    const double middle[6] = {2, 2, 1, 1, 2, 2}; /* v_z = y v_x */
    CHECK(memcmp(x, middle, sizeof x) == 0);
    const struct {
        const double *x1, *x2;
        double tau, *x;
        const char *words;
    } bad[] = {{NULL, x2, 0.5, x, "x1 is NULL"}, {x1, NULL, 0.5, x, "x2 is NULL"},
               {x1, x2, 0.5, NULL, "x is NULL"}, {x1, x2, INFINITY, x, "tau[0] = inf"}};
    for (size_t k = 0; k < sizeof bad / sizeof *bad; k++) {
        CHECK(dal_chart_curve(chart, 0.0, bad[k].x1, bad[k].x2, bad[k].tau, bad[k].x)
              == DAL_EINVAL);
        CHECK(strstr(dal_chart_error(chart)->text, bad[k].words) != NULL);
    }
    CHECK(dal_chart_curve(NULL, 0.0, x1, x2, 0.5, x) == DAL_EINVAL);
    CHECK(memcmp(x, middle, sizeof x) == 0);
}

/* From x1 to x2, in D all the way; flat at the ends: chi_1(1/64) = exp(-2 cot(pi/64)) < 1e-17. */
static void test_curve(const dal_system *system)
{
    const size_t n = dal_system_n(system);
    dal_mechanics *const mech = open_mechanics(system);
    dal_chart *const chart = open_chart(system);
    double x1[2 * N], x2[2 * N], x[2 * N], relative = NAN;
    unsigned seed = 7;
    for (size_t i = 0; i < 2 * n; i++) x1[i] = 0.3 * next_number(&seed);
    for (size_t i = 0; i < 2 * n; i++) x2[i] = x1[i] + 0.3 * next_number(&seed);
    CHECK(dal_project(mech, 0.0, 0.0, x1, NULL) == 0 && dal_project(mech, 0.0, 0.0, x2, NULL) == 0);
    CHECK(dal_chart_choose(chart, 0.0, NULL, x1) == 0);
    for (int k = -2; k <= 66; k++) {
        CHECK(dal_chart_curve(chart, 0.0, x1, x2, k / 64.0, x) == 0);
        CHECK(dal_relative_residual(mech, 0.0, 0.0, x, &relative) == 0);
        CHECK(relative <= DAL_RESIDUAL_BOUND(n));
        if (k <= 1) CHECK_NEAR(largest_difference(2 * n, x, x1), 0.0, 64 * U);
        if (k >= 63) CHECK_NEAR(largest_difference(2 * n, x, x2), 0.0, 64 * U);
    }
}

/* ---- between rows ---------------------------------------------------------------------------- */

typedef struct run {
    const dal_system *system;
    size_t n, rows;
    double t0, h, shift; /* h between rows */
    double *x;
} run;

/* rows rows of scheme, every stride-th of the step h/stride, from the system's state. */
static run make_run(const dal_system *system, const char *scheme_name, double t0, double h,
                    size_t rows, size_t stride, double *buffer)
{
    const dal_scheme scheme = find_scheme(scheme_name);
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    run r = {.system = system, .n = dal_system_n(system), .rows = rows, .t0 = t0, .h = h,
             .x = buffer};
    double x0[2 * N], shift = 0.0;
    const bool kept = scheme.nodes == DAL_KEPT_NODES;
    const double step = h / (double)stride;
    if (kept) CHECK(dal_scheme_shift(&scheme, &shift) == 0);
    r.shift = shift * step;
    CHECK(dal_system_state(system, x0) == 0);
    const dal_initial initial = kept ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE;
    need(dal_stepper_start(stepper, t0, step, x0, DAL_CHECK, initial), scheme_name,
         dal_stepper_error(stepper)->text);
    need(dal_integrate(stepper, (rows - 1) * stride, stride, buffer, NULL, NULL, NULL, NULL),
         scheme_name, dal_stepper_error(stepper)->text);
    return r;
}

static int between(dal_chart *chart, const run *r, size_t count, const double *t, double *out)
{
    return dal_chart_interpolate(chart, r->t0, r->h, r->shift, r->rows, r->x, count, t, out, NULL,
                                 NULL);
}

/* A free fall: q is a square and v is linear in t, so the polynomials are what they interpolate. */
static int gravity(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    if (V) *V = 9.0 * q[0];
    vector_set(V_q, 2, (double[]){9.0, 0.0});
    vector_set(V_qq, 4, (double[4]){0.0});
    return 0;
}

static void test_fall(void)
{
    const double mass[4] = {1, 0, 0, 1}, h = 0.75, t0 = 2.0;
    const dal_system_def def = {.n = 2, .mass = mass, .potential = gravity};
    double rows[4 * 3], out[4 * TIMES], t[TIMES];
    dal_system *const system = new_system(&def);
    dal_chart *const chart = open_chart(system);
    for (size_t k = 0; k < 3; k++) {
        const double s = (double)k * h;
        memcpy(rows + 4 * k, (double[]){1 + 5 * s - 4.5 * s * s, 2 - s, 5 - 9 * s, -1},
               4 * sizeof *rows);
    }
    for (size_t k = 0; k < TIMES; k++) t[k] = t0 + 2 * h * (double)k / (TIMES - 1);
    const run r = {system, 2, 3, t0, h, 0.0, rows};
    CHECK(between(chart, &r, TIMES, t, out) == 0);
    for (size_t k = 0; k < TIMES; k++) {
        const double s = t[k] - t0;
        const double expected[4] = {1 + 5 * s - 4.5 * s * s, 2 - s, 5 - 9 * s, -1};
        CHECK_NEAR(largest_difference(4, out + 4 * k, expected), 0.0, 128 * U);
    }
}

/* Errors against the flow at times off the grid, for h and h/2; the order is between the two. */
static void test_order(const dal_system *system, const char *scheme, size_t stride, double h,
                       double expected)
{
    const size_t n = dal_system_n(system), rows = 9;
    dal_chart *const chart = open_chart(system);
    dal_mechanics *const mech = open_mechanics(system);
    double buffer[2 * N * ROWS], error[2] = {0.0, 0.0}, relative = NAN;
    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-13);
    for (size_t level = 0; level < 2; level++) {
        const double step = level == 0 ? h : h / 2;
        const run r = make_run(system, scheme, 0.5, step, level == 0 ? rows : 2 * rows - 1, stride,
                               buffer);
        for (size_t k = 0; k < TIMES; k++) {
            const double t = r.t0 + h * (double)(rows - 1) * ((double)k + 0.37) / TIMES;
            double x[2 * N], exact[2 * N];
            CHECK(between(chart, &r, 1, &t, x) == 0);
            CHECK(dal_relative_residual(mech, 0.0, r.shift, x, &relative) == 0);
            CHECK(relative <= DAL_RESIDUAL_BOUND(n));
            for (size_t i = 0; i < n; i++) x[i] -= r.shift * x[n + i];
            CHECK(dal_system_state(system, exact) == 0);
            CHECK(dal_flow_apply(flow, r.t0, t, exact, NULL) == 0);
            error[level] = fmax(error[level], largest_difference(2 * n, x, exact));
        }
    }
    const double order = log2(error[0] / error[1]);
    printf("%s by %s, stride %zu, h = %g: errors %.2e %.2e, order %.2f\n", dal_system_name(system),
           scheme, stride, h, error[0], error[1], order);
    CHECK_NEAR(order, expected, 0.35);
}

/* Rows are reproduced bit for bit, also at times that were computed in another way; whatever the
 * order and the number of times in a call, the states are the same. */
static void test_rows(const dal_system *system, const char *scheme, double h)
{
    const size_t n = dal_system_n(system);
    double buffer[2 * N * (ROWS + 1)], t[ROWS], out[2 * N * ROWS], again[2 * N];
    dal_chart *const chart = open_chart(system);
    const run r = make_run(system, scheme, 0.1, h, ROWS, 3, buffer);
    for (size_t i = 0; i < 2 * n; i++) buffer[2 * n * ROWS + i] = NAN; /* no row of it */
    for (size_t k = 0; k < ROWS; k++) t[k] = 0.1 + (double)(3 * k) * (h / 3);
    CHECK(between(chart, &r, ROWS, t, out) == 0);
    CHECK(memcmp(out, r.x, 2 * n * ROWS * sizeof *out) == 0);

    unsigned seed = 3;
    for (size_t k = 0; k < ROWS; k++) t[k] = 0.1 + (ROWS - 1) * h * 0.5 * (1 + next_number(&seed));
    CHECK(between(chart, &r, ROWS, t, out) == 0);
    for (size_t k = ROWS; k-- > 0;) {
        CHECK(between(chart, &r, 1, t + k, again) == 0);
        CHECK(memcmp(again, out + 2 * n * k, 2 * n * sizeof *again) == 0);
    }
    CHECK(dal_chart_dependent(chart) == NULL); /* nothing was chosen by it */

    /* the end of a run that was meant, 1e-10 of the run beyond the last row; and no more */
    const double end = 0.1 + (ROWS - 1) * h, span = (ROWS - 1) * h;
    t[0] = end + 1e-10 * span;
    CHECK(between(chart, &r, 1, t, again) == 0);
    CHECK_NEAR(largest_difference(2 * n, again, r.x + 2 * n * (ROWS - 1)), 0.0,
               1e-9 * (1 + sum_of_sizes(2 * n, again)));
    t[0] = end + 1e-8 * span;
    CHECK(between(chart, &r, 1, t, again) == DAL_EINVAL);
}

/* The kept nodes of a run are its moved ones, moved: so is what lies between. */
static void test_kept_nodes(const dal_system *system)
{
    const size_t n = dal_system_n(system);
    double moved[2 * N * ROWS], kept[2 * N * ROWS], t[TIMES], x[2 * N * TIMES], y[2 * N * TIMES];
    dal_chart *const chart = open_chart(system);
    dal_mechanics *const mech = open_mechanics(system);
    const run a = make_run(system, "midpoint", 0.0, 0.1, 21, 2, moved);
    const run b = make_run(system, "midpoint-nodes", 0.0, 0.1, 21, 2, kept);
    CHECK(b.shift == 0.025);
    for (size_t k = 0; k < TIMES; k++) t[k] = 2.0 * ((double)k + 0.41) / TIMES;
    CHECK(between(chart, &a, TIMES, t, x) == 0 && between(chart, &b, TIMES, t, y) == 0);
    for (size_t k = 0; k < TIMES; k++) {
        double *const row = y + 2 * n * k, relative = NAN;
        CHECK(dal_relative_residual(mech, 0.0, b.shift, row, &relative) == 0);
        CHECK(relative <= DAL_RESIDUAL_BOUND(n));
        for (size_t i = 0; i < n; i++) row[i] -= b.shift * row[n + i];
        /* the two runs differ by the roundoff of 40 steps */
        CHECK_NEAR(largest_difference(2 * n, x + 2 * n * k, row), 0.0,
                   256 * U * (1 + sum_of_sizes(2 * n, row)));
    }
}

/* An angle that passes 2^20 is rounded more coarsely from there on, which turns the forms by 1e-10
 * between a node and the moved one: v follows. */
static void test_large_angles(void)
{
    dal_system *const disk = open_system("disk");
    dal_mechanics *const mech = open_mechanics(disk);
    dal_chart *const chart = open_chart(disk);
    double state[8] = {0.0, 0.0, 0.1, 0x1p20 - 0.2, 0.8, 0.3, 1.1, 0.9};
    double rows[8 * 9], t[TIMES], x[8 * TIMES];
    CHECK(dal_project(mech, 0.0, 0.0, state, NULL) == 0);
    dal_system_def def = disk->def;
    def.state = state;
    def.exact = NULL;
    def.invariants = 0;
    dal_system *const system = new_system(&def);
    const run r = make_run(system, "midpoint-nodes", 0.0, 0.1, 9, 1, rows);
    for (size_t k = 0; k < TIMES; k++) t[k] = 0.8 * ((double)k + 0.41) / TIMES;
    CHECK(between(chart, &r, TIMES, t, x) == 0);
    for (size_t k = 0; k < TIMES; k++) {
        double relative = NAN;
        CHECK(dal_relative_residual(mech, 0.0, r.shift, x + 8 * k, &relative) == 0);
        CHECK(relative <= DAL_RESIDUAL_BOUND(4));
    }
}

/* From y = -3 to 3 the particle depends in x, in z, in x again; and the caller's choice stays. */
static void test_changes(void)
{
    dal_system *const system = open_system("particle");
    dal_mechanics *const mech = open_mechanics(system);
    dal_chart *const chart = open_chart(system);
    const double x0[6] = {0.0, -3.0, 0.0, 1.0, 1.0, -3.0}, flat[6] = {0.0, 0.0, 0.0, 1.0, 1.0, 0.0};
    double rows[6 * 61], t[TIMES], out[6 * TIMES];
    size_t changes = 99, done = 99;
    const size_t *dependent;
    for (size_t k = 0; k < 61; k++)
        CHECK(dal_system_exact(system, 0.1 * (double)k, x0, rows + 6 * k) == 0);
    for (size_t k = 0; k < TIMES; k++) t[k] = 6.0 * ((double)k + 0.3) / TIMES;
    CHECK(dal_chart_choose(chart, 0.0, NULL, flat) == 0);
    CHECK(dal_chart_interpolate(chart, 0.0, 0.1, 0.0, 61, rows, TIMES, t, out, &changes, &done)
          == 0);
    CHECK(changes == 2 && done == TIMES);
    dependent = dal_chart_dependent(chart);
    CHECK(dependent != NULL && dependent[0] == 2);
    for (size_t k = 0; k < TIMES; k++) {
        double exact[6], relative = NAN;
        CHECK(dal_system_exact(system, t[k], x0, exact) == 0);
        /* h^4/384 of the fourth derivative of v, which is below 30 */
        CHECK_NEAR(largest_difference(6, out + 6 * k, exact), 0.0, 30 * 1e-4 / 384);
        CHECK(dal_relative_residual(mech, 0.0, 0.0, out + 6 * k, &relative) == 0);
        CHECK(relative <= DAL_RESIDUAL_BOUND(3));
    }
}

/* phi = v_z^2 - v_x^2 - v_y^2, two branches: between rows on one the chart stays on the other. */
static int cone(double t, const double *q, const double *v, double *phi, double *phi_v,
                double *phi_q, double *phi_t, void *ctx)
{
    if (phi) phi[0] = v[2] * v[2] - v[0] * v[0] - v[1] * v[1];
    vector_set(phi_v, 3, (double[]){-2 * v[0], -2 * v[1], 2 * v[2]});
    vector_set(phi_q, 3, (double[3]){0.0});
    return 0;
}

static void test_branches(void)
{
    const dal_system_def def = {.n = 3, .m = 1, .mass = vector_mass_one, .constraint = cone,
                                .kind = DAL_NONLINEAR};
    const double up[6] = {0, 0, 0, 3, 4, 5}, rows[12] = {0, 0, 0, 3, 4, -5, 3, 4, -5, 3, 4, -5};
    const double t = 0.5, xi[5] = {1, 2, 3, 5, 12}, middle[6] = {1.5, 2, -2.5, 3, 4, -5};
    const size_t z = 2;
    double x[6];
    dal_system *const system = new_system(&def);
    dal_chart *const chart = open_chart(system);
    CHECK(dal_chart_choose(chart, 0.0, &z, up) == 0);
    CHECK(dal_chart_interpolate(chart, 0.0, 1.0, 0.0, 2, rows, 1, &t, x, NULL, NULL) == 0);
    CHECK_NEAR(largest_difference(6, x, middle), 0.0, 32 * U);
    CHECK(dal_chart_lift(chart, 0.0, xi, x) == 0);
    CHECK_NEAR(x[5], 13.0, 32 * U);
}

/* The knife edge turns by 3 between two rows: no choice is good for all of such an interval. */
static void test_coarse(void)
{
    dal_system *const system = open_system("knife_edge");
    dal_mechanics *const mech = open_mechanics(system);
    dal_chart *const chart = open_chart(system);
    double x0[6], rows[6 * 5], t[TIMES], out[6 * TIMES], relative = NAN;
    size_t changes = 0;
    const double h = 2.5;
    CHECK(dal_system_state(system, x0) == 0);
    for (size_t k = 0; k < 5; k++)
        CHECK(dal_system_exact(system, h * (double)k, x0, rows + 6 * k) == 0);
    for (size_t k = 0; k < TIMES; k++) t[k] = 4 * h * ((double)k + 0.3) / TIMES;
    CHECK(dal_chart_interpolate(chart, 0.0, h, 0.0, 5, rows, TIMES, t, out, &changes, NULL) == 0);
    CHECK(changes >= 2);
    for (size_t k = 0; k < TIMES; k++) {
        CHECK(dal_relative_residual(mech, 0.0, 0.0, out + 6 * k, &relative) == 0);
        CHECK(relative <= DAL_RESIDUAL_BOUND(3));
        CHECK(sum_of_sizes(6, out + 6 * k) < 1e3);
    }
    /* one row interpolates nothing, and holds at its time */
    CHECK(dal_chart_interpolate(chart, 1.0, h, 0.0, 1, rows, 1, (double[]){1.0}, out, NULL, NULL)
          == 0);
    CHECK(memcmp(out, rows, 6 * sizeof *out) == 0);
}

/* ---- failures ------------------------------------------------------------------------------- */

/* The forms of the particle, undefined for x > 1/2. */
static int bounded(double t, const double *q, const double *v, double *phi, double *phi_v,
                   double *phi_q, double *phi_t, void *ctx)
{
    vector_particle_constraint(t, q, v, phi, phi_v, phi_q, NULL, ctx);
    return q[0] > 0.5 ? 1 : 0;
}

static void test_failures(void)
{
    const dal_system_def def = {.n = 3, .m = 1, .mass = vector_mass_one, .constraint = bounded};
    dal_system *const system = new_system(&def);
    dal_chart *const chart = open_chart(system);
    double rows[6 * 3], out[6 * 4], t[4] = {0.0, 0.05, 0.1, 0.15};
    size_t done = 99, changes = 99;
    for (size_t k = 0; k < 3; k++)
        memcpy(rows + 6 * k, (double[]){0.4 * (double)k, 0, 0, 4, 0, 0}, 6 * sizeof *rows);
    for (size_t k = 0; k < 24; k++) out[k] = 7.0;
#define REFUSED(t0, h, shift, count_rows, x, count, t, out, words)                               \
    do {                                                                                         \
        CHECK(dal_chart_interpolate(chart, t0, h, shift, count_rows, x, count, t, out, &changes, \
                                    &done) == DAL_EINVAL);                                       \
        CHECK(strstr(dal_chart_error(chart)->text, words) && done == 0 && changes == 99);          \
    } while (0)
    REFUSED(0, 0.1, 0, 3, NULL, 4, t, out, "x is NULL");
    REFUSED(0, 0.1, 0, 3, rows, 4, NULL, out, "t is NULL");
    REFUSED(0, 0.1, 0, 3, rows, 4, t, NULL, "out is NULL");
    REFUSED(0, 0.1, 0, 0, rows, 4, t, out, "rows = 0");
    REFUSED(0, 0.0, 0, 3, rows, 4, t, out, "h = 0");
    REFUSED(0, NAN, 0, 3, rows, 4, t, out, "h = nan");
    REFUSED(NAN, 0.1, 0, 3, rows, 4, t, out, "t0[0] = nan");
    REFUSED(0, 0.1, INFINITY, 3, rows, 4, t, out, "shift[0] = inf");
    REFUSED(0, 0.1, 0, 2, rows, 4, t, out, "t = 0.15 is outside the stored states: "
            "expected a time from 0 to 0.1");
    REFUSED(0, -0.1, 0, 3, rows, 4, t, out, "t = 0.05 is outside");
    REFUSED(0, 0.1, 0, 3, rows, 1, (double[]){NAN}, out, "t = nan is outside");
    REFUSED(0, 0.1, 0, 1, rows, 1, t + 1, out, "t = 0.05 is outside");
#undef REFUSED
    CHECK(dal_chart_interpolate(NULL, 0, 0.1, 0, 3, rows, 4, t, out, NULL, NULL) == DAL_EINVAL);
    for (size_t k = 0; k < 24; k++) CHECK(out[k] == 7.0);
    /* the last row is outside of the domain */
    CHECK(dal_chart_interpolate(chart, 0, 0.1, 0, 3, rows, 4, t, out, &changes, &done)
          == DAL_EDOMAIN);
    CHECK(done == 3 && changes == 99 && out[18] == 7.0);
    CHECK_NEAR(out[6], 0.2, 4 * U);
    CHECK(strstr(dal_chart_error(chart)->text, "returned 1") != NULL);
    /* a row that is not finite is handed out at no time, its own and those beside it */
    rows[3] = NAN;
    CHECK(dal_chart_interpolate(chart, 0, 0.1, 0, 3, rows, 4, t, out, NULL, &done) == DAL_EINVAL);
    CHECK(done == 0);
    CHECK(dal_chart_interpolate(chart, 0, 0.1, 0, 3, rows, 1, t + 1, out, NULL, &done)
          == DAL_EINVAL);
    CHECK(strstr(dal_chart_error(chart)->text, "x[3] = nan is not finite in row 0") != NULL);
    CHECK(dal_chart_interpolate(chart, 0, 0.1, 0, 3, rows, 0, NULL, NULL, NULL, NULL) == 0);
}

/* ---- systems with a state, some with M(q) or a nonlinear constraint ------------------------ */

/* held: what has to outlive the system. */
static dal_system *with_state(const vector_system *is, dal_constraint_kind kind,
                              dal_system *held[2])
{
    dal_system_def def = {.n = is->n, .m = is->m, .mass = is->mass, .potential = is->potential,
                          .constraint = is->constraint, .lagrangian = is->lagrangian,
                          .name = is->name};
    double state[6] = {0.4, -0.3, 0.2, 0.6, 0.5, -0.3};
    held[0] = held[1] = NULL;
    held[0] = new_system(&def);
    if (kind == DAL_NONLINEAR)
        held[1] = open_deformed(held[0], product, NULL, 0.3, kind, 0);
    def = held[held[1] ? 1 : 0]->def; /* again, with the callbacks and the context of that one */
    dal_mechanics *const mech = open_mechanics(held[held[1] ? 1 : 0]);
    CHECK(dal_project(mech, 0.0, 0.0, state, NULL) == 0);
    def.state = state;
    return new_system(&def);
}

static void test_system(dal_system *system)
{
    test_curve(system);
    test_rows(system, "midpoint", 0.02);
    test_rows(system, "midpoint-nodes", -0.02);
    test_kept_nodes(system);
}

int main(void)
{
    static const struct {
        const char *scheme;
        size_t stride;
        double h, order;
    } orders[] = {{"midpoint", 1, 0.05, 2}, {"midpoint-suzuki4", 1, 0.2, 4},
                  {"midpoint-kl8", 1, 0.1, 4}, {"midpoint-kl8", 2, -0.1, 4},
                  {"endpoint", 3, 0.05, 1}, {"midpoint-nodes", 2, 0.05, 2}};
    enum { ORDERS = sizeof orders / sizeof *orders };
    dal_system *held[2];
    test_cutoff();
    test_curve_by_hand();
    test_fall();
    for (size_t k = 0; k < sizeof vector_systems / sizeof *vector_systems; k++) {
        if (vector_systems[k].n != 3) continue;
        dal_system *const system = with_state(&vector_systems[k], DAL_LINEAR, held);
        test_system(system);
        for (size_t j = 0; !vector_systems[k].mass && j < ORDERS; j++)
            test_order(system, orders[j].scheme, orders[j].stride, orders[j].h, orders[j].order);
    }
    dal_system *const generic4 = open_system("generic4"), *const disk = open_system("disk");
    test_system(generic4);
    test_system(disk);
    for (size_t j = 0; j < ORDERS; j++)
        test_order(generic4, orders[j].scheme, orders[j].stride, orders[j].h, orders[j].order);
    dal_system *const bent = with_state(&vector_systems[1], DAL_NONLINEAR, held);
    test_curve(bent);
    test_order(bent, "midpoint", 1, 0.05, 2);
    test_order(bent, "midpoint-kl8", 1, 0.1, 4);
    test_large_angles();
    test_changes();
    test_branches();
    test_coarse();
    test_failures();
    return check_done();
}
