/* Systems that depend on time: what is evaluated when, by all that evaluates.
 *
 * A skate with the heading theta, whose blade is turned by a motor at the rate `turn`, on a floor
 * that moves with the velocity w = (sway cos 2t, 0), down a slope that changes, with a mass that
 * grows as exp(growth t):
 *     L = exp(growth t) (m (v_x^2 + v_y^2)/2 + J v_theta^2/2 + m g x),  g = slope (1 + sin(3t)/2),
 *     sin(psi) (v_x - w) - cos(psi) v_y = 0,  psi = theta + turn t.
 * With e = (cos psi, sin psi) and n = (sin psi, -cos psi) the velocity is u e + w, theta' = omega
 * exp(-growth t), and
 *     u' = g cos(psi) - growth (u + w e) - w' e,
 *     lambda = exp(growth t) m (w' n + growth w n - u psi' - g n). */
#include "fixtures.h"
#include "check.h"

typedef struct skate {
    double turn, sway, growth;
    double blind_phi, blind_L; /* errors of phi_t and L_vt, for the check */
} skate;

enum { N = 3 };
static const double m = 2.0, J = 0.75, slope = 2.5;
static const double mass[9] = {2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.75};

static double gravity(double t) { return slope * (1.0 + 0.5 * sin(3.0 * t)); }
static double floor_speed(const skate *s, double t) { return s->sway * cos(2.0 * t); }
static double floor_push(const skate *s, double t) { return -2.0 * s->sway * sin(2.0 * t); }

static int potential(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    if (V) *V = -m * gravity(t) * q[0];
    if (V_q) memcpy(V_q, (double[]){-m * gravity(t), 0.0, 0.0}, N * sizeof *V_q);
    if (V_qq) memset(V_qq, 0, N * N * sizeof *V_qq);
    return 0;
}

static int lagrangian(double t, const double *q, const double *v, double *L, double *L_q,
                      double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                      void *ctx)
{
    const skate *const s = ctx;
    const double E = exp(s->growth * t), g = gravity(t);
    if (L) *L = E * (0.5 * m * (v[0] * v[0] + v[1] * v[1]) + 0.5 * J * v[2] * v[2] + m * g * q[0]);
    if (L_q) memcpy(L_q, (double[]){E * m * g, 0.0, 0.0}, N * sizeof *L_q);
    for (size_t i = 0; i < N; i++) {
        if (L_v) L_v[i] = E * mass[4 * i] * v[i];
        if (L_vt) L_vt[i] = s->growth * E * mass[4 * i] * v[i] + s->blind_L;
    }
    if (L_qq) memset(L_qq, 0, N * N * sizeof *L_qq);
    if (L_vq) memset(L_vq, 0, N * N * sizeof *L_vq);
    for (size_t k = 0; L_vv && k < N * N; k++) L_vv[k] = E * mass[k];
    return 0;
}

static int constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    const skate *const s = ctx;
    const double sine = sin(q[2] + s->turn * t), cosine = cos(q[2] + s->turn * t);
    const double w = floor_speed(s, t), turns = cosine * (v[0] - w) + sine * v[1];
    if (phi) *phi = sine * (v[0] - w) - cosine * v[1];
    if (phi_v) memcpy(phi_v, (double[]){sine, -cosine, 0.0}, N * sizeof *phi_v);
    if (phi_q) memcpy(phi_q, (double[]){0.0, 0.0, turns}, N * sizeof *phi_q);
    if (phi_t) *phi_t = s->turn * turns - sine * floor_push(s, t) + s->blind_phi;
    return 0;
}

/* ---- the solution, by the equations of u alone --------------------------------------------- */

typedef long double real;

/* d/dt of (u, x, y), theta known. */
static void rates(const skate *s, double theta0, double omega, real t, const real y[3], real dy[3])
{
    const real growth = s->growth;
    const real turned = growth == 0.0L ? t : -expm1l(-growth * t) / growth;
    const real psi = theta0 + omega * turned + s->turn * t, c = cosl(psi), sine = sinl(psi);
    const real w = s->sway * cosl(2.0L * t), push = -2.0L * s->sway * sinl(2.0L * t);
    const real g = slope * (1.0L + 0.5L * sinl(3.0L * t));
    dy[0] = g * c - growth * (y[0] + w * c) - push * c;
    dy[1] = y[0] * c + w;
    dy[2] = y[0] * sine;
}

