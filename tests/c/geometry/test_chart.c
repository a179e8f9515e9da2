/* Charts of D: A, B, psi and its derivative, the ODE, the multipliers and the schemes in xi,
 * against formulas by hand, differences, and the same things computed on D.
 *
 * ROUNDOFF is relative to the sizes that enter: sums of n terms and a few solves with B, whose
 * condition is below 10 in the states that are used. */
#include "fixtures.h"
#include "vector_systems.h"
#include "check.h"

#define ROUNDOFF (128 * U)

enum { N = 12, M = 6, WIDTH = 2 * N };

/* ---- systems ------------------------------------------------------------------------------- */

/* phi = mu v + delta (1 + sin x) */
static int drift(double t, const double *q, const double *v, double *g, double *g_v, double *g_q,
                 double *g_t, void *ctx)
{
    if (g) g[0] = 1.0 + sin(q[0]);
    vector_set(g_v, 3, (double[3]){0.0});
    vector_set(g_q, 3, (double[]){cos(q[0]), 0.0, 0.0});
    return 0;
}

static dal_system *open_vector_system(const vector_system *is)
{
    const dal_system_def def = {.n = is->n, .m = is->m, .mass = is->mass,
                                .potential = is->potential, .constraint = is->constraint,
                                .lagrangian = is->lagrangian, .name = is->name};
    return new_system(&def);
}

/* A system with a chart, its mechanics, and a state of D where the chart was chosen by pivoting. */
typedef struct subject {
    dal_system *system;
    dal_mechanics *mech;
    dal_chart *chart;
    size_t n, m, width;
    double x[2 * N];
} subject;

/* Positions and velocities of order 1. */
static void somewhere(size_t count, unsigned *seed, double *x)
{
    for (size_t i = 0; i < count; i++) x[i] = next_number(seed);
}

static subject open_subject(dal_system *system, unsigned seed)
{
    subject s = {.system = system, .mech = open_mechanics(system), .chart = open_chart(system),
                 .n = dal_system_n(system), .m = dal_system_m(system)};
    s.width = 2 * s.n - s.m;
    somewhere(2 * s.n, &seed, s.x);
    const char *const name = dal_system_name(system);
    need(dal_project(s.mech, 0.0, 0.0, s.x, NULL), name, dal_mechanics_error(s.mech)->text);
    need(dal_chart_choose(s.chart, 0.0, NULL, s.x), name, dal_chart_error(s.chart)->text);
    return s;
}

/* ---- by hand ------------------------------------------------------------------------------- */

/* The particle: mu = (-y, 0, 1). */
static void test_particle(void)
{
    dal_system *const system = open_system("particle");
    dal_chart *const chart = open_chart(system);
    const double x[6] = {0.5, 0.3, -0.2, 1.0, 0.7, 0.9}, far[6] = {0.5, 3.0, -0.2, 1.0, 0.7, 0.9};
    double A[2], B, hor[3], ver[3], xi[5], back[6], xidot[5], J[30], left[30], condition, one = 2.0;
    CHECK(dal_chart_error(chart)->text[0] == '\0');
    CHECK(dal_chart_dependent(chart) == NULL && dal_chart_independent(chart) == NULL);
    CHECK(dal_chart_choose(chart, 0.0, NULL, far) == 0);
    CHECK(dal_chart_dependent(chart)[0] == 0);
    CHECK(dal_chart_independent(chart)[0] == 1 && dal_chart_independent(chart)[1] == 2);
    CHECK(dal_chart_connection(chart, 0.0, far, A, &B) == 0);
    CHECK(B == -3.0 && A[0] == 0.0);
    CHECK_NEAR(A[1], -1.0 / 3, U);
    CHECK(dal_chart_multipliers(chart, 0.0, far, &one, &one) == 0 && one == -6.0);
    CHECK(dal_chart_multipliers_back(chart, 0.0, far, &one, &one) == 0);
    CHECK_NEAR(one, 2.0, 2 * U);

    CHECK(dal_chart_choose(chart, 0.0, NULL, x) == 0 && dal_chart_dependent(chart)[0] == 2);
    CHECK(dal_chart_connection(chart, 0.0, x, A, &B) == 0 && A[0] == -0.3 && A[1] == 0.0
          && B == 1.0);
    CHECK(dal_chart_condition(chart, 0.0, x, &condition) == 0);
    CHECK_NEAR(condition, sqrt(1.09), 4 * U);
    CHECK(dal_chart_split(chart, 0.0, x, hor, ver) == 0);
    CHECK(hor[0] == 1.0 && hor[1] == 0.7 && hor[2] == 0.3);
    CHECK(ver[0] == 0.0 && ver[1] == 0.0);
    CHECK_NEAR(ver[2], 0.6, U);
    CHECK(dal_chart_drop(chart, x, xi) == 0 && memcmp(xi, x, sizeof xi) == 0);
    CHECK(dal_chart_lift(chart, 0.0, xi, back) == 0 && memcmp(xi, back, sizeof xi) == 0);
    CHECK(back[5] == 0.3);
    /* vdot = mu^T lambda, lambda = v_x v_y / (1 + y^2) */
    CHECK(dal_chart_field(chart, 0.0, xi, xidot) == 0);
    CHECK(xidot[0] == 1.0 && xidot[1] == 0.7 && xidot[2] == 0.3);
    CHECK_NEAR(xidot[3], -0.3 * 0.7 / 1.09, 2 * U);
    CHECK(xidot[4] == 0.0);
    /* v_z = y v_x */
    CHECK(dal_chart_jacobian(chart, 0.0, xi, J, left) == 0);
    for (size_t i = 0; i < 6; i++)
        for (size_t k = 0; k < 5; k++) {
            const double expected = i < 5 ? (double)(i == k) : k == 1 ? 1.0 : k == 3 ? 0.3 : 0.0;
            CHECK_NEAR(J[5 * i + k], expected, U);
            CHECK(left[6 * k + i] == (double)(i == k));
        }
}

/* ---- the connection ------------------------------------------------------------------------ */

