/* Deformed constraints phi + delta g and the D_eps of kept nodes, as systems of their own: against
 * numbers that were computed with 36 digits, against differences, against the flow, and against the
 * scheme whose D_eps it is. */
#include "fixtures.h"
#include "check.h"

enum { MOST_N = 8, MOST_M = 4 };

/* g = v_x v_y */
static int scaled(double t, const double *q, const double *v, double *g, double *g_v, double *g_q,
                   double *g_t, void *ctx)
{
    const double *const factor = ctx;
    (void)q;
    if (g) g[0] = *factor * v[0] * v[1];
    if (g_v) {
        g_v[0] = *factor * v[1];
        g_v[1] = *factor * v[0];
        g_v[2] = 0.0;
    }
    if (g_q) memset(g_q, 0, 3 * sizeof *g_q);
    return 0;
}

/* g = sin(x) v_y: linear in v, so the deformed D is a distribution. */
static int tilt(double t, const double *q, const double *v, double *g, double *g_v, double *g_q,
                double *g_t, void *ctx)
{
    if (g) g[0] = sin(q[0]) * v[1];
    if (g_v) {
        g_v[0] = g_v[2] = 0.0;
        g_v[1] = sin(q[0]);
    }
    if (g_q) {
        memset(g_q, 0, 3 * sizeof *g_q);
        g_q[0] = cos(q[0]) * v[1];
    }
    return 0;
}

/* The numbers of the group "deformed" of vectors.json, of 36 digits there; every one is a sum of a
 * few terms of size 1. */
static void test_vectors(void)
{
    static const struct {
        double delta, v_z, C, lambda, vdot[3];
    } expected[2] = {
        {0.05, 0.265, 1.072725, 0.652543755389312265492,
         {-0.172924095178167750355, 0.0326271877694656132746, 0.652543755389312265492}},
        {0.2, 0.16, 1.0656, 0.656906906906906906907,
         {-0.105105105105105105105, 0.131381381381381381381, 0.656906906906906906907}},
    };
    dal_system *const base = open_system("particle");
    double one = 1.0;
    for (int k = 0; k < 2; k++) {
        dal_system *const system = open_deformed(base, scaled, &one, expected[k].delta,
                                                 DAL_NONLINEAR, 0);
        dal_mechanics *const mech = open_mechanics(system);
        const double x[6] = {0.5, 0.3, -0.2, 1.0, 0.7, expected[k].v_z};
        double C, lambda = NAN, vdot[3], residual, power[2];
        CHECK(dal_relative_residual(mech, 0.0, 0.0, x, &residual) == 0 && residual < 4 * U);
        CHECK(dal_gram(mech, 0.0, x, &C) == 0 && dal_multipliers(mech, 0.0, x, &lambda) == 0);
        CHECK(dal_acceleration(mech, 0.0, x, vdot) == 0);
        CHECK_NEAR(C, expected[k].C, 8 * U);
        CHECK_NEAR(lambda, expected[k].lambda, 8 * U);
        CHECK_NEAR(largest_difference(3, vdot, expected[k].vdot), 0.0, 8 * U);
        /* the constraint forces work: dE/dt = lambda delta v_x v_y */
        CHECK(dal_power(mech, 0.0, x, power, power + 1) == 0 && power[1] == 0.0);
        CHECK_NEAR(power[0], expected[k].lambda * expected[k].delta * 0.7, 8 * U);
        release(system);
    }
}

/* A random state of D, or of what D is deformed to. */
static void random_state(dal_mechanics *mech, size_t n, unsigned *seed, double *x)
{
    for (size_t i = 0; i < 2 * n; i++) x[i] = 0.6 * next_number(seed);
    CHECK(dal_project(mech, 0.0, 0.0, x, NULL) == 0);
}

