/* The built-in systems: their derivatives, data, exact solutions and first integrals, against
 * differences and against numbers computed elsewhere with 30 digits or more. */
#include "check.h"
#include "fixtures.h"

#include <stdlib.h>
#include <string.h>

enum { MAX_N = 41, MAX_M = 11, MAX_VALUES = 4 };

static const double pi = 3.14159265358979323846;

/* A system with up to six parameters changed, {NULL} at the end. */
typedef struct choice {
    const char *name;
    const char *parameters[6];
    double values[6];
} choice;

/* Every system as it is, and with every parameter changed. */
static const choice choices[] = {
    {"particle", {NULL}, {0}},
    {"particle_oscillator", {NULL}, {0}},
    {"particle_oscillator", {"k1", "k2", "k3"}, {0.7, -1.3, 2.0}},
    {"knife_edge", {NULL}, {0}},
    {"knife_edge", {"gs", "J", "m"}, {-1.5, 2.0, 0.3}},
    {"sleigh", {NULL}, {0}},
    {"sleigh", {"m", "J", "a"}, {0.6, 1.7, -0.9}},
    {"disk", {NULL}, {0}},
    {"disk", {"m", "I", "J", "R"}, {0.4, 1.6, 2.1, 1.3}},
    {"heisenberg", {NULL}, {0}},
    {"heisenberg", {"k1", "k2", "k3"}, {0.7, 1.3, -2.0}},
    {"contact_oscillator", {NULL}, {0}},
    {"contact_oscillator", {"eps"}, {0.3}},
    {"robot", {NULL}, {0}},
    {"robot", {"m", "I", "J", "R", "k"}, {0.4, 1.6, 2.1, 1.3, -3.0}},
    {"chaotic", {NULL}, {0}},
    {"chaotic", {"pairs"}, {1.0}},
    {"chaotic", {"pairs"}, {2.0}},
    {"chaotic", {"pairs"}, {20.0}},
    {"sleigh_contact", {NULL}, {0}},
    {"sleigh_contact", {"m", "J", "a"}, {0.6, 1.7, -0.9}},
    {"genmass", {NULL}, {0}},
    {"rolling_disc", {NULL}, {0}},
    {"rolling_disc", {"m", "r", "A", "C", "g"}, {1.6, 0.7, 0.4, 0.9, 2.1}},
    {"ball_on_table", {NULL}, {0}},
    {"ball_on_table", {"m", "J", "a", "Omega"}, {0.6, 0.9, 0.7, -1.3}},
    {"ball_on_table", {"Omega"}, {0.0}},
    {"snakeboard", {NULL}, {0}},
    {"snakeboard", {"m", "r", "J0", "J1"}, {1.7, 0.8, 0.6, 0.2}},
    {"n_trailer", {NULL}, {0}},
    {"n_trailer", {"trailers", "d", "m", "J"}, {1.0, 0.7, 1.4, 0.3}},
    {"n_trailer", {"trailers", "d", "m", "J"}, {10.0, 0.9, 0.8, 0.5}},
};
enum { CHOICES = sizeof choices / sizeof choices[0] };

static dal_system *make(const choice *c)
{
    size_t count = 0;
    while (c->parameters[count]) count++;
    return open_builtin(c->name, count, c->parameters, c->values);
}

static dal_system *plain(const char *name) { return make(&(choice){name, {NULL}, {0}}); }

static double largest(size_t count, const double *x)
{
    double size = 0.0;
    for (size_t i = 0; i < count; i++) size = fmax(size, fabs(x[i]));
    return size;
}

/* Entries of x near those of y, to a tolerance relative to the largest one. */
#define CHECK_VECTOR(count, x, y, tolerance)                                              \
    do {                                                                                  \
        const double scale_ = fmax(1.0, largest(count, y));                               \
        for (size_t i_ = 0; i_ < (count); i_++)                                           \
            CHECK_NEAR((x)[i_], (y)[i_], (tolerance) * scale_);                           \
    } while (0)

/* The next of a fixed sequence of numbers in [-1, 1]. */
static double next(unsigned *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return (double)*seed / 2147483648.0 - 1.0;
}

/* A state in D at some distance from the default one. */
static void some_state(dal_mechanics *mechanics, const dal_system *system, unsigned seed, double *x)
{
    const size_t n = dal_system_n(system);
    CHECK(dal_system_state(system, x) == DAL_SUCCESS);
    for (size_t i = 0; i < 2 * n; i++) x[i] += 0.7 * next(&seed);
    CHECK(dal_project(mechanics, 0.0, 0.0, x, NULL) == DAL_SUCCESS);
}

/* x[2n] after steps classical Runge-Kutta steps of the field on D. */
static void runge_kutta(dal_mechanics *mechanics, size_t n, double h, size_t steps, double *x)
{
    static const double node[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1, 2, 2, 1};
    for (size_t step = 0; step < steps; step++) {
        double slope[2 * MAX_N] = {0}, stage[2 * MAX_N], sum[2 * MAX_N] = {0};
        for (int k = 0; k < 4; k++) {
            for (size_t i = 0; i < 2 * n; i++) stage[i] = x[i] + node[k] * h * slope[i];
            if (dal_field(mechanics, 0.0, stage, slope)) exit(1);
            for (size_t i = 0; i < 2 * n; i++) sum[i] += weight[k] * slope[i];
        }
        for (size_t i = 0; i < 2 * n; i++) x[i] += h / 6 * sum[i];
    }
}

static void check_symmetric(size_t n, const double *A)
{
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < i; j++) CHECK(A[i * n + j] == A[j * n + i]);
}

/* Central differences with h = 2^-17 err by h^2/6 times a third derivative (1e-11) and by u/h times
 * the function (1.5e-11); 1e-9 relative covers both for functions with derivatives below 100. */
static const double h = 0x1p-17, difference_tolerance = 1e-9;

/* dal__difference errs by d^4/30 times a fifth derivative and by 1.5 u/d times the function. */
static const double order_4_tolerance = 1e-11;

static void test_potential(const dal_system *system, const double *q)
{
    const size_t n = dal_system_n(system);
    const dal_potential_fn potential = system->def.potential;
    void *ctx = system->def.ctx;
    double V = NAN, V_q[MAX_N], V_qq[MAX_N * MAX_N], again[MAX_N * MAX_N];
    for (size_t i = 0; i < n * n; i++) V_qq[i] = again[i] = NAN;
    for (size_t i = 0; i < n; i++) V_q[i] = NAN;
    CHECK(potential(0.0, q, &V, V_q, V_qq, ctx) == 0);
    CHECK(isfinite(V) && dal__all_finite(n, V_q) && dal__all_finite(n * n, V_qq));
    check_symmetric(n, V_qq);

    CHECK(potential(0.0, q, again, NULL, NULL, ctx) == 0 && again[0] == V);
    CHECK(potential(0.0, q, NULL, again, NULL, ctx) == 0 && !memcmp(again, V_q, n * sizeof *again));
    CHECK(potential(0.0, q, NULL, NULL, again, ctx) == 0
          && !memcmp(again, V_qq, n * n * sizeof *again));
    CHECK(potential(0.0, q, NULL, NULL, NULL, ctx) == 0);

    const double scale = difference_tolerance * (1 + fabs(V) + largest(n, V_q));
    for (size_t j = 0; j < n; j++) {
        double point[MAX_N], left, right, V_q_left[MAX_N], V_q_right[MAX_N];
        memcpy(point, q, n * sizeof *point);
        point[j] = q[j] + h;
        CHECK(potential(0.0, point, &right, V_q_right, NULL, ctx) == 0);
        point[j] = q[j] - h;
        CHECK(potential(0.0, point, &left, V_q_left, NULL, ctx) == 0);
        CHECK_NEAR(V_q[j], (right - left) / (2 * h), scale);
        for (size_t i = 0; i < n; i++)
            CHECK_NEAR(V_qq[i * n + j], (V_q_right[i] - V_q_left[i]) / (2 * h), scale);
    }
}

