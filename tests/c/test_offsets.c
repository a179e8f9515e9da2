/* Affine and nonlinear constraints far from the origin of coordinates and time, whose terms are
 * typed so that they cancel: v_z + 2c - 2y, and not v_z - 2 (y - c).
 *
 * L = |v|^2/2 in R^3 and a form that pushes z only, so that x and y are free, and, from y = c or
 * t = c on with v_y = 1 and s = y - c or t - c,
 *     RAMP, CLOCK         v_z = 2 s,            z = s^2
 *     CLOCK_CUBIC         v_z^3 + v_z = 2 s,    z = (3 v_z^4 + 2 v_z^2)/8
 *     BENT                v_z + s v_z^2 = 2 s,  z = (r - 1 + log((r - 1)/(2 s^2 (r + 1)))/2)/2
 *                                               with r^2 = 1 + 8 s^2
 *     FOLLOW              v_z = cos s + k (c + sin s - z), which leads to z = c + sin s. */
#include "check.h"
#include "fixtures.h"

enum { N = 3 };

typedef enum shape { RAMP, BENT, CLOCK, CLOCK_CUBIC, FOLLOW, SHAPES } shape;

typedef struct track {
    shape shape;
    double c, k;
    double unit[N], row; /* of coordinates, and of the form */
} track;

static bool is_timed(shape s) { return s >= CLOCK; }
static bool is_nonlinear(shape s) { return s == BENT || s == CLOCK_CUBIC; }

static int constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    const track *const a = ctx;
    const double c = a->c, k = a->k, s = t - c; /* of FOLLOW */
    const double y = q[1] * a->unit[1], z = q[2] * a->unit[2], w = v[2] * a->unit[2];
    double value = w + 2.0 * c - 2.0 * (is_timed(a->shape) ? t : y);
    double by_w = 1.0, by_y = is_timed(a->shape) ? 0.0 : -2.0, by_z = 0.0, by_t = -2.0;
    if (a->shape == BENT) {
        value += y * w * w - c * w * w;
        by_w += 2.0 * y * w - 2.0 * c * w;
        by_y += w * w;
    } else if (a->shape == CLOCK_CUBIC) {
        value += w * w * w;
        by_w += 3.0 * w * w;
    } else if (a->shape == FOLLOW) {
        value = w - cos(s) + k * z - k * c - k * sin(s);
        by_z = k;
        by_t = sin(s) - k * cos(s);
    }
    if (phi) *phi = a->row * value;
    if (phi_v) memcpy(phi_v, (double[]){0.0, 0.0, a->row * a->unit[2] * by_w}, N * sizeof *phi_v);
    if (phi_q)
        memcpy(phi_q, (double[]){0.0, a->row * a->unit[1] * by_y, a->row * a->unit[2] * by_z},
               N * sizeof *phi_q);
    if (phi_t) *phi_t = a->row * by_t;
    return 0;
}

static dal_system *open_track(track *a)
{
    double mass[N * N] = {0};
    for (size_t i = 0; i < N; i++) mass[4 * i] = a->unit[i] * a->unit[i];
    const dal_system_def def = {.n = N, .m = 1, .mass = mass, .constraint = constraint, .ctx = a,
                                .kind = is_nonlinear(a->shape) ? DAL_NONLINEAR : DAL_AFFINE,
                                .time_dependent = is_timed(a->shape), .name = "track"};
    return new_system(&def);
}

static track plain(shape shape, double c)
{
    return (track){.shape = shape, .c = c, .k = 30.0, .unit = {1.0, 1.0, 1.0}, .row = 1.0};
}

/* x[2n] <- where the motions begin; their time. */
static double begin(const track *a, double *x)
{
    const bool follows = a->shape == FOLLOW;
    const double start[2 * N] = {0.0, is_timed(a->shape) ? 0.0 : a->c, follows ? a->c : 0.0,
                                 1.0, 1.0, follows ? 1.0 : 0.0};
    for (size_t i = 0; i < 2 * N; i++) x[i] = start[i] / a->unit[i % N];
    return is_timed(a->shape) ? a->c : 0.0;
}

