/* Mechanics on D: energy, C, lambda, acceleration, projections, the equations of a step, against
 * formulas by hand, differences and the identities that they satisfy.
 *
 * ROUNDOFF is relative to the sizes that enter: a few sums of n terms and one solve with C, whose
 * condition is below 10 here. */
#include "fixtures.h"
#include "check.h"

#define ROUNDOFF (128 * U)

enum { N = 16, M = 8 };

static const char *const all_systems[] = {"particle", "particle_oscillator", "knife_edge", "sleigh",
                                          "disk", "heisenberg", "contact_oscillator", "robot",
                                          "chaotic", "generic4", "uneven_edge"};
enum { SYSTEMS = sizeof all_systems / sizeof all_systems[0] };

/* Somewhere in TQ, off D. */
static void somewhere(size_t n, unsigned seed, double *x)
{
    for (size_t i = 0; i < 2 * n; i++) x[i] = next_number(&seed);
}

static double dot(size_t n, const double *a, const double *b)
{
    double sum = 0.0;
    for (size_t i = 0; i < n; i++) sum += a[i] * b[i];
    return sum;
}

/* ---- by hand ----------------------------------------------------------------------------- */

/* The particle on springs: C = 1 + y^2, lambda = (v_x v_y + mu.V_q)/(1 + y^2), mu = (-y, 0, 1). */
static void test_particle(void)
{
    const double k[3] = {1.0, 2.0, 1.5}, x[6] = {0.5, 0.3, -0.2, 1.0, 0.7, 0.9};
    dal_system *const system = open_system("particle_oscillator");
    dal_mechanics *const mech = open_mechanics(system);
    double E = NAN, C = NAN, lambda = NAN, vdot[3], xdot[6], residual = NAN, relative = NAN;
    CHECK(dal_energy(mech, 0.0, x, &E) == 0);
    CHECK_NEAR(E, (1.0 + 0.49 + 0.81 + 0.25 + 2 * 0.09 + 1.5 * 0.04) / 2, 8 * U);
    CHECK(dal_gram(mech, 0.0, x, &C) == 0);
    CHECK_NEAR(C, 1.09, 4 * U);
    CHECK(dal_multipliers(mech, 0.0, x, &lambda) == 0);
    CHECK_NEAR(lambda, (0.7 + (-0.3 * 0.5 - 1.5 * 0.2)) / 1.09, 8 * U);
    CHECK(dal_acceleration(mech, 0.0, x, vdot) == 0 && dal_field(mech, 0.0, x, xdot) == 0);
    const double mu[3] = {-0.3, 0.0, 1.0};
    for (size_t i = 0; i < 3; i++) {
        CHECK_NEAR(vdot[i], mu[i] * lambda - k[i] * x[i], 8 * U);
        CHECK(xdot[i] == x[3 + i] && xdot[3 + i] == vdot[i]);
    }
    CHECK(dal_residual(mech, 0.0, 0.0, x, &residual) == 0);
    CHECK_NEAR(residual, 0.9 - 0.3, 4 * U);
    CHECK(dal_relative_residual(mech, 0.0, 0.0, x, &relative) == 0);
    CHECK_NEAR(relative, 0.6 / 1.3, 4 * U); /* (0.3 + 1) max(1, 0.7, 0.9), M = 1 */
    CHECK(dal_residual(mech, 0.0, 0.1, x, &residual) == 0); /* mu at y - 0.1 v_y = 0.23 */
    CHECK_NEAR(residual, 0.9 - 0.23, 4 * U);
    CHECK(dal_relative_residual(mech, 0.0, 0.1, x, &relative) == 0);
    CHECK_NEAR(relative, 0.67 / (1.23 + 0.23 + 0.07), 4 * U); /* and |N| = 1 at that y */
    double alias[6];
    memcpy(alias, x, sizeof alias);
    CHECK(dal_field(mech, 0.0, alias, alias) == 0);
    CHECK(memcmp(alias, xdot, sizeof alias) == 0);
    const double rest[6] = {0.5, 0.3, -0.2, 0, 0, 0};
    CHECK(dal_relative_residual(mech, 0.0, 0.0, rest, &relative) == 0 && relative == 0.0);
    dal_mechanics_free(NULL);
}

/* E and C with full M from their definitions. */
static void test_definitions(dal_mechanics *mech, const dal_system *system, const double *x)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    const double *const mass = mass_of(system);
    double E = NAN, V = 0.0, kinetic = 0.0, size = 0.0, C[M * M], mu[M * N], back[N];
    if (system->def.potential) system->def.potential(0.0, x, &V, NULL, NULL, system->def.ctx);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < n; j++) {
            kinetic += mass[i * n + j] * x[n + i] * x[n + j] / 2;
            size += fabs(mass[i * n + j] * x[n + i] * x[n + j]);
        }
    CHECK(dal_energy(mech, 0.0, x, &E) == 0);
    CHECK_NEAR(E, kinetic + V, ROUNDOFF * (size + fabs(V)));
    if (m == 0) return;
    CHECK(dal_gram(mech, 0.0, x, C) == 0);
    system->def.constraint(0.0, x, x + n, NULL, mu, NULL, NULL, system->def.ctx);
    for (size_t a = 0; a < m; a++) { /* mu^T = M Z^T, C = mu Z^T: solve with M by its factor */
        double factor[N * N], inverse[N], z[N];
        memcpy(factor, mass, n * n * sizeof *factor);
        CHECK(dal__cholesky(n, factor, inverse, NULL, NULL));
        memcpy(z, mu + a * n, n * sizeof *z);
        dal__cholesky_solve(n, factor, z);
        dal__apply(n, n, mass, z, back);
        CHECK_NEAR(largest_difference(n, back, mu + a * n), 0.0, ROUNDOFF * 10);
        for (size_t b = 0; b < m; b++)
            CHECK_NEAR(C[b * m + a], dot(n, mu + b * n, z), ROUNDOFF * 10);
    }
}

/* ---- identities of the ODE ---------------------------------------------------------------- */

/* mu vdot + N v = 0, also off D; M vdot + V_q = mu^T lambda; on D the power of the reaction,
 * v.(M vdot + V_q), vanishes, so E is a first integral. */