static void test_connection(const subject *s)
{
    const size_t n = s->n, m = s->m, free = n - m;
    const size_t *const dep = dal_chart_dependent(s->chart);
    const size_t *const ind = dal_chart_independent(s->chart);
    double A[M * N], B[M * M], mu[M * N], mass[N * N], hor[N], ver[N], other[N], condition = NAN;
    CHECK(dal_chart_connection(s->chart, 0.0, s->x, A, B) == 0);
    CHECK(dal_metric(s->mech, 0.0, s->x, mass) == 0);
    /* beta = 1 has its node at q, and w = v: mu_k is mu */
    const double zeros[M] = {0.0};
    CHECK(dal_step_equations(s->mech, 0.0, 1.0, 0.0, s->x, s->x + n, zeros, NULL, NULL, NULL, NULL,
                             mu) == 0);
    for (size_t a = 0; a + 1 < m; a++) CHECK(dep[a] < dep[a + 1]);
    for (size_t j = 0; j + 1 < free; j++) CHECK(ind[j] < ind[j + 1]);
    double largest = 0.0, squares = 0.0;
    for (size_t a = 0; a < m; a++) {
        for (size_t b = 0; b < m; b++) CHECK(B[a * m + b] == mu[a * n + dep[b]]);
        for (size_t j = 0; j < free; j++) {
            double sum = 0.0, scale = 0.0;
            for (size_t b = 0; b < m; b++) {
                sum += B[a * m + b] * A[b * free + j];
                scale += fabs(B[a * m + b] * A[b * free + j]);
            }
            CHECK_NEAR(sum, mu[a * n + ind[j]], ROUNDOFF * scale);
            const double units = sqrt(mass[dep[a] * (n + 1)] / mass[ind[j] * (n + 1)]);
            const double entry = A[a * free + j] * units;
            largest = fmax(largest, fabs(entry));
            squares += entry * entry;
        }
    }
    CHECK(largest <= 1.25 * (1 + ROUNDOFF));
    /* between the largest entry of A and the root of the sum of squares, which is it for m = 1 */
    CHECK(dal_chart_condition(s->chart, 0.0, s->x, &condition) == 0);
    CHECK(condition >= hypot(1.0, largest) * (1 - ROUNDOFF));
    CHECK(condition <= sqrt(1.0 + squares) * (1 + ROUNDOFF));
    if (m == 1 || free == 1) CHECK_NEAR(condition, sqrt(1.0 + squares), ROUNDOFF * condition);

    /* a velocity off D */
    double off[2 * N];
    unsigned seed = 9;
    memcpy(off, s->x, sizeof off);
    for (size_t i = 0; i < n; i++) off[n + i] += 0.1 * next_number(&seed);
    CHECK(dal_chart_split(s->chart, 0.0, off, hor, ver) == 0);
    const double scale = sum_of_sizes(n, hor) + sum_of_sizes(n, ver);
    for (size_t i = 0; i < n; i++) CHECK_NEAR(hor[i] + ver[i], off[n + i], 2 * U * scale);
    for (size_t j = 0; j < free; j++) CHECK(ver[ind[j]] == 0.0);
    memcpy(other, off + n, sizeof other);
    memcpy(off + n, hor, n * sizeof *hor);
    double relative = NAN;
    CHECK(dal_relative_residual(s->mech, 0.0, 0.0, off, &relative) == 0);
    CHECK(relative <= DAL_RESIDUAL_BOUND(n));
    /* ver is B^-1 phi where phi is at most affine */
    if (dal_system_kind(s->system) == DAL_NONLINEAR) return;
    double phi[M];
    memcpy(off + n, other, n * sizeof *other);
    CHECK(dal_residual(s->mech, 0.0, 0.0, off, phi) == 0);
    for (size_t a = 0; a < m; a++) {
        double sum = 0.0;
        for (size_t b = 0; b < m; b++) sum += B[a * m + b] * ver[dep[b]];
        CHECK_NEAR(sum, phi[a], ROUNDOFF * (1 + scale));
    }
}

/* Every set of dependent coordinates: refused, or A has the condition that the chosen one bounds.
 */
static void test_all_choices(const subject *s)
{
    const size_t n = s->n, m = s->m;
    dal_chart *const chart = open_chart(s->system);
    double best = INFINITY, chosen = NAN;
    CHECK(dal_chart_condition(s->chart, 0.0, s->x, &chosen) == 0);
    for (unsigned set = 0; set < 1u << n; set++) {
        size_t dependent[N], count = 0;
        for (size_t i = n; i-- > 0;)
            if ((set >> i) & 1) dependent[count++] = i; /* descending */
        if (count != m) continue;
        double condition = NAN;
        const int status = dal_chart_choose(chart, 0.0, dependent, s->x);
        CHECK(status == DAL_SUCCESS || status == DAL_ESINGULAR);
        if (status) continue;
        for (size_t a = 0; a < m; a++)
            CHECK(dal_chart_dependent(chart)[a] == dependent[m - 1 - a]);
        CHECK(dal_chart_condition(chart, 0.0, s->x, &condition) == 0 && condition >= 1.0);
        best = fmin(best, condition);
    }
    CHECK(chosen <= 1.25 * sqrt(1.0 + (double)(m * (n - m))) * best);
}

/* ---- psi ----------------------------------------------------------------------------------- */

