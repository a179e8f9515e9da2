/* The callbacks of a system as the library calls them; differences for what is missing. */
#include "system/system.h"

#include <math.h>
#include <string.h>

/* A power of two near (u max(1, |q|))^(1/5), so that q+d and q-d are exact.  Roundoff of a function
 * that grows with q asks for d to grow with q; an angle, whose sine has its unit of 1 wherever it
 * stands, for d to stay: the power balances the two.  Where q is so large that d would be lost in
 * it, d is a few units of its last place. */
double dal__spacing(double q)
{
    int exponent;
    frexp(fmax(1.0, fabs(q)), &exponent);
    const int power = (exponent - 1) / 5 - 11, least = exponent - 48;
    return ldexp(1.0, power > least ? power : least);
}

/* f' = (8 (f(q+d) - f(q-d)) - (f(q+2d) - f(q-2d))) / 12d  +  O(d^4 f^(5)/30, 1.5 u f/d) */
static const int offsets[4] = {1, -1, 2, -2};
static const double weights[4] = {8.0, -8.0, -1.0, 1.0};

int dal__difference(dal__function f, void *ctx, double *point, size_t j, size_t count,
                    double *value, double *slope, size_t stride)
{
    const double q = point[j], d = dal__spacing(q);
    int returned = 0;
    for (size_t i = 0; i < count; i++) slope[i * stride] = 0.0;
    for (int k = 0; k < 4 && !returned; k++) {
        point[j] = q + offsets[k] * d;
        dal__forget(count, value);
        returned = f(point, value, ctx);
        for (size_t i = 0; i < count; i++) slope[i * stride] += weights[k] * value[i];
    }
    for (size_t i = 0; i < count; i++) slope[i * stride] /= 12.0 * d;
    point[j] = q;
    return returned;
}

int dal__jacobian(dal__function f, void *ctx, size_t n, double *point, size_t count, double *value,
                  double *slopes)
{
    int returned = 0;
    for (size_t j = 0; j < n && !returned; j++)
        returned = dal__difference(f, ctx, point, j, count, value, slopes + j, n);
    return returned;
}

/* ---- what the callbacks give ---------------------------------------------------------------- */

typedef enum callback { POTENTIAL, CONSTRAINT, LAGRANGIAN, FORCE } callback;
typedef enum extent { ONE, N, M } extent;

/* An output; where its bit is set in the definition, the callback does not give it, and it is the
 * derivative of the output `from` by what moves, symmetrised if it is symmetric. */
typedef struct output {
    const char *name;
    extent rows, columns;
    unsigned missing;
    size_t from;
    dal__moves moves;
    bool symmetric;
} output;

static const struct {
    const char *name;
    size_t count;
    output outputs[DAL__OUTPUTS];
} callbacks[DAL__CALLBACKS] = {
    [POTENTIAL] = {"potential", 3, {{"V", ONE, ONE},
                                    {"V_q", ONE, N, DAL_MISSING_V_Q, 0, MOVES_Q},
                                    {"V_qq", N, N, DAL_MISSING_V_QQ, 1, MOVES_Q}}},
    [CONSTRAINT] = {"constraint", 4, {{"phi_v", M, N},
                                      {"phi_q", M, N, DAL_MISSING_PHI_Q, 3, MOVES_Q},
                                      {"phi_t", ONE, M, DAL_MISSING_PHI_T, 3, MOVES_T},
                                      {"phi", ONE, M}}},
    [LAGRANGIAN] = {"lagrangian", 7, {{"L", ONE, ONE}, {"L_q", ONE, N}, {"L_v", ONE, N},
                                      {"L_qq", N, N, DAL_MISSING_L_QQ, 1, MOVES_Q, true},
                                      {"L_vq", N, N, DAL_MISSING_L_VQ, 2, MOVES_Q},
                                      {"L_vv", N, N, DAL_MISSING_L_VV, 2, MOVES_V, true},
                                      {"L_vt", ONE, N, DAL_MISSING_L_VT, 2, MOVES_T}}},
    [FORCE] = {"force", 3, {{"f", ONE, N}, {"f_q", N, N, DAL_MISSING_F_Q, 0, MOVES_Q},
                            {"f_v", N, N, DAL_MISSING_F_V, 0, MOVES_V}}},
};

