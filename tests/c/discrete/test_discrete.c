/* Discrete mechanics on pairs of nodes: maps, L_d and D_d with their derivatives, the DLA
 * equations, the node map and the velocity integrator, and what they conserve.
 *
 * ROUNDOFF is what one step may err by, relative to sum |q| + sum |v| + 1: Newton stops at 4 u,
 * and the conditions of the matrices are below 30 for the states used here.  What passes through
 * the nodes loses u |q|/h instead. */
#include "fixtures.h"
#include "check.h"
#include "discrete/discrete.h"

#define ROUNDOFF (128 * U)

enum { N = 16, M = 8 };

static const char *const all_systems[] = {"particle", "particle_oscillator", "knife_edge", "sleigh",
                                          "disk", "heisenberg", "contact_oscillator", "robot",
                                          "chaotic", "generic4", "uneven_edge"};
enum { SYSTEMS = sizeof all_systems / sizeof all_systems[0] };

static const double betas[] = {0.0, 0.3, 0.5, 1.0};
enum { BETAS = sizeof betas / sizeof betas[0] };

/* ---- rich: a system with everything --------------------------------------------------------
 *   L = (M0 v0^2 + M1 v1^2 + v2^2)/2 + v0 v2/5 + q1 v0 - q0 q2 v1/3 - V,
 *   M0 = 1 + q1^2/4, M1 = 3/2 + sin(q0)/4, V = (q0^2 + 2 q1^2 + 3 q2^2/2)/2 + q0^4/8,
 *   f = (3 sin(t)/10 - v0/10, q0 cos(t)/5, q1 v0/20 - v2/10),
 *   phi = -q1 v0 + sin(q2) v1/3 + (1 + q0^2/10) v2      linear
 *         + 1/5 + q0 q2/10                              affine
 *         + 3 v0^2/20 + q2 v0 v1/10                     nonlinear */

typedef struct rich {
    dal_constraint_kind kind;
} rich;

static int rich_lagrangian(double t, const double *q, const double *v, double *L, double *L_q,
                           double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                           void *ctx)
{
    const double M0 = 1 + q[1] * q[1] / 4, M1 = 1.5 + sin(q[0]) / 4;
    const double V = (q[0] * q[0] + 2 * q[1] * q[1] + 1.5 * q[2] * q[2]) / 2 + pow(q[0], 4) / 8;
    (void)ctx;
    if (L)
        *L = (M0 * v[0] * v[0] + M1 * v[1] * v[1] + v[2] * v[2]) / 2 + v[0] * v[2] / 5
             + q[1] * v[0] - q[0] * q[2] * v[1] / 3 - V;
    if (L_q) {
        L_q[0] = cos(q[0]) * v[1] * v[1] / 8 - q[2] * v[1] / 3 - q[0] - pow(q[0], 3) / 2;
        L_q[1] = q[1] * v[0] * v[0] / 4 + v[0] - 2 * q[1];
        L_q[2] = -q[0] * v[1] / 3 - 1.5 * q[2];
    }
    if (L_v) {
        L_v[0] = M0 * v[0] + v[2] / 5 + q[1];
        L_v[1] = M1 * v[1] - q[0] * q[2] / 3;
        L_v[2] = v[2] + v[0] / 5;
    }
    if (L_qq) {
        const double a = -sin(q[0]) * v[1] * v[1] / 8 - 1 - 1.5 * q[0] * q[0], b = -v[1] / 3;
        memcpy(L_qq, (double[]){a, 0, b, 0, v[0] * v[0] / 4 - 2, 0, b, 0, -1.5}, 9 * sizeof a);
    }
    if (L_vq)
        memcpy(L_vq, (double[]){0, q[1] * v[0] / 2 + 1, 0, cos(q[0]) * v[1] / 4 - q[2] / 3, 0,
                                -q[0] / 3, 0, 0, 0}, 9 * sizeof *L_vq);
    if (L_vv) memcpy(L_vv, (double[]){M0, 0, 0.2, 0, M1, 0, 0.2, 0, 1}, 9 * sizeof *L_vv);
    return 0;
}

static int rich_force(double t, const double *q, const double *v, const double *u, double *f,
                      double *f_q, double *f_v, void *ctx)
{
    (void)ctx;
    if (f) {
        f[0] = 0.3 * sin(t) - v[0] / 10;
        f[1] = q[0] * cos(t) / 5;
        f[2] = q[1] * v[0] / 20 - v[2] / 10;
    }
    if (f_q) memcpy(f_q, (double[]){0, 0, 0, cos(t) / 5, 0, 0, 0, v[0] / 20, 0}, 9 * sizeof *f_q);
    if (f_v) memcpy(f_v, (double[]){-0.1, 0, 0, 0, 0, 0, q[1] / 20, 0, -0.1}, 9 * sizeof *f_v);
    return 0;
}

static int rich_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                           double *phi_q, double *phi_t, void *ctx)
{
    const dal_constraint_kind kind = ((const rich *)ctx)->kind;
    const double affine = kind != DAL_LINEAR, bent = kind == DAL_NONLINEAR;
    const double mu[3] = {-q[1], sin(q[2]) / 3, 1 + q[0] * q[0] / 10};
    if (phi)
        *phi = mu[0] * v[0] + mu[1] * v[1] + mu[2] * v[2] + affine * (0.2 + q[0] * q[2] / 10)
               + bent * (0.15 * v[0] * v[0] + q[2] * v[0] * v[1] / 10);
    if (phi_v) {
        phi_v[0] = mu[0] + bent * (0.3 * v[0] + q[2] * v[1] / 10);
        phi_v[1] = mu[1] + bent * q[2] * v[0] / 10;
        phi_v[2] = mu[2];
    }
    if (phi_q) {
        phi_q[0] = q[0] * v[2] / 5 + affine * q[2] / 10;
        phi_q[1] = -v[0];
        phi_q[2] = cos(q[2]) * v[1] / 3 + affine * q[0] / 10 + bent * v[0] * v[1] / 10;
    }
    return 0;
}

static const double rich_state[6] = {0.4, -0.3, 0.5, 0.6, -0.5, 0.3};

/* *is is filled and has to outlive the system; m is 0 or 1. */
static dal_system *open_rich(rich *is, size_t m, dal_constraint_kind kind, bool forced)
{
    is->kind = kind;
    const dal_system_def def = {.n = 3, .m = m, .lagrangian = rich_lagrangian,
                                .constraint = m ? rich_constraint : NULL, .kind = kind,
                                .force = forced ? rich_force : NULL, .ctx = is, .name = "rich",
                                .state = rich_state};
    return new_system(&def);
}

/* ---- maps ----------------------------------------------------------------------------------- */

/* g = (q0 + q1)/2 + (q1 - q0)^2/10, f = sinh((q1 - q0)/2)/(h/2), in each coordinate: symmetric
 * under the exchange of the nodes with h -> -h.  ctx: n. */
static int bent_map(double h, const double *q0, const double *q1, double *g, double *f,
                    double *g_0, double *g_1, double *f_0, double *f_1, void *ctx)
{
    const size_t n = *(const size_t *)ctx;
    double *const matrices[] = {g_0, g_1, f_0, f_1};
    for (size_t k = 0; k < 4; k++)
        if (matrices[k]) memset(matrices[k], 0, n * n * sizeof *g);
    for (size_t i = 0; i < n; i++) {
        const double d = q1[i] - q0[i];
        g[i] = (q0[i] + q1[i]) / 2 + d * d / 10;
        f[i] = sinh(d / 2) / (h / 2);
        if (g_0) g_0[i * n + i] = 0.5 - d / 5;
        if (g_1) g_1[i * n + i] = 0.5 + d / 5;
        if (f_0) f_0[i * n + i] = -cosh(d / 2) / h;
        if (f_1) f_1[i * n + i] = cosh(d / 2) / h;
    }
    return 0;
}

/* Coupled and not symmetric: g_i = q0_i + 3 d_i/10 + d_i d_(i+1)/7, f_i = (d_i + d_(i+1)^2/9)/h
 * with d = q1 - q0 and i + 1 mod n. */
static int mixed_map(double h, const double *q0, const double *q1, double *g, double *f,
                     double *g_0, double *g_1, double *f_0, double *f_1, void *ctx)
{
    const size_t n = *(const size_t *)ctx;
    double *const matrices[] = {g_0, g_1, f_0, f_1};
    for (size_t k = 0; k < 4; k++)
        if (matrices[k]) memset(matrices[k], 0, n * n * sizeof *g);
    for (size_t i = 0; i < n; i++) {
        const size_t j = (i + 1) % n;
        const double d = q1[i] - q0[i], e = q1[j] - q0[j];
        g[i] = q0[i] + 0.3 * d + d * e / 7;
        f[i] = (d + e * e / 9) / h;
        if (g_0) {
            g_0[i * n + i] = 0.7 - e / 7;
            g_0[i * n + j] = -d / 7;
            g_1[i * n + i] = 0.3 + e / 7;
            g_1[i * n + j] = d / 7;
            f_0[i * n + i] = -1 / h;
            f_0[i * n + j] = -2 * e / (9 * h);
            f_1[i * n + i] = 1 / h;
            f_1[i * n + j] = 2 * e / (9 * h);
        }
    }
    return 0;
}

static dal_difference_map rho_beta(double beta) { return (dal_difference_map){.beta = beta}; }

