/* Systems beyond constant mass and linear constraints: a general Lagrangian, a force that depends
 * on t, q and v, affine and nonlinear constraints, against the same systems written otherwise,
 * against exact solutions, and against differences. */
#include "fixtures.h"
#include "check.h"
#include "discrete/discrete.h"

enum { MOST_N = 8, MOST_M = 4 };

static const char *const schemes[] = {"explicit", "midpoint", "endpoint", "0.3", "leapfrog",
                                      "leapfrog-mirror", "midpoint-suzuki4", "midpoint-nodes",
                                      "explicit-nodes", "endpoint-nodes"};
enum { SCHEMES = sizeof schemes / sizeof schemes[0] };

/* ---- a system of constant mass in disguise ------------------------------------------------ */

/* L = v^T M v / 2 - V as a Lagrangian of no known form. */
static int plain_lagrangian(double t, const double *q, const double *v, double *L, double *L_q,
                            double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                            void *ctx)
{
    const dal_system *const base = ctx;
    const size_t n = base->def.n;
    double V = 0.0, V_q[MOST_N] = {0.0}, V_qq[MOST_N * MOST_N] = {0.0}, p[MOST_N];
    if (base->def.potential) {
        const int returned = base->def.potential(t, q, &V, V_q, V_qq, base->def.ctx);
        if (returned) return returned;
    }
    dal__apply(n, n, base->mass, v, p);
    if (L) *L = 0.5 * dal__dot(n, v, p) - V;
    for (size_t i = 0; L_q && i < n; i++) L_q[i] = -V_q[i];
    if (L_v) memcpy(L_v, p, n * sizeof *p);
    for (size_t k = 0; L_qq && k < n * n; k++) L_qq[k] = -V_qq[k];
    if (L_vq) memset(L_vq, 0, n * n * sizeof *L_vq);
    if (L_vv) memcpy(L_vv, base->mass, n * n * sizeof *L_vv);
    return 0;
}

static int plain_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                            double *phi_q, double *phi_t, void *ctx)
{
    const dal_system *const base = ctx;
    double mu[MOST_M * MOST_N];
    const int returned = base->def.constraint(t, q, v, NULL, mu, phi_q, NULL, base->def.ctx);
    if (returned) return returned;
    if (phi) dal__apply(base->def.m, base->def.n, mu, v, phi);
    if (phi_v) memcpy(phi_v, mu, base->def.m * base->def.n * sizeof *mu);
    return 0;
}

static int no_push(double t, const double *q, const double *v, const double *u, double *f,
                    double *f_q, double *f_v, void *ctx)
{
    return zero_force(((const dal_system *)ctx)->def.n, f, f_q, f_v);
}

static int base_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                          void *ctx)
{
    const dal_system *const base = ctx;
    if (base->def.potential) return base->def.potential(t, q, V, V_q, V_qq, base->def.ctx);
    if (V) *V = 0.0;
    if (V_q) memset(V_q, 0, base->def.n * sizeof *V_q);
    if (V_qq) memset(V_qq, 0, base->def.n * base->def.n * sizeof *V_qq);
    return 0;
}

typedef enum disguise { LAGRANGIAN, FORCED, AFFINE, NONLINEAR, DIFFERENCED, DISGUISES } disguise;

static dal_system *open_disguise(const dal_system *base, disguise as)
{
    dal_system_def def = {.n = base->def.n, .m = base->def.m, .ctx = (void *)base,
                          .constraint = plain_constraint};
    if (as == LAGRANGIAN || as == DIFFERENCED) {
        def.lagrangian = plain_lagrangian;
    } else {
        def.mass = base->mass;
        def.potential = base_potential;
    }
    if (as == FORCED) def.force = no_push;
    if (as == AFFINE) def.kind = DAL_AFFINE;
    if (as == NONLINEAR) def.kind = DAL_NONLINEAR;
    if (as == DIFFERENCED)
        def.missing = DAL_MISSING_L_QQ | DAL_MISSING_L_VQ | DAL_MISSING_L_VV | DAL_MISSING_PHI_Q;
    return new_system(&def);
}

static int jet_of_base(double t, const double *q, const double *v, double *L, double *L_q,
                       double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                       void *ctx)
{
    const dal_system *const base = ctx;
    return base->def.lagrangian(t, q, v, L, L_q, L_v, L_qq, L_vq, L_vv, NULL, base->def.ctx);
}

/* A system with a general Lagrangian whose second derivatives are differenced. */
static dal_system *open_disguise_of_jet(const dal_system *base)
{
    const dal_system_def def = {.n = base->def.n, .m = base->def.m, .ctx = (void *)base,
                                .lagrangian = jet_of_base, .constraint = plain_constraint,
                                .missing = DAL_MISSING_L_QQ | DAL_MISSING_L_VQ | DAL_MISSING_L_VV
                                           | DAL_MISSING_PHI_Q};
    return new_system(&def);
}

/* The two step routines share no line, so their agreement says much: each step is solved to
 * roundoff, and ten of them move errors by little. */
static void test_same_steps(const char *name)
{
    dal_system *const base = open_system(name);
    const size_t n = base->def.n, m = base->def.m;
    double x0[2 * MOST_N];
    CHECK(dal_system_state(base, x0) == 0);
    if (sum_of_sizes(n, x0 + n) == 0.0) { /* the contact oscillator: at rest D_eps is D */
        dal_mechanics *const mech = open_mechanics(base);
        for (size_t i = 0; i < n; i++) x0[n + i] = 0.3 + 0.1 * (double)i;
        CHECK(dal_project(mech, 0.0, 0.0, x0, NULL) == 0);
        release(mech);
    }
    for (disguise as = LAGRANGIAN; as < DISGUISES; as++)
        for (size_t s = 0; s < SCHEMES; s++)
            for (int sign = -1; sign <= 1; sign += 2) {
                dal_system *const other = open_disguise(base, as);
                const dal_scheme scheme = find_scheme(schemes[s]);
                dal_stepper *const fast = open_stepper(base, &scheme, NULL);
                dal_stepper *const full = open_stepper(other, &scheme, NULL);
                dal_stepper *const check = open_stepper_by(BY_MULTIROOT, other, &scheme);
                dal_stepper *const steppers[3] = {fast, full, check};
                const bool kept = scheme.nodes == DAL_KEPT_NODES;
                double reaction[3][MOST_M] = {{0.0}};
                for (int k = 0; k < 3; k++) {
                    CHECK(dal_stepper_start(steppers[k], 0.0, 0.03 * sign, x0, DAL_CHECK,
                                            kept ? DAL_INITIAL_PROJECT : DAL_INITIAL_NONE) == 0);
                    CHECK(dal_advance(steppers[k], 10, reaction[k], NULL) == 0);
                }
                /* the Hessian of the particle oscillator is constant: h^2 V_qq < 1 throughout */
                const double scale = 1.0 + sum_of_sizes(2 * n, dal_stepper_state(fast));
                const double tolerance = (as == DIFFERENCED ? 1e-12 : 500 * U) * scale;
                for (int k = 1; k < 3; k++) {
                    CHECK_NEAR(largest_difference(2 * n, dal_stepper_state(fast),
                                                  dal_stepper_state(steppers[k])), 0.0, tolerance);
                    CHECK_NEAR(largest_difference(m, reaction[0], reaction[k]), 0.0,
                               tolerance / 0.03);
                }
                release(other);
            }
}