/* L, L_q and L_v at x, as the function that test_lagrangian differences. */
static int value_lagrangian(const double *x, double *values, void *ctx)
{
    const dal_system *system = ctx;
    const size_t n = dal_system_n(system);
    return system->def.lagrangian(0.0, x, x + n, values, values + 1, values + 1 + n, NULL, NULL,
                                  NULL,
                                  NULL, system->def.ctx);
}

static void test_lagrangian(const dal_system *system, const double *x)
{
    enum { OUTPUTS = 6 };
    static double given[OUTPUTS][MAX_N * MAX_N], again[MAX_N * MAX_N];
    const size_t n = dal_system_n(system), sizes[OUTPUTS] = {1, n, n, n * n, n * n, n * n};
    const dal_lagrangian_fn lagrangian = system->def.lagrangian;
    const double *const q = x, *const v = x + n;
    void *ctx = system->def.ctx;
    for (size_t k = 0; k < OUTPUTS; k++)
        for (size_t i = 0; i < MAX_N * MAX_N; i++) given[k][i] = NAN;
    CHECK(lagrangian(0.0, q, v, given[0], given[1], given[2], given[3], given[4], given[5], NULL,
                     ctx) == 0);
    for (size_t k = 0; k < OUTPUTS; k++) CHECK(dal__all_finite(sizes[k], given[k]));
    const double *const L_q = given[1], *const L_v = given[2];
    const double *const L_qq = given[3], *const L_vq = given[4], *const L_vv = given[5];
    check_symmetric(n, L_qq);
    check_symmetric(n, L_vv);

    CHECK(lagrangian(0.0, q, v, NULL, NULL, NULL, NULL, NULL, NULL, NULL, ctx) == 0);
    for (size_t k = 0; k < OUTPUTS; k++) {
        double *want[OUTPUTS] = {NULL};
        want[k] = again;
        for (size_t i = 0; i < sizes[k]; i++) again[i] = NAN;
        CHECK(lagrangian(0.0, q, v, want[0], want[1], want[2], want[3], want[4], want[5], NULL, ctx)
              == 0);
        CHECK(!memcmp(again, given[k], sizes[k] * sizeof *again));
    }

    double point[2 * MAX_N], values[1 + 2 * MAX_N], slope[1 + 2 * MAX_N];
    const double scale = 1 + fabs(given[0][0]) + largest(n, L_q) + largest(n, L_v);
    memcpy(point, x, 2 * n * sizeof *point);
    for (size_t j = 0; j < 2 * n; j++) {
        CHECK(dal__difference(value_lagrangian, (void *)system, point, j, 1 + 2 * n, values, slope,
                              1) == 0);
        const bool by_q = j < n;
        const size_t column = by_q ? j : j - n;
        const double *const slope_q = slope + 1, *const slope_v = slope + 1 + n;
        CHECK_NEAR((by_q ? L_q : L_v)[column], slope[0], order_4_tolerance * scale);
        for (size_t i = 0; i < n; i++) {
            CHECK_NEAR(by_q ? L_qq[i * n + column] : L_vq[column * n + i], slope_q[i],
                       order_4_tolerance * scale);
            CHECK_NEAR((by_q ? L_vq : L_vv)[i * n + column], slope_v[i], order_4_tolerance * scale);
        }
    }
}

static void test_constraint(const dal_system *system, const double *q, const double *v)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    const dal_constraint_fn constraint = system->def.constraint;
    void *ctx = system->def.ctx;
    double phi[MAX_M], mu[MAX_M * MAX_N], phi_q[MAX_M * MAX_N], again[MAX_M * MAX_N];
    for (size_t i = 0; i < m; i++) phi[i] = NAN;
    for (size_t i = 0; i < m * n; i++) mu[i] = phi_q[i] = again[i] = NAN;
    CHECK(constraint(0.0, q, v, phi, mu, phi_q, NULL, ctx) == 0);
    CHECK(dal__all_finite(m, phi) && dal__all_finite(m * n, mu) && dal__all_finite(m * n, phi_q));

    CHECK(constraint(0.0, q, v, again, NULL, NULL, NULL, ctx) == 0
          && !memcmp(again, phi, m * sizeof *phi));
    CHECK(constraint(0.0, q, v, NULL, again, NULL, NULL, ctx) == 0
          && !memcmp(again, mu, m * n * sizeof *mu));
    CHECK(constraint(0.0, q, v, NULL, NULL, again, NULL, ctx) == 0
          && !memcmp(again, phi_q, m * n * sizeof *phi_q));
    CHECK(constraint(0.0, q, v, NULL, NULL, NULL, NULL, ctx) == 0);

    const double scale = difference_tolerance * (1 + largest(m * n, mu)) * (1 + largest(n, v));
    for (size_t j = 0; j < n; j++) {
        double point[MAX_N], left[MAX_M], right[MAX_M];
        memcpy(point, v, n * sizeof *point);
        point[j] = v[j] + 1.0;
        CHECK(constraint(0.0, q, point, right, NULL, NULL, NULL, ctx) == 0);
        for (size_t a = 0; a < m; a++) /* linear in v, so that only roundoff is left */
            CHECK_NEAR(mu[a * n + j], right[a] - phi[a], 1e-14 * scale / difference_tolerance);
        memcpy(point, q, n * sizeof *point);
        point[j] = q[j] + h;
        CHECK(constraint(0.0, point, v, right, NULL, NULL, NULL, ctx) == 0);
        point[j] = q[j] - h;
        CHECK(constraint(0.0, point, v, left, NULL, NULL, NULL, ctx) == 0);
        for (size_t a = 0; a < m; a++)
            CHECK_NEAR(phi_q[a * n + j], (right[a] - left[a]) / (2 * h), scale);
    }
    const double rest[MAX_N] = {0};
    double offset[MAX_M];
    CHECK(constraint(0.0, q, rest, offset, NULL, NULL, NULL, ctx) == 0);
    for (size_t a = 0; a < m; a++) { /* phi = mu v, and an offset if it is affine */
        double sum = offset[a];
        CHECK(system->def.kind == DAL_AFFINE || offset[a] == 0.0);
        for (size_t i = 0; i < n; i++) sum += mu[a * n + i] * v[i];
        CHECK_NEAR(phi[a], sum, 1e-14 * scale / difference_tolerance);
    }
}

/* The default data lie in D to roundoff for all parameters. */
static void test_state(dal_mechanics *mechanics, const dal_system *system)
{
    const size_t n = dal_system_n(system);
    double x[2 * MAX_N], worst = NAN;
    CHECK(dal_system_state(system, x) == DAL_SUCCESS);
    CHECK(dal_relative_residual(mechanics, 0.0, 0.0, x, &worst) == DAL_SUCCESS);
    CHECK(worst <= DAL_RESIDUAL_BOUND(n));
}

/* dI/dt = 0 along the field: central differences of order 6 in its direction, with step 2^-9:
 * truncation (2^-9)^6 I^(7)/140 = 4e-19 I^(7), I^(7) < 1e6; roundoff 4 u I/2^-9 = 2e-13 I. */
