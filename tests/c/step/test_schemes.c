/* Schemes as records: the table, names and numbers, what makes a record valid. */
#include "fixtures.h"
#include "check.h"

#include "step/beta.h"
#include "step/scheme.h"
#include "dalembert/study.h"

#include <locale.h>

static const char *const names[] = {
    "leapfrog", "midpoint", "explicit", "endpoint", "leapfrog-mirror", "midpoint-nodes",
    "explicit-nodes", "endpoint-nodes", "leapfrog-suzuki4", "leapfrog-yoshida4", "leapfrog-kl6",
    "leapfrog-kl8", "leapfrog-ss10", "bm4", "bm6", "midpoint-suzuki4", "midpoint-yoshida4",
    "midpoint-kl6", "midpoint-kl8", "midpoint-ss10", "reference", "taylor",
};
/* The first of them are records of sub-steps. */
enum { NAMES = sizeof names / sizeof names[0], RECORDS = NAMES - 2 };

static double fraction(const dal_scheme *s, size_t j) { return dal__scheme_substep(s, j).fraction; }
static double beta(const dal_scheme *s, size_t j) { return dal__scheme_substep(s, j).beta; }

/* Every name that the header promises is in the table, and each record is found by its name. */
static void test_table(void)
{
    dal_scheme scheme, found;
    CHECK(dal_scheme_count() == NAMES);
    for (size_t i = 0; i < NAMES; i++) {
        CHECK(dal_scheme_find(&found, names[i], NULL) == DAL_SUCCESS);
        CHECK(strcmp(found.name, names[i]) == 0);
        CHECK(dal_scheme_at(&scheme, i) == DAL_SUCCESS);
        CHECK(dal_scheme_find(&found, scheme.name, NULL) == DAL_SUCCESS);
        CHECK(found.substeps == scheme.substeps && found.beta == scheme.beta);
        CHECK(found.family == scheme.family && (i < RECORDS) == !scheme.family);
        CHECK(scheme.help && scheme.help[0] && scheme.reference && scheme.reference[0]);
        if (scheme.family) continue;
        CHECK(dal__beta_check(&scheme, NULL) == DAL_SUCCESS);
        CHECK(scheme.order >= 1 && scheme.multiplier_order == 0);
        CHECK(scheme.symmetric == (scheme.order % 2 == 0));
        CHECK((scheme.nodes == DAL_KEPT_NODES) == (strstr(scheme.name, "-nodes") != NULL));
    }
    CHECK(dal_scheme_at(&scheme, NAMES) == DAL_EINVAL && dal_scheme_at(NULL, 0) == DAL_EINVAL);
    CHECK(dal_scheme_at(&scheme, SIZE_MAX) == DAL_EINVAL);
    CHECK(strcmp(scheme.family->name, "taylor") == 0 && scheme.order == 0);
}

/* A symmetric record reads backwards as its adjoint: fractions mirrored, beta to 1 - beta.  Order p
 * needs sum g = 1 over the base steps, and sum g^k = 0 for the odd k from 3 to p - 1.  The base
 * steps of bm4 and bm6 are their sub-steps. */