static void test_psi(const subject *s)
{
    const size_t n = s->n, m = s->m, width = s->width, free = n - m;
    const size_t *const dep = dal_chart_dependent(s->chart);
    double xi[WIDTH], again[WIDTH], x[2 * N], J[2 * N * WIDTH], left[2 * N * WIDTH];
    double relative = NAN;
    CHECK(dal_chart_drop(s->chart, s->x, xi) == 0);
    CHECK(dal_chart_lift(s->chart, 0.0, xi, x) == 0);
    const double scale = 1 + sum_of_sizes(2 * n, s->x);
    CHECK_NEAR(largest_difference(2 * n, x, s->x), 0.0, ROUNDOFF * scale);
    unsigned seed = 5;
    for (int k = 0; k < 10; k++) {
        for (size_t i = 0; i < width; i++) xi[i] += 0.1 * next_number(&seed);
        CHECK(dal_chart_lift(s->chart, 0.0, xi, x) == 0);
        CHECK(dal_chart_drop(s->chart, x, again) == 0);
        CHECK(memcmp(again, xi, width * sizeof *xi) == 0);
        CHECK(dal_relative_residual(s->mech, 0.0, 0.0, x, &relative) == 0);
        CHECK(relative <= DAL_RESIDUAL_BOUND(n));
    }

    /* differences with d = 2^-17 err by d^2 times third derivatives and u/d: 1e-9 together */
    const double d = 0x1p-17;
    CHECK(dal_chart_jacobian(s->chart, 0.0, xi, J, left) == 0);
    for (size_t k = 0; k < width; k++) {
        double up[2 * N], down[2 * N], moved[WIDTH];
        memcpy(moved, xi, sizeof moved);
        moved[k] = xi[k] + d;
        CHECK(dal_chart_lift(s->chart, 0.0, moved, up) == 0);
        moved[k] = xi[k] - d;
        CHECK(dal_chart_lift(s->chart, 0.0, moved, down) == 0);
        for (size_t i = 0; i < 2 * n; i++) {
            const double entry = J[i * width + k];
            CHECK_NEAR(entry, (up[i] - down[i]) / (2 * d), 1e-8 * (1 + fabs(entry)));
        }
        for (size_t i = 0; i < width; i++) {
            double sum = 0.0;
            for (size_t r = 0; r < 2 * n; r++) sum += left[i * 2 * n + r] * J[r * width + k];
            CHECK(sum == (double)(i == k));
        }
    }

    /* h is tangent to D: the ODE in xi, moved by J, is the ODE on D */
    double xidot[WIDTH], xdot[2 * N], moved[2 * N], A[M * N];
    CHECK(dal_chart_lift(s->chart, 0.0, xi, x) == 0
          && dal_chart_field(s->chart, 0.7, xi, xidot) == 0);
    CHECK(dal_field(s->mech, 0.7, x, xdot) == 0);
    dal__apply(2 * n, width, J, xidot, moved);
    const double size = sum_of_sizes(2 * n, xdot) * (1 + sum_of_sizes(2 * n * width, J));
    CHECK_NEAR(largest_difference(2 * n, moved, xdot), 0.0, ROUNDOFF * size);
    CHECK(dal_chart_drop(s->chart, xdot, again) == 0);
    CHECK(memcmp(again, xidot, width * sizeof *xidot) == 0);

    /* mu^T lambda = [A, I]^T lambda_E */
    double lambda[M], lambda_E[M], back[M], mu[M * N], zeros[M] = {0.0};
    somewhere(m, &seed, lambda);
    CHECK(dal_chart_multipliers(s->chart, 0.0, x, lambda, lambda_E) == 0);
    CHECK(dal_chart_multipliers_back(s->chart, 0.0, x, lambda_E, back) == 0);
    CHECK_NEAR(largest_difference(m, back, lambda), 0.0, ROUNDOFF * (1 + sum_of_sizes(m, lambda)));
    CHECK(dal_chart_connection(s->chart, 0.0, x, A, NULL) == 0);
    CHECK(dal_step_equations(s->mech, 0.0, 1.0, 0.0, x, x + n, zeros, NULL, NULL, NULL, NULL, mu)
          == 0);
    for (size_t i = 0; i < n; i++) {
        double force = 0.0, from_E = 0.0, sizes = 0.0;
        size_t at = 0;
        while (at < m && dep[at] != i) at++;
        if (at < m) from_E = lambda_E[at];
        for (size_t a = 0; a < m; a++) {
            force += mu[a * n + i] * lambda[a];
            sizes += fabs(lambda_E[a]) + fabs(lambda[a]);
        }
        for (size_t j = 0; at == m && j < free; j++)
            for (size_t a = 0; dal_chart_independent(s->chart)[j] == i && a < m; a++)
                from_E += A[a * free + j] * lambda_E[a];
        CHECK_NEAR(force, from_E, ROUNDOFF * sizes);
    }
}

/* ---- the scheme ---------------------------------------------------------------------------- */

/* dal_chart_step is dal_step in other unknowns; lambda_E = B(q_k)^T lambda. */
static void test_step(const subject *s)
{
    const double betas[] = {0.0, 0.25, 0.5, 1.0}, steps[] = {0.05, -0.02};
    const size_t n = s->n, m = s->m;
    for (size_t b = 0; b < 4; b++)
        for (size_t k = 0; k < 2; k++) {
            const double h = steps[k], beta = betas[b], t = 0.3;
            const dal_scheme scheme = {.beta = beta};
            dal_stepper *const stepper = open_stepper(s->system, &scheme, NULL);
            double x[2 * N], xi[WIDTH], node[2 * N], lambda[M], lambda_E[M], expected[M];
            need(dal_stepper_start(stepper, t, h, s->x, DAL_CHECK, DAL_INITIAL_NONE), "start",
                 dal_stepper_error(stepper)->text);
            memcpy(node, dal_stepper_state(stepper), 2 * n * sizeof *node);
            CHECK(dal_chart_drop(s->chart, node, xi) == 0);
            CHECK(dal_step(stepper, lambda) == 0);
            CHECK(dal_chart_step(s->chart, t, beta, h, xi, lambda_E) == 0);
            CHECK(dal_chart_lift(s->chart, 0.0, xi, x) == 0);
            const double *const end = dal_stepper_state(stepper);
            const double scale = 1 + sum_of_sizes(2 * n, end);
            CHECK_NEAR(largest_difference(2 * n, x, end), 0.0, ROUNDOFF * scale);
            for (size_t i = 0; i < n; i++) {
                node[i] += (1 - beta) * h * node[n + i];
                node[n + i] = 0.5 * (node[n + i] + end[n + i]);
            }
            CHECK(dal_chart_multipliers(s->chart, 0.0, node, lambda, expected) == 0);
            CHECK_NEAR(largest_difference(m, lambda_E, expected), 0.0,
                       ROUNDOFF * scale * (1 + sum_of_sizes(m, expected)) / fabs(h));
            release(stepper);
        }
}

