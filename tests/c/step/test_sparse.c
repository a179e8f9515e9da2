/* Systems with a sparsity and masses against the same ones with all entries and a mass matrix:
 * steps of every kind, mechanics, charts, what is refused; and how memory grows with n. */
#include "fixtures.h"
#include "check.h"
#include "dalembert/study.h"

enum { MOST_LINKS = 14, MOST_COORDINATES = 3 * MOST_LINKS };

/* A chain of blades, with the coordinates (x, y, heading) each: blade a does not slip sideways, but
 * for what the blade before, or one far away, drags it along. */
typedef struct chain {
    size_t links;
    double coupling, stiffness, wind, drag; /* wind depends on q alone, drag on v */
    bool sparse;
    bool far; /* the last blade hangs on the first */
    bool curved; /* V_qq is given */
} chain;

static bool has_partner(const chain *c, size_t a)
{
    return c->coupling != 0.0 && (a > 0 || (c->far && c->links > 2));
}

static size_t partner(const chain *c, size_t a) { return a > 0 ? a - 1 : c->links - 1; }

/* The entries of a row, in these columns, as they are written one after the other. */
typedef struct entries {
    size_t count, column[8];
    double mu[8], N[8];
} entries;

static void write(entries *row, size_t column, double mu, double N)
{
    row->column[row->count] = column;
    row->mu[row->count] = mu;
    row->N[row->count++] = N;
}

static void write_partner(const chain *c, size_t b, const double *q, const double *v, entries *row)
{
    const double heading = q[3 * b + 2];
    write(row, 3 * b, c->coupling * cos(heading), 0.0);
    write(row, 3 * b + 2, 0.0, -c->coupling * sin(heading) * v[3 * b]);
}

static entries row_of(const chain *c, size_t a, const double *q, const double *v)
{
    entries row = {0};
    const double heading = q[3 * a + 2];
    const size_t b = partner(c, a);
    if (has_partner(c, a) && b < a) write_partner(c, b, q, v, &row);
    write(&row, 3 * a, -sin(heading), 0.0);
    write(&row, 3 * a + 1, cos(heading), 0.0);
    write(&row, 3 * a + 2, 0.3, -cos(heading) * v[3 * a] - sin(heading) * v[3 * a + 1]);
    if (has_partner(c, a) && b > a) write_partner(c, b, q, v, &row);
    return row;
}

static int chain_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                            double *phi_q, double *phi_t, void *ctx)
{
    const chain *const c = ctx;
    const size_t n = 3 * c->links;
    size_t before = 0;
    (void)t, (void)phi, (void)phi_t;
    for (size_t k = 0; !c->sparse && k < c->links * n; k++) {
        if (phi_v) phi_v[k] = 0.0;
        if (phi_q) phi_q[k] = 0.0;
    }
    for (size_t a = 0; a < c->links; a++) {
        const double still[MOST_COORDINATES] = {0.0};
        const entries row = row_of(c, a, q, phi_q ? v : still);
        for (size_t k = 0; k < row.count; k++) {
            const size_t place = c->sparse ? before + k : a * n + row.column[k];
            if (phi_v) phi_v[place] = row.mu[k];
            if (phi_q) phi_q[place] = row.N[k];
        }
        before += row.count;
    }
    return q[0] > 50.0;
}