/* Energy, lambda, field, projections of a disguised system. */
static void test_same_mechanics(const char *name)
{
    dal_system *const base = open_system(name);
    const size_t n = base->def.n, m = base->def.m;
    dal_mechanics *const plain = open_mechanics(base);
    unsigned seed = 3;
    for (disguise as = LAGRANGIAN; as < DISGUISES; as++) {
        dal_system *const other = open_disguise(base, as);
        dal_mechanics *const mech = open_mechanics(other);
        const double tolerance = as == DIFFERENCED ? 1e-10 : 4000 * U;
        for (int trial = 0; trial < 20; trial++) {
            double x[2 * MOST_N], y[2 * MOST_N], a[2 * MOST_N], b[2 * MOST_N], d[2], E[2], power[2];
            double M[MOST_N * MOST_N], C[2][MOST_M * MOST_M];
            for (size_t i = 0; i < 2 * n; i++) x[i] = next_number(&seed);
            CHECK(dal_energy(plain, 0.0, x, E) == 0 && dal_energy(mech, 0.0, x, E + 1) == 0);
            CHECK_NEAR(E[0], E[1], 64 * U * (1.0 + fabs(E[0])));
            CHECK(dal_field(plain, 0.0, x, a) == 0 && dal_field(mech, 0.0, x, b) == 0);
            CHECK_NEAR(largest_difference(2 * n, a, b), 0.0,
                       tolerance * (1 + sum_of_sizes(2 * n, a)));
            CHECK(dal_multipliers(plain, 0.0, x, a) == 0 && dal_multipliers(mech, 0.0, x, b) == 0);
            CHECK_NEAR(largest_difference(m, a, b), 0.0, tolerance * (1 + sum_of_sizes(m, a)));
            CHECK(dal_gram(plain, 0.0, x, C[0]) == 0 && dal_gram(mech, 0.0, x, C[1]) == 0);
            CHECK_NEAR(largest_difference(m * m, C[0], C[1]), 0.0, tolerance * (1 + C[0][0]));
            CHECK(dal_metric(mech, 0.0, x, M) == 0);
            CHECK_NEAR(largest_difference(n * n, M, base->mass), 0.0, tolerance);
            CHECK(dal_power(mech, 0.0, x, power, power + 1) == 0);
            double mu_v[MOST_M], work = 0.0;
            CHECK(dal_residual(mech, 0.0, 0.0, x, mu_v) == 0);
            for (size_t k = 0; k < m; k++) work += b[k] * mu_v[k];
            CHECK_NEAR(power[0], work, tolerance * (1.0 + fabs(work)));
            CHECK(power[1] == 0.0);
            for (int kept = 0; kept < 2; kept++) {
                memcpy(y, x, sizeof y);
                memcpy(a, x, sizeof a);
                CHECK(dal_project(plain, 0.0, 0.05 * kept, a, d) == 0);
                CHECK(dal_project(mech, 0.0, 0.05 * kept, y, d + 1) == 0);
                CHECK_NEAR(largest_difference(2 * n, a, y), 0.0,
                           tolerance * (1.0 + sum_of_sizes(2 * n, a)));
                CHECK_NEAR(d[0], d[1], tolerance * (1.0 + d[0]));
            }
            unsigned char keep[MOST_N] = {0};
            keep[1] = 1;
            memcpy(y, x, sizeof y);
            memcpy(a, x, sizeof a);
            const int status = dal_consistent(plain, 0.0, keep, a, NULL);
            CHECK(dal_consistent(mech, 0.0, keep, y, NULL) == status);
            CHECK_NEAR(largest_difference(2 * n, a, y), 0.0,
                       tolerance * (1.0 + sum_of_sizes(2 * n, a)));
        }
        release(other);
    }
}

/* ---- a driven, damped oscillator: q'' + 2 c q' + k q = cos(w t) ---------------------------- */

static const double damping = 0.2, stiffness = 1.7, drive = 1.3;

static int sprung(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    if (V) *V = stiffness * q[0] * q[0] / 2;
    if (V_q) V_q[0] = stiffness * q[0];
    if (V_qq) V_qq[0] = stiffness;
    return 0;
}

static int damped_drive(double t, const double *q, const double *v, const double *u, double *f,
                        double *f_q, double *f_v, void *ctx)
{
    (void)q, (void)ctx;
    if (f) f[0] = cos(drive * t) - 2 * damping * v[0];
    if (f_q) f_q[0] = 0.0;
    if (f_v) f_v[0] = -2 * damping;
    return 0;
}

/* q = a cos(w t) + b sin(w t) + exp(-c t) (A cos(s t) + B sin(s t)), from (q, v) = x0 at t0. */
static void driven_exact(double t0, double t, const double *x0, double *x)
{
    const double w = drive, D = stiffness - w * w, d = 2 * damping * w, N = D * D + d * d;
    const double a = D / N, b = d / N, s = sqrt(stiffness - damping * damping);
    const double p0 = a * cos(w * t0) + b * sin(w * t0);
    const double r0 = w * (b * cos(w * t0) - a * sin(w * t0));
    const double A = x0[0] - p0, B = (x0[1] - r0 + damping * A) / s;
    const double e = exp(-damping * (t - t0)), c1 = cos(s * (t - t0)), s1 = sin(s * (t - t0));
    x[0] = a * cos(w * t) + b * sin(w * t) + e * (A * c1 + B * s1);
    x[1] = w * (b * cos(w * t) - a * sin(w * t)) + e * (-damping * (A * c1 + B * s1)
         + s * (B * c1 - A * s1));
}

/* The error at t = 3 of a run from t0 = 0.7, for two step sizes: their ratio tells the order. */
static void test_driven(unsigned missing)
{
    const double mass[1] = {1.0}, x0[2] = {0.4, -0.3}, t0 = 0.7, t1 = 3.7;
    const dal_system_def def = {.n = 1, .mass = mass, .potential = sprung, .force = damped_drive,
                                .missing = missing};
    dal_system *const system = new_system(&def);
    CHECK(dal_system_is_forced(system));
    double exact[2];
    driven_exact(t0, t1, x0, exact);
    double x[2] = {x0[0], x0[1]};
    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-13);
    CHECK(dal_flow_apply(flow, t0, t1, x, NULL) == 0);
    CHECK_NEAR(largest_difference(2, x, exact), 0.0, 1e-12);
    static const struct {
        const char *scheme;
        int order;
    } cases[] = {{"explicit", 1}, {"endpoint", 1}, {"0.3", 1}, {"midpoint", 2}, {"leapfrog", 2},
                 {"leapfrog-mirror", 2}, {"midpoint-suzuki4", 4}, {"leapfrog-yoshida4", 4},
                 {"leapfrog-kl6", 6}, {"midpoint-nodes", 1}};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        const dal_scheme scheme = find_scheme(cases[k].scheme);
        double error[2];
        for (int fine = 0; fine < 2; fine++) {
            const size_t steps = fine ? 60 : 30;
            dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
            CHECK(dal_stepper_start(stepper, t0, (t1 - t0) / (double)steps, x0, DAL_CHECK,
                                    scheme.nodes == DAL_KEPT_NODES ? DAL_INITIAL_D
                                                                   : DAL_INITIAL_NONE) == 0);
            CHECK(dal_advance(stepper, steps, NULL, NULL) == 0);
            error[fine] = largest_difference(2, dal_stepper_state(stepper), exact);
            const dal_stats stats = stats_of(stepper);
            CHECK(stats.force_calls > 0 && stats.lagrangian_calls == 0);
            CHECK(stats.differenced == missing);
            release(stepper);
        }
        const double order = log2(error[0] / error[1]);
        check_true(order > cases[k].order - 0.2 && order < cases[k].order + 0.4, cases[k].scheme,
                   "order of the driven oscillator", (int)(100 * order));
    }
}

/* dE/dt = f . v: the power that dal_power reports is the slope of the energy along the flow. */
static void test_power_of_force(void)
{
    const double mass[1] = {1.0};
    const dal_system_def def = {.n = 1, .mass = mass, .potential = sprung, .force = damped_drive};
    dal_system *const system = new_system(&def);
    dal_mechanics *const mech = open_mechanics(system);
    const double x0[2] = {0.4, -0.3}, d = 1e-3, t = 0.9;
    double power, E[5];
    for (int k = -2; k <= 2; k++) {
        double x[2];
        driven_exact(t, t + k * d, x0, x);
        CHECK(dal_energy(mech, 0.0, x, &E[k + 2]) == 0);
    }
    CHECK(dal_power(mech, t, x0, NULL, &power) == 0);
    CHECK_NEAR(power, (8 * (E[3] - E[1]) - (E[4] - E[0])) / (12 * d), 1e-11);
    CHECK(dal_power(mech, NAN, x0, NULL, &power) == DAL_EINVAL);
    CHECK(strstr(dal_mechanics_error(mech)->text, "t[0] = nan") != NULL);
    CHECK(dal_power(NULL, t, x0, NULL, &power) == DAL_EINVAL);
    CHECK(dal_metric(NULL, 0.0, x0, &power) == DAL_EINVAL
          && dal_metric(mech, 0.0, x0, NULL) == DAL_EINVAL);
}

