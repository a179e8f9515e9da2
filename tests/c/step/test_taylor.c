/* The family taylor, with series that are written by hand: a blade on an incline, whose heading
 * turns uniformly, and a ball in the potential |q|. */
#include "check.h"
#include "dalembert/inspect.h"
#include "dalembert/series.h"
#include "dalembert/stepper.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- the blade: L = |v|^2/2 + x/2, sin(theta) v_x = cos(theta) v_y --------------------------- */

enum { N = 3, WIDTH = 8 };

static int constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    const double s = sin(q[2]), c = cos(q[2]);
    (void)t, (void)phi_t, (void)ctx;
    if (phi) phi[0] = s * v[0] - c * v[1];
    if (phi_v) phi_v[0] = s, phi_v[1] = -c, phi_v[2] = 0.0;
    if (phi_q) phi_q[0] = phi_q[1] = 0.0, phi_q[2] = c * v[0] + s * v[1];
    return 0;
}

static int potential(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    (void)t, (void)ctx;
    if (V) *V = -0.5 * q[0];
    if (V_q) V_q[0] = -0.5, V_q[1] = V_q[2] = 0.0;
    if (V_qq) memset(V_qq, 0, N * N * sizeof *V_qq);
    return 0;
}

/* y = (x, y, theta, w, omega): v = (w cos, w sin, omega), w' = cos(theta)/2, omega' = 0. */
static void expand(const dal_series_at *at, size_t order, double *Y, double *work, const void *p)
{
    dal_four *const A = (dal_four *)work, *const B = A + order;
    const double unit = at->unit, turn = unit * at->y[4], w0 = at->y[3];
    const double s0 = sin(at->y[2]) + at->low[2] * cos(at->y[2]);
    const double c0 = cos(at->y[2]) - at->low[2] * sin(at->y[2]);
    double s = s0, c = c0, along[2] = {w0 * c0, w0 * s0};
    (void)p;
    memset(Y, 0, (order + 1) * WIDTH * sizeof *Y);
    memcpy(Y, at->y, 5 * sizeof *Y);
    Y[WIDTH + 2] = turn;
    for (size_t k = 1; k <= order; k++) {
        double *const row = Y + k * WIDTH;
        const double number = (double)k;
        row[0] = unit * along[0] / number;
        row[1] = unit * along[1] / number;
        row[3] = 0.5 * unit * c / number;
        if (k == order) return;
        union { dal_four vector; double at[4]; } M;
        dal_series_middle(k, 1, A, B, &M.vector);
        const double before = s;
        s = DAL_SERIES_OVER(turn * c, k < at->exact, number, 1.0 / number);
        c = -DAL_SERIES_OVER(turn * before, k < at->exact, number, 1.0 / number);
        along[0] = (M.at[0] + c * w0) + c0 * row[3];
        along[1] = (M.at[1] + s * w0) + s0 * row[3];
        A[k] = (dal_four){c, s, 0.0, 0.0};
        B[k] = (dal_four){row[3], row[3], 0.0, 0.0};
    }
}

static void decay(size_t order, const double *Y, double *found)
{
    dal_series_decay(WIDTH, order, Y, found);
}

static void sum(size_t order, double s, const double *Y, double *change)
{
    dal_series_sum(WIDTH, order, s, Y, change);
}

static void slope(size_t order, double s, const double *Y, double *found)
{
    dal_series_slope(WIDTH, order, s, Y, found);
}

static void velocity(double t, const double *y, const double *u, double *v, const void *p)
{
    (void)t, (void)u, (void)p;
    v[0] = y[3] * cos(y[2]);
    v[1] = y[3] * sin(y[2]);
    v[2] = y[4];
}

static void quasi(double t, const double *x, const double *u, double *w, const void *p)
{
    (void)t, (void)u, (void)p;
    w[0] = x[3] * cos(x[2]) + x[4] * sin(x[2]);
    w[1] = x[5];
}

