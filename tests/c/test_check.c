/* dal_system_check: right systems pass, and each way to be wrong is found and named. */
#include "check.h"
#include "../generic4.h"
#include "internal.h"

#include <gsl/gsl_errno.h>

#include <stdlib.h>

/* The library must never provoke it. */
static void abort_on_gsl_error(const char *reason, const char *file, int line, int number)
{
    fprintf(stderr, "%s:%d: GSL's handler was called: %s (%d)\n", file, line, reason, number);
    abort();
}

/* ---- a system that can be spoiled ------------------------------------------------------- */

/* generic4 with one thing wrong. */
typedef struct spoiled {
    enum { NOTHING, SIGN_V_Q, SIGN_V_QQ, SIGN_PHI_Q, VELOCITY, AFFINE, PHI_SILENT, OFFSET, DOUBLE,
           NEARLY_DOUBLE, VANISHING, UNITS, UNWRITTEN } wrong;
    size_t entry;            /* of the array that is spoiled */
    int call, returned;      /* the call-th call, from 1 on, returns this; */
    double written;          /* and, if that is 0, writes this to all outputs */
    int calls;
} spoiled;

static void fill(size_t count, double *x, double value)
{
    for (size_t i = 0; x && i < count; i++) x[i] = value;
}

static bool is_broken(spoiled *s) { return ++s->calls == s->call; }

static int potential(const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    spoiled *const s = ctx;
    double discard;
    if (s->wrong == UNWRITTEN && s->entry < 3)
        return generic4_potential(q, s->entry == 0 ? &discard : V, s->entry == 1 ? NULL : V_q,
                                  s->entry == 2 ? NULL : V_qq, NULL);
    if (is_broken(s)) {
        fill(1, V, s->written);
        fill(4, V_q, s->written);
        fill(16, V_qq, s->written);
        return s->returned;
    }
    generic4_potential(q, V, V_q, V_qq, NULL);
    if (V && s->wrong == OFFSET) *V += 1e8;
    if (V_q && s->wrong == SIGN_V_Q) V_q[s->entry] = -V_q[s->entry];
    if (V_qq && s->wrong == SIGN_V_QQ) V_qq[s->entry] = -V_qq[s->entry];
    return 0;
}

static int constraint(const double *q, const double *v, double *phi, double *phi_v, double *phi_q,
                      void *ctx)
{
    spoiled *const s = ctx;
    if (s->wrong == UNWRITTEN && s->entry >= 3)
        return generic4_constraint(q, v, phi, s->entry == 3 ? NULL : phi_v,
                                   s->entry == 4 ? NULL : phi_q, NULL);
    if (is_broken(s)) {
        fill(2, phi, s->written);
        fill(8, phi_v, s->written);
        fill(8, phi_q, s->written);
        return s->returned;
    }
    generic4_constraint(q, v, s->wrong == PHI_SILENT ? NULL : phi, phi_v, phi_q, NULL);
    if (phi && s->wrong == AFFINE) phi[1] += 0.25;
    if (phi_v && s->wrong == VELOCITY) phi_v[s->entry] += 1e-3 * v[1];
    if (phi_q && s->wrong == SIGN_PHI_Q) phi_q[s->entry] = -phi_q[s->entry];
    for (size_t i = 0; i < 4; i++) {
        const double keep = s->wrong == DOUBLE ? 0.0 : s->wrong == NEARLY_DOUBLE ? 1e-9 : 1.0;
        const double copy = keep == 1.0 ? 0.0 : 3.0;
        const double unit = s->wrong == VANISHING ? 0.0 : s->wrong == UNITS ? 1e-30 : 1.0;
        if (phi_v) phi_v[4 + i] = unit * (keep * phi_v[4 + i] + copy * phi_v[i]);
        if (phi_q) phi_q[4 + i] = unit * (keep * phi_q[4 + i] + copy * phi_q[i]);
    }
    if (phi && (s->wrong == UNITS || s->wrong == DOUBLE || s->wrong == NEARLY_DOUBLE ||
                s->wrong == VANISHING))
        phi[0] = phi[1] = (double)NAN;
    return 0;
}