/* ---- a general system: M(q), gyroscopic terms, a force, a nonlinear constraint -------------- */

/* L = (1 + x^2/4) v_x^2/2 + v_y^2/2 + (2 + sin x) v_z^2/2 + v_x v_y/5 + y v_x/3 - x z v_y/4 - V,
 * V = (x^2 + 2 y^2 + z^2)/2 + x y z/3. */
static int curved_lagrangian(double t, const double *q, const double *v, double *L, double *L_q,
                             double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                             void *ctx)
{
    const double x = q[0], y = q[1], z = q[2], a = v[0], b = v[1], c = v[2];
    (void)ctx;
    if (L)
        *L = (1 + x * x / 4) * a * a / 2 + b * b / 2 + (2 + sin(x)) * c * c / 2 + a * b / 5
           + y * a / 3 - x * z * b / 4 - (x * x + 2 * y * y + z * z) / 2 - x * y * z / 3;
    if (L_q) {
        L_q[0] = x * a * a / 4 + cos(x) * c * c / 2 - z * b / 4 - x - y * z / 3;
        L_q[1] = a / 3 - 2 * y - x * z / 3;
        L_q[2] = -x * b / 4 - z - x * y / 3;
    }
    if (L_v) {
        L_v[0] = (1 + x * x / 4) * a + b / 5 + y / 3;
        L_v[1] = b + a / 5 - x * z / 4;
        L_v[2] = (2 + sin(x)) * c;
    }
    if (L_qq) {
        const double values[9] = {a * a / 4 - sin(x) * c * c / 2 - 1, -z / 3, -b / 4 - y / 3,
                                  -z / 3, -2, -x / 3, -b / 4 - y / 3, -x / 3, -1};
        memcpy(L_qq, values, sizeof values);
    }
    if (L_vq) {
        const double values[9] = {x * a / 2, 1.0 / 3, 0, -z / 4, 0, -x / 4, cos(x) * c, 0, 0};
        memcpy(L_vq, values, sizeof values);
    }
    if (L_vv) {
        const double values[9] = {1 + x * x / 4, 0.2, 0, 0.2, 1, 0, 0, 0, 2 + sin(x)};
        memcpy(L_vv, values, sizeof values);
    }
    return 0;
}

static int curved_force(double t, const double *q, const double *v, const double *u, double *f,
                        double *f_q, double *f_v, void *ctx)
{
    (void)ctx;
    if (f) {
        f[0] = cos(t) - v[0] / 5 + q[1] * v[2] / 7;
        f[1] = -v[1] * v[1] * v[1] / 9;
        f[2] = sin(t) * q[0];
    }
    if (f_q) {
        memset(f_q, 0, 9 * sizeof *f_q);
        f_q[1] = v[2] / 7;
        f_q[6] = sin(t);
    }
    if (f_v) {
        memset(f_v, 0, 9 * sizeof *f_v);
        f_v[0] = -0.2;
        f_v[2] = q[1] / 7;
        f_v[4] = -v[1] * v[1] / 3;
    }
    return 0;
}

/* phi = v_z - y v_x + v_x v_y^2/5 - 1/10 */
static int curved_constraint(double t, const double *q, const double *v, double *phi,
                             double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    if (phi) phi[0] = v[2] - q[1] * v[0] + v[0] * v[1] * v[1] / 5 - 0.1;
    if (phi_v) {
        phi_v[0] = -q[1] + v[1] * v[1] / 5;
        phi_v[1] = 2 * v[0] * v[1] / 5;
        phi_v[2] = 1.0;
    }
    if (phi_q) {
        memset(phi_q, 0, 3 * sizeof *phi_q);
        phi_q[1] = -v[0];
    }
    return 0;
}

static dal_system *open_curved(unsigned missing, bool forced)
{
    const dal_system_def def = {.n = 3, .m = 1, .lagrangian = curved_lagrangian,
                                .force = forced ? curved_force : NULL,
                                .constraint = curved_constraint, .kind = DAL_NONLINEAR,
                                .missing = missing};
    return new_system(&def);
}

static const double curved_start[6] = {0.3, 0.4, -0.2, 0.8, 0.5, 0.38};

/* K and B are the derivatives of R1 and R2 in w, by differences of order 4. */
static void check_step_derivatives(const dal_system *system, const double *x, const double *w,
                                   const double *kappa)
{
    enum { MOST = 4 };
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    dal_mechanics *const mech = open_mechanics(system);
    const double d = 1e-3, h = 0.2, t = 0.3;
    for (int b = 0; b <= 4; b++) {
        const double beta = 0.25 * b;
        double K[MOST * MOST], B[MOST * MOST];
        CHECK(dal_step_equations(mech, t, beta, h, x, w, kappa, NULL, NULL, K, B, NULL) == 0);
        for (size_t j = 0; j < n; j++) {
            double slope[2 * MOST] = {0.0};
            static const int at[4] = {1, -1, 2, -2}, weight[4] = {8, -8, -1, 1};
            for (int k = 0; k < 4; k++) {
                double moved[MOST], R1[MOST], R2[MOST];
                memcpy(moved, w, n * sizeof *moved);
                moved[j] += at[k] * d;
                CHECK(dal_step_equations(mech, t, beta, h, x, moved, kappa, R1, R2, NULL, NULL,
                                         NULL) == 0);
                for (size_t i = 0; i < n; i++) slope[i] += weight[k] * R1[i] / (12 * d);
                for (size_t a = 0; a < m; a++) slope[n + a] += weight[k] * R2[a] / (12 * d);
            }
            for (size_t i = 0; i < n; i++) CHECK_NEAR(K[i * n + j], slope[i], 1e-8);
            for (size_t a = 0; a < m; a++) CHECK_NEAR(B[a * n + j], slope[n + a], 1e-10);
        }
    }
    release(mech);
}

static void test_step_derivatives(void)
{
    double x[8];
    generic4_state(x);
    check_step_derivatives(open_curved(0, true), curved_start, (double[]){0.7, 0.6, 0.4},
                           (double[]){0.07});
    check_step_derivatives(open_deformed_nodes(open_system("generic4"), 0.3), x,
                           (double[]){0.5, -0.2, 0.4, 0.3}, (double[]){0.07, -0.05});
}

/* The flow stays in D though nothing projects it on the way, and keeps dE/dt = the two powers. */
static void test_curved_flow(void)
{
    dal_system *const system = open_curved(0, true);
    dal_mechanics *const mech = open_mechanics(system);
    double x[6], E[5], power[2], residual;
    const double d = 1e-2, t = 0.4;
    memcpy(x, curved_start, sizeof x);
    CHECK(dal_project(mech, 0.0, 0.0, x, NULL) == 0);
    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-13);
    for (int k = -2; k <= 2; k++) {
        double y[6];
        memcpy(y, x, sizeof y);
        CHECK(dal__flow_apply(flow, t, k * d, y, false) == 0);
        CHECK(dal_relative_residual(mech, 0.0, 0.0, y, &residual) == 0 && residual < 1e-12);
        CHECK(dal_energy(mech, 0.0, y, &E[k + 2]) == 0);
    }
    CHECK(dal_power(mech, t, x, power, power + 1) == 0);
    CHECK(fabs(power[0]) > 1e-2 && fabs(power[1]) > 1e-2);
    CHECK_NEAR(power[0] + power[1], (8 * (E[3] - E[1]) - (E[4] - E[0])) / (12 * d), 1e-7);
}

