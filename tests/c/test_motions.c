/* Motions of the built-in systems that mechanics knows without their equations: relative
 * equilibria, one body in two sets of coordinates, velocities from positions. */
#include "check.h"
#include "fixtures.h"

static const double two_pi = 6.28318530717958647693;

static dal_system *open_trailers(double trailers)
{
    static const char *const names[] = {"trailers", "d", "m", "J"};
    return open_builtin("n_trailer", 4, names, (const double[]){trailers, 0.8, 1.3, 0.4});
}

/* x[2n] <- the state a time t later, by the reference flow. */
static void flow_by(const dal_system *system, double t, double *x)
{
    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-13);
    need(dal_flow_apply(flow, 0.0, t, x, NULL), "flow", dal_flow_error(flow)->text);
}

/* The error per unit of time that a tolerance of 1e-13 leaves, with a margin of 10. */
static const double flow_tolerance = 1e-12;

/* The default data of the disc: the centre goes round the origin on a circle of radius
 * r (1/rho - sin(beta)), with constant lean and spin, for any inertia. */
static void test_steady_circle(void)
{
    static const char *const names[] = {"m", "r", "A", "C", "g"};
    static const double sets[3][5] = {{0.3048, 0.05, 1.905e-4, 3.81e-4, 9.81},
                                      {1.6, 0.7, 0.4, 0.9, 2.1},
                                      {1.0, 1.0, 0.2, 0.3, 0.0}};
    for (size_t k = 0; k < 3; k++) {
        dal_system *system = open_builtin("rolling_disc", 5, names, sets[k]);
        double start[10];
        need(dal_system_state(system, start), "rolling_disc", "");
        const double r = sets[k][1], lean = start[3], yaw = start[7], spin = start[9];
        const double radius = r * (10 - sin(lean));
        CHECK_NEAR(lean, two_pi / 72, DAL_ROUNDOFF);
        CHECK(k == 2 ? spin == 0.0 : spin > 0.0); /* no weight, no motion */
        if (k == 0) CHECK_NEAR(spin, 10.7364981632612, 1e-13);
        const double period = k == 2 ? 1.0 : two_pi / fabs(yaw);
        for (int part = 1; part <= 4; part++) {
            const double t = part * period / 4, alpha = yaw * t;
            const double c = cos(alpha), s = sin(alpha), speed = -yaw * radius;
            const double circle[10] = {-radius * s, radius * c, alpha, lean, spin * t,
                                       speed * c, speed * s, yaw, 0.0, spin};
            double x[10];
            memcpy(x, start, sizeof x);
            flow_by(system, t, x);
            const double scale = (1 + t) * (1 + spin);
            CHECK_NEAR(x[3], lean, 1e-12);
            CHECK_NEAR(largest_difference(10, x, circle), 0.0, flow_tolerance * scale);
        }
        release(system);
    }
}

/* The sleigh by its centre of mass and by its blade: one motion, energy and reaction. */
static void test_two_points_of_the_sleigh(void)
{
    static const char *const names[] = {"m", "J", "a"};
    static const double sets[3][3] = {{1.5, 0.8, 0.4}, {0.6, 1.7, -0.9}, {1.0, 1.0, 1.0}};
    for (size_t k = 0; k < 3; k++) {
        dal_system *centre = open_builtin("sleigh", 3, names, sets[k]);
        dal_system *blade = open_builtin("sleigh_contact", 3, names, sets[k]);
        dal_mechanics *of_centre = open_mechanics(centre), *of_blade = open_mechanics(blade);
        const double a = sets[k][2];
        for (double t = 0.0; t < 5.0; t += 1.25) {
            double x[6], y[6], z[6], E[2], lambda[2];
            need(dal_system_state(centre, x), "sleigh", "");
            need(dal_system_state(blade, y), "sleigh_contact", "");
            need(dal_system_exact(centre, t, x, x), "sleigh", "");
            memcpy(z, y, sizeof z);
            flow_by(blade, t, z);
            need(dal_system_exact(blade, t, y, y), "sleigh_contact", "");
            CHECK_NEAR(largest_difference(6, y, z), 0.0, flow_tolerance * (1 + t));
            CHECK(dal_energy(of_centre, 0.0, x, &E[0]) == DAL_SUCCESS);
            CHECK(dal_energy(of_blade, 0.0, y, &E[1]) == DAL_SUCCESS);
            CHECK_NEAR(E[0], E[1], 64 * U * E[0]);
            CHECK(dal_multipliers(of_centre, 0.0, x, &lambda[0]) == DAL_SUCCESS);
            CHECK(dal_multipliers(of_blade, 0.0, y, &lambda[1]) == DAL_SUCCESS);
            CHECK_NEAR(lambda[0], lambda[1], 64 * U * (1 + fabs(lambda[0])));
            const double c = cos(y[2]), s = sin(y[2]);
            const double moved[6] = {y[0] + a * c, y[1] + a * s, y[2], y[3] - a * s * y[5],
                                     y[4] + a * c * y[5], y[5]};
            CHECK_NEAR(largest_difference(6, x, moved), 0.0, 64 * U * (1 + sum_of_sizes(6, x)));
        }
        release(centre);
    }
}

enum { MOST_AXLES = 51 };

/* Where the axles stand a time *t after the state x, if the coordinates went on uniformly. */
typedef struct train {
    size_t trailers;
    double d;
    const double *x;
} train;

