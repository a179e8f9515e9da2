/* Saving and restoring: a run that is made in legs, each by another process, which knows nothing
 * but the numbers that were saved, has the bits of the run that was never stopped.  And numbers
 * that are not those: they are refused in words, or are a state as good as any.
 *
 * With an argument this program is the other process: it reads legs and writes what became of
 * them. */
#define _POSIX_C_SOURCE 200809L
#include "fixtures.h"
#include "check.h"

#include <unistd.h>

enum { MOST_SAVED = 200, MOST_M = 4, MOST_2N = 16, LEGS = 20 };

/* ---- what is stepped ------------------------------------------------------------------------ */

/* uneven_edge, pushed around and braked, and turned by an input. */
static const double turn = 0.3;
static int push(double t, const double *q, const double *v, const double *u, double *f, double *f_q,
                double *f_v, void *ctx)
{
    (void)ctx;
    if (f) {
        f[0] = sin(t) - 0.1 * v[0];
        f[1] = cos(q[0]) - 0.1 * v[1];
        f[2] = u[0] - 0.05 * v[2];
    }
    if (f_q) {
        memset(f_q, 0, 9 * sizeof *f_q);
        f_q[3] = -sin(q[0]);
    }
    if (f_v) {
        memset(f_v, 0, 9 * sizeof *f_v);
        f_v[0] = f_v[4] = -0.1;
        f_v[8] = -0.05;
    }
    return 0;
}

/* uneven_edge on an incline that swings. */
static int swing(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const int returned = uneven_potential(t, q, V, V_q, V_qq, ctx);
    if (V) *V += sin(t) * q[1];
    if (V_q) V_q[1] += sin(t);
    return returned;
}

/* Built-in systems by their number; then those of the fixtures. */
enum { GENERIC4, UNEVEN, PUSHED, SWINGING, NONLINEAR, FIXTURES };

static dal_system *open_numbered(size_t which)
{
    const size_t count = dal_builtin_count();
    if (which < count) return open_system(dal_builtin_name(which));
    if (which - count == GENERIC4) return open_system("generic4");
    if (which - count == UNEVEN) return open_system("uneven_edge");
    dal_system *const base = open_system(which - count == NONLINEAR ? "generic4" : "uneven_edge");
    dal_system_def def = base->def;
    if (which - count == PUSHED) {
        def.force = push;
        def.inputs = 1;
        def.input_names = NULL;
    } else {
        def.potential = swing;
    }
    def.time_dependent = def.potential == swing;
    return which - count == NONLINEAR ? open_deformed_nodes(base, 0.01) : new_system(&def);
}

/* Named schemes by their number; then these. */
static const dal_flow_scheme rodas = {.method = DAL_FLOW_RODAS, .tolerance = 1e-6};
static const char *const others[] = {"pair:0.25:0.5", "pair:0.5:0.5", "reference"};

static size_t scheme_count(void) { return schemes_for_callbacks() + DAL_LENGTH(others); }

static dal_scheme numbered_scheme(size_t which)
{
    dal_scheme scheme;
    if (which < schemes_for_callbacks() && dal_scheme_at(&scheme, which) == DAL_SUCCESS)
        return scheme;
    scheme = find_scheme(others[which - schemes_for_callbacks()]);
    if (strcmp(scheme.name, "reference") == 0) scheme.data = &rodas;
    return scheme;
}

static dal_initial initial_of(const dal_scheme *scheme)
{
    return scheme->nodes == DAL_KEPT_NODES ? DAL_INITIAL_PROJECT : DAL_INITIAL_NONE;
}

/* x[2n] in D, moving: some systems start at rest. */
static void state_of(const dal_system *system, double *x)
{
    const size_t n = dal_system_n(system);
    dal_mechanics *const mechanics = open_mechanics(system);
    need(dal_system_n(system) <= MOST_2N / 2 ? DAL_SUCCESS : DAL_EINVAL, "state", "too large");
    if (dal_system_state(system, x)) /* one that is made from generic4 */
        generic4_state(x);
    for (size_t i = 0; i < n; i++) x[n + i] += 0.1 + 0.03 * (double)i;
    need(dal_project(mechanics, 0.0, 0.0, x, NULL), "state", dal_mechanics_error(mechanics)->text);
}

