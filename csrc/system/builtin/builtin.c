/* The built-in systems by name, their parameters, and how one is made. */
#include "system/builtin/builtin.h"

#include <stdio.h>
#include <string.h>

static const builtin *const table[] = {
    &dal__particle,       &dal__particle_oscillator, &dal__knife_edge, &dal__sleigh,
    &dal__sleigh_contact, &dal__disk,                &dal__heisenberg, &dal__contact_oscillator,
    &dal__robot,          &dal__chaotic,             &dal__genmass,    &dal__rolling_disc,
    &dal__ball_on_table,  &dal__snakeboard,          &dal__n_trailer,
};
enum { TABLE_COUNT = sizeof table / sizeof table[0] };

size_t dal_builtin_count(void) { return TABLE_COUNT; }

const char *dal_builtin_name(size_t i) { return i < TABLE_COUNT ? table[i]->name : NULL; }

const char *dal_builtin_help(size_t i) { return i < TABLE_COUNT ? table[i]->help : NULL; }

/* Equal, - and _ being the same. */
static bool same_name(const char *a, const char *b)
{
    for (; *a && *b; a++, b++)
        if ((*a == '-' ? '_' : *a) != (*b == '-' ? '_' : *b)) return false;
    return *a == *b;
}

/* Number of names before the first NULL, which ends every list. */
static size_t count_names(const char *const *names)
{
    size_t count = 0;
    while (names[count]) count++;
    return count;
}

static size_t count_parameters(const builtin *record)
{
    size_t count = 0;
    while (record->parameters[count].name) count++;
    return count;
}

/* Adds a name to the list in text[size]. */
static void append_name(size_t size, char *text, const char *name)
{
    const size_t used = strlen(text);
    snprintf(text + used, size - used, "%s%s", used ? ", " : "", name);
}

static int fail_unknown_system(const char *name, dal_error *error)
{
    char known[400] = "";
    for (size_t i = 0; i < TABLE_COUNT; i++) append_name(sizeof known, known, table[i]->name);
    return dal__fail(error, DAL_EINVAL, "there is no built-in system \"%.60s\"; choose one of: %s",
                     name, known);
}

static int fail_unknown_parameter(const builtin *record, const char *name, dal_error *error)
{
    char known[128] = "";
    for (size_t i = 0; i < count_parameters(record); i++)
        append_name(sizeof known, known, record->parameters[i].name);
    return dal__fail(error, DAL_EINVAL, "%s has no parameter \"%.60s\"; it has %s", record->name,
                     name, known[0] ? known : "none");
}

static int require_in_range(const builtin *record, const parameter *of, double value,
                            dal_error *error)
{
    static const struct {
        const char *words;
        double least;
    } ranges[] = {[POSITIVE] = {"a finite number > 0", DBL_TRUE_MIN},
                  [NOT_NEGATIVE] = {"a finite number >= 0", 0.0},
                  [FINITE] = {"a finite number", -DBL_MAX},
                  [WHOLE] = {"a whole number from 1 to ", 1.0}};
    char most[16] = "";
    bool inside = isfinite(value) && value >= ranges[of->range].least;
    if (of->range == WHOLE) {
        inside = inside && value <= of->most && value == floor(value);
        snprintf(most, sizeof most, "%u", of->most);
    }
    if (inside) return DAL_SUCCESS;
    return dal__fail(error, DAL_EINVAL, "parameter %s of %s = %.15g: expected %s%s", of->name,
                     record->name, value, ranges[of->range].words, most);
}

/* p[MAX_PARAMETERS] with the parameter called name changed to value. */
static int set_parameter(const builtin *record, const char *name, double value, double *p,
                         dal_error *error)
{
    const size_t parameters = count_parameters(record);
    size_t i = 0;
    while (i < parameters && !same_name(name, record->parameters[i].name)) i++;
    if (i == parameters) return fail_unknown_parameter(record, name, error);
    p[i] = value;
    return require_in_range(record, &record->parameters[i], value, error);
}

/* The ctx of a system, of which its callbacks know the parameters alone. */
typedef struct context {
    double p[MAX_PARAMETERS];
    const builtin *record;
} context;

static void find_sizes(const builtin *record, const double *p, size_t *n, size_t *m)
{
    *n = count_names(record->coordinates);
    *m = record->m;
    if (record->sizes) record->sizes(p, n, m);
}