/* The orders at t = 1 and D at every step, from the flow; adjointness on D. */
static void test_curved_orders(unsigned missing)
{
    dal_system *const system = open_curved(missing, true);
    dal_mechanics *const mech = open_mechanics(system);
    double start[6], exact[6];
    memcpy(start, curved_start, sizeof start);
    CHECK(dal_project(mech, 0.0, 0.0, start, NULL) == 0);
    memcpy(exact, start, sizeof exact);
    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-13);
    CHECK(dal_flow_apply(flow, 0.5, 1.5, exact, NULL) == 0);
    static const struct {
        const char *scheme;
        int order;
    } cases[] = {{"explicit", 1}, {"endpoint", 1}, {"midpoint", 2}, {"leapfrog", 2},
                 {"leapfrog-mirror", 2}, {"midpoint-suzuki4", 4}, {"midpoint-kl6", 6},
                 {"midpoint-nodes", 1}};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        const dal_scheme scheme = find_scheme(cases[k].scheme);
        const bool kept = scheme.nodes == DAL_KEPT_NODES;
        double error[2];
        for (int fine = 0; fine < 2; fine++) {
            const size_t steps = fine ? 40 : 20;
            const double h = 1.0 / (double)steps;
            dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
            CHECK(dal_stepper_start(stepper, 0.5, h, start, DAL_CHECK,
                                    kept ? DAL_INITIAL_PROJECT : DAL_INITIAL_NONE) == 0);
            for (size_t step = 1; step <= steps; step++) {
                double relative;
                CHECK(dal_step(stepper, NULL) == 0);
                CHECK(dal_relative_residual(mech, 0.0, kept ? 0.5 * h : 0.0,
                                            dal_stepper_state(stepper),
                                            &relative) == 0);
                CHECK(relative <= DAL_RESIDUAL_BOUND(3));
            }
            error[fine] = largest_difference(6, dal_stepper_state(stepper), exact);
            release(stepper);
        }
        const double order = log2(error[0] / error[1]);
        check_true(order > cases[k].order - 0.25 && order < cases[k].order + 0.6, cases[k].scheme,
                   "order of the curved system", (int)(100 * order));
    }
}