static bool same_stats(const dal_stats *a, const dal_stats *b)
{
    return a->steps == b->steps && a->substeps == b->substeps && a->iterations == b->iterations
        && a->constraint_calls == b->constraint_calls && a->potential_calls == b->potential_calls
        && a->lagrangian_calls == b->lagrangian_calls && a->force_calls == b->force_calls
        && a->evaluations == b->evaluations && a->corrections == b->corrections
        && a->full_newtons == b->full_newtons && a->halvings == b->halvings
        && a->worst_residual == b->worst_residual && a->initial_residual == b->initial_residual
        && a->initial_correction == b->initial_correction && a->differenced == b->differenced
        && a->scaled == b->scaled && a->unscaled == b->unscaled
        && a->uncontrolled == b->uncontrolled
        && a->jump_step == b->jump_step && a->jump == b->jump
        && a->largest_kinetic == b->largest_kinetic && a->least_pivot == b->least_pivot
        && a->least_pivot_t == b->least_pivot_t && a->least_pivot_rows == b->least_pivot_rows
        && a->rank_doubts == b->rank_doubts;
}

/* ---- legs ----------------------------------------------------------------------------------- */

typedef struct leg {
    size_t system, scheme;
    size_t steps, saved; /* 0: the leg starts */
    double h, values[MOST_SAVED];
} leg;

typedef struct outcome {
    int status;
    char message[508];
    size_t saved;
    double t, values[MOST_SAVED], x[MOST_2N], reaction[MOST_M];
    dal_stats stats;
} outcome;

/* From the numbers of a leg to those after it, with a system and a stepper of its own. */
static outcome walk(const leg *l)
{
    dal_system *const system = open_numbered(l->system);
    const dal_scheme scheme = numbered_scheme(l->scheme);
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    outcome o = {0};
    double x[MOST_2N];
    state_of(system, x);
    o.status = l->saved > 0 ? dal_stepper_restore(stepper, l->values, l->saved)
                            : dal_stepper_start(stepper, 0.5, l->h, x, DAL_CHECK,
                                                initial_of(&scheme));
    if (!o.status && l->saved == 0) o.status = dal_stepper_input(stepper, &turn);
    if (!o.status) o.status = dal_advance(stepper, l->steps, o.reaction, NULL);
    snprintf(o.message, sizeof o.message, "%s", dal_stepper_error(stepper)->text);
    o.saved = dal_stepper_saved(stepper);
    if (o.saved > MOST_SAVED || dal_stepper_save(stepper, o.values)) exit(2);
    o.t = dal_stepper_time(stepper);
    memcpy(o.x, dal_stepper_state(stepper), 2 * dal_system_n(system) * sizeof *x);
    dal_stepper_stats(stepper, &o.stats);
    release(system);
    return o;
}

/* ---- the other process ---------------------------------------------------------------------- */

static FILE *to_other, *from_other;

static int be_the_other(void)
{
    leg l;
    while (fread(&l, sizeof l, 1, stdin) == 1) {
        const outcome o = walk(&l);
        if (fwrite(&o, sizeof o, 1, stdout) != 1 || fflush(stdout)) return 2;
    }
    return 0;
}

static void start_the_other(const char *program)
{
    int there[2], back[2];
    if (pipe(there) || pipe(back)) exit(2);
    const pid_t process = fork();
    if (process < 0) exit(2);
    if (process == 0) {
        dup2(there[0], STDIN_FILENO);
        dup2(back[1], STDOUT_FILENO);
        close(there[1]);
        close(back[0]);
        execl(program, program, "legs", (char *)NULL);
        _exit(2);
    }
    close(there[0]);
    close(back[1]);
    to_other = fdopen(there[1], "w");
    from_other = fdopen(back[0], "r");
    if (!to_other || !from_other) exit(2);
}