/* Bonds (l^2 - 1)^2 between neighbours. */
static int chain_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                           void *ctx)
{
    const chain *const c = ctx;
    const size_t n = 3 * c->links;
    (void)t;
    if (V_qq && !c->curved) return -1; /* it is not asked for */
    if (V) *V = 0.0;
    for (size_t k = 0; V_qq && k < n * n; k++) V_qq[k] = 0.0;
    for (size_t i = 0; V_q && i < n; i++) V_q[i] = 0.0;
    for (size_t a = 0; a + 1 < c->links; a++) {
        const double *const p = q + 3 * a;
        const double d[2] = {p[3] - p[0], p[4] - p[1]};
        const double stretch = d[0] * d[0] + d[1] * d[1] - 1.0;
        if (V) *V += 0.25 * c->stiffness * stretch * stretch;
        for (size_t i = 0; V_q && i < 2; i++) {
            V_q[3 * a + i] -= c->stiffness * stretch * d[i];
            V_q[3 * a + 3 + i] += c->stiffness * stretch * d[i];
        }
        for (size_t i = 0; V_qq && i < 2; i++)
            for (size_t j = 0; j < 2; j++) {
                const double slope =
                    c->stiffness * (2.0 * d[i] * d[j] + (i == j ? stretch : 0.0));
                V_qq[(3 * a + i) * n + 3 * a + j] += slope;
                V_qq[(3 * a + 3 + i) * n + 3 * a + 3 + j] += slope;
                V_qq[(3 * a + i) * n + 3 * a + 3 + j] -= slope;
                V_qq[(3 * a + 3 + i) * n + 3 * a + j] -= slope;
            }
    }
    return 0;
}

static int chain_force(double t, const double *q, const double *v, const double *u, double *f,
                       double *f_q, double *f_v, void *ctx)
{
    const chain *const c = ctx;
    const size_t n = 3 * c->links;
    if (f_q || f_v) return -1; /* they are never asked for */
    for (size_t i = 0; f && i < n; i++) {
        f[i] = c->wind * sin(t + q[i]) + u[0];
        if (c->drag != 0.0) f[i] -= c->drag * v[i] * (1.0 + 0.2 * v[(i + 1) % n]);
    }
    return 0;
}

static dal_system *open_chain(chain *c, unsigned missing)
{
    const size_t n = 3 * c->links;
    double masses[MOST_COORDINATES], mass[MOST_COORDINATES * MOST_COORDINATES] = {0.0};
    const double zero[MOST_COORDINATES] = {0.0};
    size_t row[8 * MOST_LINKS], column[8 * MOST_LINKS], count = 0;
    for (size_t i = 0; i < n; i++) masses[i] = mass[i * n + i] = 1.0 + 0.1 * (double)(i % 7);
    for (size_t a = 0; a < c->links; a++) {
        const entries found = row_of(c, a, zero, zero);
        for (size_t k = 0; k < found.count; k++) {
            row[count] = a;
            column[count++] = found.column[k];
        }
    }
    const dal_sparsity sparsity = {count, row, column};
    const bool forced = c->wind != 0.0 || c->drag != 0.0;
    const dal_system_def def = {
        .n = n, .m = c->links, .ctx = c, .ctx_size = sizeof *c, .constraint = chain_constraint,
        .potential = c->stiffness != 0.0 ? chain_potential : NULL,
        .force = forced ? chain_force : NULL, .inputs = forced,
        .positional = forced && c->drag == 0.0,
        .missing = missing | (forced ? DAL_MISSING_F_Q | DAL_MISSING_F_V : 0),
        .masses = c->sparse ? masses : NULL, .mass = c->sparse ? NULL : mass,
        .sparsity = c->sparse ? &sparsity : NULL};
    dal_system *system = NULL;
    dal_error error = {0};
    need(dal_system_new(&system, &def, &error), "chain", error.text);
    return system;
}

/* The same with all entries, and with those of the sparsity. */
static void open_both(chain c, dal_system *both[2])
{
    for (int k = 0; k < 2; k++) {
        c.sparse = k == 1;
        both[k] = open_chain(&c, c.stiffness != 0.0 && !c.curved ? DAL_MISSING_V_QQ : 0);
    }
}

