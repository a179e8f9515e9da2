/* The embedding of a scheme in a periodically perturbed flow: against numbers of 36 digits, against
 * the scheme that it has to reproduce, and against the order that it has to measure. */
#include "fixtures.h"
#include "check.h"

enum { MOST_N = 8, WIDTH = 16 };

/* One entry of the group "embedding" of vectors.json: the particle, xi = (x, y, z, v_x, v_y). */
typedef struct embedding_vector {
    double beta;
    int order;
    double h, tau, z[5], y[5], chi0, chi1, slope, g[5], G[5];
} embedding_vector;

#include "embedding_data.h"

enum { VECTORS = sizeof embedding_vectors / sizeof embedding_vectors[0] };

static dal_embedding *open_embedding(const dal_system *system, const dal_embedding_def *def,
                                     const size_t *dependent, double *z)
{
    dal_embedding *embedding = NULL;
    dal_error error = {0};
    double x[2 * MOST_N];
    need(dal_embedding_new(&embedding, system, def, &error), "embedding", error.text);
    dal_chart *const chart = dal_embedding_chart(embedding);
    CHECK(dal_system_state(system, x) == 0);
    CHECK(dal_chart_choose(chart, 0.0, dependent, x) == 0);
    if (z) CHECK(dal_chart_drop(chart, x, z) == 0);
    return embedding;
}

/* The exact flow of the particle is good to a few u of its states of size 1; what is lost then is
 * division by h^(p+1). */
static void test_vectors(void)
{
    dal_system *const system = open_system("particle");
    static const size_t dependent[1] = {2};
    for (size_t k = 0; k < VECTORS; k++) {
        const embedding_vector *const e = &embedding_vectors[k];
        const dal_scheme scheme = {.beta = e->beta};
        for (int numerical = 0; numerical < 2; numerical++) {
            const dal_embedding_def def = {.scheme = &scheme, .h = e->h, .order = e->order,
                                           .numerical = numerical};
            dal_embedding *const embedding = open_embedding(system, &def, dependent, NULL);
            const double state = numerical ? 1e-13 : 32 * U;
            const double noise = 32 * dal_embedding_noise(embedding);
            double y[5], g[5], G[5], chi0, chi1, slope;
            dal_cutoff(e->tau, &chi0, &chi1, &slope);
            CHECK_NEAR(chi0, e->chi0, 4 * U);
            /* the exponents, at most 2 cot(pi/10) = 6, are rounded, and so is tau */
            CHECK_NEAR(chi1, e->chi1, 32 * U * e->chi1);
            CHECK_NEAR(slope, e->slope, 64 * U * fabs(e->slope));
            CHECK(dal_embedding_order(embedding) == e->order);
            CHECK(dal_embedding_source(embedding, e->tau, e->z, y) == 0);
            CHECK_NEAR(largest_difference(5, y, e->y), 0.0, state);
            CHECK(dal_embedding_field(embedding, e->tau, e->z, g) == 0);
            CHECK_NEAR(largest_difference(5, g, e->g), 0.0, noise);
            CHECK(dal_embedding_curve(embedding, e->tau, e->z, G) == 0);
            CHECK_NEAR(largest_difference(5, G, e->G), 0.0, state);
            dal_embedding_free(embedding);
        }
    }
}

/* The time-h map of the perturbed ODE is the scheme, from any start of a period; the curve through
 * Phi(y) goes on periodically; g is 1-periodic and 0 at integer tau. */