/* Phi_{1-beta,-h} undoes Phi_{beta,h} on D, with forces at their times. */
static void test_adjoint(void)
{
    dal_system *const system = open_curved(0, true);
    dal_mechanics *const mech = open_mechanics(system);
    double start[6];
    memcpy(start, curved_start, sizeof start);
    CHECK(dal_project(mech, 0.0, 0.0, start, NULL) == 0);
    for (int b = 0; b <= 4; b++) {
        const dal_scheme there = {.beta = 0.25 * b}, back = {.beta = 1.0 - 0.25 * b};
        const double h = 0.1, t = 0.3;
        double lambda[2];
        dal_stepper *const forth = open_stepper(system, &there, NULL);
        dal_stepper *const return_ = open_stepper(system, &back, NULL);
        CHECK(dal_stepper_start(forth, t, h, start, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        CHECK(dal_step(forth, lambda) == 0);
        CHECK(dal_stepper_start(return_, t + h, -h, dal_stepper_state(forth), DAL_CHECK,
                                DAL_INITIAL_NONE) == 0);
        CHECK(dal_step(return_, lambda + 1) == 0);
        CHECK_NEAR(largest_difference(6, dal_stepper_state(return_), start), 0.0, 64 * U);
        CHECK_NEAR(lambda[0], lambda[1], 64 * U / h);
        release(return_);
    }
}

/* ---- what goes wrong ------------------------------------------------------------------------ */

typedef enum fault { REFUSES, STOPS, NOT_FINITE, FORGETS } fault;
typedef enum callback { OF_LAGRANGIAN, OF_FORCE, OF_CONSTRAINT } callback;

typedef struct saboteur {
    callback where;
    fault what;
    size_t from, calls; /* faults from that call of the callback on */
    size_t stops;
} saboteur;

static int sabotage(saboteur *s, callback where, double *output)
{
    if (s->where != where || s->calls++ < s->from || !output) return 0;
    if (s->what == REFUSES) return 1;
    if (s->what == STOPS) return s->stops++, -1;
    output[0] = s->what == NOT_FINITE ? INFINITY : NAN;
    return 0;
}

static int faulty_lagrangian(double t, const double *q, const double *v, double *L, double *L_q,
                             double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                             void *ctx)
{
    curved_lagrangian(t, q, v, L, L_q, L_v, L_qq, L_vq, L_vv, NULL, NULL);
    return sabotage(ctx, OF_LAGRANGIAN, L_q ? L_q : L_v ? L_v : L_vv);
}

static int faulty_force(double t, const double *q, const double *v, const double *u, double *f,
                        double *f_q, double *f_v, void *ctx)
{
    curved_force(t, q, v, u, f, f_q, f_v, NULL);
    return sabotage(ctx, OF_FORCE, f ? f : f_v);
}

static int faulty_constraint(double t, const double *q, const double *v, double *phi,
                             double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    curved_constraint(t, q, v, phi, phi_v, phi_q, NULL, NULL);
    return sabotage(ctx, OF_CONSTRAINT, phi ? phi : phi_v);
}

/* Whatever a callback does and whenever, the state stays, and the message names the callback. */
static void test_sabotage(void)
{
    static const char *const names[] = {"lagrangian", "force", "constraint"};
    for (int multi = 0; multi < 2; multi++)
        for (callback where = OF_LAGRANGIAN; where <= OF_CONSTRAINT; where++)
            for (fault what = REFUSES; what <= FORGETS; what++)
                for (size_t from = 0; from < 20; from += 2) {
                    saboteur s = {.where = where, .what = what, .from = SIZE_MAX};
                    const dal_system_def def = {
                        .n = 3, .m = 1, .lagrangian = faulty_lagrangian, .force = faulty_force,
                        .constraint = faulty_constraint, .kind = DAL_NONLINEAR, .ctx = &s};
                    dal_system *const system = new_system(&def);
                    const dal_scheme scheme = find_scheme("midpoint-suzuki4");
                    dal_stepper *const stepper =
                        open_stepper_by(multi ? BY_MULTIROOT : BY_LIBRARY, system, &scheme);
                    CHECK(dal_stepper_start(stepper, 0.0, 0.1, curved_start, DAL_PROJECT,
                                            DAL_INITIAL_NONE) == 0);
                    CHECK(dal_step(stepper, NULL) == 0);
                    double before[6], reaction = 7.0;
                    memcpy(before, dal_stepper_state(stepper), sizeof before);
                    s.calls = 0;
                    s.from = from;
                    CHECK(dal_step(stepper, &reaction)
                          == (what == STOPS ? DAL_EUSER : DAL_EDOMAIN));
                    CHECK(s.stops == (what == STOPS)); /* stop means stop */
                    CHECK(reaction == 7.0 && dal_stepper_time(stepper) == 0.1);
                    CHECK(!memcmp(before, dal_stepper_state(stepper), sizeof before));
                    check_true(strstr(dal_stepper_error(stepper)->text, names[where]) != NULL,
                               dal_stepper_error(stepper)->text, names[where], __LINE__);
                    s.from = SIZE_MAX;
                    CHECK(dal_step(stepper, &reaction) == 0);
                    release(system);
                }
}

static int late_force(double t, const double *q, const double *v, const double *u, double *f,
                      double *f_q, double *f_v, void *ctx)
{
    if (!(t >= 2.0)) return 1;
    return curved_force(t, q, v, u, f, *(const bool *)ctx ? NULL : f_q, f_v, NULL);
}

static int forgetful_lagrangian(double t, const double *q, const double *v, double *L, double *L_q,
                                double *L_v, double *L_qq, double *L_vq, double *L_vv,
                                double *L_vt, void *ctx)
{
    return curved_lagrangian(t, q, v, L, L_q, L_v, L_qq, NULL, L_vv, NULL, ctx);
}

/* What callbacks never write is found at the start, where the force sees the time of the start. */
static void test_probes(void)
{
    static const char *const words[] = {"", "f_q", "L_vq"};
    for (int lacking = 0; lacking < 3; lacking++) {
        bool forgets = lacking == 1;
        const dal_system_def def = {.n = 3, .m = 1, .force = late_force, .kind = DAL_NONLINEAR,
                                    .lagrangian = lacking == 2 ? forgetful_lagrangian
                                                               : curved_lagrangian,
                                    .constraint = curved_constraint, .ctx = &forgets};
        dal_system *const system = new_system(&def);
        dal_stepper *const stepper = open_named(system, "explicit");
        const int status = dal_stepper_start(stepper, 2.0, 0.1, curved_start, DAL_PROJECT,
                                             DAL_INITIAL_NONE);
        CHECK(status == (lacking ? DAL_EDOMAIN : DAL_SUCCESS));
        CHECK(strstr(dal_stepper_error(stepper)->text, words[lacking]) != NULL);
        release(system);
    }
}

/* L_vv = diag(1, x): singular at x = 0, indefinite beyond. */
static int degenerate_lagrangian(double t, const double *q, const double *v, double *L,
                                 double *L_q, double *L_v, double *L_qq, double *L_vq,
                                 double *L_vv, double *L_vt, void *ctx)
{
    if (L) *L = v[0] * v[0] / 2 + q[0] * v[1] * v[1] / 2;
    if (L_q) {
        L_q[0] = v[1] * v[1] / 2;
        L_q[1] = 0.0;
    }
    if (L_v) {
        L_v[0] = v[0];
        L_v[1] = q[0] * v[1];
    }
    if (L_qq) memset(L_qq, 0, 4 * sizeof *L_qq);
    if (L_vq) {
        memset(L_vq, 0, 4 * sizeof *L_vq);
        L_vq[2] = v[1];
    }
    if (L_vv) {
        memset(L_vv, 0, 4 * sizeof *L_vv);
        L_vv[0] = 1.0;
        L_vv[3] = q[0];
    }
    return 0;
}

static void test_degenerate(void)
{
    const dal_system_def def = {.n = 2, .lagrangian = degenerate_lagrangian};
    dal_system *const system = new_system(&def);
    CHECK(mass_of(system) == NULL);
    dal_mechanics *const mech = open_mechanics(system);
    double out[4] = {7, 7, 7, 7}, x[4] = {0.0, 0.0, 1.0, 1.0};
    for (int sign = -1; sign <= 0; sign++) {
        x[0] = sign;
        CHECK(dal_metric(mech, 0.0, x, out) == DAL_ESINGULAR);
        CHECK(dal_field(mech, 0.0, x, out) == DAL_ESINGULAR);
        CHECK(strstr(dal_mechanics_error(mech)->text, "pivot 1") != NULL);
        CHECK(out[0] == 7.0 && out[3] == 7.0);
    }
    x[0] = 2.0;
    CHECK(dal_metric(mech, 0.0, x, out) == 0 && out[3] == 2.0);
}

/* Newton fails for a step that is far too long; with max_iterations it says how many it had. */
static void test_too_long(void)
{
    dal_system *const system = open_curved(0, false);
    const dal_scheme scheme = find_scheme("midpoint");
    const dal_options few = {.max_iterations = 2};
    dal_stepper *const stepper = open_stepper(system, &scheme, &few);
    CHECK(dal_stepper_start(stepper, 0.0, 2.0, curved_start, DAL_PROJECT, DAL_INITIAL_NONE) == 0);
    CHECK(dal_step(stepper, NULL) == DAL_ENOCONV);
    const char *const text = dal_stepper_error(stepper)->text;
    CHECK(strstr(text, "step 1 (t = 0, h = 2): Newton did not converge in 2 ") != NULL);
    CHECK(!dal_scheme_is_explicit(&scheme, system));
    const dal_scheme explicit_ = find_scheme("explicit");
    CHECK(!dal_scheme_is_explicit(&explicit_, system));
}

/* ---- units ----------------------------------------------------------------------------------
 * Another system in units of powers of two, of its coordinates and of its constraints. */

typedef struct other_units {
    const dal_system *base;
    double of_q[MOST_N], of_phi[MOST_M]; /* q of base = of_q q; phi = of_phi phi of base */
} other_units;

static void to_base(const other_units *u, const double *x, double *y)
{
    for (size_t i = 0; i < u->base->def.n; i++) y[i] = u->of_q[i] * x[i];
}

static void scale_matrix(const other_units *u, double *A)
{
    const size_t n = u->base->def.n;
    for (size_t k = 0; A && k < n * n; k++) A[k] *= u->of_q[k / n] * u->of_q[k % n];
}

static int scaled_constraint(double t, const double *q, const double *v, double *phi,
                             double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    const other_units *const u = ctx;
    const size_t n = u->base->def.n, m = u->base->def.m;
    double at[MOST_N] = {0}, along[MOST_N] = {0};
    to_base(u, q, at);
    to_base(u, v, along);
    const int returned = plain_constraint(t, at, along, phi, phi_v, phi_q, NULL, (void *)u->base);
    for (size_t a = 0; phi && a < m; a++) phi[a] *= u->of_phi[a];
    for (size_t k = 0; k < m * n; k++) {
        if (phi_v) phi_v[k] *= u->of_phi[k / n] * u->of_q[k % n];
        if (phi_q) phi_q[k] *= u->of_phi[k / n] * u->of_q[k % n];
    }
    return returned;
}

static int scaled_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                            void *ctx)
{
    const other_units *const u = ctx;
    double at[MOST_N];
    to_base(u, q, at);
    const int returned = base_potential(t, at, V, V_q, V_qq, (void *)u->base);
    if (V_q) to_base(u, V_q, V_q);
    scale_matrix(u, V_qq);
    return returned;
}

static int scaled_lagrangian(double t, const double *q, const double *v, double *L, double *L_q,
                             double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                             void *ctx)
{
    const other_units *const u = ctx;
    double at[MOST_N], along[MOST_N];
    to_base(u, q, at);
    to_base(u, v, along);
    const int returned = plain_lagrangian(t, at, along, L, L_q, L_v, L_qq, L_vq, L_vv,
                                          NULL, (void *)u->base);
    if (L_q) to_base(u, L_q, L_q);
    if (L_v) to_base(u, L_v, L_v);
    scale_matrix(u, L_qq);
    scale_matrix(u, L_vq);
    scale_matrix(u, L_vv);
    return returned;
}

static int scaled_no_push(double t, const double *q, const double *v, const double *u, double *f,
                           double *f_q, double *f_v, void *ctx)
{
    return no_push(t, q, v, u, f, f_q, f_v, (void *)((const other_units *)ctx)->base);
}

static dal_system *open_scaled(const other_units *u, disguise as)
{
    const dal_system *const base = u->base;
    double mass[MOST_N * MOST_N];
    memcpy(mass, base->mass, base->def.n * base->def.n * sizeof *mass);
    scale_matrix(u, mass);
    dal_system_def def = {.n = base->def.n, .m = base->def.m, .ctx = (void *)u,
                          .constraint = scaled_constraint};
    if (as == LAGRANGIAN) def.lagrangian = scaled_lagrangian;
    else def.mass = mass, def.potential = scaled_potential;
    if (as == FORCED) def.force = scaled_no_push;
    if (as == AFFINE) def.kind = DAL_AFFINE;
    return new_system(&def);
}

/* From x one step of a chart to y, and one of pairs of nodes to z. */
static void step_otherwise(const dal_system *system, const double *x, double *y, double *z)
{
    const dal_difference_map map = {.beta = 0.5};
    const size_t n = system->def.n;
    double xi[2 * MOST_N];
    dal_chart *const chart = open_chart(system);
    dal_discrete *const discrete = open_discrete(system, map, NULL);
    memcpy(y, x, 2 * n * sizeof *y);
    memcpy(z, x, 2 * n * sizeof *z);
    CHECK(dal_chart_choose(chart, 0.0, NULL, y) == 0 && dal_chart_drop(chart, y, xi) == 0);
    CHECK(dal_chart_step(chart, 0.0, 0.5, 0.1, xi, NULL) == 0);
    CHECK(dal_chart_lift(chart, 0.0, xi, y) == 0);
    CHECK(dal_discrete_advance(discrete, 0.0, 0.1, z, NULL) == 0);
}

/* Steps do not depend on units, to the last bit and to the last iteration; nor, all coordinates in
 * the same unit, far from the origin, where how far a rounding of q moves things decides when an
 * iteration has ended.  Sizes that are found, of the matrix for pairs of nodes, decide between
 * equal pivots. */
static void test_units(const char *name, int most, double far)
{
    dal_system *const base = open_system(name);
    const size_t n = base->def.n, m = base->def.m;
    other_units plain = {.base = base}, u = {.base = base};
    double x0[2 * MOST_N], y0[2 * MOST_N];
    CHECK(dal_system_state(base, x0) == 0);
    for (size_t i = 0; i < n; i++) x0[i] += far * (i % 2 ? 1.0 : 1.37);
    for (size_t i = 0; i < n; i++) {
        plain.of_q[i] = 1.0;
        u.of_q[i] = ldexp(1.0, far > 0.0 ? most : most * (int)((i + 1) % 3 - 1));
        y0[i] = x0[i] / u.of_q[i];
        y0[n + i] = x0[n + i] / u.of_q[i];
    }
    for (size_t a = 0; a < m; a++) {
        plain.of_phi[a] = 1.0;
        u.of_phi[a] = ldexp(1.0, a % 2 ? most : -most);
    }
    static const disguise disguises[] = {LAGRANGIAN, FORCED, AFFINE};
    for (size_t j = 0; j < 3; j++)
        for (size_t s = 0; s < SCHEMES; s++) {
            const dal_scheme scheme = find_scheme(schemes[s]);
            const bool kept = scheme.nodes == DAL_KEPT_NODES;
            dal_system *const systems[2] = {open_scaled(&plain, disguises[j]),
                                            open_scaled(&u, disguises[j])};
            double end[2][2 * MOST_N], other[2][2 * MOST_N], pairs[2][2 * MOST_N];
            double lambda[2][MOST_M];
            dal_stats stats[2];
            for (int k = 0; k < 2; k++) {
                dal_stepper *const stepper = open_stepper(systems[k], &scheme, NULL);
                CHECK(dal_stepper_start(stepper, 0.0, 0.1, k ? y0 : x0, DAL_PROJECT,
                                        kept ? DAL_INITIAL_PROJECT : DAL_INITIAL_NONE) == 0);
                CHECK(dal_advance(stepper, 50, lambda[k], NULL) == 0);
                dal_stepper_stats(stepper, &stats[k]);
                memcpy(end[k], dal_stepper_state(stepper), 2 * n * sizeof(double));
                if (!kept) step_otherwise(systems[k], end[k], other[k], pairs[k]);
                end[k][n] *= 1.1; /* and from there onto D_eps */
                dal_mechanics *const mech = open_mechanics(systems[k]);
                CHECK(dal_project(mech, 0.0, 0.05, end[k], NULL) == 0);
            }
            release(systems[0]);
            for (size_t i = 0; i < 2 * n; i++) end[1][i] *= u.of_q[i % n];
            CHECK(stats[0].iterations == stats[1].iterations);
            CHECK(stats[0].full_newtons == stats[1].full_newtons);
            for (size_t i = 0; !kept && i < 2 * n; i++) {
                CHECK(other[0][i] == other[1][i] * u.of_q[i % n]);
                CHECK_NEAR(pairs[0][i], pairs[1][i] * u.of_q[i % n],
                           1e2 * U * (1.0 + far + fabs(pairs[0][i])));
            }
            for (size_t a = 0; a < m; a++) lambda[1][a] *= u.of_phi[a];
            CHECK(memcmp(end[0], end[1], 2 * n * sizeof(double)) == 0);
            CHECK(memcmp(lambda[0], lambda[1], m * sizeof(double)) == 0);
        }
}

/* ---- how many iterations --------------------------------------------------------------------- */

static int weight(double t, const double *q, const double *v, const double *u, double *f,
                  double *f_q, double *f_v, void *ctx)
{
    (void)t, (void)q, (void)v;
    if (f) f[0] = *(const double *)ctx;
    if (f_q) f_q[0] = 0.0;
    if (f_v) f_v[0] = 0.0;
    return 0;
}

/* What falls is where it was expected, also where the steps of a scheme differ and go back: one
 * correction, and one look. */
static void test_guess(void)
{
    enum { STEPS = 10, SUBSTEPS = 5 };
    const double mass[1] = {2.0}, x[2] = {0.0, 0.3};
    double g = 9.81;
    size_t calls = 0;
    const dal_system_def def = {.n = 1, .mass = mass, .force = weight, .ctx = &g};
    dal_system *const system = new_system(&def);
    for (int start = 0; start < 2; start++) {
    dal_stepper *const stepper = start_named(system, "midpoint-suzuki4", 0.1, x);
        CHECK(dal_advance(stepper, STEPS, NULL, NULL) == 0);
        CHECK(stats_of(stepper).iterations == SUBSTEPS * STEPS);
        if (start == 0) calls = stats_of(stepper).force_calls;
        CHECK(calls > SUBSTEPS * STEPS && stats_of(stepper).force_calls == calls);
        CHECK_NEAR(dal_stepper_state(stepper)[1], x[1] + g / mass[0] * STEPS * 0.1, 1e-13);
    }
}

static int weight_until(double t, const double *q, const double *v, const double *u, double *f,
                        double *f_q, double *f_v, void *ctx)
{
    double g = 9.81;
    return t <= *(const double *)ctx ? weight(t, q, v, u, f, f_q, f_v, &g) : 1;
}

/* A step that fails after its first sub-step takes no guess from it: it was undone. */
static void test_guess_after_failure(void)
{
    enum { SUBSTEPS = 5 };
    const double mass[1] = {2.0}, x[2] = {0.0, 0.3}, h = 0.1;
    double end = HUGE_VAL;
    const dal_system_def def = {.n = 1, .mass = mass, .force = weight_until, .ctx = &end};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = start_named(system, "midpoint-suzuki4", h, x);
    CHECK(dal_step(stepper, NULL) == 0);
    end = 1.6 * h; /* in the second sub-step of the second step */
    CHECK(dal_step(stepper, NULL) == DAL_EDOMAIN);
    const size_t before = stats_of(stepper).iterations;
    end = HUGE_VAL;
    CHECK(dal_step(stepper, NULL) == 0);
    CHECK(stats_of(stepper).iterations == before + SUBSTEPS);
}

/* The changes of v in the steps before help. */
static void test_guess_of_velocities(void)
{
    dal_system *const system = open_curved(0, false);
    dal_stepper *const stepper = open_named(system, "midpoint");
    CHECK(dal_stepper_start(stepper, 0.0, 0.09, curved_start, DAL_PROJECT, DAL_INITIAL_NONE) == 0);
    CHECK(dal_advance(stepper, 100, NULL, NULL) == 0);
    CHECK(stats_of(stepper).iterations < 600); /* without the changes before it is 732 */
    CHECK(stats_of(stepper).lagrangian_calls > 600);
}

/* ---- at rest, and far out ------------------------------------------------------------------ */

/* A body at rest whose weight g[3] is balanced by the reaction of mu = (1 + y^2) g. */
static int hung_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                          void *ctx)
{
    const double *const g = ctx;
    if (V) *V = dal__dot(3, g, q);
    if (V_q) memcpy(V_q, g, 3 * sizeof *g);
    if (V_qq) memset(V_qq, 0, 9 * sizeof *V_qq);
    return 0;
}