/* A state of D. */
static void start_of(const dal_system *system, double *x)
{
    const size_t n = system->def.n;
    dal_mechanics *const mech = open_mechanics(system);
    for (size_t i = 0; i < n; i++) {
        x[i] = i % 3 == 0 ? (double)(i / 3) : 0.2 * sin(1.7 * (double)i);
        x[n + i] = cos((double)i) + (i % 3 == 2 ? 0.5 : 0.0);
    }
    CHECK(dal_project(mech, 0.0, 0.0, x, NULL) == 0);
    dal_mechanics_free(mech);
}

static const chain chains[] = {
    {.links = 1}, {.links = 5}, {.links = 5, .stiffness = 1.0},
    {.links = 9, .stiffness = 1.0, .coupling = 0.4},
    {.links = 14, .stiffness = 0.5, .coupling = 0.7, .far = true},
    {.links = 8, .stiffness = 0.5, .coupling = 0.3, .wind = 0.4},
    {.links = 7, .coupling = 0.5, .wind = 0.3, .far = true},
    {.links = 6, .stiffness = 0.5, .coupling = 0.3, .drag = 0.5},
    {.links = 5, .wind = 0.2, .drag = 2.0, .far = true},
};

/* ---- steps ------------------------------------------------------------------------------ */

static const char *const schemes[] = {
    "leapfrog", "midpoint", "explicit", "endpoint", "0.3", "leapfrog-mirror", "midpoint-nodes",
    "explicit-nodes", "leapfrog-kl8", "midpoint-suzuki4", "reference", "pair:0.5:0.5"};

static void test_steps(const chain *c)
{
    dal_system *both[2];
    double x0[2 * MOST_COORDINATES];
    const size_t n = 3 * c->links, m = c->links;
    open_both(*c, both);
    start_of(both[0], x0);
    for (size_t k = 0; k < DAL_LENGTH(schemes); k++) {
        const dal_scheme scheme = find_scheme(schemes[k]);
        const bool kept = scheme.nodes == DAL_KEPT_NODES;
        double reaction[2][MOST_LINKS], x[2][2 * MOST_COORDINATES];
        dal_stats stats[2];
        for (int s = 0; s < 2; s++) {
            dal_stepper *const stepper = open_stepper(both[s], &scheme, NULL);
            CHECK(dal_stepper_start(stepper, 0.0, 0.02, x0, DAL_CHECK,
                                    kept ? DAL_INITIAL_PROJECT : DAL_INITIAL_NONE) == 0);
            CHECK(dal_advance(stepper, 20, reaction[s], NULL) == 0);
            memcpy(x[s], dal_stepper_state(stepper), 2 * n * sizeof(double));
            dal_stepper_stats(stepper, &stats[s]);
            dal_stepper_free(stepper);
        }
        const double scale = sum_of_sizes(2 * n, x[0]);
        CHECK_NEAR(largest_difference(2 * n, x[0], x[1]), 0.0, 100.0 * U * scale);
        if (strcmp(schemes[k], "reference") != 0) /* which has none */
            CHECK_NEAR(largest_difference(m, reaction[0], reaction[1]), 0.0, 1e4 * U * scale);
        CHECK(stats[1].worst_residual <= 4.0 * (double)n * U);
        CHECK(stats[1].full_newtons == stats[0].full_newtons);
        CHECK(stats[1].constraint_calls <= 2 * stats[0].constraint_calls); /* a pair: K = M */
    }
    dal_system_free(both[0]);
    dal_system_free(both[1]);
}

/* The solution of a step that the step routine does not find is found by the full Newton iteration
 * with K = M, or there is none: never another one. */