static void test_ode(dal_mechanics *mech, const dal_system *system, const double *x)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    double mu[M * N], dmu[M * N], vdot[N], force[N] = {0}, lambda[M], balance[N], xd[2 * N];
    if (system->def.potential) system->def.potential(0.0, x, NULL, force, NULL, system->def.ctx);
    system->def.constraint(0.0, x, x + n, NULL, mu, dmu, NULL, system->def.ctx);
    CHECK(dal_acceleration(mech, 0.0, x, vdot) == 0 && dal_multipliers(mech, 0.0, x, lambda) == 0);
    const double size =
        1 + sum_of_sizes(n, vdot) + sum_of_sizes(n, force) + sum_of_sizes(m, lambda);
    for (size_t a = 0; a < m; a++)
        CHECK_NEAR(dot(n, mu + a * n, vdot) + dot(n, dmu + a * n, x + n), 0.0, ROUNDOFF * size);
    dal__apply(n, n, mass_of(system), vdot, balance);
    for (size_t i = 0; i < n; i++) {
        double reaction = 0.0;
        for (size_t a = 0; a < m; a++) reaction += mu[a * n + i] * lambda[a];
        CHECK_NEAR(balance[i] + force[i], reaction, 10 * ROUNDOFF * size);
    }
    memcpy(xd, x, 2 * n * sizeof *xd);
    CHECK(dal_project(mech, 0.0, 0.0, xd, NULL) == 0);
    CHECK(dal_acceleration(mech, 0.0, xd, vdot) == 0);
    dal__apply(n, n, mass_of(system), vdot, balance);
    for (size_t i = 0; i < n; i++) balance[i] += force[i];
    CHECK_NEAR(dot(n, xd + n, balance), 0.0, 20 * ROUNDOFF * size * (1 + sum_of_sizes(n, xd + n)));
}

/* The perturbed DAE for any ghat: its field and multiplier fulfil the n + m equations
 *   M (vdot - weight ghat_v) + V_q = mu^T lambda,  mu vdot + phi_q (v + weight ghat_q) = 0,
 * which have one solution.  A ghat across D, (0, M^-1 mu^T c), changes lambda by -weight c only. */
static void test_perturbed(dal_mechanics *mech, const dal_system *system, const double *x)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    const double weight = 0.3, *const mass = mass_of(system);
    double mu[M * N], dmu[M * N], force[N] = {0}, ghat[2 * N], xdot[2 * N], other[2 * N];
    double lambda[M], shifted[M], free[N], balance[N], factor[N * N];
    if (system->def.potential) system->def.potential(0.0, x, NULL, force, NULL, system->def.ctx);
    system->def.constraint(0.0, x, x + n, NULL, mu, dmu, NULL, system->def.ctx);
    somewhere(n, 5, ghat);
    CHECK(dal_perturbed(mech, 0.0, weight, x, ghat, xdot, lambda) == 0);
    const double size = 1 + sum_of_sizes(2 * n, xdot) + sum_of_sizes(2 * n, ghat)
                      + sum_of_sizes(n, force) + sum_of_sizes(m, lambda);
    for (size_t i = 0; i < n; i++) {
        CHECK_NEAR(xdot[i], x[n + i] + weight * ghat[i], 2 * U * size);
        free[i] = xdot[n + i] - weight * ghat[n + i];
    }
    dal__apply(n, n, mass, free, balance);
    for (size_t i = 0; i < n; i++) {
        double reaction = 0.0;
        for (size_t a = 0; a < m; a++) reaction += mu[a * n + i] * lambda[a];
        CHECK_NEAR(balance[i] + force[i], reaction, 10 * ROUNDOFF * size);
    }
    for (size_t a = 0; a < m; a++)
        CHECK_NEAR(dot(n, mu + a * n, xdot + n) + dot(n, dmu + a * n, xdot), 0.0,
                   10 * ROUNDOFF * size);

    memset(ghat, 0, sizeof ghat);
    for (size_t i = 0; i < n; i++)
        for (size_t a = 0; a < m; a++) ghat[n + i] += mu[a * n + i] * (1.0 + (double)a);
    double inverse[N];
    memcpy(factor, mass, n * n * sizeof *factor);
    CHECK(dal__cholesky(n, factor, inverse, NULL, NULL));
    dal__cholesky_solve(n, factor, ghat + n);
    CHECK(dal_perturbed(mech, 0.0, weight, x, ghat, other, shifted) == 0);
    CHECK(dal_field(mech, 0.0, x, xdot) == 0 && dal_multipliers(mech, 0.0, x, lambda) == 0);
    CHECK_NEAR(largest_difference(2 * n, other, xdot), 0.0, 10 * ROUNDOFF * size);
    for (size_t a = 0; a < m; a++)
        CHECK_NEAR(shifted[a], lambda[a] - weight * (1.0 + (double)a), 10 * ROUNDOFF * size);
}

/* Along the field: mu v keeps its value off D and E its value on D.  One classical Runge-Kutta step
 * of h errs by h^5 times a constant below 100. */
static void test_first_integrals(dal_mechanics *mech, const dal_system *system, const double *x0)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    static const double node[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1, 2, 2, 1};
    const double h = 1e-3;
    double x[2 * N], slope[2 * N] = {0}, stage[2 * N], before[M], after[M], E0 = NAN, E1 = NAN;
    for (int on = 0; on < 2; on++) {
        memcpy(x, x0, 2 * n * sizeof *x);
        if (on) CHECK(dal_project(mech, 0.0, 0.0, x, NULL) == 0);
        memcpy(stage, x, sizeof stage);
        CHECK(dal_residual(mech, 0.0, 0.0, x, before) == 0 && dal_energy(mech, 0.0, x, &E0) == 0);
        double sum[2 * N] = {0};
        memset(slope, 0, sizeof slope);
        for (int k = 0; k < 4; k++) {
            for (size_t i = 0; i < 2 * n; i++) stage[i] = x[i] + node[k] * h * slope[i];
            CHECK(dal_field(mech, 0.0, stage, slope) == 0);
            for (size_t i = 0; i < 2 * n; i++) sum[i] += weight[k] * slope[i];
        }
        for (size_t i = 0; i < 2 * n; i++) x[i] += h / 6 * sum[i];
        CHECK(dal_residual(mech, 0.0, 0.0, x, after) == 0 && dal_energy(mech, 0.0, x, &E1) == 0);
        CHECK_NEAR(largest_difference(m, before, after), 0.0, 100 * pow(h, 5) + 40 * U);
        if (on) CHECK_NEAR(E1, E0, 100 * pow(h, 5) + 40 * U * (1 + fabs(E0)));
        CHECK(largest_difference(2 * n, x, x0) > 1e-5);
    }
}