/* The paper's decompositions, with the q^alpha, q^a of its dependent and independent coordinates.
 * E6a: at beta = 1/2, q~^alpha_{k+1} = q^alpha_k - (h/2) A(q~_{k+1}) v^a_{k+1} is the scheme; with
 * the printed A(q_k) it is h^2 away.  E5: at beta = 0 v^a_{k+1} = v^a_k - h M^aj V_j(q_{k+1}) + h
 * H^T lambda(q~_k, v_k), with H = M^-1 [A, I]^T, is h^2 away from it; with the printed sign only h.
 */
static void test_errata(void)
{
    dal_system *const system = open_system("generic4");
    subject s = open_subject(system, 3);
    const size_t n = 4, m = 2;
    const size_t *const dep = dal_chart_dependent(s.chart);
    const size_t *const ind = dal_chart_independent(s.chart);
    double printed_E6[2], printed_E5[2], corrected_E5[2], inverse[16];
    memcpy(inverse, system->mass_inverse, sizeof inverse);
    for (int k = 0; k < 2; k++) {
        const double h = k == 0 ? 0x1p-8 : 0x1p-9;
        double xi[6], x[8], node[8], A[4], A_node[4];
        CHECK(dal_chart_drop(s.chart, s.x, xi) == 0);
        CHECK(dal_chart_step(s.chart, 0.0, 0.5, h, xi, NULL) == 0);
        CHECK(dal_chart_lift(s.chart, 0.0, xi, x) == 0);
        memcpy(node, s.x, sizeof node);
        for (size_t i = 0; i < n; i++) node[i] += h / 2 * node[n + i];
        CHECK(dal_chart_connection(s.chart, 0.0, x, A, NULL) == 0);
        CHECK(dal_chart_connection(s.chart, 0.0, node, A_node, NULL) == 0);
        printed_E6[k] = 0.0;
        for (size_t a = 0; a < m; a++) {
            double corrected = node[dep[a]], printed = node[dep[a]];
            for (size_t j = 0; j < n - m; j++) {
                corrected -= h / 2 * A[a * 2 + j] * x[n + ind[j]];
                printed -= h / 2 * A_node[a * 2 + j] * x[n + ind[j]];
            }
            CHECK_NEAR(corrected, x[dep[a]], 8 * U);
            printed_E6[k] = fmax(printed_E6[k], fabs(printed - x[dep[a]]));
        }

        double lambda[2], lambda_E[2], V_q[4], force[4], push[4], kick[4];
        CHECK(dal_chart_drop(s.chart, s.x, xi) == 0);
        CHECK(dal_chart_step(s.chart, 0.0, 0.0, h, xi, NULL) == 0);
        CHECK(dal_multipliers(s.mech, 0.0, s.x, lambda) == 0);
        CHECK(dal_chart_multipliers(s.chart, 0.0, s.x, lambda, lambda_E) == 0);
        memcpy(node, s.x, sizeof node);
        for (size_t i = 0; i < n; i++) node[i] += h * node[n + i];
        CHECK(dal_chart_connection(s.chart, 0.0, node, A, NULL) == 0);
        for (size_t a = 0; a < m; a++) {
            force[dep[a]] = lambda_E[a];
            force[ind[a]] = A[a] * lambda_E[0] + A[2 + a] * lambda_E[1]; /* column a of A */
        }
        CHECK(system->def.potential(0.0, node, NULL, V_q, NULL, system->def.ctx) == 0);
        dal__apply(n, n, inverse, force, push);
        dal__apply(n, n, inverse, V_q, kick);
        printed_E5[k] = corrected_E5[k] = 0.0;
        for (size_t j = 0; j < n - m; j++) {
            const double v = s.x[n + ind[j]] - h * kick[ind[j]];
            printed_E5[k] = fmax(printed_E5[k], fabs(v - h * push[ind[j]] - xi[n + j]));
            corrected_E5[k] = fmax(corrected_E5[k], fabs(v + h * push[ind[j]] - xi[n + j]));
        }
    }
    /* slopes over one halving, to 0.1 at these h */
    CHECK_NEAR(log2(printed_E6[0] / printed_E6[1]), 2.0, 0.1);
    CHECK_NEAR(log2(printed_E5[0] / printed_E5[1]), 1.0, 0.1);
    CHECK_NEAR(log2(corrected_E5[0] / corrected_E5[1]), 2.0, 0.1);
    printf("slopes over a halving: E6a printed %.2f; E5 printed %.2f, corrected %.2f\n",
           log2(printed_E6[0] / printed_E6[1]), log2(printed_E5[0] / printed_E5[1]),
           log2(corrected_E5[0] / corrected_E5[1]));
}

/* ---- what does not depend on coordinates or forms ------------------------------------------- */

/* generic4 in the coordinates q_i / unit_i. */
typedef struct other_units {
    const dal_system_def *def;
    double unit[4];
} other_units;

static int scaled_constraint(double t, const double *q, const double *v, double *phi,
                             double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    const other_units *const o = ctx;
    double Q[4], V[4];
    for (size_t i = 0; i < 4; i++) {
        Q[i] = q[i] * o->unit[i];
        V[i] = v[i] * o->unit[i];
    }
    const int returned = o->def->constraint(t, Q, V, phi, phi_v, phi_q, NULL, o->def->ctx);
    for (size_t a = 0; a < 2; a++)
        for (size_t i = 0; i < 4; i++) {
            if (phi_v) phi_v[a * 4 + i] *= o->unit[i];
            if (phi_q) phi_q[a * 4 + i] *= o->unit[i];
        }
    return returned;
}

