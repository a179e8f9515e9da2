/* The triple (Q, L, D) as an object: validation, copies, what it says about itself. */
#include "system/system.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Either mass and potential, or a Lagrangian; and nothing is called missing that is not there. */
static int check_lagrangian(const dal_system_def *def, dal_error *error)
{
    const unsigned of_potential = DAL_MISSING_V_Q | DAL_MISSING_V_QQ;
    const unsigned of_lagrangian =
        DAL_MISSING_L_QQ | DAL_MISSING_L_VQ | DAL_MISSING_L_VV | DAL_MISSING_L_VT;
    const unsigned of_force = DAL_MISSING_F_Q | DAL_MISSING_F_V;
    const unsigned of_time = DAL_MISSING_PHI_T | DAL_MISSING_L_VT;
    const unsigned known =
        of_potential | DAL_MISSING_PHI_Q | of_lagrangian | of_force | of_time;
    if (def->missing & ~known)
        return dal__fail(error, DAL_EINVAL, "missing = %#x: expected no bits outside %#x",
                         def->missing, known);
    if (def->mass && def->masses)
        return dal__fail(error, DAL_EINVAL, "mass and masses are both given: expected one of the "
                         "two");
    if (def->lagrangian && (dal__has_mass(def) || def->potential))
        return dal__fail(error, DAL_EINVAL, "lagrangian and %s are both given: expected either a "
                         "Lagrangian, or a mass and optionally a potential",
                         def->mass ? "mass" : def->masses ? "masses" : "potential");
    if (!def->lagrangian && !dal__has_mass(def))
        return dal__fail(error, DAL_EINVAL, "mass, masses and lagrangian are all NULL: expected "
                         "one of them");
    if (def->lagrangian && (def->missing & of_potential))
        return dal__fail(error, DAL_EINVAL, "missing = %#x has bits for derivatives of a "
                         "potential, but the system has a lagrangian", def->missing);
    if (!def->lagrangian && (def->missing & of_lagrangian))
        return dal__fail(error, DAL_EINVAL, "missing = %#x has bits for derivatives of L, but "
                         "lagrangian is NULL", def->missing);
    if (!def->force && !def->driven && def->inputs > 0)
        return dal__fail(error, DAL_EINVAL, "inputs = %zu, but force and driven are NULL: expected "
                         "one of them, or inputs = 0", def->inputs);
    if (def->driven && def->inputs == 0)
        return dal__fail(error, DAL_EINVAL, "driven is not NULL, but inputs = 0: expected at least "
                         "one input");
    if (!def->force && (def->missing & of_force))
        return dal__fail(error, DAL_EINVAL, "missing = %#x has bits for derivatives of a force, "
                         "but force is NULL", def->missing);
    if (!def->time_dependent && (def->missing & of_time))
        return dal__fail(error, DAL_EINVAL, "missing = %#x has bits for derivatives by time, but "
                         "time_dependent is 0", def->missing);
    return DAL_SUCCESS;
}

static int check_steady(const dal_system_def *def, dal_error *error)
{
    const char *const why = !def->steady ? NULL
                            : def->steady < DAL_STEADY_DECLARED
                                  || def->steady > DAL_STEADY_CONSTANT_RATE
                                ? "expected a dal_steady"
                            : !dal__has_mass(def) ? "expected 0, because mass is NULL"
                            : def->kind != DAL_LINEAR ? "expected 0, because the constraints are "
                                                        "not linear"
                            : def->time_dependent ? "expected 0, because the system depends on time"
                                                  : NULL;
    if (!why) return DAL_SUCCESS;
    return dal__fail(error, DAL_EINVAL, "steady = %d: %s", def->steady, why);
}

static int check_sparsity(const dal_system_def *def, dal_error *error)
{
    const dal_sparsity *const given = def->sparsity;
    if (!given) return DAL_SUCCESS;
    if (def->m == 0) return dal__fail(error, DAL_EINVAL, "sparsity is given, but m = 0: expected "
                                      "at least one constraint");
    if (given->entries > 0 && !(given->row && given->column))
        return dal__fail(error, DAL_EINVAL, "sparsity.%s is NULL", given->row ? "column" : "row");
    for (size_t e = 0; e < given->entries; e++) {
        const size_t row = given->row[e], column = given->column[e];
        if (row >= def->m || column >= def->n)
            return dal__fail(error, DAL_EINVAL, "sparsity: entry %zu, (%zu, %zu), is outside a "
                             "matrix of %zu rows and %zu columns", e, row, column, def->m, def->n);
        if (e > 0 && !(given->row[e - 1] < row
                       || (given->row[e - 1] == row && given->column[e - 1] < column)))
            return dal__fail(error, DAL_EINVAL, "sparsity: entry %zu, (%zu, %zu), comes after "
                             "(%zu, %zu): expected ascending rows, and ascending columns in each",
                             e, row, column, given->row[e - 1], given->column[e - 1]);
    }
    return DAL_SUCCESS;
}

