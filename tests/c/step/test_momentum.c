/* Stages in momentum form: of M(q), forces of v, and constraints that are not linear. */
#include "check.h"
#include "fixtures.h"

enum { MOST_2N = 16 };

/* Built-in systems of all kinds, n = 2 to 6; and a cart on a blade with a brake and two motors. */
static const char *const names[] = {"sleigh_contact", "genmass", "rolling_disc", "ball_on_table",
                                    "n_trailer", "cart"};
static const char *const schemes[] = {"midpoint", "explicit", "endpoint", "0.3", "leapfrog",
                                      "leapfrog-mirror", "midpoint-suzuki4", "leapfrog-yoshida4",
                                      "midpoint-nodes"};

/* A brake that is not linear in v, a spring in x, a motor that turns. */
static int drive(double t, const double *q, const double *v, const double *u, double *f,
                 double *f_q, double *f_v, void *ctx)
{
    const double speed = sqrt(1.0 + v[0] * v[0]);
    (void)t, (void)ctx;
    const double push[3] = {-speed * v[0] - q[0], -0.3 * v[1], u[0] - 0.1 * v[2]};
    if (f) memcpy(f, push, sizeof push);
    if (f_q) memcpy(f_q, (double[]){-1, 0, 0, 0, 0, 0, 0, 0, 0}, 9 * sizeof *f_q);
    if (f_v)
        memcpy(f_v, (double[]){-speed - v[0] * v[0] / speed, 0, 0, 0, -0.3, 0, 0, 0, -0.1},
               9 * sizeof *f_v);
    return 0;
}

static dal_system *open_cart(void)
{
    static const double mass[9] = {2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.75};
    static const double state[6] = {0.0, 0.0, 0.2, 0.98006657784124163, 0.19866933079506122, 1.2};
    const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = plane_blade,
                                .force = drive, .inputs = 1, .name = "cart", .state = state};
    return new_system(&def);
}

static dal_system *open_own(const char *name)
{
    return strcmp(name, "cart") == 0 ? open_cart() : open_system(name);
}

/* From x, or where the system starts by default if it is NULL. */
static dal_stepper *started(way by, const dal_system *system, const char *scheme, double h,
                            const double *start)
{
    const dal_scheme record = find_scheme(scheme);
    dal_stepper *const stepper = open_stepper_by(by, system, &record);
    double x[MOST_2N];
    const double u[1] = {0.4};
    if (start) memcpy(x, start, 2 * dal_system_n(system) * sizeof *x);
    else need(dal_system_state(system, x), "state", "");
    if (dal_system_inputs(system) > 0) dal_stepper_input(stepper, u);
    need(dal_stepper_start(stepper, 0.0, h, x, DAL_CHECK,
                           record.nodes == DAL_KEPT_NODES ? DAL_INITIAL_SHIFT : DAL_INITIAL_NONE),
         scheme, dal_stepper_error(stepper)->text);
    return stepper;
}

/* The compilations make the same bits; and the steps are those of another solver of the same
 * equations, to 64 u of the state for each of them.  None needs the full Newton iteration. */
static void test_same_steps(const char *name, const char *scheme, double h)
{
    enum { STEPS = 12 };
    dal_system *const system = open_own(name);
    const size_t N = 2 * dal_system_n(system);
    dal_stepper *by[WAYS];
    for (way w = BY_LIBRARY; w < WAYS; w++) by[w] = started(w, system, scheme, h, NULL);
    for (int k = 1; k <= STEPS; k++) {
        const double *x[WAYS];
        for (way w = BY_LIBRARY; w < WAYS; w++) {
            CHECK(dal_step(by[w], NULL) == DAL_SUCCESS);
            x[w] = dal_stepper_state(by[w]);
        }
        const double size = fmax(1.0, dal__largest(N, x[BY_LIBRARY]));
        CHECK(memcmp(x[BY_LIBRARY], x[BY_ANY_SIZES], N * sizeof *x[0]) == 0);
        check_near(largest_difference(N, x[BY_LIBRARY], x[BY_MULTIROOT]), 0.0, 64 * U * size * k,
                   name, scheme, __LINE__);
    }
    const dal_stats stats = stats_of(by[BY_LIBRARY]);
    CHECK(stats.full_newtons == 0);
}