static void test_invariance(void)
{
    dal_system *const system = open_system("generic4"), *scaled = NULL;
    dal_system *const mixed = open_mixed(system);
    other_units o = {.def = &system->def, .unit = {1e-3, 7.0, 2e4, 0.6}};
    double mass[16];
    for (size_t i = 0; i < 4; i++)
        for (size_t j = 0; j < 4; j++)
            mass[i * 4 + j] = generic4_mass[i * 4 + j] * o.unit[i] * o.unit[j];
    const dal_system_def def = {.n = 4, .m = 2, .mass = mass, .constraint = scaled_constraint,
                                .ctx = &o};
    scaled = new_system(&def);
    dal_chart *const in_units = open_chart(scaled), *const of_forms = open_chart(mixed);
    for (unsigned seed = 1; seed < 20; seed++) {
        subject s = open_subject(system, seed);
        double x[8], condition = NAN, other = NAN, A[4], mixed_A[4];
        for (size_t i = 0; i < 8; i++) x[i] = s.x[i] / o.unit[i % 4];
        CHECK(dal_chart_choose(in_units, 0.0, NULL, x) == 0);
        for (size_t k = 0; k < 2; k++)
            CHECK(dal_chart_dependent(in_units)[k] == dal_chart_dependent(s.chart)[k]);
        CHECK(dal_chart_condition(s.chart, 0.0, s.x, &condition) == 0);
        CHECK(dal_chart_condition(in_units, 0.0, x, &other) == 0);
        CHECK_NEAR(condition, other, ROUNDOFF * condition);
        CHECK(dal_chart_choose(of_forms, 0.0, dal_chart_dependent(s.chart), s.x) == 0);
        CHECK(dal_chart_condition(of_forms, 0.0, s.x, &other) == 0);
        CHECK_NEAR(condition, other, ROUNDOFF * condition);
        CHECK(dal_chart_connection(s.chart, 0.0, s.x, A, NULL) == 0);
        CHECK(dal_chart_connection(of_forms, 0.0, s.x, mixed_A, NULL) == 0);
        CHECK_NEAR(largest_difference(4, A, mixed_A), 0.0, ROUNDOFF * condition);
        CHECK(dal_chart_choose(of_forms, 0.0, NULL, s.x) == 0);
        CHECK(dal_chart_condition(of_forms, 0.0, s.x, &other) == 0);
        CHECK(other <= 1.25 * sqrt(5.0));
    }
}

/* Fifty trailers in line: 51 constraints, whose chart is as good as that of three. */
static void test_many_constraints(void)
{
    const char *const names[] = {"trailers"};
    const double fifty = 50.0;
    double x[106], back[106], xi[55], condition = NAN;
    dal_system *const system = open_builtin("n_trailer", 1, names, &fifty);
    dal_chart *const chart = open_chart(system);
    CHECK(dal_system_state(system, x) == 0);
    CHECK(dal_chart_choose(chart, 0.0, NULL, x) == 0);
    CHECK(dal_chart_condition(chart, 0.0, x, &condition) == 0 && condition < 1.2);
    CHECK(dal_chart_drop(chart, x, xi) == 0 && dal_chart_lift(chart, 0.0, xi, back) == 0);
    CHECK_NEAR(largest_difference(106, x, back), 0.0, 53 * U);
    CHECK(dal_chart_step(chart, 0.0, 0.5, 0.01, xi, NULL) == 0);
}

/* The particle: with z dependent A = (-y, 0), with x dependent A = (0, -1/y).  The limit is
 * 10 sqrt(3): they are kept for |y| < 17.2 and |y| > 1/17.2, and no change is undone at once. */
static void test_renewal(void)
{
    dal_system *const system = open_system("particle");
    dal_chart *const chart = open_chart(system);
    const struct {
        double y;
        int changed;
        size_t dependent;
    } course[] = {{0.0, 1, 2}, {2.0, 0, 2}, {17.0, 0, 2}, {18.0, 1, 0}, {17.0, 0, 0}, {1.0, 0, 0},
                  {-0.06, 0, 0}, {-0.05, 1, 2}, {0.06, 0, 2}, {1e300, 1, 0}, {0.0, 1, 2}};
    for (size_t k = 0; k < sizeof course / sizeof *course; k++) {
        const double x[6] = {0.0, course[k].y, 0.0, 1.0, 1.0, course[k].y};
        int changed = -1;
        CHECK(dal_chart_renew(chart, 0.0, x, &changed) == 0);
        CHECK(changed == course[k].changed);
        CHECK(dal_chart_dependent(chart)[0] == course[k].dependent);
        if (k == 3)
            CHECK(strcmp(dal_chart_error(chart)->text, "the dependent coordinates change from z "
                         "(condition 18 here) to x") == 0);
    }
    double condition = NAN;
    const double at_infinity[6] = {0.0, 0.0, 0.0, 1.0, 1.0, 0.0}, beside[6] = {0.0, 1.0};
    const size_t x_depends = 0;
    CHECK(dal_chart_choose(chart, 0.0, &x_depends, beside) == 0);
    CHECK(dal_chart_condition(chart, 0.0, at_infinity, &condition) == 0 && condition == INFINITY);
    CHECK(strstr(dal_chart_error(chart)->text, "singular") == NULL); /* that is no failure */
    CHECK(dal_chart_renew(chart, 0.0, at_infinity, NULL) == 0
          && dal_chart_dependent(chart)[0] == 2);
}

/* phi = v_z^2 - v_x^2 - v_y^2 has two branches; Newton stays on that of the choice. */
static int cone(double t, const double *q, const double *v, double *phi, double *phi_v,
                double *phi_q, double *phi_t, void *ctx)
{
    if (phi) phi[0] = v[2] * v[2] - v[0] * v[0] - v[1] * v[1];
    vector_set(phi_v, 3, (double[]){-2 * v[0], -2 * v[1], 2 * v[2]});
    vector_set(phi_q, 3, (double[3]){0.0});
    return 0;
}

