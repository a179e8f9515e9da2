/* A system as an object: what is refused and in which words, what is copied, what it says about
 * itself; and the evaluator, which differences what a callback does not give. */
#include "fixtures.h"
#include "check.h"

static const double unit2[4] = {1, 0, 0, 1};

/* V = q0^2 q1, forms (1, q0). */
static int potential2(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    if (V) *V = q[0] * q[0] * q[1];
    if (V_q) {
        V_q[0] = 2 * q[0] * q[1];
        V_q[1] = q[0] * q[0];
    }
    if (V_qq) {
        V_qq[0] = 2 * q[1];
        V_qq[1] = V_qq[2] = 2 * q[0];
        V_qq[3] = 0.0;
    }
    return 0;
}

static int constraint2(double t, const double *q, const double *v, double *phi, double *phi_v,
                       double *phi_q, double *phi_t, void *ctx)
{
    if (phi) phi[0] = v[0] + q[0] * v[1];
    if (phi_v) {
        phi_v[0] = 1.0;
        phi_v[1] = q[0];
    }
    if (phi_q) {
        phi_q[0] = v[1];
        phi_q[1] = 0.0;
    }
    return 0;
}

static int lagrangian2(double t, const double *q, const double *v, double *L, double *L_q,
                       double *L_v, double *L_qq, double *L_vq, double *L_vv, double *L_vt,
                       void *ctx)
{
    return 0;
}

static int force2(double t, const double *q, const double *v, const double *u, double *f,
                  double *f_q, double *f_v, void *ctx)
{
    (void)t, (void)q, (void)v, (void)f, (void)f_q, (void)f_v, (void)ctx;
    return 0;
}

static int invariant2(double t, const double *x, double *values, void *ctx)
{
    values[0] = x[0] + x[3] - 5.0;
    return x[0] > 100.0 ? 1 : 0;
}

static int exact2(double t, const double *x0, double *x, void *ctx)
{
    (void)ctx;
    if (t < 0.0) return -1;
    for (size_t i = 0; i < 4; i++) x[i] = x0[i] + t;
    return 0;
}

/* ---- validation ------------------------------------------------------------------------- */

static dal_system_def good(void)
{
    return (dal_system_def){.n = 2, .m = 1, .mass = unit2, .potential = potential2,
                            .constraint = constraint2};
}

static void check_refused(const dal_system_def *def, int expected, const char *first,
                          const char *second)
{
    dal_system *system = NULL;
    dal_error error = {0};
    CHECK(dal_system_new(&system, def, &error) == expected && error.status == expected);
    CHECK(system == NULL);
    check_true(strstr(error.text, first) && strstr(error.text, second), error.text, first, 0);
    CHECK(dal_system_new(&system, def, NULL) == expected);
}

#define REFUSED(change, expected, first, second)      \
    do {                                              \
        dal_system_def def_ = good();                 \
        change;                                       \
        check_refused(&def_, expected, first, second); \
    } while (0)