static outcome walk_there(const leg *l)
{
    outcome o;
    if (fwrite(l, sizeof *l, 1, to_other) != 1 || fflush(to_other)
        || fread(&o, sizeof o, 1, from_other) != 1) {
        fprintf(stderr, "the other process is gone\n");
        exit(2);
    }
    return o;
}

/* ---- the same bits -------------------------------------------------------------------------- */

static struct {
    size_t jumps, failures, full_newtons, evaluations, forces;
} seen;

/* One run in one go, and in legs of which every other one is made there. */
static void check_legs(size_t which_system, size_t which_scheme, double h, size_t steps)
{
    enum { ROWS = LEGS + 1 };
    dal_system *const system = open_numbered(which_system);
    const dal_scheme scheme = numbered_scheme(which_scheme);
    const size_t N = 2 * dal_system_n(system), m = dal_system_m(system);
    dal_stepper *const stepper = open_stepper(system, &scheme, NULL);
    double x[MOST_2N], rows[ROWS * MOST_2N], reactions[LEGS * MOST_M] = {0};
    char where[120];
    dal_stats stats;
    size_t done = 0;
    snprintf(where, sizeof where, "%s by %s, h = %g", dal_system_name(system), scheme.name, h);
    state_of(system, x);
    need(dal_stepper_start(stepper, 0.5, h, x, DAL_CHECK, initial_of(&scheme)), where,
         dal_stepper_error(stepper)->text);
    CHECK(dal_stepper_input(stepper, &turn) == 0);
    const int status =
        dal_integrate(stepper, LEGS * steps, steps, rows, reactions, NULL, NULL, &done);
    leg l = {.system = which_system, .scheme = which_scheme, .h = h};
    outcome o = walk(&l); /* the start alone */
    for (size_t k = 0; k < LEGS && !o.status; k++) {
        l.steps = steps;
        l.saved = o.saved;
        memcpy(l.values, o.values, sizeof l.values);
        o = k % 2 == 0 ? walk_there(&l) : walk(&l);
        if (o.status) break;
        check_true(memcmp(o.x, rows + (k + 1) * N, N * sizeof *x) == 0, "states", where, (int)k);
        check_true(memcmp(o.reaction, reactions + k * m, m * sizeof *x) == 0, "reactions", where,
                   (int)k);
    }
    check_true(o.status == status, "status", where, __LINE__);
    if (status == DAL_SUCCESS) { /* dal_integrate looks at the energy in the end */
        need(dal_stepper_restore(stepper, o.values, o.saved), where,
             dal_stepper_error(stepper)->text);
        CHECK(dal_integrate(stepper, 0, 1, NULL, NULL, NULL, NULL, NULL) == 0);
        dal_stepper_stats(stepper, &o.stats);
        state_of(system, x);
        CHECK(dal_stepper_start(stepper, 0.5, h, x, DAL_CHECK, initial_of(&scheme)) == 0);
        CHECK(dal_integrate(stepper, LEGS * steps, steps, NULL, NULL, NULL, NULL, NULL) == 0);
    }
    dal_stepper_stats(stepper, &stats);
    check_true(same_stats(&stats, &o.stats), "statistics", where, __LINE__);
    check_true(memcmp(o.x, dal_stepper_state(stepper), N * sizeof *x) == 0, "state", where,
               __LINE__);
    check_true(o.t == dal_stepper_time(stepper), "time", where, __LINE__);
    if (status) CHECK(strcmp(o.message, dal_stepper_error(stepper)->text) == 0);
    seen.jumps += stats.jump_step > 0;
    seen.failures += status != 0;
    seen.full_newtons += stats.full_newtons;
    seen.evaluations += stats.evaluations;
    seen.forces += stats.force_calls;
    release(system);
}