/* mu -> B(q) mu: the same field, lambda = B^T lambda', on D (off D the derivative of B enters). */
static void test_mixing(dal_mechanics *mech, const dal_system *system, dal_mechanics *mixed,
                        const double *x0)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    double x[2 * N], y[2 * N], one[2 * N], two[2 * N], lambda[M], other[M], expected[M];
    memcpy(x, x0, 2 * n * sizeof *x);
    memcpy(y, x0, 2 * n * sizeof *y);
    CHECK(dal_project(mech, 0.0, 0.0, x, NULL) == 0 && dal_project(mixed, 0.0, 0.0, y, NULL) == 0);
    CHECK_NEAR(largest_difference(2 * n, x, y), 0.0, ROUNDOFF * sum_of_sizes(2 * n, x0));
    CHECK(dal_field(mech, 0.0, x, one) == 0 && dal_field(mixed, 0.0, x, two) == 0);
    const double size = 1 + sum_of_sizes(2 * n, one);
    CHECK_NEAR(largest_difference(2 * n, one, two), 0.0, 10 * ROUNDOFF * size);
    CHECK(dal_multipliers(mech, 0.0, x, lambda) == 0);
    CHECK(dal_multipliers(mixed, 0.0, x, other) == 0);
    unmix(m, x, other, expected);
    CHECK_NEAR(largest_difference(m, lambda, expected), 0.0, 10 * ROUNDOFF * size);
    CHECK(largest_difference(m, lambda, other) > 0.01 * sum_of_sizes(m, lambda));
}

/* ---- projections --------------------------------------------------------------------------- */

/* The projection leaves q, ends in D, does nothing twice, and is orthogonal in the mass metric: the
 * correction is perpendicular to what is left, |v|^2 = |v_D|^2 + distance^2. */
static void test_projection(dal_mechanics *mech, const dal_system *system, const double *x0)
{
    const size_t n = dal_system_n(system);
    double x[2 * N], again[2 * N], d[N], Md[N], Mv[N], distance = NAN, second = NAN;
    memcpy(x, x0, 2 * n * sizeof *x);
    CHECK(dal_project(mech, 0.0, 0.0, x, &distance) == 0);
    CHECK(memcmp(x, x0, n * sizeof *x) == 0);
    CHECK(residual_of(system, 0.0, x) <= DAL_RESIDUAL_BOUND(n));
    memcpy(again, x, sizeof again);
    CHECK(dal_project(mech, 0.0, 0.0, again, &second) == 0);
    const double size = sum_of_sizes(n, x0 + n);
    CHECK_NEAR(largest_difference(2 * n, x, again), 0.0, ROUNDOFF * size);
    CHECK_NEAR(second, 0.0, ROUNDOFF * size);
    for (size_t i = 0; i < n; i++) d[i] = x[n + i] - x0[n + i];
    dal__apply(n, n, mass_of(system), d, Md);
    dal__apply(n, n, mass_of(system), x0 + n, Mv);
    CHECK_NEAR(dot(n, x + n, Md), 0.0, 10 * ROUNDOFF * size * size);
    CHECK_NEAR(distance * distance, dot(n, d, Md), 10 * ROUNDOFF * size * size);
    CHECK_NEAR(dot(n, d, Mv), -distance * distance, 10 * ROUNDOFF * size * size);
    CHECK(distance > 1e-3);
}

/* D_eps: the residual vanishes at q - shift v; the correction is M^-1 mu(q)^T kappa, so M d is a
 * combination of the forms and annihilates D_q. */
static void test_deformed(dal_mechanics *mech, const dal_system *system, const double *x0)
{
    const size_t n = dal_system_n(system);
    for (int sign = -1; sign <= 1; sign += 2) {
        const double shift = 0.05 * sign;
        double x[2 * N], d[N], Md[N], tangent[2 * N], distance = NAN;
        memcpy(x, x0, 2 * n * sizeof *x);
        const size_t calls = mech->eval.calls.constraint;
        CHECK(dal_project(mech, 0.0, shift, x, &distance) == 0);
        CHECK(mech->eval.calls.constraint - calls <= 8); /* Newton, and not a slower iteration */
        CHECK(memcmp(x, x0, n * sizeof *x) == 0);
        CHECK(residual_of(system, shift, x) <= ROUNDOFF);
        for (size_t i = 0; i < n; i++) d[i] = x[n + i] - x0[n + i];
        dal__apply(n, n, mass_of(system), d, Md);
        CHECK_NEAR(distance * distance, dot(n, d, Md), ROUNDOFF * (1 + dot(n, d, Md)));
        for (unsigned seed = 1; seed < 4; seed++) {
            somewhere(n, seed, tangent);
            memcpy(tangent, x, n * sizeof *tangent);
            CHECK(dal_project(mech, 0.0, 0.0, tangent, NULL) == 0);
            CHECK_NEAR(dot(n, tangent + n, Md), 0.0, 20 * ROUNDOFF * (1 + sum_of_sizes(n, Md)));
        }
    }
}

/* Kept components are kept to the bit; the rest is a minimum: M d is a combination of the forms on
 * the free components, so it annihilates every w of D_q with w_i = 0 where i is kept. */