static void test_invariants(dal_mechanics *mechanics, const dal_system *system, const double *x)
{
    static const double weight[4] = {0.0, 45.0 / 60, -9.0 / 60, 1.0 / 60};
    const size_t n = dal_system_n(system), count = dal_system_invariants(system);
    const double step = 0x1p-9;
    double slope[2 * MAX_N], now[MAX_VALUES];
    CHECK(count <= MAX_VALUES);
    if (count == 0) return;
    CHECK(dal_field(mechanics, 0.0, x, slope) == DAL_SUCCESS);
    CHECK(dal_system_invariant(system, 0.0, x, now) == DAL_SUCCESS);
    double rate[MAX_VALUES] = {0}, change[MAX_VALUES] = {0};
    for (int k = -3; k <= 3; k++) {
        double y[2 * MAX_N], values[MAX_VALUES];
        for (size_t i = 0; i < 2 * n; i++) y[i] = x[i] + k * step * slope[i];
        CHECK(dal_system_invariant(system, 0.0, y, values) == DAL_SUCCESS);
        for (size_t j = 0; j < count; j++)
            rate[j] += (k < 0 ? -weight[-k] : weight[k]) * values[j] / step;
    }
    for (size_t j = 0; j < count; j++) CHECK_NEAR(rate[j], 0.0, 2e-12 * (1 + fabs(now[j])));

    for (size_t i = 0; i < 2 * n; i++) { /* and it is no constant */
        double y[2 * MAX_N], values[MAX_VALUES];
        memcpy(y, x, 2 * n * sizeof *y);
        y[i] += 0.1;
        CHECK(dal_system_invariant(system, 0.0, y, values) == DAL_SUCCESS);
        for (size_t j = 0; j < count; j++) change[j] += fabs(values[j] - now[j]);
    }
    for (size_t j = 0; j < count; j++) CHECK(change[j] > 1e-3);
}

/* The exact solution has the field as its derivative (order 6, step 2^-7: truncation 1.6e-15 x^(7),
 * roundoff 2^7 * 10 u = 1e-13 x), starts in x, composes, keeps D and the first integrals. */
static void test_exact(dal_mechanics *mechanics, const dal_system *system, const double *x)
{
    static const double weight[4] = {0.0, 45.0 / 60, -9.0 / 60, 1.0 / 60};
    const size_t n = dal_system_n(system), count = dal_system_invariants(system);
    const double step = 0x1p-7;
    double y[2 * MAX_N], z[2 * MAX_N], slope[2 * MAX_N], start[MAX_VALUES], end[MAX_VALUES];
    if (!system->def.exact) {
        CHECK(dal_system_exact(system, 1.0, x, y) == DAL_EUNSUPPORTED);
        return;
    }
    CHECK(dal_system_exact(system, 0.0, x, y) == DAL_SUCCESS);
    CHECK_VECTOR(2 * n, y, x, 1e-15);
    CHECK(dal_system_invariant(system, 0.0, x, start) == DAL_SUCCESS);
    for (double t = -2.25; t < 5.0; t += 1.5) {
        double rate[2 * MAX_N] = {0}, worst = NAN;
        for (int k = -3; k <= 3; k++) {
            CHECK(dal_system_exact(system, t + k * step, x, y) == DAL_SUCCESS);
            for (size_t i = 0; i < 2 * n; i++)
                rate[i] += (k < 0 ? -weight[-k] : weight[k]) * y[i] / step;
        }
        CHECK(dal_system_exact(system, t, x, y) == DAL_SUCCESS);
        CHECK(dal_field(mechanics, 0.0, y, slope) == DAL_SUCCESS);
        CHECK_VECTOR(2 * n, rate, slope, 1e-11 * (1 + largest(n, y)));
        CHECK(dal_relative_residual(mechanics, 0.0, 0.0, y, &worst) == DAL_SUCCESS);
        CHECK(worst <= DAL_RESIDUAL_BOUND(n));
        CHECK(dal_system_invariant(system, 0.0, y, end) == DAL_SUCCESS);
        for (size_t j = 0; j < count; j++)
            CHECK_NEAR(end[j], start[j], 1e-14 * (1 + fabs(start[j]) + largest(2 * n, y)));
        memcpy(z, y, sizeof z);
        CHECK(dal_system_exact(system, 0.75, z, z) == DAL_SUCCESS); /* in place */
        CHECK(dal_system_exact(system, t + 0.75, x, y) == DAL_SUCCESS);
        CHECK_VECTOR(2 * n, z, y, 4e-14);
    }
}

static void test_choice(const choice *c)
{
    dal_system *system = make(c);
    dal_mechanics *mechanics = open_mechanics(system);
    const size_t n = dal_system_n(system);
    CHECK(!strcmp(dal_system_name(system), c->name));
    CHECK(strlen(dal_system_help(system)) > 10 && !strchr(dal_system_help(system), '\n'));
    CHECK(strlen(dal_system_description(system)) > 10 && strlen(dal_system_source(system)) > 10);
    CHECK(!strncmp(dal_system_formulas(system), "L = ", 4)); /* all of it: test_formula.py */
    CHECK(strstr(dal_system_formulas(system), " = 0") != NULL);
    for (size_t i = 0; c->parameters[i]; i++)
        for (size_t j = 0; j < dal_system_parameters(system); j++)
            if (!strcmp(dal_system_parameter_name(system, j), c->parameters[i]))
                CHECK(dal_system_parameter(system, j) == c->values[i]);
    test_state(mechanics, system);
    for (unsigned seed = 1; seed <= 4; seed++) {
        double x[2 * MAX_N];
        some_state(mechanics, system, seed, x);
        if (system->def.potential) test_potential(system, x);
        test_constraint(system, x, x + n);
        test_invariants(mechanics, system, x);
        test_exact(mechanics, system, x);
        if (system->def.lagrangian) { /* off D, where nothing vanishes by chance */
            unsigned number = seed;
            for (size_t i = n; i < 2 * n; i++) x[i] += next(&number);
            test_lagrangian(system, x);
        }
    }
}