static void test_period_map(const char *name, const char *scheme_name, double h)
{
    dal_system *const system = open_system(name);
    const dal_scheme scheme = find_scheme(scheme_name);
    const dal_embedding_def def = {.scheme = &scheme, .h = h};
    double z[WIDTH], end[WIDTH], curve[WIDTH], g[WIDTH], again[WIDTH], x[2 * MOST_N], y[WIDTH];
    dal_embedding *const embedding = open_embedding(system, &def, NULL, z);
    dal_chart *const chart = dal_embedding_chart(embedding);
    const size_t width = 2 * system->def.n - system->def.m;
    CHECK(dal_chart_lift(chart, 0.0, z, x) == 0);
    dal_stepper *const stepper = start_stepper(system, &scheme, h, x);
    CHECK(dal_step(stepper, NULL) == 0);
    CHECK(dal_chart_drop(chart, dal_stepper_state(stepper), end) == 0);

    memcpy(y, z, sizeof y);
    CHECK(dal_embedding_flow(embedding, 0.0, h, y) == 0);
    CHECK_NEAR(largest_difference(width, y, end), 0.0, 1e-10);
    CHECK(dal_embedding_flow(embedding, 5 * h, 4 * h, y) == 0); /* and back, in another period */
    CHECK_NEAR(largest_difference(width, y, z), 0.0, 2e-10);

    CHECK(dal_embedding_curve(embedding, 1.0, z, curve) == 0);
    CHECK_NEAR(largest_difference(width, curve, end), 0.0, 1e-13);
    CHECK(dal_embedding_curve(embedding, 0.3, end, curve) == 0);
    CHECK(dal_embedding_curve(embedding, 1.3, z, again) == 0);
    CHECK_NEAR(largest_difference(width, curve, again), 0.0, 1e-12);

    CHECK(dal_embedding_field(embedding, 0.4, z, g) == 0);
    CHECK(dal_embedding_field(embedding, -2.6, z, again) == 0);
    CHECK_NEAR(largest_difference(width, g, again), 0.0, 100 * dal_embedding_noise(embedding));
    CHECK(dal_embedding_field(embedding, 3.0, z, again) == 0);
    CHECK(sum_of_sizes(width, again) == 0.0);
    /* the curve from the source goes through z */
    CHECK(dal_embedding_source(embedding, 0.4, z, y) == 0);
    CHECK(dal_embedding_curve(embedding, 0.4, y, curve) == 0);
    CHECK_NEAR(largest_difference(width, curve, z), 0.0, 1e-13);

    /* g~ is tangent to D: the perturbed DAE with it has lambda of the plain one, and its field is
     * that of the perturbed ODE */
    double J[2 * MOST_N * WIDTH], gtilde[2 * MOST_N], xdot[2 * MOST_N], plain[2 * MOST_N];
    double lambda[MOST_N], lambda0[MOST_N];
    const size_t n = system->def.n, m = system->def.m;
    dal_mechanics *const mech = open_mechanics(system);
    CHECK(dal_chart_jacobian(chart, 0.0, z, J, NULL) == 0);
    dal__apply(2 * n, width, J, g, gtilde);
    const double weight = pow(h, scheme.order);
    CHECK(dal_perturbed(mech, 0.0, weight, x, gtilde, xdot, lambda) == 0);
    CHECK(dal_field(mech, 0.0, x, plain) == 0 && dal_multipliers(mech, 0.0, x, lambda0) == 0);
    for (size_t i = 0; i < 2 * n; i++)
        CHECK_NEAR(xdot[i], plain[i] + weight * gtilde[i], 1e3 * U * (1 + fabs(plain[i])));
    CHECK_NEAR(largest_difference(m, lambda, lambda0), 0.0, 1e3 * U * (1 + fabs(lambda0[0])));
    dal_embedding_free(embedding);
}

/* max |g| over tau. */
static double bound(const dal_system *system, const char *scheme_name, double h, int order)
{
    const dal_scheme scheme = find_scheme(scheme_name);
    const dal_embedding_def def = {.scheme = &scheme, .h = h, .order = order};
    double z[WIDTH], g[WIDTH], most = 0.0;
    dal_embedding *const embedding = open_embedding(system, &def, NULL, z);
    for (int k = 1; k < 8; k++) {
        CHECK(dal_embedding_field(embedding, k / 8.0, z, g) == 0);
        most = fmax(most, dal__largest(2 * system->def.n - system->def.m, g));
    }
    CHECK(dal_embedding_noise(embedding) < 1e-2 * most);
    dal_embedding_free(embedding);
    return most;
}

/* With the right p the bound hardly changes with h over [1e-2, 0.25]; with p + 1 it doubles as h is
 * halved, with p - 1 it is halved. */