static void test_consistent(void)
{
    enum { SIZE = 6, FORMS = 2 };
    wide w;
    dal_system *const system = open_wide(&w, SIZE, FORMS, true, false);
    dal_mechanics *const mech = open_mechanics(system);
    const double *const mass = mass_of(system);
    for (unsigned pattern = 0; pattern < 1u << SIZE; pattern++) {
        unsigned char keep[SIZE];
        size_t kept = 0;
        double x0[2 * SIZE], x[2 * SIZE], d[SIZE], Md[SIZE], distance = 7.0;
        for (size_t i = 0; i < SIZE; i++) kept += keep[i] = (pattern >> i) & 1;
        somewhere(SIZE, pattern + 5, x0);
        memcpy(x, x0, sizeof x);
        const int status = dal_consistent(mech, 0.0, keep, x, &distance);
        if (kept > SIZE - FORMS) {
            CHECK(status == DAL_ESINGULAR && distance == 7.0 && !memcmp(x, x0, sizeof x));
            CHECK(strstr(dal_mechanics_error(mech)->text, "mu restricted to") != NULL);
            CHECK(strstr(dal_mechanics_error(mech)->text, "rank below m = 2") != NULL);
            continue;
        }
        CHECK(status == DAL_SUCCESS);
        if (status) continue;
        double scale = 0.0;
        for (size_t i = 0; i < SIZE; i++) {
            d[i] = x[SIZE + i] - x0[SIZE + i];
            scale += fabs(d[i]) + fabs(x0[SIZE + i]);
            CHECK(x[i] == x0[i] && (!keep[i] || d[i] == 0.0));
        }
        CHECK(residual_of(system, 0.0, x) <= 4.0 * SIZE * U);
        dal__apply(SIZE, SIZE, mass, d, Md);
        CHECK_NEAR(distance * distance, dot(SIZE, d, Md), 1e3 * ROUNDOFF * scale * scale);
        if (pattern == 0) {
            double plain[2 * SIZE];
            memcpy(plain, x0, sizeof plain);
            CHECK(dal_consistent(mech, 0.0, NULL, plain, NULL) == DAL_SUCCESS);
            CHECK_NEAR(largest_difference(2 * SIZE, plain, x), 0.0, ROUNDOFF * scale);
        }
        /* any other consistent velocity with the same kept components is farther away */
        for (unsigned seed = 1; seed < 4; seed++) {
            double other[2 * SIZE], e[SIZE], Me[SIZE], inner = 0.0;
            somewhere(SIZE, seed, other);
            memcpy(other, x0, SIZE * sizeof *other);
            for (size_t i = 0; i < SIZE; i++)
                if (keep[i]) other[SIZE + i] = x0[SIZE + i];
            CHECK(dal_consistent(mech, 0.0, keep, other, NULL) == DAL_SUCCESS);
            double size = 0.0;
            for (size_t i = 0; i < SIZE; i++) {
                e[i] = other[SIZE + i] - x[SIZE + i];
                size += fabs(e[i]);
            }
            dal__apply(SIZE, SIZE, mass, e, Me);
            inner = dot(SIZE, d, Me);
            CHECK_NEAR(inner, 0.0, 1e3 * ROUNDOFF * (1 + size) * (1 + scale));
        }
    }
}

/* A free part that is singular but for roundoff is refused, or the velocity found is consistent: of
 * a car with trailers, whose free parts are singular for many patterns at every q. */
static void test_consistent_or_refused(void)
{
    enum { SIZE = 6, STATES = 100 };
    dal_system *system;
    system = open_system("n_trailer");
    dal_mechanics *const mech = open_mechanics(system);
    size_t found = 0, refused = 0;
    for (unsigned pattern = 1; pattern < 1u << SIZE; pattern++)
        for (unsigned seed = 0; seed < STATES; seed++) {
            unsigned char keep[SIZE];
            double x0[2 * SIZE], x[2 * SIZE];
            for (size_t i = 0; i < SIZE; i++) keep[i] = (pattern >> i) & 1;
            somewhere(SIZE, seed * 97 + pattern, x0);
            x0[SIZE] = -0.0;
            memcpy(x, x0, sizeof x);
            const int status = dal_consistent(mech, 0.0, keep, x, NULL);
            refused += status == DAL_ESINGULAR && !memcmp(x, x0, sizeof x);
            if (status) continue;
            bool same = true;
            for (size_t i = 0; i < SIZE; i++)
                same = same && (!keep[i] || !memcmp(x + SIZE + i, x0 + SIZE + i, sizeof *x));
            found += same && residual_of(system, 0.0, x) <= 4.0 * SIZE * U;
        }
    CHECK(found + refused == ((1u << SIZE) - 1) * STATES);
    CHECK(found > STATES && refused > STATES);
}

/* ---- the equations of a step ---------------------------------------------------------------- */

/* The particle on springs, beta = 1/4, written out. */
static void test_equations_by_hand(void)
{
    dal_system *const system = open_system("particle_oscillator");
    dal_mechanics *const mech = open_mechanics(system);
    const double k[3] = {1.0, 2.0, 1.5}, beta = 0.25, h = 0.2, kappa = 0.4;
    const double x[6] = {0.5, 0.3, -0.2, 1.0, 0.7, 0.3}, w[3] = {0.9, 0.6, 0.5};
    double R1[3], R2 = NAN, K[9], B[3], muk[3];
    CHECK(dal_step_equations(mech, 0.0, beta, h, x, w, &kappa, R1, &R2, K, B, muk) == 0);
    const double yk = 0.3 + 0.75 * 0.2 * 0.7, y1 = yk + 0.25 * 0.2 * 0.6;
    const double mu[3] = {-yk, 0.0, 1.0};
    for (size_t i = 0; i < 3; i++) {
        const double q1 = x[i] + 0.15 * x[3 + i] + 0.05 * w[i];
        const double force = k[i] * (0.75 * q1 + 0.25 * x[i]);
        CHECK_NEAR(R1[i], w[i] - x[3 + i] + h * force - mu[i] * kappa, 8 * U);
        CHECK_NEAR(muk[i], mu[i], 2 * U);
        for (size_t j = 0; j < 3; j++)
            CHECK_NEAR(K[3 * i + j], i == j ? 1 + 0.04 * 0.1875 * k[i] : 0.0, 2 * U);
    }
    CHECK_NEAR(R2, w[2] - y1 * w[0], 4 * U);
    CHECK_NEAR(B[0], -y1, 2 * U);
    CHECK_NEAR(B[1], -0.05 * w[0], U);
    CHECK(B[2] == 1.0);
}