/* The method of Runge and Kutta in long double: 2000 steps in a unit of time leave 1e-14. */
static int exact(double t, const double *x0, double *x, void *ctx)
{
    const skate *const s = ctx;
    const double theta0 = x0[2], omega = x0[5], c0 = cos(theta0), s0 = sin(theta0);
    const int steps = 1 + (int)(2000.0 * fabs(t));
    const real h = (real)t / steps;
    real y[3] = {(x0[3] - floor_speed(s, 0.0)) * c0 + x0[4] * s0, x0[0], x0[1]};
    for (int k = 0; k < steps; k++) {
        static const real parts[4] = {0.0L, 0.5L, 0.5L, 1.0L};
        static const real weights[4] = {1.0L, 2.0L, 2.0L, 1.0L};
        real slopes[3] = {0}, sum[3] = {0}, z[3];
        for (int j = 0; j < 4; j++) {
            for (int i = 0; i < 3; i++) z[i] = y[i] + h * parts[j] * slopes[i];
            rates(s, theta0, omega, h * (k + parts[j]), z, slopes);
            for (int i = 0; i < 3; i++) sum[i] += weights[j] * slopes[i];
        }
        for (int i = 0; i < 3; i++) y[i] += h * sum[i] / 6.0L;
    }
    const double turned = s->growth == 0.0 ? t : -expm1(-s->growth * t) / s->growth;
    const double theta = theta0 + omega * turned, psi = theta + s->turn * t;
    x[0] = (double)y[1];
    x[1] = (double)y[2];
    x[2] = theta;
    x[3] = (double)y[0] * cos(psi) + floor_speed(s, t);
    x[4] = (double)y[0] * sin(psi);
    x[5] = omega * exp(-s->growth * t);
    return 0;
}

/* values[1] <- lambda at x[2n]. */
static int reaction(double t, const double *x, double *values, void *ctx)
{
    const skate *const s = ctx;
    const double psi = x[2] + s->turn * t, c = cos(psi), sine = sin(psi);
    const double w = floor_speed(s, t), u = (x[3] - w) * c + x[4] * sine;
    *values = exp(s->growth * t) * m
            * ((floor_push(s, t) + s->growth * w) * sine - u * (x[5] + s->turn)
               - gravity(t) * sine);
    return 0;
}

/* ---- the same in several ways -------------------------------------------------------------- */

typedef struct variety {
    const char *name;
    skate s;
    bool general; /* by its Lagrangian */
    dal_constraint_kind kind;
} variety;

static const variety varieties[] = {
    {"by the step routine", {.turn = 0.7}, false, DAL_LINEAR},
    {"by Newton", {.turn = 0.7}, true, DAL_LINEAR},
    {"on a floor that moves", {.turn = 0.7, .sway = 0.4}, false, DAL_AFFINE},
    {"called nonlinear", {.turn = -0.5, .sway = 0.4}, false, DAL_NONLINEAR},
    {"growing", {.turn = 0.7, .growth = 0.3}, true, DAL_LINEAR},
    {"growing on a floor that moves", {.turn = 0.7, .sway = 0.4, .growth = 0.3}, true, DAL_AFFINE},
};
enum { VARIETIES = sizeof varieties / sizeof *varieties };

static dal_system_def definition(const variety *a, unsigned missing)
{
    static const char *const names[] = {"lambda"};
    return (dal_system_def){.n = N, .m = 1, .mass = a->general ? NULL : mass,
                            .potential = a->general ? NULL : potential,
                            .lagrangian = a->general ? lagrangian : NULL, .constraint = constraint,
                            .kind = a->kind, .missing = missing, .ctx = (void *)&a->s,
                            .name = a->name, .exact = exact, .invariants = 1,
                            .invariant_names = names, .invariant = reaction, .time_dependent = 1};
}

static dal_system *open_skate(const variety *a, unsigned missing)
{
    const dal_system_def def = definition(a, missing);
    return new_system(&def);
}

/* A state of D at time t. */
static void state_at(const skate *s, double t, double *x)
{
    const double theta = 0.2, psi = theta + s->turn * t, u = 0.5;
    const double v[] = {0.1, -0.3, theta, u * cos(psi) + floor_speed(s, t), u * sin(psi), 1.2};
    memcpy(x, v, sizeof v);
}

static double residual_at(dal_mechanics *mechanics, double t, double shift, const double *x)
{
    double relative = INFINITY;
    CHECK(dal_relative_residual(mechanics, t, shift, x, &relative) == 0);
    return relative;
}

/* lambda, the acceleration, energy and metric at one time, and the same by differences in t, which
 * are good to 1e-12. */
static void test_mechanics(const variety *a)
{
    const double t = 0.8;
    double x[2 * N], lambda, expected, xdot[2 * N], E, M[N * N], ahead[2 * N], behind[2 * N];
    for (int differenced = 0; differenced < 2; differenced++) {
        const unsigned missing =
            !differenced ? 0 : DAL_MISSING_PHI_T | (a->general ? DAL_MISSING_L_VT : 0);
        dal_system *const system = open_skate(a, missing);
        dal_mechanics *const mechanics = open_mechanics(system);
        CHECK(dal_system_is_time_dependent(system) && dal_system_missing(system) == missing);
        state_at(&a->s, t, x);
        CHECK(residual_at(mechanics, t, 0.0, x) <= 4.0 * N * U);
        CHECK(residual_at(mechanics, 0.0, 0.0, x) > 1e-3);
        CHECK(dal_system_invariant(system, t, x, &expected) == 0);
        CHECK(dal_multipliers(mechanics, t, x, &lambda) == 0);
        CHECK_NEAR(lambda, expected, (differenced ? 1e-11 : 64.0 * U) * (1.0 + fabs(expected)));
        /* vdot: u' e + u psi' e' + w', and that of phi = 0 ahead and behind */
        CHECK(dal_field(mechanics, t, x, xdot) == 0);
        const double d = 1e-4;
        for (size_t i = 0; i < 2 * N; i++) {
            ahead[i] = x[i] + d * xdot[i];
            behind[i] = x[i] - d * xdot[i];
        }
        double plus, minus; /* phi is 0 up to d^2, whose even part cancels */
        CHECK(dal_residual(mechanics, t + d, 0.0, ahead, &plus) == 0);
        CHECK(dal_residual(mechanics, t - d, 0.0, behind, &minus) == 0);
        CHECK_NEAR((plus - minus) / (2.0 * d), 0.0, 1e-6);
        CHECK_NEAR(xdot[5], -a->s.growth * x[5], 1e-11);
        const double size = exp(a->s.growth * t);
        CHECK(dal_metric(mechanics, t, x, M) == 0 && dal_energy(mechanics, t, x, &E) == 0);
        CHECK_NEAR(M[0], size * m, 1e-14);
        CHECK_NEAR(E, size * (0.5 * m * (x[3] * x[3] + x[4] * x[4]) + 0.5 * J * x[5] * x[5]
                              - m * gravity(t) * x[0]), 1e-14);
        double C;
        CHECK(dal_gram(mechanics, t, x, &C) == 0);
        CHECK_NEAR(C, 1.0 / (size * m), 1e-15);
        release(system);
    }
}