static void test_branches(void)
{
    const dal_system_def def = {.n = 3, .m = 1, .mass = vector_mass_one, .constraint = cone,
                                .kind = DAL_NONLINEAR};
    const double up[6] = {0, 0, 0, 3, 4, 5}, down[6] = {0, 0, 0, 3, 4, -5};
    const double xi[5] = {1, 2, 3, 5, 12}, none[5] = {0, 0, 0, 0, 0};
    const size_t z = 2;
    double x[6], start[6] = {7, 7, 7, 7, 7, 7};
    dal_system *const system = new_system(&def);
    dal_chart *const chart = open_chart(system);
    CHECK(dal_chart_choose(chart, 0.0, &z, up) == 0 && dal_chart_lift(chart, 0.0, xi, x) == 0);
    CHECK_NEAR(x[5], 13.0, 32 * U);
    CHECK(dal_chart_renew(chart, 0.0, down, NULL) == 0 && dal_chart_lift(chart, 0.0, xi, x) == 0);
    CHECK_NEAR(x[5], -13.0, 32 * U);
    /* D to roundoff, and what is on D already stays where it is, bit for bit */
    unsigned seed = 8;
    CHECK(dal_chart_renew(chart, 0.0, up, NULL) == 0);
    for (int k = 0; k < 1000; k++) {
        double point[5], again[6];
        somewhere(5, &seed, point);
        CHECK(dal_chart_lift(chart, 0.0, point, x) == 0);
        const double a = point[3], b = point[4], squares = a * a + b * b;
        CHECK_NEAR(fma(x[5], x[5], -squares), 0.0, 32 * U * squares);
        CHECK(dal_chart_renew(chart, 0.0, x, NULL) == 0);
        CHECK(dal_chart_lift(chart, 0.0, point, again) == 0 && memcmp(x, again, sizeof x) == 0);
    }
    /* where the branches meet Newton halves v_z for ever: phi_v vanishes with v */
    CHECK(dal_chart_lift(chart, 0.0, none, start) == DAL_ENOCONV && start[0] == 7.0);
    CHECK(strstr(dal_chart_error(chart)->text, "in 50 iterations") != NULL);
}

/* ---- no constraints, failures -------------------------------------------------------------- */

static void test_no_constraint(void)
{
    wide w;
    dal_system *const system = open_wide(&w, 3, 0, true, true);
    subject s = open_subject(system, 4);
    double xi[6], x[6], J[36], left[36], hor[3], ver[3], xidot[6], xdot[6], condition = NAN;
    CHECK(dal_chart_dependent(s.chart) != NULL && dal_chart_independent(s.chart)[2] == 2);
    CHECK(dal_chart_drop(s.chart, s.x, xi) == 0 && memcmp(xi, s.x, sizeof xi) == 0);
    CHECK(dal_chart_lift(s.chart, 0.0, xi, x) == 0 && memcmp(xi, x, sizeof xi) == 0);
    CHECK(dal_chart_jacobian(s.chart, 0.0, xi, J, left) == 0);
    for (size_t k = 0; k < 36; k++) CHECK(J[k] == (double)(k % 7 == 0) && left[k] == J[k]);
    CHECK(dal_chart_split(s.chart, 0.0, x, hor, ver) == 0 && memcmp(hor, x + 3, sizeof hor) == 0);
    CHECK(ver[0] == 0.0 && ver[1] == 0.0 && ver[2] == 0.0);
    CHECK(dal_chart_field(s.chart, 0.0, xi, xidot) == 0 && dal_field(s.mech, 0.0, x, xdot) == 0);
    CHECK(memcmp(xidot, xdot, sizeof xdot) == 0);
    CHECK(dal_chart_condition(s.chart, 0.0, x, &condition) == 0 && condition == 1.0);
    CHECK(dal_chart_connection(s.chart, 0.0, x, NULL, NULL) == 0);
    CHECK(dal_chart_multipliers(s.chart, 0.0, x, NULL, x) == 0);
    CHECK(dal_chart_renew(s.chart, 0.0, x, NULL) == 0);
    test_step(&s);

    const dal_system_def line = {.n = 1, .mass = vector_mass_one};
    double fast[2] = {0.0, 1e300};
    dal_system *const system_of_line = new_system(&line);
    dal_chart *const chart = open_chart(system_of_line);
    CHECK(dal_chart_choose(chart, 0.0, NULL, fast) == 0);
    CHECK(dal_chart_step(chart, 0.0, 0.5, 1e10, fast, NULL) == DAL_EDOMAIN);
    CHECK(fast[0] == 0.0 && strstr(dal_chart_error(chart)->text, "overflows with h = 1e+10"));
    CHECK(dal_chart_step(chart, 0.0, 0.5, 1e5, fast, NULL) == 0 && fast[1] == 1e300);
}

/* Two forms that coincide where q0 = 0; outside its domain for q0 > 10, stops for q0 < -10. */
static int degenerate(double t, const double *q, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    vector_set(phi_v, 6, (double[]){1.0, 2.0, 0.3, 1.0, 2.0, 0.3 + q[0]});
    vector_set(phi_q, 6, (double[]){0.0, 0.0, 0.0, v[2], 0.0, 0.0});
    return q[0] > 10.0 ? 1 : q[0] < -10.0 ? -1 : 0;
}

/* The first two columns are parallel, but for the rounding of 2.1. */
static int parallel(double t, const double *q, const double *v, double *phi, double *phi_v,
                    double *phi_q, double *phi_t, void *ctx)
{
    vector_set(phi_v, 6, (double[]){0.1, 0.7, 1.0, 0.3, 2.1, 2.0});
    vector_set(phi_q, 6, (double[6]){0.0});
    return 0;
}

/* Elimination by the largest entry takes the first two columns and gives A = (2, 1). */
static int exchanged(double t, const double *q, const double *v, double *phi, double *phi_v,
                     double *phi_q, double *phi_t, void *ctx)
{
    vector_set(phi_v, 6, (double[]){1.0, -1.0, 1.0, 0.0, 5.0, 5.0});
    vector_set(phi_q, 6, (double[6]){0.0});
    return 0;
}

static int steep(double t, const double *q, const double *v, double *phi, double *phi_v,
                 double *phi_q, double *phi_t, void *ctx)
{
    vector_set(phi_v, 2, (double[]){1.0, 1e-300});
    vector_set(phi_q, 2, (double[2]){0.0});
    return 0;
}

/* v_1 = -1e300 v_0 */
static void test_overflow(void)
{
    const double mass[4] = {1, 0, 0, 1};
    const dal_system_def def = {.n = 2, .m = 1, .mass = mass, .constraint = steep};
    const size_t second = 1;
    double xi[3] = {0.0, 0.0, 1.0}, x[4] = {0.0};
    dal_system *const system = new_system(&def);
    dal_chart *const chart = open_chart(system);
    CHECK(dal_chart_choose(chart, 0.0, &second, x) == 0 && dal_chart_lift(chart, 0.0, xi, x) == 0);
    CHECK_NEAR(x[3], -1e300, 1e300 * 4 * U);
    xi[2] = 1e10;
    CHECK(dal_chart_lift(chart, 0.0, xi, x) == DAL_EDOMAIN && x[2] == 1.0);
    CHECK(strstr(dal_chart_error(chart)->text, "overflow") != NULL);
}