/* K = dR1/dw, B = dR2/dw, -mu_k^T = dR1/dkappa by central differences with d = 2^-17: they err by
 * d^2 times third derivatives and u/d times the function, 1e-9 together. */
static void test_jacobian(dal_mechanics *mech, const dal_system *system, const double *x)
{
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    const double betas[] = {0.0, 0.3, 0.5, 1.0}, d = 0x1p-17;
    for (size_t b = 0; b < 4; b++) {
        const double h = b % 2 ? -0.2 : 0.3;
        double w[2 * N], kappa[M] = {0.3, -0.2}, K[N * N], B[M * N], muk[M * N];
        double up1[N], down1[N], up2[M], down2[M];
        somewhere(n, 77, w);
        CHECK(dal_step_equations(mech, 0.0, betas[b], h, x, w, kappa, NULL, NULL, K, B, muk) == 0);
        const double tolerance = 1e-9 * (1 + sum_of_sizes(n * n, K));
        for (size_t j = 0; j < n + m; j++) {
            double *const unknown = j < n ? w + j : kappa + (j - n), centre = *unknown;
            *unknown = centre + d;
            CHECK(dal_step_equations(mech, 0.0, betas[b], h, x, w, kappa, up1, up2, NULL, NULL,
                                     NULL)
                  == 0);
            *unknown = centre - d;
            CHECK(dal_step_equations(mech, 0.0, betas[b], h, x, w, kappa, down1, down2, NULL, NULL,
                                     NULL)
                  == 0);
            *unknown = centre;
            for (size_t i = 0; i < n; i++)
                CHECK_NEAR((up1[i] - down1[i]) / (2 * d),
                           j < n ? K[i * n + j] : -muk[(j - n) * n + i], tolerance);
            for (size_t a = 0; a < m; a++)
                CHECK_NEAR((up2[a] - down2[a]) / (2 * d), j < n ? B[a * n + j] : 0.0, tolerance);
        }
    }
}

/* ---- rows -------------------------------------------------------------------------------- */

static void test_trajectory(dal_mechanics *mech, const dal_system *system)
{
    enum { ROWS = 5 };
    const size_t n = dal_system_n(system), m = dal_system_m(system);
    double x[ROWS * 2 * N], E[ROWS], lambda[ROWS * M], residual[ROWS * M], relative[ROWS];
    size_t done = 99;
    for (unsigned k = 0; k < ROWS; k++) somewhere(n, 31 + k, x + k * 2 * n);
    CHECK(dal_trajectory(mech, 1.0, 0.1, 0.07, ROWS, x, NULL, E, lambda, residual, relative,
                         &done) == 0);
    CHECK(done == ROWS);
    for (size_t k = 0; k < ROWS; k++) {
        const double *const row = x + k * 2 * n;
        double one = NAN, many[M];
        CHECK(dal_energy(mech, 0.0, row, &one) == 0 && one == E[k]);
        CHECK(dal_multipliers(mech, 0.0, row, many) == 0);
        CHECK(memcmp(many, lambda + k * m, m * sizeof *many) == 0);
        CHECK(dal_residual(mech, 0.0, 0.07, row, many) == 0);
        CHECK(memcmp(many, residual + k * m, m * sizeof *many) == 0);
        CHECK(dal_relative_residual(mech, 0.0, 0.07, row, &one) == 0 && one == relative[k]);
        CHECK_NEAR(one, residual_of(system, 0.07, row), ROUNDOFF * one);
    }
    CHECK(dal_trajectory(mech, 0, 0.1, 0, ROWS, x, NULL, NULL, NULL, NULL, NULL,
                         NULL) == DAL_SUCCESS);
    CHECK(dal_trajectory(mech, 0, 0.1, 0, 0, NULL, NULL, E, NULL, NULL, NULL,
                         &done) == 0 && done == 0);
    CHECK(dal_trajectory(mech, 0, 0.1, 0, 1, NULL, NULL, E, NULL, NULL, NULL, &done) == DAL_EINVAL);
    CHECK(strcmp(dal_mechanics_error(mech)->text, "x is NULL") == 0);
#define NAMED(call, name)                                                       \
    CHECK((call) == DAL_EINVAL);                                                \
    CHECK(strcmp(dal_mechanics_error(mech)->text, name " is NULL") == 0)
    NAMED(dal_energy(mech, 0.0, x, NULL), "E");
    NAMED(dal_energy(mech, 0.0, NULL, E), "x");
    NAMED(dal_residual(mech, 0.0, 0.0, x, NULL), "residual");
    NAMED(dal_relative_residual(mech, 0.0, 0.0, x, NULL), "worst");
    NAMED(dal_gram(mech, 0.0, x, NULL), "C");
    NAMED(dal_multipliers(mech, 0.0, x, NULL), "lambda");
    NAMED(dal_acceleration(mech, 0.0, x, NULL), "vdot");
    NAMED(dal_field(mech, 0.0, x, NULL), "xdot");
    NAMED(dal_project(mech, 0.0, 0.0, NULL, NULL), "x");
    NAMED(dal_consistent(mech, 0.0, NULL, NULL, NULL), "x");
    NAMED(dal_step_equations(mech, 0.0, 0.5, 0.1, x, NULL, x, NULL, NULL, NULL, NULL, NULL), "w");
#undef NAMED
    CHECK(dal_step_equations(mech, 0.0, 1.5, 0.1, x, x, x, NULL, NULL, NULL, NULL, NULL)
          == DAL_EINVAL);
    CHECK(strstr(dal_mechanics_error(mech)->text, "beta = 1.5") != NULL);
    x[3 * 2 * n + 1] = NAN;
    E[3] = relative[3] = 7.0;
    CHECK(dal_trajectory(mech, 0, 0.1, 0, ROWS, x, NULL, E, NULL, NULL, NULL, &done) == DAL_EINVAL);
    CHECK(done == 3 && E[3] == 7.0 && strstr(dal_mechanics_error(mech)->text, "x[1]") != NULL);
    CHECK(dal_trajectory(mech, 0, 0.1, 0, ROWS, x, NULL, NULL, NULL, NULL, relative, &done)
          == DAL_EINVAL);
    CHECK(done == 3 && relative[3] == 7.0);
}