/* States at t = 1 and t = 10 from the default data, from Taylor series with 45 and 60 digits. */
static void test_references(void)
{
    static const struct {
        const char *name;
        double energy, lambda0[2], x1[8], lambda1[2], x10[8], lambda10[2];
    } reference[] = {
        {"particle", 0.79, {0.64220183486238532110},
         {1.37355616490802232389, 1.0, 0.35211758003334293936, 0.73824115301167002877, 0.7,
          0.73824115301167002877}, {0.25838440355408451007},
         {4.06462955621421712031, 7.3, 9.23228620083864307446, 0.14169460933113004516, 0.7,
          1.03437064811724932972}, {0.00182697046475945904}},
        {"particle_oscillator", 1.035, {0.22935779816513761467},
         {1.14399599594162275178, 0.53570230747523819392, 0.11007127667056669624,
          0.23832643131642248011, -0.3099130128462028844, 0.12767201918854639236},
         {-0.4052868523979919410},
         {0.65466787065566450753, 0.49347803828297677422, -0.0639966675752053013,
          -0.8810431038781765120, -0.4277368951408912755, -0.4347754225445474716},
         {-0.0339395881628824074}},
        {"knife_edge", 0.79, {-2.1933466539753060772},
         {0.86517186472895463050, 1.12341927049798736238, 1.4, 0.36358110591014766188,
          2.10800097321370493276, 1.2}, {-10.061150645909295729},
         {0.03717424560897144066, 10.8793422654468589753, 12.2, -0.6163900143482525053,
          0.23650492226720837097, 1.2}, {3.37563947634358661914}},
        {"sleigh", 0.55, {0.23076923076923076923},
         {0.00286768429689062797, 0.53046901642230946871, 1.21277507521911815335,
          -0.1136544699804263290, 0.61331776759524600599, 0.80341922906737976263},
         {0.49558750876071911579},
         {-6.5851811792609768244, 2.99672454791210165109, 3.05570079333169720977,
          -0.8535355900954137841, 0.06883775710444374573, 0.01159415024673408449},
         {0.01145539171436138648}},
        {"disk", 0.77974, {-0.3238402934638737488, 0.76595432261279923485},
         {0.49120853243730856026, 0.55915874149032134485, 1.2, 1.3, 0.20597409804093230338,
          0.74193980277123858282, 1.1, 0.9}, {-0.8012949869929376694, 0.22245202588420688765},
         {-0.3119722733095279170, 1.64331178638814499703, 11.1, 9.4, -0.7697636423671089835,
          0.01907707759908575323, 1.1, 0.9}, {-0.0206032438070126134, -0.8313447337564777022}},
        {"heisenberg", 0.5953, {-0.0892857142857142857},
         {0.66455715760085814125, 0.39182793591424186852,
          0.32578351584557813629, -0.5529995954769377586, -0.1914220150966854753,
          0.08946981980225738972}, {-0.1019319511763715558},
         {-0.7387746750636096338, -0.0547836688803317564, -0.7585748207022781277,
          0.20408203001140934608, -0.4414746322694839606, 0.33733064036028554293},
         {-0.2775577042017907274}},
        {"sleigh_contact", 0.55, {0.23076923076923076923},
         {-0.1373009718885025819958, 0.1558321951898243271087, 1.21277507521911815336,
          0.1873359561144306532233, 0.5007035739033667813874, 0.8034192290673797626353},
         {0.49558750876071911579},
         {-6.186655754712356194116, 2.962410032203123838621, 3.055700793331697209777,
          -0.8531377424446399784395, 0.07345832075380394138766, 0.01159415024673408449046},
         {0.01145539171436138648}},
        {"genmass", 0.8219454988211896587316, {0.4227345603084517414497},
         {0.8398182421034660411301, 0.2716931032223145699272, -0.0102482257251889455149,
          0.1846740223817324027701, 0.5249785618454262859962, -0.1480410855449657793634},
         {-0.1427397045722507912491},
         {0.1476889483698249817259, -0.2460721760391509980824, 0.2991803861938523329913,
          -0.7805451362335356950693, 0.3054910307839245211052, 0.1460253627050081249343},
         {0.1729858307348274553271}},
    };
    for (size_t k = 0; k < sizeof reference / sizeof reference[0]; k++) {
        dal_system *system = plain(reference[k].name);
        dal_mechanics *mechanics = open_mechanics(system);
        const size_t n = dal_system_n(system), m = dal_system_m(system);
        double x[2 * MAX_N], E, lambda[MAX_M];
        const bool exact = system->def.exact != NULL;
        /* Without an exact solution Runge-Kutta with h = 1/2000: about h^4 10 2^5/120 = 2e-13. */
        const double tolerance = exact ? 1e-13 : 4e-12;
        CHECK(dal_system_state(system, x) == DAL_SUCCESS);
        CHECK(dal_energy(mechanics, 0.0, x, &E) == DAL_SUCCESS);
        CHECK_NEAR(E, reference[k].energy, 1e-15);
        CHECK(dal_multipliers(mechanics, 0.0, x, lambda) == DAL_SUCCESS);
        CHECK_VECTOR(m, lambda, reference[k].lambda0, 1e-14);
        if (exact) CHECK(dal_system_exact(system, 1.0, x, x) == DAL_SUCCESS);
        else runge_kutta(mechanics, n, 1.0 / 2000, 2000, x);
        CHECK_VECTOR(2 * n, x, reference[k].x1, tolerance);
        CHECK(dal_multipliers(mechanics, 0.0, x, lambda) == DAL_SUCCESS);
        CHECK_VECTOR(m, lambda, reference[k].lambda1, 10 * tolerance);
        if (exact) CHECK(dal_system_exact(system, 9.0, x, x) == DAL_SUCCESS);
        else runge_kutta(mechanics, n, 1.0 / 2000, 18000, x);
        CHECK_VECTOR(2 * n, x, reference[k].x10, tolerance);
        CHECK(dal_multipliers(mechanics, 0.0, x, lambda) == DAL_SUCCESS);
        CHECK_VECTOR(m, lambda, reference[k].lambda10, 10 * tolerance);
        release(system);
    }
}

/* Exact solutions where a closed form could cancel, divide by zero or overflow; 50 digits.  u is
 * the velocity along the edge or blade (of the particle v_x, of the disk theta'), turn that of the
 * last angle (of the particle v_y). */