#define GOOD(discrete, call) \
    check_true((call) == DAL_SUCCESS, dal_discrete_error(discrete)->text, __FILE__, __LINE__)

static double dot(size_t n, const double *a, const double *b)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

/* The determinant, by elimination with the largest pivot. */
static double determinant(size_t n, const double *A)
{
    double a[N * N], det = 1.0;
    memcpy(a, A, n * n * sizeof *a);
    for (size_t j = 0; j < n; j++) {
        size_t best = j;
        for (size_t i = j; i < n; i++)
            if (fabs(a[i * n + j]) > fabs(a[best * n + j])) best = i;
        for (size_t k = 0; k < n && best != j; k++) {
            const double swap = a[j * n + k];
            a[j * n + k] = a[best * n + k];
            a[best * n + k] = swap;
        }
        if (best != j) det = -det;
        det *= a[j * n + j];
        if (det == 0.0) return det;
        for (size_t i = j + 1; i < n; i++) {
            const double l = a[i * n + j] / a[j * n + j];
            for (size_t k = j; k < n; k++) a[i * n + k] -= l * a[j * n + k];
        }
    }
    return det;
}

/* slope of log(error) over log(h) between two steps */
static double slope(double error, double next, double factor)
{
    return log(error / next) / log(factor);
}

/* ---- by hand -------------------------------------------------------------------------------- */

/* The particle on springs with rho^(1/4). */
static void test_by_hand(void)
{
    dal_system *const system = open_system("particle_oscillator");
    dal_discrete *const d = open_discrete(system, rho_beta(0.25), NULL);
    const double h = 0.2, q0[3] = {0.5, 0.3, -0.2}, q1[3] = {0.7, 0.2, 0.1}, k[3] = {1, 2, 1.5};
    double x[6], p[3], q[3], L = NAN, D1[3], D2[3], D12[9], phi = NAN, phi1[3], phi2[3];
    double expected = 0.0, residual[4], momenta[6];
    CHECK(dal_discrete_error(d)->text[0] == '\0');
    GOOD(d, dal_discrete_state(d, h, q0, q1, x));
    GOOD(d, dal_discrete_nodes(d, 0.0, h, x, p, q));
    GOOD(d, dal_discrete_lagrangian(d, 0.0, h, q0, q1, &L, D1, D2, D12));
    GOOD(d, dal_discrete_momenta(d, 0.0, h, q0, q1, momenta, momenta + 3));
    for (size_t i = 0; i < 3; i++) {
        const double g = 0.75 * q0[i] + 0.25 * q1[i], f = (q1[i] - q0[i]) / h;
        CHECK_NEAR(x[i], g, 2 * U);
        CHECK_NEAR(x[3 + i], f, 4 * U);
        CHECK_NEAR(p[i], q0[i], 4 * U);
        CHECK_NEAR(q[i], q1[i], 4 * U);
        expected += h * (f * f - k[i] * g * g) / 2;
        CHECK_NEAR(D1[i], -f - 0.75 * h * k[i] * g, 16 * U);
        CHECK_NEAR(D2[i], f - 0.25 * h * k[i] * g, 16 * U);
        CHECK(momenta[i] == -D1[i] && momenta[3 + i] == D2[i]);
        for (size_t j = 0; j < 3; j++)
            CHECK_NEAR(D12[3 * i + j], i == j ? -1 / h - 0.1875 * h * k[i] : 0.0, 64 * U);
    }
    CHECK_NEAR(L, expected, 16 * U);
    GOOD(d, dal_discrete_constraint(d, 0.0, h, q0, q1, &phi, phi1, phi2));
    const double y = 0.275, vx = x[3];
    CHECK_NEAR(phi, x[5] - y * vx, 16 * U);
    CHECK_NEAR(phi1[0], y / h, 16 * U);
    CHECK_NEAR(phi1[1], -0.75 * vx, 16 * U);
    CHECK_NEAR(phi1[2], -1 / h, 16 * U);
    CHECK_NEAR(phi2[0], -y / h, 16 * U);
    CHECK_NEAR(phi2[1], -0.25 * vx, 16 * U);
    CHECK_NEAR(phi2[2], 1 / h, 16 * U);
    const double q2[3] = {0.8, 0.0, 0.5}, lambda = 0.7;
    GOOD(d, dal_discrete_residual(d, 0.0, h, q0, q1, q2, &lambda, residual));
    for (size_t i = 0; i < 3; i++) {
        const double g0 = 0.75 * q0[i] + 0.25 * q1[i], g1 = 0.75 * q1[i] + 0.25 * q2[i];
        const double mu[3] = {-0.2, 0, 1};
        CHECK_NEAR(residual[i], (q1[i] - q0[i]) / h - (q2[i] - q1[i]) / h
                   - h * k[i] * (0.25 * g0 + 0.75 * g1) + h * mu[i] * lambda, 32 * U);
    }
    CHECK_NEAR(residual[3], 0.4 / h - (0.75 * 0.2) * 0.1 / h, 16 * U);
    dal_discrete_free(NULL);
}

/* ---- derivatives ---------------------------------------------------------------------------- */

typedef struct pair_function {
    dal_discrete *d;
    double h;
    enum { VALUE, FIRST, PHI } what;
} pair_function;

/* A function of (q0, q1)[2n]. */
static int of_pair(const double *q, double *out, void *ctx)
{
    const pair_function *const p = ctx;
    const size_t n = p->d->n;
    if (p->what == PHI) return dal_discrete_constraint(p->d, 0.0, p->h, q, q + n, out, NULL, NULL);
    return dal_discrete_lagrangian(p->d, 0.0, p->h, q, q + n, p->what == VALUE ? out : NULL,
                                   p->what == FIRST ? out : NULL, NULL, NULL);
}

/* D_1 L_d, D_2 L_d, D_1 D_2 L_d, D_1 phi_d, D_2 phi_d against differences, which err by 1e-11 of
 * the largest derivative; those of a map whose derivatives are differenced again by 1e-12/h and
 * more. */
static void test_derivatives(const dal_system *system, dal_difference_map lagrangian,
                             const dal_difference_map *constraint)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    dal_discrete *const d = open_discrete(system, lagrangian, constraint);
    for (int sign = -1; sign <= 1; sign += 2) {
        const double h = 0.2 * sign;
        double x[2 * N], q[2 * N], D1[N], D2[N], D12[N * N], phi1[M * N], phi2[M * N];
        double value[N], column[N];
        moved_state(system, x);
        for (size_t i = 0; i < n; i++) {
            q[i] = x[i];
            q[n + i] = x[i] + h * x[n + i];
        }
        GOOD(d, dal_discrete_lagrangian(d, 0.0, h, q, q + n, NULL, D1, D2, D12));
        GOOD(d, dal_discrete_constraint(d, 0.0, h, q, q + n, NULL, phi1, phi2));
        const double size = 1 + sum_of_sizes(n, D1) + sum_of_sizes(n, D2)
                          + sum_of_sizes(n * n, D12) + sum_of_sizes(m * n, phi1);
        const double tolerance = (lagrangian.differenced ? 1e-8 : 1e-10) * size;
        pair_function p = {d, h, VALUE};
        for (size_t j = 0; j < 2 * n; j++) {
            p.what = VALUE;
            CHECK(dal__difference(of_pair, &p, q, j, 1, value, column, 1) == 0);
            CHECK_NEAR(column[0], j < n ? D1[j] : D2[j - n], tolerance);
            p.what = FIRST;
            CHECK(dal__difference(of_pair, &p, q, j, n, value, column, 1) == 0);
            for (size_t i = 0; j >= n && i < n; i++)
                CHECK_NEAR(column[i], D12[i * n + j - n], tolerance);
            p.what = PHI;
            CHECK(dal__difference(of_pair, &p, q, j, m, value, column, 1) == 0);
            for (size_t a = 0; a < m; a++)
                CHECK_NEAR(column[a], j < n ? phi1[a * n + j] : phi2[a * n + j - n], tolerance);
        }
    }
}

/* rho after its inverse is the identity: to Newton's 4 u in the nodes, which a quotient by h
 * amplifies. */
static void test_inverse(const dal_system *system, dal_difference_map map)
{
    const size_t n = dal_system_n(system);
    dal_discrete *const d = open_discrete(system, map, NULL);
    for (int k = 0; k < 4; k++) {
        const double h = (const double[]){0.2, -0.2, 1e-3, 0.5}[k];
        double x[2 * N], y[2 * N], q0[N], q1[N];
        moved_state(system, x);
        GOOD(d, dal_discrete_nodes(d, 0.0, h, x, q0, q1));
        GOOD(d, dal_discrete_state(d, h, q0, q1, y));
        const double size = sum_of_sizes(2 * n, x);
        CHECK_NEAR(largest_difference(2 * n, x, y), 0.0, 16 * U * size * (1 + 1 / fabs(h)));
    }
}

/* ---- the step ------------------------------------------------------------------------------- */

/* The equations hold after a step, with its multipliers; p^- - p^+ = h mu^T lambda; a run makes the
 * same steps; and the state runs along: rho F rho^-1. */
