/* dal_system_check: right systems pass, and each way to be wrong is found and named. */
#include "check.h"
#include "fixtures.h"

#include <gsl/gsl_errno.h>

#include <stdlib.h>

/* ---- a system that can be spoiled ------------------------------------------------------- */

typedef enum wrong {
    NOTHING,
    SIGN_V_Q, SIGN_V_QQ, SIGN_PHI_Q,                  /* of one entry */
    NO_V, NO_V_Q, NO_V_QQ, NO_PHI, NO_PHI_V, NO_PHI_Q, /* is never written */
    OFFSET,                                           /* a large constant in V: not wrong */
    AFFINE, VELOCITY,                                 /* phi has a constant, mu depends on v */
    UNITS, VANISHING, DOUBLE, NEARLY_DOUBLE           /* of the second form; phi is not written */
} wrong;

/* generic4 with one thing wrong, which may be a single call. */
typedef struct spoiled {
    wrong wrong;
    size_t entry;            /* whose sign is wrong */
    int call, returned;      /* the call-th call, from 1 on, returns this */
    double written;          /* and writes this to all outputs */
    int calls;
} spoiled;

static void fill(size_t count, double *x, double value)
{
    for (size_t i = 0; x && i < count; i++) x[i] = value;
}

static int potential(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    spoiled *const s = ctx;
    if (++s->calls == s->call) {
        fill(1, V, s->written);
        fill(4, V_q, s->written);
        fill(16, V_qq, s->written);
        return s->returned;
    }
    if (s->wrong == NO_V) V = NULL;
    if (s->wrong == NO_V_Q) V_q = NULL;
    if (s->wrong == NO_V_QQ) V_qq = NULL;
    generic4_potential(t, q, V, V_q, V_qq, NULL);
    if (V && s->wrong == OFFSET) *V += 1e8;
    if (V_q && s->wrong == SIGN_V_Q) V_q[s->entry] = -V_q[s->entry];
    if (V_qq && s->wrong == SIGN_V_QQ) V_qq[s->entry] = -V_qq[s->entry];
    return 0;
}

/* second <- unit (share second + copies first), with first the row before it. */
static void combine(double *second, double unit, double share, double copies)
{
    for (size_t i = 0; second && i < 4; i++)
        second[i] = unit * (share * second[i] + copies * (second - 4)[i]);
}

static int constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    spoiled *const s = ctx;
    if (++s->calls == s->call) {
        fill(2, phi, s->written);
        fill(8, phi_v, s->written);
        fill(8, phi_q, s->written);
        return s->returned;
    }
    if (s->wrong == NO_PHI || s->wrong >= UNITS) phi = NULL;
    if (s->wrong == NO_PHI_V) phi_v = NULL;
    if (s->wrong == NO_PHI_Q) phi_q = NULL;
    generic4_constraint(t, q, v, phi, phi_v, phi_q, NULL, NULL);
    if (phi && s->wrong == AFFINE) phi[1] += 0.25;
    if (phi_v && s->wrong == VELOCITY) phi_v[6] += 1e-3 * v[1];
    if (phi_q && s->wrong == SIGN_PHI_Q) phi_q[s->entry] = -phi_q[s->entry];
    if (s->wrong >= UNITS) {
        const double unit = s->wrong == UNITS ? 1e-30 : s->wrong == VANISHING ? 0.0 : 1.0;
        const double share = s->wrong == DOUBLE ? 0.0 : s->wrong == NEARLY_DOUBLE ? 1e-9 : 1.0;
        const double copies = s->wrong == DOUBLE || s->wrong == NEARLY_DOUBLE ? 3.0 : 0.0;
        combine(phi_v ? phi_v + 4 : NULL, unit, share, copies);
        combine(phi_q ? phi_q + 4 : NULL, unit, share, copies);
    }
    return 0;
}

static int examine_def(const dal_system_def *def, const double *x, dal_check *report,
                       dal_error *error)
{
    memset(report, 0x7f, sizeof *report);
    return dal_system_check(new_system(def), 0.0, x, report, error);
}

static int examine(spoiled *s, unsigned missing, dal_check *report, dal_error *error)
{
    double x[8];
    generic4_state(x);
    const dal_system_def def = {.n = 4, .m = 2, .mass = generic4_mass, .potential = potential,
                                .constraint = constraint, .missing = missing, .ctx = s};
    return examine_def(&def, x, report, error);
}

static bool says(const char *text, const char *part) { return strstr(text, part) != NULL; }

static bool finds(const dal_check *report, const char *words)
{
    return says(report->finding.text, words);
}

/* ---- what is right ---------------------------------------------------------------------- */

/* Each distribution is non-integrable everywhere: mu wedge d mu of the single forms has no zero,
 * and [X, Y] of the wheels is across D (curvature below; that of a disc is its radius, 0.05).
 *
 * Differences: d = 2^-11 for |q| < 1 leaves 1.5 u 2^11 = 3e-13 of roundoff and d^4/30 = 2e-15 of
 * the fifth derivative, both times the size of v, at most 10; the margin is ten times. */
static void test_builtins(void)
{
    for (size_t i = 0; i < dal_builtin_count(); i++) {
        double x[64];
        dal_check report;
        dal_error error;
        dal_system *const system = open_system(dal_builtin_name(i));
        const size_t n = dal_system_n(system);
        CHECK(2 * n <= 64 && dal_system_state(system, x) == 0);
        CHECK(dal_system_check(system, 0.0, x, &report, &error) == 0);
        if (!report.passed) fprintf(stderr, "%s: %s\n", dal_builtin_name(i), report.finding.text);
        CHECK(report.passed && error.status == 0 && error.text[0] == '\0');
        CHECK(!report.integrable);
        if (dal_system_kind(system) == DAL_LINEAR)
            CHECK(report.curvature > 0.04 && finds(&report, "not integrable"));
        else CHECK(isnan(report.curvature) && finds(&report, "affine in v"));
        CHECK(report.rank == dal_system_m(system));
        CHECK(report.phi_q.checked && report.phi_q.error < 3e-12 * 10);
        CHECK(report.L_q.error < 3e-12 * 10 && report.L_v.error < 3e-12 * 10);
        CHECK(report.L_qq.error < 3e-12 * 10 && report.L_vq.error < 3e-12 * 10);
        CHECK(report.L_vv.error < 3e-12 * 10);
        CHECK(report.L_vq.checked == !mass_of(system));
        CHECK(report.V_q.error < 3e-12 * 10 && report.V_qq.error < 3e-12 * 10); /* |V| <= 10 */
        CHECK(report.V_q.checked == report.V_qq.checked);
        CHECK(report.linearity == 0.0 && report.residual <= 4 * (double)n * DAL_ROUNDOFF);
        release(system);
    }
}

static void examine_builtin(const char *name, dal_check *report)
{
    double x[64];
    dal_system *const system = open_system(name);
    CHECK(dal_system_state(system, x) == 0);
    CHECK(dal_system_check(system, 0.0, x, report, NULL) == 0);
}