static void test_same_bits(void)
{
    const size_t systems = dal_builtin_count() + FIXTURES;
    for (size_t s = 0; s < systems; s += brief() ? 5 : 1)
        for (size_t j = 0; j < scheme_count(); j++) {
            const dal_scheme scheme = numbered_scheme(j);
            /* expensive steps are fewer, but for a few systems */
            const bool expensive = scheme.family || scheme.count > 2;
            const bool all = s < 2 || s == dal_builtin_count() + GENERIC4;
            check_legs(s, j, 0.01, expensive && !all ? 10 : 100);
        }
    /* where steps fail, and the full Newton takes over */
    for (size_t j = 0; j < scheme_count(); j++) {
        const dal_scheme scheme = numbered_scheme(j);
        if (!scheme.family) check_legs(dal_builtin_count() + GENERIC4, j, 1.05, 20);
        if (!scheme.family) check_legs(dal_builtin_count() + PUSHED, j, 0.9, 20);
    }
    /* h^2 k = 2 is much for a leapfrog: the energy jumps, which is seen in the middle of a leg */
    size_t oscillator = 0;
    while (strcmp(dal_builtin_name(oscillator), "particle_oscillator") != 0) oscillator++;
    for (size_t j = 0; j < scheme_count(); j++)
        if (strcmp(numbered_scheme(j).name, "leapfrog") == 0) check_legs(oscillator, j, 1.0, 100);
    CHECK(seen.jumps > 0 && seen.failures > 0 && seen.full_newtons > 0);
    CHECK(seen.evaluations > 0 && seen.forces > 0);
}

/* ---- numbers that are not those ------------------------------------------------------------- */

/* Where a stepper stands, as it says itself. */
typedef struct standing {
    double values[MOST_SAVED], t;
    dal_stats stats;
} standing;

static standing standing_of(dal_stepper *stepper)
{
    standing s = {.t = dal_stepper_time(stepper)};
    need(dal_stepper_save(stepper, s.values), "save", dal_stepper_error(stepper)->text);
    dal_stepper_stats(stepper, &s.stats);
    return s;
}

static bool same_standing(const standing *a, const standing *b)
{
    return memcmp(a->values, b->values, sizeof a->values) == 0 && a->t == b->t
        && same_stats(&a->stats, &b->stats);
}

/* Refused in words, and nothing has happened. */
static void refused(dal_stepper *stepper, const double *values, size_t count, const char *words)
{
    const standing before = standing_of(stepper);
    CHECK(dal_stepper_restore(stepper, values, count) == DAL_EINVAL);
    const char *const text = dal_stepper_error(stepper)->text;
    check_true(strstr(text, words) != NULL, text, words, __LINE__);
    const standing after = standing_of(stepper);
    CHECK(same_standing(&before, &after));
}

/* What stands where among the saved numbers; x follows the head. */
enum { SAVED_VERSION, SAVED_N, SAVED_M, IDENTITY, CONTROL, T0, H, TAKEN, BEGUN, KEEPS, KEPT,
       FIRST_COUNT, LAST_COUNT = 28, LOOKING = 32, SHIFT, ENERGY, KINETIC, JUMP_STEP, JUMP, UNDONE,
       SINCE = 45, RANK_ROWS = 48, RANK_DOUBTS, RANGE, HEAD = 52 };

/* Whether nothing but a refusal will do; the words are those that it has to have. */
static bool is_hopeless(size_t i, double spoil, char words[32])
{
    const bool energy = (ENERGY <= i && i <= JUMP && i != JUMP_STEP) || i == KEPT || i == UNDONE
                     || i == RANGE || i == RANGE + 1;
    const bool counter = i == TAKEN || i == JUMP_STEP || (FIRST_COUNT <= i && i <= LAST_COUNT)
                      || i == BEGUN || i == RANK_ROWS || i == RANK_DOUBTS || i == SINCE;
    snprintf(words, 32, "values[%zu]", i);
    if (i == SAVED_VERSION || i == CONTROL) return true;
    if (i <= IDENTITY) {
        snprintf(words, 32, "another system or scheme");
        return true;
    }
    if (i == KEEPS) snprintf(words, 32, "the saved state has keep_energy");
    if (i == KEEPS) return spoil != 0.0;
    if (isnan(spoil) || (isinf(spoil) && !energy)) return true;
    if (i == T0 || i == H) {
        snprintf(words, 32, i == T0 ? "does not change t0" : "h = ");
        return i == T0 ? fabs(spoil) == 1e300 : fabs(spoil) < 1e-300;
    }
    return (counter || i == LOOKING) && spoil != 0.0;
}