/* ---- errors ------------------------------------------------------------------------------ */

/* Two forms that coincide where q0 = 0; outside its domain for q0 > 10, stops for q0 < -10. */
static int degenerate(double t, const double *q, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    const double mu[6] = {1.0, 2.0, 0.0, 1.0, 2.0, q[0]};
    if (phi_v) memcpy(phi_v, mu, sizeof mu);
    if (phi_q) {
        memset(phi_q, 0, 6 * sizeof *phi_q);
        phi_q[3] = v[2];
    }
    return q[0] > 10.0 ? 1 : q[0] < -10.0 ? -1 : 0;
}

static void test_errors(void)
{
    const double mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const dal_system_def def = {.n = 3, .m = 2, .mass = mass, .constraint = degenerate};
    dal_mechanics *mech = NULL;
    dal_error error;
    dal_system *const system = new_system(&def);
    CHECK(dal_mechanics_new(NULL, system, &error) == DAL_EINVAL);
    CHECK(dal_mechanics_new(&mech, NULL, &error) == DAL_EINVAL);
    CHECK(strstr(error.text, "system is NULL") != NULL);
    mech = open_mechanics(system);
    CHECK(dal_mechanics_error(mech)->text[0] == '\0');
    double x[6] = {0, 0, 0, 1, 2, 3}, out[6] = {7, 7, 7, 7, 7, 7}, one = 7.0;
    const double before[6] = {0, 0, 0, 1, 2, 3};
    CHECK(dal_multipliers(mech, 0, x, out) == DAL_ESINGULAR && out[0] == 7.0);
    CHECK(strstr(dal_mechanics_error(mech)->text, "singular") != NULL);
    CHECK(dal_acceleration(mech, 0, x, out) == DAL_ESINGULAR && out[0] == 7.0);
    CHECK(dal_field(mech, 0, x, out) == DAL_ESINGULAR && out[0] == 7.0);
    CHECK(dal_project(mech, 0.0, 0.0, x, &one) == DAL_ESINGULAR && one == 7.0);
    CHECK(memcmp(x, before, sizeof x) == 0);
    CHECK(dal_energy(mech, 0.0, x, &one) == DAL_SUCCESS && one == 7.0); /* (1 + 4 + 9)/2 */
    x[0] = 1e-3;
    CHECK(dal_multipliers(mech, 0, x, out) == DAL_SUCCESS);
    x[0] = 11.0;
    CHECK(dal_residual(mech, 0.0, 0, x, out) == DAL_EDOMAIN);
    CHECK(dal_project(mech, 0.0, 0, x, NULL) == DAL_EDOMAIN);
    x[0] = -11.0;
    CHECK(dal_gram(mech, 0.0, x, out) == DAL_EUSER);
    CHECK(strstr(dal_mechanics_error(mech)->text, "returned -1") != NULL);
    x[0] = NAN;
    CHECK(dal_energy(mech, 0.0, x, &one) == DAL_EINVAL
          && dal_gram(mech, 0.0, x, out) == DAL_EINVAL);
    x[0] = 1.0;
    CHECK(dal_project(mech, 0.0, INFINITY, x, NULL) == DAL_EINVAL);
    CHECK(strstr(dal_mechanics_error(mech)->text, "shift") != NULL);
    CHECK(dal_residual(mech, 0.0, NAN, x, out) == DAL_EINVAL);
    CHECK(dal_energy(NULL, 0.0, x, &one) == DAL_EINVAL
          && dal_energy(mech, 0.0, NULL, &one) == DAL_EINVAL);
    CHECK(dal_energy(mech, 0.0, x, NULL) == DAL_EINVAL
          && dal_field(mech, 0, x, NULL) == DAL_EINVAL);
    CHECK(dal_step_equations(mech, 0.0, 0.5, NAN, x, x + 3, out, out, NULL, NULL, NULL, NULL)
          == DAL_EINVAL);
    CHECK(dal_step_equations(mech, 0.0, 0.5, 0.1, x, x + 3, NULL, out, NULL, NULL, NULL, NULL)
          == DAL_EINVAL);
}

/* Without constraints everything still has its meaning. */
static void test_no_constraint(void)
{
    wide w;
    dal_system *const system = open_wide(&w, 3, 0, true, true);
    dal_mechanics *const mech = open_mechanics(system);
    double x[6], vdot[3], force[3], balance[3], unused[1] = {7.0}, distance = NAN, relative = NAN;
    memcpy(x, w.state, sizeof x);
    CHECK(dal_project(mech, 0.0, 0.0, x, &distance) == 0 && distance == 0.0);
    CHECK(dal_project(mech, 0.0, 0.3, x, &distance) == 0 && memcmp(x, w.state, sizeof x) == 0);
    CHECK(dal_multipliers(mech, 0.0, x, unused) == 0 && unused[0] == 7.0);
    CHECK(dal_relative_residual(mech, 0.0, 0.0, x, &relative) == 0 && relative == 0.0);
    CHECK(dal_acceleration(mech, 0.0, x, vdot) == 0);
    wide_potential(0.0, x, NULL, force, NULL, &w);
    dal__apply(3, 3, w.mass, vdot, balance);
    for (size_t i = 0; i < 3; i++)
        CHECK_NEAR(balance[i], -force[i], ROUNDOFF * sum_of_sizes(3, force));
    test_jacobian(mech, system, x);
    test_definitions(mech, system, x);
}

static void test_system(dal_system *system, unsigned seed)
{
    double x[2 * N];
    dal_mechanics *const mech = open_mechanics(system);
    somewhere(dal_system_n(system), seed, x);
    test_definitions(mech, system, x);
    test_ode(mech, system, x);
    test_perturbed(mech, system, x);
    test_first_integrals(mech, system, x);
    test_projection(mech, system, x);
    test_deformed(mech, system, x);
    test_jacobian(mech, system, x);
    test_trajectory(mech, system);
    if (dal_system_m(system) <= 2 && dal_system_n(system) <= 8) {
        dal_system *const mixed = open_mixed(system);
        dal_mechanics *const other = open_mechanics(mixed);
        test_mixing(mech, system, other, x);
        test_jacobian(other, mixed, x);
        release(mixed);
    }
}