/* Curvature, condition and eigenvalues by hand; a few roundings of numbers of order 1. */
static void test_numbers(void)
{
    const double tolerance = 32 * DBL_EPSILON;
    dal_check report;

    /* X = (1, 0, y)/s, Y = (0, 1, 0): mu [X, Y] = -1/s and |mu| = s with s^2 = 1 + y^2, y = 0.3. */
    examine_builtin("particle", &report);
    CHECK_NEAR(report.curvature, 1 / 1.09, tolerance);
    CHECK_NEAR(report.condition, 1.0, tolerance);
    CHECK_NEAR(report.mass_min, 1.0, tolerance);

    /* X = (c, s, 0), Y along theta: mu [X, Y] = 1 and |mu| = 1.  M = diag(2, 2, 3/4), of which
     * theta lies in D. */
    examine_builtin("knife_edge", &report);
    CHECK_NEAR(report.curvature, 1.0, tolerance);
    CHECK_NEAR(report.kernel_min, 0.75, tolerance);

    /* X = (R c, R s, 1, 0)/sqrt(1 + R^2), Y along phi: [X, Y] = R (s, -c, 0, 0)/sqrt(1 + R^2),
     * which is orthogonal to D.  M = diag(m, m, I, J) = diag(1.2, 1.2, 0.5, 0.3), R = 0.7.
     * C = 1/m + R^2/I u u^T with |u| = 1, so its condition is 1 + m R^2/I. */
    examine_builtin("disk", &report);
    CHECK_NEAR(report.curvature, 0.7 / sqrt(1.49), tolerance);
    CHECK_NEAR(report.condition, sqrt(1 + 1.2 * 0.49 / 0.5), tolerance);
    CHECK_NEAR(report.mass_min, 0.3, tolerance);
    CHECK_NEAR(report.kernel_min, 0.3, tolerance);
}

/* mu = ctx[3], constant. */
static int constant_forms(double t, const double *q, const double *v, double *phi, double *phi_v,
                          double *phi_q, double *phi_t, void *ctx)
{
    if (phi_v) memcpy(phi_v, ctx, 3 * sizeof *phi_v);
    fill(3, phi_q, 0.0);
    return 0;
}

/* M = [[2, 1, 0], [1, 2, 0], [0, 0, 5]] has the eigenvalues 1, 3, 5 with (1, -1, 0), (1, 1, 0),
 * e_3.  With mu along (1, -1, 0) the smallest on ker mu is 3. */
static void test_eigenvalues(void)
{
    const double mass[9] = {2, 1, 0, 1, 2, 0, 0, 0, 5}, x[6] = {0, 0, 0, 1, 1, 1};
    double mu[3] = {2, -2, 0};
    const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = constant_forms,
                                .ctx = mu};
    dal_check report;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && report.passed);
    CHECK_NEAR(report.mass_min, 1.0, 32 * DBL_EPSILON);
    CHECK_NEAR(report.kernel_min, 3.0, 32 * DBL_EPSILON);
    CHECK(report.integrable && report.curvature == 0.0);
}

static void test_generic(void)
{
    spoiled nothing = {.wrong = NOTHING};
    dal_check report, again;
    CHECK(examine(&nothing, 0, &report, NULL) == 0 && report.passed && !report.integrable);
    CHECK(report.V_q.checked && report.V_qq.checked && report.phi_q.checked);

    /* The condition is the root of that of C, a full 2 x 2 matrix. */
    double x[8], C[4];
    dal_mechanics *const mechanics = open_mechanics(open_system("generic4"));
    generic4_state(x);
    CHECK(dal_gram(mechanics, 0.0, x, C) == 0);
    const double mean = (C[0] + C[3]) / 2, radius = hypot((C[0] - C[3]) / 2, C[1]);
    CHECK_NEAR(report.condition, sqrt((mean + radius) / (mean - radius)), 64 * DBL_EPSILON);

    /* phi is not asked for elsewhere: a callback that ignores it is right. */
    spoiled silent = {.wrong = NO_PHI};
    CHECK(examine(&silent, 0, &again, NULL) == 0 && again.passed);

    /* The unit of a constraint does not matter, but to the condition. */
    spoiled units = {.wrong = UNITS};
    CHECK(examine(&units, 0, &again, NULL) == 0 && again.passed && again.rank == 2);
    CHECK_NEAR(again.curvature, report.curvature, 64 * DBL_EPSILON * report.curvature);
    CHECK(again.condition > 1e29);

    /* A large constant costs the differences of V their last digits, which is not a mistake. */
    spoiled offset = {.wrong = OFFSET};
    CHECK(examine(&offset, 0, &again, NULL) == 0 && again.passed);
    CHECK(examine(&offset, DAL_MISSING_V_Q, &again, NULL) == 0 && again.passed);
}

/* What is not given is not compared; what it replaces is used. */
static void test_missing(void)
{
    spoiled nothing = {.wrong = NOTHING};
    for (unsigned missing = 0; missing < 8; missing++) {
        dal_check report;
        CHECK(examine(&nothing, missing, &report, NULL) == 0 && report.passed);
        CHECK(report.V_q.checked == !(missing & DAL_MISSING_V_Q));
        CHECK(report.V_qq.checked == !(missing & DAL_MISSING_V_QQ));
        CHECK(report.phi_q.checked == !(missing & DAL_MISSING_PHI_Q));
        CHECK(!report.integrable);
    }
}

static void test_no_constraints(void)
{
    const double mass[4] = {2, 0, 0, 3}, x[4] = {1, 2, 3, 4};
    const dal_system_def def = {.n = 2, .mass = mass};
    dal_check report;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && report.passed);
    CHECK(report.rank == 0 && report.residual == 0.0 && report.curvature == 0.0);
    CHECK_NEAR(report.mass_min, 2.0, 8 * DBL_EPSILON);
    CHECK(report.kernel_min == report.mass_min && !report.V_q.checked && !report.phi_q.checked);
    CHECK(finds(&report, "no constraints") && !finds(&report, "holonomic"));
}

/* ---- what is wrong ---------------------------------------------------------------------- */

/* A sign flipped in any entry is found there.  given and expected are opposite but for the error of
 * the differences, 3e-13 of values of order 1. */
static void test_signs(void)
{
    static const struct {
        wrong wrong;
        size_t entries;
        const char *name;
    } arrays[] = {{SIGN_V_Q, 4, "V_q["}, {SIGN_V_QQ, 16, "V_qq["}, {SIGN_PHI_Q, 8, "phi_q["}};
    for (size_t i = 0; i < 3; i++)
        for (size_t entry = 0; entry < arrays[i].entries; entry++) {
            spoiled s = {.wrong = arrays[i].wrong, .entry = entry};
            dal_check report;
            CHECK(examine(&s, 0, &report, NULL) == 0);
            const dal_difference *const d = i == 0 ? &report.V_q
                : i == 1 ? &report.V_qq : &report.phi_q;
            if (i == 1 && (entry == 11 || entry == 14)) { /* V_qq[2,3] = 0 */
                CHECK(report.passed);
                continue;
            }
            CHECK(!report.passed);
            CHECK(d->row * 4 + d->column == entry);
            CHECK_NEAR(d->given, -d->expected, 1e-11);
            CHECK_NEAR(d->error, 2 * fabs(d->expected) / (1 + fabs(d->expected)), 1e-11);
            CHECK(d->error > 1e-3 && strncmp(report.finding.text, arrays[i].name, 4) == 0);
        }
}

