/* Systems with a sparsity and masses against the same ones with all entries and a mass matrix:
 * steps of every kind, mechanics, charts, what is refused; and how memory grows with n. */
#include "fixtures.h"
#include "check.h"
#include "dalembert/study.h"
#include "step/beta.h"
#include "step/scheme.h"
#include "step/stepper.h"

enum { MOST_LINKS = 14, MOST_COORDINATES = 3 * MOST_LINKS, KINDS = 4 };

/* A chain of blades, with the coordinates (x, y, heading) each: blade a does not slip sideways, but
 * for what the blade before, or one far away, drags it along. */
typedef struct chain {
    size_t links;
    double coupling, stiffness, wind, drag; /* wind depends on q alone, drag on v */
    double shift;  /* of affine constraints; 0: they are linear */
    double unit;   /* of the first row, and of each third; 0: 1 */
    bool far;      /* the last blade hangs on the first */
    bool free;     /* no constraint pushes a heading */
    bool full_newton; /* V_qq, f_q and, if f depends on v, f_v are given */
    bool sparse, masses; /* how it is told: the kinds below */
} chain;

static const struct {
    bool sparse, masses;
} kinds[KINDS] = {{false, false}, {true, true}, {false, true}, {true, false}};

/* How often each was called. */
static struct {
    size_t constraint, potential, force;
} calls;

static bool has_partner(const chain *c, size_t a)
{
    return c->coupling != 0.0 && (a > 0 || (c->far && c->links > 2));
}

static size_t partner(const chain *c, size_t a) { return a > 0 ? a - 1 : c->links - 1; }

/* The entries of a row, in these columns, as they are written one after the other. */
typedef struct entries {
    size_t count, column[8];
    double unit, mu[8], N[8];
} entries;

static void write(entries *row, size_t column, double mu, double N)
{
    row->column[row->count] = column;
    row->mu[row->count] = row->unit * mu;
    row->N[row->count++] = row->unit * N;
}

static void write_partner(const chain *c, size_t b, const double *q, const double *v, entries *row)
{
    const double heading = q[3 * b + 2];
    write(row, 3 * b, c->coupling * cos(heading), 0.0);
    write(row, 3 * b + 2, 0.0, -c->coupling * sin(heading) * v[3 * b]);
}

static entries row_of(const chain *c, size_t a, const double *q, const double *v)
{
    entries row = {.unit = c->unit != 0.0 && a % 3 == 0 ? c->unit : 1.0};
    const double x = q[3 * a], heading = q[3 * a + 2], turn = v[3 * a + 2];
    const double push = c->free ? 0.0 : 0.1;
    const size_t b = partner(c, a);
    if (has_partner(c, a) && b < a) write_partner(c, b, q, v, &row);
    write(&row, 3 * a, -sin(heading), c->shift * cos(x) - push * sin(x) * sin(heading) * turn);
    write(&row, 3 * a + 1, cos(heading), 0.0);
    write(&row, 3 * a + 2, push * (3.0 + cos(x) * sin(heading)),
          -cos(heading) * v[3 * a] - sin(heading) * v[3 * a + 1]
              + push * cos(x) * cos(heading) * turn);
    if (has_partner(c, a) && b > a) write_partner(c, b, q, v, &row);
    return row;
}