static int hung_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                           double *phi_q, double *phi_t, void *ctx)
{
    const double *const g = ctx, factor = 1.0 + q[1] * q[1], along = dal__dot(3, g, v);
    if (phi) phi[0] = factor * along;
    for (size_t i = 0; phi_v && i < 3; i++) phi_v[i] = factor * g[i];
    if (phi_q) {
        phi_q[0] = phi_q[2] = 0.0;
        phi_q[1] = 2.0 * q[1] * along;
    }
    return 0;
}

/* Rounding gives v some u h |g| / |M| in each step, and every solver takes such a v for what it is:
 * what is left of a sum that cancels. */
static void test_rest(void)
{
    const double mass[9] = {1.3, 0.1, 0.2, 0.1, 2.1, 0.3, 0.2, 0.3, 0.9}, h = 0.1;
    enum { STEPS = 100 };
    const double tolerance = 16 * STEPS * h * U;
    unsigned seed = 5;
    for (int trial = 0; trial < (brief() ? 1 : 6); trial++) {
        double g[3];
        for (size_t i = 0; i < 3; i++) g[i] = 2.0 * next_number(&seed) - 1.0;
        const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .potential = hung_potential,
                                    .constraint = hung_constraint, .ctx = g};
        const double start[6] = {0.1, next_number(&seed), -0.4};
        dal_system *const base = new_system(&def);
        for (disguise as = LAGRANGIAN; as < DIFFERENCED; as++) {
            dal_system *const system = open_disguise(base, as);
            for (size_t s = 0; s < SCHEMES; s++)
                for (int k = 0; k < 2; k++) {
                    const dal_scheme scheme = find_scheme(schemes[s]);
                    const bool kept = scheme.nodes == DAL_KEPT_NODES;
                    dal_stepper *const stepper =
                        open_stepper_by(k ? BY_MULTIROOT : BY_LIBRARY, system, &scheme);
                    CHECK(dal_stepper_start(stepper, 0.0, h, start, DAL_CHECK,
                                            kept ? DAL_INITIAL_D : DAL_INITIAL_NONE) == 0);
                    CHECK(dal_advance(stepper, STEPS, NULL, NULL) == 0);
                    const double *const x = dal_stepper_state(stepper);
                    CHECK_NEAR(largest_difference(3, x + 3, start + 3), 0.0,
                               k ? 1e-11 * STEPS * h : tolerance); /* hybridsj may be stuck there */
                    release(stepper);
                }
            double xi[5], x[6];
            const dal_difference_map map = {.beta = 0.5};
            dal_chart *const chart = open_chart(system);
            dal_discrete *const discrete = open_discrete(system, map, NULL);
            CHECK(dal_chart_choose(chart, 0.0, NULL, start) == 0);
            CHECK(dal_chart_drop(chart, start, xi) == 0);
            memcpy(x, start, sizeof x);
            for (int step = 0; step < STEPS; step++) {
                CHECK(dal_chart_step(chart, 0.0, 0.5, h, xi, NULL) == 0);
                CHECK(dal_discrete_advance(discrete, 0.0, h, x, NULL) == 0);
            }
            CHECK_NEAR(sum_of_sizes(2, xi + 3), 0.0, tolerance);
            CHECK_NEAR(sum_of_sizes(3, x + 3), 0.0, tolerance);
            release(system);
        }
        release(base);
    }
}