static void test_compositions(void)
{
    for (size_t i = 0; i < RECORDS; i++) {
        const dal_scheme s = find_scheme(names[i]);
        const size_t count = dal__scheme_count(&s);
        double sum = 0.0, size = 0.0, cubes = 0.0, fifths = 0.0, sevenths = 0.0, ninths = 0.0;
        const size_t base = strncmp(s.name, "leapfrog", 8) == 0 ? 2 : 1;
        for (size_t j = 0; j < count; j++) {
            sum += fraction(&s, j);
            size += fabs(fraction(&s, j));
            if (s.symmetric) {
                CHECK(fraction(&s, j) == fraction(&s, count - 1 - j));
                CHECK(beta(&s, j) == 1.0 - beta(&s, count - 1 - j));
            }
            if (j % base == 0) {
                const double g = (double)base * fraction(&s, j);
                cubes += g * g * g;
                fifths += pow(g, 5);
                sevenths += pow(g, 7);
                ninths += pow(g, 9);
            }
        }
        CHECK_NEAR(sum, 1.0, 4 * U * size); /* coefficients are rounded once, then added */
        if (s.order >= 4) CHECK_NEAR(cubes, 0.0, 32 * U * size);
        if (s.order >= 6) CHECK_NEAR(fifths, 0.0, 32 * U * size);
        if (s.order >= 8) CHECK_NEAR(sevenths, 0.0, 32 * U * size);
        if (s.order >= 10) CHECK_NEAR(ninths, 0.0, 32 * U * size);
        if (s.order == 4) CHECK(fabs(fifths) > 1e-3);
    }
    CHECK(dal__scheme_count(&(dal_scheme){.beta = 0.3}) == 1);
    static const struct {
        const char *name;
        size_t count;
        int order;
    } expected[] = {{"leapfrog", 2, 2}, {"leapfrog-suzuki4", 10, 4}, {"leapfrog-yoshida4", 6, 4},
                    {"leapfrog-kl6", 18, 6}, {"leapfrog-kl8", 34, 8}, {"midpoint-suzuki4", 5, 4},
                    {"midpoint-yoshida4", 3, 4}, {"midpoint-kl6", 9, 6}, {"midpoint-kl8", 17, 8},
                    {"leapfrog-ss10", 70, 10}, {"midpoint-ss10", 35, 10}, {"bm4", 12, 4},
                    {"bm6", 20, 6},
                    {"midpoint", 1, 2}, {"explicit", 1, 1}, {"endpoint", 1, 1},
                    {"midpoint-nodes", 1, 1}, {"leapfrog-mirror", 2, 2}};
    for (size_t i = 0; i < sizeof expected / sizeof expected[0]; i++) {
        const dal_scheme s = find_scheme(expected[i].name);
        CHECK(dal__scheme_count(&s) == expected[i].count && s.order == expected[i].order);
    }
    const dal_scheme leapfrog = find_scheme("leapfrog"), mirror = find_scheme("leapfrog-mirror");
    CHECK(beta(&leapfrog, 0) == 0.0 && beta(&leapfrog, 1) == 1.0 && fraction(&leapfrog, 0) == 0.5);
    CHECK(beta(&mirror, 0) == 1.0 && beta(&mirror, 1) == 0.0 && fraction(&mirror, 1) == 0.5);
}

static void test_names(void)
{
    static const struct {
        const char *name;
        double beta;
        dal_nodes nodes;
        int order, symmetric;
    } numbers[] = {
        {"0", 0.0, DAL_MOVED_NODES, 1, 0},        {"1", 1.0, DAL_MOVED_NODES, 1, 0},
        {"0.5", 0.5, DAL_MOVED_NODES, 2, 1},      {".25", 0.25, DAL_MOVED_NODES, 1, 0},
        {"0.3-nodes", 0.3, DAL_KEPT_NODES, 1, 0}, {"0.5_nodes", 0.5, DAL_KEPT_NODES, 1, 0},
        {"1e-3", 1e-3, DAL_MOVED_NODES, 1, 0},
    };
    dal_scheme scheme = {.beta = 7.0};
    dal_error error;
    setlocale(LC_ALL, "de_DE.UTF-8"); /* a decimal comma, where the host has it: nothing changes */
    for (size_t i = 0; i < sizeof numbers / sizeof numbers[0]; i++) {
        CHECK(dal_scheme_find(&scheme, numbers[i].name, &error) == DAL_SUCCESS);
        CHECK(error.text[0] == '\0' && scheme.beta == numbers[i].beta && scheme.count == 0);
        CHECK(scheme.nodes == numbers[i].nodes && scheme.order == numbers[i].order);
        CHECK(scheme.symmetric == numbers[i].symmetric);
    }
    CHECK(dal_scheme_find(&scheme, "leapfrog_kl8", NULL) == DAL_SUCCESS && scheme.order == 8);
    CHECK(dal_scheme_find(&scheme, "midpoint_nodes", NULL) == DAL_SUCCESS);
    CHECK(dal_scheme_find(&scheme, "pair:0.25:1e-1", NULL) == DAL_SUCCESS);
    CHECK(strcmp(scheme.name, "pair:0.25:1e-1") == 0 && strcmp(scheme.family->name, "pair") == 0);
    CHECK(scheme.order == 1 && !scheme.symmetric && scheme.help && scheme.reference);
    CHECK(dal_scheme_find(&scheme, "pair:.5:0.5", NULL) == DAL_SUCCESS);
    CHECK(scheme.order == 2 && scheme.symmetric);
    CHECK(dal_scheme_find(&scheme, "pair:0.5:1", NULL) == DAL_SUCCESS && scheme.order == 1);

    const char *const wrong[] = {"", "euler", "1.5", "-0.5", "nan", "inf", "0.5x", "0.5-node",
                                 " 0.5", "0,5", "0x1p-1", ".", "1e-", "0.5.", "1e", "1e5",
                                 "leapfrog-nodes", "leapfro", "leapfrog-", "MIDPOINT",
                                 "pair", "pair:", "pair:0.5", "pair:0.5:", "pair::0.5", "pair:2:1",
                                 "pair:1:1.5", "pair:0:1x", "pair:0:1:1", "pair 0:1", "PAIR:0:1",
                                 "pair:nan:0", "pair:-0:1", "reference-nodes",
                                 "leapfrog-kl8-and-much-more-than-forty-characters"};
    scheme.beta = 7.0;
    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        CHECK(dal_scheme_find(&scheme, wrong[i], &error) == DAL_EINVAL && scheme.beta == 7.0);
        char begin[41]; /* of what may be long */
        snprintf(begin, sizeof begin, "%s", wrong[i]);
        CHECK(strstr(error.text, begin) != NULL && strstr(error.text, "leapfrog") != NULL);
        CHECK(strstr(error.text, "reference, taylor, a number in [0, 1], beta") != NULL);
        CHECK(strstr(error.text, "pair:A:B with A and B in [0, 1]") != NULL);
        CHECK(error.status == DAL_EINVAL);
    }
    setlocale(LC_ALL, "C");
    CHECK(dal_scheme_find(NULL, "midpoint", &error) == DAL_EINVAL);
    CHECK(dal_scheme_find(&scheme, NULL, &error) == DAL_EINVAL && strstr(error.text, "name"));
}