static void test_derivative_at_rest(void)
{
    /* d(mu v)/dq vanishes with v; its sign is looked at with another velocity. */
    double x[8];
    generic4_state(x);
    fill(4, x + 4, 0.0);
    spoiled s = {.wrong = SIGN_PHI_Q, .entry = 3};
    const dal_system_def def = {.n = 4, .m = 2, .mass = generic4_mass, .constraint = constraint,
                                .ctx = &s};
    dal_check report;
    CHECK(examine_def(&def, x, &report, NULL) == 0);
    CHECK(!report.passed && report.phi_q.row == 0 && report.phi_q.column == 3);
}

static void test_forms(void)
{
    dal_check report;
    spoiled s = {.wrong = VELOCITY};
    CHECK(examine(&s, 0, &report, NULL) == 0 && !report.passed);
    CHECK(report.linearity > 1e-3 && report.linearity < 1e-2); /* 1e-3 of a change of 1.5 or so */
    CHECK(finds(&report, "phi_v[1,2]") && finds(&report, "depend on v"));

    s = (spoiled){.wrong = AFFINE};
    CHECK(examine(&s, 0, &report, NULL) == 0 && !report.passed && report.linearity == 0.0);
    CHECK(finds(&report, "phi[1]"));

    const wrong deficient[2] = {VANISHING, DOUBLE};
    for (size_t i = 0; i < 2; i++) {
        s = (spoiled){.wrong = deficient[i]};
        CHECK(examine(&s, 0, &report, NULL) == 0 && !report.passed && report.rank == 1);
        CHECK(finds(&report, "rank 1 instead of 2") && report.condition > 1e15);
        CHECK(finds(&report, i == 0 ? ": constraints[1] vanishes here"
                                    : ": constraints[1] equals 3 constraints[0] here"));
        CHECK(report.finding.rows == 1 + i && report.finding.dependent[0] == 1);
        CHECK(i == 0 || (report.finding.dependent[1] == 0
                         && fabs(report.finding.factor[1] - 3.0) < 1e-14));
    }

    /* Of full rank, but C, whose condition is the square, cannot be inverted. */
    s = (spoiled){.wrong = NEARLY_DOUBLE};
    CHECK(examine(&s, 0, &report, NULL) == 0 && !report.passed && report.rank == 2);
    CHECK(finds(&report, "singular") && report.condition > 1e8 && report.condition < 1e11);
    CHECK(finds(&report, "constraints[1] equals 3 constraints[0] up to "));
    CHECK(report.finding.rows == 2);
}

static void test_off_D(void)
{
    double x[8];
    generic4_state(x);
    x[4] += 0.25; /* mu^1 v = 0.25, and mu^2 v = 0.25 (b/4 + c^2/10) = 0.25 * -0.034 */
    spoiled s = {.wrong = NOTHING};
    const dal_system_def def = {.n = 4, .m = 2, .mass = generic4_mass, .constraint = constraint,
                                .ctx = &s};
    dal_check report;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && !report.passed);
    dal_system *const system = new_system(&def);
    CHECK_NEAR(report.residual, residual_of(system, 0.0, x), 16 * DBL_EPSILON);
    CHECK(finds(&report, "violates the constraint"));
}

/* ---- involutivity ----------------------------------------------------------------------- */

static const double unit_mass[49] = {[0] = 1, [8] = 1, [16] = 1, [24] = 1,
                                     [32] = 1, [40] = 1, [48] = 1};

/* q = (x, y1, y2, y3, z1, z2, z3), mu = e^x (1, 0, 0, 0, z1, z2, z3): the differential of
 * x + |z|^2/2, which the factor hides from a look at d mu. */
static int disguised(double t, const double *q, const double *v, double *phi, double *phi_v,
                     double *phi_q, double *phi_t, void *ctx)
{
    const double factor = exp(q[0]);
    fill(7, phi_v, 0.0);
    fill(7, phi_q, 0.0);
    if (phi_v) {
        phi_v[0] = factor;
        for (size_t i = 4; i < 7; i++) phi_v[i] = factor * q[i];
    }
    if (phi_q) {
        phi_q[0] = factor * (v[0] + q[4] * v[4] + q[5] * v[5] + q[6] * v[6]);
        for (size_t i = 4; i < 7; i++) phi_q[i] = factor * v[i];
    }
    return 0;
}

static void test_disguise(unsigned missing)
{
    const double x[14] = {0.2, 0.6, 0.4, 0.2, 1, -0.5, 2, -0.7, 0.3, 0.1, 0.2, 0.5, 0.4, 0.2};
    const dal_system_def def = {.n = 7, .m = 1, .mass = unit_mass, .constraint = disguised,
                                .missing = missing};
    dal_check report;
    dal_error error;
    /* -0.7 + 0.5 - 0.2 + 0.4 = 0 */
    CHECK(examine_def(&def, x, &report, &error) == 0 && report.passed);
    CHECK(report.integrable && report.curvature < (missing ? 1e-10 : 1e-14));
    CHECK(finds(&report, "holonomic"));
}

/* mu = (1, 0, y^2), whose curvature 2 y vanishes at y = 0 only; nothing is known for |y| > ctx. */
static int touching(double t, const double *q, const double *v, double *phi, double *phi_v,
                    double *phi_q, double *phi_t, void *ctx)
{
    const double *limit = ctx;
    (void)phi;
    if (fabs(q[1]) > *limit) return 1;
    fill(3, phi_v, 0.0);
    fill(3, phi_q, 0.0);
    if (phi_v) {
        phi_v[0] = 1.0;
        phi_v[2] = q[1] * q[1];
    }
    if (phi_q) phi_q[1] = 2 * q[1] * v[2];
    return 0;
}

static void test_exceptional_point(void)
{
    const double x[6] = {0, 0, 0, 0, 1, 1}, mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    double limit = INFINITY;
    const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = touching,
                                .ctx = &limit};
    dal_check report;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && report.passed);
    CHECK(!report.integrable && report.curvature == 0.0);

    /* Points out of the domain are no evidence, and no failure. */
    limit = 1e-3;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && report.passed && report.integrable);
}

/* mu = (-ctx[0] y, -ctx[1] x, 1): along the axes the bracket is ctx[0] - ctx[1], and its terms are
 * these. */
static int twisted(double t, const double *q, const double *v, double *phi, double *phi_v,
                   double *phi_q, double *phi_t, void *ctx)
{
    const double *const twist = ctx;
    (void)phi;
    if (phi_v) {
        phi_v[0] = -twist[0] * q[1];
        phi_v[1] = -twist[1] * q[0];
        phi_v[2] = 1.0;
    }
    fill(3, phi_q, 0.0);
    if (phi_q) {
        phi_q[0] = -twist[1] * v[1];
        phi_q[1] = -twist[0] * v[0];
    }
    return 0;
}

