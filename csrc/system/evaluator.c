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
int dal__difference(dal__function f, void *ctx, double *point, size_t j, size_t count,
                    double *value, double *slope, size_t stride)
{
    static const int offsets[4] = {1, -1, 2, -2};
    static const double weights[4] = {8.0, -8.0, -1.0, 1.0};
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

/* What is differenced, as functions of t, q or v: of the one that moves, the others are kept in the
 * evaluator. */

static double time_of(const evaluator *e, const double *moved)
{
    return e->moves == MOVES_T ? *moved : e->time;
}

static const double *position(const evaluator *e, const double *moved)
{
    return e->moves == MOVES_Q ? moved : e->position;
}

static const double *velocity(const evaluator *e, const double *moved)
{
    return e->moves == MOVES_V ? moved : e->velocity;
}

static int value_V(const double *moved, double *V, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    e->potential_calls++;
    return def->potential(e->time, moved, V, NULL, NULL, def->ctx);
}

static int value_V_q(const double *moved, double *V_q, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    e->potential_calls++;
    return def->potential(e->time, moved, NULL, V_q, NULL, def->ctx);
}

static int value_phi(const double *moved, double *phi, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    const bool linear = def->kind == DAL_LINEAR;
    const double *const q = position(e, moved), *const v = velocity(e, moved);
    double *const forms = linear ? e->forms : NULL;
    e->constraint_calls++;
    dal__forget(def->m * def->n, forms);
    const int returned = def->constraint(time_of(e, moved), q, v, linear ? NULL : phi, forms, NULL,
                                         NULL, def->ctx);
    if (!returned && linear) dal__apply(def->m, def->n, forms, v, phi);
    return returned;
}

static int value_L_q(const double *moved, double *L_q, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    e->lagrangian_calls++;
    return def->lagrangian(time_of(e, moved), position(e, moved), velocity(e, moved), NULL, L_q,
                           NULL, NULL, NULL, NULL, NULL, def->ctx);
}

static int value_L_v(const double *moved, double *L_v, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    e->lagrangian_calls++;
    return def->lagrangian(time_of(e, moved), position(e, moved), velocity(e, moved), NULL, NULL,
                           L_v, NULL, NULL, NULL, NULL, def->ctx);
}

static int value_f(const double *moved, double *f, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    e->force_calls++;
    return def->force(time_of(e, moved), position(e, moved), velocity(e, moved), f, NULL, NULL,
                      def->ctx);
}

static void stand_at(evaluator *e, double t, const double *q, const double *v)
{
    e->time = t;
    e->position = q;
    e->velocity = v;
}

/* slopes[rows*n], or [rows] in time, <- the derivatives of f, one of the functions above, where the
 * evaluator stands. */
static int differenced(evaluator *e, dal__function f, dal__moves moves, size_t rows, double *slopes)
{
    const double *const centre = moves == MOVES_T ? &e->time
                               : moves == MOVES_Q ? e->position : e->velocity;
    const size_t columns = moves == MOVES_T ? 1 : e->system->def.n;
    int returned = 0;
    e->moves = moves;
    memcpy(e->point, centre, columns * sizeof *centre);
    for (size_t j = 0; j < columns && !returned; j++)
        returned = dal__difference(f, e, e->point, j, rows, e->gradient, slopes + j, columns);
    return returned;
}

/* Second differences of V, good to about 1e-6, which is enough for what they serve: Newton's
 * speed. */
static int hessian_of_V(evaluator *e, double *V_qq)
{
    const size_t n = e->system->def.n;
    const double *const q = e->position;
    memcpy(e->point, q, n * sizeof *q);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j <= i; j++) {
            const double di = dal__spacing(q[i]), dj = dal__spacing(q[j]);
            double sum = 0.0;
            for (int k = 0; k < 4; k++) {
                const double si = k < 2 ? di : -di, sj = k % 2 ? -dj : dj;
                double V = (double)NAN;
                e->point[i] += si;
                e->point[j] += sj;
                const int returned = value_V(e->point, &V, e);
                e->point[i] = q[i];
                e->point[j] = q[j];
                if (returned) return returned;
                sum += si * sj > 0.0 ? V : -V;
            }
            V_qq[i * n + j] = V_qq[j * n + i] = sum / (4.0 * di * dj);
        }
    return 0;
}