static int axles(const double *t, double *xy, void *ctx)
{
    const train *all = ctx;
    const size_t n = all->trailers + 3;
    const double *q = all->x, *v = all->x + n;
    xy[0] = q[0] + *t * v[0];
    xy[1] = q[1] + *t * v[1];
    for (size_t i = 1; i <= all->trailers; i++) {
        const double theta = q[2 + i] + *t * v[2 + i];
        xy[2 * i] = xy[2 * i - 2] - all->d * cos(theta);
        xy[2 * i + 1] = xy[2 * i - 1] - all->d * sin(theta);
    }
    return 0;
}

/* Constraints and Lagrangian from the positions of the axles, differenced in time. */
static void test_axles(void)
{
    static const double counts[] = {1, 3, 10, 50};
    for (size_t k = 0; k < sizeof counts / sizeof counts[0]; k++) {
        dal_system *system = open_trailers(counts[k]);
        const size_t n = dal_system_n(system), m = dal_system_m(system);
        const double mass = dal_system_parameter(system, 2), J = dal_system_parameter(system, 3);
        double x[2 * (MOST_AXLES + 2)], phi[MOST_AXLES], value[2 * MOST_AXLES];
        double velocity[2 * MOST_AXLES], t = 0.0, L = NAN, sum = 0.0;
        unsigned seed = 3;
        for (size_t i = 0; i < 2 * n; i++) x[i] = next_number(&seed);
        train all = {n - 3, dal_system_parameter(system, 1), x};
        dal__difference(axles, &all, &t, 0, 2 * m, value, velocity, 1);
        CHECK(m == n - 2 && all.d == 0.8);
        CHECK(system->def.constraint(0.0, x, x + n, phi, NULL, NULL, NULL, system->def.ctx) == 0);
        CHECK(system->def.lagrangian(0.0, x, x + n, &L, NULL, NULL, NULL, NULL, NULL, NULL,
                                     system->def.ctx)
              == 0);
        for (size_t i = 0; i < m; i++) {
            const double vx = velocity[2 * i], vy = velocity[2 * i + 1], turn = x[n + 2 + i];
            /* Differences of sums of i + 1 numbers of size 1: 1e-12 for each. */
            CHECK_NEAR(phi[i], cos(x[2 + i]) * vy - sin(x[2 + i]) * vx, 1e-12 * (double)(i + 1));
            sum += (mass * (vx * vx + vy * vy) + J * turn * turn) / 2;
        }
        CHECK_NEAR(L, sum, 1e-12 * (double)m * (1 + sum));
        release(system);
    }
}

/* A train that turns as a whole: with bends of sin = d turn/speed of the axle before, each axle
 * keeps to a circle about the one centre, and after a turn the train stands where it started. */
static void test_turning_train(void)
{
    static const double counts[] = {1, 3};
    const double turn = 0.5;
    for (size_t k = 0; k < 2; k++) {
        dal_system *system = open_trailers(counts[k]);
        const size_t n = dal_system_n(system);
        const double d = dal_system_parameter(system, 1);
        double x[12] = {0}, y[12], speed = 1.0;
        x[n] = speed;
        x[n + 2] = turn;
        for (size_t i = 1; i <= n - 3; i++) {
            const double bend = asin(d * turn / speed);
            x[2 + i] = x[1 + i] - bend;
            x[n + 2 + i] = turn;
            speed *= cos(bend);
        }
        memcpy(y, x, sizeof y);
        flow_by(system, two_pi / turn, y);
        for (size_t i = 2; i < n; i++) x[i] += two_pi;
        CHECK_NEAR(largest_difference(2 * n, x, y), 0.0, 10 * flow_tolerance * two_pi / turn);
        release(system);
    }
}

/* The ball goes round in the period 2 pi (1 + m a^2/J)/Omega, 7 pi/Omega if it is homogeneous, and
 * its angular momentum about the vertical stays; on a table at rest it goes straight on. */
static void test_ball(void)
{
    static const char *const names[] = {"Omega"};
    for (double Omega = -1.5; Omega <= 1.5; Omega += 1.5) {
        dal_system *system = open_builtin("ball_on_table", 1, names, &Omega);
        double start[10], x[10], y[10];
        need(dal_system_state(system, start), "ball_on_table", "");
        const double period = Omega == 0.0 ? 2.0 : 3.5 * two_pi / fabs(Omega);
        memcpy(x, start, sizeof x);
        flow_by(system, period, x);
        need(dal_system_exact(system, period, start, y), "ball_on_table", "");
        CHECK_NEAR(largest_difference(10, x, y), 0.0, flow_tolerance * (1 + period));
        for (size_t i = 0; i < 2; i++) {
            const double moved = Omega == 0.0 ? period * start[5 + i] : 0.0;
            CHECK_NEAR(y[i], start[i] + moved, 64 * U);
            CHECK_NEAR(y[5 + i], start[5 + i], 64 * U);
        }
        CHECK_NEAR(y[4], start[4] + period * start[9], 64 * U * (1 + period));
        CHECK(y[9] == start[9]);
        release(system);
    }
}

int main(void)
{
    test_steady_circle();
    test_two_points_of_the_sleigh();
    test_axles();
    test_turning_train();
    test_ball();
    return check_done();
}