static void test_step(const dal_system *system, dal_difference_map lagrangian,
                      const dal_difference_map *constraint, double h)
{
    enum { STEPS = 5 };
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    dal_discrete *const d = open_discrete(system, lagrangian, constraint);
    const dal_difference_map *const of_D = constraint ? constraint : &lagrangian;
    double x[2 * N], q0[N], q1[N], nodes[(STEPS + 2) * N], lambda[STEPS * M], y[2 * N];
    size_t done = 99;
    const double t0 = 0.4;
    moved_state(system, x);
    /* Newton converges quadratically: 5 iterations at most, with two evaluations of L each */
    if (!mass_of(system)) {
        memcpy(y, x, sizeof y);
        GOOD(d, dal_discrete_advance(d, t0, h, y, NULL));
        CHECK(d->mech.eval.calls.lagrangian <= 1 + 5 * 2);
    }
    GOOD(d, dal_discrete_nodes(d, 0.0, h, x, q0, q1));
    memcpy(nodes, q0, n * sizeof *q0);
    memcpy(nodes + n, q1, n * sizeof *q1);
    GOOD(d, dal_discrete_run(d, t0, h, STEPS, nodes, lambda, &done));
    CHECK(done == STEPS);
    for (size_t k = 0; k < STEPS; k++) {
        const double t = t0 + (double)k * h, *const q = nodes + (k + 1) * n;
        const double size = (1 + sum_of_sizes(2 * n, x)) * (1 + 1 / fabs(h));
        double before[N], one[M], residual[N + M], plus[N], minus[N], mu[M * N], by_state[M];
        memcpy(before, q1, sizeof before);
        GOOD(d, dal_discrete_step(d, t, h, q0, q1, one));
        CHECK(memcmp(q0, before, n * sizeof *q0) == 0);
        CHECK_NEAR(largest_difference(n, q1, q + n), 0.0, ROUNDOFF * size);
        CHECK_NEAR(fabs(h) * largest_difference(m, one, lambda + k * m), 0.0, ROUNDOFF * size);
        GOOD(d, dal_discrete_residual(d, t, h, q - n, q, q + n, lambda + k * m, residual));
        CHECK_NEAR(dal__largest(n + m, residual), 0.0, ROUNDOFF * size);

        GOOD(d, dal_discrete_momenta(d, t, h, q - n, q, NULL, plus));
        GOOD(d, dal_discrete_momenta(d, t + h, h, q, q + n, minus, NULL));
        double v[2 * N], w[2 * N];
        GOOD(d, dal_discrete_state(d, h, q - n, q, v));
        GOOD(d, dal_discrete_state(d, h, q, q + n, w));
        for (size_t i = 0; i < n; i++) v[i] = (v[n + i] + w[n + i]) / 2;
        if (m > 0) CHECK(system->def.constraint(0.0, q, v, NULL, mu, NULL, NULL, system->def.ctx)
                         == 0);
        for (size_t i = 0; i < n; i++) {
            for (size_t a = 0; a < m; a++) plus[i] += h * mu[a * n + i] * lambda[k * m + a];
            CHECK_NEAR(minus[i], plus[i], ROUNDOFF * size);
        }
        GOOD(d, dal_discrete_advance(d, t, h, x, by_state));
        GOOD(d, dal_discrete_state(d, h, q, q + n, y));
        CHECK_NEAR(largest_difference(2 * n, x, y), 0.0, ROUNDOFF * size * (double)(k + 1));
        CHECK_NEAR(fabs(h) * largest_difference(m, by_state, lambda + k * m), 0.0,
                   ROUNDOFF * size * (double)(k + 1));
        if (of_D->map == NULL && system->def.kind == DAL_LINEAR)
            CHECK(residual_of(system, 0.0, x) <= DAL_RESIDUAL_BOUND(n));
        double relative = NAN;
        dal_mechanics *const mech = open_mechanics(system);
        CHECK(dal_relative_residual(mech, 0.0, 0.0, x, &relative) == 0);
        CHECK(relative <= DAL_RESIDUAL_BOUND(n)); /* for every map */
        release(mech);
    }
}

/* From states with rho^beta nothing is lost to the nodes, however small h is. */
static void test_small_steps(const dal_system *system)
{
    const size_t n = dal_system_n(system);
    const double h = 1e-7;
    for (size_t b = 0; b < BETAS; b++) {
        const dal_scheme scheme = {.name = "beta", .beta = betas[b]};
        dal_discrete *const d = open_discrete(system, rho_beta(betas[b]), NULL);
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        double x[2 * N];
        moved_state(system, x);
        need(dal_stepper_start(stepper, 0.0, h, x, DAL_ASSUME, DAL_INITIAL_NONE), "start", "");
        CHECK(dal_step(stepper, NULL) == 0);
        GOOD(d, dal_discrete_advance(d, 0.0, h, x, NULL));
        CHECK_NEAR(largest_difference(2 * n, x, dal_stepper_state(stepper)), 0.0,
                   ROUNDOFF * (1 + sum_of_sizes(2 * n, x)));
        release(d);
    }
}

/* The commutative diagram: moved nodes, kept nodes and the node map with one another, and with what
 * the steppers do. */
static void test_diagram(const dal_system *system, double beta, double h)
{
    enum { STEPS = 6 };
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    dal_discrete *const d = open_discrete(system, rho_beta(beta), NULL);
    const dal_scheme moved = {.name = "moved", .beta = beta};
    const dal_scheme kept = {.name = "kept", .beta = beta, .nodes = DAL_KEPT_NODES};
    dal_stepper *const on_D = open_stepper(system, &moved, NULL);
    dal_stepper *const on_D_eps = open_stepper(system, &kept, NULL);
    double x[2 * N], q0[N], q1[N], lambda[M], reaction[M], y[2 * N], nodes[(STEPS + 2) * N];
    const double t0 = 0.3;
    moved_state(system, x);
    need(dal_stepper_start(on_D, t0, h, x, DAL_ASSUME, DAL_INITIAL_NONE), "moved", "");
    need(dal_stepper_start(on_D_eps, t0, h, x, DAL_ASSUME, DAL_INITIAL_SHIFT), "kept", "");
    GOOD(d, dal_discrete_nodes(d, 0.0, h, x, q0, q1));
    memcpy(nodes, q0, n * sizeof *q0);
    memcpy(nodes + n, q1, n * sizeof *q1);
    GOOD(d, dal_discrete_run(d, t0, h, STEPS, nodes, NULL, NULL));
    for (size_t k = 0; k < STEPS; k++) {
        const double *const state = dal_stepper_state(on_D);
        const double *const node = dal_stepper_state(on_D_eps);
        const double tolerance = ROUNDOFF * (double)(k + 1) * (1 + sum_of_sizes(2 * n, x));
        CHECK(dal_step(on_D, reaction) == 0 && dal_step(on_D_eps, NULL) == 0);
        GOOD(d, dal_discrete_advance(d, t0 + (double)k * h, h, x, lambda));
        CHECK_NEAR(largest_difference(2 * n, x, state), 0.0, tolerance);
        CHECK_NEAR(fabs(h) * largest_difference(m, lambda, reaction), 0.0, tolerance);
        /* S(q~, v) = (q~ + (1-beta) h v, v) */
        for (size_t i = 0; i < n; i++) {
            y[i] = x[i] + (1 - beta) * h * x[n + i];
            y[n + i] = x[n + i];
        }
        CHECK_NEAR(largest_difference(2 * n, y, node), 0.0, tolerance);
        CHECK_NEAR(largest_difference(n, nodes + (k + 2) * n, node), 0.0, tolerance);
        GOOD(d, dal_discrete_state(d, h, nodes + (k + 1) * n, nodes + (k + 2) * n, y));
        CHECK_NEAR(largest_difference(2 * n, x, y), 0.0, tolerance / fabs(h));
    }
}

/* ---- regularity ----------------------------------------------------------------------------- */

/* The matrix against its blocks; its determinant against another elimination, and against
 * (-1/h)^n det K det S with K and B of the step equations at the same point. */