/* The derivatives of the deformed constraint, by the check that the library offers. */
static void test_derivatives(const dal_system *system)
{
    dal_mechanics *const mech = open_mechanics(system);
    unsigned seed = 5;
    for (int trial = 0; trial < 5; trial++) {
        double x[2 * MOST_N], value[2][MOST_M], slope[MOST_M];
        const size_t n = system->def.n, m = system->def.m, mn = m * n;
        double phi_v[MOST_M * MOST_N], phi_q[MOST_M * MOST_N], alone[MOST_M * MOST_N];
        random_state(mech, n, &seed, x);
        CHECK(system->def.constraint(0.0, x, x + n, value[0], phi_v, phi_q, NULL, system->def.ctx)
              == 0);
        CHECK(system->def.constraint(0.0, x, x + n, NULL, alone, NULL, NULL, system->def.ctx) == 0);
        CHECK(memcmp(alone, phi_v, mn * sizeof *alone) == 0);
        CHECK(system->def.constraint(0.0, x, x + n, NULL, NULL, alone, NULL, system->def.ctx) == 0);
        CHECK(memcmp(alone, phi_q, mn * sizeof *alone) == 0);
        CHECK(system->def.constraint(0.0, x, x + n, value[1], NULL, NULL, NULL, system->def.ctx)
              == 0);
        CHECK(memcmp(value[0], value[1], m * sizeof *alone) == 0);
        for (size_t j = 0; j < 2 * n; j++) {
            static const int at[4] = {1, -1, 2, -2}, weight[4] = {8, -8, -1, 1};
            const double d = 0x1p-10;
            memset(slope, 0, sizeof slope);
            for (int k = 0; k < 4; k++) {
                double y[2 * MOST_N];
                memcpy(y, x, sizeof y);
                y[j] += at[k] * d;
                CHECK(system->def.constraint(0.0, y, y + n, value[0], NULL, NULL, NULL,
                                             system->def.ctx) == 0);
                for (size_t a = 0; a < m; a++) slope[a] += weight[k] * value[0][a] / (12 * d);
            }
            const double *const given = j < n ? phi_q : phi_v;
            for (size_t a = 0; a < m; a++) CHECK_NEAR(given[a * n + j % n], slope[a], 1e-10);
        }
    }
}

/* delta = 0 changes nothing; a deformation that is linear in v makes a linear system of its own. */
static void test_linear(void)
{
    dal_system *const base = open_system("particle_oscillator");
    dal_system *const same = open_deformed(base, tilt, NULL, 0.0, DAL_LINEAR, 0);
    dal_system *const tilted = open_deformed(base, tilt, NULL, 0.3, DAL_LINEAR, 0);
    dal_mechanics *const plain = open_mechanics(base), *const mech = open_mechanics(same);
    unsigned seed = 1;
    CHECK(strcmp(dal_system_name(same), "particle_oscillator_deformed") == 0);
    CHECK(dal_system_formulas(base)[0] == 'L' && dal_system_formulas(same)[0] == '\0');
    CHECK(dal_system_source(same)[0] == '\0' && dal_system_description(same)[0] == '\0');
    CHECK(dal_system_kind(tilted) == DAL_LINEAR && dal_system_n(tilted) == 3);
    CHECK(strcmp(dal_system_coordinate(tilted, 1), "y") == 0);
    for (int trial = 0; trial < 10; trial++) {
        double x[6], a[6], b[6], E[2];
        random_state(plain, 3, &seed, x);
        CHECK(dal_field(plain, 0.0, x, a) == 0 && dal_field(mech, 0.0, x, b) == 0);
        CHECK(memcmp(a, b, sizeof a) == 0);
        CHECK(dal_energy(plain, 0.0, x, E) == 0 && dal_energy(mech, 0.0, x, E + 1) == 0
              && E[0] == E[1]);
    }
    test_derivatives(tilted);
    dal_mechanics *const slant = open_mechanics(tilted);
    dal_stepper *const stepper = open_named(tilted, "midpoint");
    double x[6], E0, E, power = NAN;
    random_state(slant, 3, &seed, x);
    CHECK(dal_energy(slant, 0.0, x, &E0) == 0 && dal_power(slant, 0.0, x, &power, NULL) == 0);
    CHECK_NEAR(power, 0.0, 64 * U); /* linear constraints do no work */
    CHECK(dal_stepper_start(stepper, 0.0, 0.02, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_advance(stepper, 1000, NULL, NULL) == 0);
    CHECK(dal_energy(slant, 0.0, dal_stepper_state(stepper), &E) == 0);
    CHECK_NEAR(E, E0, 1e-3);
    CHECK(residual_of(tilted, 0.0, dal_stepper_state(stepper)) <= DAL_RESIDUAL_BOUND(3));
}

/* The flow on D_delta stays there by itself, and its energy changes by the power of the
 * reactions. */
static void test_flow(void)
{
    dal_system *const base = open_system("particle_oscillator");
    double two = 2.0;
    dal_system *const system = open_deformed(base, scaled, &two, 0.15, DAL_NONLINEAR, 0);
    dal_mechanics *const mech = open_mechanics(system);
    double x[6], E[5], power, residual;
    const double d = 1e-2;
    unsigned seed = 11;
    test_derivatives(system);
    dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-13);
    random_state(mech, 3, &seed, x);
    for (int k = -2; k <= 2; k++) {
        double y[6];
        memcpy(y, x, sizeof y);
        CHECK(dal__flow_apply(flow, 0.0, k * d, y, false) == 0);
        CHECK(dal_energy(mech, 0.0, y, &E[k + 2]) == 0);
        CHECK(dal__flow_apply(flow, k * d, 2.0 - k * d, y, false) == 0);
        CHECK(dal_relative_residual(mech, 0.0, 0.0, y, &residual) == 0 && residual < 1e-11);
    }
    CHECK(dal_power(mech, 0.0, x, &power, NULL) == 0 && fabs(power) > 1e-4);
    CHECK_NEAR(power, (8 * (E[3] - E[1]) - (E[4] - E[0])) / (12 * d), 1e-8);
}