static void test_large_steps(double drag, bool curved)
{
    const chain c = {.links = 6, .stiffness = 2.0, .coupling = 0.4, .drag = drag,
                     .curved = curved};
    dal_system *both[2];
    double x0[2 * MOST_COORDINATES];
    const size_t n = 3 * c.links;
    size_t compared = 0, refused = 0, left = 0;
    open_both(c, both);
    start_of(both[0], x0);
    for (double h = 0.05; h < 3.0; h *= 1.15)
        for (size_t k = 0; k < 5; k++) {
            const dal_scheme scheme = find_scheme(schemes[k]);
            double x[2][2 * MOST_COORDINATES];
            int status[2];
            for (int s = 0; s < 2; s++) {
                dal_stepper *const stepper = open_stepper(both[s], &scheme, NULL);
                dal_stats stats;
                CHECK(dal_stepper_start(stepper, 0.0, h, x0, DAL_CHECK, DAL_INITIAL_NONE) == 0);
                status[s] = dal_advance(stepper, 3, NULL, NULL);
                memcpy(x[s], dal_stepper_state(stepper), 2 * n * sizeof(double));
                dal_stepper_stats(stepper, &stats);
                CHECK(stats.worst_residual <= 4.0 * (double)n * U);
                if (s == 1) left += stats.full_newtons;
                dal_stepper_free(stepper);
            }
            if (curved) CHECK(!status[1] || status[0]); /* it solves what the dense one does */
            if (status[1]) {
                CHECK(status[1] == DAL_ENOCONV || status[1] == DAL_ESINGULAR
                      || status[1] == DAL_EDOMAIN);
                refused++;
            } else if (!status[0] && sum_of_sizes(2 * n, x[0]) < 1e3) { /* not blown up */
                CHECK_NEAR(largest_difference(2 * n, x[0], x[1]), 0.0,
                           1e-11 * sum_of_sizes(2 * n, x[0]));
                compared++;
            }
        }
    CHECK(compared > 60 && refused > 5 && left > 10);
    dal_system_free(both[0]);
    dal_system_free(both[1]);
}

/* ---- mechanics -------------------------------------------------------------------------- */

static void compare(const char *what, size_t count, const double *a, const double *b)
{
    const double scale = 1.0 + sum_of_sizes(count, a);
    check_true(largest_difference(count, a, b) <= 200.0 * U * scale, what, __FILE__, __LINE__);
}