/* ---- the edges of what a residual can say --------------------------------------------------- */

/* phi = mu v + a, mu and a constant. */
typedef struct rows {
    size_t n, m;
    double mu[9], a[3];
} rows;

static int constant_forms(double t, const double *q, const double *v, double *phi, double *phi_v,
                          double *phi_q, double *phi_t, void *ctx)
{
    const rows *const r = ctx;
    (void)q;
    for (size_t a = 0; phi && a < r->m; a++) phi[a] = dot(r->n, r->mu + a * r->n, v) + r->a[a];
    if (phi_v) memcpy(phi_v, r->mu, r->m * r->n * sizeof *phi_v);
    if (phi_q) memset(phi_q, 0, r->m * r->n * sizeof *phi_q);
    return 0;
}

static dal_system *open_rows(rows *r, const double *mass, dal_constraint_kind kind)
{
    const dal_system_def def = {.n = r->n, .m = r->m, .mass = mass, .constraint = constant_forms,
                                .kind = kind, .ctx = r};
    return new_system(&def);
}

/* L = (1 + x^2) v_x^2/2 + 2 v_y^2. */
static int stretched(double t, const double *q, const double *v, double *L, double *L_q,
                     double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                     void *ctx)
{
    const double inertia = 1.0 + q[0] * q[0];
    (void)L_qq, (void)L_vq, (void)ctx;
    if (L) *L = 0.5 * inertia * v[0] * v[0] + 2.0 * v[1] * v[1];
    if (L_q) L_q[0] = q[0] * v[0] * v[0], L_q[1] = 0.0;
    if (L_v) L_v[0] = inertia * v[0], L_v[1] = 4.0 * v[1];
    if (L_vv) L_vv[0] = inertia, L_vv[1] = L_vv[2] = 0.0, L_vv[3] = 4.0;
    return 0;
}

/* As residual.h has it, with the metric where D_eps is looked for. */
static void test_residual_of_affine(void)
{
    rows belt = {2, 1, {2.0, -3.0}, {5.0}};
    const dal_system_def def = {.n = 2, .m = 1, .lagrangian = stretched, .kind = DAL_AFFINE,
                                .missing = DAL_MISSING_L_QQ | DAL_MISSING_L_VQ,
                                .constraint = constant_forms, .ctx = &belt};
    const double x[4] = {1.7, 0.4, 0.6, -1.1};
    dal_system *const system = new_system(&def);
    dal_mechanics *const mech = open_mechanics(system);
    for (double shift = -2.0; shift <= 2.0; shift += 1.0) {
        const double at = x[0] - shift * x[2], d = 1.0 / sqrt(1.0 + at * at);
        const double speed = fmax(fabs(x[2]) / d, fabs(x[3]) / 0.5);
        double relative = NAN;
        CHECK(dal_relative_residual(mech, 0.0, shift, x, &relative) == 0);
        CHECK_NEAR(relative, (2.0 * x[2] - 3.0 * x[3] + 5.0)
                                 / ((2.0 * d + 3.0 * 0.5) * speed + 5.0), 8 * U);
    }

    /* to begin with, 1e-8 of the terms: those of the belt count */
    rows unit = {2, 1, {1.0, 0.0}, {-1.0}};
    const double mass[4] = {1.0, 0.0, 0.0, 1.0};
    const double near[4] = {0.0, 0.0, 1.0 + 1.5e-8, 0.0}, off[4] = {0.0, 0.0, 1.0 + 3e-8, 0.0};
    dal_system *const simple = open_rows(&unit, mass, DAL_AFFINE);
    dal_stepper *const stepper = start_named(simple, "midpoint", 0.1, near);
    CHECK(dal_stepper_start(stepper, 0.0, 0.1, off, DAL_CHECK, DAL_INITIAL_NONE) == DAL_EOFFD);
}

/* A velocity across D has no part in it but roundoff, of which each projection leaves its own. */
static void test_across(void)
{
    unsigned seed = 9;
    for (int trial = 0; trial < 300; trial++) {
        rows r = {.n = 3, .m = 1 + (size_t)trial % 2};
        double mass[9] = {0}, x[6] = {0}, distance = 0.0, size = 0.0;
        for (size_t k = 0; k < 9; k++) r.mu[k] = next_number(&seed);
        for (size_t i = 0; i < 3; i++) mass[4 * i] = 1.5 + next_number(&seed);
        for (size_t a = 0; a < r.m; a++)
            for (size_t i = 0; i < 3; i++)
                x[3 + i] += (1.0 + (double)a) * r.mu[3 * a + i] / mass[4 * i];
        for (size_t i = 0; i < 3; i++) size += mass[4 * i] * x[3 + i] * x[3 + i];
        dal_system *const system = open_rows(&r, mass, DAL_LINEAR);
        dal_mechanics *const mech = open_mechanics(system);
        CHECK(dal_project(mech, 0.0, 0.0, x, &distance) == 0);
        CHECK_NEAR(sum_of_sizes(3, x + 3), 0.0, 1e-12 * sqrt(size)); /* C may have a condition */
        CHECK_NEAR(distance, sqrt(size), 1e-12 * sqrt(size));
        if (r.m == 2) { /* with one component kept at 0, D is 0 */
            const unsigned char keep[3] = {1, 0, 0};
            const double v[3] = {0.0, next_number(&seed), next_number(&seed)};
            memcpy(x + 3, v, sizeof v);
            CHECK(dal_consistent(mech, 0.0, keep, x, &distance) == 0);
            CHECK_NEAR(sum_of_sizes(3, x + 3), 0.0, 1e-12);
        }
        release(system);
    }
    /* a small part in D stays; large numbers have a distance; what overflows is not zero */
    rows wall = {2, 1, {1.0, 0.0}, {0.0}};
    const double mass[4] = {1.0, 0.0, 0.0, 1.0};
    dal_system *const system = open_rows(&wall, mass, DAL_LINEAR);
    dal_mechanics *const mech = open_mechanics(system);
    double x[4] = {0.0, 0.0, 1.0, 1e-17}, large[4] = {0.0, 0.0, -1e200, 1.0}, d = 0.0;
    CHECK(dal_project(mech, 0.0, 0.0, x, NULL) == 0 && x[2] == 0.0 && x[3] == 1e-17);
    CHECK(dal_project(mech, 0.0, 0.0, large, &d) == 0 && d == 1e200 && large[3] == 1.0);
    wall.mu[0] = 1e10;
    const double fast[4] = {0.0, 0.0, 1e300, 0.0};
    CHECK(dal_relative_residual(mech, 0.0, 0.0, fast, &d) == DAL_EDOMAIN && d == 1e200);
}