/* The states of a run with kept nodes satisfy the constraint of dal_system_deform_nodes, which is
 * phi + (h/2) v_x v_y for the particle at beta = 1/2 (deformedCons) and so a deformation by
 * -d(mu v)/dq v; energy is what it was. */
static void test_kept_nodes(const char *name)
{
    dal_system *const base = open_system(name);
    const size_t n = base->def.n;
    const double h = 0.05;
    const dal_scheme kept[] = {find_scheme("midpoint-nodes"), find_scheme("explicit-nodes")};
    double x0[2 * MOST_N];
    CHECK(dal_system_state(base, x0) == 0);
    for (size_t s = 0; s < sizeof kept / sizeof *kept; s++) {
        double shift;
        CHECK(dal_scheme_shift(&kept[s], &shift) == 0);
        dal_system *const system = open_deformed_nodes(base, shift * h);
        CHECK(dal_system_kind(system) == DAL_NONLINEAR);
        test_derivatives(system);
        dal_mechanics *const mech = open_mechanics(system), *const plain = open_mechanics(base);
        dal_stepper *const stepper = open_stepper(base, &kept[s], NULL);
        CHECK(dal_stepper_start(stepper, 0.0, h, x0, DAL_CHECK, DAL_INITIAL_PROJECT) == 0);
        for (int step = 0; step < 200; step++) {
            const double *const x = dal_stepper_state(stepper);
            double of_system[MOST_M], of_base[MOST_M], relative, E[2];
            CHECK(dal_step(stepper, NULL) == 0);
            CHECK(dal_residual(mech, 0.0, 0.0, x, of_system) == 0);
            CHECK(dal_residual(plain, 0.0, shift * h, x, of_base) == 0);
            CHECK(memcmp(of_system, of_base, base->def.m * sizeof *of_base) == 0);
            CHECK(dal_relative_residual(plain, 0.0, shift * h, x, &relative) == 0);
            CHECK(relative <= DAL_RESIDUAL_BOUND(n));
            CHECK(dal_energy(mech, 0.0, x, E) == 0 && dal_energy(plain, 0.0, x, E + 1) == 0
                  && E[0] == E[1]);
        }
        if (strcmp(name, "particle") == 0 && s == 0) {
            double one = 1.0;
            dal_system *const same = open_deformed(base, scaled, &one, h / 2, DAL_NONLINEAR, 0);
            dal_mechanics *const other = open_mechanics(same);
            double a[6], b[6];
            CHECK(dal_field(mech, 0.0, dal_stepper_state(stepper), a) == 0);
            CHECK(dal_field(other, 0.0, dal_stepper_state(stepper), b) == 0);
            CHECK_NEAR(largest_difference(6, a, b), 0.0, 64 * U);
            release(same);
        }
        release(system);
    }
}