/* Curvature counts from 1e-8 of the terms that cancel on, and from 1e-10 where they are small. */
static void test_smallest_curvature(void)
{
    static const struct {
        double twist[2];
        int integrable;
    } cases[] = {{{0.9e-10, 0.0}, 1}, {{1.1e-10, 0.0}, 0},
                 {{1.0, 1.0 - 0.9e-8}, 1}, {{1.0, 1.0 - 1.1e-8}, 0}};
    const double x[6] = {0, 0, 0, 1, 1, 0}, mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
        double twist[2] = {cases[k].twist[0], cases[k].twist[1]};
        const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = twisted,
                                    .ctx = twist};
        dal_check report;
        CHECK(examine_def(&def, x, &report, NULL) == 0 && report.passed);
        CHECK(report.integrable == cases[k].integrable);
        CHECK_NEAR(report.curvature, twist[0] - twist[1], 4 * DAL_ROUNDOFF * twist[0]);
    }
}

/* A plane and a second one at the angle ctx: singular values sqrt(2) and ctx / sqrt(2). */
static int nearly_parallel(double t, const double *q, const double *v, double *phi, double *phi_v,
                           double *phi_q, double *phi_t, void *ctx)
{
    fill(6, phi_v, 0.0);
    fill(6, phi_q, 0.0);
    if (phi_v) phi_v[0] = phi_v[3] = 1.0, phi_v[4] = *(const double *)ctx;
    return 0;
}

/* Singular values count from 4 n eps of the largest on: an angle of 8 n eps = 5.3e-15. */
static void test_smallest_angle(void)
{
    const double x[6] = {0}, mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    for (size_t rank = 1; rank <= 2; rank++) {
        double angle = (rank == 1 ? 0.9 : 1.1) * 24.0 * DBL_EPSILON;
        const dal_system_def def = {.n = 3, .m = 2, .mass = mass, .constraint = nearly_parallel,
                                    .ctx = &angle};
        dal_check report;
        CHECK(examine_def(&def, x, &report, NULL) == 0 && report.rank == rank);
    }
}

/* n - m = 1: mu = (1, 0), a line field. */
static int line(double t, const double *q, const double *v, double *phi, double *phi_v,
                double *phi_q, double *phi_t, void *ctx)
{
    if (phi_v) phi_v[0] = 1.0, phi_v[1] = sin(q[0]);
    if (phi_q) phi_q[0] = cos(q[0]) * v[1], phi_q[1] = 0.0;
    return 0;
}

static void test_line(void)
{
    const double mass[4] = {1, 0, 0, 1}, x[4] = {0, 0, 0, 1};
    const dal_system_def def = {.n = 2, .m = 1, .mass = mass, .constraint = line};
    dal_check report;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && report.passed && report.integrable);
    CHECK(finds(&report, "always integrable") && !finds(&report, "holonomic"));
}

/* ---- general systems -------------------------------------------------------------------- */

typedef enum output {
    NO_OUTPUT, OUT_L, OUT_L_Q, OUT_L_V, OUT_L_QQ, OUT_L_VQ, OUT_L_VV, OUT_F, OUT_F_Q, OUT_F_V,
    OUT_PHI, OUT_PHI_V, OUT_PHI_Q, OUTPUTS
} output;

/* A system in which one entry of one output is off. */
typedef struct general {
    dal_constraint_kind kind;
    output output;
    size_t entry;
    double amount;  /* what is added to it; NaN: the output is never written */
    double bend;    /* an affine phi has this times v0^2 */
    double turn;    /* phi_v has this times v1 in entry 0 */
    double reach;   /* largest |v| in the domain of all functions; 0: no limit */
    int call, calls, returned;
} general;

/* What an output points to, NULL if it is not to be written. */
static double *open_output(const general *g, output which, double *x)
{
    return g->output == which && isnan(g->amount) ? NULL : x;
}

static void spoil(const general *g, output which, double *x)
{
    if (x && g->output == which && !isnan(g->amount)) x[g->entry] += g->amount;
}

static int enter(general *g, const double *v)
{
    if (++g->calls == g->call) return g->returned;
    return g->reach > 0.0 && hypot(hypot(v[0], v[1]), v[2]) > g->reach;
}

static void fill_matrix(double *A, double a, double b, double c, double d, double e, double f,
                        double g, double h, double i)
{
    const double entries[9] = {a, b, c, d, e, f, g, h, i};
    if (A) memcpy(A, entries, sizeof entries);
}

static void fill_vector(double *x, double a, double b, double c)
{
    const double entries[3] = {a, b, c};
    if (x) memcpy(x, entries, sizeof entries);
}

/* L = ((2 + sin x) u^2 + (2 + y^2/4) v^2 + 3 w^2)/2 + cos z u v/2 + w^4/24 + y w + sin x v
 *     - x^2 y - cos z */
static int general_lagrangian(double t, const double *q, const double *qdot, double *L,
                              double *L_q, double *L_v, double *L_qq, double *L_vq, double *L_vv,
                              double *L_vt, void *ctx)
{
    general *const g = ctx;
    const double x = q[0], y = q[1], z = q[2], u = qdot[0], v = qdot[1], w = qdot[2];
    const double sx = sin(x), cx = cos(x), sz = sin(z), cz = cos(z);
    const int returned = enter(g, qdot);
    if (returned) return returned;
    L = open_output(g, OUT_L, L);
    if (L)
        *L = ((2 + sx) * u * u + (2 + y * y / 4) * v * v + 3 * w * w) / 2 + cz * u * v / 2
           + w * w * w * w / 24 + y * w + sx * v - x * x * y - cz;
    fill_vector(open_output(g, OUT_L_Q, L_q), cx * u * u / 2 + cx * v - 2 * x * y,
                y * v * v / 4 + w - x * x, -sz * u * v / 2 + sz);
    fill_vector(open_output(g, OUT_L_V, L_v), (2 + sx) * u + cz * v / 2,
                (2 + y * y / 4) * v + cz * u / 2 + sx, 3 * w + w * w * w / 6 + y);
    fill_matrix(open_output(g, OUT_L_QQ, L_qq), -sx * u * u / 2 - sx * v - 2 * y, -2 * x, 0,
                -2 * x, v * v / 4, 0, 0, 0, -cz * u * v / 2 + cz);
    fill_matrix(open_output(g, OUT_L_VQ, L_vq), cx * u, 0, -sz * v / 2, cx, y * v / 2, -sz * u / 2,
                0, 1, 0);
    fill_matrix(open_output(g, OUT_L_VV, L_vv), 2 + sx, cz / 2, 0, cz / 2, 2 + y * y / 4, 0, 0, 0,
                3 + w * w / 2);
    spoil(g, OUT_L, L);
    spoil(g, OUT_L_Q, L_q);
    spoil(g, OUT_L_V, L_v);
    spoil(g, OUT_L_QQ, L_qq);
    spoil(g, OUT_L_VQ, L_vq);
    spoil(g, OUT_L_VV, L_vv);
    return 0;
}