static void test_measures_order(const char *name, const char *scheme, int order)
{
    dal_system *const system = open_system(name);
    double least = INFINITY, most = 0.0;
    for (double h = 0.25; h > 0.01; h /= 2) {
        const double g = bound(system, scheme, h, order);
        least = fmin(least, g);
        most = fmax(most, g);
    }
    check_true(most < 1.5 * least, name, scheme, (int)(100 * most / least));
    for (int wrong = order == 1 ? 1 : -1; wrong <= 1; wrong += 2) { /* 0: the record's own */
        const double ratio = bound(system, scheme, 0.04, order + wrong)
                           / bound(system, scheme, 0.08, order + wrong);
        CHECK_NEAR(ratio, wrong > 0 ? 2.0 : 0.5, wrong > 0 ? 0.25 : 0.06);
    }
}

/* For h -> 0: g(tau, z) = -chi_0'(tau) d(z); d of the particle is known. */
static void test_limit(double beta, int order)
{
    dal_system *const system = open_system("particle");
    const dal_scheme scheme = {.beta = beta};
    const dal_embedding_def def = {.scheme = &scheme, .h = 1e-3, .order = order};
    static const size_t dependent[1] = {2};
    double z[5], d[5], g[5], slope;
    dal_embedding *const embedding = open_embedding(system, &def, dependent, z);
    const double y = z[1], a = z[3], b = z[4], s = 1 + y * y;
    const double first[5] = {a * b * y / (2 * s), 0.0, -a * b / (2 * s), -a * b * b / (2 * s * s),
                             0};
    const double second[5] = {a * b * b * (2 * y * y - 1) / (12 * s * s), 0.0,
                              -a * b * b * y / (4 * s * s), -a * b * b * b * y / (4 * s * s * s),
                              0};
    const double sign = beta == 1.0 ? -1.0 : 1.0;
    const double *const expected = order == 1 ? first : second;
    CHECK(dal_embedding_limit(embedding, z, d) == 0);
    for (size_t i = 0; i < 5; i++) CHECK_NEAR(d[i], sign * expected[i], 2e-3 + 1e-5);
    for (double tau = 0.1; tau < 1.0; tau += 0.2) {
        dal_cutoff(tau, NULL, NULL, &slope);
        CHECK(dal_embedding_field(embedding, tau, z, g) == 0);
        for (size_t i = 0; i < 5; i++) CHECK_NEAR(g[i], -slope * sign * expected[i], 4e-3);
    }
    dal_embedding_free(embedding);
}

/* With h so large that the curves do not cover the states, no g is made up: the iteration says so,
 * whether it diverges or does not settle. */
static void test_too_large(const char *name, const char *scheme_name, double h)
{
    dal_system *const system = open_system(name);
    const dal_scheme scheme = find_scheme(scheme_name);
    const dal_embedding_def def = {.scheme = &scheme, .h = h};
    double z[WIDTH] = {0.0}, g[WIDTH] = {7.0}, y[WIDTH] = {7.0};
    dal_embedding *const embedding = open_embedding(system, &def, NULL, z);
    CHECK(dal_embedding_field(embedding, 0.55, z, g) == DAL_ENOCONV && g[0] == 7.0);
    CHECK(strstr(dal_embedding_error(embedding)->text, "is too large") != NULL);
    CHECK(dal_embedding_source(embedding, 0.55, z, y) == DAL_ENOCONV && y[0] == 7.0);
    memcpy(y, z, sizeof y);
    CHECK(dal_embedding_flow(embedding, 0.0, h, y) == DAL_ENOCONV);
    CHECK(memcmp(y, z, sizeof y) == 0);
    dal_embedding_free(embedding);
}

/* A contraction that is slow: after 100 iterations the last change, 0.8^100, is a little below or a
 * little above 1e4 times the accuracy of the exact flow, 4 u of states of size 2. */
static void test_slow_contraction(double h, int expected)
{
    dal_system *const system = open_system("particle");
    const dal_scheme scheme = find_scheme("explicit");
    const dal_embedding_def def = {.scheme = &scheme, .h = h};
    double z[WIDTH], y[WIDTH];
    dal_embedding *const embedding = open_embedding(system, &def, NULL, z);
    CHECK(dal_embedding_source(embedding, 0.55, z, y) == expected);
    dal_embedding_free(embedding);
}