static void test_refused(void)
{
    const double unsymmetric[4] = {1, 0.25, 0.5, 1}, indefinite[4] = {1, 2, 2, 1};
    const double negative[4] = {1, 0, 0, -3}, unknown[4] = {1, 0, NAN, 1};
    const double infinite[4] = {1, 0, 0, INFINITY}, semidefinite[4] = {1, 1, 1, 1};
    const double state[4] = {0, 0, INFINITY, 0};
    const char *const invariants[1] = {"c"};
    REFUSED(def_.n = 0, DAL_EINVAL, "n = 0", "");
    REFUSED(def_.m = 3, DAL_EINVAL, "m = 3", "n = 2");
    REFUSED(def_.m = SIZE_MAX, DAL_EINVAL, "m = 18446744073709551615", "n = 2");
    REFUSED(def_.n = SIZE_MAX, DAL_ENOMEM, "n = 18446744073709551615", "overflows");
    REFUSED(def_.n = (size_t)1 << 31, DAL_ENOMEM, "n = 2147483648", "overflows");
    REFUSED(def_.mass = NULL, DAL_EINVAL, "mass, masses and lagrangian are all NULL", "expected");
    REFUSED(def_.constraint = NULL, DAL_EINVAL, "m = 1", "constraint is NULL");
    REFUSED(def_.m = 0, DAL_EINVAL, "m = 0", "constraint is not NULL");
    REFUSED(def_.missing = 1024, DAL_EINVAL, "missing = 0x400", "outside 0x3ff");
    REFUSED(def_.missing = DAL_MISSING_L_VQ, DAL_EINVAL, "missing = 0x10", "lagrangian is NULL");
    REFUSED(def_.missing = DAL_MISSING_F_V, DAL_EINVAL, "missing = 0x80", "force is NULL");
    REFUSED(def_.mass = unsymmetric, DAL_EINVAL, "mass[1,0] = 0.5", "mass[0,1] = 0.25");
    REFUSED(def_.mass = indefinite, DAL_EINVAL, "pivot 1", "is -3");
    REFUSED(def_.mass = semidefinite, DAL_EINVAL, "pivot 1", "mass[1,1] = 1");
    REFUSED(def_.mass = negative, DAL_EINVAL, "not positive definite", "mass[1,1] = -3");
    REFUSED(def_.mass = unknown, DAL_EINVAL, "mass[1,0] = ", "not finite");
    REFUSED(def_.mass = infinite, DAL_EINVAL, "mass[1,1] = inf", "not finite");
    REFUSED(def_.state = state, DAL_EINVAL, "state", "not finite");
    REFUSED(def_.invariants = 1, DAL_EINVAL, "invariants = 1", "invariant is NULL");
    REFUSED((def_.invariants = 1, def_.invariant = invariant2), DAL_EINVAL, "invariants = 1",
            "invariant_names is NULL");
    REFUSED((def_.invariants = 1, def_.invariant_names = invariants), DAL_EINVAL, "invariants = 1",
            "invariant is NULL");
    REFUSED(def_.kind = (dal_constraint_kind)3, DAL_EINVAL, "kind = 3", "");
    REFUSED((def_.m = 0, def_.constraint = NULL, def_.kind = DAL_AFFINE), DAL_EINVAL, "kind = 1",
            "m = 0");
    REFUSED(def_.lagrangian = lagrangian2, DAL_EINVAL, "lagrangian and mass", "both");
    REFUSED((def_.lagrangian = lagrangian2, def_.mass = NULL), DAL_EINVAL,
            "lagrangian and potential", "both");
    REFUSED((def_.lagrangian = lagrangian2, def_.mass = NULL, def_.potential = NULL,
             def_.missing = DAL_MISSING_V_QQ), DAL_EINVAL, "missing = 0x2", "of a potential");

    dal_system *system = NULL;
    dal_error error = {0};
    const dal_system_def def = good();
    CHECK(dal_system_new(NULL, &def, &error) == DAL_EINVAL && strstr(error.text, "system is NULL"));
    CHECK(dal_system_new(&system, NULL, &error) == DAL_EINVAL && strstr(error.text, "def is NULL"));
    CHECK(dal_system_new(&system, &def, &error) == DAL_SUCCESS && error.text[0] == '\0');
    dal_system_free(system);
    dal_system_free(NULL);
}

/* ---- copies and names --------------------------------------------------------------------- */