void dal__expand(const dal_system_def *def, double *A)
{
    const dal_sparsity *const given = def->sparsity;
    size_t left = given->entries;
    for (size_t k = def->m * def->n; k-- > 0;) { /* from behind: no entry moves forward */
        const bool is_there =
            left > 0 && given->row[left - 1] * def->n + given->column[left - 1] == k;
        A[k] = is_there ? A[--left] : 0.0;
    }
}

int dal__call_constraint(const evaluator *e, double t, const double *q, const double *v,
                         double *phi, double *phi_v, double *phi_q, double *phi_t)
{
    const dal_system_def *const def = &e->system->def;
    if (def->driven) return def->driven(t, q, v, e->input, phi, phi_v, phi_q, phi_t, def->ctx);
    return def->constraint(t, q, v, phi, phi_v, phi_q, phi_t, def->ctx);
}

/* x: where the outputs go, in the order of the table.  phi of linear constraints is mu v. */
static int call(evaluator *e, callback which, double t, const double *q, const double *v,
                double *const *x)
{
    const dal_system_def *const def = &e->system->def;
    const bool linear = def->kind == DAL_LINEAR;
    int returned = 0;
    switch (which) {
    case POTENTIAL:
        e->calls.potential++;
        return def->potential(t, q, x[0], x[1], x[2], def->ctx);
    case CONSTRAINT:
        e->calls.constraint++;
        returned = dal__call_constraint(e, t, q, v, linear ? NULL : x[3], x[0], x[1], x[2]);
        for (size_t k = 0; !returned && def->sparsity && !e->rows && k < 2; k++)
            if (x[k]) dal__expand(def, x[k]);
        if (returned || !linear || !x[3]) return returned;
        if (!e->rows) dal__apply(def->m, def->n, x[0], v, x[3]);
        for (size_t a = 0; e->rows && a < def->m; a++)
            x[3][a] = 0.0 + dal_rows_dot(e->rows, x[0], a, v);
        return returned;
    case LAGRANGIAN:
        e->calls.lagrangian++;
        return def->lagrangian(t, q, v, x[0], x[1], x[2], x[3], x[4], x[5], x[6], def->ctx);
    case FORCE:
        e->calls.force++;
        return def->force(t, q, v, e->input, x[0], x[1], x[2], def->ctx);
    }
    return returned;
}

/* ---- differences for what is missing ------------------------------------------------------- */

/* An output as a function of t, q or v: of the one that moves, while the others stand here. */
typedef struct difference {
    evaluator *e;
    callback which;
    size_t from;
    dal__moves moves;
    double t;
    const double *q, *v;
} difference;

static int value(const double *moved, double *result, void *ctx)
{
    const difference *const d = ctx;
    evaluator *const e = d->e;
    double *x[DAL__OUTPUTS] = {NULL};
    x[d->from] = result;
    if (d->which == CONSTRAINT && e->system->def.kind == DAL_LINEAR) {
        x[0] = e->forms;
        dal__forget(dal__entries(e), x[0]);
    }
    return call(e, d->which, d->moves == MOVES_T ? *moved : d->t,
                d->moves == MOVES_Q ? moved : d->q, d->moves == MOVES_V ? moved : d->v, x);
}

/* Second differences of V, good to about 1e-6, which is enough for what they serve: Newton's
 * speed. */
static int hessian_of_V(difference *d, double *V_qq)
{
    const size_t n = d->e->system->def.n;
    const double *const q = d->q;
    double *const point = d->e->point;
    d->from = 0;
    memcpy(point, q, n * sizeof *q);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j <= i; j++) {
            const double di = dal__spacing(q[i]), dj = dal__spacing(q[j]);
            double sum = 0.0;
            for (int k = 0; k < 4; k++) {
                const double si = k < 2 ? di : -di, sj = k % 2 ? -dj : dj;
                double V = (double)NAN;
                point[i] += si;
                point[j] += sj;
                const int returned = value(point, &V, d);
                point[i] = q[i];
                point[j] = q[j];
                if (returned) return returned;
                sum += si * sj > 0.0 ? V : -V;
            }
            V_qq[i * n + j] = V_qq[j * n + i] = sum / (4.0 * di * dj);
        }
    return 0;
}