static int complete_potential(double t, const double *q, double *V, double *V_q, double *V_qq,
                              void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    double *const given_V_q = def->missing & DAL_MISSING_V_Q ? NULL : V_q;
    double *const given_V_qq = def->missing & DAL_MISSING_V_QQ ? NULL : V_qq;
    int returned = 0;
    if (V || given_V_q || given_V_qq) {
        returned = def->potential(t, q, V, given_V_q, given_V_qq, def->ctx);
        e->potential_calls++;
    }
    stand_at(e, t, q, NULL);
    if (!returned && V_q && !given_V_q) returned = differenced(e, value_V, MOVES_Q, 1, V_q);
    if (returned || !V_qq || given_V_qq) return returned;
    return def->missing & DAL_MISSING_V_Q ? hessian_of_V(e, V_qq)
                                          : differenced(e, value_V_q, MOVES_Q, def->n, V_qq);
}

static int complete_constraint(double t, const double *q, const double *v, double *phi,
                               double *phi_v, double *phi_q, double *phi_t, void *ctx)
{
    evaluator *const e = ctx;
    const dal_system_def *def = &e->system->def;
    double *const given_q = def->missing & DAL_MISSING_PHI_Q ? NULL : phi_q;
    double *const given_t = def->missing & DAL_MISSING_PHI_T ? NULL : phi_t;
    int returned = 0;
    if (phi || phi_v || given_q || given_t) {
        returned = def->constraint(t, q, v, phi, phi_v, given_q, given_t, def->ctx);
        e->constraint_calls++;
    }
    stand_at(e, t, q, v);
    if (!returned && phi_q && !given_q)
        returned = differenced(e, value_phi, MOVES_Q, def->m, phi_q);
    if (!returned && phi_t && !given_t)
        returned = differenced(e, value_phi, MOVES_T, def->m, phi_t);
    return returned;
}

static void symmetrise(size_t n, double *A)
{
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j < i; j++) {
            const double mean = 0.5 * (A[i * n + j] + A[j * n + i]);
            A[i * n + j] = A[j * n + i] = mean;
        }
}

void dal__evaluator_reserve(evaluator *e, const dal_system *system, arena *a)
{
    const size_t n = system->def.n;
    dal__reserve(a, &e->point, n, sizeof(double));
    dal__reserve(a, &e->gradient, n, sizeof(double));
    dal__reserve(a, &e->forms, dal__times(system->def.m, n), sizeof(double));
}

void dal__evaluator_bind(evaluator *e, const dal_system *system)
{
    const dal_system_def *def = &system->def;
    const unsigned of_potential = DAL_MISSING_V_Q | DAL_MISSING_V_QQ;
    e->system = system;
    e->potential = def->potential;
    e->potential_ctx = def->ctx;
    e->constraint = def->constraint;
    e->constraint_ctx = def->ctx;
    e->constant_mass = !def->lagrangian;
    if (def->potential && (def->missing & of_potential)) {
        e->potential = complete_potential;
        e->potential_ctx = e;
    }
    if (def->constraint && (def->missing & (DAL_MISSING_PHI_Q | DAL_MISSING_PHI_T))) {
        e->constraint = complete_constraint;
        e->constraint_ctx = e;
    }
}

static int refuse(dal_error *error, const char *callback, int returned)
{
    return dal__fail(error, dal__callback_status(returned), "%s returned %d (%s)", callback,
                     returned, returned > 0 ? "outside its domain" : "stop");
}

static int require_finite(dal_error *error, const char *callback, const char *output, size_t rows,
                          size_t columns, const double *x)
{
    if (!x || dal__all_finite(rows * columns, x)) return DAL_SUCCESS;
    size_t i = 0;
    while (isfinite(x[i])) i++;
    const dal__entry entry = {callback, output, i / columns, i % columns, x[i]};
    return dal__fail_entry(error, DAL_EDOMAIN, &entry, " = %g is not finite, or was not written",
                           x[i]);
}

bool dal__is_autonomous(const dal_system *system)
{
    return !system->def.force && !system->def.time_dependent;
}