static int check_def(const dal_system_def *def, dal_error *error)
{
    const size_t n = def->n, m = def->m;
    if (n < 1) return dal__fail(error, DAL_EINVAL, "n = %zu: expected at least one coordinate", n);
    if (m > n)
        return dal__fail(error, DAL_EINVAL, "m = %zu constraints on n = %zu coordinates: expected "
                         "at most n", m, n);
    if (!def->sparsity && dal__times(dal__times(n, n), sizeof(double)) > PTRDIFF_MAX)
        return dal__fail(error, DAL_ENOMEM, "n = %zu: the size of an n x n matrix overflows", n);
    int status = check_lagrangian(def, error);
    if (status) return status;
    if ((int)def->kind < DAL_LINEAR || def->kind > DAL_NONLINEAR)
        return dal__fail(error, DAL_EINVAL, "kind = %d is not a dal_constraint_kind",
                         (int)def->kind);
    if (m == 0 && def->kind != DAL_LINEAR)
        return dal__fail(error, DAL_EINVAL, "kind = %d with m = 0 constraints: expected DAL_LINEAR",
                         (int)def->kind);
    if (m > 0 && !def->constraint && !def->driven)
        return dal__fail(error, DAL_EINVAL, "m = %zu, but constraint is NULL", m);
    if (m == 0 && (def->constraint || def->driven))
        return dal__fail(error, DAL_EINVAL, "m = 0, but %s is not NULL",
                         def->constraint ? "constraint" : "driven");
    if (def->constraint && def->driven)
        return dal__fail(error, DAL_EINVAL, "constraint and driven are both given: expected one of "
                         "the two");
    if (def->invariants > 0 && (!def->invariant || !def->invariant_names))
        return dal__fail(error, DAL_EINVAL, "invariants = %zu, but %s is NULL", def->invariants,
                         def->invariant ? "invariant_names" : "invariant");
    if (def->state && !dal__all_finite(2 * n, def->state))
        return dal__fail(error, DAL_EINVAL, "state has an entry that is not finite");
    if (def->ctx_size > 0 && !def->ctx)
        return dal__fail(error, DAL_EINVAL, "ctx_size = %zu, but ctx is NULL", def->ctx_size);
    if (def->parameters && def->ctx_size == 0)
        return dal__fail(error, DAL_EINVAL, "parameters is not NULL, but ctx_size is 0: expected a "
                         "ctx that is copied");
    if (def->positional != 0 && (def->positional != 1 || !def->force))
        return dal__fail(error, DAL_EINVAL, "positional = %d: %s", def->positional,
                         def->force ? "expected 0 or 1" : "expected 0, because force is NULL");
    if (def->time_dependent != 0 && def->time_dependent != 1)
        return dal__fail(error, DAL_EINVAL, "time_dependent = %d: expected 0 or 1",
                         def->time_dependent);
    if (!status) status = check_steady(def, error);
    if (!status && dal__has_mass(def)) status = dal__check_mass(def, error);
    return status ? status : check_sparsity(def, error);
}

/* The memory that a system owns, apart from what struct dal_system names. */
typedef struct possessions {
    dal_system *self;
    void *ctx;
    double *state;
    const char **coordinates, **input_names, **invariant_names;
    char *text;  /* NULL until its size is known, */
    size_t used; /* which is what was taken of it */
    dal_sparsity *sparsity;
    size_t *row, *column; /* of it */
    size_t *first, *above, *entry, *owner; /* of the rows */
} possessions;

/* The copy of a text. */
static const char *take(possessions *own, const char *text)
{
    const size_t size = text ? strlen(text) + 1 : 1;
    char *const copy = own->text ? own->text + own->used : NULL;
    if (copy) memcpy(copy, text ? text : "", size);
    own->used += size;
    return copy;
}

/* copies[count] <- the names, or letter0, letter1, ... if they are NULL. */
static void take_names(possessions *own, size_t count, const char *const *names, char letter,
                       const char **copies)
{
    for (size_t i = 0; i < count; i++) {
        char generic[24];
        snprintf(generic, sizeof generic, "%c%zu", letter, i);
        const char *const name = take(own, names ? names[i] : generic);
        if (own->text) copies[i] = name;
    }
}