static dal_stepper *started(way by, const dal_system *system, const track *a, const char *scheme)
{
    const dal_scheme record = find_scheme(scheme);
    dal_stepper *const stepper = open_stepper_by(by, system, &record);
    double x[2 * N];
    const double t0 = begin(a, x);
    need(dal_stepper_start(stepper, t0, 0.01, x, DAL_CHECK,
                           record.nodes == DAL_KEPT_NODES ? DAL_INITIAL_D : DAL_INITIAL_NONE),
         scheme, dal_stepper_error(stepper)->text);
    return stepper;
}

/* s at a state; and phi, with this difference first, and the sizes of what is rounded in it. */
static double exact_s(const track *a, double t, const double *x)
{
    return (is_timed(a->shape) ? t : x[1]) - a->c;
}

static double exact_phi(const track *a, double t, const double *x, double *size)
{
    const double w = x[5], s = exact_s(a, t, x), from = fabs(s + a->c);
    if (a->shape == FOLLOW) {
        *size = fabs(w) + 1.0 + a->k * (fabs(x[2]) + from) + from;
        return w - cos(s) + a->k * (x[2] - a->c - sin(s));
    }
    const double more = a->shape == BENT ? s * w * w : a->shape == CLOCK_CUBIC ? w * w * w : 0.0;
    *size = 3.0 * fabs(w + more) + 2.0 * fabs(s) + 2.0 * from;
    return w + more - 2.0 * s;
}

static double exact_z(const track *a, double t, const double *x)
{
    const double w = x[5], s = exact_s(a, t, x), r = sqrt(1.0 + 8.0 * s * s);
    if (a->shape == FOLLOW) return a->c + sin(s);
    if (a->shape == BENT) return 0.5 * (r - 1.0 + 0.5 * log((r - 1.0) / (2.0 * s * s * (r + 1.0))));
    return a->shape == CLOCK_CUBIC ? (3.0 * w * w * w * w + 2.0 * w * w) / 8.0 : s * s;
}

static double residual_at(const dal_system *system, double t, double shift, const double *x)
{
    dal_mechanics *const mechanics = open_mechanics(system);
    double found = NAN;
    CHECK(dal_relative_residual(mechanics, t, shift, x, &found) == DAL_SUCCESS);
    return found;
}

static dal_stats total; /* of the steps of test_motions */

/* Steps do not end, keep D, and lead where they should: of order 2 with an error of h^2 at most,
 * of order 6 and `reference` to roundoff of c, which each step rounds anew. */
static void test_motions(shape shape, double c, const char *scheme, double tolerance)
{
    enum { STEPS = 120 };
    track a = plain(shape, c);
    dal_system *const system = open_track(&a);
    const bool flows = strcmp(scheme, "reference") == 0;
    for (way by = BY_LIBRARY; by <= (flows ? BY_LIBRARY : BY_ANY_SIZES); by++) {
        dal_stepper *const stepper = started(by, system, &a, scheme);
        size_t done = 0;
        const int status = dal_advance(stepper, STEPS, NULL, &done);
        check_true(status == DAL_SUCCESS && done == STEPS, dal_stepper_error(stepper)->text, scheme,
                   __LINE__);
        const double t = dal_stepper_time(stepper), *const x = dal_stepper_state(stepper);
        double size;
        const double left = exact_phi(&a, t, x, &size);
        check_near(left, 0.0, 4 * N * U * size, "phi", scheme, __LINE__);
        const double rounding = STEPS * 2 * U * (1.0 + a.k) * c;
        check_near(x[2], exact_z(&a, t, x), tolerance + rounding, "z", scheme, __LINE__);
        const dal_stats stats = stats_of(stepper);
        CHECK(stats.worst_residual <= DAL_RESIDUAL_BOUND(N));
        CHECK(residual_at(system, t, 0.0, x) <= stats.worst_residual);
        total.substeps += stats.substeps;
        total.constraint_calls += stats.constraint_calls;
        total.full_newtons += stats.full_newtons;
        total.corrections += stats.corrections;
        release(stepper);
    }
}

/* The residual is |phi| over the sum of |mu| |v|, |phi - mu v|, |phi_q| |q| and |phi_t t|, whatever
 * the units; at a kept node |phi_q| |q - shift v| + |phi_q| |shift v| takes the place of the third,
 * which linear constraints have there, too, and nowhere else. */