/* How large the form of a coordinate is that is kept does not matter. */
static void test_kept_units(void)
{
    rows r = {2, 1, {1e20, 1.0}, {0.0}};
    const double mass[4] = {1.0, 0.0, 0.0, 1.0};
    const unsigned char keep[2] = {1, 0};
    double x[4] = {0.0, 0.0, 1e-20, 0.0};
    dal_system *const system = open_rows(&r, mass, DAL_LINEAR);
    dal_mechanics *const mech = open_mechanics(system);
    CHECK(dal_consistent(mech, 0.0, keep, x, NULL) == 0);
    CHECK_NEAR(x[3], -1.0, 4 * U);
}

/* Where the product of the sizes of mu and v overflows, and the residual does not. */
static void test_residual_of_large_numbers(void)
{
    dal_system *const particle = open_system("particle");
    dal_mechanics *const mech = open_mechanics(particle);
    const double sideways[] = {1e-100, 1e100, 1e107};
    for (size_t i = 0; i < 3; i++) {
        const double x[6] = {0.0, 1e200, 0.0, sideways[i], 1e200, 0.0};
        double relative = NAN;
        CHECK(dal_relative_residual(mech, 0.0, 0.0, x, &relative) == DAL_SUCCESS);
        CHECK_NEAR(relative, sideways[i] / 1e200, 1e-14 * sideways[i] / 1e200);
    }
    double relative = NAN;
    const double infinite[6] = {0.0, 1e200, 0.0, 1e150, 1e200, 0.0};
    CHECK(dal_relative_residual(mech, 0.0, 0.0, infinite, &relative) == DAL_EDOMAIN);
    CHECK(isnan(relative));
    const double fast[6] = {0.0, 1e10, 0.0, 1e305, 1e305, 1e305}; /* C does not see v */
    double C = (double)NAN;
    CHECK(dal_gram(mech, 0.0, fast, &C) == DAL_SUCCESS);
    CHECK_NEAR(C, 1e20, 1e6);
}

/* The equations of a step want M where it ends too; that is not the metric where it began. */
static void test_metric_stands(void)
{
    dal_system *const system = open_system("genmass");
    dal_mechanics *const mech = open_mechanics(system);
    const size_t n = dal_system_n(system);
    const double kappa[M] = {0.0};
    double x[2 * N], y[2 * N], here[N * N], K[N * N];
    somewhere(n, 1, x);
    somewhere(n, 2, y);
    CHECK(dal_metric(mech, 0.0, x, here) == 0);
    CHECK(dal_step_equations(mech, 0.0, 0.5, 0.1, x, y, kappa, NULL, NULL, K, NULL, NULL) == 0);
    CHECK(dal__renew_metric(mech, 0.0, x, x + n) == 0);
    CHECK(memcmp(mech->metric.M, here, n * n * sizeof *here) == 0);
    CHECK(memcmp(mech->L_vv, here, n * n * sizeof *here) != 0);
}

/* mu = (x, 0), whose pivot is x^2.  A step that takes x through 0, or in few steps would, raises a
 * doubt, unless the pivot is large at both ends: then mu may have turned as that of a wheel. */
static int through_zero(double t, const double *q, const double *v, double *phi, double *phi_v,
                        double *phi_q, double *phi_t, void *ctx)
{
    if (phi) phi[0] = q[0] * v[0];
    if (phi_v) memcpy(phi_v, (double[]){q[0], 0.0}, 2 * sizeof *phi_v);
    if (phi_q) memcpy(phi_q, (double[]){v[0], 0.0}, 2 * sizeof *phi_q);
    return 0;
}

static void test_rank_on_the_way(void)
{
    static const struct {
        double to;
        size_t doubts;
    } steps[] = {{-0.5, 1}, {0.4, 1}, {0.6, 0}, {-0.9, 0}};
    const double mass[4] = {1.0, 0.0, 0.0, 1.0};
    const dal_system_def def = {.n = 2, .m = 1, .mass = mass, .constraint = through_zero};
    dal_mechanics *const mech = open_mechanics(new_system(&def));
    for (size_t k = 0; k < DAL_LENGTH(steps); k++) {
        const double x[4] = {1.0, 0.0, steps[k].to - 1.0, 0.3};
        dal__rank rank = {0};
        arena memory = {0};
        dal__rank_reserve(&rank, 2, 1, &memory);
        need(dal__allocate(&memory, NULL), "rank", "memory");
        CHECK(dal__forms_at(mech, 0.0, 0.0, x, false) == 0);
        dal__rank_find(&rank, mech);
        dal__rank_start(&rank, 1);
        CHECK(dal__rank_pass(&rank, mech, 0.0, 0.0, 1.0, 2, x) == 0);
        check_true(rank.doubts == steps[k].doubts, "doubts", "step", (int)k);
        CHECK_NEAR(rank.least, steps[k].to < 0.0 ? 0.0 : steps[k].to * steps[k].to, 1e-15);
        dal__release(&memory);
    }
}

int main(void)
{
    test_particle();
    test_residual_of_large_numbers();
    for (size_t s = 0; s < SYSTEMS; s++) {
        dal_system *const system = open_system(all_systems[s]);
        test_system(system, 1);
        test_system(system, 2);
        release(system);
    }
    wide w;
    dal_system *const large = open_wide(&w, 12, 6, true, true);
    test_system(large, 1);
    test_consistent();
    test_consistent_or_refused();
    test_residual_of_affine();
    test_across();
    test_kept_units();
    test_equations_by_hand();
    test_errors();
    test_no_constraint();
    test_metric_stands();
    test_rank_on_the_way();
    return check_done();
}