static void check_invalid(const dal_scheme *scheme, const char *words)
{
    dal_error error = {0};
    CHECK(dal__beta_check(scheme, &error) == DAL_EINVAL);
    check_true(strstr(error.text, words) != NULL, error.text, words, __LINE__);
}

static void test_validation(void)
{
    const dal_substep too_long[] = {{0.5, 0.5}, {0.5, 0.5000001}};
    const dal_substep off[] = {{0.5, 0.5}, {0.5, 0.50000000000005}}; /* 1e-14 (1 + 1) is rounding */
    const dal_substep zero[] = {{0.5, 1.0}, {0.5, 0.0}};
    const dal_substep outside[] = {{0.5, 0.5}, {1.25, 0.5}}, unknown[] = {{NAN, 1.0}};
    const dal_substep infinite[] = {{0.5, INFINITY}}, two[] = {{0.0, 0.5}, {1.0, 0.5}};
    const dal_substep thirds[] = {{0.5, 0.333333333333333}, {0.5, 0.333333333333333},
                                  {0.5, 0.333333333333333}};
    check_invalid(&(dal_scheme){.beta = -0.1}, "beta = -0.1");
    check_invalid(&(dal_scheme){.beta = NAN}, "beta = ");
    check_invalid(&(dal_scheme){.count = 2}, "count = 2");
    check_invalid(&(dal_scheme){.count = 2, .substeps = too_long}, "sum to 1.00000");
    check_invalid(&(dal_scheme){.count = 2, .substeps = off}, "sum to 1.00000000000005");
    check_invalid(&(dal_scheme){.count = 2, .substeps = zero}, "sub-step 1: fraction = 0");
    check_invalid(&(dal_scheme){.count = 2, .substeps = outside}, "sub-step 1: beta = 1.25");
    check_invalid(&(dal_scheme){.count = 1, .substeps = unknown}, "sub-step 0: beta");
    check_invalid(&(dal_scheme){.count = 1, .substeps = infinite}, "fraction = inf");
    check_invalid(&(dal_scheme){.count = 2, .substeps = two, .nodes = DAL_KEPT_NODES},
                  "scheme.count = 2");
    check_invalid(&(dal_scheme){.nodes = (dal_nodes)3}, "nodes = 3");
    CHECK(dal__beta_check(&(dal_scheme){.count = 2, .substeps = two}, NULL) == DAL_SUCCESS);
    CHECK(dal__beta_check(&(dal_scheme){.count = 3, .substeps = thirds}, NULL) == DAL_SUCCESS);
    CHECK(dal__beta_check(&(dal_scheme){0}, NULL) == DAL_SUCCESS); /* explicit */
}