/* A deformed general Lagrangian, affine base, and a base that differences phi_q. */
static int affine(double t, const double *q, const double *v, double *phi, double *phi_v,
                  double *phi_q, double *phi_t, void *ctx)
{
    if (phi) phi[0] = v[2] - q[1] * v[0] + 0.3 * q[0];
    if (phi_v) {
        phi_v[0] = -q[1];
        phi_v[1] = 0.0;
        phi_v[2] = 1.0;
    }
    if (phi_q) {
        phi_q[0] = 0.3;
        phi_q[1] = -v[0];
        phi_q[2] = 0.0;
    }
    return 0;
}

static int kinetic(double t, const double *q, const double *v, double *L, double *L_q, double *L_v,
                   double *L_qq, double *L_vq, double *L_vv, double *L_vt, void *ctx)
{
    if (L) *L = dal__dot(3, v, v) / 2;
    if (L_q) memset(L_q, 0, 3 * sizeof *L_q);
    if (L_v) memcpy(L_v, v, 3 * sizeof *L_v);
    if (L_qq) memset(L_qq, 0, 9 * sizeof *L_qq);
    if (L_vq) memset(L_vq, 0, 9 * sizeof *L_vq);
    if (L_vv)
        for (size_t k = 0; k < 9; k++) L_vv[k] = k % 4 == 0;
    return 0;
}

static int friction(double t, const double *q, const double *v, const double *u, double *f,
                    double *f_q, double *f_v, void *ctx)
{
    (void)t, (void)q, (void)ctx;
    for (size_t i = 0; f && i < 3; i++) f[i] = -0.1 * v[i];
    if (f_q) memset(f_q, 0, 9 * sizeof *f_q);
    for (size_t k = 0; f_v && k < 9; k++) f_v[k] = k % 4 == 0 ? -0.1 : 0.0;
    return 0;
}

static void test_general_base(void)
{
    const dal_system_def def = {.n = 3, .m = 1, .lagrangian = kinetic, .force = friction,
                                .constraint = affine, .kind = DAL_AFFINE};
    dal_system *base = NULL, *system = NULL, *again = NULL;
    double factor = 0.5;
    dal_error error;
    base = new_system(&def);
    system = open_deformed(base, scaled, &factor, 0.2, DAL_NONLINEAR, 0);
    again = open_deformed(system, scaled, &factor, -0.2, DAL_NONLINEAR, 0); /* back to the base */
    CHECK(dal_system_is_forced(system) && mass_of(system) == NULL);
    test_derivatives(system);
    dal_mechanics *const mech = open_mechanics(base), *const twice = open_mechanics(again);
    const double x[6] = {0.2, 0.4, 0.1, 0.5, -0.3, 0.7};
    double a[6], b[6], power;
    CHECK(dal_field(mech, 0.0, x, a) == 0 && dal_field(twice, 0.0, x, b) == 0);
    CHECK_NEAR(largest_difference(6, a, b), 0.0, 64 * U);
    CHECK(dal_power(twice, 0.0, x, NULL, &power) == 0);
    CHECK_NEAR(power, -0.1 * dal__dot(3, x + 3, x + 3), 8 * U);
    dal_system *none = NULL;
    CHECK(dal_system_deform(&none, base, tilt, NULL, 0.1, DAL_LINEAR, 0, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "kind = 0") != NULL);
}

/* A base or a deformation that fails, fails the deformed system. */
static int failing(double t, const double *q, const double *v, double *g, double *g_v, double *g_q,
                   double *g_t, void *ctx)
{
    return *(const int *)ctx;
}