static void test_regularity(const dal_system *system, double beta, double h)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system), L = n + m;
    const bool linear = system->def.kind != DAL_NONLINEAR;
    dal_discrete *const d = open_discrete(system, rho_beta(beta), NULL);
    dal_mechanics *const mech = open_mechanics(system);
    double x[2 * N], q0[N], q1[N], q2[N], logarithm = NAN, condition = NAN;
    double matrix[(N + M) * (N + M)];
    double D12[N * N], phi2[M * N], K[N * N], B[M * N], mu[M * N], kappa[M] = {0}, S[M * M];
    const double t = 0.7;
    int sign = 9;
    moved_state(system, x);
    GOOD(d, dal_discrete_nodes(d, 0.0, h, x, q0, q1));
    const double *const w = x + n;
    for (size_t i = 0; i < n; i++) q2[i] = q1[i] + h * w[i];
    GOOD(d, dal_discrete_regularity(d, t, h, q1, q2, matrix, &sign, &logarithm, &condition));
    GOOD(d, dal_discrete_lagrangian(d, 0.0, h, q1, q2, NULL, NULL, NULL, D12));
    GOOD(d, dal_discrete_constraint(d, 0.0, h, q1, q2, NULL, NULL, phi2));
    CHECK(dal_step_equations(mech, t, beta, h, x, w, kappa, NULL, NULL, K, B, mu) == 0);
    const double size = (1 + sum_of_sizes(n * n, D12)) * 16 * U / fabs(h);
    for (size_t i = 0; i < L; i++)
        for (size_t j = 0; j < L; j++) {
            const double is = matrix[i * L + j];
            if (i >= n && j >= n) CHECK(is == 0.0);
            else if (i >= n) CHECK_NEAR(is, phi2[(i - n) * n + j], size);
            else if (j >= n) CHECK_NEAR(is, mu[(j - n) * n + i], size);
            else CHECK_NEAR(is, -K[i * n + j] / h, size);
            if (i < n && j < n && !system->def.force) CHECK_NEAR(is, D12[i * n + j], size);
        }
    if (linear || m == 0) {
        const double det = determinant(L, matrix);
        CHECK_NEAR(sign * exp(logarithm) / det, 1.0, 1e-11);
        double columns[N * M];
        for (size_t a = 0; a < m; a++) { /* K^-1 mu^T by Cramer's rule */
            double replaced[N * N];
            for (size_t i = 0; i < n; i++) {
                memcpy(replaced, K, n * n * sizeof *K);
                for (size_t k = 0; k < n; k++) replaced[k * n + i] = mu[a * n + k];
                columns[a * n + i] = determinant(n, replaced) / determinant(n, K);
            }
        }
        for (size_t a = 0; a < m; a++)
            for (size_t b = 0; b < m; b++) S[a * m + b] = dot(n, B + a * n, columns + b * n);
        const double expected = pow(-1 / h, (double)n) * determinant(n, K) * determinant(m, S);
        CHECK_NEAR(sign * exp(logarithm) / expected, 1.0, 1e-11);
        CHECK(condition >= 1.0 && condition < 1e3);
    }
    GOOD(d, dal_discrete_regularity(d, t, h, q1, q2, NULL, NULL, NULL, NULL));
}

/* Particle, beta = 1, y = -1, h v_y = 2: S = 1 + y' y = 0 exactly (E15). */
static void test_singular(void)
{
    dal_system *const system = open_system("particle");
    dal_discrete *const d = open_discrete(system, rho_beta(1.0), NULL);
    const double h = 0.5, x[6] = {0.5, -1.0, 0.2, 1.0, 4.0, -1.0};
    double q0[3], q1[3], lambda = 7.0, y[6], logarithm = NAN, condition = NAN;
    int sign = 9;
    GOOD(d, dal_discrete_nodes(d, 0.0, h, x, q0, q1));
    const double before[6] = {q0[0], q0[1], q0[2], q1[0], q1[1], q1[2]};
    CHECK(dal_discrete_step(d, 0.0, h, q0, q1, &lambda) == DAL_ESINGULAR && lambda == 7.0);
    CHECK(memcmp(q0, before, sizeof q0) == 0 && memcmp(q1, before + 3, sizeof q1) == 0);
    CHECK(strstr(dal_discrete_error(d)->text, "singular") != NULL);
    memcpy(y, x, sizeof y);
    CHECK(dal_discrete_advance(d, 0.0, h, y, &lambda) == DAL_ESINGULAR);
    CHECK(memcmp(y, x, sizeof y) == 0 && lambda == 7.0);
    const double q2[3] = {1.0, 1.0, 0.0};
    GOOD(d, dal_discrete_regularity(d, 0.0, h, q1, q2, NULL, &sign, &logarithm, &condition));
    CHECK(sign == 0 && logarithm == -INFINITY && condition == INFINITY);
    /* nearby: det = (-1/h)^3 (1 + y y') */
    const double near[3] = {1.0, 1.0 - 0x1p-20, 0.0};
    GOOD(d, dal_discrete_regularity(d, 0.0, h, q1, near, NULL, &sign, &logarithm, &condition));
    CHECK(sign == -1);
    CHECK_NEAR(logarithm, log(8 * 0x1p-20), 1e-9);
    CHECK(condition > 1e5 && condition < 1e7);
}

/* ---- orders --------------------------------------------------------------------------------- */

/* L_d of the nodes q(t0), q(t0 + h) against the action, by Gauss's rule with 5 nodes along the
 * flow: O(h^3) if and only if beta = 1/2, else O(h^2). */
static void test_action(dal_system *system)
{
    static const double at[5] = {0.0, 0.53846931010568309, -0.53846931010568309,
                                 0.90617984593866399, -0.90617984593866399};
    static const double weight[5] = {0.56888888888888889, 0.47862867049936647, 0.47862867049936647,
                                     0.23692688505618909, 0.23692688505618909};
    const size_t n = dal_system_n(system);
    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-14);
    dal_mechanics *const mech = open_mechanics(system);
    for (size_t b = 0; b < BETAS; b++) {
        dal_discrete *const d = open_discrete(system, rho_beta(betas[b]), NULL);
        double error[3];
        for (int k = 0; k < 3; k++) {
            const double h = ldexp(0.1, -k);
            double x0[2 * N], x[2 * N], end[2 * N], action = 0.0, L = NAN, L_d = NAN;
            moved_state(system, x0);
            memcpy(end, x0, sizeof end);
            CHECK(dal_flow_apply(flow, 0.0, h, end, NULL) == 0);
            for (int i = 0; i < 5; i++) {
                memcpy(x, x0, sizeof x);
                CHECK(dal_flow_apply(flow, 0.0, h * (1 + at[i]) / 2, x, NULL) == 0);
                const dal__jet wanted = {.L = &L};
                CHECK(dal__lagrangian(&mech->eval, 0.0, x, x + n, &wanted, NULL) == 0);
                action += h / 2 * weight[i] * L;
            }
            GOOD(d, dal_discrete_lagrangian(d, 0.0, h, x0, end, &L_d, NULL, NULL, NULL));
            error[k] = fabs(L_d - action);
        }
        const double expected = betas[b] == 0.5 ? 3 : 2;
        CHECK_NEAR(slope(error[1], error[2], 2), expected, 0.15);
        release(d);
    }
}

/* p from the error of one step and of half the step, for the state. */
static double measured_order(const dal_system *system, dal_difference_map lagrangian,
                             dal_difference_map constraint)
{
    const size_t n = dal_system_n(system);
    dal_discrete *const d = open_discrete(system, lagrangian, &constraint);
    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-14);
    double error[2];
    for (int k = 0; k < 2; k++) {
        const double h = ldexp(0.02, -k);
        double x[2 * N], y[2 * N];
        moved_state(system, x);
        memcpy(y, x, sizeof y);
        CHECK(dal_flow_apply(flow, 0.3, 0.3 + h, y, NULL) == 0);
        GOOD(d, dal_discrete_advance(d, 0.3, h, x, NULL));
        error[k] = largest_difference(2 * n, x, y);
    }
    return slope(error[0], error[1], 2) - 1;
}

/* The same map twice: order 2 if it is symmetric.  Two of them: if L is v^T M v/2 - V, the L_d of
 * beta_L and of 1/2 differ by W(q1) - W(q0), which the equations do not see, and O(h^3); then only
 * D_d decides.  Else both have to be symmetric. */
static void test_orders(const dal_system *system)
{
    const bool simple = mass_of(system) != NULL;
    size_t size = dal_system_n(system);
    const dal_difference_map bent = {.map = bent_map, .ctx = &size, .beta = 0.5};
    const dal_difference_map mixed = {.map = mixed_map, .ctx = &size, .beta = 0.3};
    CHECK_NEAR(measured_order(system, bent, bent), 2, 0.15);
    CHECK_NEAR(measured_order(system, mixed, mixed), 1, 0.15);
    CHECK_NEAR(measured_order(system, bent, rho_beta(0.5)), 2, 0.15);
    for (size_t a = 0; a < BETAS; a++)
        for (size_t b = 0; b < BETAS; b++) {
            const bool second = betas[b] == 0.5 && (simple || betas[a] == 0.5);
            CHECK_NEAR(measured_order(system, rho_beta(betas[a]), rho_beta(betas[b])),
                       second ? 2 : 1, 0.2);
        }
}

/* ---- without constraints -------------------------------------------------------------------- */

/* (q_k, p^+_k) of the pair (q0, q1)[2n], or of the pair after it. */
typedef struct phase_point {
    dal_discrete *d;
    double h;
    bool after;
} phase_point;

static int phase_of_pair(const double *q, double *z, void *ctx)
{
    const phase_point *const p = ctx;
    const size_t n = p->d->n;
    double q0[N], q1[N];
    memcpy(q0, q, n * sizeof *q);
    memcpy(q1, q + n, n * sizeof *q);
    int status = p->after ? dal_discrete_step(p->d, 0.0, p->h, q0, q1, NULL) : 0;
    if (!status) status = dal_discrete_momenta(p->d, 0.0, p->h, q0, q1, NULL, z + n);
    memcpy(z, q1, n * sizeof *z);
    return status;
}

/* J^T Omega J for J[2n*2n]: the canonical two-form pulled back. */
static void pull_back(size_t n, const double *J, double *form)
{
    for (size_t i = 0; i < 2 * n; i++)
        for (size_t j = 0; j < 2 * n; j++) {
            form[i * 2 * n + j] = 0.0;
            for (size_t k = 0; k < n; k++)
                form[i * 2 * n + j] += J[k * 2 * n + i] * J[(n + k) * 2 * n + j]
                                     - J[(n + k) * 2 * n + i] * J[k * 2 * n + j];
        }
}