static int examine_def(const dal_system_def *def, const double *x, dal_check *report,
                       dal_error *error)
{
    dal_system *system = NULL;
    dal_error made;
    CHECK(dal_system_new(&system, def, &made) == 0);
    if (!system) fprintf(stderr, "%s\n", made.text);
    memset(report, 0x7f, sizeof *report);
    const int status = dal_system_check(system, x, report, error);
    dal_system_free(system);
    return status;
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

/* ---- what is right ---------------------------------------------------------------------- */

/* Each distribution is non-integrable everywhere: mu wedge d mu of the single forms has no zero,
 * and [X, Y] of the two wheels is across D (curvature below).
 *
 * Differences: d = 2^-11 for |q| < 1 leaves 1.5 u 2^11 = 3e-13 of roundoff and d^4/30 = 2e-15 of the
 * fifth derivative; the margin is ten times. */
static void test_builtins(void)
{
    for (size_t i = 0; i < dal_builtin_count(); i++) {
        double x[64];
        dal_system *system = NULL;
        dal_check report;
        dal_error error;
        CHECK(dal_system_builtin(&system, dal_builtin_name(i), NULL, NULL, 0, NULL) == 0);
        const size_t n = dal_system_n(system);
        CHECK(2 * n <= 64 && dal_system_state(system, x) == 0);
        CHECK(dal_system_check(system, x, &report, &error) == 0);
        if (!report.passed) fprintf(stderr, "%s: %s\n", dal_builtin_name(i), report.text);
        CHECK(report.passed && error.status == 0 && error.text[0] == '\0');
        CHECK(!report.integrable && report.curvature > 0.1);
        CHECK(says(report.text, "not integrable"));
        CHECK(report.rank == dal_system_m(system));
        CHECK(report.phi_q.checked && report.phi_q.error < 3e-12);
        CHECK(report.V_q.error < 3e-12 * 10 && report.V_qq.error < 3e-12 * 10); /* |V| <= 10 */
        CHECK(report.V_q.checked == report.V_qq.checked);
        CHECK(report.linearity == 0.0 && report.residual <= 4 * (double)n * DAL_ROUNDOFF);
        dal_system_free(system);
    }
}

static void examine_builtin(const char *name, dal_check *report)
{
    double x[64];
    dal_system *system = NULL;
    CHECK(dal_system_builtin(&system, name, NULL, NULL, 0, NULL) == 0);
    CHECK(dal_system_state(system, x) == 0);
    CHECK(dal_system_check(system, x, report, NULL) == 0);
    dal_system_free(system);
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

    /* X = (R c, R s, 1, 0)/sqrt(1 + R^2), Y along phi: [X, Y] = R (s, -c, 0, 0)/sqrt(1 + R^2), which
     * is orthogonal to D.  M = diag(m, m, I, J) = diag(1.2, 1.2, 0.5, 0.3), R = 0.7.
     * C = 1/m + R^2/I u u^T with |u| = 1, so its condition is 1 + m R^2/I. */
    examine_builtin("disk", &report);
    CHECK_NEAR(report.curvature, 0.7 / sqrt(1.49), tolerance);
    CHECK_NEAR(report.condition, sqrt(1 + 1.2 * 0.49 / 0.5), tolerance);
    CHECK_NEAR(report.mass_min, 0.3, tolerance);
    CHECK_NEAR(report.kernel_min, 0.3, tolerance);
}

static int flat_forms(const double *q, const double *v, double *phi, double *phi_v, double *phi_q,
                      void *ctx)
{
    (void)q, (void)v, (void)phi;
    memcpy(phi_v ? phi_v : phi_q, ctx, 3 * sizeof *phi_v);
    if (phi_q) memset(phi_q, 0, 9 * 0 + 3 * sizeof *phi_q);
    return 0;
}

/* M = [[2, 1, 0], [1, 2, 0], [0, 0, 5]] has the eigenvalues 1, 3, 5 with (1, -1, 0), (1, 1, 0), e_3.
 * With mu along (1, -1, 0) the smallest on ker mu is 3. */
static void test_eigenvalues(void)
{
    const double mass[9] = {2, 1, 0, 1, 2, 0, 0, 0, 5}, x[6] = {0, 0, 0, 1, 1, 1};
    double mu[3] = {2, -2, 0};
    const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .constraint = flat_forms, .ctx = mu};
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

    /* phi is not asked for elsewhere: a callback that ignores it is right. */
    spoiled silent = {.wrong = PHI_SILENT};
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
    CHECK(says(report.text, "no constraints") && !says(report.text, "disguise"));
}

/* ---- what is wrong ---------------------------------------------------------------------- */

/* A sign flipped in any entry is found there, unless the entry is 0. */
static void test_signs(void)
{
    static const struct {
        int wrong;
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
            if (i == 2 && (entry == 0 || entry == 6)) { /* no form's phi_q has them: see below */
                CHECK(report.passed == (d->error < 1e-7));
            }
            if (report.passed) continue;
            CHECK(d->row * 4 + d->column == entry);
            CHECK_NEAR(d->given, -d->expected, 1e-10 * (1 + fabs(d->expected)));
            CHECK_NEAR(d->error, 2 * fabs(d->expected) / (1 + fabs(d->expected)), 1e-10);
            CHECK(d->error > 1e-3 && strncmp(report.text, arrays[i].name, 4) == 0);
        }
}