/* self->def <- copies of all texts, as many as own has memory for: at first it only counts. */
static void take_texts(dal_system *self, possessions *own, const dal_system_def *def)
{
    self->def.name = take(own, def->name ? def->name : "system");
    self->def.help = take(own, def->help);
    self->def.description = take(own, def->description);
    self->def.source = take(own, def->source);
    self->def.formulas = take(own, def->formulas);
    take_names(own, def->n, def->coordinates, 'q', own->coordinates);
    take_names(own, def->inputs, def->input_names, 'u', own->input_names);
    take_names(own, def->invariants, def->invariant_names, 'I', own->invariant_names);
    self->def.coordinates = own->coordinates;
    self->def.input_names = own->input_names;
    self->def.invariant_names = own->invariant_names;
}

static void plan_sparsity(arena *a, possessions *own, dal_system *shape, const dal_system_def *def)
{
    const size_t entries = def->sparsity->entries;
    size_t **const of_entries[] = {&own->row, &own->column, &own->entry, &own->owner};
    dal__reserve(a, &own->sparsity, 1, sizeof *own->sparsity);
    dal__reserve(a, &shape->rows, 1, sizeof *shape->rows);
    for (size_t k = 0; k < DAL_LENGTH(of_entries); k++)
        dal__reserve(a, of_entries[k], entries, sizeof(size_t));
    dal__reserve(a, &own->first, def->m + 1, sizeof(size_t));
    dal__reserve(a, &own->above, def->n + 1, sizeof(size_t));
    if (def->missing & DAL_MISSING_PHI_Q)
        dal__reserve(a, &shape->colour, def->n, sizeof *shape->colour);
}

static void plan(arena *a, possessions *own, dal_system *shape, const dal_system_def *def)
{
    const size_t n = def->n;
    const size_t square = def->masses ? n : def->mass ? dal__times(n, n) : 0;
    take_texts(shape, own, def);
    dal__reserve(a, &own->self, 1, sizeof *own->self);
    DAL__RESERVE(a, square, &shape->mass, &shape->mass_inverse);
    if (def->mass && def->parameters) DAL__RESERVE(a, square, &shape->factor);
    DAL__RESERVE(a, dal__has_mass(def) ? n : 0, &shape->unit, &shape->per_unit);
    if (def->sparsity) plan_sparsity(a, own, shape, def);
    dal__reserve(a, &own->ctx, def->ctx_size, 1);
    DAL__RESERVE(a, dal__times(2, n), &own->state);
    dal__reserve(a, &own->coordinates, n, sizeof *own->coordinates);
    dal__reserve(a, &own->input_names, def->inputs, sizeof *own->input_names);
    dal__reserve(a, &own->invariant_names, def->invariants, sizeof *own->invariant_names);
    dal__reserve(a, &own->text, own->used, 1);
    own->used = 0;
}

/* Whether V_qq, f_q and f_v are given, as far as there is something to differentiate, and matrices
 * of n rows cost no more than some megabytes and milliseconds. */
static bool has_full_newton(const dal_system_def *def)
{
    enum { MOST = 500 };
    const unsigned of_force = DAL_MISSING_F_Q | (def->positional ? 0 : DAL_MISSING_F_V);
    const unsigned of_potential = DAL_MISSING_V_Q | DAL_MISSING_V_QQ;
    const unsigned wanted = (def->potential ? of_potential : 0) | (def->force ? of_force : 0);
    return wanted && !(def->missing & wanted) && def->n <= MOST;
}

/* Each column in turn gets the first colour that no column has which it meets in a row. */
static int colour_columns(dal_system *system, dal_error *error)
{
    const dal_rows *const rows = system->rows;
    const size_t n = rows->n;
    size_t *const colour = system->colour, *met; /* the last column that met a colour, plus 1 */
    arena scratch = {0};
    dal__reserve(&scratch, &met, n, sizeof *met);
    const int status = dal__allocate(&scratch, error);
    if (status) return status;
    for (size_t i = 0; i < n; i++) {
        for (size_t k = rows->above[i]; k < rows->above[i + 1]; k++) {
            const size_t a = rows->row[k];
            for (size_t e = rows->first[a]; e < rows->first[a + 1] && rows->column[e] < i; e++)
                met[colour[rows->column[e]]] = i + 1;
        }
        while (met[colour[i]] == i + 1) colour[i]++;
        if (colour[i] >= system->colours) system->colours = colour[i] + 1;
    }
    dal__release(&scratch);
    return DAL_SUCCESS;
}