/* slopes <- phi_q by rows, of linear constraints.  Columns of a colour have no row in common, and
 * are differenced at once. */
static int differentiate_rows(difference *d, const dal_rows *rows, double *slopes)
{
    evaluator *const e = d->e;
    const size_t n = rows->n, *const colour = e->system->colour;
    double *const point = e->point, *const phi = e->gradient;
    memcpy(point, d->q, n * sizeof *point);
    dal__clear(dal_rows_entries(rows), slopes);
    for (size_t c = 0; c < e->system->colours; c++)
        for (int k = 0; k < 4; k++) {
            for (size_t i = 0; i < n; i++)
                if (colour[i] == c) point[i] = d->q[i] + offsets[k] * dal__spacing(d->q[i]);
            const int returned = value(point, phi, d);
            if (returned) return returned;
            for (size_t i = 0; i < n; i++) {
                if (colour[i] != c) continue;
                point[i] = d->q[i];
                for (size_t j = rows->above[i]; j < rows->above[i + 1]; j++)
                    slopes[rows->entry[j]] += weights[k] * phi[rows->row[j]];
            }
        }
    for (size_t j = 0; j < dal_rows_entries(rows); j++)
        slopes[j] /= 12.0 * dal__spacing(d->q[rows->column[j]]);
    return 0;
}

/* slopes <- an output that is missing. */
static int differentiate(difference *d, const output *out, double *slopes)
{
    evaluator *const e = d->e;
    const output *const base = &callbacks[d->which].outputs[out->from];
    const size_t columns = out->moves == MOVES_T ? 1 : e->system->def.n;
    const size_t count = e->sizes[d->which][out->from];
    d->from = out->from;
    d->moves = out->moves;
    if (e->system->def.missing & base->missing) return hessian_of_V(d, slopes);
    if (e->rows && out->missing == DAL_MISSING_PHI_Q) return differentiate_rows(d, e->rows, slopes);
    const double *const centre = d->moves == MOVES_T ? &d->t : d->moves == MOVES_Q ? d->q : d->v;
    memcpy(e->point, centre, columns * sizeof *centre);
    const int returned = dal__jacobian(value, d, columns, e->point, count, e->gradient, slopes);
    if (!returned && out->symmetric) dal__symmetrise(columns, slopes);
    return returned;
}

/* What is wanted of the outputs x, called for or differenced; returns what the callback did. */
static int complete(evaluator *e, callback which, double t, const double *q, const double *v,
                    double *const *x)
{
    const output *const outputs = callbacks[which].outputs;
    const size_t count = callbacks[which].count;
    const unsigned missing = e->system->def.missing;
    double *given[DAL__OUTPUTS];
    bool any = false;
    for (size_t k = 0; k < count; k++) {
        given[k] = missing & outputs[k].missing ? NULL : x[k];
        any = any || given[k];
    }
    int returned = any ? call(e, which, t, q, v, given) : 0;
    difference d = {.e = e, .which = which, .t = t, .q = q, .v = v};
    for (size_t k = 0; k < count && !returned; k++)
        if (x[k] && !given[k]) returned = differentiate(&d, &outputs[k], x[k]);
    return returned;
}

/* The same in short where nothing is missing; e->refused <- whose result it is. */
static int ask(evaluator *e, callback which, double t, const double *q, const double *v,
               double *const *x)
{
    e->refused = callbacks[which].name;
    return e->system->def.missing ? complete(e, which, t, q, v, x) : call(e, which, t, q, v, x);
}

/* V_q - f: of a dal_potential_fn what steps ask for. */
static int potential_force(double t, const double *q, double *V, double *V_q, double *V_qq,
                           void *ctx)
{
    evaluator *const e = ctx;
    const size_t n = e->system->def.n;
    double *const of_V[] = {V, V_q, V_qq}, *const of_f[] = {e->force, NULL, NULL};
    int returned = 0;
    if (e->system->def.potential) returned = ask(e, POTENTIAL, t, q, NULL, of_V);
    else dal__clear(n, V_q);
    if (returned || !e->system->def.positional) return returned;
    dal__forget(n, e->force);
    returned = ask(e, FORCE, t, q, e->nowhere, of_f);
    dal__add(n, -1.0, e->force, V_q);
    return returned;
}