static void test_copies(void)
{
    double mass[4] = {2, 0.5, 0.5, 1}, state[4] = {1, 2, 3, 4};
    char name[] = "mine", help[] = "a line", first[] = "a", second[] = "b", integral[] = "c";
    char description[] = "two lines", source[] = "a book", formulas[] = "L = V\nx = 0";
    const char *names[2] = {first, second}, *invariants[1] = {integral};
    dal_system_def def = good();
    def.mass = mass;
    def.state = state;
    def.name = name;
    def.help = help;
    def.description = description;
    def.source = source;
    def.formulas = formulas;
    def.coordinates = names;
    def.invariants = 1;
    def.invariant_names = invariants;
    def.invariant = invariant2;
    def.exact = exact2;
    def.missing = DAL_MISSING_V_QQ;
    def.force = force2;
    dal_system *system = new_system(&def);
    mass[0] = state[0] = 7.0;
    name[0] = help[0] = first[0] = second[0] = integral[0] = '!';
    description[0] = source[0] = formulas[0] = '!';
    names[0] = invariants[0] = NULL;
    memset(&def, 0, sizeof def);

    CHECK(dal_system_n(system) == 2 && dal_system_m(system) == 1);
    CHECK(dal_system_missing(system) == DAL_MISSING_V_QQ);
    CHECK(dal_system_kind(system) == DAL_LINEAR && dal_system_is_forced(system) == 1);
    CHECK(strcmp(dal_system_name(system), "mine") == 0);
    CHECK(strcmp(dal_system_help(system), "a line") == 0);
    CHECK(strcmp(dal_system_description(system), "two lines") == 0);
    CHECK(strcmp(dal_system_source(system), "a book") == 0);
    CHECK(strcmp(dal_system_formulas(system), "L = V\nx = 0") == 0);
    CHECK(strcmp(dal_system_coordinate(system, 0), "a") == 0);
    CHECK(strcmp(dal_system_coordinate(system, 1), "b") == 0);
    CHECK(dal_system_coordinate(system, 2) == NULL);
    CHECK(dal_system_invariants(system) == 1 && dal_system_invariant_name(system, 1) == NULL);
    CHECK(strcmp(dal_system_invariant_name(system, 0), "c") == 0);
    CHECK(mass_of(system)[0] == 2.0 && mass_of(system)[1] == 0.5);
    CHECK(dal_system_parameters(system) == 0 && dal_system_parameter_name(system, 0) == NULL);
    CHECK(isnan(dal_system_parameter(system, 0)));

    double x[4] = {0}, value = NAN;
    CHECK(dal_system_state(system, x) == DAL_SUCCESS && x[0] == 1.0 && x[3] == 4.0);
    CHECK(dal_system_invariant(system, 0.0, x, &value) == DAL_SUCCESS && value == 0.0);
    CHECK(dal_system_exact(system, 2.0, x, x) == DAL_SUCCESS && x[1] == 4.0);
    CHECK(dal_system_exact(system, -1.0, x, x) == DAL_EUSER);
    CHECK(dal_system_exact(system, NAN, x, x) == DAL_EINVAL);
    x[0] = 101.0;
    CHECK(dal_system_invariant(system, 0.0, x, &value) == DAL_EDOMAIN);

    /* What is left out. */
    const double diagonal[9] = {4, 0, 0, 0, 0.5, 0, 0, 0, 8};
    const dal_system_def bare = {.n = 3, .mass = diagonal};
    system = new_system(&bare);
    CHECK(strcmp(dal_system_name(system), "system") == 0 && dal_system_help(system)[0] == '\0');
    CHECK(dal_system_description(system)[0] == '\0' && dal_system_source(system)[0] == '\0');
    CHECK(dal_system_formulas(system)[0] == '\0');
    CHECK(strcmp(dal_system_coordinate(system, 2), "q2") == 0);
    CHECK(dal_system_state(system, x) == DAL_EUNSUPPORTED);
    CHECK(dal_system_exact(system, 1.0, x, x) == DAL_EUNSUPPORTED);
    CHECK(dal_system_invariant(system, 0.0, x, x) == DAL_EUNSUPPORTED);
    CHECK(dal_system_state(NULL, x) == DAL_EINVAL && dal_system_state(system, NULL) == DAL_EINVAL);
    CHECK(system->diagonal && system->mass_inverse[0] == 0.25 && system->mass_inverse[4] == 2.0);
    CHECK(system->mass_inverse[8] == 0.125 && system->mass_inverse[1] == 0.0);
}

/* M M^-1 = 1 to n u times the condition, below 100; M^-1 is symmetric to the bit. */
static void test_inverse(void)
{
    wide w;
    dal_system *const system = open_wide(&w, 12, 3, true, true);
    CHECK(!system->diagonal);
    for (size_t i = 0; i < 12; i++)
        for (size_t j = 0; j < 12; j++) {
            double sum = 0.0;
            for (size_t k = 0; k < 12; k++)
                sum += system->mass[i * 12 + k] * system->mass_inverse[k * 12 + j];
            CHECK_NEAR(sum, i == j ? 1.0 : 0.0, 12 * U * 100);
            CHECK(system->mass_inverse[i * 12 + j] == system->mass_inverse[j * 12 + i]);
        }
}

/* ---- the evaluator ------------------------------------------------------------------------ */

typedef struct workplace {
    evaluator eval;
    arena arena;
} workplace;

static void open_evaluator(workplace *w, const dal_system *system)
{
    *w = (workplace){0};
    dal__evaluator_reserve(&w->eval, system, &w->arena);
    need(dal__allocate(&w->arena, NULL), "arena", "");
    dal__evaluator_bind(&w->eval, system);
}

/* A system like base whose callbacks lack what missing says, and refuse to be asked for it. */
typedef struct lacking {
    const dal_system *base;
    unsigned missing;
    size_t potential_calls, constraint_calls;
} lacking;