/* The discrete Euler-Lagrange flow (q_k, p_k) -> (q_(k+1), p_(k+1)) is symplectic: dq ^ dp, pulled
 * back to pairs of nodes from before the step and from after it, is the same two-form.
 * Differences of order 4 err by 1e-12 of the derivatives.  With a force that damps it is not. */
static void test_symplectic(const dal_system *system, dal_difference_map map, double h)
{
    const size_t n = dal_system_n(system);
    dal_discrete *const d = open_discrete(system, map, NULL);
    double x[2 * N], q[2 * N], J[2][4 * N * N], form[2][4 * N * N], value[2 * N];
    moved_state(system, x);
    GOOD(d, dal_discrete_nodes(d, 0.0, h, x, q, q + n));
    for (int k = 0; k < 2; k++) {
        phase_point p = {d, h, k == 1};
        for (size_t j = 0; j < 2 * n; j++)
            CHECK(dal__difference(phase_of_pair, &p, q, j, 2 * n, value, J[k] + j, 2 * n) == 0);
        pull_back(n, J[k], form[k]);
    }
    const double size = sum_of_sizes(4 * n * n, J[1]);
    const double worst = largest_difference(4 * n * n, form[0], form[1]);
    if (system->def.force) CHECK(worst > 1e-3);
    else CHECK_NEAR(worst, 0.0, (map.differenced ? 1e-8 : 1e-10) * (1 + size));
    CHECK(dal__largest(4 * n * n, form[0]) > 1.0);
}

/* beta = 1/2 with a constant mass is the trapezoidal rule in (q~, v). */
static void test_trapezoidal(void)
{
    wide w;
    dal_system *const system = open_wide(&w, 4, 0, true, true);
    dal_discrete *const d = open_discrete(system, rho_beta(0.5), NULL);
    const double h = 0.1;
    double x[8], y[8], g0[4], g1[4], force[4];
    memcpy(x, w.state, sizeof x);
    memcpy(y, x, sizeof y);
    GOOD(d, dal_discrete_advance(d, 0.0, h, y, NULL));
    wide_potential(0.0, x, NULL, g0, NULL, &w);
    wide_potential(0.0, y, NULL, g1, NULL, &w);
    for (size_t i = 0; i < 4; i++) {
        CHECK_NEAR(y[i], x[i] + h / 2 * (x[4 + i] + y[4 + i]), 8 * U * sum_of_sizes(8, x));
        x[4 + i] = y[4 + i] - x[4 + i];
    }
    dal__apply(4, 4, w.mass, x + 4, force);
    for (size_t i = 0; i < 4; i++)
        CHECK_NEAR(force[i], -h / 2 * (g0[i] + g1[i]), ROUNDOFF * (1 + sum_of_sizes(8, y)));
    /* and not with a mass that depends on q (E25): v' - v is another combination of
     * accelerations */
    rich is;
    dal_system *const uneven = open_rich(&is, 0, DAL_LINEAR, false);
    dal_discrete *const e = open_discrete(uneven, rho_beta(0.5), NULL);
    dal_mechanics *const mech = open_mechanics(uneven);
    double before[3], after[3];
    moved_state(uneven, x);
    memcpy(y, x, 6 * sizeof *y);
    GOOD(e, dal_discrete_advance(e, 0.0, h, y, NULL));
    CHECK(dal_acceleration(mech, 0.0, x, before) == 0 && dal_acceleration(mech, h, y, after) == 0);
    double worst = 0.0;
    for (size_t i = 0; i < 3; i++)
        worst = fmax(worst, fabs(y[3 + i] - x[3 + i] - h / 2 * (before[i] + after[i])));
    CHECK(worst > 1e-6);
}

/* V = -1/|q| in R^3 */
static int kepler(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const double r = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]), r3 = r * r * r;
    (void)ctx;
    if (V) *V = -1 / r;
    for (size_t i = 0; i < 3; i++) {
        if (V_q) V_q[i] = q[i] / r3;
        for (size_t j = 0; V_qq && j < 3; j++)
            V_qq[3 * i + j] = (i == j) / r3 - 3 * q[i] * q[j] / (r3 * r * r);
    }
    return 0;
}

/* The discrete momentum of rotations is constant along orbits in a central field. */
static void test_rotations(void)
{
    enum { STEPS = 200 };
    const double mass[9] = {2, 0, 0, 0, 2, 0, 0, 0, 2};
    const dal_system_def def = {.n = 3, .mass = mass, .potential = kepler};
    dal_system *const system = new_system(&def);
    const double x[6] = {1.0, 0.2, -0.3, 0.1, 0.6, 0.4}, h = 0.05;
    for (size_t b = 0; b < BETAS; b++) {
        dal_discrete *const d = open_discrete(system, rho_beta(betas[b]), NULL);
        double nodes[3 * (STEPS + 2)], first[3] = {NAN, NAN, NAN};
        GOOD(d, dal_discrete_nodes(d, 0.0, h, x, nodes, nodes + 3));
        GOOD(d, dal_discrete_run(d, 0.0, h, STEPS, nodes, NULL, NULL));
        for (size_t k = 0; k <= STEPS; k++) {
            const double *const q0 = nodes + 3 * k, *const q1 = q0 + 3;
            for (size_t axis = 0; axis < 3; axis++) {
                const size_t i = (axis + 1) % 3, j = (axis + 2) % 3;
                double xi0[3] = {0}, xi1[3] = {0}, minus = NAN, plus = NAN;
                xi0[i] = -q0[j];
                xi0[j] = q0[i];
                xi1[i] = -q1[j];
                xi1[j] = q1[i];
                GOOD(d, dal_discrete_momentum(d, 0.0, h, q0, q1, xi0, xi1, &minus, &plus));
                if (k == 0) first[axis] = plus;
                /* momenta of size 2 |q|/h, known to u |q|/h, random walk of 200 steps */
                CHECK_NEAR(minus, plus, 64 * U / h);
                CHECK_NEAR(plus, first[axis], 256 * U / h);
            }
        }
        CHECK(fabs(first[2]) > 0.5);
        release(d);
    }
}

/* Constant generators in D of an invariant L: p . xi is constant also with constraints. */
static void test_translations(void)
{
    static const struct {
        const char *system;
        size_t coordinate;
    } cases[] = {{"particle", 1}, {"disk", 3}, {"knife_edge", 2}};
    enum { STEPS = 50 };
    for (size_t c = 0; c < 3; c++)
        for (size_t b = 0; b < BETAS; b++) {
            dal_system *const system = open_system(cases[c].system);
            const size_t n = dal_system_n(system);
            dal_discrete *const d = open_discrete(system, rho_beta(betas[b]), NULL);
            double x[2 * N], nodes[(STEPS + 2) * N], xi[N] = {0}, first = NAN, plus = NAN;
            const double h = 0.05;
            xi[cases[c].coordinate] = 1.0;
            moved_state(system, x);
            GOOD(d, dal_discrete_nodes(d, 0.0, h, x, nodes, nodes + n));
            GOOD(d, dal_discrete_run(d, 0.0, h, STEPS, nodes, NULL, NULL));
            for (size_t k = 0; k <= STEPS; k++) {
                const double *const q = nodes + k * n;
                GOOD(d, dal_discrete_momentum(d, 0.0, h, q, q + n, xi, xi, NULL, &plus));
                if (k == 0) first = plus;
                CHECK_NEAR(plus, first, ROUNDOFF * (1 + sum_of_sizes(n, q)) / h);
            }
            release(system);
        }
}

/* ---- two maps ------------------------------------------------------------------------------- */

/* Without constraints the map of D_d only names the states and their times: the nodes are those of
 * L_d alone, and the force is asked at the time of its g. */
static void test_force_times(void)
{
    rich is;
    dal_system *const system = open_rich(&is, 0, DAL_LINEAR, true);
    const double h = 0.1, t = 0.7, beta_L = 0.5;
    dal_discrete *const one = open_discrete(system, rho_beta(beta_L), NULL);
    for (size_t b = 0; b < BETAS; b++) {
        const dal_difference_map of_D = rho_beta(betas[b]);
        dal_discrete *const two = open_discrete(system, rho_beta(beta_L), &of_D);
        double x[6], q0[3], q1[3], p0[3], p1[3], s0[3], s1[3];
        moved_state(system, x);
        GOOD(two, dal_discrete_nodes(two, 0.0, h, x, q0, q1));
        memcpy(p0, q0, sizeof p0);
        memcpy(p1, q1, sizeof p1);
        memcpy(s0, q0, sizeof s0);
        memcpy(s1, q1, sizeof s1);
        GOOD(two, dal_discrete_step(two, t, h, q0, q1, NULL));
        GOOD(one, dal_discrete_step(one, t + (beta_L - betas[b]) * h, h, p0, p1, NULL));
        CHECK_NEAR(largest_difference(3, q1, p1), 0.0, ROUNDOFF);
        GOOD(one, dal_discrete_step(one, t + 1.0, h, s0, s1, NULL));
        CHECK(largest_difference(3, s1, p1) > 1e-4);
        release(two);
    }
}