/* A dal_parameters_fn. */
static int fill(double *mass, double *state, const void *ctx)
{
    const context *const of = ctx;
    const builtin *const record = of->record;
    size_t n, m;
    find_sizes(record, of->p, &n, &m);
    if (mass) dal__clear(n * n, mass);
    if (state) dal__clear(2 * n, state);
    if (state && record->state) record->state(of->p, state);
    else if (state) set(state, 2 * n, record->start);
    if (mass && record->mass) record->mass(of->p, mass);
    for (size_t i = 0; mass && !record->mass && i < n; i++) {
        const size_t number = i < MAX_COORDINATES ? record->diagonal[i] : 0;
        mass[i * n + i] = number ? of->p[number - 1] : 1.0;
    }
    return 0;
}

/* DAL_EINVAL if values[parameters] are out of their ranges, or change n or m of the system. */
static int check(const dal_system *system, const double *values, dal_error *error)
{
    const builtin *const record = system->record;
    int status = DAL_SUCCESS;
    for (size_t i = 0; !status && i < system->parameters; i++)
        status = require_in_range(record, &record->parameters[i], values[i], error);
    if (!status && record->check) status = record->check(values, error);
    if (status) return status;
    size_t n, m;
    find_sizes(record, values, &n, &m);
    if (n == system->def.n && m == system->def.m) return DAL_SUCCESS;
    return dal__fail(error, DAL_EINVAL, "the new parameters of %s give n = %zu coordinates and m = "
                     "%zu constraints; expected n = %zu and m = %zu, as before", record->name, n, m,
                     system->def.n, system->def.m);
}

/* A system from its record and its parameters; dal_system_new copies what depends on them. */
static int make(dal_system **system, context *of, dal_error *error)
{
    const builtin *const record = of->record;
    size_t n, m;
    find_sizes(record, of->p, &n, &m);
    arena a = {0};
    double *mass, *state;
    const char **names;
    char(*text)[NAME_SIZE];
    DAL__RESERVE(&a, dal__times(n, n), &mass);
    DAL__RESERVE(&a, 2 * n, &state);
    dal__reserve(&a, &names, n, sizeof *names);
    dal__reserve(&a, &text, n, sizeof *text);
    int status = dal__allocate(&a, error);
    if (status) return status;

    fill(mass, state, of);
    for (size_t i = 0; i < n; i++) {
        if (record->coordinate) record->coordinate(of->p, i, text[i]);
        names[i] = record->coordinate ? text[i] : record->coordinates[i];
    }
    const dal_system_def def = {
        .n = n, .m = m, .mass = record->lagrangian ? NULL : mass,
        .potential = record->potential, .lagrangian = record->lagrangian,
        .constraint = record->constraint, .kind = record->kind, .steady = record->steady,
        .name = record->name, .help = record->help, .description = record->description,
        .source = record->source, .formulas = record->formulas,
        .coordinates = names, .state = state, .ctx = of, .ctx_size = sizeof *of,
        .parameters = fill, .exact = record->exact,
        .invariants = count_names(record->invariants),
        .invariant_names = record->invariants, .invariant = record->invariant,
    };
    status = dal_system_new(system, &def, error);
    dal__release(&a);
    if (status) return status;
    (*system)->record = record;
    (*system)->check = check;
    (*system)->parameters = count_parameters(record);
    return DAL_SUCCESS;
}

size_t dal_system_parameters(const dal_system *system) { return system->parameters; }

const char *dal_system_parameter_name(const dal_system *system, size_t i)
{
    return i < system->parameters ? system->record->parameters[i].name : NULL;
}

double dal_system_parameter(const dal_system *system, size_t i)
{
    return i < system->parameters ? ((const context *)system->def.ctx)->p[i] : (double)NAN;
}

int dal_system_builtin(dal_system **system, const char *name, const char *const *names,
                       const double *values, size_t count, dal_error *error)
{
    int status = DAL__REQUIRE(error, {"system", system}, {"name", name});
    if (status) return status;
    if (count > 0 && (!names || !values))
        return dal__fail(error, DAL_EINVAL, "%s is NULL with count = %zu parameters",
                         names ? "values" : "names", count);
    const builtin *record = NULL;
    for (size_t i = 0; i < TABLE_COUNT && !record; i++)
        if (same_name(name, table[i]->name)) record = table[i];
    if (!record) return fail_unknown_system(name, error);

    context of = {.record = record};
    for (size_t i = 0; i < MAX_PARAMETERS; i++) of.p[i] = record->parameters[i].value;
    for (size_t i = 0; i < count; i++) {
        if (!names[i]) return dal__fail(error, DAL_EINVAL, "names[%zu] is NULL", i);
        status = set_parameter(record, names[i], values[i], of.p, error);
        if (status) return status;
    }
    if (record->check) status = record->check(of.p, error);
    return status ? status : make(system, &of, error);
}