static int lacking_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                             void *ctx)
{
    lacking *const l = ctx;
    l->potential_calls++;
    if (V_q && (l->missing & DAL_MISSING_V_Q)) return -7;
    if (V_qq && (l->missing & DAL_MISSING_V_QQ)) return -8;
    return l->base->def.potential(t, q, V, V_q, V_qq, l->base->def.ctx);
}

static int lacking_constraint(double t, const double *q, const double *v, double *phi,
                              double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    lacking *const l = ctx;
    l->constraint_calls++;
    if (phi) return -9; /* never asked for */
    if (phi_q && (l->missing & DAL_MISSING_PHI_Q)) return -10;
    return l->base->def.constraint(t, q, v, phi, phi_v, phi_q, NULL, l->base->def.ctx);
}

/* First derivatives are good to 1e-12 relative, second differences of V to 1e-6, as promised. */
static void check_differences(const char *name, unsigned missing)
{
    enum { N = 4, M = 2 };
    dal_system *const base = open_system(name);
    lacking l = {.base = base, .missing = missing};
    dal_system_def def = base->def;
    def.ctx = &l;
    def.potential = lacking_potential;
    def.constraint = lacking_constraint;
    def.missing = missing;
    def.exact = NULL;
    def.invariants = 0;
    dal_system *system = new_system(&def);
    const size_t n = def.n, m = def.m;
    workplace exact, w;
    open_evaluator(&exact, base);
    open_evaluator(&w, system);
    dal_error error = {0};
    unsigned seed = 23;
    for (int trial = 0; trial < 10; trial++) {
        double q[N], v[N], before[N], V[2], V_q[2][N], V_qq[2][N * N], mu[2][M * N], N_q[2][M * N];
        for (size_t i = 0; i < n; i++) {
            q[i] = 2 * next_number(&seed);
            v[i] = next_number(&seed);
        }
        memcpy(before, q, sizeof before);
        CHECK(dal__potential(&exact.eval, 0.0, q, V, V_q[0], V_qq[0], NULL) == DAL_SUCCESS);
        CHECK(dal__potential(&w.eval, 0.0, q, V + 1, V_q[1], V_qq[1], &error) == DAL_SUCCESS);
        CHECK(dal__constraint(&exact.eval, 0.0, q, v, NULL, mu[0], N_q[0], NULL, NULL)
              == DAL_SUCCESS);
        CHECK(dal__constraint(&w.eval, 0.0, q, v, NULL, mu[1], N_q[1], NULL, &error)
              == DAL_SUCCESS);
        const double scale =
            1 + fabs(V[0]) + sum_of_sizes(n, V_q[0]) + sum_of_sizes(n * n, V_qq[0]);
        const double hessian = missing & DAL_MISSING_V_Q ? 1e-6 : 1e-12;
        CHECK(V[0] == V[1] && largest_difference(m * n, mu[0], mu[1]) == 0.0);
        CHECK_NEAR(largest_difference(n, V_q[0], V_q[1]), 0.0,
                   missing & DAL_MISSING_V_Q ? 1e-12 * scale : 0.0);
        CHECK_NEAR(largest_difference(n * n, V_qq[0], V_qq[1]), 0.0,
                   missing & DAL_MISSING_V_QQ ? hessian * scale : 0.0);
        CHECK_NEAR(largest_difference(m * n, N_q[0], N_q[1]), 0.0,
                   missing & DAL_MISSING_PHI_Q ? 1e-12 * (1 + sum_of_sizes(n, v)) : 0.0);
        CHECK(memcmp(q, before, n * sizeof *q) == 0);
        CHECK(dal__potential(&w.eval, 0.0, q, NULL, V_q[1], NULL, &error) == DAL_SUCCESS);
        CHECK(dal__constraint(&w.eval, 0.0, q, v, NULL, mu[1], NULL, NULL, &error) == DAL_SUCCESS);
    }
    CHECK(w.eval.calls.potential == l.potential_calls && l.potential_calls >= 20);
    CHECK(w.eval.calls.constraint == l.constraint_calls && l.constraint_calls >= 20);
    dal__release(&exact.arena);
    dal__release(&w.arena);
}

static void test_differences(void)
{
    for (unsigned missing = 0; missing < 8; missing++) {
        check_differences("generic4", missing);
        check_differences("robot", missing);
    }
    check_differences("uneven_edge", 7);
}

/* ---- callbacks that misbehave -------------------------------------------------------------- */