/* The particle, without its exact solution. */
static int particle_constraint(double t, const double *q, const double *v, double *phi,
                               double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    if (phi) *phi = v[2] - q[1] * v[0];
    if (phi_v) phi_v[0] = -q[1], phi_v[1] = 0.0, phi_v[2] = 1.0;
    if (phi_q) phi_q[0] = 0.0, phi_q[1] = -v[0], phi_q[2] = 0.0;
    return 0;
}

static int stop(double far, void *ctx)
{
    *(double *)ctx = far;
    return far > 0.0;
}

static int stop_at_once(double far, void *ctx)
{
    *(double *)ctx = far;
    return 1;
}

/* A watch ends a curve of more steps than anybody waits for, a flow, and a perturbed flow. */
static void test_watch(void)
{
    static const double mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    static const double state[6] = {0.1, 0.5, 0.2, 1.0, 0.7, 0.5};
    const dal_system_def own = {.n = 3, .m = 1, .mass = mass, .constraint = particle_constraint,
                                .state = state};
    dal_system *const system = new_system(&own);
    const dal_scheme scheme = find_scheme("midpoint");
    const dal_embedding_def def = {.scheme = &scheme, .h = 0.1};
    double z[WIDTH], y[WIDTH], G[WIDTH] = {7.0}, far = -1.0;
    dal_embedding *const embedding = open_embedding(system, &def, NULL, z);
    memcpy(y, z, sizeof y);
    dal_embedding_watch(embedding, stop, &far);
    CHECK(dal_embedding_curve(embedding, 0x1p52, z, G) == DAL_STOPPED && G[0] == 7.0);
    CHECK(far >= 1.0);
    dal_embedding_watch(embedding, stop_at_once, &far); /* in a flow, and in a perturbed one */
    far = -1.0;
    CHECK(dal_embedding_flow(embedding, 0.0, 0.1, y) == DAL_STOPPED && far >= 0.0);
    CHECK(memcmp(y, z, 5 * sizeof *y) == 0); /* 2n - m */
    far = -1.0;
    CHECK(dal_embedding_limit(embedding, z, G) == DAL_STOPPED && far >= 0.0 && G[0] == 7.0);
    dal_embedding_watch(embedding, NULL, NULL);
    CHECK(dal_embedding_flow(embedding, 0.0, 0.1, y) == 0);
    dal_embedding_free(embedding);
}

