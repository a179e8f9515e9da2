/* The record of a failure: which number of a callback it is about, and the words for it. */
#include "fixtures.h"
#include "check.h"

static const char *output;    /* that is not finite */
static size_t entry;
static int good;              /* calls that ask for it, before */

static int potential(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const int returned = uneven_potential(t, q, V, V_q, V_qq, ctx);
    double *const wanted = strcmp(output, "V_q") == 0 ? V_q : V_qq;
    if (wanted && good-- <= 0) wanted[entry] = (double)INFINITY;
    return returned;
}

static int constraint(double t, const double *q, const double *v, double *phi, double *phi_v,
                      double *phi_q, double *phi_t, void *ctx)
{
    const int returned = uneven_constraint(t, q, v, phi, phi_v, phi_q, phi_t, ctx);
    if (phi_v && strcmp(output, "phi_v") == 0 && good-- <= 0) phi_v[entry] = -(double)INFINITY;
    return returned;
}

static dal_system *make(void)
{
    static const double mass[9] = {2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.75};
    const dal_system_def def = {.n = 3, .m = 1, .mass = mass, .potential = potential,
                                .constraint = constraint};
    return new_system(&def);
}

/* text[begin..end) is words, and row, column and value are those of the entry. */
static void is_about(const dal_error *error, const char *words, size_t row, size_t column)
{
    CHECK(error->status == DAL_EDOMAIN && error->output && strcmp(error->output, output) == 0);
    CHECK(error->row == row && error->column == column && isinf(error->value));
    CHECK(error->end - error->begin == strlen(words));
    CHECK(strncmp(error->text + error->begin, words, strlen(words)) == 0);
    CHECK(strncmp(error->text + error->end, " = ", 3) == 0);
}

/* In a run, where words about the step stand before those about the entry. */
static void test_run(void)
{
    static const double x[6] = {0.0, 0.0, 0.0, 1.0, 0.0, 1.0};
    static const struct {
        const char *output, *words;
        size_t entry, row, column;
    } cases[] = {{"V_q", "potential: V_q[0,1]", 1, 0, 1},
                 {"phi_v", "constraint: phi_v[0,2]", 2, 0, 2}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        good = 1000;
        output = cases[i].output;
        entry = cases[i].entry;
        dal_system *const system = make();
        dal_stepper *const stepper = open_named(system, "midpoint");
        need(dal_stepper_start(stepper, 0.0, 0.1, x, DAL_CHECK, DAL_INITIAL_NONE), "start", "");
        const dal_error *const error = dal_stepper_error(stepper);
        CHECK(error->text[0] == '\0' && !error->output && error->status == DAL_SUCCESS);
        good = 20;
        CHECK(dal_advance(stepper, 100, NULL, NULL) == DAL_EDOMAIN);
        CHECK(strncmp(error->text, "step ", 5) == 0 && error->begin > 5);
        is_about(error, cases[i].words, cases[i].row, cases[i].column);
        /* the next failure, which is about nothing of this kind, forgets it */
        CHECK(dal_stepper_start(stepper, 0.0, (double)NAN, x, DAL_CHECK, DAL_INITIAL_NONE)
              == DAL_EINVAL);
        CHECK(!error->output && error->end == 0 && strstr(error->text, "h = nan"));
        release(system);
    }
}

/* Without words before; and what the check finds wrong. */
static void test_check(void)
{
    static const double x[6] = {0.0, 0.0, 0.0, 1.0, 0.0, 1.0};
    dal_check check;
    dal_error error;
    output = "V_qq";
    entry = 8;
    good = 0;
    dal_system *const system = make();
    CHECK(dal_system_check(system, 0.0, x, &check, &error) == DAL_EDOMAIN);
    is_about(&error, "potential: V_qq[2,2]", 2, 2);
    is_about(&check.finding, "potential: V_qq[2,2]", 2, 2);
    good = 1000;
    CHECK(dal_system_check(system, 0.0, x, &check, &error) == DAL_SUCCESS);
    CHECK(error.text[0] == '\0' && !error.output);
    CHECK(check.passed && check.finding.status == DAL_SUCCESS);
    CHECK(check.finding.output && strcmp(check.finding.output, "D") == 0);
    CHECK(strncmp(check.finding.text + check.finding.begin, "D is not integrable", 19) == 0);
    CHECK(check.finding.end == strlen(check.finding.text));
}

int main(void)
{
    test_run();
    test_check();
    return check_done();
}