static void test_pivoting(void)
{
    const double x[6] = {0.0};
    const size_t first[2] = {1, 0};
    dal_system_def def = {.n = 3, .m = 2, .mass = vector_mass_one, .constraint = exchanged};
    double A[2];
    dal_chart *chart = open_chart(new_system(&def));
    CHECK(dal_chart_choose(chart, 0.0, NULL, x) == 0
          && dal_chart_connection(chart, 0.0, x, A, NULL) == 0);
    CHECK(dal_chart_independent(chart)[0] == 0);
    CHECK_NEAR(A[0], -0.5, 2 * U);
    CHECK_NEAR(A[1], 0.5, 2 * U);

    def.constraint = parallel;
    chart = open_chart(new_system(&def));
    CHECK(dal_chart_choose(chart, 0.0, first, x) == DAL_ESINGULAR);
    CHECK(dal_chart_choose(chart, 0.0, NULL, x) == 0 && dal_chart_dependent(chart)[1] == 2);
}

static void test_failures(void)
{
    const dal_system_def def = {.n = 3, .m = 2, .mass = vector_mass_one, .constraint = degenerate};
    const size_t twice[2] = {1, 1}, beyond[2] = {0, 3}, first[2] = {0, 1};
    double x[6] = {1, 2, 3, 0.5, 0.4, 0.3}, out[24], condition = 7.0;
    dal_chart *chart = NULL;
    dal_error error;
    int changed = 7;
    for (size_t k = 0; k < 24; k++) out[k] = 7.0;
    dal_system *const system = new_system(&def);
    CHECK(dal_chart_new(NULL, system, &error) == DAL_EINVAL);
    CHECK(strcmp(error.text, "chart is NULL") == 0);
    CHECK(dal_chart_new(&chart, NULL, &error) == DAL_EINVAL);
    CHECK(strcmp(error.text, "system is NULL") == 0);
    CHECK(chart == NULL);
    dal_chart_free(NULL);
    chart = open_chart(system);
#define FAILS(status, call, words)                                       \
    do {                                                                 \
        CHECK((call) == (status));                                       \
        CHECK(strstr(dal_chart_error(chart)->text, words) != NULL);          \
    } while (0)
    FAILS(DAL_EINVAL, dal_chart_lift(chart, 0.0, x, out), "no dependent coordinates");
    FAILS(DAL_EINVAL, dal_chart_condition(chart, 0.0, x, &condition), "no dependent");
    FAILS(DAL_EINVAL, dal_chart_drop(chart, x, out), "no dependent");
    FAILS(DAL_EINVAL, dal_chart_choose(chart, 0.0, twice, x), "[0] and dependent[1] are both 1");
    FAILS(DAL_EINVAL, dal_chart_choose(chart, 0.0, beyond, x), "dependent[1] = 3: expected");
    FAILS(DAL_ESINGULAR, dal_chart_choose(chart, 0.0, first, x), "the coordinates q0, q1 cannot");
    FAILS(DAL_EINVAL, dal_chart_choose(chart, 0.0, NULL, NULL), "x is NULL");
    CHECK(dal_chart_dependent(chart) == NULL);
    CHECK(dal_chart_choose(chart, 0.0, NULL, x) == 0);
    /* the choice survives what fails */
    FAILS(DAL_ESINGULAR, dal_chart_choose(chart, 0.0, first, x), "form a singular matrix");
    CHECK(dal_chart_dependent(chart)[0] == 1 && dal_chart_dependent(chart)[1] == 2);
    x[0] = 0.0;
    FAILS(DAL_ESINGULAR, dal_chart_choose(chart, 0.0, NULL, x), "mu has rank 1");
    FAILS(DAL_ESINGULAR, dal_chart_renew(chart, 0.0, x, &changed), "mu has rank 1");
    FAILS(DAL_ESINGULAR, dal_chart_lift(chart, 0.0, x, out), "coordinates q1, q2");
    FAILS(DAL_ESINGULAR, dal_chart_connection(chart, 0.0, x, out, out), "singular");
    FAILS(DAL_ESINGULAR, dal_chart_split(chart, 0.0, x, out, out), "singular");
    FAILS(DAL_ESINGULAR, dal_chart_jacobian(chart, 0.0, x, out, out), "singular");
    FAILS(DAL_ESINGULAR, dal_chart_field(chart, 0.0, x, out), "singular");
    FAILS(DAL_ESINGULAR, dal_chart_multipliers(chart, 0.0, x, x, out), "singular");
    FAILS(DAL_ESINGULAR, dal_chart_multipliers_back(chart, 0.0, x, x, out), "singular");
    FAILS(DAL_ESINGULAR, dal_chart_step(chart, 0, 0.5, 0.1, x, out), "singular");
    x[0] = 11.0;
    FAILS(DAL_EDOMAIN, dal_chart_lift(chart, 0.0, x, out), "returned 1");
    FAILS(DAL_EDOMAIN, dal_chart_condition(chart, 0.0, x, &condition), "returned 1");
    x[0] = -11.0;
    FAILS(DAL_EUSER, dal_chart_step(chart, 0, 0.5, 0.1, x, out), "returned -1");
    FAILS(DAL_EUSER, dal_chart_renew(chart, 0.0, x, &changed), "returned -1");
    x[0] = 1.0;
    FAILS(DAL_EINVAL, dal_chart_step(chart, 0, 1.5, 0.1, x, out), "beta = 1.5");
    FAILS(DAL_EINVAL, dal_chart_step(chart, 0, 0.5, 0.0, x, out), "h = 0");
    FAILS(DAL_EINVAL, dal_chart_step(chart, 0, 0.5, INFINITY, x, out), "h = inf");
    FAILS(DAL_EINVAL, dal_chart_step(chart, NAN, 0.5, 0.1, x, out), "t[0] = nan");
    FAILS(DAL_EINVAL, dal_chart_step(chart, 0, 0.5, 0.1, NULL, out), "xi is NULL");
    FAILS(DAL_EINVAL, dal_chart_lift(chart, 0.0, x, NULL), "x is NULL");
    FAILS(DAL_EINVAL, dal_chart_lift(chart, 0.0, NULL, out), "xi is NULL");
    FAILS(DAL_EINVAL, dal_chart_drop(chart, NULL, out), "x is NULL");
    FAILS(DAL_EINVAL, dal_chart_drop(chart, x, NULL), "xi is NULL");
    FAILS(DAL_EINVAL, dal_chart_field(chart, 0, NULL, out), "xi is NULL");
    FAILS(DAL_EINVAL, dal_chart_field(chart, 0, x, NULL), "xidot is NULL");
    FAILS(DAL_EINVAL, dal_chart_field(chart, NAN, x, out), "t[0] = nan");
    FAILS(DAL_EINVAL, dal_chart_condition(chart, 0.0, x, NULL), "condition is NULL");
    FAILS(DAL_EINVAL, dal_chart_condition(chart, 0.0, NULL, &condition), "x is NULL");
    FAILS(DAL_EINVAL, dal_chart_renew(chart, 0.0, NULL, &changed), "x is NULL");
    FAILS(DAL_EINVAL, dal_chart_connection(chart, 0.0, NULL, out, out), "x is NULL");
    FAILS(DAL_EINVAL, dal_chart_split(chart, 0.0, NULL, out, out), "x is NULL");
    FAILS(DAL_EINVAL, dal_chart_jacobian(chart, 0.0, NULL, out, out), "xi is NULL");
    FAILS(DAL_EINVAL, dal_chart_multipliers(chart, 0.0, x, NULL, out), "lambda is NULL");
    FAILS(DAL_EINVAL, dal_chart_multipliers(chart, 0.0, x, x, NULL), "lambda_E is NULL");
    FAILS(DAL_EINVAL, dal_chart_multipliers_back(chart, 0.0, x, NULL, out), "lambda_E is NULL");
    FAILS(DAL_EINVAL, dal_chart_multipliers_back(chart, 0.0, x, x, NULL), "lambda is NULL");
    x[3] = NAN;
    FAILS(DAL_EINVAL, dal_chart_lift(chart, 0.0, x, out), "xi[3] = nan");
    FAILS(DAL_EINVAL, dal_chart_split(chart, 0.0, x, out, out), "x[3] = nan");
    x[3] = 0.5;
#undef FAILS
    const dal_chart *const none = NULL;
    CHECK(dal_chart_dependent(none) == NULL && dal_chart_independent(none) == NULL);
    CHECK(dal_chart_choose(NULL, 0.0, NULL, x) == DAL_EINVAL);
    CHECK(dal_chart_lift(NULL, 0.0, x, out) == DAL_EINVAL);
    CHECK(dal_chart_condition(NULL, 0.0, x, out) == DAL_EINVAL);
    CHECK(dal_chart_renew(NULL, 0.0, x, NULL) == DAL_EINVAL);
    CHECK(dal_chart_connection(NULL, 0.0, x, out, out) == DAL_EINVAL);
    CHECK(dal_chart_split(NULL, 0.0, x, out, out) == DAL_EINVAL);
    CHECK(dal_chart_drop(NULL, x, out) == DAL_EINVAL);
    CHECK(dal_chart_jacobian(NULL, 0.0, x, out, out) == DAL_EINVAL);
    CHECK(dal_chart_field(NULL, 0, x, out) == DAL_EINVAL);
    CHECK(dal_chart_multipliers(NULL, 0.0, x, x, out) == DAL_EINVAL);
    CHECK(dal_chart_multipliers_back(NULL, 0.0, x, x, out) == DAL_EINVAL);
    CHECK(dal_chart_step(NULL, 0, 0.5, 0.1, x, out) == DAL_EINVAL);
    for (size_t k = 0; k < 24; k++) CHECK(out[k] == 7.0);
    CHECK(condition == 7.0 && changed == 7);
    CHECK(dal_chart_dependent(chart)[0] == 1 && dal_chart_lift(chart, 0.0, x, out) == 0);
}