/* The copy of the sparsity, and the same by rows. */
static void bind_sparsity(dal_system *system, const possessions *own, const dal_sparsity *given)
{
    const size_t entries = given->entries, m = system->def.m, n = system->def.n;
    for (size_t e = 0; e < entries; e++) {
        own->row[e] = given->row[e];
        own->column[e] = given->column[e];
        own->first[given->row[e] + 1]++;
        own->above[given->column[e] + 1]++;
    }
    for (size_t a = 0; a < m; a++) own->first[a + 1] += own->first[a];
    for (size_t i = 0; i < n; i++) own->above[i + 1] += own->above[i];
    for (size_t e = 0; e < entries; e++) { /* above[i]: where the next entry of column i goes */
        const size_t k = own->above[given->column[e]]++;
        own->entry[k] = e;
        own->owner[k] = given->row[e];
    }
    for (size_t i = n; i > 0; i--) own->above[i] = own->above[i - 1];
    own->above[0] = 0;
    *own->sparsity = (dal_sparsity){entries, own->row, own->column};
    size_t most = 0;
    for (size_t a = 0; a < m; a++)
        if (own->first[a + 1] - own->first[a] > most) most = own->first[a + 1] - own->first[a];
    for (size_t i = 0; i < n; i++)
        if (own->above[i + 1] - own->above[i] > most) most = own->above[i + 1] - own->above[i];
    *system->rows = (dal_rows){.m = m, .n = n, .first = own->first, .column = own->column,
                               .above = own->above, .entry = own->entry, .row = own->owner,
                               .terms = most + 1 < n ? most + 1 : n};
    system->def.sparsity = own->sparsity;
}

int dal_system_new(dal_system **system, const dal_system_def *def, dal_error *error)
{
    int status = DAL__REQUIRE(error, {"system", system}, {"def", def});
    if (!status) status = check_def(def, error);
    if (status) return status;

    arena memory = {0};
    possessions own = {0};
    dal_system shape = {.def = *def, .masses = def->masses, .ctx_size = def->ctx_size,
                        .refill = def->parameters};
    shape.sparse = shape.masses && def->kind == DAL_LINEAR
              && (def->sparsity || !(def->potential || def->force));
    shape.full_newton = shape.sparse && has_full_newton(def);
    plan(&memory, &own, &shape, def);
    status = dal__allocate(&memory, error);
    if (status) return status;

    dal_system *const self = own.self;
    *self = shape;
    self->arena = memory;
    if (!dal__has_mass(def)) self->mass = self->mass_inverse = NULL;
    self->def.mass = self->masses ? NULL : self->mass;
    self->def.masses = self->masses ? self->mass : NULL;
    if (def->state) self->def.state = memcpy(own.state, def->state, 2 * def->n * sizeof(double));
    if (def->ctx_size > 0) self->def.ctx = memcpy(own.ctx, def->ctx, def->ctx_size);
    self->def.ctx_size = 0; /* whoever takes the definition over borrows the copy, as it is */
    self->def.parameters = NULL;
    take_texts(self, &own, def);
    if (def->mass) dal__copy(def->n * def->n, def->mass, self->mass);
    if (def->masses) dal__copy(def->n, def->masses, self->mass);
    if (dal__has_mass(def)) status = dal__bind_mass(self, error);
    if (def->sparsity) bind_sparsity(self, &own, def->sparsity);
    if (!status && self->colour) status = colour_columns(self, error);
    if (!status && self->sparse && self->rows)
        status = dal__pattern_new(&self->pattern, self->rows, error);
    if (status) {
        dal_system_free(self);
        return status;
    }
    *system = self;
    return DAL_SUCCESS;
}

int dal__system_copy(dal_system **copy, const dal_system *system, dal_error *error)
{
    dal_system_def def = system->def;
    def.ctx_size = system->ctx_size;
    def.parameters = system->refill;
    const int status = dal_system_new(copy, &def, error);
    if (status) return status;
    (*copy)->record = system->record;
    (*copy)->check = system->check;
    (*copy)->parameters = system->parameters;
    (*copy)->like = system;
    return DAL_SUCCESS;
}