static void test_limits(void)
{
    static const struct {
        choice system;
        double t, q[4], u, turn, x[8];
    } limit[] = {
        {{"particle", {NULL}, {0}}, 3, {0.5, 0.3, -0.2}, 1, 0, {3.5, 0.3, 0.7, 1, 0, 0.3}},
        {{"particle", {NULL}, {0}}, 3, {0.5, 0.3, -0.2}, 1, 1e-9,
         {3.4999999987614678868, 0.3000000029999999889, 0.70000000412844031915,
          0.9999999991743119235, 1e-9, 0.30000000275229356347}},
        {{"particle", {NULL}, {0}}, 3, {0.5, 0.3, -0.2}, 1, -2,
         {1.9287004841316888673, -5.7, -2.6759311478416716914, 0.18040795149845754945, -2,
          -1.0283253235412080339}},
        {{"particle", {NULL}, {0}}, 2, {0.5, 5, -0.2}, 1, -2.5,
         {5.216467290451958894, 0, 8.1603921945628860569, 5.09901951359278483, -2.5, 0}},
        {{"particle", {NULL}, {0}}, 2, {0.5, 0, -0.2}, 1, 0, {2.5, 0, -0.2, 1, 0, 0}},
        {{"knife_edge", {NULL}, {0}}, 2, {1, -2, 0.2}, 0.5, 0,
         {6.7827190628484543143, -0.82778481343331249336, 0.2, 5.2926857739278334998,
          1.0728805211691568935, 0}},
        {{"knife_edge", {NULL}, {0}}, 2, {1, -2, 0.2}, 0.5, 1e-9,
         {6.7827190607026932651, -0.82778480618127428125, 0.200000002, 5.2926857708085265883,
          1.0728805315571809216, 1e-9}},
        {{"knife_edge", {NULL}, {0}}, -3, {1, -2, 0.2}, 0.5, -1e-4,
         {10.335255489528776464, -0.1056296558249588039, 0.2003, -6.7133176986951064262,
          -1.3629537497769036802, -1e-4}},
        {{"knife_edge", {NULL}, {0}}, 2, {1, -2, 0.2}, 0.5, 0.4999, /* either side of |x| = 1 */
         {4.4231441203932315287, 1.6751918289478154936, 1.1998, 1.5108011699896268138,
          3.8837096218337606796, 0.4999}},
        {{"knife_edge", {NULL}, {0}}, 2, {1, -2, 0.2}, 0.5, 0.51,
         {4.3606514220702517929, 1.6954388706842848152, 1.22, 1.4191053668639396093,
          3.8780661505561276767, 0.51}},
        {{"knife_edge", {NULL}, {0}}, 2, {1, -2, 0.2}, 0.5, 40,
         {0.98618157962300586871, -1.926419965419130527, 80.2, 0.03796874560126074232,
          -0.42363459782281249196, 40}},
        {{"disk", {NULL}, {0}}, 2, {1, 2, 0.1, 0.4}, 1.1, 0,
         {2.4184339307644430387, 2.599704247155321799, 2.3, 0.4, 0.70921696538222151937,
          0.29985212357766089952, 1.1, 0}},
        {{"disk", {NULL}, {0}}, 2, {1, 2, 0.1, 0.4}, 1.1, 1e-9,
         {2.4184339301647387906, 2.5997042485737557294, 2.3, 0.400000002,
          0.70921696478251727079, 0.29985212499609482968, 1.1, 1e-9}},
        {{"disk", {NULL}, {0}}, 2, {1, 2, 0.1, 0.4}, 1.1, 7,
         {1.0633863377664689768, 2.129896618523830467, 2.3, 14.4, -0.20005936428459174995,
          0.74355648794294373734, 1.1, 7}},
        {{"sleigh", {NULL}, {0}}, -30, {1, 2, 0.3}, 0.2, 1, /* nearly straight, backwards */
         {-21.79417952888872612, 6.3517298856215280106, -3.4605757014186646296,
          0.81315005298424439392, -0.26855227547829160272, 9.5429821071779328675e-7}},
        {{"sleigh", {NULL}, {0}}, 1000, {1, 2, 0.3}, -2, 0.5, /* theta' has vanished */
         {2019.0154160258224673, 259.87135976489154505, 6.4125146695827925347,
          2.0258129534833560675, 0.26346766562972233333, 0}},
        {{"sleigh", {NULL}, {0}}, 30, {1, 2, 0.3}, -1, 1e-9, /* an unstable straight motion */
         {-27.636626450279435299, -6.9378149560686719679, 0.35694954402525372935,
          -0.94120799887467329123, -0.33697466000426519364, 0.032851408912220098625}},
        {{"sleigh", {NULL}, {0}}, 200, {1, 2, 0.3}, -1, 1e-20, /* straight, a turn, straight */
         {26.59735792817736654, 35.04616494640778487, 6.839746611150456904,
          0.84907668604882255926, 0.52826961033959658426, 0}},
        {{"sleigh", {NULL}, {0}}, -200, {1, 2, 0.3}, 1, 1e-20,
         {40.785679457275403092, -10.820821373506040104, -6.2397466111504569262,
          -0.99905668818715819526, -0.043425036424939963382, 0}},
        {{"sleigh", {"a"}, {-0.4}}, 200, {1, 2, 0.3}, 1, -1e-20,
         {-38.785679457275403092, 14.820821373506040104, -6.2397466111504569262,
          -0.99905668818715819526, -0.043425036424939963382, 0}},
        {{"sleigh", {NULL}, {0}}, 5, {1, 2, 0.3}, 1, 0,
         {5.7766824456280301146, 3.4776010333066978225, 0.3, 0.95533648912560602292,
          0.2955202066613395645, 0}},
        {{"sleigh", {NULL}, {0}}, 5, {1, 2, 0.3}, 0, 2,
         {-5.6857228183756236364, 1.9909878813511546451, 3.535742376741850425,
          -1.5323971866733753511, -0.65155103236181520345, 0.032790466519747896192}},
        {{"sleigh", {NULL}, {0}}, 5, {1, 2, 0.3}, 0, 0, {1, 2, 0.3, 0, 0, 0}},
        {{"sleigh", {"a"}, {0}}, 5, {1, 2, 0.3}, 0.2, -1,
         {0.85911938981944772822, 1.8064549694823006395, -4.7, -0.0024777326925781453474,
          0.19998465151282018796, -1}},
        {{"sleigh", {"a"}, {1e-9}}, 5, {1, 2, 0.3}, -2, 0.5,
         {0.84212827959478186864, -5.5902352762969896151, 2.8000000234375001305,
          1.8844446956946133887, -0.66997625619751320546, 0.50000000937500008496}},
        {{"sleigh", {"a"}, {-0.4}}, 5, {1, 2, 0.3}, 0.2, 1,
         {3.9416928479709663345, 1.8504624501195169987, 3.6156297463465891011,
          0.70474903814315937407, 0.45965189984213655897, 0.21815529535089592886}},
    };
    for (size_t k = 0; k < sizeof limit / sizeof limit[0]; k++) {
        dal_system *system = make(&limit[k].system);
        const size_t n = dal_system_n(system);
        double x[8] = {0}, y[8];
        double *v = x + n;
        memcpy(x, limit[k].q, n * sizeof *x);
        const double angle = x[n - 1], c = cos(angle), s = sin(angle);
        const double u = limit[k].u, turn = limit[k].turn;
        if (!strcmp(limit[k].system.name, "particle")) {
            v[0] = u;
            v[1] = turn;
            v[2] = x[1] * u;
        } else if (!strcmp(limit[k].system.name, "disk")) {
            v[0] = dal_system_parameter(system, 3) * u * c;
            v[1] = dal_system_parameter(system, 3) * u * s;
            v[2] = u;
            v[3] = turn;
        } else {
            const double a = strcmp(limit[k].system.name, "sleigh") ? 0
                : dal_system_parameter(system, 2);
            v[0] = u * c - a * turn * s;
            v[1] = u * s + a * turn * c;
            v[2] = turn;
        }
        for (size_t i = 0; i < 2 * n; i++) y[i] = NAN;
        /* u times phases of up to 80 rad and exponents s of up to 70, and the initial data's own
         * roundoff, which the unstable motions multiply. */
        CHECK(dal_system_exact(system, limit[k].t, x, y) == DAL_SUCCESS);
        CHECK_VECTOR(n, y, limit[k].x, 2e-14);
        CHECK_VECTOR(n, y + n, limit[k].x + n, 2e-14);
        release(system);
    }
}

/* A sleigh that never ends turning: phases beyond 5e5 are refused, not computed for ever. */
static void test_sleigh_domain(void)
{
    dal_system *system = make(&(choice){"sleigh", {"a"}, {0.0}});
    double x[6], y[6];
    CHECK(dal_system_state(system, x) == DAL_SUCCESS);
    CHECK(dal_system_exact(system, 1e9, x, y) == DAL_EDOMAIN);
}

/* Runs of literature and of other codes (DOP853, agreed to 3e-11): the state after steps steps of
 * size h, and lambda there to 8 digits. */
typedef struct run {
    choice system;
    double x0[14], t;
    size_t steps;
    double q[7];
    double lambda; /* or NAN */
} run;

static void check_run(const run *r)
{
    dal_system *system = make(&r->system);
    dal_mechanics *mechanics = open_mechanics(system);
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    double x[14], lambda[MAX_M];
    memcpy(x, r->x0, sizeof x);
    runge_kutta(mechanics, n, r->t / (double)r->steps, r->steps, x);
    CHECK_VECTOR(n, x, r->q, 2e-10);
    CHECK(dal_multipliers(mechanics, 0.0, x, lambda) == DAL_SUCCESS);
    if (m == 1 && !isnan(r->lambda)) CHECK_NEAR(lambda[0], r->lambda, 1e-7);
}