static void test_residual(void)
{
    const double x[2 * N] = {3.0, -70.0, 40.0, 0.25, 0.5, 0.75}, t = 1000.0, shift = 0.125;
    const double reach = 70.0 + 2 * shift * 0.5, speed = 0.75; /* |v|, with M = 1 */
    for (shape s = RAMP; s < FOLLOW; s++) {
        track a = plain(s, 20.0);
        /* v_z^2 = 0.5625, v_z^3 = 0.421875, s = -90 of BENT */
        const double more = s == BENT ? -90.0 * 0.5625 : s == CLOCK_CUBIC ? 0.421875 : 0.0;
        const double mu = s == BENT ? 1.0 - 135.0 : s == CLOCK_CUBIC ? 2.6875 : 1.0;
        const double phi = 0.75 + more + 40.0 - 2.0 * (is_timed(s) ? t : -70.0);
        const double size = fabs(mu) * speed + fabs(phi - mu * 0.75);
        const double moves = is_timed(s) ? 2.0 * t : s == BENT ? 1.4375 * 70.0 : 140.0;
        dal_system *system = open_track(&a);
        const double found = residual_at(system, t, 0.0, x);
        CHECK_NEAR(found, fabs(phi) / (size + moves), 1e-15);
        release(system);
        a.unit[1] = 0x1p40; /* scaled by powers of two it has the same bits */
        a.unit[2] = 0x1p-30;
        a.row = 0x1p70;
        double y[2 * N];
        for (size_t i = 0; i < 2 * N; i++) y[i] = x[i] / a.unit[i % N];
        system = open_track(&a);
        CHECK(residual_at(system, t, 0.0, y) == found);
        release(system);
    }
    track a = plain(RAMP, 20.0);
    dal_system *system = open_track(&a);
    const double moved = 0.75 + 40.0 + 2.0 * (70.0 + shift * 0.5);
    const double scale = speed + moved - 0.75 + 2.0 * reach;
    CHECK_NEAR(residual_at(system, t, shift, x), moved / scale, 1e-15);
    /* a blade after 10^4 turns */
    const double turns = 1e4 * 2.0 * acos(-1.0) + 0.3, at[2 * N] = {0, 0, turns, 0.5, 0.25, 2.0};
    system = open_system("uneven_edge");
    for (int kept = 0; kept < 2; kept++) {
        const double back = kept * shift * 2.0, heading = turns - back;
        const double sine = fabs(sin(heading)), cosine = fabs(cos(heading));
        const double form = fabs(sin(heading) * 0.5 - cos(heading) * 0.25);
        const double slope = fabs(cos(heading) * 0.5 + sin(heading) * 0.25);
        const double fastest = 2.0 * sqrt(0.75);
        const double size = (sine + cosine) / sqrt(2.0) * fastest;
        CHECK_NEAR(residual_at(system, 0.0, kept * shift, at),
                   form / (size + kept * slope * (heading + back)), 1e-14 * form);
    }
}