/* The step that has no solution: 1 + y_k y_{k+1} = 0 at beta = 1, y = -1, h v_y = 2. */
static void test_singular_step(void)
{
    dal_system *const system = open_system("particle");
    dal_chart *const chart = open_chart(system);
    const double x[6] = {0, -1, 0, 1, 1, -1};
    double xi[5], before[5];
    CHECK(dal_chart_choose(chart, 0.0, NULL, x) == 0 && dal_chart_drop(chart, x, xi) == 0);
    memcpy(before, xi, sizeof xi);
    CHECK(dal_chart_step(chart, 0.0, 1.0, 2.0, xi, NULL) == DAL_ESINGULAR);
    CHECK(strstr(dal_chart_error(chart)->text, "with h = 2: the constraints lose rank here, or "
                                               "h is too large") != NULL);
    CHECK(memcmp(before, xi, sizeof xi) == 0);
}

static void test_system(dal_system *system)
{
    for (unsigned seed = 1; seed < 4; seed++) {
        subject s = open_subject(system, seed);
        test_connection(&s);
        test_all_choices(&s);
        test_psi(&s);
        test_step(&s);
    }
}

int main(void)
{
    test_particle();
    for (size_t k = 0; k < sizeof vector_systems / sizeof *vector_systems; k++) {
        dal_system *const system = open_vector_system(&vector_systems[k]);
        test_system(system);
        if (vector_systems[k].n == 3) {
            dal_system *const deformed = open_deformed(system, product, NULL, 0.3, DAL_NONLINEAR,
                                                       0);
            dal_system *const affine = open_deformed(system, drift, NULL, 0.3, DAL_AFFINE, 0);
            test_system(deformed);
            test_system(affine);
            release(deformed);
        }
        release(system);
    }
    wide w;
    dal_system *const large = open_wide(&w, 8, 5, true, true);
    test_system(large);
    test_errata();
    test_invariance();
    test_many_constraints();
    test_renewal();
    test_branches();
    test_no_constraint();
    test_pivoting();
    test_overflow();
    test_singular_step();
    test_failures();
    return check_done();
}