static int complete_constraint(double t, const double *q, const double *v, double *phi,
                               double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    double *const x[] = {phi_v, phi_q, phi_t, phi};
    return complete(ctx, CONSTRAINT, t, q, v, x);
}

size_t dal__entries(const evaluator *e)
{
    const dal_system_def *const def = &e->system->def;
    return e->rows ? dal_rows_entries(e->rows) : dal__times(def->m, def->n);
}

void dal__evaluator_reserve(evaluator *e, const dal_system *system, arena *a)
{
    const size_t n = system->def.n;
    const bool square = system->def.force && (e->dense || !system->sparse);
    e->system = system;
    e->sparse = system->sparse && !e->dense;
    DAL__RESERVE(a, n, &e->point, &e->gradient, &e->nowhere);
    if (system->def.force) DAL__RESERVE(a, n, &e->force);
    if (square) DAL__RESERVE(a, dal__times(n, n), &e->slopes, &e->drag);
    DAL__RESERVE(a, system->def.inputs, &e->own_input);
    e->rows = e->sparse ? system->rows : NULL;
    DAL__RESERVE(a, dal__entries(e), &e->forms);
}

void dal__evaluator_bind(evaluator *e, const dal_system *system)
{
    const dal_system_def *def = &system->def;
    const unsigned of_potential = DAL_MISSING_V_Q | DAL_MISSING_V_QQ;
    e->system = system;
    e->input = e->own_input;
    e->lengths[ONE] = 1;
    e->lengths[N] = def->n;
    e->lengths[M] = def->m;
    for (size_t i = 0; i < DAL_LENGTH(callbacks); i++)
        for (size_t k = 0; k < callbacks[i].count; k++) {
            const output *const out = &callbacks[i].outputs[k];
            e->sizes[i][k] = e->lengths[out->rows] * e->lengths[out->columns];
        }
    e->sizes[CONSTRAINT][0] = e->sizes[CONSTRAINT][1] = dal__entries(e);
    dal__forget(def->n, e->nowhere);
    e->potential_force = def->potential;
    e->potential_force_ctx = def->ctx;
    e->constraint = def->constraint;
    e->constraint_ctx = def->ctx;
    e->constant_mass = !def->lagrangian;
    if (def->compiled && def->compiled->abi == DAL_COMPILED_ABI
        && dal__check_compiled(system, NULL) == DAL_SUCCESS)
        e->field = def->compiled->field;
    if ((def->potential && (def->missing & of_potential)) || def->positional) {
        e->potential_force = potential_force;
        e->potential_force_ctx = e;
    }
    if (def->driven
        || (def->constraint && ((def->missing & (DAL_MISSING_PHI_Q | DAL_MISSING_PHI_T))
                                || (def->sparsity && !e->rows)))) {
        e->constraint = complete_constraint;
        e->constraint_ctx = e;
    }
}

int dal__evaluator_input(evaluator *e, const double *u, dal_error *error)
{
    const size_t inputs = e->system->def.inputs;
    const int status =
        inputs > 0 ? DAL__REQUIRE_FINITE(error, {"u", inputs, u}) : DAL_SUCCESS;
    if (!status) dal__copy(inputs, u, e->own_input);
    return status;
}

/* ---- the calls of the library --------------------------------------------------------------- */

int dal__refuse(dal_error *error, const char *callback, int returned)
{
    return dal__fail(error, dal__callback_status(returned), "%s returned %d (%s)", callback,
                     returned, returned > 0 ? "outside its domain" : "stop");
}