typedef struct fault {
    int returned;
    size_t skip;  /* this entry of the output is left alone; 99: none */
    double value; /* or set to value, if that is not 0 */
} fault;

static void spoil(const fault *f, size_t count, double *x)
{
    if (!x) return;
    for (size_t i = 0; i < count; i++)
        if (i != f->skip) x[i] = 1.0;
        else if (f->value != 0.0) x[i] = f->value;
}

static int faulty_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                            void *ctx)
{
    if (V) *V = 1.0;
    spoil(ctx, 3, V_q);
    spoil(ctx, 9, V_qq);
    return ((const fault *)ctx)->returned;
}

static int faulty_constraint(double t, const double *q, const double *v, double *phi,
                             double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    spoil(ctx, 6, phi_v);
    if (phi_q) memset(phi_q, 0, 6 * sizeof *phi_q);
    return ((const fault *)ctx)->returned;
}

static void test_faults(void)
{
    const double mass[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, q[3] = {0}, v[3] = {0};
    fault f = {0, 99, 0.0};
    const dal_system_def def = {.n = 3, .m = 2, .mass = mass, .potential = faulty_potential,
                                .constraint = faulty_constraint, .ctx = &f};
    dal_system *system = new_system(&def);
    workplace w;
    open_evaluator(&w, system);
    dal_error error = {0};
    double V_q[3], V_qq[9], mu[6], N[6];
    CHECK(dal__potential(&w.eval, 0.0, q, NULL, V_q, V_qq, &error) == DAL_SUCCESS);
    CHECK(dal__constraint(&w.eval, 0.0, q, v, NULL, mu, N, NULL, &error) == DAL_SUCCESS
          && mu[5] == 1.0);

    const double values[] = {0.0, NAN, INFINITY, -INFINITY}; /* 0: never written */
    for (size_t k = 0; k < 4; k++) {
        f = (fault){0, 5, values[k]};
        memset(mu, 0, sizeof mu); /* what was there before must not pass for an answer */
        CHECK(dal__constraint(&w.eval, 0.0, q, v, NULL, mu, N, NULL, &error) == DAL_EDOMAIN);
        CHECK(strstr(error.text, "constraint") && strstr(error.text, "phi_v[1,2]"));
        CHECK(dal__potential(&w.eval, 0.0, q, NULL, NULL, V_qq, &error) == DAL_EDOMAIN);
        CHECK(strstr(error.text, "potential") && strstr(error.text, "V_qq[1,2]"));
        f.skip = 1;
        memset(V_q, 0, sizeof V_q);
        CHECK(dal__potential(&w.eval, 0.0, q, NULL, V_q, NULL, &error) == DAL_EDOMAIN);
        CHECK(strstr(error.text, "V_q[0,1]") && error.status == DAL_EDOMAIN);
    }
    f = (fault){4, 99, 0.0};
    CHECK(dal__constraint(&w.eval, 0.0, q, v, NULL, mu, NULL, NULL, &error) == DAL_EDOMAIN);
    CHECK(strstr(error.text, "constraint returned 4") != NULL);
    CHECK(dal__potential(&w.eval, 0.0, q, NULL, V_q, NULL, &error) == DAL_EDOMAIN);
    f.returned = -4;
    CHECK(dal__constraint(&w.eval, 0.0, q, v, NULL, mu, NULL, NULL, &error) == DAL_EUSER);
    CHECK(dal__potential(&w.eval, 0.0, q, NULL, V_q, NULL, &error) == DAL_EUSER);
    CHECK(strstr(error.text, "potential returned -4") != NULL);
    dal__release(&w.arena);

    /* No potential is V = 0. */
    const dal_system_def none = {.n = 3, .mass = mass};
    system = new_system(&none);
    open_evaluator(&w, system);
    double V = 1.0;
    CHECK(dal__potential(&w.eval, 0.0, q, &V, V_q, V_qq, &error) == DAL_SUCCESS);
    CHECK(V == 0.0 && sum_of_sizes(3, V_q) == 0.0 && sum_of_sizes(9, V_qq) == 0.0);
    CHECK(dal__constraint(&w.eval, 0.0, q, v, NULL, NULL, NULL, NULL, &error) == DAL_SUCCESS);
    CHECK(w.eval.calls.potential == 0 && w.eval.calls.constraint == 0);
    dal__release(&w.arena);
}

int main(void)
{
    test_refused();
    test_copies();
    test_inverse();
    test_differences();
    test_faults();
    return check_done();
}