static const dal_series blade_series = {
    DAL_SERIES_ABI, 5, 0, 0, WIDTH, 8, 1, 0, .expand = expand, .decay = decay, .sum = sum,
    .slope = slope, .velocity = velocity, .quasi = quasi};

static dal_system *blade(const dal_series *series)
{
    static const double masses[N] = {1.0, 1.0, 1.0};
    const dal_system_def def = {.n = N, .m = 1, .masses = masses, .potential = potential,
                                .constraint = constraint, .series = series};
    dal_system *system = NULL;
    CHECK(dal_system_new(&system, &def, NULL) == 0);
    return system;
}

/* From x = y = 0 with the speed 1: w = 1 + sin(theta)/2, x = sin + sin^2/4, y = 1 - cos + ... */
static void exact(double t, double *x)
{
    const double s = sin(t), c = cos(t), w = 1.0 + 0.5 * s;
    x[0] = s + 0.25 * s * s;
    x[1] = 1.0 - c + 0.25 * (t - s * c);
    x[2] = t;
    x[3] = w * c;
    x[4] = w * s;
    x[5] = 1.0;
}

static dal_stepper *started(const dal_system *system, double tolerance, double h, int own)
{
    static const double x[2 * N] = {0.0, 0.0, 0.0, 1.0, 0.0, 1.0};
    const dal_taylor_scheme data = {.tolerance = tolerance};
    const dal_options options = {.own_steps = own};
    dal_stepper *stepper = NULL;
    dal_scheme scheme;
    dal_error error;
    CHECK(dal_scheme_find(&scheme, "taylor", &error) == 0);
    scheme.data = &data;
    check_true(dal_stepper_new(&stepper, system, &scheme, &options, &error) == 0, error.text,
               __FILE__, __LINE__);
    CHECK(dal_stepper_start(stepper, 0.0, h, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    return stepper;
}

static double error_of(const dal_stepper *stepper)
{
    double x[2 * N], most = 0.0;
    exact(dal_stepper_time(stepper), x);
    for (size_t i = 0; i < 2 * N; i++)
        most = fmax(most, fabs(x[i] - dal_stepper_state(stepper)[i]));
    return most;
}

/* Steps that are parts of a piece, and steps of several; forwards and backwards. */
static void test_exact(const dal_system *system)
{
    const double sizes[] = {0.01, 1.0, 50.0, -0.3, -100.0};
    for (size_t i = 0; i < 5; i++) {
        const size_t steps = (size_t)ceil(100.0 / fabs(sizes[i]));
        dal_stepper *const stepper = started(system, 0.0, sizes[i], 0);
        dal_stats stats;
        CHECK(dal_advance(stepper, steps, NULL, NULL) == 0);
        CHECK(error_of(stepper) < 1e-13);
        dal_stepper_stats(stepper, &stats);
        CHECK(stats.worst_residual <= 4 * N * 0x1p-53 && stats.evaluations < 160);
        dal_stepper_free(stepper);
    }
}

static void test_tolerances(const dal_system *system)
{
    double last = HUGE_VAL;
    for (double tolerance = 1e-3; tolerance > 1e-13; tolerance *= 1e-3) {
        dal_stepper *const stepper = started(system, tolerance, 20.0, 0);
        CHECK(dal_step(stepper, NULL) == 0);
        CHECK(error_of(stepper) < 100.0 * tolerance && error_of(stepper) < 0.1 * last);
        last = error_of(stepper);
        dal_stepper_free(stepper);
    }
}

/* Steps of the scheme's own size, which end at a time that is asked for. */
static void test_own_steps(const dal_system *system)
{
    dal_stepper *const stepper = started(system, 0.0, INFINITY, 1);
    size_t steps = 0;
    CHECK(dal_stepper_until(stepper, 30.0) == 0);
    for (; dal_stepper_time(stepper) < 30.0; steps++) {
        CHECK(dal_step(stepper, NULL) == 0);
        CHECK(error_of(stepper) < 1e-13);
    }
    CHECK(dal_stepper_time(stepper) == 30.0 && steps > 5 && steps < 40);
    dal_stepper_free(stepper);
}

/* One that goes on from the numbers of another has its bits. */
static void test_saved(const dal_system *system, double h, int own)
{
    dal_stepper *const one = started(system, 0.0, h, own), *const other = started(system, 0.0, h,
                                                                                   own);
    const size_t count = dal_stepper_saved(one);
    double *const values = malloc(count * sizeof *values);
    for (int k = 0; k < 30; k++) {
        CHECK(dal_step(one, NULL) == 0);
        CHECK(dal_stepper_save(one, values) == 0);
        CHECK(dal_stepper_restore(other, values, count) == 0);
        CHECK(dal_step(one, NULL) == 0 && dal_step(other, NULL) == 0);
        CHECK(memcmp(dal_stepper_state(one), dal_stepper_state(other), 2 * N * sizeof(double))
              == 0);
    }
    for (size_t i = 1; i <= 2; i++) {
        const double kept = values[count - i];
        values[count - i] = 0.5;
        CHECK(dal_stepper_restore(other, values, count) == DAL_EINVAL);
        values[count - i] = kept;
    }
    free(values);
    dal_stepper_free(one);
    dal_stepper_free(other);
}

static void test_refused(void)
{
    dal_series old = blade_series;
    dal_system *const without = blade(NULL), *const with = blade(&blade_series);
    old.abi++;
    dal_system *const of_old = blade(&old);
    const struct {
        const dal_system *system;
        double tolerance;
        int status;
        const char *words;
    } cases[] = {{without, 0.0, DAL_EUNSUPPORTED, "has no Taylor series"},
                 {with, 0.5, DAL_EINVAL, "tolerance = 0.5: expected"},
                 {with, 1e-17, DAL_EINVAL, "tolerance = 1e-17: expected"},
                 {of_old, 0.0, DAL_EINVAL, "series: number 3, expected 2"}};
    CHECK(dal_system_has_series(with) && !dal_system_has_series(without));
    for (size_t i = 0; i < 4; i++) {
        const dal_taylor_scheme data = {.tolerance = cases[i].tolerance};
        dal_stepper *stepper = NULL;
        dal_scheme scheme;
        dal_error error;
        CHECK(dal_scheme_find(&scheme, "taylor", NULL) == 0);
        scheme.data = &data;
        CHECK(dal_stepper_new(&stepper, cases[i].system, &scheme, NULL, &error)
              == cases[i].status);
        CHECK(strstr(error.text, cases[i].words) != NULL);
    }
    const dal_options own = {.own_steps = 1};
    dal_stepper *stepper = NULL;
    dal_scheme scheme;
    dal_error error;
    CHECK(dal_scheme_find(&scheme, "midpoint", NULL) == 0);
    CHECK(dal_stepper_new(&stepper, with, &scheme, &own, &error) == DAL_EUNSUPPORTED);
    CHECK(strstr(error.text, "has no steps of its own size") != NULL);
    dal_system_free(without);
    dal_system_free(with);
    dal_system_free(of_old);
}

/* ---- the ball: y = (q, w), and the switch q; w' = -side -------------------------------------- */

static int height(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    (void)t, (void)ctx;
    if (V) *V = fabs(q[0]);
    if (V_q) V_q[0] = q[0] > 0.0 ? 1.0 : q[0] < 0.0 ? -1.0 : 0.0;
    if (V_qq) V_qq[0] = 0.0;
    return 0;
}

static void expand_ball(const dal_series_at *at, size_t order, double *Y, double *work,
                        const void *p)
{
    (void)work, (void)p;
    memset(Y, 0, (order + 1) * 4 * sizeof *Y);
    Y[0] = Y[2] = at->y[0];
    Y[1] = at->y[1];
    Y[4] = Y[6] = at->unit * at->y[1];
    Y[5] = -at->unit * at->side[0];
    if (order > 1) Y[8] = Y[10] = -0.5 * at->unit * at->unit * at->side[0];
}

static void decay_of_ball(size_t order, const double *Y, double *found)
{
    dal_series_decay(4, order, Y, found);
}

static void sum_of_ball(size_t order, double s, const double *Y, double *change)
{
    dal_series_sum(4, order, s, Y, change);
}

static void slope_of_ball(size_t order, double s, const double *Y, double *found)
{
    dal_series_slope(4, order, s, Y, found);
}

static void speed(double t, const double *y, const double *u, double *v, const void *p)
{
    (void)t, (void)u, (void)p;
    v[0] = y[1];
}

static void speed_of(double t, const double *x, const double *u, double *w, const void *p)
{
    (void)t, (void)u, (void)p;
    w[0] = x[1];
}

/* From q = 1 at rest: parabolas of the duration 2 sqrt(2), on one side and the other. */
static void test_switch(void)
{
    static const dal_series series = {
        DAL_SERIES_ABI, 2, 1, 0, 4, 0, 1, 0, .expand = expand_ball, .decay = decay_of_ball,
        .sum = sum_of_ball, .slope = slope_of_ball, .velocity = speed, .quasi = speed_of};
    static const double mass[] = {1.0}, x[] = {1.0, 0.0};
    const dal_system_def def = {.n = 1, .masses = mass, .potential = height, .series = &series};
    dal_system *system = NULL;
    dal_scheme scheme;
    CHECK(dal_system_new(&system, &def, NULL) == 0);
    CHECK(dal_scheme_find(&scheme, "taylor", NULL) == 0);
    for (int own = 0; own < 2; own++) {
        const dal_options options = {.own_steps = own};
        dal_stepper *stepper = NULL;
        CHECK(dal_stepper_new(&stepper, system, &scheme, &options, NULL) == 0);
        CHECK(dal_stepper_start(stepper, 0.0, own ? INFINITY : 0.37, x, DAL_CHECK,
                                DAL_INITIAL_NONE) == 0);
        const double half = 2.0 * sqrt(2.0);
        for (int k = 0; k < 60; k++) {
            CHECK(dal_step(stepper, NULL) == 0);
            const double since = dal_stepper_time(stepper) + 0.5 * half;
            const double count = floor(since / half), s = since - (count + 0.5) * half;
            const double expected = (1.0 - 0.5 * s * s) * (fmod(count, 2.0) == 0.0 ? 1.0 : -1.0);
            CHECK(fabs(dal_stepper_state(stepper)[0] - expected) < 1e-12);
        }
        dal_stepper_free(stepper);
    }
    dal_system_free(system);
}

/* The sizes of last coefficients, of any column; NaN where one is not finite. */
static void test_decay(void)
{
    enum { ORDER = 6 };
    double Y[(ORDER + 1) * 4] __attribute__((aligned(32))) = {0.0}, found[DAL_SERIES_LAST];
    Y[4 + 1] = 2.0;
    Y[6 * 4 + 1] = 0.5;
    Y[5 * 4 + 2] = -3.0; /* without coefficients of low order */
    dal_series_decay(4, ORDER, Y, found);
    CHECK(found[0] == 0.0 && found[1] == 0.0 && found[2] == 1.0 && found[3] == 0.25);
    Y[4 * 4 + 3] = INFINITY;
    dal_series_decay(4, ORDER, Y, found);
    CHECK(isnan(found[0]));
    const double one = 0.1, other = 0.3;
    CHECK(DAL_SERIES_REST(double, one, other, one * other) == fma(one, other, -(one * other)));
}

int main(void)
{
    dal_system *const system = blade(&blade_series);
    test_exact(system);
    test_tolerances(system);
    test_own_steps(system);
    test_saved(system, 0.4, 0);
    test_saved(system, 7.0, 0);
    test_saved(system, INFINITY, 1);
    test_refused();
    test_switch();
    test_decay();
    dal_system_free(system);
    return check_done();
}