static void test_runs(void)
{
    const double z0 = 0.1 * sqrt(2.0), x0 = sqrt((2 - z0 * z0) / (1 + 0.3 * z0 * z0));
    const double lean = pi / 36, spin = 10.7364981632612, yaw = -spin / 10;
    const run runs[] = {
        {{"particle", {NULL}, {0}}, {0, 0, 0, 1, 1, 0}, 10, 10000,
         {2.998222950298, 10, 9.049875621121}, 9.8519e-4},
        {{"particle", {NULL}, {0}}, {0, -1, 0, 1, 0.5, -1}, 10, 10000,
         {8.41764274778, 4, 7.661903789691}, NAN},
        {{"particle_oscillator", {"k1", "k2", "k3"}, {1, 1, 0}}, {0, 0, 0, 1, 1, 0}, 10, 10000,
         {0.846638064469, -0.544021110889, 2.637600566836}, 0.6580687},
        {{"knife_edge", {"m", "J", "gs"}, {1, 1, 0.5}}, {0, 0, 0, 0, 0, 1}, 10, 10000,
         {0.25 * 0.29595896909330399, 0.25 * (10 - 0.5 * 0.91294525072762767), 10},
         0.54402111},
        {{"sleigh", {"m", "J", "a"}, {1, 1, 1}}, {1, 0, 0, 0, 1, 1}, 10, 10000,
         {-5.568779450330, 11.609652454018, 2.219039213796}, NAN},
        {{"heisenberg", {"k1", "k2", "k3"}, {1, 4, 0}}, {1, 0, 0, 0.3, 0.7, 0.7}, 10, 10000,
         {-0.52387585255, -0.413230651275, 0.455115615595}, -0.44937878},
        {{"contact_oscillator", {NULL}, {0}},
         {1.224744871391589, 1, -0.70710678118654752, 0, 0, 0}, 20 * pi, 60000,
         {1.040600088961, 1, -0.812377549303}, 0.11411127},
        {{"contact_oscillator", {"eps"}, {0.3}}, {x0, 0, z0, 0, 1, 0}, 20 * pi, 60000,
         {1.366416128916, 0, 0.064861629723}, 1.01269245},
        {{"robot", {NULL}, {0}}, {0, 0, 0, 0, 1, 0, 0, 1}, 10, 10000,
         {-0.28116043029, 0, 0, -0.28116043029}, NAN},
        {{"robot", {NULL}, {0}}, {0, 0, 0, 0, 1, 0, 0.5, 1}, 10, 10000,
         {-0.98864812971, -1.417920886527, 5, -0.28116043029}, NAN},
        {{"sleigh_contact", {"m", "J", "a"}, {1, 1, 1}}, {0, 0, 0, 0, 0, 1}, 10, 10000,
         {-4.964992787305, 10.812506504048, 2.219039213796}, NAN},
        {{"snakeboard", {NULL}, {0}},
         {0, 0, 0, 0, 0.4, -0.15 / tan(0.4), 0, 0.3, 0.5, 0.05}, 5, 5000,
         {-0.910531327032, -1.112283874546, 1.972870468825, 2.027129531175, 0.65}, NAN},
        {{"rolling_disc", {"m", "r", "A", "C"}, {0.3048, 0.05, 1.905e-4, 3.81e-4}},
         {0, 0.495642212863, 0, lean, 0, 0.05 * (spin + yaw * sin(lean)), -0.025 * cos(lean), yaw,
          0.5, spin}, 2, 20000,
         {0.354615808017, -0.304923743517, -2.30724368196, 0.092239103786, 21.559510749861}, NAN},
        {{"n_trailer", {NULL}, {0}},
         {0, 0, 0, 0.3, 0.1, -0.2, 1, 0, 0.5, sin(-0.3), cos(0.3) * sin(0.2),
          cos(0.3) * cos(0.2) * sin(0.3)}, 5, 5000,
         {1.092697147396, 3.795206596651, 2.5, 2.029794223854, 1.523595392598, 1.037995039475},
         NAN},
    };
    for (size_t k = 0; k < sizeof runs / sizeof runs[0]; k++) check_run(&runs[k]);
}

/* The default data that the references above do not cover. */
static void test_default_data(void)
{
    dal_system *system = plain("contact_oscillator");
    dal_mechanics *mechanics = open_mechanics(system);
    double x[14], values[2], E, lambda;
    CHECK(dal_system_state(system, x) == DAL_SUCCESS);
    const double contact[6] = {1.224744871391589, 1, -0.70710678118654752, 0, 0, 0};
    CHECK_VECTOR(6, x, contact, 1e-15);
    CHECK(dal_multipliers(mechanics, 0.0, x, &lambda) == DAL_SUCCESS);
    CHECK_NEAR(lambda, 0.25881905, 5e-9);

    system = make(&(choice){"contact_oscillator", {"eps"}, {0.3}});
    mechanics = open_mechanics(system);
    CHECK(dal_system_state(system, x) == DAL_SUCCESS);
    CHECK(dal_energy(mechanics, 0.0, x, &E) == DAL_SUCCESS);
    CHECK(dal_system_invariant(system, 0.0, x, values) == DAL_SUCCESS);
    CHECK_NEAR(E, 1.5, 1e-15);
    CHECK_NEAR(values[0], 0.5, 1e-15);
    CHECK_NEAR(values[1], 1.0, 1e-15); /* radius = E - H_y on D */

    system = make(&(choice){"robot", {"R"}, {2.0}});
    CHECK(dal_system_state(system, x) == DAL_SUCCESS);
    const double robot[8] = {0, 0, 0, 0, 2, 0, 0.5, 1};
    CHECK_VECTOR(8, x, robot, 0.0);

    system = plain("chaotic");
    mechanics = open_mechanics(system);
    CHECK(dal_system_state(system, x) == DAL_SUCCESS);
    const double chaotic[14] = {cos(pi / 9), 0.6, 0.4, 0.2, 1, 1, 1, 0, sin(pi / 9)};
    CHECK_VECTOR(14, x, chaotic, 1e-15);
    CHECK(dal_energy(mechanics, 0.0, x, &E) == DAL_SUCCESS);
    CHECK_NEAR(E, 3.06, 2e-15);
    run r = {{"chaotic", {NULL}, {0}}, {0}, 1, 1000,
             {1.350176734692, 0.370364124178, 0.084301432243, 0.036964929517, 0.552255076721,
              0.429087770269, 0.675384314631}, NAN};
    memcpy(r.x0, x, sizeof x);
    check_run(&r);
}

/* Default data of the vehicles and the ball, which follow the parameters. */
static void test_data_with_parameters(void)
{
    const double phi = 0.4;
    const struct {
        choice system;
        size_t n;
        double x[16];
    } expected[] = {
        {{"snakeboard", {"r"}, {2.0}}, 5, {0, 0, 0, 0, phi, -0.6 / tan(phi), 0, 0.3, 0.5, 0.05}},
        {{"ball_on_table", {"a", "Omega"}, {2, 3}}, 5,
         {0.5, -0.2, 0, 0, 0, 0.3, 0.4, 0.55, -0.15, 0.7}},
        {{"n_trailer", {"trailers", "d"}, {5, 2}}, 8,
         {0, 0, 0.2, 0.5, 0.3, 0, 0, 0, cos(0.2), sin(0.2), 0.5, -sin(0.3) / 2,
          cos(0.3) * sin(0.2) / 2, cos(0.3) * cos(0.2) * sin(0.3) / 2}},
    };
    for (size_t k = 0; k < sizeof expected / sizeof expected[0]; k++) {
        dal_system *system = make(&expected[k].system);
        double x[2 * MAX_N];
        CHECK(dal_system_n(system) == expected[k].n);
        CHECK(dal_system_state(system, x) == DAL_SUCCESS);
        CHECK_VECTOR(2 * expected[k].n, x, expected[k].x, 1e-15);
        release(system);
    }
}

/* In a potential that is symmetric about the z axis the Heisenberg constraint takes no force. */
static void test_heisenberg_symmetry(void)
{
    dal_system *system = make(&(choice){"heisenberg", {"k1", "k2", "k3"}, {1.7, 1.7, 0.0}});
    dal_mechanics *mechanics = open_mechanics(system);
    for (unsigned seed = 1; seed < 5; seed++) {
        double x[6], lambda;
        some_state(mechanics, system, seed, x);
        CHECK(dal_multipliers(mechanics, 0.0, x, &lambda) == DAL_SUCCESS);
        CHECK_NEAR(lambda, 0.0, 1e-15);
    }
}