/* A vehicle that stands far from the origin and has turned by as many radians: one rounding of q
 * moves mu by more than what Newton's iteration mends, and a node has to give back its q~
 * exactly. */
static void test_far(const char *name, double far)
{
    dal_system *const system = open_system(name);
    const size_t n = system->def.n;
    dal_mechanics *const mech = open_mechanics(system);
    double x[16];
    CHECK(dal_system_state(system, x) == 0);
    for (size_t i = 0; i < n; i++) x[i] += far * (i % 2 ? 1.0 : 1.37);
    CHECK(dal_project(mech, 0.0, 0.0, x, NULL) == 0);
    for (size_t s = 0; s < SCHEMES; s++) {
        const dal_scheme scheme = find_scheme(schemes[s]);
        const bool kept = scheme.nodes == DAL_KEPT_NODES;
        const double h = 0.1, shift = kept ? (1.0 - scheme.beta) * h : 0.0;
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        CHECK(dal_stepper_start(stepper, 0.0, h, x, DAL_CHECK,
                                kept ? DAL_INITIAL_D : DAL_INITIAL_NONE) == 0);
        for (int step = 0; step < (brief() ? 10 : 300); step++) {
            CHECK(dal_step(stepper, NULL) == 0);
            CHECK(residual_of(system, shift, dal_stepper_state(stepper)) <= DAL_RESIDUAL_BOUND(n));
        }
        release(stepper);
    }
    const dal_difference_map map = {.beta = 0.5};
    double xi[16], y[16];
    dal_chart *const chart = open_chart(system);
    dal_discrete *const discrete = open_discrete(system, map, NULL);
    memcpy(y, x, 2 * n * sizeof *y);
    for (int step = 0; step < (brief() ? 10 : 300); step++) {
        CHECK(dal_chart_choose(chart, 0.0, NULL, y) == 0);
        CHECK(dal_chart_drop(chart, y, xi) == 0);
        CHECK(dal_chart_step(chart, 0.0, 0.5, 0.1, xi, NULL) == 0);
        CHECK(dal_chart_lift(chart, 0.0, xi, y) == 0);
        CHECK(dal_discrete_advance(discrete, 0.0, 0.1, x, NULL) == 0);
    }
}

static int no_weight(double t, const double *q, const double *v, const double *u, double *f,
                     double *f_q, double *f_v, void *ctx)
{
    double none = 0.0;
    (void)ctx;
    return weight(t, q, v, u, f, f_q, f_v, &none);
}

/* A pendulum that has turned many times: there it is the force that one rounding of q moves. */
static void test_turned(void)
{
    const double mass[1] = {1.0};
    const dal_system_def def = {.n = 1, .mass = mass, .potential = pendulum, .force = no_weight};
    const dal_difference_map map = {.beta = 0.5};
    double x[2] = {1e10, 0.3};
    dal_system *const system = new_system(&def);
    dal_discrete *const discrete = open_discrete(system, map, NULL);
    dal_stepper *const stepper = start_named(system, "midpoint", 1.0, x);
    CHECK(dal_advance(stepper, 1000, NULL, NULL) == 0);
    for (int step = 0; step < 1000; step++)
        CHECK(dal_discrete_advance(discrete, 0.0, 1.0, x, NULL) == 0);
}

/* mu = (1 + k y^2, a, 1): it turns back at y = 0, and v_x may pass through 0 as it bends; *ctx is
 * {k, a}. */
static int bowl(double t, const double *q, const double *v, double *phi, double *phi_v,
                double *phi_q, double *phi_t, void *ctx)
{
    const double k = ((const double *)ctx)[0], a = ((const double *)ctx)[1];
    const double x = 1.0 + k * q[1] * q[1];
    if (phi) *phi = x * v[0] + a * v[1] + v[2];
    if (phi_v) {
        phi_v[0] = x;
        phi_v[1] = a;
        phi_v[2] = 1.0;
    }
    if (phi_q) {
        phi_q[0] = phi_q[2] = 0.0;
        phi_q[1] = 2.0 * k * q[1] * v[0];
    }
    return 0;
}

/* Where N = d(mu v)/dq is small and mu bends none the less, the steps are still in D. */
static void test_bowl(void)
{
    const char *const names[] = {"midpoint", "leapfrog-kl8", "endpoint", "0.3", "midpoint-suzuki4"};
    const double mass[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    unsigned seed = 1;
    double worst = 0.0;
    for (int start = 0; start < 1000; start++) {
        double shape[2] = {0.5 + fabs(next_number(&seed)), 0.2 + 0.3 * next_number(&seed)}, x[6];
        const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = bowl,
                                    .ctx = shape};
        dal_system *const system = new_system(&def);
        dal_stepper *const stepper = open_named(system, names[start % 5]);
        for (int i = 0; i < 6; i++) x[i] = next_number(&seed);
        x[1] = -0.5 * fabs(x[1]);
        x[4] = 0.3 + fabs(x[4]);
        const double h = 0.1 * exp(1.6 * next_number(&seed));
        CHECK(dal_stepper_start(stepper, 0.0, h, x, DAL_PROJECT, DAL_INITIAL_NONE) == 0);
        for (int step = 0; step < 50 && dal_step(stepper, NULL) == 0; step++)
            worst = fmax(worst, residual_of(system, 0.0, dal_stepper_state(stepper)));
        release(system);
    }
    CHECK_NEAR(worst, 0.0, DAL_RESIDUAL_BOUND(3));
}