static void test_mechanics(const chain *c)
{
    enum { N = MOST_COORDINATES, M = MOST_LINKS };
    static double K[2][N * N], C[2][M * M], B[2][M * N], muk[2][M * N], metric[2][N * N];
    dal_system *both[2];
    double x0[2 * N], x[2][2 * N], near[2][2 * N], lambda[2][M], field[2][2 * N], R1[2][N];
    double R2[2][M], E[2], power[2][2], residual[2][M], relative[2], distance[2], ghat[2 * N];
    double kappa[M], perturbed[2][2 * N], hat[2][M];
    unsigned char keep[N] = {0};
    const size_t n = 3 * c->links, m = c->links;
    open_both(*c, both);
    start_of(both[0], x0);
    for (size_t i = 0; i < 2 * n; i++) ghat[i] = sin((double)i);
    for (size_t a = 0; a < m; a++) kappa[a] = 0.1 * cos((double)a);
    for (size_t i = 0; i < n; i += 3) keep[i] = 1;
    for (int s = 0; s < 2; s++) {
        dal_mechanics *const mech = open_mechanics(both[s]);
        for (size_t i = 0; i < 2 * n; i++) x[s][i] = near[s][i] = x0[i] + (i < n ? 0.0 : 0.1);
        CHECK(dal_energy(mech, 0.3, x0, &E[s]) == 0);
        CHECK(dal_power(mech, 0.3, x0, &power[s][0], &power[s][1]) == 0);
        CHECK(dal_metric(mech, 0.3, x0, metric[s]) == 0);
        CHECK(dal_gram(mech, 0.3, x0, C[s]) == 0);
        CHECK(dal_multipliers(mech, 0.3, x0, lambda[s]) == 0);
        CHECK(dal_field(mech, 0.3, x0, field[s]) == 0);
        CHECK(dal_perturbed(mech, 0.3, 0.2, x0, ghat, perturbed[s], hat[s]) == 0);
        CHECK(dal_residual(mech, 0.3, 0.01, near[s], residual[s]) == 0);
        CHECK(dal_relative_residual(mech, 0.3, 0.01, near[s], &relative[s]) == 0);
        CHECK(dal_project(mech, 0.3, 0.01, x[s], &distance[s]) == 0);
        CHECK(dal_consistent(mech, 0.3, keep, near[s], NULL) == 0);
        CHECK(dal_step_equations(mech, 0.3, 0.5, 0.1, x0, near[s] + n, kappa, R1[s], R2[s],
                                 c->stiffness == 0.0 ? K[s] : NULL, B[s], muk[s]) == 0);
        dal_mechanics_free(mech);
    }
    compare("energy", 1, &E[0], &E[1]);
    compare("power", 2, power[0], power[1]);
    compare("metric", n * n, metric[0], metric[1]);
    compare("gram", m * m, C[0], C[1]);
    compare("multipliers", m, lambda[0], lambda[1]);
    compare("field", 2 * n, field[0], field[1]);
    compare("perturbed", 2 * n, perturbed[0], perturbed[1]);
    compare("hat lambda", m, hat[0], hat[1]);
    compare("residual", m, residual[0], residual[1]);
    compare("relative residual", 1, &relative[0], &relative[1]);
    compare("projection", 2 * n, x[0], x[1]);
    compare("distance", 1, &distance[0], &distance[1]);
    compare("consistent", 2 * n, near[0], near[1]);
    compare("R1", n, R1[0], R1[1]);
    compare("R2", m, R2[0], R2[1]);
    compare("K", c->stiffness == 0.0 ? n * n : 0, K[0], K[1]);
    compare("B", m * n, B[0], B[1]);
    compare("muk", m * n, muk[0], muk[1]);
    for (size_t i = 0; i < n; i += 3) CHECK(near[1][n + i] == x0[n + i] + 0.1);
    dal_system_free(both[0]);
    dal_system_free(both[1]);
}

/* The flow, with its accuracy, and a chart, which wants all entries. */
static void test_flow_and_chart(const chain *c)
{
    dal_system *both[2];
    double x0[2 * MOST_COORDINATES], x[2][2 * MOST_COORDINATES], accuracy[2];
    double condition[2];
    const size_t n = 3 * c->links;
    open_both(*c, both);
    start_of(both[0], x0);
    for (int s = 0; s < 2; s++) {
        dal_flow *flow = NULL;
        dal_chart *chart = NULL;
        memcpy(x[s], x0, sizeof x0);
        CHECK(dal_flow_new(&flow, both[s], DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-13, NULL) == 0);
        CHECK(dal_flow_apply(flow, 0.0, 0.3, x[s], &accuracy[s]) == 0);
        CHECK(dal_chart_new(&chart, both[s], NULL) == 0);
        CHECK(dal_chart_choose(chart, 0.0, NULL, x0) == 0);
        CHECK(dal_chart_condition(chart, 0.0, x0, &condition[s]) == 0);
        dal_flow_free(flow);
        dal_chart_free(chart);
    }
    CHECK_NEAR(largest_difference(2 * n, x[0], x[1]), 0.0, 1e-11);
    CHECK(accuracy[1] > 0.0 && accuracy[1] < 1e-10);
    CHECK_NEAR(condition[0], condition[1], 1e-9 * condition[0]);
    dal_system_free(both[0]);
    dal_system_free(both[1]);
}