int dal__potential(evaluator *e, double t, const double *q, double *V, double *V_q, double *V_qq,
                   dal_error *error)
{
    const size_t n = e->system->def.n;
    if (!e->potential) {
        if (V) *V = 0.0;
        if (V_q) memset(V_q, 0, n * sizeof *V_q);
        if (V_qq) memset(V_qq, 0, n * n * sizeof *V_qq);
        return DAL_SUCCESS;
    }
    if (!V && !V_q && !V_qq) return DAL_SUCCESS;
    dal__forget(1, V);
    dal__forget(n, V_q);
    dal__forget(n * n, V_qq);
    const int returned = e->potential(t, q, V, V_q, V_qq, e->potential_ctx);
    if (e->potential_ctx != e) e->potential_calls++;
    if (returned) return refuse(error, "potential", returned);
    int status = require_finite(error, "potential", "V", 1, 1, V);
    if (!status) status = require_finite(error, "potential", "V_q", 1, n, V_q);
    if (!status) status = require_finite(error, "potential", "V_qq", n, n, V_qq);
    return status;
}

int dal__constraint(evaluator *e, double t, const double *q, const double *v, double *phi,
                    double *phi_v, double *phi_q, double *phi_t, dal_error *error)
{
    const size_t n = e->system->def.n, m = e->system->def.m;
    const bool linear = e->system->def.kind == DAL_LINEAR;
    if (m == 0) return DAL_SUCCESS;
    double *const forms = linear && phi && !phi_v ? e->forms : phi_v;
    double *const rates = e->system->def.time_dependent ? phi_t : NULL;
    dal__forget(m, phi);
    dal__forget(m * n, forms);
    dal__forget(m * n, phi_q);
    dal__forget(m, rates);
    if (phi_t && !rates) memset(phi_t, 0, m * sizeof *phi_t);
    const int returned =
        e->constraint(t, q, v, linear ? NULL : phi, forms, phi_q, rates, e->constraint_ctx);
    if (e->constraint_ctx != e) e->constraint_calls++;
    if (returned) return refuse(error, "constraint", returned);
    int status = require_finite(error, "constraint", "phi_v", m, n, forms);
    if (!status) status = require_finite(error, "constraint", "phi_q", m, n, phi_q);
    if (!status) status = require_finite(error, "constraint", "phi_t", 1, m, rates);
    if (!status && !linear) status = require_finite(error, "constraint", "phi", 1, m, phi);
    if (!status && linear && phi) dal__apply(m, n, forms, v, phi);
    return status;
}

/* The jet of v^T M v / 2 - V. */
static int simple_lagrangian(evaluator *e, double t, const double *q, const double *v,
                             const dal__jet *jet, dal_error *error)
{
    const size_t n = e->system->def.n;
    const double *const M = e->system->mass;
    double V;
    const int status = dal__potential(e, t, q, jet->L ? &V : NULL, jet->L_q, jet->L_qq, error);
    if (status) return status;
    for (size_t i = 0; jet->L_q && i < n; i++) jet->L_q[i] = -jet->L_q[i];
    for (size_t k = 0; jet->L_qq && k < n * n; k++) jet->L_qq[k] = -jet->L_qq[k];
    if (jet->L_v) dal__apply(n, n, M, v, jet->L_v);
    if (jet->L_vq) memset(jet->L_vq, 0, n * n * sizeof *jet->L_vq);
    if (jet->L_vv) memcpy(jet->L_vv, M, n * n * sizeof *jet->L_vv);
    if (jet->L_vt) memset(jet->L_vt, 0, n * sizeof *jet->L_vt);
    if (!jet->L) return DAL_SUCCESS;
    dal__apply(n, n, M, v, e->gradient);
    *jet->L = 0.5 * dal__dot(n, v, e->gradient) - V;
    return DAL_SUCCESS;
}