/* Largest |E - E0| over a run. */
static double energy_band(const char *name, double beta_L, double beta_D)
{
    dal_system *const system = open_system(name);
    dal_mechanics *const mech = open_mechanics(system);
    const size_t n = dal_system_n(system);
    const dal_difference_map of_D = rho_beta(beta_D);
    dal_discrete *const d = open_discrete(system, rho_beta(beta_L), &of_D);
    double x[2 * N], E0 = NAN, E = NAN, worst = 0.0;
    need(dal_system_state(system, x), "state", "");
    CHECK(dal_energy(mech, 0.0, x, &E0) == 0);
    for (size_t k = 0; k < 2000; k++) {
        GOOD(d, dal_discrete_advance(d, 0.0, 0.05, x, NULL));
        CHECK(dal_energy(mech, 0.0, x, &E) == 0);
        worst = fmax(worst, fabs(E - E0));
        CHECK(residual_of(system, 0.0, x) <= DAL_RESIDUAL_BOUND(n));
    }
    return worst;
}

/* With a constant mass the energy is a matter of D_d: it stays in a narrow band for beta_D = 1/2,
 * whatever beta_L is, and leaves it else.  Two maps can do better than one. */
static void test_energy(void)
{
    for (size_t a = 0; a < BETAS; a++)
        for (size_t b = 0; b < BETAS; b++) {
            const double band = energy_band("particle_oscillator", betas[a], betas[b]);
            CHECK(betas[b] == 0.5 ? band < 1e-3 : band > 5e-2);
        }
    const double one = energy_band("robot", 0.5, 0.5), two = energy_band("robot", 0.25, 0.5);
    printf("energy of robot: band %.2e with one map, %.2e with two\n", one, two);
    CHECK(two < 0.5 * one && two > 1e-4);
}

/* ---- the exact discrete constraint ---------------------------------------------------------- */

/* Particle: through (x0, y0, z0) and (x1, y1) goes one orbit of D, in closed form. */
static void test_exact_particle(void)
{
    dal_system *const system = open_system("particle");
    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-14);
    const double h = 0.25, q0[3] = {0.5, 0.3, -0.2};
    double q1[3] = {0.74, 0.48, 0.0}, v0[3], defect = NAN;
    const double b = (q1[1] - q0[1]) / h, c = b * (q1[0] - q0[0]) / (asinh(q1[1]) - asinh(q0[1]));
    const double s0 = sqrt(1 + q0[1] * q0[1]), s1 = sqrt(1 + q1[1] * q1[1]);
    q1[2] = q0[2] + c / b * (s1 - s0);
    CHECK(dal_exact_velocity(flow, 0.0, h, q0, q1, v0, &defect) == 0);
    /* the flow at 1e-14 and the digits of the nodes, over h */
    CHECK_NEAR(v0[0], c / s0, 1e-12);
    CHECK_NEAR(v0[1], b, 1e-12);
    CHECK_NEAR(v0[2], c / s0 * q0[1], 1e-12);
    CHECK_NEAR(defect, 0.0, 1e-12);
    double late[3]; /* t0 + h - t0 is not h */
    CHECK(dal_exact_velocity(flow, 1e15, h, q0, q1, late, NULL) == 0);
    CHECK_NEAR(largest_difference(3, late, v0), 0.0, 0.0);
    CHECK(dal_exact_velocity(flow, 1e18, h, q0, q1, late, NULL) == 0);
    CHECK_NEAR(largest_difference(3, late, v0), 0.0, 0.0);
    q1[2] += 1e-3; /* off it: what is missed is orthogonal to D at q0, (x, z) along (-y0, 1) */
    CHECK(dal_exact_velocity(flow, 0.0, h, q0, q1, v0, &defect) == 0);
    CHECK(defect > 0.5e-3 / h && defect < 2e-3 / h);
    CHECK_NEAR(v0[2], v0[0] * q0[1], 4 * U);
    double x[6] = {q0[0], q0[1], q0[2], v0[0], v0[1], v0[2]};
    CHECK(dal_flow_apply(flow, 0.0, h, x, NULL) == 0);
    CHECK_NEAR(q1[1] - x[1], 0.0, 1e-12);
    CHECK_NEAR((q1[0] - x[0]) + q0[1] * (q1[2] - x[2]), 0.0, 1e-12);
    CHECK_NEAR(defect, ((q1[2] - x[2]) - q0[1] * (q1[0] - x[0])) / h, 1e-11);
}

/* v0 comes back from where the flow takes it; and the defect of D_d^beta on D_d^E is O(h), O(h^2)
 * for beta = 1/2.  even: phi_d does not depend on beta (d(mu v)/dq v = 0), so that it is O(h^2)
 * for all. */
static void test_exact(const dal_system *system, bool even)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-14);
    double x[2 * N], end[2 * N], v0[N], defect[M] = {0}, phi[M], size[BETAS][2];
    const double t0 = 0.3;
    moved_state(system, x);
    for (int k = 0; k < 2; k++) {
        const double h = k ? -0.04 : 0.04, finer = k ? 0.002 : 0.004;
        memcpy(end, x, sizeof end);
        CHECK(dal_flow_apply(flow, t0, t0 + h, end, NULL) == 0);
        check_true(dal_exact_velocity(flow, t0, h, x, end, v0, defect) == 0,
                   dal_flow_error(flow)->text, dal_system_name(system), __LINE__);
        const double tolerance = 1e-13 * (1 + sum_of_sizes(2 * n, x)) / fabs(h);
        CHECK_NEAR(largest_difference(n, v0, x + n), 0.0, tolerance);
        CHECK_NEAR(dal__largest(m, defect), 0.0, tolerance);
        for (size_t b = 0; b < BETAS; b++) {
            dal_discrete *const d = open_discrete(system, rho_beta(betas[b]), NULL);
            memcpy(end, x, sizeof end);
            CHECK(dal_flow_apply(flow, t0, t0 + finer, end, NULL) == 0);
            GOOD(d, dal_discrete_constraint(d, 0.0, finer, x, end, phi, NULL, NULL));
            size[b][k] = dal__largest(m, phi);
            release(d);
        }
    }
    for (size_t b = 0; b < BETAS; b++)
        CHECK_NEAR(slope(size[b][0], size[b][1], 2), even || betas[b] == 0.5 ? 2 : 1, 0.12);
}

/* A map whose first node is the state, so that only the second is left for Newton. */
static int steep_map(double h, const double *q0, const double *q1, double *g, double *f,
                     double *g_0, double *g_1, double *f_0, double *f_1, void *ctx)
{
    (void)g_0, (void)g_1, (void)f_0, (void)f_1, (void)ctx;
    for (size_t i = 0; i < 3; i++) {
        g[i] = q0[i];
        f[i] = sinh(q1[i] - q0[i]) / h;
    }
    return 0;
}

/* Newton goes on until both nodes stand still. */
static void test_second_node(void)
{
    dal_system *const system = open_system("particle");
    const dal_difference_map steep = {.map = steep_map, .differenced = 1};
    dal_discrete *const d = open_discrete(system, steep, NULL);
    double q0[3], q1[3];
    GOOD(d, dal_discrete_nodes(d, 0.0, 1.0, (double[]){0, 0, 0, 2, 2, 2}, q0, q1));
    for (int i = 0; i < 3; i++) CHECK_NEAR(q1[i], asinh(2.0), 1e-14);
}

/* ---- failures ------------------------------------------------------------------------------- */

/* Two nodes that meet in one point: f = 0. */
static int flat_map(double h, const double *q0, const double *q1, double *g, double *f,
                    double *g_0, double *g_1, double *f_0, double *f_1, void *ctx)
{
    (void)h, (void)ctx;
    for (size_t i = 0; i < 3; i++) {
        g[i] = (q0[i] + q1[i]) / 2;
        f[i] = 0.0;
        for (size_t j = 0; g_0 && j < 3; j++) {
            g_0[3 * i + j] = g_1[3 * i + j] = (i == j) / 2.0;
            f_0[3 * i + j] = f_1[3 * i + j] = 0.0;
        }
    }
    return 0;
}

/* rho^(1/2) that refuses long steps, stops, or forgets. */
typedef struct moody {
    enum { FINE, REFUSES, STOPS, FORGETS_PLACE, FORGETS, FORGETS_SLOPE, NANS } mood;
    double longest;
    size_t refused, calls, spoil; /* from call spoil on it is moody */
} moody;

static int moody_map(double h, const double *q0, const double *q1, double *g, double *f,
                     double *g_0, double *g_1, double *f_0, double *f_1, void *ctx)
{
    moody *const is = ctx;
    const bool now = is->calls++ >= is->spoil;
    for (size_t i = 0; i < 3; i++) {
        if (fabs(q1[i] - q0[i]) > is->longest) {
            is->refused++;
            return 1;
        }
        if (!now || is->mood != FORGETS_PLACE) g[i] = (q0[i] + q1[i]) / 2;
        if (now && is->mood == NANS) g[i] = NAN;
        if (!now || is->mood != FORGETS) f[i] = (q1[i] - q0[i]) / h;
        for (size_t j = 0; g_0 && j < 3; j++) {
            g_0[3 * i + j] = g_1[3 * i + j] = (i == j) / 2.0;
            f_1[3 * i + j] = (i == j) / h;
            if (!now || is->mood != FORGETS_SLOPE) f_0[3 * i + j] = -(i == j) / h;
        }
    }
    return now && is->mood == REFUSES ? 3 : now && is->mood == STOPS ? -3 : 0;
}