static void test_failures(void)
{
    dal_system *const base = open_system("particle");
    dal_system *system = NULL, *free_body = NULL;
    const double mass[1] = {1.0};
    const dal_system_def no_forms = {.n = 1, .mass = mass};
    dal_error error;
    double one = 1.0;
    free_body = new_system(&no_forms);
#define REFUSED(call, expected, name)                                       \
    CHECK((call) == (expected) && system == NULL && strstr(error.text, name) != NULL)
    REFUSED(dal_system_deform(NULL, base, scaled, &one, 0.1, DAL_NONLINEAR, 0, &error), DAL_EINVAL,
            "system is NULL");
    REFUSED(dal_system_deform(&system, NULL, scaled, &one, 0.1, DAL_NONLINEAR, 0, &error),
            DAL_EINVAL, "base is NULL");
    REFUSED(dal_system_deform(&system, base, NULL, &one, 0.1, DAL_NONLINEAR, 0, &error), DAL_EINVAL,
            "g is NULL");
    REFUSED(dal_system_deform(&system, base, scaled, &one, NAN, DAL_NONLINEAR, 0, &error),
            DAL_EINVAL, "delta = nan");
    REFUSED(dal_system_deform(&system, base, scaled, &one, 0.1, (dal_constraint_kind)9, 0, &error),
            DAL_EINVAL, "kind = 9");
    REFUSED(dal_system_deform(&system, base, scaled, &one, 0.1, DAL_NONLINEAR, 8, &error),
            DAL_EINVAL, "missing = 0x8");
    REFUSED(dal_system_deform(&system, free_body, scaled, &one, 0.1, DAL_NONLINEAR, 0, &error),
            DAL_EINVAL, "no constraints");
    REFUSED(dal_system_deform_nodes(&system, base, INFINITY, &error), DAL_EINVAL, "shift = inf");
    REFUSED(dal_system_deform_nodes(&system, NULL, 0.1, &error), DAL_EINVAL, "base is NULL");
    /* phi_v is formed on the stack: 62 * 63 entries are not too many, 63 * 64 are */
    for (size_t n = 63; n <= 64; n++) {
        double many[64 * 64] = {0};
        for (size_t i = 0; i < n; i++) many[i * n + i] = 1.0;
        const dal_system_def def = {.n = n, .m = n - 1, .mass = many,
                                    .constraint = never_constraint,
                                    .missing = DAL_MISSING_PHI_Q};
        dal_system *const large = new_system(&def);
        if (n == 63) {
            CHECK(dal_system_deform(&system, large, scaled, &one, 0.1, DAL_LINEAR, 0, NULL) == 0);
            CHECK(dal_system_missing(system) == DAL_MISSING_PHI_Q); /* that of the base */
            dal_system_free(system);
            system = NULL;
        } else {
            REFUSED(dal_system_deform(&system, large, scaled, &one, 0.1, DAL_LINEAR, 0, &error),
                    DAL_EUNSUPPORTED, "m n = 63 * 64");
        }
        release(large);
    }
#undef REFUSED
    static const int answers[3] = {1, -1, 0}; /* 0: and nothing is written */
    for (int k = 0; k < 3; k++) {
        int answer = answers[k];
        const double x[6] = {0.5, 0.3, -0.2, 1.0, 0.7, 0.3};
        double out[6] = {7, 7, 7, 7, 7, 7};
        system = open_deformed(base, failing, &answer, 0.1, DAL_NONLINEAR, 0);
        dal_mechanics *const mech = open_mechanics(system);
        CHECK(dal_field(mech, 0.0, x, out) == (k == 1 ? DAL_EUSER : DAL_EDOMAIN) && out[0] == 7.0);
        CHECK(strstr(dal_mechanics_error(mech)->text,
                     k < 2 ? "constraint returned" : "did not set it") != NULL);
        release(system);
        system = NULL;
    }
}

/* Without g_q the deformed phi_q is differenced as a whole; D_eps needs the phi_q of the base. */
static void test_missing(void)
{
    dal_system *const base = open_system("particle");
    dal_system *nodes = NULL;
    dal_error error;
    dal_system *const system = open_deformed(base, tilt, NULL, 0.3, DAL_LINEAR, DAL_MISSING_PHI_Q);
    dal_system *const exact = open_deformed(base, tilt, NULL, 0.3, DAL_LINEAR, 0);
    dal_mechanics *const mech = open_mechanics(system), *const given = open_mechanics(exact);
    const double x[6] = {0.5, 0.3, -0.2, 1.0, 0.7, 0.3};
    double a[6], b[6];
    CHECK(dal_field(mech, 0.0, x, a) == 0 && dal_field(given, 0.0, x, b) == 0);
    CHECK_NEAR(largest_difference(6, a, b), 0.0, 1e-11);
    CHECK(dal_system_deform_nodes(&nodes, system, 0.1, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "phi_q") != NULL && nodes == NULL);
}

int main(void)
{
    static const char *const names[] = {"particle", "particle_oscillator", "knife_edge", "sleigh",
                                        "disk", "heisenberg", "generic4"};
    test_vectors();
    test_linear();
    test_flow();
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) test_kept_nodes(names[i]);
    test_general_base();
    test_failures();
    test_missing();
    return check_done();
}