int dal__lagrangian(evaluator *e, double t, const double *q, const double *v, const dal__jet *jet,
                    dal_error *error)
{
    const dal_system_def *const def = &e->system->def;
    const size_t n = def->n;
    if (e->constant_mass) return simple_lagrangian(e, t, q, v, jet, error);
    double *const given_qq = def->missing & DAL_MISSING_L_QQ ? NULL : jet->L_qq;
    double *const given_vq = def->missing & DAL_MISSING_L_VQ ? NULL : jet->L_vq;
    double *const given_vv = def->missing & DAL_MISSING_L_VV ? NULL : jet->L_vv;
    double *const L_vt = def->time_dependent ? jet->L_vt : NULL;
    double *const given_vt = def->missing & DAL_MISSING_L_VT ? NULL : L_vt;
    dal__forget(1, jet->L);
    dal__forget(n, jet->L_q);
    dal__forget(n, jet->L_v);
    dal__forget(n * n, jet->L_qq);
    dal__forget(n * n, jet->L_vq);
    dal__forget(n * n, jet->L_vv);
    dal__forget(n, L_vt);
    if (jet->L_vt && !L_vt) memset(jet->L_vt, 0, n * sizeof *jet->L_vt);
    int returned = 0;
    if (jet->L || jet->L_q || jet->L_v || given_qq || given_vq || given_vv || given_vt) {
        e->lagrangian_calls++;
        returned = def->lagrangian(t, q, v, jet->L, jet->L_q, jet->L_v, given_qq, given_vq,
                                   given_vv, given_vt, def->ctx);
    }
    stand_at(e, t, q, v);
    if (!returned && jet->L_qq && !given_qq) {
        returned = differenced(e, value_L_q, MOVES_Q, n, jet->L_qq);
        symmetrise(n, jet->L_qq);
    }
    if (!returned && jet->L_vq && !given_vq)
        returned = differenced(e, value_L_v, MOVES_Q, n, jet->L_vq);
    if (!returned && jet->L_vv && !given_vv) {
        returned = differenced(e, value_L_v, MOVES_V, n, jet->L_vv);
        symmetrise(n, jet->L_vv);
    }
    if (!returned && L_vt && !given_vt) returned = differenced(e, value_L_v, MOVES_T, n, L_vt);
    if (returned) return refuse(error, "lagrangian", returned);
    int status = require_finite(error, "lagrangian", "L", 1, 1, jet->L);
    if (!status) status = require_finite(error, "lagrangian", "L_q", 1, n, jet->L_q);
    if (!status) status = require_finite(error, "lagrangian", "L_v", 1, n, jet->L_v);
    if (!status) status = require_finite(error, "lagrangian", "L_qq", n, n, jet->L_qq);
    if (!status) status = require_finite(error, "lagrangian", "L_vq", n, n, jet->L_vq);
    if (!status) status = require_finite(error, "lagrangian", "L_vv", n, n, jet->L_vv);
    if (!status) status = require_finite(error, "lagrangian", "L_vt", 1, n, L_vt);
    return status;
}

int dal__force(evaluator *e, double t, const double *q, const double *v, double *f, double *f_q,
               double *f_v, dal_error *error)
{
    const dal_system_def *const def = &e->system->def;
    const size_t n = def->n;
    if (!def->force) {
        if (f) memset(f, 0, n * sizeof *f);
        if (f_q) memset(f_q, 0, n * n * sizeof *f_q);
        if (f_v) memset(f_v, 0, n * n * sizeof *f_v);
        return DAL_SUCCESS;
    }
    double *const given_q = def->missing & DAL_MISSING_F_Q ? NULL : f_q;
    double *const given_v = def->missing & DAL_MISSING_F_V ? NULL : f_v;
    dal__forget(n, f);
    dal__forget(n * n, f_q);
    dal__forget(n * n, f_v);
    int returned = 0;
    if (f || given_q || given_v) {
        e->force_calls++;
        returned = def->force(t, q, v, f, given_q, given_v, def->ctx);
    }
    stand_at(e, t, q, v);
    if (!returned && f_q && !given_q) returned = differenced(e, value_f, MOVES_Q, n, f_q);
    if (!returned && f_v && !given_v) returned = differenced(e, value_f, MOVES_V, n, f_v);
    if (returned) return refuse(error, "force", returned);
    int status = require_finite(error, "force", "f", 1, n, f);
    if (!status) status = require_finite(error, "force", "f_q", n, n, f_q);
    if (!status) status = require_finite(error, "force", "f_v", n, n, f_v);
    return status;
}