/* Names, sizes, parameters and first integrals as they are shown to users. */
static void test_description(void)
{
    const double u = sqrt(1.5 / 1.04) * 0.2; /* of the sleigh, in units of its rotation */
    const struct {
        const char *name, *coordinates[7], *parameters[6];
        double defaults[5], values[4]; /* values: of the first integrals at the default data */
        size_t m, invariants;
        bool exact;
    } expected[] = {
        {"particle", {"x", "y", "z"}, {NULL}, {0}, {0.7, sqrt(1.09)}, 1, 2, true},
        {"particle_oscillator", {"x", "y", "z"}, {"k1", "k2", "k3"}, {1, 2, 1.5}, {0.335}, 1, 1,
         false},
        {"knife_edge", {"x", "y", "theta"}, {"m", "J", "gs"}, {2, 0.75, 2.5},
         {1.2, 0.6 - 2.5 * sin(0.2)}, 1, 2, true},
        {"sleigh", {"x", "y", "theta"}, {"m", "J", "a"}, {1.5, 0.8, 0.4},
         {0.12 - sqrt(1.04 / 1.5) * atan(u)}, 1, 1, true},
        {"sleigh_contact", {"x", "y", "theta"}, {"m", "J", "a"}, {1.5, 0.8, 0.4},
         {0.12 - sqrt(1.04 / 1.5) * atan(u)}, 1, 1, true},
        {"disk", {"x", "y", "theta", "phi"}, {"m", "I", "J", "R"}, {1.2, 0.5, 0.3, 0.7},
         {1.1, 0.9}, 2, 2, true},
        {"heisenberg", {"x", "y", "z"}, {"k1", "k2", "k3"}, {1, 2.25, 0.5}, {0}, 1, 0, false},
        {"contact_oscillator", {"x", "y", "z"}, {"eps"}, {0}, {0.5, 1}, 1, 2, false},
        {"robot", {"x", "y", "phi", "theta"}, {"m", "I", "J", "R", "k"}, {1, 1, 1, 1, 10},
         {0.5, 1}, 2, 2, false},
        {"chaotic", {NULL}, {"pairs"}, {3}, {0}, 1, 0, false},
        {"genmass", {"q1", "q2", "q3"}, {NULL}, {0}, {0}, 1, 0, false},
        {"rolling_disc", {"x", "y", "alpha", "beta", "gamma"}, {"m", "r", "A", "C", "g"},
         {1, 1, 0.25, 0.5, 9.81}, {0}, 2, 0, false},
        {"ball_on_table", {"x", "y", "theta_x", "theta_y", "theta_z"}, {"m", "J", "a", "Omega"},
         {1, 0.1, 0.5, 1}, {0.7, -0.18, 0.17, -0.1065}, 2, 4, true},
        {"snakeboard", {"x", "y", "theta", "psi", "phi"}, {"m", "r", "J0", "J1"},
         {1, 0.5, 0.1, 0.05}, {0.05, 0.08}, 2, 2, false},
        {"n_trailer", {"x", "y", "theta0", "theta1", "theta2", "theta3"},
         {"trailers", "d", "m", "J"}, {3, 1, 1, 0.1}, {0.5}, 4, 1, false},
    };
    const size_t count = sizeof expected / sizeof expected[0];
    CHECK(dal_builtin_count() == count);
    CHECK(dal_builtin_name(count) == NULL && dal_builtin_help(count) == NULL);
    for (size_t k = 0; k < count; k++) {
        dal_system *system = plain(expected[k].name);
        CHECK(!strcmp(dal_builtin_name(k), expected[k].name));
        CHECK(!strcmp(dal_builtin_help(k), dal_system_help(system)));
        CHECK(dal_system_m(system) == expected[k].m);
        CHECK(dal_system_missing(system) == 0);
        CHECK((system->def.exact != NULL) == expected[k].exact);
        size_t i = 0;
        for (; expected[k].coordinates[i]; i++)
            CHECK(!strcmp(dal_system_coordinate(system, i), expected[k].coordinates[i]));
        CHECK(i == 0 || dal_system_n(system) == i);
        CHECK(dal_system_coordinate(system, dal_system_n(system)) == NULL);
        for (i = 0; expected[k].parameters[i]; i++) {
            CHECK(!strcmp(dal_system_parameter_name(system, i), expected[k].parameters[i]));
            CHECK(dal_system_parameter(system, i) == expected[k].defaults[i]);
        }
        CHECK(dal_system_parameters(system) == i);
        CHECK(dal_system_invariants(system) == expected[k].invariants);
        double x[14], values[MAX_VALUES];
        CHECK(dal_system_state(system, x) == DAL_SUCCESS);
        CHECK(dal_system_invariant(system, 0.0, x, values)
              == (expected[k].invariants ? DAL_SUCCESS : DAL_EUNSUPPORTED));
        for (i = 0; i < expected[k].invariants; i++) {
            CHECK(strlen(dal_system_invariant_name(system, i)) > 0);
            CHECK_NEAR(values[i], expected[k].values[i], 1e-15);
        }
        CHECK(dal_system_invariant_name(system, i) == NULL);
        release(system);
    }

    dal_system *system = make(&(choice){"chaotic", {"pairs"}, {2.0}});
    static const char *const names[5] = {"x", "y1", "y2", "z1", "z2"};
    CHECK(dal_system_n(system) == 5);
    for (size_t i = 0; i < 5; i++) CHECK(!strcmp(dal_system_coordinate(system, i), names[i]));

    system = make(&(choice){"n_trailer", {"trailers"}, {50.0}});
    CHECK(dal_system_n(system) == 53 && dal_system_m(system) == 51);
    CHECK(!strcmp(dal_system_coordinate(system, 52), "theta50"));
}

/* M of the systems with masses: {m, m, ...} in the order of the coordinates. */
static void test_mass(void)
{
    static const struct {
        choice system;
        double diagonal[5];
    } expected[] = {
        {{"particle", {NULL}, {0}}, {1, 1, 1}},
        {{"knife_edge", {"m", "J"}, {2, 3}}, {2, 2, 3}},
        {{"sleigh", {"m", "J"}, {2, 3}}, {2, 2, 3}},
        {{"disk", {"m", "I", "J"}, {2, 3, 4}}, {2, 2, 3, 4}},
        {{"robot", {"m", "I", "J"}, {2, 3, 4}}, {2, 2, 3, 4}},
        {{"ball_on_table", {"m", "J"}, {2, 3}}, {2, 2, 3, 3, 3}},
    };
    for (size_t k = 0; k < sizeof expected / sizeof expected[0]; k++) {
        dal_system *system = make(&expected[k].system);
        const size_t n = dal_system_n(system);
        for (size_t i = 0; i < n; i++)
            for (size_t j = 0; j < n; j++)
                CHECK(mass_of(system)[i * n + j]
                      == (i == j ? expected[k].diagonal[i] : 0.0));
        release(system);
    }

    static const double board[25] = {2, 0, 0,  0, 0, 0, 2, 0, 0, 0, 0, 0, 18,
                                     4, 0, 0, 0, 4, 4, 0, 0, 0, 0, 0, 10};
    dal_system *system =
        make(&(choice){"snakeboard", {"m", "r", "J0", "J1"}, {2, 3, 4, 5}});
    CHECK(!memcmp(mass_of(system), board, sizeof board));
}