/* f = (cos t - x v, -v^3/3 + y, -u w sin z) */
static int general_force(double t, const double *q, const double *qdot, const double *input,
                         double *f, double *f_q, double *f_v, void *ctx)
{
    general *const g = ctx;
    const double x = q[0], y = q[1], z = q[2], u = qdot[0], v = qdot[1], w = qdot[2];
    const int returned = enter(g, qdot);
    if (returned) return returned;
    fill_vector(open_output(g, OUT_F, f), cos(t) - x * v, -v * v * v / 3 + y, -u * w * sin(z));
    fill_matrix(open_output(g, OUT_F_Q, f_q), -v, 0, 0, 0, 1, 0, 0, 0, -u * w * cos(z));
    fill_matrix(open_output(g, OUT_F_V, f_v), 0, -x, 0, 0, -v * v, 0, -w * sin(z), 0, -u * sin(z));
    spoil(g, OUT_F, f);
    spoil(g, OUT_F_Q, f_q);
    spoil(g, OUT_F_V, f_v);
    return 0;
}

/* phi = w - sin y u - x v, that minus cos z, or w - (1 + x^2) sqrt(1 + u^2 + y^2 v^2) */
static int general_constraint(double t, const double *q, const double *qdot, double *phi,
                              double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    general *const g = ctx;
    const double x = q[0], y = q[1], z = q[2], u = qdot[0], v = qdot[1], w = qdot[2];
    const double affine = g->kind == DAL_AFFINE, s = sqrt(1 + u * u + y * y * v * v);
    const int returned = enter(g, qdot);
    if (returned) return returned;
    phi = open_output(g, OUT_PHI, phi);
    phi_v = open_output(g, OUT_PHI_V, phi_v);
    phi_q = open_output(g, OUT_PHI_Q, phi_q);
    if (g->kind == DAL_NONLINEAR) {
        if (phi) *phi = w - (1 + x * x) * s;
        fill_vector(phi_v, -(1 + x * x) * u / s, -(1 + x * x) * y * y * v / s, 1);
        fill_vector(phi_q, -2 * x * s, -(1 + x * x) * y * v * v / s, 0);
    } else {
        if (phi) *phi = w - sin(y) * u - x * v - affine * cos(z) + g->bend * u * u;
        fill_vector(phi_v, -sin(y) + g->turn * v, -x, 1);
        fill_vector(phi_q, -v, -cos(y) * u, affine * sin(z));
    }
    spoil(g, OUT_PHI, phi);
    spoil(g, OUT_PHI_V, phi_v);
    spoil(g, OUT_PHI_Q, phi_q);
    return 0;
}

/* A state in D. */
static void general_state(dal_constraint_kind kind, double *x)
{
    general g = {.kind = kind};
    double phi;
    fill_vector(x, 0.4, 0.7, -0.3);
    fill_vector(x + 3, 0.5, -0.6, 0.0);
    general_constraint(0.0, x, x + 3, &phi, NULL, NULL, NULL, &g);
    x[5] = -phi;
}

static int examine_general(general *g, unsigned missing, dal_check *report, dal_error *error)
{
    double x[6];
    general_state(g->kind, x);
    const dal_system_def def = {.n = 3, .m = 1, .lagrangian = general_lagrangian,
                                .force = general_force, .constraint = general_constraint,
                                .kind = g->kind, .missing = missing, .ctx = g};
    return examine_def(&def, x, report, error);
}

static const dal_constraint_kind kinds[3] = {DAL_LINEAR, DAL_AFFINE, DAL_NONLINEAR};

/* Roundoff of the differences: 1.5 u 2^11 = 3e-13 times values up to 10; L_vv at x by hand. */
static void test_general(void)
{
    for (size_t i = 0; i < 3; i++) {
        general right = {.kind = kinds[i]};
        dal_check report;
        dal_error error;
        double x[6];
        CHECK(examine_general(&right, 0, &report, &error) == 0 && report.passed);
        if (!report.passed) fprintf(stderr, "kind %d: %s\n", (int)kinds[i], report.finding.text);
        const dal_difference *const all[] = {&report.L_q, &report.L_v, &report.L_qq, &report.L_vq,
                                             &report.L_vv, &report.f_q, &report.f_v, &report.phi_q};
        for (size_t k = 0; k < sizeof all / sizeof *all; k++)
            CHECK(all[k]->checked && all[k]->error < 3e-11);
        CHECK(!report.V_q.checked && !report.V_qq.checked);
        CHECK(report.phi_v.checked == (kinds[i] != DAL_LINEAR) && report.phi_v.error < 3e-11);
        CHECK(report.rank == 1 && report.residual <= 12 * DAL_ROUNDOFF);
        CHECK_NEAR(report.condition, 1.0, 8 * DBL_EPSILON);
        CHECK(isnan(report.curvature) == (kinds[i] != DAL_LINEAR) && !report.integrable);
        CHECK((report.linearity == 0.0) == (kinds[i] != DAL_NONLINEAR));
        CHECK(finds(&report, (const char *const[]){"not integrable", "affine", "nonlinear"}[i]));

        general_state(kinds[i], x);
        const double a = 2 + sin(x[0]), b = cos(x[2]) / 2, c = 2 + x[1] * x[1] / 4;
        const double least = (a + c) / 2 - hypot((a - c) / 2, b);
        CHECK_NEAR(report.mass_min, fmin(least, 3 + x[5] * x[5] / 2), 32 * DBL_EPSILON);
        CHECK(report.kernel_min >= report.mass_min);
    }
}

/* An entry that is off by 1e-3 is found there, and nowhere else. */
static void test_general_entries(void)
{
    static const struct {
        output output;
        size_t entries;
        const char *name;
    } arrays[] = {{OUT_L_Q, 3, "L_q["}, {OUT_L_V, 3, "L_v["}, {OUT_L_QQ, 9, "L_qq["},
                  {OUT_L_VQ, 9, "L_vq["}, {OUT_L_VV, 9, "L_vv["}, {OUT_F_Q, 9, "f_q["},
                  {OUT_F_V, 9, "f_v["}, {OUT_PHI_V, 3, "phi_v["}, {OUT_PHI_Q, 3, "phi_q["}};
    for (size_t k = 0; k < 3; k++)
        for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++)
            for (size_t entry = 0; entry < arrays[i].entries; entry++) {
                general g = {.kind = kinds[k], .output = arrays[i].output, .entry = entry,
                             .amount = 1e-3};
                dal_check report;
                if (g.kind == DAL_LINEAR && g.output == OUT_PHI_V) continue;
                CHECK(examine_general(&g, 0, &report, NULL) == 0);
                const dal_difference *const found[] = {
                    &report.L_q, &report.L_v, &report.L_qq, &report.L_vq, &report.L_vv, &report.f_q,
                    &report.f_v, &report.phi_v, &report.phi_q};
                CHECK(!report.passed && strncmp(report.finding.text, arrays[i].name,
                                                strlen(arrays[i].name)) == 0);
                CHECK(found[i]->row * 3 + found[i]->column == entry);
                CHECK_NEAR(found[i]->given - found[i]->expected, 1e-3, 3e-11);
                const double relative = 1e-3 / (1.0 + fabs(found[i]->expected));
                CHECK_NEAR(found[i]->error, relative, 3e-11);
                for (size_t other = 0; other < sizeof arrays / sizeof *arrays; other++)
                    if (other != i) CHECK(found[other]->error < 3e-11);
            }
}