/* A smooth step takes one evaluation with second derivatives, one without, and three of the forms;
 * also where headings have turned many times, whose rounding moves momenta by more than theirs. */
static void test_cost(double turns)
{
    enum { STEPS = 2000, ANGLE = 2 }; /* the first coordinate that is one */
    for (int i = 0; i < 2; i++) {
        dal_system *const system = open_own(i == 0 ? "sleigh_contact" : "n_trailer");
        dal_stepper *const stepper = started(BY_LIBRARY, system, "midpoint", 0.01, NULL);
        const size_t n = dal_system_n(system);
        double x[MOST_2N];
        dal_stats before, after;
        memcpy(x, dal_stepper_state(stepper), 2 * n * sizeof *x);
        for (size_t j = ANGLE; j < n; j++) x[j] += turns * 2.0 * acos(-1.0);
        CHECK(dal_stepper_start(stepper, 0.0, 0.01, x, DAL_PROJECT, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(stepper, 8, NULL, NULL) == 0);
        dal_stepper_stats(stepper, &before);
        CHECK(dal_advance(stepper, STEPS, NULL, NULL) == 0);
        dal_stepper_stats(stepper, &after);
        const size_t looks = after.lagrangian_calls - before.lagrangian_calls;
        const size_t forms = after.constraint_calls - before.constraint_calls;
        CHECK(100 * looks <= 206 * STEPS && 100 * forms <= 306 * STEPS);
        CHECK(after.full_newtons == 0 && after.worst_residual <= DAL_RESIDUAL_BOUND(n));
        release(system);
    }
}

/* Units that are powers of two change no bit, as far as squares do not leave the range; and beyond
 * it the steps are still those of the equations. */
static void test_units(void)
{
    static const int powers[] = {100, -100, 490, -490, 1000, -990};
    static const char *const parameters[] = {"m", "J"};
    for (size_t i = 0; i < DAL_LENGTH(powers); i++) {
        const double unit = ldexp(1.0, powers[i]), values[] = {1.5 * unit, 0.8 * unit};
        dal_system *const system = open_system("sleigh_contact");
        dal_system *const heavy = open_builtin("sleigh_contact", 2, parameters, values);
        dal_stepper *const one = started(BY_LIBRARY, system, "midpoint", 0.05, NULL);
        dal_stepper *const other = started(BY_LIBRARY, heavy, "midpoint", 0.05, NULL);
        CHECK(dal_advance(one, 20, NULL, NULL) == 0 && dal_advance(other, 20, NULL, NULL) == 0);
        const double *const x = dal_stepper_state(one), *const y = dal_stepper_state(other);
        if (abs(powers[i]) <= 490) CHECK(memcmp(x, y, 6 * sizeof *x) == 0);
        CHECK_NEAR(largest_difference(6, x, y), 0.0, 1000 * U);
        release(system);
    }
}

/* ---- guards ---------------------------------------------------------------------------------- */

/* L = (1 + x^2/2) x'^2/2 - x^2 + y'^2/2: a pendulum of a kind, beside a wheel that it knows nothing
 * of. */
static int beside_a_wheel(double t, const double *q, const double *v, double *L, double *L_q,
                          double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                          void *ctx)
{
    const double M = 1.0 + 0.5 * q[0] * q[0];
    (void)t, (void)L_vt, (void)ctx;
    if (L) *L = 0.5 * M * v[0] * v[0] + 0.5 * v[1] * v[1] - q[0] * q[0];
    if (L_q) memcpy(L_q, (double[]){0.5 * q[0] * v[0] * v[0] - 2.0 * q[0], 0.0}, 2 * sizeof *L_q);
    if (L_v) memcpy(L_v, (double[]){M * v[0], v[1]}, 2 * sizeof *L_v);
    if (L_qq) memcpy(L_qq, (double[]){0.5 * v[0] * v[0] - 2.0, 0, 0, 0}, 4 * sizeof *L_qq);
    if (L_vq) memcpy(L_vq, (double[]){q[0] * v[0], 0, 0, 0}, 4 * sizeof *L_vq);
    if (L_vv) memcpy(L_vv, (double[]){M, 0, 0, 1}, 4 * sizeof *L_vv);
    return 0;
}

/* However fast or far the wheel is, no bit of the pendulum changes. */
static void test_rows_are_their_own(void)
{
    const dal_system_def def = {.n = 2, .lagrangian = beside_a_wheel, .name = "wheel"};
    dal_system *const system = new_system(&def);
    double bits[2] = {0.0, 0.0};
    for (int power = 0; power <= 40; power += 10) {
        const double far = power > 0 ? ldexp(1.0, power) : 0.0, x[4] = {0.3, far, 1.0, far};
    dal_stepper *const stepper = start_named(system, "midpoint", 0.25, x);
        CHECK(dal_advance(stepper, 40, NULL, NULL) == 0);
        const double *const y = dal_stepper_state(stepper);
        if (power > 0) CHECK(y[0] == bits[0] && y[2] == bits[1]);
        bits[0] = y[0];
        bits[1] = y[2];
    }
}

/* L = cos(x) x'^2/2 with a force 4 - 4 x', whose damping keeps K positive where L_vv is not. */
static int falling_mass(double t, const double *q, const double *v, double *L, double *L_q,
                        double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                        void *ctx)
{
    const double c = cos(q[0]), s = sin(q[0]);
    (void)t, (void)L_vt, (void)ctx;
    if (L) *L = 0.5 * c * v[0] * v[0];
    if (L_q) *L_q = -0.5 * s * v[0] * v[0];
    if (L_v) *L_v = c * v[0];
    if (L_qq) *L_qq = -0.5 * c * v[0] * v[0];
    if (L_vq) *L_vq = -s * v[0];
    if (L_vv) *L_vv = c;
    return 0;
}

static int damper(double t, const double *q, const double *v, const double *u, double *f,
                  double *f_q, double *f_v, void *ctx)
{
    const double *const c = ctx;
    (void)t, (void)q, (void)u;
    if (f) *f = c[0] - c[1] * v[0];
    if (f_q) *f_q = 0.0;
    if (f_v) *f_v = -c[1];
    return 0;
}

static void test_indefinite(void)
{
    static const char *const some[] = {"explicit", "midpoint", "0.3"};
    double c[2] = {4.0, 4.0};
    const dal_system_def def = {.n = 1, .lagrangian = falling_mass, .force = damper, .ctx = c};
    const double x[2] = {1.2, 1.0};
    dal_system *const system = new_system(&def);
    for (size_t i = 0; i < DAL_LENGTH(some); i++) {
        dal_stepper *const stepper = open_named(system, some[i]);
        int status = dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE);
        while (status == DAL_SUCCESS) { /* no step begins where there is no mass */
            const double M = cos(dal_stepper_state(stepper)[0]);
            status = dal_step(stepper, NULL);
            CHECK(status != DAL_SUCCESS || M > 0.0);
        }
        CHECK(status == DAL_ESINGULAR);
        CHECK(strstr(dal_stepper_error(stepper)->text, "not positive definite") != NULL);
        release(stepper);
    }
}

