/* own_system.c - a user-defined system: a cart with two wheels on an incline.
 *
 * q = (x, y, phi, left, right): the middle of the axle, which is the centre of mass, with x
 * downhill; the heading; the rotation angles of the wheels.
 *
 *     L = m (v_x^2 + v_y^2)/2 + J v_phi^2/2 + I (v_left^2 + v_right^2)/2 + m g x
 *     -sin(phi) v_x + cos(phi) v_y                       = 0    the wheels do not slip sideways
 *      cos(phi) v_x + sin(phi) v_y - b v_phi - R v_left  = 0    nor along their planes
 *      cos(phi) v_x + sin(phi) v_y + b v_phi - R v_right = 0
 *     q = 0, v = (0, 0, w, -b w/R, b w/R) at t = 0: it turns on the spot and is released
 *
 * First integrals: the energy, v_phi, and R (right - left) - 2 b phi.  The exact motion is a
 * cycloid.  With a = g m/(m + 2 I/R^2) the cart never rolls down by more than a/(2 w^2); it drifts
 * sideways by pi a/w^2 in each turn.
 *
 * Prints the findings of dal_system_check, these two lengths for ten turns beside the exact ones,
 * and the errors of energy, first integrals and constraints.
 *
 *     cc own_system.c $(pkg-config --cflags --libs dalembert) -o own_system && ./own_system
 */
#include <dalembert/geometry.h>
#include <dalembert/inspect.h>
#include <math.h>
#include <stdio.h>

enum { N = 5, M = 3, TURNS = 10, STEPS_A_TURN = 200, STEPS = TURNS * STEPS_A_TURN };

/* m and J of the whole cart, I and R of a wheel.  b is half the length of the axle.  g is the
 * downhill part of the acceleration of gravity. */
typedef struct cart {
    double m, J, I, R, b, g;
} cart;

static int potential(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const cart *const c = ctx;
    if (V) *V = -c->m * c->g * q[0];
    if (V_q) {
        for (int i = 0; i < N; i++) V_q[i] = 0.0;
        V_q[0] = -c->m * c->g;
    }
    if (V_qq)
        for (int i = 0; i < N * N; i++) V_qq[i] = 0.0;
    return 0;
}

static int constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    const cart *const c = ctx;
    const double sine = sin(q[2]), cosine = cos(q[2]);
    const double mu[M * N] = {
        -sine,  cosine, 0.0,   0.0,   0.0,
        cosine, sine,   -c->b, -c->R, 0.0,
        cosine, sine,   c->b,  0.0,   -c->R,
    };
    for (int a = 0; phi && a < M; a++) {
        phi[a] = 0.0;
        for (int i = 0; i < N; i++) phi[a] += mu[a * N + i] * v[i];
    }
    for (int k = 0; phi_v && k < M * N; k++) phi_v[k] = mu[k];
    if (phi_q) { /* only the heading enters */
        for (int k = 0; k < M * N; k++) phi_q[k] = 0.0;
        phi_q[0 * N + 2] = -cosine * v[0] - sine * v[1];
        phi_q[1 * N + 2] = phi_q[2 * N + 2] = -sine * v[0] + cosine * v[1];
    }
    return 0;
}

static int invariant(double t, const double *x, double *values, void *ctx)
{
    const cart *const c = ctx;
    values[0] = x[N + 2];
    values[1] = c->R * (x[4] - x[3]) - 2.0 * c->b * x[2];
    return 0;
}

/* The largest |value - first value|. */
static double off(const double *values)
{
    double most = 0.0;
    for (int k = 1; k <= STEPS; k++) most = fmax(most, fabs(values[k] - values[0]));
    return most;
}

int main(void)
{
    cart c = {.m = 2.0, .J = 0.3, .I = 0.05, .R = 0.25, .b = 0.4, .g = 1.5};
    const double pi = acos(-1.0), w = 1.25, h = 2.0 * pi / (w * STEPS_A_TURN);
    const double mass[N * N] = {[0] = c.m, [6] = c.m, [12] = c.J, [18] = c.I, [24] = c.I};
    const double x0[2 * N] = {[N + 2] = w, [N + 3] = -c.b * w / c.R, [N + 4] = c.b * w / c.R};
    const char *const coordinates[N] = {"x", "y", "phi", "left", "right"};
    const char *const invariants[] = {"v_phi", "R (right - left) - 2 b phi"};
    const dal_system_def def = {
        .n = N, .m = M, .mass = mass, .potential = potential, .constraint = constraint, .ctx = &c,
        .name = "cart", .coordinates = coordinates, .state = x0,
        .invariants = 2, .invariant_names = invariants, .invariant = invariant,
    };
    static double x[STEPS + 1][2 * N], energy[STEPS + 1], residual[STEPS + 1];
    static double v_phi[STEPS + 1], slip[STEPS + 1];
    dal_system *system;
    dal_mechanics *mechanics;
    dal_scheme scheme;
    dal_stepper *stepper;
    dal_check check;
    dal_error error;
    if (dal_system_new(&system, &def, &error) || dal_system_check(system, 0.0, x0, &check, &error)
        || dal_mechanics_new(&mechanics, system, &error)
        || dal_scheme_find(&scheme, "leapfrog", &error)
        || dal_stepper_new(&stepper, system, &scheme, NULL, &error)) {
        fprintf(stderr, "%s\n", error.text);
        return 1;
    }
    printf("check: %s\n", check.finding.text);
    if (!check.passed) return 1;

    if (dal_stepper_start(stepper, 0.0, h, x0, DAL_CHECK, DAL_INITIAL_NONE)
        || dal_integrate(stepper, STEPS, 1, x[0], NULL, NULL, NULL, NULL)
        || dal_trajectory(mechanics, 0.0, h, 0.0, STEPS + 1, x[0], NULL, energy, NULL, NULL,
                          residual, NULL)) {
        fprintf(stderr, "%s%s\n", dal_stepper_error(stepper)->text,
                dal_mechanics_error(mechanics)->text);
        return 1;
    }
    double lowest = 0.0, worst = 0.0;
    for (int k = 0; k <= STEPS; k++) {
        double values[2];
        if (dal_system_invariant(system, 0.0, x[k], values)) return 1;
        v_phi[k] = values[0];
        slip[k] = values[1];
        lowest = fmax(lowest, x[k][0]);
        worst = fmax(worst, residual[k]);
    }
    const double a = c.g * c.m / (c.m + 2.0 * c.I / (c.R * c.R));
    printf("rolls down by up to  %.6f, exactly %.6f\n", lowest, a / (2.0 * w * w));
    printf("drifts in %d turns   %.6f, exactly %.6f\n", TURNS, x[STEPS][1],
           TURNS * pi * a / (w * w));
    printf("energy               %.6f, off by %.3e\n", energy[0], off(energy));
    printf("v_phi                %.6f, off by %.1e\n", v_phi[0], off(v_phi));
    printf("R (right - left) - 2 b phi    off by %.1e\n", off(slip));
    printf("worst residual of D  %.1e\n", worst);

    dal_stepper_free(stepper);
    dal_mechanics_free(mechanics);
    dal_system_free(system);
    return 0;
}