/* The stepper at home is saved; every number of it is spoiled in turn and handed to the stepper
 * abroad, which refuses it and stands as before, or stands at a state that is finite, as its next
 * one is; and then takes the good numbers. */
static void check_spoiled(dal_stepper *home, dal_stepper *abroad, size_t N)
{
    static const double spoils[] = {NAN, INFINITY, -INFINITY, -1.0, 0.5, 0.0, 1e300, -1e300,
                                    1e-310};
    const standing good = standing_of(home);
    const size_t count = dal_stepper_saved(home);
    double next[MOST_2N];
    CHECK(dal_stepper_saved(abroad) == count && count >= HEAD + N);
    CHECK(dal_step(home, NULL) == 0);
    memcpy(next, dal_stepper_state(home), N * sizeof *next);
    for (size_t i = 0; i < count; i++)
        for (size_t k = 0; k < DAL_LENGTH(spoils); k++) {
            standing spoiled = good;
            char words[32];
            if (spoils[k] == good.values[i]) continue;
            spoiled.values[i] = spoils[k];
            if (is_hopeless(i, spoils[k], words)) {
                refused(abroad, spoiled.values, count, words);
                continue;
            }
            const standing before = standing_of(abroad);
            const int status = dal_stepper_restore(abroad, spoiled.values, count);
            const standing after = standing_of(abroad);
            if (status) { /* of the family's numbers */
                CHECK(status == DAL_EINVAL && i >= HEAD + N);
                CHECK(strstr(dal_stepper_error(abroad)->text, "state of the scheme") != NULL);
                CHECK(same_standing(&before, &after));
                continue;
            }
            CHECK(memcmp(after.values, spoiled.values, (HEAD + N) * sizeof *next) == 0);
            CHECK(isfinite(dal_stepper_time(abroad)));
            double state[MOST_2N];
            memcpy(state, dal_stepper_state(abroad), N * sizeof *state);
            CHECK(dal__all_finite(N, state));
            if (dal_step(abroad, NULL))
                CHECK(memcmp(state, dal_stepper_state(abroad), N * sizeof *state) == 0);
            CHECK(dal__all_finite(N, dal_stepper_state(abroad)));
            CHECK(dal_stepper_restore(abroad, good.values, count) == 0);
            CHECK(dal_step(abroad, NULL) == 0);
            CHECK(memcmp(next, dal_stepper_state(abroad), N * sizeof *next) == 0);
        }
    standing full = good;
    full.values[TAKEN] = 0x1p53; /* of which no next step has a number */
    refused(abroad, full.values, count, "fewer than 2^53 steps");
    for (size_t k = 0; k <= count + 1; k++) {
        double longer[MOST_SAVED + 1] = {0.0};
        memcpy(longer, good.values, sizeof good.values);
        char words[32];
        snprintf(words, sizeof words, "count = %zu", k);
        if (k != count) refused(abroad, longer, k, words);
    }
}

static void test_spoiled(void)
{
    static const struct {
        const char *system, *scheme;
        const dal_flow_scheme *data;
    } cases[] = {{"generic4", "leapfrog", NULL},        {"generic4", "midpoint", NULL},
                 {"particle", "midpoint-nodes", NULL},  {"generic4", "midpoint-suzuki4", NULL},
                 {"genmass", "midpoint", NULL},         {"ball_on_table", "leapfrog-kl6", NULL},
                 {"generic4", "pair:0.25:0.5", NULL},   {"particle_oscillator", "reference", NULL},
                 {"generic4", "reference", &rodas}};
    for (size_t k = 0; k < DAL_LENGTH(cases); k++) {
        dal_system *const system = open_system(cases[k].system);
        dal_scheme scheme = find_scheme(cases[k].scheme);
        scheme.data = cases[k].data;
        dal_stepper *const home = open_stepper(system, &scheme, NULL);
        dal_stepper *const abroad = open_stepper(system, &scheme, NULL);
        double x[MOST_2N];
        state_of(system, x);
        CHECK(dal_stepper_start(home, 0.5, 0.01, x, DAL_CHECK, initial_of(&scheme)) == 0);
        CHECK(dal_stepper_start(abroad, 0.0, -0.02, x, DAL_CHECK, initial_of(&scheme)) == 0);
        CHECK(dal_advance(home, 70, NULL, NULL) == 0 && dal_advance(abroad, 7, NULL, NULL) == 0);
        check_spoiled(home, abroad, 2 * dal_system_n(system));
        release(system);
    }
}