/* v' (1 + c h/2) = v (1 - c h/2) with mass 1: of stiff damping the momentum keeps no rounding. */
static void test_stiff_damping(void)
{
    const double mass = 1.0, h = 0.125, x[2] = {0.0, 1.0};
    for (int power = 2; power <= 6; power++) {
        double c[2] = {0.0, pow(10.0, power)}, v = 1.0;
        const dal_system_def def = {.n = 1, .mass = &mass, .force = damper, .ctx = c};
        dal_system *const system = new_system(&def);
        dal_stepper *const stepper = started(BY_LIBRARY, system, "midpoint", h, x);
        for (int k = 0; k < 50; k++) {
            CHECK(dal_step(stepper, NULL) == 0);
            v *= (1.0 - 0.5 * c[1] * h) / (1.0 + 0.5 * c[1] * h);
            CHECK_NEAR(dal_stepper_state(stepper)[1], v, 16 * U * (k + 1) * fabs(v));
        }
        release(system);
    }
}

static int light_brake(double t, const double *q, const double *v, const double *u, double *f,
                       double *f_q, double *f_v, void *ctx)
{
    (void)t, (void)q, (void)u, (void)ctx;
    if (f) memcpy(f, (double[]){-0.1 * v[0], 0, 0}, 3 * sizeof *f);
    if (f_q) memset(f_q, 0, 9 * sizeof *f_q);
    if (f_v) memcpy(f_v, (double[]){-0.1, 0, 0, 0, 0, 0, 0, 0, 0}, 9 * sizeof *f_v);
    return 0;
}