/* mu and a of an affine constraint may be wrong by less than differences see. */
static void test_affine(void)
{
    dal_check report;
    general g = {.kind = DAL_AFFINE, .turn = 1e-9};
    CHECK(examine_general(&g, 0, &report, NULL) == 0 && !report.passed);
    CHECK(finds(&report, "phi_v[0,0]") && finds(&report, "must not depend on v"));
    CHECK(report.phi_v.error < 1e-7 && report.linearity > 1e-9 && report.linearity < 1e-8);

    g = (general){.kind = DAL_AFFINE, .bend = 1e-9};
    CHECK(examine_general(&g, 0, &report, NULL) == 0 && !report.passed);
    CHECK(finds(&report, "phi[0] - (phi_v v)[0]") && finds(&report, "affine term"));
    CHECK(report.phi_v.error < 1e-7 && report.linearity == 0.0);

    g = (general){.kind = DAL_AFFINE, .output = OUT_PHI, .amount = 0.25};
    CHECK(examine_general(&g, 0, &report, NULL) == 0 && !report.passed);
    CHECK(finds(&report, "violates the constraint") && finds(&report, "allowed 1e-08"));
    CHECK(report.residual > 0.05);
}

/* Derivatives may be wrong by 1e-7 of 1 + their size, sums of a few terms by 1e-12, and no more. */
static void test_smallest_errors(void)
{
    double x[6], other[3], scale = 0.0;
    general_state(DAL_LINEAR, x);
    const double mu[3] = {-sin(x[1]), -x[0], 1.0};
    for (size_t i = 0; i < 3; i++) { /* the largest component of v is 0.6 */
        other[i] = x[3 + i] + 1.6 * (1.0 + 0.5 * sin((double)(i + 1)));
        scale += fabs(mu[i] * other[i]);
    }
    for (int wrong = 0; wrong <= 1; wrong++) {
        const double part = wrong ? 1.1 : 0.9;
        dal_check report;
        general g = {.kind = DAL_LINEAR, .output = OUT_F_Q, .entry = 4, .amount = part * 2e-7};
        CHECK(examine_general(&g, 0, &report, NULL) == 0 && report.passed == !wrong);
        CHECK_NEAR(report.f_q.error, part * 1e-7, 3e-11);
        g = (general){.kind = DAL_LINEAR, .output = OUT_PHI, .amount = part * 1e-12 * scale};
        CHECK(examine_general(&g, 0, &report, NULL) == 0 && report.passed == !wrong);
        if (wrong) CHECK(finds(&report, "phi_v v"));
        g = (general){.kind = DAL_LINEAR, .turn = part * 1e-12 * fabs(mu[0] / (other[1] - x[4]))};
        CHECK(examine_general(&g, 0, &report, NULL) == 0 && report.passed == !wrong);
        if (wrong) CHECK(finds(&report, "must not depend on v"));
    }
}

/* V of one coordinate, whose derivatives are wrong by a part of them. */
typedef struct rough {
    double (*V)(double q, int order); /* its derivative of this order; NaN outside the domain */
    double q, part;
} rough;

static double wave(double q, int order)
{
    return order == 0 ? cos(1e3 * q) : order == 1 ? -1e3 * sin(1e3 * q) : -1e6 * cos(1e3 * q);
}

static double root(double q, int order)
{
    return order == 0 ? sqrt(q) : order == 1 ? 0.5 / sqrt(q) : -0.25 / (q * sqrt(q));
}

static double pole(double q, int order)
{
    return order == 0 ? -1 / q : order == 1 ? 1 / (q * q) : -2 / (q * q * q);
}

static double wall(double q, int order)
{
    return q <= 0.0 ? 0.0 : order == 0 ? 1e6 * q * q : order == 1 ? 2e6 * q : 2e6;
}

static int rough_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                           void *ctx)
{
    const rough *const r = ctx;
    if (V) *V = r->V(q[0], 0);
    if (V_q) *V_q = r->V(q[0], 1);
    if (V_qq) *V_qq = r->V(q[0], 2) * (1.0 + r->part);
    return 0;
}

/* The unit of q may be far from that of V: right derivatives pass, wrong ones do not. */
static void test_rough(void)
{
    const rough functions[] = {{wave, 0.3, 0.0}, {root, 1e-8, 0.0}, {pole, 1e-3, 0.0},
                               {wall, 1e-6, 0.0}, {wall, 1e-4, 0.0}};
    const double mass[1] = {1.0};
    dal_check report;
    for (size_t i = 0; i < sizeof functions / sizeof *functions; i++)
        for (int wrong = 0; wrong <= 1; wrong++) {
            rough r = functions[i];
            const double x[2] = {r.q, 0.0};
            r.part = wrong ? 1e-5 : 0.0;
            const dal_system_def def = {.n = 1, .mass = mass, .potential = rough_potential,
                                        .ctx = &r};
            CHECK(examine_def(&def, x, &report, NULL) == 0 && report.passed == !wrong);
            CHECK(report.V_q.checked && !report.V_q.wrong && report.V_q.unjudged == 0);
            CHECK(report.V_qq.wrong == wrong && report.V_qq.unjudged == 0);
            CHECK(finds(&report, wrong ? "V_qq[0,0] is given as" : "agree with finite"));
            CHECK(!finds(&report, "not judged"));
        }
}

/* At the edge of a wall V_qq is 0 on one side and 2e6 on the other: what is between them, and only
 * that, is not judged. */
static void test_kink(void)
{
    const double mass[1] = {1.0}, x[2] = {0.0, 0.0};
    rough r = {wall, 0.0, 0.0};
    const dal_system_def def = {.n = 1, .mass = mass, .potential = rough_potential, .ctx = &r};
    dal_check report;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && report.passed);
    CHECK(report.V_q.checked && !report.V_qq.checked && report.V_qq.unjudged == 1);
    CHECK(finds(&report, "(not judged everywhere: V_qq)"));
}

/* phi_q is that of phi_v v, so a wrong phi_v is not to be called a wrong phi_q. */
static int turned(double t, const double *q, const double *v, double *phi, double *phi_v,
                  double *phi_q, double *phi_t, void *ctx)
{
    if (phi) *phi = v[2] - q[1] * v[0];
    fill_vector(phi_v, q[1], 0, 1);
    fill_vector(phi_q, 0, -v[0], 0);
    return 0;
}

static void test_wrong_forms(void)
{
    const double mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, x[6] = {0.1, 0.2, 0.3, 0, 1, 0};
    const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = turned};
    dal_check report;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && !report.passed);
    CHECK(finds(&report, "phi[0] is given as") && finds(&report, "but phi_v v is"));
}

/* phi = u^2 + v^2 + w^2 - 1 */
static int speed_squared(double t, const double *q, const double *v, double *phi, double *phi_v,
                         double *phi_q, double *phi_t, void *ctx)
{
    if (phi) *phi = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] - 1;
    fill_vector(phi_v, 2 * v[0], 2 * v[1], 2 * v[2]);
    fill_vector(phi_q, 0, 0, 0);
    return 0;
}