/* DAL_EDOMAIN, with the first entry of output k that is not finite. */
static int refuse_output(const evaluator *e, callback which, size_t k, const double *x,
                         dal_error *error)
{
    const output *const out = &callbacks[which].outputs[k];
    const size_t columns = e->lengths[out->columns];
    const dal_sparsity *const sparsity =
        e->rows && out->rows == M && out->columns == N ? e->system->def.sparsity : NULL;
    size_t i = 0;
    while (isfinite(x[i])) i++;
    const dal__entry entry = {callbacks[which].name, out->name,
                              sparsity ? sparsity->row[i] : i / columns,
                              sparsity ? sparsity->column[i] : i % columns, x[i]};
    return dal__fail_entry(error, DAL_EDOMAIN, &entry, " = %g is not finite, or the callback did "
                           "not set it", x[i]);
}

/* The outputs x, as far as they are wanted; but phi of linear constraints need not be finite. */
static int evaluate(evaluator *e, callback which, double t, const double *q, const double *v,
                    double *const *x, dal_error *error)
{
    const bool linear = which == CONSTRAINT && e->system->def.kind == DAL_LINEAR;
    const size_t count = callbacks[which].count - linear, *const sizes = e->sizes[which];
    bool any = false;
    for (size_t k = 0; k < count; k++)
        if (x[k]) {
            dal__forget(sizes[k], x[k]);
            any = true;
        }
    if (!any) return DAL_SUCCESS;
    const int returned = ask(e, which, t, q, v, x);
    if (returned) return dal__refuse(error, callbacks[which].name, returned);
    for (size_t k = 0; k < count; k++)
        if (x[k] && !dal__all_finite(sizes[k], x[k]))
            return refuse_output(e, which, k, x[k], error);
    return DAL_SUCCESS;
}

static void negate(size_t count, double *x)
{
    for (size_t i = 0; x && i < count; i++) x[i] = -x[i];
}

int dal__balance(double t, const double *q, const double *v, double *L_v, double *F, double *L_vq,
                 double *L_vv, double *F_q, double *F_v, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *const def = &e->system->def;
    const size_t n = def->n;
    const unsigned missing = def->missing;
    int returned = 0;
    if (e->constant_mass) {
        double *const x[] = {NULL, F, missing & DAL_MISSING_V_QQ ? NULL : F_q};
        if (L_v) dal__apply_mass(e->system, v, L_v);
        if (L_vv) dal_system_mass(e->system, L_vv);
        dal__clear(n * n, L_vq);
        dal__clear(n * n, F_v);
        if (!def->potential || !x[2]) dal__clear(n * n, F_q);
        if (!def->potential) dal__clear(n, F);
        else if (F) returned = ask(e, POTENTIAL, t, q, NULL, x);
        negate(n, F);
        negate(n * n, F_q);
    } else {
        double *const x[] = {NULL, F, L_v, missing & DAL_MISSING_L_QQ ? NULL : F_q, L_vq, L_vv,
                             NULL};
        if (!x[3]) dal__clear(n * n, F_q);
        returned = ask(e, LAGRANGIAN, t, q, v, x);
        for (size_t i = 0; F_v && i < n; i++)
            for (size_t j = 0; j < n; j++) F_v[i * n + j] = L_vq[j * n + i];
    }
    if (returned || !F || !def->force) return returned;
    double *const f_q = F_q && !(missing & DAL_MISSING_F_Q) ? e->slopes : NULL;
    double *const f_v = F_v && !def->positional ? e->drag : NULL;
    double *const x[] = {e->force, f_q, f_v};
    dal__forget(n, e->force);
    returned = ask(e, FORCE, t, q, def->positional ? e->nowhere : v, x);
    dal__add(n, 1.0, e->force, F);
    if (f_q) dal__add(n * n, 1.0, f_q, F_q);
    if (f_v) dal__add(n * n, 1.0, f_v, F_v);
    return returned;
}

bool dal__is_dragged(const dal_system *system)
{
    return system->def.force && !system->def.positional;
}

bool dal__is_autonomous(const dal_system *system)
{
    return !system->def.force && !system->def.driven && !system->def.time_dependent;
}

bool dal__has_momenta(const dal_system *system)
{
    if (system->sparse) return false;
    return !system->mass || system->def.kind != DAL_LINEAR || dal__is_dragged(system);
}