int dal__system_change(dal_system *system, const void *parameters, dal_error *error)
{
    dal_system_def *const def = &system->def;
    double *const state = (double *)def->state; /* which lies in the arena */
    int status = system->check ? system->check(system, parameters, error) : DAL_SUCCESS;
    if (status) return status;
    memcpy(def->ctx, parameters, dal_system_parameter_size(system));
    system->age++;
    /* what the callback leaves as it is, is that of the definition, not of the member before */
    if (system->mass)
        dal__copy(system->masses ? def->n : def->n * def->n, system->like->mass, system->mass);
    if (state) dal__copy(2 * def->n, system->like->def.state, state);
    const int returned = system->refill(system->mass, state, def->ctx);
    if (returned)
        return dal__fail(error, dal__callback_status(returned), "the callback parameters returned "
                         "%d", returned);
    if (state && !dal__all_finite(2 * def->n, state))
        return dal__fail(error, DAL_EINVAL, "state has an entry that is not finite");
    if (!system->mass) return DAL_SUCCESS;
    status = dal__check_mass(def, error);
    return status ? status : dal__bind_mass(system, error);
}

size_t dal_system_parameter_size(const dal_system *system)
{
    if (system->record) return system->parameters * sizeof(double);
    return system->refill ? system->ctx_size : 0;
}

void dal_system_free(dal_system *system)
{
    if (!system) return;
    dal__pattern_free(system->pattern);
    dal__release(&system->arena);
}

size_t dal_system_n(const dal_system *system) { return system->def.n; }
size_t dal_system_m(const dal_system *system) { return system->def.m; }
unsigned dal_system_missing(const dal_system *system) { return system->def.missing; }
const char *dal_system_name(const dal_system *system) { return system->def.name; }
const char *dal_system_help(const dal_system *system) { return system->def.help; }
const char *dal_system_description(const dal_system *system) { return system->def.description; }
const char *dal_system_source(const dal_system *system) { return system->def.source; }
const char *dal_system_formulas(const dal_system *system) { return system->def.formulas; }
const dal_sparsity *dal_system_sparsity(const dal_system *system) { return system->def.sparsity; }
dal_constraint_kind dal_system_kind(const dal_system *system) { return system->def.kind; }
int dal_system_is_forced(const dal_system *system) { return system->def.force != NULL; }
int dal_system_is_driven(const dal_system *system) { return system->def.driven != NULL; }
int dal_system_is_time_dependent(const dal_system *system) { return system->def.time_dependent; }
size_t dal_system_invariants(const dal_system *system) { return system->def.invariants; }

const char *dal_system_coordinate(const dal_system *system, size_t i)
{
    return i < system->def.n ? system->def.coordinates[i] : NULL;
}

size_t dal_system_inputs(const dal_system *system) { return system->def.inputs; }

const char *dal_system_input_name(const dal_system *system, size_t i)
{
    return i < system->def.inputs ? system->def.input_names[i] : NULL;
}

const char *dal_system_invariant_name(const dal_system *system, size_t i)
{
    return i < system->def.invariants ? system->def.invariant_names[i] : NULL;
}

int dal_system_state(const dal_system *system, double *x)
{
    if (!system || !x) return DAL_EINVAL;
    if (!system->def.state) return DAL_EUNSUPPORTED;
    memcpy(x, system->def.state, 2 * system->def.n * sizeof *x);
    return DAL_SUCCESS;
}

/* answer[count] <- f at (t, x), all of it or nothing.  It is NaN before, so that what is never
 * written is found. */
static int answer_by(const dal_system *system, dal_exact_fn f, double t, const double *x,
                     size_t count, double *answer)
{
    if (!x || !answer || !isfinite(t)) return DAL_EINVAL;
    if (!f) return DAL_EUNSUPPORTED;
    arena scratch = {0};
    double *fresh;
    DAL__RESERVE(&scratch, count, &fresh);
    int status = dal__allocate(&scratch, NULL);
    if (status) return status;
    dal__forget(count, fresh);
    status = dal__callback_status(f(t, x, fresh, system->def.ctx));
    if (!status && !dal__all_finite(count, fresh)) status = DAL_EDOMAIN;
    if (!status) memcpy(answer, fresh, count * sizeof *answer);
    dal__release(&scratch);
    return status;
}

int dal_system_exact(const dal_system *system, double t, const double *x0, double *x)
{
    if (!system) return DAL_EINVAL;
    return answer_by(system, system->def.exact, t, x0, 2 * system->def.n, x);
}

int dal_system_invariant(const dal_system *system, double t, const double *x, double *values)
{
    if (!system) return DAL_EINVAL;
    return answer_by(system, system->def.invariant, t, x, system->def.invariants, values);
}