static void test_moods(void)
{
    static const struct {
        int mood, status;
        const char *text;
    } cases[] = {
        {REFUSES, DAL_EDOMAIN, "difference map returned 3"},
        {STOPS, DAL_EUSER, "difference map returned -3"},
        {FORGETS_PLACE, DAL_EDOMAIN, "difference map: g[0,0] = nan"},
        {FORGETS, DAL_EDOMAIN, "difference map: f[0,0] = nan"},
        {FORGETS_SLOPE, DAL_EDOMAIN, "difference map: f_0[0,0] = nan"},
        {NANS, DAL_EDOMAIN, "difference map: g[0,0] = nan"},
    };
    dal_system *const system = open_system("particle_oscillator");
    const double x0[6] = {0.5, 0.3, -0.2, 1.0, 0.7, 0.3}, h = 0.1;
    for (size_t c = 0; c < DAL_LENGTH(cases); c++)
        for (size_t spoil = 0; spoil < 40; spoil++) {
            moody is = {.mood = cases[c].mood, .longest = 10.0, .spoil = spoil};
            dal_discrete *const d =
                open_discrete(system, (dal_difference_map){.map = moody_map, .ctx = &is}, NULL);
            double x[6], lambda = 7.0;
            memcpy(x, x0, sizeof x);
            const int status = dal_discrete_advance(d, 0.0, h, x, &lambda);
            if (status == DAL_SUCCESS) { /* it was not called that often */
                CHECK(spoil > 10 && is.calls <= spoil);
                release(d);
                break;
            }
            CHECK(status == cases[c].status);
            CHECK(strstr(dal_discrete_error(d)->text, cases[c].text) != NULL);
            CHECK(memcmp(x, x0, sizeof x) == 0 && lambda == 7.0);
            release(d);
        }
    /* A Newton step that leaves the domain is halved: a strong spring throws the first one far. */
    const double mass[9] = {1e-3, 0, 0, 0, 1, 0, 0, 0, 1}, far[6] = {1.0, 0, 0, 0, 0, 0};
    dal_system_def def = {.n = 3, .mass = mass, .potential = system->def.potential,
                          .ctx = system->def.ctx};
    dal_system *const stiff = new_system(&def);
    moody is = {.longest = 1.4};
    const dal_difference_map map = {.map = moody_map, .ctx = &is};
    dal_discrete *const d = open_discrete(stiff, map, NULL);
    double x[6];
    memcpy(x, far, sizeof x);
    const int status = dal_discrete_advance(d, 0.0, 0.1, x, NULL);
    CHECK(status == DAL_EDOMAIN || status == DAL_ENOCONV); /* its solution is out there */
    CHECK(is.refused > 30 && memcmp(x, far, sizeof x) == 0);
}