static void test_rank_at_rest(void)
{
    const double mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const double moving[6] = {0, 0, 0, 0.6, 0, -0.8}, rest[6] = {0};
    const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = speed_squared,
                                .kind = DAL_NONLINEAR};
    dal_check report;
    CHECK(examine_def(&def, moving, &report, NULL) == 0 && report.passed);
    CHECK(examine_def(&def, rest, &report, NULL) == 0 && !report.passed && report.rank == 0);
    CHECK(finds(&report, "rank 0 instead of 1") && finds(&report, "at rest"));
}

/* L = ctx[0] u^2/2 + ctx[1] v^2/2 */
static int diagonal_lagrangian(double t, const double *q, const double *v, double *L, double *L_q,
                               double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                               void *ctx)
{
    const double *const a = ctx;
    (void)q;
    if (L) *L = (a[0] * v[0] * v[0] + a[1] * v[1] * v[1]) / 2;
    fill(2, L_q, 0.0);
    if (L_v) L_v[0] = a[0] * v[0], L_v[1] = a[1] * v[1];
    fill(4, L_qq, 0.0);
    fill(4, L_vq, 0.0);
    fill(4, L_vv, 0.0);
    if (L_vv) L_vv[0] = a[0], L_vv[3] = a[1];
    return 0;
}

/* mu = (0, 1) */
static int second(double t, const double *q, const double *v, double *phi, double *phi_v,
                  double *phi_q, double *phi_t, void *ctx)
{
    if (phi_v) phi_v[0] = 0.0, phi_v[1] = 1.0;
    fill(2, phi_q, 0.0);
    return 0;
}

/* Eigenvalues of an indefinite L_vv, to the roundoff of 2 n max |L_vv|. */
static void test_indefinite(void)
{
    const double x[4] = {0, 0, 1, 0};
    double a[2] = {2, -3};
    const dal_system_def def = {.n = 2, .m = 1, .lagrangian = diagonal_lagrangian,
                                .constraint = second, .ctx = a};
    const dal_system_def free = {.n = 2, .lagrangian = diagonal_lagrangian, .ctx = a};
    dal_check report;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && !report.passed && report.rank == 1);
    CHECK(finds(&report, "L_vv is not positive definite") && finds(&report, "-3"));
    CHECK_NEAR(report.mass_min, -3.0, 64 * DBL_EPSILON);
    CHECK_NEAR(report.kernel_min, 2.0, 64 * DBL_EPSILON);
    CHECK(isnan(report.condition));
    CHECK(examine_def(&free, x, &report, NULL) == 0 && !report.passed);

    /* Degenerate, although positive on ker mu: no scheme can invert it. */
    a[1] = 0.0;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && !report.passed);
    CHECK_NEAR(report.mass_min, 0.0, 64 * DBL_EPSILON);
    CHECK_NEAR(report.kernel_min, 2.0, 64 * DBL_EPSILON);

    const double sizes[] = {0.0, -1e-320, 1e300, -1e300, 1e308};
    for (size_t i = 0; i < 5; i++)
        for (size_t k = 0; k < 5; k++) {
            a[0] = sizes[i];
            a[1] = sizes[k];
            const int status = examine_def(&def, x, &report, NULL);
            CHECK(status == 0 || status == DAL_EDOMAIN);
            CHECK(report.finding.text[0] != '\0');
        }
}

/* The Lagrangian of a constant mass is that mass. */
static void test_same_mass(void)
{
    const double mass[4] = {2, 0, 0, 3}, x[4] = {0, 0, 1, 0};
    double a[2] = {2, 3};
    const dal_system_def simple = {.n = 2, .m = 1, .mass = mass, .constraint = second};
    const dal_system_def general = {.n = 2, .m = 1, .lagrangian = diagonal_lagrangian,
                                    .constraint = second, .ctx = a};
    dal_check one, other;
    CHECK(examine_def(&simple, x, &one, NULL) == 0 && one.passed);
    CHECK(examine_def(&general, x, &other, NULL) == 0 && other.passed);
    CHECK(one.mass_min == other.mass_min && one.kernel_min == other.kernel_min);
    CHECK(one.condition == other.condition && one.curvature == other.curvature);
}

/* f = sin(t) (v^2, 0), whose f_v is said to be 0: right at time 0 only. */
static int late_force(double t, const double *q, const double *v, const double *u, double *f,
                      double *f_q, double *f_v, void *ctx)
{
    (void)q, (void)ctx;
    if (f) f[0] = sin(t) * v[0] * v[0], f[1] = 0.0;
    fill(4, f_q, 0.0);
    fill(4, f_v, 0.0);
    return 0;
}

static void test_late_force(void)
{
    const double mass[4] = {2, 0, 0, 3}, x[4] = {0, 0, 1, 0};
    const dal_system_def def = {.n = 2, .mass = mass, .force = late_force};
    dal_check report;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && !report.passed);
    CHECK(finds(&report, "f_v[0,0]") && report.f_v.given == 0.0 && report.f_q.error == 0.0);
}

/* mu vanishes one unit of time later, where what depends on time is examined once more; its rank is
 * that at the time asked for. */
static int fading_constraint(double t, const double *q, const double *v, double *phi,
                             double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    (void)q, (void)ctx;
    if (phi) phi[0] = (1.0 - t) * v[0];
    if (phi_v) phi_v[0] = 1.0 - t, phi_v[1] = 0.0;
    fill(2, phi_q, 0.0);
    if (phi_t) phi_t[0] = -v[0];
    return 0;
}

static void test_fading(void)
{
    const double mass[4] = {2, 0, 0, 3}, x[4] = {0, 0, 0, 1};
    const dal_system_def def = {.n = 2, .m = 1, .mass = mass, .constraint = fading_constraint,
                                .time_dependent = 1};
    dal_check report;
    CHECK(examine_def(&def, x, &report, NULL) == 0 && report.passed);
    CHECK(report.rank == 1 && report.condition == 1.0 && report.phi_t.checked);
}

/* The second velocity lies outside the domain of L, f and a nonlinear phi: it is passed over. */
static void test_passed_over(void)
{
    dal_check report;
    general g = {.kind = DAL_NONLINEAR, .reach = 3.0}; /* |v| at x is about 1.6 */
    CHECK(examine_general(&g, 0, &report, NULL) == 0 && report.passed);
    CHECK(report.L_vv.checked && report.f_v.checked && report.phi_v.checked);
    CHECK(isnan(report.linearity));
    g = (general){.kind = DAL_NONLINEAR, .reach = 1.0};
    CHECK(examine_general(&g, 0, &report, NULL) == DAL_EDOMAIN && !report.passed);
    CHECK(finds(&report, "outside its domain"));
}

static void test_general_missing(void)
{
    const unsigned bits[] = {DAL_MISSING_L_QQ, DAL_MISSING_L_VQ, DAL_MISSING_L_VV,
                             DAL_MISSING_F_Q, DAL_MISSING_F_V, DAL_MISSING_PHI_Q};
    for (size_t k = 0; k < 3; k++)
        for (unsigned subset = 0; subset < 64; subset++) {
            general g = {.kind = kinds[k]};
            dal_check report;
            unsigned missing = 0;
            for (size_t i = 0; i < 6; i++)
                if (subset >> i & 1) missing |= bits[i];
            CHECK(examine_general(&g, missing, &report, NULL) == 0 && report.passed);
            const dal_difference *const found[] = {&report.L_qq, &report.L_vq, &report.L_vv,
                                                   &report.f_q, &report.f_v, &report.phi_q};
            for (size_t i = 0; i < 6; i++) CHECK(found[i]->checked == !(subset >> i & 1));
        }
}