/* A stepper at the state of its system, moved on. */
static dal_stepper *moving(const dal_system *system, const dal_scheme *scheme)
{
    dal_stepper *const stepper = open_stepper(system, scheme, NULL);
    double x[MOST_2N];
    state_of(system, x);
    need(dal_stepper_start(stepper, 0.0, 0.01, x, DAL_CHECK, initial_of(scheme)), scheme->name,
         dal_stepper_error(stepper)->text);
    need(dal_advance(stepper, 3, NULL, NULL), scheme->name, dal_stepper_error(stepper)->text);
    return stepper;
}

/* Numbers of one scheme are refused by every other. */
static void test_other_schemes(void)
{
    enum { MOST = 32 };
    static const dal_flow_scheme loose = {.method = DAL_FLOW_RK8PD, .tolerance = 1e-9};
    static const dal_pair maps = {{.beta = 0.5}, {.beta = 0.75}};
    dal_system *const system = open_system("particle");
    dal_scheme schemes[MOST];
    size_t count = 0;
    for (size_t j = 0; j < scheme_count(); j++) schemes[count++] = numbered_scheme(j);
    schemes[count++] = find_scheme("0.3");
    schemes[count] = find_scheme("reference");
    schemes[count++].data = &loose;
    schemes[count] = find_scheme("pair:0.25:0.5");
    schemes[count++].data = &maps; /* which holds, whatever the name says */
    for (size_t j = 0; j < count; j++) {
        dal_stepper *const one = moving(system, &schemes[j]);
        const standing s = standing_of(one);
        for (size_t k = 0; k < count; k++) {
            dal_stepper *const other = moving(system, &schemes[k]);
            if (j == k) CHECK(dal_stepper_restore(other, s.values, dal_stepper_saved(one)) == 0);
            else refused(other, s.values, dal_stepper_saved(one), "scheme");
            release(other);
        }
        release(one);
    }
}

/* Numbers of one system are refused by every other, also one that has only other parameters, or
 * another mass. */
static void test_other_systems(void)
{
    const dal_scheme scheme = find_scheme("leapfrog");
    dal_system *systems[24];
    size_t count = 0;
    for (; count < dal_builtin_count() + FIXTURES; count++)
        if (count != dal_builtin_count() + PUSHED) /* a force is no number */
            systems[count] = open_numbered(count);
        else systems[count] = NULL;
    const char *const name = "k1";
    const double stiffness = 3.0, mass[9] = {2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.8};
    systems[count++] = open_builtin("particle_oscillator", 1, &name, &stiffness);
    dal_system_def def = systems[dal_builtin_count() + UNEVEN]->def;
    def.mass = mass;
    systems[count++] = new_system(&def);
    for (size_t j = 0; j < count; j++) {
        if (!systems[j]) continue;
        dal_stepper *const one = moving(systems[j], &scheme);
        const standing s = standing_of(one);
        for (size_t k = 0; k < count; k++) {
            if (!systems[k]) continue;
            dal_stepper *const other = moving(systems[k], &scheme);
            if (j == k) CHECK(dal_stepper_restore(other, s.values, dal_stepper_saved(one)) == 0);
            else refused(other, s.values, dal_stepper_saved(one), "another system or scheme");
            release(other);
        }
        release(one);
    }
}