static void test_errors(void)
{
    dal_system *const system = open_system("particle");
    const dal_difference_map half = rho_beta(0.5), outside = rho_beta(1.5), nan = rho_beta(NAN);
    dal_discrete *d = NULL;
    dal_error error = {0};
    CHECK(dal_discrete_new(NULL, system, &half, NULL, &error) == DAL_EINVAL);
    CHECK(strcmp(error.text, "discrete is NULL") == 0);
    CHECK(dal_discrete_new(&d, NULL, &half, NULL, &error) == DAL_EINVAL);
    CHECK(strcmp(error.text, "system is NULL") == 0);
    CHECK(dal_discrete_new(&d, system, NULL, &half, &error) == DAL_EINVAL);
    CHECK(strcmp(error.text, "lagrangian is NULL") == 0);
    CHECK(dal_discrete_new(&d, system, &outside, NULL, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "lagrangian->beta = 1.5") != NULL);
    CHECK(dal_discrete_new(&d, system, &half, &nan, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "constraint->beta = nan") != NULL && d == NULL);
    d = open_discrete(system, half, NULL);

    double x[6] = {0.5, 0.3, -0.2, 1, 0.7, 0.3}, q0[3] = {0, 0.3, 0}, q1[3] = {0.1, 0.4, 0.2};
    double out[64], nodes[12], one = 7.0;
    size_t done = 9;
    for (size_t i = 0; i < 64; i++) out[i] = 7.0;
#define NAMED(call, words)                                                        \
    CHECK((call) == DAL_EINVAL);                                                 \
    CHECK(strstr(dal_discrete_error(d)->text, words) != NULL)
    for (int k = 0; k < 3; k++) {
        const double h = (const double[]){0.0, NAN, INFINITY}[k];
        NAMED(dal_discrete_state(d, h, q0, q1, out), "h = ");
        NAMED(dal_discrete_nodes(d, 0.0, h, x, out, out + 3), "h = ");
        NAMED(dal_discrete_lagrangian(d, 0.0, h, q0, q1, out, NULL, NULL, NULL), "h = ");
        NAMED(dal_discrete_constraint(d, 0.0, h, q0, q1, out, NULL, NULL), "h = ");
        NAMED(dal_discrete_momenta(d, 0.0, h, q0, q1, out, NULL), "h = ");
        NAMED(dal_discrete_step(d, 0.0, h, q0, q1, out), "h = ");
        NAMED(dal_discrete_advance(d, 0.0, h, x, out), "h = ");
    }
    NAMED(dal_discrete_state(d, 0.1, NULL, q1, out), "q0 is NULL");
    NAMED(dal_discrete_state(d, 0.1, q0, NULL, out), "q1 is NULL");
    NAMED(dal_discrete_state(d, 0.1, q0, q1, NULL), "x is NULL");
    NAMED(dal_discrete_nodes(d, 0.0, 0.1, NULL, out, out), "x is NULL");
    NAMED(dal_discrete_nodes(d, 0.0, 0.1, x, NULL, out), "q0 is NULL");
    NAMED(dal_discrete_nodes(d, 0.0, 0.1, x, out, NULL), "q1 is NULL");
    NAMED(dal_discrete_momenta(d, NAN, 0.1, q0, q1, out, NULL), "t[0] = nan");
    NAMED(dal_discrete_momentum(d, 0.0, 0.1, q0, q1, NULL, q1, out, NULL), "xi0 is NULL");
    NAMED(dal_discrete_momentum(d, 0.0, 0.1, q0, q1, q0, NULL, out, NULL), "xi1 is NULL");
    NAMED(dal_discrete_residual(d, 0.0, 0.1, q0, q0, q1, out, NULL), "residual is NULL");
    NAMED(dal_discrete_residual(d, 0.0, 0.1, NULL, q0, q1, out, out), "q_before is NULL");
    NAMED(dal_discrete_residual(d, 0.0, 0.1, q0, NULL, q1, out, out), "q is NULL");
    NAMED(dal_discrete_residual(d, 0.0, 0.1, q0, q0, NULL, out, out), "q_after is NULL");
    NAMED(dal_discrete_residual(d, 0.0, 0.1, q0, q0, q1, NULL, out), "lambda is NULL");
    NAMED(dal_discrete_residual(d, INFINITY, 0.1, q0, q0, q1, out, out), "t[0] = inf");
    NAMED(dal_discrete_regularity(d, 0.0, 0.1, NULL, q1, out, NULL, NULL, NULL), "q is NULL");
    NAMED(dal_discrete_regularity(d, NAN, 0.1, q0, q1, out, NULL, NULL, NULL), "t[0] = nan");
    NAMED(dal_discrete_step(d, 0.0, 0.1, NULL, q1, out), "q0 is NULL");
    NAMED(dal_discrete_step(d, NAN, 0.1, q0, q1, out), "t[0] = nan");
    NAMED(dal_discrete_advance(d, 0.0, 0.1, NULL, out), "x is NULL");
    NAMED(dal_discrete_advance(d, NAN, 0.1, x, out), "t[0] = nan");
    NAMED(dal_discrete_run(d, 0.0, 0.1, 2, NULL, out, &done), "nodes is NULL");
    CHECK(done == 0);
    NAMED(dal_discrete_run(d, NAN, 0.1, 2, nodes, out, &done), "t0[0] = nan");
    x[4] = NAN;
    NAMED(dal_discrete_advance(d, 0.0, 0.1, x, out), "x[4] = nan");
    q1[2] = INFINITY;
    NAMED(dal_discrete_lagrangian(d, 0.0, 0.1, q0, q1, out, NULL, NULL, NULL), "q1[2] = inf");
    q1[2] = 0.2;
#undef NAMED
    for (size_t i = 0; i < 64; i++) CHECK(out[i] == 7.0);
    CHECK(dal_discrete_state(NULL, 0.1, q0, q1, x) == DAL_EINVAL);
    CHECK(dal_discrete_nodes(NULL, 0.0, 0.1, x, q0, q1) == DAL_EINVAL);
    CHECK(dal_discrete_lagrangian(NULL, 0.0, 0.1, q0, q1, NULL, NULL, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_discrete_constraint(NULL, 0.0, 0.1, q0, q1, NULL, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_discrete_momenta(NULL, 0.0, 0.1, q0, q1, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_discrete_momentum(NULL, 0.0, 0.1, q0, q1, q0, q1, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_discrete_residual(NULL, 0.0, 0.1, q0, q0, q1, x, out) == DAL_EINVAL);
    CHECK(dal_discrete_regularity(NULL, 0, 0.1, q0, q1, out, NULL, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_discrete_step(NULL, 0.0, 0.1, q0, q1, NULL) == DAL_EINVAL);
    CHECK(dal_discrete_run(NULL, 0.0, 0.1, 1, nodes, NULL, &done) == DAL_EINVAL);
    CHECK(dal_discrete_advance(NULL, 0.0, 0.1, x, NULL) == DAL_EINVAL);

    /* a pair off D_d: a step goes there, a run does not start */
    memcpy(nodes, q0, sizeof q0);
    memcpy(nodes + 3, q1, sizeof q1);
    nodes[6] = nodes[9] = 7.0;
    CHECK(dal_discrete_run(d, 0.0, 0.1, 2, nodes, out, &done) == DAL_EOFFD && done == 0);
    CHECK(strstr(dal_discrete_error(d)->text, "violates the discrete constraint") != NULL);
    CHECK(nodes[6] == 7.0 && out[0] == 7.0);
    CHECK(dal_discrete_step(d, 0.0, 0.1, q0, q1, NULL) == DAL_SUCCESS);
    CHECK(dal_discrete_constraint(d, 0.0, 0.1, q0, q1, &one, NULL, NULL) == DAL_SUCCESS);
    CHECK_NEAR(one, 0.0, ROUNDOFF / 0.1);
    /* nothing to do */
    GOOD(d, dal_discrete_constraint(d, 0.0, 0.1, q0, q1, NULL, NULL, NULL));
    memcpy(nodes, q0, sizeof q0);
    memcpy(nodes + 3, q1, sizeof q1);
    CHECK(dal_discrete_run(d, 0.0, 0.1, 0, nodes, NULL, NULL) == DAL_SUCCESS && nodes[6] == 7.0);
    /* How far off a run may start: the velocity is (1, 0.7, y), and lies in D with y = 0.3. */
    for (int k = 0; k < 2; k++) {
        const double off = k == 0 ? 1e-7 : 1e-10, start[6] = {0.5, 0.3, -0.2, 1, 0.7, 0.3 + off};
        CHECK(dal_discrete_nodes(d, 0.0, 0.1, start, nodes, nodes + 3) == DAL_SUCCESS);
        CHECK(dal_discrete_run(d, 0.0, 0.1, 2, nodes, NULL, &done) == (k == 0 ? DAL_EOFFD : 0));
    }
    /* an overflow is found */
    double fast[6] = {0, 0, 0, 0, 1e308, 0};
    CHECK(dal_discrete_advance(d, 0.0, 1e10, fast, NULL) < 0 && fast[4] == 1e308);

    /* also of the node alone, where no velocity overflows */
    const double unit[1] = {1.0};
    const dal_system_def free_def = {.n = 1, .mass = unit};
    const dal_difference_map explicit = rho_beta(0.0);
    dal_system *const free_body = new_system(&free_def);
    d = open_discrete(free_body, explicit, NULL);
    double far0[1] = {0.7e308}, far1[1] = {1.4e308};
    CHECK(dal_discrete_step(d, 0.0, 1e154, far0, far1, NULL) == DAL_EDOMAIN);
    CHECK(strstr(dal_discrete_error(d)->text, "is not finite") != NULL && far1[0] == 1.4e308);

    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-14);
    /* maps without an inverse: none at all, none for this h, where f turns back */
    const dal_difference_map flat = {.map = flat_map};
    double left[3] = {7, 7, 7}, right[3] = {7, 7, 7};
    d = open_discrete(system, flat, NULL);
    CHECK(dal_discrete_nodes(d, 0.0, 0.1, (double[]){0, 0, 0, 1, 1, 1}, left, right)
          == DAL_ESINGULAR);
    CHECK(strstr(dal_discrete_error(d)->text, "has no inverse") != NULL);
    size_t three = 3;
    const dal_difference_map mixed = {.map = mixed_map, .ctx = &three};
    d = open_discrete(system, mixed, NULL); /* d + d^2/9 >= -9/4 */
    CHECK(dal_discrete_nodes(d, 0.0, 1.0, (double[]){0, 0, 0, -3, -3, -3}, left, right) < 0);
    CHECK(left[0] == 7.0 && right[0] == 7.0);

    double v0[3] = {7, 7, 7};
    CHECK(dal_exact_velocity(NULL, 0.0, 0.1, q0, q1, v0, NULL) == DAL_EINVAL);
    CHECK(dal_exact_velocity(flow, 0.0, 0.1, NULL, q1, v0, NULL) == DAL_EINVAL);
    CHECK(strcmp(dal_flow_error(flow)->text, "q0 is NULL") == 0);
    CHECK(dal_exact_velocity(flow, 0.0, 0.1, q0, NULL, v0, NULL) == DAL_EINVAL);
    CHECK(dal_exact_velocity(flow, 0.0, 0.1, q0, q1, NULL, NULL) == DAL_EINVAL);
    CHECK(strcmp(dal_flow_error(flow)->text, "v0 is NULL") == 0);
    CHECK(dal_exact_velocity(flow, 0.0, 0.0, q0, q1, v0, NULL) == DAL_EINVAL);
    CHECK(strstr(dal_flow_error(flow)->text, "h = 0") != NULL && v0[0] == 7.0);

    /* no orbit of a spring reaches q1 in half a period unless q1 = -q0 */
    const double mass[1] = {1.0}, a[1] = {1.0}, b[1] = {2.0};
    double v[1] = {7.0};
    const dal_system_def def = {.n = 1, .mass = mass, .potential = spring,
                                .ctx = (void *)&(const double){1.0}};
    dal_system *const line = new_system(&def);
    dal_flow *const long_flow = open_flow(line, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-14);
    CHECK(dal_exact_velocity(long_flow, 0.0, 3.14159265358979, a, b, v, NULL) == DAL_ENOCONV);
    CHECK(strstr(dal_flow_error(long_flow)->text, "too large") != NULL && v[0] == 7.0);
    CHECK(dal_exact_velocity(long_flow, 0.0, 1.0, a, b, v, NULL) == DAL_SUCCESS);
    CHECK_NEAR(v[0], (b[0] - cos(1.0)) / sin(1.0), 1e-12);
    v[0] = 7.0;
    CHECK(dal_exact_velocity(long_flow, 0.0, 1e-290, a, (double[]){1e200}, v, NULL) < 0);
    CHECK(v[0] == 7.0);
}

int main(void)
{
    test_by_hand();
    test_second_node();
    test_singular();
    test_trapezoidal();
    test_rotations();
    test_translations();
    test_force_times();
    if (!brief()) test_energy();
    test_exact_particle();
    test_moods();
    test_errors();
    for (size_t s = 0; s < SYSTEMS; s++) {
        dal_system *const system = open_system(all_systems[s]);
        const size_t n = dal_system_n(system);
        size_t size = n;
        const dal_difference_map bent = {.map = bent_map, .ctx = &size, .beta = 0.5};
        for (size_t b = 0; b < BETAS; b++) {
            test_diagram(system, betas[b], 0.05);
            test_diagram(system, betas[b], -0.05);
            test_regularity(system, betas[b], 0.05);
            test_regularity(system, betas[b], -0.1);
        }
        test_step(system, rho_beta(0.3), NULL, 0.05);
        test_small_steps(system);
        test_step(system, bent, NULL, 0.05);
        test_derivatives(system, bent, NULL);
        test_inverse(system, bent);
        test_exact(system, strcmp(all_systems[s], "heisenberg") == 0);
        if (strcmp(all_systems[s], "robot") == 0) test_orders(system);
        release(system);
    }
    for (int k = 0; k < 16; k++) {
        rich is;
        const dal_constraint_kind kind = (dal_constraint_kind)(k % 4 % 3);
        const bool unconstrained = k % 4 == 3;
        dal_system *const system = open_rich(&is, !unconstrained, kind, k / 4 % 2);
        size_t size = 3;
        const dal_difference_map bent = {.map = bent_map, .ctx = &size, .beta = 0.5};
        const dal_difference_map mixed = {.map = mixed_map, .ctx = &size, .beta = 0.3};
        const dal_difference_map lazy = {.map = mixed_map, .ctx = &size, .differenced = 1};
        const dal_difference_map half = rho_beta(0.5), one = rho_beta(1.0);
        if (k >= 8) {
            if (k % 4 == 0) test_action(system);
            if (k >= 12) test_orders(system);
            release(system);
            continue;
        }
        test_derivatives(system, mixed, NULL);
        test_derivatives(system, bent, &mixed);
        test_derivatives(system, lazy, NULL);
        test_derivatives(system, rho_beta(0.3), &bent);
        test_inverse(system, bent);
        test_inverse(system, mixed);
        test_step(system, bent, NULL, 0.05);
        test_step(system, mixed, NULL, -0.1);
        test_step(system, bent, &half, 0.05);
        test_step(system, half, &mixed, 0.05);
        test_step(system, half, &one, 0.05);
        test_step(system, lazy, NULL, 0.05);
        if (unconstrained) {
            test_symplectic(system, bent, 0.1);
            test_symplectic(system, mixed, 0.1);
            test_symplectic(system, lazy, 0.1);
            for (size_t b = 0; b < BETAS; b++) test_symplectic(system, rho_beta(betas[b]), 0.2);
        } else {
            test_exact(system, false);
        }
        for (size_t b = 0; b < BETAS; b++) {
            test_diagram(system, betas[b], 0.05);
            test_diagram(system, betas[b], -0.05);
            test_regularity(system, betas[b], 0.1);
            test_regularity(system, betas[b], -0.1);
        }
        release(system);
    }
    return check_done();
}