/* What of the residual of D_eps no state can avoid: shift v rounds before q - shift v is formed. */
static double unavoidable(const dal_system *system, double shift, const double *x)
{
    const size_t n = system->def.n, m = system->def.m;
    double q[MOST_N], mu[MOST_M * MOST_N], N[MOST_M * MOST_N], worst = 0.0;
    for (size_t i = 0; i < n; i++) q[i] = x[i] - shift * x[n + i];
    CHECK(system->def.constraint(0.0, q, x + n, NULL, mu, N, NULL, system->def.ctx) == 0);
    for (size_t a = 0; a < m; a++) {
        double turned = 0.0, scale = 0.0;
        for (size_t i = 0; i < n; i++) {
            turned += fabs(N[a * n + i] * shift * x[n + i]);
            scale += fabs(mu[a * n + i] * x[n + i]);
        }
        worst = fmax(worst, U * turned / scale);
    }
    return worst;
}

/* Kept nodes far out in a long run: q - shift v, which rounds, is where D_eps is looked for. */
static void test_far_nodes(const char *name, double far)
{
    static const char *const kept[] = {"midpoint-nodes", "explicit-nodes"};
    dal_system *const system = open_system(name);
    const size_t n = system->def.n;
    double x[2 * MOST_N], h = 0.1;
    CHECK(dal_system_state(system, x) == 0);
    for (size_t i = 0; i < n; i++) x[i] += far * (i % 2 ? 1.0 : 1.37);
    for (size_t s = 0; s < 2; s++) {
        const dal_scheme scheme = find_scheme(kept[s]);
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        CHECK(dal_stepper_start(stepper, 0.0, h, x, DAL_PROJECT, DAL_INITIAL_D) == 0);
        const double shift = (1.0 - scheme.beta) * h;
        double worst = 0.0; /* in units of what is allowed */
        for (int step = 0; step < 20000; step++) {
            CHECK(dal_step(stepper, NULL) == 0);
            const double *const now = dal_stepper_state(stepper);
            const double allowed = DAL_RESIDUAL_BOUND(n) + unavoidable(system, shift, now);
            worst = fmax(worst, residual_of(system, shift, now) / allowed);
        }
        CHECK(worst <= 1.0);
        release(stepper);
    }
}

/* Projections onto D_eps there: one rounding of q moves mu by more than 1e-11, so that what Newton
 * changes does not get smaller than that. */
static void test_far_projection(const char *name, double far)
{
    dal_system *const system = open_system(name);
    dal_mechanics *const mech = open_mechanics(system);
    const size_t n = system->def.n;
    double x[2 * MOST_N];
    unsigned seed = 17;
    for (int trial = 0; trial < 200; trial++) {
        for (size_t i = 0; i < n; i++) x[i] = far * (1.0 + next_number(&seed));
        for (size_t i = 0; i < n; i++) x[n + i] = next_number(&seed);
        CHECK(dal_project(mech, 0.0, 0.1, x, NULL) == 0);
        /* q - shift v, which rounds by u far, is where D_eps is */
        CHECK(residual_of(system, 0.1, x) <= DAL_RESIDUAL_BOUND(n) + 16 * U * far);
    }
}

/* Differences at angles of many turns, and far from the origin: with the spacing of the library
 * their error is (u |q|)^(4/5), for sines and for what grows with q alike; 16 is for the fifth
 * derivatives and the terms. */
static void test_far_differences(const char *name)
{
    dal_system *const base = open_system(name);
    dal_system *const differenced = open_disguise_of_jet(base);
    const size_t n = base->def.n;
    dal_mechanics *const given = open_mechanics(base), *const other = open_mechanics(differenced);
    for (double far = 10.0; far < 2e8; far *= 10.0) {
        double x[2 * MOST_N], expected[MOST_N], vdot[MOST_N];
        CHECK(dal_system_state(base, x) == 0);
        for (size_t i = 0; i < n; i++) x[i] += far;
        CHECK(dal_project(given, 0.0, 0.0, x, NULL) == 0);
        CHECK(dal_acceleration(given, 0.0, x, expected) == 0);
        CHECK(dal_acceleration(other, 0.0, x, vdot) == 0);
        CHECK_NEAR(largest_difference(n, vdot, expected), 0.0,
                   16 * pow(U * far, 0.8) * (1.0 + sum_of_sizes(n, expected)));
    }
}

/* How far R1 moves with its place: by (1 - beta) h V_qq, and phi by its forms.  M = 1. */
static void test_moves(void)
{
    const double h = 0.1, beta = 0.25;
    double x[6], xi[5], V_qq[9], sum = 0.0;
    dal_system *const system = open_system("particle_oscillator");
    need(dal_system_state(system, x), "state", "");
    dal_chart *const chart = open_chart(system);
    CHECK(dal_chart_choose(chart, 0.0, NULL, x) == 0 && dal_chart_drop(chart, x, xi) == 0);
    CHECK(dal_chart_step(chart, 0.0, beta, h, xi, NULL) == 0);
    const dal_mechanics *const mech = &chart->mech;
    const double *const q = mech->forms.q;
    CHECK(system->def.potential(0.0, q, NULL, NULL, V_qq, system->def.ctx) == 0);
    for (size_t k = 0; k < 9; k++) sum += (1.0 - beta) * h * fabs(V_qq[k] * q[k % 3]);
    CHECK_NEAR(dal__step_moves(mech)
                   - dal__forms_move(mech, mech->forms.mu, mech->forms.dmu, q, NULL, h),
               sum, 16 * U * (1.0 + sum));
    CHECK(sum > 0.01);
}

int main(void)
{
    static const char *const names[] = {"particle", "particle_oscillator", "knife_edge", "sleigh",
                                        "disk", "heisenberg", "contact_oscillator", "generic4"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        test_same_steps(names[i]);
        test_same_mechanics(names[i]);
    }
    test_far_projection("knife_edge", 1e5);
    test_far_projection("knife_edge", 1e8);
    test_far_projection("n_trailer", 1e7);
    test_driven(0);
    test_driven(DAL_MISSING_F_Q | DAL_MISSING_F_V);
    test_power_of_force();
    test_step_derivatives();
    test_curved_flow();
    test_curved_orders(0);
    test_curved_orders(DAL_MISSING_L_QQ | DAL_MISSING_L_VQ | DAL_MISSING_L_VV | DAL_MISSING_F_Q
                       | DAL_MISSING_F_V | DAL_MISSING_PHI_Q);
    test_adjoint();
    test_sabotage();
    test_probes();
    test_degenerate();
    test_too_long();
    test_units("particle_oscillator", 40, 0.0);
    test_units("generic4", 40, 0.0);
    test_units("disk", 40, 0.0);
    for (int most = -20; most <= 20; most += 40) { /* a factor of 1e6 */
        test_units("disk", most, 1e6);
        test_units("sleigh", most, 1e8);
    }
    test_guess();
    test_guess_after_failure();
    test_guess_of_velocities();
    test_rest();
    test_far("n_trailer", 1e4);
    test_far("n_trailer", 1e6);
    test_far("n_trailer", 1e8);
    test_far("sleigh", 1e6);
    test_far_nodes("heisenberg", 1e3);
    test_far_nodes("heisenberg", 1e5);
    test_far_nodes("knife_edge", 1e7);
    test_turned();
    test_moves();
    test_bowl();
    test_far_differences("sleigh_contact");
    test_far_differences("rolling_disc");
    test_far_differences("n_trailer");
    return check_done();
}