/* Nothing to save, nothing to restore. */
static void test_refusals(void)
{
    static const dal_flow_scheme adams = {.method = DAL_FLOW_MSADAMS};
    dal_system *const system = open_system("particle");
    dal_scheme scheme = find_scheme("leapfrog");
    dal_stepper *const fresh = open_stepper(system, &scheme, NULL);
    double values[MOST_SAVED] = {7.0};
    CHECK(dal_stepper_save(fresh, values) == DAL_EINVAL && values[0] == 7.0);
    CHECK(strstr(dal_stepper_error(fresh)->text, "not started") != NULL);
    CHECK(dal_stepper_save(fresh, NULL) == DAL_EINVAL);
    CHECK(dal_stepper_restore(fresh, NULL, 40) == DAL_EINVAL);
    CHECK(strstr(dal_stepper_error(fresh)->text, "values is NULL") != NULL);
    CHECK(dal_stepper_restore(fresh, values, 40) == DAL_EINVAL && dal_step(fresh, NULL) < 0);
    CHECK(dal_stepper_save(NULL, values) == DAL_EINVAL);
    CHECK(dal_stepper_restore(NULL, values, 40) == DAL_EINVAL);

    scheme = find_scheme("reference");
    scheme.data = &adams;
    dal_stepper *const multistep = moving(system, &scheme);
    double x[6], y[6];
    memcpy(x, dal_stepper_state(multistep), sizeof x);
    CHECK(dal_stepper_saved(multistep) == 0);
    for (int k = 0; k < 2; k++) {
        CHECK((k ? dal_stepper_restore(multistep, values, 1) : dal_stepper_save(multistep, values))
              == DAL_EUNSUPPORTED);
        CHECK(strstr(dal_stepper_error(multistep)->text, "\"reference\"") != NULL);
        CHECK(strstr(dal_stepper_error(multistep)->text, "multistep") != NULL);
    }
    memcpy(y, dal_stepper_state(multistep), sizeof y);
    CHECK(memcmp(x, y, sizeof x) == 0 && values[0] == 7.0);
}

/* ---- after a failure ------------------------------------------------------------------------ */

/* V = q^2/2, not a number while that is so. */
static int sprung(double t, const double *q, double *V, double *V_q, double *V_qq, void *ctx)
{
    const bool bad = *(const bool *)ctx;
    if (V) *V = 0.5 * q[0] * q[0];
    if (V_q) V_q[0] = bad ? (double)NAN : q[0];
    if (V_qq) V_qq[0] = 1.0;
    return 0;
}

/* What is saved after a step that failed is a state as any, and goes on as the one that failed. */
static void test_after_failure(void)
{
    const char *const names[] = {"leapfrog", "leapfrog-mirror", "midpoint", "endpoint", "0.3",
                                 "midpoint-kl6"};
    const double mass = 1.0, x0[2] = {1.0, 0.5};
    bool bad = false;
    const dal_system_def def = {.n = 1, .mass = &mass, .potential = sprung, .ctx = &bad};
    dal_system *const system = new_system(&def);
    for (size_t j = 0; j < DAL_LENGTH(names); j++)
        for (size_t steps = 0; steps <= 5; steps += 5) {
            const dal_scheme scheme = find_scheme(names[j]);
            dal_stepper *const two = open_stepper(system, &scheme, NULL);
            dal_stepper *const one = start_stepper(system, &scheme, 0.1, x0);
            CHECK(dal_advance(one, steps, NULL, NULL) == 0);
            bad = true;
            CHECK(dal_step(one, NULL) == DAL_EDOMAIN);
            bad = false;
            const standing s = standing_of(one);
            need(dal_stepper_restore(two, s.values, dal_stepper_saved(one)), names[j],
                 dal_stepper_error(two)->text);
            CHECK(dal_advance(one, 10, NULL, NULL) == 0 && dal_advance(two, 10, NULL, NULL) == 0);
            CHECK(memcmp(dal_stepper_state(one), dal_stepper_state(two), sizeof x0) == 0);
            release(two);
        }
}

int main(int count, char **words)
{
    if (count > 1) return be_the_other();
    start_the_other(words[0]);
    test_same_bits();
    test_spoiled();
    test_other_schemes();
    test_other_systems();
    test_refusals();
    test_after_failure();
    return check_done();
}