int dal__check_compiled(const dal_system *system, dal_error *error)
{
    const dal_system_def *const def = &system->def;
    const dal_compiled *const compiled = def->compiled;
    if (def->sparsity)
        return dal__fail(error, DAL_EINVAL, "compiled and sparsity are both given: a compiled step "
                         "routine needs a system without a sparsity");
    if (def->missing)
        return dal__fail(error, DAL_EINVAL, "compiled is given, but derivatives are missing: a "
                         "compiled step routine needs all of them");
    if (compiled->momenta != dal__has_momenta(system))
        return dal__fail(error, DAL_EINVAL, "compiled: the step routine belongs to a different "
                         "system, one with %s", compiled->momenta
                         ? "M(q), a force of v, or constraints that are not linear"
                         : "constant mass, linear constraints, and no force that depends on v");
    if (compiled->forced == (def->force != NULL)) return DAL_SUCCESS;
    return dal__fail(error, DAL_EINVAL, "compiled: the step routine belongs to a different system, "
                     "one %s a force", compiled->forced ? "with" : "without");
}

int dal__potential(evaluator *e, double t, const double *q, double *V, double *V_q, double *V_qq,
                   dal_error *error)
{
    const size_t n = e->system->def.n;
    double *const x[] = {V, V_q, V_qq};
    if (e->system->def.potential) return evaluate(e, POTENTIAL, t, q, NULL, x, error);
    dal__clear(1, V);
    dal__clear(n, V_q);
    dal__clear(n * n, V_qq);
    return DAL_SUCCESS;
}

int dal__constraint(evaluator *e, double t, const double *q, const double *v, double *phi,
                    double *phi_v, double *phi_q, double *phi_t, dal_error *error)
{
    const dal_system_def *const def = &e->system->def;
    const bool linear = def->kind == DAL_LINEAR;
    if (def->m == 0) return DAL_SUCCESS;
    double *const x[] = {linear && phi && !phi_v ? e->forms : phi_v, phi_q,
                         def->time_dependent ? phi_t : NULL, phi};
    if (!def->time_dependent) dal__clear(def->m, phi_t);
    return evaluate(e, CONSTRAINT, t, q, v, x, error);
}

/* The jet of v^T M v / 2 - V. */
static int simple_lagrangian(evaluator *e, double t, const double *q, const double *v,
                             const dal__jet *jet, dal_error *error)
{
    const size_t n = e->system->def.n;
    double V;
    const int status = dal__potential(e, t, q, jet->L ? &V : NULL, jet->L_q, jet->L_qq, error);
    if (status) return status;
    negate(n, jet->L_q);
    negate(n * n, jet->L_qq);
    if (jet->L_v) dal__apply_mass(e->system, v, jet->L_v);
    dal__clear(n * n, jet->L_vq);
    if (jet->L_vv) dal_system_mass(e->system, jet->L_vv);
    dal__clear(n, jet->L_vt);
    if (!jet->L) return DAL_SUCCESS;
    dal__apply_mass(e->system, v, e->gradient);
    *jet->L = 0.5 * dal__dot(n, v, e->gradient) - V;
    return DAL_SUCCESS;
}

int dal__lagrangian(evaluator *e, double t, const double *q, const double *v, const dal__jet *jet,
                    dal_error *error)
{
    const bool timed = e->system->def.time_dependent;
    double *const x[] = {jet->L, jet->L_q, jet->L_v, jet->L_qq, jet->L_vq, jet->L_vv,
                         timed ? jet->L_vt : NULL};
    if (e->constant_mass) return simple_lagrangian(e, t, q, v, jet, error);
    if (!timed) dal__clear(e->system->def.n, jet->L_vt);
    return evaluate(e, LAGRANGIAN, t, q, v, x, error);
}

int dal__force(evaluator *e, double t, const double *q, const double *v, double *f, double *f_q,
               double *f_v, dal_error *error)
{
    const size_t n = e->system->def.n;
    const bool positional = e->system->def.positional;
    double *const x[] = {f, f_q, positional ? NULL : f_v};
    if (positional) dal__clear(n * n, f_v);
    if (e->system->def.force) return evaluate(e, FORCE, t, q, v, x, error);
    dal__clear(n, f);
    dal__clear(n * n, f_q);
    dal__clear(n * n, f_v);
    return DAL_SUCCESS;
}