static int chain_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                            double *phi_q, double *phi_t, void *ctx)
{
    const chain *const c = ctx;
    const size_t n = 3 * c->links;
    size_t before = 0;
    (void)t, (void)phi_t;
    calls.constraint++;
    for (size_t k = 0; !c->sparse && k < c->links * n; k++) {
        if (phi_v) phi_v[k] = 0.0;
        if (phi_q) phi_q[k] = 0.0;
    }
    for (size_t a = 0; a < c->links; a++) {
        const double still[MOST_COORDINATES] = {0.0};
        const entries row = row_of(c, a, q, phi_q ? v : still);
        if (phi) phi[a] = c->shift * sin(q[3 * a]);
        for (size_t k = 0; k < row.count; k++) {
            const size_t place = c->sparse ? before + k : a * n + row.column[k];
            if (phi) phi[a] += row.mu[k] * v[row.column[k]];
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
    calls.potential++;
    if (V_qq && !c->full_newton) return -1; /* it is not asked for */
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

static bool refusing;

static int chain_force(double t, const double *q, const double *v, const double *u, double *f,
                       double *f_q, double *f_v, void *ctx)
{
    const chain *const c = ctx;
    const size_t n = 3 * c->links;
    calls.force++;
    if (refusing || ((f_q || f_v) && !c->full_newton)) return -1; /* they are not asked for */
    if (f_v && c->drag == 0.0) return -1;
    for (size_t k = 0; k < n * n; k++) {
        if (f_q) f_q[k] = k % (n + 1) == 0 ? c->wind * cos(t + q[k / n]) : 0.0;
        if (f_v) f_v[k] = 0.0;
    }
    for (size_t i = 0; i < n; i++) {
        const size_t next = (i + 1) % n;
        if (f) f[i] = c->wind * sin(t + q[i]) + u[0];
        if (f && c->drag != 0.0) f[i] -= c->drag * v[i] * (1.0 + 0.2 * v[next]);
        if (f_v) f_v[i * n + i] -= c->drag * (1.0 + 0.2 * v[next]);
        if (f_v) f_v[i * n + next] -= c->drag * 0.2 * v[i];
    }
    return 0;
}

static dal_system *open_chain(chain *c, unsigned missing)
{
    const unsigned of_force = DAL_MISSING_F_V | (c->full_newton ? 0 : DAL_MISSING_F_Q);
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
        .missing = missing | (!forced || (c->full_newton && c->drag != 0.0) ? 0 : of_force),
        .kind = c->shift != 0.0 ? DAL_AFFINE : DAL_LINEAR,
        .steady = c->free ? DAL_STEADY_DECLARED : 0,
        .masses = c->masses ? masses : NULL, .mass = c->masses ? NULL : mass,
        .sparsity = c->sparse ? &sparsity : NULL};
    return new_system(&def);
}

/* All entries and a matrix, a sparsity and masses, and one of these alone. */
static dal_system *open_kind(chain c, size_t kind)
{
    c.sparse = kinds[kind].sparse;
    c.masses = kinds[kind].masses;
    return open_chain(&c, c.stiffness != 0.0 && !c.full_newton ? DAL_MISSING_V_QQ : 0);
}

static void open_kinds(const chain *c, dal_system *systems[KINDS])
{
    for (size_t kind = 0; kind < KINDS; kind++) systems[kind] = open_kind(*c, kind);
}

static void free_kinds(dal_system *systems[KINDS])
{
}

/* A state of D. */
static void start_of(const dal_system *system, double angle, double *x)
{
    const size_t n = system->def.n;
    dal_mechanics *const mech = open_mechanics(system);
    for (size_t i = 0; i < n; i++) {
        x[i] = i % 3 == 0 ? (double)(i / 3) : 0.2 * sin(1.7 * (double)i);
        if (i % 3 == 2) x[i] += angle;
        x[n + i] = cos((double)i) + (i % 3 == 2 ? 0.5 : 0.0);
    }
    CHECK(dal_project(mech, 0.0, 0.0, x, NULL) == 0);
}

static const chain chains[] = {
    {.links = 1}, {.links = 5}, {.links = 5, .stiffness = 1.0},
    {.links = 9, .stiffness = 1.0, .coupling = 0.4},
    {.links = 14, .stiffness = 0.5, .coupling = 0.7, .far = true},
    {.links = 8, .stiffness = 0.5, .coupling = 0.3, .wind = 0.4},
    {.links = 7, .coupling = 0.5, .wind = 0.3, .far = true},
    {.links = 6, .stiffness = 0.5, .coupling = 0.3, .drag = 0.5},
    {.links = 5, .wind = 0.2, .drag = 2.0, .far = true},
    {.links = 6, .coupling = 0.4, .stiffness = 0.5, .shift = 0.3},
    {.links = 5, .coupling = 0.4, .stiffness = 0.5, .free = true},
    {.links = 5, .coupling = 0.4, .drag = 0.5, .free = true},
    {.links = 9, .coupling = 0.4, .stiffness = 1.0, .unit = 0x1p-90},
    {.links = 9, .coupling = 0.4, .stiffness = 1.0, .unit = 0x1p90},
};

/* ---- steps ------------------------------------------------------------------------------ */

static const char *const schemes[] = {
    "leapfrog", "midpoint", "explicit", "endpoint", "0.3", "leapfrog-mirror", "midpoint-nodes",
    "explicit-nodes", "leapfrog-kl8", "midpoint-suzuki4", "reference", "pair:0.5:0.5"};

/* Of the residual: by rows it does not grow with n. */
static double bound_of(const dal_system *system)
{
    const bool rows = system->sparse && system->rows;
    if (rows) CHECK(system->rows->terms <= 9);
    return 4.0 * (double)(rows ? system->rows->terms : system->def.n) * U;
}

/* Headings begin at this angle. */
static void test_steps(const chain *c, double angle)
{
    dal_system *systems[KINDS];
    double x0[2 * MOST_COORDINATES];
    const size_t n = 3 * c->links, m = c->links;
    open_kinds(c, systems);
    start_of(systems[0], angle, x0);
    for (size_t k = 0; k < DAL_LENGTH(schemes); k++) {
        const dal_scheme scheme = find_scheme(schemes[k]);
        const bool kept = scheme.nodes == DAL_KEPT_NODES;
        double reaction[KINDS][MOST_LINKS], x[KINDS][2 * MOST_COORDINATES];
        dal_stats stats[KINDS];
        for (size_t s = 0; s < KINDS; s++) {
            dal_stepper *const stepper = open_stepper(systems[s], &scheme, NULL);
            CHECK(dal_stepper_start(stepper, 0.0, 0.02, x0, DAL_CHECK,
                                    kept ? DAL_INITIAL_PROJECT : DAL_INITIAL_NONE) == 0);
            CHECK(dal_advance(stepper, brief() ? 1 : 20, reaction[s], NULL) == 0);
            memcpy(x[s], dal_stepper_state(stepper), 2 * n * sizeof(double));
            dal_stepper_stats(stepper, &stats[s]);
            release(stepper);
        }
        for (size_t a = 0; a < m; a++) /* in the units of the others */
            for (size_t s = 0; c->unit != 0.0 && a % 3 == 0 && s < KINDS; s++)
                reaction[s][a] *= c->unit;
        for (size_t s = 1; s < KINDS; s++) {
            const double scale = sum_of_sizes(2 * n, x[0]);
            CHECK_NEAR(largest_difference(2 * n, x[0], x[s]), 0.0, 100.0 * U * scale);
            if (strcmp(schemes[k], "reference") != 0) /* which has none */
                CHECK_NEAR(largest_difference(m, reaction[0], reaction[s]), 0.0, 1e4 * U * scale);
            CHECK(stats[s].worst_residual <= bound_of(systems[s]));
            CHECK(stats[s].full_newtons == stats[0].full_newtons);
            if (c->drag == 0.0 && strchr(schemes[k], ':') == NULL)
                CHECK(stats[s].iterations <= 2 * stats[0].iterations); /* its bound is tighter */
            CHECK(stats[s].constraint_calls <= 2 * stats[0].constraint_calls); /* a pair: K = M */
        }
    }
    free_kinds(systems);
}

static const chain large[] = {
    {.links = 6, .stiffness = 2.0, .coupling = 0.4},
    {.links = 6, .stiffness = 2.0, .coupling = 0.4, .drag = 2.0},
    {.links = 6, .stiffness = 2.0, .coupling = 0.4, .full_newton = true},
    {.links = 6, .stiffness = 2.0, .coupling = 0.4, .wind = 2.0, .full_newton = true},
    {.links = 6, .stiffness = 2.0, .coupling = 0.4, .wind = 1.0, .drag = 2.0, .full_newton = true},
    {.links = 6, .coupling = 0.4},
    {.links = 6, .stiffness = 2.0, .coupling = 0.4, .unit = 0x1p-90},
};

/* The solution of a step that the step routine does not find is found by the full Newton iteration,
 * with K = M where second derivatives are not there, or there is none: never another one. */
static void test_large_steps(const chain *c, size_t kind)
{
    dal_system *systems[2] = {open_kind(*c, 0), open_kind(*c, kind)};
    double x0[2 * MOST_COORDINATES];
    const size_t n = 3 * c->links;
    const bool whole = c->full_newton || !systems[1]->sparse
                    || !(systems[1]->def.potential || c->drag);
    const double u = 0.3;
    size_t compared = 0, refused = 0, left = 0;
    start_of(systems[0], 0.0, x0);
    for (double h = 0.05; h < 3.0; h *= 1.15)
        for (size_t k = 0; k < 5; k++) {
            double x[2][2 * MOST_COORDINATES];
            int status[2];
            for (int s = 0; s < 2; s++) {
                dal_stats before, stats;
                dal_stepper *const stepper = start_named(systems[s], schemes[k], h, x0);
                if (dal_system_inputs(systems[s]) > 0) CHECK(dal_stepper_input(stepper, &u) == 0);
                dal_stepper_stats(stepper, &before);
                memset(&calls, 0, sizeof calls);
                status[s] = dal_advance(stepper, 3, NULL, NULL);
                memcpy(x[s], dal_stepper_state(stepper), 2 * n * sizeof(double));
                dal_stepper_stats(stepper, &stats);
                CHECK(stats.worst_residual <= bound_of(systems[s]));
                CHECK(stats.constraint_calls - before.constraint_calls == calls.constraint);
                CHECK(stats.potential_calls - before.potential_calls == calls.potential);
                CHECK(stats.force_calls - before.force_calls == calls.force);
                if (status[s]) /* and why is said */
                    CHECK(!strstr(dal_stepper_error(stepper)->text, dal_strerror(status[s])));
                if (s == 1) left += stats.full_newtons;
                release(stepper);
            }
            if (whole) CHECK(!status[1] || status[0]); /* it solves what the dense one does */
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
    static double K[KINDS][N * N], C[KINDS][M * M], B[KINDS][M * N], muk[KINDS][M * N];
    static double metric[KINDS][N * N];
    dal_system *systems[KINDS];
    double x0[2 * N], x[KINDS][2 * N], near[KINDS][2 * N], lambda[KINDS][M], field[KINDS][2 * N];
    double R1[KINDS][N], R2[KINDS][M], E[KINDS], power[KINDS][2], residual[KINDS][M];
    double relative[KINDS], distance[KINDS], ghat[2 * N], kappa[M], perturbed[KINDS][2 * N];
    double hat[KINDS][M];
    const double u = 0.3;
    unsigned char keep[N] = {0};
    const size_t n = 3 * c->links, m = c->links;
    open_kinds(c, systems);
    start_of(systems[0], 0.0, x0);
    for (size_t i = 0; i < 2 * n; i++) ghat[i] = sin((double)i);
    for (size_t a = 0; a < m; a++) kappa[a] = 0.1 * cos((double)a);
    for (size_t i = 0; i < n; i += 3) keep[i] = 1;
    for (size_t s = 0; s < KINDS; s++) {
        dal_mechanics *const mech = open_mechanics(systems[s]);
        if (dal_system_inputs(systems[s]) > 0) CHECK(dal_mechanics_input(mech, &u) == 0);
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
        release(mech);
    }
    for (size_t s = 1; s < KINDS; s++) {
        compare("energy", 1, &E[0], &E[s]);
        compare("power", 2, power[0], power[s]);
        compare("metric", n * n, metric[0], metric[s]);
        compare("gram", m * m, C[0], C[s]);
        compare("multipliers", m, lambda[0], lambda[s]);
        compare("field", 2 * n, field[0], field[s]);
        compare("perturbed", 2 * n, perturbed[0], perturbed[s]);
        compare("hat lambda", m, hat[0], hat[s]);
        compare("residual", m, residual[0], residual[s]);
        compare("relative residual", 1, &relative[0], &relative[s]);
        compare("projection", 2 * n, x[0], x[s]);
        compare("distance", 1, &distance[0], &distance[s]);
        compare("consistent", 2 * n, near[0], near[s]);
        compare("R1", n, R1[0], R1[s]);
        compare("R2", m, R2[0], R2[s]);
        compare("K", c->stiffness == 0.0 ? n * n : 0, K[0], K[s]);
        compare("B", m * n, B[0], B[s]);
        compare("muk", m * n, muk[0], muk[s]);
        for (size_t i = 0; i < n; i += 3) CHECK(near[s][n + i] == x0[n + i] + 0.1);
    }
    free_kinds(systems);
}

/* The flow, with its accuracy, and a chart, which wants all entries. */
static void test_flow_and_chart(const chain *c)
{
    dal_system *systems[KINDS];
    double x0[2 * MOST_COORDINATES], x[KINDS][2 * MOST_COORDINATES], accuracy[KINDS];
    double condition[KINDS];
    const size_t n = 3 * c->links;
    open_kinds(c, systems);
    start_of(systems[0], 0.0, x0);
    for (size_t s = 0; s < KINDS; s++) {
        memcpy(x[s], x0, sizeof x0);
        dal_flow *const flow = open_flow(systems[s], DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-13);
        CHECK(dal_flow_apply(flow, 0.0, 0.3, x[s], &accuracy[s]) == 0);
        dal_chart *const chart = open_chart(systems[s]);
        CHECK(dal_chart_choose(chart, 0.0, NULL, x0) == 0);
        CHECK(dal_chart_condition(chart, 0.0, x0, &condition[s]) == 0);
        release(chart);
    }
    for (size_t s = 1; s < KINDS; s++) {
        CHECK_NEAR(largest_difference(2 * n, x[0], x[s]), 0.0, 1e-11);
        CHECK(accuracy[s] > 0.5 * accuracy[0] && accuracy[s] < 2.0 * accuracy[0]);
        CHECK(accuracy[s] < 1e-10);
        CHECK_NEAR(condition[0], condition[s], 1e-9 * condition[0]);
    }
    free_kinds(systems);
}

/* phi_q that is missing is differenced as in a dense system, but for many columns at once. */
static void test_differences(const chain *given)
{
    double x0[2 * MOST_COORDINATES], lambda[2][MOST_LINKS];
    dal_stats stats[2];
    for (int s = 0; s < 2; s++) {
        chain c = *given;
        c.sparse = c.masses = s == 1;
        dal_system *const system = open_chain(&c, DAL_MISSING_PHI_Q | DAL_MISSING_V_QQ);
        dal_mechanics *const mech = open_mechanics(system);
        if (s == 0) start_of(system, 0.0, x0);
        CHECK(dal_multipliers(mech, 0.0, x0, lambda[s]) == 0);
        dal_stepper *const stepper = start_named(system, "midpoint", 0.05, x0);
        CHECK(dal_advance(stepper, 10, NULL, NULL) == 0);
        dal_stepper_stats(stepper, &stats[s]);
        if (s == 1) CHECK(system->colours <= (c.far ? 8 : 5));
        release(system);
    }
    compare("multipliers", given->links, lambda[0], lambda[1]);
    CHECK(stats[1].worst_residual <= 12.0 * (double)given->links * U);
    if (given->links > 4 && given->shift == 0.0)
        CHECK(2 * stats[1].constraint_calls < stats[0].constraint_calls);
}

static int many_blades(double t, const double *q, const double *v, double *phi, double *phi_v,
                       double *phi_q, double *phi_t, void *ctx);

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
    static const double masses[3] = {1, 1, 1}, bad[3] = {1, 0, 1}, heavy[3] = {1, 1, INFINITY};
    static const dal_compiled compiled = {DAL_COMPILED_ABI, sizeof(dal_kernel), NULL, 0, 0, NULL,
                                          NULL};
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
    def.masses = heavy;
    refuse(&def, "masses[2] = inf is not finite");
    def.masses = masses;
    def.mass = unit;
    refuse(&def, "mass and masses");
    def.mass = NULL;
    def.constraint = NULL;
    def.m = 0;
    refuse(&def, "sparsity is given, but m = 0");
    def.sparsity = NULL;
    def.lagrangian = never_lagrangian;
    refuse(&def, "lagrangian and masses are both given");

    dal_error error = {0};
    dal_stepper *stepper = NULL;
    const dal_scheme scheme = find_scheme("leapfrog");
    def = (dal_system_def){.n = 3, .m = 1, .constraint = chain_constraint, .ctx = &c,
                           .masses = masses, .sparsity = &sparsity, .compiled = &compiled};
    dal_system *const system = new_system(&def);
    CHECK(dal_stepper_new(&stepper, system, &scheme, NULL, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "compiled and sparsity") != NULL);
}

/* Constraints that turn with what they push are not steady. */
static void test_not_steady(void)
{
    for (size_t kind = 0; kind < KINDS; kind++) {
        const chain c = {.links = 5, .coupling = 0.4};
        dal_system *const system = open_kind(c, kind);
        dal_system_def def = system->def;
        dal_system *steady = NULL;
        double x0[2 * MOST_COORDINATES];
        start_of(system, 0.0, x0);
        def.steady = DAL_STEADY_DECLARED;
        steady = new_system(&def);
        dal_stepper *const stepper = open_named(steady, "midpoint");
        CHECK(dal_stepper_start(stepper, 0.0, 0.1, x0, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EINVAL);
        release(system);
    }
}

/* What is left over of mu and b N where they cancel is of no use: the step is refused, and not made
 * with a reaction of any size. */
static int vanishing_constraint(double t, const double *q, const double *v, double *phi,
                                double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    if (phi_v) phi_v[0] = phi_v[1] = 1.0;
    if (phi_q) phi_q[0] = phi_q[1] = -20.0 * (1.0 - U);
    return 0;
}

static void test_cancellation(void)
{
    static const double masses[3] = {1, 1, 1}, x[6] = {0, 0, 0, 0, 0, 1};
    const size_t row[2] = {0, 1}, column[2] = {0, 1};
    const dal_sparsity sparsity = {2, row, column};
    const dal_system_def def = {.n = 3, .m = 2, .constraint = vanishing_constraint,
                                .masses = masses, .sparsity = &sparsity};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = start_named(system, "midpoint", 0.1, x);
    CHECK(dal_step(stepper, NULL) == DAL_ESINGULAR);
}

/* Systems that differ in a mass or in an entry are different ones, for a state that was saved. */
static void test_identity(void)
{
    static const double masses[2][3] = {{1, 2, 3}, {1, 2, 4}};
    const size_t row[2][3] = {{0, 0, 1}, {0, 1, 1}}, column[2][3] = {{0, 1, 2}, {0, 2, 2}};
    const dal_scheme scheme = find_scheme("leapfrog");
    double found[4];
    for (int k = 0; k < 4; k++) {
        const dal_sparsity sparsity = {3, row[k == 2], column[k == 3]};
        const dal_system_def def = {.n = 3, .m = 2, .constraint = many_blades,
                                    .masses = masses[k == 1], .sparsity = &sparsity};
        dal_system *const system = new_system(&def);
        found[k] = dal__scheme_identify(system, &scheme);
        for (int i = 0; i < k; i++) CHECK(found[i] != found[k]);
        release(system);
    }
}

/* Where second derivatives are of use, and where they would only cost n^2 numbers. */
static void test_which_are_lean(void)
{
    const chain c[] = {{.links = 5, .coupling = 0.4},
                       {.links = 5, .stiffness = 1.0},
                       {.links = 5, .stiffness = 1.0, .full_newton = true},
                       {.links = 5, .wind = 1.0, .full_newton = true},
                       {.links = 5, .drag = 1.0, .full_newton = true},
                       {.links = 5, .stiffness = 1.0, .wind = 1.0},
                       {.links = 5, .shift = 0.3}};
    static const bool sparse[][KINDS] = {{0, 1, 1, 0}, {0, 1, 0, 0}, {0, 1, 0, 0}, {0, 1, 0, 0},
                                         {0, 1, 0, 0}, {0, 1, 0, 0}, {0, 0, 0, 0}};
    for (size_t k = 0; k < DAL_LENGTH(c); k++)
        for (size_t kind = 0; kind < KINDS; kind++) {
            dal_system *const system = open_kind(c[k], kind);
            CHECK(system->sparse == sparse[k][kind]);
            CHECK(system->full_newton == (c[k].full_newton && kind == 1));
            release(system);
        }
}

/* A constraint that coincides with its neighbour is singular, and what the callback forgets is
 * named by its row and column. */
static bool forgetful, equal;
static double apart = 0.2;

static int poor_constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                           double *phi_q, double *phi_t, void *ctx)
{
    (void)t, (void)q, (void)v, (void)phi, (void)phi_t, (void)ctx;
    const double mu[4] = {1.0, 0.5, 1.0, equal ? 0.5 : 0.5 + apart};
    for (size_t e = 0; e < 4; e++) {
        if (phi_v && !(forgetful && e == 3)) phi_v[e] = mu[e];
        if (phi_q) phi_q[e] = 0.0;
    }
    if (phi_t) phi_t[0] = 0.0; /* but not phi_t[1] */
    return 0;
}

/* With a matrix of masses all entries are formed, and their places are others. */
static void test_forgetful(const dal_sparsity *sparsity)
{
    static const double masses[3] = {1, 1, 1}, mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, x[6] = {0};
    for (int timed = 0; timed < 2; timed++)
        for (int way = 0; way < 2; way++) {
            const dal_system_def def = {.n = 3, .m = 2, .constraint = poor_constraint,
                                        .masses = way == 0 ? masses : NULL,
                                        .mass = way == 0 ? NULL : mass, .sparsity = sparsity,
                                        .time_dependent = timed};
            double lambda[2];
            dal_system *const system = new_system(&def);
            dal_mechanics *const mech = open_mechanics(system);
            forgetful = !timed;
            CHECK(dal_multipliers(mech, 0.0, x, lambda) == DAL_EDOMAIN);
            check_true(strstr(dal_mechanics_error(mech)->text,
                              timed ? "phi_t[0,1]" : "phi_v[1,2]") != NULL,
                       dal_mechanics_error(mech)->text, __FILE__, __LINE__);
            forgetful = false;
            release(system);
        }
}

/* Constraints that almost coincide cost the flow digits, and it says how many. */
static void test_accuracy(const dal_sparsity *sparsity)
{
    static const double masses[3] = {1, 1, 1};
    const dal_system_def def = {.n = 3, .m = 2, .constraint = poor_constraint, .masses = masses,
                                .sparsity = sparsity};
    double accuracy[2];
    dal_system *const system = new_system(&def);
    for (int k = 0; k < 2; k++) {
        double x[6] = {0, 0, 0, 0, 1, 0};
        apart = k == 0 ? 0.2 : 1e-4;
        dal_flow *const flow = open_flow(system, DAL_FLOW_RK8PD, DAL_FLOW_X, 1e-13);
        CHECK(dal_flow_apply(flow, 0.0, 1.0, x, &accuracy[k]) == 0);
        release(flow);
    }
    CHECK(accuracy[1] > 100.0 * accuracy[0]);
    apart = 0.2;
}

/* How large the form of a coordinate is that is kept does not matter. */
static int uneven(double t, const double *q, const double *v, double *phi, double *phi_v,
                  double *phi_q, double *phi_t, void *ctx)
{
    if (phi_v) memcpy(phi_v, (double[]){1e20, 1.0}, 2 * sizeof *phi_v);
    if (phi_q) memset(phi_q, 0, 2 * sizeof *phi_q);
    return 0;
}

static void test_kept_units(void)
{
    static const double masses[3] = {1, 1, 1};
    const size_t row[2] = {0, 0}, column[2] = {0, 1};
    const dal_sparsity sparsity = {2, row, column};
    const dal_system_def def = {.n = 3, .m = 1, .constraint = uneven, .masses = masses,
                                .sparsity = &sparsity};
    const unsigned char keep[3] = {1, 0, 0};
    double x[6] = {0.0, 0.0, 0.0, 1e-20, 0.0, 0.0};
    dal_system *const system = new_system(&def);
    dal_mechanics *const mech = open_mechanics(system);
    CHECK(dal_consistent(mech, 0.0, keep, x, NULL) == 0);
    CHECK_NEAR(x[4], -1.0, 4.0 * U);
}

/* A callback that refuses is named, also where V and a force act together; and a C that overflows
 * is not given back. */
static void test_names(void)
{
    const chain dragged = {.links = 3, .drag = 0.5}, large = {.links = 4, .unit = 0x1p600};
    for (size_t kind = 0; kind < KINDS; kind++) {
        double x0[2 * MOST_COORDINATES] = {0.0}, C[16] = {0.0}, R1[9], w[9] = {0.0};
        dal_system *system = open_kind(dragged, kind);
        dal_mechanics *mech = open_mechanics(system);
        start_of(system, 0.0, x0);
        dal_stepper *const stepper = start_named(system, "midpoint", 0.1, x0);
        refusing = true;
        CHECK(dal_step(stepper, NULL) == DAL_EUSER);
        CHECK(strstr(dal_stepper_error(stepper)->text, "force returned -1") != NULL);
        CHECK(dal_step_equations(mech, 0.0, 0.5, 0.1, x0, w, w, R1, NULL, NULL, NULL, NULL)
              == DAL_EUSER);
        CHECK(strstr(dal_mechanics_error(mech)->text, "force returned -1") != NULL);
        refusing = false;
        release(system);

        system = open_kind(large, kind);
        mech = open_mechanics(system);
        CHECK(dal_gram(mech, 0.0, x0, C) == DAL_EDOMAIN && C[0] == 0.0);
        release(system);
    }
}

static void test_failures(void)
{
    static const double masses[3] = {1, 1, 1}, x[6] = {0};
    const size_t row[4] = {0, 0, 1, 1}, column[4] = {0, 2, 0, 2};
    const dal_sparsity sparsity = {4, row, column};
    const dal_system_def def = {.n = 3, .m = 2, .constraint = poor_constraint, .masses = masses,
                                .sparsity = &sparsity};
    dal_system *const system = new_system(&def);
    dal_stepper *const stepper = start_named(system, "midpoint", 0.1, x);
    CHECK(dal_step(stepper, NULL) == 0);
    equal = true;
    CHECK(dal_step(stepper, NULL) == DAL_ESINGULAR);
    equal = false;
    forgetful = true;
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EDOMAIN);
    CHECK(strstr(dal_stepper_error(stepper)->text, "phi_v[1,2]") != NULL);
    forgetful = false;
    test_forgetful(&sparsity);
    test_accuracy(&sparsity);
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

/* It would have to write n^2 numbers. */
static int sway(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const size_t n = 3 * *(const size_t *)ctx;
    if (V_qq) return -1;
    if (V) *V = 0.0;
    for (size_t i = 0; i < n; i++) {
        if (V) *V += 0.1 * cos(q[i]);
        if (V_q) V_q[i] = -0.1 * sin(q[i]);
    }
    return 0;
}

static int friction(double t, const double *q, const double *v, const double *u, double *f,
                    double *f_q, double *f_v, void *ctx)
{
    const size_t n = 3 * *(const size_t *)ctx;
    if (f_q || f_v) return -1;
    for (size_t i = 0; i < n; i++) f[i] = -0.1 * v[i];
    return 0;
}

/* 10^5 blades, with V and a force that give all derivatives: any matrix of n rows or m rows would
 * need more memory than there is. */
static void test_size(void)
{
    static size_t links = 100000;
    if (brief()) links = 1000;
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
                                .masses = masses, .sparsity = &sparsity, .potential = sway,
                                .force = friction};
    dal_system *const system = new_system(&def);
    dal_mechanics *const mech = open_mechanics(system);
    CHECK(dal_multipliers(mech, 0.0, x, reaction) == 0);
    for (size_t k = 0; k < 2; k++) {
        double worst = 0.0;
        dal_stepper *const stepper = start_named(system, schemes[k], 0.1, x);
        CHECK(dal_advance(stepper, 5, reaction, NULL) == 0);
        const double *const end = dal_stepper_state(stepper);
        for (size_t a = 0; a < links; a++)
            worst = fmax(worst, fabs(end[n + 3 * a] * sin(end[3 * a + 2])
                                     - end[n + 3 * a + 1] * cos(end[3 * a + 2])));
        CHECK(worst < 2.0 * (double)n * U);
        release(stepper);
    }
    dal__release(&memory);
}

int main(void)
{
    for (size_t k = 0; k < DAL_LENGTH(chains); k++) {
        test_steps(&chains[k], 0.0);
        test_steps(&chains[k], 1e6);
        test_mechanics(&chains[k]);
        test_flow_and_chart(&chains[k]);
        test_differences(&chains[k]);
    }
    for (size_t k = 0; k < DAL_LENGTH(large); k++)
        for (size_t kind = 1; kind < KINDS; kind++) test_large_steps(&large[k], kind);
    test_refused();
    test_not_steady();
    test_cancellation();
    test_identity();
    test_which_are_lean();
    test_failures();
    test_names();
    test_kept_units();
    test_size();
    return check_done();
}