/* Where steps are so large that all is left to the full Newton iteration, it begins where the last
 * step leads; from the velocity before it would not end in step 23. */
static void test_large_steps(void)
{
    const char *const springs[] = {"k1", "k2", "k3"};
    const double k[] = {1.0, 1.0, 1e-300}, x[6] = {1.0, 0.2, 0.0, 0.5, 1.0, 0.1};
    dal_system *const base = open_builtin("particle_oscillator", 3, springs, k);
    dal_system_def def = base->def;
    def.force = light_brake;
    def.exact = NULL;
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = started(BY_LIBRARY, system, "midpoint", 2.1328142859, x);
    CHECK(dal_advance(stepper, 60, NULL, NULL) == DAL_SUCCESS);
    const dal_stats stats = stats_of(stepper);
    CHECK(stats.full_newtons > 20);
}

/* ---- forces that are positional -------------------------------------------------------------- */

static int uneven_weight(double t, const double *q, const double *v, const double *u, double *f,
                         double *f_q, double *f_v, void *ctx)
{
    (void)v, (void)u, (void)f_v;
    uneven_potential(t, q, NULL, f, f_q, ctx);
    for (int i = 0; f && i < 3; i++) f[i] = -f[i];
    for (int i = 0; f_q && i < 9; i++) f_q[i] = -f_q[i];
    return q[0] > 1e6 ? 1 : 0;
}

/* drive, times ctx. */
static int heavy_drive(double t, const double *q, const double *v, const double *u, double *f,
                       double *f_q, double *f_v, void *ctx)
{
    const double unit = *(const double *)ctx;
    const int status = drive(t, q, v, u, f, f_q, f_v, NULL);
    for (int i = 0; f && i < 3; i++) f[i] *= unit;
    for (int i = 0; i < 9; i++) {
        if (f_q) f_q[i] *= unit;
        if (f_v) f_v[i] *= unit;
    }
    return status;
}

/* The unit of mass makes no difference to the bits, if it is a power of 2: not where stages with
 * momenta and without take turns, whose roundings are carried for p or for v. */
static void test_unit_of_mass(void)
{
    static const char *const records[] = {"leapfrog", "bm4", "bm6", "midpoint-kl6", "explicit"};
    static const double units[] = {1.0, 0x1p30, 0x1p-20};
    for (size_t r = 0; r < DAL_LENGTH(records); r++) {
        double x[3][6];
        for (size_t k = 0; k < DAL_LENGTH(units); k++) {
            double unit = units[k], mass[9] = {0};
            for (int i = 0; i < 3; i++) mass[4 * i] = unit * (i < 2 ? 2.0 : 0.75);
            const double state[6] = {0.0, 0.0, 0.2, 0.98006657784124163, 0.19866933079506122, 1.2};
            const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = plane_blade,
                                        .force = heavy_drive, .inputs = 1, .ctx = &unit,
                                        .state = state, .name = "cart"};
            dal_system *const system = new_system(&def);
            dal_stepper *const stepper = started(BY_LIBRARY, system, records[r], 0.05, NULL);
            CHECK(dal_advance(stepper, 200, NULL, NULL) == DAL_SUCCESS);
            memcpy(x[k], dal_stepper_state(stepper), sizeof x[k]);
            release(system);
        }
        CHECK(memcmp(x[0], x[1], sizeof x[0]) == 0 && memcmp(x[0], x[2], sizeof x[0]) == 0);
    }
}