static void test_general_unwritten(void)
{
    static const char *const names[OUTPUTS] = {
        [OUT_L] = ": L[", [OUT_L_Q] = ": L_q[", [OUT_L_V] = ": L_v[", [OUT_L_QQ] = ": L_qq[",
        [OUT_L_VQ] = ": L_vq[", [OUT_L_VV] = ": L_vv[", [OUT_F] = ": f[", [OUT_F_Q] = ": f_q[",
        [OUT_F_V] = ": f_v[", [OUT_PHI] = ": phi[", [OUT_PHI_V] = ": phi_v[",
        [OUT_PHI_Q] = ": phi_q["};
    for (size_t k = 0; k < 3; k++)
        for (int i = OUT_L; i < OUTPUTS; i++) {
            general g = {.kind = kinds[k], .output = (output)i, .amount = (double)NAN};
            dal_check report;
            dal_error error;
            if (i == OUT_PHI && g.kind == DAL_LINEAR) continue;
            CHECK(examine_general(&g, 0, &report, &error) == DAL_EDOMAIN && !report.passed);
            CHECK(finds(&report, names[i]) && finds(&report, "did not set it"));
            CHECK(strcmp(report.finding.text, error.text) == 0);
        }
}

/* Every call of an examination that stops stops it, and leaves the report alone. */
static void test_general_calls(void)
{
    for (size_t k = 0; k < 3; k++)
        for (int call = 1;; call++) {
            general g = {.kind = kinds[k], .call = call, .returned = -1};
            dal_check report, untouched;
            dal_error error;
            memset(&untouched, 0x7f, sizeof untouched);
            const int status = examine_general(&g, 0, &report, &error);
            if (g.calls < call) {
                CHECK(call > 200 && status == 0 && report.passed);
                break;
            }
            CHECK(status == DAL_EUSER && error.status == DAL_EUSER);
            CHECK(memcmp(&report, &untouched, sizeof report) == 0);
        }
}

/* ---- callbacks that fail ---------------------------------------------------------------- */

static void test_unwritten(void)
{
    static const struct {
        wrong wrong;
        const char *name;
    } outputs[] = {{NO_V, ": V["}, {NO_V_Q, ": V_q["}, {NO_V_QQ, ": V_qq["},
                   {NO_PHI_V, ": phi_v["}, {NO_PHI_Q, ": phi_q["}};
    for (size_t i = 0; i < sizeof outputs / sizeof outputs[0]; i++) {
        spoiled s = {.wrong = outputs[i].wrong};
        dal_check report;
        dal_error error;
        CHECK(examine(&s, 0, &report, &error) == DAL_EDOMAIN && error.status == DAL_EDOMAIN);
        CHECK(!report.passed && strcmp(report.finding.text, error.text) == 0);
        CHECK(finds(&report, outputs[i].name) && finds(&report, "did not set it"));
        CHECK(isnan(report.curvature) && report.mass_min > 0.0);
    }
}

/* The call-th call goes wrong, for every call of an examination. */
static void test_every_call(double written, int returned, int expected)
{
    int ignored = 0;
    for (int call = 1;; call++) {
        spoiled s = {.call = call, .written = written, .returned = returned};
        dal_check report, untouched;
        dal_error error;
        memset(&untouched, 0x7f, sizeof untouched);
        const int status = examine(&s, 0, &report, &error);
        if (s.calls < call) {
            CHECK(call > 50 && status == 0 && report.passed);
            return;
        }
        if (expected == DAL_EDOMAIN && status == 0) { /* another difference does as well */
            CHECK(report.passed && ++ignored < s.calls);
            continue;
        }
        CHECK(status == expected && error.status == expected && error.text[0] != '\0');
        if (status == DAL_EDOMAIN)
            CHECK(!report.passed && strcmp(report.finding.text, error.text) == 0);
        else
            CHECK(memcmp(&report, &untouched, sizeof report) == 0);
    }
}

static void test_arguments(void)
{
    double x[8];
    dal_check report, untouched;
    dal_error error;
    dal_system *const system = open_system("generic4");
    memset(&untouched, 0x7f, sizeof untouched);
    report = untouched;
    generic4_state(x);
    CHECK(dal_system_check(NULL, 0.0, x, &report, &error) == DAL_EINVAL
          && says(error.text, "system"));
    CHECK(dal_system_check(system, 0.0, NULL, &report, &error) == DAL_EINVAL
          && says(error.text, "x"));
    CHECK(dal_system_check(system, 0.0, x, NULL, &error) == DAL_EINVAL
          && says(error.text, "report"));
    CHECK(dal_system_check(system, 0.0, x, NULL, NULL) == DAL_EINVAL);
    x[6] = (double)INFINITY;
    CHECK(dal_system_check(system, 0.0, x, &report, &error) == DAL_EINVAL
          && says(error.text, "x[6]"));
    CHECK(memcmp(&report, &untouched, sizeof report) == 0);
}

/* Numbers at the ends of the range of double: what is found does not matter, only that the
 * examination comes to an end and GSL's handler is not called. */
static void test_extremes(void)
{
    const double sizes[] = {1e-300, 1e-200, 1e150, 1e300};
    for (size_t i = 0; i < 4; i++)
        for (size_t k = 0; k < 4; k++) {
            const double mass[9] = {sizes[i], 0, 0, 0, sizes[k], 0, 0, 0, 1};
            const double x[6] = {0, 0, 0, sizes[i], sizes[k], 1};
            double mu[3] = {sizes[k], -sizes[i], 1e-300};
            const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = constant_forms,
                                        .ctx = mu};
            dal_check report;
            const int status = examine_def(&def, x, &report, NULL);
            CHECK(status == 0 || status == DAL_EDOMAIN);
            CHECK(report.finding.text[0] != '\0');
        }
}

int main(void)
{
    gsl_set_error_handler(abort_on_gsl_error);
    test_builtins();
    test_numbers();
    test_eigenvalues();
    test_generic();
    test_missing();
    test_no_constraints();
    test_signs();
    test_derivative_at_rest();
    test_forms();
    test_off_D();
    test_disguise(0);
    test_disguise(DAL_MISSING_PHI_Q);
    test_exceptional_point();
    test_smallest_curvature();
    test_smallest_angle();
    test_line();
    test_smallest_errors();
    test_general();
    test_general_entries();
    test_affine();
    test_rough();
    test_kink();
    test_wrong_forms();
    test_rank_at_rest();
    test_indefinite();
    test_same_mass();
    test_late_force();
    test_fading();
    test_passed_over();
    test_general_missing();
    test_general_unwritten();
    test_general_calls();
    test_unwritten();
    test_every_call((double)NAN, 0, DAL_EDOMAIN);
    test_every_call(0.0, 1, DAL_EDOMAIN);
    test_every_call(0.0, -1, DAL_EUSER);
    test_arguments();
    test_extremes();
    return check_done();
}