static void test_failures(void)
{
    dal_system *const system = open_system("particle");
    const dal_scheme scheme = find_scheme("midpoint"), own = {.beta = 0.5};
    dal_embedding *embedding = NULL;
    dal_error error;
    double z[5] = {0.5, 0.3, -0.2, 1.0, 0.7}, g[5] = {7, 7, 7, 7, 7};
#define REFUSED(definition, status, name)                                                     \
    do {                                                                                      \
        const dal_embedding_def def_ = definition;                                            \
        CHECK(dal_embedding_new(&embedding, system, &def_, &error) == (status));              \
        check_true(embedding == NULL && strstr(error.text, name), error.text, name, __LINE__); \
    } while (0)
#define DEF(...) ((dal_embedding_def){__VA_ARGS__})
    REFUSED(DEF(.h = 0.1), DAL_EINVAL, "def->scheme is NULL");
    REFUSED(DEF(.scheme = &scheme), DAL_EINVAL, "h = 0");
    REFUSED(DEF(.scheme = &scheme, .h = NAN), DAL_EINVAL, "h = nan");
    REFUSED(DEF(.scheme = &own, .h = 0.1), DAL_EINVAL, "order = 0");
    REFUSED(DEF(.scheme = &own, .h = 0.1, .order = -2), DAL_EINVAL, "order = -2");
    REFUSED(DEF(.scheme = &scheme, .h = 0.1, .tolerance = 2.0), DAL_EINVAL, "tolerance = 2");
    CHECK(dal_embedding_new(NULL, system, &DEF(.scheme = &scheme, .h = 0.1), &error) == DAL_EINVAL);
    CHECK(dal_embedding_new(&embedding, NULL, &DEF(.scheme = &scheme, .h = 0.1), NULL)
          == DAL_EINVAL);
    CHECK(dal_embedding_new(&embedding, system, NULL, NULL) == DAL_EINVAL);
    CHECK(dal_embedding_new(&embedding, system, &DEF(.scheme = &scheme, .h = 0.1), &error) == 0);
    CHECK(dal_embedding_field(embedding, 0.5, z, g) == DAL_EINVAL); /* no chart yet */
    CHECK(strstr(dal_embedding_error(embedding)->text, "chart") != NULL);
    double x[6];
    CHECK(dal_system_state(system, x) == 0);
    CHECK(dal_chart_choose(dal_embedding_chart(embedding), 0.0, NULL, x) == 0);
    CHECK(dal_embedding_field(embedding, NAN, z, g) == DAL_EINVAL);
    CHECK(dal_embedding_field(embedding, 0.5, NULL, g) == DAL_EINVAL);
    CHECK(strstr(dal_embedding_error(embedding)->text, "z is NULL") != NULL);
    CHECK(dal_embedding_field(embedding, 0.5, z, NULL) == DAL_EINVAL);
    CHECK(dal_embedding_curve(embedding, -0.5, z, g) == DAL_EINVAL);
    CHECK(strstr(dal_embedding_error(embedding)->text, "tau = -0.5") != NULL);
    CHECK(dal_embedding_curve(embedding, 1e300, z, g) == DAL_EINVAL); /* for ever */
    CHECK(strstr(dal_embedding_error(embedding)->text, "tau = 1e+300") != NULL);
    CHECK(dal_embedding_curve(embedding, 0.5, NULL, g) == DAL_EINVAL);
    CHECK(strstr(dal_embedding_error(embedding)->text, "y is NULL") != NULL);
    CHECK(dal_embedding_flow(embedding, 0.0, INFINITY, z) == DAL_EINVAL && z[0] == 0.5);
    CHECK(strstr(dal_embedding_error(embedding)->text, "t1 = inf") != NULL);
    CHECK(dal_embedding_flow(embedding, NAN, 1.0, z) == DAL_EINVAL && z[0] == 0.5);
    CHECK(strstr(dal_embedding_error(embedding)->text, "t0 = nan") != NULL);
    double y[5]; /* just below an integer is where the curves start */
    CHECK(dal_embedding_source(embedding, -1e-18, z, y) == 0);
    for (int i = 0; i < 5; i++) CHECK_NEAR(y[i], z[i], 4 * U);
    z[1] = NAN;
    CHECK(dal_embedding_source(embedding, 0.5, z, g) == DAL_EINVAL);
    CHECK(strstr(dal_embedding_error(embedding)->text, "z[1] = nan") != NULL);
    CHECK(dal_embedding_limit(embedding, z, g) == DAL_EINVAL && g[0] == 7.0);
    CHECK(dal_embedding_field(NULL, 0.5, z, g) == DAL_EINVAL);
    dal_embedding_free(embedding);
    const dal_scheme midpoint = find_scheme("midpoint");
    const dal_embedding_def tiny = {.scheme = &midpoint, .h = 1e-120}; /* h^3 is 0 */
    embedding = open_embedding(system, &tiny, NULL, z);
    g[0] = 7.0;
    CHECK(dal_embedding_limit(embedding, z, g) == DAL_EDOMAIN && g[0] == 7.0);
    dal_embedding_free(embedding);
    dal_embedding_free(NULL);
}

int main(void)
{
    test_vectors();
    test_period_map("particle", "explicit", 0.1);
    test_period_map("particle", "midpoint", 0.2);
    test_period_map("sleigh", "midpoint", 0.1);
    test_period_map("generic4", "endpoint", 0.05);
    test_period_map("generic4", "leapfrog", 0.1);
    test_measures_order("particle", "explicit", 1);
    test_measures_order("particle", "midpoint", 2);
    test_measures_order("sleigh", "endpoint", 1);
    test_measures_order("generic4", "midpoint", 2);
    test_measures_order("generic4", "leapfrog", 2);
    test_limit(0.0, 1);
    test_limit(1.0, 1);
    test_limit(0.5, 2);
    test_too_large("sleigh", "explicit", 5.0);
    test_slow_contraction(4.0, 0);
    test_slow_contraction(4.125, DAL_ENOCONV);
    test_watch();
    test_failures();
    return check_done();
}