/* -V_q as a force makes the bits of V, but for what the kernel knows of it: its energy. */
static void test_force_of_potential(void)
{
    dal_system *const given = open_system("uneven_edge");
    dal_system_def def = given->def;
    def.potential = NULL;
    def.force = uneven_weight;
    def.positional = 1;
    dal_system *const forced = new_system(&def);
    for (size_t i = 0; i < DAL_LENGTH(schemes); i++)
        for (way w = BY_LIBRARY; w <= BY_ANY_SIZES; w++) {
            dal_stepper *const one = started(w, given, schemes[i], 0.05, NULL);
            dal_stepper *const other = started(w, forced, schemes[i], 0.05, NULL);
            CHECK(dal_advance(one, 100, NULL, NULL) == 0);
            CHECK(dal_advance(other, 100, NULL, NULL) == 0);
            const double *const x = dal_stepper_state(one), *const y = dal_stepper_state(other);
            CHECK(memcmp(x, y, 6 * sizeof *x) == 0);
            dal_stats of_one, of_other;
            dal_stepper_stats(one, &of_one);
            dal_stepper_stats(other, &of_other);
            CHECK(of_one.potential_calls > 0 && of_other.potential_calls == 0);
            CHECK(of_other.force_calls >= of_one.potential_calls);
            release(other);
        }
    double x[6];
    dal_stepper *const away = started(BY_LIBRARY, forced, "midpoint", 0.05, NULL);
    memcpy(x, dal_stepper_state(away), sizeof x);
    x[0] = 1e6 - 0.01;
    CHECK(dal_stepper_start(away, 0.0, 0.05, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_step(away, NULL) == DAL_EDOMAIN);
    CHECK(strstr(dal_stepper_error(away)->text, "force") != NULL);
}

/* What is declared positional, and is not, is refused; so is the declaration without a force. */
static void test_false_declaration(void)
{
    dal_system *const cart = open_cart();
    dal_system_def def = cart->def;
    dal_system *system = NULL;
    dal_error error;
    def.positional = 1;
    system = new_system(&def);
    dal_stepper *const stepper = open_named(system, "leapfrog");
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, def.state, DAL_CHECK, DAL_INITIAL_NONE)
          == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(stepper)->text, "positional, but f[0] is") != NULL);
    def.positional = 2;
    CHECK(dal_system_new(&system, &def, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "positional = 2: expected 0 or 1") != NULL);
    def.force = NULL;
    def.inputs = 0;
    def.positional = 1;
    CHECK(dal_system_new(&system, &def, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "positional = 1: expected 0, because force is NULL") != NULL);
}

/* An input that changes is that of the next step, also where forces are carried over from the step
 * before; and the same again changes nothing. */
static void test_change_of_input(void)
{
    dal_system *const system = open_cart();
    for (size_t i = 0; i < DAL_LENGTH(schemes); i++) {
        dal_stepper *const stepper = started(BY_LIBRARY, system, schemes[i], 0.05, NULL);
        dal_stepper *const fresh = started(BY_LIBRARY, system, schemes[i], 0.05, NULL);
        dal_stepper *const still = started(BY_LIBRARY, system, schemes[i], 0.05, NULL);
        const double u[2] = {0.4, -1.3};
        CHECK(dal_advance(stepper, 6, NULL, NULL) == 0 && dal_advance(still, 6, NULL, NULL) == 0);
        dal_stepper_input(still, u);
        CHECK(dal_step(still, NULL) == 0);
        dal_stats calls, again;
        dal_stepper_stats(still, &calls);
        dal_stepper_input(still, u);
        CHECK(dal_step(still, NULL) == 0);
        dal_stepper_stats(still, &again);
        CHECK(again.force_calls - calls.force_calls <= calls.force_calls / 7 + 1);
        dal_stepper_input(stepper, u + 1);
        dal_stepper_input(fresh, u + 1);
        const bool kept = strcmp(schemes[i], "midpoint-nodes") == 0;
        CHECK(dal_stepper_start(fresh, 0.0, 0.05, dal_stepper_state(stepper), DAL_ASSUME,
                                kept ? DAL_INITIAL_D_EPS : DAL_INITIAL_NONE) == 0);
        CHECK(dal_step(stepper, NULL) == 0 && dal_step(fresh, NULL) == 0);
        CHECK_NEAR(largest_difference(6, dal_stepper_state(stepper), dal_stepper_state(fresh)), 0.0,
                   200 * U);
        release(still);
    }
}

int main(void)
{
    for (size_t i = 0; i < DAL_LENGTH(names); i++)
        for (size_t j = 0; j < DAL_LENGTH(schemes); j++) {
            test_same_steps(names[i], schemes[j], 0.01);
            test_same_steps(names[i], schemes[j], -0.05);
        }
    test_cost(0.0);
    test_cost(1e3);
    test_cost(1e6);
    test_units();
    test_unit_of_mass();
    test_rows_are_their_own();
    test_indefinite();
    test_stiff_damping();
    test_large_steps();
    test_force_of_potential();
    test_false_declaration();
    test_change_of_input();
    return check_done();
}