/* phi_q that is missing is differenced as in a dense system, but for many columns at once. */
static void test_differences(const chain *given)
{
    double x0[2 * MOST_COORDINATES], lambda[2][MOST_LINKS];
    dal_stats stats[2];
    for (int s = 0; s < 2; s++) {
        chain c = *given;
        c.sparse = s == 1;
        dal_system *const system = open_chain(&c, DAL_MISSING_PHI_Q | DAL_MISSING_V_QQ);
        dal_mechanics *const mech = open_mechanics(system);
        const dal_scheme scheme = find_scheme("midpoint");
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        if (s == 0) start_of(system, x0);
        CHECK(dal_multipliers(mech, 0.0, x0, lambda[s]) == 0);
        CHECK(dal_stepper_start(stepper, 0.0, 0.05, x0, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(stepper, 10, NULL, NULL) == 0);
        dal_stepper_stats(stepper, &stats[s]);
        if (s == 1) CHECK(system->colours <= 8 || c.links < 3);
        dal_mechanics_free(mech);
        dal_stepper_free(stepper);
        dal_system_free(system);
    }
    compare("multipliers", given->links, lambda[0], lambda[1]);
    CHECK(stats[1].worst_residual <= 12.0 * (double)given->links * U);
    if (given->links > 4) CHECK(2 * stats[1].constraint_calls < stats[0].constraint_calls);
}

/* ---- what is refused, and what fails --------------------------------------------------- */

static void refuse(const dal_system_def *def, const char *text)
{
    dal_error error = {0};
    dal_system *system = NULL;
    CHECK(dal_system_new(&system, def, &error) == DAL_EINVAL && system == NULL);
    check_true(strstr(error.text, text) != NULL, error.text, __FILE__, __LINE__);
}

static void test_refused(void)
{
    static const double masses[3] = {1, 1, 1}, bad[3] = {1, 0, 1};
    static const double unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const size_t row[3] = {0, 0, 0}, column[3] = {0, 1, 2}, twice[3] = {0, 1, 1};
    const size_t far[3] = {0, 1, 3}, below[3] = {0, 0, 1};
    dal_sparsity sparsity = {3, row, column};
    chain c = {.links = 1, .sparse = true};
    dal_system_def def = {.n = 3, .m = 1, .constraint = chain_constraint, .ctx = &c,
                          .masses = masses, .sparsity = &sparsity};
    sparsity.column = twice;
    refuse(&def, "entry 2, (0, 1), comes after (0, 1)");
    sparsity.column = far;
    refuse(&def, "entry 2, (0, 3), is outside a matrix of 1 rows and 3 columns");
    sparsity = (dal_sparsity){3, below, column};
    refuse(&def, "entry 2, (1, 2), is outside");
    sparsity = (dal_sparsity){3, row, NULL};
    refuse(&def, "sparsity.column is NULL");
    sparsity = (dal_sparsity){3, row, column};
    def.masses = bad;
    refuse(&def, "mass[1,1] = 0");
    def.masses = masses;
    def.mass = unit;
    refuse(&def, "mass and masses");
    def.mass = NULL;
    def.constraint = NULL;
    def.m = 0;
    refuse(&def, "sparsity with m = 0");
}

/* A constraint that coincides with its neighbour is singular, and what the callback forgets is
 * named by its row and column. */
static bool forgetful, equal;

static int poor_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                           double *phi_q, double *phi_t, void *ctx)
{
    (void)t, (void)q, (void)v, (void)phi, (void)phi_t, (void)ctx;
    const double mu[4] = {1.0, 0.5, 1.0, equal ? 0.5 : 0.7};
    for (size_t e = 0; e < 4; e++) {
        if (phi_v && !(forgetful && e == 3)) phi_v[e] = mu[e];
        if (phi_q) phi_q[e] = 0.0;
    }
    return 0;
}