static void test_projections(const variety *a)
{
    const double t = 0.8;
    const unsigned char keep[N] = {1, 0, 0};
    dal_system *const system = open_skate(a, 0);
    dal_mechanics *const mechanics = open_mechanics(system);
    double x[2 * N], distance, E, other;
    state_at(&a->s, t, x);
    x[4] += 0.3;
    CHECK(dal_project(mechanics, t, 0.0, x, &distance) == 0 && distance > 0.1);
    CHECK(residual_at(mechanics, t, 0.0, x) <= 4.0 * N * U);
    CHECK(dal_project(mechanics, t, 0.05, x, &distance) == 0);
    CHECK(residual_at(mechanics, t, 0.05, x) <= 1e-14);
    x[3] += 0.3;
    const double kept = x[3];
    CHECK(dal_consistent(mechanics, t, keep, x, &distance) == 0 && x[3] == kept);
    CHECK(residual_at(mechanics, t, 0.0, x) <= 4.0 * N * U);
    /* rows at t0 + k h */
    double rows[2][2 * N], energy[2], lambda[2], relative[2];
    memcpy(rows[0], x, sizeof x);
    state_at(&a->s, t + 0.4, rows[1]);
    CHECK(dal_trajectory(mechanics, t, 0.4, 0.0, 2, rows[0], NULL, energy, lambda, NULL, relative,
                         NULL)
          == 0);
    CHECK(fmax(relative[0], relative[1]) <= 4.0 * N * U);
    CHECK(dal_energy(mechanics, t + 0.4, rows[1], &E) == 0 && E == energy[1]);
    CHECK(dal_multipliers(mechanics, t + 0.4, rows[1], &other) == 0 && other == lambda[1]);
}

/* ---- the flow and charts -------------------------------------------------------------------- */

static void test_flow(const variety *a)
{
    static const dal_flow_coordinates both[] = {DAL_FLOW_X, DAL_FLOW_XI};
    enum { STEPS = 7 };
    const double t1 = 1.3, h = 0.17;
    double x0[2 * N], x[(STEPS + 1) * 2 * N], expected[2 * N], accuracy;
    dal_system *const system = open_skate(a, 0);
    dal_mechanics *const mechanics = open_mechanics(system);
    state_at(&a->s, 0.0, x0);
    for (int k = 0; k < 2; k++) {
        dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, both[k], 1e-13);
        memcpy(x, x0, sizeof x0);
        CHECK(dal_flow_apply(flow, 0.0, t1, x, &accuracy) == 0 && accuracy < 1e-11);
        CHECK(dal_system_exact(system, t1, x0, expected) == 0);
        CHECK_NEAR(largest_difference(2 * N, x, expected), 0.0, 1e-11);
        CHECK(residual_at(mechanics, t1, 0.0, x) <= 4.0 * N * U);
        memcpy(x, x0, sizeof x0);
        CHECK(dal_flow_trajectory(flow, 0.0, h, STEPS, x, NULL) == 0);
        for (size_t row = 1; row <= STEPS; row++)
            CHECK(residual_at(mechanics, (double)row * h, 0.0, x + row * 2 * N) <= 4.0 * N * U);
        CHECK(dal_system_exact(system, STEPS * h, x0, expected) == 0);
        CHECK_NEAR(largest_difference(2 * N, x + STEPS * 2 * N, expected), 0.0, 1e-11);
        /* the velocity that leads from q0 to q1, from another time on */
        double v0[N], defect = 1.0;
        memcpy(x, x + 2 * N, 2 * N * sizeof *x);
        memcpy(expected, x, sizeof expected);
        CHECK(dal_flow_apply(flow, h, 2.0 * h, x, NULL) == 0);
        CHECK(dal_exact_velocity(flow, h, h, expected, x, v0, &defect) == 0);
        CHECK_NEAR(largest_difference(N, v0, expected + N), 0.0, 1e-10);
        CHECK_NEAR(defect, 0.0, 1e-10);
        release(flow);
    }
}