/* What phi does not depend on hides no error, however large it is. */
static void test_tight(void)
{
    track a = plain(RAMP, 0.0);
    dal_system *const system = open_track(&a);
    dal_mechanics *const mechanics = open_mechanics(system);
    dal_stepper *const stepper = open_named(system, "midpoint");
    double x[2 * N] = {1e15, 0.25, -1e15, 1.0, 1.0, 0.5 + 1e-6}, moved;
    CHECK_NEAR(residual_at(system, 1e15, 0.0, x), 1e-6 / 2.0, 1e-15);
    CHECK(dal_stepper_start(stepper, 1e15, 1.0, x, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EOFFD);
    CHECK(dal_project(mechanics, 1e15, 0.0, x, &moved) == DAL_SUCCESS);
    CHECK(x[5] == 0.5);
}

/* Velocities are found by projection, without many passes, and in a chart; and what is a rounding
 * of y or t off is accepted as a start. */
static void test_velocities(shape shape, double c)
{
    track a = plain(shape, c);
    dal_system *const system = open_track(&a);
    dal_mechanics *const mechanics = open_mechanics(system);
    double x[2 * N], xi[2 * N], size;
    const double t = begin(&a, x) + (is_timed(shape) ? 0.3 : 0.0);
    if (!is_timed(shape)) x[1] += 0.3;
    x[5] = 0.9;
    dal_chart *const chart = open_chart(system);
    CHECK(dal_chart_choose(chart, t, (size_t[]){2}, x) == DAL_SUCCESS);
    CHECK(dal_project(mechanics, t, 0.0, x, NULL) == DAL_SUCCESS);
    CHECK(mechanics->eval.calls.constraint <= 16);
    CHECK(fabs(exact_phi(&a, t, x, &size)) <= 4 * N * U * size);
    CHECK(residual_at(system, t, 0.0, x) <= DAL_RESIDUAL_BOUND(N));
    CHECK(dal_chart_drop(chart, x, xi) == DAL_SUCCESS);
    CHECK(dal_chart_lift(chart, t, xi, x) == DAL_SUCCESS);
    CHECK(fabs(exact_phi(&a, t, x, &size)) <= 4 * N * U * size);
    dal_stepper *const stepper = open_named(system, "midpoint");
    double t0 = begin(&a, x), *const rounded = is_timed(shape) ? &t0 : &x[1];
    *rounded = nextafter(*rounded, HUGE_VAL);
    CHECK(dal_stepper_start(stepper, t0, 0.01, x, DAL_CHECK, DAL_INITIAL_NONE) == DAL_SUCCESS);
}

/* Units that are powers of two change no bit of a motion, nor of its residual. */
static void test_units(shape shape)
{
    enum { STEPS = 40 };
    dal_stats stats[2];
    double x[2][2 * N];
    for (int scaled = 0; scaled < 2; scaled++) {
        track a = plain(shape, 1e3);
        if (scaled) {
            memcpy(a.unit, (double[]){0x1p-7, 0x1p40, 0x1p-30}, sizeof a.unit);
            a.row = 0x1p70;
        }
        dal_system *const system = open_track(&a);
        dal_stepper *const stepper = started(BY_LIBRARY, system, &a, "leapfrog");
        CHECK(dal_advance(stepper, STEPS, NULL, NULL) == DAL_SUCCESS);
        dal_stepper_stats(stepper, &stats[scaled]);
        for (size_t i = 0; i < 2 * N; i++)
            x[scaled][i] = dal_stepper_state(stepper)[i] * a.unit[i % N];
        release(system);
    }
    CHECK(memcmp(x[0], x[1], sizeof x[0]) == 0);
    CHECK(stats[0].worst_residual == stats[1].worst_residual);
}

/* Where roundings of q and t make velocities of more than the tolerance, error-controlled steps do
 * not shrink for ever; they are counted. */
static void test_controlled_steps(void)
{
    enum { MOST = 400 };
    track a = plain(FOLLOW, 1e6);
    a.k = 1000.0;
    dal_system *const system = open_track(&a);
    const dal_scheme scheme = find_scheme("midpoint-kl6");
    const dal_options options = {.tolerance = 1e-9};
    dal_stepper *const stepper = open_stepper(system, &scheme, &options);
    double x[2 * N];
    const double t0 = begin(&a, x);
    dal_stats stats = {0};
    int status = dal_stepper_start(stepper, t0, INFINITY, x, DAL_CHECK, DAL_INITIAL_NONE);
    while (!status && dal_stepper_time(stepper) < t0 + 0.2 && stats.steps < MOST) {
        status = dal_step(stepper, NULL);
        dal_stepper_stats(stepper, &stats);
    }
    CHECK(status == DAL_SUCCESS && stats.steps < MOST && stats.uncontrolled > 0);
}

int main(void)
{
    static const double offsets[] = {1.0, 10.0, 1e3, 1e5, 1e6};
    for (shape s = RAMP; s < SHAPES; s++) {
        test_units(s);
        for (size_t i = 0; i < DAL_LENGTH(offsets); i++) {
            test_velocities(s, offsets[i]);
            test_motions(s, offsets[i], "midpoint", 1e-4);
            test_motions(s, offsets[i], "leapfrog", 1e-4);
            test_motions(s, offsets[i], "midpoint-kl6", 1e-10);
            test_motions(s, offsets[i], "reference", 1e-10);
        }
    }
    CHECK(total.constraint_calls < 7 * total.substeps); /* few for their moves: 6.3 */
    CHECK(total.full_newtons < total.substeps / 25 && total.corrections == 0);
    test_residual();
    test_tight();
    test_controlled_steps();
    return check_done();
}