/* Of a constant mass with linear constraints and a force of t and q alone, pairs are one stage. */
static void test_usual(void)
{
    const double mass[4] = {1, 0, 0, 1};
    for (int k = 0; k < 6; k++) {
        const dal_system_def def = {
            .n = 2, .m = k >= 4, .mass = k == 1 ? NULL : mass,
            .lagrangian = k == 1 ? never_lagrangian : NULL,
            .force = k == 2 || k == 3 ? never_force : NULL, .positional = k == 3,
            .kind = k == 4 ? DAL_AFFINE : DAL_LINEAR,
            .constraint = k >= 4 ? never_constraint : NULL,
        };
        dal_system *const system = new_system(&def);
        const bool apart = k == 1 || k == 2 || k == 4;
        CHECK(strcmp(dal_scheme_usual(system), apart ? "midpoint" : "leapfrog") == 0);
        release(system);
    }
    CHECK(strcmp(dal_scheme_usual(NULL), "leapfrog") == 0);
}

static void test_explicit_and_shift(void)
{
    dal_system *const system = open_system("particle_oscillator");
    const dal_substep halves[] = {{0.0, 0.5}, {0.0, 0.5}}, one[] = {{0.25, 1.0}};
    const dal_scheme twice = {.count = 2, .substeps = halves};
    const dal_scheme single = {.count = 1, .substeps = one};
    double shift = 7.0;
    for (size_t i = 0; i < NAMES; i++) {
        const dal_scheme s = find_scheme(names[i]);
        CHECK(dal_scheme_is_explicit(&s, system) == (strncmp(names[i], "explicit", 8) == 0));
        const int status = dal_scheme_shift(&s, &shift);
        CHECK(status == (s.count > 1 || s.family ? DAL_EUNSUPPORTED : DAL_SUCCESS));
        CHECK(status != DAL_SUCCESS || shift == 1.0 - s.beta);
    }
    CHECK(dal_scheme_is_explicit(&twice, system) == 1);
    CHECK(dal_scheme_is_explicit(NULL, system) == 0 && dal_scheme_is_explicit(&twice, NULL) == 0);
    /* not of a mass that is not constant, nor with a force, nor with a nonlinear constraint */
    const double mass[4] = {1, 0, 0, 1};
    dal_system_def def = {.n = 2, .mass = mass};
    for (int k = 0; k < 4; k++) {
        def.mass = k == 1 ? NULL : mass;
        def.lagrangian = k == 1 ? never_lagrangian : NULL;
        def.force = k == 2 ? never_force : NULL;
        def.m = k == 3;
        def.constraint = k == 3 ? never_constraint : NULL;
        def.kind = k == 3 ? DAL_NONLINEAR : DAL_LINEAR;
        dal_system *const other = new_system(&def);
        CHECK(dal_scheme_is_explicit(&twice, other) == (k == 0));
        release(other);
    }
    CHECK(dal_scheme_is_explicit(&single, system) == 0);
    const dal_scheme pair = find_scheme("pair:0:0");
    CHECK(dal_scheme_is_explicit(&pair, system) == 0);
    CHECK(dal_scheme_shift(&pair, &shift) == DAL_EUNSUPPORTED);
    CHECK(dal_scheme_shift(&single, &shift) == DAL_SUCCESS && shift == 0.75);
    CHECK(dal_scheme_shift(&twice, &shift) == DAL_EUNSUPPORTED && shift == 0.75);
    CHECK(dal_scheme_shift(NULL, &shift) == DAL_EINVAL);
    CHECK(dal_scheme_shift(&single, NULL) == DAL_EINVAL);
}

int main(void)
{
    test_table();
    test_compositions();
    test_names();
    test_validation();
    test_usual();
    test_explicit_and_shift();
    return check_done();
}