static void test_chart(const variety *a)
{
    const double t = 0.8, h = 0.05;
    const size_t y = 1;
    dal_system *const system = open_skate(a, 0);
    dal_mechanics *const mechanics = open_mechanics(system);
    double x[2 * N], z[2 * N], xi[2 * N - 1], xidot[2 * N - 1], xdot[2 * N], A[2], B, J[2 * N * 5];
    double hor[N], ver[N], lambda, condition;
    int changed;
    dal_chart *const chart = open_chart(system);
    state_at(&a->s, t, x);
    const double psi = x[2] + a->s.turn * t;
    CHECK(dal_chart_choose(chart, t, &y, x) == 0 && dal_chart_drop(chart, x, xi) == 0);
    CHECK(dal_chart_connection(chart, t, x, A, &B) == 0);
    CHECK_NEAR(A[0], -tan(psi), 1e-14);
    CHECK_NEAR(B, -cos(psi), 1e-15);
    CHECK(dal_chart_condition(chart, t, x, &condition) == 0);
    CHECK_NEAR(condition, hypot(1.0, tan(psi)), 1e-13);
    CHECK(dal_chart_renew(chart, t, x, &changed) == 0 && !changed);
    CHECK(dal_chart_lift(chart, t, xi, z) == 0);
    CHECK_NEAR(largest_difference(2 * N, x, z), 0.0, 1e-15);
    CHECK(dal_chart_split(chart, t, x, hor, ver) == 0 && fabs(ver[1]) < 1e-15);
    CHECK(dal_chart_jacobian(chart, t, xi, J, NULL) == 0);
    CHECK_NEAR(J[(N + 1) * 5 + 3], tan(psi), 1e-14);
    CHECK(dal_chart_multipliers(chart, t, x, (double[]){2.0}, &lambda) == 0);
    CHECK_NEAR(lambda, -2.0 * cos(psi), 1e-15);
    CHECK(dal_chart_multipliers_back(chart, t, x, (double[]){lambda}, &lambda) == 0);
    CHECK_NEAR(lambda, 2.0, 1e-15);
    CHECK(dal_chart_curve(chart, t, x, x, 0.4, z) == 0);
    CHECK_NEAR(largest_difference(2 * N, x, z), 0.0, 1e-15);
    /* the ODE in xi has the derivatives of dal_field */
    CHECK(dal_chart_field(chart, t, xi, xidot) == 0 && dal_field(mechanics, t, x, xdot) == 0);
    CHECK_NEAR(largest_difference(N, xidot, xdot), 0.0, 1e-15);
    CHECK_NEAR(xidot[3], xdot[3], 1e-13);
    CHECK_NEAR(xidot[4], xdot[5], 1e-13);
    /* a step in them is that of the stepper */
    const dal_scheme scheme = {.name = "0.3", .beta = 0.3};
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    CHECK(dal_stepper_start(stepper, t, h, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_step(stepper, NULL) == 0 && dal_chart_step(chart, t, 0.3, h, xi, NULL) == 0);
    CHECK(dal_chart_lift(chart, t + h, xi, z) == 0);
    CHECK_NEAR(largest_difference(2 * N, dal_stepper_state(stepper), z), 0.0, 1e-14);
}

/* Between rows of the exact solution, also of those of kept nodes: in D of their own time, with an
 * error of order 4. */
static void test_interpolation(const variety *a)
{
    enum { ROWS = 9, TIMES = 5 };
    dal_system *const system = open_skate(a, 0);
    dal_mechanics *const mechanics = open_mechanics(system);
    dal_chart *const chart = open_chart(system);
    for (double shift = 0.0; shift < 0.03; shift += 0.02) {
        double worst[2] = {0.0, 0.0};
        for (int k = 0; k < 2; k++) {
            const double h = k ? 0.05 : 0.1;
            double x0[2 * N], x[ROWS][2 * N], out[TIMES][2 * N], times[TIMES], expected[2 * N];
            state_at(&a->s, 0.0, x0);
            for (size_t row = 0; row < ROWS; row++) {
                CHECK(dal_system_exact(system, (double)row * h, x0, x[row]) == 0);
                for (size_t i = 0; i < N; i++) x[row][i] += shift * x[row][N + i];
            }
            for (size_t j = 0; j < TIMES; j++) times[j] = h * (1.3 + 1.41 * (double)j);
            CHECK(dal_chart_interpolate(chart, 0.0, h, shift, ROWS, x[0], TIMES, times, out[0],
                                        NULL, NULL) == 0);
            for (size_t j = 0; j < TIMES; j++) {
                CHECK(residual_at(mechanics, times[j], shift, out[j]) <= 4.0 * N * U);
                CHECK(dal_system_exact(system, times[j], x0, expected) == 0);
                for (size_t i = 0; i < N; i++) out[j][i] -= shift * out[j][N + i];
                worst[k] = fmax(worst[k], largest_difference(2 * N, out[j], expected));
            }
        }
        CHECK(worst[0] < 1e-3 && worst[1] < worst[0] / 8.0);
    }
}

/* ---- steps ---------------------------------------------------------------------------------- */

/* The equations of one beta-step from x at t to z, written out for the skate: what is left of them
 * where lambda is its mean reaction. */
static double left_of_step(const variety *a, double t, double beta, double h, const double *x,
                           const double *z, double lambda)
{
    const skate *const s = &a->s;
    const double E0 = exp(s->growth * t), E1 = exp(s->growth * (t + h));
    const double *const v = x + N, *const w = z + N;
    double mu[N], worst = 0.0, mean[N], q[N];
    for (size_t i = 0; i < N; i++) {
        q[i] = x[i] + (1.0 - beta) * h * v[i];
        mean[i] = 0.5 * (v[i] + w[i]);
        worst = fmax(worst, fabs(z[i] - q[i] - beta * h * w[i]));
    }
    constraint(t + (1.0 - beta) * h, q, mean, NULL, mu, NULL, NULL, (void *)s);
    for (size_t i = 0; i < N; i++) {
        const double push = i == 0 ? m * ((1.0 - beta) * E1 * gravity(t + h)
                                          + beta * E0 * gravity(t)) : 0.0;
        worst = fmax(worst, fabs(mass[4 * i] * (E1 * w[i] - E0 * v[i]) - h * push
                                 - h * mu[i] * lambda));
    }
    return worst;
}

/* Small ones and large, some of which only the full Newton iteration makes. */
static size_t test_one_step(const variety *a)
{
    static const double betas[] = {0.0, 0.3, 0.5, 1.0}, sizes[] = {0.1, 1.2};
    const double t = 0.8;
    size_t full = 0;
    dal_system *const system = open_skate(a, 0);
    for (size_t j = 0; j < 8; j++) {
        const double beta = betas[j / 2], h = sizes[j % 2];
        const dal_scheme scheme = {.name = "beta", .beta = beta};
        double x[2 * N], before[2 * N], lambda;
        dal_stats stats;
        state_at(&a->s, t, x);
        for (way by = 0; by < WAYS; by++) {
            dal_stepper *const stepper = open_stepper_by(by, system, &scheme);
            CHECK(dal_stepper_start(stepper, t, h, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
            for (int step = 0; step < 3; step++) {
                const double now = dal_stepper_time(stepper);
                memcpy(before, dal_stepper_state(stepper), sizeof before);
                if (dal_step(stepper, &lambda)) {
                    CHECK(h > 1.0);
                    break;
                }
                CHECK_NEAR(left_of_step(a, now, beta, h, before, dal_stepper_state(stepper),
                                        lambda), 0.0, h > 1.0 ? 1e-12 : 2e-14);
            }
            dal_stepper_stats(stepper, &stats);
            if (by != BY_MULTIROOT) full += stats.full_newtons;
            release(stepper);
        }
    }
    return full;
}

/* The fused pair (0, 1/2), (1, 1/2): V and mu at the node, in the middle of the step. */
static void test_fused(void)
{
    const variety *const a = &varieties[0];
    const double t = 0.8, h = 0.1;
    dal_system *const system = open_skate(a, 0);
    dal_stepper *const stepper = open_named(system, "leapfrog");
    double x[2 * N], q[N], mu[N], lambda;
    state_at(&a->s, t, x);
    CHECK(dal_stepper_start(stepper, t, h, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_step(stepper, &lambda) == 0);
    const double *const z = dal_stepper_state(stepper);
    for (size_t i = 0; i < N; i++) q[i] = x[i] + 0.5 * h * x[N + i];
    constraint(t + 0.5 * h, q, x + N, NULL, mu, NULL, NULL, (void *)&a->s);
    for (size_t i = 0; i < N; i++)
        CHECK_NEAR(mass[4 * i] * (z[N + i] - x[N + i]),
                   h * mu[i] * lambda + (i == 0 ? h * m * gravity(t + 0.5 * h) : 0.0), 1e-14);
}

/* The states of a long run lie in the D of their own time, late and early, whoever makes the steps,
 * which give the same; all compilations the same bits. */
static void test_runs(const variety *a)
{
    static const char *const names[] = {"explicit", "midpoint", "endpoint", "leapfrog-mirror",
                                        "leapfrog", "midpoint-kl6", "leapfrog-yoshida4",
                                        "midpoint-nodes"};
    static const double starts[] = {0.0, -3.0, 1000.1};
    enum { STEPS = 300 };
    const double h = 0.013;
    dal_system *const system = open_skate(a, 0);
    dal_mechanics *const mechanics = open_mechanics(system);
    for (size_t j = 0; j < sizeof names / sizeof *names; j++)
        for (size_t k = 0; k < sizeof starts / sizeof *starts; k++) {
            if (a->s.growth != 0.0 && starts[k] > 100.0) continue; /* the mass */
            const dal_scheme scheme = find_scheme(names[j]);
            const bool kept = scheme.nodes == DAL_KEPT_NODES;
            double end[WAYS][2 * N], x[2 * N];
            state_at(&a->s, starts[k], x);
            for (way by = 0; by < WAYS; by++) {
                dal_stepper *const stepper = open_stepper_by(by, system, &scheme);
                double worst = 0.0;
                CHECK(dal_stepper_start(stepper, starts[k], h, x, DAL_CHECK,
                                        kept ? DAL_INITIAL_PROJECT : DAL_INITIAL_NONE) == 0);
                for (size_t step = 0; step < STEPS; step++) {
                    need(dal_step(stepper, NULL), names[j], dal_stepper_error(stepper)->text);
                    worst = fmax(worst, residual_at(mechanics, dal_stepper_time(stepper),
                                                    kept ? 0.5 * h : 0.0,
                                                    dal_stepper_state(stepper)));
                }
                CHECK(worst <= 4.0 * N * U);
                memcpy(end[by], dal_stepper_state(stepper), sizeof end[by]);
                release(stepper);
            }
            CHECK(memcmp(end[BY_LIBRARY], end[BY_ANY_SIZES], sizeof *end) == 0);
            CHECK_NEAR(largest_difference(2 * N, end[BY_LIBRARY], end[BY_MULTIROOT]), 0.0, 1e-10);
        }
}

/* The two that say the same take the same steps. */
static void test_same_steps(void)
{
    double x[2 * N], end[2][2 * N];
    for (int k = 0; k < 2; k++) {
        dal_system *const system = open_skate(&varieties[k], 0);
        dal_stepper *const stepper = open_named(system, "midpoint-kl6");
        state_at(&varieties[k].s, 0.5, x);
        CHECK(dal_stepper_start(stepper, 0.5, 0.05, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(stepper, 100, NULL, NULL) == 0);
        memcpy(end[k], dal_stepper_state(stepper), sizeof end[k]);
        release(system);
    }
    CHECK_NEAR(largest_difference(2 * N, end[0], end[1]), 0.0, 1e-11);
}

/* Orders of q, v, lambda, with the exact solution and with the flow, from another time on. */
static void test_orders(const variety *a)
{
    static const char *const names[] = {"explicit", "midpoint", "leapfrog", "leapfrog-mirror",
                                        "midpoint-kl6", "leapfrog-kl6", "midpoint-nodes"};
    static const size_t coarse[] = {6, 9, 12, 18, 24, 36}, fine[] = {20, 30, 40, 60, 80, 120};
    dal_system *const system = open_skate(a, 0);
    for (size_t j = 0; j < sizeof names / sizeof *names; j++)
        for (int late = 0; late < 2; late++) {
            const dal_scheme scheme = find_scheme(names[j]);
            double x[2 * N];
            dal_order_point points[6];
            dal_order order = {0};
            dal_error error = {0};
            const double t0 = late ? 0.7 : 0.0;
            state_at(&a->s, t0, x);
            const dal_order_def def = {
                .t0 = t0, .t_end = t0 + 1.0, .x0 = x, .count = 6,
                .steps = scheme.order > 2 ? coarse : fine,
                .initial = scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_PROJECT : DAL_INITIAL_NONE};
            need(dal_order_study(system, &scheme, &def, points, &order, &error), names[j],
                 error.text);
            CHECK(order.holds == 1);
            if (order.holds != 1)
                fprintf(stderr, "%s, %s, t0 = %g: %s\n", a->name, names[j], t0, order.text);
            CHECK(scheme.nodes == DAL_KEPT_NODES ? order.keeps_D_eps : order.keeps_D);
            CHECK(order.global_multipliers.slope > scheme.order - 0.2);
            CHECK(order.reference < 1e-11 && (late || scheme.nodes == DAL_KEPT_NODES
                                              || order.reference == 0.0));
        }
}

/* ---- pairs of nodes ------------------------------------------------------------------------- */

/* The map of pairs is the beta-step; what it evaluates, it evaluates at the times of the pair. */
static void test_discrete(const variety *a, double alpha, double beta)
{
    const double t = 0.8, h = 0.1;
    dal_system *const system = open_skate(a, 0);
    const dal_difference_map of_L = {.beta = alpha}, of_D = {.beta = beta};
    dal_discrete *const d = open_discrete(system, of_L, &of_D);
    double x[2 * N], y[2 * N], q0[N], q1[N], lambda, phi, plus[N], minus[N], mu[N], D1[N], D2[N];
    double L, L_d, g[N], residual[N + 1];
    state_at(&a->s, t, x);
    CHECK(dal_discrete_nodes(d, t, h, x, q0, q1) == 0);
    CHECK(dal_discrete_constraint(d, t, h, q0, q1, &phi, NULL, NULL) == 0 && fabs(phi) < 1e-14);
    CHECK(dal_discrete_momenta(d, t, h, q0, q1, NULL, plus) == 0);
    for (size_t i = 0; i < N; i++) g[i] = (1.0 - alpha) * q0[i] + alpha * q1[i];
    const double of_pair = t + (alpha - beta) * h;
    CHECK(dal_discrete_lagrangian(d, t, h, q0, q1, &L_d, D1, D2, NULL) == 0);
    if (a->general) {
        lagrangian(of_pair, g, x + N, &L, NULL, NULL, NULL, NULL, NULL, NULL, (void *)&a->s);
    } else {
        potential(of_pair, g, &L, NULL, NULL, NULL);
        L = 0.5 * (m * (x[3] * x[3] + x[4] * x[4]) + J * x[5] * x[5]) - L;
    }
    CHECK_NEAR(L_d, h * L, 1e-14);
    CHECK_NEAR(largest_difference(N, D2, plus), 0.0, 1e-14);
    memcpy(y, x, sizeof x);
    CHECK(dal_discrete_advance(d, t, h, y, &lambda) == 0);
    if (alpha == beta) CHECK_NEAR(left_of_step(a, t, beta, h, x, y, lambda), 0.0, 1e-13);
    double after[N], node[N], mean[N];
    memcpy(node, q1, sizeof node);
    CHECK(dal_discrete_step(d, t, h, q0, q1, &lambda) == 0);
    memcpy(after, q1, sizeof after);
    CHECK(dal_discrete_constraint(d, t + h, h, node, after, &phi, NULL, NULL) == 0);
    CHECK_NEAR(phi, 0.0, 1e-13);
    CHECK(dal_discrete_momenta(d, t + h, h, node, after, minus, NULL) == 0);
    for (size_t i = 0; i < N; i++) mean[i] = 0.5 * (x[N + i] + y[N + i]);
    constraint(t + (1.0 - beta) * h, node, mean, NULL, mu, NULL, NULL, (void *)&a->s);
    for (size_t i = 0; i < N; i++) CHECK_NEAR(minus[i] - plus[i], h * mu[i] * lambda, 1e-13);
    CHECK(dal_discrete_nodes(d, t, h, x, q0, q1) == 0);
    CHECK(dal_discrete_residual(d, t, h, q0, q1, after, &lambda, residual) == 0);
    CHECK_NEAR(sum_of_sizes(N + 1, residual), 0.0, 1e-13);
    /* the scheme of two maps */
    char name[32];
    snprintf(name, sizeof name, "pair:%g:%g", alpha, beta);
    const dal_scheme scheme = find_scheme(name);
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    CHECK(dal_stepper_start(stepper, t, h, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_step(stepper, NULL) == 0);
    CHECK_NEAR(largest_difference(2 * N, dal_stepper_state(stepper), y), 0.0, 1e-13);
    /* a run is these steps; its first pair has to lie in the D_d of its own time */
    double nodes[4 * N], matrix[(N + 1) * (N + 1)];
    memcpy(nodes, q0, sizeof q0);
    memcpy(nodes + N, q1, sizeof q1);
    CHECK(dal_discrete_run(d, 0.0, h, 2, nodes, NULL, NULL) == DAL_EOFFD);
    CHECK(dal_discrete_run(d, t, h, 2, nodes, NULL, NULL) == 0);
    CHECK_NEAR(largest_difference(N, nodes + 2 * N, after), 0.0, 1e-13);
    CHECK(dal_discrete_constraint(d, t + 2.0 * h, h, nodes + 2 * N, nodes + 3 * N, &phi, NULL, NULL)
          == 0);
    CHECK_NEAR(phi, 0.0, 1e-13);
    CHECK(dal_discrete_regularity(d, t, h, q1, after, matrix, NULL, NULL, NULL) == 0);
    if (a->kind != DAL_NONLINEAR)
        for (size_t i = 0; i < N; i++) CHECK_NEAR(matrix[i * (N + 1) + N], mu[i], 1e-15);
}

/* ---- deformations --------------------------------------------------------------------------- */

/* g = t^2 sin(q_0) v_2. */
static int swing(double t, const double *q, const double *v, double *g, double *g_v, double *g_q,
                 double *g_t, void *ctx)
{
    if (g) *g = t * t * sin(q[0]) * v[2];
    if (g_v) memcpy(g_v, (double[]){0.0, 0.0, t * t * sin(q[0])}, N * sizeof *g_v);
    if (g_q) memcpy(g_q, (double[]){t * t * cos(q[0]) * v[2], 0.0, 0.0}, N * sizeof *g_q);
    if (g_t) *g_t = 2.0 * t * sin(q[0]) * v[2];
    return 0;
}

static void test_deformed(const variety *a)
{
    const double t = 0.8;
    dal_system *const base = open_skate(a, 0);
    double lambda[3], x[2 * N];
    for (int k = 0; k < 3; k++) {
        dal_system *system = NULL;
        dal_check check;
        system = k == 2 ? open_deformed_nodes(base, 0.1)
                        : open_deformed(base, swing, NULL, 0.3, a->kind, k ? DAL_MISSING_PHI_T : 0);
        dal_mechanics *const mechanics = open_mechanics(system);
        state_at(&a->s, t, x);
        CHECK(dal_project(mechanics, t, 0.0, x, NULL) == 0);
        CHECK(dal_system_check(system, t, x, &check, NULL) == 0 && check.passed);
        CHECK(check.phi_t.checked == (k != 1) && check.phi_t.error < 1e-8);
        CHECK(dal_multipliers(mechanics, t, x, &lambda[k]) == 0);
        release(system);
    }
    CHECK_NEAR(lambda[0], lambda[1], 1e-10);
}

/* ---- the check, and what is refused ---------------------------------------------------------- */

static void test_check(const variety *a)
{
    variety b = *a;
    dal_check check;
    double x[2 * N];
    const double t = 0.8;
    state_at(&a->s, t, x);
    for (int wrong = 0; wrong < 4; wrong++) {
        dal_system_def def = definition(&b, 0);
        b.s = a->s;
        if (wrong == 1) b.s.blind_phi = 1e-3;
        if (wrong == 2) b.s.blind_L = 1e-3;
        if (wrong == 3) def.time_dependent = 0;
        dal_system *const system = new_system(&def);
        CHECK(dal_system_check(system, t, x, &check, NULL) == 0);
        CHECK(check.passed == (wrong == 0 || (wrong == 2 && !a->general)));
        if (wrong == 0) CHECK(check.phi_t.checked && check.L_vt.checked == a->general);
        if (wrong == 1) CHECK(strstr(check.finding.text, "phi_t[0,0]") && check.phi_t.wrong);
        if (wrong == 2 && a->general)
            CHECK(strstr(check.finding.text, "L_vt[") && check.L_vt.wrong);
        if (wrong == 3) CHECK(strstr(check.finding.text, "declare the system time_dep") != NULL);
        release(system);
    }
}

/* Each callback alone is seen to depend on time. */
static int still_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                            double *phi_q, double *phi_t, void *ctx)
{
    return constraint(0.0, q, v, phi, phi_v, phi_q, phi_t, ctx);
}

static void test_undeclared(void)
{
    static const char *const words[] = {"potential returns", "constraint returns",
                                        "lagrangian returns"};
    double x[2 * N];
    for (int k = 0; k < 4; k++) {
        const variety *const a = &varieties[k < 2 ? 0 : 4];
        dal_system_def def = definition(a, 0);
        dal_check check;
        def.time_dependent = 0;
        if (k != 1) def.constraint = still_constraint;
        if (k == 1 || k == 3) { /* mu alone; or nothing */
            def.mass = mass;
            def.lagrangian = NULL;
            def.potential = NULL;
        }
        dal_system *const system = new_system(&def);
        state_at(&a->s, 0.0, x);
        CHECK(dal_system_check(system, 0.0, x, &check, NULL) == 0 && check.passed == (k == 3));
        if (k < 3) CHECK(strncmp(check.finding.text, words[k], strlen(words[k])) == 0);
        release(system);
    }
}

/* V = -50 t q. */
static int pull(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    if (V) *V = -50.0 * t * q[0];
    if (V_q) *V_q = -50.0 * t;
    if (V_qq) *V_qq = 0.0;
    return 0;
}

/* Nothing is told of an energy that changes as it has to. */
static void test_energy(void)
{
    const dal_system_def def = {.n = 1, .mass = (double[]){1.0}, .potential = pull,
                                .time_dependent = 1};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = start_named(system, "midpoint", 0.01, (double[]){1.0, 0.0});
    CHECK(dal_advance(stepper, 128, NULL, NULL) == 0);
    const dal_stats stats = stats_of(stepper);
    CHECK(dal_stepper_state(stepper)[1] > 40.0 && stats.jump_step == 0);
}

static void test_refused(void)
{
    const variety *const a = &varieties[0];
    dal_system_def def = definition(a, 0);
    dal_system *system = NULL;
    dal_error error;
    def.steady = DAL_STEADY_DECLARED;
    CHECK(dal_system_new(&system, &def, &error) == DAL_EINVAL && strstr(error.text, "on time"));
    def = definition(a, DAL_MISSING_PHI_T);
    def.time_dependent = 0;
    CHECK(dal_system_new(&system, &def, &error) == DAL_EINVAL && strstr(error.text, "0x100"));
    def = definition(a, DAL_MISSING_L_VT);
    CHECK(dal_system_new(&system, &def, &error) == DAL_EINVAL && strstr(error.text, "lagrangian"));
    def = definition(a, 0);
    def.time_dependent = 2;
    CHECK(dal_system_new(&system, &def, &error) == DAL_EINVAL && strstr(error.text, "= 2"));
    system = open_skate(a, 0);
    const dal_scheme scheme = find_scheme("midpoint");
    const dal_embedding_def embedding = {.scheme = &scheme, .h = 0.1};
    dal_embedding *none = NULL;
    CHECK(dal_embedding_new(&none, system, &embedding, &error) == DAL_EUNSUPPORTED);
    CHECK(strstr(error.text, "depends on time") != NULL);
    /* times that are not finite */
    double x[2 * N], out[9];
    dal_mechanics *const mechanics = open_mechanics(system);
    state_at(&a->s, 0.0, x);
    CHECK(dal_energy(mechanics, NAN, x, out) == DAL_EINVAL);
    CHECK(dal_metric(mechanics, INFINITY, x, out) == DAL_EINVAL);
    CHECK(dal_residual(mechanics, NAN, 0.0, x, out) == DAL_EINVAL);
    CHECK(dal_project(mechanics, NAN, 0.0, x, out) == DAL_EINVAL);
    CHECK(dal_system_invariant(system, NAN, x, out) == DAL_EINVAL);
    dal_check check;
    CHECK(dal_system_check(system, NAN, x, &check, &error) == DAL_EINVAL);
}

int main(void)
{
    for (size_t k = 0; k < VARIETIES; k++) {
        const variety *const a = &varieties[k];
        test_mechanics(a);
        test_projections(a);
        test_flow(a);
        test_chart(a);
        test_interpolation(a);
        const size_t full = test_one_step(a);
        if (k == 0) CHECK(full > 0);
        test_runs(a);
        test_orders(a);
        for (double alpha = 0.0; alpha <= 1.0; alpha += 0.5)
            test_discrete(a, alpha, 0.5);
        test_discrete(a, 0.3, 0.3);
        test_deformed(a);
        test_check(a);
    }
    test_fused();
    test_same_steps();
    test_undeclared();
    test_energy();
    test_refused();
    return check_done();
}