static void test_failures(void)
{
    static const double masses[3] = {1, 1, 1}, x[6] = {0};
    const size_t row[4] = {0, 0, 1, 1}, column[4] = {0, 2, 0, 2};
    const dal_sparsity sparsity = {4, row, column};
    const dal_system_def def = {.n = 3, .m = 2, .constraint = poor_constraint, .masses = masses,
                                .sparsity = &sparsity};
    dal_system *system = NULL;
    CHECK(dal_system_new(&system, &def, NULL) == 0);
    const dal_scheme scheme = find_scheme("midpoint");
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
    CHECK(dal_step(stepper, NULL) == 0);
    equal = true;
    CHECK(dal_step(stepper, NULL) == DAL_ESINGULAR);
    equal = false;
    forgetful = true;
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EDOMAIN);
    CHECK(strstr(dal_stepper_error(stepper)->text, "phi_v[1,2]") != NULL);
    forgetful = false;
    dal_stepper_free(stepper);
    dal_system_free(system);
}

/* ---- size ------------------------------------------------------------------------------- */

static int many_blades(double t, const double *q, const double *v, double *phi, double *phi_v,
                       double *phi_q, double *phi_t, void *ctx)
{
    const size_t links = *(const size_t *)ctx;
    (void)t, (void)phi, (void)phi_t;
    for (size_t a = 0; a < links; a++) {
        const double s = sin(q[3 * a + 2]), c = cos(q[3 * a + 2]);
        const double mu[3] = {-s, c, 0.0}, turn = -c * v[3 * a] - s * v[3 * a + 1];
        for (size_t i = 0; i < 3; i++) {
            if (phi_v) phi_v[3 * a + i] = mu[i];
            if (phi_q) phi_q[3 * a + i] = i == 2 ? turn : 0.0;
        }
    }
    return 0;
}

/* 10^5 blades: any matrix of n rows or m rows would need more memory than there is. */
static void test_size(void)
{
    static size_t links = 100000;
    const size_t n = 3 * links;
    arena memory = {0};
    double *masses, *x, *reaction;
    size_t *row, *column;
    DAL__RESERVE(&memory, n, &masses);
    DAL__RESERVE(&memory, 2 * n, &x);
    DAL__RESERVE(&memory, links, &reaction);
    dal__reserve(&memory, &row, n, sizeof *row);
    dal__reserve(&memory, &column, n, sizeof *column);
    need(dal__allocate(&memory, NULL), "blades", "");
    for (size_t i = 0; i < n; i++) {
        masses[i] = 1.0;
        row[i] = i / 3;
        column[i] = i;
        x[i] = 0.1 * sin((double)i);
    }
    for (size_t a = 0; a < links; a++) {
        x[n + 3 * a] = cos(x[3 * a + 2]);
        x[n + 3 * a + 1] = sin(x[3 * a + 2]);
        x[n + 3 * a + 2] = 1.0;
    }
    const dal_sparsity sparsity = {n, row, column};
    const dal_system_def def = {.n = n, .m = links, .constraint = many_blades, .ctx = &links,
                                .masses = masses, .sparsity = &sparsity};
    dal_system *system = NULL;
    need(dal_system_new(&system, &def, NULL), "blades", "");
    for (size_t k = 0; k < 2; k++) {
        const dal_scheme scheme = find_scheme(schemes[k]);
        dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
        double worst = 0.0;
        CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == 0);
        CHECK(dal_advance(stepper, 5, reaction, NULL) == 0);
        const double *const end = dal_stepper_state(stepper);
        for (size_t a = 0; a < links; a++)
            worst = fmax(worst, fabs(end[n + 3 * a] * sin(end[3 * a + 2])
                                     - end[n + 3 * a + 1] * cos(end[3 * a + 2])));
        CHECK(worst < 1e-15);
        dal_stepper_free(stepper);
    }
    dal_system_free(system);
    dal__release(&memory);
}

int main(void)
{
    for (size_t k = 0; k < DAL_LENGTH(chains); k++) {
        test_steps(&chains[k]);
        test_mechanics(&chains[k]);
        test_flow_and_chart(&chains[k]);
        test_differences(&chains[k]);
    }
    test_large_steps(0.0, false);
    test_large_steps(2.0, false);
    test_large_steps(0.0, true);
    test_refused();
    test_failures();
    test_size();
    return check_done();
}