/* What is declared steady is so, and what is not declared is not: no coordinate, and some
 * coordinate, moves mu and is pushed by a reaction. */
static void test_steady(void)
{
    size_t found = 0;
    for (size_t c = 0; c < CHOICES; c++) {
        dal_system *const system = make(&choices[c]);
        const dal_system_def *const def = &system->def;
        const size_t n = def->n, m = def->m;
        if (def->mass && def->kind == DAL_LINEAR) {
            double q[MAX_N], v[MAX_N], mu[MAX_M * MAX_N], N[MAX_M * MAX_N];
            for (size_t i = 0; i < n; i++) {
                q[i] = 0.1 + 0.07 * (double)i;
                v[i] = 1.0 - 0.3 * (double)i;
            }
            CHECK(def->constraint(0.0, q, v, NULL, mu, N, NULL, def->ctx) == 0);
            bool both = false;
            for (size_t i = 0; i < n; i++) {
                bool pushed = false, turns = false;
                for (size_t a = 0; a < m; a++) {
                    double z = 0.0;
                    for (size_t j = 0; j < n; j++)
                        z += system->mass_inverse[i * n + j] * mu[a * n + j];
                    pushed |= z != 0.0;
                    turns |= N[a * n + i] != 0.0;
                }
                both |= pushed && turns;
            }
            CHECK(both == !def->steady);
            found += def->steady != 0;
        } else {
            CHECK(!def->steady);
        }
        release(system);
    }
    CHECK(found == 15); /* of the choices */
}

/* What dal_system_builtin refuses, and that the text names what was wrong. */
static void test_errors(void)
{
    static const struct {
        const char *system, *parameter;
        double value;
        const char *words[3];
    } refused[] = {
        {"pendulum", NULL, 0, {"pendulum", "knife_edge", "chaotic"}},
        {"", NULL, 0, {"particle", NULL, NULL}},
        {"Particle", NULL, 0, {"Particle", "particle_oscillator", NULL}},
        {"part", NULL, 0, {"part", NULL, NULL}},
        {"particles", NULL, 0, {"particles", NULL, NULL}},
        {"sleigh", "b", 1, {"sleigh", "\"b\"", "m, J, a"}},
        {"sleigh", "M", 1, {"sleigh", "\"M\"", "m, J, a"}},
        {"particle", "m", 1, {"particle", "\"m\"", "none"}},
        {"knife_edge", "m", -1.5, {"parameter m", "-1.5", "> 0"}},
        {"knife_edge", "J", 0, {"parameter J", "= 0", "> 0"}},
        {"knife_edge", "gs", NAN, {"parameter gs", "nan", "finite"}},
        {"sleigh", "a", INFINITY, {"parameter a", "inf", "finite"}},
        {"disk", "R", 0, {"parameter R", "= 0", "> 0"}},
        {"robot", "k", -INFINITY, {"parameter k", "-inf", "finite"}},
        {"contact_oscillator", "eps", -0.1, {"parameter eps", "-0.1", ">= 0"}},
        {"contact_oscillator", "eps", NAN, {"parameter eps", "nan", ">= 0"}},
        {"chaotic", "pairs", 0, {"parameter pairs", "= 0", "from 1 to 1000"}},
        {"chaotic", "pairs", -3, {"parameter pairs", "-3", "from 1 to 1000"}},
        {"chaotic", "pairs", 2.5, {"parameter pairs", "2.5", "from 1 to 1000"}},
        {"chaotic", "pairs", 1001, {"parameter pairs", "1001", "from 1 to 1000"}},
        {"chaotic", "pairs", 1e300, {"parameter pairs", "1e+300", "from 1 to 1000"}},
        {"chaotic", "pairs", NAN, {"parameter pairs", "nan", "from 1 to 1000"}},
        {"n_trailer", "trailers", 0, {"parameter trailers", "= 0", "from 1 to 50"}},
        {"n_trailer", "trailers", 51, {"parameter trailers", "= 51", "from 1 to 50"}},
        {"n_trailer", "trailers", 1.5, {"parameter trailers", "= 1.5", "from 1 to 50"}},
        {"n_trailer", "J", 0, {"parameter J", "= 0", "> 0"}},
        {"rolling_disc", "g", -1, {"parameter g", "= -1", ">= 0"}},
        {"rolling_disc", "R", 1, {"rolling_disc", "\"R\"", "m, r, A, C, g"}},
        {"ball_on_table", "Omega", INFINITY, {"parameter Omega", "inf", "finite"}},
        {"snakeboard", "J0", 0.25, {"J0 = 0.25", "m r^2 > J0", "m r^2 is 0.25"}},
        {"snakeboard", "m", 0.2, {"m = 0.2", "r = 0.5", "m r^2 is 0.05"}},
    };
    dal_system *system = NULL;
    dal_error error;
    for (size_t k = 0; k < sizeof refused / sizeof refused[0]; k++) {
        const size_t count = refused[k].parameter ? 1 : 0;
        CHECK(dal_system_builtin(&system, refused[k].system, &refused[k].parameter,
                                 &refused[k].value, count, &error) == DAL_EINVAL);
        CHECK(error.status == DAL_EINVAL && system == NULL);
        for (size_t i = 0; i < 3 && refused[k].words[i]; i++)
            if (!strstr(error.text, refused[k].words[i])) {
                CHECK(!"the text says what was wrong");
                fprintf(stderr, "    no \"%s\" in \"%s\"\n", refused[k].words[i], error.text);
            }
        CHECK(dal_system_builtin(&system, refused[k].system, &refused[k].parameter,
                                 &refused[k].value, count, NULL) == DAL_EINVAL);
    }

    const char *const names[2] = {"m", NULL};
    const double values[2] = {1.0, 2.0};
    CHECK(dal_system_builtin(NULL, "disk", NULL, NULL, 0, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "system is NULL"));
    CHECK(dal_system_builtin(&system, NULL, NULL, NULL, 0, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "name is NULL"));
    CHECK(dal_system_builtin(&system, "disk", NULL, values, 1, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "names is NULL"));
    CHECK(dal_system_builtin(&system, "disk", names, NULL, 1, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "values is NULL"));
    CHECK(dal_system_builtin(&system, "disk", names, values, 2, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "names[1] is NULL"));
    CHECK(system == NULL);

    char long_name[2000];
    memset(long_name, 'x', sizeof long_name - 1);
    long_name[sizeof long_name - 1] = '\0';
    CHECK(dal_system_builtin(&system, long_name, NULL, NULL, 0, &error) == DAL_EINVAL);
    for (size_t i = 0; i < dal_builtin_count(); i++) /* whole names: all of them fit in the text */
        CHECK(strstr(error.text, dal_builtin_name(i)) != NULL);

    CHECK(dal_system_builtin(&system, "knife-edge", names, values, 1, &error) == DAL_SUCCESS);
    CHECK(error.text[0] == '\0' && !strcmp(dal_system_name(system), "knife_edge"));
    CHECK(dal_system_parameter(system, 0) == 1.0 && dal_system_parameter(system, 1) == 0.75);
    CHECK(dal_system_parameter_name(system, 3) == NULL && isnan(dal_system_parameter(system, 3)));
    dal_system_free(system);
}

int main(void)
{
    for (size_t k = 0; k < CHOICES; k++) test_choice(&choices[k]);
    test_references();
    test_limits();
    test_sleigh_domain();
    test_runs();
    test_default_data();
    test_data_with_parameters();
    test_heisenberg_symmetry();
    test_description();
    test_mass();
    test_steady();
    test_errors();
    return check_done();
}
